//! The fit: per channel or with one fall-off for all of them, then the modulation texture.

use super::samples::{PlanarCapture, Spot, held_out};
use crate::fit::{Fitter, Params, PointFit};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use translume_image::Result;

/// What to fit.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanarParams {
    /// The fall-off.
    pub fit: Params,
    /// One fall-off for all channels, with a factor for each [Fuchs 2005, Eq. 5].
    pub shared: bool,
    /// The texture is made from samples between these multiples of the noise threshold and of the frame's brightest
    /// sample: t2 and t1 of [Fuchs 2005, Eq. 6].
    pub texture_range: (f64, f64),
}

impl Default for PlanarParams {
    fn default() -> Self {
        Self { fit: Params { segments: 8, ..Params::default() }, shared: false, texture_range: (4.0, 0.1) }
    }
}

/// The fall-off around one lit point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LitPoint {
    /// Where, in mm.
    pub at_mm: [f64; 2],
    /// Factor of each channel; 1 without a shared fall-off.
    pub scale: Vec<f64>,
    /// Fall-off of each channel, or the one shared by all.
    pub fall_off: Vec<PointFit>,
}

/// A model of a planar sample.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanarModel {
    /// Lit points, as the spots of the capture.
    pub points: Vec<LitPoint>,
    /// α for each view, channel and pixel; 1 where nothing was measured. Kept in files of its own.
    #[serde(skip)]
    pub texture: Vec<Vec<Vec<f32>>>,
    /// Samples behind each of these values.
    #[serde(skip)]
    pub texture_samples: Vec<Vec<Vec<f32>>>,
}

impl LitPoint {
    /// R_d without texture at (x, y) mm in a channel; `None` without a fit.
    fn evaluator(&self, channel: usize) -> Option<impl Fn([f64; 2]) -> f64 + '_> {
        let shared = self.fall_off.len() == 1;
        let curve = self.fall_off[if shared { 0 } else { channel }].evaluator()?;
        let (scale, at) = (self.scale[channel], self.at_mm);
        // [Fuchs 2005, Eq. 5]
        Some(move |p: [f64; 2]| scale * curve.value(p[0] - at[0], p[1] - at[1]))
    }
}

impl LitPoint {
    /// R_d without texture, at (x, y) mm from the point; `None` without a fit.
    pub fn value(&self, [x, y]: [f64; 2], channel: usize) -> Option<f64> {
        self.evaluator(channel).map(|e| e([x + self.at_mm[0], y + self.at_mm[1]]))
    }
}

impl PlanarModel {
    /// α R_d for all pixels of a spot's frame, 0 where there is no model.
    pub fn predict(&self, capture: &PlanarCapture, spot: usize, channel: usize) -> Vec<f64> {
        let view = capture.spots[spot].frame[0];
        let texture = &self.texture[view][channel];
        match self.points[spot].evaluator(channel) {
            // [Fuchs 2005, Eq. 2]
            Some(model) => capture.places(view).zip(texture).map(|(p, a)| f64::from(*a) * model(p)).collect(),
            None => vec![0.0; texture.len()],
        }
    }
}

/// Fits `capture`; `progress` is called for each lit point.
///
/// # Errors
/// Those of reading frames.
pub fn fit_planar(capture: &PlanarCapture, params: &PlanarParams, progress: impl Fn() + Sync) -> Result<PlanarModel> {
    let make = || Fitter::new(&params.fit);
    let one = |fitter: &mut Fitter, (index, spot): (usize, &Spot)| {
        let samples = samples(capture, index, spot)?;
        progress();
        Ok(match params.shared {
            true => {
                let (scale, fall_off) = fit_shared(fitter, &samples, params.fit.most);
                LitPoint { at_mm: spot.at, scale, fall_off: vec![fall_off] }
            }
            false => LitPoint {
                at_mm: spot.at,
                scale: vec![1.0; samples.len()],
                fall_off: samples.iter().map(|s| fitter.fit(s)).collect(),
            },
        })
    };
    let points: Result<Vec<LitPoint>> = capture.spots.par_iter().enumerate().map_init(make, one).collect();
    let mut model = PlanarModel { points: points?, texture: Vec::new(), texture_samples: Vec::new() };
    modulate(capture, params, &mut model)?;
    Ok(model)
}

