//! The generalized kernel method: light paths and camera paths that land near each other are linked, and a link asks from
//! where the light came instead of believing that it is the same here.
//!
//! Source: Bekaert, Slusallek, Cools, Havran, Seidel: A custom designed density estimator for light transport,
//! MPI-I-2003-4-004. One pass of the driver is one step (§5): light paths are traced once, then the picture's tiles block by
//! block: camera paths (`eye`), pairs of a camera vertex in a light vertex's footprint (`link`, `points`), trial
//! links, shadow rays in the order of light vertices (`link`). Steps are averaged; the samples of a pixel are its
//! camera paths, one a step or more.
//!
//! Nothing needs to be set: h is found by the number of footprints of direct light per camera vertex (M = 10), the number
//! of trial links by the share that a pilot found unoccluded, per tile for the first vertex and per depth beyond.
//!
//! Departures, all off with the option `printed`: R is at most 0.35 of the distance to the parent and h shrinks with the
//! steps, so that the picture converges; where a footprint is not flat the normalisation is estimated with rays; links are
//! chosen by the flux that they would bring, fewer of them beyond the first camera vertex; merges are weighed by their number (see `weight`).
//!
//! Limits: merging only where the parent scatters in more than single directions, so light that mirrors and glass focus is
//! found by camera paths that meet the light, as in `path`; no participating media.

mod eye;
mod light;
mod link;
mod points;
mod weight;

use super::{Integrator, Options, Settings};
use crate::film::{Film, Tile};
use crate::render::Shot;
use crate::subpath::{Limits, Vertex};
use crate::world::World;
use crate::{Result, Rgb};
use eye::{Eye, EyeVertex};
use light::{Bandwidth, LightPaths, LightVertex, Request};
use link::{Candidates, Linker};
use rayon::prelude::*;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use weight::Weighing;

/// See the module.
pub struct GKernel {
    settings: Settings,
    /// Light paths of a step; 0: half as many as pixels, at least [`FEWEST_PATHS`].
    light_paths: u32,
    /// Camera paths of a pixel in each step.
    eye_paths: u64,
    /// Links of camera vertices beyond the first, as a share of [`LINKS`].
    deeper_links: f32,
    /// The paper's method as it is printed.
    printed: bool,
    calibration: OnceLock<Calibration>,
    counts: Counts,
}

/// Unoccluded links that a camera vertex should get: the paper's M.
const LINKS: f32 = 10.0;

/// Most trial links of a camera vertex.
const MOST_TRIALS: f32 = 80.0;

/// Light paths of a step unless the user says otherwise.
const FEWEST_PATHS: u32 = 10_000;
const MOST_PATHS: u32 = 1_000_000;

/// h before it is calibrated.
const FIRST_H: f32 = 0.01;

/// Camera paths of a block.
const BLOCK: usize = 1 << 15;

/// Exponent of progressive photon mapping: h² falls as steps^(α − 1).
const ALPHA: f32 = 2.0 / 3.0;

/// Camera depths told apart.
const DEPTHS: usize = 8;

/// What a pilot found.
struct Calibration {
    h: [f32; 2],
    weighing: Weighing,
    /// Share of trial links that are unoccluded: of first vertices per tile, and per depth.
    first: Vec<f32>,
    deeper: [f32; DEPTHS],
}

/// What was done, for `--json`.
#[derive(Default)]
struct Counts {
    steps: AtomicU64,
    light_vertices: AtomicU64,
    eye_vertices: AtomicU64,
    candidates: AtomicU64,
    requested: AtomicU64,
    unoccluded: AtomicU64,
}

/// A part of the picture, with the camera's paths through it.
struct Block<'a> {
    eyes: Vec<EyeVertex<'a>>,
    /// Per camera path.
    radiance: Vec<Rgb>,
    rays: u64,
}

