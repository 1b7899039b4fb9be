//! Chores of the project: `cargo xtask layers`, `cargo xtask licences`, `cargo xtask slow`.

mod layers;
mod licences;
mod spdx;

use std::process::{Command, ExitCode};

const USAGE: &str = "\
Usage: cargo xtask CHORE

  layers    check that crates depend only on crates of lower layers
  licences  list the licences of all dependencies and check that they are permissive
  slow      run the tests that are too slow for every day (ignored ones), optimised";

fn main() -> ExitCode {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let outcome = match arguments.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["layers"] => layers::check(),
        ["licences"] => licences::check(),
        ["slow"] => cargo(&["test", "--workspace", "--release", "--locked", "--", "--ignored"]),
        ["help" | "-h" | "--help"] => {
            println!("{USAGE}");
            Ok(())
        }
        _ => {
            eprintln!("{USAGE}");
            return ExitCode::from(2);
        }
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(why) => {
            eprintln!("xtask: error: {why}");
            ExitCode::FAILURE
        }
    }
}

/// The cargo that runs us.
fn command() -> Command {
    Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

fn cargo(arguments: &[&str]) -> Result<(), String> {
    let status = command().args(arguments).status().map_err(|e| format!("cannot run cargo: {e}"))?;
    if status.success() { Ok(()) } else { Err(format!("cargo {} failed", arguments.join(" "))) }
}

/// What `cargo metadata` tells with these further arguments.
fn metadata(arguments: &[&str]) -> Result<serde_json::Value, String> {
    let out = command()
        .args(["metadata", "--format-version", "1", "--locked"])
        .args(arguments)
        .output()
        .map_err(|e| format!("cannot run cargo: {e}"))?;
    if !out.status.success() {
        return Err(format!("cargo metadata failed: {}", String::from_utf8_lossy(&out.stderr).trim()));
    }
    serde_json::from_slice(&out.stdout).map_err(|e| format!("cargo metadata: {e}"))
}
