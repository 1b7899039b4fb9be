//! JPEG: zune-jpeg's decoder, with the check for an end that it leaves to its caller.

use crate::limits::{self, Claim};
use crate::raster::{Raster, Transfer};
use crate::{Error, Metadata, Result, Samples, atomic, exif, orient::Orientation};
use image::ImageEncoder;
use std::path::Path;
use zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};
use zune_jpeg::JpegDecoder;

pub(crate) fn read(file: &[u8], path: &Path) -> Result<Raster> {
    let invalid = |e: zune_jpeg::errors::DecodeErrors| Error::invalid(path, format!("damaged JPEG ({e:?})"));
    // Strict mode refuses harmless padding that cameras write; truncation is checked below instead.
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
    if !reaches_end(file) {
        return Err(Error::invalid(path, "the JPEG ends before its picture does (truncated); copy the file again"));
    }
    let mut samples = limits::buffer::<u8>(path, count)?;
    decoder.decode_into(&mut samples).map_err(invalid)?;

    let mut metadata = Metadata { icc: decoder.icc_profile(), ..Metadata::default() };
    let orientation = decoder.exif().map_or(Orientation::default(), |e| exif::read_block(e.clone(), &mut metadata).orientation);
    Ok(Raster {
        width,
        height,
        channels: channels as usize,
        samples: Samples::U8(samples),
        transfer: Transfer::Srgb,
        associated: true,
        orientation,
        metadata,
    })
}

/// Whether the marker structure runs through to the end-of-image marker (thumbnails inside segments do not count).
fn reaches_end(file: &[u8]) -> bool {
    let mut i = 2;
    loop {
        // Skips entropy-coded bytes and fill bytes up to a marker that is neither a stuffed zero nor a restart.
        while i + 1 < file.len() && (file[i] != 0xff || matches!(file[i + 1], 0x00 | 0xff | 0xd0..=0xd7)) {
            i += 1;
        }
        let Some(&marker) = file.get(i + 1) else { return false };
        if marker == 0xd9 {
            return true;
        }
        let Some(length) = file.get(i + 2..i + 4) else { return false };
        i += 2 + usize::from(u16::from_be_bytes([length[0], length[1]]));
    }
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
