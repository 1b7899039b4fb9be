//! The state of a render on disk, to go on later: `.tlck`, described in docs/formats/checkpoint.md.
//!
//! A header in JSON says what is rendered and which sections of little-endian numbers follow; header and sections have a
//! checksum each (CRC-32), so that damage is found where it is. A section that a reader does not know is passed over if the
//! header says that it may be: room for what later methods keep (weights of pixels, aprons of tiles). The sums are exact, so
//! that a resumed render ends in the same bits as an uninterrupted one.

use crate::film::{Aov, Film};
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::io::{BufReader, Read, Write};
use std::path::Path;
use translume_image::atomic;

const MAGIC: &[u8; 8] = b"TLCHKPT\0";
const VERSION: u32 = 3;
/// A longer header is damaged.
const MAX_HEADER: u32 = 1 << 20;
/// Numbers that are read or written at once.
const BATCH: usize = 4096;

/// What must agree between a checkpoint and the render that goes on with it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Of scene and settings, see [`crate::fingerprint`].
    pub fingerprint: u64,
    /// Of the random numbers.
    pub seed: u64,
}

#[derive(Debug, Deserialize, Serialize)]
struct Header {
    /// 16 hexadecimal digits: JSON's numbers are not exact up to 2⁶⁴.
    fingerprint: String,
    seed: String,
    width: u32,
    height: u32,
    feature_images: Vec<String>,
    /// Pixels around each tile that its sections hold too.
    #[serde(default)]
    apron: u32,
    sections: Vec<Section>,
}

#[derive(Debug, Deserialize, PartialEq, Eq, Serialize)]
struct Section {
    name: String,
    #[serde(rename = "type")]
    kind: String,
    count: u64,
    /// A reader that does not know the section may go on without it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    optional: bool,
}

/// A number as it is stored.
trait Number: Copy {
    const KIND: &'static str;
    const BYTES: usize = size_of::<Self>();
    fn put(self, to: &mut Vec<u8>);
    fn take(from: &[u8]) -> Self;
}

macro_rules! number {
    ($type:ty, $kind:literal) => {
        impl Number for $type {
            const KIND: &'static str = $kind;
            fn put(self, to: &mut Vec<u8>) {
                to.extend_from_slice(&self.to_le_bytes());
            }
            fn take(from: &[u8]) -> Self {
                Self::from_le_bytes(from.try_into().expect("as many bytes as the type has"))
            }
        }
    };
}
number!(u64, "uint64");
number!(f64, "float64");
number!(i128, "int128");

/// What goes through the sections of a film in their order; in each the tiles come one after the other.
trait Visitor {
    fn section<T: Number>(&mut self, name: &str, values: &mut dyn Iterator<Item = T>) -> Result<()>;
}

fn visit(film: &Film, v: &mut impl Visitor) -> Result<()> {
    let tiles = &film.tiles;
    v.section("samples", &mut tiles.iter().map(|t| t.samples))?;
    v.section("broken", &mut tiles.iter().map(|t| t.broken))?;
    v.section("sums", &mut tiles.iter().flat_map(|t| t.sums.as_flattened()).copied())?;
    v.section("squares", &mut tiles.iter().flat_map(|t| t.squares.as_flattened()).copied())?;
    v.section("features", &mut tiles.iter().flat_map(|t| &t.features).copied())?;
    if let Some(splats) = &film.splats {
        v.section("splats", &mut splats.sums.as_flattened().iter().copied())?;
        v.section("splat_squares", &mut splats.squares.as_flattened().iter().copied())?;
    }
    Ok(())
}

/// The same the other way: fills the film from a file.
fn fill(film: &mut Film, file: &mut Reader) -> Result<()> {
    let tiles = &mut film.tiles;
    file.section("samples", &mut tiles.iter_mut().map(|t| &mut t.samples))?;
    file.section("broken", &mut tiles.iter_mut().map(|t| &mut t.broken))?;
    file.section("sums", &mut tiles.iter_mut().flat_map(|t| t.sums.as_flattened_mut()))?;
    file.section("squares", &mut tiles.iter_mut().flat_map(|t| t.squares.as_flattened_mut()))?;
    file.section("features", &mut tiles.iter_mut().flat_map(|t| &mut t.features))?;
    if let Some(splats) = &mut film.splats {
        file.section("splats", &mut splats.sums.as_flattened_mut().iter_mut())?;
        file.section("splat_squares", &mut splats.squares.as_flattened_mut().iter_mut())?;
    }
    Ok(())
}

