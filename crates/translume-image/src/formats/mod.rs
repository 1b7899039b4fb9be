//! One file format each: bytes to samples and back.

pub(crate) mod exr_chroma;
pub(crate) mod exr_frame;
pub(crate) mod exr_layers;
pub(crate) mod exr_read;
pub(crate) mod exr_write;
pub(crate) mod jpeg;
pub(crate) mod jpeg_scan;
pub(crate) mod pfm;
pub(crate) mod png;
pub(crate) mod png_chunks;
pub(crate) mod radiance;
pub(crate) mod raw;
pub(crate) mod tga;
pub(crate) mod tiff;
