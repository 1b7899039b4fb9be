//! Light-stage pictures: their sum is what `path` renders under all lamps at once, and each lamp stands where it is said to.

mod common;

use common::{Maker, UNLIMITED, estimates, film, room};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use translume_bxdf::{Distribution, Rgb};
use translume_core::stats::{Estimate, compare_pictures};
use translume_render::World;
use translume_render::integrator::{Path, Settings};
use translume_render::light_stage::{Lamps, Params, Pictures, render, spread, to_world, unlit};
use translume_render::render::Shot;
use translume_scene::emitter::Emitter;
use translume_scene::material::{Conductor, Model, Roughness};
use translume_scene::{Geometry, Scene};

/// [`room`] without its lights, with a mirror ball.
fn dark_room() -> Scene {
    let (mut scene, put_out) = unlit(&room());
    assert_eq!(put_out, 2);
    let mut m = Maker(std::mem::take(&mut scene));
    let (eta, k, one) = (m.gray(0.0), m.gray(1.0), m.gray(1.0));
    let mirror = m.material(Model::Conductor(Conductor { eta, k, specular_reflectance: one }));
    m.sphere(DVec3::new(0.3, -0.9, 0.4), 0.4, mirror);
    m.0
}

fn pictures(scene: &Scene, lamps: &Lamps, settings: Settings, spp: u64, seed: u64) -> Pictures {
    let world = World::dark(Arc::new(scene.clone())).unwrap();
    let method = Path::new(settings);
    let shot = Shot::new(&world, &method, &scene.sensors[0], None, seed);
    let params = Params { settings, samples: spp, clamp: f32::INFINITY };
    render(&shot, lamps, &params, &AtomicBool::new(false), &|| ()).unwrap().unwrap()
}

/// Mean and variance, by pixel, of the green of the sum over all lamps, from 32 independent renders.
fn summed(scene: &Scene, lamps: &Lamps, settings: Settings, spp: u64) -> Vec<Estimate> {
    const RUNS: u64 = 32;
    let mut all: Vec<Vec<f64>> = Vec::new();
    for seed in 0..RUNS {
        let found = pictures(scene, lamps, settings, spp, 100 + seed);
        assert_eq!(found.broken, 0);
        let mut sum = vec![0.0; 64];
        for i in 0..lamps.len() {
            let picture = found.picture(i);
            sum.iter_mut().zip(picture.chunks(3)).for_each(|(s, p)| *s += f64::from(p[1]));
        }
        all.push(sum);
    }
    let estimate = |p: usize| {
        let mean = all.iter().map(|r| r[p]).sum::<f64>() / RUNS as f64;
        let variance = all.iter().map(|r| (r[p] - mean).powi(2)).sum::<f64>() / (RUNS * (RUNS - 1)) as f64;
        Estimate { mean, variance }
    };
    (0..64).map(estimate).collect()
}

/// False alarms: one in a thousand (each case; the seeds are fixed).
#[test]
fn the_sum_is_what_path_renders_under_all_lamps() {
    let settings = Settings { hide_emitters: true, ..UNLIMITED };
    let directions: Vec<Vec3> = [[0.3, -0.5, 0.8], [-0.9, 0.1, 0.3], [0.2, 0.9, 0.2], [0.5, -0.8, -0.3]]
        .map(|d| Vec3::from(d).normalize())
        .to_vec();
    for radius in [0.0f32, 0.1] {
        let dark = dark_room();
        let mut m = Maker(dark.clone());
        for d in &directions {
            if radius == 0.0 {
                m.0.emitters.push(Emitter::Directional { direction: -d.as_dvec3(), irradiance: Rgb::splat(2.0) });
                continue;
            }
            // A disc of that angular radius, far away, facing the scene.
            let (z, far) = (-d.as_dvec3(), 1e4);
            let x = z.any_orthonormal_vector();
            let axes = DMat3::from_cols(x, z.cross(x), z) * (far * f64::from(radius.tan()));
            let place = DAffine3::from_mat3_translation(axes, -z * far);
            let (black, glow) = (m.diffuse(0.0), m.gray(2.0 / (std::f32::consts::PI * radius.sin().powi(2))));
            m.shape(Geometry::Disk, place, black).radiance = Some(glow);
        }
        let all = estimates(&film(&m.0, "path", settings, 4096, 7));
        let lamps = Lamps::new(directions.clone(), radius, 2.0).unwrap();
        let ours = summed(&dark, &lamps, settings, 64);
        compare_pictures(&all, &ours, 2e-3, 1e-3).unwrap_or_else(|e| panic!("radius {radius}: {e}"));
        // Were the mirror not to see the lamps, the test would not mind much; were one lamp missing, it would.
        let fewer = Lamps::new(directions[1..].to_vec(), radius, 2.0).unwrap();
        assert!(compare_pictures(&all, &summed(&dark, &fewer, settings, 64), 2e-3, 1e-3).is_err());
    }
}

