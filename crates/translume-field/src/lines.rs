//! Blocks as lines: what makes relighting quick.
//!
//! The values of a BC4 block lie evenly on one line between two ends, and so do the colours of a BC1 block. What a block
//! adds to a channel of the picture is therefore A + B·code: A and B are the same for its 16 texels, and each texel costs
//! one byte of memory and one multiply-add a channel, whether the block holds one plane or three. Blocks that use the extra
//! values of the other modes (0 and 255 in BC4, black in BC1) lie on no line: such fields are lit from decoded planes.

use crate::texture::{Codec, Texture};
use crate::tiles::{self, Tiles};

/// Blocks of a group, one beside the other.
pub(crate) const GROUP: usize = 8;
/// Texels of a group: four rows of 32.
pub(crate) const TEXELS: usize = 16 * GROUP;

/// A block on a line: by channel the value of code 0 and what the last code adds, both in steps of 1/255; and a code a texel,
/// of which [`last_code`] is the last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BlockLine {
    pub(crate) start: [u8; 3],
    pub(crate) step: [i16; 3],
    pub(crate) codes: [u8; 16],
}

/// The code at the far end of the line: a number that all palettes divide.
pub(crate) fn last_code(codec: Codec) -> u8 {
    if codec == Codec::Bc4 { 35 } else { 6 }
}

/// The line of a block of BC4 or BC1; `None` if it lies on none.
pub(crate) fn line(codec: Codec, block: &[u8]) -> Option<BlockLine> {
    match codec {
        Codec::Bc4 => bc4_line(block),
        Codec::Bc1 => bc1_line(block),
        _ => None,
    }
}

fn bc4_line(block: &[u8]) -> Option<BlockLine> {
    let (a, b) = (block[0], block[1]);
    let bits = block[2..8].iter().rev().fold(0u64, |bits, b| bits << 8 | u64::from(*b));
    // Eight values from a down to b; or six from a up to b, then 0 and 255.
    let (first, most) = if a > b { (5, 7) } else { (7, 5) };
    let mut codes = [0; 16];
    for (i, code) in codes.iter_mut().enumerate() {
        *code = match (bits >> (3 * i) & 7) as u8 {
            0 => 0,
            1 => 35,
            n if n - 1 < most => (n - 1) * first,
            _ => return None,
        };
    }
    Some(BlockLine { start: [a, 0, 0], step: [i16::from(b) - i16::from(a), 0, 0], codes })
}

fn bc1_line(block: &[u8]) -> Option<BlockLine> {
    let (a, b) = (u16::from_le_bytes([block[0], block[1]]), u16::from_le_bytes([block[2], block[3]]));
    // Four colours; or three, and black.
    let palette = if a > b { [Some(0), Some(6), Some(2), Some(4)] } else { [Some(0), Some(6), Some(3), None] };
    let mut codes = [0; 16];
    for (i, code) in codes.iter_mut().enumerate() {
        *code = palette[(block[4 + i / 4] >> (2 * (i % 4)) & 3) as usize]?;
    }
    let (start, end) = (rgb8(a), rgb8(b));
    Some(BlockLine { start, step: [0, 1, 2].map(|c| i16::from(end[c]) - i16::from(start[c])), codes })
}

/// 5, 6 and 5 bits as 8 bits each, the upper bits repeated below.
fn rgb8(v: u16) -> [u8; 3] {
    let (r, g, b) = ((v >> 11) as u8, (v >> 5 & 63) as u8, (v & 31) as u8);
    [r << 3 | r >> 2, g << 2 | g >> 4, b << 3 | b >> 2]
}

/// The blocks of one layer in a group. Channels that the codec has not are 0.
#[derive(Clone)]
struct Packed {
    start: [[u8; GROUP]; 3],
    step: [[i16; GROUP]; 3],
    codes: [[u8; 16]; GROUP],
}

/// All layers of a field, group by group as they are read.
pub(crate) struct Lines {
    /// Groups side by side.
    across: usize,
    /// Layers of each group, one group after the other.
    blocks: Vec<Packed>,
    /// Where each group begins in `blocks`, and the end of the last.
    starts: Vec<u32>,
}

/// What a layer's channels are multiplied with: by its channel, then by that of the picture, for values in steps of 1/255; and
/// the same for steps of the line, a code.
#[derive(Clone, Copy)]
pub(crate) struct Factors {
    /// How many of its channels the layer has.
    pub(crate) channels: usize,
    pub(crate) start: [[f32; 3]; 3],
    pub(crate) step: [[f32; 3]; 3],
}

