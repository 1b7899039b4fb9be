//! `translume field compare`.

use crate::commands::page::{self, Chapter, Figure, Table};
use crate::commands::plot::{Axis, Marks, Plot, Series, Shape};
use crate::output::Context;
use anyhow::Context as _;
use serde_json::json;
use std::path::{Path, PathBuf};
use translume_field::measure::{self, PictureError};
use translume_field::{Domain, Field, Model, Params, Rate, Relighter, Stack, compress, file};
use translume_image::{atomic, metrics, write_png8};

const EXAMPLES: &str = "\
Examples:
  Errors of a field against its pictures:
    translume field compare dome/ statue.glb

  Against pictures that were kept out, with their own .lp file:
    translume field compare dome/ statue.glb --lights held-out.lp

  A page with the plots and pictures of the thesis, for this stack:
    translume field compare dome/ statue.glb --report statue-report";

/// Measure how far a field is from the pictures of a stack
///
/// Pictures are compared as a display shows them: exposed by the stack's white, gamma 2.2, clipped. A field that was made
/// from these lights is taken at its own weights, any other one is interpolated to the stack's lights.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    #[command(flatten)]
    source: super::StackArgs,
    /// The field
    field: PathBuf,
    /// Write index.html with the error by number of terms, of log and linear PCA, and pictures side by side (made if it is
    /// not there)
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
}

pub(crate) fn run(args: &Args, ctx: &Context) -> anyhow::Result<()> {
    let field = file::read(&args.field)?;
    let bytes = std::fs::metadata(&args.field)?.len();
    let mut stack = args.source.open()?;
    let bar = ctx.progress(stack.shots.len() as u64, "comparing");
    if let Some(folder) = &args.report {
        ctx.protect(&args.source.files(&stack).into_iter().chain([&*args.field]).collect::<Vec<_>>(), &[folder])?;
    }
    let own = measure::is_own(&field, &stack);
    let errors = measure::compare(&field, &mut stack, &|| bar.inc(1))?;
    for warning in &stack.warnings {
        ctx.warn(warning);
    }
    let rms = (errors.iter().map(|e| e.rms * e.rms).sum::<f64>() / errors.len() as f64).sqrt();
    let mean = |f: fn(&PictureError) -> f64| errors.iter().map(f).sum::<f64>() / errors.len() as f64;
    let worst = errors.iter().max_by(|a, b| a.rms.total_cmp(&b.rms)).context("no pictures")?;
    let flip = flip(&field, &stack, worst.light)?;
    let source = source_bytes(&stack);
    let mut object = json!({
        "pictures": errors.len(),
        "own_lights": own,
        "rms": rms,
        "psnr": mean(|e| e.psnr),
        "log_rms": mean(|e| e.log_rms),
        "flip_of_worst": flip,
        "worst": { "file": stack.shots[worst.light].path, "rms": worst.rms, "psnr": worst.psnr },
        "bytes": bytes,
        "bytes_per_texel": field.texture_bytes() as f64 / (field.width * field.height) as f64,
        "ratio_to_half_floats": (6 * stack.pixels() * stack.shots.len()) as f64 / bytes as f64,
        "ratio_to_files": source as f64 / bytes as f64,
        "errors": errors.iter().map(|e| json!({ "file": stack.shots[e.light].path, "rms": e.rms, "psnr": e.psnr, "log_rms": e.log_rms })).collect::<Vec<_>>(),
    });
    if let Some(dir) = &args.report {
        object["report"] = report(dir, &field, &mut stack, &errors, rms, bytes, ctx)?;
    }
    ctx.text(format_args!(
        "RMS {rms:.5}, PSNR {:.2} dB, RMS of the logarithm {:.4}, FLIP {flip:.4} of the worst picture ({})\n\
         {bytes} bytes: {:.1}:1 of half floats, {:.1}:1 of the files{}",
        mean(|e| e.psnr),
        mean(|e| e.log_rms),
        stack.shots[worst.light].path.display(),
        (6 * stack.pixels() * stack.shots.len()) as f64 / bytes as f64,
        source as f64 / bytes as f64,
        if own { "" } else { "; lights other than the field's own: interpolated" }
    ))?;
    ctx.emit_json(object)
}

fn source_bytes(stack: &Stack) -> u64 {
    stack.shots.iter().filter_map(|s| std::fs::metadata(&s.path).ok()).map(|m| m.len()).sum()
}

/// Light of picture `i` as the field gives it, relative to white.
fn relit(relighter: &Relighter<'_>, field: &Field, stack: &Stack, i: usize) -> Vec<f32> {
    let own = field.mix_of_light(i).filter(|_| measure::is_own(field, stack));
    let mix = own.unwrap_or_else(|| relighter.mix_of(&stack.shots[i]));
    relighter.picture(&mix).into_iter().map(|v| v / field.white).collect()
}

/// Mean FLIP of one picture on a display.
fn flip(field: &Field, stack: &Stack, i: usize) -> anyhow::Result<f64> {
    let relighter = Relighter::new(field)?;
    let shown = |v: Vec<f32>| v.into_iter().map(measure::shown).collect::<Vec<f32>>();
    let (truth, got) = (shown(stack.read(i)?), shown(relit(&relighter, field, stack, i)));
    let ppd = translume_image::compare::CompareParams::default().ppd;
    Ok(metrics::flip_ldr(&truth, &got, stack.width, ppd).mean())
}

