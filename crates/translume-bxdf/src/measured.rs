//! A measured reflectance in the adaptive parameterisation of RGL's material database.
//!
//! Source: Dupuy & Jakob 2018, "An Adaptive Parameterization for Efficient Material Acquisition and Rendering". A direction of
//! incidence (θ_i, φ_i) has tables of its own: a density of visible normals, whose warp spreads a unit square of colours over the
//! normals that matter, and the luminance on that square, which together draw nearly in proportion to what was measured. Conventions are
//! Mitsuba 3's (`tests` of the scene crate hold the values to it): the incident direction of the tables is the known one, `wo`, and the
//! tables hold the reflectance times the cosine of the other. Limits: measured data are not reciprocal to the last digit, so in
//! [`Mode::Importance`] the roles are exchanged, and drawing is that of the unexchanged; nothing is transmitted.

use crate::{CustomBsdf, Flags, Mode, Rgb, Sample};
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_PI_2, PI, TAU};
use translume_core::bilinear::{BilinearDensity, BilinearPile, Mix};

/// What a file holds. Piles have a slice for each φ_i and, faster, each θ_i.
#[derive(Clone, Debug)]
pub struct MeasuredTables {
    /// Elevations of incidence, increasing, in radians.
    pub theta_i: Vec<f32>,
    /// Azimuths of incidence, increasing, in radians. At most two: the material is isotropic. A half or a quarter turn: the rest follows
    /// by symmetry.
    pub phi_i: Vec<f32>,
    /// Density of microfacet normals: one slice over normals as points (√(2θ/π), (φ + π)/2π).
    pub ndf: BilinearPile,
    /// Projected area of the microfacets: one slice over directions as such points.
    pub sigma: BilinearPile,
    /// Densities of visible normals, over the same points (φ relative to φ_i for isotropic materials).
    pub vndf: BilinearPile,
    /// Luminance over the square that the warp of `vndf` spreads over normals.
    pub luminance: BilinearPile,
    /// Colour over that square; red, green and blue vary faster than θ_i.
    pub rgb: BilinearPile,
    /// Whether colours are to be multiplied by ndf/(4 σ).
    pub jacobian: bool,
}

/// See the module.
#[derive(Debug)]
pub struct Measured {
    theta_i: Vec<f32>,
    phi_i: Vec<f32>,
    symmetry: Symmetry,
    ndf: BilinearPile,
    sigma: BilinearPile,
    vndf: BilinearDensity,
    luminance: BilinearDensity,
    rgb: BilinearPile,
    jacobian: bool,
    albedo: Rgb,
}

/// What the azimuths of incidence leave out.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Symmetry {
    /// Everything depends on differences of azimuths only.
    Isotropic,
    /// Nothing.
    None,
    /// A half turn about the normal; the measured half is around this azimuth.
    HalfTurn(f32),
    /// Mirrors of both axes; the measured quarter is around this azimuth.
    Mirrors(f32),
}

