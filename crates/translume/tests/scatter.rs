//! `translume scatter fit` through the binary.

mod common;

use common::translume;
use serde_json::Value;
use std::fs;
use std::path::Path;
use tempfile::tempdir;

/// A `.npy` file of version 1.0 with this description and these bytes.
fn npy(path: &Path, description: &str, data: &[u8]) {
    let mut header = format!("{description}\n");
    while !(10 + header.len()).is_multiple_of(64) {
        header.insert(header.len() - 1, ' ');
    }
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend((header.len() as u16).to_le_bytes());
    file.extend(header.as_bytes());
    file.extend(data);
    fs::write(path, file).unwrap();
}

fn describe(dtype: &str, shape: &str) -> String {
    format!("{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}")
}

/// `points` times `samples` values of 0.5 e^(−0.9 r) + 0.01 e^(−0.3 r) on a spiral.
fn fall_off(points: usize, samples: usize) -> Vec<f32> {
    let sample = |i: usize| {
        let r = 0.05 * (i % samples) as f32 + 0.1;
        let phi = i as f32;
        [r * phi.cos(), r * phi.sin(), 0.5 * (-0.9 * r).exp() + 0.01 * (-0.3 * r).exp()]
    };
    (0..points * samples).flat_map(sample).collect()
}

fn bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

#[test]
fn fits_are_written_in_order_for_any_number_of_threads() {
    let dir = tempdir().unwrap();
    let mut values = fall_off(5, 150);
    for (i, v) in values.iter_mut().enumerate().filter(|(i, _)| i % 3 == 2) {
        *v *= (i / 450 + 1) as f32; // each point is brighter than the one before
    }
    npy(&dir.path().join("a b.npy"), &describe("<f4", "(5, 150, 3)"), &bytes(&values));
    let arguments = ["scatter", "fit", "a b.npy", "--segments", "4", "-o", "fit.json", "--json"];
    let told: Value = serde_json::from_str(&translume(dir.path(), &arguments).ok()).unwrap();
    assert_eq!((&told["points"], &told["fitted"]), (&Value::from(5), &Value::from(5)));
    assert!(told["worst_rms"].as_f64().unwrap() < 1e-3);
    let text = fs::read_to_string(dir.path().join("fit.json")).unwrap();
    let fit: Value = serde_json::from_str(&text).unwrap();
    assert_eq!((&fit["model"], &fit["terms"], &fit["version"]), (&"exponential".into(), &3.into(), &"1.0".into()));
    let points = fit["points"].as_array().unwrap();
    let sum = |p: &Value| p["segments"][1]["c"].as_array().unwrap().iter().map(|c| c.as_f64().unwrap()).sum::<f64>();
    for (i, p) in points.iter().enumerate() {
        assert_eq!(p["segments"].as_array().unwrap().len(), 4);
        assert!((sum(p) / (0.51 * (i + 1) as f64) - 1.0).abs() < 0.01, "{p}");
    }
    translume(dir.path(), &["scatter", "fit", "a b.npy", "--segments", "4", "-o", "one.json", "--threads", "1"]).ok();
    let points_of = |text: &str| text.split_once("\"points\"").unwrap().1.to_owned();
    assert_eq!(points_of(&text), points_of(&fs::read_to_string(dir.path().join("one.json")).unwrap()));
}

#[test]
fn the_models_and_double_precision() {
    let dir = tempdir().unwrap();
    let doubles: Vec<u8> = fall_off(2, 100).iter().flat_map(|v| f64::from(*v).to_le_bytes()).collect();
    npy(&dir.path().join("s.npy"), &describe("<f8", "(2, 100, 3)"), &doubles);
    for (model, key) in [("dipole", "sigma_s_prime"), ("better-dipole", "sigma_a"), ("normalized", "albedo")] {
        translume(dir.path(), &["scatter", "fit", "s.npy", "--model", model, "-o", "fit.json"]).ok();
        let fit: Value = serde_json::from_str(&fs::read_to_string(dir.path().join("fit.json")).unwrap()).unwrap();
        assert_eq!(fit["model"], model);
        assert!(fit["points"][1]["segments"][0][key].as_f64().unwrap() > 0.0, "{fit}");
    }
}

