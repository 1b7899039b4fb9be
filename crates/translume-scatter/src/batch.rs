//! Many points from a sample list to a file of fits, a block at a time, on all threads.

use crate::fit::{Fitter, Model, Params, PointFit};
use crate::npy::SampleFile;
use rayon::prelude::*;
use serde::Serialize;
use std::io::Write;
use std::path::Path;
use translume_image::{Error, Result};

/// Version of the file of fits; a reader refuses another major one.
pub const FIT_VERSION: &str = "1.0";

/// Samples of a block: some 50 MB with its buffers. While one is fitted the next is read.
const BLOCK_SAMPLES: usize = 1 << 21;

/// What a run found, over all points.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Points in the list.
    pub points: usize,
    /// Points with a fit.
    pub fitted: usize,
    /// Samples above the noise floor.
    pub samples: usize,
    /// Samples left out because they are not finite.
    pub not_finite: usize,
    /// Segments for which fewer terms than asked for were enough.
    pub fewer_terms: usize,
    /// Segments that had too few samples of their own.
    pub borrowed: usize,
    /// Mean over the points of the root mean square of ln(model/sample).
    pub mean_rms: f64,
    /// The worst of them.
    pub worst_rms: f64,
}

impl Summary {
    fn add(&mut self, point: &PointFit, params: &Params) {
        self.points += 1;
        self.samples += point.samples;
        self.not_finite += point.not_finite;
        self.borrowed += point.segments.iter().filter(|s| s.borrowed).count();
        if params.model == Model::Exponential {
            let fewer =
                |s: &&crate::Segment| matches!(&s.curve, crate::Curve::Exponential(e) if e.c.len() < params.terms);
            self.fewer_terms += point.segments.iter().filter(fewer).count();
        }
        if let Some(rms) = point.rms {
            self.fitted += 1;
            self.mean_rms += (rms - self.mean_rms) / self.fitted as f64;
            self.worst_rms = self.worst_rms.max(rms);
        }
    }
}

/// Where results go and who made them.
pub struct Sink<'a, W> {
    /// The file.
    pub out: &'a mut W,
    /// Its name, for errors.
    pub path: &'a Path,
    /// The command line, kept in the file.
    pub command: &'a str,
}

/// Fits all points of `input` and writes them to `sink` in their order; `progress` is told how many are done.
///
/// # Errors
/// Those of reading and writing.
pub fn fit_file<W: Write>(
    mut input: SampleFile,
    params: &Params,
    sink: Sink<'_, W>,
    progress: impl Fn(usize),
) -> Result<Summary> {
    let io = |e| Error::io(sink.path, e);
    let out = sink.out;
    write_head(out, params, sink.command).map_err(io)?;
    let most = (BLOCK_SAMPLES / input.samples).max(1);
    let samples = input.samples;
    let (mut block, mut next) = (Vec::new(), Vec::new());
    let mut count = input.read_points(most, &mut block)?;
    let mut summary = Summary::default();
    while count > 0 {
        let (fits, read) = rayon::join(|| fit_block(&block, samples, params), || input.read_points(most, &mut next));
        for (fit, text) in fits {
            let comma = if summary.points == 0 { "" } else { "," };
            write!(out, "{comma}\n{text}").map_err(io)?;
            summary.add(&fit, params);
        }
        progress(summary.points);
        count = read?;
        std::mem::swap(&mut block, &mut next);
    }
    write!(out, "\n]}}\n").map_err(io)?;
    Ok(summary)
}

/// Fits and their text; both in parallel, because writing the digits takes its share.
fn fit_block(block: &[[f32; 3]], samples: usize, params: &Params) -> Vec<(PointFit, String)> {
    let make = || Fitter::new(params);
    let one = |fitter: &mut Fitter, point: &[[f32; 3]]| {
        let fit = fitter.fit(point);
        let text = serde_json::to_string(&fit).expect("plain numbers");
        (fit, text)
    };
    block.par_chunks(samples).map_init(make, one).collect()
}

fn write_head(out: &mut impl Write, params: &Params, command: &str) -> std::io::Result<()> {
    let mut head = serde_json::json!({
        "format": "translume scatter fit",
        "version": FIT_VERSION,
        "generator": format!("translume {}", env!("CARGO_PKG_VERSION")),
        "command": command,
        "model": params.model,
        "segments": params.segments,
    });
    match params.model {
        Model::Exponential => head["terms"] = params.terms.into(),
        Model::Dipole | Model::BetterDipole => head["eta"] = params.eta.into(),
        Model::Normalized => {}
    }
    let head = head.to_string();
    write!(out, "{},\"points\":[", head.trim_end_matches('}'))
}
