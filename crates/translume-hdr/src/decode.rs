//! From code to log exposure, for sources with a response curve and for linear ones, with what is known about each value.

use crate::Response;
use crate::weight::spline;

/// A code at or above this is clipped (sources with a curve).
pub(crate) const CLIPPED: f32 = 0.985;
/// A code at or below this is lost in black.
pub(crate) const BLACK: f32 = 0.012;

/// How the values of one picture become log exposure.
#[derive(Clone, Debug)]
pub(crate) enum Decoder {
    /// Codes in [0, 1] through a response curve.
    Curve {
        /// The curve.
        response: Response,
        /// Uncertainty of a code, in the same unit: rounding, compression and noise.
        blur: f32,
    },
    /// Values proportional to exposure, clipped at `clip` (infinite if they are not).
    Float {
        /// The value at which the picture is clipped.
        clip: f32,
        /// A value that fills the range, for weights: the clip, or the largest value.
        full: f32,
    },
}

/// Float values are trusted to this share, and in absolute terms to `FLOAT_FLOOR` of full range.
const FLOAT_RELATIVE: f32 = 0.02;
const FLOAT_FLOOR: f32 = 2e-4;

impl Decoder {
    /// ln of exposure.
    #[inline]
    pub(crate) fn log_exposure(&self, channel: usize, u: f32) -> f32 {
        match self {
            Self::Curve { response, .. } => response.log_exposure(channel, u),
            Self::Float { full, .. } => u.max(full * 1e-6).ln(),
        }
    }

    /// The code on a display-like scale in [0, 1], for weights.
    #[inline]
    pub(crate) fn encoded(&self, u: f32) -> f32 {
        match self {
            Self::Curve { .. } => u,
            Self::Float { full, .. } => (u / full).clamp(0.0, 1.0).powf(1.0 / 2.2),
        }
    }

    /// Whether the value is a lower bound only.
    #[inline]
    pub(crate) fn is_clipped(&self, u: f32) -> bool {
        match self {
            Self::Curve { .. } => u >= CLIPPED,
            Self::Float { clip, .. } => u >= clip * 0.999,
        }
    }

    /// Whether the value is an upper bound only.
    #[inline]
    pub(crate) fn is_black(&self, u: f32) -> bool {
        match self {
            Self::Curve { .. } => u <= BLACK,
            Self::Float { full, .. } => u <= full * FLOAT_FLOOR,
        }
    }

    /// The interval of log exposure that values from `low` to `high` stand for; infinite where clipped or black.
    #[inline]
    pub(crate) fn interval(&self, channel: usize, low: f32, high: f32) -> (f32, f32) {
        match self {
            Self::Curve { response, blur } => {
                let lo = if low - blur <= BLACK {
                    f32::NEG_INFINITY
                } else {
                    response.log_exposure(channel, low.min(CLIPPED) - blur)
                };
                let hi = if high >= CLIPPED - blur {
                    f32::INFINITY
                } else {
                    response.log_exposure(channel, high.max(BLACK) + blur)
                };
                (lo, hi)
            }
            Self::Float { clip, full } => {
                let floor = full * FLOAT_FLOOR;
                let lo = if low <= 2.0 * floor {
                    f32::NEG_INFINITY
                } else {
                    (low * (1.0 - FLOAT_RELATIVE) - floor).max(floor).ln()
                };
                let hi =
                    if high >= clip * 0.999 { f32::INFINITY } else { (high * (1.0 + FLOAT_RELATIVE) + floor).ln() };
                (lo, hi)
            }
        }
    }

    /// Log exposures between which the picture tells scene points apart.
    pub(crate) fn useful_range(&self, channel: usize) -> (f32, f32) {
        match self {
            Self::Curve { response, .. } => {
                (response.log_exposure(channel, 0.03), response.log_exposure(channel, 0.965))
            }
            Self::Float { clip, full } => {
                ((full * 4e-3).ln(), if clip.is_finite() { (clip * 0.97).ln() } else { f32::INFINITY })
            }
        }
    }

    /// The thesis' weight of a value.
    #[inline]
    pub(crate) fn spline_weight(&self, u: f32) -> f32 {
        match self {
            Self::Curve { .. } => spline(u),
            Self::Float { .. } => {
                // An unclipped float picture has no bad end at the top.
                let e = self.encoded(u);
                if e > 0.5 && !self.can_clip() { 1.0 } else { spline(e) }
            }
        }
    }

    fn can_clip(&self) -> bool {
        matches!(self, Self::Curve { .. }) || matches!(self, Self::Float { clip, .. } if clip.is_finite())
    }
}
