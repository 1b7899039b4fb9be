//! Rough plastic: a rough clear coat over a diffuse base with all inner reflections, on the side of the normal.
//!
//! Source: the coat after Walter et al. 2007; what it lets through and reflects inside is integrated over the visible
//! normals once per roughness and index. Deviation: the inner reflectance is averaged as Mitsuba 3 does it, over 64 equally
//! weighted cosines with both ends, which comes out 1.5 % low; pictures are compared with its pictures.

use crate::{
    Distribution, Flags, Microfacets, Rgb, Sample, fresnel,
    plastic::{base_albedo, lobe_probability},
};
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;
use translume_core::{special::gauss_legendre, warp};

const RESOLUTION: usize = 64;

/// The rough coat: its microfacets and what they let through. One per material, shared by all its shading points.
#[derive(Clone, Debug, PartialEq)]
pub struct Coat {
    microfacets: Microfacets,
    eta: f32,
    /// Fraction refracted inwards, for RESOLUTION cosines from 0 to 1.
    transmittance: [f32; RESOLUTION],
    /// Fraction of diffuse light from below that is reflected back down.
    inner_reflectance: f32,
}

impl Coat {
    /// Tabulates a coat of relative index `eta` (takes some milliseconds).
    pub fn new(distribution: Distribution, alpha: f32, eta: f32) -> Self {
        let microfacets = Microfacets::new(distribution, alpha, alpha);
        let cosine = |i: usize| (i as f32 / (RESOLUTION - 1) as f32).max(1e-6);
        // Total reflection inside has an edge that asks for more nodes.
        let (outer, inner) = (gauss_legendre(48), gauss_legendre(96));
        let transmittance = std::array::from_fn(|i| transported(&microfacets, cosine(i), eta, &outer, false));
        let reflected =
            (0..RESOLUTION).map(|i| transported(&microfacets, cosine(i), 1.0 / eta, &inner, true) * cosine(i));
        let inner_reflectance = 2.0 * reflected.sum::<f32>() / RESOLUTION as f32;
        Self { microfacets, eta, transmittance, inner_reflectance }
    }

    /// The same coat, but sampled by all normals instead of the visible ones.
    pub fn with_visible_normals(mut self, visible: bool) -> Self {
        self.microfacets.visible = visible;
        self
    }

    /// The fraction of light from the cosine `cos` that is let through.
    #[inline]
    pub(crate) fn transmittance(&self, cos: f32) -> f32 {
        let x = cos * (RESOLUTION - 1) as f32;
        let i = (x as usize).min(RESOLUTION - 2);
        let (a, b) = (self.transmittance[i], self.transmittance[i + 1]);
        a + (b - a) * (x - i as f32)
    }

    /// The reflection alone, for directions above: value without the cosine, and density of
    /// [`Coat::sample_reflection`].
    #[inline]
    pub(crate) fn reflection(&self, wo: Vec3, wi: Vec3) -> (f32, f32) {
        let microfacets = &self.microfacets;
        let m = (wo + wi).normalize();
        let cos = wo.dot(m);
        let (d, g_o) = (microfacets.d(m), microfacets.g1(wo, m));
        let r = fresnel::dielectric(cos, self.eta).reflectance;
        let pdf_w = if microfacets.visible { d * g_o / (4.0 * wo.z) } else { d * m.z / (4.0 * cos) };
        (r * d * g_o * microfacets.g1(wi, m) / (4.0 * wo.z * wi.z), pdf_w)
    }

    #[inline]
    pub(crate) fn sample_reflection(&self, wo: Vec3, u: Vec2) -> Vec3 {
        fresnel::reflect(wo, self.microfacets.sample(wo, u))
    }
}

/// Fraction of light from the cosine `cos` that microfacets of relative index `eta` reflect (or let through): the weights of
/// visible-normal sampling averaged over the unit square.
pub(crate) fn transported(microfacets: &Microfacets, cos: f32, eta: f32, rule: &[(f32, f32)], reflected: bool) -> f32 {
    let wo = Vec3::new((1.0 - cos * cos).max(0.0).sqrt(), 0.0, cos);
    let mut sum = 0.0;
    for &(x, weight_x) in rule {
        for &(y, weight_y) in rule {
            let m = microfacets.sample(wo, Vec2::new(x, y));
            let interface = fresnel::dielectric(wo.dot(m), eta);
            let r = interface.reflectance;
            let (wi, share) =
                if reflected { (fresnel::reflect(wo, m), r) } else { (fresnel::refract(wo, m, &interface), 1.0 - r) };
            if (wi.z > 0.0) == reflected && wi.z != 0.0 && share > 0.0 {
                sum += share * microfacets.g1(wi, m) * weight_x * weight_y;
            }
        }
    }
    sum
}

/// Parameters of rough plastic.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoughPlastic<'a> {
    /// The coat.
    pub coat: &'a Coat,
    /// Albedo of the base.
    pub diffuse_reflectance: Rgb,
    /// Artistic factor of the coat's reflection, 1 for physics.
    pub specular_reflectance: Rgb,
    /// Whether the inner reflections take the colour of the base at each bounce, which saturates it.
    pub nonlinear: bool,
}

impl<'a> RoughPlastic<'a> {
    /// A grey base of albedo 0.5, linear, under `coat`.
    pub fn new(coat: &'a Coat) -> Self {
        Self { coat, diffuse_reflectance: Rgb::splat(0.5), specular_reflectance: Rgb::ONE, nonlinear: false }
    }

    pub(crate) const FLAGS: Flags = Flags::REFLECTION.or(Flags::DIFFUSE).or(Flags::GLOSSY);

    #[inline]
    pub(crate) fn eval_pdf(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return (Rgb::ZERO, 0.0);
        }
        let t_o = self.coat.transmittance(wo.z);
        self.eval_pdf_given(
            wo,
            wi,
            t_o,
            lobe_probability(1.0 - t_o, self.specular_reflectance, self.diffuse_reflectance),
        )
    }

    #[inline]
    fn eval_pdf_given(&self, wo: Vec3, wi: Vec3, t_o: f32, specular: f32) -> (Rgb, f32) {
        let eta = self.coat.eta;
        let (coat, coat_pdf) = self.coat.reflection(wo, wi);
        let t_i = self.coat.transmittance(wi.z);
        let base = base_albedo(self.diffuse_reflectance, self.coat.inner_reflectance, self.nonlinear)
            * (FRAC_1_PI * t_i * t_o / (eta * eta));
        let pdf = specular * coat_pdf + (1.0 - specular) * warp::cosine_hemisphere_pdf(wi);
        (self.specular_reflectance * coat + base, pdf)
    }

    #[inline]
    pub(crate) fn sample(&self, wo: Vec3, u_lobe: f32, u: Vec2) -> Option<Sample> {
        if wo.z <= 0.0 {
            return None;
        }
        let t_o = self.coat.transmittance(wo.z);
        let specular = lobe_probability(1.0 - t_o, self.specular_reflectance, self.diffuse_reflectance);
        let (wi, lobe) = if u_lobe < specular {
            (self.coat.sample_reflection(wo, u), Flags::GLOSSY)
        } else {
            (warp::cosine_hemisphere(u.x, u.y), Flags::DIFFUSE)
        };
        if wi.z <= 0.0 {
            return None;
        }
        let (f, pdf_w) = self.eval_pdf_given(wo, wi, t_o, specular);
        let flags = Flags::REFLECTION.or(lobe);
        (pdf_w > 0.0).then(|| Sample { wi, weight: f * (wi.z / pdf_w), pdf_w, flags, eta: 1.0 })
    }
}
