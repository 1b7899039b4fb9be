//! Mitsuba XML: what is read, held to numbers of Mitsuba 3.9 (`scalar_rgb`).

mod common;

use common::{Folder, check, mitsuba, mitsuba_error, xml};
use translume_bxdf::{Distribution, Phase, Rgb};
use translume_scene::emitter::Emitter;
use translume_scene::glam::{DVec2, DVec3};
use translume_scene::material::{Material, Model};
use translume_scene::medium::{Samples, Volume};
use translume_scene::sensor::{PixelFilter, Projection};
use translume_scene::texture::Texture;
use translume_scene::{Geometry, LoadOptions, MediumId, Scene, TextureId, load};

const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n";

fn color(scene: &Scene, id: TextureId) -> Rgb {
    scene.constant(id).expect("a constant")
}

fn bsdf(version: &str, text: &str) -> (Scene, Model) {
    let inside = format!("<shape type=\"sphere\">{text}</shape>");
    let scene = Folder::new().load("scene.xml", &xml(version, &inside)).unwrap_or_else(|e| panic!("{text}: {e}"));
    check(&scene);
    let model = scene.materials[scene.shapes[0].material.0].model.clone();
    (scene, model)
}

/// One scene in the words of two dialects.
#[test]
fn dialects_say_the_same() {
    let new = r#"
        <integrator type="path"><integer name="max_depth" value="9"/><boolean name="hide_emitters" value="true"/></integrator>
        <sensor type="perspective">
            <string name="fov_axis" value="larger"/><float name="fov" value="40"/><float name="near_clip" value="2"/>
            <transform name="to_world"><lookat origin="1, 2, 3" target="0 0 0" up="0, 1, 0"/></transform>
            <film type="hdrfilm"><integer name="width" value="40"/><integer name="height" value="30"/><rfilter type="tent"/></film>
            <sampler type="independent"><integer name="sample_count" value="16"/></sampler>
        </sensor>
        <bsdf type="roughplastic" id="m"><float name="int_ior" value="1.6"/><rgb name="diffuse_reflectance" value="0.1 0.2 0.3"/></bsdf>
        <shape type="sphere"><ref id="m"/><boolean name="flip_normals" value="true"/></shape>
        <emitter type="constant"/>"#;
    let old = new
        .replace("max_depth", "maxDepth")
        .replace("hide_emitters", "hideEmitters")
        .replace("fov_axis", "fovAxis")
        .replace("near_clip", "nearClip")
        .replace("to_world", "toWorld")
        .replace("<lookat ", "<lookAt ")
        .replace("sample_count", "sampleCount")
        .replace("int_ior", "intIOR")
        .replace("diffuse_reflectance", "diffuseReflectance")
        .replace("flip_normals", "flipNormals");
    let folder = Folder::new();
    let [a, b] = [("3.0.0", new), ("0.6.0", &old)].map(|(v, text)| folder.load("scene.xml", &xml(v, text)).unwrap());
    assert_eq!(format!("{a:?}"), format!("{b:?}"));
    assert!(a.warnings.is_empty(), "{:?}", a.warnings);
    assert_eq!((a.integrator.max_depth, a.integrator.hide_emitters), (Some(9), true));
    assert_eq!(a.sensors[0].film.filter, PixelFilter::Tent { radius: 1.0 });
    assert!(a.shapes[0].flip_normals);
}

