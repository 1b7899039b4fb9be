//! How far two pictures are apart. The first argument is the reference wherever the order matters.
//!
//! Functions take interleaved RGB slices of equal length; what they hold (linear, display-encoded, cd/m²) is said at
//! each. Sums are kept in f64. NaN in an input gives NaN out: count them first.

mod convolve;
mod delta_e;
mod error_sums;
mod flip;
mod magma;
mod pu21;
mod ssim;

pub use delta_e::{delta_e_2000, delta_e_2000_map};
pub use error_sums::{psnr, psnr_mu, rel_mse, rmse, top_percentile};
pub use flip::{FlipMap, flip_hdr, flip_ldr, flip_ppd};
pub use magma::magma;
pub use pu21::{pu21_decode, pu21_encode, pu21_psnr};
pub use ssim::ssim;

#[cfg(test)]
pub(crate) mod samples {
    //! The pictures that the reference implementations were run on: 48 × 40, display values in [0, 1].

    pub(crate) const SIZE: (usize, usize) = (48, 40);

    pub(crate) fn pair() -> (Vec<f32>, Vec<f32>) {
        let (mut a, mut b) = (Vec::new(), Vec::new());
        for y in 0..SIZE.1 {
            for x in 0..SIZE.0 {
                for c in 0..3 {
                    let phase = 0.31 * x as f64 * (c + 1) as f64 * 0.7 + 0.17 * y as f64 + c as f64;
                    let v = (0.5 + 0.4 * phase.sin()) as f32;
                    let hash = (((y * SIZE.0 + x) * 3 + c) as u64 * 2_654_435_761 % (1 << 32)) >> 8;
                    let noisy = (f64::from(v) + 0.1 * hash as f64 / 16_777_216.0 - 0.05).clamp(0.0, 1.0) as f32;
                    a.push(v);
                    b.push(if (8..16).contains(&y) && (10..20).contains(&x) { 1.0 - v } else { noisy });
                }
            }
        }
        (a, b)
    }

    /// The same over eight stops.
    pub(crate) fn hdr_pair() -> (Vec<f32>, Vec<f32>) {
        let (a, b) = pair();
        let expand = |v: Vec<f32>| v.iter().map(|v| (8.0 * v - 4.0).exp2()).collect();
        (expand(a), expand(b))
    }
}
