//! `translume man`: manual pages, made from the same definitions as the help.

use crate::cli::Cli;
use crate::output::Context;
use anyhow::Context as _;
use clap::{Command, CommandFactory};
use serde_json::json;
use std::path::PathBuf;
use translume_image::atomic;

const EXAMPLES: &str = "\
Examples:
  Read the top page:
    translume man | man -l -

  Write the pages of all verbs where man finds them:
    translume man ~/.local/share/man/man1";

/// Write the manual pages, or print the top one
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    /// Folder for the pages of all verbs (made if it is not there); without it the top page goes to standard output
    #[arg(value_name = "DIR")]
    dir: Option<PathBuf>,
}

pub(crate) fn run(args: Args, ctx: &Context) -> anyhow::Result<()> {
    // clap's own `help` verb has nothing to say in a manual.
    let mut command = without_help(Cli::command());
    command.build();
    let Some(dir) = args.dir else {
        let page = String::from_utf8(page(&command)?)?;
        ctx.text(page.trim_end())?;
        return ctx.emit_json(json!({ "page": page }));
    };
    std::fs::create_dir_all(&dir).with_context(|| format!("cannot make the folder {}", dir.display()))?;
    let mut files = Vec::new();
    for command in with_descendants(&command) {
        let path = dir.join(format!("{}.1", full_name(command)));
        atomic::write_bytes(&path, &page(command)?)?;
        files.push(path.to_string_lossy().into_owned());
    }
    ctx.done(&dir, format_args!("{} pages", files.len()))?;
    ctx.emit_json(json!({ "files": files }))
}

fn without_help(command: Command) -> Command {
    command.disable_help_subcommand(true).mut_subcommands(without_help)
}

/// A command, its subcommands, theirs and so on.
fn with_descendants(command: &Command) -> Vec<&Command> {
    std::iter::once(command).chain(command.get_subcommands().flat_map(with_descendants)).collect()
}

/// The name with those of the commands above it, as manual pages are called: `translume-man`.
fn full_name(command: &Command) -> String {
    command.get_display_name().unwrap_or(command.get_name()).to_owned()
}

fn page(command: &Command) -> std::io::Result<Vec<u8>> {
    let mut page = Vec::new();
    clap_mangen::Man::new(command.clone()).title(full_name(command)).render(&mut page)?;
    Ok(page)
}
