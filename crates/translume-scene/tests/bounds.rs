//! Scene files that are small and stand for much, files that scenes name and that are none, and the meaning of what was once read
//! wrongly without a word. Each has a healthy twin beside it.

mod common;

use common::{Folder, check, mitsuba, mitsuba_error, xml};
use translume_bxdf::Rgb;
use translume_scene::emitter::Emitter;
use translume_scene::glam::{DAffine3, DVec3};
use translume_scene::material::Model;
use translume_scene::medium::Volume;
use translume_scene::texture::{Texture, Wrap};
use translume_scene::{Geometry, Scene};

const CAMERA_AND_LIGHT: &str = r#"<sensor type="perspective"/><emitter type="constant"/>"#;

fn said<'a>(scene: &'a Scene, word: &str) -> Option<&'a String> {
    scene.warnings.iter().find(|w| w.contains(word))
}

#[test]
fn values_that_double_are_refused() {
    let double = |n: usize| -> String {
        let line = |i: usize| format!(r#"<default name="a{:02}" value="$a{:02}$a{:02}"/>"#, i + 1, i, i);
        format!(r#"<default name="a00" value="7"/>{}"#, (0..n).map(line).collect::<String>())
    };
    let error = mitsuba_error(&double(40));
    assert!(error.contains("too long a value"), "{error}");
    // Many short ones from a long one, too.
    let error = mitsuba_error(&format!("{}{}", double(19), r#"<default name="b" value="$a19"/>"#.repeat(300)));
    assert!(error.contains("too long a value"), "{error}");
    let scene = mitsuba(&format!(
        r#"{}<shape type="sphere"><float name="radius" value="$a03"/></shape>{CAMERA_AND_LIGHT}"#,
        double(3)
    ));
    assert!(matches!(scene.shapes[0].geometry, Geometry::Sphere { radius: 77_777_777.0, .. }));
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
}

#[test]
fn includes_of_includes_are_bounded() {
    let folder = Folder::new();
    let twice = |name: String| format!(r#"<include filename="{name}"/>"#).repeat(2);
    for level in 0..30 {
        folder.write(&format!("m{level}.xml"), xml("3.0.0", &twice(format!("m{}.xml", level + 1))));
        folder.write(&format!("p{level}.pbrt"), format!("Include \"p{0}.pbrt\"\n", level + 1).repeat(2));
    }
    folder.write("m30.xml", xml("3.0.0", r#"<shape type="sphere"/>"#));
    folder.write("p30.pbrt", "");
    for (name, text) in
        [("s.xml", xml("3.0.0", &twice("m0.xml".into()))), ("s.pbrt", "Include \"p0.pbrt\"\n".repeat(2))]
    {
        let error = folder.load(name, &text).unwrap_err().to_string();
        assert!(error.contains("too many"), "{error}");
    }
    let scene = folder.load("t.xml", &xml("3.0.0", &format!("{}{CAMERA_AND_LIGHT}", twice("m26.xml".into())))).unwrap();
    assert_eq!((scene.shapes.len(), scene.warnings.len()), (32, 0));
}

/// A scene may name any file: what is in it is not for those who read the message.
#[test]
fn files_that_are_something_else_are_not_quoted() {
    let folder = Folder::new();
    folder.write("secret", "hunter2:x:0:0:root\n");
    for (name, text) in [
        ("a.xml", xml("3.0.0", r#"<bsdf type="diffuse"><spectrum name="reflectance" filename="secret"/></bsdf>"#)),
        ("b.xml", xml("3.0.0", r#"<include filename="secret"/>"#)),
        ("c.xml", xml("3.0.0", r#"<shape type="obj"><string name="filename" value="secret"/></shape>"#)),
        ("a.pbrt", "Include \"secret\"\n".to_owned()),
    ] {
        let error = folder.load(name, &text).unwrap_err().to_string();
        assert!(!error.contains("hunter2") && error.contains("secret"), "{name}: {error}");
    }
    folder.write("good.spd", "# nm\n400 0.5\n\n700 0.5\n");
    let text = r#"<shape type="sphere"><bsdf type="diffuse"><spectrum name="reflectance" filename="good.spd"/></bsdf></shape>"#;
    let scene = folder.load("d.xml", &xml("3.0.0", &format!("{text}{CAMERA_AND_LIGHT}"))).unwrap();
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
}

#[test]
fn textures_that_refer_to_each_other_are_taken_once() {
    let mut text = r#"<texture type="checkerboard" id="t0"><float name="color0" value="0.25"/><float name="color1" value="0.75"/></texture>"#.to_owned();
    for i in 1..60 {
        let of = format!("t{}", i - 1);
        text += &format!(
            r#"<texture type="checkerboard" id="t{i}"><ref name="color0" id="{of}"/><ref name="color1" id="{of}"/></texture>"#
        );
    }
    text += r#"<texture type="scale" id="s"><float name="scale" value="0.5"/><ref id="t59"/></texture>
        <shape type="sphere"><bsdf type="diffuse"><ref name="reflectance" id="s"/></bsdf></shape>"#;
    let scene = mitsuba(&text);
    let Model::Diffuse { reflectance } = scene.materials[scene.shapes[0].material.0].model else { panic!() };
    assert!((scene.mean(reflectance) - Rgb::splat(0.25)).abs().max_element() < 1e-6);
    assert!(scene.textures.len() < 200, "{}", scene.textures.len());
    let mut pbrt = "Texture \"t0\" \"spectrum\" \"checkerboard\"\n".to_owned();
    (1..300).for_each(|i| {
        let of = format!("t{}", i - 1);
        pbrt += &format!(
            "Texture \"t{i}\" \"spectrum\" \"checkerboard\" \"texture tex1\" \"{of}\" \"texture tex2\" \"{of}\"\n"
        );
    });
    let error = Folder::new().load("s.pbrt", &pbrt).unwrap_err().to_string();
    assert!(error.contains("nest too deep"), "{error}");
}

#[test]
fn collections_of_collections_are_bounded() {
    let levels = |n: usize, leaf: &str| {
        let mut text = format!(r#"<shape type="shapegroup" id="g0"><shape type="merge" id="m0">{leaf}</shape>"#);
        for i in 1..n {
            let of = i - 1;
            text += &format!(r#"<shape type="merge" id="m{i}"><ref id="m{of}"/><ref id="m{of}"/></shape>"#);
        }
        text + "</shape>"
    };
    for leaf in [r#"<shape type="sphere"/>"#, ""] {
        let error = mitsuba_error(&levels(40, leaf));
        assert!(error.contains("too many shapes"), "{error}");
    }
    // One, two and four: what stands in the group.
    let scene = mitsuba(&levels(3, r#"<shape type="sphere"/>"#));
    assert_eq!(scene.groups[0].shapes.len(), 7);
}

#[test]
fn area_lights_by_reference() {
    let scene = mitsuba(&format!(
        r#"<emitter type="area" id="lamp"><rgb name="radiance" value="1 2 3"/></emitter>
           <shape type="rectangle"><ref id="lamp"/></shape><shape type="sphere"><ref id="lamp"/></shape>{CAMERA_AND_LIGHT}"#
    ));
    for shape in &scene.shapes {
        assert_eq!(scene.constant(shape.radiance.unwrap()), Some(Rgb::new(1.0, 2.0, 3.0)));
    }
    assert!(scene.warnings.is_empty() && scene.emitters.len() == 1, "{:?}", scene.warnings);
    let scene = mitsuba(r#"<emitter type="area" id="lamp"/><shape type="sphere"/>"#);
    assert!(said(&scene, "does not shine").is_some(), "{:?}", scene.warnings);
}

#[test]
fn colours_of_ply_files() {
    let folder = Folder::new();
    let ply = |properties: &str, values: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n{properties}\
             element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0 {values}\n1 0 0 {values}\n0 1 0 {values}\n3 0 1 2\n"
        )
    };
    let read = |text: String| {
        folder.write("m.ply", text);
        let scene = format!(
            r#"<shape type="ply"><string name="filename" value="m.ply"/><bsdf type="twosided"><bsdf type="diffuse">
               <texture type="mesh_attribute" name="reflectance"><string name="name" value="vertex_color"/></texture></bsdf></bsdf></shape>{CAMERA_AND_LIGHT}"#
        );
        let scene = folder.load("s.xml", &xml("3.0.0", &scene)).unwrap();
        check(&scene);
        scene
    };
    for names in [["color_0", "color_1", "color_2"], ["r", "g", "b"], ["red", "green", "blue"]] {
        let properties: String = names.iter().map(|n| format!("property float {n}\n")).collect();
        let scene = read(ply(&properties, "0.2 0.5 0.8"));
        let Geometry::Mesh(mesh) = &scene.shapes[0].geometry else { panic!() };
        assert_eq!(mesh.colors.as_deref(), Some(&[[0.2, 0.5, 0.8]; 3][..]));
        assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    }
    assert!(said(&read(ply("", "")), "no attribute").is_some());
}

/// Values of Mitsuba 3.9: attributes of vertices and faces by their names, one number or three.
#[test]
fn attributes_of_ply_files() {
    let folder = Folder::new();
    let head = "element vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty float heat_0\n";
    let faces = "element face 2\nproperty list uchar int vertex_indices\nproperty float color_0\nproperty float color_1\nproperty float color_2\n";
    let corners = [[0.0_f32, 0.0, 0.0, 0.1], [1.0, 0.0, 0.0, 0.2], [1.0, 1.0, 0.0, 0.3], [0.0, 1.0, 0.0, 0.4]];
    let sides = [([0_i32, 1, 2], [0.2_f32, 0.5, 0.8]), ([0, 2, 3], [0.8, 0.5, 0.2])];
    let mut text = format!("ply\nformat ascii 1.0\n{head}{faces}end_header\n");
    let mut binary = format!("ply\nformat binary_big_endian 1.0\n{head}{faces}end_header\n").into_bytes();
    for c in &corners {
        text += &format!("{} {} {} {}\n", c[0], c[1], c[2], c[3]);
        binary.extend(c.iter().flat_map(|v| v.to_be_bytes()));
    }
    for (corner, color) in &sides {
        text += &format!("3 {} {} {} {} {} {}\n", corner[0], corner[1], corner[2], color[0], color[1], color[2]);
        binary.push(3);
        binary.extend(corner.iter().flat_map(|v| v.to_be_bytes()));
        binary.extend(color.iter().flat_map(|v| v.to_be_bytes()));
    }
    for bytes in [text.as_bytes(), &binary] {
        folder.write("m.ply", bytes);
        let colors = |name: &str| {
            let texture = format!(
                r#"<texture type="mesh_attribute" name="reflectance"><string name="name" value="{name}"/></texture>"#
            );
            let shape = format!(
                r#"<shape type="ply"><string name="filename" value="m.ply"/><bsdf type="diffuse">{texture}</bsdf></shape>{CAMERA_AND_LIGHT}"#
            );
            let scene = folder.load("s.xml", &xml("3.0.0", &shape)).unwrap();
            check(&scene);
            let Geometry::Mesh(mesh) = &scene.shapes[0].geometry else { panic!() };
            (mesh.clone(), scene.warnings)
        };
        let (mesh, warnings) = colors("face_color");
        let expected: Vec<[f32; 3]> = sides.iter().flat_map(|s| [s.1; 3]).collect();
        assert_eq!((mesh.colors.as_ref(), warnings.len()), (Some(&expected), 0));
        assert_eq!(mesh.corners(1), [[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]].map(glam_vec));
        assert_eq!(colors("vertex_heat").0.colors.as_ref().unwrap()[2], [0.3; 3]);
        assert!(colors("vertex_color").1.iter().any(|w| w.contains("no attribute")));
    }
}

fn glam_vec(v: [f32; 3]) -> translume_scene::glam::Vec3 {
    v.into()
}

fn grid(folder: &Folder, name: &str, values: &[f32]) {
    let corners = [DVec3::ZERO, DVec3::ONE];
    folder.write(name, translume_scene::grid_bytes([values.len(), 1, 1], 1, corners, values));
}

#[test]
fn where_media_are() {
    let folder = Folder::new();
    grid(&folder, "g.vol", &[0.5, 1.0]);
    let read = |version: &str, medium: &str| {
        let text = format!(r#"<shape type="cube"><medium name="interior" {medium}</medium></shape>{CAMERA_AND_LIGHT}"#);
        let scene = folder.load("s.xml", &xml(version, &text)).unwrap();
        check(&scene);
        (scene.media[0].clone(), scene.warnings)
    };
    let box_of = |volume: &str| read("3.0.0", &format!(r#"type="heterogeneous">{volume}"#)).0.domain;
    let placed = DAffine3::from_scale(DVec3::splat(2.0));
    let to_world = r#"<transform name="to_world"><scale value="2"/></transform>"#;
    assert_eq!(box_of(r#"<float name="sigma_t" value="1"/>"#), Some(DAffine3::IDENTITY));
    assert_eq!(box_of(&format!(r#"<volume name="sigma_t" type="constvolume">{to_world}</volume>"#)), Some(placed));
    let of_grid = |more: &str| format!(r#"type="gridvolume"><string name="filename" value="g.vol"/>{more}</volume>"#);
    assert_eq!(box_of(&format!(r#"<volume name="sigma_t" {}"#, of_grid(to_world))), Some(placed));
    // A homogeneous medium fills its shape, and its albedo goes on beyond the grid's box.
    let (fog, warnings) = read("3.0.0", &format!(r#"type="homogeneous"><volume name="albedo" {}"#, of_grid("")));
    assert!(fog.domain.is_none() && warnings.is_empty(), "{warnings:?}");
    let wrap_of = |medium: &str| match read("3.0.0", medium).0.albedo {
        Volume::Grid { wrap, .. } => wrap,
        Volume::Constant(_) => panic!("constant"),
    };
    for (mode, wrap) in [("", Wrap::Clamp), ("clamp", Wrap::Clamp), ("repeat", Wrap::Repeat), ("mirror", Wrap::Mirror)]
    {
        let more =
            if mode.is_empty() { String::new() } else { format!(r#"<string name="wrap_mode" value="{mode}"/>"#) };
        assert_eq!(wrap_of(&format!(r#"type="homogeneous"><volume name="albedo" {}"#, of_grid(&more))), wrap);
    }
    // Mitsuba 0.6: a constant density has no bounds.
    assert!(
        read(
            "0.6.0",
            r#"type="heterogeneous"><volume name="density" type="constvolume"><float name="value" value="1"/></volume>"#
        )
        .0
        .domain
        .is_none()
    );
    let (smoke, warnings) = read("3.0.0", &format!(r#"type="homogeneous"><volume name="sigma_t" {}"#, of_grid("")));
    assert!(smoke.domain.is_some() && warnings.iter().any(|w| w.contains("heterogeneous")), "{warnings:?}");
    let error = folder.load("s.xml", &xml("3.0.0", r#"<shape type="cube"><medium name="interior" type="homogeneous"><float name="sigma_t" value="1e30"/><float name="scale" value="1e30"/></medium></shape>"#));
    assert!(error.unwrap_err().to_string().contains("too large"));
}

#[test]
fn projectors_have_mitsubas_scale() {
    let scene = mitsuba(
        r#"<emitter type="projector"><rgb name="irradiance" value="1 2 4"/><float name="scale" value="3"/></emitter>"#,
    );
    let Emitter::Projector { scale, .. } = scene.emitters[0] else { panic!() };
    assert!((scale - 3.0 * std::f32::consts::PI).abs() < 1e-5);
}

/// Numbers of Mitsuba 3.9: `eval` gives color0 at (0.2, 0.2), `eval_1` color1.
#[test]
fn checkerboards_of_numbers() {
    let first = |version: &str, bsdf: &str| {
        let text = format!(r#"<shape type="sphere">{bsdf}</shape>{CAMERA_AND_LIGHT}"#);
        let scene = Folder::new().load("s.xml", &xml(version, &text)).unwrap();
        let id = match scene.materials[scene.shapes[0].material.0].model {
            Model::Diffuse { reflectance } => reflectance,
            Model::RoughConductor { roughness, .. } => roughness.alpha_u,
            ref other => panic!("{other:?}"),
        };
        let Texture::Checkerboard(board) = &scene.textures[id.0] else { panic!() };
        scene.constant(board.color0).unwrap().x
    };
    let board = |name: &str| {
        format!(
            r#"<texture type="checkerboard" name="{name}"><float name="color0" value="0.1"/><float name="color1" value="0.3"/></texture>"#
        )
    };
    let diffuse = format!(r#"<bsdf type="diffuse">{}</bsdf>"#, board("reflectance"));
    let rough = format!(r#"<bsdf type="roughconductor">{}</bsdf>"#, board("alpha"));
    assert_eq!([first("3.0.0", &diffuse), first("3.0.0", &rough), first("0.6.0", &rough)], [0.1, 0.3, 0.1]);
}
