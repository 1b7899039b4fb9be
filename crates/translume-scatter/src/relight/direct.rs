//! Models with a fall-off by distance under new light: the sum over all lit texels, without a mesh of factors in between, whose linear
//! interpolation would make more of a steep fall-off than it is.

use super::evaluate::sight_samples;
use super::irradiance::Power;
use super::lights::Sight;
use crate::capture::Surface;
use crate::hierarchical::{Atlas, Corners, Texel};
use glam::Vec3;
use rayon::prelude::*;
use std::f32::consts::PI;
use translume_bxdf::fresnel;

/// Parts of a texel along each side over which steep transfer is averaged, and the distance in texels up to which that is done.
const PARTS: usize = 4;
const NEAR: f32 = 4.0;

/// Linear RGB of the view, row by row: `transfer` gives R_d in mm⁻² for light at one place and a distance in mm to another, `modulation` a factor for
/// the place that is seen. `None` where the view has no direction.
pub(super) fn direct_picture(
    (surface, atlas, eta): (&Surface, &Atlas, f64),
    power: &Power,
    sight: &Sight,
    transfer: impl Fn(Corners, f32) -> [f32; 3] + Sync,
    modulation: impl Fn(u32, [f32; 2]) -> [f32; 3] + Sync,
) -> Option<Vec<[f32; 3]>> {
    let mesh = &surface.mesh;
    let place = |t: &Texel| (mesh.indices[t.face as usize], [1.0 - t.uv[0] - t.uv[1], t.uv[0], t.uv[1]]);
    let lit: Vec<(&Texel, Corners, Vec3)> = atlas
        .texels
        .iter()
        .zip(&power.texels)
        .filter(|(_, p)| **p != Vec3::ZERO)
        .map(|(t, p)| (t, place(t), *p))
        .collect();
    let samples = sight_samples(surface, sight)?;
    let share = 1.0 / (sight.samples * sight.samples) as f32;
    let one = |&(pixel, face, uv, cos): &(u32, u32, [f32; 2], f32)| {
        let [a, b, c] = mesh.corners(face as usize);
        let at = a + uv[0] * (b - a) + uv[1] * (c - a);
        let mut sum = Vec3::ZERO;
        for (texel, corners, power) in &lit {
            let d = texel.at.distance(at);
            let edge = texel.area.sqrt();
            let value = if d > NEAR * edge {
                Vec3::from(transfer(*corners, d))
            } else {
                let part = |i: usize| ((i as f32 + 0.5) / PARTS as f32 - 0.5) * edge;
                let parts = (0..PARTS * PARTS).map(|k| (d + part(k % PARTS)).hypot(part(k / PARTS)));
                parts.map(|r| Vec3::from(transfer(*corners, r))).sum::<Vec3>() / (PARTS * PARTS) as f32
            };
            sum += value * power;
        }
        let through = share * (1.0 - fresnel::dielectric(cos, eta as f32).reflectance) / PI;
        (pixel, sum * through * Vec3::from(modulation(face, uv)))
    };
    let values: Vec<(u32, Vec3)> = samples.par_iter().map(one).collect();
    let mut out = vec![[0.0f32; 3]; sight.width * sight.height];
    for (pixel, sum) in values {
        (0..3).for_each(|c| out[pixel as usize][c] += sum[c]);
    }
    Some(out)
}
