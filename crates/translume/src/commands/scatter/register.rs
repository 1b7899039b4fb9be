//! `translume scatter register`: where the cameras and the laser of a capture were, and its white balance.

use crate::cli::Usage;
use crate::output::Context;
use anyhow::anyhow;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use translume_image::{Error, atomic, read_picture};
use translume_scatter::capture::Capture;
use translume_scatter::register::{RegisterParams, RegisterReport, register, white_balance};

const EXAMPLES: &str = "\
Examples:
  A capture with corrected poses beside the old one; its frames are linked, not copied:
    translume scatter register capture/ -o registered/

  Only the corrected description, to look at and put in the place of the old one:
    translume scatter register capture/ -o corrected.json

  White balance too, from a picture of a white target under each laser:
    translume scatter register capture/ --white red.exr green.exr blue.exr -o registered/";

/// A rig that is off by more is not expected.
const FAR_DEG: f64 = 10.0;

/// Find where the cameras and the laser of a capture really were, and its white balance
///
/// The poses in rig.json must be roughly right. Each camera is moved until the outline of the mesh is that of the object in its
/// frames; the beams of the projector are moved as one until they go through the lit points; then both are refined in turn. A flat
/// sample that fills the frames has no outline: its cameras are found by the spots, and the laser is taken to be right.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(super) struct Args {
    /// The folder of a capture
    #[arg(value_name = "CAPTURE")]
    input: PathBuf,
    /// A new folder, whose frames are hard links where the file system has them; or a file for the corrected rig.json alone
    #[arg(short, long, value_name = "FOLDER|FILE.json")]
    output: PathBuf,
    /// Pictures of a white scattering target, one under each laser in the order of the rig's channels, in linear light
    #[arg(long, value_name = "PICTURE", num_args = 1..)]
    white: Vec<PathBuf>,
    /// Take the lit points where they were seen, not where the beams meet the mesh: for mirrors that do not repeat their angles
    #[arg(long)]
    seen_hits: bool,
}

pub(super) fn run(args: &Args, ctx: &Context) -> anyhow::Result<()> {
    let alone = args.output.extension().is_some_and(|e| e == "json");
    if !alone && args.output.exists() {
        return Err(anyhow!("{}: it exists; choose another name or remove it", args.output.display()));
    }
    let inputs: Vec<&Path> = std::iter::once(&args.input).chain(&args.white).map(PathBuf::as_path).collect();
    match alone {
        true => ctx.claim(&inputs, &[&args.output])?,
        false => ctx.protect(&inputs, &[&args.output])?,
    }
    let mut capture = Capture::open(&args.input)?;
    let light = white_light(args, capture.rig.channels.len())?;
    let bar = ctx.progress(capture.rig.laser.hits_mm.len() as u64, "looking");
    let told =
        register(&mut capture, &RegisterParams { seen_hits: args.seen_hits, ..RegisterParams::default() }, || {
            bar.inc(1);
        })?;
    if !light.is_empty() {
        white_balance(&mut capture.rig, &light)?;
    }
    let registered = json!({ "command": ctx.command_line, "found": told });
    match &mut capture.rig.provenance {
        Value::Object(known) => drop(known.insert("registered".into(), registered)),
        other => *other = json!({ "captured": other, "registered": registered }),
    }
    let text = format!("{}\n", serde_json::to_string_pretty(&capture.rig)?);
    match alone {
        true => atomic::write_bytes(&args.output, text.as_bytes())?,
        false => write_folder(&args.output, &capture, &text)?,
    }
    tell(args, &capture, &told, ctx)
}

/// The light of each picture of the white target, summed over its pixels and colours.
fn white_light(args: &Args, channels: usize) -> anyhow::Result<Vec<f64>> {
    if !args.white.is_empty() && args.white.len() != channels {
        let what =
            format!("--white: the rig has {channels} channels, so it needs as many pictures, not {}", args.white.len());
        return Err(Usage(what).into());
    }
    let light = |file: &PathBuf| -> anyhow::Result<f64> {
        let picture = read_picture(file)?;
        let sum: f64 = picture.pixels.as_raw().iter().map(|&v| f64::from(v)).sum();
        let lit = sum > 0.0 && sum.is_finite();
        let what = "no white target: the picture is black or has pixels that are not finite";
        if lit { Ok(sum) } else { Err(Error::invalid(file, what).into()) }
    };
    args.white.iter().map(light).collect()
}

/// The capture with another rig: mesh and frames are hard links, or copies where there are none. All or nothing.
fn write_folder(output: &Path, capture: &Capture, rig: &str) -> anyhow::Result<()> {
    let written = atomic::write_folder(
        output,
        |_| false,
        |folder| {
            for name in [&capture.rig.mesh, &capture.rig.frames] {
                let to = folder.join(name);
                if let Some(above) = to.parent() {
                    std::fs::create_dir_all(above).map_err(|e| Error::io(output, e))?;
                }
                let from = capture.path.join(name);
                atomic::link(&from, &to).map_err(|e| Error::io(&from, e))?;
            }
            std::fs::write(folder.join("rig.json"), rig).map_err(|e| Error::io(output, e))
        },
    );
    Ok(written?)
}

fn tell(args: &Args, capture: &Capture, told: &RegisterReport, ctx: &Context) -> anyhow::Result<()> {
    let pair =
        |p: Option<[f64; 2]>, unit: &str| p.map_or("not seen".into(), |[a, b]| format!("{a:.2} → {b:.2} {unit}"));
    for (i, v) in told.views.iter().enumerate() {
        if v.outline_px.is_none() && v.spot_px.is_none() {
            ctx.warn(format!("view {i}: neither outline nor spots; its camera stays as it was"));
            continue;
        }
        ctx.text(format!(
            "view {i}: outline {} at {} places, spots {} of {}; turned by {:.2}°, moved by {:.2} mm",
            pair(v.outline_px, "px"),
            v.outline_points,
            pair(v.spot_px, "px"),
            v.spots,
            v.turned_deg,
            v.moved_mm
        ))?;
    }
    if let Some(most) = told.views.iter().map(|v| v.turned_deg).max_by(f64::total_cmp).filter(|t| *t > FAR_DEG) {
        ctx.warn(format!("a camera was turned by {most:.0}°; where rig.json is better than that, the result is wrong"));
    }
    for (i, b) in told.beams.iter().enumerate() {
        ctx.text(format!("beams of stop {i}: {} from {} lit points", pair(b.off_mm, "mm"), b.seen))?;
    }
    if told.beams.is_empty() {
        ctx.note("no outline is seen, so the laser is taken to be right");
    }
    if told.missed > 0 {
        ctx.warn(format!("{} beams go past the mesh; their hits stay as they were", told.missed));
    }
    let white: Vec<f64> = capture.rig.channels.iter().map(|c| c.white_balance).collect();
    let shown: Vec<String> = white.iter().map(|w| format!("{w:.4}")).collect();
    let kept = if args.white.is_empty() { ", as it was: no pictures of a white target" } else { "" };
    ctx.text(format!("white balance {}{kept}", shown.join(" ")))?;
    ctx.done(&args.output, format_args!("{} views, {} beams past the mesh", told.views.len(), told.missed))?;
    ctx.emit_json(json!({ "output": args.output.to_string_lossy(), "views": told.views, "beams": told.beams,
        "missed": told.missed, "white_balance": white }))
}
