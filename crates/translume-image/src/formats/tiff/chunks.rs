//! The samples of a TIFF picture: strips and tiles are unpacked, their rows taken apart, predictors undone
//! (TIFF 6.0 §§ 3, 7, 9, 13, 14; Technical Notes 2 and 3 of 2002 and 2005).

use super::directory::{Directory, File};
use crate::limits::{self, Claim};
use crate::{Error, Result, formats::jpeg_scan};
use std::borrow::Cow;
use std::io::Read;
use std::path::Path;
use zune_core::{bytestream::ZCursor, options::DecoderOptions};

/// How the samples lie in the file.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    pub width: usize,
    pub height: usize,
    /// Bits of a sample, 1 to 64.
    pub bits: usize,
    pub float: bool,
    /// Samples of a pixel.
    pub samples: usize,
    /// Horizontal and vertical pixels to a chroma sample; (1, 1) where there is no chroma, or JPEG sees to it.
    pub subsampling: (usize, usize),
    pub compression: u64,
    /// The number of the directory in the file.
    pub page: usize,
    /// Each sample in strips or tiles of its own.
    planar: bool,
    tiled: bool,
    /// Width and height of a strip or tile.
    chunk: (usize, usize),
    predictor: u64,
    /// The first pixel of a byte is in its lowest bits.
    reversed: bool,
    offsets: Vec<u64>,
    counts: Vec<u64>,
}

pub(crate) const JPEG: u64 = 7;
pub(crate) const FAX4: u64 = 4;

impl Layout {
    /// From the fields of a directory. Nothing is allocated before the size was held against the file.
    pub(crate) fn new(file: &File<'_>, d: &Directory, path: &Path) -> Result<Self> {
        let missing = |what: &str| Error::invalid(path, format!("the TIFF says nothing of its {what} (damaged)"));
        let refuse = |what: String| Error::unsupported(path, format!("TIFF of {what}; convert it first"));
        let number = |tag: u16, default: u64| file.integer(d, tag).unwrap_or(default);
        let side = |tag: u16, what: &str| -> Result<usize> {
            file.integer(d, tag).filter(|v| *v <= u64::from(u32::MAX)).map(|v| v as usize).ok_or_else(|| missing(what))
        };
        let (width, height) = (side(256, "width")?, side(257, "height")?);
        // The tag has 16 bits, but a damaged file may give it any type.
        let samples = number(277, 1).min(u64::from(u16::MAX)) as usize;
        let bits = file.integers(d, 258).unwrap_or_else(|| vec![1]);
        let formats = file.integers(d, 339).unwrap_or_else(|| vec![1]);
        if bits.iter().any(|b| *b != bits[0]) || formats.iter().any(|f| *f != formats[0]) {
            return Err(refuse(format!("channels of different kinds (bits {bits:?})")));
        }
        let (bits, format) = (bits.first().copied().unwrap_or(1), formats.first().copied().unwrap_or(1));
        let float = format == 3;
        match format {
            1 | 4 if (1..=64).contains(&bits) => {}
            3 if [16, 24, 32, 64].contains(&bits) => {}
            2 => return Err(refuse(format!("signed {bits}-bit integers"))),
            3 => return Err(refuse(format!("{bits}-bit floats"))),
            _ => return Err(refuse(format!("{bits}-bit samples of format {format}"))),
        }
        let tiled = d.has(324);
        let chunk = if tiled {
            (side(322, "tile width")?, side(323, "tile height")?)
        } else {
            (width, number(278, u64::from(u32::MAX)).clamp(1, height.max(1) as u64) as usize)
        };
        let claim = Claim {
            size: (width as u64, height as u64),
            channels: samples as u64,
            bits: samples as u64 * bits,
            file_bytes: file.bytes.len() as u64,
            max_ratio: limits::MAX_RATIO,
        };
        claim.samples(path)?;
        Claim { size: (chunk.0 as u64, chunk.1 as u64), ..claim }.samples(path)?;
        let offsets = file.integers(d, if tiled { 324 } else { 273 }).ok_or_else(|| missing("pixels"))?;
        let mut layout = Self {
            width,
            height,
            bits: bits as usize,
            float,
            samples,
            subsampling: (1, 1),
            compression: number(259, 1),
            page: 0,
            planar: number(284, 1) == 2 && samples > 1,
            tiled,
            chunk,
            predictor: number(317, 1),
            reversed: number(266, 1) == 2,
            offsets,
            counts: file.integers(d, if tiled { 325 } else { 279 }).unwrap_or_default(),
        };
        layout.check(file, d, path)?;
        Ok(layout)
    }

