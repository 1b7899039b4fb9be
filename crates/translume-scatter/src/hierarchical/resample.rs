//! From frames to measurements on the surface [Goesele 2004, §5], [Goesele 2004, §6.1], [Goesele 2004, §7.1]: all pictures of a laser position are merged over views
//! and colours, at the vertices for F and at the texels around the spot for K.
//!
//! R_d = π L_o / (F_t(η, ω_o) F_t(η, ω_i) Φ), weighted by the cosines of both directions. Pixels are looked up bilinearly. Left out are samples
//! below the noise floor, clipped ones, and near the spot those close to the mirror direction of the laser, where a highlight may be.
//! A frame is read, used and dropped: memory does not grow with their number.

use super::colour::Colours;
use super::kernel::{Candidate, measure_kernels};
use super::pairs::Measured;
use super::stage::{Losses, Stage};
use super::views::Lookup;
use rayon::prelude::*;
use translume_image::Result;

/// Frames of this many positions are merged in parallel before they are added up in their order.
const BATCH: usize = 32;
/// Barycentric weights below this are too small to call a vertex lit.
const LEAST: f32 = 0.05;
/// Cosine between normal and half vector above which a highlight may be seen: 8°.
const HIGHLIGHT: f32 = 0.990_3;
/// A highlight is as wide as the spot, in diameters of the beam.
const SPOT: f32 = 1.0;

/// One picture of a laser position, its channels.
pub(super) struct Shot {
    view: usize,
    frames: Vec<Vec<f32>>,
    /// Largest value of the first channel.
    brightest: f32,
    /// From a frame's values to R_d, without the camera's Fresnel factor.
    scale: Vec<f32>,
    /// R_d of the noise floor times the threshold, as luminance.
    floor: f32,
    /// Brightest value of each channel if it is clipped.
    clip: Vec<f32>,
}

/// All pictures of a laser position.
pub(super) struct Exposure {
    pub(super) beam: usize,
    pub(super) shots: Vec<Shot>,
}

/// Why a position has no exposure.
pub(super) enum Failure {
    Missing,
    Dark,
}

impl Exposure {
    /// Reads the pictures of a beam that has whole sets of channels.
    pub(super) fn read(
        stage: &Stage,
        beam: usize,
        colours: &Colours,
    ) -> Result<std::result::Result<(Self, usize), Failure>> {
        let (capture, at) = (&stage.capture, &stage.beams[beam]);
        let [views, _, channels, ..] = capture.frames.shape;
        let (mut shots, mut clipped, mut dark) = (Vec::new(), 0, 0);
        for view in 0..views {
            if !(0..channels).all(|c| capture.frames.exists(view, at.position, c)) {
                continue;
            }
            let mut frames = Vec::with_capacity(channels);
            for c in 0..channels {
                frames.extend(capture.frames.read(view, at.position, c)?);
            }
            if frames.len() < channels {
                continue;
            }
            let rig = &capture.rig;
            let scale: Vec<f32> =
                (0..channels).map(|c| at.gain * (rig.channels[c].white_balance / rig.laser.power[c]) as f32).collect();
            let noise = |c: usize| scale[c] * (stage.threshold * rig.channels[c].noise_floor) as f32;
            let floor = colours.luminance([0, 1, 2].map(|c| noise(c.min(channels - 1))));
            let brightest: Vec<f32> = frames.iter().map(|f| brightest(f)).collect();
            let clip: Vec<f32> = frames.iter().zip(&brightest).map(|(f, b)| clip_level(f, *b)).collect();
            clipped += usize::from(clip.iter().any(|l| l.is_finite()));
            let bright = |c: usize| scale[c] * brightest[c] > noise(c);
            match (0..channels).all(bright) {
                true => shots.push(Shot { view, frames, brightest: brightest[0], scale, floor, clip }),
                false => dark += 1,
            }
        }
        Ok(match (shots.is_empty(), dark) {
            (true, 0) => Err(Failure::Missing),
            (true, _) => Err(Failure::Dark),
            _ => {
                let exposure = Self { beam, shots };
                if exposure.spot_is_there(stage) { Ok((exposure, clipped)) } else { Err(Failure::Dark) }
            }
        })
    }

