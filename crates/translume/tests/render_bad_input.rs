//! `translume render` on what it cannot use: one line that names the file (and line), the right status, nothing written.

mod common;

use common::translume;
use std::path::Path;
use tempfile::{TempDir, tempdir};

const SKY: &str = r#"<emitter type="constant"/>"#;
const BALL: &str = r#"<shape type="sphere"/>"#;
const CAMERA: &str = r#"<sensor type="perspective"><film type="hdrfilm"><integer name="width" value="8"/>
  <integer name="height" value="8"/></film><transform name="to_world">
  <lookat origin="0,0,5" target="0,0,0" up="0,1,0"/></transform></sensor>"#;

fn scene(body: &str) -> String {
    format!("<scene version=\"3.0.0\">{body}</scene>")
}

/// A folder with these files.
fn folder(files: &[(&str, &[u8])]) -> TempDir {
    let dir = tempdir().unwrap();
    for (name, bytes) in files {
        std::fs::write(dir.path().join(name), bytes).unwrap();
    }
    dir
}

fn listing(dir: &Path) -> Vec<String> {
    let names = std::fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.collect();
    names.sort();
    names
}

/// Rendering fails with `status`, a last line that has `marks` in it, and no new file.
#[track_caller]
fn fails(dir: &Path, arguments: &[&str], status: i32, marks: &[&str]) {
    let before = listing(dir);
    let run = translume(dir, &[&["render"], arguments].concat());
    assert_eq!(run.status, status, "{}", run.stderr);
    let (warnings, error): (Vec<&str>, Vec<&str>) =
        run.stderr.lines().partition(|l| l.starts_with("translume: warning: "));
    assert!(error.len() == 1 && error[0].starts_with("translume: error: "), "{warnings:?} {error:?}");
    for mark in marks {
        assert!(error[0].contains(mark), "'{mark}' is not in: {}", error[0]);
    }
    assert_eq!(before, listing(dir), "{}", error[0]);
}

/// The scene of this body fails so.
#[track_caller]
fn scene_fails(body: &str, marks: &[&str]) {
    let dir = folder(&[("s.xml", scene(body).as_bytes())]);
    fails(dir.path(), &["s.xml", "-o", "o.exr"], 1, marks);
}

/// A shape from a file of this name and content fails so.
#[track_caller]
fn mesh_fails(name: &str, bytes: &[u8], marks: &[&str]) {
    let kind = name.rsplit('.').next().unwrap();
    let shape = format!("{CAMERA}{SKY}\n<shape type=\"{kind}\"><string name=\"filename\" value=\"{name}\"/></shape>");
    let dir = folder(&[("s.xml", scene(&shape).as_bytes()), (name, bytes)]);
    fails(dir.path(), &["s.xml", "-o", "o.exr"], 1, &[&["s.xml:", name], marks].concat());
}

#[test]
fn files_that_are_not_there() {
    let dir = tempdir().unwrap();
    fails(dir.path(), &["gone.xml", "-o", "o.exr"], 1, &["gone.xml"]);
    scene_fails(
        &format!("{CAMERA}{SKY}\n\n<shape type=\"obj\"><string name=\"filename\" value=\"gone.obj\"/></shape>"),
        &["gone.obj"],
    );
    let texture = r#"<bsdf type="diffuse"><texture type="bitmap" name="reflectance">
        <string name="filename" value="gone.png"/></texture></bsdf>"#;
    scene_fails(&format!("{CAMERA}{SKY}<shape type=\"sphere\">{texture}</shape>"), &["s.xml:", "gone.png"]);
    scene_fails(
        &format!("{CAMERA}{BALL}<emitter type=\"envmap\"><string name=\"filename\" value=\"gone.exr\"/></emitter>"),
        &["gone.exr"],
    );
}

#[test]
fn files_that_include_each_other() {
    let include = |name: &str| scene(&format!("<include filename=\"{name}\"/>"));
    let dir = folder(&[("a.xml", include("b.xml").as_bytes()), ("b.xml", include("a.xml").as_bytes())]);
    fails(dir.path(), &["a.xml", "-o", "o.exr"], 1, &["b.xml:1", "a.xml includes itself"]);
    let dir = folder(&[("a.xml", include("a.xml").as_bytes()), ("p.pbrt", b"Include \"p.pbrt\"\n")]);
    fails(dir.path(), &["a.xml", "-o", "o.exr"], 1, &["a.xml includes itself"]);
    fails(dir.path(), &["p.pbrt", "-o", "o.exr"], 1, &["p.pbrt:1"]);
}

