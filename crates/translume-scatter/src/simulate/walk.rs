//! A random walk of photons inside a body.
//!
//! Sources: delta tracking (Woodcock et al. 1965) with absorption as weights at null collisions (Galtier et al. 2013, Kutz et al.
//! 2017); at the boundaries the part that leaves is recorded and the reflected part goes on (Wang, Jacques & Zheng 1995, §3.6,
//! in the limit of splitting). Of a flight that may reach the boundary its expected exit is recorded, whether it gets there
//! or not: e^(−μ̄ l) is known in closed form for the majorant μ̄ (the "expected value" estimator of Spanier & Gelbard 1969).
//! Far from the beam few photons arrive; an [`Importance`] splits those that get there and thins out the others (weight
//! windows, Booth & Hendricks 1984), so that all distances have similar relative noise.
//!
//! A rough boundary is a perfect diffuser: what enters and what is reflected from inside goes into the cosine-distributed
//! half-space, with Fresnel's reflectance averaged over it. Specular reflection of the beam at the first boundary is left out: it
//! is no subsurface scattering. Light that leaves does not come back, also where the body is concave.

use super::medium::Medium;
use glam::{Vec2, Vec3};
use translume_bxdf::{Phase, fresnel};
use translume_core::{frame::Frame, rng::Pcg32, warp};

/// What the light walks in.
pub trait Body: Sync {
    /// Where a beam from `origin` along `direction` meets it first.
    fn enter(&self, origin: [f64; 3], direction: Vec3) -> Option<Wall>;

    /// The boundary ahead of a place inside; `None` where rounding has put the place outside.
    fn wall(&self, p: [f64; 3], direction: Vec3) -> Option<Wall>;

    /// A distance from `p` within which there is no boundary, 0 where that is not known.
    fn clearance(&self, p: [f64; 3]) -> f64;
}

/// A place of the boundary.
#[derive(Clone, Copy, Debug)]
pub struct Wall {
    /// Distance along the ray in mm.
    pub distance: f64,
    /// Where.
    pub at: [f64; 3],
    /// Outer normal, of unit length.
    pub normal: Vec3,
    /// Part of the surface, numbered by the body, and coordinates on it.
    pub face: u32,
    /// Barycentric coordinates of the second and third corner, for triangles.
    pub uv: [f32; 2],
}

/// What the boundary does to light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interface {
    /// Index of refraction relative to the outside.
    pub eta: f64,
    /// Diffusing boundary instead of a smooth one.
    pub rough: bool,
    inside: f64,
    outside: f64,
}

impl Interface {
    /// With the averages over diffuse light.
    pub fn new(eta: f64, rough: bool) -> Self {
        let mean = |sign: f32| {
            let n = 2000;
            (0..n)
                .map(|i| {
                    let cos = (i as f32 + 0.5) / n as f32;
                    f64::from(2.0 * cos * fresnel::dielectric(sign * cos, eta as f32).reflectance) / f64::from(n)
                })
                .sum()
        };
        Self { eta, rough, inside: mean(-1.0), outside: mean(1.0) }
    }

    /// Radiance per radiosity M of a place seen under a cosine: F_t(η, ω_o)/(π (1 − F̄)), or 1/π for a rough boundary.
    pub fn radiance(&self, cos: f64) -> f64 {
        let lobe = match self.rough {
            true => 1.0,
            false => {
                f64::from(1.0 - fresnel::dielectric(cos as f32, self.eta as f32).reflectance) / (1.0 - self.outside)
            }
        };
        lobe / std::f64::consts::PI
    }

    /// Reflectance from inside.
    fn reflected(&self, cos: f32) -> f64 {
        match self.rough {
            true => self.inside,
            false => f64::from(fresnel::dielectric(-cos.abs(), self.eta as f32).reflectance),
        }
    }
}

/// Light that left the body.
#[derive(Clone, Copy, Debug)]
pub struct Exit {
    /// Through which place.
    pub wall: Wall,
    /// Power per power of the beam, for each channel.
    pub weight: [f64; 3],
}

/// Wanted weight of a photon by its distance from where the beam entered.
#[derive(Clone, Debug)]
pub struct Importance {
    /// At steps of [`Importance::STEP_MM`], 1 at first.
    wanted: Vec<f64>,
}

impl Importance {
    /// Step of the table.
    pub const STEP_MM: f64 = 0.25;
    /// Most copies that one collision makes.
    const SPLIT: f64 = 12.0;
    /// Most photons that wait; with more of them none is split. In a thin medium light goes far, and each copy would have copies.
    const WAITING: usize = 1000;

    /// The same everywhere: only roulette.
    pub fn flat() -> Self {
        Self { wanted: vec![0.1] }
    }

    /// From a table at steps of 0.25 mm, whose last value goes on.
    pub fn new(wanted: Vec<f64>) -> Self {
        debug_assert!(wanted.iter().all(|w| *w > 0.0));
        Self { wanted }
    }

    fn at(&self, p: [f64; 3], entry: [f64; 3]) -> f64 {
        let d2: f64 = (0..3).map(|i| (p[i] - entry[i]).powi(2)).sum();
        self.wanted[((d2.sqrt() / Self::STEP_MM) as usize).min(self.wanted.len() - 1)]
    }
}

