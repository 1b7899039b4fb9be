//! The generalized kernel method against `path` and against known values. Its normalisation is nearly, not quite, unbiased:
//! the slack of each test says by how much it may be off.

mod common;

use common::*;
use glam::{DVec3, Vec3};
use translume_render::film::Film;
use translume_render::integrator;
use translume_scene::Scene;
use translume_scene::emitter::Emitter;

fn kernel(scene: &Scene, options: &[(&str, &str)], steps: u64) -> Film {
    let options: Vec<(String, String)> = options.iter().map(|o| (o.0.to_owned(), o.1.to_owned())).collect();
    film_by(scene, &*integrator::with_options("gkernel", UNLIMITED, &options).unwrap(), steps, 5)
}

#[test]
fn pictures_are_nearly_those_of_path() {
    let scene = room();
    let (path, error) = mean(&film(&scene, "path", UNLIMITED, 4096, 6));
    let (ours, noise) = mean(&kernel(&scene, &[], 24));
    let allowed = 0.02 * path + 4.0 * (error + noise);
    assert!((path - ours).abs() < allowed, "{ours} instead of {path} ± {allowed}");
}

/// Inside a closed diffuse sphere that shines every point has L_e / (1 − albedo).
#[test]
fn a_closed_furnace() {
    let mut m = Maker::default();
    let (gray, glow) = (m.diffuse(0.5), m.gray(1.0));
    let shape = m.sphere(DVec3::ZERO, 1.0, gray);
    (shape.radiance, shape.flip_normals) = (Some(glow), true);
    m.camera(DVec3::new(0.2, -0.3, 0.1), DVec3::X, 1.0);
    let (mean, _) = mean(&kernel(&m.0, &[], 16));
    assert!((mean - 2.0).abs() < 0.04, "{mean}");
}

/// A plane below a point light: radiance albedo/π I/h². A kernel estimate would blur it, a link asks the light itself.
/// The edge of the footprints' disc is far, so the method as printed is right here too.
#[test]
fn direct_light_is_exact_where_it_is_flat() {
    let mut m = Maker::default();
    let gray = m.diffuse(0.5);
    m.square(4.0, 0.0, gray);
    m.0.emitters.push(Emitter::Point { position: DVec3::new(0.0, 0.0, 2.0), intensity: Vec3::splat(8.0) });
    m.camera(DVec3::new(3.0, 0.0, 1.0), DVec3::ZERO, 1e-3);
    let expected = 0.5 / std::f64::consts::PI * 8.0 / 4.0;
    for printed in ["false", "true"] {
        let (mean, _) = mean(&kernel(&m.0, &[("printed", printed), ("light-paths", "20000")], 16));
        assert!((mean / expected - 1.0).abs() < 0.05, "printed={printed}: {mean} instead of {expected}");
    }
}

/// At the edge of a floor the method as printed loses nearly half of the light, ours does not.
#[test]
fn edges_are_as_bright_as_the_rest() {
    let mut m = Maker::default();
    let gray = m.diffuse(0.5);
    m.square(1.0, 0.0, gray);
    m.0.emitters.push(Emitter::Point { position: DVec3::new(0.0, 0.0, 2.0), intensity: Vec3::splat(8.0) });
    // 1 % of the floor's width inside its edge.
    m.camera(DVec3::new(0.98, 0.0, 3.0), DVec3::new(0.98, 0.0, 0.0), 1e-3);
    let (r2, cos) = (4.0 + 0.98 * 0.98, 2.0 / (4.0_f64 + 0.98 * 0.98).sqrt());
    let expected = 0.5 / std::f64::consts::PI * 8.0 * cos / r2;
    let of = |printed| mean(&kernel(&m.0, &[("printed", printed), ("light-paths", "5000")], 32)).0 / expected;
    let (ours, printed) = (of("false"), of("true"));
    assert!((ours - 1.0).abs() < 0.08, "{ours}");
    assert!(printed < 0.85, "{printed}");
}

#[test]
fn threads_do_not_matter_and_options_do() {
    let scene = room();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| kernel(&scene, &[], 2))
    };
    assert_eq!(with(1).rgb(), with(3).rgb());
    assert_ne!(kernel(&scene, &[("light-paths", "1000")], 2).rgb(), kernel(&scene, &[], 2).rgb());
    assert!(integrator::with_options("gkernel", UNLIMITED, &[("printed".into(), "maybe".into())]).is_err());
}
