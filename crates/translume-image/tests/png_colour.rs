//! What PNG files say about colour and about the shot (PNG third edition §§ 4.3, 11.3.2).

mod support;

use std::path::Path;
use support::{chunk, near, png, read, read_quietly, zlib};
use translume_image::colour::{Space, srgb_to_linear};
use translume_image::{Samples, TextureCodes, decode_codes, decode_texture};

fn sixteen(codes: &[u16]) -> Vec<u8> {
    codes.iter().flat_map(|c| c.to_be_bytes()).collect()
}

fn number(v: f64) -> [u8; 4] {
    ((v * 1e5).round() as u32).to_be_bytes()
}

fn gama(exponent: f64) -> Vec<u8> {
    chunk(b"gAMA", &number(exponent))
}

/// White first, then red, green, blue.
fn chrm(space: &Space) -> Vec<u8> {
    let [r, g, b] = space.primaries;
    chunk(b"cHRM", &[space.white, r, g, b].as_flattened().iter().flat_map(|v| number(*v)).collect::<Vec<u8>>())
}

/// The profile that moxcms has for Display P3.
fn p3() -> Vec<u8> {
    moxcms::ColorProfile::new_display_p3().encode().unwrap()
}

fn iccp(profile: &[u8]) -> Vec<u8> {
    chunk(b"iCCP", &[b"p\0\0".as_slice(), &zlib(profile)].concat())
}

/// Display P3 red in linear Rec. 709.
const P3_RED: [f32; 3] = [1.2249, -0.0420, -0.0196];

#[test]
fn pq_of_rec2020_is_light_over_reference_white() {
    // ST 2084: codes of 100, 203, 1000 and 10000 cd/m².
    let codes = [33297, 38056, 49271, 65535];
    let row: Vec<u16> = codes.iter().flat_map(|c| [*c; 3]).collect();
    let cicp = chunk(b"cICP", &[9, 16, 0, 1]);
    let got = read_quietly("a.png", &png(4, 16, 2, &sixteen(&row), std::slice::from_ref(&cicp), &[])).pixels;
    let light: Vec<f32> = [100.0f32, 203.0, 1000.0, 10000.0].iter().flat_map(|l| [l / 203.0; 3]).collect();
    near(got.as_raw(), &light, 1e-3);
    // Gray likewise, and the red of Rec. 2020 by the matrix of BT.2087, inverted: 1.6605, -0.1246, -0.0182.
    let gray = read_quietly("a.png", &png(4, 16, 0, &sixteen(&codes), std::slice::from_ref(&cicp), &[])).pixels;
    near(gray.as_raw(), &light, 1e-3);
    let red = read_quietly("a.png", &png(1, 16, 2, &sixteen(&[38056, 0, 0]), &[cicp], &[])).pixels;
    near(red.as_raw(), &[1.6605, -0.1246, -0.0182], 1e-3);
}

#[test]
fn code_points_come_before_profile_gamma_and_primaries_and_a_profile_before_those() {
    let white = [255u8, 0, 0];
    let all = [chunk(b"cICP", &[1, 8, 0, 1]), iccp(&p3()), gama(0.25), chrm(&Space::REC2020)];
    near(read_quietly("a.png", &png(1, 8, 2, &[64, 0, 0], &all, &[])).pixels.as_raw(), &[64.0 / 255.0, 0.0, 0.0], 1e-4);
    near(read_quietly("a.png", &png(1, 8, 2, &white, &all[1..], &[])).pixels.as_raw(), &P3_RED, 1e-3);
    let red = read_quietly("a.png", &png(1, 8, 2, &white, &all[2..], &[])).pixels;
    near(red.as_raw(), &[1.6605, -0.1246, -0.0182], 1e-3);
    // sRGB before gAMA and cHRM.
    let srgb = [chunk(b"sRGB", &[0]), gama(0.25), chrm(&Space::REC2020)];
    let got = read_quietly("a.png", &png(1, 8, 2, &[128, 0, 0], &srgb, &[])).pixels;
    near(got.as_raw(), &[srgb_to_linear(128.0 / 255.0), 0.0, 0.0], 1e-5);
}

#[test]
fn narrow_range_and_hlg() {
    let narrow = chunk(b"cICP", &[1, 8, 0, 0]);
    let got = read_quietly("a.png", &png(3, 8, 0, &[16, 126, 235], &[narrow], &[])).pixels;
    near(got.as_raw(), &[0.0, 0.0, 0.0, 110.0 / 219.0, 110.0 / 219.0, 110.0 / 219.0, 1.0, 1.0, 1.0], 1e-5);
    let (hlg, said) = read("a.png", &png(2, 16, 0, &sixteen(&[49151, 32768]), &[chunk(b"cICP", &[9, 18, 0, 1])], &[]));
    // 75 % is reference white; half the signal is a twelfth of the full one: 1 / 12 / 0.26496.
    near(hlg.pixels.as_raw(), &[1.0, 1.0, 1.0, 0.3145, 0.3145, 0.3145], 1e-3);
    assert!(said.len() == 1 && said[0].contains("HLG"), "{said:?}");
}

