//! Volumetric path tracing: surfaces, and homogeneous and heterogeneous media.
//!
//! Source: Miller, Georgiev & Jarosz 2019, "A null-scattering path integral formulation of light transport", in the form of
//! running products as in pbrt-v4: `r_u` and `r_l` are the densities of the path by unidirectional and by light sampling,
//! relative to the one it was made with. Every path follows a channel chosen by chance; the balance heuristic weighs it
//! over the channels and over both techniques at once. Depth counts scatterings at surfaces and in media, not what passes
//! straight. Limit: media do not shine.

use super::{Integrator, MOST_SURVIVAL, Settings, Work, survival};
use crate::Rgb;
use crate::light::LightSample;
use crate::world::{Entry, Shading, SurfaceHit, World};
use glam::Vec3;
use translume_bxdf::{Flags, Mode, Phase};
use translume_core::sampler::Sampler;
use translume_scene::MediumId;
use translume_trace::{Ray, SurfacePoint};

/// See the module.
#[derive(Clone, Copy, Debug)]
pub struct Volpath {
    settings: Settings,
}

/// A path under way.
struct Walk {
    ray: Ray,
    medium: Option<MediumId>,
    /// Channel that distances are drawn by.
    hero: usize,
    radiance: Rgb,
    beta: Rgb,
    r_u: Rgb,
    r_l: Rgb,
    eta: f32,
    depth: u32,
    /// Where light was last sampled, and whether the last direction could have been found so.
    p: Vec3,
    n: Vec3,
    specular: bool,
}

/// What scatters at a vertex.
enum Vertex<'a> {
    Surface(&'a SurfaceHit, &'a Shading<'a>),
    Medium(Vec3, Phase),
}

/// How a flight through a medium ended.
enum Flight {
    Through,
    Scattered(Vec3),
    Ended,
}

const MOST_CROSSINGS: u32 = 1024;

/// Absorption has its own chance at every collision: what roulette adds must stay small after hundreds of scatterings (at
/// surfaces' 0.95 it was nearly all of the noise), and still end paths that nothing else ends.
const MOST_SURVIVAL_IN_MEDIA: f32 = 0.999;

/// Scatterings after which any path ends.
const MOST_DEPTH: u32 = 100_000;

impl Volpath {
    /// With these settings.
    pub fn new(settings: Settings) -> Self {
        Self { settings }
    }

    /// Flies through the medium up to `t_end`.
    fn fly(&self, world: &World, walk: &mut Walk, t_end: f32, work: &mut Work) -> Flight {
        let Some(medium) = walk.medium else { return Flight::Through };
        let medium = world.medium(medium);
        let (hero, mut outcome) = (walk.hero, Flight::Ended);
        let (beta, r_u, r_l) = (&mut walk.beta, &mut walk.r_u, &mut walk.r_l);
        let rest = medium.track(&walk.ray, t_end, hero, &mut work.sampler, |c, draw| {
            let scatter = c.sigma_s[hero] / c.sigma_maj[hero];
            let absorb = c.sigma_a[hero] / c.sigma_maj[hero];
            let u = draw();
            if u < absorb {
                return false;
            }
            if u < absorb + scatter {
                let ratio = c.t_maj * c.sigma_s / (c.t_maj[hero] * c.sigma_s[hero]);
                *beta *= ratio;
                *r_u *= ratio;
                outcome = Flight::Scattered(c.p);
                return false;
            }
            let sigma_n = (c.sigma_maj - c.sigma_s - c.sigma_a).max(Rgb::ZERO);
            let pdf = c.t_maj[hero] * sigma_n[hero];
            if pdf <= 0.0 {
                return false;
            }
            *beta *= c.t_maj * sigma_n / pdf;
            *r_u *= c.t_maj * sigma_n / pdf;
            *r_l *= c.t_maj * c.sigma_maj / pdf;
            true
        });
        match rest {
            Some(t_maj) if t_maj[hero] > 0.0 => {
                let ratio = t_maj / t_maj[hero];
                *beta *= ratio;
                *r_u *= ratio;
                *r_l *= ratio;
                Flight::Through
            }
            Some(_) => Flight::Ended,
            None => outcome,
        }
    }

    /// Adds what emitter sampling finds at a vertex.
    fn direct(&self, world: &World, walk: &mut Walk, vertex: &Vertex, wo: Vec3, work: &mut Work) {
        let (u_choice, u) = (work.sampler.next_1d(), work.sampler.next_2d());
        let Some(light) = world.lights().sample(world.scene(), walk.p, walk.n, u_choice, u) else { return };
        let LightSample { wi, radiance, pdf_w, delta, ref end } = light;
        let (f, pdf_scatter, point) = match vertex {
            Vertex::Surface(hit, shading) => {
                let (f, pdf) = shading.eval_cos_pdf(wo, wi, Mode::Radiance);
                (f, pdf, hit.point)
            }
            Vertex::Medium(p, phase) => {
                let f = phase.pdf_w(wo, wi);
                (Rgb::splat(f), f, SurfacePoint { p: *p, ng: Vec3::ZERO, error: Vec3::ZERO })
            }
        };
        if f == Rgb::ZERO {
            return;
        }
        let ray = World::segment(&point, wi, end);
        let medium = match vertex {
            Vertex::Surface(hit, _) => beyond(world, hit, wi, walk.medium),
            Vertex::Medium(..) => walk.medium,
        };
        let Some((t_ray, r_l, r_u)) = self.connect(world, ray, medium, walk.hero, work) else { return };
        let r_l = walk.r_u * r_l * pdf_w;
        let r_u = walk.r_u * r_u * pdf_scatter;
        let weight = if delta { mean(r_l) } else { mean(r_l + r_u) };
        if weight > 0.0 {
            walk.radiance += walk.beta * f * t_ray * radiance / weight;
        }
    }

