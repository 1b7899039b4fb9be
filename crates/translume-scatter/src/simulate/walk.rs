//! A random walk of photons through a slab.
//!
//! Sources: delta tracking (Woodcock et al. 1965) with absorption as weights at null collisions (Galtier et al. 2013, Kutz et al.
//! 2017); at the boundaries the part that leaves is recorded and the reflected part goes on (Wang, Jacques & Zheng 1995, §3.6,
//! in the limit of splitting). The slab is infinite to the sides. A rough boundary is a perfect diffuser: what enters and what is
//! reflected from inside goes into the cosine-distributed half-space, with Fresnel's reflectance averaged over it. Specular
//! reflection of the beam at the first boundary is left out: it is no subsurface scattering.

use super::medium::Medium;
use glam::{Vec2, Vec3};
use translume_bxdf::{Phase, fresnel};
use translume_core::{rng::Pcg32, warp};

/// The walls of the slab.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slab {
    /// Depth of the lower boundary in mm; `INFINITY` for a half-space.
    pub thickness_mm: f64,
    /// Index of refraction relative to the outside.
    pub eta: f64,
    /// Diffusing boundaries instead of smooth ones.
    pub rough: bool,
}

/// Light that left the slab.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exit {
    /// Where, in mm.
    pub at: [f64; 2],
    /// Through the lit side, or the other one.
    pub top: bool,
    /// Power per power of the beam, for each channel.
    pub weight: [f64; 3],
}

/// Below this weight a photon plays Russian roulette.
const ROULETTE: f64 = 0.05;

/// Fractions that the boundary reflects, averaged over diffuse light.
pub(crate) struct Averages {
    outside: f64,
    inside: f64,
}

impl Averages {
    pub(crate) fn new(eta: f64) -> Self {
        let mean = |sign: f32, eta: f64| {
            let n = 2000;
            (0..n)
                .map(|i| {
                    let cos = (i as f32 + 0.5) / n as f32;
                    f64::from(2.0 * cos * fresnel::dielectric(sign * cos, eta as f32).reflectance) / f64::from(n)
                })
                .sum()
        };
        Self { outside: mean(1.0, eta), inside: mean(-1.0, eta) }
    }

    /// What of diffuse light enters or leaves at the outside.
    pub(crate) fn transmitted_outside(&self) -> f64 {
        1.0 - self.outside
    }
}

/// Follows one photon of a beam that enters at `start` mm with the direction `wi` (z up, so downwards it is negative), and
/// tells `record` all that leaves.
pub(crate) fn photon(
    medium: &Medium,
    slab: &Slab,
    averages: &Averages,
    (start, wi): ([f64; 2], Vec3),
    rng: &mut Pcg32,
    record: &mut impl FnMut(Exit),
) {
    let entry = fresnel::dielectric(-wi.z, slab.eta as f32);
    // Depth grows downwards, so z of directions inside is the negative of the world's.
    let mut direction = match slab.rough {
        true => warp::cosine_hemisphere(rng.next_f32(), rng.next_f32()),
        false => flip(fresnel::refract(-wi, Vec3::Z, &entry)),
    };
    let mut weight = [f64::from(1.0 - entry.reflectance); 3];
    let mut p = [start[0], start[1], 0.0];
    let step = 1.0 / medium.majorant;
    loop {
        let length = -(1.0 - rng.next_f64()).ln() * step;
        let z = f64::from(direction.z);
        let wall = match z < 0.0 {
            true => -p[2] / z,
            false => (slab.thickness_mm - p[2]) / z.max(1e-12),
        };
        if length >= wall {
            advance(&mut p, direction, wall);
            let top = z < 0.0;
            p[2] = if top { 0.0 } else { slab.thickness_mm };
            let reflected = match slab.rough {
                true => averages.inside,
                false => f64::from(fresnel::dielectric(-direction.z.abs(), slab.eta as f32).reflectance),
            };
            record(Exit { at: [p[0], p[1]], top, weight: weight.map(|w| w * (1.0 - reflected)) });
            weight = weight.map(|w| w * reflected);
            direction = match slab.rough {
                true => {
                    warp::cosine_hemisphere(rng.next_f32(), rng.next_f32())
                        * Vec3::new(1.0, 1.0, if top { 1.0 } else { -1.0 })
                }
                false => flip(direction),
            };
        } else {
            advance(&mut p, direction, length);
            let local = medium.at(p);
            let scattering = f64::from(local.sigma_s);
            if rng.next_f64() * medium.majorant < scattering {
                let phase = Phase::HenyeyGreenstein { g: local.g };
                direction = phase.sample(-direction, Vec2::new(rng.next_f32(), rng.next_f32()));
            } else {
                let others = medium.majorant - scattering;
                for (w, a) in weight.iter_mut().zip(local.sigma_a) {
                    *w *= (others - f64::from(a)) / others;
                }
            }
        }
        let most = weight.iter().copied().fold(0.0, f64::max);
        if most < ROULETTE {
            if rng.next_f64() * ROULETTE >= most {
                return;
            }
            weight = weight.map(|w| w * ROULETTE / most);
        }
    }
}

fn flip(d: Vec3) -> Vec3 {
    Vec3::new(d.x, d.y, -d.z)
}

fn advance(p: &mut [f64; 3], d: Vec3, length: f64) {
    p[0] += length * f64::from(d.x);
    p[1] += length * f64::from(d.y);
    p[2] += length * f64::from(d.z);
}

/// Follows `photons` photons of a pencil beam at the origin and perpendicular to the slab, in fixed portions on all threads;
/// `add` gets each exit into a portion's tally, `merge` joins two of them in their order.
pub fn pencil_beam<T: Send>(
    (medium, slab): (&Medium, &Slab),
    (photons, seed): (usize, u64),
    empty: impl Fn() -> T + Sync,
    add: impl Fn(&mut T, Exit) + Sync,
    merge: impl Fn(T, T) -> T,
) -> T {
    use rayon::prelude::*;
    const PORTION: usize = 4096;
    let averages = Averages::new(slab.eta);
    let portion = |i: usize| {
        let mut rng = Pcg32::new(seed, i as u64);
        let mut tally = empty();
        for _ in 0..PORTION.min(photons - i * PORTION) {
            photon(medium, slab, &averages, ([0.0; 2], -Vec3::Z), &mut rng, &mut |exit| add(&mut tally, exit));
        }
        tally
    };
    let tallies: Vec<T> = (0..photons.div_ceil(PORTION)).into_par_iter().map(portion).collect();
    tallies.into_iter().fold(empty(), merge)
}
