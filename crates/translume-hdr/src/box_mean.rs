//! Means over square windows.

/// Mean over (2r+1)² pixels, windows cut at the borders.
pub(crate) fn box_mean(v: &[f32], w: usize, r: usize) -> Vec<f32> {
    let h = v.len() / w;
    let mut across = vec![0.0f32; v.len()];
    for y in 0..h {
        let row = &v[y * w..(y + 1) * w];
        let mut sum: f64 = row[..r.min(w)].iter().map(|x| f64::from(*x)).sum();
        for x in 0..w {
            if x + r < w {
                sum += f64::from(row[x + r]);
            }
            if x > r {
                sum -= f64::from(row[x - r - 1]);
            }
            let n = (x + r + 1).min(w) - x.saturating_sub(r);
            across[y * w + x] = (sum / n as f64) as f32;
        }
    }
    let mut out = vec![0.0f32; v.len()];
    let mut sums = vec![0.0f64; w];
    for y in 0..r.min(h) {
        for x in 0..w {
            sums[x] += f64::from(across[y * w + x]);
        }
    }
    for y in 0..h {
        let n = ((y + r + 1).min(h) - y.saturating_sub(r)) as f64;
        for x in 0..w {
            if y + r < h {
                sums[x] += f64::from(across[(y + r) * w + x]);
            }
            if y > r {
                sums[x] -= f64::from(across[(y - r - 1) * w + x]);
            }
            out[y * w + x] = (sums[x] / n) as f32;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn box_mean_is_the_mean_of_the_window() {
        let (w, h) = (13, 9);
        let v: Vec<f32> = (0..w * h).map(|i| ((i * 7919) % 31) as f32).collect();
        let got = box_mean(&v, w, 2);
        for y in 0..h {
            for x in 0..w {
                let (mut sum, mut n) = (0.0, 0.0);
                for yy in y.saturating_sub(2)..(y + 3).min(h) {
                    for xx in x.saturating_sub(2)..(x + 3).min(w) {
                        sum += v[yy * w + xx];
                        n += 1.0;
                    }
                }
                assert!((got[y * w + x] - sum / n).abs() < 1e-3);
            }
        }
    }
}
