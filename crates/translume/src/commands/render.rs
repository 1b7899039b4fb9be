//! `translume render`: a scene becomes a picture.

use super::camera_path;
use super::target::{self, Kind};
use crate::cli::Usage;
use crate::output::Context;
use crate::signals;
use anyhow::{Context as _, anyhow};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use translume_image::colour::linear_to_srgb;
use translume_image::{ExrOptions, Precision, atomic, write_exr_channels, write_jpeg, write_png8};
use translume_render::checkpoint::{self, Identity};
use translume_render::film::{Aov, Film};
use translume_render::integrator::{self, INTEGRATORS, Integrator, Likeness, Settings};
use translume_render::render::{Progress, Shot, Until};
use translume_render::{World, fingerprint};
use translume_scene::sensor::Sensor;

const EXAMPLES: &str = "\
Examples:
  With as many samples as the scene asks for:
    translume render scene.xml -o out.exr

  For one minute, with a preview to look at meanwhile:
    translume render scene.xml -o out.exr --time 60s --preview now.png

  Caustics through glass, by all strategies from both ends:
    translume render scene.xml -o out.exr --integrator bdpt --spp 256

  By photon mapping, everything as it is in the map:
    translume render scene.xml -o out.exr --integrator photonmap --option gather=false --option direct=map

  Many lights in many rooms, by the generalized kernel method:
    translume render scene.xml -o out.exr --integrator gkernel --spp 16

  The same with 15 light passes, four camera paths a pixel in each:
    translume render scene.xml -o out.exr --integrator gkernel --steps 15 --spp 60

  A quick look, without noise:
    translume render scene.xml -o noisy.exr --spp 16 --denoise clean.exr

  A walk through a scene with many lights (docs/examples/camera-path.json is such a file):
    translume render scene.xml -o walk.exr --integrator gkernel --spp 16 --camera-path walk.json

  In two evenings:
    translume render scene.xml -o out.exr --time 3h --checkpoint out.tlck
    translume render scene.xml -o out.exr --time 3h --checkpoint out.tlck --resume";

/// Render a scene
///
/// The picture is linear Rec. 709 in OpenEXR with the number of samples per pixel as a channel, so that `translume merge`
/// can average renders of different seeds. Ctrl-C writes what is there and exits with 130. The same scene, options and seed give the same
/// picture for any number of threads.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    /// The scene
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// The picture, .exr
    #[arg(short, long, value_name = "OUT.exr")]
    output: PathBuf,
    /// The method [default: the scene's, or the nearest to it; path where it names none, volpath where it has media]
    #[arg(long, value_name = "NAME", value_parser = integrator_names())]
    integrator: Option<String>,
    #[arg(short = 'O', long = "option", value_name = "NAME=VALUE", value_parser = parse_define, help = "An option of the method",
        long_help = options_help())]
    options: Vec<(String, String)>,
    /// Stop after this time (such as 90s, 5m, 2h)
    #[arg(long, value_name = "TIME", value_parser = parse_time)]
    time: Option<Duration>,
    /// Samples per pixel [default: the scene's, or 64]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1 << 40))]
    spp: Option<u64>,
    /// Light passes of gkernel and gkernel-2003, which share out the samples [default: as many as samples]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1 << 40))]
    steps: Option<u64>,
    /// gkernel without its small bias: converges to what path finds; slower
    #[arg(long)]
    unbiased: bool,
    /// Width and height in pixels [default: the scene's]
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    size: Option<[u32; 2]>,
    /// Seed of the random numbers
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Longest path in segments; 0: no limit [default: the scene's]
    #[arg(long, value_name = "N")]
    max_depth: Option<u32>,
    /// Save the state of the render here, from time to time and at the end
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// Time between two checkpoints
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = parse_time, requires = "checkpoint")]
    checkpoint_every: Duration,
    /// Go on from the checkpoint if it is there
    #[arg(long, requires = "checkpoint")]
    resume: bool,
    /// Feature images as further channels
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = aov_names())]
    aov: Vec<String>,
    /// Write the picture without noise here, .exr; adds the feature images that this takes
    #[arg(long, value_name = "OUT.exr")]
    denoise: Option<PathBuf>,
    /// Take a picture from each place of this path (JSON), OUT-0000.exr and so on; gkernel keeps its light paths
    #[arg(long, value_name = "PATH.json")]
    camera_path: Option<PathBuf>,
    /// Keep a picture of how it goes here, .png or .jpg
    #[arg(long, value_name = "OUT.png")]
    preview: Option<PathBuf>,
    /// Value of a parameter of the scene file
    #[arg(long, alias = "define", value_name = "NAME=VALUE", value_parser = parse_define)]
    set: Vec<(String, String)>,
    /// Leave out what is not supported, with a warning
    #[arg(long)]
    lenient: bool,
    /// Files of a glTF scene may be in this folder, too, beside its own
    #[arg(long, value_name = "DIR", value_parser = super::folder)]
    asset_root: Vec<PathBuf>,
}

