//! Translucent materials in the words of each format.

mod common;

use common::{Folder, check, mitsuba, mitsuba_error, xml};
use std::path::Path;
use std::sync::Arc;
use translume_bxdf::bssrdf::{Bssrdf, Site};
use translume_bxdf::homogeneous::{Diffusion, Homogeneous};
use translume_bxdf::{Distribution, Rgb};
use translume_scene::glam::{Vec2, Vec3};
use translume_scene::material::{Model, Subsurface};
use translume_scene::{LoadOptions, Scene, load};

fn under(scene: &Scene) -> Subsurface {
    check(scene);
    match &scene.materials[scene.shapes[0].material.0].model {
        Model::Subsurface(s) => (**s).clone(),
        other => panic!("{other:?}"),
    }
}

fn site(x: f32) -> Site {
    Site { p: Vec3::new(x, 0.0, 0.0), face: 0, uv: Vec2::ZERO }
}

/// The reflectance of a material a unit away.
fn value(model: &dyn Bssrdf) -> Rgb {
    model.eval(&site(0.0), &site(1.0))
}

#[test]
fn ways_to_say_a_material() {
    let made = |inside: &str| {
        under(&mitsuba(&format!("<shape type=\"sphere\"><bsdf type=\"subsurface\">{inside}</bsdf></shape>")))
    };
    let (s, a) = (Rgb::new(2.19, 2.62, 3.00), Rgb::new(0.0021, 0.0041, 0.0071));
    let marble = made("<string name=\"material\" value=\"marble\"/>");
    assert!((marble.eta - 1.5).abs() < 1e-6 && marble.roughness.is_none() && !marble.in_object_space);
    let same = Homogeneous::new(Diffusion::Dipole, s, a, marble.eta).unwrap();
    assert_eq!(value(&*marble.model), value(&same));
    // In a scene of centimetres.
    let large = made("<string name=\"material\" value=\"marble\"/><float name=\"scale\" value=\"10\"/>");
    assert_eq!(
        value(&*large.model),
        value(&Homogeneous::new(Diffusion::Dipole, s * 10.0, a * 10.0, large.eta).unwrap())
    );
    let given = made(
        "<rgb name=\"sigma_s\" value=\"4.38 5.24 6\"/><rgb name=\"sigma_a\" value=\"0.0021 0.0041 0.0071\"/><float name=\"g\" value=\"0.5\"/>
         <string name=\"model\" value=\"better-dipole\"/><float name=\"int_ior\" value=\"1.5\"/><float name=\"ext_ior\" value=\"1\"/>
         <float name=\"alpha\" value=\"0.3\"/><string name=\"distribution\" value=\"ggx\"/>",
    );
    let same = Homogeneous::new(Diffusion::BetterDipole, s, a, 1.5).unwrap();
    assert!((value(&*given.model) - value(&same)).abs().max_element() < 1e-6);
    assert_eq!(given.roughness, Some((Distribution::Ggx, 0.3)));
    let by_look = made("<rgb name=\"reflectance\" value=\"0.7 0.5 0.2\"/><float name=\"mfp\" value=\"0.5\"/>");
    assert!((by_look.model.total(&site(0.0)) - Rgb::new(0.7, 0.5, 0.2)).abs().max_element() < 1e-3);
    // OpenPBR's words: the radius is the mean free path, shorter in green and blue.
    let openpbr = made(
        "<rgb name=\"subsurface_color\" value=\"0.8 0.6 0.4\"/><float name=\"subsurface_radius\" value=\"0.4\"/>
         <rgb name=\"subsurface_radius_scale\" value=\"1 0.5 0.2\"/><float name=\"subsurface_scatter_anisotropy\" value=\"0.5\"/>",
    );
    let same = Homogeneous::from_reflectance(
        Diffusion::Dipole,
        Rgb::new(0.8, 0.6, 0.4),
        Rgb::new(0.8, 0.4, 0.16),
        openpbr.eta,
    );
    assert!((value(&*openpbr.model) - value(&same.unwrap())).abs().max_element() < 1e-6);
    for (wrong, says) in [
        (
            "<float name=\"subsurface_color\" value=\"0.5\"/><float name=\"subsurface_scatter_anisotropy\" value=\"1\"/>",
            "between −1 and 1",
        ),
        ("<string name=\"material\" value=\"granite\"/>", "not known"),
        ("<float name=\"sigma_s\" value=\"0\"/>", "no scattering material"),
        ("<float name=\"sigma_s\" value=\"1\"/><string name=\"model\" value=\"x\"/>", "no model of diffusion"),
        ("<float name=\"sigma_s\" value=\"1\"/><float name=\"int_ior\" value=\"9\"/>", "index of refraction"),
        ("<float name=\"sigma_t\" value=\"1\"/>", "without albedo"),
        ("<string name=\"filename\" value=\"m\"/>", "not read here"),
    ] {
        let error = mitsuba_error(&format!("<shape type=\"sphere\"><bsdf type=\"subsurface\">{wrong}</bsdf></shape>"));
        assert!(error.contains(says), "{wrong}: {error}");
    }
}

