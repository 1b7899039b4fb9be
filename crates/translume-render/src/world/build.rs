//! From a scene to a world: where each shape goes in the two-level tree, and which lights its surfaces are.
//!
//! Shapes that stand once are baked into one geometry in world space. Large meshes that stand more than once, groups, and
//! quadrics under transforms that are no similarities get geometries of their own.

use super::translucent::Translucent;
use super::{Form, Surface, World};
use crate::light::{Faces, Lights, MeshLight, Quadric, ShapeForm, ShapeLight, bright_normal};
use crate::material::{Mixture, Traits, mean_luminance, prepare, traits};
use crate::medium::Tracked;
use crate::texture;
use crate::{Result, luminance};
use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3};
use std::collections::HashMap;
use std::f32::consts::PI;
use std::sync::Arc;
use translume_mesh::TriMesh;
use translume_scene::material::Model;
use translume_scene::{Geometry, Group, MaterialId, Scene, Shape};
use translume_trace as trace;

/// Meshes of fewer triangles are copied rather than placed.
const SMALL: usize = 512;

/// Where a geometry stands: the instance it will be, and its transform.
struct Standing {
    instance: u32,
    world_from_geometry: DAffine3,
}

/// The tracer's side of the world under construction.
#[derive(Default)]
struct Parts {
    instances: Vec<trace::Instance>,
    bases: Vec<u32>,
    surfaces: Vec<Surface>,
    lights: Vec<ShapeLight>,
    /// Geometries of meshes that stand more than once.
    shared: HashMap<*const TriMesh, Arc<trace::Geometry>>,
    translucent: HashMap<(u32, u32), Translucent>,
    /// Areas of those among them that shine.
    faces: HashMap<*const TriMesh, Option<Arc<Faces>>>,
    /// Per material.
    traits: Vec<Traits>,
    mixtures: Vec<Option<Mixture>>,
}

pub(crate) fn world(scene: Arc<Scene>) -> Result<World> {
    let mut uses: HashMap<*const TriMesh, usize> = HashMap::new();
    for shape in &scene.shapes {
        if let Geometry::Mesh(mesh) = &shape.geometry {
            *uses.entry(Arc::as_ptr(mesh)).or_default() += 1;
        }
    }
    let (traits, mixtures) = traits(&scene);
    let mut parts = Parts { traits, mixtures, ..Parts::default() };
    let (mut baked, mut placed) = (Vec::new(), Vec::new());
    for shape in &scene.shapes {
        let often =
            matches!(&shape.geometry, Geometry::Mesh(m) if uses[&Arc::as_ptr(m)] > 1 && m.indices.len() > SMALL);
        match if often { None } else { bake(shape, &DAffine3::IDENTITY) } {
            Some(form) => baked.push((shape, form)),
            None => placed.push(shape),
        }
    }
    parts.add_baked(&scene, baked)?;
    for shape in placed {
        parts.add_placed(&scene, shape, &DAffine3::IDENTITY)?;
    }
    parts.add_groups(&scene)?;
    finish(scene, parts)
}

fn finish(scene: Arc<Scene>, parts: Parts) -> Result<World> {
    let Parts { instances, bases, surfaces, lights, translucent, mixtures, .. } = parts;
    let tracer = trace::Scene::new(instances)?;
    let bounds = tracer.bounds();
    let (center, radius) = match bounds.is_empty() {
        true => (Vec3::ZERO, 1.0),
        false => (bounds.center(), (0.5 * bounds.extent().length()).max(f32::MIN_POSITIVE)),
    };
    Ok(World {
        lights: Lights::new(&scene, lights, (center, radius)),
        has_null: surfaces.iter().any(|s| s.passes.0),
        media: scene.media.iter().map(Tracked::new).collect(),
        prepared: prepare(&scene),
        mixtures,
        translucent,
        scene,
        tracer,
        surfaces,
        bases,
        reach: center.length() + radius,
        center,
        radius,
    })
}

impl Parts {
    /// One geometry in world space.
    fn add_baked(&mut self, scene: &Scene, baked: Vec<(&Shape, Baked)>) -> Result<()> {
        let mut shapes = Vec::new();
        self.begin();
        for (shape, form) in baked {
            let lights = sides(shape).map(|s| self.lights_of(scene, &s?, &form, &DAffine3::IDENTITY));
            shapes.push(form.shape.clone());
            let surface = surface(&self.traits, shape, form.form, lights)?;
            if let Some(material) = surface.subsurface {
                let geometry = Arc::new(trace::Geometry::new(vec![form.shape])?);
                let here = Standing { instance: self.instances.len() as u32, world_from_geometry: DAffine3::IDENTITY };
                self.add_translucent(scene, material, geometry, &here, shape.world_from_object)?;
            }
            self.surfaces.push(surface);
        }
        self.place(Arc::new(trace::Geometry::new(shapes)?), DAffine3::IDENTITY);
        Ok(())
    }

