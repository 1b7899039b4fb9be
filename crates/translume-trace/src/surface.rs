//! Hit points with a bound on their error, and rays that start outside it (after pbrt, "Managing Rounding Error").
//!
//! Deviation: points come from barycentric coordinates in double precision, so that they lie on the triangle's plane up to
//! the final rounding; the bound is that rounding and the roundings of the triangle test for a ray that starts there.

use crate::geometry::{Geometry, Shape};
use crate::ray::{Hit, Ray};
use crate::scene::Scene;
use glam::{DAffine3, DVec3, Vec3};

/// A point on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Position in the world.
    pub p: Vec3,
    /// Unit normal of the surface itself: by the winding of triangles, outwards for quadrics.
    pub ng: Vec3,
    /// Absolute error bound of `p` per axis, for starting rays.
    pub error: Vec3,
}

impl SurfacePoint {
    /// An origin on the side of the surface to which `d` points, outside the error bound.
    #[inline]
    pub fn origin_towards(&self, d: Vec3) -> Vec3 {
        let distance = self.ng.abs().dot(self.error);
        let offset = self.ng * if d.dot(self.ng) < 0.0 { -distance } else { distance };
        // One rounding more than the sum may have lost.
        let q = self.p + offset;
        q + Vec3::select(offset.cmpeq(Vec3::ZERO), Vec3::ZERO, (q.abs() * f32::EPSILON).copysign(offset))
    }

    /// The ray from here along `d`.
    pub fn spawn(&self, d: Vec3) -> Ray {
        Ray::new(self.origin_towards(d), d)
    }

    /// The segment to a point in space; its direction has the length of the segment, t runs from 0 to 1.
    pub fn segment_to(&self, p: Vec3) -> Ray {
        let o = self.origin_towards(p - self.p);
        Ray { o, d: p - o, t_min: 0.0, t_max: 1.0 }
    }

    /// The segment to another surface, that surface excluded; t runs from 0 to 1.
    pub fn segment_between(&self, other: &Self) -> Ray {
        let back = self.p - other.p;
        // The far end also sees the roundings of a direction and a parameter as long as the segment.
        let error = other.error + Vec3::splat(back.abs().max_element() * 4.0 * f32::EPSILON);
        self.segment_to(Self { error, ..*other }.origin_towards(back))
    }
}

impl Geometry {
    /// The point of `hit`, which `ray` found in this geometry.
    pub fn surface(&self, ray: &Ray, hit: &Hit) -> SurfacePoint {
        self.surface_in_world(ray, hit, true, &DAffine3::IDENTITY, &DAffine3::IDENTITY)
    }

    /// `ray` is in the object's space; the transforms are each other's inverse, and the identity if `in_place`.
    fn surface_in_world(
        &self,
        ray: &Ray,
        hit: &Hit,
        in_place: bool,
        world_from_object: &DAffine3,
        object_from_world: &DAffine3,
    ) -> SurfacePoint {
        let shape = &self.shapes()[hit.part as usize];
        // Position, normal (of any length) and how far the parts that enter the hit's rounding are away, in the world.
        let (p, normal, reach) = match (shape, shape.quadric()) {
            (Shape::Mesh(mesh), _) => {
                let corners = mesh.corners(hit.prim as usize);
                let to_world = |v: DVec3| if in_place { v } else { world_from_object.transform_point3(v) };
                let [a, b, c] = corners.map(|v| to_world(v.as_dvec3()));
                let (u, v) = (f64::from(hit.u), f64::from(hit.v));
                let p = a * (1.0 - u - v) + b * u + c * v;
                let reach = (a - p).abs().max((b - p).abs()).max((c - p).abs());
                let mirrored = !in_place && world_from_object.matrix3.determinant() < 0.0;
                let normal = (b - a).cross(c - a);
                (p, if mirrored { -normal } else { normal }, reach)
            }
            (_, Some(quadric)) => {
                let (p, normal) = quadric.project(ray.o.as_dvec3() + f64::from(hit.t) * ray.d.as_dvec3());
                let normal = object_from_world.matrix3.transpose() * normal;
                (world_from_object.transform_point3(p), normal, DVec3::ZERO)
            }
            (_, None) => (DVec3::ZERO, DVec3::Z, DVec3::ZERO), // every other shape is a quadric
        };
        // An instance's rays are rounded in object space: carry that over as well.
        let rounding = if in_place {
            p.abs()
        } else {
            let m = &world_from_object.matrix3;
            let object = object_from_world.transform_point3(p).abs();
            p.abs() + m.x_axis.abs() * object.x + m.y_axis.abs() * object.y + m.z_axis.abs() * object.z
        };
        let half_ulp = f64::from(f32::EPSILON) / 2.0;
        SurfacePoint {
            p: p.as_vec3(),
            ng: normal.try_normalize().unwrap_or(DVec3::Z).as_vec3(),
            error: ((2.0 * rounding + 8.0 * DVec3::splat(reach.max_element())) * half_ulp).as_vec3(),
        }
    }
}

impl Scene {
    /// The point of `hit`, which `ray` found in this scene.
    pub fn surface(&self, ray: &Ray, hit: &Hit) -> SurfacePoint {
        let instance = &self.instances()[hit.instance as usize];
        let object_from_world = self.object_from_world(hit.instance);
        let in_place = self.is_in_place(hit.instance);
        let object_ray = match in_place {
            true => *ray,
            false => Ray {
                o: object_from_world.transform_point3(ray.o.as_dvec3()).as_vec3(),
                d: object_from_world.transform_vector3(ray.d.as_dvec3()).as_vec3(),
                ..*ray
            },
        };
        instance.geometry.surface_in_world(&object_ray, hit, in_place, &instance.world_from_object, object_from_world)
    }
}
