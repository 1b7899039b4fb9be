//! A bumpy closed shape and a heterogeneous R_d on it.

use glam::Vec3;
use translume_mesh::TriMesh;

/// `n` bands of 2n segments: 2n(n − 1) + 2 vertices; about 100 mm wide.
pub(crate) fn bumpy(n: u32) -> TriMesh {
    let ring = |j: u32, i: u32| match j {
        0 => 0,
        j if j == n => 1 + (n - 1) * 2 * n,
        j => 1 + (j - 1) * 2 * n + i % (2 * n),
    };
    let place = |theta: f32, phi: f32| {
        let d = Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
        let bump = 0.12 * (3.0 * d.x + 1.0).sin() * (4.0 * d.y).cos() + 0.08 * (5.0 * d.z).sin();
        (50.0 * (1.0 + bump) * d).to_array()
    };
    let mut positions = vec![place(0.0, 0.0)];
    let step = std::f32::consts::PI / n as f32;
    positions.extend((1..n).flat_map(|j| (0..2 * n).map(move |i| place(step * j as f32, step * i as f32))));
    positions.push(place(std::f32::consts::PI, 0.0));
    let mut indices = Vec::new();
    for (j, i) in (0..n).flat_map(|j| (0..2 * n).map(move |i| (j, i))) {
        let [a, b, c, d] = [ring(j, i), ring(j + 1, i), ring(j + 1, i + 1), ring(j, i + 1)];
        indices.extend([[a, b, c], [a, c, d]].into_iter().filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]));
    }
    TriMesh { positions, indices, ..TriMesh::default() }
}

/// R_d between two places: a fall-off of two exponentials, whose reach and strength change over the object.
pub(crate) fn reflectance(a: Vec3, b: Vec3) -> [f32; 3] {
    let local = |p: Vec3| 0.5 * (p.x / 11.0 + (p.y / 7.0).sin()).sin() + 0.5 * (p.z / 9.0).cos();
    let (d, s) = (a.distance(b), 0.5 * (local(a) + local(b)));
    let fall_off = |reach: f32| 0.02 * (-d / (0.5 * reach)).exp() + 2e-4 * (-d / (5.0 * reach)).exp();
    [1.25, 1.0, 0.8].map(|c| (0.5 * s).exp() * fall_off(c * (1.0 + 0.3 * s)))
}
