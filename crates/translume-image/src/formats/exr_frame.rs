//! What every reader of OpenEXR pictures needs: where the data lies in the picture, its samples, errors and metadata.

use crate::limits::{self, Claim};
use crate::raster::{Raster, Transfer};
use crate::{Error, Metadata, Result, Samples, orient::Orientation};
use exr::block::lines::LineRef;
use exr::meta::attribute::{AttributeValue, Chromaticities, SampleType, Text};
use exr::meta::header::Header;
use std::path::Path;

pub(crate) const DAMAGED_BLOCK: &str = "a damaged OpenEXR block; copy or render the file again";

pub(crate) fn raster(frame: &Frame, samples: Vec<f32>, metadata: Metadata) -> Raster {
    Raster {
        width: frame.width,
        height: frame.height,
        channels: frame.slots,
        samples: Samples::F32(samples),
        transfer: Transfer::Power(1.0),
        associated: true,
        orientation: Orientation::default(),
        metadata,
    }
}

/// Where the data window lies in the picture.
pub(crate) struct Frame {
    pub width: usize,
    pub height: usize,
    pub slots: usize,
    offset: (i64, i64),
}

impl Frame {
    pub(crate) fn new(header: &Header, slots: usize, file_bytes: u64, path: &Path) -> Result<Self> {
        let display = header.shared_attributes.display_window;
        let data = header.data_window();
        let size = (display.size.x() as u64, display.size.y() as u64);
        // A crop stores little of a large picture: 8K is always allowed. More must be backed by the file.
        let backed = if size.0.saturating_mul(size.1) <= 1 << 25 { u64::MAX } else { file_bytes };
        let (channels, max_ratio) = (slots as u64, limits::MAX_RATIO);
        Claim { size, channels, bits: 16 * channels, file_bytes: backed, max_ratio }.stored(path)?;
        Claim { size, channels, bits: 0, file_bytes, max_ratio }.samples(path)?;
        let offset = (
            i64::from(data.position.x()) - i64::from(display.position.x()),
            i64::from(data.position.y()) - i64::from(display.position.y()),
        );
        Ok(Self { width: display.size.x(), height: display.size.y(), slots, offset })
    }

    /// The visible part of `count` samples from (x, y) of the data window on: index of the first pixel in the picture,
    /// samples to skip, samples to take.
    pub(crate) fn run(&self, x: i64, y: i64, count: usize) -> Option<(usize, usize, usize)> {
        let (x, y) = (x + self.offset.0, y + self.offset.1);
        let (first, last) = (x.max(0), (x + count as i64).min(self.width as i64));
        if y < 0 || y >= self.height as i64 || first >= last {
            return None;
        }
        Some((y as usize * self.width + first as usize, (first - x) as usize, (last - first) as usize))
    }
}

/// Calls `take` with index and value of each sample of a line.
pub(crate) fn each_sample(line: &LineRef<'_>, sample_type: SampleType, mut take: impl FnMut(usize, f32)) {
    match sample_type {
        SampleType::F16 => {
            for (i, b) in line.value.as_chunks::<2>().0.iter().enumerate() {
                take(i, half::f16::from_ne_bytes(*b).to_f32());
            }
        }
        SampleType::F32 => {
            for (i, b) in line.value.as_chunks::<4>().0.iter().enumerate() {
                take(i, f32::from_ne_bytes(*b));
            }
        }
        SampleType::U32 => {
            for (i, b) in line.value.as_chunks::<4>().0.iter().enumerate() {
                take(i, u32::from_ne_bytes(*b) as f32);
            }
        }
    }
}

pub(crate) fn failed(path: &Path, e: exr::error::Error) -> Error {
    match e {
        exr::error::Error::Io(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => Error::io(path, e),
        exr::error::Error::Io(_) => Error::invalid(path, "the OpenEXR file ends before its picture does (truncated)"),
        exr::error::Error::NotSupported(what) => Error::unsupported(path, format!("OpenEXR: {what}")),
        other => Error::invalid(path, format!("damaged or truncated OpenEXR ({other})")),
    }
}

/// The facts of the shot from the standard attributes.
pub(crate) fn metadata(header: &Header) -> Metadata {
    let own = &header.own_attributes;
    let number = |v: Option<f32>| v.map(f64::from).filter(|v| v.is_finite() && *v > 0.0);
    let text = |v: &Option<Text>| v.as_ref().map(ToString::to_string).filter(|s| !s.is_empty());
    let other = |name: &str| match own.other.get(&Text::from(name)) {
        Some(AttributeValue::Text(t)) => Some(t.to_string()),
        _ => None,
    };
    Metadata {
        exposure_secs: number(own.exposure),
        f_number: number(own.aperture),
        iso: number(own.iso_speed),
        camera: match (other("cameraMake"), other("cameraModel")) {
            (Some(make), Some(model)) if !model.starts_with(&make) => Some(format!("{make} {model}")),
            (make, model) => model.or(make),
        },
        owner: text(&own.owner),
        date_time: text(&own.capture_date),
        chromaticities: header
            .shared_attributes
            .chromaticities
            .map(|c: Chromaticities| [c.red, c.green, c.blue, c.white].map(|v| [v.x(), v.y()])),
        ..Metadata::default()
    }
}
