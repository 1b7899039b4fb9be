//! Readers of the binary alone, through the program: `--config`, camera paths, response curves. It lies beside the fuzzer.
//! Without it, which `cargo test -p translume-fuzz` does not build, nothing is read.

use super::Said;
use crate::input::Input;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// `target/debug/translume`, of our own build.
fn program() -> Option<PathBuf> {
    let own = std::env::current_exe().ok()?;
    let name = format!("translume{}", std::env::consts::EXE_SUFFIX);
    own.ancestors().skip(1).take(2).map(|folder| folder.join(&name)).find(|p| p.is_file())
}

/// The input's main file is the one that its name says: `config.toml`, `path.json` with `scene.xml`, `response.json` with pictures.
pub(super) fn run(folder: &Path, input: &Input) -> Said {
    let Some(program) = program() else { return Said { accepted: false, text: "no program".into() } };
    let has = |name: &str| input.files.iter().any(|f| f.0 == name);
    let words: Vec<&str> = if has("config.toml") {
        vec!["scene", "info", "--config", "config.toml", "--print-config"]
    } else if has("path.json") {
        vec!["render", "scene.xml", "--camera-path", "path.json", "--spp", "1", "--size", "2x2", "-o", "out.exr"]
    } else if has("response.json") {
        vec!["hdr", "a.png", "b.png", "--exposures", "1,2", "--response", "response.json", "-o", "out.exr"]
    } else {
        vec!["scene", "info", "scene.xml", "--json"]
    };
    let mut command = Command::new(program);
    command.args(words).current_dir(folder).stdin(Stdio::null());
    let Ok(out) = command.output() else { return Said { accepted: false, text: "does not run".into() } };
    let text = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(!text.contains("internal error"), "{text}");
    assert!(matches!(out.status.code(), Some(0..=2)), "status {}: {text}", out.status);
    Said { accepted: out.status.success(), text }
}
