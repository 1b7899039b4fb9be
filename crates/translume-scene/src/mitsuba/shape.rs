//! Shapes, groups of them and instances.

use super::Loader;
use super::object::Object;
use crate::Result;
use crate::builder::{MeshKey, Normals};
use crate::scene::{Geometry, Group, GroupId, Instance, MediumId, Shape};
use crate::spectrum::Quantity;
use glam::{DAffine3, DVec3};
use std::rc::Rc;
use std::sync::Arc;
use translume_mesh::TriMesh;

/// Shapes of a scene, those in collections each time these are referred to.
const MOST_SHAPES: usize = 1 << 22;

impl Loader {
    /// The shapes that `object` stands for: one, none for groups and instances (which go to the scene's own lists), or
    /// all of a collection.
    pub(super) fn shape(&mut self, object: &Rc<Object>) -> Result<Vec<Shape>> {
        self.stood += 1;
        if self.stood > MOST_SHAPES {
            let what =
                format!("too many shapes: collections that refer to each other stand for more than {MOST_SHAPES}");
            return Err(object.place.unsupported(what));
        }
        match object.plugin.as_str() {
            "shapegroup" => {
                // It appears where instances place it.
                self.group(object)?;
                Ok(Vec::new())
            }
            "instance" => {
                self.instance(object)?;
                Ok(Vec::new())
            }
            "merge" => {
                let shapes = self.members(object)?;
                self.finish(object)?;
                Ok(shapes)
            }
            _ => Ok(vec![self.single(object)?]),
        }
    }

    /// The shapes nested in a collection.
    fn members(&mut self, object: &Rc<Object>) -> Result<Vec<Shape>> {
        self.guarded(object, |loader| {
            let mut shapes = Vec::new();
            for child in object.children.iter().filter(|c| !c.used.get()) {
                let member = loader.resolve(&child.target, &child.place)?;
                if member.class != "shape" {
                    continue;
                }
                child.used.set(true);
                if matches!(member.plugin.as_str(), "shapegroup" | "instance") {
                    return Err(member.place.unsupported(format!("{} inside a group", member.title())));
                }
                let made = loader.shape(&member);
                shapes.extend(loader.skippable(made, Vec::new)?);
            }
            Ok(shapes)
        })
    }

    fn group(&mut self, object: &Rc<Object>) -> Result<GroupId> {
        if let Some(&id) = self.groups.get(&Rc::as_ptr(object)) {
            return Ok(id);
        }
        // Some writers put a transform here that Mitsuba does not look at.
        let shapes = self.members(object)?;
        self.finish(object)?;
        let id = GroupId(self.builder.scene.groups.len());
        self.builder.scene.groups.push(Group { name: object.id.clone(), shapes });
        self.groups.insert(Rc::as_ptr(object), id);
        Ok(id)
    }

    fn instance(&mut self, object: &Rc<Object>) -> Result<()> {
        let world_from_group = object.invertible("to_world")?;
        let Some(group) = self.child_of_class(object, "shape")?.filter(|o| o.plugin == "shapegroup") else {
            return Err(object.place.invalid("an instance has no shapegroup"));
        };
        let group = self.group(&group)?;
        self.finish(object)?;
        self.builder.scene.instances.push(Instance { group, world_from_group });
        Ok(())
    }

