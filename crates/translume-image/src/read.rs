//! Reading any supported file.

use crate::formats::{exr_read, jpeg, pfm, png, radiance, raw, tga, tiff};
use crate::raster::{Raster, Transfer};
use crate::{Codes, Error, Orientation, Picture, Result, Samples, limits, linear};
use image::Rgb32FImage;
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
        let (file, _) = limits::open(path)?;
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

/// [`read_codes`], and the file's alpha in [0, 1] beside it, one value a pixel, where there is some.
///
/// # Errors
/// As [`read_codes`].
pub fn read_codes_alpha(path: &Path) -> Result<(Codes, Option<Vec<f32>>)> {
    Ok(read(path, None)?.into_codes())
}

/// Reads linear light in Rec. 709: 8 and 16-bit files through what they say about their colour or the sRGB curve, OpenEXR
/// and Radiance through their primaries (whites adapted by Bradford). NaN and infinities pass through; see
/// [`Picture::count_non_finite`]. What had to be passed over (a damaged profile, layers beside the one that is read) is
/// a warning in the log.
///
/// # Errors
/// As [`read_codes`].
pub fn read_picture(path: &Path) -> Result<Picture> {
    picture(read(path, None)?, path, true)
}

/// [`read_picture`] of one layer of an OpenEXR file: channels such as `albedo.R` make the layer `albedo`, and a part is
/// the layer of its name.
///
/// # Errors
/// As [`read_codes`]; [`Error::Mismatch`] when there is no such layer.
pub fn read_layer(path: &Path, layer: &str) -> Result<Picture> {
    picture(read(path, Some(layer))?, path, true)
}

/// [`read_codes`] of a file in memory; `name` stands in messages.
///
/// # Errors
/// As [`read_codes`].
pub fn decode_codes(file: &[u8], name: &Path) -> Result<Codes> {
    Ok(decode(file, name)?.into_codes().0)
}

/// How the numbers of a texture are meant, where the scene and not the picture file says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TextureCodes {
    /// Integer codes are sRGB, whatever the file says; floats are linear, in the primaries that the file names.
    Srgb,
    /// The numbers as they stand, integers over their maximum.
    Stored,
}

/// A texture in memory; `name` stands in messages. Scene formats give the meaning of the codes and the place of texture
/// coordinates themselves: profiles, gamma and code points of integer files are passed over, and so is the orientation
/// of EXIF. Colours are not multiplied by alpha.
///
/// # Errors
/// As [`read_codes`].
pub fn decode_texture(file: &[u8], name: &Path, codes: TextureCodes) -> Result<Picture> {
    let mut raster = decode(file, name)?;
    let exif = matches!(Format::of(file), Some(Format::Png | Format::Jpeg | Format::Tiff));
    if exif {
        raster.orientation = Orientation::default();
    }
    let float = matches!(raster.samples, Samples::F32(_));
    if codes == TextureCodes::Stored || !float {
        raster.metadata.icc = None;
        raster.metadata.chromaticities = None;
        raster.transfer = if codes == TextureCodes::Stored { Transfer::Power(1.0) } else { Transfer::Srgb };
    }
    picture(raster, name, false)
}

/// [`read_picture`] of a file in memory; `name` stands in messages.
///
/// # Errors
/// As [`read_codes`].
pub fn decode_picture(file: &[u8], name: &Path) -> Result<Picture> {
    picture(decode(file, name)?, name, true)
}

/// Linear light of stored samples, multiplied by alpha if `multiply`.
fn picture(raster: Raster, path: &Path, multiply: bool) -> Result<Picture> {
    let (transfer, mut associated, gray) = (raster.transfer, raster.associated, raster.channels < 3);
    let (mut codes, alpha) = raster.into_codes();
    let (width, height) = (codes.width as u32, codes.height as u32);
    if let Some(alpha) = alpha.as_ref().filter(|_| associated && !codes.is_linear()) {
        codes.samples = straight(&codes, alpha);
        associated = false;
    }
    let (mut rgb, metadata) = linear::linearise(codes, transfer, gray, path);
    if let Some(alpha) = alpha.as_ref().filter(|_| multiply && !associated) {
        rgb.as_chunks_mut::<3>().0.iter_mut().zip(alpha).for_each(|(p, a)| *p = p.map(|v| v * a));
    }
    let pixels = Rgb32FImage::from_raw(width, height, rgb)
        .ok_or_else(|| Error::invalid(path, "fewer pixels than the header says"))?;
    Ok(Picture { pixels, alpha, metadata })
}

/// Codes that alpha was multiplied into, without it: light is their curve's before it is multiplied.
fn straight(codes: &Codes, alpha: &[f32]) -> Samples {
    let whole = |i: usize| match alpha.get(i / 3) {
        Some(a) if *a > 0.0 => ((codes.unit(i) / a).min(1.0) * 65535.0).round() as u16,
        _ => 0,
    };
    Samples::U16((0..3 * codes.width * codes.height).map(whole).collect())
}

fn read(path: &Path, layer: Option<&str>) -> Result<Raster> {
    let io = |e| Error::io(path, e);
    let (mut file, length) = limits::open(path)?;
    if raw::is_raw(path) {
        return raw::read(path);
    }
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
    file.take(length).read_to_end(&mut bytes).map_err(io)?;
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