fn integrator_names() -> clap::builder::PossibleValuesParser {
    INTEGRATORS.iter().map(|e| clap::builder::PossibleValue::new(e.name).help(e.about)).collect::<Vec<_>>().into()
}

fn options_help() -> String {
    let mut text = "An option of the method; these there are:".to_owned();
    for entry in &INTEGRATORS {
        for o in entry.options {
            text += &format!("\n  {} {}={}: {}", entry.name, o.name, o.default, o.about);
        }
    }
    text
}

fn aov_names() -> clap::builder::PossibleValuesParser {
    Aov::NAMED.iter().map(|n| n.0).collect::<Vec<_>>().into()
}

fn parse_time(text: &str) -> Result<Duration, String> {
    let (number, unit) = match text.char_indices().last() {
        Some((i, 's')) => (&text[..i], 1.0),
        Some((i, 'm')) => (&text[..i], 60.0),
        Some((i, 'h')) => (&text[..i], 3600.0),
        _ => (text, 1.0),
    };
    let seconds = number.trim().parse::<f64>().ok().map(|n| n * unit).filter(|s| *s > 0.0 && *s < 1e9);
    seconds.map(Duration::from_secs_f64).ok_or_else(|| "a time above 0, such as 90s, 5m or 2h".into())
}

pub(super) fn parse_size(text: &str) -> Result<[u32; 2], String> {
    let sides = text.split_once(['x', 'X', '×']).and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    let fits = |s: &[u32; 2]| s[0] > 0 && s[1] > 0 && u64::from(s[0]) * u64::from(s[1]) <= 1 << 28;
    sides.filter(fits).ok_or_else(|| "width x height, such as 640x480, at most 2^28 pixels".into())
}

pub(super) fn parse_define(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((name, value)) if !name.is_empty() => Ok((name.trim_start_matches('$').into(), value.into())),
        _ => Err("write NAME=VALUE".into()),
    }
}

