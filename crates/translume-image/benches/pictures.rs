//! One megapixel through files, tone mapping and metrics. `cargo bench -p translume-image`.

use divan::{Bencher, black_box};
use image::{Rgb, Rgb32FImage};
use std::path::PathBuf;
use std::sync::LazyLock;
use translume_image::tonemap::{FattalParams, ReinhardParams, exposure_gamma, fattal, reinhard_global};
use translume_image::*;

fn main() {
    divan::main();
}

const SIZE: (u32, u32) = (1152, 864);

/// A smooth scene of twelve stops with fine texture.
static SCENE: LazyLock<Picture> = LazyLock::new(|| {
    Picture::new(Rgb32FImage::from_fn(SIZE.0, SIZE.1, |x, y| {
        let (u, v) = (x as f32 / 100.0, y as f32 / 80.0);
        let texture = ((x * 7919 + y * 104_729) % 1009) as f32 / 1009.0;
        let stops = 6.0 * (u + v.cos()).sin() + 0.1 * texture;
        Rgb([stops.exp2(), (stops + 0.3).exp2(), (stops + 0.6 * v.sin()).exp2()])
    }))
});

/// The scene in a folder, once in each format.
static FILES: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| dir.path().join(name);
    let shown = exposure_gamma(&SCENE, -2.0, None);
    let size = (shown.width, shown.height);
    write_png8(&at("8.png"), size, &shown.to_u8()).expect("written");
    write_png16(&at("16.png"), size, &shown.to_u16()).expect("written");
    write_tiff_float(&at("float.tif"), &SCENE).expect("written");
    write_hdr(&at("rgbe.hdr"), &SCENE).expect("written");
    write_exr(&at("half.exr"), &SCENE, &ExrOptions::default()).expect("written");
    dir
});

fn file(name: &str) -> PathBuf {
    FILES.path().join(name)
}

#[divan::bench(args = ["8.png", "16.png", "float.tif", "rgbe.hdr", "half.exr"])]
fn read(bencher: Bencher<'_, '_>, name: &str) {
    let path = file(name);
    bencher.bench_local(|| read_codes(black_box(&path)).expect("read"));
}

#[divan::bench]
fn read_linear_8_png(bencher: Bencher<'_, '_>) {
    let path = file("8.png");
    bencher.bench_local(|| read_picture(black_box(&path)).expect("read"));
}

#[divan::bench(args = [false, true])]
fn write_exr_zip(bencher: Bencher<'_, '_>, float: bool) {
    let path = file(if float { "out-float.exr" } else { "out-half.exr" });
    let precision = if float { Precision::Float } else { Precision::Half };
    let options = ExrOptions { precision, ..ExrOptions::default() };
    bencher.bench_local(|| write_exr(&path, black_box(&SCENE), &options).expect("written"));
}

#[divan::bench]
fn tonemap_reinhard() -> tonemap::Display {
    reinhard_global(black_box(&SCENE), &ReinhardParams::default())
}

#[divan::bench]
fn tonemap_fattal() -> tonemap::Display {
    fattal(black_box(&SCENE), &FattalParams::default())
}

/// The scene, and the same 3 % brighter.
fn pair() -> (Vec<f32>, Vec<f32>) {
    let a = SCENE.pixels.as_raw().clone();
    let b = a.iter().map(|v| v * 1.03).collect();
    (a, b)
}

#[divan::bench(args = ["rmse", "psnr-mu", "pu21", "ssim", "delta-e", "flip-ldr", "flip-hdr"], sample_count = 10)]
fn metric(bencher: Bencher<'_, '_>, name: &str) {
    let (a, b) = pair();
    let (width, ppd) = (SIZE.0 as usize, metrics::flip_ppd(0.7, 0.7, 3840.0));
    bencher.bench_local(|| match name {
        "rmse" => metrics::rmse(&a, &b),
        "psnr-mu" => metrics::psnr_mu(&a, &b, metrics::top_percentile(&a)),
        "pu21" => metrics::pu21_psnr(&a, &b, 100.0),
        "ssim" => metrics::ssim(&a, &b, width, 1.0),
        "delta-e" => f64::from(metrics::delta_e_2000_map(&a, &b)[0]),
        "flip-ldr" => metrics::flip_ldr(&a, &b, width, ppd).mean(),
        _ => metrics::flip_hdr(&a, &b, width, ppd).mean(),
    });
}
