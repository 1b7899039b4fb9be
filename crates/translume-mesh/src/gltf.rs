//! glTF 2.0 and GLB (Khronos specification 2.0): buffers, accessors, primitives, the node tree.
//!
//! [`Asset`] keeps the typed part of the document that geometry needs ([`document`]) beside the whole as JSON, so that a
//! scene front end can read materials, lights and cameras from the same parse, and the buffers' bytes. Nothing is
//! checked before it is used: a file whose animations are damaged still gives its meshes. Draco and meshopt compression
//! are refused; images are not decoded; nothing is animated: skins and morph targets are as the nodes have them.

mod accessor;
pub mod document;
mod primitive;
mod uri;

use crate::error::{Error, Fault, Result, invalid};
use crate::loaded::{Loaded, Part};
use accessor::little_endian;
use document::{Document, Node};
use glam::{DAffine3, DMat4, DQuat, DVec3};
pub use primitive::{Pose, Posed};
use serde_json::Value;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
pub use uri::is_data;

type Parsed<T> = std::result::Result<T, Fault>;

/// A parsed file with its buffers.
pub struct Asset {
    /// Where it came from.
    pub path: PathBuf,
    /// Scenes, nodes, meshes, accessors and buffers. Indices in it are not checked.
    pub document: Document,
    /// The whole document.
    pub json: serde_json::Value,
    /// Bytes of each buffer, at least as many as the document says, or why they are not there.
    buffers: Vec<std::result::Result<Vec<u8>, String>>,
    /// Folders, beside that of the file, where its files may be.
    roots: Vec<PathBuf>,
    /// Transforms of the nodes to the world, once they are asked for.
    worlds: OnceLock<Vec<DAffine3>>,
}

/// A node that carries a mesh.
#[derive(Clone, Debug)]
pub struct Placed {
    /// Number of the node.
    pub node: usize,
    /// Number of its mesh.
    pub mesh: usize,
    /// The node's transform, those of its parents applied.
    pub world_from_node: DAffine3,
}

/// A small file can place a mesh many times over. Flattening stops at this many vertices and triangles, and eight more for
/// each byte of the buffers.
const LARGEST_FLATTENED: usize = 1 << 25;

/// Buffers without data up to this many bytes are read as zeros.
const LARGEST_PLACEHOLDER: u64 = 1 << 24;

/// Required extensions that do not change the geometry, or that are dealt with here.
const KNOWN_EXTENSIONS: [&str; 23] = [
    "EXT_mesh_gpu_instancing",
    "KHR_lights_punctual",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_dispersion",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_materials_volume_scatter",
    "KHR_mesh_quantization",
    "KHR_texture_basisu",
    "KHR_texture_transform",
    "EXT_texture_webp",
    "KHR_xmp_json_ld",
    "KHR_node_visibility",
];

/// The first number that no 32-bit float can be, with where it is. Applications may keep what they like in `extras`.
fn too_large(value: &serde_json::Value) -> Option<(String, f64)> {
    use serde_json::Value;
    let within = |key: &str, value: &Value| {
        let (place, number) = too_large(value)?;
        let slash = if place.is_empty() { "" } else { "/" };
        Some((format!("{key}{slash}{place}"), number))
    };
    match value {
        Value::Number(n) => n.as_f64().filter(|v| v.abs() > f64::from(f32::MAX)).map(|v| (String::new(), v)),
        Value::Array(items) => items.iter().enumerate().find_map(|(i, v)| within(&i.to_string(), v)),
        Value::Object(fields) => fields.iter().filter(|(k, _)| *k != "extras").find_map(|(k, v)| within(k, v)),
        _ => None,
    }
}

impl Asset {
    /// Opens a `.gltf` or `.glb` file and the buffers it names, which are in its folder or in one of `roots`.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Invalid`], [`Error::Unsupported`] for other versions, [`Error::Outside`].
    pub fn open(path: &Path, roots: &[PathBuf]) -> Result<Self> {
        let bytes = crate::loaded::bytes_of(path)?;
        Self::from_bytes_within(path, bytes, roots)
    }

    /// [`Asset::open`] on the file's bytes without further roots; `path` is for messages and to resolve buffer files.
    ///
    /// # Errors
    /// As [`Asset::open`].
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self> {
        Self::from_bytes_within(path, bytes, &[])
    }

