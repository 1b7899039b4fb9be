//! Lights: what they emit, how one is chosen, how points on them and directions to them are drawn.
//!
//! Every emitting triangle is a light of its own, but for meshes that stand in many places: see `mesh`. [`Lights::sample`] is emitter sampling as integrators want it: choice
//! (infinite lights by equal chances, all others by a light tree) and place in one step, with the density of both together.
//! [`Lights::start`] begins light paths, with the densities of position and direction apart.

mod environment;
mod mesh;
mod point;
mod seen;
mod shape;
mod tree;

use crate::world::Surface;
use crate::{Rgb, luminance};
use environment::Environment;
use glam::{Vec2, Vec3};
pub(crate) use mesh::{Faces, MeshLight, bright_normal};
use point::PointLight;
pub(crate) use seen::{LightVisibilityCache, VisibilitySample};
pub(crate) use shape::{Form as ShapeForm, Quadric, ShapeLight, mesh_place, uv_of_sphere};
use std::f32::consts::{PI, TAU};
use translume_core::distribution::AliasTable;
use translume_core::frame::Frame;
use translume_core::warp;
use translume_scene::Scene;
use translume_scene::emitter::Emitter;
use translume_trace::SurfacePoint;
pub(crate) use tree::Place;
use tree::{LightBounds, LightTree};

/// Lights are not taken to be stronger when chances are computed.
const MOST_POWER: f32 = 1e20;

/// The other end of a connection to a light.
#[derive(Clone, Copy, Debug)]
pub enum End {
    /// A point of an emitting surface.
    Surface(SurfacePoint),
    /// A point in space.
    Point(Vec3),
    /// Infinitely far away.
    Far,
}

/// A direction to a light.
#[derive(Clone, Copy, Debug)]
pub struct LightSample {
    /// Unit direction to the light.
    pub wi: Vec3,
    /// Radiance from there; for lights without extent the irradiance on a plane that faces them.
    pub radiance: Rgb,
    /// Density per solid angle, choice included; for lights without extent the probability of the choice.
    pub pdf_w: f32,
    /// The light has no extent: no other way of sampling finds it.
    pub delta: bool,
    /// Where the light is.
    pub end: End,
}

impl LightSample {
    /// The light's point; `light` is its number.
    pub fn point(&self, light: usize) -> LightPoint {
        match &self.end {
            End::Surface(q) => LightPoint { light, p: q.p, n: q.ng, far: false },
            End::Point(q) => LightPoint { light, p: *q, n: Vec3::ZERO, far: false },
            End::Far => LightPoint { light, p: Vec3::ZERO, n: Vec3::ZERO, far: true },
        }
    }
}

/// The begin of a light path.
#[derive(Clone, Copy, Debug)]
pub struct LightStart {
    /// Where from.
    pub origin: End,
    /// A point on the ray (for infinite lights: outside the scene).
    pub p: Vec3,
    /// The emitting surface's normal; for lights without surface the direction.
    pub n: Vec3,
    /// Unit direction.
    pub direction: Vec3,
    /// Radiance along it (for points: intensity; parallel light: irradiance).
    pub radiance: Rgb,
    /// Probability of the light.
    pub choice: f32,
    /// Density of the position per area (infinite lights: per area perpendicular to the direction; points: 1).
    pub pdf_a: f32,
    /// Density of the direction per solid angle (parallel light: 1).
    pub pdf_w: f32,
    /// Number of the light.
    pub light: usize,
    /// The light has no extent: no other way of sampling finds it.
    pub delta: bool,
}

/// A point of a light, or a direction to one that is infinitely far: where a light path would begin.
#[derive(Clone, Copy, Debug)]
pub struct LightPoint {
    /// Number of the light.
    pub light: usize,
    /// Its place; of no meaning for lights far away.
    pub p: Vec3,
    /// The normal there; zero for lights without a surface.
    pub n: Vec3,
    /// Infinitely far away.
    pub far: bool,
}