#[test]
fn the_dipole_of_old_mitsuba_has_the_boundary_of_its_bsdf() {
    let made = |bsdf: &str| {
        let text = format!(
            "<shape type=\"sphere\">{bsdf}<subsurface type=\"dipole\"><string name=\"material\" value=\"Skimmilk\"/>
             <spectrum name=\"intIOR\" value=\"1.4\"/><integer name=\"irrSamples\" value=\"64\"/></subsurface></shape>"
        )
        .replace("<spectrum name=\"intIOR\"", "<float name=\"intIOR\"");
        let scene = Folder::new().load("scene.xml", &xml("0.6.0", &text)).unwrap();
        (under(&scene), scene)
    };
    let (rough, scene) = made("<bsdf type=\"roughplastic\"><float name=\"alpha\" value=\"0.2\"/></bsdf>");
    assert_eq!(rough.roughness, Some((Distribution::Beckmann, 0.2)));
    let odd = |scene: &Scene| scene.warnings.iter().filter(|w| w.contains("subsurface")).count();
    assert!((rough.eta - 1.4 / 1.000_277).abs() < 1e-5 && odd(&scene) == 0, "{:?}", scene.warnings);
    let (none, scene) = made("");
    assert_eq!(scene.constant(none.specular_reflectance), Some(Rgb::ZERO));
    let (_, scene) = made("<bsdf type=\"diffuse\"/>");
    assert_eq!(odd(&scene), 1);
}

#[test]
fn the_subsurface_of_pbrt() {
    let made = |inside: &str| {
        let text = format!("WorldBegin\nMaterial \"subsurface\" {inside}\nShape \"sphere\" \"float radius\" 1\n");
        Folder::new().load("scene.pbrt", &text)
    };
    let milk = under(&made("\"string name\" \"Wholemilk\" \"float scale\" 2 \"float roughness\" 0.25").unwrap());
    let (s, a) = (Rgb::new(2.55, 3.21, 3.77), Rgb::new(0.0011, 0.0024, 0.014));
    assert_eq!(value(&*milk.model), value(&Homogeneous::new(Diffusion::Dipole, s * 2.0, a * 2.0, 1.33).unwrap()));
    assert_eq!(milk.roughness, Some((Distribution::Ggx, 0.5)));
    let look = under(&made("\"rgb reflectance\" [ 0.5 0.4 0.3 ] \"rgb mfp\" [ 1 2 3 ] \"float eta\" 1.2").unwrap());
    assert!((look.model.total(&site(0.0)) - Rgb::new(0.5, 0.4, 0.3)).abs().max_element() < 1e-3 && look.eta == 1.2);
    assert!(made("\"string name\" \"Slime\"").unwrap_err().to_string().contains("not known"));
}

#[test]
fn what_is_measured_comes_from_the_loader() {
    let folder = Folder::new();
    let file = folder.write(
        "scene.xml",
        xml("3.0.0", "<shape type=\"sphere\"><bsdf type=\"subsurface\"><string name=\"filename\" value=\"m\"/><float name=\"scale\" value=\"1000\"/></bsdf></shape>"),
    );
    let loaded = |path: &Path| match path.ends_with("m") {
        true => Ok(Arc::new(Homogeneous::new(Diffusion::Dipole, Rgb::ONE, Rgb::ONE, 1.25).unwrap()) as Arc<dyn Bssrdf>),
        false => Err("which?".to_owned()),
    };
    let options = LoadOptions { bssrdf_loader: Some(loaded), ..LoadOptions::default() };
    let made = under(&load(&file, &options).unwrap());
    // This model does not say what index it was measured with.
    assert!(made.in_object_space && made.mm_per_unit == 1000.0 && made.eta == 1.3);
    let failing = LoadOptions { bssrdf_loader: Some(|_| Err("a broken model".into())), ..LoadOptions::default() };
    assert!(load(&file, &failing).unwrap_err().to_string().contains("a broken model"));
}

