//! What is found out before the first step, with light paths of their own and some of the camera's: h, how many links are
//! occluded, and at which lights light paths should begin.
//!
//! Source: Bekaert et al. 2003, §5 (h so that M footprints of direct light hold a camera vertex in the mean; the share of
//! unoccluded links). The lights' part is not in the paper: a lamp's chance follows what it brings to the picture, mixed
//! with its power so that none is forgotten.

use super::eye::EyeVertex;
use super::light::{Brief, LightPaths, Request};
use super::link::{self, Candidates};
use super::weight::Weighing;
use super::{Block, FEWEST_PATHS, GKernel, MOST_TRIALS};
use crate::film::Film;
use crate::light::Starts;
use crate::render::Shot;
use crate::world::{MOST_CROSSINGS, World};
use crate::{PathSampler, luminance};
use rayon::prelude::*;
use std::f32::consts::PI;
use translume_bxdf::Mode;
use translume_core::sampler::Sampler;

/// What a pilot found, for all views of a scene.
pub(crate) struct Pilot {
    pub(crate) h: [f32; 2],
    /// c of the weights.
    pub(crate) scale: f32,
    /// Of light samples at camera vertices: the mean of their squares over their variance. Weights that go by densities alone take these to
    /// be equal (Grittmann et al. 2019: variance-aware multiple importance sampling).
    pub(crate) steadiness: f32,
    /// Where light paths begin.
    pub(crate) starts: Starts,
}

/// Share of trial links that are unoccluded in a view: per tile, and of vertices that choose alone, beyond the first, per depth.
pub(crate) struct Outlook {
    /// [`Shot::view`].
    pub(crate) view: u32,
    tiles: Vec<f32>,
    depths: [f32; DEPTHS],
}

/// Views that the pilot looks at, at most.
const VIEWS: usize = 8;

/// The pilot's step.
const STEP: u64 = 1 << 30;

/// Every so many pixels send one of the pilot's camera paths.
const SPARSE: usize = 16;

/// Camera depths told apart.
const DEPTHS: usize = 8;

/// h before it is calibrated.
const FIRST_H: f32 = 0.01;

/// Lights that each camera vertex is asked about.
const LAMPS: usize = 4;

/// Largest [`Pilot::steadiness`].
const STEADIEST: f32 = 16.0;

/// Part of the light paths that begin by what was learnt.
const LEARNT: f32 = 0.8;

impl Outlook {
    /// Trial links that a vertex of this depth, or a path in this tile, asks for to get `links` that are unoccluded.
    pub(crate) fn trials(&self, links: f32, tile: usize, depth: u32) -> f32 {
        let seen = if depth == 0 { self.tiles[tile] } else { self.depths[(depth as usize).min(DEPTHS - 1)] };
        links / seen.max(1.0 / MOST_TRIALS)
    }
}

impl GKernel {
    pub(super) fn fly_pilot(&self, shots: &[&Shot]) -> Pilot {
        let lights = shots[0].world.lights();
        let weighed = (self.weighed(shots[0], [FIRST_H; 2], (1.0, 1.0)), lights.by_power());
        let views = shots.iter().step_by(shots.len().div_ceil(VIEWS)).map(|shot| self.flock(shot, weighed));
        let flock = views.reduce(Flock::join).unwrap_or_default();
        let shine = flock.shine(shots[0]);
        let starts = match self.method.importance {
            true => lights.starts_by(&shine.brought, LEARNT),
            false => lights.by_power().clone(),
        };
        let steadiness = if self.method.steady { shine.steadiness } else { 1.0 };
        let (h, scale) = self.calibrate(shots[0], &flock, &starts);
        Pilot { h, scale, steadiness, starts }
    }

    fn weighed(&self, shot: &Shot, h: [f32; 2], scale: (f32, f32)) -> Weighing {
        self.weighing(scale, &self.bandwidth(shot, 0, h), self.light_paths(shot))
    }

