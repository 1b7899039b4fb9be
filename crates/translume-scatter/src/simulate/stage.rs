//! From light that leaves a body to the frames of a capture: exposure of all laser positions, and the camera's noise.

use super::walk::{Body, Exit, Importance, Interface, World};
use super::{CHANNELS, CaptureParams, Medium};
use crate::capture::{Capture, Laser, norm, normalize, sub};
use glam::Vec3;
use rayon::prelude::*;
use std::f64::consts::TAU;
use translume_core::frame::Frame;
use translume_core::rng::Pcg32;
use translume_image::Result;

/// A body in front of cameras.
pub(super) trait Stage: Sync {
    type Body: Body;

    fn body(&self) -> &Self::Body;

    /// Number of places that count light.
    fn bins(&self) -> usize;

    /// Counts an exit.
    fn record(&self, exit: &Exit, light: &mut [[f64; 3]]);

    /// Radiance of the pixels of a view, from what was counted.
    fn frame(&self, view: usize, light: &[[f64; 3]]) -> Vec<[f64; 3]>;

    /// Number of views.
    fn views(&self) -> usize;

    /// Whether a view has frames of a laser position.
    fn sees(&self, view: usize, position: usize) -> bool;
}

/// Most photons of a pilot run for the exposure and the importance.
const PILOT: usize = 1500;
/// Distance from the beam up to which light counts, in widths of the frame.
const REACH: f64 = 0.6;
/// Relative noise of the random walk above which a pixel counts as lost in it.
const GRAIN: f64 = 0.3;
/// The default of `scatter fit --threshold`: samples are four times brighter than the floor.
const THRESHOLD: f64 = 4.0;

/// Writes the frames of all laser positions and sets the channels' noise floors.
pub(super) fn expose<S: Stage>(
    stage: &S,
    (medium, interface): (&Medium, &Interface),
    params: &CaptureParams,
    capture: &mut Capture,
    progress: impl Fn() + Sync,
) -> Result<()> {
    let laser = &capture.rig.laser;
    let pilot = Pilot::run(stage, (medium, interface), params, laser);
    let world = World { body: stage.body(), medium, interface, importance: &pilot.importance };
    let sensor = Sensor::new(pilot.brightest, params);
    let frames = &capture.frames;
    let views = capture.rig.views.len();
    let one = |position: usize| -> Result<Grain> {
        let mut rng = Pcg32::new(params.seed, position as u64);
        let halves = lit(stage, &world, laser, position, params, &mut rng);
        let mut seen = Grain::new();
        for view in (0..views).filter(|&v| stage.sees(v, position)) {
            let pair = halves.each_ref().map(|light| stage.frame(view, light));
            for channel in 0..CHANNELS.len() {
                let gain = 1.0 + params.drift * rng.next_normal();
                let measure = |(a, b): (&[f64; 3], &[f64; 3])| {
                    seen.add(channel, sensor.most, a[channel], b[channel]);
                    sensor.measure(gain * (a[channel] + b[channel]), &mut rng)
                };
                let frame: Vec<f32> = pair[0].iter().zip(&pair[1]).map(measure).collect();
                frames.write([view, position, channel], &frame)?;
            }
        }
        progress();
        Ok(seen)
    };
    let seen: Vec<Grain> = (0..laser.hits_mm.len()).into_par_iter().map(one).collect::<Result<_>>()?;
    let mut grain = Grain::new();
    seen.iter().for_each(|s| grain.join(s));
    for (i, channel) in capture.rig.channels.iter_mut().enumerate() {
        channel.noise_floor = sensor.floor.max(grain.level(i, sensor.most) / THRESHOLD);
    }
    Ok(())
}

/// The light of one laser position, counted by even and by odd photons apart.
fn lit<S: Stage>(
    stage: &S,
    world: &World<'_, S::Body>,
    laser: &Laser,
    position: usize,
    params: &CaptureParams,
    rng: &mut Pcg32,
) -> [Vec<[f64; 3]>; 2] {
    let mut light = [0, 1].map(|_| vec![[0.0; 3]; stage.bins()]);
    let beam = Beam::new(laser, position, params, rng);
    let share = 1.0 / params.photons as f64;
    for i in 0..params.photons {
        let (origin, direction) = beam.ray(rng);
        world.shine(origin, direction, rng, &mut |mut exit| {
            exit.weight = exit.weight.map(|w| w * share);
            stage.record(&exit, &mut light[i % 2]);
        });
    }
    light
}

