//! Sums of exponentials, as [Fuchs 2005, Eq. 1] and [Fuchs 2005, Eq. 4] have them: parameters, starts and what keeps them physical.
//!
//! d_k = −exp(δ_k), so every term decays. The amplitudes c_k carry a sign, because fall-off under a wide beam has a
//! shoulder that positive ones cannot follow (RMS error of the logarithm 0.071 with positive, 0.007 with signed c for a
//! 2 mm beam); the sum must stay positive at all distances. Its slowest term must be positive, a grid of distances is
//! tried at each step, and beyond the grid the slowest term must outweigh the negative ones, which decay faster.

use crate::curve::Exponentials;
use crate::lanes::{self, Block, LANES};
use crate::radial::{Datum, Family, MAX_PARAMETERS, Scratch, decay, fit};
use std::f64::consts::TAU;

/// Most terms of a sum.
pub const MAX_TERMS: usize = MAX_PARAMETERS / 2;

/// Rates times the farthest distance lie within these: flatter is a constant, steeper is one sample.
const RATES: (f64, f64) = (1e-3, 1e4);

/// How far beyond the samples positivity is looked at, in units of the farthest of them.
const BEYOND: f64 = 4.0;

/// Least ratio of the sum to the sum of its terms' absolute values: less is cancellation, and no shape that samples
/// asked for.
const CANCELLATION: f64 = 1e-6;

/// The family of sums of `terms` exponentials; parameters are c_1…c_n, δ_1…δ_n.
pub(crate) struct Sums {
    terms: usize,
    reach: f64,
    /// The largest integral over a plane.
    most: Option<f64>,
}

/// Amplitudes and decays.
pub(crate) struct PreparedSum {
    c: [f64; MAX_TERMS],
    d: [f64; MAX_TERMS],
}

impl Sums {
    /// For samples up to `reach` mm.
    pub(crate) fn new(terms: usize, reach: f64, most: Option<f64>) -> Self {
        Self { terms, reach, most }
    }

    /// ∫ Σ c e^{dr} 2πr dr = Σ 2π c/d² of `n` terms, and its derivatives by c_1…c_n, δ_1…δ_n.
    pub(crate) fn total(&self, n: usize, p: &PreparedSum) -> (f64, [f64; MAX_PARAMETERS]) {
        let mut by = [0.0; MAX_PARAMETERS];
        for k in 0..n {
            by[k] = TAU / (p.d[k] * p.d[k]);
            by[n + k] = -2.0 * p.c[k] * by[k]; // ∂d/∂δ = d
        }
        ((0..n).map(|k| p.c[k] * by[k]).sum(), by)
    }

    /// Whether the sum is positive at `points` distances up to [`BEYOND`] times the reach, and beyond.
    fn positive(&self, c: &[f64], d: &[f64], points: usize) -> bool {
        if c.iter().all(|c| *c > 0.0) {
            return true;
        }
        let parts = |r: f64| {
            c.iter().zip(d).fold((0.0, 0.0), |(sum, all), (c, d)| {
                let t = c * (d * r).exp();
                (sum + t, all + t.abs())
            })
        };
        let grid_holds = (0..=points).all(|i| {
            let t = i as f64 / points as f64;
            let (sum, all) = parts(BEYOND * self.reach * t * t); // denser near the spot
            sum > CANCELLATION * all
        });
        let slowest = (0..c.len()).max_by(|&a, &b| d[a].total_cmp(&d[b])).unwrap_or(0);
        let end = |k: usize| c[k] * (d[k] * BEYOND * self.reach).exp();
        let negative: f64 = (0..c.len()).filter(|&k| c[k] < 0.0).map(|k| -end(k)).sum();
        grid_holds && end(slowest) > negative
    }

    /// The values of `n` terms and their derivatives by c_1…c_n, δ_1…δ_n.
    #[inline(always)]
    pub(crate) fn blocks(&self, n: usize, p: &PreparedSum, r: &Block, values: &mut Block, derivatives: &mut [Block]) {
        let (by_c, by_delta) = derivatives.split_at_mut(n);
        *values = [0.0; LANES];
        for k in 0..n {
            for l in 0..LANES {
                let exponent = p.d[k] * r[l];
                let e = lanes::exp(exponent);
                let term = p.c[k] * e;
                values[l] += term; // [Fuchs 2005, Eq. 1]
                by_c[k][l] = e;
                by_delta[k][l] = term * exponent; // ∂d/∂δ = d
            }
        }
    }

