//! `bench-field generate DIR SIZE LIGHTS` writes the synthetic light stage; `bench-field table DIR [NAME …]` compresses a
//! stack by each method and prints errors, bytes and seconds; `bench-field held-out DIR` leaves every fifth light out; `bench-field speed DIR` measures relighting, `bench-field pca DIR` decomposition.

use anyhow::{Context as _, bail};
use std::path::Path;
use std::time::Instant;
use translume_field::{
    Domain, Field, Model, Params, Rate, Relighter, Stack, compress, measure, texture::Codec, tiles::Tiling,
};
use translume_field::{matrix::Matrix, pca, simulate};

/// A row of the table: its name, and how it is made.
fn rows() -> Vec<(&'static str, Params)> {
    let layers = |k| Params { rate: Rate::Terms(k), ..Params::default() };
    let pca = |model, k, codec| Params { model, rate: Rate::Terms(k), codec: Some(codec), ..Params::default() };
    let log = |delta| Some(Domain::Log { delta });
    let root = |delta| Some(Domain::Root { delta });
    let fixed = |model, codec| Params { model, codec: Some(codec), ..Params::default() };
    vec![
        ("thesis: log PCA, BC1, δ 0.001", pca(Model::LogPca, 16, Codec::Bc1)),
        ("log PCA, BC1, δ 0.01", Params { domain: log(1e-2), ..pca(Model::LogPca, 16, Codec::Bc1) }),
        ("log PCA, BC7, half the terms, δ 0.01", Params { domain: log(1e-2), ..pca(Model::LogPca, 8, Codec::Bc7) }),
        ("log PCA, BC6H, half the terms, δ 0.01", Params { domain: log(1e-2), ..pca(Model::LogPca, 8, Codec::Bc6h) }),
        ("linear PCA, BC1", pca(Model::LinearPca, 16, Codec::Bc1)),
        ("linear PCA, BC6H, half the terms", pca(Model::LinearPca, 8, Codec::Bc6h)),
        ("layers, open loop", Params { closed_loop: false, ..layers(16) }),
        ("layers (default)", layers(16)),
        ("layers, the same everywhere", Params { tiling: Tiling::Whole, ..layers(16) }),
        ("layers, background masked", Params { tiling: Tiling::Mask, ..layers(16) }),
        ("layers, log, δ 0.01", Params { domain: log(1e-2), ..layers(16) }),
        ("layers, log, δ 0.001", Params { domain: log(1e-3), ..layers(16) }),
        ("layers, root, δ 0.1", Params { domain: root(0.1), ..layers(16) }),
        ("layers, root, δ 1", Params { domain: root(1.0), ..layers(16) }),
        ("layers, PU21", Params { domain: Some(Domain::Pu21), ..layers(16) }),
        ("layers, display curve", Params { domain: Some(Domain::Display), ..layers(16) }),
        ("layers, colour counts half", Params { chroma: 0.5, ..layers(16) }),
        ("layers, colour counts twice", Params { chroma: 2.0, ..layers(16) }),
        ("layers, the last plane in 16 bits", Params { residual: 1, ..layers(16) }),
        ("layers, BC4 only", Params { codec: Some(Codec::Bc4), ..layers(16) }),
        ("layers, BC1 only", Params { codec: Some(Codec::Bc1), ..layers(16) }),
        ("layers, BC7, half the layers", Params { codec: Some(Codec::Bc7), ..layers(8) }),
        ("layers, BC6H, half the layers", Params { codec: Some(Codec::Bc6h), ..layers(8) }),
        ("layers, R8, half the layers", Params { codec: Some(Codec::R8), ..layers(8) }),
        ("PTM, RGB8", fixed(Model::Ptm, Codec::Rgb8)),
        ("HSH, RGB8", fixed(Model::Hsh, Codec::Rgb8)),
    ]
}

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        ["generate", dir, size, lights] => {
            let size = size.parse()?;
            Ok(simulate::write(Path::new(dir), (size, size), &simulate::lights(lights.parse()?))?)
        }
        ["table", dir, ref names @ ..] => table(Path::new(dir), names),
        ["speed", dir] => speed(Path::new(dir)),
        ["cost", dir] => cost(Path::new(dir)),
        ["held-out", dir] => held_out(Path::new(dir)),
        ["pca", dir] => decompose(Path::new(dir)),
        _ => bail!(
            "bench-field generate DIR SIZE LIGHTS | table DIR [NAME …] | held-out DIR | speed DIR | cost DIR | pca DIR"
        ),
    }
}

