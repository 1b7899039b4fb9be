//! The renderer's chapter: a box by `path`, how its noise falls, its feature images, and the same box full of fog.

use super::Part;
use crate::commands::page::{Chapter, Figure, Table, escape};
use crate::output::Context;
use anyhow::{Context as _, anyhow};
use serde_json::json;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;
use translume_image::colour::linear_to_srgb;
use translume_image::{ExrOptions, atomic, metrics, write_exr_channels, write_png8};
use translume_render::World;
use translume_render::film::{Aov, Film};
use translume_render::integrator::{self, Settings};
use translume_render::render::{Shot, Until};
use translume_scene::LoadOptions;

/// See `assets/README.md`.
const BOX: &[u8] = include_bytes!("../../../assets/box.xml");
/// Samples per pixel of the pictures that are compared with the last one.
const STEPS: [u64; 3] = [1, 4, 16];
const REFERENCE: u64 = 128;
const FOG: u64 = 32;
/// Stops that the pictures are brightened by.
const STOPS: f32 = 0.5;

pub(super) fn chapter(dir: &Path, ctx: &Context) -> anyhow::Result<Part> {
    let folder = dir.join("render");
    atomic::write_bytes(&folder.join("box.xml"), BOX)?;
    atomic::write_bytes(&folder.join("fog.vol"), &fog())?;

    let begun = Instant::now();
    let (reference, rays) = shoot(&folder, "0", "path", REFERENCE, 0, &[Aov::Albedo, Aov::Normal])?;
    let seconds = begun.elapsed().as_secs_f64();
    let mut errors = Vec::new();
    for samples in STEPS {
        let (film, _) = shoot(&folder, "0", "path", samples, 1, &[])?;
        errors.push(metrics::rel_mse(&reference.rgb(), &film.rgb(), 1e-2));
        save(&folder.join(format!("path-{samples}.png")), &film)?;
    }
    let (foggy, _) = shoot(&folder, "1", "volpath", FOG, 0, &[])?;

    save(&folder.join("path.png"), &reference)?;
    save(&folder.join("fog.png"), &foggy)?;
    save_features(&folder, &reference)?;
    let channels = reference.channels();
    let channels: Vec<(&str, &[f32])> = channels.iter().map(|(name, values)| (*name, &values[..])).collect();
    let options = ExrOptions { command: Some(ctx.command_line.clone()), ..ExrOptions::default() };
    write_exr_channels(&folder.join("box.exr"), size(&reference), &channels, &options)?;

    let row = |(samples, error): (&u64, &f64)| vec![samples.to_string(), format!("{error:.4}")];
    let figures = Table {
        columns: vec!["samples per pixel".into(), format!("relMSE against {REFERENCE} samples")],
        rows: STEPS.iter().zip(&errors).map(row).collect(),
    };
    let chapter = Chapter {
        title: "Rendering".into(),
        html: text(dir, rays as f64 / seconds.max(1e-9)),
        pictures: pictures(),
        figures,
    };
    let figures =
        json!({ "samples_per_pixel": STEPS, "rel_mse": errors, "rays_per_second": rays as f64 / seconds.max(1e-9) });
    Ok(Part { chapter, figures })
}

/// The box with fog of this density by `method`, and the rays it took.
fn shoot(
    folder: &Path,
    density: &str,
    method: &str,
    samples: u64,
    seed: u64,
    aovs: &[Aov],
) -> anyhow::Result<(Film, u64)> {
    let options = LoadOptions { defines: vec![("density".into(), density.into())], ..LoadOptions::default() };
    let scene = Arc::new(translume_scene::load(&folder.join("box.xml"), &options)?);
    let world = World::new(scene.clone())?;
    let sensor = scene.sensors.first().context("the demo's scene has a camera")?;
    let method = integrator::by_name(method, Settings::of(&scene)).ok_or_else(|| anyhow!("no integrator {method}"))?;
    let shot = Shot::new(&world, &*method, sensor, None, seed);
    let mut film = Film::new(shot.size(), aovs)?;
    let until = Until { samples, time: None };
    let progress = shot.render(&mut film, &until, &AtomicBool::new(false), &mut |_, _| {});
    Ok((film, progress.rays))
}

