//! Poses, white balance and the laser's power of captures with an imperfect rig, through the binary.

mod common;

use common::translume;
use serde_json::{Value, json};
use std::fs;
use std::path::Path;
use tempfile::tempdir;

type Point = [f64; 3];

/// An egg with two bumps, of some 15 mm: the tests' ball, deformed, so that no turn leaves its outline alone.
fn body(path: &Path) {
    let place = |line: &str| -> Option<Point> {
        let mut numbers = line.strip_prefix("v ")?.split(' ').map(|n| n.parse::<f64>().unwrap());
        Some(std::array::from_fn(|_| numbers.next().unwrap() / 6.0))
    };
    let dot = |a: Point, b: Point| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let bumpy = |p: Point| {
        let (one, two) = (dot(p, [0.8, 0.6, 0.0]).max(0.0), dot(p, [-0.6, 0.3, 0.74]).max(0.0));
        let r = 6.0 * (1.0 + 0.5 * one.powi(3) + 0.35 * two.powi(4));
        format!("v {:.6} {:.6} {:.6}", r * p[0], 0.75 * r * p[1], 0.9 * r * p[2])
    };
    let text: Vec<String> = common::octahedron().lines().map(|l| place(l).map_or(l.to_owned(), bumpy)).collect();
    fs::write(path, text.join("\n")).unwrap();
}

/// A capture of the body with two stops and two cameras each; a pixel is 0.4 mm.
fn simulate(dir: &Path, name: &str, more: &[&str]) {
    body(&dir.join("body.obj"));
    let common = [
        "scatter",
        "simulate",
        "homogeneous",
        "--mesh",
        "body.obj",
        "--spacing",
        "2.5",
        "--pixels",
        "48",
        "--views",
        "2",
    ];
    translume(dir, &[&common[..], &["-o", name], more].concat()).ok();
}

fn rig(dir: &Path, name: &str) -> Value {
    serde_json::from_str(&fs::read_to_string(dir.join(name).join("rig.json")).unwrap()).unwrap()
}

fn point(v: &Value) -> Point {
    std::array::from_fn(|i| v[i].as_f64().unwrap())
}

/// The rotation by `w` radians about w, of a point.
fn turn(w: Point, p: Point) -> Point {
    let angle = w.iter().map(|x| x * x).sum::<f64>().sqrt();
    let k = w.map(|x| x / angle);
    let cross = [k[1] * p[2] - k[2] * p[1], k[2] * p[0] - k[0] * p[2], k[0] * p[1] - k[1] * p[0]];
    let along = k[0] * p[0] + k[1] * p[1] + k[2] * p[2];
    std::array::from_fn(|i| p[i] * angle.cos() + cross[i] * angle.sin() + k[i] * along * (1.0 - angle.cos()))
}

/// Turns the object in front of each camera and moves it; turns and moves the projector.
fn spoil(rig: &mut Value) {
    for (i, view) in rig["views"].as_array_mut().unwrap().iter_mut().enumerate() {
        let m = view["camera"]["camera_from_world"].as_array().unwrap().clone();
        let w = [[0.02, -0.015, 0.01], [-0.01, 0.02, 0.015], [0.015, 0.01, -0.02], [0.01, -0.02, 0.01]][i];
        let shift = [[1.1, 0.3, 1.0], [-0.5, 0.9, -2.0], [0.4, -0.8, 0.5], [-1.0, -0.6, 1.0]][i];
        let columns: Vec<Point> = (0..3).map(|c| turn(w, std::array::from_fn(|r| m[r][c].as_f64().unwrap()))).collect();
        let row = |r: usize| json!([columns[0][r], columns[1][r], columns[2][r], m[r][3].as_f64().unwrap() + shift[r]]);
        view["camera"]["camera_from_world"] = json!([row(0), row(1), row(2)]);
    }
    let moved = |v: &Value| {
        let p = turn([0.01, 0.02, -0.015], point(v));
        json!([p[0] + 0.8, p[1] - 0.9, p[2] + 0.5])
    };
    let laser = &mut rig["laser"];
    laser["origin_mm"] = moved(&laser["origin_mm"]);
    for key in ["origins_mm", "hits_mm"] {
        laser[key] = laser[key].as_array().unwrap().iter().map(moved).collect();
    }
}

