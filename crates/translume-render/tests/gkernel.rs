//! The generalized kernel method against `path` and against known values. Its normalisation is nearly, not quite, unbiased:
//! the slack of each test says by how much it may be off.

mod common;

use common::*;
use glam::{DAffine2, DVec2, DVec3, Vec3};
use translume_bxdf::Distribution;
use translume_render::film::Film;
use translume_render::integrator::{self, Settings};
use translume_scene::emitter::Emitter;
use translume_scene::material::{Conductor, Model, Roughness};
use translume_scene::texture::{Checkerboard, Texture};
use translume_scene::{Scene, TextureId};

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

#[test]
fn a_closed_furnace() {
    let (scene, expected) = furnace();
    let (mean, _) = mean(&kernel(&scene, &[], 16));
    assert!((mean - expected).abs() < 0.04, "{mean}");
}

/// A plane below a point light: radiance albedo/π I/h². A kernel estimate would blur it, a link asks the light itself.
#[test]
fn direct_light_is_exact_where_it_is_flat() {
    let (scene, expected) = flat();
    let (mean, _) = mean(&kernel(&scene, &[("light-paths", "20000")], 32));
    assert!((mean / expected - 1.0).abs() < 0.05, "{mean} instead of {expected}");
}

/// At the edge of a floor the method of 2003 loses nearly half of the light (`tests/gkernel_2003.rs`), this one does not.
#[test]
fn edges_are_as_bright_as_the_rest() {
    let (scene, expected) = floor_edge();
    let ours = mean(&kernel(&scene, &[("light-paths", "5000")], 32)).0 / expected;
    assert!((ours - 1.0).abs() < 0.08, "{ours}");
}

#[test]
fn threads_do_not_matter_and_options_do() {
    let scene = room();
    same_for_threads(3, || kernel(&scene, &[], 2).rgb());
    assert_ne!(kernel(&scene, &[("light-paths", "1000")], 2).rgb(), kernel(&scene, &[], 2).rgb());
    for wrong in [[("unbiased", "maybe"), ("links", "5")], [("caustics", "true"), ("unbiased", "true")]] {
        let wrong = wrong.map(|(name, value)| (name.to_owned(), value.to_owned()));
        assert!(integrator::with_options("gkernel", UNLIMITED, &wrong).is_err(), "{wrong:?}");
    }
    let error = |name: &str| {
        let gone = [(name.to_owned(), "true".to_owned())];
        integrator::with_options("gkernel", UNLIMITED, &gone).err().unwrap().to_string()
    };
    assert!(error("printed").contains("`gkernel-2003`"), "{}", error("printed"));
    assert!(error("correlation").contains("0006-shared-camera-paths"), "{}", error("correlation"));
    assert!(error("prited").contains("has no option `prited`; it has:"), "{}", error("prited"));
}

/// Lamps that stand just over the floor, beside a ball.
fn grazing() -> Scene {
    let mut m = Maker::default();
    let (gray, black, glow) = (m.diffuse(0.5), m.diffuse(0.0), m.gray(50.0));
    m.square(4.0, 0.0, gray);
    m.sphere(DVec3::new(0.5, 0.3, 0.3), 0.3, gray);
    m.sphere(DVec3::new(-0.5, 0.0, 0.1), 0.05, black).radiance = Some(glow);
    m.camera(DVec3::new(0.0, -3.0, 1.5), DVec3::new(0.3, 0.0, 0.0), 25_f32.to_radians());
    m.0
}

/// A brushed metal floor between a lamp and a wall of balls.
fn glossy() -> Scene {
    let mut m = Maker::default();
    let (gray, black, glow) = (m.diffuse(0.5), m.diffuse(0.0), m.gray(20.0));
    let (zero, one, alpha) = (m.gray(0.0), m.gray(1.0), m.gray(0.25));
    let conductor = Conductor { eta: zero, k: one, specular_reflectance: one };
    let roughness = Roughness { distribution: Distribution::Ggx, alpha_u: alpha, alpha_v: alpha };
    let metal = m.material(Model::RoughConductor { conductor, roughness });
    m.square(2.0, 0.0, metal);
    m.sphere(DVec3::new(0.6, 0.0, 0.4), 0.4, gray);
    m.sphere(DVec3::new(-0.8, 0.0, 0.6), 0.2, black).radiance = Some(glow);
    m.camera(DVec3::new(0.0, -3.0, 1.5), DVec3::new(0.2, 0.0, 0.2), 30_f32.to_radians());
    m.0
}

