//! Cameras and films.

use super::Loader;
use super::object::Object;
use crate::Result;
use crate::sensor::{Crop, Film, FovAxis, Perspective, PixelFilter, Projection, Sensor};
use std::rc::Rc;

impl Loader {
    pub(super) fn sensor(&mut self, object: &Rc<Object>) -> Result<Sensor> {
        let near_clip = object.positive("near_clip", 1e-2)? as f32;
        let far_clip = object.positive("far_clip", 1e4)? as f32;
        let projection = match object.plugin.as_str() {
            "perspective" => Projection::Perspective(self.perspective(object)?),
            "thinlens" => Projection::ThinLens {
                perspective: self.perspective(object)?,
                aperture_radius: match object.number("aperture_radius")? {
                    Some(r) if r >= 0.0 => r as f32,
                    _ => return Err(object.place.invalid("a thinlens camera has no \"aperture_radius\"")),
                },
                focus_distance: object.positive("focus_distance", far_clip.into())? as f32,
            },
            "orthographic" => Projection::Orthographic,
            _ => return Err(object.unsupported()),
        };
        let _ = object.property("focus_distance"); // a pinhole has everything in focus
        if object
            .number("shutter_close")?
            .is_some_and(|t| t > object.number("shutter_open").ok().flatten().unwrap_or(0.0))
        {
            self.builder.warn(object.place.warning("the shutter's times are not used: nothing moves"));
        }
        let film = match self.child_of_class(object, "film")? {
            Some(film) => self.film(&film)?,
            None => Film { size: [768, 576], crop: None, filter: PixelFilter::default() },
        };
        let sample_count = match self.child_of_class(object, "sampler")? {
            Some(sampler) => {
                let count = sampler.integer("sample_count")?.unwrap_or(4);
                u32::try_from(count).ok().filter(|&n| n > 0)
            }
            None => None,
        };
        let medium = self.child_of_class(object, "medium")?.map(|m| self.medium(&m)).transpose()?;
        let world_from_camera = object.invertible("to_world")?;
        self.finish(object)?;
        let name = object.id.clone();
        Ok(Sensor { name, world_from_camera, projection, near_clip, far_clip, film, sample_count, medium })
    }

    /// The opening of a pinhole camera, as a field of view or a focal length of 35 mm film.
    pub(super) fn perspective(&mut self, object: &Object) -> Result<Perspective> {
        let axis = match object.text("fov_axis")? {
            None | Some("x") => FovAxis::X,
            Some("y") => FovAxis::Y,
            Some("diagonal") => FovAxis::Diagonal,
            Some("smaller") => FovAxis::Smaller,
            Some("larger") => FovAxis::Larger,
            Some(other) => return Err(object.place.invalid(format!("{other:?} is no axis of a field of view"))),
        };
        let (fov, fov_axis) = match (object.number("fov")?, object.property("focal_length")) {
            (Some(fov), _) => (fov.to_radians(), axis),
            (None, given) => {
                let millimetres = match given.map(|p| (&p.value, &p.place)) {
                    None => 50.0,
                    Some((super::object::Value::Number(mm), _)) => *mm,
                    Some((super::object::Value::Text(text), place)) => {
                        super::object::number(text.trim().trim_end_matches("mm"), place)?
                    }
                    Some((_, place)) => return Err(place.invalid("the focal length is not a number")),
                };
                // The frame's diagonal is √(36² + 24²) mm.
                (2.0 * (0.5 * f64::hypot(36.0, 24.0) / millimetres).atan(), FovAxis::Diagonal)
            }
        };
        if !(fov > 0.0 && fov < std::f64::consts::PI) {
            return Err(object.place.invalid("the field of view is not between 0° and 180°"));
        }
        let offset = |name: &str| Ok::<_, crate::Error>(object.number(name)?.unwrap_or(0.0) as f32);
        Ok(Perspective {
            fov: fov as f32,
            fov_axis,
            principal_point_offset: [offset("principal_point_offset_x")?, offset("principal_point_offset_y")?],
        })
    }

    fn film(&mut self, object: &Rc<Object>) -> Result<Film> {
        if object.plugin != "hdrfilm" {
            let what = format!("{} is taken as an \"hdrfilm\": linear values are what comes out", object.title());
            self.builder.warn(object.place.warning(what));
        }
        let size = |name: &str, default: u32| -> Result<u32> {
            let Some(n) = object.integer(name)? else { return Ok(default) };
            let wrong =
                || object.place.invalid(format!("{name:?} of the film is {n}; it is between 1 and {MOST_PIXELS}"));
            u32::try_from(n).ok().filter(|n| (1..=MOST_PIXELS).contains(n)).ok_or_else(wrong)
        };
        let (width, height) = (size("width", 768)?, size("height", 576)?);
        crate::check::film_size([width, height]).map_err(|what| object.place.unsupported(what))?;
        let crop = match (object.property("crop_width"), object.property("crop_height")) {
            (None, None) => None,
            _ => {
                let offset = |name: &str| Ok::<_, crate::Error>(object.integer(name)?.unwrap_or(0));
                let (x, y) = (offset("crop_offset_x")?, offset("crop_offset_y")?);
                let (w, h) = (size("crop_width", width)?, size("crop_height", height)?);
                let inside = |o: i64, n: u32, all: u32| o >= 0 && o + i64::from(n) <= i64::from(all);
                if !inside(x, w, width) || !inside(y, h, height) {
                    return Err(object.place.invalid("the film's crop window is not inside of the film"));
                }
                Some(Crop { offset: [x as u32, y as u32], size: [w, h] })
            }
        };
        let filter = match self.child_of_class(object, "rfilter")? {
            Some(filter) => self.pixel_filter(&filter)?,
            None => PixelFilter::default(),
        };
        self.finish(object)?;
        Ok(Film { size: [width, height], crop, filter })
    }

    fn pixel_filter(&mut self, object: &Rc<Object>) -> Result<PixelFilter> {
        let number = |name: &str, default: f64| object.positive(name, default).map(|v| v as f32);
        let filter = match object.plugin.as_str() {
            "box" => PixelFilter::Box { radius: number("radius", 0.5)? },
            "tent" => PixelFilter::Tent { radius: number("radius", 1.0)? },
            "gaussian" => {
                let stddev = number("stddev", 0.5)?;
                PixelFilter::Gaussian { stddev, radius: 4.0 * stddev }
            }
            "mitchell" => {
                let third = 1.0 / 3.0;
                let any =
                    |name: &str, default: f64| Ok::<_, crate::Error>(object.number(name)?.unwrap_or(default) as f32);
                // 0.6 calls them B and C, 3 calls them A and B.
                match object.properties.iter().any(|p| p.name == "c") {
                    true => PixelFilter::Mitchell { b: any("b", third)?, c: any("c", third)? },
                    false => PixelFilter::Mitchell { b: any("a", third)?, c: any("b", third)? },
                }
            }
            "catmullrom" => PixelFilter::CatmullRom,
            "lanczos" => PixelFilter::Lanczos { lobes: number("lobes", 3.0)? },
            _ => return Err(object.unsupported()),
        };
        self.finish(object)?;
        Ok(filter)
    }
}

/// Films are not wider or higher.
const MOST_PIXELS: u32 = 65_536;
