//! Photon mapping against `path` and against known values. It is biased: the slack of each test says by how much it may be.

mod common;

use common::*;
use glam::{DVec3, Vec3};
use translume_render::film::Film;
use translume_render::integrator;
use translume_scene::Scene;
use translume_scene::emitter::Emitter;

fn photons(scene: &Scene, options: &[(&str, &str)], spp: u64) -> Film {
    let options: Vec<(String, String)> = options.iter().map(|o| (o.0.to_owned(), o.1.to_owned())).collect();
    film_by(scene, &*integrator::with_options("photonmap", UNLIMITED, &options).unwrap(), spp, 5)
}

/// Means within `slack` and noise.
#[track_caller]
fn near_path(scene: &Scene, options: &[(&str, &str)], slack: f64) {
    let (path, error) = mean(&film(scene, "path", UNLIMITED, 4096, 6));
    let (ours, noise) = mean(&photons(scene, options, 256));
    let allowed = slack * path + 4.0 * (error + noise);
    assert!((path - ours).abs() < allowed, "{options:?}: {ours} instead of {path} ± {allowed}");
}

#[test]
fn pictures_are_nearly_those_of_path() {
    let many = ("photons", "200000");
    for scene in [room(), glass_ball(0.3)] {
        near_path(&scene, &[many], 0.02);
        near_path(&scene, &[many, ("gather", "false")], 0.03);
        near_path(&scene, &[many, ("gather", "false"), ("direct", "map")], 0.05);
    }
}

/// Inside a closed diffuse sphere that shines every point has L_e / (1 − albedo); curvature costs the estimate little.
#[test]
fn a_closed_furnace() {
    let mut m = Maker::default();
    let (gray, glow) = (m.diffuse(0.5), m.gray(1.0));
    let shape = m.sphere(DVec3::ZERO, 1.0, gray);
    (shape.radiance, shape.flip_normals) = (Some(glow), true);
    m.camera(DVec3::new(0.2, -0.3, 0.1), DVec3::X, 1.0);
    for options in [&[][..], &[("gather", "false")], &[("gather", "false"), ("direct", "map")]] {
        let (mean, _) = mean(&photons(&m.0, options, 32));
        assert!((mean - 2.0).abs() < 0.03, "{options:?}: {mean}");
    }
}

/// The density of photons of a point light on a plane is its irradiance I cos/r²: radiance albedo/π I/h² below it.
#[test]
fn density_is_irradiance() {
    let mut m = Maker::default();
    let gray = m.diffuse(0.5);
    m.square(4.0, 0.0, gray);
    m.0.emitters.push(Emitter::Point { position: DVec3::new(0.0, 0.0, 2.0), intensity: Vec3::splat(8.0) });
    m.camera(DVec3::new(3.0, 0.0, 1.0), DVec3::ZERO, 1e-3);
    let options = [("gather", "false"), ("direct", "map"), ("neighbours", "400")];
    let (mean, _) = mean(&photons(&m.0, &options, 4));
    let expected = 0.5 / std::f64::consts::PI * 8.0 / 4.0;
    // One estimate of 400 photons: 5 % standard deviation; four of them, a false alarm in 16,000 seeds.
    assert!((mean / expected - 1.0).abs() < 0.2, "{mean} instead of {expected}");
}

#[test]
fn threads_do_not_change_a_bit() {
    let scene = glass_ball(0.3);
    same_for_threads(2, || photons(&scene, &[("photons", "20000")], 4));
}

#[test]
fn options_are_checked() {
    let make = |name: &str, value: &str| {
        integrator::with_options("photonmap", UNLIMITED, &[(name.into(), value.into())]).err().map(|e| e.to_string())
    };
    assert_eq!(make("photons", "7"), None);
    assert!(make("photons", "0").unwrap().contains("from 1"));
    assert!(make("gather", "maybe").unwrap().contains("false or true"));
    assert!(make("direct", "map").unwrap().contains("gather=false"));
    assert!(make("radius", "1").unwrap().contains("neighbours"));
}