/// A floor, and over it a sheet with holes, under a lamp.
fn sheet() -> Scene {
    let mut m = Maker::default();
    let (gray, black, glow) = (m.diffuse(0.5), m.diffuse(0.0), m.gray(5.0));
    let (hole, whole) = (m.gray(0.0), m.gray(1.0));
    let board_from_uv = DAffine2::from_scale(DVec2::splat(8.0));
    m.0.textures.push(Texture::Checkerboard(Checkerboard { color0: hole, color1: whole, board_from_uv }));
    let opacity = TextureId(m.0.textures.len() - 1);
    let holes = m.material(Model::Mask { opacity, nested: gray });
    let holes = m.material(Model::TwoSided { front: holes, back: holes });
    m.square(1.0, 0.0, gray);
    m.square(0.7, 0.15, holes);
    let light = m.square(0.1, 1.0, black);
    (light.radiance, light.flip_normals) = (Some(glow), true);
    m.camera(DVec3::new(2.5, 0.0, 2.0), DVec3::ZERO, 25_f32.to_radians());
    m.0
}

/// Each z is beyond 4 in one of 16,000 runs.
#[test]
fn the_unbiased_method_agrees_with_path() {
    let few = [("unbiased", "true"), ("light-paths", "3000")];
    // Without emitter sampling the links carry everything.
    let alone = ("emitters", "false");
    let ways = [few.to_vec(), [&few[..], &[alone]].concat()];
    for (name, scene) in [
        ("edge", edge()),
        ("grazing", grazing()),
        ("glossy", glossy()),
        ("caustic", glass_ball(1.5)),
        ("sheet", sheet()),
    ] {
        for way in &ways {
            let z = deviation(&scene, "gkernel", way, 24);
            assert!(z.abs() < 4.0, "{name}, {way:?}: {z}");
        }
    }
}

/// Mean of the differences between pictures of the same seeds, and its standard error.
fn difference(a: &[f64], b: &[f64]) -> (f64, f64) {
    let differences: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    let n = differences.len() as f64;
    let mean = differences.iter().sum::<f64>() / n;
    let error = (differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n * (n - 1.0))).sqrt();
    (mean, error)
}

/// What camera paths share must count once: links to where others go on, and paths that go on alone. Beside pictures of the same seeds, which
/// have the same first vertices, that share nothing. Each z is beyond 4 in one of 16,000 runs.
#[test]
fn shared_paths_count_once() {
    let scene = corner();
    for links in ["1", "20"] {
        let way = |shared, sharers| {
            let few = [("unbiased", "true"), ("light-paths", "1000"), ("links", links)];
            means(&scene, "gkernel", &[&few[..], &[("shared", shared), ("sharers", sharers)]].concat(), 24)
        };
        let alone = way("1", "1");
        for (shared, sharers) in [("4", "1"), ("4", "4"), ("16", "64")] {
            let (mean, error) = difference(&way(shared, sharers), &alone);
            println!("{shared} {sharers} {links}: {mean} ± {error}, z {} of {}", mean / error, alone[0]);
            assert!(mean.abs() < 4.0 * error, "{shared} {sharers} {links}: {mean} ± {error}");
        }
    }
}

/// A floor that gets all its light from the underside of a low shelf, which a lamp lights from below. Pixels under the shelf find that light
/// often, those beside it hardly ever.
fn shelf() -> Scene {
    let mut m = Maker::default();
    let (gray, black, glow) = (m.diffuse(0.5), m.diffuse(0.0), m.gray(80.0));
    m.square(1.0, 0.0, gray);
    m.square(0.3, 0.15, gray).flip_normals = true;
    m.square(0.05, 1e-3, black).radiance = Some(glow);
    m.camera(DVec3::new(3.0, 0.0, 2.0), DVec3::new(0.35, 0.0, 0.0), 0.2);
    m.0
}

/// A pixel that finds a place more often than the one carrier does looks there for itself, and its links must know that: with the weights of the
/// carrier they would make this picture a third too bright. Beside pictures that share nothing, as above. z is beyond 4 in one of 4,000 runs
/// (Student's distribution for 48 pictures).
#[test]
fn links_know_what_carriers_hardly_find() {
    let scene = shelf();
    let way = |shared, sharers| {
        let few = [("unbiased", "true"), ("light-paths", "1000"), ("links", "20")];
        means(&scene, "gkernel", &[&few[..], &[("shared", shared), ("sharers", sharers)]].concat(), 48)
    };
    let alone = way("1", "1");
    let (mean, error) = difference(&way("16", "256"), &alone);
    println!("{mean} ± {error}, z {} of {}", mean / error, alone[0]);
    assert!(error < 0.03 * alone[0], "too noisy to tell: {error} of {}", alone[0]);
    assert!(mean.abs() < 4.0 * error, "{mean} ± {error}");
}

