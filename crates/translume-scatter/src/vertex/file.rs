//! Models of an object on disk: `model.json`, `mesh.ply`, and `texture.exr` with a row for each triangle and a column for each
//! of its texels, channels `alpha.NAME` and the number of samples behind it, `samples.NAME`.

use super::model::VertexModel;
use super::samples::MeshCapture;
use super::uniform::UniformModel;
use crate::capture::Texels;
use crate::capture::rgb_of;
use crate::fit::Model;
use crate::model_folder::write_model;
use serde::{Deserialize, Serialize};
use std::path::Path;
use translume_image::{Error, ExrOptions, Precision, Result, atomic, read_exr_channels, write_exr_channels};
use translume_mesh::{ReadOptions, TriMesh, ply};

/// Version of the format; a reader refuses another major one.
pub const VERTEX_MODEL_VERSION: &str = "1.1";
pub(crate) const FORMAT: &str = "translume vertex model";

/// What stands in `model.json` beside the vertices.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VertexHead {
    /// The command line that made it.
    pub command: String,
    /// The fall-off.
    pub model: Model,
    /// Most exponentials.
    pub terms: usize,
    /// Multiple of the noise floor above which a pixel was a sample.
    pub threshold: f64,
    /// Names of the channels.
    pub channels: Vec<String>,
    /// Relative index of refraction that the samples were made with; since 1.1, before: 1.3.
    #[serde(default = "eta_before")]
    pub eta: f64,
    /// Power of the laser in each frame, against what the rig says, where it was estimated.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub gains: Vec<FrameGain>,
}

/// The laser's power while the channels of a frame were taken.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameGain {
    /// View and laser position.
    pub frame: [usize; 2],
    /// For each channel.
    pub power: Vec<f64>,
}

impl FrameGain {
    /// The gains of a capture, as they are written down.
    pub fn of(mesh: &MeshCapture) -> Vec<Self> {
        let beam = |(i, gains): (usize, &Vec<Vec<f64>>)| {
            let (position, views) = (mesh.beams[i].position, mesh.views(i).to_vec());
            let frame = move |(view, power): (usize, Vec<f64>)| Self { frame: [view, position], power };
            views.into_iter().zip(gains.clone()).map(frame)
        };
        mesh.gains.iter().enumerate().flat_map(beam).collect()
    }

    /// Gives `mesh` the gains of a file; 1 for frames that it does not name.
    pub fn restore(gains: &[Self], mesh: &mut MeshCapture) {
        let channels = mesh.capture.rig.channels.len();
        let found: std::collections::HashMap<[usize; 2], &Self> = gains.iter().map(|g| (g.frame, g)).collect();
        let power = |view: usize, position: usize| {
            found.get(&[view, position]).map_or_else(|| vec![1.0; channels], |g| g.power.clone())
        };
        if !gains.is_empty() {
            let of = |i: usize| mesh.views(i).iter().map(|&v| power(v, mesh.beams[i].position)).collect();
            mesh.gains = (0..mesh.beams.len()).map(of).collect();
        }
    }
}

fn eta_before() -> f64 {
    1.3
}

#[derive(Serialize, Deserialize)]
struct Whole {
    format: String,
    version: String,
    #[serde(flatten)]
    head: VertexHead,
    #[serde(flatten)]
    model: VertexModel,
}

/// What `model.json` of a [`UniformModel`] calls it.
pub const UNIFORM_FORMAT: &str = "translume uniform model";

#[derive(Serialize, Deserialize)]
struct WholeUniform {
    format: String,
    version: String,
    #[serde(flatten)]
    head: VertexHead,
    #[serde(flatten)]
    model: UniformModel,
}

/// Writes the model into the folder `path`, whole or not at all; see [`crate::check_model_folder`].
///
/// # Errors
/// [`Error::Io`], also where `path` exists and is no model.
pub fn save_vertex_model(path: &Path, head: &VertexHead, model: &VertexModel, mesh: &MeshCapture) -> Result<()> {
    let whole =
        Whole { format: FORMAT.into(), version: VERTEX_MODEL_VERSION.into(), head: head.clone(), model: model.clone() };
    let text = serde_json::to_string(&whole).expect("plain data");
    write_model(path, |new| {
        write_texture(new, head, mesh, model.texels_per_edge, (&model.texture, &model.texture_samples))?;
        atomic::write_bytes(&new.join("model.json"), text.as_bytes())
    })
}

