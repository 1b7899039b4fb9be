//! Walks from the lights and from the camera, with what eq. 9 takes of them.
//!
//! Source: Bekaert et al. 2003, §5. Weights are sums of ratios p_j/p_{j+1} along either walk; what depends on one walk
//! alone is kept with its vertices (dVM, SmallVCM's name for the partial sum over merges). Camera paths are traced
//! again in each step instead of being stored, with the same random numbers.

use super::super::arrival::onto;
use super::{GKernel2003, footprint_radius, merge_weight};
use crate::film::Tile;
use crate::light::{FarLight, LightPoint, LightStart};
use crate::render::Shot;
use crate::subpath::{self, Density, Limits, Vertex, Walk};
use crate::world::{Shading, SurfaceHit, World};
use crate::{PathSampler, Rgb};
use glam::Vec3;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use translume_bxdf::Mode;

/// Random numbers of light paths, apart from those of pixels.
const STREAM: u64 = 1 << 63;

/// A place where a light path met a surface: x_k.
pub(super) struct LightVertex {
    pub(super) hit: SurfaceHit,
    /// Flux that arrives, over the density of the path.
    pub(super) throughput: Rgb,
    /// p^L(x_k | x_{k-1}, x_{k-2}), per area.
    pub(super) pdf: f32,
    pub(super) radius: f32,
    /// Number of the vertex before, or of the light's point where `segments` is 1.
    pub(super) parent: u32,
    pub(super) first: bool,
    pub(super) segments: u32,
    /// The vertex before scatters (or emits) in more than single directions: links to it can be made.
    pub(super) linked: bool,
    /// Chances with which roulette let the path come here, and surfaces in between let it pass straight.
    pub(super) survival: f32,
    pub(super) passed: f32,
    /// Density of the vertex before by a walk from here, per density of the direction.
    pub(super) back: f32,
    /// dVM, Σ p_j/p_{k-1} over techniques j < k-1 at vertices nearer to the light, up to p^E(x_{k-2}) (SmallVCM's name
    /// for the sum over merges).
    pub(super) d_vm: f32,
}

/// A place where a camera path met a surface: y.
pub(super) struct EyeVertex<'a> {
    pub(super) hit: SurfaceHit,
    pub(super) shading: Shading<'a>,
    /// Factor on radiance, pixel filter included.
    pub(super) throughput: Rgb,
    /// Number of the camera path in its block.
    pub(super) path: u32,
    pub(super) segments: u32,
    /// p^E(y), per area.
    pub(super) pdf: f32,
    pub(super) back: f32,
    /// dVM, Σ p_j/p_{y'} over techniques at the vertex y' before and nearer to the camera.
    pub(super) d_vm: f32,
}

/// The light paths of a step.
pub(super) struct LightPaths {
    pub(super) starts: Vec<LightStart>,
    pub(super) vertices: Vec<LightVertex>,
    pub(super) rays: u64,
}

/// The camera paths of some tiles: per path its tile, its pixel there, and the light that it met.
#[derive(Default)]
pub(super) struct EyePaths<'a> {
    pub(super) vertices: Vec<EyeVertex<'a>>,
    pub(super) pixels: Vec<(usize, usize)>,
    pub(super) radiance: Vec<Rgb>,
    pub(super) rays: u64,
}

/// `ratio` of densities of neighbouring techniques times what lies beyond; where nothing does the ratio may be 1/0.
pub(super) fn times(ratio: f32, beyond: f32) -> f32 {
    if beyond > 0.0 && ratio.is_finite() { ratio * beyond } else { 0.0 }
}

pub(super) fn flag(open: bool) -> f32 {
    f32::from(u8::from(open))
}

