//! OpenEXR written with provenance.

use crate::{Error, Picture, Result, atomic};
use exr::meta::attribute::Chromaticities;
use exr::prelude::{
    AnyChannel, AnyChannels, AttributeValue, Blocks, Compression, Encoding, FlatSamples, Image, ImageAttributes,
    IntegerBounds, Layer, LayerAttributes, LineOrder, SmallVec, SpecificChannels, Text, Vec2, WritableImage, f16,
};
use std::path::Path;

/// How samples are stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// 16 bits; values beyond ±65504 are stored as ±65504.
    #[default]
    Half,
    /// 32 bits.
    Float,
}

/// Lossless compression of the pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ExrCompression {
    /// None.
    None,
    /// Run lengths.
    Rle,
    /// DEFLATE over blocks of 16 rows.
    #[default]
    Zip,
    /// Wavelets and Huffman codes over blocks of 32 rows.
    Piz,
}

/// What is written beside the pixels.
#[derive(Clone, Debug, Default)]
pub struct ExrOptions {
    /// Sample type.
    pub precision: Precision,
    /// Pixel compression.
    pub compression: ExrCompression,
    /// Program and version (`software`).
    pub software: Option<String>,
    /// The command line that made the picture (`command`).
    pub command: Option<String>,
    /// Seed of random numbers, if any were used (`seed`).
    pub seed: Option<u64>,
    /// Fingerprint of what was rendered (`scene`): pictures are averaged only where it agrees.
    pub scene: Option<String>,
    /// Anything else worth telling (`comments`).
    pub comments: Option<String>,
}

/// Saves one layer of `$channels`. A macro because exr's trait for channels, made generic here, would want `'static`.
macro_rules! save {
    ($path:expr, $size:expr, $picture:expr, $options:expr, $channels:expr) => {{
        let (attributes, layer_attributes, encoding) = attributes($size, $picture, $options);
        let layer = Layer::new($size, layer_attributes, encoding, $channels);
        let image = Image::empty(attributes).with_layer(layer);
        atomic::write($path, |file| image.write().to_buffered(file).map_err(|e| failed($path, e)))
    }};
}

/// Writes linear RGB (and alpha, if there is one), with the facts of the shot in the standard attributes.
///
/// # Errors
/// [`Error::Io`]; [`Error::Mismatch`] for a picture without pixels or an alpha of another size.
pub fn write_exr(path: &Path, picture: &Picture, options: &ExrOptions) -> Result<()> {
    let size = (picture.pixels.width() as usize, picture.pixels.height() as usize);
    let rgb = picture.pixels.as_raw().as_slice();
    let alpha = picture.alpha.as_deref();
    if size.0 == 0 || size.1 == 0 || alpha.is_some_and(|a| a.len() != size.0 * size.1) {
        return Err(Error::Mismatch(format!("{}: a picture without pixels, or alpha of another size", path.display())));
    }
    if options.precision == Precision::Half {
        warn_beyond_half(path, "", rgb.iter().chain(alpha.unwrap_or_default()));
    }
    let at = |p: Vec2<usize>| (p.y() * size.0 + p.x(), &rgb[(p.y() * size.0 + p.x()) * 3..]);
    match (options.precision, alpha) {
        (Precision::Half, None) => save!(path, size, picture, options, {
            SpecificChannels::rgb(|p| {
                let v = at(p).1;
                (to_half(v[0]), to_half(v[1]), to_half(v[2]))
            })
        }),
        (Precision::Float, None) => save!(path, size, picture, options, {
            SpecificChannels::rgb(|p| {
                let v = at(p).1;
                (v[0], v[1], v[2])
            })
        }),
        (Precision::Half, Some(a)) => save!(path, size, picture, options, {
            SpecificChannels::rgba(|p| {
                let (i, v) = at(p);
                (to_half(v[0]), to_half(v[1]), to_half(v[2]), to_half(a[i]))
            })
        }),
        (Precision::Float, Some(a)) => save!(path, size, picture, options, {
            SpecificChannels::rgba(|p| {
                let (i, v) = at(p);
                (v[0], v[1], v[2], a[i])
            })
        }),
    }
}

