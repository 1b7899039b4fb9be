//! Outputs through the command line: nothing that is read is lost, nothing but a plain file is replaced, and runs that are
//! told to end leave nothing half.
#![cfg(unix)]

mod common;

use common::translume;
use std::fs;
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt, symlink};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::tempdir;

/// A picture of 4 × 4 pixels.
fn picture(path: &Path) {
    image::RgbImage::from_fn(4, 4, |x, y| image::Rgb([40 * x as u8, 40 * y as u8, 99])).save(path).unwrap();
}

const SCENE: &str = r#"<scene version="3.0.0"><sensor type="perspective"><film type="hdrfilm">
    <integer name="width" value="16"/><integer name="height" value="16"/></film></sensor>
    <emitter type="constant"/></scene>"#;

#[test]
fn an_output_that_is_an_input_is_refused_by_any_name() {
    let dir = tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    picture(&at("a.png"));
    picture(&at("b.png"));
    fs::create_dir(at("sub")).unwrap();
    symlink("a.png", at("link.png")).unwrap();
    fs::hard_link(at("a.png"), at("hard.png")).unwrap();
    fs::write(at("s.exr"), SCENE).unwrap();
    fs::write(at("m.ply"), "ply\nformat ascii 1.0\nelement vertex 0\nend_header\n").unwrap();
    let before = fs::read(at("a.png")).unwrap();
    for output in ["a.png", "./a.png", "sub/../a.png", "link.png", "hard.png"] {
        let error = translume(dir.path(), &["image", "convert", "a.png", "-o", output]).error(2);
        assert!(error.contains("also read"), "{error}");
    }
    let refused = |args: &[&str]| {
        let error = translume(dir.path(), args).error(2);
        assert!(error.contains("also read"), "{args:?}: {error}");
    };
    refused(&["image", "tonemap", "a.png", "-o", "a.png"]);
    refused(&["hdr", "a.png", "b.png", "--ev", "0,2", "-o", "x.exr", "--preview", "b.png"]);
    refused(&["hdr", "a.png", "b.png", "--ev", "0,2", "-o", "x.exr", "--mask", "link.png"]);
    refused(&["render", "s.exr", "-o", "s.exr"]);
    refused(&["render", "s.exr", "-o", "x.exr", "--checkpoint", "s.exr"]);
    // What the scene reads counts too.
    let sky = SCENE.replace("constant\"/>", "envmap\"><string name=\"filename\" value=\"sub/../a.png\"/></emitter>");
    fs::write(at("sky.xml"), sky).unwrap();
    symlink("a.png", at("sky.exr")).unwrap();
    for args in [&["-o", "sky.exr"][..], &["-o", "x.exr", "--preview", "hard.png"]] {
        let run = translume(dir.path(), &[&["render", "sky.xml"], args].concat());
        assert!(run.status == 2 && run.stderr.contains("also read"), "{args:?}: {}", run.stderr);
    }
    refused(&["mesh", "convert", "m.ply", "-o", "m.ply"]);
    refused(&["merge", "s.exr", "-o", "s.exr"]);
    let error = translume(dir.path(), &["image", "info", "a.png", "--log-file", "a.png"]).error(2);
    assert!(error.contains("no log file"), "{error}");
    assert_eq!(fs::read(at("a.png")).unwrap(), before);
    // Two outputs of one name are refused too; and the healthy twin is silent.
    let error = translume(dir.path(), &["render", "s.exr", "-o", "x.exr", "--denoise", "./x.exr"]).error(2);
    assert!(error.contains("two outputs"), "{error}");
    let run = translume(dir.path(), &["image", "convert", "a.png", "-o", "c.png"]);
    assert_eq!(run.stderr, "");
    assert_eq!(run.ok(), "c.png: 4 × 4 pixels\n");
}

