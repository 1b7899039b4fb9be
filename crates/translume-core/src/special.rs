//! Special functions: error function and its inverse (f32, for samplers), incomplete gamma and beta (f64, for tests),
//! Gauss–Legendre quadrature.
//!
//! Sources: Abramowitz & Stegun 7.1.26 for `erf`; Giles 2010, "Approximating the erfinv function"; Lanczos' approximation
//! and Lentz's continued fractions as in any numerical handbook. The f32 functions are fast rather than exact to the last bit.

/// Error function, absolute error below 2e-7 (Abramowitz & Stegun 7.1.26, in f64 inside).
#[inline]
pub fn erf(x: f32) -> f32 {
    let a = f64::from(x.abs());
    let t = 1.0 / (1.0 + 0.327_591_1 * a);
    let poly =
        ((((1.061_405_429 * t - 1.453_152_027) * t + 1.421_413_741) * t - 0.284_496_736) * t + 0.254_829_592) * t;
    ((1.0 - poly * (-a * a).exp()) as f32).copysign(x)
}

/// Inverse error function on (−1, 1), f32 (Giles 2010, single precision: relative error about 3e-7).
#[inline]
pub fn erf_inv(x: f32) -> f32 {
    let w = -((1.0 - x) * (1.0 + x)).ln();
    let poly = |c: [f32; 9], w: f32| c.iter().fold(0.0, |p, &c| p * w + c);
    let p = if w < 5.0 {
        let c = [
            2.810_226_4e-8,
            3.432_739_4e-7,
            -3.523_387_7e-6,
            -4.391_506_5e-6,
            0.000_218_580_87,
            -0.001_253_725,
            -0.004_177_681_6,
            0.246_640_73,
            1.501_409_4,
        ];
        poly(c, w - 2.5)
    } else {
        let c = [
            -0.000_200_214_26,
            0.000_100_950_56,
            0.001_349_343_2,
            -0.003_673_428_4,
            0.005_739_507_7,
            -0.007_622_461_3,
            0.009_438_870_5,
            1.001_674_1,
            2.832_976_8,
        ];
        poly(c, w.sqrt() - 3.0)
    };
    p * x
}

/// ln Γ(x), x > 0 (Lanczos, g = 7, nine terms: relative error about 1e-15).
pub fn ln_gamma(x: f64) -> f64 {
    const C: [f64; 9] = [
        0.999_999_999_999_809_93,
        676.520_368_121_885_1,
        -1_259.139_216_722_402_8,
        771.323_428_777_653_13,
        -176.615_029_162_140_59,
        12.507_343_278_686_905,
        -0.138_571_095_265_720_12,
        9.984_369_578_019_571_6e-6,
        1.505_632_735_149_311_6e-7,
    ];
    let x = x - 1.0;
    let t = x + 7.5;
    let sum = C.iter().enumerate().skip(1).fold(C[0], |s, (i, c)| s + c / (x + i as f64));
    0.5 * std::f64::consts::TAU.ln() + (x + 0.5) * t.ln() - t + sum.ln()
}

/// Regularised upper incomplete gamma function Q(a, x) = Γ(a, x)/Γ(a), a > 0, x ≥ 0.
pub fn gamma_q(a: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 1.0;
    }
    let scale = (a * x.ln() - x - ln_gamma(a)).exp();
    if x < a + 1.0 {
        let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
        while term > sum * 1e-16 {
            n += 1.0;
            term *= x / n;
            sum += term;
        }
        (1.0 - sum * scale).clamp(0.0, 1.0)
    } else {
        (scale / lentz(|i| (x + 1.0 - a + 2.0 * i, i * (i - a)))).clamp(0.0, 1.0)
    }
}

/// Regularised incomplete beta function I_x(a, b).
pub fn beta_i(a: f64, b: f64, x: f64) -> f64 {
    if x <= 0.0 || x >= 1.0 {
        return if x <= 0.0 { 0.0 } else { 1.0 };
    }
    // The fraction converges for x below the mean only; above, the other tail.
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - beta_i(b, a, 1.0 - x);
    }
    let scale = (ln_gamma(a + b) - ln_gamma(a) - ln_gamma(b) + a * x.ln() + b * (-x).ln_1p()).exp() / a;
    let fraction = lentz(|i| {
        let m = (i / 2.0).floor();
        let numerator = if i % 2.0 == 0.0 {
            m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m))
        } else {
            -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0))
        };
        (1.0, -numerator)
    });
    scale / fraction
}

