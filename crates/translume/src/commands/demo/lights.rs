//! The chapter of many lights: rooms full of lamps, most of them behind walls, by every method in the same time, with
//! pictures of the errors.

use super::Part;
use crate::commands::page::{Chapter, Figure, Table, escape};
use crate::output::Context;
use anyhow::{Context as _, anyhow};
use serde_json::json;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;
use translume_image::colour::linear_to_srgb;
use translume_image::{atomic, metrics, write_png8};
use translume_render::World;
use translume_render::film::Film;
use translume_render::integrator::{self, Settings};
use translume_render::render::{Shot, Until};
use translume_scene::LoadOptions;

/// What is compared.
const METHODS: [&str; 4] = ["path", "bdpt", "photonmap", "gkernel"];
const SECONDS: u64 = 2;
/// Of the picture that they are compared with.
const REFERENCE_SECONDS: u64 = 16;
/// Rooms to each side, their size and height, lamps of each to each side.
const ROOMS: i32 = 4;
const ROOM: f32 = 4.0;
const HEIGHT: f32 = 2.6;
const LAMPS: i32 = 3;

pub(super) fn chapter(dir: &Path, _: &Context) -> anyhow::Result<Part> {
    let folder = dir.join("lights");
    atomic::write_bytes(&folder.join("rooms.xml"), rooms().as_bytes())?;
    let scene = Arc::new(translume_scene::load(&folder.join("rooms.xml"), &LoadOptions::default())?);
    let world = World::new(scene.clone())?;
    let sensor = scene.sensors.first().context("the demo's scene has a camera")?;
    let settings = Settings::of(&scene);
    let shoot = |method: &str, seconds: u64, seed: u64| -> anyhow::Result<Film> {
        let integrator = integrator::by_name(method, settings).ok_or_else(|| anyhow!("no integrator {method}"))?;
        let shot = Shot::new(&world, &*integrator, sensor, None, seed);
        let mut film = shot.film(&[])?;
        let until = Until { samples: u64::MAX, time: Some(Duration::from_secs(seconds)) };
        shot.render(&mut film, &until, &AtomicBool::new(false), &mut |_, _| {});
        Ok(film)
    };
    let reference = shoot("path", REFERENCE_SECONDS, 1)?;
    let white = white(&reference.rgb());
    save(&folder.join("reference.png"), &reference, |rgb, _| rgb.map(|v| linear_to_srgb((v / white).min(1.0))))?;
    let (mut rows, mut errors) = (Vec::new(), serde_json::Map::new());
    for method in METHODS {
        let film = shoot(method, SECONDS, 2)?;
        let truth = reference.rgb();
        let error = metrics::rel_mse(&truth, &film.rgb(), 1e-2);
        save(&folder.join(format!("{method}.png")), &film, |rgb, _| rgb.map(|v| linear_to_srgb((v / white).min(1.0))))?;
        save(&folder.join(format!("{method}-error.png")), &film, |rgb, i| heat(&rgb, &truth[3 * i..3 * i + 3], white))?;
        rows.push(vec![method.to_owned(), film.samples().0.to_string(), format!("{error:.4}")]);
        errors.insert(method.to_owned(), error.into());
    }
    let columns = ["method", "samples per pixel", "relMSE"].map(str::to_owned).to_vec();
    let chapter = Chapter {
        title: "Many lights in many rooms".into(),
        html: text(dir, world.lights().len()),
        pictures: pictures(),
        figures: Table { columns, rows },
    };
    Ok(Part { chapter, figures: json!({ "seconds": SECONDS, "rel_mse": errors }) })
}

/// What is shown as white: nearly the brightest.
fn white(rgb: &[f32]) -> f32 {
    let mut sorted = rgb.to_vec();
    sorted.sort_unstable_by(f32::total_cmp);
    sorted[sorted.len() * 93 / 100].max(1e-6)
}

/// Black, red, yellow, white for errors relative to the truth of 1 %, 10 %, 100 % and more.
fn heat(rgb: &[f32; 3], truth: &[f32], white: f32) -> [f32; 3] {
    let square = |(a, b): (&f32, &f32)| ((a - b) / (b + 0.02 * white)).powi(2);
    let error = (rgb.iter().zip(truth).map(square).sum::<f32>() / 3.0).sqrt();
    let heat = (error.max(1e-4).log10() + 2.0) * 1.2;
    [0.0, 1.0, 2.0].map(|from| (heat - from).clamp(0.0, 1.0))
}

fn save(path: &Path, film: &Film, shown: impl Fn([f32; 3], usize) -> [f32; 3]) -> anyhow::Result<()> {
    let rgb = film.rgb();
    let (pixels, _) = rgb.as_chunks::<3>();
    let codes: Vec<u8> =
        pixels.iter().enumerate().flat_map(|(i, p)| shown(*p, i).map(|v| (v * 255.0).round() as u8)).collect();
    let [w, h] = film.size().map(|s| s as usize);
    Ok(write_png8(path, (w, h), &codes)?)
}

