//! What stands under an output's name, and how it is written therefore.

use crate::{Error, Result};
use std::ffi::OsStr;
use std::fs::{File, FileType, Metadata};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Where an output goes.
#[derive(Debug, PartialEq, Eq)]
pub enum Place {
    /// A plain file, there or not yet: written beside and renamed. Symbolic links at the end of the name are followed.
    File(PathBuf),
    /// What cannot be replaced, only written into.
    Stream(Stream),
}

/// An output without an end that could be cut off or a name that could be replaced.
#[derive(Debug, PartialEq, Eq)]
pub enum Stream {
    /// Standard output, under one of its names (`/dev/stdout`).
    Stdout,
    /// A pipe, `/dev/null`, or a file that is open already (`/dev/fd/3`).
    Path(PathBuf),
}

impl Stream {
    /// Sends the rest of `content`.
    pub(super) fn send(&self, content: &mut File) -> io::Result<()> {
        match self {
            Self::Stdout => {
                let mut out = io::stdout().lock();
                io::copy(content, &mut out).and_then(|_| out.flush())
            }
            Self::Path(path) => io::copy(content, &mut File::options().write(true).open(path)?).map(drop),
        }
    }
}

/// More symbolic links in a row are a circle.
const MAX_LINKS: usize = 40;

/// Where `path` as an output goes.
///
/// # Errors
/// [`Error::Io`]: a folder (also a name that ends as one), a device, a socket, a file that must not be written, links in a
/// circle.
pub fn place(path: &Path) -> Result<Place> {
    let refuse = |kind, what: &str| Err(Error::io(path, io::Error::new(kind, what)));
    let folder = "it names a folder; give the name of a file";
    let mut at = path.to_owned();
    for _ in 0..MAX_LINKS {
        if let Some(stream) = opened(&at) {
            return Ok(Place::Stream(stream));
        }
        let there = match std::fs::symlink_metadata(&at) {
            Ok(there) => there,
            Err(e) if e.kind() == io::ErrorKind::NotFound => {
                return match (ends_as_folder(path), super::folder_of(&at).is_dir()) {
                    (true, _) => refuse(io::ErrorKind::IsADirectory, folder),
                    (_, false) => refuse(io::ErrorKind::NotFound, "its folder does not exist"),
                    _ => Ok(Place::File(at)),
                };
            }
            Err(e) => return Err(Error::io(path, e)),
        };
        let kind = there.file_type();
        if kind.is_symlink() {
            let target = std::fs::read_link(&at).map_err(|e| Error::io(path, e))?;
            at = super::folder_of(&at).join(target);
        } else if kind.is_dir() {
            return refuse(io::ErrorKind::IsADirectory, folder);
        } else if kind.is_file() {
            // A file without the right to write stays, although its folder would let us replace it.
            return match File::options().write(true).open(&at) {
                Ok(_) => Ok(Place::File(at)),
                Err(e) => Err(Error::io(path, e)),
            };
        } else if takes_a_stream(&kind, &there) {
            return Ok(Place::Stream(Stream::Path(at)));
        } else {
            return refuse(io::ErrorKind::InvalidInput, "it is a device or a socket; give the name of a file");
        }
    }
    refuse(io::ErrorKind::InvalidInput, "symbolic links in a circle")
}

/// Whether `path` as an output is streamed into: a name that tells no format.
pub fn is_stream(path: &Path) -> bool {
    matches!(place(path), Ok(Place::Stream(_)))
}

/// Whether `path` is written as a folder's name is: `out/`.
pub fn ends_as_folder(path: &Path) -> bool {
    path.as_os_str().as_encoded_bytes().last().is_some_and(|&b| std::path::is_separator(char::from(b)))
}

/// Files that this process has open, by their names in the file system.
fn opened(path: &Path) -> Option<Stream> {
    if cfg!(not(unix)) {
        return None;
    }
    match path.to_str()? {
        "/dev/stdout" | "/dev/fd/1" | "/proc/self/fd/1" => Some(Stream::Stdout),
        "/dev/stderr" => Some(Stream::Path(path.to_owned())),
        name if name.starts_with("/dev/fd/") || name.starts_with("/proc/self/fd/") => {
            Some(Stream::Path(path.to_owned()))
        }
        _ => None,
    }
}

#[cfg(unix)]
fn takes_a_stream(kind: &FileType, there: &Metadata) -> bool {
    use std::os::unix::fs::{FileTypeExt, MetadataExt};
    // The one device that is meant: whoever names it wants no file.
    let null = || std::fs::metadata("/dev/null").is_ok_and(|null| null.rdev() == there.rdev());
    kind.is_fifo() || kind.is_char_device() && null()
}

#[cfg(not(unix))]
fn takes_a_stream(_: &FileType, _: &Metadata) -> bool {
    false
}

/// What a plain file or folder is by, whatever name it is called: links, hard links and other spellings have the same.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct FileId(Identity);

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Identity {
    #[cfg(unix)]
    There { device: u64, inode: u64 },
    #[cfg(not(unix))]
    There(PathBuf),
    /// Not there yet: the one spelling of its folder, and its name.
    ToBe(PathBuf, Box<OsStr>),
}

impl FileId {
    /// Of a name; `None` for devices, pipes and what cannot be.
    pub fn of(path: &Path) -> Option<Self> {
        match std::fs::metadata(path) {
            Ok(there) => (there.is_file() || there.is_dir()).then(|| there_id(path, &there))?,
            Err(_) => {
                let Place::File(path) = place(path).ok()? else { return None };
                let folder = std::fs::canonicalize(super::folder_of(&path)).ok()?;
                Some(Self(Identity::ToBe(folder, path.file_name()?.into())))
            }
        }
    }
}

#[cfg(unix)]
fn there_id(_: &Path, there: &Metadata) -> Option<FileId> {
    use std::os::unix::fs::MetadataExt;
    Some(FileId(Identity::There { device: there.dev(), inode: there.ino() }))
}

#[cfg(not(unix))]
fn there_id(path: &Path, _: &Metadata) -> Option<FileId> {
    Some(FileId(Identity::There(std::fs::canonicalize(path).ok()?)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_file_has_many_names() {
        let dir = tempfile::tempdir().unwrap();
        let (a, b) = (dir.path().join("a"), dir.path().join("b"));
        let odd = dir.path().join(".").join("a");
        let same_file = |a: &Path, b: &Path| FileId::of(a).unwrap() == FileId::of(b).unwrap();
        assert!(same_file(&a, &odd) && !same_file(&a, &b), "neither is there yet");
        std::fs::write(&a, "").unwrap();
        std::fs::hard_link(&a, &b).unwrap();
        assert!(same_file(&a, &odd) && same_file(&a, &b));
        std::fs::remove_file(&b).unwrap();
        std::fs::write(&b, "").unwrap();
        assert!(!same_file(&a, &b));
    }

    #[test]
    fn a_name_that_ends_in_a_slash_is_a_folder() {
        let dir = tempfile::tempdir().unwrap();
        let error = place(&dir.path().join("new").join("")).unwrap_err().to_string();
        assert!(error.contains("folder"), "{error}");
        assert!(place(&dir.path().join("new")).is_ok());
    }

    #[cfg(unix)]
    #[test]
    fn links_in_a_circle_end() {
        let dir = tempfile::tempdir().unwrap();
        let (a, b) = (dir.path().join("a"), dir.path().join("b"));
        std::os::unix::fs::symlink(&a, &b).unwrap();
        std::os::unix::fs::symlink(&b, &a).unwrap();
        assert!(place(&a).unwrap_err().to_string().contains("circle"));
    }
}
