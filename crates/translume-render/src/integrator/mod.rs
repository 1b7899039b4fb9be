//! The methods of light transport, one file each, and the one table of their names.

mod arrival;
mod bdpt;
mod direct;
mod footprints;
pub mod gkernel;
pub mod gkernel_2003;
mod link_counts;
mod nearest;
mod path;
mod photonmap;
mod volpath;

use crate::camera::Camera;
use crate::film::{Features, Film};
use crate::render::Shot;
use crate::splat::Splat;
use crate::subpath::MOST_SEGMENTS;
use crate::tally::Tally;
use crate::{Error, PathSampler, Result, Rgb, World};
use std::ops::RangeInclusive;
use std::sync::atomic::{AtomicBool, Ordering};
use translume_core::sampler::Sampler;
use translume_scene::{MediumId, Scene};
use translume_trace::Ray;

pub use bdpt::Bdpt;
pub use gkernel::GKernel;
pub use gkernel_2003::GKernel2003;
pub use nearest::{Likeness, Nearest, nearest};
pub use path::Path;
pub use photonmap::PhotonMapping;
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

impl Settings {
    /// What the scene asks for, seen by its first camera.
    pub fn of(scene: &Scene) -> Self {
        let wanted = &scene.integrator;
        Self {
            max_depth: wanted.max_depth,
            rr_depth: wanted.rr_depth,
            hide_emitters: wanted.hide_emitters,
            camera_medium: scene.sensors.first().and_then(|s| s.medium),
        }
    }

    /// Longest path of methods that keep its vertices.
    pub(crate) fn most_segments(&self) -> u32 {
        self.max_depth.unwrap_or(MOST_SEGMENTS).min(MOST_SEGMENTS)
    }

    /// Russian roulette on a path of `segments` segments; whether it goes on. Arguments as for [`survival`].
    #[inline]
    pub(crate) fn goes_on(&self, segments: u32, throughput: &mut Rgb, eta: f32, sampler: &mut impl Sampler) -> bool {
        if segments < self.rr_depth {
            return true;
        }
        let survival = survival(*throughput, eta, MOST_SURVIVAL);
        let survives = sampler.next_1d() < survival;
        if survives {
            *throughput /= survival;
        }
        survives
    }

    /// Refuses scenes with media or translucent surfaces for `method`, which knows none.
    pub(crate) fn without_media(&self, method: &str, world: &World) -> Result<()> {
        if world.has_subsurface() {
            return Err(Error::Scene(format!(
                "`{method}` knows no translucent surfaces: render this scene with `path` or `volpath`"
            )));
        }
        match world.has_media() || self.camera_medium.is_some() {
            true => {
                Err(Error::Scene(format!("`{method}` knows no participating media: render this scene with `volpath`")))
            }
            false => Ok(()),
        }
    }
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
    /// Someone wants the render to end.
    pub stop: &'a AtomicBool,
}

impl Work<'_> {
    /// Whether long walks should end where they are: what a sample brings is thrown away then.
    #[inline]
    pub fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
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
    fn radiance(&self, _world: &World, _ray: &Ray, _work: &mut Work) -> Rgb {
        Rgb::ZERO
    }

    /// For methods that work on the whole picture at once, which have no [`Integrator::radiance`]: adds a sample to every
    /// pixel, as far as neither `stop` nor `late` ends it (which leaves the first sample alone), and returns the rays.
    fn pass(
        &self,
        _shot: &Shot,
        _film: &mut Film,
        _stop: &AtomicBool,
        _late: &(dyn Fn() -> bool + Sync),
    ) -> Option<u64> {
        None
    }

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

    /// Called when a render begins, before the first sample: what is computed once for a picture. After `stop` no sample is asked for.
    fn prepare(&self, _world: &World, _seed: u64, _stop: &AtomicBool) {}

    /// Called before the first of several views of one scene: what serves all of them may be kept.
    fn prepare_views(&self, _shots: &[Shot], _stop: &AtomicBool) {}

    /// Names of the parts that [`Work::tally`] counts: of the number `part`.
    fn part(&self, part: usize) -> String {
        part.to_string()
    }

    /// Numbers about the work that was done once, with their names.
    fn facts(&self) -> Vec<(&'static str, f64)> {
        Vec::new()
    }
}

/// An option of a method.
#[derive(Clone, Copy, Debug)]
pub struct Choice {
    /// Its name.
    pub name: &'static str,
    /// Its value when nothing is said.
    pub default: &'static str,
    /// One line about it.
    pub about: &'static str,
}

/// Values of a method's options.
pub struct Options<'a> {
    method: &'static str,
    known: &'static [Choice],
    given: &'a [(String, String)],
}