impl GKernel {
    /// With these settings and options.
    ///
    /// # Errors
    /// [`crate::Error::Mismatch`] for options that are none.
    pub fn new(settings: Settings, options: &Options) -> Result<Self> {
        let light_paths = options.number("light-paths", 0..=50_000_000)? as u32;
        let eye_paths = options.number("eye-paths", 1..=1 << 40)?;
        let printed = options.switch("printed")?;
        let deeper_links = if printed { 100 } else { options.number("deeper-links", 1..=100)? } as f32 / 100.0;
        Ok(Self {
            settings,
            light_paths,
            eye_paths,
            deeper_links,
            printed,
            calibration: OnceLock::new(),
            counts: Counts::default(),
        })
    }

    fn bandwidth(&self, world: &World, h: [f32; 2]) -> Bandwidth {
        match self.printed {
            true => Bandwidth { h, grow: true, share: f32::INFINITY, most: f32::INFINITY },
            false => Bandwidth { h, grow: false, share: 0.35, most: 0.1 * world.bounding_sphere().1 },
        }
    }

    fn light_paths(&self, shot: &Shot) -> u32 {
        let [w, h] = shot.size();
        if self.light_paths > 0 { self.light_paths } else { (w * h / 2).clamp(FEWEST_PATHS, MOST_PATHS) }
    }

