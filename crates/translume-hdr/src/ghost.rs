//! Which pixels of a picture show the same scene as the anchor [Menzel 2012, §5.3], corrected.
//!
//! Two tests per pixel. The thesis' 11 × 11 normalised correlation, mean not subtracted, on values brought to a common
//! exposure: skipped where the anchor has no information (clipped or black), because then nothing can be compared. And,
//! because flat patches of one hue correlate perfectly at any brightness, a log-radiance test: every value stands for
//! an interval (its code, give or take rounding and noise; open-ended when clipped or black), and the gap between the
//! intervals of picture and anchor is what no noise explains. Where the anchor is clipped or black the next accepted
//! picture towards it stands in, so that two short exposures cannot disagree unseen.
//!
//! Beyond the thesis: confidences are soft, and the anchor's interval is widened by half its 3 × 3 neighbourhood, which
//! is what a misregistration of half a pixel explains.

use crate::align::{self, Aligned};
use crate::box_mean::box_mean;
use crate::decode::{Decoder, Kind};
use crate::exposure::Shot;
use crate::sampling::Point;
use crate::warp::{self, Strip};
use rayon::prelude::*;

/// Thresholds of the ghost tests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GhostParams {
    /// Correlation below which a pixel is a ghost (t_K of the thesis).
    pub correlation: f32,
    /// Gap in ln radiance (mean over 5 × 5) that begins to cost confidence, and the one that ends it.
    pub gap: (f32, f32),
}

impl Default for GhostParams {
    fn default() -> Self {
        Self { correlation: 0.95, gap: (0.02, 0.08) }
    }
}

/// Half side of the correlation window: 11 × 11.
const CORRELATION: usize = 5;
/// Half side of the window over which gaps are averaged.
const AVERAGE: usize = 2;
/// Rows per strip, without the windows' margin.
const ROWS: usize = 48;
/// Gap beyond which a pixel counts no more.
const GAP_CAP: f32 = 0.5;

/// What aligned points say of a pair of pictures: by how much the decoded values of one are off from the other's at
/// each of its codes, and how far they scatter. A response curve never explains a real camera fully (colour matrices,
/// gamut clipping, local contrast); what the whole picture does is no ghost.
struct Expectation {
    /// `[channel][bin]`: (offset, tolerance) in ln units.
    table: [[(f32, f32); BINS]; 3],
}

/// Bins of an [`Expectation`] over encoded values.
const BINS: usize = 32;
/// Differences beyond this do not count as misfit of the curves.
const MISFIT: f32 = 0.35;

impl Expectation {
    /// Of picture `b` against picture `a`.
    fn new(a: (usize, &Shot<'_>), b: (usize, &Shot<'_>), points: &[Point]) -> Self {
        let table = std::array::from_fn(|c| {
            let mut bins: Vec<Vec<f32>> = vec![Vec::new(); BINS];
            for p in points {
                let (Some(u), Some(v)) = (p.codes[a.0], p.codes[b.0]) else { continue };
                let (u, v) = (u[c], v[c]);
                let usable = |s: &Shot<'_>, u: f32| !s.decoder.is_clipped(c, u) && !s.decoder.is_black(u);
                if usable(a.1, u) && usable(b.1, v) {
                    let l = |s: &Shot<'_>, u: f32| s.decoder.log_exposure(c, u) - s.log_secs;
                    let difference = l(b.1, v) - l(a.1, u);
                    if difference.abs() < MISFIT {
                        bins[bin(b.1, v)].push(difference);
                    }
                }
            }
            let medians: Vec<Option<(f32, f32)>> = bins.iter_mut().map(|d| median_and_spread(d)).collect();
            std::array::from_fn(|k| {
                // A bin without evidence follows the nearest that has some, less sure of it.
                let nearest = (0..BINS).filter(|j| medians[*j].is_some()).min_by_key(|j| j.abs_diff(k));
                match nearest.and_then(|j| medians[j].map(|m| (m, j.abs_diff(k)))) {
                    Some(((offset, spread), far)) => (offset, (0.03 + 1.5 * spread + 0.02 * far as f32).min(0.25)),
                    None => (0.0, 0.15),
                }
            })
        });
        Self { table }
    }

