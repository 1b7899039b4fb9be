//! One error type: the file it concerns and what is wrong with it, I/O, invalid and unsupported told apart.

use std::path::{Path, PathBuf};

/// What can go wrong with a picture file.
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
        /// What is wrong, and what to do.
        what: String,
    },
    /// The file is sound, but this program does not read (or write) such a one.
    #[error("{}: {what}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What is not supported, and what to do.
        what: String,
    },
    /// An OpenEXR file without colour where it would be looked for, but with layers that can be asked for by name.
    #[error("{}: no R, G, B or Y among the channels {channels}; name one of its layers: {}", path.display(), layers.join(", "))]
    Layers {
        /// The file.
        path: PathBuf,
        /// Its channels, the first of them.
        channels: String,
        /// The layers.
        layers: Vec<String>,
    },
    /// Two pictures, or a picture and an option, do not go together.
    #[error("{0}")]
    Mismatch(String),
}

/// Result with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// An [`Error::Io`] at `path`.
    pub fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), source }
    }

    /// The same error, of a file below `to` in place of `from`: temporary names are nobody's business.
    pub(crate) fn moved(mut self, from: &Path, to: &Path) -> Self {
        if let Self::Io { path, .. } | Self::Invalid { path, .. } | Self::Unsupported { path, .. } = &mut self
            && let Ok(rest) = path.strip_prefix(from)
        {
            *path = if rest.as_os_str().is_empty() { to.to_owned() } else { to.join(rest) };
        }
        self
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
