//! Damaged files of every format: an error or a picture, never a panic, never memory that the header alone asked for.

#![allow(unsafe_code, reason = "a global allocator, which counts, can only be written so")]

mod support;

use std::alloc::{GlobalAlloc, Layout, System};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{Mutex, MutexGuard, PoisonError};
use translume_image::*;

/// The system's allocator with the sum of what is in use and its peak.
struct Counting;

static IN_USE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call goes to the system's allocator unchanged; the counters are atomic and allocate nothing.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        grow(layout.size());
        // SAFETY: the caller's contract is the system allocator's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        grow(layout.size());
        // SAFETY: as above.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        IN_USE.fetch_sub(layout.size(), Relaxed);
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// One test at a time: they share the counters.
static TURN: Mutex<()> = Mutex::new(());

fn turn() -> MutexGuard<'static, ()> {
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

fn grow(bytes: usize) {
    let now = IN_USE.fetch_add(bytes, Relaxed) + bytes;
    PEAK.fetch_max(now, Relaxed);
}

/// The files of tests/data, and one of each format that this crate writes.
fn originals() -> Vec<(String, Vec<u8>)> {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let picture = Picture::new(Rgb32FImage::from_fn(23, 9, |x, y| image::Rgb([x as f32, y as f32, 0.5])));
    write_pfm(&at("a.pfm"), &picture).unwrap();
    write_hdr(&at("a.hdr"), &picture).unwrap();
    write_exr(&at("a.exr"), &picture, &ExrOptions::default()).unwrap();
    write_tiff_float(&at("a.tif"), &picture).unwrap();
    write_png16(&at("a.png"), (2, 2), &[7; 12]).unwrap();
    let committed = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let mut files: Vec<PathBuf> = Vec::new();
    for folder in [dir.path(), &committed] {
        files.extend(std::fs::read_dir(folder).unwrap().map(|f| f.unwrap().path()));
    }
    files.retain(|f| !matches!(f.extension().and_then(|e| e.to_str()), Some("py" | "md") | None));
    files.sort();
    assert!(files.len() >= 28, "the files are there");
    let name = |f: &Path| f.file_name().unwrap().to_string_lossy().into_owned();
    files.iter().map(|f| (name(f), std::fs::read(f).unwrap())).chain(written_here()).collect()
}

/// Kinds of TIFF and PNG that no file of tests/data is of.
fn written_here() -> Vec<(String, Vec<u8>)> {
    use support::{Tiff, chunk, png, set, strip, zlib};
    let tiff =
        |name: &str, fields: Vec<support::Field>, data: Vec<u8>| (name.to_owned(), Tiff::new(fields, data).bytes());
    let jpeg = encode_jpeg((16, 16), &[90; 768], 90).unwrap();
    let mut in_jpeg = strip(16, 16, &[8; 3], 6, jpeg.len());
    set(&mut in_jpeg, 259, 3, &[7]);
    let mut palette = strip(4, 1, &[4], 3, 2);
    set(&mut palette, 320, 3, &[7; 48]);
    let lzw = weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8).encode(&[5; 64]).unwrap();
    let mut packed = strip(8, 8, &[8], 0, lzw.len());
    set(&mut packed, 259, 3, &[5]);
    let mut float = strip(4, 1, &[32], 1, 16);
    set(&mut float, 339, 3, &[3]);
    set(&mut float, 317, 3, &[3]);
    set(&mut float, 34675, 7, &[1; 200]);
    let text = [b"Raw profile type exif\0\0".as_slice(), &zlib(b"\nexif\n 8\n49492a0008000000\n")].concat();
    let chunks = [chunk(b"cICP", &[9, 16, 0, 1]), chunk(b"cHRM", &[0; 32]), chunk(b"zTXt", &text)];
    vec![
        tiff("jpeg.tif", in_jpeg, jpeg),
        tiff("palette.tif", palette, vec![0x12, 0x34]),
        tiff("lzw.tif", packed, lzw),
        tiff("float-predictor.tif", float, vec![3; 16]),
        tiff("lab.tif", strip(2, 1, &[8; 3], 8, 6), vec![9; 6]),
        tiff("chroma.tif", strip(4, 2, &[8; 3], 6, 12), vec![9; 12]),
        tiff("ten-bits.tif", strip(3, 2, &[10], 1, 8), vec![9; 8]),
        tiff("inks.tif", strip(1, 1, &[8; 4], 5, 4), vec![9; 4]),
        ("code-points.png".to_owned(), png(2, 16, 0, &[1, 2, 3, 4], &chunks, &[])),
    ]
}

/// xorshift: all this needs.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as usize % n.max(1)
    }
}

/// One to three changes: flipped bits, extreme fields, cuts, insertions, repeats.
fn damage(original: &[u8], random: &mut Random) -> Vec<u8> {
    let mut v = original.to_vec();
    for _ in 0..=random.below(3) {
        if v.is_empty() {
            break;
        }
        // Headers come first in most formats: half of the changes go there.
        let span = if random.below(2) == 0 { v.len().min(512) } else { v.len() };
        let i = random.below(span);
        match random.below(7) {
            0 => v[i] ^= 1 << random.below(8),
            1 => v[i] = [0, 1, 0x7f, 0x80, 0xff][random.below(5)],
            2 => v.truncate(i),
            3 => {
                let field = [0u32, 1, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 65536][random.below(6)];
                let bytes = if random.below(2) == 0 { field.to_le_bytes() } else { field.to_be_bytes() };
                let end = (i + 4).min(v.len());
                v[i..end].copy_from_slice(&bytes[..end - i]);
            }
            4 => drop(v.drain(i..(i + 1 + random.below(8)).min(v.len()))),
            5 => {
                let byte = random.below(256) as u8;
                v.splice(i..i, std::iter::repeat_n(byte, 1 + random.below(8)));
            }
            _ => v[i] = random.below(256) as u8,
        }
    }
    v
}