#[test]
fn defaults_of_bsdfs() {
    let eta = |text: &str| match bsdf("3.0.0", text).1 {
        Model::Dielectric(d) | Model::ThinDielectric(d) | Model::RoughDielectric { dielectric: d, .. } => d.eta,
        Model::Plastic(p) | Model::RoughPlastic { plastic: p, .. } => p.eta,
        other => panic!("{other:?}"),
    };
    for (plugin, expected) in [
        ("dielectric", 1.50418),
        ("thindielectric", 1.50418),
        ("roughdielectric", 1.50418),
        ("plastic", 1.48959),
        ("roughplastic", 1.48959),
    ] {
        let found = eta(&format!("<bsdf type=\"{plugin}\"/>"));
        assert!((found - expected).abs() < 1e-5, "{plugin}: {found}");
    }
    assert!(
        (eta("<bsdf type=\"dielectric\"><string name=\"int_ior\" value=\"water\"/></bsdf>") - 1.33263).abs() < 1e-5
    );
    let Model::RoughPlastic { distribution, alpha, plastic } = bsdf("3.0.0", "<bsdf type=\"roughplastic\"/>").1 else {
        panic!("another model")
    };
    assert_eq!((distribution, alpha, plastic.nonlinear), (Distribution::Beckmann, 0.1, false));
    let (scene, model) = bsdf("3.0.0", "<bsdf type=\"roughconductor\"/>");
    let Model::RoughConductor { conductor, roughness } = model else { panic!("{model:?}") };
    assert_eq!((color(&scene, conductor.eta), color(&scene, conductor.k)), (Rgb::ZERO, Rgb::ONE));
    assert_eq!(color(&scene, roughness.alpha_u), Rgb::splat(0.1));
}

#[test]
fn metals() {
    let eta_k = |version: &str, inside: &str| {
        let (scene, model) = bsdf(version, &format!("<bsdf type=\"conductor\">{inside}</bsdf>"));
        let Model::Conductor(c) = model else { panic!("{model:?}") };
        (color(&scene, c.eta), color(&scene, c.k))
    };
    let (eta, k) = eta_k("3.0.0", "<string name=\"material\" value=\"Au\"/>");
    assert!((eta - Rgb::new(0.143036, 0.375307, 1.44205)).length() < 1e-4, "{eta}");
    assert!((k - Rgb::new(3.983, 2.38556, 1.60336)).length() < 1e-4, "{k}");
    assert_eq!(eta_k("0.6.0", ""), eta_k("0.6.0", "<string name=\"material\" value=\"Cu\"/>"));
    let (eta, _) =
        eta_k("3.0.0", "<spectrum name=\"eta\" value=\"400:1.5, 700:1.2\"/><spectrum name=\"k\" value=\"2\"/>");
    assert!((eta - Rgb::new(1.25177, 1.3567, 1.45155)).abs().max_element() < 3e-3, "{eta}");
    let outside =
        "<float name=\"extEta\" value=\"2\"/><rgb name=\"eta\" value=\"1 2 3\"/><rgb name=\"k\" value=\"4\"/>";
    assert_eq!(eta_k("0.6.0", outside), (Rgb::new(0.5, 1.0, 1.5), Rgb::splat(2.0)));
}

#[test]
fn bsdfs_nest() {
    let (scene, model) = bsdf(
        "3.0.0",
        r#"<bsdf type="mask"><float name="opacity" value="0.25"/>
             <bsdf type="twosided"><bsdf type="blendbsdf"><float name="weight" value="0.3"/>
               <bsdf type="diffuse"/><bsdf type="principled"><float name="metallic" value="1"/></bsdf>
             </bsdf></bsdf></bsdf>"#,
    );
    let Model::Mask { opacity, nested } = model else { panic!("{model:?}") };
    assert_eq!(color(&scene, opacity), Rgb::splat(0.25));
    let Model::TwoSided { front, back } = scene.materials[nested.0].model else { panic!("not two-sided") };
    assert_eq!(front, back);
    let Model::Blend { first, second, .. } = scene.materials[front.0].model else { panic!("not a blend") };
    assert!(matches!(scene.materials[first.0].model, Model::Diffuse { .. }));
    assert!(matches!(scene.materials[second.0].model, Model::Principled(_)));
}

#[test]
fn mixtures_of_the_old_dialect_keep_their_weights() {
    let (scene, model) = bsdf(
        "0.6.0",
        r#"<bsdf type="mixturebsdf"><string name="weights" value="0.2, 0.3"/>
             <bsdf type="diffuse"><rgb name="reflectance" value="1 0 0"/></bsdf>
             <bsdf type="diffuse"><rgb name="reflectance" value="0 1 0"/></bsdf></bsdf>"#,
    );
    fn mean(scene: &Scene, model: &Model) -> Rgb {
        match model {
            Model::Diffuse { reflectance } => color(scene, *reflectance),
            Model::Blend { weight, first, second } => {
                let [a, b] = [first, second].map(|id| mean(scene, &scene.materials[id.0].model));
                a.lerp(b, color(scene, *weight).x)
            }
            other => panic!("{other:?}"),
        }
    }
    assert!((mean(&scene, &model) - Rgb::new(0.2, 0.3, 0.0)).length() < 1e-6);
}

