//! The boundary of a translucent object, smooth or rough, from outside.
//!
//! [`Skin`] is what a ray meets there: Fresnel's reflection, and the chance of going under the surface, told by
//! [`Flags::SUBSURFACE`]. [`Entrance`] is the place where the light went in that comes out elsewhere: F_t(ω_i)/π, alike for all
//! directions below. Neither knows how light spreads in between: that is a [`crate::bssrdf::Bssrdf`]'s.

use crate::{Coat, Flags, Rgb, Sample, fresnel, plastic::lobe_probability};
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;
use translume_core::warp;

/// What is above a translucent object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Skin<'a> {
    /// Index of refraction, inside over outside.
    pub eta: f32,
    /// Its microfacets; `None`: smooth.
    pub coat: Option<&'a Coat>,
    /// Artistic factor of the reflection, 1 for physics.
    pub specular_reflectance: Rgb,
    /// About what comes back from below, for choosing and for feature images.
    pub albedo: Rgb,
}

/// Where light enters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entrance<'a> {
    /// Index of refraction, inside over outside.
    pub eta: f32,
    /// Microfacets of the boundary; `None`: smooth.
    pub coat: Option<&'a Coat>,
}

/// The fraction of light at this cosine that the boundary lets through.
#[inline]
fn transmittance(cos: f32, eta: f32, coat: Option<&Coat>) -> f32 {
    match coat {
        Some(coat) => coat.transmittance(cos),
        None => 1.0 - fresnel::dielectric(cos, eta).reflectance,
    }
}

impl Skin<'_> {
    pub(crate) fn flags(&self) -> Flags {
        let lobe = if self.coat.is_some() { Flags::GLOSSY } else { Flags::DELTA };
        Flags::REFLECTION.or(lobe).or(Flags::SUBSURFACE)
    }

    /// The light that enters, and the chance of choosing the reflection.
    #[inline]
    fn shares(&self, cos: f32) -> (f32, f32) {
        let t = transmittance(cos, self.eta, self.coat);
        (t, lobe_probability(1.0 - t, self.specular_reflectance, self.albedo.max(Rgb::splat(0.05))))
    }

    #[inline]
    pub(crate) fn eval_pdf(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        let Some(coat) = self.coat.filter(|_| wo.z > 0.0 && wi.z > 0.0) else { return (Rgb::ZERO, 0.0) };
        let (f, pdf_w) = coat.reflection(wo, wi);
        (self.specular_reflectance * f, pdf_w * self.shares(wo.z).1)
    }

    #[inline]
    pub(crate) fn sample(&self, wo: Vec3, u_lobe: f32, u: Vec2) -> Option<Sample> {
        if wo.z <= 0.0 {
            return None;
        }
        let (t, specular) = self.shares(wo.z);
        if u_lobe >= specular {
            let weight = Rgb::splat(t / (1.0 - specular));
            return Some(Sample { wi: Vec3::NEG_Z, weight, pdf_w: 1.0 - specular, flags: Flags::SUBSURFACE, eta: 1.0 });
        }
        let Some(coat) = self.coat else {
            let wi = fresnel::reflect(wo, Vec3::Z);
            let weight = self.specular_reflectance * ((1.0 - t) / specular);
            let flags = Flags::REFLECTION.or(Flags::DELTA);
            return Some(Sample { wi, weight, pdf_w: specular, flags, eta: 1.0 });
        };
        let wi = coat.sample_reflection(wo, u);
        let (f, pdf_w) = self.eval_pdf(wo, wi);
        let flags = Flags::REFLECTION.or(Flags::GLOSSY);
        (wi.z > 0.0 && pdf_w > 0.0).then(|| Sample { wi, weight: f * (wi.z / pdf_w), pdf_w, flags, eta: 1.0 })
    }
}

impl Entrance<'_> {
    pub(crate) const FLAGS: Flags = Flags::REFLECTION.or(Flags::DIFFUSE);

    #[inline]
    pub(crate) fn eval_pdf(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return (Rgb::ZERO, 0.0);
        }
        let f = transmittance(wi.z, self.eta, self.coat) * FRAC_1_PI;
        (Rgb::splat(f), warp::cosine_hemisphere_pdf(wi))
    }

    #[inline]
    pub(crate) fn sample(&self, wo: Vec3, u: Vec2) -> Option<Sample> {
        let wi = warp::cosine_hemisphere(u.x, u.y);
        let pdf_w = warp::cosine_hemisphere_pdf(wi);
        let weight = Rgb::splat(transmittance(wi.z, self.eta, self.coat));
        (wo.z > 0.0 && pdf_w > 0.0).then_some(Sample { wi, weight, pdf_w, flags: Self::FLAGS, eta: 1.0 })
    }
}