pub(crate) fn run(args: Args, ctx: &Context) -> anyhow::Result<()> {
    check_outputs(&args, ctx)?;
    let begun = Instant::now();
    let options = super::load_options(args.lenient, args.set.clone(), &args.asset_root);
    let scene = Arc::new(super::load_scene(&args.scene, &options)?);
    scene.warnings.iter().for_each(|w| ctx.warn(w));
    let read: Vec<&Path> = scene.files.iter().map(PathBuf::as_path).collect();
    ctx.protect(&read, &outputs(&args))?;
    let world = World::new(scene.clone()).with_context(|| args.scene.display().to_string())?;
    let loaded = begun.elapsed();
    let (stored, placed) = scene.triangles();
    ctx.detail(format!("{placed} triangles ({stored} stored), {} lights", world.lights().len()));
    let sensor = scene.sensors.first().ok_or_else(|| anyhow!("{}: no camera (<sensor>)", args.scene.display()))?;
    let (name, settings) = method(&args, &world, ctx);
    let method_options = with_flags(&args, &name)?;
    let integrator =
        integrator::with_options(&name, settings, &method_options).map_err(|e| Usage(format!("--option: {e}")))?;
    integrator.check(&world).with_context(|| args.scene.display().to_string())?;
    let shots = shots(&args, &world, &*integrator, sensor)?;
    let denoising = args.denoise.as_ref().map_or(&[][..], |_| &["albedo", "normal", "depth", "variance"]);
    let wanted = |name: &str| args.aov.iter().any(|a| a == name) || denoising.contains(&name);
    let aovs: Vec<Aov> = Aov::NAMED.iter().filter(|n| wanted(n.0)).map(|n| n.1).collect();
    let asked = args.spp.or(args.steps).or(if args.time.is_some() {
        None
    } else {
        Some(sensor.sample_count.unwrap_or(64).into())
    });
    let until = Until { samples: asked.unwrap_or(u64::MAX), time: args.time };
    let identity = Identity {
        fingerprint: fingerprint(&scene, &format!("{name} {settings:?} {method_options:?}")),
        seed: args.seed,
    };
    // Other methods and random numbers give the same picture in the limit; what else differs does not.
    let views = args.camera_path.as_ref().and_then(|p| std::fs::read_to_string(p).ok());
    let pictured = format!("{:?}", (settings.max_depth, settings.hide_emitters, args.size, views));
    let stop = signals::stop_flag();
    if shots.len() > 1 {
        integrator.prepare_views(&shots, &stop);
    }
    let mut frames = Vec::new();
    for (number, shot) in shots.iter().enumerate() {
        let mut film = shot.film(&aovs)?;
        if let Some(path) = args.checkpoint.as_ref().filter(|p| args.resume && p.exists()) {
            checkpoint::read(path, &mut film, &identity)?;
            ctx.note(format!("going on from {} samples per pixel", film.samples().0));
        }
        let name_of = |path: &PathBuf| match args.camera_path {
            Some(_) => camera_path::frame_name(path, number),
            None => path.clone(),
        };
        let (output, denoised) = (name_of(&args.output), args.denoise.as_ref().map(name_of));
        ctx.protect(&read, &[&*output])?;
        let scene = format!("{:016x}", fingerprint(&scene, &format!("{pictured}, view {number}")));
        let reporter = Reporter { args: &args, ctx, identity, scene, output, denoised, stop: stop.clone() };
        let progress = reporter.watch(shot, &mut film, &until)?;
        frames.push(reporter.finish(&film, &name, &progress, loaded, told(&*integrator, shot, &progress))?);
        if stop.load(Ordering::Relaxed) {
            break;
        }
    }
    let next = camera_path::frame_name(&args.output, frames.len());
    if args.camera_path.is_some() && frames.len() == shots.len() && next.exists() {
        ctx.warn(format_args!("{}: a frame of an older, longer path; this one ends before it", next.display()));
    }
    ctx.emit_json(match args.camera_path {
        Some(_) => json!({ "frames": frames }),
        None => frames.swap_remove(0),
    })
}

/// The views: the scene's camera, or along `--camera-path`.
fn shots<'a>(
    args: &Args,
    world: &'a World,
    integrator: &'a dyn Integrator,
    sensor: &Sensor,
) -> anyhow::Result<Vec<Shot<'a>>> {
    let sensors = match &args.camera_path {
        Some(path) => camera_path::read(path, sensor)?,
        None => vec![sensor.clone()],
    };
    let shot = |(number, sensor): (usize, &Sensor)| {
        let mut shot = Shot::new(world, integrator, sensor, args.size, args.seed);
        shot.view = number as u32;
        shot
    };
    Ok(sensors.iter().enumerate().map(shot).collect())
}

/// The options of the method, with what flags say: the camera paths that `--steps` leaves to each light pass.
fn with_flags(args: &Args, name: &str) -> Result<Vec<(String, String)>, Usage> {
    let mut options = args.options.clone();
    if args.unbiased && name == "gkernel" {
        options.push(("unbiased".into(), "true".into()));
    } else if args.unbiased {
        return Err(Usage(format!("--unbiased is a mode of gkernel, not of {name}")));
    }
    let Some(steps) = args.steps else { return Ok(options) };
    if !["gkernel", "gkernel-2003"].contains(&name) {
        return Err(Usage(format!("--steps are the light passes of gkernel and gkernel-2003; {name} has none")));
    }
    let samples = args.spp.unwrap_or(steps);
    if !samples.is_multiple_of(steps) {
        return Err(Usage(format!("--spp {samples} does not share out among --steps {steps}: make it a multiple")));
    }
    options.push(("eye-paths".into(), (samples / steps).to_string()));
    Ok(options)
}

