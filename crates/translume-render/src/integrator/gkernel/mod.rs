//! The generalized kernel method: light paths and camera paths that land near each other are linked, and a link asks
//! from where the light came instead of believing that it is the same here.
//!
//! Source: Bekaert, Slusallek, Cools, Havran, Seidel: A custom designed density estimator for light transport,
//! MPI-I-2003-4-004. One pass of the driver is one step (§5): light paths are traced once, then the picture's tiles
//! block by block: camera paths (`pixels`, `eye`), pairs of a camera vertex in a light vertex's footprint (`link`),
//! trial links, shadow rays in the order of light vertices (`link`). Steps are averaged; the samples of a pixel are its
//! camera paths, one a step or more.
//!
//! Nothing needs to be set: h is found by the number of footprints per camera vertex of direct light (M = 10), the
//! number of trial links by the share that a prepass found unoccluded, per tile for the first vertex and per depth
//! beyond.
//!
//! Departures from the paper, whose own form is `gkernel-2003`: R is at most 0.35 of the distance to the parent and h
//! shrinks with the steps, so that the picture converges; where a footprint is not flat the normalisation is estimated
//! with rays; links are chosen by the flux that they would bring, fewer of them beyond the first camera vertex; lights
//! are sampled at camera vertices as well; merges are weighed by their number (see `weight`); neighbouring camera paths
//! share what they find beyond their first surface (see `share`).
//!
//! Limits: light that mirrors and glass focus is found by merging photons, not by connecting light paths to the camera;
//! no participating media.

mod calibration;
mod chance;
mod eye;
mod light;
mod link;
mod options;
mod pixels;
mod share;
mod weight;

use super::footprints::{Candidates, Footprint};
use super::link_counts::LinkCounts;
use super::{Integrator, Settings};
use crate::film::{Film, Tile};
use crate::light::{LightVisibilityCache, Starts};
use crate::render::Shot;
use crate::subpath::Limits;
use crate::world::World;
use crate::{Result, Rgb};
use calibration::{Calibration, VisibilityEstimate};
use eye::EyeVertex;
use light::{Bandwidth, CompactLightVertex, LightPaths, LightVertex, Request};
use link::Linker;
pub(crate) use options::{OPTIONS, REMOVED};
use rayon::prelude::*;
use share::{Group, SuffixShare};
use std::collections::HashMap;
use std::f32::consts::{FRAC_1_PI, PI};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use weight::{MisWeights, Technique};

/// See the module.
pub struct GKernel {
    settings: Settings,
    /// Light paths of a step; 0: an eighth as many as pixels, at least [`MIN_PATHS`].
    light_paths: u32,
    /// Camera paths of a pixel in each step.
    eye_paths: u64,
    /// Pixels on a side of the blocks that share what their camera paths find.
    shared: u32,
    /// Camera paths for each that goes on for all of them.
    sharers: usize,
    /// Unoccluded links that a camera path should get.
    links: f32,
    /// Chances of links are found without bias.
    unbiased: bool,
    /// Photons are merged behind mirrors and glass.
    caustics: bool,
    /// Lights are sampled at camera vertices as well.
    emitters: bool,
    calibration: OnceLock<Calibration>,
    /// Of the view that is being taken.
    visibility: Mutex<Option<Arc<VisibilityEstimate>>>,
    /// Light paths by their step; kept where several views want them.
    kept: Mutex<HashMap<u64, Arc<Traced>>>,
    keep: AtomicBool,
    counts: LinkCounts,
}

/// Largest number of trial links over the unoccluded links that are wanted.
const MAX_TRIALS: f32 = 8.0;

/// Light paths of a step unless the user says otherwise.
const MIN_PATHS: u32 = 5_000;
const ENOUGH_PATHS: u32 = 10_000;
const MAX_PATHS: u32 = 1_000_000;

/// Radius of photons that are merged, over the scene's, where there are this many light paths in a step; with fewer it
/// is larger, so that a place gets as many photons. Like pixels: their number is that of light paths.
const PHOTON: f32 = 0.004;
const PHOTON_PATHS: f32 = 150_000.0;

