//! The driver: tiles in parallel, pass after pass, until there are enough samples, the time is up, or someone says stop.

use crate::camera::Camera;
use crate::film::{Aov, Features, Film, Tile};
use crate::filter::FilterSampler;
use crate::integrator::{self, Integrator, View, Work};
use crate::splat::{Shared, Splats, Splatter};
use crate::subpath::Density;
use crate::tally::Tally;
use crate::{PathSampler, Result, Rgb, World};
use glam::Vec2;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use translume_core::sampler::Sampler;
use translume_scene::sensor::{Crop, Sensor};
use translume_trace::Ray;

/// A picture to take.
pub struct Shot<'a> {
    /// Of what.
    pub world: &'a World,
    /// How.
    pub integrator: &'a dyn Integrator,
    /// Of the random numbers.
    pub seed: u64,
    /// Number of the view, where one method takes several of a scene.
    pub view: u32,
    camera: Camera,
    filter: FilterSampler,
    /// Upper left pixel of the part that is rendered, and the whole film's size.
    window: ([u32; 2], [u32; 2]),
    tally: Mutex<Tally>,
}

/// When to stop.
#[derive(Clone, Copy, Debug)]
pub struct Until {
    /// Samples per pixel.
    pub samples: u64,
    /// Time from now; every pixel gets one sample in any case.
    pub time: Option<Duration>,
}

/// How it goes.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Samples per pixel so far, the fewest of any pixel.
    pub samples: u64,
    /// Samples per pixel of this run, on average.
    pub new_samples: f64,
    /// Rays traced by this run.
    pub rays: u64,
    /// Time spent by this run.
    pub elapsed: Duration,
    /// Fraction done, by samples or time.
    pub fraction: f64,
}

/// Shares of pixels that a tile keeps before it hands them on.
const MOST_SHARES: usize = 1 << 16;

/// One sample of each pixel of a tile. It counts as a whole or not at all, so that an interruption ends it anywhere.
#[derive(Default)]
struct Pass {
    values: Vec<Rgb>,
    features: Vec<Option<Features>>,
    shares: Vec<(u32, Rgb)>,
    broken: u64,
}

/// The longest that a pass may take before someone is told how it goes.
const PASS: Duration = Duration::from_millis(700);

impl<'a> Shot<'a> {
    /// `size` replaces the film's own size; its crop window is scaled along.
    pub fn new(
        world: &'a World,
        integrator: &'a dyn Integrator,
        sensor: &Sensor,
        size: Option<[u32; 2]>,
        seed: u64,
    ) -> Self {
        let full = size.unwrap_or(sensor.film.size);
        let whole = Crop { offset: [0, 0], size: full };
        let window = sensor.film.crop.map_or(whole, |c| scaled(c, sensor.film.size, full));
        Self {
            world,
            integrator,
            seed,
            view: 0,
            camera: Camera::new(sensor, full),
            filter: FilterSampler::new(&sensor.film.filter),
            window: (window.offset, window.size),
            tally: Mutex::default(),
        }
    }

    /// What the method counted so far, see [`Integrator::part`].
    pub fn tally(&self) -> Tally {
        self.tally.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// An empty film for this picture.
    ///
    /// # Errors
    /// As [`Film::new`].
    pub fn film(&self, aovs: &[Aov]) -> Result<Film> {
        let film = Film::new(self.size(), aovs)?;
        Ok(if self.integrator.splats() { film.with_splats(self.world.lights().typical()) } else { film })
    }

    /// Width and height of the picture.
    pub fn size(&self) -> [u32; 2] {
        self.window.1
    }

    /// Adds samples to `film`, one of [`Shot::film`], until `until` is reached or `stop` is set, which ends it wherever it is: what is
    /// not a whole sample of a tile is dropped. `tell` hears how it goes, about once a second.
    pub fn render(
        &self,
        film: &mut Film,
        until: &Until,
        stop: &AtomicBool,
        tell: &mut dyn FnMut(&Film, &Progress),
    ) -> Progress {
        let start = Instant::now();
        let rays = AtomicU64::new(0);
        let deadline = until.time.map(|t| start + t);
        let late = || deadline.is_some_and(|d| Instant::now() >= d);
        let (first, before) = (film.samples().0, film.mean_samples());
        let mut chunk = 1;
        self.integrator.prepare(self.world, self.seed, stop);
        loop {
            let done = film.samples().0;
            let elapsed = start.elapsed();
            let by_samples = (done - first) as f64 / (until.samples.saturating_sub(first)).max(1) as f64;
            let by_time = until.time.map_or(0.0, |t| elapsed.as_secs_f64() / t.as_secs_f64().max(1e-9));
            let progress = Progress {
                samples: done,
                new_samples: film.mean_samples() - before,
                rays: rays.load(Ordering::Relaxed),
                elapsed,
                fraction: by_samples.max(by_time).min(1.0),
            };
            if done > first {
                tell(film, &progress);
            }
            let stopped = stop.load(Ordering::Relaxed);
            if done >= until.samples || stopped || (done > 0 && late()) {
                return progress;
            }
            if let Some(n) = self.integrator.pass(self, film, stop, &late) {
                rays.fetch_add(n, Ordering::Relaxed);
                continue;
            }
            let goal = (done + chunk).min(until.samples);
            let began = Instant::now();
            let aovs = film.aovs().to_vec();
            let features = integrator::wants_features(film);
            let splats = film.splats.as_mut().map(Splats::shared);
            film.tiles.par_iter_mut().filter(|t| t.samples < goal).for_each(|tile| {
                while tile.samples < goal && !stop.load(Ordering::Relaxed) && (tile.samples == 0 || !late()) {
                    let n = if deadline.is_some() { 1 } else { goal - tile.samples };
                    rays.fetch_add(
                        self.sample_tile(tile, &aovs, features, n, splats.as_ref(), stop),
                        Ordering::Relaxed,
                    );
                }
            });
            let took = began.elapsed().as_secs_f64().max(1e-6);
            let wanted = (chunk as f64 * PASS.as_secs_f64() / took) as u64;
            chunk = wanted.clamp(1, 4 * chunk);
        }
    }

    /// The density of what the camera's ray meets.
    pub(crate) fn camera_density(&self, ray: &Ray) -> Density {
        self.camera.arrival(ray)
    }

    /// Adds what sample `sample` of each pixel of `tile` meets first to the feature images.
    pub(crate) fn add_features(&self, tile: &mut Tile, aovs: &[Aov], sample: u64) {
        if aovs.iter().all(|a| *a == Aov::Variance) {
            return;
        }
        for i in 0..tile.sums.len() {
            let (_, ray, _) = self.camera_path(tile, i, sample);
            if let Some(f) = integrator::features(self.world, &ray) {
                tile.add_features(aovs, i, &f);
            }
        }
    }

    /// The camera path of sample `sample` of pixel `i` of `tile`: its random numbers, its first ray and the filter's weight.
    pub(crate) fn camera_path(&self, tile: &Tile, i: usize, sample: u64) -> (PathSampler, Ray, f32) {
        self.camera_path_at(tile.pixel(i), sample)
    }

    /// The same of a pixel of the picture.
    pub(crate) fn camera_path_at(&self, pixel: [u32; 2], sample: u64) -> (PathSampler, Ray, f32) {
        self.camera_path_by(self.seed, pixel, sample)
    }

    /// Rays through pixel `i` of `tile` that have nothing to do with its camera paths: number `number`, with the filter's weight.
    pub(crate) fn camera_ray_beside(&self, tile: &Tile, i: usize, number: u64) -> (Ray, f32) {
        let (_, ray, weight) = self.camera_path_by(self.seed ^ 0x6265_7369, tile.pixel(i), number);
        (ray, weight)
    }

    fn camera_path_by(&self, seed: u64, pixel: [u32; 2], sample: u64) -> (PathSampler, Ray, f32) {
        let (offset, _) = self.window;
        let (x, y) = (pixel[0] + offset[0], pixel[1] + offset[1]);
        // The stream is the place on the film, so that a crop has the pixels of the whole.
        let mut sampler = PathSampler::new(seed, u64::from(y) << 32 | u64::from(x), sample);
        let (shift, weight) = self.filter.sample(sampler.next_2d());
        let film = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) + shift;
        let ray = self.camera.ray(film, sampler.next_2d());
        (sampler, ray, weight)
    }

