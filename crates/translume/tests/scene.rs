//! `translume scene` through the binary.

mod common;

use common::translume;
use serde_json::Value;

const BALL: &str = r#"<scene version="3.0.0">
  <default name="r" value="2"/>
  <sensor type="perspective"><film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="32"/></film></sensor>
  <shape type="sphere"><float name="radius" value="$r"/><emitter type="area"/></shape>
</scene>"#;

#[test]
fn info_as_text_and_json() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("ball scene.xml"), BALL).unwrap();
    let text = translume(dir.path(), &["scene", "info", "ball scene.xml"]).ok();
    assert!(text.contains("1 sphere") && text.contains("1 area") && text.contains("64x32"), "{text}");
    let json = translume(dir.path(), &["scene", "info", "ball scene.xml", "--define", "r=5", "--json"]).ok();
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["bounds"][1][0], 5.0);
    assert_eq!(json["lights"]["area"], 1);
    assert_eq!(json["sensors"][0]["width"], 64);
}

#[test]
fn warnings_go_to_standard_error() {
    let dir = tempfile::tempdir().unwrap();
    let text = BALL.replace("<emitter type=\"area\"/>", "<emitter type=\"sky\"/>");
    std::fs::write(dir.path().join("s.xml"), text).unwrap();
    let error = translume(dir.path(), &["scene", "info", "s.xml"]).error(1);
    assert!(error.contains("s.xml:4: emitter \"sky\" is not supported"), "{error}");
    let run = translume(dir.path(), &["scene", "info", "s.xml", "--lenient"]);
    assert!(run.stderr.contains("warning: s.xml:4: emitter \"sky\""), "{}", run.stderr);
    run.ok();
}

#[test]
fn bad_files_are_one_line() {
    let dir = tempfile::tempdir().unwrap();
    for (name, bytes, expected) in [
        ("empty.xml", "", "the file is empty"),
        ("cut.xml", &BALL[..200], "cut.xml"),
        ("text.txt", "hello", "not a scene"),
        ("cut.glb", "glTF\x02\0\0\0", "cut.glb"),
        ("no.gltf", "{", "no.gltf"),
        ("bad.pbrt", "WorldBegin Shape \"sphere\" \"float radius\" [ 1", "bad.pbrt:1"),
        ("bomb.xml", "<!DOCTYPE x [<!ENTITY a \"b\">]><scene version=\"3.0.0\"/>", "document type"),
    ] {
        std::fs::write(dir.path().join(name), bytes).unwrap();
        let error = translume(dir.path(), &["scene", "info", name]).error(1);
        assert!(error.contains(expected), "{error}");
    }
    let error = translume(dir.path(), &["scene", "info", "gone.xml"]).error(1);
    assert!(error.contains("gone.xml"), "{error}");
    translume(dir.path(), &["scene", "info", "empty.xml", "--define", "nothing"]).error(2);
}
