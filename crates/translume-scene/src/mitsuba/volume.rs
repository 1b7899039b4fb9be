//! Media, phase functions and grids.

use super::Loader;
use super::object::Object;
use crate::Result;
use crate::medium::{Medium, Samples, Volume};
use crate::scene::MediumId;
use crate::spectrum::Quantity;
use crate::texture::{Filter, Wrap};
use glam::{DAffine3, DMat3};
use std::rc::Rc;
use translume_bxdf::{Phase, Rgb};

const FACTOR: Quantity = Quantity::Factor;

impl Loader {
    pub(super) fn medium(&mut self, object: &Rc<Object>) -> Result<MediumId> {
        if let Some(&id) = self.media.get(&Rc::as_ptr(object)) {
            return Ok(id);
        }
        if object.class != "medium" {
            return Err(object.place.invalid(format!("{} is no medium", object.title())));
        }
        let ((sigma_t, domain), albedo) = match object.plugin.as_str() {
            "homogeneous" => self.homogeneous(object)?,
            "heterogeneous" => {
                let density = if self.is_old() { "density" } else { "sigma_t" };
                let (sigma_t, place) = self.volume_named(object, density, 1.0)?;
                // In Mitsuba 3 a medium ends with the unit cube of its density's transform, also where the density is constant.
                let domain = (!self.is_old() || matches!(sigma_t, Volume::Grid { .. })).then_some(place);
                ((sigma_t, domain), self.volume_named(object, "albedo", 0.75)?.0)
            }
            _ => return Err(object.unsupported()),
        };
        let scale = object.number("scale")?.unwrap_or(1.0) as f32;
        if !(scale >= 0.0 && scale.is_finite()) {
            return Err(object.place.invalid("the scale of a medium is not negative"));
        }
        let phase = match self.child_of_class(object, "phase")? {
            Some(phase) => self.phase(&phase)?,
            None => Phase::Isotropic,
        };
        self.finish(object)?;
        let albedo = self.at_most_one(object, albedo);
        let id = MediumId(self.builder.scene.media.len());
        let medium = Medium { name: object.id.clone(), sigma_t, albedo, scale, phase, domain };
        if !medium.majorant().is_finite() {
            return Err(object
                .place
                .invalid(format!("the extinction of {} times its scale is too large", object.title())));
        }
        self.builder.scene.media.push(medium);
        self.media.insert(Rc::as_ptr(object), id);
        Ok(id)
    }

    /// Extinction, with what it is limited to, and albedo.
    fn homogeneous(&mut self, object: &Rc<Object>) -> Result<((Volume, Option<DAffine3>), Volume)> {
        if let Some(name) = object.text("material")? {
            let what = format!("the medium preset {name:?} is not known; give sigma_t and albedo");
            return Err(object.place.unsupported(what));
        }
        let (s, a) = (self.given_color(object, "sigma_s", FACTOR)?, self.given_color(object, "sigma_a", FACTOR)?);
        if s.is_none() && a.is_none() {
            let (sigma_t, place) = self.volume_named(object, "sigma_t", 1.0)?;
            let varies = matches!(sigma_t, Volume::Grid { .. });
            if varies {
                let what = format!("{} has a grid as sigma_t and is taken as a heterogeneous one", object.title());
                self.builder.warn(object.place.warning(what));
            }
            return Ok(((sigma_t, varies.then_some(place)), self.volume_named(object, "albedo", 0.75)?.0));
        }
        let (s, a) = (s.unwrap_or(Rgb::ZERO), a.unwrap_or(Rgb::ZERO));
        let t = s + a;
        let albedo = Rgb::from(std::array::from_fn(|c| if t[c] > 0.0 { s[c] / t[c] } else { 0.0 }));
        Ok(((Volume::Constant(t), None), Volume::Constant(albedo)))
    }

    fn phase(&mut self, object: &Rc<Object>) -> Result<Phase> {
        let phase = match object.plugin.as_str() {
            "isotropic" => Phase::Isotropic,
            "rayleigh" => Phase::Rayleigh,
            "hg" => match object.number("g")?.unwrap_or(0.8) {
                g if g.abs() < 1.0 => Phase::HenyeyGreenstein { g: g as f32 },
                _ => return Err(object.place.invalid("\"g\" of a phase function is between −1 and 1")),
            },
            _ => return Err(object.unsupported()),
        };
        self.finish(object)?;
        Ok(phase)
    }

