//! Hierarchical non-linear alignment by macroblocks [Menzel 2012, §5.1], then sub-pixel positions.
//!
//! As in the thesis: blocks of 16 × 16 on every level of a pyramid (which is blocks of 2ⁿ on the picture, at a cost
//! linear in pixels), correlation of edge-enhanced pictures, nine starts (the interpolated parent displacement and
//! those of its neighbours), ascent by single pixels up to the search radius, ties to the interpolated start, and the
//! 10 % rule. The score divides by √N where the thesis prints N, which would double at each subdivision.
//!
//! Beyond the thesis: it works on what the global motion leaves; and the finest level ends with a Gauss–Newton step per
//! node whose results are weighed by how much the block says about them (structure tensor over residual) and smoothed
//! where it says little, so that flat blocks and edges seen along one direction follow their neighbours.

use crate::field::Grid;
use crate::plane::{self, Plane};
use rayon::prelude::*;
use std::collections::HashMap;

/// Block size on each level.
const BLOCK: usize = 16;
/// Pixels around a block that also count in its score, against ties in small blocks.
const MARGIN: isize = 4;
/// A block whose correlation is below this share of its parent's is not displaced [Menzel 2012, §5.1 ten percent].
const TEN_PERCENT: f32 = 0.1;
/// Steps of the ascent on the coarsest and on all finer levels.
const RADIUS: (usize, usize) = (4, 2);

/// Levels of at most this many pixels are also searched from a lattice of starts 3 pixels apart, up to 6 away: near
/// things that move far against the rest are found while they still fill a block.
const WIDE_SEARCH: usize = 36_000;

/// Displacements (in finest pixels, at blocks of 16) that align `other` with `anchor`; both are pyramids, finest first.
pub(crate) fn estimate(anchor: &[Plane], other: &[Plane]) -> Grid {
    let coarsest = anchor.len() - 1;
    let mut parent: Option<(Grid, Vec<f32>)> = None;
    for level in (0..=coarsest).rev() {
        let (a, b) = (anchor[level].edges(), other[level].edges());
        let radius = if level == coarsest { RADIUS.0 } else { RADIUS.1 };
        parent = Some(match_level(&a, &b, parent.as_ref(), radius));
    }
    let integer = parent.map_or_else(|| Grid::zero(BLOCK, anchor[0].width, anchor[0].height), |p| p.0);
    subpixel(&anchor[0], &other[0], &median3(&integer))
}

/// One level: best integer displacement and score per block.
fn match_level(a: &Plane, b: &Plane, parent: Option<&(Grid, Vec<f32>)>, radius: usize) -> (Grid, Vec<f32>) {
    let mut grid = Grid::zero(BLOCK, a.width, a.height);
    let (nx, ny) = (grid.nx, grid.ny);
    let wide = a.width * a.height <= WIDE_SEARCH;
    let results: Vec<([f32; 2], f32)> = (0..nx * ny)
        .into_par_iter()
        .map(|k| {
            let (bx, by) = (k % nx, k / nx);
            let (centre, starts, parent_score) = match parent {
                None => ([0.0; 2], vec![[0, 0]], 0.0),
                Some((p, scores)) => starts_of(p, scores, grid.centre(bx), grid.centre(by)),
            };
            let mut starts = starts;
            if wide {
                let c = [centre[0].round() as i32, centre[1].round() as i32];
                starts.extend((-2..=2).flat_map(|y| (-2..=2).map(move |x| [c[0] + 3 * x, c[1] + 3 * y])));
            }
            best_of(a, b, bx, by, centre, &starts, radius, parent_score)
        })
        .collect();
    grid.nodes = results.iter().map(|r| r.0).collect();
    (grid, results.into_iter().map(|r| r.1).collect())
}

