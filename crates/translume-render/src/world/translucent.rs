//! Translucent objects in a world: from the point that is seen to points where the light may have gone in.
//!
//! The estimate is of ∫ R_d(x_i → x_o) E(x_i) dA(x_i) over one shape. Points are drawn in two ways: by probe lines along three
//! axes through a disc of distances around x_o that the model proposes (King, Kulla, Conty & Fajardo 2013, "BSSRDF Importance
//! Sampling"), half of them along the normal and a quarter along each tangent; and uniformly over the area of the shape (meshes
//! only), since measured models join places that no short disc does. One technique is used at a time; the density is that of
//! all of them together, per area of the surface in mm²:
//!
//! p(x) = (1 − u) Σ_a w_a p_disc(r_a) |n·a| + u/A,   r_a the distance of x from the line through x_o along a.
//!
//! A line has as many points as it meets the shape; of those one is kept by chance, in proportion to R_d/p, with the sum of
//! all as its weight. Deviation from King et al.: lines do not end at a sphere around x_o, so no light is lost however
//! curved the object is.

use super::hit::SurfaceHit;
use super::{Shading, World};
use crate::material::Prepared;
use crate::{Error, Result, Rgb};
use glam::{DAffine3, Vec2, Vec3};
use std::sync::Arc;
use translume_bxdf::bssrdf::{Bssrdf, Radii, Site};
use translume_bxdf::{Entrance, Skin};
use translume_core::distribution::AliasTable;
use translume_core::frame::Frame;
use translume_core::sampler::Sampler;
use translume_core::warp;
use translume_mesh::TriMesh;
use translume_scene::MaterialId;
use translume_scene::material::{Model, Subsurface};
use translume_trace::{self as trace, Ray, SurfacePoint};

/// A translucent shape in its place.
pub(crate) struct Translucent {
    model: Arc<dyn Bssrdf>,
    /// The shape alone.
    tracer: trace::Scene,
    /// Its number among the surfaces.
    surface: u32,
    /// The triangles of a mesh, as they are in `tracer`, and its area in mm².
    mesh: Option<(Arc<TriMesh>, AliasTable, f32)>,
    /// From the world to the model.
    mm_from_world: DAffine3,
    /// Length of a unit of the world in mm.
    mm: f32,
    /// A sphere around the shape.
    center: Vec3,
    radius: f32,
}

/// Where light went in that comes out at a point, and what of it does: R_d over the density of the place.
pub struct Entry<'a> {
    /// The place; `wo` is its normal.
    pub hit: SurfaceHit,
    /// What the boundary does there.
    pub shading: Shading<'a>,
    /// R_d/p.
    pub weight: Rgb,
}

/// Shares of the axes: normal, tangent, bitangent.
const AXES: [f32; 3] = [0.5, 0.25, 0.25];
/// Share of points that are uniform over the area.
const UNIFORM: f32 = 0.125;
/// Crossings of a line with the shape that are looked at.
const MOST_CROSSINGS: usize = 256;

/// A candidate for x_i.
struct Candidate {
    ray: Ray,
    hit: trace::Hit,
    /// R_d/p.
    weight: Rgb,
}

impl Translucent {
    /// Prepares the shape `geometry`, which stands under `world_from_geometry` and whose own space is seen from the world
    /// by `object_from_world`.
    pub(super) fn new(
        material: &Subsurface,
        geometry: Arc<trace::Geometry>,
        world_from_geometry: DAffine3,
        object_from_world: DAffine3,
        surface: u32,
    ) -> Result<Self> {
        let scale = DAffine3::from_scale(glam::DVec3::splat(material.mm_per_unit));
        let mm_from_world = if material.in_object_space { scale * object_from_world } else { scale };
        let mm = super::build::similarity(&mm_from_world).ok_or_else(|| {
            Error::Scene(
                "a captured translucent object is stretched: it can only be moved, turned and scaled evenly".into(),
            )
        })?;
        let mm_from_geometry = mm_from_world * world_from_geometry;
        let whole = match &geometry.shapes()[0] {
            trace::Shape::Mesh(mesh) => Some(mesh.clone()),
            _ => None,
        };
        let corners = |face: usize| match &whole {
            Some(mesh) => mesh.corners(face).map(|p| mm_from_geometry.transform_point3(p.as_dvec3()).as_vec3()),
            None => [Vec3::ZERO; 3],
        };
        let faces = whole.as_ref().map_or(0, |m| m.indices.len());
        material.model.fits(faces, &corners).map_err(Error::Scene)?;
        let areas: Vec<f32> = (0..faces)
            .map(|face| {
                let [a, b, c] = corners(face);
                0.5 * (b - a).cross(c - a).length()
            })
            .collect();
        let total: f64 = areas.iter().copied().map(f64::from).sum();
        let mesh = whole.and_then(|mesh| Some((mesh, AliasTable::new(&areas)?, total as f32)));
        let tracer = trace::Scene::new(vec![trace::Instance { geometry, world_from_object: world_from_geometry }])?;
        let bounds = tracer.bounds();
        let (center, radius) = (bounds.center(), 0.51 * bounds.extent().length());
        let model = material.model.clone();
        Ok(Self { model, tracer, surface, mesh, mm_from_world, mm: mm as f32, center, radius })
    }

