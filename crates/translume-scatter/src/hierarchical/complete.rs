//! Completion of the throughput matrix [Goesele 2004, §6.2].
//!
//! 1. Missing entries of the columns of lit vertices, by Laplace's equation on the mesh with the measurements as boundary.
//! 2. The columns of vertices that were never lit: far from the diagonal from their neighbours' columns, which by symmetry is the same
//!    equation along a row; on the diagonal from the neighbours' diagonals; on the one-ring half of each.
//!
//! Both on ln Y and u′v′, as deviations from their mean by distance ([`super::trend`]). What two columns say about a pair is averaged, so the
//! matrix stays symmetric.

use super::colour::{Colours, Feature};
use super::pairs::{Measured, Throughput, pair};
use super::trend::Trend;
use crate::laplace::{Graph, Known};
use glam::Vec3;
use half::f16;
use rayon::prelude::*;
use translume_mesh::TriMesh;

/// How to solve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Solver {
    /// Deviations from the mean fall-off, first guess from groups, overrelaxation.
    Multilevel {
        /// Most rounds of a column.
        rounds: usize,
    },
    /// The paper's iteration on ln Y, u′, v′ themselves, to compare with.
    Plain {
        /// Rounds of a column.
        rounds: usize,
    },
}

impl Default for Solver {
    fn default() -> Self {
        Self::Multilevel { rounds: 40 }
    }
}

/// What was completed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Completion {
    /// Vertices that no beam hit.
    pub never_lit: usize,
    /// Vertices of which nothing was measured, neither as lit nor as seen.
    pub never_seen: usize,
    /// Share of the pairs that was measured.
    pub measured: f64,
}

/// Weight of a measurement that is half sure.
const HALF_SURE: f32 = 0.1;
/// Columns solved in parallel before they are written down.
const BATCH: usize = 128;
/// A vertex is lit from this sum of weights on.
const LIT: f32 = 0.05;

/// Fills F. `None` if nothing was measured at all.
pub fn complete(
    mesh: &TriMesh,
    measured: Measured,
    solver: Solver,
    progress: impl Fn() + Sync,
) -> Option<(Throughput, Completion)> {
    let n = measured.vertices;
    let lit: Vec<bool> = measured.lit.iter().map(|w| *w >= LIT).collect();
    let features = into_features(measured);
    let known = features.iter().filter(|f| f[3] > 0.0).count();
    let task = Task::new(mesh, solver, features)?;
    let mut out = Throughput {
        vertices: n,
        ln: vec![[f16::ZERO; 3]; task.features.len()],
        confidence: vec![0; task.features.len()],
    };
    let columns = |of: bool| (0..n).filter(|&k| lit[k] == of).collect::<Vec<_>>();
    for batch in columns(true).chunks(BATCH) {
        let solved: Vec<_> = batch
            .par_iter()
            .map(|&k| {
                progress();
                task.lit(k)
            })
            .collect();
        batch.iter().zip(solved).for_each(|(&k, column)| note(&mut out, k, &column, |_| true));
    }
    let rings = task.rings(&out, &lit);
    for batch in columns(false).chunks(BATCH) {
        let solved: Vec<_> = batch
            .par_iter()
            .map(|&c| {
                progress();
                task.unlit(c, &out, &lit, &rings)
            })
            .collect();
        batch.iter().zip(solved).for_each(|(&c, column)| note(&mut out, c, &column, |r| !lit[r]));
    }
    let never_seen = (0..n).filter(|&a| (0..n).all(|b| task.features[pair(a, b)][3] <= 0.0)).count();
    let never_lit = lit.iter().filter(|l| !**l).count();
    let completion = Completion { never_lit, never_seen, measured: known as f64 / task.features.len() as f64 };
    task.finish(&mut out);
    Some((out, completion))
}

/// Sums to means as features; the weight stays.
fn into_features(measured: Measured) -> Vec<[f32; 4]> {
    let colours = Colours::new();
    let mut sums = measured.sums;
    sums.par_iter_mut().for_each(|s| {
        let mean = [0, 1, 2].map(|c| s[c] / s[3]);
        *s = match colours.feature(mean).filter(|_| s[3] > 0.0) {
            Some([y, u, v]) => [y, u, v, s[3]],
            None => [0.0; 4],
        };
    });
    sums
}

/// Writes a column; the second word about a pair is averaged with the first. Until the end, `confidence` counts these words.
fn note(out: &mut Throughput, column: usize, values: &[Feature], wanted: impl Fn(usize) -> bool) {
    for (row, value) in values.iter().enumerate().filter(|(row, _)| wanted(*row)) {
        let i = pair(row, column);
        let word = f32::from(out.confidence[i]);
        for (stored, new) in out.ln[i].iter_mut().zip(value) {
            // [Goesele 2004, §6.2 symmetry]
            *stored = f16::from_f32((word * stored.to_f32() + new) / (word + 1.0));
        }
        out.confidence[i] += 1;
    }
}

struct Task<'a> {
    mesh: &'a TriMesh,
    graph: Graph,
    trend: Trend,
    solver: Solver,
    /// ln Y, u′, v′ and weight of each pair; weight 0: not measured.
    features: Vec<[f32; 4]>,
}

/// Deviations on the diagonal and, in the mean, on the one-ring of every vertex.
struct Rings {
    diagonal: Vec<Feature>,
    ring: Vec<Feature>,
}

