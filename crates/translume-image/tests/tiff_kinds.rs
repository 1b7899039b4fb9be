//! The kinds of TIFF that docs/image.md promises, written here byte by byte (TIFF 6.0, BigTIFF).

mod support;

use std::path::Path;
use support::{Field, Tiff, near, read, read_quietly, set, strip, zlib};
use translume_image::colour::srgb_to_linear;
use translume_image::{Codes, Samples, decode_codes, decode_picture, encode_jpeg};

fn codes(tiff: &Tiff) -> Codes {
    let (codes, said) = support::warnings(|| decode_codes(&tiff.bytes(), Path::new("a.tif")).unwrap());
    assert!(said.is_empty(), "{said:?}");
    codes
}

/// Values of so many bits, the highest first, each row filled up to bytes.
fn pack(values: &[u64], bits: usize, row: usize) -> Vec<u8> {
    let mut out = Vec::new();
    for line in values.chunks(row) {
        let text: String = line.iter().map(|v| format!("{v:0bits$b}")).collect();
        let text = format!("{text:0<0$}", text.len().next_multiple_of(8));
        out.extend(text.as_bytes().chunks(8).map(|b| u8::from_str_radix(std::str::from_utf8(b).unwrap(), 2).unwrap()));
    }
    out
}

/// The codes of a 3 × 2 gray picture of so many bits, as fractions.
fn fractions() -> [f64; 6] {
    [0.0, 1.0, 0.25, 0.5, 0.75, 0.4]
}

#[test]
fn integers_of_every_length_in_both_byte_orders() {
    for little in [true, false] {
        for big in [true, false] {
            for bits in [1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 24, 32, 64] {
                let full = (u64::MAX >> (64 - bits)) as f64;
                let values = fractions().map(|f| (f * full).round() as u64);
                let data = if bits >= 16 {
                    let bytes = |v: &u64| {
                        let mut b = v.to_be_bytes()[8 - bits / 8..].to_vec();
                        if little {
                            b.reverse();
                        }
                        b
                    };
                    values.iter().flat_map(bytes).collect()
                } else {
                    pack(&values, bits, 3)
                };
                let fields = strip(3, 2, &[bits as u64], 1, data.len());
                let got = codes(&Tiff { little, big, ..Tiff::new(fields, data) });
                assert_eq!(matches!(got.samples, Samples::U8(_)), [1, 2, 4, 8].contains(&bits), "{bits}");
                for (i, v) in values.iter().enumerate() {
                    let wanted = (*v as f64 / full) as f32;
                    assert!((got.unit(3 * i + 1) - wanted).abs() < 2e-5, "{bits} bits, {i}: {}", got.unit(3 * i));
                }
            }
        }
    }
}

#[test]
fn floats_of_16_24_32_and_64_bits() {
    let values = [0.5f32, -2.0, 1.0, 0.375, 100.0, 0.0];
    let half: Vec<u8> = values.iter().flat_map(|v| half::f16::from_f32(*v).to_le_bytes()).collect();
    let single: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    let double: Vec<u8> = values.iter().flat_map(|v| f64::from(*v).to_le_bytes()).collect();
    // 24 bits: exponent with bias 63, 16 bits of mantissa, cut from a single one.
    let cut = |v: &f32| {
        let (b, e) = (v.to_bits(), (v.to_bits() >> 23 & 0xff) as i32 - 127 + 63);
        let code = if *v == 0.0 { 0 } else { b >> 31 << 23 | (e as u32) << 16 | (b >> 7 & 0xffff) };
        code.to_le_bytes()[..3].to_vec()
    };
    let short: Vec<u8> = values.iter().flat_map(cut).collect();
    for (bits, data) in [(16, half), (24, short), (32, single), (64, double)] {
        let mut fields = strip(3, 2, &[bits], 1, data.len());
        set(&mut fields, 339, 3, &[3]);
        let got = read_quietly("a.tif", &Tiff::new(fields, data).bytes());
        let wanted: Vec<f32> = values.iter().flat_map(|v| [*v; 3]).collect();
        near(got.pixels.as_raw(), &wanted, 1e-6);
    }
}