#[test]
fn code_points_that_say_nothing_are_a_warning() {
    // Unspecified; a matrix of YCbCr, and a range, that PNG does not have; too short.
    for data in [&[2, 2, 0, 1][..], &[9, 16, 9, 1], &[9, 16, 0, 7], &[9, 16]] {
        let (got, said) = read("a.png", &png(1, 8, 0, &[51], &[chunk(b"cICP", data), gama(1.0)], &[]));
        near(got.pixels.as_raw(), &[0.2; 3], 1e-5);
        assert!(said.len() == 1 && said[0].contains("cICP"), "{said:?}");
    }
}

#[test]
fn gamma_and_primaries_of_every_kind_of_png() {
    let linear = [gama(1.0), chrm(&Space::REC2020)];
    let red = [1.6605, -0.1246, -0.0182];
    let half = red.map(|v| v * 32768.0 / 65535.0);
    near(read_quietly("a.png", &png(1, 16, 2, &sixteen(&[32768, 0, 0]), &linear, &[])).pixels.as_raw(), &half, 1e-3);
    // A palette; gray of two bits; alpha multiplies.
    let palette = [linear[0].clone(), linear[1].clone(), chunk(b"PLTE", &[255, 0, 0])];
    near(read_quietly("a.png", &png(1, 8, 3, &[0], &palette, &[])).pixels.as_raw(), &red, 1e-3);
    near(read_quietly("a.png", &png(1, 2, 0, &[0b0100_0000], &linear, &[])).pixels.as_raw(), &[1.0 / 3.0; 3], 1e-4);
    let got = read_quietly("a.png", &png(1, 8, 6, &[255, 0, 0, 51], &linear, &[]));
    near(got.pixels.as_raw(), &red.map(|v| v / 5.0), 1e-3);
    // A white that is not D65 stays white, by Bradford.
    let d50 = Space { white: [0.3457, 0.3585], ..Space::REC709 };
    let got = read_quietly("a.png", &png(1, 8, 2, &[255, 255, 255], &[gama(1.0), chrm(&d50)], &[]));
    near(got.pixels.as_raw(), &[1.0; 3], 1e-3);
    // gAMA 0.5 is a square; 0.45455 alone is how sRGB was said.
    near(read_quietly("a.png", &png(1, 8, 0, &[51], &[gama(0.5)], &[])).pixels.as_raw(), &[0.04; 3], 1e-4);
    near(
        read_quietly("a.png", &png(1, 8, 0, &[51], &[gama(0.45455)], &[])).pixels.as_raw(),
        &[srgb_to_linear(0.2); 3],
        1e-5,
    );
}

#[test]
fn damaged_colour_is_a_warning() {
    let sound = srgb_to_linear(128.0 / 255.0);
    let mut torn = iccp(&p3());
    let length = torn.len();
    torn[length - 30] ^= 0x55; // the checksum does not fit any more
    let flat =
        chunk(b"cHRM", &[0.3, 0.3, 0.1, 0.1, 0.2, 0.2, 0.3, 0.3].iter().flat_map(|v| number(*v)).collect::<Vec<_>>());
    let not_packed = chunk(b"iCCP", b"p\0\0no zlib stream");
    let no_profile = iccp(b"no profile at all");
    for (damaged, word) in [(torn, "iCCP"), (not_packed, "ICC"), (no_profile, "ICC"), (flat, "cHRM")] {
        let (got, said) = read("a.png", &png(1, 8, 2, &[128; 3], &[damaged], &[]));
        near(got.pixels.as_raw(), &[sound; 3], 1e-5);
        assert!(said.len() == 1 && said[0].starts_with("a.png: ") && said[0].contains(word), "{said:?}");
    }
}

