//! Shapes that move together, under one tree.

use crate::build::{Item, Params, build};
use crate::bvh::{Bvh, Child, Visitor};
use crate::lanes::{Lanes, Level, dispatch};
use crate::quadric::{Cylinder, Disk, Quadric, Sphere, intersect};
use crate::ray::{Hit, Ray};
use crate::triangle::{Block, Shear, TriangleHit};
use glam::Vec3;
use rayon::prelude::*;
use std::sync::Arc;
use translume_mesh::{Bounds, TriMesh};

/// Something to hit.
#[derive(Clone, Debug)]
pub enum Shape {
    /// Triangles, from both sides. The mesh is shared, not copied (its corners are, into the tree's leaves).
    Mesh(Arc<TriMesh>),
    /// A sphere.
    Sphere(Sphere),
    /// A disk, from both sides.
    Disk(Disk),
    /// The side of a cylinder, from both sides.
    Cylinder(Cylinder),
}

impl Shape {
    pub(crate) fn quadric(&self) -> Option<&dyn Quadric> {
        match self {
            Self::Mesh(_) => None,
            Self::Sphere(s) => Some(s),
            Self::Disk(d) => Some(d),
            Self::Cylinder(c) => Some(c),
        }
    }

    /// Primitives as counted in [`Hit::prim`].
    fn len(&self) -> usize {
        match self {
            Self::Mesh(mesh) => mesh.indices.len(),
            _ => 1,
        }
    }
}

/// More primitives than the tree can number (2³² in all, 2²⁷ leaves).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooLarge;

impl std::fmt::Display for TooLarge {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("too many triangles or instances for one tree; split the model")
    }
}

impl std::error::Error for TooLarge {}

/// Shapes with their tree.
pub struct Geometry {
    shapes: Vec<Shape>,
    /// Number in the whole geometry of each shape's first primitive, and their total.
    firsts: Vec<u32>,
    bvh: Bvh,
    blocks: Vec<Block>,
    /// Shapes of the quadric leaves.
    quadrics: Vec<u32>,
    pub(crate) level: Level,
}

const PARAMS: Params = Params { block: 8, largest_leaf: 8, block_cost: 1.0 };

impl Geometry {
    /// Builds the tree, in parallel on rayon's current pool; the result does not depend on the number of threads.
    /// Triangles with coinciding corners or corners that are not finite are left out.
    ///
    /// # Errors
    /// [`TooLarge`].
    pub fn new(shapes: Vec<Shape>) -> Result<Self, TooLarge> {
        let mut firsts = vec![0_u32];
        for shape in &shapes {
            let next = firsts[firsts.len() - 1] as usize + shape.len();
            firsts.push(u32::try_from(next).map_err(|_| TooLarge)?);
        }
        let items: Vec<Item> = shapes.iter().zip(&firsts).flat_map(|(shape, &first)| items(shape, first)).collect();
        if items.len() > Child::MOST_ITEMS {
            return Err(TooLarge);
        }
        let mut geometry = Self {
            shapes,
            firsts,
            bvh: Bvh { nodes: Vec::new(), bounds: Bounds::EMPTY },
            blocks: Vec::new(),
            quadrics: Vec::new(),
            level: Level::detect(),
        };
        let (mut blocks, mut quadrics) = (Vec::new(), Vec::new());
        geometry.bvh = build(items, &PARAMS, |ids, is_quadric| {
            if is_quadric {
                let first = quadrics.len();
                quadrics.extend(ids.iter().map(|&id| geometry.locate(id).0));
                return Child::leaf(true, first, ids.len());
            }
            let first = blocks.len();
            blocks.extend(ids.chunks(8).map(|ids| {
                let corners: Vec<_> = ids.iter().map(|&id| (geometry.corners(id), id)).collect();
                Block::new(&corners)
            }));
            Child::leaf(false, first, blocks.len() - first)
        });
        (geometry.blocks, geometry.quadrics) = (blocks, quadrics);
        Ok(geometry)
    }

    /// A geometry of one mesh.
    ///
    /// # Errors
    /// [`TooLarge`].
    pub fn from_mesh(mesh: Arc<TriMesh>) -> Result<Self, TooLarge> {
        Self::new(vec![Shape::Mesh(mesh)])
    }

    /// The same with the kernels of processors without AVX2: for comparisons.
    #[must_use]
    pub fn without_simd(self) -> Self {
        Self { level: Level::Portable, ..self }
    }

    /// The shapes, in the order of [`Hit::part`].
    pub fn shapes(&self) -> &[Shape] {
        &self.shapes
    }

    /// Box of what can be hit.
    pub fn bounds(&self) -> Bounds {
        self.bvh.bounds
    }

    /// Bytes of the tree, without the shared meshes.
    pub fn memory(&self) -> usize {
        size_of_val(&self.bvh.nodes[..]) + size_of_val(&self.blocks[..])
    }

    /// The closest hit. Rays that are not finite hit nothing.
    pub fn intersect(&self, ray: &Ray) -> Option<Hit> {
        if !is_sound(ray) {
            return None;
        }
        let geometry = self;
        dispatch!(self.level, closest(geometry: &Geometry, ray: &Ray) -> Option<Hit>)
    }

    /// Whether anything is hit within the ray's limits.
    pub fn occluded(&self, ray: &Ray) -> bool {
        if !is_sound(ray) {
            return false;
        }
        let geometry = self;
        dispatch!(self.level, any(geometry: &Geometry, ray: &Ray) -> bool)
    }