#[test]
fn gray_with_alpha_of_both_kinds_and_white_that_is_zero() {
    let data = vec![100, 255, 64, 128];
    let light = |code: f32| srgb_to_linear(code / 255.0);
    let half = 128.0 / 255.0;
    // Alpha that was multiplied into the codes (1) is taken out before the curve and multiplied in behind it.
    for (extra, wanted) in [(2, [light(100.0), light(64.0) * half]), (1, [light(100.0), light(64.0 / half) * half])] {
        let mut fields = strip(2, 1, &[8, 8], 1, 4);
        set(&mut fields, 338, 3, &[extra]);
        let got = read_quietly("a.tif", &Tiff::new(fields, data.clone()).bytes());
        near(got.pixels.as_raw(), &wanted.map(|v| [v; 3]).concat(), 1e-4);
        near(&got.alpha.unwrap(), &[1.0, half], 1e-6);
    }
    // A channel that is said to be no alpha is left out, with a word.
    let mut fields = strip(2, 1, &[8, 8], 1, 4);
    set(&mut fields, 338, 3, &[0]);
    let (got, said) = read("a.tif", &Tiff::new(fields, data.clone()).bytes());
    assert!(got.alpha.is_none() && said.len() == 1 && said[0].contains("left out"), "{said:?}");
    // Alpha is not turned over with the gray.
    let mut fields = strip(2, 1, &[8, 8], 0, 4);
    set(&mut fields, 338, 3, &[2]);
    let got = read_quietly("a.tif", &Tiff::new(fields, data).bytes());
    near(&got.pixels.as_raw()[..3], &[light(155.0); 3], 1e-5);
    near(&got.alpha.unwrap(), &[1.0, half], 1e-6);
    let bits = codes(&Tiff::new(strip(8, 1, &[1], 0, 1), vec![0b1010_0000]));
    assert_eq!(bits.samples, Samples::U8([0, 255, 0, 255, 255, 255, 255, 255].map(|v| [v; 3]).concat()));
    // RGB with associated alpha and a mask behind it.
    let mut fields = strip(1, 1, &[8; 5], 2, 5);
    set(&mut fields, 338, 3, &[0, 2]);
    let (got, said) = read("a.tif", &Tiff::new(fields, vec![255, 0, 0, 7, 51]).bytes());
    near(got.pixels.as_raw(), &[0.2, 0.0, 0.0], 1e-5);
    assert_eq!(said.len(), 1, "{said:?}");
}

#[test]
fn palettes_of_4_and_8_bits() {
    // Red in the first entries, then green, then blue.
    let map = |scale: u64| -> Vec<u64> { (0..48).map(|i| (i * 5) * scale).collect() };
    for (bits, data) in [(4, vec![0x1f, 0x20]), (8, vec![1, 15, 2])] {
        for scale in [257, 256, 1] {
            let mut fields = strip(3, 1, &[bits], 3, data.len());
            let mut entries = map(scale);
            if bits == 8 {
                entries = entries.chunks(16).flat_map(|c| [c, &[0; 240]].concat()).collect();
            }
            set(&mut fields, 320, 3, &entries);
            let got = codes(&Tiff::new(fields, data.clone()));
            let wanted = [1, 15, 2].map(|i| [i * 5, (16 + i) * 5, (32 + i) * 5]).concat();
            assert_eq!(got.samples, Samples::U8(wanted), "{bits} bits, times {scale}");
        }
    }
    let mut fields = strip(2, 1, &[8], 3, 2);
    set(&mut fields, 320, 3, &[1234; 3 * 256]);
    let got = codes(&Tiff::new(fields.clone(), vec![1, 2]));
    assert_eq!(got.samples, Samples::U16(vec![1234; 6]));
    set(&mut fields, 320, 3, &[0; 6]);
    assert!(decode_codes(&Tiff::new(fields, vec![1, 2]).bytes(), Path::new("a.tif")).is_err());
}

/// 5 × 4 RGB of 16 bits.
fn ramp() -> Vec<u16> {
    (0..60).map(|i| i * 1000 + 7).collect()
}

