//! The first principal directions of a stack's matrix, without ever taking it apart in full.
//!
//! - [`lanczos`]: [Menzel 2012, §4.2 Krylov]: a Krylov space of dimension 4k, started from the white image, and the eigenvalues
//!   of the projection to it. Multiplying by M and Mᵀ in turn from a white image w gives the same space in light space as
//!   the matrix MMᵀ from the vector Mw, and that matrix is small (lights × lights): it is summed in one pass, and the
//!   iteration runs on it. With full re-orthogonalisation.
//! - [`randomised`]: Halko, Martinsson and Tropp, "Finding structure with randomness" (SIAM Review 2011), Alg. 4.4 on
//!   the other side: a random subspace of the columns, improved by power iterations, each one pass over the matrix.
//!
//! Directions come in order of falling variance, as columns of unit length; the variances are sums over the texels seen.

use crate::matrix::{Matrix, PIECE, View, add_product, transposed, view, whole};
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use translume_core::rng::Pcg32;

/// MMᵀ of the thesis' matrix, whose rows are lights and whose columns are texels and channels, and the row sums (the
/// product with a white image).
pub fn light_gram(matrix: &Matrix, step: usize) -> (DMatrix<f64>, DVector<f64>) {
    let n = matrix.lights;
    let gram = matrix.sum(step, (n, n), |values, texels, out| {
        for c in 0..3 {
            let columns = channel(values, texels, n, c);
            let rows = lights_by_texels(values, texels, n, c);
            add_product(out, &rows, &columns);
        }
    });
    let means = matrix.means(step);
    let white = DVector::from_iterator(n, means.chunks(3).map(|c| c.iter().map(|v| f64::from(*v)).sum()));
    (gram, white)
}

/// The first `k` eigenvectors of `gram` in a Krylov space of dimension 4k from `start`, with their eigenvalues.
pub fn lanczos(gram: &DMatrix<f64>, start: &DVector<f64>, k: usize) -> (DMatrix<f64>, Vec<f64>) {
    let n = gram.nrows();
    let scale = gram.trace().max(f64::MIN_POSITIVE);
    // [Menzel 2012, §4.2 Krylov]
    let mut basis: Vec<DVector<f64>> = Vec::new();
    let mut next = start.clone();
    let mut rng = Pcg32::new(1, 0);
    while basis.len() < (4 * k).min(n) {
        // Twice is enough [Kahan, Parlett].
        for _ in 0..2 {
            for q in &basis {
                let along = q.dot(&next);
                next.axpy(-along, q, 1.0);
            }
        }
        let length = next.norm();
        let q = if length > 1e-12 * scale.sqrt().min(1.0) && length.is_finite() {
            next / length
        } else {
            // The space is invariant: go on from anywhere outside it.
            next = DVector::from_fn(n, |_, _| rng.next_normal());
            continue;
        };
        next = gram * &q / scale;
        basis.push(q);
    }
    let q = DMatrix::from_columns(&basis);
    let (vectors, values) = eigen(&(q.transpose() * gram * &q));
    let k = k.min(values.len());
    (&q * vectors.columns(0, k), values[..k].to_vec())
}

/// The first `k` principal directions of the columns (lights × channels) less `means`, from every `step`-th piece, with
/// `power` power iterations.
pub fn randomised(matrix: &Matrix, means: &[f32], k: usize, power: usize, step: usize) -> (DMatrix<f32>, Vec<f64>) {
    let columns = 3 * matrix.lights;
    let k = k.min(columns);
    let width = (k + 8).min(columns);
    let means = DVector::from_column_slice(means);
    let mut rng = Pcg32::new(1, 0);
    let mut basis = DMatrix::from_fn(columns, width, |_, _| rng.next_normal() as f32);
    for _ in 0..=power {
        let product = matrix.sum(step, (columns, width), |values, n, out| {
            let rows = centred_product(values, n, &means, &basis);
            add_product(out, &transposed(values, n, columns, PIECE), &whole(&rows));
            // (X − 1mᵀ)ᵀ R = Xᵀ R − m (1ᵀ R)
            out.ger(-1.0, &means, &rows.row_sum_tr(), 1.0);
        });
        basis = product.qr().q().map(|v| v as f32);
    }
    let small = matrix.sum(step, (width, width), |values, n, out| {
        let rows = centred_product(values, n, &means, &basis);
        add_product(out, &whole(&rows.transpose()), &whole(&rows));
    });
    let (vectors, values) = eigen(&small);
    (basis * vectors.columns(0, k).map(|v| v as f32), values[..k].to_vec())
}

/// The same for the thesis' matrix (a row a light, a column a texel and channel, nothing centred): the first `k` left
/// directions.
pub fn randomised_lights(matrix: &Matrix, k: usize, power: usize, step: usize) -> DMatrix<f64> {
    let n = matrix.lights;
    let width = (k + 8).min(n);
    let mut rng = Pcg32::new(2, 0);
    let mut basis = DMatrix::from_fn(n, width, |_, _| rng.next_normal() as f32);
    for _ in 0..=power {
        let product = matrix.sum(step, (n, width), |values, texels, out| {
            for c in 0..3 {
                let rows = along(&channel(values, texels, n, c), &basis);
                add_product(out, &lights_by_texels(values, texels, n, c), &whole(&rows));
            }
        });
        basis = product.qr().q().map(|v| v as f32);
    }
    let small = matrix.sum(step, (width, width), |values, texels, out| {
        for c in 0..3 {
            let rows = along(&channel(values, texels, n, c), &basis);
            add_product(out, &whole(&rows.transpose()), &whole(&rows));
        }
    });
    let (vectors, _) = eigen(&small);
    basis.map(f64::from) * vectors.columns(0, k.min(width))
}

