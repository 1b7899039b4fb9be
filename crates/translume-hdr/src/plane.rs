//! Single-channel float pictures for matching: pyramid, gradients, interpolation, the edge kernel.

use rayon::prelude::*;

/// A grey picture, row by row from the top. Pixel centres have integer coordinates.
#[derive(Clone, Debug)]
pub(crate) struct Plane {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) values: Vec<f32>,
}

impl Plane {
    pub(crate) fn new(width: usize, height: usize) -> Self {
        Self { width, height, values: vec![0.0; width * height] }
    }

    #[inline]
    pub(crate) fn row(&self, y: usize) -> &[f32] {
        &self.values[y * self.width..(y + 1) * self.width]
    }

    /// Value at integer coordinates, edges duplicated.
    #[inline]
    pub(crate) fn clamped(&self, x: isize, y: isize) -> f32 {
        let x = x.clamp(0, self.width as isize - 1) as usize;
        let y = y.clamp(0, self.height as isize - 1) as usize;
        self.values[y * self.width + x]
    }

    /// Bilinear value, edges duplicated.
    #[inline]
    pub(crate) fn bilinear(&self, x: f32, y: f32) -> f32 {
        let x = x.clamp(0.0, (self.width - 1) as f32);
        let y = y.clamp(0.0, (self.height - 1) as f32);
        let (ix, iy) =
            ((x as usize).min(self.width.saturating_sub(2)), (y as usize).min(self.height.saturating_sub(2)));
        let (fx, fy) = (x - ix as f32, y - iy as f32);
        let right = usize::from(self.width > 1);
        let below = if self.height > 1 { self.width } else { 0 };
        let i = iy * self.width + ix;
        let v = &self.values;
        let top = v[i] + fx * (v[i + right] - v[i]);
        let bottom = v[i + below] + fx * (v[i + below + right] - v[i + below]);
        top + fy * (bottom - top)
    }

    /// Whether a position lies on the picture.
    #[inline]
    pub(crate) fn contains(&self, x: f32, y: f32) -> bool {
        x >= 0.0 && y >= 0.0 && x <= (self.width - 1) as f32 && y <= (self.height - 1) as f32
    }

    fn from_rows(width: usize, height: usize, row: impl Fn(usize, &mut [f32]) + Sync) -> Self {
        let mut out = Self::new(width, height);
        out.values.par_chunks_mut(width).enumerate().for_each(|(y, r)| row(y, r));
        out
    }

    /// Half the size by the binomial (1 3 3 1)/8 in both directions: coarse pixel x sits at fine 2x + 0.5.
    pub(crate) fn half(&self) -> Self {
        let (w, h) = (self.width.div_ceil(2), self.height.div_ceil(2));
        Self::from_rows(w, h, |y, out| {
            let mut column = vec![0.0f32; self.width];
            for (k, weight) in [0.125, 0.375, 0.375, 0.125].into_iter().enumerate() {
                let yy = (2 * y as isize + k as isize - 1).clamp(0, self.height as isize - 1) as usize;
                for (c, v) in column.iter_mut().zip(self.row(yy)) {
                    *c += weight * v;
                }
            }
            let last = self.width - 1;
            for (x, o) in out.iter_mut().enumerate() {
                let i = 2 * x;
                let (l, r, rr) = (i.saturating_sub(1), (i + 1).min(last), (i + 2).min(last));
                *o = 0.375 * (column[i] + column[r]) + 0.125 * (column[l] + column[rr]);
            }
        })
    }

    /// The plane and its halves, finest first, down to a shorter side of at least `shortest` pixels; strips go on down
    /// to 8, because the search of the coarsest level takes time by the square of its pixels.
    pub(crate) fn pyramid(self, shortest: usize) -> Vec<Self> {
        let mut levels = vec![self];
        while let Some(last) = levels.last() {
            let (side, pixels) = (last.width.min(last.height), last.width * last.height);
            if side < 2 * shortest && (side < 16 || pixels <= 12 * shortest * shortest) {
                break;
            }
            let next = last.half();
            levels.push(next);
        }
        levels
    }

    /// The edge-enhancing kernel [Menzel 2012, §5.1 edges]: 2 in the middle, −1/4 at the four neighbours, edges duplicated.
    pub(crate) fn edges(&self) -> Self {
        Self::from_rows(self.width, self.height, |y, out| {
            let (above, row, below) =
                (self.row(y.saturating_sub(1)), self.row(y), self.row((y + 1).min(self.height - 1)));
            let last = self.width - 1;
            for (x, o) in out.iter_mut().enumerate() {
                let (l, r) = (row[x.saturating_sub(1)], row[(x + 1).min(last)]);
                *o = 2.0 * row[x] - 0.25 * (l + r + above[x] + below[x]);
            }
        })
    }

    /// Central differences in x and y.
    pub(crate) fn gradients(&self) -> (Self, Self) {
        let gx = Self::from_rows(self.width, self.height, |y, out| {
            let row = self.row(y);
            let last = self.width - 1;
            for (x, o) in out.iter_mut().enumerate() {
                *o = 0.5 * (row[(x + 1).min(last)] - row[x.saturating_sub(1)]);
            }
        });
        let gy = Self::from_rows(self.width, self.height, |y, out| {
            let (above, below) = (self.row(y.saturating_sub(1)), self.row((y + 1).min(self.height - 1)));
            for ((o, a), b) in out.iter_mut().zip(above).zip(below) {
                *o = 0.5 * (b - a);
            }
        });
        (gx, gy)
    }

