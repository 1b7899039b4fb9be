//! The readers, and what their results promise: the one table of them.

mod images;
mod lists;
mod measured;
mod meshes;
mod program;
pub(crate) mod scenes;

use crate::input::Input;
use std::path::Path;

/// What a reader said.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Said {
    /// It read the input.
    pub accepted: bool,
    /// Its error or its warnings.
    pub text: String,
}

impl Said {
    /// `Ok` with its warnings, or the error.
    fn of<T, E: std::fmt::Display>(result: &Result<T, E>, warnings: impl FnOnce(&T) -> String) -> Self {
        match result {
            Ok(value) => Self { accepted: true, text: warnings(value) },
            Err(error) => Self { accepted: false, text: error.to_string() },
        }
    }

    /// Both, one after the other.
    fn and(self, other: Self) -> Self {
        Self { accepted: self.accepted || other.accepted, text: format!("{} | {}", self.text, other.text) }
    }

    /// What is new about an answer: its text without numbers, quotations and the folder.
    pub fn kind(&self, folder: &Path) -> String {
        let text = self.text.replace(&*folder.to_string_lossy(), "");
        let (mut out, mut quoted, mut last) = (String::from(if self.accepted { "+" } else { "-" }), false, '\0');
        for c in text.chars() {
            let c = if c.is_ascii_digit() { '#' } else { c };
            quoted ^= c == '"';
            let again = c == '#' && last == '#';
            if !quoted && !again && out.len() < 240 {
                out.push(c);
            }
            last = c;
        }
        out
    }
}

/// A reader.
#[derive(Debug)]
pub struct Target {
    /// Its name, and that of its folder in the corpus.
    pub name: &'static str,
    /// Reads the input, which lies in the folder, and asserts what is promised.
    pub run: fn(&Path, &Input) -> Said,
    /// Folders of other crates' test files that are seeds too, from the project's root.
    pub seeds: &'static [&'static str],
    /// Bytes of memory that any input may take, in MiB.
    pub memory_mib: usize,
    /// Bytes of memory for each byte of the input.
    pub memory_ratio: usize,
}

const EXR_MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// A few sound bytes of OpenEXR may be the crop of a picture of 8K, 2²⁵ pixels of four floats, of which there are two copies
/// for a moment.
const CROPPED_EXR: usize = (2 * 4 * 4) << 25;

impl Target {
    /// Bytes that this input may take.
    pub fn memory(&self, input: &Input) -> usize {
        let crops = input.files.iter().any(|f| f.1.windows(4).any(|w| w == EXR_MAGIC));
        (self.memory_mib << 20) + self.memory_ratio * input.size() + if crops { CROPPED_EXR } else { 0 }
    }

    /// The reader of this name.
    pub fn named(name: &str) -> Option<&'static Self> {
        TARGETS.iter().chain([&SELF_TEST]).find(|t| t.name == name)
    }
}

const fn target(name: &'static str, run: fn(&Path, &Input) -> Said, memory_mib: usize, memory_ratio: usize) -> Target {
    Target { name, run, seeds: &[], memory_mib, memory_ratio }
}

/// All of them.
pub const TARGETS: [Target; 17] = [
    // Codecs pack up to 4096 to 1, and pixels become floats.
    Target {
        seeds: &["crates/translume-image/tests/data", "crates/translume-image/tests/data/crashes"],
        ..target("image", images::run, 64, 1 << 16)
    },
    target("mesh", meshes::run, 64, 4000),
    target("scene", scenes::load, 256, 1 << 16),
    Target { seeds: &["fuzz/corpus/scene"], ..target("render", scenes::render, 512, 1 << 16) },
    Target { seeds: &["crates/translume-scene/tests/data/measured"], ..target("bsdf", scenes::bsdf, 64, 200) },
    target("checkpoint", scenes::checkpoint, 64, 100),
    target("spectrum", scenes::spectrum, 64, 200),
    target("grid", scenes::grid, 64, 100),
    target("lights", lists::lights, 64, 500),
    target("exposures", lists::exposures, 64, 500),
    target("field", measured::field, 64, 5000),
    target("relightlab", measured::relightlab, 64, 1 << 16),
    target("capture", measured::capture, 256, 1 << 16),
    target("model", measured::model, 256, 1 << 16),
    target("lighting", measured::lighting, 64, 1 << 16),
    target("samples", measured::samples, 64, 100),
    target("program", program::run, 64, 1000),
];

/// What the harness itself must notice.
const SELF_TEST: Target = target("self-test", self_test, 16, 10);

fn self_test(_: &Path, input: &Input) -> Said {
    fn deep(n: u64) -> u64 {
        std::hint::black_box([n; 64]);
        if n == 0 { 0 } else { 1 + deep(std::hint::black_box(n - 1)) }
    }
    let text = input.files.first().map_or(&b""[..], |f| &f.1);
    match text.trim_ascii() {
        b"panic" => panic!("as asked"),
        b"other thread" => drop(std::thread::spawn(|| panic!("as asked")).join()),
        b"memory" => drop(std::hint::black_box(vec![1u8; 100 << 20])),
        b"stack" => drop(std::hint::black_box(deep(u64::MAX))),
        b"time" => loop {
            std::hint::black_box(());
        },
        _ => {}
    }
    Said { accepted: true, text: String::new() }
}