    /// Gives each pixel of the tile `n` more samples, fewer if `stop` is set; returns the rays.
    fn sample_tile(
        &self,
        tile: &mut Tile,
        aovs: &[Aov],
        features: bool,
        n: u64,
        splats: Option<&Shared>,
        stop: &AtomicBool,
    ) -> u64 {
        let (_, [w, h]) = self.window;
        let view = View { camera: &self.camera, margin: self.filter.margin(), pixels: w as f32 * h as f32 };
        let sampler = PathSampler::new(self.seed, 0, 0);
        let mut work = Work { sampler, rays: 0, view, splats: Vec::new(), tally: Tally::default(), stop };
        let (mut pass, mut shares) = (Pass::default(), Vec::new());
        for sample in tile.samples..tile.samples + n {
            if !self.sample_pass(tile, features, sample, splats.is_some(), &mut work, &mut pass) {
                break;
            }
            for (i, value) in pass.values.drain(..).enumerate() {
                tile.add(i, value);
            }
            for (i, f) in pass.features.drain(..).enumerate().filter_map(|(i, f)| Some((i, f?))) {
                tile.add_features(aovs, i, &f);
            }
            tile.broken += pass.broken;
            tile.samples += 1;
            shares.append(&mut pass.shares);
            if let Some(splats) = splats.filter(|_| shares.len() >= MOST_SHARES) {
                splats.add(&mut shares);
            }
        }
        if let Some(splats) = splats {
            splats.add(&mut shares);
        }
        self.tally.lock().unwrap_or_else(PoisonError::into_inner).add_all(&work.tally);
        work.rays
    }

    /// Sample number `sample` of each pixel of `tile`; whether it is whole.
    fn sample_pass(
        &self,
        tile: &Tile,
        features: bool,
        sample: u64,
        splats: bool,
        work: &mut Work,
        pass: &mut Pass,
    ) -> bool {
        let splatter = Splatter { filter: &self.filter, window: self.window };
        pass.broken = 0;
        for i in 0..tile.sums.len() {
            let (sampler, ray, weight) = self.camera_path(tile, i, sample);
            work.sampler = sampler;
            if features {
                pass.features.push(integrator::features(self.world, &ray));
            }
            pass.values.push(self.integrator.radiance(self.world, &ray, work) * weight);
            if splats {
                pass.broken += splatter.spread(&mut work.splats, &mut pass.shares);
            }
            if work.stopped() {
                return false;
            }
        }
        true
    }
}

/// A crop window of a film of size `from`, for one of size `to`.
fn scaled(crop: Crop, from: [u32; 2], to: [u32; 2]) -> Crop {
    let scale = |v: u32, a: usize| (f64::from(v) * f64::from(to[a]) / f64::from(from[a])).round() as u32;
    let offset = [scale(crop.offset[0], 0).min(to[0] - 1), scale(crop.offset[1], 1).min(to[1] - 1)];
    let size = [0, 1].map(|a| scale(crop.size[a], a).clamp(1, to[a] - offset[a]));
    Crop { offset, size }
}
