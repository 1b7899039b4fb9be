//! The generated part of the seed corpus: tiny files by the project's own writers. The rest of `fuzz/corpus` is written by
//! hand, or was found.

use crate::input::Input;
use flate2::{Compression, write::ZlibEncoder};
use std::io::Write;
use std::path::Path;
use translume_field::{Model, Params, Rate, Stack, basis::Basis, compress, file, relightlab, simulate};
use translume_image::{
    ExrCompression, ExrOptions, Picture, Precision, Rgb32FImage, encode_jpeg, write_exr, write_gray_png, write_hdr,
    write_pfm, write_png8, write_png16, write_tiff_float, write_tiff8, write_tiff16,
};
use translume_mesh::{TriMesh, obj, ply};
use translume_scatter::simulate::{CaptureParams, Local, Medium, capture_slab};

type Outcome = Result<(), Box<dyn std::error::Error>>;

/// Writes it into the folder `corpus`.
///
/// # Errors
/// Of writing.
pub fn write(corpus: &Path) -> Outcome {
    images(&corpus.join("image"))?;
    meshes(&corpus.join("mesh"))?;
    grids(&corpus.join("grid"))?;
    checkpoints(&corpus.join("checkpoint"))?;
    fields(corpus)?;
    capture(&corpus.join("capture"))?;
    samples(&corpus.join("samples"))
}

fn checkpoints(to: &Path) -> Outcome {
    std::fs::create_dir_all(to)?;
    let (film, identity) = crate::targets::scenes::checkpointed();
    Ok(translume_render::checkpoint::write(&to.join("empty.tlck"), &film, &identity)?)
}

fn images(to: &Path) -> Outcome {
    std::fs::create_dir_all(to)?;
    let (w, h) = (11, 7);
    let floats: Vec<f32> = (0..3 * w * h).map(|i| (i % 31) as f32 * 0.11).collect();
    let picture = Picture::new(Rgb32FImage::from_raw(w as u32, h as u32, floats).ok_or("its size")?);
    let bytes: Vec<u8> = (0..3 * w * h).map(|i| (i * 7) as u8).collect();
    let words: Vec<u16> = (0..3 * w * h).map(|i| (i * 777) as u16).collect();
    write_pfm(&to.join("rgb.pfm"), &picture)?;
    write_hdr(&to.join("rgb.hdr"), &picture)?;
    for (name, compression, precision) in [
        ("none.exr", ExrCompression::None, Precision::Float),
        ("rle.exr", ExrCompression::Rle, Precision::Half),
        ("zip.exr", ExrCompression::Zip, Precision::Float),
        ("piz.exr", ExrCompression::Piz, Precision::Half),
    ] {
        write_exr(&to.join(name), &picture, &ExrOptions { compression, precision, ..ExrOptions::default() })?;
    }
    write_tiff_float(&to.join("float.tif"), &picture)?;
    write_tiff8(&to.join("rgb8.tif"), (w, h), &bytes)?;
    write_tiff16(&to.join("rgb16.tif"), (w, h), &words)?;
    write_png8(&to.join("rgb8.png"), (w, h), &bytes)?;
    write_png16(&to.join("rgb16.png"), (w, h), &words)?;
    write_gray_png(&to.join("gray.png"), (w, h), &bytes[..w * h])?;
    std::fs::write(to.join("rgb.jpg"), encode_jpeg((w, h), &bytes, 80)?)?;
    // True colour, plain and in runs; palette; all without a mark at their beginning.
    let head = |kind: u8, map: [u8; 5], bits: u8| {
        [&[0, u8::from(map[2] > 0), kind], &map[..], &[0; 4], &[w as u8, 0, h as u8, 0, bits, 0x20]].concat()
    };
    std::fs::write(to.join("rgb.tga"), [head(2, [0; 5], 24), bytes].concat())?;
    let runs: Vec<u8> = (0..h).flat_map(|y| [0x80 | (w - 1) as u8, y as u8, 9, 200]).collect();
    std::fs::write(to.join("runs.tga"), [head(10, [0; 5], 24), runs].concat())?;
    let palette = [head(1, [0, 0, 2, 0, 24], 8), vec![0, 0, 255, 0, 255, 0], vec![1; w * h]].concat();
    Ok(std::fs::write(to.join("palette.tga"), palette)?)
}

/// A grid on a wave with all attributes.
fn wave() -> TriMesh {
    const N: u32 = 4;
    let mut mesh = TriMesh::default();
    let (mut normals, mut uvs, mut colors) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..N * N {
        let (x, y) = ((i % N) as f32, (i / N) as f32);
        mesh.positions.push([x, y, (x + y * 0.5).sin()]);
        normals.push([0.0, 0.6, 0.8]);
        uvs.push([x / 4.0, y / 4.0]);
        colors.push([1.0, x / 3.0, y / 3.0]);
    }
    for row in 0..N - 1 {
        mesh.indices.extend((row * N..row * N + N - 1).flat_map(|i| [[i, i + 1, i + N], [i + 1, i + N + 1, i + N]]));
    }
    (mesh.normals, mesh.uvs, mesh.colors) = (Some(normals), Some(uvs), Some(colors));
    mesh
}

