//! `translume scatter fit`: sample lists and planar captures to models.

use crate::cli::Usage;
use crate::output::Context;
use clap::builder::RangedU64ValueParser;
use serde_json::json;
use std::path::PathBuf;
use translume_image::atomic;
use translume_scatter::capture::Capture;
use translume_scatter::planar::{
    MODEL_VERSION, ModelHead, PlanarCapture, PlanarParams, estimate_gains, fit_planar, save_model,
};
use translume_scatter::vertex::{
    self, FrameGain, MeshCapture, VertexHead, VertexParams, fit_uniform, fit_vertices, save_uniform_model,
    save_vertex_model,
};
use translume_scatter::{Error, MAX_TERMS, Model, Params, SampleFile, Sink, fit_file};

const EXAMPLES: &str = "\
Examples:
  Sums of three exponentials:
    translume scatter fit samples.npy --model exponential --terms 3 -o fit.json

  Fall-off that depends on the direction:
    translume scatter fit samples.npy --segments 8 -o fit.json

  Scattering and absorption of a homogeneous material, by Jensen's dipole:
    translume scatter fit samples.npy --model dipole --eta 1.3 -o dipole.json

  A capture of a flat sample, one fall-off for all colours:
    translume scatter fit capture/ --segments 8 --shared -o model/

  A capture of a mesh: a fall-off for each vertex, for rendering from any side:
    translume scatter fit bunny-capture/ --model exponential -o bunny-model/

  One dipole for the whole object, with an albedo by place:
    translume scatter fit bunny-capture/ --model dipole --uniform -o bunny-dipole/

  The same capture as a hierarchical model, for relighting at interactive rates:
    translume scatter fit bunny-capture/ --model hierarchical -o bunny-disco/";

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum ModelName {
    /// Sum of exponentials (Fuchs et al. 2005)
    Exponential,
    /// Diffusion dipole (Jensen et al. 2001)
    Dipole,
    /// Dipole with Grosjean's diffusion and better boundary (d'Eon & Irving 2011)
    BetterDipole,
    /// Normalised diffusion (Burley 2015)
    Normalized,
    /// Throughput between vertices, local kernels and detail of an object (Goesele et al. 2004)
    Hierarchical,
}

/// Fit a model of the fall-off around lit points, to a list of samples or a capture
///
/// SAMPLES.npy is a float32 array (points, samples, 3): x and y from the lit point in mm, and the value of R_d; 0 or
/// less is below the noise floor and left out. The errors of the logarithm are minimised, so that far samples count
/// like near ones. The file is read a block at a time and may be larger than the memory; the result is JSON.
///
/// A capture is the folder of a flat sample; the result is a folder with the fall-offs and a modulation texture. Every fifth
/// pixel is kept from the fit, for `report`. With a capture of any other mesh the result is a folder with a fall-off for each vertex,
/// one for all colours; unstable fits lose terms, or are left out, and what was not measured comes from the neighbours.
///
/// `--model hierarchical` takes captures of meshes and keeps what was measured itself: the throughput between all pairs of vertices, 7 × 7
/// kernels around the texels of an atlas, a modulation texture, and a confidence beside each. `relight` shows it.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(super) struct Args {
    /// A list of samples, .npy, or the folder of a capture
    #[arg(value_name = "SAMPLES.npy|CAPTURE")]
    pub(super) input: PathBuf,
    /// The fits, as JSON, or the folder of the model of a capture
    #[arg(short, long, value_name = "OUT")]
    pub(super) output: PathBuf,
    /// The model
    #[arg(long, value_enum, default_value_t = ModelName::Exponential)]
    model: ModelName,
    /// Most exponentials of a sum; fewer are kept where the samples do not tell more apart
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = RangedU64ValueParser::<usize>::new().range(1..=MAX_TERMS as u64))]
    terms: usize,
    /// Directions with a fall-off of their own, blended between their centres: 1, or 3 to 64
    #[arg(long, value_name = "M", default_value_t = 1, value_parser = RangedU64ValueParser::<usize>::new().range(1..=64))]
    pub(super) segments: usize,
    /// Index of refraction for the dipoles
    #[arg(long, value_name = "ETA", default_value_t = 1.3)]
    eta: f64,
    /// Fit a factor to the dipoles too, for samples whose unit is not mm⁻²
    #[arg(long)]
    pub(super) free_scale: bool,
    /// Objects: one fall-off for the whole of them, for each colour, times an albedo by place
    #[arg(long)]
    pub(super) uniform: bool,
    /// Captures: one fall-off for all colours, with a factor for each
    #[arg(long)]
    pub(super) shared: bool,
    /// Captures: estimate the laser's power in each frame, by reciprocity between neighbouring positions
    #[arg(long)]
    pub(super) gains: bool,
    /// Captures: pixels above this multiple of the noise floor are samples
    #[arg(long, value_name = "FACTOR", default_value_t = 4.0)]
    pub(super) threshold: f64,
}

