//! Weights of the ways to make a path: merging at any of its vertices, the camera's path meeting the light, or emitter sampling
//! at the camera's last vertex.
//!
//! Source: Bekaert et al. 2003, §4.1. For the path z₀ … z_k let p_j be the density of merging at z_j: the light's walk made
//! z₀ … z_{j−1}, the camera's z_j … z_k. Two rules:
//!
//! - eq. 9, extended to all merges (errata): p_j = Π_{i≤j} p^L(z_i) Π_{i≥j} p^E(z_i), the footprint taken as a constant area;
//! - the default (`weights`): without p^L(z_j), which the radius R ∝ 1/√p^L(z_j) cancels. A merge is then what it is, a connection of
//!   z_{j−1} to z_j that is made c = N π h² times.
//!
//! Either way p_j = g_j Π_{i<j} p^L(z_i) Π_{i≥j} p^E(z_i), with g_j = c χ_j or κ p^L(z_j), and g = 1 for the camera's path that meets the
//! light; emitter sampling has the density p^D(z₀) in the place of p^E(z₀). χ_j ≤ 1 is the part of the c links that footprints of bounded size
//! leave at flat angles ([`Landing`]): trusted like the others, rare links of large value would be fireflies. p^D counts more the less its samples
//! differ ([`Weighing::emitters`]). Neighbours differ by one vertex, so sums run along the two walks: with r_i = p^L(z_i)/p^E(z_i) on the
//! camera's side A = r_t (g_{t−1} + r_{t−1} (g_{t−2} + …)), with q_i = p^E(z_i)/p^L(z_i) on the light's B = q_m (g_m + q_{m−1} (…)),
//! and w = g/(g + A + B); by default all g, r and q are squared first (Veach's power heuristic). What depends only on the walk is kept with the
//! vertex (`behind`).
//!
//! That merges at a vertex share the camera's path to it is an option: see `correlation`. What paths of a group have in common is always
//! known: see `share`.

use super::super::arrival::IncidentFrom;
use super::light::LEAST_COS;

/// How merges are weighed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Weighing {
    /// c, or κ of eq. 9.
    pub(crate) scale: f32,
    /// Eq. 9.
    pub(crate) printed: bool,
    /// How much a sample of a light at a camera path's first vertex counts, see [`super::pilot`]; farther on it counts as one, since what it has in
    /// common with others, the path to there, is not steady. 0: none are taken.
    pub(crate) emitters: f32,
    /// N π r² of photon merging, with g = N π r² p^L(z_j); 0 where there is none.
    pub(crate) photons: f32,
    /// Of the bandwidth.
    pub(crate) least: f32,
    /// See [`super::correlation`]; 0: the weights do not know.
    pub(crate) alike: f32,
}

/// A place of a light path.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Landing {
    /// Density per area of the light's walk.
    pub(crate) pdf: f32,
    /// The part of the c links that light paths which land here can make, where footprints are not as large as their density asks for.
    pub(crate) chance: f32,
}

/// What may happen at a vertex.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    /// Nothing: the vertex scatters in single directions.
    Closed,
    /// A link to the vertex before it on the light's side.
    Link,
    /// That one scatters in single directions: photons are merged.
    Merge,
}

impl Way {
    /// At a vertex that is `delta` or not, after one that is `before` or not.
    #[inline]
    pub(crate) fn of(delta: bool, before: bool) -> Self {
        match (delta, before) {
            (true, _) => Self::Closed,
            (false, true) => Self::Merge,
            (false, false) => Self::Link,
        }
    }
}

impl Weighing {
    /// Where the light's walk has density `pdf` per area, in this `reach` of the vertex before.
    #[inline]
    pub(crate) fn landing(&self, pdf: f32, reach: IncidentFrom) -> Landing {
        let chance = match reach {
            IncidentFrom::Point(d) => pdf * d * d / self.least,
            IncidentFrom::Direction(across) => pdf / (LEAST_COS * across),
        };
        Landing { pdf, chance: if self.least > 0.0 { chance.min(1.0) } else { 1.0 } }
    }

    /// g of what may happen at a vertex where the light's walk may land.
    #[inline]
    pub(crate) fn own(&self, way: Way, at: Landing) -> f32 {
        self.power(self.made(way, at))
    }

    /// The same before powers: how many times it is made.
    #[inline]
    pub(crate) fn made(&self, way: Way, at: Landing) -> f32 {
        match way {
            Way::Closed => 0.0,
            Way::Merge => self.photons * at.pdf,
            Way::Link if self.printed => self.scale * at.pdf,
            Way::Link => self.scale * at.chance,
        }
    }

    /// The power heuristic; eq. 9 is the balance heuristic.
    #[inline]
    fn power(&self, x: f32) -> f32 {
        if self.printed { x } else { x * x }
    }

    /// One vertex on: a bracket times the ratio of densities there.
    #[inline]
    pub(crate) fn times(&self, ratio: f32, bracket: f32) -> f32 {
        if bracket > 0.0 && ratio.is_finite() { self.power(ratio) * bracket } else { 0.0 }
    }

    /// The sum in brackets at the light: the camera's path may meet it, unless it has no extent.
    #[inline]
    pub(crate) fn of_light(&self, delta: bool) -> f32 {
        if delta { 0.0 } else { 1.0 }
    }

    /// How much a sample of a light counts at a camera path's `first` vertex, or another one.
    #[inline]
    pub(crate) fn sampled(&self, first: bool) -> f32 {
        if first { self.emitters } else { self.emitters.min(1.0) }
    }

    /// Emitter sampling beside what else may happen; `ratio` is its density of the light's point over the other's.
    #[inline]
    pub(crate) fn direct(&self, first: bool, ratio: f32) -> f32 {
        self.times(self.sampled(first) * ratio, 1.0)
    }

    /// A bracket around `inner`: what may happen at a vertex where the light's walk may land, and what lies behind.
    #[inline]
    pub(crate) fn add(&self, way: Way, at: Landing, ratio: f32, inner: f32) -> f32 {
        self.around(self.made(way, at), ratio, inner)
    }

    /// The same where it is known how many times it is made.
    #[inline]
    pub(crate) fn around(&self, made: f32, ratio: f32, inner: f32) -> f32 {
        self.power(made) + self.times(ratio, inner)
    }
}
