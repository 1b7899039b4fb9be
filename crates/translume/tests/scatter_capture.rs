//! Virtual captures, planar models and reports through the binary.

mod common;

use common::translume;
use serde_json::Value;
use std::fs;
use std::path::Path;
use tempfile::tempdir;

/// Nine laser positions on marble, coarse.
const SMALL: [&str; 12] =
    ["scatter", "simulate", "marble", "--spots", "3", "--pixels", "16", "--spacing", "2", "--thickness", "4", "-o"];

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
    simulate(dir, "a b", &["--photons", "1200"]).ok();
    let rig: Value = serde_json::from_str(&fs::read_to_string(dir.join("a b/rig.json")).unwrap()).unwrap();
    assert_eq!((&rig["provenance"]["simulated"]["medium"], &rig["units"]), (&"marble".into(), &"mm".into()));
    assert_eq!(rig["laser"]["hits_mm"].as_array().unwrap().len(), 9);
    let fitted = json(dir, &["scatter", "fit", "a b", "--segments", "4", "-o", "model"]);
    assert_eq!((&fitted["points"], &fitted["fitted"]), (&9.into(), &9.into()));
    // No lit point sends back more than it got: the mean of ∫ 2πr Σ c e^(dr) dr over its directions.
    let model: Value = serde_json::from_str(&fs::read_to_string(dir.join("model/model.json")).unwrap()).unwrap();
    let number = |v: &Value| v.as_f64().unwrap();
    for fit in model["points"].as_array().unwrap().iter().flat_map(|p| p["fall_off"].as_array().unwrap()) {
        let term = |(c, d): (&Value, &Value)| std::f64::consts::TAU * number(c) / number(d).powi(2);
        let total =
            |s: &Value| s["c"].as_array().unwrap().iter().zip(s["d"].as_array().unwrap()).map(term).sum::<f64>();
        let mean = fit["segments"].as_array().unwrap().iter().map(total).sum::<f64>() / 4.0;
        assert!(mean > 0.01 && mean <= 1.0 + 1e-9, "{mean}");
    }
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
    let few = ["--photons", "20"];
    simulate(dir, "few", &few).ok();
    simulate(dir, "one", &[&few[..], &["--threads", "1"]].concat()).ok();
    simulate(dir, "other", &[&few[..], &["--seed", "2"]].concat()).ok();
    let chunk = |name: &str| fs::read(dir.join(name).join("frames/c/0/4/1/0/0")).unwrap();
    assert!(chunk("few") == chunk("one") && chunk("one") != chunk("other"));
    // An existing folder is not touched.
    assert!(simulate(dir, "one", &[]).error(1).contains("it exists"));
}

#[test]
fn the_power_of_a_drifting_laser_is_found() {
    let dir = tempdir().unwrap();
    let dir = dir.path();
    // Homogeneous, so that the brightness of frames tells their true power.
    let common =
        ["scatter", "simulate", "homogeneous", "--spots", "4", "--spacing", "2", "--pixels", "20", "--field", "14"];
    translume(dir, &[&common[..], &["--photons", "600", "--drift", "0.2", "-o", "c"]].concat()).ok();
    translume(dir, &["scatter", "fit", "c", "--gains", "-o", "m"]).ok();
    let model: Value = serde_json::from_str(&fs::read_to_string(dir.join("m/model.json")).unwrap()).unwrap();
    let light = |position: usize, channel: usize| {
        let packed = fs::read(dir.join(format!("c/frames/c/0/{position}/{channel}/0/0"))).unwrap();
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(&packed[..]), &mut bytes).unwrap();
        bytes.as_chunks::<4>().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).sum::<f64>()
    };
    for channel in 0..3 {
        let (mut true_ln, mut found_ln) = (Vec::new(), Vec::new());
        for (i, frame) in model["frames"].as_array().unwrap().iter().enumerate() {
            true_ln.push(light(frame[1].as_u64().unwrap() as usize, channel).ln());
            found_ln.push(model["gains"][i][channel].as_f64().unwrap().ln());
        }
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        let (t, f) = (mean(&true_ln), mean(&found_ln));
        let square = |g: &dyn Fn(usize) -> f64| (0..true_ln.len()).map(|i| g(i).powi(2)).sum::<f64>();
        let (left, all) = (square(&|i| true_ln[i] - t - found_ln[i] + f), square(&|i| true_ln[i] - t));
        assert!(left < 0.25 * all, "{channel}: {left} of {all} are left");
    }
}

