//! Frames of 768 × 496 resampled per second, from 16-bit floats without compression and from 32-bit floats with gzip.

use crate::row;
use crate::shape::bumpy;
use half::f16;
use serde_json::json;
use std::path::Path;
use std::time::Instant;
use translume_scatter::capture::{Camera, Capture, Channel, Laser, Rig, View};
use translume_scatter::hierarchical::{AtlasParams, Stage, resample};

const WIDTH: usize = 768;
const HEIGHT: usize = 496;
const CAMERAS: usize = 3;
const POSITIONS: usize = 60;

pub(crate) fn run() -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    for (name, half) in [("float16, no compression", true), ("float32, gzip", false)] {
        let path = folder.path().join(if half { "half" } else { "gzip" });
        let bytes = write(&path, half)?;
        let mut stage = Stage::new(Capture::open(&path)?, 4.0, &AtlasParams::default())?;
        let (begin, cpu) = (Instant::now(), crate::cpu_seconds());
        let (_, kernels) = resample(&mut stage, || ())?;
        let seconds = begin.elapsed().as_secs_f64();
        let frames = (stage.positions() * CAMERAS * 3) as f64;
        row(
            &format!("resampling, 8846 vertices, {name}"),
            format!(
                "{:.0} frames/s, {:.0} MB/s of files; {:.0} frames per second of a processor ({frames} frames, {} kernels)",
                frames / seconds,
                bytes as f64 / seconds / 1e6,
                frames / (crate::cpu_seconds() - cpu),
                kernels.measured()
            ),
        );
    }
    Ok(())
}

/// A capture whose frames are a spot and its glow; the bytes of its frames.
fn write(path: &Path, half: bool) -> anyhow::Result<u64> {
    let mesh = bumpy(67);
    let camera = |i: usize| {
        let angle = 0.5 * (i as f64 - 1.0);
        let eye = [600.0 * angle.cos(), 600.0 * angle.sin(), 150.0];
        Camera::looking_at(eye, [0.0; 3], [0.0, 0.0, 1.0], (WIDTH, HEIGHT), 150.0)
    };
    let cameras: Vec<Camera> = (0..CAMERAS).map(camera).collect();
    let origin = [900.0, 0.0, 0.0];
    let hits: Vec<[f64; 3]> =
        (0..POSITIONS).map(|i| [0.0, (i % 10) as f64 * 4.0 - 18.0, (i / 10) as f64 * 4.0 - 10.0]).collect();
    let channel =
        |name: &str| Channel { name: name.into(), wavelength_nm: Some(550.0), white_balance: 1.0, noise_floor: 1e-6 };
    let rig = Rig {
        provenance: json!({ "synthetic": true }),
        ..Rig::new(
            1.3,
            ["red", "green", "blue"].map(channel).to_vec(),
            cameras.iter().map(|c| View { turntable_deg: 0.0, camera: c.clone() }).collect(),
            Laser {
                origin_mm: origin,
                origins_mm: Vec::new(),
                beam_diameter_mm: 2.0,
                power: vec![1.0; 3],
                grid: [10, POSITIONS / 10],
                hits_mm: hits.clone(),
            },
        )
    };
    let capture = Capture::create(path, rig, mesh)?;
    if half {
        describe_half(&path.join("frames/zarr.json"), capture.frames.shape)?;
    }
    let surface = translume_scatter::capture::Surface::new(capture.mesh.clone()).expect("small enough");
    let mut bytes = 0;
    for (position, hit) in hits.iter().enumerate() {
        let from = glam::DVec3::from_array(origin);
        let toward = glam::DVec3::from_array(*hit) - from;
        let place = surface.first(from.as_vec3(), toward.normalize().as_vec3()).expect("it hits");
        for (view, camera) in cameras.iter().enumerate() {
            let spot = camera.project(place.at).expect("in front");
            let value = |i: usize| {
                let (x, y) = ((i % WIDTH) as f64 + 0.5 - spot[0], (i / WIDTH) as f64 + 0.5 - spot[1]);
                // Some grain, which compression does not like.
                let grain = 1.0 + 0.02 * ((i * 7919) % 257) as f64 / 257.0;
                ((0.05 * (-x.hypot(y) / 6.0).exp() + 2e-4 * (-x.hypot(y) / 90.0).exp()) * grain) as f32
            };
            let frame: Vec<f32> = (0..WIDTH * HEIGHT).map(value).collect();
            for channel in 0..3 {
                let file = path.join(format!("frames/c/{view}/{position}/{channel}/0/0"));
                match half {
                    true => {
                        std::fs::create_dir_all(file.parent().expect("it has one"))?;
                        std::fs::write(
                            &file,
                            frame.iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()).collect::<Vec<u8>>(),
                        )?;
                    }
                    false => capture.frames.write([view, position, channel], &frame)?,
                }
                bytes += std::fs::metadata(&file)?.len();
            }
        }
    }
    Ok(bytes)
}

/// The same array in half precision without compression; [`Capture::create`] makes the default.
fn describe_half(file: &Path, shape: [usize; 5]) -> anyhow::Result<()> {
    let mut meta: serde_json::Value = serde_json::from_slice(&std::fs::read(file)?)?;
    meta["data_type"] = json!("float16");
    meta["codecs"] = json!([{ "name": "bytes", "configuration": { "endian": "little" } }]);
    meta["shape"] = json!(shape);
    Ok(std::fs::write(file, format!("{meta:#}\n"))?)
}
