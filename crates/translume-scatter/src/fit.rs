//! The fit of one lit point: samples in, one fall-off per segment out.

use crate::curve::{Curve, Evaluator};
use crate::diffusion::Diffusion;
use crate::exponential::fit_sum;
use crate::lanes;
use crate::radial::{Datum, Scratch, fit};
use crate::segments::{Directed, hat, refine, samples_of};
use serde::{Deserialize, Serialize};
use translume_bxdf::{Boundary, DipoleKind, Normalized};

/// The models of the fall-off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Model {
    /// Sum of exponentials (Fuchs et al. 2005).
    Exponential,
    /// Jensen et al. 2001.
    Dipole,
    /// d'Eon 2012.
    BetterDipole,
    /// Burley 2015.
    Normalized,
}

/// What to fit. The default is the paper's isotropic model.
#[derive(Clone, Debug, PartialEq)]
pub struct Params {
    /// The model.
    pub model: Model,
    /// Most exponentials of a sum; fewer where the samples do not tell more apart.
    pub terms: usize,
    /// Directions with a fall-off of their own: 1, or at least 3.
    pub segments: usize,
    /// Relative index of refraction, for the dipoles.
    pub eta: f64,
    /// Fit a factor to the dipoles too, for samples that are not in mm⁻².
    pub free_scale: bool,
    /// The largest integral over a plane of a sum of exponentials: 1 where samples are in mm⁻² and light is not made.
    pub most: Option<f64>,
}

impl Default for Params {
    fn default() -> Self {
        Self { model: Model::Exponential, terms: 3, segments: 1, eta: 1.3, free_scale: false, most: None }
    }
}

/// The fall-off towards one direction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Segment {
    /// Its parameters.
    #[serde(flatten)]
    pub curve: Curve,
    /// Sum of the hat weights of the samples it was fitted to.
    pub samples: f64,
    /// Too few samples in this direction: it is the fit to all directions.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub borrowed: bool,
}

/// What was found out about one lit point.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PointFit {
    /// Samples above the noise floor.
    pub samples: usize,
    /// Samples left out because they are not finite.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub not_finite: usize,
    /// Root of the mean square of ln(model/sample); `None` without a fit.
    pub rms: Option<f64>,
    /// The segments, centred at azimuth 2π l/m; empty without a fit.
    pub segments: Vec<Segment>,
}

fn is_zero(n: &usize) -> bool {
    *n == 0
}

impl PointFit {
    /// The model's value at (x, y) mm from the lit point [Fuchs 2005, Eq. 3]; `None` without a fit.
    pub fn value(&self, x: f64, y: f64) -> Option<f64> {
        self.evaluator().map(|e| e.value(x, y))
    }

    /// The integral over a plane: the share of the light that comes back, for samples in mm⁻²; 0 without a fit. Blending between
    /// directions takes their mean.
    pub fn total(&self) -> f64 {
        self.segments.iter().map(|s| s.curve.total()).sum::<f64>() / self.segments.len().max(1) as f64
    }

    /// The fit in the form that is quick to evaluate at many places; `None` without a fit.
    pub fn evaluator(&self) -> Option<PointEvaluator<'_>> {
        let segments: Vec<_> = self.segments.iter().map(|s| s.curve.evaluator()).collect();
        (!segments.is_empty()).then_some(PointEvaluator { segments })
    }
}

/// A [`PointFit`] ready to be evaluated.
pub struct PointEvaluator<'a> {
    segments: Vec<Evaluator<'a>>,
}

impl PointEvaluator<'_> {
    /// The model's value at (x, y) mm from the lit point.
    pub fn value(&self, x: f64, y: f64) -> f64 {
        let (l, blend) = hat(x, y, self.segments.len());
        self.blended(x.hypot(y), l, blend)
    }

    fn blended(&self, r: f64, l: usize, blend: f64) -> f64 {
        let near = self.segments[l].value(r);
        match blend > 0.0 {
            // [Fuchs 2005, Eq. 3]
            true => (1.0 - blend) * near + blend * self.segments[(l + 1) % self.segments.len()].value(r),
            false => near,
        }
    }
}

/// A refined blend may be this much too bright: amplitudes are lowered by as much afterwards.
const ROUNDING: f64 = 1.01;

/// Weight of samples that a direction needs for a fall-off of its own.
const FEWEST: f64 = 6.0;

/// Fits points one after the other, keeping its buffers.
pub struct Fitter {
    params: Params,
    boundary: Option<Boundary>,
    samples: Vec<Directed>,
    data: Vec<Datum>,
    scratch: Scratch,
}

impl Fitter {
    /// For many points with the same parameters.
    pub fn new(params: &Params) -> Self {
        let boundary = match params.model {
            Model::Dipole => Some(Boundary::new(DipoleKind::Dipole, params.eta)),
            Model::BetterDipole => Some(Boundary::new(DipoleKind::BetterDipole, params.eta)),
            Model::Exponential | Model::Normalized => None,
        };
        Self { params: params.clone(), boundary, samples: Vec::new(), data: Vec::new(), scratch: Scratch::default() }
    }

