//! What several tests share: the log of this thread, and small files written byte by byte.

#![allow(dead_code, reason = "each test uses some of it")]

use std::cell::RefCell;
use std::path::Path;
use translume_image::{Picture, decode_picture};

thread_local! {
    static SAID: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
}

struct Log;

impl log::Log for Log {
    fn enabled(&self, _: &log::Metadata<'_>) -> bool {
        true
    }
    fn log(&self, record: &log::Record<'_>) {
        if record.level() <= log::Level::Warn {
            SAID.with_borrow_mut(|said| said.push(record.args().to_string()));
        }
    }
    fn flush(&self) {}
}

/// What `work` gives, with the warnings that it said on this thread.
pub(crate) fn warnings<T>(work: impl FnOnce() -> T) -> (T, Vec<String>) {
    let _ = log::set_logger(&Log); // another test of this program may have done it
    log::set_max_level(log::LevelFilter::Warn);
    SAID.take();
    let result = work();
    (result, SAID.take())
}

/// A file in memory as linear light, and the warnings.
pub(crate) fn read(name: &str, file: &[u8]) -> (Picture, Vec<String>) {
    warnings(|| decode_picture(file, Path::new(name)).unwrap())
}

/// Reads a file that must give no warning.
pub(crate) fn read_quietly(name: &str, file: &[u8]) -> Picture {
    let (picture, said) = read(name, file);
    assert!(said.is_empty(), "{name}: {said:?}");
    picture
}

pub(crate) fn near(got: &[f32], expected: &[f32], relative: f32) {
    assert_eq!(got.len(), expected.len(), "{got:?} instead of {expected:?}");
    let close = |(g, e): (&f32, &f32)| (g - e).abs() <= relative * e.abs() + 2e-4;
    assert!(got.iter().zip(expected).all(close), "{got:?} instead of {expected:?}");
}

pub(crate) fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, b| {
        (0..8).fold(crc ^ u32::from(*b), |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 })
    })
}

pub(crate) fn chunk(kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let body = [kind.as_slice(), data].concat();
    [&(data.len() as u32).to_be_bytes(), body.as_slice(), &crc32(&body).to_be_bytes()].concat()
}

pub(crate) fn zlib(data: &[u8]) -> Vec<u8> {
    use std::io::Write;
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(data).unwrap();
    encoder.finish().unwrap()
}

/// A PNG of one row: bit depth, colour type, the bytes of its pixels, chunks before and behind them.
pub(crate) fn png(width: u32, depth: u8, colour: u8, row: &[u8], before: &[Vec<u8>], behind: &[Vec<u8>]) -> Vec<u8> {
    let header = [&width.to_be_bytes(), &1u32.to_be_bytes(), [depth, colour, 0, 0, 0].as_slice()].concat();
    let mut out = [b"\x89PNG\r\n\x1a\n".as_slice(), &chunk(b"IHDR", &header)].concat();
    out.extend(before.concat());
    out.extend(chunk(b"IDAT", &zlib(&[&[0], row].concat())));
    out.extend(behind.concat());
    out.extend(chunk(b"IEND", &[]));
    out
}

/// One field of a TIFF directory: tag, type, values. Types 3, 4, 13: unsigned; 2, 1, 7: bytes; 5, 10: pairs.
pub(crate) type Field = (u16, u16, Vec<u64>);

/// A TIFF or BigTIFF of several directories; offsets of tag 273 and 324 count from the beginning of `data`.
pub(crate) struct Tiff {
    pub(crate) little: bool,
    pub(crate) big: bool,
    pub(crate) pages: Vec<Vec<Field>>,
    pub(crate) data: Vec<u8>,
}

impl Tiff {
    pub(crate) fn new(fields: Vec<Field>, data: Vec<u8>) -> Self {
        Self { little: true, big: false, pages: vec![fields], data }
    }

    fn put(&self, out: &mut Vec<u8>, value: u64, size: usize) {
        let bytes = value.to_le_bytes();
        let mut bytes = bytes[..size].to_vec();
        if !self.little {
            bytes.reverse();
        }
        out.extend(bytes);
    }

    pub(crate) fn bytes(&self) -> Vec<u8> {
        let (start, word) = if self.big { (16, 8) } else { (8, 4) };
        let mut out = if self.little { b"II".to_vec() } else { b"MM".to_vec() };
        self.put(&mut out, if self.big { 43 } else { 42 }, 2);
        if self.big {
            self.put(&mut out, 8, 2);
            self.put(&mut out, 0, 2);
        }
        let first = (start + self.data.len()).next_multiple_of(2);
        self.put(&mut out, first as u64, word);
        out.extend(&self.data);
        for (number, page) in self.pages.iter().enumerate() {
            out.resize(out.len().next_multiple_of(2), 0);
            let (entry, counter) = (4 + 2 * word, if self.big { 8 } else { 2 });
            let mut behind = out.len() + counter + page.len() * entry + word;
            let mut long = Vec::new();
            self.put(&mut out, page.len() as u64, counter);
            for (tag, kind, values) in page {
                let size = [0, 1, 1, 2, 4, 4, 1, 1, 2, 4, 4, 4, 8, 4][usize::from(*kind)];
                let count = if matches!(kind, 5 | 10) { values.len() / 2 } else { values.len() };
                self.put(&mut out, u64::from(*tag), 2);
                self.put(&mut out, u64::from(*kind), 2);
                self.put(&mut out, count as u64, word);
                let mut bytes = Vec::new();
                for v in values {
                    let shift = if matches!(tag, 273 | 324 | 34665) { start as u64 } else { 0 };
                    self.put(&mut bytes, v + shift, size);
                }
                if bytes.len() <= word {
                    bytes.resize(word, 0);
                    out.extend(bytes);
                } else {
                    self.put(&mut out, behind as u64, word);
                    behind += bytes.len();
                    long.extend(bytes);
                }
            }
            let next = (behind).next_multiple_of(2);
            self.put(&mut out, if number + 1 < self.pages.len() { next as u64 } else { 0 }, word);
            out.extend(long);
        }
        out
    }
}

/// The fields of an uncompressed strip: width, height, bits of each sample, photometric interpretation.
pub(crate) fn strip(width: u64, height: u64, bits: &[u64], photometric: u64, bytes: usize) -> Vec<Field> {
    vec![
        (256, 4, vec![width]),
        (257, 4, vec![height]),
        (258, 3, bits.to_vec()),
        (259, 3, vec![1]),
        (262, 3, vec![photometric]),
        (273, 4, vec![0]),
        (277, 3, vec![bits.len() as u64]),
        (278, 4, vec![height]),
        (279, 4, vec![bytes as u64]),
    ]
}

/// Changes a field, or adds it.
pub(crate) fn set(fields: &mut Vec<Field>, tag: u16, kind: u16, values: &[u64]) {
    fields.retain(|f| f.0 != tag);
    fields.push((tag, kind, values.to_vec()));
    fields.sort_by_key(|f| f.0);
}