#[test]
fn predictors_tiles_and_planes() {
    for little in [true, false] {
        let bytes = |v: &[u16]| -> Vec<u8> {
            v.iter().flat_map(|v| if little { v.to_le_bytes() } else { v.to_be_bytes() }).collect()
        };
        let make = |fields: Vec<Field>, data: Vec<u8>| codes(&Tiff { little, ..Tiff::new(fields, data) }).samples;
        let wanted = Samples::U16(ramp());
        // Differences along rows, packed.
        let mut differences = ramp();
        for row in differences.chunks_mut(15) {
            (3..15).rev().for_each(|i| row[i] = row[i].wrapping_sub(row[i - 3]));
        }
        let packed = zlib(&bytes(&differences));
        let mut fields = strip(5, 4, &[16; 3], 2, packed.len());
        set(&mut fields, 259, 3, &[8]);
        set(&mut fields, 317, 3, &[2]);
        assert_eq!(make(fields, packed), wanted);
        // Planes, two rows to a strip.
        let plane = |c: usize| ramp().iter().skip(c).step_by(3).copied().collect::<Vec<u16>>();
        let data: Vec<u8> = (0..3).flat_map(|c| bytes(&plane(c))).collect();
        let mut fields = strip(5, 4, &[16; 3], 2, data.len());
        set(&mut fields, 284, 3, &[2]);
        set(&mut fields, 278, 4, &[2]);
        set(&mut fields, 273, 4, &(0..6).map(|i| 20 * i).collect::<Vec<u64>>());
        set(&mut fields, 279, 4, &[20; 6]);
        assert_eq!(make(fields, data), wanted);
        // Tiles of 16 × 16, of which the picture fills a corner; two in a row.
        let wide: Vec<u16> = (0..20 * 3).map(|i| i as u16 * 300).collect();
        let tile = |x0: usize| {
            let mut tile = vec![0u16; 16 * 16];
            for y in 0..3 {
                (0..16usize.min(20 - x0)).for_each(|x| tile[16 * y + x] = wide[20 * y + x0 + x]);
            }
            bytes(&tile)
        };
        let data = [tile(0), tile(16)].concat();
        let mut fields = strip(20, 3, &[16], 1, 0);
        fields.retain(|f| ![273, 278, 279].contains(&f.0));
        for (tag, values) in [(322, [16].as_slice()), (323, &[16]), (324, &[0, 512]), (325, &[512, 512])] {
            set(&mut fields, tag, 4, values);
        }
        assert_eq!(make(fields, data), Samples::U16(wide.iter().flat_map(|v| [*v; 3]).collect()));
    }
}

#[test]
fn the_float_predictor_in_both_byte_orders() {
    let values = [1.5f32, -2.25, 1e-3, 7e5];
    // Highest bytes first, then differences of bytes.
    let mut row: Vec<u8> = (0..4).flat_map(|k| values.map(|v| v.to_be_bytes()[k])).collect();
    (1..16).rev().for_each(|i| row[i] = row[i].wrapping_sub(row[i - 1]));
    let mut fields = strip(4, 1, &[32], 1, 16);
    set(&mut fields, 339, 3, &[3]);
    set(&mut fields, 317, 3, &[3]);
    for little in [true, false] {
        let got = read_quietly("a.tif", &Tiff { little, ..Tiff::new(fields.clone(), row.clone()) }.bytes());
        near(got.pixels.as_raw(), &values.map(|v| [v; 3]).concat(), 0.0);
    }
}

#[test]
fn packed_by_runs_and_by_lzw() {
    let mut fields = strip(4, 2, &[8], 1, 7);
    set(&mut fields, 259, 3, &[32773]);
    let got = codes(&Tiff::new(fields.clone(), vec![0xfd, 9, 3, 1, 2, 3, 4]));
    assert_eq!(got.samples, Samples::U8([9, 9, 9, 9, 1, 2, 3, 4].map(|v| [v; 3]).concat()));
    let lzw = weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8).encode(&[5, 6, 5, 6, 5, 6, 5, 6]);
    let lzw = lzw.unwrap();
    set(&mut fields, 259, 3, &[5]);
    set(&mut fields, 279, 4, &[lzw.len() as u64]);
    assert_eq!(codes(&Tiff::new(fields, lzw)).samples, Samples::U8([5, 6, 5, 6, 5, 6, 5, 6].map(|v| [v; 3]).concat()));
}

#[test]
fn ycbcr_in_jpeg_and_with_chroma_at_half_resolution() {
    let rgb: Vec<u8> = (0..16 * 16).flat_map(|i| [(i % 16 * 12) as u8, (i / 16 * 12) as u8, 90]).collect();
    let jpeg = encode_jpeg((16, 16), &rgb, 100).unwrap();
    let mut fields = strip(16, 16, &[8; 3], 6, jpeg.len());
    set(&mut fields, 259, 3, &[7]);
    let Samples::U8(got) = codes(&Tiff::new(fields.clone(), jpeg.clone())).samples else { panic!("8 bits") };
    assert!(got.iter().zip(&rgb).all(|(a, b)| a.abs_diff(*b) < 8), "{got:?}");
    // Cut in the middle, with its end marker.
    let cut = [&jpeg[..jpeg.len() - 12], &[0xff, 0xd9]].concat();
    set(&mut fields, 279, 4, &[cut.len() as u64]);
    let error = decode_codes(&Tiff::new(fields, cut).bytes(), Path::new("a.tif")).unwrap_err().to_string();
    assert!(error.contains("truncated"), "{error}");
    // Plain units of 2 × 2 luma and one of each chroma: gray, then red by Rec. 601.
    let data = vec![10, 20, 30, 40, 128, 128, 76, 76, 76, 76, 85, 255];
    let got = codes(&Tiff::new(strip(4, 2, &[8; 3], 6, 12), data)).samples;
    let Samples::U8(got) = got else { panic!("8 bits") };
    assert_eq!([got[0], got[3], got[12], got[15]], [10, 20, 30, 40]);
    assert!(got[6] >= 253 && got[7] <= 2 && got[8] <= 2, "{got:?}");
}

