//! Tabulated distributions: discrete, piecewise constant in one and two dimensions, and Vose's alias table.
//!
//! Sources: Pharr, Jakob & Humphreys, "Physically Based Rendering" (inversion); Vose 1991 (alias). Sums run in f64, the
//! tables are f32. The constructors refuse what has no distribution (empty, negative, not finite, all zero) with `None`.

use crate::warp::ONE_MINUS_EPSILON;
use glam::Vec2;

/// A piecewise-constant density on [0, 1], or equally a discrete distribution over its pieces.
#[derive(Clone, Debug)]
pub struct Piecewise1d {
    /// n + 1 values from 0 to 1. Their differences are the probabilities, by which what is drawn and what is said of it
    /// agree for pieces that rounding changes or empties.
    cdf: Vec<f32>,
    /// For equal intervals of u, one to [`PIECES`] pieces, the last piece that begins at or below the interval: where a
    /// search starts (Chen & Asau 1974), so that it takes constant time on average. Coarse, so that it stays in the cache.
    guide: Vec<u32>,
    mean: f64,
}

const PIECES: usize = 16;

impl Piecewise1d {
    /// From n non-negative weights, need not sum to one.
    pub fn new(weights: &[f32]) -> Option<Self> {
        let total: f64 = weights.iter().map(|&w| f64::from(w)).sum();
        if !(total > 0.0 && total.is_finite()) || weights.iter().any(|&w| w < 0.0) {
            return None;
        }
        let mut running = 0.0;
        let mut cdf = Vec::with_capacity(weights.len() + 1);
        cdf.push(0.0);
        for &w in weights {
            running += f64::from(w);
            cdf.push((running / total) as f32);
        }
        let (n, mut piece) = (weights.len(), 0);
        let intervals = n.div_ceil(PIECES);
        let guide = (0..intervals)
            .map(|k| {
                while piece + 1 < n && cdf[piece + 1] <= k as f32 / intervals as f32 {
                    piece += 1;
                }
                piece as u32
            })
            .collect();
        Some(Self { cdf, guide, mean: total / n as f64 })
    }

    /// Number of pieces.
    pub fn len(&self) -> usize {
        self.cdf.len() - 1
    }

    /// Never true: an empty distribution cannot be made.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// Mean of the weights, the integral of the function on [0, 1].
    pub fn mean(&self) -> f64 {
        self.mean
    }

    /// Draws a piece; returns its index, its probability and `u` stretched over the piece for reuse.
    #[inline]
    pub fn sample_discrete(&self, u: f32) -> (usize, f32, f32) {
        // The last piece that begins at or below u and is not empty.
        let k = ((u * self.guide.len() as f32) as usize).min(self.guide.len() - 1);
        let mut i = self.guide[k] as usize;
        let end = self.guide.get(k + 1).map_or(self.len(), |&next| next as usize + 1);
        i += self.cdf[i + 1..end].partition_point(|&begin| begin <= u);
        while i > 0 && self.cdf[i] > u {
            i -= 1; // the interval's number was rounded up
        }
        while self.cdf[i] == self.cdf[i + 1] && i > 0 {
            i -= 1;
        }
        let (lo, hi) = (self.cdf[i], self.cdf[i + 1]);
        let rest = if hi > lo { ((u - lo) / (hi - lo)).clamp(0.0, ONE_MINUS_EPSILON) } else { 0.0 };
        (i, hi - lo, rest)
    }

    /// Probability of a piece.
    #[inline]
    pub fn probability(&self, i: usize) -> f32 {
        self.cdf[i + 1] - self.cdf[i]
    }

    /// Draws x in [0, 1); returns x and its density.
    #[inline]
    pub fn sample(&self, u: f32) -> (f32, f32) {
        let (i, p, rest) = self.sample_discrete(u);
        let n = self.len() as f32;
        let mut x = ((i as f32 + rest) / n).min(ONE_MINUS_EPSILON);
        // Rounding must not carry x into a neighbour, whose density may be zero.
        while (x * n) as usize > i {
            x = x.next_down();
        }
        while ((x * n) as usize) < i {
            x = x.next_up();
        }
        (x, p * n)
    }

