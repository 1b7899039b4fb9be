//! `translume hdr`: brackets to radiance.

mod report;
mod scale;
mod sets;

use super::target::{Kind, save_display};
use crate::cli::Usage;
use crate::output::Context;
use anyhow::{Context as _, bail};
use clap::ValueEnum;
use scale::{ScaleBy, Scales};
use serde_json::{Value, json};
use sets::Set;
use std::path::{Path, PathBuf};
use translume_hdr::{Alignment, Exposure, GhostParams, Merged, Noise, Params, Response, Weights, ghost_share};
use translume_image::{ExrOptions, Metadata, Picture, Precision, atomic, colour, primaries, tonemap};

const EXAMPLES: &str = "\
Examples:
  Three photographs taken by hand; exposures from EXIF:
    translume hdr IMG_1.JPG IMG_2.JPG IMG_3.JPG -o room.exr

  Also a picture to look at, and a page that shows what was done:
    translume hdr IMG_*.JPG -o room.exr --preview room.png --report room-report/

  Scans without EXIF, times from a list (file name and seconds per line):
    translume hdr scans/*.png --list scans/times.txt -o church.exr

  Times or steps given by hand, in the order of the pictures; the second picture's view:
    translume hdr a.tif b.tif c.tif --exposures 1/60,1/15,1/4 --anchor 1 -o out.exr
    translume hdr a.tif b.tif c.tif --ev -2,0,2 --preset tripod -o out.exr

  A folder of many brackets of three, into a folder:
    translume hdr shoot/ --group 3 -o merged/ --preview

  Learn the camera's response once, use it afterwards:
    translume hdr chart/*.jpg -o chart.exr --save-response camera.json
    translume hdr a.jpg b.jpg --response camera.json -o ab.exr";

/// Merge exposure brackets, hand-held ones too, into HDR radiance pictures
///
/// Pictures of one scene at two or more exposures, in any order, become one linear picture in the view of one of them,
/// the anchor. Motion of the camera is aligned, what moved in the scene is taken from the anchor. JPEG, PNG and TIFF
/// (8 and 16 bit), and linear OpenEXR, Radiance and PFM are read. Values are scaled like the anchor's: its mid grey comes
/// out as 0.214. Brackets of one run that have the same exposures have one scale, so that they make a panorama.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    /// Pictures of one bracket, or folders of brackets
    #[arg(value_name = "IMG", required = true, num_args = 1..)]
    inputs: Vec<PathBuf>,
    /// The result: .exr, .hdr, .pfm or .tif (float); any other name is a folder, for OpenEXR files with the brackets' names
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,

    /// Exposure times in the order of the pictures: 1/30,1/8,0.5
    #[arg(long, value_name = "A,B,…", value_delimiter = ',', help_heading = "Exposures", conflicts_with_all = ["list", "ev"])]
    exposures: Vec<String>,
    /// A file with name and seconds per line
    #[arg(long, value_name = "FILE", help_heading = "Exposures", conflicts_with = "ev")]
    list: Option<PathBuf>,
    /// Exposure steps in stops, in the order of the pictures: -2,0,2
    #[arg(long, value_name = "A,B,…", value_delimiter = ',', allow_hyphen_values = true, help_heading = "Exposures")]
    ev: Vec<f64>,
    /// Pictures per bracket in a folder [default: from the pattern of exposures]
    #[arg(long, value_name = "N", help_heading = "Exposures")]
    group: Option<usize>,

    /// What to expect of the capture
    #[arg(long, value_enum, default_value_t = Preset::Handheld, help_heading = "Method")]
    preset: Preset,
    /// How far to align [default: nonlinear; off with --preset tripod]
    #[arg(long, value_enum, value_name = "HOW", help_heading = "Method")]
    align: Option<Align>,
    /// Take the pictures as registered: --align off
    #[arg(long, help_heading = "Method", conflicts_with = "align")]
    no_align: bool,
    /// Keep what moved
    #[arg(long, help_heading = "Method")]
    no_deghost: bool,
    /// The picture whose view the result has, counted from 0 in the order given [default: that of highest entropy]
    #[arg(long, value_name = "N", help_heading = "Method")]
    anchor: Option<usize>,
    /// How pixels are weighed: the thesis' spline, or the inverse variance of shot and read noise
    #[arg(long, value_enum, default_value_t = WeightKind::Spline, help_heading = "Method")]
    weights: WeightKind,
    /// Electrons at full range, for --weights variance
    #[arg(long, value_name = "E", default_value_t = 20000.0, help_heading = "Method")]
    full_well: f32,
    /// Read noise in electrons, for --weights variance
    #[arg(long, value_name = "E", default_value_t = 5.0, help_heading = "Method")]
    read_noise: f32,
    /// The codes are proportional to light: no response curve
    #[arg(long, help_heading = "Method", conflicts_with = "response")]
    linear: bool,
    /// A response saved before, instead of an estimated one
    #[arg(long, value_name = "CURVE.json", help_heading = "Method")]
    response: Option<PathBuf>,
    /// Luminance in cd/m² of the centre of the picture (a tenth of its sides): scales the result to be absolute
    #[arg(long, value_name = "CD_M2", help_heading = "Method")]
    calibrate: Option<f64>,

    /// What sets the scale of the values [default: common for brackets of one run with the same exposures, else anchor]
    #[arg(long, value_enum, value_name = "HOW", help_heading = "Method")]
    scale: Option<ScaleBy>,

    /// Also write a tone-mapped picture, .png, .jpg or .tif [default name: that of the result with .png]
    #[arg(long, value_name = "P.png", num_args = 0..=1, help_heading = "Outputs")]
    preview: Option<Option<PathBuf>>,
    /// Tone mapping of the preview
    #[arg(long, value_enum, default_value_t = Tonemap::Reinhard, help_heading = "Outputs")]
    preview_tonemap: Tonemap,
    /// Also write a page with pictures of what was done
    #[arg(long, value_name = "DIR", help_heading = "Outputs")]
    report: Option<PathBuf>,
    /// Also write the displacement of each picture (float EXR, channels X and Y in anchor pixels)
    #[arg(long, value_name = "DIR", help_heading = "Outputs")]
    fields: Option<PathBuf>,
    /// Also write where pictures were left out as ghosts (white), and where all are clipped (mid grey: a lower bound)
    #[arg(long, value_name = "M.png", num_args = 0..=1, help_heading = "Outputs")]
    mask: Option<Option<PathBuf>>,
    /// Also write the response curve
    #[arg(long, value_name = "CURVE.json", help_heading = "Outputs")]
    save_response: Option<PathBuf>,
    /// Sample type of the result [default: half; float where values are beyond 65504]
    #[arg(long, value_enum, help_heading = "Outputs")]
    precision: Option<Sample>,
    /// Primaries of the result
    #[arg(long, value_enum, default_value_t = Space::Rec709, help_heading = "Outputs")]
    output_space: Space,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Preset {
    /// Nothing moves: no alignment, no ghost removal
    Tripod,
    /// The camera moves, and some things in the scene
    Handheld,
    /// Much moves: stricter ghost removal
    Moving,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Align {
    /// Not at all
    Off,
    /// By one affine map per picture
    Global,
    /// Also by a field of local displacements
    Nonlinear,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum WeightKind {
    Spline,
    Variance,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Tonemap {
    /// Global operator of Reinhard 2002
    Reinhard,
    /// Gradient domain, Fattal 2002
    Fattal,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Sample {
    Half,
    Float,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Space {
    Rec709,
    Rec2020,
    Acescg,
}

/// Where the outputs of one bracket go.
struct Targets {
    picture: PathBuf,
    preview: Option<PathBuf>,
    mask: Option<PathBuf>,
    report: Option<PathBuf>,
    fields: Option<PathBuf>,
}

pub(crate) fn run(args: Args, ctx: &Context) -> anyhow::Result<()> {
    let params = params(&args)?;
    let sets = sets::collect(&args, ctx)?;
    let into_folder = names_folder(&args.output);
    if let [set] = &sets[..] {
        let targets = targets(&args, into_folder.then_some(&set.name));
        check(&args, &sets, std::slice::from_ref(&targets), ctx)?;
        if into_folder {
            std::fs::create_dir_all(&args.output)
                .with_context(|| format!("cannot create {}", args.output.display()))?;
        }
        let summary = merge_one(&args, &params, set, &targets, &mut Scales::default(), ctx)?;
        ctx.done(&targets.picture, describe(&summary))?;
        return ctx.emit_json(summary);
    }
    if !into_folder {
        let n = sets.len();
        return Err(Usage(format!("{n} brackets: -o names a folder ({}/)", args.output.display())).into());
    }
    run_batch(&args, &params, &sets, ctx)
}

/// Several brackets: each into the output folder, a failure does not stop the others.
fn run_batch(args: &Args, params: &Params, sets: &[Set], ctx: &Context) -> anyhow::Result<()> {
    let one_file = |p: &Option<Option<PathBuf>>| matches!(p, Some(Some(_)));
    if one_file(&args.preview) || one_file(&args.mask) {
        return Err(Usage(format!("{} brackets: --preview and --mask take no file name", sets.len())).into());
    }
    if args.save_response.is_some() {
        return Err(Usage("--save-response needs a single bracket".into()).into());
    }
    let all: Vec<Targets> = sets.iter().map(|set| targets(args, Some(&set.name))).collect();
    check(args, sets, &all, ctx)?;
    std::fs::create_dir_all(&args.output).with_context(|| format!("cannot create {}", args.output.display()))?;
    let (mut merged, mut failed) = (Vec::new(), Vec::new());
    let mut scales = Scales::of_many();
    for (set, targets) in sets.iter().zip(&all) {
        match merge_one(args, params, set, targets, &mut scales, ctx) {
            Ok(summary) => {
                ctx.note(format_args!("{}: {}", targets.picture.display(), describe(&summary)));
                merged.push(summary);
            }
            Err(e) => {
                let message = crate::output::one_line(&e);
                ctx.warn(format!("{}: {message}", set.name));
                failed.push(json!({ "set": set.name, "error": message }));
            }
        }
    }
    if let Some(note) = scales.note(args) {
        ctx.note(note);
    }
    ctx.done(&args.output, format_args!("{} of {} brackets", merged.len(), sets.len()))?;
    let failures = failed.len();
    ctx.emit_json(json!({ "sets": merged, "failed": failed }))?;
    if failures > 0 {
        bail!("{failures} of {} brackets failed", sets.len());
    }
    Ok(())
}

/// Whether a result's name is a folder's: one that is there, or that ends in a slash, or that has no ending.
fn names_folder(output: &Path) -> bool {
    output.is_dir() || !atomic::is_stream(output) && (atomic::ends_as_folder(output) || output.extension().is_none())
}

/// Formats of the result; what has only codes for a display is a preview.
const RESULTS: [Kind; 4] = [Kind::Exr, Kind::Hdr, Kind::Pfm, Kind::Tiff];
const PREVIEWS: [Kind; 3] = [Kind::Png, Kind::Jpeg, Kind::Tiff];

/// Finds out, before the work is done, whether there is a place for the results, and that they replace none of the inputs.
fn check(args: &Args, sets: &[Set], targets: &[Targets], ctx: &Context) -> anyhow::Result<()> {
    let inputs = sets.iter().flat_map(|s| &s.files).chain(&args.list).chain(&args.response);
    let inputs: Vec<&Path> = inputs.map(PathBuf::as_path).collect();
    let mut files: Vec<&Path> = args.save_response.iter().map(PathBuf::as_path).collect();
    for t in targets {
        let kind = Kind::of(&t.picture, &RESULTS, "HDR picture")?;
        if args.output_space != Space::Rec709 && ![Kind::Exr, Kind::Hdr].contains(&kind) {
            return Err(Usage(format!("{}: only .exr and .hdr say their primaries", t.picture.display())).into());
        }
        t.preview.iter().try_for_each(|p| Kind::of(p, &PREVIEWS, "preview").map(drop))?;
        t.mask.iter().try_for_each(|p| Kind::of(p, &[Kind::Png], "mask").map(drop))?;
        files.extend(std::iter::once(&t.picture).chain(&t.preview).chain(&t.mask).map(PathBuf::as_path));
        for folder in [&t.report, &t.fields].into_iter().flatten() {
            // The nearest one that exists must be a folder, the rest can be made.
            if folder.ancestors().find(|p| p.exists()).is_some_and(|p| !p.is_dir()) {
                bail!("cannot create {}: a file is in the way", folder.display());
            }
        }
    }
    // A folder that is not there yet is made; what it would hold endangers nothing.
    files.retain(|f| f.parent().is_none_or(|d| d.as_os_str().is_empty() || d.exists() || !names_folder(&args.output)));
    ctx.claim(&inputs, &files)
}

fn targets(args: &Args, name: Option<&str>) -> Targets {
    let picture = match name {
        None => args.output.clone(),
        Some(n) => args.output.join(format!("{n}.exr")),
    };
    let beside = |p: &Option<Option<PathBuf>>, ending: &str| {
        p.as_ref().map(|given| given.clone().unwrap_or_else(|| picture.with_extension(ending)))
    };
    let folder = |p: &Option<PathBuf>| p.as_ref().map(|d| name.map_or_else(|| d.clone(), |n| d.join(n)));
    Targets {
        preview: beside(&args.preview, "png"),
        mask: beside(&args.mask, "mask.png"),
        report: folder(&args.report),
        fields: folder(&args.fields),
        picture,
    }
}

fn params(args: &Args) -> anyhow::Result<Params> {
    let response = args.response.as_deref().map(load_response).transpose()?;
    if !(args.full_well > 0.0 && args.read_noise >= 0.0) {
        return Err(Usage("--full-well must be positive and --read-noise not negative".into()).into());
    }
    if args.calibrate.is_some_and(|c| !(c.is_finite() && c > 0.0)) {
        return Err(Usage("--calibrate takes a positive luminance in cd/m²".into()).into());
    }
    let ghosts = match args.preset {
        Preset::Tripod => None,
        Preset::Handheld => Some(GhostParams::default()),
        Preset::Moving => Some(GhostParams { correlation: 0.97, gap: (0.008, 0.035) }),
    };
    let alignment = match args.align {
        Some(Align::Off) => Alignment::Off,
        Some(Align::Global) => Alignment::Global,
        Some(Align::Nonlinear) => Alignment::NonLinear,
        None if args.no_align || args.preset == Preset::Tripod => Alignment::Off,
        None => Alignment::NonLinear,
    };
    Ok(Params {
        scale: translume_hdr::Scale::Anchor,
        alignment,
        ghosts: ghosts.filter(|_| !args.no_deghost),
        anchor: args.anchor,
        response,
        linear: args.linear,
        weights: match args.weights {
            WeightKind::Spline => Weights::Spline,
            WeightKind::Variance => Weights::Variance(Noise { full_well: args.full_well, read: args.read_noise }),
        },
    })
}

/// Reads, merges and writes one bracket; returns what `--json` prints.
fn merge_one(
    args: &Args,
    params: &Params,
    set: &Set,
    targets: &Targets,
    scales: &mut Scales,
    ctx: &Context,
) -> anyhow::Result<Value> {
    if let Some(anchor) = args.anchor.filter(|a| *a >= set.files.len()) {
        let n = set.files.len();
        return Err(Usage(format!("--anchor {anchor}: {} has {n} pictures, counted from 0", set.name)).into());
    }
    let bar = ctx.progress(set.files.len() as u64 * 2 + 5, &set.name);
    let start = std::time::Instant::now();
    let (exposures, said) = sets::read(set, args, &|name| {
        bar.set_message(format!("reading {name}"));
        bar.inc(1);
    })?;
    let read_secs = start.elapsed().as_secs_f64();
    let params = Params { scale: scales.of(&exposures, args), ..params.clone() };
    let mut merged = translume_hdr::merge_bracket(&exposures, &params, &|what| {
        bar.set_message(what.to_owned());
        bar.inc(1);
    })
    .map_err(|e| match e {
        // No single picture is to blame: the bracket is.
        translume_hdr::Error::Response(_) => anyhow::Error::new(e).context(set.name.clone()),
        e => e.into(),
    })?;
    merged.warnings.splice(0..0, said);
    for warning in &merged.warnings {
        ctx.warn(warning);
    }
    bar.set_message("writing");
    let start = std::time::Instant::now();
    let picture = picture(&merged, &exposures, args)?;
    write_outputs(args, &exposures, &merged, &picture, targets, ctx)?;
    let mut summary = summary(set, &exposures, &merged, targets);
    let stages = summary["seconds"].as_object_mut().context("no stages")?;
    stages.insert("read".into(), json!(read_secs));
    stages.insert("write".into(), json!(start.elapsed().as_secs_f64()));
    if let Some(dir) = &targets.report {
        report::write(dir, &exposures, &merged, &picture, &summary, ctx)?;
    }
    Ok(summary)
}

/// The radiance with its metadata, in Rec. 709, calibrated if asked for.
fn picture(merged: &Merged, exposures: &[Exposure], args: &Args) -> anyhow::Result<Picture> {
    let anchor = &exposures[merged.anchor];
    let mut pixels = merged.radiance.clone();
    if let Some(matrix) = primaries::to_rec709(&anchor.codes.metadata) {
        transform(&mut pixels, &matrix);
    }
    if let Some(cd_m2) = args.calibrate {
        calibrate(&mut pixels, cd_m2)?;
    }
    let metadata = Metadata { icc: None, chromaticities: None, ..anchor.codes.metadata.clone() };
    Ok(Picture { pixels, alpha: merged.alpha.clone(), metadata })
}

fn transform(pixels: &mut translume_image::Rgb32FImage, m: &colour::Matrix) {
    for p in pixels.pixels_mut() {
        let v = p.0.map(f64::from);
        p.0 = std::array::from_fn(|i| (m[i][0] * v[0] + m[i][1] * v[1] + m[i][2] * v[2]) as f32);
    }
}

/// Scales so that the mean luminance of the central tenth (in both directions) is `cd_m2`.
fn calibrate(pixels: &mut translume_image::Rgb32FImage, cd_m2: f64) -> anyhow::Result<()> {
    let (w, h) = pixels.dimensions();
    let weights = colour::Space::REC709.luminance_weights();
    let (half_w, half_h) = ((w / 20).max(1), (h / 20).max(1));
    let (mut sum, mut n) = (0.0f64, 0.0f64);
    for y in (h / 2).saturating_sub(half_h)..(h / 2 + half_h).min(h) {
        for x in (w / 2).saturating_sub(half_w)..(w / 2 + half_w).min(w) {
            let p = pixels.get_pixel(x, y).0;
            sum += (0..3).map(|c| weights[c] * f64::from(p[c])).sum::<f64>();
            n += 1.0;
        }
    }
    if sum <= 0.0 {
        bail!("--calibrate: the centre of the picture is black");
    }
    let scale = (cd_m2 * n / sum) as f32;
    pixels.iter_mut().for_each(|v| *v *= scale);
    Ok(())
}

/// Whether half floats will not do: asked for, or for values that they cannot hold.
fn wants_floats(picture: &Picture, args: &Args) -> bool {
    let beyond = || picture.pixels.iter().any(|v| v.abs() > 65504.0);
    args.precision.map_or_else(beyond, |p| p == Sample::Float)
}

fn write_outputs(
    args: &Args,
    exposures: &[Exposure],
    merged: &Merged,
    picture: &Picture,
    targets: &Targets,
    ctx: &Context,
) -> anyhow::Result<()> {
    let options = ExrOptions {
        precision: if wants_floats(picture, args) { Precision::Float } else { Precision::Half },
        software: Some(format!("translume {}", env!("CARGO_PKG_VERSION"))),
        command: Some(ctx.command_line.clone()),
        ..ExrOptions::default()
    };
    let space = match args.output_space {
        Space::Rec709 => None,
        Space::Rec2020 => Some(colour::Space::REC2020),
        Space::Acescg => Some(colour::Space::ACESCG),
    };
    let mut converted = None;
    if let Some(space) = space {
        let converted = converted.insert(picture.clone());
        transform(&mut converted.pixels, &colour::Space::REC709.to(&space));
        converted.metadata.chromaticities = Some(space.chromaticities());
    }
    let result = converted.as_ref().unwrap_or(picture);
    match Kind::of(&targets.picture, &RESULTS, "HDR picture")? {
        Kind::Hdr => translume_image::write_hdr(&targets.picture, result)?,
        Kind::Pfm => translume_image::write_pfm(&targets.picture, result)?,
        Kind::Tiff => translume_image::write_tiff_float(&targets.picture, result)?,
        _ => translume_image::write_exr(&targets.picture, result, &options)?,
    }
    let size = (picture.pixels.width() as usize, picture.pixels.height() as usize);
    if let Some(path) = &targets.preview {
        let display = match args.preview_tonemap {
            Tonemap::Reinhard => tonemap::reinhard_global(picture, &tonemap::ReinhardParams::default()),
            Tonemap::Fattal => tonemap::fattal(picture, &tonemap::FattalParams::default()),
        };
        save_display(&display, path, Kind::of(path, &PREVIEWS, "preview")?, 8)?;
    }
    if let Some(path) = &targets.mask {
        translume_image::write_gray_png(path, size, &ghost_mask(merged, size))?;
    }
    if let Some(dir) = &targets.fields {
        write_fields(dir, exposures, merged, size, &options)?;
    }
    if let (Some(path), Some(response)) = (&args.save_response, &merged.response) {
        let text = serde_json::to_string(&json!({ "version": 1, "log_exposure": response.log_exposure }))?;
        translume_image::atomic::write_bytes(path, text.as_bytes())?;
    } else if let Some(path) = &args.save_response {
        bail!("{}: linear sources have no response curve to save", path.display());
    }
    Ok(())
}

/// White where some picture was left out; exactly mid grey where all are clipped, so that the value is a lower bound.
fn ghost_mask(merged: &Merged, size: (usize, usize)) -> Vec<u8> {
    const BOUND: u8 = 128;
    let mut mask = vec![0u8; size.0 * size.1];
    for confidence in merged.confidences.iter().flatten() {
        mask.iter_mut().zip(confidence).for_each(|(m, c)| *m = (*m).max(255 - c));
    }
    for (m, bound) in mask.iter_mut().zip(&merged.bounds) {
        *m = match (*bound, *m) {
            (true, _) => BOUND,
            (false, BOUND) => BOUND + 1,
            (false, ghost) => ghost,
        };
    }
    mask
}

fn write_fields(
    dir: &Path,
    exposures: &[Exposure],
    merged: &Merged,
    (w, h): (usize, usize),
    options: &ExrOptions,
) -> anyhow::Result<()> {
    let options = ExrOptions { precision: Precision::Float, ..options.clone() };
    // Fields of an older, longer bracket would be taken for this one's.
    let is_field = |name: &str| {
        let number = || name.strip_suffix(".exr")?.split_once('-')?.0.parse::<u32>().ok();
        number().is_some()
    };
    if let Some(above) = dir.parent() {
        std::fs::create_dir_all(above).with_context(|| format!("cannot create {}", dir.display()))?;
    }
    let written = atomic::write_folder(dir, is_field, |new| {
        for (i, (e, a)) in exposures.iter().zip(&merged.aligned).enumerate() {
            let (mut dx, mut dy) = (vec![0.0f32; w * h], vec![0.0f32; w * h]);
            for y in 0..h {
                for x in 0..w {
                    [dx[y * w + x], dy[y * w + x]] = a.field.displacement(x as f32, y as f32);
                }
            }
            let path = new.join(format!("{i:02}-{}.exr", sets::stem(&e.name)));
            translume_image::write_exr_channels(&path, (w, h), &[("X", &dx), ("Y", &dy)], &options)?;
        }
        Ok(())
    });
    Ok(written?)
}

fn load_response(path: &Path) -> anyhow::Result<Response> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let value: Value = serde_json::from_str(&text).with_context(|| format!("{}: not JSON", path.display()))?;
    match value["version"].as_u64() {
        Some(1) => {}
        Some(v) => bail!("{}: response format version {v} is not known here", path.display()),
        None => bail!("{}: not a response curve of translume (no version)", path.display()),
    }
    let log_exposure = serde_json::from_value(value["log_exposure"].clone())
        .with_context(|| format!("{}: log_exposure must be three lists of 256 numbers", path.display()))?;
    let response = Response { log_exposure };
    response.validate().with_context(|| path.display().to_string())?;
    Ok(response)
}

/// What `--json` prints of one bracket.
fn summary(set: &Set, exposures: &[Exposure], merged: &Merged, targets: &Targets) -> Value {
    let (w, h) = (merged.radiance.width() as usize, merged.radiance.height() as usize);
    let images: Vec<Value> = exposures
        .iter()
        .enumerate()
        .map(|(i, e)| {
            let motion = merged.aligned[i].motion;
            json!({
                "file": e.name,
                "exposure": e.secs,
                "displacement_mean_px": motion.mean_px,
                "displacement_p95_px": motion.p95_px,
                "affine": merged.aligned[i].field.affine,
                "non_linear": merged.aligned[i].field.grid.is_some(),
                "ghost_share": merged.confidences[i].as_deref().map_or(0.0, ghost_share),
            })
        })
        .collect();
    let seconds: serde_json::Map<String, Value> =
        merged.seconds.iter().map(|(name, s)| ((*name).to_owned(), json!(s))).collect();
    json!({
        "set": set.name,
        "output": targets.picture,
        "width": w,
        "height": h,
        "anchor": merged.anchor,
        "exposures": exposures.iter().map(|e| e.secs).collect::<Vec<_>>(),
        "images": images,
        "radiance_of_one": merged.unit,
        "bound_share": merged.bounds.iter().filter(|b| **b).count() as f64 / merged.bounds.len().max(1) as f64,
        "seconds": seconds,
        "warnings": merged.warnings,
    })
}

/// The same in words for people.
fn describe(summary: &Value) -> String {
    let images = summary["images"].as_array().map_or(&[][..], Vec::as_slice);
    let moved: Vec<f64> = images.iter().filter_map(|i| i["displacement_p95_px"].as_f64()).collect();
    let moved = match moved.len() {
        n @ 0..10 if n > 0 => moved.iter().map(|px| format!("{px:.1}")).collect::<Vec<_>>().join(" / "),
        _ => format!("up to {:.1}", moved.iter().copied().fold(0.0, f64::max)),
    };
    let ghosts = images.iter().filter_map(|i| i["ghost_share"].as_f64()).fold(0.0, f64::max);
    let total: f64 = summary["seconds"].as_object().map_or(0.0, |s| s.values().filter_map(Value::as_f64).sum());
    format!(
        "{} pictures, anchor {}, moved by {moved} px, ghosts on up to {:.1} %, clipped in all on {:.1} %, {total:.2} s",
        images.len(),
        summary["anchor"],
        100.0 * ghosts,
        100.0 * summary["bound_share"].as_f64().unwrap_or(0.0)
    )
}
