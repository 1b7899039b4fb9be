//! Mitsuba's `.serialized` mesh collections, versions 3 and 4 (layout: Mitsuba 0.6 documentation, "serialized").
//!
//! Each shape is a 4-byte head and a zlib stream of its own; a table of offsets stands at the end of the file. All
//! numbers are little-endian.

use crate::error::{Fault, Result, invalid};
use crate::loaded::{Loaded, Part};
use crate::mesh::TriMesh;
use crate::origin;
use flate2::read::ZlibDecoder;
use glam::DVec3;
use std::io::Read;
use std::path::Path;

type Parsed<T> = std::result::Result<T, Fault>;

const MAGIC: u16 = 0x041c;
const NORMALS: u32 = 0x0001;
const TEXCOORDS: u32 = 0x0002;
const COLORS: u32 = 0x0008;
const FACE_NORMALS: u32 = 0x0010;
const DOUBLE: u32 = 0x2000;

/// Reads the shape number `which` of the file `bytes`, or all of them; `path` is for messages and names.
///
/// # Errors
/// [`crate::Error::Invalid`] naming the shape that is damaged, or when there is no shape `which`;
/// [`crate::Error::Unsupported`] for other versions.
pub fn read(path: &Path, bytes: &[u8], which: Option<usize>) -> Result<Loaded> {
    let parse = || -> Parsed<Vec<(Part, Vec<[f64; 3]>)>> {
        let offsets = offsets(bytes)?;
        let shapes = match which {
            Some(i) if i >= offsets.len() => return invalid(format!("no shape {i}: the file has {}", offsets.len())),
            Some(i) => i..i + 1,
            None => 0..offsets.len(),
        };
        // Shapes must not share bytes: otherwise a small file could expand without bound.
        if !offsets.is_sorted_by(|a, b| a < b) {
            return invalid("the offsets at the end of the file do not increase");
        }
        let end = |i: usize| offsets.get(i + 1).copied().unwrap_or(bytes.len()).min(bytes.len());
        shapes.map(|i| shape(path, &bytes[..end(i)], offsets[i], i)).collect()
    };
    let mut shapes = parse().map_err(|fault| fault.at(path))?;
    let all = shapes.iter().flat_map(|s| &s.1).map(|p| DVec3::from(*p));
    let origin = origin::of(all).unwrap_or(DVec3::ZERO);
    if origin != DVec3::ZERO {
        for (part, exact) in &mut shapes {
            part.mesh.positions = exact.iter().map(|p| (DVec3::from(*p) - origin).as_vec3().into()).collect();
        }
    }
    Ok(Loaded { parts: shapes.into_iter().map(|s| s.0).collect(), origin, ..Loaded::default() })
}

/// The offset table, its length known from the last four bytes.
fn offsets(bytes: &[u8]) -> Parsed<Vec<usize>> {
    let version = head(bytes, 0)?;
    let width = if version == 4 { 8 } else { 4 };
    let Some((rest, count)) = bytes.split_last_chunk::<4>() else { return invalid("the file is truncated") };
    let count = u32::from_le_bytes(*count) as usize;
    let Some(begin) = count.checked_mul(width).and_then(|n| rest.len().checked_sub(n)) else {
        return invalid(format!("the table at the end promises {count} shapes, the file is too short for that"));
    };
    let offset = |raw: &[u8]| raw.iter().rev().fold(0_u64, |n, &b| n << 8 | u64::from(b));
    Ok(rest[begin..].chunks_exact(width).map(|raw| usize::try_from(offset(raw)).unwrap_or(usize::MAX)).collect())
}

/// Checks the head at `offset` and gives the version.
fn head(bytes: &[u8], offset: usize) -> Parsed<u16> {
    let Some(&[a, b, c, d]) = bytes.get(offset..).and_then(|rest| rest.first_chunk()) else {
        return invalid(format!("a shape should begin at byte {offset}, beyond the end of the file"));
    };
    match (u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d])) {
        (MAGIC, version @ 3..=4) => Ok(version),
        (MAGIC, version) => Err(Fault::Unsupported(format!("version {version} of .serialized; 3 and 4 are read"))),
        _ => invalid(format!("no .serialized shape at byte {offset}")),
    }
}

