//! Two pictures compared: every measure at once, and difference pictures.

use crate::metrics::{self, FlipMap};
use crate::tonemap::{Display, exposure_gamma};
use crate::{Error, Picture, Result, write_png8};
use std::path::{Path, PathBuf};

/// How to look at the pictures.
#[derive(Clone, Copy, Debug)]
pub struct CompareParams {
    /// Whether values above 1 are light to be seen at other exposures (FLIP's HDR variant) or are clipped.
    pub hdr: bool,
    /// Pixels per degree of visual angle.
    pub ppd: f64,
    /// What a value of 1 stands for in cd/m², for PU21 only.
    pub cd_m2: f64,
}

impl Default for CompareParams {
    fn default() -> Self {
        Self { hdr: true, ppd: metrics::flip_ppd(0.7, 0.7, 3840.0), cd_m2: 100.0 }
    }
}

/// All measures of one pair. Those "of display values" clip linear light to [0, 1] and encode it as sRGB.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Root mean squared difference of linear light.
    pub rmse: f64,
    /// Mean of (test − reference)² / (reference² + 0.01).
    pub rel_mse: f64,
    /// PSNR in dB of display values; infinite for equal ones.
    pub psnr: f64,
    /// PSNR in dB after the µ-law, peak at the reference's 99.9th percentile.
    pub psnr_mu: f64,
    /// PSNR in dB of PU21-encoded light.
    pub pu21_psnr: f64,
    /// SSIM of display values.
    pub ssim: f64,
    /// Mean and largest CIEDE2000 of light clipped to [0, 1].
    pub delta_e: (f64, f64),
    /// FLIP, HDR or LDR as asked for.
    pub flip: FlipMap,
}

/// Measures `test` against `reference`.
///
/// # Errors
/// [`Error::Mismatch`] for pictures of different size, without pixels, or with NaN or infinite values.
pub fn compare(reference: &Picture, test: &Picture, params: &CompareParams) -> Result<Comparison> {
    let (size, other) = (reference.pixels.dimensions(), test.pixels.dimensions());
    if size != other {
        let message = format!("{} × {} and {} × {} pixels cannot be compared", size.0, size.1, other.0, other.1);
        return Err(Error::Mismatch(message));
    }
    if size.0 == 0 || size.1 == 0 || reference.count_non_finite() + test.count_non_finite() > 0 {
        return Err(Error::Mismatch("pictures without pixels or with NaN or infinite values have no distance".into()));
    }
    let (a, b) = (reference.pixels.as_raw().as_slice(), test.pixels.as_raw().as_slice());
    let width = size.0 as usize;
    let (shown_a, shown_b) = (exposure_gamma(reference, 0.0, None).rgb, exposure_gamma(test, 0.0, None).rgb);
    let clipped = |v: &[f32]| v.iter().map(|v| v.clamp(0.0, 1.0)).collect::<Vec<f32>>();
    let delta_e = metrics::delta_e_2000_map(&clipped(a), &clipped(b));
    let flip = if params.hdr { metrics::flip_hdr } else { metrics::flip_ldr };
    Ok(Comparison {
        rmse: metrics::rmse(a, b),
        rel_mse: metrics::rel_mse(a, b, 0.01),
        psnr: metrics::psnr(&shown_a, &shown_b, 1.0),
        psnr_mu: metrics::psnr_mu(a, b, metrics::top_percentile(a).max(1e-12)),
        pu21_psnr: metrics::pu21_psnr(a, b, params.cd_m2),
        ssim: metrics::ssim(&shown_a, &shown_b, width, 1.0),
        delta_e: (
            delta_e.iter().map(|v| f64::from(*v)).sum::<f64>() / delta_e.len() as f64,
            delta_e.iter().map(|v| f64::from(*v)).fold(0.0, f64::max),
        ),
        flip: flip(a, b, width, params.ppd),
    })
}

impl Comparison {
    /// Name, value and meaning of each measure, in the order of a report. Names are those of `--json`.
    pub fn rows(&self) -> [(&'static str, f64, &'static str); 10] {
        let flip_max = self.flip.values.iter().map(|v| f64::from(*v)).fold(0.0, f64::max);
        [
            ("rmse", self.rmse, "root mean squared difference of linear light"),
            ("rel_mse", self.rel_mse, "mean of squared difference over squared reference + 0.01"),
            ("psnr", self.psnr, "dB, display values"),
            ("psnr_mu", self.psnr_mu, "dB, after the µ-law with µ = 5000"),
            ("pu21_psnr", self.pu21_psnr, "dB, perceptually uniform luminance"),
            ("ssim", self.ssim, "structural similarity of display values, 1 is equal"),
            ("delta_e_mean", self.delta_e.0, "CIEDE2000, mean"),
            ("delta_e_max", self.delta_e.1, "CIEDE2000, largest"),
            ("flip_mean", self.flip.mean(), "FLIP, mean; 0 is equal, 1 the most"),
            ("flip_max", flip_max, "FLIP, largest"),
        ]
    }
}