/// A white pixel, and one without red and alpha.
const TWO_PIXELS: &str =
    "iVBORw0KGgoAAAANSUhEUgAAAAIAAAABCAYAAAD0In+KAAAADklEQVR42mP4DwQMQAQAHuoF+84UYIkAAAAASUVORK5CYII=";

/// A triangle whose material has these extensions.
fn gltf(extensions: &str) -> translume_scene::Result<Scene> {
    let folder = Folder::new();
    let positions: Vec<u8> =
        [0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    folder.write("t.bin", positions);
    let text = format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}], "nodes": [{{"mesh": 0}}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}, "material": 0}}]}}],
        "materials": [{{"pbrMetallicRoughness": {{"baseColorFactor": [0.2, 0.4, 0.6, 1], "roughnessFactor": 0.5}},
            "extensions": {{"KHR_materials_ior": {{"ior": 1.4}}, {extensions}}}}}],
        "textures": [{{"source": 0}}], "images": [{{"uri": "data:image/png;base64,{TWO_PIXELS}"}}],
        "accessors": [{{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}}],
        "bufferViews": [{{"buffer": 0, "byteLength": 36}}], "buffers": [{{"uri": "t.bin", "byteLength": 36}}]}}"#
    );
    folder.load("scene.gltf", &text)
}

#[test]
fn volumes_of_gltf_that_light_enters_diffusely() {
    const VOLUME: &str = r#""KHR_materials_volume": {"thicknessFactor": 1, "attenuationDistance": 0.02, "attenuationColor": [0.9, 0.5, 0.3]}"#;
    let made = |more: &str| under(&gltf(&format!("{VOLUME}, {more}")).unwrap());
    let like = |found: &Subsurface, reflectance: Rgb, path: Rgb| {
        assert!((found.eta - 1.4).abs() < 1e-4 && found.roughness == Some((Distribution::Ggx, 0.25)), "{found:?}");
        let same = Homogeneous::from_reflectance(Diffusion::Dipole, reflectance, path, found.eta).unwrap();
        // A unit is far away: compare where light is.
        let at = |model: &dyn Bssrdf| model.eval(&site(0.0), &site(0.03));
        let (a, b) = (at(&*found.model), at(&same));
        assert!((a - b).abs().max_element() < 1e-4 * b.max_element(), "{a} {b}");
    };
    // Half of the surface is opaque, of the base colour; the other half has the colours of the transmission and of the volume.
    let diffuse = r#""KHR_materials_diffuse_transmission": {"diffuseTransmissionFactor": 0.5, "diffuseTransmissionColorFactor": [1, 0.8, 0.5]}"#;
    let expected = 0.5 * Rgb::new(0.2, 0.4, 0.6) + 0.5 * Rgb::new(0.9, 0.4, 0.15);
    like(&made(diffuse), expected, Rgb::splat(0.02));
    let scatter = r#""KHR_materials_volume_scatter": {"multiscatterColor": [0.8, 0.6, 0.4], "scatterAnisotropy": 0.5}"#;
    let path = Rgb::from([0.9f32, 0.5, 0.3].map(|c| 2.0 * 0.02 / -c.ln()));
    like(&made(scatter), Rgb::new(0.8, 0.6, 0.4), path);
    // No medium is made of the volume as well.
    assert!(gltf(&format!("{VOLUME}, {diffuse}")).unwrap().media.is_empty());
    // Of pictures the means: half of the red, and half of the amount.
    let texture = r#""diffuseTransmissionColorTexture": {"index": 0}, "diffuseTransmissionTexture": {"index": 0}"#;
    let textured = diffuse.replace("0.5, \"d", &format!("1, {texture}, \"d"));
    like(&made(&textured), 0.5 * Rgb::new(0.2, 0.4, 0.6) + 0.5 * Rgb::new(0.45, 0.4, 0.15), Rgb::splat(0.02));
    // Without a volume, or without any light through, it is the material that it would be anyway.
    for opaque in [diffuse.to_owned(), format!("{VOLUME}, {}", diffuse.replace("0.5, \"d", "0, \"d"))] {
        let scene = gltf(&opaque).unwrap();
        assert!(!matches!(scene.materials[scene.shapes[0].material.0].model, Model::Subsurface(_)), "{opaque}");
    }
}
