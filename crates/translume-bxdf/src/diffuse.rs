//! Ideal diffuse scattering: Lambert's reflector on the side of the normal, and a thin sheet that also lets light through.

use crate::{Flags, Rgb, Sample};
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;
use translume_core::warp;

/// Parameters of the ideal diffuse reflector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Diffuse {
    /// Albedo.
    pub reflectance: Rgb,
}

impl Default for Diffuse {
    fn default() -> Self {
        Self { reflectance: Rgb::splat(0.5) }
    }
}

impl Diffuse {
    pub(crate) const FLAGS: Flags = Flags::REFLECTION.or(Flags::DIFFUSE);

    #[inline]
    pub(crate) fn eval_pdf(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        if wo.z > 0.0 && wi.z > 0.0 {
            (self.reflectance * FRAC_1_PI, warp::cosine_hemisphere_pdf(wi))
        } else {
            (Rgb::ZERO, 0.0)
        }
    }

    #[inline]
    pub(crate) fn sample(&self, wo: Vec3, u: Vec2) -> Option<Sample> {
        if wo.z <= 0.0 {
            return None;
        }
        let wi = warp::cosine_hemisphere(u.x, u.y);
        let pdf_w = warp::cosine_hemisphere_pdf(wi);
        (pdf_w > 0.0).then_some(Sample { wi, weight: self.reflectance, pdf_w, flags: Self::FLAGS, eta: 1.0 })
    }
}

/// Parameters of a thin diffuse sheet, alike from both sides (paper, leaves, lampshades; glTF's diffuse transmission).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DiffuseSheet {
    /// Fraction scattered back.
    pub reflectance: Rgb,
    /// Fraction scattered through; with `reflectance` at most 1.
    pub transmittance: Rgb,
}

impl Default for DiffuseSheet {
    fn default() -> Self {
        Self { reflectance: Rgb::splat(0.25), transmittance: Rgb::splat(0.25) }
    }
}

impl DiffuseSheet {
    pub(crate) const FLAGS: Flags = Diffuse::FLAGS.or(Flags::TRANSMISSION);

    /// Chance of sampling the reflection.
    #[inline]
    fn reflected_share(&self) -> f32 {
        let (r, t) = (self.reflectance.element_sum(), self.transmittance.element_sum());
        if r + t > 0.0 { r / (r + t) } else { 1.0 }
    }

    #[inline]
    pub(crate) fn eval_pdf(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        let share = self.reflected_share();
        let (colour, share) =
            if wo.z * wi.z > 0.0 { (self.reflectance, share) } else { (self.transmittance, 1.0 - share) };
        (colour * FRAC_1_PI, share * wi.z.abs() * FRAC_1_PI)
    }

    #[inline]
    pub(crate) fn sample(&self, wo: Vec3, u_lobe: f32, u: Vec2) -> Option<Sample> {
        let share = self.reflected_share();
        let reflected = u_lobe < share;
        let mut wi = warp::cosine_hemisphere(u.x, u.y);
        if (wo.z < 0.0) == reflected {
            wi.z = -wi.z;
        }
        let (colour, share, side) = if reflected {
            (self.reflectance, share, Flags::REFLECTION)
        } else {
            (self.transmittance, 1.0 - share, Flags::TRANSMISSION)
        };
        let pdf_w = share * wi.z.abs() * FRAC_1_PI;
        let flags = side.or(Flags::DIFFUSE);
        (pdf_w > 0.0 && wo.z != 0.0).then(|| Sample { wi, weight: colour / share, pdf_w, flags, eta: 1.0 })
    }
}
