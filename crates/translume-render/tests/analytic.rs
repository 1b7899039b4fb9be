//! Pictures whose values are known: furnaces, lights over planes, slabs; and the promises about seeds, threads and halves.

mod common;

use common::*;
use glam::{DAffine3, DVec3, Vec3};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use translume_bxdf::{Phase, Rgb};
use translume_core::stats;
use translume_render::film::{Aov, Film};
use translume_render::integrator;
use translume_render::render::{Shot, Until};
use translume_render::{World, checkpoint, fingerprint};
use translume_scene::emitter::Emitter;
use translume_scene::material::{Dielectric, Model};
use translume_scene::medium::{Grid, Medium, Samples, Volume};
use translume_scene::texture::{Filter, Wrap};
use translume_scene::{MediumId, Scene};

#[test]
fn furnaces_are_white() {
    for method in ["path", "volpath"] {
        let mut m = Maker::default();
        let white = m.diffuse(1.0);
        m.sphere(DVec3::ZERO, 1.0, white);
        m.constant(0.7);
        m.camera(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, 0.6);
        expect(&film(&m.0, method, UNLIMITED, 64, 1), 0.7, 1e-3);
        // A second light from everywhere is weighed by itself.
        m.constant(0.2);
        expect(&film(&m.0, method, UNLIMITED, 256, 1), 0.9, 3e-3);
        // Inside a closed diffuse sphere that shines: L_e / (1 − albedo).
        let mut m = Maker::default();
        let gray = m.diffuse(0.5);
        let glow = m.gray(1.0);
        let shape = m.sphere(DVec3::ZERO, 1.0, gray);
        (shape.radiance, shape.flip_normals) = (Some(glow), true);
        m.camera(DVec3::new(0.2, -0.3, 0.1), DVec3::X, 1.0);
        expect(&film(&m.0, method, UNLIMITED, 256, 2), 2.0, 5e-3);
    }
}

/// A glass ball in a uniform world is invisible.
#[test]
fn glass_in_a_furnace() {
    let mut m = Maker::default();
    let one = m.gray(1.0);
    let glass = Dielectric { eta: 1.5, specular_reflectance: one, specular_transmittance: one };
    let glass = m.material(Model::Dielectric(glass));
    m.sphere(DVec3::ZERO, 1.0, glass);
    m.constant(1.0);
    m.camera(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, 0.4);
    expect(&film(&m.0, "path", UNLIMITED, 64, 3), 1.0, 2e-3);
}

/// Irradiance under a sphere light at height h: π L r²/h², whatever the sphere's size; a point light I/h².
#[test]
fn lights_over_a_plane() {
    for (method, radius) in [("path", 0.05), ("path", 0.8), ("volpath", 0.8)] {
        let mut m = Maker::default();
        let (gray, black, glow) = (m.diffuse(0.5), m.diffuse(0.0), m.gray(3.0));
        m.square(50.0, 0.0, gray);
        m.sphere(DVec3::new(0.0, 0.0, 2.0), radius, black).radiance = Some(glow);
        m.camera(DVec3::new(3.0, 0.0, 1.0), DVec3::ZERO, 1e-3);
        expect(&film(&m.0, method, UNLIMITED, 64, 4), 0.5 * 3.0 * radius * radius / 4.0, 1e-4);
    }
    let mut m = Maker::default();
    let gray = m.diffuse(0.5);
    m.square(50.0, 0.0, gray);
    m.0.emitters.push(Emitter::Point { position: DVec3::new(0.0, 0.0, 2.0), intensity: Rgb::splat(8.0) });
    m.camera(DVec3::new(3.0, 0.0, 1.0), DVec3::ZERO, 1e-3);
    expect(&film(&m.0, "path", UNLIMITED, 16, 5), 0.5 / std::f64::consts::PI * 8.0 / 4.0, 1e-4);
}

