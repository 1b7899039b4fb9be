//! The scene and its shapes.

use crate::emitter::Emitter;
use crate::material::Material;
use crate::medium::{Medium, Volume};
use crate::sensor::Sensor;
use crate::texture::{Channel, Texture};
use glam::{DAffine3, DVec3};
use std::sync::Arc;
use translume_bxdf::{Bssrdf, Rgb};
use translume_mesh::{Bounds, TriMesh};

macro_rules! ids {
    ($($(#[$doc:meta])* $name:ident),+ $(,)?) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub struct $name(pub usize);
    )+};
}

ids!(
    /// Number of a material in [`Scene::materials`].
    MaterialId,
    /// Number of a texture in [`Scene::textures`].
    TextureId,
    /// Number of a medium in [`Scene::media`].
    MediumId,
    /// Number of a group in [`Scene::groups`].
    GroupId,
);

/// Everything a picture needs. Every id in it is in range; references among materials and textures have no cycles.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// Shapes that stand in the world. Shapes may share a mesh (the same [`Arc`]) under different transforms: place such
    /// a mesh, do not copy it.
    pub shapes: Vec<Shape>,
    /// Shapes that appear only where [`Scene::instances`] places them. None of them shines.
    pub groups: Vec<Group>,
    /// Groups in their places.
    pub instances: Vec<Instance>,
    /// Materials, nested ones before those that refer to them.
    pub materials: Vec<Material>,
    /// Textures; constants too, and nested ones before those that refer to them.
    pub textures: Vec<Texture>,
    /// Lights that are no shapes.
    pub emitters: Vec<Emitter>,
    /// Participating media.
    pub media: Vec<Medium>,
    /// Cameras; the first is the one to use unless the user picks another. May be empty.
    pub sensors: Vec<Sensor>,
    /// What the file says about how to render.
    pub integrator: Integrator,
    /// What was odd and how it was dealt with, a line each.
    pub warnings: Vec<String>,
    /// All files that were read.
    pub files: Vec<std::path::PathBuf>,
}

/// A surface with its material.
#[derive(Clone, Debug)]
pub struct Shape {
    /// Name or identifier in the file, for messages; may be empty.
    pub name: String,
    /// Form, in the shape's own space.
    pub geometry: Geometry,
    /// From the shape's own space to the world, or to the group's space for shapes of groups. Invertible.
    pub world_from_object: DAffine3,
    /// Normals (those of the surface and of shading) point to the other side.
    pub flip_normals: bool,
    /// What it is made of.
    pub material: MaterialId,
    /// Emitted radiance, in W m⁻² sr⁻¹ by colour channel, on the side of the normal.
    pub radiance: Option<TextureId>,
    /// It is emitted on the other side too.
    pub shines_behind: bool,
    /// Medium on the side away from the normal. With both `None` the shape is no boundary of media.
    pub interior: Option<MediumId>,
    /// Medium on the side of the normal.
    pub exterior: Option<MediumId>,
}

/// The form of a shape.
#[derive(Clone, Debug)]
pub enum Geometry {
    /// Triangles. Vertex normals are there if shading is to be smooth, texture coordinates if there are any. Without
    /// coordinates, those of a point are its barycentric ones (of the second and third corner).
    Mesh(Arc<TriMesh>),
    /// A sphere. Texture coordinates: u the azimuth from +x towards +y over 2π, v one minus the angle from +z over π.
    Sphere {
        /// Centre.
        center: DVec3,
        /// Radius, above 0.
        radius: f64,
    },
    /// The unit disk in the xy plane, normal +z. Texture coordinates: u the radius, v one minus azimuth over 2π.
    Disk,
    /// The side of a cylinder, normal away from the axis. Texture coordinates: u the azimuth over 2π, v one minus the
    /// fraction of the way from `p0` to `p1`.
    Cylinder {
        /// One end of the axis.
        p0: DVec3,
        /// The other.
        p1: DVec3,
        /// Radius, above 0.
        radius: f64,
    },
}

/// Shapes that move together.
#[derive(Clone, Debug, Default)]
pub struct Group {
    /// Name or identifier in the file.
    pub name: String,
    /// Its shapes; their `world_from_object` leads to the group's space.
    pub shapes: Vec<Shape>,
}

/// A group in its place.
#[derive(Clone, Copy, Debug)]
pub struct Instance {
    /// Which.
    pub group: GroupId,
    /// Where; invertible.
    pub world_from_group: DAffine3,
}

/// The file's wishes about light transport.
#[derive(Clone, Debug, PartialEq)]
pub struct Integrator {
    /// The method's name in the file ("path", "volpath"); empty when it names none.
    pub name: String,
    /// Longest path in segments: 1 shows lights only, 2 adds direct light; `None` is unlimited.
    pub max_depth: Option<u32>,
    /// Segments before Russian roulette may end a path.
    pub rr_depth: u32,
    /// Lights are not seen directly by the camera.
    pub hide_emitters: bool,
}

