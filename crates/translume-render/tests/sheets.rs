//! Thin sheets that light goes through diffusely: every method has the light from the other side, in the amount that is known.
//!
//! Each comparison is within 4 standard errors, a false alarm in 16,000, and a slack for the bias that `gkernel` and `photonmap`
//! have; seeds are fixed.

mod common;

use common::*;
use glam::DVec3;
use translume_bxdf::Rgb;
use translume_render::integrator;
use translume_scene::emitter::Emitter;
use translume_scene::material::{Model, ThinPrincipled};
use translume_scene::{MaterialId, Scene};

/// Methods with samples per pixel and the bias that they may have.
const METHODS: [(&str, u64, f64); 5] =
    [("path", 256, 1e-3), ("volpath", 256, 1e-3), ("bdpt", 128, 1e-3), ("gkernel", 32, 0.03), ("photonmap", 64, 0.02)];

fn paper(m: &mut Maker, reflectance: f32, transmittance: f32) -> MaterialId {
    let (reflectance, transmittance) = (m.gray(reflectance), m.gray(transmittance));
    m.material(Model::DiffuseTransmission { reflectance, transmittance })
}

fn leaf(m: &mut Maker, base_color: f32, color: f32, diff_trans: f32, roughness: f32) -> MaterialId {
    let [base_color, transmission_color, diff_trans, roughness, metallic] =
        [base_color, color, diff_trans, roughness, 0.0].map(|v| m.gray(v));
    let leaf = ThinPrincipled { base_color, transmission_color, diff_trans, eta: 1.5, roughness, metallic };
    m.material(Model::ThinPrincipled(Box::new(leaf)))
}

#[track_caller]
fn expect_of_all(what: &str, scene: &Scene, expected: f64) {
    for (method, spp, slack) in METHODS {
        let options = if method == "photonmap" { vec![("photons".to_owned(), "200000".to_owned())] } else { vec![] };
        let integrator = integrator::with_options(method, UNLIMITED, &options).unwrap();
        let (mean, error) = mean(&film_by(scene, &*integrator, spp, 11));
        let allowed = 4.0 * error + slack * expected;
        assert!((mean - expected).abs() < allowed, "{what}, {method}: {mean} ± {error} instead of {expected}");
    }
}

/// A sphere light of radius r, h above a large paper, gives it the irradiance E = π L r²/h²: below the lamp it shows E R/π on the lit
/// side and E T/π on the other, whichever of its sides is the front.
#[test]
fn paper_passes_the_irradiance_on() {
    for (side, eye) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
        let mut m = Maker::default();
        let (paper, black, glow) = (paper(&mut m, 0.3, 0.6), m.diffuse(0.0), m.gray(3.0));
        m.square(20.0, 0.0, paper);
        m.sphere(DVec3::new(0.0, 0.0, 2.0 * side), 0.8, black).radiance = Some(glow);
        m.camera(DVec3::new(3.0, 0.0, eye), DVec3::ZERO, 1e-3);
        let share = if side == eye { 0.3 } else { 0.6 };
        expect_of_all(&format!("lamp at {side}, camera at {eye}"), &m.0, share * 3.0 * 0.64 / 4.0);
    }
}

/// A point of intensity I, h behind the paper, cannot be met by chance: it shows T/π I/h² only if lights behind are sampled. A second
/// point on the seen side, too weak to see, gives the choice among lights something to choose.
#[test]
fn points_behind_paper_are_sampled() {
    let mut m = Maker::default();
    let paper = paper(&mut m, 0.3, 0.6);
    m.square(4.0, 0.0, paper);
    for (z, intensity) in [(2.0, 8.0), (-2.0, 1e-3)] {
        m.0.emitters.push(Emitter::Point { position: DVec3::new(0.0, 0.0, z), intensity: Rgb::splat(intensity) });
    }
    m.camera(DVec3::new(3.0, 0.0, -1.0), DVec3::ZERO, 1e-3);
    expect_of_all("point", &m.0, (0.6 * 8.0 + 0.3 * 1e-3) / (4.0 * std::f64::consts::PI));
}

/// A lamp of radius a in the middle of a ball of paper of radius 1: inside, E = π L a² / (1 − R (1 − a²)) everywhere, since the paper
/// lights itself but for what the black bulb takes. It comes out as E T/π.
#[test]
fn a_lampshade_shines_evenly() {
    let (r, t, a2) = (0.5, 0.4, 0.09);
    let mut m = Maker::default();
    let (paper, black, glow) = (paper(&mut m, r as f32, t as f32), m.diffuse(0.0), m.gray(7.0));
    m.sphere(DVec3::ZERO, 1.0, paper);
    m.sphere(DVec3::ZERO, 0.3, black).radiance = Some(glow);
    m.camera(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, 0.3);
    expect_of_all("lampshade", &m.0, t * 7.0 * a2 / (1.0 - r * (1.0 - a2)));
}

/// In a world of radiance 1 a ball of paper has E = π T/(1 − R) inside: it shows R + T²/(1 − R). A white one with a coat cannot be seen.
#[test]
fn balls_in_a_furnace() {
    let ball = |material: fn(&mut Maker) -> MaterialId| {
        let mut m = Maker::default();
        let material = material(&mut m);
        m.sphere(DVec3::ZERO, 1.0, material);
        m.constant(1.0);
        m.camera(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, 0.3);
        m.0
    };
    expect_of_all("gray", &ball(|m| paper(m, 0.3, 0.5)), 0.3 + 0.25 / 0.7);
    expect_of_all("white", &ball(|m| leaf(m, 1.0, 1.0, 0.6, 0.4)), 1.0);
    // More than all of the light is taken as all of it.
    expect_of_all("too much", &ball(|m| paper(m, 1.0, 1.0)), 1.0);
}

/// A leaf with a coat between a lamp and a floor, seen with its shadow from above and from below.
#[test]
fn methods_agree_on_a_leaf() {
    for eye in [DVec3::new(2.5, 0.0, 2.0), DVec3::new(2.0, 0.5, 0.3)] {
        let mut m = Maker::default();
        let (leaf, gray) = (leaf(&mut m, 0.4, 0.8, 0.7, 0.5), m.diffuse(0.5));
        let (black, glow) = (m.diffuse(0.0), m.gray(5.0));
        m.square(2.0, 0.0, gray);
        m.square(0.7, 0.8, leaf);
        let light = m.square(0.5, 2.0, black);
        (light.radiance, light.flip_normals) = (Some(glow), true);
        m.camera(eye, DVec3::new(0.0, 0.0, 0.5), 0.5);
        let (path, error) = mean(&film(&m.0, "path", UNLIMITED, 4096, 3));
        for (method, spp, slack) in METHODS {
            let (ours, noise) = mean(&film(&m.0, method, UNLIMITED, spp, 4));
            let allowed = 4.0 * (error + noise) + slack * path;
            assert!((ours - path).abs() < allowed, "{method} from {eye}: {ours} ± {noise} instead of {path} ± {error}");
        }
    }
}
