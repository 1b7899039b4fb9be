//! A virtual capture: a laser beam on a slab of a heterogeneous medium, seen by a noisy camera.
//!
//! The light that leaves the slab is found by a random walk without approximations. Its direction is not: every place is
//! taken to be equally bright from inside in all directions, L_o = F_t(η, ω_o) M / (π (1 − F̄)) with the radiosity M and F̄ the
//! mean reflectance of the boundary from outside, or M/π for a rough boundary. That is the assumption of the measurement
//! equation itself [Goesele 2004, Eq. 2]; single scattering keeps its strength and place, but not its direction.

mod lit;
mod medium;
mod slab;
mod solid;
mod stage;
mod walk;

pub use lit::{LitParams, picture_of_solid};
pub use medium::{Local, Medium, Procedural};
pub use slab::{Slab, TOP, pencil_beam};
pub use solid::{Solid, capture_solid};
pub use walk::{Body, Exit, Importance, Interface, Wall, World};

use crate::capture::{Camera, Capture, Channel, Laser, Rig, View, dot, norm, sub};
use serde::Serialize;
use slab::SlabStage;
use std::f64::consts::TAU;
use std::path::Path;
use translume_bxdf::fresnel;
use translume_core::rng::Pcg32;
use translume_image::Result;
use translume_mesh::TriMesh;

/// How to capture; lengths in mm.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CaptureParams {
    /// Columns and rows of laser positions.
    pub spots: usize,
    /// Distance between them.
    pub spacing_mm: f64,
    /// Diameter of the Gaussian beam, at 1/e².
    pub beam_diameter_mm: f64,
    /// Columns and rows of a frame.
    pub pixels: usize,
    /// Width of the object in the frame.
    pub field_mm: f64,
    /// Positions of the turntable, around the slab's normal.
    pub views: usize,
    /// Cameras at each of them.
    pub cameras: usize,
    /// Thickness of the slab.
    pub thickness_mm: f64,
    /// Index of refraction.
    pub eta: f64,
    /// Diffusing boundary.
    pub rough: bool,
    /// Photons for each laser position.
    pub photons: usize,
    /// How evenly the noise of the walk lies over all distances: with 1 faint places are as sure as bright ones, with 0 no photon is split.
    pub evenness: f64,
    /// Brightest to darkest radiance that the camera tells from black, in dB; infinite for a camera without noise.
    pub dynamic_range_db: f64,
    /// Standard deviation of the response of a pixel, relative.
    pub pixel_noise: f64,
    /// Rig error: standard deviation of the laser's power from frame to frame, relative; the rig does not know of it.
    pub drift: f64,
    /// Rig error: standard deviation of a shift of the cameras, against what the rig says.
    pub misregistration_mm: f64,
    /// Rig error: standard deviation of a shift of every laser hit, against what the rig says.
    pub peak_shift_mm: f64,
    /// Rig error: standard deviation of the heights of the mesh's vertices.
    pub geometry_error_mm: f64,
    /// Seed of light, noise and errors.
    pub seed: u64,
}

impl Default for CaptureParams {
    fn default() -> Self {
        Self {
            spots: 8,
            spacing_mm: 1.0,
            beam_diameter_mm: 2.0,
            pixels: 48,
            field_mm: 24.0,
            views: 1,
            cameras: 1,
            thickness_mm: 16.0,
            eta: 1.5,
            rough: false,
            photons: 4_000,
            evenness: 1.0,
            dynamic_range_db: 120.0,
            pixel_noise: 0.01,
            drift: 0.0,
            misregistration_mm: 0.0,
            peak_shift_mm: 0.0,
            geometry_error_mm: 0.0,
            seed: 1,
        }
    }
}

/// Laser projector and cameras of the planar set-up [Fuchs 2005, Fig. 2], in mm.
const LASER_HEIGHT: f64 = 850.0;
const CAMERA_DISTANCE: f64 = 600.0;
const CAMERA_TILT_RAD: f64 = 0.26;
/// Wavelengths of the three lasers in nm.
const CHANNELS: [(&str, f64); 3] = [("red", 640.0), ("green", 532.0), ("blue", 473.0)];

