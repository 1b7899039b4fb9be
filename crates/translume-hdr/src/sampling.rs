//! Scene points for the response: first without knowing the motion, then on aligned pixels.

use crate::align::Aligned;
use crate::exposure::Shot;
use crate::response::Sample;
use crate::warp::{self, Strip};
use rayon::prelude::*;

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

/// Aligned points spread over the picture: the flattest pixel of each of 64 × 64 cells.
pub(crate) fn aligned_points(shots: &[Shot<'_>], aligned: &[Aligned], anchor: usize) -> Vec<Point> {
    const CELLS: usize = 64;
    let (w, h) = (shots[anchor].width(), shots[anchor].height());
    let (rows, columns) = (CELLS.min(h / 3), CELLS.min(w / 3));
    (0..rows)
        .into_par_iter()
        .flat_map_iter(|cy| {
            let y = ((2 * cy + 1) * h / (2 * rows)).clamp(1, h - 2);
            let strips: Vec<Strip> =
                shots.iter().zip(aligned).map(|(s, a)| warp::strip(s, &a.field, y - 1..y + 2)).collect();
            let points: Vec<Point> = (0..columns)
                .filter_map(|cx| {
                    let (x0, x1) = ((cx * w / columns).max(1), ((cx + 1) * w / columns).min(w - 1));
                    let x = (x0..x1).min_by(|a, b| unevenness(&strips, *a).total_cmp(&unevenness(&strips, *b)))?;
                    Some(Point { codes: strips.iter().map(|s| mean_of_nine(s, x)).collect() })
                })
                .collect();
            points
        })
        .collect()
}

/// Range of the green codes in 3 × 3 pixels, summed over the pictures.
fn unevenness(strips: &[Strip], x: usize) -> f32 {
    let range = |s: &Strip| {
        let (mut low, mut high) = (f32::MAX, f32::MIN);
        for r in 0..3 {
            for xx in x - 1..=x + 1 {
                let v = s.codes[3 * (r * s.width + xx) + 1];
                (low, high) = (low.min(v), high.max(v));
            }
        }
        high - low
    };
    strips.iter().map(range).sum()
}

/// Samples for the response from a robust comparagram: for each code of one picture the median code of its neighbour
/// in exposure, and the reverse.
///
/// A median over all points of one brightness ignores what has moved there, as long as most of them have not. Where a
/// moving thing is all there is at a brightness that would not help: points that contradict the preliminary curve of
/// `shots` (found from histograms, which do not care where things are) by much are left out first.
pub(crate) fn comparagram_samples(
    shots: &[Shot<'_>],
    points: &[Point],
    order: &[usize],
    channel: usize,
) -> Vec<Sample> {
    // Near black preliminary curves are the least certain.
    let contradiction = |u: f32| if u < 0.2 { 0.8 } else { 0.3 };
    const BINS: usize = 100;
    const FEWEST: usize = 4;
    let log = |i: usize, u: f32| shots[i].decoder.log_exposure(channel, u) - shots[i].log_secs;
    let mut out = Vec::new();
    for pair in order.windows(2) {
        for (from, to) in [(pair[0], pair[1]), (pair[1], pair[0])] {
            let mut bins: Vec<Vec<(f32, f32)>> = vec![Vec::new(); BINS];
            for p in points {
                if let (Some(u), Some(v)) = (p.codes[from], p.codes[to])
                    && (log(from, u[channel]) - log(to, v[channel])).abs() < contradiction(u[channel].min(v[channel]))
                {
                    bins[((u[channel] * BINS as f32) as usize).min(BINS - 1)].push((u[channel], v[channel]));
                }
            }
            for mut bin in bins.into_iter().filter(|b| b.len() >= FEWEST) {
                let mid = bin.len() / 2;
                // Within a bin the code varies: carry it along with the median of the other.
                let u = bin.iter().map(|p| p.0).sum::<f32>() / bin.len() as f32;
                let v = bin.select_nth_unstable_by(mid, |a, b| a.1.total_cmp(&b.1)).1.1;
                let mut sample: Sample = vec![None; order.len()];
                (sample[from], sample[to]) = (Some(u), Some(v));
                out.push(sample);
            }
        }
    }
    out
}

fn mean_of_nine(s: &Strip, x: usize) -> Option<[f32; 3]> {
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
    use crate::Response;
    use crate::exposure::decoder_of;
    use translume_image::{Codes, Metadata, Samples};

    #[test]
    fn moving_points_do_not_reach_the_comparagram() {
        let codes = Codes { width: 1, height: 1, samples: Samples::U8(vec![0; 3]), metadata: Metadata::default() };
        let shot = |secs: f32| Shot {
            name: "",
            codes: &codes,
            log_secs: secs.ln(),
            border: None,
            clips: None,
            decoder: decoder_of(&codes, &Response::linear()),
        };
        // A linear camera and a ratio of 2; of the points brighter than 0.5 all have moved, of the others a third.
        let points: Vec<Point> = (0..3000)
            .map(|k| {
                let u = (k as f32 + 0.5) / 3000.0;
                let v = if k % 3 == 0 || u > 0.5 { 0.05 } else { 2.0 * u };
                Point { codes: vec![Some([u; 3]), Some([v; 3])] }
            })
            .collect();
        let samples = comparagram_samples(&[shot(1.0), shot(2.0)], &points, &[0, 1], 0);
        let pairs: Vec<(f32, f32)> =
            samples.iter().filter_map(|s| Some((s[0]?, s[1]?))).filter(|(u, _)| *u > 0.05).collect();
        assert!(pairs.len() > 80);
        for (u, v) in pairs {
            assert!((v - 2.0 * u).abs() < 0.02, "{u} {v}");
        }
    }

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
