//! Smooth plastic: a clear coat over a diffuse base with all inner reflections, on the side of the normal.
//!
//! Source: the coat after Fresnel's equations; light that enters is scattered diffusely, and reflected inside with the diffuse
//! reflectance of the interface, a geometric series. Limits: the base does not see the direction of refraction.

use crate::{Flags, Rgb, Sample, fresnel};
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;
use translume_core::warp;

/// Parameters of smooth plastic.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plastic {
    /// Index of the plastic over that of the medium in front.
    eta: f32,
    /// Albedo of the base.
    pub diffuse_reflectance: Rgb,
    /// Artistic factor of the coat's reflection, 1 for physics.
    pub specular_reflectance: Rgb,
    /// Whether the inner reflections take the colour of the base at each bounce, which saturates it.
    pub nonlinear: bool,
    /// [`fresnel::diffuse_reflectance`] of 1/eta; goes with `eta`, so that both are set by [`Plastic::new`] only.
    fdr_int: f32,
}

impl Default for Plastic {
    fn default() -> Self {
        Self::new(crate::POLYPROPYLENE / crate::AIR, Rgb::splat(0.5), Rgb::ONE, false)
    }
}

impl Plastic {
    /// Plastic of relative index `eta`; the other arguments as the fields.
    pub fn new(eta: f32, diffuse_reflectance: Rgb, specular_reflectance: Rgb, nonlinear: bool) -> Self {
        let fdr_int = fresnel::diffuse_reflectance(1.0 / eta);
        Self { eta, diffuse_reflectance, specular_reflectance, nonlinear, fdr_int }
    }

    pub(crate) const FLAGS: Flags = Flags::REFLECTION.or(Flags::DIFFUSE).or(Flags::DELTA);
    const DIFFUSE: Flags = Flags::REFLECTION.or(Flags::DIFFUSE);

    #[inline]
    pub(crate) fn eval_pdf(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return (Rgb::ZERO, 0.0);
        }
        let t_o = 1.0 - fresnel::dielectric(wo.z, self.eta).reflectance;
        let pdf = (1.0 - self.specular_probability(1.0 - t_o)) * warp::cosine_hemisphere_pdf(wi);
        (self.base(t_o, wi), pdf)
    }

    #[inline]
    pub(crate) fn sample(&self, wo: Vec3, u_lobe: f32, u: Vec2) -> Option<Sample> {
        if wo.z <= 0.0 {
            return None;
        }
        let r = fresnel::dielectric(wo.z, self.eta).reflectance;
        let specular = self.specular_probability(r);
        if u_lobe < specular {
            return Some(Sample {
                wi: Vec3::new(-wo.x, -wo.y, wo.z),
                weight: self.specular_reflectance * (r / specular),
                pdf_w: specular,
                flags: Flags::REFLECTION.or(Flags::DELTA),
                eta: 1.0,
            });
        }
        let wi = warp::cosine_hemisphere(u.x, u.y);
        let pdf_w = (1.0 - specular) * warp::cosine_hemisphere_pdf(wi);
        let weight = self.base(1.0 - r, wi) * (wi.z / pdf_w);
        (pdf_w > 0.0).then_some(Sample { wi, weight, pdf_w, flags: Self::DIFFUSE, eta: 1.0 })
    }

    /// The base seen through the coat that lets `t_o` of the light out.
    #[inline]
    fn base(&self, t_o: f32, wi: Vec3) -> Rgb {
        let t_i = 1.0 - fresnel::dielectric(wi.z, self.eta).reflectance;
        base_albedo(self.diffuse_reflectance, self.fdr_int, self.nonlinear)
            * (FRAC_1_PI * t_i * t_o / (self.eta * self.eta))
    }

    #[inline]
    fn specular_probability(&self, r: f32) -> f32 {
        lobe_probability(r, self.specular_reflectance, self.diffuse_reflectance)
    }
}

/// The base with the inner reflections summed.
#[inline]
pub(crate) fn base_albedo(reflectance: Rgb, inner: f32, nonlinear: bool) -> Rgb {
    if nonlinear { reflectance / (Rgb::ONE - reflectance * inner) } else { reflectance / (1.0 - inner) }
}

/// Chance of choosing the coat, which reflects `r`: by power, as far as it is known before sampling.
#[inline]
pub(crate) fn lobe_probability(r: f32, specular: Rgb, diffuse: Rgb) -> f32 {
    let (s, d) = (r * specular.element_sum(), (1.0 - r) * diffuse.element_sum());
    if s + d > 0.0 { s / (s + d) } else { 1.0 }
}