/// Rooms in a square with openings between them, lamps under the ceilings, a ball in each.
fn rooms() -> String {
    let mut xml = "<scene version=\"3.0.0\">\n".to_owned();
    let side = ROOMS as f32 * ROOM;
    let _ = writeln!(
        xml,
        "<integrator type=\"path\"><integer name=\"max_depth\" value=\"8\"/></integrator>\n\
         <sensor type=\"perspective\"><float name=\"fov\" value=\"75\"/><transform name=\"to_world\">\
         <lookat origin=\"0.4,0.5,1.7\" target=\"3,2.6,1.1\" up=\"0,0,1\"/></transform>\
         <film type=\"hdrfilm\"><integer name=\"width\" value=\"192\"/><integer name=\"height\" value=\"128\"/></film></sensor>\n\
         <bsdf type=\"diffuse\" id=\"wall\"><rgb name=\"reflectance\" value=\"0.7,0.66,0.6\"/></bsdf>\n\
         <bsdf type=\"diffuse\" id=\"floor\"><rgb name=\"reflectance\" value=\"0.45,0.32,0.22\"/></bsdf>\n\
         <bsdf type=\"diffuse\" id=\"ball\"><rgb name=\"reflectance\" value=\"0.25,0.4,0.55\"/></bsdf>"
    );
    let mut block = |low: [f32; 3], high: [f32; 3], material: &str| {
        let [half, middle] = [[1.0, -1.0], [1.0, 1.0]]
            .map(|s: [f32; 2]| [0, 1, 2].map(|a| format!("{:.4}", 0.5 * (s[0] * high[a] + s[1] * low[a]))).join(","));
        let _ = writeln!(
            xml,
            "<shape type=\"cube\"><transform name=\"to_world\"><scale value=\"{half}\"/><translate value=\"{middle}\"/></transform>\
             <ref id=\"{material}\"/></shape>"
        );
    };
    block([0.0, 0.0, -0.1], [side, side, 0.0], "floor");
    block([0.0, 0.0, HEIGHT], [side, side, HEIGHT + 0.1], "wall");
    for i in 0..=ROOMS {
        let at = i as f32 * ROOM;
        for j in 0..ROOMS {
            let from = j as f32 * ROOM;
            // Outer walls are whole, inner ones have a doorway in the middle.
            let open = if i == 0 || i == ROOMS { 0.0 } else { 0.45 };
            let (a, b) = (from + 0.5 * ROOM - open, from + 0.5 * ROOM + open);
            for (p, q, low) in [(from, a, 0.0), (b, from + ROOM, 0.0), (a, b, 2.1)] {
                if q > p {
                    block([at - 0.05, p, low], [at + 0.05, q, HEIGHT], "wall");
                    block([p, at - 0.05, low], [q, at + 0.05, HEIGHT], "wall");
                }
            }
        }
    }
    for i in 0..ROOMS * ROOMS {
        let (x, y) = ((i % ROOMS) as f32 * ROOM, (i / ROOMS) as f32 * ROOM);
        let _ = writeln!(
            xml,
            "<shape type=\"sphere\"><point name=\"center\" x=\"{}\" y=\"{}\" z=\"0.5\"/><float name=\"radius\" value=\"0.5\"/>\
             <ref id=\"ball\"/></shape>",
            x + 3.0,
            y + 1.4
        );
        for lamp in 0..LAMPS * LAMPS {
            let at = |k: i32| (k as f32 + 0.5) * ROOM / LAMPS as f32;
            let _ = writeln!(
                xml,
                "<shape type=\"rectangle\"><transform name=\"to_world\"><scale value=\"0.12\"/><rotate x=\"1\" angle=\"180\"/>\
                 <translate value=\"{:.3},{:.3},{:.3}\"/></transform><emitter type=\"area\"><rgb name=\"radiance\" value=\"{}\"/>\
                 </emitter></shape>",
                x + at(lamp % LAMPS),
                y + at(lamp / LAMPS),
                HEIGHT - 0.01,
                if (i + lamp) % 3 == 0 { "18,12,7" } else { "14,14,14" }
            );
        }
    }
    xml + "</scene>\n"
}

fn pictures() -> Vec<Vec<Figure>> {
    let figure = |name: String, caption: String| Figure { file: format!("lights/{name}.png"), caption };
    let shown = METHODS.map(|m| figure(m.to_owned(), format!("{m}, {SECONDS} s")));
    let errors =
        METHODS.map(|m| figure(format!("{m}-error"), format!("Errors of {m}: black 1 %, red 10 %, white 100 %")));
    let reference = figure("reference".into(), format!("What they are compared with: path, {REFERENCE_SECONDS} s"));
    vec![vec![reference], shown.into(), errors.into()]
}

fn text(dir: &Path, lights: usize) -> String {
    let folder = escape(&dir.join("lights").display().to_string());
    format!(
        "<p>{} rooms with {lights} lights, of which one room and what its doorways show is seen: every method for {SECONDS} \
         seconds. By hand:</p>\n<pre>translume render {folder}/rooms.xml -o rooms.exr --integrator gkernel --time 10s\n\
         translume compare rooms.exr other.exr</pre>",
        ROOMS * ROOMS
    )
}
