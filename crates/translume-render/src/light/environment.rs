//! Light from a picture all around.
//!
//! A direction d of the light's own space lies at the column atan2(d.x, −d.z)/2π and the row acos(d.y)/π. Columns have
//! their centres at halves; the first and the last row lie on the poles, as in Mitsuba. Radiance is interpolated between
//! the four nearest pixels; sampling draws such cells by their mean luminance times the sine of the polar angle, so that
//! no place that shines is left out.

use crate::Rgb;
use crate::light::{End, LightSample};
use glam::{DAffine3, DVec3, Mat3, Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, PI, TAU};
use std::sync::Arc;
use translume_core::distribution::Piecewise2d;
use translume_image::Picture;

/// Weights of [`crate::luminance`].
const LUMINANCE: DVec3 = DVec3::new(0.2126, 0.7152, 0.0722);

#[derive(Clone, Debug)]
pub(crate) struct Environment {
    image: Arc<Picture>,
    scale: Rgb,
    world_from_light: Mat3,
    light_from_world: Mat3,
    /// Over the cells: as many columns as pixels, one row fewer.
    cells: Piecewise2d,
    mean_luminance: f32,
}

impl Environment {
    /// `None` for a picture that is black (or too small to be one).
    pub(crate) fn new(image: Arc<Picture>, scale: Rgb, world_from_light: &DAffine3) -> Option<Self> {
        let (w, h) = image.pixels.dimensions();
        if w < 2 || h < 2 {
            return None;
        }
        // In double precision: the sun of a picture may be as bright as its numbers go.
        let gray: Vec<f64> = image
            .pixels
            .as_raw()
            .chunks_exact(3)
            .map(|p| (Rgb::new(p[0], p[1], p[2]).as_dvec3() * scale.as_dvec3()).dot(LUMINANCE).max(0.0))
            .map(|l| if l.is_finite() { l } else { 0.0 })
            .collect();
        let (w, h) = (w as usize, h as usize);
        let mut weights = Vec::with_capacity(w * (h - 1));
        let (mut total, mut sines) = (0.0_f64, 0.0_f64);
        for y in 0..h - 1 {
            let sin = (PI * (y as f32 + 0.5) / (h - 1) as f32).sin();
            for x in 0..w {
                let next = (x + 1) % w;
                let sum = gray[y * w + x] + gray[y * w + next] + gray[(y + 1) * w + x] + gray[(y + 1) * w + next];
                weights.push(0.25 * sum * f64::from(sin));
                total += 0.25 * sum * f64::from(sin);
                sines += f64::from(sin);
            }
        }
        let most = weights.iter().copied().fold(0.0, f64::max);
        let unit = if most > 1e30 { 1e30 / most } else { 1.0 };
        let weights: Vec<f32> = weights.iter().map(|w| (w * unit) as f32).collect();
        // Rotations and mirrors only: what scales or shears would bend directions otherwise.
        let light_from_world = world_from_light.matrix3.inverse();
        Some(Self {
            cells: Piecewise2d::new(&weights, w)?,
            image,
            scale,
            world_from_light: world_from_light.matrix3.as_mat3(),
            light_from_world: light_from_world.as_mat3(),
            mean_luminance: (total / sines).min(f32::MAX.into()) as f32,
        })
    }

    pub(crate) fn mean_luminance(&self) -> f32 {
        self.mean_luminance
    }

    pub(crate) fn sample(&self, u: Vec2) -> Option<LightSample> {
        let (q, density) = self.cells.sample(u);
        let (w, h) = self.size();
        let phi = TAU * (q.x + 0.5 / w); // cells begin at pixel centres
        let theta = PI * q.y;
        let (sin, cos) = theta.sin_cos();
        let d = Vec3::new(phi.sin() * sin, cos, -phi.cos() * sin);
        if sin <= 0.0 {
            return None;
        }
        let cell = (q.x * w, q.y * (h - 1.0));
        Some(LightSample {
            wi: (self.world_from_light * d).normalize(),
            radiance: self.interpolate(cell.0, cell.1),
            pdf_w: density * 0.5 * FRAC_1_PI * FRAC_1_PI / sin,
            delta: false,
            end: End::Far,
        })
    }

    /// Radiance from the direction `d` and the density of [`Environment::sample`] there.
    #[inline]
    pub(crate) fn eval_pdf(&self, d: Vec3) -> (Rgb, f32) {
        let d = (self.light_from_world * d).normalize();
        let (w, h) = self.size();
        let u = d.x.atan2(-d.z) / TAU - 0.5 / w;
        let q = Vec2::new(u - u.floor(), d.y.clamp(-1.0, 1.0).acos() * FRAC_1_PI);
        let sin = (d.x * d.x + d.z * d.z).sqrt();
        let density = self.cells.pdf(q) * 0.5 * FRAC_1_PI * FRAC_1_PI;
        (self.interpolate(q.x * w, q.y * (h - 1.0)), if sin > 0.0 { density / sin } else { 0.0 })
    }

