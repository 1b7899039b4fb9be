//! `translume merge`: independent renders become one.

use crate::output::Context;
use serde_json::json;
use std::path::{Path, PathBuf};
use translume_image::{ExrOptions, Precision, read_exr_channels, read_exr_parts, write_exr_channels};
use translume_render::merge::{self, Channels};

const EXAMPLES: &str = "\
Examples:
  Two machines share a picture, each with a seed of its own:
    translume render scene.xml -o a.exr --time 1h --seed 1
    translume render scene.xml -o b.exr --time 1h --seed 2
    translume merge a.exr b.exr -o both.exr";

/// Average renders of one picture
///
/// Pictures of `translume render` with different seeds are averaged by their numbers of samples, feature images too. The
/// result can be merged again.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    /// Pictures of the same size with the same channels
    #[arg(value_name = "FILE", required = true, num_args = 1..)]
    inputs: Vec<PathBuf>,
    /// The average, .exr
    #[arg(short, long, value_name = "OUT.exr")]
    output: PathBuf,
}

pub(crate) fn run(args: Args, ctx: &Context) -> anyhow::Result<()> {
    super::target::wants(&args.output, "exr", "result")?;
    let inputs: Vec<&Path> = args.inputs.iter().map(PathBuf::as_path).collect();
    ctx.claim(&inputs, &[&args.output])?;
    let mut renders: Vec<(String, Channels)> = Vec::new();
    let (mut size, mut seeds, mut scenes) = (None, Vec::new(), Vec::new());
    for path in &args.inputs {
        let planes = read_exr_channels(path, 0)?;
        let own = (planes.width, planes.height);
        anyhow::ensure!(
            *size.get_or_insert(own) == own,
            "{}: {} × {} pixels, unlike the first picture",
            path.display(),
            own.0,
            own.1
        );
        renders.push((path.display().to_string(), planes.planes));
        let parts = read_exr_parts(path)?;
        let said = |name: &str| parts.first().and_then(|p| p.texts.iter().find(|t| t.0 == name)).map(|t| t.1.clone());
        scenes.push(said("scene"));
        seeds.push(said("seed"));
    }
    let scene = one_scene(&args.inputs, &scenes, ctx)?;
    for (i, path) in args.inputs.iter().enumerate() {
        if let Some(seed) = seeds[i].as_ref().filter(|_| seeds[..i].contains(&seeds[i])) {
            ctx.warn(format!("{}: seed {seed} comes twice: the same samples count twice", path.display()));
        }
    }
    let merged = merge::merge(&renders)?;
    let channels: Vec<(&str, &[f32])> = merged.iter().map(|(name, values)| (name.as_str(), &values[..])).collect();
    let options = ExrOptions {
        precision: Precision::Float,
        software: Some(format!("translume {}", env!("CARGO_PKG_VERSION"))),
        command: Some(ctx.command_line.clone()),
        scene,
        ..Default::default()
    };
    write_exr_channels(&args.output, size.unwrap_or_default(), &channels, &options)?;
    let samples =
        merged.iter().find(|c| c.0 == merge::WEIGHT).map_or(0.0, |c| c.1.iter().copied().fold(f32::MAX, f32::min));
    ctx.done(&args.output, format_args!("{samples} samples per pixel from {} renders", args.inputs.len()))?;
    ctx.emit_json(json!({
        "output": args.output.to_string_lossy(),
        "inputs": args.inputs.len(),
        "samples_per_pixel": samples,
    }))
}

/// The fingerprint that all renders have. Files that say none, as of other programs, are taken on trust, with a warning.
fn one_scene(files: &[PathBuf], scenes: &[Option<String>], ctx: &Context) -> anyhow::Result<Option<String>> {
    let mut known = files.iter().zip(scenes).filter_map(|(file, scene)| Some((file, scene.as_ref()?)));
    let first = known.next();
    if let Some((file, (other, _))) = first.and_then(|f| Some((f.0, known.find(|k| k.1 != f.1)?))) {
        let (a, b) = (file.display(), other.display());
        anyhow::bail!("{b}: a render of another scene, camera or path length than {a}: they are not averaged");
    }
    let silent = files.iter().zip(scenes).find(|f| f.1.is_none());
    if let Some((file, _)) = silent.filter(|_| files.len() > 1) {
        ctx.warn(format_args!(
            "{}: it does not say what it is a render of; taken for the same as the others",
            file.display()
        ));
    }
    Ok(first.map(|f| f.1.clone()))
}
