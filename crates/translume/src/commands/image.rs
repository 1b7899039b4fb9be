//! `translume image`: what a picture file holds, conversion between formats and colour spaces, tone mapping.

use super::target::{Kind, save_display};
use crate::cli::Usage;
use crate::output::Context;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use translume_image::colour::Space;
use translume_image::tonemap::{self, FattalParams, ReinhardParams};
use translume_image::{
    Error, ExrCompression, ExrOptions, ExrPart, Format, Precision, Samples, read_codes, read_exr_parts, read_layer,
    read_picture, write_exr, write_hdr, write_pfm, write_tiff_float,
};

const INFO_EXAMPLES: &str = "\
Examples:
  Say what is known about a bracket:
    translume image info IMG_1.jpg IMG_2.jpg IMG_3.jpg

  List the channels of a file for a script:
    translume image info layers.exr --json | jq -r .files[0].parts[].channels[].name";

const CONVERT_EXAMPLES: &str = "\
Examples:
  A Radiance file as half-float OpenEXR:
    translume image convert memorial.hdr -o memorial.exr

  ACEScg, 32 bits:
    translume image convert render.exr -o render-ap1.exr --output-space acescg --precision float

  One layer of many:
    translume image convert layers.exr -o albedo.exr --layer albedo

  Two stops brighter as 16-bit PNG:
    translume image convert render.exr -o render.png --bits 16 --ev 2";

const TONEMAP_EXAMPLES: &str = "\
Examples:
  Reinhard's global operator:
    translume image tonemap memorial.hdr -o memorial.png

  Gradient-domain compression, more colour:
    translume image tonemap memorial.hdr -o memorial.png --operator fattal --saturation 0.8

  One exposure, gamma 2.2:
    translume image tonemap memorial.hdr -o memorial.png --operator exposure --ev -3 --gamma 2.2";

/// Show, convert and tone map pictures
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Args {
    Info(InfoArgs),
    Convert(ConvertArgs),
    Tonemap(TonemapArgs),
    Denoise(super::denoise::Args),
}

/// Say what picture files hold: format, size, range, shot, channels
#[derive(Debug, clap::Args)]
#[command(after_long_help = INFO_EXAMPLES)]
pub(crate) struct InfoArgs {
    /// Pictures (OpenEXR, Radiance, PFM, PNG, JPEG, TIFF)
    #[arg(required = true, value_name = "IMG")]
    images: Vec<PathBuf>,
}

/// Convert a picture to another format or colour space
///
/// The format follows from the name of the output: .exr, .hdr, .pfm and .tif hold linear light; .png, .jpg (and .tif with
/// --bits) hold sRGB clipped to [0, 1]. Pipes and /dev/stdout get OpenEXR.
#[derive(Debug, clap::Args)]
#[command(after_long_help = CONVERT_EXAMPLES)]
pub(crate) struct ConvertArgs {
    /// Picture (OpenEXR, Radiance, PFM, PNG, JPEG, TIFF)
    image: PathBuf,
    /// Output file
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Layer of an .exr file: `albedo` for channels albedo.R, albedo.G, albedo.B, or the name of a part
    #[arg(long, value_name = "NAME")]
    layer: Option<String>,
    /// Primaries of the output (only .exr and .hdr can say others than Rec. 709)
    #[arg(long, value_name = "SPACE", default_value = "rec709", value_parser = ["rec709", "rec2020", "acescg"])]
    output_space: String,
    /// Sample type of .exr files [default: half]
    #[arg(long, value_name = "TYPE", value_parser = ["half", "float"])]
    precision: Option<String>,
    /// Compression of .exr files [default: zip]
    #[arg(long, value_name = "METHOD", value_parser = ["none", "rle", "zip", "piz"])]
    compression: Option<String>,
    /// Bits of a sample in .png and .tif files: 8 or 16 [default: 8 for .png, float for .tif]
    #[arg(long, value_name = "N", value_parser = bits)]
    bits: Option<u8>,
    /// Make it this many stops brighter
    #[arg(long, value_name = "STOPS", default_value_t = 0.0, allow_negative_numbers = true)]
    ev: f32,
}

