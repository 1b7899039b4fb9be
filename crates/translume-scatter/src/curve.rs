//! What a fit says about one direction: a fall-off of reflectance with distance.

use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use translume_bxdf::{Dipole, Normalized, Sources};

/// R(r) = Σ c_k e^{d_k r} [Fuchs 2005, Eq. 1].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Exponentials {
    /// Amplitudes, in the unit of the samples; some may be negative, the sum is positive everywhere.
    pub c: Vec<f64>,
    /// Decay per mm, negative, fastest first.
    pub d: Vec<f64>,
}

impl Exponentials {
    /// The value at distance `r` in mm.
    #[inline]
    pub fn value(&self, r: f64) -> f64 {
        self.c.iter().zip(&self.d).map(|(c, d)| c * (d * r).exp()).sum() // [Fuchs 2005, Eq. 1]
    }
}

/// A fitted fall-off of one of the models.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Curve {
    /// Sum of exponentials.
    Exponential(Exponentials),
    /// A diffusion dipole.
    Dipole(Dipole),
    /// Normalised diffusion.
    Normalized(Normalized),
}

impl Curve {
    /// The integral over a plane: the fraction of the light that comes back, for samples in mm⁻².
    pub fn total(&self) -> f64 {
        match self {
            Self::Exponential(e) => e.c.iter().zip(&e.d).map(|(c, d)| TAU * c / (d * d)).sum(),
            Self::Dipole(d) => d.total(),
            Self::Normalized(n) => n.albedo,
        }
    }

    /// The curve in the form that is quick to evaluate at many distances.
    pub fn evaluator(&self) -> Evaluator<'_> {
        match self {
            Self::Exponential(e) => Evaluator::Exponential(e),
            Self::Dipole(d) => Evaluator::Dipole(d.sources()),
            Self::Normalized(n) => Evaluator::Normalized(n),
        }
    }
}

/// A [`Curve`] ready to be evaluated.
pub enum Evaluator<'a> {
    /// Sum of exponentials.
    Exponential(&'a Exponentials),
    /// A diffusion dipole.
    Dipole(Sources),
    /// Normalised diffusion.
    Normalized(&'a Normalized),
}

impl Evaluator<'_> {
    /// The value at distance `r` in mm, in the unit of the samples.
    #[inline]
    pub fn value(&self, r: f64) -> f64 {
        match self {
            Self::Exponential(e) => e.value(r),
            Self::Dipole(d) => d.value(r),
            Self::Normalized(n) => n.value(r),
        }
    }
}