    fn size(&self) -> (f32, f32) {
        let (w, h) = self.image.pixels.dimensions();
        (w as f32, h as f32)
    }

    /// Bilinear in cells, from cell coordinates.
    #[inline]
    fn interpolate(&self, x: f32, y: f32) -> Rgb {
        let (w, h) = self.image.pixels.dimensions();
        let (w, h) = (w as usize, h as usize);
        let (i, j) = ((x as usize).min(w - 1), (y as usize).min(h - 2));
        let (s, t) = ((x - i as f32).clamp(0.0, 1.0), (y - j as f32).clamp(0.0, 1.0));
        let raw = self.image.pixels.as_raw();
        let at = |i: usize, j: usize| Rgb::from_slice(&raw[3 * (j * w + i)..]);
        let next = if i + 1 == w { 0 } else { i + 1 };
        let above = at(i, j) * (1.0 - s) + at(next, j) * s;
        let below = at(i, j + 1) * (1.0 - s) + at(next, j + 1) * s;
        (above * (1.0 - t) + below * t) * self.scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use translume_core::chi2::SphereTest;

    fn picture() -> Arc<Picture> {
        let mut pixels = translume_image::Rgb32FImage::new(16, 9);
        for (x, y, p) in pixels.enumerate_pixels_mut() {
            let v = if (x, y) == (5, 3) { 40.0 } else { ((x * 7 + y * 3) % 5) as f32 };
            p.0 = [v, 0.5 * v, 0.2 * v];
        }
        Arc::new(Picture::new(pixels))
    }

    #[test]
    fn samples_follow_the_density_and_carry_the_radiance() {
        let turn = DAffine3::from_quat(glam::DQuat::from_euler(glam::EulerRot::XYZ, 0.3, 1.0, -0.4));
        let e = Environment::new(picture(), Rgb::splat(2.0), &turn).unwrap();
        let sample = |r: &mut translume_core::rng::Pcg32| {
            let s = e.sample(Vec2::new(r.next_f32(), r.next_f32()))?;
            let (radiance, pdf) = e.eval_pdf(s.wi);
            assert!((radiance - s.radiance).abs().max_element() < 0.02, "{radiance} {}", s.radiance);
            // At the borders of cells rounding may choose the neighbour.
            if (pdf - s.pdf_w).abs() > 0.01 * s.pdf_w {
                let nudged = e.eval_pdf((s.wi + Vec3::splat(1e-4)).normalize()).1;
                let other = e.eval_pdf((s.wi - Vec3::splat(1e-4)).normalize()).1;
                assert!([nudged, other].iter().any(|p| (p - s.pdf_w).abs() < 0.02 * s.pdf_w), "{pdf} {}", s.pdf_w);
            }
            Some(s.wi)
        };
        SphereTest::default().run("environment", sample, |w| e.eval_pdf(w).1, 1).unwrap();
    }

    /// One pixel may be as bright as numbers go, and the rest is seen all the same.
    #[test]
    fn the_brightest_pixel_does_not_put_the_light_out() {
        let mut image = picture().pixels.clone();
        image.get_pixel_mut(5, 3).0 = [3.3e38; 3];
        let e = Environment::new(Arc::new(Picture::new(image)), Rgb::ONE, &DAffine3::IDENTITY).unwrap();
        assert!(e.mean_luminance().is_finite() && e.mean_luminance() > 1e36);
        let sample = e.sample(Vec2::splat(0.5)).unwrap();
        assert!(sample.radiance.x > 1e30 && sample.pdf_w.is_finite() && sample.pdf_w > 0.0, "{sample:?}");
    }

    #[test]
    fn directions_map_to_the_picture() {
        // One bright column: the one that the front page's formula names.
        let mut pixels = translume_image::Rgb32FImage::new(16, 9);
        (0..9).for_each(|y| pixels.get_pixel_mut(3, y).0 = [1.0; 3]);
        let e = Environment::new(Arc::new(Picture::new(pixels)), Rgb::ONE, &DAffine3::IDENTITY).unwrap();
        let phi = TAU * 3.5 / 16.0;
        let d = Vec3::new(phi.sin(), 0.2, -phi.cos());
        assert!((e.eval_pdf(d).0.x - 1.0).abs() < 1e-3);
        assert!(e.eval_pdf(-d).0.x < 1e-6);
    }
}
