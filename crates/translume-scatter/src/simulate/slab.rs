//! A slab between z = 0, the lit side, and z = −thickness, infinite to the sides; and what cameras above it see of it.

use super::Medium;
use super::stage::Stage;
use super::walk::{Body, Exit, Importance, Interface, Wall, World};
use crate::capture::Camera;
use glam::Vec3;
use rayon::prelude::*;
use translume_core::rng::Pcg32;

/// The walls of the slab.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slab {
    /// Depth of the lower boundary in mm; `INFINITY` for a half-space.
    pub thickness_mm: f64,
}

/// The lit face of a slab; the other one is 1.
pub const TOP: u32 = 0;

impl Body for Slab {
    fn enter(&self, origin: [f64; 3], direction: Vec3) -> Option<Wall> {
        let d = direction.as_dvec3();
        let distance = -origin[2] / d.z;
        let at = [origin[0] + distance * d.x, origin[1] + distance * d.y, 0.0];
        (d.z < 0.0 && distance >= 0.0).then_some(Wall { distance, at, normal: Vec3::Z, face: TOP, uv: [0.0; 2] })
    }

    fn wall(&self, p: [f64; 3], direction: Vec3) -> Option<Wall> {
        let d = direction.as_dvec3();
        let up = d.z > 0.0;
        let height = if up { 0.0 } else { -self.thickness_mm };
        let distance = ((height - p[2]).abs() / d.z.abs().max(1e-12)).max(0.0);
        let at = [p[0] + distance * d.x, p[1] + distance * d.y, height];
        let normal = if up { Vec3::Z } else { -Vec3::Z };
        Some(Wall { distance, at, normal, face: if up { TOP } else { 1 }, uv: [0.0; 2] })
    }

    fn clearance(&self, _: [f64; 3]) -> f64 {
        0.0 // the wall itself costs no more
    }
}

/// Follows `photons` photons of a pencil beam at the origin and perpendicular to the slab, in fixed portions on all threads;
/// `add` gets each exit into a portion's tally, `merge` joins two of them in their order.
pub fn pencil_beam<T: Send>(
    (slab, medium, interface, importance): (&Slab, &Medium, &Interface, &Importance),
    (photons, seed): (usize, u64),
    empty: impl Fn() -> T + Sync,
    add: impl Fn(&mut T, Exit) + Sync,
    merge: impl Fn(T, T) -> T,
) -> T {
    const PORTION: usize = 4096;
    let world = World { body: slab, medium, interface, importance };
    let portion = |i: usize| {
        let mut rng = Pcg32::new(seed, i as u64);
        let mut tally = empty();
        for _ in 0..PORTION.min(photons - i * PORTION) {
            world.shine([0.0, 0.0, 1.0], -Vec3::Z, &mut rng, &mut |exit| add(&mut tally, exit));
        }
        tally
    };
    let tallies: Vec<T> = (0..photons.div_ceil(PORTION)).into_par_iter().map(portion).collect();
    tallies.into_iter().fold(empty(), merge)
}

/// A slab under cameras: a bin for each pixel of each.
pub(super) struct SlabStage {
    slab: Slab,
    cameras: Vec<Camera>,
    /// First bin of each camera, and their number at the end.
    starts: Vec<usize>,
    /// Radiance per power that leaves, of each bin.
    radiance: Vec<f64>,
}

impl SlabStage {
    pub(super) fn new(slab: Slab, cameras: Vec<Camera>, interface: &Interface) -> Self {
        let mut starts = vec![0];
        let mut radiance = Vec::new();
        for camera in &cameras {
            for row in 0..camera.height {
                radiance.extend((0..camera.width).map(|column| per_power(camera, (row, column), interface)));
            }
            starts.push(radiance.len());
        }
        Self { slab, cameras, starts, radiance }
    }
}

/// Radiance of a pixel per power that leaves in its footprint: a pixel above the horizon sees nothing.
fn per_power(camera: &Camera, (row, column): (usize, usize), interface: &Interface) -> f64 {
    let corner = |dx: f64, dy: f64| camera.on_plane([column as f64 + dx, row as f64 + dy], 0.0);
    let corners = [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)];
    // The shoelace formula.
    let area = corners.into_iter().collect::<Option<Vec<_>>>().map_or(0.0, |c| {
        let twice: f64 = (0..4).map(|i| c[i][0] * c[(i + 1) % 4][1] - c[i][1] * c[(i + 1) % 4][0]).sum();
        0.5 * twice.abs()
    });
    let cos = -camera.direction([column as f64 + 0.5, row as f64 + 0.5])[2];
    if area > 0.0 { interface.radiance(cos) / area } else { 0.0 }
}

impl Stage for SlabStage {
    type Body = Slab;

    fn body(&self) -> &Slab {
        &self.slab
    }

    fn bins(&self) -> usize {
        self.radiance.len()
    }

    fn record(&self, exit: &Exit, light: &mut [[f64; 3]]) {
        if exit.wall.face != TOP {
            return;
        }
        for (camera, start) in self.cameras.iter().zip(&self.starts) {
            let Some(px) = camera.project(exit.wall.at) else { continue };
            let (w, h) = (camera.width as f64, camera.height as f64);
            if (0.0..w).contains(&px[0]) && (0.0..h).contains(&px[1]) {
                let bin = &mut light[start + px[1] as usize * camera.width + px[0] as usize];
                bin.iter_mut().zip(exit.weight).for_each(|(b, w)| *b += w);
            }
        }
    }

    fn frame(&self, view: usize, light: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let bins = self.starts[view]..self.starts[view + 1];
        light[bins.clone()].iter().zip(&self.radiance[bins]).map(|(l, f)| l.map(|l| l * f)).collect()
    }

    fn views(&self) -> usize {
        self.cameras.len()
    }

    fn sees(&self, _: usize, _: usize) -> bool {
        true
    }
}
