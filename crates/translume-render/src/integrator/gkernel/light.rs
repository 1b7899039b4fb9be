//! Light paths of a step: their vertices with footprints.
//!
//! Source: Bekaert et al. 2003, §3 (eq. 7) and §5; errata: p of eq. 7 is per area, R is capped by the distance to the
//! parent, the chance of Russian roulette belongs to the density of a direction. Every vertex says whether a link to
//! its parent may be made (the parent scatters in more than single directions) and whether the surface around it is
//! flat as far as such links reach, which is what the disc of §3 takes for granted.

use super::super::arrival::{IncidentFrom, onto};
use super::super::footprints::{self, Footprint};
use super::Plan;
use super::weight::{LightPdf, Technique};
use crate::light::{End, LightStart};
use crate::subpath::{self, LightPath, Limits, NONE, Vertex};
use crate::world::{SurfaceHit, World};
use crate::{PathSampler, Rgb, luminance};
use glam::Vec3;
use rayon::prelude::*;
use std::f32::consts::FRAC_PI_2;
use std::sync::atomic::{AtomicBool, Ordering};
use translume_core::frame::Frame;
use translume_trace::Ray;

/// How footprints grow.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bandwidth {
    /// The paper's h: of vertices that come straight from lights, and of all others.
    pub(crate) h: [f32; 2],
    /// Largest radius over the distance to the parent.
    pub(crate) max_share: f32,
    /// Largest radius.
    pub(crate) max_radius: f32,
    /// Densities below this per solid angle, cosine at the surface included, count as this: what bounds a footprint's
    /// cone.
    pub(crate) min_pdf: f32,
    /// Of photons that are merged.
    pub(crate) photon: f32,
}

/// The cosine below which parallel light's footprints grow no more.
pub(crate) const MIN_COS: f32 = 0.2;

impl Bandwidth {
    /// The radius of a vertex of density `pdf` per area; light comes to it `from` there, from a light itself if it is
    /// the `first`. [Bekaert 2003, Eq. 7] without the radius of the vertex before, and bounded.
    #[inline]
    pub(crate) fn radius(&self, pdf: f32, from: IncidentFrom, first: bool) -> f32 {
        let h = self.h[usize::from(!first)];
        let radius = match from {
            IncidentFrom::Point(d) => d * (h / (pdf * d * d).max(self.min_pdf).sqrt()).min(self.max_share),
            IncidentFrom::Direction(across) => h / pdf.max(MIN_COS * across).sqrt(),
        };
        radius.min(self.max_radius)
    }

    /// The largest radius over the distance.
    pub(crate) fn bound(&self, first: bool) -> f32 {
        (self.h[usize::from(!first)] / self.min_pdf.sqrt()).min(self.max_share)
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
    /// See [`LightPdf`].
    pub(crate) acceptance: f32,
    /// The footprint's.
    pub(crate) radius: f32,
    /// Number of the vertex before, or of the begin if it is the first.
    pub(crate) parent: u32,
    /// Chance with which roulette let the path come here from the parent.
    pub(crate) survival: f32,
    /// Chance with which what stands between let it pass straight.
    pub(crate) passed: f32,
    /// dVC of the light's walk ([`super::weight`]): what may happen farther up the path.
    pub(crate) d_vc: f32,
    /// dVCM: emitter sampling here, where the parent is a light.
    pub(crate) d_vcm: f32,
    /// Density of the parent by a walk from here over that of the light's walk, per density of the direction.
    pub(crate) back: f32,
    pub(crate) segments: u16,
    /// The parent is a light.
    pub(crate) first: bool,
    /// What may happen here.
    pub(crate) technique: Technique,
}

// Millions of them are kept at once.
const _: () = assert!(size_of::<LightVertex>() <= 200);

impl LightVertex {
    /// For weights.
    #[inline]
    pub(crate) fn light_pdf(&self) -> LightPdf {
        LightPdf { pdf: self.pdf, acceptance: self.acceptance }
    }

    /// cos θ at this vertex towards the parent.
    #[inline]
    pub(crate) fn cos(&self) -> f32 {
        self.hit.n().dot(self.hit.wo).abs()
    }
}

/// What choosing among links takes of a light vertex, in one line of the cache.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CompactLightVertex {
    /// Unit direction back to the parent.
    pub(crate) wo: Vec3,
    /// Luminance of the throughput over R², over cos θ as well where it is a link.
    pub(crate) gain: f32,
    pub(crate) at: LightPdf,
    pub(crate) back: f32,
    pub(crate) d_vc: f32,
    pub(crate) d_vcm: f32,
    pub(crate) technique: Technique,
}

