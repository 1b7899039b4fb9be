//! A solid under lights instead of a laser: the truth that models of its capture are held against.
//!
//! Photons start at the lights, into the cone or onto the disc that holds the object, and walk as those of a capture do; so the picture shares
//! the capture's assumption that light leaves equally in all directions, and its boundary. What leaves is counted in texels of the surface;
//! copies of photons far from where they entered keep the far side from being noisier than the near one.

use super::walk::{Body, Importance, Interface, World};
use super::{Medium, Solid};
use crate::capture::Texels;
use crate::relight::{Sight, Sources, sight_samples};
use rayon::prelude::*;
use translume_core::rng::Pcg32;

/// How to make the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LitParams {
    /// Photons of all lights together.
    pub photons: usize,
    /// Size of the texels that light is counted in, in mm; about that of a pixel.
    pub texel_mm: f64,
    /// Index of refraction.
    pub eta: f64,
    /// Diffusing boundary.
    pub rough: bool,
    /// Seed of the walk.
    pub seed: u64,
}

/// Photons that are followed together.
const BATCH: usize = 4096;
/// Decay of the wanted weight with the distance from where a photon entered, per mm, and its least value.
const WANTED: (f64, f64) = (-0.3, 2e-3);

/// Linear RGB of `solid` filled with `medium`, row by row. `None` where the view has no direction or no light shines.
pub fn picture_of_solid(
    (solid, medium): (&Solid, &Medium),
    sources: &Sources,
    sight: &Sight,
    params: &LitParams,
) -> Option<Vec<[f32; 3]>> {
    let mesh = solid.mesh();
    let (center, radius) = (mesh.bounds().center(), 0.5 * mesh.bounds().extent().length());
    let interface = Interface::new(params.eta, params.rough);
    let wanted = (0..1024).map(|i| (WANTED.0 * f64::from(i) * Importance::STEP_MM).exp().max(WANTED.1)).collect();
    let world = World { body: solid, medium, interface: &interface, importance: &Importance::new(wanted) };
    let texels = Texels::about(mesh, params.texel_mm);
    let bins = mesh.indices.len() * texels.per_face();
    let batches = params.photons.div_ceil(BATCH);
    let walk = |light: Vec<[f64; 3]>, batch: usize| -> Option<Vec<[f64; 3]>> {
        let mut light = light;
        let mut rng = Pcg32::new(params.seed, batch as u64);
        for _ in 0..BATCH {
            let (origin, direction, power) = sources.emit(center, radius, &mut rng)?;
            if power.max_element() <= 0.0 || solid.enter(origin.as_dvec3().to_array(), direction).is_none() {
                continue;
            }
            let power = power.as_dvec3().to_array();
            world.shine(origin.as_dvec3().to_array(), direction, &mut rng, &mut |exit| {
                let bin = &mut light[texels.index(exit.wall.face, exit.wall.uv)];
                (0..3).for_each(|c| bin[c] += power[c] * exit.weight[c]);
            });
        }
        Some(light)
    };
    // One accumulator for each of a fixed number of strands, so that the sums do not depend on the number of threads.
    let strands = 16.min(batches);
    let strand = |s: usize| (s..batches).step_by(strands).try_fold(vec![[0.0; 3]; bins], walk);
    let counted: Option<Vec<_>> = (0..strands).into_par_iter().map(strand).collect();
    let photons = (batches * BATCH) as f64;
    let mut light = vec![[0.0f64; 3]; bins];
    for part in counted? {
        light.iter_mut().zip(part).for_each(|(sum, l)| (0..3).for_each(|c| sum[c] += l[c] / photons));
    }
    let mut picture = vec![[0.0f32; 3]; sight.width * sight.height];
    let share = 1.0 / (sight.samples * sight.samples) as f64;
    for (pixel, face, uv, cos) in sight_samples(solid.surface(), sight)? {
        let [a, b, c] = mesh.corners(face as usize);
        let area = f64::from(0.5 * (b - a).cross(c - a).length()) / texels.per_face() as f64;
        let factor = share * interface.radiance(f64::from(cos)) / area.max(1e-30);
        let bin = &light[texels.index(face, uv)];
        (0..3).for_each(|c| picture[pixel as usize][c] += (factor * bin[c]) as f32);
    }
    Some(picture)
}
