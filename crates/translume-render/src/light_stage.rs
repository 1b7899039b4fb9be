//! A virtual light stage: one view of a scene under each of many lamps that are far away, one lamp at a time.
//!
//! Source: Debevec et al. 2000 for the instrument; the estimator is that of `integrator/path.rs` (emitter sampling and BSDF
//! sampling, power heuristic). A path from the camera does not know the lamps, so all lamps share one set of paths: each
//! vertex sends a shadow ray to every lamp. That costs some shadow rays a lamp and none of the rest. Consequences:
//!
//! - The noise of one lamp's picture is that of `path`; between lamps it is correlated (the same paths, and the same place
//!   on every lamp's disc), so a sum over lamps is a little noisier than a render under all of them at once.
//! - A picture does not depend on which other lamps are rendered along: a part of the lamps gives the same bits.
//!
//! A lamp is a disc on the sky of constant radiance. The camera does not see lamps, mirrors and glass do. Media are ignored, as
//! by `path`.

use crate::integrator::{Settings, power_heuristic};
use crate::render::Shot;
use crate::subpath::MOST_SEGMENTS;
use crate::world::MOST_CROSSINGS;
use crate::{Error, PathSampler, Result, Rgb, World};
use glam::{DMat3, Vec3};
use rayon::prelude::*;
use std::f32::consts::{PI, TAU};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use translume_bxdf::{Flags, Mode};
use translume_core::frame::Frame;
use translume_core::sampler::Sampler;
use translume_scene::Scene;
use translume_scene::sensor::Sensor;
use translume_trace::Ray;

/// `scene` with its own lights put out: emitters are gone, shapes that shone stay and are dark. And how many there were.
pub fn unlit(scene: &Scene) -> (Scene, usize) {
    let mut dark = scene.clone();
    let shining = dark.shapes.iter_mut().filter_map(|s| s.radiance.take()).count();
    let put_out = shining + dark.emitters.len();
    dark.emitters.clear();
    (dark, put_out)
}

/// `n` directions to lamps, evenly spread (a Fibonacci lattice), x right, y up, z to the camera: over the sphere from the
/// camera to behind the object, or over the half of it that the camera is in.
pub fn spread(n: usize, hemisphere: bool) -> Vec<Vec3> {
    let height = if hemisphere { 1.0 } else { 2.0 };
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let direction = |i: usize| {
        let z = 1.0 - height * (i as f64 + 0.5) / n as f64;
        let (sin, cos) = (golden * i as f64).sin_cos();
        let s = (1.0 - z * z).sqrt();
        Vec3::new((s * cos) as f32, (s * sin) as f32, z as f32)
    };
    (0..n).map(direction).collect()
}

/// Directions as [`spread`] has them, in the world of `sensor`.
pub fn to_world(sensor: &Sensor, directions: &[Vec3]) -> Vec<Vec3> {
    // The camera looks along +z, and its +x is the left of the picture.
    let m = &sensor.world_from_camera.matrix3;
    let axes = DMat3::from_cols(-m.x_axis.normalize(), m.y_axis.normalize(), -m.z_axis.normalize());
    directions.iter().map(|d| (axes * d.as_dvec3()).normalize().as_vec3()).collect()
}

/// How to render.
#[derive(Clone, Copy, Debug)]
pub struct Params {
    /// Depth of paths. Lamps are hidden from the camera whatever it says.
    pub settings: Settings,
    /// Paths a pixel.
    pub samples: u64,
    /// The most that one path may bring of a lamp after its first scattering by something other than a smooth mirror or
    /// glass: single bright samples of caustics count less, and the picture is that much too dark. Infinite: nothing is lost.
    pub clamp: f32,
}

/// Lamps of one kind.
#[derive(Clone, Debug)]
pub struct Lamps {
    directions: Vec<Vec3>,
    frames: Vec<Frame>,
    /// 1 − cos of the disc's angular radius.
    depth: f32,
    radiance: f32,
    /// Per solid angle; 1 for lamps without extent.
    pdf_w: f32,
}

