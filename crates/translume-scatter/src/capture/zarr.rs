//! The frames of a capture: a Zarr v3 array of five dimensions, a frame a chunk.
//!
//! Source: the Zarr v3 core specification. Written and read is the part of it that a capture needs: `float32` (also `float16`
//! when read), regular chunks of one frame, the `default` chunk keys, the codecs `bytes` (little-endian) and `gzip`. Everything
//! else is refused by name. Each chunk is one file, so frames are read and written in any order, by any number of machines, and
//! a frame whose file is missing was not captured.

use flate2::{Compression, read::GzDecoder, write::GzEncoder};
use half::{f16, slice::HalfFloatSliceExt};
use serde_json::{Value, json};
use std::io::{ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use translume_image::{Error, Result, atomic};

/// Names of the dimensions, outermost first.
pub const DIMENSIONS: [&str; 5] = ["view", "position", "channel", "row", "column"];

/// Most values of a frame: 2^28, which is 1 GB.
const MAX_FRAME: u64 = 1 << 28;

/// An array of frames on disk.
#[derive(Clone, Debug)]
pub struct Frames {
    path: PathBuf,
    /// Views, laser positions, channels, rows, columns.
    pub shape: [usize; 5],
    half: bool,
    gzip: bool,
    /// Where on disk each channel is, if not in order.
    channels: Option<[usize; 3]>,
}

impl Frames {
    /// Makes the folder `path` and describes an array of `shape` in it, without any frame.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn create(path: &Path, shape: [usize; 5]) -> Result<Self> {
        std::fs::create_dir_all(path).map_err(|e| Error::io(path, e))?;
        let meta = json!({
            "zarr_format": 3, "node_type": "array", "shape": shape, "data_type": "float32",
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [1, 1, 1, shape[3], shape[4]]}},
            "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
            "fill_value": "NaN",
            "codecs": [
                {"name": "bytes", "configuration": {"endian": "little"}},
                {"name": "gzip", "configuration": {"level": 6}},
            ],
            "dimension_names": DIMENSIONS, "attributes": {},
        });
        let file = path.join("zarr.json");
        atomic::write_bytes(&file, format!("{meta:#}\n").as_bytes())?;
        Ok(Self { path: path.to_owned(), shape, half: false, gzip: true, channels: None })
    }

    /// Reads the description of the array in the folder `path`.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Invalid`] for a damaged description; [`Error::Unsupported`] for what is not read.
    pub fn open(path: &Path) -> Result<Self> {
        let file = path.join("zarr.json");
        let text = std::fs::read(&file).map_err(|e| Error::io(&file, e))?;
        let meta: Value = serde_json::from_slice(&text).map_err(|e| Error::invalid(&file, e.to_string()))?;
        let refuse = |what: String| Error::unsupported(&file, what);
        if meta["zarr_format"] != 3 || meta["node_type"] != "array" {
            return Err(refuse("not an array of Zarr version 3".into()));
        }
        let sides = |v: &Value| -> Option<[usize; 5]> {
            let sides: Vec<usize> = v.as_array()?.iter().map(|n| n.as_u64()?.try_into().ok()).collect::<Option<_>>()?;
            sides.try_into().ok()
        };
        let shape = sides(&meta["shape"])
            .ok_or_else(|| refuse("its shape is not (view, position, channel, row, column)".into()))?;
        let pixels = (shape[3] as u64).checked_mul(shape[4] as u64).filter(|&n| (1..=MAX_FRAME).contains(&n));
        if pixels.is_none() || shape[..3].contains(&0) {
            return Err(Error::invalid(&file, format!("its shape {shape:?} is empty or has frames of over 1 GB")));
        }
        let chunks = &meta["chunk_grid"];
        if chunks["name"] != "regular"
            || sides(&chunks["configuration"]["chunk_shape"]) != Some([1, 1, 1, shape[3], shape[4]])
        {
            return Err(refuse("its chunks are not one frame each".into()));
        }
        let keys = &meta["chunk_key_encoding"];
        if keys["name"] != "default" || !["/", ""].contains(&keys["configuration"]["separator"].as_str().unwrap_or(""))
        {
            return Err(refuse("its chunk keys are not the default ones, separated by /".into()));
        }
        let half = match meta["data_type"].as_str() {
            Some("float32") => false,
            Some("float16") => true,
            other => return Err(refuse(format!("data type {other:?}; float32 and float16 are read"))),
        };
        let codecs = meta["codecs"].as_array().map(Vec::as_slice).unwrap_or_default();
        let little = |c: &Value| c["name"] == "bytes" && c["configuration"]["endian"] == "little";
        let gzip = match codecs {
            [bytes] if little(bytes) => false,
            [bytes, gzip] if little(bytes) && gzip["name"] == "gzip" => true,
            _ => {
                let name = |c: &Value| c["name"].as_str().unwrap_or("without a name").to_owned();
                let names = codecs.iter().map(name).collect::<Vec<_>>().join(", ");
                let wanted =
                    "little-endian bytes, alone or with gzip, are read (zarr-python: compressors=[GzipCodec()])";
                return Err(refuse(format!("codecs {names}; {wanted}")));
            }
        };
        Ok(Self { path: path.to_owned(), shape, half, gzip, channels: None })
    }

    /// From now on channel i is what channel `order[i]` was.
    pub(super) fn reorder_channels(&mut self, order: [usize; 3]) {
        self.channels = Some(order.map(|c| self.channels.map_or(c, |before| before[c])));
    }

    fn chunk(&self, view: usize, position: usize, channel: usize) -> PathBuf {
        let channel = self.channels.map_or(channel, |order| order[channel]);
        let mut path = self.path.join("c");
        [view, position, channel, 0, 0].iter().for_each(|i| path.push(i.to_string()));
        path
    }

    /// Values of a frame.
    pub fn pixels(&self) -> usize {
        self.shape[3] * self.shape[4]
    }

    /// Whether a frame was captured.
    pub fn exists(&self, view: usize, position: usize, channel: usize) -> bool {
        self.chunk(view, position, channel).exists()
    }

    /// A frame, row by row; `None` where it was not captured.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Invalid`] for a damaged or truncated chunk.
    pub fn read(&self, view: usize, position: usize, channel: usize) -> Result<Option<Vec<f32>>> {
        let path = self.chunk(view, position, channel);
        let stored = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(Error::io(&path, e)),
        };
        let width = if self.half { 2 } else { 4 };
        let length = self.pixels() * width;
        let bytes = match self.gzip {
            false => stored,
            true => {
                let mut bytes = Vec::new();
                // One byte more than there may be tells a chunk that is too long without unpacking it all.
                let read = GzDecoder::new(&stored[..]).take(length as u64 + 1).read_to_end(&mut bytes);
                read.map_err(|e| Error::invalid(&path, format!("damaged or truncated chunk: {e}")))?;
                bytes
            }
        };
        if bytes.len() != length {
            let what = if bytes.len() < length { "truncated" } else { "too long" };
            return Err(Error::invalid(&path, format!("{what}: a frame has {length} bytes; remove or replace it")));
        }
        Ok(Some(match self.half {
            true => {
                let halves: Vec<f16> = bytes.as_chunks::<2>().0.iter().map(|b| f16::from_le_bytes(*b)).collect();
                let mut values = vec![0.0; halves.len()];
                halves.convert_to_f32_slice(&mut values);
                values
            }
            false => bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect(),
        }))
    }

    /// Writes a frame, row by row, into an array that [`Frames::create`] made.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write(&self, [view, position, channel]: [usize; 3], frame: &[f32]) -> Result<()> {
        debug_assert!(frame.len() == self.pixels() && self.gzip && !self.half);
        let path = self.chunk(view, position, channel);
        let folder = path.parent().expect("it has one");
        std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
        let bytes: Vec<u8> = frame.iter().flat_map(|v| v.to_le_bytes()).collect();
        let mut encoder = GzEncoder::new(Vec::new(), Compression::new(6));
        let packed = encoder.write_all(&bytes).and_then(|()| encoder.finish()).map_err(|e| Error::io(&path, e))?;
        atomic::write_bytes(&path, &packed)
    }
}
