//! glTF draws what it says: pictures of small files whose values the specification and its extensions give.

#[path = "common/gltf.rs"]
mod file;

use file::{File, PI, glow, matte, picture};
use serde_json::{Value, json};

const WHITE: [f32; 4] = [1.0; 4];

fn white() -> Value {
    matte(WHITE, json!({}))
}

/// §3.9.2: the factor, the texture and COLOR_0 multiply.
#[test]
fn colours_multiply() {
    let mut f = File::new();
    f.sun(0.0);
    let texture = f.texture((1, 1), &[[255, 0, 255, 255]]);
    let material = f.material(matte(
        [0.5, 0.5, 0.5, 1.0],
        json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": texture}}}),
    ));
    let plain = f.primitive(material);
    let mut colored = plain.clone();
    colored["attributes"]["COLOR_0"] = f.all([0.5, 1.0, 0.25]).into();
    f.placed(plain, json!({}));
    f.shows([0.5, 0.0, 0.5], 1e-3);
    f.json["meshes"][0]["primitives"][0] = colored;
    f.shows([0.25, 0.0, 0.125], 1e-3);
    // Bytes count as 255ths.
    let bytes = f.bytes("VEC4", &[51, 255, 102, 255].repeat(4), true);
    f.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = bytes.into();
    f.shows([0.1, 0.0, 0.2], 1e-3);
}

/// §3.9.4: alpha of the vertices counts as well; a mask is there from the cutoff on.
#[test]
fn alpha_of_vertices() {
    for (mode, factor, alpha, share) in [
        ("OPAQUE", 1.0, 0.25, 1.0),
        ("BLEND", 1.0, 0.25, 0.25),
        ("BLEND", 0.5, 0.5, 0.25),
        ("MASK", 1.0, 0.49, 0.0),
        ("MASK", 0.9, 0.6, 1.0),
        ("MASK", 0.8, 0.6, 0.0),
    ] {
        let mut f = File::new();
        f.sun(0.0);
        let material = f.material(matte([1.0, 1.0, 1.0, factor], json!({"alphaMode": mode})));
        let mut primitive = f.primitive(material);
        primitive["attributes"]["COLOR_0"] = f.all([1.0, 0.0, 0.0, alpha]).into();
        f.placed(primitive, json!({}));
        // Behind it the sun's light is gone: a glow is seen.
        f.square(glow([0.0, 0.0, 0.5]), json!({"translation": [0, 0, -1]}));
        let got = f.rendered("path", 1024);
        let expected = [share, 0.0, 0.5 * (1.0 - share)];
        assert!(
            (0..3).all(|c| (got[c] - expected[c]).abs() < 0.02),
            "{mode} {factor} {alpha}: {got:?} for {expected:?}"
        );
    }
}

/// A cutoff is applied to the value between the texels, not to them (§3.9.4).
#[test]
fn a_cutoff_is_where_the_alpha_between_texels_crosses_it() {
    let mut f = File::new();
    f.json["samplers"] = json!([{"magFilter": 9729, "wrapS": 33071, "wrapT": 33071}]);
    // From 0 to 1 over the middle half of the square: 0.9 is at x = 0.4, where the glow behind is seen up to.
    let texture = f.texture((2, 1), &[[255, 255, 255, 0], [255, 255, 255, 255]]);
    let textured = json!({"baseColorTexture": {"index": texture}});
    let masked = json!({"alphaMode": "MASK", "alphaCutoff": 0.9, "pbrMetallicRoughness": textured});
    f.square(matte(WHITE, masked), json!({}));
    f.square(glow([1.0; 3]), json!({"translation": [0, 0, -1], "scale": [3, 3, 1]}));
    for (x, expected) in [(0.3, 1.0), (0.5, 0.0)] {
        f.json["nodes"][0]["translation"] = json!([x, 0, 3]);
        f.shows([expected; 3], 1e-3);
    }
}

