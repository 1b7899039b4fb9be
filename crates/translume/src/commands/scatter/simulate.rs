//! `translume scatter simulate`: virtual captures.

use super::picture;
use crate::cli::Usage;
use crate::output::Context;
use anyhow::anyhow;
use serde_json::json;
use std::path::{Path, PathBuf};
use translume_mesh::ReadOptions;
use translume_scatter::relight::{Lighting, Sources};
use translume_scatter::simulate::{
    CaptureParams, LitParams, Local, Medium, Procedural, Solid, capture_slab, capture_solid, picture_of_solid,
};

const EXAMPLES: &str = "\
Examples:
  An 8 by 8 grid of laser positions on marble:
    translume scatter simulate marble -o capture/

  The same with a rough surface and a laser that drifts by 5 %:
    translume scatter simulate marble --rough --drift 0.05 -o capture/

  A small one to look at:
    translume scatter simulate wax --spots 2 --pixels 24 --photons 1000 -o small/

  A closed mesh of 30 mm on a turntable with four stops and two cameras:
    translume scatter simulate marble --mesh bunny.ply --mesh-size 30 --spacing 3 -o bunny-capture/

  A measured density of albedo 0.98, 0.95, 0.9 in the mesh; extinction 4 per mm where the grid is 1:
    translume scatter simulate grid --grid smoke.vol --extinction 4 --albedo 0.98,0.95,0.9 --mesh bunny.ply -o smoke/

  The same smoke as cloudiness of a body that scatters everywhere:
    translume scatter simulate grid --grid smoke.vol --base 1 --extinction 6 --mesh bunny.ply -o cloudy/

  What models of such a capture are to show: the mesh under lights, by a million photons from them:
    translume scatter simulate marble --mesh bunny.ply --mesh-size 30 --lights lights.json --photons 1000000 -o truth.exr";

/// Capture a slab or a closed mesh of a heterogeneous medium with a virtual laser and camera
///
/// A random walk of photons finds the light that leaves the object around each laser position; a perspective camera with
/// noise sees it. The result is a capture set: rig.json, mesh.ply and the frames as a Zarr array. Frames are written as they are
/// made: memory does not grow with their number.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(super) struct Args {
    /// The medium
    #[arg(value_enum, value_name = "MEDIUM")]
    medium: Name,
    /// Folder of the capture, which must not exist
    #[arg(short, long, value_name = "CAPTURE")]
    output: PathBuf,
    /// A closed mesh to capture instead of a slab; z is the turntable's axis
    #[arg(long, value_name = "FILE")]
    mesh: Option<PathBuf>,
    /// Scale the mesh to this longest side; without it, its unit is the millimetre
    #[arg(long, value_name = "MM", requires = "mesh")]
    mesh_size: Option<f64>,
    /// Density of the medium `grid`, a Mitsuba .vol, stretched over the object
    #[arg(long, value_name = "FILE.vol")]
    grid: Option<PathBuf>,
    /// Extinction per mm where the grid is 1
    #[arg(long, value_name = "PER_MM", default_value_t = 2.0)]
    extinction: f64,
    /// Extinction per mm where the grid is 0: smoke in something solid instead of in nothing
    #[arg(long, value_name = "PER_MM", default_value_t = 0.0)]
    base: f64,
    /// Albedo of the grid's medium in red, green and blue
    #[arg(long, value_name = "R,G,B", value_delimiter = ',', default_values_t = [0.99, 0.98, 0.96])]
    albedo: Vec<f64>,
    /// Laser positions along each side of a square, on slabs [default: 8]
    #[arg(long, value_name = "N", conflicts_with = "mesh")]
    spots: Option<usize>,
    /// Distance between them
    #[arg(long, value_name = "MM", default_value_t = 1.0)]
    spacing: f64,
    /// Diameter of the beam at 1/e²
    #[arg(long, value_name = "MM", default_value_t = 2.0)]
    beam: f64,
    /// Columns and rows of a frame
    #[arg(long, value_name = "N", default_value_t = 48)]
    pixels: usize,
    /// Width of the object in a frame [default: 24, or the whole mesh]
    #[arg(long, value_name = "MM")]
    field: Option<f64>,
    /// Positions of the turntable [default: 1, with a mesh 4]
    #[arg(long, value_name = "N")]
    views: Option<usize>,
    /// Cameras around the mesh; slabs have one [default: 2]
    #[arg(long, value_name = "N", requires = "mesh")]
    cameras: Option<usize>,
    /// Thickness of the slab [default: 16]
    #[arg(long, value_name = "MM", conflicts_with = "mesh")]
    thickness: Option<f64>,
    /// Index of refraction
    #[arg(long, value_name = "ETA", default_value_t = 1.5)]
    eta: f64,
    /// A surface that diffuses, instead of a smooth one
    #[arg(long)]
    rough: bool,
    /// Photons for each laser position
    #[arg(long, value_name = "N", default_value_t = 4_000)]
    photons: usize,
    /// How evenly the noise of the walk lies over all distances from the beam, 0 to 1: with 1 faint places are as sure as bright ones, with
    /// 0.5 a photon costs a sixth (a small object) to a fortieth (a wide slab), and more can be sent
    #[arg(long, value_name = "FRACTION", default_value_t = 1.0)]
    evenness: f64,
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
    /// Show the mesh under these lights instead of capturing it; OUT is then a picture, .exr or .png
    #[arg(long, value_name = "LIGHTS.json", requires = "mesh")]
    lights: Option<PathBuf>,
    /// Save the medium as PREFIX-sigma_t.vol and PREFIX-albedo.vol, for `render`
    #[arg(long, value_name = "PREFIX")]
    save_medium: Option<PathBuf>,
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
    /// The density of --grid
    Grid,
}

