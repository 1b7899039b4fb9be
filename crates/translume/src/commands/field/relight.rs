//! `translume field relight`.

use super::super::target::Kind;
use crate::cli::Usage;
use crate::output::Context;
use serde_json::json;
use std::path::{Path, PathBuf};
use translume_field::{Relighter, environment, file, lights::normalised};
use translume_image::{ExrOptions, Picture, Rgb32FImage, read_picture, write_exr, write_hdr, write_pfm, write_png8};

const EXAMPLES: &str = "\
Examples:
  A light from the upper left:
    translume field relight statue.glb --light -0.5,0.5,0.7 -o lit.exr

  Two lights, one of them warm, as a display shows them:
    translume field relight statue.glb --light -0.5,0.5,0.7 --light 1,0,1:1,0.8,0.5 -o lit.png

  A round light of 20 degrees:
    translume field relight statue.glb --light 0,0,1 --size 20 -o soft.exr

  A BTF seen from the right:
    translume field relight cloth.glb --light 0,0.5,1 --view 0.5,0,1 -o cloth.exr

  An environment map, its centre behind the camera:
    translume field relight statue.glb --env studio.exr -o studio-lit.exr";

/// Light a field by directions, area lights or an environment map
///
/// The result is linear light: one directional light gives what the stack's pictures show. Light adds up, so several
/// lights are the sum of their pictures.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    /// A field
    field: PathBuf,
    /// Direction to a light, x right, y up, z to the camera, and its colour (1,1,1 is a light of the stack) after a colon
    #[arg(long = "light", value_name = "X,Y,Z[:R,G,B]", value_parser = light, allow_hyphen_values = true)]
    lights: Vec<Light>,
    /// Environment map (longitude and latitude), light from all around
    #[arg(long, value_name = "MAP")]
    env: Option<PathBuf>,
    /// Direction to the camera, for fields of pictures from several views [default: along the normal, 0,0,1]
    #[arg(long, value_name = "X,Y,Z", value_parser = view, allow_hyphen_values = true)]
    view: Option<[f32; 3]>,
    /// Diameter of the lights in degrees; the light is spread evenly over the disc
    #[arg(long, value_name = "DEG", default_value_t = 0.0)]
    size: f32,
    /// Make it this many stops brighter
    #[arg(long, value_name = "STOPS", default_value_t = 0.0, allow_negative_numbers = true)]
    ev: f32,
    /// Output: .exr, .hdr or .pfm for linear light, .png for 8 bits sRGB, white as in the stack
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

#[derive(Clone, Copy, Debug)]
struct Light {
    direction: [f32; 3],
    colour: [f32; 3],
}

fn light(text: &str) -> Result<Light, String> {
    let triple = |text: &str| -> Option<[f32; 3]> {
        let v: Vec<f32> = text.split(',').map(|w| w.trim().parse().ok()).collect::<Option<_>>()?;
        <[f32; 3]>::try_from(v).ok().filter(|v| v.iter().all(|x| x.is_finite()))
    };
    let (direction, colour) = text.split_once(':').unwrap_or((text, "1,1,1"));
    let direction = triple(direction).and_then(normalised).ok_or("a direction x,y,z is wanted")?;
    let colour = triple(colour).filter(|c| c.iter().all(|v| *v >= 0.0)).ok_or("a colour r,g,b is wanted")?;
    Ok(Light { direction, colour })
}

fn view(text: &str) -> Result<[f32; 3], String> {
    light(text).map(|l| l.direction)
}

pub(crate) fn run(args: &Args, ctx: &Context) -> anyhow::Result<()> {
    if args.lights.is_empty() && args.env.is_none() {
        return Err(Usage("give --light or --env".into()).into());
    }
    if !(0.0..=180.0).contains(&args.size) {
        return Err(Usage("--size must lie between 0 and 180 degrees".into()).into());
    }
    let kind = Kind::of(&args.output, &[Kind::Exr, Kind::Hdr, Kind::Pfm, Kind::Png], "picture")?;
    let inputs: Vec<&Path> = std::iter::once(&args.field).chain(&args.env).map(std::path::PathBuf::as_path).collect();
    ctx.claim(&inputs, &[&args.output])?;
    let field = file::read(&args.field)?;
    if args.view.is_some() && field.views().is_empty() {
        return Err(Usage("--view: all pictures of this field have one view".into()).into());
    }
    let relighter = Relighter::new(&field)?;
    let mut all: Vec<([f32; 3], [f32; 3])> = Vec::new();
    for l in &args.lights {
        all.extend(environment::disc(l.direction, args.size.to_radians(), l.colour));
    }
    let mut beyond = 0.0;
    if let Some(path) = &args.env {
        let mut map = read_picture(path)?;
        if map.clear_non_finite() > 0 {
            ctx.warn(format_args!("{}: values that are NaN or infinite are taken for 0", path.display()));
        }
        let (w, h) = map.pixels.dimensions();
        let found = environment::from_map(map.pixels.as_raw(), (w as usize, h as usize), field.lights());
        beyond = found.beyond;
        if beyond > 0.05 {
            ctx.warn(format_args!(
                "{}: {:.0} % of its light comes from where the stack has no lights and is left out",
                path.display(),
                100.0 * beyond
            ));
        }
        all.extend(found.lights);
    }
    let mut sum = vec![0.0f32; 3 * field.width * field.height];
    let bar = ctx.progress(all.len() as u64, "relighting");
    for (direction, colour) in &all {
        relighter.add_picture(&relighter.mix_seen(*direction, args.view.unwrap_or([0.0, 0.0, 1.0])), *colour, &mut sum);
        bar.inc(1);
    }
    let gain = args.ev.exp2();
    sum.iter_mut().for_each(|v| *v *= gain);
    write(&args.output, kind, sum, &field, ctx)?;
    ctx.done(&args.output, format_args!("{} × {} pixels under {} directions", field.width, field.height, all.len()))?;
    ctx.emit_json(json!({
        "output": args.output,
        "width": field.width,
        "height": field.height,
        "directions": all.len(),
        "light_left_out": beyond,
    }))
}

fn write(path: &Path, kind: Kind, rgb: Vec<f32>, field: &translume_field::Field, ctx: &Context) -> anyhow::Result<()> {
    let (w, h) = (field.width, field.height);
    if kind == Kind::Png {
        let code =
            |v: &f32| (translume_image::colour::linear_to_srgb(v / field.white).clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        return Ok(write_png8(path, (w, h), &rgb.iter().map(code).collect::<Vec<_>>())?);
    }
    let pixels = Rgb32FImage::from_raw(w as u32, h as u32, rgb);
    let picture = Picture::new(pixels.ok_or_else(|| anyhow::anyhow!("{}: no pixels", path.display()))?);
    match kind {
        Kind::Hdr => write_hdr(path, &picture)?,
        Kind::Pfm => write_pfm(path, &picture)?,
        _ => {
            let software = Some(format!("translume {}", env!("CARGO_PKG_VERSION")));
            let options = ExrOptions { software, command: Some(ctx.command_line.clone()), ..ExrOptions::default() };
            write_exr(path, &picture, &options)?;
        }
    }
    Ok(())
}
