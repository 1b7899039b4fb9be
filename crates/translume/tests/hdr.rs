//! `translume hdr` on brackets with a known truth: what must not change the result, and what the outputs hold.

mod common;

use common::bracket::{self, EXPOSURES, POSES, SECS, camera, save, shots};
use common::translume;
use serde_json::Value;
use std::fs;
use std::io::Cursor;
use std::path::Path;
use tempfile::{TempDir, tempdir};
use translume_hdr::simulate::{Camera, Depth, Pose, scale_to};
use translume_image::{Codes, Samples, metrics, read_codes, read_exr_channels, read_picture};

fn folder() -> TempDir {
    let dir = tempdir().unwrap();
    bracket::usual(dir.path());
    dir
}

const USUAL: [&str; 6] = ["hdr", "a.png", "b.png", "c.png", EXPOSURES, "--anchor=1"];

/// The usual run with more options; its JSON.
#[track_caller]
fn usual(dir: &Path, more: &[&str]) -> Value {
    hdr(dir, &[&USUAL, more].concat())
}

#[track_caller]
fn hdr(dir: &Path, arguments: &[&str]) -> Value {
    serde_json::from_str(&translume(dir, &[arguments, &["--json"]].concat()).ok()).unwrap()
}

fn pixels(path: &Path) -> Vec<f32> {
    read_picture(path).unwrap().pixels.into_raw()
}

/// PSNR-µ in dB against what a camera without noise sees from the anchor, up to what the shortest exposure can tell.
fn quality(path: &Path) -> f64 {
    let camera = camera();
    let truth: Vec<f32> = camera.view(&bracket::scene(), &Pose::default(), None).iter().map(|v| v.min(3.9)).collect();
    let mut test = pixels(path);
    let scale = scale_to(&truth, &test);
    test.iter_mut().for_each(|v| *v = (*v * scale).min(3.9));
    let inner = |v: &[f32]| -> Vec<f32> {
        let (w, h) = camera.size;
        v.chunks_exact(3 * w).skip(12).take(h - 24).flat_map(|row| &row[36..3 * w - 36]).copied().collect()
    };
    let (truth, test) = (inner(&truth), inner(&test));
    metrics::psnr_mu(&truth, &test, metrics::top_percentile(&truth))
}

/// Largest relative difference of two pictures, beside an absolute one that darkness allows.
fn difference(a: &Path, b: &Path) -> f32 {
    let (a, b) = (pixels(a), pixels(b));
    assert_eq!(a.len(), b.len());
    a.iter().zip(&b).map(|(x, y)| (x - y).abs() / (x.abs() + 1e-3)).fold(0.0, f32::max)
}

#[test]
fn the_merge_comes_near_the_truth_and_alignment_is_why() {
    let dir = folder();
    usual(dir.path(), &["-o", "out.exr"]);
    usual(dir.path(), &["-o", "still.exr", "--preset", "tripod"]);
    let (aligned, still) = (quality(&dir.path().join("out.exr")), quality(&dir.path().join("still.exr")));
    assert!(aligned > 34.0 && aligned > still + 8.0, "{aligned} dB, {still} dB without alignment");
    // The motion of this bracket is one an affine map describes.
    let json = usual(dir.path(), &["-o", "global.exr", "--align", "global"]);
    assert!(json["images"].as_array().unwrap().iter().all(|i| i["non_linear"] == false), "{json}");
    assert!(quality(&dir.path().join("global.exr")) > still + 8.0);
    usual(dir.path(), &["-o", "a.exr", "--align=off", "--no-deghost"]);
    usual(dir.path(), &["-o", "b.exr", "--no-align", "--no-deghost"]);
    for same in ["a.exr", "b.exr"] {
        assert_eq!(difference(&dir.path().join("still.exr"), &dir.path().join(same)), 0.0);
    }
}

#[test]
fn the_order_of_the_files_does_not_matter() {
    let dir = folder();
    usual(dir.path(), &["-o", "abc.exr"]);
    let permuted = ["hdr", "c.png", "a.png", "b.png", "--exposures=1/4,1/60,1/15", "--anchor=2", "-o", "cab.exr"];
    hdr(dir.path(), &permuted);
    assert!(difference(&dir.path().join("abc.exr"), &dir.path().join("cab.exr")) < 0.002);
}

