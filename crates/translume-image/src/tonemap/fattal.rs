//! Fattal, Lischinski, Werman: Gradient Domain High Dynamic Range Compression (SIGGRAPH 2002).
//!
//! Deviations: the Poisson equation is solved exactly by a cosine transform (the paper uses multigrid); the paper does
//! not say how the result is scaled for the display, here two percentiles become black and white.

use super::{Display, luminance, percentile, simple::encode, solve_neumann};
use crate::{Picture, colour};
use rayon::prelude::*;

/// Parameters; the defaults are the paper's.
#[derive(Clone, Copy, Debug)]
pub struct FattalParams {
    /// Gradients of this share of the mean magnitude keep their size (paper: 0.1).
    pub alpha: f32,
    /// Exponent of the compression, below 1 (paper: 0.8 to 0.9).
    pub beta: f32,
    /// Colour saturation s (paper: 0.4 to 0.6).
    pub saturation: f32,
    /// Shares of the pixels that become black and white.
    pub clip: [f64; 2],
}

impl Default for FattalParams {
    fn default() -> Self {
        Self { alpha: 0.1, beta: 0.85, saturation: 0.6, clip: [0.002, 0.005] }
    }
}

/// Compresses large luminance gradients and keeps small ones. The result is encoded as sRGB.
pub fn fattal(picture: &Picture, params: &FattalParams) -> Display {
    let (width, height) = (picture.pixels.width() as usize, picture.pixels.height() as usize);
    let lum = luminance(picture.pixels.as_raw());
    let log_lum = log_luminance(&lum);
    let phi = attenuation(Level { width, height, values: log_lum.clone() }, params);
    let mut u = divergence(width, height, &log_lum, &phi);
    drop(phi);
    solve_neumann(width, height, &mut u);
    let u: Vec<f32> = u.par_iter().map(|v| v.exp() as f32).collect();
    let (black, white) = (percentile(&u, params.clip[0]), percentile(&u, 1.0 - params.clip[1]));
    // The darkest stays a little above zero: the picture's own black, not a crushed one.
    let range = (white - black).max(1e-6 * white).max(f32::MIN_POSITIVE);
    encode(picture, |i, v| {
        let shown = ((u[i] - black) / range).clamp(0.0, 1.0);
        let l = lum[i].max(f32::MIN_POSITIVE);
        // §5: C_out = (C_in / L_in)^s L_out.
        v.map(|c| colour::linear_to_srgb(((c.max(0.0) / l).powf(params.saturation) * shown).clamp(0.0, 1.0)))
    })
}

/// Natural logarithm with black lifted to a thousandth of the darkest percent that is not black, so that dead pixels
/// make no cliffs.
fn log_luminance(lum: &[f32]) -> Vec<f32> {
    let lit: Vec<f32> = lum.iter().copied().filter(|l| *l > 0.0 && *l < f32::MAX).collect();
    let (floor, top) = (percentile(&lit, 0.01) * 1e-3, percentile(&lit, 1.0));
    lum.par_iter().map(|l| l.clamp(floor.max(f32::MIN_POSITIVE), top.max(f32::MIN_POSITIVE)).ln()).collect()
}

/// In units of α: below it gradients are magnified no more.
const SMALLEST_GRADIENT: f32 = 0.5;

struct Level {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Level {
    fn at(&self, x: usize, y: usize) -> f32 {
        self.values[y * self.width + x]
    }

    /// Half the size by the mean of 2 × 2 values after a [1 2 1]/4 filter would be the Gaussian pyramid; the 4 × 4
    /// binomial [1 3 3 1]/8 does both at once and stays centred.
    fn halved(&self) -> Self {
        let (w, h) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let clamp = |i: usize, k: usize, n: usize| (2 * i + k).saturating_sub(1).min(n - 1);
        let mut values = vec![0.0; w * h];
        values.par_chunks_mut(w).enumerate().for_each(|(y, row)| {
            for (x, out) in row.iter_mut().enumerate() {
                let mut sum = 0.0;
                for (j, wy) in [1.0, 3.0, 3.0, 1.0].into_iter().enumerate() {
                    for (i, wx) in [1.0, 3.0, 3.0, 1.0].into_iter().enumerate() {
                        sum += wx * wy * self.at(clamp(x, i, self.width), clamp(y, j, self.height));
                    }
                }
                *out = sum / 64.0;
            }
        });
        Self { width: w, height: h, values }
    }

    /// The value at a pixel of the level below, interpolated linearly.
    fn sampled(&self, x: usize, y: usize) -> f32 {
        let split = |i: usize, n: usize| {
            let p = (i as f32 * 0.5 - 0.25).clamp(0.0, (n - 1) as f32);
            let i0 = p as usize;
            (i0, (i0 + 1).min(n - 1), p - i0 as f32)
        };
        let ((x0, x1, fx), (y0, y1, fy)) = (split(x, self.width), split(y, self.height));
        let row = |y: usize| self.at(x0, y) + fx * (self.at(x1, y) - self.at(x0, y));
        row(y0) + fy * (row(y1) - row(y0))
    }

