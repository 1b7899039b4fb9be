//! What a prepass finds out before the first step, with light paths of its own and some of the camera's: h, how many
//! links are occluded, which lights are visible from where, and at which lights light paths should begin.
//!
//! Source: Bekaert et al. 2003, §5 (h so that M footprints of direct light hold a camera vertex in the mean; the share
//! of unoccluded links). The lights' part is not in the paper: a light's chance follows what it contributes to the
//! picture, mixed with its power so that none is forgotten.

use super::super::footprints::Candidates;
use super::eye::EyeVertex;
use super::light::{CompactLightVertex, LightPaths, Request};
use super::link;
use super::weight::MisWeights;
use super::{Block, GKernel, MAX_TRIALS, MIN_PATHS, Plan};
use crate::film::Film;
use crate::light::{LightVisibilityCache, Place, Starts, VisibilitySample};
use crate::render::Shot;
use crate::world::{MOST_CROSSINGS, World};
use crate::{PathSampler, Rgb, luminance};
use rayon::prelude::*;
use std::f32::consts::PI;
use std::sync::atomic::{AtomicBool, Ordering};
use translume_bxdf::Mode;
use translume_core::sampler::Sampler;

/// What a prepass found, for all views of a scene.
pub(crate) struct Calibration {
    pub(crate) h: [f32; 2],
    /// c of the weights.
    pub(crate) links: f32,
    /// Variance factor of light samples at camera vertices: the mean of their squares over their variance. Weights that
    /// go by densities alone take these to be equal (Grittmann et al. 2019: variance-aware multiple importance
    /// sampling).
    pub(crate) variance_factor: f32,
    /// Where light paths begin.
    pub(crate) starts: Starts,
    /// Which lights are visible from where.
    pub(crate) visibility: Option<LightVisibilityCache>,
}

/// Share of trial links that are unoccluded in a view: per tile, and of vertices that choose alone, beyond the first,
/// per depth.
pub(crate) struct VisibilityEstimate {
    /// [`Shot::view`].
    pub(crate) view: u32,
    tiles: Vec<f32>,
    depths: [f32; DEPTHS],
}

/// Views that the prepass looks at, at most.
const VIEWS: usize = 8;

/// The prepass's step.
const STEP: u64 = 1 << 30;

/// Every so many pixels send one of the prepass's camera paths.
const SPARSE: usize = 16;

/// Camera depths told apart.
const DEPTHS: usize = 8;

/// h before it is calibrated.
const FIRST_H: f32 = 0.01;

/// Lights that are tried, by all camera vertices together; and the bounds of their number at each.
const TRIES: usize = 300_000;
const MIN_TRIES: usize = 2;
const MAX_TRIES: usize = 64;

/// Largest [`Calibration::variance_factor`].
const MAX_VARIANCE_FACTOR: f32 = 16.0;

/// Part of the light paths that begin by what was learnt.
const LEARNT: f32 = 0.8;

impl VisibilityEstimate {
    /// Trial links that a vertex of this depth, or a path in this tile, asks for to get `links` that are unoccluded.
    pub(crate) fn trials(&self, links: f32, tile: usize, depth: u32) -> f32 {
        let visible = if depth == 0 { self.tiles[tile] } else { self.depths[(depth as usize).min(DEPTHS - 1)] };
        links / visible.max(1.0 / MAX_TRIALS)
    }
}

impl GKernel {
    pub(super) fn prepass(&self, shots: &[&Shot], stop: &AtomicBool) -> Calibration {
        let shot = shots[0];
        let lights = shot.world.lights();
        let bandwidth = self.bandwidth(shot, 0, [FIRST_H; 2]);
        let weights = self.mis_weights((1.0, 1.0), &bandwidth, self.light_paths(shot));
        let first = Plan { weights, bandwidth, starts: lights.by_power(), visibility: None };
        let views = shots.iter().step_by(shots.len().div_ceil(VIEWS)).map(|shot| self.sparse_paths(shot, first, stop));
        let paths = views.reduce(SparsePaths::join).unwrap_or_default();
        let mut tried = paths.try_lights(shot, None, 0);
        let visibility = paths.learn(shot, &tried);
        if visibility.is_some() {
            tried = paths.try_lights(shot, visibility.as_ref(), 1);
        }
        let contribution = paths.contribution(lights.len(), &tried);
        let starts = lights.starts_by(&contribution.of_lights, LEARNT);
        let variance_factor = contribution.variance_factor;
        let mut calibration = Calibration { h: [FIRST_H; 2], links: 1.0, variance_factor, starts, visibility };
        (calibration.h, calibration.links) = self.calibrate(shot, &paths, &calibration, stop);
        calibration
    }

