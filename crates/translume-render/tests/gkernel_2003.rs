//! The generalized kernel method as it was published, against known values and `path`. It is biased where surfaces end or are bent: the
//! slack of each test says by how much it may be off.

mod common;

use common::*;
use translume_render::film::Film;
use translume_render::integrator::{self, Integrator};
use translume_scene::Scene;

fn method(options: &[(&str, &str)]) -> Box<dyn Integrator> {
    let options: Vec<(String, String)> = options.iter().map(|o| (o.0.to_owned(), o.1.to_owned())).collect();
    integrator::with_options("gkernel-2003", UNLIMITED, &options).unwrap()
}

fn kernel(scene: &Scene, options: &[(&str, &str)], steps: u64) -> Film {
    film_by(scene, &*method(options), steps, 5)
}

/// Mean of independent pictures over what is right, and its standard error.
fn relative(scene: &Scene, expected: f64, options: &[(&str, &str)]) -> (f64, f64) {
    let means = means(scene, "gkernel-2003", options, 24);
    let n = means.len() as f64;
    let mean = means.iter().sum::<f64>() / n;
    let error = (means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (n * (n - 1.0))).sqrt();
    println!("{} ± {}", mean / expected, error / expected);
    (mean / expected, error / expected)
}

/// Where a floor is flat and its edge far links have no bias, and in a furnace little. Each z is beyond 4 in one of 16,000 runs.
#[test]
fn known_radiances() {
    for ((scene, expected), slack) in [(flat(), 0.0), (furnace(), 0.005)] {
        let (mean, error) = relative(&scene, expected, &[("light-paths", "5000")]);
        assert!((mean - 1.0).abs() < slack + 4.0 * error, "{mean} ± {error}");
    }
}

/// Light by several surfaces: weights that forgot a technique, or counted one twice, would be off by a tenth and more.
#[test]
fn all_bounces_as_path() {
    let scene = corner();
    let (path, path_error) = mean(&film(&scene, "path", UNLIMITED, 1 << 13, 6));
    let (ours, error) = relative(&scene, path, &[("light-paths", "2000"), ("eye-paths", "4")]);
    let allowed = 0.01 + 4.0 * (error * error + (path_error / path).powi(2)).sqrt();
    assert!(allowed < 0.05, "too noisy to tell, {error}");
    assert!((ours - 1.0).abs() < allowed, "{ours} ± {error}");
}

/// Eq. 6 is approximated by a disc, half of which is not there at the edge of a floor.
#[test]
fn edges_are_too_dark() {
    let (scene, expected) = floor_edge();
    let (ours, error) = relative(&scene, expected, &[("light-paths", "5000")]);
    assert!(ours + 4.0 * error < 0.85, "{ours} ± {error}");
}

/// Every step has the same camera paths: a picture of lights alone is the same after one step and after eight, and another one with more paths a pixel.
#[test]
fn one_set_of_camera_paths_for_all_steps() {
    let mut m = Maker::default();
    let (black, glow) = (m.diffuse(0.0), m.gray(1.0));
    m.square(1.0, 0.0, black).radiance = Some(glow);
    m.camera(glam::DVec3::new(0.3, 0.5, 6.0), glam::DVec3::new(0.1, 0.2, 0.0), 32_f32.to_radians());
    let of = |eye_paths, samples| kernel(&m.0, &[("light-paths", "1000"), ("eye-paths", eye_paths)], samples).rgb();
    assert_eq!(of("1", 1), of("1", 8));
    assert_eq!(of("4", 4), of("4", 16));
    assert_ne!(of("1", 8), of("4", 8));
}

/// Trial links are asked for by what was unoccluded in the steps before: 2 M of them at first, later as many as give M unoccluded ones.
#[test]
fn vertices_get_as_many_unoccluded_links_as_they_should() {
    let scene = corner();
    let counts = |steps| {
        let method = method(&[("light-paths", "5000"), ("links", "4")]);
        film_by(&scene, &*method, steps, 5);
        let facts = method.facts();
        ["candidates", "requested", "unoccluded"]
            .map(|name| facts.iter().find(|f| f.0 == format!("{name}_per_eye_vertex")).unwrap().1)
    };
    let (first, later) = (counts(1), counts(64));
    println!("{first:?} {later:?}");
    assert!(first[0] > 16.0, "too few candidates to tell: {first:?}");
    assert!(first[2] > 5.0, "{first:?}");
    assert!((later[2] - 4.0).abs() < 0.5 && later[1] > later[2], "{later:?}");
}

#[test]
fn threads_do_not_matter_and_options_do() {
    let scene = room();
    same_for_threads(3, || kernel(&scene, &[], 3).rgb());
    assert_ne!(kernel(&scene, &[("links", "2")], 2).rgb(), kernel(&scene, &[], 2).rgb());
    let wrong = [("links".to_owned(), "0".to_owned())];
    assert!(integrator::with_options("gkernel-2003", UNLIMITED, &wrong).is_err());
}
