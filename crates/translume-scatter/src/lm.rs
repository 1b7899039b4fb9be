//! Levenberg–Marquardt on the normal equations, for small problems that are solved many times.
//!
//! Sources: Marquardt 1963 (damping by the diagonal), with the largest diagonal met so far as scale (Moré 1978) and Nielsen's
//! 1999 rule for the damping. A problem may refuse a point; the step there is then rejected like one that is worse.
//! Normal equations square the condition number: parameters must be scaled sensibly, which the diagonal does, and a sum of
//! squares below some 1e-15 of the data's is not reached.

/// A sum of squared residuals.
pub(crate) trait Problem {
    /// Number of parameters.
    fn parameters(&self) -> usize;

    /// The sum of squares at `x`, with JᵀJ (row-major, upper triangle) and Jᵀr added to buffers that are zero on
    /// entry; `None` where `x` is not allowed.
    fn linearise(&self, x: &[f64], normal: &mut [f64], gradient: &mut [f64]) -> Option<f64>;
}

/// When to stop.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Most steps tried.
    pub(crate) steps: usize,
    /// Stop when a step lowers the sum of squares by less than this fraction, as predicted and as found.
    pub(crate) tolerance: f64,
}

/// Buffers that survive from one problem to the next.
#[derive(Default)]
pub(crate) struct Workspace {
    normal: Vec<f64>,
    gradient: Vec<f64>,
    trial_normal: Vec<f64>,
    trial_gradient: Vec<f64>,
    factor: Vec<f64>,
    scale: Vec<f64>,
    trial: Vec<f64>,
    step: Vec<f64>,
}

impl Workspace {
    fn resize(&mut self, n: usize) {
        for v in [&mut self.normal, &mut self.trial_normal, &mut self.factor] {
            v.clear();
            v.resize(n * n, 0.0);
        }
        for v in [&mut self.gradient, &mut self.trial_gradient, &mut self.scale, &mut self.trial, &mut self.step] {
            v.clear();
            v.resize(n, 0.0);
        }
    }

    /// Linearises at the trial point.
    fn look(&mut self, problem: &impl Problem) -> Option<f64> {
        self.trial_normal.fill(0.0);
        self.trial_gradient.fill(0.0);
        let cost = problem.linearise(&self.trial, &mut self.trial_normal, &mut self.trial_gradient)?;
        cost.is_finite().then_some(cost)
    }

    /// Makes the trial point the current one.
    fn accept(&mut self) {
        std::mem::swap(&mut self.normal, &mut self.trial_normal);
        std::mem::swap(&mut self.gradient, &mut self.trial_gradient);
        let n = self.gradient.len();
        for i in 0..n {
            self.scale[i] = self.scale[i].max(self.normal[i * n + i]);
        }
    }

    /// Solves (JᵀJ + μ·scale) step = −Jᵀr; the predicted decrease of the sum of squares.
    fn solve(&mut self, damping: f64) -> Option<f64> {
        let n = self.gradient.len();
        self.factor.copy_from_slice(&self.normal);
        // A parameter without influence gets a unit diagonal, and so no step.
        let diagonal = |s: f64| damping * s + if s > 0.0 { 0.0 } else { 1.0 };
        (0..n).for_each(|i| self.factor[i * n + i] += diagonal(self.scale[i]));
        cholesky(&mut self.factor, n)?;
        self.step.iter_mut().zip(&self.gradient).for_each(|(s, g)| *s = -g);
        substitute(&self.factor, n, &mut self.step);
        let terms = (0..n).map(|i| self.step[i] * (diagonal(self.scale[i]) * self.step[i] - self.gradient[i]));
        Some(terms.sum())
    }
}

/// Factors the symmetric matrix whose upper triangle is given into UᵀU, in place.
fn cholesky(a: &mut [f64], n: usize) -> Option<()> {
    for i in 0..n {
        for k in 0..i {
            let f = a[k * n + i];
            if f != 0.0 {
                let (above, row) = a.split_at_mut(i * n);
                let source = &above[k * n + i..k * n + n];
                row[i..n].iter_mut().zip(source).for_each(|(x, s)| *x -= f * s);
            }
        }
        let pivot = a[i * n + i];
        // Not "pivot <= 0": a NaN must fail too.
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        let inverse = 1.0 / pivot.sqrt();
        a[i * n + i..i * n + n].iter_mut().for_each(|x| *x *= inverse);
    }
    Some(())
}

