//! The texture atlas: charts packed into a square of texels, and what each texel is on the surface.
//!
//! A texel whose centre lies in a chart is a place of the surface with an area; the texels around the charts, as far as a local
//! kernel reaches, are borders and link to the nearest texel of the chart that goes on there [Goesele 2004, §7.2]. So a kernel
//! of 7 × 7 texels finds its true neighbours everywhere.

use super::charts::{Chart, covered, cut};
use super::grid::PointGrid;
use glam::{Vec2, Vec3};
use translume_mesh::TriMesh;

/// Texels that a kernel reaches from its centre.
pub const RADIUS: i32 = 3;
/// Width of borders: a kernel and one texel for interpolation.
const BORDER: i32 = RADIUS + 1;
/// No texel.
pub(crate) const NONE: u32 = u32::MAX;

/// What to make.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AtlasParams {
    /// Most texels along a side.
    pub side: usize,
    /// Wanted texels along a mean edge of the mesh: kernels should reach as far as the neighbouring vertices, where linear
    /// interpolation takes over.
    pub per_edge: f64,
}

impl Default for AtlasParams {
    fn default() -> Self {
        Self { side: 512, per_edge: 3.5 }
    }
}

/// A place of the surface with an area.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Texel {
    /// Column and row in the atlas.
    pub xy: [u16; 2],
    /// The triangle at its centre.
    pub face: u32,
    /// Barycentric coordinates of the second and third corner.
    pub uv: [f32; 2],
    /// Its centre in mm.
    pub at: Vec3,
    /// Unit normal of the triangle.
    pub normal: Vec3,
    /// Its area on the surface in mm².
    pub area: f32,
}

/// An atlas of a mesh.
#[derive(Clone, Debug)]
pub struct Atlas {
    /// Texels along a side.
    pub side: usize,
    /// Edge of a texel in mm, where a chart faces its axis; up to twice that elsewhere.
    pub texel_mm: f32,
    /// Corners of each triangle in texels; NaN for triangles without area.
    pub corners: Vec<[[f32; 2]; 3]>,
    /// The texels of the surface.
    pub texels: Vec<Texel>,
    /// For each place of the atlas the texel there, for borders the one it links to, or `u32::MAX`.
    grid: Vec<u32>,
}

impl Atlas {
    /// Cuts, packs and links `mesh`; `None` if no triangle has an area or the charts do not fit into `side` at any scale.
    pub fn new(mesh: &TriMesh, params: &AtlasParams) -> Option<Self> {
        let edge = mean_edge(mesh)?;
        let mut texel_mm = (edge / params.per_edge) as f32;
        let charts = cut(mesh, texel_mm);
        // Each try makes texels a little larger.
        for _ in 0..400 {
            if let Some((side, places)) = pack(&charts, texel_mm, params.side) {
                return Some(Self::from_corners(mesh, side, texel_mm, corners(mesh, &charts, &places, texel_mm)));
            }
            texel_mm *= 1.015;
        }
        None
    }

    /// From the corners of the triangles in the atlas.
    pub fn from_corners(mesh: &TriMesh, side: usize, texel_mm: f32, corners: Vec<[[f32; 2]; 3]>) -> Self {
        let mut atlas = Self { side, texel_mm, corners, texels: Vec::new(), grid: vec![NONE; side * side] };
        for (face, corners) in atlas.corners.iter().enumerate() {
            let flat = corners.map(Vec2::from);
            let [a, b, c] = mesh.corners(face);
            let cross = (b - a).cross(c - a);
            let flat_area = (flat[1] - flat[0]).perp_dot(flat[2] - flat[0]).abs();
            for (x, y, uv) in covered(&flat).filter(|_| flat_area > 0.0 && cross != Vec3::ZERO) {
                let inside = (0..side as i32).contains(&x) && (0..side as i32).contains(&y);
                let slot = y as usize * side + x as usize;
                if inside && atlas.grid[slot] == NONE {
                    atlas.grid[slot] = atlas.texels.len() as u32;
                    let at = a + uv[0] * (b - a) + uv[1] * (c - a);
                    let area = cross.length() / flat_area;
                    let xy = [x as u16, y as u16];
                    atlas.texels.push(Texel { xy, face: face as u32, uv, at, normal: cross.normalize(), area });
                }
            }
        }
        atlas.share_area(mesh);
        atlas.link(mesh);
        atlas
    }