impl Options<'_> {
    /// The value of an option of the method's table; the last one given counts.
    fn value(&self, name: &str) -> &str {
        let given = self.given.iter().rev().find(|g| g.0 == name).map(|g| g.1.as_str());
        given.or(self.known.iter().find(|k| k.name == name).map(|k| k.default)).unwrap_or_default()
    }

    fn wrong<T>(&self, name: &str, wanted: &str) -> Result<T> {
        let (method, value) = (self.method, self.value(name));
        Err(Error::Mismatch(format!("option {name}={value} of {method}: {wanted} is wanted")))
    }

    fn number(&self, name: &str, range: RangeInclusive<u64>) -> Result<u64> {
        match self.value(name).parse() {
            Ok(n) if range.contains(&n) => Ok(n),
            _ => self.wrong(name, &format!("a whole number from {} to {}", range.start(), range.end())),
        }
    }

    fn choice<const N: usize>(&self, name: &str, of: [&str; N]) -> Result<usize> {
        match of.iter().position(|o| *o == self.value(name)) {
            Some(i) => Ok(i),
            None => self.wrong(name, &of.join(" or ")),
        }
    }

    fn switch(&self, name: &str) -> Result<bool> {
        Ok(self.choice(name, ["false", "true"])? == 1)
    }
}

/// A row of [`INTEGRATORS`].
pub struct Entry {
    /// As options and scene files call it.
    pub name: &'static str,
    /// One line about it.
    pub about: &'static str,
    /// Its options.
    pub options: &'static [Choice],
    /// Options that it had, and what became of them.
    pub removed: &'static [(&'static [&'static str], &'static str)],
    make: fn(Settings, &Options) -> Result<Box<dyn Integrator>>,
}

/// All methods.
pub const INTEGRATORS: [Entry; 6] = [
    Entry {
        name: "path",
        about: "path tracing with emitter sampling; media are not seen",
        options: &[],
        removed: &[],
        make: |settings, _| Ok(Box::new(Path::new(settings))),
    },
    Entry {
        name: "volpath",
        about: "path tracing through participating media",
        options: &[],
        removed: &[],
        make: |settings, _| Ok(Box::new(Volpath::new(settings))),
    },
    Entry {
        name: "bdpt",
        about: "bidirectional path tracing; no media",
        options: &[],
        removed: &[],
        make: |settings, _| Ok(Box::new(Bdpt::new(settings))),
    },
    Entry {
        name: "photonmap",
        about: "photon mapping (biased); no media",
        options: &[
            Choice { name: "photons", default: "500000", about: "light paths that are traced" },
            Choice { name: "neighbours", default: "50", about: "nearest photons of an estimate" },
            Choice { name: "gather", default: "true", about: "follow one more direction before estimating" },
            Choice { name: "direct", default: "sample", about: "direct light: `sample`, or `map` with gather=false" },
        ],
        removed: &[],
        make: |settings, options| Ok(Box::new(PhotonMapping::new(settings, options)?)),
    },
    Entry {
        name: "gkernel",
        about: "the generalized kernel method, for many lights (nearly unbiased); no media",
        options: &gkernel::OPTIONS,
        removed: &gkernel::REMOVED,
        make: |settings, options| Ok(Box::new(GKernel::new(settings, options)?)),
    },
    Entry {
        name: "gkernel-2003",
        about: "the generalized kernel method as Bekaert et al. published it in 2003 (biased); no media",
        options: &gkernel_2003::OPTIONS,
        removed: &[],
        make: |settings, options| Ok(Box::new(GKernel2003::new(settings, options)?)),
    },
];

/// The method called `name`, with its options as they are when nothing is said.
pub fn by_name(name: &str, settings: Settings) -> Option<Box<dyn Integrator>> {
    with_options(name, settings, &[]).ok()
}

/// The method called `name`, with `options` by their names.
///
/// # Errors
/// [`Error::Mismatch`] for names that are not known and values that are none.
pub fn with_options(name: &str, settings: Settings, options: &[(String, String)]) -> Result<Box<dyn Integrator>> {
    let entry = INTEGRATORS.iter().find(|e| e.name == name);
    let entry = entry.ok_or_else(|| Error::Mismatch(format!("there is no method `{name}`")))?;
    if let Some((unknown, _)) = options.iter().find(|o| entry.options.iter().all(|k| k.name != o.0)) {
        if let Some((_, now)) = entry.removed.iter().find(|r| r.0.contains(&unknown.as_str())) {
            return Err(Error::Mismatch(format!("{name} has no option `{unknown}` any more: {now}")));
        }
        let known: Vec<&str> = entry.options.iter().map(|k| k.name).collect();
        let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
        return Err(Error::Mismatch(format!("{name} has no option `{unknown}`; it has: {known}")));
    }
    (entry.make)(settings, &Options { method: entry.name, known: entry.options, given: options })
}

/// What the camera ray meets first, for feature images.
pub(crate) fn features(world: &World, ray: &Ray) -> Option<Features> {
    let hit = world.intersect(ray)?;
    let shading = world.shading(&hit);
    Some(Features {
        albedo: shading.bsdf.albedo(),
        ns: shading.normal_for(hit.wo),
        n: hit.n(),
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
