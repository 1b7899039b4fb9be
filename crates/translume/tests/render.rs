//! `translume render` by its methods, through the binary.

mod common;

use common::translume;
use serde_json::Value;

const BOX: &str = r#"<scene version="3.0.0">
  <sensor type="perspective">
    <transform name="to_world"><lookat origin="3,-3,2.5" target="0,0,0.3" up="0,0,1"/></transform>
    <float name="fov" value="40"/>
    <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/></film>
  </sensor>
  <shape type="rectangle"><transform name="to_world"><scale value="3"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.6"/></bsdf></shape>
  <shape type="sphere"><point name="center" x="0" y="0" z="0.7"/><float name="radius" value="0.5"/><bsdf type="dielectric"/></shape>
  <shape type="sphere"><point name="center" x="0.5" y="0.4" z="2.5"/><float name="radius" value="0.2"/>
    <emitter type="area"><rgb name="radiance" value="20"/></emitter></shape>
</scene>"#;

#[test]
fn bdpt_tells_of_its_strategies_and_resumes_to_the_bit() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("box.xml"), BOX).unwrap();
    let render = |more: &str| {
        let line = format!("render box.xml --integrator bdpt --seed 3 {more}");
        translume(dir.path(), &line.split(' ').collect::<Vec<_>>()).ok()
    };
    let json: Value = serde_json::from_str(&render("-o whole.exr --spp 8 --threads 1 --json")).unwrap();
    let strategies = json["strategies"].as_array().unwrap();
    let of = |name: &str| strategies.iter().find(|s| s["name"] == name).unwrap();
    for name in ["s=0 t=3", "s=1 t=2", "s=2 t=1", "s=4 t=1"] {
        assert!(of(name)["contributed"].as_u64().unwrap() > 0, "{name}");
        assert!(of(name)["contributed"].as_u64() <= of(name)["tried"].as_u64(), "{name}");
    }
    render("-o half.exr --spp 3 --checkpoint state.tlck");
    render("-o resumed.exr --spp 8 --checkpoint state.tlck --resume --threads 2");
    let rgb = |name: &str| translume_image::read_picture(&dir.path().join(name)).unwrap().pixels.into_raw();
    assert_eq!(rgb("whole.exr"), rgb("resumed.exr"));
    assert_ne!(rgb("whole.exr"), rgb("half.exr"));
}

#[test]
fn photonmap_counts_its_photons_and_options_are_checked() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("box.xml"), BOX).unwrap();
    let render = |more: &str| {
        let line = format!("render box.xml -o out.exr --integrator photonmap --spp 2 {more}");
        translume(dir.path(), &line.split(' ').collect::<Vec<_>>())
    };
    let json: Value = serde_json::from_str(&render("--option photons=2000 --json").ok()).unwrap();
    assert_eq!(json["counts"]["light_paths"], 2000);
    assert!(json["counts"]["caustic_photons"].as_u64().unwrap() > 10, "{json}");
    assert!(render("--option photons=0").error(2).contains("photons=0"));
    assert!(render("--option size=3").error(2).contains("neighbours"));
}

#[test]
fn gkernel_shares_samples_out_among_steps_and_resumes_to_the_bit() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("box.xml"), BOX).unwrap();
    let render = |more: &str| {
        let line = format!("render box.xml --integrator gkernel {more}");
        translume(dir.path(), &line.split(' ').collect::<Vec<_>>())
    };
    let json: Value = serde_json::from_str(&render("-o whole.exr --steps 2 --spp 6 --json").ok()).unwrap();
    assert_eq!((&json["counts"]["steps"], &json["samples_per_pixel"]), (&2.into(), &6.into()));
    let json: Value = serde_json::from_str(&render("-o steps.exr --steps 3 --json").ok()).unwrap();
    assert_eq!((&json["counts"]["steps"], &json["samples_per_pixel"]), (&3.into(), &3.into()));
    render("-o half.exr -O eye-paths=3 --spp 3 --checkpoint state.tlck").ok();
    render("-o resumed.exr -O eye-paths=3 --spp 6 --checkpoint state.tlck --resume --threads 1").ok();
    let rgb = |name: &str| translume_image::read_picture(&dir.path().join(name)).unwrap().pixels.into_raw();
    assert_eq!(rgb("whole.exr"), rgb("resumed.exr"));
    assert_ne!(rgb("whole.exr"), rgb("half.exr"));
    assert!(render("-o out.exr --steps 4 --spp 6").error(2).contains("multiple"));
    let path = translume(dir.path(), &["render", "box.xml", "-o", "out.exr", "--integrator", "path", "--steps", "4"]);
    assert!(path.error(2).contains("gkernel"));
    let unbiased = |method: &str| {
        translume(dir.path(), &["render", "box.xml", "-o", "u.exr", "--integrator", method, "--spp", "1", "--unbiased"])
    };
    unbiased("gkernel").ok();
    assert_ne!(rgb("u.exr"), rgb("whole.exr"));
    assert!(unbiased("path").error(2).contains("gkernel"));
    // The method of 2003 has steps too, and is where one asks for it by its old option.
    let old =
        translume(dir.path(), &["render", "box.xml", "-o", "u.exr", "--integrator", "gkernel-2003", "--steps", "2"]);
    old.ok();
    assert_ne!(rgb("u.exr"), rgb("whole.exr"));
    assert!(render("-o out.exr -O printed=true").error(2).contains("gkernel-2003"));
}

