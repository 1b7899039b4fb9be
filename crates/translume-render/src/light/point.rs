//! Lights without extent in one place: points, spots, projectors.

use crate::light::tree::LightBounds;
use crate::light::{End, LightSample, LightStart};
use crate::material::mean_luminance;
use crate::texture::{self, Place};
use crate::{Rgb, luminance};
use glam::{DAffine3, Mat3, Vec2, Vec3};
use std::f32::consts::{FRAC_PI_2, PI, TAU};
use translume_core::frame::Frame;
use translume_core::warp;
use translume_mesh::Bounds;
use translume_scene::emitter::{Emitter, Falloff, Spot};
use translume_scene::texture::Texture;
use translume_scene::{Scene, TextureId};

#[derive(Clone, Debug)]
pub(crate) struct PointLight {
    position: Vec3,
    /// Directions to the light's own space, where it shines along +z.
    light_from_world: Mat3,
    axis: Vec3,
    /// Light leaves within this angle of the axis.
    theta: f32,
    /// Largest intensity, for choosing among lights.
    peak: f32,
    kind: Kind,
}

#[derive(Clone, Debug)]
enum Kind {
    Point(Rgb),
    Spot { intensity: Rgb, cutoff: f32, beam: f32, falloff: Falloff },
    Projector { irradiance: TextureId, scale: f32, half: Vec2 },
}

impl PointLight {
    /// From any emitter that has a place; the others give a light of no power.
    pub(crate) fn new(scene: &Scene, emitter: &Emitter) -> Self {
        match emitter {
            Emitter::Spot(Spot { world_from_light, intensity, cutoff_angle, beam_width, falloff }) => {
                let (cutoff, beam) = (*cutoff_angle, *beam_width);
                let kind = Kind::Spot { intensity: *intensity, cutoff, beam: beam.min(cutoff), falloff: *falloff };
                Self::placed(world_from_light, cutoff, luminance(*intensity), kind)
            }
            Emitter::Projector { world_from_light, fov_x, irradiance, scale } => {
                let x = (0.5 * fov_x).tan();
                let half = Vec2::new(x, x / slide_aspect(scene, *irradiance));
                let kind = Kind::Projector { irradiance: *irradiance, scale: *scale, half };
                let corner = half.length().atan();
                let peak = mean_luminance(scene, *irradiance) * scale / corner.cos().powi(3);
                Self::placed(world_from_light, corner, peak, kind)
            }
            Emitter::Point { position, intensity } => {
                let kind = Kind::Point(*intensity);
                Self::placed(&DAffine3::from_translation(*position), PI, luminance(*intensity), kind)
            }
            _ => Self::placed(&DAffine3::IDENTITY, PI, 0.0, Kind::Point(Rgb::ZERO)),
        }
    }

    fn placed(world_from_light: &DAffine3, theta: f32, peak: f32, kind: Kind) -> Self {
        Self {
            position: world_from_light.translation.as_vec3(),
            light_from_world: world_from_light.matrix3.inverse().as_mat3(),
            axis: (world_from_light.matrix3 * glam::DVec3::Z).normalize_or(glam::DVec3::Z).as_vec3(),
            theta,
            peak,
            kind,
        }
    }

    pub(crate) fn bounds(&self) -> LightBounds {
        let bounds = Bounds { lo: self.position, hi: self.position };
        // A cone of "normals" as wide as the light, and nothing beyond: rounding must not darken its border.
        let theta_o = (self.theta * 1.001 + 1e-3).min(PI);
        LightBounds { bounds, power: self.peak * 2.0 * TAU, axis: self.axis, theta_o, theta_e: FRAC_PI_2 }
    }

    /// Power per solid angle towards the unit direction `d`.
    pub(crate) fn intensity(&self, scene: &Scene, d: Vec3) -> Rgb {
        let local = (self.light_from_world * d).normalize();
        match &self.kind {
            Kind::Point(intensity) => *intensity,
            Kind::Spot { intensity, cutoff, beam, falloff } => {
                *intensity * spot_factor(local.z.clamp(-1.0, 1.0), *cutoff, *beam, *falloff)
            }
            Kind::Projector { irradiance, scale, half } => {
                let plane = local.truncate() / local.z;
                if local.z <= 0.0 || plane.abs().cmpgt(*half).any() {
                    return Rgb::ZERO;
                }
                // +x is the left of the slide; v goes up.
                let uv = Vec2::new(0.5 - 0.5 * plane.x / half.x, 0.5 + 0.5 * plane.y / half.y);
                texture::eval(scene, *irradiance, &Place::bare(uv)) * *scale / local.z.powi(3)
            }
        }
    }

    pub(crate) fn sample(&self, scene: &Scene, p: Vec3) -> Option<LightSample> {
        let way = self.position - p;
        let distance2 = way.length_squared();
        let wi = way.try_normalize()?;
        let radiance = self.intensity(scene, -wi) / distance2;
        Some(LightSample { wi, radiance, pdf_w: 1.0, delta: true, end: End::Point(self.position) })
    }

    pub(crate) fn start(&self, scene: &Scene, u: Vec2) -> Option<LightStart> {
        let cos_max = self.theta.cos();
        let (direction, pdf_w) = if self.theta >= PI {
            (warp::uniform_sphere(u.x, u.y), warp::UNIFORM_SPHERE_PDF)
        } else {
            let local = warp::uniform_cone(u.x, u.y, cos_max);
            (Frame::from_normal(self.axis).to_world(local), warp::uniform_cone_pdf(cos_max))
        };
        Some(LightStart {
            origin: End::Point(self.position),
            p: self.position,
            n: direction,
            direction,
            radiance: self.intensity(scene, direction),
            choice: 1.0,
            pdf_a: 1.0,
            pdf_w,
            light: 0,
            delta: true,
        })
    }

    /// Density of [`PointLight::start`] for the direction `d`.
    pub(crate) fn pdf_w(&self, d: Vec3) -> f32 {
        let cos_max = self.theta.cos();
        match self.theta >= PI {
            true => warp::UNIFORM_SPHERE_PDF,
            false if d.dot(self.axis) >= cos_max => warp::uniform_cone_pdf(cos_max),
            false => 0.0,
        }
    }
}

/// Width over height of the slide's picture.
fn slide_aspect(scene: &Scene, id: TextureId) -> f32 {
    match &scene.textures[id.0] {
        Texture::Bitmap(b) => b.image.pixels.width() as f32 / b.image.pixels.height().max(1) as f32,
        _ => 1.0,
    }
}

fn spot_factor(cos: f32, cutoff: f32, beam: f32, falloff: Falloff) -> f32 {
    let (cos_cutoff, cos_beam) = (cutoff.cos(), beam.cos());
    if cos <= cos_cutoff {
        return 0.0;
    }
    if cos >= cos_beam {
        return 1.0;
    }
    let s = (cos - cos_cutoff) / (cos_beam - cos_cutoff);
    match falloff {
        Falloff::LinearInAngle => (cutoff - cos.acos()) / (cutoff - beam),
        Falloff::SquareInCosine => s * s,
        Falloff::SmoothInCosine => s * s * (3.0 - 2.0 * s),
    }
}
