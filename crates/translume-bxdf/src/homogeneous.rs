//! Homogeneous translucent materials as [`Bssrdf`]s: one of the diffusion models for each colour.
//!
//! The radiosity that a diffusion model gives leaves as L_o = F_t(ω_o) M/(π (1 − F̄)), F̄ the boundary's mean reflectance from
//! outside, so R_d of the measurement equation is the model's over 1 − F̄. Without this, which is how Jensen et al. 2001 print
//! it, a material that absorbs nothing would still lose F̄ of the light. Limits are the models': a half-space, many
//! scatterings.

use crate::bssrdf::{Bssrdf, Radii, RadiusTable, Site};
use crate::diffusion::{Dipole, DipoleKind, Normalized, Sources};
use crate::{Rgb, fresnel};

/// The diffusion models.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Diffusion {
    /// Jensen et al. 2001.
    #[default]
    Dipole,
    /// d'Eon 2012.
    BetterDipole,
    /// Burley 2015.
    Normalized,
}

impl Diffusion {
    /// By its name in files and options.
    pub fn by_name(name: &str) -> Option<Self> {
        match name {
            "dipole" => Some(Self::Dipole),
            "better-dipole" => Some(Self::BetterDipole),
            "normalized" => Some(Self::Normalized),
            _ => None,
        }
    }
}

/// What the fall-off of one colour is.
enum Profile {
    Sources(Sources),
    Normalized(Normalized),
    /// Nothing comes back.
    Black,
}

impl Profile {
    fn value(&self, r: f64) -> f64 {
        match self {
            Self::Sources(s) => s.value(r),
            Self::Normalized(n) => n.value(r),
            Self::Black => 0.0,
        }
    }
}

/// A homogeneous material.
pub struct Homogeneous {
    /// σs′ and σa, for messages.
    coefficients: [Rgb; 2],
    eta: f32,
    model: Diffusion,
    profiles: [Profile; 3],
    total: Rgb,
    /// 1/(1 − F̄).
    normalization: f64,
    radii: RadiusTable,
}

impl std::fmt::Debug for Homogeneous {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let [s, a] = self.coefficients;
        write!(f, "{:?} of σs′ {s}, σa {a}, η {}, total {}", self.model, self.eta, self.total)
    }
}

impl Homogeneous {
    /// From reduced scattering and absorption coefficients in mm⁻¹ and the relative index `eta` ≥ 1. `None` where they are
    /// negative or not finite, or nothing scatters.
    pub fn new(model: Diffusion, sigma_s_prime: Rgb, sigma_a: Rgb, eta: f32) -> Option<Self> {
        let sound = |c: Rgb| c.is_finite() && c.min_element() >= 0.0;
        if !(sound(sigma_s_prime) && sound(sigma_a) && sigma_s_prime.max_element() > 0.0 && (1.0..=4.0).contains(&eta))
        {
            return None;
        }
        let mut totals = [0.0; 3];
        let profiles = std::array::from_fn(|i| {
            let (s, a) = (f64::from(sigma_s_prime[i]), f64::from(sigma_a[i]));
            let kind = if model == Diffusion::BetterDipole { DipoleKind::BetterDipole } else { DipoleKind::Dipole };
            let dipole = Dipole { kind, sigma_s_prime: s, sigma_a: a, eta: eta.into(), scale: 1.0 };
            totals[i] = if s > 0.0 { dipole.total() as f32 } else { 0.0 };
            match model {
                _ if s <= 0.0 => Profile::Black,
                // Its albedo is that of the dipole of these coefficients; Burley fitted the shape to the albedo.
                Diffusion::Normalized => Profile::Normalized(normalized(totals[i].into(), 1.0 / (s + a))),
                _ => Profile::Sources(dipole.sources()),
            }
        });
        let free = 1.0 / (sigma_s_prime + sigma_a).max_element();
        Self::of(model, [sigma_s_prime, sigma_a], eta, profiles, totals.into(), free)
    }