/// Room for the largest picture that a few kilobytes may stand for: 8K of five float channels.
const MOST: usize = 900 << 20;

fn decode(name: &str, bytes: &[u8]) -> bool {
    PEAK.store(IN_USE.load(Relaxed), Relaxed);
    let before = IN_USE.load(Relaxed);
    let found = decode_picture(bytes, Path::new(name));
    if let Err(e) = &found {
        assert!(e.to_string().starts_with(name), "the error names the file: {e}");
    }
    let taken = PEAK.load(Relaxed).saturating_sub(before);
    assert!(taken < MOST, "{name}: {taken} bytes for a file of {}", bytes.len());
    found.is_ok()
}

/// Panics that become errors of a file are told to nobody, as in the program.
fn quiet_under_guard() {
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if !guard::is_active() {
            hook(panic);
        }
    }));
}

#[test]
fn damaged_files_are_errors_or_pictures() {
    let _turn = turn();
    let rounds: usize = std::env::var("TRANSLUME_FUZZ_ROUNDS").ok().and_then(|n| n.parse().ok()).unwrap_or(150);
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    let (mut errors, mut pictures) = (0, 0);
    quiet_under_guard();
    for (name, original) in originals() {
        assert!(decode(&name, &original) || name == "deep.exr", "{name} is sound");
        for round in 0..rounds {
            let damaged = damage(&original, &mut random);
            // What a crash leaves behind: the input that made it.
            let kept = std::env::temp_dir().join(format!("translume-damage-{}", std::process::id()));
            std::fs::write(&kept, &damaged).unwrap();
            match std::panic::catch_unwind(|| decode(&name, &damaged)) {
                Ok(true) => pictures += 1,
                Ok(false) => errors += 1,
                Err(_) => panic!("{name}, round {round}: the input is kept in {}", kept.display()),
            }
            std::fs::remove_file(&kept).unwrap();
        }
    }
    // Both happen often, or the damage would test nothing.
    assert!(errors > pictures / 20 && pictures > errors / 20, "{errors} errors, {pictures} pictures");
}

#[test]
fn every_truncation_is_an_error_or_a_picture() {
    let _turn = turn();
    for (name, original) in originals() {
        for length in (0..original.len()).step_by(1 + original.len() / 200) {
            decode(&name, &original[..length]);
        }
        if !name.ends_with(".png") && !name.ends_with(".tif") {
            let half = &original[..original.len() / 2];
            assert!(!decode(&name, half), "{name}: half of it is no picture");
        }
    }
}

/// Headers that ask for far more than the file holds.
#[test]
fn header_bombs_are_refused_before_memory_is_taken() {
    let _turn = turn();
    let mut bombs: Vec<(&str, Vec<u8>)> = vec![
        ("a.pfm", b"PF\n100000 100000\n-1.0\n....".to_vec()),
        ("b.pfm", b"PF\n18446744073709551615 18446744073709551615\n-1.0\n".to_vec()),
        ("a.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 40000 +X 40000\n\x02\x02".to_vec()),
    ];
    for (name, original) in originals() {
        let big = 60_000u32;
        match name.as_str() {
            "alpha.png" => {
                let mut v = original.clone();
                v[16..20].copy_from_slice(&big.to_be_bytes());
                v[20..24].copy_from_slice(&big.to_be_bytes());
                let crc = crc32(&v[12..29]);
                v[29..33].copy_from_slice(&crc.to_be_bytes());
                bombs.push(("alpha.png", v));
            }
            "a.exr" | "tiled.exr" | "chroma-zip.exr" => {
                let mut v = original.clone();
                for window in ["dataWindow\0box2i\0", "displayWindow\0box2i\0"] {
                    let at = v.windows(window.len()).position(|w| w == window.as_bytes()).unwrap() + window.len() + 4;
                    v[at + 8..at + 12].copy_from_slice(&(big - 1).to_le_bytes());
                    v[at + 12..at + 16].copy_from_slice(&(big - 1).to_le_bytes());
                }
                bombs.push(("a.exr", v));
            }
            _ => {}
        }
    }
    assert_eq!(bombs.len(), 7);
    for (name, bomb) in bombs {
        PEAK.store(IN_USE.load(Relaxed), Relaxed);
        let before = IN_USE.load(Relaxed);
        let error = decode_codes(&bomb, Path::new(name)).unwrap_err().to_string();
        let taken = PEAK.load(Relaxed).saturating_sub(before);
        assert!(error.contains("cannot hold") || error.contains("limit"), "{name}: {error}");
        assert!(taken < 16 << 20, "{name}: {taken} bytes");
    }
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, b| {
        (0..8).fold(crc ^ u32::from(*b), |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 })
    })
}