#[test]
fn the_number_of_threads_does_not_change_a_bit() {
    let dir = folder();
    let bits = |threads: &str| {
        usual(dir.path(), &["-o", "out.exr", "--precision=float", "--threads", threads]);
        pixels(&dir.path().join("out.exr")).into_iter().map(f32::to_bits).collect::<Vec<_>>()
    };
    let one = bits("1");
    for more in ["2", "3", "7"] {
        assert_eq!(one, bits(more), "{more} threads");
    }
}

#[test]
fn exposures_by_list_by_steps_and_by_time_are_the_same() {
    let dir = folder();
    usual(dir.path(), &["-o", "times.exr"]);
    hdr(dir.path(), &["hdr", "a.png", "b.png", "c.png", "--anchor=1", "--ev=-2,0,1.9068905956", "-o", "steps.exr"]);
    fs::write(dir.path().join("list.txt"), "# name seconds\nc.png 1/4\na.png 1/60\nb.png 0.0666666667\n").unwrap();
    hdr(dir.path(), &["hdr", "a.png", "b.png", "c.png", "--anchor=1", "--list", "list.txt", "-o", "list.exr"]);
    let at = |name: &str| dir.path().join(name);
    assert!(difference(&at("times.exr"), &at("steps.exr")) < 0.002);
    assert!(difference(&at("times.exr"), &at("list.exr")) < 0.002);
}

/// A JPEG with an EXIF block.
fn jpeg(codes: &Codes, fields: &[(exif::Tag, exif::Value)]) -> Vec<u8> {
    use image::ImageEncoder;
    let fields: Vec<exif::Field> = fields
        .iter()
        .map(|(tag, value)| exif::Field { tag: *tag, ifd_num: exif::In::PRIMARY, value: value.clone() })
        .collect();
    let mut writer = exif::experimental::Writer::new();
    fields.iter().for_each(|f| writer.push_field(f));
    let mut block = Cursor::new(Vec::new());
    writer.write(&mut block, true).unwrap();
    let Samples::U8(rgb) = &codes.samples else { panic!("8 bits") };
    let mut out = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut out, 97);
    encoder.set_exif_metadata(block.into_inner()).unwrap();
    encoder.write_image(rgb, codes.width as u32, codes.height as u32, image::ExtendedColorType::Rgb8).unwrap();
    out
}

#[test]
fn exif_tells_the_exposures() {
    use exif::{Rational, Tag, Value};
    let dir = tempdir().unwrap();
    let rational = |num, denom| Value::Rational(vec![Rational { num, denom }]);
    // The same light three ways: time alone; a smaller aperture; a higher ISO. Relative exposure is t · ISO/100 / N².
    let facts = [(1, 60, 4, 100), (4, 15, 8, 100), (1, 8, 4, 200)];
    for (i, (codes, (num, denom, f, iso))) in shots(&camera(), &POSES, &SECS).iter().zip(facts).enumerate() {
        let fields = [
            (Tag::ExposureTime, rational(num, denom)),
            (Tag::FNumber, rational(f, 1)),
            (Tag::PhotographicSensitivity, Value::Short(vec![iso])),
            (Tag::Model, Value::Ascii(vec![b"Simulator".to_vec()])),
        ];
        fs::write(dir.path().join(format!("{i}.JPG")), jpeg(codes, &fields)).unwrap();
    }
    let json = hdr(dir.path(), &["hdr", "0.JPG", "1.JPG", "2.JPG", "--anchor=1", "-o", "out.exr"]);
    let exposure = |i: usize| json["exposures"][i].as_f64().unwrap() * 16.0;
    for (i, secs) in SECS.iter().enumerate() {
        assert!((exposure(i) / secs - 1.0).abs() < 1e-6, "{json}");
    }
    assert_eq!(json["warnings"], serde_json::json!([]));
    assert!(quality(&dir.path().join("out.exr")) > 33.0);
    let metadata = read_picture(&dir.path().join("out.exr")).unwrap().metadata;
    assert!((metadata.exposure_secs.unwrap() - 4.0 / 15.0).abs() < 1e-6, "{metadata:?}");
}

