//! A camera's pose from the outline of the object and from spots whose places on the mesh are known.
//!
//! The outline of the mesh is cast, each of its places is moved along its normal to where the picture has the edge, and the pose with the
//! least sum of squares along these normals is found; then the outline is cast anew. That the outline slides over the mesh as the camera
//! moves changes nothing to first order: at the outline the surface is seen edge-on.

use super::outline::{Rim, outline};
use super::pictures::Lit;
use super::pose::{Motion, MotionFit, Row, median, moved, parts, robust, solve};
use crate::capture::{Camera, Surface};
use glam::{DVec2, DVec3};

/// Fewer places, or fewer spots, tell nothing of six parameters.
const FEWEST_RIMS: usize = 16;
const FEWEST_SPOTS: usize = 6;
/// Rounds of casting and fitting, and the motion in pixels that ends them.
const ROUNDS: usize = 25;
const ENOUGH_PX: f64 = 0.003;
/// How far from the outline of the mesh edges are looked for: a share of the frame's width at first, pixels at the end.
const REACH: (f64, f64) = (0.15, 3.0);
/// Errors that outlines and spots have anyway, in pixels; more than one of them alone has, because neighbours err alike.
const OUTLINE_PX: f64 = 0.6;
const SPOT_PX: f64 = 0.6;
/// What the rig's poses are trusted: shift across and along the line of sight as shares of the object and of the distance.
const TRUST: (f64, f64) = (0.5, 0.05);
/// And the angle: outlines alone, each off to one side by a little, would turn an object far.
const TRUST_ALONE_RAD: f64 = 0.01;
const TRUST_RAD: f64 = 0.03;

/// A spot and the place of the mesh that it shows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shown {
    at: DVec3,
    px: DVec2,
}

/// How far picture and mesh are apart, in pixels.
pub(super) struct Residuals {
    rims: Vec<(Rim, f64)>,
    /// Along the normals of the outline.
    pub(super) outline: Vec<f64>,
    shown: Vec<Shown>,
    /// Of the spots.
    pub(super) spots: Vec<f64>,
}

impl Residuals {
    pub(super) fn outline_median(&self) -> Option<f64> {
        median(&self.outline)
    }

    pub(super) fn spot_median(&self) -> Option<f64> {
        median(&self.spots)
    }
}

/// Residuals of a camera, with edges up to a first reach away.
pub(super) fn residuals(surface: &Surface, camera: &Camera, lit: &Lit, hits: Option<&[[f64; 3]]>) -> Residuals {
    within(surface, camera, lit, hits, REACH.0 * camera.width as f64)
}

fn within(surface: &Surface, camera: &Camera, lit: &Lit, hits: Option<&[[f64; 3]]>, reach: f64) -> Residuals {
    let mut found = Residuals { rims: Vec::new(), outline: Vec::new(), shown: Vec::new(), spots: Vec::new() };
    for rim in outline(surface, camera) {
        if let Some(edge) = lit.edge(rim.px, rim.normal, reach) {
            found.outline.push(edge);
            found.rims.push((rim, edge));
        }
    }
    for spot in hits.iter().flat_map(|hits| lit.spots.iter().map(|s| (s, hits[s.position]))) {
        let (spot, hit) = spot;
        let Some(px) = camera.project(hit).filter(|px| visible(surface, camera, *px, hit)) else { continue };
        let off = (px[0] - spot.px[0]).hypot(px[1] - spot.px[1]);
        if off <= reach {
            found.spots.push(off);
            found.shown.push(Shown { at: DVec3::from_array(hit), px: DVec2::from_array(spot.px) });
        }
    }
    found
}

/// Whether the camera sees a hit, not at a grazing angle.
pub(super) fn visible(surface: &Surface, camera: &Camera, px: [f64; 2], hit: [f64; 3]) -> bool {
    let far = (DVec3::from_array(camera.eye()) - DVec3::from_array(hit)).length();
    let near = 2.0 * far / camera.focal_px; // two pixels
    surface.seen(camera, px).is_some_and(|(place, cos)| {
        cos > 0.3 && (DVec3::from_array(place.at) - DVec3::from_array(hit)).length() < near.max(1e-3 * far)
    })
}

/// The camera with the least residuals, from the pose that the rig gives; `None` where nothing tells it.
pub(super) fn refine(surface: &Surface, given: &Camera, lit: &Lit, hits: Option<&[[f64; 3]]>) -> Option<Camera> {
    refine_from(surface, given, given, lit, hits)
}

/// The same from another start.
pub(super) fn refine_from(
    surface: &Surface,
    given: &Camera,
    start: &Camera,
    lit: &Lit,
    hits: Option<&[[f64; 3]]>,
) -> Option<Camera> {
    let bounds = surface.mesh.bounds();
    let radius = (0.5 * f64::from(bounds.extent().length())).max(1e-9);
    let (turn, shift) = parts(given);
    let pivot = turn * bounds.center().as_dvec3() + shift;
    let far = pivot.z.abs();
    let turned = radius * if hits.is_some() { TRUST_RAD } else { TRUST_ALONE_RAD };
    let expected = [turned, turned, turned, TRUST.0 * radius, TRUST.0 * radius, TRUST.1 * far];
    let mut x = motion_to(given, start, pivot, radius);
    let mut camera = start.clone();
    let mut reach = REACH.0 * camera.width as f64;
    let px_per_mm = given.focal_px / far;
    for _ in 0..ROUNDS {
        let found = within(surface, &camera, lit, hits, reach);
        if found.rims.len() < FEWEST_RIMS && found.shown.len() < FEWEST_SPOTS {
            return None;
        }
        let weights = [robust(&found.outline, OUTLINE_PX), robust(&found.spots, SPOT_PX)];
        let before = x;
        let rows = |x: &[f64], add: &mut dyn FnMut(Row)| {
            rows(given, &Motion::new(x, radius), (pivot, radius), &found, &weights, add)
        };
        if !solve(&MotionFit { rows, expected: &expected }, &mut x) {
            return None;
        }
        camera = moved(given, &Motion::new(&x, radius), pivot);
        let change = x.iter().zip(before).fold(0.0f64, |c, (a, b)| c.max((a - b).abs())) * px_per_mm;
        let last = reach <= REACH.1;
        reach = (0.6 * reach).max(REACH.1.max(4.0 * median(&found.outline).unwrap_or(0.0)).min(reach));
        if change < ENOUGH_PX && last {
            break;
        }
    }
    Some(camera)
}