    /// Makes the areas sum up to the mesh's: triangles between the centres of texels have none of their own.
    fn share_area(&mut self, mesh: &TriMesh) {
        let sum: f64 = self.texels.iter().map(|t| f64::from(t.area)).sum();
        let factor = (mesh.area() / sum.max(1e-30)) as f32;
        self.texels.iter_mut().for_each(|t| t.area *= factor);
    }

    /// Gives the borders of the charts their links, ring after ring outwards.
    fn link(&mut self, mesh: &TriMesh) {
        let Some(places) = PointGrid::new(self.texels.iter().map(|t| t.at), 2.0 * self.texel_mm) else { return };
        let side = self.side as i32;
        // The texel of the own chart that a border was reached from.
        let mut ring: Vec<(u32, u32)> = self.texels.iter().enumerate().map(|(i, t)| (self.slot(t), i as u32)).collect();
        let mut reached: Vec<bool> = self.grid.iter().map(|&g| g != NONE).collect();
        for _ in 0..BORDER {
            let mut next = Vec::new();
            for &(slot, own) in &ring {
                let (x, y) = (slot as i32 % side, slot as i32 / side);
                for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)] {
                    let (x, y) = (x + dx, y + dy);
                    if !(0..side).contains(&x) || !(0..side).contains(&y) || reached[(y * side + x) as usize] {
                        continue;
                    }
                    reached[(y * side + x) as usize] = true;
                    next.push(((y * side + x) as u32, own));
                }
            }
            for &(slot, own) in &next {
                let at = self.beyond(mesh, own as usize, slot);
                let facing = |i: u32| self.texels[i as usize].normal.dot(self.texels[own as usize].normal) > -0.5;
                let near = places.nearest(at, 8.0 * self.texel_mm, |i| self.texels[i as usize].at, facing);
                self.grid[slot as usize] = near.unwrap_or(own);
            }
            ring = next;
        }
    }

    fn slot(&self, t: &Texel) -> u32 {
        u32::from(t.xy[1]) * self.side as u32 + u32::from(t.xy[0])
    }

    /// Where a place of the atlas would be if the plane of a texel's triangle went on.
    fn beyond(&self, mesh: &TriMesh, texel: usize, slot: u32) -> Vec3 {
        let face = self.texels[texel].face as usize;
        let [a, b, c] = mesh.corners(face);
        let [u, v] = barycentric(&self.corners[face].map(Vec2::from), self.centre(slot));
        a + u * (b - a) + v * (c - a)
    }

    fn centre(&self, slot: u32) -> Vec2 {
        let (x, y) = (slot % self.side as u32, slot / self.side as u32);
        Vec2::new(x as f32 + 0.5, y as f32 + 0.5)
    }

    /// The texel at an offset from another one, over borders.
    #[inline]
    pub fn neighbour(&self, texel: usize, dx: i32, dy: i32) -> Option<usize> {
        let [x, y] = self.texels[texel].xy.map(i32::from);
        self.at(x + dx, y + dy)
    }

    /// The texel at or behind a place of the atlas.
    #[inline]
    fn at(&self, x: i32, y: i32) -> Option<usize> {
        let side = self.side as i32;
        let inside = (0..side).contains(&x) && (0..side).contains(&y);
        inside.then(|| self.grid[(y * side + x) as usize]).filter(|&t| t != NONE).map(|t| t as usize)
    }

    /// The texel that a place of the surface lies in.
    pub(super) fn texel(&self, face: u32, uv: [f32; 2]) -> Option<usize> {
        let p = self.flat(face, uv);
        self.at(p.x.floor() as i32, p.y.floor() as i32)
    }

    /// The texel at a place of the atlas, if a chart covers it there.
    #[inline]
    pub(super) fn own(&self, x: i32, y: i32) -> Option<usize> {
        self.at(x, y).filter(|&t| self.texels[t].xy.map(i32::from) == [x, y])
    }

    /// Where a place of the surface lies in the atlas, in texels.
    pub fn flat(&self, face: u32, uv: [f32; 2]) -> Vec2 {
        let [a, b, c] = self.corners[face as usize].map(Vec2::from);
        a + uv[0] * (b - a) + uv[1] * (c - a)
    }

    /// The texels between whose centres a place of the surface lies, with weights that sum to 1; none for triangles without area.
    pub fn between(&self, face: u32, uv: [f32; 2]) -> [(u32, f32); 4] {
        let p = self.flat(face, uv) - 0.5;
        let (x, y) = (p.x.floor() as i32, p.y.floor() as i32);
        let (fx, fy) = (p.x - p.x.floor(), p.y - p.y.floor());
        let corners =
            [(0, 0, (1.0 - fx) * (1.0 - fy)), (1, 0, fx * (1.0 - fy)), (0, 1, (1.0 - fx) * fy), (1, 1, fx * fy)];
        let mut out = corners.map(|(dx, dy, w)| self.at(x + dx, y + dy).map_or((0, 0.0), |t| (t as u32, w)));
        let sum: f32 = out.iter().map(|o| o.1).sum();
        out.iter_mut().for_each(|o| o.1 = if sum > 1e-6 { o.1 / sum } else { 0.0 });
        out
    }
}

