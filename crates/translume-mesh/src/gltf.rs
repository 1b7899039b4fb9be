//! glTF 2.0 and GLB (Khronos specification 2.0): buffers, accessors, primitives, the node tree.
//!
//! [`Asset`] keeps the JSON document (types of the `gltf-json` crate) beside the buffers' bytes, so that a scene front
//! end can read materials, lights and cameras from the same parse. All accesses are checked against the buffers here.
//! Draco and meshopt compression are refused; images are not decoded.

use crate::error::{Error, Fault, Result, invalid};
use crate::files::{Loaded, Part};
use crate::mesh::TriMesh;
use base64::Engine;
use glam::{DAffine3, DMat4, DQuat, DVec3};
pub use gltf::json;
use json::accessor::{ComponentType, Type};
use json::mesh::Mode;
use json::validation::{Checked, Validate};
use std::path::{Path, PathBuf};

type Parsed<T> = std::result::Result<T, Fault>;

/// A parsed file with its buffers.
pub struct Asset {
    /// Where it came from.
    pub path: PathBuf,
    /// The document; every index in it is in range.
    pub root: json::Root,
    /// Bytes of each buffer, at least as many as the document says.
    pub buffers: Vec<Vec<u8>>,
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
        let (json, binary) = split(bytes).map_err(|fault| fault.at(path))?;
        let text = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&json);
        let root = json::Root::from_slice(text).map_err(|e| Error::invalid(path, format!("JSON: {e}")))?;
        check(&root).map_err(|fault| fault.at(path))?;
        let mut asset = Self { path: path.to_owned(), root, buffers: Vec::new() };
        asset.load_buffers(binary)?;
        Ok(asset)
    }

    fn load_buffers(&mut self, mut binary: Option<Vec<u8>>) -> Result<()> {
        for (i, buffer) in self.root.buffers.iter().enumerate() {
            let bytes = match buffer.uri.as_deref() {
                Some(uri) => self.resolve(uri)?,
                None if i == 0 => {
                    binary.take().ok_or_else(|| Error::invalid(&self.path, "buffer 0 has neither URI nor BIN chunk"))?
                }
                None => return Err(Error::invalid(&self.path, format!("buffer {i} has no URI"))),
            };
            if (bytes.len() as u64) < buffer.byte_length.0 {
                let (there, wanted) = (bytes.len(), buffer.byte_length.0);
                return Err(Error::invalid(&self.path, format!("buffer {i} should hold {wanted} bytes, has {there}")));
            }
            self.buffers.push(bytes);
        }
        Ok(())
    }

    /// The bytes behind a URI: data, or a file beside this one.
    ///
    /// # Errors
    /// [`Error::Invalid`] for damaged base64, [`Error::Unsupported`] for network addresses, [`Error::Io`].
    pub fn resolve(&self, uri: &str) -> Result<Vec<u8>> {
        if let Some(data) = uri.strip_prefix("data:") {
            let Some((_, data)) = data.split_once(";base64,") else {
                return Err(Error::unsupported(&self.path, "a data URI that is not base64"));
            };
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
        let name = percent_decoded(uri);
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
        let read = || -> Parsed<Option<TriMesh>> {
            let Some(p) = self.root.meshes.get(mesh).and_then(|m| m.primitives.get(primitive)) else {
                return invalid("there is no such primitive");
            };
            let Checked::Valid(mode) = p.mode else { return invalid("unknown mode") };
            if !matches!(mode, Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
                return Ok(None);
            }
            if p.extensions.as_ref().is_some_and(|e| e.others.contains_key("KHR_draco_mesh_compression")) {
                return Err(Fault::Unsupported("Draco compression; decompress the file first".into()));
            }
            let attribute = |name: json::mesh::Semantic| p.attributes.get(&Checked::Valid(name)).map(|a| a.value());
            use json::mesh::Semantic::{Colors, Normals, Positions, TexCoords};
            let Some(positions) = attribute(Positions) else { return Ok(None) };
            let positions: Vec<[f32; 3]> = self.floats(positions)?;
            let normals = attribute(Normals).map(|a| self.floats(a)).transpose()?;
            let mut uvs: Option<Vec<[f32; 2]>> = attribute(TexCoords(0)).map(|a| self.floats(a)).transpose()?;
            uvs.iter_mut().flatten().for_each(|uv| uv[1] = 1.0 - uv[1]);
            let colors = attribute(Colors(0)).map(|a| self.floats(a)).transpose()?;
            let order = match p.indices {
                Some(accessor) => self.indices(accessor.value())?,
                None => (0..u32::try_from(positions.len()).unwrap_or(u32::MAX)).collect(),
            };
            let mesh = TriMesh { positions, normals, uvs, colors, indices: triangles(mode, &order) };
            match mesh.fault() {
                Some(fault) => invalid(fault),
                None => Ok(Some(mesh)),
            }
        };
        read().map_err(|fault| {
            let place = |what| format!("mesh {mesh}, primitive {primitive}: {what}");
            match fault {
                Fault::Invalid(what) => Error::invalid(&self.path, place(what)),
                Fault::Unsupported(what) => Error::unsupported(&self.path, place(what)),
            }
        })
    }

    /// The nodes with meshes of the default scene (all root nodes when the file has no scene), in depth-first order.
    ///
    /// # Errors
    /// [`Error::Invalid`] when a node is its own ancestor or has two parents.
    pub fn placed(&self) -> Result<Vec<Placed>> {
        let nodes = &self.root.nodes;
        let scene = self.root.scene.map_or(0, |s| s.value());
        let roots: Vec<usize> = match self.root.scenes.get(scene) {
            Some(scene) => scene.nodes.iter().map(|n| n.value()).collect(),
            None => {
                let mut is_child = vec![false; nodes.len()];
                nodes.iter().flat_map(|n| n.children.iter().flatten()).for_each(|c| is_child[c.value()] = true);
                (0..nodes.len()).filter(|&i| !is_child[i]).collect()
            }
        };
        let mut stack: Vec<(usize, DAffine3)> = roots.iter().rev().map(|&n| (n, DAffine3::IDENTITY)).collect();
        let mut seen = vec![false; nodes.len()];
        let mut placed = Vec::new();
        while let Some((node, world_from_parent)) = stack.pop() {
            if std::mem::replace(&mut seen[node], true) {
                return Err(Error::invalid(&self.path, format!("node {node} is reached twice: the nodes are no tree")));
            }
            let world_from_node = world_from_parent * local_transform(&nodes[node]);
            if let Some(mesh) = nodes[node].mesh {
                placed.push(Placed { node, mesh: mesh.value(), world_from_node });
            }
            let children = nodes[node].children.iter().flatten().rev();
            stack.extend(children.map(|c| (c.value(), world_from_node)));
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
        let (mut vertices, mut left_out) = (0_u64, 0);
        for Placed { node, mesh, world_from_node } in self.placed()? {
            let json_mesh = &self.root.meshes[mesh];
            let name = self.root.nodes[node].name.as_ref().or(json_mesh.name.as_ref());
            for (i, primitive) in json_mesh.primitives.iter().enumerate() {
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
                let material = primitive.material.and_then(|m| self.root.materials.get(m.value()));
                loaded.parts.push(Part {
                    name: name.cloned().unwrap_or_else(|| format!("mesh {mesh}")),
                    material: material.and_then(|m| m.name.clone()),
                    flat: false,
                    mesh: part,
                });
            }
        }
        if left_out > 0 {
            loaded.warnings.push(format!("{left_out} primitives of points, lines or no positions were left out"));
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

    fn floats<const N: usize>(&self, index: usize) -> Parsed<Vec<[f32; N]>> {
        let rows = self.rows(index)?;
        if rows.components < N {
            return invalid(format!("accessor {index} has {} components instead of {N}", rows.components));
        }
        let normalized = self.root.accessors[index].normalized;
        let size = component_size(rows.kind);
        Ok((0..rows.count)
            .map(|i| {
                let row = rows.row(i);
                std::array::from_fn(|j| component(rows.kind, normalized, &row[j * size..]))
            })
            .collect())
    }

    fn indices(&self, index: usize) -> Parsed<Vec<u32>> {
        let rows = self.rows(index)?;
        if rows.components != 1 {
            return invalid(format!("accessor {index} holds indices and is not SCALAR"));
        }
        let size = component_size(rows.kind);
        match rows.kind {
            ComponentType::U8 | ComponentType::U16 | ComponentType::U32 => {}
            _ => return invalid(format!("accessor {index} holds indices that are no unsigned integers")),
        }
        Ok((0..rows.count).map(|i| little_endian(&rows.row(i)[..size])).collect())
    }

    /// Checks an accessor against its buffers and gives its rows, sparse values put in.
    fn rows(&self, index: usize) -> Parsed<Rows<'_>> {
        let Some(accessor) = self.root.accessors.get(index) else { return invalid(format!("no accessor {index}")) };
        let (Checked::Valid(kind), Checked::Valid(shape)) = (accessor.component_type, accessor.type_) else {
            return invalid(format!("accessor {index} has an unknown type"));
        };
        let kind = kind.0;
        let (components, size) = (shape.multiplicity(), shape.multiplicity() * component_size(kind));
        if !matches!(shape, Type::Scalar | Type::Vec2 | Type::Vec3 | Type::Vec4) {
            return invalid(format!("accessor {index} holds matrices"));
        }
        let count = accessor.count.0;
        let offset = accessor.byte_offset.map_or(0, |o| o.0);
        let dense = match accessor.buffer_view {
            Some(view) => Some(self.view(view.value(), offset, count, size, index)?),
            None => None,
        };
        let sparse = match &accessor.sparse {
            Some(s) => Some(self.sparse_rows(s, count, size, index)?),
            None => None,
        };
        // Zeros without bytes behind them: bound what a header can ask for.
        if dense.is_none() && count > 1 << 24 {
            return invalid(format!("accessor {index} asks for {count} rows without data"));
        }
        let count = count as usize;
        Ok(Rows { dense, sparse, count, components, kind, zero: [0; 16], size })
    }

    fn sparse_rows(
        &self,
        sparse: &json::accessor::sparse::Sparse,
        count: u64,
        size: usize,
        index: usize,
    ) -> Parsed<std::collections::HashMap<u32, &[u8]>> {
        let (at, values) = (&sparse.indices, &sparse.values);
        let Checked::Valid(kind) = at.component_type else { return invalid("sparse indices of unknown type") };
        let width = component_size(kind.0);
        let n = sparse.count.0;
        let keys = self.view(at.buffer_view.value(), at.byte_offset.0, n, width, index)?;
        let values = self.view(values.buffer_view.value(), values.byte_offset.0, n, size, index)?;
        let mut rows = std::collections::HashMap::new();
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
        let v = self.root.buffer_views.get(view).ok_or_else(beyond)?;
        if v.extensions.as_ref().is_some_and(|e| e.others.contains_key("EXT_meshopt_compression")) {
            return Err(Fault::Unsupported("meshopt compression; decompress the file first".into()));
        }
        let begin = v.byte_offset.map_or(0, |o| o.0);
        let end = begin.checked_add(v.byte_length.0).ok_or_else(beyond)?;
        let buffer = self.buffers.get(v.buffer.value()).ok_or_else(beyond)?;
        let range = usize::try_from(begin).ok().zip(usize::try_from(end).ok());
        let bytes = range
            .and_then(|(b, e)| buffer.get(b..e))
            .ok_or_else(|| Fault::Invalid(format!("buffer view {view} reaches beyond the end of its buffer")))?;
        let stride = v.byte_stride.map_or(size, |s| s.0);
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
    sparse: Option<std::collections::HashMap<u32, &'a [u8]>>,
    count: usize,
    components: usize,
    kind: ComponentType,
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

fn component_size(kind: ComponentType) -> usize {
    kind.size()
}

fn little_endian(raw: &[u8]) -> u32 {
    raw.iter().rev().fold(0, |n, &b| n << 8 | u32::from(b))
}

/// One component as a float (specification, "Animations", for the normalised mapping).
fn component(kind: ComponentType, normalized: bool, raw: &[u8]) -> f32 {
    let bits = little_endian(&raw[..component_size(kind)]);
    let (value, scale) = match kind {
        ComponentType::F32 => return f32::from_bits(bits),
        ComponentType::U8 => (bits as f32, 255.0),
        ComponentType::U16 => (bits as f32, 65535.0),
        ComponentType::U32 => (bits as f32, u32::MAX as f32),
        ComponentType::I8 => (f32::from(bits as u8 as i8), 127.0),
        ComponentType::I16 => (f32::from(bits as u16 as i16), 32767.0),
    };
    if normalized { (value / scale).max(-1.0) } else { value }
}

fn triangles(mode: Mode, order: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        Mode::TriangleStrip => order
            .windows(3)
            .enumerate()
            .map(|(i, w)| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] })
            .collect(),
        Mode::TriangleFan => order.windows(2).skip(1).map(|w| [order[0], w[0], w[1]]).collect(),
        _ => order.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
    }
}

fn local_transform(node: &json::Node) -> DAffine3 {
    if let Some(m) = node.matrix {
        return DAffine3::from_mat4(DMat4::from_cols_array(&m.map(f64::from)));
    }
    let vector = |v: Option<[f32; 3]>, default| v.map_or(default, |v| DVec3::from(v.map(f64::from)));
    let rotation = node.rotation.map_or(DQuat::IDENTITY, |q| DQuat::from_array(q.0.map(f64::from)));
    let rotation = if rotation.length_squared() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY };
    DAffine3::from_scale_rotation_translation(
        vector(node.scale, DVec3::ONE),
        rotation,
        vector(node.translation, DVec3::ZERO),
    )
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

/// Version, required extensions and all indices of the document.
fn check(root: &json::Root) -> Parsed<()> {
    let wanted = root.asset.min_version.as_ref().unwrap_or(&root.asset.version);
    if !wanted.starts_with("2.") || (root.asset.min_version.is_some() && wanted != "2.0") {
        return Err(Fault::Unsupported(format!("glTF version {wanted}; 2.0 is read")));
    }
    if let Some(unknown) = root.extensions_required.iter().find(|e| !KNOWN_EXTENSIONS.contains(&e.as_str())) {
        return Err(Fault::Unsupported(format!("the file requires the extension {unknown}, which is not supported")));
    }
    let mut first = None;
    root.validate(root, json::Path::new, &mut |path, error| {
        // Required extensions were judged above, by what matters for geometry.
        if !path().as_str().starts_with("extensionsRequired") {
            first.get_or_insert_with(|| format!("{}: {error}", path()));
        }
    });
    match first {
        Some(what) => invalid(what),
        None => Ok(()),
    }
}

fn percent_decoded(uri: &str) -> String {
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
    String::from_utf8_lossy(&bytes).into_owned()
}