/// See [`Bandwidth::min_pdf`]: a quarter of what a diffuse surface sends straight ahead, towards one that it meets
/// straight.
const MIN_PDF: f32 = 0.25 * FRAC_1_PI;

/// Camera paths of a block.
const BLOCK: usize = 1 << 15;

/// Exponent of progressive photon mapping: h² falls as steps^(α − 1).
const ALPHA: f32 = 2.0 / 3.0;

/// How paths are drawn and weighed.
#[derive(Clone, Copy)]
struct Plan<'a> {
    weights: MisWeights,
    bandwidth: Bandwidth,
    /// Where light paths begin.
    starts: &'a Starts,
    /// What is known of the lights that are visible from camera vertices, for sampling them.
    visibility: Option<&'a LightVisibilityCache>,
}

/// The light paths of a step.
struct Traced {
    lights: LightPaths,
    compact: Vec<CompactLightVertex>,
    footprints: Vec<Footprint>,
}

/// Most light vertices that are kept for further views: about 2 GiB of them.
const MAX_KEPT: usize = 9_000_000;

/// A part of the picture, with the camera's paths through it.
#[derive(Default)]
struct Block<'a> {
    eyes: Vec<EyeVertex<'a>>,
    /// Per camera path: its tile and its pixel there, and what it found.
    places: Vec<(u32, u32)>,
    radiance: Vec<Rgb>,
    /// What was found beyond vertices that several camera paths share, and what each gets of it.
    suffixes: Vec<Rgb>,
    shares: Vec<SuffixShare>,
    rays: u64,
}

impl Block<'_> {
    /// Where light belongs that was found on a path, or in its suffix.
    fn light_of(&mut self, path: u32, suffix: Option<u32>) -> &mut Rgb {
        match suffix {
            Some(suffix) => &mut self.suffixes[suffix as usize],
            None => &mut self.radiance[path as usize],
        }
    }
}

impl GKernel {
    /// h² of a step over the first one's: progressive photon mapping.
    fn shrunk(step: u64) -> f32 {
        (1..=step.min(100_000)).map(|i| (i as f32 + ALPHA) / (i as f32 + 1.0)).product()
    }

    /// Of a step whose h, before it shrinks, is `h`.
    fn bandwidth(&self, shot: &Shot, step: u64, h: [f32; 2]) -> Bandwidth {
        let (world, shrink) = (shot.world, Self::shrunk(step).sqrt());
        let (h, radius) = (h.map(|h| h * shrink), world.bounding_sphere().1);
        let photon = PHOTON * radius * shrink * (PHOTON_PATHS / self.light_paths(shot) as f32).sqrt().min(6.0);
        Bandwidth { h, max_share: 0.35, max_radius: 0.1 * radius, min_pdf: MIN_PDF, photon }
    }

    /// For this many links of a vertex, and this variance factor.
    fn mis_weights(&self, (links, factor): (f32, f32), bandwidth: &Bandwidth, light_paths: u32) -> MisWeights {
        let photons = PI * bandwidth.photon.powi(2) * light_paths as f32;
        let photons = if self.caustics { photons } else { 0.0 };
        let emitters = if self.emitters { factor } else { 0.0 };
        MisWeights { links, emitters, photons, min_pdf: bandwidth.min_pdf }
    }

    fn light_paths(&self, shot: &Shot) -> u32 {
        let [w, h] = shot.size();
        if self.light_paths > 0 {
            return self.light_paths;
        }
        // In a small picture enough for photons without much noise, but not so many that a step is mostly light paths.
        let enough = (w * h / 3).clamp(MIN_PATHS, ENOUGH_PATHS);
        (w * h / 8).clamp(enough, MAX_PATHS)
    }

