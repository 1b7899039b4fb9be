//! Which pictures form a bracket, and at what exposure.

use super::Args;
use crate::cli::Usage;
use crate::output::Context;
use anyhow::Context as _;
use rayon::prelude::*;
use std::collections::HashMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use translume_hdr::{Error, Exposure, Fact, Look, group, group_by_count, one_orientation, parse_list, parse_seconds};
use translume_image::{Codes, Metadata, natural_key, read_codes, read_codes_alpha};

/// The files of one bracket, in order.
#[derive(Debug)]
pub(super) struct Set {
    pub(super) name: String,
    pub(super) files: Vec<PathBuf>,
}

/// File endings of pictures, for folders. Of several files of one stem the first kind is taken: what was developed goes
/// before the camera's own raw file, which not every build can read.
const ENDINGS: &[&str] =
    &["exr", "tif", "tiff", "png", "jpg", "jpeg", "hdr", "pfm", "dng", "cr2", "cr3", "nef", "arw", "orf", "rw2", "raf"];

/// A file's name without folder and ending.
pub(super) fn stem(name: &str) -> String {
    Path::new(name).file_stem().map_or_else(|| name.to_owned(), |s| s.to_string_lossy().into_owned())
}

/// The brackets that the inputs name: all files together one (unless `--group` cuts them), each folder one or more.
pub(super) fn collect(args: &Args, ctx: &Context) -> anyhow::Result<Vec<Set>> {
    let (folders, files): (Vec<&PathBuf>, Vec<&PathBuf>) = args.inputs.iter().partition(|p| p.is_dir());
    let mut sets = Vec::new();
    if !files.is_empty() {
        let files: Vec<PathBuf> = files.into_iter().cloned().collect();
        let name = stem(&files[0].to_string_lossy());
        sets.extend(match args.group {
            Some(_) => split(&name, files, args, ctx)?,
            None => vec![Set { name, files }],
        });
    }
    for folder in folders {
        let files = pictures_in(folder, ctx)?;
        if files.is_empty() {
            anyhow::bail!("{}: no pictures in this folder ({})", folder.display(), ENDINGS.join(", "));
        }
        let name = folder.file_name().map_or_else(|| "set".to_owned(), |n| n.to_string_lossy().into_owned());
        sets.extend(split(&name, files, args, ctx)?);
    }
    if sets.len() > 1 && !(args.exposures.is_empty() && args.ev.is_empty()) {
        let n = args.exposures.len().max(args.ev.len());
        if let Some(set) = sets.iter().find(|s| s.files.len() != n) {
            return Err(Usage(format!("{n} exposures given, but {} has {} pictures", set.name, set.files.len())).into());
        }
    }
    Ok(sets)
}

/// The picture files of a folder, numbers in their names counting as numbers. Hidden files are none: macOS leaves
/// `._IMG_1.JPG` beside `IMG_1.JPG` on memory cards.
fn pictures_in(folder: &Path, ctx: &Context) -> anyhow::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let mut files = Vec::new();
    for entry in entries {
        let path = entry.with_context(|| format!("cannot read {}", folder.display()))?.path();
        let hidden = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
        if !hidden && path.is_file() && kind(&path).is_some() {
            files.push(path);
        }
    }
    files.sort_by_cached_key(|p| (natural_key(&p.to_string_lossy()), p.clone()));
    Ok(one_of_each_stem(files, ctx))
}

/// Place of a file's ending among [`ENDINGS`].
fn kind(path: &Path) -> Option<usize> {
    let ending = path.extension()?.to_string_lossy().to_lowercase();
    ENDINGS.iter().position(|e| *e == ending)
}

/// Cameras write a raw file and a JPEG of each shot, and developers add a TIFF: one of them is the picture.
fn one_of_each_stem(files: Vec<PathBuf>, ctx: &Context) -> Vec<PathBuf> {
    let mut best: HashMap<PathBuf, usize> = HashMap::new();
    for file in &files {
        let kind = kind(file).unwrap_or(usize::MAX);
        best.entry(file.with_extension("")).and_modify(|k| *k = kind.min(*k)).or_insert(kind);
    }
    let (taken, left): (Vec<_>, Vec<_>) =
        files.into_iter().partition(|f| best.get(&f.with_extension("")) == kind(f).as_ref());
    if let Some(first) = left.first() {
        let instead = taken.iter().find(|f| f.with_extension("") == first.with_extension(""));
        let name = |f: &Path| f.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let instead = instead.map(|f| name(f)).unwrap_or_default();
        let others = if left.len() > 1 { format!(", and {} more likewise", left.len() - 1) } else { String::new() };
        ctx.note(format!("{} passed over: {instead} is the same shot{others}", first.display()));
    }
    taken
}

/// Cuts files into brackets.
fn split(name: &str, files: Vec<PathBuf>, args: &Args, ctx: &Context) -> anyhow::Result<Vec<Set>> {
    let listed = list(args)?;
    let files: Vec<PathBuf> = match &listed {
        Some(list) => files.into_iter().filter(|f| lookup(list, f).is_some()).collect(),
        None => files,
    };
    if files.is_empty() {
        anyhow::bail!("{name}: none of its pictures is in the list");
    }
    // Given by hand, exposures say how many pictures a bracket has.
    let given = args.exposures.len().max(args.ev.len());
    let runs = match args.group.or((given > 0).then_some(given)) {
        Some(n) => group_by_count(files.len(), n)?,
        None => grouped(&files, listed.as_deref(), ctx)?,
    };
    let many = runs.len() > 1;
    let named = |(k, run): (usize, Range<usize>)| Set {
        name: if many { format!("{name}-{:03}", k + 1) } else { name.to_owned() },
        files: files[run].to_vec(),
    };
    Ok(runs.into_iter().enumerate().map(named).collect())
}