#[test]
fn a_mirror_ball_shows_the_lamp_where_it_stands() {
    let mut m = Maker::default();
    let (eta, k, one) = (m.gray(0.0), m.gray(1.0), m.gray(1.0));
    let mirror = m.material(Model::Conductor(Conductor { eta, k, specular_reflectance: one }));
    m.sphere(DVec3::new(1.0, 2.0, 3.0), 1.0, mirror);
    // So far away that rays are nearly parallel; not along any axis.
    let eye = DVec3::new(1.0, 2.0, 3.0) + DVec3::new(40.0, -30.0, 20.0);
    m.camera(eye, DVec3::new(1.0, 2.0, 3.0), 2.0 * (1.0 / eye.distance(DVec3::new(1.0, 2.0, 3.0))).asin() as f32);
    m.0.sensors[0].film.size = [64, 64];
    let wanted = [[0.5f32, 0.0, 0.6], [0.0, 0.7, 0.5], [-0.4, -0.3, 0.9], [0.3, -0.9, -0.2]];
    let wanted = wanted.map(|d| Vec3::from(d).normalize());
    let lamps = Lamps::new(to_world(&m.0.sensors[0], &wanted), 0.12, 1.0).unwrap();
    let found = pictures(&m.0, &lamps, UNLIMITED, 4, 1);
    for (i, light) in wanted.iter().enumerate() {
        let picture = found.picture(i);
        let (mut sum, mut at) = (0.0, glam::Vec2::ZERO);
        for (j, p) in picture.chunks(3).enumerate() {
            let place = glam::Vec2::new((j % 64) as f32 + 0.5, (j / 64) as f32 + 0.5) / 32.0 - 1.0;
            sum += p[1];
            at += p[1] * place;
        }
        // The normal is half way between the light and the eye; y of the picture goes down.
        let n = (*light + Vec3::Z).normalize();
        let at = at / sum;
        assert!((at - glam::Vec2::new(n.x, -n.y)).length() < 0.03, "{light}: {at} for {n}");
    }
}

#[test]
fn a_lamp_gives_paper_its_irradiance_and_does_not_know_the_others() {
    let mut m = Maker::default();
    let paper = m.diffuse(0.5);
    m.square(10.0, 0.0, paper);
    m.camera(DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO, 0.3);
    let directions = spread(9, true);
    let world = to_world(&m.0.sensors[0], &directions);
    let radius = 0.02;
    let all = pictures(&m.0, &Lamps::new(world.clone(), radius, 3.0).unwrap(), UNLIMITED, 16, 5);
    let some = pictures(&m.0, &Lamps::new(world[4..].to_vec(), radius, 3.0).unwrap(), UNLIMITED, 16, 5);
    for (i, d) in directions.iter().enumerate() {
        let mean = all.picture(i).iter().sum::<f32>() / (3.0 * 64.0);
        let expected = 0.5 / std::f32::consts::PI * 3.0 * d.z;
        assert!((mean / expected - 1.0).abs() < 0.01, "{d}: {mean} for {expected}");
        assert!(i < 4 || all.picture(i) == some.picture(i - 4));
    }
    assert!(Lamps::new(world, 2.0, 1.0).is_err());
}

/// Glossy metal alone: all light is direct, drawn by either technique, and no limit on indirect light changes it.
#[test]
fn the_limit_leaves_direct_light_alone() {
    let mut m = Maker::default();
    let (gray, one) = (m.diffuse(0.7), m.gray(1.0));
    let (eta, k) = (m.gray(0.0), m.gray(1.0));
    let conductor = Conductor { eta, k, specular_reflectance: one };
    let alpha = m.gray(0.1);
    let roughness = Roughness { alpha_u: alpha, alpha_v: alpha, distribution: Distribution::Ggx };
    let metal = m.material(Model::RoughConductor { conductor, roughness });
    m.sphere(DVec3::ZERO, 1.0, metal);
    m.camera(DVec3::new(0.0, -5.0, 1.0), DVec3::ZERO, 0.5);
    let shot = |scene: &Scene, clamp: f32| {
        let world = World::dark(Arc::new(scene.clone())).unwrap();
        let method = Path::new(UNLIMITED);
        let shot = Shot::new(&world, &method, &scene.sensors[0], None, 3);
        let lamps = Lamps::new(to_world(&scene.sensors[0], &spread(4, true)), 0.1, 3.0).unwrap();
        let params = Params { settings: UNLIMITED, samples: 16, clamp };
        let found = render(&shot, &lamps, &params, &AtomicBool::new(false), &|| ()).unwrap().unwrap();
        (0..4).flat_map(|i| found.picture(i)).collect::<Vec<f32>>()
    };
    let free = shot(&m.0, f32::INFINITY);
    assert!(free.iter().any(|v| *v > 1.0) && free == shot(&m.0, 1e-3));
    // With a table there is indirect light, which the limit takes.
    m.square(5.0, -1.0, gray);
    let (free, limited) = (shot(&m.0, f32::INFINITY), shot(&m.0, 1e-3));
    assert!(free != limited && free.iter().zip(&limited).all(|(a, b)| b <= a));
}

#[test]
fn lamps_are_spread_evenly() {
    for (hemisphere, most) in [(false, 3.0), (true, 2.0)] {
        let n = 253;
        let found = spread(n, hemisphere);
        assert!(found.iter().all(|d| (d.length() - 1.0).abs() < 1e-5 && (!hemisphere || d.z > 0.0)));
        // The nearest neighbour is nowhere much nearer or farther than a hexagonal lattice has it.
        let area = if hemisphere { 2.0 } else { 4.0 } * std::f32::consts::PI / n as f32;
        let lattice = (2.0 * area / 3f32.sqrt()).sqrt();
        for (i, a) in found.iter().enumerate() {
            let nearest = (0..n).filter(|j| *j != i).map(|j| (*a - found[j]).length()).fold(f32::MAX, f32::min);
            assert!(nearest > lattice / most && nearest < 1.3 * lattice, "{i}: {nearest} for {lattice}");
        }
    }
}
