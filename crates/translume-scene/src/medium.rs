//! Participating media.

use glam::DAffine3;
use std::sync::Arc;
use translume_bxdf::{Phase, Rgb};

/// What fills the space between surfaces.
#[derive(Clone, Debug)]
pub struct Medium {
    /// Name or identifier in the file; may be empty.
    pub name: String,
    /// Extinction coefficient before [`Medium::scale`], per unit of length. A grid's medium is where the grid is: there is nothing
    /// outside its box.
    pub sigma_t: Volume,
    /// Single scattering albedo, 0–1.
    pub albedo: Volume,
    /// Factor on `sigma_t`.
    pub scale: f32,
    /// Where scattered light goes.
    pub phase: Phase,
    /// From the unit cube to the world: there is nothing outside, whatever shape encloses the medium. `None`: it fills its shape.
    pub domain: Option<DAffine3>,
}

/// A colour, or a number in all three channels, over space.
#[derive(Clone, Debug)]
pub enum Volume {
    /// The same everywhere.
    Constant(Rgb),
    /// Samples on a grid, interpolated between the eight nearest.
    Grid {
        /// The samples; shared by all volumes from one file.
        grid: Arc<Grid>,
        /// From the unit cube, which the grid fills, to the world; invertible.
        world_from_grid: DAffine3,
        /// Where in the unit cube the samples are.
        samples: Samples,
        /// Interpolation.
        filter: crate::texture::Filter,
        /// How it goes on outside of its box.
        wrap: crate::texture::Wrap,
    },
}

/// Where the samples of a grid are, for n of them along an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Samples {
    /// At (i + 0.5)/n: in the middle of cells (Mitsuba 3, pbrt). The border's values go on to the faces.
    Centers,
    /// At i/(n − 1): the first and the last on the faces (Mitsuba 0.6).
    Corners,
}

/// Numbers on a grid, all finite and not negative.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Samples along x, y and z; none is 0.
    pub size: [usize; 3],
    /// 1 or 3.
    pub channels: usize,
    /// `channels` numbers per sample, x fastest, then y, then z.
    pub values: Vec<f32>,
}

impl Grid {
    /// The largest number of each channel (of gray grids: in all three).
    pub fn max(&self) -> Rgb {
        let mut max = [0.0_f32; 3];
        for sample in self.values.chunks_exact(self.channels) {
            for c in 0..3 {
                max[c] = max[c].max(sample[c.min(self.channels - 1)]);
            }
        }
        Rgb::from(max)
    }
}

impl Medium {
    /// An upper bound of the extinction coefficient, scale included.
    pub fn majorant(&self) -> Rgb {
        let max = match &self.sigma_t {
            Volume::Constant(rgb) => *rgb,
            Volume::Grid { grid, .. } => grid.max(),
        };
        max * self.scale
    }
}