    /// A volume in place, as a colour, or nested; and where its unit cube is in the world.
    fn volume_named(&mut self, object: &Rc<Object>, name: &str, default: f32) -> Result<(Volume, DAffine3)> {
        if let Some(rgb) = self.given_color(object, name, FACTOR)? {
            return Ok((Volume::Constant(rgb), DAffine3::IDENTITY));
        }
        let Some(volume) = self.child_named(object, name)? else {
            return Ok((Volume::Constant(Rgb::splat(default)), DAffine3::IDENTITY));
        };
        let made = match volume.plugin.as_str() {
            "constvolume" => {
                (Volume::Constant(self.color(&volume, "value", 1.0, FACTOR)?), volume.invertible("to_world")?)
            }
            "gridvolume" => self.grid(&volume)?,
            "uniform" | "srgb" | "rgb" => {
                let texture = self.texture_object(&volume, FACTOR)?;
                let constant = self.builder.scene.constant(texture).unwrap_or(Rgb::ONE);
                (Volume::Constant(constant), DAffine3::IDENTITY)
            }
            _ => return Err(volume.unsupported()),
        };
        self.finish(&volume)?;
        Ok(made)
    }

    fn grid(&mut self, object: &Rc<Object>) -> Result<(Volume, DAffine3)> {
        let path = self.file(object, "filename")?;
        let loaded = self.builder.grid(&path).map_err(|e| e.at(&object.place.file, object.place.line))?;
        if loaded.bad > 0 {
            let what = format!("{}: {} values are negative or not finite and count as 0", path.display(), loaded.bad);
            self.builder.warn(object.place.warning(what));
        }
        let filter = match object.text("filter_type")? {
            None | Some("trilinear") => Filter::Bilinear,
            Some("nearest") => Filter::Nearest,
            Some(other) => return Err(object.place.invalid(format!("{other:?} is no filter of grids"))),
        };
        let wrap = match object.text("wrap_mode")? {
            None if self.is_old() => Wrap::Zero,
            None | Some("clamp") => Wrap::Clamp,
            Some("repeat") => Wrap::Repeat,
            Some("mirror") => Wrap::Mirror,
            Some(other) => return Err(object.place.invalid(format!("{other:?} is no way to wrap a grid"))),
        };
        let _ = object.boolean("raw", true)?; // numbers are numbers
        let lo = object.point("min")?.unwrap_or(loaded.lo);
        let hi = object.point("max")?.unwrap_or(loaded.hi);
        if !lo.cmplt(hi).all() {
            return Err(object.place.invalid("the box of the grid is empty"));
        }
        let mut world_from_grid = object.invertible("to_world")?;
        if object.boolean("use_grid_bbox", self.is_old())? {
            world_from_grid *= DAffine3::from_mat3_translation(DMat3::from_diagonal(hi - lo), lo);
        }
        let samples = if self.is_old() { Samples::Corners } else { Samples::Centers };
        Ok((Volume::Grid { grid: loaded.grid.clone(), world_from_grid, samples, filter, wrap }, world_from_grid))
    }

    /// An albedo above 1 would make light.
    fn at_most_one(&mut self, object: &Object, albedo: Volume) -> Volume {
        let max = match &albedo {
            Volume::Constant(rgb) => *rgb,
            Volume::Grid { grid, .. } => grid.max(),
        };
        if max.max_element() <= 1.0 {
            return albedo;
        }
        self.builder.warn(object.place.warning("an albedo above 1 is taken as 1"));
        match albedo {
            Volume::Constant(rgb) => Volume::Constant(rgb.min(Rgb::ONE)),
            Volume::Grid { grid, world_from_grid, samples, filter, wrap } => {
                let mut clipped = (*grid).clone();
                clipped.values.iter_mut().for_each(|v| *v = v.min(1.0));
                Volume::Grid { grid: clipped.into(), world_from_grid, samples, filter, wrap }
            }
        }
    }
}
