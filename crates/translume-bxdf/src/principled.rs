//! The principled model: one set of artist's parameters from plastics over metals to rough glass.
//!
//! Sources: Burley 2012 and 2015, with the parameters and the choices of Mitsuba 3's plugin of that name: GGX for the main
//! lobe with roughness squared, GTR1 for the clear coat, separable masking, no volumetric part. Deviation: light from
//! behind meets nothing where there is no transmission, in the density as well.

use crate::{Distribution, Flags, Microfacets, Mode, Rgb, Sample, fresnel};
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, PI, TAU};
use translume_core::warp;

/// Parameters; all but `eta` and the colour in [0, 1].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Principled {
    /// Colour of base, metal and (its root) of what passes through.
    pub base_color: Rgb,
    /// Square root of the GGX roughness.
    pub roughness: f32,
    /// Stretches highlights along the first tangent.
    pub anisotropic: f32,
    /// Blend from dielectric to metal.
    pub metallic: f32,
    /// Blend from diffuse base to refraction.
    pub spec_trans: f32,
    /// Index behind the surface over the index in front; see [`Principled::eta_from_specular`].
    pub eta: f32,
    /// Blend of the dielectric reflection towards the base colour.
    pub spec_tint: f32,
    /// Grazing retro-reflection of cloth.
    pub sheen: f32,
    /// Blend of the sheen towards the base colour.
    pub sheen_tint: f32,
    /// Blend of the diffuse base towards a flat subsurface look.
    pub flatness: f32,
    /// Strength of the clear coat.
    pub clearcoat: f32,
    /// Gloss of the clear coat.
    pub clearcoat_gloss: f32,
}

impl Default for Principled {
    fn default() -> Self {
        Self {
            base_color: Rgb::splat(0.5),
            roughness: 0.5,
            anisotropic: 0.0,
            metallic: 0.0,
            spec_trans: 0.0,
            eta: Self::eta_from_specular(0.5),
            spec_tint: 0.0,
            sheen: 0.0,
            sheen_tint: 0.0,
            flatness: 0.0,
            clearcoat: 0.0,
            clearcoat_gloss: 0.0,
        }
    }
}

/// Probabilities of the lobes; the main one is split by the Fresnel term at the microfacet.
struct Lobes {
    main: f32,
    coat: f32,
    diffuse: f32,
}

impl Principled {
    /// The index that reflects 8 % × `specular` at normal incidence.
    pub fn eta_from_specular(specular: f32) -> f32 {
        2.0 / (1.0 - (0.08 * specular).sqrt()) - 1.0
    }

    #[inline]
    pub(crate) fn flags(&self) -> Flags {
        let flags = Flags::REFLECTION.or(Flags::GLOSSY);
        let flags = if self.base() > 0.0 { flags.or(Flags::DIFFUSE) } else { flags };
        if self.transmission() > 0.0 { flags.or(Flags::TRANSMISSION) } else { flags }
    }

    #[inline]
    fn transmission(&self) -> f32 {
        (1.0 - self.metallic) * self.spec_trans
    }

    #[inline]
    fn base(&self) -> f32 {
        (1.0 - self.metallic) * (1.0 - self.spec_trans)
    }

    #[inline]
    fn microfacets(&self) -> Microfacets {
        let aspect = (1.0 - 0.9 * self.anisotropic).sqrt();
        let alpha = self.roughness * self.roughness;
        Microfacets::new(Distribution::Ggx, (alpha / aspect).max(1e-3), (alpha * aspect).max(1e-3))
    }

    #[inline]
    fn coat_alpha(&self) -> f32 {
        0.1 + (0.001 - 0.1) * self.clearcoat_gloss
    }

    #[inline]
    fn lobes(&self, front: bool) -> Lobes {
        if !front {
            return Lobes { main: 1.0, coat: 0.0, diffuse: 0.0 };
        }
        let (coat, diffuse) = (0.25 * self.clearcoat, self.base());
        let total = 1.0 + coat + diffuse;
        Lobes { main: 1.0 / total, coat: coat / total, diffuse: diffuse / total }
    }

    /// Share of the main lobe's samples that is reflected, where the interface reflects `r`.
    #[inline]
    fn reflected_share(&self, front: bool, r: f32) -> f32 {
        if front { 1.0 - self.transmission() * (1.0 - r) } else { r }
    }

