//! TIFF: 1 to 32-bit integers, half, float and double; gray, palette, RGB, CMYK (without a profile: naively), in strips,
//! tiles or planes. The first picture of the file is read.

use crate::limits::{self, Claim};
use crate::raster::{Raster, Transfer};
use crate::{Error, Metadata, Picture, Result, Samples, atomic, exif, orient::Orientation};
use std::io::{BufWriter, Cursor};
use std::path::Path;
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult};
use tiff::tags::Tag;

pub(crate) fn read(file: &[u8], path: &Path) -> Result<Raster> {
    let mut decoder = Decoder::new(Cursor::new(file)).map_err(|e| failed(path, e))?;
    let (w, h) = decoder.dimensions().map_err(|e| failed(path, e))?;
    let colour = decoder.colortype().map_err(|e| failed(path, e))?;
    let (stored, bits) = layout(colour, path)?;
    let size = (u64::from(w), u64::from(h));
    let bytes = u64::from(bits).div_ceil(8);
    let pixel_bits = stored as u64 * u64::from(bits);
    let (channels, file_bytes) = (stored as u64, file.len() as u64);
    let claim = Claim { size, channels, bits: pixel_bits, file_bytes, max_ratio: limits::MAX_RATIO };
    let count = claim.samples(path)?;
    let mut limit = tiff::decoder::Limits::default();
    limit.decoding_buffer_size = count.saturating_mul(bytes as usize);
    limit.intermediate_buffer_size = limit.decoding_buffer_size.saturating_add(1 << 20);
    decoder = decoder.with_limits(limit);

    let mut metadata = Metadata { icc: decoder.get_tag_u8_vec(Tag::IccProfile).ok(), ..Metadata::default() };
    let palette = match colour {
        ColorType::Palette(_) => decoder.get_tag_u16_vec(Tag::ColorMap).map_err(|e| failed(path, e))?,
        _ => Vec::new(),
    };
    let mut decoded = DecodingResult::U8(Vec::new());
    let planes = decoder.read_image_to_buffer(&mut decoded).map_err(|e| failed(path, e))?.planes;
    let samples = convert(decoded, path)?;
    let samples = match samples {
        Samples::U8(v) if bits < 8 => {
            Samples::U8(unpack(&v, w as usize * stored, h as usize, bits, palette.is_empty()))
        }
        other => other,
    };
    let short = || Error::invalid(path, "the TIFF ends before its picture does (truncated)");
    let (channels, samples) = match samples {
        Samples::U8(v) => rearrange(v, stored, planes, count, colour, &palette, 255).ok_or_else(short)?,
        Samples::U16(v) => {
            let (c, s) = rearrange(v, stored, planes, count, colour, &[], 65535).ok_or_else(short)?;
            (c, s)
        }
        Samples::F32(v) => {
            let v = interleave(v, stored, planes, count).ok_or_else(short)?;
            (stored, Samples::F32(v))
        }
    };
    exif::read_tiff(file, &mut metadata);
    let orientation = decoder.find_tag_unsigned::<u16>(Tag::Orientation).ok().flatten().unwrap_or(1);
    // ExtraSamples 1 is associated alpha.
    let associated = decoder.find_tag_unsigned_vec::<u16>(Tag::ExtraSamples).ok().flatten().is_some_and(|v| v == [1]);
    let linear = matches!(samples, Samples::F32(_));
    Ok(Raster {
        width: w as usize,
        height: h as usize,
        channels,
        samples,
        transfer: if linear { Transfer::Power(1.0) } else { Transfer::Srgb },
        associated,
        orientation: Orientation::from_exif(u32::from(orientation)),
        metadata,
    })
}

/// Stored samples a pixel and bits a sample.
fn layout(colour: ColorType, path: &Path) -> Result<(usize, u8)> {
    match colour {
        ColorType::Gray(b) | ColorType::Palette(b) if [1, 2, 4, 8, 16, 32, 64].contains(&b) => Ok((1, b)),
        ColorType::GrayA(b) if [8, 16, 32, 64].contains(&b) => Ok((2, b)),
        ColorType::RGB(b) if [8, 16, 32, 64].contains(&b) => Ok((3, b)),
        ColorType::RGBA(b) if [8, 16, 32, 64].contains(&b) => Ok((4, b)),
        ColorType::CMYK(b) if [8, 16].contains(&b) => Ok((4, b)),
        other => Err(Error::unsupported(path, format!("TIFF of colour type {other:?}; convert it to RGB first"))),
    }
}

/// Integers as they are up to 16 bits, everything wider or floating as float.
fn convert(decoded: DecodingResult, path: &Path) -> Result<Samples> {
    Ok(match decoded {
        DecodingResult::U8(v) => Samples::U8(v),
        DecodingResult::U16(v) => Samples::U16(v),
        DecodingResult::U32(v) => Samples::U16(v.iter().map(|&v| (v >> 16) as u16).collect()),
        DecodingResult::F16(v) => Samples::F32(v.iter().map(|v| v.to_f32()).collect()),
        DecodingResult::F32(v) => Samples::F32(v),
        DecodingResult::F64(v) => Samples::F32(v.iter().map(|&v| v as f32).collect()),
        _ => return Err(Error::unsupported(path, "TIFF of signed or 64-bit integers; convert it to 16 bits first")),
    })
}

