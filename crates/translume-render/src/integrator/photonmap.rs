//! Photon mapping: light is traced once, stored, and its density estimated from the nearest photons.
//!
//! Source: Jensen 2001, "Realistic Image Synthesis Using Photon Mapping". A camera's path is followed through mirrors, glass
//! and surfaces that are glossy alone, as `path` does it, to the first one with a diffuse lobe. There
//!
//! - direct light is sampled (`direct=sample`, where gathering adds the directions of the BSDF by multiple importance
//!   sampling) or is in the map (`direct=map`, without gathering: everything is seen in the map, as in the left picture of
//!   [Bekaert 2003, Fig. 1]);
//! - caustics, light that came through mirrors and glass alone, are estimated from a map of their own;
//! - the rest is gathered (`gather=true`): one direction of the BSDF is followed to the next diffuse surface, where direct
//!   light is sampled and everything else estimated; or it is estimated at once.
//!
//! An estimate sums f · power over the nearest `neighbours` photons and divides by π r², r the distance of the farthest, which
//! itself is left out (it would bias the mean by 1/(k − 1)). Photons far from the tangent plane are left out, and none is
//! sought beyond a twentieth of the scene's radius.
//!
//! The method is biased: it blurs what it estimates, and more samples do not sharpen it; more photons do. Limit: no
//! participating media.

use super::direct::{Direct, Origin};
use super::{Integrator, Options, Settings, Work};
use crate::photons::{Photon, PhotonMap};
use crate::subpath::{self, Limits};
use crate::world::{Shading, SurfaceHit, World};
use crate::{Error, PathSampler, Result, Rgb};
use rayon::prelude::*;
use std::f32::consts::PI;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use translume_bxdf::{Flags, Mode};
use translume_core::sampler::Sampler;
use translume_trace::Ray;

/// See the module.
pub struct PhotonMapping {
    settings: Settings,
    paths: u64,
    neighbours: usize,
    gather: bool,
    direct_in_map: bool,
    maps: OnceLock<Maps>,
}

struct Maps {
    /// What came through mirrors and glass alone; empty where all is in one map.
    caustic: PhotonMap,
    /// Everything else (direct light only if it is in the map).
    indirect: PhotonMap,
}

/// Light paths traced by one task.
const CHUNK: u64 = 4096;

/// Farthest photon, in radii of the scene.
const REACH: f32 = 0.05;

/// Height above the tangent plane, in distances, up to which photons count.
const FLAT: f32 = 0.3;

const EMITTED: usize = 0;
const DIRECT: usize = 1;
const CAUSTIC: usize = 2;
const INDIRECT: usize = 3;

impl PhotonMapping {
    /// The options: their names and defaults are in [`super::INTEGRATORS`].
    ///
    /// # Errors
    /// [`Error::Mismatch`] for values that are none.
    pub fn new(settings: Settings, options: &Options) -> Result<Self> {
        let gather = options.switch("gather")?;
        let direct_in_map = options.choice("direct", ["sample", "map"])? == 1;
        if gather && direct_in_map {
            return Err(Error::Mismatch("direct=map goes with gather=false only".into()));
        }
        Ok(Self {
            settings,
            paths: options.number("photons", 1..=1 << 32)?,
            neighbours: options.number("neighbours", 2..=100_000)? as usize,
            gather,
            direct_in_map,
            maps: OnceLock::new(),
        })
    }

    fn trace(&self, world: &World, seed: u64, stop: &AtomicBool) -> Maps {
        let limits =
            Limits { segments: self.settings.most_segments().saturating_sub(1), rr_depth: self.settings.rr_depth };
        let chunk = |number: u64| {
            let (mut vertices, mut photons) = (Vec::new(), [Vec::new(), Vec::new()]);
            for i in number * CHUNK..((number + 1) * CHUNK).min(self.paths) {
                if stop.load(Ordering::Relaxed) {
                    break;
                }
                let mut sampler = PathSampler::new(seed, u64::MAX, i);
                vertices.clear();
                subpath::light_path(world, world.lights().by_power(), limits, &mut sampler, &mut 0, &mut vertices);
                for v in &vertices {
                    let direct = v.parent == subpath::NONE;
                    if !world.shading(&v.hit).flags().contains(Flags::DIFFUSE) || direct && !self.direct_in_map {
                        continue;
                    }
                    let mut before = v;
                    let mut caustic = !direct && !self.direct_in_map;
                    while let Some(parent) = vertices.get(before.parent as usize) {
                        caustic &= parent.delta;
                        before = parent;
                    }
                    let power = v.throughput / self.paths as f32;
                    let photon = Photon { p: v.hit.point.p, wi: v.hit.wo, power, segments: v.segments };
                    photons[usize::from(!caustic)].push(photon);
                }
            }
            photons
        };
        let chunks: Vec<_> = (0..self.paths.div_ceil(CHUNK)).into_par_iter().map(chunk).collect();
        let mut all = [Vec::new(), Vec::new()];
        for chunk in chunks {
            all.iter_mut().zip(chunk).for_each(|(all, part)| all.extend(part));
        }
        let [caustic, indirect] = all.map(PhotonMap::new);
        Maps { caustic, indirect }
    }