    pub(crate) fn eval_pdf(&self, wo: Vec3, wi: Vec3, mode: Mode) -> (Rgb, f32) {
        let (cos_o, cos_i) = (wo.z, wi.z);
        let front = cos_o > 0.0;
        if (cos_o * cos_i).abs() < 1e-20 || (!front && self.transmission() <= 0.0) {
            return (Rgb::ZERO, 0.0);
        }
        let is_reflection = cos_o * cos_i > 0.0;
        let eta = if front { self.eta } else { 1.0 / self.eta };
        let m = (wo + wi * if is_reflection { 1.0 } else { eta }).normalize_or_zero();
        let m = if m.z < 0.0 { -m } else { m };
        let (dot_o, dot_i) = (wo.dot(m), wi.dot(m));
        // Macro- and microsurface must be seen from the same sides.
        let compatible = dot_o * cos_o > 0.0 && dot_i * cos_i > 0.0;
        let microfacets = self.microfacets();
        let r = fresnel::dielectric(dot_o, self.eta).reflectance;
        let lobes = self.lobes(front);
        let normal_pdf = if compatible { microfacets.pdf(if front { wo } else { -wo }, m) } else { 0.0 };
        let dg = if compatible { microfacets.d(m) * microfacets.g1(wo, m) * microfacets.g1(wi, m) } else { 0.0 };
        let share = self.reflected_share(front, r);
        if !is_reflection {
            let sum = dot_o + eta * dot_i;
            if self.transmission() <= 0.0 || !compatible || sum == 0.0 {
                return (Rgb::ZERO, 0.0);
            }
            let jacobian = eta * eta * dot_i.abs() / (sum * sum);
            let scale = if mode == Mode::Radiance { 1.0 / (eta * eta) } else { 1.0 };
            let f = self.transmission() * (1.0 - r) * dg * jacobian * scale * (dot_o / (cos_o * cos_i)).abs();
            let tint = self.base_color.max(Rgb::ZERO).map(f32::sqrt);
            return (tint * f, lobes.main * (1.0 - share) * normal_pdf * jacobian);
        }
        let mut f = Rgb::ZERO;
        let mut pdf = 0.0;
        if compatible {
            f += self.main_fresnel(dot_o, r, front) * (dg / (4.0 * cos_o * cos_i));
            pdf += lobes.main * share * normal_pdf / (4.0 * dot_i.abs());
        }
        if front {
            if compatible && self.clearcoat > 0.0 {
                let d = gtr1(self.coat_alpha(), m.z);
                f += Rgb::splat(self.coat(d, dot_o, wo, wi));
                pdf += lobes.coat * d * m.z / (4.0 * dot_i.abs());
            }
            f += self.diffuse(cos_o, cos_i, dot_i);
            pdf += lobes.diffuse * warp::cosine_hemisphere_pdf(wi);
        }
        (f, pdf)
    }

    pub(crate) fn sample(&self, wo: Vec3, u_lobe: f32, u: Vec2, mode: Mode) -> Option<Sample> {
        let front = wo.z > 0.0;
        if wo.z == 0.0 || (!front && self.transmission() <= 0.0) {
            return None;
        }
        let lobes = self.lobes(front);
        let (wi, flags, eta) = if u_lobe < lobes.diffuse {
            (warp::cosine_hemisphere(u.x, u.y), Flags::REFLECTION.or(Flags::DIFFUSE), 1.0)
        } else if u_lobe < lobes.diffuse + lobes.coat {
            let m = sample_gtr1(self.coat_alpha(), u);
            (fresnel::reflect(wo, m), Flags::REFLECTION.or(Flags::GLOSSY), 1.0)
        } else {
            let m = self.microfacets().sample(if front { wo } else { -wo }, u);
            let interface = fresnel::dielectric(wo.dot(m), self.eta);
            let share = self.reflected_share(front, interface.reflectance);
            if u_lobe - lobes.diffuse - lobes.coat < lobes.main * share {
                (fresnel::reflect(wo, m), Flags::REFLECTION.or(Flags::GLOSSY), 1.0)
            } else {
                let wi = fresnel::refract(wo, m, &interface);
                (wi, Flags::TRANSMISSION.or(Flags::GLOSSY), interface.eta_it)
            }
        };
        if (wo.z * wi.z > 0.0) != flags.contains(Flags::REFLECTION) {
            return None;
        }
        let (f, pdf_w) = self.eval_pdf(wo, wi, mode);
        (pdf_w > 0.0 && pdf_w.is_finite()).then(|| Sample { wi, weight: f * (wi.z.abs() / pdf_w), pdf_w, flags, eta })
    }

