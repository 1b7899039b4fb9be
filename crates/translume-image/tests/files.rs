//! Every format: what is written reads back, with its facts.

use image::{Rgb, Rgb32FImage};
use translume_image::*;

fn ramp(width: u32, height: u32) -> Picture {
    Picture::new(Rgb32FImage::from_fn(width, height, |x, y| {
        Rgb([0.01 * x as f32, 3.5 * y as f32 + 0.25, (0.5 * (x + 2 * y) as f32).exp2() * 1e-3])
    }))
}

fn close(a: &Picture, b: &Picture, relative: f32) {
    assert_eq!(a.pixels.dimensions(), b.pixels.dimensions());
    for (p, q) in a.pixels.pixels().zip(b.pixels.pixels()) {
        let largest = p.0.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        for c in 0..3 {
            assert!((p[c] - q[c]).abs() <= relative * largest, "{p:?} {q:?}");
        }
    }
}

#[test]
fn float_formats_read_back() {
    let dir = tempfile::tempdir().unwrap();
    let picture = ramp(19, 11);
    let at = |name: &str| dir.path().join(name);
    write_pfm(&at("ä b.pfm"), &picture).unwrap();
    close(&picture, &read_picture(&at("ä b.pfm")).unwrap(), 0.0);
    write_tiff_float(&at("a.tif"), &picture).unwrap();
    close(&picture, &read_picture(&at("a.tif")).unwrap(), 0.0);
    write_hdr(&at("a.hdr"), &picture).unwrap();
    // Eight bits for the largest of three, rounded: half a code of at least 128.
    close(&picture, &read_picture(&at("a.hdr")).unwrap(), 0.5 / 128.0);
    for compression in [ExrCompression::None, ExrCompression::Rle, ExrCompression::Zip, ExrCompression::Piz] {
        for (precision, error) in [(Precision::Float, 0.0), (Precision::Half, 1.0 / 2048.0)] {
            let options = ExrOptions { precision, compression, ..ExrOptions::default() };
            write_exr(&at("a.exr"), &picture, &options).unwrap();
            close(&picture, &read_picture(&at("a.exr")).unwrap(), error);
        }
    }
}

#[test]
fn exr_keeps_the_facts_alpha_and_what_half_cannot_hold() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.exr");
    let mut picture = ramp(4, 3);
    picture.pixels.put_pixel(0, 0, Rgb([1e9, f32::NAN, f32::NEG_INFINITY]));
    picture.alpha = Some((0..12).map(|i| i as f32 / 16.0).collect());
    picture.metadata = Metadata {
        exposure_secs: Some(0.125),
        f_number: Some(2.0),
        iso: Some(400.0),
        camera: Some("Acme One".into()),
        owner: Some("Zoë".into()),
        date_time: Some("2026:01:02 03:04:05".into()),
        ..Metadata::default()
    };
    let options = ExrOptions {
        software: Some("translume 1".into()),
        command: Some("translume hdr 'Ω.jpg'".into()),
        seed: Some(7),
        comments: Some("two lines\nof text".into()),
        ..ExrOptions::default()
    };
    write_exr(&path, &picture, &options).unwrap();
    let back = read_picture(&path).unwrap();
    assert_eq!(back.metadata, picture.metadata);
    assert_eq!(back.alpha, picture.alpha);
    assert_eq!(back.pixels.get_pixel(0, 0)[0], 65504.0);
    assert_eq!(back.pixels.get_pixel(0, 0)[2], -65504.0);
    assert_eq!(back.count_non_finite(), 1);
    let parts = read_exr_parts(&path).unwrap();
    let text = |key: &str| parts[0].texts.iter().find(|t| t.0 == key).map(|t| t.1.as_str());
    assert_eq!(text("software"), Some("translume 1"));
    assert_eq!(text("seed"), Some("7"));
    assert_eq!(text("command"), Some("translume hdr '?.jpg'"));
}

#[test]
fn integer_files_keep_their_bits_as_codes_and_become_linear_as_pictures() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.png");
    let codes8: Vec<u8> = (0..5 * 4 * 3).map(|i| (i * 4) as u8).collect();
    write_png8(&path, (5, 4), &codes8).unwrap();
    assert_eq!(read_codes(&path).unwrap().samples, Samples::U8(codes8.clone()));
    let linear = read_picture(&path).unwrap();
    for (code, v) in codes8.iter().zip(linear.pixels.as_raw()) {
        assert!((colour::srgb_to_linear(f32::from(*code) / 255.0) - v).abs() < 1e-7);
    }
    let codes16: Vec<u16> = (0..5 * 4 * 3).map(|i| i * 1001 + 3).collect();
    write_png16(&path, (5, 4), &codes16).unwrap();
    assert_eq!(read_codes(&path).unwrap().samples, Samples::U16(codes16.clone()));
    write_tiff16(&dir.path().join("a.tif"), (5, 4), &codes16).unwrap();
    assert_eq!(read_codes(&dir.path().join("a.tif")).unwrap().samples, Samples::U16(codes16));
    write_gray_png(&path, (3, 2), &[0, 50, 100, 150, 200, 250]).unwrap();
    let gray = read_codes(&path).unwrap();
    assert_eq!((gray.width, gray.height, gray.unit(5)), (3, 2, 50.0 / 255.0));
}

