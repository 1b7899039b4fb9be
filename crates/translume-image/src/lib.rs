//! HDR pictures: files, colour, tone mapping and metrics.
//!
//! Two types carry pixels. [`Codes`] is what a camera file stores: encoded values, undecoded, with the facts of the
//! shot beside them; the HDR merge wants it, because it finds the response curve itself. [`Picture`] is linear light.
//! Row 0 is the top row of the image; samples are interleaved RGB.
//!
//! This crate knows nothing about where a picture comes from or what it is for.

pub mod atomic;
mod cicp;
mod codes;
pub mod colour;
pub mod compare;
pub mod denoise;
mod error;
mod exif;
mod formats;
pub mod guard;
mod icc;
pub mod limits;
mod linear;
pub mod metrics;
mod names;
mod orient;
mod picture;
pub mod primaries;
mod raster;
mod read;
pub mod text;
pub mod tonemap;

pub use codes::{Codes, Samples};
pub use error::{Error, Result};
pub use formats::exr_read::{ExrChannel, ExrPart, ExrPlanes, read_exr_channels, read_exr_parts};
pub use formats::exr_write::{ExrCompression, ExrOptions, Precision, write_exr, write_exr_channels};
pub use formats::jpeg::{encode_jpeg, write_jpeg};
pub use formats::pfm::write_pfm;
pub use formats::png::{write_gray_png, write_png8, write_png16};
pub use formats::radiance::write_hdr;
pub use formats::tiff::{write_tiff_float, write_tiff8, write_tiff16};
pub use image::Rgb32FImage;
pub use names::natural_key;
pub use orient::Orientation;
pub use picture::{Metadata, Picture};
pub use read::{
    Format, TextureCodes, decode_codes, decode_picture, decode_texture, read_codes, read_codes_alpha, read_layer,
    read_picture,
};
