//! OpenEXR luminance/chroma pictures: Y, RY = (R − Y)/Y and BY = (B − Y)/Y, chroma usually at half resolution.
//!
//! The exr crate refuses subsampled channels, but its codecs know them: headers, chunks and pixels are taken apart here,
//! the compressed bytes go through the crate. Chroma is interpolated linearly; OpenEXR's own reader has a filter of 27
//! taps, which is sharper at hard edges of colour.

use super::exr_frame::{DAMAGED_BLOCK, Frame, each_sample, failed, metadata, raster};
use super::exr_layers::Roles;
use crate::colour::Space;
use crate::raster::Raster;
use crate::{Error, Result, guard, limits};
use exr::block::chunk::CompressedScanLineBlock;
use exr::block::lines::{LineIndex, LineRef};
use exr::math::Vec2;
use exr::meta::attribute::{ChannelDescription, IntegerBounds};
use exr::meta::{BlockDescription, header::Header};
use std::io::{BufRead, Seek, SeekFrom};
use std::path::Path;

/// Whether any channel of a header has fewer samples than pixels.
pub(crate) fn is_subsampled(header: &Header) -> bool {
    header.channels.list.iter().any(|c| c.sampling != Vec2(1, 1))
}

/// Reads the single part `header` of a file that stands at its offset table.
pub(crate) fn read<R: BufRead + Seek>(mut file: R, header: &Header, file_bytes: u64, path: &Path) -> Result<Raster> {
    let roles = match Roles::of(header, "") {
        Some(roles) if header.blocks == BlockDescription::ScanLines => roles,
        _ => return Err(Error::unsupported(path, "subsampled OpenEXR channels other than Y, RY and BY by scan line")),
    };
    let frame = Frame::new(header, roles.slots(), file_bytes, path)?;
    let mut planes = Planes::new(header, path)?;
    for offset in offsets(&mut file, header, path)? {
        file.seek(SeekFrom::Start(offset)).map_err(|e| Error::io(path, e))?;
        let chunk =
            CompressedScanLineBlock::read(&mut file, header.max_block_byte_size()).map_err(|e| failed(path, e))?;
        planes.insert(header, chunk, path)?;
    }
    let mut samples = limits::buffer::<f32>(path, frame.width * frame.height * frame.slots)?;
    for channel in 0..header.channels.list.len() {
        let Some(slot) = roles.slot(channel) else { continue };
        for y in 0..header.layer_size.y() {
            let Some((first, skip, count)) = frame.run(0, y as i64, header.layer_size.x()) else { continue };
            for i in 0..count {
                samples[(first + i) * frame.slots + slot] = planes.at(channel, skip + i, y);
            }
        }
    }
    let metadata = metadata(header);
    if roles.luma_chroma {
        to_rgb(&mut samples, frame.slots, metadata.chromaticities);
    }
    Ok(raster(&frame, samples, metadata))
}

/// Where the chunks of the file begin.
pub(crate) fn offsets<R: BufRead>(file: &mut R, header: &Header, path: &Path) -> Result<Vec<u64>> {
    let mut table = limits::buffer::<u8>(path, 8 * header.chunk_count)?;
    file.read_exact(&mut table).map_err(|e| failed(path, e.into()))?;
    Ok(table.as_chunks::<8>().0.iter().map(|b| u64::from_le_bytes(*b)).collect())
}

/// Every channel at its own resolution.
struct Planes {
    channels: Vec<Plane>,
}

struct Plane {
    sampling: Vec2<usize>,
    size: Vec2<usize>,
    values: Vec<f32>,
}

impl Planes {
    fn new(header: &Header, path: &Path) -> Result<Self> {
        let plane = |c: &ChannelDescription| {
            let (size, sampling) = (header.layer_size, c.sampling);
            let position = header.own_attributes.layer_position;
            let divides = |s: usize, size: usize, position: i32| {
                s > 0 && size.is_multiple_of(s) && i64::from(position).rem_euclid(s as i64) == 0
            };
            if !divides(sampling.x(), size.x(), position.x()) || !divides(sampling.y(), size.y(), position.y()) {
                return Err(Error::invalid(path, "an OpenEXR channel whose sampling does not divide the picture"));
            }
            let size = Vec2(size.x() / sampling.x(), size.y() / sampling.y());
            Ok(Plane { sampling, size, values: limits::buffer(path, size.area())? })
        };
        Ok(Self { channels: header.channels.list.iter().map(plane).collect::<Result<_>>()? })
    }

