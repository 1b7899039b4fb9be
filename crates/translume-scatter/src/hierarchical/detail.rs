//! The modulation texture T [Goesele 2004, §6.3]: what a texel sends over what the interpolated F says, of all pictures, outside of the
//! kernels' reach. It adds detail between the vertices and leaves the vertices as they are.
//!
//! The paper has a mean of ratios weighted by confidence; here it is a ratio of sums, in which every picture counts by the square root of
//! its light: noise of dark pictures does not decide, nor does the place nearest to the spot alone.

use super::colour::Colours;
use super::pairs::Throughput;
use super::refine::{for_beams, samples};
use super::stage::Stage;
use translume_image::Result;

/// Ratios beyond this, or below its reciprocal, are noise or edges of shadows.
const MOST: f32 = 8.0;

/// T of each texel and the sum of weights behind it; 1 and 0 where nothing was measured.
pub(super) type Detail = (Vec<[f32; 3]>, Vec<f32>);

/// Another run through all frames.
///
/// # Errors
/// Those of reading frames.
pub(super) fn detail(stage: &Stage, f: &Throughput, progress: impl Fn() + Sync) -> Result<Detail> {
    let colours = Colours::new();
    // For each texel the measured and the expected, red, green, blue, and the weight.
    let mut sums = vec![[0.0f32; 7]; stage.atlas.texels.len()];
    let one = |beam: usize| {
        progress();
        samples(stage, beam, f, &colours)
    };
    for_beams(stage, one, |_, told| {
        for (t, expected, rgb, weight) in told {
            let sum = &mut sums[t as usize];
            for c in 0..3 {
                let share = weight / expected[c].sqrt();
                sum[c] += share * rgb[c];
                sum[3 + c] += share * expected[c];
            }
            sum[6] += weight;
        }
    })?;
    let ratio = |s: &[f32; 7]| match s[6] > 0.0 {
        // [Goesele 2004, §6.3]
        true => [0, 1, 2].map(|c| (s[c] / s[3 + c]).clamp(1.0 / MOST, MOST)),
        false => [1.0; 3],
    };
    Ok((sums.iter().map(ratio).collect(), sums.iter().map(|s| s[6]).collect()))
}
