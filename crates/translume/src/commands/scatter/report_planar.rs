//! The report about a flat sample.

use super::report::{Args, Row, Told, figure, frame_pictures};
use super::samples_plot::{self, Line};
use crate::commands::page::Figure;
use crate::output::Context;
use std::path::Path;
use translume_scatter::capture::Capture;
use translume_scatter::planar::{
    ModelHead, PlanarCapture, PlanarModel, PlanarParams, error_map, fit_planar, load_model,
};
use translume_scatter::{Model, Params};

/// Name, fall-off, directions, shared.
const RIVALS: [(&str, Model, usize, bool); 8] = [
    ("dipole", Model::Dipole, 1, false),
    ("dipole, 8 directions", Model::Dipole, 8, false),
    ("isotropic", Model::Exponential, 1, false),
    ("4 directions", Model::Exponential, 4, false),
    ("8 directions", Model::Exponential, 8, false),
    ("isotropic, shared", Model::Exponential, 1, true),
    ("4 directions, shared", Model::Exponential, 4, true),
    ("8 directions, shared", Model::Exponential, 8, true),
];

pub(super) fn tell(args: &Args, opened: Capture, threshold: f64, ctx: &Context) -> anyhow::Result<Told> {
    let mut capture = PlanarCapture::new(opened, threshold)?;
    let (head, model) = load_model(&args.model, &capture)?;
    capture.gains.clone_from(&head.gains);
    let bar = ctx.progress(RIVALS.len() as u64, "fitting");
    let mut rows = vec![Row { name: "this model".into(), errors: error_map(&capture, &model)? }];
    let mut rivals = Vec::new();
    for (name, kind, segments, shared) in RIVALS {
        let fit = Params {
            model: kind,
            segments,
            terms: head.terms,
            eta: capture.capture.rig.eta,
            free_scale: kind == Model::Dipole,
            most: Some(1.0),
        };
        let rival = fit_planar(&capture, &PlanarParams { fit, shared, ..PlanarParams::default() }, || ())?;
        rows.push(Row { name: name.into(), errors: error_map(&capture, &rival)? });
        rivals.push(rival);
        bar.inc(1);
    }
    std::fs::create_dir_all(&args.output)?;
    let mut pictures = pictures(&args.output, &capture, &head, &model, &rows)?;
    pictures.push(vec![against(&args.output, &capture, &model, &rivals)?]);
    Ok(Told {
        title: "A planar model of subsurface scattering",
        on: "pixels kept from all fits",
        channels: head.channels,
        points: capture.spots.len(),
        rows,
        pictures,
    })
}

/// The channel that pictures show: green.
fn shown(channels: usize) -> usize {
    1.min(channels - 1)
}

/// A lit point in the middle of the grid.
fn middle(capture: &PlanarCapture) -> usize {
    let middle = capture.spots.len() / 2 + capture.capture.rig.laser.grid[0] / 2;
    middle.min(capture.spots.len() - 1)
}

/// The samples of one frame against their fits [Fuchs 2005, Fig. 3].
fn against(
    folder: &Path,
    capture: &PlanarCapture,
    model: &PlanarModel,
    rivals: &[PlanarModel],
) -> anyhow::Result<Figure> {
    let channel = shown(capture.capture.rig.channels.len());
    let index = middle(capture);
    let spot = capture.spots[index];
    let values = capture.reflectance(&spot, channel)?;
    let samples: Vec<[f64; 2]> = values
        .iter()
        .zip(capture.places(spot.frame[0]))
        .map(|(v, p)| [(p[0] - spot.at[0]).hypot(p[1] - spot.at[1]), f64::from(*v)])
        .collect();
    let mut lines = Vec::new();
    // All directions of the model, then what is the same in all.
    let directions = model.points[index].fall_off.iter().map(|f| f.segments.len()).max().unwrap_or(0);
    for l in (0..directions).filter(|_| directions > 1) {
        let (sin, cos) = (std::f64::consts::TAU * l as f64 / directions as f64).sin_cos();
        let name = if l == 0 { "this model, each direction" } else { "" };
        let value = Box::new(move |r: f64| model.points[index].value([r * cos, r * sin], channel));
        lines.push(Line { name, color: "#9ab8e6", value });
    }
    for (name, color, wanted) in [("isotropic", "#14479e", 2), ("dipole", "#c0392b", 0)] {
        let point = &rivals[wanted].points[index];
        lines.push(Line { name, color, value: Box::new(move |r| point.value([r, 0.0], channel)) });
    }
    // Names are listed from the top: those without come last.
    lines.sort_by_key(|l| l.name.is_empty());
    samples_plot::write(&folder.join("samples.svg"), &samples, &lines)?;
    let caption = "the samples of this frame against their fits, without modulation".to_owned();
    Ok(Figure { file: "samples.svg".into(), caption })
}

/// A frame, its reconstruction and the error of the middle lit point; maps of E(x_i) over the laser grid; the texture.
fn pictures(
    folder: &Path,
    capture: &PlanarCapture,
    head: &ModelHead,
    model: &PlanarModel,
    rows: &[Row],
) -> anyhow::Result<Vec<Vec<Figure>>> {
    let [.., height, width] = capture.capture.frames.shape;
    let channel = shown(head.channels.len());
    let middle = middle(capture);
    let spot = capture.spots[middle];
    let measured = capture.reflectance(&spot, channel)?;
    let predicted = model.predict(capture, middle, channel);
    let mut first = frame_pictures(folder, (width, height), &measured, &predicted)?;
    let texture = model.texture[spot.frame[0]][channel].iter().map(|a| a / 2.0);
    first.push(figure(folder, "texture.png", "modulation, white is 2", (width, height), texture)?);
    let [columns, lines] = capture.capture.rig.laser.grid;
    let mut second = Vec::new();
    // One scale for all maps, on which the worst point of the first is not white yet.
    let worst = rows
        .iter()
        .find(|r| r.name == "dipole")
        .map_or(0.0, |r| r.errors.ln.iter().map(|l| l[channel]).fold(0.0, f64::max));
    let white = ((10.0 * worst).ceil() / 10.0).max(0.2);
    for name in ["dipole", "isotropic", "4 directions", "8 directions"] {
        let Some(row) = rows.iter().find(|r| r.name == name) else { continue };
        let mut map = vec![0.0; columns * lines];
        for (spot, ln) in capture.spots.iter().zip(&row.errors.ln) {
            if let Some(cell) = map.get_mut(spot.frame[1]) {
                *cell = (ln[channel] / white) as f32;
            }
        }
        let file = format!("errors-{}.png", name.replace(' ', "-"));
        let caption = format!("{name}: ln E of each lit point, white is {white:.1}");
        second.push(figure(folder, &file, &caption, (columns, lines), map.into_iter())?);
    }
    Ok(vec![first, second])
}