    /// The pilot's camera paths.
    fn flock<'a>(&self, shot: &Shot<'a>, path: (Weighing, &'a Starts)) -> Flock<'a> {
        // Only for its tiles.
        let Ok(Film { tiles, .. }) = shot.film(&[]) else { return Flock::default() };
        let block = |t| self.eyes(shot, path, t, STEP, |i| i % SPARSE == 5);
        let blocks: Vec<Block> = tiles.par_iter().map(block).collect();
        let mut flock = Flock { eyes: Vec::new(), tile_of: Vec::new(), tiles: tiles.len() };
        let mut paths = 0;
        for (t, block) in blocks.into_iter().enumerate() {
            flock.tile_of.extend(std::iter::repeat_n(t, block.eyes.len()));
            flock.eyes.extend(block.eyes.into_iter().map(|eye| EyeVertex { path: eye.path + paths, ..eye }));
            paths += block.radiance.len() as u32;
        }
        flock
    }

    /// Finds h and c.
    fn calibrate(&self, shot: &Shot, flock: &Flock, starts: &Starts) -> ([f32; 2], f32) {
        let mut h = [FIRST_H; 2];
        let tree = link::tree(&flock.eyes);
        let bandwidth = |h| self.bandwidth(shot, 0, h);
        let request = few(self.request(shot, STEP, bandwidth(h), (self.weighed(shot, h, (1.0, 1.0)), starts)));
        let mut lights = LightPaths::trace(&request);
        // Of a step's.
        let part = request.count as f32 / self.light_paths(shot) as f32;
        let wanted = CANDIDATES * part;
        for _ in 0..8 {
            let [first, others] = link::count(&lights, &tree).map(|n| n as f32 / flock.eyes.len().max(1) as f32);
            let counts = if self.method.shrink { [first, others] } else { [first; 2] };
            if counts.iter().all(|c| (c / wanted - 1.0).abs() < 0.1) {
                break;
            }
            h.iter_mut().zip(counts).for_each(|(h, c)| *h *= (wanted / c.max(0.05 * wanted)).sqrt());
            lights.refit(&bandwidth(h));
        }
        // Light vertices per path that see a point.
        let mut scale = PI * h[0].powi(2) * lights.count as f32 / part;
        if self.method.acceptance {
            let candidates = link::count(&lights, &tree).iter().sum::<usize>().max(1) as f32 / part;
            scale *= (self.links * self.groups(&flock.eyes).len() as f32 / candidates).min(1.0);
        }
        (h, if self.method.weights { scale } else { scale * lights.typical_area() })
    }

    /// Finds how many links are occluded in a view.
    pub(super) fn look(&self, shot: &Shot, pilot: &Pilot) -> Outlook {
        let bandwidth = self.bandwidth(shot, 0, pilot.h);
        // The camera's vertices with the weights that links take.
        let path = (self.weighed(shot, pilot.h, (pilot.scale, pilot.steadiness)), &pilot.starts);
        let flock = self.flock(shot, path);
        let request = few(self.request(shot, STEP, bandwidth, path));
        let lights = LightPaths::trace(&request);
        let linker = self.linker(&request, &lights, STEP);
        let eyes = &flock.eyes;
        let candidates = Candidates::find(&lights, &link::tree(eyes), eyes.len());
        let strength =
            |light: u32, eye: &EyeVertex| self.strength(&linker, &Brief::new(&lights.vertices[light as usize]), eye);
        let trials = |_| 3.0 * self.links;
        let links = candidates.select(eyes, &self.groups(eyes), (shot.seed, STEP), trials, strength);
        // One link seen and one not for a start: what is not known is asked for moderately.
        let mut tiles = vec![(1.0_f32, 2.0_f32); flock.tiles];
        let mut depths = [(1.0_f32, 2.0_f32); DEPTHS];
        for (link, score) in links.iter().zip(linker.score(&links, eyes)) {
            let eye = &eyes[link.eye as usize];
            let add = |slot: &mut (f32, f32)| *slot = (slot.0 + f32::from(u8::from(score.visible)), slot.1 + 1.0);
            if eye.depth == 0 || self.method.target {
                add(&mut tiles[flock.tile_of[link.eye as usize]]);
            }
            add(&mut depths[(eye.depth as usize).min(DEPTHS - 1)]);
        }
        let tiles = tiles.iter().map(|(a, b)| a / b).collect();
        Outlook { view: shot.view, tiles, depths: depths.map(|(a, b)| a / b) }
    }
}

/// By emitter sampling, which finds the lights that are seen among thousands that are not.
struct Shine {
    /// What each light brings to the picture, relative to the brightness of the tile.
    brought: Vec<f32>,
    /// See [`Pilot`].
    steadiness: f32,
}

/// The pilot's light paths.
fn few(request: Request) -> Request {
    Request { count: (request.count / 4).max(FEWEST_PATHS).min(request.count), ..request }
}

/// Camera vertices of the pilot, and the tiles that they belong to.
#[derive(Default)]
struct Flock<'a> {
    eyes: Vec<EyeVertex<'a>>,
    tile_of: Vec<usize>,
    tiles: usize,
}

