//! Bidirectional path tracing: every way to make a path out of a camera's and a light's sub-path, weighed together.
//!
//! Source: Veach 1997, chapter 10; power heuristic (exponent 2, section 9.2). A path of vertices x₀ (on the light) … x_k (on
//! the lens) is made by strategy (s, t), s vertices from the light and t = k + 1 − s from the camera:
//!
//! - s = 0: the camera's path meets a light or leaves the scene;
//! - s = 1: x₀ is drawn anew for x₁ by [`crate::light::Lights::sample`], as `path` does, and counts with that density;
//! - t = 1: a vertex of the light's path is joined to the lens and lands anywhere on the film;
//! - the rest: two vertices are joined.
//!
//! Lights seen directly are left to s = 0. With p_i the density of strategy (i, k + 1 − i), neighbours differ by the density
//! of one vertex, p_{i+1}/p_i = p_light(x_i)/p_camera(x_i), so weights are sums of products along the two sub-paths
//! ([`ratios`]). Of each sample of a pixel one camera and one light path are drawn; a pixel's light paths are those of all
//! pixels, which enters the density of t = 1. Infinitely far lights have the direction's density per solid angle in place
//! of x₀'s per area; every light is weighed on its own. Densities leave out roulette, straight passes and the reconstruction
//! filter: the weights are functions of the path alone and sum to one.
//!
//! Depth, roulette and `hide_emitters` are those of `path`. Limit: no participating media.

use super::{Integrator, Settings, Work};
use crate::light::{LightPoint, LightSample};
use crate::splat::Splat;
use crate::subpath::{self, Density, Escape, LightPath, Limits, Vertex, Walk, scattering};
use crate::world::{MOST_CROSSINGS, Shading, World};
use crate::{Result, Rgb};
use glam::Vec3;
use translume_bxdf::Mode;
use translume_core::sampler::Sampler;
use translume_trace::Ray;

/// See the module.
#[derive(Clone, Copy, Debug)]
pub struct Bdpt {
    settings: Settings,
    only: Option<fn(u32, u32) -> bool>,
    weighted: bool,
}

impl Bdpt {
    /// With these settings.
    pub fn new(settings: Settings) -> Self {
        Self { settings, only: None, weighted: true }
    }

    /// With the strategies (s, t) alone that `only` says, for figures and tests; without weights each is an estimate of all
    /// paths that it can make.
    pub fn with_strategies(settings: Settings, only: fn(u32, u32) -> bool, weighted: bool) -> Self {
        Self { settings, only: Some(only), weighted }
    }

    fn wants(&self, s: u32, t: u32) -> bool {
        self.only.is_none_or(|only| only(s, t))
    }

    /// The weight whose competitors' squared relative densities add up to `others`.
    fn weight(&self, others: f64) -> f32 {
        if self.weighted { (1.0 / (1.0 + others)) as f32 } else { 1.0 }
    }
}

/// Strategies are told apart up to this many vertices from either side; longer ones count with the longest.
const TOLD: u32 = 32;

fn part(s: u32, t: u32) -> usize {
    (s.min(TOLD - 1) * TOLD + t.min(TOLD - 1)) as usize
}

/// A sub-path with what connections want of its vertices.
struct Chain<'a> {
    vertices: Vec<Vertex>,
    shadings: Vec<Shading<'a>>,
    /// Vertices of the sub-path up to each, the light's or lens's point included.
    counts: Vec<u32>,
}

impl<'a> Chain<'a> {
    fn new(world: &'a World, vertices: Vec<Vertex>) -> Self {
        let mut counts: Vec<u32> = Vec::with_capacity(vertices.len());
        for v in &vertices {
            counts.push(counts.get(v.parent as usize).map_or(2, |n| n + 1));
        }
        Self { shadings: vertices.iter().map(|v| world.shading(&v.hit)).collect(), vertices, counts }
    }

    /// The vertices that can be joined, with their numbers.
    fn open(&self) -> impl Iterator<Item = (usize, &Vertex, &Shading<'a>)> {
        let all = self.vertices.iter().zip(&self.shadings).enumerate();
        all.map(|(i, (v, s))| (i, v, s)).filter(|(_, _, s)| s.flags().has_smooth())
    }

    fn parent(&self, of: &Vertex) -> Option<&Vertex> {
        self.vertices.get(of.parent as usize)
    }

