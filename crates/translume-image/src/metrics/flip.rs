//! FLIP: the difference a viewer sees when flipping between two pictures.
//!
//! Andersson et al., FLIP: A Difference Evaluator for Alternating Images (HPG 2020), and for HDR Andersson et al.,
//! Visualizing Errors in Rendered High Dynamic Range Images (Eurographics short papers 2021), with the ACES tone mapper.
//! Every filter is separable; the blue–yellow one is the sum of two Gaussians and runs as two.

use super::convolve::{Border, separable};
use crate::colour::{self, Matrix, Space};
use rayon::prelude::*;

/// Exponent and remap of colour differences (2020, §4.1): q_c, p_c, p_t.
const Q_C: f32 = 0.7;
const P_C: f32 = 0.4;
const P_T: f32 = 0.95;
/// Width of the feature detectors in degrees and the exponent of feature differences (2020, §4.2): w, q_f.
const FEATURE_WIDTH_DEG: f32 = 0.082;
const Q_F: f32 = 0.5;

/// FLIP value of each pixel, 0 (no difference seen) to 1.
#[derive(Clone, Debug)]
pub struct FlipMap {
    /// Row by row from the top.
    pub values: Vec<f32>,
    /// Exposures in stops that the HDR variant looked at: first, last, number.
    pub exposures: Option<(f32, f32, usize)>,
}

impl FlipMap {
    /// The mean over all pixels: the usual single number.
    pub fn mean(&self) -> f64 {
        self.values.iter().map(|v| f64::from(*v)).sum::<f64>() / self.values.len().max(1) as f64
    }
}

/// Pixels per degree seen from `distance_m` on a screen `width_m` wide with `width_px` pixels. The published default,
/// 0.7 m from a 3840-pixel screen of 0.7 m, is 67.02.
pub fn flip_ppd(distance_m: f64, width_m: f64, width_px: f64) -> f64 {
    distance_m * (width_px / width_m) * std::f64::consts::PI / 180.0
}

/// FLIP of two display pictures: interleaved linear Rec. 709, clipped to [0, 1] (decode sRGB first).
pub fn flip_ldr(reference: &[f32], test: &[f32], width: usize, ppd: f64) -> FlipMap {
    assert_eq!(reference.len(), test.len(), "pictures of one size");
    let filters = Filters::new(ppd as f32);
    FlipMap { values: filters.compare(reference, test, width), exposures: None }
}

/// FLIP of two HDR pictures in linear Rec. 709: the largest LDR value over exposures from where the brightest pixel of
/// the reference is just not clipped to where its median is.
pub fn flip_hdr(reference: &[f32], test: &[f32], width: usize, ppd: f64) -> FlipMap {
    assert_eq!(reference.len(), test.len(), "pictures of one size");
    let (start, stop) = exposure_range(reference);
    let count = 2.max((stop - start).ceil() as usize);
    let filters = Filters::new(ppd as f32);
    let mut values = vec![0.0f32; reference.len() / 3];
    for i in 0..count {
        let exposure = (start + (stop - start) * i as f32 / (count - 1) as f32).exp2();
        let shown = |v: &[f32]| v.par_iter().map(|v| aces(v * exposure)).collect::<Vec<f32>>();
        let at_exposure = filters.compare(&shown(reference), &shown(test), width);
        values.iter_mut().zip(at_exposure).for_each(|(v, w)| *v = v.max(w));
    }
    FlipMap { values, exposures: Some((start, stop, count)) }
}

/// Numerator and denominator of the ACES curve as the paper fits it, highest power first.
const ACES: [f32; 6] = [0.6 * 0.6 * 2.51, 0.6 * 0.03, 0.0, 0.6 * 0.6 * 2.43, 0.6 * 0.59, 0.14];

fn aces(x: f32) -> f32 {
    let x = x.clamp(0.0, 1e9); // beyond, squares overflow; the curve is flat long before
    let [a, b, c, d, e, f] = ACES;
    (((a * x + b) * x + c) / ((d * x + e) * x + f)).clamp(0.0, 1.0)
}

/// First and last exposure in stops (2021, §3): the curve reaches t = 0.85 at the maximum and at the median luminance.
fn exposure_range(reference: &[f32]) -> (f32, f32) {
    const T: f32 = 0.85;
    let [a, b, c, d, e, f] = ACES;
    let (a, b, c) = (a - T * d, b - T * e, c - T * f);
    let x_max = (-b + (b * b - 4.0 * a * c).sqrt()) / (2.0 * a);
    let weights = [0.2126, 0.7152, 0.0722]; // rounded, as in the published program: the range shifts by 2e-4 stops
    let mut lum: Vec<f32> =
        reference.as_chunks::<3>().0.iter().map(|p| (0..3).map(|c| weights[c] * p[c]).sum()).collect();
    lum.retain(|l| l.is_finite());
    if lum.is_empty() {
        return (0.0, 0.0);
    }
    let brightest = lum.iter().copied().fold(0.0f32, f32::max).max(1e-5);
    // The published program takes the upper of two middle values.
    let middle = lum.len() / 2;
    let median = lum.select_nth_unstable_by(middle, f32::total_cmp).1.max(1e-5);
    ((x_max / brightest).log2(), (x_max / median).log2())
}