/// White and nearly black tiles in the shade of a table, whose underside sees the lit floor around: all light comes by at least two more surfaces.
fn shade() -> Scene {
    let mut m = Maker::default();
    let (bright, dark) = (m.gray(0.8), m.gray(0.02));
    let board_from_uv = DAffine2::from_scale(DVec2::splat(20.0));
    m.0.textures.push(Texture::Checkerboard(Checkerboard { color0: bright, color1: dark, board_from_uv }));
    let tiles = m.material(Model::Diffuse { reflectance: TextureId(m.0.textures.len() - 1) });
    let white = m.material(Model::Diffuse { reflectance: bright });
    m.square(0.25, 1e-3, tiles);
    m.square(4.0, 0.0, white);
    m.square(0.5, 0.5, white).flip_normals = true;
    m.0.emitters.push(Emitter::Point { position: DVec3::new(0.0, 0.0, 3.0), intensity: Vec3::splat(8.0) });
    m.camera(DVec3::new(0.0, 0.0, 0.45), DVec3::ZERO, 0.15);
    m.0
}

/// Paths of dark tiles bring light to the white ones beside them. Roulette must not go by what the dark tile took: the few paths that it lets
/// live would be fireflies. Variance over that without roulette: with 60 seeds and half as many steps it was 1.0 to 1.4, and 5 to 63
/// when roulette remembered.
#[test]
fn roulette_forgets_dark_tiles() {
    let scene = shade();
    let options = [("light-paths".to_owned(), "200".to_owned())];
    let variance = |rr_depth| {
        let settings = Settings { rr_depth, max_depth: Some(4), ..UNLIMITED };
        let film = film_by(&scene, &*integrator::with_options("gkernel", settings, &options).unwrap(), 2048, 5);
        estimates(&film).iter().map(|e| e.variance).sum::<f64>()
    };
    let (with, without) = (variance(2), variance(5));
    println!("{with} and {without}, ratio {}", with / without);
    assert!(with < 2.5 * without, "{with} and {without}");
}

/// The silhouette of a light that is seen is found with more rays, in pixels that neighbours point out: beside `path` with as many samples.
#[test]
fn silhouettes_of_lights_are_smooth_soon() {
    let mut m = Maker::default();
    let (black, glow) = (m.diffuse(0.0), m.gray(100.0));
    m.square(1.0, 0.0, black).radiance = Some(glow);
    m.camera(DVec3::new(0.3, 0.5, 6.0), DVec3::new(0.1, 0.2, 0.0), 32_f32.to_radians());
    let reference = estimates(&film(&m.0, "path", UNLIMITED, 1 << 12, 6));
    let squares = |method, seed| {
        let ours = film(&m.0, method, UNLIMITED, 4, seed);
        let pairs = estimates(&ours).into_iter().zip(&reference);
        pairs.map(|(a, b)| (a.mean - b.mean).powi(2)).sum::<f64>()
    };
    let rms = |method| (1..=16).map(|seed| squares(method, seed)).sum::<f64>().sqrt();
    let (ours, path) = (rms("gkernel"), rms("path"));
    assert!(ours < 0.4 * path, "{ours} and {path}");
}

/// Photons that glass focuses are merged: the picture that bdpt makes, nearer to it than by paths that must meet the lamp.
#[test]
fn caustics_are_merged() {
    let scene = glass_ball(0.1);
    let reference = film(&scene, "bdpt", UNLIMITED, 1 << 12, 6);
    let of = |caustics| kernel(&scene, &[("caustics", caustics), ("light-paths", "20000")], 64);
    let (with, without) = (of("true"), of("false"));
    let rms = |film: &Film| {
        let pairs = estimates(film).into_iter().zip(estimates(&reference));
        pairs.map(|(a, b)| (a.mean - b.mean).powi(2)).sum::<f64>().sqrt()
    };
    assert!(rms(&with) < 0.5 * rms(&without), "{} and {}", rms(&with), rms(&without));
    let ((bdpt, error), (ours, noise)) = (mean(&reference), mean(&with));
    assert!((ours - bdpt).abs() < 0.03 * bdpt + 4.0 * (error + noise), "{ours} ± {noise} instead of {bdpt} ± {error}");
}
