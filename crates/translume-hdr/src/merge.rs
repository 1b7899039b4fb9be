//! The weighted log average [Menzel 2012, §5.2], corrected: log E = Σ w (g(c) − ln t) / Σ w.
//!
//! Weights are the thesis' spline with its exceptions (the longest exposure keeps its dark pixels, the shortest its
//! bright ones, because nothing tells more there) or the inverse variance of shot and read noise, times the ghost
//! confidence. Clipped values count only where nothing else does, as a lower bound: that of the shortest picture which
//! is clipped there, one and the same over all of a clipped area. What longer pictures say there is held for ringing
//! (see [`crate::clip`]), because a picture with more light cannot be less clipped.

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
    /// No picture shows it.
    Unseen,
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
/// What a value that may ring still counts where a shorter picture measures more.
const RINGING: f32 = 0.02;
/// By how much more (ln units) it must measure to be preferred; by twice as much, it is alone.
const AGREE: f32 = 0.12;
/// How far below the anchor's own bound (ln units) a measured value may lie: what the curve's end leaves open.
const BELOW_ANCHOR: f32 = 0.15;

/// One pixel: `p` within the strips, `i` within the picture.
fn pixel(m: &Merge<'_>, strips: &[Strip], p: usize, i: usize) -> ([f32; 3], Trust) {
    if strips.iter().all(|s| !s.seen[p]) {
        return ([0.0; 3], Trust::Unseen);
    }
    let mut value = [0.0f32; 3];
    let mut clipped = [false; 3];
    let mut rejected =
        strips.iter().zip(m.shots).any(|(s, shot)| !s.seen[p] && shot.log_secs < m.shots[m.anchor].log_secs);
    let confidence = |k: usize| m.confidences[k].as_ref().map_or(1.0, |v| f32::from(v[i]) * (1.0 / 255.0));
    // Far from clips, as most pixels are, nothing is to be held against anything.
    let marked = strips.iter().any(|s| s.marks[p] != 0);
    let held = |k: usize| 1.0 - refuted(m, strips, k, p, &confidence);
    let held: Vec<f32> = if marked { (0..strips.len()).map(held).collect() } else { Vec::new() };
    for c in 0..3 {
        let (mut sum, mut total) = (0.0f32, 0.0f32);
        for (k, (shot, strip)) in m.shots.iter().zip(strips).enumerate().filter(|(_, (_, s))| s.seen[p]) {
            let own = weight_of(m, strip, k, c, p) * held.get(k).copied().unwrap_or(1.0);
            rejected |= own > 0.0 && confidence(k) < 0.5;
            let weight = confidence(k) * own;
            if weight > 0.0 {
                sum += weight * (shot.decoder.log_exposure(c, strip.codes[3 * p + c]) - shot.log_secs);
                total += weight;
            }
        }
        let (fallback, is_bound) = fallback(m, strips, p, c, held.get(m.anchor).is_none_or(|h| *h > 0.5));
        // [Menzel 2012, §5.2 average]
        value[c] = (sum + FALLBACK * fallback) / (total + FALLBACK);
        clipped[c] = is_bound && total < 10.0 * FALLBACK;
        if strips[m.anchor].seen[p] && strips[m.anchor].is_clipped(p, c) {
            value[c] = value[c].max(bound(m, m.anchor, c) - BELOW_ANCHOR);
        }
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

/// Weight of channel `c` of pixel `p` in picture `k`, before the ghost confidence; 0 where the code is only a bound.
fn weight_of(m: &Merge<'_>, strip: &Strip, k: usize, c: usize, p: usize) -> f32 {
    if strip.is_clipped(p, c) {
        return 0.0;
    }
    let (d, u) = (&m.shots[k].decoder, strip.codes[3 * p + c]);
    match m.weights {
        Weights::Spline => {
            // [Menzel 2012, §5.2 extremes]
            let e = d.encoded(u);
            if (k == m.longest && e < 0.5) || (k == m.shortest && e > 0.5) { 1.0 } else { d.spline_weight(c, u) }
        }
        Weights::Variance(noise) => {
            // Exposure as a share of full range, whatever the curve.
            let full = d.full_range(c);
            let variance = noise.log_variance((d.log_exposure(c, u) - full).exp());
            // Fades out over the last tenth below clipping.
            let fade = ((d.encoded(d.clip(c)).min(CLIPPED) - d.encoded(u)) / 0.1).clamp(0.0, 1.0);
            1e-3 * fade / variance
        }
    }
}

/// How surely (0 to 1) picture `k` is refuted at a pixel, all channels together, by shorter pictures: by one that is
/// clipped where it is not, because the longer one then rings or is blurred beside its own clip, whatever its codes say;
/// and, where it may ring, by one that measures more. The anchor is refuted where it may ring only, and by nothing that
/// is held for a ghost.
fn refuted(m: &Merge<'_>, strips: &[Strip], k: usize, p: usize, confidence: &impl Fn(usize) -> f32) -> f32 {
    let rings = strips[k].may_ring(&m.shots[k], p);
    if k == m.shortest || k == m.anchor && !rings {
        return 0.0;
    }
    let value = |j: usize, c| m.shots[j].decoder.log_exposure(c, strips[j].codes[3 * p + c]) - m.shots[j].log_secs;
    let shorter = |j: &usize| strips[*j].seen[p] && m.shots[*j].log_secs < m.shots[k].log_secs - 0.1;
    let doubt = |j: usize, c: usize| match (strips[j].is_clipped(p, c), strips[k].is_clipped(p, c)) {
        (true, false) => 1.0,
        (false, false) if rings && !strips[j].may_ring(&m.shots[j], p) => {
            ((value(j, c) - value(k, c) - AGREE) / AGREE).clamp(0.0, 1.0 - RINGING)
        }
        _ => 0.0,
    };
    let doubts = (0..m.shots.len()).filter(shorter);
    doubts.map(|j| confidence(j) * (0..3).map(|c| doubt(j, c)).fold(0.0, f32::max)).fold(0.0, f32::max)
}

/// The log radiance at which picture `k` clips: one figure for all of its clipped pixels, whatever codes they hold.
fn bound(m: &Merge<'_>, k: usize, c: usize) -> f32 {
    let d = &m.shots[k].decoder;
    d.log_exposure(c, d.white(c)) - m.shots[k].log_secs
}

/// What to say where no picture has a trusted, unclipped value: the anchor's, unless it is refuted, or the tightest bound
/// there is.
fn fallback(m: &Merge<'_>, strips: &[Strip], p: usize, c: usize, anchor_holds: bool) -> (f32, bool) {
    let seen = |k: &usize| strips[*k].seen[p];
    let value = |k: usize| m.shots[k].decoder.log_exposure(c, strips[k].codes[3 * p + c]) - m.shots[k].log_secs;
    let open = |k: usize| !strips[k].is_clipped(p, c);
    if seen(&m.anchor) && open(m.anchor) && anchor_holds {
        return (value(m.anchor), false);
    }
    let bounds = (0..m.shots.len()).filter(seen).filter(|k| !open(*k)).map(|k| bound(m, k, c));
    match bounds.reduce(f32::max) {
        Some(best) => (best, true),
        // Unseen by the anchor, unclipped where it is seen: a ghost or black, but all there is.
        None => ((0..m.shots.len()).find(seen).map_or(0.0, value), true),
    }
}