    /// Amplitudes for given rates by least squares on relative errors, the linear cousin of the logarithmic ones.
    /// Without `signed`, terms that want to be negative enter with a share of 5 % at most.
    fn amplitudes(&self, bins: &[Datum], rates: &[f64], signed: bool) -> Option<Vec<f64>> {
        let n = rates.len();
        let ratio = |b: &Datum, k: usize| (-rates[k] * b.r - b.ln).exp();
        let mut normal = vec![vec![0.0; n + 1]; n];
        for b in bins {
            for i in 0..n {
                let row = b.weight * ratio(b, i);
                (0..n).for_each(|j| normal[i][j] += row * ratio(b, j));
                normal[i][n] += row;
            }
        }
        let mut active: Vec<usize> = (0..n).collect();
        loop {
            let c = solve_subset(&normal, &active)?;
            let worst = (0..c.len()).min_by(|&a, &b| c[a].total_cmp(&c[b]))?;
            if signed || c[worst] > 0.0 {
                let small = |k: usize| 0.05 / bins.iter().map(|b| ratio(b, k)).fold(1e-300, f64::max);
                let at = |k: usize| active.iter().position(|&a| a == k);
                return Some((0..n).map(|k| at(k).map_or_else(|| small(k), |i| c[i])).collect());
            }
            active.remove(worst);
        }
    }
}

impl Family for Sums {
    type Prepared = PreparedSum;

    fn parameters(&self) -> usize {
        2 * self.terms
    }

    fn prepare(&self, x: &[f64]) -> Option<PreparedSum> {
        let n = self.terms;
        let mut p = PreparedSum { c: [0.0; MAX_TERMS], d: [0.0; MAX_TERMS] };
        p.c[..n].copy_from_slice(&x[..n]);
        for k in 0..n {
            let rate = x[n + k].exp();
            if !(RATES.0..=RATES.1).contains(&(rate * self.reach)) {
                return None;
            }
            p.d[k] = -rate;
        }
        self.positive(&p.c[..n], &p.d[..n], 16).then_some(p)
    }

    #[inline(always)]
    fn values<const N: usize>(&self, p: &PreparedSum, r: &Block, values: &mut Block, derivatives: &mut [Block; N]) {
        // The constant lets the loop unroll.
        self.blocks(if N < MAX_PARAMETERS { N / 2 } else { self.terms }, p, r, values, derivatives);
    }

    fn starts(&self, bins: &[Datum]) -> Vec<Vec<f64>> {
        let n = self.terms;
        let reach = self.reach;
        let limit = |rate: f64| (rate * reach).clamp(2.0 * RATES.0, 0.5 * RATES.1) / reach;
        let far = limit(decay(bins, 0.5 * reach, reach).or_else(|| decay(bins, 0.0, reach)).unwrap_or(1.0 / reach));
        let near = bins.get(bins.len() / 5).and_then(|b| decay(bins, 0.0, b.r)).unwrap_or(far).max(2.0 * far);
        // Slowest and fastest rate, and whether amplitudes may be negative from the start.
        let ranges = [
            (0.8 * far, 1.3 * near, false),
            (0.5 * far, 3.0 * near, false),
            (far, 6.0 * far, true),
            (0.9 * far, 0.6 * near.max(4.0 * far), false),
            (0.3 * far, 10.0 * near, false),
            (0.8 * far, 3.0 * near, true),
        ];
        let start = |(slow, fast, signed): (f64, f64, bool)| {
            let step = if n > 1 { (fast / slow).powf(1.0 / (n - 1) as f64) } else { 1.0 };
            let slow = if n > 1 { slow } else { (slow * fast).sqrt() };
            let rates: Vec<f64> = (0..n).rev().map(|k| limit(slow * step.powi(k as i32))).collect();
            let mut x = self.amplitudes(bins, &rates, signed)?;
            x.extend(rates.iter().map(|r| r.ln()));
            Some(x)
        };
        ranges.into_iter().filter_map(start).collect()
    }

