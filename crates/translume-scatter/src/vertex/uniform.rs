//! One fall-off for a whole object, a curve for each colour, times an albedo by place: what a homogeneous material with a texture can
//! show of it. The baseline that richer models are held against, so it is fitted as well as can be.
//!
//! The curves are fitted to the mean R_d in rings around all spots, which neither noise nor spots of other strength bias, up to some distance; the
//! albedo of a texel is the sum of what was measured there over the sum of what the curves say. No dipole follows both the near and the far
//! light of a heterogeneous object; up to which distance it is fitted is chosen by the pixels held out, by the error of square roots, which
//! weighs light as photon noise does.

use super::samples::MeshCapture;
use crate::capture::{Texels, norm, sub};
use crate::curve::Curve;
use crate::fit::{Fitter, Params};
use crate::planar::held_out;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use translume_image::{Error, Result};

/// The model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UniformModel {
    /// The fall-off of each channel.
    pub curves: Vec<Curve>,
    /// Distance in mm up to which they were fitted.
    pub reach_mm: f64,
    /// Σ (√model − √sample)² over Σ sample, of pixels held out.
    pub held_out_error: f64,
    /// Parts of a triangle's edge in the texture.
    pub texels_per_edge: usize,
    /// The albedo of each channel and texel, about 1. Kept in a file of its own.
    #[serde(skip)]
    pub texture: Vec<Vec<f32>>,
    /// Samples behind each of these values.
    #[serde(skip)]
    pub texture_samples: Vec<Vec<f32>>,
}

/// Rings around the spots: 0.2 · 1.2^i mm.
const RINGS: usize = 28;
/// Numbers of rings that a fit may use.
const CANDIDATES: [usize; 8] = [10, 12, 14, 16, 18, 20, 23, 28];
/// Weight of the albedo 1, in that of a mean texel.
const PRIOR: f64 = 0.02;

fn ring(d: f64) -> usize {
    if d < 0.2 { 0 } else { ((d / 0.2).ln() / 1.2f64.ln()) as usize + 1 }
}

/// Fits `mesh`; `progress` is called three times for each laser position.
///
/// # Errors
/// [`Error::Invalid`] where there are too few samples; those of reading frames.
pub fn fit_uniform(mesh: &MeshCapture, params: &Params, progress: impl Fn() + Sync) -> Result<UniformModel> {
    let channels = mesh.capture.rig.channels.len();
    let sums = accumulate(mesh, &progress, vec![[0.0f64; 3]; channels * RINGS], false, |sums, s| {
        if let Some(sum) = sums[s.channel * RINGS..(s.channel + 1) * RINGS].get_mut(ring(s.distance)) {
            *sum = [sum[0] + s.value, sum[1] + s.distance, sum[2] + 1.0];
        }
    })?;
    let fitted: Vec<(f64, Vec<Curve>)> =
        CANDIDATES.iter().filter_map(|&n| curves(&sums, channels, n, params)).collect();
    if fitted.is_empty() {
        return Err(Error::invalid(&mesh.capture.path, "too few pixels above the noise for a fall-off"));
    }
    let texels = Texels::about(&mesh.surface.mesh, mesh.pixel_mm());
    let count = channels * texels.per_face() * mesh.surface.mesh.indices.len();
    let at = |s: &Sample| s.channel * (count / channels) + texels.index(s.face, s.uv);
    let evaluators: Vec<Vec<_>> = fitted.iter().map(|f| f.1.iter().map(Curve::evaluator).collect()).collect();
    let n = fitted.len();
    // For each texel: the measured, the predicted of each candidate, the number.
    let light = accumulate(mesh, &progress, vec![0.0f64; count * (n + 2)], false, |sums, s| {
        let sum = &mut sums[at(s) * (n + 2)..][..n + 2];
        sum[0] += s.value;
        evaluators.iter().zip(&mut sum[1..]).for_each(|(e, sum)| *sum += e[s.channel].value(s.distance));
        sum[n + 1] += 1.0;
    })?;
    let albedo = |k: usize| -> Vec<f64> {
        let prior = PRIOR * light.chunks_exact(n + 2).map(|l| l[1 + k]).sum::<f64>() / count as f64;
        light.chunks_exact(n + 2).map(|l| (l[0] + prior) / (l[1 + k] + prior)).collect()
    };
    let albedos: Vec<Vec<f64>> = (0..n).map(albedo).collect();
    let errors = accumulate(mesh, &progress, vec![0.0f64; n + 1], true, |sums, s| {
        for (k, (albedo, e)) in albedos.iter().zip(&evaluators).enumerate() {
            let said = albedo[at(s)] * e[s.channel].value(s.distance);
            sums[k] += (said.max(0.0).sqrt() - s.value.max(0.0).sqrt()).powi(2);
        }
        sums[n] += s.value;
    })?;
    let best = (0..n).min_by(|&a, &b| errors[a].total_cmp(&errors[b])).expect("not empty");
    let part = |values: Vec<f32>| values.chunks_exact(count / channels).map(<[f32]>::to_vec).collect();
    Ok(UniformModel {
        curves: fitted[best].1.clone(),
        reach_mm: fitted[best].0,
        held_out_error: errors[best] / errors[n],
        texels_per_edge: texels.per_edge,
        texture: part(albedos[best].iter().map(|a| *a as f32).collect()),
        texture_samples: part(light.chunks_exact(n + 2).map(|l| l[n + 1] as f32).collect()),
    })
}