impl GKernel2003 {
    /// The light paths of a step, in an order that does not depend on threads.
    pub(super) fn trace_lights(
        &self,
        shot: &Shot,
        step: u64,
        count: u32,
        scale: (f32, f32),
        stop: &AtomicBool,
    ) -> LightPaths {
        let limits = Limits { segments: self.limits().segments.saturating_sub(1), ..self.limits() };
        let (world, starts) = (shot.world, shot.world.lights().by_power());
        let path = |i: u32| {
            let mut sampler = PathSampler::new(shot.seed, STREAM | step << 32 | u64::from(i), 0);
            let (mut rays, mut walk) = (0, Vec::new());
            let light = match stop.load(Relaxed) {
                false => subpath::light_path(world, starts, limits, &mut sampler, &mut rays, &mut walk),
                true => None,
            };
            (rays, light.map(|light| (light.start, light_vertices(&light, &walk, scale))))
        };
        let mut all = LightPaths { starts: Vec::new(), vertices: Vec::new(), rays: 0 };
        for (rays, path) in (0..count).into_par_iter().map(path).collect::<Vec<_>>() {
            all.rays += rays;
            let Some((start, vertices)) = path else { continue };
            let (own, base) = (all.starts.len() as u32, all.vertices.len() as u32);
            all.starts.push(start);
            let numbered = |v: LightVertex| LightVertex { parent: if v.first { own } else { base + v.parent }, ..v };
            all.vertices.extend(vertices.into_iter().map(numbered));
        }
        all
    }

    /// Camera paths number `set` of those pixels of `tiles` that are `wanted`: the same ones whenever they are asked
    /// for.
    pub(super) fn trace_eyes<'a>(
        &self,
        shot: &Shot<'a>,
        tiles: &[Tile],
        (set, kappa): (u64, f32),
        wanted: impl Fn(usize) -> bool + Sync,
        stop: &AtomicBool,
    ) -> EyePaths<'a> {
        let limits = self.limits();
        let walk = Walk { world: shot.world, mode: Mode::Radiance, limits, hide_lights: self.settings.hide_emitters };
        let of_tile = |(number, tile): (usize, &Tile)| {
            let (mut eyes, mut buffer) = (EyePaths::default(), Vec::new());
            for i in (0..tile.sums.len()).filter(|i| wanted(*i) && !stop.load(Relaxed)) {
                buffer.clear();
                let (mut sampler, ray, weight) = shot.camera_path(tile, i, set);
                let begin = (ray, Rgb::splat(weight), shot.camera_density(&ray));
                let (escape, _) = walk.run(begin, None, &mut sampler, &mut eyes.rays, &mut buffer);
                let path = EyePath::new(shot.world, &buffer, kappa);
                let (vertices, met) = path.vertices(eyes.radiance.len() as u32, limits.segments);
                let far = escape.filter(|e| e.segments > 1 || !self.settings.hide_emitters);
                eyes.vertices.extend(vertices);
                eyes.radiance.push(met + far.map_or(Rgb::ZERO, |e| path.escaped(&e)));
                eyes.pixels.push((number, i));
            }
            eyes
        };
        let mut all = EyePaths::default();
        for eyes in tiles.par_iter().enumerate().map(of_tile).collect::<Vec<_>>() {
            let base = all.radiance.len() as u32;
            all.vertices.extend(eyes.vertices.into_iter().map(|y| EyeVertex { path: y.path + base, ..y }));
            all.pixels.extend(eyes.pixels);
            all.radiance.extend(eyes.radiance);
            all.rays += eyes.rays;
        }
        all
    }
}

/// x_1, x_2, … of a light path with their footprints; `scale` is h and κ.
fn light_vertices(light: &subpath::LightPath, walk: &[Vertex], (h, kappa): (f32, f32)) -> Vec<LightVertex> {
    let mut path: Vec<LightVertex> = Vec::with_capacity(walk.len());
    let (start, point) = (&light.start, light.start.point());
    for v in walk {
        let parent = walk.get(v.parent as usize).map(|p| (p, &path[v.parent as usize]));
        let back = match parent {
            Some((p, _)) => onto(v.hit.point.p, &p.hit, v.hit.wo),
            None => point.from_solid_angle(1.0, v.hit.wo, (v.hit.point.p - point.p).length()),
        };
        let d_vm = match parent {
            // The camera's path may meet a light that has an extent.
            None => flag(!start.delta) / (kappa * start.pdf_begin()),
            Some((p, x)) => {
                let p_back = walk.get(p.parent as usize).map_or(light.pdf_back, |before| before.pdf_back);
                flag(x.linked && !p.delta) + times(p_back / x.pdf, x.d_vm)
            }
        };
        let (before, delta) = parent.map_or((0.0, false), |(p, x)| (x.radius, p.delta));
        path.push(LightVertex {
            hit: v.hit,
            throughput: v.throughput,
            pdf: v.pdf,
            // A mirror passes the footprint on as it is.
            radius: if delta { before } else { footprint_radius(h, v.pdf, before) },
            parent: v.parent,
            first: parent.is_none(),
            segments: v.segments,
            linked: !delta && v.pdf > 0.0 && v.survival > 0.0 && v.passed > 0.0,
            survival: v.survival,
            passed: v.passed,
            back,
            d_vm,
        });
    }
    path
}

