//! glTF through the binary: the method, the view and the files that are allowed.

mod common;

use common::translume;
use serde_json::Value;
use std::path::Path;

/// A cube that absorbs before a wall that glows, seen through it; `VOLUME` and `CAMERA` stand for changes.
fn cube(volume: &str, camera: &str) -> String {
    let corner = |i: usize| [i & 1, i >> 1 & 1, i >> 2].map(|b| b as f32 - 0.5);
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let wall = [[-9.0, -9.0, -3.0], [9.0, -9.0, -3.0], [9.0, 9.0, -3.0], [-9.0, 9.0, -3.0_f32]];
    let mut bytes: Vec<u8> = (0..8).map(corner).chain(wall).flatten().flat_map(f32::to_le_bytes).collect();
    let split = |q: &[u8; 4]| [q[0], q[1], q[2], q[0], q[2], q[3]];
    bytes.extend(faces.iter().flat_map(split).chain([0, 1, 2, 0, 2, 3]));
    let data: String = bytes.iter().map(|b| format!("%{b:02x}")).collect();
    format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [{camera} 0, 1]}}],
        "nodes": [{{"mesh": 0}}, {{"mesh": 1}}, {{"camera": 0, "translation": [0, 0, 3]}}],
        "cameras": [{{"type": "perspective", "perspective": {{"yfov": 0.1, "aspectRatio": 1, "znear": 0.1}}}}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}, "indices": 2, "material": 0}}]}},
                   {{"primitives": [{{"attributes": {{"POSITION": 1}}, "indices": 3, "material": 1}}]}}],
        "materials": [
          {{"extensions": {{"KHR_materials_transmission": {{"transmissionFactor": 1}}, "KHR_materials_ior": {{"ior": 1}}{volume}}},
            "pbrMetallicRoughness": {{"metallicFactor": 0, "roughnessFactor": 0}}}},
          {{"emissiveFactor": [1, 1, 1], "pbrMetallicRoughness": {{"baseColorFactor": [0, 0, 0, 1]}}}}],
        "accessors": [
          {{"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"}},
          {{"bufferView": 0, "byteOffset": 96, "componentType": 5126, "count": 4, "type": "VEC3"}},
          {{"bufferView": 1, "componentType": 5121, "count": 36, "type": "SCALAR"}},
          {{"bufferView": 1, "byteOffset": 36, "componentType": 5121, "count": 6, "type": "SCALAR"}}],
        "bufferViews": [{{"buffer": 0, "byteLength": 144}}, {{"buffer": 0, "byteOffset": 144, "byteLength": 42}}],
        "buffers": [{{"byteLength": 186, "uri": "data:application/octet-stream,{data}"}}]}}"#
    )
}

const VOLUME: &str =
    r#", "KHR_materials_volume": {"thicknessFactor": 1, "attenuationDistance": 1, "attenuationColor": [1, 0.1, 0.5]}"#;

fn render(dir: &Path, more: &[&str]) -> (Value, [f32; 3]) {
    let line = ["render", "scene.gltf", "-o", "out.exr", "--spp", "64", "--size", "8x8", "--json"];
    let json = serde_json::from_str(&translume(dir, &[&line[..], more].concat()).ok()).unwrap();
    let pixels = translume_image::read_picture(&dir.join("out.exr")).unwrap().pixels.into_raw();
    (json, [0, 1, 2].map(|c| pixels.iter().skip(c).step_by(3).sum::<f32>() / 64.0))
}

#[test]
fn a_file_with_volumes_and_no_method_is_rendered_by_one_that_sees_them() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("scene.gltf"), cube(VOLUME, "2,")).unwrap();
    let (json, rgb) = render(dir.path(), &[]);
    assert_eq!(json["integrator"], "volpath");
    assert!(rgb.iter().zip([1.0, 0.1, 0.5]).all(|(g, e)| (g - e).abs() < 0.02), "{rgb:?}");
    std::fs::write(dir.path().join("scene.gltf"), cube("", "2,")).unwrap();
    let (json, rgb) = render(dir.path(), &[]);
    assert_eq!(json["integrator"], "path");
    assert!(rgb.iter().all(|v| (v - 1.0).abs() < 0.1), "{rgb:?}");
}

#[test]
fn a_file_without_a_camera_is_seen_whole_and_that_is_said() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("scene.gltf"), cube(VOLUME, "")).unwrap();
    let run = translume(dir.path(), &["render", "scene.gltf", "-o", "out.exr", "--spp", "4", "--size", "32x16"]);
    assert!(run.stderr.contains("no camera"), "{}", run.stderr);
    run.ok();
    let info = translume(dir.path(), &["scene", "info", "scene.gltf", "--json"]);
    assert!(info.stderr.contains("no camera"), "{}", info.stderr);
    let json: Value = serde_json::from_str(&info.ok()).unwrap();
    assert_eq!(json["sensors"].as_array().unwrap().len(), 1);
    std::fs::write(dir.path().join("scene.gltf"), cube(VOLUME, "2,")).unwrap();
    assert_eq!(translume(dir.path(), &["scene", "info", "scene.gltf"]).stderr, "");
}

#[test]
fn files_of_another_folder_want_an_option() {
    let dir = tempfile::tempdir().unwrap();
    let [model, textures] = ["model", "textures"].map(|name| dir.path().join(name));
    [&model, &textures].into_iter().for_each(|d| std::fs::create_dir(d).unwrap());
    image::RgbImage::from_pixel(1, 1, image::Rgb([0, 255, 0])).save(textures.join("a.png")).unwrap();
    let text =
        cube(VOLUME, "2,").replace(r#""emissiveFactor""#, r#""emissiveTexture": {"index": 0}, "emissiveFactor""#);
    let text = text.replace(
        r#""accessors""#,
        r#""textures": [{"source": 0}], "images": [{"uri": "../textures/a.png"}], "accessors""#,
    );
    std::fs::write(model.join("scene.gltf"), text).unwrap();
    for verb in [&["render", "scene.gltf", "-o", "out.exr"][..], &["scene", "info", "scene.gltf"]] {
        let error = translume(&model, verb).error(1);
        assert!(error.contains("outside of its folder") && error.contains("--asset-root"), "{error}");
    }
    let (_, rgb) = render(&model, &["--asset-root", "../textures"]);
    assert!(rgb[1] > 0.05 && rgb[0] == 0.0 && rgb[2] == 0.0, "{rgb:?}");
    translume(&model, &["scene", "info", "scene.gltf", "--asset-root", "../textures"]).ok();
    let error = translume(&model, &["scene", "info", "scene.gltf", "--asset-root", "../gone"]).error(2);
    assert!(error.contains("../gone") && error.contains("no such folder"), "{error}");
}