/// A Gaussian beam; its rays are parallel.
struct Beam {
    origin: Vec3,
    direction: Vec3,
    frame: Frame,
    shift: [f64; 2],
    sigma: f64,
}

impl Beam {
    /// Rays start this far before the hit: precise enough in single precision, and outside of any body.
    fn new(laser: &Laser, position: usize, params: &CaptureParams, rng: &mut Pcg32) -> Self {
        let (hit, origin) = (laser.hits_mm[position], laser.origin(position));
        let direction = Vec3::from_array(normalize(sub(hit, origin)).map(|x| x as f32));
        Self {
            origin: Vec3::from_array(origin.map(|x| x as f32)),
            direction: direction * norm(sub(hit, origin)) as f32,
            frame: Frame::from_normal(direction),
            shift: [0, 1].map(|_| params.peak_shift_mm * rng.next_normal()),
            sigma: params.beam_diameter_mm / 4.0, // 1/e² at two standard deviations
        }
    }

    fn ray(&self, rng: &mut Pcg32) -> ([f64; 3], Vec3) {
        let [x, y] = self.shift.map(|s| (s + self.sigma * rng.next_normal()) as f32);
        let origin = self.origin + self.frame.to_world(Vec3::new(x, y, 0.0));
        (origin.as_dvec3().to_array(), self.direction.normalize())
    }
}

/// What a few photons tell about brightness and reach.
struct Pilot {
    importance: Importance,
    brightest: f64,
}

/// The first guess falls off so fast, per mm, in a medium of a mean extinction of 1 per mm or more.
const STEEP: f64 = 0.35;
/// Rings of the pilot's profile, 1 mm wide.
const RINGS: usize = 64;

impl Pilot {
    fn run<S: Stage>(
        stage: &S,
        (medium, interface): (&Medium, &Interface),
        params: &CaptureParams,
        laser: &Laser,
    ) -> Self {
        // A first guess of the fall-off, so that the outer rings are reached; where light goes far anyway it is not made to.
        let rate = STEEP * medium.mean_extinction().min(1.0);
        let guess = (0..4 * RINGS).map(|i| (-rate * i as f64 * Importance::STEP_MM).exp().max(1e-5)).collect();
        let importance = Importance::new(guess);
        let world = World { body: stage.body(), medium, interface, importance: &importance };
        let few = CaptureParams { photons: PILOT.min(params.photons), ..params.clone() };
        let step = laser.hits_mm.len().div_ceil(8);
        let positions: Vec<usize> = (0..laser.hits_mm.len()).step_by(step).collect();
        let one = |&position: &usize| {
            let mut rng = Pcg32::new(params.seed, (u64::MAX >> 3) + position as u64);
            let mut rings = vec![[0.0f64; 2]; RINGS];
            let mut light = vec![[0.0; 3]; stage.bins()];
            let hit = laser.hits_mm[position];
            let beam = Beam::new(laser, position, &few, &mut rng);
            for _ in 0..few.photons {
                let (origin, direction) = beam.ray(&mut rng);
                world.shine(origin, direction, &mut rng, &mut |mut exit| {
                    exit.weight = exit.weight.map(|w| w / few.photons as f64);
                    if let Some(ring) = rings.get_mut(norm(sub(exit.wall.at, hit)) as usize) {
                        ring[0] += exit.weight.iter().copied().fold(0.0, f64::max);
                        ring[1] += 1.0;
                    }
                    stage.record(&exit, &mut light);
                });
            }
            let views = (0..stage.views()).filter(|&v| stage.sees(v, position));
            let brightest = views.flat_map(|v| stage.frame(v, &light)).flatten().fold(0.0, f64::max);
            (rings, brightest)
        };
        let told: Vec<_> = positions.par_iter().map(one).collect();
        let sum = |i: usize, k: usize| told.iter().map(|t| t.0[i][k]).sum::<f64>();
        let profile: Vec<[f64; 2]> = (0..RINGS).map(|i| [sum(i, 0) / (TAU * (i as f64 + 0.5)), sum(i, 1)]).collect();
        Self {
            importance: Importance::new(wanted(&profile, REACH * params.field_mm, params.evenness)),
            // Room for brighter positions than the pilots.
            brightest: 2.0 * told.iter().map(|t| t.1).fold(0.0, f64::max),
        }
    }
}

