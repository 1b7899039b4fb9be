//! Files as programs write them, against the letter of their formats: read as they are meant, with a word; and the
//! healthy twin of each, without one.

mod common;

use common::*;
use translume_mesh::glam::DVec3;
use translume_mesh::{Error, Loaded, ReadOptions, TriMesh, ply, read, stl};

fn load_as(extension: &str, bytes: &[u8], keep_origin: bool) -> Result<Loaded, Error> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(format!("mesh.{extension}"));
    std::fs::write(&path, bytes).unwrap();
    read(&path, &ReadOptions { keep_origin, ..ReadOptions::default() })
}

fn load(extension: &str, text: &str) -> Loaded {
    load_as(extension, text.as_bytes(), false).unwrap_or_else(|e| panic!("{text}: {e}"))
}

fn refusal(extension: &str, text: &str) -> String {
    load_as(extension, text.as_bytes(), false).unwrap_err().to_string()
}

fn area(loaded: Loaded) -> f64 {
    loaded.merged().unwrap().area()
}

const SQUARE: &str = "element vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n\
    property list uchar int vertex_indices\n";
const POINTS: &str = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n";

fn square(header: &str, vertices: &str, faces: &str) -> String {
    format!("ply\nformat ascii 1.0\n{SQUARE}{header}end_header\n{vertices}{faces}")
}

#[test]
fn ply_lines_may_hold_more_than_the_header_says() {
    let said = |text: &str| load("ply", text).warnings.join("; ");
    let faces = "3 0 1 2\n3 0 2 3\n";
    assert_eq!(said(&square("", POINTS, faces)), "");
    assert_eq!(said(&square("", POINTS, &faces.replace('\n', "\r\n\r\n"))), "");
    for (vertices, faces, word) in [
        (POINTS.to_owned(), "3 0 1 2 9 8 7\n3 0 2 3 6\n".to_owned(), "4 numbers in its lines"),
        (POINTS.replace("1 1 0", "1 1 0 255 0"), faces.to_owned(), "2 numbers in its lines"),
        (POINTS.to_owned(), format!("{faces}3 0 1 3\n"), "4 words after the last element"),
    ] {
        let text = square("", &vertices, &faces);
        assert!(said(&text).contains(word), "{}", said(&text));
        assert_eq!(area(load("ply", &text)), 1.0);
    }
    // All in one line is sound, if odd.
    let joined = square("", &POINTS.replace('\n', " "), &faces.replace('\n', " "));
    assert_eq!((said(&joined), area(load("ply", &joined))), (String::new(), 1.0));
    let mut binary = Vec::new();
    ply::write(&wave(), &mut binary).unwrap();
    assert!(load_as("ply", &binary, false).unwrap().warnings.is_empty());
    binary.extend([1, 2, 3]);
    assert!(load_as("ply", &binary, false).unwrap().warnings[0].contains("3 bytes after the last element"));
}

#[test]
fn ply_headers_of_other_programs() {
    let faces = "3 0 1 2\n3 0 2 3\n";
    let odd = square("obj_info made by hand\nauthor somebody\n", POINTS, faces);
    let loaded = load("ply", &odd);
    assert!(loaded.warnings.len() == 1 && loaded.warnings[0].contains("author somebody"), "{:?}", loaded.warnings);
    assert_eq!(area(loaded), 1.0);
    assert!(refusal("ply", &odd.replace("author", "\u{1}\u{2}")).contains("cannot understand"));
    // Line ends that change within the header, and lists of odd types.
    let mixed =
        square("", POINTS, faces).replacen("ply\n", "ply\r\n", 1).replace("list uchar int", "list float double");
    assert_eq!(area(load("ply", &mixed)), 1.0);
    let wide = square("", POINTS, faces).replace("list uchar int", "list int64 uint64");
    assert_eq!(area(load("ply", &wide)), 1.0);
    assert!(refusal("ply", &mixed.replace("3 0 2 3", "2.5 0 2 3")).contains("face 1"));
}

#[test]
fn obj_corners_may_name_what_is_not_there() {
    let points = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
    for faces in ["f 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/4/1\n", "f 1/0 2/0 3/0\nf -4/-1 -2/-1 -1/-1\n"] {
        let loaded = load("obj", &format!("{points}{faces}"));
        assert!(loaded.warnings.iter().any(|w| w.contains("6 corners") && w.contains("(vt)")), "{:?}", loaded.warnings);
        let mesh = loaded.merged().unwrap();
        assert!((mesh.area(), &mesh.uvs, &mesh.normals) == (1.0, &None, &None));
    }
    let sound = load("obj", &format!("{points}vt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\n"));
    assert!(sound.warnings.is_empty() && sound.parts[0].mesh.uvs.is_some() && sound.parts[0].mesh.normals.is_some());
    let error = refusal("obj", &format!("{points}f 1 2 5\n"));
    assert!(error.contains("line 5") && error.contains("vertex 5, there are 4"), "{error}");
    assert!(refusal("obj", &format!("{points}f -5 -1 -2\n")).contains("line 5"));
}

