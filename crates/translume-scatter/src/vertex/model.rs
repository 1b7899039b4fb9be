//! The fit: a fall-off for each laser position, given to the vertices next to it; fewer terms where it is unstable; what is left
//! out comes from neighbours; then the texture.

use super::interpolate::interpolate;
use super::samples::{MeshCapture, Pixel};
use crate::capture::{Texels, norm, sub};
use crate::curve::Curve;
use crate::fit::{Fitter, Params, PointFit};
use crate::planar::{fit_shared, held_out};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use translume_image::Result;

/// What to fit.
#[derive(Clone, Debug, PartialEq)]
pub struct VertexParams {
    /// The fall-off; one segment.
    pub fit: Params,
    /// A vertex takes the fall-off of a laser position up to this far, in median distances between neighbouring positions.
    pub reach: f64,
    /// A fit is unstable whose RMS error exceeds the median of all by this factor.
    pub worst: f64,
    /// The texture is made from samples between these multiples of the frame's smallest and of its largest sample.
    pub texture_range: (f64, f64),
}

impl Default for VertexParams {
    fn default() -> Self {
        Self { fit: Params::default(), reach: 1.5, worst: 2.5, texture_range: (2.0, 0.1) }
    }
}

/// The fall-off at one vertex.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Vertex {
    /// Factor of each channel.
    pub scale: Vec<f64>,
    /// Fall-off on the first channel's level: one segment; empty where nothing is known.
    pub fall_off: PointFit,
    /// Laser position it was measured with, as the rig numbers them; `None`: interpolated.
    pub position: Option<usize>,
}

/// A model of an object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VertexModel {
    /// As the vertices of the mesh.
    pub vertices: Vec<Vertex>,
    /// Laser positions whose fits were unstable with any number of terms.
    pub unstable: usize,
    /// Parts of a triangle's edge in the texture.
    pub texels_per_edge: usize,
    /// α of each channel and texel; 1 where nothing was measured. Kept in a file of its own.
    #[serde(skip)]
    pub texture: Vec<Vec<f32>>,
    /// Samples behind each of these values.
    #[serde(skip)]
    pub texture_samples: Vec<Vec<f32>>,
}

impl Vertex {
    /// R_d at a distance, in a channel, without texture.
    pub fn value(&self, r: f64, channel: usize) -> Option<f64> {
        Some(self.scale[channel] * self.fall_off.value(r, 0.0)?)
    }

    /// Whether it was measured, not interpolated.
    pub fn measured(&self) -> bool {
        self.position.is_some()
    }
}

impl VertexModel {
    /// α R_d for all pixels of a view, of light on a place of the mesh: the mean of its triangle's corners by their
    /// weights. 0 where there is no model.
    pub fn predict(&self, mesh: &MeshCapture, beam: usize, view: usize, channel: usize) -> Vec<f64> {
        let mix = self.mixture(mesh, beam);
        let texels = Texels { per_edge: self.texels_per_edge };
        let at = mesh.beams[beam].at;
        let value = |p: &Option<Pixel>| {
            p.map_or(0.0, |p| {
                let r = norm(sub(p.at, at));
                let sum: f64 = mix.iter().filter_map(|(v, w)| Some(w * v.value(r, channel)?)).sum();
                sum * f64::from(self.texture[channel][texels.index(p.face, p.uv)])
            })
        };
        mesh.pixels[view].iter().map(value).collect()
    }

    /// Vertices with a fall-off around where a beam hits, and their weights.
    fn mixture(&self, mesh: &MeshCapture, beam: usize) -> Vec<(&Vertex, f64)> {
        let Some((face, weights)) = mesh.beams[beam].on else { return Vec::new() };
        let corners = mesh.surface.mesh.indices[face as usize];
        let known = corners.iter().zip(weights).map(|(&i, w)| (&self.vertices[i as usize], w));
        let known: Vec<_> = known.filter(|(v, w)| !v.fall_off.segments.is_empty() && *w > 0.0).collect();
        let total: f64 = known.iter().map(|k| k.1).sum();
        known.into_iter().map(|(v, w)| (v, w / total)).collect()
    }
}

