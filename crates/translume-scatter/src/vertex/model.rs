//! The fit: a fall-off for each laser position, given to the vertices next to it; fewer terms where it is unstable; what is left
//! out comes from neighbours; then the texture.

use super::interpolate::interpolate;
use super::samples::{MeshCapture, Pixel};
use crate::capture::{Texels, norm, sub};
use crate::fit::{Fitter, Params, PointFit};
use crate::planar::{fit_shared, held_out};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use translume_core::rng::Pcg32;
use translume_core::warp;
use translume_image::Result;
use translume_mesh::TriMesh;

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
    /// Why; since 1.1.
    #[serde(default)]
    pub faults: Faults,
    /// Parts of a triangle's edge in the texture.
    pub texels_per_edge: usize,
    /// α of each channel and texel; 1 where nothing was measured. Kept in a file of its own.
    #[serde(skip)]
    pub texture: Vec<Vec<f32>>,
    /// Samples behind each of these values.
    #[serde(skip)]
    pub texture_samples: Vec<Vec<f32>>,
}

/// What was wrong with the fits of most terms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Faults {
    /// Too few samples, or no curve goes through them.
    pub few: usize,
    /// An error much larger than those of the others.
    pub odd: usize,
    /// More light would leave the object than came in.
    pub bright: usize,
    /// Those that were stable with fewer terms than asked for.
    pub fewer_terms: usize,
}

impl Vertex {
    /// R_d at a distance, in a channel, without texture.
    pub fn value(&self, r: f64, channel: usize) -> Option<f64> {
        // [Fuchs 2005, Eq. 9]
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
                // [Fuchs 2005, Eq. 2]
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
        Ok(fitters.iter_mut().map(|f| fit_shared(f, &samples, None)).collect())
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
    let spread = Spread::new(&mesh.surface.mesh);
    let pick = |(tried, beam): (Vec<Found>, &super::samples::Beam)| {
        let whole = tried.first().and_then(|(scale, fit)| fault(fit, scale, beam.at, limit, &spread));
        let sound = tried.into_iter().find(|(scale, fit)| fault(fit, scale, beam.at, limit, &spread).is_none());
        (sound, whole)
    };
    let (stable, wrong): (Vec<Option<Found>>, Vec<Option<Fault>>) =
        tried.into_par_iter().zip(&mesh.beams).map(pick).unzip();
    let mut vertices = assign(mesh, params, &stable);
    interpolate(&mesh.surface.mesh, &params.fit, &mut vertices);
    let texels = Texels::about(&mesh.surface.mesh, mesh.pixel_mm());
    let lost = |fault| stable.iter().zip(&wrong).filter(|(s, f)| s.is_none() && **f == Some(fault)).count();
    let unstable = stable.iter().filter(|s| s.is_none()).count();
    let faults = Faults {
        few: lost(Fault::Few),
        odd: lost(Fault::Odd),
        bright: lost(Fault::Bright),
        fewer_terms: stable.iter().zip(&wrong).filter(|(s, f)| s.is_some() && f.is_some()).count(),
    };
    let mut model = VertexModel {
        vertices,
        unstable,
        faults,
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
/// The most that may leave the object of what came in: more is no reflectance.
const MOST: f64 = 1.5;

/// Why a fit is not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    /// Too few samples, or no curve goes through them.
    Few,
    /// An error much larger than those of the others.
    Odd,
    /// More light leaves the object than came in.
    Bright,
}

/// What is wrong with a fit of the beam that hits at `at`, if anything is.
fn fault(fit: &PointFit, scale: &[f64], at: [f64; 3], limit: f64, spread: &Spread) -> Option<Fault> {
    let Some(curve) = fit.evaluator().filter(|_| fit.samples >= FEWEST) else { return Some(Fault::Few) };
    if fit.rms.is_none_or(|rms| rms > limit) {
        return Some(Fault::Odd);
    }
    let brightest = scale.iter().copied().fold(0.0, f64::max);
    let total = brightest * spread.integral(at, |r| curve.value(r, 0.0));
    (!(0.0..=MOST).contains(&total)).then_some(Fault::Bright)
}

/// Points spread evenly over a mesh, to integrate fall-offs over it. On a plane a slow fall-off would go on for ever, and thin
/// parts have such fall-offs: light runs along them like in a rod.
struct Spread {
    points: Vec<[f64; 3]>,
    /// Area for each of them.
    area: f64,
    /// Nearer than this there are too few of them; the surface counts as a plane.
    near: f64,
}

impl Spread {
    const POINTS: usize = 4096;

    fn new(mesh: &TriMesh) -> Self {
        let total = mesh.area();
        let area = (total / Self::POINTS as f64).max(f64::MIN_POSITIVE);
        let (mut points, mut sum, mut rng) = (Vec::new(), 0.0, Pcg32::new(1, 1));
        for face in 0..mesh.indices.len() {
            let [a, b, c] = mesh.corners(face).map(|p| p.as_dvec3());
            sum += 0.5 * (b - a).cross(c - a).length();
            while (points.len() as f64 + 0.5) * area < sum {
                let at = warp::uniform_triangle(rng.next_f32(), rng.next_f32()).as_dvec2();
                points.push((a + (b - a) * at.x + (c - a) * at.y).to_array());
            }
        }
        // A dozen of them.
        Self { points, area, near: (4.0 * area).sqrt() }
    }

    fn integral(&self, at: [f64; 3], value: impl Fn(f64) -> f64) -> f64 {
        let step = self.near / 64.0;
        let ring = |i: u32| (f64::from(i) + 0.5) * step;
        let inner: f64 = (0..64).map(|i| TAU * ring(i) * step * value(ring(i))).sum();
        let distances = self.points.iter().map(|p| norm(sub(*p, at)));
        inner + distances.filter(|r| *r >= self.near).map(value).sum::<f64>() * self.area
    }
}

/// Each vertex gets the fall-off of the nearest stable laser position, if one is in reach [Fuchs 2005, §5].
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

/// α(x_o): a mean over the laser positions of sample/model, for samples of medium intensity.
///
/// Deviation from [Fuchs 2005, Eq. 6]: the mean is that of logarithms, and it is drawn towards 1 where samples are few. On an object
/// a texel has a handful of samples, whose ratios to the model scatter by a factor of two or three: their plain mean lies above
/// 1 everywhere and makes the model worse than without. With the variances of a one-way random effects model, σ_w² within
/// texels and σ_b² between them, ln α = mean · n/(n + σ_w²/σ_b²).
fn modulate(
    mesh: &MeshCapture,
    params: &VertexParams,
    stable: &[Option<Found>],
    texels: Texels,
    model: &mut VertexModel,
) -> Result<()> {
    let count = texels.per_face() * mesh.surface.mesh.indices.len();
    for channel in 0..mesh.capture.rig.channels.len() {
        let (mut sums, mut counts, mut squares) = (vec![0.0f32; count], vec![0.0f32; count], 0.0f64);
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
                        let ln = (f64::from(*value) / expected).ln(); // [Fuchs 2005, Eq. 6]
                        sums[texel] += ln as f32;
                        counts[texel] += 1.0;
                        squares += ln * ln;
                    }
                }
            }
        }
        shrink(&mut sums, &counts, squares);
        model.texture.push(sums);
        model.texture_samples.push(counts);
    }
    Ok(())
}

