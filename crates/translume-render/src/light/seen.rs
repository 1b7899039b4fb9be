//! Which lights are seen from where: what samples of lights found, as factors on the choices of the light tree.
//!
//! Sources: Vévoda, Kondapaneni, Křivánek 2018 (Bayesian online regression for adaptive direct illumination sampling) for learning, place by
//! place, how much of a light arrives; the estimate here is simpler. Space is cut into cells by the places and normals of the samples. A cell
//! keeps, for every child of every node of the tree, the share s/t of samples of lights below the child that were not in
//! vain, pulled towards that of the whole node: v = (s + k v_node)/(t + k). A part v of samples that bring L each has the second moment
//! v L², so a child's importance is multiplied by √v, relative to the best beside it; never by less than [`LEAST`], so that what was not
//! noticed is found all the same.

use super::tree::{Factors, LightTree, Trail};
use glam::Vec3;
use rayon::prelude::*;
use translume_mesh::Bounds;

/// A place, and the lights that were tried there: their numbers, and whether light of them arrived.
pub(crate) struct VisibilitySample {
    pub(crate) p: Vec3,
    /// The receiving normal.
    pub(crate) n: Vec3,
    pub(crate) lights: Vec<(usize, bool)>,
}

/// What was learnt.
pub(crate) struct LightVisibilityCache {
    cuts: Vec<Cut>,
    /// Cell after cell a factor for each child of each node, in 255ths.
    factors: Vec<[u8; 4]>,
    /// How many nodes of the tree have factors.
    nodes: usize,
}

/// Two halves of space and directions.
#[derive(Clone, Copy)]
struct Cut {
    /// Of the place (0 to 2) or of the normal.
    axis: u32,
    at: f32,
    halves: [Half; 2],
}

#[derive(Clone, Copy)]
enum Half {
    Cut(u32),
    Cell(u32),
}

/// Lights tried in a cell, at least about half as many. Few large cells that are known well serve better than many.
const TRIES: usize = 6000;

/// Most nodes of the tree, from the root, that are told apart: six levels. A cell's factors should stay in the cache.
const MOST_NODES: usize = 1365;

/// Length of a unit normal, over the radius of all places, when cells are cut.
const NORMAL: f32 = 0.2;

/// k.
const PRIOR: f32 = 2.0;

/// Smallest factor.
const LEAST: f32 = 0.05;

impl LightVisibilityCache {
    /// From what was tried. `None` where there is nothing to learn from.
    pub(crate) fn learn(tree: &LightTree, mut tried: Vec<VisibilitySample>) -> Option<Self> {
        let nodes = tree.nodes().min(MOST_NODES);
        if nodes == 0 || tried.is_empty() {
            return None;
        }
        let mut bounds = Bounds::EMPTY;
        tried.iter().for_each(|t| bounds.grow(t.p));
        let normal = NORMAL * 0.5 * bounds.extent().length();
        let mut cells = Cells { cuts: Vec::new(), ends: Vec::new(), normal };
        cells.cut(&mut tried, 0, 0);
        let begins = std::iter::once(0).chain(cells.ends.iter().copied());
        let parts: Vec<&[VisibilitySample]> = begins.zip(&cells.ends).map(|(begin, end)| &tried[begin..*end]).collect();
        let factors = parts.par_iter().flat_map_iter(|part| factors(tree, nodes, part)).collect();
        Some(Self { cuts: cells.cuts, factors, nodes })
    }

    /// Factors on the importances of the tree's nodes, at `p` with the receiving normal `n`.
    #[inline]
    pub(crate) fn from(&self, p: Vec3, n: Vec3) -> Factors<'_> {
        let mut half = if self.cuts.is_empty() { Half::Cell(0) } else { Half::Cut(0) };
        loop {
            match half {
                Half::Cut(i) => {
                    let cut = &self.cuts[i as usize];
                    half = cut.halves[usize::from(coordinate(p, n, cut.axis) >= cut.at)];
                }
                Half::Cell(i) => return &self.factors[i as usize * self.nodes..][..self.nodes],
            }
        }
    }
}

#[inline]
fn coordinate(p: Vec3, n: Vec3, axis: u32) -> f32 {
    if axis < 3 { p[axis as usize] } else { n[axis as usize - 3] }
}

/// While space is cut.
struct Cells {
    cuts: Vec<Cut>,
    /// Where each cell's places end.
    ends: Vec<usize>,
    normal: f32,
}

impl Cells {
    /// Sorts `tried`, of which `before` lie before, into cells.
    fn cut(&mut self, tried: &mut [VisibilitySample], before: usize, depth: u32) -> Half {
        let [mut places, mut normals] = [Bounds::EMPTY; 2];
        for t in tried.iter() {
            places.grow(t.p);
            normals.grow(t.n);
        }
        let of = |axis: u32| match axis {
            0..3 => places.extent()[axis as usize],
            _ => normals.extent()[axis as usize - 3] * self.normal,
        };
        let axis = (0..6).fold(0, |best, axis| if of(axis) > of(best) { axis } else { best });
        let tries: usize = tried.iter().map(|t| t.lights.len()).sum();
        if tries <= TRIES || of(axis) <= 0.0 || depth >= 48 {
            self.ends.push(before + tried.len());
            return Half::Cell(self.ends.len() as u32 - 1);
        }
        let bounds = if axis < 3 { places } else { normals };
        let at = bounds.center()[axis as usize % 3];
        let high = |t: &VisibilitySample| coordinate(t.p, t.n, axis) >= at;
        tried.sort_by_key(high);
        let middle = tried.partition_point(|t| !high(t));
        let here = self.cuts.len();
        self.cuts.push(Cut { axis, at, halves: [Half::Cell(0); 2] });
        let (low, high) = tried.split_at_mut(middle);
        let halves = [self.cut(low, before, depth + 1), self.cut(high, before + middle, depth + 1)];
        self.cuts[here].halves = halves;
        Half::Cut(here as u32)
    }
}