    /// (offset, tolerance) at a value.
    #[inline]
    fn at(&self, shot: &Shot<'_>, c: usize, u: f32) -> (f32, f32) {
        self.table[c][bin(shot, u)]
    }
}

fn bin(shot: &Shot<'_>, u: f32) -> usize {
    ((shot.decoder.encoded(u) * BINS as f32) as usize).min(BINS - 1)
}

fn median_and_spread(d: &mut [f32]) -> Option<(f32, f32)> {
    if d.len() < 10 {
        return None;
    }
    let mid = d.len() / 2;
    let median = *d.select_nth_unstable_by(mid, f32::total_cmp).1;
    d.iter_mut().for_each(|v| *v = (*v - median).abs());
    Some((median, 1.4826 * *d.select_nth_unstable_by(mid, f32::total_cmp).1))
}

/// Confidence per pixel and picture, 0 to 255, in the anchor's frame; `None` for the anchor.
pub(crate) fn confidences(
    shots: &[Shot<'_>],
    aligned: &[Aligned],
    points: &[Point],
    order: &[usize],
    anchor: usize,
    params: &GhostParams,
) -> Vec<Option<Vec<u8>>> {
    let mut out: Vec<Option<Vec<u8>>> = vec![None; shots.len()];
    for chain in align::chains(order, anchor) {
        let mut towards: Option<usize> = None;
        for i in chain {
            let expect = |from: usize| Expectation::new((from, &shots[from]), (i, &shots[i]), points);
            let by_anchor = expect(anchor);
            let by_neighbour = towards.map(|j| (j, expect(j)));
            let witness = |j: usize, expectation| Witness {
                index: j,
                theirs: Intervals::new(&shots[j], None),
                mine: Intervals::new(&shots[i], Some(expectation)),
                confidence: out[j].as_deref(),
            };
            let between = by_neighbour.as_ref().map(|(j, e)| witness(*j, e));
            let raw = confidence(shots, aligned, &witness(anchor, &by_anchor), between.as_ref(), i, params);
            out[i] = Some(soften(&raw, shots[i].width(), shots[i].height()));
            towards = Some(i);
        }
    }
    out
}

/// The interval that each value of a picture stands for, ready to be compared: tabulated where values are codes.
struct Intervals<'a> {
    shot: &'a Shot<'a>,
    expectation: Option<&'a Expectation>,
    /// `[channel][4 · code]`
    table: Option<[Vec<(f32, f32)>; 3]>,
}

/// Entries of a table per unit of code: four per 8-bit code, so that those are met exactly.
const ENTRIES: usize = 1020;

impl<'a> Intervals<'a> {
    /// Of `shot`, moved and widened by what is expected of it, if something is.
    fn new(shot: &'a Shot<'a>, expectation: Option<&'a Expectation>) -> Self {
        let mut out = Self { shot, expectation, table: None };
        if matches!(shot.decoder.kind, Kind::Curve { .. }) {
            let column = |c| (0..=ENTRIES).map(|k| out.compute(c, k as f32 / ENTRIES as f32)).collect();
            out.table = Some([column(0), column(1), column(2)]);
        }
        out
    }

    fn compute(&self, c: usize, u: f32) -> (f32, f32) {
        let (offset, tolerance) = self.expectation.map_or((0.0, 0.0), |e| e.at(self.shot, c, u));
        let (low, high) = self.shot.decoder.interval(c, u, u);
        let shift = self.shot.log_secs + offset;
        (low - shift - tolerance, high - shift + tolerance)
    }

    #[inline]
    fn at(&self, c: usize, u: f32) -> (f32, f32) {
        match &self.table {
            Some(t) => t[c][(u * ENTRIES as f32 + 0.5) as usize],
            None => self.compute(c, u),
        }
    }
}

/// A picture that others are held against.
struct Witness<'a> {
    index: usize,
    /// What its values stand for.
    theirs: Intervals<'a>,
    /// What the values of the picture in question stand for, as seen from here.
    mine: Intervals<'a>,
    /// Where it is itself trusted; everywhere, if `None`.
    confidence: Option<&'a [u8]>,
}

/// The rows of a [`Witness`] that a strip needs.
struct Testimony<'a> {
    witness: &'a Witness<'a>,
    strip: Strip,
    confidence: Option<&'a [u8]>,
}

