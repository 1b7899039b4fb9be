//! Rays and hits.

use glam::Vec3;

/// The points `o + t d` for `t_min < t < t_max`. The direction need not have length one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Origin.
    pub o: Vec3,
    /// Direction.
    pub d: Vec3,
    /// Smallest parameter, at least 0.
    pub t_min: f32,
    /// Largest parameter; may be infinite.
    pub t_max: f32,
}

impl Ray {
    /// From `o` along `d` without end.
    pub fn new(o: Vec3, d: Vec3) -> Self {
        Self { o, d, t_min: 0.0, t_max: f32::INFINITY }
    }

    /// The point at `t`.
    pub fn at(&self, t: f32) -> Vec3 {
        self.o + t * self.d
    }
}

/// Where a ray meets a surface first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Ray parameter.
    pub t: f32,
    /// Triangles: barycentric coordinate of the second corner. Quadrics: 0.
    pub u: f32,
    /// Triangles: barycentric coordinate of the third corner. Quadrics: 0.
    pub v: f32,
    /// Triangle of the part's mesh; 0 for quadrics.
    pub prim: u32,
    /// Shape of the geometry, in the order given to [`crate::Geometry::new`].
    pub part: u32,
    /// Instance of the scene; 0 for hits of a bare geometry.
    pub instance: u32,
}
