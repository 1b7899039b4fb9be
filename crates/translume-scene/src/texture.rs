//! Colours that vary over a surface.

use crate::TextureId;
use glam::DAffine2;
use std::sync::Arc;
use translume_bxdf::Rgb;
use translume_image::Picture;

/// A colour, or a number in all three channels, over texture coordinates.
#[derive(Clone, Debug)]
pub enum Texture {
    /// The same everywhere.
    Constant(Rgb),
    /// A picture.
    Bitmap(Bitmap),
    /// Squares of two colours.
    Checkerboard(Checkerboard),
    /// The mesh's vertex colours (white where it has none), times a factor.
    VertexColor(Rgb),
    /// The coverage of the mesh's vertices (1 where it has none).
    VertexAlpha,
    /// Both multiplied.
    Product(TextureId, TextureId),
    /// One minus it.
    Complement(TextureId),
    /// 1 where it is `at` or more, 0 elsewhere.
    Threshold {
        /// Of what.
        of: TextureId,
        /// The first value that counts.
        at: f32,
    },
}

/// A picture as a texture.
#[derive(Clone, Debug)]
pub struct Bitmap {
    /// Pixels: linear light, or the stored numbers (integers over their maximum) of a raw texture. Shared by all
    /// textures from one file.
    pub image: Arc<Picture>,
    /// Which set of the shape's texture coordinates; where it has not that many, the first.
    pub set: usize,
    /// From the shape's texture coordinates to the picture: (0, 0) is the upper left corner of the picture, (1, 1) the
    /// lower right one. Pixel centres are at halves: column x is at (x + 0.5) / width.
    pub image_from_uv: DAffine2,
    /// Interpolation.
    pub filter: Filter,
    /// What is beyond the picture, horizontally and vertically.
    pub wrap: [Wrap; 2],
    /// Which of the file's channels.
    pub channel: Channel,
    /// Factor on the value, per channel.
    pub scale: Rgb,
}

/// Squares of two colours.
#[derive(Clone, Debug)]
pub struct Checkerboard {
    /// Colour where the fractional parts of both transformed coordinates are on the same side of one half.
    pub color0: TextureId,
    /// The other.
    pub color1: TextureId,
    /// From the shape's texture coordinates to the board: two squares to the unit in each direction.
    pub board_from_uv: DAffine2,
}

/// Interpolation between pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Filter {
    /// The nearest pixel.
    Nearest,
    /// Between the four nearest.
    #[default]
    Bilinear,
}

/// The picture beyond its border.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// Over and over.
    #[default]
    Repeat,
    /// Every other one turned over.
    Mirror,
    /// The border's colour.
    Clamp,
    /// Black.
    Zero,
    /// White.
    One,
}

/// Where a value comes from in a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Channel {
    /// Red, green and blue; where one number is wanted, their luminance.
    #[default]
    Rgb,
    /// The first alone, as gray.
    Red,
    /// The second alone.
    Green,
    /// The third alone.
    Blue,
    /// Coverage, 1 where the file has none.
    Alpha,
}
