//! `translume mesh`: look at mesh files and convert them.

use crate::cli::Usage;
use crate::output::Context;
use anyhow::anyhow;
use serde_json::{Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};
use translume_image::atomic;
use translume_mesh::glam::{DAffine3, DVec3};
use translume_mesh::{Bounds, Loaded, ReadOptions, Topology, TriMesh, obj, ply, read, stl};

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
/// PLY (ASCII and binary), OBJ, STL, OFF, glTF and GLB (without Draco or meshopt compression) and Mitsuba's .serialized are
/// read. Coordinates that 32-bit floats do not hold, as of map projections, are kept about an origin, which is told.
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
    /// Write a mesh as binary PLY, OBJ or binary STL
    ///
    /// All parts of the input become one mesh; node transforms of glTF are applied. What the input has and the result does
    /// not is told. STL holds triangles alone, in 32-bit floats.
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
    #[arg(long, value_name = "DIR", value_parser = super::folder)]
    asset_root: Vec<PathBuf>,
}

#[derive(Debug, clap::Args)]
struct ConvertArgs {
    /// A mesh file
    #[arg(value_name = "FILE")]
    input: PathBuf,
    /// The result, .ply, .obj or .stl
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Only this part, counted from 0
    #[arg(long, value_name = "N")]
    part: Option<usize>,
    /// Files of a glTF file may be in this folder, too, beside its own
    #[arg(long, value_name = "DIR", value_parser = super::folder)]
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
    let loaded =
        read(input, &ReadOptions { part, asset_roots: roots.to_vec(), keep_origin: true }).map_err(|e| match e {
            translume_mesh::Error::Outside { .. } => anyhow!("{e}: {}", super::OUTSIDE),
            other => other.into(),
        })?;
    loaded.warnings.iter().for_each(|w| ctx.warn(format!("{}: {w}", input.display())));
    if loaded.origin != DVec3::ZERO {
        let [x, y, z] = loaded.origin.to_array();
        ctx.note(format!(
            "{}: the coordinates are kept about the origin {x} {y} {z}, near which 32-bit floats hold them",
            input.display()
        ));
    }
    Ok(loaded)
}

fn merged(input: &Path, loaded: Loaded) -> anyhow::Result<TriMesh> {
    loaded.merged().ok_or_else(|| anyhow!("{}: more vertices than 32-bit indices reach", input.display()))
}

