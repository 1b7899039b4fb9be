//! Scenes at the ends of what numbers can be: equal indices, nested blends, lights and densities as large as they go, places far from
//! the origin, and a render that is told to end.

mod common;

use common::{Maker, UNLIMITED, estimates, expect, film, film_by};
use glam::{DAffine3, DVec3};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use translume_bxdf::{Distribution, Phase, Rgb};
use translume_render::World;
use translume_render::film::Aov;
use translume_render::integrator;
use translume_render::render::{Shot, Until};
use translume_scene::emitter::Emitter;
use translume_scene::material::{Dielectric, Model, Principled, Roughness};
use translume_scene::medium::{Medium, Volume};
use translume_scene::{MaterialId, MediumId, Scene};

/// A ball in a white furnace.
fn furnace(material: impl FnOnce(&mut Maker) -> Model) -> Scene {
    let mut m = Maker::default();
    let model = material(&mut m);
    let id = m.material(model);
    m.sphere(DVec3::ZERO, 1.0, id);
    m.constant(1.0);
    m.camera(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, 0.4);
    m.0
}

fn glass(m: &mut Maker, eta: f32) -> Dielectric {
    let one = m.gray(1.0);
    Dielectric { eta, specular_reflectance: one, specular_transmittance: one }
}

fn frosted(m: &mut Maker, eta: f32, alpha: f32) -> Model {
    let alpha = m.gray(alpha);
    let roughness = Roughness { distribution: Distribution::Beckmann, alpha_u: alpha, alpha_v: alpha };
    Model::RoughDielectric { dielectric: glass(m, eta), roughness }
}

/// Nothing bends, nothing is lost; and nearly nothing where indices nearly agree.
#[test]
fn equal_indices_in_a_furnace() {
    for method in ["path", "volpath", "bdpt", "gkernel", "photonmap"] {
        for eta in [1.0, 1.000_05, 1.0003, 1.002] {
            let slack = if eta == 1.0 { 1e-5 } else { 0.01 };
            expect(&film(&furnace(|m| frosted(m, eta, 0.1)), method, UNLIMITED, 64, 1), 1.0, slack);
        }
        expect(&film(&furnace(|m| frosted(m, 1.0, 0.0)), method, UNLIMITED, 64, 1), 1.0, 1e-5);
        expect(&film(&furnace(|m| Model::Dielectric(glass(m, 1.0))), method, UNLIMITED, 64, 2), 1.0, 1e-5);
        expect(&film(&furnace(|m| Model::ThinDielectric(glass(m, 1.0))), method, UNLIMITED, 64, 3), 1.0, 1e-5);
        expect(&film(&furnace(|m| principled(m, 1.0)), method, UNLIMITED, 64, 4), 1.0, 0.01);
        // The healthy twin: what bends keeps what it kept.
        expect(&film(&furnace(|m| Model::Dielectric(glass(m, 1.5))), method, UNLIMITED, 64, 5), 1.0, 0.01);
    }
}

fn principled(m: &mut Maker, eta: f32) -> Model {
    let (zero, one, rough) = (m.gray(0.0), m.gray(1.0), m.gray(0.3));
    Model::Principled(Box::new(Principled {
        base_color: one,
        roughness: rough,
        anisotropic: zero,
        metallic: zero,
        spec_trans: one,
        eta,
        spec_tint: zero,
        sheen: zero,
        sheen_tint: zero,
        flatness: zero,
        clearcoat: zero,
        clearcoat_gloss: zero,
    }))
}

/// A light behind a surface of equal indices shines through it, by emitter sampling too.
#[test]
fn lights_shine_through_equal_indices() {
    let scene = |eta: Option<f32>| {
        let mut m = Maker::default();
        let floor = m.diffuse(0.8);
        m.square(10.0, 0.0, floor);
        if let Some(eta) = eta {
            let model = frosted(&mut m, eta, 0.2);
            let ball = m.material(model);
            m.sphere(DVec3::new(0.0, 0.0, 1.0), 0.9, ball);
        }
        let intensity = Rgb::splat(10.0);
        m.0.emitters.push(Emitter::Point { position: DVec3::new(0.0, 0.0, 1.0), intensity });
        m.camera(DVec3::new(0.0, -3.0, 0.5), DVec3::new(0.0, -0.5, 0.0), 0.2);
        m.0
    };
    for method in ["path", "bdpt"] {
        let with = common::mean(&film(&scene(Some(1.0)), method, UNLIMITED, 64, 1)).0;
        let without = common::mean(&film(&scene(None), method, UNLIMITED, 64, 1)).0;
        assert!(without > 0.1 && (with / without - 1.0).abs() < 0.01, "{method}: {with} {without}");
    }
}