/// Writes a model with one fall-off.
///
/// # Errors
/// [`Error::Io`].
pub fn save_uniform_model(path: &Path, head: &VertexHead, model: &UniformModel, mesh: &MeshCapture) -> Result<()> {
    let (format, version) = (UNIFORM_FORMAT.into(), VERTEX_MODEL_VERSION.into());
    let whole = WholeUniform { format, version, head: head.clone(), model: model.clone() };
    let text = serde_json::to_string_pretty(&whole).expect("plain data");
    write_model(path, |new| {
        write_texture(new, head, mesh, model.texels_per_edge, (&model.texture, &model.texture_samples))?;
        atomic::write_bytes(&new.join("model.json"), text.as_bytes())
    })
}

/// The mesh, and the texture with the numbers of its samples.
fn write_texture(
    path: &Path,
    head: &VertexHead,
    mesh: &MeshCapture,
    per_edge: usize,
    (texture, samples): (&[Vec<f32>], &[Vec<f32>]),
) -> Result<()> {
    let options = ExrOptions { precision: Precision::Float, ..ExrOptions::default() };
    let names: Vec<[String; 2]> =
        head.channels.iter().map(|n| [format!("alpha.{n}"), format!("samples.{n}")]).collect();
    let planes = names.iter().zip(texture.iter().zip(samples));
    let channels: Vec<(&str, &[f32])> =
        planes.flat_map(|([a, s], (alpha, samples))| [(a.as_str(), &alpha[..]), (s.as_str(), &samples[..])]).collect();
    let size = (Texels { per_edge }.per_face(), mesh.surface.mesh.indices.len());
    write_exr_channels(&path.join("texture.exr"), size, &channels, &options)?;
    let mesh_file = path.join("mesh.ply");
    atomic::write(&mesh_file, |out| ply::write(&mesh.surface.mesh, out).map_err(|e| Error::io(&mesh_file, e)))
}

/// Reads a model that was fitted to `mesh`.
///
/// # Errors
/// As [`read_vertex_model`], and [`Error::Invalid`] for a model of another capture.
pub fn load_vertex_model(path: &Path, mesh: &MeshCapture) -> Result<(VertexHead, VertexModel)> {
    let (head, model, _) = read_vertex_model(path)?;
    let channels = mesh.capture.rig.channels.iter().map(|c| &c.name);
    let vertices = mesh.surface.mesh.positions.len();
    if !head.channels.iter().eq(channels) || model.vertices.len() != vertices {
        let file = path.join("model.json");
        return Err(Error::invalid(&file, "it was not fitted to this capture: channels or vertices differ"));
    }
    Ok((head, model))
}

/// Reads a model and its mesh.
///
/// # Errors
/// [`Error::Io`]; [`Error::Invalid`] for damaged files; [`Error::Unsupported`] for another version.
pub fn read_vertex_model(path: &Path) -> Result<(VertexHead, VertexModel, TriMesh)> {
    let file = path.join("model.json");
    let value = read_json(&file, FORMAT)?;
    let Whole { mut head, mut model, .. }: Whole =
        serde_json::from_value(value).map_err(|e| Error::invalid(&file, e.to_string()))?;
    let mesh = read_mesh(path)?;
    let sound = |v: &super::Vertex| v.scale.len() == head.channels.len() && v.fall_off.segments.len() <= 1;
    let counts = model.vertices.len() == mesh.positions.len() && (1..=32).contains(&model.texels_per_edge);
    let gain =
        |g: &FrameGain| g.power.len() == head.channels.len() && g.power.iter().all(|p| *p > 0.0 && p.is_finite());
    if !head.gains.iter().all(gain) {
        return Err(Error::invalid(&file, "its gains do not go with its channels"));
    }
    if !counts || head.channels.is_empty() || !model.vertices.iter().all(sound) {
        return Err(Error::invalid(&file, "its vertices do not go with its mesh and channels"));
    }
    (model.texture, model.texture_samples) = read_texture(path, &head, &mesh, model.texels_per_edge)?;
    if let Some(order) = reorder(&mut head) {
        model.vertices.iter_mut().for_each(|v| v.scale = order.map(|c| v.scale[c]).to_vec());
        in_order(&mut model.texture, order);
        in_order(&mut model.texture_samples, order);
    }
    Ok((head, model, mesh))
}

