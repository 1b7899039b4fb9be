//! Sub-paths from the camera and from the lights: random walks whose vertices are kept, with the densities of both ways.
//!
//! Source: Veach 1997, chapters 5 (adjoint scattering, shading normals) and 10 (densities of both ways).
//!
//! Every surface that a walk meets becomes a [`Vertex`]. What lets the light straight through (masks, thin glass, null
//! interfaces) does not break a segment: a walk that passes such a vertex goes on from the vertex before, so that vertices
//! form chains by [`Vertex::parent`], and densities are those of the directions alone, as if the surface were not there; its
//! chance of letting pass is in the throughput. Connections see through the same surfaces.
//!
//! The scattering function is at both kinds of vertices the one that the camera's paths see (light's cosine by the
//! shading normal, whatever bends or cuts it): [`scattering`] turns it into f in the measure of the surface's own normal,
//! which is Veach's correction of the adjoint (his equation 5.19).
//!
//! Densities are those of the walks without Russian roulette; weights made of them sum to one all the same. At delta
//! vertices densities of both directions count as if the deltas cancelled: from the camera's side 1, from the light's side
//! the ratio of the solid angles that the interface maps onto each other.

use crate::light::{LightPoint, LightStart, Starts};
use crate::world::{Shading, SurfaceHit, World};
use crate::{PathSampler, Rgb};
use glam::Vec3;
use translume_bxdf::{Flags, Mode};
use translume_core::sampler::Sampler;
use translume_trace::Ray;

/// No vertex before this one: the parent is the light's or the camera's point.
pub const NONE: u32 = u32::MAX;

/// A place where a walk met a surface.
#[derive(Clone, Copy, Debug)]
pub struct Vertex {
    /// The surface; `wo` points back to where the walk came from.
    pub hit: SurfaceHit,
    /// What the walk brings here, over its density, scattering at this vertex excluded: of light paths a flux, of camera
    /// paths the factor on radiance.
    pub throughput: Rgb,
    /// Density per area of this vertex, given those before (of the camera's first: per pixel area of the film).
    pub pdf: f32,
    /// Density per area of this vertex by a walk from the other end, given those after; 0 until the walk has gone on.
    pub pdf_back: f32,
    /// The vertex before in the vector that the walk filled; [`NONE`] for the first.
    pub parent: u32,
    /// Segments of the walk up to here; straight passes count.
    pub segments: u32,
    /// Chance with which roulette let the walk come here from the parent.
    pub survival: f32,
    /// Chance with which the surfaces in between let it pass straight.
    pub passed: f32,
    /// The walk went on in a direction that has no density.
    pub delta: bool,
}

/// Where a walk left the scene.
#[derive(Clone, Copy, Debug)]
pub struct Escape {
    /// The direction.
    pub d: Vec3,
    /// As of a vertex.
    pub throughput: Rgb,
    /// Density of the direction per solid angle.
    pub pdf_w: f32,
    /// The last vertex.
    pub parent: u32,
    /// Segments, the last included.
    pub segments: u32,
}

/// How directions lead to places.
#[derive(Clone, Copy, Debug)]
pub enum Density {
    /// From a point, per solid angle.
    Angle {
        /// The point.
        from: Vec3,
        /// The density.
        pdf_w: f32,
    },
    /// Along parallel rays, per area perpendicular to them.
    Parallel(f32),
}

impl Density {
    /// What follows the begin `point` of a light path, by the second density of [`crate::light::Lights::pdf_start`].
    #[inline]
    pub fn from_light(point: &LightPoint, next: f32) -> Self {
        if point.far { Self::Parallel(next) } else { Self::Angle { from: point.p, pdf_w: next } }
    }

    /// Density per area at the place `p` with normal `n` that is reached along `d`.
    #[inline]
    pub fn at(&self, p: Vec3, n: Vec3, d: Vec3) -> f32 {
        match *self {
            Self::Angle { from, pdf_w } => pdf_w * n.dot(d).abs() / (p - from).length_squared(),
            Self::Parallel(pdf) => pdf * n.dot(d).abs(),
        }
    }
}

