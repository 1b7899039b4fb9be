//! Camera raw files, developed to linear Rec. 709 by rawler (feature `raw`; LGPL-2.1, therefore not in the default
//! build). Without the feature such a file is refused with the way to get it read.
//!
//! Development is black level, demosaicing (PPG for Bayer, bilinear for X-Trans), the camera's white balance and its
//! D65 matrix: no tone curve, so values are proportional to light.

use crate::raster::Raster;
use crate::{Error, Result};
use std::path::Path;

/// Endings of raw files. Most are TIFF inside, so their first bytes do not tell them from pictures.
const ENDINGS: &[&str] = &[
    "dng", "cr2", "cr3", "crw", "nef", "nrw", "arw", "sr2", "srf", "orf", "rw2", "raf", "pef", "srw", "3fr", "fff",
    "iiq", "mos", "mrw", "erf", "kdc", "dcr", "mef", "x3f",
];

/// Whether a file is to be read here, by its ending.
pub(crate) fn is_raw(path: &Path) -> bool {
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    ending.is_some_and(|e| ENDINGS.contains(&e.as_str()))
}

#[cfg(not(feature = "raw"))]
pub(crate) fn read(path: &Path) -> Result<Raster> {
    Err(Error::unsupported(
        path,
        "camera raw is not in this build: build with --features raw, or develop to linear 16-bit TIFF first",
    ))
}

#[cfg(feature = "raw")]
pub(crate) fn read(path: &Path) -> Result<Raster> {
    // Some of rawler's decoders panic on files they do not expect; a panic there is a damaged file here.
    std::panic::catch_unwind(|| develop(path)).unwrap_or_else(|_| {
        Err(Error::invalid(path, "the raw decoder gave up on this file (damaged, or a camera it does not know)"))
    })
}

