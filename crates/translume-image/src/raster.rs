//! What every decoder hands over: stored samples of one to four channels, with the facts beside them.

use crate::{Codes, Metadata, Samples, cicp, orient::Orientation};

/// How integer samples are to be read as light, where no ICC profile says so.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Transfer {
    Srgb,
    /// Light is the code to this power (PNG gAMA; 1 is linear).
    Power(f32),
    /// A curve of H.273 (PNG cICP).
    Video(cicp::Curve),
}

/// A decoded file before colour management. Channels: gray, gray + alpha, RGB, RGBA.
#[derive(Debug)]
pub(crate) struct Raster {
    pub width: usize,
    pub height: usize,
    pub channels: usize,
    pub samples: Samples,
    pub transfer: Transfer,
    /// Whether colour is multiplied by alpha already (OpenEXR), where there is alpha.
    pub associated: bool,
    pub orientation: Orientation,
    pub metadata: Metadata,
}

impl Raster {
    /// Upright RGB, as [`Codes`] wants it, with the alpha channel of the file in [0, 1] beside it.
    pub(crate) fn into_codes(self) -> (Codes, Option<Vec<f32>>) {
        let size = (self.width, self.height);
        let has_alpha = self.channels == 2 || self.channels == 4;
        let (rgb, alpha) = match self.samples {
            Samples::U8(v) => {
                let alpha = has_alpha.then(|| last_channel(&v, self.channels, |a| f32::from(a) / 255.0));
                (Samples::U8(self.orientation.apply(size, 3, to_rgb(v, self.channels)).2), alpha)
            }
            Samples::U16(v) => {
                let alpha = has_alpha.then(|| last_channel(&v, self.channels, |a| f32::from(a) / 65535.0));
                (Samples::U16(self.orientation.apply(size, 3, to_rgb(v, self.channels)).2), alpha)
            }
            Samples::F32(v) => {
                let alpha = has_alpha.then(|| last_channel(&v, self.channels, |a| a));
                (Samples::F32(self.orientation.apply(size, 3, to_rgb(v, self.channels)).2), alpha)
            }
        };
        let alpha = alpha.map(|a| self.orientation.apply(size, 1, a).2);
        let metadata = Metadata { orientation: self.orientation, ..self.metadata };
        let (width, height) = if self.orientation.swaps_axes() { (size.1, size.0) } else { size };
        (Codes { width, height, samples: rgb, metadata }, alpha)
    }
}

fn last_channel<T: Copy>(v: &[T], channels: usize, unit: impl Fn(T) -> f32) -> Vec<f32> {
    v.chunks_exact(channels).map(|p| unit(p[channels - 1])).collect()
}

/// RGB from one to four channels; three pass through untouched.
fn to_rgb<T: Copy>(v: Vec<T>, channels: usize) -> Vec<T> {
    match channels {
        1 => v.iter().flat_map(|&g| [g; 3]).collect(),
        2 => v.as_chunks::<2>().0.iter().flat_map(|p| [p[0]; 3]).collect(),
        4 => v.as_chunks::<4>().0.iter().flat_map(|p| [p[0], p[1], p[2]]).collect(),
        _ => v,
    }
}