/// How far walks go.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Most segments.
    pub segments: u32,
    /// Segments before Russian roulette begins.
    pub rr_depth: u32,
}

/// A light sub-path: where it begins; its vertices lie in the vector that was filled.
#[derive(Clone, Copy, Debug)]
pub struct LightPath {
    /// The begin.
    pub start: LightStart,
    /// Density with which a walk from the camera finds the begin, given the first two vertices: in the measure of
    /// [`LightStart::pdf_begin`].
    pub pdf_back: f32,
}

/// Scattering between two directions at a vertex.
#[derive(Clone, Copy, Debug)]
pub struct Scattering {
    /// f in the measure of the surface's own normal: f |cos θ_light, shading| / |cos θ_light, surface|.
    pub f: Rgb,
    /// Density per solid angle of a walk from the camera to choose the light's direction.
    pub pdf_to_light: f32,
    /// Density per solid angle of a walk from the light to choose the camera's direction.
    pub pdf_to_camera: f32,
}

/// Scattering at `hit` of light from `to_light` to `to_camera`, both pointing away; `shading` is that of `hit` itself. `None`:
/// there is none.
#[inline]
pub fn scattering(
    world: &World,
    hit: &SurfaceHit,
    shading: &Shading,
    to_light: Vec3,
    to_camera: Vec3,
) -> Option<Scattering> {
    let seen = world.shading_from(hit, shading, to_camera);
    let (f_cos, pdf_to_light) = seen.eval_cos_pdf(to_camera, to_light, Mode::Radiance);
    let cos = hit.n().dot(to_light).abs();
    if f_cos == Rgb::ZERO || cos <= 0.0 {
        return None;
    }
    let lit = world.shading_from(hit, shading, to_light);
    let (_, pdf_to_camera) = lit.eval_cos_pdf(to_light, to_camera, Mode::Importance);
    Some(Scattering { f: f_cos / cos, pdf_to_light, pdf_to_camera })
}

/// Segments after which any walk ends: only closed mirrors that lose nothing come here.
pub const MOST_SEGMENTS: u32 = 1000;

/// A random walk.
pub struct Walk<'a> {
    /// Through this.
    pub world: &'a World,
    /// [`Mode::Importance`] for light paths.
    pub mode: Mode,
    /// How far.
    pub limits: Limits,
    /// The first ray does not see lights.
    pub hide_lights: bool,
}

/// A walk that is under way.
pub struct PathState {
    /// Factor so far.
    throughput: Rgb,
    segments: u32,
    stage: Stage,
    ray: Ray,
    /// The throughput since the walk began, without refraction's change of radiance: for roulette.
    loss: Rgb,
    eta: f32,
    density: Density,
    parent: u32,
    survival: f32,
    passed: f32,
    /// Density of finding the begin from the other side.
    start_back: f32,
}

/// What comes next.
#[derive(PartialEq)]
enum Stage {
    /// A ray.
    Fly,
    /// The scattering at the last vertex.
    Scatter,
    Ended,
}

/// One scattering of a walk.
struct Step {
    wi: Vec3,
    weight: Rgb,
    eta: f32,
    /// Densities per solid angle: onward, and of a walk from the other side towards where this one came from.
    pdf_w: f32,
    pdf_back_w: f32,
    delta: bool,
}

impl PathState {
    /// Along a ray, with the factor and the density that it begins with.
    pub fn new((ray, throughput, density): (Ray, Rgb, Density)) -> Self {
        Self {
            throughput,
            segments: 0,
            stage: Stage::Fly,
            ray,
            loss: Rgb::ONE,
            eta: 1.0,
            density,
            parent: NONE,
            survival: 1.0,
            passed: 1.0,
            start_back: 0.0,
        }
    }

    /// Goes on with this factor as if it had begun here: roulette forgets what was lost before.
    pub fn begin_anew(&mut self, throughput: Rgb) {
        (self.throughput, self.loss, self.eta) = (throughput, Rgb::ONE, 1.0);
    }

