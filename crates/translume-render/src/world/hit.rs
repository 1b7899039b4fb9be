//! Hits with everything that shading wants.

use super::bend::Bend;
use super::{Form, World};
use crate::Rgb;
use crate::light::{mesh_place, uv_of_sphere};
use crate::texture::{OnMesh, Place};
use glam::{DVec3, Mat3, Vec2, Vec3};
use std::f32::consts::TAU;
use translume_bxdf::{Bsdf, Flags, Mode, Sample};
use translume_core::frame::Frame;
use translume_core::warp;
use translume_mesh::TriMesh;
use translume_scene::Geometry;
use translume_trace::{Hit, Ray, SurfacePoint};

/// Surfaces nearer to each other than this, relative to their coordinates (or 1), do not see each other. Models have sheets
/// that nearly coincide (decals, walls from two sides, quads cut along either diagonal) and mean one; rays that start
/// outside the rounding alone would find the darkness between them. `docs/decisions/0002-gap-between-sheets.md` has
/// the measurements. Scenes smaller than 1 have a smaller one, by their size.
const GAP: f32 = 1e-5;

/// Where a ray met a surface.
#[derive(Clone, Copy, Debug)]
pub struct SurfaceHit {
    /// Place, normal on the side that the shading normals are on, and where rays may start.
    pub point: SurfacePoint,
    /// Shading frame: its normal, the first tangent along ∂p/∂u.
    pub frame: Frame,
    /// Unit direction back along the ray.
    pub wo: Vec3,
    /// Ray parameter.
    pub t: f32,
    /// Triangle of the mesh; 0 for quadrics.
    pub prim: u32,
    pub(crate) surface: u32,
    /// Instance of the tracer.
    pub(crate) instance: u32,
    pub(crate) uv: Vec2,
    /// Barycentric coordinates on a triangle.
    pub(crate) b: Vec2,
    pub(crate) dp_du: Vec3,
    pub(crate) dp_dv: Vec3,
}

/// A BSDF in its place: what [`translume_bxdf::Bsdf`] does, for directions of the world.
#[derive(Clone, Debug)]
pub struct Shading<'a> {
    /// The BSDF, in the local frame.
    pub bsdf: Bsdf<'a>,
    /// The frame.
    pub frame: Frame,
    /// How a bump or normal map bent the frame.
    pub(super) bend: Option<Bend>,
}

impl Shading<'_> {
    /// To the local frame.
    #[inline]
    pub fn to_local(&self, w: Vec3) -> Vec3 {
        self.frame.to_local(w)
    }

    /// All lobes there may be.
    #[inline]
    pub fn flags(&self) -> Flags {
        self.bsdf.flags()
    }

    /// The shading normal for a viewer in the direction `viewer`.
    #[inline]
    pub fn normal_for(&self, viewer: Vec3) -> Vec3 {
        self.bend.as_ref().map_or(self.frame.n, |b| b.frame(&self.frame, viewer).n)
    }

    /// Whether all viewers on one side see the same.
    #[inline]
    pub fn is_lambertian(&self) -> bool {
        self.bend.is_none() && self.bsdf.is_lambertian()
    }

    /// Value times the cosine of `wi`, and density per solid angle of `wi`.
    #[inline]
    pub fn eval_cos_pdf(&self, wo: Vec3, wi: Vec3, mode: Mode) -> (Rgb, f32) {
        if let Some(bend) = &self.bend {
            return bend.eval_cos_pdf(&self.bsdf, &self.frame, wo, wi, mode);
        }
        let local = self.to_local(wi);
        let (f, pdf_w) = self.bsdf.eval_pdf(self.to_local(wo), local, mode);
        (f * local.z.abs(), pdf_w)
    }

    /// Draws `wi`: the sample has it in the world.
    #[inline]
    pub fn sample(&self, wo: Vec3, u_lobe: f32, u: Vec2, mode: Mode) -> Option<Sample> {
        if let Some(bend) = &self.bend {
            return bend.sample(&self.bsdf, &self.frame, wo, u_lobe, u, mode);
        }
        let mut sample = self.bsdf.sample(self.to_local(wo), u_lobe, u, mode)?;
        // A straight pass is no matter of frames.
        sample.wi = if sample.flags.contains(Flags::NULL) { -wo } else { self.frame.to_world(sample.wi) };
        Some(sample)
    }
}

impl SurfaceHit {
    /// Unit normal of the surface itself, on the side that its shading normals are on.
    #[inline]
    pub fn n(&self) -> Vec3 {
        self.point.ng
    }

    /// The same on the side that it is seen from.
    #[inline]
    pub fn seen_n(&self) -> Vec3 {
        if self.wo.dot(self.n()) < 0.0 { -self.n() } else { self.n() }
    }
}

