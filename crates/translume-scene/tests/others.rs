//! glTF and pbrt, damaged files of all formats, and the shared scenes.

mod common;

use common::{Folder, check, survives, xml};
use std::path::PathBuf;
use translume_bxdf::Rgb;
use translume_scene::emitter::{Emitter, Falloff};
use translume_scene::glam::DVec3;
use translume_scene::material::Model;
use translume_scene::sensor::{FovAxis, Projection};
use translume_scene::{Geometry, LoadOptions, Scene, load};

/// A triangle twice, a camera, lights, and materials with extensions. Positions are 36 bytes of floats in base64.
const GLTF: &str = r#"{
 "asset": {"version": "2.0"},
 "extensionsUsed": ["KHR_lights_punctual", "KHR_materials_emissive_strength", "KHR_materials_volume", "KHR_materials_transmission", "KHR_materials_ior", "KHR_materials_sheen"],
 "extensions": {"KHR_lights_punctual": {"lights": [
   {"type": "spot", "intensity": 5, "spot": {"outerConeAngle": 0.5}}, {"type": "directional", "color": [1, 0.5, 0.25]}]}},
 "scene": 0, "scenes": [{"nodes": [0, 1, 2, 3]}],
 "nodes": [
  {"mesh": 0, "name": "one"},
  {"mesh": 0, "translation": [5, 0, 0], "scale": [2, 2, 2]},
  {"camera": 0, "translation": [0, 0, 7], "extensions": {"KHR_lights_punctual": {"light": 0}}},
  {"extensions": {"KHR_lights_punctual": {"light": 1}}}],
 "cameras": [{"type": "perspective", "perspective": {"yfov": 0.8, "aspectRatio": 2.0, "znear": 0.1}}],
 "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}, {"attributes": {"POSITION": 0}, "material": 1}]}],
 "materials": [
  {"name": "glow", "emissiveFactor": [1, 0.5, 0], "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 8}}},
  {"name": "glass", "extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_ior": {"ior": 1.4},
    "KHR_materials_volume": {"thicknessFactor": 1, "attenuationDistance": 2, "attenuationColor": [0.5, 1, 1]}}}],
 "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
 "bufferViews": [{"buffer": 0, "byteLength": 36}],
 "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]
}"#;

const PBRT: &str = r#"
# comment with "a quote
Integrator "path" "integer maxdepth" [ 3 ]
LookAt 0 0 5  0 0 0  0 1 0
Camera "perspective" "float fov" 40
Film "rgb" "integer xresolution" 300 "integer yresolution" [ 100 ] "string filename" "x.exr"
Sampler "sobol" "integer pixelsamples" 8
WorldBegin
MakeNamedMedium "gas" "string type" "homogeneous" "rgb sigma_a" [ 1 1 1 ] "rgb sigma_s" [ 1 3 0 ]
MakeNamedMaterial "metal" "string type" "conductor" "float roughness" 0.25 "spectrum eta" "metal-Au-eta" "spectrum k" "metal-Au-k"
Texture "board" "spectrum" "checkerboard" "float uscale" 4 "rgb tex1" [ 1 0 0 ]
AttributeBegin
  AreaLightSource "diffuse" "rgb L" [ 3 2 1 ] "float scale" 2
  Translate 0 2 0
  Shape "trianglemesh" "point3 P" [ 0 0 0 1 0 0 0 1 0 ] "normal N" [ 0 0 -1 0 0 -1 0 0 -1 ] "integer indices" [ 0 1 2 ]
AttributeEnd
ObjectBegin "thing"
  NamedMaterial "metal"
  MediumInterface "gas" ""
  Shape "sphere" "float radius" 0.5
ObjectEnd
AttributeBegin
  Translate 1 2 3
  ObjectInstance "thing"
  Scale 2 2 2
  ObjectInstance "thing"
AttributeEnd
Material "diffuse" "texture reflectance" "board"
Shape "disk" "float height" 1 "float radius" 3
LightSource "spot" "rgb I" [ 1 1 1 ] "point3 from" [ 0 5 0 ] "point3 to" [ 0 0 0 ]
LightSource "infinite" "rgb L" [ .1 .1 .1 ]
"#;

