//! Geometries placed by affine transforms, under a second tree.

use crate::build::{Item, Params, build};
use crate::bvh::{Bvh, Child, Visitor};
use crate::geometry::{Geometry, TooLarge, is_sound};
use crate::lanes::{Lanes, Level, dispatch};
use crate::ray::{Hit, Ray};
use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;
use std::sync::Arc;
use translume_mesh::Bounds;

/// A geometry in its place.
#[derive(Clone)]
pub struct Instance {
    /// What is placed; the same one as often as wanted.
    pub geometry: Arc<Geometry>,
    /// Where. A transform that is not invertible hides the instance.
    pub world_from_object: DAffine3,
}

/// Instances with their tree. [`Hit::instance`] is the number of the instance in the order given.
pub struct Scene {
    instances: Vec<Instance>,
    object_from_world: Vec<DAffine3>,
    /// Which instances stand where their geometry is.
    in_place: Vec<bool>,
    bvh: Bvh,
    order: Vec<u32>,
    level: Level,
}

const PARAMS: Params = Params { block: 1, largest_leaf: 1, block_cost: 4.0 };

impl Scene {
    /// Builds the tree over the instances.
    ///
    /// # Errors
    /// [`TooLarge`].
    pub fn new(instances: Vec<Instance>) -> Result<Self, TooLarge> {
        if instances.len() > Child::MOST_ITEMS {
            return Err(TooLarge);
        }
        let items = instances.iter().enumerate().filter_map(|(i, instance)| {
            let bounds = world_bounds(instance)?;
            Some(Item { bounds, id: i as u32, kind: false })
        });
        let mut order = Vec::new();
        let bvh = build(items.collect(), &PARAMS, |ids, _| {
            order.extend_from_slice(ids);
            Child::leaf(false, order.len() - ids.len(), ids.len())
        });
        let object_from_world = instances.iter().map(|i| i.world_from_object.inverse()).collect();
        let in_place = instances.iter().map(|i| i.world_from_object == DAffine3::IDENTITY).collect();
        Ok(Self { instances, object_from_world, in_place, bvh, order, level: Level::detect() })
    }

    /// A scene of one geometry where it stands.
    ///
    /// # Errors
    /// [`TooLarge`].
    pub fn of(geometry: Geometry) -> Result<Self, TooLarge> {
        let instance = Instance { geometry: Arc::new(geometry), world_from_object: DAffine3::IDENTITY };
        Self::new(vec![instance])
    }

    /// The instances, in the order of [`Hit::instance`].
    pub fn instances(&self) -> &[Instance] {
        &self.instances
    }

    /// To an instance's own space.
    #[inline]
    pub fn object_from_world(&self, instance: u32) -> &DAffine3 {
        &self.object_from_world[instance as usize]
    }

    /// Whether an instance stands where its geometry is.
    #[inline]
    pub fn is_in_place(&self, instance: u32) -> bool {
        self.in_place[instance as usize]
    }

    /// Box of what can be hit.
    pub fn bounds(&self) -> Bounds {
        self.bvh.bounds
    }

    /// The closest hit. Rays that are not finite hit nothing.
    pub fn intersect(&self, ray: &Ray) -> Option<Hit> {
        if !is_sound(ray) {
            return None;
        }
        let scene = self;
        dispatch!(self.level, closest(scene: &Scene, ray: &Ray) -> Option<Hit>)
    }

    /// Whether anything is hit within the ray's limits.
    pub fn occluded(&self, ray: &Ray) -> bool {
        if !is_sound(ray) {
            return false;
        }
        let scene = self;
        dispatch!(self.level, any(scene: &Scene, ray: &Ray) -> bool)
    }

    /// [`Scene::intersect`] for many rays, in parallel, in their order.
    pub fn intersect_all(&self, rays: &[Ray]) -> Vec<Option<Hit>> {
        rays.par_iter().with_min_len(256).map(|ray| self.intersect(ray)).collect()
    }

    /// [`Scene::occluded`] for many rays, in parallel, in their order.
    pub fn occluded_all(&self, rays: &[Ray]) -> Vec<bool> {
        rays.par_iter().with_min_len(256).map(|ray| self.occluded(ray)).collect()
    }

