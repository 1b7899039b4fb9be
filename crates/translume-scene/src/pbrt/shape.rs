//! Shapes.

use super::Loader;
use super::parameters::Parameters;
use crate::builder::{MeshKey, Normals};
use crate::material::Model;
use crate::scene::{Geometry, Shape};
use crate::{Result, check};
use glam::{DAffine3, DVec3, Vec3};
use std::sync::Arc;
use translume_mesh::TriMesh;

impl Loader {
    pub(super) fn shape(&mut self, kind: &str, p: &Parameters) -> Result<()> {
        let mut world_from_object = self.placed(&p.place)?;
        let geometry = match kind {
            "trianglemesh" => Geometry::Mesh(Arc::new(self.triangle_mesh(p)?)),
            "plymesh" => Geometry::Mesh(self.ply_mesh(p)?),
            "sphere" => {
                let radius = radius(p)?;
                self.whole(p, &[("zmin", -radius), ("zmax", radius), ("phimax", 360.0)])?;
                Geometry::Sphere { center: DVec3::ZERO, radius }
            }
            "disk" => {
                self.whole(p, &[("innerradius", 0.0), ("phimax", 360.0)])?;
                let (radius, height) = (radius(p)?, p.number("height", 0.0)?);
                let size = DAffine3::from_scale(DVec3::new(radius, radius, 1.0));
                world_from_object *= DAffine3::from_translation(DVec3::Z * height) * size;
                Geometry::Disk
            }
            "cylinder" => {
                self.whole(p, &[("phimax", 360.0)])?;
                let (low, high) = (p.number("zmin", -1.0)?, p.number("zmax", 1.0)?);
                if low == high {
                    return Err(p.place.invalid("the cylinder has no height"));
                }
                Geometry::Cylinder { p0: DVec3::Z * low, p1: DVec3::Z * high, radius: radius(p)? }
            }
            _ => return Err(p.place.unsupported(format!("shape {kind:?} is not supported"))),
        };
        if !check::is_invertible(&world_from_object) {
            return Err(p.place.invalid("the shape is too small for numbers"));
        }
        let mut material = self.state.material.unwrap_or_else(|| self.builder.gray(0.5));
        if let Some(opacity) = self.optional(p, "alpha")? {
            material = self.builder.material("", Model::Mask { opacity, nested: material });
        }
        let mut shines_behind = false;
        let radiance = match self.state.area_light.clone() {
            Some(light) => {
                if light.get("filename").is_some() {
                    return Err(light.place.unsupported("area lights from a picture"));
                }
                shines_behind = light.boolean("twosided", false)?;
                let radiance = self.strength(&light, "L")?;
                self.finish("diffuse", &light);
                Some(self.builder.constant(radiance))
            }
            None => None,
        };
        self.finish(kind, p);
        let shape = Shape {
            name: String::new(),
            geometry,
            world_from_object,
            flip_normals: self.state.reverse,
            material,
            radiance,
            shines_behind,
            interior: self.state.interior,
            exterior: self.state.exterior,
        };
        match &mut self.group {
            Some((_, group)) => group.shapes.push(shape),
            None => self.builder.scene.shapes.push(shape),
        }
        Ok(())
    }

    /// Parameters that cut a quadric must leave it whole.
    fn whole(&mut self, p: &Parameters, uncut: &[(&str, f64)]) -> Result<()> {
        for &(name, value) in uncut {
            let given = p.number(name, value)?;
            if given.abs() < value.abs() || given * value < 0.0 || (value == 0.0 && given != 0.0) {
                return Err(p.place.unsupported(format!("a quadric cut by {name:?} is not supported")));
            }
        }
        Ok(())
    }

    fn triangle_mesh(&mut self, p: &Parameters) -> Result<TriMesh> {
        let positions = p.rows::<3>("P")?.ok_or_else(|| p.place.invalid("the mesh has no points \"P\""))?;
        let indices = match p.numbers("indices")? {
            Some(values) => {
                let (rows, rest) = values.as_chunks::<3>();
                let index =
                    |v: &f64| (v.fract() == 0.0 && (0.0..positions.len() as f64).contains(v)).then_some(*v as u32);
                let triangle = |r: &[f64; 3]| Some([index(&r[0])?, index(&r[1])?, index(&r[2])?]);
                let triangles: Option<Vec<_>> = rows.iter().map(triangle).collect();
                triangles.filter(|_| rest.is_empty()).ok_or_else(|| {
                    p.place.invalid(format!("\"indices\" are not triples of numbers below {}", positions.len()))
                })?
            }
            None if positions.len() == 3 => vec![[0, 1, 2]],
            None => return Err(p.place.invalid("the mesh has no \"indices\"")),
        };
        let uvs = match p.rows::<2>("uv")? {
            Some(uvs) => Some(uvs),
            None => p.rows::<2>("st")?,
        };
        let _ = p.get("S");
        let mut mesh = TriMesh { positions, normals: p.rows::<3>("N")?, uvs, indices, ..TriMesh::default() };
        if let Some(fault) = mesh.fault() {
            return Err(p.place.invalid(fault));
        }
        let name = p.place.warning("mesh");
        self.builder.clean(&mut mesh, &name);
        wind_by_normals(&mut mesh);
        Ok(mesh)
    }

    fn ply_mesh(&mut self, p: &Parameters) -> Result<Arc<TriMesh>> {
        let file = p.text("filename")?.ok_or_else(|| p.place.invalid("plymesh has no \"filename\""))?;
        let path = self.folder.join(file);
        if let Some(mesh) = self.ply.get(&path) {
            return Ok(mesh.clone());
        }
        let key = MeshKey { path: path.clone(), part: None, normals: Normals::Keep, flip_v: false };
        let loaded = self.builder.mesh(key).map_err(|e| e.at(&p.place.file, p.place.line))?;
        let mut mesh = (*loaded.mesh).clone();
        wind_by_normals(&mut mesh);
        let mesh = Arc::new(mesh);
        self.ply.insert(path, mesh.clone());
        Ok(mesh)
    }
}

fn radius(p: &Parameters) -> Result<f64> {
    match p.number("radius", 1.0)? {
        r if r > 0.0 => Ok(r),
        _ => Err(p.place.invalid("the radius is not above 0")),
    }
}

/// pbrt turns a triangle's normal to the side of its vertex normals: turns the triangle over where they disagree.
fn wind_by_normals(mesh: &mut TriMesh) {
    let Some(normals) = &mesh.normals else { return };
    for triangle in &mut mesh.indices {
        let [a, b, c] = triangle.map(|i| Vec3::from(mesh.positions[i as usize]));
        let side: Vec3 = triangle.iter().map(|&i| Vec3::from(normals[i as usize])).sum();
        if (b - a).cross(c - a).dot(side) < 0.0 {
            triangle.swap(1, 2);
        }
    }
}
