//! The state of a render on disk, to go on later: `.tlck`, described in docs/formats/checkpoint.md.
//!
//! All numbers are little-endian. Magic `TLCHKPT\0`, version u32 (2), fingerprint u64, seed u64, width u32, height u32,
//! number of feature images u32 and for each its index in [`Aov::NAMED`] u32; then per tile, in rows of tiles from the top
//! left, samples u64, broken u64 and the sums as f64: RGB per pixel, their squares if the variance is collected, the
//! features' channels; then, of methods that splat, per pixel the sums of splats as i128 in units of 2⁻⁶⁴, RGB, and their
//! squares if the variance is collected. The sums are exact, so that a resumed render ends in the same bits as an uninterrupted one.

use crate::film::{Aov, Film};
use crate::{Error, Result};
use std::io::{Read, Write};
use std::path::Path;
use translume_image::atomic;

const MAGIC: &[u8; 8] = b"TLCHKPT\0";
const VERSION: u32 = 2;

/// What must agree between a checkpoint and the render that goes on with it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Of scene and settings, see [`crate::fingerprint`].
    pub fingerprint: u64,
    /// Of the random numbers.
    pub seed: u64,
}

/// Writes `film`; the file appears whole or not at all.
///
/// # Errors
/// [`Error::Image`] (I/O).
pub fn write(path: &Path, film: &Film, identity: &Identity) -> Result<()> {
    let io = |e| translume_image::Error::io(path, e);
    let aovs = film.aovs();
    let numbers: Vec<u32> =
        aovs.iter().filter_map(|a| Aov::NAMED.iter().position(|n| n.1 == *a)).map(|i| i as u32).collect();
    Ok(atomic::write(path, |out| {
        let mut put = |bytes: &[u8]| out.write_all(bytes).map_err(io);
        put(MAGIC)?;
        put(&VERSION.to_le_bytes())?;
        put(&identity.fingerprint.to_le_bytes())?;
        put(&identity.seed.to_le_bytes())?;
        for n in [film.size()[0], film.size()[1], numbers.len() as u32].iter().chain(&numbers) {
            put(&n.to_le_bytes())?;
        }
        for tile in &film.tiles {
            put(&tile.samples.to_le_bytes())?;
            put(&tile.broken.to_le_bytes())?;
            let sums = tile.sums.iter().chain(&tile.squares).flatten().chain(&tile.features);
            for v in sums {
                put(&v.to_le_bytes())?;
            }
        }
        for v in film.splats.iter().flat_map(|s| s.sums.iter().chain(&s.squares)).flatten() {
            put(&v.to_le_bytes())?;
        }
        Ok::<(), translume_image::Error>(())
    })?)
}

/// Reads a checkpoint into `film`, an empty film of the render that is to go on.
///
/// # Errors
/// [`Error::Mismatch`] for one of another scene, seed, size or set of feature images, and for files that are damaged.
pub fn read(path: &Path, film: &mut Film, identity: &Identity) -> Result<()> {
    let file = std::fs::File::open(path).map_err(|e| translume_image::Error::io(path, e))?;
    let mut input = Input { file: std::io::BufReader::new(file), path };
    // A file shorter than the magic is no checkpoint either.
    if input.take::<8>().ok().as_ref() != Some(MAGIC) {
        return Err(mismatch(path, "this is no checkpoint of translume"));
    }
    let version = u32::from_le_bytes(input.take()?);
    if version != VERSION {
        return Err(mismatch(path, &format!("version {version} of the format; this program reads version {VERSION}")));
    }
    let found = Identity { fingerprint: u64::from_le_bytes(input.take()?), seed: u64::from_le_bytes(input.take()?) };
    if found.seed != identity.seed {
        let (had, has) = (found.seed, identity.seed);
        return Err(mismatch(
            path,
            &format!("it was begun with --seed {had}, not {has}; a resumed render keeps its seed"),
        ));
    }
    let size = [u32::from_le_bytes(input.take()?), u32::from_le_bytes(input.take()?)];
    let count = u32::from_le_bytes(input.take()?);
    let mut aovs = Vec::new();
    for _ in 0..count.min(Aov::NAMED.len() as u32) {
        let number = u32::from_le_bytes(input.take()?) as usize;
        aovs.extend(Aov::NAMED.get(number).map(|n| n.1));
    }
    if size != film.size() || aovs != film.aovs() {
        let why = format!("it holds {} × {} pixels or other feature images than this render", size[0], size[1]);
        return Err(mismatch(path, &why));
    }
    if found.fingerprint != identity.fingerprint {
        return Err(mismatch(path, "it belongs to another scene or other settings; render anew without --resume"));
    }
    for tile in &mut film.tiles {
        tile.samples = u64::from_le_bytes(input.take()?);
        tile.broken = u64::from_le_bytes(input.take()?);
        let sums = tile.sums.iter_mut().chain(&mut tile.squares).flatten().chain(&mut tile.features);
        for v in sums {
            *v = f64::from_le_bytes(input.take()?);
        }
    }
    for v in film.splats.iter_mut().flat_map(|s| s.sums.iter_mut().chain(&mut s.squares)).flatten() {
        *v = i128::from_le_bytes(input.take()?);
    }
    match input.file.read(&mut [0]) {
        Ok(0) => Ok(()),
        _ => Err(mismatch(path, "there is more in the file than there should be: it is damaged")),
    }
}

struct Input<'a> {
    file: std::io::BufReader<std::fs::File>,
    path: &'a Path,
}

impl Input<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut bytes = [0; N];
        match self.file.read_exact(&mut bytes) {
            Ok(()) => Ok(bytes),
            Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => Err(mismatch(self.path, "the file is cut off")),
            Err(e) => Err(translume_image::Error::io(self.path, e).into()),
        }
    }
}

fn mismatch(path: &Path, why: &str) -> Error {
    Error::Mismatch(format!("{}: {why}", path.display()))
}