    /// Density per area of the parent of `v` by a walk that goes on from `v` towards it with `pdf_w`; `None`: no parent.
    fn back_to_parent(&self, v: &Vertex, pdf_w: f32) -> Option<f32> {
        let parent = self.parent(v)?;
        Some(Density::Angle { from: v.hit.point.p, pdf_w }.at(parent.hit.point.p, parent.hit.n(), v.hit.wo))
    }
}

/// Where [`ratios`] begins.
struct From {
    /// Number of the vertex.
    at: usize,
    /// Density ratio so far.
    ratio: f64,
    /// Density of the vertex by the other side's walk.
    back: f32,
    /// That of its parent, if it differs from the one that the walk left there.
    parent_back: Option<f32>,
    /// The sub-path ends here: how it goes on was not drawn.
    end: bool,
}

/// Densities, relative to the strategy at hand, of those that make ever more vertices of a sub-path by the other side's walk:
/// `each` hears of the vertex that is given up, the ratio, and whether the edge before the vertex could be a connection. The
/// last ratio is returned.
fn ratios(chain: &Chain, from: &From, mut each: impl FnMut(&Vertex, f64, bool)) -> f64 {
    let From { mut ratio, mut back, mut parent_back, mut end, .. } = *from;
    let mut vertex = &chain.vertices[from.at];
    loop {
        ratio *= if vertex.pdf > 0.0 { f64::from(back) / f64::from(vertex.pdf) } else { 0.0 };
        let parent = chain.parent(vertex);
        each(vertex, ratio, (end || !vertex.delta) && parent.is_none_or(|p| !p.delta));
        let Some(parent) = parent else { return ratio };
        back = parent_back.take().unwrap_or(parent.pdf_back);
        end = false;
        vertex = parent;
    }
}

/// One sample of a pixel.
struct Sample<'a, 'w> {
    own: &'a Bdpt,
    world: &'a World,
    camera: Chain<'a>,
    light: Chain<'a>,
    path: Option<LightPath>,
    /// Per first vertex of the light path: density of its light's point by emitter sampling over that by the light's walk.
    direct: Vec<(u32, f64)>,
    max: u32,
    work: &'a mut Work<'w>,
}

impl Sample<'_, '_> {
    /// Σ (p/p_own)² over the strategies with fewer vertices from the camera.
    fn fewer_from_camera(&self, from: &From) -> f64 {
        let (mut sum, pixels) = (0.0, f64::from(self.work.view.pixels));
        ratios(&self.camera, from, |vertex, ratio, open| {
            // Given up the first vertex, what is left is the lens: as many light paths as pixels try that.
            let ratio = if vertex.parent == subpath::NONE { ratio * pixels } else { ratio };
            sum += if open { ratio * ratio } else { 0.0 };
        });
        sum
    }

    /// The same of the light, for joined vertices.
    fn fewer_from_light(&self, path: &LightPath, from: &From, start_back: f32) -> f64 {
        let mut sum = 0.0;
        let ratio = ratios(&self.light, from, |vertex, ratio, open| {
            if open {
                let ratio = if vertex.parent == subpath::NONE { ratio * self.direct_factor(vertex) } else { ratio };
                sum += ratio * ratio;
            }
        });
        if !path.start.delta {
            let ratio = ratio * f64::from(start_back) / f64::from(path.start.pdf_begin());
            sum += ratio * ratio;
        }
        sum
    }

    fn direct_factor(&self, first: &Vertex) -> f64 {
        let found = self.direct.iter().find(|(i, _)| std::ptr::eq(&self.light.vertices[*i as usize], first));
        found.map_or(0.0, |d| d.1)
    }

    /// Prepares [`Sample::direct_factor`].
    fn find_direct_factors(&mut self) {
        let Some(path) = &self.path else { return };
        let point = path.start.point();
        for (i, (v, shading)) in self.light.vertices.iter().zip(&self.light.shadings).enumerate() {
            if v.parent == subpath::NONE {
                let pdf = self.world.pdf_direct(&v.hit, shading, None, &point, v.hit.wo);
                self.direct.push((i as u32, f64::from(pdf) / f64::from(path.start.pdf_begin())));
            }
        }
    }

    fn count(&mut self, s: u32, t: u32, value: Rgb) {
        self.work.tally.add(part(s, t), value);
    }

