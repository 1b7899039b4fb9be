//! glTF 2.0 and GLB (Khronos specification 2.0): buffers, accessors, primitives, the node tree.
//!
//! [`Asset`] keeps the typed part of the document that geometry needs ([`document`]) beside the whole as JSON, so that a
//! scene front end can read materials, lights and cameras from the same parse, and the buffers' bytes. Nothing is
//! checked before it is used: a file whose animations are damaged still gives its meshes. Draco and meshopt compression
//! are refused; images are not decoded; skins are left in their bind pose and morph targets at rest.

pub mod document;

use crate::error::{Error, Fault, Result, invalid};
use crate::files::{Loaded, Part};
use crate::mesh::TriMesh;
use base64::Engine;
use document::{Document, Node, Primitive, Sparse};
use glam::{DAffine3, DMat4, DQuat, DVec3};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

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

/// A small file can place a mesh many times over; flattening stops there.
const LARGEST_FLATTENED: u64 = 1 << 27;

/// Buffers without data up to this many bytes are read as zeros.
const LARGEST_PLACEHOLDER: u64 = 1 << 24;

/// Required extensions that do not change the geometry, or that are dealt with here.
const KNOWN_EXTENSIONS: [&str; 21] = [
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
    "KHR_mesh_quantization",
    "KHR_texture_basisu",
    "KHR_texture_transform",
    "EXT_texture_webp",
    "KHR_xmp_json_ld",
    "KHR_node_visibility",
];

impl Asset {
    /// Opens a `.gltf` or `.glb` file and the buffers it names.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Invalid`], [`Error::Unsupported`] for required extensions that are not known here.
    pub fn open(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
        Self::from_bytes(path, bytes)
    }