/// b₀ − a₁/(b₁ − a₂/(b₂ − …)) with (bᵢ, aᵢ) = `term(i)`, by the modified method of Lentz.
fn lentz(term: impl Fn(f64) -> (f64, f64)) -> f64 {
    const TINY: f64 = 1e-300;
    let nonzero = |x: f64| if x.abs() < TINY { TINY } else { x };
    let mut f = nonzero(term(0.0).0);
    let (mut c, mut d) = (f, 0.0);
    for i in 1..100_000 {
        let (b, a) = term(f64::from(i));
        d = 1.0 / nonzero(b - a * d);
        c = nonzero(b - a / c);
        f *= c * d;
        if (c * d - 1.0).abs() < 1e-15 {
            break;
        }
    }
    f
}

/// Nodes and weights of the n-point Gauss–Legendre rule on [0, 1]: Newton's method on the three-term recurrence.
pub fn gauss_legendre(n: usize) -> Vec<(f32, f32)> {
    let rule = |i: usize| {
        let mut x = (std::f64::consts::PI * (i as f64 + 0.75) / (n as f64 + 0.5)).cos();
        let mut derivative = 1.0;
        for _ in 0..100 {
            let (mut p, mut previous) = (1.0, 0.0);
            for k in 0..n {
                let k = k as f64;
                (p, previous) = (((2.0 * k + 1.0) * x * p - k * previous) / (k + 1.0), p);
            }
            derivative = n as f64 * (x * p - previous) / (x * x - 1.0);
            let step = p / derivative;
            x -= step;
            if step.abs() < 1e-15 {
                break;
            }
        }
        let weight = 1.0 / ((1.0 - x * x) * derivative * derivative);
        ((0.5 + 0.5 * x) as f32, weight as f32)
    };
    (0..n).map(rule).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_values() {
        // Γ(5) = 24, Γ(1/2) = √π.
        assert!((ln_gamma(5.0) - 24f64.ln()).abs() < 1e-13);
        assert!((ln_gamma(0.5) - 0.5 * std::f64::consts::PI.ln()).abs() < 1e-13);
        // Q(1, x) = e^−x; Q(1/2, x²) = erfc(x), erfc(1) = 0.15729920705028513.
        for x in [0.1, 1.0, 1.9, 2.1, 30.0] {
            assert!((gamma_q(1.0, x) - (-x).exp()).abs() < 1e-14, "{x}");
        }
        assert!((gamma_q(0.5, 1.0) - 0.157_299_207_050_285_13).abs() < 1e-14);
        // I_x(1, b) = 1 − (1−x)^b; I_x(a, a) = 1/2 at 1/2.
        for x in [0.05, 0.4, 0.9] {
            assert!((beta_i(1.0, 3.5, x) - (1.0 - (1f64 - x).powf(3.5))).abs() < 1e-13, "{x}");
        }
        assert!((beta_i(7.3, 7.3, 0.5) - 0.5).abs() < 1e-13);
    }

    #[test]
    fn quadrature_is_exact_for_polynomials() {
        for n in [1, 2, 5, 16, 96] {
            let rule = gauss_legendre(n);
            for power in [0, 1, 2 * n as i32 - 1] {
                let sum: f64 = rule.iter().map(|&(x, w)| f64::from(w) * f64::from(x).powi(power)).sum();
                assert!((sum * f64::from(power + 1) - 1.0).abs() < 2e-5, "{n} {power} {sum}");
            }
        }
    }

    #[test]
    fn erf_and_its_inverse() {
        for i in -400..=400 {
            let x = i as f32 / 100.0;
            let exact = (1.0 - gamma_q(0.5, f64::from(x * x))).copysign(f64::from(x));
            assert!((f64::from(erf(x)) - exact).abs() < 3e-7, "{x}");
            // Back from the exact value, where it is not yet 1 to single precision.
            if x.abs() < 2.5 {
                assert!((erf_inv(exact as f32) - x).abs() < 2e-4 * x.abs().max(0.1), "{x} {}", erf_inv(exact as f32));
            }
        }
    }
}
