//! The scale on which a stack is taken apart: log light [Menzel 2012, §4.2 logarithm], and what is measured beside it.
//!
//! A value is light divided by the stack's white, so that the offset δ and the scale of 16-bit floats mean the same for
//! any source. δ is an offset against the noise floor: light far below it is noise, and the logarithm is nearly linear
//! there. On a display that has a curve of infinite slope at black, steps that are even in light are coarse there: parts of a picture that
//! should be black glow, and where they are stored with different numbers of layers the borders show. [`Domain::Root`], the default,
//! takes the logarithm of the root of light: near black its steps are even on a display, in the light they are even in stops.

use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use translume_image::metrics;

/// A monotonic scale of light.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", tag = "kind")]
pub enum Domain {
    /// ln(δ + x).
    Log {
        /// Offset as a share of white.
        delta: f32,
    },
    /// ln(δ + √x).
    Root {
        /// Offset: a root of a share of white.
        delta: f32,
    },
    /// x.
    Linear,
    /// The sRGB curve of x, continued beyond 1 by its own formula.
    Display,
    /// PU21, divided by 100, with white at 100 cd/m².
    Pu21,
}

impl Default for Domain {
    fn default() -> Self {
        Self::Root { delta: 0.2 }
    }
}

impl Domain {
    /// δ of the thesis' own method here: about three codes of an 8-bit file above black.
    pub const THESIS: Self = Self::Log { delta: 1e-3 };

    pub(crate) fn check(self) -> Result<Self> {
        match self {
            Self::Log { delta } | Self::Root { delta } if !(delta > 0.0 && delta < 1e3) => {
                Err(Error::Parameter(format!("an offset of {delta} in the logarithm: it must be positive")))
            }
            domain => Ok(domain),
        }
    }

    /// The value of light `x`, relative to white; negative light counts as none.
    pub fn value(self, x: f32) -> f32 {
        let x = x.max(0.0);
        match self {
            // [Menzel 2012, §4.2 logarithm]
            Self::Log { delta } => (delta + x).ln(),
            Self::Root { delta } => (delta + x.sqrt()).ln(),
            Self::Linear => x,
            Self::Display => translume_image::colour::linear_to_srgb(x),
            Self::Pu21 => (metrics::pu21_encode(100.0 * f64::from(x)) / 100.0) as f32,
        }
    }

    /// [`Domain::value`] of each sample in place.
    pub fn values(self, light: &mut [f32]) {
        match self {
            Self::Log { delta } => light.iter_mut().for_each(|x| *x = ln(delta + x.max(0.0))),
            Self::Root { delta } => light.iter_mut().for_each(|x| *x = ln(delta + x.max(0.0).sqrt())),
            domain => light.iter_mut().for_each(|x| *x = domain.value(*x)),
        }
    }

    /// Light, relative to white, of each value in place; what falls below no light is none.
    #[inline(always)]
    pub fn light(self, values: &mut [f32]) {
        match self {
            // [Menzel 2012, §4.4 inverse]
            Self::Log { delta } => values.iter_mut().for_each(|v| *v = (exp(*v) - delta).clamp_light()),
            Self::Root { delta } => values.iter_mut().for_each(|v| {
                let root = (exp(*v) - delta).max(0.0);
                *v = (root * root).clamp_light();
            }),
            Self::Linear => values.iter_mut().for_each(|v| *v = v.clamp_light()),
            Self::Display => {
                values
                    .iter_mut()
                    .for_each(|v| *v = translume_image::colour::srgb_to_linear(v.clamp_light()).clamp_light());
            }
            Self::Pu21 => {
                // The scale begins at 0.005 cd/m².
                let light = |v: f32| (metrics::pu21_decode(100.0 * f64::from(v)) / 100.0) as f32;
                values.iter_mut().for_each(|v| *v = if *v > 0.0 { light(*v).clamp_light() } else { 0.0 });
            }
        }
    }
}

/// The most light there is, relative to white: sums of damaged files end here and not at infinity.
pub(crate) const MOST_LIGHT: f32 = 1e18;

trait ClampLight {
    /// Between 0 and [`MOST_LIGHT`]; NaN is 0.
    fn clamp_light(self) -> Self;
}

impl ClampLight for f32 {
    #[inline(always)]
    fn clamp_light(self) -> Self {
        if self > 0.0 { self.min(MOST_LIGHT) } else { 0.0 }
    }
}

