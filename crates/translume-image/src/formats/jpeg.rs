//! JPEG: zune-jpeg's decoder, with the check for missing data that it leaves to its caller.

use super::jpeg_scan;
use crate::limits::{self, Claim};
use crate::raster::{Raster, Transfer};
use crate::{Error, Metadata, Result, Samples, atomic, colour::Space, exif};
use image::ImageEncoder;
use std::path::Path;
use zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};
use zune_jpeg::JpegDecoder;

pub(crate) fn read(file: &[u8], path: &Path) -> Result<Raster> {
    let invalid = |e: zune_jpeg::errors::DecodeErrors| Error::invalid(path, format!("damaged JPEG ({e:?})"));
    // Strict mode refuses harmless padding that cameras write, and accepts missing data, which is looked for below.
    let options = DecoderOptions::default().set_strict_mode(false).set_max_width(65535).set_max_height(65535);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(file), options);
    decoder.decode_headers().map_err(invalid)?;
    let (width, height) = decoder.dimensions().ok_or_else(|| Error::invalid(path, "JPEG without a frame header"))?;
    let gray = decoder.input_colorspace() == Some(ColorSpace::Luma);
    let (space, channels) = if gray { (ColorSpace::Luma, 1) } else { (ColorSpace::RGB, 3) };
    decoder.set_options(options.jpeg_set_out_colorspace(space));
    let (size, file_bytes) = ((width as u64, height as u64), file.len() as u64);
    let claim = Claim { size, channels, bits: 8 * channels, file_bytes, max_ratio: limits::MAX_RATIO };
    let count = claim.samples(path)?;
    jpeg_scan::check(file, (width, height)).map_err(|fault| Error::invalid(path, fault.to_string()))?;
    let mut samples = limits::buffer::<u8>(path, count)?;
    decoder.decode_into(&mut samples).map_err(invalid)?;

    let mut metadata = Metadata { icc: profile(file, path), ..Metadata::default() };
    if decoder.input_colorspace().is_some_and(|s| s.num_components() == 4) {
        let of = if metadata.icc.take().is_some() { "its profile is not used" } else { "it has no profile" };
        log::warn!("{}: CMYK is turned into RGB by the plain formula ({of})", path.display());
    }
    let block = decoder.exif().map_or_else(Default::default, |e| exif::read_block(e.clone(), &mut metadata));
    let mut transfer = Transfer::Srgb;
    if block.adobe_rgb && metadata.icc.is_none() && !gray {
        transfer = Transfer::Power(563.0 / 256.0);
        metadata.chromaticities = Some(Space::ADOBE_RGB.chromaticities());
    }
    Ok(Raster {
        width,
        height,
        channels: channels as usize,
        samples: Samples::U8(samples),
        transfer,
        associated: true,
        orientation: block.orientation,
        metadata,
    })
}

/// The ICC profile of the APP2 segments (ICC.1 Annex B.4), in the order of their numbers; a warning if one is missing.
fn profile(file: &[u8], path: &Path) -> Option<Vec<u8>> {
    let (mut parts, mut count): (Vec<(u8, &[u8])>, u8) = (Vec::new(), 0);
    let mut at = 2;
    // The segments before the first scan.
    while let Some(&[0xff, marker, high, low]) = file.get(at..at + 4) {
        if marker == 0xff {
            at += 1;
            continue;
        }
        let end = at + 2 + (usize::from(high) << 8 | usize::from(low));
        if matches!(marker, 0xda | 0xd9) {
            break;
        }
        if let Some(part) = file.get(at + 4..end).filter(|_| marker == 0xe2)
            && let Some([number, all, data @ ..]) = part.strip_prefix(b"ICC_PROFILE\0")
        {
            parts.push((*number, data));
            count = count.max(*all);
        }
        at = end.max(at + 2);
    }
    if parts.is_empty() {
        return None;
    }
    parts.sort_by_key(|p| p.0);
    if parts.len() != usize::from(count) || parts.iter().zip(1..).any(|(p, i)| p.0 != i) {
        let found = parts.len();
        log::warn!("{}: {found} of the {count} parts of its ICC profile are there; read as sRGB", path.display());
        return None;
    }
    Some(parts.into_iter().flat_map(|p| p.1).copied().collect())
}

/// Writes 8-bit sRGB, `3 * width * height` values, at a `quality` of 1 to 100, colour at full resolution.
///
/// # Errors
/// As [`encode_jpeg`], with the file's name; [`Error::Io`].
pub fn write_jpeg(path: &Path, size: (usize, usize), rgb: &[u8], quality: u8) -> Result<()> {
    let named = |e| Error::Mismatch(format!("{}: {e}", path.display()));
    atomic::write_bytes(path, &encode_jpeg(size, rgb, quality).map_err(named)?)
}

/// The bytes of such a file.
///
/// # Errors
/// [`Error::Mismatch`] when `rgb` has another length than `3 * width * height`, or beyond 65535 pixels a side.
pub fn encode_jpeg((width, height): (usize, usize), rgb: &[u8], quality: u8) -> Result<Vec<u8>> {
    if rgb.len() != 3 * width * height {
        return Err(Error::Mismatch(format!("{} values for {width} × {height} pixels", rgb.len())));
    }
    let (Ok(w), Ok(h)) = (u16::try_from(width), u16::try_from(height)) else {
        return Err(Error::Mismatch(format!("{width} × {height} pixels: JPEG holds 65535 a side")));
    };
    let mut out = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut out, quality.clamp(1, 100))
        .write_image(rgb, u32::from(w), u32::from(h), image::ExtendedColorType::Rgb8)
        .map_err(|e| Error::Mismatch(format!("{width} × {height} pixels: {e}")))?;
    Ok(out)
}