/// §3.7.2.1: each texture has its own set; KHR_texture_transform's wins.
#[test]
fn sets_of_texture_coordinates() {
    let mut f = File::new();
    let three = f.texture((3, 1), &[[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255]]);
    let at = |set: usize| json!({"index": three, "texCoord": set});
    let material = f.material(matte(
        [0.0, 0.0, 0.0, 1.0],
        json!({"emissiveFactor": [1, 1, 1], "emissiveTexture": at(0), "doubleSided": false}),
    ));
    let mut primitive = f.primitive(material);
    for (set, u) in [0.2, 0.5, 0.8].into_iter().enumerate() {
        primitive["attributes"][format!("TEXCOORD_{set}")] = f.all([u, 0.5]).into();
    }
    f.placed(primitive, json!({}));
    f.sun(0.0);
    for (set, expected) in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].into_iter().enumerate() {
        f.json["materials"][0]["emissiveTexture"] = at(set);
        f.shows(expected, 1e-3);
        let transform =
            json!({"index": three, "texCoord": 0, "extensions": {"KHR_texture_transform": {"texCoord": set}}});
        f.json["materials"][0]["emissiveTexture"] = transform;
        f.shows(expected, 1e-3);
        // As the base colour, too.
        f.json["materials"][0] = matte(WHITE, json!({"pbrMetallicRoughness": {"baseColorTexture": at(set)}}));
        f.shows(expected, 1e-3);
        f.json["materials"][0] = matte([0.0, 0.0, 0.0, 1.0], json!({"emissiveFactor": [1, 1, 1]}));
    }
    // What is not there is said.
    f.json["materials"][0]["emissiveTexture"] = at(3);
    let warnings = f.scene().warnings;
    assert!(warnings.len() == 1 && warnings[0].contains("TEXCOORD_3"), "{warnings:?}");
}

/// Codes of the normal that is tilted by 45° to the right, or to the top of the picture.
const RIGHT: [u8; 4] = [218, 128, 218, 255];
const UP: [u8; 4] = [128, 218, 218, 255];

/// A square with such a normal map, and the sun from 45° above: its light meets the tilted normal head on.
fn tilted(normal: [u8; 4]) -> File {
    let mut f = File::new();
    f.sun(45.0);
    let texture = f.texture((1, 1), &[normal]);
    f.square(matte(WHITE, json!({"normalTexture": {"index": texture}})), json!({}));
    f
}

/// §3.7.2.1: the bitangent is the normal cross the tangent, times its w; without tangents both follow the picture.
#[test]
fn normal_maps_follow_the_picture() {
    let mirrored = |f: &mut File| {
        let uvs = f.floats("VEC2", &[1.0, 1.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0]);
        f.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = uvs.into();
    };
    tilted(UP).shows([1.0; 3], 0.01);
    let mut f = tilted(UP);
    mirrored(&mut f);
    f.shows([1.0; 3], 0.01);
    // A node that mirrors takes the picture along.
    for scale in [[-1.0, 1.0, 1.0], [-2.0, 3.0, 1.0]] {
        let mut f = tilted(UP);
        f.json["nodes"][2]["scale"] = json!(scale);
        f.shows([1.0; 3], 0.01);
        let tangents = f.all([1.0, 0.0, 0.0, 1.0]);
        f.json["meshes"][0]["primitives"][0]["attributes"]["TANGENT"] = tangents.into();
        f.shows([1.0; 3], 0.01);
    }
    // Upside down the tilt is away from the sun.
    let mut f = tilted(UP);
    f.json["nodes"][2]["scale"] = json!([1.0, -1.0, 1.0]);
    f.shows([0.0; 3], 0.01);
    // Scale 0 makes it flat again.
    let mut f = tilted(UP);
    f.json["materials"][0]["normalTexture"]["scale"] = json!(0.0);
    f.shows([0.5_f32.sqrt(); 3], 0.01);
}

