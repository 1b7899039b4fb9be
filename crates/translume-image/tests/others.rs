//! Files that other programs wrote (tests/data/make.py says how).

use std::path::{Path, PathBuf};
use translume_image::*;

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn read(name: &str) -> Picture {
    read_picture(&data(name)).unwrap()
}

/// The picture that most of the float files hold.
fn truth(x: u32, y: u32) -> [f32; 3] {
    let (x, y) = (x as f32, y as f32);
    [0.1 + x / 16.0, 0.2 + y / 8.0, 0.05 + (x + y) / 32.0]
}

fn assert_near(name: &str, (x, y): (u32, u32), got: [f32; 3], expected: [f32; 3], tolerance: f32) {
    for c in 0..3 {
        assert!((got[c] - expected[c]).abs() <= tolerance, "{name} ({x}, {y}): {got:?} instead of {expected:?}");
    }
}

fn assert_truth(name: &str, tolerance: f32) {
    let picture = read(name);
    assert_eq!(picture.pixels.dimensions(), (24, 20), "{name}");
    for (x, y, p) in picture.pixels.enumerate_pixels() {
        assert_near(name, (x, y), p.0, truth(x, y), tolerance);
    }
}

#[test]
fn tiled_multi_part_and_named_layers() {
    assert_truth("tiled.exr", 1e-3);
    assert_truth("multipart.exr", 0.0);
    assert_truth("layers.exr", 0.0);
    let parts = read_exr_parts(&data("multipart.exr")).unwrap();
    assert_eq!(parts.iter().map(|p| p.name.as_deref().unwrap()).collect::<Vec<_>>(), ["depth", "beauty"]);
    assert_eq!(read_exr_parts(&data("tiled.exr")).unwrap()[0].tiles, Some([16, 8]));
    for (file, layer) in [("layers.exr", "albedo"), ("multipart.exr", "beauty")] {
        assert_eq!(read_layer(&data(file), layer).unwrap().pixels, read(file).pixels);
    }
    assert_eq!(read_layer(&data("multipart.exr"), "depth").unwrap().pixels.get_pixel(7, 3).0, [7.0; 3]);
    let error = read_layer(&data("layers.exr"), "normal").unwrap_err().to_string();
    assert!(error.contains("normal") && error.contains("it has albedo, depth"), "{error}");
    assert!(read_layer(&data("gray.jpg"), "albedo").is_err());
    let depth = read_exr_channels(&data("multipart.exr"), 0).unwrap();
    assert_eq!((depth.width, depth.height, depth.planes[0].0.as_str()), (24, 20, "Z"));
    assert_eq!(depth.planes[0].1[24 + 5], 5.0);
    assert!(read_exr_channels(&data("multipart.exr"), 2).is_err());
}

#[test]
fn deep_pictures_are_refused_in_words() {
    let error = read_picture(&data("deep.exr")).unwrap_err();
    assert!(matches!(error, Error::Unsupported { .. }) && error.to_string().contains("deep"), "{error}");
}

#[test]
fn the_display_window_is_the_picture() {
    // Stored are columns 2 to 25 and rows 3 to 22; shown are columns -4 to 25 and rows 8 to 23.
    let picture = read("windows.exr");
    assert_eq!(picture.pixels.dimensions(), (30, 16));
    for (x, y, p) in picture.pixels.enumerate_pixels() {
        let expected = if x >= 6 && y < 15 { truth(x - 6, y + 5) } else { [0.0; 3] };
        assert_eq!(p.0, expected, "({x}, {y})");
    }
}

#[test]
fn luminance_and_chroma_in_every_compression() {
    for compression in ["none", "rle", "zips", "zip", "piz"] {
        let name = format!("chroma-{compression}.exr");
        let picture = read(&name);
        assert_eq!(picture.pixels.dimensions(), (24, 20));
        for (x, y, p) in picture.pixels.enumerate_pixels() {
            let t = truth(x, y);
            let lum = 0.212_639 * t[0] + 0.715_168_7 * t[1] + 0.072_192_3 * t[2];
            // Samples sit on even pixels; the last odd column and row have no second one to interpolate with.
            let (cx, cy) = ((x as f32).min(22.0), (y as f32).min(18.0));
            let (r, b) = (lum * (1.2 + cx / 64.0 - cy / 128.0), lum * (0.9 - cx / 128.0 + cy / 256.0));
            let g = (lum - 0.212_639 * r - 0.072_192_3 * b) / 0.715_168_7;
            assert_near(&name, (x, y), p.0, [r, g, b], 4e-3);
        }
    }
    let gray = read("luminance.exr");
    let p = gray.pixels.get_pixel(3, 4).0;
    assert!(p[0] == p[1] && p[1] == p[2] && p[0] > 0.4);
}

