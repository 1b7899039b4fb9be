//! Emitter sampling at a point, and its other half: the emission that a direction of the BSDF meets.
//!
//! Source: Veach 1997 (power heuristic). Deviation from Mitsuba: emitter sampling sees through masks and other surfaces that
//! pass light straight, which Mitsuba leaves to chance; the expectation is the same.

use super::{Work, power_heuristic};
use crate::Rgb;
use crate::light::FarLight;
use crate::world::{MOST_CROSSINGS, Shading, SurfaceHit, World};
use glam::Vec3;
use translume_bxdf::Mode;
use translume_core::sampler::Sampler;

/// The vertex that a direction was drawn at, for weighing what it hits: emitter sampling there, and the density of the
/// direction (infinite: nothing but this direction could be).
pub(super) struct Origin {
    pub(super) p: Vec3,
    pub(super) n: Vec3,
    pub(super) pdf_w: f32,
}

impl Origin {
    /// The camera at `p`, where nothing else samples lights.
    pub(super) fn camera(p: Vec3) -> Self {
        Self { p, n: Vec3::ZERO, pdf_w: f32::INFINITY }
    }

    /// What is emitted where the ray along `d` arrives (`hit`) or escapes, weighed against emitter sampling here: each light
    /// that lies behind by itself, since emitter sampling draws one of them.
    pub(super) fn emitted(&self, world: &World, hit: Option<&SurfaceHit>, d: Vec3) -> Rgb {
        let Some(hit) = hit else {
            let weighed = |far: FarLight| far.radiance * power_heuristic(self.pdf_w, far.pdf_w);
            return world.lights().far_lights(d).map(weighed).sum();
        };
        let Some((value, light)) = world.emission(hit) else { return Rgb::ZERO };
        let pdf_w = match self.pdf_w.is_infinite() {
            true => 0.0,
            false => world.lights().pdf_surface(self.p, self.n, light, hit.point.p, hit.n()),
        };
        value * power_heuristic(self.pdf_w, pdf_w)
    }
}

/// Emitter sampling.
pub(super) struct Direct {
    /// [`World::receiving_normal`].
    pub(super) n: Vec3,
    /// Surfaces that light may pass straight.
    pub(super) crossings: u32,
    /// Against the directions of the BSDF, which are followed as well.
    pub(super) weighed: bool,
}

impl Direct {
    /// Light that arrives at `hit` and is scattered to `hit.wo`.
    pub(super) fn sample(&self, world: &World, hit: &SurfaceHit, shading: &Shading, work: &mut Work) -> Rgb {
        let (u_choice, u) = (work.sampler.next_1d(), work.sampler.next_2d());
        let light = world.lights().sample(world.scene(), hit.point.p, self.n, u_choice, u);
        let Some(light) = light else { return Rgb::ZERO };
        let (f_cos, pdf_bsdf) = shading.eval_cos_pdf(hit.wo, light.wi, Mode::Radiance);
        if f_cos == Rgb::ZERO {
            return Rgb::ZERO;
        }
        work.rays += 1;
        let segment = World::segment(&hit.point, light.wi, &light.end);
        let visible = world.transmittance(&segment, self.crossings.min(MOST_CROSSINGS));
        let weight = if light.delta || !self.weighed { 1.0 } else { power_heuristic(light.pdf_w, pdf_bsdf) };
        visible * light.radiance * f_cos * (weight / light.pdf_w) // [Bekaert 2003, Eq. 2]
    }
}
