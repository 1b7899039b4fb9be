//! One door for all formats.

use crate::error::{Error, Result};
use crate::loaded::{Loaded, bytes_of};
use crate::{gltf, obj, off, ply, serialized, stl};
use std::path::{Path, PathBuf};

/// What to read.
#[derive(Clone, Debug, Default)]
pub struct ReadOptions {
    /// Only this part, counted from 0: the shape index of a `.serialized` file. `None` reads all.
    pub part: Option<usize>,
    /// Folders, beside that of the file, where files that it names may be (glTF).
    pub asset_roots: Vec<PathBuf>,
    /// Coordinates that 32-bit floats do not hold stay about [`Loaded::origin`]. Otherwise they are rounded, with a warning.
    pub keep_origin: bool,
}

/// A mesh file format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Stanford PLY.
    Ply,
    /// Wavefront OBJ.
    Obj,
    /// glTF 2.0, JSON or binary.
    Gltf,
    /// STL, text or binary.
    Stl,
    /// Geomview's OFF.
    Off,
    /// Mitsuba's compressed mesh collections.
    Serialized,
}

impl Format {
    /// By content where it tells, by extension otherwise.
    pub fn detect(path: &Path, bytes: &[u8]) -> Option<Self> {
        match bytes {
            [b'p', b'l', b'y', b'\r' | b'\n' | b' ', ..] => return Some(Self::Ply),
            [b'g', b'l', b'T', b'F', ..] => return Some(Self::Gltf),
            [0x1c, 0x04, 3..=4, 0, ..] => return Some(Self::Serialized),
            _ if off::is_off(bytes) => return Some(Self::Off),
            _ => {}
        }
        match path.extension()?.to_ascii_lowercase().to_str()? {
            "ply" => Some(Self::Ply),
            "obj" => Some(Self::Obj),
            "stl" => Some(Self::Stl),
            "off" => Some(Self::Off),
            "gltf" | "glb" => Some(Self::Gltf),
            "serialized" => Some(Self::Serialized),
            _ => None,
        }
    }
}

/// Reads the meshes of a file: PLY, OBJ, STL, OFF, glTF/GLB (the default scene, node transforms applied) or
/// `.serialized`.
///
/// # Errors
/// [`Error::Io`], [`Error::Invalid`] for damaged files, [`Error::Unsupported`] for other formats and features.
pub fn read(path: &Path, options: &ReadOptions) -> Result<Loaded> {
    let bytes = bytes_of(path)?;
    if bytes.is_empty() {
        return Err(Error::invalid(path, "the file is empty"));
    }
    let mut loaded = match Format::detect(path, &bytes) {
        Some(Format::Ply) => ply::read(path, &bytes)?,
        Some(Format::Obj) => obj::read(path, &bytes)?,
        Some(Format::Gltf) => gltf::Asset::from_bytes_within(path, bytes, &options.asset_roots)?.flatten()?,
        Some(Format::Stl) => stl::read(path, &bytes)?,
        Some(Format::Off) => off::read(path, &bytes)?,
        Some(Format::Serialized) => return serialized::read(path, &bytes, options.part),
        None => return Err(Error::unsupported(path, "not a PLY, OBJ, STL, OFF, glTF, GLB or .serialized file")),
    };
    if let Some(part) = options.part {
        if part >= loaded.parts.len() {
            return Err(Error::invalid(path, format!("no part {part}: the file has {}", loaded.parts.len())));
        }
        loaded.parts = vec![loaded.parts.swap_remove(part)];
    }
    if !options.keep_origin {
        loaded.put_back();
    }
    Ok(loaded)
}
