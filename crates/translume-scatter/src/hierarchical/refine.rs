//! F again, from what it leaves of the measurements.
//!
//! A mean of measurements around a vertex is more than the value at the vertex where R_d is steep, because R_d is convex; and linear
//! interpolation between vertices lies above a convex function once more, on the side that is lit and on the side that is seen. Together they
//! made half as much light again at distances of two to four edges. So F is corrected by the ratio of the measurements to what the interpolated F
//! says about them, F_kr ← F_kr Σ a m/p / Σ a over all measurements m with prediction p that the pair has a share a in: the iteration of Richardson
//! and Lucy, which finds the likeliest F under photon noise, converges from any positive start and needs no logarithm of dark samples. Each
//! round's F goes through the completion again, so what was not measured follows. Measurements that a kernel covers do not count here: there K
//! has the rest.

use super::atlas::{Atlas, RADIUS};
use super::colour::Colours;
use super::pairs::{Measured, Throughput};
use super::resample::Exposure;
use super::stage::{Beam, Stage};
use rayon::prelude::*;
use translume_image::Result;

/// Positions in parallel before what they say is added up in their order.
const BATCH: usize = 32;
/// Barycentric weights below this are too small to say something about a vertex.
const LEAST: f32 = 0.05;
/// What is taken for sure before any measurement: weight of the ratio 1.
const PRIOR: f32 = 0.02;

/// Predicted and measured light of one beam at the texels that no kernel covers: texel, prediction, measurement, weight.
pub(super) type Sample = (u32, [f32; 3], [f32; 3], f32);

/// What F says about the exposure of a beam, beside the measurements.
pub(super) fn samples(stage: &Stage, beam: usize, f: &Throughput, colours: &Colours) -> Result<Vec<Sample>> {
    let Ok((exposure, _)) = Exposure::read(stage, beam, colours)? else { return Ok(Vec::new()) };
    let beam = &stage.beams[beam];
    let mut global = vec![[0.0f32; 3]; f.vertices];
    for (&k, w) in stage.corners(beam.face).iter().zip(beam.weights()) {
        for (r, sum) in global.iter_mut().enumerate() {
            let value = f.value(r, k as usize);
            (0..3).for_each(|c| sum[c] += w * value[c]);
        }
    }
    let covered = covered(&stage.atlas, beam);
    let one = |(t, texel): (usize, &super::atlas::Texel)| {
        if covered.binary_search(&(t as u32)).is_ok() {
            return None;
        }
        let (rgb, weight) = exposure.sample(stage, colours, false, |view| stage.views[view].texels[t].as_ref())?;
        let [u, v] = texel.uv;
        let mut expected = [0.0f32; 3];
        for (&r, w) in stage.corners(texel.face).iter().zip([1.0 - u - v, u, v]) {
            (0..3).for_each(|c| expected[c] += w * global[r as usize][c]);
        }
        expected.iter().all(|e| *e > 0.0).then_some((t as u32, expected, rgb, weight))
    };
    Ok(stage.atlas.texels.iter().enumerate().filter_map(one).collect())
}

/// Texels, in order, that see some light of a beam through a kernel.
pub(super) fn covered(atlas: &Atlas, beam: &Beam) -> Vec<u32> {
    let lit = atlas.between(beam.face, beam.uv).into_iter().filter(|l| l.1 > 0.0);
    let around = |(t, _): (u32, f32)| {
        (-RADIUS..=RADIUS)
            .flat_map(move |dy| (-RADIUS..=RADIUS).filter_map(move |dx| atlas.neighbour(t as usize, dx, dy)))
    };
    let mut all: Vec<u32> = lit.flat_map(around).map(|t| t as u32).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// Runs `one` for all beams in parallel and `add` in their order.
pub(super) fn for_beams<T: Send>(
    stage: &Stage,
    one: impl Fn(usize) -> Result<T> + Sync,
    mut add: impl FnMut(usize, T),
) -> Result<()> {
    let all: Vec<usize> = (0..stage.beams.len()).collect();
    for batch in all.chunks(BATCH) {
        let told: Vec<T> = batch.par_iter().map(|&beam| one(beam)).collect::<Result<_>>()?;
        batch.iter().zip(told).for_each(|(&beam, t)| add(beam, t));
    }
    Ok(())
}

/// Pairs as the ratios of the measurements to `f` say they are, to be completed.
///
/// # Errors
/// Those of reading frames.
pub(super) fn corrected(stage: &Stage, f: &Throughput, progress: impl Fn() + Sync) -> Result<Measured> {
    let colours = Colours::new();
    let mut measured = Measured::new(f.vertices);
    // For each vertex that is seen, the ratio of its surroundings and their weight.
    let one = |beam: usize| -> Result<Vec<(u32, [f32; 3], f32)>> {
        let mut sums = vec![[0.0f32; 4]; f.vertices];
        for (t, expected, rgb, weight) in samples(stage, beam, f, &colours)? {
            let texel = &stage.atlas.texels[t as usize];
            let [u, v] = texel.uv;
            for (&r, w) in stage.corners(texel.face).iter().zip([1.0 - u - v, u, v]) {
                let (sum, w) = (&mut sums[r as usize], w * weight);
                (0..3).for_each(|c| sum[c] += w * rgb[c] / expected[c]);
                sum[3] += w;
            }
        }
        progress();
        let ratio =
            |(r, s): (usize, &[f32; 4])| (s[3] > LEAST).then(|| (r as u32, [0, 1, 2].map(|c| s[c] / s[3]), s[3]));
        Ok(sums.iter().enumerate().filter_map(ratio).collect())
    };
    for_beams(stage, one, |beam, seen| {
        let beam = &stage.beams[beam];
        for (&k, share) in stage.corners(beam.face).iter().zip(beam.weights()).filter(|(_, w)| *w >= LEAST) {
            measured.light(k as usize, share);
            for &(r, ratio, weight) in &seen {
                let old = f.value(k as usize, r as usize);
                measured.add(k as usize, r as usize, [0, 1, 2].map(|c| old[c] * ratio[c]), share * weight);
            }
        }
    })?;
    measured.draw_to(f, PRIOR);
    Ok(measured)
}