    /// Magnitude of the central-difference gradient in units of the finest level.
    fn gradient_magnitude(&self, level: i32) -> Vec<f32> {
        let scale = 1.0 / f32::from(2u8) / (level as f32).exp2(); // [§4] 1/2^(k+1)
        let mut out = vec![0.0; self.values.len()];
        out.par_chunks_mut(self.width).enumerate().for_each(|(y, row)| {
            let (above, below) = (y.saturating_sub(1), (y + 1).min(self.height - 1));
            for (x, out) in row.iter_mut().enumerate() {
                let gx = self.at((x + 1).min(self.width - 1), y) - self.at(x.saturating_sub(1), y);
                let gy = self.at(x, below) - self.at(x, above);
                *out = gx.hypot(gy) * scale;
            }
        });
        out
    }
}

/// Φ of the finest level: the product over all levels of φ_k, interpolated from coarse to fine (§4).
fn attenuation(finest: Level, params: &FattalParams) -> Vec<f32> {
    let mut pyramid = vec![finest];
    while let Some(last) = pyramid.last().filter(|l| l.width.min(l.height) >= 64) {
        let next = last.halved(); // down to at least 32 pixels, as in the paper
        pyramid.push(next);
    }
    let mut phi: Option<Level> = None;
    for (k, level) in pyramid.iter().enumerate().rev() {
        let magnitude = level.gradient_magnitude(k as i32);
        let mean = magnitude.iter().map(|v| f64::from(*v)).sum::<f64>() / magnitude.len().max(1) as f64;
        let alpha = (f64::from(params.alpha) * mean).max(1e-9) as f32;
        let width = level.width;
        let mut values = vec![0.0; magnitude.len()];
        values.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            for (x, out) in row.iter_mut().enumerate() {
                // φ = (α/g)(g/α)^β. The paper magnifies small gradients "slightly"; unbounded, the product over all
                // levels makes clouds out of the noise of smooth walls.
                let g = (magnitude[y * width + x] / alpha).max(SMALLEST_GRADIENT);
                *out = g.powf(params.beta - 1.0) * phi.as_ref().map_or(1.0, |coarse| coarse.sampled(x, y));
            }
        });
        phi = Some(Level { width, height: level.height, values });
    }
    phi.map_or_else(Vec::new, |l| l.values)
}

/// div G by backward differences, G = Φ ∇H by forward differences, no flux through the border.
fn divergence(width: usize, height: usize, h: &[f32], phi: &[f32]) -> Vec<f64> {
    let mut out = vec![0.0; h.len()];
    // Φ between two pixels is their mean, which keeps G symmetric under mirroring.
    let flux = |a: usize, b: usize| f64::from(h[b] - h[a]) * 0.5 * f64::from(phi[a] + phi[b]);
    out.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, out) in row.iter_mut().enumerate() {
            let i = y * width + x;
            let mut sum = 0.0;
            if x + 1 < width {
                sum += flux(i, i + 1);
            }
            if x > 0 {
                sum -= flux(i - 1, i);
            }
            if y + 1 < height {
                sum += flux(i, i + width);
            }
            if y > 0 {
                sum -= flux(i - width, i);
            }
            *out = sum;
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, Rgb32FImage};

    fn step(ratio: f32) -> Picture {
        // Two halves, each with the same fine texture in the logarithm.
        Picture::new(Rgb32FImage::from_fn(96, 64, |x, y| {
            let texture = 1.0 + 0.05 * ((x + y) % 2) as f32;
            Rgb([if x < 48 { texture } else { ratio * texture }; 3])
        }))
    }

    #[test]
    fn a_large_step_is_compressed_and_texture_survives_on_both_sides() {
        let picture = step(10_000.0);
        let shown = fattal(&picture, &FattalParams::default());
        let linear: Vec<f32> = shown.rgb.iter().step_by(3).map(|v| colour::srgb_to_linear(*v)).collect();
        let mean = |x0: usize, x1: usize| {
            let v: Vec<f32> =
                (0..64).flat_map(|y| (x0..x1).map(move |x| (x, y))).map(|(x, y)| linear[y * 96 + x]).collect();
            v.iter().sum::<f32>() / v.len() as f32
        };
        let ratio = mean(60, 90) / mean(6, 36).max(1e-6);
        assert!(ratio > 1.0 && ratio < 1000.0, "a step of 10,000 became {ratio}");
        for x in [20, 70] {
            let (a, b) = (linear[30 * 96 + x], linear[30 * 96 + x + 1]);
            assert!((a - b).abs() > 0.0, "texture lost at {x}: {a} {b}");
        }
    }

    #[test]
    fn flat_black_and_tiny_pictures_are_shown() {
        for (w, h, v) in [(5, 1, 0.0), (1, 1, 2.0), (70, 70, 0.5)] {
            let shown = fattal(&Picture::new(Rgb32FImage::from_pixel(w, h, Rgb([v; 3]))), &FattalParams::default());
            assert!(shown.rgb.iter().all(|v| (0.0..=1.0).contains(v)));
        }
    }
}