/// The filters for one viewing distance.
struct Filters {
    /// Contrast sensitivity of the achromatic, red–green and blue–yellow channels: per channel, Gaussians with weight.
    spatial: [Vec<(f32, Vec<f32>)>; 3],
    /// Gaussian, first and second derivative for the feature detectors.
    gauss: Vec<f32>,
    edge: Vec<f32>,
    point: Vec<f32>,
}

impl Filters {
    fn new(ppd: f32) -> Self {
        // a1, b1, a2, b2 of 2020, Table 1.
        let terms = [[1.0f32, 0.0047, 0.0, 1e-5], [1.0, 0.0053, 0.0, 1e-5], [34.1, 0.04, 13.5, 0.025]];
        let pi = std::f32::consts::PI;
        let radius = (3.0 * (0.04 / (2.0 * pi * pi)).sqrt() * ppd).ceil() as i32;
        let spatial = terms.map(|[a1, b1, a2, b2]| {
            let parts = [(a1, b1), (a2, b2)].map(|(a, b)| {
                let kernel: Vec<f32> = (-radius..=radius).map(|i| (-(pi * i as f32 / ppd).powi(2) / b).exp()).collect();
                let sum: f32 = kernel.iter().sum();
                // In two dimensions the weight of a Gaussian is its amplitude times its sum squared.
                (a * (pi / b).sqrt() * sum * sum, kernel.iter().map(|k| k / sum).collect::<Vec<f32>>())
            });
            let total: f32 = parts.iter().map(|p| p.0).sum();
            parts.into_iter().filter(|p| p.0 > 0.0).map(|(w, k)| (w / total, k)).collect()
        });
        let sigma = 0.5 * FEATURE_WIDTH_DEG * ppd;
        let radius = (3.0 * sigma).ceil() as i32;
        let shape = |f: &dyn Fn(f32, f32) -> f32| -> Vec<f32> {
            (-radius..=radius).map(|i| f(i as f32, (-((i * i) as f32) / (2.0 * sigma * sigma)).exp())).collect()
        };
        let mut gauss = shape(&|_, g| g);
        let sum: f32 = gauss.iter().sum();
        gauss.iter_mut().for_each(|v| *v /= sum);
        Self {
            spatial,
            gauss,
            edge: balanced(shape(&|x, g| -x * g)),
            point: balanced(shape(&|x, g| (x * x / (sigma * sigma) - 1.0) * g)),
        }
    }

    /// FLIP values of two pictures in linear RGB.
    fn compare(&self, reference: &[f32], test: &[f32], width: usize) -> Vec<f32> {
        let opponent = Opponent::new();
        let (r, t) = (opponent.planes(reference), opponent.planes(test));
        let colour = self.colour_difference(&opponent, &r, &t, width);
        let feature = self.feature_difference(&r[0], &t[0], width);
        // 2020, Eq. 13: features make colour differences count more.
        colour.par_iter().zip(feature).with_min_len(4096).map(|(c, f)| c.powf(1.0 - f)).collect()
    }

    fn colour_difference(&self, o: &Opponent, r: &[Vec<f32>; 3], t: &[Vec<f32>; 3], width: usize) -> Vec<f32> {
        let filtered = |p: &[Vec<f32>; 3]| -> Vec<[f32; 3]> {
            let planes: [Vec<f32>; 3] = std::array::from_fn(|c| {
                let mut sum = vec![0.0f32; p[c].len()];
                for (weight, kernel) in &self.spatial[c] {
                    let blurred = separable(&p[c], width, kernel, kernel, Border::Repeat);
                    sum.iter_mut().zip(blurred).for_each(|(s, v)| *s += weight * v);
                }
                sum
            });
            (0..planes[0].len()).map(|i| [planes[0][i], planes[1][i], planes[2][i]]).collect()
        };
        let (r, t) = (filtered(r), filtered(t));
        let largest = hyab(o.hunt_lab([0.0, 1.0, 0.0]), o.hunt_lab([0.0, 0.0, 1.0])).powf(Q_C);
        r.par_iter()
            .zip(&t)
            .with_min_len(1024)
            .map(|(r, t)| {
                let lab = |v: &[f32; 3]| o.hunt_lab(o.to_rgb(*v).map(|v| v.clamp(0.0, 1.0)));
                let d = hyab(lab(r), lab(t)).powf(Q_C);
                let knee = P_C * largest;
                if d < knee { d * P_T / knee } else { P_T + (d - knee) / (largest - knee) * (1.0 - P_T) }
            })
            .collect()
    }

