//! Light that is no single direction: discs and environment maps, as lists of directions with colours.
//!
//! A light of the stack is taken to light a surface that faces it with an irradiance of π, so that white paper shows as
//! 1, and so that an environment of radiance 1 all around shows it as 1 too.

use crate::lights::normalised;
use crate::sphere::{points, spacing};
use translume_image::colour::Space;

/// A direction and a colour; 1 is a light of the stack.
pub type DirectionalLight = ([f32; 3], [f32; 3]);

/// A round light of `diameter` radians about `direction`, its `colour` shared out over directions of equal solid angle.
pub fn disc(direction: [f32; 3], diameter: f32, colour: [f32; 3]) -> Vec<DirectionalLight> {
    if diameter <= 0.0 {
        return vec![(direction, colour)];
    }
    // One for every two degrees across.
    let across = diameter.to_degrees() / 2.0;
    let n = ((across * across) as usize).clamp(16, 1024);
    let (t, b) = frame(direction);
    let lowest = (diameter / 2.0).cos();
    let share = colour.map(|c| c / n as f32);
    let sample = |i: usize| {
        // Equal steps of the cosine are equal solid angles.
        let cos = 1.0 - (1.0 - lowest) * (i as f32 + 0.5) / n as f32;
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        let (y, x) = (2.399_963_2 * i as f32).sin_cos();
        ([0, 1, 2].map(|c| cos * direction[c] + sin * (x * t[c] + y * b[c])), share)
    };
    (0..n).map(sample).collect()
}

