//! `translume capture light-stage`.

use super::super::render::{parse_define, parse_size};
use crate::output::Context;
use crate::signals;
use anyhow::{Context as _, anyhow, bail};
use rayon::prelude::*;
use serde_json::{Value, json};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;
use translume_field::lights;
use translume_image::{ExrOptions, Picture, Rgb32FImage, atomic, write_exr};
use translume_render::integrator::{self, Settings};
use translume_render::light_stage::{self, Lamps, Params, Pictures};
use translume_render::render::Shot;
use translume_render::{World, fingerprint};
use translume_scene::sensor::Sensor;
use translume_scene::{Scene, glam::Vec3};

const EXAMPLES: &str = "\
Examples:
  A stack as a light stage gives it, and the field of it:
    translume capture light-stage scene.xml -o stack/
    translume field compress stack/ -o scene.glb

  A dome of 64 lamps, each 4 degrees wide, a quick look:
    translume capture light-stage scene.xml -o dome/ --lights 64 --hemisphere --angle 4 --spp 16 --size 320x240

  Going on after an interruption: the same command again, pictures that are there stay:
    translume capture light-stage scene.xml -o stack/";

/// Render one view of a scene under each of many lamps
///
/// The lamps stand far away, spread evenly over the sphere (or the half of it that the camera is in). Each is a disc that
/// gives a surface facing it an irradiance of π, so that white paper has a radiance of 1: what `field relight` takes a light of
/// strength 1 to be. The scene's own lights are put out (shapes that shone stay, dark); the camera does not see the lamps,
/// mirrors and glass do. The method is that of `path`, with one set of paths for all lamps: the noise of the pictures is
/// correlated.
///
/// The folder gets a picture for each lamp (OpenEXR, half floats, linear Rec. 709), lights.lp with the directions to the lamps
/// (x right, y up, z to the camera), and light-stage.json with what was asked for.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    /// The scene
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// Folder for the pictures (made if it is not there)
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Number of lamps
    #[arg(long, value_name = "N", default_value_t = 253, value_parser = clap::value_parser!(u32).range(1..=4096))]
    lights: u32,
    /// Lamps on the camera's side only
    #[arg(long)]
    hemisphere: bool,
    /// How wide a lamp is seen from the scene, in degrees; 0: parallel light, which smooth mirrors do not show
    #[arg(long, value_name = "DEGREES", default_value_t = 2.0, value_parser = parse_angle)]
    angle: f32,
    /// Paths per pixel
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u64).range(1..=1 << 24))]
    spp: u64,
    /// Width and height in pixels [default: the scene's]
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    size: Option<[u32; 2]>,
    /// Seed of the random numbers
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Longest path in segments; 0: no limit [default: the scene's]
    #[arg(long, value_name = "N")]
    max_depth: Option<u32>,
    /// The most that one path may bring of indirect light (white paper facing a lamp is 1): takes single bright pixels of
    /// caustics away, and makes them darker than they are [default: no limit]
    #[arg(long, value_name = "X", value_parser = parse_clamp)]
    clamp: Option<f32>,
    /// Memory for pictures under way in MiB; with less, fewer lamps are rendered at once
    #[arg(long, value_name = "MIB", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    memory: u32,
    /// Value of a parameter of the scene file
    #[arg(long, alias = "define", value_name = "NAME=VALUE", value_parser = parse_define)]
    set: Vec<(String, String)>,
    /// Leave out what is not supported, with a warning
    #[arg(long)]
    lenient: bool,
    /// Files of a glTF scene may be in this folder, too, beside its own
    #[arg(long, value_name = "DIR", value_parser = crate::commands::folder)]
    asset_root: Vec<PathBuf>,
}

/// Most lamps that are rendered at once: an interruption loses the work on them.
const GROUP: usize = 64;

fn parse_angle(text: &str) -> Result<f32, String> {
    // Below a fifth of a degree a lamp is brighter than a half float.
    let angle = text.parse::<f32>().ok().filter(|a| *a == 0.0 || (0.5..=90.0).contains(a));
    angle.ok_or_else(|| "0, or from 0.5 to 90 degrees".into())
}

fn parse_clamp(text: &str) -> Result<f32, String> {
    text.parse::<f32>().ok().filter(|x| *x > 0.0).ok_or_else(|| "a number above 0".into())
}

