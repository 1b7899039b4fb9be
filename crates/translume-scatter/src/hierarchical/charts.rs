//! A surface cut into charts that lie flat: the parametrisation of the texture atlas.
//!
//! A chart is grown from a triangle over neighbours whose normals lie within [`MAX_ANGLE`] of its axis, nearest first, and is
//! projected along the axis. So a length on the surface is 1 to 1/cos 60° = 2 times its length in the atlas: the bound on stretch
//! that [Goesele 2004, §7] asks for holds by construction. Where a projection would fold over itself (a spiral), the triangles that
//! come later are put into charts of their own.

use glam::{Vec2, Vec3};
use std::cmp::Ordering;
use std::collections::{BinaryHeap, HashMap};
use translume_core::frame::Frame;
use translume_mesh::TriMesh;

/// cos 60°: normals of a chart's triangles are at most this far from its axis.
const MAX_ANGLE: f32 = 0.5;
/// Directions in which a chart is tried, over a quarter turn.
const TURNS: usize = 12;

/// Triangles and where they lie, in mm.
pub(super) struct Chart {
    pub(super) faces: Vec<u32>,
    /// Corners of each, from (0, 0) on.
    pub(super) corners: Vec<[Vec2; 3]>,
    /// Width and height.
    pub(super) extent: Vec2,
}

/// Cuts `mesh`; triangles without area are in no chart. `cell_mm` is the size of things that must not overlap.
pub(super) fn cut(mesh: &TriMesh, cell_mm: f32) -> Vec<Chart> {
    let normals: Vec<Option<Vec3>> = (0..mesh.indices.len()).map(|f| normal(mesh, f)).collect();
    let neighbours = neighbours(mesh);
    let mut free: Vec<bool> = normals.iter().map(Option::is_some).collect();
    let mut charts = Vec::new();
    for seed in 0..free.len() {
        // What is left out of a chart because of an overlap starts the next one.
        while free[seed] {
            let axis = axis(seed, &normals, &neighbours, &free);
            let order = grow(mesh, seed, axis, (&normals, &neighbours, &free));
            let chart = flatten(mesh, axis, &order, cell_mm);
            chart.faces.iter().for_each(|&f| free[f as usize] = false);
            charts.push(chart);
        }
    }
    charts
}

fn normal(mesh: &TriMesh, face: usize) -> Option<Vec3> {
    let [a, b, c] = mesh.corners(face).map(|p| p.as_dvec3());
    (b - a).cross(c - a).try_normalize().map(|n| n.as_vec3())
}

/// Triangles across the three edges of each; none across edges that are not shared by two.
fn neighbours(mesh: &TriMesh) -> Vec<[Option<u32>; 3]> {
    let mut edges: HashMap<(u32, u32), Vec<(u32, u8)>> = HashMap::with_capacity(2 * mesh.indices.len());
    for (f, t) in mesh.indices.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            edges.entry((a.min(b), a.max(b))).or_default().push((f as u32, k as u8));
        }
    }
    let mut out = vec![[None; 3]; mesh.indices.len()];
    for two in edges.values().filter(|e| e.len() == 2) {
        out[two[0].0 as usize][two[0].1 as usize] = Some(two[1].0);
        out[two[1].0 as usize][two[1].1 as usize] = Some(two[0].0);
    }
    out
}

/// The mean direction of the triangles some rings around the seed, if the seed itself lies well to it.
fn axis(seed: usize, normals: &[Option<Vec3>], neighbours: &[[Option<u32>; 3]], free: &[bool]) -> Vec3 {
    let own = normals[seed].expect("a free triangle has a normal");
    let (mut ring, mut seen) = (vec![seed as u32], vec![seed as u32]);
    let mut sum = own;
    for _ in 0..4 {
        let mut next = Vec::new();
        for other in ring.iter().flat_map(|&f| neighbours[f as usize].iter().flatten()) {
            if free[*other as usize] && !seen.contains(other) {
                seen.push(*other);
                next.push(*other);
                sum += normals[*other as usize].unwrap_or(Vec3::ZERO);
            }
        }
        ring = next;
    }
    let mean = sum.normalize_or_zero();
    if mean.dot(own) >= 0.8 { mean } else { own }
}

/// A triangle that may join, nearest to the seed first.
struct Candidate(f32, u32);

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}
impl Eq for Candidate {}
impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        other.0.total_cmp(&self.0).then(other.1.cmp(&self.1))
    }
}

/// Normals, neighbours and the triangles that are in no chart yet.
type Faces<'a> = (&'a [Option<Vec3>], &'a [[Option<u32>; 3]], &'a [bool]);

fn grow(mesh: &TriMesh, seed: usize, axis: Vec3, (normals, neighbours, free): Faces) -> Vec<u32> {
    let centre = |f: u32| mesh.corners(f as usize).iter().sum::<Vec3>() / 3.0;
    let from = centre(seed as u32);
    let mut waiting = BinaryHeap::from([Candidate(0.0, seed as u32)]);
    let mut taken = std::collections::HashSet::from([seed as u32]);
    let mut order = Vec::new();
    while let Some(Candidate(_, face)) = waiting.pop() {
        order.push(face);
        for &other in neighbours[face as usize].iter().flatten() {
            let fits = free[other as usize] && normals[other as usize].is_some_and(|n| n.dot(axis) >= MAX_ANGLE);
            if fits && taken.insert(other) {
                waiting.push(Candidate(centre(other).distance(from), other));
            }
        }
    }
    order
}