fn info(args: &InfoArgs, ctx: &Context) -> anyhow::Result<()> {
    let loaded = load(&args.input, args.part, &args.asset_root, ctx)?;
    let (origin, dropped) = (loaded.origin, loaded.dropped.clone());
    let parts: Vec<Value> = loaded
        .parts
        .iter()
        .map(|p| {
            json!({
                "name": p.name,
                "material": p.material,
                "vertices": p.mesh.positions.len(),
                "triangles": p.mesh.indices.len(),
                "bounds": bounds_json(&p.mesh.bounds(), origin),
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
    ctx.text(describe(&topology, origin, &part_lines, &warnings))?;
    ctx.emit_json(json!({
        "file": args.input.to_string_lossy(),
        "parts": parts,
        "vertices": topology.vertices,
        "positions": topology.positions,
        "triangles": topology.triangles,
        "edges": topology.edges,
        "bounds": bounds_json(&topology.bounds, origin),
        "origin": origin.to_array(),
        "not_kept": dropped,
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

/// In the file's own coordinates.
fn bounds_json(bounds: &Bounds, origin: DVec3) -> Value {
    match (bounds.is_empty(), origin == DVec3::ZERO) {
        (true, _) => Value::Null,
        (false, true) => json!([bounds.lo.to_array(), bounds.hi.to_array()]),
        (false, false) => json!([bounds.lo, bounds.hi].map(|p| (p.as_dvec3() + origin).to_array())),
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

fn describe(t: &Topology, origin: DVec3, parts: &[String], warnings: &[String]) -> String {
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
        let shown = |p: translume_mesh::glam::Vec3| match origin == DVec3::ZERO {
            true => format!("{} {} {}", p.x, p.y, p.z),
            false => p
                .as_dvec3()
                .to_array()
                .iter()
                .zip(origin.to_array())
                .map(|(x, o)| (x + o).to_string())
                .collect::<Vec<_>>()
                .join(" "),
        };
        lines.push(format!("bounds {} to {}", shown(t.bounds.lo), shown(t.bounds.hi)));
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
    type Writer = fn(&TriMesh, DVec3, &mut dyn Write) -> std::io::Result<()>;
    let extension = args.output.extension().map(|e| e.to_ascii_lowercase());
    let write: Writer = match extension.as_ref().and_then(|e| e.to_str()) {
        Some("ply") => ply::write_about,
        Some("obj") => obj::write_about,
        Some("stl") => |mesh, _, out| stl::write(mesh, out),
        _ => return Err(Usage(format!("{}: the result must be .ply, .obj or .stl", args.output.display())).into()),
    };
    let triangles_alone = extension.as_ref().is_some_and(|e| e == "stl");
    if args.scale == 0.0 || !args.scale.is_finite() {
        return Err(Usage(format!("--scale {}: it must be finite and not 0", args.scale)).into());
    }
    ctx.claim(&[&args.input], &[&args.output])?;
    let loaded = load(&args.input, args.part, &args.asset_root, ctx)?;
    let dropped = dropped(&loaded, triangles_alone, args.normals.is_some());
    if !dropped.is_empty() {
        let name = args.output.display();
        ctx.warn(format!("{}: not written to {name}: {}", args.input.display(), dropped.join("; ")));
    }
    let origin = loaded.origin * args.scale;
    let mut mesh = merged(&args.input, loaded)?;
    if args.scale != 1.0 {
        mesh.transform(&DAffine3::from_scale(DVec3::splat(args.scale)));
    }
    if let Some(degrees) = args.normals {
        mesh.crease_normals(degrees.to_radians());
    }
    atomic::write(&args.output, |out| {
        write(&mesh, origin, out).and_then(|()| out.flush()).map_err(|e| translume_image::Error::io(&args.output, e))
    })?;
    let (vertices, triangles) = (mesh.positions.len(), mesh.indices.len());
    ctx.done(&args.output, format_args!("{vertices} vertices, {triangles} triangles"))?;
    ctx.emit_json(json!({ "output": args.output.to_string_lossy(), "vertices": vertices, "triangles": triangles,
        "origin": origin.to_array(), "dropped": dropped }))
}

/// What `loaded` has and the result will not have.
fn dropped(loaded: &Loaded, triangles_alone: bool, own_normals: bool) -> Vec<String> {
    let mut dropped = loaded.dropped.clone();
    let materials: std::collections::BTreeSet<&str> =
        loaded.parts.iter().filter_map(|p| p.material.as_deref()).collect();
    if !materials.is_empty() {
        let names: Vec<&str> = materials.iter().take(5).copied().collect();
        let more = if materials.len() > names.len() { ", …" } else { "" };
        dropped.push(format!("the materials {}{more}", names.join(", ")));
    }
    if !loaded.material_files.is_empty() {
        let files = loaded.material_files.iter().filter_map(|f| f.file_name()).map(|f| f.to_string_lossy());
        dropped.push(format!("the material library {}", files.take(5).collect::<Vec<_>>().join(", ")));
    }
    if loaded.parts.len() > 1 {
        dropped.push(format!("the division into {} parts", loaded.parts.len()));
    }
    let any = |f: fn(&TriMesh) -> bool| loaded.parts.iter().any(|p| f(&p.mesh));
    let attributes = [
        (any(|m| m.uvs.is_some()), "texture coordinates"),
        (any(|m| m.normals.is_some()) && !own_normals, "vertex normals"),
        (any(|m| m.colors.is_some()), "vertex colours"),
        (loaded.origin != DVec3::ZERO, "the origin of the coordinates: the mesh is moved to it"),
    ];
    dropped
        .extend(attributes.iter().filter(|(there, _)| triangles_alone && *there).map(|(_, what)| (*what).to_owned()));
    dropped
}
