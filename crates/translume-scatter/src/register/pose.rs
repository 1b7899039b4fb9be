//! Small rigid motions and least squares over them.
//!
//! A motion has six parameters in mm: a rotation vector times the object's radius, and a shift. It turns about the middle of the
//! object, so that the six have little to do with each other.

use crate::capture::Camera;
use crate::lm::{Limits, Problem, Workspace, minimise};
use glam::{DMat3, DVec3};

/// Turns about `pivot` and shifts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    pub(super) rotation: DMat3,
    pub(super) shift: DVec3,
}

impl Motion {
    /// From six parameters, for an object of this radius.
    pub(super) fn new(x: &[f64], radius: f64) -> Self {
        let turn = DVec3::new(x[0], x[1], x[2]) / radius;
        Self { rotation: rotation(turn), shift: DVec3::new(x[3], x[4], x[5]) }
    }

    pub(super) fn of(&self, p: DVec3, pivot: DVec3) -> DVec3 {
        self.rotation * (p - pivot) + pivot + self.shift
    }
}

/// The rotation by |w| about w.
fn rotation(w: DVec3) -> DMat3 {
    match w.length() {
        angle if angle > 0.0 => DMat3::from_axis_angle(w / angle, angle),
        _ => DMat3::IDENTITY,
    }
}

/// A residual and its derivatives by the six parameters.
pub(super) type Row = (f64, [f64; 6]);

/// The sum of squares of rows that depend on a motion, and of the parameters over their expected sizes.
pub(super) struct MotionFit<'a, F> {
    /// Calls its second argument for each row; `false` where the motion is impossible.
    pub(super) rows: F,
    /// Standard deviations that the parameters are taken to have.
    pub(super) expected: &'a [f64; 6],
}

impl<F: Fn(&[f64], &mut dyn FnMut(Row)) -> bool> Problem for MotionFit<'_, F> {
    fn parameters(&self) -> usize {
        6
    }

    fn linearise(&self, x: &[f64], normal: &mut [f64], gradient: &mut [f64]) -> Option<f64> {
        let mut cost = 0.0;
        let mut add = |(r, j): Row| {
            cost += r * r;
            for a in 0..6 {
                gradient[a] += j[a] * r;
                (a..6).for_each(|b| normal[a * 6 + b] += j[a] * j[b]);
            }
        };
        if !(self.rows)(x, &mut add) {
            return None;
        }
        for (i, sigma) in self.expected.iter().enumerate() {
            let mut j = [0.0; 6];
            j[i] = 1.0 / sigma;
            add((x[i] / sigma, j));
        }
        Some(cost)
    }
}

/// Lowers the sum of squares from `x` on.
pub(super) fn solve<F: Fn(&[f64], &mut dyn FnMut(Row)) -> bool>(problem: &MotionFit<'_, F>, x: &mut [f64; 6]) -> bool {
    minimise(problem, x, Limits { steps: 20, tolerance: 1e-8 }, &mut Workspace::default()).is_some()
}

/// Weights of residuals by their size [Cauchy]: those much larger than the median count little.
pub(super) fn robust(residuals: &[f64], least: f64) -> Vec<f64> {
    let scale = median(residuals).map_or(least, |m| (2.0 * 1.4826 * m).max(least));
    residuals.iter().map(|r| 1.0 / (1.0 + (r / scale).powi(2))).collect()
}

/// Median of absolute values.
pub(super) fn median(values: &[f64]) -> Option<f64> {
    let mut all: Vec<f64> = values.iter().map(|v| v.abs()).collect();
    all.sort_by(f64::total_cmp);
    all.get(all.len() / 2).copied()
}

/// Rotation and translation of a camera.
pub(super) fn parts(camera: &Camera) -> (DMat3, DVec3) {
    let m = &camera.camera_from_world;
    let row = |i: usize| DVec3::new(m[i][0], m[i][1], m[i][2]);
    (DMat3::from_cols(row(0), row(1), row(2)).transpose(), DVec3::new(m[0][3], m[1][3], m[2][3]))
}

/// The camera as if the object had been moved in front of it; `pivot` in the camera's coordinates.
pub(super) fn moved(camera: &Camera, motion: &Motion, pivot: DVec3) -> Camera {
    let (r, t) = parts(camera);
    let (r, t) = (motion.rotation * r, motion.of(t, pivot));
    let row = |i: usize| [r.row(i).x, r.row(i).y, r.row(i).z, t[i]];
    Camera { camera_from_world: [row(0), row(1), row(2)], ..camera.clone() }
}

/// Angle in radians and length in mm between the poses of two cameras.
pub(super) fn between(a: &Camera, b: &Camera) -> (f64, f64) {
    let ((ra, _), (rb, _)) = (parts(a), parts(b));
    let turn = rb * ra.transpose();
    // The sine too: near 0 the cosine has lost the angle.
    let axis = DVec3::new(turn.y_axis.z - turn.z_axis.y, turn.z_axis.x - turn.x_axis.z, turn.x_axis.y - turn.y_axis.x);
    let trace = turn.x_axis.x + turn.y_axis.y + turn.z_axis.z;
    let angle = (0.5 * axis.length()).atan2(0.5 * (trace - 1.0));
    (angle, (DVec3::from_array(a.eye()) - DVec3::from_array(b.eye())).length())
}