#[test]
fn each_rig_error_changes_what_it_should() {
    let dir = tempdir().unwrap();
    let dir = dir.path();
    let tiny =
        |name: &str, more: &[&str]| simulate(dir, name, &[&["--noise-free", "--photons", "20"], more].concat()).ok();
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
    simulate(dir, "c", &["--photons", "300"]).ok();
    let fit = |what: &str| translume(dir, &["scatter", "fit", "c", "--threshold", "0", "-o", what]);
    let edit = |file: &str, from: &str, to: &str, says: &str| {
        let path = dir.join("c").join(file);
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{file}: {from}");
        fs::write(&path, text.replacen(from, to, 1)).unwrap();
        let error = fit("m").error(1);
        assert!(error.contains(says), "{from} → {to}: {error}");
        fs::write(&path, text).unwrap();
    };
    edit("rig.json", "\"version\": \"1.1\"", "\"version\": \"9.0\"", "version 9.0");
    edit("rig.json", "\"units\": \"mm\"", "\"units\": \"m\"", "not a translume capture in mm");
    edit("rig.json", "\"mesh.ply\"", "\"../mesh.ply\"", "inside the capture's folder");
    edit("rig.json", "\"name\": \"red\",", "", "name");
    edit("rig.json", "\"width\": 16", "\"width\": 17", "16 × 16 pixels");
    edit("rig.json", "\"hits_mm\": [", "\"hits_mm\": [[0, 0, 0],", "10 laser positions");
    edit("frames/zarr.json", "float32", "int8", "float32 and float16");
    edit("frames/zarr.json", "gzip", "zstd", "codecs");
    edit("frames/zarr.json", "16", "4000000000", "chunks are not one frame each");
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

    // A surface that is not flat, and that the pixels do not see.
    let mesh = "v 0 0 0\nv 5 0 0\nv 0 5 3\nf 1 2 3\n";
    fs::write(dir.join("c/mesh.obj"), mesh).unwrap();
    edit("rig.json", "\"mesh.ply\"", "\"mesh.obj\"", "enough pixels");
    for wrong in [&["--spots", "0"][..], &["--eta", "0.5"], &["--drift", "-1"], &["--beam", "0"]] {
        assert_eq!(simulate(dir, "w", wrong).status, 2, "{wrong:?}");
    }
}

#[test]
fn a_mesh_is_captured_fitted_for_each_vertex_and_reported() {
    let dir = tempdir().unwrap();
    let dir = dir.path();
    fs::write(dir.join("ball.obj"), common::octahedron()).unwrap();
    let small = ["--spacing", "4", "--pixels", "24", "--views", "3", "--photons", "300"];
    let simulate = [&["scatter", "simulate", "homogeneous", "--mesh", "ball.obj", "-o", "c"][..], &small].concat();
    let made = json(dir, &simulate);
    let rig: Value = serde_json::from_str(&fs::read_to_string(dir.join("c/rig.json")).unwrap()).unwrap();
    let positions = rig["laser"]["hits_mm"].as_array().unwrap().len();
    assert_eq!((&made["positions"], &made["frames"]), (&positions.into(), &(positions * 6).into()));
    // Three stops with two cameras: the frames of a position are those of its stop.
    assert_eq!(rig["views"].as_array().unwrap().len(), 6);
    let there = |view: usize| dir.join(format!("c/frames/c/{view}/0/1/0/0")).exists();
    assert_eq!((0..6).map(there).collect::<Vec<_>>(), [true, true, false, false, false, false]);
    let fitted = json(dir, &["scatter", "fit", "c", "--model", "exponential", "-o", "m"]);
    let measured = fitted["measured"].as_u64().unwrap();
    assert!(fitted["vertices"] == 258 && measured > 60 && measured < 258 && fitted["empty"] == 0, "{fitted}");
    let model: Value = serde_json::from_str(&fs::read_to_string(dir.join("m/model.json")).unwrap()).unwrap();
    // What no laser reached comes from its neighbours and says so.
    let from_neighbours = |v: &&Value| v["position"].is_null();
    let others: Vec<&Value> = model["vertices"].as_array().unwrap().iter().filter(from_neighbours).collect();
    assert!(others.len() as u64 == 258 - measured && others[0]["fall_off"]["segments"][0]["c"][0].is_number());
    let told = json(dir, &["scatter", "report", "c", "m", "-o", "r"]);
    let green = |i: usize| told["models"][i]["ln_e"][1].as_f64().unwrap();
    assert!(
        told["models"][0]["model"] == "this model" && green(0) < 0.6 && (1..4).all(|i| green(i).is_finite()),
        "{told}"
    );
    assert!(dir.join("r/samples.svg").exists() && dir.join("r/near.png").exists());

    // A model of another capture, and options that objects do not have.
    let error = translume(dir, &["scatter", "fit", "c", "--segments", "4", "-o", "n"]).error(2);
    assert!(error.contains("flat samples"), "{error}");
    let path = dir.join("m/model.json");
    let text = fs::read_to_string(&path).unwrap();
    for (from, to, says) in [
        ("translume vertex model", "something", "not a translume vertex model"),
        ("\"version\":\"1.1\"", "\"version\":\"2.0\"", "version 2.0"),
        ("\"texels_per_edge\":", "\"texels_per_edge\":9", "do not go"),
        ("\"channels\":[\"red\"", "\"channels\":[\"teal\"", "no channel alpha.teal"),
    ] {
        fs::write(&path, text.replacen(from, to, 1)).unwrap();
        let error = translume(dir, &["scatter", "report", "c", "m", "-o", "x"]).error(1);
        assert!(error.contains(says), "{from}: {error}");
    }
}

