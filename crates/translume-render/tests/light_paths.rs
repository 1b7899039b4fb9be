//! Light sub-paths, the camera's importance and splats: tracing light alone gives the pictures that `path` gives.
//!
//! Pictures are compared pixel by pixel at a false-alarm rate of 1e-3 per comparison (Šidák over the pixels); seeds are fixed.

mod common;

use common::*;
use glam::{DAffine3, DVec3, Vec2, Vec3};
use std::sync::Arc;
use translume_bxdf::{Distribution, Flags, Mode, Rgb};
use translume_core::rng::Pcg32;
use translume_core::sampler::Sampler;
use translume_core::stats;
use translume_image::{Picture, Rgb32FImage};
use translume_mesh::TriMesh;
use translume_render::camera::Camera;
use translume_render::integrator::{Bdpt, Integrator, Settings, Work};
use translume_render::splat::Splat;
use translume_render::subpath::{self, Limits};
use translume_render::{World, integrator};
use translume_scene::emitter::{Emitter, Falloff, Spot};
use translume_scene::material::{Conductor, Dielectric, Model, Roughness, ThinPrincipled};
use translume_scene::sensor::{Projection, Sensor};
use translume_scene::texture::{Bitmap, Channel, Filter, Texture, Wrap};
use translume_scene::{Geometry, MaterialId, Scene, TextureId};
use translume_trace::Ray;

/// Light tracing, written with what any method has.
struct LightTracer(Settings);

impl Integrator for LightTracer {
    fn splats(&self) -> bool {
        true
    }

    fn radiance(&self, world: &World, _: &Ray, work: &mut Work) -> Rgb {
        let limits = Limits { segments: self.0.max_depth.map_or(100, |n| n - 1), rr_depth: self.0.rr_depth };
        let mut vertices = Vec::new();
        let mut sampler = work.sampler.branch(0);
        subpath::light_path(world, world.lights().by_power(), limits, &mut sampler, &mut work.rays, &mut vertices);
        for v in &vertices {
            let lens = sampler.next_2d();
            let Some(camera) = work.view.camera.sample_importance(v.hit.point.p, lens, work.view.margin) else {
                continue;
            };
            let shading = world.shading(&v.hit);
            let Some(here) = subpath::scattering(world, &v.hit, &shading, v.hit.wo, camera.wi) else { continue };
            let visible = world.transmittance_to_camera(&camera, &v.hit, self.0.hide_emitters, 100);
            let value = v.throughput * here.f * visible * (camera.weight * v.hit.n().dot(camera.wi).abs());
            work.splats.push(Splat { film: camera.film, value });
        }
        Rgb::ZERO
    }
}

/// Lights are hidden: they are what light tracing does not see.
const HIDDEN: Settings = Settings { hide_emitters: true, ..UNLIMITED };

/// A floor, two balls and a wall, without light.
fn stage() -> (Maker, TextureId, MaterialId) {
    let mut m = Maker::default();
    let (gray, black, glow) = (m.diffuse(0.6), m.diffuse(0.0), m.gray(5.0));
    m.square(3.0, 0.0, gray);
    m.sphere(DVec3::new(-0.7, 0.2, 0.6), 0.6, gray);
    m.camera(DVec3::new(3.0, -3.0, 2.5), DVec3::new(0.0, 0.0, 0.5), 0.7);
    (m, glow, black)
}

fn panel(m: &mut Maker, size: f32, z: f32, glow: TextureId, black: MaterialId) {
    let light = m.square(size, z, black);
    (light.radiance, light.flip_normals) = (Some(glow), true);
}

