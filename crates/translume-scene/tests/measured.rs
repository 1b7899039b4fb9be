//! Files of RGL's material database, written by another program (`tests/data/measured/make.py`), beside Mitsuba 3's reading of them.

mod common;

use common::{Folder, survives_within, xml};
use std::path::Path;
use std::sync::Arc;
use translume_bxdf::{CustomBsdf, Mode, Rgb};
use translume_scene::glam::{Vec2, Vec3};
use translume_scene::material::Model;
use translume_scene::{LoadOptions, Scene, load};

const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/measured");

fn measured(scene: &Scene) -> Arc<dyn CustomBsdf> {
    let found = scene.materials.iter().find_map(|m| match &m.model {
        Model::Measured(model) => Some(model.clone()),
        _ => None,
    });
    found.expect("a measured material")
}

fn in_mitsuba(file: &str) -> String {
    xml(
        "3.0.0",
        &format!(
            "<shape type=\"sphere\"><bsdf type=\"measured\"><string name=\"filename\" value=\"{file}\"/></bsdf></shape>"
        ),
    )
}

fn loaded(name: &str) -> Arc<dyn CustomBsdf> {
    measured(&Folder::new().load("scene.xml", &in_mitsuba(&format!("{DATA}/{name}.bsdf"))).unwrap())
}

/// Relative to the larger of the value and a hundredth.
fn near(a: f32, b: f32, tolerance: f32) -> bool {
    (a - b).abs() <= tolerance * b.abs().max(0.01)
}

#[test]
fn values_and_samples_are_those_of_mitsuba() {
    let table = std::fs::read_to_string(format!("{DATA}/mitsuba.txt")).unwrap();
    let models = ["isotropic", "anisotropic", "whole-turn"].map(|name| (name, loaded(name)));
    let mut seen = [0; 3];
    for line in table.lines().filter(|line| !line.starts_with('#')) {
        let (name, numbers) = line.split_once(' ').unwrap();
        let n: Vec<f32> = numbers.split(' ').map(|v| v.parse().unwrap()).collect();
        let vector = |i: usize| Vec3::new(n[i], n[i + 1], n[i + 2]);
        let which = models.iter().position(|m| m.0 == name).unwrap();
        let model = &models[which].1;
        let (wo, wi, value, pdf) = (vector(0), vector(3), vector(6), n[9]);
        let (f, density) = model.eval_pdf(Vec2::ZERO, wo, wi, Mode::Radiance);
        assert!((0..3).all(|c| near(f[c] * wi.z, value[c], 3e-3)), "{line}: {}", f * wi.z);
        assert!(near(density, pdf, 3e-3), "{line}: {density}");
        // Mitsuba draws y first.
        let (drawn, weight, pdf) = (vector(12), vector(15), n[18]);
        match model.sample(Vec2::ZERO, wo, 0.5, Vec2::new(n[11], n[10]), Mode::Radiance) {
            Some(sample) => {
                assert!((sample.wi - drawn).length() < 2e-3, "{line}: {}", sample.wi);
                assert!(near(sample.pdf_w, pdf, 3e-2), "{line}: {}", sample.pdf_w);
                assert!((0..3).all(|c| near(sample.weight[c], weight[c], 3e-2)), "{line}: {}", sample.weight);
                seen[which] += 1;
            }
            None => assert!(drawn.z <= 1e-3 || pdf == 0.0, "{line}"),
        }
    }
    assert!(seen.iter().all(|&n| n > 25), "{seen:?}");
}