#[test]
fn colours_and_spectra() {
    let radiance = |text: &str| {
        let scene = mitsuba(&format!("<shape type=\"sphere\"><emitter type=\"area\">{text}</emitter></shape>"));
        color(&scene, scene.shapes[0].radiance.expect("shines"))
    };
    let near = |a: Rgb, b: [f32; 3], e: f32| assert!((a - Rgb::from(b)).abs().max_element() < e, "{a} {b:?}");
    near(radiance("<spectrum name=\"radiance\" value=\"2\"/>"), [2.40959, 1.89658, 1.81783], 2e-3);
    near(radiance("<float name=\"radiance\" value=\"2\"/>"), [2.0; 3], 1e-6);
    near(radiance("<rgb name=\"radiance\" value=\"2\"/>"), [2.0; 3], 1e-6);
    near(radiance(""), [1.0; 3], 1e-6);
    near(radiance("<srgb name=\"radiance\" value=\"#ff8000\"/>"), [1.0, 0.21586, 0.0], 1e-4);
    let reflectance = |text: &str| {
        let (scene, model) = bsdf("3.0.0", &format!("<bsdf type=\"diffuse\">{text}</bsdf>"));
        let Model::Diffuse { reflectance } = model else { panic!("{model:?}") };
        (color(&scene, reflectance), scene.warnings)
    };
    near(reflectance("<spectrum name=\"reflectance\" value=\"0.3\"/>").0, [0.3; 3], 1e-6);
    let (clipped, warnings) = reflectance("<rgb name=\"reflectance\" value=\"1.5 0.5 0\"/>");
    near(clipped, [1.0, 0.5, 0.0], 1e-6);
    assert!(warnings[0].contains("above 1"), "{warnings:?}");
}

/// x_fov in degrees as Mitsuba works it out.
#[test]
fn fields_of_view() {
    for (text, portrait, landscape) in [
        ("", 26.99147, 38.18484),
        ("<string name=\"fov_axis\" value=\"y\"/><float name=\"fov\" value=\"40\"/>", 27.27808, 51.77401),
        ("<string name=\"focal_length\" value=\"50mm\"/>", 26.99147, 38.18484),
        ("<string name=\"focal_length\" value=\"35\"/>", 37.84929, 52.62254),
        ("<string name=\"fov_axis\" value=\"diagonal\"/><float name=\"fov\" value=\"40\"/>", 22.82852, 32.4686),
        ("<string name=\"fov_axis\" value=\"larger\"/><float name=\"fov\" value=\"40\"/>", 27.27808, 40.0),
        ("<string name=\"fov_axis\" value=\"smaller\"/><float name=\"fov\" value=\"40\"/>", 40.0, 51.77401),
    ] {
        for (size, expected) in [([200, 300], portrait), ([768, 576], landscape)] {
            let film = format!(
                "<film type=\"hdrfilm\"><integer name=\"width\" value=\"{}\"/><integer name=\"height\" value=\"{}\"/></film>",
                size[0], size[1]
            );
            let scene = mitsuba(&format!("<sensor type=\"perspective\">{text}{film}</sensor>"));
            let Projection::Perspective(p) = scene.sensors[0].projection else { panic!("no perspective") };
            let found = p.fov_x(size[0], size[1]).to_degrees();
            assert!((found - expected).abs() < 2e-4, "{text} {size:?}: {found} for {expected}");
        }
    }
}

#[test]
fn transforms_apply_in_order_and_lookat_looks() {
    let scene = mitsuba(
        r#"<sensor type="perspective"><transform name="to_world"><lookat origin="1,2,3" target="0,0,0" up="0,1,0"/></transform></sensor>
           <shape type="sphere"><transform name="to_world"><scale value="2"/><rotate z="1" angle="90"/><translate x="5"/></transform></shape>"#,
    );
    let m = scene.sensors[0].world_from_camera;
    assert!((m.matrix3.x_axis - DVec3::new(-0.948683, 0.0, 0.316228)).length() < 1e-5);
    assert!((m.matrix3.y_axis - DVec3::new(-0.169031, 0.845154, -0.507093)).length() < 1e-5);
    assert!((m.matrix3.z_axis - DVec3::new(-0.267261, -0.534522, -0.801784)).length() < 1e-5);
    let p = scene.shapes[0].world_from_object.transform_point3(DVec3::X);
    assert!((p - DVec3::new(5.0, 2.0, 0.0)).length() < 1e-12, "{p}");
}