/// A stable fit of one laser position: factors and fall-off.
type Found = (Vec<f64>, PointFit);

/// Fits `mesh`; `progress` is called for each laser position.
///
/// # Errors
/// Those of reading frames.
pub fn fit_vertices(mesh: &MeshCapture, params: &VertexParams, progress: impl Fn() + Sync) -> Result<VertexModel> {
    let one = |fitters: &mut Vec<Fitter>, beam: usize| -> Result<Vec<Found>> {
        let samples = samples(mesh, beam)?;
        progress();
        Ok(fitters.iter_mut().map(|f| fit_shared(f, &samples)).collect())
    };
    // From the most terms down; one fitter each.
    let make = || -> Vec<Fitter> {
        (1..=params.fit.terms).rev().map(|terms| Fitter::new(&Params { terms, ..params.fit.clone() })).collect()
    };
    let tried: Result<Vec<Vec<Found>>> = (0..mesh.beams.len()).into_par_iter().map_init(make, one).collect();
    let tried = tried?;
    let mut rms: Vec<f64> = tried.iter().filter_map(|t| t[0].1.rms).collect();
    rms.sort_by(f64::total_cmp);
    let limit = params.worst * rms.get(rms.len() / 2).copied().unwrap_or(f64::INFINITY);
    let stable: Vec<Option<Found>> =
        tried.into_iter().map(|t| t.into_iter().find(|(_, fit)| is_stable(fit, limit))).collect();
    let mut vertices = assign(mesh, params, &stable);
    interpolate(&mesh.surface.mesh, &params.fit, &mut vertices);
    let texels = Texels::about(&mesh.surface.mesh, pixel_mm(mesh));
    let unstable = stable.iter().filter(|s| s.is_none()).count();
    let mut model = VertexModel {
        vertices,
        unstable,
        texels_per_edge: texels.per_edge,
        texture: Vec::new(),
        texture_samples: Vec::new(),
    };
    modulate(mesh, params, &stable, texels, &mut model)?;
    Ok(model)
}

/// The samples (distance, 0, R_d) of each channel that are not held out, of all views of a beam.
fn samples(mesh: &MeshCapture, beam: usize) -> Result<Vec<Vec<[f32; 3]>>> {
    let at = mesh.beams[beam].at;
    let channel = |channel: usize| -> Result<Vec<[f32; 3]>> {
        let mut out = Vec::new();
        for &view in mesh.views(beam) {
            let values = mesh.reflectance(beam, view, channel)?;
            let pixels = values.iter().zip(&mesh.pixels[view]).enumerate();
            out.extend(pixels.filter_map(|(i, (value, pixel))| {
                let pixel = pixel.as_ref().filter(|_| !held_out(beam, i))?;
                Some([norm(sub(pixel.at, at)) as f32, 0.0, *value])
            }));
        }
        Ok(out)
    };
    (0..mesh.capture.rig.channels.len()).map(channel).collect()
}

/// Samples that a stable fit needs.
const FEWEST: usize = 24;
/// The most that may leave of what came in, as the fall-off goes on along a plane: more is no reflectance.
const MOST: f64 = 1.5;

/// Whether a fit may be used: enough samples, an error like that of others, and no more light than there was.
fn is_stable(fit: &PointFit, limit: f64) -> bool {
    let total = |curve: &Curve| match curve {
        Curve::Exponential(e) => TAU * e.c.iter().zip(&e.d).map(|(c, d)| c / (d * d)).sum::<f64>(),
        // Diffusion conserves energy but for a free scale.
        Curve::Dipole(d) => d.total(),
        Curve::Normalized(_) => 0.5,
    };
    fit.samples >= FEWEST
        && fit.rms.is_some_and(|rms| rms <= limit)
        && fit.segments.iter().all(|s| (0.0..=MOST).contains(&total(&s.curve)))
}

