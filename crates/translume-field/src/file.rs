//! The file of a field: a binary glTF 2.0 container (`.glb`) with KTX2 textures and an extension of our own,
//! `TRANSLUME_reflectance_field`. `docs/formats/field.md` is its specification.

use crate::Relighter;
use crate::basis::Basis;
use crate::field::{Angular, Field, Model};
use crate::ktx2;
use crate::preview;
use crate::sphere::Kernel;
use crate::texture::{Codec, Texture};
use crate::tiles::{self, Tiles};
use crate::{Domain, Error, Result};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::io::{self, Write};
use std::path::Path;
use translume_image::atomic;

/// Version of the extension; another major version is refused.
pub const VERSION: &str = "1.0";
const EXTENSION: &str = "TRANSLUME_reflectance_field";

/// The extension's object.
#[derive(Serialize, Deserialize)]
struct Manifest {
    version: String,
    model: Model,
    width: usize,
    height: usize,
    domain: Domain,
    white: f32,
    /// Buffer views of KTX2 textures.
    textures: Vec<usize>,
    layers: Vec<LayerEntry>,
    #[serde(skip_serializing_if = "Option::is_none")]
    tiles: Option<TilesEntry>,
    weights: Weights,
}

/// Layers by tile, a byte each.
#[derive(Serialize, Deserialize)]
struct TilesEntry {
    side: usize,
    #[serde(rename = "countsView")]
    counts_view: usize,
}

/// A layer: a texture of the file, a layer of its array, and the range of each channel.
#[derive(Serialize, Deserialize)]
struct LayerEntry {
    texture: usize,
    layer: usize,
    low: Vec<f32>,
    high: Vec<f32>,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "lowercase", tag = "kind")]
enum Weights {
    /// Unit directions (float32 x, y, z) and weights by light, then column, as integers of `bits` bits in a range for each
    /// column.
    Lights {
        /// Whether columns are colours of planes, and not weights of layers.
        colour: bool,
        kernel: Kernel,
        count: usize,
        #[serde(rename = "directionsView")]
        directions_view: usize,
        /// Unit directions to the camera, the same way, where pictures differ in that.
        #[serde(rename = "viewsView", default, skip_serializing_if = "Option::is_none")]
        views_view: Option<usize>,
        #[serde(rename = "weightsView")]
        weights_view: usize,
        bits: u32,
        low: Vec<f32>,
        high: Vec<f32>,
    },
    Basis {
        basis: Basis,
    },
}

/// Bits of a stored weight.
pub fn weight_bits(model: Model) -> u32 {
    if matches!(model, Model::LogPca | Model::LinearPca) { 8 } else { 16 }
}

/// A weight as the file stores it: what fields are made of before they are measured, so that figures hold for the file.
pub fn quantise_weights(field: &mut Field) {
    let bits = weight_bits(field.model);
    if let Angular::Lights { table, .. } = &mut field.angular {
        let (codes, low, high) = codes(table, bits);
        *table = values(&codes, table.nrows(), (&low, &high), bits);
    }
}

fn codes(table: &DMatrix<f32>, bits: u32) -> (Vec<u16>, Vec<f32>, Vec<f32>) {
    let most = ((1u32 << bits) - 1) as f32;
    let (low, high): (Vec<f32>, Vec<f32>) = table.column_iter().map(|c| (c.min(), c.max())).unzip();
    let code = |i: usize, j: usize| {
        let range = high[j] - low[j];
        if range > 0.0 { ((table[(i, j)] - low[j]) / range * most + 0.5) as u16 } else { 0 }
    };
    let codes = (0..table.nrows()).flat_map(|i| (0..table.ncols()).map(move |j| code(i, j))).collect();
    (codes, low, high)
}

fn values(codes: &[u16], rows: usize, (low, high): (&[f32], &[f32]), bits: u32) -> DMatrix<f32> {
    let most = ((1u32 << bits) - 1) as f32;
    DMatrix::from_fn(rows, low.len(), |i, j| low[j] + f32::from(codes[i * low.len() + j]) / most * (high[j] - low[j]))
}

/// The number of a layer, and its blocks.
type Numbered<'a> = (usize, &'a [u8]);