/// Weights in proportion to the light that leaves in rings of 1 mm (its density, and the exits counted), so that all rings are
/// reached by as many photons for their area; beyond `reach` fewer. An `evenness` below 1 spends less on faint rings.
fn wanted(profile: &[[f64; 2]], reach: f64, evenness: f64) -> Vec<f64> {
    let first = profile[0][0].max(1e-30);
    let mut ln: Vec<f64> = vec![0.0];
    for ring in &profile[1..] {
        let last = *ln.last().expect("not empty");
        let before = ln[ln.len().saturating_sub(4)];
        // Where nothing was counted, on as it went.
        let on = last + (last - before) / (ln.len() - ln.len().saturating_sub(4)).max(1) as f64;
        ln.push(if ring[1] >= 20.0 && ring[0] > 0.0 { (ring[0] / first).ln().min(last) } else { on });
    }
    let table = |i: usize| {
        let r = i as f64 * Importance::STEP_MM;
        // Rings stand for their centres; the beam's own is flat.
        let at = (r - 0.5).clamp(0.0, (ln.len() - 2) as f64);
        let (k, t) = (at as usize, at.fract());
        let value = (evenness * (ln[k] * (1.0 - t) + ln[k + 1] * t)).exp().clamp(1e-9, 1.0);
        // Outside of all frames the less: through an almost empty slab light runs for ever.
        let outside = (r / (1.5 * reach)).max(1.0).powi(4);
        if r > reach { (30.0 * value * outside).min(1.0) } else { value }
    };
    (0..profile.len() * 4).map(table).collect()
}

/// Octaves of brightness that [`Grain`] tells apart, and classes of noise in each.
const LEVELS: usize = 40;
const CLASSES: usize = 50;

/// Relative noise of the random walk by brightness, from the two halves of its photons. The median tells it: at silhouettes
/// some pixels see little of the object, and are no samples anyway.
struct Grain {
    /// Per channel, octave below the brightest and |a − b|/(a + b): the number of pixels.
    counts: Vec<[[u32; CLASSES]; LEVELS]>,
}

impl Grain {
    fn new() -> Self {
        Self { counts: vec![[[0; CLASSES]; LEVELS]; CHANNELS.len()] }
    }

    fn add(&mut self, channel: usize, most: f64, a: f64, b: f64) {
        let sum = a + b;
        if sum > 0.0 {
            let octave = ((most / sum).log2().max(0.0) as usize).min(LEVELS - 1);
            let class = ((a - b).abs() / sum * CLASSES as f64) as usize;
            self.counts[channel][octave][class.min(CLASSES - 1)] += 1;
        }
    }

    fn join(&mut self, other: &Self) {
        let theirs = other.counts.iter().flatten().flatten();
        self.counts.iter_mut().flatten().flatten().zip(theirs).for_each(|(a, b)| *a += b);
    }

    /// The brightness below which pixels are lost in the noise of the walk.
    fn level(&self, channel: usize, most: f64) -> f64 {
        // The median deviation of a normal distribution is 0.6745 standard deviations.
        let good = (0.6745 * GRAIN * CLASSES as f64) as usize;
        let noisy = |classes: &[u32; CLASSES]| {
            let all: u32 = classes.iter().sum();
            let below: u32 = classes[..good].iter().sum();
            all >= 8 && 2 * below < all
        };
        match self.counts[channel].iter().position(noisy) {
            Some(octave) => most * (-(octave as f64)).exp2(),
            None => 0.0,
        }
    }
}

/// The camera's response: linear, with noise that grows with the signal, and a floor.
struct Sensor {
    floor: f64,
    pixel_noise: f64,
    most: f64,
}

impl Sensor {
    fn new(most: f64, params: &CaptureParams) -> Self {
        let floor = most * 10f64.powf(-params.dynamic_range_db / 20.0);
        Self { floor, pixel_noise: if floor > 0.0 { params.pixel_noise } else { 0.0 }, most }
    }

    fn measure(&self, radiance: f64, rng: &mut Pcg32) -> f32 {
        let noise = (self.pixel_noise * radiance).hypot(self.floor) * rng.next_normal();
        (radiance + noise).min(self.most) as f32
    }
}
