//! JPEG files whose data are cut or whose profile is damaged.

mod support;

use std::path::Path;
use support::{near, read, read_quietly};
use translume_image::colour::srgb_to_linear;
use translume_image::{decode_codes, encode_jpeg};

fn picture() -> Vec<u8> {
    let rgb: Vec<u8> = (0..64 * 48 * 3).map(|i| (i * 7 % 251) as u8 ^ (i / 97) as u8).collect();
    encode_jpeg((64, 48), &rgb, 90).unwrap()
}

fn progressive() -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/progressive.jpg")).unwrap()
}

/// Where the entropy-coded bytes of the scans are.
fn scans(file: &[u8]) -> Vec<std::ops::Range<usize>> {
    let (mut at, mut out) = (2, Vec::new());
    while file[at + 1] != 0xd9 {
        let end = at + 2 + usize::from(u16::from_be_bytes([file[at + 2], file[at + 3]]));
        let start = at;
        at = end;
        if file[start + 1] == 0xda {
            while file[at] != 0xff || file[at + 1] == 0 {
                at += 1;
            }
            out.push(end..at);
        }
    }
    out
}

fn error(file: &[u8]) -> Option<String> {
    decode_codes(file, Path::new("a.jpg")).err().map(|e| e.to_string())
}

#[test]
fn whole_files_pass_and_files_with_cut_scans_do_not() {
    for whole in [picture(), progressive()] {
        assert_eq!(error(&whole), None);
        for scan in scans(&whole).iter().filter(|s| s.len() > 3) {
            for keep in [0, scan.len() / 4, scan.len() / 2, scan.len() - 2] {
                // A byte of 0xff must keep the zero behind it.
                let end = scan.start + keep - usize::from(keep > 0 && whole[scan.start + keep - 1] == 0xff);
                let cut = [&whole[..end], &whole[scan.end..]].concat();
                let said = error(&cut).unwrap_or_default();
                assert!(said.contains("truncated") || said.contains("damaged"), "{scan:?} {keep}: '{said}'");
            }
        }
    }
    let whole = picture();
    let half = scans(&whole)[0].start + 500;
    let said = error(&[&whole[..half], &[0xff, 0xd9]].concat()).unwrap();
    assert!(said.contains("% of its picture (truncated)"), "{said}");
    assert!(error(&whole[..half]).unwrap().contains("truncated"));
}

#[test]
fn fill_bytes_and_what_follows_the_end_do_no_harm() {
    let whole = picture();
    let end = whole.len() - 2;
    assert_eq!(error(&[&whole[..end], &[0xff, 0xff, 0xff, 0xd9, 1, 2, 3]].concat()), None);
    assert_eq!(error(&[&whole[..end], &[0x12, 0x34, 0xff, 0xd9]].concat()), None);
}

/// `file` with an ICC profile in parts of these numbers (out of `count`).
fn with_profile(file: &[u8], profile: &[u8], numbers: &[u8], count: u8) -> Vec<u8> {
    let mut out = file[..2].to_vec();
    for (part, number) in profile.chunks(profile.len().div_ceil(numbers.len())).zip(numbers) {
        let length = (part.len() + 16) as u16;
        out.extend([&[0xff, 0xe2], &length.to_be_bytes()[..], b"ICC_PROFILE\0", &[*number, count], part].concat());
    }
    out.extend(&file[2..]);
    out
}

#[test]
fn a_profile_that_cannot_be_used_is_a_warning_and_a_sound_one_is_followed() {
    let flat = encode_jpeg((8, 8), &[200; 192], 100).unwrap();
    let gamma = {
        let mut profile = moxcms::ColorProfile::new_srgb();
        let trc = moxcms::curve_from_gamma(1.0);
        (profile.red_trc, profile.green_trc, profile.blue_trc) = (Some(trc.clone()), Some(trc.clone()), Some(trc));
        profile.cicp = None;
        profile.encode().unwrap()
    };
    let (linear, srgb) = ([200.0 / 255.0; 3], [srgb_to_linear(200.0 / 255.0); 3]);
    for numbers in [&[1][..], &[1, 2, 3], &[3, 1, 2]] {
        // The parts are written in the order of `numbers`, and read by their numbers.
        let mut parts: Vec<&[u8]> = gamma.chunks(gamma.len().div_ceil(numbers.len())).collect();
        if numbers[0] == 3 {
            parts.rotate_right(1);
        }
        let file = with_profile(&flat, &parts.concat(), numbers, numbers.len() as u8);
        if numbers[0] != 3 || parts.iter().all(|p| p.len() == parts[0].len()) {
            near(&read_quietly("a.jpg", &file).pixels.as_raw()[..3], &linear, 0.01);
        }
    }
    let mut garbled = gamma.clone();
    garbled[36..60].fill(0);
    for file in [
        with_profile(&flat, &garbled, &[1], 1),
        with_profile(&flat, &gamma[..200], &[1], 1),
        with_profile(&flat, &gamma, &[1, 3], 3),
        with_profile(&flat, &gamma, &[1, 1], 2),
    ] {
        let (picture, said) = read("a.jpg", &file);
        near(&picture.pixels.as_raw()[..3], &srgb, 0.02);
        assert!(said.len() == 1 && said[0].contains("ICC"), "{said:?}");
    }
}

/// A JPEG with an EXIF block: orientation, and the index of interoperability, three directories deep.
fn with_index(file: &[u8], index: &[u8; 4]) -> Vec<u8> {
    let entry = |tag: u16, kind: u16, count: u32, value: [u8; 4]| {
        [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &count.to_le_bytes(), &value].concat()
    };
    let table = |entry: Vec<u8>| [&1u16.to_le_bytes()[..], &entry, &[0; 4]].concat();
    let block = [
        b"Exif\0\0II*\0\x08\0\0\0".to_vec(),
        table(entry(0x8769, 4, 1, 26u32.to_le_bytes())),
        table(entry(0xa005, 4, 1, 44u32.to_le_bytes())),
        table(entry(0x0001, 2, 4, *index)),
    ]
    .concat();
    let length = (block.len() as u16 + 2).to_be_bytes();
    [&file[..2], &[0xff, 0xe1], &length, &block, &file[2..]].concat()
}

#[test]
fn adobe_rgb_of_cameras_is_known_by_its_index() {
    let red = encode_jpeg((8, 8), &[200, 0, 0].repeat(64), 100).unwrap();
    let light = (200.0f32 / 255.0).powf(563.0 / 256.0);
    let plain = read_quietly("a.jpg", &with_index(&red, b"R98\0")).pixels;
    near(&plain.as_raw()[..1], &[srgb_to_linear(200.0 / 255.0)], 0.02);
    let adobe = read_quietly("a.jpg", &with_index(&red, b"R03\0")).pixels;
    // The red of Adobe RGB is 1.3983 times that of Rec. 709, which has the same chromaticity.
    near(&adobe.as_raw()[..1], &[1.3983 * light], 0.02);
}
