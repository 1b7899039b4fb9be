//! Translucent surfaces: white furnaces, integrals over bent objects, the random walk beside the dipole, threads.

mod common;

use common::*;
use glam::{DAffine3, DVec3, Vec2, Vec3};
use std::sync::Arc;
use translume_bxdf::bssrdf::{Bssrdf, Site};
use translume_bxdf::homogeneous::{Diffusion, Homogeneous, mean_reflectance};
use translume_bxdf::{Phase, Rgb, fresnel};
use translume_core::rng::Pcg32;
use translume_core::warp;
use translume_mesh::TriMesh;
use translume_render::World;
use translume_scene::material::{Dielectric, Model, Subsurface};
use translume_scene::medium::{Medium, Volume};
use translume_scene::{Geometry, MaterialId, MediumId};
use translume_trace::Ray;

impl Maker {
    fn subsurface(&mut self, model: Homogeneous, eta: f32, mm_per_unit: f64) -> MaterialId {
        let specular_reflectance = self.gray(1.0);
        let model = Arc::new(model);
        let under =
            Subsurface { model, mm_per_unit, in_object_space: false, eta, roughness: None, specular_reflectance };
        self.material(Model::Subsurface(Box::new(under)))
    }
}

fn wax(model: Diffusion, eta: f32) -> Homogeneous {
    Homogeneous::new(model, Rgb::splat(2.0), Rgb::splat(0.05), eta).unwrap()
}

/// Seen from above under a uniform sky: F_r + F_t R, R the total reflectance in closed form.
#[test]
fn a_half_space_in_a_furnace_sends_back_its_total() {
    for model in [Diffusion::Dipole, Diffusion::BetterDipole, Diffusion::Normalized] {
        for (method, disk, eta) in
            [("path", false, 1.5), ("path", true, 1.5), ("path", false, 1.0), ("volpath", false, 1.3)]
        {
            let under = wax(model, eta);
            let total = f64::from(under.total(&Site { p: Vec3::ZERO, face: 0, uv: Vec2::ZERO }).y);
            let mut m = Maker::default();
            // Millimetres are thousandths here: a square of 0.6 units is 600 mm wide.
            let material = m.subsurface(under, eta, 1000.0);
            match disk {
                true => m.shape(Geometry::Disk, DAffine3::from_scale(DVec3::splat(0.3)), material),
                false => m.square(0.3, 0.0, material),
            };
            m.constant(1.0);
            m.camera(DVec3::new(0.0, 0.0, 0.3), DVec3::ZERO, 0.02);
            let r = f64::from(fresnel::dielectric(1.0, eta).reflectance);
            expect(&film(&m.0, method, UNLIMITED, 256, 1), r + (1.0 - r) * total, 2e-3);
        }
    }
}

