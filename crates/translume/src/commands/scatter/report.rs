//! `translume scatter report`: how good a model of a capture is, beside the others.

use crate::commands::page::{self, Chapter, Figure, Table};
use crate::output::Context;
use serde_json::json;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use translume_image::{atomic, metrics::magma, write_png8};
use translume_scatter::capture::Capture;
use translume_scatter::planar::{
    ErrorMap, ModelHead, PlanarCapture, PlanarModel, PlanarParams, error_map, fit_planar, load_model,
};
use translume_scatter::{Model, Params};

const EXAMPLES: &str = "\
Examples:
  translume scatter report capture/ model/ -o report/
  translume scatter report capture/ model/ -o report/ --json";

/// Tell the errors of a planar model, beside those of simpler and other models of the same capture
///
/// The errors are those of pixels that no fit has seen. Fitted for comparison are the exponential model, isotropic and with 4 and
/// 8 directions, with a fall-off for each colour and a shared one, and the dipole with a free scale. Written are an HTML page
/// with pictures, and the table as CSV.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(super) struct Args {
    /// The folder of a capture of a flat sample
    #[arg(value_name = "CAPTURE")]
    capture: PathBuf,
    /// The folder of a model that was fitted to it
    #[arg(value_name = "MODEL")]
    model: PathBuf,
    /// Folder of the report
    #[arg(short, long, value_name = "REPORT")]
    output: PathBuf,
}

/// Name, fall-off, directions, shared.
const RIVALS: [(&str, Model, usize, bool); 8] = [
    ("dipole", Model::Dipole, 1, false),
    ("dipole, 8 directions", Model::Dipole, 8, false),
    ("isotropic", Model::Exponential, 1, false),
    ("4 directions", Model::Exponential, 4, false),
    ("8 directions", Model::Exponential, 8, false),
    ("isotropic, shared", Model::Exponential, 1, true),
    ("4 directions, shared", Model::Exponential, 4, true),
    ("8 directions, shared", Model::Exponential, 8, true),
];

struct Row {
    name: String,
    errors: ErrorMap,
}

pub(super) fn run(args: &Args, ctx: &Context) -> anyhow::Result<()> {
    let opened = Capture::open(&args.capture)?;
    // The threshold of the model decides what is a sample; it is known once the model is read.
    let threshold = threshold_of(&args.model)?;
    let capture = PlanarCapture::new(opened, threshold)?;
    let (head, model) = load_model(&args.model, &capture)?;
    let bar = ctx.progress(RIVALS.len() as u64, "fitting");
    let mut rows = vec![Row { name: "this model".into(), errors: error_map(&capture, &model)? }];
    for (name, kind, segments, shared) in RIVALS {
        let fit = Params {
            model: kind,
            segments,
            terms: head.terms,
            eta: capture.capture.rig.eta,
            free_scale: kind == Model::Dipole,
        };
        let rival = fit_planar(&capture, &PlanarParams { fit, shared, ..PlanarParams::default() }, || ())?;
        rows.push(Row { name: name.into(), errors: error_map(&capture, &rival)? });
        bar.inc(1);
    }
    std::fs::create_dir_all(&args.output)?;
    let figures = pictures(&args.output, &capture, &head, &model, &rows)?;
    let table = table(&head.channels, &rows);
    write_csv(&args.output.join("errors.csv"), &table)?;
    ctx.text(text(&table))?;
    let chapter = Chapter {
        title: "Errors".into(),
        html: "<p>Mean over the lit points of ln E(x<sub>i</sub>) on pixels kept from all fits [Fuchs 2005, Eq. 8]; \
               0 is perfect. Then the mean of E itself.</p>"
            .into(),
        pictures: figures,
        figures: table,
    };
    let introduction = format!("<p>{}</p>", page::escape(&ctx.command_line));
    page::write(&args.output.join("index.html"), "A planar model of subsurface scattering", &introduction, &[chapter])?;
    let told = rows.iter().map(|r| {
        let means: Vec<_> = (0..head.channels.len()).map(|c| r.errors.mean(c)).collect();
        json!({ "model": r.name, "ln_e": means.iter().map(|m| m.ln_e).collect::<Vec<_>>(),
                "e": means.iter().map(|m| m.e).collect::<Vec<_>>(),
                "log10_e": means.iter().map(|m| m.log10_e).collect::<Vec<_>>() })
    });
    ctx.emit_json(
        json!({ "output": args.output.to_string_lossy(), "channels": head.channels, "points": capture.spots.len(),
        "models": told.collect::<Vec<_>>() }),
    )
}

