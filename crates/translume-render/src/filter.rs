//! Reconstruction filters by importance sampling (Ernst, Stamminger & Greiner 2006): the place of a sample in its pixel is
//! drawn from the filter, so that every sample belongs to one pixel.
//!
//! Filters with negative lobes are drawn by their magnitude and carry a sign. The expectation is the convolution of the
//! picture with the filter, as splatting has it, but for the pixels at the border, where the filter here reaches beyond.

use glam::Vec2;
use std::f32::consts::PI;
use translume_core::distribution::Piecewise1d;
use translume_scene::sensor::PixelFilter;

const PIECES: usize = 256;

/// A filter ready for sampling.
#[derive(Clone, Debug)]
pub(crate) struct FilterSampler {
    radius: f32,
    pieces: Piecewise1d,
    negative: Vec<bool>,
    /// ∫|f| / ∫f of the one-dimensional filter.
    gain: f32,
}

impl FilterSampler {
    pub(crate) fn new(filter: &PixelFilter) -> Self {
        let radius = radius(filter);
        let values: Vec<f32> = (0..PIECES)
            .map(|i| value(filter, ((i as f32 + 0.5) / PIECES as f32 * 2.0 - 1.0) * radius, radius))
            .collect();
        let (sum, magnitude): (f32, f32) = (values.iter().sum(), values.iter().map(|v| v.abs()).sum());
        let usable = sum > 0.0 && sum.is_finite();
        let weights: Vec<f32> = if usable { values.iter().map(|v| v.abs()).collect() } else { vec![1.0; PIECES] };
        Self {
            radius,
            pieces: Piecewise1d::new(&weights).expect("weights are finite, positive and not all zero"),
            negative: values.iter().map(|&v| usable && v < 0.0).collect(),
            gain: if usable { magnitude / sum } else { 1.0 },
        }
    }

    /// Offset from the pixel's centre, in pixels, and the sample's weight (1 for filters without negative lobes).
    #[inline]
    pub(crate) fn sample(&self, u: Vec2) -> (Vec2, f32) {
        let (x, sx) = self.sample_1d(u.x);
        let (y, sy) = self.sample_1d(u.y);
        (Vec2::new(x, y), sx * sy)
    }

    /// Pixels this far beyond a pixel's border still count for it.
    pub(crate) fn margin(&self) -> f32 {
        (self.radius - 0.5).max(0.0)
    }

    pub(crate) fn radius(&self) -> f32 {
        self.radius
    }

    /// What light at `offset` from a pixel's centre counts for the pixel, per pixel area: the density of
    /// [`FilterSampler::sample`] times its weight.
    #[inline]
    pub(crate) fn weight(&self, offset: Vec2) -> f32 {
        self.weight_1d(offset.x) * self.weight_1d(offset.y)
    }

    #[inline]
    fn weight_1d(&self, x: f32) -> f32 {
        if x < -self.radius || x >= self.radius {
            return 0.0;
        }
        let place = 0.5 * (x / self.radius + 1.0);
        let piece = ((place * PIECES as f32) as usize).min(PIECES - 1);
        let weight = self.gain * self.pieces.probability(piece) * PIECES as f32 / (2.0 * self.radius);
        if self.negative[piece] { -weight } else { weight }
    }

    #[inline]
    fn sample_1d(&self, u: f32) -> (f32, f32) {
        let (i, _, rest) = self.pieces.sample_discrete(u);
        let x = ((i as f32 + rest) / PIECES as f32 * 2.0 - 1.0) * self.radius;
        (x, if self.negative[i] { -self.gain } else { self.gain })
    }
}

/// Half the width; at least half a pixel's hundredth, so that no filter is empty.
fn radius(filter: &PixelFilter) -> f32 {
    let radius = match *filter {
        PixelFilter::Box { radius } | PixelFilter::Tent { radius } | PixelFilter::Gaussian { radius, .. } => radius,
        PixelFilter::Mitchell { .. } | PixelFilter::CatmullRom => 2.0,
        PixelFilter::Lanczos { lobes } => lobes,
    };
    if radius.is_finite() { radius.clamp(0.005, 64.0) } else { 0.5 }
}

fn value(filter: &PixelFilter, x: f32, radius: f32) -> f32 {
    let x = x.abs();
    match *filter {
        PixelFilter::Box { .. } => 1.0,
        PixelFilter::Tent { .. } => (1.0 - x / radius).max(0.0),
        PixelFilter::Gaussian { stddev, .. } => {
            let g = |x: f32| (-x * x / (2.0 * stddev * stddev)).exp();
            (g(x) - g(radius)).max(0.0)
        }
        PixelFilter::Mitchell { b, c } => mitchell(b, c, x),
        PixelFilter::CatmullRom => mitchell(0.0, 0.5, x),
        PixelFilter::Lanczos { lobes } => sinc(x) * sinc(x / lobes),
    }
}

fn sinc(x: f32) -> f32 {
    if x < 1e-4 { 1.0 } else { (PI * x).sin() / (PI * x) }
}

/// [Mitchell & Netravali 1988, Eq. 8].
fn mitchell(b: f32, c: f32, x: f32) -> f32 {
    let v = if x < 1.0 {
        (12.0 - 9.0 * b - 6.0 * c) * x.powi(3) + (-18.0 + 12.0 * b + 6.0 * c) * x * x + 6.0 - 2.0 * b
    } else if x < 2.0 {
        (-b - 6.0 * c) * x.powi(3) + (6.0 * b + 30.0 * c) * x * x - (12.0 * b + 48.0 * c) * x + 8.0 * b + 24.0 * c
    } else {
        0.0
    };
    v / 6.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean of w·x² over the samples is the filter's second moment, which quadrature knows too.
    #[test]
    fn samples_have_the_moments_of_the_filter() {
        let filters = [
            PixelFilter::Box { radius: 0.5 },
            PixelFilter::Tent { radius: 1.0 },
            PixelFilter::default(),
            PixelFilter::Mitchell { b: 1.0 / 3.0, c: 1.0 / 3.0 },
            PixelFilter::CatmullRom,
            PixelFilter::Lanczos { lobes: 3.0 },
        ];
        for filter in filters {
            let r = radius(&filter);
            let (mut mass, mut second) = (0.0_f64, 0.0_f64);
            for i in 0..100_000 {
                let x = ((i as f32 + 0.5) / 50_000.0 - 1.0) * r;
                mass += f64::from(value(&filter, x, r));
                second += f64::from(value(&filter, x, r) * x * x);
            }
            let sampler = FilterSampler::new(&filter);
            let n = 100_000;
            let (mut sampled_mass, mut sampled_second) = (0.0_f64, 0.0_f64);
            for i in 0..n {
                let (x, w) = sampler.sample_1d((i as f32 + 0.5) / n as f32);
                sampled_mass += f64::from(w) / f64::from(n);
                sampled_second += f64::from(w * x * x) / f64::from(n);
            }
            assert!((sampled_mass - 1.0).abs() < 2e-3, "{filter:?} {sampled_mass}");
            assert!((sampled_second - second / mass).abs() < 2e-3, "{filter:?} {sampled_second} {}", second / mass);
        }
    }
}