/// Texels × lights of one channel of a piece.
pub(crate) fn channel(values: &[f32], texels: usize, lights: usize, c: usize) -> View<'_> {
    View::from_slice_with_strides(&values[c * PIECE..], texels, lights, 1, 3 * PIECE)
}

/// Its transposed.
fn lights_by_texels(values: &[f32], texels: usize, lights: usize, c: usize) -> View<'_> {
    View::from_slice_with_strides(&values[c * PIECE..], lights, texels, 3 * PIECE, 1)
}

/// Rows times a basis.
pub(crate) fn along(rows: &View<'_>, basis: &DMatrix<f32>) -> DMatrix<f32> {
    let mut out = DMatrix::zeros(rows.nrows(), basis.ncols());
    add_product(&mut out, rows, &whole(basis));
    out
}

/// (X − 1mᵀ) B without forming the bracket.
fn centred_product(values: &[f32], n: usize, means: &DVector<f32>, basis: &DMatrix<f32>) -> DMatrix<f32> {
    let mut rows = along(&view(values, n, basis.nrows(), PIECE), basis);
    let shift = basis.tr_mul(means);
    for (mut column, s) in rows.column_iter_mut().zip(&shift) {
        column.add_scalar_mut(-s);
    }
    rows
}

/// Eigenvectors of a symmetric matrix by falling eigenvalue.
pub(crate) fn eigen(matrix: &DMatrix<f64>) -> (DMatrix<f64>, Vec<f64>) {
    let found = SymmetricEigen::new(matrix.clone());
    let mut order: Vec<usize> = (0..matrix.nrows()).collect();
    order.sort_by(|&a, &b| found.eigenvalues[b].total_cmp(&found.eigenvalues[a]));
    let vectors: Vec<_> = order.iter().map(|&i| found.eigenvectors.column(i).into_owned()).collect();
    (DMatrix::from_columns(&vectors), order.iter().map(|&i| found.eigenvalues[i].max(0.0)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Five lights, 700 texels; three strong directions and a little of everything.
    fn small() -> Matrix {
        let mut rng = Pcg32::new(7, 0);
        let mut draw = |n: usize| (0..n).map(|_| rng.next_normal() as f32).collect::<Vec<_>>();
        let (left, right, noise) = (draw(3 * 15), draw(3 * 700), draw(15 * 700));
        Matrix::of(5, 700, |i, t| {
            let strong: f32 = (0..3).map(|j| (3 - j) as f32 * left[15 * j + i] * right[700 * j + t]).sum();
            12.0 + strong + 0.05 * noise[700 * i + t]
        })
    }

    /// All of the matrix, texels × columns.
    fn full(matrix: &Matrix) -> DMatrix<f64> {
        let mut out = DMatrix::zeros(matrix.texels, 3 * matrix.lights);
        let mut values = Vec::new();
        for piece in 0..matrix.pieces() {
            matrix.load(piece, &mut values);
            for (row, t) in matrix.piece(piece).enumerate() {
                (0..out.ncols()).for_each(|c| out[(t, c)] = f64::from(values[c * PIECE + row]));
            }
        }
        out
    }

    #[test]
    fn lanczos_from_white_finds_the_eigenvectors_of_the_thesis_matrix() {
        let matrix = small();
        let all = full(&matrix);
        // The thesis' matrix: a row a light, a column a texel and channel, no mean taken off.
        let m = DMatrix::from_fn(5, 3 * 700, |l, i| all[(i / 3, 3 * l + i % 3)]);
        let (exact_vectors, exact) = eigen(&(&m * m.transpose()));
        let (gram, white) = light_gram(&matrix, 1);
        let (vectors, values) = lanczos(&gram, &white, 3);
        for j in 0..3 {
            assert!((values[j] / exact[j] - 1.0).abs() < 1e-4, "{j}: {} for {}", values[j], exact[j]);
            let along = vectors.column(j).dot(&exact_vectors.column(j)).abs();
            assert!((along - 1.0).abs() < 1e-4, "{j}: {along}");
        }
        // The first is near the mean picture: had the mean been taken off, it would not be.
        assert!(vectors.column(0).sum().abs() > 2.0);
    }

    #[test]
    fn the_random_subspace_holds_what_a_full_decomposition_finds() {
        let matrix = small();
        let mut all = full(&matrix);
        let means = matrix.means(1);
        (0..15).for_each(|c| all.column_mut(c).add_scalar_mut(-f64::from(means[c])));
        let (_, exact) = eigen(&all.tr_mul(&all));
        let (vectors, values) = randomised(&matrix, &means, 4, 1, 1);
        // The fourth is noise, as large in every direction: any of them will do.
        for (j, near) in [1e-3, 1e-3, 1e-3, 0.05].into_iter().enumerate() {
            assert!((values[j] / exact[j] - 1.0).abs() < near, "{j}: {} for {}", values[j], exact[j]);
        }
        let gram = vectors.tr_mul(&vectors) - DMatrix::identity(4, 4);
        assert!(gram.amax() < 1e-5, "{gram}");
    }
}
