//! `translume image` and `translume compare` as a user runs them.

mod common;

use common::translume;
use serde_json::Value;
use std::path::Path;
use tempfile::tempdir;
use translume_image::{ExrOptions, Picture, Rgb32FImage, read_picture, write_exr_channels, write_pfm};

/// A gradient over ten stops, 24 × 16.
fn picture(dir: &Path, name: &str, gain: f32) {
    let pixels = Rgb32FImage::from_fn(24, 16, |x, y| {
        image_rgb([gain * (0.5 * x as f32 - 6.0).exp2(), 0.1 + 0.02 * y as f32, 0.3])
    });
    write_pfm(&dir.join(name), &Picture::new(pixels)).unwrap();
}

fn image_rgb(v: [f32; 3]) -> image::Rgb<f32> {
    image::Rgb(v)
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

#[test]
fn convert_goes_round_through_every_format() {
    let dir = tempdir().unwrap();
    picture(dir.path(), "a b.pfm", 1.0);
    let original = read_picture(&dir.path().join("a b.pfm")).unwrap();
    let chains: [(&str, &[&str], f32); 6] = [
        ("half.exr", &[], 1e-3),
        ("float.exr", &["--precision", "float", "--compression", "piz"], 0.0),
        ("wide.exr", &["--precision", "float", "--output-space", "acescg"], 1e-5),
        ("wide.hdr", &["--output-space", "rec2020"], 0.2), // eight bits for 45, the largest
        ("linear.tif", &[], 0.0),
        ("deep.png", &["--bits", "16"], 1e-4),
    ];
    for (name, options, tolerance) in chains {
        let arguments = [&["image", "convert", "a b.pfm", "-o", name, "--json"], options].concat();
        assert_eq!(json(&translume(dir.path(), &arguments).ok())["output"], name);
        let back = read_picture(&dir.path().join(name)).unwrap();
        for (p, q) in original.pixels.iter().zip(back.pixels.iter()) {
            // PNG clips at white; the gradient exceeds it.
            let expected = if name.ends_with("png") { p.min(1.0) } else { *p };
            assert!((expected - q).abs() <= tolerance * expected.max(1.0), "{name}: {expected} {q}");
        }
    }
}

#[test]
fn layers_without_colour_are_asked_for_by_the_option_and_listed() {
    let dir = tempdir().unwrap();
    let plane = [0.5f32; 4];
    let channels = ["normal.X", "normal.Y", "normal.Z", "depth.V"].map(|n| (n, plane.as_slice()));
    write_exr_channels(&dir.path().join("a.exr"), (2, 2), &channels, &ExrOptions::default()).unwrap();
    let run = translume(dir.path(), &["image", "convert", "a.exr", "-o", "b.exr"]);
    let error = run.error(1);
    assert!(error.contains("layers: depth, normal; give it as --layer NAME"), "{error}");
    let info = translume(dir.path(), &["image", "info", "a.exr"]).ok();
    assert!(info.contains("2 × 2") && info.contains("normal.X (half)"), "{info}");
    translume(dir.path(), &["image", "convert", "a.exr", "-o", "b.exr", "--layer", "normal"]).ok();
}

#[test]
fn values_beyond_half_are_a_warning_of_the_run() {
    let dir = tempdir().unwrap();
    picture(dir.path(), "a.pfm", 1e5);
    let run = |precision: &str| {
        let arguments = ["image", "convert", "a.pfm", "-o", "a.exr", "--json", "--precision", precision];
        json(&translume(dir.path(), &arguments).ok())["warnings"].to_string()
    };
    assert!(run("half").contains("65504"), "{}", run("half"));
    assert!(!run("float").contains("65504"), "{}", run("float"));
}

#[test]
fn info_tells_the_facts() {
    let dir = tempdir().unwrap();
    picture(dir.path(), "a.pfm", 1.0);
    let convert = ["image", "convert", "a.pfm", "-o", "a.exr", "--output-space", "rec2020"];
    translume(dir.path(), &convert).ok();
    let text = translume(dir.path(), &["image", "info", "a.exr"]).ok();
    assert!(text.contains("OpenEXR, 24 × 16, float") && text.contains("R (half)"), "{text}");
    assert!(text.contains("command: translume image convert a.pfm -o a.exr"), "{text}");
    let found = json(&translume(dir.path(), &["image", "info", "a.exr", "a.pfm", "--json"]).ok());
    assert_eq!(found["files"][0]["parts"][0]["channels"][2]["name"], "R");
    assert_eq!(found["files"][1]["format"], "PFM");
    assert!((found["files"][0]["chromaticities"][0][0].as_f64().unwrap() - 0.708).abs() < 1e-6);
}

#[test]
fn every_operator_makes_a_picture() {
    let dir = tempdir().unwrap();
    picture(dir.path(), "a.pfm", 4.0);
    for (operator, option) in [("reinhard", "--ev=1"), ("fattal", "--saturation=0.8"), ("exposure", "--gamma=2.2")] {
        let out = format!("{operator}.png");
        translume(dir.path(), &["image", "tonemap", "a.pfm", "-o", &out, "--operator", operator, option]).ok();
        let shown = read_picture(&dir.path().join(&out)).unwrap();
        assert_eq!(shown.pixels.dimensions(), (24, 16));
        let (dark, bright) = (shown.pixels.get_pixel(0, 8)[0], shown.pixels.get_pixel(23, 8)[0]);
        assert!(bright > dark + 0.2, "{operator}: {dark} {bright}");
    }
    translume(dir.path(), &["image", "tonemap", "a.pfm", "-o", "a.tif", "--bits", "16"]).ok();
    assert!(read_picture(&dir.path().join("a.tif")).is_ok());
}

#[test]
fn compare_measures_and_reports() {
    let dir = tempdir().unwrap();
    picture(dir.path(), "a.pfm", 1.0);
    picture(dir.path(), "b.pfm", 1.1);
    let equal = json(&translume(dir.path(), &["compare", "a.pfm", "a.pfm", "--json"]).ok());
    assert_eq!((&equal["rmse"], &equal["psnr"], &equal["flip_mean"]), (&0.0.into(), &Value::Null, &0.0.into()));
    let out = translume(dir.path(), &["compare", "a.pfm", "b.pfm", "--json", "--report", "page of ours"]).ok();
    let found = json(&out);
    assert!(found["hdr"] == true && found["flip_mean"].as_f64().unwrap() > 0.001, "{found}");
    assert!(found["flip_exposures"]["count"].as_u64().unwrap() >= 2);
    for file in found["files"].as_array().unwrap() {
        assert!(dir.path().join(file.as_str().unwrap()).exists(), "{file}");
    }
    let ldr = translume(dir.path(), &["compare", "a.pfm", "b.pfm", "--ldr", "--ppd", "30"]).ok();
    assert!(ldr.contains("flip_mean") && ldr.contains("ssim"), "{ldr}");
}

#[test]
fn mistakes_are_one_line() {
    let dir = tempdir().unwrap();
    picture(dir.path(), "a.pfm", 1.0);
    std::fs::write(dir.path().join("text.png"), "no picture").unwrap();
    std::fs::write(dir.path().join("empty.exr"), "").unwrap();
    let usage: [&[&str]; 6] = [
        &["image", "convert", "a.pfm", "-o", "a.gif"],
        &["image", "convert", "a.pfm", "-o", "a.png", "--output-space", "acescg"],
        &["image", "convert", "a.pfm", "-o", "a.png", "--bits", "12"],
        &["image", "convert", "a.pfm", "-o", "a.hdr", "--precision", "half"],
        &["image", "tonemap", "a.pfm", "-o", "a.png", "--operator", "fattal", "--white", "1"],
        &["image", "tonemap", "a.pfm", "-o", "a.exr"],
    ];
    for arguments in usage {
        translume(dir.path(), arguments).error(2);
    }
    for name in ["text.png", "empty.exr", "none.exr"] {
        let error = translume(dir.path(), &["image", "info", name]).error(1);
        assert!(error.starts_with(name), "{error}");
    }
    picture(dir.path(), "c.pfm", 1.0);
    translume(dir.path(), &["image", "convert", "a.pfm", "-o", "nowhere/a.exr"]).error(1);
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 4, "nothing half-written stays behind");
}
