//! Lights that are surfaces: triangles by area, spheres by solid angle, other quadrics by area.
//!
//! They shine on one side, that of the normal.

use crate::Rgb;
use crate::light::mesh::MeshLight;
use crate::light::tree::LightBounds;
use crate::light::{End, LightSample, LightStart};
use crate::texture::{self, OnMesh, Place};
use glam::{DAffine3, DVec3, Vec2, Vec3};
use std::f32::consts::{FRAC_PI_2, PI, TAU};
use std::sync::Arc;
use translume_core::frame::Frame;
use translume_core::warp;
use translume_mesh::{Bounds, TriMesh};
use translume_scene::{Geometry, Scene, TextureId};
use translume_trace::SurfacePoint;

/// An emitting triangle or quadric.
#[derive(Clone, Debug)]
pub(crate) struct ShapeLight {
    pub(crate) radiance: TextureId,
    /// Power, as luminance.
    pub(crate) power: f32,
    pub(crate) form: Form,
}

#[derive(Clone, Debug)]
pub(crate) enum Form {
    /// `n` is the unit normal on the bright side, `mesh` and `face` are for texture coordinates.
    Triangle { p: Vec3, e1: Vec3, e2: Vec3, n: Vec3, area: f32, mesh: Arc<TriMesh>, face: u32 },
    /// A sphere that shines outwards.
    Sphere { center: Vec3, radius: f32, object_from_world: Box<DAffine3> },
    /// Any other quadric in its place.
    Quadric(Box<Quadric>),
    /// One of the places of a mesh.
    Mesh(Box<MeshLight>),
}

/// A quadric under an affine map, sampled uniformly in its own space.
#[derive(Clone, Debug)]
pub(crate) struct Quadric {
    pub(crate) geometry: Geometry,
    pub(crate) world_from_object: DAffine3,
    pub(crate) flip: bool,
}

/// A point of a light.
pub(crate) struct Place3 {
    pub(super) point: SurfacePoint,
    pub(super) pdf_a: f32,
    pub(super) radiance: Rgb,
}

/// What a light emits where `place` says; most lights are the same everywhere and need not be asked where.
#[inline]
pub(super) fn radiance<'a>(scene: &Scene, id: TextureId, place: impl FnOnce() -> Place<'a>) -> Rgb {
    scene.constant(id).unwrap_or_else(|| texture::eval(scene, id, &place()))
}

impl ShapeLight {
    pub(crate) fn bounds(&self) -> Option<LightBounds> {
        let (bounds, axis, theta_o) = match &self.form {
            Form::Triangle { p, e1, e2, n, .. } => {
                let mut b = Bounds { lo: *p, hi: *p };
                b.grow(*p + *e1);
                b.grow(*p + *e2);
                (b, *n, 0.0)
            }
            Form::Sphere { center, radius, .. } => {
                (Bounds { lo: *center - Vec3::splat(*radius), hi: *center + Vec3::splat(*radius) }, Vec3::Z, PI)
            }
            Form::Quadric(q) => {
                let own = q.geometry.bounds();
                let mut b = Bounds::EMPTY;
                for corner in 0..8 {
                    let pick = |a: usize| f64::from(if corner >> a & 1 == 0 { own.lo[a] } else { own.hi[a] });
                    b.grow(q.world_from_object.transform_point3(DVec3::new(pick(0), pick(1), pick(2))).as_vec3());
                }
                match q.geometry {
                    Geometry::Disk => (b, q.normal(DVec3::Z).normalize().as_vec3(), 0.0),
                    _ => (b, Vec3::Z, PI),
                }
            }
            Form::Mesh(m) => (m.bounds(), Vec3::Z, PI),
        };
        let finite = bounds.lo.is_finite() && bounds.hi.is_finite() && axis.is_finite();
        finite.then_some(LightBounds { bounds, power: self.power, axis, theta_o, theta_e: FRAC_PI_2 })
    }

    /// Draws a direction from `p` to the light.
    #[inline]
    pub(crate) fn sample(&self, scene: &Scene, p: Vec3, u: Vec2) -> Option<LightSample> {
        if let Form::Sphere { center, radius, object_from_world } = &self.form
            && let Some((wi, pdf_w, q)) = sample_cone(p, *center, *radius, u)
        {
            let point = SurfacePoint { p: q, ng: (q - *center) / *radius, error: rounding(q, *radius) };
            let place = || Place::bare(sphere_uv(object_from_world, q));
            let radiance = radiance(scene, self.radiance, place);
            return Some(LightSample { wi, radiance, pdf_w, delta: false, end: End::Surface(point) });
        }
        let Place3 { point, pdf_a, radiance } = self.place(scene, u);
        let way = point.p - p;
        let wi = way.try_normalize()?;
        let cos = -wi.dot(point.ng);
        if cos <= 0.0 {
            return None;
        }
        let pdf_w = pdf_a * way.length_squared() / cos;
        Some(LightSample { wi, radiance, pdf_w, delta: false, end: End::Surface(point) })
    }