impl LightPoint {
    /// A density per solid angle of directions to this point, from a point `distance` away along `wi`, as density of the
    /// point itself: per area on surfaces; without extent or far away it stays what it is.
    #[inline]
    pub fn from_solid_angle(&self, pdf_w: f32, wi: Vec3, distance: f32) -> f32 {
        if self.far || self.n == Vec3::ZERO { pdf_w } else { pdf_w * self.n.dot(wi).abs() / (distance * distance) }
    }
}

impl LightStart {
    /// Where the path begins.
    pub fn point(&self) -> LightPoint {
        let far = matches!(self.origin, End::Far);
        let n = if matches!(self.origin, End::Surface(_)) { self.n } else { Vec3::ZERO };
        LightPoint { light: self.light, p: self.p, n, far }
    }

    /// Density of the begin, choice included: of the place per area, of far lights of the direction per solid angle; of
    /// lights without extent the probability.
    pub fn pdf_begin(&self) -> f32 {
        self.choice * if matches!(self.origin, End::Far) { self.pdf_w } else { self.pdf_a }
    }

    /// Density of what follows: of the direction per solid angle, of far lights of the place per area perpendicular to it.
    pub fn pdf_next(&self) -> f32 {
        if matches!(self.origin, End::Far) { self.pdf_a } else { self.pdf_w }
    }

    /// Flux of the path: radiance and cosine over the density.
    pub fn throughput(&self) -> Rgb {
        let cos = if matches!(self.origin, End::Surface(_)) { self.n.dot(self.direction).abs() } else { 1.0 };
        self.radiance * (cos / (self.choice * self.pdf_a * self.pdf_w))
    }

    /// The path's first ray.
    pub fn ray(&self) -> translume_trace::Ray {
        match &self.origin {
            End::Surface(point) => point.spawn(self.direction),
            _ => translume_trace::Ray::new(self.p, self.direction),
        }
    }
}

/// One infinitely far light in some direction.
#[derive(Clone, Copy, Debug)]
pub struct FarLight {
    /// Number of the light.
    pub light: usize,
    /// Radiance from there.
    pub radiance: Rgb,
    /// Density per solid angle with which [`Lights::sample`] draws the direction, choice included.
    pub pdf_w: f32,
}

/// A light.
#[derive(Clone, Debug)]
pub(crate) enum Light {
    Shape(ShapeLight),
    Point(PointLight),
    /// Direction of travel and irradiance.
    Directional {
        direction: Vec3,
        irradiance: Rgb,
    },
    Environment(Box<Environment>),
    Constant {
        radiance: Rgb,
    },
}

/// Chances of lights to begin light paths.
#[derive(Clone, Debug)]
pub struct Starts(Option<AliasTable>);

/// All lights of a scene.
pub struct Lights {
    pub(crate) lights: Vec<Light>,
    tree: LightTree,
    /// Numbers of the infinitely far ones.
    far: Vec<usize>,
    by_power: Starts,
    /// See [`Lights::typical`].
    typical: f64,
    /// The scene's bounding sphere.
    center: Vec3,
    radius: f32,
}

impl Lights {
    /// `shapes` are the lights of surfaces, in the order that [`Surface::first_light`] counts.
    pub(crate) fn new(scene: &Scene, shapes: Vec<ShapeLight>, (center, radius): (Vec3, f32)) -> Self {
        let mut lights: Vec<Light> = shapes.into_iter().map(Light::Shape).collect();
        lights.extend(scene.emitters.iter().map(|e| compile(scene, e)));
        let mut bounds: Vec<Option<LightBounds>> = lights
            .iter()
            .map(|light| match light {
                Light::Shape(s) => s.bounds(),
                Light::Point(p) => Some(p.bounds()),
                _ => None,
            })
            .collect();
        let far = (0..lights.len()).filter(|&i| lights[i].is_far() && lights[i].far_power(radius) > 0.0).collect();
        let power = |light: &Light, bounds: &Option<LightBounds>| {
            bounds.as_ref().map_or_else(|| light.far_power(radius), |b| b.power).clamp(0.0, f32::MAX)
        };
        let mut powers: Vec<f32> = lights.iter().zip(&bounds).map(|(light, bounds)| power(light, bounds)).collect();
        let sum: f64 = powers.iter().map(|p| f64::from(*p)).sum();
        let typical = sum / (4.0 * f64::from(PI * PI) * f64::from(radius) * f64::from(radius));
        // Sums of powers, and what is made of them, must stay finite; their unit does not matter.
        let most = powers.iter().copied().fold(0.0, f32::max);
        if most > MOST_POWER {
            let scaled = |p: f32| if p > 0.0 { (p * (MOST_POWER / most)).max(f32::MIN_POSITIVE) } else { 0.0 };
            powers.iter_mut().for_each(|p| *p = scaled(*p));
            bounds.iter_mut().flatten().for_each(|b| b.power = scaled(b.power.clamp(0.0, f32::MAX)));
        }
        Self {
            tree: LightTree::new(&bounds),
            far,
            by_power: Starts(AliasTable::new(&powers)),
            typical,
            lights,
            center,
            radius,
        }
    }