    /// [`Asset::open`] on the file's bytes; `path` is for messages and to resolve buffer files.
    ///
    /// # Errors
    /// As [`Asset::open`].
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self> {
        let is_glb = bytes.starts_with(b"glTF");
        let (json, mut binary) = split(bytes).map_err(|fault| fault.at(path))?;
        let text = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&json);
        let parsed = |e: serde_json::Error| Error::invalid(path, format!("JSON: {e}"));
        let document: Document = serde_json::from_slice(text).map_err(parsed)?;
        let json = serde_json::from_slice(text).map_err(parsed)?;
        check(&document).map_err(|fault| fault.at(path))?;
        let mut asset = Self { path: path.to_owned(), document, json, buffers: Vec::new() };
        asset.buffers = (0..asset.document.buffers.len()).map(|i| asset.load_buffer(i, is_glb, &mut binary)).collect();
        Ok(asset)
    }

    fn load_buffer(
        &self,
        index: usize,
        is_glb: bool,
        binary: &mut Option<Vec<u8>>,
    ) -> std::result::Result<Vec<u8>, String> {
        let buffer = &self.document.buffers[index];
        let bytes = match buffer.uri.as_deref() {
            Some(uri) => self.resolve(uri).map_err(|e| e.to_string())?,
            None if is_glb && index == 0 => binary.take().ok_or("there is no BIN chunk")?,
            // The format allows a placeholder, whose content is left to the application.
            None if buffer.byte_length.0 <= LARGEST_PLACEHOLDER => vec![0; buffer.byte_length.get()],
            None => return Err("it has neither a URI nor a BIN chunk".into()),
        };
        match bytes.len() as u64 {
            n if n < buffer.byte_length.0 => Err(format!("it should hold {} bytes, has {n}", buffer.byte_length.0)),
            _ => Ok(bytes),
        }
    }

    /// The bytes behind a URI: data, or a file beside this one.
    ///
    /// # Errors
    /// [`Error::Invalid`] for damaged base64, [`Error::Unsupported`] for network addresses, [`Error::Io`].
    pub fn resolve(&self, uri: &str) -> Result<Vec<u8>> {
        if let Some(data) = uri.strip_prefix("data:") {
            let Some((kind, data)) = data.split_once(',') else {
                return Err(Error::invalid(&self.path, "a data URI without data"));
            };
            if !kind.ends_with(";base64") {
                return Ok(percent_decoded(data));
            }
            let engine = base64::engine::GeneralPurpose::new(
                &base64::alphabet::STANDARD,
                base64::engine::GeneralPurposeConfig::new()
                    .with_decode_padding_mode(base64::engine::DecodePaddingMode::Indifferent),
            );
            return engine.decode(data).map_err(|e| Error::invalid(&self.path, format!("data URI: {e}")));
        }
        let file = self.file(uri)?;
        std::fs::read(&file).map_err(|e| Error::io(&file, e))
    }

    /// The file a relative URI names.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for other schemes and absolute paths.
    pub fn file(&self, uri: &str) -> Result<PathBuf> {
        let name = String::from_utf8_lossy(&percent_decoded(uri)).into_owned();
        if uri.contains("://") || Path::new(&name).is_absolute() {
            return Err(Error::unsupported(&self.path, format!("URI {uri:?}: only files beside this one are read")));
        }
        Ok(self.path.parent().unwrap_or(Path::new("")).join(name))
    }

    /// Triangles of primitive `primitive` of mesh `mesh`, in the mesh's own space; `None` for points and lines.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming mesh, primitive and attribute.
    pub fn primitive(&self, mesh: usize, primitive: usize) -> Result<Option<TriMesh>> {
        let read = || match self.document.meshes.get(mesh).and_then(|m| m.primitives.get(primitive)) {
            Some(p) => self.triangles(p),
            None => invalid("there is no such primitive"),
        };
        read().map_err(|fault| {
            let place = |what| format!("mesh {mesh}, primitive {primitive}: {what}");
            match fault {
                Fault::Invalid(what) => Error::invalid(&self.path, place(what)),
                Fault::Unsupported(what) => Error::unsupported(&self.path, place(what)),
            }
        })
    }

    fn triangles(&self, p: &Primitive) -> Parsed<Option<TriMesh>> {
        let mode = p.mode.map_or(4, |m| m.0);
        if mode > 6 {
            return invalid(format!("unknown mode {mode}"));
        }
        let Some(positions) = p.attributes.get("POSITION").filter(|_| mode >= 4) else { return Ok(None) };
        if p.extensions.contains_key("KHR_draco_mesh_compression") {
            return Err(Fault::Unsupported("Draco compression; decompress the file first".into()));
        }
        let positions: Vec<[f32; 3]> = self.floats(positions.get())?;
        let normals = p.attributes.get("NORMAL").map(|a| self.floats(a.get())).transpose()?;
        let mut uvs: Option<Vec<[f32; 2]>> =
            p.attributes.get("TEXCOORD_0").map(|a| self.floats(a.get())).transpose()?;
        uvs.iter_mut().flatten().for_each(|uv| uv[1] = 1.0 - uv[1]);
        let colors = p.attributes.get("COLOR_0").map(|a| self.floats(a.get())).transpose()?;
        let order = match p.indices {
            Some(accessor) => self.indices(accessor.get())?,
            None => (0..u32::try_from(positions.len()).unwrap_or(u32::MAX)).collect(),
        };
        let mesh = TriMesh { positions, normals, uvs, colors, indices: triangles(mode, &order) };
        match mesh.fault() {
            Some(fault) => invalid(fault),
            None => Ok(Some(mesh)),
        }
    }

    /// The nodes with meshes of the default scene (all root nodes when the file has no scene), in depth-first order.
    ///
    /// # Errors
    /// [`Error::Invalid`] when a node is its own ancestor or has two parents.
    pub fn placed(&self) -> Result<Vec<Placed>> {
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
        let mut placed = Vec::new();
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
            let world_from_node = world_from_parent * node.local_transform();
            if let Some(mesh) = node.mesh {
                placed.push(Placed { node: index, mesh: mesh.get(), world_from_node });
            }
            stack.extend(node.children.iter().rev().map(|c| (c.get(), world_from_node)));
        }
        Ok(placed)
    }

    /// Every primitive of every placed node as a part in world space.
    ///
    /// # Errors
    /// Those of [`Asset::placed`] and [`Asset::primitive`], and [`Error::Unsupported`] when instances would multiply
    /// into more than 2^27 vertices.
    pub fn flatten(&self) -> Result<Loaded> {
        let mut loaded = Loaded::default();
        let (mut vertices, mut left_out, mut skinned) = (0_u64, 0, 0);
        for Placed { node, mesh, world_from_node } in self.placed()? {
            let Some(source) = self.document.meshes.get(mesh) else {
                return Err(Error::invalid(
                    &self.path,
                    format!("node {node} asks for mesh {mesh}, which is not there"),
                ));
            };
            let name = self.document.nodes[node].name.as_ref().or(source.name.as_ref());
            skinned += usize::from(self.document.nodes[node].skin.is_some());
            for (i, primitive) in source.primitives.iter().enumerate() {
                let Some(mut part) = self.primitive(mesh, i)? else {
                    left_out += 1;
                    continue;
                };
                vertices += part.positions.len() as u64;
                if vertices > LARGEST_FLATTENED {
                    let what = "more than 2^27 vertices once instances are flattened; load it as a scene";
                    return Err(Error::unsupported(&self.path, what));
                }
                part.transform(&world_from_node);
                let material = primitive.material.and_then(|m| self.json["materials"][m.get()]["name"].as_str());
                loaded.parts.push(Part {
                    name: name.cloned().unwrap_or_else(|| format!("mesh {mesh}")),
                    material: material.map(str::to_owned),
                    flat: false,
                    mesh: part,
                });
            }
        }
        if left_out > 0 {
            loaded.warnings.push(format!("{left_out} primitives of points, lines or no positions were left out"));
        }
        if skinned > 0 {
            loaded.warnings.push(format!("{skinned} skinned meshes are left in their bind pose"));
        }
        Ok(loaded)
    }

    /// An accessor as rows of `N` floats. Integers are scaled when the accessor is normalised; a fourth component
    /// (alpha, or the sign of a tangent) is dropped for `N = 3`.
    ///
    /// # Errors
    /// A fault that names the accessor, as [`Error`] with this file's path.
    pub fn accessor<const N: usize>(&self, index: usize) -> Result<Vec<[f32; N]>> {
        self.floats(index).map_err(|fault| fault.at(&self.path))
    }

    /// The bytes of a buffer view, as images use them.
    ///
    /// # Errors
    /// [`Error::Invalid`] when there is no such view or its buffer is shorter.
    pub fn bytes(&self, view: usize) -> Result<&[u8]> {
        let read = || -> Parsed<&[u8]> {
            let Some(v) = self.document.buffer_views.get(view) else {
                return invalid(format!("no buffer view {view}"));
            };
            let Some(buffer) = self.buffers.get(v.buffer.get()) else {
                return invalid(format!("buffer view {view} uses a buffer that is not there"));
            };
            let buffer = buffer.as_ref().map_err(|e| Fault::Invalid(format!("buffer {}: {e}", v.buffer.0)))?;
            let end = v.byte_offset.get().saturating_add(v.byte_length.get());
            match buffer.get(v.byte_offset.get()..end) {
                Some(bytes) => Ok(bytes),
                None => invalid(format!("buffer view {view} reaches beyond its buffer")),
            }
        };
        read().map_err(|fault| fault.at(&self.path))
    }

    fn floats<const N: usize>(&self, index: usize) -> Parsed<Vec<[f32; N]>> {
        let rows = self.rows(index)?;
        if rows.components < N {
            return invalid(format!("accessor {index} has {} components instead of {N}", rows.components));
        }
        let normalized = self.document.accessors[index].normalized;
        let size = rows.kind.size();
        Ok((0..rows.count)
            .map(|i| {
                let row = rows.row(i);
                std::array::from_fn(|j| rows.kind.component(normalized, &row[j * size..]))
            })
            .collect())
    }

    fn indices(&self, index: usize) -> Parsed<Vec<u32>> {
        let rows = self.rows(index)?;
        if rows.components != 1 {
            return invalid(format!("accessor {index} holds indices and is not SCALAR"));
        }
        let size = rows.kind.size();
        match rows.kind {
            Kind::U8 | Kind::U16 | Kind::U32 => {}
            _ => return invalid(format!("accessor {index} holds indices that are no unsigned integers")),
        }
        Ok((0..rows.count).map(|i| little_endian(&rows.row(i)[..size])).collect())
    }

    /// Checks an accessor against its buffers and gives its rows, sparse values put in.
    fn rows(&self, index: usize) -> Parsed<Rows<'_>> {
        let Some(accessor) = self.document.accessors.get(index) else { return invalid(format!("no accessor {index}")) };
        let kind = Kind::of(accessor.component_type.0)
            .ok_or_else(|| Fault::Invalid(format!("accessor {index} has an unknown component type")))?;
        let components = match accessor.shape.as_str() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            other => return invalid(format!("accessor {index} is of type {other:?}, not a scalar or vector")),
        };
        let (count, size) = (accessor.count.0, components * kind.size());
        let offset = accessor.byte_offset.0;
        let dense = accessor.buffer_view.map(|v| self.view(v.get(), offset, count, size, index)).transpose()?;
        let sparse = accessor.sparse.as_ref().map(|s| self.sparse_rows(s, count, size, index)).transpose()?;
        // Zeros without bytes behind them: bound what a header can ask for.
        if dense.is_none() && count > 1 << 24 {
            return invalid(format!("accessor {index} asks for {count} rows without data"));
        }
        let count = count as usize;
        Ok(Rows { dense, sparse, count, components, kind, zero: [0; 16], size })
    }

    fn sparse_rows(&self, sparse: &Sparse, count: u64, size: usize, index: usize) -> Parsed<HashMap<u32, &[u8]>> {
        let (at, from) = (&sparse.indices, &sparse.values);
        let width = match at.component_type.map(|t| Kind::of(t.0)) {
            Some(Some(kind @ (Kind::U8 | Kind::U16 | Kind::U32))) => kind.size(),
            _ => return invalid(format!("accessor {index} has sparse indices that are no unsigned integers")),
        };
        let n = sparse.count.0;
        let keys = self.view(at.buffer_view.get(), at.byte_offset.0, n, width, index)?;
        let values = self.view(from.buffer_view.get(), from.byte_offset.0, n, size, index)?;
        let mut rows = HashMap::new();
        for i in 0..n as usize {
            let key = little_endian(&keys.bytes[i * keys.stride..][..width]);
            if u64::from(key) >= count {
                return invalid(format!("accessor {index} has a sparse index {key} beyond its {count} rows"));
            }
            rows.insert(key, &values.bytes[i * values.stride..][..size]);
        }
        Ok(rows)
    }

    /// `count` rows of `size` bytes from `offset` in buffer view `view`, checked.
    fn view(&self, view: usize, offset: u64, count: u64, size: usize, accessor: usize) -> Parsed<View<'_>> {
        let beyond = || Fault::Invalid(format!("accessor {accessor} reaches beyond its buffer view"));
        let v = self.document.buffer_views.get(view).ok_or_else(beyond)?;
        if v.extensions.contains_key("EXT_meshopt_compression") {
            return Err(Fault::Unsupported("meshopt compression; decompress the file first".into()));
        }
        let begin = v.byte_offset.0;
        let end = begin.checked_add(v.byte_length.0).ok_or_else(beyond)?;
        let buffer = match self.buffers.get(v.buffer.get()) {
            Some(Ok(bytes)) => bytes,
            Some(Err(why)) => return invalid(format!("buffer {}: {why}", v.buffer.get())),
            None => {
                return invalid(format!("buffer view {view} asks for buffer {}, which is not there", v.buffer.get()));
            }
        };
        let range = usize::try_from(begin).ok().zip(usize::try_from(end).ok());
        let bytes = range
            .and_then(|(b, e)| buffer.get(b..e))
            .ok_or_else(|| Fault::Invalid(format!("buffer view {view} reaches beyond the end of its buffer")))?;
        let stride = v.byte_stride.map_or(size, |s| s.get());
        if stride < size {
            return invalid(format!("buffer view {view} has stride {stride}, its rows need {size} bytes"));
        }
        let needed = match count {
            0 => Some(0),
            n => (n - 1).checked_mul(stride as u64).and_then(|n| n.checked_add(size as u64)),
        };
        let needed = needed.and_then(|n| n.checked_add(offset)).ok_or_else(beyond)?;
        if needed > bytes.len() as u64 {
            return Err(beyond());
        }
        Ok(View { bytes: &bytes[offset as usize..], stride })
    }
}