/// Map linear light to what a display shows
#[derive(Debug, clap::Args)]
#[command(after_long_help = TONEMAP_EXAMPLES)]
pub(crate) struct TonemapArgs {
    /// Picture (OpenEXR, Radiance, PFM, PNG, JPEG, TIFF)
    image: PathBuf,
    /// Output file (.png, .tif or .jpg)
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// reinhard: one curve for all pixels; fattal: compresses large gradients, keeps small ones; exposure: clips
    #[arg(long, value_name = "NAME", default_value = "reinhard", value_parser = ["reinhard", "fattal", "exposure"])]
    operator: String,
    /// reinhard, exposure: make it this many stops brighter [default: 0]
    #[arg(long, value_name = "STOPS", allow_negative_numbers = true)]
    ev: Option<f32>,
    /// reinhard: smallest luminance shown as white, where middle gray is 0.18 [default: the maximum]
    #[arg(long, value_name = "L", value_parser = positive)]
    white: Option<f32>,
    /// exposure: gamma of the display [default: the sRGB curve]
    #[arg(long, value_name = "GAMMA", value_parser = positive)]
    gamma: Option<f32>,
    /// fattal: gradients of this share of the mean keep their size [default: 0.1]
    #[arg(long, value_name = "SHARE", value_parser = positive)]
    alpha: Option<f32>,
    /// fattal: exponent of the compression; smaller is stronger [default: 0.85]
    #[arg(long, value_name = "EXPONENT", value_parser = positive)]
    beta: Option<f32>,
    /// fattal: how much colour is kept [default: 0.6]
    #[arg(long, value_name = "S", value_parser = positive)]
    saturation: Option<f32>,
    /// Bits of a sample: 8 or 16
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = bits)]
    bits: u8,
}

fn bits(text: &str) -> Result<u8, String> {
    text.parse().ok().filter(|b| [8, 16].contains(b)).ok_or_else(|| "it is 8 or 16".to_owned())
}

pub(super) fn positive(text: &str) -> Result<f32, String> {
    text.parse()
        .ok()
        .filter(|v: &f32| *v > 0.0 && v.is_finite())
        .ok_or_else(|| "a positive number is wanted".to_owned())
}

pub(crate) fn run(args: Args, ctx: &Context) -> anyhow::Result<()> {
    match args {
        Args::Info(args) => info(&args, ctx),
        Args::Convert(args) => convert(args, ctx),
        Args::Tonemap(args) => tone_map(&args, ctx),
        Args::Denoise(args) => super::denoise::run(&args, ctx),
    }
}

fn info(args: &InfoArgs, ctx: &Context) -> anyhow::Result<()> {
    let mut objects = Vec::new();
    for path in &args.images {
        let (text, object) = describe(path)?;
        ctx.text(text)?;
        objects.push(object);
    }
    ctx.emit_json(json!({ "files": objects }))
}

/// One file as text and as a JSON object.
fn describe(path: &Path) -> anyhow::Result<(String, Value)> {
    let format = Format::of_file(path)?;
    let codes = match read_codes(path) {
        Err(e @ Error::Layers { .. }) => return describe_layers(path, &e),
        codes => codes?,
    };
    let kind = match codes.samples {
        Samples::U8(_) => "8-bit",
        Samples::U16(_) => "16-bit",
        Samples::F32(_) => "float",
    };
    let finite = (0..3 * codes.width * codes.height).map(|i| codes.unit(i)).filter(|v| v.is_finite());
    let (low, high) = finite.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    let non_finite = codes.count_non_finite();
    let m = &codes.metadata;
    let mut lines = vec![format!("{}: {}, {} × {}, {kind}", path.display(), format.name(), codes.width, codes.height)];
    lines.push(format!("  values      {low} to {high}"));
    let mut add = |name: &str, value: Option<String>| lines.extend(value.map(|v| format!("  {name:11} {v}")));
    add("non-finite", (non_finite > 0).then(|| non_finite.to_string()));
    add("exposure", m.exposure_secs.map(|t| if t < 0.5 { format!("1/{:.0} s", 1.0 / t) } else { format!("{t} s") }));
    add("aperture", m.f_number.map(|n| format!("f/{n}")));
    add("ISO", m.iso.map(|v| v.to_string()));
    add("camera", m.camera.clone());
    add("date", m.date_time.clone());
    add("owner", m.owner.clone());
    add("ICC profile", m.icc.as_ref().map(|p| format!("{} bytes", p.len())));
    add("primaries", m.chromaticities.map(|c| format!("{c:?} (R, G, B, white)")));
    let parts = if format == Format::Exr { read_exr_parts(path)? } else { Vec::new() };
    lines.extend(parts.iter().map(part_line));
    let object = json!({
        "file": path.to_string_lossy(), "format": format.name(), "width": codes.width, "height": codes.height,
        "samples": kind, "min": low.is_finite().then_some(low), "max": high.is_finite().then_some(high),
        "non_finite": non_finite, "exposure_secs": m.exposure_secs, "f_number": m.f_number, "iso": m.iso,
        "relative_exposure": m.relative_exposure(), "camera": m.camera, "date_time": m.date_time, "owner": m.owner,
        "icc_bytes": m.icc.as_ref().map(Vec::len), "chromaticities": m.chromaticities,
        "parts": parts.iter().map(part_object).collect::<Vec<_>>(),
    });
    Ok((lines.join("\n"), object))
}