/// [Menzel 2012, §5.1 starts]: the interpolated displacement of the parent level at a block, the nine starts and the parent's score.
fn starts_of(parent: &Grid, scores: &[f32], x: f32, y: f32) -> ([f32; 2], Vec<[i32; 2]>, f32) {
    // Coarse pixel x sits at fine 2x + 0.5.
    let (px, py) = ((x - 0.5) / 2.0, (y - 0.5) / 2.0);
    let d = parent.at(px, py);
    let centre = [2.0 * d[0], 2.0 * d[1]];
    let round = |v: [f32; 2]| [v[0].round() as i32, v[1].round() as i32];
    let mut starts = vec![round(centre)];
    let cx = ((px / parent.step as f32) as isize).clamp(0, parent.nx as isize - 1);
    let cy = ((py / parent.step as f32) as isize).clamp(0, parent.ny as isize - 1);
    for dy in -1..=1 {
        for dx in -1..=1 {
            let (nx, ny) = (cx + dx, cy + dy);
            if nx >= 0 && ny >= 0 && nx < parent.nx as isize && ny < parent.ny as isize {
                let n = parent.nodes[ny as usize * parent.nx + nx as usize];
                let s = round([2.0 * n[0], 2.0 * n[1]]);
                if !starts.contains(&s) {
                    starts.push(s);
                }
            }
        }
    }
    (centre, starts, scores[cy as usize * parent.nx + cx as usize])
}

/// [Menzel 2012, §5.1 search]: ascends from every start and takes the best; ties go to the one nearest to the interpolated displacement.
#[allow(clippy::too_many_arguments, reason = "the state of one block; a struct would only rename it")]
fn best_of(
    a: &Plane,
    b: &Plane,
    bx: usize,
    by: usize,
    centre: [f32; 2],
    starts: &[[i32; 2]],
    radius: usize,
    parent_score: f32,
) -> ([f32; 2], f32) {
    let block = Block::new(a, bx, by);
    let mut known: HashMap<[i32; 2], f32> = HashMap::new();
    let mut score = |d: [i32; 2]| *known.entry(d).or_insert_with(|| block.score(b, d));
    let distance = |d: [i32; 2]| (d[0] as f32 - centre[0]).hypot(d[1] as f32 - centre[1]);
    let first = [centre[0].round() as i32, centre[1].round() as i32];
    let (mut best, mut best_score) = (first, score(first));
    for &start in starts {
        let (mut d, mut s) = (start, score(start));
        for _ in 0..radius {
            let around = [[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]];
            let next = around
                .iter()
                .map(|o| [d[0] + o[0], d[1] + o[1]])
                .map(|n| (score(n), n))
                .fold((s, d), |m, n| if n.0 > m.0 { n } else { m });
            if next.1 == d {
                break;
            }
            (s, d) = next;
        }
        // One part in a thousand better, or as good and nearer.
        if s > best_score * 1.001 + 1e-9 || (s >= best_score && distance(d) < distance(best)) {
            (best, best_score) = (d, s);
        }
    }
    if best_score < TEN_PERCENT * parent_score {
        // Gradually lower, so that the children of a flat block are not held to a bar that it missed itself.
        return (centre, TEN_PERCENT.sqrt() * parent_score);
    }
    ([best[0] as f32, best[1] as f32], best_score)
}

/// The anchor's side of a block, centred on its mean.
struct Block {
    x0: isize,
    y0: isize,
    width: usize,
    values: Vec<f32>,
}

impl Block {
    fn new(a: &Plane, bx: usize, by: usize) -> Self {
        let span = |b: usize, side: usize| {
            let lo = (b * BLOCK) as isize - MARGIN;
            (lo.max(0), (lo + (BLOCK as isize) + 2 * MARGIN).min(side as isize))
        };
        let ((x0, x1), (y0, y1)) = (span(bx, a.width), span(by, a.height));
        let mut values: Vec<f32> =
            (y0..y1).flat_map(|y| a.row(y as usize)[x0 as usize..x1 as usize].iter().copied()).collect();
        let mean = values.iter().sum::<f32>() / values.len().max(1) as f32;
        values.iter_mut().for_each(|v| *v -= mean);
        Self { x0, y0, width: (x1 - x0) as usize, values }
    }