impl Witness<'_> {
    fn rows(&self, shots: &[Shot<'_>], aligned: &[Aligned], rows: std::ops::Range<usize>) -> Testimony<'_> {
        let shot = &shots[self.index];
        let w = shot.width();
        Testimony {
            witness: self,
            confidence: self.confidence.map(|c| &c[rows.start * w..rows.end * w]),
            strip: warp::strip(shot, &aligned[self.index].field, rows),
        }
    }
}

impl Testimony<'_> {
    /// Per channel by how much more than expected the codes of the picture in question contradict this one at pixel
    /// (x, y), and whether this one leaves an end open. `None` where it does not see the pixel or is not trusted.
    #[inline]
    fn contradicts(&self, picture: &Strip, x: usize, y: usize) -> Option<[(f32, bool); 3]> {
        let (w, p) = (self.strip.width, y * self.strip.width + x);
        if !self.strip.seen[p] || self.confidence.is_some_and(|c| c[p] <= 128) {
            return None;
        }
        let around = neighbourhood(&self.strip, x, y, self.strip.seen.len() / w);
        let codes = picture.pixel(p);
        // What rings beside a clip may be any brighter.
        let (mine_rings, theirs_ring) =
            (picture.may_ring(self.witness.mine.shot, p), self.strip.may_ring(self.witness.theirs.shot, p));
        let open = |strip: &Strip, rings: bool, c, (low, high): (f32, f32)| {
            (low, if rings || strip.is_clipped(p, c) { f32::INFINITY } else { high })
        };
        Some(std::array::from_fn(|c| {
            let mine = open(picture, mine_rings, c, self.witness.mine.at(c, codes[c]));
            let theirs = (self.witness.theirs.at(c, around[c].0).0, self.witness.theirs.at(c, around[c].1).1);
            let theirs = open(&self.strip, theirs_ring, c, theirs);
            (gap(mine, theirs), theirs.0 == f32::NEG_INFINITY || theirs.1 == f32::INFINITY)
        }))
    }
}

