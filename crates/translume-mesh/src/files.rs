//! One door for all formats.

use crate::error::{Error, Result};
use crate::mesh::TriMesh;
use crate::{gltf, obj, off, ply, serialized, stl};
use glam::DVec3;
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

/// A mesh with its names.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Part {
    /// Object or group name, the file's name where the format has none.
    pub name: String,
    /// Material name, where the format has one.
    pub material: Option<String>,
    /// The file asks for flat shading, though vertices are shared (`.serialized` only).
    pub flat: bool,
    /// The triangles.
    pub mesh: TriMesh,
}

impl Part {
    /// A part named after its file.
    pub(crate) fn named(path: &Path, mesh: TriMesh) -> Self {
        let name = path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
        Self { name, mesh, ..Self::default() }
    }
}

/// What a file holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Loaded {
    /// The meshes in file order.
    pub parts: Vec<Part>,
    /// Material libraries an OBJ file names, resolved against its folder; they may not exist.
    pub material_files: Vec<PathBuf>,
    /// What was odd and how it was dealt with, a line each.
    pub warnings: Vec<String>,
    /// What the file has and a [`TriMesh`] has no place for, as the end of a sentence.
    pub dropped: Vec<String>,
    /// What was taken off all positions, because 32-bit floats would not hold them; zero for nearly all files.
    pub origin: DVec3,
}

impl Loaded {
    /// Adds the origin to all positions, rounded to 32-bit floats, and says what that costs.
    fn put_back(&mut self) {
        let origin = std::mem::take(&mut self.origin);
        if origin == DVec3::ZERO {
            return;
        }
        let mut moved = 0.0_f64;
        for p in self.parts.iter_mut().flat_map(|p| &mut p.mesh.positions) {
            let exact = DVec3::from(p.map(f64::from)) + origin;
            let rounded = exact.as_vec3();
            if exact.is_finite() {
                moved = moved.max((rounded.as_dvec3() - exact).abs().max_element());
            }
            *p = rounded.into();
        }
        self.warnings.push(format!(
            "its coordinates around {} {} {} lose precision in 32-bit floats: vertices move by up to {moved:.2e}; move the \
             mesh to the origin",
            origin.x, origin.y, origin.z
        ));
    }

    /// All parts as one mesh; `None` when it would not fit 32-bit indices.
    pub fn merged(self) -> Option<TriMesh> {
        let mut parts = self.parts.into_iter();
        let mut whole = parts.next().map(|p| p.mesh).unwrap_or_default();
        parts.all(|p| whole.append(&p.mesh)).then_some(whole)
    }
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

/// The bytes of the file at `path`, which must be a plain one: devices and pipes may never end.
pub(crate) fn bytes_of(path: &Path) -> Result<Vec<u8>> {
    let kind = std::fs::metadata(path).map_err(|e| Error::io(path, e))?;
    if !kind.is_file() {
        let what = if kind.is_dir() { "a folder" } else { "a device or pipe" };
        return Err(Error::unsupported(path, format!("{what}, not a plain file")));
    }
    std::fs::read(path).map_err(|e| Error::io(path, e))
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
