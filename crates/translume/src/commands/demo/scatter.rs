//! The chapter of translucent objects: one is captured with a laser, two models are fitted to it, and both are lit by lights that the capture
//! does not have, beside the truth.

use super::Part;
use crate::commands::page::{Chapter, Figure, Table, escape};
use crate::commands::scatter::picture::{white, write_png};
use crate::output::Context;
use anyhow::{Context as _, anyhow, ensure};
use serde_json::json;
use std::f32::consts::FRAC_PI_4;
use std::path::Path;
use std::time::Instant;
use translume_image::{Error, atomic};
use translume_mesh::glam::Vec3;
use translume_mesh::{TriMesh, ply};
use translume_scatter::capture::{Capture, Surface};
use translume_scatter::hierarchical::{
    AtlasParams, Hierarchical, HierarchicalHead, HierarchicalParams, Stage, fit_hierarchical, save_hierarchical,
};
use translume_scatter::relight::{self, Light, Lighting, Relighter, Sight, Sources, uniform_picture};
use translume_scatter::simulate::{
    CaptureParams, LitParams, Medium, Procedural, Solid, capture_solid, picture_of_solid,
};
use translume_scatter::vertex::{MeshCapture, UniformModel, VertexHead, fit_uniform, save_uniform_model};
use translume_scatter::{Model, Params};

/// Pattern of the marble: one with a vein through the object.
const PATTERN: u64 = 3;
/// Squares along an edge of the cube that the object is made of.
const SQUARES: u16 = 7;
/// Of the capture; fitted to are all samples, so that the noise of faint ones cancels.
const SPACING_MM: f64 = 1.4;
const BEAM_MM: f64 = 1.0;
const PHOTONS: usize = 800;
const EVENNESS: f64 = 0.5;
const THRESHOLD: f64 = 0.0;
/// Directions of the lit places whose frames are shown.
const SHOWN: [Vec3; 3] = [Vec3::new(-0.5, -1.0, 0.3), Vec3::new(0.2, -1.0, 0.2), Vec3::new(0.8, -0.8, 0.4)];
/// Photons of each of two halves of a truth, and the texels that they are counted in: the noise of smaller ones would be seen.
const HALF_PHOTONS: usize = 400_000;
const TEXEL_MM: f64 = 0.35;
const SIZE: (usize, usize) = (128, 96);

/// Linear RGB.
type Picture = Vec<[f32; 3]>;

/// What was fitted.
struct Models {
    hierarchical: Hierarchical,
    dipole: UniformModel,
    surface: Surface,
}

/// An object under a light.
struct Relit {
    truth: Picture,
    /// By both models, their errors, and how long a picture took.
    pictures: [Picture; 2],
    errors: [f64; 2],
    seconds: [f64; 2],
}

pub(super) fn chapter(dir: &Path, ctx: &Context) -> anyhow::Result<Part> {
    let folder = dir.join("scatter");
    let solid = Solid::new(object()).map_err(|what| anyhow!("the demo's object: {what}"))?;
    let file = folder.join("object.ply");
    atomic::write(&file, |out| ply::write(solid.mesh(), out).map_err(|e| Error::io(&file, e)))?;
    let medium = Procedural::Marble.fill(PATTERN, solid.bounds(), |p| solid.depth(p));
    let begun = Instant::now();
    let capture = shoot(&folder, (&solid, &medium), ctx)?;
    let capturing = begun.elapsed().as_secs_f64();
    let positions = capture.rig.laser.hits_mm.len();
    let mut pictures = vec![frames(&folder, &capture)?];
    let (models, fitting) = fit(&folder, capture, ctx)?;

    let (mut errors, mut showing) = (Vec::new(), [0.0; 2]);
    for (name, said, light) in lights() {
        let relit = relight(&folder.join(format!("{name}.json")), light, (&solid, &medium), &models)?;
        pictures.push(show(&folder, name, said, &relit)?);
        (0..2).for_each(|i| showing[i] += 0.5 * relit.seconds[i]);
        errors.push(relit.errors);
    }
    let bytes = [size(&folder.join("model"))?, size(&folder.join("dipole"))?];
    let row = |i: usize| {
        let percent = |light: usize| format!("{:.1} %", 100.0 * errors[light][i]);
        vec![
            ["hierarchical", "dipole"][i].to_owned(),
            percent(0),
            percent(1),
            format!("{:.1} s", fitting[i]),
            format!("{:.1} ms", 1e3 * showing[i]),
            format!("{:.0} kB", bytes[i] as f64 / 1e3),
        ]
    };
    let columns = ["model", "error, lit from behind", "error, under the spot", "fitted in", "a picture in", "on disk"];
    let figures = Table { columns: columns.map(str::to_owned).to_vec(), rows: vec![row(0), row(1)] };
    let captured = size(&folder.join("capture"))? as f64 / 1e6;
    let html = text(dir, positions, capturing, captured);
    let of = |light: [f64; 2]| json!({ "hierarchical": light[0], "dipole": light[1] });
    let told = json!({
        "error": { "behind": of(errors[0]), "spot": of(errors[1]) }, "positions": positions,
        "capture_seconds": capturing, "fit_seconds": of(fitting),
        "picture_seconds": of(showing), "bytes": { "hierarchical": bytes[0], "dipole": bytes[1] },
    });
    let title = "A translucent object, captured and relit".into();
    Ok(Part { chapter: Chapter { title, html, pictures, figures }, figures: told })
}