    /// Density of [`ShapeLight::sample`] from `p` for the direction to the point `q` with unit normal `nq`.
    #[inline]
    pub(crate) fn pdf_w(&self, p: Vec3, q: Vec3, nq: Vec3) -> f32 {
        if let Form::Sphere { center, radius, .. } = &self.form
            && let Some(cos_max) = cone(p, *center, *radius)
        {
            return warp::uniform_cone_pdf(cos_max);
        }
        let way = q - p;
        let cos = nq.dot(way).abs() / way.length();
        if cos > 0.0 { self.pdf_a(q) * way.length_squared() / cos } else { 0.0 }
    }

    /// Density of places per area, at the point `q`.
    pub(crate) fn pdf_a(&self, q: Vec3) -> f32 {
        match &self.form {
            Form::Triangle { area, .. } => 1.0 / area,
            Form::Sphere { radius, .. } => 1.0 / (2.0 * TAU * radius * radius),
            Form::Quadric(quadric) => {
                let object = quadric.world_from_object.inverse().transform_point3(q.as_dvec3());
                quadric.pdf_a(quadric.object_normal(object))
            }
            Form::Mesh(m) => 1.0 / m.area(),
        }
    }

    /// A point of the light.
    #[inline]
    fn place(&self, scene: &Scene, u: Vec2) -> Place3 {
        match &self.form {
            Form::Triangle { p, e1, e2, n, area, mesh, face } => {
                let b = warp::uniform_triangle(u.x, u.y);
                let q = *p + *e1 * b.x + *e2 * b.y;
                let reach = e1.abs().max(e2.abs()).max_element();
                let point = SurfacePoint { p: q, ng: *n, error: rounding(q, 4.0 * reach + p.abs().max_element()) };
                let radiance = radiance(scene, self.radiance, || mesh_place(mesh, *face, b));
                Place3 { point, pdf_a: 1.0 / area, radiance }
            }
            Form::Sphere { center, radius, object_from_world } => {
                let n = warp::uniform_sphere(u.x, u.y);
                let q = *center + n * *radius;
                let point = SurfacePoint { p: q, ng: n, error: rounding(q, center.abs().max_element() + *radius) };
                let place = || Place::bare(sphere_uv(object_from_world, q));
                let radiance = radiance(scene, self.radiance, place);
                Place3 { point, pdf_a: 1.0 / (2.0 * TAU * radius * radius), radiance }
            }
            Form::Quadric(quadric) => {
                let (object, normal, uv) = quadric.uniform(u);
                let q = quadric.world_from_object.transform_point3(object).as_vec3();
                let ng = quadric.normal(normal).normalize_or(DVec3::Z).as_vec3();
                let point = SurfacePoint { p: q, ng, error: rounding(q, 4.0 * q.abs().max_element()) };
                let radiance = radiance(scene, self.radiance, || Place::bare(uv));
                Place3 { point, pdf_a: quadric.pdf_a(normal), radiance }
            }
            Form::Mesh(m) => m.place(scene, self.radiance, u),
        }
    }

    pub(crate) fn start(&self, scene: &Scene, u: Vec2, v: Vec2) -> Option<LightStart> {
        let Place3 { point, pdf_a, radiance } = self.place(scene, u);
        let local = warp::cosine_hemisphere(v.x, v.y);
        let pdf_w = warp::cosine_hemisphere_pdf(local);
        (pdf_w > 0.0).then(|| LightStart {
            origin: End::Surface(point),
            p: point.p,
            n: point.ng,
            direction: Frame::from_normal(point.ng).to_world(local),
            radiance,
            choice: 1.0,
            pdf_a,
            pdf_w,
            light: 0,
            delta: false,
        })
    }
}

impl Quadric {
    /// The image of an object-space normal, any length, on the bright side.
    fn normal(&self, n: DVec3) -> DVec3 {
        let n = self.world_from_object.matrix3.inverse().transpose() * n;
        if self.flip { -n } else { n }
    }

    /// A point that is uniform in object space, the unit normal there, and texture coordinates.
    fn uniform(&self, u: Vec2) -> (DVec3, DVec3, Vec2) {
        match &self.geometry {
            Geometry::Sphere { center, radius } => {
                let n = warp::uniform_sphere(u.x, u.y).as_dvec3().normalize();
                (*center + n * *radius, n, uv_of_sphere(n))
            }
            Geometry::Cylinder { p0, p1, radius } => {
                let frame = Frame::from_normal((*p1 - *p0).normalize_or(DVec3::Z).as_vec3());
                let (sin, cos) = (TAU * u.y).sin_cos();
                let n = (frame.s * cos + frame.t * sin).as_dvec3();
                (p0.lerp(*p1, u.x.into()) + n * *radius, n, Vec2::new(u.y, 1.0 - u.x))
            }
            Geometry::Disk | Geometry::Mesh(_) => {
                let d = warp::uniform_disk(u.x, u.y);
                let uv = Vec2::new(d.length(), 1.0 - warp::azimuth(d.extend(0.0)) / TAU);
                (d.extend(0.0).as_dvec3(), DVec3::Z, uv)
            }
        }
    }

