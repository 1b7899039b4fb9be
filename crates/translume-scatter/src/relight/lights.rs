//! Lights and a view, as the JSON that `docs/formats/lights.md` describes. Lengths are mm of the model, z is up.

use serde::{Deserialize, Serialize};
use std::path::Path;
use translume_image::{Error, Result};

/// What shines and who looks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lighting {
    /// The camera.
    pub view: Sight,
    /// All lights together.
    pub lights: Vec<Light>,
}

/// A pinhole camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sight {
    /// Where it is.
    pub eye: [f64; 3],
    /// What it looks at.
    pub target: [f64; 3],
    /// What is upright in the picture.
    #[serde(default = "z_up")]
    pub up: [f64; 3],
    /// Angle across the width.
    pub fov_deg: f64,
    /// Columns.
    #[serde(default = "width")]
    pub width: usize,
    /// Rows.
    #[serde(default = "height")]
    pub height: usize,
    /// Samples along each side of a pixel.
    #[serde(default = "samples")]
    pub samples: usize,
}

/// A light. Intensities are radiance times area per solid angle: a point at distance r gives the irradiance I cos θ/r².
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase", deny_unknown_fields)]
pub enum Light {
    /// The same in all directions.
    Point {
        /// Where.
        position: [f64; 3],
        /// Red, green, blue.
        intensity: [f32; 3],
    },
    /// A cone whose border falls off smoothly.
    Spot {
        /// Where.
        position: [f64; 3],
        /// What it is aimed at.
        target: [f64; 3],
        /// On its axis.
        intensity: [f32; 3],
        /// Nothing beyond this angle to the axis.
        cutoff_deg: f64,
        /// Full within this one.
        beam_deg: f64,
    },
    /// A picture of all directions, latitude and longitude; its top is +z, its middle column +x, and +y is left of it.
    Environment {
        /// The picture, beside the JSON file unless absolute.
        file: String,
        /// Factor on its radiance.
        #[serde(default = "one")]
        scale: f32,
        /// Directions that stand for it.
        #[serde(default = "directions")]
        samples: usize,
    },
    /// A slide projector.
    Projector {
        /// Where.
        position: [f64; 3],
        /// What its axis points at.
        target: [f64; 3],
        /// What is upright in the slide.
        #[serde(default = "z_up")]
        up: [f64; 3],
        /// Angle across the width of the slide.
        fov_deg: f64,
        /// The slide: irradiance on a plane 1 mm away, across the axis.
        file: String,
        /// Factor on it.
        #[serde(default = "one")]
        scale: f32,
    },
}

fn z_up() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}
fn width() -> usize {
    512
}
fn height() -> usize {
    384
}
fn samples() -> usize {
    2
}
fn one() -> f32 {
    1.0
}
fn directions() -> usize {
    256
}

impl Lighting {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Invalid`] with what is wrong.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read(path).map_err(|e| Error::io(path, e))?;
        let lighting: Self = serde_json::from_slice(&text).map_err(|e| Error::invalid(path, e.to_string()))?;
        lighting.check().map_err(|what| Error::invalid(path, what))?;
        Ok(lighting)
    }

    fn check(&self) -> std::result::Result<(), String> {
        let view = &self.view;
        look(view.eye, view.target, view.up).ok_or("view: eye, target and up do not span a view")?;
        if !(0.01..179.0).contains(&view.fov_deg) {
            return Err("view: fov_deg must lie between 0.01 and 179".into());
        }
        if ![view.width, view.height].iter().all(|n| (1..=16384).contains(n)) || !(1..=16).contains(&view.samples) {
            return Err("view: width and height lie between 1 and 16384, samples between 1 and 16".into());
        }
        for (i, light) in self.lights.iter().enumerate() {
            light.check().map_err(|what| format!("light {i}: {what}"))?;
        }
        Ok(())
    }
}

impl Light {
    fn check(&self) -> std::result::Result<(), &'static str> {
        let sound = |rgb: &[f32; 3]| rgb.iter().all(|x| x.is_finite() && *x >= 0.0);
        match self {
            Self::Point { position, intensity } => (sound(intensity) && position.iter().all(|x| x.is_finite()))
                .then_some(())
                .ok_or("position or intensity is no number of 0 or more"),
            Self::Spot { position, target, intensity, cutoff_deg, beam_deg } => {
                let angles =
                    (0.0..180.0).contains(cutoff_deg) && (0.0..=*cutoff_deg).contains(beam_deg) && *cutoff_deg > 0.0;
                let aim = look(*position, *target, [0.3, 0.7, 0.2]).or_else(|| look(*position, *target, z_up()));
                match (sound(intensity) && aim.is_some(), angles) {
                    (true, true) => Ok(()),
                    (_, false) => Err("cutoff_deg lies between 0 and 180 and beam_deg is not larger"),
                    _ => Err("it has no direction, or an intensity below 0"),
                }
            }
            Self::Environment { scale, samples, .. } => {
                let sound = scale.is_finite() && *scale >= 0.0 && (1..=65536).contains(samples);
                sound.then_some(()).ok_or("scale is 0 or more, samples 1 to 65536")
            }
            Self::Projector { position, target, up, fov_deg, scale, .. } => {
                look(*position, *target, *up).ok_or("position, target and up do not span a slide")?;
                let sound = scale.is_finite() && *scale >= 0.0 && (0.01..179.0).contains(fov_deg);
                sound.then_some(()).ok_or("scale is 0 or more, fov_deg lies between 0.01 and 179")
            }
        }
    }
}

/// Right, down and forward of somebody at `eye` who looks at `target`.
pub(super) fn look(eye: [f64; 3], target: [f64; 3], up: [f64; 3]) -> Option<[glam::Vec3; 3]> {
    let [eye, target, up] = [eye, target, up].map(glam::DVec3::from_array);
    let forward = (target - eye).try_normalize()?;
    let right = forward.cross(up).try_normalize()?;
    let down = forward.cross(right);
    let all = [right, down, forward].map(|v| v.as_vec3());
    all.iter().all(|v| v.is_finite()).then_some(all)
}
