//! Lambert's reflector, on the side of the normal.

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
