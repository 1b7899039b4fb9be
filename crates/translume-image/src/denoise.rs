//! Takes noise out of rendered pictures: joint non-local means.
//!
//! Source: Rousselle, Knaus, Zwicker 2012 (patch distances with the variance of the pixels taken out) and 2013 (features of
//! the first surface as a second vote; the smaller weight counts). The picture is divided by the albedo first, so that
//! textures stay. Deviations: features are taken for free of noise; one pass, without the error estimate that chooses among
//! several; variances are not below the median of 3 × 3 pixels; the two pixels count by themselves, too.
//!
//! Limits: what the features do not show and the noise hides (soft shadows, caustics of few samples) is blurred; noise that
//! neighbouring pixels share (`gkernel`, `photonmap`) is larger than its variance per pixel says and stays in part.

use rayon::prelude::*;
use std::ops::Range;

/// What is known of a rendered picture: planes of `width` × `height`, row after row.
#[derive(Clone, Debug)]
pub struct Noisy<'a> {
    /// Width and height.
    pub size: (usize, usize),
    /// Linear light.
    pub rgb: [&'a [f32]; 3],
    /// Variance of each value of `rgb` (of the mean of the samples, not of one).
    pub variance: [&'a [f32]; 3],
    /// Albedo of the first surface.
    pub albedo: Option<[&'a [f32]; 3]>,
    /// Its normal.
    pub normal: Option<[&'a [f32]; 3]>,
    /// Its distance.
    pub depth: Option<&'a [f32]>,
}

/// How much is smoothed.
#[derive(Clone, Copy, Debug)]
pub struct DenoiseParams {
    /// Pixels to each side that are averaged.
    pub radius: usize,
    /// Patches may differ by so many standard deviations.
    pub strength: f32,
}

impl Default for DenoiseParams {
    fn default() -> Self {
        Self { radius: 8, strength: 0.6 }
    }
}

/// Half size of the patches that are compared.
const PATCH: usize = 3;

/// How much the two pixels themselves count beside their patches: keeps one bright sample from its neighbours.
const ALONE: f32 = 0.1;

/// Rows of a task.
const BAND: usize = 24;

/// Features may differ by this share of their scale.
const FEATURE: f32 = 0.6;

/// Smallest squared gradient of a feature that counts.
const FLAT: f32 = 1e-3;

/// Added to the albedo before it divides.
const DARK: f32 = 0.02;

/// The picture without noise, three planes.
///
/// # Panics
/// If the planes are not of the size that `noisy` says.
pub fn non_local_means(noisy: &Noisy, params: &DenoiseParams) -> [Vec<f32>; 3] {
    let (width, height) = noisy.size;
    let shade = |c: usize, i: usize| noisy.albedo.map_or(1.0, |a| a[c][i].max(0.0) + DARK);
    let plane =
        |value: &(dyn Fn(usize) -> f32 + Sync)| (0..width * height).into_par_iter().map(value).collect::<Vec<f32>>();
    let light: [Vec<f32>; 3] = [0, 1, 2].map(|c| plane(&|i| finite(noisy.rgb[c][i]) / shade(c, i)));
    let variance: [Vec<f32>; 3] = [0, 1, 2].map(|c| {
        let own = plane(&|i| finite(noisy.variance[c][i]).max(0.0) / shade(c, i).powi(2));
        steady(&own, noisy.size)
    });
    let features = features(noisy);
    let bands: Vec<usize> = (0..height).step_by(BAND).collect();
    let parts: Vec<[Vec<f32>; 3]> = bands
        .par_iter()
        .map(|&y| {
            let band = Band { size: noisy.size, rows: y..(y + BAND).min(height), params };
            band.smooth(&light, &variance, &features)
        })
        .collect();
    [0, 1, 2].map(|c| {
        let smooth = parts.iter().flat_map(|p| p[c].iter());
        smooth.enumerate().map(|(i, v)| v * shade(c, i)).collect()
    })
}

fn finite(v: f32) -> f32 {
    if v.is_finite() { v } else { 0.0 }
}

/// A plane with one over the squared difference that counts as one.
type Feature = (Vec<f32>, Vec<f32>);

fn features(noisy: &Noisy) -> Vec<Feature> {
    let mut planes: Vec<Vec<f32>> = Vec::new();
    for rgb in [noisy.albedo, noisy.normal].into_iter().flatten() {
        planes.extend(rgb.map(|p| p.iter().map(|v| finite(*v)).collect()));
    }
    // Distances by their ratios.
    planes.extend(noisy.depth.map(|p| p.iter().map(|v| finite(*v).max(1e-6).ln()).collect()));
    let (width, height) = noisy.size;
    let scaled = |plane: Vec<f32>| {
        let at = |x: usize, y: usize| plane[y * width + x];
        let inverse = |i: usize| {
            let (x, y) = (i % width, i / width);
            let dx = at((x + 1).min(width - 1), y) - at(x.saturating_sub(1), y);
            let dy = at(x, (y + 1).min(height - 1)) - at(x, y.saturating_sub(1));
            1.0 / (FEATURE * FEATURE * (0.25 * (dx * dx + dy * dy)).max(FLAT))
        };
        let inverses = (0..width * height).map(inverse).collect();
        (plane, inverses)
    };
    planes.into_iter().map(scaled).collect()
}

/// Variances of few samples are noisy themselves: at least the median of 3 × 3 pixels, which one bright sample in the
/// neighbourhood does not change.
fn steady(plane: &[f32], (width, height): (usize, usize)) -> Vec<f32> {
    let of = |i: usize| {
        let (x, y) = (i % width, i / width);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        let mut near = [0.0; 9];
        let mut count = 0;
        for v in (y.saturating_sub(1)..(y + 2).min(height))
            .flat_map(|y| &plane[y * width + columns.start..y * width + columns.end])
        {
            near[count] = *v;
            count += 1;
        }
        let (_, median, _) = near[..count].select_nth_unstable_by(count / 2, f32::total_cmp);
        plane[i].max(*median)
    };
    (0..plane.len()).into_par_iter().map(of).collect()
}

/// Rows that one task smooths.
struct Band<'a> {
    size: (usize, usize),
    rows: Range<usize>,
    params: &'a DenoiseParams,
}

impl Band<'_> {
    fn smooth(&self, light: &[Vec<f32>; 3], variance: &[Vec<f32>; 3], features: &[Feature]) -> [Vec<f32>; 3] {
        let (width, height) = self.size;
        let n = self.rows.len() * width;
        let mut sums = [vec![0.0_f32; n], vec![0.0_f32; n], vec![0.0_f32; n]];
        let mut weights = vec![0.0_f32; n];
        // Rows of patches around the band.
        let outer = self.rows.start.saturating_sub(PATCH)..(self.rows.end + PATCH).min(height);
        // Differences of a row with nothing around them, and their sums along the patch's rows.
        let mut line = vec![0.0_f32; width + 2 * PATCH];
        let mut along = vec![0.0_f32; outer.len() * width];
        let r = self.params.radius as isize;
        for (dy, dx) in (-r..=r).flat_map(|dy| (-r..=r).map(move |dx| (dy, dx))) {
            // Pixels that are inside the picture on both sides.
            let (columns, rows) = (both(width, dx), both(height, dy));
            for (sums, y) in along.chunks_exact_mut(width).zip(outer.clone()) {
                line.fill(0.0);
                if rows.contains(&y) {
                    for x in columns.clone() {
                        let p = y * width + x;
                        line[PATCH + x] =
                            self.apart(light, variance, p, p.wrapping_add_signed(dy * width as isize + dx));
                    }
                }
                sums.iter_mut().zip(line.windows(2 * PATCH + 1)).for_each(|(sum, taps)| *sum = taps.iter().sum());
            }
            for y in self.rows.clone().filter(|y| rows.contains(y)) {
                let patch_rows = around(y, &outer);
                let high = overlap(&patch_rows, &rows);
                for x in columns.clone() {
                    let (p, i) = (y * width + x, (y - self.rows.start) * width + x);
                    let q = p.wrapping_add_signed(dy * width as isize + dx);
                    let count = high * overlap(&around(x, &(0..width)), &columns);
                    let sum: f32 = patch_rows.clone().map(|y| along[(y - outer.start) * width + x]).sum();
                    let feature =
                        features.iter().map(|(f, inverse)| (f[p] - f[q]).powi(2) * inverse[p]).fold(0.0, f32::max);
                    let own = ALONE * self.apart(light, variance, p, q);
                    let weight = (-(sum / count as f32).max(own).max(feature)).exp();
                    weights[i] += weight;
                    sums.iter_mut().zip(light).for_each(|(sum, plane)| sum[i] += weight * plane[q]);
                }
            }
        }
        // The pixel itself has weight one.
        sums.map(|sum| sum.iter().zip(&weights).map(|(s, w)| s / w).collect())
    }

    /// Squared difference of two pixels beyond what their noise explains, over what is allowed.
    #[inline]
    fn apart(&self, light: &[Vec<f32>; 3], variance: &[Vec<f32>; 3], p: usize, q: usize) -> f32 {
        let k2 = self.params.strength * self.params.strength;
        let mut sum = 0.0;
        for c in 0..3 {
            let (vp, vq) = (variance[c][p], variance[c][q]);
            let difference = (light[c][p] - light[c][q]).powi(2) - (vp + vp.min(vq));
            sum += difference / (1e-10 + k2 * (vp + vq));
        }
        sum / 3.0
    }
}

/// Places of a row of `n` whose neighbour `shift` away lies in it too.
fn both(n: usize, shift: isize) -> Range<usize> {
    let by = shift.unsigned_abs().min(n);
    if shift < 0 { by..n } else { 0..n - by }
}

/// The patch around `at`, as far as it lies in `within`.
fn around(at: usize, within: &Range<usize>) -> Range<usize> {
    at.saturating_sub(PATCH).max(within.start)..(at + PATCH + 1).min(within.end)
}

fn overlap(a: &Range<usize>, b: &Range<usize>) -> usize {
    a.end.min(b.end).saturating_sub(a.start.max(b.start))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (48, 40);
    const N: usize = SIZE.0 * SIZE.1;

    /// Two halves of different light, noise of standard deviation `sigma`; the truth beside it.
    fn noisy(sigma: f32, seed: u64) -> (Vec<f32>, Vec<f32>) {
        let mut state = seed;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1 << 24) as f32
        };
        // Twelve uniform numbers make nearly a normal one of variance one.
        let mut normal = || (0..12).map(|_| uniform()).sum::<f32>() - 6.0;
        let truth: Vec<f32> = (0..N).map(|i| if i % SIZE.0 < SIZE.0 / 2 { 1.0 } else { 2.0 }).collect();
        let noise = |v: &f32| v + sigma * normal();
        (truth.iter().map(noise).collect(), truth)
    }

    fn rms(a: &[f32], b: &[f32]) -> f32 {
        (a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>() / N as f32).sqrt()
    }

    fn smooth(plane: &[f32], variance: f32, albedo: Option<&[f32]>) -> Vec<f32> {
        let variance = vec![variance; N];
        let noisy = Noisy {
            size: SIZE,
            rgb: [plane; 3],
            variance: [&variance; 3],
            albedo: albedo.map(|a| [a; 3]),
            normal: None,
            depth: None,
        };
        let [r, g, b] = non_local_means(&noisy, &DenoiseParams::default());
        assert_eq!((&r, &r), (&g, &b));
        r
    }

    #[test]
    fn noise_goes_and_an_edge_stays() {
        let (plane, truth) = noisy(0.1, 3);
        let ours = smooth(&plane, 0.01, None);
        assert!(rms(&ours, &truth) < 0.25 * rms(&plane, &truth), "{} of {}", rms(&ours, &truth), rms(&plane, &truth));
        let mean = |p: &[f32]| p.iter().sum::<f32>() / N as f32;
        assert!((mean(&ours) - mean(&plane)).abs() < 0.003);
    }

    #[test]
    fn without_variance_nothing_changes() {
        let (plane, _) = noisy(0.1, 4);
        assert!(rms(&smooth(&plane, 0.0, None), &plane) < 1e-4);
    }

    /// An edge that the noise hides is kept by the albedo that shows it.
    #[test]
    fn a_feature_keeps_what_noise_hides() {
        let (plane, truth) = noisy(1.0, 5);
        let albedo: Vec<f32> = truth.iter().map(|v| 0.4 * v).collect();
        let (blind, guided) = (smooth(&plane, 1.0, None), smooth(&plane, 1.0, Some(&albedo)));
        assert!(rms(&guided, &truth) < 0.9 * rms(&blind, &truth), "{} {}", rms(&guided, &truth), rms(&blind, &truth));
    }

    #[test]
    fn values_that_are_none_do_not_spread() {
        let (mut plane, truth) = noisy(0.1, 6);
        (plane[500], plane[501]) = (f32::NAN, f32::INFINITY);
        let ours = smooth(&plane, 0.01, None);
        assert!(ours.iter().all(|v| v.is_finite()) && rms(&ours, &truth) < 0.1);
    }
}
