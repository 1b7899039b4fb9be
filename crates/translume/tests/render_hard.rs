//! Scenes at the border of what there is to see, by the methods that need light paths: a right picture in bounded time.

mod common;

use common::translume;
use tempfile::tempdir;

const FLOOR: &str = r#"<shape type="rectangle"><transform name="to_world"><scale value="4"/></transform>
  <bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf></shape>"#;
const BALL: &str =
    r#"<shape type="sphere"><float name="radius" value="0.5"/><point name="center" x="0" y="0" z="0.5"/></shape>"#;
const POINT: &str =
    r#"<emitter type="point"><point name="position" x="1" y="1" z="3"/><rgb name="intensity" value="10"/></emitter>"#;
/// Of a lamp in a closed box beside the picture.
const BOXED: &str = r#"<shape type="sphere"><float name="radius" value="0.2"/><point name="center" x="20" y="0" z="0"/>
  <emitter type="area"><rgb name="radiance" value="5"/></emitter></shape>
  <shape type="cube"><transform name="to_world"><translate x="20"/></transform></shape>"#;

fn camera(z: f32) -> String {
    format!(
        r#"<sensor type="perspective"><film type="hdrfilm"><integer name="width" value="16"/>
        <integer name="height" value="12"/></film><transform name="to_world">
        <lookat origin="2,-4,{z}" target="0,0,0" up="0,0,1"/></transform></sensor>"#
    )
}

/// Mean of the picture of `body` by `method`; it must be made, and finite.
fn mean(body: &str, method: &str) -> f64 {
    let dir = tempdir().unwrap();
    std::fs::write(dir.path().join("s.xml"), format!("<scene version=\"3.0.0\">{body}</scene>")).unwrap();
    let spp = if method == "path" { "256" } else { "16" };
    let run =
        translume(dir.path(), &["render", "s.xml", "-o", "o.exr", "--integrator", method, "--spp", spp, "--json"]);
    assert_eq!(run.status, 0, "{method}: {}", run.stderr);
    assert!(!run.stderr.contains("not finite"), "{method}: {}", run.stderr);
    let pixels = translume_image::read_picture(&dir.path().join("o.exr")).unwrap().pixels.into_raw();
    pixels.iter().map(|v| f64::from(*v)).sum::<f64>() / pixels.len() as f64
}

#[test]
fn no_light_is_said() {
    let dir = tempdir().unwrap();
    std::fs::write(dir.path().join("s.xml"), format!("<scene version=\"3.0.0\">{}{FLOOR}</scene>", camera(3.0)))
        .unwrap();
    for method in ["path", "bdpt", "photonmap", "gkernel"] {
        let run = translume(dir.path(), &["render", "s.xml", "-o", "o.exr", "--integrator", method]);
        assert!(run.status == 1 && run.stderr.contains("no light that shines"), "{method}: {}", run.stderr);
    }
}

#[test]
fn pictures_at_the_border() {
    let above = camera(3.0);
    let scenes = [
        ("one point light", format!("{above}{FLOOR}{BALL}{POINT}"), 0.05),
        ("a sky only", format!("{above}{FLOOR}{BALL}<emitter type=\"constant\"/>"), 0.03),
        ("a light that nobody sees", format!("{above}{FLOOR}{BALL}{BOXED}"), 0.0),
        ("that and a point light", format!("{above}{FLOOR}{BALL}{BOXED}{POINT}"), 0.05),
        ("nothing but a light", format!("{above}{POINT}"), 0.0),
        // The floor is seen from below, where it is black; inside a ball nothing arrives.
        ("camera below the floor", format!("{}{FLOOR}{POINT}", camera(-3.0)), 0.0),
        (
            "camera in a wall",
            format!(
                "{above}{FLOOR}{POINT}<shape type=\"sphere\"><point name=\"center\" x=\"2\" y=\"-4\" z=\"3\"/></shape>"
            ),
            0.0,
        ),
    ];
    for (name, body, slack) in scenes {
        let path = mean(&body, "path");
        for method in ["bdpt", "photonmap", "gkernel"] {
            let ours = mean(&body, method);
            assert!((ours - path).abs() <= slack * path, "{name}: {method} {ours}, path {path}");
        }
    }
}