/// The material's reflectance at the wavelengths rises from 0.2 to 0.9: an orange.
#[test]
fn spectra_become_colours() {
    let model = loaded("spectral");
    let f = model.eval_pdf(Vec2::ZERO, Vec3::Z, Vec3::new(0.1, 0.0, 1.0).normalize(), Mode::Radiance).0;
    let shape = f / f.max_element();
    // What the shared reader of reflectance spectra says of the same one, in Mitsuba's syntax.
    let spectrum = "400:0.2, 500:0.3, 600:0.7, 700:0.9";
    let inside = format!("<bsdf type=\"diffuse\"><spectrum name=\"reflectance\" value=\"{spectrum}\"/></bsdf>");
    let scene = common::mitsuba(&format!("<shape type=\"sphere\">{inside}</shape>"));
    let Model::Diffuse { reflectance } = scene.materials.last().unwrap().model else { panic!("not diffuse") };
    let expected = scene.constant(reflectance).unwrap();
    let expected = expected / expected.max_element();
    assert!((shape - expected).abs().max_element() < 0.02, "{shape} for {expected}");
}

#[test]
fn pbrt_reads_the_same_on_both_sides() {
    let text =
        format!("WorldBegin\nMaterial \"measured\" \"string filename\" \"{DATA}/isotropic.bsdf\"\nShape \"sphere\"\n");
    let scene = Folder::new().load("scene.pbrt", &text).unwrap();
    let (wo, wi) = (Vec3::new(0.3, 0.1, 0.8).normalize(), Vec3::new(0.2, -0.4, 0.7).normalize());
    let value = |m: &dyn CustomBsdf| m.eval_pdf(Vec2::ZERO, wo, wi, Mode::Radiance);
    assert_eq!(value(&*measured(&scene)), value(&*loaded("isotropic")));
    assert!(matches!(scene.materials[scene.shapes[0].material.0].model, Model::TwoSided { .. }));
}

#[test]
fn a_file_is_read_once() {
    let shape = format!(
        "<shape type=\"sphere\"><bsdf type=\"measured\"><string name=\"filename\" value=\"{DATA}/isotropic.bsdf\"/></bsdf></shape>"
    );
    let scene = common::mitsuba(&(shape.clone() + &shape));
    let models: Vec<_> =
        scene.materials.iter().filter_map(|m| if let Model::Measured(m) = &m.model { Some(m) } else { None }).collect();
    assert!(models.len() == 2 && Arc::ptr_eq(models[0], models[1]));
}

#[test]
fn damaged_files_are_refused_or_harmless() {
    let folder = Folder::new();
    let bytes = std::fs::read(Path::new(DATA).join("isotropic.bsdf")).unwrap();
    let spectral = std::fs::read(Path::new(DATA).join("spectral.bsdf")).unwrap();
    let scene = folder.write("scene.xml", in_mitsuba("m.bsdf"));
    survives_within(&scene, "m.bsdf", &bytes, 600, &folder);
    survives_within(&scene, "m.bsdf", &spectral, 600, &folder);
    // What still loads, as damage in the numbers alone does, must not make light of nothing.
    let mut worse = bytes.clone();
    let half = worse.len() / 2;
    worse[half..half + 400].fill(0x7e);
    folder.write("m.bsdf", &worse);
    if let Ok(scene) = load(&scene, &LoadOptions::default()) {
        let f = measured(&scene).eval_pdf(Vec2::ZERO, Vec3::Z, Vec3::Z, Mode::Radiance);
        assert!(f.0.is_finite() && f.0.cmpge(Rgb::ZERO).all() && f.1.is_finite());
    }
    for (bytes, message) in [
        (&b"tensor"[..], "not a .bsdf file"),
        (&bytes[..200], "truncated"),
        (&[&bytes[..12], &[2, 0], &bytes[14..]].concat(), "version 2.0"),
    ] {
        folder.write("m.bsdf", bytes);
        let error = load(&scene, &LoadOptions::default()).unwrap_err().to_string();
        assert!(error.contains(message) && error.contains("scene.xml:2") && error.contains("m.bsdf"), "{error}");
    }
    folder.write("m.bsdf", std::fs::read(Path::new(DATA).join("mitsuba.txt")).unwrap());
    assert!(load(&scene, &LoadOptions::default()).is_err());
}