#[test]
fn sixteen_bits_and_linear_sources() {
    let dir = tempdir().unwrap();
    for (depth, ending) in [(Depth::Sixteen, "png"), (Depth::Linear, "exr")] {
        let files: Vec<String> = (0..3).map(|i| format!("{depth:?}{i}.{ending}")).collect();
        for (file, codes) in files.iter().zip(shots(&Camera { depth, ..camera() }, &POSES, &SECS)) {
            save(&dir.path().join(file), &codes);
        }
        let mut arguments = vec!["hdr", &files[0], &files[1], &files[2], "--anchor=1", "-o", "out.exr"];
        if depth == Depth::Sixteen {
            arguments.push(EXPOSURES); // the EXR files carry theirs
        }
        let json = hdr(dir.path(), &arguments);
        assert!((json["exposures"][0].as_f64().unwrap() * 60.0 - 1.0).abs() < 1e-5, "{json}");
        let got = quality(&dir.path().join("out.exr"));
        assert!(got > 35.0, "{depth:?}: {got} dB");
    }
}

#[test]
fn a_saved_response_gives_the_same_picture() {
    let dir = folder();
    usual(dir.path(), &["-o", "found.exr", "--save-response", "camera.json"]);
    usual(dir.path(), &["-o", "loaded.exr", "--response", "camera.json"]);
    let (found, loaded) = (dir.path().join("found.exr"), dir.path().join("loaded.exr"));
    // Alignment starts from a rougher curve when none is given, so that the fields may differ by a hair.
    assert!((quality(&found) - quality(&loaded)).abs() < 0.5, "{} {}", quality(&found), quality(&loaded));
    usual(dir.path(), &["-o", "again.exr", "--response", "camera.json", "--save-response", "again.json"]);
    assert_eq!(difference(&loaded, &dir.path().join("again.exr")), 0.0);
    let curve = |name: &str| fs::read_to_string(dir.path().join(name)).unwrap();
    assert_eq!(curve("camera.json"), curve("again.json"));
}

#[test]
fn a_run_can_be_repeated_from_its_configuration() {
    let dir = folder();
    let printed = translume(dir.path(), &[&USUAL[..], &["-o", "a.exr", "--print-config"]].concat()).ok();
    assert!(!dir.path().join("a.exr").exists());
    fs::write(dir.path().join("run.toml"), printed).unwrap();
    translume(dir.path(), &["hdr", "--config", "run.toml"]).ok();
    translume(dir.path(), &["hdr", "--config", "run.toml", "-o", "b.exr"]).ok();
    usual(dir.path(), &["-o", "c.exr"]);
    for other in ["b.exr", "c.exr"] {
        assert_eq!(difference(&dir.path().join("a.exr"), &dir.path().join(other)), 0.0);
    }
}

#[test]
fn a_folder_is_a_batch() {
    let dir = tempdir().unwrap();
    let shoot = dir.path().join("the shoot");
    fs::create_dir(&shoot).unwrap();
    for (k, codes) in shots(&camera(), &POSES, &SECS).iter().enumerate() {
        for set in 0..2 {
            save(&shoot.join(format!("{set}{k}.png")), codes);
        }
    }
    let arguments =
        ["hdr", "the shoot", "--group", "3", EXPOSURES, "--anchor=1", "-o", "merged", "--preview", "--mask"];
    let json = hdr(dir.path(), &arguments);
    assert_eq!(json["sets"].as_array().unwrap().len(), 2);
    assert_eq!(json["failed"], serde_json::json!([]));
    for k in ["001", "002"] {
        for ending in ["exr", "png", "mask.png"] {
            assert!(dir.path().join(format!("merged/the shoot-{k}.{ending}")).exists(), "{k}.{ending}");
        }
    }
    let exr = |k| dir.path().join(format!("merged/the shoot-{k}.exr"));
    assert_eq!(difference(&exr("001"), &exr("002")), 0.0);
}

