//! `translume field import`, `export` and `lights`.

use crate::cli::Usage;
use crate::output::Context;
use clap::ValueEnum;
use serde_json::json;
use std::path::PathBuf;
use translume_field::basis::Basis;
use translume_field::lights::{self, Shot, pictures, to_csv, to_lp};
use translume_field::probe::{self, Ball, Surface};
use translume_field::{Stack, file, relightlab, strength};
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
    translume field lights probe/ --ball 535.9,478,421.1 --pictures objects/ -o objects/lights.lp

  A grey ball: directions and strengths:
    translume field lights dome/ --ball 80,95,40 --surface matt -o dome/lights.csv

  Directions are known, but the lamps were not equally strong; the object is mostly matt:
    translume field lights objects/ --lights light_directions.txt --strengths -o objects/lights.csv";

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
/// Writes an .lp file for `field compress`, or lights.csv with the strengths of the lights, by which pictures are divided then. Pictures of
/// the ball and of the object go together by their names (endings aside), or else in the order of the numbers in them.
#[derive(Debug, clap::Args)]
#[command(after_long_help = LIGHTS_EXAMPLES)]
pub(crate) struct LightsArgs {
    /// Folder with the pictures that show the ball
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Centre and radius of the ball in pixels; (0, 0) is the centre of the top left pixel
    #[arg(long, value_name = "X,Y,R", value_parser = ball, required_unless_present = "lights")]
    ball: Option<Ball>,
    /// List of the directions, where they are known and only strengths are wanted
    #[arg(long, value_name = "FILE", conflicts_with = "ball", requires = "strengths")]
    lights: Option<PathBuf>,
    /// Estimate how strong each light was from the pictures that the list is for, which show something mostly matt
    #[arg(long)]
    strengths: bool,
    /// For the strengths: 8 and 16-bit pictures hold light as it is, not codes for a display
    #[arg(long, requires = "strengths")]
    linear_codes: bool,
    /// What the ball is made of
    #[arg(long, value_enum, default_value = "mirror")]
    surface: SurfaceName,
    /// Folder of the pictures that the list is for, one for each of the ball [default: those of the ball]
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Output: an .lp file, or .csv with strengths
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
    super::super::target::wants_field(&args.output)?;
    ctx.claim(&[&args.folder], &[&args.output])?;
    let field = relightlab::import(&args.folder)?;
    file::write(&args.output, &field, &ctx.command_line, None)?;
    let bytes = super::bytes_of(&args.output, &field)?;
    let planes = 3 * field.layers.len();
    ctx.done(&args.output, format_args!("{} × {}, {planes} planes, {bytes} bytes", field.width, field.height))?;
    ctx.emit_json(super::describe(&field, bytes))
}

pub(super) fn export(args: &ExportArgs, ctx: &Context) -> anyhow::Result<()> {
    ctx.protect(&[&args.field], &[&args.relight])?;
    let field = file::read(&args.field)?;
    let basis = match args.basis {
        BasisName::Ptm => Basis::Ptm,
        BasisName::Hsh => Basis::Hsh,
        BasisName::Hsh4 => Basis::Hsh4,
    };
    let rms = relightlab::export(&field, basis, &args.relight, args.quality)?;
    let planes = 3 * basis.terms();
    ctx.done(&args.relight, format_args!("{planes} planes; the basis is off by up to {rms:.4} (RMS on a display)"))?;
    ctx.emit_json(json!({ "folder": args.relight, "planes": 3 * basis.terms(), "worst_rms": rms }))
}

