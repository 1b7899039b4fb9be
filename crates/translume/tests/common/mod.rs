//! Runs the built program as a user would. Each test file compiles its own copy and may use a part of it.
#![allow(dead_code, reason = "see above")]

pub(crate) mod bracket;

use std::path::Path;
use std::process::{Command, Stdio};

/// What a run left behind.
pub(crate) struct Run {
    pub(crate) status: i32,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

/// Runs `translume` with `arguments` in the folder `dir`.
pub(crate) fn translume(dir: &Path, arguments: &[&str]) -> Run {
    let out = Command::new(env!("CARGO_BIN_EXE_translume"))
        .args(arguments)
        .current_dir(dir)
        .stdin(Stdio::null())
        .output()
        .expect("the program starts");
    let text = |bytes| String::from_utf8(bytes).expect("UTF-8");
    Run { status: out.status.code().expect("no signal"), stdout: text(out.stdout), stderr: text(out.stderr) }
}

impl Run {
    /// Standard output of a run that must have gone well.
    #[track_caller]
    pub(crate) fn ok(self) -> String {
        assert_eq!(self.status, 0, "{}", self.stderr);
        self.stdout
    }

    /// The one error line of a run that must have failed with `status`.
    #[track_caller]
    pub(crate) fn error(self, status: i32) -> String {
        assert_eq!(self.status, status, "{}{}", self.stdout, self.stderr);
        let lines: Vec<_> = self.stderr.lines().collect();
        assert!(lines.len() == 1 && lines[0].starts_with("translume: error: "), "not one line: {}", self.stderr);
        assert_eq!(self.stdout, "", "a failed run prints no result");
        lines[0].trim_start_matches("translume: error: ").to_owned()
    }
}