#[test]
fn tangents_of_the_file_are_used() {
    for (tangent, normal, expected) in [
        ([0.0, 1.0, 0.0, 1.0], RIGHT, 1.0),
        ([0.0, -1.0, 0.0, 1.0], RIGHT, 0.0),
        ([1.0, 0.0, 0.0, 1.0], UP, 1.0),
        ([1.0, 0.0, 0.0, -1.0], UP, 0.0),
    ] {
        let mut f = tilted(normal);
        let accessor = f.all(tangent);
        f.json["meshes"][0]["primitives"][0]["attributes"]["TANGENT"] = accessor.into();
        f.shows([expected; 3], 0.01);
        // Without normals they do not count: the picture's own axes do.
        f.json["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap().remove("NORMAL");
        f.shows([if normal == UP { 1.0 } else { 0.5 }; 3], 0.01);
    }
}

/// A normal map is along the set of coordinates that it is looked up by, as its transform turns them.
#[test]
fn normal_maps_are_along_their_own_coordinates() {
    let mut f = tilted(RIGHT);
    // In the second set the picture stands on its side: its right is up.
    let uvs = f.floats("VEC2", &[0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0]);
    f.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"] = uvs.into();
    f.shows([0.5; 3], 0.01);
    f.json["materials"][0]["normalTexture"]["texCoord"] = json!(1);
    f.shows([1.0; 3], 0.01);
}

/// §3.7.2.2: weights of the mesh, else those of the node.
#[test]
fn morph_targets() {
    let mut f = File::new();
    f.sun(0.0);
    let material = f.material(white());
    let mut primitive = f.primitive(material);
    let aside = f.all([5.0, 0.0, 0.0]);
    // One row of the second target differs from zero, and it has no bytes for the others; the third is of bytes.
    let (at, by) = (f.raw_view(&[1]), f.raw_view(&5.0_f32.to_le_bytes().repeat(3)));
    let sparse =
        json!({"count": 1, "indices": {"bufferView": at, "componentType": 5121}, "values": {"bufferView": by}});
    let sparse = f.accessor(json!({"componentType": 5126, "count": 4, "type": "VEC3", "sparse": sparse}));
    let short = f.bytes("VEC3", &[255, 0, 0].repeat(4), true);
    primitive["targets"] = json!([{"POSITION": aside}, {"POSITION": sparse}, {"POSITION": short}]);
    let node = f.placed(primitive, json!({}));
    f.shows([1.0; 3], 1e-3);
    for (mesh, of_node, visible) in [
        (json!([1, 0, 0]), None, false),
        (json!([0.1, 0, 0]), None, true),
        (json!([1, 0, 0]), Some(json!([0, 0, 0])), true),
        (json!([0, 0, 0]), Some(json!([1, 0, 0])), false),
        (json!([0, 0, 3]), None, false),
        (json!([-0.6, 0, 3]), None, true),
    ] {
        f.json["meshes"][0]["weights"] = mesh.clone();
        f.json["nodes"][node].as_object_mut().unwrap().remove("weights");
        if let Some(weights) = &of_node {
            f.json["nodes"][node]["weights"] = weights.clone();
        }
        let got = f.rendered("path", 16)[0];
        assert!((got - f32::from(u8::from(visible))).abs() < 1e-3, "{mesh} {of_node:?}: {got}");
    }
    f.json["meshes"][0]["weights"] = json!([0, 1, 0]);
    f.json["nodes"][node].as_object_mut().unwrap().remove("weights");
    let translume_scene::Geometry::Mesh(mesh) = &f.scene().shapes[0].geometry else { panic!() };
    assert_eq!((mesh.positions[1], mesh.positions[2]), ([6.0, 4.0, 5.0], [1.0, 1.0, 0.0]));
}

/// Normals, colours and coordinates are morphed as well.
#[test]
fn morph_targets_of_other_attributes() {
    let mut f = File::new();
    f.sun(60.0);
    let material = f.material(white());
    let mut primitive = f.primitive(material);
    primitive["attributes"]["COLOR_0"] = f.all([1.0, 0.5, 0.0]).into();
    let up = f.all([0.0, 3.0_f32.sqrt(), 0.0]);
    let red = f.all([0.0, -0.5, 0.5]);
    primitive["targets"] = json!([{"NORMAL": up}, {"COLOR_0": red}]);
    f.placed(primitive, json!({}));
    f.shows([0.5, 0.25, 0.0], 1e-3);
    f.json["meshes"][0]["weights"] = json!([1, 0]);
    f.shows([1.0, 0.5, 0.0], 1e-3);
    f.json["meshes"][0]["weights"] = json!([0, 1]);
    f.shows([0.5, 0.0, 0.25], 1e-3);
}

/// A square in a skin, moved aside by its node; the joints are below a node of their own.
fn skinned(joints: &[[f32; 3]], weights: [f32; 4]) -> (File, usize) {
    let mut f = File::new();
    f.sun(0.0);
    let material = f.material(white());
    let mut primitive = f.primitive(material);
    primitive["attributes"]["JOINTS_0"] = f.bytes("VEC4", &[0, 1, 0, 0].repeat(4), false).into();
    primitive["attributes"]["WEIGHTS_0"] = f.all(weights).into();
    let node = f.placed(primitive, json!({"translation": [5, 0, 0], "skin": 0}));
    let mut numbers = Vec::new();
    for joint in joints {
        numbers.push(f.node(json!({"translation": joint})));
    }
    f.json["skins"] = json!([{"joints": numbers}]);
    (f, node)
}

/// §3.7.3: of a skin's mesh only the joints count, by their places and inverse bind matrices.
#[test]
fn skins_where_their_joints_rest() {
    let (f, _) = skinned(&[[0.0; 3], [9.0, 0.0, 0.0]], [1.0, 0.0, 0.0, 0.0]);
    f.shows([1.0; 3], 1e-3);
    // Moved off with half of the weight, and by weights that are no sum of one.
    let (f, _) = skinned(&[[0.0; 3], [9.0, 0.0, 0.0]], [0.5, 0.5, 0.0, 0.0]);
    f.shows([0.0; 3], 1e-3);
    let (f, _) = skinned(&[[-4.0, 0.0, 0.0], [4.0, 0.0, 0.0]], [0.2, 0.2, 0.0, 0.0]);
    f.shows([1.0; 3], 1e-3);
    // A joint far away whose bind matrix takes it back.
    let (mut f, _) = skinned(&[[7.0, 0.0, 0.0], [0.0; 3]], [1.0, 0.0, 0.0, 0.0]);
    let mut back = [0.0; 32];
    (0..8).for_each(|i| back[5 * (i % 4) + 16 * (i / 4)] = 1.0);
    back[12] = -7.0;
    let matrices = f.floats("MAT4", &back);
    f.json["skins"][0]["inverseBindMatrices"] = matrices.into();
    f.shows([1.0; 3], 1e-3);
    // A second set of joints holds what the first leaves.
    let (mut f, _) = skinned(&[[9.0, 0.0, 0.0], [0.0; 3]], [0.0; 4]);
    let (joints, weights) = (f.bytes("VEC4", &[1, 0, 0, 0].repeat(4), false), f.all([1.0, 0.0, 0.0, 0.0]));
    let attributes = &mut f.json["meshes"][0]["primitives"][0]["attributes"];
    (attributes["JOINTS_1"], attributes["WEIGHTS_1"]) = (joints.into(), weights.into());
    f.shows([1.0; 3], 1e-3);
    // Turned by its joint, the normal turns too: 60° to the sun, a cosine of one half over what is seen.
    let (mut f, _) = skinned(&[[0.0; 3], [0.0; 3]], [1.0, 0.0, 0.0, 0.0]);
    let (sin, cos) = (PI / 6.0).sin_cos();
    let joint = f.json["skins"][0]["joints"][0].as_u64().unwrap() as usize;
    f.json["nodes"][joint]["rotation"] = json!([sin, 0.0, 0.0, cos]);
    f.shows([0.5; 3], 1e-3);
}

/// A black dielectric, smooth, before a wall that glows.
fn before_a_wall(material: Value) -> File {
    let mut f = File::new();
    f.square(material, json!({}));
    f.square(glow([1.0; 3]), json!({"translation": [0, 0, 4], "rotation": [0, 1, 0, 0], "scale": [40, 40, 1]}));
    f
}

/// KHR_materials_specular: F0 = 0.04 · color · factor, each with its texture; KHR_materials_ior: F0 of the index.
#[test]
fn specular_reflection() {
    let smooth = |extensions: Value| {
        json!({"pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1], "metallicFactor": 0, "roughnessFactor": 0},
            "extensions": extensions})
    };
    before_a_wall(smooth(json!({}))).shows([0.04; 3], 0.01);
    let red = json!({"specularColorFactor": [1, 0, 0], "specularFactor": 0.5});
    before_a_wall(smooth(json!({"KHR_materials_specular": red}))).shows([0.02, 0.0, 0.0], 0.01);
    before_a_wall(smooth(json!({"KHR_materials_ior": {"ior": 3}}))).shows([0.25; 3], 0.01);
    // All is reflected by an index beyond all bounds, and by a colour that would make it more.
    let all =
        json!({"KHR_materials_ior": {"ior": 0}, "KHR_materials_specular": {"specularColorFactor": [0.5, 9, 0.1]}});
    before_a_wall(smooth(all)).shows([0.5, 1.0, 0.1], 0.01);
    let mut f = before_a_wall(smooth(json!({})));
    let (color, factor) = (f.texture((1, 1), &[[188, 255, 0, 255]]), f.texture((1, 1), &[[0, 0, 0, 51]]));
    f.json["materials"][0]["extensions"]["KHR_materials_specular"] =
        json!({"specularColorTexture": {"index": color}, "specularTexture": {"index": factor}});
    f.shows([0.2 * 0.04 * 0.5029, 0.2 * 0.04, 0.0], 0.01);
    // A metal does not care.
    let mut metal = smooth(json!({"KHR_materials_specular": {"specularFactor": 0}}));
    metal["pbrMetallicRoughness"] =
        json!({"baseColorFactor": [0.3, 0.6, 0.9, 1], "metallicFactor": 1, "roughnessFactor": 0});
    before_a_wall(metal).shows([0.3, 0.6, 0.9], 0.01);
}

/// KHR_materials_pbrSpecularGlossiness: c = diffuse (1 − max specular), F0 = specular, α = (1 − glossiness)².
#[test]
fn specular_glossiness() {
    let old = |inside: Value| json!({"extensions": {"KHR_materials_pbrSpecularGlossiness": inside}});
    let black = [0, 0, 0, 1];
    let f = before_a_wall(old(json!({"diffuseFactor": black, "specularFactor": [0.5, 0, 0.1]})));
    f.shows([0.5, 0.0, 0.1], 0.01);
    let mut f = before_a_wall(old(json!({"diffuseFactor": black, "specularFactor": [0.5, 1, 1]})));
    let texture = f.texture((1, 1), &[[255, 188, 0, 255]]);
    f.json["materials"][0]["extensions"]["KHR_materials_pbrSpecularGlossiness"]["specularGlossinessTexture"] =
        json!({"index": texture});
    f.shows([0.5, 0.5029, 0.0], 0.01);
    // Without specular it is Lambert's; the texture's glossiness spreads a highlight: D(n) = 1/(π α²).
    let mut f = File::new();
    f.sun(0.0);
    f.square(old(json!({"diffuseFactor": [0.2, 0.4, 0.6, 1], "specularFactor": [0, 0, 0]})), json!({}));
    f.shows([0.2, 0.4, 0.6], 0.02);
    f.json["materials"][0] = old(json!({"diffuseFactor": black, "specularFactor": [0.5, 0.5, 0.5]}));
    let half = f.texture((1, 1), &[[255, 255, 255, 102]]);
    f.json["materials"][0]["extensions"]["KHR_materials_pbrSpecularGlossiness"]["specularGlossinessTexture"] =
        json!({"index": half});
    let alpha = 0.6_f32.powi(2);
    f.shows([0.5 / (4.0 * alpha * alpha); 3], 0.01);
}

/// KHR_materials_clearcoat: a GGX lobe of α = roughness², F0 = 0.04, over all roughnesses; the base has what it leaves.
#[test]
fn clear_coats() {
    let coated = |color: [f32; 4], coat: Value| matte(color, json!({"extensions": {"KHR_materials_clearcoat": coat}}));
    let black = [0.0, 0.0, 0.0, 1.0];
    for (roughness, sun, expected) in
        [(0.6_f32, 0.0, 0.0772), (0.6, 40.0, 0.0237), (1.0, 0.0, 0.01), (1.0, 40.0, 0.0087), (0.3, 0.0, 1.2346)]
    {
        let mut f = File::new();
        f.sun(sun);
        f.square(coated(black, json!({"clearcoatFactor": 1, "clearcoatRoughnessFactor": roughness})), json!({}));
        f.shows([expected; 3], 0.02);
        // The same by textures: strength in red, roughness in green.
        let code = (roughness * 255.0).round() as u8;
        let texture = f.texture((1, 1), &[[128, code, 0, 255]]);
        let map = json!({"index": texture});
        f.json["materials"][0] = coated(
            black,
            json!({"clearcoatFactor": 1, "clearcoatRoughnessFactor": 1, "clearcoatTexture": map, "clearcoatRoughnessTexture": map}),
        );
        f.shows([expected * 128.0 / 255.0; 3], 0.03);
    }
    let mut f = File::new();
    f.sun(0.0);
    f.square(coated(WHITE, json!({"clearcoatFactor": 0.5, "clearcoatRoughnessFactor": 1})), json!({}));
    f.shows([1.0 - 0.02 + 0.005; 3], 0.005);
    // Normals of the base do not bend the coat; its own do.
    let coat = json!({"clearcoatFactor": 1, "clearcoatRoughnessFactor": 0.6});
    let mut f = tilted(UP);
    f.json["nodes"][1]["rotation"] = json!([0, 0, 0, 1]);
    f.json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = json!(black);
    f.json["materials"][0]["extensions"]["KHR_materials_clearcoat"] = coat;
    f.shows([0.0772; 3], 0.02);
    let normals = f.json["materials"][0].as_object_mut().unwrap().remove("normalTexture").unwrap();
    f.json["materials"][0]["extensions"]["KHR_materials_clearcoat"]["clearcoatNormalTexture"] = normals;
    // Tilted by 45°, both directions along the surface's normal: D G² F/(4 cos) with m = n.
    let (alpha2, cos2) = (0.36_f32.powi(2), 0.5_f32);
    let d = alpha2 / (std::f32::consts::PI * (cos2 * (alpha2 - 1.0) + 1.0).powi(2));
    let g1 = 2.0 / (1.0 + (1.0 + alpha2 * (1.0 - cos2) / cos2).sqrt());
    let expected = 0.04 * d * g1 * g1 / (4.0 * cos2) * cos2.sqrt() * std::f32::consts::PI;
    f.shows([expected; 3], 0.03);
}

/// KHR_materials_transmission without a volume: nothing is refracted, roughness blurs as it does reflections.
#[test]
fn thin_sheets() {
    let sheet = |roughness: f64, more: Value| {
        let mut extensions = json!({"KHR_materials_transmission": {"transmissionFactor": 1}});
        more.as_object().unwrap().iter().for_each(|(k, v)| extensions[k] = v.clone());
        json!({"pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 1, 1], "metallicFactor": 0, "roughnessFactor": roughness},
            "extensions": extensions})
    };
    let before_lamp = |material: Value, lamp: f64| {
        let mut f = File::new();
        f.square(material, json!({"scale": [9, 9, 1]}));
        f.square(glow([1.0; 3]), json!({"translation": [0, 0, -2], "scale": [lamp, lamp, 1]}));
        f
    };
    before_lamp(sheet(0.0, json!({})), 0.3).shows([0.96, 0.48, 0.96], 0.01);
    let no_specular = json!({"KHR_materials_specular": {"specularFactor": 0}});
    before_lamp(sheet(0.0, no_specular.clone()), 0.3).shows([1.0, 0.5, 1.0], 0.01);
    // The lobe of reflection, mirrored: ∫ D G/(4 cos_o) over the small lamp, by the middle of its solid angle.
    let alpha2 = 0.36_f32.powi(2);
    let lobe = 0.96 / (4.0 * std::f32::consts::PI * alpha2);
    let solid_angle = 0.04_f32 * 0.04 / 4.0;
    let got = before_lamp(sheet(0.6, json!({})), 0.02).rendered("path", 256);
    assert!((got[0] / (lobe * solid_angle) - 1.0).abs() < 0.02, "{got:?} for {}", lobe * solid_angle);
    // A wide lamp is seen through any of them, but for what single scattering loses.
    let got = before_lamp(sheet(0.3, no_specular), 50.0).rendered("path", 256);
    assert!(got[0] > 0.97 && got[0] < 1.001 && (got[1] / got[0] - 0.5).abs() < 0.01, "{got:?}");
}

/// KHR_materials_volume: the medium inside is seen by `volpath`; what passes a surface has its colour.
#[test]
fn volumes() {
    let glass = json!({
        "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 0.5, 1], "metallicFactor": 0, "roughnessFactor": 0},
        "extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_ior": {"ior": 1},
            "KHR_materials_volume": {"thicknessFactor": 1, "attenuationDistance": 2, "attenuationColor": [1, 0.25, 1]}},
    });
    let mut f = File::new();
    let material = f.material(glass);
    let primitive = f.primitive(material);
    let mesh = f.mesh(primitive);
    // Two faces, 1 apart, wide enough for what is seen.
    f.node(json!({"mesh": mesh, "scale": [9, 9, 1]}));
    f.node(json!({"mesh": mesh, "scale": [9, 9, 1], "rotation": [0, 1, 0, 0], "translation": [0, 0, -1]}));
    f.square(glow([1.0; 3]), json!({"translation": [0, 0, -2], "scale": [9, 9, 1]}));
    let got = f.rendered("volpath", 256);
    let expected = [1.0, 0.5, 0.25];
    assert!((0..3).all(|c| (got[c] - expected[c]).abs() < 0.02), "{got:?}");
    // Nothing gets into what does not transmit, so it has no inside.
    f.json["materials"][0]["extensions"]["KHR_materials_transmission"]["transmissionFactor"] = json!(0);
    assert!(f.scene().media.is_empty());
}

