//! Temporaries: those of this process, to be removed when it is told to end, and those that a killed one left.
//!
//! A temporary is locked while its process lives, so whoever can lock an old one may remove it.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// End of a temporary's name.
pub(super) const SUFFIX: &str = ".tmp";
/// Younger temporaries may be on their way to their lock.
const MIN_AGE: Duration = Duration::from_secs(60);
/// Longer names are cut, for file systems that end at 255 bytes.
const MAX_NAME: usize = 100;

static LIVE: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn live() -> MutexGuard<'static, Vec<PathBuf>> {
    LIVE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A temporary file or folder that [`clean_up`] removes.
pub(super) struct Live(PathBuf);

impl Live {
    pub(super) fn new(path: &Path) -> Self {
        live().push(path.to_owned());
        Self(path.to_owned())
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        live().retain(|p| *p != self.0);
    }
}

/// Removes the temporaries of this process, which must end afterwards: a thread that writes still gets no new ones.
pub fn clean_up() {
    let live = live();
    for path in live.iter() {
        // Threads may go on to write into a folder for a moment.
        for _ in 0..10 {
            let gone = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
            if gone.is_ok() || !path.exists() {
                break;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
    }
    std::mem::forget(live);
}

/// Beginning of the names of temporaries of the output `path`.
pub(super) fn prefix(path: &Path) -> String {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let cut = (0..=MAX_NAME.min(name.len())).rev().find(|&i| name.is_char_boundary(i)).unwrap_or(0);
    format!(".translume-{}-", &name[..cut])
}

/// Marks a temporary as alive; file systems without locks do without.
pub(super) fn lock(file: &File) {
    let _ = file.try_lock();
}

/// Name of the file that holds the lock of a temporary folder.
pub(super) const LOCK: &str = "lock";

/// Removes what killed runs left of the output `path`.
pub(super) fn sweep(path: &Path) {
    let prefix = prefix(path);
    let Ok(entries) = std::fs::read_dir(super::folder_of(path)) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        if name.to_str().is_some_and(|n| n.starts_with(&prefix) && n.ends_with(SUFFIX)) {
            remove_if_dead(&entry.path(), path);
        }
    }
}

fn remove_if_dead(temporary: &Path, output: &Path) {
    let Ok(there) = std::fs::symlink_metadata(temporary) else { return };
    let old = there.modified().ok().and_then(|t| t.elapsed().ok()).is_some_and(|age| age > MIN_AGE);
    let lock = if there.is_dir() { temporary.join(LOCK) } else { temporary.to_owned() };
    // Without a lock file the folder is none of ours.
    let dead = old && File::options().write(true).open(lock).is_ok_and(|f| f.try_lock().is_ok());
    let gone = match (dead, there.is_dir()) {
        (false, _) => return,
        (true, true) => std::fs::remove_dir_all(temporary),
        (true, false) => std::fs::remove_file(temporary),
    };
    if gone.is_ok() {
        log::info!("{}: removed what an interrupted run had left of it", output.display());
    }
}
