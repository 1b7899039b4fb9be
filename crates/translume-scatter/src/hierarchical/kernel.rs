//! Local kernels from single spots [Goesele 2004, §7.1]: a smooth fall-off m(d) from the sub-pixel peak, and the surface detail C = m/measured
//! of the 8 × 8 texels around it, which stays where it is when the peak is shifted to its four neighbouring texels.
//!
//! m(d) = c₁ e^(λ₁ d) + c₂ e^(λ₂ d), λ shared by the channels. First λ₁ and c₁ in log space on d > ζ₁, with c₂ = 0; then λ₂ and c₂ on d < ζ₂; then
//! the colours on all data. ζ₁ and ζ₂ are 5 and 3.5 texels, the first less than the paper's 3 mm and 1 mm over its texels of 0.4 mm, because the
//! data here is what lies on the atlas within 8 texels. All three are linear least squares of relative errors.

use super::atlas::RADIUS;
use super::stage::Stage;

/// Distances at which a fall-off is kept, in texels; linear in the logarithm between them.
pub(super) const KNOTS: [f32; 9] = [0.0, 0.7, 1.4, 2.1, 3.0, 4.0, 5.5, 7.5, 10.0];
/// Values of a kernel.
pub(super) const CELLS: usize = ((2 * RADIUS + 1) * (2 * RADIUS + 1)) as usize;
/// Half the window of the fit, in texels.
const WINDOW: i32 = 8;
/// The paper's ζ₁ and ζ₂, in texels.
const ZETA: [f32; 2] = [5.0, 3.5];
/// Most of ln C: noise and misplaced texels are no detail.
const MOST_DETAIL: f32 = 1.5;
/// Samples that a fit needs.
const FEWEST: usize = 16;

/// A kernel before the split: ln m at [`KNOTS`] for each channel, then ln C of its cells for each channel.
pub(super) const RECORD: usize = 3 * (KNOTS.len() + CELLS);

/// A measured kernel for a texel.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    pub(super) texel: u32,
    /// The laser position that it was measured with.
    pub(super) beam: u32,
    /// Distance from the peak to the texel's centre, in texels.
    pub(super) offset: f32,
    pub(super) record: Vec<f32>,
    /// Share of the cells that was measured.
    pub(super) confidence: f32,
}

/// Cells of a kernel, row by row.
pub(super) fn cells() -> impl Iterator<Item = (i32, i32)> {
    (-RADIUS..=RADIUS).flat_map(|dy| (-RADIUS..=RADIUS).map(move |dx| (dx, dy)))
}