impl<'a> Task<'a> {
    fn new(mesh: &'a TriMesh, solver: Solver, features: Vec<[f32; 4]>) -> Option<Self> {
        let n = mesh.positions.len();
        let most = mesh.bounds().extent().length();
        // Some millions of pairs tell the trend.
        let step = (features.len() / 3_000_000).max(1);
        let at = |i: usize| Vec3::from(mesh.positions[i]);
        let all = (0..n).flat_map(|a| (0..=a).map(move |b| (a, b))).step_by(step);
        let samples = all.filter_map(|(a, b)| {
            let [y, u, v, w] = features[pair(a, b)];
            (w > 0.0).then(|| (at(a).distance(at(b)), [y, u, v], 1.0))
        });
        let fitted = Trend::new(most, samples)?;
        let trend = if matches!(solver, Solver::Plain { .. }) { Trend::none() } else { fitted };
        Some(Self { graph: Graph::of_mesh(mesh), mesh, trend, solver, features })
    }

    fn trend(&self, a: usize, b: usize) -> Feature {
        self.trend.at(Vec3::from(self.mesh.positions[a]).distance(Vec3::from(self.mesh.positions[b])))
    }

    fn solve(&self, column: usize, known: &[Known]) -> Vec<Feature> {
        let mean = {
            let (mut sum, mut count) = ([0.0; 3], 0.0);
            for k in known.iter().filter(|k| k[3] > 0.0) {
                (0..3).for_each(|c| sum[c] += k[c]);
                count += 1.0;
            }
            sum.map(|s| if count > 0.0 { s / count } else { 0.0 })
        };
        let mut field = match self.solver {
            // Pieces of the mesh without any value are on the mean fall-off.
            Solver::Multilevel { rounds } => self.graph.fill(known, [0.0; 3], rounds),
            Solver::Plain { rounds } => self.graph.plain(known, mean, rounds),
        };
        for (row, f) in field.iter_mut().enumerate() {
            let t = self.trend(row, column);
            (0..3).for_each(|c| f[c] += t[c]);
        }
        field
    }

    /// [Goesele 2004, §6.2 column]
    fn lit(&self, column: usize) -> Vec<Feature> {
        let known = |row: usize| {
            let [y, u, v, w] = self.features[pair(row, column)];
            match w > 0.0 {
                true => {
                    let t = self.trend(row, column);
                    // c = w/(w + ½-sure); c/(1 − c) = w/½-sure.
                    [y - t[0], u - t[1], v - t[2], w / HALF_SURE]
                }
                false => [0.0; 4],
            }
        };
        let known: Vec<Known> = (0..self.graph.len()).map(known).collect();
        self.solve(column, &known)
    }

    /// Deviation of what is written down so far.
    fn deviation(&self, out: &Throughput, a: usize, b: usize) -> Feature {
        let (f, t) = (out.ln[pair(a, b)].map(f16::to_f32), self.trend(a, b));
        [0, 1, 2].map(|c| f[c] - t[c])
    }

    /// [Goesele 2004, §6.2 diagonal]
    fn rings(&self, out: &Throughput, lit: &[bool]) -> Rings {
        let fixed = |f: Feature| [f[0], f[1], f[2], f32::INFINITY];
        let solve = |at: &dyn Fn(usize) -> Known| {
            let known: Vec<Known> = (0..lit.len()).map(|v| if lit[v] { at(v) } else { [0.0; 4] }).collect();
            self.graph.fill(&known, [0.0; 3], 400)
        };
        let ring = |v: usize| {
            let mut sum = [0.0; 3];
            for &(n, w) in self.graph.neighbours(v) {
                let d = self.deviation(out, v, n as usize);
                (0..3).for_each(|c| sum[c] += w * d[c]);
            }
            fixed(sum)
        };
        Rings { diagonal: solve(&|v| fixed(self.deviation(out, v, v))), ring: solve(&ring) }
    }

    /// The column of a vertex that was never lit: rows of lit vertices are known by symmetry.
    /// [Goesele 2004, §6.2 far]
    fn unlit(&self, column: usize, out: &Throughput, lit: &[bool], rings: &Rings) -> Vec<Feature> {
        let known = |row: usize| match lit[row] {
            true => {
                let [y, u, v] = self.deviation(out, row, column);
                [y, u, v, f32::INFINITY]
            }
            false => [0.0; 4],
        };
        let known: Vec<Known> = (0..self.graph.len()).map(known).collect();
        let mut field = self.solve(column, &known);
        let add = |t: Feature, d: Feature| [0, 1, 2].map(|c| t[c] + d[c]);
        field[column] = add(self.trend(column, column), rings.diagonal[column]);
        for &(n, _) in self.graph.neighbours(column) {
            let n = n as usize;
            if !lit[n] {
                let near = add(self.trend(n, column), rings.ring[column]);
                (0..3).for_each(|c| field[n][c] = 0.5 * (field[n][c] + near[c]));
            }
        }
        field
    }

    /// From features to logarithms of red, green and blue, with the confidences of the measurements.
    fn finish(&self, out: &mut Throughput) {
        let colours = Colours::new();
        let all = out.ln.par_iter_mut().zip(&mut out.confidence).zip(&self.features);
        all.for_each(|((ln, confidence), f)| {
            *ln = colours.rgb(ln.map(f16::to_f32)).map(super::pairs::to_log);
            *confidence = (255.0 * f[3] / (f[3] + HALF_SURE)) as u8;
        });
    }
}