/// Light from each kind of emitter, by name.
fn lit_by(kind: &str) -> Scene {
    let (mut m, glow, black) = stage();
    let picture = || {
        let mut pixels = Rgb32FImage::new(8, 5);
        for (x, y, p) in pixels.enumerate_pixels_mut() {
            let v = if (x, y) == (5, 1) { 20.0 } else { ((x * 7 + y * 3) % 5) as f32 };
            p.0 = [v, 0.3 * v, 0.2 * v];
        }
        Arc::new(Picture::new(pixels))
    };
    let slide = Texture::Bitmap(Bitmap {
        set: 0,
        image: picture(),
        image_from_uv: glam::DAffine2::IDENTITY,
        filter: Filter::Bilinear,
        wrap: [Wrap::Repeat; 2],
        channel: Channel::Rgb,
        scale: Rgb::ONE,
    });
    let down = DAffine3::from_quat(glam::DQuat::from_rotation_x(std::f64::consts::PI - 0.2));
    let above = DAffine3::from_translation(DVec3::new(0.2, 0.3, 3.0)) * down;
    match kind {
        "panel" => panel(&mut m, 0.5, 3.0, glow, black),
        "textured panel" => {
            m.0.textures.push(slide);
            let glow = TextureId(m.0.textures.len() - 1);
            panel(&mut m, 1.0, 2.0, glow, black);
        }
        "sphere" => m.sphere(DVec3::new(0.8, 0.0, 1.8), 0.3, black).radiance = Some(glow),
        "stretched disk" => {
            let place = DAffine3::from_translation(DVec3::new(0.0, 0.3, 2.5))
                * DAffine3::from_quat(glam::DQuat::from_rotation_x(2.8))
                * DAffine3::from_scale(DVec3::new(0.8, 0.3, 1.0));
            m.shape(Geometry::Disk, place, black).radiance = Some(glow);
        }
        "point" => {
            m.0.emitters.push(Emitter::Point { position: DVec3::new(0.5, 0.0, 2.0), intensity: Rgb::splat(8.0) });
        }
        "spot" => m.0.emitters.push(Emitter::Spot(Spot {
            world_from_light: above,
            intensity: Rgb::splat(30.0),
            cutoff_angle: 0.6,
            beam_width: 0.2,
            falloff: Falloff::SmoothInCosine,
        })),
        "projector" => {
            m.0.textures.push(slide);
            let irradiance = TextureId(m.0.textures.len() - 1);
            m.0.emitters.push(Emitter::Projector { world_from_light: above, fov_x: 0.9, irradiance, scale: 2.0 });
        }
        "directional" => m.0.emitters.push(Emitter::Directional {
            direction: DVec3::new(0.3, 0.4, -1.0).normalize(),
            irradiance: Rgb::splat(3.0),
        }),
        "constant" => m.constant(1.0),
        _ => {
            let world_from_light = DAffine3::from_quat(glam::DQuat::from_rotation_x(1.57));
            m.0.emitters.push(Emitter::Environment { image: picture(), scale: Rgb::ONE, world_from_light });
        }
    }
    m.0
}

const EMITTERS: [&str; 10] = [
    "panel",
    "textured panel",
    "sphere",
    "stretched disk",
    "point",
    "spot",
    "projector",
    "directional",
    "constant",
    "environment",
];

/// At a false-alarm rate of 1e-3. Rounding of rays at edges is allowed 2e-3 of the brightest pixel.
#[track_caller]
fn agree(what: &str, scene: &Scene, settings: Settings, integrator: &dyn Integrator, spp: u64, other: u64) {
    let path = estimates(&film(scene, "path", settings, spp, 31));
    let ours = estimates(&film_by(scene, integrator, other, 32));
    let floor = 1e-3 * path.iter().map(|e| e.mean).fold(0.0, f64::max);
    stats::compare_pictures(&path, &ours, floor, 1e-3).unwrap_or_else(|e| panic!("{what}: {e}"));
    // The mean of the picture is a sharper test: 4 standard errors, a false alarm in 16,000.
    let sums = |e: &[stats::Estimate]| {
        let n = e.len() as f64;
        (e.iter().map(|e| e.mean).sum::<f64>() / n, e.iter().map(|e| e.variance).sum::<f64>() / (n * n))
    };
    let ((a, va), (b, vb)) = (sums(&path), sums(&ours));
    let error = (va + vb).sqrt() + 5e-4 * a;
    assert!((a - b).abs() <= 4.0 * error, "{what}: means {a} and {b}, ± {error}");
}

