//! Which pictures form a bracket, and at what exposure.

use super::Args;
use crate::cli::Usage;
use anyhow::Context as _;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use translume_hdr::{Exposure, Grouping, group, parse_list, parse_seconds};
use translume_image::{Codes, Metadata, read_codes};

/// The files of one bracket, in order.
#[derive(Debug)]
pub(super) struct Set {
    pub(super) name: String,
    pub(super) files: Vec<PathBuf>,
}

/// File endings of pictures, for folders.
const ENDINGS: &[&str] =
    &["jpg", "jpeg", "png", "tif", "tiff", "exr", "hdr", "pfm", "dng", "cr2", "cr3", "nef", "arw", "orf", "rw2", "raf"];

/// A file's name without folder and ending.
pub(super) fn stem(name: &str) -> String {
    Path::new(name).file_stem().map_or_else(|| name.to_owned(), |s| s.to_string_lossy().into_owned())
}

/// The brackets that the inputs name: all files together one (unless `--group` cuts them), each folder one or more.
pub(super) fn collect(args: &Args) -> anyhow::Result<Vec<Set>> {
    let (folders, files): (Vec<&PathBuf>, Vec<&PathBuf>) = args.inputs.iter().partition(|p| p.is_dir());
    let mut sets = Vec::new();
    if !files.is_empty() {
        let files: Vec<PathBuf> = files.into_iter().cloned().collect();
        sets.extend(match args.group {
            Some(n) => split(&stem(&files[0].to_string_lossy()), files, Grouping::Count(n), args)?,
            None => vec![Set { name: stem(&files[0].to_string_lossy()), files }],
        });
    }
    for folder in folders {
        let files = pictures_in(folder)?;
        if files.is_empty() {
            anyhow::bail!("{}: no pictures in this folder ({})", folder.display(), ENDINGS.join(", "));
        }
        let how = args.group.map_or(Grouping::Pattern, Grouping::Count);
        let name = folder.file_name().map_or_else(|| "set".to_owned(), |n| n.to_string_lossy().into_owned());
        sets.extend(split(&name, files, how, args)?);
    }
    if sets.len() > 1 && !(args.exposures.is_empty() && args.ev.is_empty()) {
        let n = args.exposures.len().max(args.ev.len());
        if let Some(set) = sets.iter().find(|s| s.files.len() != n) {
            return Err(Usage(format!("{n} exposures given, but {} has {} pictures", set.name, set.files.len())).into());
        }
    }
    Ok(sets)
}

/// The picture files of a folder by name; of a published set, only the files that `--list` names.
fn pictures_in(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let mut files = Vec::new();
    for entry in entries {
        let path = entry.with_context(|| format!("cannot read {}", folder.display()))?.path();
        let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        if path.is_file() && ENDINGS.contains(&ending.as_str()) {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

/// Cuts files into brackets.
fn split(name: &str, files: Vec<PathBuf>, how: Grouping, args: &Args) -> anyhow::Result<Vec<Set>> {
    let listed = list(args)?;
    let files: Vec<PathBuf> = match &listed {
        Some(list) => files.into_iter().filter(|f| lookup(list, f).is_some()).collect(),
        None => files,
    };
    if files.is_empty() {
        anyhow::bail!("{name}: none of its pictures is in the list");
    }
    let lengths = match how {
        Grouping::Count(_) => group(&vec![1.0; files.len()], &vec![(0, 0); files.len()], how)?,
        // Given by hand, exposures say how many pictures a bracket has.
        Grouping::Pattern if !args.exposures.is_empty() || !args.ev.is_empty() => {
            let n = args.exposures.len().max(args.ev.len());
            group(&vec![1.0; files.len()], &vec![(0, 0); files.len()], Grouping::Count(n))?
        }
        Grouping::Pattern => {
            let facts: Vec<(f64, (usize, usize))> = files
                .par_iter()
                .map(|f| {
                    let codes = read_codes(f)?;
                    let own = codes.metadata.relative_exposure();
                    let secs = listed.as_ref().and_then(|l| lookup(l, f)).or(own).unwrap_or(1.0);
                    Ok((secs, (codes.width, codes.height)))
                })
                .collect::<anyhow::Result<_>>()?;
            let (exposures, sizes): (Vec<f64>, Vec<(usize, usize)>) = facts.into_iter().unzip();
            group(&exposures, &sizes, how)?
        }
    };
    let mut rest = files.into_iter();
    let many = lengths.len() > 1;
    Ok(lengths
        .iter()
        .enumerate()
        .map(|(k, n)| Set {
            name: if many { format!("{name}-{:03}", k + 1) } else { name.to_owned() },
            files: rest.by_ref().take(*n).collect(),
        })
        .collect())
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

/// Reads the pictures of a bracket and finds their exposures.
pub(super) fn read(set: &Set, args: &Args, progress: &(dyn Fn(&str) + Sync)) -> anyhow::Result<Vec<Exposure>> {
    let files = &set.files;
    let pictures: Vec<Codes> = files
        .par_iter()
        .map(|f| {
            progress(&f.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default());
            Ok(read_codes(f)?)
        })
        .collect::<anyhow::Result<_>>()?;
    let seconds = exposures(files, &pictures, args)?;
    let named = files.iter().zip(pictures).zip(seconds);
    Ok(named.map(|((f, codes), secs)| Exposure { name: f.display().to_string(), codes, secs }).collect())
}

fn exposures(files: &[PathBuf], pictures: &[Codes], args: &Args) -> anyhow::Result<Vec<f64>> {
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
    let all = |has: &dyn Fn(&Metadata) -> bool| pictures.iter().all(|p| has(&p.metadata));
    let (with_iso, with_f) = (all(&|m| m.iso.is_some()), all(&|m| m.f_number.is_some()));
    files
        .iter()
        .zip(pictures)
        .map(|(f, p)| {
            let m = Metadata {
                iso: p.metadata.iso.filter(|_| with_iso),
                f_number: p.metadata.f_number.filter(|_| with_f),
                ..p.metadata.clone()
            };
            m.relative_exposure().with_context(|| {
                format!("{}: no exposure time in the file; give --exposures, --ev or --list", f.display())
            })
        })
        .collect()
}