    /// Σ b̃ ã / √(N Σ b̃²) at displacement `d`; pixels outside the other picture duplicate its edge.
    fn score(&self, b: &Plane, d: [i32; 2]) -> f32 {
        let (mut sum, mut squares, mut product) = (0.0f32, 0.0f32, 0.0f32);
        let x = self.x0 + d[0] as isize;
        let inside = x >= 0 && x + self.width as isize <= b.width as isize;
        let mut row_buffer = [0.0f32; BLOCK + 2 * MARGIN as usize];
        for (k, ra) in self.values.chunks_exact(self.width).enumerate() {
            let y = (self.y0 + k as isize + d[1] as isize).clamp(0, b.height as isize - 1);
            let rb: &[f32] = if inside {
                &b.row(y as usize)[x as usize..x as usize + self.width]
            } else {
                for (l, v) in row_buffer[..self.width].iter_mut().enumerate() {
                    *v = b.clamped(x + l as isize, y);
                }
                &row_buffer[..self.width]
            };
            let [_, tb, _, tbb, tab] = plane::sums(ra, rb);
            (sum, squares, product) = (sum + tb, squares + tbb, product + tab);
        }
        let n = self.values.len() as f32;
        // [Menzel 2012, §5.1 score], corrected. ã has mean 0, so b's mean drops out of the product.
        let variance = (squares - sum * sum / n).max(0.0);
        if variance <= 1e-9 { 0.0 } else { product / (n * variance).sqrt() }
    }
}

/// Component-wise median over 3 × 3 nodes.
fn median3(grid: &Grid) -> Grid {
    let mut out = grid.clone();
    for iy in 0..grid.ny {
        for ix in 0..grid.nx {
            for c in 0..2 {
                let mut v: Vec<f32> = Vec::with_capacity(9);
                for y in iy.saturating_sub(1)..(iy + 2).min(grid.ny) {
                    for x in ix.saturating_sub(1)..(ix + 2).min(grid.nx) {
                        v.push(grid.nodes[y * grid.nx + x][c]);
                    }
                }
                let mid = v.len() / 2;
                out.nodes[iy * grid.nx + ix][c] = *v.select_nth_unstable_by(mid, f32::total_cmp).1;
            }
        }
    }
    out
}

/// What one node's window says: displacement, information matrix (xx, xy, yy) per pixel², its residual variance.
#[derive(Clone, Copy)]
struct Measurement {
    d: [f32; 2],
    information: [f32; 3],
}

/// Robust difference over a window, in [0, 1], and the standard error of that mean.
#[derive(Clone, Copy)]
struct Cost {
    mean: f32,
    error: f32,
}

/// Half side of the window of a node.
const WINDOW: isize = 14;
/// Standard errors by which a displacement must beat standing still: the search tries about a hundred.
const SIGNIFICANT: f32 = 3.0;
/// A robust difference above this is no match, whatever the search preferred: the node follows its neighbours.
const HOPELESS: f32 = 0.4;
/// Variance of matched grey values from rounding and noise.
const NOISE: f32 = 0.006 * 0.006;
/// Share of the information that is independent, windows overlapping and pixels being correlated.
const INDEPENDENT: f32 = 0.05;

/// Sub-pixel displacements by two rounds of Gauss–Newton per node and confidence-weighted smoothing.
fn subpixel(a: &Plane, b: &Plane, start: &Grid) -> Grid {
    let (gx, gy) = a.gradients();
    let mut grid = start.clone();
    for round in 0..3 {
        let measured: Vec<Measurement> = (0..grid.nodes.len())
            .into_par_iter()
            .map(|k| {
                let d = grid.nodes[k];
                let candidate = measure(a, &gx, &gy, b, &grid, k, d);
                // Staying put is a candidate on the first round: no displacement without a gain.
                if round == 0 && d != [0.0; 2] {
                    let still = measure(a, &gx, &gy, b, &grid, k, [0.0; 2]);
                    let chance = SIGNIFICANT * (still.1.error.hypot(candidate.1.error)) + 0.002;
                    if still.1.mean <= candidate.1.mean + chance { still.0 } else { candidate.0 }
                } else {
                    candidate.0
                }
            })
            .collect();
        grid.nodes = smooth(&grid, &measured);
    }
    grid
}

