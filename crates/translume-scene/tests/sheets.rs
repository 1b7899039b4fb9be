//! Sheets that transmit diffusely in the words of each format.

mod common;

use common::{Folder, check, mitsuba, mitsuba_error, survives, xml};
use translume_bxdf::Rgb;
use translume_scene::material::{Model, ThinPrincipled};
use translume_scene::texture::{Channel, Texture};
use translume_scene::{Scene, TextureId};

fn model(scene: &Scene) -> &Model {
    check(scene);
    &scene.materials[scene.shapes[0].material.0].model
}

fn thin(scene: &Scene) -> ThinPrincipled {
    match model(scene) {
        Model::ThinPrincipled(p) => **p,
        other => panic!("{other:?}"),
    }
}

#[track_caller]
fn constant(scene: &Scene, id: TextureId, expected: [f32; 3]) {
    assert_eq!(scene.constant(id), Some(Rgb::from(expected)));
}

#[track_caller]
fn bitmap(scene: &Scene, id: TextureId, channel: Channel, scale: [f32; 3]) {
    let Texture::Bitmap(b) = &scene.textures[id.0] else { panic!("{:?}", scene.textures[id.0]) };
    assert_eq!((b.channel, b.scale), (channel, Rgb::from(scale)));
}

const LEAF: &str = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
    "materials": [{"name": "leaf", "doubleSided": true,
        "pbrMetallicRoughness": {"baseColorFactor": [0.2, 0.4, 0.6, 1], "metallicFactor": 0.25, "roughnessFactor": 0.5},
        "extensions": {"KHR_materials_diffuse_transmission": {"diffuseTransmissionFactor": 0.75,
            "diffuseTransmissionColorFactor": [1, 0.5, 0.25]}, "more": 0}}],
    "textures": [{"source": 0}],
    "images": [{"uri": "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mP8z8BQDwAEhQGAhKmMIQAAAABJRU5ErkJggg=="}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]}"#;

fn gltf(changes: &[(&str, &str)]) -> Scene {
    let mut text = LEAF.to_owned();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    Folder::new().load("leaf.gltf", &text).unwrap()
}

#[test]
fn leaves_of_gltf() {
    for sides in ["true", "false"] {
        let scene = gltf(&[("\"doubleSided\": true", &format!("\"doubleSided\": {sides}"))]);
        let leaf = thin(&scene);
        constant(&scene, leaf.base_color, [0.2, 0.4, 0.6]);
        constant(&scene, leaf.transmission_color, [1.0, 0.5, 0.25]);
        constant(&scene, leaf.diff_trans, [0.75; 3]);
        constant(&scene, leaf.roughness, [0.5; 3]);
        constant(&scene, leaf.metallic, [0.25; 3]);
        assert!((leaf.eta - 1.5).abs() < 1e-4 && scene.warnings.iter().all(|w| !w.contains("\"leaf\"")));
    }
    // Both textures: the amount is in the alpha of one, the colour in the other.
    let textures = (
        "\"diffuseTransmissionFactor\"",
        r#""diffuseTransmissionTexture": {"index": 0}, "diffuseTransmissionColorTexture": {"index": 0}, "diffuseTransmissionFactor""#,
    );
    let scene = gltf(&[textures]);
    bitmap(&scene, thin(&scene).diff_trans, Channel::Alpha, [0.75; 3]);
    bitmap(&scene, thin(&scene).transmission_color, Channel::Rgb, [1.0, 0.5, 0.25]);
    // A volume that does not attenuate: its boundary is a sheet. One of no thickness is none.
    for volume in [r#"{"thicknessFactor": 1}"#, r#"{"thicknessFactor": 0, "attenuationDistance": 2}"#] {
        let scene = gltf(&[("\"more\": 0", &format!("\"KHR_materials_volume\": {volume}"))]);
        constant(&scene, thin(&scene).diff_trans, [0.75; 3]);
    }
}

