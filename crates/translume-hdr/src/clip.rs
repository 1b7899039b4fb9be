//! Where a picture is clipped, its neighbours and channels together.
//!
//! A clipped area says only that the scene was at least so bright. Its codes are no longer to be had one by one: JPEG
//! rings beside every edge to white, so that codes *inside* a clipped area swing below the clip and would pass for
//! measured light, a stop and more too dark and coloured. So clipped areas are closed (what they surround is clipped
//! too), and what lies within a block of one is marked as standing beside a clip: good for the edge it shows, not
//! against a shorter exposure that is clipped there.
//!
//! Where a camera clips is found from the histograms, per channel: not all stop at 255, and white balance makes the
//! channels of developed pictures stop apart.

use crate::decode::{BELOW_PILE, CLIPPED, Kind};
use crate::exposure::Shot;
use rayon::prelude::*;
use translume_image::{Codes, Samples};

/// Beside a clip of any channel. The bits below it, `1 << channel`, say that the channel is clipped.
pub(crate) const BESIDE: u8 = 8;

/// Pixels by which clipped areas reach out: a JPEG block rings as a whole.
const REACH: usize = 8;
/// Half side of the gaps in clipped areas that are closed, in pixels.
const GAP: usize = 3;
/// How far below the clip, in encoded units, ringing inside a clipped area can swing.
const SWING: f32 = 0.3;
/// At the rim of a clipped area, where nothing surrounds a pixel, it is less: beyond, the edge itself is meant. This
/// share of the 7 × 7 pixels around must be clipped.
const RIM_SWING: f32 = 0.12;
const RIM_SHARE: f32 = 0.4;

/// Whether codes beside a clip may be ringing of what is clipped. All three channels must be near their clips: a twig
/// before a white sky is dark in one at least, and a pixel of which only some channels were doubted would change its hue.
pub(crate) fn may_ring(shot: &Shot<'_>, codes: &[f32]) -> bool {
    all_within(shot, codes, SWING)
}

/// Whether all channels lie less than `swing` (in encoded units) under their clips.
fn all_within(shot: &Shot<'_>, codes: &[f32], swing: f32) -> bool {
    let d = &shot.decoder;
    let near = |c: usize| d.encoded(codes[c]) >= d.encoded(d.clip(c)) - swing;
    (0..3).any(|c| d.clip(c).is_finite()) && (0..3).all(near)
}

/// The marks of a picture, row by row; `None` where nothing is clipped.
pub(crate) fn marks(shot: &Shot<'_>) -> Option<Vec<u8>> {
    let (w, h) = (shot.width(), shot.height());
    let mut clipped = vec![0u8; w * h];
    clipped.par_chunks_mut(w).enumerate().for_each_init(
        || vec![0.0f32; 3 * w],
        |row, (y, out)| {
            shot.unit_row(y, row);
            for (o, p) in out.iter_mut().zip(row.as_chunks::<3>().0) {
                *o = (0..3).filter(|c| shot.decoder.is_clipped(*c, p[*c])).fold(0, |bits, c| bits | 1 << c);
            }
        },
    );
    if clipped.iter().all(|b| *b == 0) {
        return None;
    }
    let near = widened(&clipped, w, REACH, |a, b| a | b);
    let closed = widened(&widened(&clipped, w, GAP, |a, b| a | b), w, GAP, |a, b| a & b);
    let around: Vec<f32> = clipped.iter().map(|b| f32::from(u8::from(*b != 0))).collect();
    let around = crate::box_mean::box_mean(&around, w, GAP);
    clipped.par_chunks_mut(w).zip(closed.par_chunks(w)).zip(near.par_chunks(w)).enumerate().for_each_init(
        || vec![0.0f32; 3 * w],
        |row, (y, ((out, closed), near))| {
            // Most rows are far from any clip.
            if near.iter().all(|n| *n == 0) {
                return;
            }
            shot.unit_row(y, row);
            for (x, (o, p)) in out.iter_mut().zip(row.as_chunks::<3>().0).enumerate() {
                if closed[x] & !*o != 0 && may_ring(shot, p) {
                    *o |= closed[x];
                }
                if around[y * w + x] > RIM_SHARE && all_within(shot, p, RIM_SWING) {
                    *o |= near[x];
                }
                *o |= if near[x] != 0 { BESIDE } else { 0 };
            }
        },
    );
    Some(clipped)
}

/// Every value joined with those within `r` pixels in x and y.
fn widened(v: &[u8], w: usize, r: usize, join: impl Fn(u8, u8) -> u8 + Sync) -> Vec<u8> {
    let h = v.len() / w;
    let mut across = vec![0u8; v.len()];
    across.par_chunks_mut(w).zip(v.par_chunks(w)).for_each(|(out, row)| {
        for (x, o) in out.iter_mut().enumerate() {
            let window = &row[x.saturating_sub(r)..(x + r + 1).min(w)];
            *o = window.iter().copied().reduce(&join).unwrap_or(0);
        }
    });
    let mut out = vec![0u8; v.len()];
    out.par_chunks_mut(w).enumerate().for_each(|(y, out)| {
        let rows = y.saturating_sub(r)..(y + r + 1).min(h);
        out.copy_from_slice(&across[rows.start * w..(rows.start + 1) * w]);
        for row in rows.skip(1) {
            out.iter_mut().zip(&across[row * w..(row + 1) * w]).for_each(|(o, v)| *o = join(*o, *v));
        }
    });
    out
}

/// The histograms of the three channels, and of how many pixels.
pub(crate) struct Histograms {
    counts: [[usize; 256]; 3],
    pixels: usize,
}

