//! The door for models of translucent objects, analytic and measured: where light comes out that went in elsewhere.
//!
//! What a model says is the diffuse subsurface reflectance R_d(x_i → x_o) of the equation
//!
//! L_o(x_o, ω_o) = ∫_A ∫_Ω (1/π) F_t(η, ω_o) R_d(x_i → x_o) F_t(η, ω_i) L_i(x_i, ω_i) (n_i·ω_i) dω_i dA(x_i)
//!
//! [Goesele 2004, Eq. 2], in mm⁻². Its parameters belong to x_i, so it is not symmetric. Whoever renders knows the surface, the
//! light and the Fresnel factors; the model knows R_d and at which distances from a point that is seen light is worth looking for.

use crate::Rgb;
use glam::{Vec2, Vec3};
use std::f32::consts::TAU;

/// A place on a translucent object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Site {
    /// Where, in the model's space, in mm.
    pub p: Vec3,
    /// Triangle of the mesh; 0 for other shapes.
    pub face: u32,
    /// Barycentric coordinates of its second and third corner.
    pub uv: Vec2,
}

/// A model of how light spreads under a surface.
pub trait Bssrdf: Send + Sync + std::fmt::Debug {
    /// R_d of light that enters at `from` and leaves at `to`, in mm⁻². Finite and not negative.
    fn eval(&self, from: &Site, to: &Site) -> Rgb;

    /// Distances at which to look for the light that leaves at `to`. Any density is right that is positive at all distances
    /// where [`Bssrdf::eval`] is; the nearer to it, the less noise.
    fn radii(&self, to: &Site) -> Radii<'_>;

    /// About the fraction of the light entering at `from` that leaves, ∫ R_d dA on a plane.
    fn total(&self, from: &Site) -> Rgb;

    /// No component of R_d is above this at distance `r` in mm or farther.
    fn bound(&self, r: f32) -> f32;

    /// Relative index of refraction of the capture it was made from.
    fn eta(&self) -> Option<f32> {
        None
    }

    /// Whether the model can stand on a surface of `faces` triangles with these corners (in mm; 0: not a mesh); else why not.
    ///
    /// # Errors
    /// A sentence for the user.
    fn fits(&self, _faces: usize, _corners: &dyn Fn(usize) -> [Vec3; 3]) -> Result<(), String> {
        Ok(())
    }
}

/// Most terms of [`Radii::Gammas`].
pub const MOST_GAMMAS: usize = 12;

/// A density of distances, for importance sampling.
#[derive(Clone, Debug)]
pub enum Radii<'a> {
    /// A mixture of densities k² r e^{−kr}, those of a point on a plane under e^{−kr}.
    Gammas(Gammas),
    /// A tabulated one.
    Table(&'a RadiusTable),
}

impl Radii<'_> {
    /// Draws a distance in mm by two uniform numbers, the first of which chooses a term.
    #[inline]
    pub fn sample(&self, u: Vec2) -> f32 {
        match self {
            Self::Gammas(g) => g.sample(u),
            Self::Table(t) => t.sample(u.y),
        }
    }

    /// Density per area of the plane (mm⁻²) at the distance `r`, all directions being alike.
    #[inline]
    pub fn pdf_a(&self, r: f32) -> f32 {
        match self {
            Self::Gammas(g) => g.pdf_a(r),
            Self::Table(t) => t.pdf_r(r) / (TAU * r.max(1e-12)),
        }
    }
}

/// See [`Radii::Gammas`].
#[derive(Clone, Copy, Debug)]
pub struct Gammas {
    /// Weight and decay k in mm⁻¹ of each term; the weights need not sum to 1.
    terms: [(f32, f32); MOST_GAMMAS],
    len: usize,
    total: f32,
}

impl Default for Gammas {
    fn default() -> Self {
        Self { terms: [(0.0, 1.0); MOST_GAMMAS], len: 0, total: 0.0 }
    }
}

impl Gammas {
    /// Adds a term; those without weight or decay, and those that find no room, are left out.
    pub fn push(&mut self, weight: f32, decay: f32) {
        if weight > 0.0 && weight.is_finite() && decay > 0.0 && decay.is_finite() && self.len < MOST_GAMMAS {
            self.terms[self.len] = (weight, decay);
            self.len += 1;
            self.total += weight;
        }
    }

    /// Sum of all weights so far.
    pub fn total(&self) -> f32 {
        self.total
    }

    fn terms(&self) -> &[(f32, f32)] {
        &self.terms[..self.len]
    }

    fn sample(&self, u: Vec2) -> f32 {
        let mut rest = u.x * self.total;
        let mut decay = 1.0;
        for &(weight, k) in self.terms() {
            decay = k;
            if rest < weight {
                break;
            }
            rest -= weight;
        }
        gamma2(u.y) / decay
    }

    fn pdf_a(&self, r: f32) -> f32 {
        let sum: f32 = self.terms().iter().map(|&(w, k)| w * k * k * (-k * r).exp()).sum();
        sum / (TAU * self.total.max(f32::MIN_POSITIVE))
    }
}

