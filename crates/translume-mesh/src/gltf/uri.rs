//! URIs: data in the file itself, and files beside it.

use super::Asset;
use crate::error::{Error, Result};
use base64::Engine;
use std::path::{Path, PathBuf};

/// Whether the URI holds its data itself. Schemes have no case (RFC 3986, §3.1).
pub fn is_data(uri: &str) -> bool {
    starts_with(uri, "data:")
}

impl Asset {
    /// The bytes behind a URI: data, or a file beside this one.
    ///
    /// # Errors
    /// [`Error::Invalid`] for damaged base64, those of [`Asset::file`], [`Error::Io`].
    pub fn resolve(&self, uri: &str) -> Result<Vec<u8>> {
        if !is_data(uri) {
            let file = self.file(uri)?;
            return crate::loaded::bytes_of(&file);
        }
        let Some((kind, data)) = uri["data:".len()..].split_once(',') else {
            return Err(Error::invalid(&self.path, "a data URI without data"));
        };
        // Its words are in ABNF (RFC 2397, §3), which knows no case.
        let encoding = kind.len().checked_sub(";base64".len()).and_then(|at| kind.get(at..));
        if !encoding.is_some_and(|e| e.eq_ignore_ascii_case(";base64")) {
            return Ok(percent_decoded(data));
        }
        let engine = base64::engine::GeneralPurpose::new(
            &base64::alphabet::STANDARD,
            base64::engine::GeneralPurposeConfig::new()
                .with_decode_padding_mode(base64::engine::DecodePaddingMode::Indifferent),
        );
        engine.decode(data).map_err(|e| Error::invalid(&self.path, format!("data URI: {e}")))
    }

    /// The file a relative URI names: in the folder of this one or in one of its roots, symbolic links followed.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for other schemes and absolute paths, [`Error::Outside`].
    pub fn file(&self, uri: &str) -> Result<PathBuf> {
        let name = String::from_utf8_lossy(&percent_decoded(uri)).into_owned();
        if uri.contains("://") || Path::new(&name).is_absolute() {
            return Err(Error::unsupported(&self.path, format!("URI {uri:?}: only files beside this one are read")));
        }
        let folder = self.path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let file = self.path.parent().unwrap_or(Path::new("")).join(name);
        // Of what cannot be found, opening tells why.
        let Ok(real) = file.canonicalize() else { return Ok(file) };
        let mut allowed = std::iter::once(folder).chain(self.roots.iter().map(PathBuf::as_path));
        match allowed.any(|root| root.canonicalize().is_ok_and(|root| real.starts_with(root))) {
            true => Ok(file),
            false => Err(Error::Outside { path: self.path.clone(), file }),
        }
    }
}

fn starts_with(text: &str, start: &str) -> bool {
    text.get(..start.len()).is_some_and(|head| head.eq_ignore_ascii_case(start))
}

fn percent_decoded(uri: &str) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let [first, tail @ ..] = rest {
        let hex = |b: u8| (b as char).to_digit(16);
        match (first, tail) {
            (b'%', [a, b, after @ ..]) if hex(*a).is_some() && hex(*b).is_some() => {
                bytes.push((hex(*a).unwrap_or(0) * 16 + hex(*b).unwrap_or(0)) as u8);
                rest = after;
            }
            _ => {
                bytes.push(*first);
                rest = tail;
            }
        }
    }
    bytes
}
