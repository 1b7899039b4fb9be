//! Light that reaches the film by itself: splats, added up so that their order does not matter.
//!
//! The paths of a tile splat all over the film, in an order that depends on the threads. Sums are therefore of fixed point in 128
//! bits, which is associative: the same bits for any number of threads, any lengths of passes, any interruption. The unit is 2⁻⁶⁴ of a
//! power of two that the scene's light decides (`Splats::new`), so that sums of pictures of any brightness neither saturate nor vanish.

use crate::Rgb;
use crate::filter::FilterSampler;
use glam::Vec2;
use std::sync::Mutex;

/// A number of fixed point; 2 to the `exponent` is where the point stands.
pub(crate) fn fixed(v: f64, exponent: i32) -> i128 {
    (v * 2.0_f64.powi(64 - exponent)) as i128 // saturates
}

/// The number as a float.
pub(crate) fn float(v: i128, exponent: i32) -> f64 {
    v as f64 * 2.0_f64.powi(exponent - 64)
}

/// Pictures as bright as 2 to this, or as dark as one over it, have their point where everyday ones have it.
const EVERYDAY: i32 = 20;

/// Light at a place of the film.
#[derive(Clone, Copy, Debug)]
pub struct Splat {
    /// In pixels of the whole film.
    pub film: Vec2,
    /// Contribution, as [`crate::camera::CameraSample::weight`] makes it.
    pub value: Rgb,
}

/// Sums of splats, pixel by pixel of the window that is rendered.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Splats {
    /// Values over the number of pixels, so that the pixel is their sum over the samples per pixel.
    pub(crate) sums: Vec<[i128; 3]>,
    /// Sums of the squares of what one path gave a pixel, at twice the exponent.
    pub(crate) squares: Vec<[i128; 3]>,
    exponent: i32,
}

/// Pixels that are locked together.
const BAND: usize = 4096;

/// Splats under way: bands of pixels, each behind a lock.
pub(crate) struct Shared<'a> {
    bands: Vec<Mutex<Band<'a>>>,
}

struct Band<'a> {
    sums: &'a mut [[i128; 3]],
    squares: &'a mut [[i128; 3]],
    exponent: i32,
}

impl Splats {
    /// For a picture of about the brightness `typical`: from 2⁻⁶⁰ to 2⁵⁰ times that are added up without loss.
    pub(crate) fn new(pixels: usize, squares: bool, typical: f64) -> Self {
        let exponent = if typical > 0.0 && typical.is_finite() { typical.log2() as i32 } else { 0 };
        let exponent = if exponent.abs() <= EVERYDAY { 0 } else { exponent };
        Self { sums: vec![[0; 3]; pixels], squares: vec![[0; 3]; if squares { pixels } else { 0 }], exponent }
    }

    /// The sum of channel `c` of a pixel, and that of squares, 0 where there is none.
    pub(crate) fn sum(&self, pixel: usize, c: usize) -> (f64, f64) {
        let square = self.squares.get(pixel).map_or(0.0, |s| float(s[c], 2 * self.exponent));
        (float(self.sums[pixel][c], self.exponent), square)
    }

    pub(crate) fn shared(&mut self) -> Shared<'_> {
        let mut squares = self.squares.chunks_mut(BAND);
        let bands = self.sums.chunks_mut(BAND);
        let exponent = self.exponent;
        let band = |sums| Mutex::new(Band { sums, squares: squares.next().unwrap_or_default(), exponent });
        Shared { bands: bands.map(band).collect() }
    }
}

impl Shared<'_> {
    /// Adds what paths gave to pixels and empties the list.
    pub(crate) fn add(&self, list: &mut Vec<(u32, Rgb)>) {
        list.sort_unstable_by_key(|(pixel, _)| *pixel / BAND as u32);
        for run in list.chunk_by(|a, b| a.0 / BAND as u32 == b.0 / BAND as u32) {
            let Some(band) = self.bands.get(run[0].0 as usize / BAND) else { continue };
            // A thread that panicked elsewhere leaves whole sums.
            let mut band = band.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            let exponent = band.exponent;
            for (pixel, value) in run {
                let i = *pixel as usize % BAND;
                for c in 0..3 {
                    let v = f64::from(value[c]);
                    band.sums[i][c] = band.sums[i][c].saturating_add(fixed(v, exponent));
                    if let Some(square) = band.squares.get_mut(i) {
                        square[c] = square[c].saturating_add(fixed(v * v, 2 * exponent));
                    }
                }
            }
        }
        list.clear();
    }
}

/// Turns splats on the film into shares of the window's pixels.
pub(crate) struct Splatter<'a> {
    pub(crate) filter: &'a FilterSampler,
    /// Upper left pixel and size.
    pub(crate) window: ([u32; 2], [u32; 2]),
}

impl Splatter<'_> {
    /// Appends the shares of all splats of one path, one entry per pixel, and empties the splats; returns how many were not
    /// finite.
    pub(crate) fn spread(&self, splats: &mut Vec<Splat>, list: &mut Vec<(u32, Rgb)>) -> u64 {
        let first = list.len();
        let broken = splats.iter().filter(|s| !s.value.is_finite()).count() as u64;
        let ([x0, y0], [w, h]) = self.window;
        let scale = 1.0 / (w as f32 * h as f32);
        let r = self.filter.radius();
        for splat in splats.drain(..).filter(|s| s.value.is_finite()) {
            let at = splat.film - Vec2::new(x0 as f32, y0 as f32);
            let range = |at: f32, n: u32| {
                let lo = (at - 0.5 - r).ceil().max(0.0) as u32;
                let hi = (at - 0.5 + r).floor().min(n as f32 - 1.0);
                lo..if hi < 0.0 { lo } else { hi as u32 + 1 }
            };
            for y in range(at.y, h) {
                for x in range(at.x, w) {
                    let weight = self.filter.weight(at - Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
                    if weight != 0.0 {
                        list.push((y * w + x, splat.value * (weight * scale)));
                    }
                }
            }
        }
        // One path may meet a pixel several times: the variance wants its sum.
        list[first..].sort_by_key(|(pixel, _)| *pixel); // stable: sums in the order of the splats
        let mut end = first;
        for i in first..list.len() {
            let (pixel, value) = list[i];
            if end > first && list[end - 1].0 == pixel {
                list[end - 1].1 += value;
            } else {
                list[end] = (pixel, value);
                end += 1;
            }
        }
        list.truncate(end);
        broken
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_keep_light_of_any_strength() {
        for typical in [1e-30, 1e-9, 1.0, 1e6, 1e18, 1e20, 1e36] {
            let mut splats = Splats::new(1, true, typical);
            let value = (0.37 * typical) as f32;
            let shared = splats.shared();
            (0..1000).for_each(|_| shared.add(&mut vec![(0, Rgb::splat(value))]));
            drop(shared);
            let (sum, square) = splats.sum(0, 1);
            let value = f64::from(value);
            assert!((sum / (1000.0 * value) - 1.0).abs() < 1e-6, "{typical}: {sum}");
            assert!((square / (1000.0 * value * value) - 1.0).abs() < 1e-3, "{typical}: {square}");
        }
    }
}
