//! Outputs appear whole or not at all: written under a temporary name in the same folder, then renamed.
//!
//! What stands under the name decides how it is written ([`place()`]): a plain file is replaced and keeps its mode, of a
//! symbolic link the target is; a pipe, standard output or `/dev/null` is streamed into once the content is whole; folders,
//! devices and sockets are refused. Temporaries are known to [`clean_up`], which a program that is told to end calls, and
//! those that a killed run left are removed by the next write of the same output.

mod folder;
mod leftovers;
mod place;

pub use folder::{link, write_folder};
pub use leftovers::clean_up;
pub use place::{FileId, Place, Stream, ends_as_folder, is_stream, place};

use crate::{Error, Result};
use leftovers::Live;
use std::fs::File;
use std::io::{self, BufWriter, Seek, Write};
use std::path::Path;

/// Calls `fill` with a buffered temporary file and puts it in the place of `path` when `fill` succeeded.
///
/// # Errors
/// Whatever `fill` returns, or [`Error::Io`]; in both cases nothing is left behind and an older `path` stays as it was.
pub fn write<E: From<Error>>(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<&mut File>) -> std::result::Result<(), E>,
) -> std::result::Result<(), E> {
    let io = |e: io::Error| Error::io(path, without_name(e));
    match place(path)? {
        Place::File(file) => {
            leftovers::sweep(&file);
            let (mut temporary, _live) = temporary_beside(&file).map_err(io)?;
            fill_buffered(temporary.as_file_mut(), path, fill)?;
            keep_rights(temporary.as_file(), &file);
            // Else a crash of the machine soon after could leave an empty file under the name.
            temporary.as_file().sync_all().map_err(io)?;
            temporary.persist(&file).map_err(|e| io(e.error))?;
        }
        Place::Stream(stream) => {
            // Formats that seek are written to a spool; and a failure half-way sends nothing.
            let mut spool = tempfile::tempfile().map_err(io)?;
            fill_buffered(&mut spool, path, fill)?;
            spool.rewind().and_then(|()| stream.send(&mut spool)).map_err(io)?;
        }
    }
    Ok(())
}

fn fill_buffered<E: From<Error>>(
    file: &mut File,
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<&mut File>) -> std::result::Result<(), E>,
) -> std::result::Result<(), E> {
    let mut buffered = BufWriter::new(file);
    fill(&mut buffered)?;
    Ok(buffered.flush().map_err(|e| Error::io(path, e))?)
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
    match place(path)? {
        Place::File(file) => temporary_beside(&file).map(drop).map_err(|e| Error::io(path, without_name(e))),
        Place::Stream(_) => Ok(()),
    }
}

fn temporary_beside(path: &Path) -> io::Result<(tempfile::NamedTempFile, Live)> {
    let prefix = leftovers::prefix(path);
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(leftovers::SUFFIX);
    // Results are for whom the umask lets read them, not for their owner alone as temporary files are.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let file = builder.tempfile_in(folder_of(path))?;
    leftovers::lock(file.as_file());
    let live = Live::new(file.path());
    Ok((file, live))
}

/// The folder that `path` is in.
pub(crate) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Gives a temporary the mode of the file that it will replace, and its owner where that is allowed.
fn keep_rights(temporary: &File, replaced: &Path) {
    let Ok(old) = std::fs::metadata(replaced) else { return };
    // A failure leaves a file with the rights of a new one, which is no reason to lose the result.
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let _ = std::os::unix::fs::fchown(temporary, Some(old.uid()), Some(old.gid()));
    }
    let _ = temporary.set_permissions(old.permissions());
}

/// The system's answer without the temporary's name, which nobody knows.
fn without_name(error: io::Error) -> io::Error {
    if error.raw_os_error().is_some() { error } else { error.kind().into() }
}

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

    #[cfg(unix)]
    #[test]
    fn mode_of_the_old_file_stays_and_links_are_followed() {
        use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
        let dir = tempfile::tempdir().unwrap();
        let (file, link, dangling) = (dir.path().join("f"), dir.path().join("l"), dir.path().join("d"));
        write_bytes(&file, b"1").unwrap();
        std::fs::set_permissions(&file, PermissionsExt::from_mode(0o600)).unwrap();
        symlink("f", &link).unwrap();
        write_bytes(&link, b"2").unwrap();
        assert_eq!(std::fs::read(&file).unwrap(), b"2");
        assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(std::fs::metadata(&file).unwrap().mode() & 0o777, 0o600);
        // A link to what is not there yet makes it.
        symlink("new", &dangling).unwrap();
        write_bytes(&dangling, b"3").unwrap();
        assert_eq!(std::fs::read(dir.path().join("new")).unwrap(), b"3");
        assert!(std::fs::symlink_metadata(&dangling).unwrap().is_symlink());
    }

    #[cfg(unix)]
    #[test]
    fn new_files_have_the_mode_that_the_umask_leaves() {
        use std::os::unix::fs::MetadataExt;
        let dir = tempfile::tempdir().unwrap();
        let (ours, plain) = (dir.path().join("ours"), dir.path().join("plain"));
        write_bytes(&ours, b"").unwrap();
        std::fs::write(&plain, b"").unwrap();
        assert_eq!(std::fs::metadata(&ours).unwrap().mode(), std::fs::metadata(&plain).unwrap().mode());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn devices_stay_devices() {
        let null = Path::new("/dev/null");
        check_writable(null).unwrap();
        write_bytes(null, b"gone").unwrap();
        assert!(!std::fs::metadata(null).unwrap().is_file());
        let refused = check_writable(Path::new("/dev/zero")).unwrap_err().to_string();
        assert!(refused.contains("device"), "{refused}");
    }

    #[test]
    fn what_a_killed_run_left_is_swept_and_what_a_live_one_writes_is_not() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.exr");
        let (live, _guard) = temporary_beside(&path).unwrap();
        let stale = dir.path().join(format!("{}dead{}", leftovers::prefix(&path), leftovers::SUFFIX));
        let other =
            dir.path().join(format!("{}dead{}", leftovers::prefix(&dir.path().join("b.exr")), leftovers::SUFFIX));
        let old = std::time::SystemTime::now() - std::time::Duration::from_secs(3600);
        for file in [&stale, &other] {
            File::create(file).unwrap().set_modified(old).unwrap();
        }
        live.as_file().set_modified(old).unwrap();
        write_bytes(&path, b"new").unwrap();
        assert!(!stale.exists() && other.exists() && live.path().exists() && path.exists());
    }
}
