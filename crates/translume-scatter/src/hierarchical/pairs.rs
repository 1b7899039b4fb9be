//! Pairs of vertices: what is measured between them, and the matrix F that comes of it.
//!
//! F holds R_d in mm⁻² without the areas of vertices, so it is symmetric and only one half is stored: pair (a, b) with a ≥ b is
//! number a (a + 1)/2 + b. Measurements of (a, b) and (b, a) meet in one place, with their weights; so the symmetric mean of the
//! errata, F_rk = (c_rk F_rk + c_kr F_kr)/(c_rk + c_kr), is made by adding.

use half::f16;

/// Number of the pair of two vertices.
#[inline]
pub(super) fn pair(a: usize, b: usize) -> usize {
    let (a, b) = if a >= b { (a, b) } else { (b, a) };
    a * (a + 1) / 2 + b
}

/// Number of pairs of `n` vertices.
pub(super) fn pairs(n: usize) -> usize {
    n * (n + 1) / 2
}

/// Weighted sums of what was measured between vertices.
pub struct Measured {
    /// Number of vertices.
    pub vertices: usize,
    /// Sum of w R_d in red, green and blue, and of w.
    pub(super) sums: Vec<[f32; 4]>,
    /// Weight of the light that hit each vertex.
    pub(super) lit: Vec<f32>,
}

impl Measured {
    /// Nothing yet.
    pub fn new(vertices: usize) -> Self {
        Self { vertices, sums: vec![[0.0; 4]; pairs(vertices)], lit: vec![0.0; vertices] }
    }

    /// Adds a measurement of R_d (red, green, blue) for light on vertex `lit` that leaves at vertex `seen`.
    #[inline]
    pub fn add(&mut self, lit: usize, seen: usize, rgb: [f32; 3], weight: f32) {
        let sum = &mut self.sums[pair(lit, seen)];
        (0..3).for_each(|c| sum[c] += weight * rgb[c]);
        sum[3] += weight;
    }

    /// Counts light on a vertex.
    pub fn light(&mut self, vertex: usize, weight: f32) {
        self.lit[vertex] += weight;
    }

    /// Adds `f` itself to what was measured, with little weight: so no mean is 0.
    pub(super) fn draw_to(&mut self, f: &Throughput, weight: f32) {
        for (sum, ln) in self.sums.iter_mut().zip(&f.ln).filter(|s| s.0[3] > 0.0) {
            (0..3).for_each(|c| sum[c] = (sum[c] + weight * ln[c].to_f32().exp()) * sum[3] / (sum[3] + weight));
        }
    }

    /// Takes back what was measured between two vertices: its mean, if there was any.
    pub fn withdraw(&mut self, a: usize, b: usize) -> Option<[f32; 3]> {
        let sum = std::mem::replace(&mut self.sums[pair(a, b)], [0.0; 4]);
        (sum[3] > 0.0).then(|| [0, 1, 2].map(|c| sum[c] / sum[3]))
    }
}

/// The matrix of throughput factors: the logarithm of R_d for all pairs, in half precision, with a confidence.
#[derive(Clone, Debug, PartialEq)]
pub struct Throughput {
    /// Number of vertices.
    pub vertices: usize,
    /// ln R_d of red, green, blue.
    pub(super) ln: Vec<[f16; 3]>,
    /// 0: interpolated; 255: measured without doubt.
    pub(super) confidence: Vec<u8>,
}

impl Throughput {
    /// From R_d of each pair, for a model that is known everywhere.
    pub fn from_function(vertices: usize, f: impl Fn(usize, usize) -> [f32; 3] + Sync) -> Self {
        use rayon::prelude::*;
        let row = |a: usize| (0..=a).map(|b| f(a, b).map(to_log)).collect::<Vec<_>>();
        let ln: Vec<[f16; 3]> = (0..vertices).into_par_iter().flat_map_iter(row).collect();
        Self { vertices, confidence: vec![255; ln.len()], ln }
    }

    /// R_d between two vertices in mm⁻².
    #[inline]
    pub fn value(&self, a: usize, b: usize) -> [f32; 3] {
        self.ln[pair(a, b)].map(|l| l.to_f32().exp())
    }

    /// How sure it is, from 0 (interpolated) to 1.
    pub fn confidence(&self, a: usize, b: usize) -> f32 {
        f32::from(self.confidence[pair(a, b)]) / 255.0
    }

    /// R_d between places of two triangles, linear in both.
    pub fn between(&self, lit: ([u32; 3], [f32; 3]), seen: ([u32; 3], [f32; 3])) -> [f32; 3] {
        let mut out = [0.0; 3];
        for (&a, wa) in lit.0.iter().zip(lit.1) {
            for (&b, wb) in seen.0.iter().zip(seen.1) {
                let f = self.value(a as usize, b as usize);
                (0..3).for_each(|c| out[c] += wa * wb * f[c]);
            }
        }
        out
    }
}

/// The logarithm as it is stored; nothing is darker than e^−60.
pub(super) fn to_log(r: f32) -> f16 {
    f16::from_f32(r.max(8.8e-27).ln())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_directions_of_a_pair_are_one_weighted_mean() {
        let mut m = Measured::new(4);
        m.add(3, 1, [1.0, 2.0, 3.0], 3.0);
        m.add(1, 3, [5.0, 6.0, 7.0], 1.0);
        // A plain average would halve what has no partner.
        m.add(0, 2, [8.0; 3], 0.5);
        assert_eq!(m.withdraw(1, 3), Some([2.0, 3.0, 4.0]));
        assert_eq!(m.withdraw(2, 0), Some([8.0; 3]));
        assert_eq!(m.withdraw(2, 0), None);
        let numbers: std::collections::HashSet<usize> = (0..4).flat_map(|a| (0..=a).map(move |b| pair(b, a))).collect();
        assert_eq!((numbers.len(), numbers.iter().max()), (pairs(4), Some(&(pairs(4) - 1))));
    }

    #[test]
    fn halves_of_logarithms_are_precise_over_the_whole_range() {
        let f = Throughput::from_function(2, |a, b| if a == b { [0.5, 1e-3, 1e-9] } else { [1e-12, 3.0, 2e-4] });
        for (a, b, expected) in [(1, 1, [0.5, 1e-3, 1e-9]), (0, 1, [1e-12, 3.0, 2e-4])] {
            let found = f.value(a, b);
            assert!(found.iter().zip(expected).all(|(x, e): (&f32, f32)| (x / e - 1.0).abs() < 0.01), "{found:?}");
        }
    }
}