#[test]
fn named_layers_are_written_and_read() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("field.exr");
    let (x, y): (Vec<f32>, Vec<f32>) = (0..35).map(|i| (i as f32 - 7.5, i as f32 * 1e-3)).unzip();
    let options = ExrOptions { precision: Precision::Float, ..ExrOptions::default() };
    write_exr_channels(&path, (7, 5), &[("Y", &y), ("X", &x)], &options).unwrap();
    let read = read_exr_channels(&path, 0).unwrap();
    assert_eq!((read.width, read.height), (7, 5));
    assert_eq!(read.planes, [("X".to_owned(), x.clone()), ("Y".to_owned(), y.clone())]);

    let names = ["albedo.R", "albedo.G", "albedo.B", "depth.Z"];
    write_exr_channels(&path, (7, 5), &names.map(|n| (n, x.as_slice())), &options).unwrap();
    assert_eq!(read_picture(&path).unwrap().pixels.get_pixel(2, 1)[1], x[9]);
    assert!(write_exr_channels(&path, (7, 5), &[("X", &x[..34])], &options).is_err());
    assert!(write_exr_channels(&path, (7, 5), &[("X", &x), ("X", &y)], &options).is_err());
}

#[test]
fn tga_files_are_read_and_damaged_ones_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.TGA");
    // 3 × 2, 24 bits, top row first, run-length coded: a run of two pixels, one alone, a run of three; blue first.
    let mut file = vec![0, 0, 10, 0, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0, 2, 0, 24, 0x20];
    file.extend([0x81, 0, 0, 255, 0x00, 10, 20, 30, 0x82, 255, 255, 255]);
    std::fs::write(&path, &file).unwrap();
    let codes = read_codes(&path).unwrap();
    let mut expected = vec![255, 0, 0, 255, 0, 0, 30, 20, 10];
    expected.extend([255; 9]);
    assert_eq!((codes.width, codes.height, codes.samples), (3, 2, Samples::U8(expected)));
    assert_eq!(Format::of_file(&path).unwrap(), Format::Tga);
    for cut in 0..file.len() {
        std::fs::write(&path, &file[..cut]).unwrap();
        assert!(read_codes(&path).is_err(), "{cut}");
    }
    // A header cannot ask for memory that the file could not fill.
    file[12..16].fill(0xff);
    std::fs::write(&path, &file).unwrap();
    assert!(read_codes(&path).is_err());
}

#[test]
fn jpeg_keeps_a_smooth_picture() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.jpg");
    let rgb: Vec<u8> = (0..3 * 40 * 30).map(|i| (60 + i / 3 % 40 * 3 + i % 3 * 20) as u8).collect();
    write_jpeg(&path, (40, 30), &rgb, 95).unwrap();
    let Samples::U8(back) = read_codes(&path).unwrap().samples else { panic!("8 bits") };
    assert!(rgb.iter().zip(&back).all(|(a, b)| a.abs_diff(*b) <= 6));
    assert!(write_jpeg(&path, (40, 31), &rgb, 95).is_err());
}

#[test]
fn pfm_headers_may_end_in_cr_lf_and_hold_comments() {
    let values: Vec<f32> = (0..12).map(|i| i as f32 / 6.0).collect();
    let pixels: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    let upright: Vec<f32> = values[6..].iter().chain(&values[..6]).copied().collect();
    for header in
        ["PF\n2 2\n-1.0\n", "PF\r\n2 2\r\n-1.0\r\n", "PF\n# made by hand\n2 2\n# twice\n-1.0\n", "PF 2 2 -1.0\r"]
    {
        let file = [header.as_bytes(), &pixels].concat();
        let picture = decode_picture(&file, std::path::Path::new("a.pfm")).unwrap();
        assert_eq!(*picture.pixels.as_raw(), upright, "{header:?}");
    }
    // A carriage return alone, and a first pixel that begins with the byte of a line feed.
    let mut odd = pixels;
    odd[0] = b'\n';
    let file = [b"PF\r2 2\r-1.0\r".as_slice(), &odd].concat();
    let picture = decode_picture(&file, std::path::Path::new("a.pfm")).unwrap();
    assert_eq!(picture.pixels.get_pixel(0, 1)[0], f32::from_le_bytes([b'\n', 0, 0, 0]));
    assert_eq!(picture.pixels.get_pixel(1, 0)[2], values[11]);
    // A positive scale is the other byte order, and a factor.
    let big: Vec<u8> = values.iter().flat_map(|v| v.to_be_bytes()).collect();
    let picture =
        decode_picture(&[b"PF\n2 2\n0.5\n".as_slice(), &big].concat(), std::path::Path::new("a.pfm")).unwrap();
    assert_eq!(picture.pixels.get_pixel(0, 1)[1], values[1] / 2.0);
}
