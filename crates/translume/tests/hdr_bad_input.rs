//! `translume hdr` on what it cannot use: one line that names the file, the right status, nothing left behind.

mod common;

use common::bracket::{self, EXPOSURES, SECS, camera, save, shots};
use common::translume;
use std::fs;
use std::path::Path;
use tempfile::{TempDir, tempdir};
use translume_hdr::simulate::{Camera, Depth, Pose};
use translume_image::{Samples, write_png8};

/// A folder with the usual bracket.
fn folder() -> TempDir {
    let dir = tempdir().unwrap();
    bracket::usual(dir.path());
    dir
}

/// All names below a folder.
fn listing(dir: &Path) -> Vec<String> {
    let mut names = Vec::new();
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        names.push(path.display().to_string());
        if path.is_dir() {
            names.extend(listing(&path));
        }
    }
    names.sort();
    names
}

/// Runs `hdr` with these arguments, which must fail with `status`, a line that has `marks` in it, and no new file.
#[track_caller]
fn fails(dir: &Path, arguments: &[&str], status: i32, marks: &[&str]) {
    let before = listing(dir);
    let arguments: Vec<&str> = ["hdr"].iter().chain(arguments).copied().collect();
    let error = translume(dir, &arguments).error(status);
    for mark in marks {
        assert!(error.contains(mark), "'{mark}' is not in: {error}");
    }
    assert_eq!(before, listing(dir), "{error}");
}

#[test]
fn one_picture() {
    let dir = folder();
    fails(dir.path(), &["a.png", "--exposures=1", "-o", "out.exr"], 1, &["a.png", "two or more"]);
    fails(dir.path(), &["-o", "out.exr"], 2, &["IMG"]);
}

#[test]
fn different_sizes() {
    let dir = folder();
    let small = shots(&Camera { size: (100, 80), ..camera() }, &[Pose::default()], &[1.0]);
    save(&dir.path().join("small.png"), &small[0]);
    let size = ["small.png", "100 × 80", "a.png", "240 × 176"];
    fails(dir.path(), &["a.png", "b.png", "small.png", EXPOSURES, "-o", "out.exr"], 1, &size);
}

#[test]
fn exposures_missing_equal_or_miscounted() {
    let dir = folder();
    let run = |more: &[&str], status, marks: &[&str]| {
        fails(dir.path(), &[&["a.png", "b.png", "c.png", "-o", "out.exr"], more].concat(), status, marks);
    };
    run(&[], 1, &["a.png", "no exposure time", "--exposures", "--list"]);
    run(&["--exposures=1/15,1/15,1/15"], 1, &["same exposure"]);
    run(&["--exposures=1/15,1/4"], 2, &["--exposures", "2", "3"]);
    run(&["--ev=-2,0"], 2, &["--ev", "2", "3"]);
    for bad in ["0", "-1", "soon", "1/0", "nan", "1e999"] {
        run(&[&format!("--exposures=1,2,{bad}")], 2, &[bad]);
    }
    run(&["--ev=0,1,inf"], 2, &["--ev"]);
    run(&["--ev=0,1,5000"], 2, &["--ev"]);
    run(&["--ev=0,1,two"], 2, &["two"]);
    run(&["--ev=0,1,2", "--exposures=1,2,3"], 2, &["--ev", "--exposures"]);
}

#[test]
fn lists_that_do_not_help() {
    let dir = folder();
    let run = |marks: &[&str]| {
        fails(dir.path(), &["a.png", "b.png", "c.png", "--list", "times.txt", "-o", "out.exr"], 1, marks);
    };
    run(&["times.txt"]);
    for (text, mark) in [
        ("", "seconds"),
        ("a.png 1/60\nb.png soon\nc.png 1\n", "line 2"),
        ("a.png 1/60\nb.png 1/15\n", "c.png"),
        ("a.png 1/60\nb.png -1\nc.png 2\n", "line 2"),
        ("\u{0}\u{1}\u{2}", "line 1"),
    ] {
        fs::write(dir.path().join("times.txt"), text).unwrap();
        run(&[mark]);
    }
    fs::remove_file(dir.path().join("times.txt")).unwrap();
    fs::create_dir(dir.path().join("times.txt")).unwrap();
    run(&["times.txt"]);
}