pub(super) fn run(args: &Args, ctx: &Context) -> anyhow::Result<()> {
    let params = params(args)?;
    let Some(params) = params else { return super::fit_hierarchical::run(args, ctx) };
    match args.input.is_dir() {
        true => fit_capture(args, params, ctx),
        false if args.uniform => Err(Usage("--uniform needs a capture of an object".into()).into()),
        false if args.shared || args.gains => {
            Err(Usage("--shared and --gains need a capture; a list of samples has one channel and no frames".into())
                .into())
        }
        false => fit_list(args, params, ctx),
    }
}

/// `None` for the hierarchical model, which has no fall-offs.
fn params(args: &Args) -> anyhow::Result<Option<Params>> {
    if args.segments == 2 {
        return Err(
            Usage("--segments 2: two directions cannot be blended around a circle; take 1, or 3 to 64".into()).into()
        );
    }
    if !(1.0..=4.0).contains(&args.eta) {
        return Err(Usage(format!("--eta {}: an index of refraction lies between 1 and 4", args.eta)).into());
    }
    let model = match args.model {
        ModelName::Exponential => Model::Exponential,
        ModelName::Dipole => Model::Dipole,
        ModelName::BetterDipole => Model::BetterDipole,
        ModelName::Normalized => Model::Normalized,
        ModelName::Hierarchical => return Ok(None),
    };
    if args.threshold.is_nan() || args.threshold < 0.0 {
        return Err(Usage("--threshold: it must be 0 or more".into()).into());
    }
    if args.free_scale && !matches!(model, Model::Dipole | Model::BetterDipole) {
        return Err(Usage("--free-scale: only the dipoles have a scale of their own".into()).into());
    }
    Ok(Some(Params {
        model,
        terms: args.terms,
        segments: args.segments,
        eta: args.eta,
        free_scale: args.free_scale,
        most: None,
    }))
}

fn fit_list(args: &Args, params: Params, ctx: &Context) -> anyhow::Result<()> {
    ctx.claim(&[&args.input], &[&args.output])?;
    let input = SampleFile::open(&args.input)?;
    let bar = ctx.progress(input.points as u64, "fitting");
    let mut summary = None;
    atomic::write(&args.output, |out| {
        let sink = Sink { out, path: &args.output, command: &ctx.command_line };
        let done = fit_file(input, &params, sink, |points| bar.set_position(points as u64))?;
        if done.fitted == 0 {
            return Err(Error::invalid(
                &args.input,
                "no point has enough samples above 0 at different distances for a fit",
            ));
        }
        summary = Some(done);
        Ok(())
    })?;
    let summary = summary.expect("written");
    if summary.fitted < summary.points {
        ctx.warn(format!(
            "{} of {} points have too few samples for a fit",
            summary.points - summary.fitted,
            summary.points
        ));
    }
    if summary.not_finite > 0 {
        ctx.warn(format!(
            "{}: {} samples are infinite or NaN and were left out",
            args.input.display(),
            summary.not_finite
        ));
    }
    ctx.done(
        &args.output,
        format_args!(
            "{} points, {} samples above the noise floor: RMS of ln(model/sample) {:.4} in the mean, {:.4} at worst",
            summary.fitted, summary.samples, summary.mean_rms, summary.worst_rms
        ),
    )?;
    let mut report = json!(summary_json(&summary));
    report["output"] = args.output.to_string_lossy().into();
    ctx.emit_json(report)
}