    /// The valid-spot test: in a view that sees the spot well, the brightest pixel lies near it.
    fn spot_is_there(&self, stage: &Stage) -> bool {
        let beam = &stage.beams[self.beam];
        let [.., rows, columns] = stage.capture.frames.shape;
        let corners = stage.corners(beam.face);
        let seen = |s: &&Shot| corners.iter().any(|&v| stage.views[s.view].vertices[v as usize].is_some());
        let mut seeing = self.shots.iter().filter(seen).peekable();
        // Where no camera sees the spot its place is taken on trust: the light that comes through is still a measurement.
        seeing.peek().is_none() || {
            let near = |shot: &Shot| {
                let camera = &stage.capture.rig.views[shot.view].camera;
                let Some([x, y]) = camera.project(beam.at.as_dvec3().to_array()) else { return false };
                let frame = &shot.frames[0];
                let reach = 2.0
                    + camera.focal_px * stage.capture.rig.laser.beam_diameter_mm
                        / crate::capture::norm(crate::capture::sub(camera.eye(), beam.at.as_dvec3().to_array()));
                let around =
                    |c: f64, n: usize| (c - reach).max(0.0) as usize..((c + reach).max(0.0) as usize + 1).min(n);
                around(y, rows).any(|r| around(x, columns).any(|c| frame[r * columns + c] >= 0.5 * shot.brightest))
            };
            seeing.any(near)
        }
    }

    /// R_d at a place and its weight, merged over the views.
    pub(super) fn sample<'a>(
        &self,
        stage: &'a Stage,
        colours: &Colours,
        near: bool,
        lookup: impl Fn(usize) -> Option<&'a Lookup>,
    ) -> Option<([f32; 3], f32)> {
        let beam = &stage.beams[self.beam];
        let (mut sum, mut weights) = ([0.0; 3], 0.0);
        for shot in &self.shots {
            let Some(at) = lookup(shot.view) else { continue };
            let half = (at.towards + beam.towards).normalize_or_zero();
            if near && half.dot(beam.normal) > HIGHLIGHT && stage.capture.rig.eta > 1.0 {
                continue;
            }
            let width = stage.views[shot.view].width;
            let Some(values) = shot.values(at, width) else { continue };
            let rgb = [0, 1, 2].map(|c: usize| values[c.min(shot.frames.len() - 1)]);
            // Without a threshold everything counts: noise has no sign, and dropping what is below 0 would make light.
            if stage.threshold == 0.0 || colours.luminance(rgb) > shot.floor * at.inverse {
                let weight = at.weight * beam.cos;
                (0..3).for_each(|c| sum[c] += weight * rgb[c]);
                weights += weight;
            }
        }
        (weights > 0.0).then(|| (sum.map(|s| s / weights), weights))
    }
}

impl Shot {
    /// R_d of up to three channels at a place of the frame; `None` where it is clipped or not a number.
    #[inline]
    fn values(&self, at: &Lookup, width: usize) -> Option<[f32; 3]> {
        let mut out = [0.0; 3];
        let i = at.pixel as usize;
        for (c, frame) in self.frames.iter().enumerate() {
            let four = [frame[i], frame[i + 1], frame[i + width], frame[i + width + 1]];
            let upper = four[0] + at.fx * (four[1] - four[0]);
            let lower = four[2] + at.fx * (four[3] - four[2]);
            // [Goesele 2004, Eq. 2]
            out[c] = (upper + at.fy * (lower - upper)) * self.scale[c] * at.inverse;
            if !out[c].is_finite() || four.iter().any(|&v| v >= self.clip[c]) {
                return None;
            }
        }
        Some(out)
    }
}

/// The largest finite value of a frame, 0 at least.
fn brightest(frame: &[f32]) -> f32 {
    // Lanes of their own, so that the compiler makes vectors of them. NaN is larger than nothing.
    let mut lanes = [0.0f32; 16];
    let (blocks, rest) = frame.as_chunks::<16>();
    let larger = |most: &mut f32, v: f32| *most = if v > *most && v < f32::INFINITY { v } else { *most };
    blocks.iter().for_each(|b| lanes.iter_mut().zip(b).for_each(|(l, v)| larger(l, *v)));
    rest.iter().for_each(|v| larger(&mut lanes[0], *v));
    lanes.into_iter().fold(0.0, f32::max)
}

