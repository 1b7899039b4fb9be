//! Outputs by the endings of their names: what is written is what the name says, or nothing.

use crate::cli::Usage;
use std::path::Path;
use translume_image::tonemap::Display;
use translume_image::{atomic, write_jpeg, write_png8, write_png16, write_tiff8, write_tiff16};

/// Format of a picture that is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Exr,
    Hdr,
    Pfm,
    Tiff,
    Png,
    Jpeg,
}

/// Quality of JPEG files: those are for a look.
const JPEG_QUALITY: u8 = 92;

impl Kind {
    /// The endings, the usual one first.
    const fn endings(self) -> &'static [&'static str] {
        match self {
            Self::Exr => &["exr"],
            Self::Hdr => &["hdr", "pic", "rgbe"],
            Self::Pfm => &["pfm"],
            Self::Tiff => &["tif", "tiff"],
            Self::Png => &["png"],
            Self::Jpeg => &["jpg", "jpeg"],
        }
    }

    /// The format that the name of `path` says, of those that `what` can be written in. Pipes and `/dev/null` say none and
    /// get the first.
    ///
    /// # Errors
    /// Names the endings.
    pub(crate) fn of(path: &Path, allowed: &[Self], what: &str) -> Result<Self, Usage> {
        if atomic::is_stream(path) {
            return Ok(allowed[0]);
        }
        let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        let found = allowed.iter().copied().find(|k| k.endings().contains(&ending.as_str()));
        found.ok_or_else(|| {
            let endings: Vec<&str> = allowed.iter().map(|k| k.endings()[0]).collect();
            Usage(ending_wanted(path, what, &endings))
        })
    }
}

/// The message for a name without one of `endings`.
fn ending_wanted(path: &Path, what: &str, endings: &[&str]) -> String {
    let endings: Vec<String> = endings.iter().map(|e| format!(".{e}")).collect();
    let list = match endings.split_last() {
        Some((last, [])) => last.clone(),
        Some((last, before)) => format!("{} or {last}", before.join(", ")),
        None => String::new(),
    };
    let hint = if what == "picture" && !endings.contains(&".png".to_owned()) { " (a preview may be .png)" } else { "" };
    format!("{}: the {what} must be named {list}, the format that it is written in{hint}", path.display())
}

/// Refuses a name that does not end in `.ending`; pipes and `/dev/null` may have any.
///
/// # Errors
/// Names the ending.
pub(crate) fn wants(path: &Path, ending: &str, what: &str) -> Result<(), Usage> {
    let named = path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending));
    if named || atomic::is_stream(path) { Ok(()) } else { Err(Usage(ending_wanted(path, what, &[ending]))) }
}

/// Endings that say another format than that of a field.
const NO_FIELDS: [&str; 22] = [
    "ptm", "lptm", "rti", "hsh", "lp", "csv", "json", "zip", "gltf", "ply", "obj", "exr", "hdr", "pfm", "png", "jpg",
    "jpeg", "tif", "tiff", "ktx2", "html", "xml",
];

/// Refuses a name for a field that says another format; `.glb` is the usual one, and a name that says none will do.
///
/// # Errors
/// Names the ending.
pub(crate) fn wants_field(path: &Path) -> Result<(), Usage> {
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let other = NO_FIELDS.contains(&ending.as_str()) && !atomic::is_stream(path);
    if other { Err(Usage(ending_wanted(path, "field", &["glb"]))) } else { Ok(()) }
}

/// Writes display values as `kind`, which is one of PNG, TIFF and JPEG; `bits` is 8 or 16 (JPEG has 8).
pub(crate) fn save_display(shown: &Display, path: &Path, kind: Kind, bits: u8) -> anyhow::Result<()> {
    let size = (shown.width, shown.height);
    match (kind, bits) {
        (Kind::Jpeg, _) => write_jpeg(path, size, &shown.to_u8(), JPEG_QUALITY)?,
        (Kind::Tiff, 8) => write_tiff8(path, size, &shown.to_u8())?,
        (Kind::Tiff, _) => write_tiff16(path, size, &shown.to_u16())?,
        (_, 8) => write_png8(path, size, &shown.to_u8())?,
        _ => write_png16(path, size, &shown.to_u16())?,
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_says_the_format() {
        let of = |name: &str| Kind::of(Path::new(name), &[Kind::Exr, Kind::Tiff], "picture");
        assert_eq!(of("a.TIFF").unwrap(), Kind::Tiff);
        assert_eq!(of("a.exr").unwrap(), Kind::Exr);
        for wrong in ["a", "a.", "a.jpg", ".exr", "a.exr.gz"] {
            let message = of(wrong).unwrap_err().0;
            assert!(message.contains(".exr or .tif"), "{message}");
        }
    }
}
