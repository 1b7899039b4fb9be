//! `translume hdr` on what goes wrong outside: folders as cameras leave them, clipped highlights, transparent borders,
//! exposures that are none, brackets of a panorama, strips and turned cameras. Each with a healthy twin.

mod common;

use common::bracket::{EXPOSURES, SECS, camera, scene};
use common::translume;
use image::ImageEncoder as _;
use serde_json::Value;
use std::fs;
use std::io::Cursor;
use std::path::Path;
use tempfile::tempdir;
use translume_hdr::simulate::{Camera, Pose, response};
use translume_image::{Rgb32FImage, Samples, read_exr_channels, read_picture, write_png8};

#[track_caller]
fn hdr(dir: &Path, arguments: &[&str]) -> Value {
    serde_json::from_str(&translume(dir, &[&["hdr"], arguments, &["--json"]].concat()).ok()).unwrap()
}

/// The three 8-bit shots of a scene from one place.
fn shots_of(scene: &Rgb32FImage, pose: &Pose, camera: &Camera, secs: &[f64]) -> Vec<Vec<u8>> {
    let view = camera.view(scene, pose, None);
    let shot = |(i, t): (usize, &f64)| match camera.expose(&view, *t, i as u32).samples {
        Samples::U8(v) => v,
        _ => panic!("8 bits"),
    };
    secs.iter().enumerate().map(shot).collect()
}

/// A scene of its own for each number: patches of several sizes, brighter to the right.
fn another_scene(number: u32) -> Rgb32FImage {
    let (w, h) = scene().dimensions();
    let mut rng = translume_core::rng::Pcg32::new(100 + u64::from(number), 0);
    let mut layer =
        |cell: u32| -> Vec<f32> { (0..(w / cell + 1) * (h / cell + 1)).map(|_| rng.next_f32() - 0.5).collect() };
    let layers = [5u32, 13, 31].map(|cell| (cell, layer(cell)));
    Rgb32FImage::from_fn(w, h, |x, y| {
        let patches = |(cell, v): &(u32, Vec<f32>)| v[(y / cell * (w / cell + 1) + x / cell) as usize];
        let light = (1.3 * layers.iter().map(patches).sum::<f32>() + 2.5 * x as f32 / w as f32 - 2.0).exp();
        image::Rgb([light, 0.9 * light, 0.8 * light])
    })
}

fn jpeg(path: &Path, (w, h): (usize, usize), rgb: &[u8], secs: Option<f64>, quality: u8) {
    let mut out = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut out, quality);
    if let Some(secs) = secs {
        let time = exif::Rational { num: 1, denom: (1.0 / secs).round() as u32 };
        let value = exif::Value::Rational(vec![time]);
        let field = exif::Field { tag: exif::Tag::ExposureTime, ifd_num: exif::In::PRIMARY, value };
        let mut writer = exif::experimental::Writer::new();
        writer.push_field(&field);
        let mut block = Cursor::new(Vec::new());
        writer.write(&mut block, true).unwrap();
        encoder.set_exif_metadata(block.into_inner()).unwrap();
    }
    encoder.write_image(rgb, w as u32, h as u32, image::ExtendedColorType::Rgb8).unwrap();
    fs::write(path, out).unwrap();
}

/// Writes the shots of `order` (indices into [`SECS`]) of one scene as `IMG_n.jpg`, counting on from `n`.
fn shoot(dir: &Path, n: &mut usize, number: u32, order: &[usize]) {
    let camera = camera();
    let shots = shots_of(&another_scene(number), &Pose::default(), &camera, &SECS);
    for k in order {
        jpeg(&dir.join(format!("IMG_{n}.jpg")), camera.size, &shots[*k], Some(SECS[*k]), 95);
        *n += 1;
    }
}

fn files_of(json: &Value) -> Vec<Vec<String>> {
    let name = |i: &Value| Path::new(i["file"].as_str().unwrap()).file_name().unwrap().to_string_lossy().into_owned();
    let set = |s: &Value| s["images"].as_array().unwrap().iter().map(name).collect();
    json["sets"].as_array().map_or_else(|| vec![set(json)], |sets| sets.iter().map(set).collect())
}

#[test]
fn a_memory_card_falls_into_its_brackets() {
    let dir = tempdir().unwrap();
    let card = dir.path().join("card");
    fs::create_dir(&card).unwrap();
    let mut n = 8;
    // Automatic brackets begin in the middle; the second was broken off; the third goes up.
    shoot(&card, &mut n, 1, &[1, 0, 2]);
    shoot(&card, &mut n, 2, &[1, 0]);
    shoot(&card, &mut n, 3, &[0, 1, 2]);
    for side in ["._IMG_9.jpg", "IMG_9.xmp", "IMG_9.THM", ".DS_Store", "Thumbs.db", "IMG_9.cr2"] {
        fs::write(card.join(side), "no picture").unwrap();
    }
    let json = hdr(dir.path(), &["card", "-o", "merged"]);
    let names = |r: std::ops::Range<usize>| r.map(|i| format!("IMG_{i}.jpg")).collect::<Vec<_>>();
    assert_eq!(files_of(&json), [names(8..11), names(11..13), names(13..16)]);
    assert_eq!(json["failed"], serde_json::json!([]));
}