/// Which way normals point under a mirror is Mitsuba's way.
#[test]
fn normals_under_mirrors() {
    let folder = Folder::new();
    let bare = folder.write("bare.obj", TRIANGLE);
    let dressed = folder.write("dressed.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\n");
    let flipped = |shape: String| {
        let mirror = "<transform name=\"to_world\"><scale x=\"-1\"/></transform>";
        mitsuba(&format!("<shape {shape}{mirror}</shape>")).shapes[0].flip_normals
    };
    let obj = |path: &std::path::Path, more: &str| {
        format!("type=\"obj\"><string name=\"filename\" value=\"{}\"/>{more}", path.display())
    };
    assert!(flipped(obj(&bare, "")));
    assert!(!flipped(obj(&dressed, "")));
    assert!(flipped(obj(&dressed, "<boolean name=\"face_normals\" value=\"true\"/>")));
    assert!(flipped("type=\"sphere\">".to_owned()));
    assert!(!flipped("type=\"rectangle\">".to_owned()));
    assert!(!flipped("type=\"disk\">".to_owned()));
}

/// Texture coordinates of files and their place in a picture, as Mitsuba has them: OBJ is turned over, PLY is not.
#[test]
fn texture_coordinates() {
    let folder = Folder::new();
    let obj = folder.write("t.obj", TRIANGLE);
    let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty float u\nproperty float v\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0 0.1 0.2\n1 0 0 0.3 0.4\n0 1 0 0.5 0.6\n3 0 1 2\n";
    let ply = folder.write("t.ply", ply);
    let in_board = |kind: &str, path: &std::path::Path, inside: &str| {
        let scene = mitsuba(&format!(
            "<shape type=\"{kind}\"><string name=\"filename\" value=\"{}\"/><bsdf type=\"diffuse\">\
             <texture type=\"checkerboard\" name=\"reflectance\">{inside}</texture></bsdf></shape>",
            path.display()
        ));
        let Some(Texture::Checkerboard(board)) = scene.textures.last() else { panic!("no board") };
        let Geometry::Mesh(mesh) = &scene.shapes[0].geometry else { panic!("no mesh") };
        let uv = DVec2::from(mesh.uvs.as_ref().expect("coordinates")[0].map(f64::from));
        board.board_from_uv.transform_point2(uv)
    };
    let near = |a: DVec2, b: DVec2| assert!((a - b).length() < 1e-6, "{a} {b}");
    near(in_board("obj", &obj, ""), DVec2::new(0.0, 1.0));
    near(in_board("ply", &ply, ""), DVec2::new(0.1, 0.2));
    let to_uv = "<transform name=\"to_uv\"><scale x=\"2\" y=\"3\"/><translate x=\"0.1\" y=\"0.2\"/></transform>";
    near(in_board("ply", &ply, to_uv), DVec2::new(0.3, 0.8));
    near(in_board("ply", &ply, "<float name=\"uscale\" value=\"8\"/>"), DVec2::new(0.8, 0.2));
}