    /// A shape under its transform.
    fn add_placed(&mut self, scene: &Scene, shape: &Shape, world_from_group: &DAffine3) -> Result<()> {
        let world = *world_from_group * shape.world_from_object;
        let own = in_own_space(&shape.geometry);
        let mut one_light = false;
        let lights = sides(shape).map(|side| {
            let side = side?;
            let whole = self.mesh_light(scene, &side, &world);
            one_light |= whole.is_some();
            whole.or_else(|| self.lights_of(scene, &side, &own, &world))
        });
        let geometry = match &shape.geometry {
            Geometry::Mesh(mesh) => match self.shared.get(&Arc::as_ptr(mesh)) {
                Some(geometry) => geometry.clone(),
                None => {
                    let geometry = Arc::new(trace::Geometry::new(vec![own.shape])?);
                    self.shared.insert(Arc::as_ptr(mesh), geometry.clone());
                    geometry
                }
            },
            _ => Arc::new(trace::Geometry::new(vec![own.shape])?),
        };
        self.begin();
        let surface = Surface { one_light, ..surface(&self.traits, shape, own.form, lights)? };
        if let Some(material) = surface.subsurface {
            let here = Standing { instance: self.instances.len() as u32, world_from_geometry: world };
            self.add_translucent(scene, material, geometry.clone(), &here, world)?;
        }
        self.surfaces.push(surface);
        self.place(geometry, world);
        Ok(())
    }

    /// Groups, each built once, in all their places.
    fn add_groups(&mut self, scene: &Scene) -> Result<()> {
        let mut by_group = vec![Vec::new(); scene.groups.len()];
        scene.instances.iter().for_each(|i| by_group[i.group.0].push(i.world_from_group));
        for (group, places) in scene.groups.iter().zip(by_group) {
            if places.is_empty() {
                continue;
            }
            let Group { shapes, .. } = group;
            let (mut baked, mut alone) = (Vec::new(), Vec::new());
            for shape in shapes {
                match bake(shape, &DAffine3::IDENTITY) {
                    Some(form) => baked.push((shape, form)),
                    None => alone.push(shape),
                }
            }
            let base = self.surfaces.len() as u32;
            let tracer_shapes: Vec<trace::Shape> = baked.iter().map(|(_, form)| form.shape.clone()).collect();
            let mut under = Vec::new();
            for (number, (shape, form)) in baked.into_iter().enumerate() {
                let surface = surface(&self.traits, shape, form.form, [None; 2])?;
                if let Some(material) = surface.subsurface {
                    let geometry = Arc::new(trace::Geometry::new(vec![form.shape])?);
                    under.push((base + number as u32, material, geometry, shape.world_from_object));
                }
                self.surfaces.push(surface);
            }
            let geometry = Arc::new(trace::Geometry::new(tracer_shapes)?);
            for place in &places {
                for (surface, material, geometry, group_from_object) in &under {
                    let Model::Subsurface(model) = &scene.materials[material.0].model else { continue };
                    let object_from_world = (*place * *group_from_object).inverse();
                    let made = Translucent::new(model, geometry.clone(), *place, object_from_world, *surface)?;
                    self.translucent.insert((self.instances.len() as u32, *surface), made);
                }
                self.bases.push(base);
                self.instances.push(trace::Instance { geometry: geometry.clone(), world_from_object: *place });
                for shape in &alone {
                    self.add_placed(scene, shape, place)?;
                }
            }
        }
        Ok(())
    }

    /// The surface that is pushed next is translucent.
    fn add_translucent(
        &mut self,
        scene: &Scene,
        material: MaterialId,
        geometry: Arc<trace::Geometry>,
        here: &Standing,
        world_from_object: DAffine3,
    ) -> Result<()> {
        let Model::Subsurface(model) = &scene.materials[material.0].model else { return Ok(()) };
        let surface = self.surfaces.len() as u32;
        let made = Translucent::new(model, geometry, here.world_from_geometry, world_from_object.inverse(), surface)?;
        self.translucent.insert((here.instance, surface), made);
        Ok(())
    }

    fn begin(&mut self) {
        self.bases.push(self.surfaces.len() as u32);
    }

    fn place(&mut self, geometry: Arc<trace::Geometry>, world_from_object: DAffine3) {
        self.instances.push(trace::Instance { geometry, world_from_object });
    }

