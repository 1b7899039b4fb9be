//! The global affine motion between two grey pictures of equal exposure (beyond the thesis, which starts from a
//! translation of the whole picture).
//!
//! Coarsest level: exhaustive search over rotations and translations by normalised correlation on overlapping pixels.
//! The best few are refined down the pyramid by Gauss–Newton (inverse compositional [Baker & Matthews 2004]) with
//! weights that ignore what moves on its own, and a gain and offset for what the response estimate leaves.

use crate::field::{Affine, IDENTITY, apply, compose, invert};
use crate::plane::{self, Plane};
use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;

/// Shorter side of the coarsest level, in pixels (up to twice that).
pub(crate) const COARSEST: usize = 32;
/// Largest rotation searched, degrees, and the step of the search.
const ROTATION: (i32, usize) = (15, 3);
/// Step of the search over the whole circle.
const WIDE_STEP: usize = 4;
/// Products that a search may cost; beyond, it reaches less far (strips of a few pixels' width).
const MOST_PRODUCTS: usize = 400_000_000;
/// Largest translation searched, as a share of the sides.
const TRANSLATION: f32 = 0.25;

/// One level of a pair: the anchor with its gradients, and the other picture.
pub(crate) struct Level<'a> {
    pub(crate) anchor: &'a Plane,
    pub(crate) gx: &'a Plane,
    pub(crate) gy: &'a Plane,
    pub(crate) other: &'a Plane,
}

