//! Codes to linear Rec. 709: the sRGB curve, PNG gamma and code points, ICC profiles, and primaries that a file names.

use crate::colour::{self, Matrix, Space};
use crate::raster::Transfer;
use crate::{Codes, Metadata, Samples, icc};
use rayon::prelude::*;
use std::path::Path;

/// Pixels that one task converts.
pub(crate) const CHUNK: usize = 1 << 14;

/// Linear Rec. 709 values of `codes` (of a gray picture with equal channels if `gray`), interleaved RGB. Colours
/// outside Rec. 709 get negative values; none is clipped. A profile that cannot be used is a warning: the pixels are
/// sound, and read as if it were not there.
pub(crate) fn linearise(codes: Codes, transfer: Transfer, gray: bool, path: &Path) -> (Vec<f32>, Metadata) {
    let Codes { samples, mut metadata, .. } = codes;
    let icc = metadata.icc.take();
    let chromaticities = metadata.chromaticities.take();
    let samples = match icc {
        Some(profile) => match through_profile(samples, &profile, gray, path) {
            Ok(rgb) => return (rgb, metadata),
            Err(samples) => samples,
        },
        None => samples,
    };
    let decode = move |v: f32| match transfer {
        Transfer::Srgb => colour::srgb_to_linear(v),
        Transfer::Power(g) => v.powf(g),
        Transfer::Video(curve) => curve.light(v),
    };
    let mut rgb = through_curves(samples, [&decode, &decode, &decode], false);
    if let Some(space) = chromaticities.and_then(Space::from_chromaticities).filter(|s| differs(s, &Space::REC709)) {
        multiply(&mut rgb, &space.to(&Space::REC709));
    }
    (rgb, metadata)
}

