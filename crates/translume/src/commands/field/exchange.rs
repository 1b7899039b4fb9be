//! `translume field import`, `export` and `lights`.

use crate::cli::Usage;
use crate::output::Context;
use clap::ValueEnum;
use serde_json::json;
use std::path::PathBuf;
use translume_field::basis::Basis;
use translume_field::lights::{Shot, pictures, to_lp};
use translume_field::probe::{self, Ball, Surface};
use translume_field::{file, relightlab};
use translume_image::atomic;

const IMPORT_EXAMPLES: &str = "\
Examples:
  Planes that RelightLab wrote:
    translume field import figurine-web/ -o figurine.glb";

const EXPORT_EXAMPLES: &str = "\
Examples:
  A folder that OpenLIME shows:
    translume field export statue.glb --relight statue-web

  Twelve planes instead of 27:
    translume field export statue.glb --relight statue-web --basis hsh4";

const LIGHTS_EXAMPLES: &str = "\
Examples:
  Directions from a chrome ball that is in every picture:
    translume field lights dome/ --ball 412.5,300,58 -o dome/dome.lp

  The ball was cut out into a folder of its own, in the same order:
    translume field lights probe/ --ball 535.9,521,421.1 --pictures objects/ -o objects/lights.lp

  A grey ball, directions and strengths for a script:
    translume field lights dome/ --ball 80,95,40 --surface matt -o dome.lp --json";

/// Read the coefficient planes of RelightLab (PTM, HSH) as a field
#[derive(Debug, clap::Args)]
#[command(after_long_help = IMPORT_EXAMPLES)]
pub(crate) struct ImportArgs {
    /// Folder with info.json and plane_0.jpg, plane_1.jpg, …
    folder: PathBuf,
    /// Output file
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

/// Write a field as coefficient planes that RelightLab and OpenLIME show
///
/// The field is refitted to the basis under the lights of its stack, and clipped at white: these planes hold 8 bits of
/// what a display shows.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXPORT_EXAMPLES)]
pub(crate) struct ExportArgs {
    /// A field
    field: PathBuf,
    /// Folder for info.json and the planes (made if it is not there)
    #[arg(long, value_name = "DIR")]
    relight: PathBuf,
    /// Functions of the direction
    #[arg(long, value_enum, default_value = "hsh")]
    basis: BasisName,
    /// Quality of the JPEG files, 1 to 100
    #[arg(long, value_name = "Q", default_value_t = 95, value_parser = clap::value_parser!(u8).range(1..=100))]
    quality: u8,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum BasisName {
    /// Polynomial texture map, 18 planes
    Ptm,
    /// Hemispherical harmonics to order 2, 27 planes
    Hsh,
    /// Hemispherical harmonics to order 1, 12 planes
    Hsh4,
}

/// Estimate light directions from a mirror ball or a matt ball in the pictures
///
/// Writes an .lp file for `field compress`. The pictures are taken in the order of the numbers in their names.
#[derive(Debug, clap::Args)]
#[command(after_long_help = LIGHTS_EXAMPLES)]
pub(crate) struct LightsArgs {
    /// Folder with the pictures that show the ball
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Centre and radius of the ball in pixels; (0, 0) is the centre of the top left pixel
    #[arg(long, value_name = "X,Y,R", value_parser = ball)]
    ball: Ball,
    /// What the ball is made of
    #[arg(long, value_enum, default_value = "mirror")]
    surface: SurfaceName,
    /// Folder of the pictures that the list is for, one for each of the ball [default: those of the ball]
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Output .lp file
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum SurfaceName {
    /// Chrome
    Mirror,
    /// Plaster, grey paint
    Matt,
}

fn ball(text: &str) -> Result<Ball, String> {
    let v: Option<Vec<f32>> = text.split(',').map(|w| w.trim().parse().ok()).collect();
    match v.as_deref() {
        Some(&[x, y, radius]) if radius > 1.0 && x.is_finite() && y.is_finite() && radius.is_finite() => {
            Ok(Ball { x, y, radius })
        }
        _ => Err("a centre and a radius x,y,r in pixels are wanted".into()),
    }
}

pub(super) fn import(args: &ImportArgs, ctx: &Context) -> anyhow::Result<()> {
    super::compress::prepare(&args.output)?;
    let field = relightlab::import(&args.folder)?;
    file::write(&args.output, &field, &ctx.command_line, None)?;
    let bytes = std::fs::metadata(&args.output)?.len();
    ctx.text(format_args!(
        "{}: {} × {}, {} planes, {bytes} bytes",
        args.output.display(),
        field.width,
        field.height,
        3 * field.layers.len()
    ))?;
    ctx.emit_json(super::describe(&field, bytes))
}

pub(super) fn export(args: &ExportArgs, ctx: &Context) -> anyhow::Result<()> {
    let field = file::read(&args.field)?;
    let basis = match args.basis {
        BasisName::Ptm => Basis::Ptm,
        BasisName::Hsh => Basis::Hsh,
        BasisName::Hsh4 => Basis::Hsh4,
    };
    let rms = relightlab::export(&field, basis, &args.relight, args.quality)?;
    ctx.text(format_args!(
        "{}: {} planes; the basis is off by up to {rms:.4} (RMS of a picture on a display)",
        args.relight.display(),
        3 * basis.terms()
    ))?;
    ctx.emit_json(json!({ "folder": args.relight, "planes": 3 * basis.terms(), "worst_rms": rms }))
}

pub(super) fn lights(args: &LightsArgs, ctx: &Context) -> anyhow::Result<()> {
    super::compress::prepare(&args.output)?;
    let surface = if matches!(args.surface, SurfaceName::Mirror) { Surface::Mirror } else { Surface::Matt };
    let shown = pictures(&args.folder)?;
    let named = args.pictures.as_deref().map(pictures).transpose()?.unwrap_or_else(|| shown.clone());
    if shown.is_empty() || shown.len() != named.len() {
        let what =
            format!("{} pictures show the ball, {} are to be listed: there must be as many", shown.len(), named.len());
        return Err(if shown.is_empty() {
            anyhow::anyhow!("{}: no pictures", args.folder.display())
        } else {
            Usage(what).into()
        });
    }
    let bar = ctx.progress(shown.len() as u64, "looking");
    let mut found = Vec::new();
    for path in &shown {
        found.push(probe::light(path, args.ball, surface)?);
        bar.inc(1);
    }
    let shots: Vec<Shot> =
        named.iter().zip(&found).map(|(p, l)| Shot { path: p.clone(), light: l.direction, view: None }).collect();
    let folder = args.output.parent().unwrap_or(std::path::Path::new(""));
    atomic::write_bytes(&args.output, to_lp(&shots, folder).as_bytes())?;
    ctx.text(format_args!("{}: {} directions", args.output.display(), shots.len()))?;
    let list = shots
        .iter()
        .zip(&found)
        .map(|(s, l)| json!({ "file": s.path, "direction": l.direction, "strength": l.strength }));
    ctx.emit_json(json!({ "output": args.output, "lights": list.collect::<Vec<_>>() }))
}
