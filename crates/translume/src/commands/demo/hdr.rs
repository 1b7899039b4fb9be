//! The HDR chapter: three hand-held exposures of a room in which a ball flies, merged and compared with the room.

use super::Part;
use crate::commands::page::{Chapter, Figure, Table, escape};
use crate::commands::pictures;
use crate::output::Context;
use anyhow::bail;
use rayon::prelude::*;
use serde_json::json;
use std::path::Path;
use translume_hdr::simulate::{Ball, Camera, Pose, scale_to};
use translume_hdr::{Alignment, Exposure, Merged, Params, ghost_share, merge_bracket, simulate};
use translume_image::tonemap::{Display, ReinhardParams, exposure_gamma, reinhard_global};
use translume_image::{
    ExrOptions, Picture, Rgb32FImage, Samples, atomic, decode_picture, metrics, read_codes, write_exr, write_gray_png,
    write_png8,
};

/// See `assets/README.md`.
const ROOM: &[u8] = include_bytes!("../../../assets/room.exr");
/// Exposure time in seconds, how the hand moved (degrees, pixels), where the ball was (pixels).
const SHOTS: [(f64, f64, [f64; 2], [f64; 2]); 3] = [
    (1.0 / 60.0, 1.2, [9.5, -6.25], [400.0, 258.0]),
    (1.0 / 15.0, 0.0, [0.0, 0.0], [335.0, 300.0]),
    (1.0 / 4.0, -0.9, [-7.0, 10.5], [282.0, 350.0]),
];
/// The shot whose view the result has.
const ANCHOR: usize = 1;
/// Pixels at the sides that the moved shots may not see.
const MARGIN: usize = 24;

/// What the camera saw and what it wrote.
struct Bracket {
    camera: Camera,
    poses: Vec<Pose>,
    /// What a perfect camera would have seen from the anchor, up to what the shortest exposure can tell.
    truth: Rgb32FImage,
    exposures: Vec<Exposure>,
}

pub(super) fn chapter(dir: &Path, ctx: &Context) -> anyhow::Result<Part> {
    let bracket = shoot(&dir.join("hdr"))?;
    let merge = |params: Params| merge_bracket(&bracket.exposures, &params, &|what| ctx.trace(what));
    let anchored = || Params { anchor: Some(ANCHOR), ..Params::default() };
    let merged = merge(anchored())?;
    let global = merge(Params { alignment: Alignment::Global, ghosts: None, ..anchored() })?;
    let tripod = merge(Params { alignment: Alignment::Off, ghosts: None, ..anchored() })?;

    let rows = [
        ("the middle exposure alone", &single(&bracket)),
        ("merged as if from a tripod", &tripod.radiance),
        ("aligned by one affine map per shot", &global.radiance),
        ("aligned non-linearly, ghosts left out (the default)", &merged.radiance),
    ];
    let psnr: Vec<f64> = rows.iter().map(|(_, picture)| psnr_mu(&bracket, picture)).collect();
    let end_point: Vec<f64> = (0..SHOTS.len()).map(|i| end_point_error(&bracket, &merged, i)).collect();

    let result = Picture::new(on_scale(&bracket.truth, merged.radiance.clone()));
    let options = ExrOptions {
        software: Some(format!("translume {}", env!("CARGO_PKG_VERSION"))),
        command: Some(ctx.command_line.clone()),
        ..ExrOptions::default()
    };
    write_exr(&dir.join("hdr/room.exr"), &result, &options)?;
    let pictures = draw(&dir.join("hdr"), &bracket, &merged, &tripod, &result)?;
    let figures = json!({
        "psnr_mu_db": { "single": psnr[0], "tripod": psnr[1], "global": psnr[2], "default": psnr[3] },
        "end_point_error_px": end_point,
        "ghost_share": merged.confidences.iter().map(|c| c.as_deref().map_or(0.0, ghost_share)).collect::<Vec<_>>(),
        "seconds": merged.seconds.iter().map(|s| s.1).sum::<f64>(),
    });
    let table = Table {
        columns: vec!["merge".into(), "PSNR-µ against the truth".into()],
        rows: rows.iter().zip(&psnr).map(|((name, _), db)| vec![(*name).to_owned(), format!("{db:.2} dB")]).collect(),
    };
    let chapter = Chapter {
        title: "Hand-held brackets to radiance".into(),
        html: text(dir, &end_point, &merged),
        pictures,
        figures: table,
    };
    Ok(Part { chapter, figures })
}