impl Flock<'_> {
    fn join(mut self, other: Self) -> Self {
        self.eyes.extend(other.eyes);
        self.tile_of.extend(other.tile_of.iter().map(|t| t + self.tiles));
        self.tiles += other.tiles;
        self
    }

    /// What lights bring to the picture through these vertices.
    fn shine(&self, shot: &Shot) -> Shine {
        let world = shot.world;
        let of = |(i, eye): (usize, &EyeVertex)| {
            let mut sampler = PathSampler::new(shot.seed ^ 0x706c_6f74, i as u64, 0);
            let n = world.receiving_normal(&eye.hit, &eye.shading);
            std::array::from_fn::<_, LAMPS, _>(|_| {
                let (u_choice, u) = (sampler.next_1d(), sampler.next_2d());
                let p = eye.hit.point.p;
                let (light, sample) = world.lights().sample_numbered(world.scene(), p, n, u_choice, u)?;
                let (f_cos, _) = eye.shading.eval_cos_pdf(eye.hit.wo, sample.wi, Mode::Radiance);
                let segment = World::segment(&eye.hit.point, sample.wi, &sample.end);
                let visible = world.transmittance(&segment, MOST_CROSSINGS);
                let value = luminance(visible * sample.radiance * f_cos * eye.throughput) / sample.pdf_w;
                (value > 0.0).then_some((light, value))
            })
        };
        let found: Vec<_> = self.eyes.par_iter().enumerate().map(of).collect();
        let mut shine = vec![0.0; self.tiles];
        for (lamps, tile) in found.iter().zip(&self.tile_of) {
            lamps.iter().flatten().for_each(|lamp| shine[*tile] += lamp.1);
        }
        let dark = 0.01 * shine.iter().sum::<f32>() / self.tiles as f32;
        let mut brought = vec![0.0; world.lights().len()];
        let (mut squares, mut variance) = (0.0, 0.0);
        for (lamps, tile) in found.iter().zip(&self.tile_of) {
            let relative = lamps.map(|lamp| lamp.map_or(0.0, |lamp| lamp.1 / (shine[*tile] + dark)));
            lamps
                .iter()
                .zip(relative)
                .filter_map(|(lamp, v)| Some((lamp.as_ref()?.0, v)))
                .for_each(|(i, v)| brought[i] += v);
            let mean = relative.iter().sum::<f32>() / LAMPS as f32;
            squares += relative.iter().map(|v| v * v).sum::<f32>() / LAMPS as f32;
            variance += relative.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / (LAMPS - 1) as f32;
        }
        let steadiness = if squares > 0.0 { squares / variance.max(squares / STEADIEST) } else { 1.0 };
        Shine { brought, steadiness: steadiness.max(1.0) }
    }
}

/// Footprints of each kind that a camera vertex should lie in: the paper's M.
const CANDIDATES: f32 = 10.0;
