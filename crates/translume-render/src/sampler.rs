//! The random numbers of one camera sample: an Owen-scrambled Sobol point first, independent numbers after.
//!
//! The first dimensions (film, lens, the first bounces) gain from stratification; deep bounces do not and cost less so.

use glam::Vec2;
use translume_core::rng::Pcg32;
use translume_core::sampler::{Sampler, Sobol};

/// Dimensions taken from the Sobol sequence before independent numbers follow.
const STRATIFIED: u32 = 40;

/// A sampler of one path.
#[derive(Clone, Debug)]
pub struct PathSampler {
    sobol: Sobol,
    rng: Pcg32,
    used: u32,
    key: (u64, u64, u64),
}

impl PathSampler {
    /// Numbers of sample `index` in stream `stream` (a pixel) of `seed`.
    pub fn new(seed: u64, stream: u64, index: u64) -> Self {
        // Samples of one stream differ in the state, streams in the sequence.
        let state = seed ^ index.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let key = (seed, stream, index);
        Self { sobol: Sobol::new(seed, stream, index), rng: Pcg32::new(state, stream), used: 0, key }
    }

    /// Other numbers for the same sample, independent of these: `number` tells branches apart.
    pub fn branch(&self, number: u64) -> Self {
        let (seed, stream, index) = self.key;
        Self::new(seed ^ (number + 1).wrapping_mul(0xd1b5_4a32_d192_ed03), stream, index)
    }
}

impl Sampler for PathSampler {
    #[inline]
    fn next_1d(&mut self) -> f32 {
        self.used += 1;
        if self.used <= STRATIFIED { self.sobol.next_1d() } else { self.rng.next_1d() }
    }

    #[inline]
    fn next_2d(&mut self) -> Vec2 {
        self.used += 2;
        if self.used <= STRATIFIED { self.sobol.next_2d() } else { self.rng.next_2d() }
    }
}