/// Blends that refer to each other in 2^30 ways.
#[test]
fn blends_of_blends() {
    let made = |nested: fn(&mut Maker, MaterialId) -> MaterialId, levels: usize| {
        let mut m = Maker::default();
        let (dark, bright, half) = (m.diffuse(0.2), m.diffuse(0.6), m.gray(0.5));
        let mut top = m.material(Model::Blend { weight: half, first: dark, second: bright });
        for _ in 0..levels {
            let (first, second) = (nested(&mut m, top), nested(&mut m, top));
            top = m.material(Model::Blend { weight: half, first, second });
        }
        m.square(10.0, 0.0, top);
        m.constant(1.0);
        m.camera(DVec3::new(0.0, -1.0, 4.0), DVec3::ZERO, 0.2);
        m.0
    };
    expect(&film(&made(|_, id| id, 30), "path", UNLIMITED, 64, 1), 0.4, 1e-3);
    let masked = |m: &mut Maker, id: MaterialId| {
        let opacity = m.gray(0.5);
        m.material(Model::Mask { opacity, nested: id })
    };
    let refused = World::new(Arc::new(made(masked, 30))).err().expect("too many").to_string();
    assert!(refused.contains("nested"), "{refused}");
    assert!(World::new(Arc::new(made(masked, 3))).is_ok());
}

/// A floor under a lamp of this radiance, and its picture over that.
#[test]
fn brightness_has_no_end() {
    let lit = |radiance: f32| {
        let mut m = Maker::default();
        let (floor, black) = (m.diffuse(0.7), m.diffuse(0.0));
        m.square(4.0, 0.0, floor);
        let shine = m.gray(radiance);
        let lamp = m.square(0.5, 2.0, black);
        (lamp.radiance, lamp.flip_normals) = (Some(shine), true);
        m.camera(DVec3::new(0.0, -5.0, 3.0), DVec3::ZERO, 0.3);
        m.0
    };
    for method in ["path", "bdpt", "gkernel"] {
        let [one, bright, dark] = [1.0, 1e20, 1e-20]
            .map(|radiance| common::mean(&film(&lit(radiance), method, UNLIMITED, 64, 1)).0 / f64::from(radiance));
        assert!(
            (bright / one - 1.0).abs() < 0.02 && (dark / one - 1.0).abs() < 0.02,
            "{method}: {one} {bright} {dark}"
        );
    }
}

/// One pixel of the sky as bright as numbers go, the sky's other half seen all the same.
#[test]
fn a_sky_with_a_sun_that_has_no_end() {
    let mut pixels = image_of(64, 32, 1.0);
    pixels[3 * (8 * 64 + 20)..][..3].fill(3e38);
    let picture = translume_image::Rgb32FImage::from_raw(64, 32, pixels).unwrap();
    let mut m = Maker::default();
    let floor = m.diffuse(0.5);
    m.square(1.0, 0.0, floor);
    m.0.emitters.push(Emitter::Environment {
        image: Arc::new(translume_image::Picture::new(picture)),
        scale: Rgb::ONE,
        world_from_light: DAffine3::from_rotation_x(std::f64::consts::FRAC_PI_2),
    });
    m.camera(DVec3::new(0.0, -1.0, 3.0), DVec3::ZERO, 0.2);
    let world = World::new(Arc::new(m.0.clone())).expect("it shines");
    let method = integrator::by_name("path", UNLIMITED).unwrap();
    let shot = Shot::new(&world, &*method, &m.0.sensors[0], None, 1);
    let mut film = shot.film(&[]).unwrap();
    shot.render(&mut film, &Until { samples: 16, time: None }, &AtomicBool::new(false), &mut |_, _| {});
    assert!(film.rgb().iter().all(|v| v.is_finite() && *v > 1e30), "{:?}", &film.rgb()[..6]);
}

