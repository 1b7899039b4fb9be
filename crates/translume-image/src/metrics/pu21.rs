//! PU21: a perceptually uniform scale of absolute luminance (Mantiuk and Azimi, PCS 2021), fit `banding_glare`.

use super::error_sums::mean;

/// Seven parameters of the fit that the authors recommend.
const P: [f64; 7] =
    [0.353487901, 0.3734658629, 8.277049286e-05, 0.9062562627, 0.09150303166, 0.9099517204, 596.3148142];

/// PU value of a luminance (or a linear colour value) in cd/m², clipped to 0.005 … 10,000: 0 to 595, and 100 cd/m² is
/// near 256.
pub fn pu21_encode(cd_m2: f64) -> f64 {
    let y = cd_m2.clamp(0.005, 10_000.0).powf(P[3]);
    P[6] * (((P[0] + P[1] * y) / (1.0 + P[2] * y)).powf(P[4]) - P[5])
}

/// The luminance in cd/m² that has a PU value; the inverse of [`pu21_encode`].
pub fn pu21_decode(pu: f64) -> f64 {
    let t = (pu / P[6] + P[5]).max(0.0).powf(1.0 / P[4]);
    ((t - P[0]) / (P[1] - P[2] * t)).max(0.0).powf(1.0 / P[3]).clamp(0.005, 10_000.0)
}

/// PSNR in dB of PU-encoded linear colour values, peak 256 as the authors' own metric takes it. `cd_m2` is what one unit
/// of the samples stands for.
pub fn pu21_psnr(reference: &[f32], test: &[f32], cd_m2: f64) -> f64 {
    let mse = mean(reference, test, |a, b| (pu21_encode(a * cd_m2) - pu21_encode(b * cd_m2)).powi(2));
    10.0 * (256.0 * 256.0 / mse).log10()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::samples;

    #[test]
    fn the_scale_has_its_published_ends() {
        // p_min and p_max that the authors' encoder publishes.
        assert!((pu21_encode(0.0) - 5.4705e-10).abs() < 1e-9);
        assert!((pu21_encode(1e6) - 595.3939).abs() < 1e-4);
        assert!((pu21_encode(100.0) - 256.383_897).abs() < 1e-5);
    }

    #[test]
    fn psnr_agrees_with_a_separate_computation() {
        let (a, b) = samples::hdr_pair();
        assert!((pu21_psnr(&a, &b, 10.0) - 17.664_228).abs() < 1e-3);
    }

    #[test]
    fn decoding_undoes_encoding() {
        for cd_m2 in [0.005, 0.1, 3.0, 100.0, 2500.0, 10_000.0] {
            assert!((pu21_decode(pu21_encode(cd_m2)) / cd_m2 - 1.0).abs() < 1e-6, "{cd_m2}");
        }
    }
}