/// A camera path.
struct EyePath<'a, 'b> {
    world: &'a World,
    walk: &'b [Vertex],
    kappa: f32,
    /// dVM of each vertex where the path goes on.
    d_vm: Vec<f32>,
}

impl<'a, 'b> EyePath<'a, 'b> {
    fn new(world: &'a World, walk: &'b [Vertex], kappa: f32) -> Self {
        let mut path = Self { world, walk, kappa, d_vm: Vec::with_capacity(walk.len()) };
        for v in walk {
            let d_vm = path.d_vm(v.parent, v.delta);
            path.d_vm.push(d_vm);
        }
        path
    }

    /// dVM of a vertex with this parent y' that is `delta` itself: Σ p_j/p_{y'} over y' and the vertices nearer to the
    /// camera.
    fn d_vm(&self, parent: u32, delta: bool) -> f32 {
        let Some(p) = self.walk.get(parent as usize) else { return 0.0 };
        let back = self.walk.get(p.parent as usize).map_or(0.0, |before| before.pdf_back);
        flag(!p.delta && !delta) + times(back / p.pdf, self.d_vm[parent as usize])
    }

    /// Its vertices that links can end at, as path number `path` of at most `max` segments, and the radiance of the
    /// lights that it meets.
    fn vertices(&self, path: u32, max: u32) -> (Vec<EyeVertex<'a>>, Rgb) {
        let (mut vertices, mut met) = (Vec::new(), Rgb::ZERO);
        for v in self.walk {
            let (parent, d_vm) = (self.walk.get(v.parent as usize), self.d_vm(v.parent, false));
            if let Some((radiance, light)) = self.world.emission(&v.hit) {
                let point = LightPoint { light, p: v.hit.point.p, n: v.hit.seen_n(), far: false };
                let onto = |p: &Vertex| onto(v.hit.point.p, &p.hit, v.hit.wo);
                let weight = parent.map_or(1.0, |p| self.weight_of_meeting((&point, v.hit.wo, v.pdf), onto(p), d_vm));
                met += v.throughput * radiance * weight;
            }
            let shading = self.world.shading(&v.hit);
            if shading.flags().has_smooth() && v.segments < max {
                let back = parent.map_or(0.0, |p| onto(v.hit.point.p, &p.hit, v.hit.wo));
                let (hit, throughput, pdf, segments) = (v.hit, v.throughput, v.pdf, v.segments);
                vertices.push(EyeVertex { hit, shading, throughput, path, segments, pdf, back, d_vm });
            }
        }
        (vertices, met)
    }

    /// The radiance of far lights, of a path that left the scene.
    fn escaped(&self, escape: &subpath::Escape) -> Rgb {
        let (parent, d_vm) = (self.walk.get(escape.parent as usize), self.d_vm(escape.parent, false));
        let one = |far: FarLight| {
            let point = LightPoint { light: far.light, p: Vec3::ZERO, n: Vec3::ZERO, far: true };
            let onto = |p: &Vertex| Density::Parallel(1.0).at(p.hit.point.p, p.hit.n(), escape.d);
            let met = (&point, -escape.d, escape.pdf_w);
            far.radiance * parent.map_or(1.0, |p| self.weight_of_meeting(met, onto(p), d_vm))
        };
        escape.throughput * self.world.lights().far_lights(escape.d).map(one).sum::<Rgb>()
    }

    /// The weight of meeting a light at `point` with density `pdf`, where it sends light along `d`, `onto` the vertex
    /// before per density of that.
    fn weight_of_meeting(&self, (point, d, pdf): (&LightPoint, Vec3, f32), onto: f32, d_vm: f32) -> f32 {
        let lights = self.world.lights();
        let (begin, next) = lights.pdf_start(lights.by_power(), point, d);
        merge_weight(0.0, times(self.kappa * begin * next * onto / pdf, d_vm))
    }
}
