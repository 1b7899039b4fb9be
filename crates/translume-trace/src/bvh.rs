//! A tree of eight-wide nodes and its traversal.
//!
//! Boxes are tested against a ray whose origin is moved apart by a bound on the rounding errors of everything that
//! decides a hit further down, once per ray (after Woop, Benthin and Wald 2013, section 3.4, and Ize 2013, "Robust BVH
//! Ray Traversal"): a box is never missed whose content would be hit.
#![allow(unsafe_code)] // The uninitialised stack; measured in benches/results/trace-throughput.md.

use crate::lanes::Lanes;
use crate::ray::Ray;
use glam::Vec3;
use std::mem::MaybeUninit;
use translume_mesh::Bounds;

/// Half an ulp of 1.
const HALF_ULP: f32 = f32::EPSILON / 2.0;

/// The most entries the traversal stack can hold: `build` bounds the depth of trees accordingly.
pub(crate) const STACK: usize = 7 * crate::build::DEEPEST + 1;

/// What a child is, in 32 bits: a node, or what the tree's owner packs with [`Child::leaf`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Child(u32);

impl Child {
    /// No child. A leaf by its bits; never delivered.
    pub(crate) const EMPTY: Self = Self(u32::MAX);
    const LEAF: u32 = 1 << 31;
    /// Items of a leaf are numbered below this.
    pub(crate) const MOST_ITEMS: usize = 1 << 27;
    /// Most items in a leaf.
    pub(crate) const LARGEST_LEAF: usize = 7;

    pub(crate) fn node(index: usize) -> Self {
        debug_assert!(index < Self::LEAF as usize);
        Self(index as u32)
    }

    /// `count` items from number `first`, of either of two kinds.
    pub(crate) fn leaf(kind: bool, first: usize, count: usize) -> Self {
        debug_assert!(first < Self::MOST_ITEMS && (1..=Self::LARGEST_LEAF).contains(&count));
        Self(Self::LEAF | u32::from(kind) << 30 | (count as u32 - 1) << 27 | first as u32)
    }

    #[inline(always)]
    fn is_leaf(self) -> bool {
        self.0 & Self::LEAF != 0
    }

    #[inline(always)]
    pub(crate) fn kind(self) -> bool {
        self.0 & 1 << 30 != 0
    }

    #[inline(always)]
    pub(crate) fn items(self) -> std::ops::Range<usize> {
        let first = self.0 as usize & (Self::MOST_ITEMS - 1);
        first..first + (self.0 as usize >> 27 & 7) + 1
    }
}

/// Eight boxes, as arrays of lo.x, lo.y, lo.z, hi.x, hi.y, hi.z, and what is in them.
#[repr(C, align(32))]
#[derive(Clone)]
pub(crate) struct Node {
    planes: [[f32; 8]; 6],
    children: [Child; 8],
}

impl Node {
    pub(crate) const EMPTY: Self = Self {
        planes: [
            [f32::INFINITY; 8],
            [f32::INFINITY; 8],
            [f32::INFINITY; 8],
            [f32::NEG_INFINITY; 8],
            [f32::NEG_INFINITY; 8],
            [f32::NEG_INFINITY; 8],
        ],
        children: [Child::EMPTY; 8],
    };

    pub(crate) fn set(&mut self, lane: usize, bounds: &Bounds, child: Child) {
        for axis in 0..3 {
            self.planes[axis][lane] = bounds.lo[axis];
            self.planes[axis + 3][lane] = bounds.hi[axis];
        }
        self.children[lane] = child;
    }
}

/// The tree. `nodes[0]` is the root; there is none when there is nothing to hit.
pub(crate) struct Bvh {
    pub(crate) nodes: Vec<Node>,
    pub(crate) bounds: Bounds,
}

/// What is done at a leaf.
pub(crate) trait Visitor<L: Lanes> {
    /// Looks at a leaf's items; may lower `t_max`. Returns true to end the traversal.
    fn leaf(&mut self, leaf: Child, t_max: &mut f32) -> bool;
}

/// The ray's part of the box test.
struct Slabs<L> {
    /// Rows of `Node::planes` the ray meets first and last, per axis.
    near: [usize; 3],
    far: [usize; 3],
    /// Inverse directions, and minus origin times inverse direction, for the near and the far planes.
    near_inverse: [L; 3],
    near_offset: [L; 3],
    far_inverse: [L; 3],
    far_offset: [L; 3],
}