/// A cube of squares blown up to a ball, with bumps and hollows, 15 mm long.
fn object() -> TriMesh {
    let place = |cell: [u16; 3]| {
        let on_cube = cell.map(|k| (FRAC_PI_4 * (2.0 * f32::from(k) / f32::from(SQUARES) - 1.0)).tan());
        let d = Vec3::from(on_cube).normalize();
        let bump = |x, y, z, width: f32| (-(d.distance_squared(Vec3::new(x, y, z)) / width.powi(2))).exp();
        let height =
            0.18 * bump(0.75, -0.2, 0.6, 0.5) + 0.2 * bump(-0.8, 0.1, 0.4, 0.45) + 0.16 * bump(-0.1, -0.2, 1.0, 0.5)
                - 0.25 * bump(0.1, -1.0, 0.05, 0.4)
                - 0.2 * bump(0.0, 0.0, -1.0, 0.6);
        (6.4 * (1.0 + height) * d * Vec3::new(1.1, 0.85, 0.9)).to_array()
    };
    let mut mesh = TriMesh::default();
    for (axis, side) in [(0, 0), (0, SQUARES), (1, 0), (1, SQUARES), (2, 0), (2, SQUARES)] {
        for (i, j) in (0..SQUARES).flat_map(|i| (0..SQUARES).map(move |j| (i, j))) {
            let corner = |[a, b]: [u16; 2]| {
                let mut cell = [side; 3];
                (cell[(axis + 1) % 3], cell[(axis + 2) % 3]) = (i + a, j + b);
                place(cell)
            };
            let first = mesh.positions.len() as u32;
            mesh.positions.extend([[0, 0], [1, 0], [1, 1], [0, 1]].map(corner));
            let outwards = if side == 0 { [[0, 2, 1], [0, 3, 2]] } else { [[0, 1, 2], [0, 2, 3]] };
            mesh.indices.extend(outwards.map(|t| t.map(|k| first + k)));
        }
    }
    mesh.compacted()
}

/// The capture, in place of one of an earlier run.
fn shoot(folder: &Path, object: (&Solid, &Medium), ctx: &Context) -> anyhow::Result<Capture> {
    let params = CaptureParams {
        spacing_mm: SPACING_MM,
        beam_diameter_mm: BEAM_MM,
        // The object as it turns, and some room.
        field_mm: 1.05 * f64::from(object.0.mesh().bounds().extent().length()),
        views: 4,
        cameras: 2,
        photons: PHOTONS,
        evenness: EVENNESS,
        ..CaptureParams::default()
    };
    let label = json!({ "medium": "marble", "pattern": PATTERN, "command": ctx.command_line });
    let place = folder.join("capture");
    let free = !place.exists() || place.join("rig.json").exists();
    ensure!(free, "{}: it exists and is no capture; remove it", place.display());
    let is_part = |name: &str| ["rig.json", "mesh.ply", "frames"].contains(&name);
    atomic::write_folder(&place, is_part, |new| capture_solid(new, object, &params, label, |_| ()))?;
    Ok(Capture::open(&place)?)
}

