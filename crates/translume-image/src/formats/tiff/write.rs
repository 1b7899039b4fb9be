//! TIFF as it is written: 8 and 16-bit codes and floats, uncompressed.

use crate::{Error, Picture, Result, atomic};
use std::io::BufWriter;
use std::path::Path;

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
