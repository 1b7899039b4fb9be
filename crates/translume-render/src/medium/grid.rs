//! Values of grids, and what they can be at most in a box.

use crate::Rgb;
use glam::DVec3;
use std::sync::Arc;
use translume_scene::medium::{Grid, Samples};
use translume_scene::texture::{Filter, Wrap};

/// The samples of a grid with all that says what is between and beyond them.
pub(super) struct Samples3 {
    pub(super) grid: Arc<Grid>,
    pub(super) at: Samples,
    pub(super) filter: Filter,
    pub(super) wrap: Wrap,
}

/// What the grid is in a box.
#[derive(Clone, Copy)]
pub(super) struct Bound {
    /// At most, in any channel; `None`: not worth finding out.
    pub(super) most: Option<f32>,
    /// In the middle.
    pub(super) middle: Rgb,
}

/// Samples that [`Samples3::bound`] looks at.
const MOST_SAMPLES: i64 = 64;

impl Samples3 {
    /// The place of coordinate `q` of the unit cube in units of samples.
    fn place(&self, axis: usize, q: f64) -> f64 {
        let n = self.grid.size[axis] as f64;
        match self.at {
            Samples::Centers => q * n - 0.5,
            Samples::Corners => q * (n - 1.0),
        }
    }

    /// The sample that stands for number `i`, which may be beyond the border; `None`: zero.
    #[inline]
    fn wrapped(&self, axis: usize, i: i64) -> Option<usize> {
        let n = self.grid.size[axis] as i64;
        if (0..n).contains(&i) {
            return Some(i as usize);
        }
        match self.wrap {
            Wrap::Repeat => Some(i.rem_euclid(n) as usize),
            Wrap::Mirror => {
                let i = i.rem_euclid(2 * n);
                Some(if i < n { i } else { 2 * n - 1 - i } as usize)
            }
            Wrap::Clamp => Some(i.clamp(0, n - 1) as usize),
            Wrap::Zero | Wrap::One => None,
        }
    }

    /// The sample of these numbers, none of them beyond the border; `None`: zero.
    #[inline]
    fn stored(&self, at: [Option<usize>; 3]) -> Rgb {
        let [Some(x), Some(y), Some(z)] = at else { return Rgb::ZERO };
        let Grid { size, channels, values } = &*self.grid;
        let i = (z * size[1] + y) * size[0] + x;
        if *channels == 1 { Rgb::splat(values[i]) } else { Rgb::from_slice(&values[3 * i..]) }
    }

    fn sample(&self, at: [i64; 3]) -> Rgb {
        self.stored(std::array::from_fn(|axis| self.wrapped(axis, at[axis])))
    }

    /// The value at a place in units of samples.
    #[inline]
    fn interpolated(&self, x: DVec3) -> Rgb {
        let floor = x.floor();
        let t = (x - floor).as_vec3();
        let ends: [[Option<usize>; 2]; 3] = std::array::from_fn(|a| {
            let i = floor[a] as i64;
            [self.wrapped(a, i), self.wrapped(a, i.saturating_add(1))]
        });
        let along = |y: usize, z: usize| {
            let at = |x: usize| self.stored([ends[0][x], ends[1][y], ends[2][z]]);
            at(0) * (1.0 - t.x) + at(1) * t.x
        };
        let across = |z: usize| along(0, z) * (1.0 - t.y) + along(1, z) * t.y;
        across(0) * (1.0 - t.z) + across(1) * t.z
    }

    /// The value at a point of the space in which the grid is the unit cube.
    pub(super) fn value(&self, q: DVec3) -> Rgb {
        if self.wrap == Wrap::Zero && (q.min_element() < 0.0 || q.max_element() > 1.0) {
            return Rgb::ZERO;
        }
        let x = DVec3::from_array(std::array::from_fn(|a| {
            let x = self.place(a, q[a]);
            // Beyond the border samples stand for others, but for those whose own border goes on.
            if matches!(self.wrap, Wrap::Clamp | Wrap::Zero | Wrap::One) {
                x.clamp(0.0, (self.grid.size[a] - 1) as f64)
            } else {
                x
            }
        }));
        match self.filter {
            Filter::Nearest => self.sample(x.to_array().map(|v| v.round() as i64)),
            Filter::Bilinear => self.interpolated(x),
        }
    }

    /// Numbers of the samples along an axis that values between `lo` and `hi` of the unit cube may use, one more on each side for
    /// rounding.
    pub(super) fn touched(&self, axis: usize, lo: f64, hi: f64) -> Vec<usize> {
        let (lo, hi) = (self.place(axis, lo).floor() as i64 - 1, self.place(axis, hi).ceil() as i64 + 1);
        let mut touched: Vec<usize> = (lo..=hi).filter_map(|i| self.wrapped(axis, i)).collect();
        touched.sort_unstable();
        touched.dedup();
        touched
    }

