//! Planes of numbers in memory or, where there is no room for them, in a file without a name, which ends with its process.
//!
//! Both are worked on in bands of texels, those in memory in one band of all. Bands begin at multiples of a unit, so that what is
//! summed in pieces is summed in the same pieces in any case: results do not depend on where planes are kept.

use crate::{Error, Result};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Bytes of a band, however much room there is: longer ones are no quicker.
const MOST_BAND: usize = 256 << 20;

/// How much memory there is for planes, and where others go.
#[derive(Clone, Debug)]
pub(crate) struct Room {
    /// Bytes of memory.
    pub(crate) bytes: usize,
    /// Folder for files.
    pub(crate) folder: Arc<Path>,
}

impl Room {
    /// Room for any number of planes.
    #[cfg(test)]
    pub(crate) fn boundless() -> Self {
        Self { bytes: usize::MAX, folder: Arc::from(Path::new("")) }
    }

    /// Room for `bytes`; what is more goes to files in `folder`.
    pub(crate) fn new(bytes: usize, folder: PathBuf) -> Self {
        Self { bytes, folder: Arc::from(folder) }
    }

    /// Empty planes of `texels` each, in memory if there is room for `expected` of them in all.
    pub(crate) fn planes(&self, texels: usize, expected: usize) -> Result<Planes> {
        let fits = texels.saturating_mul(4).saturating_mul(expected) <= self.bytes;
        let store = if fits { Store::Memory(Vec::new()) } else { self.file()? };
        Ok(Planes { texels, count: 0, store, room: self.clone() })
    }

    fn file(&self) -> Result<Store> {
        let file = tempfile::tempfile_in(&self.folder).map_err(|e| self.error(e))?;
        Ok(Store::File(file))
    }

    fn error(&self, source: std::io::Error) -> Error {
        let source = std::io::Error::new(source.kind(), format!("a temporary file for planes: {}", source.kind()));
        Error::io(&self.folder, source)
    }
}

/// Planes of the same number of texels.
#[derive(Debug)]
pub(crate) struct Planes {
    texels: usize,
    count: usize,
    store: Store,
    room: Room,
}

#[derive(Debug)]
enum Store {
    /// Plane after plane.
    Memory(Vec<f32>),
    /// The same, as the machine has its numbers.
    File(File),
}

impl Planes {
    /// Planes in memory, one after the other, each of `texels`.
    #[cfg(test)]
    pub(crate) fn of(texels: usize, values: Vec<f32>) -> Self {
        Self { texels, count: values.len() / texels, store: Store::Memory(values), room: Room::boundless() }
    }

    /// No planes yet, of the same texels and kept in the same way, with room for `expected`.
    pub(crate) fn empty_like(&self, expected: usize) -> Result<Self> {
        let store = match self.store {
            Store::Memory(_) => Store::Memory(Vec::with_capacity(expected * self.texels)),
            Store::File(_) => self.room.file()?,
        };
        Ok(Self { texels: self.texels, count: 0, store, room: self.room.clone() })
    }

    /// How many there are.
    pub(crate) fn count(&self) -> usize {
        self.count
    }

    /// Texels of each.
    pub(crate) fn texels(&self) -> usize {
        self.texels
    }

    /// Whether they are in memory.
    pub(crate) fn in_memory(&self) -> bool {
        matches!(self.store, Store::Memory(_))
    }

    /// The room that they have.
    pub(crate) fn room(&self) -> &Room {
        &self.room
    }

    /// Adds planes of zeros.
    pub(crate) fn grow(&mut self, by: usize) -> Result<()> {
        self.count += by;
        match &mut self.store {
            Store::Memory(values) => values.resize(self.count * self.texels, 0.0),
            Store::File(file) => {
                file.set_len(4 * (self.count * self.texels) as u64).map_err(|e| self.room.error(e))?;
            }
        }
        Ok(())
    }

    /// Adds all of `others`, which are kept in the same way.
    pub(crate) fn append(&mut self, others: &Self) -> Result<()> {
        let (mut buffer, start) = (Vec::new(), self.count);
        if let (Store::Memory(all), Store::Memory(more)) = (&mut self.store, &others.store) {
            all.extend_from_slice(more);
            self.count += others.count;
            return Ok(());
        }
        self.grow(others.count)?;
        for band in others.bands(1, others.count) {
            let values = others.read(0..others.count, band.clone(), &mut buffer)?;
            self.write(start, band, values)?;
        }
        Ok(())
    }

    /// Runs of texels, which begin at multiples of `unit`, so short that there is room for `floats` numbers a texel; all texels,
    /// where they are in memory.
    pub(crate) fn bands(&self, unit: usize, floats: usize) -> Vec<Range<usize>> {
        if self.in_memory() {
            return std::iter::once(0..self.texels).collect();
        }
        let length = (self.room.bytes.min(MOST_BAND) / (4 * floats.max(1)) / unit).max(1) * unit;
        (0..self.texels).step_by(length).map(|start| start..(start + length).min(self.texels)).collect()
    }