    /// The picture looked up at `source(x, y)` for every pixel, by Catmull–Rom cubics.
    pub(crate) fn resampled(
        &self,
        width: usize,
        height: usize,
        source: impl Fn(f32, f32) -> (f32, f32) + Sync,
    ) -> Self {
        Self::from_rows(width, height, |y, out| {
            for (x, o) in out.iter_mut().enumerate() {
                let (sx, sy) = source(x as f32, y as f32);
                *o = self.cubic(sx, sy);
            }
        })
    }

    /// Catmull–Rom value, edges duplicated.
    pub(crate) fn cubic(&self, x: f32, y: f32) -> f32 {
        let (fx, fy) = (x.floor(), y.floor());
        let (ix, iy) = (fx as isize, fy as isize);
        let (wx, wy) = (catmull_rom(x - fx), catmull_rom(y - fy));
        let mut sum = 0.0;
        if ix >= 1 && iy >= 1 && ix + 2 < self.width as isize && iy + 2 < self.height as isize {
            let start = (iy as usize - 1) * self.width + ix as usize - 1;
            for (k, wy) in wy.into_iter().enumerate() {
                let r = &self.values[start + k * self.width..start + k * self.width + 4];
                sum += wy * (wx[0] * r[0] + wx[1] * r[1] + wx[2] * r[2] + wx[3] * r[3]);
            }
        } else {
            for (k, wy) in wy.into_iter().enumerate() {
                for (l, wx) in wx.into_iter().enumerate() {
                    sum += wy * wx * self.clamped(ix + l as isize - 1, iy + k as isize - 1);
                }
            }
        }
        sum
    }
}

/// Weights of the four samples around a position `f` in [0, 1) between the middle two.
#[inline]
pub(crate) fn catmull_rom(f: f32) -> [f32; 4] {
    let f2 = f * f;
    let f3 = f2 * f;
    [0.5 * (-f3 + 2.0 * f2 - f), 0.5 * (3.0 * f3 - 5.0 * f2 + 2.0), 0.5 * (-3.0 * f3 + 4.0 * f2 + f), 0.5 * (f3 - f2)]
}

/// Σa, Σb, Σa², Σb², Σab over two rows of one length, each in eight sums of every eighth, which vector units add at once.
pub(crate) fn sums(a: &[f32], b: &[f32]) -> [f32; 5] {
    let [mut ta, mut tb, mut taa, mut tbb, mut tab] = [[0.0f32; 8]; 5];
    let mut add = |p: &[f32; 8], q: &[f32; 8]| {
        for k in 0..8 {
            ta[k] += p[k];
            tb[k] += q[k];
            taa[k] += p[k] * p[k];
            tbb[k] += q[k] * q[k];
            tab[k] += p[k] * q[k];
        }
    };
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    a.iter().zip(b).for_each(|(p, q)| add(p, q));
    if !a_rest.is_empty() {
        let filled = |rest: &[f32]| std::array::from_fn(|k| rest.get(k).copied().unwrap_or(0.0));
        add(&filled(a_rest), &filled(b_rest));
    }
    [ta, tb, taa, tbb, tab].map(|s| ((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_those_of_all() {
        for n in [0usize, 1, 7, 8, 24, 37] {
            let a: Vec<f32> = (0..n).map(|i| i as f32).collect();
            let b: Vec<f32> = (0..n).map(|i| (i * i % 11) as f32).collect();
            let product = |p: &[f32], q: &[f32]| p.iter().zip(q).map(|(x, y)| x * y).sum::<f32>();
            let expected = [a.iter().sum(), b.iter().sum(), product(&a, &a), product(&b, &b), product(&a, &b)];
            assert_eq!(sums(&a, &b), expected, "{n}"); // whole numbers: exact in any order
        }
    }

    fn ramp(w: usize, h: usize) -> Plane {
        Plane::from_rows(w, h, |y, r| {
            for (x, v) in r.iter_mut().enumerate() {
                *v = 2.0 * x as f32 + 3.0 * y as f32;
            }
        })
    }

    #[test]
    fn interpolation_is_exact_on_a_ramp() {
        let p = ramp(20, 15);
        for (x, y) in [(4.25, 6.5), (10.9, 3.1)] {
            let truth = 2.0 * x + 3.0 * y;
            assert!((p.bilinear(x, y) - truth).abs() < 1e-4);
            assert!((p.cubic(x, y) - truth).abs() < 1e-4);
        }
    }

    #[test]
    fn half_keeps_positions() {
        // Coarse pixel x is fine position 2x + 0.5.
        let half = ramp(40, 40).half();
        for (x, y) in [(3usize, 4usize), (10, 7)] {
            let truth = 2.0 * (2.0 * x as f32 + 0.5) + 3.0 * (2.0 * y as f32 + 0.5);
            assert!((half.values[y * half.width + x] - truth).abs() < 1e-3);
        }
    }

    #[test]
    fn odd_and_tiny_sizes_survive() {
        for (w, h) in [(1, 1), (2, 1), (1, 5), (3, 7)] {
            let p = ramp(w, h);
            let _ = (p.half(), p.edges(), p.gradients(), p.bilinear(0.5, 0.5), p.cubic(0.5, 9.0));
        }
    }
}
