//! Outputs appear whole or not at all: written under a temporary name in the same folder, then renamed.

use crate::{Error, Result};
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Calls `fill` with a buffered temporary file beside `path` and renames it to `path` when `fill` succeeded.
///
/// # Errors
/// Whatever `fill` returns, or [`Error::Io`]; in both cases nothing is left behind and an older `path` stays as it was.
pub fn write<E: From<Error>>(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<&mut File>) -> std::result::Result<(), E>,
) -> std::result::Result<(), E> {
    let mut temporary = temporary_beside(path).map_err(|e| Error::io(path, e))?;
    let mut buffered = BufWriter::new(temporary.as_file_mut());
    fill(&mut buffered)?;
    buffered.flush().map_err(|e| Error::io(path, e))?;
    drop(buffered);
    set_default_permissions(temporary.as_file());
    temporary.persist(path).map_err(|e| Error::io(path, e.error))?;
    Ok(())
}

/// [`write()`] for bytes that are already there.
///
/// # Errors
/// [`Error::Io`].
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    write(path, |f| f.write_all(bytes).map_err(|e| Error::io(path, e)))
}

/// Whether [`write()`] could write `path`, for long work that would be lost otherwise.
///
/// # Errors
/// [`Error::Io`].
pub fn check_writable(path: &Path) -> Result<()> {
    if path.is_dir() {
        return Err(Error::io(path, io::ErrorKind::IsADirectory.into()));
    }
    // The message of the temporary file names a path that nobody knows.
    temporary_beside(path).map(drop).map_err(|e| Error::io(path, e.kind().into()))
}

fn temporary_beside(path: &Path) -> io::Result<tempfile::NamedTempFile> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    tempfile::Builder::new().prefix(".translume-").suffix(".tmp").tempfile_in(folder)
}

/// Temporary files are private to their owner; results are not.
#[cfg(unix)]
fn set_default_permissions(file: &File) {
    use std::os::unix::fs::PermissionsExt;
    // A failure leaves a readable-by-owner file, which is no reason to lose the result.
    let _ = file.set_permissions(std::fs::Permissions::from_mode(0o644));
}

#[cfg(not(unix))]
fn set_default_permissions(_: &File) {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_keeps_the_old_file_and_leaves_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a b.txt");
        write_bytes(&path, b"old").unwrap();
        let failed: Result<()> = write(&path, |f| {
            f.write_all(b"half").unwrap();
            Err(Error::Mismatch("no".into()))
        });
        assert!(failed.is_err());
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_cannot_be_written_is_known_before() {
        let dir = tempfile::tempdir().unwrap();
        check_writable(&dir.path().join("new.txt")).unwrap();
        assert!(check_writable(dir.path()).is_err());
        let error = check_writable(&dir.path().join("gone").join("new.txt")).unwrap_err().to_string();
        assert!(error.contains("new.txt") && !error.contains(".translume-"), "{error}");
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }
}
