//! `translume scatter fit --model hierarchical`.

use super::fit::Args;
use crate::cli::Usage;
use crate::output::Context;
use serde_json::json;
use translume_scatter::capture::Capture;
use translume_scatter::hierarchical::{
    AtlasParams, HierarchicalHead, HierarchicalParams, Losses, Stage, Step, fit_hierarchical, save_hierarchical,
};

/// Share of measured pairs below which a model says more about its completion than about the object.
const FEW: f64 = 0.05;

pub(super) fn run(args: &Args, ctx: &Context) -> anyhow::Result<()> {
    if args.shared || args.gains || args.free_scale || args.uniform || args.segments != 1 {
        let what = "--shared, --gains, --free-scale, --uniform and --segments are about fall-offs; the hierarchical model has none";
        return Err(Usage(what.into()).into());
    }
    if args.threshold.is_nan() || args.threshold < 0.0 {
        return Err(Usage("--threshold: it must be 0 or more".into()).into());
    }
    if !args.input.is_dir() {
        let what = format!("{}: hierarchical models are fitted to captures, which are folders", args.input.display());
        return Err(Usage(what).into());
    }
    ctx.protect(&[&args.input], &[&args.output])?;
    translume_scatter::check_model_folder(&args.output)?;
    let stage = Stage::new(Capture::open(&args.input)?, args.threshold, &AtlasParams::default())?;
    let (positions, vertices) = (stage.positions() as u64, stage.surface.mesh.positions.len() as u64);
    let params = HierarchicalParams::default();
    let rounds = params.rounds as u64;
    let bar = ctx.progress((2 + rounds) * positions + (1 + rounds) * vertices, "resampling");
    let (model, told) = fit_hierarchical(stage, &params, |step| {
        bar.set_message(match step {
            Step::Resampled => "resampling",
            Step::Completed => "completing",
            Step::Detailed => "detail",
        });
        bar.inc(1);
    })?;
    warn(args, &told.losses, ctx);
    if told.completion.measured < FEW && args.threshold > 0.0 {
        ctx.warn(format!(
            "{}: only {:.1} % of the pairs of vertices are above --threshold {} and measured, the others are guessed; where the laser's power varies \
             (simulate --evenness) or frames are faint, --threshold 0 takes all samples",
            args.input.display(),
            100.0 * told.completion.measured,
            args.threshold
        ));
    }
    let head = HierarchicalHead::new(&model, &told, ctx.command_line.clone(), args.threshold);
    save_hierarchical(&args.output, &head, &model)?;
    let texels = model.atlas.texels.len();
    let modulated = model.detail_weight.iter().filter(|w| **w > 0.0).count() as f64 / texels as f64;
    let completion = told.completion;
    ctx.done(
        &args.output,
        format_args!(
            "{vertices} vertices, {:.0} % of their pairs measured; {} vertices were never lit and {} never seen, their values \
             are filled in; {texels} kernels, {} of them measured, error of spots held out {:.3}; modulation known for {:.0} % \
             of the surface",
            100.0 * completion.measured,
            completion.never_lit,
            completion.never_seen,
            told.measured_kernels,
            told.kernel_error,
            100.0 * modulated
        ),
    )?;
    ctx.emit_json(json!({
        "output": args.output.to_string_lossy(), "vertices": vertices, "measured": completion.measured,
        "never_lit": completion.never_lit, "never_seen": completion.never_seen, "kernels": texels,
        "measured_kernels": told.measured_kernels, "kernel_error": told.kernel_error, "modulated": modulated, "positions": positions,
        "astray": told.losses.astray, "missing": told.losses.missing, "dark": told.losses.dark, "clipped": told.losses.clipped,
        "atlas_side": model.atlas.side, "texel_mm": model.atlas.texel_mm,
    }))
}

fn warn(args: &Args, losses: &Losses, ctx: &Context) {
    let input = args.input.display();
    for (count, what) in [
        (losses.missing, "laser positions have no view with all channels and are left out"),
        (losses.dark, "laser positions have dark frames or no spot where the rig says, and are left out"),
        (losses.astray, "laser positions miss the mesh or graze it and are left out"),
        (losses.clipped, "views of laser positions are clipped; their brightest pixels are left out"),
    ] {
        if count > 0 {
            ctx.warn(format!("{input}: {count} {what}"));
        }
    }
}
