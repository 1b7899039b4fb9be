//! Linear light through an embedded ICC profile.
//!
//! Gray and matrix profiles are followed by our own arithmetic, unclipped, below 0 and beyond 1 too, so that float
//! pictures keep their range. Profiles with look-up tables (scanners, printers, CMYK) go through the moxcms library
//! into Rec. 2020 and are clipped to that.

use crate::cicp;
use crate::colour::{self, Matrix, Space};
use crate::linear::{self, through_curves};
use crate::{Samples, primaries};
use moxcms::{ColorProfile, DataColorSpace, Layout, ToneReprCurve, TransformExecutor, TransformOptions};
use std::path::Path;
use std::sync::Arc;

type Transform = Arc<dyn TransformExecutor<f32> + Send + Sync>;

/// A profile made ready for the pixels of one picture.
pub(crate) enum Reading {
    Gray(Curve),
    Matrix(Box<[Curve; 3]>, Matrix),
    /// The profile names a video transfer (PQ, HLG), which its curves only imitate.
    CodePoints(cicp::Curve, Space),
    Tables(Transform),
}

impl Reading {
    /// What `profile` says about gray or RGB pixels of `bits`.
    ///
    /// # Errors
    /// Why it cannot be used.
    pub(crate) fn new(profile: &[u8], gray: bool, bits: u8) -> Result<Self, String> {
        let profile = parse(profile)?;
        if let Some(reading) = code_points(&profile, bits) {
            return Ok(reading);
        }
        match profile.color_space {
            DataColorSpace::Gray if gray => {
                Ok(Self::Gray(Curve::new(profile.gray_trc.as_ref().ok_or("it has no gray curve")?)?))
            }
            DataColorSpace::Rgb if profile.is_matrix_shaper() => {
                let curve = |trc: &Option<ToneReprCurve>| Curve::new(trc.as_ref().ok_or("it lacks a curve")?);
                let curves = [curve(&profile.red_trc)?, curve(&profile.green_trc)?, curve(&profile.blue_trc)?];
                let matrix = primaries::matrix_of(&profile);
                if !matrix.as_flattened().iter().all(|v| v.is_finite()) || colour::inverse(&matrix).is_none() {
                    return Err("its primaries span no triangle".into());
                }
                Ok(Self::Matrix(Box::new(curves), matrix))
            }
            DataColorSpace::Rgb => transform(&profile, Layout::Rgb).map(Self::Tables),
            other => Err(format!("it is for {other:?}, the pixels are {}", if gray { "gray" } else { "RGB" })),
        }
    }

    /// Linear Rec. 709 of interleaved RGB samples (equal ones for gray).
    ///
    /// # Errors
    /// What the colour management library says, and the samples again.
    pub(crate) fn apply(&self, samples: Samples, path: &Path) -> Result<Vec<f32>, (String, Samples)> {
        match self {
            Self::Gray(curve) => {
                curve.warn_beyond(&samples, path);
                let eval = |v: f32| curve.eval(v);
                Ok(through_curves(samples, [&eval, &eval, &eval], true))
            }
            Self::Matrix(curves, matrix) => {
                curves.iter().for_each(|c| c.warn_beyond(&samples, path));
                let [r, g, b] = [&curves[0], &curves[1], &curves[2]].map(|c| move |v: f32| c.eval(v));
                let mut rgb = through_curves(samples, [&r, &g, &b], true);
                linear::multiply(&mut rgb, matrix);
                Ok(rgb)
            }
            Self::CodePoints(curve, space) => {
                let eval = |v: f32| curve.light(v);
                let mut rgb = through_curves(samples, [&eval, &eval, &eval], true);
                linear::multiply(&mut rgb, &space.to(&Space::REC709));
                Ok(rgb)
            }
            Self::Tables(transform) => {
                let outside = |v: &&f32| !(0.0..=1.0).contains(*v);
                if let Samples::F32(v) = &samples
                    && v.iter().find(outside).is_some()
                {
                    let path = path.display();
                    log::warn!("{path}: its ICC profile has tables, which end at 1: values beyond are clipped");
                }
                let same = |v: f32| v;
                let codes = through_curves(samples.clone(), [&same, &same, &same], true);
                through_tables(&codes, 3, transform).map_err(|what| (what, samples))
            }
        }
    }
}