    /// The radiance that there would be if all light were spread evenly over the sphere around the scene.
    pub fn typical(&self) -> f64 {
        self.typical
    }

    /// Whether nothing shines.
    pub fn is_empty(&self) -> bool {
        self.tree.is_empty() && self.far.is_empty()
    }

    /// How many lights there are; each emitting triangle counts.
    pub fn len(&self) -> usize {
        self.lights.len()
    }

    /// Chance that an infinite light is chosen.
    fn far_share(&self) -> f32 {
        let far = self.far.len() as f32;
        far / (far + if self.tree.is_empty() { 0.0 } else { 1.0 })
    }

    /// Draws a direction to a light from `p`. `n` is the receiving normal, or zero where light may come from any side. `None`:
    /// the light that was chosen does not shine here.
    #[inline]
    pub fn sample(&self, scene: &Scene, p: Vec3, n: Vec3, u_choice: f32, u: Vec2) -> Option<LightSample> {
        let chosen = self.choose(p, n, u_choice)?;
        self.sample_of(scene, p, chosen, u)
    }

    /// Chooses a light for `p` and `n`; its number and its probability. `None`: none shines here.
    #[inline]
    pub(crate) fn choose(&self, p: Vec3, n: Vec3, u: f32) -> Option<(usize, f32)> {
        self.choose_by(u, |u| self.tree.sample(p, n, None, u))
    }

    /// The same at a place that asks several times, by what is known of the lights that are seen there.
    #[inline]
    pub(crate) fn choose_at(&self, place: &mut Place, u: f32) -> Option<(usize, f32)> {
        self.choose_by(u, |u| self.tree.sample_at(place, u))
    }

    #[inline(always)]
    fn choose_by(&self, u: f32, near: impl FnOnce(f32) -> Option<(usize, f32)>) -> Option<(usize, f32)> {
        if self.is_empty() {
            return None;
        }
        let share = self.far_share();
        if u < share {
            let i = (u / share * self.far.len() as f32) as usize;
            return Some((self.far[i.min(self.far.len() - 1)], share / self.far.len() as f32));
        }
        let u = ((u - share) / (1.0 - share)).min(warp::ONE_MINUS_EPSILON);
        let (index, pmf) = near(u)?;
        Some((index, pmf * (1.0 - share)))
    }

    /// Learns from what was tried.
    pub(crate) fn learn(&self, tried: Vec<VisibilitySample>) -> Option<LightVisibilityCache> {
        LightVisibilityCache::learn(&self.tree, tried)
    }

    /// Draws a direction from `p` to a light that was chosen with a probability. `None`: it does not shine here.
    #[inline]
    pub(crate) fn sample_of(
        &self,
        scene: &Scene,
        p: Vec3,
        (index, choice): (usize, f32),
        u: Vec2,
    ) -> Option<LightSample> {
        let mut sample = match &self.lights[index] {
            Light::Shape(s) => s.sample(scene, p, u)?,
            Light::Point(s) => s.sample(scene, p)?,
            Light::Directional { direction, irradiance } => {
                LightSample { wi: -*direction, radiance: *irradiance, pdf_w: 1.0, delta: true, end: End::Far }
            }
            Light::Environment(e) => e.sample(u)?,
            Light::Constant { radiance } => LightSample {
                wi: warp::uniform_sphere(u.x, u.y),
                radiance: *radiance,
                pdf_w: warp::UNIFORM_SPHERE_PDF,
                delta: false,
                end: End::Far,
            },
        };
        sample.pdf_w *= choice;
        (sample.pdf_w > 0.0 && sample.pdf_w.is_finite() && sample.radiance != Rgb::ZERO).then_some(sample)
    }