/// Two unit vectors across `n`.
fn frame(n: [f32; 3]) -> ([f32; 3], [f32; 3]) {
    let cross =
        |a: [f32; 3], b: [f32; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let other = if n[0].abs() < 0.7 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let t = normalised(cross(n, other)).unwrap_or([0.0, 0.0, 1.0]);
    (t, cross(n, t))
}

/// An environment map as lights of a field.
#[derive(Clone, Debug)]
pub struct Environment {
    /// Directions and colours.
    pub lights: Vec<DirectionalLight>,
    /// Share of the map's light that comes from where the stack has no lights and was left out.
    pub beyond: f32,
}

/// Cells along the edge of a cube's face that the map is gathered in.
const CELLS: usize = 16;

/// The direction that the pixel at (u, v) in [0, 1]² of a map looks at: the centre is behind the camera (+z), the upper edge
/// is up, and u runs as an eye in the object sees it, from +x at the left of the centre to −x at its right.
fn map_direction(u: f32, v: f32) -> [f32; 3] {
    let (sin_t, cos_t) = (v * std::f32::consts::PI).sin_cos();
    let (sin_p, cos_p) = ((u - 0.5) * std::f32::consts::TAU).sin_cos();
    [-sin_t * sin_p, cos_t, sin_t * cos_p]
}

/// Gathers a longitude-latitude map (interleaved RGB) in some 1500 cells, each one light in the direction of its
/// brightest part. Light from farther than two spacings beyond the stack's `lights` is left out; without lights (PTM,
/// HSH), that from below the horizon.
pub fn from_map(rgb: &[f32], (w, h): (usize, usize), lights: &[[f32; 3]]) -> Environment {
    let y = Space::REC709.luminance_weights().map(|v| v as f32);
    // By cell: colour, direction times luminance.
    let mut cells = vec![([0.0f64; 3], [0.0f64; 3]); 6 * CELLS * CELLS];
    for (row, line) in rgb.chunks(3 * w).enumerate() {
        let v = (row as f32 + 0.5) / h as f32;
        let area = std::f32::consts::TAU / w as f32
            * ((row as f32 / h as f32 * std::f32::consts::PI).cos()
                - ((row + 1) as f32 / h as f32 * std::f32::consts::PI).cos());
        for (column, p) in line.as_chunks::<3>().0.iter().enumerate() {
            let d = map_direction((column as f32 + 0.5) / w as f32, v);
            let colour = p.map(|x| x.max(0.0) * area / std::f32::consts::PI);
            let luminance: f32 = (0..3).map(|c| y[c] * colour[c]).sum();
            let cell = &mut cells[cell(d)];
            for c in 0..3 {
                cell.0[c] += f64::from(colour[c]);
                cell.1[c] += f64::from(luminance * d[c]);
            }
        }
    }
    // Each direction once: with several views, pictures share their lights.
    let mut distinct = points(lights, &[]);
    distinct.sort_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
    distinct.dedup();
    let reach = 2.0 * spacing(&distinct);
    let within = |d: [f32; 3]| match lights {
        [] => d[2] > 0.0,
        _ => lights.iter().any(|l| (0..3).map(|c| (l[c] - d[c]).powi(2)).sum::<f32>() <= reach * reach),
    };
    let (mut kept, mut all, mut left_out) = (Vec::new(), 0.0f32, 0.0f32);
    for (colour, direction) in &cells {
        let colour = colour.map(|v| v as f32);
        let luminance: f32 = (0..3).map(|c| y[c] * colour[c]).sum();
        // A cell whose light has no luminance has no direction and no effect.
        let Some(direction) = normalised_64(*direction) else { continue };
        all += luminance;
        if within(direction) {
            kept.push((direction, colour));
        } else {
            left_out += luminance;
        }
    }
    Environment { lights: kept, beyond: if all > 0.0 { left_out / all } else { 0.0 } }
}

fn normalised_64(v: [f64; 3]) -> Option<[f32; 3]> {
    let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    (length > 0.0).then(|| v.map(|x| (x / length) as f32))
}

fn cell(d: [f32; 3]) -> usize {
    let axis = (0..3).max_by(|&a, &b| d[a].abs().total_cmp(&d[b].abs())).unwrap_or(0);
    let face = 2 * axis + usize::from(d[axis] < 0.0);
    let at = |v: f32| (((v / d[axis].abs()) * 0.5 + 0.5) * CELLS as f32).clamp(0.0, CELLS as f32 - 1.0) as usize;
    (face * CELLS + at(d[(axis + 1) % 3])) * CELLS + at(d[(axis + 2) % 3])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_even_environment_lights_white_paper_to_one() {
        let found = from_map(&[0.8; 3 * 64 * 32], (64, 32), &[]);
        // Paper facing z: Σ colour · cosine.
        let shown: f32 = found.lights.iter().map(|(d, c)| c[1] * d[2].max(0.0)).sum();
        assert!((shown - 0.8).abs() < 0.01, "{shown}");
        assert!((found.beyond - 0.5).abs() < 0.01, "{}", found.beyond);
    }

    #[test]
    fn a_map_is_oriented_as_documented() {
        for (u, v, expected) in [
            (0.5, 0.5, [0.0, 0.0, 1.0]),
            (0.25, 0.5, [1.0, 0.0, 0.0]),
            (0.75, 0.5, [-1.0, 0.0, 0.0]),
            (0.3, 0.0, [0.0, 1.0, 0.0]),
        ] {
            assert!((0..3).all(|c| (map_direction(u, v)[c] - expected[c]).abs() < 1e-6), "{u} {v}");
        }
        // One bright pixel is one light where it is.
        let mut map = vec![0.0; 3 * 200 * 100];
        map[3 * (30 * 200 + 120)] = 5.0;
        let found = from_map(&map, (200, 100), &[]);
        let bright = map_direction(120.5 / 200.0, 30.5 / 100.0);
        assert_eq!(found.lights.len(), 1);
        assert!((0..3).all(|c| (found.lights[0].0[c] - bright[c]).abs() < 1e-5));
    }

    #[test]
    fn light_from_beyond_the_stack_is_left_out_and_counted() {
        let lights: Vec<[f32; 3]> = (0..8)
            .map(|i| {
                let (sin, cos) = (i as f32 * 0.785).sin_cos();
                [0.3 * cos, 0.3 * sin, 0.954]
            })
            .collect();
        let found = from_map(&[1.0; 3 * 64 * 32], (64, 32), &lights);
        assert!(found.beyond > 0.6 && found.lights.iter().all(|(d, _)| d[2] > 0.5), "{}", found.beyond);
    }

    #[test]
    fn a_disc_keeps_its_colour_its_centre_and_its_size() {
        let towards = normalised([0.3, -0.5, 0.8]).unwrap();
        let lights = disc(towards, 0.4, [1.0, 2.0, 3.0]);
        let green: f32 = lights.iter().map(|l| l.1[1]).sum();
        assert!((green - 2.0).abs() < 1e-3, "{green}");
        let cosines: Vec<f32> = lights.iter().map(|l| (0..3).map(|c| l.0[c] * towards[c]).sum()).collect();
        assert!(cosines.iter().all(|c| *c >= 0.2f32.cos() - 1e-5));
        // The mean of an even spherical cap.
        let mean = cosines.iter().sum::<f32>() / cosines.len() as f32;
        assert!((mean - (1.0 + 0.2f32.cos()) / 2.0).abs() < 1e-4, "{mean}");
        let centre: [f32; 3] =
            [0, 1, 2].map(|c| lights.iter().map(|l| l.0[c]).sum::<f32>() / lights.len() as f32 / mean);
        assert!((0..3).all(|c| (centre[c] - towards[c]).abs() < 0.01), "{centre:?}");
        assert_eq!(disc(towards, 0.0, [1.0; 3]), [(towards, [1.0; 3])]);
    }
}
