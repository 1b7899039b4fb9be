//! What the readers must get right, on files made here.

mod common;

use common::*;
use std::path::Path;
use translume_mesh::{Error, Loaded, ReadOptions, Topology, TriMesh, obj, ply, read};

/// Reads `bytes` from a file with this extension.
fn load(extension: &str, bytes: &[u8]) -> Result<Loaded, Error> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(format!("a mesh.{extension}"));
    std::fs::write(&path, bytes).unwrap();
    read(&path, &ReadOptions::default())
}

fn only(loaded: Loaded) -> TriMesh {
    assert_eq!(loaded.parts.len(), 1);
    loaded.merged().unwrap()
}

fn refusal(extension: &str, bytes: &[u8]) -> String {
    let error = load(extension, bytes).unwrap_err().to_string();
    assert!(error.contains("a mesh."), "{error}");
    assert!(!error.contains('\n'), "{error}");
    error
}

#[test]
fn binary_ply_keeps_everything() {
    let mut bytes = Vec::new();
    ply::write(&wave(), &mut bytes).unwrap();
    assert_eq!(only(load("ply", &bytes).unwrap()), wave());
    // By content, whatever the name.
    assert_eq!(only(load("bin", &bytes).unwrap()), wave());
}

#[test]
fn other_ply_encodings_keep_the_triangles() {
    let bare = TriMesh { normals: None, uvs: None, colors: None, ..wave() };
    assert_eq!(only(load("ply", ply_text(&wave()).as_bytes()).unwrap()), bare);
    assert_eq!(only(load("ply", &ply_big(&wave())).unwrap()), bare);
    let crlf = ply_text(&wave()).replace('\n', "\r\n");
    assert_eq!(only(load("ply", crlf.as_bytes()).unwrap()), bare);
}

#[test]
fn ply_strips_alternate_and_restart() {
    let mesh = only(load("ply", &ply_strips()).unwrap());
    assert_eq!(mesh.indices, [[0, 1, 2], [2, 1, 3], [2, 3, 4], [1, 3, 2], [2, 3, 4]]);
}

#[test]
fn ply_data_may_begin_with_a_line_feed() {
    // x = 0x0000000A as float bits: the first byte of the data is \n.
    let mut bytes = b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
        property float z\nend_header\n"
        .to_vec();
    bytes.extend([10, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(only(load("ply", &bytes).unwrap()).positions, [[f32::from_bits(10), 0.0, 0.0]]);
}

#[test]
fn ply_refusals_say_where() {
    let header = |vertices: &str, rest: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n\
             element face 1\nproperty list uchar int vertex_indices\nend_header\n{rest}"
        )
    };
    let refuse = |text: String| refusal("ply", text.as_bytes());
    assert!(refuse(header("4000000000000000000", "0 0 0")).contains("4000000000000000000 vertex"));
    assert!(refuse(header("2", "0 0 0\n0 x 0\n3 0 0 0")).contains("vertex 1 of 2"));
    assert!(refuse(header("1", "0 0 0\n3 0 0 1")).contains("face 0 uses vertex 1, there are 1"));
    assert!(refuse(header("1", "0 0 0\n3 0 0 -1")).contains("vertex -1"));
    assert!(refuse(header("1", "0 0 0\n2000000000 0 0")).contains("face 0 of 1"));
    assert!(refuse("ply\nformat ascii 1.0\n".into()).contains("end_header"));
    assert!(refuse("ply\nformat binary_middle 1.0\nend_header\n".into()).contains("binary_middle"));
}

#[test]
fn obj_parts_keep_names_and_share_no_vertices() {
    let text = b"mtllib some lib.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt 0 0\nvt 1 1\nvn 0 0 1\n\
        o left\nusemtl red paint\nf 1/1/1 2/2/1 3/1/1\ng right\nusemtl blue\nf 2 4 3\nf 3/1 2 4/2 # tail\n\
        o left\nusemtl red paint\nf 1/1/1 3/1/1 4/1/1\nl 1 2\n";
    let loaded = load("obj", text).unwrap();
    assert_eq!(loaded.parts.len(), 2);
    let [left, right] = [&loaded.parts[0], &loaded.parts[1]];
    assert_eq!((left.name.as_str(), left.material.as_deref()), ("left", Some("red paint")));
    assert_eq!((right.name.as_str(), right.material.as_deref()), ("right", Some("blue")));
    assert_eq!((left.mesh.indices.len(), left.mesh.positions.len()), (2, 4));
    assert_eq!(left.mesh.normals.as_ref().unwrap()[0], [0.0, 0.0, 1.0]);
    // Corners without texture coordinates get zeros and stay apart from those with.
    assert_eq!((right.mesh.positions.len(), right.mesh.normals.is_none()), (5, true));
    assert_eq!(loaded.warnings.len(), 1);
    assert!(loaded.material_files[0].ends_with("some lib.mtl"));
}

