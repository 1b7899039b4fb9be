//! A gain for each frame of an object, where the laser's power drifts.
//!
//! As on flat samples, transport is reciprocal: what the beam at i sends to the place of j is what the beam at j sends to the place of i. Here
//! each may be seen by several cameras at several times, and the frames of one position that different cameras took show the same
//! places equally bright (R_d is the same for all directions). So for frames (i, v) and (j, w), of which v sees j and w sees i,
//! ln g_iv − ln g_jw = ln s_v(i → j) − ln s_w(j → i), and for frames of one position ln g_iv − ln g_iw = ln s_v(i → j) − ln s_w(i → j).
//!
//! A beam that meets the surface obliquely sends its light on in its direction before it is scattered, so that more of it gets to places
//! ahead than comes back from them. That looks like a laser that grows stronger from place to place along its beams. How such a
//! field looks is known, (d_i + d_j) · u for pairs in the direction u, though not how strong it is; it is taken out of the gains.

use super::samples::{MeshCapture, Pixel};
use crate::capture::{dot, norm, normalize, sub};
use crate::gains::{PAIRS, SEEN, solve};
use rayon::prelude::*;
use std::f64::consts::TAU;
use translume_image::Result;

/// Places that are lit at a smaller cosine are not compared: light goes far before it is scattered.
const LEAST_COS: f64 = 0.5;
/// A view sees a place of which it sees this share of the beam's profile: with less it would see light farther or nearer than it is.
const WHOLE: f64 = 0.8;

/// For each beam the pixels of a view that its light would fall on, and the beam's profile on the area there; none where the view does not see it.
type Footprints = Vec<Vec<(u32, f64)>>;
/// What a frame shows at the places of other beams.
type Received = Vec<(usize, f64)>;
/// For each frame its partners and a difference to them.
type Differences = Vec<Vec<(usize, f64)>>;

/// Gains for each beam, each of its views and each channel; 1 where a frame has no partners.
///
/// # Errors
/// Those of reading frames.
pub fn estimate_gains(mesh: &MeshCapture) -> Result<Vec<Vec<Vec<f64>>>> {
    let [views, _, channels, ..] = mesh.capture.frames.shape;
    let footprints: Vec<Footprints> = (0..views).into_par_iter().map(|v| footprints(mesh, v)).collect();
    let mut gains: Vec<Vec<Vec<f64>>> = mesh.views.iter().map(|v| vec![vec![1.0; channels]; v.len()]).collect();
    for channel in 0..channels {
        let of_beam = |beam: usize| -> Result<Vec<Received>> {
            mesh.views[beam].iter().map(|&v| received(mesh, &footprints[v], beam, v, channel)).collect()
        };
        let received: Vec<Vec<Received>> = (0..mesh.beams.len()).into_par_iter().map(of_beam).collect::<Result<_>>()?;
        let (ratios, ahead) = pairs(mesh, &received);
        let (mut found, field) = (solve(&ratios), solve(&ahead));
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let strength = product(&found, &field) / product(&field, &field).max(1e-12);
        found.iter_mut().zip(&field).for_each(|(ln, f)| *ln -= strength * f);
        gains.iter_mut().flatten().zip(found).for_each(|(gain, ln)| gain[channel] = ln.exp());
    }
    Ok(gains)
}

