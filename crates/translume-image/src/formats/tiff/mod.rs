//! TIFF and BigTIFF: integers of 1 to 64 bits, floats of 16, 24, 32 and 64; gray, palette, RGB, CMYK, YCbCr, CIE L*a*b*,
//! with alpha; strips, tiles, planes, predictors; both byte orders. Compressed by PackBits, LZW, DEFLATE, JPEG, fax of
//! group 4. The first picture of the file that is no thumbnail or mask is read.

mod chunks;
mod colour;
mod directory;
mod write;

use crate::raster::{Raster, Transfer};
use crate::{Error, Metadata, Result, Samples, exif, orient::Orientation};
use chunks::{FAX4, Layout};
use directory::{Directory, File};
use std::path::Path;
pub use write::{write_tiff_float, write_tiff8, write_tiff16};

/// Directories of one file that are looked at.
const MOST_PAGES: usize = 1 << 16;

pub(crate) fn read(bytes: &[u8], path: &Path) -> Result<Raster> {
    let damaged = || Error::invalid(path, "damaged TIFF header");
    let (file, first) = File::new(bytes).ok_or_else(damaged)?;
    let (page, directory) = choose(&file, first, path)?;
    let mut layout = Layout::new(&file, &directory, path)?;
    layout.page = page;
    let picture = Picture { file, directory: &directory, layout, path };
    let mut metadata = Metadata { icc: file.bytes_of(&directory, 34675).map(<[u8]>::to_vec), ..Metadata::default() };
    let pixels = picture.pixels(&mut metadata)?;
    facts(&file, &directory, &mut metadata);
    let orientation = file.integer(&directory, 274).unwrap_or(1);
    Ok(Raster {
        width: picture.layout.width,
        height: picture.layout.height,
        channels: pixels.channels,
        transfer: if matches!(pixels.samples, Samples::F32(_)) { Transfer::Power(1.0) } else { Transfer::Srgb },
        samples: pixels.samples,
        associated: pixels.associated,
        orientation: Orientation::from_exif(orientation as u32),
        metadata,
    })
}

/// The first directory that is a picture and neither a thumbnail nor a mask, with its number; says if there are more.
fn choose(file: &File<'_>, first: u64, path: &Path) -> Result<(usize, Directory)> {
    let (mut found, mut pictures, mut any) = (None, 0, None);
    let (mut next, mut seen) = (first, std::collections::HashSet::new());
    for number in 0..MOST_PAGES {
        if next == 0 || !seen.insert(next) {
            break;
        }
        let Some(directory) = file.directory(next) else { break };
        next = directory.next;
        let sort = file.integer(&directory, 254).unwrap_or(0);
        let small = sort & 0b101 != 0 || file.integer(&directory, 255) == Some(2);
        if small {
            any = any.or(Some((number, directory)));
        } else {
            pictures += 1;
            found = found.or(Some((number, directory)));
        }
    }
    if pictures > 1 {
        log::warn!("{}: it holds {pictures} pictures; the first is read", path.display());
    }
    found.or(any).ok_or_else(|| Error::invalid(path, "the TIFF has no picture (truncated or damaged)"))
}

/// The facts of the shot, from the EXIF directory and the picture's own.
fn facts(file: &File<'_>, directory: &Directory, metadata: &mut Metadata) {
    let shot = file.integer(directory, 34665).and_then(|at| file.directory(at)).unwrap_or_default();
    let tags = exif::TAGS.iter();
    let fields: Vec<_> = tags
        .filter_map(|&tag| {
            // Tags of the camera's settings are in either; those of the file are in the picture's own.
            let context = if tag >= 0x829a { ::exif::Context::Exif } else { ::exif::Context::Tiff };
            file.exif_field(&shot, tag, context).or_else(|| file.exif_field(directory, tag, context))
        })
        .collect();
    exif::read_fields(&fields, metadata);
}

/// A picture about to be decoded.
struct Picture<'a> {
    file: File<'a>,
    directory: &'a Directory,
    layout: Layout,
    path: &'a Path,
}

/// Its gray or RGB, with alpha if there is one.
struct Pixels {
    channels: usize,
    samples: Samples,
    associated: bool,
}