    /// From the diffuse reflectance (below 1) and the mean free path in mm. The dipoles get the reduced albedo that has this
    /// total. `None` where there is none.
    pub fn from_reflectance(model: Diffusion, reflectance: Rgb, mean_free_path: Rgb, eta: f32) -> Option<Self> {
        let sound = reflectance.min_element() >= 0.0 && reflectance.max_element() <= 1.0;
        if !(sound && mean_free_path.min_element() > 0.0 && mean_free_path.is_finite() && (1.0..=4.0).contains(&eta)) {
            return None;
        }
        if model == Diffusion::Normalized {
            let profile = |i: usize| Profile::Normalized(normalized(reflectance[i].into(), mean_free_path[i].into()));
            let profiles = std::array::from_fn(profile);
            return Self::of(model, [Rgb::ZERO; 2], eta, profiles, reflectance, mean_free_path.min_element());
        }
        let albedo = Rgb::from_array(std::array::from_fn(|i| albedo_of_total(model, reflectance[i], eta)));
        Self::new(model, albedo / mean_free_path, (Rgb::ONE - albedo) / mean_free_path, eta)
    }

    fn of(
        model: Diffusion,
        coefficients: [Rgb; 2],
        eta: f32,
        profiles: [Profile; 3],
        total: Rgb,
        free: f32,
    ) -> Option<Self> {
        let power = |i: usize| if total[i] > 0.0 { 1.0 / f64::from(total[i]) } else { 0.0 };
        let density = |r: f64| (0..3).map(|i| power(i) * r * profiles[i].value(r)).sum::<f64>();
        // As far as anything is left to speak of.
        let mut reach = 8.0 * f64::from(free);
        let peak = density(f64::from(free));
        while density(reach) * reach > 1e-6 * peak * f64::from(free) && reach < 1e5 * f64::from(free) {
            reach *= 1.25;
        }
        let radii = RadiusTable::new(0.02 * free, reach as f32, density)?;
        let normalization = 1.0 / (1.0 - mean_reflectance(eta));
        Some(Self { coefficients, eta, model, profiles, total, normalization, radii })
    }
}

fn normalized(albedo: f64, mean_free_path: f64) -> Normalized {
    // d = ℓ/s(A): the inverse of what `Normalized::new` says of d.
    let unit = Normalized::new(albedo, 1.0).mean_free_path.unwrap_or(1.0);
    Normalized::new(albedo, mean_free_path / unit)
}

/// The reduced albedo whose dipole sends back `total`, by bisection: the total grows with it.
fn albedo_of_total(model: Diffusion, total: f32, eta: f32) -> f32 {
    let kind = if model == Diffusion::BetterDipole { DipoleKind::BetterDipole } else { DipoleKind::Dipole };
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        let dipole = Dipole { kind, sigma_s_prime: middle, sigma_a: 1.0 - middle, eta: eta.into(), scale: 1.0 };
        if dipole.total() < f64::from(total) { low = middle } else { high = middle }
    }
    low as f32
}

/// Mean of Fresnel's reflectance over light from all sides, 2 ∫ F(μ) μ dμ.
pub fn mean_reflectance(eta: f32) -> f64 {
    let n = 2048;
    let at = |i: i32| (f64::from(i) + 0.5) / f64::from(n);
    (0..n).map(|i| 2.0 * at(i) * f64::from(fresnel::dielectric(at(i) as f32, eta).reflectance)).sum::<f64>()
        / f64::from(n)
}

impl Bssrdf for Homogeneous {
    fn eval(&self, from: &Site, to: &Site) -> Rgb {
        let r = f64::from(from.p.distance(to.p));
        Rgb::from_array(std::array::from_fn(|i| (self.normalization * self.profiles[i].value(r)) as f32))
    }

    fn radii(&self, _: &Site) -> Radii<'_> {
        Radii::Table(&self.radii)
    }

    fn total(&self, _: &Site) -> Rgb {
        self.total
    }

    fn bound(&self, r: f32) -> f32 {
        // They all fall.
        self.profiles.iter().map(|p| (self.normalization * p.value(r.into())) as f32).fold(0.0, f32::max)
    }
}