/// The samples (x, y from the spot, R_d) of each channel that are not held out; the same pixels in each, 0 under the noise.
fn samples(capture: &PlanarCapture, index: usize, spot: &Spot) -> Result<Vec<Vec<[f32; 3]>>> {
    (0..capture.capture.rig.channels.len())
        .map(|channel| {
            let values = capture.reflectance(spot, channel)?;
            let place = |(i, (value, at)): (usize, (f32, [f64; 2]))| {
                let used = !held_out(index, i) && at[0].is_finite();
                used.then(|| [(at[0] - spot.at[0]) as f32, (at[1] - spot.at[1]) as f32, value])
            };
            Ok(values.into_iter().zip(capture.places(spot.frame[0])).enumerate().filter_map(place).collect())
        })
        .collect()
}

/// One fall-off for all channels [Fuchs 2005, Eq. 5]: factors by the mean logarithm over pixels that all channels see, a fit to all samples on the
/// first channel's level, and factors again by the mean logarithm against the fit. `samples` are the same places in each channel. `most` may
/// come back in the brightest channel, over a plane.
pub(crate) fn fit_shared(fitter: &mut Fitter, samples: &[Vec<[f32; 3]>], most: Option<f64>) -> (Vec<f64>, PointFit) {
    let brightest = |logs: &[f64]| logs.iter().copied().fold(f64::NEG_INFINITY, f64::max).exp();
    let channels = samples.len();
    let ratio = |c: usize| {
        let both = samples[0].iter().zip(&samples[c]).filter(|(a, b)| a[2] > 0.0 && b[2] > 0.0);
        mean(both.map(|(a, b)| f64::from(b[2] / a[2]).ln())).unwrap_or(0.0)
    };
    let mut logs: Vec<f64> = (0..channels).map(ratio).collect();
    let mut fall_off = PointFit::default();
    for _ in 0..2 {
        let scaled = samples.iter().zip(&logs).flat_map(|(s, l)| {
            let factor = (-l).exp() as f32;
            s.iter().map(move |&[x, y, v]| [x, y, v * factor])
        });
        fitter.bound(most.map(|m| m / brightest(&logs)));
        fall_off = fitter.fit(&scaled.collect::<Vec<_>>());
        let Some(model) = fall_off.evaluator() else { break };
        for (log, s) in logs.iter_mut().zip(samples) {
            let lit = s.iter().filter(|s| s[2] > 0.0);
            let above = lit.map(|s| f64::from(s[2]).ln() - model.value(f64::from(s[0]), f64::from(s[1])).ln());
            *log = mean(above).unwrap_or(*log);
        }
    }
    let excess = most.map_or(1.0, |m| (fall_off.total() * brightest(&logs) / m).max(1.0));
    (logs.into_iter().map(|l| l.exp() / excess).collect(), fall_off)
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, n) = values.fold((0.0, 0usize), |(s, n), v| (s + v, n + 1));
    (n > 0).then(|| sum / n as f64)
}

/// α(x_o): the mean over x_i of sample/model, for samples of medium intensity.
///
/// [Fuchs 2005, Eq. 6], corrected: the average runs over x_i for a fixed x_o.
fn modulate(capture: &PlanarCapture, params: &PlanarParams, model: &mut PlanarModel) -> Result<()> {
    let rig = &capture.capture.rig;
    let pixels = capture.capture.frames.pixels();
    let empty = vec![vec![vec![0.0f32; pixels]; rig.channels.len()]; rig.views.len()];
    let (mut sums, mut counts) = (empty.clone(), empty);
    for (index, spot) in capture.spots.iter().enumerate() {
        let view = spot.frame[0];
        for channel in 0..rig.channels.len() {
            let values = capture.reflectance(spot, channel)?;
            let Some(curve) = model.points[index].evaluator(channel) else { continue };
            // `reflectance` has cut at the threshold; its smallest value stands for it.
            let faint = values.iter().copied().filter(|v| *v > 0.0).fold(f32::INFINITY, f32::min);
            let peak = values.iter().copied().fold(0.0, f32::max);
            let (t2, t1) = (params.texture_range.0 as f32 * faint, params.texture_range.1 as f32 * peak);
            for (i, (value, place)) in values.iter().zip(capture.places(view)).enumerate() {
                if *value > t2 && *value < t1 && !held_out(index, i) {
                    // [Fuchs 2005, Eq. 6]
                    sums[view][channel][i] += (f64::from(*value) / curve(place)) as f32;
                    counts[view][channel][i] += 1.0;
                }
            }
        }
    }
    for (sum, count) in sums.iter_mut().flatten().zip(counts.iter().flatten()) {
        sum.iter_mut().zip(count).for_each(|(s, n)| *s = if *n > 0.0 { *s / n } else { 1.0 });
    }
    (model.texture, model.texture_samples) = (sums, counts);
    Ok(())
}