fn summary_json(s: &translume_scatter::Summary) -> serde_json::Value {
    json!({
        "points": s.points, "fitted": s.fitted, "samples": s.samples, "not_finite": s.not_finite,
        "fewer_terms": s.fewer_terms, "borrowed": s.borrowed, "mean_rms": s.mean_rms, "worst_rms": s.worst_rms,
    })
}

fn fit_capture(args: &Args, fit: Params, ctx: &Context) -> anyhow::Result<()> {
    ctx.protect(&[&args.input], &[&args.output])?;
    translume_scatter::check_model_folder(&args.output)?;
    let opened = Capture::open(&args.input)?.in_rgb_order();
    if !opened.is_flat() {
        return fit_mesh(args, fit, opened, ctx);
    }
    if args.uniform {
        return Err(Usage("--uniform needs a capture of an object, not of a flat sample".into()).into());
    }
    let mut capture = PlanarCapture::new(opened, args.threshold)?;
    if capture.missing > 0 {
        ctx.warn(format!(
            "{}: {} frames are missing; their laser positions are left out",
            args.input.display(),
            capture.missing
        ));
    }
    if args.gains {
        capture.gains = estimate_gains(&capture)?;
        tell_gains(capture.gains.iter().flatten(), ctx)?;
    }
    // No more light comes back than came in.
    let fit = Params { eta: capture.capture.rig.eta, most: Some(1.0), ..fit };
    let params = PlanarParams { fit, shared: args.shared, ..PlanarParams::default() };
    let bar = ctx.progress(capture.spots.len() as u64, "fitting");
    let model = fit_planar(&capture, &params, || bar.inc(1))?;
    let fitted = model.points.iter().filter(|p| p.fall_off.iter().all(|f| f.rms.is_some())).count();
    if fitted == 0 {
        return Err(Error::invalid(&args.input, "no laser position has enough pixels above the noise for a fit").into());
    }
    if fitted < model.points.len() {
        ctx.warn(format!(
            "{} of {} laser positions have too few samples for a fit",
            model.points.len() - fitted,
            model.points.len()
        ));
    }
    let head = ModelHead {
        format: "translume planar model".into(),
        version: MODEL_VERSION.into(),
        command: ctx.command_line.clone(),
        model: params.fit.model,
        segments: params.fit.segments,
        terms: params.fit.terms,
        shared: params.shared,
        threshold: args.threshold,
        channels: capture.capture.rig.channels.iter().map(|c| c.name.clone()).collect(),
        frames: capture.spots.iter().map(|s| s.frame).collect(),
        eta: capture.capture.rig.eta,
        cameras: capture.capture.rig.views.iter().map(|v| v.camera.clone()).collect(),
        gains: capture.gains.clone(),
    };
    let [.., rows, columns] = capture.capture.frames.shape;
    save_model(&args.output, &head, &model, (columns, rows))?;
    let rms: Vec<f64> = model.points.iter().flat_map(|p| &p.fall_off).filter_map(|f| f.rms).collect();
    let mean = rms.iter().sum::<f64>() / rms.len() as f64;
    let seen: Vec<f32> = model.texture_samples.iter().flatten().flatten().copied().collect();
    let textured = seen.iter().filter(|n| **n > 0.0).count() as f64 / seen.len() as f64;
    ctx.done(
        &args.output,
        format_args!(
            "{fitted} lit points: RMS of ln(fall-off/sample) {mean:.4} in the mean; modulation known for {:.0} % of the pixels",
            100.0 * textured
        ),
    )?;
    ctx.emit_json(json!({
        "output": args.output.to_string_lossy(), "points": model.points.len(), "fitted": fitted,
        "missing_frames": capture.missing, "mean_rms": mean, "textured": textured,
    }))
}

