//! Scenes put together by hand, and pictures of them.

#![allow(dead_code, reason = "each test file uses a part")]

use glam::{DAffine3, DVec3, Vec3};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use translume_bxdf::Rgb;
use translume_core::stats;
use translume_mesh::TriMesh;
use translume_render::World;
use translume_render::film::{Aov, Film};
use translume_render::integrator::{self, Integrator, Settings};
use translume_render::render::{Shot, Until};
use translume_scene::emitter::Emitter;
use translume_scene::material::{Dielectric, Material, Model};
use translume_scene::sensor::{Film as FilmSize, Perspective, PixelFilter, Projection, Sensor};
use translume_scene::texture::Texture;
use translume_scene::{Geometry, MaterialId, Scene, Shape, TextureId};

/// Scenes are put together by hand here.
#[derive(Default)]
pub(crate) struct Maker(pub(crate) Scene);

impl Maker {
    pub(crate) fn gray(&mut self, v: f32) -> TextureId {
        self.0.textures.push(Texture::Constant(Rgb::splat(v)));
        TextureId(self.0.textures.len() - 1)
    }

    pub(crate) fn material(&mut self, model: Model) -> MaterialId {
        self.0.materials.push(Material { name: String::new(), model });
        MaterialId(self.0.materials.len() - 1)
    }

    pub(crate) fn diffuse(&mut self, albedo: f32) -> MaterialId {
        let reflectance = self.gray(albedo);
        self.material(Model::Diffuse { reflectance })
    }

    pub(crate) fn shape(
        &mut self,
        geometry: Geometry,
        world_from_object: DAffine3,
        material: MaterialId,
    ) -> &mut Shape {
        self.0.shapes.push(Shape {
            name: String::new(),
            geometry,
            world_from_object,
            flip_normals: false,
            material,
            radiance: None,
            shines_behind: false,
            interior: None,
            exterior: None,
        });
        self.0.shapes.last_mut().unwrap()
    }

    /// A camera at `eye` that looks at `target` through a small opening.
    pub(crate) fn camera(&mut self, eye: DVec3, target: DVec3, fov: f32) {
        let z = (target - eye).normalize();
        let x = z.any_orthonormal_vector();
        let world_from_camera = DAffine3::from_mat3_translation(glam::DMat3::from_cols(x, z.cross(x), z), eye);
        self.0.sensors.push(Sensor {
            name: String::new(),
            world_from_camera,
            projection: Projection::Perspective(Perspective {
                fov,
                fov_axis: Default::default(),
                principal_point_offset: [0.0; 2],
            }),
            near_clip: 1e-3,
            far_clip: 1e6,
            film: FilmSize { size: [8, 8], crop: None, filter: PixelFilter::Box { radius: 0.5 } },
            sample_count: None,
            medium: None,
        });
    }

    pub(crate) fn constant(&mut self, radiance: f32) {
        self.0.emitters.push(Emitter::Constant { radiance: Rgb::splat(radiance) });
    }

    pub(crate) fn sphere(&mut self, center: DVec3, radius: f64, material: MaterialId) -> &mut Shape {
        self.shape(Geometry::Sphere { center, radius }, DAffine3::IDENTITY, material)
    }

    /// A square of half edge `size` at height `z`, facing up.
    pub(crate) fn square(&mut self, size: f32, z: f32, material: MaterialId) -> &mut Shape {
        let mesh = TriMesh {
            positions: vec![[-size, -size, z], [size, -size, z], [size, size, z], [-size, size, z]],
            indices: vec![[0, 1, 2], [0, 2, 3]],
            ..Default::default()
        };
        self.shape(Geometry::Mesh(Arc::new(mesh)), DAffine3::IDENTITY, material)
    }
}

pub(crate) const UNLIMITED: Settings =
    Settings { max_depth: None, rr_depth: 5, hide_emitters: false, camera_medium: None };

pub(crate) fn film(scene: &Scene, method: &str, settings: Settings, spp: u64, seed: u64) -> Film {
    film_by(scene, &*integrator::by_name(method, settings).unwrap(), spp, seed)
}