/// The page: Fig. 4.2 and 4.3 of the thesis for this stack and field.
fn report(
    dir: &Path,
    field: &Field,
    stack: &mut Stack,
    errors: &[PictureError],
    rms: f64,
    bytes: u64,
    ctx: &Context,
) -> anyhow::Result<serde_json::Value> {
    std::fs::create_dir_all(dir).with_context(|| format!("cannot make the folder {}", dir.display()))?;
    let most = 24.min(stack.shots.len());
    let bar = ctx.progress(4 * stack.shots.len() as u64, "report");
    let log = measure::curve(stack, Domain::THESIS, most, &|| bar.inc(1))?;
    let linear = measure::curve(stack, Domain::Linear, most, &|| bar.inc(1))?;
    // The thesis' two methods at as many terms as the field has bytes for, 4 bits a texel and term.
    let equal = (field.texture_bytes() / translume_field::texture::Codec::Bc1.bytes(field.width, field.height)).max(1);
    let terms = equal.min(most);
    atomic::write_bytes(&dir.join("rms.svg"), plot(&log, &linear, (equal, rms)).as_bytes())?;
    let mut others = Vec::new();
    for (name, model) in [("linear PCA", Model::LinearPca), ("log PCA", Model::LogPca)] {
        let params = Params { model, rate: Rate::Terms(terms), ..Params::default() };
        others.push((name, compress(stack, &params, &|_| bar.inc(1))?));
    }
    let mut order: Vec<&PictureError> = errors.iter().collect();
    order.sort_by(|a, b| a.rms.total_cmp(&b.rms));
    let mut rows = vec![vec![Figure { file: "rms.svg".into(), caption: "RMS by number of terms".into() }]];
    for (what, error) in [("median", order[order.len() / 2]), ("worst", order[order.len() - 1])] {
        let mut row = Vec::new();
        let i = error.light;
        let mut add = |name: &str, light: &[f32]| -> anyhow::Result<()> {
            let file = format!("{what}-{}.png", name.replace(' ', "-"));
            let bytes: Vec<u8> = light.iter().map(|v| (measure::shown(*v) * 255.0 + 0.5) as u8).collect();
            write_png8(&dir.join(&file), (stack.width, stack.height), &bytes)?;
            row.push(Figure { file, caption: format!("{what} picture: {name}") });
            Ok(())
        };
        add(others[0].0, &relit(&Relighter::new(&others[0].1)?, &others[0].1, stack, i))?;
        add("as photographed", &stack.read(i)?)?;
        add(others[1].0, &relit(&Relighter::new(&others[1].1)?, &others[1].1, stack, i))?;
        add("this field", &relit(&Relighter::new(field)?, field, stack, i))?;
        rows.push(row);
    }
    let mut table =
        Table { columns: vec!["".into(), "bytes a texel".into(), "RMS".into(), "PSNR, dB".into()], rows: Vec::new() };
    let mut line = |name: String, f: &Field, errors: &[PictureError]| {
        let rms = (errors.iter().map(|e| e.rms * e.rms).sum::<f64>() / errors.len() as f64).sqrt();
        let psnr = errors.iter().map(|e| e.psnr).sum::<f64>() / errors.len() as f64;
        let size = f.texture_bytes() as f64 / (f.width * f.height) as f64;
        table.rows.push(vec![name, format!("{size:.2}"), format!("{rms:.5}"), format!("{psnr:.2}")]);
    };
    line(format!("this field, {} layers", field.layers.len()), field, errors);
    for (name, other) in &others {
        line(format!("{name}, {terms} terms in BC1"), other, &measure::compare(other, stack, &|| {})?);
    }
    let chapter = Chapter {
        title: format!("{} × {}, {} lights, {bytes} bytes", field.width, field.height, stack.shots.len()),
        html: "<p>Errors of what a display shows (white of the stack, gamma 2.2). The curves are decompositions in floats, \
               nothing quantised; the point is this field as it is in its file, at as many terms of 4 bits a texel as it has bytes.</p>"
            .into(),
        pictures: rows,
        figures: table,
    };
    let introduction = format!("<p>Made by <code>{}</code>.</p>", page::escape(&ctx.command_line));
    page::write(&dir.join("index.html"), "A field and its stack", &introduction, &[chapter])?;
    ctx.note(format_args!("report in {}", dir.join("index.html").display()));
    Ok(json!({ "page": dir.join("index.html"), "rms_log_pca": log, "rms_linear_pca": linear }))
}

/// Error curves on a logarithmic scale, as SVG.
fn plot(log: &[f64], linear: &[f64], (terms, rms): (usize, f64)) -> String {
    let values = || log.iter().chain(linear).copied().chain([rms]).filter(|v| *v > 0.0);
    let low = values().fold(f64::INFINITY, f64::min).max(1e-6).log10().floor();
    let high = values().fold(0.0, f64::max).max(1e-5).log10().ceil().max(low + 1.0);
    let most = log.len().max(linear.len()).max(terms).max(2) as f64;
    let points = |curve: &[f64]| curve.iter().enumerate().map(|(i, v)| [i as f64 + 1.0, v.max(1e-6)]).collect();
    let curve = |name, color, values| Series { name, color, points: points(values), shape: Shape::Curve };
    let own = [[terms as f64, rms.max(1e-6)]];
    let plot = Plot {
        x: Axis { title: "terms", range: (1.0, most), marks: Marks::Every(4.0) },
        y: Axis { title: "RMS", range: (10f64.powf(low), 10f64.powf(high)), marks: Marks::Decades },
        series: vec![
            curve("log PCA", "#1663a6", log),
            curve("linear PCA", "#b5541c", linear),
            Series { name: "this field", color: "#2a7d2e", points: own.to_vec(), shape: Shape::Dots(5.0) },
        ],
    };
    plot.svg()
}
