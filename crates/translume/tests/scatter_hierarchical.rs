//! Hierarchical models and relighting through the binary.

mod common;

use common::translume;
use serde_json::Value;
use std::fs;
use std::path::Path;
use tempfile::tempdir;

fn json(dir: &Path, arguments: &[&str]) -> Value {
    serde_json::from_str(&translume(dir, &[arguments, &["--json"]].concat()).ok()).unwrap()
}

/// A ball of 8 mm with 8 bands, as OBJ.
fn ball(path: &Path) {
    let n = 8u32;
    let mut text = String::from("v 0 0 4\n");
    for (j, i) in (1..n).flat_map(|j| (0..2 * n).map(move |i| (j, i))) {
        let step = std::f64::consts::PI / f64::from(n);
        let (theta, phi) = (f64::from(j) * step, f64::from(i) * step);
        let (x, y, z) = (theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
        text += &format!("v {} {} {}\n", 4.0 * x, 4.0 * y, 4.0 * z);
    }
    text += "v 0 0 -4\n";
    let at = |j: u32, i: u32| match j {
        0 => 1,
        j if j == n => 2 + (n - 1) * 2 * n,
        j => 2 + (j - 1) * 2 * n + i % (2 * n),
    };
    for (j, i) in (0..n).flat_map(|j| (0..2 * n).map(move |i| (j, i))) {
        let [a, b, c, d] = [at(j, i), at(j + 1, i), at(j + 1, i + 1), at(j, i + 1)];
        for t in [[a, b, c], [a, c, d]].into_iter().filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]) {
            text += &format!("f {} {} {}\n", t[0], t[1], t[2]);
        }
    }
    fs::write(path, text).unwrap();
}

const LIGHTS: &str = r#"{"view": {"eye": [0, -40, 10], "target": [0, 0, 0], "fov_deg": 14, "width": 40, "height": 30},
    "lights": [{"type": "point", "position": [20, -20, 20], "intensity": [100, 90, 80]}]}"#;

const SCENE: &str = r#"<scene version="3.0.0"><integrator type="path"/><sensor type="perspective"><float name="fov" value="14"/>
    <string name="fov_axis" value="x"/><transform name="to_world"><lookat origin="0,-40,10" target="0,0,0" up="0,0,1"/></transform>
    <sampler type="independent"><integer name="sample_count" value="64"/></sampler>
    <film type="hdrfilm"><integer name="width" value="40"/><integer name="height" value="30"/><rfilter type="box"/></film></sensor>
    <shape type="ply"><string name="filename" value="m/mesh.ply"/><boolean name="face_normals" value="true"/>
    <bsdf type="subsurface"><string name="filename" value="m"/><float name="specular_reflectance" value="0"/></bsdf></shape>
    <emitter type="point"><point name="position" x="20" y="-20" z="20"/><rgb name="intensity" value="100 90 80"/></emitter></scene>"#;