#[test]
fn brackets_that_cannot_be_told_apart_are_not_merged() {
    let dir = tempdir().unwrap();
    let card = dir.path().join("card");
    fs::create_dir(&card).unwrap();
    // Three exposures of three scenes.
    let mut n = 1;
    for k in 0..3 {
        shoot(&card, &mut n, k as u32 + 1, &[k]);
    }
    let run = translume(dir.path(), &["hdr", "card", "-o", "merged"]);
    let error = run.error(1);
    assert!(error.contains("--group") && error.contains("IMG_1.jpg and"), "{error}");
    assert!(!dir.path().join("merged").exists());
}

/// A scene with a disc that all exposures clip.
fn lamp() -> Rgb32FImage {
    let base = scene();
    Rgb32FImage::from_fn(base.width(), base.height(), |x, y| match (x as f32 - 100.0).hypot(y as f32 - 90.0) < 24.0 {
        true => image::Rgb([60.0, 55.0, 50.0]),
        false => image::Rgb(base.get_pixel(x, y).0.map(|v| v.min(1.5))),
    })
}

#[test]
fn a_lamp_that_all_clip_is_bright_and_white_in_spite_of_jpeg() {
    let dir = tempdir().unwrap();
    let camera = Camera { size: (200, 150), ..camera() };
    let scene = lamp();
    let view = camera.view(&scene, &Pose::default(), None);
    // Without its rim, which JPEG mixes with what is around it.
    let (w, h) = camera.size;
    let lit = |x: usize, y: usize| view.get_pixel(x as u32, y as u32).0[0] > 40.0;
    let within = |x: usize, y: usize| (3..w - 3).contains(&x) && (3..h - 3).contains(&y);
    let around = |x: usize, y: usize| [(x - 3, y), (x + 3, y), (x, y - 3), (x, y + 3)].iter().all(|p| lit(p.0, p.1));
    let inside: Vec<bool> = (0..w * h).map(|i| within(i % w, i / w) && around(i % w, i / w)).collect();
    assert!(inside.iter().filter(|i| **i).count() > 1000);
    let names = ["a.jpg", "b.jpg", "c.jpg"];
    for (name, rgb) in names.iter().zip(shots_of(&scene, &Pose::default(), &camera, &SECS)) {
        jpeg(&dir.path().join(name), camera.size, &rgb, None, 80);
    }
    for preset in ["tripod", "handheld"] {
        let json = hdr(
            dir.path(),
            &[
                "a.jpg",
                "b.jpg",
                "c.jpg",
                EXPOSURES,
                "--anchor=1",
                "--preset",
                preset,
                "--mask",
                "m.png",
                "--precision=float",
                "-o",
                "o.exr",
            ],
        );
        let out = read_picture(&dir.path().join("o.exr")).unwrap().pixels;
        let mask = translume_image::read_codes(&dir.path().join("m.png")).unwrap();
        let lamp: Vec<[f32; 3]> = out.pixels().zip(&inside).filter(|(_, i)| **i).map(|(p, _)| p.0).collect();
        let mut levels: Vec<f32> = lamp.iter().flatten().copied().collect();
        levels.sort_by(f32::total_cmp);
        let (least, middle) = (levels[0], levels[levels.len() / 2]);
        assert!(least > 0.7 * middle, "{preset}: {least} of {middle}");
        let hue = lamp.iter().map(|p| p.iter().copied().fold(0.0, f32::max) / p.iter().copied().fold(9e9, f32::min));
        assert!(hue.fold(0.0, f32::max) < 1.35, "{preset}");
        let flagged =
            inside.iter().enumerate().filter(|(i, inside)| **inside && mask.unit(3 * i) == 128.0 / 255.0).count();
        assert!(flagged * 10 > 9 * lamp.len(), "{preset}: {flagged} of {}", lamp.len());
        let share = std::f64::consts::PI * 24.0 * 24.0 / f64::from(out.width() * out.height());
        assert!((json["bound_share"].as_f64().unwrap() / share - 1.0).abs() < 0.1, "{json}");
    }
}

