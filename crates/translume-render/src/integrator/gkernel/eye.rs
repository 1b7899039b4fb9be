//! Camera paths of a step: their vertices wait for links; lights that they meet, or that emitter sampling finds, count
//! at once.
//!
//! Source: Bekaert et al. 2003, §4.1 and §5.

use super::super::arrival::{IncidentFrom, onto};
use super::share::{self, Continuation, Group, ReuseTarget, SuffixShare};
use super::weight::{LightPdf, MisWeights, Technique};
use super::{Block, Plan};
use crate::light::{LightPoint, Place};
use crate::subpath::{Density, Escape, Limits, PathState, Vertex, Walk, scattering};
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
    /// Factor on radiance, pixel filter included; of a suffix's, since its begin.
    pub(crate) throughput: Rgb,
    /// Luminance of the whole factor.
    pub(crate) gain: f32,
    /// Number of the camera path.
    pub(crate) path: u32,
    /// Number of the suffix that it belongs to: what is found here is for all paths that share it.
    pub(crate) suffix: Option<u32>,
    /// Of a path's first vertex: those that share suffixes with it.
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
    pub(crate) technique: Technique,
    /// dVC of the camera's walk ([`super::weight`]): what may happen behind the vertex before.
    pub(crate) d_vc: f32,
}

impl EyeVertex<'_> {
    /// What may happen nearer to the camera, where the light's walk finds this vertex with density `onto` per area and
    /// goes on with `pdf_to_camera` per solid angle: the sum of squares over that of the density here.
    #[inline]
    pub(crate) fn camera_sum(&self, weights: &MisWeights, onto: f32, pdf_to_camera: f32) -> f32 {
        let back = pdf_to_camera * self.back;
        let at = weights.light_pdf(back, IncidentFrom::Point(self.distance));
        weights.onward(onto / self.pdf, weights.sum(self.technique, at, back / self.before, self.d_vc))
    }
}

/// A traced path.
pub(crate) struct Eye<'a> {
    pub(crate) world: &'a World,
    pub(crate) limits: Limits,
    pub(crate) hide_lights: bool,
    pub(crate) plan: Plan<'a>,
}