/// Takes the shots, writes them as files and reads them back, as from a memory card.
fn shoot(dir: &Path) -> anyhow::Result<Bracket> {
    let room = decode_picture(ROOM, Path::new("room.exr"))?.pixels;
    let room = bright_at(&room, 0.97);
    let camera = Camera::default();
    let mut list = String::from("# file seconds\n");
    let (mut poses, mut exposures) = (Vec::new(), Vec::new());
    for (i, (secs, degrees, shift_px, _)) in SHOTS.into_iter().enumerate() {
        let pose = Pose { rotation_rad: degrees.to_radians(), shift_px };
        let view = camera.view(&room, &pose, Some(&ball(i)));
        let codes = camera.expose(&view, secs, i as u32);
        let Samples::U8(bytes) = &codes.samples else { bail!("the demo's camera writes 8 bits") };
        let name = format!("shot{}.png", i + 1);
        let path = dir.join(&name);
        write_png8(&path, camera.size, bytes)?;
        list += &format!("{name} {secs:.6}\n");
        poses.push(pose);
        exposures.push(Exposure { name, codes: read_codes(&path)?, alpha: None, secs });
    }
    atomic::write_bytes(&dir.join("exposures.txt"), list.as_bytes())?;
    let limit = (camera.white_secs / SHOTS[0].0) as f32;
    let mut truth = camera.view(&room, &poses[ANCHOR], Some(&ball(ANCHOR)));
    truth.par_iter_mut().for_each(|v| *v = v.min(limit));
    Ok(Bracket { camera, poses, truth, exposures })
}

fn ball(shot: usize) -> Ball {
    Ball { centre_px: SHOTS[shot].3, radius_px: 34.0, white: 0.5, roll_rad: 0.7 * shot as f64 }
}

/// The scene scaled so that a share `q` of its samples is below 1.
fn bright_at(scene: &Rgb32FImage, q: f64) -> Rgb32FImage {
    let mut sorted = scene.as_raw().clone();
    let k = ((sorted.len() - 1) as f64 * q) as usize;
    let one = sorted.select_nth_unstable_by(k, f32::total_cmp).1.max(1e-6);
    let mut out = scene.clone();
    out.iter_mut().for_each(|v| *v /= one);
    out
}

/// The anchor's shot by itself, through the response that the camera really has.
fn single(bracket: &Bracket) -> Rgb32FImage {
    let codes = &bracket.exposures[ANCHOR].codes;
    let mut out = Rgb32FImage::new(codes.width as u32, codes.height as u32);
    out.iter_mut().enumerate().for_each(|(i, v)| *v = simulate::exposure_of(codes.unit(i)));
    out
}

/// `picture` times the one factor that an unknown absolute exposure leaves free.
fn on_scale(truth: &Rgb32FImage, mut picture: Rgb32FImage) -> Rgb32FImage {
    let scale = scale_to(truth, &picture);
    picture.iter_mut().for_each(|v| *v *= scale);
    picture
}

fn psnr_mu(bracket: &Bracket, picture: &Rgb32FImage) -> f64 {
    let inner = |p: &Rgb32FImage| -> Vec<f32> {
        let (w, h) = bracket.camera.size;
        let rows = p.as_raw().chunks_exact(3 * w).skip(MARGIN).take(h - 2 * MARGIN);
        rows.flat_map(|row| &row[3 * MARGIN..3 * (w - MARGIN)]).copied().collect()
    };
    let (truth, test) = (inner(&bracket.truth), inner(&on_scale(&bracket.truth, picture.clone())));
    metrics::psnr_mu(&truth, &test, metrics::top_percentile(&truth))
}

/// Mean distance between the displacement found and the true one in pixels, the ball's places left out.
fn end_point_error(bracket: &Bracket, merged: &Merged, i: usize) -> f64 {
    let (w, h) = bracket.camera.size;
    let (mut sum, mut n) = (0.0, 0.0);
    let hidden = |x: usize, y: usize| {
        [ball(i), ball(ANCHOR)]
            .iter()
            .any(|b| (x as f64 - b.centre_px[0]).hypot(y as f64 - b.centre_px[1]) < b.radius_px + 4.0)
    };
    for y in (MARGIN..h - MARGIN).step_by(2) {
        for x in (MARGIN..w - MARGIN).step_by(2).filter(|x| !hidden(*x, y)) {
            let found = merged.aligned[i].field.source(x as f32, y as f32);
            let place = bracket.poses[i].place([x as f64, y as f64], bracket.camera.size);
            sum += (f64::from(found.0) - place[0]).hypot(f64::from(found.1) - place[1]);
            n += 1.0;
        }
    }
    sum / n
}