    /// What cannot be taken apart, and the chroma of YCbCr.
    fn check(&mut self, file: &File<'_>, d: &Directory, path: &Path) -> Result<()> {
        let refuse = |what: String| Err(Error::unsupported(path, format!("TIFF of {what}; convert it first")));
        let whole = self.bits.is_multiple_of(8) && self.bits != 40 && self.bits != 48 && self.bits != 56;
        match self.predictor {
            1 => {}
            2 if whole => {}
            3 if self.float => {}
            p => return refuse(format!("{}-bit samples with predictor {p}", self.bits)),
        }
        if file.integer(d, 262) == Some(6) && self.compression != JPEG {
            let chroma = file.integers(d, 530).unwrap_or_else(|| vec![2, 2]);
            let known = |v: &u64| matches!(v, 1 | 2 | 4);
            if chroma.len() != 2 || !chroma.iter().all(known) || self.bits != 8 || self.samples != 3 || self.planar {
                return refuse("YCbCr in an unusual form".into());
            }
            self.subsampling = (chroma[0] as usize, chroma[1] as usize);
        }
        if self.compression == FAX4 && (self.reversed || self.bits != 1 || self.samples != 1) {
            return refuse("fax in an unusual form".into());
        }
        if self.compression == JPEG && (self.bits != 8 || self.float) {
            return refuse(format!("{}-bit JPEG", self.bits));
        }
        let (across, down) = (self.width.div_ceil(self.chunk.0), self.height.div_ceil(self.chunk.1));
        let wanted = across * down * if self.planar { self.samples } else { 1 };
        if self.offsets.len() < wanted {
            return Err(Error::invalid(
                path,
                "the TIFF lists fewer strips than its picture has (truncated or damaged)",
            ));
        }
        Ok(())
    }

    /// All samples, interleaved, each as its raw code (the upper 16 bits of longer integers; floats as their 32 bits).
    pub(crate) fn decode<T: Clone + Default>(
        &self,
        file: &File<'_>,
        d: &Directory,
        path: &Path,
        code: impl Fn(u32) -> T,
    ) -> Result<Vec<T>> {
        let mut out = limits::buffer::<T>(path, self.width * self.height * self.samples)?;
        let (across, down) = (self.width.div_ceil(self.chunk.0), self.height.div_ceil(self.chunk.1));
        let (planes, samples) = if self.planar { (self.samples, 1) } else { (1, self.samples) };
        let tables = file.bytes_of(d, 347).unwrap_or_default();
        let mut row = Vec::new();
        for index in 0..planes * across * down {
            let (plane, x0) = (index / (across * down), index % across * self.chunk.0);
            let y0 = index / across % down * self.chunk.1;
            let rows = self.chunk.1.min(self.height - y0);
            let stored = if self.tiled { self.chunk.1 } else { rows };
            let columns = self.chunk.0.min(self.width - x0);
            let row_bytes = (self.chunk.0 * samples * self.bits).div_ceil(8);
            let bytes = self.unpack(file, index, (stored, row_bytes), tables, path)?;
            for (y, line) in bytes.chunks_exact(row_bytes).take(rows).enumerate() {
                self.row(line, self.chunk.0 * samples, samples, file.little, &mut row);
                let start = ((y0 + y) * self.width + x0) * self.samples + plane;
                if self.planar {
                    row[..columns].iter().enumerate().for_each(|(i, v)| out[start + i * self.samples] = code(*v));
                } else {
                    let target = &mut out[start..start + columns * samples];
                    target.iter_mut().zip(&row).for_each(|(o, v)| *o = code(*v));
                }
            }
        }
        Ok(out)
    }