    /// The largest number among these samples.
    pub(super) fn most(&self, x: &[usize], y: &[usize], z: &[usize]) -> f32 {
        let Grid { size, channels, values } = &*self.grid;
        let mut most = 0.0_f32;
        for k in z {
            for j in y {
                let row = (k * size[1] + j) * size[0];
                let cells = x.iter().flat_map(|i| &values[(row + i) * channels..(row + i + 1) * channels]);
                most = cells.copied().fold(most, f32::max);
            }
        }
        most
    }

    /// What the grid is in the box between two points of the unit cube.
    pub(super) fn bound(&self, p: DVec3, q: DVec3) -> Bound {
        let middle = self.value(0.5 * (p + q));
        let (lo, hi) = (p.min(q), p.max(q));
        let place = |v: DVec3| DVec3::from_array(std::array::from_fn(|a| self.place(a, v[a])));
        let (lo, hi) = (place(lo), place(hi));
        let nearest = self.filter == Filter::Nearest;
        let (first, last) = match nearest {
            true => (lo.map(f64::round), hi.map(f64::round)),
            false => (lo.floor(), hi.floor() + 1.0),
        };
        let count = (last - first + 1.0).to_array().map(|n| n as i64);
        let samples = count.iter().try_fold(1_i64, |n, c| n.checked_mul(*c)).unwrap_or(i64::MAX);
        if samples > MOST_SAMPLES {
            return Bound { most: None, middle };
        }
        // Within a cell between eight samples the interpolation is largest at a corner of the box.
        let most = if !nearest && count == [2; 3] {
            let corner =
                |i: u32| DVec3::from_array(std::array::from_fn(|a| if i >> a & 1 == 0 { lo[a] } else { hi[a] }));
            (0..8).map(|i| self.interpolated(corner(i)).max_element()).fold(0.0, f32::max) * (1.0 + 1e-5)
        } else {
            let first = first.to_array().map(|v| v as i64);
            let number = |n: i64| [n % count[0], n / count[0] % count[1], n / (count[0] * count[1])];
            let at = |n: i64| std::array::from_fn(|a| first[a].saturating_add(number(n)[a]));
            (0..samples).map(|n| self.sample(at(n)).max_element()).fold(0.0, f32::max)
        };
        Bound { most: Some(most), middle }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(wrap: Wrap) -> Samples3 {
        let grid = Arc::new(Grid { size: [3, 1, 1], channels: 1, values: vec![1.0, 2.0, 4.0] });
        Samples3 { grid, at: Samples::Centers, filter: Filter::Bilinear, wrap }
    }

    #[test]
    fn grids_go_on_as_they_are_wrapped() {
        let at = |wrap: Wrap, x: f64| grid(wrap).value(DVec3::new(x, 0.5, 0.5)).x;
        assert_eq!(at(Wrap::Clamp, 0.5), 2.0);
        assert_eq!([-2.0, -0.1, 0.0, 1.0, 9.0].map(|x| at(Wrap::Clamp, x)), [1.0, 1.0, 1.0, 4.0, 4.0]);
        assert_eq!([1.5, -0.5, 0.0].map(|x| at(Wrap::Repeat, x)), [2.0, 2.0, 2.5]);
        assert_eq!(
            [-0.5, 7.0 / 6.0, 1.5, 0.0].map(|x| (at(Wrap::Mirror, x) * 1e4).round() / 1e4),
            [2.0, 4.0, 2.0, 1.0]
        );
        assert_eq!([-0.01, 1.01, 0.5].map(|x| at(Wrap::Zero, x)), [0.0, 0.0, 2.0]);
    }

    #[test]
    fn bounds_bound() {
        let values: Vec<f32> = (0..125).map(|i| ((i * 37) % 11) as f32).collect();
        for (filter, wrap) in
            [(Filter::Bilinear, Wrap::Clamp), (Filter::Nearest, Wrap::Repeat), (Filter::Bilinear, Wrap::Repeat)]
        {
            let grid = Arc::new(Grid { size: [5, 5, 5], channels: 1, values: values.clone() });
            let samples = Samples3 { grid, at: Samples::Centers, filter, wrap };
            let mut random = translume_core::rng::Pcg32::new(3, 1);
            let mut point =
                |scale: f64| DVec3::from_array(std::array::from_fn(|_| f64::from(random.next_f32()) * scale));
            for i in 0..3000 {
                let p = point(1.0);
                let q = (p + point(1.0) * 0.5_f64.powi(i % 12)).min(DVec3::ONE);
                let Some(most) = samples.bound(p, q).most else { continue };
                for k in 0..=8 {
                    let v = samples.value(p.lerp(q, f64::from(k) / 8.0)).x;
                    assert!(v <= most, "{v} > {most} between {p} and {q}");
                }
            }
        }
    }
}