fn meshes(to: &Path) -> Outcome {
    std::fs::create_dir_all(to)?;
    let mesh = wave();
    let mut bytes = Vec::new();
    ply::write(&mesh, &mut bytes)?;
    std::fs::write(to.join("wave.ply"), &bytes)?;
    bytes.clear();
    obj::write(&mesh, &mut bytes)?;
    std::fs::write(to.join("wave.obj"), &bytes)?;
    std::fs::write(to.join("big.ply"), ply_big(&mesh))?;
    std::fs::write(to.join("wave.stl"), stl(&mesh))?;
    std::fs::write(to.join("wave.glb"), glb(&mesh))?;
    for (name, version, double) in [("four.serialized", 4, false), ("three.serialized", 3, true)] {
        std::fs::write(to.join(name), serialized(&mesh, version, double)?)?;
    }
    Ok(())
}

/// Big-endian doubles with an element and a property that must be passed over.
fn ply_big(mesh: &TriMesh) -> Vec<u8> {
    let (v, f) = (mesh.positions.len(), mesh.indices.len());
    let mut bytes = format!(
        "ply\r\nformat binary_big_endian 1.0\r\nelement camera 2\r\nproperty list uchar short lens\r\nelement vertex {v}\r\n\
         property double x\r\nproperty double y\r\nproperty uchar quality\r\nproperty double z\r\nelement face {f}\r\n\
         property list uint uint vertex_indices\r\nend_header\r\n"
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

/// Binary, with "solid" where only text has it.
fn stl(mesh: &TriMesh) -> Vec<u8> {
    let mut bytes = b"solid".to_vec();
    bytes.resize(80, 0);
    bytes.extend((mesh.indices.len() as u32).to_le_bytes());
    for face in 0..mesh.indices.len() {
        bytes.extend([0; 12]);
        mesh.corners(face).iter().flat_map(|c| c.to_array()).for_each(|x| bytes.extend(x.to_le_bytes()));
        bytes.extend([0x1f, 0x80]);
    }
    bytes
}

/// 16-bit indices, a sparse replacement, a node with a transform.
fn glb(mesh: &TriMesh) -> Vec<u8> {
    let mut binary = Vec::new();
    mesh.positions.iter().flatten().for_each(|x| binary.extend(x.to_le_bytes()));
    let uvs = binary.len();
    mesh.uvs.iter().flatten().flatten().for_each(|x| binary.extend(x.to_le_bytes()));
    let indices = binary.len();
    mesh.indices.iter().flatten().for_each(|&i| binary.extend((i as u16).to_le_bytes()));
    let sparse = binary.len();
    binary.extend([7, 0, 0, 0]);
    [0.5_f32, 0.5, 9.0].iter().for_each(|x| binary.extend(x.to_le_bytes()));
    binary.resize(binary.len().next_multiple_of(4), 0);
    let (n, m) = (mesh.positions.len(), 3 * mesh.indices.len());
    let document = serde_json::json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [1]}],
        "nodes": [{"mesh": 0, "translation": [0, 0, 5], "name": "leaf"}, {"children": [0], "scale": [2, 2, 2]}],
        "materials": [{"name": "red"}],
        "meshes": [{"primitives": [
            {"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0},
            {"attributes": {"POSITION": 0}, "mode": 0}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": n, "type": "VEC3", "sparse":
                {"count": 1, "indices": {"bufferView": 3, "componentType": 5123}, "values": {"bufferView": 3, "byteOffset": 4}}},
            {"bufferView": 1, "componentType": 5126, "count": n, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5123, "count": m, "type": "SCALAR"}],
        "bufferViews": [
            {"buffer": 0, "byteLength": uvs},
            {"buffer": 0, "byteOffset": uvs, "byteLength": indices - uvs},
            {"buffer": 0, "byteOffset": indices, "byteLength": sparse - indices},
            {"buffer": 0, "byteOffset": sparse, "byteLength": 16}],
        "buffers": [{"byteLength": binary.len()}],
    });
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let word = |n: usize| (n as u32).to_le_bytes();
    let (length, t, b) = (word(28 + text.len() + binary.len()), word(text.len()), word(binary.len()));
    [b"glTF\x02\0\0\0", &length[..], &t, b"JSON", &text, &b, b"BIN\0", &binary].concat()
}

