//! Truevision TGA: 8-bit gray, palette, RGB and RGBA, raw or run-length coded, through the `image` crate.
//!
//! TGA files have no mark at their start: they are told by the ending of their name.

use crate::limits::{self, Claim};
use crate::raster::{Raster, Transfer};
use crate::{Error, Metadata, Result, Samples, guard, orient::Orientation};
use image::codecs::tga::TgaDecoder;
use image::{ColorType, ImageDecoder};
use std::io::Cursor;
use std::path::Path;

/// Whether a file name says TGA.
pub(crate) fn is_tga(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("tga"))
}

pub(crate) fn read(file: &[u8], path: &Path) -> Result<Raster> {
    let damaged = |e: &dyn std::fmt::Display| Error::invalid(path, format!("damaged or truncated TGA ({e})"));
    let decoded = guard::run(|| {
        let decoder = TgaDecoder::new(Cursor::new(file)).map_err(|e| damaged(&e))?;
        let (w, h) = decoder.dimensions();
        let channels = match decoder.color_type() {
            ColorType::L8 => 1,
            ColorType::La8 => 2,
            ColorType::Rgb8 => 3,
            ColorType::Rgba8 => 4,
            other => return Err(Error::unsupported(path, format!("TGA of type {other:?}; convert it to RGB first"))),
        };
        // A run of 128 pixels takes two bytes at least.
        let size = (u64::from(w), u64::from(h));
        let count = Claim { size, channels: channels as u64, bits: 8, file_bytes: file.len() as u64, max_ratio: 64 }
            .samples(path)?;
        let mut samples = limits::buffer::<u8>(path, count)?;
        decoder.read_image(&mut samples).map_err(|e| damaged(&e))?;
        Ok(Raster {
            width: w as usize,
            height: h as usize,
            channels,
            samples: Samples::U8(samples),
            transfer: Transfer::Srgb,
            associated: false,
            orientation: Orientation::default(),
            metadata: Metadata::default(),
        })
    });
    decoded.unwrap_or_else(|| Err(damaged(&"the decoder gave up")))
}