/// What a buffer view holds.
enum Part<'a> {
    Bytes(Vec<u8>),
    /// A texture array of whole layers.
    Layers(Codec, (usize, usize), Vec<Numbered<'a>>),
    /// One of the tiles of layers that are so many blocks wide.
    Tiles(Codec, &'a Tiles, usize, Vec<Numbered<'a>>),
}

impl Part<'_> {
    /// Its header, if it is a texture array, and the bytes of all.
    fn header(&self) -> (Vec<u8>, usize) {
        let (codec, size, count) = match self {
            Self::Bytes(bytes) => return (Vec::new(), bytes.len()),
            Self::Layers(codec, size, layers) => (*codec, *size, layers.len()),
            Self::Tiles(codec, tiles, _, layers) => {
                let (size, count) = tiles.atlas(layers.iter().map(|l| l.0));
                (*codec, size, count)
            }
        };
        let header = ktx2::header(codec, size, count);
        let length = header.len() + count * codec.bytes(size.0, size.1);
        (header, length)
    }

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        out.write_all(&self.header().0)?;
        match self {
            Self::Bytes(bytes) => out.write_all(bytes),
            Self::Layers(.., layers) => layers.iter().try_for_each(|l| out.write_all(l.1)),
            Self::Tiles(_, tiles, blocks, layers) => tiles.pack(layers, *blocks, &mut |part| out.write_all(part)),
        }
    }
}

/// The file: its JSON, and what its buffer holds. Textures are not copied.
struct Contents<'a> {
    text: Vec<u8>,
    /// Each, and where it begins.
    parts: Vec<(usize, Part<'a>)>,
    /// Bytes of the buffer.
    buffer: usize,
}

impl Contents<'_> {
    fn len(&self) -> usize {
        12 + 8 + self.text.len() + 8 + self.buffer
    }

    /// Header, JSON chunk, binary chunk.
    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        out.write_all(b"glTF")?;
        for v in [2, self.len() as u32, self.text.len() as u32] {
            out.write_all(&v.to_le_bytes())?;
        }
        out.write_all(b"JSON")?;
        out.write_all(&self.text)?;
        out.write_all(&(self.buffer as u32).to_le_bytes())?;
        out.write_all(b"BIN\0")?;
        let mut at = 0;
        for (start, part) in &self.parts {
            out.write_all(&[0; ALIGN][..start - at])?;
            part.write(out)?;
            at = start + part.header().1;
        }
        out.write_all(&[0; ALIGN][..self.buffer - at])
    }
}

/// Buffer views begin at multiples of this.
const ALIGN: usize = 16;

/// Writes a field; it appears whole or not at all. `command` says how it was made. The preview is left out where the file would
/// be larger than `most` bytes.
///
/// # Errors
/// [`Error::Picture`] or [`Error::Io`] when the file cannot be written.
pub fn write(path: &Path, field: &Field, command: &str, most: Option<usize>) -> Result<()> {
    let mut contents = contents(field, command, true);
    if most.is_some_and(|most| contents.len() > most) {
        contents = self::contents(field, command, false);
    }
    atomic::write(path, |out| contents.write(out).map_err(|e| Error::io(path, e)))
}

/// The bytes of the file, with or without a preview.
pub fn to_bytes(field: &Field, command: &str, preview: bool) -> Vec<u8> {
    let contents = contents(field, command, preview);
    let mut out = Vec::with_capacity(contents.len());
    // Memory takes everything.
    let _ = contents.write(&mut out);
    out
}

