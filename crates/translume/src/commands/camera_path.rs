//! `translume render --camera-path`: views along a curve through given ones.
//!
//! Catmull–Rom through the keys' origins, targets and up vectors, evenly in the keys' numbers; fields of view linearly.

use anyhow::{Context as _, anyhow};
use glam::DVec3;
use serde::Deserialize;
use std::path::{Path, PathBuf};
use translume_scene::sensor::{Projection, Sensor, look_at};

/// The file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    /// Pictures; as many as keys if it is not said.
    frames: Option<usize>,
    keys: Vec<Key>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Key {
    origin: [f64; 3],
    target: [f64; 3],
    /// The scene's camera's if it is not said.
    up: Option<[f64; 3]>,
    /// Degrees, along the scene's camera's axis.
    fov: Option<f32>,
}

/// More pictures than anybody wants at once.
const MOST_FRAMES: usize = 100_000;

/// The camera `sensor` of the scene in every place of the path in the file `path`.
pub(crate) fn read(path: &Path, sensor: &Sensor) -> anyhow::Result<Vec<Sensor>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let file: File = serde_json::from_str(&text).map_err(|e| anyhow!("{}: {e}", path.display()))?;
    let frames = file.frames.unwrap_or(file.keys.len());
    if file.keys.is_empty() || frames == 0 || frames > MOST_FRAMES {
        return Err(anyhow!("{}: one key at least is wanted, and 1 to {MOST_FRAMES} frames", path.display()));
    }
    let last = (file.keys.len() - 1) as f64;
    let place = |frame: usize| if frames > 1 { last * frame as f64 / (frames - 1) as f64 } else { 0.0 };
    (0..frames)
        .map(|f| {
            view(&file.keys, place(f), sensor)
                .ok_or_else(|| anyhow!("{}: frame {f} looks nowhere, or along its up vector", path.display()))
        })
        .collect()
}

/// The camera at `at` of the keys' numbers.
fn view(keys: &[Key], at: f64, sensor: &Sensor) -> Option<Sensor> {
    let i = (at as usize).min(keys.len().saturating_sub(2));
    let t = at - i as f64;
    let key = |offset: isize| &keys[i.saturating_add_signed(offset).min(keys.len() - 1)];
    let own_up = sensor.world_from_camera.transform_vector3(DVec3::Y);
    let curve = |of: &dyn Fn(&Key) -> DVec3| {
        let [a, b, c, d] = [-1, 0, 1, 2].map(|k| of(key(k)));
        // Ends go straight on.
        let a = if i == 0 { 2.0 * b - c } else { a };
        let d = if i + 2 >= keys.len() { 2.0 * c - b } else { d };
        b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)))
    };
    let origin = curve(&|k| DVec3::from(k.origin));
    let target = curve(&|k| DVec3::from(k.target));
    let up = curve(&|k| k.up.map_or(own_up, DVec3::from));
    let mut view = Sensor { world_from_camera: look_at(origin, target, up)?, ..sensor.clone() };
    if let Projection::Perspective(p) | Projection::ThinLens { perspective: p, .. } = &mut view.projection {
        let fov = |k: &Key| k.fov.map_or(p.fov, f32::to_radians);
        p.fov = fov(key(0)) + t as f32 * (fov(key(1)) - fov(key(0)));
    }
    Some(view)
}

/// The name of frame `number` of `frames`: `walk.exr` becomes `walk-0012.exr`.
pub(crate) fn frame_name(path: &Path, number: usize) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}-{number:04}.{extension}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use translume_scene::sensor::{Film, Perspective, PixelFilter};

    fn sensor() -> Sensor {
        Sensor {
            name: String::new(),
            world_from_camera: look_at(DVec3::ZERO, DVec3::X, DVec3::Z).unwrap(),
            projection: Projection::Perspective(Perspective {
                fov: 1.0,
                fov_axis: Default::default(),
                principal_point_offset: [0.0; 2],
            }),
            near_clip: 1e-3,
            far_clip: 1e6,
            film: Film { size: [8, 8], crop: None, filter: PixelFilter::Box { radius: 0.5 } },
            sample_count: None,
            medium: None,
        }
    }

    fn key(x: f64) -> Key {
        Key { origin: [x, 0.0, 0.0], target: [x, 1.0, 0.0], up: None, fov: None }
    }

    #[test]
    fn keys_are_met_and_straight_ways_are_straight() {
        let keys = [key(0.0), key(1.0), key(2.0), key(3.0)];
        for at in [0.0, 0.25, 1.0, 1.5, 2.9, 3.0] {
            let place = view(&keys, at, &sensor()).unwrap().world_from_camera.translation;
            assert!((place - DVec3::new(at, 0.0, 0.0)).length() < 1e-12, "{at}: {place}");
        }
        let bent = [key(0.0), key(5.0), key(-3.0)];
        for (i, k) in bent.iter().enumerate() {
            let place = view(&bent, i as f64, &sensor()).unwrap().world_from_camera.translation;
            assert!((place - DVec3::from(k.origin)).length() < 1e-12);
        }
        assert!(view(&[Key { target: [0.0; 3], ..key(0.0) }], 0.0, &sensor()).is_none());
    }
}