    /// Reflectance of the main lobe: the exact dielectric `r`, blended with Schlick's metal and tinted dielectric.
    #[inline]
    fn main_fresnel(&self, dot_o: f32, r: f32, front: bool) -> Rgb {
        if !front {
            return Rgb::splat(self.transmission() * r);
        }
        let mut f = Rgb::splat((1.0 - self.metallic) * (1.0 - self.spec_tint) * r);
        if self.metallic > 0.0 {
            f += self.schlick(self.base_color, dot_o) * self.metallic;
        }
        if self.spec_tint > 0.0 {
            let r0 = ((self.eta - 1.0) / (self.eta + 1.0)).powi(2);
            f += self.schlick(self.tint() * r0, dot_o) * ((1.0 - self.metallic) * self.spec_tint);
        }
        f
    }

    /// Schlick's blend from `r0` to 1 at the angle in the thinner medium.
    #[inline]
    fn schlick(&self, r0: Rgb, cos: f32) -> Rgb {
        let cos = if self.eta > 1.0 { cos } else { fresnel::dielectric(cos, self.eta).cos_t.abs() };
        r0.lerp(Rgb::ONE, fresnel::schlick_weight(cos))
    }

    /// The base colour at unit luminance.
    #[inline]
    fn tint(&self) -> Rgb {
        let luminance = self.base_color.dot(Rgb::new(0.212_671, 0.715_16, 0.072_169));
        if luminance > 0.0 { self.base_color / luminance } else { Rgb::ONE }
    }

    /// The clear coat: reflects 4 % at normal incidence, masked as GGX of roughness 0.25 [Burley 2012, §5.6].
    #[inline]
    fn coat(&self, d: f32, dot_o: f32, wo: Vec3, wi: Vec3) -> f32 {
        let mask = |w: Vec3| {
            let tan2 = (1.0 - w.z * w.z) / (w.z * w.z);
            2.0 / (1.0 + (1.0 + 0.0625 * tan2).sqrt())
        };
        0.25 * self.clearcoat * self.schlick(Rgb::splat(0.04), dot_o).x * d * mask(wo) * mask(wi)
    }

    /// Base, retro-reflection, flat subsurface look and sheen [Burley 2012, §5.3; Burley 2015, §4].
    #[inline]
    fn diffuse(&self, cos_o: f32, cos_i: f32, cos_d: f32) -> Rgb {
        let base = self.base();
        if base <= 0.0 {
            return Rgb::ZERO;
        }
        let (f_o, f_i) = (fresnel::schlick_weight(cos_o), fresnel::schlick_weight(cos_i));
        let lambert = (1.0 - 0.5 * f_o) * (1.0 - 0.5 * f_i);
        let rr = 2.0 * self.roughness * cos_d * cos_d;
        let retro = rr * (f_o + f_i + f_o * f_i * (rr - 1.0));
        let mut value = lambert + retro;
        if self.flatness > 0.0 {
            let ss90 = 0.5 * rr - 1.0;
            let ss = (1.0 + ss90 * f_o) * (1.0 + ss90 * f_i);
            let flat = 1.25 * (ss * (1.0 / (cos_o + cos_i) - 0.5) + 0.5);
            value += (flat - value) * self.flatness;
        }
        let mut f = self.base_color * (base * FRAC_1_PI * value);
        if self.sheen > 0.0 {
            let colour = Rgb::ONE.lerp(self.tint(), self.sheen_tint);
            f += colour * (self.sheen * (1.0 - self.metallic) * fresnel::schlick_weight(cos_d.abs()));
        }
        f
    }
}

/// GTR1 [Burley 2012, Eq. 4 of its appendix].
#[inline]
fn gtr1(alpha: f32, cos: f32) -> f32 {
    let a2 = alpha * alpha;
    let d = (a2 - 1.0) / (PI * a2.ln() * (1.0 + (a2 - 1.0) * cos * cos));
    if d * cos > 1e-20 { d } else { 0.0 }
}

/// Draws a normal with density D·cos [Burley 2012, Eqs. 2, 5 of its appendix].
#[inline]
fn sample_gtr1(alpha: f32, u: Vec2) -> Vec3 {
    let a2 = alpha * alpha;
    let cos2 = ((1.0 - a2.powf(1.0 - u.y)) / (1.0 - a2)).clamp(0.0, 1.0);
    let sin = (1.0 - cos2).sqrt();
    let (sin_phi, cos_phi) = (TAU * u.x).sin_cos();
    Vec3::new(sin * cos_phi, sin * sin_phi, cos2.sqrt())
}