#[test]
fn an_object_is_captured_fitted_relit_and_reported() {
    let dir = tempdir().unwrap();
    let dir = dir.path();
    ball(&dir.join("ball.obj"));
    let small = ["--spacing", "1.5", "--pixels", "32", "--views", "3", "--photons", "150", "--eta", "1"];
    let simulate = ["scatter", "simulate", "stone", "--mesh", "ball.obj", "--save-medium", "stone", "-o", "c"];
    translume(dir, &[&simulate[..], &small].concat()).ok();
    // The medium of the capture, for a reference picture: 48 bytes of head, then three channels.
    let size = |name: &str| fs::metadata(dir.join(name)).unwrap().len();
    assert!(size("stone-sigma_t.vol") == size("stone-albedo.vol") && (size("stone-albedo.vol") - 48) % 12 == 0);
    let fitted = json(dir, &["scatter", "fit", "c", "--model", "hierarchical", "--threshold", "0", "-o", "m"]);
    let number = |key: &str| fitted[key].as_f64().unwrap();
    assert!(number("vertices") == 114.0 && number("measured") > 0.3 && number("never_lit") > 0.0, "{fitted}");
    assert!(number("measured_kernels") > 100.0 && number("measured_kernels") < number("kernels"), "{fitted}");

    let scarce = translume(dir, &["scatter", "fit", "c", "--model", "hierarchical", "--threshold", "0.5", "-o", "s"]);
    assert!(scarce.status == 0 && scarce.stderr.contains("--threshold 0"), "{}", scarce.stderr);

    fs::write(dir.join("lights.json"), LIGHTS).unwrap();
    let relight = |model: &str, more: &[&str]| {
        let base = ["scatter", "relight", model, "--lights", "lights.json", "-o", "p.exr"];
        translume(dir, &[&base[..], more].concat())
    };
    relight("m", &[]).ok();
    relight("m", &["--part", "local"]).ok();
    let timed = json(dir, &["scatter", "relight", "m", "--lights", "lights.json", "--frames", "3", "-o", "p.png"]);
    assert!(timed["seconds_per_frame"].as_f64().unwrap() > 0.0 && dir.join("p.png").exists(), "{timed}");
    // Light from elsewhere makes another picture.
    let bytes = fs::read(dir.join("p.png")).unwrap();
    fs::write(dir.join("lights.json"), LIGHTS.replace("20, -20, 20", "0, 40, -10")).unwrap();
    translume(dir, &["scatter", "relight", "m", "--lights", "lights.json", "-o", "q.png"]).ok();
    assert!(bytes != fs::read(dir.join("q.png")).unwrap());
    // A model with a fall-off for each vertex is relit by the same verb.
    json(dir, &["scatter", "fit", "c", "--model", "exponential", "--threshold", "0.01", "-o", "v"]);
    relight("v", &[]).ok();

    // So is one fall-off for the whole, which has no parts.
    let whole = json(dir, &["scatter", "fit", "c", "--model", "dipole", "--uniform", "--threshold", "0", "-o", "u"]);
    assert!((0.0..0.5).contains(&whole["held_out_error"].as_f64().unwrap()), "{whole}");
    relight("u", &[]).ok();
    assert!(relight("u", &["--part", "local"]).error(2).contains("hierarchical"));
    let error = translume(dir, &["scatter", "fit", "c", "--model", "hierarchical", "--uniform", "-o", "n"]).error(2);
    assert!(error.contains("--uniform"), "{error}");
    // The truth is as bright as the model, and so is a render of the model: 1 % of noise, 5 % of few photons behind the model.
    fs::write(dir.join("lights.json"), LIGHTS).unwrap();
    let truth = ["--lights", "lights.json", "--eta", "1", "--photons", "40000", "-o", "truth.exr"];
    translume(dir, &[&["scatter", "simulate", "stone", "--mesh", "ball.obj"][..], &truth].concat()).ok();
    translume(dir, &["scatter", "relight", "m", "--lights", "lights.json", "-o", "relit.exr"]).ok();
    fs::write(dir.join("scene.xml"), SCENE).unwrap();
    translume(dir, &["render", "scene.xml", "-o", "rendered.exr"]).ok();
    let [truth, relit, rendered] = ["truth", "relit", "rendered"].map(|name| {
        let picture = translume_image::read_picture(&dir.join(format!("{name}.exr"))).unwrap();
        picture.pixels.as_raw().iter().map(|v| f64::from(*v)).sum::<f64>()
    });
    assert!((relit / truth - 1.0).abs() < 0.15 && (rendered / relit - 1.0).abs() < 0.05, "{truth} {relit} {rendered}");

    let told = json(dir, &["scatter", "report", "c", "m", "-o", "r"]);
    let green = |i: usize| told["models"][i]["ln_e"][1].as_f64().unwrap();
    assert!(green(0) < green(2), "kernels must help: {told}");
    assert!(green(3).is_finite() && green(3) > green(0), "positions held out: {told}");
    for picture in ["local.png", "global.png", "combined.png", "measured.png"] {
        assert!(dir.join("r").join(picture).exists(), "{picture}");
    }

    // Bad input: one line that names the file, and nothing written.
    let usage = |more: &[&str], says: &str| {
        let error =
            translume(dir, &[&["scatter", "fit", "--model", "hierarchical", "-o", "n"][..], more].concat()).error(2);
        assert!(error.contains(says), "{error}");
    };
    usage(&["c", "--segments", "4"], "fall-offs");
    usage(&["ball.obj"], "captures");
    for (from, to, says) in [
        ("\"fov_deg\": 14", "\"fov_deg\": 200", "fov_deg"),
        ("\"point\"", "\"sun\"", "sun"),
        ("\"width\"", "\"widht\"", "widht"),
        ("[0, -40, 10]", "[0, 0, 0]", "eye"),
        ("100, 90, 80", "100, -90, 80", "light 0"),
    ] {
        fs::write(dir.join("lights.json"), LIGHTS.replace(from, to)).unwrap();
        let error = relight("m", &[]).error(1);
        assert!(error.contains(says) && error.contains("lights.json"), "{error}");
    }
    fs::write(dir.join("lights.json"), LIGHTS).unwrap();
    assert!(relight("c", &[]).error(1).contains("model.json"));
    let chunk = dir.join("m/throughput/c/0/0/0");
    let whole = fs::read(&chunk).unwrap();
    fs::write(&chunk, &whole[..whole.len() / 2]).unwrap();
    assert!(relight("m", &[]).error(1).contains("truncated"));
    fs::write(&chunk, whole).unwrap();
    let path = dir.join("m/model.json");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replace("\"version\": \"1.1\"", "\"version\": \"7.0\"")).unwrap();
    assert!(relight("m", &[]).error(1).contains("version 7.0"));
}

#[test]
fn the_committed_example_of_lights_is_read() {
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/examples/lights.json");
    let lighting = translume_scatter::relight::Lighting::read(&example).unwrap();
    assert_eq!(lighting.lights.len(), 2);
}
