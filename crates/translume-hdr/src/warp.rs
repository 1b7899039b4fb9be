//! Rows of a picture as the anchor sees them: unit codes looked up through the displacement field.

use crate::clip;
use crate::exposure::Shot;
use crate::field::Field;
use crate::plane::catmull_rom;

/// Rows `y0..y1` of a picture in the anchor's frame.
pub(crate) struct Strip {
    pub(crate) width: usize,
    /// Interleaved RGB unit codes.
    pub(crate) codes: Vec<f32>,
    /// Whether the picture sees the pixel at all.
    pub(crate) seen: Vec<bool>,
    /// The marks of [`crate::clip`].
    pub(crate) marks: Vec<u8>,
}

impl Strip {
    /// Whether the picture says of a channel only that the scene is at least so bright.
    #[inline]
    pub(crate) fn is_clipped(&self, i: usize, c: usize) -> bool {
        self.marks[i] & 1 << c != 0
    }

    /// Whether the pixel may be ringing of what is clipped beside it.
    #[inline]
    pub(crate) fn may_ring(&self, shot: &Shot<'_>, i: usize) -> bool {
        self.marks[i] & clip::BESIDE != 0 && clip::may_ring(shot, &self.codes[3 * i..3 * i + 3])
    }

    #[inline]
    pub(crate) fn pixel(&self, i: usize) -> [f32; 3] {
        [self.codes[3 * i], self.codes[3 * i + 1], self.codes[3 * i + 2]]
    }
}

/// Looks rows `rows` up through `field`.
///
/// Catmull–Rom in the code domain, kept inside the range of the four pixels around the position; a value of which one
/// of those four is clipped is clipped too, so that no mixture of clipped and good pixels passes for good.
pub(crate) fn strip(shot: &Shot<'_>, field: &Field, rows: std::ops::Range<usize>) -> Strip {
    let w = shot.width();
    let n = rows.len() * w;
    let mut out = Strip { width: w, codes: vec![0.0; 3 * n], seen: vec![true; n], marks: vec![0; n] };
    if field.is_identity() {
        for (k, y) in rows.enumerate() {
            shot.unit_row(y, &mut out.codes[3 * k * w..3 * (k + 1) * w]);
            for x in 0..w {
                out.seen[k * w + x] = shot.is_picture(y * w + x);
            }
            if let Some(marks) = &shot.clips {
                out.marks[k * w..(k + 1) * w].copy_from_slice(&marks[y * w..(y + 1) * w]);
            }
        }
        return out;
    }
    let (first, window) = source_rows(shot, field, &rows);
    for (k, y) in rows.enumerate() {
        for x in 0..w {
            let (sx, sy) = field.source(x as f32, y as f32);
            let i = k * w + x;
            match lookup(shot, &window, first, sx, sy) {
                Some((rgb, marks)) => {
                    out.codes[3 * i..3 * i + 3].copy_from_slice(&rgb);
                    out.marks[i] = marks;
                }
                None => out.seen[i] = false,
            }
        }
    }
    out
}

/// Pixels of three channels in four lanes; the last is not used.
type Lanes = [f32; 4];

/// The source rows that a strip reads, as unit codes, and the index of the first.
fn source_rows(shot: &Shot<'_>, field: &Field, rows: &std::ops::Range<usize>) -> (usize, Vec<Lanes>) {
    let (w, h) = (shot.width(), shot.height());
    let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
    for y in rows.clone() {
        for x in (0..w).step_by(8).chain([w - 1]) {
            let sy = field.source(x as f32, y as f32).1;
            low = low.min(sy);
            high = high.max(sy);
        }
    }
    // Between samples 8 pixels apart a field with jumps can reach a little further.
    let margin = 8.0;
    let first = (low - margin).clamp(0.0, (h - 1) as f32) as usize;
    let last = (high + margin).clamp(0.0, (h - 1) as f32) as usize;
    let mut window = vec![[0.0; 4]; w * (last - first + 1)];
    let mut row = vec![0.0; 3 * w];
    for (k, out) in window.chunks_exact_mut(w).enumerate() {
        shot.unit_row(first + k, &mut row);
        for (o, p) in out.iter_mut().zip(row.as_chunks::<3>().0) {
            *o = [p[0], p[1], p[2], 0.0];
        }
    }
    (first, window)
}

/// The interpolated code and the marks of the pixels it is made of, `None` outside the picture or on its border.
#[inline]
fn lookup(shot: &Shot<'_>, window: &[Lanes], first: usize, sx: f32, sy: f32) -> Option<([f32; 3], u8)> {
    let (w, h) = (shot.width() as isize, shot.height() as isize);
    // Half a pixel beyond the outermost centres still belongs to the picture.
    if !(sx >= -0.5 && sy >= -0.5 && sx <= w as f32 - 0.5 && sy <= h as f32 - 0.5) {
        return None;
    }
    let rows = (window.len() / w as usize) as isize;
    // What is not below −1 is rounded down by cutting off.
    let floor = |v: f32| if v < 0.0 { -1 } else { v as isize };
    let (ix, iy) = (floor(sx), floor(sy));
    let column = |k: isize| (ix + k).clamp(0, w - 1) as usize;
    let row = |k: isize| ((iy + k).clamp(0, h - 1) - first as isize).clamp(0, rows - 1) as usize * w as usize;
    let core = |k: isize, l: isize| ((iy + k).clamp(0, h - 1) * w + (ix + l).clamp(0, w - 1)) as usize;
    let core = [core(0, 0), core(0, 1), core(1, 0), core(1, 1)];
    if shot.border.as_ref().is_some_and(|border| core.iter().any(|i| border[*i])) {
        return None;
    }
    let marks = shot.clips.as_ref().map_or(0, |marks| core.iter().fold(0, |m, i| m | marks[*i]));
    let (wx, wy) = (catmull_rom(sx - ix as f32), catmull_rom(sy - iy as f32));
    let columns = [column(-1), column(0), column(1), column(2)];
    let rows = [row(-1), row(0), row(1), row(2)];
    let mut out = [0.0f32; 4];
    let (mut low, mut high) = ([f32::INFINITY; 4], [f32::NEG_INFINITY; 4]);
    for k in 0..4 {
        for l in 0..4 {
            let (p, weight) = (window[rows[k] + columns[l]], wy[k] * wx[l]);
            for c in 0..4 {
                out[c] += weight * p[c];
            }
            if (1..=2).contains(&k) && (1..=2).contains(&l) {
                for c in 0..4 {
                    low[c] = if p[c] < low[c] { p[c] } else { low[c] };
                    high[c] = if p[c] > high[c] { p[c] } else { high[c] };
                }
            }
        }
    }
    let between = wx[1] * wy[1] < 0.999;
    let value = |c: usize| match between && shot.decoder.is_clipped(c, high[c]) {
        true => high[c],
        false => out[c].clamp(low[c], high[c]),
    };
    Some(([value(0), value(1), value(2)], marks))
}