/// From sums of logarithms to factors; `squares` is the sum of all squares.
fn shrink(sums: &mut [f32], counts: &[f32], squares: f64) {
    let seen = || sums.iter().zip(counts).filter(|s| *s.1 > 0.0).map(|(s, n)| (f64::from(*s), f64::from(*n)));
    let (texels, samples) = seen().fold((0.0, 0.0), |(t, n), s| (t + 1.0, n + s.1));
    let of_means: f64 = seen().map(|(s, n)| s * s / n).sum();
    let within = if samples > texels { ((squares - of_means) / (samples - texels)).max(0.0) } else { squares };
    let between = (of_means - texels * within) / samples.max(1.0);
    for (sum, n) in sums.iter_mut().zip(counts) {
        let factor = if *n > 0.0 && between > 0.0 { 1.0 / (f64::from(*n) + within / between) } else { 0.0 };
        *sum = (f64::from(*sum) * factor).exp() as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_modulation_is_drawn_to_one_where_it_is_noise() {
        // 2000 texels of 4 samples: of deviation `between` from texel to texel and 1 within.
        let check = |between: f64| {
            let (mut rng, mut error) = (Pcg32::new(4, 4), [0.0f64; 2]);
            let truth: Vec<f64> = (0..2000).map(|_| between * rng.next_normal()).collect();
            let (mut sums, mut squares) = (Vec::new(), 0.0);
            for t in &truth {
                let samples: Vec<f64> = (0..4).map(|_| t + rng.next_normal()).collect();
                sums.push(samples.iter().sum::<f64>() as f32);
                squares += samples.iter().map(|s| s * s).sum::<f64>();
            }
            let plain: Vec<f64> = sums.iter().map(|s| f64::from(*s) / 4.0).collect();
            shrink(&mut sums, &[4.0; 2000], squares);
            for (i, t) in truth.iter().enumerate() {
                error[0] += (f64::from(sums[i]).ln() - t).powi(2) / 2000.0;
                error[1] += (plain[i] - t).powi(2) / 2000.0;
            }
            // The least mean square error: 1/(n/σ_w² + 1/σ_b²).
            let least = if between > 0.0 { 1.0 / (4.0 + between.powi(-2)) } else { 0.0 };
            assert!(error[0] < 1.05 * least + 0.01 && error[0] < error[1], "{between}: {error:?}, {least}");
        };
        [0.0, 0.3, 1.0].into_iter().for_each(check);
    }

    #[test]
    fn fall_offs_integrate_over_the_object_not_a_plane() {
        // A rod of 1 mm × 1 mm × 40 mm: a slow fall-off sends back what its sides can, 4 ∫ e^{−r/20} dr on both sides.
        let corner = |i: u32| {
            [
                if i & 1 > 0 { 1.0f32 } else { 0.0 },
                if i & 2 > 0 { 1.0 } else { 0.0 },
                if i & 4 > 0 { 40.0 } else { 0.0 },
            ]
        };
        let quads = [[0, 1, 5, 4], [1, 3, 7, 5], [3, 2, 6, 7], [2, 0, 4, 6], [0, 2, 3, 1], [4, 5, 7, 6]];
        let indices = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
        let rod = TriMesh { positions: (0..8).map(corner).collect(), indices, ..TriMesh::default() };
        let total = Spread::new(&rod).integral([0.5, 0.0, 20.0], |r| 0.01 * (-r / 20.0).exp());
        let expected = 0.01 * 4.0 * 2.0 * 20.0 * (1.0 - (-1.0f64).exp());
        assert!((total / expected - 1.0).abs() < 0.05, "{total} {expected}");
    }
}