/// What the method tells of its parts in this run: per part how often it was tried and contributed, and its share of the
/// picture, as the mean of luminances per sample.
fn told(integrator: &dyn Integrator, shot: &Shot, progress: &Progress) -> Value {
    let [w, h] = shot.size().map(f64::from);
    let samples = (progress.new_samples * w * h).max(1.0);
    let tally = shot.tally();
    let parts = tally.parts().map(|(i, count)| {
        json!({
            "name": integrator.part(i),
            "tried": count.tried,
            "contributed": count.contributed,
            "mean_luminance": count.sum() / samples,
        })
    });
    let facts: serde_json::Map<String, Value> =
        integrator.facts().into_iter().map(|(name, n)| (name.to_owned(), number(n))).collect();
    json!({ "strategies": parts.collect::<Vec<_>>(), "counts": facts })
}

/// Before hours of work: outputs are of the kinds that are written, and can be.
fn check_outputs(args: &Args, ctx: &Context) -> anyhow::Result<()> {
    if args.camera_path.is_some() && args.checkpoint.is_some() {
        return Err(Usage("--camera-path has no --checkpoint: frames that are done stay".into()).into());
    }
    target::wants(&args.output, "exr", "picture")?;
    args.denoise.iter().try_for_each(|p| target::wants(p, "exr", "clean picture"))?;
    args.preview.iter().try_for_each(|p| Kind::of(p, &PREVIEWS, "preview").map(drop))?;
    let outputs = outputs(args);
    if args.camera_path.is_some() && outputs.iter().any(|o| atomic::is_stream(o)) {
        return Err(Usage("--camera-path writes a file for each frame: give names of files".into()).into());
    }
    ctx.claim(&inputs(args), &outputs)
}

/// Formats of previews.
const PREVIEWS: [Kind; 2] = [Kind::Png, Kind::Jpeg];

/// The files that are written, but for frames of a path.
fn outputs(args: &Args) -> Vec<&Path> {
    let more = [&args.denoise, &args.preview, &args.checkpoint].into_iter().flatten();
    std::iter::once(&args.output).chain(more).map(PathBuf::as_path).collect()
}

/// The files that the command line names to be read.
fn inputs(args: &Args) -> Vec<&Path> {
    std::iter::once(&args.scene).chain(&args.camera_path).map(PathBuf::as_path).collect()
}

/// Whole numbers are written as such.
fn number(n: f64) -> Value {
    if n.fract() == 0.0 && n.abs() < 1e15 { (n as i64).into() } else { n.into() }
}

/// The method and its settings: the user's, else the scene's.
fn method(args: &Args, world: &World, ctx: &Context) -> (String, Settings) {
    let scene = world.scene();
    let own = Settings::of(scene);
    let wanted = scene.integrator.name.as_str();
    let nearest = integrator::nearest(wanted, world, own.camera_medium.is_some());
    if args.integrator.is_none() {
        match nearest.kind {
            Likeness::Same => {}
            Likeness::Like => {
                ctx.note(format!("the scene's integrator `{wanted}` is rendered with `{}`", nearest.name));
            }
            Likeness::Unknown => {
                let what =
                    format!("the scene's integrator `{wanted}` is not known here: rendering with `{}`", nearest.name);
                ctx.warn(what);
            }
        }
    }
    let name = args.integrator.clone().unwrap_or_else(|| nearest.name.to_owned());
    let settings = Settings { max_depth: args.max_depth.map_or(own.max_depth, |n| (n > 0).then_some(n)), ..own };
    (name, settings)
}

/// What a run tells and writes.
struct Reporter<'a> {
    args: &'a Args,
    ctx: &'a Context,
    identity: Identity,
    /// Fingerprint of what the picture is of, whatever the method.
    scene: String,
    output: PathBuf,
    denoised: Option<PathBuf>,
    stop: Arc<AtomicBool>,
}

