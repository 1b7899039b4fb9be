//! Points in a balanced tree with tight boxes, asked for those within a sphere.
//!
//! Source: the balanced box decomposition tree that Bekaert et al. 2003 (§5) use, after Arya and Mount 1995; ours splits at
//! the median of the longest side. The queries go sphere by sphere over the points, not point by point over the spheres.

use glam::Vec3;
use translume_mesh::Bounds;

/// Points in a leaf.
const LEAF: usize = 16;

/// Points below which one thread builds.
const ALONE: usize = 4096;

/// The tree.
pub(crate) struct Points {
    /// Places and numbers, leaf after leaf.
    points: Vec<(Vec3, u32)>,
    /// The boxes of a complete binary tree, the root first; children of `i` are 2i + 1 and 2i + 2, and halves of its points.
    boxes: Vec<Bounds>,
    levels: u32,
}

impl Points {
    /// Of numbered points.
    pub(crate) fn new(mut points: Vec<(Vec3, u32)>) -> Self {
        let mut levels = 0;
        while points.len() >> levels > LEAF {
            levels += 1;
        }
        let inner = (1 << levels) - 1;
        let mut boxes = vec![Bounds::EMPTY; inner];
        build(&mut points, &mut boxes, 1 << levels);
        Self { points, boxes, levels }
    }

    /// Calls `each` with the number of every point within `radius` of `center`.
    #[inline]
    pub(crate) fn within(&self, center: Vec3, radius: f32, mut each: impl FnMut(u32)) {
        self.visit(0, 0, self.points.len(), self.levels, (center, radius * radius), &mut each);
    }

    fn visit(&self, node: usize, begin: usize, end: usize, levels: u32, ball: (Vec3, f32), each: &mut impl FnMut(u32)) {
        if levels == 0 {
            for (p, number) in &self.points[begin..end] {
                if p.distance_squared(ball.0) <= ball.1 {
                    each(*number);
                }
            }
            return;
        }
        let b = &self.boxes[node];
        // An empty box is infinitely far.
        if ball.0.max(b.lo).min(b.hi).distance_squared(ball.0) > ball.1 {
            return;
        }
        let middle = begin + (end - begin) / 2;
        self.visit(2 * node + 1, begin, middle, levels - 1, ball, each);
        self.visit(2 * node + 2, middle, end, levels - 1, ball, each);
    }
}

/// Sorts `points` into `leaves` leaves (a power of two) and returns their boxes in the order of [`Points::boxes`].
fn build(points: &mut [(Vec3, u32)], boxes: &mut [Bounds], leaves: usize) {
    // Level by level, so that each level's boxes lie side by side.
    let mut slices = vec![points];
    let mut rest = boxes;
    let mut count = 1;
    while count < leaves {
        let (here, below) = rest.split_at_mut(count);
        rest = below;
        let halves: Vec<[&mut [(Vec3, u32)]; 2]> = split_all(slices, here);
        slices = halves.into_iter().flatten().collect();
        count *= 2;
    }
}

fn split_all<'a>(slices: Vec<&'a mut [(Vec3, u32)]>, boxes: &mut [Bounds]) -> Vec<[&'a mut [(Vec3, u32)]; 2]> {
    use rayon::prelude::*;
    let total: usize = slices.iter().map(|s| s.len()).sum();
    if total < ALONE {
        return slices.into_iter().zip(boxes).map(|(s, b)| split(s, b)).collect();
    }
    slices.into_par_iter().zip(boxes).map(|(s, b)| split(s, b)).collect()
}

fn split<'a>(points: &'a mut [(Vec3, u32)], bounds: &mut Bounds) -> [&'a mut [(Vec3, u32)]; 2] {
    points.iter().for_each(|(p, _)| bounds.grow(*p));
    let middle = points.len() / 2;
    let size = bounds.hi - bounds.lo;
    let axis = (0..3).fold(0, |best, a| if size[a] > size[best] { a } else { best });
    if middle > 0 {
        points.select_nth_unstable_by(middle, |a, b| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1)));
    }
    let (a, b) = points.split_at_mut(middle);
    [a, b]
}

#[cfg(test)]
mod tests {
    use super::*;
    use translume_core::rng::Pcg32;
    use translume_core::sampler::Sampler;

    #[test]
    fn the_same_points_as_by_looking_at_all() {
        let mut rng = Pcg32::new(3, 1);
        for n in [0, 1, 7, 8, 9, 17, 1000, 5000] {
            let points: Vec<(Vec3, u32)> = (0..n).map(|i| (rng.next_2d().extend(rng.next_1d() * 0.1), i)).collect();
            let tree = Points::new(points.clone());
            for _ in 0..50 {
                let (center, radius) = (rng.next_2d().extend(rng.next_1d() * 0.1), rng.next_1d() * 0.3);
                let mut found = Vec::new();
                tree.within(center, radius, |i| found.push(i));
                found.sort_unstable();
                let all = points.iter().filter(|(p, _)| p.distance_squared(center) <= radius * radius);
                assert_eq!(found, all.map(|p| p.1).collect::<Vec<_>>(), "{n} points");
            }
        }
    }
}
