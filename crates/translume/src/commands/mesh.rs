//! `translume mesh`: look at mesh files and convert them.

use crate::cli::Usage;
use crate::output::Context;
use anyhow::anyhow;
use serde_json::{Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};
use translume_image::atomic;
use translume_mesh::{Bounds, Loaded, ReadOptions, Topology, TriMesh, obj, ply, read};

const EXAMPLES: &str = "\
Examples:
  Is a scan closed, in one piece, and free of damage?
    translume mesh info scan.ply

  A shape of a Mitsuba collection as PLY:
    translume mesh convert scene.serialized --part 3 -o shape.ply";

const INFO_EXAMPLES: &str = "\
Examples:
  translume mesh info scan.ply
  translume mesh info model.glb --json";

const CONVERT_EXAMPLES: &str = "\
Examples:
  A glTF model, node transforms applied, as one PLY in metres:
    translume mesh convert model.glb --scale 0.001 -o model.ply

  With new normals, creased at edges of more than 40 degrees:
    translume mesh convert part.obj --normals 40 -o part.ply";

/// Look at triangle meshes and convert them
///
/// PLY (ASCII and binary), OBJ, glTF and GLB (without Draco or meshopt compression) and Mitsuba's .serialized are read.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    /// Tell what a mesh file holds and what is wrong with it
    ///
    /// Vertices at the same position count as one for edges and pieces, so that seams of texture or shading do not
    /// make a mesh look open.
    #[command(after_long_help = INFO_EXAMPLES)]
    Info(InfoArgs),
    /// Write a mesh as binary PLY or as OBJ
    ///
    /// All parts of the input become one mesh; node transforms of glTF are applied.
    #[command(after_long_help = CONVERT_EXAMPLES)]
    Convert(ConvertArgs),
}

#[derive(Debug, clap::Args)]
struct InfoArgs {
    /// A mesh file
    #[arg(value_name = "FILE")]
    input: PathBuf,
    /// Only this part, counted from 0
    #[arg(long, value_name = "N")]
    part: Option<usize>,
    /// Files of a glTF file may be in this folder, too, beside its own
    #[arg(long, value_name = "DIR")]
    asset_root: Vec<PathBuf>,
}

#[derive(Debug, clap::Args)]
struct ConvertArgs {
    /// A mesh file
    #[arg(value_name = "FILE")]
    input: PathBuf,
    /// The result, .ply or .obj
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Only this part, counted from 0
    #[arg(long, value_name = "N")]
    part: Option<usize>,
    /// Files of a glTF file may be in this folder, too, beside its own
    #[arg(long, value_name = "DIR")]
    asset_root: Vec<PathBuf>,
    /// Compute normals anew, smooth over edges up to this angle
    #[arg(long, value_name = "DEGREES")]
    normals: Option<f32>,
    /// Multiply all lengths
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    scale: f64,
}

pub(crate) fn run(args: Args, ctx: &Context) -> anyhow::Result<()> {
    match args.verb {
        Verb::Info(args) => info(&args, ctx),
        Verb::Convert(args) => convert(&args, ctx),
    }
}

fn load(input: &Path, part: Option<usize>, roots: &[PathBuf], ctx: &Context) -> anyhow::Result<Loaded> {
    let loaded = read(input, &ReadOptions { part, asset_roots: roots.to_vec() }).map_err(|e| match e {
        translume_mesh::Error::Outside { .. } => anyhow!("{e}: {}", super::OUTSIDE),
        other => other.into(),
    })?;
    loaded.warnings.iter().for_each(|w| ctx.warn(format!("{}: {w}", input.display())));
    Ok(loaded)
}

fn merged(input: &Path, loaded: Loaded) -> anyhow::Result<TriMesh> {
    loaded.merged().ok_or_else(|| anyhow!("{}: more vertices than 32-bit indices reach", input.display()))
}

fn info(args: &InfoArgs, ctx: &Context) -> anyhow::Result<()> {
    let loaded = load(&args.input, args.part, &args.asset_root, ctx)?;
    let parts: Vec<Value> = loaded
        .parts
        .iter()
        .map(|p| {
            json!({
                "name": p.name,
                "material": p.material,
                "vertices": p.mesh.positions.len(),
                "triangles": p.mesh.indices.len(),
                "bounds": bounds_json(&p.mesh.bounds()),
                "normals": p.mesh.normals.is_some(),
                "texture_coordinates": p.mesh.uvs.is_some(),
                "colors": p.mesh.colors.is_some(),
                "flat": p.flat,
            })
        })
        .collect();
    let mut warnings = loaded.warnings.clone();
    let part_lines: Vec<String> = loaded.parts.iter().enumerate().map(part_line).collect();
    let topology = Topology::of(&merged(&args.input, loaded)?);
    warnings.extend(topology.warnings());
    if topology.triangles == 0 {
        warnings.push("no triangles".into());
    }
    ctx.text(describe(&topology, &part_lines, &warnings))?;
    ctx.emit_json(json!({
        "file": args.input.to_string_lossy(),
        "parts": parts,
        "vertices": topology.vertices,
        "positions": topology.positions,
        "triangles": topology.triangles,
        "edges": topology.edges,
        "bounds": bounds_json(&topology.bounds),
        "area": topology.area,
        "volume": topology.volume,
        "closed": topology.is_closed(),
        "manifold": topology.is_manifold(),
        "components": topology.components,
        "boundary_edges": topology.boundary_edges,
        "non_manifold_edges": topology.non_manifold_edges,
        "non_manifold_vertices": topology.non_manifold_vertices,
        "flipped_edges": topology.flipped_edges,
        "degenerate_triangles": topology.degenerate_triangles,
        "duplicate_triangles": topology.duplicate_triangles,
        "unused_vertices": topology.unused_vertices,
        "non_finite_vertices": topology.non_finite_vertices,
        "warnings": warnings,
    }))
}