/// The parameters that move `given` to `camera`.
fn motion_to(given: &Camera, camera: &Camera, pivot: DVec3, radius: f64) -> [f64; 6] {
    let ((ra, ta), (rb, tb)) = (parts(given), parts(camera));
    let turn = rb * ra.transpose();
    let (axis, angle) = glam::DQuat::from_mat3(&turn).to_axis_angle();
    let shift = tb - pivot - turn * (ta - pivot);
    let turned = axis * angle * radius;
    [turned.x, turned.y, turned.z, shift.x, shift.y, shift.z]
}

/// Residuals in units of their errors, and derivatives.
fn rows(
    given: &Camera,
    motion: &Motion,
    (pivot, radius): (DVec3, f64),
    found: &Residuals,
    weights: &[Vec<f64>; 2],
    add: &mut dyn FnMut(Row),
) -> bool {
    let (r, t) = parts(given);
    // The place in the frame, and the derivatives of its coordinates by the six parameters.
    let project = |at: DVec3| -> Option<(DVec2, [[f64; 6]; 2])> {
        let p = motion.of(r * at + t, pivot);
        if p.z <= 0.0 {
            return None;
        }
        let f = given.focal_px / p.z;
        let px = DVec2::new(given.center_px[0] + f * p.x, given.center_px[1] + f * p.y);
        let by_place = [DVec3::new(f, 0.0, -f * p.x / p.z), DVec3::new(0.0, f, -f * p.y / p.z)];
        let arm = p - pivot - motion.shift;
        let by_motion = by_place.map(|g| {
            let turn = arm.cross(g) / radius; // g · (e × arm) = e · (arm × g)
            [turn.x, turn.y, turn.z, g.x, g.y, g.z]
        });
        Some((px, by_motion))
    };
    for ((rim, edge), weight) in found.rims.iter().zip(&weights[0]) {
        let Some((px, by)) = project(DVec3::from_array(rim.at)) else { return false };
        let n = rim.normal;
        let off = n[0] * (px.x - rim.px[0]) + n[1] * (px.y - rim.px[1]) - edge;
        let scale = weight.sqrt() / OUTLINE_PX;
        add((scale * off, std::array::from_fn(|k| scale * (n[0] * by[0][k] + n[1] * by[1][k]))));
    }
    for (shown, weight) in found.shown.iter().zip(&weights[1]) {
        let Some((px, by)) = project(shown.at) else { return false };
        let scale = weight.sqrt() / SPOT_PX;
        for (off, by) in [(px.x - shown.px.x, by[0]), (px.y - shown.px.y, by[1])] {
            add((scale * off, by.map(|b| scale * b)));
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_are_those_of_the_projection() {
        let camera = Camera::looking_at([80.0, 20.0, 60.0], [0.0; 3], [0.0, 0.0, 1.0], (64, 48), 20.0);
        let (r, t) = parts(&camera);
        let (pivot, radius) = (t, 5.0);
        let at = [[1.0, 2.0, 3.0], [-2.0, 0.5, 1.0]];
        let rim = Rim { px: [30.0, 20.0], at: at[0], normal: [0.6, 0.8] };
        let shown = Shown { at: DVec3::from_array(at[1]), px: DVec2::new(31.0, 22.0) };
        let found = Residuals { rims: vec![(rim, 0.3)], outline: vec![0.3], shown: vec![shown], spots: vec![1.0] };
        let weights = [vec![1.0], vec![0.5]];
        let all = |x: &[f64]| {
            let mut out = Vec::new();
            assert!(rows(&camera, &Motion::new(x, radius), (pivot, radius), &found, &weights, &mut |row| out.push(row)));
            out
        };
        assert!((r.determinant() - 1.0).abs() < 1e-12);
        let x = [0.0, 0.0, 0.0, 0.4, -0.3, 1.0];
        for k in 0..6 {
            let (mut low, mut high) = (x, x);
            (low[k], high[k]) = (x[k] - 1e-5, x[k] + 1e-5);
            for ((here, a), b) in all(&x).iter().zip(all(&low)).zip(all(&high)) {
                let slope = (b.0 - a.0) / 2e-5;
                assert!((slope - here.1[k]).abs() < 1e-5 * (1.0 + slope.abs()), "{k}: {slope} {}", here.1[k]);
            }
        }
        // A motion and the camera that it makes are inverse.
        let x = [0.3, -0.2, 0.1, 0.4, -0.3, 1.0];
        let back = motion_to(&camera, &moved(&camera, &Motion::new(&x, radius), pivot), pivot, radius);
        assert!(x.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-9), "{back:?}");
    }
}