    fn feature_difference(&self, r: &[f32], t: &[f32], width: usize) -> Vec<f32> {
        // Detectors work on the luminance scaled to [0, 1].
        let unit = |v: &[f32]| v.iter().map(|v| (v + 16.0) / 116.0).collect::<Vec<f32>>();
        let (r, t) = (unit(r), unit(t));
        let strength = |v: &[f32], kernel: &[f32]| -> Vec<f32> {
            let x = separable(v, width, kernel, &self.gauss, Border::Repeat);
            let y = separable(v, width, &self.gauss, kernel, Border::Repeat);
            x.iter().zip(y).map(|(x, y)| x.hypot(y)).collect()
        };
        let (re, te) = (strength(&r, &self.edge), strength(&t, &self.edge));
        let (rp, tp) = (strength(&r, &self.point), strength(&t, &self.point));
        (0..r.len())
            .map(|i| {
                let d = (re[i] - te[i]).abs().max((rp[i] - tp[i]).abs());
                (d * std::f32::consts::FRAC_1_SQRT_2).powf(Q_F)
            })
            .collect()
    }
}

/// Scales positive weights to the sum 1 and negative ones to −1.
fn balanced(mut kernel: Vec<f32>) -> Vec<f32> {
    let positive: f32 = kernel.iter().filter(|v| **v > 0.0).sum();
    let negative: f32 = -kernel.iter().filter(|v| **v < 0.0).sum::<f32>();
    kernel.iter_mut().for_each(|v| *v /= if *v > 0.0 { positive } else { negative });
    kernel
}

/// HyAB: city block in lightness, Euclidean in chroma.
fn hyab(a: [f32; 3], b: [f32; 3]) -> f32 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
}

/// Conversions to the opponent space YCxCz and to Hunt-adjusted L*a*b*, both under the white of Rec. 709.
struct Opponent {
    /// XYZ over white from linear RGB, and back.
    relative: Matrix,
    inverse: Matrix,
}

impl Opponent {
    fn new() -> Self {
        let to_xyz = Space::REC709.rgb_to_xyz();
        let white = colour::product_vec(&to_xyz, [1.0; 3]);
        let relative = std::array::from_fn(|i| to_xyz[i].map(|v| v / white[i]));
        Self { relative, inverse: colour::inverse(&relative).expect("a regular matrix") }
    }

    fn planes(&self, rgb: &[f32]) -> [Vec<f32>; 3] {
        let pixels: Vec<[f32; 3]> = rgb
            .as_chunks::<3>()
            .0
            .iter()
            .map(|p| {
                let [x, y, z] = colour::apply(&self.relative, p.map(|v| v.clamp(0.0, 1.0)));
                [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
            })
            .collect();
        std::array::from_fn(|c| pixels.iter().map(|p| p[c]).collect())
    }

    fn to_rgb(&self, [y, cx, cz]: [f32; 3]) -> [f32; 3] {
        let y = (y + 16.0) / 116.0;
        colour::apply(&self.inverse, [y + cx / 500.0, y, y - cz / 200.0])
    }

    fn hunt_lab(&self, rgb: [f32; 3]) -> [f32; 3] {
        let relative = colour::apply(&self.relative, rgb).map(f64::from);
        let [l, a, b] = colour::xyz_to_lab(relative, [1.0; 3]).map(|v| v as f32);
        [l, 0.01 * l * a, 0.01 * l * b]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::samples;

    /// Means and three pixels from the published implementation (flip-evaluator 1.7).
    fn check(map: &FlipMap, mean: f64, pixels: [f32; 3]) {
        assert!((map.mean() - mean).abs() < 1e-3, "{} instead of {mean}", map.mean());
        for ((x, y), expected) in [(15, 12), (0, 0), (40, 30)].into_iter().zip(pixels) {
            let got = map.values[y * samples::SIZE.0 + x];
            assert!((got - expected).abs() < 1e-3, "({x}, {y}): {got} instead of {expected}");
        }
    }

    #[test]
    fn ldr_agrees_with_the_published_implementation() {
        let (a, b) = samples::pair();
        let linear = |v: Vec<f32>| v.into_iter().map(colour::srgb_to_linear).collect::<Vec<f32>>();
        let (a, b) = (linear(a), linear(b));
        let ppd = flip_ppd(0.7, 0.7, 3840.0);
        check(&flip_ldr(&a, &b, samples::SIZE.0, ppd), 0.194_123_27, [0.773_548_5, 0.172_135_65, 0.109_558_48]);
        check(&flip_ldr(&a, &b, samples::SIZE.0, 30.0), 0.236_675_58, [0.959_565_1, 0.219_082_6, 0.190_640_2]);
        assert_eq!(flip_ldr(&a, &a, samples::SIZE.0, ppd).mean(), 0.0);
    }

    #[test]
    fn hdr_agrees_with_the_published_implementation() {
        let (a, b) = samples::hdr_pair();
        let map = flip_hdr(&a, &b, samples::SIZE.0, flip_ppd(0.7, 0.7, 3840.0));
        let (start, stop, count) = map.exposures.unwrap();
        assert!((start + 2.114_170_8).abs() < 1e-4 && (stop - 0.056_489_38).abs() < 1e-4, "{start} {stop}");
        assert_eq!(count, 3);
        check(&map, 0.212_822_0, [0.835_011_54, 0.141_057_39, 0.128_312_53]);
    }
}