#[test]
fn obj_numbers_polygons_and_line_ends() {
    let text = "\u{feff}v 0 0 0 1\r\nv 4 0 1 1 .5 0\r\nv 4. +4 1\r\nv 2e0 1 .5\r\nv 0 4 nan(ind)\r\nv 0 4 0\r\n\
        f 1 2 3 \\\r\n -3 6\r\n";
    let mesh = only(load("obj", text.as_bytes()).unwrap());
    assert_eq!(mesh.indices.len(), 3);
    // The notch at (2, 1) is cut out: a fan from the first corner would cover 4 × 4 − something else.
    assert!((mesh.area() - (16.0 - 6.0) * 17.0_f64.sqrt() / 4.0).abs() < 1e-12);
    let color = |p: [f32; 3]| mesh.colors.as_ref().unwrap()[mesh.positions.iter().position(|&q| q == p).unwrap()];
    assert_eq!(color([0.0, 0.0, 0.0]), [1.0; 3], "a fourth number is a weight");
    assert_eq!(color([4.0, 0.0, 1.0]), [1.0, 0.5, 0.0]);
}

#[test]
fn obj_refusals_name_the_line() {
    for (text, why) in [
        ("v 0 0 0\nv 1 0 x\n", "line 2"),
        ("v 0 0 0\n\nf 1 2 3\n", "line 3: a face uses vertex 2, there are 1"),
        ("v 0 0 0\r\n\r\nf 1 1 0\r\n", "line 3: a face uses vertex 0"),
        ("v 0 0 0\nf 1 1 -2\n", "line 2"),
        ("v 0 0 0\nf 1/x 1 1\n", "line 2: face corner"),
        ("v 0 0 0\nf 1 1 99999999999999999999999\n", "line 2"),
        ("hello\n", "no vertices"),
    ] {
        let error = refusal("obj", text.as_bytes());
        assert!(error.contains(why), "{text:?}: {error}");
    }
    assert!(matches!(load("obj", b"\xff\xfev\0 \0").unwrap_err(), Error::Unsupported { .. }));
}

#[test]
fn obj_written_is_obj_read() {
    let mut bytes = Vec::new();
    obj::write(&wave(), &mut bytes).unwrap();
    let mesh = only(load("obj", &bytes).unwrap());
    // Vertices come in the order of their first use.
    assert_eq!(Topology::of(&mesh), Topology::of(&wave()));
    let corners = |m: &TriMesh| -> Vec<_> {
        let at = |i: u32| {
            let i = i as usize;
            (m.positions[i], m.normals.as_ref().unwrap()[i], m.uvs.as_ref().unwrap()[i], m.colors.as_ref().unwrap()[i])
        };
        m.indices.iter().map(|t| t.map(at)).collect()
    };
    assert_eq!(corners(&mesh), corners(&wave()));
}

#[test]
fn mtl_materials() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("m.mtl");
    let text = "# nothing\nKd 9 9 9\nnewmtl red paint\nKd 1 0.5 0\nKs .5\nNs 200\nTr 0.25\nillum 2\n\
        map_Kd -o 1 2 -bm 0.5 tex dir\\wood grain.png\nnewmtl glass\nNi 1.5\nd 0.1\nKd spectral file.rfl\n";
    std::fs::write(&path, text).unwrap();
    let materials = obj::read_mtl(&path).unwrap();
    assert_eq!(materials.len(), 2);
    let red = &materials[0];
    assert_eq!((red.name.as_str(), red.diffuse, red.specular), ("red paint", Some([1.0, 0.5, 0.0]), Some([0.5; 3])));
    assert_eq!((red.exponent, red.opacity, red.illumination), (Some(200.0), Some(0.75), Some(2)));
    assert_eq!(red.textures, [("map_Kd".into(), dir.path().join("tex dir/wood grain.png"))]);
    assert_eq!((materials[1].ior, materials[1].opacity, materials[1].diffuse), (Some(1.5), Some(0.1), None));
}

#[test]
fn gltf_nodes_sparse_values_and_texture_origin() {
    for (extension, bytes) in [("glb", glb(&wave())), ("gltf", gltf_text(&wave()))] {
        let loaded = load(extension, &bytes).unwrap();
        assert_eq!(loaded.warnings.len(), 1, "the points are reported");
        let part = &loaded.parts[0];
        assert_eq!((part.name.as_str(), part.material.as_deref()), ("leaf", Some("red")));
        assert_eq!(part.mesh.indices, wave().indices);
        assert_eq!(part.mesh.positions[8], wave().positions[8].map(|x| 2.0 * x).map_last(|z| z + 10.0));
        assert_eq!(part.mesh.positions[7], [1.0, 1.0, 28.0], "the sparse value, transformed");
        let (u, v) = (wave().uvs.unwrap()[9][0], 1.0 - wave().uvs.unwrap()[9][1]);
        assert_eq!(part.mesh.uvs.as_ref().unwrap()[9], [u, v]);
    }
}