    /// Adds a shape that is one of the places of a mesh as one light; its number. `None`: its triangles are lights each.
    fn mesh_light(&mut self, scene: &Scene, shape: &Shape, world: &DAffine3) -> Option<u32> {
        let (Some(radiance), Geometry::Mesh(mesh)) = (shape.radiance, &shape.geometry) else { return None };
        let scale = similarity(world)?;
        let faces =
            self.faces.entry(Arc::as_ptr(mesh)).or_insert_with(|| Faces::new(mesh).map(Arc::new)).as_ref()?.clone();
        let light = MeshLight::new(faces, *world, scale, shape.flip_normals);
        let power = mean_luminance(scene, radiance) * light.area() * PI;
        self.lights.push(ShapeLight { radiance, power, form: ShapeForm::Mesh(Box::new(light)) });
        Some(self.lights.len() as u32 - 1)
    }

    /// Adds the lights of a shape; the number of the first.
    fn lights_of(&mut self, scene: &Scene, shape: &Shape, form: &Baked, world: &DAffine3) -> Option<u32> {
        let radiance = shape.radiance?;
        let first = self.lights.len() as u32;
        match &form.form {
            Form::Mesh(mesh) => {
                let mean = mean_luminance(scene, radiance); // of a picture that may be large
                for face in 0..mesh.indices.len() {
                    self.lights.push(triangle_light(scene, shape, mesh, (face, mean), world));
                }
            }
            Form::Quadric(_) => {
                let object = shape.world_from_object;
                // A baked form is in the world already; its object transform is the shape's all the same.
                let object = if *world == DAffine3::IDENTITY { object } else { *world };
                let form = match (&form.shape, *world == DAffine3::IDENTITY && !shape.flip_normals) {
                    (trace::Shape::Sphere(s), true) => ShapeForm::Sphere {
                        center: s.center,
                        radius: s.radius,
                        object_from_world: Box::new(unit_sphere_from_world(&shape.geometry, &object)),
                    },
                    _ => ShapeForm::Quadric(Box::new(Quadric {
                        geometry: shape.geometry.clone(),
                        world_from_object: object,
                        flip: shape.flip_normals,
                    })),
                };
                let area = match &form {
                    ShapeForm::Sphere { radius, .. } => 4.0 * PI * radius * radius,
                    ShapeForm::Quadric(q) => q.area(),
                    ShapeForm::Triangle { .. } | ShapeForm::Mesh(_) => 0.0, // not made here
                };
                let power = mean_luminance(scene, radiance) * area * PI;
                self.lights.push(ShapeLight { radiance, power, form });
            }
        }
        Some(first)
    }
}

fn unit_sphere_from_world(geometry: &Geometry, world_from_object: &DAffine3) -> DAffine3 {
    match geometry {
        Geometry::Sphere { center, radius } => {
            let unit = DAffine3 { matrix3: DMat3::from_diagonal(DVec3::splat(*radius)), translation: *center };
            (*world_from_object * unit).inverse()
        }
        _ => world_from_object.inverse(),
    }
}

/// The light that is triangle `face`; `mean` is the mean luminance of the shape's radiance.
fn triangle_light(
    scene: &Scene,
    shape: &Shape,
    mesh: &Arc<TriMesh>,
    (face, mean): (usize, f32),
    world: &DAffine3,
) -> ShapeLight {
    let [p, b, c] = mesh.corners(face).map(|v| world.transform_point3(v.as_dvec3()).as_vec3());
    let (e1, e2) = (b - p, c - p);
    let n = bright_normal(mesh, face, world, shape.flip_normals);
    let double = e1.as_dvec3().cross(e2.as_dvec3());
    let area = (0.5 * double.length()) as f32;
    let radiance = shape.radiance.expect("called for shapes that shine");
    let form = ShapeForm::Triangle { p, e1, e2, n, area, mesh: mesh.clone(), face: face as u32 };
    let power = if area > 0.0 && area.is_finite() {
        area * PI * triangle_luminance(scene, shape, mesh, (face, mean))
    } else {
        0.0
    };
    ShapeLight { radiance, power, form }
}

