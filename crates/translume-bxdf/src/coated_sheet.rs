//! A thin diffuse sheet with a rough clear coat on both sides: leaves, paper, lampshades with their highlights.
//!
//! Source: the dielectric of glTF's metallic-roughness model with `KHR_materials_diffuse_transmission`, whose base is a mixture
//! of Lambertian reflection and transmission. Deviation: glTF lays the coat over the base by 1 − F at the half vector, which has
//! no meaning for light from the other side and makes or loses energy. Here the base gets (1 − E(ω_o)) (1 − E(ω_i)) / (1 − Ē), E
//! the coat's own albedo and Ē its mean over the cosine [Kelemen & Szirmay-Kalos 2001], for both sides alike: symmetric in
//! its directions, and a white sheet sends on all the light. Limit: the coat scatters once, so that a rough one gives the
//! base what its facets would pass among themselves.

use crate::rough_plastic::transported;
use crate::{DiffuseSheet, Distribution, Flags, Microfacets, Rgb, Sample, fresnel};
use glam::{Vec2, Vec3};
use translume_core::special::gauss_legendre;

/// Steps of the roughness, and of the root of the cosine, in the table of a coat.
const ROUGH: usize = 16;
const FLAT: usize = 63;

/// Roughness below which coats are all alike: α = 0.001.
const SMOOTH: f32 = 0.031_622_776;

/// What a clear coat leaves to what is under it, for all roughnesses. One per index of refraction, shared by all sheets of it.
#[derive(Clone, Debug, PartialEq)]
pub struct SheetCoat {
    eta: f32,
    /// By roughness from [`SMOOTH`] to 1: 1 − E, for the roots of the cosine from 0 to 1; its mean over the cosine.
    passed: Vec<([f32; FLAT + 1], f32)>,
}

impl SheetCoat {
    /// Tabulates a coat of relative index `eta`, above 1 (takes some hundredths of a second).
    pub fn new(eta: f32) -> Self {
        let (rule, cell) = (gauss_legendre(32), gauss_legendre(3));
        let row = |r: usize| {
            let microfacets = microfacets(SMOOTH + (1.0 - SMOOTH) * r as f32 / ROUGH as f32);
            let passed: [f32; FLAT + 1] = std::array::from_fn(|i| {
                let root = i as f32 / FLAT as f32;
                1.0 - transported(&microfacets, (root * root).max(1e-6), eta, &rule, true)
            });
            // 2 ∫ (1 − E) cos d cos of the table as it is read, which is linear in x = √cos: exact, so that energy is too.
            let mut mean = 0.0;
            for (i, ends) in passed.windows(2).enumerate() {
                for &(t, weight) in &cell {
                    let x = (i as f32 + t) / FLAT as f32;
                    mean += 4.0 * x.powi(3) * (ends[0] + (ends[1] - ends[0]) * t) * weight / FLAT as f32;
                }
            }
            (passed, mean)
        };
        Self { eta, passed: (0..=ROUGH).map(row).collect() }
    }

    /// 1 − E at the cosines `cos`, and 1 − Ē.
    #[inline]
    fn passed<const N: usize>(&self, roughness: f32, cos: [f32; N]) -> ([f32; N], f32) {
        let (r, t) = cell((roughness - SMOOTH) / (1.0 - SMOOTH), ROUGH);
        let ((low, low_mean), (high, high_mean)) = (&self.passed[r], &self.passed[r + 1]);
        let at = |cos: f32| {
            let (i, s) = cell(cos.sqrt(), FLAT);
            let along = |row: &[f32; FLAT + 1]| row[i] + (row[i + 1] - row[i]) * s;
            along(low) * (1.0 - t) + along(high) * t
        };
        (cos.map(at), low_mean * (1.0 - t) + high_mean * t)
    }
}

/// The step that `x` of [0, 1] is in, and the place in it.
#[inline]
fn cell(x: f32, steps: usize) -> (usize, f32) {
    let x = x.clamp(0.0, 1.0) * steps as f32;
    let i = (x as usize).min(steps - 1);
    (i, x - i as f32)
}

#[inline]
fn microfacets(roughness: f32) -> Microfacets {
    let alpha = roughness.max(SMOOTH).powi(2);
    Microfacets::new(Distribution::Ggx, alpha, alpha)
}

