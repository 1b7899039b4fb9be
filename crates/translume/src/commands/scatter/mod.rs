//! `translume scatter`: models of subsurface scattering from measurements.

mod fit;
mod fit_hierarchical;
pub(super) mod picture;
mod register;
mod relight;
mod report;
mod report_hierarchical;
mod report_mesh;
mod report_planar;
mod samples_plot;
mod simulate;

use crate::output::Context;

const EXAMPLES: &str = "\
Examples:
  Three exponentials for each point of a sample list:
    translume scatter fit samples.npy --model exponential --terms 3 -o fit.json

  A virtual capture of marble, its model with eight directions, and how good that is:
    translume scatter simulate marble -o capture/
    translume scatter fit capture/ --model exponential --segments 8 -o model/
    translume scatter report capture/ model/ -o report/";

/// Measure subsurface scattering: capture, register, fit models, report their errors
///
/// Lengths are millimetres, coefficients per millimetre.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, clap::Subcommand)]
#[allow(clippy::large_enum_variant, reason = "one exists at a time")]
enum Verb {
    Simulate(simulate::Args),
    Register(register::Args),
    Fit(fit::Args),
    Relight(relight::Args),
    Report(report::Args),
}

pub(crate) fn run(args: Args, ctx: &Context) -> anyhow::Result<()> {
    match args.verb {
        Verb::Simulate(args) => simulate::run(&args, ctx),
        Verb::Register(args) => register::run(&args, ctx),
        Verb::Fit(args) => fit::run(&args, ctx),
        Verb::Relight(args) => relight::run(&args, ctx),
        Verb::Report(args) => report::run(&args, ctx),
    }
}
