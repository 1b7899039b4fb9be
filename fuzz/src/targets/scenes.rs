//! Scenes of every front end, with the files they name; and those files alone, in a scene that is sound.

use super::Said;
use crate::input::Input;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use translume_render::World;
use translume_render::checkpoint::{self, Identity};
use translume_render::film::{Aov, Film};
use translume_render::integrator::{INTEGRATORS, Settings, with_options};
use translume_render::render::{Shot, Until};
use translume_scene::material::Model;
use translume_scene::texture::Texture;
use translume_scene::{Geometry, LoadOptions, MaterialId, Scene, Shape, TextureId, read_grid};

const ENDINGS: [&str; 4] = [".xml", ".pbrt", ".gltf", ".glb"];

fn load_one(path: &Path, lenient: bool) -> (Said, Option<Scene>) {
    let options = LoadOptions {
        lenient,
        bssrdf_loader: Some(|p| translume_scatter::material::load_material(p).map_err(|e| e.to_string())),
        ..LoadOptions::default()
    };
    let scene = translume_scene::load(path, &options);
    let said = Said::of(&scene, |s| s.warnings.join("; "));
    let scene = scene.ok();
    scene.iter().for_each(check);
    (said, scene)
}

/// The file that is the scene.
fn main_file(input: &Input) -> Option<&str> {
    let named = |f: &&(String, Vec<u8>)| f.0.starts_with("scene.");
    let any = || ENDINGS.iter().find_map(|e| input.ending(e));
    input.files.iter().find(named).map(|f| f.0.as_str()).or_else(any)
}

pub(super) fn load(folder: &Path, input: &Input) -> Said {
    let Some(name) = main_file(input) else { return Said { accepted: false, text: String::new() } };
    let path = folder.join(name);
    let (said, scene) = load_one(&path, false);
    match scene {
        Some(_) => said,
        None => said.and(load_one(&path, true).0),
    }
}

/// Four by four pixels by a method that the input chooses.
pub(super) fn render(folder: &Path, input: &Input) -> Said {
    let Some(name) = main_file(input) else { return Said { accepted: false, text: String::new() } };
    let (said, scene) = load_one(&folder.join(name), true);
    let Some(scene) = scene else { return said };
    let Some(sensor) = scene.sensors.first().cloned() else { return said };
    let settings = Settings::of(&scene);
    let scene = Arc::new(scene);
    let world = match World::new(scene) {
        Ok(world) => world,
        Err(e) => return said.and(Said { accepted: true, text: e.to_string() }),
    };
    let method = &INTEGRATORS[(input.hash() >> 20) as usize % INTEGRATORS.len()];
    let few = [("photons".to_owned(), "2000".to_owned())];
    let options = if method.name == "photonmap" { &few[..] } else { &[] };
    let Ok(integrator) = with_options(method.name, settings, options) else { return said };
    if let Err(e) = integrator.check(&world) {
        return said.and(Said { accepted: true, text: e.to_string() });
    }
    let shot = Shot::new(&world, &*integrator, &sensor, Some([4, 4]), 1);
    let Ok(mut film) = shot.film(&[]) else { return said };
    let until = Until { samples: 2, time: None };
    shot.render(&mut film, &until, &AtomicBool::new(false), &mut |_, _| ());
    assert!(film.rgb().iter().all(|v| v.is_finite()), "a pixel of {} is not finite", method.name);
    said.and(Said {
        accepted: true,
        text: format!("{} {}", method.name, if film.broken() > 0 { "broken samples" } else { "" }),
    })
}

/// A reflectance of RGL's database.
pub(super) fn bsdf(folder: &Path, input: &Input) -> Said {
    let Some(name) = input.ending(".bsdf") else { return Said { accepted: false, text: String::new() } };
    within(folder, &format!("<bsdf type=\"measured\"><string name=\"filename\" value=\"{name}\"/></bsdf>"))
}

/// A spectrum.
pub(super) fn spectrum(folder: &Path, input: &Input) -> Said {
    let Some((name, _)) = input.files.first() else { return Said { accepted: false, text: String::new() } };
    within(folder, &format!("<bsdf type=\"diffuse\"><spectrum name=\"reflectance\" filename=\"{name}\"/></bsdf>"))
}

/// A sphere of a material in Mitsuba's words.
fn within(folder: &Path, material: &str) -> Said {
    let path = folder.join("wrapped.scene.xml");
    let text = format!("<scene version=\"3.0.0\"><shape type=\"sphere\">{material}</shape></scene>");
    std::fs::write(&path, text).expect("the folder is ours");
    load_one(&path, false).0
}

/// A `.vol` grid.
pub(super) fn grid(folder: &Path, input: &Input) -> Said {
    let Some((name, _)) = input.files.first() else { return Said { accepted: false, text: String::new() } };
    let grid = read_grid(&folder.join(name));
    if let Ok((grid, [lo, hi])) = &grid {
        assert!(grid.values.iter().all(|v| v.is_finite() && *v >= 0.0), "a cell is not finite or below 0");
        assert!(lo.is_finite() && hi.is_finite() && lo.cmplt(*hi).all(), "its box");
    }
    Said::of(&grid, |_| String::new())
}