/// Red, green / blue, gray in blocks of eight pixels, as sRGB codes.
fn assert_patches(name: &str, turned: bool, tolerance: f32) {
    let codes = read_codes(&data(name)).unwrap();
    assert_eq!((codes.width, codes.height), (16, 16), "{name}");
    let [r, g, b, gray] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [128.0 / 255.0; 3]];
    // Orientation 6 turns the stored picture clockwise.
    let rows = if turned { [[b, r], [gray, g]] } else { [[r, g], [b, gray]] };
    for (y, row) in rows.into_iter().enumerate() {
        for (x, expected) in row.into_iter().enumerate() {
            let i = 3 * ((8 * y + 4) * 16 + 8 * x + 4);
            let got = [codes.unit(i), codes.unit(i + 1), codes.unit(i + 2)];
            assert_near(name, (x as u32, y as u32), got, expected, tolerance);
        }
    }
}

#[test]
fn orientation_and_the_facts_of_the_shot() {
    for name in ["turned.jpg", "turned.png", "turned.tif"] {
        assert_patches(name, true, 0.02);
        let m = read_codes(&data(name)).unwrap().metadata;
        assert_eq!(m.camera.as_deref(), Some("Acme One"), "{name}");
        if name != "turned.tif" {
            assert_eq!((m.exposure_secs, m.f_number, m.iso), (Some(0.125), Some(2.8), Some(400.0)), "{name}");
            assert_eq!(m.owner.as_deref(), Some("Nobody"));
            assert_eq!(m.date_time.as_deref(), Some("2026:01:02 03:04:05"));
        }
    }
}

#[test]
fn gray_palette_progressive_and_alpha() {
    assert_patches("progressive.jpg", false, 0.02);
    assert_patches("palette.png", false, 0.0);
    assert_patches("alpha.png", false, 0.0);
    let picture = read("alpha.png");
    let alpha = picture.alpha.as_ref().unwrap();
    assert!((0..256).all(|i| (alpha[i] - i as f32 / 255.0).abs() < 1e-6));
    assert_eq!(picture.pixels.get_pixel(3, 2).0, [alpha[35], 0.0, 0.0], "light is multiplied by alpha");
    let gray = read_codes(&data("gray.jpg")).unwrap();
    assert_eq!((gray.width, gray.height), (8, 6));
    assert!((gray.unit(3 * 47) - 1.0).abs() < 0.02 && gray.unit(0) < 0.02);
    assert_eq!(gray.unit(60), gray.unit(61));
    let bits = read_codes(&data("one-bit.png")).unwrap();
    assert_eq!((bits.unit(0), bits.unit(3 * 47)), (0.0, 1.0));
}

#[test]
fn a_profile_of_srgb_changes_nothing() {
    let (with, without) = (read("srgb-profile.png"), read("palette.png"));
    assert!(read_codes(&data("srgb-profile.png")).unwrap().metadata.icc.is_some());
    for (x, y, p) in with.pixels.enumerate_pixels() {
        assert_near("srgb-profile.png", (x, y), p.0, without.pixels.get_pixel(x, y).0, 1e-3);
    }
}

#[test]
fn tiff_in_floats_halves_tiles_planes_and_either_byte_order() {
    let gray = read("gray-float.tif");
    assert_eq!(gray.pixels.get_pixel(5, 7).0, [truth(5, 7)[0]; 3]);
    let half = read("half-tiled.tif");
    assert_eq!(half.pixels.dimensions(), (32, 32));
    assert_near("half-tiled.tif", (9, 11), half.pixels.get_pixel(9, 11).0, truth(9, 11), 2e-3);
    for name in ["planes.tif", "big-endian.tif"] {
        let codes = read_codes(&data(name)).unwrap();
        let Samples::U16(v) = codes.samples else { panic!("{name}: not 16 bits") };
        let i = 3 * (11 * 24 + 9);
        assert_eq!(v[i..i + 3], truth(9, 11).map(|v| (v * 8000.0) as u16), "{name}");
    }
}

/// Inputs that once crashed a reader.
#[test]
fn what_crashed_once_is_an_error_or_a_picture() {
    let files: Vec<_> = std::fs::read_dir(data("crashes")).unwrap().map(|f| f.unwrap().path()).collect();
    assert!(!files.is_empty());
    for file in files {
        // Three bits a sample are read by now.
        let sound = file.ends_with("three-bit-gray.tif");
        assert_eq!(read_picture(&file).is_ok(), sound, "{}", file.display());
    }
}
