//! Eight floats at a time: one set of operations, on plain arrays and on AVX2 registers.
//!
//! The kernels are written once over [`Lanes`]. The AVX2 version is worth its `unsafe`: see the table
//! `benches/results/trace-throughput.md`, column "portable".
#![allow(unsafe_code)] // Intrinsics; the only caller of Avx2 checks the processor first (see `Level`).

/// Code over [`Lanes`] must be `#[inline(always)]` throughout, without closures: what is not inlined into the caller that
/// enables AVX2 would be compiled without it.
///
/// Operations on eight lanes. Comparisons give a bit per lane, false where an operand is NaN.
pub(crate) trait Lanes: Copy {
    fn splat(x: f32) -> Self;
    fn load(x: &[f32; 8]) -> Self;
    fn store(self) -> [f32; 8];
    fn add(self, b: Self) -> Self;
    fn sub(self, b: Self) -> Self;
    fn mul(self, b: Self) -> Self;
    fn div(self, b: Self) -> Self;
    /// `self * b + c`, rounded once or twice.
    fn mul_add(self, b: Self, c: Self) -> Self;
    fn abs(self) -> Self;
    /// `b` where either is NaN.
    fn min(self, b: Self) -> Self;
    /// `b` where either is NaN.
    fn max(self, b: Self) -> Self;
    fn le(self, b: Self) -> u32;
    fn lt(self, b: Self) -> u32;
}

/// What the processor can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Level {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2,
}

impl Level {
    /// The best this machine has.
    pub(crate) fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("fma")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("lzcnt")
            && is_x86_feature_detected!("popcnt")
        {
            return Self::Avx2;
        }
        Self::Portable
    }
}

#[derive(Clone, Copy)]
pub(crate) struct Portable([f32; 8]);

impl Portable {
    #[inline(always)]
    fn zip(self, b: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|i| f(self.0[i], b.0[i])))
    }

    #[inline(always)]
    fn compare(self, b: Self, f: impl Fn(f32, f32) -> bool) -> u32 {
        (0..8).fold(0, |bits, i| bits | u32::from(f(self.0[i], b.0[i])) << i)
    }
}

impl Lanes for Portable {
    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self([x; 8])
    }
    #[inline(always)]
    fn load(x: &[f32; 8]) -> Self {
        Self(*x)
    }
    #[inline(always)]
    fn store(self) -> [f32; 8] {
        self.0
    }
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        self.zip(b, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        self.zip(b, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        self.zip(b, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, b: Self) -> Self {
        self.zip(b, |a, b| a / b)
    }
    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        self.mul(b).add(c)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        self.zip(self, |a, _| a.abs())
    }
    #[inline(always)]
    fn min(self, b: Self) -> Self {
        self.zip(b, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(self, b: Self) -> Self {
        self.zip(b, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn le(self, b: Self) -> u32 {
        self.compare(b, |a, b| a <= b)
    }
    #[inline(always)]
    fn lt(self, b: Self) -> u32 {
        self.compare(b, |a, b| a < b)
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) use avx2::Avx2;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::Lanes;
    use std::arch::x86_64::*;

    /// Only for code that runs after [`super::Level::detect`] said `Avx2`.
    #[derive(Clone, Copy)]
    pub(crate) struct Avx2(__m256);

    // SAFETY, for every block below: the intrinsics need AVX2 and FMA, which the one place that picks this type
    // checked; the loads and the store are of arrays of exactly eight floats.
    #[allow(clippy::undocumented_unsafe_blocks)]
    impl Lanes for Avx2 {
        #[inline(always)]
        fn splat(x: f32) -> Self {
            Self(unsafe { _mm256_set1_ps(x) })
        }
        #[inline(always)]
        fn load(x: &[f32; 8]) -> Self {
            Self(unsafe { _mm256_loadu_ps(x.as_ptr()) })
        }
        #[inline(always)]
        fn store(self) -> [f32; 8] {
            let mut x = [0.0; 8];
            unsafe { _mm256_storeu_ps(x.as_mut_ptr(), self.0) };
            x
        }
        #[inline(always)]
        fn add(self, b: Self) -> Self {
            Self(unsafe { _mm256_add_ps(self.0, b.0) })
        }
        #[inline(always)]
        fn sub(self, b: Self) -> Self {
            Self(unsafe { _mm256_sub_ps(self.0, b.0) })
        }
        #[inline(always)]
        fn mul(self, b: Self) -> Self {
            Self(unsafe { _mm256_mul_ps(self.0, b.0) })
        }
        #[inline(always)]
        fn div(self, b: Self) -> Self {
            Self(unsafe { _mm256_div_ps(self.0, b.0) })
        }
        #[inline(always)]
        fn mul_add(self, b: Self, c: Self) -> Self {
            Self(unsafe { _mm256_fmadd_ps(self.0, b.0, c.0) })
        }
        #[inline(always)]
        fn abs(self) -> Self {
            Self(unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0) })
        }
        #[inline(always)]
        fn min(self, b: Self) -> Self {
            Self(unsafe { _mm256_min_ps(self.0, b.0) })
        }
        #[inline(always)]
        fn max(self, b: Self) -> Self {
            Self(unsafe { _mm256_max_ps(self.0, b.0) })
        }
        #[inline(always)]
        fn le(self, b: Self) -> u32 {
            unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(self.0, b.0)) as u32 }
        }
        #[inline(always)]
        fn lt(self, b: Self) -> u32 {
            unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, b.0)) as u32 }
        }
    }
}

/// Calls `$call::<L>($arg, …)` compiled for the processor's [`Level`]. `$call` and all it calls must be
/// `#[inline(always)]`.
macro_rules! dispatch {
    ($level:expr, $call:ident($($arg:ident : $type:ty),*) -> $out:ty) => {{
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
        #[allow(unsafe_code)]
        fn avx2($($arg: $type),*) -> $out {
            $call::<crate::lanes::Avx2>($($arg),*)
        }
        match $level {
            #[cfg(target_arch = "x86_64")]
            #[allow(unsafe_code)]
            // SAFETY: the level was detected on this machine.
            crate::lanes::Level::Avx2 => unsafe { avx2($($arg),*) },
            crate::lanes::Level::Portable => $call::<crate::lanes::Portable>($($arg),*),
        }
    }};
}
pub(crate) use dispatch;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_arch = "x86_64")]
    fn avx2_agrees_with_arrays() {
        if Level::detect() != Level::Avx2 {
            eprintln!("skipped: no AVX2 here");
            return;
        }
        let a = [1.0, -2.0, 0.0, -0.0, f32::NAN, f32::INFINITY, 1e-40, 3e38];
        let b = [2.0, -2.0, -0.0, 5.0, 1.0, f32::NAN, 1e-41, 3.1e38];
        let (pa, pb) = (Portable::load(&a), Portable::load(&b));
        let (xa, xb) = (Avx2::load(&a), Avx2::load(&b));
        let same = |p: Portable, x: Avx2| {
            for (p, x) in p.store().iter().zip(x.store()) {
                assert!(p.to_bits() == x.to_bits() || p.is_nan() && x.is_nan(), "{p} {x}");
            }
        };
        same(pa.add(pb), xa.add(xb));
        same(pa.sub(pb), xa.sub(xb));
        same(pa.mul(pb), xa.mul(xb));
        same(pa.div(pb), xa.div(xb));
        same(pa.abs(), xa.abs());
        same(pa.min(pb), xa.min(xb));
        same(pa.max(pb), xa.max(xb));
        assert_eq!((pa.le(pb), pa.lt(pb)), (xa.le(xb), xa.lt(xb)));
    }
}
