//! What the frames show: each view's object as a whole, and the spot of each laser position.

use crate::capture::{Capture, norm, sub};
use rayon::prelude::*;
use translume_image::Result;

/// A spot in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Spot {
    /// Laser position.
    pub(super) position: usize,
    /// Its centre in pixels.
    pub(super) px: [f64; 2],
}

/// The frames of a view.
pub(super) struct Lit {
    width: usize,
    height: usize,
    /// The sum of all its frames.
    picture: Vec<f64>,
    /// Less than this is noise.
    floor: f64,
    pub(super) spots: Vec<Spot>,
}

/// All views.
pub(super) struct Pictures {
    pub(super) views: Vec<Lit>,
}

/// Frames of this many positions are read in parallel before they are added up in their order.
const BATCH: usize = 32;
/// Standard deviations of the noise that the object must be above.
const ABOVE_NOISE: f64 = 4.0;
/// A spot's centre is that of its pixels above this share of the brightest.
const SPOT: f64 = 0.35;

impl Pictures {
    /// Reads each frame once.
    pub(super) fn read(capture: &Capture, progress: impl Fn() + Sync) -> Result<Self> {
        let [views, positions, channels, height, width] = capture.frames.shape;
        let weight = |c: usize| capture.rig.channels[c].white_balance / capture.rig.laser.power[c];
        let noise = (0..channels).map(|c| (weight(c) * capture.rig.channels[c].noise_floor).powi(2)).sum::<f64>();
        let frame = |view: usize, position: usize| -> Result<Option<Vec<f64>>> {
            let mut sum: Option<Vec<f64>> = None;
            for c in 0..channels {
                let Some(frame) = capture.frames.read(view, position, c)? else { continue };
                let sum = sum.get_or_insert_with(|| vec![0.0; frame.len()]);
                let finite = |v: f32| if v.is_finite() { weight(c) * f64::from(v) } else { 0.0 };
                sum.iter_mut().zip(frame).for_each(|(s, v)| *s += finite(v));
            }
            Ok(sum)
        };
        let mut all: Vec<Lit> = (0..views)
            .map(|_| Lit { width, height, picture: vec![0.0; width * height], floor: 0.0, spots: Vec::new() })
            .collect();
        let mut counts = vec![0usize; views];
        let numbers: Vec<usize> = (0..positions).collect();
        for batch in numbers.chunks(BATCH) {
            let read = |&position: &usize| {
                progress();
                (0..views).map(|view| frame(view, position)).collect::<Result<Vec<_>>>()
            };
            let frames: Vec<Vec<Option<Vec<f64>>>> = batch.par_iter().map(read).collect::<Result<_>>()?;
            for (&position, frames) in batch.iter().zip(frames) {
                for (view, frame) in frames.into_iter().enumerate() {
                    let Some(frame) = frame else { continue };
                    let lit = &mut all[view];
                    let spot = spot(capture, view, position, &frame, ABOVE_NOISE * noise.sqrt());
                    lit.spots.extend(spot.map(|px| Spot { position, px }));
                    lit.picture.iter_mut().zip(frame).for_each(|(s, v)| *s += v);
                    counts[view] += 1;
                }
            }
        }
        for (lit, n) in all.iter_mut().zip(counts) {
            lit.floor = ABOVE_NOISE * dark_noise(&lit.picture).unwrap_or((noise * n as f64).sqrt());
        }
        Ok(Self { views: all })
    }
}

/// Standard deviation of the noise of dark pixels, by those that are below 0: light has no such values. `None` for pictures without
/// them. The floor of a rig may say more than that of the camera.
fn dark_noise(picture: &[f64]) -> Option<f64> {
    let (sum, n) = picture.iter().filter(|v| **v < 0.0).fold((0.0, 0usize), |(s, n), v| (s + v * v, n + 1));
    (n >= 16).then(|| (sum / n as f64).sqrt())
}

impl Lit {
    /// The sum of the frames at a place, bilinear between the centres of pixels.
    pub(super) fn at(&self, [x, y]: [f64; 2]) -> f64 {
        let clamped = |v: f64, n: usize| (v - 0.5).clamp(0.0, (n - 1) as f64);
        let (x, y) = (clamped(x, self.width), clamped(y, self.height));
        let (i, j) = (x as usize, y as usize);
        let (k, l) = ((i + 1).min(self.width - 1), (j + 1).min(self.height - 1));
        let (u, v) = (x.fract(), y.fract());
        let p = |i: usize, j: usize| self.picture[j * self.width + i];
        (1.0 - v) * ((1.0 - u) * p(i, j) + u * p(k, j)) + v * ((1.0 - u) * p(i, l) + u * p(k, l))
    }

    /// Where along the normal, in pixels, the object ends: nearest to 0 within ± `reach`.
    ///
    /// It ends near where the picture has half its value inside, both as fourth roots, since light may fall off steeply before the edge. There the light from a place inside, on to where it is dark, is
    /// compared with what the object would send if it went on as it falls off inside: blur by pixels moves light, but keeps its sum.
    pub(super) fn edge(&self, at: [f64; 2], normal: [f64; 2], reach: f64) -> Option<f64> {
        const STEP: f64 = 0.25;
        let value = |s: f64| self.at([at[0] + s * normal[0], at[1] + s * normal[1]]);
        let root = |s: f64| value(s).max(0.0).sqrt().sqrt();
        let middle = |s: f64| root(s) - 0.5 * (root(s - INSIDE) + root(s + INSIDE));
        let n = (reach / STEP).ceil() as i64;
        let mut best: Option<f64> = None;
        let mut last = middle(-(n as f64) * STEP);
        for i in -n + 1..=n {
            let s = i as f64 * STEP;
            let here = middle(s);
            if last > 0.0 && here <= 0.0 {
                // Once more from there: the first guess lies outwards, by the roots.
                let guess = end(&value, s - STEP * here / (here - last), self.floor);
                let found = guess.and_then(|g| end(&value, g, self.floor));
                if found.is_some_and(|f| best.is_none_or(|b| f.abs() < b.abs())) {
                    best = found;
                }
            }
            last = here;
        }
        best
    }
}

