//! Links: camera vertices that lie in a light vertex's footprint are connected to that vertex's parent.
//!
//! Source: Bekaert et al. 2003, §4.2 and §5, with the corrections of errata: a link's score is T f(parent) cos/p_ω ·
//! f(y) cos_y · T_y / (π R² cos θ N), where N light paths were traced, T belongs to the parent, and the chance p_ω of
//! the direction includes roulette's. Trial links are drawn by stratified sampling; a link's weight is the expected
//! number of its selections n p, of which it may have several.
//!
//! The normalisation (§3, eq. 6) takes the surface within reach for a disc. Where it is not ([`LightPaths::is_flat`])
//! the share of the disc's (or ball's) solid angle from which light paths would have made this link is estimated with
//! rays, see [`Linker::share`].

use super::super::arrival::{Arrival, IncidentFrom};
use super::super::footprints::{self, Candidates, Link};
use super::Plan;
use super::eye::{EyeVertex, emitter_samples};
use super::light::{CompactLightVertex, LightPaths, LightVertex};
use super::weight::{Technique, mis_weight};
use crate::light::{End, LightStart};
use crate::points::Points;
use crate::subpath::{Scattering, scattering};
use crate::world::{MOST_CROSSINGS, Shading, World};
use crate::{PathSampler, Rgb};
use glam::Vec3;
use rayon::prelude::*;
use std::f32::consts::{FRAC_1_PI, PI};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use translume_core::frame::Frame;
use translume_core::sampler::Sampler;
use translume_core::warp;

/// Trial links in the order of light vertices. Every group of camera vertices (their numbers) shares those it asks for;
/// `wanted` is their number of a group that begins with this vertex, `strength` how likely a candidate is taken.
pub(crate) fn select(
    candidates: &Candidates,
    eyes: &[EyeVertex],
    groups: &[Range<usize>],
    (seed, step): (u64, u64),
    wanted: impl Fn(usize) -> f32 + Sync,
    strength: impl Fn(u32, &EyeVertex) -> f32 + Sync,
) -> Vec<Link> {
    let mut links: Vec<Link> = groups
        .par_iter()
        .fold(Vec::new, |mut links, group| {
            let pairs: Vec<(u32, usize)> =
                group.clone().flat_map(|eye| candidates.of(eye).iter().map(move |light| (*light, eye))).collect();
            let n = wanted(group.start);
            let link = |(light, eye): (u32, usize), weight| Link { light, eye: eye as u32, weight };
            if pairs.len() as f32 <= n {
                links.extend(pairs.into_iter().map(|pair| link(pair, 1.0)));
                return links;
            }
            let strengths: Vec<f32> = pairs.iter().map(|(light, eye)| strength(*light, &eyes[*eye])).collect();
            let u = PathSampler::new(seed ^ 0x6c69_6e6b, step << 32 | group.start as u64, 0).next_1d();
            footprints::choose(&strengths, n, u, |i, weight| links.push(link(pairs[i], weight)));
            links
        })
        .reduce(Vec::new, |mut a, b| {
            a.extend(b);
            a
        });
    links.par_sort_unstable_by_key(|l| (l.light, l.eye));
    links
}

/// Camera vertices for [`Candidates::find`].
pub(crate) fn tree(eyes: &[EyeVertex]) -> Points {
    footprints::tree(eyes.iter().map(|e| e.hit.point.p))
}

/// How many pairs there are, of light vertices that come straight from lights and of all others.
pub(crate) fn count(lights: &LightPaths, tree: &Points) -> [usize; 2] {
    let of = |v: &LightVertex| {
        let mut n = 0;
        tree.within(v.hit.point.p, v.radius, |_| n += 1);
        if v.first { [n, 0] } else { [0, n] }
    };
    let linked = lights.vertices.par_iter().filter(|v| v.technique == Technique::Connect);
    linked.map(of).reduce(|| [0; 2], |a, b| [a[0] + b[0], a[1] + b[1]])
}

/// What scoring takes.
pub(crate) struct Linker<'a> {
    pub(crate) world: &'a World,
    pub(crate) lights: &'a LightPaths,
    pub(crate) plan: Plan<'a>,
    /// Chances of links are found without bias.
    pub(crate) unbiased: bool,
    /// Longest path in segments.
    pub(crate) max: u32,
    /// Of the random numbers.
    pub(crate) seed: (u64, u64),
    /// Someone wants the render to end: scores will not be used.
    pub(crate) stop: &'a AtomicBool,
}