#[test]
fn bitmaps_are_linear_unless_raw_and_shared() {
    let folder = Folder::new();
    let png = folder.path("t.png");
    translume_image::write_png8(&png, (2, 2), &[188; 12]).unwrap();
    let texture = |id: &str, more: &str| {
        format!(
            "<texture type=\"bitmap\" id=\"{id}\"><string name=\"filename\" value=\"{}\"/>{more}</texture>",
            png.display()
        )
    };
    let shape = |id: &str| {
        format!("<shape type=\"sphere\"><bsdf type=\"diffuse\"><ref name=\"reflectance\" id=\"{id}\"/></bsdf></shape>")
    };
    let texts = [
        texture("a", ""),
        texture("b", "<string name=\"wrap_mode\" value=\"clamp\"/>"),
        texture("c", "<boolean name=\"raw\" value=\"true\"/>"),
        shape("a"),
        shape("b"),
        shape("c"),
    ];
    let scene = mitsuba(&texts.concat());
    let bitmaps = scene.textures.iter().filter_map(|t| if let Texture::Bitmap(b) = t { Some(b) } else { None });
    let images: Vec<_> = bitmaps.map(|b| &b.image).collect();
    assert!(std::sync::Arc::ptr_eq(images[0], images[1]), "one file, one picture");
    let value = |i: usize| images[i].pixels.get_pixel(1, 1)[0];
    assert!((value(0) - 0.5029).abs() < 1e-3, "{}", value(0));
    assert!((value(2) - 188.0 / 255.0).abs() < 1e-6, "{}", value(2));
}

/// Colour under transparent parts of a picture counts: opacity is often a channel of its own.
#[test]
fn textures_are_not_multiplied_by_alpha() {
    let folder = Folder::new();
    let png = folder.path("leaf.png");
    image::RgbaImage::from_pixel(2, 2, image::Rgba([255, 255, 255, 0])).save(&png).unwrap();
    let scene = mitsuba(&format!(
        "<shape type=\"sphere\"><bsdf type=\"diffuse\"><texture type=\"bitmap\" name=\"reflectance\"><string name=\"filename\" value=\"{}\"/></texture></bsdf></shape>",
        png.display()
    ));
    let Some(Texture::Bitmap(bitmap)) = scene.textures.iter().find(|t| matches!(t, Texture::Bitmap(_))) else {
        panic!("no bitmap in {:?}", scene.textures)
    };
    assert_eq!(bitmap.image.pixels.get_pixel(0, 0).0[..3], [1.0, 1.0, 1.0]);
}

#[test]
fn cameras_may_share_a_film() {
    let camera = "<sensor type=\"perspective\"><ref id=\"f\"/></sensor>";
    let film = "<film type=\"hdrfilm\" id=\"f\"><rfilter type=\"tent\"/></film>";
    let scene = mitsuba(&format!("{film}{camera}{camera}"));
    assert!(scene.sensors.iter().all(|s| s.film.filter == PixelFilter::Tent { radius: 1.0 }), "{:?}", scene.sensors);
}

#[test]
fn instances_stay_instances() {
    let folder = Folder::new();
    let obj = folder.write("t.obj", TRIANGLE);
    let member = format!("<shape type=\"obj\"><string name=\"filename\" value=\"{}\"/></shape>", obj.display());
    let instance = |x: i32| {
        format!(
            "<shape type=\"instance\"><ref id=\"g\"/><transform name=\"to_world\"><translate x=\"{x}\"/></transform></shape>"
        )
    };
    let group = format!("<shape type=\"shapegroup\" id=\"g\">{member}{member}</shape>");
    let scene = mitsuba(&[group, instance(1), instance(2), instance(3)].concat());
    assert_eq!((scene.groups.len(), scene.instances.len(), scene.shapes.len()), (1, 3, 0));
    assert_eq!(scene.triangles(), (1, 6), "two uses of a file share its mesh");
    assert_eq!(scene.bounds().hi.x, 4.0);
    // A light has a place in the world: its group turns into shapes.
    let shining = member.replace("/></shape>", "/><emitter type=\"area\"/></shape>");
    let scene =
        mitsuba(&format!("<shape type=\"shapegroup\" id=\"g\">{shining}</shape>{}{}", instance(1), instance(2)));
    assert_eq!((scene.shapes.len(), scene.instances.len()), (2, 0));
    assert_eq!(scene.shapes[1].world_from_object.translation.x, 2.0);
}

