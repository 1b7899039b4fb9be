//! A tree over lights that chooses one for a point with a chance that follows its contribution there.
//!
//! Source: Conty Estevez & Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting", without the
//! splitting, with the bounds as in pbrt-v4: each node keeps a box, a power, and a cone of normals; the importance of a node
//! is a bound of power · cosines / distance², and a descent chooses children in proportion. The chance of a light is zero only
//! where it contributes nothing, so sampling stays unbiased, and is told for any light by walking its path again.
//!
//! Deviation: the cosine at the receiver counts one side only (the caller gives no normal where light passes through).

use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, PI};
use translume_mesh::Bounds;

/// What is known of a light, or of many.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LightBounds {
    pub(crate) bounds: Bounds,
    /// Emitted power; in any unit common to all lights.
    pub(crate) power: f32,
    /// Axis of the cone of normals.
    pub(crate) axis: Vec3,
    /// Half the cone's opening.
    pub(crate) theta_o: f32,
    /// How far from a normal light is emitted.
    pub(crate) theta_e: f32,
}

impl LightBounds {
    fn join(&self, other: &Self) -> Self {
        let mut bounds = self.bounds;
        bounds.join(&other.bounds);
        let (axis, theta_o) = join_cones((self.axis, self.theta_o), (other.axis, other.theta_o));
        Self { bounds, power: self.power + other.power, axis, theta_o, theta_e: self.theta_e.max(other.theta_e) }
    }

    /// The orientation measure of the building cost: the solid angle of the cone, with the emission's fall-off.
    fn spread(&self) -> f32 {
        let (o, w) = (self.theta_o, (self.theta_o + self.theta_e).min(PI));
        let (sin, cos) = o.sin_cos();
        2.0 * PI * (1.0 - cos) + FRAC_PI_2 * (2.0 * w * sin - (o - 2.0 * w).cos() - 2.0 * o * sin + cos)
    }
}

/// The cone around two cones.
fn join_cones(a: (Vec3, f32), b: (Vec3, f32)) -> (Vec3, f32) {
    let (a, b) = if a.1 >= b.1 { (a, b) } else { (b, a) };
    let between = angle(a.0, b.0);
    if (between + b.1).min(PI) <= a.1 {
        return a;
    }
    let half = 0.5 * (a.1 + between + b.1);
    let around = a.0.cross(b.0);
    if half >= PI || around.length_squared() < 1e-12 {
        return (a.0, PI);
    }
    let turned = glam::Quat::from_axis_angle(around.normalize(), half - a.1) * a.0;
    (turned.normalize(), half)
}

fn angle(a: Vec3, b: Vec3) -> f32 {
    // Precise for small and for large angles, unlike the arc cosine.
    2.0 * (a - b).length().atan2((a + b).length())
}

#[derive(Clone, Copy, Debug)]
struct Node {
    center: Vec3,
    /// Half the diagonal of the box.
    radius: f32,
    lo: Vec3,
    hi: Vec3,
    axis: Vec3,
    power: f32,
    sin_o: f32,
    cos_o: f32,
    cos_e: f32,
    /// Of inner nodes the second child (the first follows its parent); of leaves the light.
    index: u32,
    leaf: bool,
}

impl Node {
    fn new(b: &LightBounds, index: u32, leaf: bool) -> Self {
        let (sin_o, cos_o) = b.theta_o.sin_cos();
        Self {
            center: b.bounds.center(),
            radius: 0.5 * b.bounds.extent().length(),
            lo: b.bounds.lo,
            hi: b.bounds.hi,
            axis: b.axis,
            power: b.power,
            sin_o,
            cos_o: if b.theta_o >= PI { -1.0 } else { cos_o },
            cos_e: b.theta_e.cos(),
            index,
            leaf,
        }
    }

