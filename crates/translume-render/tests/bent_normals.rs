//! Bump and normal maps: the limits of what they bend, against values by hand, and the same from both ends of a path.

mod common;

use common::*;
use glam::{DVec3, Vec3};
use std::sync::Arc;
use translume_bxdf::{Distribution, Flags, Mode, Rgb};
use translume_core::rng::Pcg32;
use translume_core::sampler::Sampler;
use translume_core::{stats, warp};
use translume_render::World;
use translume_render::integrator::Settings;
use translume_scene::emitter::Emitter;
use translume_scene::material::{BendLimits, Conductor, Model, NormalAxes, Roughness};
use translume_scene::texture::Texture;
use translume_scene::{MaterialId, Scene, TextureId};
use translume_trace::Ray;

const ALL: BendLimits = BendLimits { turns_to_viewer: true, softens_terminator: true };
const NONE: BendLimits = BendLimits { turns_to_viewer: false, softens_terminator: false };

/// `nested` under normals that are all `n`.
fn bent(m: &mut Maker, n: Vec3, limits: BendLimits, nested: MaterialId) -> MaterialId {
    m.0.textures.push(Texture::Constant((n.normalize() + 1.0) / 2.0));
    let normals = TextureId(m.0.textures.len() - 1);
    m.material(Model::NormalMap { normals, scale: 1.0, axes: NormalAxes::RightHanded, limits, nested })
}

/// A white floor of bent normals under a sun, seen along `eye` (towards the eye).
fn sunlit(n: Vec3, limits: BendLimits, sun: Vec3, eye: Vec3, two_sided: bool) -> f64 {
    let mut m = Maker::default();
    let mut nested = m.diffuse(1.0);
    if two_sided {
        nested = m.material(Model::TwoSided { front: nested, back: nested });
    }
    let floor = bent(&mut m, n, limits, nested);
    m.square(10.0, 0.0, floor);
    m.0.emitters.push(Emitter::Directional {
        direction: -sun.normalize().as_dvec3(),
        irradiance: Rgb::splat(std::f32::consts::PI),
    });
    let at = DVec3::new(3.0, -3.0, 0.0); // inside of one triangle: each has its own tangent
    m.camera(at + eye.normalize().as_dvec3() * 2.0, at, 1e-3);
    mean(&film(&m.0, "path", UNLIMITED, 4, 1)).0
}

#[track_caller]
fn is_near(a: f64, b: f64) {
    assert!((a - b).abs() < 1e-3, "{a} instead of {b}");
}

/// Tangents of a square without coordinates are the renderer's own: normals are bent along the view's plane both ways.
#[test]
fn invalid_normals_turn_to_the_viewer() {
    // The first tangent of the square, found by what it does to a sun that is along it.
    let n = Vec3::new(0.8, 0.0, 0.6);
    let tangent = (0..360).map(|i| (i as f32).to_radians()).map(|a| Vec3::new(a.cos(), a.sin(), 0.0));
    let up = Vec3::Z;
    let along = tangent.max_by(|a, b| {
        let lit = |t: &Vec3| sunlit(n, NONE, *t * 0.8 + up * 0.6, up, false);
        lit(a).total_cmp(&lit(b))
    });
    let t = along.unwrap();
    let (sun, valid, invalid) = (t * 0.3 + up, t * 0.5 + up, -t * 2.0 + up * 0.5);
    let bent = (t * 0.8 + up * 0.6).dot(sun.normalize());
    let turned = (-t * 0.8 + up * 0.6).dot(sun.normalize());
    for two_sided in [false, true] {
        is_near(sunlit(n, NONE, sun, valid, two_sided), bent.into());
        is_near(sunlit(n, NONE, sun, invalid, two_sided), 0.0);
        let turns = BendLimits { turns_to_viewer: true, ..NONE };
        is_near(sunlit(n, turns, sun, valid, two_sided), bent.into());
        is_near(sunlit(n, turns, sun, invalid, two_sided), turned.into());
    }
    // From behind, with the sun behind: the two-sided floor is as bright there.
    is_near(sunlit(n, NONE, -sun, -valid, true), bent.into());
    is_near(sunlit(n, ALL, -sun, -valid, true), sunlit(n, ALL, sun, valid, true));
    // tan² of the bent normal is 16/9, an eighth of it 2/9; tan² of the sun 0.09.
    let soft = BendLimits { softens_terminator: true, ..NONE };
    let masking = 2.0 / (1.0 + (1.0 + 2.0 / 9.0 * 0.09_f64).sqrt());
    is_near(sunlit(n, soft, sun, valid, false), masking * f64::from(bent));
    // Light from the far side of the surface's own normal stays away.
    is_near(sunlit(n, ALL, t - up * 0.1, valid, false), 0.0);
}

