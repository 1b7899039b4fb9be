//! The Poisson equation on a rectangle with no flux through the border, solved exactly by the cosine transform.

use rayon::prelude::*;
use rustdct::DctPlanner;

/// Solves Δu = `divergence` for the five-point Laplacian with Neumann borders on `width × height` values, in place.
///
/// The DCT-II diagonalises that Laplacian with eigenvalues 2cos(πi/w) + 2cos(πj/h) − 4, so the solve is exact up to
/// rounding. The mean of the result is 0; a mean in the right-hand side (which no solution has) is dropped.
pub fn solve_neumann(width: usize, height: usize, divergence: &mut Vec<f64>) {
    assert_eq!(divergence.len(), width * height);
    if divergence.is_empty() {
        return;
    }
    let mut planner = DctPlanner::new();
    let (forward_x, forward_y) = (planner.plan_dct2(width), planner.plan_dct2(height));
    let (back_x, back_y) = (planner.plan_dct3(width), planner.plan_dct3(height));
    divergence.par_chunks_mut(width).for_each(|row| forward_x.process_dct2(row));
    let mut columns = transposed(divergence, width);
    let eigenvalue = |k: usize, n: usize| 2.0 * (std::f64::consts::PI * k as f64 / n as f64).cos() - 2.0;
    // A DCT-II followed by a DCT-III multiplies by n/2 per axis.
    let norm = 4.0 / (width * height) as f64;
    columns.par_chunks_mut(height).enumerate().for_each(|(i, column)| {
        forward_y.process_dct2(column);
        for (j, v) in column.iter_mut().enumerate() {
            *v = if i + j == 0 { 0.0 } else { *v * norm / (eigenvalue(i, width) + eigenvalue(j, height)) };
        }
        back_y.process_dct3(column);
    });
    *divergence = transposed(&columns, height);
    divergence.par_chunks_mut(width).for_each(|row| back_x.process_dct3(row));
}

/// The transpose of rows of `width` values.
fn transposed(v: &[f64], width: usize) -> Vec<f64> {
    let height = v.len() / width;
    let mut out = vec![0.0; v.len()];
    // Sixteen columns at a time: each cache line of the source is used whole.
    out.par_chunks_mut(16 * height).enumerate().for_each(|(block, out)| {
        let columns = out.len() / height;
        for y in 0..height {
            for c in 0..columns {
                out[c * height + y] = v[y * width + block * 16 + c];
            }
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_laplacian_of_the_solution_is_the_right_hand_side() {
        let (w, h) = (37, 21);
        let mut u: Vec<f64> = (0..w * h).map(|i| ((i * 7919 % 1009) as f64).sin()).collect();
        let mean = u.iter().sum::<f64>() / u.len() as f64;
        u.iter_mut().for_each(|v| *v -= mean);
        let at = |x: usize, y: usize| u[y * w + x];
        let mut rhs = Vec::new();
        for y in 0..h {
            for x in 0..w {
                let mut sum = 0.0;
                if x > 0 {
                    sum += at(x - 1, y) - at(x, y);
                }
                if x + 1 < w {
                    sum += at(x + 1, y) - at(x, y);
                }
                if y > 0 {
                    sum += at(x, y - 1) - at(x, y);
                }
                if y + 1 < h {
                    sum += at(x, y + 1) - at(x, y);
                }
                rhs.push(sum);
            }
        }
        solve_neumann(w, h, &mut rhs);
        let worst = rhs.iter().zip(&u).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-11, "{worst}");
    }
}
