//! `translume capture` through the program: a stack from a scene, what resuming keeps, and what bad input is told.

mod common;

use common::translume;
use std::path::Path;
use translume_image::read_picture;

const LOOK: &str = r#"<sensor type="perspective"><float name="fov" value="20"/>
    <transform name="to_world"><lookat origin="6, 0, 0" target="0, 0, 0" up="0, 0, 1"/></transform>
    <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="24"/><rfilter type="box"/></film>
    </sensor>"#;

/// A white ball with a lamp of its own, seen along −x with z up: the picture's right is +y.
fn scene(dir: &Path, sensor: &str) {
    let ball = r#"<shape type="sphere"><bsdf type="diffuse"><rgb name="reflectance" value="1"/></bsdf></shape>"#;
    let lamp = r#"<emitter type="constant"/><shape type="sphere"><point name="center" x="9" y="9" z="9"/>
        <emitter type="area"><rgb name="radiance" value="1000"/></emitter></shape>"#;
    std::fs::write(dir.join("s.xml"), format!("<scene version=\"3.0.0\">{sensor}{ball}{lamp}</scene>")).unwrap();
}

const SMALL: [&str; 9] = ["capture", "light-stage", "s.xml", "-o", "stack", "--lights", "12", "--spp", "4"];

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap()
}

#[test]
fn a_stack_shows_the_scene_under_the_lamps_of_its_list() {
    let dir = tempfile::tempdir().unwrap();
    scene(dir.path(), LOOK);
    let found = json(&translume(dir.path(), &[&SMALL[..], &["--hemisphere", "--json"]].concat()).ok());
    assert_eq!((&found["pictures"], &found["kept"], &found["own_lights_put_out"]), (&12.into(), &0.into(), &2.into()));
    let list = std::fs::read_to_string(dir.path().join("stack/lights.lp")).unwrap();
    for line in list.lines().skip(1) {
        let words: Vec<&str> = line.split(' ').collect();
        let l: Vec<f32> = words[1..].iter().map(|w| w.parse().unwrap()).collect();
        let picture = read_picture(&dir.path().join("stack").join(words[0])).unwrap().pixels;
        // Where the ray of a pixel meets the ball: from (0, 0, 6), z to the camera. White paper shows the cosine.
        for (x, y) in [(12u32, 12u32), (19, 12), (12, 4), (6, 16)] {
            let slope = |v: f32| (v + 0.5 - 12.0) / 12.0 * 10f32.to_radians().tan();
            let (u, v) = (slope(x as f32), -slope(y as f32));
            let a = u * u + v * v + 1.0;
            let t = (6.0 - (36.0 - 35.0 * a).sqrt()) / a;
            let (nx, ny, nz) = (t * u, t * v, 6.0 - t);
            let cos = (nx * l[0] + ny * l[1] + nz * l[2]).max(0.0);
            let got = picture.get_pixel(x, y).0[1];
            assert!((got - cos).abs() < 0.04, "{line} at {x}, {y}: {got} for {cos}");
        }
        // The lamps themselves are not seen, nor the scene's own light.
        assert_eq!(picture.get_pixel(0, 0).0, [0.0; 3]);
    }
    // What compress reads.
    translume(dir.path(), &["field", "compress", "stack", "-o", "f.glb", "--terms", "4"]).ok();
}

#[test]
fn what_is_there_stays_and_the_rest_comes_out_the_same() {
    let dir = tempfile::tempdir().unwrap();
    scene(dir.path(), LOOK);
    translume(dir.path(), &SMALL).ok();
    let file = |i: usize| dir.path().join(format!("stack/light_{i:03}.exr"));
    let pixels = |i: usize| read_picture(&file(i)).unwrap().pixels.into_raw();
    let before: Vec<Vec<f32>> = (0..12).map(pixels).collect();
    std::fs::remove_file(file(3)).unwrap();
    std::fs::remove_file(file(8)).unwrap();
    std::fs::copy(file(0), file(1)).unwrap(); // a picture that is told by its content
    let again = json(&translume(dir.path(), &[&SMALL[..], &["--threads", "1", "--json"]].concat()).ok());
    assert_eq!(again["kept"], 10);
    let after: Vec<Vec<f32>> = (0..12).map(pixels).collect();
    assert!((0..12).all(|i| after[i] == before[if i == 1 { 0 } else { i }]));
    // Asked for otherwise.
    let error = translume(dir.path(), &[&SMALL[..], &["--seed", "1", "--hemisphere"]].concat()).error(1);
    assert!(error.contains("stack") && error.contains("seed") && error.contains("hemisphere"), "{error}");
    std::fs::remove_file(dir.path().join("stack/light-stage.json")).unwrap();
    let error = translume(dir.path(), &SMALL).error(1);
    assert!(error.contains("light_000.exr") && error.contains("unknown stack"), "{error}");
}

#[test]
fn bad_input_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| translume(dir.path(), &[&["capture", "light-stage"], arguments].concat());
    assert!(run(&["no.xml", "-o", "stack"]).error(1).contains("no.xml"));
    scene(dir.path(), "");
    // The scene's own warning stands before the error.
    let found = run(&["s.xml", "-o", "stack"]);
    assert!(found.status == 1 && found.stderr.contains("error: s.xml: no camera (<sensor>)"), "{}", found.stderr);
    assert!(!dir.path().join("stack").exists());
    scene(dir.path(), LOOK);
    for (arguments, what) in [
        (["--lights", "0"], "--lights"),
        (["--lights", "1000000"], "--lights"),
        (["--angle", "0.01"], "0.5 to 90"),
        (["--angle", "nan"], "0.5 to 90"),
        (["--spp", "0"], "--spp"),
        (["--size", "0x9"], "width x height"),
        (["--clamp", "0"], "above 0"),
    ] {
        let error = run(&[&["s.xml", "-o", "stack"], &arguments[..]].concat()).error(2);
        assert!(error.contains(what), "{arguments:?}: {error}");
    }
    // A folder that cannot be made, as a file is in its way.
    std::fs::write(dir.path().join("file"), "").unwrap();
    let error = run(&["s.xml", "-o", "file/stack"]).error(1);
    assert!(error.contains("file/stack"), "{error}");
    let error = run(&["s.xml", "-o", "file"]).error(1);
    assert!(error.contains("cannot make the folder file"), "{error}");
}