    /// A bound of the contribution at `p`, whose receiving normal is `n` (zero: receives from everywhere).
    #[inline]
    fn importance(&self, p: Vec3, n: Vec3) -> f32 {
        let to_center = self.center - p;
        let d2 = to_center.length_squared();
        let distance2 = d2.max(self.radius * self.radius).max(1e-30);
        let inside = p.cmpge(self.lo).all() && p.cmple(self.hi).all();
        // The box is seen under the half angle θ_b.
        let (sin_b, cos_b) = if inside || d2 <= self.radius * self.radius {
            (0.0, -1.0)
        } else {
            let sin2 = self.radius * self.radius / d2;
            (sin2.sqrt(), (1.0 - sin2).max(0.0).sqrt())
        };
        let wi = to_center / d2.max(1e-30).sqrt();
        let mut importance = self.power / distance2;
        if cos_b > -1.0 {
            // θ' = θ_w − θ_o − θ_b, the least angle between a normal and the way to p.
            let cos_w = (-wi).dot(self.axis).clamp(-1.0, 1.0);
            let sin_w = (1.0 - cos_w * cos_w).sqrt();
            let (cos_x, sin_x) = less(cos_w, sin_w, self.cos_o, self.sin_o);
            let (cos, _) = less(cos_x, sin_x, cos_b, sin_b);
            if cos <= self.cos_e {
                return 0.0;
            }
            importance *= cos.max(1e-3); // lights that shine beyond 90° from their normals
            if n != Vec3::ZERO {
                let cos_i = wi.dot(n).clamp(-1.0, 1.0);
                let (cos, _) = less(cos_i, (1.0 - cos_i * cos_i).sqrt(), cos_b, sin_b);
                importance *= cos.max(0.0);
            }
        }
        importance
    }
}

/// Cosine and sine of max(0, a − b).
#[inline]
fn less(cos_a: f32, sin_a: f32, cos_b: f32, sin_b: f32) -> (f32, f32) {
    if cos_a > cos_b {
        (1.0, 0.0)
    } else {
        ((cos_a * cos_b + sin_a * sin_b).min(1.0), (sin_a * cos_b - cos_a * sin_b).max(0.0))
    }
}

/// The tree. Lights of no power are not in it.
#[derive(Clone, Debug, Default)]
pub(crate) struct LightTree {
    nodes: Vec<Node>,
    /// Per light the way down to it, one bit a level from the lowest (0: first child); `None`: not in the tree.
    trails: Vec<Option<u64>>,
}

const BUCKETS: usize = 12;
/// Bits of a trail; deeper than that, halves are split by number.
const MOST_DEPTH: u32 = 62;

