//! Building the tree: binned surface area heuristic (Wald 2007), eight-wide nodes directly.
//!
//! A node starts with all its items as one group and splits the group of the largest surface until it has eight, as
//! Embree does (Wald et al. 2014). Subtrees are built in parallel; the result does not depend on threads.

use crate::bvh::{Bvh, Child, Node};
use glam::Vec3;
use rayon::prelude::*;
use translume_mesh::Bounds;

/// Below this depth groups are halved by count, which ends after 27 more levels.
const SAH_DEPTH: usize = 40;
/// No path from the root has more nodes than this.
pub(crate) const DEEPEST: usize = SAH_DEPTH + 29;
const BINS: usize = 16;
/// Fewer items than this are built in one thread.
const PARALLEL: usize = 4096;

/// An item: its box and number. `kind` may not be mixed in one leaf.
#[derive(Clone, Copy)]
pub(crate) struct Item {
    pub(crate) bounds: Bounds,
    pub(crate) id: u32,
    pub(crate) kind: bool,
}

impl Item {
    /// Twice the middle of the box.
    #[inline]
    fn middle(&self) -> Vec3 {
        self.bounds.lo + self.bounds.hi
    }
}

/// Costs and sizes.
#[derive(Clone, Copy)]
pub(crate) struct Params {
    /// Items tested at once.
    pub(crate) block: usize,
    /// Most items in a leaf.
    pub(crate) largest_leaf: usize,
    /// Cost of a block over that of a node's share.
    pub(crate) block_cost: f32,
}

enum Tree {
    Leaf(Vec<u32>, bool),
    Inner(Vec<(Bounds, Tree)>),
}

/// Builds the tree; `leaf` packs the items of a leaf, called in depth-first order.
pub(crate) fn build(mut items: Vec<Item>, params: &Params, mut leaf: impl FnMut(&[u32], bool) -> Child) -> Bvh {
    let mut bvh = Bvh { nodes: Vec::new(), bounds: bounds_of(&items) };
    if !items.is_empty() {
        let children = inner(&mut items, params, 0);
        drop(items);
        flatten(&mut bvh.nodes, children, &mut leaf);
    }
    bvh
}

fn flatten(
    nodes: &mut Vec<Node>,
    children: Vec<(Bounds, Tree)>,
    leaf: &mut impl FnMut(&[u32], bool) -> Child,
) -> Child {
    let index = nodes.len();
    nodes.push(Node::EMPTY);
    for (lane, (bounds, tree)) in children.into_iter().enumerate() {
        let child = match tree {
            Tree::Leaf(ids, kind) => leaf(&ids, kind),
            Tree::Inner(children) => flatten(nodes, children, leaf),
        };
        nodes[index].set(lane, &bounds, child);
    }
    Child::node(index)
}

struct Group<'a> {
    items: &'a mut [Item],
    bounds: Bounds,
    finished: bool,
}

impl<'a> Group<'a> {
    fn new(items: &'a mut [Item]) -> Self {
        Self { bounds: bounds_of(items), items, finished: false }
    }
}

/// The children of a node over `items`.
fn inner(items: &mut [Item], params: &Params, depth: usize) -> Vec<(Bounds, Tree)> {
    let mut groups = vec![Group::new(items)];
    while groups.len() < 8 {
        let area = |g: &Group| g.bounds.half_area();
        let open = groups.iter().enumerate().filter(|(_, g)| !g.finished);
        let Some((largest, _)) = open.max_by(|a, b| area(a.1).total_cmp(&area(b.1))) else { break };
        let group = groups.swap_remove(largest);
        match split(group, params, depth) {
            Ok([a, b]) => groups.extend([a, b]),
            Err(whole) => groups.push(whole),
        }
    }
    let below = |g: Group| {
        let tree = if g.finished || is_leaf_at_all(&g, params) {
            Tree::Leaf(g.items.iter().map(|i| i.id).collect(), g.items[0].kind)
        } else {
            Tree::Inner(inner(g.items, params, depth + 1))
        };
        (g.bounds, tree)
    };
    if groups.iter().map(|g| g.items.len()).sum::<usize>() > PARALLEL {
        groups.into_par_iter().map(below).collect()
    } else {
        groups.into_iter().map(below).collect()
    }
}

/// A node that filled up before this group was looked at: would splitting it pay?
fn is_leaf_at_all(group: &Group, params: &Params) -> bool {
    may_be_leaf(group.items, params) && group.items.len() <= params.block
}

fn may_be_leaf(items: &[Item], params: &Params) -> bool {
    items.len() <= params.largest_leaf && items.iter().all(|i| i.kind == items[0].kind)
}

