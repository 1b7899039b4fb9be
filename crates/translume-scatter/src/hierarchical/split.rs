//! The split of R_d between F and K [Goesele 2004, §3.1]: within the 7 × 7 texels of a kernel K is what was measured less T times what F
//! gives there, so local and global light together are what was measured.
//!
//! Linear interpolation of a matrix with a steep diagonal spreads its peak over the one-ring, also where no kernel reaches to take
//! it away. So entries of F nearer than a kernel reaches are lowered to the level at its reach: F keeps what is smooth, K has the peak.

use super::atlas::{Atlas, NONE};
use super::kernel::{CELLS, Candidate, KNOTS, RECORD, cells, ln_fall_off};
use super::pairs::{Throughput, pair};
use crate::laplace::{Graph, Known};
use glam::Vec3;
use half::f16;
use rayon::prelude::*;
use translume_mesh::TriMesh;

/// Reach of a kernel in texels, rounded up.
const REACH: f32 = 4.0;

/// Distance in mm within which K has the peak of R_d.
pub(super) fn reach_mm(atlas: &Atlas) -> f32 {
    REACH * atlas.texel_mm
}

/// Lowers the entries of F within the kernels' reach to the mean of those just beyond.
pub(super) fn flatten(f: &mut Throughput, mesh: &TriMesh, atlas: &Atlas) {
    let n = f.vertices;
    let at: Vec<Vec3> = mesh.positions.iter().map(|&p| p.into()).collect();
    let reach = reach_mm(atlas);
    let level = |k: usize| -> Option<[f32; 3]> {
        let (mut sum, mut count) = ([0.0; 3], 0.0);
        let mut nearest: Option<(f32, usize)> = None;
        for r in 0..n {
            let d = at[r].distance(at[k]);
            if d >= reach && d < 2.0 * reach {
                (0..3).for_each(|c| sum[c] += f.ln[pair(r, k)][c].to_f32());
                count += 1.0;
            }
            if d >= reach && nearest.is_none_or(|b| d < b.0) {
                nearest = Some((d, r));
            }
        }
        match count > 0.0 {
            true => Some(sum.map(|s| s / count)),
            false => nearest.map(|(_, r)| f.ln[pair(r, k)].map(f16::to_f32)),
        }
    };
    let levels: Vec<Option<[f32; 3]>> = (0..n).into_par_iter().map(level).collect();
    for a in 0..n {
        for b in 0..=a {
            let (true, Some(la), Some(lb)) = (at[a].distance(at[b]) < reach, levels[a], levels[b]) else { continue };
            let ln = &mut f.ln[pair(a, b)];
            (0..3).for_each(|c| ln[c] = f16::from_f32(ln[c].to_f32().min(0.5 * (la[c] + lb[c]))));
        }
    }
}

/// The kernels of all texels before the split.
pub(super) struct Records {
    /// [`RECORD`] values for each texel, three by three as they were filled.
    triples: Vec<Vec<[f32; 3]>>,
    /// 0 where it comes from the neighbours.
    pub(super) confidence: Vec<u8>,
    /// Added to the logarithm of the fall-offs at the knots.
    radial: [[f32; KNOTS.len()]; 3],
    /// Added to the logarithm of all of a texel.
    gains: Vec<[f32; 3]>,
}

impl Records {
    /// Fills texels without kernel from their neighbours on the surface, fall-off and detail together [Goesele 2004, §7.2]. `None` if there is no
    /// kernel at all. `strength` is that of a kernel against its neighbours': single spots are noisy.
    pub(super) fn fill(atlas: &Atlas, kernels: &[Option<Candidate>], strength: f32) -> Option<Self> {
        let measured: Vec<&Candidate> = kernels.iter().flatten().collect();
        if measured.is_empty() {
            return None;
        }
        let graph = texel_graph(atlas);
        let triple = |t: usize| {
            let of = |c: &Candidate| [c.record[3 * t], c.record[3 * t + 1], c.record[3 * t + 2]];
            let sum = measured.iter().fold([0.0f64; 3], |s, c| {
                let v = of(c);
                [0, 1, 2].map(|i| s[i] + f64::from(v[i]))
            });
            let mean = sum.map(|s| (s / measured.len() as f64) as f32);
            let known = |c: &Option<Candidate>| {
                c.as_ref().map_or([0.0; 4], |c| {
                    let [a, b, d] = of(c);
                    [a, b, d, strength * c.confidence]
                })
            };
            let known: Vec<Known> = kernels.iter().map(known).collect();
            graph.fill(&known, mean, 40)
        };
        let confidence = kernels.iter().map(|k| k.as_ref().map_or(0, |k| (255.0 * k.confidence) as u8)).collect();
        let triples = (0..RECORD / 3).into_par_iter().map(triple).collect();
        Some(Self { triples, confidence, radial: [[0.0; KNOTS.len()]; 3], gains: vec![[0.0; 3]; atlas.texels.len()] })
    }

