//! What the chunks of a PNG file say beside its pixels: colour (cICP, iCCP, sRGB, gAMA, cHRM; PNG third edition §4.3)
//! and the facts of the shot (eXIf, and EXIF in text chunks as ImageMagick and GIMP write it).
//!
//! A damaged chunk is passed over with a warning: the pixels are sound without it.

use crate::colour::Space;
use crate::orient::Orientation;
use crate::raster::Transfer;
use crate::{Metadata, cicp, exif};
use std::borrow::Cow;
use std::io::Read;
use std::path::Path;

/// Most bytes of a chunk that unfolds: profiles and EXIF are far smaller.
const MOST: u64 = 16 << 20;

/// 1/2.2 as a gAMA chunk holds it: how writers without an sRGB chunk said sRGB.
const SRGB_GAMMA: u32 = 45455;

/// How the codes become light, with what else the file says.
pub(crate) struct Facts {
    pub transfer: Transfer,
    pub orientation: Orientation,
    pub metadata: Metadata,
}

/// Reads all chunks of `file`, whose codes have `bits`.
pub(crate) fn facts(file: &[u8], bits: u8, path: &Path) -> Facts {
    let found = Found::new(file, path);
    let mut metadata = Metadata::default();
    let orientation = match found.exif {
        Some(block) => exif::read_block(block, &mut metadata).orientation,
        None => Orientation::default(),
    };
    let mut transfer = Transfer::Srgb;
    if let Some((curve, space)) = found.cicp.and_then(|data| code_points(data, bits, path)) {
        transfer = Transfer::Video(curve);
        metadata.chromaticities = Some(space.chromaticities());
    } else if found.icc.is_some() || found.srgb {
        metadata.icc = found.icc;
    } else {
        if let Some(gamma) = found.gamma.filter(|&g| g > 0 && g.abs_diff(SRGB_GAMMA) > 50) {
            transfer = Transfer::Power(100_000.0 / gamma as f32);
        }
        metadata.chromaticities = found.chromaticities;
    }
    Facts { transfer, orientation, metadata }
}

/// The file without a cICP chunk that breaks its rules (an RGB matrix, a range of 0 or 1): the decoder would refuse the
/// picture for it, and [`facts`] warns.
pub(crate) fn without_bad_code_points(file: &[u8]) -> Cow<'_, [u8]> {
    let bad = |c: &Chunk<'_>| &c.kind == b"cICP" && !matches!(c.data, [_, _, 0, 0 | 1]);
    match chunks(file).find(bad) {
        Some(c) => Cow::Owned([&file[..c.at], &file[c.at + 12 + c.data.len()..]].concat()),
        None => Cow::Borrowed(file),
    }
}

/// The chunks that matter, taken apart.
#[derive(Default)]
struct Found {
    cicp: Option<[u8; 4]>,
    icc: Option<Vec<u8>>,
    srgb: bool,
    gamma: Option<u32>,
    chromaticities: Option<[[f32; 2]; 4]>,
    exif: Option<Vec<u8>>,
}

impl Found {
    fn new(file: &[u8], path: &Path) -> Self {
        let mut found = Self::default();
        let mut texts = Self::default();
        for Chunk { kind, data, sound, .. } in chunks(file) {
            if !sound && matches!(&kind, b"cICP" | b"iCCP" | b"sRGB" | b"gAMA" | b"cHRM" | b"eXIf") {
                log::warn!(
                    "{}: its chunk {} is damaged and passed over",
                    path.display(),
                    String::from_utf8_lossy(&kind)
                );
                continue;
            }
            match &kind {
                // A chunk of another length is as good as one that names nothing.
                b"cICP" => found.cicp = found.cicp.or(Some(data.try_into().unwrap_or([2, 2, 0, 1]))),
                b"iCCP" if found.icc.is_none() => {
                    found.icc = profile(data);
                    if found.icc.is_none() {
                        log::warn!("{}: its ICC profile is damaged (chunk iCCP) and passed over", path.display());
                    }
                }
                b"sRGB" => found.srgb = true,
                b"gAMA" => found.gamma = data.try_into().ok().map(u32::from_be_bytes),
                b"cHRM" => found.chromaticities = chromaticities(data, path),
                b"eXIf" => found.exif = Some(data.to_vec()),
                b"tEXt" | b"zTXt" | b"iTXt" if sound => texts.raw_profile(&kind, data),
                _ => {}
            }
        }
        found.exif = found.exif.or(texts.exif);
        found.icc = found.icc.or(texts.icc);
        found
    }

    /// Takes EXIF or an ICC profile out of a text chunk.
    fn raw_profile(&mut self, kind: &[u8; 4], data: &[u8]) {
        let Some((keyword, rest)) = split_zero(data) else { return };
        let Some(name) = keyword.strip_prefix(b"Raw profile type ") else { return };
        let name = name.to_ascii_lowercase();
        if !matches!(name.as_slice(), b"exif" | b"app1" | b"icc" | b"icm") {
            return;
        }
        let Some(bytes) = text(kind, rest).and_then(|text| from_hex(&text)) else { return };
        match bytes.strip_prefix(b"Exif\0\0") {
            Some(block) => self.exif = self.exif.take().or_else(|| Some(block.to_vec())),
            None if name == b"exif" => self.exif = self.exif.take().or(Some(bytes)),
            None if name != b"app1" => self.icc = self.icc.take().or(Some(bytes)),
            None => {}
        }
    }
}

struct Chunk<'a> {
    at: usize,
    kind: [u8; 4],
    data: &'a [u8],
    sound: bool,
}