#[test]
fn light_tracing_agrees_with_path_for_every_emitter() {
    for kind in EMITTERS {
        agree(kind, &lit_by(kind), HIDDEN, &LightTracer(HIDDEN), 1024, 2048);
    }
}

/// Smooth normals on a coarse ball bend light the same way from both ends (Veach's correction).
fn coarse_ball() -> Scene {
    let (mut m, glow, black) = stage();
    panel(&mut m, 0.5, 3.0, glow, black);
    let gray = m.diffuse(0.8);
    let mut mesh = TriMesh::default();
    for (i, z) in [(0, 1.0_f32), (1, 0.0), (2, -1.0)] {
        let n = if i == 1 { 6 } else { 1 };
        for k in 0..n {
            let phi = k as f32 / n as f32 * std::f32::consts::TAU;
            let r = if i == 1 { 1.0 } else { 0.0 };
            mesh.positions.push([r * phi.cos(), r * phi.sin(), z]);
        }
    }
    for k in 0..6_u32 {
        mesh.indices.push([0, 1 + k, 1 + (k + 1) % 6]);
        mesh.indices.push([7, 1 + (k + 1) % 6, 1 + k]);
    }
    mesh.normals = Some(mesh.positions.clone());
    let place = DAffine3::from_translation(DVec3::new(0.8, -0.5, 0.7)) * DAffine3::from_scale(DVec3::splat(0.6));
    m.shape(Geometry::Mesh(Arc::new(mesh)), place, gray);
    m.0
}

fn camera_like(scene: &Scene, projection: Projection, scale: f64) -> Scene {
    let mut scene = scene.clone();
    let sensor = &mut scene.sensors[0];
    sensor.projection = projection;
    sensor.world_from_camera.matrix3 *= scale;
    scene
}

fn thin_lens(scene: &Scene) -> Scene {
    let Projection::Perspective(perspective) = scene.sensors[0].projection else { panic!() };
    camera_like(scene, Projection::ThinLens { perspective, aperture_radius: 0.2, focus_distance: 3.0 }, 1.0)
}

#[test]
fn light_tracing_agrees_with_path_for_cameras_and_bent_normals() {
    let scene = lit_by("panel");
    agree("thin lens", &thin_lens(&scene), HIDDEN, &LightTracer(HIDDEN), 1024, 2048);
    let parallel = camera_like(&scene, Projection::Orthographic, 1.7);
    agree("parallel", &parallel, HIDDEN, &LightTracer(HIDDEN), 1024, 2048);
    let scaled = camera_like(&scene, scene.sensors[0].projection, 1.7);
    agree("scaled", &scaled, HIDDEN, &LightTracer(HIDDEN), 1024, 2048);
    agree("smooth normals", &coarse_ball(), HIDDEN, &LightTracer(HIDDEN), 1024, 4096);
    let mut filtered = scene.clone();
    filtered.sensors[0].film.filter = translume_scene::sensor::PixelFilter::Mitchell { b: 1.0 / 3.0, c: 1.0 / 3.0 };
    agree("filter", &filtered, HIDDEN, &LightTracer(HIDDEN), 1024, 2048);
    let three = Settings { max_depth: Some(3), ..HIDDEN };
    agree("depth", &scene, three, &LightTracer(three), 1024, 2048);
}

