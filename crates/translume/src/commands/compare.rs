//! `translume compare`: every measure of two pictures, and a page with difference pictures.

use super::page::{self, Chapter, Figure, Table};
use crate::cli::Usage;
use crate::output::Context;
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};
use translume_image::compare::{CompareParams, Comparison, PICTURES, compare, write_pictures};
use translume_image::{Format, Picture, read_picture};

const EXAMPLES: &str = "\
Examples:
  Print all measures:
    translume compare reference.exr render.exr

  Write a page with FLIP map, signed difference and both pictures:
    translume compare reference.exr render.exr --report differences

  Take one measure into a script:
    translume compare a.png b.png --json | jq .flip_mean

  Look from 1 m at a 27-inch screen of 2560 pixels:
    translume compare a.png b.png --ppd 74.8";

/// Measure how far a picture is from a reference
///
/// RMSE, relMSE, PSNR, PSNR-µ, PU21-PSNR, SSIM, CIEDE2000 and FLIP. Two 8 or 16-bit files are compared as they are
/// displayed; with a float, PQ or HLG file among them, FLIP looks at all exposures that show something.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    /// The picture taken for right
    reference: PathBuf,
    /// The picture to be judged
    test: PathBuf,
    /// Write index.html with difference pictures into this folder (made if it is not there)
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Compare light beyond white too [default: if one of the files is float]
    #[arg(long, conflicts_with = "ldr")]
    hdr: bool,
    /// Compare only what a display shows without tone mapping
    #[arg(long)]
    ldr: bool,
    /// Pixels per degree of visual angle [default: 67.02, 0.7 m from a 3840-pixel screen of 0.7 m]
    #[arg(long, value_name = "N")]
    ppd: Option<f64>,
    /// Luminance that a value of 1 stands for, for PU21
    #[arg(long, value_name = "CD_M2", default_value_t = 100.0)]
    white: f64,
}

pub(crate) fn run(args: Args, ctx: &Context) -> anyhow::Result<()> {
    let ppd = args.ppd.unwrap_or(CompareParams::default().ppd);
    if !(1.0..=10_000.0).contains(&ppd) {
        return Err(Usage("--ppd must lie between 1 and 10000".into()).into());
    }
    if !(args.white > 0.0 && args.white.is_finite()) {
        return Err(Usage("--white must be a positive luminance".into()).into());
    }
    if let Some(folder) = &args.report {
        ctx.protect(&[&args.reference, &args.test], &[folder])?;
    }
    let mut pictures = [read_picture(&args.reference)?, read_picture(&args.test)?];
    let mut non_finite = [0, 0];
    for (i, path) in [&args.reference, &args.test].into_iter().enumerate() {
        non_finite[i] = pictures[i].clear_non_finite();
        if non_finite[i] > 0 {
            ctx.warn(format_args!("{}: {} values are NaN or infinite, taken for 0", path.display(), non_finite[i]));
        }
    }
    let [reference, test] = pictures;
    let beyond_white = beyond_white(&reference) || beyond_white(&test);
    let hdr = args.hdr || !args.ldr && (beyond_white || is_float(&args.reference)? || is_float(&args.test)?);
    let params = CompareParams { hdr, ppd, cd_m2: args.white };
    let found = compare(&reference, &test, &params)?;
    let mut files = Vec::new();
    if let Some(folder) = &args.report {
        files = write_report(folder, (&reference, &test), [&args.reference, &args.test], &found)?;
    }
    let rows = found.rows();
    let table: Vec<String> = rows.iter().map(|(n, v, meaning)| format!("{n:13} {v:14.6}   {meaning}")).collect();
    ctx.text(table.join("\n"))?;
    let (width, height) = reference.pixels.dimensions();
    if let Some(folder) = &args.report {
        ctx.done(&folder.join("index.html"), format_args!("{width} × {height} pixels compared"))?;
    }
    let mut object = Map::new();
    // JSON knows no infinity: the PSNR of equal pictures is null.
    object.extend(rows.iter().map(|(name, value, _)| ((*name).to_owned(), json!(value))));
    object.insert("reference".into(), json!(args.reference.to_string_lossy()));
    object.insert("test".into(), json!(args.test.to_string_lossy()));
    object.insert("width".into(), json!(width));
    object.insert("height".into(), json!(height));
    object.insert("hdr".into(), json!(hdr));
    object.insert("ppd".into(), json!(params.ppd));
    object.insert("non_finite".into(), json!(non_finite));
    if let Some((start, stop, count)) = found.flip.exposures {
        object.insert("flip_exposures".into(), json!({ "start": start, "stop": stop, "count": count }));
    }
    if !files.is_empty() {
        object.insert("files".into(), files.iter().map(|f| json!(f.to_string_lossy())).collect());
    }
    ctx.emit_json(Value::Object(object))
}

/// Whether integer codes hold light beyond white (PQ, HLG): more than a colour outside of Rec. 709 has in one component.
fn beyond_white(picture: &Picture) -> bool {
    picture.pixels.iter().any(|v| *v > 2.0)
}

/// Whether a file's format holds light beyond white.
fn is_float(path: &std::path::Path) -> anyhow::Result<bool> {
    Ok(match Format::of_file(path)? {
        Format::Exr | Format::Radiance | Format::Pfm => true,
        Format::Png | Format::Jpeg | Format::Tga => false,
        Format::Tiff => translume_image::read_codes(path)?.is_linear(),
    })
}

/// Writes a page with the pictures of [`write_pictures`]; returns all files.
fn write_report(
    folder: &Path,
    (reference, test): (&Picture, &Picture),
    names: [&Path; 2],
    found: &Comparison,
) -> anyhow::Result<Vec<PathBuf>> {
    let (mut files, ev) = write_pictures(folder, (reference, test), found)?;
    let [reference_name, test_name] = names.map(Path::to_string_lossy);
    let caption = |file: &str, what: &str| match file {
        "reference.png" => format!("{what}: {reference_name}"),
        "test.png" => format!("{what}: {test_name}"),
        _ => what.to_owned(),
    };
    let figure = |(file, what): &(&str, &str)| Figure { file: (*file).into(), caption: caption(file, what) };
    let pictures: Vec<Figure> = PICTURES.iter().map(figure).collect();
    let mut rows = vec![Vec::new(), Vec::new(), Vec::new()];
    pictures.into_iter().enumerate().for_each(|(i, f)| rows[[0, 0, 2, 1, 1][i]].push(f));
    let (width, height) = reference.pixels.dimensions();
    let exposures = found.flip.exposures.map_or(String::new(), |(from, to, count)| {
        format!(" FLIP looked at {count} exposures from {from:+.2} to {to:+.2} stops.")
    });
    let rows_of = |(n, v, meaning): &(&str, f64, &str)| vec![format!("{n}: {meaning}"), format!("{v:.6}")];
    let measures: Vec<Vec<String>> = found.rows().iter().map(rows_of).collect();
    let chapter = Chapter {
        title: "Differences".into(),
        html: format!("<p>{width} × {height} pixels, shown at {ev:+.2} stops.{exposures}</p>"),
        pictures: rows,
        figures: Table { columns: vec!["measure".into(), "value".into()], rows: measures },
    };
    let page = folder.join("index.html");
    page::write(&page, &format!("{test_name} against {reference_name}"), "", &[chapter])?;
    files.push(page);
    Ok(files)
}