impl Reporter<'_> {
    /// Renders, with progress, previews and checkpoints, until done or interrupted.
    fn watch(&self, shot: &Shot, film: &mut Film, until: &Until) -> anyhow::Result<Progress> {
        let stop = &self.stop;
        let bar = self.ctx.progress(1000, "rendering");
        let (mut saved, mut failure) = (Instant::now(), None);
        let progress = shot.render(film, until, stop, &mut |film, progress| {
            bar.set_position((progress.fraction * 1000.0) as u64);
            bar.set_message(tell(progress));
            let mut written = Ok(());
            if let Some(path) = &self.args.preview {
                written = preview(path, film);
            }
            if saved.elapsed() > self.args.checkpoint_every {
                written = written.and_then(|()| self.save(film));
                saved = Instant::now();
            }
            if let Err(error) = written {
                stop.store(true, Ordering::Relaxed);
                failure.get_or_insert(error);
            }
        });
        drop(bar);
        // What has been rendered is not lost with a preview that cannot be written.
        if let Some(error) = failure {
            self.picture(film)?;
            return Err(error);
        }
        if progress.fraction < 1.0 && stop.load(Ordering::Relaxed) {
            self.ctx.note("interrupted: writing what is there");
            self.ctx.cut_short();
        }
        Ok(progress)
    }

    fn save(&self, film: &Film) -> anyhow::Result<()> {
        match &self.args.checkpoint {
            Some(path) => Ok(checkpoint::write(path, film, &self.identity)?),
            None => Ok(()),
        }
    }

    fn picture(&self, film: &Film) -> anyhow::Result<()> {
        let options = ExrOptions {
            precision: Precision::Float,
            software: Some(format!("translume {}", env!("CARGO_PKG_VERSION"))),
            command: Some(self.ctx.command_line.clone()),
            seed: Some(self.args.seed),
            scene: Some(self.scene.clone()),
            ..Default::default()
        };
        let channels = film.channels();
        let channels: Vec<(&str, &[f32])> = channels.iter().map(|(name, values)| (*name, &values[..])).collect();
        let size = film.size().map(|s| s as usize);
        Ok(write_exr_channels(&self.output, (size[0], size[1]), &channels, &options)?)
    }

    fn finish(
        &self,
        film: &Film,
        integrator: &str,
        progress: &Progress,
        loaded: Duration,
        told: Value,
    ) -> anyhow::Result<Value> {
        self.picture(film)?;
        self.save(film)?;
        if let Some(path) = &self.denoised {
            let channels = film.channels();
            let channels: Vec<(&str, &[f32])> = channels.iter().map(|(name, values)| (*name, &values[..])).collect();
            let [w, h] = film.size().map(|s| s as usize);
            super::denoise::write(path, (w, h), &channels, &Default::default(), self.ctx)?;
        }
        if film.broken() > 0 {
            self.ctx.warn(format!("{} samples were not finite and count as black", film.broken()));
        }
        let seconds = progress.elapsed.as_secs_f64();
        self.ctx.done(&self.output, tell(progress))?;
        Ok(json!({
            "output": self.output.to_string_lossy(),
            "integrator": integrator,
            "size": film.size(),
            "seed": self.args.seed,
            "samples_per_pixel": film.samples().0,
            "samples_per_pixel_most": film.samples().1,
            "rays": progress.rays,
            "load_seconds": loaded.as_secs_f64(),
            "render_seconds": seconds,
            "rays_per_second": progress.rays as f64 / seconds.max(1e-9),
            "broken_samples": film.broken(),
            "strategies": told["strategies"],
            "counts": told["counts"],
        }))
    }
}

fn tell(p: &Progress) -> String {
    let rate = p.rays as f64 / p.elapsed.as_secs_f64().max(1e-9) / 1e6;
    format!("{} samples per pixel, {rate:.2} million rays/s, {:.1} s", p.samples, p.elapsed.as_secs_f64())
}

/// The picture as it would be seen, clipped at 1.
fn preview(path: &Path, film: &Film) -> anyhow::Result<()> {
    let code = |v: f32| (linear_to_srgb(v.clamp(0.0, 1.0)) * 255.0).round() as u8;
    let pixels: Vec<u8> = film.rgb().into_iter().map(code).collect();
    let [w, h] = film.size().map(|s| s as usize);
    match Kind::of(path, &PREVIEWS, "preview")? {
        Kind::Jpeg => Ok(write_jpeg(path, (w, h), &pixels, 90)?),
        _ => Ok(write_png8(path, (w, h), &pixels)?),
    }
}
