//! Planes of numbers as textures that a graphics processor reads as they are.
//!
//! A texture holds one or three channels, each mapped from its own range to [0, 1] [Menzel 2012, §4.3], raw or in blocks
//! of 4 × 4. BC4, the codec of the default model, and BC6H are written here; BC1 and BC7 are the `block_compression` crate's.
//! Sizes that are no multiple of four are filled up by repeating the last row and column.

use crate::{Error, Result, bc6h, lines};
use block_compression::{BC7Settings, CompressionVariant, decode, encode};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How a texture is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Codec {
    /// One channel, 8 bits.
    R8,
    /// One channel, 16 bits.
    R16,
    /// Three channels of 8 bits.
    Rgb8,
    /// Three channels, 4 bits a texel: two colours of 5, 6 and 5 bits and two between them (DXT1).
    Bc1,
    /// One channel, 4 bits a texel: two values of 8 bits and six between them.
    Bc4,
    /// Three channels, 8 bits a texel, ends of 10 to 16 bits and 16 steps: values are the patterns of half floats.
    Bc6h,
    /// Three channels, 8 bits a texel.
    Bc7,
}

/// A texture.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// Its storage.
    pub codec: Codec,
    /// Blocks or texels, row by row.
    pub data: Vec<u8>,
    /// What 0 stands for, by channel.
    pub low: [f32; 3],
    /// What 1 stands for, by channel.
    pub high: [f32; 3],
}

impl Codec {
    /// Channels of a texel.
    pub fn channels(self) -> usize {
        match self {
            Self::R8 | Self::R16 | Self::Bc4 => 1,
            Self::Rgb8 | Self::Bc1 | Self::Bc6h | Self::Bc7 => 3,
        }
    }

    /// Bytes of a `width × height` texture.
    pub fn bytes(self, width: usize, height: usize) -> usize {
        let blocks = width.div_ceil(4) * height.div_ceil(4);
        match self {
            Self::R8 => width * height,
            Self::R16 => 2 * width * height,
            Self::Rgb8 => 3 * width * height,
            Self::Bc1 | Self::Bc4 => 8 * blocks,
            Self::Bc6h | Self::Bc7 => 16 * blocks,
        }
    }

    fn library(self) -> CompressionVariant {
        match self {
            Self::Bc1 => CompressionVariant::BC1,
            _ => CompressionVariant::BC7(BC7Settings::opaque_basic()),
        }
    }
}

impl Texture {
    /// Stores planes (one or three, as the codec has channels) of a `width`-wide picture.
    ///
    /// # Errors
    /// [`Error::Parameter`] when the number of planes is not the codec's.
    pub fn encode(codec: Codec, planes: &[&[f32]], width: usize) -> Result<Self> {
        let mut ends = Ends::default();
        ends.see(planes);
        Self::encode_in(codec, planes, width, ends.range(planes.len()), &|_, _| true)
    }