impl Histograms {
    pub(crate) fn of(codes: &Codes) -> Self {
        let all = codes.width * codes.height;
        let stride = (all / 200_000).max(1);
        let mut out = Self { counts: [[0; 256]; 3], pixels: 0 };
        for i in (0..all).step_by(stride) {
            out.pixels += 1;
            for c in 0..3 {
                out.counts[c][(codes.unit(3 * i + c) * 255.0 + 0.5) as usize] += 1;
            }
        }
        out
    }

    fn above(&self, c: usize, code: usize) -> usize {
        self.counts[c][code.min(255)..].iter().sum()
    }

    /// The code at which a channel piles up with next to nothing above it, if it does.
    fn pile(&self, c: usize) -> Option<usize> {
        let counts = &self.counts[c];
        // Lower down, only a pile that is the sharp end of everything counts.
        [(HIGH, 5, 500), (LOW, 20, 100)].into_iter().find_map(|(from, times, share)| {
            let top = (from..256).max_by_key(|k| counts[*k])?;
            let around =
                (from..256).filter(|k| k.abs_diff(top) > 2).map(|k| counts[k]).sum::<usize>() / (251 - from).max(1);
            let sharp = counts[top] > times * around.max(1) && counts[top] * share > self.pixels;
            (sharp && self.above(c, top + 4) * 20 < counts[top]).then_some(top)
        })
    }
}

/// Codes from which on a pile is taken for a clip, and for one if everything ends there.
const HIGH: usize = 225;
const LOW: usize = 128;

/// The codes at which the camera of these pictures clips, per channel, a little below where they pile up.
///
/// All pictures of a bracket come from one camera: the lowest pile holds for all. But a wall may be of one code too: a
/// level that another picture, with more light, goes beyond is none.
pub(crate) fn levels(histograms: &[Histograms]) -> [f32; 3] {
    std::array::from_fn(|c| {
        let beyond = |level: usize| histograms.iter().any(|h| h.above(c, level + 4) * 500 > h.pixels);
        let piles = histograms.iter().filter_map(|h| h.pile(c)).filter(|level| *level >= 252 || !beyond(*level));
        piles.map(|level| level as f32 / 255.0 - BELOW_PILE).fold(CLIPPED, f32::min)
    })
}

/// Finds the clip of pictures with a response.
pub(crate) fn find_levels(shots: &mut [Shot<'_>]) {
    let encoded: Vec<&Codes> =
        shots.iter().map(|s| s.codes).filter(|c| !matches!(c.samples, Samples::F32(_))).collect();
    let histograms: Vec<Histograms> = encoded.par_iter().map(|c| Histograms::of(c)).collect();
    let found = levels(&histograms);
    for s in shots {
        if let Kind::Curve { clip, .. } = &mut s.decoder.kind {
            *clip = found;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Response;
    use crate::exposure::decoder_of;
    use translume_image::Metadata;

    fn codes(f: impl Fn(usize, usize) -> [u8; 3]) -> Codes {
        let (width, height) = (64, 48);
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let samples = Samples::U8(pixels.flat_map(|(x, y)| f(x, y)).collect());
        Codes { width, height, samples, metadata: Metadata::default() }
    }

    fn levels_of(pictures: &[Codes]) -> [u8; 3] {
        let histograms: Vec<Histograms> = pictures.iter().map(Histograms::of).collect();
        levels(&histograms).map(|l| (l * 255.0).ceil() as u8)
    }

    #[test]
    fn cameras_may_clip_anywhere_and_channels_apart() {
        let ramp = |x: usize, gain: usize, top: usize| (20 + x * gain).min(top) as u8;
        let shot = |gain| codes(move |x, _| [ramp(x, gain, 255), ramp(x, gain, 250), ramp(x, gain, 190)]);
        assert_eq!(levels_of(&[shot(3), shot(9)]), [252, 248, 188]);
        // A wall of one code is no clip when more light makes it brighter.
        let wall = |level| codes(move |x, y| if y < 20 { [level; 3] } else { [(x % 90) as u8; 3] });
        assert_eq!(levels_of(&[wall(120), wall(230), wall(255)]), [252; 3]);
        assert_eq!(levels_of(&[codes(|x, y| [(3 * x + y) as u8; 3])]), [252; 3], "nothing piles up");
    }

    #[test]
    fn channels_of_float_values_are_clipped_apart() {
        let v: Vec<f32> = (0..3000).flat_map(|i| [(i as f32).min(500.0), (i as f32).min(800.0), i as f32]).collect();
        assert_eq!(crate::decode::float_levels(&v), [500.0, 800.0, f32::INFINITY]);
    }

    #[test]
    fn ringing_inside_is_clipped_and_an_edge_is_not() {
        // A white disc in which single pixels swing down, on a dark ground.
        let inside = |x: usize, y: usize| (x as f32 - 30.0).hypot(y as f32 - 24.0) < 15.0;
        let c = codes(|x, y| match (inside(x, y), (x * 7 + y * 3) % 11) {
            (true, 0) => [255, 215, 240],
            (true, _) => [255; 3],
            (false, _) => [90, 80, 70],
        });
        let mut shots = [Shot {
            name: "",
            codes: &c,
            log_secs: 0.0,
            border: None,
            clips: None,
            decoder: decoder_of(&c, &Response::linear()),
        }];
        find_levels(&mut shots);
        let marks = marks(&shots[0]).unwrap();
        for (i, m) in marks.iter().enumerate() {
            let from_middle = ((i % 64) as f32 - 30.0).hypot((i / 64) as f32 - 24.0);
            // What swings at the very rim is not surrounded.
            assert!(from_middle >= 12.0 || m & 7 == 7, "{i}");
            assert!(from_middle < 15.0 || m & 7 == 0, "{i}");
            assert!(from_middle < 30.0 || *m == 0);
            assert!(from_middle > 22.0 || m & BESIDE != 0);
        }
    }
}