/// Parameters of a coated sheet, alike from both sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoatedSheet<'a> {
    /// The coat.
    pub coat: &'a SheetCoat,
    /// Square root of the coat's GGX roughness, in [0, 1].
    pub roughness: f32,
    /// What is under the coat.
    pub sheet: DiffuseSheet,
    /// Blend from the coated sheet to opaque metal, in [0, 1].
    pub metallic: f32,
    /// What the metal reflects along the normal.
    pub metal: Rgb,
}

impl CoatedSheet<'_> {
    pub(crate) const FLAGS: Flags = DiffuseSheet::FLAGS.or(Flags::GLOSSY);

    /// Chance of sampling the coat, by power as far as it is known before sampling; `passed` is 1 − E.
    #[inline]
    fn coat_share(&self, passed: f32) -> f32 {
        let metal = self.metallic * self.metal.element_sum() / 3.0;
        let coat = (1.0 - self.metallic) * (1.0 - passed) + metal;
        let base =
            (1.0 - self.metallic) * passed * (self.sheet.reflectance + self.sheet.transmittance).element_sum() / 3.0;
        if coat + base > 0.0 { coat / (coat + base) } else { 1.0 }
    }

    pub(crate) fn eval_pdf(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        let (cos_o, cos_i) = (wo.z.abs(), wi.z.abs());
        if cos_o * cos_i < 1e-20 {
            return (Rgb::ZERO, 0.0);
        }
        let ([passed_o, passed_i], mean) = self.coat.passed(self.roughness, [cos_o, cos_i]);
        let share = self.coat_share(passed_o);
        let (base, base_pdf) = self.sheet.eval_pdf(wo, wi);
        let mut f = base * ((1.0 - self.metallic) * passed_o * passed_i / mean.max(1e-6));
        let mut pdf_w = (1.0 - share) * base_pdf;
        if wo.z * wi.z > 0.0 {
            let (wo, wi) = (up(wo), up(wi));
            let m = (wo + wi).normalize();
            let microfacets = microfacets(self.roughness);
            let visible = microfacets.d(m) * microfacets.g1(wo, m) / (4.0 * cos_o);
            f += self.reflectance(wo.dot(m)) * (visible * microfacets.g1(wi, m) / cos_i);
            pdf_w += share * visible;
        }
        (f, pdf_w)
    }

    pub(crate) fn sample(&self, wo: Vec3, u_lobe: f32, u: Vec2) -> Option<Sample> {
        if wo.z == 0.0 {
            return None;
        }
        let ([passed], _) = self.coat.passed(self.roughness, [wo.z.abs()]);
        let share = self.coat_share(passed);
        let (wi, flags) = if u_lobe < share {
            let m = microfacets(self.roughness).sample(up(wo), u);
            let wi = fresnel::reflect(up(wo), m);
            if wi.z <= 0.0 {
                return None;
            }
            (Vec3::new(wi.x, wi.y, wi.z.copysign(wo.z)), Flags::REFLECTION.or(Flags::GLOSSY))
        } else {
            let s = self.sheet.sample(wo, (u_lobe - share) / (1.0 - share), u)?;
            (s.wi, s.flags)
        };
        let (f, pdf_w) = self.eval_pdf(wo, wi);
        let fine = pdf_w > 0.0 && pdf_w.is_finite();
        fine.then(|| Sample { wi, weight: f * (wi.z.abs() / pdf_w), pdf_w, flags, eta: 1.0 })
    }

    /// Of a facet that is seen under the cosine `cos`: the exact dielectric, blended with Schlick's metal.
    #[inline]
    fn reflectance(&self, cos: f32) -> Rgb {
        let clear = Rgb::splat(fresnel::dielectric(cos, self.coat.eta).reflectance);
        match self.metallic > 0.0 {
            true => clear.lerp(self.metal.lerp(Rgb::ONE, fresnel::schlick_weight(cos)), self.metallic),
            false => clear,
        }
    }

    /// An estimate of the scattered fraction.
    pub(crate) fn albedo(&self) -> Rgb {
        (self.sheet.reflectance + self.sheet.transmittance).lerp(self.metal, self.metallic)
    }
}

/// As seen from the side that `w` is on.
#[inline]
fn up(w: Vec3) -> Vec3 {
    Vec3::new(w.x, w.y, w.z.abs())
}