    fn value(&self, texel: usize, i: usize) -> f32 {
        self.triples[i / 3][texel][i % 3]
    }

    /// R_d from a texel to a cell of its kernel at distance `d` in texels.
    pub(super) fn measured(&self, texel: usize, cell: usize, d: f32, channel: usize) -> f32 {
        let knots: [f32; KNOTS.len()] =
            std::array::from_fn(|k| self.value(texel, channel * KNOTS.len() + k) + self.radial[channel][k]);
        let detail = self.value(texel, 3 * KNOTS.len() + channel * CELLS + cell);
        (ln_fall_off(&knots, d) - detail + self.gains[texel][channel]).exp() // K = m/C [Goesele 2004, §7.1]
    }

    /// Multiplies the fall-offs at the knots by the first over the second of two sums.
    pub(super) fn bend(&mut self, sums: &[[[f64; 2]; KNOTS.len()]; 3]) {
        for (ln, sums) in self.radial.iter_mut().flatten().zip(sums.iter().flatten()) {
            if sums.iter().all(|s| *s > 0.0) {
                *ln += (sums[0] / sums[1]).clamp(0.2, 5.0).ln() as f32;
            }
        }
    }

    /// Adds to the logarithms of all of each texel.
    pub(super) fn amplify(&mut self, ln: &[[f32; 3]]) {
        self.gains.iter_mut().zip(ln).for_each(|(g, l)| (0..3).for_each(|c| g[c] += l[c]));
    }
}

/// Texels and their four neighbours, over borders.
pub(super) fn texel_graph(atlas: &Atlas) -> Graph {
    let edges = (0..atlas.texels.len()).flat_map(|t| {
        let next = move |(dx, dy)| atlas.neighbour(t, dx, dy).map(|n| (t.min(n) as u32, t.max(n) as u32));
        [(1, 0), (0, 1), (-1, 0), (0, -1)].into_iter().filter_map(next)
    });
    let mut edges: Vec<(u32, u32)> = edges.filter(|e| e.0 != e.1).collect();
    edges.sort_unstable();
    edges.dedup();
    Graph::new(atlas.texels.len(), edges.into_iter().map(|(a, b)| (a, b, 1.0)))
}

/// Whether texels that are (dx, dy) apart in the atlas and `d` texels in space are neighbours on the surface.
pub(super) fn near_enough(dx: i32, dy: i32, d: f32) -> bool {
    d <= 2.2 * ((dx * dx + dy * dy) as f32).sqrt() + 2.5
}

/// K of all texels, [`CELLS`] each: what `measured` says (texel, other texel, cell, distance in texels, channel) less what F and T give.
///
/// Kernels are measured from the lit texel outwards and are used as filters around the texel that is seen; R_d is the same by
/// reciprocity, and T is that of the texel that is seen.
pub(super) fn kernels(
    mesh: &TriMesh,
    atlas: &Atlas,
    f: &Throughput,
    detail: &[[f32; 3]],
    measured: impl Fn(usize, usize, usize, f32, usize) -> f32 + Sync,
) -> Vec<[f16; 3]> {
    let measured = &measured;
    let place = |t: usize| {
        let texel = &atlas.texels[t];
        let [u, v] = texel.uv;
        (mesh.indices[texel.face as usize], [1.0 - u - v, u, v])
    };
    let place = &place;
    let one = |t: usize| {
        cells().enumerate().map(move |(cell, (dx, dy))| {
            let n = atlas.neighbour(t, dx, dy).map_or(NONE as usize, |n| n);
            if n == NONE as usize {
                return [f16::ZERO; 3];
            }
            let d = atlas.texels[n].at.distance(atlas.texels[t].at) / atlas.texel_mm;
            if !near_enough(dx, dy, d) {
                return [f16::ZERO; 3];
            }
            let global = f.between(place(t), place(n));
            // R_d = F + K, F with its T [Goesele 2004, §3.1].
            std::array::from_fn(|c| f16::from_f32(measured(t, n, cell, d, c) - detail[t][c] * global[c]))
        })
    };
    (0..atlas.texels.len()).into_par_iter().flat_map_iter(one).collect()
}

impl Records {
    /// K of all texels.
    pub(super) fn split(&self, mesh: &TriMesh, atlas: &Atlas, f: &Throughput, detail: &[[f32; 3]]) -> Vec<[f16; 3]> {
        kernels(mesh, atlas, f, detail, |t, _, cell, d, c| self.measured(t, cell, d, c))
    }
}
