//! From pictures of different exposure to one displacement field each.
//!
//! Both pictures of a pair are brought to a common exposure: codes through the (preliminary) response, log radiance
//! clamped to the range that both record, then to a display-like grey. What is clipped in one is then flat in both, and
//! the edge of a clipped area is an edge in both, so that plain differences compare them without masks. Pictures whose
//! exposures are far from the anchor's are matched with their neighbour, already seen through its own field.

use crate::exposure::Shot;
use crate::field::{Affine, Field, IDENTITY, apply};
use crate::global::{self, Level};
use crate::local;
use crate::look::{self, Look};
use crate::plane::Plane;
use rayon::prelude::*;

/// How far the alignment goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Alignment {
    /// None: pictures are taken as registered.
    Off,
    /// One affine map per picture.
    Global,
    /// The affine map and the hierarchical field of the thesis.
    NonLinear,
}

/// What the alignment of one picture came to.
#[derive(Clone, Debug)]
pub struct Aligned {
    /// Where anchor pixels lie in this picture.
    pub field: Field,
    /// Robust difference from the reference, in [0, 1]: as it was, with the global map, with the local field.
    pub cost: [f64; 3],
    /// How far things moved where there is something to see.
    pub motion: Motion,
    /// What a person should know, if anything.
    pub note: Option<String>,
}

/// Lengths of the displacement over the textured places that both pictures show, in pixels. Elsewhere (in the dark, in
/// what is clipped, on bare walls) a displacement is a guess and says nothing of the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// The mean, without the longest twentieth.
    pub mean_px: f64,
    /// What 95 of 100 places stay below.
    pub p95_px: f64,
}

/// A global motion must lower the cost to this share of standing still to be believed.
const MUST_IMPROVE: f64 = 0.985;
/// A local field, which has a hundred times the freedom, to this share of the global motion's.
const FIELD_MUST_IMPROVE: f64 = 0.96;
/// A global motion below this many pixels everywhere is none.
const STILL: f32 = 0.12;

