//! How much a code is trusted.

/// The quadratic spline [Menzel 2012, §5.2 weight]: 0 with zero slope at both ends, 1 at mid code. `u` in [0, 1].
#[inline]
pub fn spline(u: f32) -> f32 {
    if !(0.0..=1.0).contains(&u) {
        0.0
    } else if u < 0.25 {
        8.0 * u * u
    } else if u <= 0.75 {
        1.0 - 8.0 * (u - 0.5) * (u - 0.5)
    } else {
        8.0 * (1.0 - u) * (1.0 - u)
    }
}

/// Camera noise in units of full range: shot noise of `full_well` electrons, `read` electrons, and rounding to `steps`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Electrons at full range.
    pub full_well: f32,
    /// Read noise in electrons.
    pub read: f32,
}

impl Default for Noise {
    /// A middling camera: 20,000 electrons, 5 electrons of read noise.
    fn default() -> Self {
        Self { full_well: 20_000.0, read: 5.0 }
    }
}

impl Noise {
    /// Variance of ln(exposure) at `exposure` (1 = full range): relative variance of shot plus read noise.
    pub fn log_variance(&self, exposure: f32) -> f32 {
        let electrons = (exposure * self.full_well).max(0.5);
        (electrons + self.read * self.read) / (electrons * electrons)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spline_is_smooth_and_peaks_at_one() {
        assert_eq!(spline(0.0), 0.0);
        assert_eq!(spline(1.0), 0.0);
        assert_eq!(spline(0.5), 1.0);
        for (a, b) in [(0.249_999, 0.250_001), (0.749_999, 0.750_001)] {
            assert!((spline(a) - spline(b)).abs() < 1e-4);
        }
        assert_eq!(spline(f32::NAN), 0.0);
    }

    #[test]
    fn noise_falls_with_light() {
        let n = Noise::default();
        assert!(n.log_variance(0.5) < n.log_variance(0.05));
        // Pure shot noise far above the read noise: variance 1/electrons.
        assert!((n.log_variance(1.0) * 20_000.0 - 1.0).abs() < 0.01);
    }
}