#[test]
fn lab_is_light() {
    // L* 50 is Y 0.18419; a* and b* of zero are gray under D65 as well. Red of sRGB is (54.29, 80.81, 69.89) under D50.
    let data = vec![128, 0, 0, 138, 81, 70];
    let got = read_quietly("a.tif", &Tiff::new(strip(2, 1, &[8; 3], 8, 6), data).bytes());
    let gray = ((128.0f32 / 255.0 * 100.0 + 16.0) / 116.0).powi(3);
    near(&got.pixels.as_raw()[..3], &[gray; 3], 2e-3);
    assert!((got.pixels.as_raw()[3] - 1.0).abs() < 0.02 && got.pixels.as_raw()[4].abs() < 0.01);
    let icc = read_quietly("a.tif", &Tiff::new(strip(1, 1, &[8; 3], 9, 3), vec![128, 128, 128]).bytes());
    near(icc.pixels.as_raw(), &[gray; 3], 2e-3);
}

#[test]
fn inks_go_by_the_plain_formula_with_a_word() {
    let (got, said) = read("a.tif", &Tiff::new(strip(1, 1, &[8; 4], 5, 4), vec![0, 255, 255, 51]).bytes());
    near(got.pixels.as_raw(), &[srgb_to_linear(0.8), 0.0, 0.0], 1e-5);
    assert!(said.len() == 1 && said[0].contains("CMYK"), "{said:?}");
}

/// Display P3 red in linear Rec. 709.
const P3_RED: [f32; 3] = [1.2249, -0.0420, -0.0196];

#[test]
fn profiles_of_any_size_are_followed() {
    let profile = moxcms::ColorProfile::new_display_p3().encode().unwrap();
    // The tag says how long the profile is; what is behind its own length is padding.
    for padding in [0, 200_000] {
        let mut fields = strip(1, 1, &[8; 3], 2, 3);
        let icc: Vec<u64> = profile.iter().map(|b| u64::from(*b)).chain(vec![0; padding]).collect();
        set(&mut fields, 34675, 7, &icc);
        for little in [true, false] {
            let file = Tiff { little, ..Tiff::new(fields.clone(), vec![255, 0, 0]) };
            near(read_quietly("a.tif", &file.bytes()).pixels.as_raw(), &P3_RED, 1e-3);
        }
    }
    let mut fields = strip(1, 1, &[8; 3], 2, 3);
    set(&mut fields, 34675, 7, &[1; 300]);
    let (got, said) = read("a.tif", &Tiff::new(fields, vec![255, 0, 0]).bytes());
    near(got.pixels.as_raw(), &[1.0, 0.0, 0.0], 1e-5);
    assert!(said.len() == 1 && said[0].contains("ICC"), "{said:?}");
}

/// An sRGB profile with these curves.
fn with_curve(curve: moxcms::ToneReprCurve) -> Vec<u64> {
    let mut profile = moxcms::ColorProfile::new_srgb();
    profile.cicp = None;
    (profile.red_trc, profile.green_trc, profile.blue_trc) = (Some(curve.clone()), Some(curve.clone()), Some(curve));
    profile.encode().unwrap().iter().map(|b| u64::from(*b)).collect()
}