#[test]
fn transparent_pixels_do_not_count() {
    let dir = tempdir().unwrap();
    let camera = camera();
    let (w, h) = camera.size;
    let shots = shots_of(&scene(), &Pose::default(), &camera, &SECS);
    for (k, rgb) in shots.iter().enumerate() {
        write_png8(&dir.path().join(format!("whole{k}.png")), camera.size, rgb).unwrap();
        // Another side is cut off each; the left five columns off all.
        let gone = |x: usize, y: usize| x < 5 || [y < 9, x + 14 > w, y + 6 > h][k];
        let rgba: Vec<u8> = rgb
            .chunks_exact(3)
            .enumerate()
            .flat_map(|(i, p)| if gone(i % w, i / w) { [0; 4] } else { [p[0], p[1], p[2], 255] })
            .collect();
        image::save_buffer(dir.path().join(format!("cut{k}.png")), &rgba, w as u32, h as u32, image::ColorType::Rgba8)
            .unwrap();
    }
    let merge = |stem: &str| {
        let names: Vec<String> = (0..3).map(|k| format!("{stem}{k}.png")).collect();
        let options = [EXPOSURES, "--preset=tripod", "--anchor=1", "--precision=float", "-o", "o.exr"];
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let json = hdr(dir.path(), &[&names[..], &options[..]].concat());
        assert_eq!(json["warnings"], serde_json::json!([]));
        read_picture(&dir.path().join("o.exr")).unwrap()
    };
    let (whole, cut) = (merge("whole"), merge("cut"));
    assert!(whole.alpha.is_none());
    let alpha = cut.alpha.unwrap();
    for (i, (p, q)) in whole.pixels.pixels().zip(cut.pixels.pixels()).enumerate() {
        let seen = i % w >= 5;
        assert_eq!(alpha[i], f32::from(u8::from(seen)));
        let (p, q) = (p.0.iter().sum::<f32>(), q.0.iter().sum::<f32>());
        // Where the shortest shot is cut off, what the others clip is lost.
        assert!(
            if seen { (p / q).ln().abs() < 0.35 || !(0.1..=2.0).contains(&p) } else { q == 0.0 },
            "({}, {}): {p} {q}",
            i % w,
            i / w
        );
    }
}

#[test]
fn brackets_of_a_panorama_have_one_brightness() {
    let dir = tempdir().unwrap();
    let shoot = dir.path().join("pano");
    fs::create_dir(&shoot).unwrap();
    // The second view looks to where it is eight times as bright: its anchor is another shot.
    let camera = Camera { size: (120, 90), ..camera() };
    let base = scene();
    let pan = |from: u32, gain: f32| {
        Rgb32FImage::from_fn(160, 130, |x, y| {
            let bright = if x + from > 130 { gain } else { 1.0 };
            image::Rgb(base.get_pixel(60 + x / 4 + (x + from) % 60, y + 20).0.map(|v| 0.3 * bright * v))
        })
    };
    let scenes = [pan(0, 12.0), pan(90, 12.0)];
    for (s, scene) in scenes.iter().enumerate() {
        for (k, rgb) in shots_of(scene, &Pose::default(), &camera, &SECS).iter().enumerate() {
            jpeg(&shoot.join(format!("P{s}_{k}.jpg")), camera.size, rgb, Some(SECS[k]), 97);
        }
    }
    let ratio = |more: &[&str]| {
        hdr(dir.path(), &[&["pano", "--group=3", "--preset=tripod", "-o", "out"], more].concat());
        let median = |s: usize| {
            let merged = read_picture(&dir.path().join(format!("out/pano-00{}.exr", s + 1))).unwrap().pixels;
            let truth = camera.view(&scenes[s], &Pose::default(), None);
            let mut ratios: Vec<f32> = merged
                .pixels()
                .zip(truth.pixels())
                .filter(|(_, t)| (0.05..3.0).contains(&t.0[1]))
                .map(|(m, t)| m.0[1] / t.0[1])
                .collect();
            ratios.sort_by(f32::total_cmp);
            ratios[ratios.len() / 2]
        };
        median(0) / median(1)
    };
    let common = ratio(&[]);
    assert!((common.ln()).abs() < 0.1, "{common}");
    assert!((ratio(&["--scale=common"]) / common - 1.0).abs() < 1e-3);
    let run = translume(dir.path(), &["hdr", "pano", "--group=3", "-o", "out"]);
    assert!(run.status == 0 && run.stderr.contains("--scale"), "{}", run.stderr);
}