#[test]
fn files_that_are_missing_damaged_or_no_pictures() {
    let dir = folder();
    let run = |file: &str| {
        fails(dir.path(), &["a.png", file, "c.png", EXPOSURES, "-o", "out.exr"], 1, &[file]);
    };
    run("none.png");
    fs::write(dir.path().join("text.jpg"), "not a picture").unwrap();
    run("text.jpg");
    fs::write(dir.path().join("empty.png"), "").unwrap();
    run("empty.png");
    let linear = shots(&Camera { depth: Depth::Linear, ..camera() }, &[Pose::default()], &[1.0]);
    save(&dir.path().join("whole.exr"), &linear[0]);
    for whole in ["b.png", "whole.exr"] {
        let bytes = fs::read(dir.path().join(whole)).unwrap();
        for share in [1, 3, 9] {
            let cut = format!("cut{share}-{whole}");
            fs::write(dir.path().join(&cut), &bytes[..bytes.len() * share / 10]).unwrap();
            run(&cut);
        }
    }
}

#[test]
fn headers_that_claim_more_than_the_file_holds() {
    let dir = folder();
    let run = |file: &str| {
        fails(dir.path(), &[file, file, EXPOSURES_OF_TWO, "-o", "out.exr"], 1, &[file]);
    };
    for side in [12_000u32, 400_000, u32::MAX] {
        let mut png = fs::read(dir.path().join("a.png")).unwrap();
        png[16..20].copy_from_slice(&side.to_be_bytes());
        png[20..24].copy_from_slice(&side.to_be_bytes());
        let crc = crc32(&png[12..29]);
        png[29..33].copy_from_slice(&crc.to_be_bytes());
        fs::write(dir.path().join("huge.png"), png).unwrap();
        run("huge.png");
        for (file, text) in [
            ("huge.pfm", format!("PF\n{side} {side}\n-1.0\n")),
            ("huge.hdr", format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {side} +X {side}\n")),
        ] {
            fs::write(dir.path().join(file), text).unwrap();
            run(file);
        }
    }
    let linear = shots(&Camera { depth: Depth::Linear, ..camera() }, &[Pose::default()], &[1.0]);
    let exr = dir.path().join("huge.exr");
    save(&exr, &linear[0]);
    let mut bytes = fs::read(&exr).unwrap();
    for window in ["dataWindow\0box2i\0", "displayWindow\0box2i\0"] {
        let at = bytes.windows(window.len()).position(|w| w == window.as_bytes()).unwrap() + window.len() + 4;
        bytes[at + 8..at + 12].copy_from_slice(&200_000i32.to_le_bytes());
        bytes[at + 12..at + 16].copy_from_slice(&200_000i32.to_le_bytes());
    }
    fs::write(&exr, bytes).unwrap();
    run("huge.exr");
}

const EXPOSURES_OF_TWO: &str = "--exposures=1/15,1/4";

/// The checksum of PNG chunks.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, _| if crc & 1 == 1 { (crc >> 1) ^ 0xedb8_8320 } else { crc >> 1 };
    !bytes.iter().fold(u32::MAX, |crc, b| (0..8).fold(crc ^ u32::from(*b), step))
}

#[test]
fn nothing_but_white_or_black() {
    let dir = tempdir().unwrap();
    for (name, level) in [("white", 255u8), ("black", 0)] {
        for k in 0..2 {
            write_png8(&dir.path().join(format!("{name}{k}.png")), (64, 48), &vec![level; 3 * 64 * 48]).unwrap();
        }
        let files = [format!("{name}0.png"), format!("{name}1.png")];
        let arguments = [&files[0], &files[1], EXPOSURES_OF_TWO, "-o", "out.exr"];
        fails(dir.path(), &arguments, 1, &[name, "response", "--response"]);
    }
}

#[test]
fn values_that_are_not_finite() {
    let dir = tempdir().unwrap();
    let mut linear = shots(&Camera { depth: Depth::Linear, ..camera() }, &[Pose::default(); 2], &[1.0, 0.25]);
    save(&dir.path().join("good.exr"), &linear[1]);
    for (name, value) in [("nan.exr", f32::NAN), ("inf.exr", f32::INFINITY)] {
        let Samples::F32(v) = &mut linear[0].samples else { panic!("linear") };
        v[3 * (5 * 240 + 7)] = value;
        save(&dir.path().join(name), &linear[0]);
        fails(dir.path(), &["good.exr", name, EXPOSURES_OF_TWO, "-o", "out.exr"], 1, &[name, "(7, 5)"]);
    }
}

#[test]
fn linear_and_encoded_mixed() {
    let dir = folder();
    let linear = shots(&Camera { depth: Depth::Linear, ..camera() }, &[Pose::default()], &[1.0]);
    save(&dir.path().join("l.exr"), &linear[0]);
    fails(dir.path(), &["a.png", "l.exr", EXPOSURES_OF_TWO, "-o", "out.exr"], 1, &["l.exr", "mixed"]);
}