/// ∫ of a camera's density over a wall that a pixel sees wholly is one, through any point of the lens.
#[test]
fn densities_of_camera_rays_are_those_of_their_hits() {
    let scene = lit_by("panel");
    let cameras: [Sensor; 3] = [
        camera_like(&scene, scene.sensors[0].projection, 2.0).sensors[0].clone(),
        thin_lens(&scene).sensors[0].clone(),
        camera_like(&scene, Projection::Orthographic, 0.5).sensors[0].clone(),
    ];
    let mut rng = Pcg32::new(1, 2);
    for sensor in &cameras {
        let camera = Camera::new(sensor, [64, 48]);
        for _ in 0..100 {
            let (film, lens) = (rng.next_2d() * Vec2::new(63.0, 47.0), rng.next_2d());
            // A wall across the view; the ray's place on it for the corners of a pixel.
            let middle = camera.ray(film + 0.5, lens);
            let n = (middle.d + 0.3 * middle.d.any_orthonormal_vector()).normalize();
            let wall = middle.at(middle.t_min + 4.0);
            let hit = |x: f32, y: f32| {
                let ray = camera.ray(film + Vec2::new(x, y), lens);
                ray.o + ray.d * ((wall - ray.o).dot(n) / ray.d.dot(n))
            };
            let area = 0.5 * (hit(1.0, 1.0) - hit(0.0, 0.0)).cross(hit(0.0, 1.0) - hit(1.0, 0.0)).length();
            let lens_point = match camera.is_parallel() {
                true => middle.o,
                false => camera.sample_importance(wall, lens, 0.0).unwrap().p,
            };
            let density = camera.density(middle.d, (wall - lens_point).length()) * n.dot(middle.d).abs();
            assert!((area * density - 1.0).abs() < 0.01, "{area} {density}");
            let sample = camera.sample_importance(wall, lens, 0.0).unwrap();
            assert!((sample.film - film - 0.5).abs().max_element() < 0.02, "{} {film}", sample.film);
        }
    }
}

/// A bent normal cuts the light's direction from either end: scattering is the same function.
#[test]
fn scattering_is_one_function_from_both_ends() {
    let scene = coarse_ball();
    let world = World::new(Arc::new(scene)).unwrap();
    let mut rng = Pcg32::new(7, 1);
    let mut met = 0;
    for _ in 0..2000 {
        let mut d = || Vec3::new(rng.next_f32(), rng.next_f32(), rng.next_f32()) * 2.0 - 1.0;
        let (o, target, out) = (d() * 3.0 + Vec3::Z, Vec3::new(0.8, -0.5, 0.7) + d() * 0.4, d().normalize());
        let Some(hit) = world.intersect(&Ray::new(o, (target - o).normalize())) else { continue };
        let shading = world.shading(&hit);
        let (f, _) = shading.eval_cos_pdf(hit.wo, out, Mode::Radiance);
        let adjoint = subpath::scattering(&world, &hit, &shading, out, hit.wo);
        let same = adjoint.map_or(Rgb::ZERO, |s| s.f * hit.n().dot(out).abs());
        assert!((f - same).abs().max_element() < 1e-4 * (1.0 + f.max_element()), "{f} {same}");
        met += 1;
    }
    assert!(met > 500);
}

/// Materials for comparisons, by name.
fn made_of(kind: &str) -> Scene {
    let (mut m, glow, black) = stage();
    panel(&mut m, 0.5, 3.0, glow, black);
    let (one, rough, smooth) = (m.gray(1.0), m.gray(0.2), m.gray(0.05));
    let glass = Dielectric { eta: 1.5, specular_reflectance: one, specular_transmittance: one };
    let model = match kind {
        "glass" => Model::Dielectric(glass),
        "rough glass" => Model::RoughDielectric {
            dielectric: glass,
            roughness: Roughness { distribution: Distribution::Ggx, alpha_u: rough, alpha_v: rough },
        },
        "mask" => Model::Mask { opacity: rough, nested: m.diffuse(0.8) },
        "leaf" => {
            let [color, through, roughness, metallic] = [0.7, 0.6, 0.4, 0.1].map(|v| m.gray(v));
            Model::ThinPrincipled(Box::new(ThinPrincipled {
                base_color: color,
                transmission_color: color,
                diff_trans: through,
                eta: 1.5,
                roughness,
                metallic,
            }))
        }
        "two-sided bump" => {
            let front = m.diffuse(0.8);
            let back = m.diffuse(0.3);
            Model::TwoSided { front, back }
        }
        _ => {
            let (eta, k) = (m.gray(0.2), m.gray(3.0));
            Model::RoughConductor {
                conductor: Conductor { eta, k, specular_reflectance: one },
                roughness: Roughness { distribution: Distribution::Ggx, alpha_u: smooth, alpha_v: rough },
            }
        }
    };
    let material = m.material(model);
    m.sphere(DVec3::new(0.8, -0.5, 0.7), 0.5, material);
    m.0
}

