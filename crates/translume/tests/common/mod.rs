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
        let line = lines[0].trim_start_matches("translume: error: ").to_owned();
        // With --json the same once more as an object, and no result in any case.
        if !self.stdout.is_empty() {
            let object: serde_json::Value = serde_json::from_str(&self.stdout).expect("a failed run prints no result");
            assert_eq!((object["error"].as_str(), object["status"].as_i64()), (Some(&line[..]), Some(status.into())));
        }
        line
    }
}

/// An octahedron, each triangle in four parts three times over, on a sphere of radius 6, as OBJ: 258 different vertices.
pub(crate) fn octahedron() -> String {
    let mut faces: Vec<[[f64; 3]; 3]> = Vec::new();
    for signs in 0..8 {
        let s = [0, 1, 2].map(|k| if signs >> k & 1 == 0 { 1.0 } else { -1.0 });
        let [a, b, c] = [[s[0], 0.0, 0.0], [0.0, s[1], 0.0], [0.0, 0.0, s[2]]];
        faces.push(if s[0] * s[1] * s[2] > 0.0 { [a, b, c] } else { [a, c, b] });
    }
    let middle = |a: [f64; 3], b: [f64; 3]| {
        let m = [0, 1, 2].map(|i| a[i] + b[i]);
        let n = m.iter().map(|x| x * x).sum::<f64>().sqrt();
        m.map(|x| x / n)
    };
    for _ in 0..3 {
        let split = |[a, b, c]: [[f64; 3]; 3]| {
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
        };
        faces = faces.into_iter().flat_map(split).collect();
    }
    let vertex = |p: &[f64; 3]| format!("v {:.6} {:.6} {:.6}\n", 6.0 * p[0], 6.0 * p[1], 6.0 * p[2]);
    let corners: String = faces.iter().flatten().map(vertex).collect();
    let index = |i: usize| format!("f {} {} {}\n", 3 * i + 1, 3 * i + 2, 3 * i + 3);
    corners + &(0..faces.len()).map(index).collect::<String>()
}
