//! `translume demo`: a small run of every system on data built into the program, and a page that shows it.
//!
//! A system adds its chapter as a module with `fn chapter(dir: &Path, ctx: &Context) -> anyhow::Result<Part>` that
//! writes its files into a folder of its own under `dir`, and a line in [`CHAPTERS`].

mod field;
mod hdr;
mod lights;
mod render;
mod scatter;

use super::page::{self, Chapter};
use crate::output::Context;
use anyhow::Context as _;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "\
Examples:
  Into the folder out/, then look at out/index.html:
    translume demo out/";

/// Run every system once on small built-in data, into a page with pictures and figures
///
/// Simulated cameras photograph a rendered room and a translucent object, and what the systems make of the photographs is compared with
/// the truth. The files in between are left in the folder, with the commands that do the same by hand.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    /// Folder for the page and its files (made if it is not there)
    #[arg(value_name = "DIR", default_value = "out")]
    dir: PathBuf,
}

/// What a system contributes: its chapter of the page, and the same figures for `--json`.
struct Part {
    chapter: Chapter,
    figures: Value,
}

/// A system's name in `--json` and on the progress bar, and what makes its part in the folder of the demo.
type Entry = (&'static str, fn(&Path, &Context) -> anyhow::Result<Part>);

/// The chapters in the order of the page.
const CHAPTERS: &[Entry] = &[
    ("hdr", hdr::chapter),
    ("render", render::chapter),
    ("lights", lights::chapter),
    ("scatter", scatter::chapter),
    ("field", field::chapter),
];

pub(crate) fn run(args: Args, ctx: &Context) -> anyhow::Result<()> {
    let page_file = args.dir.join("index.html");
    let bar = ctx.progress(CHAPTERS.len() as u64, "demo");
    let mut chapters = Vec::new();
    let mut figures = serde_json::Map::new();
    for (name, chapter) in CHAPTERS {
        bar.set_message(*name);
        let dir = args.dir.join(name);
        std::fs::create_dir_all(&dir).with_context(|| format!("cannot make the folder {}", dir.display()))?;
        let part = chapter(&args.dir, ctx)?;
        chapters.push(part.chapter);
        figures.insert((*name).to_owned(), part.figures);
        bar.inc(1);
    }
    let introduction = format!(
        "<p>What translume {} does, on data built into the program. Everything on this page was made just now, by <code>{}</code>; \
         the files are beside it.</p>",
        env!("CARGO_PKG_VERSION"),
        page::escape(&ctx.command_line)
    );
    page::write(&page_file, "translume: from camera to picture", &introduction, &chapters)?;
    ctx.done(&page_file, format_args!("{} chapters; open it in a browser", CHAPTERS.len()))?;
    ctx.emit_json(json!({ "page": page_file, "figures": figures }))
}
