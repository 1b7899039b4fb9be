//! Hand-held exposure brackets to radiance [Menzel 2012, §5].
//!
//! `exposures → response → alignment field → ghost confidence → weighted log merge`. [`merge_bracket`] is the whole
//! chain; its parts are one file each. Pictures come in as [`translume_image::Codes`] with a relative exposure, any
//! number from two up, in any order; the result is linear radiance in the frame of one of them, the anchor.
//!
//! This crate knows nothing about files, options or reports.

mod align;
mod box_mean;
mod bracket;
mod clip;
mod decode;
mod exposure;
mod field;
mod fill;
mod ghost;
mod global;
mod grouping;
mod lists;
mod local;
mod look;
mod merge;
mod order;
mod plane;
mod response;
mod sampling;
pub mod simulate;
mod upright;
mod warp;
mod weight;

pub use align::{Aligned, Alignment, Motion};
pub use bracket::check;
pub use exposure::Exposure;
pub use field::{Affine, Field, Grid};
pub use ghost::GhostParams;
pub use grouping::{Brackets, Fact, group, group_by_count};
pub use lists::{parse_list, parse_seconds};
pub use look::Look;
pub use merge::Weights;
pub use response::{NODES, Response};
pub use upright::one_orientation;
pub use weight::{Noise, spline};

use exposure::Shot;
use rayon::prelude::*;
use std::time::Instant;
use translume_image::Rgb32FImage;

/// What can go wrong with a bracket.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The pictures are no bracket.
    #[error("{0}")]
    Bracket(String),
    /// It is not clear which pictures form a bracket.
    #[error("it is not clear which pictures belong together: {0}")]
    Doubt(String),
    /// The response cannot be found or used.
    #[error("camera response: {0}")]
    Response(String),
}

/// Result with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

/// Options of [`merge_bracket`]; the default is the thesis' method with what this crate adds to it.
#[derive(Clone, Debug)]
pub struct Params {
    /// How far to align.
    pub alignment: Alignment,
    /// Whether to look for ghosts, and how.
    pub ghosts: Option<GhostParams>,
    /// The picture whose view the result has (index in the order given); by default the one of highest entropy.
    pub anchor: Option<usize>,
    /// A known response instead of an estimated one.
    pub response: Option<Response>,
    /// Codes are proportional to exposure.
    pub linear: bool,
    /// How pixels are weighed.
    pub weights: Weights,
    /// What the values are scaled by.
    pub scale: Scale,
}

/// The one factor that exposures leave free.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scale {
    /// Values come out as the anchor's own decoded codes: each bracket has a brightness of its own.
    Anchor,
    /// Values come out as the decoded codes of a picture of this relative exposure: brackets that are given the same have
    /// one brightness.
    Exposure(f64),
}

impl Default for Params {
    fn default() -> Self {
        Self {
            alignment: Alignment::NonLinear,
            ghosts: Some(GhostParams::default()),
            anchor: None,
            response: None,
            linear: false,
            weights: Weights::Spline,
            scale: Scale::Anchor,
        }
    }
}