#[test]
fn point_clouds_keep_their_points() {
    let loaded = load("obj", "v 0 0 0\nv 1 0 0 0 1 0\nv 1 1 0\nv 0 1 0\n");
    let mesh = &loaded.parts[0].mesh;
    assert_eq!((mesh.positions.len(), mesh.indices.len(), mesh.fault()), (4, 0, None));
    assert_eq!(mesh.colors.as_ref().unwrap()[1], [0.0, 1.0, 0.0]);
    let text = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n1 0 0\n";
    assert_eq!(load("ply", text).parts[0].mesh.positions.len(), 2);
    // Vertices that no face uses are no points of a cloud.
    assert_eq!(load("obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 9 9 9\nf 1 2 3\n").parts[0].mesh.positions.len(), 3);
}

/// A quadrangle of 5 mm at the coordinates of a map, in every format that holds it.
#[test]
fn large_coordinates_are_kept_about_an_origin() {
    let at = |x: f64, y: f64| [443_211.0 + x, 5_412_345.0 + y, 7.25];
    let corners = [at(0.0, 0.0), at(0.005, 0.0), at(0.005, 0.005), at(0.0, 0.005)];
    let lines = |before: &str| corners.map(|[x, y, z]| format!("{before}{x} {y} {z}\n")).concat();
    let obj = format!("{}f 1 2 3 4\n", lines("v "));
    let off = format!("OFF\n4 1 4\n{}4 0 1 2 3\n", lines(""));
    let text = square("", &lines(""), "3 0 1 2\n3 0 2 3\n").replace("float", "double");
    let loops = [[0, 1, 2], [0, 2, 3]].map(|t| {
        let corners = t.map(|i| format!("vertex {} {} {}\n", corners[i][0], corners[i][1], corners[i][2])).concat();
        format!("facet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\n")
    });
    let stl = format!("solid s\n{}endsolid\n", loops.concat());
    let gltf = r#"{"asset":{"version":"2.0"},"nodes":[{"mesh":0,"translation":[443211,5412345,7.25],"scale":[0.005,0.005,1]}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}],"bufferViews":[{"buffer":0,"byteLength":36}],
        "buffers":[{"byteLength":36,"uri":"data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]}"#;
    for (extension, text, wanted) in [
        ("obj", &*obj, 2.5e-5),
        ("off", &off, 2.5e-5),
        ("ply", &text, 2.5e-5),
        ("stl", &stl, 2.5e-5),
        ("gltf", gltf, 1.25e-5),
    ] {
        let kept = load_as(extension, text.as_bytes(), true).unwrap();
        assert!((kept.origin - DVec3::new(443_211.0, 5_412_345.0, 7.0)).length() < 2.0, "{extension}: {}", kept.origin);
        assert!(kept.warnings.is_empty());
        let mesh = kept.merged().unwrap();
        assert!((mesh.area() / wanted - 1.0).abs() < 1e-3, "{extension}: {}", mesh.area());
        let rounded = load(extension, text);
        assert!(rounded.origin == DVec3::ZERO && rounded.warnings[0].contains("precision"), "{:?}", rounded.warnings);
        assert!((rounded.parts[0].mesh.positions[0][0] - 443_211.0).abs() < 0.1);
    }
    // Somewhere near the origin nothing is moved and nothing said.
    let near = load_as("obj", b"v 3.1 2.7 20\nv 3.2 2.7 20\nv 3.1 2.8 20\nf 1 2 3\n", true).unwrap();
    assert!(near.origin == DVec3::ZERO && near.warnings.is_empty());
}

fn stl_bytes(mesh: &TriMesh) -> Vec<u8> {
    let mut bytes = Vec::new();
    stl::write(mesh, &mut bytes).unwrap();
    bytes
}

#[test]
fn stl_is_read_in_both_forms_and_welded() {
    let mesh = wave();
    let mut bytes = stl_bytes(&mesh);
    // Binary files that begin as texts do are as common as others.
    bytes[..5].copy_from_slice(b"solid");
    bytes[84 + 48] = 0x1f;
    let loaded = load_as("stl", &bytes, false).unwrap();
    assert!(loaded.warnings.is_empty() && loaded.dropped[0].contains("1 triangles"), "{:?}", loaded.dropped);
    let found = loaded.merged().unwrap();
    assert_eq!((found.positions.len(), found.indices.len()), (mesh.positions.len(), mesh.indices.len()));
    assert!((found.area() - mesh.area()).abs() < 1e-6);
    let cut = load_as("stl", &bytes[..bytes.len() - 1], false).unwrap_err().to_string();
    assert!(cut.contains("solid") || cut.contains("too few") || cut.contains("no word"), "{cut}");
    bytes[0] = b'S' + 1;
    assert!(load_as("stl", &bytes[..bytes.len() - 1], false).unwrap_err().to_string().contains("too few"));
    bytes.push(0);
    assert!(load_as("stl", &bytes, false).unwrap().warnings[0].contains("1 bytes after"));

    let facet = |a: &str, b: &str, c: &str| {
        format!(
            " facet normal 0 0 1\r\n  outer loop\r\n   vertex {a}\r\n   vertex {b}\r\n   VERTEX {c}\r\n  endloop\r\n endfacet\r\n"
        )
    };
    let text = format!(
        "solid a b\r\n{}{}endsolid a b\r\n",
        facet("0 0 0", "1 0 0", "1 1 0"),
        facet("-0 0 0", "1e0 1 0", "0 1 0")
    );
    let loaded = load("stl", &text);
    assert_eq!((loaded.parts[0].name.as_str(), loaded.parts[0].mesh.positions.len()), ("a b", 4));
    assert_eq!(area(loaded), 1.0);
    assert!(refusal("stl", &text.replace("1 1 0", "1 1,5 0")).contains("line 6"));
    assert!(
        refusal("stl", &text[..text.len() / 2]).contains("truncated")
            || refusal("stl", &text[..text.len() / 2]).contains("line")
    );
    assert!(refusal("stl", "solid\nendsolid\n").contains("without facets"));
}

#[test]
fn off_and_its_relatives_are_read() {
    let faces = "# a comment\n3 0 1 2\n3 0 2 3 # another\n";
    let plain = format!("OFF\n4 2 0\n\n{POINTS}{faces}");
    let loaded = load("off", &plain);
    assert!(loaded.warnings.is_empty() && loaded.dropped.is_empty());
    assert_eq!(area(loaded), 1.0);
    // Told by its first word; the counts may stand there too, or the word be missing.
    assert_eq!(area(load("txt", &plain)), 1.0);
    assert_eq!(area(load("off", &plain.replace("OFF\n", "OFF "))), 1.0);
    assert_eq!(area(load("off", &plain.replace("OFF\n", ""))), 1.0);
    let coloured =
        load("off", "COFF\n3 1 0\n0 0 0 255 0 0 255\n1 0 0 0 255 0 255\n0 1 0 0 0 255 255\n3 0 1 2 0.5 0.5 0.5\n");
    assert_eq!(coloured.parts[0].mesh.colors.as_ref().unwrap()[1], [0.0, 1.0, 0.0]);
    assert!(coloured.dropped[0].contains("colours of 1 faces") && coloured.warnings.is_empty(), "{coloured:?}");
    let normals = load("off", "NOFF\n3 1 0\n0 0 0 0 0 1\n1 0 0 0 0 1\n0 1 0 0 0 1\n3 0 1 2\n");
    assert_eq!(normals.parts[0].mesh.normals.as_ref().unwrap()[2], [0.0, 0.0, 1.0]);
    let more = load("off", &format!("{plain}3 0 1 3\n"));
    assert!(more.warnings[0].contains("1 lines after the last face"), "{:?}", more.warnings);
    for (text, expected) in [
        (plain.replace("3 0 2 3", "3 0 2 4"), "line 10: a face uses vertex \"4\", there are 4"),
        (plain.replace("1 1 0", "1 x 0"), "line 6: \"x\" is not a number"),
        (plain.replace("4 2 0", "4 9 0"), "ends after 2 of 9 faces"),
        (plain.replace("4 2 0", "4000000000 2 0"), "do not fit"),
        (plain.replace("OFF\n", "OFF BINARY\n"), "binary OFF"),
        (plain.replace("OFF\n", "4OFF\n"), "another dimension"),
    ] {
        assert!(refusal("off", &text).contains(expected), "{}", refusal("off", &text));
    }
}
