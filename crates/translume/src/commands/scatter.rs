//! `translume scatter`: models of subsurface scattering from measurements.

use crate::cli::Usage;
use crate::output::Context;
use clap::builder::RangedU64ValueParser;
use serde_json::json;
use std::path::PathBuf;
use translume_image::atomic;
use translume_scatter::{Error, MAX_TERMS, Model, Params, SampleFile, Sink, fit_file};

const EXAMPLES: &str = "\
Examples:
  Three exponentials for each point of a sample list:
    translume scatter fit samples.npy --model exponential --terms 3 -o fit.json

  The same with eight directions of their own, told as JSON:
    translume scatter fit samples.npy --segments 8 -o fit.json --json";

const FIT_EXAMPLES: &str = "\
Examples:
  Sums of three exponentials:
    translume scatter fit samples.npy --model exponential --terms 3 -o fit.json

  Fall-off that depends on the direction:
    translume scatter fit samples.npy --segments 8 -o fit.json

  Scattering and absorption of a homogeneous material, by Jensen's dipole:
    translume scatter fit samples.npy --model dipole --eta 1.3 -o dipole.json";

/// Measure subsurface scattering: fit models to samples around lit points
///
/// Lengths are millimetres, coefficients per millimetre.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    /// Fit a model of the fall-off to samples around lit points
    ///
    /// SAMPLES.npy is a float32 array (points, samples, 3): x and y from the lit point in mm, and the value of R_d; 0 or
    /// less is below the noise floor and left out. The errors of the logarithm are minimised, so that far samples count
    /// like near ones. The file is read a block at a time and may be larger than the memory.
    #[command(after_long_help = FIT_EXAMPLES)]
    Fit(FitArgs),
}

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
}

#[derive(Debug, clap::Args)]
struct FitArgs {
    /// A list of samples, .npy
    #[arg(value_name = "SAMPLES.npy")]
    input: PathBuf,
    /// The fits, as JSON
    #[arg(short, long, value_name = "FIT.json")]
    output: PathBuf,
    /// The model
    #[arg(long, value_enum, default_value_t = ModelName::Exponential)]
    model: ModelName,
    /// Most exponentials of a sum; fewer are kept where the samples do not tell more apart
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = RangedU64ValueParser::<usize>::new().range(1..=MAX_TERMS as u64))]
    terms: usize,
    /// Directions with a fall-off of their own, blended between their centres: 1, or 3 to 64
    #[arg(long, value_name = "M", default_value_t = 1, value_parser = RangedU64ValueParser::<usize>::new().range(1..=64))]
    segments: usize,
    /// Index of refraction for the dipoles
    #[arg(long, value_name = "ETA", default_value_t = 1.3)]
    eta: f64,
    /// Fit a factor to the dipoles too, for samples whose unit is not mm⁻²
    #[arg(long)]
    free_scale: bool,
}

pub(crate) fn run(args: Args, ctx: &Context) -> anyhow::Result<()> {
    match args.verb {
        Verb::Fit(args) => fit(&args, ctx),
    }
}

fn params(args: &FitArgs) -> anyhow::Result<Params> {
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
    };
    if args.free_scale && !matches!(model, Model::Dipole | Model::BetterDipole) {
        return Err(Usage("--free-scale: only the dipoles have a scale of their own".into()).into());
    }
    Ok(Params { model, terms: args.terms, segments: args.segments, eta: args.eta, free_scale: args.free_scale })
}

fn fit(args: &FitArgs, ctx: &Context) -> anyhow::Result<()> {
    let params = params(args)?;
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
    ctx.text(format!(
        "{} points, {} samples above the noise floor: RMS of ln(model/sample) {:.4} in the mean, {:.4} at worst",
        summary.fitted, summary.samples, summary.mean_rms, summary.worst_rms
    ))?;
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