/// Samples of 1, 2 or 4 bits, rows padded to bytes, to 8: stretched to full range, or as they are for a palette.
fn unpack(packed: &[u8], row: usize, rows: usize, bits: u8, stretch: bool) -> Vec<u8> {
    let bits = usize::from(bits);
    let full = (1u16 << bits) - 1;
    let bytes = (row * bits).div_ceil(8);
    let mut out = Vec::with_capacity(row * rows);
    for line in packed.chunks_exact(bytes).take(rows) {
        out.extend((0..row).map(|i| {
            let shift = 8 - bits - (i * bits) % 8;
            let v = (u16::from(line[i * bits / 8]) >> shift) & full;
            if stretch { (v * 255 / full) as u8 } else { v as u8 }
        }));
    }
    out
}

/// Planes side by side to interleaved samples; `None` when there are too few.
fn interleave<T: Copy>(v: Vec<T>, stored: usize, planes: usize, count: usize) -> Option<Vec<T>> {
    if v.len() < count {
        return None;
    }
    if planes < 2 {
        let mut v = v;
        v.truncate(count);
        return Some(v);
    }
    let plane = count / stored;
    Some((0..count).map(|i| v[(i % stored) * plane + i / stored]).collect())
}

trait Code: Copy + Into<u32> {
    fn from_u32(v: u32) -> Self;
    fn wrap(v: Vec<Self>) -> Samples;
}

impl Code for u8 {
    fn from_u32(v: u32) -> Self {
        v as Self
    }
    fn wrap(v: Vec<Self>) -> Samples {
        Samples::U8(v)
    }
}

impl Code for u16 {
    fn from_u32(v: u32) -> Self {
        v as Self
    }
    fn wrap(v: Vec<Self>) -> Samples {
        Samples::U16(v)
    }
}

/// Interleaved gray or RGB codes with the number of channels; palettes become 16-bit RGB, CMYK becomes RGB.
fn rearrange<T: Code>(
    v: Vec<T>,
    stored: usize,
    planes: usize,
    count: usize,
    colour: ColorType,
    palette: &[u16],
    full: u32,
) -> Option<(usize, Samples)> {
    let v = interleave(v, stored, planes, count)?;
    match colour {
        ColorType::Palette(_) => {
            let entries = palette.len() / 3;
            let look_up = |i: usize, c: usize| palette.get(c * entries + i).copied().filter(|_| i < entries);
            let indices = v.iter().map(|&i| i.into() as usize);
            let rgb: Option<Vec<u16>> = indices.flat_map(|i| (0..3).map(move |c| look_up(i, c))).collect();
            Some((3, Samples::U16(rgb?)))
        }
        ColorType::CMYK(_) => {
            let ink = |p: &[T], c: usize| T::from_u32((full - p[c].into()) * (full - p[3].into()) / full);
            Some((3, T::wrap(v.chunks_exact(4).flat_map(|p| (0..3).map(|c| ink(p, c)).collect::<Vec<T>>()).collect())))
        }
        _ => Some((stored, T::wrap(v))),
    }
}

fn failed(path: &Path, e: tiff::TiffError) -> Error {
    match e {
        tiff::TiffError::UnsupportedError(e) => Error::unsupported(path, format!("TIFF: {e}")),
        tiff::TiffError::LimitsExceeded => Error::invalid(path, "the TIFF asks for more memory than its pixels need"),
        other => Error::invalid(path, format!("damaged or truncated TIFF ({other})")),
    }
}

/// Writes linear RGB as float TIFF.
///
/// # Errors
/// [`Error::Io`], [`Error::Unsupported`] for what TIFF cannot hold (4 GiB).
pub fn write_tiff_float(path: &Path, picture: &Picture) -> Result<()> {
    let (w, h) = picture.pixels.dimensions();
    save::<tiff::encoder::colortype::RGB32Float>(path, (w, h), picture.pixels.as_raw())
}

/// Writes 8-bit sRGB codes, `3 * width * height`.
///
/// # Errors
/// As [`write_tiff_float`].
pub fn write_tiff8(path: &Path, (width, height): (usize, usize), rgb: &[u8]) -> Result<()> {
    save::<tiff::encoder::colortype::RGB8>(path, (width as u32, height as u32), rgb)
}

/// Writes 16-bit sRGB codes, `3 * width * height`.
///
/// # Errors
/// As [`write_tiff_float`].
pub fn write_tiff16(path: &Path, (width, height): (usize, usize), rgb: &[u16]) -> Result<()> {
    save::<tiff::encoder::colortype::RGB16>(path, (width as u32, height as u32), rgb)
}

fn save<C: tiff::encoder::colortype::ColorType>(path: &Path, (w, h): (u32, u32), samples: &[C::Inner]) -> Result<()>
where
    [C::Inner]: tiff::encoder::TiffValue,
{
    atomic::write(path, |file: &mut BufWriter<&mut std::fs::File>| {
        let failed = |e: tiff::TiffError| match e {
            tiff::TiffError::IoError(e) => Error::io(path, e),
            other => Error::unsupported(path, format!("TIFF cannot hold this picture ({other})")),
        };
        let mut encoder = tiff::encoder::TiffEncoder::new(file).map_err(failed)?;
        encoder.write_image::<C>(w, h, samples).map_err(failed)
    })
}
