//! What a file holds, whatever its format.

use crate::error::{Error, Result};
use crate::mesh::TriMesh;
use glam::DVec3;
use std::path::{Path, PathBuf};

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
    pub(crate) fn put_back(&mut self) {
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

/// The bytes of the file at `path`, which must be a plain one: devices and pipes may never end.
pub(crate) fn bytes_of(path: &Path) -> Result<Vec<u8>> {
    let kind = std::fs::metadata(path).map_err(|e| Error::io(path, e))?;
    if !kind.is_file() {
        let what = if kind.is_dir() { "a folder" } else { "a device or pipe" };
        return Err(Error::unsupported(path, format!("{what}, not a plain file")));
    }
    std::fs::read(path).map_err(|e| Error::io(path, e))
}
