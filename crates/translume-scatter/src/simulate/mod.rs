//! A virtual capture: a laser beam on a slab of a heterogeneous medium, seen by a noisy camera.
//!
//! The light that leaves the slab is found by a random walk without approximations. Its direction is not: every place is
//! taken to be equally bright from inside in all directions, L_o = F_t(η, ω_o) M / (π (1 − F̄)) with the radiosity M and F̄ the
//! mean reflectance of the boundary from outside, or M/π for a rough boundary. That is the assumption of the measurement
//! equation itself [Goesele 2004, Eq. 2]; single scattering keeps its strength and place, but not its direction.

mod medium;
mod walk;

pub use medium::{Local, Medium, Procedural};
pub use walk::{Exit, Slab, pencil_beam};

use crate::capture::{Camera, Capture, Channel, Laser, RIG_VERSION, Rig, View, dot, norm, normalize, sub};
use glam::Vec3;
use rayon::prelude::*;
use serde::Serialize;
use std::f64::consts::{PI, TAU};
use std::path::Path;
use translume_bxdf::fresnel;
use translume_core::rng::Pcg32;
use translume_image::Result;
use translume_mesh::TriMesh;
use walk::{Averages, photon};

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
    /// Thickness of the slab.
    pub thickness_mm: f64,
    /// Index of refraction.
    pub eta: f64,
    /// Diffusing boundary.
    pub rough: bool,
    /// Photons for each laser position.
    pub photons: usize,
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
            thickness_mm: 16.0,
            eta: 1.5,
            rough: false,
            photons: 400_000,
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
/// Photons in a pixel that count as the noise floor.
const GRAIN: f64 = 4.5;
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
    let slab = Slab { thickness_mm: params.thickness_mm, eta: params.eta, rough: params.rough };
    let footprints: Vec<Footprints> = cameras.iter().map(|c| Footprints::new(c, &slab)).collect();
    let sensor = Sensor::of(&footprints, medium, &slab, params);
    let averages = Averages::new(slab.eta);
    let positions = capture.rig.laser.hits_mm.len();
    (0..positions).into_par_iter().try_for_each(|position| {
        let hit = capture.rig.laser.hits_mm[position];
        let mut rng = Pcg32::new(params.seed, position as u64);
        let mut light: Vec<_> = footprints.iter().map(|f| vec![[0.0f64; 3]; f.area.len()]).collect();
        expose(medium, &slab, &averages, (hit, capture.rig.laser.origin_mm), params, &mut rng, |exit| {
            for (camera, light) in footprints.iter().zip(&mut light) {
                camera.splat(&exit, light);
            }
        });
        for (view, light) in light.iter().enumerate() {
            for channel in 0..CHANNELS.len() {
                let gain = 1.0 + params.drift * rng.next_normal();
                let radiance = light.iter().zip(&footprints[view].radiance).map(|(m, f)| gain * m[channel] * f);
                let frame: Vec<f32> = radiance.map(|l| sensor.measure(l, &mut rng)).collect();
                capture.frames.write([view, position, channel], &frame)?;
            }
        }
        progress();
        Ok(())
    })?;
    // Below some photons in a pixel the random walk is noisier than the camera.
    let photon = footprints[0].radiance.iter().copied().fold(0.0, f64::max) / params.photons as f64;
    let floor = sensor.floor.max(GRAIN * photon);
    capture.rig.channels.iter_mut().for_each(|c| c.noise_floor = floor);
    Capture::create(path, capture.rig, capture.mesh)
}

/// Follows the photons of one laser position.
fn expose(
    medium: &Medium,
    slab: &Slab,
    averages: &Averages,
    (hit, origin): ([f64; 3], [f64; 3]),
    params: &CaptureParams,
    rng: &mut Pcg32,
    mut record: impl FnMut(Exit),
) {
    let shift = [0, 1].map(|_| params.peak_shift_mm * rng.next_normal());
    let direction = normalize(sub(hit, origin)).map(|x| x as f32);
    let sigma = params.beam_diameter_mm / 4.0; // 1/e² at two standard deviations
    let share = 1.0 / params.photons as f64;
    for _ in 0..params.photons {
        let start = [0, 1].map(|i| hit[i] + shift[i] + sigma * rng.next_normal());
        photon(medium, slab, averages, (start, Vec3::from_array(direction)), rng, &mut |mut exit| {
            exit.weight = exit.weight.map(|w| w * share);
            record(exit);
        });
    }
}

/// What the pixels of a camera see of the plane z = 0.
struct Footprints {
    camera: Camera,
    /// mm² of each pixel.
    area: Vec<f64>,
    /// Radiance per radiosity towards the camera, over the area, of each pixel.
    radiance: Vec<f64>,
}