/// The kernels of the four texels around a beam's peak; none where too little of its surroundings is seen.
pub(super) fn measure_kernels(
    stage: &Stage,
    beam: usize,
    sample: impl Fn(usize) -> Option<([f32; 3], f32)>,
) -> Vec<Candidate> {
    let (index, beam, atlas) = (beam as u32, &stage.beams[beam], &stage.atlas);
    let peak = atlas.flat(beam.face, beam.uv) - 0.5;
    let base = peak.floor();
    if !base.is_finite() {
        return Vec::new();
    }
    let texel_at = |dx: i32, dy: i32| atlas.own(base.x as i32 + dx, base.y as i32 + dy);
    // Any texel of the chart near the peak leads to the others, also over borders.
    let Some((first, [fx, fy])) =
        (0..2).flat_map(|y| (0..2).map(move |x| [x, y])).find_map(|d| Some((texel_at(d[0], d[1])?, d)))
    else {
        return Vec::new();
    };
    let side = (2 * WINDOW) as usize;
    let mut samples: Vec<Option<([f32; 3], f32)>> = vec![None; side * side];
    let offset = |k: usize| (k as i32 % (2 * WINDOW) - WINDOW + 1, k as i32 / (2 * WINDOW) - WINDOW + 1);
    let mut data = Vec::new();
    for (k, slot) in samples.iter_mut().enumerate() {
        let (dx, dy) = offset(k);
        let Some(texel) = atlas.neighbour(first, dx - fx, dy - fy) else { continue };
        let d = atlas.texels[texel].at.distance(beam.at) / atlas.texel_mm;
        // Two texels of the atlas that are no neighbours on the surface.
        if d > 2.2 * ((dx * dx + dy * dy) as f32).sqrt() + 3.0 {
            continue;
        }
        *slot = sample(texel).filter(|s| s.0.iter().all(|r| *r > 1e-12)).map(|(rgb, _)| (rgb, d));
        data.extend(*slot);
    }
    let Some(fall_off) = FallOff::fit(&data) else { return Vec::new() };
    let ln_detail = |dx: i32, dy: i32, c: usize| -> Option<f32> {
        let k = (dy + WINDOW - 1) * 2 * WINDOW + dx + WINDOW - 1;
        let (rgb, d) = samples[k as usize]?;
        // C = m(d)/measured [Goesele 2004, §7.1]
        Some((fall_off.value(d, c).ln() - rgb[c].ln()).clamp(-MOST_DETAIL, MOST_DETAIL))
    };
    let shifted = |dx: i32, dy: i32| -> Option<Candidate> {
        let texel = texel_at(dx, dy)?;
        let offset = (peak - (base + glam::Vec2::new(dx as f32, dy as f32))).length();
        let mut record = Vec::with_capacity(RECORD);
        (0..3).for_each(|c| record.extend(KNOTS.iter().map(|&d| fall_off.value(d, c).ln())));
        (0..3).for_each(|c| {
            record.extend(cells().map(|(x, y)| ln_detail(dx + x, dy + y, c).unwrap_or(0.0)));
        });
        let seen = cells().filter(|(x, y)| ln_detail(dx + x, dy + y, 0).is_some()).count();
        Some(Candidate { texel: texel as u32, beam: index, offset, record, confidence: seen as f32 / CELLS as f32 })
    };
    (0..2).flat_map(|y| (0..2).map(move |x| (x, y))).filter_map(|(x, y)| shifted(x, y)).collect()
}

/// ln m at a distance in texels, from a record's knots of one channel.
pub(super) fn ln_fall_off(knots: &[f32], d: f32) -> f32 {
    let k = KNOTS.partition_point(|&x| x <= d).clamp(1, KNOTS.len() - 1);
    let t = (d - KNOTS[k - 1]) / (KNOTS[k] - KNOTS[k - 1]);
    knots[k - 1] + t * (knots[k] - knots[k - 1])
}

/// c₁ e^(λ₁ d) + c₂ e^(λ₂ d), distances in texels.
#[derive(Debug)]
struct FallOff {
    c: [[f64; 2]; 3],
    lambda: [f64; 2],
}

impl FallOff {
    fn value(&self, d: f32, channel: usize) -> f32 {
        let [c1, c2] = self.c[channel];
        // [Goesele 2004, §7.1 m(d)]
        (c1 * (self.lambda[0] * f64::from(d)).exp() + c2 * (self.lambda[1] * f64::from(d)).exp()).max(1e-12) as f32
    }

    /// [Goesele 2004, §7.1 fit]
    fn fit(data: &[([f32; 3], f32)]) -> Option<Self> {
        if data.len() < FEWEST {
            return None;
        }
        let far: Vec<_> =
            data.iter().filter(|s| s.1 > ZETA[0]).map(|s| (s.0.map(|r| f64::from(r).ln()), f64::from(s.1))).collect();
        let first = if far.len() >= FEWEST / 2 { log_line(&far) } else { None };
        // Without anything far, or with a rise outwards: one exponential for all.
        let all: Vec<_> = data.iter().map(|s| (s.0.map(|r| f64::from(r).ln()), f64::from(s.1))).collect();
        let (lambda1, ln_c1) = match first.filter(|f| f.0 < 0.0) {
            Some(line) => line,
            None => log_line(&all).map(|(l, c)| (l.min(-1e-3), c))?,
        };
        let excess = |s: &([f32; 3], f32)| -> Option<([f64; 3], f64)> {
            let d = f64::from(s.1);
            let rest = [0, 1, 2].map(|c| f64::from(s.0[c]) - (ln_c1[c] + lambda1 * d).exp());
            rest.iter().all(|r| *r > 0.0).then(|| (rest.map(f64::ln), d))
        };
        let near: Vec<_> = data.iter().filter(|s| s.1 < ZETA[1]).filter_map(excess).collect();
        let second = if near.len() >= 6 { log_line(&near) } else { None };
        let one = || Self { c: ln_c1.map(|c| [c.exp(), 0.0]), lambda: [lambda1, lambda1] };
        let Some((lambda2, _)) = second.filter(|s| s.0 < 1.2 * lambda1) else { return Some(one()) };
        let lambda = [lambda1, lambda2];
        let colours = [0, 1, 2].map(|c| amplitudes(data, c, lambda));
        match colours {
            [Some(r), Some(g), Some(b)] => Some(Self { c: [r, g, b], lambda }),
            _ => Some(one()),
        }
    }
}