    fn single(&mut self, object: &Rc<Object>) -> Result<Shape> {
        let world_from_object = object.invertible("to_world")?;
        let mirrors = world_from_object.matrix3.determinant() < 0.0;
        // Which way normals point under a mirroring transform: Mitsuba takes what it computes itself from world space.
        let (geometry, turned) = match object.plugin.as_str() {
            "obj" | "ply" | "serialized" => {
                let mesh = self.mesh_file(object)?;
                let turned = mirrors && !mesh.has_own_normals;
                (Geometry::Mesh(mesh.mesh), turned)
            }
            "rectangle" => (Geometry::Mesh(self.unit_mesh(false)), false),
            "cube" => (Geometry::Mesh(self.unit_mesh(true)), false),
            "sphere" => {
                let center = object.point("center")?.unwrap_or(DVec3::ZERO);
                (Geometry::Sphere { center, radius: object.positive("radius", 1.0)? }, mirrors)
            }
            "disk" => (Geometry::Disk, false),
            "cylinder" => {
                let p0 = object.point("p0")?.unwrap_or(DVec3::ZERO);
                let p1 = object.point("p1")?.unwrap_or(DVec3::Z);
                if p0 == p1 {
                    return Err(object.place.invalid("the ends of the cylinder are the same point"));
                }
                (Geometry::Cylinder { p0, p1, radius: object.positive("radius", 1.0)? }, false)
            }
            _ => return Err(object.unsupported()),
        };
        let flip_normals = object.boolean("flip_normals", false)? != turned;
        let shape = self.dressed(object, geometry, world_from_object, flip_normals)?;
        self.finish(object)?;
        Ok(shape)
    }

    /// The shape with material, light and media.
    fn dressed(
        &mut self,
        object: &Rc<Object>,
        geometry: Geometry,
        world_from_object: DAffine3,
        flip_normals: bool,
    ) -> Result<Shape> {
        self.asked.clear();
        let interior = self.medium_named(object, "interior")?;
        let exterior = self.medium_named(object, "exterior")?;
        let radiance = match self.child_of_class(object, "emitter")? {
            Some(emitter) if emitter.plugin == "area" => {
                self.worn.insert(Rc::as_ptr(&emitter));
                let radiance = self.texture(&emitter, "radiance", 1.0, Quantity::Light)?;
                self.finish(&emitter)?;
                Some(radiance)
            }
            Some(emitter) => {
                let refused = Err(emitter.unsupported());
                self.skippable(refused, || None)?
            }
            None => None,
        };
        let bsdf = self.child_of_class(object, "bsdf")?.map(|bsdf| self.bsdf(&bsdf)).transpose()?;
        let material = match self.child_of_class(object, "subsurface")? {
            Some(under) => {
                let made = self.subsurface_of_shape(&under, bsdf);
                let gray = self.builder.gray(0.5);
                Some(self.skippable(made, || gray)?)
            }
            None => bsdf,
        };
        let material = match material {
            Some(material) => material,
            None if radiance.is_some() => self.builder.gray(0.0),
            None if self.is_old() && (interior.is_some() || exterior.is_some()) => {
                self.builder.material("", crate::material::Model::Null)
            }
            None => self.builder.gray(0.5),
        };
        let geometry = self.with_attributes(object, geometry)?;
        let name = object.id.clone();
        Ok(Shape {
            name,
            geometry,
            world_from_object,
            flip_normals,
            material,
            radiance,
            shines_behind: false,
            interior,
            exterior,
        })
    }

    /// The geometry with the attribute that its material and light look at.
    fn with_attributes(&mut self, object: &Rc<Object>, geometry: Geometry) -> Result<Geometry> {
        let mut asked = std::mem::take(&mut self.asked).into_iter();
        let Some(name) = asked.next() else { return Ok(geometry) };
        if asked.next().is_some() {
            return Err(object
                .place
                .unsupported(format!("{} has more than one mesh attribute in use", object.title())));
        }
        let colored = match &geometry {
            Geometry::Mesh(mesh) if name == "vertex_color" && mesh.colors.is_some() => return Ok(geometry),
            Geometry::Mesh(mesh) if object.plugin == "ply" => {
                let key = (Arc::as_ptr(mesh), name.clone());
                match self.colored.get(&key) {
                    Some(known) => known.clone(),
                    None => {
                        let made = super::attribute::colored(mesh, &self.file(object, "filename")?, &name);
                        self.colored.insert(key, made.clone());
                        made
                    }
                }
            }
            _ => None,
        };
        if let Some(mesh) = colored {
            return Ok(Geometry::Mesh(mesh));
        }
        let what =
            format!("{} has no attribute {name:?}, which its material or light wants: it is white", object.title());
        self.builder.warn(object.place.warning(what));
        Ok(geometry)
    }