/// Linear Rec. 709 RGB of interleaved inks (cyan, magenta, yellow, black; 1 is all ink) through a CMYK profile.
///
/// # Errors
/// Why the profile cannot be used.
pub(crate) fn cmyk(inks: &[f32], profile: &[u8]) -> Result<Vec<f32>, String> {
    let profile = parse(profile)?;
    if profile.color_space != DataColorSpace::Cmyk {
        return Err(format!("it is for {:?}, the pixels are CMYK", profile.color_space));
    }
    through_tables(inks, 4, &transform(&profile, Layout::Rgba)?)
}

fn parse(profile: &[u8]) -> Result<ColorProfile, String> {
    crate::guard::run(|| ColorProfile::new_from_slice(profile))
        .ok_or_else(|| "it is damaged".to_owned())?
        .map_err(|e| e.to_string())
}

/// Profiles with a cicp tag for PQ or HLG: their curves are tables made for displays.
fn code_points(profile: &ColorProfile, bits: u8) -> Option<Reading> {
    let tag = profile.cicp.as_ref().filter(|_| profile.color_space == DataColorSpace::Rgb)?;
    let transfer = tag.transfer_characteristics as u8;
    let space = cicp::space(tag.color_primaries as u8).filter(|_| transfer == 16 || transfer == 18)?;
    // Whatever the tag says of the range, the curves beside it begin at code 0 and end at the largest.
    Some(Reading::CodePoints(cicp::Curve::new(transfer, true, bits)?, space))
}

fn wide() -> ColorProfile {
    ColorProfile::new_bt2020()
}

fn transform(profile: &ColorProfile, layout: Layout) -> Result<Transform, String> {
    let made = crate::guard::run(|| {
        profile
            .create_transform_f32(layout, &wide(), Layout::Rgb, TransformOptions::default())
            .map_err(|e| e.to_string())
    });
    made.unwrap_or_else(|| Err("it is damaged".into()))
}

fn through_tables(values: &[f32], channels: usize, transform: &Transform) -> Result<Vec<f32>, String> {
    let wide = wide();
    let curve = Curve::new(wide.red_trc.as_ref().ok_or("no curve")?)?;
    let matrix = primaries::matrix_of(&wide);
    let mut out = vec![0.0; values.len() / channels * 3];
    for (from, to) in values.chunks(channels * linear::CHUNK).zip(out.chunks_mut(3 * linear::CHUNK)) {
        transform.transform(from, to).map_err(|e| e.to_string())?;
        to.iter_mut().for_each(|v| *v = curve.eval(*v));
    }
    linear::multiply(&mut out, &matrix);
    Ok(out)
}

/// A tone curve of a profile (ICC.1 §10.6 and §10.18), for all numbers.
#[derive(Debug)]
pub(crate) enum Curve {
    Power(f32),
    /// Equally spaced values from 0 to 1; beyond 1 the last of them grows with this power of the code.
    Table(Vec<f32>, f32),
    /// `(a x + b)^g + e` from `d` on, `c x + f` below: g, a, b, c, d, e, f.
    Parametric([f32; 7]),
}

impl Curve {
    fn new(curve: &ToneReprCurve) -> Result<Self, String> {
        match curve {
            ToneReprCurve::Lut(v) if v.is_empty() => Ok(Self::Power(1.0)),
            ToneReprCurve::Lut(v) if v.len() == 1 => Ok(Self::Power(f32::from(v[0]) / 256.0)),
            ToneReprCurve::Lut(v) => {
                let values: Vec<f32> = v.iter().map(|&v| f32::from(v) / 65535.0).collect();
                let exponent = end_exponent(&values);
                Ok(Self::Table(values, exponent))
            }
            ToneReprCurve::Parametric(p) => {
                let full = match **p {
                    [g] => return Ok(Self::Power(g)),
                    [g, a, b] => [g, a, b, 0.0, -b / a, 0.0, 0.0],
                    [g, a, b, c] => [g, a, b, 0.0, -b / a, c, c],
                    [g, a, b, c, d] => [g, a, b, c, d, 0.0, 0.0],
                    [g, a, b, c, d, e, f] => [g, a, b, c, d, e, f],
                    _ => return Err("a curve of an unknown kind".into()),
                };
                if full.iter().all(|v| v.is_finite()) {
                    Ok(Self::Parametric(full))
                } else {
                    Err("a curve that is not finite".into())
                }
            }
        }
    }