    /// [`Asset::from_bytes`] with `roots`.
    ///
    /// # Errors
    /// As [`Asset::open`].
    pub fn from_bytes_within(path: &Path, bytes: Vec<u8>, roots: &[PathBuf]) -> Result<Self> {
        let is_glb = bytes.starts_with(b"glTF");
        let (json, mut binary) = split(bytes).map_err(|fault| fault.at(path))?;
        let text = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&json);
        let parsed = |e: serde_json::Error| Error::invalid(path, format!("JSON: {e}"));
        let document: Document = serde_json::from_slice(text).map_err(parsed)?;
        let json = serde_json::from_slice(text).map_err(parsed)?;
        if let Some((place, number)) = too_large(&json) {
            return Err(Error::invalid(path, format!("{place}: {number:e} is too large")));
        }
        check(&document).map_err(|fault| fault.at(path))?;
        let (roots, worlds) = (roots.to_vec(), OnceLock::new());
        let mut asset = Self { path: path.to_owned(), document, json, buffers: Vec::new(), roots, worlds };
        for index in 0..asset.document.buffers.len() {
            let buffer = asset.load_buffer(index, is_glb, &mut binary)?;
            asset.buffers.push(buffer);
        }
        Ok(asset)
    }

    /// A buffer, or why it is not there. A file that must not be read is an error at once.
    fn load_buffer(
        &self,
        index: usize,
        is_glb: bool,
        binary: &mut Option<Vec<u8>>,
    ) -> Result<std::result::Result<Vec<u8>, String>> {
        let buffer = &self.document.buffers[index];
        let read = match buffer.uri.as_deref().map(|uri| self.resolve(uri)) {
            Some(Err(e @ Error::Outside { .. })) => return Err(e),
            Some(read) => Some(read.map_err(|e| e.to_string())),
            None => None,
        };
        Ok(self.whole_buffer(buffer, read, (is_glb && index == 0).then_some(binary)))
    }

    /// Bytes of all buffers.
    pub fn size(&self) -> usize {
        self.buffers.iter().flatten().map(Vec::len).fold(0, usize::saturating_add)
    }

    fn whole_buffer(
        &self,
        buffer: &document::Buffer,
        read: Option<std::result::Result<Vec<u8>, String>>,
        binary: Option<&mut Option<Vec<u8>>>,
    ) -> std::result::Result<Vec<u8>, String> {
        let bytes = match (read, binary) {
            (Some(read), _) => read?,
            (None, Some(binary)) => binary.take().ok_or("there is no BIN chunk")?,
            // The format allows a placeholder, whose content is left to the application.
            _ if buffer.byte_length.0 <= LARGEST_PLACEHOLDER => vec![0; buffer.byte_length.get()],
            _ => return Err("it has neither a URI nor a BIN chunk".into()),
        };
        match bytes.len() as u64 {
            n if n < buffer.byte_length.0 => Err(format!("it should hold {} bytes, has {n}", buffer.byte_length.0)),
            _ => Ok(bytes),
        }
    }

    /// The visible nodes with meshes, of [`Asset::nodes`].
    ///
    /// # Errors
    /// As [`Asset::nodes`].
    pub fn placed(&self) -> Result<Vec<Placed>> {
        let with_mesh = |(node, world_from_node): (usize, DAffine3)| {
            let mesh = self.document.nodes[node].mesh?.get();
            Some(Placed { node, mesh, world_from_node })
        };
        Ok(self.nodes()?.into_iter().filter_map(with_mesh).collect())
    }

    /// The visible nodes of the default scene (of all roots when the file has no scene) with their transforms to the world, in
    /// depth-first order, parents first.
    ///
    /// # Errors
    /// [`Error::Invalid`] when a node is its own ancestor or has two parents.
    pub fn nodes(&self) -> Result<Vec<(usize, DAffine3)>> {
        let nodes = &self.document.nodes;
        let roots: Vec<usize> = match self.document.scenes.get(self.document.scene.map_or(0, |s| s.get())) {
            Some(scene) => scene.nodes.iter().map(|n| n.get()).collect(),
            None if self.document.scene.is_some() => {
                return Err(Error::invalid(&self.path, "the default scene is missing"));
            }
            None => {
                let children: std::collections::HashSet<usize> =
                    nodes.iter().flat_map(|n| &n.children).map(|c| c.get()).collect();
                (0..nodes.len()).filter(|i| !children.contains(i)).collect()
            }
        };
        let mut stack: Vec<(usize, DAffine3)> = roots.iter().rev().map(|&n| (n, DAffine3::IDENTITY)).collect();
        let mut seen = vec![false; nodes.len()];
        let mut found = Vec::new();
        while let Some((index, world_from_parent)) = stack.pop() {
            let Some(node) = nodes.get(index) else {
                return Err(Error::invalid(&self.path, format!("there is no node {index}")));
            };
            if std::mem::replace(&mut seen[index], true) {
                return Err(Error::invalid(
                    &self.path,
                    format!("node {index} is reached twice: the nodes are no tree"),
                ));
            }
            if !node.is_visible() {
                continue;
            }
            let world_from_node = world_from_parent * node.local_transform();
            found.push((index, world_from_node));
            stack.extend(node.children.iter().rev().map(|c| (c.get(), world_from_node)));
        }
        Ok(found)
    }

    /// Where a node draws its mesh, in its own space: many times by `EXT_mesh_gpu_instancing`, else once.
    ///
    /// # Errors
    /// [`Error::Invalid`] for damaged accessors.
    pub fn instances(&self, node: usize) -> Result<Vec<DAffine3>> {
        let Some(instancing) = self.document.nodes[node].extensions.get("EXT_mesh_gpu_instancing") else {
            return Ok(vec![DAffine3::IDENTITY]);
        };
        fn rows<const N: usize>(asset: &Asset, accessor: &Value) -> Result<Vec<[f32; N]>> {
            let index = accessor.as_f64().filter(|v| v.fract() == 0.0 && (0.0..9e15).contains(v));
            index.map_or(Ok(Vec::new()), |i| asset.accessor(i as usize))
        }
        let attributes = &instancing["attributes"];
        let translations = rows::<3>(self, &attributes["TRANSLATION"])?;
        let rotations = rows::<4>(self, &attributes["ROTATION"])?;
        let scales = rows::<3>(self, &attributes["SCALE"])?;
        let count = translations.len().max(rotations.len()).max(scales.len());
        let vector =
            |rows: &[[f32; 3]], i: usize, missing| rows.get(i).map_or(missing, |v| DVec3::from(v.map(f64::from)));
        let place = |i| {
            let rotation = rotations.get(i).map(|r: &[f32; 4]| DQuat::from_array(r.map(f64::from)));
            let rotation = rotation.filter(|q| q.length_squared() > 1e-12).map_or(DQuat::IDENTITY, DQuat::normalize);
            let (scale, t) = (vector(&scales, i, DVec3::ONE), vector(&translations, i, DVec3::ZERO));
            DAffine3::from_scale_rotation_translation(scale, rotation, t)
        };
        Ok((0..count).map(place).collect())
    }

    /// Every primitive of every placed node as a part in world space.
    ///
    /// # Errors
    /// Those of [`Asset::placed`] and [`Asset::posed`], and [`Error::Unsupported`] for required extensions that are not known
    /// here or when instances would multiply far beyond the size of the file.
    pub fn flatten(&self) -> Result<Loaded> {
        let required = &self.document.extensions_required;
        if let Some(unknown) = required.iter().find(|e| !KNOWN_EXTENSIONS.contains(&e.as_str())) {
            let what = format!("it requires the extension {unknown}, which is not supported");
            return Err(Error::unsupported(&self.path, what));
        }
        let (mut loaded, mut worlds) = (Loaded::default(), Vec::new());
        let limit = LARGEST_FLATTENED.saturating_add(self.size().saturating_mul(8));
        let (mut elements, mut left_out) = (0_usize, 0);
        let mut poses = HashMap::new();
        for Placed { node, mesh, world_from_node } in self.placed()? {
            let Some(source) = self.document.meshes.get(mesh) else {
                return Err(Error::invalid(
                    &self.path,
                    format!("node {node} asks for mesh {mesh}, which is not there"),
                ));
            };
            let name = self.document.nodes[node].name.as_ref().or(source.name.as_ref());
            let (pose, places) = (self.pose(node), self.instances(node)?);
            for (i, primitive) in source.primitives.iter().enumerate() {
                let key = (self.recipe(mesh, i), pose.key());
                if !poses.contains_key(&key) {
                    poses.insert(key.clone(), self.posed(mesh, i, &pose)?);
                }
                let Some(Posed { mesh: part, in_world }) = &poses[&key] else {
                    left_out += 1;
                    continue;
                };
                let material = primitive.material.and_then(|m| self.json["materials"][m.get()]["name"].as_str());
                for place in places.iter().take(if *in_world { 1 } else { usize::MAX }) {
                    elements += part.positions.len() + part.indices.len();
                    if elements > limit {
                        let what = format!("more than {limit} vertices and triangles once instances are flattened");
                        return Err(Error::unsupported(&self.path, what + "; load it as a scene"));
                    }
                    let part = part.clone();
                    worlds.push(if *in_world { DAffine3::IDENTITY } else { world_from_node * *place });
                    loaded.parts.push(Part {
                        name: name.cloned().unwrap_or_else(|| format!("mesh {mesh}")),
                        material: material.map(str::to_owned),
                        flat: false,
                        mesh: part,
                    });
                }
            }
        }
        let wide = loaded.parts.iter().zip(&worlds).flat_map(|(p, world)| {
            p.mesh.positions.iter().map(|p| world.transform_point3(glam::DVec3::from(p.map(f64::from))))
        });
        let origin = crate::origin::of(wide).unwrap_or_default();
        loaded.origin = origin;
        for (part, world) in loaded.parts.iter_mut().zip(&worlds) {
            // What is where it belongs keeps its normals to the bit.
            if *world != DAffine3::IDENTITY || origin != glam::DVec3::ZERO {
                part.mesh.transform(&(DAffine3::from_translation(-origin) * *world));
            }
        }
        if left_out > 0 {
            loaded.warnings.push(format!("{left_out} primitives of points, lines or no positions were left out"));
        }
        Ok(loaded)
    }
}

