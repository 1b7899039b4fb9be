//! glTF's metallic-roughness material, with what its extensions add to it: a coloured specular reflection, transmission through
//! thin sheets and solids, and a clear coat.
//!
//! Source: glTF 2.0, Appendix B, and KHR_materials_specular, _transmission, _volume, _ior and _clearcoat: Lambert's base, GGX with
//! α = roughness² and Smith's separable masking, Schlick's Fresnel terms. Through a thin sheet light goes by the lobe of reflection,
//! mirrored at the sheet; into a solid it is refracted [Walter et al. 2007]; the base colour tints it at each crossing.
//! Deviations: what reflects in front leaves 1 − max(F(ω_o), F(ω_i)) to the diffuse base and, for the coat, to all that is
//! under it, where the appendix has F at the half vector and the coat's extension F at ω_o: so the model is the same in both
//! directions and makes no energy. Seen along the normal they are equal. Limit: single scattering.

use crate::{Distribution, Flags, Microfacets, Mode, Rgb, Sample, fresnel};
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;
use translume_core::frame::Frame;
use translume_core::warp;

/// Roughness up to which what is transmitted by a thin sheet goes straight on.
const STRAIGHT_ROUGHNESS: f32 = 0.03;

/// Relative indices nearer to 1 than this bend nothing.
const MATCHED: f32 = 1e-3;

/// What the coat reflects along its normal: its index is 1.5.
const COAT_F0: f32 = 0.04;

/// Parameters; numbers in [0, 1] but for `eta`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MetalRough {
    /// Colour of the diffuse base, of the metal, and of what passes a surface.
    pub base_color: Rgb,
    /// Blend from dielectric to metal.
    pub metallic: f32,
    /// Root of the GGX roughness.
    pub roughness: f32,
    /// What the dielectric reflects along the normal.
    pub f0: Rgb,
    /// What it reflects at grazing angles.
    pub f90: f32,
    /// Blend from the diffuse base to transmission.
    pub transmission: f32,
    /// A sheet without thickness; else the boundary of a solid, whose back is its inside.
    pub thin: bool,
    /// Index behind the surface over the index in front, of solids.
    pub eta: f32,
    /// Strength of the coat.
    pub coat: f32,
    /// Root of the coat's GGX roughness.
    pub coat_roughness: f32,
    /// The coat's own unit normal.
    pub coat_normal: Vec3,
}

impl Default for MetalRough {
    fn default() -> Self {
        Self {
            base_color: Rgb::ONE,
            metallic: 0.0,
            roughness: 1.0,
            f0: Rgb::splat(0.04),
            f90: 1.0,
            transmission: 0.0,
            thin: true,
            eta: 1.5,
            coat: 0.0,
            coat_roughness: 0.0,
            coat_normal: Vec3::Z,
        }
    }
}

/// Chances of the lobes for a direction: the coat, the facets under it (reflecting or transmitting), the diffuse base, straight on.
struct Lobes {
    coat: f32,
    facets: f32,
    diffuse: f32,
    straight: f32,
}

impl MetalRough {
    /// Whether what is transmitted goes straight on, for a roughness.
    pub fn is_straight(thin: bool, eta: f32, roughness: f32) -> bool {
        if thin { roughness <= STRAIGHT_ROUGHNESS } else { (eta - 1.0).abs() < MATCHED }
    }

    fn passes_straight(&self) -> bool {
        Self::is_straight(self.thin, self.eta, self.roughness)
    }

    /// Share of the dielectric that transmits.
    fn through(&self) -> f32 {
        (1.0 - self.metallic) * self.transmission
    }

    pub(crate) fn flags(&self) -> Flags {
        let flags = Flags::REFLECTION.or(Flags::GLOSSY).or(Flags::DIFFUSE);
        match (self.through() > 0.0, self.passes_straight()) {
            (false, _) => flags,
            (true, false) => flags.or(Flags::TRANSMISSION),
            (true, true) => flags.or(Flags::TRANSMISSION).or(Flags::DELTA).or(Flags::NULL),
        }
    }