trait MapLast {
    fn map_last(self, f: impl Fn(f32) -> f32) -> Self;
}

impl MapLast for [f32; 3] {
    fn map_last(mut self, f: impl Fn(f32) -> f32) -> Self {
        self[2] = f(self[2]);
        self
    }
}

#[test]
fn gltf_refusals() {
    let text = String::from_utf8(gltf_text(&wave())).unwrap();
    let refuse = |from: &str, to: &str| {
        assert!(text.contains(from));
        refusal("gltf", text.replacen(from, to, 1).as_bytes())
    };
    assert!(refuse(r#""count":36"#, r#""count":360000000000"#).contains("accessor 0 reaches beyond"));
    assert!(refuse(r#""children":[0]"#, r#""children":[1]"#).contains("node 1 is reached twice"));
    assert!(refuse(r#""children":[0]"#, r#""children":[77]"#).contains("no node 77"));
    assert!(refuse(r#""version":"2.0""#, r#""version":"1.0""#).contains("1.0"));
    assert!(refuse(r#""scene":0"#, r#""scene":0,"extensionsRequired":["ABC_x"]"#).contains("ABC_x"));
    assert!(refuse("octet-stream;base64,", "octet-stream;base64,*").contains("data URI"));
    assert!(refuse(r#""bufferView":2"#, r#""bufferView":9"#).contains("accessor 2"));
    assert!(
        refuse(r#""componentType":5123,"count":150"#, r#""componentType":5122,"count":150"#).contains("accessor 2")
    );
    let mut cut = glb(&wave());
    cut.truncate(cut.len() - 5);
    assert!(refusal("glb", &cut).contains("truncated"));
}

#[test]
fn serialized_shapes_in_both_versions() {
    let bare = TriMesh { normals: None, uvs: None, colors: None, ..wave() };
    for (version, double) in [(3, false), (3, true), (4, false), (4, true)] {
        let loaded = load("serialized", &serialized(&wave(), version, double)).unwrap();
        assert_eq!(loaded.parts.len(), 2);
        assert_eq!(loaded.parts[0].mesh, wave());
        assert_eq!(loaded.parts[1].mesh, bare);
        assert_eq!([loaded.parts[0].flat, loaded.parts[1].flat], [false, true]);
        assert_eq!(loaded.parts[0].name, if version == 4 { "shape" } else { "a mesh" });
    }
}

#[test]
fn serialized_refusals() {
    let good = serialized(&wave(), 4, false);
    let n = good.len();
    let mut bytes = good.clone();
    bytes[n - 4..].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(refusal("serialized", &bytes).contains("4294967295 shapes"));
    bytes = good.clone();
    bytes[n - 12..n - 4].copy_from_slice(&u64::MAX.to_le_bytes());
    assert!(refusal("serialized", &bytes).contains("beyond the end"));
    bytes = good;
    bytes.copy_within(n - 20..n - 12, n - 12);
    assert!(refusal("serialized", &bytes).contains("do not increase"));
    // A stream that promises 2^60 vertices.
    let mut raw = 0x1000_u32.to_le_bytes().to_vec();
    raw.extend(b"\0");
    raw.extend(u64::from(u32::MAX).to_le_bytes());
    raw.extend(1_u64.to_le_bytes());
    let mut packed = flate2::write::ZlibEncoder::new(vec![0x1c, 4, 4, 0], flate2::Compression::default());
    std::io::Write::write_all(&mut packed, &raw).unwrap();
    bytes = packed.finish().unwrap();
    bytes.extend(0_u64.to_le_bytes());
    bytes.extend(1_u32.to_le_bytes());
    assert!(refusal("serialized", &bytes).contains("4294967295 records"));
}

#[test]
fn a_part_can_be_picked() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("m.serialized");
    std::fs::write(&path, serialized(&wave(), 4, false)).unwrap();
    let part = |part| read(&path, &ReadOptions { part: Some(part), ..ReadOptions::default() });
    assert!(part(1).unwrap().parts[0].mesh.uvs.is_none());
    assert!(part(2).unwrap_err().to_string().contains("no shape 2"));
}

/// The collections of odd and damaged files, when they are there: every one gives a mesh or an error of one line.
#[test]
fn shared_collections_of_damaged_files() {
    let Some(data) = std::env::var_os("TRANSLUME_DATA") else {
        eprintln!("skipped: TRANSLUME_DATA is not set");
        return;
    };
    let mut count = 0;
    let mut folders = vec![Path::new(&data).join("meshes")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            count += 1;
            match read(&path, &ReadOptions::default()) {
                Ok(loaded) => assert!(loaded.parts.iter().all(|p| p.mesh.fault().is_none()), "{path:?}"),
                Err(error) => assert!(!error.to_string().contains('\n'), "{error}"),
            }
        }
    }
    eprintln!("{count} files");
    assert!(count > 0);
}