/// The form factor from a point to a parallel square of half edge a at distance h, centred:
/// 4/(2π) · 2 · a/√(a²+h²) · atan(a/√(a²+h²)). Two triangles in a light tree give the same.
#[test]
fn form_factor_of_a_square() {
    let mut m = Maker::default();
    let (gray, black, glow) = (m.diffuse(0.8), m.diffuse(0.0), m.gray(2.0));
    m.square(50.0, 0.0, gray);
    let light = m.square(0.7, 1.5, black);
    (light.radiance, light.flip_normals) = (Some(glow), true);
    m.camera(DVec3::new(3.0, 0.0, 1.0), DVec3::ZERO, 1e-3);
    let (a, h) = (0.7_f64, 1.5_f64);
    let s = a / (a * a + h * h).sqrt();
    let form_factor = 4.0 / std::f64::consts::PI * s * s.atan();
    for (method, seed) in [("path", 6), ("volpath", 7)] {
        expect(&film(&m.0, method, UNLIMITED, 256, seed), 0.8 * 2.0 * form_factor, 1e-4);
    }
}

/// A square of a medium between z = 0 and z = −d under a constant sky; `eta` of its clear boundary (1: none).
fn slab(sigma_a: f32, sigma_s: f32, g: f32, thickness: f64, eta: f32) -> Scene {
    let mut m = Maker::default();
    m.0.media.push(Medium {
        name: String::new(),
        sigma_t: Volume::Constant(Rgb::splat(sigma_a + sigma_s)),
        albedo: Volume::Constant(Rgb::splat(sigma_s / (sigma_a + sigma_s))),
        scale: 1.0,
        phase: if g == 0.0 { Phase::Isotropic } else { Phase::HenyeyGreenstein { g } },
        domain: None,
    });
    let one = m.gray(1.0);
    let boundary = if eta == 1.0 {
        m.material(Model::Null)
    } else {
        m.material(Model::Dielectric(Dielectric { eta, specular_reflectance: one, specular_transmittance: one }))
    };
    m.square(1000.0, 0.0, boundary).interior = Some(MediumId(0));
    let bottom = m.square(1000.0, -thickness as f32, boundary);
    (bottom.interior, bottom.flip_normals) = (Some(MediumId(0)), true);
    m.constant(1.0);
    m.camera(DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO, 1e-3);
    m.0
}

/// Reflected plus transmitted light of slabs; by reciprocity the radiance that leaves along the normal under a sky of one.
#[test]
fn slabs_reflect_and_transmit_what_the_tables_say() {
    // van de Hulst 1980: 0.09739 + 0.66096. Giovanelli 1955: 0.2600 (semi-infinite: nothing gets through).
    expect(&film(&slab(10.0, 90.0, 0.75, 0.02, 1.0), "volpath", UNLIMITED, 512, 8), 0.09739 + 0.66096, 1e-3);
    expect(&film(&slab(10.0, 90.0, 0.0, 4.0, 1.5), "volpath", UNLIMITED, 1024, 9), 0.2600, 2e-3);
}

/// Nothing is lost in a medium that absorbs nothing, homogeneous or not.
#[test]
fn media_in_a_furnace() {
    let values: Vec<f32> = (0..64).map(|i| [0.0, 3.0, 0.5, 1.0, 2.0][i % 5]).collect();
    let grid = Volume::Grid {
        grid: Arc::new(Grid { size: [4, 4, 4], channels: 1, values }),
        world_from_grid: DAffine3::from_scale_rotation_translation(
            DVec3::splat(2.0),
            glam::DQuat::IDENTITY,
            DVec3::splat(-1.0),
        ),
        samples: Samples::Centers,
        filter: Filter::Bilinear,
        wrap: Wrap::Clamp,
    };
    for sigma_t in [Volume::Constant(Rgb::new(0.3, 2.0, 6.0)), grid] {
        let mut m = Maker::default();
        m.0.media.push(Medium {
            name: String::new(),
            sigma_t,
            albedo: Volume::Constant(Rgb::ONE),
            scale: 1.0,
            phase: Phase::HenyeyGreenstein { g: 0.4 },
            domain: None,
        });
        let null = m.material(Model::Null);
        m.sphere(DVec3::ZERO, 1.0, null).interior = Some(MediumId(0));
        m.constant(1.0);
        m.camera(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, 0.4);
        expect(&film(&m.0, "volpath", UNLIMITED, 256, 10), 1.0, 2e-3);
    }
}