fn threshold_of(model: &Path) -> anyhow::Result<f64> {
    let file = model.join("model.json");
    let text = std::fs::read(&file).map_err(|e| translume_image::Error::io(&file, e))?;
    let value: serde_json::Value =
        serde_json::from_slice(&text).map_err(|e| translume_image::Error::invalid(&file, e.to_string()))?;
    let threshold = value["threshold"].as_f64().filter(|t| *t >= 0.0);
    Ok(threshold
        .ok_or_else(|| translume_image::Error::invalid(&file, "no threshold: not a planar model of translume"))?)
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
    let line = |cells: &[String]| {
        let rest: Vec<String> = cells[1..].iter().map(|c| format!("{c:>11}")).collect();
        format!("{:22}{}", cells[0], rest.join(""))
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

/// A frame, its reconstruction and the error of the middle lit point; maps of E(x_i) over the laser grid; the texture.
fn pictures(
    folder: &Path,
    capture: &PlanarCapture,
    head: &ModelHead,
    model: &PlanarModel,
    rows: &[Row],
) -> anyhow::Result<Vec<Vec<Figure>>> {
    let [.., height, width] = capture.capture.frames.shape;
    let channel = 1.min(head.channels.len() - 1);
    let middle = capture.spots.len() / 2 + capture.capture.rig.laser.grid[0] / 2;
    let middle = middle.min(capture.spots.len() - 1);
    let spot = capture.spots[middle];
    let measured = capture.reflectance(&spot, channel)?;
    let predicted = model.predict(capture, middle, channel);
    let peak = measured.iter().copied().fold(0.0, f32::max);
    let floor = measured.iter().copied().filter(|v| *v > 0.0).fold(peak, f32::min).max(1e-30);
    let log = |v: f64| ((v.max(1e-30) as f32 / floor).ln() / (peak / floor).ln()).clamp(0.0, 1.0);
    let error = |(s, m): (&f32, &f64)| match *s > 0.0 && *m > 0.0 {
        true => ((m / f64::from(*s)).ln().abs() / 0.7) as f32,
        false => 0.0,
    };
    let texture = &model.texture[spot.frame[0]][channel];
    let save = |name: &str, caption: String, (w, h): (usize, usize), values: Vec<f32>| -> anyhow::Result<Figure> {
        save_map(&folder.join(name), (w, h), &values)?;
        Ok(Figure { file: name.to_owned(), caption })
    };
    let first = vec![
        save(
            "measured.png",
            "a frame, logarithmic".into(),
            (width, height),
            measured.iter().map(|v| log(f64::from(*v))).collect(),
        )?,
        save("model.png", "the model of it".into(), (width, height), predicted.iter().map(|v| log(*v)).collect())?,
        save(
            "error.png",
            "|ln E|, white is 0.7".into(),
            (width, height),
            measured.iter().zip(&predicted).map(error).collect(),
        )?,
        save(
            "texture.png",
            "modulation, white is 2".into(),
            (width, height),
            texture.iter().map(|a| a / 2.0).collect(),
        )?,
    ];
    let [columns, lines] = capture.capture.rig.laser.grid;
    let mut second = Vec::new();
    for name in ["dipole", "isotropic", "4 directions", "8 directions"] {
        let Some(row) = rows.iter().find(|r| r.name == name) else { continue };
        let mut map = vec![0.0; columns * lines];
        for (spot, ln) in capture.spots.iter().zip(&row.errors.ln) {
            if let Some(cell) = map.get_mut(spot.frame[1]) {
                *cell = (ln[channel] / 0.7) as f32;
            }
        }
        let file = format!("errors-{}.png", name.replace(' ', "-"));
        second.push(save(&file, format!("{name}: ln E of each lit point, white is 0.7"), (columns, lines), map)?);
    }
    Ok(vec![first, second])
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