    /// Fits a point to samples (x, y, value): mm from the lit point, and R_d; values of 0 or less are below the noise
    /// floor and left out.
    pub fn fit(&mut self, samples: &[[f32; 3]]) -> PointFit {
        let not_finite = self.take(samples);
        let free = PointFit { not_finite, ..self.fit_taken(None) };
        // Most fits keep to the bound by themselves, and the best of those is the free one.
        match self.most().filter(|most| free.total() > *most) {
            Some(most) => PointFit { not_finite, ..self.fit_taken(Some(most)) },
            None => free,
        }
    }

    /// Fits the samples that were taken.
    fn fit_taken(&mut self, most: Option<f64>) -> PointFit {
        let mut found = PointFit { samples: self.samples.len(), ..PointFit::default() };
        let m = self.params.segments;
        samples_of(&self.samples, 0, 1, &mut self.data);
        let Some((whole, cost)) = self.fit_data(most) else { return found };
        if m == 1 {
            found.rms = Some((cost / found.samples as f64).sqrt());
            found.segments = vec![Segment { curve: whole, samples: found.samples as f64, borrowed: false }];
            darken(&mut found, most);
            return found;
        }
        found.segments = (0..m).map(|l| self.fit_segment(l, &whole, most)).collect();
        self.refine(&mut found.segments, most);
        if most.is_some_and(|most| found.total() > most * ROUNDING) {
            // What no refinement made dark enough becomes the same in all directions.
            let curve = |s: &Segment| Segment { curve: whole.clone(), borrowed: true, ..*s };
            found.segments = found.segments.iter().map(curve).collect();
        }
        darken(&mut found, most);
        found.rms = self.rms(&found);
        found
    }

    /// The dipoles keep to it by themselves, but for their free scale.
    fn most(&self) -> Option<f64> {
        self.params.most.filter(|_| self.params.model == Model::Exponential)
    }

    /// What later fits may send back, as [`Params::most`].
    pub(crate) fn bound(&mut self, most: Option<f64>) {
        self.params.most = most;
    }

    /// Keeps the usable samples; the number of those that are not finite is returned.
    fn take(&mut self, samples: &[[f32; 3]]) -> usize {
        let m = self.params.segments;
        self.samples.clear();
        let mut not_finite = 0;
        for &[x, y, value] in samples {
            if !(x.is_finite() && y.is_finite() && value.is_finite()) {
                not_finite += 1;
            } else if value > 0.0 {
                let (x, y) = (f64::from(x), f64::from(y));
                let (segment, blend) = hat(x, y, m);
                let r = (x * x + y * y).sqrt();
                self.samples.push(Directed { r, ln: lanes::ln(f64::from(value)), segment, blend });
            }
        }
        not_finite
    }

    fn fit_segment(&mut self, l: usize, whole: &Curve, most: Option<f64>) -> Segment {
        samples_of(&self.samples, l, self.params.segments, &mut self.data);
        let samples = self.data.iter().map(|d| d.weight).sum();
        let enough = samples >= FEWEST;
        match self.fit_data(most).filter(|_| enough) {
            Some((curve, _)) => Segment { curve, samples, borrowed: false },
            None => Segment { curve: whole.clone(), samples, borrowed: true },
        }
    }

    /// Fits `self.data`.
    fn fit_data(&mut self, most: Option<f64>) -> Option<(Curve, f64)> {
        if self.params.model == Model::Exponential {
            let (sum, cost) = fit_sum(&self.data, self.params.terms, most, &mut self.scratch)?;
            return Some((Curve::Exponential(sum), cost));
        }
        let reach = self.data.iter().map(|d| d.r).fold(0.0, f64::max);
        let family =
            Diffusion { boundary: self.boundary, eta: self.params.eta, free_scale: self.params.free_scale, reach };
        let (x, cost) = fit(&family, &self.data, &mut self.scratch)?;
        let curve = match self.boundary {
            Some(b) => Curve::Dipole(family.dipole(b.kind(), &x)),
            None => Curve::Normalized(Normalized::new(x[0].exp(), x[1].exp())),
        };
        Some((curve, cost))
    }

    /// Refines segments of exponentials together; those of the baselines stay as they were fitted.
    fn refine(&mut self, segments: &mut [Segment], most: Option<f64>) {
        let sums: Option<Vec<_>> = segments
            .iter()
            .map(|s| match &s.curve {
                Curve::Exponential(e) => Some(e.clone()),
                _ => None,
            })
            .collect();
        if let Some(mut sums) = sums {
            let fixed: Vec<bool> = segments.iter().map(|s| s.borrowed).collect();
            refine(&mut self.samples, &mut sums, (&fixed, most), &mut self.scratch);
            segments.iter_mut().zip(sums).for_each(|(s, sum)| s.curve = Curve::Exponential(sum));
        }
    }

    fn rms(&self, found: &PointFit) -> Option<f64> {
        let model = found.evaluator()?;
        let square = |s: &Directed| (model.blended(s.r, s.segment, s.blend).ln() - s.ln).powi(2);
        Some((self.samples.iter().map(square).sum::<f64>() / self.samples.len() as f64).sqrt())
    }
}

/// Takes away what the stiffness of the bound has left above it.
fn darken(found: &mut PointFit, most: Option<f64>) {
    let Some(excess) = most.map(|most| found.total() / most).filter(|e| *e > 1.0) else { return };
    for segment in &mut found.segments {
        if let Curve::Exponential(sum) = &mut segment.curve {
            sum.c.iter_mut().for_each(|c| *c /= excess);
        }
    }
}
