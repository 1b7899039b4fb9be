//! Virtual captures, planar models and reports through the binary.

mod common;

use common::translume;
use serde_json::Value;
use std::fs;
use std::path::Path;
use tempfile::tempdir;

/// Nine laser positions on marble, coarse.
const SMALL: [&str; 10] = ["scatter", "simulate", "marble", "--spots", "3", "--pixels", "24", "--spacing", "2", "-o"];

fn simulate(dir: &Path, name: &str, more: &[&str]) -> common::Run {
    translume(dir, &[&SMALL[..], &[name], more].concat())
}

fn json(dir: &Path, arguments: &[&str]) -> Value {
    serde_json::from_str(&translume(dir, &[arguments, &["--json"]].concat()).ok()).unwrap()
}

#[test]
fn a_capture_becomes_a_model_and_a_report() {
    let dir = tempdir().unwrap();
    let dir = dir.path();
    simulate(dir, "a b", &["--photons", "12000"]).ok();
    let rig: Value = serde_json::from_str(&fs::read_to_string(dir.join("a b/rig.json")).unwrap()).unwrap();
    assert_eq!((&rig["provenance"]["simulated"]["medium"], &rig["units"]), (&"marble".into(), &"mm".into()));
    assert_eq!(rig["laser"]["hits_mm"].as_array().unwrap().len(), 9);
    let fitted = json(dir, &["scatter", "fit", "a b", "--segments", "4", "-o", "model"]);
    assert_eq!((&fitted["points"], &fitted["fitted"]), (&9.into(), &9.into()));
    let told = json(dir, &["scatter", "report", "a b", "model", "-o", "report"]);
    let models = told["models"].as_array().unwrap();
    let green = |name: &str| models.iter().find(|m| m["model"] == name).unwrap()["ln_e"][1].as_f64().unwrap();
    // The same fit twice: once read from its files, once made for the table.
    assert!((green("this model") / green("4 directions") - 1.0).abs() < 1e-3, "{told}");
    assert!(green("4 directions") < green("isotropic") && green("isotropic").is_finite(), "{told}");
    for file in ["index.html", "errors.csv", "measured.png", "errors-dipole.png"] {
        assert!(dir.join("report").join(file).exists(), "{file}");
    }

    // The same seed gives the same frames for any number of threads; another one does not.
    let few = ["--photons", "300"];
    simulate(dir, "few", &few).ok();
    simulate(dir, "one", &[&few[..], &["--threads", "1"]].concat()).ok();
    simulate(dir, "other", &[&few[..], &["--seed", "2"]].concat()).ok();
    let chunk = |name: &str| fs::read(dir.join(name).join("frames/c/0/4/1/0/0")).unwrap();
    assert!(chunk("few") == chunk("one") && chunk("one") != chunk("other"));
    // An existing folder is not touched.
    assert!(simulate(dir, "one", &[]).error(1).contains("it exists"));
}

#[test]
fn each_rig_error_changes_what_it_should() {
    let dir = tempdir().unwrap();
    let dir = dir.path();
    let tiny =
        |name: &str, more: &[&str]| simulate(dir, name, &[&["--noise-free", "--photons", "500"], more].concat()).ok();
    tiny("plain", &[]);
    let read = |name: &str, file: &str| fs::read(dir.join(name).join(file)).unwrap();
    for (switch, value, frames, mesh) in [
        ("--drift", "0.1", true, false),
        ("--misregistration", "1", true, false),
        ("--peak-shift", "0.5", true, false),
        ("--geometry-error", "0.1", false, true),
    ] {
        let name = &switch[2..];
        tiny(name, &[switch, value]);
        let chunk = "frames/c/0/4/1/0/0";
        assert_eq!(read("plain", chunk) != read(name, chunk), frames, "{switch}");
        assert_eq!(read("plain", "mesh.ply") != read(name, "mesh.ply"), mesh, "{switch}");
    }
}

#[test]
fn damaged_captures_are_named() {
    let dir = tempdir().unwrap();
    let dir = dir.path();
    simulate(dir, "c", &["--photons", "1000"]).ok();
    let fit = |what: &str| translume(dir, &["scatter", "fit", "c", "-o", what]);
    let edit = |file: &str, from: &str, to: &str, says: &str| {
        let path = dir.join("c").join(file);
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{file}: {from}");
        fs::write(&path, text.replacen(from, to, 1)).unwrap();
        let error = fit("m").error(1);
        assert!(error.contains(says), "{from} → {to}: {error}");
        fs::write(&path, text).unwrap();
    };
    edit("rig.json", "\"version\": \"1.0\"", "\"version\": \"9.0\"", "version 9.0");
    edit("rig.json", "\"units\": \"mm\"", "\"units\": \"m\"", "not a translume capture in mm");
    edit("rig.json", "\"mesh.ply\"", "\"../mesh.ply\"", "inside the capture's folder");
    edit("rig.json", "\"name\": \"red\",", "", "name");
    edit("rig.json", "\"width\": 24", "\"width\": 25", "24 × 24 pixels");
    edit("rig.json", "\"hits_mm\": [", "\"hits_mm\": [[0, 0, 0],", "10 laser positions");
    edit("frames/zarr.json", "float32", "int8", "float32 and float16");
    edit("frames/zarr.json", "gzip", "zstd", "codecs");
    edit("frames/zarr.json", "24", "4000000000", "chunks are not one frame each");
    assert!(!dir.join("m").exists());

    // A missing frame costs its laser position; a truncated one is an error.
    let chunk = dir.join("c/frames/c/0/4/1/0/0");
    let bytes = fs::read(&chunk).unwrap();
    fs::write(&chunk, &bytes[..bytes.len() / 2]).unwrap();
    assert!(fit("m").error(1).contains("truncated"));
    fs::remove_file(&chunk).unwrap();
    let run = fit("m");
    assert!(run.stderr.contains("1 frames are missing"), "{}", run.stderr);
    run.ok();
    // The model of other positions is refused.
    fs::write(&chunk, &bytes).unwrap();
    let error = translume(dir, &["scatter", "report", "c", "m", "-o", "r"]).error(1);
    assert!(error.contains("not fitted to this capture"), "{error}");

    // A surface that is not flat.
    let mesh = "v 0 0 0\nv 5 0 0\nv 0 5 3\nf 1 2 3\n";
    fs::write(dir.join("c/mesh.obj"), mesh).unwrap();
    edit("rig.json", "\"mesh.ply\"", "\"mesh.obj\"", "flat sample");
    for wrong in [&["--spots", "0"][..], &["--eta", "0.5"], &["--drift", "-1"], &["--beam", "0"]] {
        assert_eq!(simulate(dir, "w", wrong).status, 2, "{wrong:?}");
    }
}