/// §3.9.4 and §3.9.5: what is transparent does not shine; double-sided surfaces shine to both sides, others to the front.
#[test]
fn emission() {
    let lamp = |more: Value| matte([0.0, 0.0, 0.0, 1.0], more);
    for (mode, alpha, expected) in [("OPAQUE", 0.3, 1.0), ("BLEND", 0.3, 0.3), ("MASK", 0.3, 0.0), ("MASK", 0.6, 1.0)] {
        let mut f = File::new();
        let material = json!({"emissiveFactor": [1, 1, 1], "alphaMode": mode,
            "pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, alpha]}});
        f.square(lamp(material), json!({}));
        // Something else shines, out of sight.
        f.square(glow([1.0; 3]), json!({"translation": [0, 0, 9]}));
        let scene = f.scene();
        let got = picture(&scene, "path", 256)[0];
        assert!((got - expected).abs() < 0.02, "{mode} {alpha}: {got}");
    }
    for (double, turned, expected) in [(false, false, 1.0), (false, true, 0.0), (true, false, 1.0), (true, true, 1.0)] {
        let mut f = File::new();
        let place = if turned { json!({"rotation": [0, 1, 0, 0]}) } else { json!({}) };
        f.square(lamp(json!({"emissiveFactor": [1, 1, 1], "doubleSided": double})), place);
        f.sun(0.0);
        f.shows([expected; 3], 1e-3);
    }
}

/// A lamp lights what is behind it as what is before it, by every method.
#[test]
fn double_sided_lamps_light_both_sides() {
    for (turned, masked) in [(false, false), (true, false), (true, true)] {
        let mut f = File::new();
        f.square(white(), json!({"scale": [9, 9, 1]}));
        let mut material = matte([0.0; 4], json!({"emissiveFactor": [1, 1, 1], "doubleSided": true}));
        if masked {
            material["alphaMode"] = json!("BLEND");
            material["pbrMetallicRoughness"]["baseColorFactor"] = json!([0, 0, 0, 0.5]);
        }
        let rotation = if turned { json!([0, 1, 0, 0]) } else { json!([0, 0, 0, 1]) };
        f.square(material, json!({"translation": [1.2, 0, 1.5], "scale": [0.3, 0.3, 1], "rotation": rotation}));
        let expected = if masked { 0.5 } else { 1.0 } * 0.0195;
        for method in ["path", "volpath", "bdpt", "gkernel"] {
            let got = f.rendered(method, 256)[0];
            assert!(
                (got / expected - 1.0).abs() < 0.05,
                "{method}, turned {turned}, masked {masked}: {got} {expected}"
            );
        }
    }
}

/// KHR_materials_unlit: the base colour, whatever the light.
#[test]
fn unlit() {
    let mut f = File::new();
    let texture = f.texture((1, 1), &[[188, 255, 0, 255]]);
    let material = f.material(json!({"extensions": {"KHR_materials_unlit": {}},
        "emissiveFactor": [9, 9, 9], "pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 1, 1], "baseColorTexture": {"index": texture}}}));
    let mut primitive = f.primitive(material);
    primitive["attributes"]["COLOR_0"] = f.all([0.5, 1.0, 1.0]).into();
    f.placed(primitive, json!({}));
    f.shows([0.5 * 0.5029, 0.5, 0.0], 0.01);
    f.sun(30.0);
    f.shows([0.5 * 0.5029, 0.5, 0.0], 0.01);
}

/// §3.8: what a picture says of its colours and its orientation is not for glTF.
#[test]
fn pictures_are_as_they_are_stored() {
    let mut png = std::io::Cursor::new(Vec::new());
    let image = image::RgbImage::from_raw(1, 2, vec![188, 0, 0, 0, 188, 0]).unwrap();
    image.write_to(&mut png, image::ImageFormat::Png).unwrap();
    let plain = png.into_inner();
    let mut said = plain[..33].to_vec();
    let exif = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x03\0\0\0\0\0\0";
    said.extend(chunk(b"gAMA", &100_000_u32.to_be_bytes()));
    said.extend(chunk(b"eXIf", exif));
    said.extend(&plain[33..]);
    for bytes in [plain, said] {
        let mut f = File::new();
        let texture = f.png(bytes);
        let factor = json!({"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": texture}});
        f.square(matte([0.0, 0.0, 0.0, 1.0], factor), json!({"translation": [0, -0.5, 0]}));
        f.shows([0.5029, 0.0, 0.0], 0.01);
    }
}

fn chunk(kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let body = [&kind[..], data].concat();
    let crc = !body.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |c, _| if c & 1 == 1 { c >> 1 ^ 0xedb8_8320 } else { c >> 1 })
    });
    [&(data.len() as u32).to_be_bytes(), &body[..], &crc.to_be_bytes()].concat()
}

/// A file without a camera shows all that is in it.
#[test]
fn a_view_of_everything() {
    let mut f = File::new();
    f.json["scenes"][0]["nodes"] = json!([]);
    f.square(glow([1.0; 3]), json!({"translation": [100, 20, 3], "scale": [10, 10, 1]}));
    let scene = f.scene();
    assert!(scene.warnings.len() == 1 && scene.warnings[0].contains("no camera"), "{:?}", scene.warnings);
    let got = picture(&scene, "path", 64);
    // The square is foreshortened, its corners touch the sphere that fills the picture.
    assert!(got[0] > 0.3 && got[0] < 0.6, "{got:?}");
}

/// Missing normals are flat ones; strips and fans are wound as §3.7.2.1 says.
#[test]
fn primitives_of_all_kinds() {
    let strip: [u8; 4] = [0, 1, 3, 2];
    for (mode, order) in [(5, &strip[..]), (6, &[0, 1, 2, 3]), (4, &[0, 1, 2, 0, 2, 3])] {
        let mut f = File::new();
        let material = f.material(matte([0.0, 0.0, 0.0, 1.0], json!({"emissiveFactor": [1, 1, 1]})));
        let mut primitive = f.primitive(material);
        let view = f.raw_view(order);
        let count = order.len();
        let indices = f.accessor(json!({"bufferView": view, "componentType": 5121, "count": count, "type": "SCALAR"}));
        (primitive["mode"], primitive["indices"]) = (mode.into(), indices.into());
        primitive["attributes"].as_object_mut().unwrap().remove("NORMAL");
        f.placed(primitive, json!({}));
        for x in [-0.5, 0.5] {
            f.json["nodes"][0]["translation"] = json!([x, 0.1, 3]);
            f.shows([1.0; 3], 1e-3);
        }
    }
}