/// One shape.
fn serialized(mesh: &TriMesh, version: u16, double: bool) -> Result<Vec<u8>, std::io::Error> {
    let mut raw = (0xb | if double { 0x2000 } else { 0x1000_u32 }).to_le_bytes().to_vec();
    if version == 4 {
        raw.extend(b"shape\0");
    }
    raw.extend((mesh.positions.len() as u64).to_le_bytes());
    raw.extend((mesh.indices.len() as u64).to_le_bytes());
    let normals = mesh.normals.iter().flatten().flatten();
    let rest = mesh.uvs.iter().flatten().flatten().chain(mesh.colors.iter().flatten().flatten());
    for &x in mesh.positions.iter().flatten().chain(normals).chain(rest) {
        if double { raw.extend(f64::from(x).to_le_bytes()) } else { raw.extend(x.to_le_bytes()) }
    }
    mesh.indices.iter().flatten().for_each(|i| raw.extend(i.to_le_bytes()));
    let mut packed = ZlibEncoder::new([0x1c, 4, version as u8, 0].to_vec(), Compression::best());
    packed.write_all(&raw)?;
    let mut bytes = packed.finish()?;
    bytes.extend(if version == 4 { vec![0; 8] } else { vec![0; 4] });
    bytes.extend(1u32.to_le_bytes());
    Ok(bytes)
}

fn grids(to: &Path) -> Outcome {
    use translume_scene::glam::DVec3;
    std::fs::create_dir_all(to)?;
    for (name, channels) in [("one.vol", 1), ("three.vol", 3)] {
        let values: Vec<f32> = (0..8 * channels).map(|i| i as f32 * 0.3).collect();
        let bytes = translume_scene::grid_bytes([2, 2, 2], channels, [DVec3::ZERO, DVec3::ONE], &values);
        std::fs::write(to.join(name), bytes)?;
    }
    Ok(())
}

fn fields(corpus: &Path) -> Outcome {
    let folder = tempfile::tempdir()?;
    simulate::write(folder.path(), (36, 20), &simulate::lights(9))?;
    std::fs::create_dir_all(corpus.join("field"))?;
    for (name, model, terms, residual) in [
        ("layers.glb", Model::Layers, 4, 0),
        ("residual.glb", Model::Layers, 6, 1),
        ("pca.glb", Model::LogPca, 3, 0),
        ("ptm.glb", Model::Ptm, 0, 0),
    ] {
        let rate = if terms > 0 { Rate::Terms(terms) } else { Rate::Default };
        let params = Params { model, rate, residual, ..Params::default() };
        let field = compress(&mut Stack::open(folder.path(), None)?, &params, &|_| ())?;
        std::fs::write(corpus.join("field").join(name), file::to_bytes(&field, "", name == "pca.glb"))?;
    }
    let field =
        compress(&mut Stack::open(folder.path(), None)?, &Params { model: Model::Ptm, ..Params::default() }, &|_| ())?;
    let out = corpus.join("relightlab/ptm");
    std::fs::create_dir_all(&out)?;
    relightlab::export(&field, Basis::Ptm, &out, 60)?;
    Ok(())
}

fn capture(to: &Path) -> Outcome {
    let local = Local { sigma_s: 1.0, sigma_a: [0.02; 3], g: 0.0 };
    let medium = Medium::new([2, 2, 2], 10.0, |_| local);
    let params = CaptureParams { spots: 2, pixels: 8, field_mm: 6.0, photons: 300, ..CaptureParams::default() };
    let folder = tempfile::tempdir()?;
    capture_slab(&folder.path().join("slab"), &medium, &params, serde_json::Value::Null, || ())?;
    // Of the frames two are enough: the others count as not captured.
    let mut input = Input::load(&folder.path().join("slab"))?;
    input.files.retain(|f| {
        !f.0.starts_with("frames/c/0/") || f.0.starts_with("frames/c/0/0/") || f.0.starts_with("frames/c/0/1/0/")
    });
    Ok(input.write(&to.join("slab"))?)
}

/// NumPy arrays of (points, samples, 3).
fn samples(to: &Path) -> Outcome {
    std::fs::create_dir_all(to)?;
    for (name, kind, version) in [("float.npy", "<f4", 1u8), ("double.npy", "<f8", 2)] {
        let mut head = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': (3, 2, 3), }}");
        head.push('\n');
        let mut bytes = [&b"\x93NUMPY"[..], &[version, 0]].concat();
        bytes.extend((head.len() as u16).to_le_bytes());
        bytes.extend(vec![0; if version == 1 { 0 } else { 2 }]);
        bytes.extend(head.bytes());
        for i in 0..18u8 {
            if version == 1 {
                bytes.extend(f32::from(i).to_le_bytes());
            } else {
                bytes.extend(f64::from(i).to_le_bytes());
            }
        }
        std::fs::write(to.join(name), bytes)?;
    }
    Ok(())
}
