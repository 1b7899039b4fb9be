//! The kernels' fall-offs and gains from all measurements that they cover.
//!
//! A kernel of a single spot [Goesele 2004, §7.1] has the noise of that spot; its two exponentials have a cusp where a beam of some width is round;
//! and a kernel between spots comes from its neighbours. So what the kernels of all spots say is held against what was measured near all spots, as
//! relighting would show it, and corrected by the ratio of the sums of both: by distance from the spot, the same on the whole object, and by a
//! gain for each texel that is seen. Gains are smoothed over the surface in favour of those of bright texels. How much the kernels and the gains are smoothed is
//! chosen by spots held out: every fifth, whose light is predicted from the others.

use super::colour::Colours;
use super::kernel::{CELLS, Candidate, KNOTS, cells};
use super::pairs::Throughput;
use super::refine::{covered, for_beams};
use super::resample::Exposure;
use super::split::{Records, near_enough, texel_graph};
use super::stage::Stage;
use crate::laplace::Known;
use translume_image::Result;
use translume_mesh::TriMesh;

/// Every spot of this many is held out when smoothing is chosen.
const HELD: u32 = 5;
/// Rounds of corrections.
const ROUNDS: usize = 6;
/// Strengths of single kernels, and of gains of texels as bright as the mean, against their neighbours.
const SMOOTHING: [(f32, f32); 6] = [(0.3, 3.0), (0.3, 0.5), (0.3, 0.1), (0.03, 0.5), (0.03, 0.1), (0.003, 0.03)];

/// A texel that is seen in a kernel's reach of a spot.
pub(super) struct Near {
    beam: u32,
    texel: u32,
    /// Cells of its kernel that are lit, with their distance in texels and share of the light.
    lit: Vec<(u8, f32, f32)>,
    /// What F adds beside the kernels.
    rest: [f32; 3],
    measured: [f32; 3],
    /// Confidence times area.
    weight: f32,
}

/// All measurements near spots.
///
/// # Errors
/// Those of reading frames.
pub(super) fn near(stage: &Stage, mesh: &TriMesh, f: &Throughput, detail: &[[f32; 3]]) -> Result<Vec<Near>> {
    let (colours, atlas) = (Colours::new(), &stage.atlas);
    let place = |t: usize| {
        let texel = &atlas.texels[t];
        let [u, v] = texel.uv;
        (mesh.indices[texel.face as usize], [1.0 - u - v, u, v])
    };
    let spot = stage.capture.rig.laser.beam_diameter_mm as f32;
    let one = |index: usize| -> Result<Vec<Near>> {
        let Ok((exposure, _)) = Exposure::read(stage, index, &colours)? else { return Ok(Vec::new()) };
        let beam = &stage.beams[index];
        let lights = atlas.between(beam.face, beam.uv);
        let at = |&t: &u32| {
            let t = t as usize;
            let near = beam.at.distance(atlas.texels[t].at) < spot;
            let (measured, confidence) =
                exposure.sample(stage, &colours, near, |view| stage.views[view].texels[t].as_ref())?;
            let mut rest = f.between((stage.corners(beam.face), beam.weights()), place(t));
            let mut lit = Vec::new();
            for (cell, (dx, dy)) in cells().enumerate() {
                let Some(n) = atlas.neighbour(t, dx, dy) else { continue };
                let d = atlas.texels[n].at.distance(atlas.texels[t].at) / atlas.texel_mm;
                for &(_, share) in lights.iter().filter(|l| l.0 as usize == n && l.1 > 0.0 && near_enough(dx, dy, d)) {
                    lit.push((cell as u8, d, share));
                    let global = f.between(place(n), place(t));
                    (0..3).for_each(|c| rest[c] -= share * global[c]);
                }
            }
            (0..3).for_each(|c| rest[c] *= detail[t][c]);
            let weight = confidence * atlas.texels[t].area;
            (!lit.is_empty()).then_some(Near { beam: index as u32, texel: t as u32, lit, rest, measured, weight })
        };
        Ok(covered(atlas, beam).iter().filter_map(at).collect())
    };
    let mut all = Vec::new();
    for_beams(stage, one, |_, told| all.extend(told))?;
    Ok(all)
}