#[test]
fn gltf() {
    let scene = Folder::new().load("scene.gltf", GLTF).unwrap();
    check(&scene);
    assert_eq!((scene.shapes.len(), scene.triangles()), (4, (1, 4)), "nodes and primitives share their meshes");
    assert_eq!(scene.constant(scene.shapes[0].radiance.unwrap()), Some(Rgb::new(8.0, 4.0, 0.0)));
    let Model::MetalRough(glass) = &scene.materials[scene.shapes[1].material.0].model else { panic!("not glTF's") };
    assert!(glass.solid == Some(1.4) && scene.constant(glass.transmission) == Some(Rgb::ONE));
    assert!((scene.constant(glass.f0).unwrap().x - (0.4_f32 / 2.4).powi(2)).abs() < 1e-6);
    let majorant = scene.media[scene.shapes[1].interior.unwrap().0].majorant();
    assert!((majorant - Rgb::new(0.5_f32.ln() / -2.0, 0.0, 0.0)).length() < 1e-6);
    let camera = &scene.sensors[0];
    assert_eq!(camera.world_from_camera.matrix3.z_axis, DVec3::NEG_Z);
    assert_eq!(camera.world_from_camera.matrix3.x_axis, DVec3::NEG_X, "left");
    assert_eq!(camera.film.size, [1280, 640]);
    let Projection::Perspective(p) = camera.projection else { panic!("no perspective") };
    assert_eq!((p.fov, p.fov_axis), (0.8, FovAxis::Y));
    let Emitter::Spot(spot) = &scene.emitters[0] else { panic!("no spot") };
    assert_eq!((spot.intensity, spot.falloff), (Rgb::splat(5.0), Falloff::SquareInCosine));
    assert!(matches!(scene.emitters[1], Emitter::Directional { direction: DVec3::NEG_Z, .. }));
    assert!(scene.warnings.iter().any(|w| w.contains("KHR_materials_sheen")), "{:?}", scene.warnings);
}

#[test]
fn gltf_that_cannot_be() {
    for (from, to, expected) in [
        ("\"mesh\": 0, \"name\"", "\"mesh\": 7, \"name\"", "no mesh 7"),
        ("\"nodes\": [0, 1, 2, 3]", "\"nodes\": [0, 0]", "reached twice"),
        ("\"material\": 1}", "\"material\": 9}", "no material 9"),
        ("\"count\": 3", "\"count\": 4000000000", "accessor 0"),
        ("\"scene\": 0", "\"extensionsRequired\": [\"KHR_materials_sheen\"], \"scene\": 0", "requires the extension"),
        ("\"light\": 0", "\"light\": 5", "light 5"),
        ("\"yfov\": 0.8", "\"yfov\": 4", "yfov"),
    ] {
        assert!(GLTF.contains(from), "{from}");
        let error = Folder::new().load("scene.gltf", &GLTF.replace(from, to)).unwrap_err().to_string();
        assert!(error.contains(expected) && error.contains("scene.gltf"), "{error}");
    }
}

#[test]
fn pbrt() {
    let scene = Folder::new().load("scene.pbrt", PBRT).unwrap();
    check(&scene);
    assert_eq!(scene.integrator.max_depth, Some(4));
    let camera = &scene.sensors[0];
    assert!((camera.world_from_camera.matrix3.z_axis - DVec3::NEG_Z).length() < 1e-12);
    assert_eq!((camera.film.size, camera.sample_count), ([300, 100], Some(8)));
    let Projection::Perspective(p) = camera.projection else { panic!("no perspective") };
    // 40° is the height here.
    let wide = 2.0 * (3.0 * 20_f32.to_radians().tan()).atan();
    assert!((p.fov_x(300, 100) - wide).abs() < 1e-5);
    let light = &scene.shapes[0];
    assert_eq!(scene.constant(light.radiance.unwrap()), Some(Rgb::new(6.0, 4.0, 2.0)));
    let Geometry::Mesh(mesh) = &light.geometry else { panic!("no mesh") };
    assert_eq!(mesh.indices, [[0, 2, 1]], "wound towards its normals");
    assert_eq!((scene.groups.len(), scene.instances.len()), (1, 2));
    let ball = &scene.groups[0].shapes[0];
    assert!(ball.interior.is_some() && ball.exterior.is_none());
    let Model::TwoSided { front, .. } = scene.materials[ball.material.0].model else { panic!("not two-sided") };
    let Model::RoughConductor { roughness, .. } = &scene.materials[front.0].model else { panic!("not a metal") };
    assert_eq!(scene.constant(roughness.alpha_u), Some(Rgb::splat(0.5)), "the square root of 0.25");
    let big = scene.instances[1].world_from_group;
    assert_eq!((big.translation, big.matrix3.x_axis.x), (DVec3::new(1.0, 2.0, 3.0), 2.0));
    assert_eq!(scene.emitters.len(), 2);
}

