//! The camera's response by least squares [Debevec & Malik 1997], per channel.
//!
//! Unknown are g(z) = ln of the exposure that makes code z, on a grid of 256 codes, and one log radiance per sample.
//! The radiances are eliminated before solving, so the system has 256 unknowns whatever the number of samples. Codes
//! may be fractional (16-bit files, interpolated pixels): a measurement then ties the two nodes beside it.
//!
//! Deviations from the paper. Smooth is not the curve itself but its difference from a base: for all channels together
//! the sRGB curve, for one channel the common curve. Exposures a constant ratio apart leave any function free that
//! repeats with that ratio; against a base the free part stays flat, where a smooth log curve would bend at its dark end
//! or climb in stairs. Samples are weighed by a trapezoid instead of the paper's hat, which leaves the toe of the curve,
//! where cameras differ most, to the smoothness. Residuals are reweighted a few times, so that samples on moving things do not bend the curve; the
//! result is made monotone.

use crate::{Error, Result};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Nodes of a curve, at codes 0, 1/255, …, 1.
pub const NODES: usize = 256;

/// Natural log of exposure over code for the three channels; 0 at mid code.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Response {
    /// `log_exposure[channel][node]`, strictly increasing.
    pub log_exposure: [Vec<f32>; 3],
}

/// One scene point seen in several exposures: `codes[picture]` in [0, 1], `None` where the picture does not see it.
pub(crate) type Sample = Vec<Option<f32>>;

impl Response {
    /// The response of a sensor whose codes are proportional to exposure.
    pub fn linear() -> Self {
        let mid = 0.5f32;
        // Half a step instead of zero keeps the first node finite.
        let curve: Vec<f32> = (0..NODES).map(|z| ((z as f32).max(0.25) / (NODES - 1) as f32 / mid).ln()).collect();
        Self { log_exposure: [curve.clone(), curve.clone(), curve] }
    }

    /// g at code `u` in [0, 1], linear between nodes.
    #[inline]
    pub fn log_exposure(&self, channel: usize, u: f32) -> f32 {
        let at = (u * (NODES - 1) as f32).clamp(0.0, (NODES - 1) as f32);
        let i = (at as usize).min(NODES - 2);
        let g = &self.log_exposure[channel];
        g[i] + (at - i as f32) * (g[i + 1] - g[i])
    }

    /// dg/du at code `u`.
    #[inline]
    pub fn slope(&self, channel: usize, u: f32) -> f32 {
        let i = ((u * (NODES - 1) as f32) as usize).clamp(1, NODES - 2);
        let g = &self.log_exposure[channel];
        (g[i + 1] - g[i - 1]) * 0.5 * (NODES - 1) as f32
    }

    /// Checks a curve that came from a file: three increasing curves of 256 finite values.
    ///
    /// # Errors
    /// [`Error::Response`] that says what is wrong.
    pub fn validate(&self) -> Result<()> {
        for (c, g) in self.log_exposure.iter().enumerate() {
            if g.len() != NODES {
                return Err(Error::Response(format!("channel {c} has {} values, not {NODES}", g.len())));
            }
            if g.iter().any(|v| !v.is_finite()) || g.windows(2).any(|w| w[1] < w[0]) {
                return Err(Error::Response(format!("channel {c} is not an increasing curve of finite values")));
            }
        }
        Ok(())
    }
}

/// Weight of the curvature of the difference from the base, per measurement and node.
const SMOOTHNESS: f64 = 4.0;
/// Weight of the difference itself, per measurement and node, which carries the base to codes nobody has seen.
const TO_BASE: f64 = 1e-5;
/// Residual (ln units) beyond which a measurement counts less.
const HUBER: f64 = 0.1;

/// The sRGB curve as a base: ln of linear light over code, 0 at mid code.
fn srgb_base() -> Vec<f64> {
    let linear = |u: f64| if u <= 0.04045 { u / 12.92 } else { ((u + 0.055) / 1.055).powf(2.4) };
    (0..NODES).map(|z| (linear((z as f64).max(0.25) / (NODES - 1) as f64) / linear(0.5)).ln()).collect()
}

/// The response of three channels: `samples[channel]` as codes, `log_secs[picture]` the log of the relative exposures,
/// `start` a curve that tells outliers before there is a better one.
///
/// # Errors
/// [`Error::Response`] when too few samples are well exposed in two pictures.
pub(crate) fn solve(samples: &[Vec<Sample>; 3], log_secs: &[f64], start: Option<&Response>) -> Result<Response> {
    let all: Vec<&Sample> = samples.iter().flatten().collect();
    let green = start.map(|r| &r.log_exposure[1][..]);
    let common = solve_curve(&all, log_secs, green, &srgb_base())?;
    let base: Vec<f64> = common.iter().map(|v| f64::from(*v)).collect();
    let curves: Vec<Vec<f32>> = (0..3usize)
        .into_par_iter()
        .map(|c| {
            let own: Vec<&Sample> = samples[c].iter().collect();
            // A channel that says too little by itself (a red scene's blue) has the common curve.
            solve_curve(&own, log_secs, Some(&common), &base).or_else(|_| Ok(common.clone()))
        })
        .collect::<Result<_>>()?;
    let [r, g, b] = <[Vec<f32>; 3]>::try_from(curves).map_err(|_| Error::Response("no three channels".into()))?;
    Ok(Response { log_exposure: [r, g, b] })
}

