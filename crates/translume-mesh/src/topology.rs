//! What kind of surface a mesh is: closed, manifold, in how many pieces, and what is wrong with it.
//!
//! Vertices at bitwise equal positions count as one here, because files split vertices at seams of texture or shading.
//! Degenerate triangles take no part in edges and pieces.

use crate::mesh::{Bounds, TriMesh};
use glam::DVec3;
use std::collections::HashMap;

/// Counts over a mesh; see the fields.
#[derive(Clone, Debug, PartialEq)]
pub struct Topology {
    /// Vertices as stored.
    pub vertices: usize,
    /// Distinct positions among them.
    pub positions: usize,
    /// Vertices no triangle uses.
    pub unused_vertices: usize,
    /// Vertices with an infinite or NaN coordinate.
    pub non_finite_vertices: usize,
    /// Triangles as stored.
    pub triangles: usize,
    /// Triangles without area: coinciding or collinear corners, or one that is not finite.
    pub degenerate_triangles: usize,
    /// Triangles beyond the first on the same three positions, in whatever order.
    pub duplicate_triangles: usize,
    /// Edges of the triangles that have area.
    pub edges: usize,
    /// Edges of one triangle.
    pub boundary_edges: usize,
    /// Edges of more than two triangles.
    pub non_manifold_edges: usize,
    /// Edges of two triangles that run through them in the same direction: one of them is turned over.
    pub flipped_edges: usize,
    /// Positions where the triangles around form more than one fan.
    pub non_manifold_vertices: usize,
    /// Pieces connected through edges.
    pub components: usize,
    /// Box of the finite vertices.
    pub bounds: Bounds,
    /// Total area.
    pub area: f64,
    /// Enclosed volume (negative when the surface is inside out), for closed surfaces of consistent winding.
    pub volume: Option<f64>,
}

impl Topology {
    /// Counts everything in time O(n log n).
    pub fn of(mesh: &TriMesh) -> Self {
        let (weld, positions) = mesh.weld();
        let triangles: Vec<[u32; 3]> = mesh.indices.iter().map(|t| t.map(|i| weld[i as usize])).collect();
        let mut used = vec![false; mesh.positions.len()];
        mesh.indices.iter().flatten().for_each(|&i| used[i as usize] = true);
        let sound: Vec<usize> = (0..triangles.len()).filter(|&f| !is_degenerate(mesh, f)).collect();
        let surface = Surface::of(&triangles, &sound);
        let whole = surface.boundary + surface.non_manifold + surface.flipped == 0 && !sound.is_empty();
        Self {
            vertices: mesh.positions.len(),
            positions,
            unused_vertices: used.iter().filter(|&&u| !u).count(),
            non_finite_vertices: mesh.positions.iter().filter(|p| p.iter().any(|x| !x.is_finite())).count(),
            triangles: triangles.len(),
            degenerate_triangles: triangles.len() - sound.len(),
            duplicate_triangles: duplicates(&triangles),
            edges: surface.edges,
            boundary_edges: surface.boundary,
            non_manifold_edges: surface.non_manifold,
            flipped_edges: surface.flipped,
            non_manifold_vertices: surface.non_manifold_vertices,
            components: surface.components,
            bounds: mesh.bounds(),
            area: mesh.area(),
            volume: whole.then(|| volume(mesh, &sound)),
        }
    }

    /// Every edge has two triangles of consistent winding.
    pub fn is_closed(&self) -> bool {
        self.volume.is_some()
    }

    /// No edge has more than two triangles, no vertex more than one fan.
    pub fn is_manifold(&self) -> bool {
        self.non_manifold_edges == 0 && self.non_manifold_vertices == 0
    }

    /// What a user should know, a line each.
    pub fn warnings(&self) -> Vec<String> {
        let counts = [
            (self.non_finite_vertices, "vertices are infinite or NaN"),
            (self.degenerate_triangles, "triangles have no area"),
            (self.duplicate_triangles, "triangles are there twice"),
            (self.unused_vertices, "vertices are not used"),
            (self.non_manifold_edges, "edges have more than two triangles"),
            (self.flipped_edges, "edges lie between triangles of opposite winding"),
        ];
        counts.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")).collect()
    }
}