#[test]
fn transforms_that_cannot_be_inverted() {
    let shape = |kind: &str, inside: &str| {
        format!(
            "{CAMERA}{SKY}<shape type=\"{kind}\">{inside}<transform name=\"to_world\"><scale x=\"0\"/></transform></shape>"
        )
    };
    scene_fails(&shape("sphere", ""), &["s.xml:", "sphere", "degenerate"]);
    scene_fails(&shape("rectangle", ""), &["degenerate"]);
    let group = r#"<shape type="shapegroup" id="g"><shape type="sphere"/></shape>"#;
    scene_fails(&format!("{group}{}", shape("instance", r#"<ref id="g"/>"#)), &["instance", "degenerate"]);
    let camera = CAMERA.replace(r#"target="0,0,0""#, r#"target="0,0,5""#);
    scene_fails(&format!("{camera}{SKY}"), &["lookat", "same point"]);
}

#[test]
fn scenes_that_cannot_make_a_picture() {
    scene_fails(&format!("{CAMERA}{BALL}"), &["s.xml", "no light"]);
    scene_fails(&format!("{SKY}{BALL}"), &["s.xml", "no camera"]);
    scene_fails("", &["s.xml"]);
    scene_fails(
        &format!("{CAMERA}{SKY}<shape type=\"sphere\"><float name=\"radius\" value=\"0\"/></shape>"),
        &["radius"],
    );
    // A light without area is none.
    let flat = b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n";
    let shape = r#"<shape type="obj"><string name="filename" value="flat.obj"/><emitter type="area"/></shape>"#;
    let dir = folder(&[("s.xml", scene(&format!("{CAMERA}{shape}")).as_bytes()), ("flat.obj", flat)]);
    fails(dir.path(), &["s.xml", "-o", "o.exr"], 1, &["s.xml", "no light"]);
}

#[test]
fn sizes_beyond_reason() {
    let film = |w: &str| CAMERA.replacen("value=\"8\"", &format!("value=\"{w}\""), 1);
    for width in ["0", "-8", "2000000000", "99999999999999999999"] {
        scene_fails(&format!("{}{SKY}{BALL}", film(width)), &["s.xml:", "width"]);
    }
    scene_fails(&format!("{}{SKY}{BALL}", CAMERA.replace("value=\"8\"", "value=\"65536\"")), &["65536"]);
    let dir = folder(&[("s.xml", scene(&format!("{CAMERA}{SKY}{BALL}")).as_bytes())]);
    for size in ["0x5", "7", "1000000x1000000", "99999999999999999999x1", "axb"] {
        fails(dir.path(), &["s.xml", "-o", "o.exr", "--size", size], 2, &["--size"]);
    }
}

#[test]
fn truncated_files_and_counts_that_lie() {
    let header = |vertices: u64| {
        format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\n\
             property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    mesh_fails("cut.ply", header(3).as_bytes(), &["3"]);
    mesh_fails("bomb.ply", header(4_000_000_000).as_bytes(), &["4000000000"]);
    mesh_fails("cut.obj", b"v 0 0 0\nv 1 0 0\nf 1 2 99\n", &["line 3", "99"]);
    mesh_fails("cut.serialized", b"\x1c\x04\x04\x00x\x9c\x01\x02", &[]);
    let glb = b"glTF\x02\0\0\0\xff\xff\xff\xff\x10\0\0\0JSON{}";
    let dir = folder(&[("cut.glb", glb), ("cut.xml", &scene(CAMERA).as_bytes()[..60])]);
    fails(dir.path(), &["cut.glb", "-o", "o.exr"], 1, &["cut.glb", "truncated"]);
    fails(dir.path(), &["cut.xml", "-o", "o.exr"], 1, &["cut.xml"]);
    let medium = r#"<medium type="heterogeneous" name="interior"><volume type="gridvolume" name="sigma_t">
        <string name="filename" value="cut.vol"/></volume></medium>"#;
    let mut grid = b"VOL\x03\x01\0\0\0".to_vec();
    grid.extend([i32::MAX, i32::MAX, i32::MAX, 3].iter().flat_map(|v| v.to_le_bytes()));
    grid.extend([0; 24]);
    let body = format!("{CAMERA}{SKY}<shape type=\"sphere\">{medium}</shape>");
    let dir = folder(&[("s.xml", scene(&body).as_bytes()), ("cut.vol", &grid)]);
    fails(dir.path(), &["s.xml", "-o", "o.exr"], 1, &["s.xml:", "cut.vol", "truncated"]);
}

/// What is not a number is left out with a warning, and does not get into the picture.
#[test]
fn vertices_that_are_no_numbers() {
    let shape = r#"<shape type="obj"><string name="filename" value="nan.obj"/></shape>"#;
    let mesh = b"v nan 0 0\nv 1 0 0\nv 0 1 0\nv -1 0 0\nf 1 2 3\nf 2 3 4\n";
    let dir = folder(&[("s.xml", scene(&format!("{CAMERA}{SKY}{shape}")).as_bytes()), ("nan.obj", mesh)]);
    let run = translume(dir.path(), &["render", "s.xml", "-o", "o.exr", "--spp", "4"]);
    assert!(run.stderr.contains("nan.obj") && run.stderr.contains("not finite"), "{}", run.stderr);
    run.ok();
    let planes = translume_image::read_exr_channels(&dir.path().join("o.exr"), 0).unwrap().planes;
    assert!(planes.iter().all(|(_, values)| values.iter().all(|v| v.is_finite())));
}

#[test]
fn checkpoints_of_something_else() {
    let other = scene(&format!("{CAMERA}{SKY}"));
    let dir = folder(&[("s.xml", scene(&format!("{CAMERA}{SKY}{BALL}")).as_bytes()), ("other.xml", other.as_bytes())]);
    let go_on = |scene: &'static str, state: &'static str, more: &[&'static str]| -> Vec<&str> {
        [&[scene, "-o", "o.exr", "--resume", "--checkpoint", state, "--spp", "4"], more].concat()
    };
    translume(dir.path(), &["render", "s.xml", "-o", "o.exr", "--spp", "2", "--checkpoint", "c.tlck", "--quiet"]).ok();
    let state = std::fs::read(dir.path().join("c.tlck")).unwrap();
    let mut newer = state.clone();
    newer[8] = 9;
    for (bytes, mark) in [
        (&b"hello"[..], "no checkpoint"),
        (&[7; 200], "no checkpoint"),
        (&state[..100], "cut off"),
        (&newer, "version 9"),
    ] {
        std::fs::write(dir.path().join("bad.tlck"), bytes).unwrap();
        fails(dir.path(), &go_on("s.xml", "bad.tlck", &[]), 1, &["bad.tlck", mark]);
    }
    fails(dir.path(), &go_on("s.xml", "c.tlck", &["--seed", "5"]), 1, &["c.tlck", "seed 0"]);
    fails(dir.path(), &go_on("s.xml", "c.tlck", &["--size", "16x16"]), 1, &["c.tlck", "8 × 8"]);
    fails(dir.path(), &go_on("s.xml", "c.tlck", &["--aov", "depth"]), 1, &["c.tlck", "feature images"]);
    fails(dir.path(), &go_on("other.xml", "c.tlck", &[]), 1, &["c.tlck", "another scene"]);
    fails(dir.path(), &["s.xml", "-o", "o.exr", "--resume"], 2, &["--checkpoint"]);
}

/// Known before the work begins, not after hours of it.
#[test]
fn outputs_that_cannot_be_written() {
    let dir = folder(&[("s.xml", scene(&format!("{CAMERA}{SKY}{BALL}")).as_bytes())]);
    std::fs::create_dir(dir.path().join("folder.exr")).unwrap();
    let with = |more: &[&'static str]| -> Vec<&str> { [&["s.xml", "--time", "9h"], more].concat() };
    fails(dir.path(), &with(&["-o", "gone/o.exr"]), 1, &["gone/o.exr"]);
    fails(dir.path(), &with(&["-o", "folder.exr"]), 1, &["folder.exr"]);
    fails(dir.path(), &with(&["-o", "o.exr", "--preview", "gone/p.png"]), 1, &["gone/p.png"]);
    fails(dir.path(), &with(&["-o", "o.exr", "--checkpoint", "gone/c.tlck"]), 1, &["gone/c.tlck"]);
    fails(dir.path(), &with(&["-o", "o.png"]), 2, &["o.png", ".exr"]);
    fails(dir.path(), &with(&["-o", "o.exr", "--preview", "p.gif"]), 2, &["p.gif", ".png"]);
}

#[test]
fn names_that_nobody_knows() {
    let dir = folder(&[("s.xml", scene(&format!("{CAMERA}{SKY}{BALL}")).as_bytes())]);
    for (option, value) in [
        ("--integrator", "metropolis"),
        ("--aov", "depht"),
        ("--spp", "0"),
        ("--time", "0s"),
        ("--time", "soon"),
        ("--max-depth", "deep"),
        ("--set", "nothing"),
        ("--nonsense", "1"),
    ] {
        fails(dir.path(), &["s.xml", "-o", "o.exr", option, value], 2, &[option]);
    }
    fails(dir.path(), &["s.xml"], 2, &["--output"]);
    scene_fails(&format!("{CAMERA}{SKY}<shape type=\"teapot\"/>"), &["s.xml:", "teapot"]);
}