/// A lumpy closed mesh with long and flat parts: a subdivided octahedron pushed about.
fn lump() -> TriMesh {
    let mut triangles: Vec<[Vec3; 3]> = Vec::new();
    for signs in 0..8 {
        let axis = |k: usize| if signs >> k & 1 == 0 { 1.0f32 } else { -1.0 };
        let [a, b, c] = [Vec3::X * axis(0), Vec3::Y * axis(1), Vec3::Z * axis(2)];
        triangles.push(if axis(0) * axis(1) * axis(2) > 0.0 { [a, b, c] } else { [a, c, b] });
    }
    for _ in 0..3 {
        triangles = triangles
            .into_iter()
            .flat_map(|[a, b, c]| {
                let (ab, bc, ca) = ((a + b).normalize(), (b + c).normalize(), (c + a).normalize());
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    let push = |p: Vec3| p * Vec3::new(3.0, 1.2, 0.5) * (1.0 + 0.3 * (4.0 * p.x).sin() * (3.0 * p.y).cos());
    let positions: Vec<[f32; 3]> = triangles.iter().flatten().map(|p| push(*p).to_array()).collect();
    let indices = (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    TriMesh { positions, indices, ..TriMesh::default() }
}

/// What is drawn, weighed by R_d/p, integrates R_d over each eighth of a bent object and over all of it; placed and turned
/// alike. The direct sum over small triangles is the truth. False alarms: 27 z-tests beyond 4.5 sigma, 2 in 10⁴.
#[test]
fn entries_integrate_the_reflectance_over_a_bent_object() {
    let mesh = Arc::new(lump());
    let model = wax(Diffusion::Dipole, 1.4);
    let spread = DAffine3::from_rotation_z(0.7) * DAffine3::from_scale(DVec3::splat(0.5));
    for placed in [DAffine3::IDENTITY, spread] {
        let mut m = Maker::default();
        let material = m.subsurface(wax(Diffusion::Dipole, 1.4), 1.4, if placed == spread { 2.0 } else { 1.0 });
        m.shape(Geometry::Mesh(mesh.clone()), placed, material);
        m.constant(1.0);
        let world = World::new(Arc::new(m.0)).unwrap();
        let mm = if placed == spread { 2.0 } else { 1.0 };
        for (eye, d) in [(Vec3::new(0.1, 0.2, 9.0), -Vec3::Z), (Vec3::new(-9.0, 0.1, 0.05), Vec3::X)] {
            let to_world = |v: Vec3| placed.transform_vector3(v.as_dvec3()).as_vec3();
            let hit = world.intersect(&Ray::new(to_world(eye), to_world(d).normalize())).unwrap();
            let site = |p: Vec3| Site { p, face: 0, uv: Vec2::ZERO };
            let octant = |p: Vec3| usize::from(p.x > 0.0) | usize::from(p.y > 0.0) << 1 | usize::from(p.z > 0.0) << 2;
            // The truth, in mm: the transforms cancel but for the rotation.
            let to = site(hit.point.p * mm);
            let mut truth = [0.0f64; 9];
            for face in 0..mesh.indices.len() {
                let [a, b, c] = mesh.corners(face);
                let (n, area) = (24, 0.5 * (b - a).cross(c - a).length());
                for i in 0..n * n {
                    let at = warp::uniform_triangle(
                        (i % n) as f32 / n as f32 + 0.5 / n as f32,
                        (i / n) as f32 / n as f32 + 0.5 / n as f32,
                    );
                    let p = to_world(a + (b - a) * at.x + (c - a) * at.y);
                    let value = f64::from(model.eval(&site(p * mm), &to).y) * f64::from(area) / f64::from(n * n);
                    truth[octant(p)] += value;
                    truth[8] += value;
                }
            }
            let n = 60_000;
            let (mut sum, mut square) = ([0.0f64; 9], [0.0f64; 9]);
            let mut rng = Pcg32::new(11, 3);
            for _ in 0..n {
                let Some(entry) = world.entry(&hit, &mut rng) else { continue };
                let value = f64::from(entry.weight.y);
                for k in [octant(entry.hit.point.p), 8] {
                    sum[k] += value;
                    square[k] += value * value;
                }
            }
            for k in 0..9 {
                let mean = sum[k] / f64::from(n);
                let error = ((square[k] / f64::from(n) - mean * mean) / f64::from(n)).sqrt();
                assert!(
                    (mean - truth[k]).abs() < 4.5 * error + 2e-3 * truth[8],
                    "{k}: {mean} ± {error}, not {}",
                    truth[k]
                );
            }
        }
    }
}

/// A ball of a dense medium without a boundary of its own: the dipole beside the random walk. The dipole is made for a plane
/// and knows no single scattering, so a tenth is what it is expected to be off under light from everywhere.
#[test]
fn the_dipole_is_near_the_random_walk_on_a_ball() {
    let (s, a) = (3.0, 0.06);
    for eta in [1.0f32, 1.4] {
        let mut walk = Maker::default();
        walk.0.media.push(Medium {
            name: String::new(),
            sigma_t: Volume::Constant(Rgb::splat(s + a)),
            albedo: Volume::Constant(Rgb::splat(s / (s + a))),
            scale: 1.0,
            phase: Phase::Isotropic,
            domain: None,
        });
        let one = walk.gray(1.0);
        let boundary = match eta > 1.0 {
            true => Model::Dielectric(Dielectric { eta, specular_reflectance: one, specular_transmittance: one }),
            false => Model::Null,
        };
        let boundary = walk.material(boundary);
        walk.sphere(DVec3::ZERO, 8.0, boundary).interior = Some(MediumId(0));
        let mut dipole = Maker::default();
        let model = Homogeneous::new(Diffusion::Dipole, Rgb::splat(s), Rgb::splat(a), eta).unwrap();
        let material = dipole.subsurface(model, eta, 1.0);
        dipole.sphere(DVec3::ZERO, 8.0, material);
        for m in [&mut walk, &mut dipole] {
            m.constant(1.0);
            m.camera(DVec3::new(0.0, -40.0, 0.0), DVec3::ZERO, 0.25);
        }
        let (truth, noise) = mean(&film(&walk.0, "volpath", UNLIMITED, 256, 2));
        let (found, _) = mean(&film(&dipole.0, "path", UNLIMITED, 64, 3));
        assert!(
            noise < 0.01 * truth && (found / truth - 1.0).abs() < 0.1,
            "η {eta}: {found}, the walk {truth} ± {noise}"
        );
    }
}

#[test]
fn threads_do_not_change_a_bit() {
    let mut m = Maker::default();
    let material = m.subsurface(wax(Diffusion::BetterDipole, 1.4), 1.4, 1.0);
    m.shape(Geometry::Mesh(Arc::new(lump())), DAffine3::IDENTITY, material);
    m.constant(1.0);
    m.camera(DVec3::new(0.0, 2.0, 9.0), DVec3::ZERO, 0.5);
    same_for_threads(3, || film(&m.0, "path", UNLIMITED, 16, 5));
}

#[test]
fn what_cannot_be_is_refused() {
    // Other methods.
    let mut m = Maker::default();
    let material = m.subsurface(wax(Diffusion::Dipole, 1.4), 1.4, 1.0);
    m.square(1.0, 0.0, material);
    m.constant(1.0);
    let world = World::new(Arc::new(m.0.clone())).unwrap();
    for method in ["bdpt", "photonmap", "gkernel", "gkernel-2003"] {
        let refused = translume_render::integrator::by_name(method, UNLIMITED).unwrap().check(&world);
        assert!(refused.unwrap_err().to_string().contains("translucent"), "{method}");
    }
    // Half of one.
    let (half, gray) = (m.gray(0.5), m.diffuse(0.5));
    let blend = m.material(Model::Blend { weight: half, first: gray, second: material });
    m.square(1.0, 1.0, blend);
    assert!(World::new(Arc::new(m.0)).is_err());
    assert!((mean_reflectance(1.5) - 0.0918).abs() < 2e-4);
}
