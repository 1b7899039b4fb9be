//! Clear glass: an interface of two media, and a thin pane with all its inner reflections.
//!
//! Source: Fresnel's equations; the pane sums R + T R T + T R³ T + … = 2R/(1 + R) and does not bend the ray.

use crate::{Flags, Mode, Rgb, Sample, fresnel};
use glam::Vec3;

/// Parameters of a smooth interface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dielectric {
    /// Index behind the surface (against the normal) over the index in front.
    pub eta: f32,
    /// Artistic factor of the reflection, 1 for physics.
    pub specular_reflectance: Rgb,
    /// Artistic factor of the refraction, 1 for physics.
    pub specular_transmittance: Rgb,
}

impl Default for Dielectric {
    fn default() -> Self {
        Self { eta: crate::BK7 / crate::AIR, specular_reflectance: Rgb::ONE, specular_transmittance: Rgb::ONE }
    }
}

impl Dielectric {
    pub(crate) const FLAGS: Flags = Flags::REFLECTION.or(Flags::TRANSMISSION).or(Flags::DELTA);

    #[inline]
    pub(crate) fn sample(&self, wo: Vec3, u_lobe: f32, mode: Mode) -> Option<Sample> {
        let interface = fresnel::dielectric(wo.z, self.eta);
        let r = interface.reflectance;
        if u_lobe < r || r == 1.0 {
            return Some(mirror(wo, r, self.specular_reflectance));
        }
        let factor = if mode == Mode::Radiance { interface.eta_ti * interface.eta_ti } else { 1.0 };
        Some(Sample {
            wi: fresnel::refract(wo, Vec3::Z, &interface),
            weight: self.specular_transmittance * factor,
            pdf_w: 1.0 - r,
            flags: Flags::TRANSMISSION.or(Flags::DELTA),
            eta: interface.eta_it,
        })
    }
}

/// Parameters of a thin pane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThinDielectric {
    /// Index of the pane over that of the medium around it.
    pub eta: f32,
    /// Artistic factor of the reflection, 1 for physics.
    pub specular_reflectance: Rgb,
    /// Artistic factor of what passes, 1 for physics.
    pub specular_transmittance: Rgb,
}

impl Default for ThinDielectric {
    fn default() -> Self {
        let Dielectric { eta, specular_reflectance, specular_transmittance } = Dielectric::default();
        Self { eta, specular_reflectance, specular_transmittance }
    }
}

impl ThinDielectric {
    pub(crate) const FLAGS: Flags = Dielectric::FLAGS.or(Flags::NULL);

    /// Reflected fraction.
    #[inline]
    pub(crate) fn reflectance(&self, wo: Vec3) -> f32 {
        let r = fresnel::dielectric(wo.z.abs(), self.eta).reflectance;
        2.0 * r / (1.0 + r)
    }

    #[inline]
    pub(crate) fn sample(&self, wo: Vec3, u_lobe: f32) -> Option<Sample> {
        let r = self.reflectance(wo);
        if u_lobe < r || r == 1.0 {
            return Some(mirror(wo, r, self.specular_reflectance));
        }
        Some(Sample::pass_through(wo, self.specular_transmittance, 1.0 - r))
    }
}

#[inline]
fn mirror(wo: Vec3, probability: f32, weight: Rgb) -> Sample {
    let flags = Flags::REFLECTION.or(Flags::DELTA);
    Sample { wi: Vec3::new(-wo.x, -wo.y, wo.z), weight, pdf_w: probability, flags, eta: 1.0 }
}