impl Lamps {
    /// Discs of angular radius `radius` (radians; 0: parallel light) at unit `directions` of the world, each of which
    /// gives a surface that faces it the irradiance `irradiance`.
    ///
    /// # Errors
    /// [`Error::Scene`] for a radius that is negative or more than a quarter of a turn.
    pub fn new(directions: Vec<Vec3>, radius: f32, irradiance: f32) -> Result<Self> {
        if !(0.0..=PI / 2.0).contains(&radius) {
            return Err(Error::Scene(format!(
                "a lamp of {}° across: from 0 to 180 are possible",
                radius.to_degrees() * 2.0
            )));
        }
        let frames = directions.iter().map(|d| Frame::from_normal(*d)).collect();
        // 1 − cos α = 2 sin²(α/2) keeps its digits where α is small; ∫ cos over the disc is π sin² α.
        let depth = 2.0 * (0.5 * radius).sin().powi(2);
        let (radiance, pdf_w) = match radius > 0.0 {
            true => (irradiance / (PI * radius.sin().powi(2)), 1.0 / (TAU * depth)),
            false => (irradiance, 1.0),
        };
        Ok(Self { directions, frames, depth, radiance, pdf_w })
    }

    /// How many.
    pub fn len(&self) -> usize {
        self.directions.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.directions.is_empty()
    }

    /// The point of the unit disc about +z that `u` draws.
    fn place(&self, u: glam::Vec2) -> Vec3 {
        let z = u.x * self.depth;
        let (sin, cos) = (TAU * u.y).sin_cos();
        let s = (z * (2.0 - z)).sqrt();
        Vec3::new(s * cos, s * sin, 1.0 - z)
    }

    /// Adds the light of the lamps that the direction `d` meets, drawn with density `pdf_w`.
    fn add_met(&self, d: Vec3, pdf_w: f32, throughput: Rgb, most: f32, sums: &mut [Rgb]) {
        let value = clamped(throughput * self.radiance * power_heuristic(pdf_w, self.pdf_w), most);
        for (sum, lamp) in sums.iter_mut().zip(&self.directions) {
            // |d − l|² = 2 (1 − cos)
            if (d - *lamp).length_squared() < 2.0 * self.depth {
                *sum += value;
            }
        }
    }
}

/// A colour made darker until none of its parts is above `most`.
fn clamped(value: Rgb, most: f32) -> Rgb {
    let peak = value.max_element();
    if peak > most { value * (most / peak) } else { value }
}

/// Pictures under each lamp.
pub struct Pictures {
    /// Width and height.
    pub size: [u32; 2],
    /// Samples that were not finite and count as black.
    pub broken: u64,
    /// Rays that were traced.
    pub rays: u64,
    lamps: usize,
    /// By row, lamp, column and channel.
    values: Vec<f32>,
}

impl Pictures {
    /// Linear RGB under lamp `i`, interleaved, rows from the top.
    pub fn picture(&self, i: usize) -> Vec<f32> {
        let row = 3 * self.size[0] as usize;
        self.values.chunks(row * self.lamps).flat_map(|r| &r[i * row..(i + 1) * row]).copied().collect()
    }
}

/// Renders `shot` under each of `lamps`; lights of the shot's world and its integrator have no part in it. `tell` is called once
/// a row. `None`: `stop` was set before the end.
///
/// # Errors
/// [`Error::Scene`] when there is no memory for so many pictures.
pub fn render(
    shot: &Shot,
    lamps: &Lamps,
    params: &Params,
    stop: &AtomicBool,
    tell: &(dyn Fn() + Sync),
) -> Result<Option<Pictures>> {
    let size = shot.size();
    let row = 3 * size[0] as usize * lamps.len();
    let mut values: Vec<f32> = Vec::new();
    let length = row * size[1] as usize;
    let too_large =
        |_| Error::Scene(format!("{} bytes of memory for {} pictures are refused", 4 * length, lamps.len()));
    values.try_reserve_exact(length).map_err(too_large)?;
    values.resize(length, 0.0);
    let (rays, broken) = (AtomicU64::new(0), AtomicU64::new(0));
    values.par_chunks_mut(row.max(1)).enumerate().for_each(|(y, out)| {
        let mut pixel = Pixel::new(lamps.len());
        for x in 0..size[0] as usize {
            if stop.load(Ordering::Relaxed) {
                return;
            }
            pixel.take(shot, lamps, params, [x as u32, y as u32]);
            for (i, sum) in pixel.sums.iter().enumerate() {
                let at = 3 * (i * size[0] as usize + x);
                (0..3).for_each(|c| out[at + c] = (sum[c] / params.samples.max(1) as f64) as f32);
            }
        }
        rays.fetch_add(pixel.rays, Ordering::Relaxed);
        broken.fetch_add(pixel.broken, Ordering::Relaxed);
        tell();
    });
    let whole = !stop.load(Ordering::Relaxed);
    let pictures = Pictures { size, broken: broken.into_inner(), rays: rays.into_inner(), lamps: lamps.len(), values };
    Ok(whole.then_some(pictures))
}

