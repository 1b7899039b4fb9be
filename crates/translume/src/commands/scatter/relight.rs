//! `translume scatter relight`: models of objects under new light.

use crate::cli::Usage;
use crate::output::Context;
use anyhow::anyhow;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Instant;
use translume_image::Error;
use translume_mesh::TriMesh;
use translume_scatter::capture::{Surface, rgb_of};
use translume_scatter::hierarchical::{Atlas, AtlasParams};
use translume_scatter::hierarchical::{HIERARCHICAL_FORMAT, Hierarchical, load_hierarchical};
use translume_scatter::relight::{Lighting, Part, Power, Relighter, Sight, Sources, uniform_picture, vertex_picture};
use translume_scatter::vertex::{UNIFORM_FORMAT, UniformModel, VertexModel, read_uniform_model, read_vertex_model};

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
/// `scatter fit` of captures of objects: hierarchical ones, at interactive rates, and those with fall-offs, which are summed over all
/// lit places. Shadows are by rays; light that a concave object throws onto itself is left out. The picture is linear radiance.
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
    super::picture::check(&[&args.model, &args.lights], &args.output, ctx)?;
    let lighting = Lighting::read(&args.lights)?;
    let sources = Sources::new(&lighting.lights, args.lights.parent().unwrap_or(Path::new("")))?;
    let (model, mesh, eta) = load(&args.model)?;
    let surface = Surface::new(mesh).ok_or_else(|| anyhow!("too many triangles"))?;
    let atlas = match &model {
        Loaded::Hierarchical(model) => model.atlas.clone(),
        _ => Atlas::new(&surface.mesh, &AtlasParams::default())
            .ok_or_else(|| anyhow!("{}: its mesh has no area", args.model.display()))?,
    };
    let shown = Shown::new(args, &model, (&surface, &atlas, eta), &lighting.view)?;
    let begin = Instant::now();
    let mut picture = Vec::new();
    for _ in 0..args.frames {
        let power = sources.shine(&surface, &atlas, eta as f32);
        picture = shown.picture(&power)?;
    }
    let seconds = begin.elapsed().as_secs_f64() / f64::from(args.frames);
    let view = &lighting.view;
    super::picture::write(&args.output, (view.width, view.height), &picture, ctx)?;
    let rate = if args.frames > 1 { format!(", {:.1} pictures per second", 1.0 / seconds) } else { String::new() };
    ctx.done(&args.output, format_args!("{} × {} pixels{rate}", view.width, view.height))?;
    ctx.emit_json(json!({
        "output": args.output.to_string_lossy(), "width": view.width, "height": view.height,
        "vertices": surface.mesh.positions.len(), "kernels": atlas.texels.len(), "seconds_per_frame": seconds,
    }))
}

/// A model of any kind.
enum Loaded {
    Hierarchical(Box<Hierarchical>),
    Vertex(VertexModel),
    Uniform(UniformModel),
}

/// The model, its mesh and its index of refraction.
fn load(path: &Path) -> anyhow::Result<(Loaded, TriMesh, f64)> {
    let file = path.join("model.json");
    let text = std::fs::read(&file).map_err(|e| Error::io(&file, e))?;
    let value: serde_json::Value = serde_json::from_slice(&text).map_err(|e| Error::invalid(&file, e.to_string()))?;
    Ok(match value["format"].as_str() {
        Some(HIERARCHICAL_FORMAT) => {
            let model = load_hierarchical(path)?.1;
            let (mesh, eta) = (model.mesh.clone(), model.eta);
            (Loaded::Hierarchical(Box::new(model)), mesh, eta)
        }
        Some("translume vertex model") => {
            let (head, model, mesh) = read_vertex_model(path)?;
            wants_colours(&file, &head.channels)?;
            (Loaded::Vertex(model), mesh, head.eta)
        }
        Some(UNIFORM_FORMAT) => {
            let (head, model, mesh) = read_uniform_model(path)?;
            wants_colours(&file, &head.channels)?;
            (Loaded::Uniform(model), mesh, head.eta)
        }
        Some("translume planar model") => {
            return Err(anyhow!("{}: the model of a flat sample; relight takes models of objects", file.display()));
        }
        _ => return Err(anyhow!("{}: not a model of translume", file.display())),
    })
}

/// Pictures are of red, green and blue.
fn wants_colours(file: &Path, channels: &[String]) -> anyhow::Result<()> {
    let what = || format!("channels {}: one, or red, green and blue can be relit", channels.join(", "));
    rgb_of(channels.iter().map(String::as_str)).map(drop).ok_or_else(|| Error::unsupported(file, what()).into())
}

/// A model in front of the camera.
enum Shown<'a> {
    Hierarchical(Relighter, Part),
    Other(&'a Args, &'a Loaded, (&'a Surface, &'a Atlas, f64), &'a Sight),
}

impl<'a> Shown<'a> {
    fn new(
        args: &'a Args,
        model: &'a Loaded,
        object: (&'a Surface, &'a Atlas, f64),
        view: &'a Sight,
    ) -> anyhow::Result<Self> {
        let part = match args.part {
            PartName::Whole => Part::Whole,
            PartName::Local => Part::Local,
            PartName::Global => Part::Global,
        };
        let Loaded::Hierarchical(model) = model else {
            if part != Part::Whole {
                return Err(Usage("--part: only hierarchical models have parts".into()).into());
            }
            return Ok(Self::Other(args, model, object, view));
        };
        let relighter = Relighter::new(model, object.0, view)
            .ok_or_else(|| anyhow!("{}: eye, target and up do not span a view", args.lights.display()))?;
        Ok(Self::Hierarchical(relighter, part))
    }

    fn picture(&self, power: &Power) -> anyhow::Result<Vec<[f32; 3]>> {
        let (args, made) = match self {
            Self::Hierarchical(relighter, part) => return Ok(relighter.picture(power, *part)),
            Self::Other(args, Loaded::Vertex(model), object, view) => {
                (args, vertex_picture(model, *object, power, view))
            }
            Self::Other(args, Loaded::Uniform(model), object, view) => {
                (args, uniform_picture(model, *object, power, view))
            }
            Self::Other(_, Loaded::Hierarchical(_), ..) => unreachable!("it has a relighter"),
        };
        made.ok_or_else(|| {
            anyhow!("{}: relighting needs one channel or red, green, blue, and a fall-off", args.model.display())
        })
    }
}