    /// Density of [`Lights::sample`] at (`p`, `n`) for the point `q` of a light, which lies along `wi`: per area of the
    /// light's surface; for far lights per solid angle; for lights without extent the probability. `seen` as in the choice.
    pub(crate) fn pdf_direct(
        &self,
        p: Vec3,
        n: Vec3,
        seen: Option<&LightVisibilityCache>,
        q: &LightPoint,
        wi: Vec3,
    ) -> f32 {
        let near = 1.0 - self.far_share();
        let far = if self.far.contains(&q.light) { self.far_share() / self.far.len() as f32 } else { 0.0 };
        let probability = || self.tree.probability(p, n, seen.map(|s| s.from(p, n)), q.light);
        match &self.lights[q.light] {
            Light::Shape(s) => q.from_solid_angle(near * probability() * s.pdf_w(p, q.p, q.n), wi, (q.p - p).length()),
            Light::Point(_) => near * probability(),
            Light::Directional { .. } => far,
            Light::Environment(e) => far * e.eval_pdf(wi).1,
            Light::Constant { .. } => far * warp::UNIFORM_SPHERE_PDF,
        }
    }

    /// Chances by power.
    pub fn by_power(&self) -> &Starts {
        &self.by_power
    }

    /// Chances of which `share` is by `weights`, one for each light (or none at all), and what remains by power.
    pub fn starts_by(&self, weights: &[f32], share: f32) -> Starts {
        let sum: f64 = weights.iter().map(|w| f64::from(*w)).sum();
        let share = if sum > 0.0 && sum.is_finite() { share } else { 0.0 };
        let mix = |i: usize| {
            let learnt = if share > 0.0 { share * (f64::from(weights[i]) / sum) as f32 } else { 0.0 };
            (1.0 - share) * self.by_power.probability(i) + learnt
        };
        Starts(AliasTable::new(&(0..self.lights.len()).map(mix).collect::<Vec<_>>()))
    }

    /// Densities of [`Lights::start`] for the begin `q` and the direction `d` of travel, as [`LightStart::pdf_begin`] and
    /// [`LightStart::pdf_next`] have them.
    pub fn pdf_start(&self, starts: &Starts, q: &LightPoint, d: Vec3) -> (f32, f32) {
        let choice = starts.probability(q.light);
        let disk = 1.0 / (PI * self.radius * self.radius);
        match &self.lights[q.light] {
            Light::Shape(s) => (choice * s.pdf_a(q.p), q.n.dot(d).max(0.0) / PI),
            Light::Point(s) => (choice, s.pdf_w(d)),
            Light::Directional { .. } => (choice, disk),
            Light::Environment(e) => (choice * e.eval_pdf(-d).1, disk),
            Light::Constant { .. } => (choice * warp::UNIFORM_SPHERE_PDF, disk),
        }
    }

    /// Radiance (points: intensity) that the light of `start` sends from there along `d`; nothing behind its surface.
    pub fn emitted(&self, scene: &Scene, start: &LightStart, d: Vec3) -> Rgb {
        match &self.lights[start.light] {
            Light::Point(s) => s.intensity(scene, d),
            Light::Shape(_) if start.n.dot(d) <= 0.0 => Rgb::ZERO,
            _ => start.radiance,
        }
    }

    /// The infinitely far lights with extent, each as seen along `d`.
    pub fn far_lights(&self, d: Vec3) -> impl Iterator<Item = FarLight> {
        let chance = self.far_share() / self.far.len().max(1) as f32;
        self.far.iter().filter_map(move |&light| {
            let (radiance, pdf_w) = match &self.lights[light] {
                Light::Environment(e) => e.eval_pdf(d),
                Light::Constant { radiance } => (*radiance, warp::UNIFORM_SPHERE_PDF),
                _ => return None,
            };
            Some(FarLight { light, radiance, pdf_w: pdf_w * chance })
        })
    }

