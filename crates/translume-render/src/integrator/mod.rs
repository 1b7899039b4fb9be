//! The methods of light transport, one file each, and the one table of their names.

mod bdpt;
mod path;
mod volpath;

use crate::camera::Camera;
use crate::film::{Features, Film};
use crate::splat::Splat;
use crate::tally::Tally;
use crate::{PathSampler, Result, Rgb, World};
use translume_scene::MediumId;
use translume_trace::Ray;

pub use bdpt::Bdpt;
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
pub struct Work<'a> {
    /// Random numbers of the sample at hand.
    pub sampler: PathSampler,
    /// Rays traced so far.
    pub rays: u64,
    /// The picture.
    pub view: View<'a>,
    /// Light that the sample's light path brings to the film, for methods that splat.
    pub splats: Vec<Splat>,
    /// Counts, for methods that tell of their parts.
    pub tally: Tally,
}

/// The picture that is taken.
#[derive(Clone, Copy)]
pub struct View<'a> {
    /// By which camera.
    pub camera: &'a Camera,
    /// Pixels beyond the border of the film whose light counts.
    pub margin: f32,
    /// Pixels of the part that is rendered: light paths per sample of a pixel.
    pub pixels: f32,
}

/// A method of rendering: called once per sample of each pixel.
pub trait Integrator: Send + Sync {
    /// One estimate of the radiance that arrives along `ray`; what reaches other pixels goes to [`Work::splats`].
    fn radiance(&self, world: &World, ray: &Ray, work: &mut Work) -> Rgb;

    /// Whether the method splats: the film must be [`Film::with_splats`].
    fn splats(&self) -> bool {
        false
    }

    /// Whether the method can render this scene; to be asked before the first sample.
    ///
    /// # Errors
    /// [`crate::Error::Scene`].
    fn check(&self, _world: &World) -> Result<()> {
        Ok(())
    }

    /// Called when a render begins, before the first sample: what is computed once for a picture.
    fn prepare(&self, _world: &World, _seed: u64) {}

    /// Names of the parts that [`Work::tally`] counts: of the number `part`.
    fn part(&self, part: usize) -> String {
        part.to_string()
    }

    /// Numbers about the work that was done once, with their names.
    fn facts(&self) -> Vec<(&'static str, u64)> {
        Vec::new()
    }
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
pub const INTEGRATORS: [Entry; 3] = [
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
    Entry {
        name: "bdpt",
        about: "bidirectional path tracing; no media",
        make: |settings| Box::new(Bdpt::new(settings)),
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

/// Russian roulette: the chance that a path of this throughput goes on. Refraction's change of radiance is taken out by
/// `eta`, the product of relative indices so far.
#[inline]
pub(crate) fn survival(throughput: Rgb, eta: f32) -> f32 {
    (throughput.max_element() * eta * eta).min(0.95)
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
