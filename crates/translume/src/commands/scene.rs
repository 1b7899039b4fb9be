//! `translume scene`: what a scene file holds.

use super::render::parse_define;
use crate::output::Context;
use anyhow::Result;
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::PathBuf;
use translume_scene::emitter::Emitter;
use translume_scene::material::Model;
use translume_scene::sensor::{Projection, Sensor};
use translume_scene::texture::Texture;
use translume_scene::{Geometry, Scene};

const INFO_EXAMPLES: &str = "\
Examples:
  translume scene info scene.xml
  translume scene info scene.xml --json
  translume scene info --set spp=16 --lenient old-scene.xml";

/// Look at scene files
#[derive(Debug, clap::Args)]
#[command(arg_required_else_help = true)]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    Info(InfoArgs),
}

/// Read a scene with all its files and tell what is in it
#[derive(Debug, clap::Args)]
#[command(after_long_help = INFO_EXAMPLES)]
struct InfoArgs {
    /// The scene file
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// Leave out what is not supported, with a warning, instead of giving up
    #[arg(long)]
    lenient: bool,
    /// Value of a parameter of the scene file
    #[arg(long, alias = "define", value_name = "NAME=VALUE", value_parser = parse_define)]
    set: Vec<(String, String)>,
    /// Files of a glTF scene may be in this folder, too, beside its own
    #[arg(long, value_name = "DIR", value_parser = super::folder)]
    asset_root: Vec<PathBuf>,
}

pub(crate) fn run(args: Args, ctx: &Context) -> Result<()> {
    let Verb::Info(args) = args.verb;
    let options = super::load_options(args.lenient, args.set, &args.asset_root);
    let scene = super::load_scene(&args.scene, &options)?;
    scene.warnings.iter().for_each(|w| ctx.warn(w));
    ctx.text(text(&scene).trim_end())?;
    ctx.emit_json(as_json(&scene))
}

/// How many there are of each, most first.
fn counted(names: impl Iterator<Item = &'static str>) -> Vec<(&'static str, usize)> {
    let mut counts: Vec<(&str, usize)> = Vec::new();
    for name in names {
        match counts.iter_mut().find(|c| c.0 == name) {
            Some(count) => count.1 += 1,
            None => counts.push((name, 1)),
        }
    }
    counts.sort_by_key(|c| std::cmp::Reverse(c.1));
    counts
}

fn shape_kinds(scene: &Scene) -> Vec<(&'static str, usize)> {
    counted(scene.shapes.iter().chain(scene.groups.iter().flat_map(|g| &g.shapes)).map(|s| match s.geometry {
        Geometry::Mesh(_) => "mesh",
        Geometry::Sphere { .. } => "sphere",
        Geometry::Disk => "disk",
        Geometry::Cylinder { .. } => "cylinder",
    }))
}

fn material_kinds(scene: &Scene) -> Vec<(&'static str, usize)> {
    counted(scene.materials.iter().map(|m| match m.model {
        Model::Null => "null",
        Model::Diffuse { .. } => "diffuse",
        Model::DiffuseTransmission { .. } => "diffuse transmission",
        Model::Dielectric(_) => "dielectric",
        Model::ThinDielectric(_) => "thin dielectric",
        Model::RoughDielectric { .. } => "rough dielectric",
        Model::Conductor(_) => "conductor",
        Model::RoughConductor { .. } => "rough conductor",
        Model::Plastic(_) => "plastic",
        Model::RoughPlastic { .. } => "rough plastic",
        Model::Principled(_) => "principled",
        Model::MetalRough(_) => "metallic roughness",
        Model::ThinPrincipled(_) => "thin principled",
        Model::Measured(_) => "measured",
        Model::Subsurface(_) => "subsurface",
        Model::TwoSided { .. } => "two-sided",
        Model::Mask { .. } => "mask",
        Model::BumpMap { .. } => "bump map",
        Model::NormalMap { .. } => "normal map",
        Model::Blend { .. } => "blend",
    }))
}

fn texture_kinds(scene: &Scene) -> Vec<(&'static str, usize)> {
    counted(scene.textures.iter().map(|t| match t {
        Texture::Constant(_) => "constant",
        Texture::Bitmap(_) => "bitmap",
        Texture::Checkerboard(_) => "checkerboard",
        Texture::VertexColor(_) => "vertex colour",
        Texture::VertexAlpha => "vertex alpha",
        Texture::Product(..) => "product",
        Texture::Complement(_) => "complement",
        Texture::Threshold { .. } => "threshold",
    }))
}

