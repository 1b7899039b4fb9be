//! Mutations behind checksums, compression and lengths: PNG chunks, zlib and gzip streams, EXR attributes, TIFF
//! directories, binary glTF, base64 in JSON. What is changed inside is packed again so that readers come as far.

use super::{below, bytes, pick, text_or_json};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use std::io::{Read, Write};
use translume_core::rng::Pcg32;

/// Changes `v` inside, if its format is known; whether it was.
pub(super) fn mutate(v: &mut Vec<u8>, other: &[u8], rng: &mut Pcg32) -> bool {
    match v.as_slice() {
        [0x89, b'P', b'N', b'G', ..] => png(v, rng),
        [0x76, 0x2f, 0x31, 1, ..] => exr(v, rng),
        [b'I', b'I', 42, 0, ..] | [b'M', b'M', 0, 42, ..] => tiff(v, rng),
        [b'g', b'l', b'T', b'F', ..] => glb(v, other, rng),
        [0x1f, 0x8b, ..] => gzip(v, rng),
        [0x1c, 0x04, 3..=4, 0, ..] => serialized(v, rng),
        [b'{', ..] => data_uri(v, rng),
        _ => return false,
    }
    .is_some()
}

fn be32(v: &[u8], at: usize) -> Option<usize> {
    Some(u32::from_be_bytes(*v.get(at..)?.first_chunk()?) as usize)
}

fn le32(v: &[u8], at: usize) -> Option<usize> {
    Some(u32::from_le_bytes(*v.get(at..)?.first_chunk()?) as usize)
}

/// Kind and data of each chunk.
fn png(v: &mut Vec<u8>, rng: &mut Pcg32) -> Option<()> {
    let mut chunks: Vec<(Vec<u8>, Vec<u8>)> = Vec::new();
    let mut at = 8;
    while let Some(n) = be32(v, at) {
        let data = v.get(at + 8..(at + 8).checked_add(n)?)?;
        chunks.push((v[at + 4..at + 8].to_vec(), data.to_vec()));
        at += 12 + n;
    }
    if chunks.is_empty() {
        return None;
    }
    let which = below(chunks.len(), rng);
    match below(6, rng) {
        0 => drop(chunks.remove(which)),
        1 => chunks.insert(which, chunks[which].clone()),
        2 => {
            let with = below(chunks.len(), rng);
            chunks.swap(which, with);
        }
        _ => {
            let (kind, data) = &mut chunks[which];
            let head = match (&kind[..], below(4, rng)) {
                (b"IDAT", 1..) => 0,
                (b"iCCP" | b"zTXt", 1..) => data.iter().position(|b| *b == 0)? + 2,
                _ => data.len() + 1,
            };
            match data.get(head..).and_then(|d| zlib(d, rng)) {
                Some(new) => drop(data.splice(head.., new)),
                None => bytes::mutate(data, &[], rng),
            }
        }
    }
    v.truncate(8);
    for (kind, data) in chunks {
        v.extend((data.len() as u32).to_be_bytes());
        let begin = v.len();
        v.extend(kind);
        v.extend(data);
        let crc = crc32(&v[begin..]);
        v.extend(crc.to_be_bytes());
    }
    Some(())
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, b| {
        (0..8).fold(crc ^ u32::from(*b), |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 })
    })
}

/// Most bytes that are unpacked to be changed.
const MOST: u64 = 1 << 18;

/// A zlib stream with its content changed.
fn zlib(stream: &[u8], rng: &mut Pcg32) -> Option<Vec<u8>> {
    let mut raw = Vec::new();
    flate2::read::ZlibDecoder::new(stream).take(MOST).read_to_end(&mut raw).ok()?;
    bytes::mutate(&mut raw, &[], rng);
    let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), Compression::fast());
    packed.write_all(&raw).ok()?;
    packed.finish().ok()
}

fn gzip(v: &mut Vec<u8>, rng: &mut Pcg32) -> Option<()> {
    let mut raw = Vec::new();
    flate2::read::GzDecoder::new(&v[..]).take(MOST).read_to_end(&mut raw).ok()?;
    bytes::mutate(&mut raw, &[], rng);
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), Compression::fast());
    packed.write_all(&raw).ok()?;
    *v = packed.finish().ok()?;
    Some(())
}

/// The first stream of the file; the offsets after it move along.
fn serialized(v: &mut Vec<u8>, rng: &mut Pcg32) -> Option<()> {
    let stream = zlib(v.get(4..)?, rng)?;
    let version = v[2];
    let mut new = v[..4].to_vec();
    new.extend(stream);
    new.extend(if version == 4 { vec![0; 8] } else { vec![0; 4] });
    new.extend(1u32.to_le_bytes());
    *v = new;
    Some(())
}