/// Kernels of all texels that show what was measured near the spots, and the error of the light of spots held out. `None` without any kernel.
pub(super) fn fitted(stage: &Stage, kernels: &[Option<Candidate>], near: &[Near]) -> Option<(Records, f64)> {
    let held = |beam: u32| beam % HELD == HELD - 1;
    let kept: Vec<Option<Candidate>> = kernels.iter().map(|k| k.as_ref().filter(|k| !held(k.beam)).cloned()).collect();
    let mut best: Option<(f64, (f32, f32))> = None;
    for smoothing in SMOOTHING {
        let Some(records) = corrected(stage, &kept, near, smoothing, |beam| !held(beam)) else { continue };
        let error = error(&records, near, held);
        if best.is_none_or(|b| error < b.0) {
            best = Some((error, smoothing));
        }
    }
    let (error, smoothing) = best.unwrap_or((f64::NAN, SMOOTHING[0]));
    Some((corrected(stage, kernels, near, smoothing, |_| true)?, error))
}

/// Records of `kernels`, corrected by the spots that are `used`.
fn corrected(
    stage: &Stage,
    kernels: &[Option<Candidate>],
    near: &[Near],
    smoothing: (f32, f32),
    used: impl Fn(u32) -> bool,
) -> Option<Records> {
    let mut records = Records::fill(&stage.atlas, kernels, smoothing.0)?;
    let graph = texel_graph(&stage.atlas);
    for round in 0..ROUNDS {
        // By distance: sums of what was measured and of what is said, shared between the knots around.
        let mut radial = [[[0.0f64; 2]; KNOTS.len()]; 3];
        let mut gains = vec![[0.0f32; 6]; stage.atlas.texels.len()];
        for n in near.iter().filter(|n| used(n.beam)) {
            let said = said(&records, n);
            let d = n.lit.iter().map(|l| l.1 * l.2).sum::<f32>() / n.lit.iter().map(|l| l.2).sum::<f32>();
            let knot = KNOTS.partition_point(|&x| x <= d).clamp(1, KNOTS.len() - 1);
            let t = f64::from(((d - KNOTS[knot - 1]) / (KNOTS[knot] - KNOTS[knot - 1])).clamp(0.0, 1.0));
            for c in 0..3 {
                for (i, both) in [n.measured[c] - n.rest[c], said[c] - n.rest[c]].into_iter().enumerate() {
                    radial[c][knot - 1][i] += (1.0 - t) * f64::from(n.weight * both);
                    radial[c][knot][i] += t * f64::from(n.weight * both);
                    gains[n.texel as usize][3 * i + c] += n.weight * both;
                }
            }
        }
        // Alternately, because both would correct the same error twice.
        match round % 2 == 0 {
            true => records.bend(&radial),
            false => {
                let mean = gains.iter().map(|g| g[4]).sum::<f32>() / gains.len() as f32;
                let known = |g: &[f32; 6]| -> Known {
                    let ln = [0, 1, 2].map(|c| (g[c].max(0.2 * g[3 + c]) / g[3 + c]).min(5.0).ln());
                    match g[3..].iter().all(|s| *s > 0.0) {
                        true => [ln[0], ln[1], ln[2], smoothing.1 * g[4] / mean],
                        false => [0.0; 4],
                    }
                };
                let known: Vec<Known> = gains.iter().map(known).collect();
                records.amplify(&graph.fill(&known, [0.0; 3], 40));
            }
        }
    }
    Some(records)
}

/// What the kernels and F say about a measurement.
fn said(records: &Records, near: &Near) -> [f32; 3] {
    [0, 1, 2].map(|c| {
        let cell =
            |&(cell, d, share): &(u8, f32, f32)| share * records.measured(near.texel as usize, cell.into(), d, c);
        near.rest[c] + near.lit.iter().map(cell).sum::<f32>()
    })
}

/// Root mean square over the spots of the relative error of the light around them.
fn error(records: &Records, near: &[Near], wanted: impl Fn(u32) -> bool) -> f64 {
    let (mut sum, mut spots) = (0.0, 0.0);
    for spot in near.chunk_by(|a, b| a.beam == b.beam).filter(|s| wanted(s[0].beam)) {
        let mut light = [[0.0f64; 2]; 3];
        for n in spot {
            let said = said(records, n);
            for c in 0..3 {
                light[c][0] += f64::from(n.weight * said[c]);
                light[c][1] += f64::from(n.weight * n.measured[c]);
            }
        }
        for [said, measured] in light.into_iter().filter(|l| l[1] > 0.0) {
            sum += (said / measured - 1.0).powi(2);
            spots += 1.0;
        }
    }
    (sum / f64::max(spots, 1.0)).sqrt()
}

const _: () = assert!(CELLS <= u8::MAX as usize);
