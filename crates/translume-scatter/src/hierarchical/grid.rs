//! The nearest of many points of a surface.

use glam::{IVec3, Vec3};
use std::collections::HashMap;

/// Points by cells of space.
pub(super) struct PointGrid {
    cells: HashMap<IVec3, Vec<u32>>,
    cell: f32,
}

impl PointGrid {
    /// `None` without points or for a cell without size.
    pub(super) fn new(points: impl Iterator<Item = Vec3>, cell: f32) -> Option<Self> {
        let mut cells: HashMap<IVec3, Vec<u32>> = HashMap::new();
        if cell.is_nan() || cell <= 0.0 {
            return None;
        }
        for (i, p) in points.enumerate() {
            cells.entry((p / cell).floor().as_ivec3()).or_default().push(i as u32);
        }
        (!cells.is_empty()).then_some(Self { cells, cell })
    }

    /// The nearest point to `p` up to `most` away that is accepted; `at` tells where each is.
    pub(super) fn nearest(
        &self,
        p: Vec3,
        most: f32,
        at: impl Fn(u32) -> Vec3,
        accept: impl Fn(u32) -> bool,
    ) -> Option<u32> {
        let home = (p / self.cell).floor().as_ivec3();
        let mut best = (most, None);
        for ring in 0..=(most / self.cell).ceil() as i32 {
            // Everything in this shell is at least ring − 1 cells away.
            if best.0 < (ring - 1) as f32 * self.cell {
                break;
            }
            let span = || -ring..=ring;
            for d in span().flat_map(|z| span().flat_map(move |y| span().map(move |x| IVec3::new(x, y, z)))) {
                if d.abs().max_element() != ring {
                    continue;
                }
                for &i in self.cells.get(&(home + d)).into_iter().flatten() {
                    let distance = at(i).distance(p);
                    if distance < best.0 && accept(i) {
                        best = (distance, Some(i));
                    }
                }
            }
        }
        best.1
    }
}
