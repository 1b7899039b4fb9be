//! `translume field compress`.

use crate::cli::Usage;
use crate::output::Context;
use clap::ValueEnum;
use serde_json::json;
use std::path::PathBuf;
use std::sync::Mutex;
use translume_field::{Domain, Model, Params, Rate, compress, file, texture::Codec, tiles::Tiling};

const EXAMPLES: &str = "\
Examples:
  A folder with pictures and an .lp file:
    translume field compress dome/ -o statue.glb

  As good as 2 MB allow:
    translume field compress dome/ -o statue.glb --bytes 2000000

  Colour errors count half as much as those of luminance:
    translume field compress dome/ -o statue.glb --chroma 0.5

  A BTF of the Bonn database, directions to light and camera in the names:
    translume field compress cloth/ -o cloth.glb --names {*}_tl{theta}_pl{phi}_tv{vtheta}_pv{vphi}.jpg

  The method of the thesis, with 8 terms:
    translume field compress dome/ -o statue.glb --model log-pca --terms 8

  Directions in the names of the pictures (ball_t30_p270.png), linear 16-bit values:
    translume field compress raw/ -o ball.glb --names ball_t{theta}_p{phi}.png --linear-codes

  Lights from a list elsewhere; PTM, as the RTI tools make it:
    translume field compress pictures/ --lights dome.lp -o statue.glb --model ptm";

