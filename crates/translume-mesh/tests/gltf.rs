//! Poses, visibility, instances and neighbouring files of glTF, as meshes.

use std::path::Path;
use translume_mesh::{Error, Loaded, ReadOptions, read};

/// The triangle (0, 0, 0), (1, 0, 0), (0, 1, 0) on a node that is moved by 5 along x; `MORE` stands for further parts.
const TRIANGLE: &str = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
    "nodes": [{"mesh": 0, "translation": [5, 0, 0]}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]}"#;

fn changed(changes: &[(&str, &str)]) -> String {
    let mut text = TRIANGLE.to_owned();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, to, 1);
    }
    text
}

fn load(text: &str) -> Result<Loaded, Error> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("t.gltf");
    std::fs::write(&path, text).unwrap();
    read(&path, &ReadOptions::default())
}

/// The second corner of each part.
fn corners(text: &str) -> Vec<[f32; 3]> {
    let loaded = load(text).unwrap();
    assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
    loaded.parts.iter().map(|p| p.mesh.positions[1]).collect()
}

#[test]
fn words_of_data_uris_have_no_case() {
    for start in ["data:application/octet-stream;base64,", "DATA:application/octet-stream;BASE64,", "Data:;Base64,"] {
        let text = changed(&[("data:application/octet-stream;base64,", start)]);
        assert_eq!(corners(&text), [[6.0, 0.0, 0.0]], "{start}");
    }
}

#[test]
fn what_is_invisible_is_no_part() {
    let node = r#"{"mesh": 0, "translation": [5, 0, 0]}"#;
    let hidden = |visible: bool| {
        format!(
            r#"{{"children": [1], "extensions": {{"KHR_node_visibility": {{"visible": {visible}}}}}}}, {{"mesh": 0, "translation": [5, 0, 0]}}"#
        )
    };
    assert_eq!(corners(&changed(&[(node, &hidden(true))])).len(), 1);
    assert_eq!(corners(&changed(&[(node, &hidden(false))])).len(), 0, "with all below it");
}

