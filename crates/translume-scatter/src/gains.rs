//! Gains of frames from the ratios of what they should show alike, where the laser's power drifts.

/// Pairs lie at distances between these, in diameters of the beam: nearer ones see each other's spot, farther ones noise.
pub(crate) const PAIRS: (f64, f64) = (0.6, 2.6);
/// Of a pair at least this share of the beam's profile is above the noise.
pub(crate) const SEEN: f64 = 0.95;
/// Rounds of Gauss and Seidel.
const ROUNDS: usize = 1000;

/// Least squares of ln g_i − ln g_j = y_ij, where each unknown has its partners j and y_ij. Unknowns that hang together have the mean 0:
/// no ratio tells how bright all of them are. One without partners is 0.
pub(crate) fn solve(pairs: &[Vec<(usize, f64)>]) -> Vec<f64> {
    let mut ln = vec![0.0; pairs.len()];
    for _ in 0..ROUNDS {
        let mut change = 0.0f64;
        for (i, partners) in pairs.iter().enumerate().filter(|(_, p)| !p.is_empty()) {
            let mean = partners.iter().map(|(j, y)| ln[*j] + y).sum::<f64>() / partners.len() as f64;
            change = change.max((mean - ln[i]).abs());
            ln[i] = mean;
        }
        if change < 1e-6 {
            break;
        }
    }
    let mut done = vec![false; pairs.len()];
    for first in 0..pairs.len() {
        if std::mem::replace(&mut done[first], true) {
            continue;
        }
        let mut together = vec![first];
        let mut next = 0;
        while let Some(&i) = together.get(next) {
            next += 1;
            for &(j, _) in &pairs[i] {
                if !std::mem::replace(&mut done[j], true) {
                    together.push(j);
                }
            }
        }
        let mean = together.iter().map(|&i| ln[i]).sum::<f64>() / together.len() as f64;
        together.iter().for_each(|&i| ln[i] -= mean);
    }
    ln
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gains_are_what_pairs_agree_on() {
        let truth = [0.3, -0.1, 0.2, -0.4, 0.0, 0.5, 0.1];
        let pair = |i: usize, j: usize| (j, truth[i] - truth[j]);
        // A chain, a spot alone, and two for themselves.
        let pairs = vec![
            vec![pair(0, 1)],
            vec![pair(1, 0), pair(1, 2)],
            vec![pair(2, 1), pair(2, 3)],
            vec![pair(3, 2)],
            vec![],
            vec![pair(5, 6)],
            vec![pair(6, 5)],
        ];
        let found = solve(&pairs);
        let expected = [0.3, -0.1, 0.2, -0.4, 0.0, 0.2, -0.2];
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-4), "{found:?}");
    }
}