    /// That goes nowhere.
    pub fn end(&mut self) {
        self.stage = Stage::Ended;
    }

    fn arrive(&self, hit: SurfaceHit) -> Vertex {
        Vertex {
            hit,
            throughput: self.throughput,
            pdf: self.density.at(hit.point.p, hit.n(), hit.wo),
            pdf_back: 0.0,
            parent: self.parent,
            segments: self.segments,
            survival: self.survival,
            passed: self.passed,
            delta: false,
        }
    }
}

impl Walk<'_> {
    /// Follows `ray` and appends what it meets to `out`. `start` is the light's point, for the density that is returned
    /// second: that of finding it from the other side.
    pub fn run(
        &self,
        begin: (Ray, Rgb, Density),
        start: Option<&LightPoint>,
        sampler: &mut PathSampler,
        rays: &mut u64,
        out: &mut Vec<Vertex>,
    ) -> (Option<Escape>, f32) {
        let mut going = PathState::new(begin);
        let escape = self.follow(&mut going, usize::MAX, start, sampler, rays, out);
        (escape, going.start_back)
    }

    /// Goes on until `out` has this many vertices; the walk has not scattered at the last one yet.
    pub fn follow(
        &self,
        s: &mut PathState,
        vertices: usize,
        start: Option<&LightPoint>,
        sampler: &mut PathSampler,
        rays: &mut u64,
        out: &mut Vec<Vertex>,
    ) -> Option<Escape> {
        while s.stage == Stage::Scatter || s.stage == Stage::Fly && s.segments < self.limits.segments {
            if s.stage == Stage::Fly {
                s.segments += 1;
                *rays += 1;
                let hidden = s.segments == 1 && self.hide_lights;
                let found =
                    if hidden { self.world.intersect_behind_lights(&s.ray) } else { self.world.intersect(&s.ray) };
                let Some(hit) = found else {
                    s.stage = Stage::Ended;
                    let pdf_w = if let Density::Angle { pdf_w, .. } = s.density { pdf_w } else { 0.0 };
                    let (throughput, parent, segments) = (s.throughput, s.parent, s.segments);
                    return Some(Escape { d: s.ray.d, throughput, pdf_w, parent, segments });
                };
                out.push(s.arrive(hit));
                s.stage = if s.segments >= self.limits.segments { Stage::Ended } else { Stage::Scatter };
                if out.len() >= vertices {
                    break;
                }
            }
            if s.stage == Stage::Scatter {
                let goes_on = self.scatter(s, start, sampler, out) && self.survives(s, sampler);
                s.stage = if goes_on { Stage::Fly } else { Stage::Ended };
            }
        }
        None
    }

    /// Scatters at the last vertex of `out`; whether the walk can go on.
    fn scatter(
        &self,
        s: &mut PathState,
        start: Option<&LightPoint>,
        sampler: &mut PathSampler,
        out: &mut Vec<Vertex>,
    ) -> bool {
        let index = out.len() - 1;
        let hit = out[index].hit;
        let shading = self.world.shading(&hit);
        let Some(sample) = shading.sample(hit.wo, sampler.next_1d(), sampler.next_2d(), self.mode) else {
            return false;
        };
        if sample.flags.contains(Flags::NULL) {
            if !shading.flags().has_smooth() && !self.world.is_light(&hit) {
                out.pop();
            }
            s.ray = hit.point.spawn(sample.wi);
            s.throughput *= sample.weight;
            s.loss *= sample.weight;
            s.passed *= sample.pdf_w;
            return true;
        }
        let Some(step) = self.step(&hit, &shading, &sample) else { return false };
        out[index].delta = step.delta;
        let back = Density::Angle { from: hit.point.p, pdf_w: step.pdf_back_w };
        match out.get_mut(s.parent as usize) {
            Some(parent) => parent.pdf_back = back.at(parent.hit.point.p, parent.hit.n(), hit.wo),
            None => {
                s.start_back =
                    start.map_or(0.0, |q| q.from_solid_angle(step.pdf_back_w, hit.wo, (q.p - hit.point.p).length()));
            }
        }
        s.ray = hit.point.spawn(step.wi);
        s.throughput *= step.weight;
        s.loss *= step.weight;
        s.eta *= step.eta;
        s.density = Density::Angle { from: hit.point.p, pdf_w: step.pdf_w };
        s.parent = index as u32;
        (s.survival, s.passed) = (1.0, 1.0);
        true
    }

    /// The scattering that was drawn, with its densities.
    fn step(&self, hit: &SurfaceHit, shading: &Shading, sample: &translume_bxdf::Sample) -> Option<Step> {
        let (wo, wi) = (hit.wo, sample.wi);
        let (to_light, to_camera) = if self.mode == Mode::Radiance { (wi, wo) } else { (wo, wi) };
        let cosines = |n: Vec3| (n.dot(to_light).abs(), n.dot(to_camera).abs());
        let (light, camera) = cosines(hit.n());
        if sample.flags.contains(Flags::DELTA) {
            let (light_s, camera_s) = cosines(shading.normal_for(to_camera));
            // n² |cos θ| dω is the same on both sides of an interface.
            let eta2 = sample.eta * sample.eta;
            let (weight, ratio) = match self.mode {
                Mode::Radiance => (sample.weight, camera_s / (light_s * eta2)),
                Mode::Importance => {
                    (sample.weight * (light_s * camera / (light * camera_s)), eta2 * camera_s / light_s)
                }
            };
            let (pdf_w, pdf_back_w) = if self.mode == Mode::Radiance { (1.0, ratio) } else { (ratio, 1.0) };
            let usable = weight.is_finite() && ratio.is_finite() && ratio > 0.0;
            let eta = if self.mode == Mode::Radiance { sample.eta } else { 1.0 };
            return usable.then_some(Step { wi, weight, eta, pdf_w, pdf_back_w, delta: true });
        }
        let both = scattering(self.world, hit, shading, to_light, to_camera)?;
        let (weight, pdf_back_w, eta) = match self.mode {
            Mode::Radiance => (sample.weight, both.pdf_to_camera, sample.eta),
            Mode::Importance => (both.f * (camera / sample.pdf_w), both.pdf_to_light, 1.0),
        };
        let usable = sample.pdf_w > 0.0 && weight.is_finite();
        usable.then_some(Step { wi, weight, eta, pdf_w: sample.pdf_w, pdf_back_w, delta: false })
    }

    fn survives(&self, s: &mut PathState, sampler: &mut PathSampler) -> bool {
        if s.loss.max_element() <= 0.0 {
            return false;
        }
        if s.segments >= self.limits.rr_depth {
            let survival = crate::integrator::survival(s.loss, s.eta, crate::integrator::MOST_SURVIVAL);
            if sampler.next_1d() >= survival {
                return false;
            }
            s.throughput /= survival;
            s.loss /= survival;
            s.survival *= survival;
        }
        true
    }
}

/// Draws a light sub-path from the lights of `starts`; its vertices are appended to `out`, whose parents count from the vector's begin.
pub fn light_path(
    world: &World,
    starts: &Starts,
    limits: Limits,
    sampler: &mut PathSampler,
    rays: &mut u64,
    out: &mut Vec<Vertex>,
) -> Option<LightPath> {
    let (choice, u, v) = (sampler.next_1d(), sampler.next_2d(), sampler.next_2d());
    let start = world.lights().start(world.scene(), starts, choice, u, v)?;
    let point = start.point();
    let density = Density::from_light(&point, start.pdf_next());
    let walk = Walk { world, mode: Mode::Importance, limits, hide_lights: false };
    let (_, pdf_back) = walk.run((start.ray(), start.throughput(), density), Some(&point), sampler, rays, out);
    Some(LightPath { start, pdf_back })
}