/// Simulates a capture of `medium` into the folder `path`; `progress` is told how many laser positions are done. The rig's
/// provenance holds `params` and `label`.
///
/// # Errors
/// Those of writing.
pub fn capture_slab(
    path: &Path,
    medium: &Medium,
    params: &CaptureParams,
    label: serde_json::Value,
    progress: impl Fn() + Sync,
) -> Result<Capture> {
    let mut errors = Pcg32::new(params.seed, u64::MAX >> 2);
    let rig = rig(params, label);
    let cameras: Vec<Camera> = rig.views.iter().map(|v| shifted(&v.camera, params, &mut errors)).collect();
    let mesh = slab_mesh(params, &mut errors);
    let mut capture = Capture::create(path, rig, mesh)?;
    let interface = Interface::new(params.eta, params.rough);
    let stage = SlabStage::new(Slab { thickness_mm: params.thickness_mm }, cameras, &interface);
    stage::expose(&stage, (medium, &interface), params, &mut capture, progress)?;
    Capture::create(path, capture.rig, capture.mesh)
}

/// Fresnel transmittance of the horizontal surface seen at a place of the frame.
pub(crate) fn transmittance(camera: &Camera, px: [f64; 2], eta: f64) -> f64 {
    let cos = -camera.direction(px)[2];
    f64::from(1.0 - fresnel::dielectric(cos as f32, eta as f32).reflectance)
}

/// A channel as the rig knows it before the capture.
fn channel((name, wavelength_nm): (&str, f64)) -> Channel {
    Channel { name: name.into(), wavelength_nm: Some(wavelength_nm), white_balance: 1.0, noise_floor: 0.0 }
}

/// The camera as it really stood: turned about its own axes by a random shift of the picture.
fn shifted(camera: &Camera, params: &CaptureParams, rng: &mut Pcg32) -> Camera {
    let mut real = camera.clone();
    let px_per_mm = params.pixels as f64 / params.field_mm;
    real.center_px.iter_mut().for_each(|c| *c += params.misregistration_mm * px_per_mm * rng.next_normal());
    real
}

/// The slab's lit side, as two triangles for each 2 mm.
fn slab_mesh(params: &CaptureParams, rng: &mut Pcg32) -> TriMesh {
    let half = 0.75 * params.field_mm;
    let n = (half.ceil() as u32).clamp(1, 256);
    let at = |i: u32| (2.0 * f64::from(i) / f64::from(n) - 1.0) * half;
    let mut positions = Vec::new();
    for j in 0..=n {
        for i in 0..=n {
            let z = params.geometry_error_mm * rng.next_normal();
            positions.push([at(i) as f32, at(j) as f32, z as f32]);
        }
    }
    let index = |i: u32, j: u32| j * (n + 1) + i;
    let quads = (0..n).flat_map(|j| (0..n).map(move |i| (i, j)));
    let indices = quads.flat_map(|(i, j)| {
        let [a, b, c, d] = [index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)];
        [[a, b, c], [a, c, d]]
    });
    TriMesh { positions, indices: indices.collect(), ..TriMesh::default() }
}

fn hits(params: &CaptureParams) -> Vec<[f64; 3]> {
    let at = |i: usize| (i as f64 - (params.spots as f64 - 1.0) / 2.0) * params.spacing_mm;
    (0..params.spots * params.spots).map(|i| [at(i % params.spots), at(i / params.spots), 0.0]).collect()
}

/// The rig as it is written down.
fn rig(params: &CaptureParams, label: serde_json::Value) -> Rig {
    let view = |i: usize| {
        let turn = TAU * i as f64 / params.views as f64;
        let (far, height) = (CAMERA_DISTANCE * CAMERA_TILT_RAD.sin(), CAMERA_DISTANCE * CAMERA_TILT_RAD.cos());
        let eye = [far * turn.sin(), -far * turn.cos(), height];
        let up = [-turn.sin(), turn.cos(), 0.0];
        let size = (params.pixels, params.pixels);
        View { turntable_deg: turn.to_degrees(), camera: Camera::looking_at(eye, [0.0; 3], up, size, params.field_mm) }
    };
    Rig {
        provenance: serde_json::json!({ "simulated": label, "parameters": params }),
        ..Rig::new(
            params.eta,
            CHANNELS.into_iter().map(channel).collect(),
            (0..params.views).map(view).collect(),
            Laser {
                origin_mm: [0.0, 0.0, LASER_HEIGHT],
                origins_mm: Vec::new(),
                beam_diameter_mm: params.beam_diameter_mm,
                power: vec![1.0; 3],
                grid: [params.spots; 2],
                hits_mm: hits(params),
            },
        )
    }
}

/// Cosine of incidence of the laser at a hit on the horizontal plane.
pub(crate) fn incidence(origin: [f64; 3], hit: [f64; 3]) -> f64 {
    let d = sub(origin, hit);
    dot(d, [0.0, 0.0, 1.0]) / norm(d)
}