/// One curve near `base`.
fn solve_curve(samples: &[&Sample], log_secs: &[f64], start: Option<&[f32]>, base: &[f64]) -> Result<Vec<f32>> {
    let useful = samples.iter().filter(|s| s.iter().flatten().filter(|u| trust(**u) > 0.3).count() >= 2).count();
    if useful < 8 {
        return Err(Error::Response(format!(
            "only {useful} sample points are well exposed in two pictures (all black or saturated elsewhere): add \
             pictures in between, or give --response"
        )));
    }
    let base = DVector::from_row_slice(base);
    let mut g = start.map(|s| DVector::from_iterator(NODES, s.iter().map(|v| f64::from(*v))));
    for _ in 0..4 {
        let (mut h, mut rhs) = (DMatrix::<f64>::zeros(NODES, NODES), DVector::<f64>::zeros(NODES));
        let mut measurements = 0.0;
        for s in samples {
            measurements += add_sample(s, log_secs, g.as_ref(), &mut h, &mut rhs);
        }
        // From here on the unknown is the difference from the base.
        rhs -= &h * &base;
        add_smoothness(measurements, &mut h);
        // g(mid) = 0, as the base has it, fixes the free constant; mid is between two nodes.
        let pin = measurements.max(1.0);
        for (i, j) in [(127, 127), (127, 128), (128, 127), (128, 128)] {
            h[(i, j)] += 0.25 * pin;
        }
        let factor = h.cholesky().ok_or_else(|| {
            Error::Response("the exposures do not determine the curve; give --response or --linear".into())
        })?;
        g = Some(factor.solve(&rhs) + &base);
    }
    Ok(monotone(g.unwrap_or(base).as_slice()))
}

/// Adds one sample's normal equations with its radiance eliminated; returns the weight it brought.
fn add_sample(
    s: &Sample,
    log_secs: &[f64],
    g: Option<&DVector<f64>>,
    h: &mut DMatrix<f64>,
    rhs: &mut DVector<f64>,
) -> f64 {
    // (a = weight², first node, fraction, b = ln t)
    let mut rows: Vec<(f64, usize, f64, f64)> = Vec::with_capacity(s.len());
    for (u, b) in s.iter().zip(log_secs) {
        let Some(u) = u else { continue };
        let w = f64::from(trust(*u));
        if w <= 0.0 {
            continue;
        }
        let at = f64::from(*u) * (NODES - 1) as f64;
        let i = (at as usize).min(NODES - 2);
        rows.push((w * w, i, at - i as f64, *b));
    }
    if rows.len() < 2 {
        return 0.0;
    }
    if let Some(g) = g {
        let value = |r: &(f64, usize, f64, f64)| g[r.1] * (1.0 - r.2) + g[r.1 + 1] * r.2 - r.3;
        let e = rows.iter().map(|r| r.0 * value(r)).sum::<f64>() / rows.iter().map(|r| r.0).sum::<f64>();
        for r in &mut rows {
            let residual = (value(r) - e).abs();
            if residual > HUBER {
                // Falls as 1/r², so that a moved thing fades out instead of pulling with constant force.
                r.0 *= (HUBER / residual).powi(2);
            }
        }
    }
    let sum: f64 = rows.iter().map(|r| r.0).sum();
    let b_mean = rows.iter().map(|r| r.0 * r.3).sum::<f64>() / sum;
    for (k, &(a, i, f, b)) in rows.iter().enumerate() {
        for (di, wi) in [(0, 1.0 - f), (1, f)] {
            rhs[i + di] += a * wi * (b - b_mean);
        }
        for (l, &(a2, i2, f2, _)) in rows.iter().enumerate() {
            let weight = if k == l { a } else { 0.0 } - a * a2 / sum;
            for (di, wi) in [(0, 1.0 - f), (1, f)] {
                for (dj, wj) in [(0, 1.0 - f2), (1, f2)] {
                    h[(i + di, i2 + dj)] += weight * wi * wj;
                }
            }
        }
    }
    sum
}

/// Weight of a code in the fit: 0 at both ends, 1 from code 12 to 237.
fn trust(u: f32) -> f32 {
    ((u - 0.008) / 0.04).clamp(0.0, 1.0) * ((0.985 - u) / 0.055).clamp(0.0, 1.0)
}