    /// Density at x in [0, 1].
    #[inline]
    pub fn pdf(&self, x: f32) -> f32 {
        let n = self.len();
        self.probability(((x * n as f32) as usize).min(n - 1)) * n as f32
    }
}

/// A piecewise-constant density on the unit square, row by row.
#[derive(Clone, Debug)]
pub struct Piecewise2d {
    rows: Vec<Option<Piecewise1d>>,
    marginal: Piecewise1d,
}

impl Piecewise2d {
    /// From `width` × height weights in rows, height = weights.len() / width; `None` also where that does not divide.
    pub fn new(weights: &[f32], width: usize) -> Option<Self> {
        if width == 0 || !weights.len().is_multiple_of(width) {
            return None;
        }
        if weights.iter().any(|w| !(w.is_finite() && *w >= 0.0)) {
            return None;
        }
        let rows: Vec<_> = weights.chunks_exact(width).map(Piecewise1d::new).collect();
        let sums: Vec<f32> = rows.iter().map(|r| r.as_ref().map_or(0.0, |r| r.mean() as f32)).collect();
        Some(Self { marginal: Piecewise1d::new(&sums)?, rows })
    }

    /// Mean of the weights, the integral of the function on the unit square.
    pub fn mean(&self) -> f64 {
        self.marginal.mean()
    }

    /// Draws (x, y) in [0, 1)²; returns the point and its density per unit area.
    #[inline]
    pub fn sample(&self, u: Vec2) -> (Vec2, f32) {
        let (y, pdf_y) = self.marginal.sample(u.y);
        match self.row(y) {
            Some(row) => {
                let (x, pdf_x) = row.sample(u.x);
                (Vec2::new(x, y), pdf_x * pdf_y)
            }
            None => (Vec2::new(u.x, y), 0.0),
        }
    }

    /// Density at a point of [0, 1]².
    #[inline]
    pub fn pdf(&self, p: Vec2) -> f32 {
        self.row(p.y).map_or(0.0, |row| row.pdf(p.x) * self.marginal.pdf(p.y))
    }

    #[inline]
    fn row(&self, y: f32) -> Option<&Piecewise1d> {
        let n = self.rows.len();
        self.rows[((y * n as f32) as usize).min(n - 1)].as_ref()
    }
}

/// Discrete distribution sampled in constant time; unlike inversion it does not keep the order of `u`.
#[derive(Clone, Debug)]
pub struct AliasTable {
    bins: Vec<AliasBin>,
}

#[derive(Clone, Copy, Debug)]
struct AliasBin {
    /// Chance of staying in this bin.
    stay: f32,
    alias: u32,
    probability: f32,
}

impl AliasTable {
    /// From non-negative weights, need not sum to one.
    pub fn new(weights: &[f32]) -> Option<Self> {
        let total: f64 = weights.iter().map(|&w| f64::from(w)).sum();
        if !(total > 0.0 && total.is_finite()) || weights.iter().any(|&w| w < 0.0) {
            return None;
        }
        u32::try_from(weights.len()).ok()?;
        let n = weights.len() as f64;
        let mut scaled: Vec<f64> = weights.iter().map(|&w| f64::from(w) / total * n).collect();
        let mut bins: Vec<AliasBin> = weights
            .iter()
            .enumerate()
            .map(|(i, &w)| AliasBin { stay: 1.0, alias: i as u32, probability: (f64::from(w) / total) as f32 })
            .collect();
        let (mut small, mut large): (Vec<usize>, Vec<usize>) = (0..bins.len()).partition(|&i| scaled[i] < 1.0);
        while let (Some(&s), Some(&l)) = (small.last(), large.last()) {
            small.pop();
            bins[s].stay = scaled[s] as f32;
            bins[s].alias = l as u32;
            scaled[l] -= 1.0 - scaled[s];
            if scaled[l] < 1.0 {
                large.pop();
                small.push(l);
            }
        }
        // Whatever is left differs from 1 by rounding only; a weight of zero is never left with a full bin.
        let likeliest = (0..bins.len()).max_by(|&a, &b| weights[a].total_cmp(&weights[b]))?;
        for i in small {
            if weights[i] == 0.0 {
                (bins[i].stay, bins[i].alias) = (0.0, likeliest as u32);
            }
        }
        Some(Self { bins })
    }