pub(crate) fn film_by(scene: &Scene, integrator: &dyn Integrator, spp: u64, seed: u64) -> Film {
    let world = World::new(Arc::new(scene.clone())).unwrap();
    integrator.check(&world).unwrap();
    let shot = Shot::new(&world, integrator, &scene.sensors[0], None, seed);
    let mut film = shot.film(&[Aov::Variance]).unwrap();
    shot.render(&mut film, &Until { samples: spp, time: None }, &AtomicBool::new(false), &mut |_, _| {});
    assert_eq!(film.broken(), 0);
    film
}

/// Per pixel the green and the variance of its mean.
pub(crate) fn estimates(film: &Film) -> Vec<stats::Estimate> {
    let channels = film.channels();
    let plane = |name: &str| &channels.iter().find(|c| c.0 == name).unwrap().1;
    let pairs = plane("G").iter().zip(plane("Variance.G"));
    pairs.map(|(&m, &v)| stats::Estimate { mean: m.into(), variance: v.into() }).collect()
}

/// What one thread makes, which must be the same to the bit as what `threads` make.
#[track_caller]
pub(crate) fn same_for_threads<T: PartialEq + std::fmt::Debug + Send>(
    threads: usize,
    make: impl Fn() -> T + Sync,
) -> T {
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(&make)
    };
    let one = with(1);
    assert_eq!(one, with(threads));
    one
}

/// Mean of the picture's green and its standard error.
pub(crate) fn mean(film: &Film) -> (f64, f64) {
    let channels = film.channels();
    let plane = |name: &str| channels.iter().find(|c| c.0 == name).unwrap().1.iter().map(|&v| f64::from(v));
    let n = plane("G").count() as f64;
    (plane("G").sum::<f64>() / n, plane("Variance.G").sum::<f64>().sqrt() / n)
}

#[track_caller]
pub(crate) fn expect(film: &Film, expected: f64, slack: f64) {
    let (mean, error) = mean(film);
    assert!((mean - expected).abs() < 4.0 * error + slack, "{mean} ± {error} instead of {expected}");
}

/// A box with a light, something glossy and a mirror: nothing analytic, for comparisons.
pub(crate) fn room() -> Scene {
    let mut m = Maker::default();
    let (gray, black, glow) = (m.diffuse(0.6), m.diffuse(0.0), m.gray(5.0));
    m.square(3.0, 0.0, gray);
    m.sphere(DVec3::new(-0.7, 0.2, 0.6), 0.6, gray);
    m.sphere(DVec3::new(0.8, 0.0, 1.8), 0.3, black).radiance = Some(glow);
    let light = m.square(0.4, 3.0, black);
    (light.radiance, light.flip_normals) = (Some(glow), true);
    m.camera(DVec3::new(3.0, -3.0, 2.5), DVec3::new(0.0, 0.0, 0.5), 0.7);
    m.0
}

/// A ball of glass over a floor, lit from a square: a caustic.
pub(crate) fn glass_ball(light: f32) -> Scene {
    let mut m = Maker::default();
    let (gray, black, glow, one) = (m.diffuse(0.6), m.diffuse(0.0), m.gray(20.0), m.gray(1.0));
    let glass =
        m.material(Model::Dielectric(Dielectric { eta: 1.5, specular_reflectance: one, specular_transmittance: one }));
    m.square(3.0, 0.0, gray);
    m.sphere(DVec3::new(0.0, 0.0, 0.7), 0.5, glass);
    let light = m.square(light, 3.0, black);
    (light.radiance, light.flip_normals) = (Some(glow), true);
    m.camera(DVec3::new(3.0, -3.0, 2.5), DVec3::new(0.0, 0.0, 0.3), 0.5);
    m.0
}

/// A floor just inside its edge, under a small lamp.
pub(crate) fn edge() -> Scene {
    let mut m = Maker::default();
    let (gray, black, glow) = (m.diffuse(0.5), m.diffuse(0.0), m.gray(5.0));
    m.square(1.0, 0.0, gray);
    let light = m.square(0.1, 1.0, black);
    (light.radiance, light.flip_normals) = (Some(glow), true);
    m.camera(DVec3::new(0.98, 0.0, 4.0), DVec3::new(0.98, 0.0, 0.0), 0.3);
    m.0
}

