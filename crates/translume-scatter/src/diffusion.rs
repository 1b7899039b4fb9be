//! The baselines as families of curves to fit: diffusion dipoles and normalised diffusion.

use crate::lanes::{Block, LANES};
use crate::radial::{Datum, Family, decay};
use translume_bxdf::{Boundary, Dipole, DipoleKind, Normalized, Sources};

/// The baselines as families: parameters are logarithms, derivatives are differences.
pub(crate) struct Diffusion {
    /// `None` for normalised diffusion.
    pub(crate) boundary: Option<Boundary>,
    pub(crate) eta: f64,
    /// The samples' unit is not absolute: a factor is fitted too.
    pub(crate) free_scale: bool,
    /// Farthest sample in mm.
    pub(crate) reach: f64,
}

/// A curve and its neighbours, one for each parameter.
pub(crate) struct Neighbours {
    here: Either,
    beside: Vec<Either>,
}

enum Either {
    Sources(Sources),
    Normalized(Normalized),
}

/// Step of the differences; the curves are smooth in the logarithm of their parameters.
const STEP: f64 = 1e-5;

impl Diffusion {
    pub(crate) fn dipole(&self, kind: DipoleKind, x: &[f64]) -> Dipole {
        let scale = x.get(2).map_or(1.0, |s| s.exp());
        Dipole { kind, sigma_s_prime: x[0].exp(), sigma_a: x[1].exp(), eta: self.eta, scale }
    }

    fn curve(&self, x: &[f64]) -> Either {
        match &self.boundary {
            Some(b) => Either::Sources(self.dipole(b.kind(), x).sources_behind(b)),
            None => Either::Normalized(Normalized::new(x[0].exp(), x[1].exp())),
        }
    }
}

impl Either {
    fn value(&self, r: f64) -> f64 {
        match self {
            Self::Sources(s) => s.value(r),
            Self::Normalized(n) => n.value(r),
        }
    }
}

impl Family for Diffusion {
    type Prepared = Neighbours;

    fn parameters(&self) -> usize {
        if self.free_scale && self.boundary.is_some() { 3 } else { 2 }
    }

    fn prepare(&self, x: &[f64]) -> Option<Neighbours> {
        // e^±30 mm⁻¹ is beyond any material; there the formulas lose their digits.
        x.iter().all(|x| x.abs() < 30.0).then(|| Neighbours {
            here: self.curve(x),
            beside: (0..x.len())
                .map(|i| {
                    let mut moved = x.to_vec();
                    moved[i] += STEP;
                    self.curve(&moved)
                })
                .collect(),
        })
    }

    #[inline(always)]
    fn values<const N: usize>(&self, p: &Neighbours, r: &Block, values: &mut Block, derivatives: &mut [Block; N]) {
        for l in 0..LANES {
            values[l] = p.here.value(r[l]);
        }
        for (d, beside) in derivatives.iter_mut().zip(&p.beside) {
            for l in 0..LANES {
                d[l] = (beside.value(r[l]) - values[l]) / STEP;
            }
        }
    }

    fn starts(&self, bins: &[Datum]) -> Vec<Vec<f64>> {
        let slope = decay(bins, 0.5 * self.reach, self.reach).unwrap_or(0.0).max(0.1 / self.reach);
        let first = bins.first().map_or(0.0, |b| b.ln);
        let mut starts = Vec::new();
        for part in [0.7, 0.2] {
            let sigma_tr = part * slope;
            match self.boundary {
                None => starts.push(vec![first.clamp(-3.0, 0.0), (1.0 / (3.0 * sigma_tr)).ln()]),
                Some(_) => starts.extend([3.0, 12.0, 50.0].map(|f| {
                    let scattering: f64 = f * sigma_tr;
                    let mut x = vec![scattering.ln(), (sigma_tr * sigma_tr / (3.0 * scattering)).ln()];
                    if self.free_scale {
                        let model = self.curve(&[x[0], x[1], 0.0]).value(bins.first().map_or(0.0, |b| b.r));
                        x.push(first - model.ln());
                    }
                    x
                })),
            }
        }
        starts
    }

    fn sound(&self, x: &[f64]) -> bool {
        x.iter().all(|x| x.is_finite())
    }
}
