//! Operators that treat every pixel alike: Reinhard's global one, and exposure with gamma.

use super::{Display, luminance};
use crate::{Picture, colour};
use rayon::prelude::*;

/// Parameters of [`reinhard_global`].
#[derive(Clone, Copy, Debug)]
pub struct ReinhardParams {
    /// Luminance that the log average is mapped to; 0.18 is the paper's middle gray.
    pub key: f32,
    /// Smallest luminance shown as white, in units of the scaled picture; `None`: its maximum, as in the paper.
    pub white: Option<f32>,
}

impl Default for ReinhardParams {
    fn default() -> Self {
        Self { key: 0.18, white: None }
    }
}

/// The global operator of Reinhard et al., Photographic Tone Reproduction for Digital Images (2002), §3.1, with its
/// burn-out white; colours keep their ratios to the luminance. The result is encoded as sRGB.
pub fn reinhard_global(picture: &Picture, params: &ReinhardParams) -> Display {
    let rgb = picture.pixels.as_raw();
    let lum = luminance(rgb);
    // Eq. 1: the log average. Black pixels carry no exposure information (the paper's small delta would let them
    // decide it), so they are left out.
    // Blocks of fixed size, summed in order: the same bits for any number of threads.
    let block = |lum: &[f32]| {
        let lit = lum.iter().filter(|l| **l > 0.0 && **l < f32::MAX);
        lit.fold((0.0f64, 0u64), |(s, n), &l| (s + f64::from(l).ln(), n + 1))
    };
    let sums: Vec<_> = lum.par_chunks(1 << 14).map(block).collect();
    let (sum, count) = sums.iter().fold((0.0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
    let scale = if count == 0 { 1.0 } else { params.key / ((sum / count as f64).exp() as f32) }; // Eq. 2
    let brightest = lum.iter().filter(|l| **l < f32::MAX).fold(0.0f32, |a, &b| a.max(b)) * scale;
    let white = params.white.unwrap_or(brightest).max(1e-6);
    let inverse_white2 = 1.0 / (white * white);
    encode(picture, |i, v| {
        let l = (lum[i] * scale).min(1e18);
        let factor = scale * (1.0 + l * inverse_white2) / (1.0 + l); // Eq. 4, over L
        v.map(|c| colour::linear_to_srgb((c * factor).clamp(0.0, 1.0)))
    })
}

/// Light times `2^ev`, clipped, encoded with `1/gamma`; `None` takes the sRGB curve.
pub fn exposure_gamma(picture: &Picture, ev: f32, gamma: Option<f32>) -> Display {
    let scale = ev.exp2();
    encode(picture, |_, v| {
        v.map(|c| {
            let c = (c * scale).clamp(0.0, 1.0);
            gamma.map_or_else(|| colour::linear_to_srgb(c), |g| c.powf(1.0 / g))
        })
    })
}

/// Runs `pixel` over all pixels; NaN becomes black.
pub(super) fn encode(picture: &Picture, pixel: impl Fn(usize, [f32; 3]) -> [f32; 3] + Sync) -> Display {
    let pixels = picture.pixels.as_raw().as_chunks::<3>().0;
    let mut rgb = vec![0.0; 3 * pixels.len()];
    let out = rgb.as_chunks_mut::<3>().0;
    out.par_iter_mut().zip(pixels).enumerate().with_min_len(1 << 12).for_each(|(i, (out, p))| {
        *out = pixel(i, *p).map(|v| if v.is_nan() { 0.0 } else { v });
    });
    Display { width: picture.pixels.width() as usize, height: picture.pixels.height() as usize, rgb }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, Rgb32FImage};

    fn gray(values: &[f32]) -> Picture {
        Picture::new(Rgb32FImage::from_fn(values.len() as u32, 1, |x, _| Rgb([values[x as usize]; 3])))
    }

    #[test]
    fn reinhard_maps_the_log_average_and_the_white_as_published() {
        // Log average 1, so the scaled luminances are 0.18 times the values; the largest becomes white.
        let shown = reinhard_global(&gray(&[0.01, 1.0, 100.0]), &ReinhardParams::default());
        let linear: Vec<f32> = shown.rgb.iter().step_by(3).map(|v| colour::srgb_to_linear(*v)).collect();
        let expected = |l: f32| l * (1.0 + l / (18.0 * 18.0)) / (1.0 + l);
        for (got, l) in linear.iter().zip([0.0018, 0.18, 18.0]) {
            assert!((got - expected(l)).abs() < 1e-5, "{got} {}", expected(l));
        }
        assert!((linear[2] - 1.0).abs() < 1e-5);
    }

    #[test]
    fn non_finite_and_negative_light_is_shown_without_spoiling_the_rest() {
        for shown in [
            reinhard_global(&gray(&[f32::NAN, -1.0, f32::INFINITY, 1.0]), &ReinhardParams::default()),
            exposure_gamma(&gray(&[f32::NAN, -1.0, f32::INFINITY, 1.0]), 0.0, Some(2.2)),
        ] {
            assert!(shown.rgb.iter().all(|v| (0.0..=1.0).contains(v)), "{:?}", shown.rgb);
            assert!(shown.rgb[9] > 0.3, "{:?}", shown.rgb);
        }
    }

    #[test]
    fn exposure_counts_in_stops() {
        let shown = exposure_gamma(&gray(&[0.125]), 2.0, Some(2.0));
        assert!((shown.rgb[0] - 0.5f32.sqrt()).abs() < 1e-6);
    }
}