    fn microfacets(roughness: f32) -> Microfacets {
        let alpha = (roughness * roughness).max(1e-3);
        Microfacets::new(Distribution::Ggx, alpha, alpha)
    }

    /// Of the dielectric under the cosine `cos` on the outside. Where indices match there is no surface to reflect.
    fn clear(&self, cos: f32) -> Rgb {
        if !self.thin && self.passes_straight() {
            return Rgb::ZERO;
        }
        self.f0.lerp(Rgb::splat(self.f90), fresnel::schlick_weight(cos.abs()))
    }

    /// The same at a facet of a solid that is met under the cosine `dot`, signed: by the angle on the thinner side, all where
    /// nothing can get out.
    fn clear_at(&self, dot: f32) -> Rgb {
        if self.thin || self.passes_straight() {
            return self.clear(dot);
        }
        let interface = fresnel::dielectric(dot, self.eta);
        match interface.eta_it >= 1.0 {
            true => self.clear(dot),
            false if interface.cos_t == 0.0 => Rgb::ONE,
            false => self.clear(interface.cos_t),
        }
    }

    /// What a facet reflects of light from outside.
    fn facet(&self, clear: Rgb, dot: f32) -> Rgb {
        let metal = self.base_color.lerp(Rgb::ONE, fresnel::schlick_weight(dot.abs()));
        clear.lerp(metal, self.metallic)
    }

    /// What the coat reflects of a direction that it sees under the cosine `cos`.
    fn coat_fresnel(cos: f32) -> f32 {
        COAT_F0 + (1.0 - COAT_F0) * fresnel::schlick_weight(cos.abs())
    }

    /// What the coat leaves to what is under it.
    fn under_coat(&self, wo: Vec3, wi: Vec3) -> f32 {
        if self.coat <= 0.0 {
            return 1.0;
        }
        let of = |w: Vec3| Self::coat_fresnel(self.coat_normal.dot(w));
        1.0 - self.coat * of(wo).max(of(wi))
    }

    /// Of what meets a facet, the part that is reflected among that and what is transmitted by rough facets.
    fn reflected_share(&self, wo: Vec3, dot: f32) -> f32 {
        if self.through() <= 0.0 || self.passes_straight() {
            return 1.0;
        }
        let clear = self.clear_at(dot);
        let reflected = match wo.z > 0.0 {
            true => mean(self.facet(clear, dot)),
            false => self.through() * mean(clear),
        };
        let transmitted = self.through() * mean(self.base_color) * (1.0 - clear.max_element());
        if reflected + transmitted > 0.0 { reflected / (reflected + transmitted) } else { 1.0 }
    }

    fn lobes(&self, wo: Vec3) -> Lobes {
        if wo.z < 0.0 && !self.passes_straight() {
            return Lobes { coat: 0.0, facets: 1.0, diffuse: 0.0, straight: 0.0 };
        }
        let clear = self.clear(wo.z);
        let (under, base) = (self.under_coat(wo, wo), mean(self.base_color) * (1.0 - clear.max_element()));
        let through = under * base * self.through();
        let (straight, rough) = if self.passes_straight() { (through, 0.0) } else { (0.0, through) };
        if wo.z < 0.0 {
            let facets = self.through() * mean(clear);
            let total = (facets + straight).max(f32::MIN_POSITIVE);
            return Lobes { coat: 0.0, facets: facets / total, diffuse: 0.0, straight: straight / total };
        }
        let coat = self.coat * Self::coat_fresnel(self.coat_normal.dot(wo));
        let facets = under * mean(self.facet(clear, wo.z)) + rough;
        let diffuse = under * base * (1.0 - self.metallic) * (1.0 - self.transmission);
        let total = (coat + facets + diffuse + straight).max(f32::MIN_POSITIVE);
        Lobes { coat: coat / total, facets: facets / total, diffuse: diffuse / total, straight: straight / total }
    }