/// Lists the sections.
struct List(Vec<Section>);

impl Visitor for List {
    fn section<T: Number>(&mut self, name: &str, values: &mut dyn Iterator<Item = T>) -> Result<()> {
        let count = values.count() as u64;
        self.0.push(Section { name: name.into(), kind: T::KIND.into(), count, optional: false });
        Ok(())
    }
}

fn header(film: &Film, identity: &Identity) -> Result<Header> {
    let mut list = List(Vec::new());
    visit(film, &mut list)?;
    let name = |a: &Aov| Aov::NAMED.iter().find(|n| n.1 == *a).map(|n| n.0.to_owned());
    Ok(Header {
        fingerprint: format!("{:016x}", identity.fingerprint),
        seed: identity.seed.to_string(),
        width: film.size()[0],
        height: film.size()[1],
        feature_images: film.aovs().iter().filter_map(name).collect(),
        apron: 0,
        sections: list.0,
    })
}

/// Writes `film`; the file appears whole or not at all.
///
/// # Errors
/// [`Error::Image`] (I/O).
pub fn write(path: &Path, film: &Film, identity: &Identity) -> Result<()> {
    let header = serde_json::to_vec(&header(film, identity)?).expect("plain data");
    atomic::write(path, |out| {
        let mut writer = Writer { out, path };
        writer.put(MAGIC)?;
        writer.put(&VERSION.to_le_bytes())?;
        writer.put(&(header.len() as u32).to_le_bytes())?;
        writer.put(&header)?;
        writer.put(&crc32fast::hash(&header).to_le_bytes())?;
        visit(film, &mut writer)
    })
}

struct Writer<'a, W> {
    out: &'a mut W,
    path: &'a Path,
}

impl<W: Write> Writer<'_, W> {
    fn put(&mut self, bytes: &[u8]) -> Result<()> {
        Ok(self.out.write_all(bytes).map_err(|e| translume_image::Error::io(self.path, e))?)
    }
}

impl<W: Write> Visitor for Writer<'_, W> {
    fn section<T: Number>(&mut self, _: &str, values: &mut dyn Iterator<Item = T>) -> Result<()> {
        let (mut hash, mut batch) = (crc32fast::Hasher::new(), Vec::with_capacity(BATCH * T::BYTES));
        loop {
            batch.clear();
            values.take(BATCH).for_each(|v| v.put(&mut batch));
            if batch.is_empty() {
                return self.put(&hash.finalize().to_le_bytes());
            }
            hash.update(&batch);
            self.put(&batch)?;
        }
    }
}

/// Reads a checkpoint into `film`, an empty film of the render that is to go on.
///
/// # Errors
/// [`Error::Mismatch`] for one of another scene, seed, size or set of feature images, and for files that are damaged; `film`
/// is then of no use.
pub fn read(path: &Path, film: &mut Film, identity: &Identity) -> Result<()> {
    let file = std::fs::File::open(path).map_err(|e| translume_image::Error::io(path, e))?;
    let mut input = Input { file: BufReader::new(file), path };
    // A file shorter than the magic is no checkpoint either.
    if input.take::<8>().ok().as_ref() != Some(MAGIC) {
        return Err(mismatch(path, "this is no checkpoint of translume"));
    }
    let version = u32::from_le_bytes(input.take()?);
    if version != VERSION {
        return Err(mismatch(path, &format!("version {version} of the format; this program reads version {VERSION}")));
    }
    let found = input.header()?;
    let wanted = header(film, identity)?;
    agree(path, &found, &wanted)?;
    let mut reader = Reader { input, sections: found.sections.into_iter() };
    fill(film, &mut reader)?;
    let Reader { mut input, sections } = reader;
    for section in sections {
        input.pass(&section)?;
    }
    match input.file.read(&mut [0]) {
        Ok(0) => Ok(()),
        _ => Err(mismatch(path, "there is more in the file than there should be: it is damaged")),
    }
}