/// The pictures of [`write_pictures`], in the order in which it returns them, and what they show.
pub const PICTURES: [(&str, &str); 5] = [
    ("reference.png", "reference"),
    ("test.png", "test"),
    ("side-by-side.png", "reference and test side by side"),
    ("flip.png", "FLIP: dark is equal, bright is different"),
    ("difference.png", "red: the test is brighter; blue: darker; full colour from a quarter of the range on"),
];

/// Writes [`PICTURES`] into `folder` (made if it is not there): both pictures at one exposure, also side by side, the FLIP map
/// and the signed difference. Returns the files and the exposure, in stops.
///
/// # Errors
/// [`Error::Io`].
pub fn write_pictures(
    folder: &Path,
    (reference, test): (&Picture, &Picture),
    comparison: &Comparison,
) -> Result<(Vec<PathBuf>, f32)> {
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
    let ev = common_exposure(reference);
    let (a, b) = (exposure_gamma(reference, ev, None), exposure_gamma(test, ev, None));
    let size = (a.width, a.height);
    let (width, pair) = side_by_side(&a, &b);
    let flip: Vec<u8> = comparison.flip.values.iter().flat_map(|v| metrics::magma(*v)).collect();
    let contents = [
        (size, a.to_u8()),
        (size, b.to_u8()),
        ((width, a.height), pair),
        (size, flip),
        (size, signed_difference(&a, &b)),
    ];
    let files: Vec<PathBuf> = PICTURES.iter().map(|(name, _)| folder.join(name)).collect();
    files.iter().zip(contents).try_for_each(|(file, (size, rgb))| write_png8(file, size, &rgb))?;
    Ok((files, ev))
}

/// Stops by which both pictures are brightened: 0 where the reference suits a display, else its 99.9th percentile
/// becomes white.
fn common_exposure(reference: &Picture) -> f32 {
    let top = metrics::top_percentile(reference.pixels.as_raw()) as f32;
    if !(1e-30..1e30).contains(&top) || (0.25..=1.0).contains(&top) { 0.0 } else { -top.log2() }
}

/// Both pictures in one, four gray columns between them.
fn side_by_side(a: &Display, b: &Display) -> (usize, Vec<u8>) {
    let (left, right) = (a.to_u8(), b.to_u8());
    let rows = left.chunks_exact(3 * a.width).zip(right.chunks_exact(3 * b.width));
    (2 * a.width + 4, rows.flat_map(|(l, r)| [l, &[128; 12], r].concat()).collect())
}

/// Mean difference of the display values: red where the test is brighter, blue where it is darker, white where both are
/// equal; full colour from a quarter of the range on.
fn signed_difference(a: &Display, b: &Display) -> Vec<u8> {
    let pairs = a.rgb.as_chunks::<3>().0.iter().zip(b.rgb.as_chunks::<3>().0);
    pairs
        .flat_map(|(p, q)| {
            let d = (0..3).map(|c| q[c] - p[c]).sum::<f32>() / 3.0;
            let rest = (255.0 * (1.0 - (4.0 * d.abs()).min(1.0))).round() as u8;
            if d > 0.0 { [255, rest, rest] } else { [rest, rest, 255] }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, Rgb32FImage};

    fn gray(v: f32) -> Picture {
        Picture::new(Rgb32FImage::from_pixel(20, 16, Rgb([v; 3])))
    }

    #[test]
    fn equal_pictures_are_at_no_distance_and_are_shown() {
        let found = compare(&gray(0.3), &gray(0.3), &CompareParams::default()).unwrap();
        assert_eq!((found.rmse, found.rel_mse, found.flip.mean(), found.delta_e.1), (0.0, 0.0, 0.0, 0.0));
        assert_eq!(found.psnr, f64::INFINITY);
        let dir = tempfile::tempdir().unwrap();
        let (files, ev) = write_pictures(dir.path(), (&gray(0.3), &gray(0.3)), &found).unwrap();
        assert!(files.len() == PICTURES.len() && files.iter().all(|f| f.is_file()) && ev == 0.0);
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        let small = Picture::new(Rgb32FImage::new(19, 16));
        assert!(compare(&gray(0.3), &small, &CompareParams::default()).is_err());
        assert!(compare(&gray(0.3), &gray(f32::NAN), &CompareParams::default()).is_err());
    }

    #[test]
    fn colours_of_the_difference_tell_its_sign() {
        let (dark, bright) = (exposure_gamma(&gray(0.2), 0.0, None), exposure_gamma(&gray(0.3), 0.0, None));
        let brighter = signed_difference(&dark, &bright);
        let darker = signed_difference(&bright, &dark);
        assert!(brighter[0] == 255 && brighter[2] < 255 && darker[0] < 255 && darker[2] == 255);
        assert_eq!(signed_difference(&dark, &dark)[..3], [255; 3]);
    }
}