#[test]
fn pbrt_that_cannot_be() {
    for (from, to, expected) in [
        ("AttributeEnd\nMaterial", "Material", "truncated"),
        ("\"thing\"\n  Scale", "\"nothing\"\n  Scale", "no object \"nothing\""),
        ("\"float fov\" 40", "\"float fov\" [ 40", "wrong value"),
        ("Shape \"disk\"", "Shape \"curve\"", "scene.pbrt:29: shape \"curve\""),
        ("Shape \"disk\"", "Shape \"disk\" \"float radius\" 1e-300", "too small"),
        ("[ 0 1 2 ]", "[ 0 1 3 ]", "below 3"),
        ("Scale 2 2 2", "Scale 0 0 0", "degenerate"),
        ("WorldBegin", "Include \"scene.pbrt\" WorldBegin", "includes itself"),
        ("LookAt 0 0 5  0 0 0", "LookAt 0 0 5  0 0 5", "degenerate"),
        ("WorldBegin", "Wobble", "not a directive"),
        ("\"float fov\" 40", "\"float fov\" 1e39", "1e39 is no finite number"),
    ] {
        assert!(PBRT.contains(from), "{from}");
        let error = Folder::new().load("scene.pbrt", &PBRT.replace(from, to)).unwrap_err().to_string();
        assert!(error.contains(expected) && error.contains("scene.pbrt:"), "{error}");
    }
}

