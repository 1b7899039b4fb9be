//! Values for holes: pixels that are clipped in the anchor and of which every unclipped picture shows something else.
//!
//! The anchor bounds them from below, nothing else is known; they, and pixels that no picture shows, take the smooth continuation of what surrounds them
//! (pull–push over a pyramid of averages [Gortler et al. 1996]), never below their bound. No edge of a thing that moved
//! is left standing there, which a plain bound or another picture's value would leave.

use crate::merge::Trust;

/// One level of the pyramid: weighted sums of RGB and weights.
struct Level {
    width: usize,
    height: usize,
    values: Vec<[f32; 4]>,
}

/// Fills the holes of a log-radiance picture (interleaved RGB) of `width` pixels a row.
pub(crate) fn fill(values: &mut [f32], trust: &[Trust], width: usize) {
    let to_fill = |t: Trust| matches!(t, Trust::Hole | Trust::Unseen);
    if !trust.iter().any(|t| to_fill(*t)) {
        return;
    }
    let height = trust.len() / width;
    let finest = |x: usize, y: usize| {
        let i = y * width + x;
        let known = f32::from(u8::from(!to_fill(trust[i])));
        [values[3 * i] * known, values[3 * i + 1] * known, values[3 * i + 2] * known, known]
    };
    let mut levels = vec![halve(width, height, finest)];
    while let Some(last) = levels.last().filter(|l| l.values.iter().any(|v| v[3] == 0.0) && l.width.max(l.height) > 1) {
        let next = halve(last.width, last.height, |x, y| last.values[y * last.width + x]);
        levels.push(next);
    }
    // Downwards: what a level does not know it takes from the one above.
    for k in (0..levels.len() - 1).rev() {
        let (fine, coarse) = levels.split_at_mut(k + 1);
        let (fine, coarse) = (&mut fine[k], &coarse[0]);
        for y in 0..fine.height {
            for x in 0..fine.width {
                let v = &mut fine.values[y * fine.width + x];
                if v[3] == 0.0 {
                    *v = coarse.at(x as f32, y as f32);
                }
            }
        }
    }
    for (i, t) in trust.iter().enumerate().filter(|(_, t)| to_fill(**t)) {
        let v = levels[0].at((i % width) as f32, (i / width) as f32);
        if v[3] == 0.0 {
            continue;
        }
        for c in 0..3 {
            let own = values[3 * i + c];
            values[3 * i + c] = if *t == Trust::Unseen { v[c] } else { own.max(v[c]) };
        }
    }
}

impl Level {
    /// Bilinear value at pixel (x, y) of the level below, normalised.
    fn at(&self, x: f32, y: f32) -> [f32; 4] {
        let (gx, gy) = (
            (0.5 * x - 0.25).clamp(0.0, (self.width - 1) as f32),
            (0.5 * y - 0.25).clamp(0.0, (self.height - 1) as f32),
        );
        let (ix, iy) = (gx as usize, gy as usize);
        let (fx, fy) = (gx - ix as f32, gy - iy as f32);
        let mut sum = [0.0f32; 4];
        for (dx, dy, weight) in
            [(0, 0, (1.0 - fx) * (1.0 - fy)), (1, 0, fx * (1.0 - fy)), (0, 1, (1.0 - fx) * fy), (1, 1, fx * fy)]
        {
            let p = &self.values[(iy + dy).min(self.height - 1) * self.width + (ix + dx).min(self.width - 1)];
            // Little known pixels count, but less.
            let weight = weight * p[3].min(1.0);
            for c in 0..3 {
                sum[c] += weight * p[c] / p[3].max(1e-9);
            }
            sum[3] += weight;
        }
        if sum[3] > 0.0 { [sum[0] / sum[3], sum[1] / sum[3], sum[2] / sum[3], 1.0] } else { [0.0; 4] }
    }
}

fn halve(width: usize, height: usize, at: impl Fn(usize, usize) -> [f32; 4]) -> Level {
    let (w, h) = (width.div_ceil(2), height.div_ceil(2));
    let mut values = vec![[0.0f32; 4]; w * h];
    for y in 0..height {
        for x in 0..width {
            let v = at(x, y);
            let o = &mut values[y / 2 * w + x / 2];
            (0..4).for_each(|c| o[c] += v[c]);
        }
    }
    Level { width: w, height: h, values }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hole_continues_its_surroundings_and_keeps_its_bound() {
        let (w, h) = (40, 30);
        let mut values: Vec<f32> = (0..w * h).flat_map(|i| [(i % w) as f32 * 0.1; 3]).collect();
        let mut trust = vec![Trust::Measured; w * h];
        for y in 10..20 {
            for x in 15..25 {
                trust[y * w + x] = Trust::Hole;
                values[3 * (y * w + x)] = -5.0;
                values[3 * (y * w + x) + 1] = -5.0;
                values[3 * (y * w + x) + 2] = 9.0;
            }
        }
        fill(&mut values, &trust, w);
        let middle = 3 * (15 * w + 20);
        assert!((values[middle] - 2.0).abs() < 0.3, "{}", values[middle]);
        assert_eq!(values[middle + 2], 9.0);
        assert_eq!(values[3 * (5 * w + 5)], 0.5);
    }

    #[test]
    fn nothing_known_leaves_the_bounds() {
        let mut values = vec![-1.5f32; 3 * 12];
        fill(&mut values, &[Trust::Hole; 12], 4);
        assert!(values.iter().all(|v| *v == -1.5));
    }
}