    /// The rows of strip or tile `index`, unpacked.
    fn unpack<'a>(
        &self,
        file: &File<'a>,
        index: usize,
        (rows, row_bytes): (usize, usize),
        tables: &[u8],
        path: &Path,
    ) -> Result<Cow<'a, [u8]>> {
        let (h, v) = self.subsampling;
        let wanted =
            if (h, v) == (1, 1) { rows * row_bytes } else { self.chunk.0.div_ceil(h) * rows.div_ceil(v) * (h * v + 2) };
        let short = || Error::invalid(path, "the TIFF ends before its picture does (truncated or damaged)");
        let start = usize::try_from(self.offsets[index]).map_err(|_| short())?;
        let from = file.bytes.get(start..).filter(|b| !b.is_empty()).ok_or_else(short)?;
        // Without its length a strip runs to the end of the file at most.
        let packed = match self.counts.get(index).copied().unwrap_or(0) {
            0 => from,
            n => from.get(..usize::try_from(n).map_err(|_| short())?).ok_or_else(short)?,
        };
        let packed = if self.reversed && self.compression != JPEG {
            Cow::Owned(packed.iter().map(|b| b.reverse_bits()).collect())
        } else {
            Cow::Borrowed(packed)
        };
        let bytes = match self.compression {
            1 => match packed {
                Cow::Borrowed(b) => Cow::Borrowed(b.get(..wanted).ok_or_else(short)?),
                Cow::Owned(b) => Cow::Owned(b.get(..wanted).ok_or_else(short)?.to_vec()),
            },
            JPEG => Cow::Owned(self.jpeg(&packed, tables, (rows, row_bytes), path)?),
            FAX4 => Cow::Owned(self.fax(file, index, path)?),
            5 => Cow::Owned(lzw(&packed, limits::buffer(path, wanted)?).ok_or_else(short)?),
            8 | 32946 => {
                let mut out = limits::buffer(path, wanted)?;
                flate2::read::ZlibDecoder::new(&*packed).read_exact(&mut out).map_err(|_| short())?;
                Cow::Owned(out)
            }
            32773 => Cow::Owned(pack_bits(&packed, wanted).ok_or_else(short)?),
            other => return Err(Error::unsupported(path, refused(other))),
        };
        if bytes.len() < wanted {
            return Err(short());
        }
        Ok(if (h, v) == (1, 1) { bytes } else { Cow::Owned(self.spread(&bytes, rows)) })
    }

    /// Chroma for every pixel, from data units of h × v luma samples and two of chroma (TIFF 6.0 §21).
    fn spread(&self, units: &[u8], rows: usize) -> Vec<u8> {
        let ((h, v), width) = (self.subsampling, self.chunk.0);
        let across = width.div_ceil(h);
        let mut out = Vec::with_capacity(3 * width * rows);
        for y in 0..rows {
            for x in 0..width {
                let unit = &units[(y / v * across + x / h) * (h * v + 2)..];
                out.extend([unit[y % v * h + x % h], unit[h * v], unit[h * v + 1]]);
            }
        }
        out
    }

    /// A JPEG strip or tile, its tables in front, as it stores its components.
    fn jpeg(&self, data: &[u8], tables: &[u8], (rows, row_bytes): (usize, usize), path: &Path) -> Result<Vec<u8>> {
        let invalid =
            |e: zune_jpeg::errors::DecodeErrors| Error::invalid(path, format!("damaged JPEG in TIFF ({e:?})"));
        let whole = match (tables.len().checked_sub(2), data.get(2..)) {
            (Some(end), Some(rest)) if end > 2 => [&tables[..end], rest].concat(),
            _ => data.to_vec(),
        };
        let options = DecoderOptions::default().set_strict_mode(false).set_max_width(65535).set_max_height(65535);
        let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(&whole), options);
        decoder.decode_headers().map_err(invalid)?;
        let (w, h) = decoder.dimensions().unwrap_or_default();
        let wrong = || Error::invalid(path, "a JPEG strip of another size than its TIFF says (damaged)");
        let space = decoder.input_colorspace().ok_or_else(wrong)?;
        let samples = if self.planar { 1 } else { self.samples };
        if space.num_components() != samples {
            let what = format!("TIFF of {samples} channels in a JPEG of {}; convert it first", space.num_components());
            return Err(Error::unsupported(path, what));
        }
        if w * samples != row_bytes || h < rows || h > rows.max(self.chunk.1) {
            return Err(wrong());
        }
        jpeg_scan::check(&whole, (w, h)).map_err(|fault| Error::invalid(path, fault.to_string()))?;
        decoder.set_options(options.jpeg_set_out_colorspace(space));
        decoder.decode().map_err(invalid)
    }

    /// Group 4 fax, through the tiff library; black is 0 in what it gives.
    fn fax(&self, file: &File<'_>, index: usize, path: &Path) -> Result<Vec<u8>> {
        let failed = |e: tiff::TiffError| Error::invalid(path, format!("damaged or truncated TIFF ({e})"));
        let mut decoder = tiff::decoder::Decoder::new(std::io::Cursor::new(file.bytes)).map_err(failed)?;
        decoder.seek_to_image(self.page).map_err(failed)?;
        match decoder.read_chunk(index as u32).map_err(failed)? {
            tiff::decoder::DecodingResult::U8(v) => Ok(v),
            _ => Err(Error::invalid(path, "fax of more than one bit a pixel (damaged)")),
        }
    }

    /// Takes a row apart into codes.
    fn row(&self, line: &[u8], count: usize, samples: usize, little: bool, out: &mut Vec<u32>) {
        let mut values: Vec<u64> = if self.predictor == 3 {
            float_predictor(line, count, samples, self.bits / 8)
        } else if self.bits.is_multiple_of(8) {
            let add = |n: u64, b: &u8| n << 8 | u64::from(*b);
            let value = |b: &[u8]| if little { b.iter().rev().fold(0, add) } else { b.iter().fold(0, add) };
            line.chunks_exact(self.bits / 8).map(value).collect()
        } else {
            packed(line, count, self.bits)
        };
        if self.predictor == 2 {
            let mask = u64::MAX >> (64 - self.bits);
            for i in samples..values.len() {
                values[i] = values[i].wrapping_add(values[i - samples]) & mask;
            }
        }
        out.clear();
        out.extend(values.into_iter().map(|v| match (self.float, self.bits) {
            (false, ..=16) => v as u32,
            (false, bits) => (v >> (bits - 16)) as u32,
            (true, 16) => half::f16::from_bits(v as u16).to_f32().to_bits(),
            (true, 24) => float24(v as u32).to_bits(),
            (true, 32) => v as u32,
            (true, _) => (f64::from_bits(v) as f32).to_bits(),
        }));
    }
}