/// Pixels from an edge to where its blur has all but ended.
const INSIDE: f64 = 1.5;

/// The edge near `half`, by the sum of light.
///
/// Towards an outline the surface turns away: at d pixels from it the way along the surface goes as √d. Light that falls off exponentially
/// along the surface is v(d) = v(d₀) e^{β(√d − √d₀)}, with β from another place inside.
fn end(value: &dyn Fn(f64) -> f64, half: f64, floor: f64) -> Option<f64> {
    /// Outside there is at most this share of the light inside: dark parts of the object are brighter.
    const DARK: f64 = 0.2;
    /// Pixels over which the fall-off inside is taken, and the steepest β that is believed.
    const OVER: f64 = 1.5;
    const STEEPEST: f64 = 2.5;
    const PARTS: usize = 28;
    let from = half - INSIDE;
    let (here, before) = (value(from), value(from - OVER));
    if here <= floor || before <= 0.0 || value(half + INSIDE) > DARK * here {
        return None;
    }
    let step = 2.0 * INSIDE / PARTS as f64;
    let light: f64 = (0..PARTS).map(|i| step * value(from + (i as f64 + 0.5) * step)).sum();
    // What an object that ends `length` beyond `from` would send: ∫₀^√length 2 t v(t²) dt.
    let sent = |length: f64| {
        let root = length.sqrt();
        let beta = ((before / here).ln() / ((length + OVER).sqrt() - root)).clamp(-STEEPEST, STEEPEST);
        let part = |i: usize| {
            let t = (i as f64 + 0.5) / PARTS as f64 * root;
            2.0 * t * (beta * (t - root)).exp()
        };
        here * root / PARTS as f64 * (0..PARTS).map(part).sum::<f64>()
    };
    let (mut low, mut high) = (0.0, 2.0 * INSIDE);
    if sent(high) < light {
        return None;
    }
    for _ in 0..12 {
        let middle = 0.5 * (low + high);
        match sent(middle) < light {
            true => low = middle,
            false => high = middle,
        }
    }
    Some(from + low)
}

/// The centre of the brightest spot of a frame; `None` at the rim of the frame and in the noise.
fn spot(capture: &Capture, view: usize, position: usize, frame: &[f64], floor: f64) -> Option<[f64; 2]> {
    let camera = &capture.rig.views[view].camera;
    let (w, h) = (camera.width, camera.height);
    let (at, peak) = frame.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
    let (x, y) = (at % w, at / w);
    if peak <= floor || x == 0 || y == 0 || x + 1 == w || y + 1 == h {
        return None;
    }
    let far = norm(sub(camera.eye(), capture.rig.laser.hits_mm[position]));
    let reach = (camera.focal_px * capture.rig.laser.beam_diameter_mm / far).ceil().max(1.0) as usize;
    let (mut sum, mut centre) = (0.0, [0.0; 2]);
    for j in y.saturating_sub(reach)..=(y + reach).min(h - 1) {
        for i in x.saturating_sub(reach)..=(x + reach).min(w - 1) {
            let weight = (frame[j * w + i] - SPOT * peak).max(0.0);
            sum += weight;
            centre[0] += weight * (i as f64 + 0.5);
            centre[1] += weight * (j as f64 + 0.5);
        }
    }
    Some(centre.map(|c| c / sum))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_are_found_between_pixels() {
        // A half-plane x cos + y sin < d, brighter to one side, seen by pixels that average over 16² places.
        let (width, height) = (32, 32);
        for (angle, d) in [(0.0f64, 16.3), (0.6, 20.0), (2.2, 2.37)] {
            let normal = [angle.cos(), angle.sin()];
            let inside = |x: f64, y: f64| x * normal[0] + y * normal[1] < d;
            let pixel = |i: usize| {
                let sub = |k: usize| (k as f64 + 0.5) / 16.0;
                let hits =
                    (0..256).filter(|k| inside((i % width) as f64 + sub(k % 16), (i / width) as f64 + sub(k / 16)));
                hits.count() as f64 / 256.0 * (1.0 + 0.02 * (i % width) as f64)
            };
            let picture = (0..width * height).map(pixel).collect();
            let lit = Lit { width, height, picture, floor: 0.01, spots: Vec::new() };
            // Places near the middle of the picture's part of the line, off by up to 3 pixels.
            for off in [-3.0, -0.4, 0.0, 2.2] {
                let c = d + off - 16.0 * (normal[0] + normal[1]);
                let at = [16.0 + c * normal[0], 16.0 + c * normal[1]];
                let found = lit.edge(at, normal, 5.0).unwrap_or(f64::NAN);
                assert!((found + off).abs() < 0.12, "{angle} {d} {off}: {found}");
            }
            let far = d + 8.0 - 16.0 * (normal[0] + normal[1]);
            assert!(lit.edge([16.0 + far * normal[0], 16.0 + far * normal[1]], normal, 5.0).is_none());
        }
    }
}