    /// Ratio tracking to a light: transmittance, and the densities by light and by unidirectional sampling; `None`: blocked.
    fn connect(
        &self,
        world: &World,
        mut ray: Ray,
        mut medium: Option<MediumId>,
        hero: usize,
        work: &mut Work,
    ) -> Option<(Rgb, Rgb, Rgb)> {
        let (mut t_ray, mut r_l, mut r_u) = (Rgb::ONE, Rgb::ONE, Rgb::ONE);
        for _ in 0..MOST_CROSSINGS {
            work.rays += 1;
            let hit = world.intersect(&ray);
            let through = match &hit {
                Some(hit) => world.straight_through(hit),
                None => Rgb::ONE,
            };
            if through == Rgb::ZERO {
                return None;
            }
            if let Some(medium) = medium {
                let t_end = hit.as_ref().map_or(ray.t_max, |h| h.t);
                let rest = world.medium(medium).track(&ray, t_end, hero, &mut work.sampler, |c, draw| {
                    let sigma_n = (c.sigma_maj - c.sigma_s - c.sigma_a).max(Rgb::ZERO);
                    let pdf = c.t_maj[hero] * c.sigma_maj[hero];
                    t_ray *= c.t_maj * sigma_n / pdf;
                    r_l *= c.t_maj * c.sigma_maj / pdf;
                    r_u *= c.t_maj * sigma_n / pdf;
                    let estimate = t_ray / mean(r_l + r_u);
                    if estimate.max_element() < 0.05 {
                        if draw() < 0.75 {
                            t_ray = Rgb::ZERO;
                        } else {
                            t_ray *= 4.0;
                        }
                    }
                    t_ray != Rgb::ZERO
                })?;
                if rest[hero] <= 0.0 {
                    return None;
                }
                let ratio = rest / rest[hero];
                (t_ray, r_l, r_u) = (t_ray * ratio, r_l * ratio, r_u * ratio);
            }
            let Some(hit) = hit else { return Some((t_ray, r_l, r_u)) };
            t_ray *= through;
            medium = beyond(world, &hit, ray.d, medium);
            ray = hit.go_on(&ray);
        }
        None
    }

    /// Adds what the ray itself finds: `value` from a light that emitter sampling finds with `pdf_w`.
    fn found(&self, walk: &mut Walk, value: Rgb, pdf_w: f32) {
        let weight = if walk.specular { mean(walk.r_u) } else { mean(walk.r_u + walk.r_l * pdf_w) };
        if weight > 0.0 {
            walk.radiance += walk.beta * value / weight;
        }
    }

    /// Russian roulette with at most the chance `most` to survive; whether the path goes on.
    fn goes_on(&self, walk: &mut Walk, most: f32, work: &mut Work) -> bool {
        if walk.beta == Rgb::ZERO || mean(walk.r_u) <= 0.0 {
            return false;
        }
        if walk.depth >= self.settings.rr_depth {
            let survival = survival(walk.beta / mean(walk.r_u), walk.eta, most);
            if work.sampler.next_1d() >= survival {
                return false;
            }
            walk.beta /= survival;
        }
        true
    }

    /// Goes on from a surface; whether the path does.
    fn scatter_at(&self, world: &World, walk: &mut Walk, hit: &SurfaceHit, most: u32, work: &mut Work) -> bool {
        let shading = world.shading(hit);
        let straight_only = !shading.flags().has_smooth() && shading.flags().contains(Flags::NULL);
        if walk.depth + 1 >= most && !straight_only {
            return false;
        }
        if shading.flags().has_smooth() {
            let (p, n) = (walk.p, walk.n);
            (walk.p, walk.n) = (hit.point.p, world.receiving_normal(hit, &shading));
            self.direct(world, walk, &Vertex::Surface(hit, &shading), hit.wo, work);
            (walk.p, walk.n) = (p, n);
        }
        let (u_lobe, u) = (work.sampler.next_1d(), work.sampler.next_2d());
        let Some(sample) = shading.sample(hit.wo, u_lobe, u, Mode::Radiance) else { return false };
        walk.beta *= sample.weight;
        if sample.flags.contains(Flags::SUBSURFACE) {
            let Some(entry) = world.entry(hit, &mut work.sampler) else { return false };
            walk.beta *= entry.weight;
            return self.enter(world, walk, &entry, work);
        }
        walk.medium = beyond(world, hit, sample.wi, walk.medium);
        if sample.flags.contains(Flags::NULL) {
            // Straight on: what is known of the direction stays.
            walk.ray = hit.point.spawn(sample.wi);
            return walk.beta != Rgb::ZERO;
        }
        walk.eta *= sample.eta;
        walk.depth += 1;
        walk.specular = sample.flags.contains(Flags::DELTA);
        walk.r_l = walk.r_u / sample.pdf_w;
        (walk.p, walk.n) = (hit.point.p, world.receiving_normal(hit, &shading));
        walk.ray = hit.point.spawn(sample.wi);
        self.goes_on(walk, MOST_SURVIVAL, work)
    }

