//! Unidirectional path tracing with emitter sampling and multiple importance sampling: the reference.
//!
//! Source: Kajiya 1986; Veach 1997 (power heuristic). What counts as depth, when roulette begins and what `hide_emitters`
//! does is as in Mitsuba 3's integrator of this name. Deviation: emitter sampling sees through masks and other surfaces that
//! pass light straight, which Mitsuba leaves to chance; the expectation is the same. Media are ignored.

use super::{Integrator, MOST_SURVIVAL, Settings, Work, power_heuristic, survival};
use crate::Rgb;
use crate::light::LightSample;
use crate::world::{Shading, SurfaceHit, World};
use glam::Vec3;
use translume_bxdf::{Flags, Mode};
use translume_core::sampler::Sampler;
use translume_trace::Ray;

/// See the module.
#[derive(Clone, Copy, Debug)]
pub struct Path {
    settings: Settings,
}

/// The vertex that a direction was drawn at, for weighing what it hits: emitter sampling there, and the density of the
/// direction (infinite: nothing but this direction could be).
struct Origin {
    p: Vec3,
    n: Vec3,
    pdf_w: f32,
}

impl Path {
    /// With these settings.
    pub fn new(settings: Settings) -> Self {
        Self { settings }
    }

    /// Light that arrives at `hit` by emitter sampling and is scattered to `hit.wo`.
    fn direct(&self, world: &World, hit: &SurfaceHit, shading: &Shading, n: Vec3, depth: u32, work: &mut Work) -> Rgb {
        let (u_choice, u) = (work.sampler.next_1d(), work.sampler.next_2d());
        let lights = world.lights();
        let Some(LightSample { wi, radiance, pdf_w, delta, end }) =
            lights.sample(world.scene(), hit.point.p, n, u_choice, u)
        else {
            return Rgb::ZERO;
        };
        let (f_cos, pdf_bsdf) = shading.eval_cos_pdf(hit.wo, wi, Mode::Radiance);
        if f_cos == Rgb::ZERO {
            return Rgb::ZERO;
        }
        work.rays += 1;
        let crossings = self.settings.max_depth.map_or(u32::MAX, |most| most - depth - 2);
        let visible = world.transmittance(&World::segment(&hit.point, wi, &end), crossings.min(MOST_CROSSINGS));
        let weight = if delta { 1.0 } else { power_heuristic(pdf_w, pdf_bsdf) };
        visible * radiance * f_cos * (weight / pdf_w)
    }
}

/// Surfaces that a connection may pass straight before it counts as blocked.
const MOST_CROSSINGS: u32 = 256;

/// Segments after which any path ends: only closed mirrors that lose nothing come here.
const MOST_SEGMENTS: u32 = 10_000;

impl Integrator for Path {
    fn radiance(&self, world: &World, ray: &Ray, work: &mut Work) -> Rgb {
        let max_depth = self.settings.max_depth.unwrap_or(MOST_SEGMENTS);
        let (mut radiance, mut throughput, mut eta) = (Rgb::ZERO, Rgb::ONE, 1.0);
        let mut ray = *ray;
        let mut origin = Origin { p: ray.o, n: Vec3::ZERO, pdf_w: f32::INFINITY };
        for depth in 0..max_depth {
            work.rays += 1;
            let hidden = depth == 0 && self.settings.hide_emitters;
            let found = if hidden { world.intersect_behind_lights(&ray) } else { world.intersect(&ray) };
            let Some(hit) = found else {
                if !hidden {
                    let (value, pdf_w) = world.lights().far_radiance(ray.d);
                    radiance += throughput * value * power_heuristic(origin.pdf_w, pdf_w);
                }
                break;
            };
            if let Some((value, light)) = world.emission(&hit) {
                let pdf_w = match origin.pdf_w.is_infinite() {
                    true => 0.0,
                    false => world.lights().pdf_surface(origin.p, origin.n, light, hit.point.p, hit.n()),
                };
                radiance += throughput * value * power_heuristic(origin.pdf_w, pdf_w);
            }
            if depth + 1 >= max_depth {
                break;
            }
            let shading = world.shading(&hit);
            let n = world.receiving_normal(&hit, &shading);
            if shading.flags().has_smooth() {
                radiance += throughput * self.direct(world, &hit, &shading, n, depth, work);
            }
            let (u_lobe, u) = (work.sampler.next_1d(), work.sampler.next_2d());
            let Some(sample) = shading.sample(hit.wo, u_lobe, u, Mode::Radiance) else { break };
            throughput *= sample.weight;
            eta *= sample.eta;
            if throughput.max_element() <= 0.0 {
                break;
            }
            ray = hit.point.spawn(sample.wi);
            // A straight pass leaves what was said about the direction: emitter sampling sees through it too.
            if !sample.flags.contains(Flags::NULL) {
                let delta = sample.flags.contains(Flags::DELTA);
                origin = Origin { p: hit.point.p, n, pdf_w: if delta { f32::INFINITY } else { sample.pdf_w } };
            }
            if depth + 1 >= self.settings.rr_depth {
                let survival = survival(throughput, eta, MOST_SURVIVAL);
                if work.sampler.next_1d() >= survival {
                    break;
                }
                throughput /= survival;
            }
        }
        radiance
    }
}
