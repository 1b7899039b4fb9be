//! One small mesh, and its bytes in formats that are read but not written.
#![allow(dead_code, reason = "each test file uses a part of it")]

use translume_mesh::TriMesh;

/// A grid on a wave with all attributes.
pub(crate) fn wave() -> TriMesh {
    const N: u32 = 6;
    let mut mesh = TriMesh { normals: Some(vec![]), uvs: Some(vec![]), colors: Some(vec![]), ..TriMesh::default() };
    for i in 0..N * N {
        let (x, y) = ((i % N) as f32, (i / N) as f32);
        mesh.positions.push([x, y, (x + y * 0.5).sin()]);
        mesh.normals.as_mut().unwrap().push([0.0, 0.6, 0.8]);
        mesh.uvs.as_mut().unwrap().push([x / 8.0, y / 8.0]);
        mesh.colors.as_mut().unwrap().push([1.0, x / 5.0, y / 5.0].map(|c| (c * 255.0_f32).round() / 255.0));
    }
    for row in 0..N - 1 {
        for i in row * N..row * N + N - 1 {
            mesh.indices.extend([[i, i + 1, i + N], [i + 1, i + N + 1, i + N]]);
        }
    }
    mesh
}

pub(crate) fn ply_text(mesh: &TriMesh) -> String {
    let mut text = format!(
        "ply\nformat ascii 1.0\ncomment made by a test\nelement vertex {}\nproperty float x\nproperty float y\n\
         property float z\nelement face {}\nproperty list uchar int vertex_index\nend_header\n",
        mesh.positions.len(),
        mesh.indices.len()
    );
    mesh.positions.iter().for_each(|[x, y, z]| text += &format!("{x} {y} {z}\n"));
    mesh.indices.iter().for_each(|[a, b, c]| text += &format!("3 {a} {b} {c}\n"));
    text
}

/// Big-endian doubles with an element and a property that must be skipped.
pub(crate) fn ply_big(mesh: &TriMesh) -> Vec<u8> {
    let mut bytes = format!(
        "ply\r\nformat binary_big_endian 1.0\r\nelement camera 2\r\nproperty list uchar short lens\r\nelement vertex {}\r\n\
         property double x\r\nproperty double y\r\nproperty uchar quality\r\nproperty double z\r\nelement face {}\r\n\
         property list uint uint vertex_indices\r\nend_header\r\n",
        mesh.positions.len(),
        mesh.indices.len()
    )
    .into_bytes();
    bytes.extend([0, 2, 0, 1, 0, 2]);
    for p in &mesh.positions {
        let [x, y, z] = p.map(|x| f64::from(x).to_be_bytes());
        bytes.extend([&x[..], &y, b"\n", &z].concat());
    }
    for t in &mesh.indices {
        bytes.extend([[0, 0, 0, 3], t[0].to_be_bytes(), t[1].to_be_bytes(), t[2].to_be_bytes()].concat());
    }
    bytes
}

/// Two strips of three and two triangles in one list.
pub(crate) fn ply_strips() -> Vec<u8> {
    b"ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n\
      element tristrips 1\nproperty list int int vertex_indices\nend_header\n\
      0 0 0\n1 0 0\n0 1 0\n1 1 0\n0 2 0\n10 0 1 2 3 4 -1 1 3 2 4\n"
        .to_vec()
}

