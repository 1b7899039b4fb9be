//! Metals, smooth and rough, on the side of the normal.
//!
//! Source: Walter et al. 2007 with Fresnel's equations for a complex index per channel. Limits: single scattering, so a rough
//! metal loses energy.

use crate::{Flags, Microfacets, Rgb, Sample, fresnel, microfacet::Distribution};
use glam::{Vec2, Vec3};

/// Parameters of a smooth metal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conductor {
    /// Real part of the index over that of the medium in front.
    pub eta: Rgb,
    /// Imaginary part over the same index.
    pub k: Rgb,
    /// Artistic factor, 1 for physics.
    pub specular_reflectance: Rgb,
}

impl Default for Conductor {
    /// A perfect mirror.
    fn default() -> Self {
        Self { eta: Rgb::ZERO, k: Rgb::ONE, specular_reflectance: Rgb::ONE }
    }
}

impl Conductor {
    pub(crate) const FLAGS: Flags = Flags::REFLECTION.or(Flags::DELTA);

    #[inline]
    pub(crate) fn fresnel(&self, cos: f32) -> Rgb {
        fresnel::conductor(cos, self.eta, self.k) * self.specular_reflectance
    }

    #[inline]
    pub(crate) fn sample(&self, wo: Vec3) -> Option<Sample> {
        let wi = Vec3::new(-wo.x, -wo.y, wo.z);
        (wo.z > 0.0).then(|| Sample { wi, weight: self.fresnel(wo.z), pdf_w: 1.0, flags: Self::FLAGS, eta: 1.0 })
    }
}

/// Parameters of a rough metal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoughConductor {
    /// The metal.
    pub metal: Conductor,
    /// Its roughness.
    pub microfacets: Microfacets,
}

impl Default for RoughConductor {
    fn default() -> Self {
        Self { metal: Conductor::default(), microfacets: Microfacets::new(Distribution::Beckmann, 0.1, 0.1) }
    }
}

impl RoughConductor {
    pub(crate) const FLAGS: Flags = Flags::REFLECTION.or(Flags::GLOSSY);

    #[inline]
    pub(crate) fn eval_pdf(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return (Rgb::ZERO, 0.0);
        }
        let m = (wo + wi).normalize();
        let cos = wo.dot(m);
        let d = self.microfacets.d(m);
        if d == 0.0 || cos <= 0.0 {
            return (Rgb::ZERO, 0.0);
        }
        let g1 = self.microfacets.g1(wo, m);
        let f = self.metal.fresnel(cos) * (d * g1 * self.microfacets.g1(wi, m) / (4.0 * wo.z * wi.z));
        let pdf = if self.microfacets.visible { d * g1 / (4.0 * wo.z) } else { d * m.z / (4.0 * cos) };
        (f, pdf)
    }

    #[inline]
    pub(crate) fn sample(&self, wo: Vec3, u: Vec2) -> Option<Sample> {
        if wo.z <= 0.0 {
            return None;
        }
        let m = self.microfacets.sample(wo, u);
        let cos = wo.dot(m);
        let wi = fresnel::reflect(wo, m);
        let pdf_w = self.microfacets.pdf(wo, m) / (4.0 * cos);
        if wi.z <= 0.0 || cos <= 0.0 || pdf_w.is_nan() || pdf_w <= 0.0 {
            return None;
        }
        let mut weight = self.metal.fresnel(cos) * self.microfacets.g1(wi, m);
        if !self.microfacets.visible {
            weight *= self.microfacets.g1(wo, m) * cos / (wo.z * m.z);
        }
        Some(Sample { wi, weight, pdf_w, flags: Self::FLAGS, eta: 1.0 })
    }
}