/// A shape, and its positions as they are stored, where not all are single precision.
fn shape(path: &Path, bytes: &[u8], offset: usize, index: usize) -> Parsed<(Part, Vec<[f64; 3]>)> {
    let version = head(bytes, offset)?;
    let packed = &bytes[offset + 4..];
    // Deflate expands at most some 1032 times; no mesh worth its name needs that, so large files get less.
    let n = packed.len() as u64;
    let mut stream =
        Stream { inner: ZlibDecoder::new(packed), index, most: (1100 * (n + 64)).min((1 << 28) + 100 * n) };
    let flags = stream.u32()?;
    let name = if version == 4 { stream.name()? } else { String::new() };
    let (vertices, triangles) = (stream.u64()?, stream.u64()?);
    let double = flags & DOUBLE != 0;
    if vertices > u64::from(u32::MAX) {
        return Err(Fault::Unsupported(format!("shape {index} has {vertices} vertices; 32-bit indices do not reach")));
    }
    let exact = stream.doubles::<3>(vertices, double)?;
    let positions = exact.iter().map(|p| p.map(|x| x as f32)).collect();
    let normals = (flags & NORMALS != 0).then(|| stream.floats::<3>(vertices, double)).transpose()?;
    let uvs = (flags & TEXCOORDS != 0).then(|| stream.floats::<2>(vertices, double)).transpose()?;
    let colors = (flags & COLORS != 0).then(|| stream.floats::<3>(vertices, double)).transpose()?;
    let indices = stream.triangles(triangles)?;
    let mesh = TriMesh { positions, normals, uvs, colors, indices, ..TriMesh::default() };
    if let Some(fault) = mesh.fault() {
        return invalid(format!("shape {index}: {fault}"));
    }
    let mut part = Part::named(path, mesh);
    part.flat = flags & FACE_NORMALS != 0;
    if !name.is_empty() {
        part.name = name;
    }
    Ok((part, exact))
}

struct Stream<'a> {
    inner: ZlibDecoder<&'a [u8]>,
    index: usize,
    /// More bytes than this are not taken from the stream.
    most: u64,
}

impl Stream<'_> {
    fn truncated(&self) -> Fault {
        Fault::Invalid(format!("shape {}: the compressed stream is damaged or ends too early", self.index))
    }

    fn array<const N: usize>(&mut self) -> Parsed<[u8; N]> {
        let mut raw = [0; N];
        self.inner.read_exact(&mut raw).map_err(|_| self.truncated())?;
        Ok(raw)
    }

    fn u32(&mut self) -> Parsed<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Parsed<u64> {
        self.array().map(u64::from_le_bytes)
    }

    fn name(&mut self) -> Parsed<String> {
        let mut name = Vec::new();
        loop {
            match self.array()? {
                [0] => return Ok(String::from_utf8_lossy(&name).into_owned()),
                [b] if name.len() < 4096 => name.push(b),
                _ => return invalid(format!("shape {}: the name has no end", self.index)),
            }
        }
    }

    /// `count` records of `size` bytes, after checking that the stream can hold them.
    fn records(&mut self, count: u64, size: usize, mut take: impl FnMut(&[u8])) -> Parsed<()> {
        let bytes = count.checked_mul(size as u64).filter(|&n| n <= self.most);
        let Some(mut left) = bytes.map(|n| n as usize) else {
            return invalid(format!("shape {}: {count} records cannot be in so short a file", self.index));
        };
        let mut buffer = vec![0; (64 * 1024 / size * size).min(left.max(1))];
        while left > 0 {
            let n = left.min(buffer.len());
            self.inner.read_exact(&mut buffer[..n]).map_err(|_| self.truncated())?;
            buffer[..n].chunks_exact(size).for_each(&mut take);
            left -= n;
        }
        Ok(())
    }

    fn floats<const N: usize>(&mut self, count: u64, double: bool) -> Parsed<Vec<[f32; N]>> {
        Ok(self.doubles::<N>(count, double)?.into_iter().map(|v| v.map(|x| x as f32)).collect())
    }

    fn doubles<const N: usize>(&mut self, count: u64, double: bool) -> Parsed<Vec<[f64; N]>> {
        let width = if double { 8 } else { 4 };
        let mut values = Vec::new();
        self.records(count, N * width, |raw| {
            values.push(std::array::from_fn(|i| {
                let raw = &raw[i * width..];
                match (raw.first_chunk::<4>(), raw.first_chunk::<8>()) {
                    (_, Some(&raw)) if double => f64::from_le_bytes(raw),
                    (Some(&raw), _) => f64::from(f32::from_le_bytes(raw)),
                    _ => 0.0, // not reached: a record holds N values
                }
            }));
        })?;
        Ok(values)
    }

    fn triangles(&mut self, count: u64) -> Parsed<Vec<[u32; 3]>> {
        let mut triangles = Vec::new();
        self.records(count, 12, |raw| {
            triangles.push(std::array::from_fn(|i| {
                u32::from_le_bytes([raw[4 * i], raw[4 * i + 1], raw[4 * i + 2], raw[4 * i + 3]])
            }));
        })?;
        Ok(triangles)
    }
}
