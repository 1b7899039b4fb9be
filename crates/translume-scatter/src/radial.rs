//! The fit of one fall-off to samples (r, ln value): several starts on binned samples, then all of them.
//!
//! Minimised is Σ w (ln R(r) − ln s)² [Fuchs 2005, Eq. 4]. A sum of exponentials has false minima, so a family proposes
//! several starts. They are tried on means over narrow bins of r, some eighty numbers instead of thousands; the spread
//! within the bins is a floor that no smooth curve gets below, so the search stops as soon as the best fit is close to
//! that floor. The winner is then refined on the samples themselves.

use crate::lanes::{self, Block, LANES, with_avx2};
use crate::lm::{Limits, Problem, Workspace, minimise};

/// Most parameters of one fall-off.
pub(crate) const MAX_PARAMETERS: usize = 12;

/// A set of positive functions of the distance with a few parameters.
pub(crate) trait Family {
    /// Parameters in the form that evaluates fast.
    type Prepared;

    /// Number of parameters, at most [`MAX_PARAMETERS`].
    fn parameters(&self) -> usize;

    /// `None` for parameters that are not allowed.
    fn prepare(&self, x: &[f64]) -> Option<Self::Prepared>;

    /// The values at distances `r` and their derivatives by the parameters. `N` is the number of these, or
    /// [`MAX_PARAMETERS`], and then what is too many stays as it was. To be inlined always.
    fn values<const N: usize>(&self, p: &Self::Prepared, r: &Block, values: &mut Block, derivatives: &mut [Block; N]);

    /// Parameters to start from, the most promising first.
    fn starts(&self, bins: &[Datum]) -> Vec<Vec<f64>>;

    /// The last word about a fit: whether it may be used.
    fn sound(&self, x: &[f64]) -> bool;

    /// By how much, as a logarithm, the curve is brighter than it may be, with the derivatives by the parameters; `None` where it is not.
    fn excess(&self, _: &Self::Prepared) -> Option<(f64, [f64; MAX_PARAMETERS])> {
        None
    }
}

/// A sample, or the mean of some.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Datum {
    /// Distance in mm.
    pub(crate) r: f64,
    /// Natural logarithm of the value.
    pub(crate) ln: f64,
    /// Its weight.
    pub(crate) weight: f64,
}

/// Buffers that survive from one fit to the next.
#[derive(Default)]
pub(crate) struct Scratch {
    pub(crate) lm: Workspace,
    bins: Vec<Datum>,
}

/// The sum of squares over `data` of a family.
struct LogFit<'a, F> {
    family: &'a F,
    data: &'a [Datum],
}

impl<F: Family> Problem for LogFit<'_, F> {
    fn parameters(&self) -> usize {
        self.family.parameters()
    }

    fn linearise(&self, x: &[f64], normal: &mut [f64], gradient: &mut [f64]) -> Option<f64> {
        // The usual sizes as constants: their loops unroll.
        match x.len() {
            2 => self.sums::<2>(x, normal, gradient),
            4 => self.sums::<4>(x, normal, gradient),
            6 => self.sums::<6>(x, normal, gradient),
            _ => self.sums::<MAX_PARAMETERS>(x, normal, gradient),
        }
    }
}

impl<F: Family> LogFit<'_, F> {
    fn sums<const N: usize>(&self, x: &[f64], normal: &mut [f64], gradient: &mut [f64]) -> Option<f64> {
        let prepared = self.family.prepare(x)?;
        let n = x.len();
        let mut sums = Squares::<N>::new();
        if !sum_blocks::<F, N>(self.family, &prepared, self.data, &mut sums) {
            return None;
        }
        for a in 0..n {
            gradient[a] = sums.right(a);
            (a..n).for_each(|b| normal[a * n + b] = sums.product(a, b));
        }
        let Some((excess, by)) = self.family.excess(&prepared) else { return Some(sums.cost()) };
        let all: f64 = self.data.iter().map(|d| d.weight).sum();
        Some(sums.cost() + punish(all, excess, &by[..n], normal, gradient))
    }
}

/// Weight of an excess against that of all data together: what is left of it is some 10⁻⁴.
const STIFFNESS: f64 = 1000.0;

/// Adds an excess as one more residual; its square is returned. `weight` is that of all data.
pub(crate) fn punish(weight: f64, excess: f64, by: &[f64], normal: &mut [f64], gradient: &mut [f64]) -> f64 {
    let (n, stiffness) = (by.len(), STIFFNESS * weight);
    for a in 0..n {
        gradient[a] += stiffness * excess * by[a];
        (a..n).for_each(|b| normal[a * n + b] += stiffness * by[a] * by[b]);
    }
    stiffness * excess * excess
}