/// A pixel of a frame.
struct Sample {
    channel: usize,
    distance: f64,
    face: u32,
    uv: [f32; 2],
    value: f64,
}

/// Adds up something over all pixels that are held out, or all others; strands of beams in parallel, in a fixed order.
fn accumulate<T: Copy + Send + Sync + Sum>(
    mesh: &MeshCapture,
    progress: &(impl Fn() + Sync),
    zero: Vec<T>,
    wanted: bool,
    add: impl Fn(&mut [T], &Sample) + Sync,
) -> Result<Vec<T>> {
    let strands = 4;
    let strand = |first: usize| -> Result<Vec<T>> {
        let mut sums = zero.clone();
        for beam in (first..mesh.beams.len()).step_by(strands) {
            let hit = mesh.beams[beam].at;
            for &view in mesh.views(beam) {
                for channel in 0..mesh.capture.rig.channels.len() {
                    let values = mesh.reflectance(beam, view, channel)?;
                    for (i, (value, pixel)) in values.iter().zip(&mesh.pixels[view]).enumerate() {
                        let Some(p) = pixel else { continue };
                        // Without a threshold the dark ones count, too.
                        if held_out(beam, i) == wanted && (*value > 0.0 || mesh.threshold == 0.0) {
                            let distance = norm(sub(p.at, hit));
                            add(
                                &mut sums,
                                &Sample { channel, distance, face: p.face, uv: p.uv, value: (*value).into() },
                            );
                        }
                    }
                }
            }
            progress();
        }
        Ok(sums)
    };
    let mut parts = (0..strands).into_par_iter().map(strand).collect::<Result<Vec<_>>>()?.into_iter();
    let mut all = parts.next().expect("strands");
    parts.for_each(|part| all.iter_mut().zip(part).for_each(|(a, b)| *a = a.sum(b)));
    Ok(all)
}

trait Sum {
    fn sum(self, other: Self) -> Self;
}

impl Sum for f64 {
    fn sum(self, other: Self) -> Self {
        self + other
    }
}

impl Sum for [f64; 3] {
    fn sum(self, other: Self) -> Self {
        [self[0] + other[0], self[1] + other[1], self[2] + other[2]]
    }
}

/// Farthest distance and fall-offs fitted to the first `n` rings.
fn curves(sums: &[[f64; 3]], channels: usize, n: usize, params: &Params) -> Option<(f64, Vec<Curve>)> {
    let mut fitter = Fitter::new(params);
    let mut reach = 0.0f64;
    let curve = |channel: usize| {
        let rings = &sums[channel * RINGS..][..n];
        let known = rings.iter().filter(|r| r[2] > 0.0 && r[0] > 0.0);
        let means: Vec<[f32; 3]> = known.map(|r| [(r[1] / r[2]) as f32, 0.0, (r[0] / r[2]) as f32]).collect();
        reach = means.iter().fold(reach, |far, m| far.max(m[0].into()));
        Some(fitter.fit(&means).segments.first()?.curve.clone())
    };
    let curves: Option<Vec<Curve>> = (0..channels).map(curve).collect();
    Some((reach, curves?))
}

impl MeshCapture {
    /// Size of a pixel on the object.
    pub(super) fn pixel_mm(&self) -> f64 {
        let camera = &self.capture.rig.views[0].camera;
        let center = self.surface.mesh.bounds().center().as_dvec3().to_array();
        norm(sub(camera.eye(), center)) / camera.focal_px
    }
}

/// What relights it: R_d of a distance, and the albedo of a place.
impl UniformModel {
    /// R_d of each colour at a distance in mm, without albedo.
    pub fn value(&self, d: f64) -> [f32; 3] {
        [0, 1, 2].map(|c: usize| self.curves[c.min(self.curves.len() - 1)].evaluator().value(d) as f32)
    }

    /// The albedo of each colour.
    pub fn albedo(&self, face: u32, uv: [f32; 2]) -> [f32; 3] {
        let texel = Texels { per_edge: self.texels_per_edge }.index(face, uv);
        [0, 1, 2].map(|c: usize| self.texture[c.min(self.texture.len() - 1)][texel])
    }
}
