//! The surface of a captured object, for rays: what a camera sees through a pixel, where a beam meets it.

use super::rig::{Camera, dot};
use glam::Vec3;
use std::sync::Arc;
use translume_mesh::TriMesh;
use translume_trace::{Geometry, Ray};

/// A mesh that rays can be cast at.
pub struct Surface {
    /// The mesh.
    pub mesh: Arc<TriMesh>,
    geometry: Geometry,
}

/// A place of the surface.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Where, in mm.
    pub at: [f64; 3],
    /// Unit normal, by the winding of the triangle.
    pub normal: Vec3,
    /// The triangle.
    pub face: u32,
    /// Barycentric coordinates of its second and third corner.
    pub uv: [f32; 2],
    /// From the ray's origin, in lengths of its direction.
    pub distance: f64,
    /// The same place, moved inwards by the rounding of its coordinates.
    pub inside: [f64; 3],
}

impl Surface {
    /// Prepares `mesh`; `None` for more triangles than a tree can hold.
    pub fn new(mesh: TriMesh) -> Option<Self> {
        let mesh = Arc::new(mesh);
        Some(Self { geometry: Geometry::from_mesh(mesh.clone()).ok()?, mesh })
    }

    /// The first place on a ray.
    pub fn first(&self, origin: Vec3, direction: Vec3) -> Option<Place> {
        let ray = Ray::new(origin, direction);
        let hit = self.geometry.intersect(&ray)?;
        let point = self.geometry.surface(&ray, &hit);
        let inside = point.origin_towards(-point.ng).as_dvec3().to_array();
        let at = point.p.as_dvec3().to_array();
        let uv = [hit.u, hit.v];
        Some(Place { at, normal: point.ng, face: hit.prim, uv, distance: f64::from(hit.t), inside })
    }

    /// The first triangle on a ray, with the barycentric coordinates of its second and third corner there.
    pub fn first_hit(&self, ray: &Ray) -> Option<(u32, [f32; 2])> {
        self.geometry.intersect(ray).map(|hit| (hit.prim, [hit.u, hit.v]))
    }

    /// Whether anything lies on a ray.
    pub fn occluded(&self, ray: &Ray) -> bool {
        self.geometry.occluded(ray)
    }

    /// Largest coordinate of the box around it.
    pub(crate) fn extent(&self) -> Vec3 {
        let bounds = self.geometry.bounds();
        bounds.lo.abs().max(bounds.hi.abs())
    }

    /// What a camera sees at a place of its frame, and the cosine to the line of sight; `None` beside the object and where
    /// the back of a triangle is seen.
    pub fn seen(&self, camera: &Camera, px: [f64; 2]) -> Option<(Place, f64)> {
        let direction = camera.direction(px);
        let to_single = |v: [f64; 3]| Vec3::from_array(v.map(|x| x as f32));
        let place = self.first(to_single(camera.eye()), to_single(direction))?;
        let cos = -dot(direction, place.normal.as_dvec3().to_array());
        (cos > 0.0).then_some((place, cos))
    }

    /// The corner positions of a triangle and where it lies between them.
    pub fn weights(place: &Place) -> [f64; 3] {
        let [u, v] = place.uv.map(f64::from);
        [1.0 - u - v, u, v]
    }
}

/// A regular division of all triangles into n² congruent parts each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Texels {
    /// Parts along an edge.
    pub per_edge: usize,
}

impl Texels {
    /// So fine that parts of `mesh` are about `size_mm` long, up to 32 along an edge.
    pub fn about(mesh: &TriMesh, size_mm: f64) -> Self {
        // The edge of an equilateral triangle of mean area.
        let area = mesh.area() / mesh.indices.len().max(1) as f64;
        let edge = (area * 4.0 / 3f64.sqrt()).sqrt();
        Self { per_edge: ((edge / size_mm).ceil() as usize).clamp(1, 32) }
    }

    /// Parts of one triangle.
    pub fn per_face(&self) -> usize {
        self.per_edge * self.per_edge
    }

    /// The part, over all triangles, in which a place is.
    #[inline]
    pub fn index(&self, face: u32, uv: [f32; 2]) -> usize {
        let n = self.per_edge;
        let scaled = |x: f32| f64::from(x.clamp(0.0, 1.0)) * n as f64;
        let (x, y) = (scaled(uv[0]), scaled(uv[1]));
        let row = (x as usize).min(n - 1);
        let column = (y as usize).min(n - 1 - row);
        // Rows along the first coordinate have 2 (n − row) − 1 parts, standing and hanging ones in turn.
        let hanging = (x - row as f64) + (y - column as f64) > 1.0 && column + 1 < n - row;
        face as usize * n * n + 2 * n * row - row * row + 2 * column + usize::from(hanging)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texels_have_equal_areas() {
        // The parts of a triangle, hit by a fine regular grid of its points.
        for n in [1, 2, 3, 7] {
            let texels = Texels { per_edge: n };
            let mut counts = vec![0usize; n * n];
            let fine = 70 * n;
            for i in 0..fine {
                for j in 0..fine - i {
                    let at = |k: usize| (k as f32 + 1.0 / 3.0) / fine as f32;
                    counts[texels.index(0, [at(i), at(j)])] += 1;
                }
            }
            let mean = counts.iter().sum::<usize>() as f64 / (n * n) as f64;
            assert!(counts.iter().all(|&c| (c as f64 / mean - 1.0).abs() < 0.04), "{n}: {counts:?}");
        }
        assert_eq!(Texels { per_edge: 4 }.index(2, [1.0, 0.0]), 2 * 16 + 15);
        assert_eq!(Texels { per_edge: 4 }.index(2, [0.0, 1.0]), 2 * 16 + 6);
    }
}