    /// The ray in an instance's own space, with the same parameters; `None` when it is not finite there.
    #[inline(always)]
    fn object_ray(&self, instance: usize, ray: &Ray) -> Option<Ray> {
        if self.in_place[instance] {
            return Some(*ray);
        }
        let m = &self.object_from_world[instance];
        // Double precision leaves one rounding per component.
        let o = m.transform_point3(ray.o.as_dvec3()).as_vec3();
        let d = m.transform_vector3(ray.d.as_dvec3()).as_vec3();
        let ray = Ray { o, d, ..*ray };
        is_sound(&ray).then_some(ray)
    }
}

#[inline(always)]
fn closest<L: Lanes>(scene: &Scene, ray: &Ray) -> Option<Hit> {
    let mut visitor = Closest { scene, ray, best: None };
    let mut t_max = ray.t_max;
    if scene.order.len() == 1 {
        // No tree over one instance.
        Visitor::<L>::leaf(&mut visitor, Child::leaf(false, 0, 1), &mut t_max);
        return visitor.best;
    }
    scene.bvh.traverse::<L, true>(ray, &mut t_max, &mut visitor);
    visitor.best
}

#[inline(always)]
fn any<L: Lanes>(scene: &Scene, ray: &Ray) -> bool {
    let (mut t_max, mut visitor) = (ray.t_max, Any { scene, ray });
    if scene.order.len() == 1 {
        return Visitor::<L>::leaf(&mut visitor, Child::leaf(false, 0, 1), &mut t_max);
    }
    scene.bvh.traverse::<L, false>(ray, &mut t_max, &mut visitor)
}

/// Box of the instance in the world, widened by the roundings of rays on their way into it; `None` when it cannot be hit.
fn world_bounds(instance: &Instance) -> Option<Bounds> {
    let Instance { geometry, world_from_object: m } = instance;
    let Bounds { lo, hi } = geometry.bounds();
    let invertible = m.is_finite() && m.inverse().is_finite() && m.matrix3.determinant() != 0.0;
    if !invertible || geometry.bounds().is_empty() {
        return None;
    }
    let (mut bounds, mut reach) = (Bounds::EMPTY, DVec3::ZERO);
    for corner in 0..8 {
        let pick = |axis: usize| f64::from(if corner >> axis & 1 == 0 { lo[axis] } else { hi[axis] });
        let p = m.transform_point3(DVec3::new(pick(0), pick(1), pick(2)));
        bounds.grow(p.as_vec3());
        reach = reach.max(p.abs());
    }
    if *m != DAffine3::IDENTITY {
        let slack = (reach * 4.0 * f64::from(f32::EPSILON)).as_vec3();
        bounds = Bounds { lo: bounds.lo - slack, hi: bounds.hi + slack };
    }
    (bounds.lo.is_finite() && bounds.hi.is_finite() && bounds.lo != Vec3::NAN).then_some(bounds)
}

struct Closest<'a> {
    scene: &'a Scene,
    ray: &'a Ray,
    best: Option<Hit>,
}

impl<L: Lanes> Visitor<L> for Closest<'_> {
    #[inline(always)]
    fn leaf(&mut self, leaf: Child, t_max: &mut f32) -> bool {
        for i in leaf.items() {
            let instance = self.scene.order[i];
            let Some(ray) = self.scene.object_ray(instance as usize, self.ray) else { continue };
            let geometry = &self.scene.instances[instance as usize].geometry;
            if let Some(hit) = geometry.closest::<L>(&ray, *t_max) {
                *t_max = hit.t;
                self.best = Some(Hit { instance, ..hit });
            }
        }
        false
    }
}

struct Any<'a> {
    scene: &'a Scene,
    ray: &'a Ray,
}

impl<L: Lanes> Visitor<L> for Any<'_> {
    #[inline(always)]
    fn leaf(&mut self, leaf: Child, _: &mut f32) -> bool {
        for i in leaf.items() {
            let instance = self.scene.order[i] as usize;
            let Some(ray) = self.scene.object_ray(instance, self.ray) else { continue };
            if self.scene.instances[instance].geometry.any::<L>(&ray) {
                return true;
            }
        }
        false
    }
}
