//! The outline of the mesh as a camera sees it: places of the frame between pixels, the places of the mesh there, and normals.

use crate::capture::{Camera, Surface};

/// A place of the outline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rim {
    /// Where in the frame.
    pub(super) px: [f64; 2],
    /// The place of the mesh, in mm.
    pub(super) at: [f64; 3],
    /// Unit normal of the outline in the frame, outwards.
    pub(super) normal: [f64; 2],
}

/// Halvings of the step between a pixel that sees the mesh and one that does not.
const HALVINGS: usize = 8;
/// Pixels around a place that tell its normal.
const AROUND: i64 = 3;

/// The outline, where it lies inside the frame.
pub(super) fn outline(surface: &Surface, camera: &Camera) -> Vec<Rim> {
    let (w, h) = (camera.width, camera.height);
    let seen = |px: [f64; 2]| surface.seen(camera, px);
    let centre = |x: usize, y: usize| [x as f64 + 0.5, y as f64 + 0.5];
    let mask: Vec<bool> = (0..w * h).map(|i| seen(centre(i % w, i / w)).is_some()).collect();
    let mut rims = Vec::new();
    let mut between = |a: (usize, usize), b: (usize, usize)| {
        let (on, off) = match (mask[a.1 * w + a.0], mask[b.1 * w + b.0]) {
            (true, false) => (a, b),
            (false, true) => (b, a),
            _ => return,
        };
        let (mut on, mut off) = (centre(on.0, on.1), centre(off.0, off.1));
        let mut place = None;
        for _ in 0..HALVINGS {
            let middle = [0, 1].map(|i| 0.5 * (on[i] + off[i]));
            match seen(middle) {
                Some((p, _)) => (on, place) = (middle, Some(p)),
                None => off = middle,
            }
        }
        let place = place.or_else(|| seen(on).map(|p| p.0));
        let normal = normal(&mask, (w, h), on);
        rims.extend(place.zip(normal).map(|(place, normal)| Rim { px: on, at: place.at, normal }));
    };
    for y in 0..h {
        for x in 0..w {
            if x + 1 < w {
                between((x, y), (x + 1, y));
            }
            if y + 1 < h {
                between((x, y), (x, y + 1));
            }
        }
    }
    rims
}

/// Away from the middle of the pixels around `at` that see the mesh; `None` at the rim of the frame.
fn normal(mask: &[bool], (w, h): (usize, usize), at: [f64; 2]) -> Option<[f64; 2]> {
    let (x, y) = (at[0].floor() as i64, at[1].floor() as i64);
    if x < AROUND || y < AROUND || x + AROUND >= w as i64 || y + AROUND >= h as i64 {
        return None;
    }
    let mut sum = [0.0; 2];
    for j in y - AROUND..=y + AROUND {
        for i in x - AROUND..=x + AROUND {
            let d = [i as f64 + 0.5 - at[0], j as f64 + 0.5 - at[1]];
            // A round window, without steps at its rim.
            let weight = (1.0 - (d[0] * d[0] + d[1] * d[1]) / (AROUND as f64 + 0.5).powi(2)).max(0.0);
            let side = if mask[j as usize * w + i as usize] { -weight } else { weight };
            sum = [sum[0] + side * d[0], sum[1] + side * d[1]];
        }
    }
    let length = sum[0].hypot(sum[1]);
    (length > 1e-9).then(|| sum.map(|s| s / length))
}