#[test]
fn damaged_files_are_errors_or_scenes() {
    let folder = Folder::new();
    folder.write("t.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    let inside = r##"<default name="d" value="4"/><integrator type="path"><integer name="max_depth" value="$d"/></integrator>
        <sensor type="thinlens"><float name="fov" value="40"/><float name="aperture_radius" value="0.1"/>
          <transform name="to_world"><lookat origin="1,2,3" target="0,0,0" up="0,1,0"/></transform>
          <film type="hdrfilm"><integer name="width" value="64"/><integer name="crop_width" value="10"/><rfilter type="mitchell"/></film></sensor>
        <medium type="homogeneous" id="fog"><rgb name="sigma_t" value="1 2 3"/><phase type="hg"><float name="g" value="0.3"/></phase></medium>
        <bsdf type="twosided" id="m"><bsdf type="blendbsdf"><texture name="weight" type="checkerboard"/><bsdf type="diffuse"/><bsdf type="plastic"/></bsdf></bsdf>
        <shape type="shapegroup" id="g"><shape type="obj"><string name="filename" value="t.obj"/><ref id="m"/></shape></shape>
        <shape type="instance"><ref id="g"/><transform name="to_world"><scale value="2"/><matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/></transform></shape>
        <shape type="cylinder"><point name="p1" x="0" y="1" z="1"/><ref name="interior" id="fog"/><bsdf type="null"/></shape>
        <shape type="sphere"><emitter type="area"><spectrum name="radiance" value="400:1, 500:2, 700:3"/></emitter></shape>
        <emitter type="spot"><rgb name="intensity" value="#ffcc00"/></emitter>"##;
    survives("scene.xml", xml("3.0.0", inside).as_bytes(), 1000, &folder);
    survives("scene.gltf", GLTF.as_bytes(), 1000, &folder);
    // With poses, and materials of many textures and sets.
    let png = "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mP8z8BQDwAEhQGAhKmMIQAAAABJRU5ErkJggg==";
    let texture =
        r#"{"index": 0, "texCoord": 1, "extensions": {"KHR_texture_transform": {"rotation": 1, "texCoord": 0}}}"#;
    let rich = GLTF
        .replace(
            r#"{"attributes": {"POSITION": 0}, "material": 0}"#,
            r#"{"attributes": {"POSITION": 0, "NORMAL": 0, "TANGENT": 1, "COLOR_0": 1, "TEXCOORD_0": 2, "TEXCOORD_1": 2,
                "JOINTS_0": 1, "WEIGHTS_0": 1}, "targets": [{"POSITION": 0, "COLOR_0": 0}], "material": 0}"#,
        )
        .replace(r#""mesh": 0, "name": "one""#, r#""mesh": 0, "name": "one", "skin": 0, "weights": [0.5]"#)
        .replace(
            r#""accessors": ["#,
            &format!(
                r#""skins": [{{"joints": [0, 1]}}], "textures": [{{"source": 0}}], "images": [{{"uri": "{png}"}}], "accessors": [
                {{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}},
                {{"componentType": 5126, "count": 3, "type": "VEC4"}}, {{"componentType": 5126, "count": 3, "type": "VEC2"}},"#
            ),
        )
        .replace(
            r#""emissiveFactor""#,
            &format!(
                r#""alphaMode": "MASK", "doubleSided": true, "normalTexture": {texture}, "emissiveTexture": {texture},
                "pbrMetallicRoughness": {{"baseColorTexture": {texture}}}, "emissiveFactor""#
            ),
        )
        .replace(
            r#""KHR_materials_emissive_strength": {"emissive"#,
            &format!(
                r#""KHR_materials_clearcoat": {{"clearcoatFactor": 1, "clearcoatNormalTexture": {texture}}},
                "KHR_materials_specular": {{"specularTexture": {texture}, "specularColorTexture": {texture}}},
                "KHR_materials_emissive_strength": {{"emissive"#
            ),
        );
    check(&Folder::new().load("scene.gltf", &rich).unwrap());
    survives("scene.gltf", rich.as_bytes(), 1000, &folder);
    survives("scene.pbrt", PBRT.as_bytes(), 1000, &folder);
}

/// A scene of the shared data, `None` (told) where there is none.
fn shared(name: &str) -> Option<Scene> {
    let Some(data) = std::env::var_os("TRANSLUME_DATA") else {
        eprintln!("skipped: TRANSLUME_DATA is not set");
        return None;
    };
    let scene = load(&PathBuf::from(data).join("scenes").join(name), &LoadOptions::default());
    let scene = scene.unwrap_or_else(|e| panic!("{e}"));
    check(&scene);
    Some(scene)
}

/// Triangles, lights and boxes as Mitsuba 3.9 has them.
#[test]
fn shared_mitsuba_scenes() {
    for (name, triangles, lights, lo, hi) in [
        ("cornell-box/mitsuba/scene_v3.xml", 36, 1, [-1.0, 0.0, -1.0], [1.0, 2.0, 1.0]),
        ("modern-hall/scene.xml", 30_927, 13, [-21.71956, -3.68796, -3.08069], [7.16257, 11.38502, 6.95097]),
        ("living-room/scene.xml", 143_163, 1, [-0.51343, -0.00306, -3.63538], [5.12268, 2.87914, 0.59284]),
        ("matpreview/matpreview.xml", 61_600, 1, [-7.19786, -5.46007, -0.01207], [5.14732, 7.94973, 6.84708]),
        ("sponza-dabrovic/sponza.xml", 66_445, 1, [-17.40276, -0.90669, -7.79851], [17.41724, 17.1, 7.80149]),
        (
            "light-instances-luxcore/scene-mitsuba-translation.xml",
            17_860_024,
            4501,
            [-9.9, -28.71, -0.99758],
            [13.19741, 28.71, 11.05522],
        ),
    ] {
        let Some(scene) = shared(name) else { return };
        assert_eq!(scene.triangles().1, triangles, "{name}");
        let area = scene.shapes.iter().filter(|s| s.radiance.is_some()).count();
        assert_eq!(area + scene.emitters.len(), lights, "{name}");
        let bounds = scene.bounds();
        for (found, expected) in [(bounds.lo, lo), (bounds.hi, hi)] {
            assert!((found - Rgb::from(expected)).abs().max_element() < 2e-5, "{name}: {found} for {expected:?}");
        }
        assert!(scene.heap_bytes() < 200_000_000, "{name}");
    }
}

#[test]
fn shared_media_and_pbrt_scenes() {
    for name in ["hetvol", "hetvol_colored", "vol_cbox", "vol_cbox_teapot", "volpath_test4", "volpath_test6"] {
        let Some(scene) = shared(&format!("volume-smoke-media/{name}.xml")) else { return };
        assert!(!scene.media.is_empty() && scene.sensors.len() == 1, "{name}");
    }
    for (name, triangles, lights) in [
        ("veach-mis/scene-v4.pbrt", 52, 3),
        ("veach-bidir/scene-v4.pbrt", 11_544, 2),
        ("volumetric-caustic/scene-v4.pbrt", 14, 1),
        ("cornell-box/pbrt/scene-v4.pbrt", 36, 1),
    ] {
        let Some(scene) = shared(name) else { return };
        assert_eq!(scene.triangles().1, triangles, "{name}");
        assert_eq!(scene.shapes.iter().filter(|s| s.radiance.is_some()).count(), lights, "{name}");
    }
}

/// The Cornell box stands in two formats: camera, light and boxes are the same.
#[test]
fn formats_agree() {
    let Some(a) = shared("cornell-box/mitsuba/scene_v3.xml") else { return };
    let Some(b) = shared("cornell-box/pbrt/scene-v4.pbrt") else { return };
    let [m, n] = [&a, &b].map(|s| s.sensors[0].world_from_camera);
    assert!(m.abs_diff_eq(n, 1e-9), "{m} {n}");
    let [l, r] = [&a, &b].map(|s| s.shapes.iter().find(|s| s.radiance.is_some()).expect("a light"));
    assert_eq!(a.constant(l.radiance.unwrap()), b.constant(r.radiance.unwrap()));
    assert!((l.bounds().hi - r.bounds().hi).length() < 1e-5);
    assert!((a.bounds().lo - b.bounds().lo).length() < 1e-5);
}

/// Many primitives and nodes of one list of vertices are one mesh; of a long list that each uses little of, parts.
#[test]
fn vertices_of_gltf_are_read_once() {
    let primitive = r#"{"attributes": {"POSITION": 0}, "material": 0}"#;
    let text = GLTF.replace(primitive, &[primitive; 40].join(", "));
    let scene = Folder::new().load("scene.gltf", &text).unwrap();
    check(&scene);
    assert_eq!((scene.shapes.len(), scene.triangles()), (82, (1, 82)));
    let long = GLTF
        .replace(
            "{\"bufferView\": 0, \"componentType\": 5126, \"count\": 3",
            "{\"componentType\": 5126, \"count\": 90000",
        )
        .replace("{\"POSITION\": 0}, \"material\": 0}", "{\"POSITION\": 0}, \"indices\": 1, \"material\": 0}")
        .replace(
            "\"type\": \"VEC3\"}]",
            "\"type\": \"VEC3\"}, {\"componentType\": 5123, \"count\": 6, \"type\": \"SCALAR\"}]",
        );
    let scene = Folder::new().load("scene.gltf", &long).unwrap();
    let Geometry::Mesh(mesh) = &scene.shapes[0].geometry else { panic!() };
    assert_eq!((mesh.positions.len(), mesh.indices.len()), (1, 2));
}

/// A file that poses its vertices over and over is refused before they fill the memory.
#[test]
fn poses_of_gltf_have_a_bound() {
    let nodes: Vec<String> = (0..9).map(|i| format!("{{\"mesh\": 0, \"weights\": [{i}]}}")).collect();
    let text = GLTF
        .replace("\"nodes\": [0, 1, 2, 3]", "\"nodes\": [0, 1, 2, 3, 4, 5, 6, 7, 8]")
        .replace("{\"POSITION\": 0}", "{\"POSITION\": 0}, \"targets\": [{\"POSITION\": 0}]")
        .replace("{\"mesh\": 0, \"name\": \"one\"},", &format!("{},", nodes.join(", ")))
        .replace(
            "{\"bufferView\": 0, \"componentType\": 5126, \"count\": 3",
            "{\"componentType\": 5126, \"count\": 12000000",
        );
    let error = Folder::new().load("scene.gltf", &text).unwrap_err().to_string();
    assert!(error.contains("vertices and triangles together"), "{error}");
}