/// Four partial sums of everything, so that they are vectors.
pub(crate) struct Squares<const N: usize> {
    cost: [f64; 4],
    right: [[f64; 4]; N],
    products: [[[f64; 4]; N]; N],
}

/// The smallest value of a curve: logarithms of less are not worth their rounding.
pub(crate) const SMALLEST: f64 = 1e-300;

/// Adds up all data; `false` if the curve is not positive at one of them.
fn sum_blocks<F: Family, const N: usize>(
    family: &F,
    prepared: &F::Prepared,
    data: &[Datum],
    sums: &mut Squares<N>,
) -> bool {
    with_avx2!([F: Family, const N: usize], sum_blocks_here,
        (family: &F, prepared: &F::Prepared, data: &[Datum], sums: &mut Squares<N>) -> bool)
}

#[inline(always)]
fn sum_blocks_here<F: Family, const N: usize>(
    family: &F,
    prepared: &F::Prepared,
    data: &[Datum],
    sums: &mut Squares<N>,
) -> bool {
    let (mut r, mut ln, mut weight, mut values) = ([0.0; LANES], [0.0; LANES], [0.0; LANES], [0.0; LANES]);
    let mut j = [[0.0; LANES]; N];
    for block in data.chunks(LANES) {
        for l in 0..LANES {
            // A short block is filled up with its last datum, which weighs nothing there.
            let datum = block[l.min(block.len() - 1)];
            (r[l], ln[l]) = (datum.r, datum.ln);
            weight[l] = if l < block.len() { datum.weight } else { 0.0 };
        }
        family.values::<N>(prepared, &r, &mut values, &mut j);
        if !values.iter().all(|v| *v >= SMALLEST) {
            return false;
        }
        sums.add(&values, &ln, &weight, &j);
    }
    true
}

impl<const N: usize> Squares<N> {
    pub(crate) fn new() -> Self {
        Self { cost: [0.0; 4], right: [[0.0; 4]; N], products: [[[0.0; 4]; N]; N] }
    }

    /// Σ w r².
    pub(crate) fn cost(&self) -> f64 {
        self.cost.iter().sum()
    }

    /// Element `a` of Jᵀr.
    pub(crate) fn right(&self, a: usize) -> f64 {
        self.right[a].iter().sum()
    }

    /// Element (a, b) of JᵀJ, a ≤ b.
    pub(crate) fn product(&self, a: usize, b: usize) -> f64 {
        self.products[a][b].iter().sum()
    }

    /// Adds a block; `j` are the derivatives of the values, those of their logarithms are j/value.
    #[inline(always)]
    pub(crate) fn add(&mut self, values: &Block, ln: &Block, weight: &Block, j: &[Block; N]) {
        let (mut once, mut square) = ([0.0; LANES], [0.0; LANES]);
        for l in 0..LANES {
            let residual = lanes::ln(values[l]) - ln[l]; // [Fuchs 2005, Eq. 4]
            let inverse = 1.0 / values[l];
            let weighted = weight[l] * residual;
            self.cost[l % 4] += weighted * residual;
            once[l] = weighted * inverse;
            square[l] = weight[l] * inverse * inverse;
        }
        for a in 0..N {
            let mut row = [0.0; LANES];
            for l in 0..LANES {
                self.right[a][l % 4] += j[a][l] * once[l];
                row[l] = j[a][l] * square[l];
            }
            for b in a..N {
                let sum = &mut self.products[a][b];
                for l in 0..LANES {
                    sum[l % 4] += row[l] * j[b][l];
                }
            }
        }
    }
}

/// Share of the sum of squares that a better minimum on the bins could still take away when the search ends early.
const GOOD_ENOUGH: f64 = 0.005;

/// Fits `family` to `data`; parameters and Σ w (ln R − ln s)². `None` without a sound fit.
pub(crate) fn fit<F: Family>(family: &F, data: &[Datum], scratch: &mut Scratch) -> Option<(Vec<f64>, f64)> {
    let within = bin(data, &mut scratch.bins);
    let bins = &scratch.bins;
    if bins.len() < family.parameters() {
        return None;
    }
    // What the means of honest samples scatter about a perfect curve.
    let freedom = (data.len() - bins.len()).max(1) as f64;
    let expected = within * (bins.len() - family.parameters()) as f64 / freedom;
    let search = Limits { steps: 60, tolerance: 1e-5 };
    let mut best: Option<(Vec<f64>, f64)> = None;
    for mut x in family.starts(bins) {
        let problem = LogFit { family, data: bins };
        let Some(cost) = minimise(&problem, &mut x, search, &mut scratch.lm) else { continue };
        if family.sound(&x) && best.as_ref().is_none_or(|b| cost < b.1) {
            best = Some((x, cost));
            if cost - expected <= GOOD_ENOUGH * (cost + within) {
                break;
            }
        }
    }
    let (binned, _) = best?;
    let mut x = binned.clone();
    let problem = LogFit { family, data };
    let finish = Limits { steps: 40, tolerance: 1e-5 };
    let cost = minimise(&problem, &mut x, finish, &mut scratch.lm)?;
    if family.sound(&x) {
        return Some((x, cost));
    }
    // Between the grid points of the family's test the refinement went wrong; what the bins gave is sound.
    let cost = minimise(&problem, &mut binned.clone(), Limits { steps: 0, tolerance: 0.0 }, &mut scratch.lm)?;
    Some((binned, cost))
}