#[test]
fn all_strategies_together_agree_with_path_for_every_emitter() {
    for kind in EMITTERS {
        agree(kind, &lit_by(kind), UNLIMITED, &Bdpt::new(UNLIMITED), 1024, 512);
    }
    agree("hidden", &lit_by("sphere"), HIDDEN, &Bdpt::new(HIDDEN), 1024, 512);
    agree("hidden environment", &lit_by("constant"), HIDDEN, &Bdpt::new(HIDDEN), 1024, 512);
}

#[test]
fn all_strategies_together_agree_with_path_for_materials_and_cameras() {
    for kind in ["glass", "rough glass", "mask", "leaf", "two-sided bump", "metal"] {
        agree(kind, &made_of(kind), UNLIMITED, &Bdpt::new(UNLIMITED), 2048, 1024);
    }
    agree("smooth normals", &coarse_ball(), UNLIMITED, &Bdpt::new(UNLIMITED), 1024, 512);
    agree("thin lens", &thin_lens(&lit_by("panel")), UNLIMITED, &Bdpt::new(UNLIMITED), 1024, 512);
    let parallel = camera_like(&lit_by("sphere"), Projection::Orthographic, 1.7);
    agree("parallel", &parallel, UNLIMITED, &Bdpt::new(UNLIMITED), 1024, 512);
    for depth in 1..5 {
        let settings = Settings { max_depth: Some(depth), ..UNLIMITED };
        agree("depth", &made_of("mask"), settings, &Bdpt::new(settings), 1024, 512);
    }
}

/// Lights of one mesh in several places, and the room of the other tests.
#[test]
fn instances_and_many_lights() {
    let (mut m, glow, black) = stage();
    // More triangles than are copied: the tracer places the one mesh three times.
    let n = 20;
    let mut mesh = TriMesh::default();
    for i in 0..=n * (n + 2) {
        let (x, y) = (i % (n + 1), i / (n + 1));
        mesh.positions.push([x as f32 * 0.02, y as f32 * 0.02, 0.0]);
    }
    for i in (0..n * (n + 1)).filter(|i| i % (n + 1) < n) {
        mesh.indices.push([i, i + n + 2, i + 1]);
        mesh.indices.push([i, i + n + 1, i + n + 2]);
    }
    let mesh = Arc::new(mesh);
    for (x, y) in [(0.5, 0.0), (-0.8, 1.0), (0.3, -1.2)] {
        let place = DAffine3::from_translation(DVec3::new(x, y, 2.0))
            * DAffine3::from_quat(glam::DQuat::from_rotation_x(x))
            * DAffine3::from_scale(DVec3::new(1.0, 1.5, 1.0));
        m.shape(Geometry::Mesh(mesh.clone()), place, black).radiance = Some(glow);
    }
    agree("instances", &m.0, UNLIMITED, &Bdpt::new(UNLIMITED), 1024, 512);
    agree("room", &room(), UNLIMITED, &Bdpt::new(UNLIMITED), 1024, 512);
}

/// Each strategy alone, unweighted, is an estimate of the paths that it can make: of direct light on a diffuse floor, all
/// of them are.
#[test]
fn strategies_alone_agree() {
    let settings = Settings { max_depth: Some(2), ..HIDDEN };
    let scene = lit_by("sphere");
    for only in [|s, _| s == 0, |s, _| s == 1, |_, t| t == 1] as [fn(u32, u32) -> bool; 3] {
        agree("alone", &scene, settings, &Bdpt::with_strategies(settings, only, false), 1024, 4096);
    }
    let three = Settings { max_depth: Some(3), ..HIDDEN };
    let joined = |s: u32, t: u32| (s + t == 3 && s == 1) || (s, t) == (2, 2);
    agree("joined", &scene, three, &Bdpt::with_strategies(three, joined, false), 1024, 2048);
}

