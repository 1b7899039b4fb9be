//! glTF 2.0 and GLB: nodes, meshes, cameras and lights; the materials are beside this file.
//!
//! Read are the core, `KHR_lights_punctual`, `KHR_texture_transform`, `EXT_mesh_gpu_instancing`, and of materials emissive
//! strength, transmission (diffuse, too), index of refraction, volume (with the draft of its scattering), specular, clear coat, unlit and specular-glossiness. Other
//! extensions are left out with a warning, or refused where the file requires them. Photometric units are taken as they
//! are, so pictures of such files count in candela and lux. Pictures are read as they are stored, whatever they say of
//! their colours and orientation (glTF 2.0, §3.8). A file without a camera is seen from before, a little from above.
//!
//! Limits: nothing is animated, skins and morph targets are as the nodes have them; surfaces reflect on both sides, and
//! emissive ones that are not double-sided shine on the front alone; a clear coat does not dim the emission under it.

mod material;
mod texture;
mod translucent;

use crate::builder::Builder;
use crate::emitter::{Emitter, Falloff, Spot};
use crate::scene::{Geometry, LoadOptions, MaterialId, MediumId, Scene, Shape, TextureId};
use crate::sensor::{Film, FovAxis, Perspective, PixelFilter, Projection, Sensor, look_at};
use crate::{Error, Result, check};
use glam::{DAffine3, DMat3, DVec3};
use serde_json::Value;
use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::sync::Arc;
use translume_bxdf::Rgb;
use translume_mesh::TriMesh;
use translume_mesh::gltf::{Asset, Pose};

/// Extensions that are used, or that have nothing to do with pictures.
const KNOWN: [&str; 17] = [
    "EXT_mesh_gpu_instancing",
    "KHR_lights_punctual",
    "KHR_materials_clearcoat",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_materials_volume_scatter",
    "KHR_mesh_quantization",
    "KHR_node_visibility",
    "KHR_texture_transform",
    "KHR_xmp_json_ld",
];

/// A small file can have one list of vertices in many poses. Reading stops at this many vertices and triangles, and eight
/// more for each byte of the buffers.
const LARGEST_POSED: usize = 1 << 25;

/// A file cannot ask for more shapes than this.
const MOST_SHAPES: usize = 10_000_000;

/// Width of pictures: the format says the aspect ratio only.
const WIDTH: u32 = 1280;

/// Reads a `.gltf` or `.glb` file.
///
/// # Errors
/// [`Error::Io`]; [`Error::Invalid`] naming the element for damaged files; [`Error::Unsupported`] for required extensions
/// that are not known here, unless `options.lenient`.
pub fn load(path: &Path, options: &LoadOptions) -> Result<Scene> {
    let asset = Asset::open(path, &options.asset_roots).map_err(Error::from)?;
    crate::files::note(path);
    let uris = asset.json["buffers"].as_array().into_iter().flatten().filter_map(|b| b["uri"].as_str());
    uris.filter_map(|uri| asset.file(uri).ok()).filter(|f| f.is_file()).for_each(|f| crate::files::note(&f));
    let mut loader = Loader {
        builder: Builder::new(path, options),
        asset,
        meshes: HashMap::new(),
        materials: HashMap::new(),
        sets: 0,
        elements: 0,
        told: HashSet::new(),
    };
    loader.extensions()?;
    for (node, world_from_node) in loader.asset.nodes()? {
        loader.node(node, &world_from_node)?;
    }
    if loader.builder.scene.sensors.is_empty() {
        loader.default_view();
    }
    Ok(loader.builder.finish())
}

/// What a material becomes for a shape.
#[derive(Clone, Copy)]
struct Dress {
    material: MaterialId,
    radiance: Option<TextureId>,
    shines_behind: bool,
    interior: Option<MediumId>,
}

/// What of a mesh's vertices concerns its material.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
struct Vertices {
    colors: bool,
    alphas: bool,
    /// Sets of texture coordinates.
    sets: usize,
}

/// The triangles of a primitive, and whether they are in the world as they are; `None` for points and lines.
type Primitive = Option<(Arc<TriMesh>, bool)>;

