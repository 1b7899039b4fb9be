//! `translume scatter simulate`: virtual captures.

use crate::cli::Usage;
use crate::output::Context;
use anyhow::anyhow;
use serde_json::json;
use std::path::{Path, PathBuf};
use translume_scatter::simulate::{CaptureParams, Procedural, capture_slab};

const EXAMPLES: &str = "\
Examples:
  An 8 by 8 grid of laser positions on marble:
    translume scatter simulate marble -o capture/

  The same with a rough surface and a laser that drifts by 5 %:
    translume scatter simulate marble --rough --drift 0.05 -o capture/

  A small one to look at:
    translume scatter simulate wax --spots 2 --pixels 24 --photons 20000 -o small/";

/// Capture a slab of a heterogeneous medium with a virtual laser and camera
///
/// A random walk of photons finds the light that leaves the slab around each laser position; a perspective camera with
/// noise sees it. The result is a capture set: rig.json, mesh.ply and the frames as a Zarr array.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(super) struct Args {
    /// The medium
    #[arg(value_enum, value_name = "MEDIUM")]
    medium: Name,
    /// Folder of the capture, which must not exist
    #[arg(short, long, value_name = "CAPTURE")]
    output: PathBuf,
    /// Laser positions along each side of a square
    #[arg(long, value_name = "N", default_value_t = 8)]
    spots: usize,
    /// Distance between them
    #[arg(long, value_name = "MM", default_value_t = 1.0)]
    spacing: f64,
    /// Diameter of the beam at 1/e²
    #[arg(long, value_name = "MM", default_value_t = 2.0)]
    beam: f64,
    /// Columns and rows of a frame
    #[arg(long, value_name = "N", default_value_t = 48)]
    pixels: usize,
    /// Width of the object in a frame
    #[arg(long, value_name = "MM", default_value_t = 24.0)]
    field: f64,
    /// Positions of the turntable
    #[arg(long, value_name = "N", default_value_t = 1)]
    views: usize,
    /// Thickness of the slab
    #[arg(long, value_name = "MM", default_value_t = 16.0)]
    thickness: f64,
    /// Index of refraction
    #[arg(long, value_name = "ETA", default_value_t = 1.5)]
    eta: f64,
    /// A surface that diffuses, instead of a smooth one
    #[arg(long)]
    rough: bool,
    /// Photons for each laser position
    #[arg(long, value_name = "N", default_value_t = 400_000)]
    photons: usize,
    /// Dynamic range of the camera; without it, it has no noise
    #[arg(long, value_name = "DB", default_value_t = 120.0)]
    dynamic_range: f64,
    /// A camera without noise
    #[arg(long)]
    noise_free: bool,
    /// Rig error: deviation of the laser's power from frame to frame, relative
    #[arg(long, value_name = "FRACTION", default_value_t = 0.0)]
    drift: f64,
    /// Rig error: deviation of the cameras' aim
    #[arg(long, value_name = "MM", default_value_t = 0.0)]
    misregistration: f64,
    /// Rig error: deviation of the laser's hits
    #[arg(long, value_name = "MM", default_value_t = 0.0)]
    peak_shift: f64,
    /// Rig error: deviation of the heights of the mesh
    #[arg(long, value_name = "MM", default_value_t = 0.0)]
    geometry_error: f64,
    /// Pattern of the medium
    #[arg(long, value_name = "N", default_value_t = 1)]
    pattern: u64,
    /// Seed of light, noise and errors
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Name {
    /// Clear matrix with dark, dense veins
    Marble,
    /// A pigmented skin over fibrous flesh
    Apple,
    /// Walls around pores that scatter little
    Sponge,
    /// Pressed chunks of waxes of different colour
    Wax,
    /// Fine grains, strongly absorbing
    Stone,
    /// Marble's matrix alone
    Homogeneous,
}