    fn eval(&self, x: f32) -> f32 {
        match self {
            Self::Power(g) => x.abs().powf(*g).copysign(x),
            Self::Table(values, exponent) => {
                let last = values.len() - 1;
                // A NaN passes through both comparisons and comes out of the interpolation.
                if x > 1.0 {
                    return values[last] * x.powf(*exponent);
                }
                if x < 0.0 {
                    return 2.0 * values[0] - self.eval(-x);
                }
                let at = x * last as f32;
                let i = (at as usize).min(last - 1);
                values[i] + (at - i as f32) * (values[i + 1] - values[i])
            }
            &Self::Parametric([g, a, b, c, d, e, f]) => {
                if x < d {
                    c * x + f
                } else {
                    (a * x + b).max(0.0).powf(g) + e
                }
            }
        }
    }

    /// A table says nothing about codes beyond 1; where it is no straight line, its continuation is an opinion.
    fn warn_beyond(&self, samples: &Samples, path: &Path) {
        let (Self::Table(_, exponent), Samples::F32(v)) = (self, samples) else { return };
        if (exponent - 1.0).abs() > 1e-3 && v.iter().any(|v| *v > 1.0) {
            let path = path.display();
            log::warn!("{path}: a curve of its ICC profile ends at 1: values beyond are continued by its last power");
        }
    }
}

/// The power by which a table grows at its end, from its last sixteenth.
fn end_exponent(values: &[f32]) -> f32 {
    let last = values.len() - 1;
    let back = (last / 16).max(1);
    let (before, end) = (values[last - back], values[last]);
    let exponent = (end / before).ln() / (last as f32 / (last - back) as f32).ln();
    // A table that falls, stays or starts at zero has no such power.
    if exponent.is_finite() && (0.1..=10.0).contains(&exponent) { exponent } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_goes_on_beyond_its_end() {
        let linear: Vec<u16> = (0..1024).map(|i| (f64::from(i) / 1023.0 * 65535.0).round() as u16).collect();
        let curve = Curve::new(&ToneReprCurve::Lut(linear)).unwrap();
        for x in [0.0, 0.05, 0.18, 1.0, 4.0, 16.0, 100.0, -0.5] {
            assert!((curve.eval(x) - x).abs() <= 1e-3 * x.abs() + 1e-5, "{x}: {}", curve.eval(x));
        }
        let gamma: Vec<u16> = (0..4096).map(|i| ((f64::from(i) / 4095.0).powf(1.8) * 65535.0).round() as u16).collect();
        let curve = Curve::new(&ToneReprCurve::Lut(gamma)).unwrap();
        assert!((curve.eval(8.0) / (8.0f32).powf(1.8) - 1.0).abs() < 5e-3);
        assert!(curve.eval(f32::NAN).is_nan());
        // Two entries are a straight line, and one that falls goes on flat.
        assert_eq!(Curve::new(&ToneReprCurve::Lut(vec![0, 65535])).unwrap().eval(3.0), 3.0);
    }

    #[test]
    fn the_five_parametric_kinds_are_their_formulas() {
        let eval = |p: &[f32], x: f32| Curve::new(&ToneReprCurve::Parametric(p.to_vec())).unwrap().eval(x);
        let near = |a: f32, b: f32| assert!((a - b).abs() < 1e-5, "{a} {b}");
        near(eval(&[2.0], 0.5), 0.25);
        near(eval(&[2.0, 2.0, -0.5], 0.5), 0.25);
        near(eval(&[2.0, 2.0, -0.5], 0.2), 0.0);
        near(eval(&[2.0, 2.0, -0.5, 0.1], 0.5), 0.35);
        near(eval(&[2.0, 2.0, -0.5, 0.1], 0.2), 0.1);
        let srgb = [2.4, 1.0 / 1.055, 0.055 / 1.055, 1.0 / 12.92, 0.04045];
        for x in [0.01, 0.04, 0.5, 1.0, 2.0] {
            near(eval(&srgb, x), colour::srgb_to_linear(x));
        }
        near(eval(&[2.0, 1.0, 0.0, 0.5, 0.3, 0.2, 0.1], 0.5), 0.45);
        near(eval(&[2.0, 1.0, 0.0, 0.5, 0.3, 0.2, 0.1], 0.2), 0.2);
        assert!(Curve::new(&ToneReprCurve::Parametric(vec![2.0, 0.0, 1.0])).is_err());
    }
}