#[test]
fn media() {
    let folder = Folder::new();
    let mut vol = b"VOL\x03".to_vec();
    vol.extend([1, 2, 2, 2, 1].iter().flat_map(|v: &i32| v.to_le_bytes()));
    vol.extend([-0.5_f32, -0.5, -0.5, 0.5, 0.5, 0.5].iter().flat_map(|v| v.to_le_bytes()));
    vol.extend([1.0_f32, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0].iter().flat_map(|v| v.to_le_bytes()));
    let vol = folder.write("smoke.vol", vol);
    let old = format!(
        r#"<medium type="heterogeneous" id="smoke"><volume name="density" type="gridvolume"><string name="filename" value="{}"/></volume>
             <volume name="albedo" type="constvolume"><rgb name="value" value="0.9"/></volume><float name="scale" value="100"/>
             <phase type="hg"><float name="g" value="0.5"/></phase></medium>
           <medium type="homogeneous" id="fog"><rgb name="sigmaA" value="1 1 1"/><rgb name="sigmaS" value="3 1 0"/></medium>
           <shape type="sphere"><ref name="interior" id="smoke"/><ref name="exterior" id="fog"/></shape>
           <sensor type="perspective"><ref id="fog"/></sensor>"#,
        vol.display()
    );
    let scene = folder.load("scene.xml", &xml("0.5.0", &old)).unwrap();
    check(&scene);
    let shape = &scene.shapes[0];
    assert!(matches!(scene.materials[shape.material.0].model, Model::Null), "index-matched");
    let smoke = &scene.media[shape.interior.unwrap().0];
    assert_eq!((smoke.phase, smoke.majorant()), (Phase::HenyeyGreenstein { g: 0.5 }, Rgb::splat(800.0)));
    let Volume::Grid { world_from_grid, samples, .. } = &smoke.sigma_t else { panic!("no grid") };
    assert_eq!((world_from_grid.translation, *samples), (DVec3::splat(-0.5), Samples::Corners));
    let fog = &scene.media[scene.sensors[0].medium.unwrap().0];
    let (Volume::Constant(sigma_t), Volume::Constant(albedo)) = (&fog.sigma_t, &fog.albedo) else { panic!("varies") };
    assert_eq!((*sigma_t, *albedo), (Rgb::new(4.0, 2.0, 1.0), Rgb::new(0.75, 0.5, 0.0)));
    assert_eq!(shape.exterior, Some(MediumId(1)));
}

#[test]
fn lights() {
    let scene = mitsuba(
        r#"<emitter type="point"><point name="position" x="1" y="2" z="3"/><rgb name="intensity" value="4"/></emitter>
           <emitter type="spot"><float name="cutoff_angle" value="40"/></emitter>
           <emitter type="directional"><vector name="direction" x="0" y="-2" z="0"/></emitter>
           <emitter type="projector"><texture name="irradiance" type="checkerboard"/><float name="fov" value="30"/></emitter>"#,
    );
    let Emitter::Point { position, intensity } = &scene.emitters[0] else { panic!("no point") };
    assert_eq!((*position, *intensity), (DVec3::new(1.0, 2.0, 3.0), Rgb::splat(4.0)));
    let Emitter::Spot(spot) = &scene.emitters[1] else { panic!("no spot") };
    assert!((spot.beam_width.to_degrees() - 30.0).abs() < 1e-4);
    let Emitter::Directional { direction, .. } = &scene.emitters[2] else { panic!("not directional") };
    assert_eq!(*direction, DVec3::NEG_Y);
    assert!(matches!(scene.emitters[3], Emitter::Projector { .. }));
}

#[test]
fn parameters_includes_and_aliases() {
    let folder = Folder::new();
    folder.write(
        "part.xml",
        xml("3.0.0", "<bsdf type=\"diffuse\" id=\"a\"><rgb name=\"reflectance\" value=\"$red 0 0\"/></bsdf>"),
    );
    let text = xml(
        "3.0.0",
        r#"<default name="red" value="0.25"/><default name="red_not" value="1"/><include filename="part.xml"/>
           <alias id="a" as="b"/><shape type="sphere"><ref id="b"/></shape>"#,
    );
    let path = folder.write("scene.xml", text);
    let red = |defines: Vec<(String, String)>| {
        let scene = load(&path, &LoadOptions { defines, ..LoadOptions::default() }).unwrap();
        let Model::Diffuse { reflectance } = scene.materials[0].model else { panic!("not diffuse") };
        color(&scene, reflectance).x
    };
    assert_eq!(red(Vec::new()), 0.25);
    assert_eq!(red(vec![("red".to_owned(), "0.75".to_owned())]), 0.75);
}

