//! Reading any supported file.

use crate::formats::{exr_read, jpeg, pfm, png, radiance, raw, tga, tiff};
use crate::raster::Raster;
use crate::{Codes, Error, Orientation, Picture, Result, Samples, linear};
use image::Rgb32FImage;
use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

/// File formats, told by their first bytes and not by their names (but for TGA, which has no mark there).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// OpenEXR.
    Exr,
    /// Radiance RGBE or XYZE.
    Radiance,
    /// Portable float map.
    Pfm,
    /// PNG.
    Png,
    /// JPEG.
    Jpeg,
    /// TIFF.
    Tiff,
    /// Truevision TGA.
    Tga,
}

impl Format {
    /// The format that a file starting with `head` (eight bytes or more) has.
    pub fn of(head: &[u8]) -> Option<Self> {
        match head {
            [0x76, 0x2f, 0x31, 0x01, ..] => Some(Self::Exr),
            [b'#', b'?', ..] => Some(Self::Radiance),
            [b'P', b'F' | b'f', w, ..] if w.is_ascii_whitespace() => Some(Self::Pfm),
            [0x89, b'P', b'N', b'G', ..] => Some(Self::Png),
            [0xff, 0xd8, 0xff, ..] => Some(Self::Jpeg),
            [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => Some(Self::Tiff),
            _ => None,
        }
    }

    /// The format of the file at `path`.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Invalid`] and [`Error::Unsupported`] for what is none of them.
    pub fn of_file(path: &Path) -> Result<Self> {
        let mut head = Vec::with_capacity(16);
        let file = File::open(path).map_err(|e| Error::io(path, e))?;
        file.take(16).read_to_end(&mut head).map_err(|e| Error::io(path, e))?;
        format_of(&head, path)
    }

    /// Its usual name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Exr => "OpenEXR",
            Self::Radiance => "Radiance HDR",
            Self::Pfm => "PFM",
            Self::Png => "PNG",
            Self::Jpeg => "JPEG",
            Self::Tiff => "TIFF",
            Self::Tga => "TGA",
        }
    }
}

/// Reads encoded values as the camera stored them, upright, gray expanded to RGB, alpha left out, 8-bit codes kept as 8
/// bits.
///
/// # Errors
/// [`Error::Io`]; [`Error::Invalid`] for damaged or truncated files; [`Error::Unsupported`] for formats and sizes that
/// are not read.
pub fn read_codes(path: &Path) -> Result<Codes> {
    Ok(read(path, None)?.into_codes().0)
}

/// Reads linear light in Rec. 709: 8 and 16-bit files through their ICC profile or the sRGB curve, OpenEXR and Radiance
/// through their primaries (whites adapted by Bradford). NaN and infinities pass through; see
/// [`Picture::count_non_finite`].
///
/// # Errors
/// As [`read_codes`].
pub fn read_picture(path: &Path) -> Result<Picture> {
    picture(read(path, None)?, path)
}

/// [`read_picture`] of one layer of an OpenEXR file: channels such as `albedo.R` make the layer `albedo`, and a part is
/// the layer of its name.
///
/// # Errors
/// As [`read_codes`]; [`Error::Mismatch`] when there is no such layer.
pub fn read_layer(path: &Path, layer: &str) -> Result<Picture> {
    picture(read(path, Some(layer))?, path)
}

/// [`read_codes`] of a file in memory; `name` stands in messages.
///
/// # Errors
/// As [`read_codes`].
pub fn decode_codes(file: &[u8], name: &Path) -> Result<Codes> {
    Ok(decode(file, name)?.into_codes().0)
}

/// [`decode_picture`] with colours as the file stores them where it has alpha: not multiplied by it. Textures are meant so.
///
/// # Errors
/// As [`read_codes`].
pub fn decode_straight(file: &[u8], name: &Path) -> Result<Picture> {
    picture(Raster { associated: true, ..decode(file, name)? }, name)
}

/// Encoded values as a file in memory stores them, neither turned upright nor seen through what it says of its colours,
/// and its alpha in [0, 1] where it has such. glTF wants PNG and JPEG so.
///
/// # Errors
/// As [`read_codes`].
pub fn decode_stored(file: &[u8], name: &Path) -> Result<(Codes, Option<Vec<f32>>)> {
    Ok(Raster { orientation: Orientation::default(), ..decode(file, name)? }.into_codes())
}