/// What [`Scene`] promises.
fn check(scene: &Scene) {
    let texture = |id: TextureId| assert!(id.0 < scene.textures.len(), "texture {}", id.0);
    for (i, t) in scene.textures.iter().enumerate() {
        match t {
            Texture::Checkerboard(board) => assert!(board.color0.0 < i && board.color1.0 < i, "nested textures first"),
            Texture::Constant(rgb) => assert!(rgb.is_finite(), "a colour is not finite"),
            _ => {}
        }
    }
    for (i, material) in scene.materials.iter().enumerate() {
        let before = |id: MaterialId| assert!(id.0 < i, "nested materials come first");
        match &material.model {
            Model::Diffuse { reflectance } => texture(*reflectance),
            Model::TwoSided { front, back } => [*front, *back].into_iter().for_each(before),
            Model::Mask { opacity, nested } => (texture(*opacity), before(*nested)).1,
            Model::BumpMap { height, nested, .. } => (texture(*height), before(*nested)).1,
            Model::NormalMap { normals, nested, .. } => (texture(*normals), before(*nested)).1,
            Model::Blend { weight, first, second } => (texture(*weight), before(*first), before(*second)).0,
            _ => {}
        }
    }
    scene.shapes.iter().for_each(|s| shape(scene, s));
    scene.groups.iter().flat_map(|g| &g.shapes).for_each(|s| shape(scene, s));
    for instance in &scene.instances {
        assert!(instance.group.0 < scene.groups.len(), "an instance's group");
        assert!(instance.world_from_group.inverse().is_finite(), "an instance's transform");
    }
    for sensor in &scene.sensors {
        assert!(sensor.film.size.iter().all(|&n| n > 0) && sensor.world_from_camera.is_finite(), "a camera");
    }
    assert!(scene.warnings.iter().all(|w| w.len() < 4000 && !w.contains('\n')), "a warning is a line");
}

fn shape(scene: &Scene, s: &Shape) {
    assert!(s.material.0 < scene.materials.len(), "a shape's material");
    assert!(s.radiance.iter().all(|t| t.0 < scene.textures.len()), "a shape's radiance");
    assert!([s.interior, s.exterior].into_iter().flatten().all(|m| m.0 < scene.media.len()), "a shape's media");
    assert!(s.world_from_object.inverse().is_finite(), "a shape's transform");
    if let Geometry::Mesh(mesh) = &s.geometry {
        assert_eq!(mesh.fault(), None);
        assert!(mesh.positions.iter().flatten().all(|x| x.is_finite()), "a vertex is not finite");
    }
}

/// The render that checkpoints of the corpus belong to.
pub(crate) fn checkpointed() -> (Film, Identity) {
    let film = Film::new([5, 3], &[Aov::Variance, Aov::Albedo]).expect("a small film");
    (film, Identity { fingerprint: 0x7261_6e73_6c75_6d65, seed: 7 })
}

/// As it is, and with its checksums made right, behind which most mutations would never be seen.
pub(super) fn checkpoint(folder: &Path, input: &Input) -> Said {
    let Some((name, bytes)) = input.files.first() else { return Said { accepted: false, text: String::new() } };
    let path = folder.join(name);
    let read = |path: &Path| {
        let (mut film, identity) = checkpointed();
        let outcome = checkpoint::read(path, &mut film, &identity);
        if outcome.is_ok() {
            assert_eq!(film.rgb().len(), 3 * 15);
        }
        Said::of(&outcome, |()| String::new())
    };
    let said = read(&path);
    let sealed = folder.join("sealed.tlck");
    match std::fs::write(&sealed, seal(bytes.clone())) {
        Ok(()) => said.and(read(&sealed)),
        Err(_) => said,
    }
}

/// The checksums of header and sections of a checkpoint made right, as far as they are to be found.
fn seal(mut bytes: Vec<u8>) -> Vec<u8> {
    fn put(bytes: &mut [u8], from: usize, to: usize) -> Option<()> {
        let hash = crc32fast::hash(bytes.get(from..to)?).to_le_bytes();
        bytes.get_mut(to..to.checked_add(4)?)?.copy_from_slice(&hash);
        Some(())
    }
    let mut sealed = || {
        let length = u32::from_le_bytes(bytes.get(12..16)?.try_into().ok()?) as usize;
        let mut at = 16usize.checked_add(length)?;
        put(&mut bytes, 16, at)?;
        let header: serde_json::Value = serde_json::from_slice(bytes.get(16..at)?).ok()?;
        at += 4;
        for section in header.get("sections")?.as_array()? {
            let size = match section.get("type")?.as_str()? {
                "uint8" => 1,
                "uint32" | "float32" => 4,
                "uint64" | "float64" => 8,
                _ => 16,
            };
            let end = usize::try_from(section.get("count")?.as_u64()?).ok()?.checked_mul(size)?.checked_add(at)?;
            put(&mut bytes, at, end)?;
            at = end + 4;
        }
        Some(())
    };
    sealed();
    bytes
}
