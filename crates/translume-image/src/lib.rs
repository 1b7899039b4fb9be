//! HDR pictures: files, colour, tone mapping and metrics.
//!
//! Two types carry pixels. [`Codes`] is what a camera file stores: encoded values, undecoded, with the facts of the
//! shot beside them; the HDR merge wants it, because it finds the response curve itself. [`Picture`] is linear light.
//! Row 0 is the top row of the image; samples are interleaved RGB.
//!
//! This crate knows nothing about where a picture comes from or what it is for.

pub mod atomic;
mod codes;
mod error;
mod picture;

pub use codes::{Codes, Samples};
pub use error::{Error, Result};
pub use image::Rgb32FImage;
pub use picture::{Metadata, Picture};
