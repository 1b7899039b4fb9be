//! Microfacet normal distributions: GGX (Trowbridge & Reitz) and Beckmann, anisotropic.
//!
//! Sources: Walter et al. 2007; Heitz 2014 (masking); visible normals of GGX by spherical caps, Dupuy & Benyoub 2023;
//! visible normals of Beckmann by the numerical inversion of Jakob 2014 in the erf domain. Deviations: masking is Smith's
//! separable G = G1·G1, and Beckmann's G1 is Walter's rational fit (0.35 %), as in the renderers that pictures are
//! compared with. Limits: roughness below 10⁻⁴ is taken as 10⁻⁴.

use glam::{Vec2, Vec3};
use std::f32::consts::{PI, TAU};
use translume_core::special::{erf, erf_inv};

const INV_SQRT_PI: f32 = 0.564_189_6;

/// Shape of the distribution of slopes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Distribution {
    /// Gaussian slopes.
    Beckmann,
    /// Long-tailed slopes.
    Ggx,
}

/// A distribution of microfacet normals about z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Microfacets {
    /// Shape.
    pub distribution: Distribution,
    /// Root mean square slope along x (times √2 for Beckmann).
    pub alpha_u: f32,
    /// The same along y.
    pub alpha_v: f32,
    /// Whether [`Microfacets::sample`] draws only normals that can be seen, the better way.
    pub visible: bool,
}

impl Microfacets {
    /// Visible-normal sampling.
    #[inline]
    pub fn new(distribution: Distribution, alpha_u: f32, alpha_v: f32) -> Self {
        Self { distribution, alpha_u: alpha_u.max(1e-4), alpha_v: alpha_v.max(1e-4), visible: true }
    }

    /// Density of normals D(m) per solid angle and projected area: ∫ D(m) m.z dm = 1. Zero where it is negligible.
    #[inline]
    pub fn d(&self, m: Vec3) -> f32 {
        let slopes = Vec2::new(m.x / self.alpha_u, m.y / self.alpha_v).length_squared();
        let z2 = m.z * m.z;
        let d = match self.distribution {
            Distribution::Beckmann => (-slopes / z2).exp() / (PI * self.alpha_u * self.alpha_v * z2 * z2),
            Distribution::Ggx => {
                let s = slopes + z2;
                1.0 / (PI * self.alpha_u * self.alpha_v * s * s)
            }
        };
        if d * m.z > 1e-20 { d } else { 0.0 }
    }

    /// Smith's masking: the visible fraction of facets of normal m from w; zero when w sees the facet and the surface from
    /// different sides.
    #[inline]
    pub fn g1(&self, w: Vec3, m: Vec3) -> f32 {
        if w.dot(m) * w.z <= 0.0 {
            return 0.0;
        }
        let slope2 = Vec2::new(self.alpha_u * w.x, self.alpha_v * w.y).length_squared();
        if slope2 == 0.0 {
            return 1.0;
        }
        let tan2 = slope2 / (w.z * w.z);
        match self.distribution {
            Distribution::Ggx => 2.0 / (1.0 + (1.0 + tan2).sqrt()),
            Distribution::Beckmann => {
                let a = 1.0 / tan2.sqrt();
                if a >= 1.6 { 1.0 } else { (3.535 + 2.181 * a) * a / (1.0 + (2.276 + 2.577 * a) * a) }
            }
        }
    }

    /// Density of [`Microfacets::sample`] per solid angle of m, for w.z > 0.
    #[inline]
    pub fn pdf(&self, w: Vec3, m: Vec3) -> f32 {
        if self.visible { self.d(m) * self.g1(w, m) * w.dot(m).abs() / w.z } else { self.d(m) * m.z }
    }

    /// Draws a normal for w.z > 0; its density is [`Microfacets::pdf`].
    #[inline]
    pub fn sample(&self, w: Vec3, u: Vec2) -> Vec3 {
        match (self.visible, self.distribution) {
            (false, _) => self.sample_all(u),
            (true, Distribution::Ggx) => self.sample_visible_ggx(w, u),
            (true, Distribution::Beckmann) => self.sample_visible_beckmann(w, u),
        }
    }

    /// [Walter et al. 2007, Eqs. 28, 35], with the azimuth of the anisotropic form.
    fn sample_all(&self, u: Vec2) -> Vec3 {
        let (sin, cos) = (TAU * u.y).sin_cos();
        // Slopes of the unit distribution stretched: tan² θ is exponential (Beckmann) or x/(1−x) (GGX).
        let tan = match self.distribution {
            Distribution::Beckmann => (-(1.0 - u.x).ln()).sqrt(),
            Distribution::Ggx => (u.x / (1.0 - u.x)).sqrt(),
        };
        Vec3::new(self.alpha_u * tan * cos, self.alpha_v * tan * sin, 1.0).normalize()
    }