/// The value at which a frame is clipped: its largest, if four or more pixels have it exactly.
fn clip_level(frame: &[f32], most: f32) -> f32 {
    let many = most > 0.0 && frame.iter().map(|&v| u32::from(v == most)).sum::<u32>() >= 4;
    if many { most } else { f32::INFINITY }
}

/// For each texel the kernel whose spot is best centred on it [Goesele 2004, §7.1].
pub struct Kernels(pub(super) Vec<Option<Candidate>>);

impl Kernels {
    /// Texels with a kernel.
    pub fn measured(&self) -> usize {
        self.0.iter().flatten().count()
    }
}

/// What a laser position tells.
struct Response {
    /// Vertex, R_d, weight.
    vertices: Vec<(u32, [f32; 3], f32)>,
    kernels: Vec<Candidate>,
}

/// Resamples all frames once.
///
/// # Errors
/// Those of reading frames.
pub fn resample(stage: &mut Stage, progress: impl Fn() + Sync) -> Result<(Measured, Kernels)> {
    let colours = Colours::new();
    let mut measured = Measured::new(stage.surface.mesh.positions.len());
    let mut kernels: Vec<Option<Candidate>> = vec![None; stage.atlas.texels.len()];
    let mut losses = stage.losses;
    let all: Vec<usize> = (0..stage.beams.len()).collect();
    for batch in all.chunks(BATCH) {
        let one = |&beam: &usize| {
            let response = respond(stage, beam, &colours);
            progress();
            response
        };
        let responses: Vec<_> = batch.par_iter().map(one).collect::<Result<_>>()?;
        for (&beam, response) in batch.iter().zip(responses) {
            match response {
                Ok((response, clipped)) => {
                    losses.clipped += clipped;
                    add(stage, beam, response, &mut measured, &mut kernels);
                }
                Err(failure) => count(&mut losses, &failure),
            }
        }
    }
    stage.losses = losses;
    Ok((measured, Kernels(kernels)))
}

fn count(losses: &mut Losses, failure: &Failure) {
    match failure {
        Failure::Missing => losses.missing += 1,
        Failure::Dark => losses.dark += 1,
    }
}

fn respond(stage: &Stage, beam: usize, colours: &Colours) -> Result<std::result::Result<(Response, usize), Failure>> {
    let (exposure, clipped) = match Exposure::read(stage, beam, colours)? {
        Ok(read) => read,
        Err(failure) => return Ok(Err(failure)),
    };
    let spot = SPOT * stage.capture.rig.laser.beam_diameter_mm as f32;
    let (at, positions) = (stage.beams[beam].at, &stage.surface.mesh.positions);
    let vertex = |v: usize| {
        let near = at.distance(positions[v].into()) < spot;
        let (rgb, weight) = exposure.sample(stage, colours, near, |view| stage.views[view].vertices[v].as_ref())?;
        Some((v as u32, rgb, weight))
    };
    let vertices = (0..positions.len()).filter_map(vertex).collect();
    let kernels = measure_kernels(stage, beam, |texel| {
        let near = at.distance(stage.atlas.texels[texel].at) < spot;
        exposure.sample(stage, colours, near, |view| stage.views[view].texels[texel].as_ref())
    });
    Ok(Ok((Response { vertices, kernels }, clipped)))
}

/// The light counts for the corners of its triangle by its barycentric coordinates [Goesele 2004, §6.1].
fn add(stage: &Stage, beam: usize, response: Response, measured: &mut Measured, kernels: &mut [Option<Candidate>]) {
    let beam = &stage.beams[beam];
    for (&corner, weight) in stage.corners(beam.face).iter().zip(beam.weights()).filter(|(_, w)| *w >= LEAST) {
        measured.light(corner as usize, weight);
        for &(seen, rgb, w) in &response.vertices {
            measured.add(corner as usize, seen as usize, rgb, weight * w);
        }
    }
    for candidate in response.kernels {
        let slot = &mut kernels[candidate.texel as usize];
        if slot.as_ref().is_none_or(|best| candidate.offset < best.offset) {
            *slot = Some(candidate);
        }
    }
}