    /// The prepass's camera paths.
    fn sparse_paths<'a>(&self, shot: &Shot<'a>, plan: Plan<'a>, stop: &AtomicBool) -> SparsePaths<'a> {
        // Only for its tiles.
        let Ok(Film { tiles, .. }) = shot.film(&[]) else { return SparsePaths::default() };
        // Their vertices are wanted, not light.
        let plan = Plan { weights: MisWeights { emitters: 0.0, ..plan.weights }, ..plan };
        let block = |t| self.sparse_eyes(shot, plan, (t, STEP), |i| i % SPARSE == 5 && !stop.load(Ordering::Relaxed));
        let blocks: Vec<Block> = tiles.par_iter().map(block).collect();
        let mut all = SparsePaths { tiles: tiles.len(), ..SparsePaths::default() };
        let mut paths = 0;
        for (t, block) in blocks.into_iter().enumerate() {
            all.tile_of.extend(std::iter::repeat_n(t, block.eyes.len()));
            all.eyes.extend(block.eyes.into_iter().map(|eye| EyeVertex { path: eye.path + paths, ..eye }));
            paths += block.radiance.len() as u32;
        }
        all
    }

    /// Finds h and c.
    fn calibrate(&self, shot: &Shot, paths: &SparsePaths, known: &Calibration, stop: &AtomicBool) -> ([f32; 2], f32) {
        let mut h = [FIRST_H; 2];
        let tree = link::tree(&paths.eyes);
        let request = self.request(shot, STEP, self.plan(shot, 0, known), stop);
        let whole = request.count as f32;
        let request = few(request);
        let mut lights = LightPaths::trace(&request);
        // Of a step's.
        let part = request.count as f32 / whole;
        let wanted = CANDIDATES * part;
        for _ in 0..8 {
            let counts = link::count(&lights, &tree).map(|n| n as f32 / paths.eyes.len().max(1) as f32);
            if counts.iter().all(|c| (c / wanted - 1.0).abs() < 0.1) {
                break;
            }
            h.iter_mut().zip(counts).for_each(|(h, c)| *h *= (wanted / c.max(0.05 * wanted)).sqrt());
            lights.refit(&self.bandwidth(shot, 0, h));
        }
        // Light vertices per path that see a point, and the part of them that become trial links.
        let candidates = link::count(&lights, &tree).iter().sum::<usize>().max(1) as f32 / part;
        let accepted = (self.links * self.groups(&paths.eyes).len() as f32 / candidates).min(1.0);
        (h, PI * h[0].powi(2) * lights.count as f32 / part * accepted)
    }

    /// Finds how many links are occluded in a view.
    pub(super) fn visibility_in(&self, shot: &Shot, known: &Calibration, stop: &AtomicBool) -> VisibilityEstimate {
        // The camera's vertices with the weights that links take.
        let plan = self.plan(shot, 0, known);
        let paths = self.sparse_paths(shot, plan, stop);
        let request = few(self.request(shot, STEP, plan, stop));
        let lights = LightPaths::trace(&request);
        let linker = self.linker(&request, &lights, STEP);
        let eyes = &paths.eyes;
        let candidates = Candidates::find(&lights.footprints(), &link::tree(eyes), eyes.len());
        let strength = |light: u32, eye: &EyeVertex| {
            self.strength(&linker, &CompactLightVertex::new(&lights.vertices[light as usize]), eye)
        };
        let trials = |_| 3.0 * self.links;
        let links = link::select(&candidates, eyes, &self.groups(eyes), (shot.seed, STEP), trials, strength);
        // One visible link and one occluded one for a start: what is not known is asked for moderately.
        let mut tiles = vec![(1.0_f32, 2.0_f32); paths.tiles];
        let mut depths = [(1.0_f32, 2.0_f32); DEPTHS];
        for (link, score) in links.iter().zip(linker.score(&links, eyes)) {
            let eye = &eyes[link.eye as usize];
            let add = |slot: &mut (f32, f32)| *slot = (slot.0 + f32::from(u8::from(score.visible)), slot.1 + 1.0);
            add(&mut tiles[paths.tile_of[link.eye as usize]]);
            add(&mut depths[(eye.depth as usize).min(DEPTHS - 1)]);
        }
        let tiles = tiles.iter().map(|(a, b)| a / b).collect();
        VisibilityEstimate { view: shot.view, tiles, depths: depths.map(|(a, b)| a / b) }
    }
}

/// By emitter sampling, which finds the lights that are visible among thousands that are not.
struct Contribution {
    /// What each light contributes to the picture, relative to the brightness of the tile.
    of_lights: Vec<f32>,
    /// See [`Calibration`].
    variance_factor: f32,
}

