//! Points in a balanced tree with tight boxes, asked for those within a sphere.
//!
//! Source: the balanced box decomposition tree that Bekaert et al. 2003 (§5) use, after Arya and Mount 1995; ours splits at
//! the median of the longest side. The queries go sphere by sphere over the points, not point by point over the spheres.

use glam::Vec3;
use translume_mesh::Bounds;
use wide::f32x8;

/// Most points in a leaf.
const LEAF: usize = 16;

/// Balls that descend together, and most leaves that they may touch: if there are more, they are not near each other.
const TOGETHER: usize = 16;
const MOST_TOUCHED: usize = 64;

/// Points below which one thread builds.
const ALONE: usize = 4096;

/// The tree.
pub(crate) struct Points {
    leaves: Vec<Leaf>,
    /// The boxes of a complete binary tree above them, the root first; children of `i` are 2i + 1 and 2i + 2, and halves of its points.
    boxes: Vec<Bounds>,
}

/// Points that are tested at once; those that are not there are infinitely far.
struct Leaf {
    bounds: Bounds,
    places: [[f32x8; 3]; LEAF / 8],
    numbers: [u32; LEAF],
}

impl Leaf {
    fn new(points: &[(Vec3, u32)]) -> Self {
        let mut bounds = Bounds::EMPTY;
        points.iter().for_each(|(p, _)| bounds.grow(*p));
        let of = |i: usize| points.get(i).copied().unwrap_or((Vec3::INFINITY, 0));
        let eight = |first: usize, axis: usize| f32x8::new(std::array::from_fn(|lane| of(first + lane).0[axis]));
        let places = std::array::from_fn(|k| std::array::from_fn(|axis| eight(8 * k, axis)));
        Self { bounds, places, numbers: std::array::from_fn(|i| of(i).1) }
    }

    #[inline(always)]
    fn within(&self, ball: Ball, each: &mut impl FnMut(u32)) {
        if !ball.touches(&self.bounds) {
            return;
        }
        for (k, [x, y, z]) in self.places.iter().enumerate() {
            let (x, y, z) = (*x - ball.center.x, *y - ball.center.y, *z - ball.center.z);
            let mut found = (x * x + y * y + z * z).simd_le(f32x8::splat(ball.radius2)).to_bitmask();
            while found != 0 {
                each(self.numbers[8 * k + found.trailing_zeros() as usize]);
                found &= found - 1;
            }
        }
    }
}

#[derive(Clone, Copy)]
struct Ball {
    center: Vec3,
    /// The radius squared.
    radius2: f32,
}

impl Ball {
    /// An empty box is infinitely far.
    #[inline(always)]
    fn touches(&self, b: &Bounds) -> bool {
        self.center.max(b.lo).min(b.hi).distance_squared(self.center) <= self.radius2
    }
}

impl Points {
    /// Of numbered points.
    pub(crate) fn new(mut points: Vec<(Vec3, u32)>) -> Self {
        let mut levels = 0;
        while points.len().div_ceil(1 << levels) > LEAF {
            levels += 1;
        }
        let inner = (1 << levels) - 1;
        let mut boxes = vec![Bounds::EMPTY; inner];
        let leaves = build(&mut points, &mut boxes, 1 << levels);
        Self { leaves: leaves.into_iter().map(|points| Leaf::new(points)).collect(), boxes }
    }

    /// Calls `each` with the number of every point within `radius` of `center`.
    #[inline]
    pub(crate) fn within(&self, center: Vec3, radius: f32, mut each: impl FnMut(u32)) {
        self.visit(0, Ball { center, radius2: radius * radius }, &mut each);
    }

    /// The same for many, with `each` called ball by ball. Those that follow each other had better be near each other.
    pub(crate) fn within_all<T>(&self, balls: &[T], of: impl Fn(&T) -> (Vec3, f32), mut each: impl FnMut(&T, u32)) {
        let mut touched = Vec::new();
        for group in balls.chunks(TOGETHER) {
            let mut around = Bounds::EMPTY;
            for (center, radius) in group.iter().map(&of) {
                around.grow(center - radius);
                around.grow(center + radius);
            }
            touched.clear();
            self.touch(0, &around, &mut touched);
            for ball in group {
                let (center, radius) = of(ball);
                let place = Ball { center, radius2: radius * radius };
                let mut each = |number| each(ball, number);
                if touched.len() > MOST_TOUCHED {
                    self.visit(0, place, &mut each);
                } else {
                    touched.iter().for_each(|leaf| self.leaves[*leaf].within(place, &mut each));
                }
            }
        }
    }

    fn visit(&self, node: usize, ball: Ball, each: &mut impl FnMut(u32)) {
        let Some(bounds) = self.boxes.get(node) else {
            return self.leaves[node - self.boxes.len()].within(ball, each);
        };
        if ball.touches(bounds) {
            self.visit(2 * node + 1, ball, each);
            self.visit(2 * node + 2, ball, each);
        }
    }

    /// Leaves that may have points in this box, until there are too many.
    fn touch(&self, node: usize, around: &Bounds, touched: &mut Vec<usize>) {
        let Some(bounds) = self.boxes.get(node) else {
            touched.push(node - self.boxes.len());
            return;
        };
        let apart = around.lo.cmpgt(bounds.hi).any() || bounds.lo.cmpgt(around.hi).any();
        if !apart && touched.len() <= MOST_TOUCHED {
            self.touch(2 * node + 1, around, touched);
            self.touch(2 * node + 2, around, touched);
        }
    }
}

/// Sorts `points` into `leaves` leaves (a power of two), with the boxes above in the order of [`Points::boxes`].
fn build<'a>(points: &'a mut [(Vec3, u32)], boxes: &mut [Bounds], leaves: usize) -> Vec<&'a mut [(Vec3, u32)]> {
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
    slices
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
            // Near each other, and all over the place.
            for spread in [0.02, 1.0] {
                let ball = |_| ((rng.next_2d() * spread).extend(0.05), rng.next_1d() * 0.1);
                let balls: Vec<(Vec3, f32)> = (0..50).map(ball).collect();
                let (mut together, mut alone) = (Vec::new(), Vec::new());
                tree.within_all(&balls, |ball| *ball, |ball, i| together.push((ball.1, i)));
                balls.iter().for_each(|ball| tree.within(ball.0, ball.1, |i| alone.push((ball.1, i))));
                assert_eq!(together, alone, "{n} points, {spread}");
            }
        }
    }
}
