//! A tree over lights that chooses one for a point with a chance that follows its contribution there.
//!
//! Source: Conty Estevez & Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting", without the
//! splitting, with the bounds as in pbrt-v4: of each child a node keeps a sphere, a power, and a cone of normals; the
//! importance of a child is a bound of power · cosines / distance², and a descent chooses children in proportion. The chance of
//! a light is zero only where it contributes nothing, so sampling stays unbiased, and is told for any light by walking its path
//! again.
//!
//! Deviations: the cosine at the receiver counts one side only (the caller gives no normal where light passes through); nodes
//! have four children, whose importances are computed at once.

use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, PI};
use translume_mesh::Bounds;
use wide::f32x4;

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

/// Four children, a lane each. Missing ones have no power.
#[derive(Clone, Copy, Debug)]
struct Node {
    center: [f32x4; 3],
    /// Square of half the diagonal of the box.
    radius2: f32x4,
    axis: [f32x4; 3],
    power: f32x4,
    sin_o: f32x4,
    cos_o: f32x4,
    cos_e: f32x4,
    children: [Child; 4],
}

/// Factors on the importances of the children of the first nodes; only their ratios within a node count.
pub(crate) type Factors<'a> = &'a [[u8; 4]];

/// A point that chooses several lights: the nodes on its ways down, of which the upper ones are the same.
pub(crate) struct Place<'a> {
    p: Vec3,
    n: Vec3,
    seen: Option<Factors<'a>>,
    /// Numbers of nodes, and their children's importances.
    known: [(usize, [f32; 4]); KNOWN],
}

/// A power of two.
const KNOWN: usize = 16;

impl<'a> Place<'a> {
    /// As of [`LightTree::sample`].
    pub(crate) fn new(p: Vec3, n: Vec3, seen: Option<Factors<'a>>) -> Self {
        Self { p, n, seen, known: [(usize::MAX, [0.0; 4]); KNOWN] }
    }

    #[inline(always)]
    fn importance(&mut self, at: usize, node: &Node) -> [f32; 4] {
        let slot = &mut self.known[at % KNOWN];
        if slot.0 != at {
            *slot = (at, node.importance(self.p, self.n, factors(self.seen, at)));
        }
        slot.1
    }
}

/// A step on the way down to a light.
pub(crate) struct Trail {
    pub(crate) node: usize,
    pub(crate) lane: usize,
}

/// A node, or (highest bit) a light.
#[derive(Clone, Copy, Debug)]
struct Child(u32);

impl Child {
    const LIGHT: u32 = 1 << 31;

    fn light(self) -> Option<usize> {
        (self.0 & Self::LIGHT != 0).then_some((self.0 & !Self::LIGHT) as usize)
    }

    /// A missing child is as the root, which is nobody's child.
    fn node(self) -> Option<usize> {
        (self.0 & Self::LIGHT == 0 && self.0 > 0).then_some(self.0 as usize)
    }
}

impl Node {
    /// Of at most four children.
    fn new(of: &[(LightBounds, Child)]) -> Self {
        let lanes = |f: &dyn Fn(&LightBounds) -> f32| {
            f32x4::new(std::array::from_fn(|lane| of.get(lane).map_or(0.0, |(bounds, _)| f(bounds))))
        };
        Self {
            center: [0, 1, 2].map(|k| lanes(&|b| b.bounds.center()[k])),
            radius2: lanes(&|b| 0.25 * b.bounds.extent().length_squared()),
            axis: [0, 1, 2].map(|k| lanes(&|b| b.axis[k])),
            power: lanes(&|b| b.power),
            sin_o: lanes(&|b| b.theta_o.sin()),
            cos_o: lanes(&|b| if b.theta_o >= PI { -1.0 } else { b.theta_o.cos() }),
            cos_e: lanes(&|b| b.theta_e.cos()),
            children: std::array::from_fn(|lane| of.get(lane).map_or(Child(0), |c| c.1)),
        }
    }