/// The result of [`merge_bracket`].
#[derive(Debug)]
pub struct Merged {
    /// Linear radiance in the anchor's frame and the source's primaries, on the scale of [`Params::scale`]: mid code of an
    /// encoded picture of that exposure is 0.214, a linear picture keeps its values.
    pub radiance: Rgb32FImage,
    /// 1 where some picture shows the pixel, 0 elsewhere; `None` if no picture has transparent pixels.
    pub alpha: Option<Vec<f32>>,
    /// Relative radiance (per unit of exposure) of value 1.
    pub unit: f64,
    /// Index of the anchor.
    pub anchor: usize,
    /// The response, for sources that have one.
    pub response: Option<Response>,
    /// Alignment per picture.
    pub aligned: Vec<Aligned>,
    /// Ghost confidence per picture in the anchor's frame, 0 to 255; `None` for the anchor or without ghost removal.
    pub confidences: Vec<Option<Vec<u8>>>,
    /// Pixels of which some channel is only a bound (clipped wherever it is trusted), row by row.
    pub bounds: Vec<bool>,
    /// Seconds per stage, in order.
    pub seconds: Vec<(&'static str, f64)>,
    /// What a person should know.
    pub warnings: Vec<String>,
}

/// Linear value of mid code in an sRGB picture.
const MID: f64 = 0.2140;

/// Merges a bracket; `progress` is told the stages and pictures as they begin.
///
/// # Errors
/// [`Error::Bracket`] for pictures that cannot be merged, [`Error::Response`] when the response cannot be solved.
pub fn merge_bracket(exposures: &[Exposure], params: &Params, progress: &(dyn Fn(&str) + Sync)) -> Result<Merged> {
    check(exposures)?;
    let mut clock = Clock::start();
    let mut warnings = Vec::new();

    progress("preparing");
    let start = params.response.clone().unwrap_or_else(Response::linear);
    start.validate()?;
    let mut shots: Vec<Shot<'_>> = exposures
        .par_iter()
        .map(|e| Shot {
            name: &e.name,
            codes: &e.codes,
            log_secs: e.secs.ln() as f32,
            border: exposure::hidden(e),
            clips: None,
            decoder: exposure::decoder_of(&e.codes, &start),
        })
        .collect();
    clip::find_levels(&mut shots);
    let clips: Vec<Option<Vec<u8>>> = shots.iter().map(clip::marks).collect();
    shots.iter_mut().zip(clips).for_each(|(s, c)| s.clips = c);
    let mut order: Vec<usize> = (0..shots.len()).collect();
    order.sort_by(|a, b| exposures[*a].secs.total_cmp(&exposures[*b].secs).then(a.cmp(b)));
    let anchor = match params.anchor {
        Some(a) if a < shots.len() => a,
        Some(a) => {
            return Err(Error::Bracket(format!("--anchor {a}: there are {} pictures, counted from 0", shots.len())));
        }
        None => highest_entropy(&shots),
    };
    let hidden: Vec<Option<&[bool]>> = shots.iter().map(|s| s.border.as_deref()).collect();
    order::check(exposures, &hidden, &order, params.linear)?;
    let log_secs: Vec<f64> = exposures.iter().map(|e| e.secs.ln()).collect();
    let solve = params.response.is_none() && !params.linear && !exposures[0].codes.is_linear();
    if solve {
        let samples = std::array::from_fn(|c| sampling::quantile_samples(&shots, c));
        set_all(&mut shots, &response::solve(&samples, &log_secs, None)?);
    }
    clock.lap("prepare");

    progress("aligning");
    let aligned = align::align(&shots, &order, anchor, params.alignment, progress);
    warnings.extend(aligned.iter().filter_map(|a| a.note.clone()));
    clock.lap("align");

    progress("response");
    let points = sampling::aligned_points(&shots, &aligned, anchor);
    if solve {
        let samples: [Vec<response::Sample>; 3] =
            std::array::from_fn(|c| sampling::comparagram_samples(&shots, &points, &order, c));
        // Too few flat points (a tiny picture): the histogram's curve stands.
        let preliminary = shots[anchor].response().cloned();
        if let Ok(r) = response::solve(&samples, &log_secs, preliminary.as_ref()) {
            set_all(&mut shots, &r);
        }
    }
    let corrections = balance(&mut shots, &points, &order, anchor);
    warnings.extend(corrections.iter().zip(&shots).filter(|(ev, _)| ev.abs() > 0.25).map(|(ev, s)| {
        format!("{}: its pixels say {ev:+.2} EV against the exposure given; merged as the pixels say", s.name)
    }));
    clock.lap("response");

    progress("ghosts");
    let confidences = match &params.ghosts {
        Some(g) => ghost::confidences(&shots, &aligned, &points, &order, anchor, g),
        None => vec![None; shots.len()],
    };
    clock.lap("ghosts");

    progress("merging");
    let (shortest, longest) = (order[0], order[order.len() - 1]);
    let job = merge::Merge {
        shots: &shots,
        aligned: &aligned,
        confidences: &confidences,
        anchor,
        shortest,
        longest,
        weights: params.weights,
    };
    let (mut values, trust) = merge::merge(&job);
    fill::fill(&mut values, &trust, shots[anchor].width());
    let bounds = trust.iter().map(|t| *t != merge::Trust::Measured).collect();
    let mid = if exposures[0].codes.is_linear() { 1.0 } else { MID };
    let log_reference = match params.scale {
        Scale::Anchor => f64::from(shots[anchor].log_secs),
        Scale::Exposure(e) => e.ln(),
    };
    let scale = log_reference + mid.ln();
    values.par_iter_mut().for_each(|v| *v = (*v + scale as f32).exp());
    let alpha = alpha(exposures, &trust, &mut values);
    clock.lap("merge");

    let (w, h) = (shots[anchor].width() as u32, shots[anchor].height() as u32);
    let response = shots[anchor].response().cloned();
    let radiance = Rgb32FImage::from_raw(w, h, values).ok_or_else(|| Error::Bracket("picture too large".into()))?;
    Ok(Merged {
        radiance,
        alpha,
        unit: (-scale).exp(),
        anchor,
        response,
        aligned,
        confidences,
        bounds,
        seconds: clock.laps,
        warnings,
    })
}

/// Alpha of the result, if a picture has transparent pixels; what none shows is black then.
fn alpha(exposures: &[Exposure], trust: &[merge::Trust], values: &mut [f32]) -> Option<Vec<f32>> {
    let has_alpha = |e: &Exposure| e.alpha.as_ref().is_some_and(|a| a.iter().any(|a| *a < 1.0));
    if !exposures.iter().any(has_alpha) {
        return None;
    }
    let seen = |t: &merge::Trust| *t != merge::Trust::Unseen;
    for (p, _) in values.as_chunks_mut::<3>().0.iter_mut().zip(trust).filter(|(_, t)| !seen(t)) {
        *p = [0.0; 3];
    }
    Some(trust.iter().map(|t| f32::from(u8::from(seen(t)))).collect())
}

fn set_all(shots: &mut [Shot<'_>], response: &Response) {
    shots.iter_mut().for_each(|s| s.set_response(response));
}

/// Seconds per stage.
struct Clock {
    last: Instant,
    laps: Vec<(&'static str, f64)>,
}

impl Clock {
    fn start() -> Self {
        Self { last: Instant::now(), laps: Vec::new() }
    }

    fn lap(&mut self, name: &'static str) {
        self.laps.push((name, self.last.elapsed().as_secs_f64()));
        self.last = Instant::now();
    }
}

/// The picture whose histogram of green codes has the highest entropy [Menzel 2012, §5.1 anchor]; of equals the first.
fn highest_entropy(shots: &[Shot<'_>]) -> usize {
    let entropies: Vec<f64> = shots
        .par_iter()
        .map(|s| {
            let mut counts = [0.0f64; 256];
            let mut row = vec![0.0f32; 3 * s.width()];
            for y in (0..s.height()).step_by((s.height() / 400).max(1)) {
                s.unit_row(y, &mut row);
                for (x, p) in row.chunks_exact(3).enumerate() {
                    if s.is_picture(y * s.width() + x) {
                        counts[(s.decoder.encoded(p[1]) * 255.0 + 0.5) as usize] += 1.0;
                    }
                }
            }
            let total: f64 = counts.iter().sum();
            counts.iter().filter(|c| **c > 0.0).map(|c| -(c / total) * (c / total).ln()).sum()
        })
        .collect();
    (0..shots.len()).fold(0, |best, i| if entropies[i] > entropies[best] + 1e-9 { i } else { best })
}

/// Green codes that both pictures of a pair record well, on common points.
fn well_exposed(shots: &[Shot<'_>], points: &[sampling::Point], a: usize, b: usize) -> Vec<(f32, f32)> {
    let good = |d: &decode::Decoder, u: f32| (0.1..0.9).contains(&d.encoded(u)) && !d.is_clipped(1, u);
    let pair = |p: &sampling::Point| Some((p.codes[a]?[1], p.codes[b]?[1]));
    points.iter().filter_map(pair).filter(|(u, v)| good(&shots[a].decoder, *u) && good(&shots[b].decoder, *v)).collect()
}

/// Fewest common points that say something about a pair.
const FEWEST: usize = 20;

/// Corrects each exposure by what common pixels say (shutters are off by a tenth of a stop and more); returns the
/// corrections in EV.
fn balance(shots: &mut [Shot<'_>], points: &[sampling::Point], order: &[usize], anchor: usize) -> Vec<f32> {
    let mut corrections = vec![0.0f32; shots.len()];
    let at = order.iter().position(|i| *i == anchor).unwrap_or(0);
    let longer = order[at..].windows(2).map(|w| (w[0], w[1]));
    let shorter = order[..=at].windows(2).rev().map(|w| (w[1], w[0]));
    for (from, to) in longer.chain(shorter).collect::<Vec<_>>() {
        let l = |i: usize, u: f32| shots[i].decoder.log_exposure(1, u) - shots[i].log_secs;
        let mut differences: Vec<f32> =
            well_exposed(shots, points, from, to).iter().map(|(u, v)| l(to, *v) - l(from, *u)).collect();
        if differences.len() < FEWEST {
            continue;
        }
        let mid = differences.len() / 2;
        let median = *differences.select_nth_unstable_by(mid, f32::total_cmp).1;
        shots[to].log_secs += median;
        corrections[to] = median / std::f32::consts::LN_2;
    }
    corrections
}

/// Share of pixels whose confidence is below one half, per picture.
pub fn ghost_share(confidence: &[u8]) -> f64 {
    confidence.iter().filter(|c| **c < 128).count() as f64 / confidence.len().max(1) as f64
}
