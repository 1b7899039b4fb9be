//! Which light paths are kept: those that come where the camera's paths are.
//!
//! Source: Georgiev, Slusallek 2010: Simple and robust iterative importance sampling of virtual point lights. A light path is kept with the chance
//! min(1, v/v̄), v what it may bring to the picture and v̄ the mean of all, and counts as many times more; more paths are
//! traced, so that as many are kept. They estimate v by a coarse picture; here it is the flux at each of its vertices times what the pilot's
//! camera vertices near there would hand on, on a grid.

use super::eye::EyeVertex;
use crate::luminance;
use crate::subpath::Vertex;
use glam::Vec3;

/// Cells along the longest side.
const CELLS: f32 = 48.0;

/// Least chance: what the pilot did not see is not lost.
const LEAST: f32 = 0.1;

/// What was learnt.
pub(crate) struct Keep {
    least: Vec3,
    per_length: f32,
    cells: [usize; 3],
    /// Per cell, x first: factors on radiance of the camera vertices in it and around it.
    gains: Vec<f32>,
    /// v̄.
    mean: f32,
    /// Share of the paths that are kept.
    pub(crate) share: f32,
}

impl Keep {
    /// By the pilot's camera vertices, in a scene with this bounding sphere; `None` where there are none.
    pub(crate) fn learn(eyes: &[EyeVertex], (center, radius): (Vec3, f32)) -> Option<Self> {
        let per_length = CELLS / (2.0 * radius);
        let cells = [CELLS as usize + 2; 3];
        let least = center - radius - Vec3::splat(1.0 / per_length);
        let mut keep =
            Self { least, per_length, cells, gains: vec![0.0; cells.iter().product()], mean: 0.0, share: 1.0 };
        for eye in eyes {
            let at = keep.cell(eye.hit.point.p);
            for (x, y, z) in around(at, cells) {
                let cell = keep.number([x, y, z]);
                keep.gains[cell] += eye.gain;
            }
        }
        eyes.iter().any(|eye| eye.gain > 0.0).then_some(keep)
    }

    /// Learns v̄ by what paths may bring.
    pub(crate) fn compare_with(&mut self, brought: &[f32]) {
        let n = brought.len().max(1) as f32;
        self.mean = brought.iter().sum::<f32>() / n;
        self.share = brought.iter().map(|v| self.chance(*v)).sum::<f32>() / n;
    }

    /// What a path may bring.
    pub(crate) fn brings(&self, path: &[Vertex]) -> f32 {
        path.iter().map(|v| luminance(v.throughput) * self.gains[self.number(self.cell(v.hit.point.p))]).sum()
    }

    /// The chance to keep a path that may bring this much.
    pub(crate) fn chance(&self, brings: f32) -> f32 {
        if self.mean > 0.0 { (brings / self.mean).clamp(LEAST, 1.0) } else { 1.0 }
    }

    fn cell(&self, p: Vec3) -> [usize; 3] {
        let at = ((p - self.least) * self.per_length).max(Vec3::ZERO).to_array();
        [0, 1, 2].map(|axis| (at[axis] as usize).min(self.cells[axis] - 1))
    }

    fn number(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.cells[1] + y) * self.cells[0] + x
    }
}

/// A cell and those around it.
fn around(at: [usize; 3], cells: [usize; 3]) -> impl Iterator<Item = (usize, usize, usize)> {
    let near = move |axis: usize| at[axis].saturating_sub(1)..(at[axis] + 2).min(cells[axis]);
    near(2).flat_map(move |z| near(1).flat_map(move |y| near(0).map(move |x| (x, y, z))))
}
