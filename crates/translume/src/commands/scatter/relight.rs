//! `translume scatter relight`: models of objects under new light.

use crate::output::Context;
use anyhow::anyhow;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Instant;
use translume_image::Error;
use translume_scatter::capture::Surface;
use translume_scatter::hierarchical::{HIERARCHICAL_FORMAT, Hierarchical, load_hierarchical};
use translume_scatter::relight::{Lighting, Part, Relighter, Sources, from_vertex_model};
use translume_scatter::vertex::read_vertex_model;

const EXAMPLES: &str = "\
Examples:
  translume scatter relight model/ --lights lights.json -o picture.exr
  translume scatter relight model/ --lights lights.json --part local -o local.exr
  translume scatter relight model/ --lights lights.json --frames 20 --json -o picture.exr";

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum PartName {
    /// All light
    Whole,
    /// That of the local kernels; it may be negative, because F overestimates in places
    Local,
    /// That of the throughput between vertices
    Global,
}

/// Show a model of an object under new light
///
/// LIGHTS.json holds a view and points, spots, environments and projectors; docs/formats/lights.md describes it. Models are those of
/// `scatter fit` of captures of objects: hierarchical ones, and those with a fall-off for each vertex, which are brought into the
/// same form first. Shadows are by rays; light that a concave object throws onto itself is left out. The picture is linear radiance.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(super) struct Args {
    /// The folder of a model
    #[arg(value_name = "MODEL")]
    model: PathBuf,
    /// The lights and the view
    #[arg(long, value_name = "LIGHTS.json")]
    lights: PathBuf,
    /// The picture, .exr, or .png for a look
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Which light to show
    #[arg(long, value_enum, default_value_t = PartName::Whole)]
    part: PartName,
    /// Make the picture this many times and tell how long one takes
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    frames: u32,
}

pub(super) fn run(args: &Args, ctx: &Context) -> anyhow::Result<()> {
    super::picture::check(&args.output)?;
    let lighting = Lighting::read(&args.lights)?;
    let sources = Sources::new(&lighting.lights, args.lights.parent().unwrap_or(Path::new("")))?;
    let model = load(&args.model)?;
    let surface = Surface::new(model.mesh.clone()).ok_or_else(|| anyhow!("too many triangles"))?;
    let relighter = Relighter::new(&model, &surface, &lighting.view)
        .ok_or_else(|| anyhow!("{}: eye, target and up do not span a view", args.lights.display()))?;
    let part = match args.part {
        PartName::Whole => Part::Whole,
        PartName::Local => Part::Local,
        PartName::Global => Part::Global,
    };
    let begin = Instant::now();
    let mut picture = Vec::new();
    for _ in 0..args.frames {
        let power = sources.shine(&surface, &model.atlas, model.eta as f32);
        picture = relighter.picture(&power, part);
    }
    let seconds = begin.elapsed().as_secs_f64() / f64::from(args.frames);
    super::picture::write(&args.output, relighter.size, &picture, ctx)?;
    if args.frames > 1 {
        ctx.text(format!("{:.1} pictures per second", 1.0 / seconds))?;
    }
    ctx.emit_json(json!({
        "output": args.output.to_string_lossy(), "width": relighter.size.0, "height": relighter.size.1,
        "vertices": model.mesh.positions.len(), "kernels": model.atlas.texels.len(), "seconds_per_frame": seconds,
    }))
}

/// A model of either kind.
fn load(path: &Path) -> anyhow::Result<Hierarchical> {
    let file = path.join("model.json");
    let text = std::fs::read(&file).map_err(|e| Error::io(&file, e))?;
    let value: serde_json::Value = serde_json::from_slice(&text).map_err(|e| Error::invalid(&file, e.to_string()))?;
    match value["format"].as_str() {
        Some(HIERARCHICAL_FORMAT) => Ok(load_hierarchical(path)?.1),
        Some("translume vertex model") => vertex(path),
        Some("translume planar model") => {
            Err(anyhow!("{}: the model of a flat sample; relight takes models of objects", file.display()))
        }
        _ => Err(anyhow!("{}: not a model of translume", file.display())),
    }
}

fn vertex(path: &Path) -> anyhow::Result<Hierarchical> {
    let (head, model, mesh) = read_vertex_model(path)?;
    let made = from_vertex_model(&model, mesh, head.eta);
    made.ok_or_else(|| {
        anyhow!("{}: relighting needs a mesh with area, and one channel or red, green, blue", path.display())
    })
}