/// Each vertex gets the fall-off of the nearest stable laser position, if one is in reach.
fn assign(mesh: &MeshCapture, params: &VertexParams, stable: &[Option<Found>]) -> Vec<Vertex> {
    let reach = params.reach * spacing(mesh);
    let channels = mesh.capture.rig.channels.len();
    let used: Vec<(usize, &Found)> = stable.iter().enumerate().filter_map(|(i, s)| Some((i, s.as_ref()?))).collect();
    let vertex = |p: &[f32; 3]| {
        let p = p.map(f64::from);
        let distance = |i: usize| norm(sub(mesh.beams[i].at, p));
        let near = used.iter().map(|(i, f)| (distance(*i), *i, *f)).min_by(|a, b| a.0.total_cmp(&b.0));
        match near.filter(|n| n.0 <= reach) {
            Some((_, i, (scale, fall_off))) => {
                Vertex { scale: scale.clone(), fall_off: fall_off.clone(), position: Some(mesh.beams[i].position) }
            }
            None => Vertex { scale: vec![1.0; channels], fall_off: PointFit::default(), position: None },
        }
    };
    mesh.surface.mesh.positions.par_iter().map(vertex).collect()
}

/// Median distance of a laser position to the nearest other one.
fn spacing(mesh: &MeshCapture) -> f64 {
    let nearest = |i: usize| {
        let others = mesh.beams.iter().enumerate().filter(|(j, _)| *j != i);
        others.map(|(_, b)| norm(sub(b.at, mesh.beams[i].at))).filter(|d| *d > 0.0).fold(f64::INFINITY, f64::min)
    };
    let mut all: Vec<f64> = (0..mesh.beams.len()).into_par_iter().map(nearest).collect();
    all.sort_by(f64::total_cmp);
    all[all.len() / 2]
}

/// Size of a pixel on the object.
fn pixel_mm(mesh: &MeshCapture) -> f64 {
    let camera = &mesh.capture.rig.views[0].camera;
    let center = mesh.surface.mesh.bounds().center().as_dvec3().to_array();
    norm(sub(camera.eye(), center)) / camera.focal_px
}

/// α(x_o): the mean over the laser positions of sample/model, for samples of medium intensity [Fuchs 2005, Eq. 6].
fn modulate(
    mesh: &MeshCapture,
    params: &VertexParams,
    stable: &[Option<Found>],
    texels: Texels,
    model: &mut VertexModel,
) -> Result<()> {
    let count = texels.per_face() * mesh.surface.mesh.indices.len();
    for channel in 0..mesh.capture.rig.channels.len() {
        let (mut sums, mut counts) = (vec![0.0f32; count], vec![0.0f32; count]);
        for (beam, found) in stable.iter().enumerate() {
            let Some((scale, fit)) = found else { continue };
            let Some(curve) = fit.evaluator() else { continue };
            for &view in mesh.views(beam) {
                let values = mesh.reflectance(beam, view, channel)?;
                let faint = values.iter().copied().filter(|v| *v > 0.0).fold(f32::INFINITY, f32::min);
                let peak = values.iter().copied().fold(0.0, f32::max);
                let (t2, t1) = (params.texture_range.0 as f32 * faint, params.texture_range.1 as f32 * peak);
                for (i, (value, pixel)) in values.iter().zip(&mesh.pixels[view]).enumerate() {
                    if let Some(p) = pixel.as_ref().filter(|_| *value > t2 && *value < t1 && !held_out(beam, i)) {
                        let expected = scale[channel] * curve.value(norm(sub(p.at, mesh.beams[beam].at)), 0.0);
                        let texel = texels.index(p.face, p.uv);
                        sums[texel] += (f64::from(*value) / expected) as f32;
                        counts[texel] += 1.0;
                    }
                }
            }
        }
        sums.iter_mut().zip(&counts).for_each(|(s, n)| *s = if *n > 0.0 { *s / n } else { 1.0 });
        model.texture.push(sums);
        model.texture_samples.push(counts);
    }
    Ok(())
}