    fn request<'a>(&self, shot: &Shot<'a>, step: u64, h: [f32; 2], weighing: Weighing) -> Request<'a> {
        Request {
            world: shot.world,
            limits: Limits {
                segments: self.settings.most_segments().saturating_sub(1),
                rr_depth: self.settings.rr_depth,
            },
            bandwidth: self.bandwidth(shot.world, h),
            weighing,
            seed: shot.seed,
            step,
            count: self.light_paths(shot),
            probe: !self.printed,
        }
    }

    /// Camera paths number `sample` of the pixels of `tile` that `wanted` says.
    fn eyes<'a>(
        &self,
        shot: &Shot<'a>,
        weighing: Weighing,
        tile: &Tile,
        sample: u64,
        wanted: impl Fn(usize) -> bool,
    ) -> Block<'a> {
        let limits = Limits { segments: self.settings.most_segments(), rr_depth: self.settings.rr_depth };
        let eye = Eye { world: shot.world, limits, hide_lights: self.settings.hide_emitters, weighing };
        let mut block = Block { eyes: Vec::new(), radiance: Vec::new(), rays: 0 };
        let mut buffer: Vec<Vertex> = Vec::new();
        for i in (0..tile.sums.len()).filter(|i| wanted(*i)) {
            let (mut sampler, ray, weight) = shot.camera_path(tile, i, sample);
            let path = block.radiance.len() as u32;
            let begin = (&ray, shot.camera_density(&ray), weight);
            let radiance = eye.trace(begin, path, &mut sampler, &mut block.rays, &mut buffer, &mut block.eyes);
            block.radiance.push(radiance);
        }
        block
    }

    /// Finds h, and how many links are occluded, with light paths of their own and some of the camera's.
    fn calibrate(&self, shot: &Shot, film: &Film) -> Calibration {
        const STEP: u64 = 1 << 40;
        let mut weighing = Weighing { scale: 1.0, printed: self.printed };
        let wanted = |i: usize| i % 16 == 5;
        let mut blocks: Vec<Block> =
            film.tiles.par_iter().map(|t| self.eyes(shot, weighing, t, STEP, wanted)).collect();
        let per_tile: Vec<usize> = blocks.iter().map(|b| b.eyes.len()).collect();
        let eyes: Vec<EyeVertex> = blocks.iter_mut().flat_map(|b| std::mem::take(&mut b.eyes)).collect();

        let tree = link::tree(&eyes);
        let mut request = self.request(shot, STEP, [FIRST_H; 2], weighing);
        request.probe = false;
        let mut lights = LightPaths::trace(&request);
        for _ in 0..8 {
            let [first, others] = link::count(&lights, &tree).map(|n| n as f32 / eyes.len().max(1) as f32);
            let counts = if self.printed { [first; 2] } else { [first, others] };
            if counts.iter().all(|c| (c / LINKS - 1.0).abs() < 0.1) {
                break;
            }
            let h = &mut request.bandwidth.h;
            h.iter_mut().zip(counts).for_each(|(h, c)| *h *= (LINKS / c.max(0.05 * LINKS)).sqrt());
            lights.refit(&request.bandwidth);
        }
        let h = request.bandwidth.h;
        // Light vertices per path that see a point: c of the weights.
        weighing.scale = std::f32::consts::PI * h[0] * h[0] * lights.count as f32;
        if self.printed {
            weighing.scale *= lights.typical_area();
        }

        let candidates = Candidates::find(&lights, &tree, eyes.len());
        let strength = |light: u32, eye: &EyeVertex| self.strength(&lights.vertices[light as usize], eye);
        let links = candidates.select(&eyes, (shot.seed, STEP), |_| 3.0 * LINKS, strength);
        let linker = self.linker(shot, &lights, request.bandwidth, weighing, STEP);
        let scores = linker.score(&links, &eyes);
        let mut tile_of = Vec::with_capacity(eyes.len());
        per_tile.iter().enumerate().for_each(|(t, n)| tile_of.extend(std::iter::repeat_n(t, *n)));
        // One link seen and one not for a start: what is not known is asked for moderately.
        let mut first = vec![(1.0_f32, 2.0_f32); per_tile.len()];
        let mut deeper = [(1.0_f32, 2.0_f32); DEPTHS];
        for (link, score) in links.iter().zip(&scores) {
            let eye = &eyes[link.eye as usize];
            let slot = match eye.depth {
                0 => &mut first[tile_of[link.eye as usize]],
                depth => &mut deeper[(depth as usize).min(DEPTHS - 1)],
            };
            slot.0 += f32::from(u8::from(score.visible));
            slot.1 += 1.0;
        }
        Calibration {
            h,
            weighing,
            first: first.iter().map(|(a, b)| a / b).collect(),
            deeper: deeper.map(|(a, b)| a / b),
        }
    }

    fn linker<'a>(
        &self,
        shot: &Shot<'a>,
        lights: &'a LightPaths,
        bandwidth: Bandwidth,
        weighing: Weighing,
        step: u64,
    ) -> Linker<'a> {
        Linker {
            world: shot.world,
            lights,
            bandwidth,
            weighing,
            max: self.settings.most_segments(),
            seed: (shot.seed, step),
        }
    }

    /// How likely a candidate becomes a trial link, relative to others of the same camera vertex.
    fn strength(&self, v: &LightVertex, eye: &EyeVertex) -> f32 {
        if self.printed {
            return 1.0 / (v.radius * v.radius * v.cos()); // eq. 10
        }
        LightPaths::strength(v) * (eye.hit.n().dot(v.hit.wo).abs() + 0.05)
    }

    /// h of a step.
    fn bandwidth_of(&self, calibration: &Calibration, step: u64) -> [f32; 2] {
        if self.printed {
            return calibration.h;
        }
        let shrink: f32 = (1..=step.min(100_000)).map(|i| (i as f32 + ALPHA) / (i as f32 + 1.0)).product();
        calibration.h.map(|h| h * shrink.sqrt())
    }

    /// One block of tiles: one camera path more for each pixel.
    fn block(
        &self,
        shot: &Shot,
        tiles: &mut [Tile],
        aovs: &[crate::film::Aov],
        (first_tile, sample): (usize, u64),
        linker: &Linker,
        calibration: &Calibration,
    ) -> u64 {
        let mut parts: Vec<Block> = tiles
            .par_iter_mut()
            .map(|t| {
                shot.add_features(t, aovs, sample);
                self.eyes(shot, linker.weighing, t, sample, |_| true)
            })
            .collect();
        let mut radiance = Vec::new();
        let mut eyes = Vec::new();
        let mut wanted = Vec::new();
        let mut rays = 0;
        for (t, part) in parts.iter_mut().enumerate() {
            let base = radiance.len() as u32;
            radiance.append(&mut part.radiance);
            for eye in part.eyes.drain(..) {
                let trials = match eye.depth {
                    0 => LINKS / calibration.first[first_tile + t],
                    depth => self.deeper_links * LINKS / calibration.deeper[(depth as usize).min(DEPTHS - 1)],
                };
                wanted.push(trials.min(MOST_TRIALS));
                eyes.push(EyeVertex { path: eye.path + base, ..eye });
            }
            rays += part.rays;
        }
        let candidates = Candidates::find(linker.lights, &link::tree(&eyes), eyes.len());
        let strength = |light: u32, eye: &EyeVertex| self.strength(&linker.lights.vertices[light as usize], eye);
        let links = candidates.select(&eyes, linker.seed, |i| wanted[i], strength);
        let scores = linker.score(&links, &eyes);
        let mut unoccluded = 0;
        for (link, score) in links.iter().zip(scores) {
            radiance[eyes[link.eye as usize].path as usize] += score.value;
            unoccluded += u64::from(score.visible);
            rays += score.rays;
        }
        let mut values = radiance.into_iter();
        for tile in tiles {
            for i in 0..tile.sums.len() {
                tile.add(i, values.next().unwrap_or(Rgb::ZERO));
            }
            tile.samples += 1;
        }
        let c = &self.counts;
        c.eye_vertices.fetch_add(eyes.len() as u64, Ordering::Relaxed);
        c.candidates.fetch_add(candidates.len() as u64, Ordering::Relaxed);
        c.requested.fetch_add(links.len() as u64, Ordering::Relaxed);
        c.unoccluded.fetch_add(unoccluded, Ordering::Relaxed);
        rays
    }
}

