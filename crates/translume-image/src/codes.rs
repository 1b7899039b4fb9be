//! Encoded values as a camera file stores them.

use crate::Metadata;

/// The samples of a [`Codes`], interleaved RGB, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub enum Samples {
    /// 8-bit codes.
    U8(Vec<u8>),
    /// 16-bit codes.
    U16(Vec<u16>),
    /// Float values; linear radiance unless the metadata says otherwise.
    F32(Vec<f32>),
}

/// A picture as stored: encoded RGB values, turned upright (EXIF orientation applied), not linearised and not colour
/// managed.
#[derive(Clone, Debug)]
pub struct Codes {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `3 * width * height` values.
    pub samples: Samples,
    /// What the file says about the shot.
    pub metadata: Metadata,
}

impl Codes {
    /// Whether the samples are linear in radiance as they stand (float sources).
    pub fn is_linear(&self) -> bool {
        matches!(self.samples, Samples::F32(_))
    }

    /// Sample `i` on the scale where full range is 1 (integers) or as it stands (floats).
    pub fn unit(&self, i: usize) -> f32 {
        match &self.samples {
            Samples::U8(v) => f32::from(v[i]) / 255.0,
            Samples::U16(v) => f32::from(v[i]) / 65535.0,
            Samples::F32(v) => v[i],
        }
    }
}