/// Brackets by what the files say and show.
fn grouped(files: &[PathBuf], listed: Option<&[(String, f64)]>, ctx: &Context) -> anyhow::Result<Vec<Range<usize>>> {
    let fact = |f: &PathBuf| {
        let codes = read_codes(f)?;
        let facts = &codes.metadata;
        let stored =
            if facts.orientation.swaps_axes() { (codes.height, codes.width) } else { (codes.width, codes.height) };
        Ok(Fact {
            name: f.display().to_string(),
            exposure: listed.and_then(|l| lookup(l, f)).or(facts.relative_exposure()),
            exposure_secs: facts.exposure_secs,
            size: stored,
            captured_secs: facts.captured_secs,
            auto_bracket: facts.auto_bracket,
            look: Some(Look::new(&codes)),
        })
    };
    let facts: Vec<Fact> = files.par_iter().map(fact).collect::<anyhow::Result<_>>()?;
    let found = group(&facts).map_err(|e| match e {
        Error::Doubt(_) => {
            anyhow::anyhow!("{e}; give --group with the pictures per bracket, or one bracket's files by name")
        }
        e => e.into(),
    })?;
    if found.sets.is_empty() {
        // One picture is no bracket: the merge says so.
        return Ok(std::iter::once(0..files.len()).collect());
    }
    for alone in &found.alone {
        ctx.warn(format!("{}: belongs to no bracket; left out", files[*alone].display()));
    }
    Ok(found.sets)
}

fn list(args: &Args) -> anyhow::Result<Option<Vec<(String, f64)>>> {
    let Some(path) = &args.list else { return Ok(None) };
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    let list = parse_list(&translume_image::text::decode(&bytes)).with_context(|| path.display().to_string())?;
    Ok(Some(list))
}

/// Seconds of a file in a list, by name without folder.
fn lookup(list: &[(String, f64)], file: &Path) -> Option<f64> {
    let name = file.file_name()?.to_string_lossy();
    list.iter().find(|(n, _)| Path::new(n).file_name().is_some_and(|n| n.to_string_lossy() == name)).map(|l| l.1)
}

/// Reads the pictures of a bracket and finds their exposures; what had to be set right is told in words.
pub(super) fn read(
    set: &Set,
    args: &Args,
    progress: &(dyn Fn(&str) + Sync),
) -> anyhow::Result<(Vec<Exposure>, Vec<String>)> {
    let files = &set.files;
    let pictures: Vec<(Codes, Option<Vec<f32>>)> = files
        .par_iter()
        .map(|f| {
            progress(&f.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default());
            Ok(read_codes_alpha(f)?)
        })
        .collect::<anyhow::Result<_>>()?;
    let seconds = exposures(files, pictures.iter().map(|p| &p.0.metadata), args)?;
    let named = files.iter().zip(pictures).zip(seconds);
    let mut exposures: Vec<Exposure> = named
        .map(|((f, (codes, alpha)), secs)| Exposure { name: f.display().to_string(), codes, alpha, secs })
        .collect();
    let said = one_orientation(&mut exposures);
    Ok((exposures, said))
}

fn exposures<'a>(
    files: &[PathBuf],
    facts: impl Iterator<Item = &'a Metadata> + Clone,
    args: &Args,
) -> anyhow::Result<Vec<f64>> {
    let counted = |n: usize, option: &str| match n == files.len() {
        true => Ok(()),
        false => Err(Usage(format!("{option} gives {n} exposures for {} pictures", files.len()))),
    };
    if !args.exposures.is_empty() {
        counted(args.exposures.len(), "--exposures")?;
        return args.exposures.iter().map(|t| parse_seconds(t).map_err(|e| Usage(e.to_string()).into())).collect();
    }
    if !args.ev.is_empty() {
        counted(args.ev.len(), "--ev")?;
        if let Some(ev) = args.ev.iter().find(|ev| !(-64.0..=64.0).contains(*ev)) {
            return Err(Usage(format!("--ev {ev}: give stops between -64 and 64, like -2,0,2")).into());
        }
        return Ok(args.ev.iter().map(|ev| ev.exp2()).collect());
    }
    if let Some(list) = list(args)? {
        return files
            .iter()
            .map(|f| lookup(&list, f).with_context(|| format!("{}: not in the list of exposures", f.display())))
            .collect();
    }
    // What only some files tell would distort the ratios: it counts for all or for none.
    let all = |has: fn(&Metadata) -> bool| facts.clone().all(has);
    let (with_iso, with_f) = (all(|m| m.iso.is_some()), all(|m| m.f_number.is_some()));
    files
        .iter()
        .zip(facts)
        .map(|(f, own)| {
            let m = Metadata {
                iso: own.iso.filter(|_| with_iso),
                f_number: own.f_number.filter(|_| with_f),
                exposure_secs: own.exposure_secs,
                ..Metadata::default()
            };
            m.relative_exposure().with_context(|| {
                format!("{}: no exposure time in the file; give --exposures, --ev or --list", f.display())
            })
        })
        .collect()
}