impl<L: Lanes> Slabs<L> {
    #[inline(always)]
    fn of(ray: &Ray, bounds: &Bounds) -> Self {
        let d = ray.d.to_array();
        let size = ray.d.abs().max_element();
        // Farthest that a corner of any box lies from the origin, per axis.
        let reach = (bounds.lo - ray.o).abs().max((bounds.hi - ray.o).abs());
        let along = if ray.d.x.abs() == size {
            reach.x
        } else if ray.d.y.abs() == size {
            reach.y
        } else {
            reach.z
        };
        // The sheared corner x - o - s (z - o) is off by at most 1 + 2 (s <= 1) roundings of its terms, s by 2 more; the
        // product o * inverse below by one rounding of o. Eight in all, generously.
        let apart = (reach + Vec3::splat(along) + ray.o.abs()) * (8.0 * HALF_ULP);
        let mut slabs = Self {
            near: [0, 1, 2],
            far: [3, 4, 5],
            near_inverse: [L::splat(0.0); 3],
            near_offset: [L::splat(0.0); 3],
            far_inverse: [L::splat(0.0); 3],
            far_offset: [L::splat(0.0); 3],
        };
        for k in 0..3 {
            // Directions below 2^-40 of the largest count as that: over the scene this shifts a ray far less than `apart`.
            let smallest = size * (0.5_f32).powi(40);
            let dk = if d[k].abs() < smallest { smallest.copysign(d[k]) } else { d[k] };
            let negative = dk < 0.0;
            if negative {
                (slabs.near[k], slabs.far[k]) = (k + 3, k);
            }
            let inverse = 1.0 / dk;
            // Relative errors of the inverse and the final rounding, on the safe side for parameters >= 0.
            let (near_inverse, far_inverse) = (inverse * (1.0 - 6.0 * HALF_ULP), inverse * (1.0 + 6.0 * HALF_ULP));
            let apart = if negative { -apart[k] } else { apart[k] };
            slabs.near_inverse[k] = L::splat(near_inverse);
            slabs.far_inverse[k] = L::splat(far_inverse);
            slabs.near_offset[k] = L::splat(-(ray.o[k] + apart) * near_inverse);
            slabs.far_offset[k] = L::splat(-(ray.o[k] - apart) * far_inverse);
        }
        slabs
    }

    /// Entry parameters and a bit for each box that is entered before `t_max`.
    #[inline(always)]
    fn enter(&self, node: &Node, t_min: f32, t_max: f32) -> (L, u32) {
        let (near, far) = (&self.near, &self.far);
        let near_x = L::load(&node.planes[near[0]]).mul_add(self.near_inverse[0], self.near_offset[0]);
        let near_y = L::load(&node.planes[near[1]]).mul_add(self.near_inverse[1], self.near_offset[1]);
        let near_z = L::load(&node.planes[near[2]]).mul_add(self.near_inverse[2], self.near_offset[2]);
        let far_x = L::load(&node.planes[far[0]]).mul_add(self.far_inverse[0], self.far_offset[0]);
        let far_y = L::load(&node.planes[far[1]]).mul_add(self.far_inverse[1], self.far_offset[1]);
        let far_z = L::load(&node.planes[far[2]]).mul_add(self.far_inverse[2], self.far_offset[2]);
        // NaN (from overflow) loses against the other operand.
        let t_near = near_x.max(near_y.max(near_z.max(L::splat(t_min))));
        let t_far = far_x.min(far_y.min(far_z.min(L::splat(t_max))));
        (t_near, t_near.le(t_far))
    }
}

#[derive(Clone, Copy)]
struct Entry {
    child: Child,
    t: f32,
}

impl Bvh {
    /// Visits the leaves whose boxes the ray enters, nearest first where that is cheap to know. `ORDERED` sorts them, which
    /// the closest hit wants. Returns whether a visit ended the traversal. The ray is finite and its direction not zero.
    #[inline(always)]
    pub(crate) fn traverse<L: Lanes, const ORDERED: bool>(
        &self,
        ray: &Ray,
        t_max: &mut f32,
        visitor: &mut impl Visitor<L>,
    ) -> bool {
        if self.nodes.is_empty() {
            return false;
        }
        let slabs = Slabs::<L>::of(ray, &self.bounds);
        let mut stack = [const { MaybeUninit::<Entry>::uninit() }; STACK];
        let mut top = 0;
        let mut current = Child::node(0);
        loop {
            if !current.is_leaf() {
                // SAFETY: `build` makes node numbers below nodes.len() only.
                let node = unsafe { self.nodes.get_unchecked(current.0 as usize) };
                let (near, mut hits) = slabs.enter(node, ray.t_min, *t_max);
                if hits & hits.wrapping_sub(1) == 0 && hits != 0 {
                    // One child: no detour over the stack.
                    current = node.children[hits.trailing_zeros() as usize & 7];
                    continue;
                }
                if hits != 0 {
                    let near = near.store();
                    let base = top;
                    while hits != 0 {
                        let i = hits.trailing_zeros() as usize & 7;
                        hits &= hits - 1;
                        let entry = Entry { child: node.children[i], t: near[i] };
                        // Insertion sort, the nearest on top.
                        let mut at = top;
                        if ORDERED {
                            while at > base {
                                // SAFETY: entries below `top` were written.
                                let below = unsafe { stack[at - 1].assume_init() };
                                if below.t >= entry.t {
                                    break;
                                }
                                stack[at].write(below);
                                at -= 1;
                            }
                        }
                        stack[at].write(entry);
                        top += 1;
                    }
                }
            } else if current != Child::EMPTY && visitor.leaf(current, t_max) {
                return true;
            }
            loop {
                if top == 0 {
                    return false;
                }
                top -= 1;
                // SAFETY: entries below the former `top` were written.
                let entry = unsafe { stack[top].assume_init() };
                if entry.t <= *t_max {
                    current = entry.child;
                    break;
                }
            }
        }
    }
}
