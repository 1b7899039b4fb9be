//! Light paths of a step: their vertices with footprints.
//!
//! Source: Bekaert et al. 2003, §3 (eq. 7) and §5; errata: p of eq. 7 is per area, R is capped by the distance to the
//! parent, the chance of Russian roulette belongs to the density of a direction. Every vertex says whether a link to its
//! parent may be made (the parent scatters in more than single directions) and whether the surface around it is flat as
//! far as such links reach, which is what the disc of §3 takes for granted.

use super::weight::Weighing;
use crate::light::{End, LightPoint, LightStart};
use crate::subpath::{self, Density, LightPath, Limits, NONE, Vertex};
use crate::world::{SurfaceHit, World};
use crate::{PathSampler, Rgb, luminance};
use glam::Vec3;
use rayon::prelude::*;
use std::f32::consts::FRAC_PI_2;
use translume_core::frame::Frame;
use translume_trace::Ray;

/// How footprints grow.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bandwidth {
    /// The paper's h: of vertices that come straight from lights, and of all others.
    pub(crate) h: [f32; 2],
    /// Footprints grow along the path.
    pub(crate) grow: bool,
    /// Largest radius over the distance to the parent.
    pub(crate) share: f32,
    /// Largest radius.
    pub(crate) most: f32,
}

impl Bandwidth {
    /// Eq. 7: of a vertex of density `pdf` per area, `distance` from a parent with the footprint `before` (`None`: a light).
    #[inline]
    pub(crate) fn radius(&self, pdf: f32, distance: f32, before: Option<f32>) -> f32 {
        let own = self.h[usize::from(before.is_some())] / pdf.sqrt();
        let grown = if self.grow { own + before.unwrap_or(0.0) } else { own };
        grown.min(self.share * distance).min(self.most)
    }
}

/// Where a light path met a surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LightVertex {
    pub(crate) hit: SurfaceHit,
    /// Flux that arrives, over the density of the path.
    pub(crate) throughput: Rgb,
    /// Density per area, given the parent.
    pub(crate) pdf: f32,
    /// The footprint's.
    pub(crate) radius: f32,
    /// Number of the vertex before, or of the begin ([`LightVertex::first`]).
    pub(crate) parent: u32,
    /// Chance with which roulette let the path come here from the parent.
    pub(crate) survival: f32,
    /// Weights of merging farther up the path, see [`Weighing`].
    pub(crate) behind: f32,
    /// Density of the parent by a walk from here over that of the light's walk, per density of the direction.
    pub(crate) back: f32,
    pub(crate) segments: u16,
    flags: u8,
}

// Millions of them are kept at once.
const _: () = assert!(size_of::<LightVertex>() <= 200);

const FIRST: u8 = 1;
const LINKED: u8 = 2;
const FLAT: u8 = 4;

impl LightVertex {
    /// The parent is a light.
    #[inline]
    pub(crate) fn first(&self) -> bool {
        self.flags & FIRST != 0
    }

    /// Links to the parent can be made.
    #[inline]
    pub(crate) fn linked(&self) -> bool {
        self.flags & LINKED != 0
    }

    /// The surface is flat as far as points that link here would also link to neighbours.
    #[inline]
    pub(crate) fn flat(&self) -> bool {
        self.flags & FLAT != 0
    }

    /// cos θ at this vertex towards the parent.
    #[inline]
    pub(crate) fn cos(&self) -> f32 {
        self.hit.n().dot(self.hit.wo).abs()
    }
}

/// All light paths of a step.
#[derive(Default)]
pub(crate) struct LightPaths {
    /// Paths that were tried.
    pub(crate) count: u32,
    pub(crate) starts: Vec<LightStart>,
    pub(crate) vertices: Vec<LightVertex>,
    pub(crate) rays: u64,
}

/// What is asked for.
pub(crate) struct Request<'a> {
    pub(crate) world: &'a World,
    pub(crate) limits: Limits,
    pub(crate) bandwidth: Bandwidth,
    pub(crate) weighing: Weighing,
    /// Of the random numbers, and the stream: the step.
    pub(crate) seed: u64,
    pub(crate) step: u64,
    pub(crate) count: u32,
    /// Find out where surfaces are flat; if not, all are taken for it.
    pub(crate) probe: bool,
}

/// Paths that one task traces.
const CHUNK: u32 = 512;

/// Streams of light paths, apart from those of pixels.
const STREAM: u64 = 1 << 63;

impl LightPaths {
    /// Traces them, in an order that does not depend on threads.
    pub(crate) fn trace(request: &Request) -> Self {
        let chunks: Vec<Self> = (0..request.count.div_ceil(CHUNK))
            .into_par_iter()
            .map(|c| {
                let mut own = Self::default();
                let mut buffer = Vec::new();
                (c * CHUNK..((c + 1) * CHUNK).min(request.count)).for_each(|i| own.add(request, i, &mut buffer));
                own
            })
            .collect();
        let mut all = Self { count: request.count, ..Self::default() };
        for chunk in chunks {
            let (starts, vertices) = (all.starts.len() as u32, all.vertices.len() as u32);
            all.starts.extend(chunk.starts);
            all.vertices.extend(chunk.vertices.into_iter().map(|v| {
                let first = if v.first() { starts } else { vertices };
                LightVertex { parent: v.parent + first, ..v }
            }));
            all.rays += chunk.rays;
        }
        all
    }