#[test]
fn float_pictures_keep_their_range_through_profiles() {
    let values = [0.0f32, 0.05, 0.18, 1.0, 4.0, 16.0, 100.0, -0.25];
    let data: Vec<u8> = values.iter().flat_map(|v| [*v; 3]).flat_map(f32::to_le_bytes).collect();
    let mut fields = strip(8, 1, &[32; 3], 2, data.len());
    set(&mut fields, 339, 3, &[3; 3]);
    let table = |power: f64| {
        let value = |i: u32| ((f64::from(i) / 1023.0).powf(power) * 65535.0).round() as u16;
        moxcms::ToneReprCurve::Lut((0..1024).map(value).collect())
    };
    set(&mut fields, 34675, 7, &with_curve(table(1.0)));
    let got = read_quietly("a.tif", &Tiff::new(fields.clone(), data.clone()).bytes());
    near(got.pixels.as_raw(), &values.map(|v| [v; 3]).concat(), 2e-3);
    set(&mut fields, 34675, 7, &with_curve(moxcms::ToneReprCurve::Parametric(vec![2.0])));
    let got = read_quietly("a.tif", &Tiff::new(fields.clone(), data.clone()).bytes());
    near(got.pixels.as_raw(), &values.map(|v| [v * v.abs(); 3]).concat(), 2e-3);
    // What a curved table says of values beyond its end is an opinion, and said.
    set(&mut fields, 34675, 7, &with_curve(table(2.0)));
    let (got, said) = read("a.tif", &Tiff::new(fields, data).bytes());
    near(&got.pixels.as_raw()[12..15], &[16.0; 3], 1e-2);
    assert!(!said.is_empty() && said[0].contains("ICC"), "{said:?}");
}

#[test]
fn one_bad_field_loses_that_field_only() {
    let mut fields = strip(1, 1, &[8], 1, 1);
    set(&mut fields, 34665, 4, &[2]);
    // Behind the pixel: an EXIF directory with a time of 1/60 and a maker note outside of the file.
    let mut data = vec![77, 0];
    data.extend(3u16.to_le_bytes());
    let mut entry = |tag: u16, kind: u16, count: u32, value: u32| {
        data.extend([&tag.to_le_bytes()[..], &kind.to_le_bytes(), &count.to_le_bytes(), &value.to_le_bytes()].concat());
    };
    entry(0x829a, 5, 1, 8 + 2 + 2 + 36 + 4);
    entry(0x8827, 3, 1, 400);
    entry(0x927c, 7, 5000, 0x00ff_ffff);
    data.extend([0; 4]);
    data.extend([1u32.to_le_bytes(), 60u32.to_le_bytes()].concat());
    let facts = codes(&Tiff::new(fields, data)).metadata;
    assert!((facts.exposure_secs.unwrap() - 1.0 / 60.0).abs() < 1e-9 && facts.iso == Some(400.0), "{facts:?}");
}

#[test]
fn thumbnails_are_passed_over_and_further_pictures_said() {
    let data = vec![50, 60];
    let page = |at: u64, small: bool| {
        let mut fields = strip(1, 1, &[8], 1, 1);
        set(&mut fields, 273, 4, &[at]);
        set(&mut fields, 254, 4, &[u64::from(small)]);
        fields
    };
    let read_pages = |pages: Vec<Vec<Field>>| {
        let file = Tiff { little: true, big: false, pages, data: data.clone() }.bytes();
        support::warnings(|| decode_codes(&file, Path::new("a.tif")).unwrap().samples)
    };
    assert_eq!(read_pages(vec![page(0, true), page(1, false)]), (Samples::U8(vec![60; 3]), vec![]));
    assert_eq!(read_pages(vec![page(0, false), page(1, true)]), (Samples::U8(vec![50; 3]), vec![]));
    let (samples, said) = read_pages(vec![page(0, false), page(1, false)]);
    assert_eq!(samples, Samples::U8(vec![50; 3]));
    assert!(said.len() == 1 && said[0].contains("2 pictures"), "{said:?}");
}

#[test]
fn what_is_not_read_is_refused_by_its_name() {
    let refused = |tag: u16, values: &[u64], word: &str| {
        let mut fields = strip(1, 1, &[8; 3], 2, 3);
        set(&mut fields, tag, 3, values);
        let error = decode_picture(&Tiff::new(fields, vec![0; 3]).bytes(), Path::new("a.tif")).unwrap_err();
        assert!(error.to_string().contains(word), "{error}");
    };
    refused(259, &[6], "JPEG of the old kind");
    refused(259, &[50000], "Zstandard");
    refused(259, &[34677], "LogLuv");
    refused(262, &[32803], "camera raw");
    refused(339, &[2, 2, 2], "signed");
    refused(258, &[5, 6, 5], "different kinds");
    let mut fields = strip(2, 2, &[8], 1, 4);
    set(&mut fields, 273, 4, &[2]);
    let cut = Tiff::new(fields, vec![0; 3]).bytes();
    let _ = decode_codes(&cut, Path::new("a.tif")); // reads on into the directory at most
    let mut fields = strip(200, 200, &[8], 1, 40000);
    set(&mut fields, 273, 4, &[0]);
    let error = decode_codes(&Tiff::new(fields, vec![0; 300]).bytes(), Path::new("a.tif")).unwrap_err().to_string();
    assert!(error.contains("truncated"), "{error}");
}
