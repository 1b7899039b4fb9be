//! Zarr v3 arrays of a model: any number of dimensions, regular chunks, `bytes` (little-endian) and `gzip`. Each chunk is one file; chunks at the
//! end are padded. Frames of captures have a reader of their own, in [`crate::capture`].

use flate2::{Compression, read::GzDecoder, write::GzEncoder};
use half::f16;
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use translume_image::{Error, Result};

/// A number as it is stored.
pub(super) trait Number: Copy + Default + Send + Sync {
    const NAME: &'static str;
    const BYTES: usize;

    fn put(self, to: &mut Vec<u8>);
    fn take(from: &[u8]) -> Self;
}

macro_rules! number {
    ($type:ty, $name:literal) => {
        impl Number for $type {
            const NAME: &'static str = $name;
            const BYTES: usize = size_of::<$type>();

            fn put(self, to: &mut Vec<u8>) {
                to.extend_from_slice(&self.to_le_bytes());
            }

            fn take(from: &[u8]) -> Self {
                Self::from_le_bytes(from.try_into().expect("as many bytes as the type has"))
            }
        }
    };
}
number!(u8, "uint8");
number!(f16, "float16");
number!(f32, "float32");

/// An array in a folder.
pub(super) struct Array {
    path: PathBuf,
    shape: Vec<usize>,
    pub(super) chunk: Vec<usize>,
}

impl Array {
    /// Makes the folder and describes the array.
    pub(super) fn create<T: Number>(path: &Path, shape: &[usize], chunk: &[usize], names: &[&str]) -> Result<Self> {
        std::fs::create_dir_all(path).map_err(|e| Error::io(path, e))?;
        let fill = if T::NAME == "uint8" { json!(0) } else { json!("NaN") };
        let meta = json!({
            "zarr_format": 3, "node_type": "array", "shape": shape, "data_type": T::NAME,
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": chunk}},
            "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
            "fill_value": fill, "codecs": Self::codecs(), "dimension_names": names, "attributes": {},
        });
        let file = path.join("zarr.json");
        std::fs::write(&file, format!("{meta:#}\n")).map_err(|e| Error::io(&file, e))?;
        Ok(Self { path: path.to_owned(), shape: shape.to_vec(), chunk: chunk.to_vec() })
    }

    fn codecs() -> Value {
        json!([
            {"name": "bytes", "configuration": {"endian": "little"}},
            {"name": "gzip", "configuration": {"level": 4}},
        ])
    }

    /// Opens an array that [`Array::create`] made, of the same shape and chunks.
    pub(super) fn open<T: Number>(path: &Path, shape: &[usize], chunk: &[usize]) -> Result<Self> {
        let file = path.join("zarr.json");
        let text = std::fs::read(&file).map_err(|e| Error::io(&file, e))?;
        let meta: Value = serde_json::from_slice(&text).map_err(|e| Error::invalid(&file, e.to_string()))?;
        let same = meta["zarr_format"] == 3
            && meta["shape"] == json!(shape)
            && meta["data_type"] == T::NAME
            && meta["chunk_grid"]["configuration"]["chunk_shape"] == json!(chunk)
            && meta["codecs"]
                .as_array()
                .is_some_and(|c| c.len() == 2 && c[0] == Self::codecs()[0] && c[1]["name"] == "gzip");
        match same {
            true => Ok(Self { path: path.to_owned(), shape: shape.to_vec(), chunk: chunk.to_vec() }),
            false => {
                let what =
                    format!("not the array of {} of shape {shape:?} that goes with model.json and mesh.ply", T::NAME);
                Err(Error::invalid(&file, what))
            }
        }
    }

    fn file(&self, at: &[usize]) -> PathBuf {
        let mut path = self.path.join("c");
        at.iter().for_each(|i| path.push(i.to_string()));
        path
    }

    /// Writes a chunk from what `value` says at each index of the array; beyond its end are zeros.
    pub(super) fn write<T: Number>(&self, at: &[usize], value: impl Fn(&[usize]) -> T) -> Result<()> {
        let mut bytes = Vec::with_capacity(self.chunk.iter().product::<usize>() * T::BYTES);
        self.each(at, |index, inside| if inside { value(index) } else { T::default() }.put(&mut bytes));
        let mut encoder = GzEncoder::new(Vec::new(), Compression::new(4));
        let file = self.file(at);
        let folder = file.parent().expect("it has one");
        std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
        let packed = encoder.write_all(&bytes).and_then(|()| encoder.finish()).map_err(|e| Error::io(&file, e))?;
        std::fs::write(&file, packed).map_err(|e| Error::io(&file, e))
    }

    /// Reads a chunk and tells `take` the value at each index of the array.
    pub(super) fn read<T: Number>(&self, at: &[usize], mut take: impl FnMut(&[usize], T)) -> Result<()> {
        let file = self.file(at);
        let packed = std::fs::read(&file).map_err(|e| Error::io(&file, e))?;
        let length = self.chunk.iter().product::<usize>() * T::BYTES;
        let mut bytes = Vec::new();
        // One byte more than there may be tells a chunk that is too long without unpacking it all.
        let read = GzDecoder::new(&packed[..]).take(length as u64 + 1).read_to_end(&mut bytes);
        read.map_err(|e| Error::invalid(&file, format!("damaged or truncated chunk: {e}")))?;
        if bytes.len() != length {
            return Err(Error::invalid(
                &file,
                format!("a chunk has {length} bytes, this one does not; fit the model again"),
            ));
        }
        let mut numbers = bytes.chunks_exact(T::BYTES).map(T::take);
        self.each(at, |index, inside| {
            let number = numbers.next().expect("counted");
            if inside {
                take(index, number);
            }
        });
        Ok(())
    }

    /// All indices of a chunk in the order of its file, and whether they lie in the array.
    fn each(&self, at: &[usize], mut visit: impl FnMut(&[usize], bool)) {
        let dimensions = self.shape.len();
        let first: Vec<usize> = at.iter().zip(&self.chunk).map(|(i, c)| i * c).collect();
        let mut index = first.clone();
        for _ in 0..self.chunk.iter().product::<usize>() {
            visit(&index, index.iter().zip(&self.shape).all(|(i, n)| i < n));
            for d in (0..dimensions).rev() {
                index[d] += 1;
                if index[d] < first[d] + self.chunk[d] {
                    break;
                }
                index[d] = first[d];
            }
        }
    }

    /// The chunks along the first dimension, for arrays that are whole in the others.
    fn slabs(&self) -> Vec<Vec<usize>> {
        let one = |i: usize| std::iter::once(i).chain(std::iter::repeat_n(0, self.shape.len() - 1)).collect();
        (0..self.shape[0].div_ceil(self.chunk[0])).map(one).collect()
    }

    /// Writes the whole array, row by row.
    pub(super) fn write_all<T: Number>(&self, values: impl Fn(usize) -> T) -> Result<()> {
        let stride = self.stride();
        self.slabs().iter().try_for_each(|at| self.write(at, |index| values(dot(index, &stride))))
    }

    /// Reads the whole array, row by row.
    pub(super) fn read_all<T: Number>(&self, mut take: impl FnMut(usize, T)) -> Result<()> {
        let stride = self.stride();
        self.slabs().iter().try_for_each(|at| self.read(at, |index, value| take(dot(index, &stride), value)))
    }

    fn stride(&self) -> Vec<usize> {
        (0..self.shape.len()).map(|d| self.shape[d + 1..].iter().product()).collect()
    }
}

fn dot(index: &[usize], stride: &[usize]) -> usize {
    index.iter().zip(stride).map(|(i, s)| i * s).sum()
}