    /// The values of a band of some of the planes, one plane after the other. Of planes in memory, the band is all texels.
    pub(crate) fn read<'a>(
        &'a self,
        planes: Range<usize>,
        band: Range<usize>,
        buffer: &'a mut Vec<f32>,
    ) -> Result<&'a [f32]> {
        match &self.store {
            Store::Memory(values) if band == (0..self.texels) => {
                Ok(&values[planes.start * self.texels..planes.end * self.texels])
            }
            _ => {
                buffer.resize(planes.len() * band.len(), 0.0);
                let parts = buffer.chunks_mut(band.len().max(1));
                planes.zip(parts).try_for_each(|(plane, part)| self.read_run(plane, band.start, part))?;
                Ok(buffer)
            }
        }
    }

    /// Values of one plane from texel `start` on.
    pub(crate) fn read_run(&self, plane: usize, start: usize, out: &mut [f32]) -> Result<()> {
        let at = plane * self.texels + start;
        match &self.store {
            Store::Memory(values) => out.copy_from_slice(&values[at..at + out.len()]),
            Store::File(file) => {
                let mut file = file;
                let read = file
                    .seek(SeekFrom::Start(4 * at as u64))
                    .and_then(|_| file.read_exact(bytemuck::cast_slice_mut(out)));
                read.map_err(|e| self.room.error(e))?;
            }
        }
        Ok(())
    }

    /// Puts the values of a band of planes, one after the other, into those from `plane` on.
    pub(crate) fn write(&mut self, plane: usize, band: Range<usize>, values: &[f32]) -> Result<()> {
        let mut parts = values.chunks(band.len().max(1)).enumerate();
        parts.try_for_each(|(i, part)| self.write_run(plane + i, band.start, part))
    }

    /// Puts values into one plane, from texel `start` on.
    pub(crate) fn write_run(&mut self, plane: usize, start: usize, values: &[f32]) -> Result<()> {
        let at = plane * self.texels + start;
        match &mut self.store {
            Store::Memory(all) => all[at..at + values.len()].copy_from_slice(values),
            Store::File(file) => {
                let bytes = bytemuck::cast_slice(values);
                let written = file.seek(SeekFrom::Start(4 * at as u64)).and_then(|_| file.write_all(bytes));
                written.map_err(|e| self.room.error(e))?;
            }
        }
        Ok(())
    }

    /// Lets `change` change the values of a band of all planes, one after the other. Of planes in memory, the band is all texels.
    pub(crate) fn edit(
        &mut self,
        band: Range<usize>,
        buffer: &mut Vec<f32>,
        change: impl FnOnce(&mut [f32]) -> Result<()>,
    ) -> Result<()> {
        if let Store::Memory(values) = &mut self.store {
            return change(values);
        }
        self.read(0..self.count, band.clone(), buffer)?;
        change(buffer)?;
        self.write(0, band, buffer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_hold_what_memory_holds() {
        let dir = tempfile::tempdir().unwrap();
        let make = |bytes: usize| {
            let mut planes = Room::new(bytes, dir.path().to_owned()).planes(1000, 3).unwrap();
            planes.grow(3).unwrap();
            let mut buffer = Vec::new();
            for band in planes.bands(7, 3) {
                let start = band.start;
                let n = band.len();
                planes
                    .edit(band, &mut buffer, |values| {
                        assert!(values.iter().all(|v| *v == 0.0));
                        values.iter_mut().enumerate().for_each(|(i, v)| *v = (i / n * 1000 + start + i % n) as f32);
                        Ok(())
                    })
                    .unwrap();
            }
            let mut more = planes.empty_like(1).unwrap();
            more.grow(1).unwrap();
            more.write(0, 10..12, &[5.0, 6.0]).unwrap();
            planes.append(&more).unwrap();
            planes
        };
        let (memory, file) = (make(usize::MAX), make(200));
        assert!(memory.in_memory() && !file.in_memory() && memory.bands(7, 3).len() == 1);
        let bands = file.bands(7, 3);
        assert!(bands.len() > 50 && bands.iter().all(|b| b.start % 7 == 0 && b.len() <= 200 / 12));
        let all = |planes: &Planes| planes.read(0..4, 0..1000, &mut Vec::new()).unwrap().to_vec();
        assert_eq!(all(&memory), all(&file));
        assert_eq!(all(&file)[2003..2005], [2003.0, 2004.0]);
        assert_eq!(all(&file)[3009..3013], [0.0, 5.0, 6.0, 0.0]);
        // Nothing of them has a name.
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_folder_that_is_not_there_is_named() {
        let error = Room::new(0, "no/where".into()).planes(10, 1).unwrap_err().to_string();
        assert!(error.starts_with("no/where: a temporary file for planes"), "{error}");
    }
}