    /// The same in given ranges; of block codecs only the blocks (x, y) that are to be kept: the others are 0.
    pub(crate) fn encode_in(
        codec: Codec,
        planes: &[&[f32]],
        width: usize,
        (low, high): ([f32; 3], [f32; 3]),
        keep: &(dyn Fn(usize, usize) -> bool + Sync),
    ) -> Result<Self> {
        if planes.len() != codec.channels() {
            let what = format!("{} planes for {codec:?}, which has {} channels", planes.len(), codec.channels());
            return Err(Error::Parameter(what));
        }
        let height = planes[0].len() / width;
        // [Menzel 2012, §4.3]
        let unit = |c: usize, i: usize| (planes[c][i] - low[c]) / (high[c] - low[c]);
        let data = match codec {
            Codec::R8 => (0..planes[0].len()).map(|i| byte(unit(0, i))).collect(),
            Codec::R16 => {
                let code = |i: usize| (unit(0, i) * 65535.0 + 0.5) as u16;
                (0..planes[0].len()).flat_map(|i| code(i).to_le_bytes()).collect()
            }
            Codec::Rgb8 => (0..planes[0].len()).flat_map(|i| [0, 1, 2].map(|c| byte(unit(c, i)))).collect(),
            Codec::Bc4 => blocks(8, (width, height), keep, |at, out| {
                let values: [f32; 16] = std::array::from_fn(|i| 255.0 * unit(0, at(i)));
                out.copy_from_slice(&bc4_block(&values));
            }),
            Codec::Bc6h => blocks(16, (width, height), keep, |at, out| {
                let texels = std::array::from_fn(|i| [0, 1, 2].map(|c| unit(c, at(i))));
                out.copy_from_slice(&bc6h::encode(&texels));
            }),
            Codec::Bc1 | Codec::Bc7 => blocks(codec.bytes(4, 4), (width, height), keep, |at, out| {
                let texel = |i| [0, 1, 2, 3].map(|c| if c < 3 { byte(unit(c, at(i))) } else { 255 });
                let texels: Vec<u8> = (0..16).flat_map(texel).collect();
                encode::compress_rgba8(codec.library(), &texels, out, 4, 4, 16);
            }),
        };
        Ok(Self { codec, data, low, high })
    }

    /// The planes of a `width × height` texture in [0, 1], as 16-bit codes.
    ///
    /// # Errors
    /// [`Error::Parameter`] when the data are not of that size, or BC6H blocks have two pairs of ends.
    pub fn decode(&self, width: usize, height: usize) -> Result<Vec<Vec<u16>>> {
        if self.data.len() != self.codec.bytes(width, height) {
            let what = format!("a {width} × {height} texture of {:?} with {} bytes", self.codec, self.data.len());
            return Err(Error::Parameter(what));
        }
        if self.codec == Codec::Bc6h && !self.data.as_chunks::<16>().0.iter().all(|b| bc6h::decode(b).is_some()) {
            return Err(Error::Parameter("a BC6H texture with blocks of two pairs of ends".into()));
        }
        let channels = self.codec.channels();
        if self.codec == Codec::R16 {
            return Ok(vec![self.data.as_chunks::<2>().0.iter().map(|b| u16::from_le_bytes(*b)).collect()]);
        }
        let mut planes = vec![vec![0u16; width * height]; channels];
        if matches!(self.codec, Codec::R8 | Codec::Rgb8) {
            for (c, plane) in planes.iter_mut().enumerate() {
                plane
                    .iter_mut()
                    .zip(self.data.iter().skip(c).step_by(channels))
                    .for_each(|(p, b)| *p = u16::from(*b) * 257);
            }
            return Ok(planes);
        }
        let (size, across) = (self.codec.bytes(4, 4), width.div_ceil(4));
        let mut rows: Vec<Vec<&mut [u16]>> = (0..height.div_ceil(4)).map(|_| Vec::new()).collect();
        for plane in &mut planes {
            plane.chunks_mut(4 * width).zip(&mut rows).for_each(|(p, r)| r.push(p));
        }
        rows.par_iter_mut().zip(self.data.par_chunks(size * across)).for_each(|(row, data)| {
            for (bx, block) in data.chunks(size).enumerate() {
                let texels = self.decode_block(block);
                for (plane, texels) in row.iter_mut().zip(&texels) {
                    for (y, line) in plane.chunks_mut(width).enumerate() {
                        let n = (width - 4 * bx).min(4);
                        line[4 * bx..4 * bx + n].copy_from_slice(&texels[4 * y..4 * y + n]);
                    }
                }
            }
        });
        Ok(planes)
    }

    /// The planes as numbers, in the ranges they were stored with.
    ///
    /// # Errors
    /// As [`Texture::decode`].
    pub fn values(&self, width: usize, height: usize) -> Result<Vec<Vec<f32>>> {
        let planes = self.decode(width, height)?;
        let value = |c: usize, code: u16| self.low[c] + f32::from(code) * ((self.high[c] - self.low[c]) / 65535.0);
        Ok(planes.iter().enumerate().map(|(c, p)| p.iter().map(|code| value(c, *code)).collect()).collect())
    }

