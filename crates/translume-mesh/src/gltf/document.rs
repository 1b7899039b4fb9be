//! The part of a glTF document that geometry needs, as it is written: absent lists are empty, indices are unchecked.

use serde::{Deserialize, Deserializer};
use std::collections::BTreeMap;

/// A whole number; `1.0` is one too, as JSON has it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Number(pub u64);

impl Number {
    /// As an index.
    pub fn get(self) -> usize {
        usize::try_from(self.0).unwrap_or(usize::MAX)
    }
}

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let x = f64::deserialize(deserializer)?;
        if (0.0..=9e15).contains(&x) && x.fract() == 0.0 {
            return Ok(Self(x as u64));
        }
        Err(serde::de::Error::custom(format!("{x} where a count or index belongs")))
    }
}

/// Extension objects by name.
pub type Extensions = BTreeMap<String, serde_json::Value>;

/// The document.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
#[allow(missing_docs, reason = "names and meanings are the specification's")]
pub struct Document {
    pub asset: Info,
    pub extensions_required: Vec<String>,
    pub scene: Option<Number>,
    pub scenes: Vec<Scene>,
    pub nodes: Vec<Node>,
    pub meshes: Vec<Mesh>,
    pub accessors: Vec<Accessor>,
    pub buffer_views: Vec<BufferView>,
    pub buffers: Vec<Buffer>,
    pub skins: Vec<Skin>,
}

/// `asset`.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
#[allow(missing_docs, reason = "names and meanings are the specification's")]
pub struct Info {
    pub version: String,
    pub min_version: Option<String>,
}

/// A scene.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
#[allow(missing_docs, reason = "names and meanings are the specification's")]
pub struct Scene {
    pub nodes: Vec<Number>,
}

/// A node.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
#[allow(missing_docs, reason = "names and meanings are the specification's")]
pub struct Node {
    pub name: Option<String>,
    pub children: Vec<Number>,
    pub mesh: Option<Number>,
    pub camera: Option<Number>,
    pub skin: Option<Number>,
    /// By columns.
    pub matrix: Option<[f64; 16]>,
    pub translation: Option<[f64; 3]>,
    pub rotation: Option<[f64; 4]>,
    pub scale: Option<[f64; 3]>,
    /// Of morph targets, in place of the mesh's.
    pub weights: Option<Vec<f32>>,
    pub extensions: Extensions,
}

/// A mesh.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
#[allow(missing_docs, reason = "names and meanings are the specification's")]
pub struct Mesh {
    pub name: Option<String>,
    pub primitives: Vec<Primitive>,
    /// Of morph targets.
    pub weights: Vec<f32>,
}

/// A primitive: attributes by name, with their accessors.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
#[allow(missing_docs, reason = "names and meanings are the specification's")]
pub struct Primitive {
    pub attributes: BTreeMap<String, Number>,
    pub indices: Option<Number>,
    pub material: Option<Number>,
    pub mode: Option<Number>,
    /// What morph targets add to attributes, by their names.
    pub targets: Vec<BTreeMap<String, Number>>,
    pub extensions: Extensions,
}

/// A skin.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
#[allow(missing_docs, reason = "names and meanings are the specification's")]
pub struct Skin {
    pub inverse_bind_matrices: Option<Number>,
    pub joints: Vec<Number>,
}

/// An accessor.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
#[allow(missing_docs, reason = "names and meanings are the specification's")]
pub struct Accessor {
    pub buffer_view: Option<Number>,
    pub byte_offset: Number,
    pub component_type: Number,
    pub normalized: bool,
    pub count: Number,
    /// `SCALAR`, `VEC2`, …
    #[serde(rename = "type")]
    pub shape: String,
    pub sparse: Option<Sparse>,
}

/// Rows that replace those of an accessor.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
#[allow(missing_docs, reason = "names and meanings are the specification's")]
pub struct Sparse {
    pub count: Number,
    pub indices: SparseRows,
    pub values: SparseRows,
}

/// Where the indices or the values of [`Sparse`] are.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
#[allow(missing_docs, reason = "names and meanings are the specification's")]
pub struct SparseRows {
    pub buffer_view: Number,
    pub byte_offset: Number,
    /// Of indices only.
    pub component_type: Option<Number>,
}

/// A buffer view.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
#[allow(missing_docs, reason = "names and meanings are the specification's")]
pub struct BufferView {
    pub buffer: Number,
    pub byte_offset: Number,
    pub byte_length: Number,
    pub byte_stride: Option<Number>,
    pub extensions: Extensions,
}

/// A buffer.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
#[allow(missing_docs, reason = "names and meanings are the specification's")]
pub struct Buffer {
    pub uri: Option<String>,
    pub byte_length: Number,
}
