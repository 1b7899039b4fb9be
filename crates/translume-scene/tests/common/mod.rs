//! Scenes in a folder of their own, and what holds for every scene that loads.
#![allow(dead_code, reason = "each test file uses a part of it")]

use std::path::{Path, PathBuf};
use tempfile::TempDir;
use translume_scene::material::Model;
use translume_scene::texture::Texture;
use translume_scene::{Geometry, LoadOptions, MaterialId, Scene, Shape, TextureId, load};

/// A folder with files.
pub(crate) struct Folder(TempDir);

impl Folder {
    pub(crate) fn new() -> Self {
        Self(TempDir::new().expect("a folder"))
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(crate) fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        std::fs::write(self.path(name), bytes).expect("writable");
        self.path(name)
    }

    /// Loads `text` as the file `name`.
    pub(crate) fn load(&self, name: &str, text: &str) -> translume_scene::Result<Scene> {
        load(&self.write(name, text), &LoadOptions::default())
    }

    pub(crate) fn lenient(&self, name: &str, text: &str) -> Scene {
        load(&self.write(name, text), &LoadOptions { lenient: true, ..LoadOptions::default() }).expect("lenient")
    }
}

/// A Mitsuba scene of this version.
pub(crate) fn xml(version: &str, inside: &str) -> String {
    format!("<scene version=\"{version}\">\n{inside}\n</scene>")
}

pub(crate) fn mitsuba(inside: &str) -> Scene {
    let scene = Folder::new().load("scene.xml", &xml("3.0.0", inside));
    let scene = scene.unwrap_or_else(|e| panic!("{inside}: {e}"));
    check(&scene);
    scene
}

/// The message for a scene that must not load.
pub(crate) fn mitsuba_error(inside: &str) -> String {
    match Folder::new().load("scene.xml", &xml("3.0.0", inside)) {
        Ok(_) => panic!("loads: {inside}"),
        Err(e) => e.to_string(),
    }
}

/// What [`Scene`] promises.
pub(crate) fn check(scene: &Scene) {
    let texture = |id: TextureId| assert!(id.0 < scene.textures.len());
    for (i, t) in scene.textures.iter().enumerate() {
        match t {
            Texture::Checkerboard(board) => assert!(board.color0.0 < i && board.color1.0 < i),
            Texture::Product(a, b) => assert!(a.0 < i && b.0 < i),
            Texture::Complement(of) | Texture::Threshold { of, .. } => assert!(of.0 < i),
            _ => {}
        }
    }
    for (i, material) in scene.materials.iter().enumerate() {
        let before = |id: MaterialId| assert!(id.0 < i, "nested materials come first");
        match &material.model {
            Model::Diffuse { reflectance } => texture(*reflectance),
            Model::DiffuseTransmission { reflectance, transmittance } => {
                [*reflectance, *transmittance].into_iter().for_each(texture);
            }
            Model::MetalRough(p) => {
                let normals = p.coat_normals.map_or(p.coat, |(id, _)| id);
                [
                    p.base_color,
                    p.metallic,
                    p.roughness,
                    p.f0,
                    p.specular,
                    p.transmission,
                    p.coat,
                    p.coat_roughness,
                    normals,
                ]
                .into_iter()
                .for_each(texture);
                assert!(p.solid.is_none_or(|eta| eta >= 1.0 && eta.is_finite()));
            }
            Model::ThinPrincipled(p) => {
                [p.base_color, p.transmission_color, p.diff_trans, p.roughness, p.metallic]
                    .into_iter()
                    .for_each(texture);
                assert!(p.eta >= 1.0 && p.eta.is_finite());
            }
            Model::TwoSided { front, back } => [*front, *back].into_iter().for_each(before),
            Model::Mask { opacity, nested } => (texture(*opacity), before(*nested)).1,
            Model::BumpMap { height, nested, .. } => (texture(*height), before(*nested)).1,
            Model::NormalMap { normals, nested, .. } => (texture(*normals), before(*nested)).1,
            Model::Blend { weight, first, second } => (texture(*weight), before(*first), before(*second)).0,
            _ => {}
        }
    }
    let shape = |s: &Shape| {
        assert!(s.material.0 < scene.materials.len());
        s.radiance.into_iter().for_each(texture);
        assert!([s.interior, s.exterior].into_iter().flatten().all(|m| m.0 < scene.media.len()));
        assert!(s.world_from_object.inverse().is_finite());
        if let Geometry::Mesh(mesh) = &s.geometry {
            assert_eq!(mesh.fault(), None);
            assert!(mesh.positions.iter().flatten().all(|x| x.is_finite()));
        }
    };
    scene.shapes.iter().for_each(shape);
    scene.groups.iter().flat_map(|g| &g.shapes).for_each(|s| {
        shape(s);
        assert!(s.radiance.is_none(), "groups do not shine");
    });
    for instance in &scene.instances {
        assert!(instance.group.0 < scene.groups.len() && instance.world_from_group.inverse().is_finite());
    }
    for sensor in &scene.sensors {
        assert!(sensor.film.size.iter().all(|&n| n > 0) && sensor.world_from_camera.is_finite());
    }
}

/// Damages `seed` at random, many times, and sees that loading gives a sound scene or an error, and returns.
pub(crate) fn survives(name: &str, seed: &[u8], rounds: u64, folder: &Folder) {
    survives_within(&folder.path(name), name, seed, rounds, folder);
}

/// The same for the file `name` that `scene` names.
pub(crate) fn survives_within(scene: &Path, name: &str, seed: &[u8], rounds: u64, folder: &Folder) {
    let mut loaded = 0;
    for round in 0..rounds {
        let mut rng = translume_core::rng::Pcg32::new(round, 7);
        let mut bytes = seed.to_vec();
        for _ in 0..1 + rng.next_u32() % 4 {
            damage(&mut bytes, &mut rng);
        }
        folder.write(name, &bytes);
        for lenient in [false, true] {
            if let Ok(scene) = load(scene, &LoadOptions { lenient, ..LoadOptions::default() }) {
                check(&scene);
                loaded += 1;
            }
        }
    }
    assert!(loaded > 0, "the damage is too great to test anything");
}

fn damage(bytes: &mut Vec<u8>, rng: &mut translume_core::rng::Pcg32) {
    let mut below = |n: usize| rng.next_u32() as usize % n.max(1);
    let at = below(bytes.len());
    match below(6) {
        0 => bytes.truncate(at),
        1 if at < bytes.len() => bytes[at] ^= 1 << below(8),
        2 => {
            let end = (at + below(30)).min(bytes.len());
            bytes.drain(at..end);
        }
        3 => {
            let end = (at + below(60)).min(bytes.len());
            let copy = bytes[at..end].to_vec();
            let to = below(bytes.len());
            bytes.splice(to..to, copy);
        }
        // Numbers are where it hurts.
        4 => {
            let digits: Vec<usize> = (0..bytes.len()).filter(|&i| bytes[i].is_ascii_digit()).collect();
            if !digits.is_empty() {
                let i = digits[below(digits.len())];
                let numbers: [&[u8]; 6] = [b"-1", b"0", b"1e38", b"99999999999", b"nan", b"1e-300"];
                bytes.splice(i..=i, numbers[below(6)].iter().copied());
            }
        }
        _ if at < bytes.len() => bytes[at] = b" <>\"'[]{}$/&;,:=0-e"[below(19)],
        _ => {}
    }
}