#[test]
fn what_is_odd_is_told_with_its_line() {
    let scene = mitsuba("<shape type=\"sphere\">\n<float name=\"wobble\" value=\"1\"/></shape>");
    assert!(scene.warnings.iter().any(|w| w.contains("scene.xml:3: property \"wobble\"")), "{:?}", scene.warnings);
    assert!(scene.warnings.iter().any(|w| w.contains("no lights")));
    assert!(scene.warnings.iter().any(|w| w.contains("no camera")));
    let folder = Folder::new();
    let flat = folder.write("flat.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nv nan 0 0\nf 1 2 3\nf 1 2 4\n");
    let scene = mitsuba(&format!(
        "<shape type=\"obj\"><string name=\"filename\" value=\"{}\"/><emitter type=\"area\"/></shape>",
        flat.display()
    ));
    assert!(scene.shapes[0].radiance.is_none());
    assert!(scene.warnings.iter().any(|w| w.contains("light without area")), "{:?}", scene.warnings);
    assert!(scene.warnings.iter().any(|w| w.contains("1 triangles with corners that are not finite")));
}

#[test]
fn what_cannot_be_is_refused_with_its_line() {
    for (text, expected) in [
        ("<shape type=\"moebius\"/>", "scene.xml:2: shape \"moebius\" is not supported"),
        ("<shape type=\"obj\"><string name=\"filename\" value=\"no.obj\"/></shape>", "scene.xml:2: cannot read"),
        ("<shape type=\"sphere\"><transform name=\"to_world\"><scale value=\"0\"/></transform></shape>", "degenerate"),
        ("<shape type=\"sphere\"><transform name=\"to_world\"><rotate angle=\"3\"/></transform></shape>", "no axis"),
        ("<shape type=\"sphere\"><float name=\"radius\" value=\"0\"/></shape>", "not above 0"),
        ("<shape type=\"sphere\"><float name=\"radius\" value=\"nan\"/></shape>", "NaN"),
        ("<shape type=\"sphere\"><ref id=\"x\"/></shape>", "nothing has the id \"x\""),
        (
            "<shape type=\"sphere\"><bsdf type=\"diffuse\"><rgb name=\"reflectance\" value=\"1 2\"/></bsdf></shape>",
            "one number or three",
        ),
        (
            "<bsdf type=\"twosided\" id=\"a\"><ref id=\"a\"/></bsdf><shape type=\"sphere\"><ref id=\"a\"/></shape>",
            "refers to itself",
        ),
        (
            "<bsdf type=\"twosided\" id=\"a\"><ref id=\"b\"/></bsdf><bsdf type=\"twosided\" id=\"b\"><ref id=\"a\"/></bsdf><shape type=\"sphere\"><ref id=\"a\"/></shape>",
            "refers to itself",
        ),
        (
            "<sensor type=\"perspective\"><film type=\"hdrfilm\"><integer name=\"width\" value=\"2000000000\"/></film></sensor>",
            "between 1 and 65536",
        ),
        (
            "<sensor type=\"perspective\"><film type=\"hdrfilm\"><integer name=\"width\" value=\"65536\"/><integer name=\"height\" value=\"65536\"/></film></sensor>",
            "a film of 65536 × 65536 pixels",
        ),
        ("<shape type=\"sphere\"><float name=\"radius\" value=\"1e39\"/></shape>", "1e39 is too large"),
        ("<sensor type=\"perspective\"><float name=\"fov\" value=\"180\"/></sensor>", "field of view"),
        ("<emitter type=\"sky\"/>", "emitter \"sky\" is not supported"),
        ("<shape type=\"sphere\"><float name=\"radius\" value=\"$r\"/></shape>", "parameter $r has no value"),
        ("<include filename=\"scene.xml\"/>", "includes itself"),
        ("<include filename=\"none.xml\"/>", "cannot include"),
        ("<wobble/>", "<wobble> is not known"),
        (
            "<medium type=\"homogeneous\" id=\"m\"><string name=\"material\" value=\"Skin1\"/></medium><shape type=\"sphere\"><ref name=\"interior\" id=\"m\"/></shape>",
            "preset \"Skin1\"",
        ),
        ("<shape type=\"sphere\"", "XML"),
    ] {
        let message = mitsuba_error(text);
        assert!(message.contains(expected), "{text}\n{message}");
        assert!(message.contains("scene.xml:2") || message.contains("scene.xml:3"), "{message}");
    }
}

