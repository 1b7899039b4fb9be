//! OpenEXR luminance/chroma pictures: Y, RY = (R − Y)/Y and BY = (B − Y)/Y.

use crate::colour::Space;

/// Turns interleaved RY, Y, BY (and alpha, if `slots` is 4) into R, G, B in place.
///
/// Y is the luminance in the file's own primaries (Rec. 709 without `chromaticities`).
pub(crate) fn to_rgb(samples: &mut [f32], slots: usize, chromaticities: Option<[[f32; 2]; 4]>) {
    let space = chromaticities.and_then(Space::from_chromaticities).unwrap_or(Space::REC709);
    let [wr, wg, wb] = space.luminance_weights().map(|w| w as f32);
    for p in samples.chunks_exact_mut(slots) {
        let (ry, y, by) = (p[0], p[1], p[2]);
        let (r, b) = ((ry + 1.0) * y, (by + 1.0) * y);
        p[0] = r;
        p[1] = (y - wr * r - wb * b) / wg;
        p[2] = b;
    }
}
