//! Rough glass: reflection and refraction at microfacets, from either side.
//!
//! Source: Walter et al. 2007, Eqs. 16–21; radiance is scaled by 1/η² as Veach 1997 §5.2 asks. Limits: single scattering.

use crate::{Flags, Microfacets, Mode, Rgb, Sample, fresnel, microfacet::Distribution};
use glam::{Vec2, Vec3};

/// Parameters of a rough interface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoughDielectric {
    /// Index behind the surface (against the normal) over the index in front; not 1.
    pub eta: f32,
    /// Its roughness.
    pub microfacets: Microfacets,
    /// Artistic factor of the reflection, 1 for physics.
    pub specular_reflectance: Rgb,
    /// Artistic factor of the refraction, 1 for physics.
    pub specular_transmittance: Rgb,
}

impl Default for RoughDielectric {
    fn default() -> Self {
        Self {
            eta: crate::BK7 / crate::AIR,
            microfacets: Microfacets::new(Distribution::Beckmann, 0.1, 0.1),
            specular_reflectance: Rgb::ONE,
            specular_transmittance: Rgb::ONE,
        }
    }
}

impl RoughDielectric {
    pub(crate) const FLAGS: Flags = Flags::REFLECTION.or(Flags::TRANSMISSION).or(Flags::GLOSSY);

    pub(crate) fn eval_pdf(&self, wo: Vec3, wi: Vec3, mode: Mode) -> (Rgb, f32) {
        let (cos_o, cos_i) = (wo.z, wi.z);
        if (cos_o * cos_i).abs() < 1e-20 {
            return (Rgb::ZERO, 0.0);
        }
        let is_reflection = cos_o * cos_i > 0.0;
        // Index on the side of wi over the side of wo, for refraction.
        let eta = if cos_o > 0.0 { self.eta } else { 1.0 / self.eta };
        let m = wo + wi * if is_reflection { 1.0 } else { eta };
        let m = m.normalize_or_zero();
        let m = if m.z < 0.0 { -m } else { m };
        let (dot_o, dot_i) = (wo.dot(m), wi.dot(m));
        let d = self.microfacets.d(m);
        if d == 0.0 || dot_o * cos_o <= 0.0 || dot_i * cos_i <= 0.0 {
            return (Rgb::ZERO, 0.0);
        }
        let g = self.microfacets.g1(wo, m) * self.microfacets.g1(wi, m);
        let r = fresnel::dielectric(dot_o, self.eta).reflectance;
        let normal_pdf = self.sampled(cos_o).pdf(upward(wo), m);
        if is_reflection {
            let f = self.specular_reflectance * (r * d * g / (4.0 * cos_o * cos_i));
            return (f, r * normal_pdf / (4.0 * dot_i.abs()));
        }
        // [Walter et al. 2007, Eq. 17]: dm/dwi = η²|wi·m|/(wo·m + η wi·m)².
        let sum = dot_o + eta * dot_i;
        let jacobian = eta * eta * dot_i.abs() / (sum * sum);
        let scale = if mode == Mode::Radiance { 1.0 / (eta * eta) } else { 1.0 };
        let f = (1.0 - r) * d * g * jacobian * scale * (dot_o / (cos_o * cos_i)).abs();
        (self.specular_transmittance * f, (1.0 - r) * normal_pdf * jacobian)
    }

    pub(crate) fn sample(&self, wo: Vec3, u_lobe: f32, u: Vec2, mode: Mode) -> Option<Sample> {
        if wo.z == 0.0 {
            return None;
        }
        let up = upward(wo);
        let sampled = self.sampled(wo.z);
        let m = sampled.sample(up, u);
        let normal_pdf = sampled.pdf(up, m);
        if normal_pdf.is_nan() || normal_pdf <= 0.0 {
            return None;
        }
        let dot_o = wo.dot(m);
        if dot_o * wo.z <= 0.0 {
            return None; // The back of a facet, which only sampling of all normals yields.
        }
        let interface = fresnel::dielectric(dot_o, self.eta);
        let r = interface.reflectance;
        let (wi, tint, pdf_w, flags, eta) = if u_lobe < r || r == 1.0 {
            let wi = fresnel::reflect(wo, m);
            let pdf_w = r * normal_pdf / (4.0 * wi.dot(m).abs());
            (wi, self.specular_reflectance, pdf_w, Flags::REFLECTION.or(Flags::GLOSSY), 1.0)
        } else {
            let wi = fresnel::refract(wo, m, &interface);
            let eta = interface.eta_it;
            let sum = dot_o + eta * wi.dot(m);
            let pdf_w = (1.0 - r) * normal_pdf * eta * eta * wi.dot(m).abs() / (sum * sum);
            let scale = if mode == Mode::Radiance { interface.eta_ti * interface.eta_ti } else { 1.0 };
            (wi, self.specular_transmittance * scale, pdf_w, Flags::TRANSMISSION.or(Flags::GLOSSY), eta)
        };
        let side = if flags.contains(Flags::REFLECTION) { wo.z } else { -wo.z };
        if side * wi.z <= 0.0 || wi.dot(m) * wi.z <= 0.0 || pdf_w.is_nan() || pdf_w <= 0.0 {
            return None;
        }
        let mut weight = tint * self.microfacets.g1(wi, m);
        if !self.microfacets.visible {
            weight *= self.microfacets.g1(wo, m) * self.microfacets.d(m) * dot_o.abs() / (wo.z.abs() * normal_pdf);
        }
        Some(Sample { wi, weight, pdf_w, flags, eta })
    }

    /// The distribution that normals are drawn from: without visible-normal sampling it is widened towards grazing angles
    /// to bound the weights [Walter et al. 2007, §5.3].
    #[inline]
    fn sampled(&self, cos_o: f32) -> Microfacets {
        let mut sampled = self.microfacets;
        if !sampled.visible {
            let scale = 1.2 - 0.2 * cos_o.abs().sqrt();
            sampled.alpha_u *= scale;
            sampled.alpha_v *= scale;
        }
        sampled
    }
}

#[inline]
fn upward(w: Vec3) -> Vec3 {
    if w.z < 0.0 { -w } else { w }
}