/// Of a cell.
fn factors(tree: &LightTree, nodes: usize, tried: &[VisibilitySample]) -> Vec<[u8; 4]> {
    let mut counts = vec![[[0.0_f32; 2]; 4]; nodes];
    let mut all = [0.0_f32; 2];
    for (light, arrived) in tried.iter().flat_map(|t| &t.lights) {
        let arrived = f32::from(u8::from(*arrived));
        all = [all[0] + arrived, all[1] + 1.0];
        for Trail { node, lane } in tree.trail(*light).take_while(|step| step.node < nodes) {
            let count = &mut counts[node][lane];
            *count = [count[0] + arrived, count[1] + 1.0];
        }
    }
    let mut share = vec![1.0; nodes];
    share[0] = (all[0] + PRIOR) / (all[1] + PRIOR);
    counts
        .iter()
        .enumerate()
        .map(|(node, counts)| {
            // Parents come before their children.
            let shares = counts.map(|[s, t]| (s + PRIOR * share[node]) / (t + PRIOR));
            for (lane, child) in tree.children(node).filter(|(_, child)| *child < nodes) {
                share[child] = shares[lane];
            }
            let best = shares.iter().fold(0.0_f32, |a, b| a.max(*b));
            shares.map(|v| (255.0 * (v / best).sqrt().max(LEAST)).round() as u8)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::tree::LightBounds;
    use super::*;
    use std::f32::consts::{FRAC_PI_2, PI};
    use translume_core::{rng::Pcg32, sampler::Sampler};

    /// Two rooms of 100 lamps each, on both sides of the wall x = 0.
    fn rooms() -> (LightTree, Vec<Vec3>) {
        let mut rng = Pcg32::new(3, 1);
        let side = |i: usize| if i < 100 { -1.0 } else { 1.0 };
        let lamp = |i| Vec3::new(side(i) * (0.2 + 4.0 * rng.next_1d()), 4.0 * rng.next_1d(), 3.0);
        let lamps: Vec<Vec3> = (0..200).map(lamp).collect();
        let bounds = |p: &Vec3| {
            let bounds = Bounds { lo: *p, hi: *p };
            Some(LightBounds { bounds, power: 1.0, axis: Vec3::NEG_Z, theta_o: PI, theta_e: FRAC_PI_2 })
        };
        (LightTree::new(&lamps.iter().map(bounds).collect::<Vec<_>>()), lamps)
    }

    fn known(tree: &LightTree, lamps: &[Vec3]) -> Option<LightVisibilityCache> {
        let mut rng = Pcg32::new(5, 1);
        let place = |i: usize| {
            // Some on either face of the wall itself, which only their normals tell apart.
            let side = if i.is_multiple_of(2) { -1.0 } else { 1.0 };
            let x = if i % 4 < 2 { 0.0 } else { side * 4.0 * rng.next_1d() };
            let (p, n) = (Vec3::new(x, 4.0 * rng.next_1d(), 3.0 * rng.next_1d()), Vec3::X * side);
            let lights = (0..8).filter_map(|_| {
                let (light, _) = tree.sample(p, Vec3::ZERO, None, rng.next_1d())?;
                Some((light, lamps[light].x * side > 0.0))
            });
            VisibilitySample { p, n, lights: lights.collect() }
        };
        LightVisibilityCache::learn(tree, (0..20_000).map(place).collect())
    }

    #[test]
    fn lamps_behind_the_wall_are_chosen_seldom_but_chosen() {
        let (tree, lamps) = rooms();
        let seen = known(&tree, &lamps).unwrap();
        for (p, n) in [(Vec3::new(0.0, 2.0, 1.0), Vec3::X), (Vec3::new(0.0, 1.0, 2.0), Vec3::NEG_X)] {
            let hidden = |factors| -> f32 {
                let behind = (0..200).filter(|&i| lamps[i].x * n.x < 0.0);
                behind.map(|i| tree.probability(p, Vec3::ZERO, factors, i)).sum()
            };
            let (before, after) = (hidden(None), hidden(Some(seen.from(p, n))));
            assert!((0.35..0.65).contains(&before), "{before}");
            assert!(after < 0.2, "{after}");
            assert!((0..200).all(|i| tree.probability(p, Vec3::ZERO, Some(seen.from(p, n)), i) > 0.0));
        }
    }

    #[test]
    fn nothing_tried_is_nothing_learnt() {
        let (tree, _) = rooms();
        assert!(LightVisibilityCache::learn(&tree, Vec::new()).is_none());
        assert!(
            LightVisibilityCache::learn(
                &LightTree::new(&[]),
                vec![VisibilitySample { p: Vec3::ZERO, n: Vec3::Z, lights: Vec::new() }]
            )
            .is_none()
        );
        // Places all alike, and without lights.
        let alike = || VisibilitySample { p: Vec3::ONE, n: Vec3::Z, lights: Vec::new() };
        let seen = LightVisibilityCache::learn(&tree, (0..1000).map(|_| alike()).collect()).unwrap();
        assert!(seen.from(Vec3::ZERO, Vec3::ZERO).iter().flatten().all(|f| *f == 255));
    }
}