/// Fits both models and saves them; with the seconds that the fits took.
fn fit(folder: &Path, capture: Capture, ctx: &Context) -> anyhow::Result<(Models, [f64; 2])> {
    let begun = Instant::now();
    let stage = Stage::new(capture.clone(), THRESHOLD, &AtlasParams::default())?;
    let (hierarchical, told) = fit_hierarchical(stage, &HierarchicalParams::default(), |_| ())?;
    let first = begun.elapsed().as_secs_f64();
    let begun = Instant::now();
    let params = Params { model: Model::Dipole, eta: capture.rig.eta, ..Params::default() };
    let mesh = MeshCapture::new(capture, THRESHOLD)?;
    let dipole = fit_uniform(&mesh, &params, || ())?;
    let seconds = [first, begun.elapsed().as_secs_f64()];

    let command = ctx.command_line.clone();
    let head = HierarchicalHead::new(&hierarchical, &told, command.clone(), THRESHOLD);
    save_hierarchical(&folder.join("model"), &head, &hierarchical)?;
    let head = VertexHead {
        command,
        model: params.model,
        terms: params.terms,
        threshold: THRESHOLD,
        channels: mesh.capture.rig.channels.iter().map(|c| c.name.clone()).collect(),
        eta: params.eta,
        gains: Vec::new(),
    };
    save_uniform_model(&folder.join("dipole"), &head, &dipole, &mesh)?;
    Ok((Models { hierarchical, dipole, surface: mesh.surface }, seconds))
}

/// Their names, what is said of them, and the lights.
fn lights() -> [(&'static str, &'static str, Light); 2] {
    let intensity = [3000.0; 3];
    let behind = Light::Point { position: [10.0, 40.0, 12.0], intensity };
    let spot = Light::Spot {
        position: [-25.0, -30.0, 15.0],
        target: [-2.5, -5.0, 1.0],
        intensity,
        cutoff_deg: 5.0,
        beam_deg: 3.5,
    };
    [("behind", "A lamp behind the object", behind), ("spot", "A spot from the left", spot)]
}

/// Writes the description of a light and shows the object under it.
fn relight(file: &Path, light: Light, object: (&Solid, &Medium), models: &Models) -> anyhow::Result<Relit> {
    let view = Sight {
        eye: [0.0, -60.0, 14.0],
        target: [0.0, 0.0, 0.9],
        up: [0.0, 0.0, 1.0],
        fov_deg: 16.5,
        width: SIZE.0,
        height: SIZE.1,
        samples: 2,
    };
    let lighting = Lighting { view, lights: vec![light] };
    atomic::write_bytes(file, format!("{:#}\n", serde_json::to_value(&lighting)?).as_bytes())?;
    let (view, sources) = (&lighting.view, Sources::new(&lighting.lights, Path::new(""))?);
    let nothing = || anyhow!("{}: there is no light, or no view", file.display());
    let Models { hierarchical, dipole, surface } = models;

    let half = |seed: u64| {
        let params = LitParams { photons: HALF_PHOTONS, texel_mm: TEXEL_MM, eta: hierarchical.eta, rough: false, seed };
        picture_of_solid(object, &sources, view, &params).ok_or_else(nothing)
    };
    let halves = [half(1)?, half(2)?];
    let relighter = Relighter::new(hierarchical, surface, view).ok_or_else(nothing)?;
    let power = || sources.shine(surface, &hierarchical.atlas, hierarchical.eta as f32);
    let begun = Instant::now();
    let ours = relighter.picture(&power(), relight::Part::Whole);
    let first = begun.elapsed().as_secs_f64();
    let begun = Instant::now();
    let parts = (surface, &hierarchical.atlas, hierarchical.eta);
    let plain = uniform_picture(dipole, parts, &power(), view).ok_or_else(nothing)?;
    let seconds = [first, begun.elapsed().as_secs_f64()];
    let errors = [error(&ours, &halves), error(&plain, &halves)];
    let mean = |(a, b): (&[f32; 3], &[f32; 3])| [0, 1, 2].map(|c| 0.5 * (a[c] + b[c]));
    let truth = halves[0].iter().zip(&halves[1]).map(mean).collect();
    Ok(Relit { truth, pictures: [ours, plain], errors, seconds })
}

/// Relative RMSE over the pixels. The truth's noise is not in it: that of its halves is independent.
fn error(picture: &Picture, halves: &[Picture; 2]) -> f64 {
    let (mut off, mut all) = (0.0, 0.0);
    for ((x, a), b) in picture.iter().flatten().zip(halves[0].iter().flatten()).zip(halves[1].iter().flatten()) {
        let [x, a, b] = [x, a, b].map(|v| f64::from(*v));
        off += (x - a) * (x - b);
        all += a * b;
    }
    (f64::max(off, 0.0) / all).sqrt()
}

