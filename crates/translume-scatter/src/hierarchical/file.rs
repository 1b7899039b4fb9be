//! A hierarchical model on disk: a folder with `model.json`, `mesh.ply` and Zarr arrays; `docs/formats/hierarchical.md` tells them.

use super::array::{Array, Number};
use super::atlas::{Atlas, RADIUS};
use super::model::{Hierarchical, Told};
use super::pairs::{Throughput, pair, pairs};
use crate::model_folder::write_model;
use half::f16;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::Path;
use translume_image::{Error, Result};
use translume_mesh::{ReadOptions, ply};

/// Version of the format; a reader refuses another major one.
pub const HIERARCHICAL_VERSION: &str = "1.1";
/// What `model.json` calls it.
pub const HIERARCHICAL_FORMAT: &str = "translume hierarchical model";
/// Rows and columns of a block of F.
const BLOCK: usize = 256;
/// Texels of a chunk.
const TEXELS: usize = 4096;
/// Most texels along a side that are read.
const MOST_SIDE: usize = 8192;
const CELLS: usize = ((2 * RADIUS + 1) * (2 * RADIUS + 1)) as usize;

/// What stands in `model.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HierarchicalHead {
    /// [`HIERARCHICAL_FORMAT`].
    pub format: String,
    /// [`HIERARCHICAL_VERSION`].
    pub version: String,
    /// The command line that made it.
    pub command: String,
    /// Multiple of the noise floor above which pixels were samples.
    pub threshold: f64,
    /// Relative index of refraction.
    pub eta: f64,
    /// Texels along a side of the atlas.
    pub side: usize,
    /// Their size in mm.
    pub texel_mm: f32,
    /// Texels of the surface.
    pub texels: usize,
    /// Those with a measured kernel.
    pub measured_kernels: usize,
    /// Relative error (RMS) of the light around spots held out, predicted by the kernels of the others; since 1.1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kernel_error: Option<f64>,
    /// Vertices that no beam hit; what is known of them comes from what they send out under light elsewhere, and from neighbours.
    pub never_lit: usize,
    /// Vertices of which nothing was measured.
    pub never_seen: usize,
    /// Share of F that was measured.
    pub measured: f64,
}

impl HierarchicalHead {
    /// The head of a model that was fitted just now.
    pub fn new(model: &Hierarchical, told: &Told, command: String, threshold: f64) -> Self {
        Self {
            format: HIERARCHICAL_FORMAT.into(),
            version: HIERARCHICAL_VERSION.into(),
            command,
            threshold,
            eta: model.eta,
            side: model.atlas.side,
            texel_mm: model.atlas.texel_mm,
            texels: model.atlas.texels.len(),
            measured_kernels: told.measured_kernels,
            kernel_error: told.kernel_error.is_finite().then_some(told.kernel_error),
            never_lit: told.completion.never_lit,
            never_seen: told.completion.never_seen,
            measured: told.completion.measured,
        }
    }
}

/// Writes the model into the folder `path`, whole or not at all; see [`crate::check_model_folder`].
///
/// # Errors
/// [`Error::Io`], also where `path` exists and is no model.
pub fn save_hierarchical(path: &Path, head: &HierarchicalHead, model: &Hierarchical) -> Result<()> {
    write_model(path, |new| write_parts(new, head, model))
}

fn write_parts(path: &Path, head: &HierarchicalHead, model: &Hierarchical) -> Result<()> {
    let text = serde_json::to_string_pretty(head).expect("plain data");
    std::fs::write(path.join("model.json"), format!("{text}\n")).map_err(|e| Error::io(path, e))?;
    let mut bytes = Vec::new();
    ply::write(&model.mesh, &mut bytes).map_err(|e| Error::io(path, e))?;
    std::fs::write(path.join("mesh.ply"), bytes).map_err(|e| Error::io(path, e))?;
    let arrays = Arrays::new(path, model.mesh.positions.len(), model.mesh.indices.len(), head.texels, Open::Create)?;
    let f = &model.throughput;
    blocks(f.vertices).par_iter().try_for_each(|&[row, column]| {
        arrays.throughput.write(&[0, row, column], |i| f.ln[pair(i[1], i[2])][i[0]])?;
        arrays.confidence.write(&[row, column], |i| f.confidence[pair(i[0], i[1])])
    })?;
    arrays.corners.write_all(|i| model.atlas.corners[i / 6][i / 2 % 3][i % 2])?;
    arrays.kernels.write_all(|i| model.kernels[i / 3][i % 3])?;
    arrays.kernel_confidence.write_all(|i| model.kernel_confidence[i])?;
    arrays.detail.write_all(|i| f16::from_f32(model.detail[i / 3][i % 3]))?;
    arrays.detail_weight.write_all(|i| model.detail_weight[i])
}

