//! OpenEXR as it comes: multi-part, tiled, mip-mapped (the full level is read), half, float and integer channels, named
//! layers (see `exr_layers`), data window unequal to the display window, luminance/chroma. Deep parts are passed over.
//!
//! A picture has the size of the display window: pixels outside the data window are zero (and transparent), data
//! outside the display window is left out.

use super::exr_chroma;
use super::exr_frame::{DAMAGED_BLOCK, Frame, each_sample, failed, metadata, raster};
use super::exr_layers::{choose, choose_layer};
use crate::limits::{self, Claim};
use crate::raster::Raster;
use crate::{Error, Result, guard};
use exr::block::{UncompressedBlock, chunk::Chunk, lines::LineRef};
use exr::compression::Compression;
use exr::math::Vec2;
use exr::meta::attribute::{AttributeValue, SampleType};
use exr::meta::{MetaData, header::Header};
use rayon::prelude::*;
use std::io::{BufRead, Seek, SeekFrom};
use std::path::Path;

/// A channel as stored.
#[derive(Clone, Debug)]
pub struct ExrChannel {
    /// Name with its layer in front, as in `albedo.R`.
    pub name: String,
    /// `half`, `float` or `uint`.
    pub sample_type: &'static str,
}

/// One part of a file.
#[derive(Clone, Debug)]
pub struct ExrPart {
    /// Name, if the file gives one.
    pub name: Option<String>,
    /// Channels in the order of the file (alphabetical).
    pub channels: Vec<ExrChannel>,
    /// Compression method.
    pub compression: String,
    /// Tile size, if tiled.
    pub tiles: Option<[usize; 2]>,
    /// First column, first row, width and height of the stored pixels.
    pub data_window: [i64; 4],
    /// First column, first row, width and height of the picture.
    pub display_window: [i64; 4],
    /// Text attributes beside the standard ones (provenance).
    pub texts: Vec<(String, String)>,
}

/// The parts of an OpenEXR file, from its headers alone.
///
/// # Errors
/// [`Error::Io`], [`Error::Invalid`], [`Error::Unsupported`] (deep data).
pub fn read_exr_parts(path: &Path) -> Result<Vec<ExrPart>> {
    let (file, _) = limits::open(path)?;
    let meta = MetaData::read_from_unbuffered(file, false).map_err(|e| failed(path, e))?;
    Ok(meta.headers.iter().map(describe).collect())
}

/// The channels of one part.
#[derive(Clone, Debug)]
pub struct ExrPlanes {
    /// Pixels in a row of the data window.
    pub width: usize,
    /// Rows of the data window.
    pub height: usize,
    /// Name and `width * height` values of each channel, in the order of the file (alphabetical).
    pub planes: Vec<(String, Vec<f32>)>,
}

/// Every channel of part `part` (0 is the first) as float planes.
///
/// # Errors
/// As [`crate::read_picture`]; subsampled channels are [`Error::Unsupported`].
pub fn read_exr_channels(path: &Path, part: usize) -> Result<ExrPlanes> {
    let (file, file_bytes) = limits::open(path)?;
    let mut file = std::io::BufReader::with_capacity(1 << 16, file);
    let meta = meta_data(&mut file, path)?;
    let Some(header) = meta.headers.get(part) else {
        return Err(Error::Mismatch(format!("{}: there is no part {part}", path.display())));
    };
    if header.deep {
        return Err(Error::unsupported(path, "a deep OpenEXR picture; flatten it first"));
    }
    let (width, height) = (header.layer_size.x(), header.layer_size.y());
    let channels = &header.channels.list;
    meta.headers.iter().try_for_each(|h| check_stored(h, file_bytes, path))?;
    decoded(header, file_bytes).samples(path)?;
    validate(&meta, path)?;
    let count = width * height * channels.len();
    let mut planes = limits::buffer::<f32>(path, count)?;
    read_lines(file, &meta, (part, file_bytes), path, |line| {
        let Vec2(x, y) = line.location.position;
        let channel = line.location.channel;
        let start = (channel * height + y) * width + x;
        each_sample(&line, channels[channel].sample_type, |i, v| planes[start + i] = v);
        Ok(())
    })?;
    let planes = planes.chunks_exact(width * height);
    let planes = channels.iter().zip(planes).map(|(c, p)| (c.name.to_string(), p.to_vec())).collect();
    Ok(ExrPlanes { width, height, planes })
}

