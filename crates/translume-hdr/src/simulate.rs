//! A simulated camera held by hand: exposes a known scene, so that a merge can be measured against the truth.
//!
//! Not from a paper. A shot is: the scene moved by a rotation and a shift, a ball in front of it, multiplied by the
//! exposure, shot and read noise, clipped where the well is full, a response that is no gamma, rounded.
//!
//! Limits: no lens (vignetting, distortion, glare), no Bayer pattern, no blur by motion. Shot noise is normal with the
//! variance of the Poisson distribution, which differs from it below some ten electrons only, where read noise hides it.

use rayon::prelude::*;
use translume_core::rng::Pcg32;
use translume_image::{Codes, Metadata, Rgb32FImage, Samples};

/// What the camera writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Depth {
    /// 8-bit codes through [`response`].
    Eight,
    /// 16-bit codes through [`response`].
    Sixteen,
    /// Floats proportional to exposure, 1 at full well.
    Linear,
}

/// The camera.
#[derive(Clone, Debug)]
pub struct Camera {
    /// Columns and rows of its pictures: the middle of the scene, which should be larger by what the hand moves.
    pub size: (usize, usize),
    /// Electrons that fill the well of a pixel.
    pub full_well: f64,
    /// Standard deviation of the read noise in electrons.
    pub read_noise: f64,
    /// Exposure time in seconds at which radiance 1 fills the well.
    pub white_secs: f64,
    /// What it writes.
    pub depth: Depth,
    /// Seed of the noise; every row of every shot has a stream of its own.
    pub seed: u64,
}

impl Default for Camera {
    /// A small sensor at low gain: 12,000 electrons, 4 of read noise, 8 bits.
    fn default() -> Self {
        Self {
            size: (640, 640),
            full_well: 12_000.0,
            read_noise: 4.0,
            white_secs: 1.0 / 15.0,
            depth: Depth::Eight,
            seed: 1,
        }
    }
}

/// How the camera was held for one shot, against the anchor's shot.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// Rotation about the middle of the picture; positive turns the x axis towards the y axis, clockwise as seen.
    pub rotation_rad: f64,
    /// Shift in pixels, x and y.
    pub shift_px: [f64; 2],
}

/// Something that moves on its own: a striped ball before the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    /// Its middle in pixels of the anchor's frame.
    pub centre_px: [f64; 2],
    /// Its radius in pixels.
    pub radius_px: f64,
    /// Radiance of its white stripes in full light.
    pub white: f32,
    /// How far it has rolled.
    pub roll_rad: f64,
}

impl Pose {
    /// Where the point that the anchor's shot shows at `p` lies in this shot, both in pixels of a picture of `size`.
    pub fn place(&self, p: [f64; 2], size: (usize, usize)) -> [f64; 2] {
        let (sin, cos) = self.rotation_rad.sin_cos();
        let c = middle(size);
        let d = [p[0] - c[0], p[1] - c[1]];
        [c[0] + cos * d[0] - sin * d[1] + self.shift_px[0], c[1] + sin * d[0] + cos * d[1] + self.shift_px[1]]
    }

    /// The inverse of [`Pose::place`].
    pub fn anchor_of(&self, p: [f64; 2], size: (usize, usize)) -> [f64; 2] {
        let (sin, cos) = self.rotation_rad.sin_cos();
        let c = middle(size);
        let d = [p[0] - c[0] - self.shift_px[0], p[1] - c[1] - self.shift_px[1]];
        [c[0] + cos * d[0] + sin * d[1], c[1] - sin * d[0] + cos * d[1]]
    }
}

fn middle((w, h): (usize, usize)) -> [f64; 2] {
    [0.5 * (w as f64 - 1.0), 0.5 * (h as f64 - 1.0)]
}

impl Camera {
    /// The radiance that reaches the sensor in one shot, without noise: of [`Pose::default`], the truth of a merge.
    pub fn view(&self, scene: &Rgb32FImage, pose: &Pose, ball: Option<&Ball>) -> Rgb32FImage {
        let (w, h) = self.size;
        let (scene_middle, own) = (middle((scene.width() as usize, scene.height() as usize)), middle(self.size));
        let mut out = Rgb32FImage::new(w as u32, h as u32);
        out.par_chunks_mut(3 * w).enumerate().for_each(|(y, row)| {
            for (x, pixel) in row.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                let p = pose.anchor_of([x as f64, y as f64], self.size);
                *pixel = sample(scene, p[0] - own[0] + scene_middle[0], p[1] - own[1] + scene_middle[1]);
                if let Some((colour, share)) = ball.and_then(|b| b.at(p)) {
                    (0..3).for_each(|c| pixel[c] += share * (colour[c] - pixel[c]));
                }
            }
        });
        out
    }

    /// What the camera writes of a view exposed for `secs`, as shot number `shot` (which sets its noise).
    pub fn expose(&self, view: &Rgb32FImage, secs: f64, shot: u32) -> Codes {
        let (width, height) = (view.width() as usize, view.height() as usize);
        let gain = secs / self.white_secs;
        let mut linear = vec![0.0f32; 3 * width * height];
        linear.par_chunks_mut(3 * width).zip(view.par_chunks(3 * width)).enumerate().for_each(
            |(y, (out, radiance))| {
                let mut rng = Pcg32::new(self.seed, (u64::from(shot) << 32) | y as u64);
                for (o, r) in out.iter_mut().zip(radiance) {
                    let electrons = (f64::from(r.max(0.0)) * gain).min(2.0) * self.full_well;
                    let sigma = (electrons + self.read_noise * self.read_noise).sqrt();
                    *o = ((electrons + sigma * rng.next_normal()) / self.full_well).clamp(0.0, 1.0) as f32;
                }
            },
        );
        let samples = match self.depth {
            Depth::Eight => Samples::U8(linear.iter().map(|x| (response(*x) * 255.0).round() as u8).collect()),
            Depth::Sixteen => Samples::U16(linear.iter().map(|x| (response(*x) * 65535.0).round() as u16).collect()),
            Depth::Linear => Samples::F32(linear),
        };
        let metadata = Metadata { exposure_secs: Some(secs), ..Metadata::default() };
        Codes { width, height, samples, metadata }
    }
}