/// Raw confidence of picture `i` [Menzel 2012, §5.3 weight], by the anchor and, where that is clipped or black, by the picture between them.
fn confidence(
    shots: &[Shot<'_>],
    aligned: &[Aligned],
    anchor: &Witness<'_>,
    between: Option<&Witness<'_>>,
    i: usize,
    params: &GhostParams,
) -> Vec<u8> {
    let (w, h) = (shots[i].width(), shots[i].height());
    let mut out = vec![0u8; w * h];
    out.par_chunks_mut(w * ROWS).enumerate().for_each(|(k, rows)| {
        let (y0, y1) = (k * ROWS, (k * ROWS + rows.len() / w).min(h));
        let (s0, s1) = (y0.saturating_sub(CORRELATION + 1), (y1 + CORRELATION + 1).min(h));
        let picture = warp::strip(&shots[i], &aligned[i].field, s0..s1);
        let first = anchor.rows(shots, aligned, s0..s1);
        let second = between.map(|b| b.rows(shots, aligned, s0..s1));
        let gaps = box_mean(&gaps(&picture, &first, second.as_ref()), w, AVERAGE);
        let correlations = correlations(&shots[anchor.index], &shots[i], &first.strip, &picture);
        for (o, p) in rows.iter_mut().zip((y0 - s0) * w..) {
            let by_gap = 1.0 - smoothstep(params.gap.0, params.gap.1, gaps[p]);
            let by_correlation = smoothstep(params.correlation - 0.03, params.correlation, correlations[p]);
            *o = (255.0 * by_gap.min(by_correlation)).round() as u8;
        }
    });
    out
}

fn smoothstep(a: f32, b: f32, x: f32) -> f32 {
    let t = ((x - a) / (b - a)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Contradiction per pixel, the largest over the channels, in ln units.
fn gaps(picture: &Strip, first: &Testimony<'_>, second: Option<&Testimony<'_>>) -> Vec<f32> {
    let w = picture.width;
    let mut out = vec![0.0f32; picture.seen.len()];
    for (p, out) in out.iter_mut().enumerate().filter(|(p, _)| picture.seen[*p]) {
        let (x, y) = (p % w, p / w);
        let by_first = first.contradicts(picture, x, y).unwrap_or([(0.0, true); 3]);
        let open = by_first.iter().any(|c| c.1);
        let by_second = second.filter(|_| open).and_then(|s| s.contradicts(picture, x, y));
        for c in 0..3 {
            *out = out.max(by_first[c].0);
            if let (true, Some(s)) = (by_first[c].1, by_second) {
                *out = out.max(s[c].0);
            }
        }
        *out = out.min(GAP_CAP);
    }
    out
}

/// Distance between two intervals, 0 if they meet.
#[inline]
fn gap(a: (f32, f32), b: (f32, f32)) -> f32 {
    (a.0 - b.1).max(b.0 - a.1).max(0.0)
}

/// Per channel the range half way from the pixel to the extremes of its 3 × 3 neighbourhood.
#[inline]
fn neighbourhood(s: &Strip, x: usize, y: usize, rows: usize) -> [(f32, f32); 3] {
    let own = s.pixel(y * s.width + x);
    let (mut low, mut high) = (own, own);
    let (x0, x1) = (x.saturating_sub(1), (x + 2).min(s.width));
    for ny in y.saturating_sub(1)..(y + 2).min(rows) {
        for p in s.codes[3 * (ny * s.width + x0)..3 * (ny * s.width + x1)].as_chunks::<3>().0 {
            for c in 0..3 {
                low[c] = low[c].min(p[c]);
                high[c] = high[c].max(p[c]);
            }
        }
    }
    std::array::from_fn(|c| (0.5 * (low[c] + own[c]), 0.5 * (high[c] + own[c])))
}

/// K [Menzel 2012, §5.3 confidence]: Σ c_i c_r / √(Σ c_i² Σ c_r²) over 11 × 11, values brought to a common exposure and clamped to the
/// common range; 1 where a pixel cannot be compared.
fn correlations(a: &Shot<'_>, b: &Shot<'_>, reference: &Strip, picture: &Strip) -> Vec<f32> {
    let (w, n) = (picture.width, picture.seen.len());
    let (mut ab, mut aa, mut bb) = (vec![0.0f32; n], vec![0.0f32; n], vec![0.0f32; n]);
    let common: [(f32, f32); 3] = std::array::from_fn(|c| {
        let (ra, rb) = (a.decoder.useful_range(c), b.decoder.useful_range(c));
        let hi = (ra.1 - a.log_secs).min(rb.1 - b.log_secs);
        (((ra.0 - a.log_secs).max(rb.0 - b.log_secs)).min(hi), hi)
    });
    let value = |s: &Shot<'_>, c: usize, u: f32| {
        let (lo, hi) = common[c];
        let hi_or_zero = if hi.is_finite() { hi } else { 0.0 };
        (((s.decoder.log_exposure(c, u) - s.log_secs).clamp(lo, hi) - hi_or_zero) / 2.2).exp()
    };
    let (ta, tb) = (Table::new(&a.decoder, |c, u| value(a, c, u)), Table::new(&b.decoder, |c, u| value(b, c, u)));
    for p in 0..n {
        if !(picture.seen[p] && reference.seen[p]) {
            continue;
        }
        let (pa, pb) = (reference.pixel(p), picture.pixel(p));
        for c in 0..3 {
            if reference.is_clipped(p, c) || a.decoder.is_black(pa[c]) {
                continue;
            }
            let (va, vb) = (ta.at(c, pa[c], |c, u| value(a, c, u)), tb.at(c, pb[c], |c, u| value(b, c, u)));
            ab[p] += va * vb;
            aa[p] += va * va;
            bb[p] += vb * vb;
        }
    }
    let (ab, aa, bb) = (box_mean(&ab, w, CORRELATION), box_mean(&aa, w, CORRELATION), box_mean(&bb, w, CORRELATION));
    (0..n)
        .map(|p| {
            let d = aa[p] * bb[p];
            if d > 1e-12 { (ab[p] / d.sqrt()).min(1.0) } else { 1.0 }
        })
        .collect()
}

/// A function of a code, tabulated where codes lie in [0, 1].
struct Table(Option<Vec<[f32; 3]>>);

impl Table {
    const SIZE: usize = 1024;

    fn new(decoder: &Decoder, f: impl Fn(usize, f32) -> f32) -> Self {
        let tabulate =
            || (0..=Self::SIZE).map(|i| std::array::from_fn(|c| f(c, i as f32 / Self::SIZE as f32))).collect();
        Self(matches!(decoder.kind, Kind::Curve { .. }).then(tabulate))
    }

    #[inline]
    fn at(&self, c: usize, u: f32, f: impl Fn(usize, f32) -> f32) -> f32 {
        match &self.0 {
            Some(t) => t[(u * Self::SIZE as f32 + 0.5) as usize][c],
            None => f(c, u),
        }
    }
}

/// Ghosts grown by 3 pixels and feathered, so that no hard transition and no rim of the moved thing stays; and places
/// where accepted and rejected pixels alternate given up as a whole, because a picture is not improved by speckles.
fn soften(raw: &[u8], w: usize, h: usize) -> Vec<u8> {
    let mut out = grow(raw, w, h);
    let broad: Vec<f32> = out.iter().map(|c| f32::from(*c)).collect();
    let radius = (w.min(h) / 80).clamp(2, 24);
    let broad = box_mean(&box_mean(&broad, w, radius), w, radius);
    out.par_iter_mut().zip(broad).for_each(|(o, b)| {
        let keep = smoothstep(SPECKLED.0, SPECKLED.1, b / 255.0);
        *o = (f32::from(*o) * keep + 0.5) as u8;
    });
    out
}

/// Share of confidence in a neighbourhood (an eightieth of the picture's shorter side) below which all of it is given
/// up, and above which none.
const SPECKLED: (f32, f32) = (0.3, 0.75);

/// Ghosts grown by 3 pixels and feathered.
fn grow(raw: &[u8], w: usize, h: usize) -> Vec<u8> {
    const GROW: usize = 3;
    let across: Vec<u8> = raw
        .par_chunks(w)
        .flat_map_iter(|row| {
            (0..w).map(|x| row[x.saturating_sub(GROW)..(x + GROW + 1).min(w)].iter().copied().min().unwrap_or(0))
        })
        .collect();
    let grown: Vec<u8> = (0..h)
        .into_par_iter()
        .flat_map_iter(|y| {
            let across = &across;
            let (y0, y1) = (y.saturating_sub(GROW), (y + GROW + 1).min(h));
            (0..w).map(move |x| (y0..y1).map(|yy| across[yy * w + x]).min().unwrap_or(0))
        })
        .collect();
    // A mean over (2·2+1)² of the grown mask never exceeds what the raw mask says within a pixel of a ghost.
    const FEATHER: usize = 2;
    let mut out = vec![0u8; w * h];
    out.par_chunks_mut(w).enumerate().for_each(|(y, row)| {
        let (y0, y1) = (y.saturating_sub(FEATHER), (y + FEATHER + 1).min(h));
        let columns: Vec<u32> = (0..w).map(|x| (y0..y1).map(|yy| u32::from(grown[yy * w + x])).sum()).collect();
        for (x, o) in row.iter_mut().enumerate() {
            let (x0, x1) = (x.saturating_sub(FEATHER), (x + FEATHER + 1).min(w));
            *o = (columns[x0..x1].iter().sum::<u32>() / ((x1 - x0) * (y1 - y0)) as u32) as u8;
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_that_meet_have_no_gap() {
        assert_eq!(gap((0.0, 1.0), (0.5, 2.0)), 0.0);
        assert_eq!(gap((0.0, f32::INFINITY), (5.0, 6.0)), 0.0);
        assert!((gap((0.0, 1.0), (1.5, 2.0)) - 0.5).abs() < 1e-6);
        assert!((gap((3.0, 4.0), (f32::NEG_INFINITY, 2.0)) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn softened_masks_only_grow() {
        let (w, h) = (30, 20);
        let mut raw = vec![255u8; w * h];
        raw[10 * w + 15] = 0;
        let soft = soften(&raw, w, h);
        assert_eq!(soft[10 * w + 15], 0);
        assert_eq!(soft[10 * w + 16], 0);
        assert_eq!(soft[2 * w + 2], 255);
        assert!(soft[10 * w + 19] > 0 && soft[10 * w + 19] < 255);
    }
}