    /// Density with which [`Lights::sample`] at (`p`, `n`) draws the direction to the point `q` of light `light`, whose
    /// normal there is `nq`.
    #[inline]
    pub fn pdf_surface(&self, p: Vec3, n: Vec3, light: usize, q: Vec3, nq: Vec3) -> f32 {
        let Light::Shape(shape) = &self.lights[light] else { return 0.0 };
        (1.0 - self.far_share()) * self.tree.probability(p, n, None, light) * shape.pdf_w(p, q, nq)
    }

    /// Begins a light path: a light by `starts`, a place on it by `u`, a direction by `v`.
    pub fn start(&self, scene: &Scene, starts: &Starts, u_choice: f32, u: Vec2, v: Vec2) -> Option<LightStart> {
        let (light, choice) = starts.0.as_ref()?.sample(u_choice);
        let start = match &self.lights[light] {
            Light::Shape(s) => s.start(scene, u, v),
            Light::Point(s) => s.start(scene, u),
            Light::Directional { direction, irradiance } => {
                self.start_from_far(*direction, *irradiance, 1.0, v).map(|s| LightStart { delta: true, ..s })
            }
            Light::Environment(e) => {
                let s = e.sample(u)?;
                self.start_from_far(-s.wi, s.radiance, s.pdf_w, v)
            }
            Light::Constant { radiance } => {
                self.start_from_far(warp::uniform_sphere(u.x, u.y), *radiance, warp::UNIFORM_SPHERE_PDF, v)
            }
        }?;
        let start = LightStart { choice, light, ..start };
        (choice > 0.0 && start.pdf_w > 0.0 && start.radiance != Rgb::ZERO).then_some(start)
    }

    /// A ray along `direction` through the scene's bounding sphere.
    fn start_from_far(&self, direction: Vec3, radiance: Rgb, pdf_w: f32, v: Vec2) -> Option<LightStart> {
        let disk = warp::uniform_disk(v.x, v.y) * self.radius;
        let frame = Frame::from_normal(direction);
        Some(LightStart {
            origin: End::Far,
            p: self.center + frame.s * disk.x + frame.t * disk.y - direction * self.radius,
            n: direction,
            direction,
            radiance,
            choice: 1.0,
            pdf_a: 1.0 / (PI * self.radius * self.radius),
            pdf_w,
            light: 0,
            delta: false,
        })
    }
}

impl Starts {
    /// Of `light`.
    pub fn probability(&self, light: usize) -> f32 {
        self.0.as_ref().map_or(0.0, |t| t.probability(light))
    }
}

impl Light {
    fn is_far(&self) -> bool {
        matches!(self, Self::Directional { .. } | Self::Environment(_) | Self::Constant { .. })
    }

    /// Power that reaches a scene of this radius.
    fn far_power(&self, radius: f32) -> f32 {
        let disk = PI * radius * radius;
        match self {
            Self::Directional { irradiance, .. } => luminance(*irradiance) * disk,
            Self::Environment(e) => e.mean_luminance() * 2.0 * TAU * disk,
            Self::Constant { radiance } => luminance(*radiance) * 2.0 * TAU * disk,
            _ => 0.0,
        }
    }
}

fn compile(scene: &Scene, emitter: &Emitter) -> Light {
    match emitter {
        Emitter::Directional { direction, irradiance } => {
            Light::Directional { direction: direction.normalize_or(glam::DVec3::Z).as_vec3(), irradiance: *irradiance }
        }
        Emitter::Constant { radiance } => Light::Constant { radiance: *radiance },
        Emitter::Environment { image, scale, world_from_light } => {
            match Environment::new(image.clone(), *scale, world_from_light) {
                Some(environment) => Light::Environment(Box::new(environment)),
                None => Light::Constant { radiance: Rgb::ZERO },
            }
        }
        _ => Light::Point(PointLight::new(scene, emitter)),
    }
}

/// The number of the light that a hit surface's primitive is, in front or behind.
#[inline]
pub(crate) fn light_of(surface: &Surface, prim: u32, behind: bool) -> Option<usize> {
    let first = if behind { surface.first_light_behind } else { surface.first_light };
    first.map(|first| (first + if surface.one_light { 0 } else { prim }) as usize)
}