/// The blocks of the lower triangle.
fn blocks(vertices: usize) -> Vec<[usize; 2]> {
    let n = vertices.div_ceil(BLOCK);
    (0..n).flat_map(|row| (0..=row).map(move |column| [row, column])).collect()
}

enum Open {
    Create,
    Read,
}

struct Arrays {
    throughput: Array,
    confidence: Array,
    corners: Array,
    kernels: Array,
    kernel_confidence: Array,
    detail: Array,
    detail_weight: Array,
}

impl Arrays {
    fn new(path: &Path, vertices: usize, faces: usize, texels: usize, open: Open) -> Result<Self> {
        fn array<T: Number>(path: &Path, open: &Open, name: &str, sizes: &[(&str, usize, usize)]) -> Result<Array> {
            let shape: Vec<usize> = sizes.iter().map(|s| s.1).collect();
            let chunk: Vec<usize> = sizes.iter().map(|s| s.2).collect();
            let names: Vec<&str> = sizes.iter().map(|s| s.0).collect();
            match open {
                Open::Create => Array::create::<T>(&path.join(name), &shape, &chunk, &names),
                Open::Read => Array::open::<T>(&path.join(name), &shape, &chunk),
            }
        }
        let (o, p) = (&open, path);
        let (a, b) = (("vertex", vertices, BLOCK), ("other_vertex", vertices, BLOCK));
        let (texel, channel) = (("texel", texels, TEXELS), ("channel", 3, 3));
        let side = (2 * RADIUS + 1) as usize;
        Ok(Self {
            throughput: array::<f16>(p, o, "throughput", &[channel, a, b])?,
            confidence: array::<u8>(p, o, "throughput_confidence", &[a, b])?,
            corners: array::<f32>(p, o, "atlas", &[("triangle", faces, TEXELS), ("corner", 3, 3), ("axis", 2, 2)])?,
            kernels: array::<f16>(p, o, "kernels", &[texel, ("row", side, side), ("column", side, side), channel])?,
            kernel_confidence: array::<u8>(p, o, "kernels_confidence", &[texel])?,
            detail: array::<f16>(p, o, "modulation", &[texel, channel])?,
            detail_weight: array::<f32>(p, o, "modulation_weight", &[texel])?,
        })
    }
}

/// Reads `model.json` alone.
///
/// # Errors
/// [`Error::Io`]; [`Error::Invalid`] for something else; [`Error::Unsupported`] for another version.
pub fn read_head(path: &Path) -> Result<HierarchicalHead> {
    let file = path.join("model.json");
    let text = std::fs::read(&file).map_err(|e| Error::io(&file, e))?;
    let value: serde_json::Value = serde_json::from_slice(&text).map_err(|e| Error::invalid(&file, e.to_string()))?;
    if value["format"] != HIERARCHICAL_FORMAT {
        return Err(Error::invalid(&file, "not a hierarchical model"));
    }
    let version = value["version"].as_str().unwrap_or_default();
    if version.split('.').next() != HIERARCHICAL_VERSION.split('.').next() {
        let what = format!("version {version}; this program reads {HIERARCHICAL_VERSION}");
        return Err(Error::unsupported(&file, what));
    }
    let head: HierarchicalHead = serde_json::from_value(value).map_err(|e| Error::invalid(&file, e.to_string()))?;
    if !(1.0..=4.0).contains(&head.eta)
        || !(1..=MOST_SIDE).contains(&head.side)
        || head.texel_mm.is_nan()
        || head.texel_mm <= 0.0
    {
        return Err(Error::invalid(&file, "eta, side or texel_mm cannot be"));
    }
    Ok(head)
}

