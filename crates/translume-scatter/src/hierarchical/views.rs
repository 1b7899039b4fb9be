//! What does not change while a camera and the object stand still [Goesele 2004, §5]: where vertices and texels lie in the
//! picture, which of them are seen well, Fresnel's term and the weight of what is measured there.

use super::atlas::Atlas;
use crate::capture::{Camera, Surface, dot, norm, sub};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use translume_bxdf::fresnel;
use translume_mesh::TriMesh;
use translume_trace::SurfacePoint;

/// Places seen at less than this cosine are left out.
const GRAZING: f32 = 0.25;
/// A step of distance between neighbouring pixels that belongs to a silhouette, in widths of a pixel.
const STEP: f64 = 8.0;

/// Where a place lies in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lookup {
    /// The upper left of four pixels, row by row.
    pub(super) pixel: u32,
    /// Between them.
    pub(super) fx: f32,
    pub(super) fy: f32,
    /// 1/F_t(η, ω_o).
    pub(super) inverse: f32,
    /// The cosine to the camera; 0 where the place is not seen.
    pub(super) weight: f32,
    /// Direction to the camera.
    pub(super) towards: Vec3,
}

/// A camera's view of the model.
pub(super) struct ViewMap {
    pub(super) vertices: Vec<Option<Lookup>>,
    pub(super) texels: Vec<Option<Lookup>>,
    pub(super) width: usize,
}

impl ViewMap {
    pub(super) fn new(camera: &Camera, eta: f64, surface: &Surface, normals: &[Vec3], atlas: &Atlas) -> Self {
        let sound = sound_pixels(camera, surface);
        let at = |p: Vec3, normal: Vec3| lookup(camera, eta, surface, &sound, p, normal);
        let positions = &surface.mesh.positions;
        Self {
            vertices: (0..positions.len()).into_par_iter().map(|i| at(positions[i].into(), normals[i])).collect(),
            texels: atlas.texels.par_iter().map(|t| at(t.at, t.normal)).collect(),
            width: camera.width,
        }
    }
}

/// Unit vertex normals.
pub(super) fn vertex_normals(mesh: &TriMesh) -> Vec<Vec3> {
    let mut mesh = mesh.clone();
    mesh.compute_normals();
    mesh.normals.into_iter().flatten().map(Vec3::from).collect()
}

/// Pixels that see the mesh, away from silhouettes: where a small error of pose would show something else.
fn sound_pixels(camera: &Camera, surface: &Surface) -> Vec<bool> {
    let (w, h) = (camera.width, camera.height);
    let centre = |i: usize| [(i % w) as f64 + 0.5, (i / w) as f64 + 0.5];
    let depths: Vec<f64> = (0..w * h)
        .into_par_iter()
        .map(|i| surface.seen(camera, centre(i)).map_or(f64::INFINITY, |s| s.0.distance))
        .collect();
    let sound = |i: usize| {
        let (x, y) = (i % w, i / w);
        let step = STEP * depths[i] / camera.focal_px;
        let span = |k: usize, n: usize| k.saturating_sub(1)..=(k + 1).min(n - 1);
        depths[i].is_finite() && span(y, h).all(|y| span(x, w).all(|x| (depths[y * w + x] - depths[i]).abs() <= step))
    };
    (0..w * h).map(sound).collect()
}

fn lookup(camera: &Camera, eta: f64, surface: &Surface, sound: &[bool], p: Vec3, normal: Vec3) -> Option<Lookup> {
    let place = p.as_dvec3().to_array();
    let to_eye = sub(camera.eye(), place);
    let cos = (dot(to_eye, normal.as_dvec3().to_array()) / norm(to_eye)) as f32;
    let [x, y] = camera.project(place)?.map(|x| x - 0.5);
    let inside = x >= 0.0 && y >= 0.0 && x < (camera.width - 1) as f64 && y < (camera.height - 1) as f64;
    if cos.is_nan() || cos < GRAZING || !inside {
        return None;
    }
    let pixel = y as usize * camera.width + x as usize;
    let four = [pixel, pixel + 1, pixel + camera.width, pixel + camera.width + 1];
    let eye = Vec3::from_array(camera.eye().map(|x| x as f32));
    if !four.iter().all(|&i| sound[i]) || hidden(surface, p, normal, eye) {
        return None;
    }
    let through = 1.0 - fresnel::dielectric(cos, eta as f32).reflectance;
    let towards = DVec3::from_array(to_eye).normalize().as_vec3();
    Some(Lookup {
        pixel: pixel as u32,
        fx: x.fract() as f32,
        fy: y.fract() as f32,
        inverse: 1.0 / through,
        weight: cos,
        towards,
    })
}

/// Whether the mesh lies between a place of it and a point in space.
pub(crate) fn hidden(surface: &Surface, p: Vec3, normal: Vec3, from: Vec3) -> bool {
    // Positions are rounded, and vertices lie on triangles of other slopes.
    let error = p.abs().max(surface.extent()) * 4.0 * f32::EPSILON;
    surface.occluded(&SurfacePoint { p, ng: normal, error }.segment_to(from))
}