/// The x with 1 − (1 + x) e^{−x} = u, by Newton's method; convex on both sides of 1, so from a start on the right side it runs
/// straight in.
fn gamma2(u: f32) -> f32 {
    let (u, rest) = (f64::from(u), f64::from(1.0 - u));
    let mut x =
        if u < 0.5 { (2.0 * u).sqrt() * (1.0 + (2.0 * u).sqrt() / 3.0) } else { 1.7 - 1.3 * rest.max(1e-12).ln() };
    for _ in 0..6 {
        let e = (-x).exp();
        // (1 + x) e^{−x} − (1 − u) over its slope −x e^{−x}.
        x += ((1.0 + x) * e - rest) / (x * e).max(1e-30);
        x = x.clamp(0.0, 60.0);
    }
    x as f32
}

/// A tabulated density of distances, finer near 0: cells are equal in x with r = s (e^{kx} − 1).
#[derive(Clone, Debug)]
pub struct RadiusTable {
    cells: translume_core::distribution::Piecewise1d,
    s: f32,
    k: f32,
}

/// Cells of a [`RadiusTable`].
const CELLS: usize = 512;

impl RadiusTable {
    /// From `density` per unit of r, which need not integrate to one, up to `reach`; cells have the width of `scale` where r is
    /// as small as that. `None` where it is nowhere positive.
    pub fn new(scale: f32, reach: f32, density: impl Fn(f64) -> f64) -> Option<Self> {
        let s = scale.max(1e-6 * reach);
        let k = (reach / s).ln_1p();
        let cell = |i: usize| {
            // The mean of a few points times dr/dx.
            let at = |j: usize| {
                let e = (f64::from(k) * (i as f64 + (j as f64 + 0.5) / 4.0) / CELLS as f64).exp();
                density(f64::from(s) * (e - 1.0)) * e
            };
            ((0..4).map(at).sum::<f64>() * 0.25) as f32
        };
        let weights: Vec<f32> = (0..CELLS).map(cell).collect();
        let largest = weights.iter().copied().fold(0.0, f32::max);
        // Nothing below the reach is impossible.
        let weights: Vec<f32> = weights.iter().map(|w| w.max(1e-9 * largest)).collect();
        Some(Self { cells: translume_core::distribution::Piecewise1d::new(&weights)?, s, k })
    }

    fn sample(&self, u: f32) -> f32 {
        self.s * (self.k * self.cells.sample(u).0).exp_m1()
    }

    fn pdf_r(&self, r: f32) -> f32 {
        let x = (r / self.s).ln_1p() / self.k;
        if x < 1.0 { self.cells.pdf(x) / (self.k * (r + self.s)) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use translume_core::rng::Pcg32;
    use translume_core::stats::chi2_test;

    /// χ² of sampled distances against the density, false alarms one in a thousand.
    fn check(radii: &Radii, reach: f32) {
        let (n, bins) = (200_000usize, 60usize);
        let mut rng = Pcg32::new(3, 1);
        let mut observed = vec![0.0; bins + 1];
        for _ in 0..n {
            let r = radii.sample(Vec2::new(rng.next_f32(), rng.next_f32()));
            observed[((r / reach * bins as f32) as usize).min(bins)] += 1.0;
        }
        let width = f64::from(reach) / bins as f64;
        let integral = |i: usize| {
            let at = |j: usize| width * (i as f64 + (j as f64 + 0.5) / 200.0);
            let density = |r: f64| f64::from(radii.pdf_a(r as f32)) * std::f64::consts::TAU * r;
            (0..200).map(|j| density(at(j)) * width / 200.0).sum::<f64>() * n as f64
        };
        let mut expected: Vec<f64> = (0..bins).map(integral).collect();
        let inside: f64 = expected.iter().sum();
        assert!(inside <= 1.003 * n as f64, "the density integrates to {}", inside / n as f64);
        expected.push((n as f64 - inside).max(0.0));
        chi2_test(&observed, &expected, 1e-3).unwrap();
    }

    #[test]
    fn distances_follow_their_density() {
        let mut gammas = Gammas::default();
        gammas.push(1.0, 3.0);
        gammas.push(0.5, 0.4);
        gammas.push(-1.0, 0.4);
        gammas.push(2.0, 1.1);
        check(&Radii::Gammas(gammas), 12.0);
        let table = RadiusTable::new(0.01, 20.0, |r| r * (-r).exp() + 0.1 * (-0.3 * r).exp()).unwrap();
        check(&Radii::Table(&table), 15.0);
    }

    #[test]
    fn the_quantiles_of_gamma_2_are_inverse_to_its_distribution() {
        for u in [0.0, 1e-7, 1e-3, 0.2, 0.5, 0.9, 0.9999, 0.999_999_9] {
            let x = f64::from(gamma2(u));
            let back = 1.0 - (1.0 + x) * (-x).exp();
            assert!((back - f64::from(u)).abs() < 1e-7 + 1e-5 * f64::from(u), "{u}: {x} gives {back}");
        }
    }
}
