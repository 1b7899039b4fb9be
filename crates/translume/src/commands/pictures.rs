//! Small pictures of what was measured, for pages.

use std::path::Path;
use translume_hdr::Field;
use translume_image::write_png8;

/// A small RGB picture, 8 bits.
pub(crate) struct Thumb {
    pub(crate) size: (usize, usize),
    pub(crate) rgb: Vec<u8>,
}

impl Thumb {
    /// Writes it as PNG.
    pub(crate) fn save(&self, path: &Path) -> anyhow::Result<()> {
        Ok(write_png8(path, self.size, &self.rgb)?)
    }
}

/// A picture of `w` × `h` pixels by averages of `step` × `step` blocks; `at` gives pixel `i`, row by row.
pub(crate) fn shrink((w, h): (usize, usize), step: usize, at: impl Fn(usize) -> [f32; 3]) -> Thumb {
    let size = (w.div_ceil(step), h.div_ceil(step));
    let mut rgb = Vec::with_capacity(3 * size.0 * size.1);
    for y in 0..size.1 {
        for x in 0..size.0 {
            let (mut sum, mut n) = ([0.0f32; 3], 0.0f32);
            for yy in y * step..((y + 1) * step).min(h) {
                for xx in x * step..((x + 1) * step).min(w) {
                    let v = at(yy * w + xx);
                    (0..3).for_each(|c| sum[c] += v[c]);
                    n += 1.0;
                }
            }
            rgb.extend(sum.map(|s| (s / n * 255.0 + 0.5).clamp(0.0, 255.0) as u8));
        }
    }
    Thumb { size, rgb }
}

/// Displacement as a colour wheel, every `step`-th pixel: hue is direction, brightness length relative to the largest.
pub(crate) fn motion(field: &Field, (w, h): (usize, usize), step: usize) -> Thumb {
    let most = field.longest(w, h).max(1e-6);
    let size = (w.div_ceil(step), h.div_ceil(step));
    let mut rgb = Vec::with_capacity(3 * size.0 * size.1);
    for y in 0..size.1 {
        for x in 0..size.0 {
            let [dx, dy] = field.displacement((x * step) as f32, (y * step) as f32);
            let (length, hue) = ((dx.hypot(dy) / most).min(1.0), dy.atan2(dx) / std::f32::consts::TAU);
            // A hue as three cosines a third of a turn apart.
            rgb.extend([0.0, 1.0 / 3.0, 2.0 / 3.0].map(|shift| {
                let v = 0.5 + 0.5 * ((hue - shift) * std::f32::consts::TAU).cos();
                (255.0 * length * v + 0.5) as u8
            }));
        }
    }
    Thumb { size, rgb }
}
