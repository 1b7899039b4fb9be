//! Outputs appear whole or not at all: written under a temporary name in the same folder, then renamed.

use crate::{Error, Result};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

/// Calls `fill` with a buffered temporary file beside `path` and renames it to `path` when `fill` succeeded.
///
/// # Errors
/// Whatever `fill` returns, or [`Error::Io`]; in both cases nothing is left behind and an older `path` stays as it was.
pub fn write<E: From<Error>>(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<&mut File>) -> std::result::Result<(), E>,
) -> std::result::Result<(), E> {
    let folder = match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p,
        _ => Path::new("."),
    };
    let mut temporary = tempfile::Builder::new()
        .prefix(".translume-")
        .suffix(".tmp")
        .tempfile_in(folder)
        .map_err(|e| Error::io(path, e))?;
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
}