/// A corner with a block in it, lit by what a lamp throws at its walls: most pixels see others' second vertices at all distances and angles.
pub(crate) fn corner() -> Scene {
    let mut m = Maker::default();
    let (gray, red, black, glow) = (m.diffuse(0.7), m.diffuse(0.4), m.diffuse(0.0), m.gray(20.0));
    m.square(1.0, 0.0, gray);
    m.sphere(DVec3::new(0.0, 0.0, 0.15), 0.15, red);
    m.sphere(DVec3::new(0.35, 0.2, 0.1), 0.1, gray);
    // A dome as the wall, from inside.
    m.sphere(DVec3::ZERO, 0.8, gray).flip_normals = true;
    m.sphere(DVec3::new(0.0, -0.3, 0.6), 0.05, black).radiance = Some(glow);
    m.camera(DVec3::new(0.0, -0.7, 0.3), DVec3::new(0.1, 0.0, 0.1), 60_f32.to_radians());
    m.0
}

/// The middle of a large floor, under a point light, and its radiance.
pub(crate) fn flat() -> (Scene, f64) {
    let mut m = Maker::default();
    let gray = m.diffuse(0.5);
    m.square(4.0, 0.0, gray);
    m.0.emitters.push(Emitter::Point { position: DVec3::new(0.0, 0.0, 2.0), intensity: Vec3::splat(8.0) });
    m.camera(DVec3::new(3.0, 0.0, 1.0), DVec3::ZERO, 1e-3);
    (m.0, 0.5 / std::f64::consts::PI * 8.0 / 4.0)
}

/// The same of a smaller floor, 1 % of its width inside the edge.
pub(crate) fn floor_edge() -> (Scene, f64) {
    let mut m = Maker::default();
    let gray = m.diffuse(0.5);
    m.square(1.0, 0.0, gray);
    m.0.emitters.push(Emitter::Point { position: DVec3::new(0.0, 0.0, 2.0), intensity: Vec3::splat(8.0) });
    m.camera(DVec3::new(0.98, 0.0, 3.0), DVec3::new(0.98, 0.0, 0.0), 1e-3);
    let (r2, cos) = (4.0 + 0.98 * 0.98, 2.0 / (4.0_f64 + 0.98 * 0.98).sqrt());
    (m.0, 0.5 / std::f64::consts::PI * 8.0 * cos / r2)
}

/// Inside a closed diffuse sphere that shines every point has L_e / (1 − albedo).
pub(crate) fn furnace() -> (Scene, f64) {
    let mut m = Maker::default();
    let (gray, glow) = (m.diffuse(0.5), m.gray(1.0));
    let shape = m.sphere(DVec3::ZERO, 1.0, gray);
    (shape.radiance, shape.flip_normals) = (Some(glow), true);
    m.camera(DVec3::new(0.2, -0.3, 0.1), DVec3::X, 1.0);
    (m.0, 2.0)
}

/// Means of independent pictures.
pub(crate) fn means(scene: &Scene, method: &str, options: &[(&str, &str)], pictures: u64) -> Vec<f64> {
    let options: Vec<(String, String)> = options.iter().map(|o| (o.0.to_owned(), o.1.to_owned())).collect();
    let of = |seed| mean(&film_by(scene, &*integrator::with_options(method, UNLIMITED, &options).unwrap(), 8, seed)).0;
    (100..100 + pictures).map(of).collect()
}

/// How many standard errors the mean of independent pictures is from that of `path`. Pixels of one picture share light paths,
/// so that only whole pictures are independent.
pub(crate) fn deviation(scene: &Scene, method: &str, options: &[(&str, &str)], pictures: u64) -> f64 {
    let (path, error) = mean(&film(scene, "path", UNLIMITED, 1 << 14, 6));
    let means = means(scene, method, options, pictures);
    let n = pictures as f64;
    let ours = means.iter().sum::<f64>() / n;
    let variance = means.iter().map(|m| (m - ours).powi(2)).sum::<f64>() / (n * (n - 1.0));
    let z = (ours - path) / (variance + error * error).sqrt();
    println!("{method} {options:?}: {ours} beside {path}, standard errors {} and {error}, z {z}", variance.sqrt());
    z
}