/// [`read_picture`] of a file in memory; `name` stands in messages.
///
/// # Errors
/// As [`read_codes`].
pub fn decode_picture(file: &[u8], name: &Path) -> Result<Picture> {
    picture(decode(file, name)?, name)
}

fn picture(raster: Raster, path: &Path) -> Result<Picture> {
    let (transfer, associated) = (raster.transfer, raster.associated);
    let (codes, alpha) = raster.into_codes();
    let (width, height) = (codes.width as u32, codes.height as u32);
    let (mut rgb, metadata) = linear::linearise(codes, transfer, path)?;
    if let Some(alpha) = alpha.as_ref().filter(|_| !associated) {
        rgb.as_chunks_mut::<3>().0.iter_mut().zip(alpha).for_each(|(p, a)| *p = p.map(|v| v * a));
    }
    let pixels = Rgb32FImage::from_raw(width, height, rgb)
        .ok_or_else(|| Error::invalid(path, "fewer pixels than the header says"))?;
    Ok(Picture { pixels, alpha, metadata })
}

fn read(path: &Path, layer: Option<&str>) -> Result<Raster> {
    let io = |e| Error::io(path, e);
    let mut file = File::open(path).map_err(io)?;
    if raw::is_raw(path) {
        return raw::read(path);
    }
    let length = file.metadata().map_err(io)?.len();
    let mut head = Vec::with_capacity(16);
    (&mut file).take(16).read_to_end(&mut head).map_err(io)?;
    file.seek(SeekFrom::Start(0)).map_err(io)?;
    // OpenEXR files may be larger than their picture (other parts and levels): streamed. The others are read whole.
    if Format::of(&head) == Some(Format::Exr) {
        return exr_read::read(BufReader::with_capacity(1 << 16, file), layer, length, path);
    }
    let format = format_of(&head, path)?;
    if layer.is_some() {
        let message = format!("{}: {} files have no layers", path.display(), format.name());
        return Err(Error::Mismatch(message));
    }
    let mut bytes = Vec::new();
    bytes
        .try_reserve_exact(usize::try_from(length).unwrap_or(usize::MAX))
        .map_err(|_| Error::unsupported(path, "the file is larger than this machine's memory"))?;
    file.read_to_end(&mut bytes).map_err(io)?;
    decode(&bytes, path)
}

fn format_of(head: &[u8], path: &Path) -> Result<Format> {
    let by_name = (!head.is_empty() && tga::is_tga(path)).then_some(Format::Tga);
    Format::of(head).or(by_name).ok_or_else(|| match head {
        [] => Error::invalid(path, "the file is empty"),
        _ => Error::unsupported(path, "not a picture that is read here (OpenEXR, Radiance, PFM, PNG, JPEG, TIFF, TGA)"),
    })
}

fn decode(file: &[u8], path: &Path) -> Result<Raster> {
    match format_of(file, path)? {
        Format::Exr => exr_read::read(Cursor::new(file), None, file.len() as u64, path),
        Format::Radiance => radiance::read(file, path),
        Format::Pfm => pfm::read(file, path),
        Format::Png => png::read(file, path),
        Format::Jpeg => jpeg::read(file, path),
        Format::Tiff => tiff::read(file, path),
        Format::Tga => tga::read(file, path),
    }
}

impl Picture {
    /// How many samples are NaN or infinite. Reading lets them pass; most algorithms want none.
    pub fn count_non_finite(&self) -> usize {
        self.pixels.as_raw().iter().filter(|v| !v.is_finite()).count()
    }

    /// Sets samples that are NaN or infinite to 0 and returns their number.
    pub fn clear_non_finite(&mut self) -> usize {
        self.pixels.iter_mut().filter(|v| !v.is_finite()).map(|v| *v = 0.0).count()
    }
}

impl Codes {
    /// How many samples are NaN or infinite; integers never are.
    pub fn count_non_finite(&self) -> usize {
        match &self.samples {
            Samples::F32(v) => v.iter().filter(|v| !v.is_finite()).count(),
            _ => 0,
        }
    }
}
