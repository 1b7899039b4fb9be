//! Exponential and logarithm of a block of numbers, without branches and calls, so that the compiler makes vectors of them.
//!
//! Argument reduction by powers of two and a polynomial (Taylor's for e^x, that of artanh for ln). No fused operations: the
//! result has the same bits with and without AVX2. Relative error below 1e-14 for exp, absolute below 1e-15 + 2e-16 |ln x|.

/// Numbers of a block.
pub(crate) const LANES: usize = 16;

/// A block of numbers.
pub(crate) type Block = [f64; LANES];

/// 1.5 · 2^52: adding it rounds to an integer and leaves that in the low bits.
const ROUND: f64 = 6_755_399_441_055_744.0;
const LN2_HIGH: f64 = 6.931_471_803_691_238e-1;
const LN2_LOW: f64 = 1.908_214_929_270_587_7e-10;

/// e^x; for x below −700 e^−700, above 700 e^700.
#[inline(always)]
pub(crate) fn exp(x: f64) -> f64 {
    let x = x.clamp(-700.0, 700.0);
    let shifted = x * std::f64::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let t = (x - n * LN2_HIGH) - n * LN2_LOW;
    let mut p = 1.0 / 39_916_800.0;
    for inverse_factorial in [
        1.0 / 3_628_800.0,
        1.0 / 362_880.0,
        1.0 / 40_320.0,
        1.0 / 5_040.0,
        1.0 / 720.0,
        1.0 / 120.0,
        1.0 / 24.0,
        1.0 / 6.0,
        0.5,
        1.0,
        1.0,
    ] {
        p = p * t + inverse_factorial;
    }
    p * f64::from_bits((shifted.to_bits() << 52).wrapping_add(1f64.to_bits()))
}

/// ln x of a positive normal number; for others some number.
#[inline(always)]
pub(crate) fn ln(x: f64) -> f64 {
    // x = 2^e m with m in [√½, √2): e is found by subtracting the bits of √½.
    const SQRT_HALF: u64 = 0x3fe6_a09e_667f_3bcd;
    const EXPONENT: u64 = 0xfff0_0000_0000_0000;
    const TWO_52: u64 = 0x4330_0000_0000_0000;
    let above = x.to_bits().wrapping_sub(SQRT_HALF);
    let m = f64::from_bits(x.to_bits().wrapping_sub(above & EXPONENT));
    // e + 2048 as a float, through the mantissa of 2^52.
    let e = f64::from_bits((above.wrapping_add(1 << 63) >> 52) | TWO_52) - (4_503_599_627_370_496.0 + 2048.0);
    let s = (m - 1.0) / (m + 1.0);
    let z = s * s;
    let mut p = 1.0 / 19.0;
    for odd in [17.0, 15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0, 1.0] {
        p = p * z + 1.0 / odd;
    }
    e * LN2_LOW + 2.0 * s * p + e * LN2_HIGH
}

/// Calls `$call::<T, …>($arg, …)` compiled for AVX2 where the machine has it. `$call` and all it calls on its hot path must
/// be `#[inline(always)]`.
macro_rules! with_avx2 {
    ([$($generics:tt)*], $call:ident, ($($arg:ident : $type:ty),* $(,)?) -> $out:ty) => {{
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn avx2<$($generics)*>($($arg: $type),*) -> $out {
                $call($($arg),*)
            }
            if std::arch::is_x86_feature_detected!("avx2") {
                #[allow(unsafe_code, reason = "more fits per second, see benches/results/scatter-fit.md")]
                // SAFETY: the machine has AVX2, which is all that the function asks for.
                return unsafe { avx2($($arg),*) };
            }
        }
        $call($($arg),*)
    }};
}
pub(crate) use with_avx2;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agree_with_the_standard_library() {
        for i in -70_000..70_000 {
            let x = f64::from(i) * 0.01 + 0.0037;
            let (e, exact) = (exp(x.clamp(-699.9, 699.9)), x.clamp(-699.9, 699.9).exp());
            assert!((e / exact - 1.0).abs() < 1e-14, "exp {x}: {e} {exact}");
            let y = (x * 0.9).exp();
            assert!((ln(y) - y.ln()).abs() <= 1e-15 + 2.3e-16 * y.ln().abs(), "ln {y}: {} {}", ln(y), y.ln());
            let near = 1.0 + f64::from(i) * 3e-6;
            assert!((ln(near) - near.ln()).abs() <= 3e-16, "ln {near}");
        }
        assert_eq!((exp(0.0), ln(1.0)), (1.0, 0.0));
        assert!(exp(-1e300) > 0.0 && exp(-1e300) < 1e-300 && exp(1e300) > 1e300);
    }
}