pub(crate) fn run(args: &Args, ctx: &Context) -> anyhow::Result<()> {
    ctx.protect(&[&args.scene], &[&args.output])?;
    let options = crate::commands::load_options(args.lenient, args.set.clone(), &args.asset_root);
    let scene = crate::commands::load_scene(&args.scene, &options)?;
    scene.warnings.iter().for_each(|w| ctx.warn(w));
    let (scene, put_out) = light_stage::unlit(&scene);
    let sensor =
        scene.sensors.first().ok_or_else(|| anyhow!("{}: no camera (<sensor>)", args.scene.display()))?.clone();
    let settings = settings(args, &scene);
    let stage = Stage::new(args, &scene, &sensor, &settings)?;
    let missing = stage.begin(ctx)?;
    if put_out > 0 {
        ctx.note(format_args!("the scene's own lights are switched off ({put_out})"));
    }
    let world = World::dark(Arc::new(scene)).with_context(|| args.scene.display().to_string())?;
    if world.has_media() {
        ctx.warn(format_args!("{}: participating media are not seen by this method", args.scene.display()));
    }
    let kept = stage.lights.len() - missing.len();
    let (rays, seconds) = stage.render(&world, &settings, &missing, ctx)?;
    let rate = rays as f64 / seconds.max(1e-9) / 1e6;
    let rendered = missing.len();
    ctx.done(
        &args.output,
        format_args!("{rendered} rendered, {kept} reused, {rate:.2} million rays/s, {seconds:.1} s"),
    )?;
    ctx.emit_json(json!({
        "output": args.output.to_string_lossy(),
        "lights": args.output.join("lights.lp").to_string_lossy(),
        "pictures": stage.lights.len(),
        "kept": kept,
        "own_lights_put_out": put_out,
        "rays": rays,
        "render_seconds": seconds,
    }))
}

fn settings(args: &Args, scene: &Scene) -> Settings {
    let own = Settings::of(scene);
    let max_depth = args.max_depth.map_or(own.max_depth, |n| (n > 0).then_some(n));
    Settings { max_depth, hide_emitters: true, camera_medium: None, ..own }
}

/// What is to be rendered, and where to.
struct Stage<'a> {
    args: &'a Args,
    sensor: &'a Sensor,
    /// Directions, x right, y up, z to the camera.
    lights: Vec<Vec3>,
    /// Everything that the pictures depend on.
    record: Value,
}

impl<'a> Stage<'a> {
    fn new(args: &'a Args, scene: &Scene, sensor: &'a Sensor, settings: &Settings) -> anyhow::Result<Self> {
        let directory = &args.output;
        std::fs::create_dir_all(directory)
            .with_context(|| format!("cannot make the folder {}", directory.display()))?;
        let lights = light_stage::spread(args.lights as usize, args.hemisphere);
        let record = json!({
            "format": "translume light stage",
            "version": "1.0",
            "scene": args.scene.file_name().map(|n| n.to_string_lossy()),
            "fingerprint": format!("{:016x}", fingerprint(scene, &format!("{settings:?}"))),
            "lights": args.lights,
            "hemisphere": args.hemisphere,
            "angle_degrees": args.angle,
            "clamp": args.clamp,
            "irradiance": std::f32::consts::PI,
            "samples_per_pixel": args.spp,
            "size": args.size.unwrap_or(sensor.film.size),
            "seed": args.seed,
        });
        Ok(Self { args, sensor, lights, record })
    }

    fn path(&self, i: usize) -> PathBuf {
        let digits = (self.lights.len() - 1).to_string().len().max(3);
        self.args.output.join(format!("light_{i:0digits$}.exr"))
    }

