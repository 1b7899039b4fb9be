//! A mesh that shines in many places: one light a place, whose points are drawn uniformly by area.
//!
//! A light a triangle, as single meshes have it, chooses better but takes some 200 bytes a triangle and place. Limits:
//! half of the points of a closed mesh face away from where they are wanted; only under similarities does one table of
//! areas serve all places.

use crate::light::shape::{Place3, mesh_place, radiance, rounding};
use glam::{DAffine3, Vec2, Vec3};
use std::sync::Arc;
use translume_core::distribution::Piecewise1d;
use translume_core::warp;
use translume_mesh::{Bounds, TriMesh};
use translume_scene::{Scene, TextureId};
use translume_trace::SurfacePoint;

/// The triangles of a mesh by their areas, shared by all its places.
#[derive(Debug)]
pub(crate) struct Faces {
    mesh: Arc<TriMesh>,
    by_area: Piecewise1d,
    bounds: Bounds,
    area: f64,
}

impl Faces {
    /// `None` for a mesh without area.
    pub(crate) fn new(mesh: &Arc<TriMesh>) -> Option<Self> {
        let area = |face| {
            let [a, b, c] = mesh.corners(face).map(Vec3::as_dvec3);
            let area = 0.5 * (b - a).cross(c - a).length();
            if area.is_finite() { area } else { 0.0 }
        };
        let areas: Vec<f32> = (0..mesh.indices.len()).map(|face| area(face) as f32).collect();
        let area = areas.iter().map(|&a| f64::from(a)).sum();
        Some(Self { by_area: Piecewise1d::new(&areas)?, bounds: mesh.bounds(), mesh: mesh.clone(), area })
    }
}

/// A mesh in its place.
#[derive(Clone, Debug)]
pub(crate) struct MeshLight {
    faces: Arc<Faces>,
    world_from_object: DAffine3,
    flip: bool,
    /// In the world.
    area: f32,
}

impl MeshLight {
    /// `scale` is that of `world_from_object`, a similarity.
    pub(crate) fn new(faces: Arc<Faces>, world_from_object: DAffine3, scale: f64, flip: bool) -> Self {
        let area = (faces.area * scale * scale) as f32;
        Self { faces, world_from_object, flip, area }
    }

    pub(crate) fn area(&self) -> f32 {
        self.area
    }

    /// A box around it in the world.
    pub(crate) fn bounds(&self) -> Bounds {
        let own = &self.faces.bounds;
        let mut bounds = Bounds::EMPTY;
        for corner in 0..8 {
            let pick = |a: usize| f64::from(if corner >> a & 1 == 0 { own.lo[a] } else { own.hi[a] });
            bounds.grow(self.world_from_object.transform_point3(glam::DVec3::new(pick(0), pick(1), pick(2))).as_vec3());
        }
        bounds
    }

    /// A point, uniform by area, with the normal on the bright side.
    pub(crate) fn place(&self, scene: &Scene, texture: TextureId, u: Vec2) -> Place3 {
        let (face, _, x) = self.faces.by_area.sample_discrete(u.x);
        let mesh = &self.faces.mesh;
        let b = warp::uniform_triangle(x, u.y);
        let [p0, p1, p2] = mesh.corners(face).map(|v| self.world_from_object.transform_point3(v.as_dvec3()));
        let (e1, e2) = (p1 - p0, p2 - p0);
        let q = (p0 + e1 * f64::from(b.x) + e2 * f64::from(b.y)).as_vec3();
        let n = bright_normal(mesh, face, &self.world_from_object, self.flip);
        let reach = e1.abs().max(e2.abs()).max_element() as f32 * 4.0 + p0.abs().max_element() as f32;
        Place3 {
            point: SurfacePoint { p: q, ng: n, error: rounding(q, reach) },
            pdf_a: 1.0 / self.area,
            radiance: radiance(scene, texture, || mesh_place(mesh, face as u32, b)),
        }
    }
}

/// The unit normal of a triangle in the world on the side that shines: that of its shading normals, as for hits.
pub(crate) fn bright_normal(mesh: &TriMesh, face: usize, world_from_object: &DAffine3, flip: bool) -> Vec3 {
    let [a, b, c] = mesh.corners(face).map(|v| world_from_object.transform_point3(v.as_dvec3()));
    let mut n = (b - a).cross(c - a).normalize_or_zero().as_vec3();
    if world_from_object.matrix3.determinant() < 0.0 {
        n = -n;
    }
    if let Some(normals) = &mesh.normals {
        let sum: Vec3 = mesh.indices[face].iter().map(|&i| Vec3::from(normals[i as usize])).sum();
        let m = world_from_object.matrix3.inverse().transpose().as_mat3();
        if (m * sum).dot(n) < 0.0 {
            n = -n;
        }
    }
    if flip { -n } else { n }
}