impl Default for Integrator {
    fn default() -> Self {
        Self { name: String::new(), max_depth: None, rr_depth: 5, hide_emitters: false }
    }
}

/// Reads a measured translucent object from a file or folder; an error is a line for the user.
pub type BssrdfLoader = fn(&std::path::Path) -> Result<Arc<dyn Bssrdf>, String>;

/// How to load.
#[derive(Clone, Debug, Default)]
pub struct LoadOptions {
    /// Elements that change the picture and are not supported are left out with a warning, instead of an error.
    pub lenient: bool,
    /// Values of `$name` parameters in Mitsuba files, before the file's own `<default>`.
    pub defines: Vec<(String, String)>,
    /// What reads measured translucent objects; scenes with such are refused without it.
    pub bssrdf_loader: Option<BssrdfLoader>,
    /// Folders, beside that of the scene, where the files of a glTF file may be.
    pub asset_roots: Vec<std::path::PathBuf>,
}

impl Scene {
    /// The texture's colour if it is the same everywhere.
    pub fn constant(&self, texture: TextureId) -> Option<Rgb> {
        match &self.textures[texture.0] {
            Texture::Constant(rgb) => Some(*rgb),
            _ => None,
        }
    }

    /// About the mean of the texture over its picture; of vertex colours the factor on them, of a product that of the means. Takes as
    /// long as there are textures in it, in however many ways these refer to each other.
    pub fn mean(&self, texture: TextureId) -> Rgb {
        self.mean_by(texture, &mut std::collections::HashMap::new())
    }

    fn mean_by(&self, texture: TextureId, known: &mut std::collections::HashMap<TextureId, Rgb>) -> Rgb {
        if let Some(mean) = known.get(&texture) {
            return *mean;
        }
        let mean = match &self.textures[texture.0] {
            Texture::Constant(rgb) | Texture::VertexColor(rgb) => return *rgb,
            Texture::VertexAlpha => Rgb::ONE,
            Texture::Product(a, b) => self.mean_by(*a, known) * self.mean_by(*b, known),
            Texture::Complement(of) => Rgb::ONE - self.mean_by(*of, known),
            // Nothing is known but where it is the same everywhere.
            Texture::Threshold { of, at } => match self.constant(*of) {
                Some(rgb) => Rgb::splat(if rgb.x >= *at { 1.0 } else { 0.0 }),
                None => Rgb::splat(0.5),
            },
            Texture::Checkerboard(board) => {
                0.5 * (self.mean_by(board.color0, known) + self.mean_by(board.color1, known))
            }
            Texture::Bitmap(b) => mean_of(b),
        };
        known.insert(texture, mean);
        mean
    }

    /// Triangles as stored (shared meshes once), and as seen (each placement counted).
    pub fn triangles(&self) -> (u64, u64) {
        let mut seen = std::collections::HashSet::new();
        let mut stored = 0;
        let mut count = |shapes: &[Shape]| -> u64 {
            let meshes = shapes.iter().filter_map(|s| match &s.geometry {
                Geometry::Mesh(mesh) => Some(mesh),
                _ => None,
            });
            meshes
                .map(|mesh| {
                    let n = mesh.indices.len() as u64;
                    stored += if seen.insert(Arc::as_ptr(mesh)) { n } else { 0 };
                    n
                })
                .sum()
        };
        let shapes = count(&self.shapes);
        let groups: Vec<u64> = self.groups.iter().map(|g| count(&g.shapes)).collect();
        let placed = self.instances.iter().map(|i| groups[i.group.0]).fold(shapes, u64::saturating_add);
        (stored, placed)
    }

    /// Bytes of meshes, pictures and grids, shared ones once.
    pub fn heap_bytes(&self) -> u64 {
        let mut seen = std::collections::HashSet::new();
        let mut bytes = 0;
        let mut once = |address: usize, size: usize| bytes += if seen.insert(address) { size as u64 } else { 0 };
        for shape in self.shapes.iter().chain(self.groups.iter().flat_map(|g| &g.shapes)) {
            if let Geometry::Mesh(mesh) = &shape.geometry {
                let optional = [mesh.normals.as_ref(), mesh.colors.as_ref()].into_iter().flatten().map(Vec::len);
                let triples = mesh.positions.len() + mesh.indices.len() + optional.sum::<usize>();
                let pairs: usize = mesh.uvs.iter().chain(&mesh.more_uvs).map(Vec::len).sum();
                let others =
                    16 * mesh.tangents.as_ref().map_or(0, Vec::len) + 4 * mesh.alphas.as_ref().map_or(0, Vec::len);
                once(Arc::as_ptr(mesh) as usize, 12 * triples + 8 * pairs + others);
            }
        }
        let bitmaps = self.textures.iter().filter_map(|t| match t {
            Texture::Bitmap(b) => Some(&b.image),
            _ => None,
        });
        let environments = self.emitters.iter().filter_map(|e| match e {
            Emitter::Environment { image, .. } => Some(image),
            _ => None,
        });
        for image in bitmaps.chain(environments) {
            let samples = image.pixels.as_raw().len() + image.alpha.as_ref().map_or(0, Vec::len);
            once(Arc::as_ptr(image) as usize, 4 * samples);
        }
        for volume in self.media.iter().flat_map(|m| [&m.sigma_t, &m.albedo]) {
            if let Volume::Grid { grid, .. } = volume {
                once(Arc::as_ptr(grid) as usize, 4 * grid.values.len());
            }
        }
        bytes
    }

