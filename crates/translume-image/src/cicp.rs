//! Colour by the code points of ITU-T H.273: what the cICP chunk of PNG and the cicp tag of ICC profiles say.
//!
//! Transfers are taken back to light: camera curves (BT.709 and its kin, HLG) to the light in front of the camera by
//! the inverse of the printed curve, PQ to the light of the display. 1 is reference white: 203 cd/m² of PQ, and the
//! same white, 75 % of the signal, of HLG (ITU-R BT.2408, table 1).

use crate::colour::{self, D65, Space};

/// cd/m² that 1 stands for in pictures that were PQ (ITU-R BT.2408).
pub(crate) const PQ_REFERENCE_WHITE: f32 = 203.0;

/// A transfer curve by its code point, and the range of the codes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Curve {
    transfer: u8,
    /// Code in [0, 1] to signal: `scale · code + offset`.
    scale: f32,
    offset: f32,
}

impl Curve {
    /// The curve of `transfer`, if it is one that is known here; `bits` are those of a stored code.
    pub(crate) fn new(transfer: u8, full_range: bool, bits: u8) -> Option<Self> {
        if !matches!(transfer, 1 | 4..=18) {
            return None;
        }
        let (scale, offset) = if full_range {
            (1.0, 0.0)
        } else {
            // H.273 §8.3: black is 16, white is 235, times 2^(bits - 8).
            let step = f32::from(1u16 << (bits.max(8) - 8));
            let full = (2.0f32).powi(i32::from(bits.max(8))) - 1.0;
            (full / (219.0 * step), -16.0 / 219.0)
        };
        Some(Self { transfer, scale, offset })
    }

    /// Whether the signal stands for light only up to a scale that the display chooses.
    pub(crate) fn is_hlg(&self) -> bool {
        self.transfer == 18
    }

    /// Light of a code in [0, 1].
    pub(crate) fn light(&self, code: f32) -> f32 {
        let v = self.scale * code + self.offset;
        let odd = |f: &dyn Fn(f32) -> f32| f(v.abs()).copysign(v);
        match self.transfer {
            4 => odd(&|v| v.powf(2.2)),
            5 => odd(&|v| v.powf(2.8)),
            7 => odd(&|v| if v < 0.0913 { v / 4.0 } else { ((v + 0.1115) / 1.1115).powf(1.0 / 0.45) }),
            8 => v,
            9 => logarithmic(v, 2.0),
            10 => logarithmic(v, 2.5),
            13 => colour::srgb_to_linear(v),
            16 => 10000.0 / PQ_REFERENCE_WHITE * pq(v),
            17 => odd(&|v| v.powf(2.6) * 52.37 / 48.0),
            18 => hlg(v) / hlg(0.75),
            // 1, 6, 14 and 15; 11 and 12 are the same where the signal is positive.
            _ => odd(&|v| {
                const ALPHA: f32 = 1.099_296_8;
                const BETA: f32 = 0.018_053_97;
                if v < 4.5 * BETA { v / 4.5 } else { ((v + ALPHA - 1.0) / ALPHA).powf(1.0 / 0.45) }
            }),
        }
    }
}

fn logarithmic(v: f32, decades: f32) -> f32 {
    if v <= 0.0 { 0.0 } else { (10.0f32).powf(decades * (v - 1.0)) }
}

/// Light in 10000 cd/m² (SMPTE ST 2084, Eq. 4.1).
fn pq(v: f32) -> f32 {
    const M1: f64 = 2610.0 / 16384.0;
    const M2: f64 = 2523.0 / 4096.0 * 128.0;
    const C1: f64 = 3424.0 / 4096.0;
    const C2: f64 = 2413.0 / 4096.0 * 32.0;
    const C3: f64 = 2392.0 / 4096.0 * 32.0;
    let p = f64::from(v.clamp(0.0, 1.0)).powf(1.0 / M2);
    ((p - C1).max(0.0) / (C2 - C3 * p)).powf(1.0 / M1) as f32
}

/// Scene light in [0, 1] (ITU-R BT.2100, table 5: the inverse OETF).
fn hlg(v: f32) -> f32 {
    const A: f32 = 0.178_832_77;
    const B: f32 = 0.284_668_92;
    const C: f32 = 0.559_910_73;
    let a = v.abs();
    let light = if a <= 0.5 { a * a / 3.0 } else { (((a - C) / A).exp() + B) / 12.0 };
    light.copysign(v)
}