fn contents<'a>(field: &'a Field, command: &str, preview: bool) -> Contents<'a> {
    let (mut parts, mut views, mut buffer, mut textures) = (Vec::new(), Vec::new(), 0usize, Vec::new());
    let mut add_as = |part: Part<'a>, mut view: Value| {
        let (start, length) = (buffer.next_multiple_of(ALIGN), part.header().1);
        view["buffer"] = json!(0);
        view["byteOffset"] = json!(start);
        view["byteLength"] = json!(length);
        views.push(view);
        parts.push((start, part));
        buffer = start + length;
        views.len() - 1
    };
    let scene = if preview {
        preview::scene(field, &mut |bytes, view| add_as(Part::Bytes(bytes.to_vec()), view))
    } else {
        serde_json::Map::new()
    };
    let mut add_part = |part: Part<'a>| add_as(part, json!({}));
    let mut layers: Vec<LayerEntry> = Vec::new();
    // Layers of one codec are one array.
    let mut arrays: Vec<(Codec, Vec<Numbered<'_>>)> = Vec::new();
    for (number, l) in field.layers.iter().enumerate() {
        let texture = arrays.iter().position(|a| a.0 == l.codec).unwrap_or(arrays.len());
        if texture == arrays.len() {
            arrays.push((l.codec, Vec::new()));
        }
        let n = l.codec.channels();
        let layer = arrays[texture].1.len();
        layers.push(LayerEntry { texture, layer, low: l.low[..n].to_vec(), high: l.high[..n].to_vec() });
        arrays[texture].1.push((number, &l.data));
    }
    for (codec, data) in arrays {
        textures.push(add_part(match &field.tiles {
            None => Part::Layers(codec, (field.width, field.height), data),
            Some(tiles) => Part::Tiles(codec, tiles, field.width.div_ceil(4), data),
        }));
    }
    let mut add = |bytes: &[u8]| add_part(Part::Bytes(bytes.to_vec()));
    let tiles = field.tiles.as_ref().map(|t| TilesEntry { side: tiles::SIDE, counts_view: add(&t.counts) });
    let weights = match &field.angular {
        Angular::Basis(basis) => Weights::Basis { basis: *basis },
        Angular::Lights { colour, lights, views, table, kernel } => {
            let bits = weight_bits(field.model);
            let (codes, low, high) = codes(table, bits);
            let packed: Vec<u8> = match bits {
                8 => codes.iter().map(|c| *c as u8).collect(),
                _ => codes.iter().flat_map(|c| c.to_le_bytes()).collect(),
            };
            let mut directions =
                |d: &[[f32; 3]]| add(&d.iter().flatten().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>());
            let directions_view = directions(lights);
            let views_view = (!views.is_empty()).then(|| directions(views));
            let weights_view = add(&packed);
            Weights::Lights {
                colour: *colour,
                kernel: *kernel,
                count: lights.len(),
                directions_view,
                views_view,
                weights_view,
                bits,
                low,
                high,
            }
        }
    };
    let manifest = Manifest {
        version: VERSION.into(),
        model: field.model,
        width: field.width,
        height: field.height,
        domain: field.domain,
        white: field.white,
        textures,
        layers,
        tiles,
        weights,
    };
    let buffer = buffer.next_multiple_of(4);
    let mut document = json!({
        "asset": {
            "version": "2.0",
            "generator": format!("translume {}", env!("CARGO_PKG_VERSION")),
            "extras": { "command": command },
        },
        "extensionsUsed": if scene.is_empty() { json!([EXTENSION]) } else { json!([EXTENSION, "KHR_materials_unlit"]) },
        "buffers": [{ "byteLength": buffer }],
        "bufferViews": views,
        "extensions": { EXTENSION: manifest },
    });
    scene.into_iter().for_each(|(key, value)| document[key] = value);
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    Contents { text, parts, buffer }
}

/// Reads a field.
///
/// # Errors
/// [`Error::Io`]; [`Error::Invalid`] for what is no field, damaged or truncated; [`Error::Unsupported`] for one of another
/// major version.
pub fn read(path: &Path) -> Result<Field> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    from_bytes(&bytes, path)
}

/// [`read`] of bytes in memory; `path` stands in messages.
///
/// # Errors
/// As [`read`].
pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<Field> {
    let invalid = |what: String| Error::invalid(path, what);
    let (text, binary) = chunks(bytes).map_err(invalid)?;
    let document: Value = serde_json::from_slice(text).map_err(|e| invalid(format!("its JSON is damaged: {e}")))?;
    let extension = &document["extensions"][EXTENSION];
    let version = extension["version"].as_str().ok_or_else(|| invalid("a glTF file, but no field".into()))?;
    let major = |v: &str| v.split('.').next().map(str::to_owned);
    if major(version) != major(VERSION) {
        let what = format!("a field of format version {version}; this program reads {VERSION}");
        return Err(Error::Unsupported { path: path.to_owned(), what });
    }
    let manifest: Manifest =
        serde_json::from_value(extension.clone()).map_err(|e| invalid(format!("its description is damaged: {e}")))?;
    let field = assemble(manifest, &document, binary).map_err(invalid)?;
    // Everything that relighting needs fits together.
    Relighter::new(&field).map_err(|e| invalid(e.to_string()))?;
    Ok(field)
}

