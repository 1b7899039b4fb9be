//! The weighted log average [Menzel ch. 5 §2, corrected]: log E = Σ w (g(c) − ln t) / Σ w.
//!
//! Weights are the thesis' spline with its exceptions (the longest exposure keeps its dark pixels, the shortest its
//! bright ones, because nothing tells more there) or the inverse variance of shot and read noise, times the ghost
//! confidence. Clipped values of the shortest exposure count only where nothing else does, as a lower bound.

use crate::align::Aligned;
use crate::decode::CLIPPED;
use crate::exposure::Shot;
use crate::warp::{self, Strip};
use crate::weight::Noise;
use rayon::prelude::*;

/// How pixels are weighed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Weights {
    /// The thesis' quadratic spline.
    Spline,
    /// Inverse variance of the log radiance, for linear sources.
    Variance(Noise),
}

/// Rows per strip.
const ROWS: usize = 32;

/// What the merge needs to know of each picture.
pub(crate) struct Merge<'a> {
    pub(crate) shots: &'a [Shot<'a>],
    pub(crate) aligned: &'a [Aligned],
    pub(crate) confidences: &'a [Option<Vec<u8>>],
    pub(crate) anchor: usize,
    pub(crate) shortest: usize,
    pub(crate) longest: usize,
    pub(crate) weights: Weights,
}

/// What the value of a pixel rests on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Trust {
    /// Unclipped values of pictures that agree with the anchor.
    Measured,
    /// Clipped in every picture: a lower bound in some channel.
    Bound,
    /// Clipped in the anchor, and the pictures that are not show something else, or do not reach here: a lower bound in
    /// some channel.
    Hole,
}

/// Log radiance (interleaved RGB) and what it rests on.
pub(crate) fn merge(m: &Merge<'_>) -> (Vec<f32>, Vec<Trust>) {
    let (w, h) = (m.shots[m.anchor].width(), m.shots[m.anchor].height());
    let (mut out, mut bound) = (vec![0.0f32; 3 * w * h], vec![Trust::Measured; w * h]);
    out.par_chunks_mut(3 * w * ROWS).zip(bound.par_chunks_mut(w * ROWS)).enumerate().for_each(|(k, (rows, bound))| {
        let y0 = k * ROWS;
        let y1 = y0 + bound.len() / w;
        let strips: Vec<Strip> = m.shots.iter().zip(m.aligned).map(|(s, a)| warp::strip(s, &a.field, y0..y1)).collect();
        for (p, (o, b)) in rows.chunks_exact_mut(3).zip(bound.iter_mut()).enumerate() {
            let (value, trust) = pixel(m, &strips, p, y0 * w + p);
            o.copy_from_slice(&value);
            *b = trust;
        }
    });
    (out, bound)
}

/// A weight this small beside the others' sum hands over to the fallback.
const FALLBACK: f32 = 1e-4;

/// One pixel: `p` within the strips, `i` within the picture.
fn pixel(m: &Merge<'_>, strips: &[Strip], p: usize, i: usize) -> ([f32; 3], Trust) {
    let mut value = [0.0f32; 3];
    let mut clipped = [false; 3];
    let mut rejected = false;
    for c in 0..3 {
        let (mut sum, mut total) = (0.0f32, 0.0f32);
        for (k, (shot, strip)) in m.shots.iter().zip(strips).enumerate() {
            if !strip.seen[p] {
                rejected |= shot.log_secs < m.shots[m.anchor].log_secs;
                continue;
            }
            let u = strip.codes[3 * p + c];
            let confidence = m.confidences[k].as_ref().map_or(1.0, |v| f32::from(v[i]) * (1.0 / 255.0));
            let own = weight_of(m, k, c, u);
            rejected |= own > 0.0 && confidence < 0.5;
            let weight = confidence * own;
            if weight > 0.0 {
                sum += weight * (shot.decoder.log_exposure(c, u) - shot.log_secs);
                total += weight;
            }
        }
        let (fallback, is_bound) = fallback(m, strips, p, c);
        value[c] = (sum + FALLBACK * fallback) / (total + FALLBACK);
        clipped[c] = is_bound && total < 10.0 * FALLBACK;
    }
    // Hues of fully clipped pixels are those of the curve's ends, not of the scene: bounds are raised to the highest.
    let bounds = clipped.iter().filter(|c| **c).count();
    if bounds >= 2 {
        let top = (0..3).filter(|c| clipped[*c]).map(|c| value[c]).fold(f32::NEG_INFINITY, f32::max);
        for c in (0..3).filter(|c| clipped[*c]) {
            value[c] = top;
        }
    }
    let trust = match (bounds > 0, rejected) {
        (false, _) => Trust::Measured,
        (true, false) => Trust::Bound,
        (true, true) => Trust::Hole,
    };
    (value, trust)
}

/// Weight of code `u` in picture `k`, before the ghost confidence; 0 where the code is only a bound.
fn weight_of(m: &Merge<'_>, k: usize, c: usize, u: f32) -> f32 {
    let d = &m.shots[k].decoder;
    if d.is_clipped(u) {
        return 0.0;
    }
    match m.weights {
        Weights::Spline => {
            let e = d.encoded(u);
            if (k == m.longest && e < 0.5) || (k == m.shortest && e > 0.5) { 1.0 } else { d.spline_weight(u) }
        }
        Weights::Variance(noise) => {
            // Exposure as a share of full range, whatever the curve.
            let full = d.full_range(c);
            let variance = noise.log_variance((d.log_exposure(c, u) - full).exp());
            // Fades out over the last tenth below clipping.
            let fade = ((CLIPPED - d.encoded(u)) / 0.1).clamp(0.0, 1.0);
            1e-3 * fade / variance
        }
    }
}

/// What to say where no picture has a trusted, unclipped value: the anchor's, or that of the picture whose bound is the
/// tightest, if the anchor does not see the pixel.
fn fallback(m: &Merge<'_>, strips: &[Strip], p: usize, c: usize) -> (f32, bool) {
    let of = |k: usize| {
        let u = strips[k].codes[3 * p + c];
        (m.shots[k].decoder.log_exposure(c, u) - m.shots[k].log_secs, m.shots[k].decoder.is_clipped(u))
    };
    // Clipped in every picture that is trusted: the shortest of them bounds best.
    let trusted = |k: usize| strips[k].seen[p];
    if trusted(m.anchor) {
        let (value, clipped) = of(m.anchor);
        if !clipped {
            return (value, false);
        }
        let best = (0..m.shots.len()).filter(|k| trusted(*k) && of(*k).1).map(|k| of(k).0).fold(value, f32::max);
        return (best, true);
    }
    (0..m.shots.len()).find(|k| trusted(*k)).map_or((0.0, true), |k| (of(k).0, true))
}
