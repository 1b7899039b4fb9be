//! glTF files put together by hand, and what the middle of their pictures shows.

use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use translume_render::World;
use translume_render::integrator::{self, Settings};
use translume_render::render::{Shot, Until};
use translume_scene::{LoadOptions, Scene, load};

pub(crate) const PI: f64 = std::f64::consts::PI;

/// A camera at z = 3 that looks at the origin through a narrow opening; squares face it.
pub(crate) struct File {
    pub(crate) json: Value,
    bytes: Vec<u8>,
    /// PNG files by name.
    pictures: Vec<(String, Vec<u8>)>,
}

/// Corners of a square, counter-clockwise from the lower left.
const CORNERS: [[f32; 2]; 4] = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];

impl File {
    pub(crate) fn new() -> Self {
        let json = json!({
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
            "nodes": [{"camera": 0, "translation": [0, 0, 3]}],
            "cameras": [{"type": "perspective", "perspective": {"yfov": 0.02, "aspectRatio": 1.0, "znear": 0.01}}],
            "meshes": [], "materials": [], "accessors": [], "bufferViews": [], "textures": [], "images": [],
            "samplers": [{"magFilter": 9728}],
            "extensions": {"KHR_lights_punctual": {"lights": [{"type": "directional", "intensity": PI}]}},
        });
        Self { json, bytes: Vec::new(), pictures: Vec::new() }
    }

    fn push(&mut self, list: &str, value: Value) -> usize {
        let list = self.json[list].as_array_mut().unwrap();
        list.push(value);
        list.len() - 1
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let offset = self.bytes.len();
        self.bytes.extend(bytes);
        self.push("bufferViews", json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()}))
    }

    /// Floats as an accessor of this type.
    pub(crate) fn floats(&mut self, shape: &str, rows: &[f32]) -> usize {
        let components = ["SCALAR", "", "VEC2", "VEC3", "VEC4"].iter().position(|s| *s == shape).unwrap_or(16).max(1);
        let bytes: Vec<u8> = rows.iter().flat_map(|v| v.to_le_bytes()).collect();
        let (view, count) = (self.view(&bytes), rows.len() / components);
        self.push("accessors", json!({"bufferView": view, "componentType": 5126, "count": count, "type": shape}))
    }

    /// Four rows of bytes.
    pub(crate) fn bytes(&mut self, shape: &str, rows: &[u8], normalized: bool) -> usize {
        let view = self.view(rows);
        let accessor =
            json!({"bufferView": view, "componentType": 5121, "count": 4, "type": shape, "normalized": normalized});
        self.push("accessors", accessor)
    }

    pub(crate) fn accessor(&mut self, accessor: Value) -> usize {
        self.push("accessors", accessor)
    }

    pub(crate) fn raw_view(&mut self, bytes: &[u8]) -> usize {
        self.view(bytes)
    }

    /// The same for each corner of the square.
    pub(crate) fn all<const N: usize>(&mut self, row: [f32; N]) -> usize {
        let shape = ["SCALAR", "", "VEC2", "VEC3", "VEC4"][if N == 1 { 0 } else { N }];
        self.floats(shape, &row.repeat(4))
    }

    pub(crate) fn material(&mut self, material: Value) -> usize {
        self.push("materials", material)
    }

    /// A square of half edge 1 as a primitive, with texture coordinates (v down) over the whole picture.
    pub(crate) fn primitive(&mut self, material: usize) -> Value {
        let positions: Vec<f32> = CORNERS.iter().flat_map(|[x, y]| [*x, *y, 0.0]).collect();
        let uvs: Vec<f32> = CORNERS.iter().flat_map(|[x, y]| [0.5 + 0.5 * x, 0.5 - 0.5 * y]).collect();
        let attributes = json!({
            "POSITION": self.floats("VEC3", &positions),
            "NORMAL": self.all([0.0, 0.0, 1.0]),
            "TEXCOORD_0": self.floats("VEC2", &uvs),
        });
        let view = self.view(&[0, 1, 2, 0, 2, 3]);
        let indices = self.accessor(json!({"bufferView": view, "componentType": 5121, "count": 6, "type": "SCALAR"}));
        json!({"attributes": attributes, "indices": indices, "material": material})
    }

    pub(crate) fn mesh(&mut self, primitive: Value) -> usize {
        self.push("meshes", json!({"primitives": [primitive]}))
    }

    /// A node of the scene.
    pub(crate) fn node(&mut self, node: Value) -> usize {
        let number = self.push("nodes", node);
        self.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(number.into());
        number
    }

    /// A square in its place.
    pub(crate) fn square(&mut self, material: Value, place: Value) -> usize {
        let material = self.material(material);
        let primitive = self.primitive(material);
        self.placed(primitive, place)
    }

    pub(crate) fn placed(&mut self, primitive: Value, mut place: Value) -> usize {
        place["mesh"] = self.mesh(primitive).into();
        self.node(place)
    }

    /// A picture as a texture, one pixel after the other.
    pub(crate) fn texture(&mut self, size: (u32, u32), pixels: &[[u8; 4]]) -> usize {
        let mut png = std::io::Cursor::new(Vec::new());
        let image = image::RgbaImage::from_raw(size.0, size.1, pixels.concat()).unwrap();
        image.write_to(&mut png, image::ImageFormat::Png).unwrap();
        self.png(png.into_inner())
    }

    pub(crate) fn png(&mut self, bytes: Vec<u8>) -> usize {
        let name = format!("{}.png", self.pictures.len());
        self.pictures.push((name.clone(), bytes));
        let source = self.push("images", json!({"uri": name}));
        self.push("textures", json!({"source": source, "sampler": 0}))
    }

    /// Parallel light, of irradiance π where it is perpendicular, turned about x by so many degrees.
    pub(crate) fn sun(&mut self, degrees: f64) {
        let (sin, cos) = (0.5 * degrees.to_radians()).sin_cos();
        let light = json!({"KHR_lights_punctual": {"light": 0}});
        self.node(json!({"extensions": light, "rotation": [-sin, 0.0, 0.0, cos]}));
    }

    pub(crate) fn scene(&self) -> Scene {
        let folder = tempfile::tempdir().unwrap();
        let mut json = self.json.clone();
        json["buffers"] = json!([{"byteLength": self.bytes.len(), "uri": "all.bin"}]);
        std::fs::write(folder.path().join("all.bin"), &self.bytes).unwrap();
        for (name, bytes) in &self.pictures {
            std::fs::write(folder.path().join(name), bytes).unwrap();
        }
        let path = folder.path().join("scene.gltf");
        std::fs::write(&path, json.to_string()).unwrap();
        load(&path, &LoadOptions::default()).unwrap()
    }

    /// Mean of the picture.
    pub(crate) fn rendered(&self, method: &str, spp: u64) -> [f32; 3] {
        let scene = self.scene();
        assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
        picture(&scene, method, spp)
    }

    /// The picture is of this colour, up to a part of it.
    #[track_caller]
    pub(crate) fn shows(&self, expected: [f32; 3], part: f32) {
        let got = self.rendered("path", 64);
        for (g, e) in got.iter().zip(expected) {
            assert!((g - e).abs() <= part * e + 1e-4, "{got:?} instead of {expected:?}");
        }
    }
}

