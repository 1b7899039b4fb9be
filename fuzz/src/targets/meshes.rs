//! Meshes of every format, and OBJ's materials.

use super::Said;
use crate::input::Input;
use std::path::Path;
use translume_mesh::{ReadOptions, Topology, obj, ply, read};

pub(super) fn run(folder: &Path, input: &Input) -> Said {
    let mut said = Said { accepted: false, text: String::new() };
    for (name, _) in input.files.iter().filter(|f| f.0.ends_with(".mtl")) {
        said = said.and(Said::of(&obj::read_mtl(&folder.join(name)), |_| String::new()));
    }
    let Some((name, bytes)) = input.files.iter().find(|f| !f.0.ends_with(".mtl") && !f.0.ends_with(".bin")) else {
        return said;
    };
    let loaded = read(&folder.join(name), &ReadOptions::default());
    let said = said.and(Said::of(&loaded, |l| l.warnings.join("; ")));
    let Ok(loaded) = loaded else { return said };
    for part in &loaded.parts {
        assert_eq!(part.mesh.fault(), None, "part {:?}", part.name);
        let held = part.mesh.positions.len() + part.mesh.indices.len();
        // Deflate packs at most 1032 to 1.
        assert!(held < 1100 * (bytes.len() + 100), "{held} vertices and triangles");
    }
    if let Some(mesh) = loaded.merged() {
        let topology = Topology::of(&mesh);
        let warnings = topology.warnings().join("; ");
        let mut twin = mesh.clone();
        twin.crease_normals(0.5);
        assert_eq!(twin.fault(), None, "with new normals");
        let mut out = Vec::new();
        ply::write(&mesh, &mut out).expect("memory takes everything");
        let again = ply::read(Path::new("again.ply"), &out).map(|l| l.parts[0].mesh.indices.len()).ok();
        assert_eq!(again, Some(mesh.indices.len()), "written and read again");
        obj::write(&mesh, &mut std::io::sink()).expect("nowhere takes everything");
        return Said { text: format!("{} | {warnings}", said.text), ..said };
    }
    said
}
