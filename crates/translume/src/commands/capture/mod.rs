//! `translume capture`: virtual instruments on the renderer.

mod light_stage;

use crate::output::Context;

/// Take measurements of a scene with virtual instruments
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Args {
    LightStage(light_stage::Args),
}

pub(crate) fn run(args: Args, ctx: &Context) -> anyhow::Result<()> {
    match args {
        Args::LightStage(args) => light_stage::run(&args, ctx),
    }
}
