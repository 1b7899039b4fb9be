//! One page that shows what was merged and how: inputs, result, motion, ghosts, response, figures.

use super::sets::stem;
use crate::commands::page::{self, Chapter, Figure, Table, escape};
use crate::commands::pictures::{motion, shrink};
use crate::commands::plot::{Axis, Marks, Plot, Series, Shape};
use crate::output::Context;
use anyhow::Context as _;
use serde_json::Value;
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
    let mut rows = Vec::new();
    for (i, e) in exposures.iter().enumerate() {
        let input = shrink(size, step, |p| std::array::from_fn(|c| encoded(e, 3 * p + c)));
        input.save(&dir.join(format!("input{i}.png")))?;
        motion(&merged.aligned[i].field, size, step).save(&dir.join(format!("motion{i}.png")))?;
        let figures = &summary["images"][i];
        let number = |key: &str| figures[key].as_f64().unwrap_or(0.0);
        let name = stem(&e.name);
        let anchor = if i == merged.anchor { ", the anchor" } else { "" };
        let non_linear = if figures["non_linear"] == true { ", non-linear" } else { "" };
        let mut row = vec![
            figure(format!("input{i}.png"), format!("{name}: exposure {:.5}{anchor}", e.secs)),
            figure(
                format!("motion{i}.png"),
                format!(
                    "Displacement (hue: direction, brightness: length): {:.2} px on average, {:.2} px at the 95th percentile of \
                     its textured places{non_linear}",
                    number("displacement_mean_px"),
                    number("displacement_p95_px")
                ),
            ),
        ];
        if let Some(confidence) = &merged.confidences[i] {
            let (w, h) = (size.0.div_ceil(step), size.1.div_ceil(step));
            let pixels = (0..h).flat_map(|y| (0..w).map(move |x| (x, y)));
            let small: Vec<u8> = pixels.map(|(x, y)| 255 - confidence[y * step * size.0 + x * step]).collect();
            write_gray_png(&dir.join(format!("ghosts{i}.png")), (w, h), &small)?;
            let caption = format!("Ghosts (white: left out): {:.1} %", 100.0 * number("ghost_share"));
            row.push(figure(format!("ghosts{i}.png"), caption));
        }
        rows.push(row);
    }
    let warnings: String = merged.warnings.iter().map(|w| format!("<li>{}</li>", escape(w))).collect();
    let seconds = summary["seconds"].as_object().into_iter().flatten();
    let seconds = seconds.map(|(k, v)| vec![k.clone(), format!("{:.2}", v.as_f64().unwrap_or(0.0))]).collect();
    let result = vec![
        figure("reinhard.png".into(), "Result, global tone mapping (Reinhard 2002)".into()),
        figure("fattal.png".into(), "Result, gradient domain (Fattal 2002)".into()),
    ];
    let mut chapters = vec![
        Chapter {
            title: "Result".into(),
            html: if warnings.is_empty() { String::new() } else { format!("<ul class=\"warn\">{warnings}</ul>") },
            pictures: vec![result],
            figures: Table { columns: vec!["stage".into(), "seconds".into()], rows: seconds },
        },
        Chapter { title: "Exposures".into(), html: String::new(), pictures: rows, figures: Table::default() },
    ];
    if let Some(response) = &merged.response {
        atomic::write_bytes(&dir.join("response.svg"), response_plot(response).svg().as_bytes())?;
        let caption = "Code over exposure in stops from the mid code".into();
        chapters.push(Chapter {
            title: "Camera response".into(),
            html: String::new(),
            pictures: vec![vec![figure("response.svg".into(), caption)]],
            figures: Table::default(),
        });
    }
    let command = escape(&ctx.command_line);
    let introduction = format!("<p>{} × {} pixels.</p><pre>{command}</pre>", size.0, size.1);
    let title = summary["set"].as_str().unwrap_or("bracket");
    page::write(&dir.join("index.html"), title, &introduction, &chapters)
}

fn figure(file: String, caption: String) -> Figure {
    Figure { file, caption }
}

fn encoded(e: &Exposure, i: usize) -> f32 {
    let u = e.codes.unit(i);
    if e.codes.is_linear() { u.clamp(0.0, 1.0).powf(1.0 / 2.2) } else { u }
}

fn pick(rgb: &[f32], i: usize) -> [f32; 3] {
    [rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]]
}

/// The three response curves: code over log2 exposure.
fn response_plot(response: &translume_hdr::Response) -> Plot<'static> {
    let curve = |c: usize, color| {
        let stops = |g: f32| f64::from(g / std::f32::consts::LN_2);
        let code = |z: usize| 255.0 * z as f64 / (NODES - 1) as f64;
        let points = (0..NODES).map(|z| [stops(response.log_exposure[c][z]), code(z)]).collect();
        Series { name: "", color, points, shape: Shape::Curve }
    };
    Plot {
        x: Axis { title: "exposure in stops from the mid code", range: (-12.0, 4.0), marks: Marks::Every(1.0) },
        y: Axis { title: "code", range: (0.0, 255.0), marks: Marks::Every(32.0) },
        series: vec![curve(0, "#c33"), curve(1, "#393"), curve(2, "#33c")],
    }
}