/// What a thread works with.
struct Pixel {
    /// By lamp: of one path, and of all of the pixel.
    path: Vec<Rgb>,
    sums: Vec<[f64; 3]>,
    rays: u64,
    broken: u64,
}

impl Pixel {
    fn new(lamps: usize) -> Self {
        Self { path: vec![Rgb::ZERO; lamps], sums: vec![[0.0; 3]; lamps], rays: 0, broken: 0 }
    }

    /// All samples of one pixel.
    fn take(&mut self, shot: &Shot, lamps: &Lamps, params: &Params, pixel: [u32; 2]) {
        self.sums.fill([0.0; 3]);
        for sample in 0..params.samples {
            self.path.fill(Rgb::ZERO);
            let (mut sampler, ray, weight) = shot.camera_path_at(pixel, sample);
            self.trace(shot.world, lamps, params, ray, &mut sampler);
            for (value, sum) in self.path.iter().zip(&mut self.sums) {
                if value.is_finite() {
                    (0..3).for_each(|c| sum[c] += f64::from(value[c] * weight));
                } else {
                    self.broken += 1;
                }
            }
        }
    }

    /// Follows one path; what it brings of each lamp is added to `self.path`.
    fn trace(&mut self, world: &World, lamps: &Lamps, params: &Params, mut ray: Ray, sampler: &mut PathSampler) {
        let settings = &params.settings;
        let max_depth = settings.max_depth.unwrap_or(MOST_SEGMENTS);
        let (mut throughput, mut eta) = (Rgb::ONE, 1.0);
        // Density of the direction under way, and the most that a lamp there may bring; `None` while the direction is the
        // camera's, which sees no lamps.
        let mut drawn: Option<(f32, f32)> = None;
        let mut most = f32::INFINITY;
        for depth in 0..max_depth {
            self.rays += 1;
            let Some(hit) = world.intersect(&ray) else {
                if let Some((pdf_w, most)) = drawn {
                    lamps.add_met(ray.d.normalize(), pdf_w, throughput, most, &mut self.path);
                }
                break;
            };
            if depth + 1 >= max_depth {
                break;
            }
            let shading = world.shading(&hit);
            let u = sampler.next_2d();
            if shading.flags().has_smooth() {
                let crossings = settings.max_depth.map_or(MOST_CROSSINGS, |m| (m - depth - 2).min(MOST_CROSSINGS));
                let place = lamps.place(u);
                for (frame, sum) in lamps.frames.iter().zip(&mut self.path) {
                    let wi = frame.to_world(place);
                    let (f_cos, pdf_bsdf) = shading.eval_cos_pdf(hit.wo, wi, Mode::Radiance);
                    if f_cos == Rgb::ZERO {
                        continue;
                    }
                    self.rays += 1;
                    let visible = world.transmittance(&hit.point.spawn(wi), crossings);
                    let weight = if lamps.depth > 0.0 { power_heuristic(lamps.pdf_w, pdf_bsdf) } else { 1.0 };
                    *sum += clamped(throughput * visible * f_cos * (lamps.radiance * weight / lamps.pdf_w), most);
                }
            }
            let (u_lobe, u) = (sampler.next_1d(), sampler.next_2d());
            let Some(sample) = shading.sample(hit.wo, u_lobe, u, Mode::Radiance) else { break };
            throughput *= sample.weight;
            eta *= sample.eta;
            if throughput.max_element() <= 0.0 {
                break;
            }
            ray = hit.point.spawn(sample.wi);
            if !sample.flags.contains(Flags::NULL) {
                let delta = sample.flags.contains(Flags::DELTA);
                drawn = Some((if delta { f32::INFINITY } else { sample.pdf_w }, most));
                most = if delta { most } else { params.clamp };
            }
            if !settings.goes_on(depth + 1, &mut throughput, eta, sampler) {
                break;
            }
        }
    }
}

impl World {
    /// Compiles `scene` for a light stage, which brings its own light: the scene may be dark.
    ///
    /// # Errors
    /// [`Error::TooLarge`].
    pub fn dark(scene: Arc<Scene>) -> Result<Self> {
        crate::world::compile(scene)
    }
}