/// An attribute of the header: its value, its name, its size; or it goes, or comes twice.
fn exr(v: &mut Vec<u8>, rng: &mut Pcg32) -> Option<()> {
    let zero = |from: usize| v.get(from..)?.iter().position(|b| *b == 0).map(|n| from + n);
    let mut attributes = Vec::new();
    let mut at = 8;
    // Headers of further parts follow the empty name that ends one.
    while let Some(name) = zero(at) {
        if name == at {
            break;
        }
        let size = zero(name + 1)? + 1;
        let value = size + 4..(size + 4).checked_add(le32(v, size)?)?;
        v.get(value.clone())?;
        attributes.push((at, size, value.clone()));
        at = value.end;
    }
    if attributes.is_empty() {
        return None;
    }
    let (begin, size, value) = pick(&attributes, rng).clone();
    match below(8, rng) {
        0 => drop(v.drain(begin..value.end)),
        1 => {
            let copy = v[begin..value.end].to_vec();
            drop(v.splice(begin..begin, copy));
        }
        2 => {
            let mut name = v[begin..size].to_vec();
            bytes::mutate(&mut name, &[], rng);
            drop(v.splice(begin..size, name));
        }
        _ => {
            let mut new = v[value.clone()].to_vec();
            bytes::mutate(&mut new, &[], rng);
            v[size..size + 4].copy_from_slice(&(new.len() as u32).to_le_bytes());
            drop(v.splice(value, new));
        }
    }
    Some(())
}

/// An entry of the first directory: tag, type, count or value; or it becomes another's.
fn tiff(v: &mut [u8], rng: &mut Pcg32) -> Option<()> {
    let big = v[0] == b'M';
    let at = if big { be32(v, 4)? } else { le32(v, 4)? };
    let count = v.get(at..at.checked_add(2)?)?;
    let count = usize::from(if big {
        u16::from_be_bytes([count[0], count[1]])
    } else {
        u16::from_le_bytes([count[0], count[1]])
    });
    let entry = |i: usize| at + 2 + 12 * i;
    let (a, b) = (entry(below(count, rng)), entry(below(count, rng)));
    v.get(a.max(b)..a.max(b) + 12)?;
    let put = |v: &mut [u8], at: usize, n: usize, x: u32| match (n, big) {
        (2, true) => v[at..at + 2].copy_from_slice(&(x as u16).to_be_bytes()),
        (2, false) => v[at..at + 2].copy_from_slice(&(x as u16).to_le_bytes()),
        (_, true) => v[at..at + 4].copy_from_slice(&x.to_be_bytes()),
        (_, false) => v[at..at + 4].copy_from_slice(&x.to_le_bytes()),
    };
    const NUMBERS: [u32; 14] = [0, 1, 2, 3, 4, 8, 16, 32, 64, 255, 0x7fff, 0x8000_0000, u32::MAX, 70_000];
    match below(6, rng) {
        0 => put(v, a + 2, 2, 1 + below(18, rng) as u32),
        1 => put(v, a + 4, 4, *pick(&NUMBERS, rng)),
        2 => v.copy_within(b..b + 12, a),
        // Short values stand at the beginning of their field.
        3 => put(v, a + 8, 2, *pick(&NUMBERS, rng)),
        4 => put(v, a + 8, 4, *pick(&NUMBERS, rng)),
        _ => {
            const TAGS: [u32; 16] = [254, 256, 257, 258, 259, 262, 273, 274, 277, 278, 284, 317, 320, 322, 338, 339];
            put(v, a, 2, *pick(&TAGS, rng));
        }
    }
    Some(())
}

/// The JSON or the binary chunk, lengths kept right.
fn glb(v: &mut Vec<u8>, other: &[u8], rng: &mut Pcg32) -> Option<()> {
    let n = le32(v, 12)?;
    let mut text = v.get(20..20usize.checked_add(n)?)?.to_vec();
    let mut rest = v[20 + n..].to_vec();
    if rest.len() > 8 && below(3, rng) == 0 {
        let mut binary = rest.split_off(8);
        // A field has textures in there, with heads of their own.
        bytes::mutate(&mut binary, other, rng);
        rest[..4].copy_from_slice(&(binary.len() as u32).to_le_bytes());
        rest.extend(binary);
    } else {
        text_or_json(&mut text, &[], rng);
        text.resize(text.len().next_multiple_of(4), b' ');
    }
    let length = 20 + text.len() + rest.len();
    v.truncate(8);
    v.extend((length as u32).to_le_bytes());
    v.extend((text.len() as u32).to_le_bytes());
    v.extend(b"JSON");
    v.extend(text);
    v.extend(rest);
    Some(())
}

/// A buffer in base64.
fn data_uri(v: &mut Vec<u8>, rng: &mut Pcg32) -> Option<()> {
    if below(3, rng) > 0 {
        return None;
    }
    let mark = b";base64,";
    let begins: Vec<usize> =
        v.windows(mark.len()).enumerate().filter(|w| w.1 == mark).map(|w| w.0 + mark.len()).collect();
    let begin = *(!begins.is_empty()).then(|| pick(&begins, rng))?;
    let end = begin + v[begin..].iter().position(|b| *b == b'"')?;
    let mut raw = STANDARD.decode(&v[begin..end]).ok()?;
    bytes::mutate(&mut raw, &[], rng);
    drop(v.splice(begin..end, STANDARD.encode(raw).into_bytes()));
    Some(())
}