    /// How paths of a step are drawn and weighed.
    fn plan<'a>(&self, shot: &Shot, step: u64, known: &'a Calibration) -> Plan<'a> {
        let bandwidth = self.bandwidth(shot, step, known.h);
        let scale = (known.links, known.variance_factor);
        let weights = self.mis_weights(scale, &bandwidth, self.light_paths(shot));
        Plan { weights, bandwidth, starts: &known.starts, visibility: known.visibility.as_ref() }
    }

    fn request<'a>(&self, shot: &Shot<'a>, step: u64, plan: Plan<'a>, stop: &'a AtomicBool) -> Request<'a> {
        let segments = self.settings.most_segments().saturating_sub(1);
        let limits = Limits { segments, rr_depth: self.settings.rr_depth };
        Request { world: shot.world, limits, plan, seed: shot.seed, step, count: self.light_paths(shot), stop }
    }

    fn linker<'a>(&self, request: &Request<'a>, lights: &'a LightPaths, sample: u64) -> Linker<'a> {
        Linker {
            world: request.world,
            lights,
            plan: request.plan,
            unbiased: self.unbiased,
            max: self.settings.most_segments(),
            seed: (request.seed, sample),
            stop: request.stop,
        }
    }

    /// Camera vertices that share their trial links: those of a path.
    fn groups(&self, eyes: &[EyeVertex]) -> Vec<Range<usize>> {
        let mut begin = 0;
        let group = |chunk: &[EyeVertex]| {
            begin += chunk.len();
            begin - chunk.len()..begin
        };
        eyes.chunk_by(|a, b| a.path == b.path).map(group).collect()
    }

    /// How likely a candidate becomes a trial link, relative to the others: what it would bring if the surface were
    /// white and nothing stood between.
    fn strength(&self, linker: &Linker, v: &CompactLightVertex, eye: &EyeVertex) -> f32 {
        let cos_y = if v.technique == Technique::Merge { 1.0 } else { eye.hit.n().dot(v.wo).abs() + 0.05 };
        v.gain * cos_y * eye.gain * (linker.likely_weight(v, eye) + 0.02)
    }

    /// What is known of occlusion in this view.
    fn visibility(&self, shot: &Shot, calibration: &Calibration, stop: &AtomicBool) -> Arc<VisibilityEstimate> {
        let mut known = self.visibility.lock().unwrap_or_else(PoisonError::into_inner);
        match &*known {
            Some(estimate) if estimate.view == shot.view => estimate.clone(),
            _ => known.insert(Arc::new(self.visibility_in(shot, calibration, stop))).clone(),
        }
    }

    /// The light paths of a step, and the rays that they took now.
    fn traced(&self, request: &Request) -> (Arc<Traced>, u64) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(traced) = kept.get(&request.step) {
            self.counts.reused.fetch_add(1, Ordering::Relaxed);
            return (traced.clone(), 0);
        }
        let lights = LightPaths::trace(request);
        let compact = lights.vertices.iter().map(CompactLightVertex::new).collect();
        let rays = lights.rays;
        let footprints = lights.footprints();
        let traced = Arc::new(Traced { lights, compact, footprints });
        let stored: usize = kept.values().map(|t| t.compact.len()).sum();
        if self.keep.load(Ordering::Relaxed) && stored + traced.compact.len() <= MAX_KEPT {
            kept.insert(request.step, traced.clone());
        }
        (traced, rays)
    }

    /// One block of tiles: one camera path more for each pixel, or none where it is told to stop.
    fn block(
        &self,
        shot: &Shot,
        tiles: &mut [Tile],
        aovs: &[crate::film::Aov],
        (first_tile, sample): (usize, u64),
        (linker, traced): (&Linker, &Traced),
        visibility: &VisibilityEstimate,
    ) -> u64 {
        let (mut places, mut radiance) = (Vec::new(), Vec::new());
        let (mut suffixes, mut shares) = (Vec::new(), Vec::new());
        let (mut eyes, mut wanted) = (Vec::new(), Vec::new());
        let mut rays = 0;
        for mut part in self.eyes(shot, linker.plan, tiles, sample, linker.stop) {
            let [base, first_suffix, first_eye] = [radiance.len(), suffixes.len(), eyes.len()].map(|n| n as u32);
            places.append(&mut part.places);
            radiance.append(&mut part.radiance);
            suffixes.append(&mut part.suffixes);
            shares.extend(part.shares.iter().map(|s| SuffixShare {
                suffix: s.suffix + first_suffix,
                path: s.path + base,
                ..*s
            }));
            for eye in part.eyes.drain(..) {
                let path = eye.path + base;
                let tile = first_tile + places[path as usize].0 as usize;
                wanted.push(visibility.trials(self.links, tile, eye.depth));
                let later = |g: Group| Group { first: g.first + first_eye, next: g.next.map(|n| n + first_eye), ..g };
                eyes.push(EyeVertex {
                    path,
                    suffix: eye.suffix.map(|t| t + first_suffix),
                    group: eye.group.map(later),
                    ..eye
                });
            }
            rays += part.rays;
        }
        let candidates = Candidates::find(&traced.footprints, &link::tree(&eyes), eyes.len());
        let strength = |light: u32, eye: &EyeVertex| self.strength(linker, &traced.compact[light as usize], eye);
        let links = link::select(&candidates, &eyes, &self.groups(&eyes), linker.seed, |i| wanted[i], strength);
        let scores = linker.score(&links, &eyes);
        let unoccluded = scores.iter().filter(|score| score.visible).count();
        for (link, score) in links.iter().zip(scores) {
            let eye = &eyes[link.eye as usize];
            let sum =
                eye.suffix.map_or_else(|| &mut radiance[eye.path as usize], |suffix| &mut suffixes[suffix as usize]);
            *sum += score.value;
            rays += score.rays;
        }
        if linker.stop.load(Ordering::Relaxed) {
            return rays;
        }
        tiles.par_iter_mut().for_each(|t| shot.add_features(t, aovs, sample));
        for share in shares {
            radiance[share.path as usize] += share.factor * suffixes[share.suffix as usize];
        }
        self.counts.add_block([radiance.len(), eyes.len(), candidates.len(), links.len(), unoccluded]);
        for ((tile, pixel), value) in places.into_iter().zip(radiance) {
            tiles[tile as usize].add(pixel as usize, value);
        }
        tiles.iter_mut().for_each(|tile| tile.samples += 1);
        rays
    }
}

