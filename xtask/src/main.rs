//! Chores of the project: `cargo xtask layers`, `cargo xtask equations`, `cargo xtask licences`, `cargo xtask fuzz`,
//! `cargo xtask same-bits`.

mod allowed;
mod equations;
mod inside;
mod layers;
mod licences;
mod modules;
mod picture;
mod same_bits;
mod source;
mod spdx;

use std::process::{Command, ExitCode};

const USAGE: &str = "\
Usage: cargo xtask CHORE

  layers     check that crates depend only on crates of lower layers, that modules have no circles, that libraries name no
             options, and that docs/images/layers.svg is not stale; layers --picture draws it
  equations  check that docs/papers.md and the tags of equations in the code agree
  licences   list the licences of all dependencies and check that they are permissive
  fuzz       mutate the files of fuzz/corpus and read them, 60 s long or as long as --seconds says; fuzz help tells more
  same-bits  run two builds of the program on the same work and compare their outputs bit for bit";

fn main() -> ExitCode {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let outcome = match arguments.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["layers"] => layers::check().and_then(|()| inside::check()).and_then(|()| picture::check()),
        ["layers", "--picture"] => picture::write(),
        ["equations"] => equations::check(),
        ["licences"] => licences::check(),
        ["fuzz", words @ ..] => fuzz(words),
        ["same-bits", words @ ..] => same_bits::run(words),
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

/// Builds the fuzzer and beside it the program, whose readers it runs too, and hunts.
fn fuzz(words: &[&str]) -> Result<(), String> {
    cargo(&["build", "--locked", "--package", "translume", "--package", "translume-fuzz"])?;
    cargo(&[&["run", "--locked", "--quiet", "--package", "translume-fuzz", "--"], words].concat())
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