/// The JSON and the binary chunk.
fn chunks(bytes: &[u8]) -> std::result::Result<(&[u8], &[u8]), String> {
    let word = |at: usize| bytes.get(at..at + 4).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes);
    if !bytes.starts_with(b"glTF") {
        return Err("not a field (a .glb file that `translume field compress` wrote is wanted)".into());
    }
    let cut = || "the file ends early (truncated)".to_owned();
    let length = word(8).ok_or_else(cut)? as usize;
    if length > bytes.len() {
        return Err(cut());
    }
    let chunk = |at: usize, kind: &[u8]| {
        let n = word(at).ok_or_else(cut)? as usize;
        if bytes.get(at + 4..at + 8) != Some(kind) {
            return Err("its chunks are not JSON and BIN (damaged)".to_owned());
        }
        let end = (at + 8).checked_add(n).ok_or_else(cut)?;
        bytes.get(at + 8..end).map(|data| (data, end)).ok_or_else(cut)
    };
    let (text, end) = chunk(12, b"JSON")?;
    Ok((text, chunk(end, b"BIN\0")?.0))
}

fn assemble(manifest: Manifest, document: &Value, binary: &[u8]) -> std::result::Result<Field, String> {
    let view = |index: usize| {
        let view = &document["bufferViews"][index];
        let number = |key: &str| view[key].as_u64().and_then(|v| usize::try_from(v).ok());
        let range = number("byteOffset").zip(number("byteLength"));
        let range = range.and_then(|(start, n)| Some(start..start.checked_add(n)?));
        range.and_then(|r| binary.get(r)).ok_or_else(|| format!("buffer view {index} is not in the file (truncated?)"))
    };
    let (w, h) = (manifest.width, manifest.height);
    let tiles = match &manifest.tiles {
        None => None,
        Some(entry) => {
            let (counts, (across, down)) = (view(entry.counts_view)?, Tiles::grid(w, h));
            if entry.side != tiles::SIDE || across.checked_mul(down) != Some(counts.len()) {
                return Err("its tiles do not fit its size".into());
            }
            Some(Tiles { across, counts: counts.to_vec() })
        }
    };
    let mut layers: Vec<Option<Texture>> = vec![None; manifest.layers.len()];
    if manifest.textures.len() > layers.len() {
        return Err("it has more textures than layers".into());
    }
    for (texture, at) in manifest.textures.iter().enumerate() {
        // Layers of this texture, in its order.
        let mut own: Vec<usize> = (0..layers.len()).filter(|i| manifest.layers[*i].texture == texture).collect();
        if own.is_empty() {
            continue;
        }
        own.sort_by_key(|i| manifest.layers[*i].layer);
        let missing = |i: usize| format!("layer {i} is not in its texture");
        let (codec, size, parts) = ktx2::read(view(*at)?)?;
        let data: Vec<Vec<u8>> = match &tiles {
            None => {
                let one = |i: &usize| parts.get(manifest.layers[*i].layer).map(|d| d.to_vec());
                let found: Option<Vec<_>> = own.iter().map(one).collect();
                found.filter(|_| size == (w, h)).ok_or_else(|| missing(own[0]))?
            }
            Some(tiles) => {
                let blocks = (w.div_ceil(4), h.div_ceil(4));
                // Layers of tiles take more room here than in the file, but not any amount.
                let room = blocks.0.saturating_mul(blocks.1).saturating_mul(8 * layers.len());
                let sound = matches!(codec, Codec::Bc1 | Codec::Bc4) && tiles.most() == layers.len();
                if !sound || room > binary.len().saturating_mul(1024) {
                    return Err("its tiles do not fit its layers".into());
                }
                tiles.unpack(&own, blocks, size, &parts).ok_or_else(|| missing(own[0]))?
            }
        };
        for (i, data) in own.into_iter().zip(data) {
            let (entry, n) = (&manifest.layers[i], codec.channels());
            let range = |v: &[f32]| {
                (v.len() == n && v.iter().all(|x| x.is_finite())).then(|| std::array::from_fn(|c| v[c.min(n - 1)]))
            };
            let ranges = range(&entry.low).zip(range(&entry.high));
            let (low, high) = ranges.ok_or_else(|| format!("layer {i} has no range"))?;
            layers[i] = Some(Texture { codec, data, low, high });
        }
    }
    let found: Option<Vec<Texture>> = layers.into_iter().collect();
    let layers = found.ok_or("a layer has no texture")?;
    let angular = match manifest.weights {
        Weights::Basis { basis } => Angular::Basis(basis),
        Weights::Lights { colour, kernel, count, directions_view, views_view, weights_view, bits, low, high } => {
            let directions = |at: usize| {
                let found = floats(view(at)?).as_chunks::<3>().0.to_vec();
                let unit = |d: &[f32; 3]| (d.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() <= 1e-2;
                let sound = found.len() == count && found.iter().all(unit);
                if sound { Ok(found) } else { Err(format!("{count} unit directions are wanted")) }
            };
            let lights = directions(directions_view)?;
            let views = views_view.map(directions).transpose()?.unwrap_or_default();
            let packed = view(weights_view)?;
            let codes: Vec<u16> = match bits {
                8 => packed.iter().map(|b| u16::from(*b)).collect(),
                16 => packed.as_chunks::<2>().0.iter().map(|b| u16::from_le_bytes(*b)).collect(),
                _ => return Err(format!("weights of {bits} bits")),
            };
            let finite = low.iter().chain(&high).all(|v| v.is_finite());
            if low.len() != high.len() || !finite || count.checked_mul(low.len()) != Some(codes.len()) {
                return Err("the weights do not fit the lights (truncated?)".into());
            }
            check(kernel)?;
            Angular::Lights { colour, table: values(&codes, count, (&low, &high), bits), lights, views, kernel }
        }
    };
    if !(manifest.white > 0.0 && manifest.white < crate::domain::MOST_LIGHT) {
        return Err(format!(
            "its white is {}: a positive number below {:e} is wanted",
            manifest.white,
            crate::domain::MOST_LIGHT
        ));
    }
    let domain = manifest.domain.check().map_err(|e| e.to_string())?;
    Ok(Field { model: manifest.model, width: w, height: h, domain, white: manifest.white, layers, tiles, angular })
}

fn check(kernel: Kernel) -> std::result::Result<(), String> {
    let sound = match kernel {
        Kernel::Gaussian { width } => width > 0.0,
        Kernel::Surface { rough, width, noise } => (0.0..=1.0).contains(&rough) && width > 0.0 && noise >= 0.0,
    };
    if sound { Ok(()) } else { Err("its interpolation is damaged".into()) }
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fields() -> Vec<Field> {
        let plane: Vec<f32> = (0..35).map(|i| (i as f32 * 0.3).sin()).collect();
        let lights = vec![[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, 0.6, 0.8]];
        let field = |model, layers: Vec<Texture>, columns: usize, kernel| Field {
            model,
            width: 7,
            height: 5,
            domain: Domain::default(),
            white: 3.5,
            layers,
            tiles: None,
            angular: Angular::Lights {
                colour: model == Model::Layers,
                lights: lights.clone(),
                views: if model == Model::LogPca { lights.iter().rev().copied().collect() } else { Vec::new() },
                table: DMatrix::from_fn(3, columns, |i, j| (i * j) as f32 * 0.37 - 1.0),
                kernel,
            },
        };
        let one = Texture::encode(Codec::Bc4, &[&plane], 7).unwrap();
        let rgb = Texture::encode(Codec::Bc1, &[&plane, &plane, &plane], 7).unwrap();
        let surface = Kernel::Surface { rough: 0.3, width: 0.4, noise: 0.01 };
        let mut ptm = field(Model::Ptm, vec![rgb.clone(); 6], 6, surface);
        ptm.angular = Angular::Basis(Basis::Ptm);
        vec![
            field(Model::Layers, vec![one.clone(), rgb.clone(), one], 18, surface),
            field(Model::LogPca, vec![rgb.clone(), rgb], 2, Kernel::Gaussian { width: 0.5 }),
            ptm,
        ]
    }

    #[test]
    fn fields_come_back_as_they_were() {
        for mut field in fields() {
            quantise_weights(&mut field);
            let bytes = to_bytes(&field, "translume field compress x", true);
            let got = from_bytes(&bytes, Path::new("f")).unwrap();
            assert_eq!(got.layers, field.layers);
            let same =
                (got.domain, got.white, got.model, got.width) == (field.domain, field.white, field.model, field.width);
            assert!(same && got.lights() == field.lights() && got.views() == field.views());
            match (got.mix_of_light(2), field.mix_of_light(2)) {
                (Some(got), Some(put)) => {
                    let values =
                        |m: &Mix| m.constant.iter().chain(m.layers.iter().flatten()).copied().collect::<Vec<f32>>();
                    assert!(values(&got).iter().zip(values(&put)).all(|(a, b)| (a - b).abs() < 1e-6));
                }
                (got, put) => assert!(got.is_none() && put.is_none()),
            }
        }
    }

    use crate::field::Mix;

    #[test]
    fn sixteen_bits_change_a_weight_by_no_more_than_half_a_step() {
        let mut field = fields().swap_remove(0);
        let before = field.mix_of_light(2).unwrap();
        quantise_weights(&mut field);
        let after = field.mix_of_light(2).unwrap();
        // Columns j hold −1 … 0.74 j − 1.
        for (j, (a, b)) in after.layers.iter().flatten().zip(before.layers.iter().flatten()).enumerate() {
            assert!((a - b).abs() <= 0.51 * 0.74 * (j + 3) as f32 / 65535.0 + 1e-6, "{j}: {a} {b}");
        }
    }

    #[test]
    fn truncated_and_damaged_files_are_errors_and_never_panics() {
        for field in fields() {
            let bytes = to_bytes(&field, "", true);
            for cut in (0..bytes.len()).step_by(3) {
                assert!(from_bytes(&bytes[..cut], Path::new("f")).is_err(), "{cut}");
            }
            for at in (0..bytes.len()).step_by(2) {
                for value in [0, b'9', b'-', 0xff] {
                    let mut damaged = bytes.clone();
                    damaged[at] = value;
                    let _ = from_bytes(&damaged, Path::new("f"));
                }
            }
        }
    }

    #[test]
    fn another_major_version_is_refused() {
        let bytes = to_bytes(&fields()[0], "", false);
        let text = String::from_utf8_lossy(&bytes[20..]).into_owned();
        let at = 20 + text.find("\"version\":\"1.0\"").unwrap() + 11;
        let mut newer = bytes;
        newer[at] = b'2';
        let error = from_bytes(&newer, Path::new("f.glb")).unwrap_err().to_string();
        assert!(error.starts_with("f.glb: a field of format version 2.0"), "{error}");
    }

    /// Whatever numbers a damaged file has, light is a number: files are made of what relights to pixels that others can add up.
    #[test]
    fn damaged_numbers_relight_to_finite_pixels() {
        for field in fields() {
            for domain in [Domain::default(), Domain::THESIS, Domain::Linear, Domain::Display, Domain::Pu21] {
                for (range, weight) in [(1e3, 1e3), (1e20, 1.0), (3e38, 1.0), (3e38, -3e38)] {
                    let mut field = Field { domain, white: 9e17, ..field.clone() };
                    field.layers.iter_mut().for_each(|l| (l.low, l.high) = ([-0.1 * range; 3], [range; 3]));
                    if let Angular::Lights { table, .. } = &mut field.angular {
                        table.iter_mut().for_each(|w| *w *= weight);
                    }
                    let read = from_bytes(&to_bytes(&field, "", false), Path::new("f"));
                    // Refused is as good.
                    let Ok(read) = read else { continue };
                    let relighter = Relighter::new(&read).unwrap();
                    let mixes = read.mix_of_light(1).into_iter().chain([relighter.mix([0.0, 0.6, 0.8])]);
                    for mix in mixes {
                        let light = relighter.picture(&mix);
                        let sound = |v: &f32| v.is_finite() && *v >= 0.0;
                        assert!(light.iter().all(sound), "{domain:?} {range} {weight}: {:?}", &light[..6]);
                    }
                }
            }
        }
    }

    #[test]
    fn a_white_beyond_all_light_is_refused() {
        for white in [0.0, -1.0, 1e18, 3e38] {
            let field = Field { white, ..fields().swap_remove(0) };
            let error = from_bytes(&to_bytes(&field, "", false), Path::new("f.glb")).unwrap_err().to_string();
            assert!(error.starts_with("f.glb: its white is"), "{white}: {error}");
        }
        let field = Field { white: 9e17, ..fields().swap_remove(0) };
        assert!(from_bytes(&to_bytes(&field, "", false), Path::new("f.glb")).is_ok());
    }
}