/// The fields of all pictures; `order` lists indices from short to long exposure.
pub(crate) fn align(
    shots: &[Shot<'_>],
    order: &[usize],
    anchor: usize,
    how: Alignment,
    progress: &(dyn Fn(&str) + Sync),
) -> Vec<Aligned> {
    let unmoved = || Aligned { field: Field::identity(), cost: [0.0; 3], motion: Motion::default(), note: None };
    let mut out: Vec<Aligned> = shots.iter().map(|_| unmoved()).collect();
    if how == Alignment::Off {
        let looks: Vec<Look> = shots.par_iter().map(|s| Look::new(s.codes)).collect();
        for chain in chains(order, anchor) {
            for pair in std::iter::once(anchor).chain(chain).collect::<Vec<_>>().windows(2) {
                let (from, i) = (pair[0], pair[1]);
                let likeness = looks[from].likeness(&looks[i]);
                out[i].note = likeness.filter(|l| *l < look::DIFFERENT).map(|l| {
                    format!(
                        "{} and {} do not look like one scene (they agree by {l:.2} of 1), and they are not aligned: is it \
                         of another bracket, or was the camera moved? Its part of the result may be wrong",
                        shots[i].name, shots[from].name
                    )
                });
            }
        }
        return out;
    }
    for chain in chains(order, anchor) {
        let mut previous = anchor;
        for i in chain {
            progress(shots[i].name);
            let reference = if overlap(&shots[i], &shots[anchor]) >= ENOUGH_OVERLAP { anchor } else { previous };
            out[i] = align_pair(&shots[reference], &out[reference].field, &shots[i], how);
            previous = i;
        }
    }
    out
}

/// The pictures longer than the anchor and those shorter, each outwards from it.
pub(crate) fn chains(order: &[usize], anchor: usize) -> [Vec<usize>; 2] {
    let at = order.iter().position(|i| *i == anchor).unwrap_or(0);
    [order[at + 1..].to_vec(), order[..at].iter().rev().copied().collect()]
}

/// Natural log of the range of exposures that two pictures must share to be matched directly (three stops).
const ENOUGH_OVERLAP: f32 = 2.08;

/// Shared range in ln units, the smallest over the channels.
fn overlap(a: &Shot<'_>, b: &Shot<'_>) -> f32 {
    (0..3)
        .map(|c| {
            let (lo, hi) = common_range(a, b, c);
            hi - lo
        })
        .fold(f32::INFINITY, f32::min)
}

fn common_range(a: &Shot<'_>, b: &Shot<'_>, c: usize) -> (f32, f32) {
    let (ra, rb) = (a.decoder.useful_range(c), b.decoder.useful_range(c));
    let (ta, tb) = (a.log_secs, b.log_secs);
    let hi = (ra.1 - ta).min(rb.1 - tb);
    // Both unclipped floats: the brighter end is set by the largest value there is.
    let hi = if hi.is_finite() { hi } else { (a.decoder.full_range(c) - ta).max(b.decoder.full_range(c) - tb) };
    ((ra.0 - ta).max(rb.0 - tb), hi)
}

/// The grey picture of `shot` clamped to what it shares with `partner`.
fn matched(shot: &Shot<'_>, partner: &Shot<'_>) -> Plane {
    let ranges: [(f32, f32); 3] = std::array::from_fn(|c| common_range(shot, partner, c));
    let grey = |c: usize, u: f32| {
        let (lo, hi) = ranges[c];
        let x = (shot.decoder.log_exposure(c, u) - shot.log_secs).clamp(lo, hi.max(lo));
        ((x - hi) / 2.2).exp() / 3.0
    };
    let (w, h) = (shot.width(), shot.height());
    let mut out = Plane::new(w, h);
    // Codes go through a table; floats through the formula.
    const TABLE: usize = 4096;
    let table: Option<Vec<[f32; 3]>> = (!shot.codes.is_linear())
        .then(|| (0..TABLE).map(|i| std::array::from_fn(|c| grey(c, i as f32 / (TABLE - 1) as f32))).collect());
    out.values.par_chunks_mut(w).enumerate().for_each_init(
        || vec![0.0f32; 3 * w],
        |row, (y, out)| {
            shot.unit_row(y, row);
            for (o, p) in out.iter_mut().zip(row.chunks_exact(3)) {
                *o = match &table {
                    Some(t) => (0..3).map(|c| t[(p[c] * (TABLE - 1) as f32 + 0.5) as usize][c]).sum(),
                    None => (0..3).map(|c| grey(c, p[c])).sum(),
                };
            }
        },
    );
    if let Some(border) = &shot.border {
        // Transparent and border pixels take the mean of the others: no light of their own, and little of an edge.
        let shown = || out.values.iter().zip(border).filter(|(_, b)| !**b).map(|(v, _)| f64::from(*v));
        let mean = (shown().sum::<f64>() / shown().count().max(1) as f64) as f32;
        out.values.iter_mut().zip(border).filter(|(_, b)| **b).for_each(|(v, _)| *v = mean);
    }
    out
}

/// Aligns `shot` with `reference` (itself seen through `through`).
fn align_pair(reference: &Shot<'_>, through: &Field, shot: &Shot<'_>, how: Alignment) -> Aligned {
    let mut a = matched(reference, shot);
    if !through.is_identity() {
        a = a.resampled(a.width, a.height, |x, y| through.source(x, y));
    }
    let b = matched(shot, reference);
    let spread = a.values.iter().fold((f32::MAX, f32::MIN), |m, v| (m.0.min(*v), m.1.max(*v)));
    if spread.1 - spread.0 < 0.02 {
        let note = format!(
            "{}: shares too little of its range with {} to be aligned; left as it is",
            shot.name, reference.name
        );
        return Aligned { field: Field::identity(), cost: [0.0; 3], motion: Motion::default(), note: Some(note) };
    }
    let a = a.pyramid(global::COARSEST);
    let (affine, unmoved_cost, mut cost, mut note) = {
        let b = b.clone().pyramid(global::COARSEST);
        global_motion(&a, &b, shot.name, reference.name)
    };
    let mut field = Field { affine, grid: None };
    let global_cost = cost;
    if how == Alignment::NonLinear {
        let moved = if affine == IDENTITY {
            b
        } else {
            let m = affine;
            b.resampled(b.width, b.height, move |x, y| apply(&m, x, y))
        };
        let moved = moved.pyramid(global::COARSEST);
        let grid = local::estimate(&a, &moved);
        let with_grid = cost_of(&a[0], &moved[0], |x, y| {
            let d = grid.at(x, y);
            (x + d[0], y + d[1])
        });
        let without = cost_of(&a[0], &moved[0], |x, y| (x, y));
        if with_grid < FIELD_MUST_IMPROVE * without && grid.nodes.iter().any(|d| d[0].hypot(d[1]) > STILL) {
            field.grid = Some(grid);
            cost = global_cost * with_grid / without.max(1e-12);
        }
    }
    if field.is_identity() && note.is_none() && unmoved_cost > 0.35 {
        note = Some(format!(
            "{}: no motion found that explains its difference from {}; left as it is",
            shot.name, reference.name
        ));
    }
    let motion = motion(&a[0], &field);
    Aligned { field, cost: [unmoved_cost, global_cost, cost], motion, note }
}

/// Gradient of matched grey (per pixel) from which on a place has texture.
const TEXTURE: f32 = 0.02;

/// How far the textured places of `a` moved that the other picture, of the same size, shows too.
fn motion(a: &Plane, field: &Field) -> Motion {
    if field.is_identity() {
        return Motion::default();
    }
    let step = (((a.width * a.height) as f64 / 60_000.0).sqrt() as usize).max(1);
    let mut lengths: Vec<f32> = Vec::new();
    for y in (0..a.height).step_by(step) {
        for x in (0..a.width).step_by(step) {
            let (px, py) = (x as isize, y as isize);
            let gx = a.clamped(px + 1, py) - a.clamped(px - 1, py);
            let gy = a.clamped(px, py + 1) - a.clamped(px, py - 1);
            let (sx, sy) = field.source(x as f32, y as f32);
            if 0.5 * gx.hypot(gy) > TEXTURE && a.contains(sx, sy) {
                lengths.push((sx - x as f32).hypot(sy - y as f32));
            }
        }
    }
    if lengths.is_empty() {
        return Motion::default();
    }
    let at = (lengths.len() * 95 / 100).min(lengths.len() - 1);
    let p95 = *lengths.select_nth_unstable_by(at, f32::total_cmp).1;
    let mean = lengths[..=at].iter().map(|l| f64::from(*l)).sum::<f64>() / (at + 1) as f64;
    Motion { mean_px: mean, p95_px: f64::from(p95) }
}

/// The global map, or the identity when that explains the difference as well.
fn global_motion(a: &[Plane], b: &[Plane], name: &str, reference: &str) -> (Affine, f64, f64, Option<String>) {
    let gradients: Vec<(Plane, Plane)> = a.iter().map(Plane::gradients).collect();
    let levels: Vec<Level<'_>> =
        a.iter().zip(b).zip(&gradients).map(|((anchor, other), (gx, gy))| Level { anchor, gx, gy, other }).collect();
    let mut m = global::estimate(&levels, false);
    let mut agreement = global::agreement(a, b, &m);
    if agreement < AGREES {
        // Turned by more than hands do: dear, and therefore second.
        let wide = global::estimate(&levels, true);
        let found = global::agreement(a, b, &wide);
        if found > agreement + 0.05 {
            (m, agreement) = (wide, found);
        }
    }
    let lost = (agreement < LOST).then(|| {
        format!(
            "{name}: no motion found that brings it onto {reference} (they agree by {agreement:.2} of 1): was it turned or \
             moved too far, or is it of another scene? Its part of the result may be wrong"
        )
    });
    let unmoved = cost_of(&a[0], &b[0], |x, y| (x, y));
    let moved = cost_of(&a[0], &b[0], |x, y| apply(&m, x, y));
    let (w, h) = ((a[0].width - 1) as f32, (a[0].height - 1) as f32);
    let most = [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)]
        .iter()
        .map(|&(x, y)| {
            let p = apply(&m, x, y);
            (p.0 - x).hypot(p.1 - y)
        })
        .fold(0.0f32, f32::max);
    if most < STILL {
        return (IDENTITY, unmoved, unmoved, lost);
    }
    if moved >= MUST_IMPROVE * unmoved {
        let note = format!("{name}: the best global motion ({most:.1} px) does not improve the match; left as it is");
        return (IDENTITY, unmoved, unmoved, lost.or((most > 1.0 && unmoved > 0.15).then_some(note)));
    }
    (m, unmoved, moved, lost)
}