pub(crate) fn picture(scene: &Scene, method: &str, spp: u64) -> [f32; 3] {
    let world = World::new(Arc::new(scene.clone())).unwrap();
    let integrator = integrator::by_name(method, Settings::of(scene)).unwrap();
    integrator.check(&world).unwrap();
    let shot = Shot::new(&world, &*integrator, &scene.sensors[0], Some([8, 8]), 1);
    let mut film = shot.film(&[]).unwrap();
    shot.render(&mut film, &Until { samples: spp, time: None }, &AtomicBool::new(false), &mut |_, _| {});
    let rgb = film.rgb();
    [0, 1, 2].map(|c| rgb.iter().skip(c).step_by(3).sum::<f32>() / 64.0)
}

/// A Lambertian material of this colour, with more.
pub(crate) fn matte(color: [f32; 4], more: Value) -> Value {
    let mut material = json!({
        "pbrMetallicRoughness": {"baseColorFactor": color, "metallicFactor": 0},
        "extensions": {"KHR_materials_specular": {"specularFactor": 0}},
    });
    for (key, value) in more.as_object().unwrap() {
        match value.as_object() {
            Some(inside) => inside.iter().for_each(|(k, v)| material[key][k] = v.clone()),
            None => material[key] = value.clone(),
        }
    }
    material
}

/// A material that glows and reflects nothing.
pub(crate) fn glow(radiance: [f32; 3]) -> Value {
    matte([0.0, 0.0, 0.0, 1.0], json!({"emissiveFactor": radiance}))
}
