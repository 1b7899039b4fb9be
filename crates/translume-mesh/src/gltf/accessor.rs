//! Accessors: rows of numbers in buffer views, with sparse values put in.

use super::document::Sparse;
use super::{Asset, Parsed};
use crate::error::{Fault, Result, invalid};
use std::collections::HashMap;

impl Asset {
    /// An accessor as rows of `N` floats. Integers are scaled when the accessor is normalised; a fourth component
    /// (alpha, or the sign of a tangent) is dropped for `N = 3`.
    ///
    /// # Errors
    /// A fault that names the accessor, as an error with this file's path.
    pub fn accessor<const N: usize>(&self, index: usize) -> Result<Vec<[f32; N]>> {
        self.floats(index).map_err(|fault| fault.at(&self.path))
    }

    /// The bytes of a buffer view, as images use them.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] when there is no such view or its buffer is shorter.
    pub fn bytes(&self, view: usize) -> Result<&[u8]> {
        let read = || -> Parsed<&[u8]> {
            let Some(v) = self.document.buffer_views.get(view) else {
                return invalid(format!("no buffer view {view}"));
            };
            let Some(buffer) = self.buffers.get(v.buffer.get()) else {
                return invalid(format!("buffer view {view} uses a buffer that is not there"));
            };
            let buffer = buffer.as_ref().map_err(|e| Fault::Invalid(format!("buffer {}: {e}", v.buffer.0)))?;
            let end = v.byte_offset.get().saturating_add(v.byte_length.get());
            match buffer.get(v.byte_offset.get()..end) {
                Some(bytes) => Ok(bytes),
                None => invalid(format!("buffer view {view} reaches beyond its buffer")),
            }
        };
        read().map_err(|fault| fault.at(&self.path))
    }

    pub(super) fn floats<const N: usize>(&self, index: usize) -> Parsed<Vec<[f32; N]>> {
        let rows = self.rows(index)?;
        if rows.components < N {
            return invalid(format!("accessor {index} has {} components instead of {N}", rows.components));
        }
        let normalized = self.document.accessors[index].normalized;
        let size = rows.kind.size();
        Ok((0..rows.count)
            .map(|i| {
                let row = rows.row(i);
                std::array::from_fn(|j| rows.kind.component(normalized, &row[j * size..]))
            })
            .collect())
    }

    pub(super) fn indices(&self, index: usize) -> Parsed<Vec<u32>> {
        let rows = self.rows(index)?;
        if rows.components != 1 {
            return invalid(format!("accessor {index} holds indices and is not SCALAR"));
        }
        let size = rows.kind.size();
        match rows.kind {
            Kind::U8 | Kind::U16 | Kind::U32 => {}
            _ => return invalid(format!("accessor {index} holds indices that are no unsigned integers")),
        }
        Ok((0..rows.count).map(|i| little_endian(&rows.row(i)[..size])).collect())
    }

