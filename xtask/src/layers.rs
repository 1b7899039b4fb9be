//! The layer rule: a crate depends only on crates listed above it, the measured models do not know each other, and the
//! mathematical crates touch no files.

use serde_json::Value;

/// All crates, foundations first.
const ORDER: [&str; 16] = [
    "translume-core",
    "translume-image",
    "translume-mesh",
    "translume-trace",
    "translume-bxdf",
    "translume-hdr",
    "translume-field",
    "translume-btf",
    "translume-scatter",
    "translume-simplify",
    "translume-scene",
    "translume-render",
    "translume-capture",
    "translume-view",
    "translume",
    "translume-fuzz",
];

/// Crates that do not know each other, whatever their order.
const STRANGERS: [&str; 5] =
    ["translume-hdr", "translume-field", "translume-btf", "translume-scatter", "translume-simplify"];

/// Crates without file input and output …
const PURE: [&str; 2] = ["translume-core", "translume-bxdf"];

/// … and so without these.
const FILE_CRATES: [&str; 16] = [
    "exr",
    "flate2",
    "gltf",
    "image",
    "kamadak-exif",
    "ktx2",
    "memmap2",
    "png",
    "rawler",
    "tempfile",
    "tiff",
    "tobj",
    "translume-image",
    "translume-mesh",
    "zarrs",
    "zip",
];

/// A dependency as a crate declares it.
pub(crate) struct Edge<'a> {
    pub(crate) from: &'a str,
    pub(crate) to: &'a str,
    /// Not for tests, benchmarks or build scripts alone.
    pub(crate) ships: bool,
}

/// Checks the workspace, and that ARCHITECTURE.md has a place for each of its crates.
///
/// # Errors
/// Every wrong edge and every crate that is left out, one a line.
pub(crate) fn check() -> Result<(), String> {
    let metadata = crate::metadata(&["--no-deps"])?;
    let edges = edges(&metadata);
    let mut wrong: Vec<_> = edges.iter().filter_map(objection).collect();
    let map = std::path::Path::new(metadata["workspace_root"].as_str().unwrap_or(".")).join("ARCHITECTURE.md");
    let map = std::fs::read_to_string(&map).map_err(|e| format!("{}: {e}", map.display()))?;
    wrong.extend(left_out(&metadata, &map));
    if wrong.is_empty() {
        let inner = edges.iter().filter(|e| is_ours(e.to)).count();
        println!("layers: {inner} dependencies between crates of the workspace, all downwards");
        Ok(())
    } else {
        Err(format!("the layers of ARCHITECTURE.md do not hold:\n  {}", wrong.join("\n  ")))
    }
}

pub(crate) fn edges(metadata: &Value) -> Vec<Edge<'_>> {
    let mut edges = Vec::new();
    for package in metadata["packages"].as_array().into_iter().flatten() {
        for dependency in package["dependencies"].as_array().into_iter().flatten() {
            if let (Some(from), Some(to)) = (package["name"].as_str(), dependency["name"].as_str()) {
                edges.push(Edge { from, to, ships: dependency["kind"].is_null() });
            }
        }
    }
    edges
}

/// A complaint for every crate that the table in `map` has no row for.
fn left_out(metadata: &Value, map: &str) -> Vec<String> {
    let packages = metadata["packages"].as_array().into_iter().flatten();
    let names = packages.filter_map(|p| p["name"].as_str());
    names
        .filter(|name| !map.contains(&format!("\n| `{name}` |")))
        .map(|name| format!("{name} has no row in the table of crates"))
        .collect()
}

pub(crate) fn is_ours(name: &str) -> bool {
    name == "translume" || name.starts_with("translume-")
}

/// What is wrong with an edge, if anything.
fn objection(edge: &Edge<'_>) -> Option<String> {
    let Edge { from, to, ships } = *edge;
    if ships && PURE.contains(&from) && FILE_CRATES.contains(&to) {
        return Some(format!("{from} -> {to}: {from} knows nothing about files"));
    }
    if !is_ours(from) || !is_ours(to) {
        return None;
    }
    let layer = |name| ORDER.iter().position(|known| *known == name);
    match (layer(from), layer(to)) {
        (None, _) => Some(format!("{from} has no layer: add it to xtask/src/layers.rs and ARCHITECTURE.md")),
        (_, None) => Some(format!("{to} has no layer: add it to xtask/src/layers.rs and ARCHITECTURE.md")),
        (Some(a), Some(b)) if b >= a => Some(format!("{from} -> {to}: {to} stands above {from}")),
        _ if STRANGERS.contains(&from) && STRANGERS.contains(&to) => {
            Some(format!("{from} -> {to}: these two do not know each other"))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(from: &str, to: &str) -> bool {
        objection(&Edge { from, to, ships: true }).is_some()
    }

    #[test]
    fn upwards_and_sideways_are_refused() {
        assert!(refused("translume-core", "translume-image"));
        assert!(refused("translume-image", "translume"));
        assert!(refused("translume-render", "translume-view"));
        assert!(refused("translume-scatter", "translume-hdr"));
        assert!(refused("translume-core", "translume-core"));
        assert!(refused("translume-new", "translume-core"));
        assert!(refused("translume", "translume-new"));
    }

    #[test]
    fn downwards_is_fine() {
        assert!(!refused("translume", "translume-hdr"));
        assert!(!refused("translume-render", "translume-bxdf"));
        assert!(!refused("translume-scatter", "translume-mesh"));
        assert!(!refused("translume-image", "exr"));
    }

    #[test]
    fn mathematics_has_no_files() {
        assert!(refused("translume-core", "image"));
        assert!(refused("translume-bxdf", "translume-image"));
        assert!(!refused("translume-bxdf", "glam"));
        let in_tests = Edge { from: "translume-bxdf", to: "tempfile", ships: false };
        assert!(objection(&in_tests).is_none());
    }

    #[test]
    fn a_crate_without_a_row_is_named() {
        let metadata = serde_json::json!({"packages": [{"name": "translume-core"}, {"name": "translume"}]});
        let complaints = left_out(&metadata, "\n| `translume-core` | random numbers |\n");
        assert_eq!(complaints, ["translume has no row in the table of crates"]);
    }

    #[test]
    fn edges_are_read_off_the_metadata() {
        let metadata = serde_json::json!({"packages": [
            {"name": "translume-core", "dependencies": [{"name": "translume", "kind": null}, {"name": "tempfile", "kind": "dev"}]},
        ]});
        let edges = edges(&metadata);
        assert_eq!(edges.len(), 2);
        assert_eq!(edges.iter().filter_map(objection).count(), 1);
    }
}