    fn add(&mut self, request: &Request, path: u32, buffer: &mut Vec<Vertex>) {
        // One path after the other of a low-discrepancy sequence, another sequence for each step.
        let mut sampler = PathSampler::new(request.seed, STREAM | request.step, path.into());
        buffer.clear();
        let Some(light) = subpath::light_path(request.world, request.limits, &mut sampler, &mut self.rays, buffer)
        else {
            return;
        };
        self.starts.push(light.start);
        let base = self.vertices.len();
        for i in 0..buffer.len() {
            let vertex = self.vertex(request, &light, buffer, base, i);
            self.vertices.push(vertex);
            if !request.probe || vertex.linked() && self.is_flat(request.world, &vertex) {
                self.vertices[base + i].flags |= FLAT;
            }
        }
    }

    fn vertex(&self, request: &Request, light: &LightPath, path: &[Vertex], base: usize, i: usize) -> LightVertex {
        let v = &path[i];
        let parent = path.get(v.parent as usize);
        let (p, wo) = (v.hit.point.p, v.hit.wo);
        let point = light.start.point();
        let (distance, before, back) = match parent {
            Some(parent) => {
                let one = Density::Angle { from: p, pdf_w: 1.0 }.at(parent.hit.point.p, parent.hit.n(), wo);
                let before = self.vertices[base + v.parent as usize].radius;
                ((p - parent.hit.point.p).length(), Some(before), one / parent.pdf)
            }
            None => {
                let distance = if point.far { f32::INFINITY } else { (p - point.p).length() };
                (distance, None, point.from_solid_angle(1.0, wo, distance) / light.start.pdf_begin())
            }
        };
        let behind = match parent {
            None => request.weighing.of_light(light.start.delta),
            Some(parent) => {
                let above = path.get(parent.parent as usize);
                let ratio = match above {
                    Some(above) => above.pdf_back / above.pdf,
                    None => light.pdf_back / light.start.pdf_begin(),
                };
                let open = !parent.delta && above.is_none_or(|a| !a.delta);
                let inner = self.vertices[base + v.parent as usize].behind;
                request.weighing.add(open, parent.pdf, ratio, inner)
            }
        };
        let delta = parent.is_some_and(|p| p.delta);
        let linked = !delta && v.pdf > 0.0 && v.survival > 0.0;
        // A mirror passes the footprint on as it is.
        let radius = if delta { before.unwrap_or(0.0) } else { request.bandwidth.radius(v.pdf, distance, before) };
        LightVertex {
            hit: v.hit,
            throughput: v.throughput,
            pdf: v.pdf,
            radius,
            parent: if v.parent == NONE { self.starts.len() as u32 - 1 } else { base as u32 + v.parent },
            survival: v.survival,
            behind,
            back,
            segments: v.segments.min(u16::MAX.into()) as u16,
            flags: if v.parent == NONE { FIRST } else { 0 } | if linked { LINKED } else { 0 },
        }
    }

    /// The ray from the parent of `v` through a point beside `v`.
    #[inline]
    pub(crate) fn ray_beside(&self, world: &World, v: &LightVertex, q: Vec3) -> Ray {
        if !v.first() {
            let from = &self.vertices[v.parent as usize].hit.point;
            return from.spawn((q - from.p).normalize_or(-v.hit.wo));
        }
        let start = &self.starts[v.parent as usize];
        match &start.origin {
            End::Surface(from) => from.spawn((q - from.p).normalize_or(-v.hit.wo)),
            End::Point(from) => Ray::new(*from, (q - *from).normalize_or(-v.hit.wo)),
            End::Far => Ray::new(q - start.direction * (4.0 * world.bounding_sphere().1), start.direction),
        }
    }

    /// Whether the parent of `v` sees the plane of `v` all around it, twice as far as the footprint.
    fn is_flat(&mut self, world: &World, v: &LightVertex) -> bool {
        let frame = Frame::from_normal(v.hit.n());
        (0..PROBES).all(|i| {
            let turn = (i as f32 + 0.5) * (4.0 * FRAC_PI_2 / PROBES as f32);
            let away = frame.to_world(Vec3::new(turn.cos(), turn.sin(), 0.0) * (2.0 * v.radius));
            let ray = self.ray_beside(world, v, v.hit.point.p + away);
            self.rays += 1;
            let Some((point, _)) = world.arrive(&ray) else { return false };
            let off = point.p - v.hit.point.p;
            off.dot(v.hit.n()).abs() <= 0.05 * v.radius && (off - away).length_squared() <= (0.5 * v.radius).powi(2)
        })
    }

    /// Gives all vertices the footprints of another bandwidth.
    pub(crate) fn refit(&mut self, bandwidth: &Bandwidth) {
        for i in 0..self.vertices.len() {
            let v = &self.vertices[i];
            let (distance, before) = if v.first() {
                let point = self.point(v);
                (if point.far { f32::INFINITY } else { (v.hit.point.p - point.p).length() }, None)
            } else {
                let parent = &self.vertices[v.parent as usize];
                ((v.hit.point.p - parent.hit.point.p).length(), Some(parent.radius))
            };
            self.vertices[i].radius =
                if v.linked() { bandwidth.radius(v.pdf, distance, before) } else { before.unwrap_or(0.0) };
        }
    }

    /// Median of 1/p over the vertices that come straight from lights.
    pub(crate) fn typical_area(&self) -> f32 {
        let mut areas: Vec<f32> = self.vertices.iter().filter(|v| v.first()).map(|v| 1.0 / v.pdf).collect();
        areas.sort_unstable_by(f32::total_cmp);
        areas.get(areas.len() / 2).copied().unwrap_or(1.0)
    }

    /// Strength of a vertex for choosing among links: flux over the footprint's area across the light.
    #[inline]
    pub(crate) fn strength(v: &LightVertex) -> f32 {
        luminance(v.throughput) / (v.radius * v.radius * v.cos())
    }

    /// The light that the path of a first vertex begins at.
    pub(crate) fn point(&self, v: &LightVertex) -> LightPoint {
        self.starts[v.parent as usize].point()
    }
}

/// Rays around a vertex.
const PROBES: u32 = 4;