/// Linear light through an ICC profile; the samples again, and a warning, if it cannot be used.
fn through_profile(samples: Samples, profile: &[u8], gray: bool, path: &Path) -> Result<Vec<f32>, Samples> {
    let bits = if matches!(samples, Samples::U8(_)) { 8 } else { 16 };
    let float = matches!(samples, Samples::F32(_));
    let warn = |what: String| {
        let instead = if float { "linear Rec. 709" } else { "sRGB" };
        log::warn!("{}: its ICC profile cannot be used ({what}); read as {instead}", path.display());
    };
    match icc::Reading::new(profile, gray, bits) {
        Ok(reading) => reading.apply(samples, path).map_err(|(what, samples)| {
            warn(what);
            samples
        }),
        Err(what) => {
            warn(what);
            Err(samples)
        }
    }
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

/// One curve a channel, by table for integers; floats go through the curves only if `floats`.
pub(crate) fn through_curves(samples: Samples, curves: [Curve<'_>; 3], floats: bool) -> Vec<f32> {
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
        Samples::F32(mut v) => {
            if floats {
                let pixels = v.as_chunks_mut::<3>().0.par_iter_mut().with_min_len(CHUNK);
                pixels.for_each(|p| *p = [curves[0](p[0]), curves[1](p[1]), curves[2](p[2])]);
            }
            v
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moxcms::{ColorProfile, LutDataType, LutStore, LutType, LutWarehouse, Matrix3d, ProfileClass};

    fn linear(profile: &ColorProfile, samples: Samples) -> Vec<f32> {
        let metadata = Metadata { icc: Some(profile.encode().unwrap()), ..Metadata::default() };
        let codes = Codes { width: 2, height: 1, samples, metadata };
        linearise(codes, Transfer::Srgb, profile.gray_trc.is_some(), Path::new("a.png")).0
    }

    fn near(got: &[f32], expected: &[f32], tolerance: f32) {
        assert!(got.iter().zip(expected).all(|(g, e)| (g - e).abs() < tolerance), "{got:?} instead of {expected:?}");
    }

    #[test]
    fn a_wide_profile_gives_negative_light_and_keeps_white() {
        let got = linear(&ColorProfile::new_display_p3(), Samples::U8(vec![255, 0, 0, 255, 255, 255]));
        // Display P3 red in linear Rec. 709, as the primaries of both give it.
        near(&got, &[1.2249, -0.0420, -0.0196, 1.0, 1.0, 1.0], 2e-3);
        let adobe = linear(&ColorProfile::new_adobe_rgb(), Samples::U16(vec![0, 65535, 0, 32768, 32768, 32768]));
        let half = 0.5f32.powf(563.0 / 256.0);
        near(&adobe, &[-0.3983, 1.0, -0.0429, half, half, half], 2e-3);
    }

    #[test]
    fn float_samples_go_through_the_curves_of_their_profile() {
        let got = linear(&ColorProfile::new_srgb(), Samples::F32(vec![0.5, 0.5, 0.5, 1.0, 1.0, 1.0]));
        near(&got, &[0.2140, 0.2140, 0.2140, 1.0, 1.0, 1.0], 1e-3);
    }

    #[test]
    fn a_gray_profile_has_its_own_curve() {
        let got = linear(&ColorProfile::new_gray_with_gamma(1.8), Samples::U8(vec![0, 0, 0, 128, 128, 128]));
        near(&got[3..], &[(128.0f32 / 255.0).powf(1.8); 3], 1e-3);
    }

    /// A scanner-like profile: curves, then a table of device colours in XYZ; red and blue are exchanged in it.
    fn table_profile() -> ColorProfile {
        let curve = (0..256).map(|i| (colour::srgb_to_linear(i as f32 / 255.0) * 65535.0).round() as u16);
        let colorants = ColorProfile::new_srgb().colorant_matrix().v;
        let mut table = Vec::new();
        for i in 0..8 {
            let exchanged = [f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)];
            // XYZ of lut16 is in units of 1/32768.
            table.extend(colour::product_vec(&colorants, exchanged).map(|v| (v * 32768.0).round() as u16));
        }
        let mut profile = ColorProfile::new_srgb();
        profile.profile_class = ProfileClass::InputDevice;
        (profile.red_trc, profile.green_trc, profile.blue_trc, profile.cicp) = (None, None, None, None);
        profile.lut_a_to_b_perceptual = Some(LutWarehouse::Lut(LutDataType {
            num_input_channels: 3,
            num_output_channels: 3,
            num_clut_grid_points: 2,
            matrix: Matrix3d { v: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] },
            num_input_table_entries: 256,
            num_output_table_entries: 2,
            input_table: LutStore::Store16(std::iter::repeat_n(curve, 3).flatten().collect()),
            clut_table: LutStore::Store16(table),
            output_table: LutStore::Store16(vec![0, 65535, 0, 65535, 0, 65535]),
            lut_type: LutType::Lut16,
        }));
        profile
    }

    #[test]
    fn a_profile_with_tables_is_followed() {
        let got = linear(&table_profile(), Samples::U8(vec![255, 0, 0, 128, 128, 128]));
        let gray = colour::srgb_to_linear(128.0 / 255.0);
        near(&got, &[0.0, 0.0, 1.0, gray, gray, gray], 0.01);
    }

    #[test]
    fn what_is_no_profile_for_these_pixels_leaves_them_srgb() {
        let gray = ColorProfile::new_gray_with_gamma(1.8).encode().unwrap();
        for profile in [b"no profile".to_vec(), ColorProfile::new_lab().encode().unwrap(), gray] {
            let metadata = Metadata { icc: Some(profile), ..Metadata::default() };
            let codes = Codes { width: 1, height: 1, samples: Samples::U8(vec![0, 128, 255]), metadata };
            let (got, _) = linearise(codes, Transfer::Srgb, false, Path::new("a.png"));
            near(&got, &[0.0, colour::srgb_to_linear(128.0 / 255.0), 1.0], 1e-6);
        }
    }

    #[test]
    fn a_gray_float_picture_goes_through_its_gray_profile() {
        let got = linear(&ColorProfile::new_gray_with_gamma(2.0), Samples::F32(vec![0.5, 0.5, 0.5, 3.0, 3.0, 3.0]));
        near(&got, &[0.25, 0.25, 0.25, 9.0, 9.0, 9.0], 1e-4);
    }

    #[test]
    fn a_profile_that_names_pq_is_read_as_pq() {
        // Code 38056 of 65535 is 203 cd/m², reference white.
        let got = linear(&ColorProfile::new_bt2020_pq(), Samples::U16(vec![38056, 38056, 38056, 0, 0, 0]));
        near(&got, &[1.0, 1.0, 1.0, 0.0, 0.0, 0.0], 1e-3);
    }

    #[test]
    fn primaries_of_float_files_are_brought_to_rec709() {
        let metadata = Metadata { chromaticities: Some(Space::ACESCG.chromaticities()), ..Metadata::default() };
        let samples = Samples::F32(vec![0.5, 0.5, 0.5, 1.0, 0.0, 0.0]);
        let (got, metadata) =
            linearise(Codes { width: 2, height: 1, samples, metadata }, Transfer::Power(1.0), false, Path::new("a"));
        // ACEScg red, D60 adapted to D65 by Bradford.
        near(&got, &[0.5, 0.5, 0.5, 1.705, -0.130, -0.024], 1e-3);
        assert_eq!(metadata.chromaticities, None);
    }
}