    /// The box around all shapes and instances. Of scenes that place very many vertices it is that of their meshes' boxes.
    pub fn bounds(&self) -> Bounds {
        let groups: Vec<Bounds> = self.groups.iter().map(|g| bounds_of(&g.shapes)).collect();
        let mut bounds = bounds_of(&self.shapes);
        for instance in &self.instances {
            bounds.join(&transformed(&groups[instance.group.0], &instance.world_from_group));
        }
        bounds
    }
}

/// The mean of a picture's values.
fn mean_of(b: &crate::texture::Bitmap) -> Rgb {
    let mean = |values: &mut dyn Iterator<Item = f32>| {
        let (sum, n) = values.fold((0.0, 0u64), |(sum, n), v| (sum + f64::from(v), n + 1));
        (sum / n.max(1) as f64) as f32
    };
    let of = |c: usize| mean(&mut b.image.pixels.as_raw().iter().skip(c).step_by(3).copied());
    let value = match b.channel {
        Channel::Rgb => Rgb::new(of(0), of(1), of(2)),
        Channel::Red => Rgb::splat(of(0)),
        Channel::Green => Rgb::splat(of(1)),
        Channel::Blue => Rgb::splat(of(2)),
        Channel::Alpha => Rgb::splat(b.image.alpha.as_ref().map_or(1.0, |a| mean(&mut a.iter().copied()))),
    };
    value * b.scale
}

impl Geometry {
    /// The box in the shape's own space.
    pub fn bounds(&self) -> Bounds {
        match self {
            Self::Mesh(mesh) => mesh.bounds(),
            Self::Sphere { center, radius } => Bounds {
                lo: (center - DVec3::splat(*radius)).as_vec3(),
                hi: (center + DVec3::splat(*radius)).as_vec3(),
            },
            Self::Disk => Bounds { lo: glam::Vec3::new(-1.0, -1.0, 0.0), hi: glam::Vec3::new(1.0, 1.0, 0.0) },
            Self::Cylinder { p0, p1, radius } => {
                let axis = (p1 - p0).normalize_or_zero();
                // A disk reaches r √(1 − a²) along an axis to which its normal has the cosine a.
                let reach = (DVec3::ONE - axis * axis).max(DVec3::ZERO).map(f64::sqrt) * *radius;
                Bounds { lo: (p0.min(*p1) - reach).as_vec3(), hi: (p0.max(*p1) + reach).as_vec3() }
            }
        }
    }
}

impl Shape {
    /// A box around the shape in the world: exact for meshes, that of the transformed box for the others.
    pub fn bounds(&self) -> Bounds {
        let Geometry::Mesh(mesh) = &self.geometry else {
            return transformed(&self.geometry.bounds(), &self.world_from_object);
        };
        let mut bounds = Bounds::EMPTY;
        for p in &mesh.positions {
            let p = self.world_from_object.transform_point3(DVec3::from(p.map(f64::from))).as_vec3();
            if p.is_finite() {
                bounds.grow(p);
            }
        }
        bounds
    }
}

/// More vertices than this are not looked at one by one, where their meshes stand more than once.
const MOST_BOUNDED: usize = 1 << 25;

fn bounds_of(shapes: &[Shape]) -> Bounds {
    let vertices = |s: &Shape| if let Geometry::Mesh(mesh) = &s.geometry { mesh.positions.len() } else { 1 };
    let mut bounds = Bounds::EMPTY;
    if shapes.iter().map(vertices).fold(0, usize::saturating_add) <= MOST_BOUNDED {
        shapes.iter().for_each(|s| bounds.join(&s.bounds()));
        return bounds;
    }
    let mut boxes = std::collections::HashMap::new();
    for shape in shapes {
        let own = match &shape.geometry {
            Geometry::Mesh(mesh) => *boxes.entry(Arc::as_ptr(mesh)).or_insert_with(|| mesh.bounds()),
            other => other.bounds(),
        };
        bounds.join(&transformed(&own, &shape.world_from_object));
    }
    bounds
}

fn transformed(b: &Bounds, m: &DAffine3) -> Bounds {
    let mut bounds = Bounds::EMPTY;
    for corner in 0..8 {
        let pick = |axis: usize| f64::from(if corner >> axis & 1 == 0 { b.lo[axis] } else { b.hi[axis] });
        if !b.is_empty() {
            bounds.grow(m.transform_point3(DVec3::new(pick(0), pick(1), pick(2))).as_vec3());
        }
    }
    bounds
}