/// Reads the layer called `layer`, without one the picture itself.
pub(crate) fn read<R: BufRead + Seek>(
    mut file: R,
    layer: Option<&str>,
    file_bytes: u64,
    path: &Path,
) -> Result<Raster> {
    let meta = meta_data(&mut file, path)?;
    for header in &meta.headers {
        // Those that are not read too: their offset tables are.
        check_stored(header, file_bytes, path)?;
    }
    match meta.headers.as_slice() {
        [header] if layer.is_none() && !header.deep && exr_chroma::is_subsampled(header) => {
            return exr_chroma::read(file, header, file_bytes, path);
        }
        _ => {}
    }
    validate(&meta, path)?;
    let (part, roles) = match layer {
        Some(layer) => choose_layer(&meta.headers, layer, path)?,
        None => choose(&meta.headers, path)?,
    };
    let header = &meta.headers[part];
    let frame = Frame::new(header, roles.slots(), file_bytes, path)?;
    let picture = || limits::buffer::<f32>(path, frame.width * frame.height * frame.slots);
    // Made when the first block turned out sound: a crop of a few bytes may be one of a large picture.
    let mut samples = Vec::new();
    read_lines(file, &meta, (part, file_bytes), path, |line| {
        if samples.is_empty() {
            samples = picture()?;
        }
        let Some(slot) = roles.slot(line.location.channel) else { return Ok(()) };
        let Vec2(x, y) = line.location.position;
        let Some((first, skip, count)) = frame.run(x as i64, y as i64, line.location.sample_count) else {
            return Ok(());
        };
        let sample_type = header.channels.list[line.location.channel].sample_type;
        each_sample(&line, sample_type, |i, v| {
            if i >= skip && i < skip + count {
                samples[(first + i - skip) * frame.slots + slot] = v;
            }
        });
        Ok(())
    })?;
    if samples.is_empty() {
        samples = picture()?;
    }
    let metadata = metadata(header);
    if roles.luma_chroma {
        exr_chroma::to_rgb(&mut samples, frame.slots, metadata.chromaticities);
    }
    Ok(raster(&frame, samples, metadata))
}

/// Chunks that are read before they are decompressed together.
const BATCH: usize = 64;

fn meta_data<R: BufRead>(file: &mut R, path: &Path) -> Result<MetaData> {
    MetaData::read_from_buffered(file, false).map_err(|e| failed(path, e))
}

/// Whether the flat parts are sound by the library's rules; it refuses files with a deep part as a whole.
fn validate(meta: &MetaData, path: &Path) -> Result<()> {
    let flat: Vec<Header> = meta.headers.iter().filter(|h| !h.deep).cloned().collect();
    if !flat.is_empty() {
        MetaData::validate(&flat, false).map_err(|e| failed(path, e))?;
    }
    Ok(())
}