impl Footprints {
    fn new(camera: &Camera, slab: &Slab) -> Self {
        let (mut area, mut radiance) = (Vec::new(), Vec::new());
        let outside = Averages::new(slab.eta).transmitted_outside();
        for row in 0..camera.height {
            for column in 0..camera.width {
                let corner = |dx: f64, dy: f64| camera.on_plane([column as f64 + dx, row as f64 + dy], 0.0);
                let corners = [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)];
                let corners: Option<Vec<_>> = corners.into_iter().collect();
                // The shoelace formula; a pixel above the horizon sees nothing.
                let size = corners.map_or(0.0, |c| {
                    let twice: f64 = (0..4).map(|i| c[i][0] * c[(i + 1) % 4][1] - c[i][1] * c[(i + 1) % 4][0]).sum();
                    0.5 * twice.abs()
                });
                let toward = transmittance(camera, [column as f64 + 0.5, row as f64 + 0.5], slab.eta);
                let lobe = if slab.rough { 1.0 } else { toward / outside };
                area.push(size);
                radiance.push(if size > 0.0 { lobe / (PI * size) } else { 0.0 });
            }
        }
        Self { camera: camera.clone(), area, radiance }
    }

    fn splat(&self, exit: &Exit, light: &mut [[f64; 3]]) {
        let Some(px) = self.camera.project([exit.at[0], exit.at[1], 0.0]).filter(|_| exit.top) else { return };
        let (w, h) = (self.camera.width as f64, self.camera.height as f64);
        if (0.0..w).contains(&px[0]) && (0.0..h).contains(&px[1]) {
            let pixel = &mut light[px[1] as usize * self.camera.width + px[0] as usize];
            pixel.iter_mut().zip(exit.weight).for_each(|(p, w)| *p += w);
        }
    }
}

/// Fresnel transmittance of the horizontal surface seen at a place of the frame.
pub(crate) fn transmittance(camera: &Camera, px: [f64; 2], eta: f64) -> f64 {
    let cos = -camera.direction(px)[2];
    f64::from(1.0 - fresnel::dielectric(cos as f32, eta as f32).reflectance)
}

/// The camera's response: linear, with noise that grows with the signal, and a floor.
struct Sensor {
    floor: f64,
    pixel_noise: f64,
    most: f64,
}

impl Sensor {
    /// Exposed for the brightest of a few pilot frames.
    fn of(footprints: &[Footprints], medium: &Medium, slab: &Slab, params: &CaptureParams) -> Self {
        let pilot = CaptureParams { photons: 20_000, ..params.clone() };
        let averages = Averages::new(slab.eta);
        let mut most = 0.0f64;
        for (i, hit) in hits(params).into_iter().step_by((params.spots * params.spots).div_ceil(8)).enumerate() {
            let mut rng = Pcg32::new(params.seed, (u64::MAX >> 3) + i as u64);
            let mut light = vec![[0.0; 3]; footprints[0].area.len()];
            let laser = (hit, [0.0, 0.0, LASER_HEIGHT]);
            expose(medium, slab, &averages, laser, &pilot, &mut rng, |exit| footprints[0].splat(&exit, &mut light));
            let brightest = |(m, f): (&[f64; 3], &f64)| m.iter().copied().fold(0.0, f64::max) * f;
            most = light.iter().zip(&footprints[0].radiance).map(brightest).fold(most, f64::max);
        }
        // Room for brighter positions than the pilots.
        let most = 2.0 * most;
        let floor = most * 10f64.powf(-params.dynamic_range_db / 20.0);
        Self { floor, pixel_noise: if floor > 0.0 { params.pixel_noise } else { 0.0 }, most }
    }

    fn measure(&self, radiance: f64, rng: &mut Pcg32) -> f32 {
        let noise = (self.pixel_noise * radiance).hypot(self.floor) * rng.next_normal();
        (radiance + noise).min(self.most) as f32
    }
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
    let channel = |(name, wavelength_nm): (&str, f64)| Channel {
        name: name.into(),
        wavelength_nm,
        white_balance: 1.0,
        noise_floor: 0.0,
    };
    Rig {
        format: "translume capture".into(),
        version: RIG_VERSION.into(),
        units: "mm".into(),
        frames: "frames".into(),
        mesh: "mesh.ply".into(),
        eta: params.eta,
        channels: CHANNELS.into_iter().map(channel).collect(),
        views: (0..params.views).map(view).collect(),
        laser: Laser {
            origin_mm: [0.0, 0.0, LASER_HEIGHT],
            beam_diameter_mm: params.beam_diameter_mm,
            power: vec![1.0; 3],
            grid: [params.spots; 2],
            hits_mm: hits(params),
        },
        provenance: serde_json::json!({ "simulated": label, "parameters": params }),
    }
}

/// Cosine of incidence of the laser at a hit on the horizontal plane.
pub(crate) fn incidence(origin: [f64; 3], hit: [f64; 3]) -> f64 {
    let d = sub(origin, hit);
    dot(d, [0.0, 0.0, 1.0]) / norm(d)
}
