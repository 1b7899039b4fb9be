//! The generalized kernel method as it was published: light paths and camera paths are linked where a camera vertex y
//! lies in the footprint of a light vertex x_k, and the link asks x_{k-1} for the light that it sends to y.
//!
//! Source: Bekaert, Slusallek, Cools, Havran, Seidel 2003: A custom designed density estimator for light transport,
//! MPI-I-2003-4-004. `gkernel` is the same method with what was found to be better since; this one is for comparisons.
//!
//! Corrected (errata): p in eq. 7 is a density per area; the score evaluates x_{k-1} towards y (see `arrival`); links
//! are divided by the expected number of their selections; eq. 9 extends to all merges of a path, p_j/p_{j+1} =
//! p^E(z_j)/p^L(z_{j+1}), merges at and behind vertices that scatter in single directions have none, and a camera path
//! that meets a light is one more technique: it counts as a merge in a footprint of typical area would at z_0.
//!
//! Here are footprints, weights, acceptance, trial links, scores and the step; walks and calibration have files of
//! their own, the index of footprints and the light's half of a link are shared with `gkernel`.
//!
//! Limits: darker at edges, too bright at flat angles (eq. 6 is approximated); no caustics of mirrors and glass but by
//! camera paths that meet the light; pixels keep the noise of their one set of camera paths, however many steps are
//! averaged; after `--resume` visibility is learnt anew.

mod calibration;
mod walks;

use super::arrival::Arrival;
use super::footprints::{self, Candidates, Footprint, Link};
use super::link_counts::LinkCounts;
use super::{Choice, Integrator, Options, Settings};
use crate::film::{Aov, Film, TILE, Tile};
use crate::render::Shot;
use crate::subpath::scattering;
use crate::world::{MOST_CROSSINGS, World};
use crate::{PathSampler, Result, Rgb};
use calibration::{View, VisibilityEstimate};
use rayon::prelude::*;
use std::f32::consts::PI;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};
use translume_core::sampler::Sampler;
use walks::{EyeVertex, LightPaths, LightVertex, flag, times};

/// The options.
pub(crate) const OPTIONS: [Choice; 3] = [
    Choice { name: "light-paths", default: "0", about: "light paths of a step; 0: half as many as pixels" },
    Choice { name: "eye-paths", default: "1", about: "camera paths of a pixel, the same ones in each step" },
    Choice { name: "links", default: "10", about: "unoccluded links that each camera vertex should get" },
];

/// See the module.
pub struct GKernel2003 {
    settings: Settings,
    light_paths: u32,
    eye_paths: u64,
    /// The paper's M.
    links: f32,
    view: Mutex<Option<Arc<View>>>,
    counts: LinkCounts,
}

/// Camera paths of a block.
const BLOCK: usize = 1 << 15;

/// R(x_k), after the radius `before` of the vertex before.
fn footprint_radius(h: f32, pdf: f32, before: f32) -> f32 {
    h / pdf.sqrt() + before // [Bekaert 2003, Eq. 7]
}

/// Chance of a candidate to become a trial link, relative to the others of its camera vertex.
fn acceptance(v: &LightVertex) -> f32 {
    1.0 / (v.radius * v.radius * v.hit.n().dot(v.hit.wo).abs()) // [Bekaert 2003, Eq. 10]
}

/// The weight of a merge at z_j: its density over that of all techniques, where `light` and `camera` are the sums of
/// p_i/p_j on either side.
fn merge_weight(light: f32, camera: f32) -> f32 {
    1.0 / (1.0 + light + camera) // [Bekaert 2003, Eq. 9]
}

impl GKernel2003 {
    /// With these settings and options.
    ///
    /// # Errors
    /// [`crate::Error::Mismatch`] for options that are none.
    pub fn new(settings: Settings, options: &Options) -> Result<Self> {
        let light_paths = options.number("light-paths", 0..=50_000_000)? as u32;
        let eye_paths = options.number("eye-paths", 1..=1 << 40)?;
        let links = options.number("links", 1..=1000)? as f32;
        Ok(Self { settings, light_paths, eye_paths, links, view: Mutex::default(), counts: LinkCounts::default() })
    }

