//! `translume field`: stacks of pictures under many lights, compressed, relit, compared.

mod compare;
mod compress;
mod exchange;
mod relight;

use crate::output::Context;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use translume_field::{Angular, Domain, Field, Source, Stack, file, sphere::Kernel};

/// Where the pictures and their lights are.
#[derive(Debug, clap::Args)]
pub(crate) struct StackArgs {
    /// Folder with the pictures
    #[arg(value_name = "DIR")]
    stack: PathBuf,
    /// List of light directions [default: the one in the folder]
    #[arg(long, value_name = "FILE")]
    lights: Option<PathBuf>,
    /// Directions are in the names of the pictures: a pattern with {x}, {y} and {z}, or {theta} (degrees from the view) and {phi}
    /// (degrees from the right over the top), and {*} for anything
    #[arg(long, value_name = "PATTERN", conflicts_with = "lights")]
    names: Option<String>,
    /// 8 and 16-bit pictures hold light as it is, not codes for a display
    #[arg(long)]
    linear_codes: bool,
}

impl StackArgs {
    fn open(&self) -> translume_field::Result<Stack> {
        let source = Source { list: self.lights.clone(), names: self.names.clone(), linear: self.linear_codes };
        Stack::open_as(&self.stack, &source)
    }

    /// What is read of `stack`, for outputs to stay away from.
    fn files<'a>(&'a self, stack: &'a Stack) -> Vec<&'a Path> {
        stack.shots.iter().map(|s| &s.path).chain(&self.lights).map(PathBuf::as_path).collect()
    }
}

const INFO_EXAMPLES: &str = "\
Examples:
  Say what a field holds:
    translume field info statue.glb

  Its bytes a texel, for a script:
    translume field info statue.glb --json | jq .bytes_per_texel";

/// Compress pictures of one view under many lights, and relight them
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Args {
    Compress(compress::Args),
    Relight(relight::Args),
    Info(InfoArgs),
    Compare(compare::Args),
    Lights(exchange::LightsArgs),
    Import(exchange::ImportArgs),
    Export(exchange::ExportArgs),
}

/// Say what a field holds: size, model, layers, bytes, lights
#[derive(Debug, clap::Args)]
#[command(after_long_help = INFO_EXAMPLES)]
pub(crate) struct InfoArgs {
    /// A field that `field compress` wrote
    field: PathBuf,
}

pub(crate) fn run(args: Args, ctx: &Context) -> anyhow::Result<()> {
    match args {
        Args::Compress(args) => compress::run(&args, ctx),
        Args::Relight(args) => relight::run(&args, ctx),
        Args::Info(args) => info(&args, ctx),
        Args::Compare(args) => compare::run(&args, ctx),
        Args::Lights(args) => exchange::lights(&args, ctx),
        Args::Import(args) => exchange::import(&args, ctx),
        Args::Export(args) => exchange::export(&args, ctx),
    }
}

fn info(args: &InfoArgs, ctx: &Context) -> anyhow::Result<()> {
    let field = file::read(&args.field)?;
    let bytes = std::fs::metadata(&args.field)?.len();
    let object = describe(&field, bytes);
    let mut lines = vec![format!(
        "{}: {} × {}, {} layers ({}), {bytes} bytes, {:.2} bytes a texel",
        args.field.display(),
        field.width,
        field.height,
        field.layers.len(),
        object["model"].as_str().unwrap_or_default(),
        object["bytes_per_texel"].as_f64().unwrap_or_default()
    )];
    let scale = match field.domain {
        Domain::Log { delta } => format!("ln(δ + x), δ = {delta} of white"),
        Domain::Root { delta } => format!("ln(δ + √x), δ = {delta}"),
        Domain::Linear => "linear".into(),
        Domain::Display => "sRGB curve".into(),
        Domain::Pu21 => "PU21".into(),
    };
    lines.push(format!("  scale       {scale}"));
    lines.push(format!("  white       {}", field.white));
    let what = if field.views().is_empty() { "lights" } else { "directions of light and view" };
    let between = match &field.angular {
        Angular::Basis(basis) => format!("functions of the direction: {basis:?}"),
        Angular::Lights { lights, kernel: Kernel::Gaussian { width }, .. } => {
            format!("{} {}, Gaussian of width {width:.3} between them", lights.len(), what)
        }
        Angular::Lights { lights, kernel: Kernel::Surface { rough, width, noise }, .. } => {
            format!(
                "{} {what}, between them matt surfaces, {rough} rough of width {width}, noise {noise}",
                lights.len()
            )
        }
    };
    lines.push(format!("  lights      {between}"));
    if let Some(t) = &field.tiles {
        let mean = t.slots() as f64 / t.counts.len().max(1) as f64;
        lines.push(format!(
            "  tiles       {} of 32 × 32 with up to {} layers, {mean:.1} on average",
            t.counts.len(),
            t.most()
        ));
    }
    ctx.text(lines.join("\n"))?;
    ctx.emit_json(object)
}

/// Size of a written field; what a pipe took is not known, but for its textures.
fn bytes_of(output: &Path, field: &Field) -> anyhow::Result<u64> {
    let streamed = translume_image::atomic::is_stream(output);
    Ok(if streamed { field.texture_bytes() as u64 } else { std::fs::metadata(output)?.len() })
}

/// What `--json` says of a field in a file of so many bytes.
fn describe(field: &Field, bytes: u64) -> Value {
    let texels = (field.width * field.height) as f64;
    let kernel = match &field.angular {
        Angular::Lights { kernel, .. } => json!(kernel),
        Angular::Basis(basis) => json!({ "kind": "basis", "basis": basis }),
    };
    json!({
        "model": field.model,
        "width": field.width,
        "height": field.height,
        "terms": field.layers.len(),
        "planes": field.planes(),
        "layers_by_tile": field.tiles.as_ref().map(|t| json!({
            "fewest": t.counts.iter().min(),
            "most": t.most(),
            "mean": t.slots() as f64 / t.counts.len().max(1) as f64,
            "without": t.counts.iter().filter(|c| **c == 0).count(),
        })),
        "codecs": field.layers.iter().map(|l| l.codec).collect::<Vec<_>>(),
        "scale": field.domain,
        "white": field.white,
        "lights": field.lights().len(),
        "several_views": !field.views().is_empty(),
        "interpolation": kernel,
        "bytes": bytes,
        "texture_bytes": field.texture_bytes(),
        "bytes_per_texel": field.texture_bytes() as f64 / texels,
    })
}