/// Two groups, or the whole one marked as a leaf where that costs less.
fn split<'a>(group: Group<'a>, params: &Params, depth: usize) -> Result<[Group<'a>; 2], Group<'a>> {
    let n = group.items.len();
    let blocks = |n: usize| n.div_ceil(params.block) as f32 * params.block_cost;
    let finished = |group: Group<'a>| Err(Group { finished: true, ..group });
    if n == 1 {
        return finished(group);
    }
    let leaf_cost = may_be_leaf(group.items, params).then(|| blocks(n));
    let best = if depth < SAH_DEPTH { Split::find(group.items, blocks) } else { None };
    if let Some(leaf_cost) = leaf_cost {
        let split_cost = best.as_ref().map_or(f32::INFINITY, |s| 1.0 + s.cost / group.bounds.half_area());
        // NaN (a box without area) makes a leaf.
        if split_cost.is_nan() || split_cost >= leaf_cost {
            return finished(group);
        }
    }
    let items = group.items;
    let middle = match best {
        Some(split) => partition(items, |i| split.is_left(i)),
        None if items.iter().any(|i| i.kind) && !items.iter().all(|i| i.kind) => partition(items, |i| i.kind),
        None => {
            // Nothing tells the items apart, or the tree is too deep already.
            let axis = largest_axis(centers_of(items).extent());
            items.select_nth_unstable_by(n / 2, |a, b| a.middle()[axis].total_cmp(&b.middle()[axis]));
            n / 2
        }
    };
    let (left, right) = items.split_at_mut(middle);
    Ok([Group::new(left), Group::new(right)])
}

struct Split {
    axis: usize,
    bin: usize,
    lo: f32,
    scale: f32,
    /// Sum over both sides of half area times cost of its items.
    cost: f32,
}

impl Split {
    fn find(items: &[Item], cost: impl Fn(usize) -> f32) -> Option<Self> {
        let centers = centers_of(items);
        let mut best: Option<Self> = None;
        let scales = (centers.extent()).to_array().map(|e| BINS as f32 * (1.0 - 1e-6) / e);
        let lo = centers.lo.to_array();
        let mut bins = [[(Bounds::EMPTY, 0_usize); BINS]; 3];
        for item in items {
            let middle = item.middle();
            for axis in 0..3 {
                // Casts saturate, and NaN (an axis without extent) becomes 0.
                let bin = (((middle[axis] - lo[axis]) * scales[axis]) as usize).min(BINS - 1);
                bins[axis][bin].0.join(&item.bounds);
                bins[axis][bin].1 += 1;
            }
        }
        for axis in 0..3 {
            let mut right = [(Bounds::EMPTY, 0); BINS];
            let mut sum = (Bounds::EMPTY, 0);
            for bin in (1..BINS).rev() {
                sum.0.join(&bins[axis][bin].0);
                sum.1 += bins[axis][bin].1;
                right[bin] = sum;
            }
            let mut left = (Bounds::EMPTY, 0);
            for bin in 1..BINS {
                left.0.join(&bins[axis][bin - 1].0);
                left.1 += bins[axis][bin - 1].1;
                let right = right[bin];
                if left.1 == 0 || right.1 == 0 {
                    continue;
                }
                let cost = left.0.half_area() * cost(left.1) + right.0.half_area() * cost(right.1);
                if best.as_ref().is_none_or(|b| cost < b.cost) {
                    best = Some(Self { axis, bin, lo: lo[axis], scale: scales[axis], cost });
                }
            }
        }
        best
    }

    fn is_left(&self, item: &Item) -> bool {
        (((item.middle()[self.axis] - self.lo) * self.scale) as usize).min(BINS - 1) < self.bin
    }
}

/// Moves the items with `is_left` to the front and returns how many there are.
fn partition(items: &mut [Item], is_left: impl Fn(&Item) -> bool) -> usize {
    let (mut left, mut right) = (0, items.len());
    while left < right {
        if is_left(&items[left]) {
            left += 1;
        } else {
            right -= 1;
            items.swap(left, right);
        }
    }
    left
}

fn bounds_of(items: &[Item]) -> Bounds {
    items.iter().fold(Bounds::EMPTY, |mut b, i| {
        b.join(&i.bounds);
        b
    })
}

fn centers_of(items: &[Item]) -> Bounds {
    items.iter().fold(Bounds::EMPTY, |mut b, i| {
        b.grow(i.middle());
        b
    })
}

fn largest_axis(e: Vec3) -> usize {
    if e.x >= e.y && e.x >= e.z {
        0
    } else if e.y >= e.z {
        1
    } else {
        2
    }
}
