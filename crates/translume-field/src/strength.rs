//! How strong each light of a stack was, from pictures of a mostly matt object: photometric stereo with known directions and unknown
//! strengths.
//!
//! A lit matt texel shows s_j b·l_j under light j, b its albedo times its normal. So what it shows, each value divided by s_j, lies in the
//! space that the directions span: with u_j = 1/s_j, L the directions of the lights that light it and D the diagonal of what it shows,
//! (1 − L L⁺) D u = 0. The u of least squares over all texels is the last eigenvector of Σ w D (1 − L L⁺) D. Texels that follow no b,
//! in shadows and highlights, are weighed down by what they leave, and u is found again (Cauchy weights). The strengths are relative: their
//! mean is 1.

use crate::stack::Stack;
use crate::{Error, Result};
use nalgebra::{DMatrix, DVector, Matrix3, SymmetricEigen, Vector3};
use rayon::prelude::*;

/// Texels that are looked at.
const ENOUGH: usize = 1 << 14;
const ROUNDS: usize = 12;
/// Fewest lights that a texel must be lit by.
const LIT: usize = 4;
/// Fewest texels that say enough.
const FEWEST: usize = 32;

/// The relative strengths of the lights of `stack`, as far as they are not known already.
///
/// # Errors
/// Of reading; [`Error::Invalid`] when too little of the pictures is lit by four lights or more.
pub fn estimate(stack: &Stack) -> Result<Vec<f32>> {
    let step = stack.pixels().div_ceil(ENOUGH);
    let grey = |i: usize| -> Result<Vec<f64>> {
        let rgb = stack.read(i)?;
        Ok(rgb.as_chunks::<3>().0.iter().step_by(step).map(|p| f64::from(p[0] + p[1] + p[2]) / 3.0).collect())
    };
    let pictures = (0..stack.shots.len()).into_par_iter().with_max_len(1).map(grey).collect::<Result<Vec<_>>>()?;
    let lights: Vec<Vector3<f64>> = stack.shots.iter().map(|s| Vector3::from(s.light.map(f64::from))).collect();
    from_values(&pictures, &lights).ok_or_else(|| {
        let what = "too little of the pictures is lit by four lights or more to tell how strong the lights were";
        Error::invalid(&stack.folder, what)
    })
}

/// The same of values by light, then texel.
fn from_values(pictures: &[Vec<f64>], lights: &[Vector3<f64>]) -> Option<Vec<f32>> {
    let n = lights.len();
    let texels = pictures.first()?.len();
    // Lit: far above what the texel shows at its darkest; and not clipped.
    let lit_by = |t: usize| {
        let most = pictures.iter().map(|p| p[t]).fold(0.0, f64::max);
        let counts = |j: &usize| pictures[*j][t] > 0.15 * most && pictures[*j][t] < 0.97 && most > 0.02;
        (0..n).filter(counts).collect::<Vec<usize>>()
    };
    let picked: Vec<(usize, Vec<usize>)> =
        (0..texels).map(|t| (t, lit_by(t))).filter(|(_, lit)| lit.len() >= LIT).collect();
    // By texel: which lights, what it shows relative to its brightest, and the inverse of LᵀL.
    let texel = |(t, lit): (usize, Vec<usize>)| {
        let most = lit.iter().map(|j| pictures[*j][t]).fold(0.0, f64::max);
        let products: Matrix3<f64> = lit.iter().map(|j| lights[*j] * lights[*j].transpose()).sum();
        let shown: Vec<f64> = lit.iter().map(|j| pictures[*j][t] / most).collect();
        Some((lit, shown, products.try_inverse()?))
    };
    let texels: Vec<_> = picked.into_iter().filter_map(texel).collect();
    if texels.len() < FEWEST || (0..n).any(|j| texels.iter().filter(|(lit, ..)| lit.contains(&j)).count() < FEWEST / 2)
    {
        return None;
    }
    let mut weights = vec![1.0; texels.len()];
    let mut inverse = DVector::from_element(n, 1.0);
    for _ in 0..ROUNDS {
        let mut sum = DMatrix::<f64>::zeros(n, n);
        for ((lit, shown, products), w) in texels.iter().zip(&weights) {
            for (a, i) in lit.iter().enumerate() {
                let along = products * lights[*i];
                for (b, j) in lit.iter().enumerate() {
                    let one = if a == b { 1.0 } else { 0.0 };
                    sum[(*i, *j)] += w * shown[a] * (one - along.dot(&lights[*j])) * shown[b];
                }
            }
        }
        let eigen = SymmetricEigen::new(sum);
        let last = (0..n).min_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]))?;
        inverse = eigen.eigenvectors.column(last).into_owned();
        inverse *= n as f64 / inverse.sum();
        let left: Vec<f64> = texels.iter().map(|t| residual(t, lights, &inverse)).collect();
        let mut sorted = left.clone();
        let middle = *sorted.select_nth_unstable_by(left.len() / 2, f64::total_cmp).1;
        weights = left.iter().map(|r| 1.0 / (1.0 + r / middle.max(1e-12))).collect();
    }
    if inverse.iter().any(|u| *u <= 1e-3) {
        return None;
    }
    let mean = inverse.iter().map(|u| 1.0 / u).sum::<f64>() / n as f64;
    Some(inverse.iter().map(|u| (1.0 / (u * mean)) as f32).collect())
}

/// Squared length of what a texel leaves.
fn residual(
    (lit, shown, products): &(Vec<usize>, Vec<f64>, Matrix3<f64>),
    lights: &[Vector3<f64>],
    u: &DVector<f64>,
) -> f64 {
    let values = || lit.iter().zip(shown).map(|(j, v)| (*j, v * u[*j]));
    let surface = products * values().map(|(j, v)| lights[j] * v).sum::<Vector3<f64>>();
    values().map(|(j, v)| (v - surface.dot(&lights[j])).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strengths_come_back_from_a_matt_ball_with_shadows_and_highlights() {
        let lights: Vec<Vector3<f64>> = (0..9)
            .map(|j| {
                let (sin, cos) = (2.4 * f64::from(j)).sin_cos();
                Vector3::new(0.5 * cos, 0.5 * sin, 1.0).normalize()
            })
            .collect();
        let truth: Vec<f64> = (0..9).map(|j| 0.6 + 0.1 * f64::from(j)).collect();
        let texel = |t: usize, j: usize| {
            let (x, y) = ((t % 40) as f64 / 20.0 - 0.975, (t / 40) as f64 / 20.0 - 0.975);
            let z2 = 1.0 - x * x - y * y;
            if z2 <= 0.0 {
                return 0.0;
            }
            let normal = Vector3::new(x, y, z2.sqrt());
            let half = (lights[j] + Vector3::z()).normalize();
            // A texel in thirteen is in the shadow of something.
            let shadow = if (t * 7 + j * 5).is_multiple_of(13) { 0.0 } else { 1.0 };
            let gloss = 0.3 * normal.dot(&half).max(0.0).powi(60);
            shadow * truth[j] * ((0.3 + 0.2 * (0.3 * t as f64).sin()) * normal.dot(&lights[j]).max(0.0) + gloss)
        };
        let pictures: Vec<Vec<f64>> = (0..9).map(|j| (0..1600).map(|t| texel(t, j)).collect()).collect();
        let found = from_values(&pictures, &lights).unwrap();
        for (found, truth) in found.iter().zip(&truth) {
            assert!((f64::from(*found) / truth - 1.0).abs() < 0.03, "{found:?} {truth}");
        }
        assert!(from_values(&vec![vec![0.0; 1600]; 9], &lights).is_none());
    }
}
