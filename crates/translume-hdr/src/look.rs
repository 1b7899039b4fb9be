//! Whether two pictures of different exposure show one scene: small pictures of ranks, held against each other.
//!
//! Ranks do not change with exposure or response, as long as nothing is clipped. The mean of the surroundings is taken
//! off, because most scenes are bright above and dark below; and shifts of some per cent are tried, for cameras held by
//! hand. This tells scenes apart; it aligns nothing.

use translume_image::Codes;

/// Cells on the longer side.
const CELLS: usize = 36;
/// Cells by which pictures are shifted against each other.
const SHIFT: isize = 3;
/// Half side, in cells, of the surroundings whose mean is taken off.
const AROUND: usize = 3;
/// Share of the cells that must be well exposed in both pictures.
const ENOUGH: f32 = 0.15;
/// A likeness below this is that of different scenes.
pub(crate) const DIFFERENT: f32 = 0.3;
/// A likeness above this is that of one scene.
pub(crate) const SAME: f32 = 0.45;

/// A small picture of ranks.
#[derive(Clone, Debug)]
pub struct Look {
    width: usize,
    height: usize,
    /// Rank in [0, 1] less the mean of the surroundings; `None` where clipped or black.
    cells: Vec<Option<f32>>,
}

impl Look {
    /// Of a picture.
    pub fn new(codes: &Codes) -> Self {
        let longer = codes.width.max(codes.height).max(1);
        let (width, height) = ((codes.width * CELLS).div_ceil(longer), (codes.height * CELLS).div_ceil(longer));
        let means = cell_means(codes, width, height);
        let top = if codes.is_linear() { means.iter().copied().fold(f32::MIN_POSITIVE, f32::max) } else { 1.0 };
        let usable = |m: f32| (0.02 * top..0.97 * top).contains(&m);
        let mut order: Vec<usize> = (0..means.len()).collect();
        order.sort_by(|a, b| means[*a].total_cmp(&means[*b]));
        let mut ranks = vec![0.0f32; means.len()];
        for (rank, cell) in order.iter().enumerate() {
            ranks[*cell] = rank as f32 / means.len() as f32;
        }
        let around = crate::box_mean::box_mean(&ranks, width, AROUND);
        let cells = (0..means.len()).map(|i| usable(means[i]).then(|| ranks[i] - around[i])).collect();
        Self { width, height, cells }
    }

    /// Correlation in [−1, 1] at the best shift; `None` if too little is well exposed in both or the sizes differ.
    pub fn likeness(&self, other: &Self) -> Option<f32> {
        if (self.width, self.height) != (other.width, other.height) {
            return None;
        }
        let shifts = (-SHIFT..=SHIFT).flat_map(|dy| (-SHIFT..=SHIFT).map(move |dx| (dx, dy)));
        shifts.filter_map(|(dx, dy)| self.correlation(other, dx, dy)).reduce(f32::max)
    }

    fn correlation(&self, other: &Self, dx: isize, dy: isize) -> Option<f32> {
        let (mut ab, mut aa, mut bb, mut n) = (0.0f32, 0.0f32, 0.0f32, 0.0f32);
        for y in 0..self.height {
            let Some(oy) = y.checked_add_signed(dy).filter(|v| *v < self.height) else { continue };
            for x in 0..self.width {
                let Some(ox) = x.checked_add_signed(dx).filter(|v| *v < self.width) else { continue };
                if let (Some(a), Some(b)) = (self.cells[y * self.width + x], other.cells[oy * self.width + ox]) {
                    ab += a * b;
                    aa += a * a;
                    bb += b * b;
                    n += 1.0;
                }
            }
        }
        let enough = n >= ENOUGH * self.cells.len() as f32 && n >= 12.0 && aa.min(bb) > 1e-4 * n;
        enough.then(|| ab / (aa * bb).sqrt())
    }
}

/// Mean codes of the cells, over about 16 × 16 pixels each.
fn cell_means(codes: &Codes, width: usize, height: usize) -> Vec<f32> {
    let step = (codes.width.max(codes.height) / (CELLS * 16)).max(1);
    let (mut sums, mut counts) = (vec![0.0f32; width * height], vec![0.0f32; width * height]);
    for y in (0..codes.height).step_by(step) {
        for x in (0..codes.width).step_by(step) {
            let i = 3 * (y * codes.width + x);
            let cell = y * height / codes.height * width + x * width / codes.width;
            sums[cell] += (codes.unit(i) + codes.unit(i + 1) + codes.unit(i + 2)) / 3.0;
            counts[cell] += 1.0;
        }
    }
    sums.iter().zip(counts).map(|(s, n)| if n > 0.0 { s / n } else { 0.0 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use translume_image::{Metadata, Samples};

    /// A picture of patches; `seed` makes the scene, `gain` the exposure, `shift` moves it.
    fn picture(seed: u64, gain: f32, shift: usize) -> Codes {
        let (w, h) = (360, 240);
        let mut rng = translume_core::rng::Pcg32::new(seed, 0);
        let patches: Vec<f32> = (0..60 * 40).map(|_| rng.next_f32()).collect();
        let code = |x: usize, y: usize| {
            let sky = 0.3 * (1.0 - y as f32 / h as f32);
            let light = gain * (0.05 + sky + 0.6 * patches[y / 12 * 60 + (x + shift) / 12]);
            (255.0 * light.min(1.0).powf(1.0 / 2.2)) as u8
        };
        let samples = (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).flat_map(|(x, y)| [code(x, y); 3]).collect();
        Codes { width: w, height: h, samples: Samples::U8(samples), metadata: Metadata::default() }
    }

    #[test]
    fn one_scene_is_told_from_another_at_any_exposure() {
        let look = |seed, gain, shift| Look::new(&picture(seed, gain, shift));
        let reference = look(1, 0.5, 0);
        for (gain, shift) in [(0.125, 0), (0.5, 20), (2.0, 10)] {
            assert!(reference.likeness(&look(1, gain, shift)).unwrap() > SAME, "{gain} {shift}");
        }
        for seed in 2..12 {
            assert!(reference.likeness(&look(seed, 0.4, 0)).unwrap() < DIFFERENT, "{seed}");
        }
        assert_eq!(reference.likeness(&look(1, 100.0, 0)), None, "all white");
    }
}
