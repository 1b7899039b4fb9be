//! Fall-offs for vertices that have none, from their neighbours on the mesh.
//!
//! Parameters of sums of exponentials cannot be averaged: different ones give the same curve. So the logarithms of the
//! curves are, at fixed distances, by the discrete Laplace equation with the measured vertices as its boundary, and a sum is
//! fitted to what comes out.

use super::model::Vertex;
use crate::fit::{Fitter, Params};
use rayon::prelude::*;
use translume_mesh::TriMesh;

/// Distances at which curves are compared, in mm: 0.25 · 1.2^i, up to some 20 mm.
const DISTANCES: usize = 25;
/// Most rounds over the unknown vertices, and the change of a logarithm that ends them.
const ROUNDS: usize = 2000;
const ENOUGH: f64 = 1e-4;

fn distance(i: usize) -> f64 {
    0.25 * 1.2f64.powi(i as i32)
}

/// Fills in the vertices without fall-off; pieces of the mesh without any measured vertex stay empty.
pub(super) fn interpolate(mesh: &TriMesh, params: &Params, vertices: &mut [Vertex]) {
    let links = links(mesh);
    let logs = |v: &Vertex| -> Option<Vec<f64>> {
        let curve = v.fall_off.evaluator()?;
        let values = (0..DISTANCES).map(|i| curve.value(distance(i), 0.0).max(1e-300).ln());
        Some(values.chain(v.scale.iter().map(|s| s.ln())).collect())
    };
    let mut field: Vec<Option<Vec<f64>>> = vertices.iter().map(logs).collect();
    let unknown: Vec<usize> = (0..vertices.len()).filter(|&i| field[i].is_none()).collect();
    for _ in 0..ROUNDS {
        let mut change = 0.0f64;
        let mut filled = false;
        for &i in &unknown {
            let Some(mean) = mean(&links[i], &field) else { continue };
            match &field[i] {
                Some(old) => change = old.iter().zip(&mean).fold(change, |c, (a, b)| c.max((a - b).abs())),
                None => filled = true,
            }
            field[i] = Some(mean);
        }
        if !filled && change < ENOUGH {
            break;
        }
    }
    let channels = vertices.first().map_or(0, |v| v.scale.len());
    let fitted: Vec<(usize, Vertex)> = unknown
        .par_iter()
        .filter_map(|&i| {
            let logs = field[i].as_ref()?;
            let samples: Vec<[f32; 3]> =
                (0..DISTANCES).map(|k| [distance(k) as f32, 0.0, logs[k].exp() as f32]).collect();
            let fall_off = Fitter::new(params).fit(&samples);
            let scale = logs[DISTANCES..DISTANCES + channels].iter().map(|l| l.exp()).collect();
            Some((i, Vertex { scale, fall_off, position: None }))
        })
        .collect();
    fitted.into_iter().for_each(|(i, v)| vertices[i] = v);
}

/// The mean of the neighbours that are known so far, the nearer ones counting more.
fn mean(links: &[(u32, f64)], field: &[Option<Vec<f64>>]) -> Option<Vec<f64>> {
    let known = || links.iter().filter_map(|&(j, w)| Some((field[j as usize].as_ref()?, w)));
    let total: f64 = known().map(|k| k.1).sum();
    let (first, _) = known().next()?;
    let mut sum = vec![0.0; first.len()];
    known().for_each(|(f, w)| sum.iter_mut().zip(f).for_each(|(s, x)| *s += w / total * x));
    Some(sum)
}

/// Neighbours of each vertex along edges, and the reciprocals of their lengths. Vertices at one place are neighbours, too.
fn links(mesh: &TriMesh) -> Vec<Vec<(u32, f64)>> {
    let p = |i: u32| glam::DVec3::from_array(mesh.positions[i as usize].map(f64::from));
    let mut edges: Vec<(u32, u32)> =
        mesh.indices.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]).collect();
    let (weld, _) = mesh.weld();
    let mut first = vec![u32::MAX; mesh.positions.len()];
    for (i, &number) in weld.iter().enumerate() {
        match first[number as usize] {
            u32::MAX => first[number as usize] = i as u32,
            twin => edges.push((twin, i as u32)),
        }
    }
    let mut links = vec![Vec::new(); mesh.positions.len()];
    let mean = edges.iter().map(|&(a, b)| (p(a) - p(b)).length()).sum::<f64>() / edges.len().max(1) as f64;
    for (a, b) in edges {
        // Twins and slivers count a lot, but not without limit, or the rounds would not end.
        let weight = 1.0 / (p(a) - p(b)).length().max(0.1 * mean).max(1e-30);
        links[a as usize].push((b, weight));
        links[b as usize].push((a, weight));
    }
    links.iter_mut().for_each(|l: &mut Vec<(u32, f64)>| {
        l.sort_by_key(|e| e.0);
        l.dedup_by_key(|e| e.0);
    });
    links
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