    fn decode_block(&self, block: &[u8]) -> [[u16; 16]; 3] {
        let mut out = [[0; 16]; 3];
        // Exactly between the ends, where graphics processors may round.
        if let Some(line) = lines::line(self.codec, block) {
            let last = f32::from(lines::last_code(self.codec));
            for (c, out) in out.iter_mut().enumerate() {
                let (start, step) = (f32::from(line.start[c]), f32::from(line.step[c]) / last);
                out.iter_mut()
                    .zip(line.codes)
                    .for_each(|(o, code)| *o = ((start + step * f32::from(code)) * 257.0 + 0.5) as u16);
            }
            return out;
        }
        match self.codec {
            Codec::Bc4 => out[0] = bc4_texels(block),
            Codec::Bc6h => {
                let last = u32::from(bc6h::LAST);
                let code = |v: u16| ((u32::from(v) * 65535 + last / 2) / last) as u16;
                out = bc6h::decode(block).unwrap_or_default().map(|c| c.map(code));
            }
            _ => {
                let mut texels = [0u8; 64];
                decode::decompress_blocks_as_rgba8(self.codec.library(), 4, 4, block, &mut texels);
                (0..16).for_each(|i| (0..3).for_each(|c| out[c][i] = u16::from(texels[4 * i + c]) * 257));
            }
        }
        out
    }
}

/// The least and the most of each channel.
pub(crate) struct Ends([(f32, f32); 3]);

impl Default for Ends {
    fn default() -> Self {
        Self([EMPTY; 3])
    }
}

impl Ends {
    /// Looks at more values of each channel.
    pub(crate) fn see(&mut self, planes: &[&[f32]]) {
        let range = |a: (f32, f32), b: (f32, f32)| (a.0.min(b.0), a.1.max(b.1));
        for (ends, plane) in self.0.iter_mut().zip(planes) {
            let parts = plane.par_chunks(1 << 14).map(|p| p.iter().map(|v| (*v, *v)).fold(EMPTY, range));
            *ends = range(*ends, parts.reduce(|| EMPTY, range));
        }
    }

    /// What 0 and 1 stand for, of `channels` that were seen.
    pub(crate) fn range(&self, channels: usize) -> ([f32; 3], [f32; 3]) {
        let end = |c: usize| {
            let (low, high) = self.0[if c < channels { c } else { 0 }];
            if high > low { (low, high) } else { (low, low + 1.0) }
        };
        let ends = [0, 1, 2].map(end);
        (ends.map(|e| e.0), ends.map(|e| e.1))
    }
}

const EMPTY: (f32, f32) = (f32::INFINITY, f32::NEG_INFINITY);

fn byte(unit: f32) -> u8 {
    (unit * 255.0 + 0.5) as u8
}

/// All blocks of `size` bytes of a picture; `fill` gets the index of a block's texel `i` and the place for the block.
fn blocks(
    size: usize,
    (w, h): (usize, usize),
    keep: &(dyn Fn(usize, usize) -> bool + Sync),
    fill: impl Fn(&dyn Fn(usize) -> usize, &mut [u8]) + Sync,
) -> Vec<u8> {
    let across = w.div_ceil(4);
    let mut data = vec![0; size * across * h.div_ceil(4)];
    data.par_chunks_mut(size * across).enumerate().for_each(|(by, row)| {
        for (bx, out) in row.chunks_mut(size).enumerate() {
            let at = |i: usize| (4 * by + i / 4).min(h - 1) * w + (4 * bx + i % 4).min(w - 1);
            if keep(bx, by) {
                fill(&at, out);
            }
        }
    });
    data
}