impl World {
    /// Where textures are looked up for `hit`.
    pub(crate) fn place(&self, hit: &SurfaceHit) -> Place<'_> {
        let on = match &self.surfaces[hit.surface as usize].form {
            Form::Mesh(mesh) => Some(OnMesh { mesh, face: hit.prim, b: hit.b }),
            Form::Quadric(_) => None,
        };
        Place { uv: hit.uv, on }
    }

    /// Fills in what shading wants.
    pub(crate) fn surface_hit(&self, ray: &Ray, hit: &Hit) -> SurfaceHit {
        self.hit_on(&self.tracer, self.surface_index(hit) as u32, ray, hit)
    }

    /// The same for a `tracer` with shapes of this world, for the surface numbered `index`.
    pub(super) fn hit_on(&self, tracer: &translume_trace::Scene, index: u32, ray: &Ray, hit: &Hit) -> SurfaceHit {
        let surface = &self.surfaces[index as usize];
        let mut point = tracer.surface(ray, hit);
        let b = Vec2::new(hit.u, hit.v);
        let mut local = match &surface.form {
            Form::Mesh(mesh) => on_triangle(mesh, hit.prim, b, mesh_place(mesh, hit.prim, b).uv),
            Form::Quadric(quadric) => {
                let (geometry, object_from_geometry) = &**quadric;
                let own = tracer.object_from_world(hit.instance).transform_point3(point.p.as_dvec3());
                let place = on_quadric(geometry, object_from_geometry.transform_point3(own));
                place.moved(&object_from_geometry.matrix3.inverse().as_mat3())
            }
        };
        if !tracer.is_in_place(hit.instance) {
            local = local.moved(&tracer.instances()[hit.instance as usize].world_from_object.matrix3.as_mat3());
        }
        // The normal proper is on the side of the shading normals, as far as there are any.
        let mut n = match local.normal {
            Some(ns) if ns.dot(point.ng) < 0.0 => -point.ng,
            _ => point.ng,
        };
        let mut ns = local.normal.and_then(Vec3::try_normalize).unwrap_or(n);
        if surface.flip {
            (n, ns) = (-n, -ns);
        }
        point.ng = n;
        // Not where media meet: a path there would lose a part of its way through them.
        if surface.interior.is_none() && surface.exterior.is_none() {
            point.error = point.error.max(Vec3::splat(GAP * (1.0 + point.p.abs().max_element()).min(self.reach)));
        }
        SurfaceHit {
            point,
            frame: Frame::from_normal_tangent(ns, local.dp_du),
            wo: -ray.d.normalize(),
            t: hit.t,
            prim: hit.prim,
            surface: index,
            instance: hit.instance,
            uv: local.uv,
            b,
            dp_du: local.dp_du,
            dp_dv: local.dp_dv,
        }
    }
}

/// Differential geometry in some space.
struct Local {
    uv: Vec2,
    /// Interpolated vertex normal, any length; `None`: the surface's own.
    normal: Option<Vec3>,
    dp_du: Vec3,
    dp_dv: Vec3,
}

impl Local {
    fn moved(self, m: &Mat3) -> Self {
        let normal = self.normal.map(|n| m.inverse().transpose() * n);
        Self { uv: self.uv, normal, dp_du: *m * self.dp_du, dp_dv: *m * self.dp_dv }
    }
}

#[inline]
fn on_triangle(mesh: &TriMesh, face: u32, b: Vec2, uv: Vec2) -> Local {
    let [i, j, k] = mesh.indices[face as usize].map(|i| i as usize);
    let [p0, p1, p2] = mesh.corners(face as usize);
    let (e1, e2) = (p1 - p0, p2 - p0);
    let normal = mesh
        .normals
        .as_ref()
        .map(|n| Vec3::from(n[i]) * (1.0 - b.x - b.y) + Vec3::from(n[j]) * b.x + Vec3::from(n[k]) * b.y);
    let (dp_du, dp_dv) = match &mesh.uvs {
        None => (e1, e2),
        Some(uvs) => {
            let (d1, d2) = (Vec2::from(uvs[j]) - Vec2::from(uvs[i]), Vec2::from(uvs[k]) - Vec2::from(uvs[i]));
            let determinant = d1.perp_dot(d2);
            if determinant == 0.0 {
                (e1, e2)
            } else {
                ((e1 * d2.y - e2 * d1.y) / determinant, (e2 * d1.x - e1 * d2.x) / determinant)
            }
        }
    };
    Local { uv, normal, dp_du, dp_dv }
}

/// `p` is in the quadric's own space.
fn on_quadric(geometry: &Geometry, p: DVec3) -> Local {
    let (uv, dp_du, dp_dv) = match geometry {
        Geometry::Sphere { center, radius } => {
            let out = (p - *center).as_vec3();
            let rho = out.truncate().length().max(1e-12 * *radius as f32);
            let (sin, cos) = (out.y / rho, out.x / rho);
            // v falls with the polar angle.
            let down = -std::f32::consts::PI * Vec3::new(out.z * cos, out.z * sin, -rho);
            (uv_of_sphere(out.as_dvec3().normalize_or(DVec3::Z)), TAU * Vec3::new(-out.y, out.x, 0.0), down)
        }
        Geometry::Cylinder { p0, p1, radius: _ } => {
            let axis = (*p1 - *p0).as_vec3();
            let out = (p - *p0).as_vec3();
            let along = out.dot(axis) / axis.length_squared().max(1e-30);
            let radial = out - axis * along;
            let frame = Frame::from_normal(axis.try_normalize().unwrap_or(Vec3::Z));
            let local = frame.to_local(radial);
            let turn = frame.to_world(Vec3::new(-local.y, local.x, 0.0)) * TAU;
            (Vec2::new(warp::azimuth(local) / TAU, 1.0 - along), turn, -axis)
        }
        Geometry::Disk | Geometry::Mesh(_) => {
            let p = p.as_vec3();
            let r = p.truncate().length();
            let (sin, cos) = if r > 0.0 { (p.y / r, p.x / r) } else { (0.0, 1.0) };
            let uv = Vec2::new(r, 1.0 - warp::azimuth(p) / TAU);
            (uv, Vec3::new(cos, sin, 0.0), -TAU * Vec3::new(-p.y, p.x, 0.0))
        }
    };
    Local { uv, normal: None, dp_du, dp_dv }
}