    /// Goes on from where the light entered a translucent object, as from a diffuse surface; whether the path does.
    fn enter(&self, world: &World, walk: &mut Walk, entry: &Entry, work: &mut Work) -> bool {
        let Entry { hit, shading, .. } = entry;
        (walk.p, walk.n) = (hit.point.p, shading.frame.n);
        self.direct(world, walk, &Vertex::Surface(hit, shading), hit.wo, work);
        let (u_lobe, u) = (work.sampler.next_1d(), work.sampler.next_2d());
        let Some(sample) = shading.sample(hit.wo, u_lobe, u, Mode::Radiance) else { return false };
        walk.beta *= sample.weight;
        walk.medium = beyond(world, hit, sample.wi, walk.medium);
        walk.depth += 1;
        walk.specular = false;
        walk.r_l = walk.r_u / sample.pdf_w;
        walk.ray = hit.point.spawn(sample.wi);
        self.goes_on(walk, MOST_SURVIVAL, work)
    }

    /// Goes on from a collision; whether the path does.
    fn scatter_in(&self, world: &World, walk: &mut Walk, p: Vec3, most: u32, work: &mut Work) -> bool {
        let Some(medium) = walk.medium else { return false };
        if walk.depth + 1 >= most {
            return false;
        }
        let (phase, wo) = (*world.medium(medium).phase(), -walk.ray.d.normalize());
        (walk.p, walk.n) = (p, Vec3::ZERO);
        self.direct(world, walk, &Vertex::Medium(p, phase), wo, work);
        let wi = phase.sample(wo, work.sampler.next_2d());
        walk.depth += 1;
        walk.specular = false;
        walk.r_l = walk.r_u / phase.pdf_w(wo, wi);
        walk.ray = Ray::new(p, wi);
        self.goes_on(walk, MOST_SURVIVAL_IN_MEDIA, work)
    }
}

impl Integrator for Volpath {
    fn radiance(&self, world: &World, ray: &Ray, work: &mut Work) -> Rgb {
        let most = self.settings.max_depth.unwrap_or(MOST_DEPTH);
        let mut walk = Walk {
            ray: *ray,
            medium: self.settings.camera_medium,
            hero: ((work.sampler.next_1d() * 3.0) as usize).min(2),
            radiance: Rgb::ZERO,
            beta: Rgb::ONE,
            r_u: Rgb::ONE,
            r_l: Rgb::ONE,
            eta: 1.0,
            depth: 0,
            p: ray.o,
            n: Vec3::ZERO,
            specular: true,
        };
        for _ in 0..MOST_DEPTH {
            if work.stopped() {
                break;
            }
            work.rays += 1;
            let hidden = walk.depth == 0 && self.settings.hide_emitters;
            let hit = if hidden { world.intersect_behind_lights(&walk.ray) } else { world.intersect(&walk.ray) };
            let t_end = hit.as_ref().map_or(walk.ray.t_max, |h| h.t);
            match self.fly(world, &mut walk, t_end, work) {
                Flight::Ended => break,
                Flight::Scattered(p) => {
                    if self.scatter_in(world, &mut walk, p, most, work) {
                        continue;
                    }
                    break;
                }
                Flight::Through => {}
            }
            let Some(hit) = hit else {
                if !hidden {
                    for far in world.lights().far_lights(walk.ray.d) {
                        self.found(&mut walk, far.radiance, far.pdf_w);
                    }
                }
                break;
            };
            if let Some((value, light)) = world.emission(&hit) {
                let pdf_w = match walk.specular {
                    true => 0.0,
                    false => world.lights().pdf_surface(walk.p, walk.n, light, hit.point.p, hit.n()),
                };
                self.found(&mut walk, value, pdf_w);
            }
            if !self.scatter_at(world, &mut walk, &hit, most, work) {
                break;
            }
        }
        walk.radiance
    }
}

fn mean(v: Rgb) -> f32 {
    v.element_sum() / 3.0
}

/// The medium behind the surface for a direction that leaves it.
fn beyond(world: &World, hit: &SurfaceHit, wi: Vec3, medium: Option<MediumId>) -> Option<MediumId> {
    match world.media(hit) {
        Some((interior, exterior)) => {
            if wi.dot(hit.n()) < 0.0 {
                interior
            } else {
                exterior
            }
        }
        None => medium,
    }
}