    /// About the reflected fraction, for choosing among lobes.
    pub(crate) fn albedo(&self, hit: &SurfaceHit) -> Rgb {
        self.model.total(&self.site(hit.point.p, hit.prim)).clamp(Rgb::ZERO, Rgb::ONE)
    }

    /// The place in the model's space.
    fn site(&self, p: Vec3, face: u32) -> Site {
        let p = self.mm_from_world.transform_point3(p.as_dvec3()).as_vec3();
        let uv = match &self.mesh {
            None => Vec2::ZERO,
            Some((mesh, ..)) => {
                let to_mm = self.mm_from_world * self.tracer.instances()[0].world_from_object;
                let [a, b, c] = mesh.corners(face as usize).map(|v| to_mm.transform_point3(v.as_dvec3()).as_vec3());
                barycentric(p, a, b, c)
            }
        };
        Site { p, face, uv }
    }

    /// Density of all techniques together at a point, per mm².
    fn pdf_a(&self, radii: &Radii, origin: Vec3, axes: &[Vec3; 3], point: &SurfacePoint) -> f32 {
        let away = (point.p - origin) * self.mm;
        let by_axis = |(axis, share): (&Vec3, f32)| {
            let along = away.dot(*axis);
            let r = (away - *axis * along).length();
            share * radii.pdf_a(r) * point.ng.dot(*axis).abs()
        };
        let probes: f32 = axes.iter().zip(AXES).map(by_axis).sum();
        match &self.mesh {
            Some((.., area)) => (1.0 - UNIFORM) * probes + UNIFORM / area,
            None => probes,
        }
    }

    /// Draws x_i for the x_o at `hit`.
    fn sample(&self, hit: &SurfaceHit, sampler: &mut impl Sampler) -> Option<Candidate> {
        let (origin, to) = (hit.point.p, self.site(hit.point.p, hit.prim));
        let radii = self.model.radii(&to);
        let frame = Frame::from_normal(hit.point.ng);
        let axes = [frame.n, frame.to_world(Vec3::X), frame.to_world(Vec3::Y)];
        let (mut u, place) = (sampler.next_1d(), sampler.next_2d());
        let weigh = |point: &SurfacePoint, face: u32| {
            let value = self.model.eval(&self.site(point.p, face), &to);
            value / self.pdf_a(&radii, origin, &axes, point).max(f32::MIN_POSITIVE)
        };
        if let Some((_, table, _)) = &self.mesh {
            if u < UNIFORM {
                let (face, _) = table.sample(u / UNIFORM);
                let b = warp::uniform_triangle(place.x, place.y);
                let hit = trace::Hit { t: 0.0, u: b.x, v: b.y, prim: face as u32, part: 0, instance: 0 };
                let ray = Ray::new(origin, axes[0]); // a point of a triangle needs none
                let point = self.tracer.surface(&ray, &hit);
                return Some(Candidate { ray, hit, weight: weigh(&point, hit.prim) });
            }
            u = (u - UNIFORM) / (1.0 - UNIFORM);
        }
        let (axis, u) = match u {
            u if u < AXES[0] => (0, u / AXES[0]),
            u if u < AXES[0] + AXES[1] => (1, (u - AXES[0]) / AXES[1]),
            u => (2, (u - AXES[0] - AXES[1]) / AXES[2]),
        };
        let r = radii.sample(Vec2::new(u.min(warp::ONE_MINUS_EPSILON), place.x)) / self.mm;
        let (sin, cos) = (std::f32::consts::TAU * place.y).sin_cos();
        let (across, beside) = (axes[(axis + 1) % 3], axes[(axis + 2) % 3]);
        self.probe(origin + (across * cos + beside * sin) * r, axes[axis], weigh, sampler)
    }

