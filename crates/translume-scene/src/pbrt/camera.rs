//! Cameras, films, filters, samplers and integrators: settings that count once the file has been read.

use super::Loader;
use super::parameters::Parameters;
use crate::Result;
use crate::scene::{Integrator, MediumId};
use crate::sensor::{Crop, Film, FovAxis, Perspective, PixelFilter, Projection, Sensor};
use glam::{DAffine3, DVec3};

/// What the file said, and where.
#[derive(Default)]
pub(super) struct Settings {
    camera: Option<(String, Parameters, DAffine3, Option<MediumId>)>,
    film: Option<(String, Parameters)>,
    filter: Option<PixelFilter>,
    sample_count: Option<u32>,
}

impl Loader {
    pub(super) fn setting(&mut self, directive: &str, kind: &str, parameters: Parameters) -> Result<()> {
        match directive {
            "Integrator" => {
                let depth = parameters.integer("maxdepth", 5)?.max(0);
                self.builder.scene.integrator = Integrator {
                    name: kind.to_owned(),
                    // Here the depth counts scattering, there segments.
                    max_depth: Some(u32::try_from(depth).unwrap_or(u32::MAX).saturating_add(1)),
                    ..Integrator::default()
                };
            }
            "Sampler" => {
                let count = parameters.integer("pixelsamples", 16)?;
                self.settings.sample_count = u32::try_from(count).ok().filter(|&n| n > 0);
            }
            "PixelFilter" => self.settings.filter = Some(self.pixel_filter(kind, &parameters)?),
            "Film" => self.settings.film = Some((kind.to_owned(), parameters)),
            _ => {
                let place = &parameters.place;
                let world_from_camera = self.placed(place)?.inverse();
                self.systems.insert("camera".to_owned(), world_from_camera);
                self.settings.camera = Some((kind.to_owned(), parameters, world_from_camera, self.state.exterior));
            }
        }
        Ok(())
    }

    fn pixel_filter(&mut self, kind: &str, p: &Parameters) -> Result<PixelFilter> {
        let radius = |default: f64| -> Result<f32> {
            let (x, y) = (p.number("xradius", default)?, p.number("yradius", default)?);
            if x != y || x <= 0.0 {
                return Err(p.place.unsupported("a pixel filter of different radii, or none"));
            }
            Ok(x as f32)
        };
        let filter = match kind {
            "box" => PixelFilter::Box { radius: radius(0.5)? },
            "triangle" => PixelFilter::Tent { radius: radius(2.0)? },
            "gaussian" => PixelFilter::Gaussian { stddev: p.number("sigma", 0.5)? as f32, radius: radius(1.5)? },
            "mitchell" => {
                let third = 1.0 / 3.0;
                let _ = radius(2.0)?; // ours has this radius
                PixelFilter::Mitchell { b: p.number("B", third)? as f32, c: p.number("C", third)? as f32 }
            }
            "sinc" => PixelFilter::Lanczos { lobes: radius(4.0)?.min(p.number("tau", 3.0)? as f32) },
            _ => return Err(p.place.unsupported(format!("pixel filter {kind:?} is not supported"))),
        };
        self.finish(kind, p);
        Ok(filter)
    }

    /// Puts the camera together, now that the film is known.
    pub(super) fn film_and_camera(&mut self) -> Result<()> {
        let settings = std::mem::take(&mut self.settings);
        let filter = settings.filter.unwrap_or(PixelFilter::Gaussian { stddev: 0.5, radius: 1.5 });
        let film = match settings.film {
            Some((kind, parameters)) => self.film(&kind, &parameters, filter)?,
            None => Film { size: [1280, 720], crop: None, filter },
        };
        let Some((kind, p, world_from_camera, medium)) = settings.camera else { return Ok(()) };
        let [width, height] = film.size;
        let aspect = f64::from(width) / f64::from(height);
        let fov = p.number("fov", 90.0)?.to_radians();
        if !(fov > 0.0 && fov < std::f64::consts::PI) {
            return Err(p.place.invalid("the field of view is not between 0° and 180°"));
        }
        let perspective = Perspective { fov: fov as f32, fov_axis: FovAxis::Smaller, principal_point_offset: [0.0; 2] };
        let lens = p.number("lensradius", 0.0)?;
        let focus = p.number("focaldistance", 1e6)?;
        let (projection, across) = match kind.as_str() {
            "perspective" if lens > 0.0 && focus > 0.0 => {
                let lens = (lens as f32, focus as f32);
                (Projection::ThinLens { perspective, aperture_radius: lens.0, focus_distance: lens.1 }, 1.0)
            }
            "perspective" => (Projection::Perspective(perspective), 1.0),
            "orthographic" if lens == 0.0 => (Projection::Orthographic, aspect.max(1.0)),
            _ => return Err(p.place.unsupported(format!("camera {kind:?} is not supported, or not with a lens"))),
        };
        let _ = (p.get("shutteropen"), p.get("shutterclose")); // nothing moves
        for name in ["frameaspectratio", "screenwindow"] {
            if p.get(name).is_some() {
                let refused = Err(p.place.unsupported(format!("{name:?} of a camera is not supported")));
                self.skippable(refused)?;
            }
        }
        self.finish(&kind, &p);
        // There +x is right, here it is left.
        let turn = DAffine3::from_scale(DVec3::new(-across, across, 1.0));
        self.builder.scene.sensors.push(Sensor {
            name: String::new(),
            world_from_camera: world_from_camera * turn,
            projection,
            near_clip: 0.0,
            far_clip: f32::MAX,
            film,
            sample_count: settings.sample_count,
            medium,
        });
        Ok(())
    }

    fn film(&mut self, kind: &str, p: &Parameters, filter: PixelFilter) -> Result<Film> {
        let size = |name: &str, default: i64| -> Result<u32> {
            let n = p.integer(name, default)?;
            let wrong = || p.place.invalid(format!("{name:?} of the film is {n}; it is between 1 and 65536"));
            u32::try_from(n).ok().filter(|n| (1..=65_536).contains(n)).ok_or_else(wrong)
        };
        let [width, height] = [size("xresolution", 1280)?, size("yresolution", 720)?];
        crate::check::film_size([width, height]).map_err(|what| p.place.unsupported(what))?;
        let crop = match p.numbers("cropwindow")? {
            None => None,
            Some(&[x0, x1, y0, y1]) if 0.0 <= x0 && x0 < x1 && x1 <= 1.0 && 0.0 <= y0 && y0 < y1 && y1 <= 1.0 => {
                let at = |f: f64, n: u32| (f * f64::from(n)).ceil() as u32;
                let (offset, end) = ([at(x0, width), at(y0, height)], [at(x1, width), at(y1, height)]);
                let size = [end[0] - offset[0], end[1] - offset[1]];
                (size[0] > 0 && size[1] > 0).then_some(Crop { offset, size })
            }
            Some(_) => return Err(p.place.invalid("\"cropwindow\" is not x0 x1 y0 y1 within 0 and 1")),
        };
        for name in ["filename", "savefp16", "diagonal"] {
            let _ = p.get(name); // how the picture is written is the renderer's affair
        }
        if !matches!(p.text("sensor")?, None | Some("cie1931"))
            || p.get("iso").is_some()
            || p.get("exposuretime").is_some()
        {
            self.builder.warn(p.place.warning("sensor, ISO and exposure time of the film are not used"));
        }
        self.finish(kind, p);
        Ok(Film { size: [width, height], crop, filter })
    }
}