/// Agreement of the pictures' edges (0 to 1) that ends the search, and the one below which nothing was found.
const AGREES: f64 = 0.5;
const LOST: f64 = 0.35;

/// Difference at which a matched grey value counts half.
const HALF: f32 = 0.03;

/// Robust mean difference in [0, 1] under a motion, on a grid of about 120,000 pixels; pixels without partner left out.
fn cost_of(a: &Plane, b: &Plane, source: impl Fn(f32, f32) -> (f32, f32) + Sync) -> f64 {
    let step = (((a.width * a.height) as f64 / 120_000.0).sqrt() as usize).max(1);
    let rows: Vec<usize> = (0..a.height).step_by(step).collect();
    let sums: Vec<(f64, u32)> = rows
        .par_iter()
        .map(|&y| {
            let (mut sum, mut n) = (0.0f64, 0u32);
            for x in (0..a.width).step_by(step) {
                let (sx, sy) = source(x as f32, y as f32);
                if b.contains(sx, sy) {
                    let r = b.cubic(sx, sy) - a.values[y * a.width + x];
                    sum += f64::from(r * r / (r * r + HALF * HALF));
                    n += 1;
                }
            }
            (sum, n)
        })
        .collect();
    // Row after row, whatever the number of threads: the last bits decide what motion is believed.
    let (sum, n) = sums.iter().fold((0.0, 0), |p, q| (p.0 + q.0, p.1 + q.1));
    if n == 0 { 1.0 } else { sum / f64::from(n) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motion_is_that_of_textured_places() {
        // Texture on the left, nothing on the right, where the field runs away.
        let mut a = Plane::new(128, 96);
        for y in 0..96 {
            for x in 0..64 {
                a.values[y * 128 + x] = if (x / 4 + y / 4) % 2 == 0 { 0.8 } else { 0.2 };
            }
        }
        let mut grid = crate::field::Grid::zero(16, 128, 96);
        for (k, node) in grid.nodes.iter_mut().enumerate() {
            *node = if k % grid.nx < 5 { [3.0, 0.0] } else { [-40.0, 9.0] };
        }
        let field = Field { affine: IDENTITY, grid: Some(grid) };
        assert!(field.longest(128, 96) > 40.0);
        let m = motion(&a, &field);
        assert!((m.mean_px - 3.0).abs() < 0.01 && (m.p95_px - 3.0).abs() < 0.01, "{m:?}");
        assert_eq!(motion(&a, &Field::identity()), Motion::default());
    }
}