/// What a primitive is made of, and the key of a pose.
type PrimitiveKey = (String, (Vec<u32>, Option<usize>));

struct Loader {
    builder: Builder,
    asset: Asset,
    meshes: HashMap<PrimitiveKey, Primitive>,
    /// By number, and what the mesh has.
    materials: HashMap<(Option<usize>, Vertices), Dress>,
    /// Sets of texture coordinates of the mesh whose material is read.
    sets: usize,
    /// Vertices and triangles that were read.
    elements: usize,
    told: HashSet<String>,
}

impl Loader {
    fn invalid(&self, what: impl Into<String>) -> Error {
        Error::invalid(&self.asset.path, None, what)
    }

    /// A warning, given once.
    fn warn_once(&mut self, what: String) {
        if self.told.insert(what.clone()) {
            self.builder.warn(format!("{}: {what}", self.asset.path.display()));
        }
    }

    fn extensions(&mut self) -> Result<()> {
        let names = |key: &str| -> Vec<String> {
            let list = self.asset.json[key].as_array().into_iter().flatten();
            list.filter_map(|v| v.as_str().map(str::to_owned)).collect()
        };
        let (used, required) = (names("extensionsUsed"), names("extensionsRequired"));
        for name in used.iter().filter(|n| !KNOWN.contains(&n.as_str())) {
            if required.contains(name) && !self.builder.options.lenient {
                let what = format!("the file requires the extension {name}, which is not supported");
                return Err(Error::unsupported(&self.asset.path, None, what));
            }
            self.warn_once(format!("the extension {name} is not supported and left out"));
        }
        Ok(())
    }

    fn node(&mut self, index: usize, world_from_node: &DAffine3) -> Result<()> {
        let node = &self.asset.document.nodes[index];
        let name = node.name.clone().unwrap_or_default();
        let (mesh, camera) = (node.mesh.map(|m| m.get()), node.camera.map(|c| c.get()));
        let light = node.extensions.get("KHR_lights_punctual").map(|l| index_of(&l["light"]));
        if let Some(mesh) = mesh {
            let pose = self.asset.pose(index);
            for place in self.asset.instances(index).map_err(Error::from)? {
                self.place(mesh, &pose, &name, *world_from_node * place)?;
            }
        }
        if let Some(camera) = camera {
            let sensor = self.camera(camera, &name, world_from_node)?;
            self.builder.scene.sensors.push(sensor);
        }
        if let Some(light) = light {
            let emitter = self.light(light, world_from_node)?;
            self.builder.scene.emitters.push(emitter);
        }
        Ok(())
    }

    /// Puts the primitives of a mesh into the scene.
    fn place(&mut self, mesh: usize, pose: &Pose, name: &str, world_from_object: DAffine3) -> Result<()> {
        let Some(source) = self.asset.document.meshes.get(mesh) else {
            return Err(self.invalid(format!("there is no mesh {mesh}")));
        };
        let materials: Vec<Option<usize>> = source.primitives.iter().map(|p| p.material.map(|m| m.get())).collect();
        for (i, material) in materials.into_iter().enumerate() {
            let Some((triangles, in_world)) = self.primitive(mesh, i, pose)? else {
                self.warn_once(format!("mesh {mesh} has points or lines, which are left out"));
                continue;
            };
            if !in_world && !check::is_invertible(&world_from_object) {
                self.warn_once(format!("node {name:?} has a degenerate transform and is left out"));
                return Ok(());
            }
            let sets = triangles.uvs.as_ref().map_or(0, |_| 1 + triangles.more_uvs.len());
            let vertices = Vertices { colors: triangles.colors.is_some(), alphas: triangles.alphas.is_some(), sets };
            let Dress { material, radiance, shines_behind, interior } = self.material(material, vertices)?;
            if self.builder.scene.shapes.len() >= MOST_SHAPES {
                let what = format!("more than {MOST_SHAPES} shapes");
                return Err(Error::unsupported(&self.asset.path, None, what));
            }
            self.builder.scene.shapes.push(Shape {
                name: name.to_owned(),
                geometry: Geometry::Mesh(triangles),
                world_from_object: if in_world { DAffine3::IDENTITY } else { world_from_object },
                flip_normals: false,
                material,
                radiance,
                shines_behind,
                interior,
                exterior: None,
            });
        }
        Ok(())
    }

