//! Textures and spectra.

use super::Loader;
use super::object::{Object, Spectrum, Value};
use crate::Result;
use crate::scene::TextureId;
use crate::spectrum::{self, Quantity};
use crate::texture::{Bitmap, Channel, Checkerboard, Filter, Texture, Wrap};
use glam::{DAffine2, DMat2, DVec2};
use std::rc::Rc;
use translume_bxdf::Rgb;

/// Mitsuba's own texture coordinates (origin at the upper left) from ours.
const MITSUBA_FROM_UV: DAffine2 = DAffine2::from_cols(DVec2::X, DVec2::new(0.0, -1.0), DVec2::new(0.0, 1.0));

impl Loader {
    /// The colour or texture that `object` has as `name`, or the constant `default`.
    pub(super) fn texture(
        &mut self,
        object: &Object,
        name: &str,
        default: f32,
        quantity: Quantity,
    ) -> Result<TextureId> {
        match self.given_texture(object, name, quantity)? {
            Some(id) => Ok(id),
            None => Ok(self.builder.constant(Rgb::splat(default))),
        }
    }

    /// The colour or texture that `object` has as `name`.
    pub(super) fn given_texture(
        &mut self,
        object: &Object,
        name: &str,
        quantity: Quantity,
    ) -> Result<Option<TextureId>> {
        if let Some(rgb) = self.given_color(object, name, quantity)? {
            return Ok(Some(self.builder.constant(rgb)));
        }
        match self.child_named(object, name)? {
            Some(child) => self.texture_object(&child, quantity).map(Some),
            None => Ok(None),
        }
    }

    /// The colour that `object` has as the property `name`.
    pub(super) fn given_color(&mut self, object: &Object, name: &str, quantity: Quantity) -> Result<Option<Rgb>> {
        let Some(property) = object.property(name) else { return Ok(None) };
        let rgb = match &property.value {
            Value::Number(v) => Rgb::splat(*v as f32),
            Value::Color(rgb) => *rgb,
            Value::Spectrum(s) => s.color(quantity),
            _ => return Err(property.place.invalid(format!("property {name:?} is not a colour"))),
        };
        if !rgb.is_finite() {
            return Err(property.place.invalid(format!("property {name:?} is not finite")));
        }
        if rgb.min_element() < 0.0 {
            self.builder.warn(property.place.warning(format!("negative parts of {name:?} count as 0")));
        }
        Ok(Some(rgb.max(Rgb::ZERO)))
    }

    /// A colour, in place or as an object that is the same everywhere.
    pub(super) fn color(&mut self, object: &Object, name: &str, default: f32, quantity: Quantity) -> Result<Rgb> {
        let id = self.texture(object, name, default, quantity)?;
        let varies = || object.place.unsupported(format!("{name:?} of {} cannot vary", object.title()));
        self.builder.scene.constant(id).ok_or_else(varies)
    }

    pub(super) fn texture_object(&mut self, object: &Rc<Object>, quantity: Quantity) -> Result<TextureId> {
        let key = (Rc::as_ptr(object), quantity);
        if let Some(&id) = self.textures.get(&key) {
            self.asked.extend(self.attributes.get(&id).into_iter().flatten().cloned());
            return Ok(id);
        }
        let asked = std::mem::take(&mut self.asked);
        let made = self.guarded(object, |loader| loader.make_texture(object, quantity));
        let made = match made {
            Err(e) if self.builder.options.lenient => {
                self.builder.warn(format!("{e}; gray instead"));
                self.builder.constant(Rgb::splat(0.5))
            }
            made => made?,
        };
        self.textures.insert(key, made);
        if !self.asked.is_empty() {
            self.attributes.insert(made, self.asked.clone());
        }
        self.asked.extend(asked);
        Ok(made)
    }

    fn make_texture(&mut self, object: &Rc<Object>, quantity: Quantity) -> Result<TextureId> {
        let texture = match object.plugin.as_str() {
            "bitmap" => Texture::Bitmap(self.bitmap(object)?),
            "checkerboard" => {
                let colors =
                    [self.texture(object, "color0", 0.4, quantity)?, self.texture(object, "color1", 0.2, quantity)?];
                // Where Mitsuba 2 and 3 read a number off the board, they take the squares of the other colour.
                let [color0, color1] = match quantity == Quantity::Number && !self.is_old() {
                    true => [colors[1], colors[0]],
                    false => colors,
                };
                Texture::Checkerboard(Checkerboard { color0, color1, board_from_uv: image_from_uv(object)? })
            }
            "scale" => {
                let id = self.scaled(object, quantity)?;
                self.finish(object)?;
                return Ok(id);
            }
            "mesh_attribute" => match object.text("name")? {
                Some(name) if name.starts_with("vertex_") || name.starts_with("face_") => {
                    self.asked.insert(name.to_owned());
                    Texture::VertexColor(Rgb::splat(object.number("scale")?.unwrap_or(1.0) as f32))
                }
                _ => return Err(object.place.invalid("the name of a mesh attribute begins with vertex_ or face_")),
            },
            "vertexcolors" => {
                self.asked.insert("vertex_color".to_owned());
                Texture::VertexColor(Rgb::ONE)
            }
            "uniform" => Texture::Constant(self.spectrum_value(object, "value", 1.0, quantity)?),
            "srgb" | "rgb" => Texture::Constant(self.color(object, "color", 0.5, quantity)?),
            "d65" => Texture::Constant(Rgb::splat(object.number("scale")?.unwrap_or(1.0) as f32)),
            "blackbody" => {
                let scale = object.number("scale")?.unwrap_or(1.0) as f32;
                Texture::Constant(spectrum::black_body(object.positive("temperature", 5000.0)?) * scale)
            }
            // A number or three of them, as they stand.
            "rawconstant" => Texture::Constant(match object.property("value").map(|p| &p.value) {
                Some(Value::Number(v)) => Rgb::splat(*v as f32),
                Some(Value::Point(v)) => v.as_vec3(),
                _ => return Err(object.place.invalid("the value of rawconstant is a number or a vector")),
            }),
            _ => return Err(object.unsupported()),
        };
        self.finish(object)?;
        Ok(match texture {
            Texture::Constant(rgb) => self.builder.constant(rgb),
            texture => self.builder.texture(texture),
        })
    }