/// Penalties on the difference from the base; in the toe a log curve may bend more.
fn add_smoothness(measurements: f64, h: &mut DMatrix<f64>) {
    let scale = SMOOTHNESS * measurements.max(1.0);
    for z in 1..NODES - 1 {
        let a = scale * (z as f64 / 60.0).powi(2).clamp(0.01, 1.0);
        let row = [(z - 1, 1.0), (z, -2.0), (z + 1, 1.0)];
        for (i, ci) in row {
            for (j, cj) in row {
                h[(i, j)] += a * ci * cj;
            }
        }
    }
    for z in 0..NODES {
        h[(z, z)] += TO_BASE * measurements.max(1.0);
    }
}

/// The nearest non-decreasing curve (pool adjacent violators), then tilted by a hair so that it is invertible.
fn monotone(g: &[f64]) -> Vec<f32> {
    let mut pools: Vec<(f64, usize)> = Vec::with_capacity(g.len());
    for &v in g {
        pools.push((v, 1));
        while pools.len() > 1 && pools[pools.len() - 2].0 > pools[pools.len() - 1].0 {
            let (b, nb) = pools.pop().unwrap_or_default();
            let (a, na) = pools.pop().unwrap_or_default();
            pools.push(((a * na as f64 + b * nb as f64) / (na + nb) as f64, na + nb));
        }
    }
    let flat = pools.iter().flat_map(|&(v, n)| std::iter::repeat_n(v, n));
    flat.enumerate().map(|(i, v)| (v + 1e-5 * (i as f64 - 127.5)) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A curve that is no gamma: toe, shoulder and a wiggle.
    fn film(x: f64) -> f64 {
        let x = x.clamp(0.0, 1.0);
        ((1.055 * x.powf(1.0 / 2.4) - 0.055 * (1.0 - x).powi(8))
            * (1.0 - 0.04 * (std::f64::consts::TAU * x.sqrt()).sin()))
        .clamp(0.0, 1.0)
    }

    fn samples(outliers: bool) -> (Vec<Sample>, Vec<f64>) {
        let secs = [1.0 / 60.0, 1.0 / 15.0, 1.0 / 4.0];
        let mut rng = translume_core::rng::Pcg32::new(3, 0);
        let samples = (0..400)
            .map(|k| {
                let radiance = (f64::from(k) / 400.0 * 9.0 - 4.0).exp() * 0.05;
                secs.iter()
                    .enumerate()
                    .map(|(i, t)| {
                        let moved = if outliers && k % 10 == 0 && i == 2 { 0.2 } else { 1.0 };
                        let code = film(radiance * moved * t * 15.0) * 255.0 + rng.next_normal() * 0.6;
                        Some((code.round().clamp(0.0, 255.0) / 255.0) as f32)
                    })
                    .collect()
            })
            .collect();
        (samples, secs.iter().map(|t: &f64| t.ln()).collect())
    }

    /// Largest error of the recovered log exposure over well-exposed codes, after removing the free constant.
    fn worst_error(g: &[f32]) -> f64 {
        let truth: Vec<(f64, f64)> = (0..2000)
            .map(|k| 0.002 * (f64::from(k) / 2000.0 * 6.0).exp())
            .filter(|x| *x < 0.8)
            .map(|x| (film(x), x.ln()))
            .filter(|(u, _)| *u > 0.1 && *u < 0.95)
            .collect();
        let errors: Vec<f64> = truth
            .iter()
            .map(|(u, l)| {
                let at = u * 255.0;
                let i = at as usize;
                f64::from(g[i]) + (at - i as f64) * f64::from(g[i + 1] - g[i]) - l
            })
            .collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        errors.iter().map(|e| (e - mean).abs()).fold(0.0, f64::max)
    }

    fn solved(outliers: bool) -> Vec<f32> {
        let (samples, log_secs) = samples(outliers);
        let channels = [samples.clone(), samples.clone(), samples];
        solve(&channels, &log_secs, None).unwrap().log_exposure[1].clone()
    }

    #[test]
    fn recovers_a_film_curve() {
        let g = solved(false);
        assert!(worst_error(&g) < 0.06, "{}", worst_error(&g));
        assert!(g.windows(2).all(|w| w[1] > w[0]));
        assert!((g[127] + g[128]).abs() < 0.02);
    }

    #[test]
    fn moved_things_do_not_bend_it() {
        let g = solved(true);
        assert!(worst_error(&g) < 0.08, "{}", worst_error(&g));
    }

    #[test]
    fn saturated_everywhere_is_an_error() {
        let samples = vec![vec![Some(1.0), Some(1.0)]; 100];
        assert!(solve(&[samples.clone(), samples.clone(), samples], &[0.0, 1.0], None).is_err());
    }

    #[test]
    fn linear_response_is_logarithmic() {
        let r = Response::linear();
        r.validate().unwrap();
        let step = r.log_exposure(1, 0.8) - r.log_exposure(1, 0.2);
        assert!((step - 4f32.ln()).abs() < 1e-3);
    }
}
