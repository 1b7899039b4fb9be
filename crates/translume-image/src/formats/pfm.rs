//! Portable float map (Debevec): `PF` or `Pf`, size, scale (negative: little-endian), then rows from the bottom up.

use crate::limits::Claim;
use crate::raster::{Raster, Transfer};
use crate::{Error, Metadata, Result, Samples, atomic, orient::Orientation};
use std::io::Write;
use std::path::Path;

pub(crate) fn read(file: &[u8], path: &Path) -> Result<Raster> {
    let (header, pixels) = header(file).ok_or_else(|| Error::invalid(path, "damaged PFM header"))?;
    let channels = if header.colour { 3 } else { 1 };
    let (size, file_bytes) = ((header.width, header.height), pixels.len() as u64);
    let count = Claim { size, channels, bits: 32 * channels, file_bytes, max_ratio: 1 }.samples(path)?;
    let pixels = without_line_feed(file, pixels, 4 * count);
    let Some(pixels) = pixels.get(..4 * count) else {
        return Err(Error::invalid(path, "the PFM ends before its picture does (truncated)"));
    };
    let scale = header.scale.abs();
    let decode = |b: &[u8; 4]| scale * if header.scale < 0.0 { f32::from_le_bytes(*b) } else { f32::from_be_bytes(*b) };
    let row = header.width as usize * channels as usize;
    let samples = pixels.chunks_exact(4 * row).rev().flat_map(|r| r.as_chunks::<4>().0.iter().map(decode)).collect();
    Ok(Raster {
        width: header.width as usize,
        height: header.height as usize,
        channels: channels as usize,
        samples: Samples::F32(samples),
        transfer: Transfer::Power(1.0),
        associated: true,
        orientation: Orientation::default(),
        metadata: Metadata::default(),
    })
}

struct Header {
    colour: bool,
    width: u64,
    height: u64,
    scale: f32,
}

/// The pixels without the second half of a line end of two characters (CR LF), which some editors and writers make. A
/// line feed may be the first byte of a pixel as well: the length of the file tells.
fn without_line_feed<'a>(file: &[u8], pixels: &'a [u8], wanted: usize) -> &'a [u8] {
    let before = file.len().checked_sub(pixels.len() + 1).and_then(|i| file.get(i));
    match (before, pixels.split_first()) {
        (Some(b'\r'), Some((b'\n', rest))) if rest.len() >= wanted => rest,
        _ => pixels,
    }
}

/// Four words, lines of comment (`#`) between them, and the pixels after the single white-space character behind the
/// last.
fn header(file: &[u8]) -> Option<(Header, &[u8])> {
    let mut rest = file;
    let mut word = || {
        let mut start = rest.iter().position(|b| !b.is_ascii_whitespace())?;
        while rest[start] == b'#' {
            start += rest[start..].iter().position(|b| matches!(b, b'\n' | b'\r'))?;
            start += rest[start..].iter().position(|b| !b.is_ascii_whitespace())?;
        }
        let length = rest[start..].iter().take(64).position(u8::is_ascii_whitespace)?;
        let text = std::str::from_utf8(&rest[start..start + length]).ok()?;
        rest = &rest[start + length + 1..];
        Some(text)
    };
    let colour = match word()? {
        "PF" => true,
        "Pf" => false,
        _ => return None,
    };
    let (width, height) = (word()?.parse().ok()?, word()?.parse().ok()?);
    let scale = word()?.parse::<f32>().ok().filter(|s| s.is_finite() && *s != 0.0)?;
    Some((Header { colour, width, height, scale }, rest))
}

/// Writes linear RGB as a little-endian PFM.
///
/// # Errors
/// [`Error::Io`].
pub fn write_pfm(path: &Path, picture: &crate::Picture) -> Result<()> {
    let (width, height) = picture.pixels.dimensions();
    atomic::write(path, |f| {
        let mut put = |bytes: &[u8]| f.write_all(bytes).map_err(|e| Error::io(path, e));
        put(format!("PF\n{width} {height}\n-1.0\n").as_bytes())?;
        for row in picture.pixels.as_raw().chunks_exact(3 * width as usize).rev() {
            put(&row.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>())?;
        }
        Ok(())
    })
}