/// Mean length of the edges of the triangles.
pub(super) fn mean_edge(mesh: &TriMesh) -> Option<f64> {
    let lengths = (0..mesh.indices.len()).flat_map(|f| {
        let [a, b, c] = mesh.corners(f);
        [a.distance(b), b.distance(c), c.distance(a)].map(f64::from)
    });
    let (sum, n) = lengths.filter(|l| *l > 0.0 && l.is_finite()).fold((0.0, 0.0), |(s, n), l| (s + l, n + 1.0));
    (n > 0.0).then(|| sum / n)
}

fn barycentric(t: &[Vec2; 3], p: Vec2) -> [f32; 2] {
    let (e1, e2, d) = (t[1] - t[0], t[2] - t[0], p - t[0]);
    let det = e1.perp_dot(e2);
    [d.perp_dot(e2) / det, e1.perp_dot(d) / det]
}

/// Corners of the triangles from where the charts lie.
fn corners(mesh: &TriMesh, charts: &[Chart], places: &[(i32, i32)], texel_mm: f32) -> Vec<[[f32; 2]; 3]> {
    let mut out = vec![[[f32::NAN; 2]; 3]; mesh.indices.len()];
    for (chart, place) in charts.iter().zip(places) {
        let origin = Vec2::new(place.0 as f32, place.1 as f32);
        for (&face, corners) in chart.faces.iter().zip(&chart.corners) {
            out[face as usize] = corners.map(|p| (origin + p / texel_mm).to_array());
        }
    }
    out
}

/// Puts the charts onto shelves, tallest first, each with its border around; the side of the square, a multiple of 16, and where
/// each begins.
fn pack(charts: &[Chart], texel_mm: f32, most: usize) -> Option<(usize, Vec<(i32, i32)>)> {
    let sizes: Vec<(i32, i32)> = charts
        .iter()
        .map(|c| {
            let size = (c.extent / texel_mm).ceil().as_ivec2() + 2 * BORDER;
            (size.x, size.y)
        })
        .collect();
    let area: i64 = sizes.iter().map(|s| i64::from(s.0) * i64::from(s.1)).sum();
    let smallest = ((area as f64).sqrt() / 16.0).ceil() as usize * 16;
    let mut order: Vec<usize> = (0..charts.len()).collect();
    order.sort_by_key(|&i| (-sizes[i].1, -sizes[i].0));
    (smallest.max(16)..=most).step_by(16).find_map(|side| Some((side, shelves(&sizes, &order, side as i32)?)))
}