/// The 16-bit values of a BC4 block: two bytes a > b, then 3 bits a texel; where a ≤ b, four values between them and
/// the ends of the scale.
fn bc4_texels(block: &[u8]) -> [u16; 16] {
    let palette = bc4_palette(block[0], block[1]);
    let bits = block[2..8].iter().rev().fold(0u64, |bits, b| bits << 8 | u64::from(*b));
    std::array::from_fn(|i| (palette[(bits >> (3 * i) & 7) as usize] * 257.0 + 0.5) as u16)
}

fn bc4_palette(a: u8, b: u8) -> [f32; 8] {
    let (x, y) = (f32::from(a), f32::from(b));
    let steps = if a > b { 7 } else { 5 };
    let mut palette = [x, y, 0.0, 0.0, 0.0, 0.0, 0.0, 255.0];
    for i in 1..steps {
        palette[i + 1] = (x * (steps - i) as f32 + y * i as f32) / steps as f32;
    }
    palette
}

/// The best BC4 block found for values in 0 … 255: from the ends of their range, then least squares for the ends given
/// the indices, twice, then a step of each end.
fn bc4_block(values: &[f32; 16]) -> [u8; 8] {
    let (low, high) = values.iter().fold(EMPTY, |(l, h), v| (l.min(*v), h.max(*v)));
    let ends = |low: f32, high: f32| {
        let (b, a) = (low.clamp(0.0, 255.0).round() as u8, high.clamp(0.0, 255.0).round() as u8);
        // Equal ends would mean the other palette.
        if a > b { (a, b) } else { (b.max(1), b.max(1) - 1) }
    };
    let mut best = (f32::INFINITY, (1, 0), [0u8; 16]);
    let mut attempt = |(a, b): (u8, u8)| {
        let (indices, error) = bc4_indices(values, a, b);
        if error < best.0 {
            best = (error, (a, b), indices);
        }
        (best.1, best.2)
    };
    let (_, mut indices) = attempt(ends(low, high));
    for _ in 0..2 {
        if let Some((low, high)) = bc4_fit(values, &indices) {
            indices = attempt(ends(low, high)).1;
        }
    }
    let (a, b) = attempt(ends(low, high)).0;
    for (da, db) in [(1i16, 0i16), (-1, 0), (0, 1), (0, -1), (-1, 1), (1, -1)] {
        let (a, b) = (i16::from(a) + da, i16::from(b) + db);
        if a > b && b >= 0 && a < 256 {
            attempt((a as u8, b as u8));
        }
    }
    let (_, (a, b), indices) = best;
    let bits = indices.iter().rev().fold(0u64, |bits, i| bits << 3 | u64::from(*i));
    let mut block = [a, b, 0, 0, 0, 0, 0, 0];
    block[2..].copy_from_slice(&bits.to_le_bytes()[..6]);
    block
}

/// Nearest palette entries for ends a > b, and the sum of squared errors.
fn bc4_indices(values: &[f32; 16], a: u8, b: u8) -> ([u8; 16], f32) {
    let (x, y) = (f32::from(a), f32::from(b));
    let (scale, step) = (7.0 / (x - y), (x - y) / 7.0);
    let mut error = 0.0;
    let indices = values.map(|v| {
        // Steps down from a: 0 is a itself (index 0), 7 is b (index 1), the others follow in order.
        let s = ((x - v) * scale + 0.5).clamp(0.0, 7.0) as u8;
        error += (x - f32::from(s) * step - v).powi(2);
        match s {
            0 => 0,
            7 => 1,
            s => s + 1,
        }
    });
    (indices, error)
}

