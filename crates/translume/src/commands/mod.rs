//! The verbs, one module each.
//!
//! A module holds `Args`, whose doc comment is the help text and whose `after_long_help` starts with `Examples:`, and
//! `fn run(args: Args, ctx: &Context) -> anyhow::Result<()>`. A new verb is that module, a variant of [`Verb`] and an
//! arm of [`Verb::run`]; help, completions, man pages and `--config` follow from them.

mod camera_path;
mod capture;
mod compare;
mod completions;
mod demo;
mod denoise;
mod field;
mod hdr;
mod image;
mod man;
mod merge;
mod mesh;
mod page;
mod pictures;
mod plot;
mod render;
mod scatter;
mod scene;
mod target;

use crate::output::Context;

/// What the program can do, in the order of the help.
#[derive(Debug, clap::Subcommand)]
#[allow(clippy::large_enum_variant, reason = "one value of it exists in a run")]
pub(crate) enum Verb {
    Demo(demo::Args),
    Hdr(hdr::Args),
    #[command(subcommand)]
    Field(field::Args),
    Render(render::Args),
    #[command(subcommand)]
    Capture(capture::Args),
    Merge(merge::Args),
    Scene(scene::Args),
    Mesh(mesh::Args),
    Scatter(scatter::Args),
    #[command(subcommand)]
    Image(image::Args),
    Compare(compare::Args),
    Completions(completions::Args),
    Man(man::Args),
}

/// How scenes are read: measured translucent objects too.
fn load_options(
    lenient: bool,
    defines: Vec<(String, String)>,
    asset_roots: &[std::path::PathBuf],
) -> translume_scene::LoadOptions {
    let load = |path: &std::path::Path| translume_scatter::material::load_material(path).map_err(|e| e.to_string());
    translume_scene::LoadOptions { lenient, defines, bssrdf_loader: Some(load), asset_roots: asset_roots.to_vec() }
}

/// A folder that is there.
fn folder(text: &str) -> Result<std::path::PathBuf, String> {
    let path = std::path::PathBuf::from(text);
    if path.is_dir() { Ok(path) } else { Err("there is no such folder".into()) }
}

/// Reads a scene.
fn load_scene(
    path: &std::path::Path,
    options: &translume_scene::LoadOptions,
) -> anyhow::Result<translume_scene::Scene> {
    translume_scene::load(path, options).map_err(|e| match e {
        translume_scene::Error::Outside { .. } => anyhow::anyhow!("{e}: {OUTSIDE}"),
        other => other.into(),
    })
}

/// What to do about files that must not be read.
const OUTSIDE: &str = "name the folder that it may be in with --asset-root DIR";

impl Verb {
    /// Does it.
    pub(crate) fn run(self, ctx: &Context) -> anyhow::Result<()> {
        match self {
            Self::Demo(args) => demo::run(args, ctx),
            Self::Hdr(args) => hdr::run(args, ctx),
            Self::Field(args) => field::run(args, ctx),
            Self::Render(args) => render::run(args, ctx),
            Self::Capture(args) => capture::run(args, ctx),
            Self::Merge(args) => merge::run(args, ctx),
            Self::Scene(args) => scene::run(args, ctx),
            Self::Mesh(args) => mesh::run(args, ctx),
            Self::Scatter(args) => scatter::run(args, ctx),
            Self::Image(args) => image::run(args, ctx),
            Self::Compare(args) => compare::run(args, ctx),
            Self::Completions(args) => completions::run(args, ctx),
            Self::Man(args) => man::run(args, ctx),
        }
    }
}