fn bounds_json(bounds: &Bounds) -> Value {
    match bounds.is_empty() {
        true => Value::Null,
        false => json!([bounds.lo.to_array(), bounds.hi.to_array()]),
    }
}

fn part_line((i, part): (usize, &translume_mesh::Part)) -> String {
    let has = [
        (part.mesh.normals.is_some(), "normals"),
        (part.mesh.uvs.is_some(), "texture coordinates"),
        (part.mesh.colors.is_some(), "colours"),
        (part.flat, "flat"),
    ];
    let has: Vec<&str> = has.iter().filter(|(there, _)| *there).map(|(_, name)| *name).collect();
    let material = part.material.as_ref().map(|m| format!(", material {m}")).unwrap_or_default();
    let attributes = if has.is_empty() { String::new() } else { format!(", {}", has.join(", ")) };
    let (vertices, triangles) = (part.mesh.positions.len(), part.mesh.indices.len());
    format!("part {i}: {} ({vertices} vertices, {triangles} triangles{material}{attributes})", part.name)
}

fn describe(t: &Topology, parts: &[String], warnings: &[String]) -> String {
    const MOST_PARTS: usize = 20;
    let mut lines: Vec<String> = parts.iter().take(MOST_PARTS).cloned().collect();
    if parts.len() > MOST_PARTS {
        lines.push(format!("… and {} more parts", parts.len() - MOST_PARTS));
    }
    lines.push(format!(
        "{} vertices at {} positions, {} triangles, {} edges",
        t.vertices, t.positions, t.triangles, t.edges
    ));
    if !t.bounds.is_empty() {
        let [lo, hi] = [t.bounds.lo, t.bounds.hi];
        lines.push(format!("bounds {} {} {} to {} {} {}", lo.x, lo.y, lo.z, hi.x, hi.y, hi.z));
    }
    let manifold = if t.is_manifold() { "manifold" } else { "not manifold" };
    let surface = match t.volume {
        Some(volume) => format!("closed, {manifold}, volume {volume:.6}"),
        None => format!("open, {manifold}, {} boundary edges", t.boundary_edges),
    };
    lines.push(format!("{} pieces, {surface}, area {:.6}", t.components, t.area));
    lines.extend(warnings.iter().map(|w| format!("warning: {w}")));
    lines.join("\n")
}

fn convert(args: &ConvertArgs, ctx: &Context) -> anyhow::Result<()> {
    type Writer = fn(&TriMesh, &mut dyn Write) -> std::io::Result<()>;
    let extension = args.output.extension().map(|e| e.to_ascii_lowercase());
    let write: Writer = match extension.as_ref().and_then(|e| e.to_str()) {
        Some("ply") => ply::write,
        Some("obj") => obj::write,
        _ => return Err(Usage(format!("{}: the result must be .ply or .obj", args.output.display())).into()),
    };
    if args.scale == 0.0 || !args.scale.is_finite() {
        return Err(Usage(format!("--scale {}: it must be finite and not 0", args.scale)).into());
    }
    ctx.claim(&[&args.input], &[&args.output])?;
    let mut mesh = merged(&args.input, load(&args.input, args.part, &args.asset_root, ctx)?)?;
    if args.scale != 1.0 {
        mesh.transform(&translume_mesh::glam::DAffine3::from_scale(translume_mesh::glam::DVec3::splat(args.scale)));
    }
    if let Some(degrees) = args.normals {
        mesh.crease_normals(degrees.to_radians());
    }
    atomic::write(&args.output, |out| {
        write(&mesh, out).and_then(|()| out.flush()).map_err(|e| translume_image::Error::io(&args.output, e))
    })?;
    let (vertices, triangles) = (mesh.positions.len(), mesh.indices.len());
    ctx.done(&args.output, format_args!("{vertices} vertices, {triangles} triangles"))?;
    ctx.emit_json(json!({ "output": args.output.to_string_lossy(), "vertices": vertices, "triangles": triangles }))
}