#[test]
fn textures_take_their_meaning_from_the_scene() {
    let chunks = [chunk(b"cICP", &[9, 16, 0, 1]), iccp(&p3()), gama(1.0), chrm(&Space::REC2020)];
    for from in 0..4 {
        let file = png(2, 8, 2, &[128, 0, 0, 255, 255, 255], &chunks[from..], &[turned_exif()]);
        let srgb = decode_texture(&file, Path::new("a.png"), TextureCodes::Srgb).unwrap().pixels;
        assert_eq!(srgb.dimensions(), (2, 1), "not turned by EXIF");
        near(&srgb.as_raw()[..3], &[srgb_to_linear(128.0 / 255.0), 0.0, 0.0], 1e-6);
        let stored = decode_texture(&file, Path::new("a.png"), TextureCodes::Stored).unwrap().pixels;
        near(&stored.as_raw()[..3], &[128.0 / 255.0, 0.0, 0.0], 1e-6);
    }
}

/// Little-endian EXIF: orientation 6 and, in its own directory, an exposure time of 1/60.
fn exif_block() -> Vec<u8> {
    let entry = |tag: u16, kind: u16, count: u32, value: u32| {
        [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &count.to_le_bytes(), &value.to_le_bytes()].concat()
    };
    let mut out = b"II*\0\x08\0\0\0\x02\0".to_vec();
    out.extend(entry(0x0112, 3, 1, 6));
    out.extend(entry(0x8769, 4, 1, 38));
    out.extend([0; 4]);
    assert_eq!(out.len(), 38);
    out.extend(1u16.to_le_bytes());
    out.extend(entry(0x829a, 5, 1, 56));
    out.extend([0; 4]);
    out.extend([1u32.to_le_bytes(), 60u32.to_le_bytes()].concat());
    out
}

fn turned_exif() -> Vec<u8> {
    chunk(b"eXIf", &exif_block())
}

#[test]
fn exif_in_text_chunks_is_read() {
    let block = [b"Exif\0\0".as_slice(), &exif_block()].concat();
    let hex: String = block.iter().map(|b| format!("{b:02x}")).collect();
    let lines =
        hex.as_bytes().chunks(72).map(|l| String::from_utf8_lossy(l).into_owned()).collect::<Vec<_>>().join("\n");
    let text = |name: &str| format!("\n{name}\n{:8}\n{lines}\n", block.len());
    let key = |name: &str| format!("Raw profile type {name}\0").into_bytes();
    let plain = [key("exif"), text("exif").into_bytes()].concat();
    let packed = [key("APP1"), vec![0], zlib(text("app1").as_bytes())].concat();
    let utf8 = [key("exif"), vec![1, 0, 0, 0], zlib(text("exif").as_bytes())].concat();
    let row = [1u8, 2, 3, 4, 5, 6];
    for chunk in [chunk(b"tEXt", &plain), chunk(b"zTXt", &packed), chunk(b"iTXt", &utf8), turned_exif()] {
        for (before, behind) in [(vec![chunk.clone()], vec![]), (vec![], vec![chunk.clone()])] {
            let codes = decode_codes(&png(2, 8, 2, &row, &before, &behind), Path::new("a.png")).unwrap();
            assert!((codes.metadata.exposure_secs.unwrap() - 1.0 / 60.0).abs() < 1e-9);
            assert_eq!((codes.width, codes.height, codes.samples), (1, 2, Samples::U8(row.to_vec())), "turned");
        }
    }
    // A profile that is none, and text that is something else, say nothing.
    let other = [chunk(b"tEXt", b"Raw profile type exif\0\nexif\n 9\nzz\n"), chunk(b"tEXt", b"Comment\0exif")];
    let codes = decode_codes(&png(2, 8, 2, &row, &other, &[]), Path::new("a.png")).unwrap();
    assert_eq!((codes.width, codes.metadata.exposure_secs), (2, None));
}

#[test]
fn pixels_that_are_cut_are_an_error() {
    let whole = png(3, 8, 0, &[1, 2, 3], &[], &[]);
    assert!(decode_codes(&whole, Path::new("a.png")).is_ok());
    // Too few pixels in a stream that ends well.
    let short = png(3, 8, 0, &[1], &[], &[]);
    assert!(decode_codes(&short, Path::new("a.png")).is_err());
}

#[test]
fn palettes_that_are_cut_are_an_error_and_no_panic() {
    for colours in [&[][..], &[1], &[1, 2], &[1, 2, 3], &[1, 2, 3, 4]] {
        // An error or a picture, as the decoder likes, for codes within the palette and beyond it.
        for row in [[0u8, 0], [0, 7]] {
            let _ = decode_codes(&png(2, 8, 3, &row, &[chunk(b"PLTE", colours)], &[]), Path::new("a.png"));
        }
    }
    let whole = png(2, 8, 3, &[0, 1], &[chunk(b"PLTE", &[1, 2, 3, 4, 5, 6])], &[]);
    assert_eq!(decode_codes(&whole, Path::new("a.png")).unwrap().samples, Samples::U8(vec![1, 2, 3, 4, 5, 6]));
}
