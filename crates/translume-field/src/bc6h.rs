//! BC6H blocks (unsigned), as far as fields need them: the four modes with one pair of ends, whose 16 texels lie on one line.
//!
//! BC6H interpolates the bit patterns of half floats, 0 … 0x7bff: evenly spaced in the logarithm of what a graphics processor
//! reads. A field stores planes of values on its own scale, evenly in those patterns: that gives ends of 10 to 16 bits and 16
//! steps. A shader takes the bits of the half float it reads, divided by 31743 (`docs/formats/field.md`).
//!
//! Source: Microsoft, "BC6H format" (Direct3D 11.3 functional specification, §19.5.14). Blocks with two pairs of ends are
//! neither written nor read. Checked against two decoders of others: `tests/decoders.rs`.

/// Bits of the first end, of the second (its difference to the first, if `difference`), and the number in the block.
struct Mode {
    bits: u32,
    second: u32,
    number: u32,
    difference: bool,
}

const MODES: [Mode; 4] = [
    Mode { bits: 10, second: 10, number: 3, difference: false },
    Mode { bits: 11, second: 9, number: 7, difference: true },
    Mode { bits: 12, second: 8, number: 11, difference: true },
    Mode { bits: 16, second: 4, number: 15, difference: true },
];

/// Shares of the second end in sixty-fourths.
const SHARES: [i32; 16] = [0, 4, 9, 13, 17, 21, 26, 30, 34, 38, 43, 47, 51, 55, 60, 64];

/// The largest pattern: that of 65504.
pub(crate) const LAST: u16 = 0x7bff;

type Ends = [[i32; 3]; 2];

impl Mode {
    /// An end in 16 bits, which interpolation runs in.
    fn unquantise(&self, end: i32) -> i32 {
        match end {
            _ if self.bits >= 15 => end,
            0 => 0,
            _ if end == (1 << self.bits) - 1 => 0xffff,
            _ => ((end << 16) + 0x8000) >> self.bits,
        }
    }

    fn quantise(&self, value: f32) -> i32 {
        ((value.clamp(0.0, 65535.0) as i32) >> (16 - self.bits)).min((1 << self.bits) - 1)
    }

    /// Whether the second end is near enough to the first.
    fn holds(&self, ends: &Ends) -> bool {
        let reach = 1 << (self.second - 1);
        !self.difference || (0..3).all(|c| (-reach..reach).contains(&(ends[1][c] - ends[0][c])))
    }

    fn palette(&self, ends: &Ends) -> [[i32; 3]; 16] {
        let [a, b] = ends.map(|e| e.map(|v| self.unquantise(v)));
        SHARES.map(|w| [0, 1, 2].map(|c| (a[c] * (64 - w) + b[c] * w + 32) >> 6))
    }
}

/// The best block found for texels (by channel, in [0, 1]): ends along the axis of most variance, then least squares for the ends
/// given the indices, in each mode.
pub(crate) fn encode(texels: &[[f32; 3]; 16]) -> [u8; 16] {
    let values = texels.map(|t| t.map(|v| 65535.0 * v));
    let start = along_axis(&values);
    let mut best = (f32::INFINITY, [0u8; 16]);
    for mode in &MODES {
        let mut ends = start;
        for _ in 0..3 {
            let quantised = ends.map(|e| e.map(|v| mode.quantise(v)));
            let (indices, error) = nearest(&values, &mode.palette(&quantised));
            if error < best.0
                && let Some(block) = pack(mode, quantised, indices)
            {
                best = (error, block);
            }
            match fit(&values, &indices) {
                Some(better) => ends = better,
                None => break,
            }
        }
    }
    best.1
}

/// Ends of the texels' range along the direction in which they vary most.
fn along_axis(values: &[[f32; 3]; 16]) -> [[f32; 3]; 2] {
    let mean = [0, 1, 2].map(|c| values.iter().map(|v| v[c]).sum::<f32>() / 16.0);
    let centred = values.map(|v| [0, 1, 2].map(|c| v[c] - mean[c]));
    // The texel farthest from the mean is a start that is not at right angles to the axis.
    let square = |v: &[f32; 3]| v.iter().map(|x| x * x).sum::<f32>();
    let mut axis = centred.iter().copied().max_by(|a, b| square(a).total_cmp(&square(b))).unwrap_or_default();
    for _ in 0..8 {
        let length = square(&axis).sqrt();
        if length <= 0.0 {
            return [mean, mean];
        }
        let unit = axis.map(|v| v / length);
        axis = [0.0; 3];
        for v in &centred {
            let along = dot(v, &unit);
            (0..3).for_each(|c| axis[c] += along * v[c]);
        }
    }
    let length = square(&axis).sqrt().max(f32::MIN_POSITIVE);
    let unit = axis.map(|v| v / length);
    let (low, high) = centred.iter().map(|v| dot(v, &unit)).fold((0.0f32, 0.0f32), |(l, h), p| (l.min(p), h.max(p)));
    [low, high].map(|p| [0, 1, 2].map(|c| mean[c] + p * unit[c]))
}