#[test]
fn poses_are_those_of_the_nodes() {
    let target =
        (r#"{"attributes": {"POSITION": 0}}"#, r#"{"attributes": {"POSITION": 0}, "targets": [{"POSITION": 0}]}"#);
    let of_mesh = (
        r#"}]}],
    "accessors""#,
        r#"}], "weights": [2]}],
    "accessors""#,
    );
    assert_eq!(corners(&changed(&[target])), [[6.0, 0.0, 0.0]]);
    assert_eq!(corners(&changed(&[target, of_mesh])), [[8.0, 0.0, 0.0]]);
    let of_node = (r#""mesh": 0,"#, r#""mesh": 0, "weights": [0.5],"#);
    assert_eq!(corners(&changed(&[target, of_mesh, of_node])), [[6.5, 0.0, 0.0]]);
    // Two nodes with poses of their own.
    let two = (r#""nodes": [0]"#, r#""nodes": [0, 1]"#);
    let other = (r#"[5, 0, 0]}]"#, r#"[5, 0, 0]}, {"mesh": 0}]"#);
    assert_eq!(corners(&changed(&[target, of_mesh, of_node, two, other])), [[6.5, 0.0, 0.0], [3.0, 0.0, 0.0]]);
}

#[test]
fn skins_are_where_their_joints_are() {
    // Joints of zeros and ones: the position's own bytes will do, as weights of 0, 1 and 0 too.
    let attributes = (r#"{"POSITION": 0}"#, r#"{"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}"#);
    let accessors = (
        r#""type": "VEC3"}]"#,
        r#""type": "VEC3"}, {"componentType": 5121, "count": 3, "type": "VEC4"},
           {"componentType": 5126, "count": 3, "type": "VEC4"}]"#,
    );
    let node = (
        r#"{"mesh": 0, "translation": [5, 0, 0]}"#,
        r#"{"mesh": 0, "translation": [5, 0, 0], "skin": 0}, {"translation": [0, 0, 7], "children": [2]}, {"scale": [2, 2, 2]}"#,
    );
    let skin = (r#""bufferViews""#, r#""skins": [{"joints": [2]}], "bufferViews""#);
    let all = [attributes, accessors, node, skin];
    // Weights of nothing: the first joint has the vertices.
    assert_eq!(corners(&changed(&all)), [[2.0, 0.0, 7.0]]);
    for (from, to, why) in [
        ("\"joints\": [2]", "\"joints\": [9]", "node 9 as a joint"),
        ("\"joints\": [2]", "\"joints\": []", "joint 0 of a skin of 0"),
        ("\"skin\": 0", "\"skin\": 3", "no skin 3"),
        ("\"joints\": [2]", "\"joints\": [2], \"inverseBindMatrices\": 2", "components"),
    ] {
        let error = load(&changed(&[&all[..], &[(from, to)]].concat())).unwrap_err().to_string();
        assert!(error.contains(why), "{error}");
    }
    // A primitive without joints is placed by its node.
    assert_eq!(corners(&changed(&[node, skin])), [[6.0, 0.0, 0.0]]);
}

#[test]
fn instances_are_parts_each() {
    let node = (
        r#""mesh": 0,"#,
        r#""mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}},"#,
    );
    let required = (r#""scene": 0"#, r#""scene": 0, "extensionsRequired": ["EXT_mesh_gpu_instancing"]"#);
    assert_eq!(corners(&changed(&[node, required])), [[6.0, 0.0, 0.0], [7.0, 0.0, 0.0], [6.0, 1.0, 0.0]]);
}

#[test]
fn files_outside_of_the_folder_are_read_where_it_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let (inside, outside) = (dir.path().join("scene/model"), dir.path().join("scene/data"));
    [&inside, &outside, &inside.join("deep")].into_iter().for_each(|d| std::fs::create_dir_all(d).unwrap());
    let bytes: Vec<u8> =
        [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    let data = TRIANGLE.find("data:").unwrap();
    let end = data + TRIANGLE[data..].find('"').unwrap();
    let read = |uri: &str, roots: &[&Path]| {
        let path = inside.join("t.gltf");
        std::fs::write(&path, format!("{}{uri}{}", &TRIANGLE[..data], &TRIANGLE[end..])).unwrap();
        let asset_roots = roots.iter().map(|r| r.to_path_buf()).collect();
        read(&path, &ReadOptions { asset_roots, ..ReadOptions::default() })
    };
    for at in [inside.join("a.bin"), inside.join("deep/a b.bin"), outside.join("a.bin")] {
        std::fs::write(at, &bytes).unwrap();
    }
    for uri in ["a.bin", "deep/a%20b.bin", "deep/../a.bin", "../model/a.bin"] {
        assert_eq!(read(uri, &[]).unwrap().parts.len(), 1, "{uri}");
    }
    let error = read("../data/a.bin", &[]).unwrap_err();
    assert!(matches!(error, Error::Outside { .. }) && error.to_string().contains("outside of its folder"), "{error}");
    assert_eq!(read("../data/a.bin", &[&outside]).unwrap().parts.len(), 1);
    assert!(read("../data/a.bin", &[&inside]).is_err());
    assert!(read("/etc/hostname", &[]).is_err() && read("http://a/b.bin", &[]).is_err());
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(outside.join("a.bin"), inside.join("link.bin")).unwrap();
        assert!(matches!(read("link.bin", &[]).unwrap_err(), Error::Outside { .. }));
        assert!(read("link.bin", &[&outside]).is_ok());
    }
}

/// What no 32-bit float can be is refused where it stands; extras are the application's own.
#[test]
fn numbers_fit_floats() {
    let with = |field: &str| changed(&[("\"nodes\": [{", &format!("\"nodes\": [{{{field}, "))]);
    let error = load(&with("\"extensions\": {\"any\": [0, 1e300]}")).unwrap_err().to_string();
    assert!(error.contains("nodes/0/extensions/any/1: 1e300 is too large"), "{error}");
    assert_eq!(corners(&with("\"extras\": {\"any\": 1e300}, \"weights\": [3e38, -3e38]")), [[6.0, 0.0, 0.0]]);
}
