//! One over the chance that a light path has a camera vertex in its footprint, without bias.
//!
//! Source: Booth 2007 (one over a probability is the mean number of trials until the first success); Qin et al. 2015
//! use it for photon gathering. From the parent x of a light vertex a walk takes a direction ω with density p(ω), and
//! hits a surface at z(ω); the chance is ∫ p(ω) [|z(ω) − y| ≤ R(z(ω))] dω. Since R is at most ρ times the distance of z
//! from x, only directions within asin ρ of y come into question (|z − y| is at least the sine times either distance).
//! Trials:
//!
//! - lights and Lambertian surfaces have a bound p⁺ of p: directions evenly in that cone C, a success when the hit is
//!   one and u < p(ω)/p⁺; n trials estimate 1/(|C| p⁺) n;
//! - other surfaces: the walk's own directions, most of which miss the cone and cost no ray; n trials estimate n;
//! - parallel light: places in the disc that bounds all footprints, p is constant.
//!
//! Roulette is not part of it: a link divides by the chance that its own light path had. A trial passes masks straight
//! by chance, as walks do.

use super::super::arrival::{Arrival, IncidentFrom};
use super::super::footprints::Link;
use super::light::MIN_COS;
use super::link::{Linker, Parent, is_inside};
use super::{eye::EyeVertex, light::LightVertex};
use crate::PathSampler;
use crate::light::End;
use glam::Vec3;
use std::f32::consts::PI;
use std::sync::atomic::Ordering;
use translume_bxdf::{Flags, Mode};
use translume_core::frame::Frame;
use translume_core::sampler::Sampler;
use translume_core::warp;
use translume_trace::Ray;

/// Trials after which the estimate is cut off, without a ray and with one: a chance of less than one in a million, and
/// a guard against endless loops where rounding forbids what happened.
const MAX_TRIALS: u64 = 20_000_000;
const MAX_RAYS: u64 = 300_000;

/// Cosines of directions of single precision are known so well.
const ROUNDING: f32 = 1e-6;

impl Linker<'_> {
    /// One over the chance.
    pub(super) fn inverse_chance(
        &self,
        link: &Link,
        v: &LightVertex,
        parent: &Parent,
        arrival: &Arrival,
        y: &EyeVertex,
        rays: &mut u64,
    ) -> f32 {
        let key = u64::from(link.light) << 32 | u64::from(link.eye);
        let mut sampler = PathSampler::new(self.seed.0 ^ 0x6368_616e, key, self.seed.1);
        let mut passing = sampler.branch(0x7061_7373);
        let center = y.hit.point.p;
        let to_y = -arrival.wi;
        let frame = Frame::from_normal(to_y);
        // Whether the hit of a ray of this density per solid angle (parallel light: per area across) is a success.
        let mut hits = |ray: Ray, pdf: f32| {
            self.world.arrives(&ray, Some(&mut passing), |point, t| {
                let from = self.incident_from(v, t);
                let across = if matches!(from, IncidentFrom::Direction(_)) { 1.0 } else { t * t };
                let radius = self.plan.bandwidth.radius(pdf * point.ng.dot(ray.d).abs() / across, from, v.first);
                is_inside(point.p.distance_squared(center), radius) > 0.0
            })
        };
        if let Parent::Start(start) = parent
            && matches!(start.origin, End::Far)
        {
            let pdf = start.pdf_next();
            let radius = (self.plan.bandwidth.h[0] / (MIN_COS * pdf).sqrt()).min(self.plan.bandwidth.max_radius);
            let trials = self.until(rays, |rays| {
                let u = sampler.next_2d();
                let beside = frame.to_world((warp::uniform_disk(u.x, u.y) * radius).extend(0.0));
                *rays += 1;
                hits(self.lights.ray_beside(self.world, v, center + beside), pdf)
            });
            return trials / (PI * radius * radius * pdf);
        }
        let origin = match parent {
            Parent::Start(start) => start.p,
            Parent::Vertex(p, _) => p.hit.point.p,
        };
        let distance = (center - origin).length();
        let sine = self.plan.bandwidth.bound(v.first).min(self.plan.bandwidth.max_radius / distance).min(1.0);
        // A little wider, for rounding.
        let cos = (1.0 - sine * sine).sqrt() * (1.0 - 1e-6);
        let bounded = match parent {
            Parent::Start(start) => {
                let point = start.point();
                let flat = point.n != Vec3::ZERO;
                Some(if flat { widest_cosine(point.n.dot(to_y), cos) / PI } else { start.pdf_next() })
            }
            Parent::Vertex(_, shading) => (shading.flags() == Flags::REFLECTION.or(Flags::DIFFUSE)).then_some(1.0 / PI),
        };
        // The light path itself is one of the walks that are counted. Where rounding would have it miss, next to where
        // it comes from, the trials would never end, and there is no light to speak of between surfaces that close.
        if -v.hit.wo.dot(to_y) < cos - ROUNDING {
            return 0.0;
        }
        let density = |d: Vec3| match parent {
            Parent::Start(start) => self.world.lights().pdf_start(self.plan.starts, &start.point(), d).1,
            Parent::Vertex(p, shading) => {
                self.world.shading_from(&p.hit, shading, p.hit.wo).eval_cos_pdf(p.hit.wo, d, Mode::Importance).1
            }
        };
        if let (None, Parent::Vertex(p, shading)) = (bounded, parent) {
            return self.until(rays, |rays| {
                let Some(s) = shading.sample(p.hit.wo, sampler.next_1d(), sampler.next_2d(), Mode::Importance) else {
                    return false;
                };
                let inside = !s.flags.contains(Flags::DELTA) && s.wi.dot(to_y) >= cos;
                *rays += u64::from(inside);
                inside && hits(self.lights.ray_along(v, s.wi), s.pdf_w)
            });
        }
        let max_pdf = bounded.unwrap_or(1.0);
        let trials = self.until(rays, |rays| {
            let u = sampler.next_2d();
            let d = frame.to_world(warp::uniform_cone(u.x, u.y, cos));
            let pdf = density(d);
            let chosen = sampler.next_1d() * max_pdf < pdf;
            *rays += u64::from(chosen);
            chosen && hits(self.lights.ray_along(v, d), pdf)
        });
        trials * warp::uniform_cone_pdf(cos) / max_pdf
    }

    /// Trials up to and with the first success, which are told to count their rays.
    fn until(&self, rays: &mut u64, mut success: impl FnMut(&mut u64) -> bool) -> f32 {
        let (mut n, max) = (1_u64, *rays + MAX_RAYS);
        while !success(rays) && n < MAX_TRIALS && *rays < max && !self.stop.load(Ordering::Relaxed) {
            n += 1;
        }
        n as f32
    }
}

/// The largest cosine to a normal within a cone whose axis has the cosine `c` to it.
fn widest_cosine(c: f32, cone: f32) -> f32 {
    if c >= cone { 1.0 } else { c * cone + ((1.0 - c * c) * (1.0 - cone * cone)).max(0.0).sqrt() }
}
