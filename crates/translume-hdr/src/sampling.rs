//! Scene points for the response: first without knowing the motion, then on aligned pixels.

use crate::align::Aligned;
use crate::exposure::Shot;
use crate::response::Sample;
use crate::warp;

/// Quantiles of the pictures' histograms as virtual scene points [after Grossberg & Nayar 2003].
///
/// The q-th share of the darkest pixels is about the same part of the scene in every picture, wherever it has moved to;
/// so the codes at q are one sample. Good enough to bring pictures to a common exposure before they are aligned.
pub(crate) fn quantile_samples(shots: &[Shot<'_>], channel: usize) -> Vec<Sample> {
    const QUANTILES: usize = 200;
    let histograms: Vec<Vec<f64>> = shots.iter().map(|s| cumulative_histogram(s, channel)).collect();
    (0..QUANTILES)
        .map(|k| {
            let q = (k as f64 + 0.5) / QUANTILES as f64;
            histograms.iter().map(|h| Some(inverse(h, q))).collect()
        })
        .collect()
}

/// Share of pixels below each of 257 code borders.
fn cumulative_histogram(shot: &Shot<'_>, channel: usize) -> Vec<f64> {
    let mut counts = vec![0.0f64; 257];
    let mut row = vec![0.0f32; 3 * shot.width()];
    let step = (shot.height() / 500).max(1);
    for y in (0..shot.height()).step_by(step) {
        shot.unit_row(y, &mut row);
        for (x, p) in row.chunks_exact(3).enumerate() {
            if shot.is_picture(y * shot.width() + x) {
                counts[1 + ((p[channel] * 255.0 + 0.5) as usize).min(255)] += 1.0;
            }
        }
    }
    let total = counts.iter().sum::<f64>().max(1.0);
    let mut sum = 0.0;
    counts
        .iter()
        .map(|c| {
            sum += c / total;
            sum
        })
        .collect()
}

/// Code at which the cumulative histogram reaches `q`; the codes of bin i are spread over [i − ½, i + ½]/255.
fn inverse(cumulative: &[f64], q: f64) -> f32 {
    let i = cumulative.partition_point(|c| *c < q).clamp(1, 256);
    let (a, b) = (cumulative[i - 1], cumulative[i]);
    // The end bins hold clipped pixels: no spreading.
    if i == 1 || i == 256 {
        return (i - 1) as f32 / 255.0;
    }
    let f = if b > a { (q - a) / (b - a) } else { 0.5 };
    (((i - 1) as f64 - 0.5 + f) / 255.0) as f32
}

/// One aligned scene point: the mean codes of 3 × 3 pixels in each picture, for the three channels.
pub(crate) struct Point {
    pub(crate) codes: Vec<Option<[f32; 3]>>,
}

/// Well-spread aligned points: the flattest pixel of each of many cells, then as even a choice over brightness as the
/// scene allows.
pub(crate) fn aligned_points(shots: &[Shot<'_>], aligned: &[Aligned], anchor: usize) -> Vec<Point> {
    const CELLS: usize = 64;
    const BUCKETS: usize = 64;
    const PER_BUCKET: usize = 10;
    let (w, h) = (shots[anchor].width(), shots[anchor].height());
    let mut buckets: Vec<Vec<Point>> = (0..BUCKETS).map(|_| Vec::new()).collect();
    for cy in 0..CELLS.min(h / 3) {
        let rows = CELLS.min(h / 3);
        let y = (((cy as f32 + 0.5) / rows as f32) * h as f32) as usize;
        let y = y.clamp(1, h.saturating_sub(2).max(1));
        if y + 2 > h {
            continue;
        }
        let strips: Vec<_> = shots.iter().zip(aligned).map(|(s, a)| warp::strip(s, &a.field, y - 1..y + 2)).collect();
        let columns = CELLS.min(w / 3);
        for cx in 0..columns {
            let (x0, x1) = ((cx * w / columns).max(1), ((cx + 1) * w / columns).min(w - 1));
            let spread = |x: usize| -> f32 {
                // Flat in the two pictures that matter most is flat in all: sum over pictures of the range of green.
                strips
                    .iter()
                    .map(|s| {
                        let v: Vec<f32> =
                            (0..3).flat_map(|r| (x - 1..=x + 1).map(move |xx| s.codes[3 * (r * w + xx) + 1])).collect();
                        v.iter().copied().fold(f32::MIN, f32::max) - v.iter().copied().fold(f32::MAX, f32::min)
                    })
                    .sum()
            };
            let Some(x) = (x0..x1).min_by(|a, b| spread(*a).total_cmp(&spread(*b))) else { continue };
            let point = Point { codes: strips.iter().map(|s| mean_of_nine(s, x)).collect() };
            let seen: Vec<f32> = point.codes.iter().flatten().map(|c| c[1]).collect();
            if seen.len() >= 2 {
                let at = seen.iter().sum::<f32>() / seen.len() as f32;
                let bucket = &mut buckets[((at * BUCKETS as f32) as usize).min(BUCKETS - 1)];
                if bucket.len() < PER_BUCKET {
                    bucket.push(point);
                }
            }
        }
    }
    buckets.into_iter().flatten().collect()
}

fn mean_of_nine(s: &warp::Strip, x: usize) -> Option<[f32; 3]> {
    let mut sum = [0.0f32; 3];
    for r in 0..3 {
        for xx in x - 1..=x + 1 {
            let i = r * s.width + xx;
            if !s.seen[i] {
                return None;
            }
            let p = s.pixel(i);
            (0..3).for_each(|c| sum[c] += p[c] / 9.0);
        }
    }
    Some(sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantile_of_a_uniform_histogram_is_the_code() {
        let mut sum = 0.0;
        let c: Vec<f64> = (0..257)
            .map(|i| {
                if i > 0 {
                    sum += 1.0 / 256.0;
                }
                sum
            })
            .collect();
        for q in [0.1, 0.5, 0.9] {
            assert!((f64::from(inverse(&c, q)) - (q * 256.0 - 0.5) / 255.0).abs() < 1e-3);
        }
    }
}
