//! Attributes of PLY files by Mitsuba's names: `vertex_NAME` and `face_NAME` are the properties NAME_0, NAME_1, … of vertices and
//! faces, one number or three, as stored.
//!
//! The mesh reader keeps colours only; this looks for one attribute beside it. Damaged files are the mesh reader's to refuse: here
//! they have no attribute.

use std::path::Path;
use std::sync::Arc;
use translume_mesh::{TriMesh, ply};

/// The mesh with the attribute `name` of its file as colours; `None`: it has none.
pub(super) fn colored(mesh: &Arc<TriMesh>, path: &Path, name: &str) -> Option<Arc<TriMesh>> {
    let (element, name) = name.split_once('_')?;
    let values = ply::attribute(path, &crate::files::bytes(path).ok()?, element, name).ok()??;
    match element {
        "vertex" if values.len() == mesh.positions.len() => {
            Some(Arc::new(TriMesh { colors: Some(values), ..TriMesh::clone(mesh) }))
        }
        "face" if values.len() == mesh.indices.len() => Some(Arc::new(by_face(mesh, &values))),
        _ => None,
    }
}

/// The mesh with corners of their own for each triangle, in its colour.
fn by_face(mesh: &TriMesh, values: &[[f32; 3]]) -> TriMesh {
    let corners = || mesh.indices.iter().flatten().map(|i| *i as usize);
    // What else there may be is glTF's; nothing that this format has is left out.
    TriMesh {
        positions: corners().map(|i| mesh.positions[i]).collect(),
        normals: mesh.normals.as_ref().map(|n| corners().map(|i| n[i]).collect()),
        uvs: mesh.uvs.as_ref().map(|uv| corners().map(|i| uv[i]).collect()),
        colors: Some(values.iter().flat_map(|v| [*v; 3]).collect()),
        indices: (0..mesh.indices.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect(),
        ..TriMesh::default()
    }
}