/// An OpenEXR file that shows nothing without the name of a layer.
fn describe_layers(path: &Path, why: &Error) -> anyhow::Result<(String, Value)> {
    let parts = read_exr_parts(path)?;
    let [_, _, width, height] = parts.first().map_or([0; 4], |p| p.display_window);
    let mut lines = vec![format!("{}: OpenEXR, {width} × {height}", path.display())];
    lines.extend(parts.iter().map(part_line));
    let note = why.to_string();
    lines.push(format!("  {}", note.strip_prefix(&format!("{}: ", path.display())).unwrap_or(&note)));
    let object = json!({
        "file": path.to_string_lossy(), "format": "OpenEXR", "width": width, "height": height, "samples": null,
        "parts": parts.iter().map(part_object).collect::<Vec<_>>(),
    });
    Ok((lines.join("\n"), object))
}

fn part_line(part: &ExrPart) -> String {
    let channels: Vec<String> = part.channels.iter().map(|c| format!("{} ({})", c.name, c.sample_type)).collect();
    let tiles = part.tiles.map_or(String::new(), |[w, h]| format!(", tiles of {w} × {h}"));
    let name = part.name.as_ref().map_or(String::new(), |n| format!(" {n}"));
    let [x, y, w, h] = part.data_window;
    let window = if part.data_window == part.display_window {
        String::new()
    } else {
        format!(", data window {w} × {h} at ({x}, {y})")
    };
    let texts: String = part.texts.iter().map(|(k, v)| format!("\n    {k}: {v}")).collect();
    format!("  part{name}: {}, {}{tiles}{window}{texts}", channels.join(", "), part.compression)
}

fn part_object(part: &ExrPart) -> Value {
    let channels = part.channels.iter().map(|c| json!({ "name": c.name, "type": c.sample_type }));
    json!({
        "name": part.name, "channels": channels.collect::<Vec<_>>(), "compression": part.compression,
        "tiles": part.tiles, "data_window": part.data_window, "display_window": part.display_window,
        "attributes": part.texts.iter().cloned().collect::<std::collections::BTreeMap<_, _>>(),
    })
}

