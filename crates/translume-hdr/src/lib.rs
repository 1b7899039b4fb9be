//! Hand-held exposure brackets to radiance [Menzel, thesis, ch. 5].
//!
//! `exposures → response → alignment field → ghost confidence → weighted log merge`. [`merge_bracket`] is the whole
//! chain; its parts are one file each. Pictures come in as [`translume_image::Codes`] with a relative exposure, any
//! number from two up, in any order; the result is linear radiance in the frame of one of them, the anchor.
//!
//! This crate knows nothing about files, options or reports.

mod align;
mod decode;
mod exposure;
mod field;
mod ghost;
mod global;
mod local;
mod merge;
mod plane;
mod response;
mod sampling;
mod warp;
mod weight;

pub use align::{Aligned, Alignment};
pub use exposure::{Exposure, check};
pub use field::{Affine, Field, Grid};
pub use ghost::GhostParams;
pub use merge::Weights;
use response::solve_channel;
pub use response::{NODES, Response};
pub use weight::{Noise, spline};

use exposure::Shot;
use rayon::prelude::*;
use std::time::Instant;
use translume_image::{Rgb32FImage, Samples};

/// What can go wrong with a bracket.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The pictures are no bracket.
    #[error("{0}")]
    Bracket(String),
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
        }
    }
}

/// The result of [`merge_bracket`].
#[derive(Debug)]
pub struct Merged {
    /// Linear radiance in the anchor's frame and the source's primaries, scaled so that the anchor's values come out as
    /// its own decoded codes: mid code of an encoded picture is 0.214, a linear picture keeps its values.
    pub radiance: Rgb32FImage,
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
            border: exposure::find_border(&e.codes),
            decoder: exposure::decoder_of(&e.codes, &start),
        })
        .collect();
    let mut order: Vec<usize> = (0..shots.len()).collect();
    order.sort_by(|a, b| exposures[*a].secs.total_cmp(&exposures[*b].secs).then(a.cmp(b)));
    let anchor = match params.anchor {
        Some(a) if a < shots.len() => a,
        Some(a) => {
            return Err(Error::Bracket(format!("--anchor {a}: there are {} pictures, counted from 0", shots.len())));
        }
        None => highest_entropy(&shots),
    };
    let solve = params.response.is_none() && !params.linear && !exposures[0].codes.is_linear();
    if solve {
        let samples = std::array::from_fn(|c| sampling::quantile_samples(&shots, c));
        set_all(&mut shots, &solve_response(&samples, exposures, None)?);
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
        if let Ok(r) = solve_response(&samples, exposures, preliminary.as_ref()) {
            set_all(&mut shots, &r);
        }
    }
    warnings.extend(check_ratios(&shots, &points, &order));
    clock.lap("response");

    progress("ghosts");
    let confidences = match &params.ghosts {
        Some(g) => ghost::confidences(&shots, &aligned, &order, anchor, g),
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
    let (mut values, bounds) = merge::merge(&job);
    let mid = if exposures[0].codes.is_linear() { 1.0 } else { MID };
    let scale = f64::from(shots[anchor].log_secs) + mid.ln();
    values.par_iter_mut().for_each(|v| *v = (*v + scale as f32).exp());
    clock.lap("merge");

    let (w, h) = (shots[anchor].width() as u32, shots[anchor].height() as u32);
    let response = shots[anchor].response().cloned();
    let radiance = Rgb32FImage::from_raw(w, h, values).ok_or_else(|| Error::Bracket("picture too large".into()))?;
    Ok(Merged {
        radiance,
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

fn solve_response(
    samples: &[Vec<response::Sample>; 3],
    exposures: &[Exposure],
    start: Option<&Response>,
) -> Result<Response> {
    let log_secs: Vec<f64> = exposures.iter().map(|e| e.secs.ln()).collect();
    let curves: Vec<Vec<f32>> = (0..3usize)
        .into_par_iter()
        .map(|c| solve_channel(&samples[c], &log_secs, start.map(|r| &r.log_exposure[c][..])))
        .collect::<Result<_>>()?;
    let [r, g, b] = <[Vec<f32>; 3]>::try_from(curves).map_err(|_| Error::Response("no three channels".into()))?;
    Ok(Response { log_exposure: [r, g, b] })
}

/// The picture whose histogram of green codes has the highest entropy [Menzel ch. 5 §1]; of equals the first.
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

/// Whether each picture is as bright as its exposure says, judged by its neighbour in exposure on common points.
fn check_ratios(shots: &[Shot<'_>], points: &[sampling::Point], order: &[usize]) -> Vec<String> {
    let mut warnings = Vec::new();
    for pair in order.windows(2) {
        let (a, b) = (pair[0], pair[1]);
        let mut differences: Vec<f32> = Vec::new();
        let mut order_differences = 0i32;
        for p in points {
            let (Some(u), Some(v)) = (p.codes[a], p.codes[b]) else { continue };
            let good = |d: &decode::Decoder, u: f32| (0.05..0.95).contains(&d.encoded(u)) && !d.is_clipped(u);
            if good(&shots[a].decoder, u[1]) && good(&shots[b].decoder, v[1]) {
                let l = |s: &Shot<'_>, u: f32| s.decoder.log_exposure(1, u) - s.log_secs;
                differences.push(l(&shots[b], v[1]) - l(&shots[a], u[1]));
                order_differences += if v[1] > u[1] { 1 } else { -1 };
            }
        }
        if differences.len() < 20 {
            continue;
        }
        let mid = differences.len() / 2;
        let stops = *differences.select_nth_unstable_by(mid, f32::total_cmp).1 / std::f32::consts::LN_2;
        let (na, nb) = (shots[a].name, shots[b].name);
        if order_differences < 0 && shots[b].log_secs > shots[a].log_secs + 0.1 {
            warnings.push(format!("{nb} is darker than {na}, but its exposure is longer: are the exposures in the order of the pictures? (--exposures, --list)"));
        } else if stops.abs() > 0.2 {
            warnings.push(format!("the pixels of {nb} against {na} say {stops:+.2} EV more than the exposures given; check them (--exposures, --list)"));
        }
    }
    warnings
}

/// Share of pixels whose confidence is below one half, per picture.
pub fn ghost_share(confidence: &[u8]) -> f64 {
    confidence.iter().filter(|c| **c < 128).count() as f64 / confidence.len().max(1) as f64
}

/// Number of samples of a picture in bytes, for memory estimates.
pub fn samples_size(samples: &Samples) -> usize {
    match samples {
        Samples::U8(v) => v.len(),
        Samples::U16(v) => 2 * v.len(),
        Samples::F32(v) => 4 * v.len(),
    }
}