    /// Decompresses a chunk and puts its samples where they belong.
    fn insert(&mut self, header: &Header, chunk: CompressedScanLineBlock, path: &Path) -> Result<()> {
        let lines = header.compression.scan_lines_per_block();
        let (left, top) = (header.own_attributes.layer_position.x(), header.own_attributes.layer_position.y());
        let row = usize::try_from(i64::from(chunk.y_coordinate) - i64::from(top)).ok();
        let Some(first) = row.filter(|r| *r < header.layer_size.y() && r % lines == 0) else {
            return Err(Error::invalid(path, "an OpenEXR chunk lies outside its picture"));
        };
        let rows = lines.min(header.layer_size.y() - first);
        let bounds = IntegerBounds::new((left, chunk.y_coordinate), (header.layer_size.x(), rows));
        let line_bytes = |channel: &Plane, c: &ChannelDescription| channel.size.x() * c.sample_type.bytes_per_sample();
        let stored = |channel: &Plane, y: usize| (first + y).is_multiple_of(channel.sampling.y());
        let channels = &header.channels.list;
        let expected: usize = (0..rows)
            .flat_map(|y| self.channels.iter().zip(channels).filter(move |(p, _)| stored(p, y)))
            .map(|(p, c)| line_bytes(p, c))
            .sum();
        // The crate counts bytes as pixels times bytes per pixel; the mean number makes that true for this block.
        let mut described = header.clone();
        if !expected.is_multiple_of(bounds.size.area()) {
            return Err(Error::unsupported(path, "an OpenEXR picture with this sampling of its channels"));
        }
        described.channels.bytes_per_pixel = expected / bounds.size.area();
        let (compression, bytes) = (header.compression, chunk.compressed_pixels_le);
        let data = guard::run(|| compression.decompress_image_section_from_le(&described, bytes, bounds, false))
            .ok_or_else(|| Error::invalid(path, DAMAGED_BLOCK))?
            .map_err(|e| failed(path, e))?;
        if data.len() != expected {
            return Err(Error::invalid(path, "a damaged OpenEXR chunk"));
        }
        let mut rest = data.as_slice();
        for y in 0..rows {
            for (plane, channel) in self.channels.iter_mut().zip(channels).filter(|(p, _)| stored(p, y)) {
                let (line, tail) = rest.split_at(line_bytes(plane, channel));
                rest = tail;
                let start = (first + y) / plane.sampling.y() * plane.size.x();
                each_sample(&whole_line(line, plane.size.x()), channel.sample_type, |i, v| plane.values[start + i] = v);
            }
        }
        Ok(())
    }

    /// The value of a channel at a pixel of the data window; samples sit on the first of their pixels.
    fn at(&self, channel: usize, x: usize, y: usize) -> f32 {
        let p = &self.channels[channel];
        let split = |i: usize, s: usize, n: usize| (i / s, (i / s + 1).min(n - 1), (i % s) as f32 / s as f32);
        let (x0, x1, fx) = split(x, p.sampling.x(), p.size.x());
        let (y0, y1, fy) = split(y, p.sampling.y(), p.size.y());
        let row = |y: usize| {
            let (a, b) = (p.values[y * p.size.x() + x0], p.values[y * p.size.x() + x1]);
            if fx == 0.0 { a } else { a + fx * (b - a) }
        };
        if fy == 0.0 { row(y0) } else { row(y0) + fy * (row(y1) - row(y0)) }
    }
}

fn whole_line(value: &[u8], sample_count: usize) -> LineRef<'_> {
    let location = LineIndex { layer: 0, channel: 0, level: Vec2(0, 0), position: Vec2(0, 0), sample_count };
    LineRef { location, value }
}

/// Turns interleaved RY, Y, BY (and alpha, if `slots` is 4) into R, G, B in place.
///
/// Y is the luminance in the file's own primaries (Rec. 709 without `chromaticities`).
pub(crate) fn to_rgb(samples: &mut [f32], slots: usize, chromaticities: Option<[[f32; 2]; 4]>) {
    let space = chromaticities.and_then(Space::from_chromaticities).unwrap_or(Space::REC709);
    let [wr, wg, wb] = space.luminance_weights().map(|w| w as f32);
    for p in samples.chunks_exact_mut(slots) {
        let (ry, y, by) = (p[0], p[1], p[2]);
        let (r, b) = ((ry + 1.0) * y, (by + 1.0) * y);
        p[0] = r;
        p[1] = (y - wr * r - wb * b) / wg;
        p[2] = b;
    }
}