#[test]
fn the_name_says_the_format_or_nothing_is_written() {
    let dir = tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    picture(&at("a.png"));
    picture(&at("b.png"));
    let hdr = |more: &[&str]| {
        let args = ["hdr", "a.png", "b.png", "--ev", "0,2", "--preset", "tripod"];
        translume(dir.path(), &[&args[..], more].concat())
    };
    for (name, magic) in [("o.exr", &b"\x76\x2f\x31\x01"[..]), ("o.hdr", b"#?"), ("o.pfm", b"PF"), ("o.tif", b"II")] {
        hdr(&["-o", name]).ok();
        assert!(fs::read(at(name)).unwrap().starts_with(magic), "{name}");
    }
    for (name, magic) in [("p.png", &b"\x89PNG"[..]), ("p.jpg", b"\xff\xd8"), ("p.tif", b"II")] {
        hdr(&["-o", "o.exr", "--preview", name]).ok();
        assert!(fs::read(at(name)).unwrap().starts_with(magic), "{name}");
    }
    for args in [
        &["-o", "x.png"][..],
        &["-o", "x.jpg"],
        &["-o", "x.exr", "--preview", "x.bmp"],
        &["-o", "x.exr", "--mask", "x.jpg"],
    ] {
        assert!(hdr(args).error(2).contains("must be named ."), "{args:?}");
    }
    assert!(!at("x.exr").exists());
    for args in [&["field", "compress", ".", "-o", "x.ptm"][..], &["image", "convert", "a.png", "-o", "x"]] {
        assert!(translume(dir.path(), args).error(2).contains("must be named ."), "{args:?}");
    }
    // A field has one format: a name that says none will do.
    let error = translume(dir.path(), &["field", "compress", ".", "-o", "field.out"]).error(1);
    assert!(!error.contains("field.out"), "{error}");
    assert!(translume(dir.path(), &["image", "convert", "a.png", "-o", "new.exr/"]).error(1).contains("folder"));
    // A name without an ending is a folder to `hdr`, with or without a slash, whether it is there or not.
    for name in ["one", "two/", "one/"] {
        let run = hdr(&["-o", name]);
        assert!(run.stdout.starts_with(&format!("{}/", name.trim_end_matches('/'))), "{}{}", run.stdout, run.stderr);
        assert_eq!(fs::read_dir(at(name)).unwrap().count(), 1);
    }
}