fn light_kinds(scene: &Scene) -> Vec<(&'static str, usize)> {
    let area = scene.shapes.iter().filter(|s| s.radiance.is_some()).map(|_| "area");
    counted(area.chain(scene.emitters.iter().map(|e| match e {
        Emitter::Point { .. } => "point",
        Emitter::Spot(_) => "spot",
        Emitter::Directional { .. } => "directional",
        Emitter::Environment { .. } => "environment",
        Emitter::Constant { .. } => "constant",
        Emitter::Projector { .. } => "projector",
    })))
}

fn sensor_kind(sensor: &Sensor) -> (&'static str, Option<f64>) {
    let [width, height] = sensor.film.size;
    match &sensor.projection {
        Projection::Perspective(p) => ("perspective", Some(p.fov_x(width, height).to_degrees().into())),
        Projection::ThinLens { perspective, .. } => {
            ("thin lens", Some(perspective.fov_x(width, height).to_degrees().into()))
        }
        Projection::Orthographic => ("orthographic", None),
    }
}

/// Bytes of meshes, pictures and grids, shared ones once.
fn megabytes(scene: &Scene) -> f64 {
    scene.heap_bytes() as f64 / 1e6
}

fn text(scene: &Scene) -> String {
    let list = |kinds: Vec<(&str, usize)>| {
        let total: usize = kinds.iter().map(|k| k.1).sum();
        match kinds.iter().map(|(name, n)| format!("{n} {name}")).collect::<Vec<_>>().join(", ") {
            parts if parts.is_empty() => "none".to_owned(),
            parts => format!("{total} ({parts})"),
        }
    };
    let (stored, placed) = scene.triangles();
    let bounds = scene.bounds();
    let mut out = String::new();
    // Writing to a string cannot fail.
    let mut line = |name: &str, value: String| writeln!(out, "{name:<11}{value}").unwrap_or_default();
    line("shapes", list(shape_kinds(scene)));
    if !scene.instances.is_empty() {
        line("instances", format!("{} of {} groups", scene.instances.len(), scene.groups.len()));
    }
    line("triangles", format!("{stored} stored, {placed} placed"));
    if !bounds.is_empty() {
        line("bounds", format!("{} to {}", bounds.lo, bounds.hi));
    }
    line("materials", list(material_kinds(scene)));
    line("textures", list(texture_kinds(scene)));
    line("lights", list(light_kinds(scene)));
    line("media", scene.media.len().to_string());
    for sensor in &scene.sensors {
        let [width, height] = sensor.film.size;
        let (kind, fov) = sensor_kind(sensor);
        let fov = fov.map_or(String::new(), |f| format!(", {f:.3}° wide"));
        line("camera", format!("{kind}, {width}x{height}{fov}"));
    }
    let depth = scene.integrator.max_depth.map_or("any".to_owned(), |d| d.to_string());
    line("integrator", format!("{:?}, depth {depth}", scene.integrator.name));
    line("memory", format!("{:.1} MB", megabytes(scene)));
    out
}

fn as_json(scene: &Scene) -> Value {
    let object =
        |kinds: Vec<(&str, usize)>| Value::Object(kinds.into_iter().map(|(k, n)| (k.to_owned(), n.into())).collect());
    let (stored, placed) = scene.triangles();
    let bounds = scene.bounds();
    let sensors: Vec<Value> = scene
        .sensors
        .iter()
        .map(|s| {
            let (kind, fov_x_deg) = sensor_kind(s);
            json!({
                "kind": kind,
                "name": s.name,
                "width": s.film.size[0],
                "height": s.film.size[1],
                "crop": s.film.crop.map(|c| [c.offset, c.size]),
                "filter": format!("{:?}", s.film.filter),
                "fov_x_deg": fov_x_deg,
                "position": s.world_from_camera.translation.to_array(),
                "direction": s.world_from_camera.matrix3.z_axis.to_array(),
                "sample_count": s.sample_count,
            })
        })
        .collect();
    json!({
        "shapes": object(shape_kinds(scene)),
        "groups": scene.groups.len(),
        "instances": scene.instances.len(),
        "triangles_stored": stored,
        "triangles_placed": placed,
        "bounds": if bounds.is_empty() { Value::Null } else { json!([bounds.lo.to_array(), bounds.hi.to_array()]) },
        "materials": object(material_kinds(scene)),
        "textures": object(texture_kinds(scene)),
        "lights": object(light_kinds(scene)),
        "media": scene.media.len(),
        "sensors": sensors,
        "integrator": {
            "name": scene.integrator.name,
            "max_depth": scene.integrator.max_depth,
            "rr_depth": scene.integrator.rr_depth,
            "hide_emitters": scene.integrator.hide_emitters,
        },
        "memory_bytes": scene.heap_bytes(),
        "warnings": scene.warnings,
    })
}