#[test]
fn a_camera_path_reuses_light_paths() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("box.xml"), BOX).unwrap();
    let path = r#"{"frames": 3, "keys": [{"origin": [3, -3, 2.5], "target": [0, 0, 0.3], "up": [0, 0, 1]},
        {"origin": [3, 3, 2.5], "target": [0, 0, 0.3], "up": [0, 0, 1]}]}"#;
    std::fs::write(dir.path().join("path.json"), path).unwrap();
    let render = |more: &str| {
        let line = format!("render box.xml --seed 3 --spp 4 --json {more}");
        translume(dir.path(), &line.split(' ').collect::<Vec<_>>())
    };
    let rgb = |name: &str| translume_image::read_picture(&dir.path().join(name)).unwrap().pixels.into_raw();
    // The first key is the scene's camera.
    render("--integrator path -o one.exr").ok();
    render("--integrator path -o walk.exr --camera-path path.json").ok();
    assert_eq!(rgb("one.exr"), rgb("walk-0000.exr"));
    assert_ne!(rgb("walk-0001.exr"), rgb("walk-0002.exr"));
    let json: Value =
        serde_json::from_str(&render("--integrator gkernel -o g.exr --camera-path path.json").ok()).unwrap();
    let counts = &json["frames"][2]["counts"];
    assert_eq!((counts["steps"].as_u64(), counts["steps_reused"].as_u64()), (Some(12), Some(8)), "{counts}");
    let mean = |name: &str| rgb(name).iter().sum::<f32>() / rgb(name).len() as f32;
    let (ours, path) = (mean("g-0002.exr"), mean("walk-0002.exr"));
    assert!((ours / path - 1.0).abs() < 0.15, "{ours} and {path}");

    std::fs::write(dir.path().join("bad.json"), r#"{"keys": [{"origin": [0, 0, 0], "target": [0, 0, 0]}]}"#).unwrap();
    assert!(render("-o b.exr --camera-path bad.json").error(1).contains("frame 0"));
    std::fs::write(dir.path().join("bad.json"), r#"{"keys": [{"origin": [0, 0]}]}"#).unwrap();
    assert!(render("-o b.exr --camera-path bad.json").error(1).contains("bad.json"));
    assert!(render("-o b.exr --camera-path path.json --checkpoint c.tlck").error(2).contains("--camera-path"));
}

#[test]
fn denoising_comes_nearer_to_the_truth() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("box.xml"), BOX.replace("dielectric", "diffuse")).unwrap();
    let run = |line: &str| translume(dir.path(), &line.split(' ').collect::<Vec<_>>());
    run("render box.xml -o truth.exr --spp 1024 --size 48x32").ok();
    run("render box.xml -o noisy.exr --spp 4 --size 48x32 --denoise clean.exr").ok();
    let rgb = |name: &str| translume_image::read_picture(&dir.path().join(name)).unwrap().pixels.into_raw();
    let error = |name: &str| {
        let differ = |(a, b): (&f32, &f32)| ((a - b) / (b + 0.05)).powi(2);
        rgb(name).iter().zip(&rgb("truth.exr")).map(differ).sum::<f32>()
    };
    assert!(error("clean.exr") < 0.75 * error("noisy.exr"), "{} of {}", error("clean.exr"), error("noisy.exr"));
    run("image denoise noisy.exr -o again.exr").ok();
    assert_eq!(rgb("again.exr"), rgb("clean.exr"));
    assert!(run("image denoise truth.exr -o no.exr").error(1).contains("variance"));
    assert!(run("image denoise noisy.exr -o no.png").error(2).contains(".exr"));
}