#[test]
fn lenient_reading_leaves_out_what_is_not_known() {
    let folder = Folder::new();
    let text = r#"<shape type="moebius"/><emitter type="sky"/><wobble/><shape type="sphere"><bsdf type="hk"/></shape>
        <shape type="obj"><string name="filename" value="no.obj"/></shape>"#;
    let scene = folder.lenient("scene.xml", &xml("3.0.0", text));
    check(&scene);
    assert_eq!(scene.shapes.len(), 1);
    for what in ["moebius", "sky", "wobble", "hk", "no.obj"] {
        assert!(scene.warnings.iter().any(|w| w.contains(what)), "{what}: {:?}", scene.warnings);
    }
}

#[test]
fn bombs_do_not_go_off() {
    let folder = Folder::new();
    let entities = "<!DOCTYPE s [<!ENTITY a \"aaaaaaaaaa\"><!ENTITY b \"&a;&a;&a;&a;\">]><scene version=\"3.0.0\"><shape type=\"&b;\"/></scene>";
    assert!(folder.load("scene.xml", entities).unwrap_err().to_string().contains("document type"));
    let deep = format!("{}{}", "<bsdf type=\"twosided\">".repeat(200_000), "</bsdf>".repeat(200_000));
    assert!(folder.load("scene.xml", &xml("3.0.0", &deep)).unwrap_err().to_string().contains("nest deeper"));
    let hidden = "<a b=\"/>\">".repeat(200_000);
    assert!(folder.load("scene.xml", &xml("3.0.0", &hidden)).unwrap_err().to_string().contains("nest deeper"));
    // Each level includes the next one twice, and the last one holds something.
    for i in 0..30 {
        folder.write(&format!("{i}.xml"), xml("3.0.0", &format!("<include filename=\"{}.xml\"/>", i + 1).repeat(2)));
    }
    folder.write("30.xml", xml("3.0.0", &"<bsdf type=\"diffuse\"/>".repeat(100_000)));
    let error = folder.load("scene.xml", &xml("3.0.0", "<include filename=\"0.xml\"/>")).unwrap_err().to_string();
    assert!(error.contains("more than") && error.contains("elements"), "{error}");
}

/// Raw constants are numbers as they stand, and the limits of bent normals are on unless a file turns them off.
#[test]
fn normal_maps_of_raw_constants() {
    let bsdf = |inside: &str| {
        let map = format!(
            r#"<bsdf type="normalmap"><texture name="normalmap" type="rawconstant">{inside}</texture><bsdf type="diffuse"/></bsdf>"#
        );
        mitsuba(&format!(r#"<shape type="sphere">{map}</shape>"#))
    };
    let scene = bsdf(r#"<vector name="value" value="0.5, 0.25, 1"/>"#);
    let map = scene.materials.iter().find_map(|m| match &m.model {
        Model::NormalMap { normals, limits, .. } => Some((*normals, *limits)),
        _ => None,
    });
    let (normals, limits) = map.unwrap();
    assert!(matches!(scene.textures[normals.0], Texture::Constant(v) if v.to_array() == [0.5, 0.25, 1.0]));
    assert!(limits.turns_to_viewer && limits.softens_terminator);
    bsdf(r#"<float name="value" value="0.5"/>"#);
    let text = r#"<shape type="sphere"><bsdf type="bumpmap"><texture type="rawconstant"><string name="value" value="x"/></texture>
        <boolean name="flip_invalid_normals" value="false"/><bsdf type="diffuse"/></bsdf></shape>"#;
    assert!(mitsuba_error(text).contains("a number or a vector"));
    let off = mitsuba(&text.replace(r#"<string name="value" value="x"/>"#, r#"<float name="value" value="1"/>"#));
    let turns = |m: &Material| matches!(&m.model, Model::BumpMap { limits, .. } if limits.turns_to_viewer);
    assert!(!off.materials.iter().any(turns));
}