    /// Bounds of the children's contributions at `p`, whose receiving normal is `n` (zero: receives from everywhere), times
    /// these factors.
    #[inline]
    fn importance(&self, p: Vec3, n: Vec3, factors: f32x4) -> [f32; 4] {
        let [x, y, z] = [self.center[0] - p.x, self.center[1] - p.y, self.center[2] - p.z];
        let d2 = x * x + y * y + z * z;
        let inverse = 1.0 / d2.fast_max(self.radius2).fast_max(f32x4::splat(1e-30)).sqrt();
        // The child is seen under the half angle θ_b.
        let sin2_b = self.radius2 * (inverse * inverse);
        let b = (root(1.0 - sin2_b), sin2_b.sqrt());
        // θ' = θ_w − θ_o − θ_b, the least angle between a normal and the way to p.
        let cos_w = -(x * self.axis[0] + y * self.axis[1] + z * self.axis[2]) * inverse;
        let cos = less(less((cos_w, sine(cos_w)), (self.cos_o, self.sin_o)), b).0;
        let bound = cos.fast_max(f32x4::splat(1e-3)); // some shine beyond 90° from their normals
        let mut directed = cos.simd_gt(self.cos_e) & bound;
        if n != Vec3::ZERO {
            let cos_i = (x * n.x + y * n.y + z * n.z) * inverse;
            directed *= less((cos_i, sine(cos_i)), b).0.fast_max(f32x4::ZERO);
        }
        // From inside the sphere around the child nothing is known of directions.
        let known = d2.simd_gt(self.radius2).bitselect(directed, f32x4::ONE);
        (self.power * factors * (inverse * inverse) * known).to_array()
    }
}

/// Of a node, from those of all.
#[inline(always)]
fn factors(seen: Option<Factors>, node: usize) -> f32x4 {
    seen.and_then(|of| of.get(node)).map_or(f32x4::ONE, |of| f32x4::new(of.map(f32::from)))
}

#[inline(always)]
fn root(x: f32x4) -> f32x4 {
    x.fast_max(f32x4::ZERO).sqrt()
}

#[inline(always)]
fn sine(cosine: f32x4) -> f32x4 {
    root(1.0 - cosine * cosine)
}

/// Cosine and sine of max(0, a − b).
#[inline(always)]
fn less((cos_a, sin_a): (f32x4, f32x4), (cos_b, sin_b): (f32x4, f32x4)) -> (f32x4, f32x4) {
    let (cos, sin) = (cos_a * cos_b + sin_a * sin_b, (sin_a * cos_b - cos_a * sin_b).fast_max(f32x4::ZERO));
    let within = cos_a.simd_gt(cos_b);
    (within.bitselect(f32x4::ONE, cos), within.bitselect(f32x4::ZERO, sin))
}

/// The tree. Lights of no power are not in it.
#[derive(Clone, Debug, Default)]
pub(crate) struct LightTree {
    nodes: Vec<Node>,
    /// Per light the way down to it, two bits a level from the lowest; `None`: not in the tree.
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
        let mut tree = Self { nodes: Vec::with_capacity(items.len()), trails: vec![None; lights.len()] };
        if !items.is_empty() {
            tree.build(&mut items, 0, 0);
            tree.nodes = by_level(&tree.nodes);
        }
        tree
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// Appends the node of `items`, which is `depth` bits down along `trail`, and all below it.
    fn build(&mut self, items: &mut [(u32, LightBounds)], trail: u64, depth: u32) -> LightBounds {
        let at = self.nodes.len();
        self.nodes.push(Node::new(&[])); // replaced below
        let mut children = Vec::with_capacity(4);
        for part in halves(items, depth).into_iter().flat_map(|half| halves(half, depth + 1)) {
            let trail = trail | (children.len() as u64) << depth;
            children.push(match part {
                [(light, bounds)] => {
                    self.trails[*light as usize] = Some(trail);
                    (*bounds, Child(Child::LIGHT | *light))
                }
                _ => {
                    let child = Child(self.nodes.len() as u32);
                    (self.build(part, trail, depth + 2), child)
                }
            });
        }
        self.nodes[at] = Node::new(&children);
        children[1..].iter().fold(children[0].0, |all, (bounds, _)| all.join(bounds))
    }

    /// How many nodes there are.
    pub(crate) fn nodes(&self) -> usize {
        self.nodes.len()
    }

    /// The children of a node that are nodes, which come after it.
    pub(crate) fn children(&self, node: usize) -> impl Iterator<Item = (usize, usize)> {
        let children = self.nodes[node].children.iter().enumerate();
        children.filter_map(|(lane, child)| Some((lane, child.node()?)))
    }

    /// The way down to `light`; none for one that is not in the tree.
    pub(crate) fn trail(&self, light: usize) -> impl Iterator<Item = Trail> {
        let mut next = self.trails[light].map(|trail| (Child(0), trail));
        std::iter::from_fn(move || {
            let (Child(node), trail) = next.filter(|(child, _)| child.light().is_none())?;
            let lane = (trail & 3) as usize;
            next = Some((self.nodes[node as usize].children[lane], trail >> 2));
            Some(Trail { node: node as usize, lane })
        })
    }

    /// Chooses a light for the point `p` with normal `n`; its number and its probability. `None`: none contributes. `seen` is
    /// what is known there.
    #[inline]
    pub(crate) fn sample(&self, p: Vec3, n: Vec3, seen: Option<Factors>, u: f32) -> Option<(usize, f32)> {
        self.descend(u, |at, node| node.importance(p, n, factors(seen, at)))
    }

