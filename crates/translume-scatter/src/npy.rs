//! Sample lists in NumPy's `.npy` format, read a block of points at a time.
//!
//! Source: the NEP 1 specification of the format, versions 1.0 to 3.0. Read are C-ordered little-endian `float32` and
//! `float64` arrays of shape (points, samples, 3). The length of the file is compared with the header before anything is
//! allocated, so a header cannot ask for more memory than the file has bytes.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use translume_image::{Error, Result};

/// Longest header that is read; NumPy itself refuses headers of more than 10,000 bytes.
const MAX_HEADER: usize = 1 << 16;

/// An open list of samples.
#[derive(Debug)]
pub struct SampleFile {
    path: PathBuf,
    reader: BufReader<File>,
    double: bool,
    /// Number of lit points.
    pub points: usize,
    /// Samples of each point.
    pub samples: usize,
    read: usize,
    bytes: Vec<u8>,
}

impl SampleFile {
    /// Opens `path` and checks its header against its length.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Invalid`] for what is no `.npy` file, or is truncated; [`Error::Unsupported`] for
    /// another type, order or shape.
    pub fn open(path: &Path) -> Result<Self> {
        let io = |e| Error::io(path, e);
        let file = File::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        let mut reader = BufReader::new(file);
        let header = read_header(path, &mut reader)?;
        let Header { double, points, samples } = parse_header(path, &header.text)?;
        let point_bytes = (samples as u64).checked_mul(if double { 24 } else { 12 });
        let needed = point_bytes.and_then(|b| b.checked_mul(points as u64)?.checked_add(header.bytes));
        match needed {
            Some(n) if n == length => {}
            Some(n) if n < length => {
                return Err(Error::invalid(path, format!("{} bytes follow the end of the array", length - n)));
            }
            _ => {
                return Err(Error::invalid(
                    path,
                    format!(
                        "truncated: {points} points of {samples} samples do not fit into {length} bytes; save it again"
                    ),
                ));
            }
        }
        Ok(Self { path: path.to_owned(), reader, double, points, samples, read: 0, bytes: Vec::new() })
    }

    /// Reads up to `most` further points into `block`, (x, y, value) each; the number of points read, 0 at the end.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Unsupported`] when a point is larger than the memory.
    pub fn read_points(&mut self, most: usize, block: &mut Vec<[f32; 3]>) -> Result<usize> {
        block.clear();
        let points = most.min(self.points - self.read);
        let samples = points * self.samples;
        let width = if self.double { 24 } else { 12 };
        let refused = |_| Error::unsupported(&self.path, "a block of points does not fit into the memory");
        self.bytes.clear();
        self.bytes.try_reserve(samples * width).map_err(refused)?;
        block.try_reserve(samples).map_err(refused)?;
        self.bytes.resize(samples * width, 0);
        self.reader.read_exact(&mut self.bytes).map_err(|e| Error::io(&self.path, e))?;
        match self.double {
            false => block.extend(self.bytes.chunks_exact(12).map(|s| {
                let float = |i: usize| f32::from_le_bytes([s[4 * i], s[4 * i + 1], s[4 * i + 2], s[4 * i + 3]]);
                [float(0), float(1), float(2)]
            })),
            true => block.extend(self.bytes.chunks_exact(24).map(|s| {
                let float = |i: usize| {
                    let mut word = [0; 8];
                    word.copy_from_slice(&s[8 * i..8 * i + 8]);
                    f64::from_le_bytes(word) as f32
                };
                [float(0), float(1), float(2)]
            })),
        }
        self.read += points;
        Ok(points)
    }
}

struct RawHeader {
    text: String,
    /// Everything before the array.
    bytes: u64,
}

fn read_header(path: &Path, reader: &mut impl Read) -> Result<RawHeader> {
    let no_npy = || Error::invalid(path, "not a .npy file (write one with numpy.save)");
    let mut start = [0u8; 8];
    reader.read_exact(&mut start).map_err(|_| no_npy())?;
    if start[..6] != *b"\x93NUMPY" {
        return Err(no_npy());
    }
    let (size_bytes, known) = match start[6] {
        1 => (2, true),
        2 | 3 => (4, true),
        _ => (0, false),
    };
    if !known {
        return Err(Error::unsupported(path, format!(".npy version {}; versions 1 to 3 are read", start[6])));
    }
    let truncated = || Error::invalid(path, "truncated inside its header");
    let mut size = [0u8; 4];
    reader.read_exact(&mut size[..size_bytes]).map_err(|_| truncated())?;
    let size = u32::from_le_bytes(size) as usize;
    if size > MAX_HEADER {
        return Err(Error::invalid(path, format!("a header of {size} bytes; no array needs one")));
    }
    let mut text = vec![0; size];
    reader.read_exact(&mut text).map_err(|_| truncated())?;
    let text = String::from_utf8(text).map_err(|_| Error::invalid(path, "its header is no text"))?;
    Ok(RawHeader { text, bytes: (8 + size_bytes + size) as u64 })
}

struct Header {
    double: bool,
    points: usize,
    samples: usize,
}

/// Reads `{'descr': '<f4', 'fortran_order': False, 'shape': (40, 2000, 3), }`.
fn parse_header(path: &Path, text: &str) -> Result<Header> {
    let field = |name: &str| {
        let at = [format!("'{name}'"), format!("\"{name}\"")].iter().find_map(|k| Some(text.find(k)? + k.len()));
        at.and_then(|at| text[at..].trim_start().strip_prefix(':'))
            .map(str::trim_start)
            .ok_or_else(|| Error::invalid(path, format!("its header has no {name}")))
    };
    let descr = field("descr")?;
    let double = match descr.get(1..4) {
        Some("<f4") => false,
        Some("<f8") => true,
        _ => {
            let found: String = descr.chars().take(24).take_while(|c| *c != ',').collect();
            return Err(Error::unsupported(
                path,
                format!("type {found}: samples are little-endian float32 (array.astype('<f4'))"),
            ));
        }
    };
    if !field("fortran_order")?.starts_with("False") {
        return Err(Error::unsupported(path, "Fortran order: save numpy.ascontiguousarray of it"));
    }
    let shape = field("shape")?.strip_prefix('(').and_then(|s| s.split_once(')')).map(|s| s.0);
    let shape = shape.ok_or_else(|| Error::invalid(path, "its header has no shape"))?;
    let sides: Vec<usize> = shape
        .split(',')
        .map(str::trim)
        .filter(|s| !s.is_empty())
        .map(|s| s.parse().map_err(|_| Error::invalid(path, format!("the shape ({shape}) makes no sense"))))
        .collect::<Result<_>>()?;
    match sides[..] {
        [points, samples, 3] if points > 0 && samples > 0 => Ok(Header { double, points, samples }),
        _ => Err(Error::unsupported(
            path,
            format!("shape ({shape}): wanted is (points, samples, 3) with x, y and the value of each sample"),
        )),
    }
}