/// Bins per octave of r².
const PER_OCTAVE_LOG2: u32 = 3;
/// Most bins; what is nearer than 2^-16 of the farthest sample is one.
const MAX_BINS: u32 = 256;

/// Means of `data` over bins of r whose width is some 4 % of it; the sum of squares within the bins is returned.
fn bin(data: &[Datum], bins: &mut Vec<Datum>) -> f64 {
    // The leading bits of a positive float are a logarithm that is linear within octaves.
    let index = |r: f64| ((r * r) as f32).to_bits() >> (23 - PER_OCTAVE_LOG2);
    let top = data.iter().map(|d| index(d.r)).max().unwrap_or(0);
    let low = top.saturating_sub(MAX_BINS - 1);
    bins.clear();
    bins.resize((top - low + 1) as usize, Datum { r: 0.0, ln: 0.0, weight: 0.0 });
    let mut squares = 0.0;
    for d in data {
        let b = &mut bins[(index(d.r).max(low) - low) as usize];
        b.weight += d.weight;
        b.r += d.weight * d.r;
        b.ln += d.weight * d.ln;
        squares += d.weight * d.ln * d.ln;
    }
    bins.retain(|b| b.weight > 0.0);
    for b in bins.iter_mut() {
        b.r /= b.weight;
        b.ln /= b.weight;
        squares -= b.weight * b.ln * b.ln;
    }
    squares.max(0.0)
}

/// Decay per mm of the bins with `from ≤ r ≤ to`, by a straight line through their logarithms.
pub(crate) fn decay(bins: &[Datum], from: f64, to: f64) -> Option<f64> {
    let part = || bins.iter().filter(|b| (from..=to).contains(&b.r));
    let weight: f64 = part().map(|b| b.weight).sum();
    let mean = |f: fn(&Datum) -> f64| part().map(|b| b.weight * f(b)).sum::<f64>() / weight;
    let (r, ln) = (mean(|b| b.r), mean(|b| b.ln));
    let covariance: f64 = part().map(|b| b.weight * (b.r - r) * (b.ln - ln)).sum();
    let variance: f64 = part().map(|b| b.weight * (b.r - r) * (b.r - r)).sum();
    (variance > 1e-12 * weight * r * r).then(|| -covariance / variance)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_keep_weight_and_mean_and_split_the_squares() {
        let data: Vec<Datum> = (0..1000)
            .map(|i| Datum { r: f64::from(i) * 0.01, ln: (f64::from(i) * 0.7).sin(), weight: 1.0 + f64::from(i % 3) })
            .collect();
        let mut bins = Vec::new();
        let within = bin(&data, &mut bins);
        let sum = |d: &[Datum], f: fn(&Datum) -> f64| d.iter().map(|x| x.weight * f(x)).sum::<f64>();
        for f in [|_: &Datum| 1.0, |d: &Datum| d.r, |d: &Datum| d.ln] {
            assert!((sum(&data, f) - sum(&bins, f)).abs() < 1e-9);
        }
        assert!((sum(&data, |d| d.ln * d.ln) - sum(&bins, |d| d.ln * d.ln) - within).abs() < 1e-9);
        assert!(bins.windows(2).all(|w| w[0].r < w[1].r) && (50..120).contains(&bins.len()), "{}", bins.len());
    }

    #[test]
    fn decay_is_the_slope_of_the_logarithm() {
        let bins: Vec<Datum> =
            (1..20).map(|i| Datum { r: f64::from(i), ln: 2.0 - 0.7 * f64::from(i), weight: f64::from(i) }).collect();
        assert!((decay(&bins, 3.0, 12.0).unwrap() - 0.7).abs() < 1e-12);
        assert!(decay(&bins, 3.0, 3.5).is_none(), "one bin has no slope");
    }
}