/// How deep toe and shoulder of [`response`] are; 0 leaves a power, 1 would make the ends flat.
const CONTRAST: f32 = 0.5;

/// The camera's response: code in [0, 1] over exposure in [0, 1], a power of 1/2.2 with a toe and a shoulder.
pub fn response(exposure: f32) -> f32 {
    use std::f32::consts::TAU;
    let v = exposure.clamp(0.0, 1.0).powf(1.0 / 2.2);
    v - CONTRAST * (TAU * v).sin() / TAU
}

/// The inverse of [`response`], by bisection.
pub fn exposure_of(code: f32) -> f32 {
    let (mut low, mut high) = (0.0f32, 1.0f32);
    for _ in 0..30 {
        let mid = 0.5 * (low + high);
        *(if response(mid) < code { &mut low } else { &mut high }) = mid;
    }
    0.5 * (low + high)
}

impl Ball {
    /// Radiance and coverage at `p` (pixels of the anchor's frame), `None` beside the ball.
    fn at(&self, p: [f64; 2]) -> Option<([f32; 3], f32)> {
        let d = [(p[0] - self.centre_px[0]) / self.radius_px, (p[1] - self.centre_px[1]) / self.radius_px];
        let from_middle = d[0].hypot(d[1]);
        let share = ((1.0 - from_middle) * self.radius_px + 0.5).clamp(0.0, 1.0);
        if share <= 0.0 {
            return None;
        }
        let z = (1.0 - from_middle.min(1.0).powi(2)).sqrt();
        // A light from the upper left, before the picture.
        let shade = 0.12 + 0.88 * (-0.5 * d[0] - 0.6 * d[1] + 0.62 * z).max(0.0);
        // Six sectors about an axis that leans towards the viewer.
        let sector = ((d[1] + 0.3 * z).atan2(d[0]) + self.roll_rad).rem_euclid(std::f64::consts::TAU) * 3.0
            / std::f64::consts::PI;
        let colour = if (sector as u32).is_multiple_of(2) { [1.0, 1.0, 0.95] } else { [0.85, 0.08, 0.05] };
        Some((colour.map(|c: f32| c * self.white * shade as f32), share as f32))
    }
}

/// Catmull–Rom interpolation with edges repeated, held within the range of the four nearest pixels: next to a lamp a
/// cubic would swing below zero, and light does not.
fn sample(scene: &Rgb32FImage, x: f64, y: f64) -> [f32; 3] {
    let (w, h) = (scene.width() as i64, scene.height() as i64);
    let (ix, iy) = (x.floor() as i64, y.floor() as i64);
    let (wx, wy) = (catmull_rom((x - x.floor()) as f32), catmull_rom((y - y.floor()) as f32));
    let mut out = [0.0f32; 3];
    let (mut low, mut high) = ([f32::INFINITY; 3], [0.0f32; 3]);
    for j in 0..4 {
        for i in 0..4 {
            let at = |v: i64, n: i64| v.clamp(0, n - 1) as u32;
            let p = scene.get_pixel(at(ix + i - 1, w), at(iy + j - 1, h)).0;
            let near = (1..=2).contains(&i) && (1..=2).contains(&j);
            for c in 0..3 {
                out[c] += wx[i as usize] * wy[j as usize] * p[c];
                if near {
                    (low[c], high[c]) = (low[c].min(p[c]), high[c].max(p[c]));
                }
            }
        }
    }
    std::array::from_fn(|c| out[c].clamp(low[c], high[c]))
}

fn catmull_rom(t: f32) -> [f32; 4] {
    [
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    ]
}