impl LightTree {
    pub(crate) fn new(lights: &[Option<LightBounds>]) -> Self {
        let mut items: Vec<(u32, LightBounds)> = lights
            .iter()
            .enumerate()
            .filter_map(|(i, b)| b.map(|b| (i as u32, b)))
            .filter(|(_, b)| b.power > 0.0 && b.power.is_finite() && !b.bounds.is_empty())
            .collect();
        let mut tree = Self { nodes: Vec::with_capacity(2 * items.len()), trails: vec![None; lights.len()] };
        if !items.is_empty() {
            tree.build(&mut items, 0, 0);
        }
        tree
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    fn build(&mut self, items: &mut [(u32, LightBounds)], trail: u64, depth: u32) -> LightBounds {
        if let [(light, bounds)] = items {
            self.trails[*light as usize] = Some(trail);
            self.nodes.push(Node::new(bounds, *light, true));
            return *bounds;
        }
        let middle = split(items, depth);
        let at = self.nodes.len();
        self.nodes.push(Node::new(&items[0].1, 0, false)); // replaced below
        let (first, second) = items.split_at_mut(middle);
        let a = self.build(first, trail, depth + 1);
        let second_at = self.nodes.len() as u32;
        let b = self.build(second, trail | 1 << depth, depth + 1);
        let joined = a.join(&b);
        self.nodes[at] = Node::new(&joined, second_at, false);
        joined
    }

    /// Chooses a light for the point `p` with normal `n`; its number and its probability. `None`: none contributes.
    #[inline]
    pub(crate) fn sample(&self, p: Vec3, n: Vec3, u: f32) -> Option<(usize, f32)> {
        if self.nodes.is_empty() {
            return None;
        }
        let (mut at, mut u, mut pmf) = (0, u, 1.0);
        loop {
            let node = &self.nodes[at];
            if node.leaf {
                // A root that is a leaf has not been asked whether it contributes.
                return (at > 0 || node.importance(p, n) > 0.0).then_some((node.index as usize, pmf));
            }
            let first = self.first_share(at, p, n)?;
            if u < first {
                (u, pmf, at) = (u / first, pmf * first, at + 1);
            } else {
                let rest = 1.0 - first;
                (u, pmf, at) = ((u - first) / rest, pmf * rest, node.index as usize);
            }
            u = u.min(translume_core::warp::ONE_MINUS_EPSILON);
        }
    }

    /// The chance that [`LightTree::sample`] chooses `light`.
    #[inline]
    pub(crate) fn probability(&self, p: Vec3, n: Vec3, light: usize) -> f32 {
        let Some(Some(mut trail)) = self.trails.get(light).copied() else { return 0.0 };
        let (mut at, mut pmf) = (0, 1.0);
        loop {
            let node = &self.nodes[at];
            if node.leaf {
                return if at > 0 || node.importance(p, n) > 0.0 { pmf } else { 0.0 };
            }
            let Some(first) = self.first_share(at, p, n) else { return 0.0 };
            (pmf, at) = if trail & 1 == 0 { (pmf * first, at + 1) } else { (pmf * (1.0 - first), node.index as usize) };
            trail >>= 1;
            if pmf <= 0.0 {
                return 0.0;
            }
        }
    }

    /// The share of the first child of the inner node `at`.
    #[inline]
    fn first_share(&self, at: usize, p: Vec3, n: Vec3) -> Option<f32> {
        let a = self.nodes[at + 1].importance(p, n);
        let b = self.nodes[self.nodes[at].index as usize].importance(p, n);
        (a + b > 0.0).then(|| a / (a + b))
    }
}

/// Reorders `items` and returns where the second half begins: by the cost power · spread · area over the buckets of the
/// widest axes; down the middle where that tells nothing.
fn split(items: &mut [(u32, LightBounds)], depth: u32) -> usize {
    let mut centers = Bounds::EMPTY;
    let mut all = Bounds::EMPTY;
    for (_, b) in items.iter() {
        centers.grow(b.bounds.center());
        all.join(&b.bounds);
    }
    let bucket = |b: &LightBounds, axis: usize| {
        let x = (b.bounds.center()[axis] - centers.lo[axis]) / centers.extent()[axis];
        ((x * BUCKETS as f32) as usize).min(BUCKETS - 1)
    };
    // Halving from here on stays within the bits of a trail for any number of lights.
    let halve = depth + items.len().ilog2() + 1 >= MOST_DEPTH;
    let mut best: Option<(f32, usize, usize)> = None;
    for axis in (0..3).filter(|&a| !halve && centers.extent()[a] > 0.0) {
        let mut sums = [None::<LightBounds>; BUCKETS];
        for (_, b) in items.iter() {
            let sum = &mut sums[bucket(b, axis)];
            *sum = Some(sum.map_or(*b, |s| s.join(b)));
        }
        let elongation = all.extent().max_element() / all.extent()[axis].max(1e-30);
        for at in 1..BUCKETS {
            let join = |part: &[Option<LightBounds>]| part.iter().flatten().copied().reduce(|a, b| a.join(&b));
            let (Some(a), Some(b)) = (join(&sums[..at]), join(&sums[at..])) else { continue };
            let cost = |b: &LightBounds| b.power * b.spread() * b.bounds.half_area().max(1e-30);
            let cost = elongation * (cost(&a) + cost(&b));
            if best.is_none_or(|(c, ..)| cost < c) {
                best = Some((cost, axis, at));
            }
        }
    }
    let Some((_, axis, at)) = best else { return items.len() / 2 };
    items.sort_by_key(|(_, b)| bucket(b, axis) >= at); // stable: the same tree on every machine
    items.partition_point(|(_, b)| bucket(b, axis) < at)
}

#[cfg(test)]
mod tests {
    use super::*;
    use translume_core::{rng::Pcg32, stats};