impl Measured {
    /// From tables.
    ///
    /// # Errors
    /// What is wrong with them, as the end of a sentence.
    pub fn new(tables: MeasuredTables) -> Result<Self, &'static str> {
        let MeasuredTables { theta_i, phi_i, ndf, sigma, vndf, luminance, rgb, jacobian } = tables;
        let increasing = |v: &[f32]| !v.is_empty() && v.iter().all(|a| a.is_finite()) && v.is_sorted_by(|a, b| a < b);
        if !increasing(&theta_i) || !increasing(&phi_i) {
            return Err("the angles of incidence do not increase");
        }
        let slices = theta_i.len() * phi_i.len();
        if vndf.slices() != slices || luminance.slices() != slices || rgb.slices() != 3 * slices {
            return Err("the tables do not have a slice for each direction of incidence");
        }
        if ndf.slices() != 1 || sigma.slices() != 1 {
            return Err("the microfacets have more than one table");
        }
        let (first, last) = (phi_i[0], phi_i[phi_i.len() - 1]);
        let symmetry = match (phi_i.len(), (TAU / (last - first)).round()) {
            (..=2, _) => Symmetry::Isotropic,
            (_, 1.0) => Symmetry::None,
            (_, 2.0) => Symmetry::HalfTurn(0.5 * (first + last)),
            (_, 4.0) => Symmetry::Mirrors(0.5 * (first + last)),
            _ => return Err("the azimuths of incidence are neither a turn nor a half or a quarter of one"),
        };
        let vndf = BilinearDensity::new(vndf).ok_or("the visible normals have no density")?;
        let luminance = BilinearDensity::new(luminance).ok_or("the luminance has no density")?;
        let made = Self { theta_i, phi_i, symmetry, ndf, sigma, vndf, luminance, rgb, jacobian, albedo: Rgb::ZERO };
        let albedo = made.average_weight();
        Ok(Self { albedo, ..made })
    }

    /// The reflected fraction of light along the normal.
    fn average_weight(&self) -> Rgb {
        const N: usize = 16;
        let middle = |i| (i as f32 + 0.5) / N as f32;
        let points = (0..N * N).map(|i| Vec2::new(middle(i % N), middle(i / N)));
        let weights = points.filter_map(|u| self.draw(Vec3::Z, u, Mode::Radiance)).map(|sample| sample.weight);
        weights.sum::<Rgb>() / (N * N) as f32
    }

    /// The directions where the tables are.
    fn reduced(&self, wo: Vec3, wi: Vec3) -> (Vec3, Vec3) {
        let flip = match self.symmetry {
            Symmetry::Isotropic | Symmetry::None => return (wo, wi),
            Symmetry::HalfTurn(middle) if wo.x * middle.cos() + wo.y * middle.sin() < 0.0 => Vec3::new(-1.0, -1.0, 1.0),
            Symmetry::HalfTurn(_) => Vec3::ONE,
            Symmetry::Mirrors(middle) => {
                let side = |w: f32, m: f32| if w * m < 0.0 { -1.0 } else { 1.0 };
                Vec3::new(side(wo.x, middle.cos()), side(wo.y, middle.sin()), 1.0)
            }
        };
        (wo * flip, wi * flip)
    }

    /// The tables for a direction of incidence, and its azimuth.
    fn tables(&self, w: Vec3) -> (Mix, f32) {
        let (theta, phi) = (elevation(w), w.y.atan2(w.x));
        let ((p, s), (t, r)) = (bracket(&self.phi_i, phi), bracket(&self.theta_i, theta));
        let n = self.theta_i.len() as u32;
        // Where the table ends or has one angle only, the second share is zero and its index must still be in range.
        let (p1, t1) = (p + u32::from(s > 0.0), t + u32::from(r > 0.0));
        let shares = [(p, t, (1.0 - s) * (1.0 - r)), (p, t1, (1.0 - s) * r), (p1, t, s * (1.0 - r)), (p1, t1, s * r)];
        (Mix(shares.map(|(p, t, share)| (p * n + t, share))), phi)
    }

    /// The azimuth that the normals' tables are relative to.
    fn origin(&self, phi: f32) -> f32 {
        if self.symmetry == Symmetry::Isotropic { phi } else { 0.0 }
    }

    /// Reflectance times the cosine of `wi`, and the density of [`Measured::draw`], for both directions above.
    fn reflected(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        let (wo, wi) = self.reduced(wo, wi);
        let m = (wo + wi).normalize();
        let (mix, phi) = self.tables(wo);
        let u_m = point(elevation(m), m.y.atan2(m.x) - self.origin(phi));
        let (s, visible) = self.vndf.invert(&mix, u_m);
        let value = std::array::from_fn(|c| {
            let colour = Mix(mix.0.map(|(slice, share)| (3 * slice + c as u32, share)));
            self.rgb.eval(&colour, s)
        });
        let mut value = Rgb::from_array(value).max(Rgb::ZERO);
        if self.jacobian {
            let one = Mix::one(0);
            let sigma = self.sigma.eval(&one, point(elevation(wo), phi));
            let ratio = self.ndf.eval(&one, u_m) / (4.0 * sigma);
            value *= if ratio.is_finite() { ratio.max(0.0) } else { 0.0 };
        }
        (value, visible * self.luminance.pdf(&mix, s) / spread(m, u_m, wo))
    }

    fn draw(&self, wo: Vec3, u: Vec2, mode: Mode) -> Option<Sample> {
        let (here, _) = self.reduced(wo, wo);
        let (mix, phi) = self.tables(here);
        let (s, _) = self.luminance.sample(&mix, u);
        let (u_m, _) = self.vndf.sample(&mix, s);
        let (theta, phi_m) = (u_m.x * u_m.x * FRAC_PI_2, (2.0 * u_m.y - 1.0) * PI + self.origin(phi));
        let m = Vec3::new(theta.sin() * phi_m.cos(), theta.sin() * phi_m.sin(), theta.cos());
        let drawn = 2.0 * m.dot(here) * m - here;
        // The symmetries are their own inverses.
        let wi = drawn * self.reduced(wo, Vec3::ONE).1;
        if wi.z <= 0.0 {
            return None;
        }
        // By the same way as when it is asked for, so that both agree where rounding moves a normal over a cell's edge.
        let (f, pdf_w) = self.eval_pdf(Vec2::ZERO, wo, wi, mode);
        let flags = Flags::REFLECTION.or(Flags::GLOSSY);
        (pdf_w > 0.0).then(|| Sample { wi, weight: f * (wi.z / pdf_w), pdf_w, flags, eta: 1.0 })
    }
}