/// Whether a file is of the render that is to go on.
fn agree(path: &Path, found: &Header, wanted: &Header) -> Result<()> {
    if found.seed != wanted.seed {
        let (had, has) = (&found.seed, &wanted.seed);
        return Err(mismatch(
            path,
            &format!("it was begun with seed {had}, not {has}; a resumed render keeps its seed"),
        ));
    }
    let same_size = [found.width, found.height] == [wanted.width, wanted.height];
    if !same_size || found.feature_images != wanted.feature_images {
        let (w, h) = (found.width, found.height);
        return Err(mismatch(path, &format!("it holds {w} × {h} pixels or other feature images than this render")));
    }
    if found.fingerprint != wanted.fingerprint {
        return Err(mismatch(path, "it belongs to another scene or other settings: it cannot be resumed"));
    }
    if found.apron != wanted.apron {
        return Err(mismatch(path, "its tiles have aprons, which this program does not know"));
    }
    Ok(())
}

/// Goes through the sections that a film needs, in their order; others must be optional.
struct Reader<'a> {
    input: Input<'a>,
    sections: std::vec::IntoIter<Section>,
}

impl Reader<'_> {
    fn section<'a, T: Number + 'a>(&mut self, name: &str, values: &mut dyn Iterator<Item = &'a mut T>) -> Result<()> {
        let path = self.input.path;
        let section = loop {
            let next = self.sections.next();
            let next = next.ok_or_else(|| mismatch(path, &format!("it has no section `{name}`: it is damaged")))?;
            if next.name == name {
                break next;
            }
            self.input.pass(&next)?;
        };
        let mut values = values.peekable();
        let (mut hash, mut bytes, mut count) = (crc32fast::Hasher::new(), Vec::new(), 0u64);
        while count < section.count && section.kind == T::KIND {
            let batch = (section.count - count).min(BATCH as u64) as usize;
            bytes.resize(batch * T::BYTES, 0);
            self.input.fill(&mut bytes)?;
            hash.update(&bytes);
            let stored = bytes.chunks_exact(T::BYTES).map(T::take);
            let taken = stored.zip(&mut values).map(|(s, v)| *v = s).count();
            count += taken as u64;
            if taken < batch {
                break;
            }
        }
        if section.kind != T::KIND || count != section.count || values.peek().is_some() {
            let what =
                format!("section `{name}` has {} numbers of type {}: it is damaged", section.count, section.kind);
            return Err(mismatch(path, &what));
        }
        self.input.check(hash.finalize(), name)
    }
}

struct Input<'a> {
    file: BufReader<std::fs::File>,
    path: &'a Path,
}

impl Input<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut bytes = [0; N];
        self.fill(&mut bytes)?;
        Ok(bytes)
    }

    fn fill(&mut self, bytes: &mut [u8]) -> Result<()> {
        match self.file.read_exact(bytes) {
            Ok(()) => Ok(()),
            Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => Err(mismatch(self.path, "the file is cut off")),
            Err(e) => Err(translume_image::Error::io(self.path, e).into()),
        }
    }

    fn header(&mut self) -> Result<Header> {
        let length = u32::from_le_bytes(self.take()?);
        if length > MAX_HEADER {
            return Err(mismatch(self.path, "its header is too long: it is damaged"));
        }
        let mut text = vec![0; length as usize];
        self.fill(&mut text)?;
        self.check(crc32fast::hash(&text), "header")?;
        serde_json::from_slice(&text).map_err(|e| mismatch(self.path, &format!("its header: {e}")))
    }

    fn check(&mut self, hash: u32, what: &str) -> Result<()> {
        match u32::from_le_bytes(self.take()?) == hash {
            true => Ok(()),
            false => Err(mismatch(self.path, &format!("the checksum of `{what}` is wrong: the file is damaged"))),
        }
    }

    /// Passes over an optional section.
    fn pass(&mut self, section: &Section) -> Result<()> {
        let Section { name, kind, count, optional } = section;
        let bytes = match &kind[..] {
            "uint8" => 1,
            "uint32" | "float32" => 4,
            "uint64" | "float64" => 8,
            "int128" => 16,
            _ => 0,
        };
        if !*optional || bytes == 0 {
            return Err(mismatch(self.path, &format!("a section `{name}` that this program does not know")));
        }
        let (mut hash, mut left) = (crc32fast::Hasher::new(), count.saturating_mul(bytes));
        let mut batch = vec![0; 1 << 16];
        while left > 0 {
            let part = left.min(batch.len() as u64) as usize;
            self.fill(&mut batch[..part])?;
            hash.update(&batch[..part]);
            left -= part as u64;
        }
        self.check(hash.finalize(), name)
    }
}

