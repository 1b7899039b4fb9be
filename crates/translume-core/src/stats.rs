//! Statistical tests: χ² goodness of fit, normal and Student tails, correction for many tests.
//!
//! A test is told its significance: the chance that it raises a false alarm when all is well. With many pixels or many
//! cases each single one is held to Šidák's stricter level, [`sidak`].

use crate::special::{beta_i, gamma_q};

/// What a failed test found.
#[derive(Clone, Debug, PartialEq)]
pub struct Failure(pub String);

impl std::fmt::Display for Failure {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Failure {}

/// The level for each of `tests` independent tests so that all together raise a false alarm with chance `significance`.
pub fn sidak(significance: f64, tests: usize) -> f64 {
    // −expm1(ln1p(−α)/n): the naive power loses everything for small α and many tests.
    -((-significance).ln_1p() / tests.max(1) as f64).exp_m1()
}

/// Chance that a χ² variable with `dof` degrees of freedom exceeds `statistic`.
pub fn chi2_tail(statistic: f64, dof: f64) -> f64 {
    gamma_q(0.5 * dof, 0.5 * statistic)
}

/// Chance that a standard normal variable exceeds |z| in absolute value.
pub fn normal_tail(z: f64) -> f64 {
    gamma_q(0.5, 0.5 * z * z)
}

/// Chance that a Student variable with `dof` degrees of freedom exceeds |t| in absolute value.
pub fn student_tail(t: f64, dof: f64) -> f64 {
    beta_i(0.5 * dof, 0.5, dof / (dof + t * t))
}

/// χ² test of observed against expected counts; cells are pooled, smallest expectation first, until each pool expects at
/// least five. Cells that expect next to nothing must stay nearly empty (five counts are forgiven to rounding). Returns the p-value, or what failed.
pub fn chi2_test(observed: &[f64], expected: &[f64], significance: f64) -> Result<f64, Failure> {
    const MIN_EXPECTED: f64 = 5.0;
    if observed.len() != expected.len() {
        return Err(Failure(format!("{} observed cells, {} expected", observed.len(), expected.len())));
    }
    if expected.iter().chain(observed).any(|x| !x.is_finite() || *x < 0.0) {
        return Err(Failure("a cell is negative or not finite".into()));
    }
    let empty = |x: &f64| *x < 0.01;
    let (stray, allowed) =
        expected.iter().zip(observed).filter(|(e, _)| empty(e)).fold((0.0, 0.0), |(o, e), c| (o + c.1, e + c.0));
    if stray > allowed + 5.0 * (allowed + 1.0).sqrt() {
        return Err(Failure(format!("{stray} counts in cells that expect {allowed:.2e}")));
    }
    let mut order: Vec<usize> = (0..expected.len()).collect();
    order.sort_by(|&a, &b| expected[a].total_cmp(&expected[b]));
    let (mut statistic, mut cells) = (0.0, 0usize);
    let (mut pool_observed, mut pool_expected) = (0.0, 0.0);
    let mut last = (0.0, 0.0);
    for &i in &order {
        pool_observed += observed[i];
        pool_expected += expected[i];
        if pool_expected >= MIN_EXPECTED {
            let deviation: f64 = pool_observed - pool_expected;
            statistic += deviation * deviation / pool_expected;
            last = (pool_observed, pool_expected);
            cells += 1;
            (pool_observed, pool_expected) = (0.0, 0.0);
        }
    }
    if cells == 0 {
        return Err(Failure("too few expected counts for a test".into()));
    }
    if pool_observed > 0.0 || pool_expected > 0.0 {
        // A remainder (only when the largest cell itself is small) joins the last pool.
        let (o, e) = last;
        statistic -= (o - e) * (o - e) / e;
        let (o, e) = (o + pool_observed, e + pool_expected);
        statistic += (o - e) * (o - e) / e;
    }
    let p = chi2_tail(statistic, (cells.max(2) - 1) as f64);
    if p >= significance {
        return Ok(p);
    }
    let worst = order.iter().copied().max_by(|&a, &b| {
        let score = |i: usize| (observed[i] - expected[i]).powi(2) / expected[i].max(1.0);
        score(a).total_cmp(&score(b))
    });
    let worst = worst.unwrap_or(0);
    Err(Failure(format!(
        "chi2 = {statistic:.1} with {} degrees of freedom: p = {p:.2e} < {significance:.2e}; worst cell {worst}: {} observed, \
         {:.1} expected",
        cells.max(2) - 1,
        observed[worst],
        expected[worst]
    )))
}

/// Whether the mean of `n` samples with mean `mean` and variance (of a single sample) `variance` agrees with `expected`:
/// a two-sided Student test. Returns the p-value, or what failed. Zero variance passes only for equality to rounding.
pub fn t_test(mean: f64, variance: f64, n: usize, expected: f64, significance: f64) -> Result<f64, Failure> {
    if n < 2 || !mean.is_finite() || !variance.is_finite() {
        return Err(Failure(format!("no test possible: mean {mean}, variance {variance}, {n} samples")));
    }
    let error = (variance.max(0.0) / n as f64).sqrt();
    // Rounding of f32 sums must not look like an error in noise-free cases.
    let error = error.max(1e-6 * expected.abs().max(mean.abs()));
    let t = if error > 0.0 { (mean - expected) / error } else { 0.0 };
    let p = student_tail(t, (n - 1) as f64);
    if p >= significance {
        Ok(p)
    } else {
        Err(Failure(format!("mean {mean} ± {error:.2e} against {expected}: p = {p:.2e} < {significance:.2e}")))
    }
}

/// One pixel's estimate for [`compare_pictures`].
#[derive(Clone, Copy, Debug)]
pub struct Estimate {
    /// The mean.
    pub mean: f64,
    /// Variance OF THE MEAN (variance of a sample divided by the number of samples).
    pub variance: f64,
}

/// Whether two independent estimates of the same picture agree: a z-test per pixel at Šidák's level. `floor` is the
/// standard error that no pixel falls below, so that a pixel whose few samples all agree does not fail the test.
/// Returns the smallest p-value, or what failed.
pub fn compare_pictures(a: &[Estimate], b: &[Estimate], floor: f64, significance: f64) -> Result<f64, Failure> {
    if a.len() != b.len() || a.is_empty() {
        return Err(Failure(format!("{} pixels against {}", a.len(), b.len())));
    }
    let level = sidak(significance, a.len());
    let (mut smallest, mut at, mut failed) = (1.0, 0, 0);
    for (i, (x, y)) in a.iter().zip(b).enumerate() {
        let error = (x.variance + y.variance).sqrt().max(floor);
        let p =
            if error > 0.0 { normal_tail((x.mean - y.mean) / error) } else { f64::from(u8::from(x.mean == y.mean)) };
        // A pixel that is not a number fails.
        failed += usize::from(p.is_nan() || p < level);
        if p.is_nan() || p < smallest {
            (smallest, at) = (if p.is_nan() { 0.0 } else { p }, i);
        }
    }
    if failed == 0 {
        return Ok(smallest);
    }
    Err(Failure(format!(
        "{failed} of {} pixels differ at the level {level:.1e}; worst {at}: {} against {}, p = {smallest:.1e}",
        a.len(),
        a[at].mean,
        b[at].mean
    )))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Pcg32;

    #[test]
    fn tails_have_their_tabulated_values() {
        assert!((chi2_tail(3.841_458_820_694_124, 1.0) - 0.05).abs() < 1e-12);
        assert!((chi2_tail(124.342_113_404, 100.0) - 0.05).abs() < 1e-9);
        assert!((normal_tail(1.959_963_984_540_054) - 0.05).abs() < 1e-12);
        assert!((student_tail(2.228_138_851_986_275_3, 10.0) - 0.05).abs() < 1e-12);
        assert!((student_tail(1.96, 1e7) - normal_tail(1.96)).abs() < 1e-6);
        assert!((sidak(0.01, 1) - 0.01).abs() < 1e-15);
        let s = sidak(0.01, 1_000_000);
        assert!((1.0 - (1.0 - s).powi(1_000_000) - 0.01).abs() < 1e-6);
    }

    #[test]
    fn false_alarms_are_as_rare_as_promised() {
        // 2,000 honest tests at 5 %: about 100 alarms; the seed is fixed.
        let (mut chi, mut t) = (0, 0);
        let mut rng = Pcg32::new(11, 0);
        for _ in 0..2000 {
            let mut seen = [0.0; 10];
            let (mut sum, mut sum2) = (0.0, 0.0);
            for _ in 0..200 {
                seen[(rng.next_f64() * 10.0) as usize] += 1.0;
                let x = rng.next_normal();
                sum += x;
                sum2 += x * x;
            }
            chi += i32::from(chi2_test(&seen, &[20.0; 10], 0.05).is_err());
            let mean = sum / 200.0;
            t += i32::from(t_test(mean, (sum2 / 200.0 - mean * mean) * 200.0 / 199.0, 200, 0.0, 0.05).is_err());
        }
        assert!((60..140).contains(&chi), "{chi}");
        assert!((60..140).contains(&t), "{t}");
    }

    #[test]
    fn wrong_things_are_caught() {
        assert!(chi2_test(&[100.0, 100.0], &[150.0, 50.0], 1e-3).is_err());
        assert!(chi2_test(&[90.0, 0.0, 10.0], &[100.0, 0.0, 0.0], 1e-3).is_err(), "counts where none are expected");
        assert!(chi2_test(&[f64::NAN, 1.0], &[50.0, 50.0], 1e-3).is_err());
        assert!(chi2_test(&[1.0], &[1.0], 1e-3).is_err(), "nothing to test");
        assert!(chi2_test(&[100.0, 1.0, 2.0], &[98.0, 1.5, 3.5], 1e-3).is_ok());
        assert!(t_test(1.0, 0.0, 10, 1.0, 0.01).is_ok());
        assert!(t_test(1.1, 0.0, 10, 1.0, 0.01).is_err());
        assert!(t_test(f64::NAN, 1.0, 10, 1.0, 0.01).is_err());
        let a = vec![Estimate { mean: 1.0, variance: 1e-4 }; 1000];
        let mut b = a.clone();
        assert!(compare_pictures(&a, &b, 0.0, 0.01).is_ok());
        b[500].mean = 1.1;
        assert!(compare_pictures(&a, &b, 0.0, 0.01).unwrap_err().0.contains("worst 500"));
        b[500].mean = f64::NAN;
        assert!(compare_pictures(&a, &b, 0.0, 0.01).is_err());
    }
}
