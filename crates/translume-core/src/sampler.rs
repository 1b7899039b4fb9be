//! Where integrators take their random numbers from: independent ones or an Owen-scrambled Sobol sequence.
//!
//! Source of the latter: Burley 2020, "Practical Hash-based Owen Scrambling"; the crate `sobol_burley` gives 64 sets of
//! four dimensions and 2¹⁶ points. Deviations: dimensions beyond 256 and points beyond 2¹⁶ are padded with further
//! scrambles, independent of the first. The numbers are those of the crate's `sample_4d`; for the first sets its loop over
//! the bits of the index is replaced by tables by the bytes of the index, since the sequence is linear in them.

use crate::rng::Pcg32;
use glam::Vec2;
use sobol_burley::parts::{Int4, hash, hash_int4, owen_scramble_int4_rev, owen_scramble_rev, sobol_int4_rev};
use std::sync::LazyLock;

/// A source of uniform numbers in [0, 1).
pub trait Sampler {
    /// One number.
    fn next_1d(&mut self) -> f32;
    /// Two numbers, well distributed jointly.
    fn next_2d(&mut self) -> Vec2;
}

impl Sampler for Pcg32 {
    #[inline]
    fn next_1d(&mut self) -> f32 {
        self.next_f32()
    }

    #[inline]
    fn next_2d(&mut self) -> Vec2 {
        Vec2::new(self.next_f32(), self.next_f32())
    }
}

/// Sets of dimensions that have tables, 8 KiB each.
const TABULATED: u32 = 16;

/// Per set, the unscrambled point of each high byte of a reversed 16-bit index, then of each low byte.
static TABLES: LazyLock<Vec<[Int4; 512]>> = LazyLock::new(|| {
    let table = |set| std::array::from_fn(|i| sobol_int4_rev((i as u32 & 0xff) << if i < 256 { 24 } else { 16 }, set));
    (0..TABULATED).map(table).collect()
});

/// The coordinates of one point of an Owen-scrambled Sobol sequence, handed out in order of dimension.
#[derive(Clone, Debug)]
pub struct Sobol {
    index: u32,
    /// The index reversed and shuffled by the seed.
    shuffled: u32,
    seed: u32,
    set: u32,
    used: usize,
    buffer: [f32; 4],
}

impl Sobol {
    /// Point number `index` of the sequence of (`seed`, `stream`); different streams (pixels, light passes) are scrambled
    /// independently.
    pub fn new(seed: u64, stream: u64, index: u64) -> Self {
        let block = index >> 16;
        let key = mix(mix(seed).wrapping_add(stream)).wrapping_add(block);
        let (index, seed) = ((index & 0xffff) as u32, (mix(key) >> 32) as u32);
        let shuffled = owen_scramble_rev(index.reverse_bits(), hash(seed ^ 0x79c6_8e4a));
        Self { index, shuffled, seed, set: 0, used: 4, buffer: [0.0; 4] }
    }

    #[inline]
    fn refill(&mut self) {
        self.buffer = match self.set < TABULATED {
            true => self.tabulated(&TABLES[self.set as usize]),
            false => self.padded(),
        };
        self.set += 1;
        self.used = 0;
    }

    /// The crate's `sample_4d`.
    #[inline]
    fn tabulated(&self, table: &[Int4; 512]) -> [f32; 4] {
        let (high, low) = (self.shuffled >> 24, self.shuffled >> 16 & 0xff);
        let point = table[high as usize] ^ table[256 + low as usize];
        let seed: Int4 = [self.seed.wrapping_mul(0x9c8f_2d3b) ^ self.set; 4].into();
        let scramble = hash_int4(seed ^ [0x912f_69ba, 0x174f_18ab, 0x691e_72ca, 0xb40c_c1b8].into());
        owen_scramble_int4_rev(point, scramble).reverse_bits().to_f32_norm()
    }

    #[cold]
    fn padded(&self) -> [f32; 4] {
        let pad = self.set / sobol_burley::NUM_DIMENSION_SETS_4D;
        let set = self.set % sobol_burley::NUM_DIMENSION_SETS_4D;
        sobol_burley::sample_4d(self.index, set, self.seed.wrapping_add(pad.wrapping_mul(0x9e37_79b9)))
    }
}

impl Sampler for Sobol {
    #[inline]
    fn next_1d(&mut self) -> f32 {
        if self.used >= 4 {
            self.refill();
        }
        let x = self.buffer[self.used];
        self.used += 1;
        x
    }

    #[inline]
    fn next_2d(&mut self) -> Vec2 {
        // A pair never straddles two sets: only dimensions of one set are stratified together.
        if self.used >= 3 {
            self.refill();
        }
        let p = Vec2::new(self.buffer[self.used], self.buffer[self.used + 1]);
        self.used += 2;
        p
    }
}

/// SplitMix64's finaliser.
fn mix(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_are_stratified_in_every_elementary_interval() {
        for stream in 0..4 {
            for split in 0..=6u32 {
                let (a, b) = (1usize << split, 64usize >> split);
                let mut seen = vec![0; 64];
                for i in 0..64 {
                    let p = Sobol::new(7, stream, i).next_2d();
                    seen[(p.x * a as f32) as usize * b + (p.y * b as f32) as usize] += 1;
                }
                assert!(seen.iter().all(|&c| c == 1), "stream {stream} split {split}");
            }
        }
    }

    #[test]
    fn tables_give_the_numbers_of_the_crate() {
        for index in [0, 1, 2, 3, 255, 256, 4711, 65535] {
            let mut sobol = Sobol::new(3, 1, index);
            for set in 0..TABULATED + 2 {
                let mine: [f32; 4] = std::array::from_fn(|_| sobol.next_1d());
                assert_eq!(mine, sobol_burley::sample_4d(index as u32, set, sobol.seed), "{index} {set}");
            }
        }
    }

    #[test]
    fn streams_blocks_and_far_dimensions_differ() {
        let head = |mut s: Sobol| -> Vec<f32> { (0..8).map(|_| s.next_1d()).collect() };
        let a = head(Sobol::new(1, 0, 5));
        assert_eq!(a, head(Sobol::new(1, 0, 5)));
        assert_ne!(a, head(Sobol::new(1, 1, 5)));
        assert_ne!(a, head(Sobol::new(2, 0, 5)));
        assert_ne!(a, head(Sobol::new(1, 0, 5 + (1 << 16))));
        let mut s = Sobol::new(1, 0, 5);
        let all: Vec<f32> = (0..1024).map(|_| s.next_1d()).collect();
        assert_ne!(all[..4], all[256..260]);
        assert!(all.iter().all(|x| (0.0..1.0).contains(x)));
    }

    #[test]
    fn integrates_a_smooth_function_faster_than_independent_numbers() {
        // ∫ x y over the square = 1/4, RMS error over 64 scrambles of 256 points.
        let rms = |f: &mut dyn FnMut(u64) -> f64| -> f64 {
            ((0..64).map(|s| (f(s) - 0.25).powi(2)).sum::<f64>() / 64.0).sqrt()
        };
        let product = |p: Vec2| f64::from(p.x * p.y);
        let sobol = rms(&mut |s| (0..256).map(|i| product(Sobol::new(9, s, i).next_2d())).sum::<f64>() / 256.0);
        let random = rms(&mut |s| {
            let mut rng = Pcg32::new(9, s);
            (0..256).map(|_| product(rng.next_2d())).sum::<f64>() / 256.0
        });
        assert!(sobol < random / 10.0, "{sobol} {random}");
    }
}
