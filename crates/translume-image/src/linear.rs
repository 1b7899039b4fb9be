//! Codes to linear Rec. 709: the sRGB curve, PNG gamma, ICC profiles, and primaries named by OpenEXR or Radiance.

use crate::colour::{self, Matrix, Space};
use crate::raster::Transfer;
use crate::{Codes, Error, Metadata, Result, Samples};
use moxcms::{ColorProfile, DataColorSpace, Layout, TransformOptions};
use rayon::prelude::*;
use std::path::Path;

/// Pixels that one task converts.
const CHUNK: usize = 1 << 14;

/// Linear Rec. 709 values of `codes`, interleaved RGB. Colours outside Rec. 709 get negative values; none is clipped.
pub(crate) fn linearise(codes: Codes, transfer: Transfer, path: &Path) -> Result<(Vec<f32>, Metadata)> {
    let Codes { samples, mut metadata, .. } = codes;
    let icc = metadata.icc.take();
    let chromaticities = metadata.chromaticities.take();
    let mut rgb = match icc {
        Some(profile) => through_profile(samples, &profile, path)?,
        None => {
            let decode = move |v: f32| match transfer {
                Transfer::Srgb => colour::srgb_to_linear(v),
                Transfer::Power(g) => v.powf(g),
            };
            through_curves(samples, [&decode, &decode, &decode])
        }
    };
    // Float sources without a curve of their own carry primaries instead.
    if let Some(space) = chromaticities.and_then(Space::from_chromaticities).filter(|s| differs(s, &Space::REC709)) {
        multiply(&mut rgb, &space.to(&Space::REC709));
    }
    Ok((rgb, metadata))
}

/// Whether two spaces differ by more than rounding in a file.
pub(crate) fn differs(a: &Space, b: &Space) -> bool {
    let (a, b) = (a.chromaticities(), b.chromaticities());
    a.iter().flatten().zip(b.iter().flatten()).any(|(x, y)| (x - y).abs() > 1e-4)
}

/// Multiplies every pixel.
pub(crate) fn multiply(rgb: &mut [f32], m: &Matrix) {
    rgb.as_chunks_mut::<3>().0.par_iter_mut().with_min_len(CHUNK).for_each(|p| *p = colour::apply(m, *p));
}

type Curve<'a> = &'a (dyn Fn(f32) -> f32 + Sync);

/// One curve a channel; by table for integers, floats pass through (they are linear by definition here).
fn through_curves(samples: Samples, curves: [Curve<'_>; 3]) -> Vec<f32> {
    fn table(curve: Curve<'_>, full: usize) -> Vec<f32> {
        (0..=full).map(|i| curve(i as f32 / full as f32)).collect()
    }
    fn look_up<T: Copy + Into<usize> + Sync>(v: &[T], tables: &[Vec<f32>; 3]) -> Vec<f32> {
        let mut out = vec![0.0; v.len()];
        out.par_chunks_mut(3 * CHUNK).zip(v.par_chunks(3 * CHUNK)).for_each(|(out, v)| {
            for (o, p) in out.as_chunks_mut::<3>().0.iter_mut().zip(v.as_chunks::<3>().0) {
                *o = std::array::from_fn(|c| tables[c][p[c].into()]);
            }
        });
        out
    }
    match samples {
        Samples::U8(v) => look_up(&v, &curves.map(|c| table(c, 255))),
        Samples::U16(v) => look_up(&v, &curves.map(|c| table(c, 65535))),
        Samples::F32(v) => v,
    }
}

fn through_profile(samples: Samples, profile: &[u8], path: &Path) -> Result<Vec<f32>> {
    let unusable = |what: String| {
        Error::unsupported(path, format!("cannot use the embedded ICC profile ({what}); strip it or convert to sRGB"))
    };
    let profile = ColorProfile::new_from_slice(profile).map_err(|e| unusable(e.to_string()))?;
    match profile.color_space {
        DataColorSpace::Gray => {
            let curve = profile.gray_trc.as_ref().ok_or_else(|| unusable("no gray curve".into()))?;
            let curve = curve.make_linear_evaluator().map_err(|e| unusable(e.to_string()))?;
            let curve = |v: f32| curve.evaluate_value(v);
            Ok(through_curves(samples, [&curve, &curve, &curve]))
        }
        DataColorSpace::Rgb if profile.is_matrix_shaper() => {
            let curves = [&profile.red_trc, &profile.green_trc, &profile.blue_trc].map(|trc| {
                trc.as_ref()
                    .ok_or_else(|| "no curves".to_owned())
                    .and_then(|t| t.make_linear_evaluator().map_err(|e| e.to_string()))
            });
            let [r, g, b] = curves;
            let (r, g, b) = (r.map_err(unusable)?, g.map_err(unusable)?, b.map_err(unusable)?);
            let [r, g, b] = [&r, &g, &b].map(|c| move |v: f32| c.evaluate_value(v));
            let mut rgb = match samples {
                // Float TIFF: the profile's curves apply to floats too.
                Samples::F32(mut v) => {
                    for p in v.as_chunks_mut::<3>().0 {
                        *p = [r(p[0]), g(p[1]), b(p[2])];
                    }
                    v
                }
                integers => through_curves(integers, [&r, &g, &b]),
            };
            let colorants = profile.colorant_matrix().v;
            let from_pcs = colour::adaptation(colour::D50_XYZ, colour::xy_to_xyz(colour::D65));
            let to_rgb = colour::product(&Space::REC709.xyz_to_rgb(), &colour::product(&from_pcs, &colorants));
            multiply(&mut rgb, &to_rgb);
            Ok(rgb)
        }
        DataColorSpace::Rgb => through_tables(samples, &profile).map_err(unusable),
        other => Err(unusable(format!("it is for {other:?}, the pixels are RGB"))),
    }
}

/// Profiles with look-up tables, through the colour management library.
fn through_tables(samples: Samples, profile: &ColorProfile) -> std::result::Result<Vec<f32>, String> {
    let identity = |v: f32| v;
    let encoded = through_curves(samples, [&identity, &identity, &identity]);
    let srgb = ColorProfile::new_srgb();
    let transform = profile
        .create_transform_f32(Layout::Rgb, &srgb, Layout::Rgb, TransformOptions::default())
        .map_err(|e| e.to_string())?;
    let mut out = vec![0.0; encoded.len()];
    for (from, to) in encoded.chunks(3 * CHUNK).zip(out.chunks_mut(3 * CHUNK)) {
        transform.transform(from, to).map_err(|e| e.to_string())?;
        to.iter_mut().for_each(|v| *v = colour::srgb_to_linear(*v));
    }
    Ok(out)
}
