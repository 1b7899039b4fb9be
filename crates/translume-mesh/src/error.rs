//! One error type: the file it concerns and what is wrong with it; I/O, invalid and unsupported told apart.

use std::path::{Path, PathBuf};

/// What can go wrong with a mesh file.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
    },
    /// The file is damaged, truncated or contradicts itself.
    #[error("{}: {what}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong, with the line or element where there is one.
        what: String,
    },
    /// The file is sound, but this program does not read such a one.
    #[error("{}: {what}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What is not supported, and what to do.
        what: String,
    },
    /// The file names another where none is read unless the user says so.
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

impl Error {
    /// An [`Error::Io`] at `path`.
    pub fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), source }
    }

    /// An [`Error::Invalid`] at `path`.
    pub fn invalid(path: &Path, what: impl Into<String>) -> Self {
        Self::Invalid { path: path.to_owned(), what: what.into() }
    }

    /// An [`Error::Unsupported`] at `path`.
    pub fn unsupported(path: &Path, what: impl Into<String>) -> Self {
        Self::Unsupported { path: path.to_owned(), what: what.into() }
    }
}

/// A parser's complaint before the file's name is known.
#[derive(Debug)]
pub(crate) enum Fault {
    /// See [`Error::Invalid`].
    Invalid(String),
    /// See [`Error::Unsupported`].
    Unsupported(String),
}

impl Fault {
    pub(crate) fn at(self, path: &Path) -> Error {
        match self {
            Self::Invalid(what) => Error::invalid(path, what),
            Self::Unsupported(what) => Error::unsupported(path, what),
        }
    }
}

/// Shorthand for [`Fault::Invalid`].
pub(crate) fn invalid<T>(what: impl Into<String>) -> std::result::Result<T, Fault> {
    Err(Fault::Invalid(what.into()))
}