/// A corner of a floor and a wall, both of strongly bent normals, lit from a panel.
fn corner(rough: Option<f32>) -> Scene {
    let mut m = Maker::default();
    let (black, glow) = (m.diffuse(0.0), m.gray(5.0));
    let nested = match rough {
        None => m.diffuse(0.8),
        Some(alpha) => {
            let [alpha, eta, k, one] = [alpha, 0.2, 3.0, 1.0].map(|v| m.gray(v));
            m.material(Model::RoughConductor {
                conductor: Conductor { eta, k, specular_reflectance: one },
                roughness: Roughness { distribution: Distribution::Ggx, alpha_u: alpha, alpha_v: alpha },
            })
        }
    };
    let (floor, ball) =
        (bent(&mut m, Vec3::new(1.5, 0.3, 1.0), ALL, nested), bent(&mut m, Vec3::new(-0.9, 0.2, 1.0), ALL, nested));
    m.square(2.0, 0.0, floor);
    m.sphere(DVec3::new(-0.3, 0.2, 0.6), 0.6, ball);
    let light = m.square(0.7, 2.5, black);
    (light.radiance, light.flip_normals) = (Some(glow), true);
    m.camera(DVec3::new(3.0, -3.0, 1.0), DVec3::new(0.0, 0.0, 0.4), 0.6);
    m.0
}

/// At a false-alarm rate of 1e-3 per picture, pixel by pixel.
#[test]
fn bent_normals_are_the_same_from_both_ends() {
    let settings = Settings { max_depth: Some(4), ..UNLIMITED };
    for rough in [None, Some(0.3)] {
        let scene = corner(rough);
        let path = estimates(&film(&scene, "path", settings, 2048, 31));
        let both = estimates(&film(&scene, "bdpt", settings, 1024, 32));
        let floor = 2e-3 * path.iter().map(|e| e.mean).fold(0.0, f64::max);
        stats::compare_pictures(&path, &both, floor, 1e-3).unwrap_or_else(|e| panic!("{rough:?}: {e}"));
    }
}

#[derive(Default)]
struct Moments {
    n: f64,
    sum: f64,
    squares: f64,
}

impl Moments {
    fn add(&mut self, v: f64) {
        (self.n, self.sum, self.squares) = (self.n + 1.0, self.sum + v, self.squares + v * v);
    }

    fn mean(&self) -> f64 {
        self.sum / self.n
    }

    fn variance_of_mean(&self) -> f64 {
        (self.squares / self.n - self.mean().powi(2)) / self.n
    }
}

/// What walks from either end draw is what they say they draw: Σ 1/pdf over samples is the solid angle that they reach, and
/// Σ weight is ∫ f cos, which evenly drawn directions find too. Six standard errors.
#[test]
fn samples_have_their_densities() {
    let scene = corner(Some(0.3));
    let world = World::new(Arc::new(scene)).unwrap();
    let mut rng = Pcg32::new(3, 1);
    for mode in [Mode::Radiance, Mode::Importance] {
        for eye in [Vec3::new(1.0, 0.5, 1.0), Vec3::new(-1.0, -0.3, 0.3), Vec3::new(0.2, 1.0, 0.15)] {
            let at = Vec3::new(1.2, -1.2, 0.0);
            let hit = world.intersect(&Ray::new(at + eye, -eye.normalize())).unwrap();
            let shading = world.shading(&hit);
            let n = 200_000;
            let (mut drawn, mut evenly) = (Moments::default(), Moments::default());
            for _ in 0..n {
                let sample = shading.sample(hit.wo, rng.next_f32(), rng.next_2d(), mode);
                if let Some(s) = sample {
                    let (value, pdf_w) = shading.eval_cos_pdf(hit.wo, s.wi, mode);
                    assert!(!s.flags.contains(Flags::DELTA));
                    assert!((pdf_w - s.pdf_w).abs() <= 2e-3 * pdf_w, "{pdf_w} {}", s.pdf_w);
                    assert!((value / pdf_w - s.weight).abs().max_element() <= 4e-3 * s.weight.max_element() + 1e-6);
                }
                drawn.add(sample.map_or(0.0, |s| f64::from(s.weight.y)));
                let wi = warp::uniform_sphere(rng.next_f32(), rng.next_f32());
                let (value, _) = shading.eval_cos_pdf(hit.wo, wi, mode);
                evenly.add(f64::from(value.y) * 4.0 * std::f64::consts::PI);
            }
            let error = (drawn.variance_of_mean() + evenly.variance_of_mean()).sqrt();
            let (a, b) = (drawn.mean(), evenly.mean());
            assert!((a - b).abs() < 6.0 * error, "{mode:?} {eye}: {a} {b} ± {error}");
        }
    }
}
