//! Fall-offs for vertices that have none, from their neighbours on the mesh.
//!
//! Parameters of sums of exponentials cannot be averaged: different ones give the same curve. So the logarithms of the
//! curves are, at fixed distances, by the discrete Laplace equation with the measured vertices as its boundary, and a sum is
//! fitted to what comes out.

use super::model::Vertex;
use crate::fit::{Fitter, Params};
use crate::laplace::{Graph, Known};
use rayon::prelude::*;
use translume_mesh::TriMesh;

/// Distances at which curves are compared, in mm: 0.25 · 1.2^i, up to some 20 mm.
const DISTANCES: usize = 25;
/// Most rounds over the unknown vertices.
const ROUNDS: usize = 2000;

fn distance(i: usize) -> f64 {
    0.25 * 1.2f64.powi(i as i32)
}

/// Fills in the vertices without fall-off; pieces of the mesh without any measured vertex stay empty.
pub(super) fn interpolate(mesh: &TriMesh, params: &Params, vertices: &mut [Vertex]) {
    let logs = |v: &Vertex| -> Option<Vec<f32>> {
        let curve = v.fall_off.evaluator()?;
        let values = (0..DISTANCES).map(|i| curve.value(distance(i), 0.0).max(1e-300).ln());
        Some(values.chain(v.scale.iter().map(|s| s.ln())).map(|v| v as f32).collect())
    };
    let known: Vec<Option<Vec<f32>>> = vertices.iter().map(logs).collect();
    let unknown: Vec<usize> = (0..vertices.len()).filter(|&i| known[i].is_none()).collect();
    if unknown.is_empty() {
        return;
    }
    let graph = Graph::of_welded_mesh(mesh);
    let count = known.iter().flatten().next().map_or(0, Vec::len);
    // Three values at a time.
    let filled: Vec<Vec<[f32; 3]>> = (0..count)
        .step_by(3)
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|first| {
            let value = |v: &[f32], c: usize| v.get(first + c).copied().unwrap_or(0.0);
            let known: Vec<Known> = known
                .iter()
                .map(|v| v.as_ref().map_or([0.0; 4], |v| [value(v, 0), value(v, 1), value(v, 2), f32::INFINITY]))
                .collect();
            graph.fill(&known, [f32::NAN; 3], ROUNDS)
        })
        .collect();
    let field = |i: usize| -> Option<Vec<f64>> {
        let values = filled.iter().flat_map(|v| v[i]).take(count).map(f64::from);
        let values: Vec<f64> = values.collect();
        (!values.is_empty() && values.iter().all(|v| v.is_finite())).then_some(values)
    };
    let channels = vertices.first().map_or(0, |v| v.scale.len());
    let fitted: Vec<(usize, Vertex)> = unknown
        .par_iter()
        .filter_map(|&i| {
            let logs = field(i)?;
            let samples: Vec<[f32; 3]> =
                (0..DISTANCES).map(|k| [distance(k) as f32, 0.0, logs[k].exp() as f32]).collect();
            let fall_off = Fitter::new(params).fit(&samples);
            let scale = logs[DISTANCES..DISTANCES + channels].iter().map(|l| l.exp()).collect();
            Some((i, Vertex { scale, fall_off, position: None }))
        })
        .collect();
    fitted.into_iter().for_each(|(i, v)| vertices[i] = v);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::curve::{Curve, Exponentials};
    use crate::fit::{PointFit, Segment};

    fn vertex(c: f64, d: f64) -> Vertex {
        let curve = Curve::Exponential(Exponentials { c: vec![c], d: vec![d] });
        let segments = vec![Segment { curve, samples: 50.0, borrowed: false }];
        let fall_off = PointFit { samples: 50, rms: Some(0.1), segments, ..PointFit::default() };
        Vertex { scale: vec![1.0, c], fall_off, position: Some(0) }
    }

    #[test]
    fn a_vertex_between_two_has_the_mean_of_their_logarithms() {
        // A strip: known, unknown, known at equal distances, twice over; and a piece that no light reached.
        let mut positions: Vec<[f32; 3]> =
            (0..6).map(|i| [(i % 3) as f32, if i < 3 { 0.0 } else { 1e-3 }, 0.0]).collect();
        positions.extend([[9.0, 0.0, 0.0], [9.0, 1.0, 0.0], [9.0, 0.0, 1.0]]);
        let indices = vec![[0, 1, 3], [1, 4, 3], [1, 2, 4], [2, 5, 4], [6, 7, 8]];
        let mesh = TriMesh { positions, indices, ..TriMesh::default() };
        let empty = Vertex { scale: vec![1.0; 2], fall_off: PointFit::default(), position: None };
        let (a, b) = (vertex(1.0, -1.0), vertex(4.0, -2.0));
        let mut all = vec![a.clone(), empty.clone(), b.clone(), a, empty.clone(), b];
        all.extend(vec![empty; 3]);
        interpolate(&mesh, &Params::default(), &mut all);
        // The diagonals make each of the two a little more like one side; together they are in the middle.
        let middle = |value: &dyn Fn(&Vertex) -> f64| (value(&all[1]) * value(&all[4])).sqrt();
        for r in [0.3f64, 1.0, 3.0] {
            let expected = 2.0 * (-1.5 * r).exp();
            let found = middle(&|v| v.value(r, 0).unwrap());
            assert!((found / expected - 1.0).abs() < 0.01, "{r}: {found} {expected}");
        }
        assert!((middle(&|v| v.scale[1]) - 2.0).abs() < 0.01 && !all[1].measured() && !all[4].measured());
        assert!(all[6..].iter().all(|v| v.value(1.0, 0).is_none()));
    }
}