/// RMS distance in pixels between what two cameras show of the body's vertices.
fn apart(dir: &Path, a: &Value, b: &Value) -> f64 {
    let project = |v: &Value, p: Point| {
        let m = &v["camera"]["camera_from_world"];
        let c: Point = std::array::from_fn(|r| {
            (0..3).map(|k| m[r][k].as_f64().unwrap() * p[k]).sum::<f64>() + m[r][3].as_f64().unwrap()
        });
        let f = v["camera"]["focal_px"].as_f64().unwrap() / c[2];
        [f * c[0], f * c[1]]
    };
    let text = fs::read_to_string(dir.join("body.obj")).unwrap();
    let points = text.lines().filter_map(|l| l.strip_prefix("v ")).map(|l| {
        let mut numbers = l.split(' ').map(|n| n.parse::<f64>().unwrap());
        std::array::from_fn(|_| numbers.next().unwrap())
    });
    let (sum, n) = points.fold((0.0, 0.0), |(s, n), p| {
        let (a, b) = (project(a, p), project(b, p));
        (s + (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2), n + 1.0)
    });
    (sum / n).sqrt()
}

fn hits_apart(a: &Value, b: &Value) -> f64 {
    let hits = |v: &Value| v["laser"]["hits_mm"].as_array().unwrap().iter().map(point).collect::<Vec<_>>();
    let distance = |(p, q): (Point, Point)| (0..3).map(|i| (p[i] - q[i]).powi(2)).sum::<f64>().sqrt();
    let mut all: Vec<f64> = hits(a).into_iter().zip(hits(b)).map(distance).collect();
    all.sort_by(f64::total_cmp);
    all[all.len() / 2]
}

#[test]
fn cameras_and_laser_are_found_again() {
    let dir = tempdir().unwrap();
    let dir = dir.path();
    simulate(dir, "c", &["--photons", "250"]);
    let truth = rig(dir, "c");
    let mut spoiled = truth.clone();
    spoil(&mut spoiled);
    fs::write(dir.join("c/rig.json"), spoiled.to_string()).unwrap();
    let told = translume(dir, &["scatter", "register", "c", "-o", "r", "--json"]).ok();
    let told: Value = serde_json::from_str(&told).unwrap();
    let found = rig(dir, "r");
    for view in 0..4 {
        let before = apart(dir, &truth["views"][view], &spoiled["views"][view]);
        let after = apart(dir, &truth["views"][view], &found["views"][view]);
        assert!(before > 1.2 && after < 0.75, "view {view}: {before} → {after} px");
        let outline = &told["views"][view]["outline_px"];
        assert!(outline[1].as_f64().unwrap() < 0.25 && outline[0].as_f64().unwrap() > 0.3, "{told}");
    }
    let (before, after) = (hits_apart(&truth, &spoiled), hits_apart(&truth, &found));
    assert!(before > 0.9 && after < 0.45, "{before} → {after} mm");
    assert!(found["provenance"]["registered"]["found"]["views"].is_array(), "{found}");
    assert_eq!(found["provenance"]["parameters"], truth["provenance"]["parameters"]);

    // The new folder is a whole capture; a file is only the description, and is the same.
    let chunk = "frames/c/0/0/1/0/0";
    assert_eq!(fs::read(dir.join("c").join(chunk)).unwrap(), fs::read(dir.join("r").join(chunk)).unwrap());
    let refused = translume(dir, &["scatter", "register", "c", "-o", "c/rig.json"]).error(2);
    assert!(refused.contains("also read"), "{refused}");
    let replace = || {
        translume(dir, &["scatter", "register", "c", "-o", "found.json"]).ok();
        fs::copy(dir.join("found.json"), dir.join("c/rig.json")).unwrap();
    };
    replace();
    let mut alone = rig(dir, "c");
    assert_eq!(alone["views"], found["views"]);
    // Registered once more little changes.
    replace();
    (0..4).for_each(|v| assert!(apart(dir, &rig(dir, "c")["views"][v], &found["views"][v]) < 0.5));
    assert!(translume(dir, &["scatter", "register", "c", "-o", "r"]).error(1).contains("it exists"));

    // A mesh that no camera has in its frame.
    alone["views"]
        .as_array_mut()
        .unwrap()
        .iter_mut()
        .for_each(|v| v["camera"]["camera_from_world"][0][3] = json!(900.0));
    fs::write(dir.join("c/rig.json"), alone.to_string()).unwrap();
    let error = translume(dir, &["scatter", "register", "c", "-o", "x"]).error(1);
    assert!(error.contains("no camera of rig.json has the mesh"), "{error}");
    // Frames without light.
    fs::write(dir.join("c/rig.json"), truth.to_string()).unwrap();
    fs::remove_dir_all(dir.join("c/frames/c")).unwrap();
    let error = translume(dir, &["scatter", "register", "c", "-o", "x"]).error(1);
    assert!(error.contains("can be made out"), "{error}");
    assert!(!dir.join("x").exists());
}

