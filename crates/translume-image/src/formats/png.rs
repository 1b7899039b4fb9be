//! PNG, 1 to 16 bits, every colour type; what its other chunks say is read in `png_chunks`.

use super::png_chunks;
use crate::limits::{self, Claim};
use crate::raster::Raster;
use crate::{Error, Result, Samples, atomic, guard};
use std::io::Cursor;
use std::path::Path;

pub(crate) fn read(file: &[u8], path: &Path) -> Result<Raster> {
    let invalid = |e: png::DecodingError| Error::invalid(path, format!("damaged or truncated PNG ({e})"));
    let decodable = png_chunks::without_bad_code_points(file);
    let mut decoder = png::Decoder::new(Cursor::new(&*decodable));
    decoder.set_transformations(png::Transformations::EXPAND);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    let header = decoder.read_header_info().map_err(invalid)?;
    let size = (u64::from(header.width), u64::from(header.height));
    let bits = (header.color_type.samples() * header.bit_depth as usize) as u64;
    let claim = Claim { size, channels: 1, bits, file_bytes: file.len() as u64, max_ratio: limits::MAX_RATIO };
    claim.samples(path)?;
    // The pixels are counted here; this limit is for what the decoder holds beside them (rows, chunks).
    decoder.set_limits(png::Limits { bytes: 64 << 20 });
    // The png crate (0.18) panics on palettes that are cut in the middle of a colour.
    let damaged = || Error::invalid(path, "damaged PNG");
    let mut reader = guard::run(|| decoder.read_info()).ok_or_else(damaged)?.map_err(invalid)?;
    let (colour, depth) = reader.output_color_type();
    let channels = colour.samples();
    // Palettes and gray of a few bits grow here; what the file must hold was checked above.
    let count = Claim { channels: channels as u64, ..claim }.samples(path)?;

    let (samples, bits) = if depth == png::BitDepth::Sixteen {
        let mut big_endian = limits::buffer::<u8>(path, count * 2)?;
        guard::run(|| reader.next_frame(&mut big_endian)).ok_or_else(damaged)?.map_err(invalid)?;
        (Samples::U16(big_endian.as_chunks::<2>().0.iter().map(|b| u16::from_be_bytes(*b)).collect()), 16)
    } else {
        let mut v = limits::buffer::<u8>(path, count)?;
        guard::run(|| reader.next_frame(&mut v)).ok_or_else(damaged)?.map_err(invalid)?;
        (Samples::U8(v), 8)
    };
    let facts = png_chunks::facts(file, bits, path);
    Ok(Raster {
        width: size.0 as usize,
        height: size.1 as usize,
        channels,
        samples,
        transfer: facts.transfer,
        associated: false,
        orientation: facts.orientation,
        metadata: facts.metadata,
    })
}

/// Writes 8-bit sRGB, `3 * width * height` values.
///
/// # Errors
/// [`Error::Io`], or [`Error::Mismatch`] when the number of values is not that of the size.
pub fn write_png8(path: &Path, (width, height): (usize, usize), rgb: &[u8]) -> Result<()> {
    write(path, (width, height), png::ColorType::Rgb, png::BitDepth::Eight, rgb)
}

/// Writes 16-bit sRGB, `3 * width * height` values.
///
/// # Errors
/// As [`write_png8`].
pub fn write_png16(path: &Path, (width, height): (usize, usize), rgb: &[u16]) -> Result<()> {
    let bytes: Vec<u8> = rgb.iter().flat_map(|v| v.to_be_bytes()).collect();
    write(path, (width, height), png::ColorType::Rgb, png::BitDepth::Sixteen, &bytes)
}

/// Writes 8-bit gray, `width * height` values (masks, confidences).
///
/// # Errors
/// As [`write_png8`].
pub fn write_gray_png(path: &Path, (width, height): (usize, usize), gray: &[u8]) -> Result<()> {
    write(path, (width, height), png::ColorType::Grayscale, png::BitDepth::Eight, gray)
}

fn write(
    path: &Path,
    (width, height): (usize, usize),
    colour: png::ColorType,
    depth: png::BitDepth,
    bytes: &[u8],
) -> Result<()> {
    let per_pixel = colour.samples() * if depth == png::BitDepth::Sixteen { 2 } else { 1 };
    if width == 0 || height == 0 || bytes.len() != width * height * per_pixel {
        return Err(Error::Mismatch(format!(
            "{}: {} bytes are no {width} × {height} picture",
            path.display(),
            bytes.len()
        )));
    }
    let (Ok(w), Ok(h)) = (u32::try_from(width), u32::try_from(height)) else {
        return Err(Error::unsupported(path, "PNG sides are at most 2^32 - 1 pixels"));
    };
    atomic::write(path, |file| {
        let failed = |e: png::EncodingError| match e {
            png::EncodingError::IoError(e) => Error::io(path, e),
            other => Error::unsupported(path, format!("PNG cannot hold this picture ({other})")),
        };
        let mut encoder = png::Encoder::new(file, w, h);
        encoder.set_color(colour);
        encoder.set_depth(depth);
        encoder.set_compression(png::Compression::Fast);
        if colour == png::ColorType::Rgb {
            encoder.set_source_srgb(png::SrgbRenderingIntent::RelativeColorimetric);
        }
        let mut writer = encoder.write_header().map_err(failed)?;
        writer.write_image_data(bytes).map_err(failed)?;
        writer.finish().map_err(failed)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gamma_chunk_is_followed_unless_srgb_is_said() {
        let encode = |srgb: bool, gamma: f32| {
            let mut bytes = Vec::new();
            let mut encoder = png::Encoder::new(&mut bytes, 1, 1);
            encoder.set_color(png::ColorType::Rgb);
            encoder.set_source_gamma(png::ScaledFloat::new(gamma));
            if srgb {
                encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
            }
            let mut writer = encoder.write_header().unwrap();
            writer.write_image_data(&[51, 102, 204]).unwrap();
            writer.finish().unwrap();
            bytes
        };
        let read = |bytes: Vec<u8>| crate::decode_picture(&bytes, Path::new("a.png")).unwrap().pixels.into_raw();
        for (got, expected) in read(encode(false, 1.0)).into_iter().zip([0.2f32, 0.4, 0.8]) {
            assert!((got - expected).abs() < 1e-6);
        }
        let srgb = read(encode(true, 0.45455));
        assert!((srgb[2] - crate::colour::srgb_to_linear(0.8)).abs() < 1e-6);
    }

    #[test]
    fn sizes_that_do_not_fit_are_refused() {
        assert!(write_png8(Path::new("a.png"), (2, 2), &[0; 11]).is_err());
        assert!(write_gray_png(Path::new("a.png"), (0, 0), &[]).is_err());
    }
}