/// A camera path that is under way.
pub(crate) struct CameraSubpath {
    /// Its pixel: the number of its tile, and its own number there.
    place: (u32, u32),
    /// In the picture.
    pub(super) pixel: [u32; 2],
    /// Direct emission by further rays at a light's silhouette, and how much the path's own counts.
    pub(super) supersampled: Rgb,
    pub(super) own_part: f32,
    state: PathState,
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
    ) -> CameraSubpath {
        let mut state = PathState::new((*ray, Rgb::splat(weight), density));
        let mut vertices = Vec::with_capacity(2);
        let escape = self.walk().follow(&mut state, 2, None, &mut sampler, rays, &mut vertices);
        CameraSubpath {
            place,
            pixel,
            supersampled: Rgb::ZERO,
            own_part: 1.0,
            state,
            vertices,
            escape,
            sampler,
            from: ray.o,
        }
    }

    /// What the first surface that a camera path meets emits.
    pub(super) fn direct_emission(&self, subpath: &CameraSubpath) -> Rgb {
        let first = subpath.vertices.first().filter(|v| v.segments == 1);
        first.map_or(Rgb::ZERO, |v| self.emitted(&subpath.vertices, v, 0, 0.0))
    }

    /// The same of a ray, not weighted.
    pub(super) fn direct_emission_along(&self, ray: &Ray) -> Rgb {
        let hit = if self.hide_lights { None } else { self.world.intersect(ray) };
        hit.and_then(|hit| self.world.emission(&hit)).map_or(Rgb::ZERO, |(radiance, _)| radiance)
    }

    /// Continues camera paths of neighbouring pixels: those that resemble each other share, `sharers` for each that
    /// goes on.
    pub(crate) fn continue_paths(&self, mut walks: Vec<CameraSubpath>, sharers: usize, block: &mut Block<'a>) {
        let base = block.radiance.len() as u32;
        for subpath in &walks {
            block.places.push(subpath.place);
            block.radiance.push(subpath.supersampled + self.direct_emission(subpath) * (subpath.own_part - 1.0));
        }
        if let [subpath] = &mut walks[..] {
            self.continue_path(base, subpath, None, Continuation::Alone, block);
            return;
        }
        let target =
            |(path, w): (u32, &CameraSubpath)| ReuseTarget::of(self.world, path, &w.vertices, self.limits.segments);
        let mut targets: Vec<Option<ReuseTarget>> = (base..).zip(&walks).map(target).collect();
        let number = |i: usize| base + i as u32;
        for (i, subpath) in walks.iter_mut().enumerate().filter(|(i, _)| targets[*i].is_none()) {
            self.continue_path(number(i), subpath, None, Continuation::Alone, block);
        }
        for i in 0..walks.len() {
            let Some(first) = targets[i].take() else { continue };
            let mut members = vec![i];
            let mut group = vec![first];
            for (j, other) in targets.iter_mut().enumerate().skip(i + 1) {
                if let Some(target) = other.take_if(|r| r.resembles(&group[0], walks[i].from)) {
                    members.push(j);
                    group.push(target);
                }
            }
            if group.len() == 1 {
                self.continue_path(number(i), &mut walks[i], None, Continuation::Alone, block);
                continue;
            }
            let representatives = group.len().div_ceil(sharers);
            // Representatives first: evenly among the rest.
            for k in 0..representatives {
                let at = k * group.len() / representatives;
                members.swap(k, at);
                group.swap(k, at);
            }
            let continuations: Vec<_> = (0..)
                .zip(&members)
                .map(|(own, j)| {
                    share::continuation(
                        self.world,
                        (&group, representatives, own),
                        &walks[*j].vertices,
                        &mut block.rays,
                    )
                })
                .collect();
            let first = block.eyes.len() as u32;
            let mut before: Option<usize> = None;
            for (own, (j, continuation)) in members.iter().zip(continuations).enumerate() {
                let is_representative = own < representatives;
                let begin = block.eyes.len();
                if let Some(group) = before.filter(|_| is_representative).and_then(|b| block.eyes[b].group.as_mut()) {
                    group.next = Some(begin as u32);
                }
                before = Some(begin);
                let shared = Group { first, next: None, is_representative, representatives: representatives as f32 };
                self.continue_path(number(*j), &mut walks[*j], Some(shared), continuation, block);
            }
        }
    }

    /// Follows a path to its end; appends its vertices, and the radiance of the lights that it meets.
    fn continue_path(
        &self,
        path: u32,
        subpath: &mut CameraSubpath,
        group: Option<Group>,
        continuation: Continuation,
        block: &mut Block<'a>,
    ) {
        let CameraSubpath { state, vertices, escape, sampler, .. } = subpath;
        let own = vertices.first().copied();
        let mut suffix = None;
        // Of the path at the suffix's begin.
        let mut factor = Rgb::ONE;
        if !matches!(continuation, Continuation::Alone) {
            // What the second vertex emits is for this path alone.
            block.radiance[path as usize] += self.emitted(vertices, &vertices[1], 1, 0.0);
        }
        match continuation {
            Continuation::Alone => (),
            Continuation::Ends => {
                vertices.truncate(1);
                state.end();
            }
            Continuation::Shared(seen, shares) => {
                let number = block.suffixes.len() as u32;
                suffix = Some(number);
                block.suffixes.push(Rgb::ZERO);
                block.shares.extend(shares.into_iter().map(|(path, factor)| SuffixShare {
                    suffix: number,
                    path,
                    factor,
                }));
                factor = vertices[1].throughput;
                // A path that is dark for its own pixel may be bright for others.
                state.begin_anew(seen[1].throughput);
                vertices.copy_from_slice(&*seen);
            }
        }
        if escape.is_none() {
            *escape = self.walk().follow(state, usize::MAX, None, sampler, &mut block.rays, vertices);
        }
        let mut emitters = sampler.branch(0x656d_6974);
        let (mut d_vc, mut depths) = (Vec::with_capacity(vertices.len()), Vec::with_capacity(vertices.len()));
        for (i, v) in own.iter().chain(vertices.iter().skip(1)).enumerate() {
            d_vc.push(self.d_vc(vertices, &d_vc, v.parent));
            depths.push(depths.get(v.parent as usize).map_or(0, |d| d + 1));
            let suffix = suffix.filter(|_| i > 0);
            let mut found = Rgb::ZERO;
            if i != 1 || suffix.is_none() {
                found += self.emitted(vertices, v, depths[i], d_vc[i]);
            }
            let shading = self.world.shading(&v.hit);
            if shading.flags().has_smooth() && v.segments < self.limits.segments {
                let parent = vertices.get(v.parent as usize);
                let y = EyeVertex {
                    hit: v.hit,
                    shading,
                    throughput: v.throughput,
                    gain: luminance(if suffix.is_some() { v.throughput * factor } else { v.throughput }),
                    path,
                    suffix,
                    group: group.filter(|_| i == 0),
                    segments: v.segments,
                    depth: depths[i],
                    pdf: v.pdf,
                    back: parent.map_or(0.0, |p| onto(v.hit.point.p, &p.hit, v.hit.wo)),
                    before: parent.map_or(1.0, |p| p.pdf),
                    distance: parent.map_or(0.0, |p| between(p, &v.hit)),
                    technique: Technique::of(parent.is_none_or(|p| p.delta), false),
                    d_vc: d_vc[i],
                };
                if self.plan.weights.emitters > 0.0 {
                    found += self.sample_emitters(&y, &mut emitters, &mut block.rays);
                }
                block.eyes.push(y);
            }
            *block.light_of(path, suffix) += found;
        }
        if let Some(escape) = escape {
            let depth = depths.get(escape.parent as usize).copied().unwrap_or(0);
            let d_vc = self.d_vc(vertices, &d_vc, escape.parent);
            let found = self.escaped(vertices, escape, depth, d_vc);
            *block.light_of(path, suffix) += found;
        }
    }

    /// dVC of a vertex whose parent has this number.
    fn d_vc(&self, path: &[Vertex], d_vc: &[f32], parent: u32) -> f32 {
        let Some(vertex) = path.get(parent as usize) else { return 0.0 };
        let Some(before) = path.get(vertex.parent as usize) else { return 0.0 };
        let weights = &self.plan.weights;
        let at = weights.light_pdf(before.pdf_back, IncidentFrom::Point(between(before, &vertex.hit)));
        let technique = Technique::of(before.delta, vertex.delta);
        weights.sum(technique, at, before.pdf_back / before.pdf, d_vc[parent as usize])
    }

    /// Emitter sampling at `y`.
    fn sample_emitters(&self, y: &EyeVertex, sampler: &mut PathSampler, rays: &mut u64) -> Rgb {
        let (p, n) = (y.hit.point.p, self.world.receiving_normal(&y.hit, &y.shading));
        let mut place = Place::new(p, n, self.plan.visibility.map(|s| s.from(p, n)));
        (0..emitter_samples(self.world, y.depth)).map(|_| self.sample_emitter(y, &mut place, sampler, rays)).sum()
    }

    /// One of the samples of the light that falls on `y`.
    fn sample_emitter(&self, y: &EyeVertex, place: &mut Place, sampler: &mut PathSampler, rays: &mut u64) -> Rgb {
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
        let (weights, samples) = (&self.plan.weights, emitter_samples(world, y.depth) as f32);
        let own = weights.emitter_factor(y.depth == 0) * samples * per_point(sample.pdf_w);
        let met = if sample.delta { 0.0 } else { per_point(here.pdf_to_light) };
        let (begin, next) = lights.pdf_start(self.plan.starts, &point, -sample.wi);
        let onto_y = Density::from_light(&point, next).at(p, y.hit.n(), sample.wi);
        let at = weights.light_pdf(onto_y, IncidentFrom::light(&point, next, distance));
        let linked = weights.density(Technique::Connect, at) + y.camera_sum(weights, onto_y, here.pdf_to_camera);
        let weight = weight(weights.onward(met / own, 1.0) + weights.onward(begin / own, linked));
        let cos = y.hit.n().dot(sample.wi).abs();
        visible * sample.radiance * here.f * y.throughput * (cos * weight / (samples * sample.pdf_w))
    }

    fn emitted(&self, path: &[Vertex], v: &Vertex, depth: u32, d_vc: f32) -> Rgb {
        let Some((radiance, light)) = self.world.emission(&v.hit) else { return Rgb::ZERO };
        let Some(parent) = path.get(v.parent as usize) else { return v.throughput * radiance };
        let point = LightPoint { light, p: v.hit.point.p, n: v.hit.seen_n(), far: false };
        let (begin, next) = self.world.lights().pdf_start(self.plan.starts, &point, v.hit.wo);
        let back = next * onto(v.hit.point.p, &parent.hit, v.hit.wo);
        let at = self.plan.weights.light_pdf(back, IncidentFrom::Point(between(parent, &v.hit)));
        let direct = match parent.delta {
            false if self.plan.weights.emitters > 0.0 => {
                let samples = emitter_samples(self.world, depth - 1) as f32;
                let shading = self.world.shading(&parent.hit);
                samples * self.world.pdf_direct(&parent.hit, &shading, self.plan.visibility, &point, -v.hit.wo)
            }
            _ => 0.0,
        };
        v.throughput * radiance * self.weight_of_meeting((begin, v.pdf, direct), depth == 1, (parent, back, at), d_vc)
    }

    /// Weight of a camera's walk that meets a light: densities of its point by light paths, by this walk and by samples
    /// of lights; whether the vertex before is the walk's first; that vertex and the density with which the light's
    /// walk finds it.
    fn weight_of_meeting(
        &self,
        (begin, own, direct): (f32, f32, f32),
        first: bool,
        (parent, back, at): (&Vertex, f32, LightPdf),
        d_vc: f32,
    ) -> f32 {
        let weights = &self.plan.weights;
        let linked = weights.sum(Technique::of(parent.delta, false), at, back / parent.pdf, d_vc);
        weight(weights.onward(begin / own, linked) + weights.emitter_sampling(first, direct / own))
    }

    fn escaped(&self, path: &[Vertex], escape: &Escape, depth: u32, d_vc: f32) -> Rgb {
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
            let at = self.plan.weights.light_pdf(back, IncidentFrom::Direction(next));
            let direct = if parent.delta { 0.0 } else { emitter_samples(self.world, depth) as f32 * far.pdf_w };
            far.radiance * self.weight_of_meeting((begin, escape.pdf_w, direct), depth == 0, (parent, back, at), d_vc)
        };
        escape.throughput * lights.far_lights(escape.d).map(one).sum::<Rgb>()
    }
}

/// Emitter samples at a camera vertex of this depth. Where links take care of what comes by other surfaces, direct
/// light of many lights on the first one is most of the noise that is left; what is found at the second one is for many
/// pixels. Beyond it is one, as light paths take it to be.
pub(super) fn emitter_samples(world: &World, depth: u32) -> u32 {
    let max = [8, 2, 1][depth.min(2) as usize];
    (world.lights().len() as u32).clamp(1, max)
}

/// 1/(1 + A); where nothing competes A may be 0 · ∞.
fn weight(others: f32) -> f32 {
    if others > 0.0 { 1.0 / (1.0 + others) } else { 1.0 }
}

fn between(a: &Vertex, b: &SurfaceHit) -> f32 {
    a.hit.point.p.distance(b.point.p)
}