fn mismatch(path: &Path, why: &str) -> Error {
    Error::Mismatch(format!("{}: {why}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDENTITY: Identity = Identity { fingerprint: u64::MAX - 1, seed: u64::MAX };

    fn splats(sum: i128, square: i128) -> crate::splat::Splats {
        let mut splats = crate::splat::Splats::new(340, true, 1.0);
        splats.sums.fill([sum; 3]);
        splats.squares.fill([square; 3]);
        splats
    }

    fn film(value: f64) -> Film {
        let mut film = Film::new([20, 17], &[Aov::Albedo, Aov::Variance]).unwrap();
        film.splats = Some(splats(7, -1));
        for (i, tile) in film.tiles.iter_mut().enumerate() {
            tile.samples = i as u64;
            tile.sums.iter_mut().flatten().for_each(|v| *v = value);
        }
        film
    }

    fn empty() -> Film {
        let mut film = film(0.0);
        film.splats = Some(splats(0, 0));
        film
    }

    #[test]
    fn every_changed_byte_is_found() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.tlck");
        write(&path, &film(0.1), &IDENTITY).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let mut read_back = empty();
        read(&path, &mut read_back, &IDENTITY).unwrap();
        assert_eq!(read_back.tiles[3].samples, 3);
        assert!(read_back.tiles.iter().flat_map(|t| t.sums.as_flattened()).all(|v| *v == 0.1));
        assert_eq!(read_back.splats.unwrap().squares[339], [-1; 3]);
        for at in (0..whole.len()).step_by(97).chain(0..600) {
            let mut damaged = whole.clone();
            damaged[at] ^= 0x10;
            std::fs::write(&path, damaged).unwrap();
            assert!(read(&path, &mut empty(), &IDENTITY).is_err(), "byte {at}");
        }
    }

    /// A file of a later program, with a section more.
    #[test]
    fn optional_sections_are_passed_over() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.tlck");
        write(&path, &film(0.5), &IDENTITY).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let length = u32::from_le_bytes(whole[12..16].try_into().unwrap()) as usize;
        let header: serde_json::Value = serde_json::from_slice(&whole[16..16 + length]).unwrap();
        let with = |optional: bool| {
            let mut header = header.clone();
            let more = serde_json::json!({ "name": "weights", "type": "float32", "count": 2, "optional": optional });
            header["sections"].as_array_mut().unwrap().insert(1, more);
            let (text, first) = (header.to_string().into_bytes(), 16 + length + 4 + 4 * 8 + 4);
            let mut file = [&whole[..12], &(text.len() as u32).to_le_bytes(), &text].concat();
            file.extend(crc32fast::hash(&text).to_le_bytes());
            file.extend(&whole[16 + length + 4..first]);
            file.extend([1; 8]);
            file.extend(crc32fast::hash(&[1; 8]).to_le_bytes());
            file.extend(&whole[first..]);
            std::fs::write(&path, file).unwrap();
            read(&path, &mut empty(), &IDENTITY)
        };
        with(true).unwrap();
        assert!(with(false).unwrap_err().to_string().contains("weights"));
    }
}