    fn lights(n: usize) -> Vec<Option<LightBounds>> {
        let mut rng = Pcg32::new(5, 1);
        let mut v = || Vec3::new(rng.next_f32(), rng.next_f32(), rng.next_f32()) * 2.0 - 1.0;
        (0..n)
            .map(|i| {
                let (p, size, axis) = (v() * 4.0, v() * 0.2, v());
                let mut bounds = Bounds::EMPTY;
                bounds.grow(p);
                bounds.grow(p + size);
                let power = if i % 7 == 3 { 0.0 } else { 0.1 + v().x.abs() };
                let theta_o = if i % 3 == 0 { PI } else { 0.0 };
                Some(LightBounds { bounds, power, axis: axis.normalize(), theta_o, theta_e: FRAC_PI_2 })
            })
            .collect()
    }

    #[test]
    fn chances_sum_to_one_and_are_those_of_sampling() {
        let lights = lights(60);
        let tree = LightTree::new(&lights);
        let mut rng = Pcg32::new(9, 2);
        for case in 0..20 {
            let p = Vec3::new(rng.next_f32(), rng.next_f32(), rng.next_f32()) * 8.0 - 4.0;
            let n = if case % 2 == 0 { Vec3::ZERO } else { Vec3::new(rng.next_f32(), 1.0, -0.5).normalize() };
            let probabilities: Vec<f64> = (0..60).map(|i| f64::from(tree.probability(p, n, i))).collect();
            let total: f64 = probabilities.iter().sum();
            assert!(total < 1.0 + 1e-5);
            let samples = 40_000;
            let mut seen = vec![0.0; 61];
            for _ in 0..samples {
                match tree.sample(p, n, rng.next_f32()) {
                    Some((i, pmf)) => {
                        assert!((f64::from(pmf) - probabilities[i]).abs() < 1e-5 * probabilities[i].max(1e-3));
                        seen[i] += 1.0;
                    }
                    None => seen[60] += 1.0,
                }
            }
            // Only a descent that ends where nothing contributes loses probability.
            let mut expected: Vec<f64> = probabilities.iter().map(|p| p * f64::from(samples)).collect();
            expected.push((1.0 - total).max(0.0) * f64::from(samples));
            stats::chi2_test(&seen, &expected, stats::sidak(1e-3, 20)).unwrap();
            if n == Vec3::ZERO && (0..60).all(|i| i % 3 == 0 || probabilities[i] > 0.0) {
                assert!((total - 1.0).abs() < 1e-5, "{total}");
            }
        }
    }

    /// A light that shines at a point is never left out.
    #[test]
    fn no_light_that_contributes_has_no_chance() {
        let mut rng = Pcg32::new(11, 4);
        let lights = lights(40);
        let tree = LightTree::new(&lights);
        for _ in 0..2000 {
            let p = Vec3::new(rng.next_f32(), rng.next_f32(), rng.next_f32()) * 8.0 - 4.0;
            for (i, light) in lights.iter().enumerate() {
                let light = light.unwrap();
                let way = p - light.bounds.center();
                let shines = light.theta_o >= PI || way.dot(light.axis) > 1e-4;
                if light.power > 0.0 && shines {
                    assert!(tree.probability(p, Vec3::ZERO, i) > 0.0, "{i} at {p}");
                }
            }
        }
    }

    #[test]
    fn many_lights_in_one_place() {
        let bounds = Bounds { lo: Vec3::ONE, hi: Vec3::ONE };
        let light = LightBounds { bounds, power: 1.0, axis: Vec3::Z, theta_o: PI, theta_e: FRAC_PI_2 };
        let tree = LightTree::new(&vec![Some(light); 1000]);
        let total: f32 = (0..1000).map(|i| tree.probability(Vec3::ZERO, Vec3::ZERO, i)).sum();
        assert!((total - 1.0).abs() < 1e-3, "{total}");
    }
}