#[test]
fn what_no_sheet_is_made_of_in_gltf() {
    // Nothing comes through: the material that it would be anyway.
    let scene = gltf(&[("\"diffuseTransmissionFactor\": 0.75", "\"diffuseTransmissionFactor\": 0")]);
    assert!(matches!(model(&scene), Model::MetalRough(_)));
    // Clear transmission lies over the diffuse one.
    let clear = ("\"more\": 0", r#""KHR_materials_transmission": {"transmissionFactor": 0.5}"#);
    let scene = gltf(&[clear]);
    let Model::Blend { weight, first, second } = *model(&scene) else { panic!("{:?}", model(&scene)) };
    constant(&scene, weight, [0.5; 3]);
    assert!(matches!(scene.materials[first.0].model, Model::ThinPrincipled(_)));
    let Model::MetalRough(over) = &scene.materials[second.0].model else { panic!() };
    constant(&scene, over.transmission, [1.0; 3]);
    constant(&scene, over.roughness, [0.5; 3]);
    let solid = (
        clear.0,
        r#""KHR_materials_volume": {"thicknessFactor": 1}, "KHR_materials_transmission": {"transmissionFactor": 0.5}"#,
    );
    let scene = gltf(&[solid]);
    assert!(matches!(model(&scene), Model::MetalRough(m) if m.solid.is_some()));
    for (extension, told) in [
        (r#""KHR_materials_clearcoat": {"clearcoatFactor": 1}"#, "clear coat is not used"),
        (r#""KHR_materials_pbrSpecularGlossiness": {}"#, "specular glossiness"),
    ] {
        let scene = gltf(&[("\"more\": 0", extension)]);
        assert!(scene.warnings.iter().any(|w| w.contains("\"leaf\"") && w.contains(told)), "{:?}", scene.warnings);
    }
}

#[test]
fn damaged_leaves_are_errors_or_scenes() {
    survives("leaf.gltf", LEAF.as_bytes(), 1000, &Folder::new());
}

#[test]
fn transmitters_of_mitsuba() {
    let old = |inside: &str| {
        let text = format!("<shape type=\"rectangle\"><bsdf type=\"difftrans\">{inside}</bsdf></shape>");
        Folder::new().load("scene.xml", &xml("0.6.0", &text)).unwrap()
    };
    for (inside, expected) in [("", 0.5), ("<spectrum name=\"transmittance\" value=\"0.75\"/>", 0.75)] {
        let scene = old(inside);
        let Model::DiffuseTransmission { reflectance, transmittance } = *model(&scene) else { panic!() };
        constant(&scene, reflectance, [0.0; 3]);
        constant(&scene, transmittance, [expected; 3]);
    }
    let new = |inside: &str| format!("<shape type=\"rectangle\"><bsdf type=\"principledthin\">{inside}</bsdf></shape>");
    // At 2 all of the light goes through.
    let color = "<rgb name=\"base_color\" value=\"0.2 0.4 0.6\"/><float name=\"diff_trans\" value=\"1.5\"/>";
    let scene = mitsuba(&new(&format!("{color}<float name=\"roughness\" value=\"0.3\"/>")));
    let sheet = thin(&scene);
    constant(&scene, sheet.base_color, [0.2, 0.4, 0.6]);
    constant(&scene, sheet.diff_trans, [0.75; 3]);
    assert!(sheet.transmission_color == sheet.base_color && sheet.eta == 1.0);
    assert!(scene.warnings.iter().all(|w| !w.contains("principledthin")), "{:?}", scene.warnings);
    let scene = mitsuba(&new("<float name=\"spec_trans\" value=\"0.25\"/><float name=\"sheen\" value=\"1\"/>"));
    let Model::Blend { weight, second, .. } = *model(&scene) else { panic!() };
    constant(&scene, weight, [0.25; 3]);
    assert!(matches!(scene.materials[second.0].model, Model::ThinDielectric(_)));
    assert!(scene.warnings.iter().any(|w| w.contains("without its roughness, sheen")), "{:?}", scene.warnings);
    let error = mitsuba_error(&new("<float name=\"eta\" value=\"0.9\"/>"));
    assert!(error.contains("not above 1"), "{error}");
}

#[test]
fn diffuse_transmission_of_pbrt() {
    let load = |parameters: &str| {
        let text = format!(
            "WorldBegin\nTexture \"board\" \"spectrum\" \"checkerboard\" \"rgb tex1\" [ 1 0.5 0 ]\n\
             Material \"diffusetransmission\" {parameters}\nShape \"disk\""
        );
        Folder::new().load("scene.pbrt", &text).unwrap()
    };
    let sheet = |scene: &Scene| match *model(scene) {
        Model::DiffuseTransmission { reflectance, transmittance } => (reflectance, transmittance),
        ref other => panic!("{other:?}"),
    };
    let scene = load("");
    let (r, t) = sheet(&scene);
    constant(&scene, r, [0.25; 3]);
    constant(&scene, t, [0.25; 3]);
    let scene = load("\"rgb reflectance\" [ 0.2 0.4 0.6 ] \"texture transmittance\" \"board\" \"float scale\" 0.5");
    let (r, t) = sheet(&scene);
    constant(&scene, r, [0.1, 0.2, 0.3]);
    let Texture::Checkerboard(board) = &scene.textures[t.0] else { panic!() };
    constant(&scene, board.color0, [0.5, 0.25, 0.0]);
    assert!(scene.warnings.iter().all(|w| !w.contains("diffusetransmission")), "{:?}", scene.warnings);
}