fn image_of(w: usize, h: usize, v: f32) -> Vec<f32> {
    vec![v; 3 * w * h]
}

/// The unbiased mode ends far from the origin, with the picture that `path` finds there.
#[test]
fn unbiased_links_far_from_the_origin() {
    let scene = |x: f64| {
        let mut m = Maker::default();
        let (white, black) = (m.diffuse(0.6), m.diffuse(0.0));
        let at = DAffine3::from_translation(DVec3::new(x, 0.0, 0.0));
        m.square(1.0, 0.0, white).world_from_object = at;
        let shine = m.gray(5.0);
        let lamp = m.square(0.4, 1.9, black);
        (lamp.world_from_object, lamp.radiance, lamp.flip_normals) = (at, Some(shine), true);
        let model = Model::Dielectric(glass(&mut m, 1.5));
        let clear = m.material(model);
        m.sphere(DVec3::new(x - 0.4, 0.0, 0.4), 0.4, clear);
        m.sphere(DVec3::new(x + 0.4, 0.0, 0.3), 0.3, white); // touches the floor
        m.camera(DVec3::new(x, -4.0, 1.0), DVec3::new(x, 0.0, 0.5), 0.5);
        m.0
    };
    for x in [0.0, 3000.0] {
        let options = [("unbiased".to_owned(), "true".to_owned())];
        let method = integrator::with_options("gkernel", UNLIMITED, &options).unwrap();
        let (scene, seed) = (scene(x), 3);
        let a = estimates(&film_by(&scene, &*method, 512, seed));
        let b = estimates(&film(&scene, "path", UNLIMITED, 512, seed + 1));
        let [a, b] = [a, b].map(|e| e.iter().map(|e| e.mean).sum::<f64>() / e.len() as f64);
        assert!((a / b - 1.0).abs() < 0.04, "{x}: {a} {b}");
    }
}

/// A render that is told to end does so within a sample, however long that would take, and keeps whole samples only.
#[test]
fn a_render_ends_when_it_is_told_to() {
    let mut m = Maker::default();
    let fog = |sigma: f32| Medium {
        name: String::new(),
        sigma_t: Volume::Constant(Rgb::splat(sigma)),
        albedo: Volume::Constant(Rgb::ONE),
        scale: 1.0,
        phase: Phase::Isotropic,
        domain: None,
    };
    m.0.media.push(fog(30.0));
    let null = m.material(Model::Null);
    m.sphere(DVec3::ZERO, 1.0, null).interior = Some(MediumId(0));
    m.constant(1.0);
    m.camera(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, 0.4);
    let scene = m.0;
    for method in ["volpath", "path", "bdpt", "gkernel", "gkernel-2003", "photonmap"] {
        let mut scene = scene.clone();
        if method != "volpath" {
            scene.shapes[0].interior = None;
        }
        let world = World::new(Arc::new(scene.clone())).unwrap();
        let integrator = integrator::by_name(method, UNLIMITED).unwrap();
        let shot = Shot::new(&world, &*integrator, &scene.sensors[0], None, 1);
        let (mut interrupted, stop) = (shot.film(&[Aov::Depth]).unwrap(), AtomicBool::new(false));
        std::thread::scope(|s| {
            s.spawn(|| {
                std::thread::sleep(Duration::from_millis(60));
                stop.store(true, Ordering::Relaxed);
            });
            shot.render(&mut interrupted, &Until { samples: 1 << 40, time: None }, &stop, &mut |_, _| {});
        });
        let (few, many) = interrupted.samples();
        assert_eq!(few, many, "{method}: one tile");
        let again = integrator::by_name(method, UNLIMITED).unwrap();
        let shot = Shot::new(&world, &*again, &scene.sensors[0], None, 1);
        let mut whole = shot.film(&[Aov::Depth]).unwrap();
        shot.render(&mut whole, &Until { samples: few, time: None }, &AtomicBool::new(false), &mut |_, _| {});
        assert_eq!(interrupted, whole, "{method}: {few} samples");
    }
}