/// `--group` is taken at its word: shots of two scenes in one group are merged, but not without a word, aligned or not.
#[test]
fn strangers_in_one_group_are_said() {
    let dir = tempdir().unwrap();
    let shoot = dir.path().join("mixed");
    fs::create_dir(&shoot).unwrap();
    let camera = Camera { size: (240, 180), ..camera() };
    let write = |number: u32, shot: usize| {
        let shots = shots_of(&another_scene(number), &Pose::default(), &camera, &SECS);
        jpeg(&shoot.join(format!("{shot}.jpg")), camera.size, &shots[shot], Some(SECS[shot]), 97);
    };
    (0..3).for_each(|shot| write(1, shot));
    for preset in ["tripod", "handheld"] {
        let warnings = |options: &[&str]| {
            let preset = format!("--preset={preset}");
            let told = hdr(dir.path(), &[&["mixed", "--group=3", &preset, "-o", "out"], options].concat());
            told["warnings"].as_array().unwrap().iter().map(|w| w.to_string()).collect::<Vec<_>>()
        };
        assert!(warnings(&[]).is_empty(), "{preset}: {:?}", warnings(&[]));
        write(2, 2);
        assert!(warnings(&[]).iter().any(|w| w.contains("2.jpg") && w.contains("scene")), "{preset}");
        write(1, 2);
    }
}

#[test]
fn exposures_that_contradict_the_pixels_are_an_error() {
    let dir = tempdir().unwrap();
    common::bracket::usual(dir.path());
    for (list, mark) in [("a.png 60\nb.png 15\nc.png 4\n", "1/t"), ("a.png 1/15\nb.png 1/60\nc.png 1/4\n", "order")] {
        fs::write(dir.path().join("list.txt"), list).unwrap();
        let run = translume(dir.path(), &["hdr", "a.png", "b.png", "c.png", "--list=list.txt", "-o", "out.exr"]);
        let error = run.error(1);
        assert!(error.contains("contradict") && error.contains(mark), "{error}");
        assert!(!dir.path().join("out.exr").exists());
    }
    let run = translume(dir.path(), &["hdr", "a.png", "b.png", "--exposures=1,1", "-o", "out.exr"]);
    let error = run.error(1);
    assert!(error.contains("same exposure") && error.contains("the pixels say about +0.0, +"), "{error}");
}

#[test]
fn strips_of_any_shape_are_merged() {
    for (w, h) in [(1usize, 300usize), (400, 1), (3, 2000), (1500, 20)] {
        let dir = tempdir().unwrap();
        let light = |i: usize| 0.02 + 0.9 * (((i % w) / 3 * 37 + (i / w) / 3 * 61) % 101) as f32 / 101.0;
        for (k, gain) in [0.25f32, 1.0, 4.0].iter().enumerate() {
            let code = |i: usize| (255.0 * response((0.3 * gain * light(i)).min(1.0))) as u8;
            let rgb: Vec<u8> = (0..w * h).flat_map(|i| [code(i); 3]).collect();
            write_png8(&dir.path().join(format!("{k}.png")), (w, h), &rgb).unwrap();
        }
        let json = hdr(dir.path(), &["0.png", "1.png", "2.png", "--ev=-2,0,2", "-o", "o.exr"]);
        let out = read_picture(&dir.path().join("o.exr")).unwrap().pixels;
        assert_eq!(out.dimensions(), (w as u32, h as u32), "{json}");
        assert!(out.iter().all(|v| v.is_finite()));
    }
}

#[test]
fn a_turned_camera_is_found_and_another_scene_is_said() {
    let dir = tempdir().unwrap();
    let camera = camera();
    let write = |name: &str, rgb: &[u8]| write_png8(&dir.path().join(name), camera.size, rgb).unwrap();
    let still = shots_of(&scene(), &Pose::default(), &camera, &SECS);
    write("a.png", &still[0]);
    write("b.png", &still[1]);
    let turned = Pose { rotation_rad: 27f64.to_radians(), shift_px: [4.0, 2.0] };
    write("turned.png", &shots_of(&scene(), &turned, &camera, &SECS)[2]);
    write("other.png", &shots_of(&another_scene(2), &Pose::default(), &camera, &SECS)[2]);
    let run =
        |third| hdr(dir.path(), &["a.png", "b.png", third, EXPOSURES, "--anchor=1", "--fields=fields", "-o", "o.exr"]);
    let json = run("turned.png");
    let planes = read_exr_channels(&dir.path().join("fields/02-turned.exr"), 0).unwrap();
    let channel = |n: &str| &planes.planes.iter().find(|c| c.0 == n).unwrap().1;
    let (w, h) = camera.size;
    let mut errors = Vec::new();
    for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
        let place = turned.place([x as f64, y as f64], camera.size);
        if (4.0..w as f64 - 4.0).contains(&place[0]) && (4.0..h as f64 - 4.0).contains(&place[1]) {
            let found = [x as f64 + f64::from(channel("X")[y * w + x]), y as f64 + f64::from(channel("Y")[y * w + x])];
            errors.push((found[0] - place[0]).hypot(found[1] - place[1]));
        }
    }
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    assert!(mean < 1.0, "{mean} px off; {}", json["images"][2]["affine"]);
    assert_eq!(json["warnings"], serde_json::json!([]));
    let json = run("other.png");
    let said = json["warnings"].to_string();
    assert!(said.contains("other.png") && said.contains("no motion found"), "{said}");
}