    /// Everything on the line through `p` along `axis`, one point of it kept.
    fn probe(
        &self,
        p: Vec3,
        axis: Vec3,
        weigh: impl Fn(&SurfacePoint, u32) -> Rgb,
        sampler: &mut impl Sampler,
    ) -> Option<Candidate> {
        let middle = (self.center - p).dot(axis);
        let aside = (self.center - p - axis * middle).length_squared();
        let half = (self.radius * self.radius - aside).max(0.0).sqrt();
        if half == 0.0 {
            return None;
        }
        let mut ray = Ray::new(p + axis * (middle - 1.01 * half), axis);
        let (mut kept, mut sum): (Option<Candidate>, f32) = (None, 0.0);
        for _ in 0..MOST_CROSSINGS {
            let Some(hit) = self.tracer.intersect(&ray) else { break };
            let point = self.tracer.surface(&ray, &hit);
            let weight = weigh(&point, hit.prim);
            let size = weight.element_sum();
            if size > 0.0 {
                sum += size;
                if sampler.next_1d() * sum < size {
                    kept = Some(Candidate { ray, hit, weight });
                }
            }
            ray = Ray::new(point.origin_towards(axis), axis);
        }
        kept.map(|c| Candidate { weight: c.weight * (sum / c.weight.element_sum()), ..c })
    }
}

/// Barycentric coordinates of the second and third corner at the point of the triangle's plane nearest to `p`.
fn barycentric(p: Vec3, a: Vec3, b: Vec3, c: Vec3) -> Vec2 {
    let (e1, e2, d) = ((b - a).as_dvec3(), (c - a).as_dvec3(), (p - a).as_dvec3());
    let n = e1.cross(e2);
    let square = n.length_squared();
    if square <= 0.0 {
        return Vec2::ZERO;
    }
    let (u, v) = (d.cross(e2).dot(n) / square, e1.cross(d).dot(n) / square);
    let (u, v) = (u.clamp(0.0, 1.0), v.clamp(0.0, 1.0));
    let over = (u + v).max(1.0);
    Vec2::new((u / over) as f32, (v / over) as f32)
}

impl World {
    /// Whether light goes under any surface.
    pub fn has_subsurface(&self) -> bool {
        !self.translucent.is_empty()
    }

    /// The translucent shape at `hit`.
    pub(crate) fn translucent(&self, hit: &SurfaceHit) -> Option<&Translucent> {
        if self.translucent.is_empty() {
            return None;
        }
        self.translucent.get(&(hit.instance, hit.surface))
    }

    /// Where the light may have entered that leaves at `hit`, for a sample that goes under its surface.
    pub fn entry(&self, hit: &SurfaceHit, sampler: &mut impl Sampler) -> Option<Entry<'_>> {
        let object = self.translucent(hit)?;
        let found = object.sample(hit, sampler)?;
        if !(found.weight.is_finite() && found.weight.max_element() > 0.0) {
            return None;
        }
        let mut entered = self.hit_on(&object.tracer, object.surface, &found.ray, &found.hit);
        // Light comes from the same side of the surface as the eye.
        let behind = hit.wo.dot(hit.n()) < 0.0;
        if behind {
            entered.frame.n = -entered.frame.n;
        }
        entered.wo = entered.frame.n;
        entered.instance = hit.instance;
        let skin = self.skin(self.surfaces[object.surface as usize].subsurface?)?;
        let bsdf = Entrance { eta: skin.eta, coat: skin.coat }.into();
        let shading = Shading { bsdf, frame: entered.frame, bend: None };
        Some(Entry { hit: entered, shading, weight: found.weight })
    }

    /// The boundary of a subsurface material, white.
    pub(super) fn skin(&self, id: MaterialId) -> Option<Skin<'_>> {
        let Model::Subsurface(s) = &self.scene.materials[id.0].model else { return None };
        let coat = match &self.prepared[id.0] {
            Prepared::Coat(coat) => Some(&**coat),
            _ => None,
        };
        Some(Skin { eta: s.eta, coat, specular_reflectance: Rgb::ONE, albedo: Rgb::ONE })
    }
}
