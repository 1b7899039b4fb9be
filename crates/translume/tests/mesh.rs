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
    assert!(
        translume(dir.path(), &["mesh", "convert", "t.obj", "-o", "t.off"]).error(2).contains(".ply, .obj or .stl")
    );
    translume(dir.path(), &["mesh", "convert", "t.obj", "--scale", "0", "-o", "t.ply"]).error(2);
}

/// Map coordinates come back as they went in; nothing is moved, and nothing said, where floats are enough.
#[test]
fn large_coordinates_are_kept_and_written_back() {
    let dir = tempdir().unwrap();
    let grid = |x0: f64, y0: f64| {
        let v = (0..16).map(|i| format!("v {} {} 2\n", x0 + 0.005 * f64::from(i % 4), y0 + 0.005 * f64::from(i / 4)));
        v.collect::<String>() + "f 1 2 6 5\nf 11 12 16 15\n"
    };
    fs::write(dir.path().join("far.obj"), grid(443_211.0, 5_412_345.0)).unwrap();
    fs::write(dir.path().join("near.obj"), grid(3.0, 2.0)).unwrap();
    let info = |name: &str| -> Value {
        serde_json::from_str(&translume(dir.path(), &["mesh", "info", name, "--json"]).ok()).unwrap()
    };
    let near = |a: &Value, b: f64, e: f64| assert!((a.as_f64().unwrap() - b).abs() < e, "{a} for {b}");
    for name in ["far.ply", "far2.obj"] {
        let ran = translume(dir.path(), &["mesh", "convert", "far.obj", "-o", name]);
        assert!(ran.stderr.contains("origin 443211 5412345"), "{}", ran.stderr);
        ran.ok();
        let found = info(name);
        near(&found["area"], 5e-5, 1e-8);
        near(&found["bounds"][1][1], 5_412_345.015, 1e-6);
        assert_eq!(found["warnings"], Value::Array(vec![]));
    }
    let ran = translume(dir.path(), &["mesh", "convert", "near.obj", "-o", "near.ply"]);
    assert!(!ran.stderr.contains("origin") && !ran.stderr.contains("warning"), "{}", ran.stderr);
    assert_eq!(info("near.ply")["origin"], serde_json::json!([0.0, 0.0, 0.0]));
}

#[test]
fn convert_says_what_it_drops() {
    let dir = tempdir().unwrap();
    let head = "mtllib red.mtl\nvt 0 0\nusemtl red\n";
    fs::write(dir.path().join("m.obj"), format!("{head}{}", TETRAHEDRON.replace("f 1 3 2", "f 1/1 3/1 2/1"))).unwrap();
    let warned = |args: &[&str]| {
        let ran = translume(dir.path(), args);
        let text = ran.stderr.clone();
        ran.ok();
        text
    };
    let text = warned(&["mesh", "convert", "m.obj", "-o", "m.ply"]);
    assert!(text.contains("the materials red") && text.contains("red.mtl") && !text.contains("coordinates"), "{text}");
    let text = warned(&["mesh", "convert", "m.obj", "-o", "m.stl"]);
    assert!(text.contains("texture coordinates"), "{text}");
    let info = translume(dir.path(), &["mesh", "info", "m.stl", "--json"]).ok();
    assert_eq!(serde_json::from_str::<Value>(&info).unwrap()["closed"], Value::from(true));
    fs::write(dir.path().join("t.obj"), TETRAHEDRON).unwrap();
    assert!(!warned(&["mesh", "convert", "t.obj", "-o", "t.stl"]).contains("warning"));
}

#[cfg(unix)]
#[test]
fn devices_and_folders_are_refused() {
    let dir = tempdir().unwrap();
    assert!(translume(dir.path(), &["mesh", "info", "/dev/zero"]).error(1).contains("not a plain file"));
    assert!(translume(dir.path(), &["mesh", "info", "."]).error(1).contains("a folder"));
}
