//! `translume scatter report`: how good a model of a capture is, beside the others.

use crate::commands::page::{self, Chapter, Figure, Table};
use crate::output::Context;
use serde_json::json;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use translume_image::{atomic, metrics::magma, write_png8};
use translume_scatter::capture::Capture;
use translume_scatter::hierarchical::read_head;
use translume_scatter::planar::ErrorMap;

const EXAMPLES: &str = "\
Examples:
  translume scatter report capture/ model/ -o report/
  translume scatter report capture/ model/ -o report/ --json";

/// Tell the errors of a model, beside those of simpler and other models of the same capture
///
/// The errors are those of pixels that no fit has seen. Fitted for comparison are, on flat samples, the exponential model, isotropic
/// and with 4 and 8 directions, with a fall-off for each colour and a shared one, and the dipole with a free scale; on objects,
/// one exponential and the dipole. Hierarchical models use all pixels; theirs are errors of what was fitted, without K and without the
/// modulation for comparison, and of every fifth laser position as a model of the others predicts it; and the pictures show local, global and combined light apart. Written are an HTML page with pictures, samples against fits, and the table as CSV.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(super) struct Args {
    /// The folder of a capture
    #[arg(value_name = "CAPTURE")]
    pub(super) capture: PathBuf,
    /// The folder of a model that was fitted to it
    #[arg(value_name = "MODEL")]
    pub(super) model: PathBuf,
    /// Folder of the report
    #[arg(short, long, value_name = "REPORT")]
    pub(super) output: PathBuf,
}

/// A line of the table.
pub(super) struct Row {
    pub(super) name: String,
    pub(super) errors: ErrorMap,
}

/// What one kind of model has to show.
pub(super) struct Told {
    pub(super) title: &'static str,
    /// Which pixels the errors are about.
    pub(super) on: &'static str,
    pub(super) channels: Vec<String>,
    pub(super) points: usize,
    pub(super) rows: Vec<Row>,
    pub(super) pictures: Vec<Vec<Figure>>,
}

pub(super) fn run(args: &Args, ctx: &Context) -> anyhow::Result<()> {
    ctx.protect(&[&args.capture, &args.model], &[&args.output])?;
    let opened = Capture::open(&args.capture)?.in_rgb_order();
    // The threshold of the model decides what is a sample; it is known once the model is read.
    let threshold = threshold_of(&args.model)?;
    let told = match opened.is_flat() {
        _ if read_head(&args.model).is_ok() => super::report_hierarchical::tell(args, &opened, threshold)?,
        true => super::report_planar::tell(args, opened, threshold, ctx)?,
        false => super::report_mesh::tell(args, opened, threshold, ctx)?,
    };
    for row in &told.rows {
        if (0..told.channels.len()).all(|c| !row.errors.mean(c).ln_e.is_finite()) {
            ctx.warn(format_args!(
                "{}: it says nothing about any of these pixels, so its errors are unknown (NaN)",
                row.name
            ));
        }
    }
    let table = table(&told.channels, &told.rows);
    write_csv(&args.output.join("errors.csv"), &table)?;
    ctx.text(text(&table))?;
    let chapter = Chapter {
        title: "Errors".into(),
        html: format!(
            "<p>Mean over the lit points of ln E(x<sub>i</sub>) on {} [Fuchs 2005, Eq. 8]; 0 is perfect. Then the mean of E itself.</p>",
            told.on
        ),
        pictures: told.pictures,
        figures: table,
    };
    let introduction = format!("<p>{}</p>", page::escape(&ctx.command_line));
    page::write(&args.output.join("index.html"), told.title, &introduction, &[chapter])?;
    ctx.done(&args.output.join("index.html"), format_args!("{} lit points", told.points))?;
    let models = told.rows.iter().map(|r| {
        let means: Vec<_> = (0..told.channels.len()).map(|c| r.errors.mean(c)).collect();
        json!({ "model": r.name, "ln_e": means.iter().map(|m| m.ln_e).collect::<Vec<_>>(),
                "e": means.iter().map(|m| m.e).collect::<Vec<_>>(),
                "log10_e": means.iter().map(|m| m.log10_e).collect::<Vec<_>>() })
    });
    ctx.emit_json(json!({ "output": args.output.to_string_lossy(), "channels": told.channels, "points": told.points,
        "models": models.collect::<Vec<_>>() }))
}

