//! Weights of the techniques that can make a path: connecting or merging at any of its vertices, the camera's path
//! meeting the light, or emitter sampling at the camera's last vertex.
//!
//! Source: Bekaert et al. 2003, §4.1, with other densities than eq. 9 has; Georgiev et al. 2012 and SmallVCM for the
//! sums along the two walks. For the path z₀ … z_k let p_j be the density of the technique at z_j: the light's walk
//! made z₀ … z_{j−1}, the camera's z_j … z_k. It is p_j = g_j Π_{i<j} p^L(z_i) Π_{i≥j} p^E(z_i). p^L(z_j) is missing:
//! the radius R ∝ 1/√p^L(z_j) cancels it, so that a link is what it is, a connection of z_{j−1} to z_j that is made g_j
//! = c χ_j times, c = N π h² times the part of the candidates that become trial links. χ_j ≤ 1, the acceptance, is the
//! part of the c links that footprints of bounded size leave at flat angles ([`LightPdf`]): trusted like the others,
//! rare links of large value would be fireflies. A photon is merged g_j = N π r² p^L(z_j) times. g = 1 for the camera's
//! path that meets the light; emitter sampling has the density p^D(z₀) in the place of p^E(z₀), and counts more the
//! less its samples differ ([`MisWeights::emitters`]).
//!
//! The weight is p_j²/Σ p_i² (Veach's power heuristic). Neighbours differ by one vertex, so the sum runs along the two
//! walks, and what depends on one walk alone is kept with its vertices, over the square of the technique's density
//! there:
//!
//! - dVCM: of emitter sampling at the light path's first vertex (in SmallVCM this starts the sums as well);
//! - dVC: of all that may happen farther back on the walk, connections and merges in one sum, since at a vertex only
//!   one of them can (SmallVCM's dVC and dVM, which differ by the constant factor of a merge).
//!
//! What paths of a group have in common is in `share`.

use super::super::arrival::IncidentFrom;
use super::light::MIN_COS;

/// How techniques are weighed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MisWeights {
    /// c.
    pub(crate) links: f32,
    /// Variance factor of samples of a light at a camera path's first vertex, see [`super::calibration`]; farther on
    /// they count as one, since what they have in common with others, the path to there, varies. 0: none are taken.
    pub(crate) emitters: f32,
    /// N π r² of photon merging; 0 where there is none.
    pub(crate) photons: f32,
    /// Of the bandwidth.
    pub(crate) min_pdf: f32,
}

/// The light's walk at a place where it may arrive.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LightPdf {
    /// Density per area.
    pub(crate) pdf: f32,
    /// χ: the part of the c links that light paths which arrive here can make, where footprints are not as large as
    /// their density asks for.
    pub(crate) acceptance: f32,
}

/// What may happen at a vertex.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Technique {
    /// Nothing: the vertex scatters in single directions.
    None,
    /// A link to the vertex before it on the light's side.
    Connect,
    /// That one scatters in single directions: photons are merged.
    Merge,
}

impl Technique {
    /// At a vertex that is `delta` or not, after one on the light's side that is `before` or not.
    #[inline]
    pub(crate) fn of(delta: bool, before: bool) -> Self {
        match (delta, before) {
            (true, _) => Self::None,
            (false, true) => Self::Merge,
            (false, false) => Self::Connect,
        }
    }
}

impl MisWeights {
    /// Where the light's walk has density `pdf` per area, with light from there.
    #[inline]
    pub(crate) fn light_pdf(&self, pdf: f32, from: IncidentFrom) -> LightPdf {
        let acceptance = match from {
            IncidentFrom::Point(d) => pdf * d * d / self.min_pdf,
            IncidentFrom::Direction(across) => pdf / (MIN_COS * across),
        };
        LightPdf { pdf, acceptance: acceptance.min(1.0) }
    }

    /// g², of what may happen at a vertex where the light's walk may arrive.
    #[inline]
    pub(crate) fn density(&self, technique: Technique, at: LightPdf) -> f32 {
        let g = match technique {
            Technique::None => 0.0,
            Technique::Merge => self.photons * at.pdf,
            Technique::Connect => self.links * at.acceptance,
        };
        g * g
    }

    /// One vertex on: a sum over the square of one density, times the ratio of densities of the two neighbours.
    #[inline]
    pub(crate) fn onward(&self, ratio: f32, sum: f32) -> f32 {
        if sum > 0.0 && ratio.is_finite() { ratio * ratio * sum } else { 0.0 }
    }

    /// The sum at a vertex: what may happen there, and `ratio` on, what may happen behind it.
    #[inline]
    pub(crate) fn sum(&self, technique: Technique, at: LightPdf, ratio: f32, behind: f32) -> f32 {
        self.density(technique, at) + self.onward(ratio, behind)
    }

    /// The sum at the light: the camera's path may meet it, unless it has no extent.
    #[inline]
    pub(crate) fn at_light(&self, delta: bool) -> f32 {
        if delta { 0.0 } else { 1.0 }
    }

    /// How much a sample of a light counts at a camera path's `first` vertex, or another one.
    #[inline]
    pub(crate) fn emitter_factor(&self, first: bool) -> f32 {
        if first { self.emitters } else { self.emitters.min(1.0) }
    }

    /// Emitter sampling beside what else may happen; `ratio` is its density of the light's point over the other's.
    #[inline]
    pub(crate) fn emitter_sampling(&self, first: bool, ratio: f32) -> f32 {
        self.onward(self.emitter_factor(first) * ratio, 1.0)
    }
}

/// The weight of a technique of this squared density among others, of which these are the sums of squares on either
/// side.
#[inline]
pub(crate) fn mis_weight(own: f32, camera: f32, light: f32) -> f32 {
    own / (own + camera + light)
}
