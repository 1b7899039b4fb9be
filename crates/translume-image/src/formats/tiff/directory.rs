//! The directories of TIFF and BigTIFF files, field by field: a field that is damaged is missing, the others are there.

use exif::{Field, In, Rational, SRational, Tag, Value};

/// A file as its directories see it.
#[derive(Clone, Copy)]
pub(crate) struct File<'a> {
    pub bytes: &'a [u8],
    pub little: bool,
    /// BigTIFF: 64-bit offsets.
    big: bool,
}

/// One directory: a picture, or a table of facts.
#[derive(Clone, Debug, Default)]
pub(crate) struct Directory {
    entries: Vec<Entry>,
    /// Where the next one is; 0 for none.
    pub next: u64,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    tag: u16,
    kind: u16,
    count: usize,
    at: usize,
}

/// Bytes of a value of each field type; 0 for types that are unknown.
const SIZES: [usize; 19] = [0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4, 0, 0, 8, 8, 8];

impl<'a> File<'a> {
    /// The file and the place of its first directory.
    pub(crate) fn new(bytes: &'a [u8]) -> Option<(Self, u64)> {
        let little = match bytes.get(..2)? {
            b"II" => true,
            b"MM" => false,
            _ => return None,
        };
        let mut file = Self { bytes, little, big: false };
        match file.number(2, 2)? {
            42 => Some((file, file.number(4, 4)?)),
            43 if file.number(4, 2)? == 8 => {
                file.big = true;
                Some((file, file.number(8, 8)?))
            }
            _ => None,
        }
    }

    /// An unsigned number of `size` bytes.
    fn number(&self, at: usize, size: usize) -> Option<u64> {
        let bytes = self.bytes.get(at..at.checked_add(size)?)?;
        let add = |n: u64, b: &u8| n << 8 | u64::from(*b);
        Some(if self.little { bytes.iter().rev().fold(0, add) } else { bytes.iter().fold(0, add) })
    }

    /// The directory at `offset`, with those of its entries that lie in the file.
    pub(crate) fn directory(&self, offset: u64) -> Option<Directory> {
        let at = usize::try_from(offset).ok()?;
        let (counter, step, inline) = if self.big { (8, 20, 8) } else { (2, 12, 4) };
        let count = usize::try_from(self.number(at, counter)?).ok()?;
        let first = at.checked_add(counter)?;
        let room = self.bytes.len().checked_sub(first)? / step;
        let entries = (0..count.min(room)).filter_map(|i| self.entry(first + i * step, inline)).collect();
        let end = count.checked_mul(step).and_then(|n| first.checked_add(n));
        let next = end.and_then(|end| self.number(end, inline)).unwrap_or(0);
        Some(Directory { entries, next })
    }

    fn entry(&self, at: usize, inline: usize) -> Option<Entry> {
        let (tag, kind) = (self.number(at, 2)? as u16, self.number(at + 2, 2)? as u16);
        let count = usize::try_from(self.number(at + 4, inline)?).ok()?;
        let size = SIZES.get(usize::from(kind)).copied().filter(|s| *s > 0)?;
        let bytes = count.checked_mul(size)?;
        let at = if bytes <= inline { at + 4 + inline } else { self.number(at + 4 + inline, inline)? as usize };
        (at.checked_add(bytes)? <= self.bytes.len()).then_some(Entry { tag, kind, count, at })
    }

    /// The bytes of a field, as they stand.
    pub(crate) fn bytes_of(&self, directory: &Directory, tag: u16) -> Option<&'a [u8]> {
        let e = directory.find(tag)?;
        self.bytes.get(e.at..e.at + e.count * SIZES[usize::from(e.kind)])
    }

    /// The unsigned integers of a field.
    pub(crate) fn integers(&self, directory: &Directory, tag: u16) -> Option<Vec<u64>> {
        let e = directory.find(tag).filter(|e| matches!(e.kind, 1 | 3 | 4 | 7 | 13 | 16 | 18))?;
        let size = SIZES[usize::from(e.kind)];
        (0..e.count).map(|i| self.number(e.at + i * size, size)).collect()
    }

    /// The first integer of a field.
    pub(crate) fn integer(&self, directory: &Directory, tag: u16) -> Option<u64> {
        self.integers(directory, tag)?.first().copied()
    }

    /// The numbers of a field of fractions, floats or integers.
    pub(crate) fn fractions(&self, directory: &Directory, tag: u16) -> Option<Vec<f64>> {
        let e = directory.find(tag)?;
        let pair = |i: usize| Some((self.number(e.at + 8 * i, 4)?, self.number(e.at + 8 * i + 4, 4)?));
        match e.kind {
            5 => (0..e.count).map(|i| pair(i).map(|(a, b)| a as f64 / b as f64)).collect(),
            10 => (0..e.count).map(|i| pair(i).map(|(a, b)| f64::from(a as i32) / f64::from(b as i32))).collect(),
            11 => (0..e.count).map(|i| Some(f64::from(f32::from_bits(self.number(e.at + 4 * i, 4)? as u32)))).collect(),
            12 => (0..e.count).map(|i| self.number(e.at + 8 * i, 8).map(f64::from_bits)).collect(),
            _ => Some(self.integers(directory, tag)?.into_iter().map(|v| v as f64).collect()),
        }
    }

    /// A field as the EXIF library holds it: numbers and text.
    pub(crate) fn exif_field(&self, directory: &Directory, tag: u16, context: exif::Context) -> Option<Field> {
        let e = directory.find(tag)?;
        let pair = |i: usize| Some((self.number(e.at + 8 * i, 4)? as u32, self.number(e.at + 8 * i + 4, 4)? as u32));
        let value = match e.kind {
            2 => Value::Ascii(vec![self.bytes_of(directory, tag)?.to_vec()]),
            5 => {
                let pairs = (0..e.count).map(|i| pair(i).map(|(num, denom)| Rational { num, denom }));
                Value::Rational(pairs.collect::<Option<_>>()?)
            }
            10 => {
                let signed = |(num, denom): (u32, u32)| SRational { num: num as i32, denom: denom as i32 };
                Value::SRational((0..e.count).map(|i| pair(i).map(signed)).collect::<Option<_>>()?)
            }
            11 | 12 => Value::Double(self.fractions(directory, tag)?),
            _ => Value::Long(self.integers(directory, tag)?.into_iter().map(|v| v as u32).collect()),
        };
        Some(Field { tag: Tag(context, tag), ifd_num: In::PRIMARY, value })
    }
}

impl Directory {
    fn find(&self, tag: u16) -> Option<&Entry> {
        self.entries.iter().find(|e| e.tag == tag)
    }

    pub(crate) fn has(&self, tag: u16) -> bool {
        self.find(tag).is_some()
    }
}