/// The luminance of a triangle's radiance: a few of its points, and never zero while the texture is not.
fn triangle_luminance(scene: &Scene, shape: &Shape, mesh: &TriMesh, (face, mean): (usize, f32)) -> f32 {
    let radiance = shape.radiance.expect("called for shapes that shine");
    if let Some(constant) = scene.constant(radiance) {
        return luminance(constant);
    }
    let points = [(1.0 / 3.0, 1.0 / 3.0), (0.1, 0.1), (0.8, 0.1), (0.1, 0.8), (0.45, 0.1), (0.1, 0.45), (0.45, 0.45)];
    let at = |(x, y)| crate::light::mesh_place(mesh, face as u32, Vec2::new(x, y));
    let sum: f32 = points.iter().map(|&b| luminance(texture::eval(scene, radiance, &at(b)))).sum();
    sum / points.len() as f32 + 0.01 * mean
}

/// A shape in the tracer's terms.
struct Baked {
    shape: trace::Shape,
    form: Form,
}

/// The shape in the space that `world_from_object` leads to; `None` when the tracer has no such quadric.
fn bake(shape: &Shape, outer: &DAffine3) -> Option<Baked> {
    let m = *outer * shape.world_from_object;
    let scale = similarity(&m);
    let point = |p: DVec3| m.transform_point3(p).as_vec3();
    let quadric = match &shape.geometry {
        Geometry::Mesh(mesh) if m == DAffine3::IDENTITY => return Some(mesh_form(mesh.clone())),
        Geometry::Mesh(mesh) => {
            let mut moved = TriMesh::clone(mesh);
            moved.transform(&m);
            return Some(mesh_form(Arc::new(moved)));
        }
        Geometry::Sphere { center, radius } => {
            trace::Shape::Sphere(trace::Sphere { center: point(*center), radius: (radius * scale?) as f32 })
        }
        Geometry::Disk => trace::Shape::Disk(trace::Disk {
            center: point(DVec3::ZERO),
            normal: (m.matrix3.inverse().transpose() * DVec3::Z).normalize_or(DVec3::Z).as_vec3(),
            radius: scale? as f32,
        }),
        Geometry::Cylinder { p0, p1, radius } => {
            trace::Shape::Cylinder(trace::Cylinder { p0: point(*p0), p1: point(*p1), radius: (radius * scale?) as f32 })
        }
    };
    let form = Form::Quadric(Box::new((shape.geometry.clone(), m.inverse())));
    Some(Baked { shape: quadric, form })
}

fn mesh_form(mesh: Arc<TriMesh>) -> Baked {
    Baked { shape: trace::Shape::Mesh(mesh.clone()), form: Form::Mesh(mesh) }
}

/// The geometry where it was made.
fn in_own_space(geometry: &Geometry) -> Baked {
    let shape = match geometry {
        Geometry::Mesh(mesh) => return mesh_form(mesh.clone()),
        Geometry::Sphere { center, radius } => {
            trace::Shape::Sphere(trace::Sphere { center: center.as_vec3(), radius: *radius as f32 })
        }
        Geometry::Disk => trace::Shape::Disk(trace::Disk { center: Vec3::ZERO, normal: Vec3::Z, radius: 1.0 }),
        Geometry::Cylinder { p0, p1, radius } => {
            trace::Shape::Cylinder(trace::Cylinder { p0: p0.as_vec3(), p1: p1.as_vec3(), radius: *radius as f32 })
        }
    };
    Baked { shape, form: Form::Quadric(Box::new((geometry.clone(), DAffine3::IDENTITY))) }
}

/// The factor of a transform that only rotates, mirrors, moves and scales alike.
pub(super) fn similarity(m: &DAffine3) -> Option<f64> {
    let c = [m.matrix3.x_axis, m.matrix3.y_axis, m.matrix3.z_axis];
    let scale = c[0].length();
    let alike = c.iter().all(|v| (v.length() - scale).abs() <= 1e-6 * scale);
    let square = (0..3).all(|i| c[i].dot(c[(i + 1) % 3]).abs() <= 1e-6 * scale * scale);
    (alike && square && scale > 0.0).then_some(scale)
}

/// The shape as it shines on the side of its normal, and on the other.
fn sides(shape: &Shape) -> [Option<Shape>; 2] {
    let behind = shape.shines_behind && shape.radiance.is_some();
    [Some(shape.clone()), behind.then(|| Shape { flip_normals: !shape.flip_normals, ..shape.clone() })]
}

fn surface(traits: &[Traits], shape: &Shape, form: Form, lights: [Option<u32>; 2]) -> Result<Surface> {
    let material = &traits[shape.material.0];
    Ok(Surface {
        subsurface: material.subsurface()?,
        form,
        material: shape.material,
        passes: material.passes,
        sided: material.sided,
        radiance: shape.radiance,
        first_light: lights[0],
        first_light_behind: lights[1],
        one_light: false,
        flip: shape.flip_normals,
        interior: shape.interior,
        exterior: shape.exterior,
    })
}