    fn medium_named(&mut self, object: &Object, name: &str) -> Result<Option<MediumId>> {
        self.child_named(object, name)?.map(|medium| self.medium(&medium)).transpose()
    }

    fn mesh_file(&mut self, object: &Rc<Object>) -> Result<crate::builder::Mesh> {
        let path = self.file(object, "filename")?;
        let part = match object.integer("shape_index")? {
            Some(i) => match usize::try_from(i) {
                Ok(i) => Some(i),
                Err(_) => return Err(object.place.invalid("the shape index is negative")),
            },
            None if object.plugin == "serialized" => Some(0),
            None => None,
        };
        let normals = match object.number("max_smooth_angle")? {
            _ if object.boolean("face_normals", false)? => Normals::Flat,
            Some(degrees) => Normals::Crease((degrees.to_radians() as f32).to_bits()),
            None => Normals::Smooth,
        };
        // OBJ has v up, as we have it, and Mitsuba turns it over by default; it does not for the others.
        let turns_over = object.boolean("flip_tex_coords", object.plugin == "obj")?;
        let _ = object.property("collapse"); // groups of an OBJ file as one shape: no difference here
        let mesh = self.builder.mesh(MeshKey { path, part, normals, flip_v: !turns_over });
        mesh.map_err(|e| e.at(&object.place.file, object.place.line))
    }

    /// Mitsuba's rectangle or cube from −1 to 1.
    fn unit_mesh(&mut self, cube: bool) -> Arc<TriMesh> {
        let slot = &mut self.unit_meshes[usize::from(cube)];
        slot.get_or_insert_with(|| Arc::new(if cube { unit_cube() } else { unit_rectangle() })).clone()
    }
}

fn unit_rectangle() -> TriMesh {
    TriMesh {
        positions: vec![[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]],
        // Mitsuba's v grows with y, and has its origin at the top of pictures.
        uvs: Some(vec![[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]),
        indices: vec![[0, 1, 2], [0, 2, 3]],
        ..TriMesh::default()
    }
}

fn unit_cube() -> TriMesh {
    // Per face: the corner of texture coordinates (0, 1) in Mitsuba, then (1, 1), (1, 0), (0, 0).
    const FACES: [[[f32; 3]; 4]; 6] = [
        [[1.0, -1.0, -1.0], [1.0, -1.0, 1.0], [-1.0, -1.0, 1.0], [-1.0, -1.0, -1.0]],
        [[1.0, 1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, 1.0, 1.0], [1.0, 1.0, 1.0]],
        [[1.0, -1.0, -1.0], [1.0, 1.0, -1.0], [1.0, 1.0, 1.0], [1.0, -1.0, 1.0]],
        [[1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [-1.0, -1.0, 1.0]],
        [[-1.0, -1.0, 1.0], [-1.0, 1.0, 1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, -1.0]],
        [[1.0, 1.0, -1.0], [1.0, -1.0, -1.0], [-1.0, -1.0, -1.0], [-1.0, 1.0, -1.0]],
    ];
    TriMesh {
        positions: FACES.into_iter().flatten().collect(),
        uvs: Some([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].repeat(FACES.len())),
        indices: (0..6).map(|f| 4 * f).flat_map(|i| [[i, i + 1, i + 2], [i + 3, i, i + 2]]).collect(),
        ..TriMesh::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn unit_meshes_face_outwards() {
        for face in 0..12 {
            let [a, b, c] = unit_cube().corners(face);
            let normal = (b - a).cross(c - a);
            assert!(normal.dot(a + b + c) > 0.0 && normal.length() == 4.0, "face {face}: {normal}");
        }
        let [a, b, c] = unit_rectangle().corners(1);
        assert_eq!((b - a).cross(c - a).normalize(), Vec3::Z);
    }
}