    fn sound(&self, x: &[f64]) -> bool {
        let d: Vec<f64> = x[self.terms..].iter().map(|x| -x.exp()).collect();
        x.iter().all(|x| x.is_finite()) && self.positive(&x[..self.terms], &d, 512)
    }

    fn excess(&self, p: &PreparedSum) -> Option<(f64, [f64; MAX_PARAMETERS])> {
        let most = self.most?;
        let (total, by) = self.total(self.terms, p);
        (total > most).then(|| ((total / most).ln(), by.map(|b| b / total)))
    }
}

/// Solves the rows and columns `active` of the normal equations by elimination with a relative ridge.
fn solve_subset(normal: &[Vec<f64>], active: &[usize]) -> Option<Vec<f64>> {
    let (n, right) = (active.len(), normal.len());
    let mut a: Vec<Vec<f64>> = active
        .iter()
        .map(|&i| {
            let mut row: Vec<f64> = active.iter().map(|&j| normal[i][j]).collect();
            row.push(normal[i][right]);
            row
        })
        .collect();
    (0..n).for_each(|i| a[i][i] *= 1.0 + 1e-9);
    for i in 0..n {
        if !(a[i][i] > 0.0 && a[i][i].is_finite()) {
            return None;
        }
        for k in i + 1..n {
            let f = a[k][i] / a[i][i];
            for j in i..=n {
                a[k][j] -= f * a[i][j];
            }
        }
    }
    let mut x = vec![0.0; n];
    for i in (0..n).rev() {
        let sum: f64 = (i + 1..n).map(|j| a[i][j] * x[j]).sum();
        x[i] = (a[i][n] - sum) / a[i][i];
    }
    (n > 0).then_some(x)
}

/// With fewer samples than this for each parameter, the number of terms is chosen by what they pay.
const PLENTY: f64 = 40.0;

/// Fits up to `terms` exponentials: fewer where more find no sound fit, or are not worth it. The sum of squares of the
/// logarithm is returned with them; `None` without samples at two distances.
///
/// Few samples are overfitted by many terms, which extrapolate badly. So the fits are then compared by Schwarz's criterion,
/// N ln(S/N) + p ln N for the sum of squares S of p parameters; with many samples more terms win it anyway.
///
/// `most` is the largest integral over a plane: samples of a short range do not tell how slow the slowest term is, and a fit would be as
/// bright as it likes.
pub(crate) fn fit_sum(
    data: &[Datum],
    terms: usize,
    most: Option<f64>,
    scratch: &mut Scratch,
) -> Option<(Exponentials, f64)> {
    let reach = data.iter().map(|d| d.r).fold(0.0, f64::max);
    if reach <= 0.0 {
        return None;
    }
    let weight: f64 = data.iter().map(|d| d.weight).sum();
    let criterion = |n: usize, cost: f64| weight * (cost / weight + 1e-14).ln() + 2.0 * n as f64 * weight.ln();
    let mut best: Option<(Exponentials, f64, f64)> = None;
    for n in (1..=terms).rev() {
        let Some((x, cost)) = fit(&Sums::new(n, reach, most), data, scratch) else { continue };
        // Two rates in one: the terms are not told apart by the samples, and their amplitudes mean nothing.
        let merged = (n..2 * n).any(|i| (n..i).any(|j| (x[i] - x[j]).abs() < 1e-4));
        let value = criterion(n, cost);
        if (!merged || n == 1) && best.as_ref().is_none_or(|b| value < b.2) {
            best = Some((to_exponentials(&x), cost, value));
        }
        if best.is_some() && weight >= PLENTY * 2.0 * n as f64 {
            break;
        }
    }
    best.map(|(sum, cost, _)| (sum, cost))
}

/// Parameters as amplitudes and decays, fastest first.
pub(crate) fn to_exponentials(x: &[f64]) -> Exponentials {
    let n = x.len() / 2;
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&a, &b| x[n + b].total_cmp(&x[n + a]));
    Exponentials { c: order.iter().map(|&k| x[k]).collect(), d: order.iter().map(|&k| -x[n + k].exp()).collect() }
}