fn refused(compression: u64) -> String {
    let name = match compression {
        2 | 3 => "fax (group 3)",
        6 => "JPEG of the old kind",
        34676 | 34677 => "LogLuv",
        34712 => "JPEG 2000",
        34887 => "LERC",
        34925 => "LZMA",
        50000 => "Zstandard",
        50001 => "WebP",
        50002 | 52546 => "JPEG XL",
        _ => return format!("TIFF of compression {compression}; save it with DEFLATE or LZW"),
    };
    format!("TIFF compressed by {name}; save it with DEFLATE or LZW")
}

fn lzw(data: &[u8], mut out: Vec<u8>) -> Option<Vec<u8>> {
    let mut decoder = weezl::decode::Decoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8);
    let (mut read, mut written) = (0, 0);
    while written < out.len() {
        let result = decoder.decode_bytes(&data[read..], &mut out[written..]);
        read += result.consumed_in;
        written += result.consumed_out;
        match result.status {
            Ok(weezl::LzwStatus::Ok) if result.consumed_in + result.consumed_out > 0 => {}
            _ if written == out.len() => {}
            _ => return None,
        }
    }
    Some(out)
}

/// Runs and literals [TIFF 6.0 §9].
fn pack_bits(mut data: &[u8], wanted: usize) -> Option<Vec<u8>> {
    let mut out = Vec::new();
    while out.len() < wanted {
        let (&n, rest) = data.split_first()?;
        match n as i8 {
            -128 => data = rest,
            n @ 0.. => {
                let (literal, rest) = rest.split_at_checked(n as usize + 1)?;
                out.extend_from_slice(literal);
                data = rest;
            }
            n => {
                let (&value, rest) = rest.split_first()?;
                out.resize(out.len() + 1 + usize::from(n.unsigned_abs()), value);
                data = rest;
            }
        }
    }
    Some(out)
}