#[test]
fn what_is_no_plain_file_is_streamed_into_or_refused() {
    let dir = tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    picture(&at("a.png"));
    let convert = |output: &str| translume(dir.path(), &["image", "convert", "a.png", "-o", output]);
    convert("plain.exr").ok();
    let plain = fs::read(at("plain.exr")).unwrap();
    // Standard output has the bytes and nothing else.
    let piped = Command::new(env!("CARGO_BIN_EXE_translume"))
        .args(["image", "convert", "a.png", "-o", "/dev/stdout", "--no-provenance"])
        .current_dir(dir.path())
        .output()
        .unwrap();
    assert!(
        piped.status.success() && piped.stdout.starts_with(&plain[..4]),
        "{}",
        String::from_utf8_lossy(&piped.stderr)
    );
    assert!(image::load_from_memory(&piped.stdout).is_err(), "an OpenEXR file, which this decoder does not have");
    let error = translume(dir.path(), &["image", "convert", "a.png", "-o", "/dev/stdout", "--json"]).error(2);
    assert!(error.contains("--json"), "{error}");
    let hdr = ["hdr", "a.png", "a.png", "--ev", "0,2", "-o", "/dev/stdout", "--preview", "/dev/stdout"];
    assert!(translume(dir.path(), &hdr).error(2).contains("two outputs"));
    convert("/dev/null").ok();
    assert!(fs::metadata("/dev/null").unwrap().file_type().is_char_device());
    symlink("/dev/zero", at("zero.exr")).unwrap();
    assert!(convert("zero.exr").error(1).contains("device"));
    // A FIFO gets the file and stays one.
    let fifo = at("fifo");
    assert!(Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    let reader = {
        let fifo = fifo.clone();
        std::thread::spawn(move || fs::read(fifo).unwrap())
    };
    convert("fifo").ok();
    assert!(reader.join().unwrap().starts_with(&plain[..4]));
    assert!(fs::metadata(&fifo).unwrap().file_type().is_fifo());
    // Links stay, modes stay.
    fs::write(at("target.exr"), "old").unwrap();
    fs::set_permissions(at("target.exr"), PermissionsExt::from_mode(0o640)).unwrap();
    symlink("target.exr", at("link.exr")).unwrap();
    convert("link.exr").ok();
    assert!(fs::symlink_metadata(at("link.exr")).unwrap().is_symlink());
    assert!(fs::read(at("target.exr")).unwrap().starts_with(&plain[..4]));
    assert_eq!(fs::metadata(at("target.exr")).unwrap().mode() & 0o777, 0o640);
}

/// Starts the program, waits until `ready`, sends `signal`, and returns the exit status and what it said.
fn interrupted(dir: &Path, args: &[&str], signal: &str, ready: impl Fn() -> bool) -> (Option<i32>, String) {
    let child = Command::new(env!("CARGO_BIN_EXE_translume"))
        .args(args)
        .current_dir(dir)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let begun = Instant::now();
    while !ready() && begun.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(ready(), "{args:?} did not begin");
    assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn interrupted_runs_keep_what_there_is_and_say_so() {
    let dir = tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    fs::write(at("s.xml"), SCENE).unwrap();
    for (signal, status) in [("-INT", 130), ("-TERM", 143)] {
        let args = ["render", "s.xml", "-o", "o.exr", "--spp", "1000000000", "--preview", "p.png"];
        let (code, said) = interrupted(dir.path(), &args, signal, || at("p.png").exists());
        assert_eq!(code, Some(status), "{said}");
        assert!(at("o.exr").exists() && said.contains("interrupted"), "{said}");
        fs::remove_file(at("o.exr")).unwrap();
        fs::remove_file(at("p.png")).unwrap();
    }
    // A time that is reached is what was asked for.
    translume(dir.path(), &["render", "s.xml", "-o", "o.exr", "--time", "0.2s"]).ok();
}

#[test]
fn an_interrupted_capture_leaves_nothing() {
    let dir = tempdir().unwrap();
    let hidden = || {
        fs::read_dir(dir.path()).unwrap().flatten().any(|e| e.file_name().to_string_lossy().starts_with(".translume-"))
    };
    let args = ["scatter", "simulate", "marble", "-o", "capture", "--photons", "100000000", "--spots", "8"];
    let (code, said) = interrupted(dir.path(), &args, "-TERM", hidden);
    assert_eq!(code, Some(143), "{said}");
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn written_files_name_no_folders() {
    let dir = tempdir().unwrap();
    fs::create_dir(dir.path().join("secret")).unwrap();
    picture(&dir.path().join("secret/a.png"));
    let provenance = |name: &str, more: &[&str]| {
        let args = [&["image", "convert", "secret/a.png", "-o", name][..], more].concat();
        translume(dir.path(), &args).ok();
        String::from_utf8_lossy(&fs::read(dir.path().join(name)).unwrap()).into_owned()
    };
    let with = provenance("a.exr", &[]);
    assert!(with.contains("image convert a.png") && !with.contains("secret"));
    assert!(!provenance("b.exr", &["--no-provenance"]).contains("a.png"));
}

#[test]
fn renders_of_two_scenes_are_not_averaged() {
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("a.xml"), SCENE).unwrap();
    fs::write(
        dir.path().join("b.xml"),
        SCENE.replace("constant\"/>", "constant\"><rgb name=\"radiance\" value=\"9\"/></emitter>"),
    )
    .unwrap();
    let render = |scene: &str, out: &str, more: &[&str]| {
        let args = [&["render", scene, "-o", out, "--spp", "2", "-q"][..], more].concat();
        translume(dir.path(), &args).ok();
    };
    render("a.xml", "a1.exr", &["--seed", "1"]);
    render("a.xml", "a2.exr", &["--seed", "2", "--integrator", "bdpt"]);
    render("b.xml", "b.exr", &["--seed", "3"]);
    // The same seed is no matter where the scenes differ already: one line says what is wrong.
    render("a.xml", "short.exr", &["--seed", "1", "--max-depth", "1"]);
    let merge = |files: &[&str]| translume(dir.path(), &[&["merge"], files, &["-o", "m.exr"]].concat());
    for other in ["b.exr", "short.exr"] {
        let error = merge(&["a1.exr", other]).error(1);
        assert!(error.contains(other) && error.contains("another scene"), "{error}");
    }
    let run = merge(&["a1.exr", "a2.exr"]);
    assert_eq!(run.stderr, "", "the healthy twin is silent");
    run.ok();
    // What was merged still knows what it is of.
    let error = translume(dir.path(), &["merge", "m.exr", "b.exr", "-o", "n.exr"]).error(1);
    assert!(error.contains("b.exr"), "{error}");
}
