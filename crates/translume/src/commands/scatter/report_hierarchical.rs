//! The report about a hierarchical model.

use super::report::{Args, Row, Told, figure, frame_pictures};
use crate::commands::page::Figure;
use anyhow::anyhow;
use std::path::Path;
use translume_scatter::capture::Capture;
use translume_scatter::hierarchical::{
    AtlasParams, Hierarchical, HierarchicalParams, Stage, fit_hierarchical, load_hierarchical,
};
use translume_scatter::planar::ErrorMap;
use translume_scatter::relight::{Part, Predictor};

pub(super) fn tell(args: &Args, capture: &Capture, threshold: f64) -> anyhow::Result<Told> {
    let (_, model) = load_hierarchical(&args.model)?;
    let mut rows = Vec::new();
    for (name, model) in [
        ("this model", &model),
        ("no modulation", &without_detail(&model)),
        ("F and T alone", &without_kernels(&model)),
    ] {
        rows.push(Row { name: name.into(), errors: predictor(model, capture)?.errors(threshold)? });
    }
    rows.extend(held_out(args, capture, threshold)?);
    std::fs::create_dir_all(&args.output)?;
    let pictures = pictures(&args.output, capture, &predictor(&model, capture)?, &rows[0].errors)?;
    Ok(Told {
        title: "A hierarchical model of an object",
        on: "all pixels above the noise; held out is every fifth position, predicted by a model of the others",
        channels: capture.rig.channels.iter().map(|c| c.name.clone()).collect(),
        points: capture.rig.laser.hits_mm.len(),
        rows,
        pictures,
    })
}

/// A model of four fifths of the laser positions, held against the others.
fn held_out(args: &Args, capture: &Capture, threshold: f64) -> anyhow::Result<Vec<Row>> {
    let held = |position: usize| position % 5 == 4;
    let mut stage = Stage::new(Capture::open(&args.capture)?, threshold, &AtlasParams::default())?;
    stage.hold_out(held);
    if stage.positions() == 0 {
        return Ok(Vec::new());
    }
    let (model, _) = fit_hierarchical(stage, &HierarchicalParams::default(), |_| ())?;
    let row = |name: &str, model: &Hierarchical| -> anyhow::Result<Row> {
        let mut errors = predictor(model, capture)?.errors(threshold)?;
        for (_, ln) in errors.ln.iter_mut().enumerate().filter(|e| !held(e.0)) {
            ln.fill(f64::NAN);
        }
        Ok(Row { name: name.into(), errors })
    };
    Ok(vec![row("held out", &model)?, row("held out, F and T", &without_kernels(&model))?])
}

fn predictor<'a>(model: &'a Hierarchical, capture: &'a Capture) -> anyhow::Result<Predictor<'a>> {
    Predictor::new(model, capture).ok_or_else(|| anyhow!("the model's mesh has too many triangles"))
}

fn without_detail(model: &Hierarchical) -> Hierarchical {
    let mut plain = model.clone();
    plain.detail.fill([1.0; 3]);
    plain
}

fn without_kernels(model: &Hierarchical) -> Hierarchical {
    let mut plain = model.clone();
    plain.kernels.iter_mut().for_each(|k| *k = Default::default());
    plain
}

/// The frame of a laser position of median error: measured, modelled, what is between, and the parts of the model.
fn pictures(
    folder: &Path,
    capture: &Capture,
    predictor: &Predictor<'_>,
    errors: &ErrorMap,
) -> anyhow::Result<Vec<Vec<Figure>>> {
    let channel = 1.min(capture.rig.channels.len() - 1);
    let mut order: Vec<usize> = (0..errors.ln.len()).filter(|&p| errors.ln[p][channel].is_finite()).collect();
    order.sort_by(|&a, &b| errors.ln[a][channel].total_cmp(&errors.ln[b][channel]));
    let Some(&position) = order.get(order.len() / 2) else { return Ok(Vec::new()) };
    let [views, .., height, width] = capture.frames.shape;
    let Some(view) = (0..views).find(|&v| capture.frames.exists(v, position, channel)) else { return Ok(Vec::new()) };
    let floor = capture.rig.channels[channel].noise_floor as f32;
    let mut measured = capture.frames.read(view, position, channel)?.unwrap_or_default();
    measured.iter_mut().filter(|v| **v <= floor).for_each(|v| *v = 0.0);
    let part = |part: Part| -> Vec<f32> {
        predictor.frame(position, view, part).unwrap_or_default().iter().map(|p| p[channel]).collect()
    };
    let [whole, local, global] = [Part::Whole, Part::Local, Part::Global].map(part);
    let size = (width, height);
    let predicted: Vec<f64> = whole.iter().map(|v| f64::from(*v)).collect();
    let first = frame_pictures(folder, size, &measured, &predicted)?;
    let peak = whole.iter().copied().fold(1e-30, f32::max);
    // The fourth root shows the far field beside the spot.
    let shown = |values: Vec<f32>| values.into_iter().map(move |v| (v / peak).max(0.0).sqrt().sqrt());
    let second = vec![
        figure(folder, "local.png", "local light, K; fourth root", size, shown(local))?,
        figure(folder, "global.png", "global light, T · F", size, shown(global))?,
        figure(folder, "combined.png", "both", size, shown(whole))?,
    ];
    Ok(vec![first, second])
}
