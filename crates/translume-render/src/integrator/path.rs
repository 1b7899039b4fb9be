//! Unidirectional path tracing with emitter sampling and multiple importance sampling: the reference.
//!
//! Source: Kajiya 1986; Veach 1997 (power heuristic). What counts as depth, when roulette begins and what `hide_emitters`
//! does is as in Mitsuba 3's integrator of this name. Deviation: emitter sampling sees through masks and other surfaces that
//! pass light straight, which Mitsuba leaves to chance; the expectation is the same. Media are
//! ignored. Under a translucent surface one point is drawn where the light went in (`world/translucent.rs`); both places
//! together are one scattering.

use super::direct::{Direct, Origin};
use super::{Integrator, Settings, Work};
use crate::world::{Entry, World};
use crate::{Result, Rgb};
use translume_bxdf::{Flags, Mode};
use translume_core::sampler::Sampler;
use translume_trace::Ray;

/// See the module.
#[derive(Clone, Copy, Debug)]
pub struct Path {
    settings: Settings,
}

impl Path {
    /// With these settings.
    pub fn new(settings: Settings) -> Self {
        Self { settings }
    }
}

/// Segments after which any path ends: only closed mirrors that lose nothing come here.
const MOST_SEGMENTS: u32 = 10_000;

impl Integrator for Path {
    /// Any scene; says what is not seen of it.
    fn check(&self, world: &World) -> Result<()> {
        if world.has_media() || self.settings.camera_medium.is_some() {
            log::warn!("`path` does not see the participating media of this scene; `volpath` does");
        }
        Ok(())
    }

    fn radiance(&self, world: &World, ray: &Ray, work: &mut Work) -> Rgb {
        let max_depth = self.settings.max_depth.unwrap_or(MOST_SEGMENTS);
        let (mut radiance, mut throughput, mut eta) = (Rgb::ZERO, Rgb::ONE, 1.0);
        let mut ray = *ray;
        let mut origin = Origin::camera(ray.o);
        for depth in 0..max_depth {
            work.rays += 1;
            let hidden = depth == 0 && self.settings.hide_emitters;
            let found = if hidden { world.intersect_behind_lights(&ray) } else { world.intersect(&ray) };
            if !(hidden && found.is_none()) {
                radiance += throughput * origin.emitted(world, found.as_ref(), ray.d);
            }
            let Some(mut hit) = found else { break };
            if depth + 1 >= max_depth {
                break;
            }
            let shading = world.shading(&hit);
            let mut n = world.receiving_normal(&hit, &shading);
            let crossings = self.settings.max_depth.map_or(u32::MAX, |most| most - depth - 2);
            if shading.flags().has_smooth() {
                let direct = Direct { n, crossings, weighed: true };
                radiance += throughput * direct.sample(world, &hit, &shading, work);
            }
            let (u_lobe, u) = (work.sampler.next_1d(), work.sampler.next_2d());
            let Some(mut sample) = shading.sample(hit.wo, u_lobe, u, Mode::Radiance) else { break };
            throughput *= sample.weight;
            if sample.flags.contains(Flags::SUBSURFACE) {
                // The light went in elsewhere: go on from there, as from a diffuse surface.
                let Some(Entry { hit: entered, shading, weight }) = world.entry(&hit, &mut work.sampler) else { break };
                throughput *= weight;
                (hit, n) = (entered, shading.frame.n);
                let direct = Direct { n, crossings, weighed: true };
                radiance += throughput * direct.sample(world, &hit, &shading, work);
                let (u_lobe, u) = (work.sampler.next_1d(), work.sampler.next_2d());
                let Some(next) = shading.sample(hit.wo, u_lobe, u, Mode::Radiance) else { break };
                throughput *= next.weight;
                sample = next;
            }
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
            if !self.settings.goes_on(depth + 1, &mut throughput, eta, &mut work.sampler) {
                break;
            }
        }
        radiance
    }
}