#[test]
fn fields_hold_the_motion_in_pixels() {
    let dir = folder();
    usual(dir.path(), &["-o", "out.exr", "--fields", "fields"]);
    let (w, h) = camera().size;
    for (name, pose) in ["00-a.exr", "01-b.exr", "02-c.exr"].iter().zip(POSES) {
        let planes = read_exr_channels(&dir.path().join("fields").join(name), 0).unwrap();
        assert_eq!((planes.width, planes.height), (w, h));
        let channel = |n: &str| &planes.planes.iter().find(|c| c.0 == n).unwrap().1;
        let (dx, dy) = (channel("X"), channel("Y"));
        let (mut sum, mut n) = (0.0, 0.0);
        for y in 12..h - 12 {
            for x in 12..w - 12 {
                let place = pose.place([x as f64, y as f64], (w, h));
                let found = [x as f64 + f64::from(dx[y * w + x]), y as f64 + f64::from(dy[y * w + x])];
                sum += (found[0] - place[0]).hypot(found[1] - place[1]);
                n += 1.0;
            }
        }
        assert!(sum / n < 0.5, "{name}: {} px off", sum / n);
    }
}

#[test]
fn previews_masks_and_reports_are_pictures_of_the_result() {
    let dir = folder();
    let json = usual(dir.path(), &["-o", "out.exr", "--preview", "--mask", "m.png", "--report", "report"]);
    for (file, gray) in [("out.png", false), ("m.png", true)] {
        let codes = read_codes(&dir.path().join(file)).unwrap();
        assert_eq!((codes.width, codes.height), camera().size);
        let levels: Vec<f32> = (0..codes.width * codes.height * 3).map(|i| codes.unit(i)).collect();
        let mean = levels.iter().sum::<f32>() / levels.len() as f32;
        assert!(if gray { mean < 0.3 } else { (0.15..0.85).contains(&mean) }, "{file}: {mean}");
    }
    let page = fs::read_to_string(dir.path().join("report/index.html")).unwrap();
    let files: Vec<&str> = page.split("src=\"").skip(1).filter_map(|s| s.split('"').next()).collect();
    assert!(files.len() >= 8 && files.iter().all(|f| dir.path().join("report").join(f).exists()), "{files:?}");
    assert_eq!(json["anchor"], 1);
    assert_eq!((json["width"].as_u64(), json["height"].as_u64()), (Some(240), Some(176)));
    let moved = json["images"][0]["displacement_mean_px"].as_f64().unwrap();
    assert!((moved - 5.55).abs() < 0.7, "{json}");
}

#[test]
fn names_may_hold_spaces_and_any_letters() {
    let dir = tempdir().unwrap();
    let inner = dir.path().join("фото 写真");
    fs::create_dir(&inner).unwrap();
    let files: Vec<String> = (0..3).map(|i| format!("фото 写真/Brücke № {i}.png")).collect();
    for (file, codes) in files.iter().zip(shots(&camera(), &POSES, &SECS)) {
        save(&dir.path().join(file), &codes);
    }
    let out = "фото 写真/das Ergebnis.exr";
    let json = hdr(dir.path(), &["hdr", &files[0], &files[1], &files[2], EXPOSURES, "-o", out, "--preview"]);
    assert_eq!(json["output"], out);
    assert!(inner.join("das Ergebnis.exr").exists() && inner.join("das Ergebnis.png").exists());
}

#[test]
fn calibration_sets_the_luminance_of_the_centre() {
    let dir = folder();
    usual(dir.path(), &["-o", "out.exr", "--calibrate", "250"]);
    let picture = read_picture(&dir.path().join("out.exr")).unwrap().pixels;
    let (mut sum, mut n) = (0.0, 0.0);
    for y in 88 - 8..88 + 8 {
        for x in 120 - 12..120 + 12 {
            let p = picture.get_pixel(x, y).0;
            sum += 0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2];
            n += 1.0;
        }
    }
    assert!((sum / n - 250.0_f32).abs() < 1.0, "{}", sum / n);

    // Sunlight goes beyond half floats: the file then has floats, unless halves were asked for.
    let bright = |more: &[&str]| {
        let json = usual(dir.path(), &[&["-o", "bright.exr", "--calibrate", "60000"], more].concat());
        let picture = read_picture(&dir.path().join("bright.exr")).unwrap().pixels;
        (picture.iter().copied().fold(0.0, f32::max), json["warnings"].to_string())
    };
    let (top, warnings) = bright(&[]);
    assert!(top > 65504.0 && !warnings.contains("65504"), "{top} {warnings}");
    let (top, warnings) = bright(&["--precision", "half"]);
    assert!(top == 65504.0 && warnings.contains("65504"), "{top} {warnings}");
}
