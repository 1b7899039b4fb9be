//! The modulation texture T [Goesele 2004, §6.3]: the mean over all pictures of what a texel sends over what the interpolated F says, far
//! from the spot, weighted by confidence. It adds detail between the vertices and leaves the vertices as they are.

use super::colour::Colours;
use super::pairs::Throughput;
use super::resample::Exposure;
use super::split::reach_mm;
use super::stage::Stage;
use rayon::prelude::*;
use translume_image::Result;

/// Positions in parallel before their ratios are added up in their order.
const BATCH: usize = 16;
/// A texel counts from this many reaches of a kernel away from the spot on.
const FAR: f32 = 2.0;
/// Ratios beyond this, or below its reciprocal, are noise or edges of shadows.
const MOST: f32 = 8.0;

/// T of each texel and the sum of weights behind it; 1 and 0 where nothing was measured.
pub(super) type Detail = (Vec<[f32; 3]>, Vec<f32>);

/// A second run through all frames.
///
/// # Errors
/// Those of reading frames.
pub(super) fn detail(stage: &Stage, f: &Throughput, progress: impl Fn() + Sync) -> Result<Detail> {
    let mut sums = vec![[0.0f32; 4]; stage.atlas.texels.len()];
    let colours = Colours::new();
    let all: Vec<usize> = (0..stage.beams.len()).collect();
    for batch in all.chunks(BATCH) {
        let one = |&beam: &usize| {
            let ratios = ratios(stage, beam, f, &colours);
            progress();
            ratios
        };
        let told: Vec<_> = batch.par_iter().map(one).collect::<Result<_>>()?;
        for (texel, ratio, w) in told.into_iter().flatten() {
            let sum = &mut sums[texel as usize];
            (0..3).for_each(|c| sum[c] += w * ratio[c]);
            sum[3] += w;
        }
    }
    let mean = |s: &[f32; 4]| if s[3] > 0.0 { [s[0] / s[3], s[1] / s[3], s[2] / s[3]] } else { [1.0; 3] };
    Ok((sums.iter().map(mean).collect(), sums.iter().map(|s| s[3]).collect()))
}

/// Texel, ratio, weight.
type Ratio = (u32, [f32; 3], f32);

fn ratios(stage: &Stage, beam: usize, f: &Throughput, colours: &Colours) -> Result<Vec<Ratio>> {
    let Ok((exposure, _)) = Exposure::read(stage, beam, colours)? else { return Ok(Vec::new()) };
    let beam = &stage.beams[beam];
    // What F says about all vertices.
    let mut global = vec![[0.0f32; 3]; f.vertices];
    for (&k, w) in stage.corners(beam.face).iter().zip(beam.weights()) {
        for (r, sum) in global.iter_mut().enumerate() {
            let value = f.value(r, k as usize);
            (0..3).for_each(|c| sum[c] += w * value[c]);
        }
    }
    let far = FAR * reach_mm(&stage.atlas);
    let one = |(t, texel): (usize, &super::atlas::Texel)| {
        if texel.at.distance(beam.at) < far {
            return None;
        }
        let (rgb, weight) = exposure.sample(stage, colours, false, |view| stage.views[view].texels[t].as_ref())?;
        let [u, v] = texel.uv;
        let mut expected = [0.0f32; 3];
        for (&r, w) in stage.corners(texel.face).iter().zip([1.0 - u - v, u, v]) {
            (0..3).for_each(|c| expected[c] += w * global[r as usize][c]);
        }
        let ratio = [0, 1, 2].map(|c| rgb[c] / expected[c]);
        ratio.iter().all(|r| (1.0 / MOST..MOST).contains(r)).then_some((t as u32, ratio, weight))
    };
    Ok(stage.atlas.texels.iter().enumerate().filter_map(one).collect())
}