/// One slope and an intercept for each channel, least squares.
fn log_line(data: &[([f64; 3], f64)]) -> Option<(f64, [f64; 3])> {
    let n = data.len() as f64;
    let mean_d = data.iter().map(|s| s.1).sum::<f64>() / n;
    let mean = [0, 1, 2].map(|c| data.iter().map(|s| s.0[c]).sum::<f64>() / n);
    let (mut up, mut down) = (0.0, 0.0);
    for (ln, d) in data {
        (0..3).for_each(|c| up += (d - mean_d) * (ln[c] - mean[c]));
        down += 3.0 * (d - mean_d).powi(2);
    }
    let slope = up / down;
    (down > 1e-9 && slope.is_finite()).then(|| (slope, mean.map(|m| m - slope * mean_d)))
}

/// c₁ and c₂ of least relative errors; `None` if the sum would not be positive everywhere.
fn amplitudes(data: &[([f32; 3], f32)], channel: usize, lambda: [f64; 2]) -> Option<[f64; 2]> {
    let (mut a, mut b) = ([[0.0f64; 2]; 2], [0.0f64; 2]);
    for (rgb, d) in data {
        let row = lambda.map(|l| (l * f64::from(*d)).exp() / f64::from(rgb[channel]));
        for i in 0..2 {
            (0..2).for_each(|j| a[i][j] += row[i] * row[j]);
            b[i] += row[i];
        }
    }
    let det = a[0][0] * a[1][1] - a[0][1] * a[1][0];
    let c = [(b[0] * a[1][1] - b[1] * a[0][1]) / det, (b[1] * a[0][0] - b[0] * a[1][0]) / det];
    // The slow one alone is left far away, the sum at the peak.
    (det > 1e-12 * a[0][0] * a[1][1] && c[0] > 0.0 && c[0] + c[1] > 0.0).then_some(c)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_exponentials_are_found_with_their_colours() {
        let truth = |d: f64| [1.0, 0.6, 0.3].map(|s| (s * (0.02 * (-0.25 * d).exp() + 0.3 * (-1.6 * d).exp())) as f32);
        let data: Vec<_> = (0..400).map(|i| 10.0 * f64::from(i) / 400.0).map(|d| (truth(d), d as f32)).collect();
        let fit = FallOff::fit(&data).unwrap();
        for d in [0.0f32, 0.5, 1.0, 2.0, 4.0, 8.0] {
            for c in 0..3 {
                let (found, expected) = (fit.value(d, c), truth(f64::from(d))[c]);
                assert!((found / expected - 1.0).abs() < 0.15, "{d} {c}: {found} {expected}");
            }
        }
        // Kept at knots, it is still the same.
        let knots: Vec<f32> = KNOTS.iter().map(|&d| truth(f64::from(d))[0].ln()).collect();
        for d in [0.3f32, 2.5, 6.0] {
            assert!((ln_fall_off(&knots, d) - truth(f64::from(d))[0].ln()).abs() < 0.12, "{d}");
        }
    }

    #[test]
    fn a_single_exponential_and_too_few_samples() {
        let data: Vec<_> = (0..60).map(|i| i as f32 / 6.0).map(|d| ([(-0.8 * d).exp(); 3], d)).collect();
        let fit = FallOff::fit(&data).unwrap();
        assert!([0.0f32, 3.0, 9.0].iter().all(|&d| (fit.value(d, 1) / (-0.8 * d).exp() - 1.0).abs() < 0.02), "{fit:?}");
        assert!(FallOff::fit(&data[..8]).is_none());
    }
}
