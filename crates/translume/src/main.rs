//! The command line: parse, load, call, save. No algorithm lives here.

mod cli;
mod commands;
mod config;
mod output;
mod signals;

use std::process::ExitCode;

fn main() -> ExitCode {
    output::install_panic_hook();
    // A panic is a bug, but still an ordinary failure to whoever called us: one line (by the hook) and status 1.
    std::panic::catch_unwind(|| cli::run(std::env::args_os().collect())).unwrap_or(cli::FAILED).into()
}