fn make(dir: &Path, params: &Params) -> anyhow::Result<(Field, Stack, f64)> {
    let start = Instant::now();
    let mut stack = Stack::open(dir, None)?;
    let field = compress(&mut stack, params, &|_| ())?;
    Ok((field, stack, start.elapsed().as_secs_f64()))
}

fn table(dir: &Path, names: &[&str]) -> anyhow::Result<()> {
    println!("| method | bytes a texel | RMS on a display | PSNR, dB | FLIP | RMS of ln | seconds |");
    println!("|---|--:|--:|--:|--:|--:|--:|");
    for (name, params) in rows().into_iter().filter(|(n, _)| names.is_empty() || names.iter().any(|x| n.contains(x))) {
        let (field, mut stack, secs) = match make(dir, &params) {
            Ok(made) => made,
            Err(e) => {
                println!("| {name} | | {e} |");
                continue;
            }
        };
        let errors = measure::compare(&field, &mut stack, &|| ())?;
        let mean = |f: &dyn Fn(&measure::PictureError) -> f64| errors.iter().map(f).sum::<f64>() / errors.len() as f64;
        println!(
            "| {name} | {:.2} | {:.5} | {:.2} | {:.4} | {:.4} | {secs:.1} |",
            field.texture_bytes() as f64 / (field.width * field.height) as f64,
            mean(&|e| e.rms * e.rms).sqrt(),
            mean(&|e| e.psnr),
            flip(&field, &stack)?,
            mean(&|e| e.log_rms * e.log_rms).sqrt()
        );
    }
    Ok(())
}

/// Mean FLIP on a display of eight pictures of the stack, as a viewer at the usual distance sees it.
fn flip(field: &Field, stack: &Stack) -> anyhow::Result<f64> {
    let relighter = Relighter::new(field)?;
    let n = stack.shots.len();
    let picked: Vec<usize> = (0..n.min(8)).map(|i| i * n / n.min(8)).collect();
    let ppd = translume_image::compare::CompareParams::default().ppd;
    let mut sum = 0.0;
    for &i in &picked {
        let mix = field.mix_of_light(i).unwrap_or_else(|| relighter.mix_of(&stack.shots[i]));
        let shown = |v: Vec<f32>, white: f32| v.into_iter().map(|v| measure::shown(v / white)).collect::<Vec<f32>>();
        let (truth, got) = (shown(stack.read(i)?, 1.0), shown(relighter.picture(&mix), field.white));
        sum += translume_image::metrics::flip_ldr(&truth, &got, stack.width, ppd).mean() / picked.len() as f64;
    }
    Ok(sum)
}

/// Frames a second of relighting with 16 layers, with and without exp and tone map to 8 bits.
fn speed(dir: &Path) -> anyhow::Result<()> {
    let (field, ..) = make(dir, &Params { rate: Rate::Terms(16), ..Params::default() })?;
    let relighter = Relighter::new(&field)?;
    let mixes: Vec<_> = simulate::lights(32).into_iter().filter(|l| l[2] > 0.0).map(|l| relighter.mix(l)).collect();
    let mut out = vec![[0u8; 4]; field.width * field.height];
    let first = mixes.first().context("no lights")?;
    relighter.display(first, 1.0, &mut out);
    let (start, before, mut frames) = (Instant::now(), cpu_secs(), 0);
    while start.elapsed().as_secs_f64() < 4.0 {
        relighter.display(&mixes[frames % mixes.len()], 1.0, &mut out);
        frames += 1;
    }
    let secs = start.elapsed().as_secs_f64();
    let cpu = match (before, cpu_secs()) {
        (Some(a), Some(b)) => format!(", {:.2} ms of processor time a frame", 1000.0 * (b - a) / frames as f64),
        _ => String::new(),
    };
    println!(
        "Relighting {} × {} with {} layers ({} planes), exp and tone map to 8 bits, {} threads: {:.1} frames/s{cpu}",
        field.width,
        field.height,
        field.layers.len(),
        field.planes(),
        rayon::current_num_threads(),
        frames as f64 / secs
    );
    Ok(())
}

