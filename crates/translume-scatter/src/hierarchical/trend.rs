//! The mean of what is measured by distance: what completion starts from.
//!
//! ln F falls about linearly with distance, and steeply near the diagonal. Interpolating it directly cuts off peaks and goes on flat
//! beyond what was seen; the deviation from the mean fall-off is smooth everywhere. This goes beyond the paper, which filters ln F itself.

use super::colour::Feature;

/// Pieces of the curve.
const BINS: usize = 48;
/// Samples that make a bin known.
const FEWEST: f64 = 8.0;

/// A feature by distance; all zero until something is known.
pub(super) struct Trend {
    values: Vec<Feature>,
    step: f32,
}

impl Trend {
    /// No trend at all.
    pub(super) fn none() -> Self {
        Self { values: vec![[0.0; 3]; 2], step: 1.0 }
    }

    /// From distances in mm up to `most`, features and weights; `None` without any.
    pub(super) fn new(most: f32, samples: impl Iterator<Item = (f32, Feature, f32)>) -> Option<Self> {
        let step = most.max(1e-6) / (BINS - 1) as f32;
        let mut sums = vec![[0.0f64; 5]; BINS];
        for (d, f, w) in samples {
            let sum = &mut sums[((d / step + 0.5) as usize).min(BINS - 1)];
            (0..3).for_each(|c| sum[c] += f64::from(w * f[c]));
            sum[3] += f64::from(w);
            sum[4] += 1.0;
        }
        let few = if sums.iter().any(|s| s[4] >= FEWEST) { FEWEST } else { 1.0 };
        let known: Vec<(usize, Feature)> = sums
            .iter()
            .enumerate()
            .filter(|(_, s)| s[4] >= few && s[3] > 0.0)
            .map(|(i, s)| (i, [0, 1, 2].map(|c| (s[c] / s[3]) as f32)))
            .collect();
        let (&(first, low), &(last, high)) = (known.first()?, known.last()?);
        // On beyond the last by the slope of the last quarter, never upwards.
        let from = known[known.len() - 1 - known.len() / 4];
        let slope = match last > from.0 {
            true => ((high[0] - from.1[0]) / (last - from.0) as f32).min(0.0),
            false => 0.0,
        };
        let value = |i: usize| {
            if i <= first {
                return low;
            }
            if i >= last {
                return [high[0] + slope * (i - last) as f32, high[1], high[2]];
            }
            let k = known.partition_point(|e| e.0 <= i);
            let (a, b) = (&known[k - 1], &known[k]);
            let t = (i - a.0) as f32 / (b.0 - a.0) as f32;
            [0, 1, 2].map(|c| a.1[c] + t * (b.1[c] - a.1[c]))
        };
        Some(Self { values: (0..BINS).map(value).collect(), step })
    }

    #[inline]
    pub(super) fn at(&self, d: f32) -> Feature {
        let x = (d / self.step).min((self.values.len() - 1) as f32);
        let i = (x as usize).min(self.values.len() - 2);
        let t = x - i as f32;
        [0, 1, 2].map(|c| self.values[i][c] + t * (self.values[i + 1][c] - self.values[i][c]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_bridged_and_the_fall_off_goes_on() {
        let samples = (0..2000).map(|i| i as f32 / 100.0).filter(|d| !(4.0..8.0).contains(d) && *d < 15.0);
        let trend = Trend::new(20.0, samples.map(|d| (d, [-1.0 - 0.5 * d, 0.2, 0.5], 1.0))).unwrap();
        for d in [0.5f32, 3.0, 6.0, 12.0, 19.0] {
            let f = trend.at(d);
            assert!((f[0] + 1.0 + 0.5 * d).abs() < 0.25 && (f[1] - 0.2).abs() < 1e-4, "{d}: {f:?}");
        }
        assert!(Trend::new(1.0, std::iter::empty()).is_none());
    }
}
