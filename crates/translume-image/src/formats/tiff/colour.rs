//! TIFF pictures whose samples are not gray or RGB: palettes, CMYK, YCbCr, L*a*b* (TIFF 6.0 §§ 5, 16, 21, 23).

use super::{Picture, Pixels};
use crate::colour::{self, Space};
use crate::{Error, Metadata, Result, Samples, icc};

impl Picture<'_> {
    /// Palette entries have 16 bits; those that come from 8 stay 8.
    pub(super) fn palette(&self) -> Result<Pixels> {
        let indices = self.codes(1, "a palette")?;
        let invalid = |what: &str| Error::invalid(self.path, format!("a palette TIFF {what} (damaged)"));
        let map = self.file.integers(self.directory, 320).ok_or_else(|| invalid("without a palette"))?;
        let entries = map.len() / 3;
        if indices.iter().any(|&i| usize::from(i) >= entries) {
            return Err(invalid("with colours beyond its palette"));
        }
        let colours = indices.iter().flat_map(|&i| (0..3).map(move |c| c * entries + usize::from(i)));
        // Written as 257 v by the standard, as 256 v by some, and as v by a few old programs.
        let (largest, low_is_zero) = (map.iter().max().copied().unwrap_or(0), map.iter().all(|e| e & 255 == 0));
        let samples = if largest < 256 && largest > 0 {
            Samples::U8(colours.map(|i| map[i] as u8).collect())
        } else if low_is_zero || map.iter().all(|e| e.is_multiple_of(257)) {
            Samples::U8(colours.map(|i| (map[i] >> 8) as u8).collect())
        } else {
            Samples::U16(colours.map(|i| map[i] as u16).collect())
        };
        Ok(Pixels { channels: 3, samples, associated: false })
    }

    /// Inks through their profile to linear light; without one by the plain formula.
    pub(super) fn cmyk(&self, metadata: &mut Metadata) -> Result<Pixels> {
        if self.file.integer(self.directory, 332).is_some_and(|set| set != 1) {
            return Err(Error::unsupported(self.path, "TIFF of inks that are not CMYK; convert it to RGB first"));
        }
        let path = self.path.display();
        let codes = self.codes(4, "CMYK")?;
        let full = ((1u32 << self.layout.bits) - 1) as f32;
        let inks: Vec<f32> = codes.iter().map(|&v| f32::from(v) / full).collect();
        let failed = match metadata.icc.take() {
            Some(profile) => match icc::cmyk(&inks, &profile) {
                Ok(rgb) => return Ok(Pixels { channels: 3, samples: Samples::F32(rgb), associated: false }),
                Err(what) => format!("its profile cannot be used: {what}"),
            },
            None => "it has no profile".to_owned(),
        };
        log::warn!("{path}: CMYK is turned into RGB by the plain formula ({failed})");
        let rgb = inks.as_chunks::<4>().0.iter().flat_map(|&[c, m, y, k]| [c, m, y].map(|ink| (1.0 - ink) * (1.0 - k)));
        let samples = if self.layout.bits <= 8 {
            Samples::U8(rgb.map(|v| (v * 255.0).round() as u8).collect())
        } else {
            Samples::U16(rgb.map(|v| (v * 65535.0).round() as u16).collect())
        };
        Ok(Pixels { channels: 3, samples, associated: false })
    }

    /// Luma and chroma of 8 bits.
    pub(super) fn ycbcr(&self) -> Result<Pixels> {
        if self.layout.bits != 8 {
            return Err(Error::unsupported(self.path, "TIFF of YCbCr of other than 8 bits; convert it to RGB first"));
        }
        let codes = self.codes(3, "YCbCr")?;
        let list = |tag: u16, default: &[f64]| {
            let found = self.file.fractions(self.directory, tag);
            let found = found.filter(|v| v.len() == default.len() && v.iter().all(|v| v.is_finite()));
            found.unwrap_or_else(|| default.to_vec())
        };
        let weights = list(529, &[0.299, 0.587, 0.114]);
        let range = list(532, &[0.0, 255.0, 128.0, 255.0, 128.0, 255.0]);
        if weights[1] == 0.0 || (0..3).any(|i| range[2 * i] == range[2 * i + 1]) {
            return Err(Error::invalid(self.path, "a YCbCr TIFF with weights that give no colour (damaged)"));
        }
        let scaled =
            |v: u16, i: usize, span: f64| (f64::from(v) - range[2 * i]) * span / (range[2 * i + 1] - range[2 * i]);
        let rgb = codes.as_chunks::<3>().0.iter().flat_map(|p| {
            let (y, cb, cr) = (scaled(p[0], 0, 255.0), scaled(p[1], 1, 127.0), scaled(p[2], 2, 127.0));
            let (r, b) = (y + cr * (2.0 - 2.0 * weights[0]), y + cb * (2.0 - 2.0 * weights[2]));
            let g = (y - weights[2] * b - weights[0] * r) / weights[1];
            [r, g, b].map(|v| v.round().clamp(0.0, 255.0) as u8)
        });
        Ok(Pixels { channels: 3, samples: Samples::U8(rgb.collect()), associated: false })
    }

    /// CIE L*a*b* under D50 as linear light; a and b are signed, or as ICC profiles have them with zero in the middle.
    pub(super) fn lab(&self, signed: bool) -> Result<Pixels> {
        let codes = self.codes(3, "L*a*b*")?;
        let bits = self.layout.bits;
        if bits != 8 && bits != 16 {
            let what = format!("TIFF of L*a*b* of {bits} bits; convert it to RGB first");
            return Err(Error::unsupported(self.path, what));
        }
        let white = colour::D50_XYZ;
        let adapted = colour::adaptation(white, colour::xy_to_xyz(colour::D65));
        let to_rgb = colour::product(&Space::REC709.xyz_to_rgb(), &adapted);
        let opponent = |v: u16| match (bits, signed) {
            (8, true) => f64::from(v as u8 as i8),
            (8, false) => f64::from(v) - 128.0,
            (_, true) => f64::from(v as i16) / 256.0,
            (_, false) => f64::from(v) / 256.0 - 128.0,
        };
        // 16-bit ICC codes (version 2) have 100 at 0xff00.
        let full = if bits == 8 {
            255.0
        } else if signed {
            65535.0
        } else {
            65280.0
        };
        let light = codes.as_chunks::<3>().0.iter().flat_map(|&[l, a, b]| {
            let lab = [f64::from(l) * 100.0 / full, opponent(a), opponent(b)];
            colour::product_vec(&to_rgb, colour::lab_to_xyz(lab, white)).map(|v| v as f32)
        });
        Ok(Pixels { channels: 3, samples: Samples::F32(light.collect()), associated: false })
    }
}