    /// Radiance towards `hit.wo` of the light in `map`, from photons that came by no more than `segments` segments.
    fn estimate(&self, world: &World, map: &PhotonMap, hit: &SurfaceHit, shading: &Shading, segments: u32) -> Rgb {
        let (p, reach) = (hit.point.p, REACH * world.bounding_sphere().1);
        let (mut sum, mut last, mut found, mut farthest2) = (Rgb::ZERO, Rgb::ZERO, 0, 0.0);
        let wanted = |photon: &Photon| {
            let way = photon.p - p;
            photon.segments <= segments && way.dot(hit.n()).abs() <= FLAT * way.length() + 1e-4 * reach
        };
        map.nearest(p, self.neighbours, reach, wanted, |photon, d2| {
            let (f_cos, _) = shading.eval_cos_pdf(hit.wo, photon.wi, Mode::Radiance);
            let cos = hit.n().dot(photon.wi).abs();
            last = if cos > 0.0 { f_cos / cos * photon.power } else { Rgb::ZERO };
            sum += last;
            (found, farthest2) = (found + 1, d2);
        });
        match found == self.neighbours {
            // [Bekaert 2003, Eq. 3], by the nearest neighbours.
            true if farthest2 > 0.0 => (sum - last).max(Rgb::ZERO) / (PI * farthest2),
            true => Rgb::ZERO,
            false => sum / (PI * reach * reach),
        }
    }
}

impl Integrator for PhotonMapping {
    fn check(&self, world: &World) -> Result<()> {
        self.settings.without_media("photonmap", world)
    }

    fn prepare(&self, world: &World, seed: u64, stop: &AtomicBool) {
        self.maps.get_or_init(|| self.trace(world, seed, stop));
    }

    fn part(&self, part: usize) -> String {
        ["emitted", "direct", "caustic", "indirect"][part].into()
    }

    fn facts(&self) -> Vec<(&'static str, f64)> {
        let maps = self.maps.get();
        let count = |f: fn(&Maps) -> usize| maps.map_or(0.0, |m| f(m) as f64);
        vec![
            ("light_paths", self.paths as f64),
            ("caustic_photons", count(|m| m.caustic.len())),
            ("photons", count(|m| m.caustic.len() + m.indirect.len())),
        ]
    }

    fn radiance(&self, world: &World, ray: &Ray, work: &mut Work) -> Rgb {
        let maps = self.maps.get_or_init(|| self.trace(world, 0, work.stop));
        let (mut radiance, mut throughput, mut eta, mut ray) = (Rgb::ZERO, Rgb::ONE, 1.0, *ray);
        let mut origin = Origin::camera(ray.o);
        // A diffuse surface was left to gather; the last direction with a density was drawn at one; since then there were only
        // mirrors and glass, so that a light behind is in the caustic map there.
        let (mut gathered, mut from_diffuse, mut in_caustics) = (false, false, false);
        for segments in 1..=self.settings.most_segments() {
            work.rays += 1;
            let hidden = segments == 1 && self.settings.hide_emitters;
            let found = if hidden { world.intersect_behind_lights(&ray) } else { world.intersect(&ray) };
            if !(in_caustics || hidden && found.is_none()) {
                let value = throughput * origin.emitted(world, found.as_ref(), ray.d);
                work.tally.add(EMITTED, value);
                radiance += value;
            }
            let Some(hit) = found else { break };
            if segments == self.settings.most_segments() {
                break;
            }
            let shading = world.shading(&hit);
            let n = world.receiving_normal(&hit, &shading);
            let diffuse = shading.flags().contains(Flags::DIFFUSE);
            let last = diffuse && (gathered || !self.gather);
            if shading.flags().has_smooth() && !(diffuse && self.direct_in_map) {
                let direct = Direct { n, crossings: self.settings.most_segments() - segments - 1, weighed: !last };
                let value = throughput * direct.sample(world, &hit, &shading, work);
                work.tally.add(DIRECT, value);
                radiance += value;
            }
            if diffuse {
                let mut add = |part: usize, map: &PhotonMap| {
                    let value = throughput
                        * self.estimate(world, map, &hit, &shading, self.settings.most_segments() - segments);
                    work.tally.add(part, value);
                    radiance += value;
                };
                add(CAUSTIC, &maps.caustic);
                if last {
                    add(INDIRECT, &maps.indirect);
                }
            }
            let (u_lobe, u) = (work.sampler.next_1d(), work.sampler.next_2d());
            let Some(sample) = shading.sample(hit.wo, u_lobe, u, Mode::Radiance) else { break };
            throughput *= sample.weight;
            eta *= sample.eta;
            if throughput.max_element() <= 0.0 {
                break;
            }
            ray = hit.point.spawn(sample.wi);
            if !sample.flags.contains(Flags::NULL) {
                let delta = sample.flags.contains(Flags::DELTA);
                if last && !delta {
                    break;
                }
                if delta {
                    in_caustics = from_diffuse;
                } else {
                    (gathered, from_diffuse, in_caustics) = (gathered || diffuse, diffuse, false);
                }
                origin = Origin { p: hit.point.p, n, pdf_w: if delta { f32::INFINITY } else { sample.pdf_w } };
            }
            if !self.settings.goes_on(segments, &mut throughput, eta, &mut work.sampler) {
                break;
            }
        }
        radiance
    }
}