/// A row of pictures under one light, with one white.
fn show(folder: &Path, name: &str, said: &str, relit: &Relit) -> anyhow::Result<Vec<Figure>> {
    let white = white(&relit.truth, 97);
    let figures = [
        (
            "truth",
            format!("{said}: the truth, {} thousand photons in texels of {TEXEL_MM} mm", HALF_PHOTONS / 500),
            &relit.truth,
        ),
        ("hierarchical", "By the hierarchical model".to_owned(), &relit.pictures[0]),
        ("dipole", "By the dipole".to_owned(), &relit.pictures[1]),
    ];
    let figure = |(what, caption, picture): (&str, String, &Picture)| {
        let file = format!("{name}-{what}.png");
        write_png(&folder.join(&file), SIZE, picture, white)?;
        Ok(Figure { file: format!("scatter/{file}"), caption })
    };
    figures.into_iter().map(figure).collect()
}

/// Three laser positions as cameras saw them.
fn frames(folder: &Path, capture: &Capture) -> anyhow::Result<Vec<Figure>> {
    let [_, _, channels, rows, columns] = capture.frames.shape;
    let hits: Vec<Vec3> = capture.rig.laser.hits_mm.iter().map(|h| Vec3::from_array(h.map(|x| x as f32))).collect();
    let mut row = Vec::new();
    for (i, direction) in SHOWN.iter().enumerate() {
        let towards = |p: usize| hits[p].normalize().dot(direction.normalize());
        let position =
            (0..hits.len()).max_by(|a, b| towards(*a).total_cmp(&towards(*b))).context("no laser position")?;
        let view = (0..capture.rig.views.len()).find(|v| capture.frames.exists(*v, position, 0)).context("no view")?;
        let planes: Vec<_> = (0..channels).map(|c| capture.frames.read(view, position, c)).collect::<Result<_, _>>()?;
        let planes: Option<Vec<Vec<f32>>> = planes.into_iter().collect();
        let planes = planes.context("a frame of the capture is missing")?;
        let picture: Picture = (0..rows * columns).map(|k| [0, 1, 2].map(|c| planes[c][k])).collect();
        let file = format!("frame-{}.png", i + 1);
        write_png(&folder.join(&file), (columns, rows), &picture, white(&picture, 99))?;
        let caption = format!("Laser position {position}, as the camera of view {view} saw it");
        row.push(Figure { file: format!("scatter/{file}"), caption });
    }
    Ok(row)
}

/// Bytes of the files in a folder.
fn size(folder: &Path) -> anyhow::Result<u64> {
    let mut bytes = 0;
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let entry = entry?;
        bytes += if entry.file_type()?.is_dir() { size(&entry.path())? } else { entry.metadata()?.len() };
    }
    Ok(bytes)
}

fn text(dir: &Path, positions: usize, seconds: f64, megabytes: f64) -> String {
    let folder = escape(&dir.join("scatter").display().to_string());
    format!(
        "<p>Marble with dark veins inside, 15 mm long. A simulated laser lights {positions} places of it in turn, and cameras see the \
         light that comes out around each: {megabytes:.0} MB of frames, simulated in {seconds:.1} s. Two models are fitted to them. The \
         dipole has one fall-off by distance for the whole object, times a texture. The hierarchical one keeps how much light comes \
         from each place to each other.</p>\n<p>Then both are lit by lights that the capture does not have, beside photons followed \
         through the marble itself. A vein that light cannot pass is dark from behind and stops the glow around a spot: that is in what \
         was measured, and in no fall-off that is the same everywhere. The errors are relative RMSE over the pixels, the noise of the \
         truth taken out. By hand:</p>\n<pre>\
         translume scatter simulate marble --pattern {PATTERN} --mesh {folder}/object.ply \\\n    \
         --spacing {SPACING_MM} --beam {BEAM_MM} --photons {PHOTONS} --evenness {EVENNESS} -o capture/\n\
         translume scatter fit {folder}/capture --model hierarchical --threshold {THRESHOLD} -o model/\n\
         translume scatter fit {folder}/capture --model dipole --uniform --threshold {THRESHOLD} -o dipole/\n\
         translume scatter relight {folder}/model --lights {folder}/behind.json -o behind.exr\n\
         translume scatter simulate marble --pattern {PATTERN} --mesh {folder}/object.ply \\\n    \
         --lights {folder}/behind.json --photons {} -o truth.exr</pre>",
        2 * HALF_PHOTONS
    )
}