    /// Draws an index; returns it and its probability.
    #[inline]
    pub fn sample(&self, u: f32) -> (usize, f32) {
        let n = self.bins.len();
        // In f64: with many bins an f32 has too few bits for the bin and the choice inside it.
        let x = f64::from(u) * n as f64;
        let i = (x as usize).min(n - 1);
        let bin = self.bins[i];
        let chosen = if x - (i as f64) < f64::from(bin.stay) { i } else { bin.alias as usize };
        (chosen, self.bins[chosen].probability)
    }

    /// Probability of an index.
    #[inline]
    pub fn probability(&self, i: usize) -> f32 {
        self.bins[i].probability
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{rng::Pcg32, stats};

    const WEIGHTS: [f32; 7] = [0.0, 1.0, 3.0, 0.0, 0.5, 7.0, 0.0];

    #[test]
    fn draws_follow_the_weights() {
        let n = 100_000;
        let total: f32 = WEIGHTS.iter().sum();
        let expected: Vec<f64> = WEIGHTS.iter().map(|w| f64::from(w / total) * f64::from(n)).collect();
        let inversion = Piecewise1d::new(&WEIGHTS).unwrap();
        let alias = AliasTable::new(&WEIGHTS).unwrap();
        let mut rng = Pcg32::new(5, 0);
        let (mut a, mut b) = (vec![0.0; 7], vec![0.0; 7]);
        for _ in 0..n {
            let (i, p, rest) = inversion.sample_discrete(rng.next_f32());
            assert!(p > 0.0 && p == inversion.probability(i) && (0.0..1.0).contains(&rest));
            a[i] += 1.0;
            let (j, p) = alias.sample(rng.next_f32());
            assert!(p > 0.0 && p == alias.probability(j));
            b[j] += 1.0;
        }
        stats::chi2_test(&a, &expected, 1e-4).unwrap();
        stats::chi2_test(&b, &expected, 1e-4).unwrap();
    }

    #[test]
    fn ends_of_the_range_never_reach_an_empty_piece() {
        let d = Piecewise1d::new(&WEIGHTS).unwrap();
        for u in [0.0, ONE_MINUS_EPSILON, 1.0] {
            let (i, p, _) = d.sample_discrete(u);
            assert!(p > 0.0, "{u} {i}");
            let (x, pdf) = d.sample(u);
            assert!(x < 1.0 && pdf > 0.0 && (pdf - d.pdf(x)).abs() < 1e-4 * pdf);
        }
    }

    #[test]
    fn two_dimensions_match_their_density() {
        let (w, h) = (5, 4);
        let weights: Vec<f32> = (0..w * h).map(|i| if i / w == 2 { 0.0 } else { (i % 7) as f32 }).collect();
        let d = Piecewise2d::new(&weights, w).unwrap();
        let total: f32 = weights.iter().sum();
        assert!((d.mean() - f64::from(total) / 20.0).abs() < 1e-6);
        let n = 100_000;
        let mut seen = vec![0.0; w * h];
        let mut rng = Pcg32::new(6, 0);
        for _ in 0..n {
            let (p, pdf) = d.sample(Vec2::new(rng.next_f32(), rng.next_f32()));
            let i = (p.y * h as f32) as usize * w + (p.x * w as f32) as usize;
            assert!((pdf - weights[i] / total * (w * h) as f32).abs() < 1e-4, "{p} {pdf}");
            assert!((pdf - d.pdf(p)).abs() < 1e-4);
            seen[i] += 1.0;
        }
        let expected: Vec<f64> = weights.iter().map(|x| f64::from(x / total) * f64::from(n)).collect();
        stats::chi2_test(&seen, &expected, 1e-4).unwrap();
    }

    #[test]
    fn what_has_no_distribution_is_refused() {
        for bad in [&[][..], &[0.0, 0.0], &[1.0, -1.0, 3.0], &[f32::NAN, 1.0], &[f32::INFINITY]] {
            assert!(Piecewise1d::new(bad).is_none());
            assert!(AliasTable::new(bad).is_none());
            assert!(Piecewise2d::new(bad, 1).is_none());
        }
        assert!(Piecewise2d::new(&[1.0; 5], 2).is_none());
        assert!(Piecewise2d::new(&[1.0; 4], 0).is_none());
    }
}
