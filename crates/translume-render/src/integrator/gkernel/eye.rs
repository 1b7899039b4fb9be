//! Camera paths of a step: their vertices wait for links; lights that they meet, or that emitter sampling finds, count at once.
//!
//! Source: Bekaert et al. 2003, §4.1 and §5.

use super::super::arrival::IncidentFrom;
use super::correlation::{Ancestor, Node, Technique, Whole};
use super::share::{self, Group, Onward, Receiver, Share};
use super::weight::{Landing, Way, Weighing};
use super::{Block, Plan};
use crate::light::{End, LightPoint, Place};
use crate::subpath::{Density, Escape, Going, Limits, NONE, Vertex, Walk, scattering};
use crate::world::{MOST_CROSSINGS, Shading, SurfaceHit, World};
use crate::{PathSampler, Rgb, luminance};
use glam::Vec3;
use translume_bxdf::Mode;
use translume_core::sampler::Sampler;
use translume_trace::Ray;

/// Where a camera path met a surface that links can end at.
pub(crate) struct EyeVertex<'a> {
    pub(crate) hit: SurfaceHit,
    pub(crate) shading: Shading<'a>,
    /// Factor on radiance, pixel filter included; of a tail's, since its begin.
    pub(crate) throughput: Rgb,
    /// Luminance of the whole factor.
    pub(crate) gain: f32,
    /// Number of the camera path.
    pub(crate) path: u32,
    /// Number of the tail that it belongs to: what is found here is for all paths that share it.
    pub(crate) tail: Option<u32>,
    /// Of a path's first vertex: those that share tails with it.
    pub(crate) group: Option<Group>,
    pub(crate) segments: u32,
    /// Surfaces met, from 0.
    pub(crate) depth: u32,
    /// Density per area, given the vertex before.
    pub(crate) pdf: f32,
    /// The vertex before: density per area of a walk from here, per density of the direction; its own density; what may
    /// happen there.
    pub(crate) back: f32,
    pub(crate) before: f32,
    /// Its distance.
    pub(crate) distance: f32,
    pub(crate) way: Way,
    /// See [`super::weight`].
    pub(crate) behind: f32,
    /// Number of the one before the vertex before among the [`Ancestor`]s, or [`NONE`].
    pub(crate) above: u32,
}

impl EyeVertex<'_> {
    /// What may happen nearer to the camera, where the light's walk finds this vertex with density `onto` per area and goes on with
    /// `pdf_to_camera` per solid angle.
    #[inline]
    pub(crate) fn nearer(&self, weighing: &Weighing, onto: f32, pdf_to_camera: f32) -> f32 {
        let back = pdf_to_camera * self.back;
        let at = weighing.landing(back, IncidentFrom::Point(self.distance));
        weighing.times(onto / self.pdf, weighing.add(self.way, at, back / self.before, self.behind))
    }

    /// Appends this vertex, and those nearer to the camera, to a path that is merged `made` times here; the rest as of [`EyeVertex::nearer`].
    pub(crate) fn ascend(
        &self,
        weighing: &Weighing,
        (onto, made, pdf_to_camera): (f32, f32, f32),
        ancestors: &[Ancestor],
        whole: &mut Whole,
    ) {
        whole.nodes.push(Node { light: onto, camera: self.pdf, made, delta: false });
        if self.depth > 0 {
            let light = pdf_to_camera * self.back;
            let made = weighing.made(self.way, weighing.landing(light, IncidentFrom::Point(self.distance)));
            whole.nodes.push(Node { light, camera: self.before, made, delta: self.way == Way::Closed });
            whole.ascend(ancestors, self.above);
        }
    }
}

/// Ancestors, and the number of the one that is meant.
type Above<'a> = (&'a [Ancestor], u32);

const NOTHING_ABOVE: Above = (&[], NONE);

/// A traced path.
pub(crate) struct Eye<'a> {
    pub(crate) world: &'a World,
    pub(crate) limits: Limits,
    pub(crate) hide_lights: bool,
    pub(crate) plan: Plan<'a>,
}

/// A camera path that is under way.
pub(crate) struct Walked {
    /// Its pixel: the number of its tile, and its own number there.
    place: (u32, u32),
    /// In the picture.
    pub(super) pixel: [u32; 2],
    /// What rays beside it saw of lamps, and how much its own sight of them counts.
    pub(super) beside: Rgb,
    pub(super) sight: f32,
    going: Going,
    vertices: Vec<Vertex>,
    escape: Option<Escape>,
    sampler: PathSampler,
    /// The camera's point.
    from: Vec3,
}

