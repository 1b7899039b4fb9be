//! Lights that are no shapes.

use super::Loader;
use super::object::Object;
use crate::Result;
use crate::emitter::{Emitter, Falloff, Spot};
use crate::spectrum::Quantity;
use glam::DVec3;
use std::rc::Rc;

const LIGHT: Quantity = Quantity::Light;

impl Loader {
    pub(super) fn emitter(&mut self, object: &Rc<Object>) -> Result<()> {
        let emitter = match object.plugin.as_str() {
            "point" => Emitter::Point {
                position: match object.point("position")? {
                    Some(p) => p,
                    None => object.transform("to_world")?.translation,
                },
                intensity: self.color(object, "intensity", 1.0, LIGHT)?,
            },
            "spot" => Emitter::Spot(self.spot(object)?),
            "directional" => {
                let given = match object.point("direction")? {
                    Some(d) => d,
                    None => object.transform("to_world")?.transform_vector3(DVec3::Z),
                };
                let Some(direction) = given.try_normalize() else {
                    return Err(object.place.invalid("a directional light has no direction"));
                };
                Emitter::Directional { direction, irradiance: self.color(object, "irradiance", 1.0, LIGHT)? }
            }
            "constant" => Emitter::Constant { radiance: self.color(object, "radiance", 1.0, LIGHT)? },
            "envmap" => {
                let path = self.file(object, "filename")?;
                let image = self.builder.light_image(&path).map_err(|e| e.at(&object.place.file, object.place.line))?;
                Emitter::Environment {
                    image,
                    scale: translume_bxdf::Rgb::splat(object.number("scale")?.unwrap_or(1.0) as f32),
                    world_from_light: object.invertible("to_world")?,
                }
            }
            "projector" => self.projector(object)?,
            "area" => return Err(object.place.invalid("an area light stands inside of a shape")),
            _ => return Err(object.unsupported()),
        };
        self.finish(object)?;
        self.builder.scene.emitters.push(emitter);
        Ok(())
    }

    fn spot(&mut self, object: &Rc<Object>) -> Result<Spot> {
        let cutoff = object.positive("cutoff_angle", 20.0)?;
        let beam = object.number("beam_width")?.unwrap_or(cutoff * 0.75);
        if cutoff > 180.0 || !(0.0..=cutoff).contains(&beam) {
            return Err(object.place.invalid("the angles of a spot light: 0 ≤ beam_width ≤ cutoff_angle ≤ 180"));
        }
        Ok(Spot {
            world_from_light: object.invertible("to_world")?,
            intensity: self.color(object, "intensity", 1.0, LIGHT)?,
            cutoff_angle: cutoff.to_radians() as f32,
            beam_width: beam.to_radians() as f32,
            falloff: Falloff::LinearInAngle,
        })
    }

    fn projector(&mut self, object: &Rc<Object>) -> Result<Emitter> {
        let irradiance = match self.given_texture(object, "irradiance", LIGHT)? {
            Some(id) => id,
            None => match self.child_of_class(object, "texture")? {
                Some(texture) => self.texture_object(&texture, LIGHT)?,
                None => return Err(object.place.invalid("a projector has no texture \"irradiance\"")),
            },
        };
        // The slide's aspect ratio decides what a field of view along another axis means.
        let [width, height] = match &self.builder.scene.textures[irradiance.0] {
            crate::texture::Texture::Bitmap(b) => [b.image.pixels.width(), b.image.pixels.height()],
            _ => [1, 1],
        };
        Ok(Emitter::Projector {
            world_from_light: object.invertible("to_world")?,
            fov_x: self.perspective(object)?.fov_x(width, height),
            irradiance,
            // Mitsuba's irradiance E shows as E/distance² on white, which an irradiance of π E does.
            scale: std::f32::consts::PI * object.number("scale")?.unwrap_or(1.0) as f32,
        })
    }
}