impl TriMesh {
    /// For each vertex the number of its position, and how many distinct positions there are. NaNs are equal to
    /// themselves here, −0 is 0.
    pub fn weld(&self) -> (Vec<u32>, usize) {
        let mut numbers = HashMap::with_capacity(self.positions.len());
        let weld = self
            .positions
            .iter()
            .map(|p| {
                let next = numbers.len() as u32;
                *numbers.entry(p.map(|x| (x + 0.0).to_bits())).or_insert(next)
            })
            .collect();
        let count = numbers.len();
        (weld, count)
    }

    /// Positions and triangles alone: one vertex for each position (files split them at seams of texture), without vertices
    /// that no triangle uses and without triangles of fewer than three corners.
    pub fn compacted(&self) -> Self {
        let (weld, positions) = self.weld();
        let mut number = vec![u32::MAX; positions];
        let mut out = Self::default();
        for triangle in &self.indices {
            let [a, b, c] = triangle.map(|i| weld[i as usize]);
            if a == b || b == c || c == a {
                continue;
            }
            let index = triangle.map(|i| {
                let n = &mut number[weld[i as usize] as usize];
                if *n == u32::MAX {
                    *n = out.positions.len() as u32;
                    out.positions.push(self.positions[i as usize]);
                }
                *n
            });
            out.indices.push(index);
        }
        out
    }
}

fn is_degenerate(mesh: &TriMesh, face: usize) -> bool {
    let [a, b, c] = mesh.corners(face).map(|p| p.as_dvec3());
    // In double precision the cross product of float differences underflows for no float input.
    let area = (b - a).cross(c - a).length_squared();
    !(area > 0.0 && area.is_finite())
}

fn duplicates(triangles: &[[u32; 3]]) -> usize {
    let mut sorted: Vec<[u32; 3]> = triangles.to_vec();
    sorted.iter_mut().for_each(|t| t.sort_unstable());
    sorted.sort_unstable();
    sorted.windows(2).filter(|w| w[0] == w[1]).count()
}

fn volume(mesh: &TriMesh, faces: &[usize]) -> f64 {
    let origin = mesh.bounds().center().as_dvec3();
    let six: f64 = faces
        .iter()
        .map(|&f| {
            let [a, b, c]: [DVec3; 3] = mesh.corners(f).map(|p| p.as_dvec3() - origin);
            a.dot(b.cross(c))
        })
        .sum();
    six / 6.0
}

#[derive(Default)]
struct Surface {
    edges: usize,
    boundary: usize,
    non_manifold: usize,
    flipped: usize,
    non_manifold_vertices: usize,
    components: usize,
}

impl Surface {
    fn of(triangles: &[[u32; 3]], faces: &[usize]) -> Self {
        let mut half_edges = Vec::with_capacity(3 * faces.len());
        for (f, &face) in faces.iter().enumerate() {
            for k in 0..3 {
                let (a, b) = (triangles[face][k], triangles[face][(k + 1) % 3]);
                let corner = (3 * f + k) as u64;
                half_edges.push((u64::from(a.min(b)) << 32 | u64::from(a.max(b)), corner << 1 | u64::from(a < b)));
            }
        }
        half_edges.sort_unstable();
        let mut surface = Self::default();
        let mut pieces = Sets::new(faces.len());
        // Corners of the same fan: corner k of a face is at its vertex k.
        let mut fans = Sets::new(3 * faces.len());
        for edge in half_edges.chunk_by(|x, y| x.0 == y.0) {
            surface.edges += 1;
            match edge {
                [_] => surface.boundary += 1,
                [x, y] => surface.flipped += usize::from(x.1 & 1 == y.1 & 1),
                _ => surface.non_manifold += 1,
            }
            for pair in edge.windows(2) {
                let [x, y] = [pair[0].1, pair[1].1].map(|h| (h >> 1) as usize);
                pieces.join(x / 3, y / 3);
                let ends = |corner: usize| {
                    let (f, k) = (corner / 3, corner % 3);
                    let next = 3 * f + (k + 1) % 3;
                    let vertex = triangles[faces[f]][k];
                    if vertex as u64 == pair[0].0 >> 32 { [corner, next] } else { [next, corner] }
                };
                let (x, y) = (ends(x), ends(y));
                fans.join(x[0], y[0]);
                fans.join(x[1], y[1]);
            }
        }
        surface.components = pieces.count();
        surface.non_manifold_vertices = split_vertices(triangles, faces, &mut fans);
        surface
    }
}