impl<'a> Eye<'a> {
    fn walk(&self) -> Walk<'a> {
        Walk { world: self.world, mode: Mode::Radiance, limits: self.limits, hide_lights: self.hide_lights }
    }

    /// Follows `ray` with weight `weight` to its second vertex.
    pub(crate) fn begin(
        &self,
        place: (u32, u32),
        pixel: [u32; 2],
        (ray, density, weight): (&Ray, Density, f32),
        mut sampler: PathSampler,
        rays: &mut u64,
    ) -> Walked {
        let mut going = Going::new((*ray, Rgb::splat(weight), density));
        let mut vertices = Vec::with_capacity(2);
        let escape = self.walk().follow(&mut going, 2, None, &mut sampler, rays, &mut vertices);
        Walked { place, pixel, beside: Rgb::ZERO, sight: 1.0, going, vertices, escape, sampler, from: ray.o }
    }

    /// What the first surface that a camera path meets emits.
    pub(super) fn sight(&self, walked: &Walked) -> Rgb {
        let first = walked.vertices.first().filter(|v| v.segments == 1);
        first.map_or(Rgb::ZERO, |v| self.emitted(&walked.vertices, v, 0, 0.0, NOTHING_ABOVE))
    }

    /// The same of a ray, not weighted.
    pub(super) fn sight_along(&self, ray: &Ray) -> Rgb {
        let hit = if self.hide_lights { None } else { self.world.intersect(ray) };
        hit.and_then(|hit| self.world.emission(&hit)).map_or(Rgb::ZERO, |(radiance, _)| radiance)
    }

    /// Takes up camera paths of neighbouring pixels: those that resemble each other share, `sharers` for each that goes on.
    pub(crate) fn take_up(&self, mut walks: Vec<Walked>, sharers: usize, block: &mut Block<'a>) {
        let base = block.radiance.len() as u32;
        for walked in &walks {
            block.places.push(walked.place);
            block.radiance.push(walked.beside + self.sight(walked) * (walked.sight - 1.0));
        }
        if let [walked] = &mut walks[..] {
            self.finish(base, walked, None, Onward::Alone, block);
            return;
        }
        let receiver = |(path, w): (u32, &Walked)| Receiver::of(self.world, path, &w.vertices, self.limits.segments);
        let mut receivers: Vec<Option<Receiver>> = (base..).zip(&walks).map(receiver).collect();
        let number = |i: usize| base + i as u32;
        for (i, walked) in walks.iter_mut().enumerate().filter(|(i, _)| receivers[*i].is_none()) {
            self.finish(number(i), walked, None, Onward::Alone, block);
        }
        for i in 0..walks.len() {
            let Some(first) = receivers[i].take() else { continue };
            let mut members = vec![i];
            let mut group = vec![first];
            for (j, other) in receivers.iter_mut().enumerate().skip(i + 1) {
                if let Some(receiver) = other.take_if(|r| r.resembles(&group[0], walks[i].from)) {
                    members.push(j);
                    group.push(receiver);
                }
            }
            if group.len() == 1 {
                self.finish(number(i), &mut walks[i], None, Onward::Alone, block);
                continue;
            }
            let carriers = group.len().div_ceil(sharers);
            // Carriers first: evenly among the rest.
            for k in 0..carriers {
                let at = k * group.len() / carriers;
                members.swap(k, at);
                group.swap(k, at);
            }
            let onward: Vec<_> = (0..)
                .zip(&members)
                .map(|(own, j)| {
                    share::onward(self.world, (&group, carriers, own), &walks[*j].vertices, &mut block.rays)
                })
                .collect();
            let first = block.eyes.len() as u32;
            let mut before: Option<usize> = None;
            for (own, (j, onward)) in members.iter().zip(onward).enumerate() {
                let carries = own < carriers;
                let begin = block.eyes.len();
                if let Some(group) = before.filter(|_| carries).and_then(|b| block.eyes[b].group.as_mut()) {
                    group.next = Some(begin as u32);
                }
                before = Some(begin);
                let shared = Group { first, next: None, carries, carriers: carriers as f32 };
                self.finish(number(*j), &mut walks[*j], Some(shared), onward, block);
            }
        }
    }

    /// Follows a path to its end; appends its vertices, and the radiance of the lights that it meets.
    fn finish(&self, path: u32, walked: &mut Walked, group: Option<Group>, onward: Onward, block: &mut Block<'a>) {
        let Walked { going, vertices, escape, sampler, .. } = walked;
        let own = vertices.first().copied();
        let mut tail = None;
        // Of the path at the tail's begin.
        let mut factor = Rgb::ONE;
        if !matches!(onward, Onward::Alone) {
            // What the second vertex emits is for this path alone.
            block.radiance[path as usize] += self.emitted(vertices, &vertices[1], 1, 0.0, NOTHING_ABOVE);
        }
        match onward {
            Onward::Alone => (),
            Onward::Left => {
                vertices.truncate(1);
                going.end();
            }
            Onward::Carries(seen, shares) => {
                let number = block.tails.len() as u32;
                tail = Some(number);
                block.tails.push(Rgb::ZERO);
                block.shares.extend(shares.into_iter().map(|(path, factor)| Share { tail: number, path, factor }));
                factor = vertices[1].throughput;
                // A path that is dark for its own pixel may be bright for others.
                going.begin_anew(seen[1].throughput);
                vertices.copy_from_slice(&*seen);
            }
        }
        if escape.is_none() {
            *escape = self.walk().follow(going, usize::MAX, None, sampler, &mut block.rays, vertices);
        }
        let mut emitters = sampler.branch(0x656d_6974);
        let (mut behind, mut depths) = (Vec::with_capacity(vertices.len()), Vec::with_capacity(vertices.len()));
        // Per vertex, the ancestor that is its parent.
        let mut parents = Vec::new();
        for (i, v) in own.iter().chain(vertices.iter().skip(1)).enumerate() {
            behind.push(self.behind(vertices, &behind, v.parent));
            let above = parents.get(v.parent as usize).copied().unwrap_or(NONE);
            if self.plan.weighing.alike > 0.0 {
                parents.push(self.ancestor(vertices, v, above, &mut block.ancestors));
            }
            depths.push(depths.get(v.parent as usize).map_or(0, |d| d + 1));
            let tail = tail.filter(|_| i > 0);
            let mut found = Rgb::ZERO;
            if i != 1 || tail.is_none() {
                found += self.emitted(vertices, v, depths[i], behind[i], (&block.ancestors, above));
            }
            let shading = self.world.shading(&v.hit);
            if shading.flags().has_smooth() && v.segments < self.limits.segments {
                let parent = vertices.get(v.parent as usize);
                let y = EyeVertex {
                    hit: v.hit,
                    shading,
                    throughput: v.throughput,
                    gain: luminance(if tail.is_some() { v.throughput * factor } else { v.throughput }),
                    path,
                    tail,
                    group: group.filter(|_| i == 0),
                    segments: v.segments,
                    depth: depths[i],
                    pdf: v.pdf,
                    back: parent.map_or(0.0, |p| onto(v.hit.point.p, p, v.hit.wo)),
                    before: parent.map_or(1.0, |p| p.pdf),
                    distance: parent.map_or(0.0, |p| between(p, &v.hit)),
                    way: Way::of(parent.is_none_or(|p| p.delta), false),
                    behind: behind[i],
                    above,
                };
                if self.plan.weighing.emitters > 0.0 {
                    found += self.lit(&y, &mut emitters, &block.ancestors, &mut block.rays);
                }
                block.eyes.push(y);
            }
            *block.light_of(path, tail) += found;
        }
        if let Some(escape) = escape {
            let depth = depths.get(escape.parent as usize).copied().unwrap_or(0);
            let above = parents.get(escape.parent as usize).copied().unwrap_or(NONE);
            let behind = self.behind(vertices, &behind, escape.parent);
            let found = self.escaped(vertices, escape, depth, behind, (&block.ancestors, above));
            *block.light_of(path, tail) += found;
        }
    }

    /// The bracket behind the vertex before, of a vertex whose parent has this number.
    fn behind(&self, path: &[Vertex], behind: &[f32], parent: u32) -> f32 {
        let above = path.get(parent as usize).and_then(|v| self.before(path, v));
        above
            .map_or(0.0, |node| self.plan.weighing.around(node.made, node.light / node.camera, behind[parent as usize]))
    }

    /// The vertex before `v`, where the light's walk comes from there.
    fn before(&self, path: &[Vertex], v: &Vertex) -> Option<Node> {
        let parent = path.get(v.parent as usize)?;
        let at = self.plan.weighing.landing(parent.pdf_back, IncidentFrom::Point(between(parent, &v.hit)));
        let made = self.plan.weighing.made(Way::of(parent.delta, v.delta), at);
        Some(Node { light: parent.pdf_back, camera: parent.pdf, made, delta: parent.delta })
    }

    /// Makes the vertex before `v` an ancestor; its number. `above` is that of the one before.
    fn ancestor(&self, path: &[Vertex], v: &Vertex, above: u32, all: &mut Vec<Ancestor>) -> u32 {
        let Some(node) = self.before(path, v) else { return NONE };
        all.push(Ancestor { node, above });
        all.len() as u32 - 1
    }

    /// Emitter sampling at `y`.
    fn lit(&self, y: &EyeVertex, sampler: &mut PathSampler, ancestors: &[Ancestor], rays: &mut u64) -> Rgb {
        let (p, n) = (y.hit.point.p, self.world.receiving_normal(&y.hit, &y.shading));
        let mut place = Place::new(p, n, self.plan.seen.map(|s| s.from(p, n)));
        let samples = emitter_samples(self.world, y.depth);
        (0..samples).map(|_| self.lit_once(y, &mut place, samples as f32, sampler, ancestors, rays)).sum()
    }

    /// One of `samples` of the light that falls on `y`.
    fn lit_once(
        &self,
        y: &EyeVertex,
        place: &mut Place,
        samples: f32,
        sampler: &mut PathSampler,
        ancestors: &[Ancestor],
        rays: &mut u64,
    ) -> Rgb {
        let (world, lights) = (self.world, self.world.lights());
        let (u_choice, u) = (sampler.next_1d(), sampler.next_2d());
        let p = y.hit.point.p;
        let Some(chosen) = lights.choose_at(place, u_choice) else { return Rgb::ZERO };
        let Some(sample) = lights.sample_of(world.scene(), p, chosen, u) else { return Rgb::ZERO };
        let Some(here) = scattering(world, &y.hit, &y.shading, sample.wi, y.hit.wo) else { return Rgb::ZERO };
        *rays += 1;
        let segment = World::segment(&y.hit.point, sample.wi, &sample.end);
        let crossings = (self.limits.segments - y.segments - 1).min(MOST_CROSSINGS);
        let visible = world.transmittance(&segment, crossings);
        if visible == Rgb::ZERO {
            return Rgb::ZERO;
        }
        let point = sample.point(chosen.0);
        let distance = (point.p - p).length();
        let per_point = |pdf_w| point.from_solid_angle(pdf_w, sample.wi, distance);
        let weighing = &self.plan.weighing;
        let own = weighing.sampled(y.depth == 0) * samples * per_point(sample.pdf_w);
        let met = if sample.delta { 0.0 } else { per_point(here.pdf_to_light) };
        let (begin, next) = lights.pdf_start(self.plan.starts, &point, -sample.wi);
        let onto_y = Density::from_light(&point, next).at(p, y.hit.n(), sample.wi);
        let at = weighing.landing(onto_y, IncidentFrom::light(&point, next, distance));
        let weight = if weighing.alike > 0.0 {
            let extended = matches!(sample.end, End::Surface(_));
            let mut whole = Whole::from_light(begin, met, extended, own);
            let joint = (onto_y, weighing.made(Way::Link, at), here.pdf_to_camera);
            y.ascend(weighing, joint, ancestors, &mut whole);
            whole.weight(Technique::Sampled, weighing.alike)
        } else {
            let merged = weighing.own(Way::Link, at) + y.nearer(weighing, onto_y, here.pdf_to_camera);
            weight(weighing.times(met / own, 1.0) + weighing.times(begin / own, merged))
        };
        let cos = y.hit.n().dot(sample.wi).abs();
        visible * sample.radiance * here.f * y.throughput * (cos * weight / (samples * sample.pdf_w))
    }

    fn emitted(&self, path: &[Vertex], v: &Vertex, depth: u32, behind: f32, above: Above) -> Rgb {
        let Some((radiance, light)) = self.world.emission(&v.hit) else { return Rgb::ZERO };
        let Some(parent) = path.get(v.parent as usize) else { return v.throughput * radiance };
        let point = LightPoint { light, p: v.hit.point.p, n: v.hit.seen_n(), far: false };
        let (begin, next) = self.world.lights().pdf_start(self.plan.starts, &point, v.hit.wo);
        let back = next * onto(v.hit.point.p, parent, v.hit.wo);
        let at = self.plan.weighing.landing(back, IncidentFrom::Point(between(parent, &v.hit)));
        let direct = match parent.delta {
            false if self.plan.weighing.emitters > 0.0 => {
                let samples = emitter_samples(self.world, depth - 1) as f32;
                let shading = self.world.shading(&parent.hit);
                samples * self.world.pdf_direct(&parent.hit, &shading, self.plan.seen, &point, -v.hit.wo)
            }
            _ => 0.0,
        };
        v.throughput
            * radiance
            * self.met((begin, v.pdf, direct), (true, depth == 1), (parent, back, at), (behind, above))
    }

    /// Weight of a camera's walk that meets a light: densities of its point by light paths, by this walk and by samples of
    /// lights; whether it is one of an extended light, and the vertex before the walk's first; that vertex and the density with which light's walk finds it.
    fn met(
        &self,
        (begin, own, direct): (f32, f32, f32),
        (extended, first): (bool, bool),
        (parent, back, at): (&Vertex, f32, Landing),
        (behind, above): (f32, Above),
    ) -> f32 {
        let (weighing, way) = (&self.plan.weighing, Way::of(parent.delta, false));
        if weighing.alike == 0.0 {
            let inner = weighing.add(way, at, back / parent.pdf, behind);
            return weight(weighing.times(begin / own, inner) + weighing.direct(first, direct / own));
        }
        let mut whole = Whole::from_light(begin, own, extended, weighing.sampled(first) * direct);
        let made = weighing.made(way, at);
        whole.nodes.push(Node { light: back, camera: parent.pdf, made, delta: parent.delta });
        whole.ascend(above.0, above.1);
        whole.weight(Technique::Met, weighing.alike)
    }

    fn escaped(&self, path: &[Vertex], escape: &Escape, depth: u32, behind: f32, above: Above) -> Rgb {
        if escape.segments == 1 && self.hide_lights {
            return Rgb::ZERO;
        }
        let parent = path.get(escape.parent as usize);
        let lights = self.world.lights();
        let one = |far: crate::light::FarLight| {
            let Some(parent) = parent else { return far.radiance };
            let point = LightPoint { light: far.light, p: Vec3::ZERO, n: Vec3::ZERO, far: true };
            let (begin, next) = lights.pdf_start(self.plan.starts, &point, -escape.d);
            let back = Density::Parallel(next).at(parent.hit.point.p, parent.hit.n(), escape.d);
            let at = self.plan.weighing.landing(back, IncidentFrom::Direction(next));
            let direct = if parent.delta { 0.0 } else { emitter_samples(self.world, depth) as f32 * far.pdf_w };
            far.radiance
                * self.met((begin, escape.pdf_w, direct), (false, depth == 0), (parent, back, at), (behind, above))
        };
        escape.throughput * lights.far_lights(escape.d).map(one).sum::<Rgb>()
    }
}

/// Emitter samples at a camera vertex of this depth. Where links take care of what comes by other surfaces, direct light of many lamps
/// on the first one is most of the noise that is left; what is found at the second one is for many pixels. Beyond it is one, as
/// light paths take it to be.
pub(super) fn emitter_samples(world: &World, depth: u32) -> u32 {
    let most = [8, 2, 1][depth.min(2) as usize];
    (world.lights().len() as u32).clamp(1, most)
}

/// 1/(1 + A); where nothing competes A may be 0 · ∞.
fn weight(others: f32) -> f32 {
    if others > 0.0 { 1.0 / (1.0 + others) } else { 1.0 }
}

fn between(a: &Vertex, b: &SurfaceHit) -> f32 {
    a.hit.point.p.distance(b.point.p)
}

/// Density per area at `to` of a walk from `from`, per density of the direction; `d` is parallel to the way.
fn onto(from: Vec3, to: &Vertex, d: Vec3) -> f32 {
    Density::Angle { from, pdf_w: 1.0 }.at(to.hit.point.p, to.hit.n(), d)
}