/// Least squares for the lower and the upper end, given which palette entry each value takes.
fn bc4_fit(values: &[f32; 16], indices: &[u8; 16]) -> Option<(f32, f32)> {
    let (mut aa, mut ab, mut bb, mut av, mut bv) = (0.0f32, 0.0, 0.0, 0.0, 0.0);
    for (v, i) in values.iter().zip(indices) {
        let s = match i {
            0 => 0.0,
            1 => 1.0,
            i => f32::from(i - 1) / 7.0,
        };
        let t = 1.0 - s;
        (aa, ab, bb) = (aa + t * t, ab + t * s, bb + s * s);
        (av, bv) = (av + t * v, bv + s * v);
    }
    let d = aa * bb - ab * ab;
    (d > 1e-4).then(|| ((aa * bv - ab * av) / d, (bb * av - ab * bv) / d))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(w: usize, h: usize, shift: f32) -> Vec<f32> {
        (0..w * h).map(|i| ((i % w) as f32 * 0.11 + shift).sin() * 3.0 + (i / w) as f32 * 0.05 - 1.0).collect()
    }

    fn rms(codec: Codec, (w, h): (usize, usize)) -> f32 {
        let planes: Vec<Vec<f32>> = (0..codec.channels()).map(|c| picture(w, h, c as f32)).collect();
        let planes: Vec<&[f32]> = planes.iter().map(|p| &p[..]).collect();
        let texture = Texture::encode(codec, &planes, w).unwrap();
        assert_eq!(texture.data.len(), codec.bytes(w, h));
        let decoded = texture.decode(w, h).unwrap();
        let mut sum = 0.0;
        for (c, plane) in decoded.iter().enumerate() {
            for (code, v) in plane.iter().zip(planes[c]) {
                let unit = f32::from(*code) / 65535.0;
                sum += (texture.low[c] + unit * (texture.high[c] - texture.low[c]) - v).powi(2);
            }
        }
        (sum / (w * h * codec.channels()) as f32).sqrt()
    }

    #[test]
    fn each_codec_gives_back_what_it_can_hold() {
        // The range is about 8; an 8-bit step of it is 0.03, a uniform error in a step has an RMS of 0.29 steps.
        for (codec, most) in [
            (Codec::R8, 0.011),
            (Codec::R16, 1e-4),
            (Codec::Rgb8, 0.011),
            (Codec::Bc4, 0.05),
            (Codec::Bc1, 0.4),
            (Codec::Bc6h, 0.25),
            (Codec::Bc7, 0.2),
        ] {
            for size in [(32, 16), (33, 18), (3, 1)] {
                let got = rms(codec, size);
                assert!(got < most, "{codec:?} {size:?}: {got}");
            }
        }
    }

    #[test]
    fn a_bc4_block_by_hand() {
        // Ends 240 and 100, then indices 0 … 7 twice, three bits each from the lowest.
        let bits: u64 = (0..16).map(|i| (i % 8) << (3 * i)).sum();
        let mut block = vec![240u8, 100];
        block.extend(&bits.to_le_bytes()[..6]);
        let expected = [240, 100, 220, 200, 180, 160, 140, 120].map(|v| v * 257);
        assert_eq!(bc4_texels(&block)[..8], expected);
        assert_eq!(bc4_texels(&block)[8..], expected);
        // Ends in rising order: four between them, then 0 and 255.
        block[..2].copy_from_slice(&[100, 200]);
        let expected = [100, 200, 120, 140, 160, 180, 0, 255].map(|v| v * 257);
        assert_eq!(bc4_texels(&block)[..8], expected);
        let values = std::array::from_fn(|i| 100.0 + 20.0 * (i % 8) as f32);
        assert!(bc4_texels(&bc4_block(&values)).iter().zip(values).all(|(c, v)| f32::from(*c) == 257.0 * v));
    }

    #[test]
    fn data_of_another_size_are_refused() {
        let texture = Texture::encode(Codec::Bc4, &[&picture(8, 8, 0.0)], 8).unwrap();
        assert!(texture.decode(8, 12).is_err());
        assert!(Texture::encode(Codec::Bc1, &[&picture(8, 8, 0.0)], 8).is_err());
    }
}
