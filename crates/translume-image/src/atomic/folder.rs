//! Folders as outputs: written beside, then exchanged with the older one, of which nothing is lost but its own files.

use super::leftovers::{self, LOCK, Live};
use super::{folder_of, without_name};
use crate::{Error, Result};
use std::ffi::OsStr;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// Calls `fill` with an empty folder and puts it in the place of `path` when `fill` succeeded. Of an older folder what
/// `own` says to be a file or folder of this kind of output (by its name) is removed; everything else stays.
///
/// # Errors
/// Whatever `fill` returns, as if it had worked in `path`, or [`Error::Io`]; in both cases nothing is left behind and an
/// older folder stays as it was.
pub fn write_folder<T>(path: &Path, own: impl Fn(&str) -> bool, fill: impl FnOnce(&Path) -> Result<T>) -> Result<T> {
    let io = |e: io::Error| Error::io(path, without_name(e));
    let target = folder_place(path)?;
    leftovers::sweep(&target);
    let around = tempfile::Builder::new()
        .prefix(&leftovers::prefix(&target))
        .suffix(leftovers::SUFFIX)
        .tempdir_in(folder_of(&target))
        .map_err(io)?;
    let _live = Live::new(around.path());
    let lock = File::create(around.path().join(LOCK)).map_err(io)?;
    leftovers::lock(&lock);
    let new = around.path().join("new");
    std::fs::create_dir(&new).map_err(io)?;
    let made = fill(&new).map_err(|e| e.moved(&new, path))?;
    if target.exists() {
        // As links, so that there is no moment at which they are in neither folder.
        keep_foreign(&target, &new, &own).map_err(io)?;
        exchange(&new, &target, &around.path().join("old")).map_err(io)?;
    } else {
        std::fs::rename(&new, &target).map_err(io)?;
    }
    Ok(made)
}

/// The folder that `path` means as an output, links followed.
fn folder_place(path: &Path) -> Result<PathBuf> {
    match std::fs::metadata(path) {
        Ok(there) if there.is_dir() => std::fs::canonicalize(path).map_err(|e| Error::io(path, e)),
        Ok(_) => Err(Error::io(path, io::ErrorKind::NotADirectory.into())),
        Err(e) if e.kind() == io::ErrorKind::NotFound && !path.is_symlink() => {
            // `out/` and `out` are one name here.
            let name = path.file_name().ok_or_else(|| Error::io(path, io::ErrorKind::InvalidInput.into()))?;
            Ok(folder_of(path).join(name))
        }
        Err(e) => Err(Error::io(path, e)),
    }
}

fn keep_foreign(old: &Path, new: &Path, own: &impl Fn(&str) -> bool) -> io::Result<()> {
    for entry in std::fs::read_dir(old)? {
        let name = entry?.file_name();
        if !name.to_str().is_some_and(own) && !new.join(&name).exists() {
            link(&old.join(&name), &new.join(&name))?;
        }
    }
    std::fs::set_permissions(new, std::fs::metadata(old)?.permissions())
}

/// `to` becomes a second name of what `from` is, or a copy where that cannot be; folders with all that is in them.
///
/// # Errors
/// The system's.
pub fn link(from: &Path, to: &Path) -> io::Result<()> {
    if std::fs::symlink_metadata(from)?.is_dir() {
        std::fs::create_dir(to)?;
        for entry in std::fs::read_dir(from)? {
            let name: &OsStr = &entry?.file_name();
            link(&from.join(name), &to.join(name))?;
        }
        return Ok(());
    }
    std::fs::hard_link(from, to).or_else(|_| std::fs::copy(from, to).map(drop))
}

/// Puts `new` in the place of `target`, whose older content comes to be below `new` or `old`.
fn exchange(new: &Path, target: &Path, old: &Path) -> io::Result<()> {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{CWD, RenameFlags, renameat_with};
        if renameat_with(CWD, new, CWD, target, RenameFlags::EXCHANGE).is_ok() {
            return Ok(());
        }
    }
    // Not every file system can do it at once.
    std::fs::rename(target, old)?;
    std::fs::rename(new, target).inspect_err(|_| {
        let _ = std::fs::rename(old, target);
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fill(text: &'static str) -> impl FnOnce(&Path) -> Result<()> {
        move |dir| std::fs::write(dir.join("model.json"), text).map_err(|e| Error::io(dir, e))
    }

    #[test]
    fn an_older_folder_loses_its_own_files_only() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("model");
        let own = |name: &str| name == "model.json" || name.starts_with("texture");
        write_folder(&path, own, fill("1")).unwrap();
        std::fs::write(path.join("texture-3.exr"), "").unwrap();
        std::fs::write(path.join("notes.txt"), "mine").unwrap();
        std::fs::create_dir(path.join("sketches")).unwrap();
        std::fs::write(path.join("sketches").join("a"), "too").unwrap();
        write_folder(&path, own, fill("2")).unwrap();
        assert_eq!(std::fs::read_to_string(path.join("model.json")).unwrap(), "2");
        assert_eq!(std::fs::read_to_string(path.join("notes.txt")).unwrap(), "mine");
        assert_eq!(std::fs::read_to_string(path.join("sketches").join("a")).unwrap(), "too");
        assert!(!path.join("texture-3.exr").exists());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "nothing is left beside");
    }

    #[test]
    fn a_failure_changes_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("model");
        write_folder(&path, |_| true, fill("1")).unwrap();
        let failed: Result<()> = write_folder(
            &path,
            |_| true,
            |new| {
                std::fs::write(new.join("half"), "").unwrap();
                Err(Error::Mismatch("no".into()))
            },
        );
        assert!(failed.is_err());
        assert_eq!(std::fs::read_to_string(path.join("model.json")).unwrap(), "1");
        assert!(!path.join("half").exists());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }
}