fn footprints(mesh: &MeshCapture, view: usize) -> Footprints {
    let camera = &mesh.capture.rig.views[view].camera;
    let diameter = mesh.capture.rig.laser.beam_diameter_mm;
    let of = |beam: &super::Beam| -> Vec<(u32, f64)> {
        let at = beam.at;
        let origin = mesh.capture.rig.laser.origin(beam.position);
        let direction = normalize(sub(at, origin));
        let Some(px) = camera.project(at).filter(|_| beam.cos >= LEAST_COS) else { return Vec::new() };
        let pixel_mm = norm(sub(camera.eye(), at)) / camera.focal_px;
        let inside = |x: f64, n: usize| (0.0..n as f64).contains(&x);
        if !(inside(px[0], camera.width) && inside(px[1], camera.height)) {
            return Vec::new();
        }
        let near = |p: &Pixel| norm(sub(p.at, at)) <= diameter.max(2.0 * pixel_mm);
        // The pixel that the place falls into must show it, or something hides it.
        let own = px[1] as usize * camera.width + px[0] as usize;
        if !mesh.pixels[view][own].as_ref().is_some_and(near) {
            return Vec::new();
        }
        let sigma = diameter / 4.0;
        let reach = diameter / pixel_mm + 1.0;
        let span = |c: f64, n: usize| (c - reach).max(0.0) as usize..((c + reach) as usize + 1).min(n);
        let mut found = Vec::new();
        for i in span(px[1], camera.height).flat_map(|y| span(px[0], camera.width).map(move |x| y * camera.width + x)) {
            let Some(pixel) = mesh.pixels[view][i].as_ref().filter(|p| near(p)) else { continue };
            let d = sub(pixel.at, at);
            let along = dot(d, direction);
            let across = (dot(d, d) - along * along).max(0.0);
            let profile = (-0.5 * across / sigma.powi(2)).exp();
            if profile > 1e-3 {
                found.push((i as u32, profile * pixel_mm * pixel_mm / f64::from(pixel.cos)));
            }
        }
        let sum: f64 = found.iter().map(|f| f.1).sum();
        match sum * beam.cos < WHOLE * TAU * sigma * sigma {
            true => Vec::new(),
            false => found,
        }
    };
    mesh.beams.iter().map(of).collect()
}

/// What a frame shows at the places of other beams that are near: their numbers, and the mean logarithm of R_d under their profile.
fn received(mesh: &MeshCapture, footprints: &Footprints, from: usize, view: usize, channel: usize) -> Result<Received> {
    let values = mesh.reflectance(from, view, channel)?;
    let diameter = mesh.capture.rig.laser.beam_diameter_mm;
    let near = |to: &usize| {
        let distance = norm(sub(mesh.beams[*to].at, mesh.beams[from].at));
        (PAIRS.0..=PAIRS.1).contains(&(distance / diameter))
    };
    let under = |to: usize| {
        let (mut sum, mut seen, mut all) = (0.0, 0.0, 0.0);
        for &(pixel, weight) in &footprints[to] {
            let value = f64::from(values[pixel as usize]);
            all += weight;
            if value > 0.0 {
                (sum, seen) = (sum + weight * value.ln(), seen + weight);
            }
        }
        (seen > 0.0 && seen >= SEEN * all).then(|| (to, sum / seen))
    };
    Ok((0..mesh.beams.len()).filter(near).filter_map(under).collect())
}

/// For each frame, beam after beam, its partners with the logarithm of its ratio to them, and with how far ahead of it they lie.
fn pairs(mesh: &MeshCapture, received: &[Vec<Received>]) -> (Differences, Differences) {
    let mut first = vec![0];
    received.iter().for_each(|r| first.push(first[first.len() - 1] + r.len()));
    let direction = |beam: usize| {
        let beam = &mesh.beams[beam];
        normalize(sub(beam.at, mesh.capture.rig.laser.origin(beam.position)))
    };
    let ahead = |from: usize, to: usize| {
        let u = normalize(sub(mesh.beams[to].at, mesh.beams[from].at));
        dot(direction(from), u) + dot(direction(to), u)
    };
    let of = |(beam, own): (usize, usize)| {
        let there = &received[beam][own];
        let value = |r: &Received, to: usize| r.iter().find(|(j, _)| *j == to).map(|v| v.1);
        let (mut ratios, mut fields) = (Vec::new(), Vec::new());
        for &(to, sent) in there {
            for (k, r) in received[to].iter().enumerate() {
                if let Some(back) = value(r, beam) {
                    ratios.push((first[to] + k, sent - back));
                    fields.push((first[to] + k, ahead(beam, to)));
                }
            }
            for (k, r) in received[beam].iter().enumerate().filter(|(k, _)| *k != own) {
                if let Some(beside) = value(r, to) {
                    ratios.push((first[beam] + k, sent - beside));
                    fields.push((first[beam] + k, 0.0));
                }
            }
        }
        (ratios, fields)
    };
    let frames: Vec<(usize, usize)> =
        received.iter().enumerate().flat_map(|(beam, r)| (0..r.len()).map(move |k| (beam, k))).collect();
    frames.into_par_iter().map(of).unzip()
}