#[test]
fn options_out_of_range() {
    let dir = folder();
    let run = |more: &[&str], status, marks: &[&str]| {
        fails(dir.path(), &[&["a.png", "b.png", "c.png", EXPOSURES, "-o", "out.exr"], more].concat(), status, marks);
    };
    run(&["--anchor", "3"], 2, &["--anchor", "3 pictures"]);
    run(&["--anchor=-1"], 2, &["--anchor"]);
    run(&["--calibrate=0"], 2, &["--calibrate"]);
    run(&["--full-well=0"], 2, &["--full-well"]);
    run(&["--preset", "boat"], 2, &["tripod"]);
    run(&["--group", "2"], 1, &["--group"]);
    run(&["--group", "0"], 1, &["--group"]);
}

#[test]
fn responses_that_are_none() {
    let dir = folder();
    let run = |marks: &[&str]| {
        let arguments = ["a.png", "b.png", "c.png", EXPOSURES, "--response", "curve.json", "-o", "out.exr"];
        fails(dir.path(), &arguments, 1, marks);
    };
    run(&["curve.json"]);
    let rising: Vec<f32> = (0..256).map(|i| i as f32 / 100.0).collect();
    let falling: Vec<f32> = rising.iter().rev().copied().collect();
    let json = |version: u32, curve: &[f32]| {
        serde_json::json!({ "version": version, "log_exposure": [curve, curve, curve] }).to_string()
    };
    for (text, mark) in [
        ("{".to_owned(), "JSON"),
        ("[1, 2]".to_owned(), "version"),
        (json(2, &rising), "version 2"),
        (json(1, &rising[..255]), "256"),
        (json(1, &falling), "increasing"),
        (r#"{"version": 1, "log_exposure": "steep"}"#.to_owned(), "log_exposure"),
        (r#"{"version": 1}"#.to_owned(), "log_exposure"),
    ] {
        fs::write(dir.path().join("curve.json"), text).unwrap();
        run(&["curve.json", mark]);
    }
}

#[test]
fn outputs_that_cannot_be_written() {
    let dir = folder();
    let all = ["a.png", "b.png", "c.png", EXPOSURES];
    let run = |more: &[&str], mark| fails(dir.path(), &[&all[..], more].concat(), 1, &[mark]);
    run(&["-o", "no/such/out.exr"], "no/such");
    run(&["-o", "out.exr", "--preview", "no/p.png"], "no/p.png");
    run(&["-o", "out.exr", "--mask", "no/m.png"], "no/m.png");
    run(&["-o", "out.exr", "--save-response", "no/c.json"], "no/c.json");
    fs::write(dir.path().join("taken"), "").unwrap();
    run(&["-o", "out.exr", "--report", "taken"], "taken");
    run(&["-o", "out.exr", "--fields", "taken/fields"], "taken/fields");
}

#[test]
fn a_broken_set_does_not_stop_a_batch() {
    let dir = tempdir().unwrap();
    let shoot = dir.path().join("shoot");
    fs::create_dir(&shoot).unwrap();
    for (k, codes) in shots(&camera(), &bracket::POSES, &SECS).iter().enumerate() {
        save(&shoot.join(format!("1-{k}.png")), codes);
        save(&shoot.join(format!("2-{k}.png")), codes);
    }
    fs::write(shoot.join("1-1.png"), "broken").unwrap();
    let run = translume(dir.path(), &["hdr", "shoot", "--group", "3", EXPOSURES, "-o", "merged", "--json"]);
    assert_eq!(run.status, 1, "{}", run.stderr);
    let error = run.stderr.lines().last().unwrap_or_default();
    assert!(error.contains("error: 1 of 2 brackets failed"), "{}", run.stderr);
    let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    assert_eq!(json["sets"].as_array().unwrap().len(), 1);
    assert!(json["failed"][0]["error"].as_str().unwrap().contains("1-1.png"), "{json}");
    assert_eq!(listing(&dir.path().join("merged")).len(), 1, "the whole one, and nothing of the other");
    assert!(dir.path().join("merged/shoot-002.exr").exists());
}

#[test]
fn folders_without_brackets() {
    let dir = tempdir().unwrap();
    fs::create_dir(dir.path().join("empty")).unwrap();
    fails(dir.path(), &["empty", "-o", "out"], 1, &["empty", "no pictures"]);
    fails(dir.path(), &["none", "-o", "out.exr"], 1, &["none"]);
}