/// Solves UᵀU x = b in place.
fn substitute(u: &[f64], n: usize, x: &mut [f64]) {
    for i in 0..n {
        x[i] /= u[i * n + i];
        for j in i + 1..n {
            x[j] -= u[i * n + j] * x[i];
        }
    }
    for i in (0..n).rev() {
        let sum: f64 = (i + 1..n).map(|j| u[i * n + j] * x[j]).sum();
        x[i] = (x[i] - sum) / u[i * n + i];
    }
}

/// Lowers the sum of squares from `x` on; `x` becomes the best point found. Returns its sum of squares, `None` if the
/// start itself is not allowed.
pub(crate) fn minimise(problem: &impl Problem, x: &mut [f64], limits: Limits, ws: &mut Workspace) -> Option<f64> {
    ws.resize(problem.parameters());
    ws.trial.copy_from_slice(x);
    let mut cost = ws.look(problem)?;
    ws.accept();
    let (mut damping, mut raise) = (1e-3, 2.0);
    for _ in 0..limits.steps {
        let Some(predicted) = ws.solve(damping) else {
            damping *= raise;
            raise *= 2.0;
            continue;
        };
        if predicted <= limits.tolerance * cost {
            break;
        }
        for i in 0..x.len() {
            ws.trial[i] = x[i] + ws.step[i];
        }
        let found = ws.look(problem).filter(|&c| c < cost);
        let Some(lower) = found else {
            damping *= raise;
            raise *= 2.0;
            if damping > 1e16 {
                break;
            }
            continue;
        };
        let gain = (cost - lower) / predicted;
        damping = (damping * (1.0 - (2.0 * gain - 1.0).powi(3)).max(1.0 / 3.0)).max(1e-15);
        raise = 2.0;
        let done = cost - lower <= limits.tolerance * cost && predicted <= 2.0 * limits.tolerance * cost;
        x.copy_from_slice(&ws.trial);
        ws.accept();
        cost = lower;
        if done {
            break;
        }
    }
    Some(cost)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rosenbrock's valley as residuals 10 (y − x²), 1 − x; forbidden for x > 1.5.
    struct Valley;

    impl Problem for Valley {
        fn parameters(&self) -> usize {
            2
        }

        fn linearise(&self, p: &[f64], normal: &mut [f64], gradient: &mut [f64]) -> Option<f64> {
            let (x, y) = (p[0], p[1]);
            if x > 1.5 {
                return None;
            }
            let rows = [([-20.0 * x, 10.0], 10.0 * (y - x * x)), ([-1.0, 0.0], 1.0 - x)];
            for (j, r) in rows {
                normal[0] += j[0] * j[0];
                normal[1] += j[0] * j[1];
                normal[3] += j[1] * j[1];
                gradient[0] += j[0] * r;
                gradient[1] += j[1] * r;
            }
            Some(rows.iter().map(|(_, r)| r * r).sum())
        }
    }

    #[test]
    fn finds_the_bottom_of_a_bent_valley_past_forbidden_ground() {
        let limits = Limits { steps: 200, tolerance: 1e-14 };
        for start in [[-1.2, 1.0], [1.4, -3.0], [0.0, 50.0]] {
            let mut x = start;
            let cost = minimise(&Valley, &mut x, limits, &mut Workspace::default()).unwrap();
            assert!(cost < 1e-20 && (x[0] - 1.0).abs() < 1e-8 && (x[1] - 1.0).abs() < 1e-8, "{start:?}: {x:?}");
        }
        assert!(minimise(&Valley, &mut [2.0, 0.0], limits, &mut Workspace::default()).is_none());
    }

    #[test]
    fn cholesky_solves_and_refuses_what_is_not_positive() {
        let mut a = [4.0, 2.0, 1.0, 0.0, 5.0, 3.0, 0.0, 0.0, 6.0];
        let mut x = [9.0, 21.0, 25.0]; // the matrix times (0.5, 2, 3.083…) is not used: the residual is checked
        let b = x;
        let full = [[4.0, 2.0, 1.0], [2.0, 5.0, 3.0], [1.0, 3.0, 6.0]];
        cholesky(&mut a, 3).unwrap();
        substitute(&a, 3, &mut x);
        for i in 0..3 {
            let product: f64 = (0..3).map(|j| full[i][j] * x[j]).sum();
            assert!((product - b[i]).abs() < 1e-12);
        }
        assert!(cholesky(&mut [1.0, 2.0, 0.0, 1.0], 2).is_none());
        assert!(cholesky(&mut [f64::NAN], 1).is_none());
    }
}