impl Integrator for GKernel {
    fn check(&self, world: &World) -> Result<()> {
        self.settings.without_media("gkernel", world)
    }

    /// One prepass for all views; light paths are kept.
    fn prepare_views(&self, shots: &[Shot], stop: &AtomicBool) {
        self.keep.store(true, Ordering::Relaxed);
        if !shots.is_empty() {
            self.calibration.get_or_init(|| self.prepass(&shots.iter().collect::<Vec<_>>(), stop));
        }
    }

    /// A step, or the rest of one.
    fn pass(&self, shot: &Shot, film: &mut Film, stop: &AtomicBool, late: &(dyn Fn() -> bool + Sync)) -> Option<u64> {
        let calibration = self.calibration.get_or_init(|| self.prepass(&[shot], stop));
        let visibility = self.visibility(shot, calibration, stop);
        let first = film.samples().0;
        let step = first / self.eye_paths;
        let request = self.request(shot, step, self.plan(shot, step, calibration), stop);
        let (traced, mut rays) = self.traced(&request);
        let lights = &traced.lights;
        let aovs = film.aovs().to_vec();
        let tiles_at_once = (BLOCK / (crate::film::TILE * crate::film::TILE) as usize).max(1);
        let end = (step + 1) * self.eye_paths;
        for sample in first..end {
            // Links are drawn anew for every camera path, as if it had a step of its own.
            let linker = self.linker(&request, lights, sample);
            let block = |(i, tiles): (usize, &mut [Tile])| {
                // After an interruption some blocks are a sample ahead.
                let done = tiles.iter().any(|t| t.samples != sample);
                if done || stop.load(Ordering::Relaxed) || (sample > 0 && late()) {
                    return 0;
                }
                self.block(shot, tiles, &aovs, (i * tiles_at_once, sample), (&linker, &traced), &visibility)
            };
            rays += film.tiles.par_chunks_mut(tiles_at_once).enumerate().map(block).sum::<u64>();
        }
        self.counts.add_step(lights.vertices.len());
        Some(rays)
    }

    fn facts(&self) -> Vec<(&'static str, f64)> {
        self.counts.facts(self.calibration.get().map_or(0.0, |c| c.h[0]), size_of::<LightVertex>())
    }
}