pub(super) fn lights(args: &LightsArgs, ctx: &Context) -> anyhow::Result<()> {
    let is_csv = args.output.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv"));
    if !is_csv {
        super::super::target::wants(&args.output, "lp", "list")?;
    }
    ctx.claim(&[], &[&args.output])?;
    let listed = args.lights.iter().map(std::path::PathBuf::as_path).collect::<Vec<_>>();
    ctx.protect(&listed, &[&args.output])?;
    if args.strengths && !is_csv {
        return Err(Usage("--strengths: an .lp file cannot hold them; give an output that ends in .csv".into()).into());
    }
    let (mut shots, mut strengths) = match (&args.lights, args.ball) {
        (Some(list), _) => {
            let shots = lights::find(args.pictures.as_deref().unwrap_or(&args.folder), Some(list))?.0;
            let known = vec![1.0; shots.len()];
            (shots, known)
        }
        (None, Some(ball)) => from_ball(args, ball, ctx)?,
        (None, None) => return Err(Usage("give --ball or --lights".into()).into()),
    };
    if args.strengths {
        let stack = Stack { linear: args.linear_codes, ..Stack::of(&args.folder, shots.clone())? };
        let found = strength::estimate(&stack)?;
        strengths = found.iter().zip(&shots).map(|(found, shot)| found * shot.strength).collect();
    }
    let mean = strengths.iter().sum::<f32>() / strengths.len() as f32;
    shots.iter_mut().zip(&strengths).for_each(|(shot, s)| shot.strength = s / mean);
    let folder = args.output.parent().unwrap_or(std::path::Path::new(""));
    let text = if is_csv { to_csv(&shots, folder) } else { to_lp(&shots, folder) };
    atomic::write_bytes(&args.output, text.as_bytes())?;
    let range = strengths.iter().fold((f32::INFINITY, 0.0f32), |(l, h), s| (l.min(s / mean), h.max(s / mean)));
    let what = if is_csv { format!(", strengths from {:.2} to {:.2}", range.0, range.1) } else { String::new() };
    ctx.done(&args.output, format_args!("{} directions{what}", shots.len()))?;
    let list = shots
        .iter()
        .zip(&strengths)
        .map(|(s, strength)| json!({ "file": s.path, "direction": s.light, "strength": strength }));
    ctx.emit_json(json!({ "output": args.output, "lights": list.collect::<Vec<_>>() }))
}

/// Shots with the directions that a ball shows, and the strengths as it shows them.
fn from_ball(args: &LightsArgs, ball: Ball, ctx: &Context) -> anyhow::Result<(Vec<Shot>, Vec<f32>)> {
    let surface = if matches!(args.surface, SurfaceName::Mirror) { Surface::Mirror } else { Surface::Matt };
    let shown = pictures(&args.folder)?;
    if shown.is_empty() {
        anyhow::bail!("{}: no pictures", args.folder.display());
    }
    let named = args.pictures.as_deref().map(pictures).transpose()?.unwrap_or_else(|| shown.clone());
    let of_ball = partners(&named, &shown).ok_or_else(|| {
        Usage(format!(
            "{} pictures show the ball, {} are to be listed: as many are wanted, or the same names",
            shown.len(),
            named.len()
        ))
    })?;
    if of_ball.len() < shown.len() {
        ctx.warn(format_args!(
            "{}: {} pictures have no partner of their name and are left out",
            args.folder.display(),
            shown.len() - of_ball.len()
        ));
    }
    let bar = ctx.progress(of_ball.len() as u64, "looking");
    let mut found = Vec::new();
    for path in &of_ball {
        found.push(probe::light(path, ball, surface)?);
        bar.inc(1);
    }
    let same = |l: &probe::ProbeLight| (0..3).all(|c| (l.direction[c] - found[0].direction[c]).abs() < 0.01);
    if found.len() > 2 && found.iter().all(same) {
        let [x, y, z] = found[0].direction;
        ctx.warn(format_args!(
            "{}: every picture shows the light from the same side, ({x:.2}, {y:.2}, {z:.2}): is that the ball, and did the light move?",
            args.folder.display()
        ));
    }
    let shots = named.iter().zip(&found).map(|(p, l)| Shot::new(p.clone(), l.direction)).collect();
    Ok((shots, found.iter().map(|l| l.strength).collect()))
}

/// For each of `named` the picture of the ball: that of the same name without its ending, if all have one; else in order.
fn partners(named: &[PathBuf], shown: &[PathBuf]) -> Option<Vec<PathBuf>> {
    let same = |n: &PathBuf| shown.iter().find(|s| s.file_stem() == n.file_stem()).cloned();
    let by_name: Option<Vec<PathBuf>> = named.iter().map(same).collect();
    by_name.or_else(|| (named.len() == shown.len()).then(|| shown.to_vec()))
}