struct View<'a> {
    bytes: &'a [u8],
    stride: usize,
}

struct Rows<'a> {
    dense: Option<View<'a>>,
    sparse: Option<HashMap<u32, &'a [u8]>>,
    count: usize,
    components: usize,
    kind: Kind,
    zero: [u8; 16],
    size: usize,
}

impl Rows<'_> {
    fn row(&self, i: usize) -> &[u8] {
        if let Some(row) = self.sparse.as_ref().and_then(|s| s.get(&(i as u32))) {
            return row;
        }
        match &self.dense {
            Some(view) => &view.bytes[i * view.stride..][..self.size],
            None => &self.zero[..self.size],
        }
    }
}

/// Component types, by their numbers in the format.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Kind {
    fn of(number: u64) -> Option<Self> {
        Some(match number {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// One component as a float (specification, "Animations", for the normalised mapping).
    fn component(self, normalized: bool, raw: &[u8]) -> f32 {
        let bits = little_endian(&raw[..self.size()]);
        let (value, scale) = match self {
            Self::F32 => return f32::from_bits(bits),
            Self::U8 => (bits as f32, 255.0),
            Self::U16 => (bits as f32, 65535.0),
            Self::U32 => (bits as f32, u32::MAX as f32),
            Self::I8 => (f32::from(bits as u8 as i8), 127.0),
            Self::I16 => (f32::from(bits as u16 as i16), 32767.0),
        };
        if normalized { (value / scale).max(-1.0) } else { value }
    }
}

fn little_endian(raw: &[u8]) -> u32 {
    raw.iter().rev().fold(0, |n, &b| n << 8 | u32::from(b))
}

/// Corner triples of modes 4 (triangles), 5 (strip) and 6 (fan).
fn triangles(mode: u64, order: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        5 => {
            let turned = |(i, w): (usize, &[u32])| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] };
            order.windows(3).enumerate().map(turned).collect()
        }
        6 => order.windows(2).skip(1).map(|w| [order[0], w[0], w[1]]).collect(),
        _ => order.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
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

/// Version and required extensions.
fn check(document: &Document) -> Parsed<()> {
    let version = document.asset.min_version.as_ref().unwrap_or(&document.asset.version);
    if !version.starts_with("2.") {
        return Err(Fault::Unsupported(format!("glTF version {version:?}; version 2 is read")));
    }
    match document.extensions_required.iter().find(|e| !KNOWN_EXTENSIONS.contains(&e.as_str())) {
        Some(unknown) => {
            Err(Fault::Unsupported(format!("it requires the extension {unknown}, which is not supported")))
        }
        None => Ok(()),
    }
}

fn percent_decoded(uri: &str) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let [first, tail @ ..] = rest {
        let hex = |b: u8| (b as char).to_digit(16);
        match (first, tail) {
            (b'%', [a, b, after @ ..]) if hex(*a).is_some() && hex(*b).is_some() => {
                bytes.push((hex(*a).unwrap_or(0) * 16 + hex(*b).unwrap_or(0)) as u8);
                rest = after;
            }
            _ => {
                bytes.push(*first);
                rest = tail;
            }
        }
    }
    bytes
}