impl std::fmt::Debug for Lines {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Lines({} layers of {} groups)", self.blocks.len(), self.starts.len() - 1)
    }
}

impl Lines {
    /// `None` where a block of a layer lies on no line, or textures and tiles are of another size.
    pub(crate) fn new(layers: &[Texture], tiles: Option<&Tiles>, width: usize, height: usize) -> Option<Self> {
        let (columns, rows) = (width.div_ceil(4), height.div_ceil(4));
        let across = columns.div_ceil(GROUP);
        // A group is as wide as a tile.
        const { assert!(4 * GROUP == tiles::SIDE) };
        let grid = Tiles::grid(width, height);
        let fits = |l: &Texture| matches!(l.codec, Codec::Bc1 | Codec::Bc4) && l.data.len() == 8 * columns * rows;
        let tiled = |t: &Tiles| t.across == grid.0 && t.counts.len() == grid.0 * grid.1 && t.most() <= layers.len();
        if !layers.iter().all(fits) || !tiles.is_none_or(tiled) {
            return None;
        }
        let (mut starts, mut blocks) = (vec![0], Vec::new());
        for (x, y) in (0..across * rows).map(|i| (i % across, i / across)) {
            let count = tiles.map_or(layers.len(), |t| t.layers_at(x * GROUP, y));
            for layer in &layers[..count] {
                let mut packed = Packed { start: [[0; GROUP]; 3], step: [[0; GROUP]; 3], codes: [[0; 16]; GROUP] };
                for i in 0..GROUP.min(columns - x * GROUP) {
                    let at = 8 * (y * columns + x * GROUP + i);
                    let line = line(layer.codec, &layer.data[at..at + 8])?;
                    for c in 0..3 {
                        packed.start[c][i] = line.start[c];
                        packed.step[c][i] = line.step[c];
                    }
                    packed.codes[i] = line.codes;
                }
                blocks.push(packed);
            }
            starts.push(u32::try_from(blocks.len()).ok()?);
        }
        Some(Self { across, blocks, starts })
    }

    /// Groups side by side in a row of blocks.
    pub(crate) fn across(&self) -> usize {
        self.across
    }

    fn group(&self, (x, y): (usize, usize)) -> &[Packed] {
        let at = y * self.across + x;
        &self.blocks[self.starts[at] as usize..self.starts[at + 1] as usize]
    }

    /// The sums over all layers for group `x` of the row of blocks `y`: by channel, then row, then column of the group. `constants` are by
    /// number of layers; `steps` has room for a layer each.
    pub(crate) fn sums(
        &self,
        at: (usize, usize),
        constants: &[[f32; 3]],
        factors: &[Factors],
        steps: &mut Steps,
        out: &mut Tile,
    ) {
        let layers = self.group(at);
        let mut starts = constants[layers.len()].map(|c| [c; GROUP]);
        for ((layer, f), steps) in layers.iter().zip(factors).zip(steps.iter_mut()) {
            *steps = [[0.0; GROUP]; 3];
            for (k, c) in (0..f.channels).flat_map(|k| [(k, 0), (k, 1), (k, 2)]) {
                for i in 0..GROUP {
                    starts[c][i] += f.start[k][c] * f32::from(layer.start[k][i]);
                    steps[c][i] += f.step[k][c] * f32::from(layer.step[k][i]);
                }
            }
        }
        for b in 0..GROUP {
            for c in 0..3 {
                let mut sums = [starts[c][b]; 16];
                for (layer, step) in layers.iter().zip(steps.iter()) {
                    sums.iter_mut().zip(layer.codes[b]).for_each(|(s, code)| *s += step[c][b] * f32::from(code));
                }
                for (row, four) in sums.as_chunks::<4>().0.iter().enumerate() {
                    out[c][4 * GROUP * row + 4 * b..][..4].copy_from_slice(four);
                }
            }
        }
    }

