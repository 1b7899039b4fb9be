//! One page that shows what was merged and how: inputs, result, motion, ghosts, response, figures.

use super::sets::stem;
use crate::commands::page::escape;
use crate::commands::pictures::{motion, shrink};
use crate::output::Context;
use anyhow::Context as _;
use serde_json::Value;
use std::fmt::Write as _;
use std::path::Path;
use translume_hdr::{Exposure, Merged, NODES};
use translume_image::{Picture, atomic, tonemap, write_gray_png};

/// Longer side of the page's pictures.
const SIDE: usize = 960;

/// Writes `index.html` and its pictures into `dir`.
pub(super) fn write(
    dir: &Path,
    exposures: &[Exposure],
    merged: &Merged,
    picture: &Picture,
    summary: &Value,
    ctx: &Context,
) -> anyhow::Result<()> {
    std::fs::create_dir_all(dir).with_context(|| format!("cannot create {}", dir.display()))?;
    let size = (picture.pixels.width() as usize, picture.pixels.height() as usize);
    let step = size.0.max(size.1).div_ceil(SIDE).max(1);
    let reinhard = tonemap::reinhard_global(picture, &tonemap::ReinhardParams::default());
    shrink(size, step, |i| pick(&reinhard.rgb, i)).save(&dir.join("reinhard.png"))?;
    let fattal = tonemap::fattal(picture, &tonemap::FattalParams::default());
    shrink(size, step, |i| pick(&fattal.rgb, i)).save(&dir.join("fattal.png"))?;
    let mut rows = String::new();
    for (i, e) in exposures.iter().enumerate() {
        let input = shrink(size, step, |p| std::array::from_fn(|c| encoded(e, 3 * p + c)));
        input.save(&dir.join(format!("input{i}.png")))?;
        motion(&merged.aligned[i].field, size, step).save(&dir.join(format!("motion{i}.png")))?;
        let ghosts = match &merged.confidences[i] {
            None => String::from("<td>–</td>"),
            Some(confidence) => {
                let (w, h) = (size.0.div_ceil(step), size.1.div_ceil(step));
                let small: Vec<u8> = (0..h)
                    .flat_map(|y| (0..w).map(move |x| (x, y)))
                    .map(|(x, y)| 255 - confidence[y * step * size.0 + x * step])
                    .collect();
                write_gray_png(&dir.join(format!("ghosts{i}.png")), (w, h), &small)?;
                format!("<td><img src=\"ghosts{i}.png\" alt=\"ghost mask\"></td>")
            }
        };
        let figures = &summary["images"][i];
        let number = |key: &str| figures[key].as_f64().unwrap_or(0.0);
        write!(
            rows,
            "<tr><td><b>{}</b><br>exposure {:.5}<br>{}moved {:.2} px on average, {:.2} px at the 95th percentile of its textured places{}<br>ghosts {:.1} %</td>\
             <td><img src=\"input{i}.png\" alt=\"input\"></td><td><img src=\"motion{i}.png\" alt=\"displacement\"></td>{ghosts}</tr>",
            escape(&stem(&e.name)),
            e.secs,
            if i == merged.anchor { "<b>anchor</b><br>" } else { "" },
            number("displacement_mean_px"),
            number("displacement_p95_px"),
            if figures["non_linear"] == true { ", non-linear" } else { "" },
            100.0 * number("ghost_share"),
        )?;
    }
    let warnings: String = merged.warnings.iter().map(|w| format!("<li>{}</li>", escape(w))).collect();
    let seconds: String = summary["seconds"]
        .as_object()
        .into_iter()
        .flatten()
        .map(|(k, v)| format!("{k} {:.2} s; ", v.as_f64().unwrap_or(0.0)))
        .collect();
    let html = format!(
        "<!DOCTYPE html><html lang=\"en\"><meta charset=\"utf-8\"><title>translume hdr: {title}</title><style>{STYLE}</style>\
         <h1>{title}</h1><p class=\"note\">{size0} × {size1} pixels. {seconds}</p>\
         <ul class=\"warn\">{warnings}</ul>\
         <div class=\"pair\"><figure><img src=\"reinhard.png\" alt=\"result\"><figcaption>Result, global tone mapping (Reinhard 2002)</figcaption></figure>\
         <figure><img src=\"fattal.png\" alt=\"result\"><figcaption>Result, gradient domain (Fattal 2002)</figcaption></figure></div>\
         <h2>Pictures</h2><table><tr><th>Picture</th><th>Input</th><th>Displacement (hue: direction, brightness: length)</th>\
         <th>Ghosts (white: left out)</th></tr>{rows}</table>{response}<h2>Command</h2><pre>{command}</pre></html>",
        title = escape(summary["set"].as_str().unwrap_or("bracket")),
        size0 = size.0,
        size1 = size.1,
        response = merged.response.as_ref().map(response_plot).unwrap_or_default(),
        command = escape(&ctx.command_line),
    );
    Ok(atomic::write_bytes(&dir.join("index.html"), html.as_bytes())?)
}

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:1280px;color:#222;background:#fafafa}\
    img{max-width:100%;display:block}.pair{display:flex;gap:1rem}figure{margin:0;flex:1}figcaption,.note{color:#666}\
    table{border-collapse:collapse;width:100%}td,th{padding:.4rem;vertical-align:top;text-align:left;border-top:1px solid #ddd}\
    td img{width:300px}.warn{color:#a40}pre{white-space:pre-wrap;background:#eee;padding:1rem}";

fn encoded(e: &Exposure, i: usize) -> f32 {
    let u = e.codes.unit(i);
    if e.codes.is_linear() { u.clamp(0.0, 1.0).powf(1.0 / 2.2) } else { u }
}

fn pick(rgb: &[f32], i: usize) -> [f32; 3] {
    [rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]]
}

/// The three response curves as an SVG: code over log2 exposure.
fn response_plot(response: &translume_hdr::Response) -> String {
    const W: f32 = 560.0;
    const H: f32 = 320.0;
    let x = |g: f32| W * (0.75 + g / std::f32::consts::LN_2 / 16.0);
    let y = |z: usize| H * (1.0 - z as f32 / (NODES - 1) as f32);
    let curve = |c: usize, colour: &str| {
        let points: String =
            (0..NODES).map(|z| format!("{:.1},{:.1} ", x(response.log_exposure[c][z]), y(z))).collect();
        format!("<polyline points=\"{points}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>")
    };
    let stops: String = (-11..=3)
        .map(|s: i32| {
            let at = x(s as f32 * std::f32::consts::LN_2);
            format!("<line x1=\"{at}\" x2=\"{at}\" y1=\"0\" y2=\"{H}\" stroke=\"#ddd\"/><text x=\"{at}\" y=\"{}\" font-size=\"11\" text-anchor=\"middle\">{s}</text>", H + 14.0)
        })
        .collect();
    format!(
        "<h2>Camera response</h2><p class=\"note\">Code (0 to 255, upwards) over exposure in stops from mid code</p>\
         <svg width=\"{W}\" height=\"{}\" viewBox=\"0 0 {W} {}\">{stops}{}{}{}</svg>",
        H + 20.0,
        H + 20.0,
        curve(0, "#c33"),
        curve(1, "#393"),
        curve(2, "#33c")
    )
}