#[test]
fn a_registered_capture_is_fitted_like_a_perfect_one() {
    let dir = tempdir().unwrap();
    let dir = dir.path();
    let ln_e = |name: &str| {
        let (model, report) = (format!("{name}-m"), format!("{name}-r"));
        translume(dir, &["scatter", "fit", name, "--threshold", "0.05", "-o", &model]).ok();
        let told = translume(dir, &["scatter", "report", name, &model, "-o", &report, "--json"]).ok();
        serde_json::from_str::<Value>(&told).unwrap()["models"][0]["ln_e"][1].as_f64().unwrap()
    };
    simulate(dir, "perfect", &["--photons", "250"]);
    simulate(dir, "off", &["--photons", "250", "--misregistration", "1"]);
    translume(dir, &["scatter", "register", "off", "-o", "on"]).ok();
    let (perfect, off, on) = (ln_e("perfect"), ln_e("off"), ln_e("on"));
    assert!(off > 1.2 * perfect && on < 1.08 * perfect, "{perfect} {off} {on}");
    // Mirrors that miss their angles: the spots say where the beams fell.
    simulate(dir, "shift", &["--photons", "250", "--peak-shift", "0.7"]);
    translume(dir, &["scatter", "register", "shift", "--seen-hits", "-o", "seen"]).ok();
    let (before, after) = (ln_e("shift"), ln_e("seen"));
    assert!(after < 0.93 * before, "{before} {after}");
}

#[test]
fn a_flat_sample_is_registered_by_its_spots() {
    let dir = tempdir().unwrap();
    let dir = dir.path();
    let common = [
        "scatter",
        "simulate",
        "homogeneous",
        "--spots",
        "4",
        "--spacing",
        "2",
        "--pixels",
        "24",
        "--field",
        "14",
        "--thickness",
        "4",
    ];
    translume(dir, &[&common[..], &["--photons", "400", "--misregistration", "1", "-o", "c"]].concat()).ok();
    let told = translume(dir, &["scatter", "register", "c", "-o", "r", "--json"]).ok();
    let told: Value = serde_json::from_str(&told).unwrap();
    let spots = &told["views"][0]["spot_px"];
    assert!(spots[0].as_f64().unwrap() > 0.5 && spots[1].as_f64().unwrap() < 0.25, "{told}");
    assert_eq!(told["beams"], json!([]));
    assert_eq!(rig(dir, "c")["laser"], rig(dir, "r")["laser"]);
}