fn shelves(sizes: &[(i32, i32)], order: &[usize], side: i32) -> Option<Vec<(i32, i32)>> {
    let mut places = vec![(0, 0); sizes.len()];
    // Column, row and height of each shelf.
    let mut shelves: Vec<(i32, i32, i32)> = Vec::new();
    let mut top = 0;
    for &i in order {
        let (w, h) = sizes[i];
        let found = shelves.iter().position(|s| s.0 + w <= side && h <= s.2);
        let shelf = match found {
            Some(shelf) => shelf,
            None if w <= side && top + h <= side => {
                shelves.push((0, top, h));
                top += h;
                shelves.len() - 1
            }
            None => return None,
        };
        places[i] = (shelves[shelf].0 + BORDER, shelves[shelf].1 + BORDER);
        shelves[shelf].0 += w;
    }
    Some(places)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use translume_mesh::Topology;

    /// A sphere of `n` bands and 2n segments, radius `r`, looking outwards, closed.
    pub(crate) fn sphere(n: u32, r: f32) -> TriMesh {
        let ring = |j: u32, i: u32| match j {
            0 => 0,
            j if j == n => 1 + (n - 1) * 2 * n,
            j => 1 + (j - 1) * 2 * n + i % (2 * n),
        };
        let mut positions = vec![[0.0, 0.0, r]];
        for j in 1..n {
            for i in 0..2 * n {
                let (theta, phi) =
                    (std::f32::consts::PI * j as f32 / n as f32, std::f32::consts::PI * i as f32 / n as f32);
                positions.push([r * theta.sin() * phi.cos(), r * theta.sin() * phi.sin(), r * theta.cos()]);
            }
        }
        positions.push([0.0, 0.0, -r]);
        let mut indices = Vec::new();
        for (j, i) in (0..n).flat_map(|j| (0..2 * n).map(move |i| (j, i))) {
            let [a, b, c, d] = [ring(j, i), ring(j + 1, i), ring(j + 1, i + 1), ring(j, i + 1)];
            indices.extend([[a, b, c], [a, c, d]].into_iter().filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]));
        }
        let mesh = TriMesh { positions, indices, ..TriMesh::default() };
        assert!(Topology::of(&mesh).volume.unwrap() > 0.0);
        mesh
    }

    #[test]
    fn stretch_is_bounded_charts_do_not_overlap_and_areas_sum_up() {
        let mesh = sphere(12, 10.0);
        let atlas = Atlas::new(&mesh, &AtlasParams::default()).unwrap();
        for (face, corners) in atlas.corners.iter().enumerate() {
            let flat = corners.map(Vec2::from);
            let p = mesh.corners(face);
            // Singular values of the map from the atlas in mm to the surface, by its metric.
            let at = |i: usize| (flat[i] - flat[0]) * atlas.texel_mm;
            let inverse = glam::Mat2::from_cols(at(1), at(2)).inverse();
            let (e1, e2) = (p[1] - p[0], p[2] - p[0]);
            let (du, dv) =
                (e1 * inverse.x_axis.x + e2 * inverse.x_axis.y, e1 * inverse.y_axis.x + e2 * inverse.y_axis.y);
            let (g11, g12, g22) = (du.dot(du), du.dot(dv), dv.dot(dv));
            let mean = (g11 + g22) / 2.0;
            let spread = ((g11 - g22).powi(2) / 4.0 + g12 * g12).sqrt();
            assert!((mean + spread).sqrt() <= 2.01 && (mean - spread).sqrt() >= 0.99, "{face}");
        }
        let sum: f64 = atlas.texels.iter().map(|t| f64::from(t.area)).sum();
        assert!((sum / mesh.area() - 1.0).abs() < 1e-4);
        // As many texels as the area asks for, between stretch 1 and 2: none is covered twice or lost.
        let least = mesh.area() / (2.0 * f64::from(atlas.texel_mm).powi(2));
        assert!((atlas.texels.len() as f64) > least && atlas.side <= 512, "{} {least}", atlas.texels.len());
    }

    #[test]
    fn neighbours_are_near_on_the_surface_also_across_borders() {
        let mesh = sphere(12, 10.0);
        let atlas = Atlas::new(&mesh, &AtlasParams::default()).unwrap();
        let mut crossed = 0;
        for t in 0..atlas.texels.len() {
            for (dx, dy) in (-RADIUS..=RADIUS).flat_map(|y| (-RADIUS..=RADIUS).map(move |x| (x, y))) {
                let n = atlas.neighbour(t, dx, dy).expect("linked");
                let (a, b) = (&atlas.texels[t], &atlas.texels[n]);
                let away = a.at.distance(b.at) / atlas.texel_mm;
                let flat = ((dx * dx + dy * dy) as f32).sqrt();
                assert!(away <= 2.0 * flat + 2.0, "{t} {dx} {dy}: {away} {flat}");
                crossed += usize::from(i32::from(b.xy[0]) - i32::from(a.xy[0]) != dx);
            }
        }
        assert!(crossed > 1000, "{crossed}");
    }

    #[test]
    fn a_function_of_the_surface_is_found_again_between_texels() {
        let mesh = sphere(12, 10.0);
        let atlas = Atlas::new(&mesh, &AtlasParams::default()).unwrap();
        let f = |p: Vec3| p.x + 2.0 * p.y - p.z;
        for face in 0..mesh.indices.len() as u32 {
            for uv in [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.3, 0.3]] {
                let [a, b, c] = mesh.corners(face as usize);
                let p = a + uv[0] * (b - a) + uv[1] * (c - a);
                let found: f32 = atlas.between(face, uv).iter().map(|&(t, w)| w * f(atlas.texels[t as usize].at)).sum();
                assert!((found - f(p)).abs() < 2.5 * atlas.texel_mm, "{face} {uv:?}: {found} {}", f(p));
            }
        }
    }
}
