//! Embree 3 as a peer.

use crate::rays::{Kind, RaySet};
use cgmath::{Vector3, Vector4};
use embree::{CommittedScene, Device, IntersectContext, Ray, RayHit, Scene, TriangleMesh};
use std::hint::black_box;
use std::time::Instant;
use translume_mesh::TriMesh;

pub(crate) struct Embree {
    scene: CommittedScene<'static>,
}

impl Embree {
    pub(crate) fn new(mesh: &TriMesh) -> Self {
        // The wrapper's lifetimes want device and scene to outlive everything; a benchmark may leak them.
        let device: &'static Device = Box::leak(Box::new(Device::new()));
        let mut triangles = TriangleMesh::unanimated(device, mesh.indices.len(), mesh.positions.len());
        let mut vertices = triangles.vertex_buffer.map();
        mesh.positions.iter().enumerate().for_each(|(i, [x, y, z])| vertices[i] = Vector4::new(*x, *y, *z, 0.0));
        let mut indices = triangles.index_buffer.map();
        mesh.indices.iter().enumerate().for_each(|(i, [a, b, c])| indices[i] = Vector3::new(*a, *b, *c));
        drop((vertices, indices));
        let mut triangles = embree::Geometry::Triangle(triangles);
        triangles.commit();
        let scene: &'static mut Scene = Box::leak(Box::new(Scene::new(device)));
        scene.attach_geometry(triangles);
        Self { scene: scene.commit() }
    }

    pub(crate) fn run(&self, set: &RaySet) -> (f64, usize) {
        let vector = |v: translume_trace::glam::Vec3| Vector3::new(v.x, v.y, v.z);
        let start = Instant::now();
        let hits = set.rays.iter().filter(|ray| {
            let mut context = match set.kind {
                Kind::Coherent => IntersectContext::coherent(),
                _ => IntersectContext::incoherent(),
            };
            let mut segment = Ray::segment(vector(ray.o), vector(ray.d), ray.t_min, ray.t_max);
            if set.kind == Kind::AnyHit {
                self.scene.occluded(&mut context, &mut segment);
                return segment.tfar < 0.0;
            }
            let mut hit = RayHit::new(segment);
            self.scene.intersect(&mut context, &mut hit);
            black_box(&hit).hit.hit()
        });
        let hits = hits.count();
        (start.elapsed().as_secs_f64(), hits)
    }
}