fn dot(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The nearest entries of a palette, and the sum of squared errors.
fn nearest(values: &[[f32; 3]; 16], palette: &[[i32; 3]; 16]) -> ([u8; 16], f32) {
    let mut error = 0.0;
    let palette = palette.map(|p| p.map(|v| v as f32));
    let indices = values.map(|v| {
        let (mut least, mut index) = (f32::INFINITY, 0);
        for (i, p) in palette.iter().enumerate() {
            let e = (0..3).map(|c| (v[c] - p[c]).powi(2)).sum::<f32>();
            if e < least {
                (least, index) = (e, i as u8);
            }
        }
        error += least;
        index
    });
    (indices, error)
}

/// Least squares for both ends, given the indices; `None` where all are the same.
fn fit(values: &[[f32; 3]; 16], indices: &[u8; 16]) -> Option<[[f32; 3]; 2]> {
    let (mut aa, mut ab, mut bb, mut av, mut bv) = (0.0f32, 0.0, 0.0, [0.0f32; 3], [0.0f32; 3]);
    for (v, i) in values.iter().zip(indices) {
        let s = SHARES[usize::from(*i)] as f32 / 64.0;
        let t = 1.0 - s;
        (aa, ab, bb) = (aa + t * t, ab + t * s, bb + s * s);
        for c in 0..3 {
            av[c] += t * v[c];
            bv[c] += s * v[c];
        }
    }
    let d = aa * bb - ab * ab;
    (d > 1e-4)
        .then(|| [[0, 1, 2].map(|c| (bb * av[c] - ab * bv[c]) / d), [0, 1, 2].map(|c| (aa * bv[c] - ab * av[c]) / d)])
}

/// The block; `None` if the mode cannot hold these ends.
fn pack(mode: &Mode, mut ends: Ends, mut indices: [u8; 16]) -> Option<[u8; 16]> {
    // The first index has three bits: its upper one is 0.
    if indices[0] >= 8 {
        ends.swap(0, 1);
        indices = indices.map(|i| 15 - i);
    }
    if !mode.holds(&ends) {
        return None;
    }
    let (mut bits, mut at) = (u128::from(mode.number), 5);
    let mut put = |value: i32, count: u32| {
        bits |= (value as u128 & ((1 << count) - 1)) << at;
        at += count;
    };
    ends[0].iter().for_each(|v| put(*v, 10));
    for c in 0..3 {
        put(if mode.difference { ends[1][c] - ends[0][c] } else { ends[1][c] }, mode.second);
        // What the first end has beyond 10 bits, the upper ones first.
        (10..mode.bits).rev().for_each(|b| put(ends[0][c] >> b, 1));
    }
    put(i32::from(indices[0]), 3);
    indices[1..].iter().for_each(|i| put(i32::from(*i), 4));
    Some(bits.to_le_bytes())
}

/// The patterns of the half floats of a block, by channel; `None` for a block with two pairs of ends.
pub(crate) fn decode(block: &[u8]) -> Option<[[u16; 16]; 3]> {
    let bits = u128::from_le_bytes(block.try_into().ok()?);
    let mode = MODES.iter().find(|m| u128::from(m.number) == bits & 31)?;
    let mut at = 5;
    let mut take = |count: u32| {
        let value = (bits >> at) as i32 & ((1 << count) - 1);
        at += count;
        value
    };
    let mut ends = [[0; 3]; 2];
    ends[0].iter_mut().for_each(|v| *v = take(10));
    for c in 0..3 {
        ends[1][c] = take(mode.second);
        (10..mode.bits).rev().for_each(|b| ends[0][c] |= take(1) << b);
    }
    if mode.difference {
        for c in 0..3 {
            let difference = ends[1][c] << (32 - mode.second) >> (32 - mode.second);
            ends[1][c] = (ends[0][c] + difference) & ((1 << mode.bits) - 1);
        }
    }
    let palette = mode.palette(&ends).map(|p| p.map(|v| ((v * 31) >> 6) as u16));
    let mut out = [[0; 16]; 3];
    for i in 0..16 {
        let index = take(if i == 0 { 3 } else { 4 }) as usize;
        (0..3).for_each(|c| out[c][i] = palette[index][c]);
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(texels: &[[f32; 3]; 16]) -> f32 {
        let decoded = decode(&encode(texels)).unwrap();
        let square = |i: usize, c: usize| (f32::from(decoded[c][i]) / f32::from(LAST) - texels[i][c]).powi(2);
        ((0..48).map(|j| square(j / 3, j % 3)).sum::<f32>() / 48.0).sqrt()
    }

    #[test]
    fn blocks_on_a_line_come_back_nearly_exactly() {
        // Steep, flat and very flat blocks: modes with ends far apart and near each other.
        for (range, most) in [(0.9, 0.02), (0.1, 0.003), (1e-3, 1e-4), (0.0, 4e-5)] {
            let texels = std::array::from_fn(|i| {
                let t = range * ((i * 7 % 16) as f32 / 15.0);
                [0.05 + t, 0.95 - t, 0.5 + 0.3 * t]
            });
            assert!(error(&texels) < most, "{range}: {}", error(&texels));
        }
        assert!(error(&[[0.0; 3]; 16]) == 0.0 && error(&[[1.0; 3]; 16]) < 1e-4);
    }

    #[test]
    fn each_mode_is_used_where_it_is_finest() {
        let block = |range: f32| encode(&std::array::from_fn(|i| [0.3 + range * i as f32 / 15.0; 3]));
        let numbers = [0.6, 0.1, 0.02, 5e-5].map(|range| u32::from(block(range)[0] & 31));
        assert_eq!(numbers, [3, 7, 11, 15]);
    }

    #[test]
    fn any_block_is_read_or_refused() {
        let mut rng = translume_core::rng::Pcg32::new(3, 0);
        let mut read = 0;
        for _ in 0..4096 {
            let block: [u8; 16] = std::array::from_fn(|_| rng.next_u32() as u8);
            if let Some(texels) = decode(&block) {
                read += 1;
                assert!(texels.iter().flatten().all(|v| *v <= LAST));
            }
        }
        // Four of 32 numbers are modes with one pair of ends; 512 ± 21 of 4096.
        assert!((400..620).contains(&read), "{read}");
    }
}
