//! Does a sampler of directions follow its density? A χ² test over cells of the sphere.
//!
//! After the practice of Jakob's and Pharr's renderers: samples are counted in cells of equal solid angle (cos θ, φ), the
//! density is integrated over each cell, small cells are pooled. What the sampler drops (absorption, or a density that
//! integrates to less than one) is a cell of its own, so the total mass is tested as well.

use crate::{
    rng::Pcg32,
    stats::{Failure, chi2_test, sidak},
};
use glam::Vec3;
use std::f64::consts::TAU;

/// Settings of the test.
#[derive(Clone, Copy, Debug)]
pub struct SphereTest {
    /// Cells in cos θ.
    pub rows: usize,
    /// Cells in φ.
    pub columns: usize,
    /// Samples drawn.
    pub samples: usize,
    /// Chance of a false alarm over all the cases that the caller runs with the same settings.
    pub significance: f64,
    /// Seed of the samples.
    pub seed: u64,
    /// How far the density's total may honestly be off, for densities that contain a fit; the shape is tested nevertheless.
    pub mass_tolerance: f64,
}

impl Default for SphereTest {
    fn default() -> Self {
        Self { rows: 20, columns: 40, samples: 100_000, significance: 0.01, seed: 1, mass_tolerance: 0.0 }
    }
}

impl SphereTest {
    /// Runs the test; `cases` is how many such tests the caller makes (for Šidák's correction). Returns the p-value.
    ///
    /// `sample` returns a unit direction or `None` for a dropped sample; `pdf` is per solid angle.
    pub fn run(
        &self,
        name: &str,
        mut sample: impl FnMut(&mut Pcg32) -> Option<Vec3>,
        pdf: impl Fn(Vec3) -> f32,
        cases: usize,
    ) -> Result<f64, Failure> {
        let mut rng = Pcg32::new(self.seed, 0x5eed);
        let mut observed = vec![0.0; self.rows * self.columns + 1];
        for _ in 0..self.samples {
            let cell = match sample(&mut rng) {
                Some(w) if w.is_finite() && (w.length() - 1.0).abs() < 1e-3 => self.cell(w),
                Some(w) => return Err(Failure(format!("{name}: not a unit direction: {w}"))),
                None => self.rows * self.columns,
            };
            observed[cell] += 1.0;
        }
        let mut expected: Vec<f64> = (0..self.rows * self.columns)
            .map(|i| self.integrate(i / self.columns, i % self.columns, &pdf) * self.samples as f64)
            .collect();
        let total: f64 = expected.iter().sum::<f64>() / self.samples as f64;
        if total.is_nan() || total > 1.01 {
            return Err(Failure(format!("{name}: the density integrates to {total}")));
        }
        let dropped = observed[self.rows * self.columns] / self.samples as f64;
        if (1.0 - dropped - total).abs() <= self.mass_tolerance {
            let correction = (1.0 - dropped) / total.max(f64::MIN_POSITIVE);
            expected.iter_mut().for_each(|e| *e *= correction);
            observed.pop();
        } else {
            expected.push((1.0 - total).max(0.0) * self.samples as f64);
        }
        chi2_test(&observed, &expected, sidak(self.significance, cases)).map_err(|Failure(what)| {
            Failure(format!("{name}: {what} (density integrates to {total:.5}, {dropped:.5} of the samples dropped)"))
        })
    }

    fn cell(&self, w: Vec3) -> usize {
        let row = ((f64::from(w.z) + 1.0) * 0.5 * self.rows as f64) as usize;
        let phi = f64::from(w.y).atan2(f64::from(w.x)).rem_euclid(TAU);
        let column = (phi / TAU * self.columns as f64) as usize;
        row.min(self.rows - 1) * self.columns + column.min(self.columns - 1)
    }

    /// Integral of the density over a cell: adaptive halving of the longer side until two rules agree.
    fn integrate(&self, row: usize, column: usize, pdf: &impl Fn(Vec3) -> f32) -> f64 {
        let f = |z: f64, phi: f64| {
            let r = (1.0 - z * z).max(0.0).sqrt();
            f64::from(pdf(Vec3::new((r * phi.cos()) as f32, (r * phi.sin()) as f32, z as f32)))
        };
        let (dz, dphi) = (2.0 / self.rows as f64, TAU / self.columns as f64);
        let (z0, phi0) = (row as f64 * dz - 1.0, column as f64 * dphi);
        // Enough to see a peak that is much narrower than the cell.
        let n = 4;
        let (sz, sphi) = (dz / n as f64, dphi / n as f64);
        (0..n * n)
            .map(|i| {
                let (a, b) = (z0 + (i / n) as f64 * sz, phi0 + (i % n) as f64 * sphi);
                adaptive(&f, Rect { z: a, phi: b, dz: sz, dphi: sphi }, None, 1e-7, 0)
            })
            .sum()
    }
}

#[derive(Clone, Copy)]
struct Rect {
    z: f64,
    phi: f64,
    dz: f64,
    dphi: f64,
}

/// 3 × 3 Gauss–Legendre over a rectangle, halved in both directions until the halves agree with the whole.
fn adaptive(f: &impl Fn(f64, f64) -> f64, r: Rect, whole: Option<f64>, tolerance: f64, depth: u32) -> f64 {
    let whole = whole.unwrap_or_else(|| gauss(f, r));
    let (hz, hphi) = (r.dz / 2.0, r.dphi / 2.0);
    let quarters = [(0.0, 0.0), (hz, 0.0), (0.0, hphi), (hz, hphi)].map(|(a, b)| {
        let q = Rect { z: r.z + a, phi: r.phi + b, dz: hz, dphi: hphi };
        (q, gauss(f, q))
    });
    let sum: f64 = quarters.iter().map(|q| q.1).sum();
    if depth >= 7 || (sum - whole).abs() <= tolerance + 1e-4 * sum.abs() {
        return sum;
    }
    quarters.iter().map(|&(q, value)| adaptive(f, q, Some(value), tolerance / 4.0, depth + 1)).sum()
}

fn gauss(f: &impl Fn(f64, f64) -> f64, r: Rect) -> f64 {
    const X: [f64; 3] = [0.112_701_665_379_258_3, 0.5, 0.887_298_334_620_741_7];
    const W: [f64; 3] = [5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0];
    let mut sum = 0.0;
    for i in 0..3 {
        for j in 0..3 {
            sum += W[i] * W[j] * f(r.z + X[i] * r.dz, r.phi + X[j] * r.dphi);
        }
    }
    sum * r.dz * r.dphi
}