/// Samples of any number of bits, the highest first, without gaps.
fn packed(line: &[u8], count: usize, bits: usize) -> Vec<u64> {
    let (mut buffer, mut held, mut bytes) = (0u128, 0, line.iter());
    let mut take = || {
        while held < bits {
            buffer = buffer << 8 | u128::from(bytes.next().copied().unwrap_or(0));
            held += 8;
        }
        held -= bits;
        (buffer >> held) as u64 & (u64::MAX >> (64 - bits))
    };
    (0..count).map(|_| take()).collect()
}

/// Bytes of equal weight stand together, highest first, each the difference to the one a pixel before.
fn float_predictor(line: &[u8], count: usize, samples: usize, bytes: usize) -> Vec<u64> {
    let mut sums = line[..count * bytes].to_vec();
    for i in samples..sums.len() {
        sums[i] = sums[i].wrapping_add(sums[i - samples]);
    }
    let value = |i: usize| (0..bytes).fold(0, |v, k| v << 8 | u64::from(sums[k * count + i]));
    (0..count).map(value).collect()
}

/// Adobe's floats of 24 bits: a sign, 7 bits of exponent with bias 63, 16 of mantissa.
fn float24(v: u32) -> f32 {
    let (sign, exponent, mantissa) = (v >> 23 & 1, v >> 16 & 0x7f, v & 0xffff);
    let value = match exponent {
        0 => mantissa as f32 * (-78f32).exp2(),
        127 if mantissa == 0 => f32::INFINITY,
        127 => f32::NAN,
        e => (1.0 + mantissa as f32 / 65536.0) * (e as f32 - 63.0).exp2(),
    };
    if sign == 1 { -value } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packed_bits_are_taken_apart() {
        // 10 bits: 1, 1023, 512; 12 bits: 0xabc, 0xdef; 14 bits: 0x3fff, 1.
        assert_eq!(packed(&[0b0000_0000, 0b0111_1111, 0b1111_1000, 0b0000_0000], 3, 10), [1, 1023, 512]);
        assert_eq!(packed(&[0xab, 0xcd, 0xef], 2, 12), [0xabc, 0xdef]);
        assert_eq!(packed(&[0xff, 0xfc, 0x00, 0x10], 2, 14), [0x3fff, 1]);
    }

    #[test]
    fn floats_of_24_bits() {
        for (code, value) in
            [(0x3f_0000, 1.0), (0x3e_8000, 0.75), (0xc0_0000, -2.0), (0, 0.0), (0x00_0001, (-78f32).exp2())]
        {
            assert_eq!(float24(code), value, "{code:x}");
        }
        assert!(float24(0x7f_0000).is_infinite() && float24(0x7f_0001).is_nan());
    }

    #[test]
    fn runs_and_literals() {
        // The example of TIFF 6.0 §9.
        let packed = [0xfe, 0xaa, 0x02, 0x80, 0x00, 0x2a, 0xfd, 0xaa, 0x03, 0x80, 0x00, 0x2a, 0x22, 0xf7, 0xaa];
        let plain = pack_bits(&packed, 24).unwrap();
        assert_eq!(plain[..10], [0xaa, 0xaa, 0xaa, 0x80, 0x00, 0x2a, 0xaa, 0xaa, 0xaa, 0xaa]);
        assert_eq!((plain.len(), pack_bits(&packed, 25)), (24, None));
    }
}