#[test]
fn methods_agree_and_halves_differ_by_noise_alone() {
    let scene = room();
    let a = estimates(&film(&scene, "path", UNLIMITED, 512, 11));
    let b = estimates(&film(&scene, "path", UNLIMITED, 512, 12));
    let c = estimates(&film(&scene, "volpath", UNLIMITED, 512, 13));
    stats::compare_pictures(&a, &b, 1e-3, 1e-3).unwrap();
    stats::compare_pictures(&a, &c, 1e-3, 1e-3).unwrap();
}

#[test]
fn threads_do_not_change_a_bit() {
    let scene = room();
    let one = same_for_threads(4, || film(&scene, "path", UNLIMITED, 20, 14));
    assert_ne!(one, film(&scene, "path", UNLIMITED, 20, 15));
}

#[test]
fn a_resumed_render_ends_in_the_same_bits() {
    let scene = room();
    let identity = checkpoint::Identity { fingerprint: fingerprint(&scene, "x"), seed: 16 };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("state.tlck");
    checkpoint::write(&path, &film(&scene, "path", UNLIMITED, 7, 16), &identity).unwrap();
    let world = World::new(Arc::new(scene.clone())).unwrap();
    let integrator = integrator::by_name("path", UNLIMITED).unwrap();
    let shot = Shot::new(&world, &*integrator, &scene.sensors[0], None, 16);
    let empty = || Film::new(shot.size(), &[Aov::Variance]).unwrap();
    let mut resumed = empty();
    checkpoint::read(&path, &mut resumed, &identity).unwrap();
    shot.render(&mut resumed, &Until { samples: 20, time: None }, &AtomicBool::new(false), &mut |_, _| {});
    assert_eq!(resumed, film(&scene, "path", UNLIMITED, 20, 16));

    // Another seed, another scene, other features, and damage are refused.
    let other = checkpoint::Identity { seed: 17, ..identity };
    assert!(checkpoint::read(&path, &mut empty(), &other).unwrap_err().to_string().contains("begun with seed"));
    let mut changed = scene.clone();
    changed.shapes[0].world_from_object.translation.z += 1.0;
    let other = checkpoint::Identity { fingerprint: fingerprint(&changed, "x"), ..identity };
    assert!(checkpoint::read(&path, &mut empty(), &other).unwrap_err().to_string().contains("another scene"));
    assert!(checkpoint::read(&path, &mut Film::new([8, 8], &[]).unwrap(), &identity).is_err());
    let bytes = std::fs::read(&path).unwrap();
    for cut in [0, 5, 30, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..cut]).unwrap();
        assert!(checkpoint::read(&path, &mut empty(), &identity).is_err(), "cut at {cut}");
    }
}

/// What a camera measures is what light paths measure that reach it: importance is the density of the camera's rays.
#[test]
fn importance_is_that_of_the_rays() {
    use translume_core::rng::Pcg32;
    let mut m = Maker::default();
    m.camera(DVec3::new(0.3, -2.0, 1.0), DVec3::new(0.0, 0.0, 0.2), 0.8);
    let camera = translume_render::camera::Camera::new(&m.0.sensors[0], [64, 48]);
    // The splats of a wall of radiance 1, seen wholly, sum to one per pixel that sees it.
    let mut rng = Pcg32::new(3, 0);
    let (n, size) = (400_000, 8.0_f32);
    let mut sum = 0.0_f64;
    for _ in 0..n {
        let p = Vec3::new((rng.next_f32() - 0.5) * size, 3.0, (rng.next_f32() - 0.5) * size);
        if let Some(s) = camera.sample_importance(p, glam::Vec2::ZERO, 0.0) {
            let ray = camera.ray(s.film, glam::Vec2::ZERO);
            assert!((ray.d + s.wi).length() < 1e-4, "{} {}", ray.d, s.wi);
            sum += f64::from(s.weight * s.wi.y.abs());
        }
    }
    let pixels = sum * f64::from(size * size) / f64::from(n);
    let seen = (0..64 * 48)
        .filter(|i| {
            let ray = camera.ray(glam::Vec2::new((i % 64) as f32 + 0.5, (i / 64) as f32 + 0.5), glam::Vec2::ZERO);
            let p = ray.at((3.0 - ray.o.y) / ray.d.y);
            p.x.abs() < size / 2.0 && p.z.abs() < size / 2.0
        })
        .count();
    assert!((pixels / seen as f64 - 1.0).abs() < 0.02, "{pixels} {seen}");
}