/// Vertices whose corners fall into several fans.
fn split_vertices(triangles: &[[u32; 3]], faces: &[usize], fans: &mut Sets) -> usize {
    let roots = (0..3 * faces.len()).filter(|&corner| fans.root(corner) == corner);
    let mut roots: Vec<(u32, usize)> = roots.map(|corner| (triangles[faces[corner / 3]][corner % 3], corner)).collect();
    roots.sort_unstable();
    roots.chunk_by(|x, y| x.0 == y.0).filter(|fans| fans.len() > 1).count()
}

/// Disjoint sets with path halving.
struct Sets(Vec<usize>);

impl Sets {
    fn new(n: usize) -> Self {
        Self((0..n).collect())
    }

    fn root(&mut self, mut i: usize) -> usize {
        while self.0[i] != i {
            self.0[i] = self.0[self.0[i]];
            i = self.0[i];
        }
        i
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b)] = a.min(b);
    }

    fn count(&self) -> usize {
        self.0.iter().enumerate().filter(|(i, p)| i == *p).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron() -> TriMesh {
        TriMesh {
            positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            indices: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
            ..TriMesh::default()
        }
    }

    #[test]
    fn a_tetrahedron_is_closed() {
        let t = Topology::of(&tetrahedron());
        assert!(t.is_closed() && t.is_manifold());
        assert_eq!((t.edges, t.components, t.warnings()), (6, 1, vec![]));
        assert!((t.volume.unwrap() - 1.0 / 6.0).abs() < 1e-12);
        let mut inside_out = tetrahedron();
        inside_out.flip();
        assert!(Topology::of(&inside_out).volume.unwrap() < 0.0);
    }

    #[test]
    fn seams_do_not_open_a_mesh() {
        let whole = tetrahedron();
        let split = TriMesh {
            positions: whole.indices.iter().flatten().map(|&i| whole.positions[i as usize]).collect(),
            indices: (0..4).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect(),
            ..TriMesh::default()
        };
        let t = Topology::of(&split);
        assert!(t.is_closed());
        assert_eq!((t.vertices, t.positions), (12, 4));
    }

    #[test]
    fn two_tetrahedra_that_touch_in_a_corner() {
        let mut mesh = tetrahedron();
        let mut other = tetrahedron();
        other.transform(&glam::DAffine3::from_scale(DVec3::splat(-1.0)));
        assert!(mesh.append(&other));
        let t = Topology::of(&mesh);
        assert_eq!((t.components, t.non_manifold_vertices, t.non_manifold_edges), (2, 1, 0));
        assert!(t.is_closed() && !t.is_manifold());
    }

    #[test]
    fn faults_are_counted() {
        let mut mesh = tetrahedron();
        mesh.indices[3].swap(0, 1); // turned over
        mesh.indices.push([0, 1, 2]); // a duplicate: its three edges have three triangles
        mesh.indices.push([0, 0, 1]); // degenerate
        mesh.positions.push([f32::NAN, 0.0, 0.0]); // NaN and unused
        mesh.positions.push([2.0, 0.0, 0.0]);
        mesh.indices.push([0, 1, 5]); // collinear
        let t = Topology::of(&mesh);
        assert_eq!(
            (t.degenerate_triangles, t.duplicate_triangles, t.non_finite_vertices, t.unused_vertices),
            (2, 1, 1, 1)
        );
        assert_eq!((t.non_manifold_edges, t.flipped_edges, t.boundary_edges), (3, 2, 0));
        assert!(!t.is_closed());
    }

    #[test]
    fn an_open_square_has_a_boundary() {
        let mut mesh = tetrahedron();
        mesh.indices.truncate(2);
        let t = Topology::of(&mesh);
        assert_eq!((t.edges, t.boundary_edges, t.components), (5, 4, 1));
        assert!(t.is_manifold() && !t.is_closed());
    }
}