    /// [`Geometry::intersect`] for many rays, in parallel, in their order.
    pub fn intersect_all(&self, rays: &[Ray]) -> Vec<Option<Hit>> {
        rays.par_iter().with_min_len(256).map(|ray| self.intersect(ray)).collect()
    }

    /// [`Geometry::occluded`] for many rays, in parallel, in their order.
    pub fn occluded_all(&self, rays: &[Ray]) -> Vec<bool> {
        rays.par_iter().with_min_len(256).map(|ray| self.occluded(ray)).collect()
    }

    /// Shape and primitive of a number in the whole geometry.
    #[inline]
    fn locate(&self, id: u32) -> (u32, u32) {
        let part = self.firsts.partition_point(|&first| first <= id) - 1;
        (part as u32, id - self.firsts[part])
    }

    fn corners(&self, id: u32) -> [Vec3; 3] {
        let (part, prim) = self.locate(id);
        match &self.shapes[part as usize] {
            Shape::Mesh(mesh) => mesh.corners(prim as usize),
            _ => [Vec3::ZERO; 3], // quadrics have leaves of their own
        }
    }

    /// The tree's part of [`Geometry::intersect`], for a sound ray; `hit.t` bounds the search and is lowered.
    #[inline(always)]
    pub(crate) fn closest<L: Lanes>(&self, ray: &Ray, t_max: f32) -> Option<Hit> {
        let mut visitor = Closest { geometry: self, ray, shear: Shear::of(ray), best: None };
        let mut t_max = t_max;
        self.bvh.traverse::<L, true>(ray, &mut t_max, &mut visitor);
        let TriangleHit { t, u, v, prim } = visitor.best?;
        let (part, prim) = self.locate(prim);
        Some(Hit { t, u, v, prim, part, instance: 0 })
    }

    #[inline(always)]
    pub(crate) fn any<L: Lanes>(&self, ray: &Ray) -> bool {
        let mut visitor = Any { geometry: self, ray, shear: Shear::of(ray) };
        let mut t_max = ray.t_max;
        self.bvh.traverse::<L, false>(ray, &mut t_max, &mut visitor)
    }

    #[inline(always)]
    fn quadric_hit(&self, item: usize, ray: &Ray, t_max: f32) -> Option<TriangleHit> {
        let part = self.quadrics[item] as usize;
        let t = intersect(self.shapes[part].quadric()?, ray, t_max)?;
        Some(TriangleHit { t, u: 0.0, v: 0.0, prim: self.firsts[part] })
    }
}

#[inline(always)]
fn closest<L: Lanes>(geometry: &Geometry, ray: &Ray) -> Option<Hit> {
    geometry.closest::<L>(ray, ray.t_max)
}

#[inline(always)]
fn any<L: Lanes>(geometry: &Geometry, ray: &Ray) -> bool {
    geometry.any::<L>(ray)
}

/// Finite, with a direction, and limits that are numbers.
#[inline(always)]
pub(crate) fn is_sound(ray: &Ray) -> bool {
    ray.o.is_finite() && ray.d.is_finite() && ray.d != Vec3::ZERO && ray.t_min < ray.t_max
}

fn items(shape: &Shape, first: u32) -> Vec<Item> {
    if let Some(quadric) = shape.quadric() {
        let bounds = quadric.bounds();
        let sound = bounds.lo.is_finite() && bounds.hi.is_finite() && !bounds.is_empty();
        return sound.then_some(Item { bounds, id: first, kind: true }).into_iter().collect();
    }
    let Shape::Mesh(mesh) = shape else { return Vec::new() };
    let item = |face: usize| {
        let [a, b, c] = mesh.corners(face);
        let sound = a.is_finite() && b.is_finite() && c.is_finite() && a != b && b != c && c != a;
        let bounds = Bounds { lo: a.min(b).min(c), hi: a.max(b).max(c) };
        sound.then_some(Item { bounds, id: first + face as u32, kind: false })
    };
    (0..mesh.indices.len()).into_par_iter().with_min_len(4096).filter_map(item).collect()
}

struct Closest<'a> {
    geometry: &'a Geometry,
    ray: &'a Ray,
    shear: Shear,
    best: Option<TriangleHit>,
}

impl<L: Lanes> Visitor<L> for Closest<'_> {
    #[inline(always)]
    fn leaf(&mut self, leaf: Child, t_max: &mut f32) -> bool {
        for i in leaf.items() {
            let hit = if leaf.kind() {
                self.geometry.quadric_hit(i, self.ray, *t_max)
            } else {
                self.geometry.blocks[i].intersect::<L>(&self.shear, self.ray.t_min, *t_max)
            };
            if let Some(hit) = hit {
                *t_max = hit.t;
                self.best = Some(hit);
            }
        }
        false
    }
}

struct Any<'a> {
    geometry: &'a Geometry,
    ray: &'a Ray,
    shear: Shear,
}

impl<L: Lanes> Visitor<L> for Any<'_> {
    #[inline(always)]
    fn leaf(&mut self, leaf: Child, t_max: &mut f32) -> bool {
        for i in leaf.items() {
            let hit = if leaf.kind() {
                self.geometry.quadric_hit(i, self.ray, *t_max)
            } else {
                self.geometry.blocks[i].intersect::<L>(&self.shear, self.ray.t_min, *t_max)
            };
            if hit.is_some() {
                return true;
            }
        }
        false
    }
}
