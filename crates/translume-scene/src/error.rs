//! One error type: the file it concerns, the line where there is one, and what is wrong; I/O, invalid and unsupported
//! told apart.

use std::path::{Path, PathBuf};

/// What can go wrong with a scene file.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system refused.
    #[error("{}: {source}", place(path, *line))]
    Io {
        /// The file that asked: the scene file, or the one that cannot be opened.
        path: PathBuf,
        /// Line in it.
        line: Option<u32>,
        /// The system's answer.
        source: std::io::Error,
    },
    /// The file is damaged, truncated or contradicts itself.
    #[error("{}: {what}", place(path, *line))]
    Invalid {
        /// The file.
        path: PathBuf,
        /// Line in it.
        line: Option<u32>,
        /// What is wrong.
        what: String,
    },
    /// The file is sound, but this program does not read such a one.
    #[error("{}: {what}", place(path, *line))]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// Line in it.
        line: Option<u32>,
        /// What is not supported, and what to do.
        what: String,
    },
    /// The file names another where none is read unless the user says so, see [`crate::LoadOptions::asset_roots`].
    #[error("{}: {} lies outside of its folder", path.display(), file.display())]
    Outside {
        /// The file.
        path: PathBuf,
        /// What it names.
        file: PathBuf,
    },
}

/// Result with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

/// `file:line`, or the file alone.
pub(crate) fn place(path: &Path, line: Option<u32>) -> String {
    match line {
        Some(line) => format!("{}:{line}", path.display()),
        None => path.display().to_string(),
    }
}

impl Error {
    /// An [`Error::Io`] about the file `path` itself.
    pub fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), line: None, source }
    }

    /// An [`Error::Invalid`] at `path`.
    pub fn invalid(path: &Path, line: impl Into<Option<u32>>, what: impl Into<String>) -> Self {
        Self::Invalid { path: path.to_owned(), line: line.into(), what: what.into() }
    }

    /// An [`Error::Unsupported`] at `path`.
    pub fn unsupported(path: &Path, line: impl Into<Option<u32>>, what: impl Into<String>) -> Self {
        Self::Unsupported { path: path.to_owned(), line: line.into(), what: what.into() }
    }
}

impl Error {
    /// The same about a file that the scene file names at `line`: who looks for the mistake starts there.
    pub(crate) fn at(self, path: &Path, line: u32) -> Self {
        let (named, line) = (path.to_owned(), Some(line));
        match self {
            Self::Io { path, source, .. } => {
                let what = format!("cannot read {}: {source}", path.display());
                Self::Io { path: named, line, source: std::io::Error::new(source.kind(), what) }
            }
            Self::Invalid { path, what, line: None } => {
                Self::Invalid { path: named, line, what: format!("{}: {what}", path.display()) }
            }
            Self::Unsupported { path, what, line: None } => {
                Self::Unsupported { path: named, line, what: format!("{}: {what}", path.display()) }
            }
            placed => placed,
        }
    }
}

impl Error {
    /// The same about an element of the file `path`.
    pub(crate) fn inside(self, path: &Path, element: &str) -> Self {
        let what = format!("{element}: {self}");
        match self {
            Self::Unsupported { .. } => Self::unsupported(path, None, what),
            Self::Io { source, .. } => {
                let source = std::io::Error::new(source.kind(), what);
                Self::io(path, source)
            }
            Self::Invalid { .. } => Self::invalid(path, None, what),
            outside @ Self::Outside { .. } => outside,
        }
    }
}

impl From<translume_mesh::Error> for Error {
    fn from(e: translume_mesh::Error) -> Self {
        match e {
            translume_mesh::Error::Io { path, source } => Self::Io { path, line: None, source },
            translume_mesh::Error::Invalid { path, what } => Self::Invalid { path, line: None, what },
            translume_mesh::Error::Unsupported { path, what } => Self::Unsupported { path, line: None, what },
            translume_mesh::Error::Outside { path, file } => Self::Outside { path, file },
        }
    }
}

impl From<translume_image::Error> for Error {
    fn from(e: translume_image::Error) -> Self {
        match e {
            translume_image::Error::Io { path, source } => Self::Io { path, line: None, source },
            translume_image::Error::Invalid { path, what } => Self::Invalid { path, line: None, what },
            translume_image::Error::Unsupported { path, what } => Self::Unsupported { path, line: None, what },
            translume_image::Error::Layers { ref path, .. } => {
                let (path, whole) = (path.clone(), e.to_string());
                let what = whole.strip_prefix(&format!("{}: ", path.display())).unwrap_or(&whole).to_owned();
                Self::Unsupported { path, line: None, what }
            }
            translume_image::Error::Mismatch(what) => Self::Invalid { path: PathBuf::new(), line: None, what },
        }
    }
}