impl Name {
    fn procedural(self) -> Procedural {
        match self {
            Self::Marble => Procedural::Marble,
            Self::Apple => Procedural::Apple,
            Self::Sponge => Procedural::Sponge,
            Self::Wax => Procedural::Wax,
            Self::Stone => Procedural::Stone,
            Self::Homogeneous => Procedural::Homogeneous,
        }
    }
}

fn params(args: &Args) -> anyhow::Result<CaptureParams> {
    let usage = |what: String| Err(Usage(what).into());
    for (name, n, most) in [
        ("--spots", args.spots, 256),
        ("--pixels", args.pixels, 4096),
        ("--views", args.views, 360),
        ("--photons", args.photons, 1 << 40),
    ] {
        if !(1..=most).contains(&n) {
            return usage(format!("{name} {n}: it must lie between 1 and {most}"));
        }
    }
    let lengths = [
        ("--spacing", args.spacing),
        ("--beam", args.beam),
        ("--field", args.field),
        ("--thickness", args.thickness),
        ("--dynamic-range", args.dynamic_range),
    ];
    if let Some((name, x)) = lengths.into_iter().find(|(_, x)| !(x.is_finite() && (1e-3..=1e4).contains(x))) {
        return usage(format!("{name} {x}: it must lie between 0.001 and 10000"));
    }
    let errors = [
        ("--drift", args.drift),
        ("--misregistration", args.misregistration),
        ("--peak-shift", args.peak_shift),
        ("--geometry-error", args.geometry_error),
    ];
    if let Some((name, x)) = errors.into_iter().find(|(_, x)| !(0.0..=100.0).contains(x)) {
        return usage(format!("{name} {x}: it must be 0 or a positive deviation"));
    }
    if !(1.0..=4.0).contains(&args.eta) {
        return usage(format!("--eta {}: an index of refraction lies between 1 and 4", args.eta));
    }
    Ok(CaptureParams {
        spots: args.spots,
        spacing_mm: args.spacing,
        beam_diameter_mm: args.beam,
        pixels: args.pixels,
        field_mm: args.field,
        views: args.views,
        thickness_mm: args.thickness,
        eta: args.eta,
        rough: args.rough,
        photons: args.photons,
        dynamic_range_db: if args.noise_free { f64::INFINITY } else { args.dynamic_range },
        drift: args.drift,
        misregistration_mm: args.misregistration,
        peak_shift_mm: args.peak_shift,
        geometry_error_mm: args.geometry_error,
        seed: args.seed,
        ..CaptureParams::default()
    })
}

pub(super) fn run(args: &Args, ctx: &Context) -> anyhow::Result<()> {
    let params = params(args)?;
    if args.output.exists() {
        return Err(anyhow!("{}: it exists; choose another name or remove it", args.output.display()));
    }
    let parent = args.output.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let beside = tempfile::Builder::new().prefix(".translume-").tempdir_in(parent);
    let beside = beside.map_err(|e| anyhow!("{}: {e}", parent.display()))?;
    let folder = beside.path().join("capture");
    let positions = params.spots * params.spots;
    let bar = ctx.progress(positions as u64, "shining");
    let label = json!({ "medium": format!("{:?}", args.medium).to_lowercase(), "pattern": args.pattern, "command": ctx.command_line });
    let medium = args.medium.procedural().build(args.pattern);
    let capture = capture_slab(&folder, &medium, &params, label, || bar.inc(1))?;
    std::fs::rename(&folder, &args.output).map_err(|e| anyhow!("{}: {e}", args.output.display()))?;
    let frames: usize = capture.frames.shape[..3].iter().product();
    ctx.text(format!("{}: {frames} frames of {} × {} pixels", args.output.display(), params.pixels, params.pixels))?;
    ctx.emit_json(json!({ "output": args.output.to_string_lossy(), "frames": frames, "positions": positions,
        "noise_floor": capture.rig.channels[0].noise_floor }))
}