/// Buffer of the mesh and the JSON that describes it; 16-bit indices, a sparse replacement, a node with a transform.
fn gltf_parts(mesh: &TriMesh, uri: Option<&str>) -> (Vec<u8>, String) {
    let mut bin = Vec::new();
    mesh.positions.iter().flatten().for_each(|x| bin.extend(x.to_le_bytes()));
    let uvs = bin.len();
    mesh.uvs.iter().flatten().flatten().for_each(|x| bin.extend(x.to_le_bytes()));
    let indices = bin.len();
    mesh.indices.iter().flatten().for_each(|&i| bin.extend((i as u16).to_le_bytes()));
    let sparse = bin.len();
    bin.extend([7, 0, 0, 0]);
    [0.5_f32, 0.5, 9.0].iter().for_each(|x| bin.extend(x.to_le_bytes()));
    let (n, m, total) = (mesh.positions.len(), 3 * mesh.indices.len(), bin.len());
    let uri = uri.map_or(String::new(), |u| format!(r#""uri":"{u}","#));
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[1]}}],
"nodes":[{{"mesh":0,"translation":[0,0,5],"name":"leaf"}},{{"children":[0],"scale":[2,2,2]}}],
"materials":[{{"name":"red"}}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}},"indices":2,"material":0}},{{"attributes":{{"POSITION":0}},"mode":0}}]}}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":{n},"type":"VEC3",
"sparse":{{"count":1,"indices":{{"bufferView":3,"componentType":5123}},"values":{{"bufferView":3,"byteOffset":4}}}}}},
{{"bufferView":1,"componentType":5126,"count":{n},"type":"VEC2"}},
{{"bufferView":2,"componentType":5123,"count":{m},"type":"SCALAR"}}],
"bufferViews":[{{"buffer":0,"byteLength":{uvs}}},
{{"buffer":0,"byteOffset":{uvs},"byteLength":{}}},
{{"buffer":0,"byteOffset":{indices},"byteLength":{}}},
{{"buffer":0,"byteOffset":{sparse},"byteLength":16}}],
"buffers":[{{{uri}"byteLength":{total}}}]}}"#,
        indices - uvs,
        sparse - indices,
    );
    (bin, json)
}

pub(crate) fn glb(mesh: &TriMesh) -> Vec<u8> {
    let (mut bin, json) = gltf_parts(mesh, None);
    let mut json = json.into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    bin.resize(bin.len().next_multiple_of(4), 0);
    let word = |n: usize| (n as u32).to_le_bytes();
    let length = word(28 + json.len() + bin.len());
    let (j, b) = (word(json.len()), word(bin.len()));
    [b"glTF\x02\0\0\0", &length[..], &j, b"JSON", &json, &b, b"BIN\0", &bin].concat()
}

pub(crate) fn gltf_text(mesh: &TriMesh) -> Vec<u8> {
    use base64::Engine;
    let (bin, _) = gltf_parts(mesh, None);
    let uri = base64::engine::general_purpose::STANDARD.encode(bin);
    gltf_parts(mesh, Some(&format!("data:application/octet-stream;base64,{uri}"))).1.into_bytes()
}

/// Two shapes: the mesh, and the mesh without attributes.
pub(crate) fn serialized(mesh: &TriMesh, version: u16, double: bool) -> Vec<u8> {
    let bare = TriMesh { normals: None, uvs: None, colors: None, ..mesh.clone() };
    serialized_from(version, &[stream(mesh, 0x1 | 0x2 | 0x8, version, double), stream(&bare, 0x10, version, double)])
}

/// What stands in a shape's zlib stream.
pub(crate) fn stream(shape: &TriMesh, flags: u32, version: u16, double: bool) -> Vec<u8> {
    let width = if double { 0x2000 } else { 0x1000 };
    let mut raw = (flags | width).to_le_bytes().to_vec();
    if version == 4 {
        raw.extend(b"shape\0");
    }
    raw.extend((shape.positions.len() as u64).to_le_bytes());
    raw.extend((shape.indices.len() as u64).to_le_bytes());
    let floats = [Some(&shape.positions), shape.normals.as_ref()].into_iter().flatten().flatten().flatten();
    let floats = floats.chain(shape.uvs.iter().flatten().flatten());
    for &x in floats.chain(shape.colors.iter().flatten().flatten()) {
        if double { raw.extend(f64::from(x).to_le_bytes()) } else { raw.extend(x.to_le_bytes()) }
    }
    shape.indices.iter().flatten().for_each(|i| raw.extend(i.to_le_bytes()));
    raw
}

/// A file of these streams.
pub(crate) fn serialized_from(version: u16, streams: &[Vec<u8>]) -> Vec<u8> {
    let (mut bytes, mut offsets) = (Vec::new(), Vec::new());
    for raw in streams {
        offsets.push(bytes.len() as u64);
        bytes.extend(0x041c_u16.to_le_bytes());
        bytes.extend(version.to_le_bytes());
        let mut packed = flate2::write::ZlibEncoder::new(bytes, flate2::Compression::default());
        std::io::Write::write_all(&mut packed, raw).unwrap();
        bytes = packed.finish().unwrap();
    }
    for offset in &offsets {
        if version == 4 { bytes.extend(offset.to_le_bytes()) } else { bytes.extend((*offset as u32).to_le_bytes()) }
    }
    bytes.extend((streams.len() as u32).to_le_bytes());
    bytes
}