/// What a link brings.
pub(crate) struct Score {
    pub(crate) value: Rgb,
    /// Nothing stood between.
    pub(crate) visible: bool,
    pub(crate) rays: u64,
}

/// The other end of links to one light vertex.
pub(super) enum Parent<'a> {
    Start(&'a LightStart),
    Vertex(&'a LightVertex, Box<Shading<'a>>),
}

/// What links to one light vertex have in common.
struct Common<'a> {
    parent: Parent<'a>,
    /// Whether the surface around it is flat as far as points that link here would also link to neighbours; found out
    /// by the first link that wants to know.
    flat: Option<bool>,
}

/// Largest answer of [`Linker::share`]: beyond, little light is lost and much noise spared.
const MAX_SHARE: f32 = 32.0;

/// Largest footprint over that of the vertex at hand, for [`Linker::share`].
const MARGIN: f32 = 1.3;

/// Largest factor on it where y is met at a flatter angle.
const MAX_WIDENING: f32 = 4.0;

impl<'a> Linker<'a> {
    /// Scores of `links`, in their order.
    pub(crate) fn score(&self, links: &[Link], eyes: &[EyeVertex]) -> Vec<Score> {
        links
            .par_chunks(256)
            .flat_map_iter(|chunk| {
                let mut common: Option<(u32, Common)> = None;
                chunk.iter().map(move |link| {
                    let v = &self.lights.vertices[link.light as usize];
                    let y = &eyes[link.eye as usize];
                    if self.stop.load(Ordering::Relaxed) {
                        return Score { value: Rgb::ZERO, visible: false, rays: 0 };
                    }
                    if v.technique == Technique::Merge {
                        return self.merge(link, v, y);
                    }
                    if common.as_ref().is_none_or(|c| c.0 != link.light) {
                        common = Some((link.light, Common { parent: self.parent(v), flat: None }));
                    }
                    match &mut common {
                        Some((_, common)) => self.link(link, v, common, (y, eyes)),
                        None => Score { value: Rgb::ZERO, visible: false, rays: 0 },
                    }
                })
            })
            .collect()
    }

    /// The photon `v` where it is merged with `y`.
    fn merge(&self, link: &Link, v: &LightVertex, y: &EyeVertex) -> Score {
        let none = Score { value: Rgb::ZERO, visible: false, rays: 0 };
        // Photons on the other side of a sheet, or around a corner, belong elsewhere.
        if u32::from(v.segments) + y.segments > self.max || v.hit.n().dot(y.hit.n()) < 0.8 {
            return none;
        }
        let Some(here) = scattering(self.world, &y.hit, &y.shading, v.hit.wo, y.hit.wo) else { return none };
        let weights = &self.plan.weights;
        let own = weights.density(Technique::Merge, v.light_pdf());
        let camera = y.camera_sum(weights, v.pdf, here.pdf_to_camera);
        let weight = mis_weight(own, camera, weights.onward(here.pdf_to_light * v.back, v.d_vc));
        let area = PI * v.radius * v.radius * self.lights.count as f32;
        let inside = is_inside(v.hit.point.p.distance_squared(y.hit.point.p), v.radius);
        let value = v.throughput * here.f * y.throughput * (weight * inside * link.weight / area);
        Score { value, visible: true, rays: 0 }
    }

    /// Where the light at `v` comes from, a hit at ray parameter `t`.
    #[inline]
    pub(super) fn incident_from(&self, v: &LightVertex, t: f32) -> IncidentFrom {
        if v.first {
            let start = &self.lights.starts[v.parent as usize];
            if matches!(start.origin, End::Far) {
                return IncidentFrom::Direction(start.pdf_next());
            }
        }
        IncidentFrom::Point(t)
    }