    /// A number meant as a flat spectrum.
    fn spectrum_value(&mut self, object: &Object, name: &str, default: f64, quantity: Quantity) -> Result<Rgb> {
        Ok(Spectrum::Uniform(object.number(name)?.unwrap_or(default)).color(quantity))
    }

    fn bitmap(&mut self, object: &Rc<Object>) -> Result<Bitmap> {
        // A gamma of 1 was the old way to say raw.
        let raw = object.boolean("raw", object.number("gamma")? == Some(1.0))?;
        let path = self.file(object, "filename")?;
        let wrap = |name: &str, default: Wrap| -> Result<Wrap> {
            Ok(match object.text(name)? {
                None => default,
                Some("repeat") => Wrap::Repeat,
                Some("mirror") => Wrap::Mirror,
                Some("clamp") => Wrap::Clamp,
                Some("zero" | "black") => Wrap::Zero,
                Some("one" | "white") => Wrap::One,
                Some(other) => return Err(object.place.invalid(format!("{other:?} is no way to wrap a texture"))),
            })
        };
        let both = wrap("wrap_mode", Wrap::Repeat)?;
        let filter = match object.text("filter_type")? {
            None | Some("bilinear" | "trilinear" | "ewa") => Filter::Bilinear,
            Some("nearest") => Filter::Nearest,
            Some(other) => return Err(object.place.invalid(format!("{other:?} is no filter of textures"))),
        };
        let channel = match object.text("channel")? {
            None | Some("all" | "rgb") => Channel::Rgb,
            Some("r" | "x") => Channel::Red,
            Some("g" | "y") => Channel::Green,
            Some("b" | "z") => Channel::Blue,
            Some("a") => Channel::Alpha,
            Some(other) => return Err(object.place.invalid(format!("{other:?} is no channel of a texture"))),
        };
        Ok(Bitmap {
            set: 0,
            image: self.builder.image(&path, raw).map_err(|e| e.at(&object.place.file, object.place.line))?,
            image_from_uv: image_from_uv(object)?,
            filter,
            wrap: [wrap("wrap_mode_u", both)?, wrap("wrap_mode_v", both)?],
            channel,
            scale: Rgb::ONE,
        })
    }

    /// Mitsuba 0.6's factor on a texture.
    fn scaled(&mut self, object: &Rc<Object>, quantity: Quantity) -> Result<TextureId> {
        let factor = self.color(object, "scale", 1.0, Quantity::Factor)?;
        let inner = match self.child_of_class(object, "texture")? {
            Some(child) => self.texture_object(&child, quantity)?,
            None => self.texture(object, "value", 1.0, quantity)?,
        };
        Ok(self.builder.scaled(inner, factor))
    }
}

/// Where texture coordinates fall in the picture: `to_uv`, or the scales and offsets of 0.6.
fn image_from_uv(object: &Object) -> Result<DAffine2> {
    let m = object.transform("to_uv")?;
    let [x, y] = [m.matrix3.x_axis, m.matrix3.y_axis].map(|c| c.truncate());
    let given = DAffine2::from_mat2_translation(DMat2::from_cols(x, y), m.translation.truncate());
    let both = object.number("uvscale")?.unwrap_or(1.0);
    let number = |name: &str, default: f64| Ok::<_, crate::Error>(object.number(name)?.unwrap_or(default));
    let scale = DVec2::new(number("uscale", both)?, number("vscale", both)?);
    let offset = DVec2::new(number("uoffset", 0.0)?, number("voffset", 0.0)?);
    let old = DAffine2::from_mat2_translation(DMat2::from_diagonal(scale), offset);
    let whole = given * old * MITSUBA_FROM_UV;
    if !whole.is_finite() {
        return Err(object.place.invalid("the transform of texture coordinates is not finite"));
    }
    Ok(whole)
}