#[test]
fn meshes_without_an_inside_are_refused() {
    let dir = tempdir().unwrap();
    let dir = dir.path();
    fs::write(dir.join("open.obj"), "v 0 0 0\nv 5 0 0\nv 0 5 0\nv 0 0 5\nf 1 3 2\nf 1 2 4\nf 1 4 3\n").unwrap();
    fs::write(dir.join("flat.obj"), "v 0 0 0\nv 5 0 0\nv 0 5 0\nf 1 2 3\nf 1 3 2\n").unwrap();
    let run = |more: &[&str]| translume(dir, &[&["scatter", "simulate", "wax", "-o", "c"][..], more].concat());
    assert!(run(&["--mesh", "open.obj"]).error(1).contains("closed surface"));
    assert!(run(&["--mesh", "flat.obj"]).error(1).contains("flat.obj"));
    assert!(run(&["--mesh", "open.obj", "--spots", "3"]).status == 2);
    assert!(run(&["--grid", "no.vol"]).error(2).contains("go together"));
    assert!(!dir.join("c").exists());
}

#[test]
fn a_grid_is_a_medium() {
    let dir = tempdir().unwrap();
    let dir = dir.path();
    // Two by one by one numbers: the left half scatters, the right half is empty.
    let mut vol = b"VOL\x03".to_vec();
    [1i32, 2, 1, 1, 1].iter().for_each(|n| vol.extend(n.to_le_bytes()));
    [0.0f32, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0].iter().for_each(|x| vol.extend(x.to_le_bytes()));
    fs::write(dir.join("two.vol"), vol).unwrap();
    let common = ["scatter", "simulate", "grid", "--grid", "two.vol", "--pixels", "8", "--field", "16"];
    let more = ["--photons", "200", "--noise-free", "--spots", "2", "--spacing", "8", "-o"];
    translume(dir, &[&common[..], &more, &["c"]].concat()).ok();
    translume(dir, &[&common[..], &more, &["solid", "--base", "2"]].concat()).ok();
    // Where nothing scatters, nothing comes back: the frames of the right spots are darker.
    let light = |name: &str, position: usize| {
        let packed = fs::read(dir.join(format!("{name}/frames/c/0/{position}/1/0/0"))).unwrap();
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(&packed[..]), &mut bytes).unwrap();
        bytes.as_chunks::<4>().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).sum::<f64>()
    };
    let [left, right] = [light("c", 0), light("c", 1)];
    assert!(left > 5.0 * right, "{left} {right}");
    // With the same extinction everywhere both sides are alike.
    let [left, right] = [light("solid", 0), light("solid", 1)];
    assert!((left / right).ln().abs() < 0.4, "{left} {right}");

    // Something solid around it, and numbers that are no density.
    let with = |more: &[&str]| {
        let common =
            ["scatter", "simulate", "grid", "--grid", "two.vol", "--pixels", "8", "--photons", "20", "-o", "d"];
        translume(dir, &[&common[..], more].concat())
    };
    assert!(with(&["--base=-1"]).error(2).contains("--base"));
    let mut bytes = fs::read(dir.join("two.vol")).unwrap();
    let values = bytes.len() - 8;
    bytes[values..].fill(0);
    fs::write(dir.join("two.vol"), bytes).unwrap();
    assert!(with(&[]).error(1).contains("no density"));
}