/// Gauss–Newton from displacement `d` at node `k`, and the robust cost there.
fn measure(a: &Plane, gx: &Plane, gy: &Plane, b: &Plane, grid: &Grid, k: usize, d: [f32; 2]) -> (Measurement, Cost) {
    let (cx, cy) = (grid.centre(k % grid.nx) as isize, grid.centre(k / grid.nx) as isize);
    let (x0, x1) = ((cx - WINDOW).max(0), (cx + WINDOW + 1).min(a.width as isize));
    let (y0, y1) = ((cy - WINDOW).max(0), (cy + WINDOW + 1).min(a.height as isize));
    let (mut xx, mut xy, mut yy, mut ex, mut ey) = (0.0f32, 0.0f32, 0.0f32, 0.0f32, 0.0f32);
    let (mut weights, mut squares, mut n) = (0.0f32, 0.0f32, 0.0f32);
    let (mut cost, mut cost_squares) = (0.0f32, 0.0f32);
    // Every second pixel in a checkerboard is enough for two unknowns.
    for y in y0..y1 {
        let mut x = x0 + ((x0 + y) & 1);
        while x < x1 {
            let (sx, sy) = (x as f32 + d[0], y as f32 + d[1]);
            let i = y as usize * a.width + x as usize;
            x += 2;
            if !b.contains(sx, sy) {
                continue;
            }
            let r = b.bilinear(sx, sy) - a.values[i];
            let w = 1.0 / (1.0 + r * r / (25.0 * NOISE));
            let (px, py) = (gx.values[i], gy.values[i]);
            xx += w * px * px;
            xy += w * px * py;
            yy += w * py * py;
            ex += w * px * r;
            ey += w * py * r;
            weights += w;
            squares += w * r * r;
            let c = r * r / (r * r + 25.0 * NOISE);
            cost += c;
            cost_squares += c * c;
            n += 1.0;
        }
    }
    let none = Measurement { d, information: [0.0; 3] };
    if n < 20.0 {
        return (none, Cost { mean: 1.0, error: 0.0 });
    }
    let mean = cost / n;
    let cost = Cost { mean, error: ((cost_squares / n - mean * mean).max(0.0) / n).sqrt() };
    // Damped, so that a direction without structure is left alone.
    let ridge = 0.02 * (xx + yy) * 0.5 + 1e-7;
    let (hxx, hyy) = (xx + ridge, yy + ridge);
    let det = hxx * hyy - xy * xy;
    let step = [-(hyy * ex - xy * ey) / det, -(hxx * ey - xy * ex) / det];
    let length = step[0].hypot(step[1]);
    let shrink = if length > 1.0 { 1.0 / length } else { 1.0 };
    let variance = squares / weights.max(1e-3) + NOISE;
    // A window in which most pixels disagree tells little, however sharp it is.
    let trust = if mean > HOPELESS { 0.0 } else { INDEPENDENT * (weights / n).powi(2) / variance };
    let m = Measurement {
        d: [d[0] + shrink * step[0], d[1] + shrink * step[1]],
        information: [trust * xx, trust * xy, trust * yy],
    };
    (m, cost)
}

