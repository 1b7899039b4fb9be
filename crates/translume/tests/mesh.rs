//! `translume mesh` through the binary.

mod common;

use common::translume;
use serde_json::Value;
use std::fs;
use tempfile::tempdir;

const TETRAHEDRON: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";

#[test]
fn info_tells_what_is_wrong_with_a_mesh() {
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("a b.obj"), TETRAHEDRON).unwrap();
    let closed: Value =
        serde_json::from_str(&translume(dir.path(), &["mesh", "info", "a b.obj", "--json"]).ok()).unwrap();
    assert_eq!((&closed["closed"], &closed["edges"]), (&Value::from(true), &Value::from(6)));
    assert_eq!(closed["warnings"], Value::Array(vec![]));
    assert!((closed["volume"].as_f64().unwrap() - 1.0 / 6.0).abs() < 1e-9);

    let broken = format!("{TETRAHEDRON}v nan 0 0\nf 1 1 2\nf 1 2 5\nf 1 3 2\n");
    fs::write(dir.path().join("broken.obj"), broken).unwrap();
    let text = translume(dir.path(), &["mesh", "info", "broken.obj"]).ok();
    for line in ["1 vertices are infinite or NaN", "2 triangles have no area", "1 triangles are there twice", "open"] {
        assert!(text.contains(line), "{text}");
    }
    assert!(translume(dir.path(), &["mesh", "info", "none.ply"]).error(1).contains("none.ply"));
    assert!(translume(dir.path(), &["mesh", "info", "a b.obj", "--part", "1"]).error(1).contains("no part 1"));
}

#[test]
fn convert_writes_ply_and_obj() {
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("t.obj"), TETRAHEDRON).unwrap();
    translume(dir.path(), &["mesh", "convert", "t.obj", "--scale", "2", "--normals", "30", "-o", "t.ply"]).ok();
    translume(dir.path(), &["mesh", "convert", "t.ply", "-o", "back.obj"]).ok();
    let info: Value =
        serde_json::from_str(&translume(dir.path(), &["mesh", "info", "back.obj", "--json"]).ok()).unwrap();
    assert!((info["volume"].as_f64().unwrap() - 8.0 / 6.0).abs() < 1e-6);
    // Every edge is a crease: three corners per face.
    assert_eq!((&info["vertices"], &info["positions"]), (&Value::from(12), &Value::from(4)));
    assert_eq!(info["parts"][0]["normals"], Value::from(true));
    assert!(translume(dir.path(), &["mesh", "convert", "t.obj", "-o", "t.stl"]).error(2).contains(".ply or .obj"));
    translume(dir.path(), &["mesh", "convert", "t.obj", "--scale", "0", "-o", "t.ply"]).error(2);
}