/// Primaries and white by their code point (H.273, table 2); `None` for those that are unspecified or reserved.
pub(crate) fn space(primaries: u8) -> Option<Space> {
    const C: [f64; 2] = [0.310, 0.316];
    let (primaries, white) = match primaries {
        1 => return Some(Space::REC709),
        4 => ([[0.67, 0.33], [0.21, 0.71], [0.14, 0.08]], C),
        5 => ([[0.64, 0.33], [0.29, 0.60], [0.15, 0.06]], D65),
        6 | 7 => ([[0.630, 0.340], [0.310, 0.595], [0.155, 0.070]], D65),
        8 => ([[0.681, 0.319], [0.243, 0.692], [0.145, 0.049]], C),
        9 => return Some(Space::REC2020),
        10 => ([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]], [1.0 / 3.0; 2]),
        11 => ([[0.680, 0.320], [0.265, 0.690], [0.150, 0.060]], [0.314, 0.351]),
        12 => ([[0.680, 0.320], [0.265, 0.690], [0.150, 0.060]], D65),
        22 => ([[0.630, 0.340], [0.295, 0.605], [0.155, 0.077]], D65),
        _ => return None,
    };
    Some(Space { primaries, white })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn light(transfer: u8, code: f32) -> f32 {
        Curve::new(transfer, true, 8).unwrap().light(code)
    }

    fn near(got: f32, expected: f32) {
        assert!((got - expected).abs() <= 2e-4 * expected.abs() + 1e-6, "{got} instead of {expected}");
    }

    #[test]
    fn pq_has_the_luminances_of_its_standard() {
        // Codes and cd/m² as ITU-R BT.2408 and ST 2084 print them.
        for (code, cd_m2) in [(0.0, 0.0), (0.508_078_4, 100.0), (0.580_688_9, 203.0), (0.751_827_1, 1000.0), (1.0, 1e4)]
        {
            let got = light(16, code) * PQ_REFERENCE_WHITE;
            assert!((got - cd_m2).abs() <= 5e-4 * cd_m2 + 1e-4, "{got} instead of {cd_m2}");
        }
    }

    #[test]
    fn hlg_has_reference_white_at_three_quarters() {
        near(light(18, 0.75), 1.0);
        // BT.2100: a signal of one half is a twelfth of the scene light that a signal of 1 is.
        near(light(18, 1.0) / light(18, 0.5), 12.0);
        near(light(18, 0.25) / light(18, 0.5), 0.25);
    }

    #[test]
    fn the_other_curves_end_at_one_and_join() {
        for transfer in [1, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15] {
            near(light(transfer, 1.0), 1.0);
        }
        near(light(1, 0.081), 0.018);
        near(light(1, 0.5), 0.259_72); // ((0.5 + 0.0992968) / 1.0992968)^(1 / 0.45)
        near(light(9, 0.5), 0.1);
        assert!(
            Curve::new(2, true, 8).is_none() && Curve::new(0, true, 8).is_none() && Curve::new(19, true, 8).is_none()
        );
    }

    #[test]
    fn narrow_range_stretches_16_to_235() {
        let eight = Curve::new(8, false, 8).unwrap();
        near(eight.light(16.0 / 255.0), 0.0);
        near(eight.light(235.0 / 255.0), 1.0);
        let sixteen = Curve::new(8, false, 16).unwrap();
        near(sixteen.light(4096.0 / 65535.0), 0.0);
        near(sixteen.light(60160.0 / 65535.0), 1.0);
    }

    #[test]
    fn every_space_that_is_named_spans_a_triangle() {
        let known: Vec<u8> = (0..=255).filter(|&p| space(p).is_some()).collect();
        assert_eq!(known, [1, 4, 5, 6, 7, 8, 9, 10, 11, 12, 22]);
        for p in known {
            let white = colour::product_vec(&space(p).unwrap().to(&Space::REC709), [1.0; 3]);
            assert!(white.iter().all(|v| (v - 1.0).abs() < 1e-9), "{p}");
        }
    }
}