/// The chunks in order, but for the pixels; ends where the file does.
fn chunks(file: &[u8]) -> impl Iterator<Item = Chunk<'_>> {
    let mut rest = file.get(8..).unwrap_or_default();
    std::iter::from_fn(move || {
        loop {
            let (length, tail) = rest.split_first_chunk::<4>()?;
            let (kind, tail) = tail.split_first_chunk::<4>()?;
            let (data, tail) = tail.split_at_checked(u32::from_be_bytes(*length) as usize)?;
            let (sum, tail) = tail.split_first_chunk::<4>()?;
            let at = file.len() - rest.len();
            rest = tail;
            if kind != b"IDAT" && kind != b"fdAT" {
                let sound = crc32(kind.iter().chain(data)) == u32::from_be_bytes(*sum);
                return Some(Chunk { at, kind: *kind, data, sound });
            }
        }
    })
}

/// The checksum of PNG (ISO 3309).
fn crc32<'a>(bytes: impl Iterator<Item = &'a u8>) -> u32 {
    const TABLE: [u32; 256] = {
        let mut table = [0; 256];
        let mut i = 0;
        while i < 256 {
            let (mut c, mut bit) = (i as u32, 0);
            while bit < 8 {
                c = if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 };
                bit += 1;
            }
            table[i] = c;
            i += 1;
        }
        table
    };
    !bytes.fold(!0, |crc, &b| TABLE[((crc ^ u32::from(b)) & 255) as usize] ^ (crc >> 8))
}

fn split_zero(data: &[u8]) -> Option<(&[u8], &[u8])> {
    let end = data.iter().position(|&b| b == 0)?;
    Some((&data[..end], &data[end + 1..]))
}

fn unfold(data: &[u8]) -> Option<Vec<u8>> {
    let mut out = Vec::new();
    flate2::read::ZlibDecoder::new(data).take(MOST + 1).read_to_end(&mut out).ok()?;
    (out.len() as u64 <= MOST).then_some(out)
}

fn profile(data: &[u8]) -> Option<Vec<u8>> {
    let (_, rest) = split_zero(data)?;
    let (0, packed) = rest.split_first()? else { return None };
    unfold(packed)
}

/// The text of a chunk behind its keyword.
fn text(kind: &[u8; 4], rest: &[u8]) -> Option<Vec<u8>> {
    match kind {
        b"tEXt" => Some(rest.to_vec()),
        b"zTXt" => match rest.split_first()? {
            (0, packed) => unfold(packed),
            _ => None,
        },
        _ => {
            let (&[folded, _], rest) = rest.split_first_chunk::<2>()?;
            let (_, rest) = split_zero(rest)?; // language
            let (_, text) = split_zero(rest)?; // the keyword in that language
            if folded == 1 { unfold(text) } else { Some(text.to_vec()) }
        }
    }
}

/// The bytes of a raw profile: its name, the number of bytes, then their hexadecimal digits over many lines.
fn from_hex(text: &[u8]) -> Option<Vec<u8>> {
    let mut words = text.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty());
    let _name = words.next()?;
    let length: usize = std::str::from_utf8(words.next()?).ok()?.parse().ok()?;
    let digits: Option<Vec<u8>> = words.flatten().map(|&d| (d as char).to_digit(16).map(|d| d as u8)).collect();
    let bytes: Vec<u8> = digits?.as_chunks::<2>().0.iter().map(|[high, low]| high << 4 | low).collect();
    (bytes.len() >= length).then(|| bytes[..length].to_vec())
}

fn chromaticities(data: &[u8], path: &Path) -> Option<[[f32; 2]; 4]> {
    let numbers: [u8; 32] = data.try_into().ok()?;
    let v: Vec<f32> =
        numbers.as_chunks::<4>().0.iter().map(|b| (f64::from(u32::from_be_bytes(*b)) / 1e5) as f32).collect();
    // White comes first.
    let found = [[v[2], v[3]], [v[4], v[5]], [v[6], v[7]], [v[0], v[1]]];
    if Space::from_chromaticities(found).is_none() {
        log::warn!("{}: the primaries of its cHRM chunk span no triangle and are passed over", path.display());
        return None;
    }
    Some(found)
}

/// Curve and primaries of a cICP chunk, or a warning.
fn code_points(
    [primaries, transfer, matrix, full_range]: [u8; 4],
    bits: u8,
    path: &Path,
) -> Option<(cicp::Curve, Space)> {
    let path = path.display();
    let curve = cicp::Curve::new(transfer, full_range != 0, bits).filter(|_| matrix == 0 && full_range <= 1);
    let (Some(curve), Some(space)) = (curve, cicp::space(primaries)) else {
        log::warn!(
            "{path}: its cICP chunk ({primaries} {transfer} {matrix} {full_range}) names no known colour; passed over"
        );
        return None;
    };
    if curve.is_hlg() {
        log::warn!("{path}: HLG (cICP) is read as the light in front of the camera, reference white as 1");
    }
    Some((curve, space))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raw_profiles_are_hexadecimal_lines() {
        assert_eq!(from_hex(b"\nexif\n       4\n45786\n966\n").unwrap(), b"Exif");
        assert_eq!(from_hex(b"\nexif\n       5\n45786966\n"), None);
        assert_eq!(from_hex(b"\nexif\n       2\n4g\n"), None);
        assert_eq!(from_hex(b""), None);
    }

    #[test]
    fn the_checksum_is_that_of_png() {
        // The checksum of an empty IEND chunk stands at the end of every PNG file.
        assert_eq!(crc32(b"IEND".iter()), 0xae42_6082);
    }
}
