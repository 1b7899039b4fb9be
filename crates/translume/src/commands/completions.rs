//! `translume completions`: a shell's script that completes this command line.

use crate::cli::Cli;
use crate::output::Context;
use clap::CommandFactory;
use serde_json::json;

const EXAMPLES: &str = "\
Examples:
  translume completions bash > ~/.local/share/bash-completion/completions/translume
  translume completions zsh  > ~/.zfunc/_translume
  translume completions fish > ~/.config/fish/completions/translume.fish";

/// Print a completion script for a shell
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    /// The shell
    #[arg(value_name = "SHELL")]
    shell: clap_complete::Shell,
}

pub(crate) fn run(args: Args, ctx: &Context) -> anyhow::Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "translume", &mut script);
    let script = String::from_utf8(script)?;
    ctx.text(script.trim_end())?;
    ctx.emit_json(json!({ "shell": args.shell.to_string(), "script": script }))
}