/// A grid in Mitsuba's format over the box: fog that gets thinner with height, in waves.
fn fog() -> Vec<u8> {
    const N: [i32; 3] = [16, 16, 16];
    let mut bytes = b"VOL\x03".to_vec();
    bytes.extend([1, N[0], N[1], N[2], 1].iter().flat_map(|v: &i32| v.to_le_bytes()));
    bytes.extend([-1.0_f32, 0.0, -1.0, 1.0, 2.0, 1.0].iter().flat_map(|v| v.to_le_bytes()));
    for i in 0..N[0] * N[1] * N[2] {
        let (x, y, z) = ((i % 16) as f32 / 15.0, (i / 16 % 16) as f32 / 15.0, (i / 256) as f32 / 15.0);
        let surface = 0.45 + 0.12 * (7.0 * x + 2.0 * z).sin() + 0.1 * (9.0 * z - 3.0 * x).sin();
        bytes.extend((1.0 / (1.0 + ((y - surface) * 14.0).exp())).to_le_bytes());
    }
    bytes
}

fn size(film: &Film) -> (usize, usize) {
    (film.size()[0] as usize, film.size()[1] as usize)
}

fn save(path: &Path, film: &Film) -> anyhow::Result<()> {
    let code = |v: f32| (linear_to_srgb((v * STOPS.exp2()).clamp(0.0, 1.0)) * 255.0).round() as u8;
    let pixels: Vec<u8> = film.rgb().into_iter().map(code).collect();
    Ok(write_png8(path, size(film), &pixels)?)
}

/// Albedo, and normals as colours.
fn save_features(folder: &Path, film: &Film) -> anyhow::Result<()> {
    let channels = film.channels();
    let plane = |name: &str| channels.iter().find(|c| c.0 == name).map_or(&[][..], |c| &c.1);
    for (file, names, code) in [
        ("albedo.png", ["Albedo.R", "Albedo.G", "Albedo.B"], (|v| linear_to_srgb(v.clamp(0.0, 1.0))) as fn(f32) -> f32),
        ("normal.png", ["Ns.X", "Ns.Y", "Ns.Z"], |v| 0.5 + 0.5 * v),
    ] {
        let planes = names.map(plane);
        let pixels: Vec<u8> = (0..planes[0].len())
            .flat_map(|i| planes.map(|p| (code(p[i]).clamp(0.0, 1.0) * 255.0).round() as u8))
            .collect();
        write_png8(&folder.join(file), size(film), &pixels)?;
    }
    Ok(())
}

fn pictures() -> Vec<Vec<Figure>> {
    let figure = |name: &str, caption: String| Figure { file: format!("render/{name}"), caption };
    let noisy = STEPS.map(|n| figure(&format!("path-{n}.png"), format!("{n} samples per pixel")));
    let last = [
        figure("path.png", format!("path, {REFERENCE} samples per pixel")),
        figure("fog.png", format!("volpath, {FOG} samples per pixel: the same box with fog in it")),
        figure("albedo.png", "A feature image: albedo of what is seen first".into()),
        figure("normal.png", "Another: shading normals".into()),
    ];
    vec![noisy.into(), last.into()]
}

fn text(dir: &Path, rays_per_second: f64) -> String {
    let folder = escape(&dir.join("render").display().to_string());
    format!(
        "<p>A scene in Mitsuba's format, by path tracing with emitter sampling: {:.1} million rays per second. The error falls \
         with the number of samples, by nothing else: there is no bias to be tuned. By hand:</p>\n<pre>\
         translume render {folder}/box.xml -o box.exr --spp {REFERENCE} --aov albedo,normal\n\
         translume render {folder}/box.xml -o fog.exr --spp {FOG} --integrator volpath --set density=1</pre>",
        rays_per_second / 1e6
    )
}