    /// s = 0 on surfaces.
    fn emitted(&mut self) -> Rgb {
        let mut total = Rgb::ZERO;
        for i in 0..self.camera.vertices.len() {
            let (v, t) = (&self.camera.vertices[i], self.camera.counts[i]);
            let Some((radiance, light)) = self.world.emission(&v.hit) else { continue };
            if !self.own.wants(0, t) {
                continue;
            }
            let point = LightPoint { light, p: v.hit.point.p, n: v.hit.seen_n(), far: false };
            let others = match self.camera.parent(v) {
                None => 0.0,
                Some(parent) => {
                    let lights = self.world.lights();
                    let (begin, next) = lights.pdf_start(lights.by_power(), &point, v.hit.wo);
                    let parent_back = self.camera.back_to_parent(v, next);
                    let direct = self.pdf_direct(parent, v.parent, &point, -v.hit.wo);
                    let direct = if v.pdf > 0.0 { f64::from(direct) / f64::from(v.pdf) } else { 0.0 };
                    let from = From { at: i, ratio: 1.0, back: begin, parent_back, end: true };
                    self.unless_direct(&from, direct, parent.delta)
                }
            };
            let value = v.throughput * radiance * self.own.weight(others);
            self.count(0, t, value);
            total += value;
        }
        total
    }

    /// s = 0, infinitely far.
    fn escaped(&mut self, escape: &Escape) -> Rgb {
        let t = self.camera.counts.get(escape.parent as usize).map_or(2, |n| n + 1);
        let mut total = Rgb::ZERO;
        if escape.segments == 1 && self.own.settings.hide_emitters || !self.own.wants(0, t) {
            return total;
        }
        let (world, d) = (self.world, escape.d);
        for far in world.lights().far_lights(d) {
            let others = match self.camera.vertices.get(escape.parent as usize) {
                None => 0.0,
                Some(parent) => {
                    let point = LightPoint { light: far.light, p: Vec3::ZERO, n: Vec3::ZERO, far: true };
                    let (begin, next) = world.lights().pdf_start(world.lights().by_power(), &point, -d);
                    let back = Density::Parallel(next).at(parent.hit.point.p, parent.hit.n(), d);
                    let own = f64::from(escape.pdf_w);
                    let ratio = f64::from(begin) / own;
                    let from = From { at: escape.parent as usize, ratio, back, parent_back: None, end: false };
                    let direct = if parent.delta { 0.0 } else { f64::from(far.pdf_w) / own };
                    direct * direct + self.fewer_from_camera(&from)
                }
            };
            let value = escape.throughput * far.radiance * self.own.weight(others);
            self.count(0, t, value);
            total += value;
        }
        total
    }

    /// Like [`Sample::fewer_from_camera`], but giving up the first vertex is emitter sampling with its own ratio.
    fn unless_direct(&self, from: &From, direct: f64, parent_delta: bool) -> f64 {
        let end = &self.camera.vertices[from.at];
        let ratio = if end.pdf > 0.0 { f64::from(from.back) / f64::from(end.pdf) } else { 0.0 };
        let above = From {
            at: end.parent as usize,
            ratio: from.ratio * ratio,
            back: from.parent_back.unwrap_or(0.0),
            parent_back: None,
            end: false,
        };
        let direct = if parent_delta { 0.0 } else { direct };
        direct * direct + self.fewer_from_camera(&above)
    }

    /// Density of emitter sampling at the camera's vertex number `i` for a point of a light along `wi`.
    fn pdf_direct(&self, v: &Vertex, i: u32, point: &LightPoint, wi: Vec3) -> f32 {
        self.world.pdf_direct(&v.hit, &self.camera.shadings[i as usize], None, point, wi)
    }

    /// s = 1.
    fn direct(&mut self) -> Rgb {
        let mut sampler = self.work.sampler.branch(1);
        let mut total = Rgb::ZERO;
        for i in 0..self.camera.vertices.len() {
            let t = self.camera.counts[i];
            let (v, shading) = (&self.camera.vertices[i], &self.camera.shadings[i]);
            if !shading.flags().has_smooth() || v.segments >= self.max || !self.own.wants(1, t) {
                continue;
            }
            let n = self.world.receiving_normal(&v.hit, shading);
            let (u_choice, u) = (sampler.next_1d(), sampler.next_2d());
            let (p, lights) = (v.hit.point.p, self.world.lights());
            let chosen = lights.choose(p, n, u_choice);
            let sample = |of: (usize, f32)| Some((of.0, lights.sample_of(self.world.scene(), p, of, u)?));
            let value = match chosen.and_then(sample) {
                Some((light, sample)) => self.direct_from(i, light, &sample),
                None => Rgb::ZERO,
            };
            self.count(1, t, value);
            total += value;
        }
        total
    }