/// Brings the channels of a model into the order red, green, blue, if it has these in another one; says what came from where.
fn reorder(head: &mut VertexHead) -> Option<[usize; 3]> {
    let three = head.channels.len() == 3;
    let order = rgb_of(head.channels.iter().map(String::as_str)).filter(|o| three && *o != [0, 1, 2])?;
    head.channels = order.map(|c| head.channels[c].clone()).to_vec();
    head.gains.iter_mut().for_each(|g| g.power = order.map(|c| g.power[c]).to_vec());
    Some(order)
}

fn in_order<T: Clone>(channels: &mut Vec<T>, order: [usize; 3]) {
    *channels = order.map(|c| channels[c].clone()).to_vec();
}

/// Reads a model with one fall-off and its mesh.
///
/// # Errors
/// [`Error::Io`]; [`Error::Invalid`] for damaged files; [`Error::Unsupported`] for another version.
pub fn read_uniform_model(path: &Path) -> Result<(VertexHead, UniformModel, TriMesh)> {
    let file = path.join("model.json");
    let value = read_json(&file, UNIFORM_FORMAT)?;
    let WholeUniform { mut head, mut model, .. }: WholeUniform =
        serde_json::from_value(value).map_err(|e| Error::invalid(&file, e.to_string()))?;
    let mesh = read_mesh(path)?;
    if head.channels.is_empty()
        || model.curves.len() != head.channels.len()
        || !(1..=32).contains(&model.texels_per_edge)
    {
        return Err(Error::invalid(&file, "its fall-offs do not go with its channels"));
    }
    (model.texture, model.texture_samples) = read_texture(path, &head, &mesh, model.texels_per_edge)?;
    if let Some(order) = reorder(&mut head) {
        in_order(&mut model.curves, order);
        in_order(&mut model.texture, order);
        in_order(&mut model.texture_samples, order);
    }
    Ok((head, model, mesh))
}

/// `model.json` of a format and version that is read.
fn read_json(file: &Path, format: &str) -> Result<serde_json::Value> {
    let text = std::fs::read(file).map_err(|e| Error::io(file, e))?;
    let value: serde_json::Value = serde_json::from_slice(&text).map_err(|e| Error::invalid(file, e.to_string()))?;
    if value["format"] != format {
        return Err(Error::invalid(file, format!("not a {format}")));
    }
    let version = value["version"].as_str().unwrap_or_default();
    if version.split('.').next() != VERTEX_MODEL_VERSION.split('.').next() {
        let what = format!("version {version}; this program reads {VERTEX_MODEL_VERSION}");
        return Err(Error::unsupported(file, what));
    }
    Ok(value)
}

fn read_mesh(path: &Path) -> Result<TriMesh> {
    let file = path.join("mesh.ply");
    let mesh = translume_mesh::read(&file, &ReadOptions::default())
        .map_err(|e| Error::invalid(&file, e.to_string()))?
        .merged()
        .filter(|m| !m.indices.is_empty() && m.fault().is_none());
    mesh.ok_or_else(|| Error::invalid(&file, "no sound triangles"))
}

/// A texture and the numbers of its samples, a list for each channel.
type Texture = (Vec<Vec<f32>>, Vec<Vec<f32>>);

fn read_texture(path: &Path, head: &VertexHead, mesh: &TriMesh, per_edge: usize) -> Result<Texture> {
    let expected = Texels { per_edge }.per_face() * mesh.indices.len();
    let file = path.join("texture.exr");
    let mut texture = read_exr_channels(&file, 0)?;
    let mut take = |name: String| {
        let plane = texture.planes.iter_mut().find(|p| p.0 == name).map(|p| std::mem::take(&mut p.1));
        let fits = plane.filter(|p| p.len() == expected);
        fits.ok_or_else(|| Error::invalid(&file, format!("no channel {name} of the mesh's size")))
    };
    let mut out = Texture::default();
    for name in &head.channels {
        out.0.push(take(format!("alpha.{name}"))?);
        out.1.push(take(format!("samples.{name}"))?);
    }
    Ok(out)
}
