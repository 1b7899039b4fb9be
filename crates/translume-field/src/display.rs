//! Displays.

/// What a display shows of light relative to white.
#[inline]
pub fn shown(x: f32) -> f32 {
    x.clamp(0.0, 1.0).powf(1.0 / 2.2) // [Menzel 2012, §4.6]
}
