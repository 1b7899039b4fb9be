//! A light stage without a renderer, for tests, benchmarks and the demo: two balls on a relief, HDR, with cast shadows and
//! sharp highlights. The left ball is a mirror-like metal, the right one velvet; the ground is matt with glossy stripes.

use crate::lights::{Shot, normalised, to_lp};
use crate::{Error, Result};
use rayon::prelude::*;
use std::path::Path;
use translume_image::{ExrOptions, Picture, Rgb32FImage, write_exr};

type V = [f32; 3];

fn dot(a: V, b: V) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn unit(a: V) -> V {
    normalised(a).unwrap_or([0.0, 0.0, 1.0])
}

/// `n` directions spread over the sphere down to 25° below the horizon, as a light stage has them.
pub fn lights(n: usize) -> Vec<V> {
    let light = |i: usize| {
        let z = 1.0 - 1.42 * (i as f32 + 0.5) / n as f32;
        let (sin, cos) = (2.399_963_2 * i as f32).sin_cos();
        let s = (1.0 - z * z).sqrt();
        [s * cos, s * sin, z]
    };
    (0..n).map(light).collect()
}

/// Centre and radius.
const BALLS: [(V, f32); 2] = [([-0.42, 0.1, 0.38], 0.36), ([0.45, -0.05, 0.34], 0.33)];

/// What a ray sees.
struct Hit {
    p: V,
    n: V,
    kind: usize,
}

/// Along −z, from above.
fn see(x: f32, y: f32) -> Hit {
    for (kind, (c, r)) in BALLS.iter().enumerate() {
        let d2 = (x - c[0]).powi(2) + (y - c[1]).powi(2);
        if d2 < r * r {
            let p = [x, y, c[2] + (r * r - d2).sqrt()];
            return Hit { p, n: unit([p[0] - c[0], p[1] - c[1], p[2] - c[2]]), kind };
        }
    }
    let n = unit([0.3 * (14.0 * x).sin() * (9.0 * y).cos(), 0.3 * (11.0 * y + 3.0 * x).cos(), 1.0]);
    Hit { p: [x, y, 0.0], n, kind: 2 }
}

fn hidden(p: V, l: V) -> bool {
    BALLS.iter().any(|(c, r)| {
        let m = [0, 1, 2].map(|i| p[i] - c[i]);
        let (b, e) = (dot(m, l), dot(m, m) - r * r);
        // Outside the ball and heading into it.
        e > 1e-4 && b < 0.0 && b * b > e
    }) || (l[2] < 0.0 && p[2] <= 1e-4)
}

fn shade(hit: &Hit, l: V) -> V {
    let cos = dot(hit.n, l);
    if cos <= 0.0 || hidden(hit.p, l) {
        return [0.0; 3];
    }
    let h = unit([l[0], l[1], l[2] + 1.0]);
    let nh = dot(hit.n, h).max(0.0);
    let pattern = 0.5 + 0.5 * (37.0 * hit.p[0]).sin() * (29.0 * hit.p[1]).sin();
    match hit.kind {
        // A narrow lobe, and a broad one under it.
        0 => [0.9, 0.75, 0.5].map(|c| c * (120.0 * nh.powi(900) + 1.5 * nh.powi(20)) * cos + 0.01 * cos),
        1 => [0.5, 0.1, 0.25].map(|c| c * (0.25 * cos + 0.8 * (1.0 - hit.n[2]).powi(3) * cos.sqrt())),
        _ => {
            let gloss = if (9.0 * hit.p[1]).sin() > 0.3 { 25.0 * nh.powi(200) } else { 0.0 };
            [0.25 + 0.4 * pattern, 0.3, 0.45 - 0.35 * pattern].map(|c| c * cos + gloss * cos)
        }
    }
}

/// The scene of `width × height` pixels, two units across, under one light.
pub fn picture((width, height): (u32, u32), light: V) -> Rgb32FImage {
    let at = |v: u32, size: u32| (2.0 * v as f32 + 1.0 - size as f32) / width as f32;
    let mut pixels = Rgb32FImage::new(width, height);
    pixels.par_chunks_mut(3 * width as usize).enumerate().for_each(|(y, row)| {
        for (x, p) in row.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            *p = shade(&see(at(x as u32, width), -at(y as u32, height)), light);
        }
    });
    pixels
}

/// Writes a picture under each of `lights` into `dir` as half-float OpenEXR, and their list, `lights.lp`.
///
/// # Errors
/// [`Error::Io`], [`Error::Picture`].
pub fn write(dir: &Path, size: (u32, u32), lights: &[V]) -> Result<()> {
    std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, e))?;
    let shot = |(i, light): (usize, &V)| Shot::new(dir.join(format!("l{i:03}.exr")), *light);
    let shots: Vec<Shot> = lights.iter().enumerate().map(shot).collect();
    for s in &shots {
        write_exr(&s.path, &Picture::new(picture(size, s.light)), &ExrOptions::default())?;
    }
    Ok(translume_image::atomic::write_bytes(&dir.join("lights.lp"), to_lp(&shots, dir).as_bytes())?)
}
