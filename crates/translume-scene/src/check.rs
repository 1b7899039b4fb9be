//! A last look over a scene: what would break a renderer is taken out, what is merely odd is told.

use crate::scene::{Geometry, Scene, Shape, TextureId};
use crate::texture::Texture;
use glam::{DAffine3, DVec3};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// Whether `m` can be turned back and its inverse is of use.
pub(crate) fn is_invertible(m: &DAffine3) -> bool {
    let determinant = m.matrix3.determinant();
    m.is_finite() && determinant != 0.0 && determinant.is_finite() && m.inverse().is_finite()
}

/// Pictures have no more pixels than this.
const MOST_PIXELS: u64 = 1 << 28;

/// Refuses films that no machine would want.
pub(crate) fn film_size([width, height]: [u32; 2]) -> Result<(), String> {
    match u64::from(width) * u64::from(height) {
        n if n > MOST_PIXELS => Err(format!("a film of {width} × {height} pixels; at most {MOST_PIXELS} are rendered")),
        _ => Ok(()),
    }
}

/// Lights in groups become shapes of their own where they stand: these are not more.
const MOST_UNFOLDED: usize = 1 << 21;

/// Refuses what [`repair`] would make too many shapes of.
pub(crate) fn instances(scene: &Scene, path: &Path) -> crate::Result<()> {
    let shines: Vec<bool> = scene.groups.iter().map(|g| g.shapes.iter().any(|s| s.radiance.is_some())).collect();
    let standing = scene.instances.iter().filter(|i| shines[i.group.0]).map(|i| scene.groups[i.group.0].shapes.len());
    match standing.fold(0, usize::saturating_add) {
        n if n > MOST_UNFOLDED => {
            let what =
                format!("instances of groups with lights are {n} shapes; at most {MOST_UNFOLDED} are made of them");
            Err(crate::Error::unsupported(path, None, what))
        }
        _ => Ok(()),
    }
}

/// Lights without area shine no more; groups with lights become plain shapes; a scene without camera or light is told.
pub(crate) fn repair(scene: &mut Scene, path: &Path) {
    unfold_shining_groups(scene);
    let mut areas = HashMap::new();
    let mut warnings = Vec::new();
    let mut black = 0;
    for (i, shape) in scene.shapes.iter_mut().enumerate() {
        let Some(radiance) = shape.radiance else { continue };
        let name = if shape.name.is_empty() { format!("shape {i}") } else { format!("shape {:?}", shape.name) };
        if is_black(&scene.textures, radiance) {
            shape.radiance = None;
            black += 1;
        } else if area(shape, &mut areas) <= 0.0 {
            shape.radiance = None;
            warnings.push(format!("{}: {name} is a light without area and does not shine", path.display()));
        }
    }
    if black > 0 {
        warnings.push(format!("{}: {black} area lights are black and are left out", path.display()));
    }
    scene.warnings.extend(warnings);
    if scene.emitters.is_empty() && scene.shapes.iter().all(|s| s.radiance.is_none()) {
        scene.warnings.push(format!("{}: the scene has no lights: pictures of it are black", path.display()));
    }
    if scene.sensors.is_empty() {
        scene.warnings.push(format!("{}: the scene has no camera", path.display()));
    }
    if scene.shapes.is_empty() && scene.instances.is_empty() {
        scene.warnings.push(format!("{}: the scene has no shapes", path.display()));
    }
}

fn is_black(textures: &[Texture], id: TextureId) -> bool {
    matches!(&textures[id.0], Texture::Constant(c) if c.max_element() <= 0.0)
}

/// Area in the shape's own space (zero is zero in any other). Meshes are measured once.
fn area(shape: &Shape, areas: &mut HashMap<usize, f64>) -> f64 {
    match &shape.geometry {
        Geometry::Mesh(mesh) => *areas.entry(Arc::as_ptr(mesh) as usize).or_insert_with(|| mesh.area()),
        Geometry::Sphere { radius, .. } => *radius,
        Geometry::Disk => 1.0,
        Geometry::Cylinder { p0, p1, radius } => DVec3::distance(*p0, *p1) * radius,
    }
}

/// Instances of groups that shine turn into shapes of their own (which share their meshes): a renderer's list of lights
/// has places in the world.
fn unfold_shining_groups(scene: &mut Scene) {
    let shines: Vec<bool> = scene.groups.iter().map(|g| g.shapes.iter().any(|s| s.radiance.is_some())).collect();
    let Scene { shapes, groups, instances, .. } = scene;
    instances.retain(|instance| {
        let group = instance.group.0;
        if shines[group] {
            shapes.extend(groups[group].shapes.iter().map(|shape| Shape {
                world_from_object: instance.world_from_group * shape.world_from_object,
                ..shape.clone()
            }));
        }
        !shines[group]
    });
    for (group, _) in groups.iter_mut().zip(shines).filter(|(_, shines)| *shines) {
        group.shapes.clear();
    }
}
