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
}
