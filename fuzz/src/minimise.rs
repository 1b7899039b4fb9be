//! Makes an input smaller that breaks a promise, for as long as it breaks the same one.

use crate::drive::{cause, own, reason};
use crate::input::Input;
use crate::targets::Target;
use std::process::Stdio;
use std::time::Instant;

/// Most attempts.
const MOST: usize = 400;

/// A smaller input with the same fault, by leaving out files and parts of files until `end`.
pub fn minimise(target: &Target, input: Input, why: &str, end: Instant) -> Input {
    let mut best = input;
    let mut attempts = 0;
    let mut still = |candidate: &Input| {
        attempts += 1;
        attempts <= MOST && Instant::now() < end && fails(target, candidate).is_some_and(|w| cause(&w) == cause(why))
    };
    if !still(&best) {
        return best;
    }
    for file in (0..best.files.len()).rev() {
        let mut candidate = best.clone();
        candidate.files.remove(file);
        if !candidate.files.is_empty() && still(&candidate) {
            best = candidate;
        }
    }
    for file in 0..best.files.len() {
        let mut part = best.files[file].1.len().div_ceil(2);
        while part > 0 {
            let mut at = 0;
            while at < best.files[file].1.len() {
                let mut candidate = best.clone();
                let bytes = &mut candidate.files[file].1;
                drop(bytes.drain(at..(at + part).min(bytes.len())));
                if still(&candidate) { best = candidate } else { at += part }
            }
            // Single bytes of large files are not worth their attempts.
            part = if part > 1 && part * 200 > best.files[file].1.len() { part / 2 } else { 0 };
        }
    }
    best
}

/// Why an input fails, read by a process of its own; `None` if it does not.
pub fn fails(target: &Target, input: &Input) -> Option<String> {
    let folder = tempfile::tempdir().ok()?;
    let place = folder.path().join("input");
    input.write(&place).ok()?;
    let out = own().ok()?.args(["check", target.name]).arg(&place).stdin(Stdio::null()).output().ok()?;
    reason(out.status, &String::from_utf8_lossy(&out.stderr)).ok()?
}
