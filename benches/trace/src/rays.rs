//! Meshes and rays to race on.

use translume_core::rng::Pcg32;
use translume_mesh::TriMesh;
use translume_trace::glam::Vec3;
use translume_trace::{Geometry, Ray};

/// Kinds of rays, see the crate's description.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Kind {
    Coherent,
    Diffuse,
    AnyHit,
}

impl Kind {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Coherent => "coherent",
            Self::Diffuse => "diffuse",
            Self::AnyHit => "any-hit",
        }
    }
}

pub(crate) struct RaySet {
    pub(crate) kind: Kind,
    pub(crate) rays: Vec<Ray>,
}

const SIZE: usize = 640;

impl RaySet {
    pub(crate) fn new(kind: Kind, geometry: &Geometry) -> Self {
        let camera = camera(geometry);
        if kind == Kind::Coherent {
            return Self { kind, rays: camera };
        }
        let mut rng = Pcg32::new(7, kind as u64);
        let (center, extent) = (geometry.bounds().center(), geometry.bounds().extent());
        let rays = camera.iter().filter_map(|ray| {
            let surface = geometry.surface(ray, &geometry.intersect(ray)?);
            let normal = surface.ng * -surface.ng.dot(ray.d).signum();
            Some(match kind {
                Kind::AnyHit => surface.segment_to(center + 0.9 * extent * (in_unit_cube(&mut rng) - 0.5)),
                _ => surface.spawn((normal + on_sphere(&mut rng)).normalize_or(normal)),
            })
        });
        Self { kind, rays: rays.collect() }
    }
}

fn in_unit_cube(rng: &mut Pcg32) -> Vec3 {
    Vec3::new(rng.next_f32(), rng.next_f32(), rng.next_f32())
}

fn on_sphere(rng: &mut Pcg32) -> Vec3 {
    let z = 2.0 * rng.next_f32() - 1.0;
    let (sin, cos) = (std::f32::consts::TAU * rng.next_f32()).sin_cos();
    let r = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(r * cos, r * sin, z)
}

/// Rows of a camera inside the room that looks at its middle.
fn camera(geometry: &Geometry) -> Vec<Ray> {
    let (center, extent) = (geometry.bounds().center(), geometry.bounds().extent());
    let eye = center + Vec3::new(0.2, 0.15, 0.48) * extent;
    let forward = (center - eye).normalize();
    let right = forward.cross(Vec3::Y).normalize();
    let up = right.cross(forward);
    let pixel = |i: usize| {
        let at = |k: usize| (k as f32 + 0.5) / SIZE as f32 * 1.4 - 0.7;
        Ray::new(eye, (forward + at(i % SIZE) * right - at(i / SIZE) * up).normalize())
    };
    (0..SIZE * SIZE).map(pixel).collect()
}

/// The mesh in the middle of a box twice its size.
pub(crate) fn in_room(mut mesh: TriMesh) -> TriMesh {
    let (center, half) = (mesh.bounds().center(), mesh.bounds().extent());
    let corner = |i: u32| {
        let side = |k: u32| if i >> k & 1 == 0 { -1.0 } else { 1.0 };
        (center + half * Vec3::new(side(0), side(1), side(2))).to_array()
    };
    let room = TriMesh {
        positions: (0..8).map(corner).collect(),
        indices: [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
            .iter()
            .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
            .collect(),
        ..TriMesh::default()
    };
    assert!(mesh.append(&room), "the mesh is too large");
    mesh
}

/// A sphere of 2 n (n − 1) triangles in rows and columns, with bumps of several sizes.
pub(crate) fn bumpy_sphere(n: usize) -> TriMesh {
    let point = |row: usize, column: usize| {
        let (st, ct) = (std::f32::consts::PI * row as f32 / n as f32).sin_cos();
        let (sp, cp) = (std::f32::consts::TAU * column as f32 / n as f32).sin_cos();
        let p = Vec3::new(st * cp, ct, st * sp);
        let bump = 0.1 * (9.0 * p.x).sin() * (7.0 * p.y).cos() + 0.02 * (60.0 * p.z).sin() * (50.0 * p.x).sin();
        (p * (1.0 + bump)).to_array()
    };
    let mut mesh = TriMesh { positions: vec![point(0, 0)], ..TriMesh::default() };
    let number = |row: usize, column: usize| match row {
        0 => 0,
        r if r == n => (1 + (n - 1) * n) as u32,
        r => (1 + (r - 1) * n + column % n) as u32,
    };
    (1..n).for_each(|row| (0..n).for_each(|column| mesh.positions.push(point(row, column))));
    mesh.positions.push(point(n, 0));
    for row in 0..n {
        for column in 0..n {
            let [a, b] = [number(row, column), number(row, column + 1)];
            let [c, d] = [number(row + 1, column), number(row + 1, column + 1)];
            mesh.indices.extend([[a, b, c], [b, d, c]].into_iter().filter(|t| t[0] != t[1] && t[1] != t[2]));
        }
    }
    mesh
}
