//! From code to log exposure, for sources with a response curve and for linear ones, with what is known about each value.

use crate::Response;
use crate::weight::spline;

/// A code at or above this is clipped, whatever the histogram says (sources with a curve).
pub(crate) const CLIPPED: f32 = 0.985;
/// How far below the pile of its clipped pixels a picture counts as clipped.
pub(crate) const BELOW_PILE: f32 = 2.5 / 255.0;
/// A code at or below this is lost in black: cameras leave a pedestal of several codes, which says nothing of light.
pub(crate) const BLACK: f32 = 0.035;

/// Bins of the noise table over the encoded range.
pub(crate) const NOISE_BINS: usize = 16;

/// How the values of one picture become log exposure.
#[derive(Clone, Debug)]
pub(crate) struct Decoder {
    /// What the values are.
    pub(crate) kind: Kind,
    /// Uncertainty of an encoded value (rounding, compression, noise) at the middle of each bin, about two standard
    /// deviations.
    pub(crate) blur: [f32; NOISE_BINS],
}

/// What the values of a picture are.
#[derive(Clone, Debug)]
pub(crate) enum Kind {
    /// Codes in [0, 1] through a response curve, clipped at `clip` of each channel.
    Curve {
        /// The curve.
        response: Response,
        /// The codes at which the camera clips, a little below where the histograms of the channels pile up.
        clip: [f32; 3],
    },
    /// Values proportional to exposure, clipped at `clip` (infinite if they are not).
    Float {
        /// The values at which the channels are clipped.
        clip: [f32; 3],
        /// A value that fills the range, for weights: the clip, or the largest value.
        full: f32,
    },
}

/// Float values below this share of full range are black.
const FLOAT_FLOOR: f32 = 2e-4;
/// Further uncertainty of codes above 0.9, downwards, per unit of code.
const SHOULDER: f32 = 0.8;
/// Exponent of the display-like scale of float values.
const GAMMA: f32 = 2.2;

impl Decoder {
    /// ln of exposure.
    #[inline]
    pub(crate) fn log_exposure(&self, channel: usize, u: f32) -> f32 {
        match &self.kind {
            Kind::Curve { response, .. } => response.log_exposure(channel, u),
            Kind::Float { full, .. } => u.max(full * 1e-6).ln(),
        }
    }

    /// The value on a display-like scale in [0, 1].
    #[inline]
    pub(crate) fn encoded(&self, u: f32) -> f32 {
        match self.kind {
            Kind::Curve { .. } => u,
            Kind::Float { full, .. } => (u / full).clamp(0.0, 1.0).powf(1.0 / GAMMA),
        }
    }

    /// Whether the value is a lower bound only.
    #[inline]
    pub(crate) fn is_clipped(&self, channel: usize, u: f32) -> bool {
        u >= self.clip(channel)
    }

    /// The value from which on the channel is clipped; infinite if it is not.
    #[inline]
    pub(crate) fn clip(&self, channel: usize) -> f32 {
        match self.kind {
            Kind::Curve { clip, .. } => clip[channel],
            Kind::Float { clip, .. } => clip[channel] * 0.999,
        }
    }

    /// The value at which the clipped pixels of a channel pile up.
    pub(crate) fn white(&self, channel: usize) -> f32 {
        match self.kind {
            Kind::Curve { clip, .. } if clip[channel] < CLIPPED => clip[channel] + BELOW_PILE,
            Kind::Curve { .. } => 1.0,
            Kind::Float { clip, .. } => clip[channel],
        }
    }

    /// Whether the value is an upper bound only.
    #[inline]
    pub(crate) fn is_black(&self, u: f32) -> bool {
        match self.kind {
            Kind::Curve { .. } => u <= BLACK,
            Kind::Float { full, .. } => u <= full * FLOAT_FLOOR,
        }
    }

    /// The interval of log exposure that values from `low` to `high` stand for; infinite where clipped or black.
    #[inline]
    pub(crate) fn interval(&self, channel: usize, low: f32, high: f32) -> (f32, f32) {
        match &self.kind {
            Kind::Curve { response, clip } => {
                let clip = clip[channel];
                // Cameras compress highlights near the end of the range by more than any one curve.
                let shoulder = SHOULDER * (low - (clip - 0.085)).max(0.0);
                let (low, high) = (low.min(clip) - self.blur_at(low) - shoulder, high + self.blur_at(high));
                let lo = if low <= BLACK { f32::NEG_INFINITY } else { response.log_exposure(channel, low) };
                let hi = if high >= clip { f32::INFINITY } else { response.log_exposure(channel, high.max(BLACK)) };
                (lo, hi)
            }
            Kind::Float { clip, full } => {
                let clip = clip[channel];
                let clipped = high >= clip * 0.999;
                let (low, high) = (self.encoded(low), self.encoded(high));
                let (low, top) = (low - self.blur_at(low), high + self.blur_at(high));
                let value = |e: f32| full.ln() + GAMMA * e.ln();
                let black = FLOAT_FLOOR.powf(1.0 / GAMMA);
                let lo = if low <= black { f32::NEG_INFINITY } else { value(low) };
                let hi = if clipped || clip.is_finite() && top >= self.encoded(clip) {
                    f32::INFINITY
                } else {
                    value(top.max(black))
                };
                (lo, hi)
            }
        }
    }

    /// The uncertainty of an encoded value.
    #[inline]
    fn blur_at(&self, e: f32) -> f32 {
        self.blur[((e * NOISE_BINS as f32) as usize).min(NOISE_BINS - 1)]
    }

    /// Log exposures between which the picture tells scene points apart; infinite at the top of an unclipped picture.
    pub(crate) fn useful_range(&self, channel: usize) -> (f32, f32) {
        match &self.kind {
            Kind::Curve { response, clip } => {
                (response.log_exposure(channel, 0.03), response.log_exposure(channel, clip[channel] - 0.02))
            }
            Kind::Float { clip, full } => {
                let clip = clip[channel];
                ((full * 4e-3).ln(), if clip.is_finite() { (clip * 0.97).ln() } else { f32::INFINITY })
            }
        }
    }

    /// Log exposure of full range.
    pub(crate) fn full_range(&self, channel: usize) -> f32 {
        match &self.kind {
            Kind::Curve { response, .. } => response.log_exposure(channel, 1.0),
            Kind::Float { full, .. } => full.ln(),
        }
    }

    /// The thesis' weight of a value; an unclipped float picture has no bad end at the top.
    #[inline]
    pub(crate) fn spline_weight(&self, channel: usize, u: f32) -> f32 {
        let e = self.encoded(u);
        match self.kind {
            Kind::Float { clip, .. } if clip[channel].is_infinite() && e > 0.5 => 1.0,
            _ => spline(e),
        }
    }
}

/// Where the channels of float values are clipped: at their largest value, if they pile up there. A highlight that is
/// the largest by chance does not.
pub(crate) fn float_levels(v: &[f32]) -> [f32; 3] {
    std::array::from_fn(|c| {
        let own = || v.iter().skip(c).step_by(3);
        let most = own().copied().fold(0.0f32, f32::max);
        let at_most = own().filter(|x| **x >= most * 0.9999).count();
        if most > 0.0 && at_most > 8.max(v.len() / 60_000) { most } else { f32::INFINITY }
    })
}