    /// Unit normal in object space at a point of the surface.
    fn object_normal(&self, p: DVec3) -> DVec3 {
        match &self.geometry {
            Geometry::Sphere { center, .. } => (p - *center).normalize_or(DVec3::Z),
            Geometry::Cylinder { p0, p1, .. } => {
                let axis = (*p1 - *p0).normalize_or(DVec3::Z);
                let out = p - *p0;
                (out - axis * axis.dot(out)).normalize_or(DVec3::X)
            }
            Geometry::Disk | Geometry::Mesh(_) => DVec3::Z,
        }
    }

    /// Density per area in the world of [`Quadric::uniform`]: areas of normal n grow by |det M| |M⁻ᵀ n|.
    fn pdf_a(&self, object_normal: DVec3) -> f32 {
        let own = match &self.geometry {
            Geometry::Sphere { radius, .. } => 4.0 * std::f64::consts::PI * radius * radius,
            Geometry::Cylinder { p0, p1, radius } => std::f64::consts::TAU * radius * (*p1 - *p0).length(),
            Geometry::Disk | Geometry::Mesh(_) => std::f64::consts::PI,
        };
        let m = &self.world_from_object.matrix3;
        let growth = m.determinant().abs() * (m.inverse().transpose() * object_normal).length();
        (1.0 / (own * growth)) as f32
    }

    /// Area in the world, by quadrature over the surface.
    pub(crate) fn area(&self) -> f32 {
        let n = 16;
        let inverse: f32 = (0..n * n)
            .map(|i| Vec2::new((i % n) as f32 + 0.5, (i / n) as f32 + 0.5) / n as f32)
            .map(|u| 1.0 / self.pdf_a(self.uniform(u).1))
            .sum();
        inverse / (n * n) as f32
    }
}

/// A mesh's point, for textures.
#[inline]
pub(crate) fn mesh_place(mesh: &TriMesh, face: u32, b: Vec2) -> Place<'_> {
    let on = OnMesh { mesh, face, b };
    let uv = mesh.uvs.as_ref().map_or(b, |uv| on.mean(|i| Vec2::from(uv[i])));
    Place { uv, on: Some(on) }
}

/// u: azimuth over 2π; v: one minus the polar angle over π.
pub(crate) fn uv_of_sphere(n: DVec3) -> Vec2 {
    let n = n.as_vec3();
    Vec2::new(warp::azimuth(n) / TAU, 1.0 - n.z.clamp(-1.0, 1.0).acos() / PI)
}

/// `object_from_world` leads to the unit sphere about the origin.
fn sphere_uv(object_from_world: &DAffine3, q: Vec3) -> Vec2 {
    uv_of_sphere(object_from_world.transform_point3(q.as_dvec3()).normalize_or(DVec3::Z))
}

/// Bound of the rounding of a point that was computed from numbers of size `reach`.
pub(super) fn rounding(q: Vec3, reach: f32) -> Vec3 {
    (2.0 * q.abs() + Vec3::splat(4.0 * reach)) * f32::EPSILON
}

/// Cosine of the half angle under which a sphere is seen; `None` from inside, so close that the cone is no help, or so far
/// that the cosine rounds to one.
#[inline]
fn cone(p: Vec3, center: Vec3, radius: f32) -> Option<f32> {
    let distance2 = (center - p).length_squared();
    let sin2 = radius * radius / distance2;
    (1e-5..0.9999).contains(&sin2).then(|| (1.0 - sin2).sqrt())
}

/// A direction in the cone of the sphere, its density per solid angle, and the point that it meets.
#[inline]
fn sample_cone(p: Vec3, center: Vec3, radius: f32, u: Vec2) -> Option<(Vec3, f32, Vec3)> {
    let cos_max = cone(p, center, radius)?;
    let to_center = center - p;
    let distance = to_center.length();
    let local = warp::uniform_cone(u.x, u.y, cos_max);
    let wi = Frame::from_normal(to_center / distance).to_world(local);
    // The nearer root, along the chord; at the rim rounding may leave none.
    let half = (radius * radius - distance * distance * (1.0 - local.z * local.z)).max(0.0).sqrt();
    let q = p + wi * (distance * local.z - half);
    let n = (q - center).try_normalize()?;
    Some((wi, warp::uniform_cone_pdf(cos_max), center + n * radius))
}