    /// Value and density of all but what goes straight on.
    pub(crate) fn eval_pdf(&self, wo: Vec3, wi: Vec3, mode: Mode) -> (Rgb, f32) {
        if (wo.z * wi.z).abs() < 1e-20 || (wo.z < 0.0 && self.through() <= 0.0) {
            return (Rgb::ZERO, 0.0);
        }
        let lobes = self.lobes(wo);
        if wo.z * wi.z < 0.0 {
            return self.transmitted(wo, wi, mode, lobes.facets);
        }
        let (mut f, mut pdf_w) = self.reflected(wo, wi, lobes.facets);
        if wo.z < 0.0 {
            return (f, pdf_w);
        }
        let base = (1.0 - self.metallic) * (1.0 - self.transmission) * FRAC_1_PI;
        if base > 0.0 {
            let clear = self.clear(wo.z).max(self.clear(wi.z)).max_element();
            f += self.base_color * (base * (1.0 - clear));
            pdf_w += lobes.diffuse * warp::cosine_hemisphere_pdf(wi);
        }
        f *= self.under_coat(wo, wi);
        if self.coat > 0.0 {
            let (coat, pdf) = self.coated(wo, wi, mode);
            f += Rgb::splat(coat);
            pdf_w += lobes.coat * pdf;
        }
        (f, pdf_w)
    }

    /// By the facets, back to the side of `wo`.
    fn reflected(&self, wo: Vec3, wi: Vec3, chance: f32) -> (Rgb, f32) {
        let m = (wo + wi).normalize_or_zero();
        let m = if m.z < 0.0 { -m } else { m };
        let (dot, microfacets) = (wo.dot(m), Self::microfacets(self.roughness));
        if dot * wo.z <= 0.0 {
            return (Rgb::ZERO, 0.0);
        }
        let visible = microfacets.d(m) * microfacets.g1(wo, m) / (4.0 * wo.z.abs());
        let clear = self.clear_at(dot);
        let reflectance = if wo.z > 0.0 { self.facet(clear, dot) } else { clear * self.through() };
        let f = reflectance * (visible * microfacets.g1(wi, m) / wi.z.abs());
        (f, chance * self.reflected_share(wo, dot) * visible)
    }

    /// By the facets, to the other side.
    fn transmitted(&self, wo: Vec3, wi: Vec3, mode: Mode, chance: f32) -> (Rgb, f32) {
        if self.through() <= 0.0 || self.passes_straight() {
            return (Rgb::ZERO, 0.0);
        }
        let (eta, outer) = if wo.z > 0.0 { (self.eta, wo) } else { (1.0 / self.eta, wi) };
        let mirrored = Vec3::new(wi.x, wi.y, -wi.z);
        let m = if self.thin { wo + mirrored } else { wo + wi * eta }.normalize_or_zero();
        let m = if m.z < 0.0 { -m } else { m };
        let microfacets = Self::microfacets(self.roughness);
        let (dot_o, dot_i) = (wo.dot(m), if self.thin { mirrored.dot(m) } else { wi.dot(m) });
        let right_side = dot_o * wo.z > 0.0 && dot_i * if self.thin { mirrored.z } else { wi.z } > 0.0;
        let sum = dot_o + eta * dot_i;
        if !right_side || (!self.thin && sum == 0.0) {
            return (Rgb::ZERO, 0.0);
        }
        let seen_i = if self.thin { mirrored } else { wi };
        let visible = microfacets.d(m) * microfacets.g1(wo, m) / wo.z.abs();
        // Density of the direction for that of the facet times |wo·m|.
        let (jacobian, scale) = match self.thin {
            true => (0.25, 1.0),
            false => (
                eta * eta * (dot_o * dot_i).abs() / (sum * sum),
                if mode == Mode::Radiance { 1.0 / (eta * eta) } else { 1.0 },
            ),
        };
        let passed = self.through() * (1.0 - self.clear_at(dot_o).max_element()) * self.under_coat(outer, outer);
        let f = self.base_color * (passed * visible * microfacets.g1(seen_i, m) * jacobian * scale / wi.z.abs());
        (f, chance * (1.0 - self.reflected_share(wo, dot_o)) * visible * jacobian)
    }

