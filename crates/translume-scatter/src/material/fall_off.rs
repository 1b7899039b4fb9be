//! A fitted curve in single precision, quick to evaluate.

use crate::curve::Curve;
use std::f32::consts::TAU;
use translume_bxdf::bssrdf::Gammas;
use translume_bxdf::{Normalized, Sources};

/// One fall-off.
pub(super) enum FallOff {
    /// Amplitudes and decays.
    Sum(Vec<(f32, f32)>),
    /// A dipole, with decays that are like it, near and far.
    Sources(Sources, [f32; 2], f32),
    /// Normalised diffusion.
    Normalized(Normalized),
}

impl FallOff {
    pub(super) fn new(curve: &Curve) -> Self {
        match curve {
            Curve::Exponential(e) => Self::Sum(e.c.iter().zip(&e.d).map(|(c, d)| (*c as f32, *d as f32)).collect()),
            Curve::Dipole(d) => {
                let transport = d.sigma_s_prime + d.sigma_a;
                let far = (3.0 * d.sigma_a * transport).sqrt().max(0.02 * transport);
                Self::Sources(d.sources(), [transport as f32, far as f32], d.total() as f32)
            }
            Curve::Normalized(n) => Self::Normalized(n.clone()),
        }
    }

    /// The value at distance `r` in mm.
    #[inline]
    pub(super) fn value(&self, r: f32) -> f32 {
        match self {
            Self::Sum(terms) => terms.iter().map(|(c, d)| c * (d * r).exp()).sum::<f32>().max(0.0),
            Self::Sources(s, ..) => s.value(r.into()) as f32,
            Self::Normalized(n) => n.value(r.into()) as f32,
        }
    }

    /// The integral over a plane.
    pub(super) fn total(&self) -> f32 {
        match self {
            Self::Sum(terms) => terms.iter().map(|(c, d)| TAU * c / (d * d)).sum::<f32>().max(0.0),
            Self::Sources(.., total) => *total,
            Self::Normalized(n) => n.albedo as f32,
        }
    }

    /// Terms of a density like it, for `emit`: weight and decay.
    pub(super) fn densities(&self, mut emit: impl FnMut(f32, f32)) {
        match self {
            // A term that takes away has no density, but where it does light is looked for, too.
            Self::Sum(terms) => terms.iter().for_each(|(c, d)| emit(TAU * c.abs() / (d * d), -d)),
            Self::Sources(_, [near, far], total) => {
                emit(0.5 * total, *near);
                emit(0.5 * total, *far);
            }
            Self::Normalized(n) => {
                emit(0.25 * n.albedo as f32, 1.5 / n.shape as f32);
                emit(0.75 * n.albedo as f32, 0.5 / n.shape as f32);
            }
        }
    }

    /// The slowest decay.
    pub(super) fn slowest(&self) -> f32 {
        let mut slowest = f32::INFINITY;
        self.densities(|_, k| slowest = slowest.min(k));
        slowest
    }
}

/// A share of this of all looking goes as far as the widest fall-off of the model, since x_o may be darker inside than x_i.
const WIDE: f32 = 0.1;

/// Adds the term of the widest fall-off, of decay `slowest`.
pub(super) fn widen(gammas: &mut Gammas, slowest: f32) {
    let weight = if gammas.total() > 0.0 { gammas.total() * WIDE / (1.0 - WIDE) } else { 1.0 };
    gammas.push(weight, slowest);
}