/// The factor that brings `picture` to the scale of `truth` (interleaved RGB of one size): the median of the ratios
/// over pixels that are neither dark nor bright in the truth. 1 if there are none.
pub fn scale_to(truth: &[f32], picture: &[f32]) -> f32 {
    let sum = |v: &[f32; 3]| v.iter().sum::<f32>();
    let mut order: Vec<f32> = truth.as_chunks::<3>().0.iter().map(sum).collect();
    if order.is_empty() {
        return 1.0;
    }
    order.sort_by(f32::total_cmp);
    let (low, high) = (order[order.len() / 5], order[order.len() * 19 / 20]);
    let pairs = truth.as_chunks::<3>().0.iter().map(sum).zip(picture.as_chunks::<3>().0.iter().map(sum));
    let mut ratios: Vec<f32> =
        pairs.filter(|(t, p)| (low..=high).contains(t) && *t > 0.0 && *p > 0.0).map(|(t, p)| t / p).collect();
    if ratios.is_empty() {
        return 1.0;
    }
    let mid = ratios.len() / 2;
    *ratios.select_nth_unstable_by(mid, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene() -> Rgb32FImage {
        let mut scene = Rgb32FImage::new(60, 50);
        for (x, y, p) in scene.enumerate_pixels_mut() {
            p.0 = [0.2 + 0.005 * x as f32, 0.1 + 0.004 * y as f32, 0.3];
        }
        scene
    }

    fn small() -> Camera {
        Camera { size: (40, 30), ..Camera::default() }
    }

    #[test]
    fn poses_undo_themselves_and_move_the_picture_as_they_say() {
        let pose = Pose { rotation_rad: 0.05, shift_px: [2.0, -1.0] };
        let p = [7.0, 21.0];
        let q = pose.anchor_of(pose.place(p, (40, 30)), (40, 30));
        assert!((p[0] - q[0]).abs() < 1e-12 && (p[1] - q[1]).abs() < 1e-12);
        // The scene is a plane in x and y, which cubic interpolation keeps.
        let camera = small();
        let (truth, shot) = (camera.view(&scene(), &Pose::default(), None), camera.view(&scene(), &pose, None));
        let at = pose.place([20.0, 15.0], camera.size);
        let (x, y) = (at[0].round(), at[1].round());
        let back = pose.anchor_of([x, y], camera.size);
        let expected = truth.get_pixel(20, 15).0[0] + 0.005 * (back[0] - 20.0) as f32;
        assert!((shot.get_pixel(x as u32, y as u32).0[0] - expected).abs() < 1e-5);
    }

    #[test]
    fn exposure_is_linear_before_the_response_and_noise_has_the_variance_it_should() {
        let camera = Camera { size: (64, 64), depth: Depth::Linear, ..Camera::default() };
        let flat = Rgb32FImage::from_raw(64, 64, vec![0.25; 3 * 64 * 64]).unwrap();
        let Samples::F32(v) = camera.expose(&flat, 1.0 / 30.0, 0).samples else { panic!("linear") };
        let n = v.len() as f64;
        let mean = v.iter().map(|x| f64::from(*x)).sum::<f64>() / n;
        let variance = v.iter().map(|x| (f64::from(*x) - mean).powi(2)).sum::<f64>() / n;
        let expected = (0.125 * 12_000.0 + 16.0) / 12_000.0f64.powi(2);
        assert!((mean - 0.125).abs() < 5.0 * (expected / n).sqrt(), "{mean}");
        assert!((variance / expected - 1.0).abs() < 5.0 * (2.0 / n).sqrt(), "{variance} {expected}");
    }

    #[test]
    fn response_rises_from_0_to_1_and_is_no_power() {
        let codes: Vec<f32> = (0..=100).map(|i| response(i as f32 / 100.0)).collect();
        assert!(codes[0] == 0.0 && (codes[100] - 1.0).abs() < 1e-6 && codes.windows(2).all(|w| w[0] < w[1]));
        let exponent = |a: f32, b: f32| (response(b) / response(a)).ln() / (b / a).ln();
        assert!(exponent(0.05, 0.1) > 1.5 * exponent(0.5, 1.0));
        for x in [0.001, 0.1, 0.7] {
            assert!((exposure_of(response(x)) - x).abs() < 1e-5);
        }
    }

    #[test]
    fn shots_repeat_and_differ_in_noise() {
        let (camera, scene) = (small(), scene());
        let ball = Ball { centre_px: [10.0, 10.0], radius_px: 5.0, white: 2.0, roll_rad: 0.3 };
        let view = camera.view(&scene, &Pose::default(), Some(&ball));
        let shot = |n| camera.expose(&view, 1.0 / 15.0, n).samples;
        assert_eq!(shot(0), shot(0));
        assert_ne!(shot(0), shot(1));
        let plain = camera.view(&scene, &Pose::default(), None);
        assert_eq!(plain.get_pixel(30, 20), view.get_pixel(30, 20));
        assert!(view.get_pixel(8, 8).0[0] > 2.0 * plain.get_pixel(8, 8).0[0]);
    }

    #[test]
    fn scale_is_found_beside_outliers() {
        let truth: Vec<f32> = (0..300).map(|i| 0.1 + i as f32).collect();
        let mut picture: Vec<f32> = truth.iter().map(|t| t / 3.0).collect();
        picture[30..60].fill(7.0);
        assert!((scale_to(&truth, &picture) - 3.0).abs() < 1e-4);
    }
}