/// Reads a model.
///
/// # Errors
/// [`Error::Io`]; [`Error::Invalid`] for damaged files and files that do not go together; [`Error::Unsupported`] for another version.
pub fn load_hierarchical(path: &Path) -> Result<(HierarchicalHead, Hierarchical)> {
    let head = read_head(path)?;
    let mesh_file = path.join("mesh.ply");
    let loaded = translume_mesh::read(&mesh_file, &ReadOptions::default())
        .map_err(|e| Error::invalid(&mesh_file, e.to_string()))?;
    let mesh = loaded.merged().filter(|m| !m.indices.is_empty() && m.positions.iter().flatten().all(|x| x.is_finite()));
    let mesh = mesh.ok_or_else(|| Error::invalid(&mesh_file, "no triangles, or a vertex that is not finite"))?;
    let n = mesh.positions.len();
    let arrays = Arrays::new(path, n, mesh.indices.len(), head.texels, Open::Read)?;
    let mut corners = vec![[[0.0f32; 2]; 3]; mesh.indices.len()];
    arrays.corners.read_all(|i, x: f32| corners[i / 6][i / 2 % 3][i % 2] = x)?;
    let limit = head.side as f32;
    if corners.iter().flatten().flatten().any(|x| x.is_infinite() || *x < 0.0 || *x > limit) {
        return Err(Error::invalid(&path.join("atlas"), "a corner lies outside of the atlas"));
    }
    let atlas = Atlas::from_corners(&mesh, head.side, head.texel_mm, corners);
    if atlas.texels.len() != head.texels {
        let what = format!("the atlas covers {} texels, model.json counts {}", atlas.texels.len(), head.texels);
        return Err(Error::invalid(&path.join("model.json"), what));
    }
    let mut kernels = vec![[f16::ZERO; 3]; head.texels * CELLS];
    arrays.kernels.read_all(|i, x: f16| kernels[i / 3][i % 3] = x)?;
    let mut kernel_confidence = vec![0; head.texels];
    arrays.kernel_confidence.read_all(|i, x: u8| kernel_confidence[i] = x)?;
    let (mut detail, mut detail_weight) = (vec![[1.0; 3]; head.texels], vec![0.0; head.texels]);
    arrays.detail.read_all(|i, x: f16| detail[i / 3][i % 3] = x.to_f32())?;
    arrays.detail_weight.read_all(|i, x: f32| detail_weight[i] = x)?;
    let finite = kernels.iter().flatten().all(|x| x.is_finite()) && detail.iter().flatten().all(|x| x.is_finite());
    if !finite {
        return Err(Error::invalid(path, "a kernel or the modulation is not finite; fit the model again"));
    }
    let throughput = read_throughput(&arrays, n)?;
    if throughput.ln.iter().flatten().any(|x| !x.is_finite()) {
        return Err(Error::invalid(&path.join("throughput"), "a value is not finite; fit the model again"));
    }
    let eta = head.eta;
    let model = Hierarchical { mesh, eta, atlas, throughput, kernels, kernel_confidence, detail, detail_weight };
    Ok((head, model))
}

fn read_throughput(arrays: &Arrays, n: usize) -> Result<Throughput> {
    let (mut ln, mut confidence) = (vec![[f16::ZERO; 3]; pairs(n)], vec![0; pairs(n)]);
    for [row, column] in blocks(n) {
        arrays.throughput.read(&[0, row, column], |i, x: f16| {
            if i[1] >= i[2] {
                ln[pair(i[1], i[2])][i[0]] = x;
            }
        })?;
        arrays.confidence.read(&[row, column], |i, x: u8| {
            if i[0] >= i[1] {
                confidence[pair(i[0], i[1])] = x;
            }
        })?;
    }
    Ok(Throughput { vertices: n, ln, confidence })
}