    /// The same at a place that asks several times.
    #[inline]
    pub(crate) fn sample_at(&self, place: &mut Place, u: f32) -> Option<(usize, f32)> {
        self.descend(u, |at, node| place.importance(at, node))
    }

    #[inline(always)]
    fn descend(&self, u: f32, mut importance_of: impl FnMut(usize, &Node) -> [f32; 4]) -> Option<(usize, f32)> {
        let (mut at, mut u, mut pmf) = (0, u, 1.0);
        loop {
            let node = self.nodes.get(at)?;
            let importance = importance_of(at, node);
            let total: f32 = importance.iter().sum();
            if !(total > 0.0 && total < f32::INFINITY) {
                return None;
            }
            let (mut lane, mut rest) = (0, u * total);
            // The last one of any importance takes what rounding leaves.
            while rest >= importance[lane] && importance[lane + 1..].iter().any(|&w| w > 0.0) {
                rest -= importance[lane];
                lane += 1;
            }
            pmf *= importance[lane] / total;
            let child = node.children[lane];
            if let Some(light) = child.light() {
                return Some((light, pmf));
            }
            u = (rest / importance[lane]).min(translume_core::warp::ONE_MINUS_EPSILON);
            at = child.0 as usize;
        }
    }

    /// The chance that [`LightTree::sample`] chooses `light`.
    #[inline]
    pub(crate) fn probability(&self, p: Vec3, n: Vec3, seen: Option<Factors>, light: usize) -> f32 {
        let Some(Some(mut trail)) = self.trails.get(light).copied() else { return 0.0 };
        let (mut at, mut pmf) = (0, 1.0);
        loop {
            let node = &self.nodes[at];
            let importance = node.importance(p, n, factors(seen, at));
            let total: f32 = importance.iter().sum();
            let lane = (trail & 3) as usize;
            if !(importance[lane] > 0.0 && total < f32::INFINITY) {
                return 0.0;
            }
            pmf *= importance[lane] / total;
            let child = node.children[lane];
            if child.light().is_some() {
                return pmf;
            }
            trail >>= 2;
            at = child.0 as usize;
        }
    }
}

/// The same nodes, those nearer to the root first.
fn by_level(nodes: &[Node]) -> Vec<Node> {
    let mut sorted: Vec<Node> = vec![nodes[0]];
    let mut at = 0;
    while at < sorted.len() {
        for lane in 0..4 {
            let child = sorted[at].children[lane];
            if let Some(node) = child.node() {
                sorted[at].children[lane] = Child(sorted.len() as u32);
                sorted.push(nodes[node]);
            }
        }
        at += 1;
    }
    sorted
}

/// `items` in two, reordered; one item stays alone.
fn halves(items: &mut [(u32, LightBounds)], depth: u32) -> Vec<&mut [(u32, LightBounds)]> {
    if items.len() < 2 {
        return vec![items];
    }
    let middle = split(items, depth);
    let (first, second) = items.split_at_mut(middle);
    vec![first, second]
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
        // Of the first nodes only, as where there are many.
        let known: Vec<[u8; 4]> = (0..tree.nodes() - 3).map(|i| [255, 13, 60, (i * 31 % 200) as u8 + 20]).collect();
        for case in 0..20 {
            let factors = (case % 3 == 0).then_some(known.as_slice());
            let p = Vec3::new(rng.next_f32(), rng.next_f32(), rng.next_f32()) * 8.0 - 4.0;
            let n = if case % 2 == 0 { Vec3::ZERO } else { Vec3::new(rng.next_f32(), 1.0, -0.5).normalize() };
            let probabilities: Vec<f64> = (0..60).map(|i| f64::from(tree.probability(p, n, factors, i))).collect();
            let total: f64 = probabilities.iter().sum();
            assert!(total < 1.0 + 1e-5);
            let samples = 40_000;
            let mut seen = vec![0.0; 61];
            for _ in 0..samples {
                match tree.sample(p, n, factors, rng.next_f32()) {
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
                    assert!(tree.probability(p, Vec3::ZERO, None, i) > 0.0, "{i} at {p}");
                }
            }
        }
    }

    #[test]
    fn many_lights_in_one_place() {
        let bounds = Bounds { lo: Vec3::ONE, hi: Vec3::ONE };
        let light = LightBounds { bounds, power: 1.0, axis: Vec3::Z, theta_o: PI, theta_e: FRAC_PI_2 };
        let tree = LightTree::new(&vec![Some(light); 1000]);
        let total: f32 = (0..1000).map(|i| tree.probability(Vec3::ZERO, Vec3::ZERO, None, i)).sum();
        assert!((total - 1.0).abs() < 1e-3, "{total}");
    }
}