fn convert(args: ConvertArgs, ctx: &Context) -> anyhow::Result<()> {
    let output = args.output.as_path();
    let kind = Kind::of(output, &[Kind::Exr, Kind::Hdr, Kind::Pfm, Kind::Tiff, Kind::Png, Kind::Jpeg], "picture")?;
    ctx.claim(&[&args.image], &[output])?;
    let space = Space::named(&args.output_space).expect("clap lets only these pass");
    if ![Kind::Exr, Kind::Hdr].contains(&kind) && args.output_space != "rec709" {
        return Err(Usage(format!("{}: only .exr and .hdr say their primaries", args.output.display())).into());
    }
    let exr_only = args.precision.is_some() || args.compression.is_some();
    if exr_only && kind != Kind::Exr {
        return Err(Usage(format!("{}: --precision and --compression are for .exr", args.output.display())).into());
    }
    if args.bits.is_some() && ![Kind::Png, Kind::Tiff].contains(&kind) {
        return Err(Usage(format!("{}: --bits is for .png and .tif", args.output.display())).into());
    }
    let mut picture = match &args.layer {
        Some(layer) => read_layer(&args.image, layer)?,
        None => read_picture(&args.image).map_err(|e| match e {
            Error::Layers { .. } => anyhow::anyhow!("{e}; give it as --layer NAME"),
            other => other.into(),
        })?,
    };
    let non_finite = picture.count_non_finite();
    if non_finite > 0 {
        ctx.warn(format_args!("{}: {non_finite} values are NaN or infinite", args.image.display()));
    }
    if args.ev != 0.0 {
        picture.pixels.iter_mut().for_each(|v| *v *= args.ev.exp2());
    }
    if picture.alpha.is_some() && kind != Kind::Exr {
        ctx.warn(format_args!("{}: transparency is left out", args.output.display()));
    }
    let picture = picture.into_space(&space);
    match (kind, args.bits) {
        (Kind::Exr, _) => write_exr(output, &picture, &exr_options(&args, ctx))?,
        (Kind::Hdr, _) => write_hdr(output, &picture)?,
        (Kind::Pfm, _) => write_pfm(output, &picture)?,
        (Kind::Tiff, None) => write_tiff_float(output, &picture)?,
        (Kind::Png | Kind::Jpeg | Kind::Tiff, bits) => {
            save_display(&tonemap::exposure_gamma(&picture, 0.0, None), output, kind, bits.unwrap_or(8))?;
        }
    }
    written(ctx, output, picture.pixels.dimensions())
}

fn exr_options(args: &ConvertArgs, ctx: &Context) -> ExrOptions {
    ExrOptions {
        precision: if args.precision.as_deref() == Some("float") { Precision::Float } else { Precision::Half },
        compression: match args.compression.as_deref() {
            Some("none") => ExrCompression::None,
            Some("rle") => ExrCompression::Rle,
            Some("piz") => ExrCompression::Piz,
            _ => ExrCompression::Zip,
        },
        software: Some(concat!("translume ", env!("CARGO_PKG_VERSION")).to_owned()),
        command: Some(ctx.command_line.clone()),
        ..ExrOptions::default()
    }
}

fn tone_map(args: &TonemapArgs, ctx: &Context) -> anyhow::Result<()> {
    let given = [
        ("ev", args.ev.is_some(), ["reinhard", "exposure"]),
        ("white", args.white.is_some(), ["reinhard"; 2]),
        ("gamma", args.gamma.is_some(), ["exposure"; 2]),
        ("alpha", args.alpha.is_some(), ["fattal"; 2]),
        ("beta", args.beta.is_some(), ["fattal"; 2]),
        ("saturation", args.saturation.is_some(), ["fattal"; 2]),
    ];
    if let Some((name, ..)) = given.iter().find(|(_, given, of)| *given && !of.contains(&args.operator.as_str())) {
        return Err(Usage(format!("--{name} is no option of the operator {}", args.operator)).into());
    }
    let kind = Kind::of(&args.output, &[Kind::Png, Kind::Tiff, Kind::Jpeg], "picture for a display")?;
    if kind == Kind::Jpeg && args.bits == 16 {
        return Err(Usage(format!("{}: --bits 16 is for .png and .tif", args.output.display())).into());
    }
    ctx.claim(&[&args.image], &[&args.output])?;
    let picture = read_picture(&args.image)?;
    let ev = args.ev.unwrap_or(0.0);
    let shown = match args.operator.as_str() {
        "fattal" => {
            let mut params = FattalParams::default();
            params.alpha = args.alpha.unwrap_or(params.alpha);
            params.beta = args.beta.unwrap_or(params.beta);
            params.saturation = args.saturation.unwrap_or(params.saturation);
            tonemap::fattal(&picture, &params)
        }
        "exposure" => tonemap::exposure_gamma(&picture, ev, args.gamma),
        _ => {
            let key = ReinhardParams::default().key * ev.exp2();
            tonemap::reinhard_global(&picture, &ReinhardParams { key, white: args.white })
        }
    };
    save_display(&shown, &args.output, kind, args.bits)?;
    written(ctx, &args.output, picture.pixels.dimensions())
}

fn written(ctx: &Context, output: &Path, (width, height): (u32, u32)) -> anyhow::Result<()> {
    ctx.done(output, format_args!("{width} × {height} pixels"))?;
    ctx.emit_json(json!({ "output": output.to_string_lossy(), "width": width, "height": height }))
}