impl CompactLightVertex {
    pub(crate) fn new(v: &LightVertex) -> Self {
        let cos = if v.technique == Technique::Merge { 1.0 } else { v.cos() };
        let gain = luminance(v.throughput) / (v.radius * v.radius * cos);
        Self {
            wo: v.hit.wo,
            gain,
            at: v.light_pdf(),
            back: v.back,
            d_vc: v.d_vc,
            d_vcm: v.d_vcm,
            technique: v.technique,
        }
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
    pub(crate) plan: Plan<'a>,
    /// Of the random numbers, and the stream: the step.
    pub(crate) seed: u64,
    pub(crate) step: u64,
    pub(crate) count: u32,
    /// Someone wants the render to end: what is traced will not be used.
    pub(crate) stop: &'a AtomicBool,
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
                let mut walk = Vec::new();
                (c * CHUNK..((c + 1) * CHUNK).min(request.count))
                    .take_while(|_| !request.stop.load(Ordering::Relaxed))
                    .for_each(|i| own.add(request, i, &mut walk));
                own
            })
            .collect();
        let mut all = Self { count: request.count, ..Self::default() };
        for chunk in chunks {
            let (starts, vertices) = (all.starts.len() as u32, all.vertices.len() as u32);
            all.starts.extend(chunk.starts);
            all.vertices.extend(chunk.vertices.into_iter().map(|v| {
                let first = if v.first { starts } else { vertices };
                LightVertex { parent: v.parent + first, ..v }
            }));
            all.rays += chunk.rays;
        }
        all
    }

    fn add(&mut self, request: &Request, path: u32, walk: &mut Vec<Vertex>) {
        walk.clear();
        // One path after the other of a low-discrepancy sequence, another sequence for each step.
        let mut sampler = PathSampler::new(request.seed, STREAM | request.step, path.into());
        let (world, starts) = (request.world, request.plan.starts);
        let light = subpath::light_path(world, starts, request.limits, &mut sampler, &mut self.rays, walk);
        let Some(light) = light else { return };
        self.starts.push(light.start);
        let base = self.vertices.len();
        for i in 0..walk.len() {
            let vertex = self.vertex(request, &light, walk, base, i);
            self.vertices.push(vertex);
        }
    }

    fn vertex(&self, request: &Request, light: &LightPath, path: &[Vertex], base: usize, i: usize) -> LightVertex {
        let v = &path[i];
        let weights = &request.plan.weights;
        let parent = path.get(v.parent as usize);
        let (p, wo) = (v.hit.point.p, v.hit.wo);
        let point = light.start.point();
        let (from, back) = match parent {
            Some(parent) => {
                (IncidentFrom::Point((p - parent.hit.point.p).length()), onto(p, &parent.hit, wo) / parent.pdf)
            }
            None => {
                let back = point.from_solid_angle(1.0, wo, (p - point.p).length()) / light.start.pdf_begin();
                (incident_from(&light.start, p), back)
            }
        };
        let d_vc = match parent {
            None => weights.at_light(light.start.delta),
            Some(parent) => {
                let above = path.get(parent.parent as usize);
                let ratio = match above {
                    Some(above) => above.pdf_back / above.pdf,
                    None => light.pdf_back / light.start.pdf_begin(),
                };
                let technique = Technique::of(parent.delta, above.is_some_and(|a| a.delta));
                let before = &self.vertices[base + v.parent as usize];
                weights.sum(technique, before.light_pdf(), ratio, before.d_vc) + before.d_vcm
            }
        };
        let d_vcm = match parent {
            None if weights.emitters > 0.0 && !v.delta => {
                let shading = request.world.shading(&v.hit);
                let pdf = request.world.pdf_direct(&v.hit, &shading, request.plan.visibility, &point, wo);
                weights.emitter_sampling(false, pdf / light.start.pdf_begin())
            }
            _ => 0.0,
        };
        let delta = parent.is_some_and(|p| p.delta);
        let usable = v.pdf > 0.0 && v.survival > 0.0 && v.passed > 0.0;
        let technique = Technique::of(!usable || (delta && weights.photons == 0.0), delta);
        let radius = if delta {
            request.plan.bandwidth.photon
        } else {
            request.plan.bandwidth.radius(v.pdf, from, parent.is_none())
        };
        LightVertex {
            hit: v.hit,
            throughput: v.throughput,
            pdf: v.pdf,
            acceptance: weights.light_pdf(v.pdf, from).acceptance,
            radius,
            parent: if v.parent == NONE { self.starts.len() as u32 - 1 } else { base as u32 + v.parent },
            survival: v.survival,
            passed: v.passed,
            d_vc,
            d_vcm,
            back,
            segments: v.segments.min(u16::MAX.into()) as u16,
            first: parent.is_none(),
            technique,
        }
    }

    /// The ray from the parent of `v` through a point beside `v`.
    #[inline]
    pub(crate) fn ray_beside(&self, world: &World, v: &LightVertex, q: Vec3) -> Ray {
        let towards = |from: Vec3| (q - from).normalize_or(-v.hit.wo);
        if !v.first {
            return self.ray_along(v, towards(self.vertices[v.parent as usize].hit.point.p));
        }
        let start = &self.starts[v.parent as usize];
        match &start.origin {
            End::Surface(from) => self.ray_along(v, towards(from.p)),
            End::Point(from) => self.ray_along(v, towards(*from)),
            End::Far => Ray::new(q - start.direction * (4.0 * world.bounding_sphere().1), start.direction),
        }
    }

    /// The ray from the parent of `v`, which is not far away, in this direction. Far from the origin there is nothing
    /// between the points that single precision knows: whoever has a direction must not go by one.
    #[inline]
    pub(crate) fn ray_along(&self, v: &LightVertex, d: Vec3) -> Ray {
        if !v.first {
            return self.vertices[v.parent as usize].hit.point.spawn(d);
        }
        match &self.starts[v.parent as usize].origin {
            End::Surface(from) => from.spawn(d),
            End::Point(from) => Ray::new(*from, d),
            End::Far => Ray::new(v.hit.point.p - d, d), // not called
        }
    }

    /// Whether the parent of `v` sees the plane of `v` all around it, a fifth farther than the footprint.
    pub(crate) fn is_flat(&self, world: &World, v: &LightVertex, rays: &mut u64) -> bool {
        let frame = Frame::from_normal(v.hit.n());
        (0..PROBES).all(|i| {
            let turn = (i as f32 + 0.5) * (4.0 * FRAC_PI_2 / PROBES as f32);
            let away = frame.to_world(Vec3::new(turn.cos(), turn.sin(), 0.0) * (1.2 * v.radius));
            let ray = self.ray_beside(world, v, v.hit.point.p + away);
            *rays += 1;
            world.arrives(&ray, None, |point, _| {
                let off = point.p - v.hit.point.p;
                off.dot(v.hit.n()).abs() <= 0.05 * v.radius && (off - away).length_squared() <= (0.5 * v.radius).powi(2)
            })
        })
    }

    /// Gives all vertices the footprints of another bandwidth.
    pub(crate) fn refit(&mut self, bandwidth: &Bandwidth) {
        for i in 0..self.vertices.len() {
            let v = &self.vertices[i];
            let from = if v.first {
                incident_from(&self.starts[v.parent as usize], v.hit.point.p)
            } else {
                let parent = &self.vertices[v.parent as usize];
                IncidentFrom::Point((v.hit.point.p - parent.hit.point.p).length())
            };
            self.vertices[i].radius = match v.technique {
                Technique::Merge => bandwidth.photon,
                _ => bandwidth.radius(v.pdf, from, v.first),
            };
        }
    }

    /// Those that something may happen at, in an order in which neighbours are near each other.
    pub(crate) fn footprints(&self) -> Vec<Footprint> {
        let open = (0..).zip(&self.vertices).filter(|(_, v)| v.technique != Technique::None);
        let all: Vec<_> = open.map(|(light, v)| Footprint { p: v.hit.point.p, radius: v.radius, light }).collect();
        footprints::sorted(&all)
    }
}

/// From `start` to `p`.
fn incident_from(start: &LightStart, p: Vec3) -> IncidentFrom {
    let point = start.point();
    IncidentFrom::light(&point, start.pdf_next(), (p - point.p).length())
}

/// Rays around a vertex.
const PROBES: u32 = 4;