/// Writes named planes of `width * height` values each, row by row from the top. A layer is the part of a name before
/// the last dot (`albedo.R`); a displacement field has `X` and `Y`.
///
/// # Errors
/// [`Error::Io`]; [`Error::Mismatch`] when a plane has another number of values or a name comes twice.
pub fn write_exr_channels(
    path: &Path,
    size: (usize, usize),
    channels: &[(&str, &[f32])],
    options: &ExrOptions,
) -> Result<()> {
    let mut names: Vec<&str> = channels.iter().map(|c| c.0).collect();
    names.sort_unstable();
    names.dedup();
    if size.0 == 0 || size.1 == 0 || channels.is_empty() || names.len() != channels.len() {
        return Err(Error::Mismatch(format!("{}: no pixels, or channel names that are not unique", path.display())));
    }
    if let Some((name, plane)) = channels.iter().find(|c| c.1.len() != size.0 * size.1) {
        return Err(Error::Mismatch(format!(
            "{}: channel {name} has {} values, not {} × {}",
            path.display(),
            plane.len(),
            size.0,
            size.1
        )));
    }
    let list: SmallVec<[AnyChannel<FlatSamples>; 4]> = channels
        .iter()
        .map(|&(name, plane)| {
            let samples = match options.precision {
                Precision::Half => {
                    warn_beyond_half(path, name, plane.iter());
                    FlatSamples::F16(plane.iter().map(|&v| to_half(v)).collect())
                }
                Precision::Float => FlatSamples::F32(plane.to_vec()),
            };
            AnyChannel::new(name, samples)
        })
        .collect();
    save!(path, size, &Picture::new(image::Rgb32FImage::new(0, 0)), options, AnyChannels::sort(list))
}

/// Says how many values (of a channel with a name) half floats cannot hold.
fn warn_beyond_half<'a>(path: &Path, channel: &str, values: impl Iterator<Item = &'a f32>) {
    let (mut count, mut largest) = (0, 0.0f32);
    for v in values.filter(|v| v.abs() > 65504.0) {
        count += 1;
        largest = largest.max(v.abs());
    }
    if count > 0 {
        let of = if channel.is_empty() { String::new() } else { format!(" of channel {channel}") };
        log::warn!(
            "{}: {count} values{of} (up to {largest:.4e}) are beyond 65504, the largest half float, and stored as that; \
             32-bit floats hold them",
            path.display()
        );
    }
}

fn to_half(v: f32) -> f16 {
    // NaN stays NaN: clamp passes it through.
    f16::from_f32(v.clamp(-65504.0, 65504.0))
}

fn failed(path: &Path, e: exr::error::Error) -> Error {
    match e {
        exr::error::Error::Io(e) => Error::io(path, e),
        other => Error::unsupported(path, format!("OpenEXR cannot hold this picture ({other})")),
    }
}

fn attributes(
    size: (usize, usize),
    picture: &Picture,
    options: &ExrOptions,
) -> (ImageAttributes, LayerAttributes, Encoding) {
    let compression = match options.compression {
        ExrCompression::None => Compression::Uncompressed,
        ExrCompression::Rle => Compression::RLE,
        ExrCompression::Zip => Compression::ZIP16,
        ExrCompression::Piz => Compression::PIZ,
    };
    let encoding = Encoding { compression, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let mut attributes = ImageAttributes::new(IntegerBounds::from_dimensions(size));
    attributes.chromaticities = picture.metadata.chromaticities.map(|c| {
        let [red, green, blue, white] = c.map(|[x, y]| Vec2(x, y));
        Chromaticities { red, green, blue, white }
    });
    (attributes, layer_attributes(picture, options), encoding)
}

fn layer_attributes(picture: &Picture, options: &ExrOptions) -> LayerAttributes {
    let metadata = &picture.metadata;
    let number = |v: Option<f64>| v.map(|v| v as f32);
    // OpenEXR text is bytes; what is not Latin-1 is written as '?' rather than lost with the whole attribute.
    let text =
        |s: &str| Text::new_or_none(s).unwrap_or_else(|| s.chars().map(latin1).collect::<String>().as_str().into());
    let maybe = |s: &Option<String>| s.as_deref().map(text);
    let mut other = std::collections::HashMap::new();
    let mut put = |name: &str, value: Option<String>| {
        if let Some(v) = value {
            other.insert(Text::from(name), AttributeValue::Text(text(&v)));
        }
    };
    put("command", options.command.clone());
    put("seed", options.seed.map(|s| s.to_string()));
    put("scene", options.scene.clone());
    put("cameraModel", metadata.camera.clone());
    LayerAttributes {
        exposure: number(metadata.exposure_secs),
        aperture: number(metadata.f_number),
        iso_speed: number(metadata.iso),
        owner: maybe(&metadata.owner),
        capture_date: maybe(&metadata.date_time),
        comments: maybe(&options.comments),
        software_name: maybe(&options.software),
        other,
        ..LayerAttributes::default()
    }
}

fn latin1(c: char) -> char {
    if (c as u32) < 256 { c } else { '?' }
}