    fn parent(&self, v: &LightVertex) -> Parent<'a> {
        if v.first {
            return Parent::Start(&self.lights.starts[v.parent as usize]);
        }
        let parent = &self.lights.vertices[v.parent as usize];
        Parent::Vertex(parent, Box::new(self.world.shading(&parent.hit)))
    }

    fn link(&self, link: &Link, v: &LightVertex, common: &mut Common, (y, eyes): (&EyeVertex, &[EyeVertex])) -> Score {
        let parent = &common.parent;
        let mut score = Score { value: Rgb::ZERO, visible: false, rays: 0 };
        let before = if let Parent::Vertex(p, _) = parent { u32::from(p.segments) } else { 0 };
        let segments = y.segments + before + 1;
        if segments > self.max {
            return score;
        }
        let Some(arrival) = self.arrival(parent, y.hit.point.p) else { return score };
        let Some(here) = scattering(self.world, &y.hit, &y.shading, arrival.wi, y.hit.wo) else { return score };
        score.rays += 1;
        let segment = match parent {
            Parent::Start(start) => match &start.origin {
                End::Surface(q) => y.hit.point.segment_between(q),
                End::Point(q) => y.hit.point.segment_to(*q),
                End::Far => y.hit.point.spawn(arrival.wi),
            },
            Parent::Vertex(p, _) => y.hit.point.segment_between(&p.hit.point),
        };
        let visible = self.world.transmittance(&segment, (self.max - segments).min(MOST_CROSSINGS));
        if visible == Rgb::ZERO {
            return score;
        }
        score.visible = true;
        let cos_y = y.hit.n().dot(arrival.wi).abs();
        // One over the area across the light in which light paths have y in their footprints: [Bekaert 2003, Eq. 6].
        let kernel = if self.unbiased {
            self.inverse_chance(link, v, parent, &arrival, y, &mut score.rays) * arrival.pdf_across
        } else if v.passed < 1.0
            || !*common.flat.get_or_insert_with(|| self.lights.is_flat(self.world, v, &mut score.rays))
        {
            self.share(link, v, &arrival, y, &mut score.rays) / (PI * v.radius * v.radius)
        } else {
            1.0 / (PI * v.radius * v.radius * v.cos() * v.passed)
        };
        let kernel = kernel * is_inside(v.hit.point.p.distance_squared(y.hit.point.p), v.radius);
        let clear = || visible == Rgb::ONE && (!self.world.has_null() || self.world.is_clear(&segment));
        let weight = match self.representative(parent, (y, eyes), clear, &mut score.rays) {
            None => self.weight(parent, &arrival, &here, (y, cos_y, 1.0)),
            Some((first, size)) => {
                let Some(arrival) = self.arrival(parent, first.hit.point.p) else { return score };
                let Some(here) = scattering(self.world, &first.hit, &first.shading, arrival.wi, first.hit.wo) else {
                    return score;
                };
                let cos = first.hit.n().dot(arrival.wi).abs();
                self.weight(parent, &arrival, &here, (first, cos, size))
            }
        };
        let paths = self.lights.count as f32;
        score.value = arrival.value
            * visible
            * here.f
            * y.throughput
            * (cos_y * kernel * weight * link.weight / (v.survival * paths));
        score
    }

    fn arrival(&self, parent: &Parent, y: Vec3) -> Option<Arrival> {
        match parent {
            Parent::Start(start) => Arrival::from_light(self.world, self.plan.starts, start, y),
            Parent::Vertex(p, shading) => Arrival::from_surface(self.world, (&p.hit, shading), p.throughput, y),
        }
    }

    /// π R² p over N: how much larger than the disc the part of a ball around y is, as the parent sees it, in which a
    /// light path's hit would have y in its footprint. Rays are sent into the ball until one succeeds; their number is
    /// one over the chance in the mean (Booth 2007). Footprints beside may be larger than this one: by [`MARGIN`], and
    /// where the surface at y is met at a flatter angle, as among leaves, by as much as those there are.
    fn share(&self, link: &Link, v: &LightVertex, arrival: &Arrival, y: &EyeVertex, rays: &mut u64) -> f32 {
        let key = u64::from(link.light) << 32 | u64::from(link.eye);
        let mut sampler = PathSampler::new(self.seed.0 ^ 0x7368_6172, key, self.seed.1);
        let mut passing = sampler.branch(0x7061_7373);
        let frame = Frame::from_normal(arrival.wi);
        let center = y.hit.point.p;
        let cos_y = y.hit.n().dot(arrival.wi).abs();
        let margin = MARGIN * (v.cos() / cos_y).sqrt().clamp(1.0, MAX_WIDENING);
        let trials = (MAX_SHARE * margin * margin) as u32;
        for tried in 1..=trials {
            let u = sampler.next_2d();
            let beside = frame.to_world((warp::uniform_disk(u.x, u.y) * (margin * v.radius)).extend(0.0));
            let ray = self.lights.ray_beside(self.world, v, center + beside);
            *rays += 1;
            let found = self.world.arrives(&ray, Some(&mut passing), |point, t| {
                let pdf = arrival.pdf_across * point.ng.dot(ray.d).abs();
                let radius = self.plan.bandwidth.radius(pdf, self.incident_from(v, t), v.first);
                is_inside(point.p.distance_squared(center), radius) > 0.0
            });
            if found {
                return tried as f32 / (margin * margin);
            }
        }
        MAX_SHARE
    }

    /// About the weight that `v` will have at `y`, as if both scattered evenly: for choosing.
    #[inline]
    pub(crate) fn likely_weight(&self, v: &CompactLightVertex, y: &EyeVertex) -> f32 {
        let w = &self.plan.weights;
        let own = w.density(v.technique, v.at);
        let camera = y.camera_sum(w, v.at.pdf, y.hit.n().dot(y.hit.wo).abs() * FRAC_1_PI);
        let direct = w.onward(w.emitter_factor(y.depth == 0) / w.emitter_factor(false), v.d_vcm);
        let light = w.onward(y.hit.n().dot(v.wo).abs() * FRAC_1_PI * v.back, v.d_vc) + direct;
        mis_weight(own, camera, light)
    }

    /// Density with which emitter sampling at `y` finds the light's point.
    fn pdf_direct(&self, start: &LightStart, arrival: &Arrival, y: &EyeVertex) -> f32 {
        if self.plan.weights.emitters == 0.0 {
            return 0.0;
        }
        let samples = emitter_samples(self.world, y.depth) as f32;
        samples * self.world.pdf_direct(&y.hit, &y.shading, self.plan.visibility, &start.point(), arrival.wi)
    }

    /// The camera vertex whose weights a link takes instead of those of `y`, and the factor on its density; see
    /// [`super::share`].
    fn representative<'e>(
        &self,
        parent: &Parent,
        (y, eyes): (&EyeVertex, &'e [EyeVertex<'a>]),
        clear: impl Fn() -> bool,
        rays: &mut u64,
    ) -> Option<(&'e EyeVertex<'a>, f32)> {
        let (group, Parent::Vertex(p, shading)) = (y.group?, parent) else { return None };
        group.representative(self.world, (y, eyes), (&p.hit, shading), clear, rays)
    }

    /// Of a link to `y`, with so many times the camera's density of the parent.
    fn weight(
        &self,
        parent: &Parent,
        arrival: &Arrival,
        here: &Scattering,
        (y, cos_y, times): (&EyeVertex, f32, f32),
    ) -> f32 {
        let onto_y = arrival.pdf_across * cos_y;
        let w = &self.plan.weights;
        let own = w.density(Technique::Connect, w.light_pdf(onto_y, arrival.from));
        let parent_pdf = here.pdf_to_light * arrival.onto_parent * times;
        let camera = y.camera_sum(w, onto_y, here.pdf_to_camera);
        let light = match parent {
            Parent::Start(start) => {
                let begin = start.pdf_begin();
                w.onward(parent_pdf / begin, w.at_light(start.delta))
                    + w.emitter_sampling(y.depth == 0, self.pdf_direct(start, arrival, y) / begin)
            }
            Parent::Vertex(p, _) => {
                let there = arrival.at_parent.as_ref().map_or(0.0, |s| s.pdf_to_light);
                // Light paths take it to be one sample.
                let samples = emitter_samples(self.world, y.depth + 1) as f32;
                let inner = w.sum(p.technique, p.light_pdf(), there * p.back, p.d_vc) + w.onward(samples, p.d_vcm);
                w.onward(parent_pdf / p.pdf, inner)
            }
        };
        mis_weight(own, camera, light)
    }
}

/// 1 at this squared distance from a footprint's middle if that is inside, or 0.
#[inline]
pub(super) fn is_inside(distance_squared: f32, radius: f32) -> f32 {
    if distance_squared / (radius * radius) > 1.0 { 0.0 } else { 1.0 }
}