impl Integrator for GKernel {
    fn check(&self, world: &World) -> Result<()> {
        self.settings.without_media("gkernel", world)
    }

    /// A step, or the rest of one.
    fn pass(&self, shot: &Shot, film: &mut Film, stop: &AtomicBool, late: &dyn Fn() -> bool) -> Option<u64> {
        let calibration = self.calibration.get_or_init(|| self.calibrate(shot, film));
        let first = film.samples().0;
        let step = first / self.eye_paths;
        let h = self.bandwidth_of(calibration, step);
        let weighing = calibration.weighing;
        let request = self.request(shot, step, h, weighing);
        let lights = LightPaths::trace(&request);
        let mut rays = lights.rays;
        let aovs = film.aovs().to_vec();
        let whole = film.tiles.len();
        let tiles_at_once = (BLOCK / (crate::film::TILE * crate::film::TILE) as usize).max(1);
        let end = (step + 1) * self.eye_paths;
        'step: for sample in first..end {
            // Links are drawn anew for every camera path, as if it had a step of its own.
            let linker = self.linker(shot, &lights, request.bandwidth, weighing, sample);
            for first_tile in (0..whole).step_by(tiles_at_once) {
                if stop.load(Ordering::Relaxed) || (sample > 0 && late()) {
                    break 'step;
                }
                let tiles = &mut film.tiles[first_tile..(first_tile + tiles_at_once).min(whole)];
                // After an interruption some blocks are a sample ahead.
                if tiles.iter().all(|t| t.samples == sample) {
                    rays += self.block(shot, tiles, &aovs, (first_tile, sample), &linker, calibration);
                }
            }
        }
        self.counts.steps.fetch_add(1, Ordering::Relaxed);
        self.counts.light_vertices.fetch_add(lights.vertices.len() as u64, Ordering::Relaxed);
        Some(rays)
    }

    fn facts(&self) -> Vec<(&'static str, f64)> {
        let of = |c: &AtomicU64| c.load(Ordering::Relaxed) as f64;
        let c = &self.counts;
        let eyes = of(&c.eye_vertices).max(1.0);
        let requested = of(&c.requested);
        vec![
            ("h", self.calibration.get().map_or(0.0, |c| c.h[0].into())),
            ("steps", of(&c.steps)),
            ("light_vertices", of(&c.light_vertices)),
            ("bytes_per_light_vertex", size_of::<LightVertex>() as f64),
            ("eye_vertices", eyes),
            ("candidates_per_eye_vertex", of(&c.candidates) / eyes),
            ("requested_per_eye_vertex", requested / eyes),
            ("unoccluded_per_eye_vertex", of(&c.unoccluded) / eyes),
            ("mean_visibility", of(&c.unoccluded) / requested.max(1.0)),
        ]
    }
}