#[cfg(feature = "raw")]
fn develop(path: &Path) -> Result<Raster> {
    use crate::raster::Transfer;
    use crate::{Metadata, Orientation, Samples};
    use rawler::imgop::develop::{Intermediate, ProcessingStep, RawDevelop};
    let failed = |e: rawler::RawlerError| Error::invalid(path, format!("not a raw file that can be read ({e})"));
    let source = rawler::rawsource::RawSource::new(path).map_err(|e| Error::io(path, e))?;
    let decoder = rawler::get_decoder(&source).map_err(failed)?;
    let parameters = rawler::decoders::RawDecodeParams::default();
    let raw = decoder.raw_image(&source, &parameters, false).map_err(failed)?;
    let facts = decoder.raw_metadata(&source, &parameters).map_err(failed)?;
    let steps = RawDevelop::new_with(&[
        ProcessingStep::Rescale,
        ProcessingStep::Demosaic,
        ProcessingStep::FujiRotate,
        ProcessingStep::CropActiveArea,
        ProcessingStep::WhiteBalance,
        ProcessingStep::Calibrate,
        ProcessingStep::CropDefault,
    ]);
    let developed = steps.develop_intermediate(&raw).map_err(failed)?;
    let size = developed.dim();
    let (channels, samples): (usize, Vec<f32>) = match developed {
        Intermediate::Monochrome(p) => (1, p.data),
        Intermediate::ThreeColor(p) => (3, p.data.into_iter().flatten().collect()),
        Intermediate::FourColor(_) => {
            return Err(Error::unsupported(path, "a four-colour sensor without a matrix to RGB"));
        }
    };
    let ratio = |r: rawler::formats::tiff::Rational| f64::from(r.n) / f64::from(r.d);
    let exif = &facts.exif;
    Ok(Raster {
        width: size.w,
        height: size.h,
        channels,
        samples: Samples::F32(samples),
        transfer: Transfer::Power(1.0),
        associated: false,
        orientation: Orientation::from_exif(u32::from(exif.orientation.unwrap_or(1))),
        metadata: Metadata {
            exposure_secs: exif.exposure_time.map(ratio).filter(|v| v.is_finite()),
            f_number: exif.fnumber.map(ratio).filter(|v| v.is_finite()),
            iso: exif.iso_speed.map(f64::from).or(exif.iso_speed_ratings.map(f64::from)),
            camera: Some(format!("{} {}", facts.make, facts.model)),
            ..Metadata::default()
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raw_files_are_told_by_their_ending() {
        assert!(is_raw(Path::new("a b/IMG_1.CR2")) && is_raw(Path::new("x.dng")));
        assert!(!is_raw(Path::new("x.tif")) && !is_raw(Path::new("dng")));
    }

    #[cfg(not(feature = "raw"))]
    #[test]
    fn without_the_feature_the_way_is_told() {
        let error = read(Path::new("x.nef")).unwrap_err().to_string();
        assert!(error.contains("x.nef") && error.contains("--features raw"), "{error}");
    }

    /// A 16-bit Bayer DNG of flat patches: left half half as bright as the right.
    #[cfg(feature = "raw")]
    fn dng(width: u32, height: u32) -> Vec<u8> {
        let mut extra: Vec<u8> = Vec::new();
        let mut entries: Vec<(u16, u16, u32, [u8; 4])> = Vec::new();
        let count = 22u32;
        let data_at = 8 + 2 + 12 * count + 4;
        let mut put = |entries: &mut Vec<(u16, u16, u32, [u8; 4])>, tag: u16, kind: u16, n: u32, bytes: &[u8]| {
            let mut value = [0u8; 4];
            if bytes.len() <= 4 {
                value[..bytes.len()].copy_from_slice(bytes);
            } else {
                value = (data_at + extra.len() as u32).to_le_bytes();
                extra.extend_from_slice(bytes);
                extra.resize(extra.len().next_multiple_of(4), 0);
            }
            entries.push((tag, kind, n, value));
        };
        let short = |v: u16| v.to_le_bytes().to_vec();
        let long = |v: u32| v.to_le_bytes().to_vec();
        let rationals = |v: &[(i32, i32)]| {
            v.iter().flat_map(|(a, b)| [a.to_le_bytes(), b.to_le_bytes()].concat()).collect::<Vec<u8>>()
        };
        put(&mut entries, 254, 4, 1, &long(0));
        put(&mut entries, 256, 4, 1, &long(width));
        put(&mut entries, 257, 4, 1, &long(height));
        put(&mut entries, 258, 3, 1, &short(16));
        put(&mut entries, 259, 3, 1, &short(1));
        put(&mut entries, 262, 3, 1, &short(32803));
        put(&mut entries, 271, 2, 5, b"Test\0");
        put(&mut entries, 272, 2, 5, b"Cam1\0");
        put(&mut entries, 273, 4, 1, &long(u32::MAX));
        put(&mut entries, 274, 3, 1, &short(1));
        put(&mut entries, 277, 3, 1, &short(1));
        put(&mut entries, 278, 4, 1, &long(height));
        put(&mut entries, 279, 4, 1, &long(2 * width * height));
        put(&mut entries, 33421, 3, 2, &[2, 0, 2, 0]);
        put(&mut entries, 33422, 1, 4, &[0, 1, 1, 2]);
        put(&mut entries, 33434, 5, 1, &rationals(&[(1, 30)]));
        put(&mut entries, 50706, 1, 4, &[1, 4, 0, 0]);
        put(&mut entries, 50708, 2, 10, b"Test Cam1\0");
        put(&mut entries, 50717, 3, 1, &short(4096));
        let m = [
            (32406, 10000),
            (-15372, 10000),
            (-4986, 10000),
            (-9689, 10000),
            (18758, 10000),
            (415, 10000),
            (557, 10000),
            (-2040, 10000),
            (10570, 10000),
        ];
        put(&mut entries, 50721, 10, 9, &rationals(&m));
        put(&mut entries, 50728, 5, 3, &rationals(&[(1, 1), (1, 1), (1, 1)]));
        put(&mut entries, 50778, 3, 1, &short(21));
        assert_eq!(entries.len(), count as usize);
        let pixels_at = data_at + extra.len() as u32;
        let mut out = b"II*\0".to_vec();
        out.extend(8u32.to_le_bytes());
        out.extend((count as u16).to_le_bytes());
        for (tag, kind, n, value) in entries {
            let value = if tag == 273 { pixels_at.to_le_bytes() } else { value };
            out.extend(tag.to_le_bytes());
            out.extend(kind.to_le_bytes());
            out.extend(n.to_le_bytes());
            out.extend(value);
        }
        out.extend(0u32.to_le_bytes());
        out.extend(extra);
        for i in 0..width * height {
            out.extend((if i % width < width / 2 { 1000u16 } else { 2000 }).to_le_bytes());
        }
        out
    }

    #[cfg(feature = "raw")]
    #[test]
    fn a_dng_is_linear() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("flat.dng");
        std::fs::write(&path, dng(64, 48)).unwrap();
        let (codes, _) = read(&path).unwrap().into_codes();
        assert_eq!((codes.width, codes.height), (64, 48));
        let green = |x: usize| codes.unit(3 * (24 * 64 + x) + 1);
        assert!((green(48) / green(16) - 2.0).abs() < 0.01, "{} {}", green(48), green(16));
    }

    #[cfg(feature = "raw")]
    #[test]
    fn a_damaged_dng_is_an_error() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("cut.dng");
        std::fs::write(&path, &dng(64, 48)[..700]).unwrap();
        assert!(read(&path).is_err());
    }
}
