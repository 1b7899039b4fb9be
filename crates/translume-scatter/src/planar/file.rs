//! A planar model on disk: `model.json` and one OpenEXR texture for each view, with a channel `alpha.NAME` and the number of
//! samples behind it, `samples.NAME`, for each channel of the rig.

use super::model::PlanarModel;
use super::samples::PlanarCapture;
use crate::capture::Camera;
use crate::fit::Model;
use crate::model_folder::write_model;
use serde::{Deserialize, Serialize};
use std::path::Path;
use translume_image::{Error, ExrOptions, Precision, Result, atomic, read_exr_channels, write_exr_channels};

/// Version of the format; a reader refuses another major one.
pub const MODEL_VERSION: &str = "1.1";
pub(crate) const FORMAT: &str = "translume planar model";

/// What stands in `model.json` beside the points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelHead {
    /// `translume planar model`.
    pub format: String,
    /// [`MODEL_VERSION`].
    pub version: String,
    /// The command line that made it.
    pub command: String,
    /// The fall-off.
    pub model: Model,
    /// Directions.
    pub segments: usize,
    /// Most exponentials.
    pub terms: usize,
    /// One fall-off for all channels.
    pub shared: bool,
    /// Multiple of the noise floor above which a pixel was a sample.
    pub threshold: f64,
    /// Names of the channels.
    pub channels: Vec<String>,
    /// View and laser position of each point's frames.
    pub frames: Vec<[usize; 2]>,
    /// Relative index of refraction that the samples were made with; since 1.1, before: 1.3.
    #[serde(default = "eta_before")]
    pub eta: f64,
    /// The cameras of the textures; since 1.1.
    #[serde(default)]
    pub cameras: Vec<Camera>,
    /// Power of the laser in each point's frame and channel, against what the rig says, where it was estimated.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub gains: Vec<Vec<f64>>,
}

fn eta_before() -> f64 {
    1.3
}

#[derive(Serialize, Deserialize)]
struct Whole {
    #[serde(flatten)]
    head: ModelHead,
    #[serde(flatten)]
    model: PlanarModel,
}

/// Writes the model into the folder `path`, whole or not at all; see [`crate::check_model_folder`].
///
/// # Errors
/// [`Error::Io`], also where `path` exists and is no model.
pub fn save_model(path: &Path, head: &ModelHead, model: &PlanarModel, size: (usize, usize)) -> Result<()> {
    write_model(path, |new| write_parts(new, head, model, size))
}

fn write_parts(path: &Path, head: &ModelHead, model: &PlanarModel, size: (usize, usize)) -> Result<()> {
    let whole = Whole { head: head.clone(), model: model.clone() };
    let text = serde_json::to_string(&whole).expect("plain data");
    let options = ExrOptions { precision: Precision::Float, ..ExrOptions::default() };
    for (view, (alpha, samples)) in model.texture.iter().zip(&model.texture_samples).enumerate() {
        let planes = head.channels.iter().zip(alpha.iter().zip(samples));
        let names: Vec<[String; 2]> =
            head.channels.iter().map(|n| [format!("alpha.{n}"), format!("samples.{n}")]).collect();
        let channels: Vec<(&str, &[f32])> = names
            .iter()
            .zip(planes)
            .flat_map(|([a, s], (_, (alpha, samples)))| [(a.as_str(), &alpha[..]), (s.as_str(), &samples[..])])
            .collect();
        write_exr_channels(&path.join(format!("texture-{view}.exr")), size, &channels, &options)?;
    }
    atomic::write_bytes(&path.join("model.json"), text.as_bytes())
}

/// Reads a model that was fitted to `capture`.
///
/// # Errors
/// As [`read_model`], and [`Error::Invalid`] for a model of another capture.
pub fn load_model(path: &Path, capture: &PlanarCapture) -> Result<(ModelHead, PlanarModel)> {
    let (head, model) = read_model(path)?;
    let rig = &capture.capture.rig;
    let frames = capture.spots.iter().map(|s| s.frame);
    let same = head.channels.iter().eq(rig.channels.iter().map(|c| &c.name))
        && frames.eq(head.frames.iter().copied())
        && head.cameras.iter().eq(rig.views.iter().map(|v| &v.camera));
    match same {
        true => Ok((head, model)),
        false => {
            let what = "it was not fitted to this capture: channels, cameras or laser positions differ";
            Err(Error::invalid(&path.join("model.json"), what))
        }
    }
}

/// Reads a model with its textures.
///
/// # Errors
/// [`Error::Io`]; [`Error::Invalid`] for damaged files; [`Error::Unsupported`] for another version, and for 1.0, which has no
/// cameras.
pub fn read_model(path: &Path) -> Result<(ModelHead, PlanarModel)> {
    let file = path.join("model.json");
    let text = std::fs::read(&file).map_err(|e| Error::io(&file, e))?;
    let head: serde_json::Value = serde_json::from_slice(&text).map_err(|e| Error::invalid(&file, e.to_string()))?;
    if head["format"] != FORMAT {
        return Err(Error::invalid(&file, "not a planar model of translume"));
    }
    let version = head["version"].as_str().unwrap_or_default();
    if version.split('.').next() != MODEL_VERSION.split('.').next() {
        return Err(Error::unsupported(&file, format!("version {version}; this program reads {MODEL_VERSION}")));
    }
    let Whole { head, mut model }: Whole =
        serde_json::from_slice(&text).map_err(|e| Error::invalid(&file, e.to_string()))?;
    let channels = head.channels.len();
    if head.cameras.is_empty() {
        return Err(Error::unsupported(&file, "it does not say where the cameras were; fit it again"));
    }
    let fits = |p: &super::model::LitPoint| p.scale.len() == channels && [1, channels].contains(&p.fall_off.len());
    let gains = |g: &Vec<f64>| g.len() == channels && g.iter().all(|g| *g > 0.0 && g.is_finite());
    if !(head.gains.is_empty() || head.gains.len() == head.frames.len() && head.gains.iter().all(gains)) {
        return Err(Error::invalid(&file, "its gains do not go with its frames and channels"));
    }
    if channels == 0 || model.points.len() != head.frames.len() || !model.points.iter().all(fits) {
        return Err(Error::invalid(&file, "its points do not go with its frames and channels"));
    }
    for (view, camera) in head.cameras.iter().enumerate() {
        let file = path.join(format!("texture-{view}.exr"));
        let mut texture = read_exr_channels(&file, 0)?;
        let mut take = |name: String| {
            let plane = texture.planes.iter_mut().find(|p| p.0 == name).map(|p| std::mem::take(&mut p.1));
            plane
                .filter(|p| Some(p.len()) == camera.width.checked_mul(camera.height))
                .ok_or_else(|| Error::invalid(&file, format!("no channel {name} of the frames' size")))
        };
        let plane = |kind: &str, take: &mut dyn FnMut(String) -> Result<Vec<f32>>| -> Result<Vec<Vec<f32>>> {
            head.channels.iter().map(|n| take(format!("{kind}.{n}"))).collect()
        };
        model.texture.push(plane("alpha", &mut take)?);
        model.texture_samples.push(plane("samples", &mut take)?);
    }
    Ok((head, model))
}