    fn direct_from(&mut self, i: usize, light: usize, sample: &LightSample) -> Rgb {
        let (v, shading) = (&self.camera.vertices[i], &self.camera.shadings[i]);
        let (world, wi, p) = (self.world, sample.wi, v.hit.point.p);
        let Some(here) = scattering(world, &v.hit, shading, wi, v.hit.wo) else { return Rgb::ZERO };
        self.work.rays += 1;
        let crossings = (self.max - v.segments - 1).min(MOST_CROSSINGS);
        let visible = world.transmittance(&World::segment(&v.hit.point, wi, &sample.end), crossings);
        if visible == Rgb::ZERO {
            return visible;
        }
        let point = sample.point(light);
        let distance = (point.p - p).length();
        let direct = f64::from(point.from_solid_angle(sample.pdf_w, wi, distance));
        let (begin, next) = world.lights().pdf_start(world.lights().by_power(), &point, -wi);
        let from = From {
            at: i,
            ratio: f64::from(begin) / direct,
            back: Density::from_light(&point, next).at(p, v.hit.n(), wi),
            parent_back: self.camera.back_to_parent(v, here.pdf_to_camera),
            end: true,
        };
        let hit = match sample.delta {
            true => 0.0,
            false => f64::from(point.from_solid_angle(here.pdf_to_light, wi, distance)) / direct,
        };
        let weight = self.own.weight(hit * hit + self.fewer_from_camera(&from));
        let cos = v.hit.n().dot(wi).abs();
        v.throughput * visible * sample.radiance * here.f * (cos * weight / sample.pdf_w)
    }

    /// Density of what lies before the vertex `v` of the light's path, its parent or the light's point, by a walk that goes
    /// on there from `v` with `pdf_w`: of the parent if there is one, and of the light's point.
    fn back_of_light(&self, path: &LightPath, v: &Vertex, pdf_w: f32) -> (Option<f32>, f32) {
        match self.light.back_to_parent(v, pdf_w) {
            Some(parent) => (Some(parent), path.pdf_back),
            None => {
                let point = path.start.point();
                (None, point.from_solid_angle(pdf_w, v.hit.wo, (point.p - v.hit.point.p).length()))
            }
        }
    }

    /// t = 1.
    fn land(&mut self, lens: glam::Vec2) {
        let Some(path) = self.path else { return };
        for i in 0..self.light.vertices.len() {
            let (v, shading, s) = (self.light.vertices[i], &self.light.shadings[i], self.light.counts[i]);
            if !shading.flags().has_smooth() || v.segments >= self.max || !self.own.wants(s, 1) {
                continue;
            }
            let view = self.work.view;
            let mut value = Rgb::ZERO;
            if let Some(camera) = view.camera.sample_importance(v.hit.point.p, lens, view.margin)
                && let Some(here) = scattering(self.world, &v.hit, shading, v.hit.wo, camera.wi)
            {
                self.work.rays += 1;
                let crossings = (self.max - v.segments - 1).min(MOST_CROSSINGS);
                let hide = self.own.settings.hide_emitters;
                let visible = self.world.transmittance_to_camera(&camera, &v.hit, hide, crossings);
                if visible != Rgb::ZERO {
                    let back = camera.weight * v.hit.n().dot(camera.wi).abs();
                    let (parent_back, start_back) = self.back_of_light(&path, &v, here.pdf_to_light);
                    let from = From { at: i, ratio: 1.0 / f64::from(view.pixels), back, parent_back, end: true };
                    let weight = self.own.weight(self.fewer_from_light(&path, &from, start_back));
                    value = v.throughput * visible * here.f * (back * weight);
                    self.work.splats.push(Splat { film: camera.film, value });
                }
            }
            self.count(s, 1, value / self.work.view.pixels);
        }
    }