impl Picture<'_> {
    fn pixels(&self, metadata: &mut Metadata) -> Result<Pixels> {
        let refuse =
            |what: &str| Err(Error::unsupported(self.path, format!("TIFF of {what}; convert it to RGB first")));
        match self.file.integer(self.directory, 262) {
            Some(0) if self.layout.compression == FAX4 => self.plain(1, false), // turned over by its decoder
            Some(0) => self.plain(1, true),
            Some(1) => self.plain(1, false),
            Some(2) => self.plain(3, false),
            Some(3) => self.palette(),
            Some(5) => self.cmyk(metadata),
            Some(6) => self.ycbcr(),
            Some(lab @ (8 | 9)) => {
                metadata.icc = None; // L*a*b* is what profiles lead to
                self.lab(lab == 8)
            }
            Some(4) => refuse("a transparency mask"),
            Some(10) => refuse("ITU L*a*b*"),
            Some(32803 | 34892) => refuse("camera raw data"),
            Some(32844 | 32845) => refuse("LogL or LogLuv"),
            Some(other) => refuse(&format!("photometric interpretation {other}")),
            // Required, but what lacks it is gray or RGB by its number of channels.
            None => self.plain(if self.layout.samples < 3 { 1 } else { 3 }, false),
        }
    }

    /// Gray (1) or RGB (3) samples, with alpha; turned over where white is zero.
    fn plain(&self, colours: usize, white_is_zero: bool) -> Result<Pixels> {
        let (alpha, associated) = self.alpha(colours)?;
        let keep: Vec<usize> = (0..colours).chain(alpha).collect();
        let turn = |i: usize| white_is_zero && i < colours;
        let samples = match self.samples()? {
            Samples::U8(v) => Samples::U8(pick(v, self.layout.samples, &keep, |i, v| if turn(i) { !v } else { v })),
            Samples::U16(v) => Samples::U16(pick(v, self.layout.samples, &keep, |i, v| if turn(i) { !v } else { v })),
            Samples::F32(v) => {
                Samples::F32(pick(v, self.layout.samples, &keep, |i, v| if turn(i) { 1.0 - v } else { v }))
            }
        };
        Ok(Pixels { channels: keep.len(), samples, associated })
    }

    /// Which of the samples behind `colours` is alpha, and whether colour is multiplied by it (ExtraSamples).
    fn alpha(&self, colours: usize) -> Result<(Option<usize>, bool)> {
        let extra = self.layout.samples.checked_sub(colours).ok_or_else(|| {
            Error::invalid(self.path, format!("a TIFF of {} channels, where {colours} are colour", self.layout.samples))
        })?;
        let kinds = match self.file.integers(self.directory, 338) {
            Some(kinds) => kinds,
            // A channel that nothing is said of, alone behind the colours, is alpha as most writers mean it.
            None if extra == 1 => vec![2],
            None => Vec::new(),
        };
        let alpha = kinds.iter().take(extra).position(|k| matches!(k, 1 | 2));
        let left_out = extra - usize::from(alpha.is_some());
        if left_out > 0 {
            log::warn!("{}: {left_out} channels beside its colours are left out", self.path.display());
        }
        Ok((alpha.map(|a| colours + a), alpha.is_some_and(|a| kinds[a] == 1)))
    }

    /// All samples on the full range of their type.
    fn samples(&self) -> Result<Samples> {
        let (file, d, path) = (&self.file, self.directory, self.path);
        let bits = self.layout.bits;
        let full = if bits < 16 { (1u32 << bits) - 1 } else { 65535 };
        Ok(match (self.layout.float, bits) {
            (true, _) => Samples::F32(self.layout.decode(file, d, path, f32::from_bits)?),
            (_, 8) => Samples::U8(self.layout.decode(file, d, path, |v| v as u8)?),
            (_, 1 | 2 | 4) => Samples::U8(self.layout.decode(file, d, path, |v| (v * (255 / full)) as u8)?),
            (_, 16..) => Samples::U16(self.layout.decode(file, d, path, |v| v as u16)?),
            _ => Samples::U16(self.layout.decode(file, d, path, |v| ((v * 65535 + full / 2) / full) as u16)?),
        })
    }

    /// Integer codes of 1 to 16 bits as they stand.
    fn codes(&self, samples: usize, what: &str) -> Result<Vec<u16>> {
        if self.layout.float || self.layout.bits > 16 || self.layout.samples < samples {
            let (bits, have) = (self.layout.bits, self.layout.samples);
            let what = format!("TIFF of {what} in {have} samples of {bits} bits; convert it to RGB first");
            return Err(Error::unsupported(self.path, what));
        }
        let all = self.layout.decode(&self.file, self.directory, self.path, |v| v as u16)?;
        let keep: Vec<usize> = (0..samples).collect();
        Ok(pick(all, self.layout.samples, &keep, |_, v| v))
    }
}

/// The samples `keep` of each pixel, through `code` with their place among them.
fn pick<T: Copy>(v: Vec<T>, samples: usize, keep: &[usize], code: impl Fn(usize, T) -> T) -> Vec<T> {
    if keep.len() == samples && keep.is_sorted() {
        let mut v = v;
        v.chunks_exact_mut(samples).for_each(|p| p.iter_mut().enumerate().for_each(|(i, s)| *s = code(i, *s)));
        return v;
    }
    v.chunks_exact(samples).flat_map(|p| keep.iter().enumerate().map(|(i, &k)| code(i, p[k]))).collect()
}
