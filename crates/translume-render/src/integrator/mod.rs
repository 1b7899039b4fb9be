//! The methods of light transport, one file each, and the one table of their names.

mod path;
mod volpath;

use crate::film::{Features, Film};
use crate::{PathSampler, Rgb, World};
use translume_scene::MediumId;
use translume_trace::Ray;

pub use path::Path;
pub use volpath::Volpath;

/// What every method takes from the scene or the user.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Longest path in segments: 1 shows lights only, 2 adds direct light; `None` is unlimited.
    pub max_depth: Option<u32>,
    /// Segments before Russian roulette may end a path.
    pub rr_depth: u32,
    /// Lights are not seen directly by the camera.
    pub hide_emitters: bool,
    /// What the camera stands in.
    pub camera_medium: Option<MediumId>,
}

/// What a thread works with.
pub struct Work {
    /// Random numbers of the sample at hand.
    pub sampler: PathSampler,
    /// Rays traced so far.
    pub rays: u64,
}

/// A method that renders pixels independently of each other.
pub trait Integrator: Send + Sync {
    /// One unbiased estimate of the radiance that arrives along `ray`.
    fn radiance(&self, world: &World, ray: &Ray, work: &mut Work) -> Rgb;
}

/// A row of [`INTEGRATORS`].
pub struct Entry {
    /// As options and scene files call it.
    pub name: &'static str,
    /// One line about it.
    pub about: &'static str,
    make: fn(Settings) -> Box<dyn Integrator>,
}

/// All methods.
pub const INTEGRATORS: [Entry; 2] = [
    Entry {
        name: "path",
        about: "path tracing with emitter sampling; media are not seen",
        make: |settings| Box::new(Path::new(settings)),
    },
    Entry {
        name: "volpath",
        about: "path tracing through participating media",
        make: |settings| Box::new(Volpath::new(settings)),
    },
];

/// The method called `name`.
pub fn by_name(name: &str, settings: Settings) -> Option<Box<dyn Integrator>> {
    INTEGRATORS.iter().find(|e| e.name == name).map(|e| (e.make)(settings))
}

/// What the camera ray meets first, for feature images.
pub(crate) fn features(world: &World, ray: &Ray) -> Option<Features> {
    let hit = world.intersect(ray)?;
    let shading = world.shading(&hit);
    Some(Features {
        albedo: shading.bsdf.albedo(),
        ns: shading.frame.n,
        n: hit.n,
        p: hit.point.p,
        uv: hit.uv(),
        depth: hit.t * ray.d.length(),
    })
}

/// Whether a film wants features at all.
pub(crate) fn wants_features(film: &Film) -> bool {
    film.aovs().iter().any(|a| *a != crate::film::Aov::Variance)
}

/// The most that a scattering at a surface leaves to Russian roulette, so that paths end among mirrors.
pub(crate) const MOST_SURVIVAL: f32 = 0.95;

/// Russian roulette: the chance, at most `most`, that a path of this throughput goes on. Refraction's change of radiance is
/// taken out by `eta`, the product of relative indices so far.
#[inline]
pub(crate) fn survival(throughput: Rgb, eta: f32, most: f32) -> f32 {
    (throughput.max_element() * eta * eta).min(most)
}

/// The power heuristic for one sample of each of two techniques (Veach 1997, exponent 2).
#[inline]
pub(crate) fn power_heuristic(a: f32, b: f32) -> f32 {
    if a.is_infinite() {
        return 1.0;
    }
    let a2 = a * a;
    let sum = a2 + b * b;
    if sum > 0.0 { a2 / sum } else { 0.0 }
}