/// Minimises Σ (d−m)ᵀ C (d−m) + λ Σ ψ(|d_i − d_j|²) + μ |d|² over the grid by Gauss–Seidel; ψ lets motion jump.
fn smooth(grid: &Grid, measured: &[Measurement]) -> Vec<[f32; 2]> {
    const LAMBDA: f32 = 6.0;
    const TO_GLOBAL: f32 = 0.02;
    const JUMP: f32 = 1.0;
    let (nx, ny) = (grid.nx, grid.ny);
    let mut d: Vec<[f32; 2]> = grid.nodes.clone();
    for _ in 0..40 {
        for k in 0..nx * ny {
            let (ix, iy) = (k % nx, k / nx);
            let m = &measured[k];
            let [cxx, cxy, cyy] = m.information;
            let (mut hxx, mut hyy) = (cxx + TO_GLOBAL, cyy + TO_GLOBAL);
            let mut rhs = [cxx * m.d[0] + cxy * m.d[1], cxy * m.d[0] + cyy * m.d[1]];
            let neighbours = [
                (ix > 0).then(|| k - 1),
                (ix + 1 < nx).then(|| k + 1),
                (iy > 0).then(|| k - nx),
                (iy + 1 < ny).then(|| k + nx),
            ];
            for n in neighbours.into_iter().flatten() {
                let jump = (d[n][0] - d[k][0]).powi(2) + (d[n][1] - d[k][1]).powi(2);
                let weight = LAMBDA / (1.0 + jump / (JUMP * JUMP));
                hxx += weight;
                hyy += weight;
                rhs[0] += weight * d[n][0];
                rhs[1] += weight * d[n][1];
            }
            let det = hxx * hyy - cxy * cxy;
            d[k] = [(hyy * rhs[0] - cxy * rhs[1]) / det, (hxx * rhs[1] - cxy * rhs[0]) / det];
        }
    }
    d
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texture(x: f32, y: f32) -> f32 {
        let mut rng = translume_core::rng::Pcg32::new(9, 0);
        let mut v = 0.5;
        for _ in 0..30 {
            let (fx, fy) = (rng.next_f32() - 0.5, rng.next_f32() - 0.5);
            v += 0.05 * (fx * x + fy * y + std::f32::consts::TAU * rng.next_f32()).sin();
        }
        v
    }

    fn plane(f: impl Fn(f32, f32) -> f32) -> Plane {
        let mut p = Plane::new(320, 256);
        for y in 0..256 {
            for x in 0..320 {
                p.values[y * 320 + x] = f(x as f32, y as f32);
            }
        }
        p
    }

    /// Mean end-point error away from the borders.
    fn error(grid: &Grid, truth: impl Fn(f32, f32) -> [f32; 2]) -> f32 {
        let mut sum = 0.0;
        let mut n = 0.0;
        for y in (24..232).step_by(4) {
            for x in (24..296).step_by(4) {
                let (d, t) = (grid.at(x as f32, y as f32), truth(x as f32, y as f32));
                sum += (d[0] - t[0]).hypot(d[1] - t[1]);
                n += 1.0;
            }
        }
        sum / n
    }

    #[test]
    fn follows_a_bending_field_below_a_fifth_of_a_pixel() {
        // other(p + d(p)) = anchor(p), with d given at the anchor.
        let truth = |x: f32, y: f32| [4.0 * (x / 80.0).sin(), 3.0 * (y / 70.0).cos()];
        let other = plane(texture);
        let anchor = plane(|x, y| {
            let d = truth(x, y);
            texture(x + d[0], y + d[1])
        });
        let grid = estimate(&anchor.pyramid(32), &other.pyramid(32));
        let e = error(&grid, truth);
        assert!(e < 0.2, "{e} px");
    }

    #[test]
    fn two_layers_of_parallax_keep_their_own_motion() {
        let truth = |_: f32, y: f32| if y < 128.0 { [6.0, 0.0] } else { [-5.0, 1.0] };
        let other = plane(texture);
        let anchor = plane(|x, y| {
            let d = truth(x, y);
            texture(x + d[0], y + d[1])
        });
        let grid = estimate(&anchor.pyramid(32), &other.pyramid(32));
        let (top, bottom) = (grid.at(160.0, 60.0), grid.at(160.0, 200.0));
        assert!((top[0] - 6.0).abs() < 0.3 && (bottom[0] + 5.0).abs() < 0.3, "{top:?} {bottom:?}");
    }

    #[test]
    fn flat_pictures_are_not_displaced() {
        let flat = plane(|_, _| 0.4);
        let grid = estimate(&flat.clone().pyramid(32), &flat.pyramid(32));
        assert!(grid.nodes.iter().all(|d| d[0].hypot(d[1]) < 1e-3));
    }
}