impl CustomBsdf for Measured {
    fn eval_pdf(&self, _: Vec2, wo: Vec3, wi: Vec3, mode: Mode) -> (Rgb, f32) {
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return (Rgb::ZERO, 0.0);
        }
        let (value, pdf_w) = self.reflected(wo, wi);
        match mode {
            Mode::Radiance => (value / wi.z.max(1e-6), pdf_w),
            Mode::Importance => (self.reflected(wi, wo).0 / wo.z.max(1e-6), pdf_w),
        }
    }

    fn sample(&self, _: Vec2, wo: Vec3, _: f32, u: Vec2, mode: Mode) -> Option<Sample> {
        if wo.z <= 0.0 { None } else { self.draw(wo, u, mode) }
    }

    fn flags(&self) -> Flags {
        Flags::REFLECTION.or(Flags::GLOSSY)
    }

    fn albedo(&self, _: Vec2) -> Rgb {
        self.albedo
    }
}

/// Angle to the normal, exact where the cosine is flat.
fn elevation(w: Vec3) -> f32 {
    w.x.hypot(w.y).atan2(w.z)
}

/// A direction's point of the unit square.
fn point(theta: f32, phi: f32) -> Vec2 {
    let turn = (phi + PI) / TAU;
    Vec2::new((theta.clamp(0.0, FRAC_PI_2) / FRAC_PI_2).sqrt(), turn - turn.floor())
}

/// Solid angle of reflected directions for the square's area at the normal m: |∂m/∂u| = 2π² u sin θ, times 4 wo·m.
fn spread(m: Vec3, u_m: Vec2, wo: Vec3) -> f32 {
    (TAU * PI * u_m.x * m.x.hypot(m.y)).max(1e-6) * 4.0 * wo.dot(m).max(1e-6)
}

