//! Lights that are no shapes. Radiant quantities carry no photometric factor: numbers are as in the file.

use crate::TextureId;
use glam::{DAffine3, DVec3};
use std::sync::Arc;
use translume_bxdf::Rgb;
use translume_image::Picture;

/// A light without a surface.
#[derive(Clone, Debug)]
pub enum Emitter {
    /// From a point in all directions.
    Point {
        /// Where.
        position: DVec3,
        /// Power per solid angle.
        intensity: Rgb,
    },
    /// From a point into a cone.
    Spot(Spot),
    /// Parallel, from infinitely far away.
    Directional {
        /// Where the light goes, of length 1.
        direction: DVec3,
        /// Power per area perpendicular to it.
        irradiance: Rgb,
    },
    /// All around, from a picture (latitude and longitude; the crate's front page says how directions map).
    Environment {
        /// Radiance. Column x stands at the azimuth (x + ½)/width of a turn, row y at the polar angle π y/(height − 1):
        /// the first and the last row are the poles.
        image: Arc<Picture>,
        /// Factor on it.
        scale: Rgb,
        /// Orientation; only the linear part counts.
        world_from_light: DAffine3,
    },
    /// All around, the same from everywhere.
    Constant {
        /// Radiance.
        radiance: Rgb,
    },
    /// A slide projector: a pinhole camera the other way round.
    Projector {
        /// As for cameras: it shines along +z, +y is the slide's top.
        world_from_light: DAffine3,
        /// Horizontal field of view.
        fov_x: f32,
        /// The slide; over the field of view its texture coordinates run from 0 to 1, the origin at the lower left.
        irradiance: TextureId,
        /// Factor on it. `irradiance · scale` is the irradiance on a plane at distance 1.
        scale: f32,
    },
}

/// A spot light. It shines along +z of its own space.
#[derive(Clone, Debug)]
pub struct Spot {
    /// Place and direction.
    pub world_from_light: DAffine3,
    /// Power per solid angle in the middle.
    pub intensity: Rgb,
    /// Half the opening angle, where the light ends.
    pub cutoff_angle: f32,
    /// Half the angle up to which it is at full strength.
    pub beam_width: f32,
    /// What is between the two.
    pub falloff: Falloff,
}

/// The border of a spot light, as a factor on its intensity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Falloff {
    /// Linear in the angle (Mitsuba).
    LinearInAngle,
    /// s² with s linear in the cosine (glTF).
    SquareInCosine,
    /// 3s² − 2s³ with s linear in the cosine (pbrt).
    SmoothInCosine,
}