fn fit_mesh(args: &Args, fit: Params, opened: Capture, ctx: &Context) -> anyhow::Result<()> {
    if args.shared || args.segments != 1 {
        let what =
            "--shared and --segments are for flat samples; objects have one fall-off for all colours and directions";
        return Err(Usage(what.into()).into());
    }
    let fit = Params { eta: opened.rig.eta, ..fit };
    let mut mesh = MeshCapture::new(opened, args.threshold)?;
    if mesh.dark > 0 {
        ctx.warn(format!(
            "{}: {} laser positions have no whole set of frames and are left out",
            args.input.display(),
            mesh.dark
        ));
    }
    if args.gains {
        mesh.gains = vertex::estimate_gains(&mesh)?;
        tell_gains(mesh.gains.iter().flatten().flatten(), ctx)?;
    }
    if args.uniform {
        return fit_whole(args, &fit, &mesh, ctx);
    }
    let bar = ctx.progress(mesh.beams.len() as u64, "fitting");
    let params = VertexParams { fit, ..VertexParams::default() };
    let model = fit_vertices(&mesh, &params, || bar.inc(1))?;
    let measured = model.vertices.iter().filter(|v| v.measured()).count();
    let empty = model.vertices.iter().filter(|v| v.fall_off.segments.is_empty()).count();
    if measured == 0 {
        return Err(Error::invalid(&args.input, "no laser position has enough pixels above the noise for a fit").into());
    }
    if empty > 0 {
        ctx.warn(format!("{empty} vertices are on pieces that no laser position lit, and have no fall-off"));
    }
    let head = head(args, &params.fit, &mesh, ctx);
    save_vertex_model(&args.output, &head, &model, &mesh)?;
    let vertices = model.vertices.len();
    let seen = model.texture_samples.iter().flatten().filter(|n| **n > 0.0).count();
    let textured = seen as f64 / model.texture_samples.iter().map(Vec::len).sum::<usize>() as f64;
    ctx.done(
        &args.output,
        format_args!(
            "{vertices} vertices: {measured} measured, {} interpolated, from {} laser positions of which {} gave no stable \
             fit; modulation known for {:.0} % of the surface",
            vertices - measured - empty,
            mesh.beams.len(),
            model.unstable,
            100.0 * textured
        ),
    )?;
    ctx.emit_json(json!({
        "output": args.output.to_string_lossy(), "vertices": vertices, "measured": measured, "empty": empty,
        "positions": mesh.beams.len(), "unstable": model.unstable, "faults": model.faults, "textured": textured,
    }))
}

fn tell_gains<'a>(gains: impl Iterator<Item = &'a f64>, ctx: &Context) -> anyhow::Result<()> {
    let all: Vec<f64> = gains.copied().collect();
    let (low, high) = all.iter().fold((f64::INFINITY, 0.0f64), |(l, h), g| (l.min(*g), h.max(*g)));
    ctx.text(format!("power of the laser from {low:.3} to {high:.3} of what the rig says"))?;
    let alone = all.iter().filter(|g| **g == 1.0).count();
    if alone > 0 {
        ctx.warn(format!(
            "the power in {alone} of {} frames cannot be told: no neighbouring position saw the same place",
            all.len()
        ));
    }
    Ok(())
}

fn fit_whole(args: &Args, fit: &Params, mesh: &MeshCapture, ctx: &Context) -> anyhow::Result<()> {
    let bar = ctx.progress(3 * mesh.beams.len() as u64, "fitting");
    let model = fit_uniform(mesh, fit, || bar.inc(1))?;
    save_uniform_model(&args.output, &head(args, fit, mesh, ctx), &model, mesh)?;
    ctx.done(
        &args.output,
        format_args!(
            "one fall-off for each colour, fitted up to {:.1} mm; error of the square roots of pixels held out {:.3}",
            model.reach_mm,
            model.held_out_error.sqrt()
        ),
    )?;
    ctx.emit_json(json!({
        "output": args.output.to_string_lossy(), "reach_mm": model.reach_mm, "held_out_error": model.held_out_error,
        "positions": mesh.beams.len(),
    }))
}

fn head(args: &Args, fit: &Params, mesh: &MeshCapture, ctx: &Context) -> VertexHead {
    VertexHead {
        command: ctx.command_line.clone(),
        model: fit.model,
        terms: fit.terms,
        threshold: args.threshold,
        channels: mesh.capture.rig.channels.iter().map(|c| c.name.clone()).collect(),
        eta: mesh.capture.rig.eta,
        gains: FrameGain::of(mesh),
    }
}
