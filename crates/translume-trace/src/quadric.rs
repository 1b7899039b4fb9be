//! Spheres, disks and open cylinders, intersected in double precision.

use crate::ray::Ray;
use glam::{DVec3, Vec3};
use translume_mesh::Bounds;

/// A sphere; its normal points outwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sphere {
    /// Centre.
    pub center: Vec3,
    /// Radius, above 0.
    pub radius: f32,
}

/// A flat disk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disk {
    /// Centre.
    pub center: Vec3,
    /// Direction of the normal, of any length but 0.
    pub normal: Vec3,
    /// Radius, above 0.
    pub radius: f32,
}

/// The side of a cylinder, without caps; its normal points away from the axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cylinder {
    /// One end of the axis.
    pub p0: Vec3,
    /// The other end.
    pub p1: Vec3,
    /// Radius, above 0.
    pub radius: f32,
}

/// What a quadric answers. Points and normals are of double precision; `hit` takes and gives ray parameters.
pub(crate) trait Quadric {
    fn bounds(&self) -> Bounds;
    /// The smallest parameter in `t_min < t < t_max`.
    fn hit(&self, o: DVec3, d: DVec3, t_min: f64, t_max: f64) -> Option<f64>;
    /// The nearest point of the unbounded surface and the unit normal there.
    fn project(&self, p: DVec3) -> (DVec3, DVec3);
}

/// [`Quadric::hit`] rounded to the ray's precision, still within its limits.
#[inline]
pub(crate) fn intersect(quadric: &(impl Quadric + ?Sized), ray: &Ray, t_max: f32) -> Option<f32> {
    let t = quadric.hit(ray.o.as_dvec3(), ray.d.as_dvec3(), ray.t_min.into(), t_max.into())? as f32;
    (t > ray.t_min && t < t_max).then_some(t)
}

/// The box of radius `e` about `p` and `q`, rounded outwards.
fn around(p: Vec3, q: Vec3, e: Vec3) -> Bounds {
    let out = |v: Vec3, f: fn(f32) -> f32| Vec3::new(f(v.x), f(v.y), f(v.z));
    Bounds { lo: out(p.min(q) - e, f32::next_down), hi: out(p.max(q) + e, f32::next_up) }
}

/// Solves a t² − 2 b t + c = 0 given the discriminant b² − a c and picks the first root that `keep`s.
fn first_root(a: f64, b: f64, c: f64, discriminant: f64, keep: impl Fn(f64) -> bool) -> Option<f64> {
    if discriminant.is_nan() || discriminant < 0.0 || a == 0.0 {
        return None;
    }
    // Without cancellation: the root of larger magnitude first, the other from the product of both.
    let q = b + discriminant.sqrt().copysign(b);
    let (t0, t1) = if q == 0.0 { (0.0, 0.0) } else { (c / q, q / a) };
    [t0.min(t1), t0.max(t1)].into_iter().find(|&t| keep(t))
}

impl Quadric for Sphere {
    fn bounds(&self) -> Bounds {
        around(self.center, self.center, Vec3::splat(self.radius))
    }

    fn hit(&self, o: DVec3, d: DVec3, t_min: f64, t_max: f64) -> Option<f64> {
        let (f, r) = (o - self.center.as_dvec3(), f64::from(self.radius));
        let (a, b) = (d.length_squared(), -f.dot(d));
        // The discriminant from the distance of line and centre (Haines et al. 2019), precise far away too.
        let nearest = f + (b / a) * d;
        let discriminant = a * (r * r - nearest.length_squared());
        first_root(a, b, f.length_squared() - r * r, discriminant, |t| t > t_min && t < t_max)
    }

    fn project(&self, p: DVec3) -> (DVec3, DVec3) {
        let center = self.center.as_dvec3();
        let normal = (p - center).try_normalize().unwrap_or(DVec3::Z);
        (center + f64::from(self.radius) * normal, normal)
    }
}

impl Disk {
    fn unit_normal(&self) -> DVec3 {
        self.normal.as_dvec3().try_normalize().unwrap_or(DVec3::Z)
    }
}

impl Quadric for Disk {
    fn bounds(&self) -> Bounds {
        let n = self.unit_normal();
        let e = (DVec3::ONE - n * n).max(DVec3::ZERO).map(f64::sqrt) * f64::from(self.radius);
        around(self.center, self.center, e.as_vec3().map(f32::next_up))
    }

    fn hit(&self, o: DVec3, d: DVec3, t_min: f64, t_max: f64) -> Option<f64> {
        let (n, center) = (self.unit_normal(), self.center.as_dvec3());
        let t = n.dot(center - o) / n.dot(d);
        let inside = (o + t * d).distance_squared(center) <= f64::from(self.radius).powi(2);
        (inside && t > t_min && t < t_max).then_some(t)
    }

    fn project(&self, p: DVec3) -> (DVec3, DVec3) {
        let (n, center) = (self.unit_normal(), self.center.as_dvec3());
        (p - n.dot(p - center) * n, n)
    }
}

impl Cylinder {
    /// Unit axis and length.
    fn axis(&self) -> (DVec3, f64) {
        let axis = (self.p1 - self.p0).as_dvec3();
        (axis.normalize_or_zero(), axis.length())
    }
}

impl Quadric for Cylinder {
    fn bounds(&self) -> Bounds {
        around(self.p0, self.p1, Vec3::splat(self.radius))
    }

    fn hit(&self, o: DVec3, d: DVec3, t_min: f64, t_max: f64) -> Option<f64> {
        let (axis, length) = self.axis();
        let (f, r) = (o - self.p0.as_dvec3(), f64::from(self.radius));
        let (f2, d2) = (f - f.dot(axis) * axis, d - d.dot(axis) * axis);
        let (a, b) = (d2.length_squared(), -f2.dot(d2));
        let nearest = f2 + (b / a) * d2;
        let discriminant = a * (r * r - nearest.length_squared());
        first_root(a, b, f2.length_squared() - r * r, discriminant, |t| {
            let z = (f + t * d).dot(axis);
            t > t_min && t < t_max && z >= 0.0 && z <= length
        })
    }

    fn project(&self, p: DVec3) -> (DVec3, DVec3) {
        let (axis, _) = self.axis();
        let f = p - self.p0.as_dvec3();
        let foot = self.p0.as_dvec3() + f.dot(axis) * axis;
        let normal = (p - foot).try_normalize().unwrap_or_else(|| axis.any_orthonormal_vector());
        (foot + f64::from(self.radius) * normal, normal)
    }
}