    /// Checks an accessor against its buffers and gives its rows, sparse values put in.
    fn rows(&self, index: usize) -> Parsed<Rows<'_>> {
        let Some(accessor) = self.document.accessors.get(index) else { return invalid(format!("no accessor {index}")) };
        let kind = Kind::of(accessor.component_type.0)
            .ok_or_else(|| Fault::Invalid(format!("accessor {index} has an unknown component type")))?;
        let components = match accessor.shape.as_str() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            // Columns of four floats need no padding.
            "MAT4" if kind == Kind::F32 => 16,
            other => return invalid(format!("accessor {index} is of type {other:?}, not a scalar or vector")),
        };
        let (count, size) = (accessor.count.0, components * kind.size());
        let offset = accessor.byte_offset.0;
        let dense = accessor.buffer_view.map(|v| self.view(v.get(), offset, count, size, index)).transpose()?;
        let sparse = accessor.sparse.as_ref().map(|s| self.sparse_rows(s, count, size, index)).transpose()?;
        // Zeros without bytes behind them: bound what a header can ask for.
        if dense.is_none() && count > 1 << 24 {
            return invalid(format!("accessor {index} asks for {count} rows without data"));
        }
        let count = count as usize;
        Ok(Rows { dense, sparse, count, components, kind, zero: [0; 64], size })
    }

    fn sparse_rows(&self, sparse: &Sparse, count: u64, size: usize, index: usize) -> Parsed<HashMap<u32, &[u8]>> {
        let (at, from) = (&sparse.indices, &sparse.values);
        let width = match at.component_type.map(|t| Kind::of(t.0)) {
            Some(Some(kind @ (Kind::U8 | Kind::U16 | Kind::U32))) => kind.size(),
            _ => return invalid(format!("accessor {index} has sparse indices that are no unsigned integers")),
        };
        let n = sparse.count.0;
        let keys = self.view(at.buffer_view.get(), at.byte_offset.0, n, width, index)?;
        let values = self.view(from.buffer_view.get(), from.byte_offset.0, n, size, index)?;
        let mut rows = HashMap::new();
        for i in 0..n as usize {
            let key = little_endian(&keys.bytes[i * keys.stride..][..width]);
            if u64::from(key) >= count {
                return invalid(format!("accessor {index} has a sparse index {key} beyond its {count} rows"));
            }
            rows.insert(key, &values.bytes[i * values.stride..][..size]);
        }
        Ok(rows)
    }

    /// `count` rows of `size` bytes from `offset` in buffer view `view`, checked.
    fn view(&self, view: usize, offset: u64, count: u64, size: usize, accessor: usize) -> Parsed<View<'_>> {
        let beyond = || Fault::Invalid(format!("accessor {accessor} reaches beyond its buffer view"));
        let v = self.document.buffer_views.get(view).ok_or_else(beyond)?;
        if ["EXT_meshopt_compression", "KHR_meshopt_compression"].iter().any(|e| v.extensions.contains_key(*e)) {
            return Err(Fault::Unsupported("meshopt compression; decompress the file first".into()));
        }
        let begin = v.byte_offset.0;
        let end = begin.checked_add(v.byte_length.0).ok_or_else(beyond)?;
        let buffer = match self.buffers.get(v.buffer.get()) {
            Some(Ok(bytes)) => bytes,
            Some(Err(why)) => return invalid(format!("buffer {}: {why}", v.buffer.get())),
            None => {
                return invalid(format!("buffer view {view} asks for buffer {}, which is not there", v.buffer.get()));
            }
        };
        let range = usize::try_from(begin).ok().zip(usize::try_from(end).ok());
        let bytes = range
            .and_then(|(b, e)| buffer.get(b..e))
            .ok_or_else(|| Fault::Invalid(format!("buffer view {view} reaches beyond the end of its buffer")))?;
        let stride = v.byte_stride.map_or(size, |s| s.get());
        if stride < size {
            return invalid(format!("buffer view {view} has stride {stride}, its rows need {size} bytes"));
        }
        let needed = match count {
            0 => Some(0),
            n => (n - 1).checked_mul(stride as u64).and_then(|n| n.checked_add(size as u64)),
        };
        let needed = needed.and_then(|n| n.checked_add(offset)).ok_or_else(beyond)?;
        if needed > bytes.len() as u64 {
            return Err(beyond());
        }
        Ok(View { bytes: &bytes[offset as usize..], stride })
    }
}

struct View<'a> {
    bytes: &'a [u8],
    stride: usize,
}

struct Rows<'a> {
    dense: Option<View<'a>>,
    sparse: Option<HashMap<u32, &'a [u8]>>,
    count: usize,
    components: usize,
    kind: Kind,
    zero: [u8; 64],
    size: usize,
}

impl Rows<'_> {
    fn row(&self, i: usize) -> &[u8] {
        if let Some(row) = self.sparse.as_ref().and_then(|s| s.get(&(i as u32))) {
            return row;
        }
        match &self.dense {
            Some(view) => &view.bytes[i * view.stride..][..self.size],
            None => &self.zero[..self.size],
        }
    }
}

/// Component types, by their numbers in the format.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Kind {
    fn of(number: u64) -> Option<Self> {
        Some(match number {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// One component as a float (specification, "Animations", for the normalised mapping).
    fn component(self, normalized: bool, raw: &[u8]) -> f32 {
        let bits = little_endian(&raw[..self.size()]);
        let (value, scale) = match self {
            Self::F32 => return f32::from_bits(bits),
            Self::U8 => (bits as f32, 255.0),
            Self::U16 => (bits as f32, 65535.0),
            Self::U32 => (bits as f32, u32::MAX as f32),
            Self::I8 => (f32::from(bits as u8 as i8), 127.0),
            Self::I16 => (f32::from(bits as u16 as i16), 32767.0),
        };
        if normalized { (value / scale).max(-1.0) } else { value }
    }
}

pub(super) fn little_endian(raw: &[u8]) -> u32 {
    raw.iter().rev().fold(0, |n, &b| n << 8 | u32::from(b))
}