/// e^x to a relative error of 2e-7·max(1, |x|), without branches so that it vectorises; clamped where floats end.
#[inline(always)]
pub(crate) fn exp(x: f32) -> f32 {
    let y = (x * std::f32::consts::LOG2_E).clamp(-126.0, 127.0);
    // Round to nearest by the bits of 1.5 · 2^23; the remainder r is within ±1/2.
    const MAGIC: f32 = 12_582_912.0;
    let shifted = y + MAGIC;
    let whole = shifted - MAGIC;
    let r = y - whole;
    // Taylor series of 2^r; the last term left out is below 2e-8.
    let p = 1.540_353_e-4f32;
    let p = p * r + 1.333_355_8e-3;
    let p = p * r + 9.618_129e-3;
    let p = p * r + 5.550_411e-2;
    let p = p * r + 0.240_226_5;
    let p = p * r + std::f32::consts::LN_2;
    let p = p * r + 1.0;
    let bits = shifted.to_bits().wrapping_sub(MAGIC.to_bits()).wrapping_add(127) << 23;
    p * f32::from_bits(bits)
}

/// The natural logarithm of a positive normal number to 1e-6, without branches so that it vectorises.
#[inline(always)]
pub(crate) fn ln(v: f32) -> f32 {
    // v = m 2^e with m in [√½, √2), and a series in (m − 1)/(m + 1) about m = 1.
    let bits = v.to_bits();
    let e = (bits.wrapping_sub(0x3f35_04f3) as i32) >> 23;
    let m = f32::from_bits(bits.wrapping_sub((e << 23) as u32));
    let t = (m - 1.0) / (m + 1.0);
    let t2 = t * t;
    2.0 * t * (1.0 + t2 * (1.0 / 3.0 + t2 * (0.2 + t2 * (1.0 / 7.0)))) + e as f32 * std::f32::consts::LN_2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_comes_back_from_every_scale() {
        let log = Domain::Log { delta: 0.01 };
        for domain in [Domain::default(), log, Domain::THESIS, Domain::Linear, Domain::Display, Domain::Pu21] {
            for x in [0.0f32, 1e-4, 0.02, 0.7, 1.0, 40.0] {
                let mut v = [domain.value(x)];
                domain.light(&mut v);
                // PU21 ends at 0.005 cd/m².
                assert!(
                    (v[0] - x).abs() <= 4e-6 * (1.0 + x) + if domain == Domain::Pu21 { 6e-5 } else { 0.0 },
                    "{domain:?}: {x} became {}",
                    v[0]
                );
            }
            assert_eq!(domain.value(-1.0), domain.value(0.0));
        }
    }

    /// An error of the same size anywhere shows by about as much near black as at a tenth of white, and in stops by the same in the light.
    #[test]
    fn the_default_scale_is_even_on_a_display_near_black_and_in_stops_above() {
        let moved = |domain: Domain, x: f32| {
            let mut v = [domain.value(x) + 0.01];
            domain.light(&mut v);
            v[0]
        };
        let shows = |domain, x: f32| moved(domain, x).powf(1.0 / 2.2) - x.powf(1.0 / 2.2);
        let ratio = |domain| shows(domain, 0.0) / shows(domain, 0.1);
        assert!(ratio(Domain::default()) < 1.2 && ratio(Domain::Log { delta: 0.01 }) > 4.0);
        let stops = |x: f32| (moved(Domain::default(), x) / x).log2();
        assert!((stops(4e3) / stops(1e2) - 1.0).abs() < 0.05);
    }

    #[test]
    fn the_quick_exponential_is_exact_to_a_few_bits() {
        for i in -8700..8800 {
            let x = i as f32 * 0.01;
            let exact = f64::from(x).exp();
            let error = (f64::from(exp(x)) / exact - 1.0).abs();
            assert!(error < 2e-7 * f64::from(x.abs().max(1.0)) + 1e-7, "{x}: {error:e}");
        }
        assert!(exp(-1e30) >= 0.0 && exp(1e30).is_finite());
    }

    #[test]
    fn the_quick_logarithm_is_exact_to_a_few_bits() {
        for i in -2000..2000 {
            let x = (i as f32 * 0.04).exp();
            assert!((f64::from(ln(x)) - f64::from(x).ln()).abs() < 1e-6 * (1.0 + (i as f64 * 0.04).abs()), "{x}");
        }
    }
}
