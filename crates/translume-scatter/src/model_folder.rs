//! Folders of models: whole or not at all, whatever kind of model was there before, and with what is not of a model kept.

use crate::{Error, Result};
use std::path::Path;
use translume_image::atomic;

/// Names of all files and folders that models of any kind consist of.
fn is_part(name: &str) -> bool {
    const PARTS: [&str; 10] = [
        "model.json",
        "mesh.ply",
        "texture.exr",
        "throughput",
        "throughput_confidence",
        "atlas",
        "kernels",
        "kernels_confidence",
        "modulation",
        "modulation_weight",
    ];
    let numbered = || name.strip_prefix("texture-")?.strip_suffix(".exr")?.parse::<u32>().ok();
    PARTS.contains(&name) || numbered().is_some()
}

/// Whether a model may be written into `path`: it is not there yet, or empty, or a model.
///
/// # Errors
/// [`Error::Io`] otherwise: a folder of something else is not to be mixed with a model.
pub fn check_model_folder(path: &Path) -> Result<()> {
    let is_model = || {
        let text = std::fs::read(path.join("model.json")).ok()?;
        let head: serde_json::Value = serde_json::from_slice(&text).ok()?;
        head["format"].as_str().filter(|f| f.starts_with("translume ")).map(drop)
    };
    match std::fs::read_dir(path).map(Iterator::count) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(e) => Err(Error::io(path, e)),
        Ok(entries) if entries == 0 || is_model().is_some() => Ok(()),
        Ok(_) => {
            let what = "it holds something that is no model; choose another name, or remove it";
            Err(Error::io(path, std::io::Error::new(std::io::ErrorKind::AlreadyExists, what)))
        }
    }
}

/// Calls `fill` with an empty folder, which then takes the place of `path`; of an older model nothing is left, of other files
/// there all.
pub(crate) fn write_model(path: &Path, fill: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    check_model_folder(path)?;
    atomic::write_folder(path, is_part, fill)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_of_something_else_is_refused_and_kept() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("thesis.tex"), "years").unwrap();
        let write = |text: &'static str| {
            write_model(&dir.path().join("m"), move |new| {
                std::fs::write(new.join("model.json"), text).map_err(|e| Error::io(new, e))
            })
        };
        assert!(write_model(dir.path(), |_| Ok(())).unwrap_err().to_string().contains("no model"));
        write(r#"{"format": "translume planar model"}"#).unwrap();
        std::fs::write(dir.path().join("m/notes.txt"), "mine").unwrap();
        std::fs::write(dir.path().join("m/texture-7.exr"), "old").unwrap();
        write(r#"{"format": "translume vertex model"}"#).unwrap();
        assert!(dir.path().join("m/notes.txt").exists() && !dir.path().join("m/texture-7.exr").exists());
        assert_eq!(std::fs::read_to_string(dir.path().join("thesis.tex")).unwrap(), "years");
    }
}