    /// The same in vectors of eight, sums in registers.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    pub(crate) fn sums_avx2(
        &self,
        at: (usize, usize),
        constants: &[[f32; 3]],
        factors: &[Factors],
        steps: &mut Steps,
        out: &mut Tile,
    ) {
        use std::arch::x86_64::*;
        let layers = self.group(at);
        let mut starts = constants[layers.len()].map(|c| _mm256_set1_ps(c));
        for ((layer, f), steps) in layers.iter().zip(factors).zip(steps.iter_mut()) {
            let mut sums = [_mm256_setzero_ps(); 3];
            for k in 0..f.channels {
                let start =
                    _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_set_epi64x(0, i64::from_le_bytes(layer.start[k]))));
                let step = _mm256_cvtepi32_ps(_mm256_cvtepi16_epi32(vector(&layer.step[k])));
                for c in 0..3 {
                    starts[c] = _mm256_fmadd_ps(_mm256_set1_ps(f.start[k][c]), start, starts[c]);
                    sums[c] = _mm256_fmadd_ps(_mm256_set1_ps(f.step[k][c]), step, sums[c]);
                }
            }
            *steps = sums.map(lanes);
        }
        let starts = starts.map(lanes);
        for b in 0..GROUP {
            let mut upper = [0, 1, 2].map(|c| _mm256_set1_ps(starts[c][b]));
            let mut lower = upper;
            for (layer, step) in layers.iter().zip(steps.iter()) {
                let codes = vector(&layer.codes[b]);
                let first = _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(codes));
                let last = _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_unpackhi_epi64(codes, codes)));
                for c in 0..3 {
                    let step = _mm256_set1_ps(step[c][b]);
                    upper[c] = _mm256_fmadd_ps(step, first, upper[c]);
                    lower[c] = _mm256_fmadd_ps(step, last, lower[c]);
                }
            }
            for c in 0..3 {
                for (half, rows) in [lanes(upper[c]), lanes(lower[c])].iter().zip([0, 2]) {
                    for (row, four) in half.as_chunks::<4>().0.iter().enumerate() {
                        out[c][4 * GROUP * (rows + row) + 4 * b..][..4].copy_from_slice(four);
                    }
                }
            }
        }
    }
}

/// Steps by layer, channel and block.
pub(crate) type Steps = [[[f32; GROUP]; 3]];
/// Sums by channel, row and column of a group.
pub(crate) type Tile = [[f32; TEXELS]; 3];

#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn lanes(v: std::arch::x86_64::__m256) -> [f32; 8] {
    #[allow(unsafe_code, reason = "a vector as the array that it is")]
    // SAFETY: both are eight floats, and any bits are floats.
    unsafe {
        std::mem::transmute(v)
    }
}

/// 16 bytes as a vector.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn vector<T: Copy, const N: usize>(values: &[T; N]) -> std::arch::x86_64::__m128i {
    const { assert!(size_of::<T>() * N == 16) };
    #[allow(unsafe_code, reason = "one load instead of sixteen")]
    // SAFETY: 16 bytes of integers are read from an array of that size; the type asks for no alignment of the source.
    unsafe {
        std::ptr::from_ref(values).cast::<std::arch::x86_64::__m128i>().read_unaligned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bc1_block_by_hand() {
        // Red 31 and blue 31, codes 0 1 2 3 in the first row, then one colour a row.
        let block = [0x00, 0xf8, 0x1f, 0x00, 0b11_10_01_00, 0, 0b01_01_01_01, 0b11_11_11_11];
        let found = line(Codec::Bc1, &block).unwrap();
        assert_eq!((found.start, found.step), ([255, 0, 0], [-255, 0, 255]));
        assert_eq!(found.codes, [0, 6, 2, 4, 0, 0, 0, 0, 6, 6, 6, 6, 4, 4, 4, 4]);
        // Ends the other way round: three colours, and black, which lies on no line.
        let mut block = [0x1f, 0x00, 0x00, 0xf8, 0b10_10_01_00, 0, 0, 0];
        assert_eq!(line(Codec::Bc1, &block).unwrap().codes[..4], [0, 6, 3, 3]);
        block[7] = 0b11;
        assert_eq!(line(Codec::Bc1, &block), None);
        assert_eq!(rgb8(0x8401), [0b1000_0100, 0b1000_0010, 0b0000_1000]);
    }

    #[test]
    fn a_bc4_block_by_hand() {
        let bits = |index: &[u64; 16]| index.iter().enumerate().map(|(i, v)| v << (3 * i)).sum::<u64>().to_le_bytes();
        let block = |a: u8, b: u8, index: &[u64; 16]| [&[a, b], &bits(index)[..6]].concat();
        let found = line(Codec::Bc4, &block(200, 60, &[0, 1, 2, 3, 4, 5, 6, 7, 0, 0, 0, 0, 0, 0, 0, 0])).unwrap();
        assert_eq!(
            ((found.start[0], found.step[0]), &found.codes[..8]),
            ((200, -140), &[0, 35, 5, 10, 15, 20, 25, 30][..])
        );
        let found = line(Codec::Bc4, &block(60, 200, &[0, 1, 2, 5, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0])).unwrap();
        assert_eq!(((found.start[0], found.step[0]), &found.codes[..4]), ((60, 140), &[0, 35, 7, 28][..]));
        assert_eq!(line(Codec::Bc4, &block(60, 200, &[6; 16])), None);
    }
}