impl Name {
    fn procedural(self) -> Option<Procedural> {
        Some(match self {
            Self::Marble => Procedural::Marble,
            Self::Apple => Procedural::Apple,
            Self::Sponge => Procedural::Sponge,
            Self::Wax => Procedural::Wax,
            Self::Stone => Procedural::Stone,
            Self::Homogeneous => Procedural::Homogeneous,
            Self::Grid => return None,
        })
    }
}

fn params(args: &Args, solid: Option<&Solid>) -> anyhow::Result<CaptureParams> {
    let plain = CaptureParams::default();
    let (spots, thickness) = (args.spots.unwrap_or(plain.spots), args.thickness.unwrap_or(plain.thickness_mm));
    let views = args.views.unwrap_or(if solid.is_some() { 4 } else { 1 });
    let cameras = args.cameras.unwrap_or(if solid.is_some() { 2 } else { 1 });
    // The mesh as it turns, and some room.
    let around = solid.map(|s| 1.05 * f64::from(s.mesh().bounds().extent().length()));
    let field = args.field.unwrap_or(around.unwrap_or(plain.field_mm));
    let usage = |what: String| Err(Usage(what).into());
    for (name, n, most) in [
        ("--spots", spots, 256),
        ("--pixels", args.pixels, 4096),
        ("--views", views, 360),
        ("--cameras", cameras, 16),
        ("--photons", args.photons, 1 << 40),
    ] {
        if !(1..=most).contains(&n) {
            return usage(format!("{name} {n}: it must lie between 1 and {most}"));
        }
    }
    let lengths = [
        ("--spacing", args.spacing),
        ("--beam", args.beam),
        ("--field", field),
        ("--thickness", thickness),
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
    if !(0.0..=1.0).contains(&args.evenness) {
        return usage(format!("--evenness {}: it must lie between 0 and 1", args.evenness));
    }
    if !(1.0..=4.0).contains(&args.eta) {
        return usage(format!("--eta {}: an index of refraction lies between 1 and 4", args.eta));
    }
    Ok(CaptureParams {
        spots,
        spacing_mm: args.spacing,
        beam_diameter_mm: args.beam,
        pixels: args.pixels,
        field_mm: field,
        views,
        cameras,
        thickness_mm: thickness,
        eta: args.eta,
        rough: args.rough,
        photons: args.photons,
        evenness: args.evenness,
        dynamic_range_db: if args.noise_free { f64::INFINITY } else { args.dynamic_range },
        drift: args.drift,
        misregistration_mm: args.misregistration,
        peak_shift_mm: args.peak_shift,
        geometry_error_mm: args.geometry_error,
        seed: args.seed,
        ..plain
    })
}

pub(super) fn run(args: &Args, ctx: &Context) -> anyhow::Result<()> {
    if args.grid.is_some() != matches!(args.medium, Name::Grid) {
        return Err(Usage("--grid FILE.vol and the medium `grid` go together".into()).into());
    }
    if args.lights.is_none() && args.output.exists() {
        return Err(anyhow!("{}: it exists; choose another name or remove it", args.output.display()));
    }
    let solid = args.mesh.as_deref().map(|file| load_solid(file, args.mesh_size)).transpose()?;
    let params = params(args, solid.as_ref())?;
    let medium = medium(args, &params, solid.as_ref(), ctx)?;
    if let Some(prefix) = &args.save_medium {
        save_medium(prefix, &medium, &inputs(args), ctx)?;
    }
    if let Some(lights) = &args.lights {
        let solid = solid.as_ref().expect("clap asks for a mesh");
        return under_lights(args, lights, (solid, &medium), &params, ctx);
    }
    let bar = ctx.progress((params.spots * params.spots) as u64, "shining");
    let label = json!({ "medium": format!("{:?}", args.medium).to_lowercase(), "pattern": args.pattern, "command": ctx.command_line });
    let capture = translume_image::atomic::write_folder(
        &args.output,
        |_| false,
        |folder| match &solid {
            Some(solid) => capture_solid(folder, (solid, &medium), &params, label, |positions| {
                bar.set_length(positions as u64);
                bar.inc(1);
            }),
            None => capture_slab(folder, &medium, &params, label, || bar.inc(1)),
        },
    )?;
    drop(bar);
    let rig = &capture.rig;
    let positions = rig.laser.hits_mm.len();
    // Each laser position of a mesh is seen by the cameras of its stop.
    let frames = positions * rig.channels.len() * if solid.is_some() { params.cameras } else { params.views };
    let side = params.pixels;
    ctx.done(&args.output, format_args!("{frames} frames of {side} × {side} pixels, {positions} laser positions"))?;
    let floors: Vec<f64> = rig.channels.iter().map(|c| c.noise_floor).collect();
    ctx.emit_json(json!({ "output": args.output.to_string_lossy(), "frames": frames, "positions": positions,
        "noise_floor": floors }))
}

/// The files that the command line names to be read.
fn inputs(args: &Args) -> Vec<&Path> {
    [&args.mesh, &args.grid, &args.lights].into_iter().flatten().map(PathBuf::as_path).collect()
}

/// The truth for models of the capture: the same walk, with photons of the lights.
fn under_lights(
    args: &Args,
    lights: &Path,
    object: (&Solid, &Medium),
    params: &CaptureParams,
    ctx: &Context,
) -> anyhow::Result<()> {
    picture::check(&inputs(args), &args.output, ctx)?;
    let lighting = Lighting::read(lights)?;
    let sources = Sources::new(&lighting.lights, lights.parent().unwrap_or(Path::new("")))?;
    let view = &lighting.view;
    let distance = (0..3).map(|i| (view.eye[i] - view.target[i]).powi(2)).sum::<f64>().sqrt();
    let lit = LitParams {
        photons: params.photons,
        texel_mm: 2.0 * distance * (0.5 * view.fov_deg.to_radians()).tan() / view.width as f64,
        eta: params.eta,
        rough: params.rough,
        seed: params.seed,
    };
    let picture = picture_of_solid(object, &sources, view, &lit);
    let picture = picture.ok_or_else(|| anyhow!("{}: there is no light, or no view", lights.display()))?;
    picture::write(&args.output, (view.width, view.height), &picture, ctx)?;
    ctx.done(&args.output, format_args!("{} × {} pixels, {} photons", view.width, view.height, params.photons))?;
    ctx.emit_json(json!({ "output": args.output.to_string_lossy(), "width": view.width, "height": view.height,
        "photons": params.photons }))
}

fn load_solid(file: &Path, size: Option<f64>) -> anyhow::Result<Solid> {
    if size.is_some_and(|s| !(1e-3..=1e4).contains(&s)) {
        return Err(Usage("--mesh-size: it must lie between 0.001 and 10000".into()).into());
    }
    let loaded = translume_mesh::read(file, &ReadOptions::default())?;
    let mesh = loaded.merged().filter(|m| !m.indices.is_empty());
    let mut mesh = mesh.ok_or_else(|| anyhow!("{}: no triangles", file.display()))?.compacted();
    if let Some(size) = size {
        let longest = mesh.bounds().extent().max_element();
        let factor = (size / f64::from(longest)) as f32;
        mesh.positions.iter_mut().flatten().for_each(|x| *x *= factor);
    }
    Solid::new(mesh).map_err(|what| anyhow!("{}: {what}", file.display()))
}

fn medium(args: &Args, params: &CaptureParams, solid: Option<&Solid>, ctx: &Context) -> anyhow::Result<Medium> {
    let Some(procedural) = args.medium.procedural() else { return grid(args, params, solid, ctx) };
    Ok(match solid {
        Some(solid) => procedural.fill(args.pattern, solid.bounds(), |p| solid.depth(p)),
        None => procedural.build(args.pattern),
    })
}

/// Extinction and albedo, three channels each, as grids of Mitsuba's format.
fn save_medium(prefix: &Path, medium: &Medium, inputs: &[&Path], ctx: &Context) -> anyhow::Result<()> {
    let (size, corners, cells) = medium.cells();
    let corners = corners.map(translume_mesh::glam::DVec3::from_array);
    let extinction = |c: &Local| c.sigma_a.map(|a| a + c.sigma_s);
    let sigma_t: Vec<f32> = cells.iter().flat_map(extinction).collect();
    let albedo: Vec<f32> = cells.iter().flat_map(|c| extinction(c).map(|t| c.sigma_s / t.max(1e-30))).collect();
    for (name, values) in [("sigma_t", sigma_t), ("albedo", albedo)] {
        let mut file = prefix.as_os_str().to_owned();
        file.push(format!("-{name}.vol"));
        ctx.claim(inputs, &[Path::new(&file)])?;
        let bytes = translume_scene::grid_bytes(size, 3, corners, &values);
        translume_image::atomic::write_bytes(Path::new(&file), &bytes)?;
    }
    Ok(())
}

/// The numbers of a grid as extinction, its box stretched over the mesh, or for a slab over the frame and the depth.
fn grid(args: &Args, params: &CaptureParams, solid: Option<&Solid>, ctx: &Context) -> anyhow::Result<Medium> {
    let file = args.grid.as_deref().expect("checked");
    let albedo: [f64; 3] = args.albedo.clone().try_into().map_err(|_| Usage("--albedo: three numbers".into()))?;
    if !albedo.iter().all(|a| *a > 0.0 && *a <= 1.0) || !(1e-6..=1e3).contains(&args.extinction) {
        return Err(Usage("--albedo lies in (0, 1], --extinction in 0.000001 to 1000".into()).into());
    }
    if !(0.0..=1e3).contains(&args.base) {
        return Err(Usage("--base lies in 0 to 1000".into()).into());
    }
    let (grid, _) = translume_scene::read_grid(file)?;
    if grid.values.iter().all(|v| *v <= 0.0) {
        return Err(anyhow!("{}: no density: all its values are 0", file.display()));
    }
    if grid.channels > 1 {
        ctx.warn(format!("{}: of its {} channels the first is the density", file.display(), grid.channels));
    }
    let half = params.field_mm / 2.0;
    let slab = ([-half, -half, -params.thickness_mm], [half, half, 0.0]);
    let (low, high) = solid.map_or(slab, Solid::bounds);
    let extent = [0, 1, 2].map(|i| (high[i] - low[i]).max(1e-6));
    // Cubes as fine as the grid's finest side.
    let cell = (0..3).map(|i| extent[i] / grid.size[i] as f64).fold(f64::INFINITY, f64::min);
    let cell = cell.max(extent.iter().copied().fold(0.0, f64::max) / 256.0);
    let size = extent.map(|e| ((e / cell).ceil() as usize).max(1));
    let scattering = albedo.iter().copied().fold(0.0, f64::max);
    Ok(Medium::block(low, size, cell, |p| {
        let at = |i: usize| (((p[i] - low[i]) / extent[i] * grid.size[i] as f64) as usize).min(grid.size[i] - 1);
        let index = (at(2) * grid.size[1] + at(1)) * grid.size[0] + at(0);
        // Scattering is grey here: each channel keeps its albedo by its absorption. Values above 1 may take base below 0.
        let density = f64::from(grid.values[index * grid.channels]);
        let sigma_s = scattering * (args.base + (args.extinction - args.base) * density).max(0.0);
        Local { sigma_s: sigma_s as f32, sigma_a: albedo.map(|a| (sigma_s * (1.0 / a - 1.0)) as f32), g: 0.0 }
    }))
}