/// What a walk needs to know.
#[derive(Clone, Copy)]
pub struct World<'a, B> {
    /// The shape.
    pub body: &'a B,
    /// Inside it.
    pub medium: &'a Medium,
    /// Its boundary.
    pub interface: &'a Interface,
    /// Where to spend the effort.
    pub importance: &'a Importance,
}

/// Boundaries that are more than this optical depth ahead get an exit only from flights that reach them.
const AHEAD: f64 = 3.0;

#[derive(Clone, Copy)]
struct Photon {
    p: [f64; 3],
    direction: Vec3,
    weight: [f64; 3],
}

impl<B: Body> World<'_, B> {
    /// Follows one photon of a beam from `origin` along `direction`, with all its copies, and tells `record` all that leaves.
    pub fn shine(&self, origin: [f64; 3], direction: Vec3, rng: &mut Pcg32, record: &mut impl FnMut(Exit)) {
        let Some(entry) = self.body.enter(origin, direction) else { return };
        let at_wall = fresnel::dielectric(-direction.dot(entry.normal), self.interface.eta as f32);
        let inward = match self.interface.rough {
            true => cosine(-entry.normal, rng),
            false => fresnel::refract(-direction, entry.normal, &at_wall),
        };
        let weight = [f64::from(1.0 - at_wall.reflectance); 3];
        let mut waiting = vec![Photon { p: entry.at, direction: inward, weight }];
        while let Some(photon) = waiting.pop() {
            self.walk(photon, entry.at, rng, &mut waiting, record);
        }
    }

    fn walk(
        &self,
        mut photon: Photon,
        entry: [f64; 3],
        rng: &mut Pcg32,
        waiting: &mut Vec<Photon>,
        record: &mut impl FnMut(Exit),
    ) {
        let majorant = self.medium.majorant;
        // The boundary ahead, as long as the direction does not change.
        let mut ahead: Option<Wall> = None;
        loop {
            let length = -(1.0 - rng.next_f64()).ln() / majorant;
            let clear = ahead.is_none() && self.body.clearance(photon.p) > length.max(AHEAD / majorant);
            if !clear {
                let Some(wall) = ahead.or_else(|| self.body.wall(photon.p, photon.direction)) else { return };
                let reflected = self.interface.reflected(wall.normal.dot(photon.direction));
                let depth = majorant * wall.distance;
                let reaches = length >= wall.distance;
                if depth < AHEAD || reaches {
                    let share = (1.0 - reflected) * if depth < AHEAD { (-depth).exp() } else { 1.0 };
                    if share > 0.0 {
                        record(Exit { wall, weight: photon.weight.map(|w| w * share) });
                    }
                }
                if reaches {
                    photon.p = wall.at;
                    photon.weight = photon.weight.map(|w| w * reflected);
                    photon.direction = match self.interface.rough {
                        true => cosine(-wall.normal, rng),
                        false => photon.direction - 2.0 * photon.direction.dot(wall.normal) * wall.normal,
                    };
                    ahead = None;
                    if !self.window(&mut photon, entry, rng, waiting) {
                        return;
                    }
                    continue;
                }
                ahead = Some(Wall { distance: wall.distance - length, ..wall });
            }
            advance(&mut photon.p, photon.direction, length);
            let local = self.medium.at(photon.p);
            let scattering = f64::from(local.sigma_s);
            if rng.next_f64() * majorant < scattering {
                let phase = Phase::HenyeyGreenstein { g: local.g };
                photon.direction = phase.sample(-photon.direction, Vec2::new(rng.next_f32(), rng.next_f32()));
                ahead = None;
            } else {
                let others = majorant - scattering;
                for (w, a) in photon.weight.iter_mut().zip(local.sigma_a) {
                    *w *= (others - f64::from(a)) / others;
                }
            }
            if !self.window(&mut photon, entry, rng, waiting) {
                return;
            }
        }
    }

    /// Splits a photon that is too heavy for where it is, the copies wait; roulette for one that is too light.
    fn window(&self, photon: &mut Photon, entry: [f64; 3], rng: &mut Pcg32, waiting: &mut Vec<Photon>) -> bool {
        let most = photon.weight.iter().copied().fold(0.0, f64::max);
        let wanted = self.importance.at(photon.p, entry);
        let room = waiting.len() < Importance::WAITING && self.importance.wanted.len() > 1;
        if most > 2.0 * wanted && room {
            let copies = (most / wanted).min(Importance::SPLIT).floor();
            photon.weight = photon.weight.map(|w| w / copies);
            waiting.extend(std::iter::repeat_n(*photon, copies as usize - 1));
        } else if most < 0.5 * wanted {
            if rng.next_f64() * wanted >= most {
                return false;
            }
            photon.weight = photon.weight.map(|w| w * wanted / most);
        }
        true
    }
}

fn cosine(normal: Vec3, rng: &mut Pcg32) -> Vec3 {
    Frame::from_normal(normal).to_world(warp::cosine_hemisphere(rng.next_f32(), rng.next_f32()))
}

fn advance(p: &mut [f64; 3], d: Vec3, length: f64) {
    p[0] += length * f64::from(d.x);
    p[1] += length * f64::from(d.y);
    p[2] += length * f64::from(d.z);
}
