//! Pictures of lit objects as files.

use super::super::target::Kind;
use crate::output::Context;
use std::path::Path;
use translume_image::colour::linear_to_srgb;
use translume_image::{ExrOptions, Precision, write_exr_channels, write_png8};

const KINDS: [Kind; 2] = [Kind::Exr, Kind::Png];

/// Whether a picture can be written there, beside what is read.
pub(super) fn check(inputs: &[&Path], output: &Path, ctx: &Context) -> anyhow::Result<()> {
    Kind::of(output, &KINDS, "picture")?;
    ctx.claim(inputs, &[output])
}

/// What is shown as white: so many in a hundred of the values that are not zero are darker.
pub(crate) fn white(picture: &[[f32; 3]], percent: usize) -> f32 {
    let mut levels: Vec<f32> = picture.iter().flatten().copied().filter(|v| *v > 0.0).collect();
    levels.sort_unstable_by(f32::total_cmp);
    levels.get(levels.len() * percent / 100).copied().unwrap_or(1.0)
}

/// Writes linear RGB to look at, `white` and what is brighter as white.
pub(crate) fn write_png(output: &Path, size: (usize, usize), picture: &[[f32; 3]], white: f32) -> anyhow::Result<()> {
    let code = |v: &f32| (linear_to_srgb((v / white).clamp(0.0, 1.0)) * 255.0).round() as u8;
    Ok(write_png8(output, size, &picture.iter().flatten().map(code).collect::<Vec<_>>())?)
}

/// Writes linear RGB; PNG files are for a look.
pub(super) fn write(output: &Path, size: (usize, usize), picture: &[[f32; 3]], ctx: &Context) -> anyhow::Result<()> {
    if Kind::of(output, &KINDS, "picture")? == Kind::Png {
        return write_png(output, size, picture, white(picture, 99));
    }
    let plane = |c: usize| picture.iter().map(|p| p[c]).collect::<Vec<f32>>();
    let planes = [plane(0), plane(1), plane(2)];
    let channels: Vec<(&str, &[f32])> = ["R", "G", "B"].into_iter().zip(planes.iter().map(Vec::as_slice)).collect();
    let options = ExrOptions {
        precision: Precision::Float,
        software: Some(format!("translume {}", env!("CARGO_PKG_VERSION"))),
        command: Some(ctx.command_line.clone()),
        ..ExrOptions::default()
    };
    Ok(write_exr_channels(output, size, &channels, &options)?)
}