/// Where `x` is among increasing values: an index and the share of the next; the ends go on.
fn bracket(values: &[f32], x: f32) -> (u32, f32) {
    let after = values.partition_point(|&v| v <= x);
    let (Some(i), Some(&next)) = (after.checked_sub(1), values.get(after)) else {
        return (after.saturating_sub(1) as u32, 0.0);
    };
    (i as u32, (x - values[i]) / (next - values[i]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Bsdf, Conductor, Custom, Distribution, Microfacets, RoughConductor};
    use translume_core::{chi2::SphereTest, rng::Pcg32, warp};

    /// Tables of a white metal with GGX microfacets, by the definitions of what they are. `turn`: the azimuths' range.
    fn metal(n: usize, au: f32, av: f32, phi_i: &[f32]) -> (Measured, Microfacets) {
        let microfacets = Microfacets::new(Distribution::Ggx, au, av);
        let isotropic = phi_i.len() <= 2;
        let direction = |theta: f32, phi: f32| Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
        let normal = |p: Vec2, origin: f32| direction(p.x * p.x * FRAC_PI_2, (2.0 * p.y - 1.0) * PI + origin);
        let grid = |n: usize| {
            let step = move |i| i as f32 / (n - 1) as f32;
            (0..n * n).map(move |i| Vec2::new(step(i % n), step(i / n)))
        };
        let pile = |values: Vec<f32>, n: usize| BilinearPile::new(values, n, n).unwrap();
        let sigma = |w: Vec3| w.z.max(1e-4) / microfacets.g1(w.with_z(w.z.max(1e-4)).normalize(), Vec3::Z);
        let theta_i: Vec<f32> = (0..24).map(|i| FRAC_PI_2 * (i as f32 / 23.0).powf(0.7)).collect();
        let (mut vndf, mut rgb, mut luminance) = (Vec::new(), Vec::new(), Vec::new());
        for &phi in phi_i {
            for &theta in &theta_i {
                let (wo, origin) = (direction(theta, phi), if isotropic { phi } else { 0.0 });
                let visible = |p: Vec2| {
                    let m = normal(p, origin);
                    let area = TAU * PI * p.x * m.x.hypot(m.y);
                    (microfacets.d(m) * wo.dot(m).max(0.0) * area / sigma(wo)).max(1e-6)
                };
                vndf.extend(grid(n).map(visible));
                let own = BilinearPile::new(vndf[vndf.len() - n * n..].to_vec(), n, n).unwrap();
                let warp = BilinearDensity::new(own).unwrap();
                // G of both directions is a product of two for this metal: σ has one of them, the colours have the other.
                let seen = |s: Vec2| {
                    let wi = crate::fresnel::reflect(wo, normal(warp.sample(&Mix::one(0), s).0, origin));
                    if wi.z > 0.0 { microfacets.g1(wi, Vec3::Z) } else { 0.0 }
                };
                let values: Vec<f32> = grid(n).map(seen).collect();
                luminance.extend(values.iter().map(|v| v.max(1e-4)));
                (0..3).for_each(|_| rgb.extend(&values));
            }
        }
        let tables = MeasuredTables {
            theta_i,
            phi_i: phi_i.to_vec(),
            ndf: pile(grid(n).map(|p| microfacets.d(normal(p, 0.0))).collect(), n),
            sigma: pile(grid(n).map(|p| sigma(normal(p, 0.0))).collect(), n),
            vndf: pile(vndf, n),
            luminance: pile(luminance, n),
            rgb: pile(rgb, n),
            jacobian: true,
        };
        (Measured::new(tables).unwrap(), microfacets)
    }

    fn cases() -> Vec<(&'static str, Measured, Microfacets)> {
        let turn = |from: f32, to: f32, n: usize| {
            (0..n).map(|i| from + (to - from) * i as f32 / (n - 1) as f32).collect::<Vec<_>>()
        };
        let cases = [
            ("isotropic", (0.3, 0.3), vec![0.0]),
            ("turn", (0.2, 0.5), turn(-PI, PI, 25)),
            ("half", (0.2, 0.5), turn(-PI, 0.0, 13)),
            ("other half", (0.2, 0.5), turn(-FRAC_PI_2, FRAC_PI_2, 13)),
            ("quarter", (0.2, 0.5), turn(-PI, -FRAC_PI_2, 7)),
        ];
        let make = |(name, (au, av), phi): (_, (f32, f32), Vec<f32>)| {
            let (measured, microfacets) = metal(40, au, av, &phi);
            (name, measured, microfacets)
        };
        cases.into_iter().map(make).collect()
    }

    /// Another model of the same metal: the tables' meaning, their symmetries and the cosine are right. What is left is interpolation.
    #[test]
    fn tables_of_a_metal_are_that_metal() {
        for (name, measured, microfacets) in cases() {
            let metal: Bsdf = RoughConductor { metal: Conductor::default(), microfacets }.into();
            let bsdf: Bsdf = Custom { model: &measured, uv: Vec2::ZERO }.into();
            let mut rng = Pcg32::new(5, 8);
            let mut errors = Vec::new();
            for _ in 0..2000 {
                let mut w = || warp::cosine_hemisphere(rng.next_f32(), rng.next_f32());
                let (wo, wi) = (w(), w());
                for mode in [Mode::Radiance, Mode::Importance] {
                    let (f, truth) = (bsdf.eval(wo, wi, mode).x, metal.eval(wo, wi, mode).x);
                    errors.push((f - truth).abs() / (truth + 0.02));
                }
            }
            errors.sort_by(f32::total_cmp);
            let (median, far) = (errors[errors.len() / 2], errors[errors.len() * 98 / 100]);
            assert!(median < 0.02 && far < 0.2, "{name}: {median} {far}");
            assert!((measured.albedo - Rgb::splat(measured.albedo.x)).length() < 1e-6);
            let us = (0..64 * 64).map(|i| Vec2::new((i % 64) as f32 + 0.5, (i / 64) as f32 + 0.5) / 64.0);
            let weights =
                us.filter_map(|u| metal.sample(Vec3::Z, 0.5, u, Mode::Radiance)).map(|sample| sample.weight.x);
            let albedo = weights.sum::<f32>() / (64.0 * 64.0);
            assert!((measured.albedo.x - albedo).abs() < 0.01, "{name}: {} for {albedo}", measured.albedo);
        }
    }

    /// False alarm: 1 % over all cases.
    #[test]
    fn samples_follow_the_density_and_carry_its_weight() {
        let test = SphereTest { rows: 10, columns: 20, mass_tolerance: 2e-3, ..SphereTest::default() };
        let directions = [Vec3::Z, Vec3::new(0.5, -0.4, 0.7), Vec3::new(-0.8, 0.3, 0.25)].map(Vec3::normalize);
        let cases = cases();
        for (name, measured, _) in &cases {
            let bsdf: Bsdf = Custom { model: measured, uv: Vec2::ZERO }.into();
            for wo in directions {
                let draw = |rng: &mut Pcg32| {
                    let u = Vec2::new(rng.next_f32(), rng.next_f32());
                    let sample = bsdf.sample(wo, 0.5, u, Mode::Radiance)?;
                    let (f, pdf_w) = bsdf.eval_pdf(wo, sample.wi, Mode::Radiance);
                    assert_eq!(sample.pdf_w, pdf_w);
                    assert!((f * sample.wi.z / pdf_w - sample.weight).length() <= 1e-4 * sample.weight.length());
                    Some(sample.wi)
                };
                let pdf = |wi| bsdf.pdf_w(wo, wi, Mode::Radiance);
                test.run(&format!("{name} from {wo}"), draw, pdf, cases.len() * directions.len()).unwrap();
            }
        }
    }

    #[test]
    fn edges_and_damaged_tables() {
        let (measured, _) = metal(8, 0.3, 0.3, &[0.0]);
        let bsdf: Bsdf = Custom { model: &measured, uv: Vec2::ZERO }.into();
        let grazing = Vec3::new(1.0, 0.0, 1e-7).normalize();
        for (wo, wi) in
            [(grazing, Vec3::Z), (Vec3::Z, grazing), (grazing, grazing), (Vec3::Z, Vec3::Z), (Vec3::X, Vec3::Z)]
        {
            for mode in [Mode::Radiance, Mode::Importance] {
                let (f, pdf) = bsdf.eval_pdf(wo, wi, mode);
                assert!(f.is_finite() && f.min_element() >= 0.0 && pdf.is_finite() && pdf >= 0.0, "{wo} {wi}");
            }
        }
        assert_eq!(bsdf.eval(Vec3::Z, Vec3::NEG_Z, Mode::Radiance), Rgb::ZERO);
        let one = |n: usize| BilinearPile::new(vec![1.0; 4 * n], 2, 2).unwrap();
        let good = || MeasuredTables {
            theta_i: vec![0.0, 1.0],
            phi_i: vec![0.0],
            ndf: one(1),
            sigma: one(1),
            vndf: one(2),
            luminance: one(2),
            rgb: one(6),
            jacobian: false,
        };
        assert!(Measured::new(good()).is_ok());
        assert!(Measured::new(MeasuredTables { theta_i: vec![1.0, 1.0], ..good() }).is_err());
        assert!(Measured::new(MeasuredTables { rgb: one(5), ..good() }).is_err());
        let odd = MeasuredTables {
            theta_i: vec![0.0],
            phi_i: vec![0.0, 0.1, 2.1],
            rgb: one(9),
            vndf: one(3),
            luminance: one(3),
            ..good()
        };
        assert!(Measured::new(odd).is_err_and(|e| e.contains("turn")));
        let dark = BilinearPile::new(vec![0.0; 8], 2, 2).unwrap();
        assert!(Measured::new(MeasuredTables { luminance: dark, ..good() }).is_err());
    }
}