/// σs′ and σa in mm⁻¹ and the index of refraction of a material measured by Jensen et al. 2001, by its name there in
/// lower case.
pub fn measured_by_name(name: &str) -> Option<([Rgb; 2], f32)> {
    let (_, s, a) = MEASURED.iter().find(|m| m.0.eq_ignore_ascii_case(name))?;
    Some(([Rgb::from_array(*s), Rgb::from_array(*a)], if *a == MEASURED[5].2 { 1.5 } else { 1.3 }))
}

/// Names, σs′, σa.
pub const MEASURED: [(&str, [f32; 3], [f32; 3]); 12] = [
    ("apple", [2.29, 2.39, 1.97], [0.0030, 0.0034, 0.046]),
    ("chicken1", [0.15, 0.21, 0.38], [0.015, 0.077, 0.19]),
    ("chicken2", [0.19, 0.25, 0.32], [0.018, 0.088, 0.20]),
    ("cream", [7.38, 5.47, 3.15], [0.0002, 0.0028, 0.0163]),
    ("ketchup", [0.18, 0.07, 0.03], [0.061, 0.97, 1.45]),
    ("marble", [2.19, 2.62, 3.00], [0.0021, 0.0041, 0.0071]),
    ("potato", [0.68, 0.70, 0.55], [0.0024, 0.0090, 0.12]),
    ("skimmilk", [0.70, 1.22, 1.90], [0.0014, 0.0025, 0.0142]),
    ("skin1", [0.74, 0.88, 1.01], [0.032, 0.17, 0.48]),
    ("skin2", [1.09, 1.59, 1.79], [0.013, 0.070, 0.145]),
    ("spectralon", [11.6, 20.4, 14.9], [0.0, 0.0, 0.0]),
    ("wholemilk", [2.55, 3.21, 3.77], [0.0011, 0.0024, 0.014]),
];

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Vec2, Vec3};

    fn site(x: f32) -> Site {
        Site { p: Vec3::new(x, 0.0, 0.0), face: 0, uv: Vec2::ZERO }
    }

    /// ∫ R_d dA by the model's own samples, against the closed form over 1 − F̄.
    #[test]
    fn samples_weighed_by_their_density_integrate_to_the_total() {
        for model in [Diffusion::Dipole, Diffusion::BetterDipole, Diffusion::Normalized] {
            for (name, s, a) in MEASURED {
                let m = Homogeneous::new(model, s.into(), a.into(), 1.3).unwrap();
                let radii = m.radii(&site(0.0));
                let n = 4000;
                let weight = |i: i32| {
                    let r = radii.sample(Vec2::new(0.5, (i as f32 + 0.5) / n as f32));
                    m.eval(&site(r), &site(0.0)) / radii.pdf_a(r)
                };
                let sum: Rgb = (0..n).map(weight).sum::<Rgb>() / n as f32;
                let expected = m.total(&site(0.0)) * m.normalization as f32;
                // Spectralon, which absorbs nothing, falls with r⁻³ and has some of its light far away.
                let slack = if name == "spectralon" { 2e-3 } else { 5e-4 };
                assert!(
                    (sum - expected).abs().max_element() < slack + 0.005 * expected.max_element(),
                    "{model:?} {name}: {sum} {expected}"
                );
            }
        }
    }

    #[test]
    fn a_reflectance_comes_back() {
        let (wanted, path) = (Rgb::new(0.8, 0.4, 0.05), Rgb::new(1.0, 0.5, 0.2));
        for model in [Diffusion::Dipole, Diffusion::BetterDipole, Diffusion::Normalized] {
            let m = Homogeneous::from_reflectance(model, wanted, path, 1.4).unwrap();
            assert!((m.total(&site(0.0)) - wanted).abs().max_element() < 1e-4, "{m:?}");
        }
        assert!(Homogeneous::from_reflectance(Diffusion::Dipole, Rgb::splat(1.2), path, 1.4).is_none());
        assert!(Homogeneous::new(Diffusion::Dipole, Rgb::ZERO, Rgb::ONE, 1.4).is_none());
    }

    #[test]
    fn marble_alone_has_the_index_of_marble() {
        assert_eq!(measured_by_name("Marble").unwrap().1, 1.5);
        assert!(MEASURED.iter().filter(|m| measured_by_name(m.0).unwrap().1 == 1.5).count() == 1);
        assert!(measured_by_name("granite").is_none());
    }
}