/// The affine map from anchor to other pixels at the finest of `levels` (finest first); `wide` looks at any rotation,
/// not only at those of a camera held by hand.
pub(crate) fn estimate(levels: &[Level<'_>], wide: bool) -> Affine {
    let Some(coarsest) = levels.last() else { return IDENTITY };
    let rotations: Vec<i32> = match wide {
        _ if coarsest.anchor.width.min(coarsest.anchor.height) < 8 => vec![0],
        true => (-180..180).step_by(WIDE_STEP).collect(),
        false => (-ROTATION.0..=ROTATION.0).step_by(ROTATION.1).collect(),
    };
    let mut candidates = search(coarsest, &rotations);
    candidates.push(IDENTITY);
    for (i, level) in levels.iter().enumerate().rev() {
        let last = i + 1 == levels.len();
        if !last {
            for m in &mut candidates {
                *m = finer(m);
            }
        }
        let mut scored: Vec<(f64, Affine)> = candidates
            .par_iter()
            .map(|m| {
                let m = refine(level, m, if last { 12 } else { 8 });
                (cost(level, &m), m)
            })
            .collect();
        scored.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Few survive the coarsest level, one the level of about 100 pixels.
        let keep = if last { 4 } else { 1 };
        candidates = scored.into_iter().take(keep).map(|s| s.1).collect();
    }
    candidates.first().copied().unwrap_or(IDENTITY)
}

/// The same motion one level coarser.
fn coarser(m: &Affine) -> Affine {
    let up = [2.0, 0.0, 0.5, 0.0, 2.0, 0.5];
    let down = [0.5, 0.0, -0.25, 0.0, 0.5, -0.25];
    compose(&down, &compose(m, &up))
}

/// Correlation of the gradients of `a` with those of `b` seen through `m`, in [−1, 1], on the level next to the coarsest
/// (finest first): near 1 for one scene, near 0 for two, whatever the brightness.
pub(crate) fn agreement(a: &[Plane], b: &[Plane], m: &Affine) -> f64 {
    let level = a.len().saturating_sub(2);
    let m = (0..level).fold(*m, |m, _| coarser(&m));
    let (a, b) = (&a[level], &b[level]);
    let ((ax, ay), (bx, by)) = (a.gradients(), b.resampled(a.width, a.height, |x, y| apply(&m, x, y)).gradients());
    let (mut ab, mut aa, mut bb) = (0.0f64, 0.0f64, 0.0f64);
    for i in 0..a.values.len() {
        let (x, y) = apply(&m, (i % a.width) as f32, (i / a.width) as f32);
        if b.contains(x - 1.0, y - 1.0) && b.contains(x + 1.0, y + 1.0) {
            let (p, q) = ([ax.values[i], ay.values[i]].map(f64::from), [bx.values[i], by.values[i]].map(f64::from));
            ab += p[0] * q[0] + p[1] * q[1];
            aa += p[0] * p[0] + p[1] * p[1];
            bb += q[0] * q[0] + q[1] * q[1];
        }
    }
    if aa * bb > 0.0 { ab / (aa * bb).sqrt() } else { 1.0 }
}

/// The same motion one level finer, where pixel x of the coarse level sits at 2x + 0.5.
pub(crate) fn finer(m: &Affine) -> Affine {
    let up = [2.0, 0.0, 0.5, 0.0, 2.0, 0.5];
    let down = [0.5, 0.0, -0.25, 0.0, 0.5, -0.25];
    compose(&up, &compose(m, &down))
}

/// The best distinct rotations and translations of the coarsest level.
fn search(level: &Level<'_>, rotations: &[i32]) -> Vec<Affine> {
    let (w, h) = (level.anchor.width as f64, level.anchor.height as f64);
    let (mut rx, mut ry) = ((w * f64::from(TRANSLATION)) as i32, (h * f64::from(TRANSLATION)) as i32);
    let products =
        |rx: i32, ry: i32| (2 * rx as usize + 1) * (2 * ry as usize + 1) * rotations.len() * (w * h) as usize;
    while products(rx, ry) > MOST_PRODUCTS && rx.max(ry) > 0 {
        *(if rx > ry { &mut rx } else { &mut ry }) /= 2;
    }
    let (a, b) = (level.anchor.edges(), level.other.edges());
    let mut found: Vec<(f64, i32, i32, i32)> = rotations
        .par_iter()
        .flat_map_iter(|&degrees| {
            let turned = b.resampled(a.width, a.height, |x, y| {
                let (sx, sy) = apply(&about_centre(degrees, 0, 0, w, h), x, y);
                (sx, sy)
            });
            let (a, turned) = (&a, turned);
            let scores: Vec<(f64, i32, i32, i32)> = (-ry..=ry)
                .flat_map(|dy| (-rx..=rx).map(move |dx| (dx, dy)))
                .map(|(dx, dy)| (correlation(a, &turned, dx, dy), degrees, dx, dy))
                .collect();
            scores
        })
        .collect();
    found.sort_by(|p, q| q.0.total_cmp(&p.0));
    let mut best: Vec<(i32, i32, i32)> = Vec::new();
    for (_, degrees, dx, dy) in found {
        let near = |b: &(i32, i32, i32)| (b.0 - degrees).abs() <= 3 && (b.1 - dx).abs() <= 2 && (b.2 - dy).abs() <= 2;
        if !best.iter().any(near) {
            best.push((degrees, dx, dy));
        }
        if best.len() == 6 {
            break;
        }
    }
    best.into_iter().map(|(degrees, dx, dy)| about_centre(degrees, dx, dy, w, h)).collect()
}

/// Translation by (dx, dy), then rotation about the picture's centre.
fn about_centre(degrees: i32, dx: i32, dy: i32, w: f64, h: f64) -> Affine {
    let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
    let (cx, cy) = ((w - 1.0) / 2.0, (h - 1.0) / 2.0);
    let rotate = [cos, -sin, cx - cos * cx + sin * cy, sin, cos, cy - sin * cx - cos * cy];
    compose(&rotate, &[1.0, 0.0, f64::from(dx), 0.0, 1.0, f64::from(dy)])
}

/// Normalised correlation of a(p) with b(p + d) over the pixels that both have.
fn correlation(a: &Plane, b: &Plane, dx: i32, dy: i32) -> f64 {
    let (w, h) = (a.width as i32, a.height as i32);
    let (x0, x1) = (0.max(-dx), w.min(w - dx));
    let (y0, y1) = (0.max(-dy), h.min(h - dy));
    let n = ((x1 - x0).max(0) * (y1 - y0).max(0)) as f64;
    if n < 0.3 * f64::from(w * h) {
        return -1.0;
    }
    let (mut sa, mut sb, mut saa, mut sbb, mut sab) = (0.0f64, 0.0, 0.0, 0.0, 0.0);
    for y in y0..y1 {
        let ra = &a.row(y as usize)[x0 as usize..x1 as usize];
        let rb = &b.row((y + dy) as usize)[(x0 + dx) as usize..(x1 + dx) as usize];
        let [ta, tb, taa, tbb, tab] = plane::sums(ra, rb);
        sa += f64::from(ta);
        sb += f64::from(tb);
        saa += f64::from(taa);
        sbb += f64::from(tbb);
        sab += f64::from(tab);
    }
    let (va, vb) = (saa - sa * sa / n, sbb - sb * sb / n);
    // Less overlap is less evidence.
    (sab - sa * sb / n) / (va * vb).sqrt().max(1e-12) * (n / f64::from(w * h)).sqrt().min(1.0)
}

/// Every how many pixels (in x and y) a level is sampled: about 60,000 samples.
fn stride(level: &Level<'_>) -> usize {
    (((level.anchor.width * level.anchor.height) as f64 / 60_000.0).sqrt().round() as usize).max(1)
}

/// Differences `other(M p) − anchor(p)` on the sampled grid.
fn residuals(level: &Level<'_>, m: &Affine) -> Vec<f32> {
    let step = stride(level);
    let mut out = Vec::new();
    for y in (0..level.anchor.height).step_by(step) {
        for x in (0..level.anchor.width).step_by(step) {
            let (sx, sy) = apply(m, x as f32, y as f32);
            if level.other.contains(sx, sy) {
                out.push(level.other.bilinear(sx, sy) - level.anchor.values[y * level.anchor.width + x]);
            }
        }
    }
    out
}

/// Median of absolute values, as a standard deviation of the undisturbed part.
fn robust_scale(residuals: &mut [f32]) -> f32 {
    if residuals.is_empty() {
        return 1.0;
    }
    let mid = residuals.len() / 2;
    residuals.iter_mut().for_each(|r| *r = r.abs());
    let (_, median, _) = residuals.select_nth_unstable_by(mid, f32::total_cmp);
    1.4826 * *median
}

/// Noise floor of matched grey values (about half a code).
const FLOOR: f32 = 0.004;

/// Robust mean square of the difference relative to the anchor's variance; missing overlap counts as bad match.
pub(crate) fn cost(level: &Level<'_>, m: &Affine) -> f64 {
    let r = residuals(level, m);
    let all = level.anchor.width.div_ceil(stride(level)) * level.anchor.height.div_ceil(stride(level));
    if r.len() * 4 < all {
        return f64::INFINITY;
    }
    // Half overlap is no reason to prefer a wrong match with more of it: compare means, with a mild penalty.
    let offset = {
        let mut s = r.clone();
        let k = s.len() / 2;
        *s.select_nth_unstable_by(k, f32::total_cmp).1
    };
    let c2 = 0.1f64 * 0.1;
    let mean = r
        .iter()
        .map(|v| {
            let d = f64::from(v - offset).powi(2);
            d / (d + c2)
        })
        .sum::<f64>()
        / r.len() as f64;
    mean * (all as f64 / r.len() as f64).sqrt()
}

/// Gauss–Newton on one level.
fn refine(level: &Level<'_>, start: &Affine, rounds: usize) -> Affine {
    let mut m = *start;
    let (w, h) = (level.anchor.width as f64, level.anchor.height as f64);
    let (cx, cy, radius) = ((w - 1.0) / 2.0, (h - 1.0) / 2.0, w.max(h) / 2.0);
    let step = stride(level);
    for _ in 0..rounds {
        let scale = robust_scale(&mut residuals(level, &m)).max(FLOOR) * 2.0;
        let mut a = SMatrix::<f64, 8, 8>::zeros();
        let mut b = SVector::<f64, 8>::zeros();
        for y in (0..level.anchor.height).step_by(step) {
            for x in (0..level.anchor.width).step_by(step) {
                let (sx, sy) = apply(&m, x as f32, y as f32);
                if !level.other.contains(sx, sy) {
                    continue;
                }
                let i = y * level.anchor.width + x;
                let value = level.other.bilinear(sx, sy);
                let r = value - level.anchor.values[i];
                let q = r / scale;
                let weight = f64::from(1.0 / ((1.0 + q * q) * (1.0 + q * q)));
                let (gx, gy) = (f64::from(level.gx.values[i]), f64::from(level.gy.values[i]));
                let (u, v) = ((x as f64 - cx) / radius, (y as f64 - cy) / radius);
                let j = SVector::<f64, 8>::from([gx * u, gx * v, gx, gy * u, gy * v, gy, -f64::from(value), -1.0]);
                a += weight * j * j.transpose();
                b += weight * f64::from(r) * j;
            }
        }
        for k in 0..8 {
            a[(k, k)] += 1e-6 * a[(k, k)].max(1e-6);
        }
        let Some(delta) = a.cholesky().map(|c| c.solve(&b)) else { break };
        if delta.iter().any(|d| !d.is_finite()) {
            break;
        }
        // The increment acts on centred, scaled coordinates: u' = u + (d0 u + d1 v + d2)/radius.
        let inner = [
            1.0 + delta[0] / radius,
            delta[1] / radius,
            delta[2] / radius,
            delta[3] / radius,
            1.0 + delta[4] / radius,
            delta[5] / radius,
        ];
        let to = [1.0 / radius, 0.0, -cx / radius, 0.0, 1.0 / radius, -cy / radius];
        let from = [radius, 0.0, cx, 0.0, radius, cy];
        let Some(back) = invert(&compose(&from, &compose(&inner, &to))) else { break };
        let next = compose(&m, &back);
        if !plausible(&next) {
            break;
        }
        m = next;
        if delta.fixed_rows::<6>(0).amax() < 0.003 {
            break;
        }
    }
    m
}

/// Hand-held pictures turn and shift; they do not shear or zoom by more than a few per cent.
fn plausible(m: &Affine) -> bool {
    let det = m[0] * m[4] - m[1] * m[3];
    let shear = (m[0] * m[1] + m[3] * m[4]).abs();
    let zooms = [m[0].hypot(m[3]), m[1].hypot(m[4])];
    (0.85..1.18).contains(&det) && shear < 0.15 && zooms.iter().all(|z| (0.8..1.25).contains(z))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth random texture at a continuous position.
    fn texture(x: f32, y: f32) -> f32 {
        let mut rng = translume_core::rng::Pcg32::new(5, 0);
        let mut v = 0.5;
        for _ in 0..24 {
            let (fx, fy) = (rng.next_f32() * 0.5 - 0.25, rng.next_f32() * 0.5 - 0.25);
            v += 0.05 * (fx * x + fy * y + std::f32::consts::TAU * rng.next_f32()).sin();
        }
        v
    }

    fn pair(m: &Affine) -> (Plane, Plane) {
        let at = |f: &(dyn Fn(f32, f32) -> f32 + Sync)| {
            let mut p = Plane::new(240, 180);
            for y in 0..180 {
                for x in 0..240 {
                    p.values[y * 240 + x] = f(x as f32, y as f32);
                }
            }
            p
        };
        let back = invert(m).unwrap();
        let anchor = at(&texture);
        let other = at(&|x, y| {
            let (u, v) = apply(&back, x, y);
            texture(u, v)
        });
        (anchor, other)
    }

    /// What `estimate` says of each of `wide`.
    fn estimates<const N: usize>(a: &[Plane], b: &[Plane], wide: [bool; N]) -> [Affine; N] {
        let gradients: Vec<_> = a.iter().map(Plane::gradients).collect();
        let levels = a.iter().zip(b).zip(&gradients);
        let levels: Vec<_> = levels.map(|((anchor, other), (gx, gy))| Level { anchor, gx, gy, other }).collect();
        wide.map(|wide| estimate(&levels, wide))
    }

    fn run(anchor: Plane, other: Plane) -> Affine {
        let [found] = estimates(&anchor.pyramid(COARSEST), &other.pyramid(COARSEST), [false]);
        found
    }

    fn worst(m: &Affine, truth: &Affine) -> f64 {
        [(0.0, 0.0), (239.0, 0.0), (0.0, 179.0), (239.0, 179.0)]
            .iter()
            .map(|&(x, y)| {
                let (p, q) = (apply(m, x, y), apply(truth, x, y));
                f64::from((p.0 - q.0).hypot(p.1 - q.1))
            })
            .fold(0.0, f64::max)
    }

    #[test]
    fn finds_translation_and_rotation_to_a_tenth_of_a_pixel() {
        for (degrees, dx, dy) in [(0.0f64, 11.5, -7.25), (2.0, 8.0, 5.0), (-9.5, -14.0, 9.0)] {
            let (s, c) = degrees.to_radians().sin_cos();
            let truth = [c, -s, dx + 120.0 * (1.0 - c) + 90.0 * s, s, c, dy - 120.0 * s + 90.0 * (1.0 - c)];
            let (a, b) = pair(&truth);
            let error = worst(&run(a, b), &truth);
            assert!(error < 0.1, "{degrees}° ({dx}, {dy}): {error} px");
        }
    }

    #[test]
    fn any_rotation_is_found_when_it_is_looked_for_and_the_agreement_tells() {
        for degrees in [33.0f64, -100.0, 180.0] {
            let (s, c) = degrees.to_radians().sin_cos();
            let (dx, dy) = (5.0, -3.0);
            let truth = [c, -s, dx + 119.5 * (1.0 - c) + 89.5 * s, s, c, dy - 119.5 * s + 89.5 * (1.0 - c)];
            let (anchor, other) = pair(&truth);
            let (a, b) = (anchor.pyramid(COARSEST), other.pyramid(COARSEST));
            let [near, wide] = estimates(&a, &b, [false, true]);
            assert!(worst(&wide, &truth) < 0.3, "{degrees}°: {} px", worst(&wide, &truth));
            let (near, wide) = (agreement(&a, &b, &near), agreement(&a, &b, &wide));
            assert!(wide > 0.8 && near < wide - 0.2, "{degrees}°: {near} {wide}");
        }
    }

    #[test]
    fn a_moving_object_does_not_drag_it() {
        let (a, mut b) = pair(&IDENTITY);
        for y in 40..100 {
            for x in 60..130 {
                b.values[y * 240 + x] = 0.9 - 0.3 * texture(x as f32 + 500.0, y as f32);
            }
        }
        let error = worst(&run(a, b), &IDENTITY);
        assert!(error < 0.1, "{error} px");
    }
}