    fn primitive(&mut self, mesh: usize, primitive: usize, pose: &Pose) -> Result<Primitive> {
        let key = (self.asset.recipe(mesh, primitive), pose.key());
        if let Some(known) = self.meshes.get(&key) {
            return Ok(known.clone());
        }
        let posed = self.asset.posed(mesh, primitive, pose).map_err(Error::from)?;
        let mut made = None;
        if let Some(mut posed) = posed {
            self.elements += posed.mesh.positions.len() + posed.mesh.indices.len();
            let most = LARGEST_POSED.saturating_add(self.asset.size().saturating_mul(8));
            if self.elements > most {
                let what = format!("its primitives and poses have more than {most} vertices and triangles together");
                return Err(Error::unsupported(&self.asset.path, None, what));
            }
            // Primitives may share one list of vertices of which each uses a part.
            if posed.mesh.positions.len() > 6 * posed.mesh.indices.len() {
                posed.mesh.compact();
            }
            let name = format!("{}: mesh {mesh}, primitive {primitive}", self.asset.path.display());
            self.builder.clean(&mut posed.mesh, &name);
            made = Some((Arc::new(posed.mesh), posed.in_world));
        }
        self.meshes.insert(key, made.clone());
        Ok(made)
    }

    /// A camera for a file without one: from before and a little from above and the side, with everything in view.
    fn default_view(&mut self) {
        let bounds = self.builder.scene.bounds();
        if bounds.is_empty() {
            return;
        }
        let (center, radius) = (bounds.center().as_dvec3(), 0.5 * bounds.extent().as_dvec3().length());
        let radius = if radius > 0.0 { radius } else { 1.0 };
        // The sphere around everything touches the shorter sides of the picture, but for a margin.
        let fov = 0.7_f64;
        let distance = 1.02 * radius / (0.5 * fov).sin();
        let towards = DVec3::new(0.45, 0.35, 1.0).normalize();
        let Some(world_from_camera) = look_at(center + towards * distance, center, DVec3::Y) else { return };
        let perspective = Perspective { fov: fov as f32, fov_axis: FovAxis::Smaller, principal_point_offset: [0.0; 2] };
        self.builder.scene.sensors.push(Sensor {
            name: "default view".to_owned(),
            world_from_camera,
            projection: Projection::Perspective(perspective),
            near_clip: (1e-3 * radius) as f32,
            far_clip: f32::MAX,
            film: Film { size: [WIDTH, WIDTH * 9 / 16], crop: None, filter: PixelFilter::default() },
            sample_count: None,
            medium: None,
        });
        self.warn_once("the file has no camera: everything in it is seen from before, a little from above".to_owned());
    }

