//! Counts per part of a method (a strategy of bidirectional path tracing, say), for `--json`.

use crate::splat::{fixed, float};
use crate::{Rgb, luminance};

/// What one part did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Count {
    /// Times that it was tried.
    pub tried: u64,
    /// Times that it contributed.
    pub contributed: u64,
    /// Sum of the contributions' luminances, in fixed point: the order does not matter.
    sum: i128,
}

impl Count {
    /// Sum of the luminances of all contributions.
    pub fn sum(&self) -> f64 {
        float(self.sum, 0)
    }
}

/// Counts by number of the part.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tally {
    counts: Vec<Count>,
}

impl Tally {
    /// Counts one try of `part` and what it contributed.
    #[inline]
    pub fn add(&mut self, part: usize, value: Rgb) {
        if part >= self.counts.len() {
            self.counts.resize(part + 1, Count::default());
        }
        let count = &mut self.counts[part];
        count.tried += 1;
        let value = luminance(value);
        if value != 0.0 && value.is_finite() {
            count.contributed += 1;
            count.sum = count.sum.saturating_add(fixed(value.into(), 0));
        }
    }

    /// Adds the counts of `other`.
    pub(crate) fn add_all(&mut self, other: &Self) {
        self.counts.resize(self.counts.len().max(other.counts.len()), Count::default());
        for (a, b) in self.counts.iter_mut().zip(&other.counts) {
            a.tried += b.tried;
            a.contributed += b.contributed;
            a.sum = a.sum.saturating_add(b.sum);
        }
    }

    /// The parts that were tried, with their numbers.
    pub fn parts(&self) -> impl Iterator<Item = (usize, &Count)> {
        self.counts.iter().enumerate().filter(|(_, c)| c.tried > 0)
    }
}