impl Node {
    /// The node's own transform.
    pub fn local_transform(&self) -> DAffine3 {
        if let Some(m) = &self.matrix {
            return DAffine3::from_mat4(DMat4::from_cols_array(m));
        }
        let rotation = DQuat::from_array(self.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]));
        let rotation = if rotation.length_squared() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY };
        let scale = DVec3::from(self.scale.unwrap_or([1.0; 3]));
        let translation = DVec3::from(self.translation.unwrap_or([0.0; 3]));
        DAffine3::from_scale_rotation_translation(scale, rotation, translation)
    }

    /// Not made invisible, with all below it (`KHR_node_visibility`).
    pub fn is_visible(&self) -> bool {
        self.extensions.get("KHR_node_visibility").is_none_or(|v| v["visible"] != Value::Bool(false))
    }
}

/// The JSON text and the BIN chunk of a GLB file; a `.gltf` file as it is.
fn split(bytes: Vec<u8>) -> Parsed<(Vec<u8>, Option<Vec<u8>>)> {
    if !bytes.starts_with(b"glTF") {
        return Ok((bytes, None));
    }
    let word = |at: usize| bytes.get(at..at + 4).map(little_endian);
    let (Some(version), Some(length)) = (word(4), word(8)) else { return invalid("GLB: the header is truncated") };
    if version != 2 {
        return Err(Fault::Unsupported(format!("GLB version {version}; version 2 is read")));
    }
    if length as usize > bytes.len() {
        return invalid(format!("GLB: truncated, {} of {length} bytes are there", bytes.len()));
    }
    let (mut at, mut json, mut binary) = (12, None, None);
    while let (Some(size), Some(kind)) = (word(at), word(at + 4)) {
        let end = (at + 8).saturating_add(size as usize);
        let Some(chunk) = bytes.get(at + 8..end).filter(|_| end <= length as usize) else {
            return invalid("GLB: a chunk reaches beyond the end of the file");
        };
        match kind {
            0x4e4f_534a if json.is_none() && binary.is_none() => json = Some(chunk.to_vec()),
            0x004e_4942 if binary.is_none() => binary = Some(chunk.to_vec()),
            _ => {}
        }
        at = end;
        if at == length as usize {
            break;
        }
    }
    match json {
        Some(json) => Ok((json, binary)),
        None => invalid("GLB: no JSON chunk"),
    }
}

fn check(document: &Document) -> Parsed<()> {
    let version = document.asset.min_version.as_ref().unwrap_or(&document.asset.version);
    match version.starts_with("2.") {
        true => Ok(()),
        false => Err(Fault::Unsupported(format!("glTF version {version:?}; version 2 is read"))),
    }
}