    /// s ≥ 2, t ≥ 2.
    fn joined(&mut self) -> Rgb {
        let Some(path) = self.path else { return Rgb::ZERO };
        let mut total = Rgb::ZERO;
        let camera: Vec<usize> = self.camera.open().map(|(i, ..)| i).collect();
        let light: Vec<usize> = self.light.open().map(|(i, ..)| i).collect();
        for &c in &camera {
            for &l in &light {
                let (t, s) = (self.camera.counts[c], self.light.counts[l]);
                let segments = self.camera.vertices[c].segments + self.light.vertices[l].segments + 1;
                if segments > self.max || !self.own.wants(s, t) {
                    continue;
                }
                let value = self.join(&path, l, c, self.max - segments);
                self.count(s, t, value);
                total += value;
            }
        }
        total
    }

    fn join(&mut self, path: &LightPath, l: usize, c: usize, crossings: u32) -> Rgb {
        let (y, z) = (&self.light.vertices[l], &self.camera.vertices[c]);
        let way = z.hit.point.p - y.hit.point.p;
        let distance2 = way.length_squared();
        let Some(d) = way.try_normalize() else { return Rgb::ZERO };
        let world = self.world;
        let Some(at_y) = scattering(world, &y.hit, &self.light.shadings[l], y.hit.wo, d) else { return Rgb::ZERO };
        let Some(at_z) = scattering(world, &z.hit, &self.camera.shadings[c], -d, z.hit.wo) else { return Rgb::ZERO };
        self.work.rays += 1;
        let segment = z.hit.point.segment_between(&y.hit.point);
        let visible = world.transmittance(&segment, crossings.min(MOST_CROSSINGS));
        if visible == Rgb::ZERO {
            return visible;
        }
        let (cos_y, cos_z) = (y.hit.n().dot(d).abs(), z.hit.n().dot(d).abs());
        let (parent_back, start_back) = self.back_of_light(path, y, at_y.pdf_to_light);
        let of_light = From { at: l, ratio: 1.0, back: at_z.pdf_to_light * cos_y / distance2, parent_back, end: true };
        let of_camera = From {
            at: c,
            ratio: 1.0,
            back: at_y.pdf_to_camera * cos_z / distance2,
            parent_back: self.camera.back_to_parent(z, at_z.pdf_to_camera),
            end: true,
        };
        let others = self.fewer_from_light(path, &of_light, start_back) + self.fewer_from_camera(&of_camera);
        let geometry = cos_y * cos_z / distance2;
        y.throughput * at_y.f * visible * at_z.f * z.throughput * (geometry * self.own.weight(others))
    }
}

impl Integrator for Bdpt {
    fn splats(&self) -> bool {
        true
    }

    fn check(&self, world: &World) -> Result<()> {
        self.settings.without_media("bdpt", world)
    }

    fn part(&self, part: usize) -> String {
        format!("s={} t={}", part as u32 / TOLD, part as u32 % TOLD)
    }

    fn radiance(&self, world: &World, ray: &Ray, work: &mut Work) -> Rgb {
        let max = self.settings.most_segments();
        if max == 0 {
            return Rgb::ZERO;
        }
        let rr_depth = self.settings.rr_depth;
        let mut light_sampler = work.sampler.branch(0);
        let mut vertices = Vec::with_capacity(16);
        let limits = Limits { segments: max - 1, rr_depth };
        let path = subpath::light_path(
            world,
            world.lights().by_power(),
            limits,
            &mut light_sampler,
            &mut work.rays,
            &mut vertices,
        );
        let light = Chain::new(world, vertices);

        let camera = work.view.camera;
        let density = camera.arrival(ray);
        let limits = Limits { segments: max, rr_depth };
        let walk = Walk { world, mode: Mode::Radiance, limits, hide_lights: self.settings.hide_emitters };
        let mut vertices = Vec::with_capacity(16);
        let begin = (*ray, Rgb::ONE, density);
        let (escape, _) = walk.run(begin, None, &mut work.sampler, &mut work.rays, &mut vertices);
        let camera = Chain::new(world, vertices);

        let mut sample = Sample { own: self, world, camera, light, path, direct: Vec::new(), max, work };
        sample.find_direct_factors();
        let mut radiance = sample.emitted() + sample.direct() + sample.joined();
        if let Some(escape) = escape {
            radiance += sample.escaped(&escape);
        }
        sample.land(light_sampler.next_2d());
        radiance
    }
}