/// What compressing takes, files included: seconds, processor time, the most memory held.
fn cost(dir: &Path) -> anyhow::Result<()> {
    let (field, stack, secs) = make(dir, &Params::default())?;
    let file = dir.join("field.glb");
    translume_field::file::write(&file, &field, "bench-field cost", None)?;
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|l| l.strip_prefix("VmHWM:")).map_or("unknown", str::trim);
    println!(
        "Compressing {} pictures of {} × {} ({:.0} MB of half floats) to {:.2} MB ({:.2} bytes a texel): {secs:.1} s, \
         {:.1} s of processor time, at most {peak} of memory",
        stack.shots.len(),
        field.width,
        field.height,
        (6 * stack.pixels() * stack.shots.len()) as f64 / 1e6,
        std::fs::metadata(&file)?.len() as f64 / 1e6,
        field.texture_bytes() as f64 / stack.pixels() as f64,
        cpu_secs().unwrap_or_default()
    );
    Ok(std::fs::remove_file(&file)?)
}

/// Processor time of this process so far, where the system tells it: what other work on the machine does not change.
fn cpu_secs() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
    let ticks: f64 = fields.next()?.parse::<f64>().ok()? + fields.next()?.parse::<f64>().ok()?;
    Some(ticks / 100.0)
}

/// Lanczos beside the randomised range finder: seconds, and the share of the energy of log light that 16 terms leave.
fn decompose(dir: &Path) -> anyhow::Result<()> {
    let mut stack = Stack::open(dir, None)?;
    let start = Instant::now();
    let matrix = Matrix::read(&mut stack, Domain::default(), usize::MAX, &|| ())?;
    println!("| read {} pictures, logarithm | {:.2} | |", matrix.lights, start.elapsed().as_secs_f64());
    let (gram, white) = pca::light_gram(&matrix, 1);
    let left = |v: &nalgebra::DMatrix<f64>| 1.0 - (v.transpose() * &gram * v).trace() / gram.trace();
    let start = Instant::now();
    let (again, _) = pca::light_gram(&matrix, 1);
    let lanczos = pca::lanczos(&again, &white, 16).0;
    println!("| translume, Lanczos from white | {:.2} | {:.4e} |", start.elapsed().as_secs_f64(), left(&lanczos));
    for power in [0, 1, 2] {
        let start = Instant::now();
        let found = pca::randomised_lights(&matrix, 16, power, 1);
        println!(
            "| translume, randomised, {power} power iterations | {:.2} | {:.4e} |",
            start.elapsed().as_secs_f64(),
            left(&found)
        );
    }
    Ok(())
}

/// Every fifth light is kept out, and predicted from the others.
fn held_out(dir: &Path) -> anyhow::Result<()> {
    let whole = Stack::open(dir, None)?;
    let part = |out: bool| {
        let shots = whole.shots.iter().enumerate().filter(|(i, _)| (i % 5 == 2) == out);
        shots.map(|(_, s)| s.clone()).collect::<Vec<_>>()
    };
    println!("| method | PSNR of {} lights kept out, dB |\n|---|--:|", part(true).len());
    let fixed = |model| Params { model, codec: Some(Codec::Rgb8), ..Params::default() };
    for (name, params) in [
        ("layers (default)", Params::default()),
        ("layers, the thesis' Gaussian", Params { gaussian: Some(true), ..Params::default() }),
        ("layers, root, δ 0.1", Params { domain: Some(Domain::Root { delta: 0.1 }), ..Params::default() }),
        ("layers, root, δ 1", Params { domain: Some(Domain::Root { delta: 1.0 }), ..Params::default() }),
        ("layers, log, δ 0.01", Params { domain: Some(Domain::Log { delta: 1e-2 }), ..Params::default() }),
        ("layers, log, δ 0.001", Params { domain: Some(Domain::Log { delta: 1e-3 }), ..Params::default() }),
        ("thesis: log PCA, BC1, Gaussian", Params { model: Model::LogPca, ..Params::default() }),
        ("PTM, RGB8", fixed(Model::Ptm)),
        ("HSH, RGB8", fixed(Model::Hsh)),
    ] {
        let mut stack = Stack::of(dir, part(false))?;
        stack.white = whole.white;
        match compress(&mut stack, &params, &|_| ()) {
            Ok(field) => {
                let mut rest = stack.clone();
                rest.shots = part(true);
                let errors = measure::compare(&field, &mut rest, &|| ())?;
                println!("| {name} | {:.2} |", errors.iter().map(|e| e.psnr).sum::<f64>() / errors.len() as f64);
            }
            Err(e) => println!("| {name} | {e} |"),
        }
    }
    Ok(())
}
