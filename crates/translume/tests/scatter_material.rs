//! Fitted models as materials, through the binary: capture, fit, render.

mod common;

use common::translume;
use std::fs;
use std::path::Path;
use tempfile::tempdir;
use translume_image::read_exr_channels;

/// A scene with one shape of a model under a projector with half of its picture black, and a little sky.
fn scene(shape: &str, model: &str, scale: f64) -> String {
    format!(
        "<scene version=\"3.0.0\"><integrator type=\"path\"/>
         <sensor type=\"perspective\"><float name=\"fov\" value=\"30\"/>
          <transform name=\"to_world\"><lookat origin=\"0,-1,40\" target=\"0,0,0\" up=\"0,1,0\"/></transform>
          <film type=\"hdrfilm\"><integer name=\"width\" value=\"24\"/><integer name=\"height\" value=\"24\"/></film></sensor>
         <shape {shape}<bsdf type=\"subsurface\"><string name=\"filename\" value=\"{model}\"/>
          <float name=\"scale\" value=\"{scale}\"/></bsdf></shape>
         <emitter type=\"projector\"><float name=\"fov\" value=\"20\"/><float name=\"scale\" value=\"12732\"/>
          <transform name=\"to_world\"><lookat origin=\"0,0,40\" target=\"0,0,0\" up=\"0,1,0\"/></transform>
          <texture name=\"irradiance\" type=\"bitmap\"><string name=\"filename\" value=\"half.pfm\"/></texture></emitter>
         <emitter type=\"constant\"><float name=\"radiance\" value=\"0.01\"/></emitter></scene>"
    )
}

/// A picture whose left half is dark.
fn half(dir: &Path) {
    let mut pfm = b"PF\n64 1\n-1.0\n".to_vec();
    (0..192).for_each(|i| pfm.extend((if i < 96 { 0.0f32 } else { 1.0 }).to_le_bytes()));
    fs::write(dir.join("half.pfm"), pfm).unwrap();
}

/// Green means of the left and the right half of a render.
fn halves(dir: &Path, scene: &str, more: &[&str]) -> [f64; 2] {
    fs::write(dir.join("s.xml"), scene).unwrap();
    translume(dir, &[&["render", "s.xml", "-o", "o.exr", "--spp", "64"][..], more].concat()).ok();
    let planes = read_exr_channels(&dir.join("o.exr"), 0).unwrap();
    let green = &planes.planes.iter().find(|p| p.0 == "G").unwrap().1;
    assert!(green.iter().all(|v| v.is_finite()));
    let sum = |side: usize| {
        green.iter().enumerate().filter(|(i, _)| i % 24 / 12 == side).map(|p| f64::from(*p.1)).sum::<f64>()
    };
    [sum(0) / 288.0, sum(1) / 288.0]
}

#[test]
fn a_captured_slab_and_a_captured_ball_are_rendered() {
    let dir = tempdir().unwrap();
    let dir = dir.path();
    half(dir);
    let slab = [
        "scatter",
        "simulate",
        "homogeneous",
        "--spots",
        "3",
        "--pixels",
        "20",
        "--spacing",
        "2",
        "--thickness",
        "5",
        "-o",
        "c",
    ];
    translume(dir, &[&slab[..], &["--photons", "400"]].concat()).ok();
    let rectangle = "type=\"rectangle\"><transform name=\"to_world\"><scale value=\"8\"/></transform>";
    let mut means = Vec::new();
    for (name, options) in [("e", &["--segments", "4"][..]), ("d", &["--model", "dipole"])] {
        translume(dir, &[&["scatter", "fit", "c", "-o", name][..], options].concat()).ok();
        means.push(halves(dir, &scene(rectangle, name, 8.0), &[]));
    }
    // Light under the dark half comes from below the lit one.
    for [dark, lit] in &means {
        assert!(*dark > 0.01 * lit && *dark < 0.5 * lit, "{means:?}");
    }
    // About the truth, as 5 mm let little through: the medium that was captured, by its coefficients.
    let known = scene(rectangle, "e", 8.0).replace(
        "<string name=\"filename\" value=\"e\"/>\n          <float name=\"scale\" value=\"8\"/>",
        "<rgb name=\"sigma_s\" value=\"2 2 2\"/><rgb name=\"sigma_a\" value=\"0.004 0.006 0.01\"/><float name=\"int_ior\" value=\"1.5\"/>",
    );
    assert!(known.contains("sigma_s"));
    let truth = halves(dir, &known, &[]);
    assert!(means.iter().all(|m| (m[1] / truth[1]).ln().abs() < 0.7), "{means:?} {truth:?}");

    // Any number of threads, the same bits.
    let bytes = |threads: &str| {
        let file = format!("t{threads}.exr");
        let run = ["render", "s.xml", "--spp", "4", "--threads", threads, "-o", &file];
        translume(dir, &run).ok();
        let read = read_exr_channels(&dir.join(&file), 0).unwrap();
        read.planes.iter().flat_map(|p| p.1.iter().map(|v| v.to_bits())).collect::<Vec<_>>()
    };
    fs::write(dir.join("s.xml"), scene(rectangle, "e", 8.0)).unwrap();
    assert!(bytes("1") == bytes("3"));

    // An object: on its own mesh, however large, and on no other.
    let ball = "o ball\n";
    fs::write(dir.join("ball.obj"), ball.to_owned() + &common::octahedron()).unwrap();
    translume(
        dir,
        &[
            "scatter",
            "simulate",
            "homogeneous",
            "--mesh",
            "ball.obj",
            "--spacing",
            "4",
            "--pixels",
            "24",
            "--views",
            "3",
            "--photons",
            "300",
            "-o",
            "b",
        ],
    )
    .ok();
    translume(dir, &["scatter", "fit", "b", "-o", "bm"]).ok();
    let mesh = "type=\"ply\"><string name=\"filename\" value=\"bm/mesh.ply\"/>";
    let [dark, lit] = halves(dir, &scene(mesh, "bm", 1.0), &[]);
    assert!(dark > 0.02 * lit && dark < 0.7 * lit, "{dark} {lit}");
    let refused = |shape: &str, scale: f64, says: &str| {
        fs::write(dir.join("s.xml"), scene(shape, "bm", scale)).unwrap();
        let error = translume(dir, &["render", "s.xml", "-o", "o.exr"]).error(1);
        assert!(error.contains(says), "{error}");
    };
    refused(mesh, 2.0, "mesh it was fitted to");
    refused("type=\"sphere\">", 1.0, "mesh it was fitted to");
    let stretched = "type=\"ply\"><string name=\"filename\" value=\"bm/mesh.ply\"/><transform name=\"to_world\"><scale x=\"2\"/></transform>";
    refused(stretched, 1.0, "stretched");
    fs::write(dir.join("bm/model.json"), "{}").unwrap();
    refused(mesh, 1.0, "not a model");
}