    /// [Dupuy & Benyoub 2023, Listing 3]: the facets seen by w are, in the stretched space, halfway between w and a
    /// uniform point of a spherical cap.
    #[inline]
    fn sample_visible_ggx(&self, w: Vec3, u: Vec2) -> Vec3 {
        let w = Vec3::new(self.alpha_u * w.x, self.alpha_v * w.y, w.z).normalize();
        let z = (1.0 - u.y) * (1.0 + w.z) - w.z;
        let r = (1.0 - z * z).max(0.0).sqrt();
        let (sin, cos) = (TAU * u.x).sin_cos();
        let h = Vec3::new(r * cos, r * sin, z) + w;
        Vec3::new(self.alpha_u * h.x, self.alpha_v * h.y, h.z.max(0.0)).normalize_or(Vec3::Z)
    }

    /// [Jakob 2014]: inverts the distribution of slopes seen from the angle of w, in the variable erf(slope).
    fn sample_visible_beckmann(&self, w: Vec3, u: Vec2) -> Vec3 {
        let w = Vec3::new(self.alpha_u * w.x, self.alpha_v * w.y, w.z).normalize();
        let sin = w.truncate().length();
        let (cos_phi, sin_phi) = if sin > 0.0 { (w.x / sin, w.y / sin) } else { (1.0, 0.0) };
        let tan = sin / w.z;
        let along = visible_slope_beckmann(tan, u.x);
        let across = erf_inv((2.0 * u.y - 1.0).clamp(-0.999_999, 0.999_999));
        let slope_x = (cos_phi * along - sin_phi * across) * self.alpha_u;
        let slope_y = (sin_phi * along + cos_phi * across) * self.alpha_v;
        Vec3::new(-slope_x, -slope_y, 1.0).normalize()
    }
}

/// Slope along the viewing azimuth for a unit-roughness surface seen under the angle of tangent `tan`, by safeguarded
/// Newton steps on the CDF in x = erf(slope).
fn visible_slope_beckmann(tan: f32, u: f32) -> f32 {
    let u = u.clamp(1e-6, 1.0 - 1e-6);
    let cot = 1.0 / tan;
    let top = erf(cot);
    let total = 1.0 + top + INV_SQRT_PI * tan * (-cot * cot).exp();
    // The CDF rises from −1 to `top`; the first guess is exact for grazing views.
    let (mut lo, mut hi) = (-1.0f32, top);
    let mut x = (top - (top + 1.0) * erf((-u.ln()).sqrt())).clamp(-0.999_999, 0.999_999);
    let target = u * total;
    // Near the top the CDF is flat and Newton's steps halve the error only.
    for _ in 0..12 {
        let slope = erf_inv(x);
        let value = 1.0 + x + INV_SQRT_PI * tan * (-slope * slope).exp() - target;
        if value > 0.0 {
            hi = hi.min(x);
        } else {
            lo = lo.max(x);
        }
        let next = x - value / (1.0 - slope * tan);
        let next = if next >= lo && next <= hi { next } else { 0.5 * (lo + hi) }.clamp(-0.999_999, 0.999_999);
        let step = (next - x).abs();
        x = next;
        if step < 1e-5 {
            break;
        }
    }
    erf_inv(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use translume_core::special::gamma_q;

    #[test]
    fn visible_slopes_of_beckmann_invert_their_distribution() {
        let erf = |x: f64| (1.0 - gamma_q(0.5, x * x)).copysign(x);
        for tan in [1e-3f32, 0.1, 1.0, 3.0, 11.45, 60.0, 1e4] {
            let cdf = |s: f64| 1.0 + erf(s) + f64::from(tan) * (-s * s).exp() / std::f64::consts::PI.sqrt();
            let total = cdf(1.0 / f64::from(tan));
            for i in 0..2000 {
                let u = (i as f32 + 0.5) / 2000.0;
                let slope = visible_slope_beckmann(tan, u);
                assert!(slope <= 1.0 / tan + 1e-3, "{tan} {u} {slope}");
                let got = cdf(f64::from(slope)) / total;
                assert!((got - f64::from(u)).abs() < 2e-4, "{tan} {u}: {slope} {got}");
            }
        }
    }
}
