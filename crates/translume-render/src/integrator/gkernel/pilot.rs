//! What is found out before the first step, with light paths of their own and some of the camera's: h, how many links are
//! occluded, which lights are seen from where, and at which lights light paths should begin.
//!
//! Source: Bekaert et al. 2003, §5 (h so that M footprints of direct light hold a camera vertex in the mean; the share of
//! unoccluded links). The lights' part is not in the paper: a lamp's chance follows what it brings to the picture, mixed
//! with its power so that none is forgotten.

use super::super::footprints::Candidates;
use super::correlation::{self, Ancestor};
use super::eye::EyeVertex;
use super::keep::Keep;
use super::light::{Brief, LightPaths, Request};
use super::link;
use super::weight::Weighing;
use super::{Block, FEWEST_PATHS, GKernel, MOST_TRIALS, Plan};
use crate::film::Film;
use crate::light::{Place, Seen, Starts, Tried};
use crate::render::Shot;
use crate::world::{MOST_CROSSINGS, World};
use crate::{PathSampler, Rgb, luminance};
use rayon::prelude::*;
use std::f32::consts::PI;
use std::sync::atomic::{AtomicBool, Ordering};
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
    /// Which lights are seen from where.
    pub(crate) seen: Option<Seen>,
    /// Which light paths are kept.
    pub(crate) keep: Option<Keep>,
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

/// Lights that are tried, by all camera vertices together; and the bounds of their number at each.
const TRIES: usize = 300_000;
const FEWEST_TRIES: usize = 2;
const MOST_TRIES: usize = 64;

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

impl Pilot {
    pub(super) fn plan(&self, weighing: Weighing) -> Plan<'_> {
        Plan { weighing, starts: &self.starts, seen: self.seen.as_ref(), keep: self.keep.as_ref() }
    }
}

impl GKernel {
    pub(super) fn fly_pilot(&self, shots: &[&Shot], stop: &AtomicBool) -> Pilot {
        let shot = shots[0];
        let lights = shot.world.lights();
        let first = Plan {
            weighing: self.weighed(shot, [FIRST_H; 2], (1.0, 1.0)),
            starts: lights.by_power(),
            seen: None,
            keep: None,
        };
        let views = shots.iter().step_by(shots.len().div_ceil(VIEWS)).map(|shot| self.flock(shot, first, stop));
        let flock = views.reduce(Flock::join).unwrap_or_default();
        let mut lamps = flock.lamps(shot, None, 0);
        let seen = if self.method.seen { flock.learn(shot, &lamps) } else { None };
        if seen.is_some() {
            lamps = flock.lamps(shot, seen.as_ref(), 1);
        }
        let shine = flock.shine(lights.len(), &lamps);
        let learnt = if self.method.importance { &shine.brought[..] } else { &[] };
        let starts = lights.starts_by(learnt, LEARNT, self.quota);
        let steadiness = if self.method.steady { shine.steadiness } else { 1.0 };
        let mut pilot = Pilot { h: [FIRST_H; 2], scale: 1.0, steadiness, starts, seen, keep: None };
        pilot.keep = if self.method.keep { self.keep(shot, &flock, &pilot, stop) } else { None };
        (pilot.h, pilot.scale) = self.calibrate(shot, &flock, &pilot, stop);
        pilot
    }

    fn weighed(&self, shot: &Shot, h: [f32; 2], scale: (f32, f32)) -> Weighing {
        self.weighing(scale, &self.bandwidth(shot, 0, h), self.light_paths(shot))
    }

