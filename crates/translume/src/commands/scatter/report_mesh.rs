//! The report about an object.

use super::report::{Args, Row, Told, figure, frame_pictures};
use super::samples_plot::{self, Line};
use crate::commands::page::Figure;
use crate::output::Context;
use std::path::Path;
use translume_scatter::capture::Capture;
use translume_scatter::planar::ErrorMap;
use translume_scatter::vertex::{
    FrameGain, MeshCapture, VertexHead, VertexModel, VertexParams, error_map, fit_vertices, load_vertex_model,
};
use translume_scatter::{Model, Params};

/// Name, fall-off, terms.
const RIVALS: [(&str, Model, usize); 2] =
    [("dipole for each vertex", Model::Dipole, 1), ("one exponential", Model::Exponential, 1)];

pub(super) fn tell(args: &Args, opened: Capture, threshold: f64, ctx: &Context) -> anyhow::Result<Told> {
    let mut mesh = MeshCapture::new(opened, threshold)?;
    let (head, model) = load_vertex_model(&args.model, &mesh)?;
    FrameGain::restore(&head.gains, &mut mesh);
    let bar = ctx.progress(RIVALS.len() as u64, "fitting");
    let mut rows = vec![Row { name: "this model".into(), errors: error_map(&mesh, &model)? }];
    let mut rivals = Vec::new();
    for (name, kind, terms) in RIVALS {
        let eta = mesh.capture.rig.eta;
        let fit = Params { model: kind, segments: 1, terms, eta, free_scale: kind == Model::Dipole, most: None };
        let rival = fit_vertices(&mesh, &VertexParams { fit, ..VertexParams::default() }, || ())?;
        rows.push(Row { name: name.into(), errors: error_map(&mesh, &rival)? });
        rivals.push(rival);
        bar.inc(1);
    }
    let mut plain = model.clone();
    plain.texture.iter_mut().flatten().for_each(|a| *a = 1.0);
    rows.push(Row { name: "this model, no modulation".into(), errors: error_map(&mesh, &plain)? });
    std::fs::create_dir_all(&args.output)?;
    let pictures = pictures(&args.output, &mesh, &head, &model, (&rows[0].errors, &rivals[0]))?;
    Ok(Told {
        title: "A model of subsurface scattering of an object",
        on: "pixels kept from all fits",
        channels: head.channels,
        points: mesh.beams.len(),
        rows,
        pictures,
    })
}

/// A frame of a laser position of median error, its model, samples against fits, and what vertices and texels hold.
fn pictures(
    folder: &Path,
    mesh: &MeshCapture,
    head: &VertexHead,
    model: &VertexModel,
    (errors, dipole): (&ErrorMap, &VertexModel),
) -> anyhow::Result<Vec<Vec<Figure>>> {
    let channel = 1.min(head.channels.len() - 1);
    let mut order: Vec<usize> = (0..mesh.beams.len()).filter(|&b| errors.ln[b][channel].is_finite()).collect();
    order.sort_by(|&a, &b| errors.ln[a][channel].total_cmp(&errors.ln[b][channel]));
    let Some(&beam) = order.get(order.len() / 2) else { return Ok(Vec::new()) };
    let [.., height, width] = mesh.capture.frames.shape;
    let view = mesh.views(beam)[0];
    let measured = mesh.reflectance(beam, view, channel)?;
    let first = frame_pictures(folder, (width, height), &measured, &model.predict(mesh, beam, view, channel))?;
    let distances = mesh.distances(beam, view);
    let mut samples = Vec::new();
    for (value, r) in measured.iter().zip(&distances) {
        samples.extend(r.map(|r| [r, f64::from(*value)]));
    }
    let nearest = mesh.nearest_vertex(beam);
    let line = |name, color, model: &VertexModel| {
        let vertex = model.vertices[nearest].clone();
        Line { name, color, value: Box::new(move |r| vertex.value(r, channel)) }
    };
    samples_plot::write(
        &folder.join("samples.svg"),
        &samples,
        &[line("this model", "#14479e", model), line("dipole", "#c0392b", dipole)],
    )?;
    let caption = "the samples of this frame against the fall-off of the nearest vertex, without modulation".to_owned();
    let against = Figure { file: "samples.svg".into(), caption };
    let size = (width, height);
    let maps = [
        (
            "near.png",
            "R of each place at 1 mm, from white at the brightest",
            mesh.vertex_map(view, |v| model.vertices[v].value(1.0, channel).unwrap_or(0.0)),
        ),
        ("far.png", "R at 5 mm", mesh.vertex_map(view, |v| model.vertices[v].value(5.0, channel).unwrap_or(0.0))),
        (
            "measured-vertices.png",
            "bright: measured; dark: from neighbours",
            mesh.vertex_map(view, |v| if model.vertices[v].measured() { 0.9 } else { 0.3 }),
        ),
        ("texture.png", "modulation, white is 2", mesh.texel_map(view, model.texels_per_edge, &model.texture[channel])),
    ];
    let mut second = Vec::new();
    for (name, caption, values) in maps {
        let most = match name {
            "near.png" | "far.png" => values.iter().copied().fold(1e-30, f32::max),
            "texture.png" => 2.0,
            _ => 1.0,
        };
        second.push(figure(folder, name, caption, size, values.into_iter().map(|v| v / most))?);
    }
    Ok(vec![first, second, vec![against]])
}