    /// Writes the lists, unless they are there; the numbers of the lamps whose pictures are not.
    fn begin(&self, ctx: &Context) -> anyhow::Result<Vec<usize>> {
        let note = self.args.output.join("light-stage.json");
        let there = |i: &usize| self.path(*i).is_file();
        if note.is_file() {
            let found: Option<Value> = serde_json::from_slice(&std::fs::read(&note)?).ok();
            if found.as_ref() != Some(&self.record) {
                let differs = found.as_ref().and_then(Value::as_object).map_or(String::new(), |f| {
                    let keys = self.record.as_object().into_iter().flatten().filter(|(k, v)| f.get(*k) != Some(v));
                    format!(" ({})", keys.map(|(k, _)| k.as_str()).collect::<Vec<_>>().join(", "))
                });
                bail!(
                    "{}: a stack that was asked for otherwise{differs}: give another folder, or remove this one",
                    self.args.output.display()
                );
            }
        } else if let Some(i) = (0..self.lights.len()).find(|i| there(i)) {
            bail!("{}: a picture of an unknown stack: give another folder", self.path(i).display());
        }
        let shot = |(i, l): (usize, &Vec3)| lights::Shot::new(self.path(i), l.to_array());
        let shots: Vec<lights::Shot> = self.lights.iter().enumerate().map(shot).collect();
        atomic::write_bytes(&self.args.output.join("lights.lp"), lights::to_lp(&shots, &self.args.output).as_bytes())?;
        atomic::write_bytes(&note, (serde_json::to_string_pretty(&self.record)? + "\n").as_bytes())?;
        let missing: Vec<usize> = (0..self.lights.len()).filter(|i| !there(i)).collect();
        if missing.len() < self.lights.len() {
            ctx.note(format_args!("{} pictures are there and stay", self.lights.len() - missing.len()));
        }
        Ok(missing)
    }

    /// Renders and writes the pictures of the lamps `missing`; rays and seconds.
    fn render(
        &self,
        world: &World,
        settings: &Settings,
        missing: &[usize],
        ctx: &Context,
    ) -> anyhow::Result<(u64, f64)> {
        let begun = Instant::now();
        let stop = signals::stop_flag();
        let clamp = self.args.clamp.unwrap_or(f32::INFINITY);
        let params = Params { settings: *settings, samples: self.args.spp, clamp };
        let method = integrator::Path::new(*settings);
        let shot = Shot::new(world, &method, self.sensor, self.args.size, self.args.seed);
        let [w, h] = shot.size();
        let bytes = 12 * w as usize * h as usize;
        let group = ((self.args.memory as usize) << 20).checked_div(bytes).unwrap_or(1).clamp(1, GROUP);
        let directions = light_stage::to_world(self.sensor, &self.lights);
        let bar = ctx.progress(u64::from(h) * missing.len().div_ceil(group) as u64, "rendering");
        let (mut rays, mut broken, mut clipped) = (0, 0, 0);
        for numbers in missing.chunks(group) {
            let picked = numbers.iter().map(|i| directions[*i]).collect();
            let lamps = Lamps::new(picked, 0.5 * self.args.angle.to_radians(), std::f32::consts::PI)?;
            let found = light_stage::render(&shot, &lamps, &params, &stop, &|| bar.inc(1))?;
            let Some(found) = found else {
                bail!("interrupted: the same command goes on with the pictures that are not there yet");
            };
            clipped += self.write(numbers, &found, ctx)?;
            (rays, broken) = (rays + found.rays, broken + found.broken);
        }
        if broken > 0 {
            ctx.warn(format_args!("{broken} samples were not finite and count as black"));
        }
        if clipped > 0 {
            ctx.warn(format_args!("{clipped} samples were brighter than a half float can be, and are 65504"));
        }
        Ok((rays, begun.elapsed().as_secs_f64()))
    }

    /// Writes a group of pictures; how many samples did not fit.
    fn write(&self, numbers: &[usize], found: &Pictures, ctx: &Context) -> anyhow::Result<usize> {
        let one = |(at, number): (usize, &usize)| -> anyhow::Result<usize> {
            let mut values = found.picture(at);
            let clipped = values.iter().filter(|v| **v > 65504.0).count();
            values.iter_mut().for_each(|v| *v = v.min(65504.0));
            let l = self.lights[*number];
            let options = ExrOptions {
                software: Some(format!("translume {}", env!("CARGO_PKG_VERSION"))),
                command: Some(ctx.command_line.clone()),
                seed: Some(self.args.seed),
                comments: Some(format!("lamp {number}, direction {} {} {} (right, up, to the camera)", l.x, l.y, l.z)),
                ..Default::default()
            };
            let pixels =
                Rgb32FImage::from_raw(found.size[0], found.size[1], values).context("a picture of odd size")?;
            write_exr(&self.path(*number), &Picture::new(pixels), &options)?;
            Ok(clipped)
        };
        let written: Vec<anyhow::Result<usize>> = numbers.par_iter().enumerate().map(one).collect();
        written.into_iter().sum()
    }
}