    /// The pilot's camera paths.
    fn flock<'a>(&self, shot: &Shot<'a>, plan: Plan<'a>, stop: &AtomicBool) -> Flock<'a> {
        // Only for its tiles.
        let Ok(Film { tiles, .. }) = shot.film(&[]) else { return Flock::default() };
        // Their vertices are wanted, not light.
        let plan = Plan { weighing: Weighing { emitters: 0.0, ..plan.weighing }, ..plan };
        let block = |t| self.sparse_eyes(shot, plan, (t, STEP), |i| i % SPARSE == 5 && !stop.load(Ordering::Relaxed));
        let blocks: Vec<Block> = tiles.par_iter().map(block).collect();
        let mut flock = Flock { tiles: tiles.len(), ..Flock::default() };
        let mut paths = 0;
        for (t, block) in blocks.into_iter().enumerate() {
            flock.tile_of.extend(std::iter::repeat_n(t, block.eyes.len()));
            let by = flock.ancestors.len() as u32;
            let moved = |eye: EyeVertex<'a>| EyeVertex {
                path: eye.path + paths,
                above: correlation::moved(eye.above, by),
                ..eye
            };
            flock.eyes.extend(block.eyes.into_iter().map(moved));
            flock.ancestors.extend(block.ancestors.iter().map(|a| a.moved(by)));
            paths += block.radiance.len() as u32;
        }
        flock
    }

    /// Finds out which light paths are to be kept.
    fn keep(&self, shot: &Shot, flock: &Flock, pilot: &Pilot, stop: &AtomicBool) -> Option<Keep> {
        let mut keep = Keep::learn(&flock.eyes, shot.world.bounding_sphere())?;
        let plan = pilot.plan(self.weighed(shot, pilot.h, (1.0, pilot.steadiness)));
        keep.compare_with(&LightPaths::brought(
            &few(self.request(shot, STEP, self.bandwidth(shot, 0, pilot.h), plan, stop)),
            &keep,
        ));
        Some(keep)
    }

    /// Finds h and c.
    fn calibrate(&self, shot: &Shot, flock: &Flock, pilot: &Pilot, stop: &AtomicBool) -> ([f32; 2], f32) {
        let mut h = [FIRST_H; 2];
        let tree = link::tree(&flock.eyes);
        let bandwidth = |h| self.bandwidth(shot, 0, h);
        let plan = pilot.plan(self.weighed(shot, h, (1.0, pilot.steadiness)));
        let request = self.request(shot, STEP, bandwidth(h), plan, stop);
        let whole = request.count as f32;
        let request = few(request);
        let mut lights = LightPaths::trace(&request);
        // Of a step's.
        let part = request.count as f32 / whole;
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
    pub(super) fn look(&self, shot: &Shot, pilot: &Pilot, stop: &AtomicBool) -> Outlook {
        let bandwidth = self.bandwidth(shot, 0, pilot.h);
        // The camera's vertices with the weights that links take.
        let plan = pilot.plan(self.weighed(shot, pilot.h, (pilot.scale, pilot.steadiness)));
        let flock = self.flock(shot, plan, stop);
        let request = few(self.request(shot, STEP, bandwidth, plan, stop));
        let lights = LightPaths::trace(&request);
        let linker = self.linker(&request, &lights, STEP);
        let eyes = &flock.eyes;
        let candidates = Candidates::find(&lights.footprints(), &link::tree(eyes), eyes.len());
        let strength =
            |light: u32, eye: &EyeVertex| self.strength(&linker, &Brief::new(&lights.vertices[light as usize]), eye);
        let trials = |_| 3.0 * self.links;
        let links = link::select(&candidates, eyes, &self.groups(eyes), (shot.seed, STEP), trials, strength);
        // One link seen and one not for a start: what is not known is asked for moderately.
        let mut tiles = vec![(1.0_f32, 2.0_f32); flock.tiles];
        let mut depths = [(1.0_f32, 2.0_f32); DEPTHS];
        for (link, score) in links.iter().zip(linker.score(&links, eyes, &flock.ancestors)) {
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
    ancestors: Vec<Ancestor>,
    tile_of: Vec<usize>,
    tiles: usize,
}

impl Flock<'_> {
    /// With the vertices of another; no links will be made.
    fn join(mut self, other: Self) -> Self {
        self.eyes.extend(other.eyes);
        self.tile_of.extend(other.tile_of.iter().map(|t| t + self.tiles));
        self.tiles += other.tiles;
        self
    }

    /// How many lights are tried at each vertex.
    fn tries(&self) -> usize {
        (TRIES / self.eyes.len().max(1)).clamp(FEWEST_TRIES, MOST_TRIES)
    }

    /// Lights tried at each vertex.
    fn lamps(&self, shot: &Shot, seen: Option<&Seen>, round: u64) -> Vec<Lamps> {
        let (world, lights) = (shot.world, shot.world.lights());
        let of = |(i, eye): (usize, &EyeVertex)| {
            let mut sampler = PathSampler::new(shot.seed ^ 0x706c_6f74, i as u64, round);
            let (p, n) = (eye.hit.point.p, world.receiving_normal(&eye.hit, &eye.shading));
            let mut place = Place::new(p, n, seen.map(|s| s.from(p, n)));
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

    /// Which lights are seen from where.
    fn learn(&self, shot: &Shot, lamps: &[Lamps]) -> Option<Seen> {
        let world = shot.world;
        let tried = self.eyes.iter().zip(lamps).map(|(eye, lamps)| Tried {
            p: eye.hit.point.p,
            n: world.receiving_normal(&eye.hit, &eye.shading),
            lights: lamps.iter().map(|(light, value)| (*light, *value > 0.0)).collect(),
        });
        world.lights().learn(tried.collect())
    }

    /// What lights bring to the picture through these vertices, of so many lights.
    fn shine(&self, lights: usize, found: &[Lamps]) -> Shine {
        let mut shine = vec![0.0; self.tiles];
        for (lamps, tile) in found.iter().zip(&self.tile_of) {
            shine[*tile] += lamps.iter().map(|lamp| lamp.1).sum::<f32>();
        }
        let dark = 0.01 * shine.iter().sum::<f32>() / self.tiles as f32;
        let mut brought = vec![0.0; lights];
        let (mut squares, mut variance) = (0.0, 0.0);
        let tries = self.tries() as f32;
        for ((lamps, tile), eye) in found.iter().zip(&self.tile_of).zip(&self.eyes).filter(|_| dark > 0.0) {
            let relative = |value: f32| value / (shine[*tile] + dark);
            lamps.iter().for_each(|(light, value)| brought[*light] += relative(*value));
            if eye.depth > 0 {
                continue;
            }
            let mean = lamps.iter().map(|(_, value)| relative(*value)).sum::<f32>() / tries;
            let square = lamps.iter().map(|(_, value)| relative(*value).powi(2)).sum::<f32>() / tries;
            squares += square;
            variance += (square - mean * mean).max(0.0) * (tries / (tries - 1.0));
        }
        let steadiness = if squares > 0.0 { squares / variance.max(squares / STEADIEST) } else { 1.0 };
        Shine { brought, steadiness: steadiness.max(1.0) }
    }
}

/// Lights that a camera vertex tried: their numbers, and what they bring to the picture there.
type Lamps = Vec<(usize, f32)>;

/// Footprints of each kind that a camera vertex should lie in: the paper's M.
const CANDIDATES: f32 = 10.0;