/// Projects triangles, leaving out those that would lie on earlier ones: in the middle of a cell that is taken.
fn flatten(mesh: &TriMesh, axis: Vec3, order: &[u32], cell_mm: f32) -> Chart {
    let frame = Frame::from_normal(axis);
    let flat = |f: u32| {
        mesh.corners(f as usize).map(|p| {
            let local = frame.to_local(p);
            Vec2::new(local.x, local.y)
        })
    };
    let mut taken: HashMap<(i32, i32), u32> = HashMap::new();
    let (mut faces, mut corners) = (Vec::new(), Vec::new());
    for &face in order {
        let triangle = flat(face);
        let cells: Vec<(i32, i32)> = covered(&triangle.map(|p| p / cell_mm)).map(|(x, y, _)| (x, y)).collect();
        if faces.is_empty() || cells.iter().all(|cell| !taken.contains_key(cell)) {
            taken.extend(cells.into_iter().map(|cell| (cell, face)));
            faces.push(face);
            corners.push(triangle);
        }
    }
    let (corners, extent) = turned(&corners);
    Chart { faces, corners, extent }
}

/// Turned so that the box around it is small, and moved to the origin.
fn turned(corners: &[[Vec2; 3]]) -> (Vec<[Vec2; 3]>, Vec2) {
    let by = |k: usize| Vec2::from_angle(std::f32::consts::FRAC_PI_2 * k as f32 / TURNS as f32);
    let bounds = |turn: Vec2| {
        let points = corners.iter().flatten().map(|p| turn.rotate(*p));
        points.fold((Vec2::INFINITY, Vec2::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)))
    };
    let area = |k: &usize| {
        let (lo, hi) = bounds(by(*k));
        (hi - lo).element_product()
    };
    let best = (0..TURNS).min_by(|a, b| area(a).total_cmp(&area(b))).unwrap_or(0);
    let (lo, hi) = bounds(by(best));
    (corners.iter().map(|t| t.map(|p| by(best).rotate(p) - lo)).collect(), hi - lo)
}

/// The unit cells whose centres a triangle covers, with the barycentric coordinates of its second and third corner there.
/// A centre on an edge belongs to one of the two triangles at it, whichever way these turn.
pub(super) fn covered(t: &[Vec2; 3]) -> impl Iterator<Item = (i32, i32, [f32; 2])> + use<> {
    let [a, b, c] = t.map(Vec2::as_dvec2);
    let (e1, e2) = (b - a, c - a);
    let det = e1.perp_dot(e2);
    let lo = a.min(b).min(c).floor().as_ivec2();
    let hi = a.max(b).max(c).ceil().as_ivec2();
    // An edge that is a lower or left one owns the points on it.
    let owns = |d: glam::DVec2| d.y > 0.0 || (d.y == 0.0 && d.x < 0.0);
    let (ab, bc, ca) = match det > 0.0 {
        true => (owns(e1), owns(c - b), owns(a - c)),
        false => (owns(-e1), owns(b - c), owns(c - a)),
    };
    let inside = move |w: f64, own: bool| w > 0.0 || (w == 0.0 && own);
    let cells = (lo.y..hi.y).flat_map(move |y| (lo.x..hi.x).map(move |x| (x, y)));
    cells.filter_map(move |(x, y)| {
        let p = glam::DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5) - a;
        let (u, v) = (p.perp_dot(e2) / det, e1.perp_dot(p) / det);
        let hit = det != 0.0 && inside(v, ab) && inside(1.0 - u - v, bc) && inside(u, ca);
        hit.then_some((x, y, [u as f32, v as f32]))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_centre_belongs_to_one_of_the_triangles_of_a_square() {
        // Corners and diagonals pass through centres of cells.
        for (a, b, c, d) in [
            (Vec2::new(0.5, 0.5), Vec2::new(4.5, 0.5), Vec2::new(4.5, 4.5), Vec2::new(0.5, 4.5)),
            (Vec2::new(2.5, 0.5), Vec2::new(4.5, 2.5), Vec2::new(2.5, 4.5), Vec2::new(0.5, 2.5)),
        ] {
            let mut count: HashMap<(i32, i32), u32> = HashMap::new();
            for t in [[a, b, c], [a, c, d]] {
                for (x, y, [u, v]) in covered(&t) {
                    *count.entry((x, y)).or_default() += 1;
                    let p = t[0] * (1.0 - u - v) + t[1] * u + t[2] * v;
                    assert!(p.distance(Vec2::new(x as f32 + 0.5, y as f32 + 0.5)) < 1e-5);
                }
            }
            assert!(count.values().all(|n| *n == 1), "{count:?}");
            let area = (b - a).perp_dot(d - a);
            assert!((count.len() as f32 - area).abs() <= 1.0, "{} {area}", count.len());
        }
    }
}
