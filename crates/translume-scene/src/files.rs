//! The files that a scene is read from: plain ones only, and all of them known afterwards, so that an output can stay away
//! from what was read.

use crate::{Error, Result};
use std::cell::RefCell;
use std::path::{Path, PathBuf};

thread_local! {
    /// What the scene being loaded by this thread has read so far.
    static READ: RefCell<Vec<PathBuf>> = const { RefCell::new(Vec::new()) };
}

/// Calls `load` and returns the files that it read, each once.
pub(crate) fn recorded<T>(load: impl FnOnce() -> T) -> (T, Vec<PathBuf>) {
    READ.with_borrow_mut(Vec::clear);
    let loaded = load();
    let mut files = READ.with_borrow_mut(std::mem::take);
    files.sort();
    files.dedup();
    (loaded, files)
}

/// Remembers a file that something else reads.
pub(crate) fn note(path: &Path) {
    READ.with_borrow_mut(|read| read.push(path.to_owned()));
}

/// The whole file. A pipe or a device, which may never end, is refused before it is opened.
///
/// # Errors
/// [`Error::Io`]; [`Error::Unsupported`] for what is no plain file.
pub(crate) fn bytes(path: &Path) -> Result<Vec<u8>> {
    check(path)?;
    note(path);
    std::fs::read(path).map_err(|e| Error::io(path, e))
}

/// Whether `path` is a plain file.
///
/// # Errors
/// As [`bytes`].
pub(crate) fn check(path: &Path) -> Result<()> {
    let there = std::fs::metadata(path).map_err(|e| Error::io(path, e))?;
    match there.is_file() || there.is_dir() {
        true => Ok(()), // of a folder, opening says what is wrong
        false => Err(Error::unsupported(path, None, "it is not a plain file but a pipe or a device")),
    }
}
