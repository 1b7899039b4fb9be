//! The light's half of a link: a light path continued from its vertex x_{k-1} to a point y that it did not meet.
//!
//! Source: Bekaert et al. 2003, the first factor of eq. 8, which they call the partial score, with the corrections of
//! errata: what x_{k-1} emits or scatters is evaluated towards y, and divided by the density of that direction, so that
//! r² cancels; parallel light has a density on the plane across it in the place of p_ω/r².

use crate::Rgb;
use crate::light::{LightPoint, LightStart, Starts};
use crate::subpath::{Density, Scattering, scattering};
use crate::world::{Shading, SurfaceHit, World};
use glam::Vec3;

/// Where light comes from, at a surface point.
#[derive(Clone, Copy, Debug)]
pub(super) enum IncidentFrom {
    /// From a point this far away.
    Point(f32),
    /// From a direction, with this density per area across it.
    Direction(f32),
}

impl IncidentFrom {
    /// The light's `point` this far away, by the second density of [`crate::light::Lights::pdf_start`].
    #[inline]
    pub(super) fn light(point: &LightPoint, next: f32, distance: f32) -> Self {
        if point.far { Self::Direction(next) } else { Self::Point(distance) }
    }
}

/// Light from x_{k-1} to y, before the kernel.
pub(super) struct Arrival {
    /// Unit direction from y to x_{k-1}.
    pub(super) wi: Vec3,
    /// Flux over densities, the direction's included, towards y; of far lights likewise.
    pub(super) value: Rgb,
    /// Density per area across the light at y; the kernel's area times this normalises.
    pub(super) pdf_across: f32,
    pub(super) from: IncidentFrom,
    /// cos at x_{k-1} over the squared distance: density of its place by a walk from y, per direction's.
    pub(super) onto_parent: f32,
    /// Of a surface.
    pub(super) at_parent: Option<Scattering>,
}

impl Arrival {
    /// From a light, where light paths begin by `starts`; `None` if it sends nothing there.
    pub(super) fn from_light(world: &World, starts: &Starts, start: &LightStart, y: Vec3) -> Option<Self> {
        let point = start.point();
        if point.far {
            let value = start.radiance / start.pdf_begin();
            let (wi, pdf_across) = (-start.direction, start.pdf_next());
            return Some(Self {
                wi,
                value: value / pdf_across,
                pdf_across,
                from: IncidentFrom::Direction(pdf_across),
                onto_parent: 1.0,
                at_parent: None,
            });
        }
        let (wi, distance) = toward(y, start.p)?;
        let (_, pdf_w) = world.lights().pdf_start(starts, &point, -wi);
        let radiance = world.lights().emitted(world.scene(), start, -wi);
        let cos = if point.n == Vec3::ZERO { 1.0 } else { point.n.dot(-wi) };
        if pdf_w <= 0.0 || cos <= 0.0 || radiance == Rgb::ZERO {
            return None;
        }
        let value = radiance * (cos / (start.pdf_begin() * pdf_w));
        let onto_parent = point.from_solid_angle(1.0, wi, distance);
        let (pdf_across, from) = (pdf_w / (distance * distance), IncidentFrom::Point(distance));
        Some(Self { wi, value, pdf_across, from, onto_parent, at_parent: None })
    }

    /// From a surface at which a light path arrived with this throughput.
    pub(super) fn from_surface(
        world: &World,
        (hit, shading): (&SurfaceHit, &Shading),
        throughput: Rgb,
        y: Vec3,
    ) -> Option<Self> {
        let (wi, distance) = toward(y, hit.point.p)?;
        let there = scattering(world, hit, shading, hit.wo, -wi)?;
        if there.pdf_to_camera <= 0.0 {
            return None;
        }
        let cos = hit.n().dot(wi).abs();
        let across = 1.0 / (distance * distance);
        Some(Self {
            wi,
            value: throughput * there.f * (cos / there.pdf_to_camera),
            pdf_across: there.pdf_to_camera * across,
            from: IncidentFrom::Point(distance),
            onto_parent: cos * across,
            at_parent: Some(there),
        })
    }
}

/// Density per area at `to` of a walk from `from`, per density of the direction; `d` is parallel to the way.
pub(super) fn onto(from: Vec3, to: &SurfaceHit, d: Vec3) -> f32 {
    Density::Angle { from, pdf_w: 1.0 }.at(to.point.p, to.n(), d)
}

fn toward(from: Vec3, to: Vec3) -> Option<(Vec3, f32)> {
    let way = to - from;
    let distance = way.length();
    (distance > 0.0).then(|| (way / distance, distance))
}
