//! Structural similarity (Wang et al. 2004): 11 × 11 Gaussian window of σ = 1.5, K1 = 0.01, K2 = 0.03, population
//! covariances, mean over the channels and over the pixels whose window lies inside (smaller pictures: over all).

use super::convolve::{Border, separable};

const RADIUS: usize = 5;

/// Mean SSIM of display-encoded RGB with values from 0 to `range`; 1 for equal pictures.
pub fn ssim(reference: &[f32], test: &[f32], width: usize, range: f64) -> f64 {
    assert_eq!(reference.len(), test.len(), "pictures of one size");
    if reference.is_empty() {
        return 1.0;
    }
    (0..3).map(|c| of_channel(reference, test, c, width, range)).sum::<f64>() / 3.0
}

fn of_channel(reference: &[f32], test: &[f32], channel: usize, width: usize, range: f64) -> f64 {
    let kernel = gaussian();
    let blur = |v: &[f32]| separable(v, width, &kernel, &kernel, Border::Mirror);
    // Differences from the channel's mean keep the variances exact in f32.
    let centre = reference.iter().skip(channel).step_by(3).sum::<f32>() / (reference.len() / 3) as f32;
    let plane = |v: &[f32]| v.iter().skip(channel).step_by(3).map(|v| v - centre).collect::<Vec<f32>>();
    let products = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<f32>>();
    let (a, b) = (plane(reference), plane(test));
    let (mean_a, mean_b) = (blur(&a), blur(&b));
    let (aa, bb, ab) = (blur(&products(&a, &a)), blur(&products(&b, &b)), blur(&products(&a, &b)));
    let (c1, c2) = ((0.01 * range).powi(2), (0.03 * range).powi(2));
    let index = |i: usize| {
        let (ma, mb) = (f64::from(mean_a[i]), f64::from(mean_b[i]));
        let (va, vb) = (f64::from(aa[i]) - ma * ma, f64::from(bb[i]) - mb * mb);
        let covariance = f64::from(ab[i]) - ma * mb;
        let (ma, mb) = (ma + f64::from(centre), mb + f64::from(centre));
        (2.0 * ma * mb + c1) * (2.0 * covariance + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2))
    };
    let height = a.len() / width;
    let inner = |n: usize| if n > 2 * RADIUS { RADIUS..n - RADIUS } else { 0..n };
    let (rows, columns) = (inner(height), inner(width));
    let count = rows.len() * columns.len();
    rows.flat_map(|y| columns.clone().map(move |x| y * width + x)).map(index).sum::<f64>() / count as f64
}

fn gaussian() -> Vec<f32> {
    let weights: Vec<f64> = (-(RADIUS as i32)..=RADIUS as i32).map(|i| (-f64::from(i * i) / 4.5).exp()).collect();
    let sum: f64 = weights.iter().sum();
    weights.iter().map(|w| (w / sum) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::samples;

    #[test]
    fn agrees_with_scikit_image() {
        // skimage 0.26: structural_similarity(a, b, channel_axis=2, data_range=1, gaussian_weights=True, sigma=1.5,
        // use_sample_covariance=False).
        let (a, b) = samples::pair();
        let got = ssim(&a, &b, samples::SIZE.0, 1.0);
        assert!((got - 0.832_260_420).abs() < 1e-5, "{got}");
        assert!((ssim(&a, &a, samples::SIZE.0, 1.0) - 1.0).abs() < 1e-12);
    }
}