    /// What is known of this view; h is calibrated where it is new.
    fn view(&self, shot: &Shot, stop: &AtomicBool) -> Arc<View> {
        let key = (shot.view, shot.seed, shot.size());
        let mut known = self.view.lock().unwrap_or_else(PoisonError::into_inner);
        match &*known {
            Some(view) if view.key == key => view.clone(),
            _ => known.insert(Arc::new(self.calibrate(shot, key, stop))).clone(),
        }
    }

    /// Trial links of every camera vertex, in the order of light vertices, §4.2.
    fn trial_links(
        &self,
        (lights, candidates): (&LightPaths, &Candidates),
        visibility: &[VisibilityEstimate],
        seed: (u64, u64),
    ) -> Vec<Link> {
        let of_vertex = |eye: usize| {
            let own = candidates.of(eye);
            let n = self.links / visibility[eye].share();
            if own.len() as f32 <= n {
                return own.iter().map(|light| Link { light: *light, eye: eye as u32, weight: 1.0 }).collect();
            }
            let strengths: Vec<f32> = own.iter().map(|light| acceptance(&lights.vertices[*light as usize])).collect();
            let u = PathSampler::new(seed.0 ^ 0x6c69_6e6b, seed.1 << 32 | eye as u64, 0).next_1d();
            let mut links = Vec::new();
            let each = |i: usize, weight| links.push(Link { light: own[i], eye: eye as u32, weight });
            footprints::choose(&strengths, n, u, each);
            links
        };
        let mut links: Vec<Link> = (0..visibility.len()).into_par_iter().flat_map_iter(of_vertex).collect();
        links.par_sort_unstable_by_key(|l| (l.light, l.eye));
        links
    }

    /// What a link brings to its camera path; `None` if it is occluded.
    fn score(&self, shot: &Shot, lights: &LightPaths, link: &Link, y: &EyeVertex) -> Option<Rgb> {
        let (world, starts) = (shot.world, shot.world.lights().by_power());
        let (v, p) = (&lights.vertices[link.light as usize], y.hit.point.p);
        let segments = y.segments + v.segments;
        if segments > self.limits().segments {
            return None;
        }
        // The partial score of x_0 … x_{k-1}, y, the shadow ray's other end, and the sum of p_j/p_{k-1} over techniques
        // j < k - 1.
        let (arrival, segment, beyond) = if v.first {
            let start = &lights.starts[v.parent as usize];
            let arrival = Arrival::from_light(world, starts, start, p)?;
            let segment = World::segment(&y.hit.point, arrival.wi, &start.origin);
            (arrival, segment, v.d_vm)
        } else {
            let x = &lights.vertices[v.parent as usize];
            let shading = world.shading(&x.hit);
            let arrival = Arrival::from_surface(world, (&x.hit, &shading), x.throughput, p)?;
            let back = arrival.at_parent.as_ref().map_or(0.0, |s| s.pdf_to_light) * x.back;
            (arrival, y.hit.point.segment_between(&x.hit.point), flag(x.linked) + times(back / x.pdf, x.d_vm))
        };
        let f = scattering(world, &y.hit, &y.shading, arrival.wi, y.hit.wo)?;
        let visible = world.transmittance(&segment, (self.limits().segments - segments).min(MOST_CROSSINGS));
        if visible == Rgb::ZERO {
            return None;
        }
        let cos_y = y.hit.n().dot(arrival.wi).abs();
        let cos_x = v.hit.n().dot(v.hit.wo).abs();
        let light = times(f.pdf_to_light * arrival.onto_parent / (arrival.pdf_across * cos_y), beyond);
        let camera = times(f.pdf_to_camera * y.back / y.pdf, y.d_vm);
        let partial = arrival.value * f.f * cos_y; // [Bekaert 2003, Eq. 8], the partial score
        let kernel = 1.0 / (PI * v.radius * v.radius * cos_x * v.passed); // [Bekaert 2003, Eq. 8], the kernel
        let paths = self.path_count(shot) as f32;
        let factor = kernel * merge_weight(light, camera) * link.weight / (v.survival * paths);
        Some(partial * visible * y.throughput * factor) // [Bekaert 2003, Eq. 8]
    }