/// Compress a stack of pictures under many lights into one file
///
/// The folder holds pictures of one view, each under one light, and a list of the directions to the lights: an RTI .lp
/// file, lights.csv (file, x, y, z) or a table of directions (lights.txt) in the order of the numbers in the pictures'
/// names. x is right, y up, z to the camera. Pictures of a BTF or a surface light field, rectified to one grid of texels, have the
/// direction to the camera beside that to the light (lights.csv: file, x, y, z, vx, vy, vz). Pictures may be PNG, JPEG, TIFF, TGA (encoded: 8 or 16 bits) or OpenEXR,
/// Radiance, PFM (linear).
///
/// The file is a binary glTF with block-compressed KTX2 textures; docs/formats/field.md describes it.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    #[command(flatten)]
    source: super::StackArgs,
    /// Output file: a binary glTF file, .glb, whatever its name; names of other formats are refused
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// What to make
    #[arg(long, value_enum, default_value = "layers")]
    model: ModelName,
    /// The same as --model linear-pca
    #[arg(long, conflicts_with = "model")]
    linear: bool,
    /// Number of layers (terms) [default: 16]
    #[arg(long, value_name = "K", conflicts_with_all = ["bytes", "psnr"])]
    terms: Option<usize>,
    /// As many layers as fit into so many bytes
    #[arg(long, value_name = "N", conflicts_with = "psnr")]
    bytes: Option<u64>,
    /// The fewest layers that reach this PSNR in dB after tone mapping, over the pictures of the stack
    #[arg(long, value_name = "DB")]
    psnr: Option<f64>,
    /// Scale on which light is taken apart [default: root; log-pca: log]
    #[arg(long, value_enum)]
    scale: Option<ScaleName>,
    /// Offset δ of that scale, of white 1 [default: root 0.2, log 0.01; log-pca: 0.001]
    #[arg(long, value_name = "SHARE", allow_negative_numbers = true)]
    delta: Option<f32>,
    /// What an error of colour counts beside one of luminance; below 1, luminance gets more of the bits
    #[arg(long, value_name = "WEIGHT", default_value_t = 1.0, allow_negative_numbers = true)]
    chroma: f32,
    /// Store so many planes of what the other layers leave in 16 bits, each in the place of four layers
    #[arg(long, value_name = "N", default_value_t = 0)]
    residual: usize,
    /// How many layers each tile of 32 × 32 texels gets, for the same bytes in all
    #[arg(long, value_enum, default_value = "auto")]
    tiles: TilesName,
    /// Storage of the layers [default: bc4 or bc1, what serves best; PCA: bc1; PTM and HSH: rgb8]
    #[arg(long, value_enum)]
    codec: Option<CodecName>,
    /// What is between the lights [default: cross-validated; PCA: gaussian]
    #[arg(long, value_enum)]
    interpolation: Option<Between>,
    /// Memory for all of it in MiB; a stack larger than three quarters of that is read twice, and what finds no room is kept in
    /// files beside the output, which have no names and end with the program
    #[arg(long, value_name = "MIB", default_value_t = 2048)]
    memory: usize,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ModelName {
    /// Planes with weights in colour, found and stored in a closed loop
    Layers,
    /// Principal components of log light, as the thesis has them
    LogPca,
    /// Principal components of linear light
    LinearPca,
    /// Polynomial texture maps: 6 terms
    Ptm,
    /// Hemispherical harmonics: 9 terms
    Hsh,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ScaleName {
    /// ln(δ + √x): near black as a display shows it, above logarithmic
    Root,
    /// ln(δ + x), as the thesis has it
    Log,
    /// The display's curve
    Display,
    /// PU21, white at 100 cd/m²
    Pu21,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum TilesName {
    /// As many as serve best, where that pays
    Auto,
    /// All the same
    Whole,
    /// None where all pictures are black, elsewhere the same
    Mask,
    /// As many as serve best
    Adaptive,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum CodecName {
    /// One plane, 8 bits a texel
    R8,
    /// Three channels, 24 bits a texel
    Rgb8,
    /// Three channels, 4 bits a texel
    Bc1,
    /// One channel, 4 bits a texel
    Bc4,
    /// Three channels, 8 bits a texel, ends of 10 to 16 bits
    Bc6h,
    /// Three channels, 8 bits a texel
    Bc7,
    /// One plane, 16 bits a texel
    R16,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Between {
    /// Matt surfaces, something rough and noise, as leaving out each light finds best
    CrossValidated,
    /// The thesis' radial function, 1.5 spacings wide
    Gaussian,
}

impl Args {
    fn params(&self) -> anyhow::Result<Params> {
        let model = match self.model {
            _ if self.linear => Model::LinearPca,
            ModelName::Layers => Model::Layers,
            ModelName::LogPca => Model::LogPca,
            ModelName::LinearPca => Model::LinearPca,
            ModelName::Ptm => Model::Ptm,
            ModelName::Hsh => Model::Hsh,
        };
        if matches!(model, Model::Ptm | Model::Hsh)
            && (self.terms.is_some() || self.bytes.is_some() || self.psnr.is_some())
        {
            return Err(Usage("PTM and HSH have a fixed number of terms: no --terms, --bytes or --psnr".into()).into());
        }
        if self.delta.is_some()
            && (!matches!(model, Model::Layers | Model::LogPca)
                || matches!(self.scale, Some(ScaleName::Display | ScaleName::Pu21)))
        {
            return Err(Usage("--delta: this model, or scale, has no logarithm".into()).into());
        }
        let own = self.scale.is_some() || self.chroma != 1.0 || self.residual > 0 || self.tiles != TilesName::Auto;
        if own && model != Model::Layers {
            return Err(
                Usage("--scale, --chroma, --residual and --tiles: only the model `layers` has them".into()).into()
            );
        }
        if self.residual > 0 && !matches!(self.tiles, TilesName::Auto | TilesName::Whole) {
            return Err(Usage("--residual: planes of 16 bits are not cut into tiles".into()).into());
        }
        if self.interpolation.is_some() && matches!(model, Model::Ptm | Model::Hsh) {
            return Err(Usage("--interpolation: PTM and HSH are functions of the direction themselves".into()).into());
        }
        if self.delta.is_some_and(|d| !(d > 0.0 && d.is_finite())) {
            return Err(Usage("--delta must be a positive number".into()).into());
        }
        if self.psnr.is_some_and(|p| !(0.0..=200.0).contains(&p)) {
            return Err(Usage("--psnr takes decibels between 0 and 200".into()).into());
        }
        Ok(Params {
            model,
            rate: match (self.terms, self.bytes, self.psnr) {
                (Some(k), ..) => Rate::Terms(k),
                (_, Some(n), _) => Rate::Bytes(n as usize),
                (.., Some(db)) => Rate::Psnr(db),
                _ => Rate::Default,
            },
            domain: self.domain(model),
            chroma: self.chroma,
            residual: self.residual,
            codec: self.codec.map(|c| match c {
                CodecName::R8 => Codec::R8,
                CodecName::Rgb8 => Codec::Rgb8,
                CodecName::Bc1 => Codec::Bc1,
                CodecName::Bc4 => Codec::Bc4,
                CodecName::Bc6h => Codec::Bc6h,
                CodecName::Bc7 => Codec::Bc7,
                CodecName::R16 => Codec::R16,
            }),
            gaussian: self.interpolation.map(|b| matches!(b, Between::Gaussian)),
            tiling: match self.tiles {
                TilesName::Auto => Tiling::Auto,
                TilesName::Whole => Tiling::Whole,
                TilesName::Mask => Tiling::Mask,
                TilesName::Adaptive => Tiling::Adaptive,
            },
            memory: self.memory.saturating_mul(1 << 20),
            scratch: self.scratch(),
            ..Params::default()
        })
    }
}

impl Args {
    /// The folder of the output, where that is one: there is room for large files, which temporary folders may have in memory only.
    fn scratch(&self) -> Option<PathBuf> {
        let folder = self.output.parent().filter(|_| !translume_image::atomic::is_stream(&self.output))?;
        Some(if folder.as_os_str().is_empty() { PathBuf::from(".") } else { folder.to_owned() })
    }

    /// The scale asked for; `None`: that of the model.
    fn domain(&self, model: Model) -> Option<Domain> {
        let (scale, delta) = (self.scale, self.delta);
        match scale {
            Some(ScaleName::Display) => Some(Domain::Display),
            Some(ScaleName::Pu21) => Some(Domain::Pu21),
            Some(ScaleName::Log) => Some(Domain::Log { delta: delta.unwrap_or(0.01) }),
            Some(ScaleName::Root) => Some(delta.map_or_else(Domain::default, |delta| Domain::Root { delta })),
            None if model == Model::Layers => delta.map(|delta| Domain::Root { delta }),
            None => delta.map(|delta| Domain::Log { delta }),
        }
    }
}

pub(crate) fn run(args: &Args, ctx: &Context) -> anyhow::Result<()> {
    let params = args.params()?;
    super::super::target::wants_field(&args.output)?;
    ctx.claim(&[], &[&args.output])?;
    let start = std::time::Instant::now();
    let mut stack = args.source.open()?;
    ctx.protect(&args.source.files(&stack), &[&args.output])?;
    let bar = ctx.progress(stack.shots.len() as u64, "reading");
    let phase = Mutex::new(String::new());
    let progress = |what: &str| {
        let mut phase = phase.lock().unwrap_or_else(|p| p.into_inner());
        if what == "reading" {
            bar.inc(1);
        } else if *phase != what {
            bar.set_message(what.to_owned());
            what.clone_into(&mut phase);
        }
    };
    let field = compress(&mut stack, &params, &progress)?;
    for warning in &stack.warnings {
        ctx.warn(warning);
    }
    file::write(&args.output, &field, &ctx.command_line, args.bytes.map(|b| b as usize))?;
    bar.finish_and_clear();
    let bytes = super::bytes_of(&args.output, &field)?;
    let mut object = super::describe(&field, bytes);
    let secs = start.elapsed().as_secs_f64();
    object["output"] = json!(args.output);
    object["warnings"] = json!(stack.warnings);
    object["seconds"] = json!(secs);
    ctx.done(
        &args.output,
        format_args!(
            "{} pictures of {} × {} in {} layers, {bytes} bytes, {secs:.1} s",
            stack.shots.len(),
            field.width,
            field.height,
            field.layers.len()
        ),
    )?;
    ctx.emit_json(object)
}
