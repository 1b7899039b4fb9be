//! Linear light with the facts of the shot.

use crate::{Orientation, colour::Space, linear};
use image::Rgb32FImage;

/// What a file says about its picture. Everything is optional; nothing is guessed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Metadata {
    /// Exposure time in seconds (EXIF `ExposureTime`, OpenEXR `expTime`).
    pub exposure_secs: Option<f64>,
    /// The f-number N of the aperture.
    pub f_number: Option<f64>,
    /// ISO speed.
    pub iso: Option<f64>,
    /// Camera maker and model.
    pub camera: Option<String>,
    /// Copyright holder or owner.
    pub owner: Option<String>,
    /// Time of capture as the camera wrote it.
    pub date_time: Option<String>,
    /// Moment of the shot in seconds (EXIF `DateTimeOriginal` with its fraction), from an origin that all files share.
    pub captured_secs: Option<f64>,
    /// Whether the camera took it as one of an automatic bracket (EXIF `ExposureMode` 2), where it says so.
    pub auto_bracket: Option<bool>,
    /// How the file said that its rows lie; the pixels have been turned upright by it.
    pub orientation: Orientation,
    /// The embedded ICC profile.
    pub icc: Option<Vec<u8>>,
    /// CIE xy of red, green, blue and white (OpenEXR `chromaticities`).
    pub chromaticities: Option<[[f32; 2]; 4]>,
}

impl Metadata {
    /// Relative exposure `t · ISO/100 / N²`: proportional to the light a pixel code stands for.
    /// `None` without an exposure time; a missing f-number or ISO counts as the same for all pictures of the set.
    pub fn relative_exposure(&self) -> Option<f64> {
        let t = self.exposure_secs.filter(|t| t.is_finite() && *t > 0.0)?;
        let sane = |v: Option<f64>| v.filter(|v| v.is_finite() && *v > 0.0);
        let iso = sane(self.iso).map_or(1.0, |i| i / 100.0);
        let n = sane(self.f_number).unwrap_or(1.0);
        Some(t * iso / (n * n))
    }
}

/// A linear picture, Rec. 709 primaries unless [`Metadata::chromaticities`] says otherwise.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Linear RGB.
    pub pixels: Rgb32FImage,
    /// Coverage in [0, 1], one value a pixel, if the file has it; the pixels are multiplied by it, as in OpenEXR.
    pub alpha: Option<Vec<f32>>,
    /// What the file says.
    pub metadata: Metadata,
}

impl Picture {
    /// The same light in the primaries of `space`, whites adapted by Bradford; the metadata tells the primaries.
    pub fn into_space(mut self, space: &Space) -> Self {
        let own = self.metadata.chromaticities.and_then(Space::from_chromaticities).unwrap_or(Space::REC709);
        if linear::differs(&own, space) {
            linear::multiply(&mut self.pixels, &own.to(space));
        }
        self.metadata.chromaticities = linear::differs(space, &Space::REC709).then(|| space.chromaticities());
        self
    }

    /// A picture without metadata.
    pub fn new(pixels: Rgb32FImage) -> Self {
        Self { pixels, alpha: None, metadata: Metadata::default() }
    }
}
