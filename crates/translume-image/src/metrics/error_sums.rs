//! Sums of squared differences: RMSE, relMSE, PSNR, PSNR-µ.

/// Mean of `f` over all pairs of samples; 0 without samples.
pub(super) fn mean(a: &[f32], b: &[f32], f: impl Fn(f64, f64) -> f64) -> f64 {
    assert_eq!(a.len(), b.len(), "pictures of one size");
    a.iter().zip(b).map(|(&x, &y)| f(f64::from(x), f64::from(y))).sum::<f64>() / a.len().max(1) as f64
}

/// Root of the mean squared difference, in the unit of the samples.
pub fn rmse(reference: &[f32], test: &[f32]) -> f64 {
    mean(reference, test, |a, b| (a - b).powi(2)).sqrt()
}

/// Mean of (test − reference)² / (reference² + ε) over samples of linear light; ε = 0.01 as in Rousselle et al. 2011.
pub fn rel_mse(reference: &[f32], test: &[f32], epsilon: f64) -> f64 {
    mean(reference, test, |a, b| (a - b).powi(2) / (a * a + epsilon))
}

/// Peak signal-to-noise ratio in dB, 10 log10(peak² / MSE); infinite for equal pictures.
pub fn psnr(reference: &[f32], test: &[f32], peak: f64) -> f64 {
    10.0 * (peak * peak / mean(reference, test, |a, b| (a - b).powi(2))).log10()
}

/// PSNR in dB of linear light after the µ-law ln(1 + µ x) / ln(1 + µ), µ = 5000 (Kalantari and Ramamoorthi 2017), with
/// x clipped to [0, 1] in units of `peak`; [`top_percentile`] of the reference is a usual peak.
pub fn psnr_mu(reference: &[f32], test: &[f32], peak: f64) -> f64 {
    const MU: f64 = 5000.0;
    let law = |v: f64| (MU * (v / peak).clamp(0.0, 1.0)).ln_1p() / MU.ln_1p();
    -10.0 * mean(reference, test, |a, b| (law(a) - law(b)).powi(2)).log10()
}

/// The 99.9th percentile of all samples, interpolated.
pub fn top_percentile(samples: &[f32]) -> f64 {
    if samples.is_empty() {
        return 0.0;
    }
    let mut v = samples.to_vec();
    let rank = 0.999 * (v.len() - 1) as f64;
    let (_, &mut low, above) = v.select_nth_unstable_by(rank as usize, f32::total_cmp);
    let high = above.iter().copied().min_by(f32::total_cmp).unwrap_or(low);
    f64::from(low) + rank.fract() * (f64::from(high) - f64::from(low))
}

#[cfg(test)]
mod tests {
    use super::super::samples;
    use super::*;

    fn near(got: f64, expected: f64, tolerance: f64) {
        assert!((got - expected).abs() < tolerance, "{got} instead of {expected}");
    }

    #[test]
    fn agree_with_numpy_and_scikit_image() {
        let (a, b) = samples::pair();
        near(rmse(&a, &b), 0.125_252_227_7, 1e-6);
        near(rel_mse(&a, &b, 0.01), 0.363_035_989_2, 1e-5);
        near(psnr(&a, &b, 1.0), 18.044_290_820, 1e-4);
        let (a, b) = samples::hdr_pair();
        near(top_percentile(&a), 9.189_534, 1e-4);
        near(psnr_mu(&a, &b, top_percentile(&a)), 21.812_171_8, 1e-3);
    }

    #[test]
    fn equal_pictures_have_no_error() {
        let (a, _) = samples::pair();
        assert_eq!(rmse(&a, &a), 0.0);
        assert_eq!(psnr(&a, &a, 1.0), f64::INFINITY);
    }
}