/// Decompresses the full-resolution blocks of one part, of a file of so many bytes that stands at its offset tables, and
/// hands over their lines.
fn read_lines<R: BufRead + Seek>(
    mut file: R,
    meta: &MetaData,
    (part, file_bytes): (usize, u64),
    path: &Path,
    mut take: impl FnMut(LineRef<'_>) -> Result<()>,
) -> Result<()> {
    let offsets = offsets(&mut file, meta, (part, file_bytes), path)?;
    let mut next = |offset: u64| -> Result<Chunk> {
        // Seeking throws away what is buffered.
        if file.stream_position().map_err(|e| Error::io(path, e))? != offset {
            file.seek(SeekFrom::Start(offset)).map_err(|e| Error::io(path, e))?;
        }
        Chunk::read(&mut file, meta).map_err(|e| failed(path, e))
    };
    let mut rest = offsets.into_iter();
    loop {
        let batch: Vec<_> = rest.by_ref().take(BATCH).map(&mut next).collect();
        if batch.is_empty() {
            return Ok(());
        }
        // Not the crate's own threads: a panic there ends the process (see the guard).
        let decompress = |chunk| guard::run(|| UncompressedBlock::decompress_chunk(chunk, meta, false));
        let blocks: Vec<_> = batch.into_par_iter().map(|chunk| chunk.map(decompress)).collect();
        for block in blocks {
            let damaged = || Error::invalid(path, DAMAGED_BLOCK);
            let block = block?.ok_or_else(damaged)?.map_err(|e| failed(path, e))?;
            // A wrong offset may lead to a block of another part or level, which has other lines.
            let header = &meta.headers[part];
            let end = block.index.pixel_position + block.index.pixel_size;
            let inside = end.x() <= header.layer_size.x() && end.y() <= header.layer_size.y();
            let expected = block.index.pixel_size.area() * header.channels.bytes_per_pixel;
            if block.index.layer != part || block.index.level != Vec2(0, 0) || !inside || block.data.len() != expected {
                return Err(damaged());
            }
            block.lines(&header.channels).try_for_each(&mut take)?;
        }
    }
}

/// Where the chunks of the largest level of a part begin, in the order of the file.
fn offsets<R: BufRead + Seek>(
    file: &mut R,
    meta: &MetaData,
    (part, file_bytes): (usize, u64),
    path: &Path,
) -> Result<Vec<u64>> {
    let header = &meta.headers[part];
    let bytes = |h: &Header| (h.chunk_count as u64).saturating_mul(8);
    let before = meta.headers[..part].iter().fold(0u64, |n, h| n.saturating_add(bytes(h)));
    let skipped = i64::try_from(before).ok().filter(|_| before.saturating_add(bytes(header)) <= file_bytes);
    let truncated = || Error::invalid(path, "the OpenEXR file ends before its picture does (truncated)");
    file.seek(SeekFrom::Current(skipped.ok_or_else(truncated)?)).map_err(|e| Error::io(path, e))?;
    let table = exr_chroma::offsets(file, header, path)?;
    let largest = header.blocks_increasing_y_order().enumerate().filter(|(_, t)| t.location.level_index == Vec2(0, 0));
    let offsets: Option<Vec<u64>> = largest.map(|(i, _)| table.get(i).copied()).collect();
    let mut offsets = offsets.ok_or_else(|| Error::invalid(path, DAMAGED_BLOCK))?;
    offsets.sort_unstable();
    Ok(offsets)
}

/// What the header of a part says is stored.
fn decoded(header: &Header, file_bytes: u64) -> Claim {
    let max_ratio = match header.compression {
        // Flat blocks are packed twice: by the cosine transform and by DEFLATE.
        Compression::DWAA(_) | Compression::DWAB(_) => 64 * limits::MAX_RATIO,
        _ => limits::MAX_RATIO,
    };
    Claim {
        size: (header.layer_size.x() as u64, header.layer_size.y() as u64),
        channels: header.channels.list.len() as u64,
        bits: 8 * header.channels.bytes_per_pixel as u64,
        file_bytes,
        max_ratio,
    }
}

/// Whether the file can hold the pixels that a part says are stored. What is decoded of them is held against the limit
/// where it is known which they are.
fn check_stored(header: &Header, file_bytes: u64, path: &Path) -> Result<()> {
    // Deep parts are not read, and have no fixed number of samples.
    if header.deep {
        return Ok(());
    }
    let claim = decoded(header, file_bytes);
    claim.stored(path)
}

fn describe(header: &Header) -> ExrPart {
    let data = header.data_window();
    let display = header.shared_attributes.display_window;
    let window = |w: exr::meta::attribute::IntegerBounds| {
        [i64::from(w.position.x()), i64::from(w.position.y()), w.size.x() as i64, w.size.y() as i64]
    };
    let own = &header.own_attributes;
    let mut texts: Vec<(String, String)> = own
        .other
        .iter()
        .filter_map(|(k, v)| match v {
            AttributeValue::Text(t) => Some((k.to_string(), t.to_string())),
            _ => None,
        })
        .collect();
    let named = [("software", &own.software_name), ("comments", &own.comments), ("owner", &own.owner)];
    texts.extend(named.iter().filter_map(|(k, v)| Some(((*k).to_owned(), v.as_ref()?.to_string()))));
    texts.sort();
    ExrPart {
        name: own.layer_name.as_ref().map(ToString::to_string),
        channels: header
            .channels
            .list
            .iter()
            .map(|c| ExrChannel {
                name: c.name.to_string(),
                sample_type: match c.sample_type {
                    SampleType::F16 => "half",
                    SampleType::F32 => "float",
                    SampleType::U32 => "uint",
                },
            })
            .collect(),
        compression: header.compression.to_string(),
        tiles: match header.blocks {
            exr::meta::BlockDescription::Tiles(t) => Some([t.tile_size.x(), t.tile_size.y()]),
            exr::meta::BlockDescription::ScanLines => None,
        },
        data_window: window(data),
        display_window: window(display),
        texts,
    }
}