    /// A camera looks along −z of its node, +x is right. Scales of nodes do not change cameras.
    fn camera(&self, index: usize, name: &str, world_from_node: &DAffine3) -> Result<Sensor> {
        let camera = &self.asset.json["cameras"][index];
        let wrong = |what: &str| self.invalid(format!("camera {index}: {what}"));
        let world_from_camera = turned(world_from_node).ok_or_else(|| wrong("its node has a degenerate transform"))?;
        let kind = camera["type"].as_str().unwrap_or_default();
        let parameters = &camera[kind];
        let positive = |key: &str| parameters[key].as_f64().filter(|v| *v > 0.0 && v.is_finite());
        let near_clip = parameters["znear"].as_f64().filter(|v| *v >= 0.0).unwrap_or(0.0) as f32;
        let far_clip = positive("zfar").map_or(f32::MAX, |v| v as f32);
        let (projection, aspect, scale) = match kind {
            "perspective" => {
                let fov = positive("yfov").filter(|f| *f < std::f64::consts::PI);
                let fov = fov.ok_or_else(|| wrong("yfov is not between 0 and π"))? as f32;
                let perspective = Perspective { fov, fov_axis: FovAxis::Y, principal_point_offset: [0.0; 2] };
                (Projection::Perspective(perspective), positive("aspectRatio").unwrap_or(16.0 / 9.0), 1.0)
            }
            "orthographic" => {
                let size = positive("xmag").zip(positive("ymag"));
                let (x, y) = size.ok_or_else(|| wrong("xmag or ymag is not above 0"))?;
                (Projection::Orthographic, x / y, x)
            }
            _ => return Err(wrong("neither perspective nor orthographic")),
        };
        let height = (f64::from(WIDTH) / aspect).round();
        if !(1.0..=65_536.0).contains(&height) {
            return Err(wrong("its aspect ratio is absurd"));
        }
        let across = DAffine3::from_scale(DVec3::new(scale, scale, 1.0));
        let film = Film { size: [WIDTH, height as u32], crop: None, filter: PixelFilter::default() };
        Ok(Sensor {
            name: name.to_owned(),
            world_from_camera: world_from_camera * across,
            projection,
            near_clip,
            far_clip,
            film,
            sample_count: None,
            medium: None,
        })
    }

    fn light(&mut self, index: Option<usize>, world_from_node: &DAffine3) -> Result<Emitter> {
        let index = index.ok_or_else(|| self.invalid("KHR_lights_punctual: \"light\" is no number"))?;
        let light = self.asset.json["extensions"]["KHR_lights_punctual"]["lights"][index].clone();
        let wrong = |what: &str| self.invalid(format!("light {index}: {what}"));
        let strength = light["intensity"].as_f64().unwrap_or(1.0) as f32;
        let color = vector3(&light["color"], [1.0; 3]) * strength;
        if !(color.is_finite() && color.min_element() >= 0.0) {
            return Err(wrong("its intensity is negative or not finite"));
        }
        let world_from_light = turned(world_from_node).ok_or_else(|| wrong("its node has a degenerate transform"))?;
        let emitter = match light["type"].as_str().unwrap_or_default() {
            "directional" => Emitter::Directional { direction: world_from_light.matrix3.z_axis, irradiance: color },
            "point" => Emitter::Point { position: world_from_light.translation, intensity: color },
            "spot" => {
                let angle = |key: &str, default: f64| light["spot"][key].as_f64().unwrap_or(default) as f32;
                let outer = angle("outerConeAngle", std::f64::consts::FRAC_PI_4);
                let inner = angle("innerConeAngle", 0.0);
                if !(inner >= 0.0 && inner <= outer && outer > 0.0 && outer <= std::f32::consts::FRAC_PI_2 + 1e-4) {
                    return Err(wrong("its cone angles are wrong"));
                }
                Emitter::Spot(Spot {
                    world_from_light,
                    intensity: color,
                    cutoff_angle: outer,
                    beam_width: inner,
                    falloff: Falloff::SquareInCosine,
                })
            }
            _ => return Err(wrong("neither directional, point nor spot")),
        };
        if !light["range"].is_null() {
            self.warn_once("the range of lights is not used: light falls off with the square alone".to_owned());
        }
        Ok(emitter)
    }
}

/// The frame of a camera or light that looks along −z of its node: rotation and place, turned about y.
fn turned(world_from_node: &DAffine3) -> Option<DAffine3> {
    let m = &world_from_node.matrix3;
    let z = (-m.z_axis).try_normalize()?;
    let x = m.y_axis.cross(z).try_normalize()?;
    let frame = DAffine3::from_mat3_translation(DMat3::from_cols(x, z.cross(x), z), world_from_node.translation);
    frame.is_finite().then_some(frame)
}

fn index_of(value: &Value) -> Option<usize> {
    value.as_f64().filter(|v| v.fract() == 0.0 && (0.0..9e15).contains(v)).map(|v| v as usize)
}

/// Three numbers, each `default` where it is missing.
fn vector3(value: &Value, default: [f32; 3]) -> Rgb {
    Rgb::from(std::array::from_fn(|i| value[i].as_f64().map_or(default[i], |v| v as f32)))
}