#[test]
fn damaged_lists_are_named_and_leave_nothing() {
    let dir = tempdir().unwrap();
    let path = dir.path().join("s.npy");
    let data = bytes(&fall_off(2, 10));
    let huge = "(4611686018427387904, 4611686018427387904, 3)";
    for (description, data, says) in [
        (describe("<f4", "(2, 10, 3)"), &data[..data.len() - 1], "truncated"),
        (describe("<f4", "(2, 10, 3)"), &[&data[..], &[0; 4]].concat(), "4 bytes follow"),
        (describe("<f4", "(1000000000, 2000, 3)"), &data, "truncated"),
        (describe("<f4", huge), &data, "truncated"),
        (describe("<f4", "(99999999999999999999, 10, 3)"), &data, "makes no sense"),
        (describe("<f4", "(20, 3)"), &data, "wanted is (points, samples, 3)"),
        (describe("<f4", "(2, 10, 4)"), &data, "wanted is (points, samples, 3)"),
        (describe("<f4", "(0, 10, 3)"), &[], "wanted is (points, samples, 3)"),
        (describe("<i4", "(2, 10, 3)"), &data, "float32"),
        (describe(">f4", "(2, 10, 3)"), &data, "float32"),
        (describe("<f4", "(2, 10, 3)").replace("False", "True"), &data, "Fortran"),
        ("{}".into(), &data, "no descr"),
    ] {
        npy(&path, &description, data);
        let error = translume(dir.path(), &["scatter", "fit", "s.npy", "-o", "fit.json"]).error(1);
        assert!(error.contains("s.npy") && error.contains(says), "{description}: {error}");
    }
    for (file, says) in [
        (&b"not numpy at all"[..], "not a .npy"),
        (b"", "not a .npy"),
        (b"\x93NUMPY\x09\x00\x10\x00", "version 9"),
        (b"\x93NUMPY\x02\x00\xff\xff\xff\xff{'descr'", "no array needs one"),
        (b"\x93NUMPY\x01\x00\x76\x00{'descr'", "truncated inside its header"),
    ] {
        fs::write(&path, file).unwrap();
        let error = translume(dir.path(), &["scatter", "fit", "s.npy", "-o", "fit.json"]).error(1);
        assert!(error.contains(says), "{error}");
    }
    assert!(!dir.path().join("fit.json").exists());
    assert!(translume(dir.path(), &["scatter", "fit", "none.npy", "-o", "fit.json"]).error(1).contains("none.npy"));
}

#[test]
fn bad_samples_are_counted_and_wrong_options_refused() {
    let dir = tempdir().unwrap();
    let mut values = fall_off(2, 100);
    values[5] = f32::NAN;
    values[301..600].fill(f32::INFINITY); // the second point
    npy(&dir.path().join("s.npy"), &describe("<f4", "(2, 100, 3)"), &bytes(&values));
    let run = translume(dir.path(), &["scatter", "fit", "s.npy", "-o", "fit.json", "--json"]);
    assert!(run.stderr.contains("1 of 2 points") && run.stderr.contains("101 samples are infinite"), "{}", run.stderr);
    let told: Value = serde_json::from_str(&run.ok()).unwrap();
    assert_eq!((&told["fitted"], &told["not_finite"], &told["samples"]), (&1.into(), &101.into(), &99.into()));
    let fit: Value = serde_json::from_str(&fs::read_to_string(dir.path().join("fit.json")).unwrap()).unwrap();
    assert_eq!((&fit["points"][1]["rms"], &fit["points"][1]["segments"]), (&Value::Null, &Value::Array(vec![])));

    npy(&dir.path().join("dark.npy"), &describe("<f4", "(2, 100, 3)"), &bytes(&[0.0; 600]));
    let error = translume(dir.path(), &["scatter", "fit", "dark.npy", "-o", "dark.json"]).error(1);
    assert!(error.contains("dark.npy") && error.contains("no point has enough samples"), "{error}");
    assert!(!dir.path().join("dark.json").exists());
    for wrong in [&["--segments", "2"][..], &["--eta", "0.5"], &["--free-scale"], &["--terms", "0"], &["--model", "x"]]
    {
        let arguments = [&["scatter", "fit", "s.npy", "-o", "fit.json"], wrong].concat();
        let run = translume(dir.path(), &arguments);
        assert_eq!(run.status, 2, "{wrong:?}: {}", run.stderr);
    }
}