    /// One block of tiles in a step: camera paths, candidate links, trial links, scores.
    fn block(
        &self,
        shot: &Shot,
        tiles: &mut [Tile],
        (number, sample): (usize, u64),
        (view, lights, footprints): (&View, &LightPaths, &[Footprint]),
        (aovs, stop): (&[Aov], &AtomicBool),
    ) -> u64 {
        // One set of camera paths for all steps.
        let set = sample % self.eye_paths;
        let mut eyes = self.trace_eyes(shot, tiles, (set, view.kappa), |_| true, stop);
        let tree = footprints::tree(eyes.vertices.iter().map(|y| y.hit.point.p));
        let candidates = Candidates::find(footprints, &tree, eyes.vertices.len());
        let known = || view.visibility.lock().unwrap_or_else(PoisonError::into_inner);
        let new = || vec![VisibilityEstimate::default(); eyes.vertices.len()];
        let mut visibility = known().get(&(number, set)).cloned().unwrap_or_else(new);
        if stop.load(Relaxed) {
            return eyes.rays;
        }
        let links = self.trial_links((lights, &candidates), &visibility, (shot.seed, sample));
        let of_link = |link: &Link| {
            let y = &eyes.vertices[link.eye as usize];
            if stop.load(Relaxed) { None } else { self.score(shot, lights, link, y) }
        };
        let scores: Vec<Option<Rgb>> = links.par_iter().with_min_len(256).map(of_link).collect();
        if stop.load(Relaxed) {
            return eyes.rays;
        }
        for (link, score) in links.iter().zip(&scores) {
            let of_y = &mut visibility[link.eye as usize];
            of_y.tried += 1;
            of_y.unoccluded += u32::from(score.is_some());
            eyes.radiance[eyes.vertices[link.eye as usize].path as usize] += score.unwrap_or(Rgb::ZERO);
        }
        known().insert((number, set), visibility);
        tiles.par_iter_mut().for_each(|t| shot.add_features(t, aovs, set));
        for ((tile, pixel), value) in eyes.pixels.iter().zip(&eyes.radiance) {
            tiles[*tile].add(*pixel, *value);
        }
        tiles.iter_mut().for_each(|tile| tile.samples += 1);
        let unoccluded = scores.iter().flatten().count();
        let counts = [eyes.radiance.len(), eyes.vertices.len(), candidates.len(), links.len(), unoccluded];
        self.counts.add_block(counts);
        eyes.rays + links.len() as u64
    }
}

impl Integrator for GKernel2003 {
    fn check(&self, world: &World) -> Result<()> {
        self.settings.without_media("gkernel-2003", world)
    }

    /// A step, or the rest of one: light paths, then block by block camera paths and links.
    fn pass(&self, shot: &Shot, film: &mut Film, stop: &AtomicBool, late: &(dyn Fn() -> bool + Sync)) -> Option<u64> {
        let view = self.view(shot, stop);
        let first = film.samples().0;
        let step = first / self.eye_paths;
        let lights = self.trace_lights(shot, step, self.path_count(shot), (view.h, view.kappa), stop);
        let linked = (0..).zip(&lights.vertices).filter(|(_, v)| v.linked);
        let all: Vec<_> = linked.map(|(light, v)| Footprint { p: v.hit.point.p, radius: v.radius, light }).collect();
        let footprints = footprints::sorted(&all);
        let aovs = film.aovs().to_vec();
        let tiles_at_once = (BLOCK / (TILE * TILE) as usize).max(1);
        let mut rays = lights.rays;
        for sample in first..(step + 1) * self.eye_paths {
            let block = |(number, tiles): (usize, &mut [Tile])| {
                // After an interruption some blocks are a sample ahead.
                let done = tiles.iter().any(|t| t.samples != sample);
                if done || stop.load(Relaxed) || (sample > 0 && late()) {
                    return 0;
                }
                self.block(shot, tiles, (number, sample), (&view, &lights, &footprints), (&aovs, stop))
            };
            rays += film.tiles.par_chunks_mut(tiles_at_once).enumerate().map(block).sum::<u64>();
        }
        self.counts.add_step(lights.vertices.len());
        Some(rays)
    }

    fn facts(&self) -> Vec<(&'static str, f64)> {
        let view = self.view.lock().unwrap_or_else(PoisonError::into_inner);
        self.counts.facts(view.as_ref().map_or(0.0, |view| view.h), size_of::<LightVertex>())
    }
}