    /// Value and density of the coat.
    fn coated(&self, wo: Vec3, wi: Vec3, mode: Mode) -> (f32, f32) {
        let frame = Frame::from_normal(self.coat_normal);
        let (o, i) = (frame.to_local(wo), frame.to_local(wi));
        if o.z <= 0.0 || i.z <= 0.0 {
            return (0.0, 0.0);
        }
        let m = (o + i).normalize();
        let microfacets = Self::microfacets(self.coat_roughness);
        let seen = 0.25 * microfacets.d(m) * microfacets.g1(o, m);
        // Light falls on the coat by its own cosine; what multiplies the value is that of the surface.
        let cosines = if mode == Mode::Radiance { o.z * wi.z } else { i.z * wo.z };
        (self.coat * Self::coat_fresnel(o.dot(m)) * seen * microfacets.g1(i, m) / cosines, seen / o.z)
    }

    pub(crate) fn sample(&self, wo: Vec3, u_lobe: f32, u: Vec2, mode: Mode) -> Option<Sample> {
        if wo.z == 0.0 || (wo.z < 0.0 && self.through() <= 0.0) {
            return None;
        }
        let lobes = self.lobes(wo);
        let glossy = Flags::REFLECTION.or(Flags::GLOSSY);
        if u_lobe < lobes.straight {
            return Some(Sample::pass_through(wo, self.straight(wo) / lobes.straight, lobes.straight));
        }
        let u_lobe = u_lobe - lobes.straight;
        let (wi, flags, eta) = if u_lobe < lobes.diffuse {
            (warp::cosine_hemisphere(u.x, u.y), Flags::REFLECTION.or(Flags::DIFFUSE), 1.0)
        } else if u_lobe < lobes.diffuse + lobes.coat {
            let frame = Frame::from_normal(self.coat_normal);
            let o = frame.to_local(wo);
            if o.z <= 0.0 {
                return None;
            }
            let i = fresnel::reflect(o, Self::microfacets(self.coat_roughness).sample(o, u));
            if i.z <= 0.0 {
                return None;
            }
            (frame.to_world(i), glossy, 1.0)
        } else {
            let chance = (u_lobe - lobes.diffuse - lobes.coat) / lobes.facets;
            self.sample_facet(wo, chance, u)?
        };
        if (wo.z * wi.z > 0.0) != flags.contains(Flags::REFLECTION) {
            return None;
        }
        let (f, pdf_w) = self.eval_pdf(wo, wi, mode);
        (pdf_w > 0.0 && pdf_w.is_finite()).then(|| Sample { wi, weight: f * (wi.z.abs() / pdf_w), pdf_w, flags, eta })
    }

    fn sample_facet(&self, wo: Vec3, chance: f32, u: Vec2) -> Option<(Vec3, Flags, f32)> {
        let m = Self::microfacets(self.roughness).sample(if wo.z > 0.0 { wo } else { -wo }, u);
        let dot = wo.dot(m);
        let wi = fresnel::reflect(wo, m);
        if chance < self.reflected_share(wo, dot) {
            return Some((wi, Flags::REFLECTION.or(Flags::GLOSSY), 1.0));
        }
        let flags = Flags::TRANSMISSION.or(Flags::GLOSSY);
        if self.thin {
            return (wi.z * wo.z > 0.0).then_some((Vec3::new(wi.x, wi.y, -wi.z), flags, 1.0));
        }
        let interface = fresnel::dielectric(dot, self.eta);
        Some((fresnel::refract(wo, m, &interface), flags, interface.eta_it))
    }

    /// What goes straight on.
    pub(crate) fn straight(&self, wo: Vec3) -> Rgb {
        if self.through() <= 0.0 || !self.passes_straight() {
            return Rgb::ZERO;
        }
        let passed = self.through() * (1.0 - self.clear(wo.z).max_element());
        self.base_color * (passed * self.under_coat(wo, wo))
    }
}

fn mean(v: Rgb) -> f32 {
    v.element_sum() / 3.0
}
