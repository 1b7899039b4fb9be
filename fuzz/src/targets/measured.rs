//! Measured data: fields, capture sets, models of scattering, their lights, sample lists.

use super::Said;
use crate::input::Input;
use std::path::Path;
use translume_field::{Field, Relighter, file, relightlab};
use translume_mesh::TriMesh;
use translume_scatter::SampleFile;
use translume_scatter::capture::Capture;
use translume_scatter::planar::PlanarCapture;
use translume_scatter::relight::{Lighting, Sources};
use translume_scatter::vertex::{MeshCapture, read_uniform_model};

/// A field and its picture under one light.
fn relit(field: &Field) {
    let relighter = Relighter::new(field).expect("a field that was read can be relit");
    let light = [0.6, 0.0, 0.8];
    let mix = if field.views().is_empty() { relighter.mix(light) } else { relighter.mix_seen(light, [0.0, 0.0, 1.0]) };
    let picture = relighter.picture(&mix);
    assert_eq!(picture.len(), 3 * field.width * field.height);
    assert!(picture.iter().all(|v| v.is_finite()), "a pixel is not finite");
}

pub(super) fn field(folder: &Path, input: &Input) -> Said {
    let Some((name, _)) = input.files.first() else { return Said { accepted: false, text: String::new() } };
    let field = file::read(&folder.join(name));
    field.iter().for_each(relit);
    Said::of(&field, |f| format!("{:?}", f.model))
}

pub(super) fn relightlab(folder: &Path, _: &Input) -> Said {
    let field = relightlab::import(folder);
    field.iter().for_each(relit);
    Said::of(&field, |f| format!("{:?}", f.model))
}

pub(super) fn capture(folder: &Path, _: &Input) -> Said {
    let capture = match Capture::open(folder) {
        Ok(capture) => capture,
        Err(e) => return Said { accepted: false, text: e.to_string() },
    };
    let [views, positions, channels, ..] = capture.frames.shape;
    let mut said = Said { accepted: true, text: String::new() };
    for view in 0..views.min(4) {
        for position in 0..positions.min(8) {
            for channel in 0..channels.min(3) {
                if let Err(e) = capture.frames.read(view, position, channel) {
                    said.text = e.to_string();
                }
            }
        }
    }
    // Rays for each pixel and position: larger ones take the time that they take.
    let [.., rows, columns] = capture.frames.shape;
    if views.saturating_mul(rows).saturating_mul(columns).saturating_mul(positions.max(1)) > 1 << 20 {
        return said;
    }
    match capture.is_flat() {
        true => said.and(Said::of(&PlanarCapture::new(capture, 4.0), |_| String::new())),
        false => said.and(Said::of(&MeshCapture::new(capture, 4.0), |_| String::new())),
    }
}

pub(super) fn model(folder: &Path, _: &Input) -> Said {
    let material = Said::of(&translume_scatter::material::load_material(folder), |_| String::new());
    let uniform = read_uniform_model(folder);
    if let Ok((_, _, mesh)) = &uniform {
        finite(mesh);
    }
    material.and(Said::of(&uniform, |_| String::new()))
}

fn finite(mesh: &TriMesh) {
    assert_eq!(mesh.fault(), None);
}

pub(super) fn lighting(folder: &Path, input: &Input) -> Said {
    let Some(name) = input.ending(".json") else { return Said { accepted: false, text: String::new() } };
    match Lighting::read(&folder.join(name)) {
        Ok(lighting) => Said::of(&Sources::new(&lighting.lights, folder), |_| String::new()),
        Err(e) => Said { accepted: false, text: e.to_string() },
    }
}

pub(super) fn samples(folder: &Path, input: &Input) -> Said {
    let Some((name, _)) = input.files.first() else { return Said { accepted: false, text: String::new() } };
    let mut file = match SampleFile::open(&folder.join(name)) {
        Ok(file) => file,
        Err(e) => return Said { accepted: false, text: e.to_string() },
    };
    let (mut block, mut points) = (Vec::new(), 0);
    loop {
        match file.read_points(7, &mut block) {
            Ok(0) => break,
            Ok(n) => {
                points += n;
                assert_eq!(block.len(), n * file.samples, "a block of {n} points");
            }
            Err(e) => return Said { accepted: false, text: e.to_string() },
        }
    }
    assert_eq!(points, file.points, "points that were read");
    Said { accepted: true, text: String::new() }
}
