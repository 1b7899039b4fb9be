//! `translume image denoise`, and the same for `translume render --denoise`.

use crate::output::Context;
use anyhow::anyhow;
use serde_json::json;
use std::path::{Path, PathBuf};
use translume_image::denoise::{DenoiseParams, Noisy, non_local_means};
use translume_image::{ExrOptions, Precision, read_exr_channels, write_exr_channels};

const EXAMPLES: &str = "\
Examples:
  A render, with what the denoiser wants to know:
    translume render scene.xml -o noisy.exr --spp 16 --aov albedo,normal,depth,variance
    translume image denoise noisy.exr -o clean.exr

  Both at once:
    translume render scene.xml -o noisy.exr --spp 16 --denoise clean.exr";

/// Take the noise out of a rendered picture
///
/// Joint non-local means: pixels are averaged with those nearby whose surroundings differ by no more than the noise, and
/// whose first surface (albedo, normal, depth) is alike. The file must hold `--aov variance`; albedo, normal and depth keep
/// textures and edges. Soft shadows and caustics that drown in noise are blurred.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    /// Picture by `translume render` with feature images, .exr
    image: PathBuf,
    /// The clean picture, .exr
    #[arg(short, long, value_name = "OUT.exr")]
    output: PathBuf,
    /// Pixels to each side that are averaged
    #[arg(long, value_name = "N", default_value_t = DenoiseParams::default().radius as u64, value_parser = clap::value_parser!(u64).range(1..=50))]
    radius: u64,
    /// Larger smooths more
    #[arg(long, value_name = "FACTOR", default_value_t = DenoiseParams::default().strength, value_parser = super::image::positive)]
    strength: f32,
}

pub(crate) fn run(args: &Args, ctx: &Context) -> anyhow::Result<()> {
    super::target::wants(&args.output, "exr", "clean picture")?;
    ctx.claim(&[&args.image], &[&args.output])?;
    let planes = read_exr_channels(&args.image, 0)?;
    let named: Vec<(&str, &[f32])> = planes.planes.iter().map(|(name, plane)| (&name[..], &plane[..])).collect();
    let params = DenoiseParams { radius: args.radius as usize, strength: args.strength };
    write(&args.output, (planes.width, planes.height), &named, &params, ctx)
        .map_err(|e| anyhow!("{}: {e}", args.image.display()))?;
    ctx.done(&args.output, format_args!("{} × {} pixels", planes.width, planes.height))?;
    ctx.emit_json(json!({ "output": args.output.to_string_lossy(), "size": [planes.width, planes.height] }))
}

/// Denoises the picture of these channels, as [`translume_render::film::Aov`] names them, into a file.
pub(crate) fn write(
    path: &Path,
    size: (usize, usize),
    channels: &[(&str, &[f32])],
    params: &DenoiseParams,
    ctx: &Context,
) -> anyhow::Result<()> {
    let plane = |name: &str| channels.iter().find(|c| c.0 == name).map(|c| c.1);
    let three = |names: [&str; 3]| match names.map(plane) {
        [Some(a), Some(b), Some(c)] => Some([a, b, c]),
        _ => None,
    };
    let rgb = three(["R", "G", "B"]).ok_or_else(|| anyhow!("there are no channels R, G, B"))?;
    let variance = three(["Variance.R", "Variance.G", "Variance.B"]);
    let variance =
        variance.ok_or_else(|| anyhow!("there is no variance: render with --aov albedo,normal,depth,variance"))?;
    let noisy = Noisy {
        size,
        rgb,
        variance,
        albedo: three(["Albedo.R", "Albedo.G", "Albedo.B"]),
        normal: three(["Ns.X", "Ns.Y", "Ns.Z"]),
        depth: plane("Z"),
    };
    if noisy.albedo.is_none() && noisy.normal.is_none() {
        ctx.warn("no feature images: edges and textures that the noise hides are blurred");
    }
    let clean = non_local_means(&noisy, params);
    let clean: Vec<(&str, &[f32])> = ["R", "G", "B"].into_iter().zip(clean.iter().map(|p| &p[..])).collect();
    let options = ExrOptions {
        precision: Precision::Float,
        software: Some(format!("translume {}", env!("CARGO_PKG_VERSION"))),
        command: Some(ctx.command_line.clone()),
        ..Default::default()
    };
    Ok(write_exr_channels(path, size, &clean, &options)?)
}