#[test]
fn furnaces_and_form_factors() {
    let bdpt = |scene: &Scene, spp, seed| film(scene, "bdpt", UNLIMITED, spp, seed);
    let mut m = Maker::default();
    let white = m.diffuse(1.0);
    m.sphere(DVec3::ZERO, 1.0, white);
    m.constant(0.7);
    m.camera(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, 0.6);
    expect(&bdpt(&m.0, 64, 1), 0.7, 1e-3);
    let mut m = Maker::default();
    let (gray, glow) = (m.diffuse(0.5), m.gray(1.0));
    let shape = m.sphere(DVec3::ZERO, 1.0, gray);
    (shape.radiance, shape.flip_normals) = (Some(glow), true);
    m.camera(DVec3::new(0.2, -0.3, 0.1), DVec3::X, 1.0);
    expect(&bdpt(&m.0, 256, 2), 2.0, 5e-3);
    // A sphere light over a plane: π L r²/h².
    let mut m = Maker::default();
    let (gray, black, glow) = (m.diffuse(0.5), m.diffuse(0.0), m.gray(3.0));
    m.square(50.0, 0.0, gray);
    m.sphere(DVec3::new(0.0, 0.0, 2.0), 0.8, black).radiance = Some(glow);
    m.camera(DVec3::new(3.0, 0.0, 1.0), DVec3::ZERO, 1e-3);
    expect(&bdpt(&m.0, 64, 3), 0.5 * 3.0 * 0.64 / 4.0, 1e-4);
}

#[test]
fn threads_do_not_change_a_bit_of_splats() {
    let scene = made_of("glass");
    let one = same_for_threads(2, || film(&scene, "bdpt", UNLIMITED, 20, 14));
    assert_ne!(one, film(&scene, "bdpt", UNLIMITED, 20, 15));
}

#[test]
fn media_are_refused() {
    let mut scene = lit_by("panel");
    scene.media.push(translume_scene::medium::Medium {
        name: String::new(),
        sigma_t: translume_scene::medium::Volume::Constant(Rgb::ONE),
        albedo: translume_scene::medium::Volume::Constant(Rgb::ONE),
        scale: 1.0,
        phase: translume_bxdf::Phase::Isotropic,
        domain: None,
    });
    scene.shapes[0].interior = Some(translume_scene::MediumId(0));
    let world = World::new(Arc::new(scene)).unwrap();
    let bdpt = integrator::by_name("bdpt", UNLIMITED).unwrap();
    assert!(bdpt.check(&world).unwrap_err().to_string().contains("volpath"));
}

/// Segments end where they end, however many surfaces they pass straight.
#[test]
fn what_passes_light_moves_no_end() {
    let scene = made_of("mask");
    let world = World::new(Arc::new(scene.clone())).unwrap();
    let camera = Camera::new(&scene.sensors[0], [8, 8]);
    let mut seen = 0;
    for k in 0..1600 {
        let (x, y) = ((k % 40) as f32 * 0.2 + 0.1, (k / 40) as f32 * 0.2 + 0.1);
        // The floor behind the masked ball: two passes at opacity 0.2.
        let mut ray = camera.ray(Vec2::new(x, y), Vec2::ZERO);
        let mut hits = Vec::new();
        while let Some(hit) = world.intersect(&ray) {
            ray = hit.point.spawn(ray.d);
            hits.push(hit);
        }
        let [_, _, floor] = hits[..] else { continue };
        if floor.point.p.z != 0.0 || !world.shading(&hits[0]).flags().contains(Flags::NULL) {
            continue;
        }
        let Some(s) = camera.sample_importance(floor.point.p, Vec2::ZERO, 0.0) else { continue };
        let visible = world.transmittance_to_camera(&s, &floor, false, 100);
        assert!((visible.x - 0.64).abs() < 1e-5, "{visible} at {x} {y}");
        seen += 1;
    }
    assert!(seen > 50, "{seen}");
}
