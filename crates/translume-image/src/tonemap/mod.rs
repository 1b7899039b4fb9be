//! From linear light to a display: three operators, one result type.

mod fattal;
mod poisson;
mod simple;

pub use fattal::{FattalParams, fattal};
pub use poisson::solve_neumann;
pub use simple::{ReinhardParams, exposure_gamma, reinhard_global};

/// A picture for a display: encoded values in [0, 1], interleaved RGB.
#[derive(Clone, Debug, PartialEq)]
pub struct Display {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `3 * width * height` encoded values.
    pub rgb: Vec<f32>,
}

impl Display {
    /// 8-bit codes, rounded.
    pub fn to_u8(&self) -> Vec<u8> {
        self.rgb.iter().map(|v| (v * 255.0 + 0.5) as u8).collect()
    }

    /// 16-bit codes, rounded.
    pub fn to_u16(&self) -> Vec<u16> {
        self.rgb.iter().map(|v| (v * 65535.0 + 0.5) as u16).collect()
    }
}

/// Luminance of Rec. 709 pixels, negative and NaN as 0, infinite as the largest float.
fn luminance(rgb: &[f32]) -> Vec<f32> {
    use rayon::prelude::*;
    let [wr, wg, wb] = crate::colour::Space::REC709.luminance_weights().map(|w| w as f32);
    let pixels = rgb.as_chunks::<3>().0;
    pixels
        .par_iter()
        .with_min_len(1 << 14)
        .map(|p| wr * p[0] + wg * p[1] + wb * p[2])
        .map(|l| if l > 0.0 { l.min(f32::MAX) } else { 0.0 })
        .collect()
}

/// The value below which a share `q` of `values` lies.
fn percentile(values: &[f32], q: f64) -> f32 {
    let mut v = values.to_vec();
    if v.is_empty() {
        return 0.0;
    }
    let k = ((v.len() - 1) as f64 * q).round() as usize;
    *v.select_nth_unstable_by(k, f32::total_cmp).1
}