/// The prepass's light paths.
fn few(request: Request) -> Request {
    Request { count: (request.count / 4).max(MIN_PATHS).min(request.count), ..request }
}

/// Camera vertices of the prepass, and the tiles that they belong to.
#[derive(Default)]
struct SparsePaths<'a> {
    eyes: Vec<EyeVertex<'a>>,
    tile_of: Vec<usize>,
    tiles: usize,
}

impl SparsePaths<'_> {
    /// With the vertices of another; no links will be made.
    fn join(mut self, other: Self) -> Self {
        self.eyes.extend(other.eyes);
        self.tile_of.extend(other.tile_of.iter().map(|t| t + self.tiles));
        self.tiles += other.tiles;
        self
    }

    /// How many lights are tried at each vertex.
    fn tries(&self) -> usize {
        (TRIES / self.eyes.len().max(1)).clamp(MIN_TRIES, MAX_TRIES)
    }

    /// Lights tried at each vertex.
    fn try_lights(&self, shot: &Shot, cache: Option<&LightVisibilityCache>, round: u64) -> Vec<TriedLights> {
        let (world, lights) = (shot.world, shot.world.lights());
        let of = |(i, eye): (usize, &EyeVertex)| {
            let mut sampler = PathSampler::new(shot.seed ^ 0x706c_6f74, i as u64, round);
            let (p, n) = (eye.hit.point.p, world.receiving_normal(&eye.hit, &eye.shading));
            let mut place = Place::new(p, n, cache.map(|c| c.from(p, n)));
            let once = |_| {
                let (u_choice, u) = (sampler.next_1d(), sampler.next_2d());
                let chosen = lights.choose_at(&mut place, u_choice)?;
                let Some(sample) = lights.sample_of(world.scene(), p, chosen, u) else { return Some((chosen.0, 0.0)) };
                let (f_cos, _) = eye.shading.eval_cos_pdf(eye.hit.wo, sample.wi, Mode::Radiance);
                let unshadowed = luminance(sample.radiance * f_cos * eye.throughput) / sample.pdf_w;
                let segment = World::segment(&eye.hit.point, sample.wi, &sample.end);
                let visible = if unshadowed > 0.0 { world.transmittance(&segment, MOST_CROSSINGS) } else { Rgb::ZERO };
                Some((chosen.0, unshadowed * luminance(visible)))
            };
            (0..self.tries()).filter_map(once).collect()
        };
        self.eyes.par_iter().enumerate().map(of).collect()
    }

    /// Which lights are visible from where.
    fn learn(&self, shot: &Shot, tried: &[TriedLights]) -> Option<LightVisibilityCache> {
        let world = shot.world;
        let samples = self.eyes.iter().zip(tried).map(|(eye, tried)| VisibilitySample {
            p: eye.hit.point.p,
            n: world.receiving_normal(&eye.hit, &eye.shading),
            lights: tried.iter().map(|(light, value)| (*light, *value > 0.0)).collect(),
        });
        world.lights().learn(samples.collect())
    }

    /// What each of so many lights contributes to the picture through these vertices.
    fn contribution(&self, lights: usize, tried: &[TriedLights]) -> Contribution {
        let mut of_tiles = vec![0.0; self.tiles];
        for (tried, tile) in tried.iter().zip(&self.tile_of) {
            of_tiles[*tile] += tried.iter().map(|light| light.1).sum::<f32>();
        }
        let dark = 0.01 * of_tiles.iter().sum::<f32>() / self.tiles as f32;
        let mut of_lights = vec![0.0; lights];
        let (mut squares, mut variance) = (0.0, 0.0);
        let tries = self.tries() as f32;
        for ((tried, tile), eye) in tried.iter().zip(&self.tile_of).zip(&self.eyes).filter(|_| dark > 0.0) {
            let relative = |value: f32| value / (of_tiles[*tile] + dark);
            tried.iter().for_each(|(light, value)| of_lights[*light] += relative(*value));
            if eye.depth > 0 {
                continue;
            }
            let mean = tried.iter().map(|(_, value)| relative(*value)).sum::<f32>() / tries;
            let square = tried.iter().map(|(_, value)| relative(*value).powi(2)).sum::<f32>() / tries;
            squares += square;
            variance += (square - mean * mean).max(0.0) * (tries / (tries - 1.0));
        }
        let factor = if squares > 0.0 { squares / variance.max(squares / MAX_VARIANCE_FACTOR) } else { 1.0 };
        Contribution { of_lights, variance_factor: factor.max(1.0) }
    }
}

/// Lights that a camera vertex tried: their numbers, and what they contribute to the picture there.
type TriedLights = Vec<(usize, f32)>;

/// Footprints of each kind that a camera vertex should lie in: the paper's M.
const CANDIDATES: f32 = 10.0;