#[test]
fn white_is_balanced_by_pictures_of_a_white_target() {
    let dir = tempdir().unwrap();
    let dir = dir.path();
    let common =
        ["scatter", "simulate", "homogeneous", "--spots", "3", "--spacing", "2", "--pixels", "16", "--field", "12"];
    translume(dir, &[&common[..], &["--photons", "100", "-o", "c"]].concat()).ok();
    // Two by two pixels in grey each; the camera sees less green and blue, and the blue laser is stronger.
    let mut powers = rig(dir, "c");
    powers["laser"]["power"] = json!([1.0, 1.0, 2.0]);
    fs::write(dir.join("c/rig.json"), powers.to_string()).unwrap();
    let picture = |name: &str, value: f32| {
        let mut bytes = b"Pf\n2 2\n-1.0\n".to_vec();
        (0..4).for_each(|i| bytes.extend((value * (0.5 + 0.25 * i as f32)).to_le_bytes()));
        fs::write(dir.join(name), bytes).unwrap();
    };
    picture("r.pfm", 4.0);
    picture("g.pfm", 2.0);
    picture("b.pfm", 2.0);
    picture("black.pfm", 0.0);
    let register = |white: &[&str], out: &str| {
        translume(dir, &[&["scatter", "register", "c", "-o", out, "--white"][..], white].concat())
    };
    register(&["r.pfm", "g.pfm", "b.pfm"], "w").ok();
    let white: Vec<f64> =
        rig(dir, "w")["channels"].as_array().unwrap().iter().map(|c| c["white_balance"].as_f64().unwrap()).collect();
    // factor × light / power is the same for all, and the product is 1.
    assert!((white[1] / white[0] - 2.0).abs() < 1e-6 && (white[2] / white[0] - 4.0).abs() < 1e-6, "{white:?}");
    assert!((white.iter().product::<f64>() - 1.0).abs() < 1e-9, "{white:?}");
    assert!(register(&["r.pfm", "g.pfm"], "x").error(2).contains("3 channels"));
    assert!(register(&["r.pfm", "g.pfm", "black.pfm"], "x").error(1).contains("black.pfm: no white target"));
    assert!(register(&["r.pfm", "g.pfm", "none.pfm"], "x").error(1).contains("none.pfm"));
    assert!(!dir.join("x").exists());
}

#[test]
fn the_power_of_a_drifting_laser_is_found_on_a_mesh() {
    let dir = tempdir().unwrap();
    let dir = dir.path();
    // The same photons with and without drift: the ratio of two frames is the true power.
    let one = ["--photons", "600", "--spacing", "2", "--views", "1", "--cameras", "1", "--pixels", "40"];
    body(&dir.join("body.obj"));
    let common = ["scatter", "simulate", "homogeneous", "--mesh", "body.obj"];
    translume(dir, &[&common[..], &one, &["-o", "steady"]].concat()).ok();
    translume(dir, &[&common[..], &one, &["--drift", "0.3", "-o", "drifting"]].concat()).ok();
    let run = translume(dir, &["scatter", "fit", "drifting", "--gains", "--threshold", "0.05", "-o", "m"]);
    assert!(run.stderr.contains("frames cannot be told"), "{}", run.stderr);
    run.ok();
    let light = |name: &str, frame: &Value, channel: usize| {
        let chunk = format!("{name}/frames/c/{}/{}/{channel}/0/0", frame[0], frame[1]);
        let packed = fs::read(dir.join(chunk)).unwrap();
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(&packed[..]), &mut bytes).unwrap();
        bytes.as_chunks::<4>().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).sum::<f64>()
    };
    let model: Value = serde_json::from_str(&fs::read_to_string(dir.join("m/model.json")).unwrap()).unwrap();
    let (mut left, mut all) = (0.0, 0.0);
    for channel in 0..3 {
        let pairs = model["gains"].as_array().unwrap().iter().filter(|g| g["power"][channel] != 1.0).map(|g| {
            let truth = light("drifting", &g["frame"], channel) / light("steady", &g["frame"], channel);
            (truth.ln(), g["power"][channel].as_f64().unwrap().ln())
        });
        let pairs: Vec<(f64, f64)> = pairs.collect();
        assert!(pairs.len() >= 10, "{}", pairs.len());
        let mean = |of: fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>() / pairs.len() as f64;
        let (t, f) = (mean(|p| p.0), mean(|p| p.1));
        left += pairs.iter().map(|p| (p.0 - t - p.1 + f).powi(2)).sum::<f64>();
        all += pairs.iter().map(|p| (p.0 - t).powi(2)).sum::<f64>();
    }
    assert!(left < 0.4 * all, "{left} of {all} are left");
    // A report takes the powers into account; gains that do not fit the channels are refused.
    translume(dir, &["scatter", "report", "drifting", "m", "-o", "r"]).ok();
    let path = dir.join("m/model.json");
    let text = fs::read_to_string(&path).unwrap().replacen("\"power\":[", "\"power\":[-1.0,", 1);
    fs::write(&path, text).unwrap();
    assert!(translume(dir, &["scatter", "report", "drifting", "m", "-o", "x"]).error(1).contains("gains"));
}
