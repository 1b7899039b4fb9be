//! The field chapter: a scene under 48 lights, compressed, and lit where no light was.

use super::Part;
use crate::commands::page::{Chapter, Figure, Table, escape};
use crate::output::Context;
use serde_json::json;
use std::path::Path;
use translume_field::{Model, Params, Rate, Relighter, Stack, compress, file, lights::normalised, measure, simulate};
use translume_image::write_png8;

const SIZE: (u32, u32) = (320, 240);
/// Lights of the stack, and directions that none of them has.
const LIGHTS: usize = 48;
const BETWEEN: [[f32; 3]; 2] = [[-0.5, 0.35, 0.8], [0.75, -0.3, 0.6]];

pub(super) fn chapter(dir: &Path, ctx: &Context) -> anyhow::Result<Part> {
    let folder = dir.join("field");
    // Those above the horizon of twice as many around the scene.
    let lights: Vec<[f32; 3]> = simulate::lights(LIGHTS * 3 / 2).into_iter().take(LIGHTS).collect();
    simulate::write(&folder.join("stack"), SIZE, &lights)?;
    let mut stack = Stack::open(&folder.join("stack"), None)?;
    let mut rows = Vec::new();
    let mut psnr = Vec::new();
    let mut fields = Vec::new();
    for (name, model) in [
        ("linear PCA", Model::LinearPca),
        ("log PCA, as the thesis", Model::LogPca),
        ("layers (the default)", Model::Layers),
    ] {
        let params = Params { model, rate: Rate::Terms(8), ..Params::default() };
        let field = compress(&mut stack, &params, &|what| ctx.trace(what))?;
        let errors = measure::compare(&field, &mut stack, &|| ())?;
        let db = errors.iter().map(|e| e.psnr).sum::<f64>() / errors.len() as f64;
        let texels = (field.width * field.height) as f64;
        rows.push(vec![
            name.to_owned(),
            format!("{:.1}", field.texture_bytes() as f64 / texels),
            format!("{db:.2} dB"),
        ]);
        psnr.push(db);
        fields.push(field);
    }
    let path = folder.join("scene.glb");
    let ours = &fields[2];
    file::write(&path, ours, &ctx.command_line, None)?;
    let bytes = std::fs::metadata(&path)?.len();
    let mut pictures = Vec::new();
    for (i, direction) in BETWEEN.iter().enumerate() {
        let light = normalised(*direction).unwrap_or([0.0, 0.0, 1.0]);
        let truth = simulate::picture(SIZE, light).into_raw();
        let mut row = Vec::new();
        let mut show = |name: &str, caption: &str, picture: &[f32]| -> anyhow::Result<()> {
            let code = |v: &f32| (measure::shown(v / ours.white) * 255.0 + 0.5) as u8;
            let name = format!("{name}-{}.png", i + 1);
            write_png8(&folder.join(&name), (ours.width, ours.height), &picture.iter().map(code).collect::<Vec<_>>())?;
            row.push(Figure { file: format!("field/{name}"), caption: caption.into() });
            Ok(())
        };
        show("truth", "a light that the stack does not have: the truth", &truth)?;
        for (k, caption) in [(1, "relit from log PCA, as the thesis"), (2, "relit from layers, the default")] {
            let relighter = Relighter::new(&fields[k])?;
            show(["linear", "thesis", "layers"][k], caption, &relighter.picture(&relighter.mix(light)))?;
        }
        pictures.push(row);
    }
    let place = escape(&dir.join("field").to_string_lossy());
    let html = format!(
        "<p>Two balls on a relief, a metal and a velvet one, under {LIGHTS} lights in turn: HDR pictures with cast shadows. \
         They become one file of {bytes} bytes ({:.0}:1 of half floats) that is lit from anywhere.</p>\
         <pre>translume field compress {place}/stack -o {place}/scene.glb --terms 8\n\
         translume field relight {place}/scene.glb --light -0.5,0.35,0.8 -o lit.exr</pre>",
        (6 * stack.pixels() * LIGHTS) as f64 / bytes as f64
    );
    let figures =
        json!({ "psnr_db": { "linear_pca": psnr[0], "log_pca": psnr[1], "layers": psnr[2] }, "bytes": bytes });
    let columns = vec!["8 terms".into(), "bytes a texel".into(), "PSNR of the stack's pictures on a display".into()];
    let chapter =
        Chapter { title: "A scene under many lights".into(), html, pictures, figures: Table { columns, rows } };
    Ok(Part { chapter, figures })
}
