//! What is found out about a view: h, and which part of the trial links of each camera vertex is unoccluded.
//!
//! Source: Bekaert et al. 2003, §5 (Auto-calibration).

use super::super::footprints;
use super::walks::LightVertex;
use super::{GKernel2003, footprint_radius};
use crate::film::Film;
use crate::render::Shot;
use crate::subpath::Limits;
use rayon::prelude::*;
use std::collections::HashMap;
use std::f32::consts::PI;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

/// What is known of a view.
pub(super) struct View {
    /// Its number, seed and size.
    pub(super) key: (u32, u64, [u32; 2]),
    pub(super) h: f32,
    /// Expected merges in a footprint of typical area, per density of light paths: weighs camera paths that meet a
    /// light.
    pub(super) kappa: f32,
    /// Of each camera vertex, by block of tiles and camera path of a pixel.
    pub(super) visibility: Mutex<HashMap<(usize, u64), Vec<VisibilityEstimate>>>,
}

/// P_vis(y): trial links so far, and those that were unoccluded. Before the first, half of them are taken to be.
#[derive(Clone, Copy, Default)]
pub(super) struct VisibilityEstimate {
    pub(super) tried: u32,
    pub(super) unoccluded: u32,
}

impl VisibilityEstimate {
    /// P_vis(y).
    pub(super) fn share(self) -> f32 {
        ((self.unoccluded + 1) as f32 / (self.tried + 2) as f32).max(MIN_VISIBILITY)
    }
}

/// P_vis is taken to be no less, so that dark corners do not ask for all there is.
const MIN_VISIBILITY: f32 = 0.125;

/// A starting guess of h, and how often it is improved.
const FIRST_H: f32 = 0.01;
const ROUNDS: usize = 8;

/// Pixels for each camera path that calibrates h, and the step whose random numbers its light paths have.
const SPARSE: usize = 16;
const CALIBRATION: u64 = 1 << 30;

impl GKernel2003 {
    /// How far camera paths go.
    pub(super) fn limits(&self) -> Limits {
        Limits { segments: self.settings.most_segments(), rr_depth: self.settings.rr_depth }
    }

    /// Light paths of a step.
    pub(super) fn path_count(&self, shot: &Shot) -> u32 {
        let [w, h] = shot.size();
        if self.light_paths > 0 { self.light_paths } else { (w * h / 2).clamp(5_000, 1_000_000) }
    }

    /// Finds h so that M footprints of direct light hold a camera vertex in the mean, §5.
    pub(super) fn calibrate(&self, shot: &Shot, key: (u32, u64, [u32; 2]), stop: &AtomicBool) -> View {
        let (mut h, count) = (FIRST_H, self.path_count(shot));
        let mut view = View { key, h, kappa: 0.0, visibility: Mutex::default() };
        // Only for its tiles.
        let Ok(Film { tiles, .. }) = shot.film(&[]) else { return view };
        let eyes = self.trace_eyes(shot, &tiles, (0, 0.0), |i| i % SPARSE == 5, stop).vertices;
        let tree = footprints::tree(eyes.iter().map(|y| y.hit.point.p));
        let lights = self.trace_lights(shot, CALIBRATION, count, (h, 0.0), stop);
        let direct: Vec<&LightVertex> = lights.vertices.iter().filter(|v| v.first).collect();
        for _ in 0..ROUNDS {
            let overlaps = |v: &&LightVertex| {
                let mut n = 0_usize;
                tree.within(v.hit.point.p, footprint_radius(h, v.pdf, 0.0), |_| n += 1);
                n
            };
            let mean = direct.par_iter().map(overlaps).sum::<usize>() as f32 / eyes.len().max(1) as f32;
            if (mean / self.links - 1.0).abs() < 0.1 {
                break;
            }
            // Overlaps go as h² (errata: not as h).
            h *= (self.links / mean.max(0.05 * self.links)).sqrt();
        }
        let mut areas: Vec<f32> = direct.iter().map(|v| 1.0 / v.pdf).collect();
        areas.sort_unstable_by(f32::total_cmp);
        (view.h, view.kappa) = (h, PI * h * h * count as f32 * areas.get(areas.len() / 2).copied().unwrap_or(1.0));
        view
    }
}
