//! Cameras and films.

use crate::MediumId;
use glam::{DAffine3, DVec3};

/// A camera with its film.
#[derive(Clone, Debug)]
pub struct Sensor {
    /// Name or identifier in the file; may be empty.
    pub name: String,
    /// Place and direction: it looks along +z, +y is up, +x is the left of the picture. May mirror; invertible.
    pub world_from_camera: DAffine3,
    /// How directions map to the film.
    pub projection: Projection,
    /// Nothing nearer along +z is seen.
    pub near_clip: f32,
    /// Nothing farther along +z is seen.
    pub far_clip: f32,
    /// Size and filter of the picture.
    pub film: Film,
    /// Samples per pixel that the file asks for.
    pub sample_count: Option<u32>,
    /// What the camera stands in.
    pub medium: Option<MediumId>,
}

/// A camera's place at `origin`, looking at `target`; `None` where `up` is along the view, or nothing is left of a direction.
pub fn look_at(origin: DVec3, target: DVec3, up: DVec3) -> Option<DAffine3> {
    let forward = (target - origin).try_normalize()?;
    let left = up.cross(forward).try_normalize()?;
    Some(DAffine3::from_cols(left, forward.cross(left), forward, origin))
}

/// How directions map to the film.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// A pinhole.
    Perspective(Perspective),
    /// A lens with depth of field.
    ThinLens {
        /// The pinhole in its middle.
        perspective: Perspective,
        /// Radius of the lens, in the camera's space.
        aperture_radius: f32,
        /// Distance along +z of what is sharp.
        focus_distance: f32,
    },
    /// Parallel: the picture's width is −1 to 1 of the camera's space, its height by the aspect ratio.
    Orthographic,
}

/// A pinhole camera's opening.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Perspective {
    /// Field of view along `fov_axis`, in (0, π).
    pub fov: f32,
    /// What the field of view is measured along.
    pub fov_axis: FovAxis,
    /// Shift of the picture's middle, in widths and heights.
    pub principal_point_offset: [f32; 2],
}

/// What a field of view is measured along.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FovAxis {
    /// The width.
    #[default]
    X,
    /// The height.
    Y,
    /// The diagonal.
    Diagonal,
    /// The shorter of width and height.
    Smaller,
    /// The longer one.
    Larger,
}

impl Perspective {
    /// Horizontal field of view of a film of `width` × `height` pixels.
    pub fn fov_x(&self, width: u32, height: u32) -> f32 {
        let aspect = f64::from(width) / f64::from(height);
        // Half the extents of the film at distance 1 are in proportion to (aspect, 1).
        let along = match self.fov_axis {
            FovAxis::X => aspect,
            FovAxis::Y => 1.0,
            FovAxis::Diagonal => aspect.hypot(1.0),
            FovAxis::Smaller => aspect.min(1.0),
            FovAxis::Larger => aspect.max(1.0),
        };
        (2.0 * ((0.5 * f64::from(self.fov)).tan() * aspect / along).atan()) as f32
    }
}

/// The picture to be taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Film {
    /// Width and height in pixels, none 0.
    pub size: [u32; 2],
    /// Part of the picture that is rendered.
    pub crop: Option<Crop>,
    /// Reconstruction filter.
    pub filter: PixelFilter,
}

/// A window in the picture, inside of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crop {
    /// Its upper left pixel.
    pub offset: [u32; 2],
    /// Width and height in pixels, none 0.
    pub size: [u32; 2],
}

/// Reconstruction filters: separable functions of the distance x from the pixel's centre, in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PixelFilter {
    /// 1 up to `radius`.
    Box {
        /// Half the width.
        radius: f32,
    },
    /// 1 − |x|/radius.
    Tent {
        /// Half the width.
        radius: f32,
    },
    /// exp(−x²/2σ²) − exp(−radius²/2σ²).
    Gaussian {
        /// σ.
        stddev: f32,
        /// Half the width.
        radius: f32,
    },
    /// Mitchell & Netravali's cubic, on |x| ≤ 2.
    Mitchell {
        /// Blur.
        b: f32,
        /// Ringing.
        c: f32,
    },
    /// Mitchell's with b = 0, c = ½.
    CatmullRom,
    /// sinc(x) · sinc(x/lobes).
    Lanczos {
        /// Half the width.
        lobes: f32,
    },
}

impl Default for PixelFilter {
    fn default() -> Self {
        Self::Gaussian { stddev: 0.5, radius: 2.0 }
    }
}