/// Writes the pictures of the chapter and returns them row by row.
fn draw(
    dir: &Path,
    bracket: &Bracket,
    merged: &Merged,
    tripod: &Merged,
    result: &Picture,
) -> anyhow::Result<Vec<Vec<Figure>>> {
    let size = bracket.camera.size;
    let save = |name: &str, display: &Display| write_png8(&dir.join(name), size, &display.to_u8());
    let figure = |name: &str, caption: &str| Figure { file: format!("hdr/{name}"), caption: caption.into() };
    let shots = SHOTS.iter().enumerate().map(|(i, (secs, degrees, shift, _))| {
        let motion = match i == ANCHOR {
            true => "the anchor: its view is the result's".to_owned(),
            false => format!("the hand turned by {degrees}° and moved by {:.1} px", shift[0].hypot(shift[1])),
        };
        figure(&format!("shot{}.png", i + 1), &format!("Shot {}, 1/{:.0} s; {motion}", i + 1, 1.0 / secs))
    });
    let shots = shots.collect();

    // One white for all three, the truth's, so that they can be compared.
    let tone = |p: &Rgb32FImage| {
        let white = metrics::top_percentile(&bracket.truth) as f32;
        let scaled = Picture::new(on_scale(&bracket.truth, p.clone()));
        reinhard_global(&scaled, &ReinhardParams { white: Some(white), ..ReinhardParams::default() })
    };
    save("tripod.png", &tone(&tripod.radiance))?;
    save("result.png", &tone(&merged.radiance))?;
    save("truth.png", &tone(&bracket.truth))?;
    save("dark.png", &exposure_gamma(result, -2.0, None))?;
    save("bright.png", &exposure_gamma(result, 2.0, None))?;
    let mut mask = vec![0u8; size.0 * size.1];
    for confidence in merged.confidences.iter().flatten() {
        mask.iter_mut().zip(confidence).for_each(|(m, c)| *m = (*m).max(255 - c));
    }
    write_gray_png(&dir.join("ghosts.png"), size, &mask)?;
    let longest = SHOTS.len() - 1;
    pictures::motion(&merged.aligned[longest].field, size, 1).save(&dir.join("motion.png"))?;
    Ok(vec![
        shots,
        vec![
            figure("tripod.png", "Merged as if from a tripod: every edge is double, the ball is there three times"),
            figure("result.png", "Merged by translume (hdr/room.exr), global tone mapping after Reinhard 2002"),
            figure("truth.png", "The truth, the same way"),
        ],
        vec![
            figure("dark.png", "The result two stops darker: the light around the lamp is there"),
            figure("bright.png", "Two stops brighter: so are the corners"),
        ],
        vec![
            figure("ghosts.png", "Ghosts: where it is white, a shot was left out"),
            figure("motion.png", "How shot 3 was moved: hue is the direction, brightness the length"),
        ],
    ])
}

fn text(dir: &Path, end_point: &[f64], merged: &Merged) -> String {
    let folder = dir.join("hdr");
    let command = format!(
        "translume hdr {0}/shot1.png {0}/shot2.png {0}/shot3.png --list {0}/exposures.txt --anchor {ANCHOR} \\\n    -o room.exr --preview --report report/",
        folder.display()
    );
    format!(
        "<p>A room (rendering by Benedikt Bitterli, CC0, after Eric Veach) is photographed three times by a simulated camera: \
         the hand turns and shakes, a ball flies through, and the camera adds noise, a response curve that is no gamma, and \
         rounding to 8 bits. No single exposure holds both the lamp's light and the dark corners. translume finds the \
         response, aligns the shots, leaves out what moved and merges the rest into linear radiance.</p>\
         <p>The alignment is off by {:.2} px on average in the short shot and by {:.2} px in the long one; aligning and \
         merging took {:.2} s. PSNR-µ is the peak signal-to-noise ratio after the µ-law (µ = 5000), without a margin of \
         {MARGIN} px, against what a camera without noise would have seen.</p>\n<pre>{}</pre>",
        end_point[0],
        end_point[SHOTS.len() - 1],
        merged.seconds.iter().map(|s| s.1).sum::<f64>(),
        escape(&command)
    )
}