fn threshold_of(model: &Path) -> anyhow::Result<f64> {
    let file = model.join("model.json");
    let text = std::fs::read(&file).map_err(|e| translume_image::Error::io(&file, e))?;
    let value: serde_json::Value =
        serde_json::from_slice(&text).map_err(|e| translume_image::Error::invalid(&file, e.to_string()))?;
    let threshold = value["threshold"].as_f64().filter(|t| *t >= 0.0);
    Ok(threshold.ok_or_else(|| translume_image::Error::invalid(&file, "no threshold: not a model of translume"))?)
}

fn table(channels: &[String], rows: &[Row]) -> Table {
    let mut columns = vec!["model".to_owned()];
    columns.extend(channels.iter().map(|c| format!("ln E, {c}")));
    columns.extend(channels.iter().map(|c| format!("E, {c}")));
    let row = |r: &Row| {
        let means: Vec<_> = (0..channels.len()).map(|c| r.errors.mean(c)).collect();
        let mut cells = vec![r.name.clone()];
        cells.extend(means.iter().map(|m| format!("{:.4}", m.ln_e)));
        cells.extend(means.iter().map(|m| format!("{:.4}", m.e)));
        cells
    };
    Table { columns, rows: rows.iter().map(row).collect() }
}

fn text(table: &Table) -> String {
    let all = || std::iter::once(&table.columns).chain(&table.rows);
    let width = all().map(|cells| cells[0].chars().count()).max().unwrap_or(0);
    let line = |cells: &[String]| {
        let rest: Vec<String> = cells[1..].iter().map(|c| format!("{c:>13}")).collect();
        format!("{:width$}{}", cells[0], rest.join(""))
    };
    std::iter::once(line(&table.columns)).chain(table.rows.iter().map(|r| line(r))).collect::<Vec<_>>().join("\n")
}

fn write_csv(path: &Path, table: &Table) -> anyhow::Result<()> {
    let mut csv = String::new();
    for row in std::iter::once(&table.columns).chain(&table.rows) {
        let cells: Vec<String> = row.iter().map(|c| format!("\"{c}\"")).collect();
        let _ = writeln!(csv, "{}", cells.join(","));
    }
    Ok(atomic::write_bytes(path, csv.as_bytes())?)
}

/// A measured and a modelled frame and what is between them, as pictures `measured.png`, `model.png` and `error.png`.
pub(super) fn frame_pictures(
    folder: &Path,
    size: (usize, usize),
    measured: &[f32],
    predicted: &[f64],
) -> anyhow::Result<Vec<Figure>> {
    let peak = measured.iter().copied().fold(0.0, f32::max);
    let floor = measured.iter().copied().filter(|v| *v > 0.0).fold(peak, f32::min).max(1e-30);
    let log = |v: f64| ((v.max(1e-30) as f32 / floor).ln() / (peak / floor).ln()).clamp(0.0, 1.0);
    let error = |(s, m): (&f32, &f64)| match *s > 0.0 && *m > 0.0 {
        true => ((m / f64::from(*s)).ln().abs() / 0.7) as f32,
        false => 0.0,
    };
    Ok(vec![
        figure(folder, "measured.png", "a frame, logarithmic", size, measured.iter().map(|v| log(f64::from(*v))))?,
        figure(folder, "model.png", "the model of it", size, predicted.iter().map(|v| log(*v)))?,
        figure(folder, "error.png", "|ln E|, white is 0.7", size, measured.iter().zip(predicted).map(error))?,
    ])
}

/// Saves a map and says what it shows.
pub(super) fn figure(
    folder: &Path,
    name: &str,
    caption: &str,
    size: (usize, usize),
    values: impl Iterator<Item = f32>,
) -> anyhow::Result<Figure> {
    save_map(&folder.join(name), size, &values.collect::<Vec<_>>())?;
    Ok(Figure { file: name.to_owned(), caption: caption.to_owned() })
}

/// Values in [0, 1] as colours, each a block of pixels, so that small maps can be seen.
fn save_map(path: &Path, (w, h): (usize, usize), values: &[f32]) -> anyhow::Result<()> {
    let block = (384 / w.max(1)).max(1);
    let mut rgb = Vec::with_capacity(3 * w * h * block * block);
    for y in 0..h * block {
        for x in 0..w * block {
            let v = values[y / block * w + x / block];
            rgb.extend(magma(if v.is_finite() { v } else { 0.0 }));
        }
    }
    Ok(write_png8(path, (w * block, h * block), &rgb)?)
}
