//! Separable filters on one plane.

use rayon::prelude::*;

/// How samples outside the plane are made up.
#[derive(Clone, Copy)]
pub(super) enum Border {
    /// The nearest sample.
    Repeat,
    /// Mirrored with the border sample doubled (`d c b a | a b c d`).
    Mirror,
}

impl Border {
    fn index(self, i: isize, n: usize) -> usize {
        let n = n as isize;
        match self {
            Self::Repeat => i.clamp(0, n - 1) as usize,
            Self::Mirror => {
                let m = i.rem_euclid(2 * n);
                (if m < n { m } else { 2 * n - 1 - m }) as usize
            }
        }
    }
}

/// Filters rows with `along_x`, then columns with `along_y`, both of odd length and centred. The kernels are applied as
/// they stand (correlation).
pub(super) fn separable(plane: &[f32], width: usize, along_x: &[f32], along_y: &[f32], border: Border) -> Vec<f32> {
    let height = plane.len() / width;
    let mut rows = vec![0.0f32; plane.len()];
    let radius = along_x.len() / 2;
    rows.par_chunks_mut(width).zip(plane.par_chunks(width)).for_each(|(out, line)| {
        let padded: Vec<f32> =
            (0..width + 2 * radius).map(|i| line[border.index(i as isize - radius as isize, width)]).collect();
        for (x, out) in out.iter_mut().enumerate() {
            *out = padded[x..].iter().zip(along_x).map(|(v, k)| v * k).sum();
        }
    });
    let mut out = vec![0.0f32; plane.len()];
    let radius = along_y.len() / 2;
    out.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        for (j, k) in along_y.iter().enumerate() {
            let source = border.index(y as isize + j as isize - radius as isize, height) * width;
            out.iter_mut().zip(&rows[source..source + width]).for_each(|(o, v)| *o += k * v);
        }
    });
    out
}
