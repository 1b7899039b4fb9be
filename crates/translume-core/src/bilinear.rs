//! Functions on the unit square given at grid points, linear between them, and for densities the warp that draws from them.
//!
//! There is a pile of them, one for each value of some parameters; what lies between the values is a [`Mix`] of up to four. The
//! warp is the conditional one (Rosenblatt 1952): y by the marginal distribution of the rows, x by that along y. A mixture of bilinear
//! densities is bilinear again, so it is followed exactly: within a cell both cumulative distributions are quadratic.

use crate::warp::ONE_MINUS_EPSILON;
use glam::Vec2;

/// Which functions of a pile are mixed, and their shares, which sum to one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mix(pub [(u32, f32); 4]);

impl Mix {
    /// One function alone.
    pub const fn one(i: u32) -> Self {
        Self([(i, 1.0), (i, 0.0), (i, 0.0), (i, 0.0)])
    }

    #[inline]
    fn of(&self, value: impl Fn(usize) -> f32) -> f32 {
        self.0.iter().filter(|(_, share)| *share > 0.0).map(|&(i, share)| share * value(i as usize)).sum()
    }
}

/// Functions on the unit square, values at `rows` × `columns` points with the first on its edge y = 0 and x = 0.
#[derive(Clone, Debug)]
pub struct BilinearPile {
    /// Slice after slice, row after row.
    values: Vec<f32>,
    rows: usize,
    columns: usize,
}

impl BilinearPile {
    /// `None` unless there are at least 2 × 2 points and the values are whole slices of finite numbers.
    pub fn new(values: Vec<f32>, rows: usize, columns: usize) -> Option<Self> {
        let slice = rows.checked_mul(columns)?;
        let whole = rows >= 2 && columns >= 2 && !values.is_empty() && values.len().is_multiple_of(slice);
        (whole && values.iter().all(|v| v.is_finite())).then_some(Self { values, rows, columns })
    }

    /// How many functions.
    pub fn slices(&self) -> usize {
        self.values.len() / (self.rows * self.columns)
    }

    /// Rows and columns.
    pub fn size(&self) -> (usize, usize) {
        (self.rows, self.columns)
    }

    /// All values, slice after slice, row after row.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// The cell of a point in [0, 1]²: row, column, and where in it.
    #[inline]
    fn cell(&self, p: Vec2) -> (usize, usize, Vec2) {
        let at = p * Vec2::new((self.columns - 1) as f32, (self.rows - 1) as f32);
        let (i, j) = ((at.x as usize).min(self.columns - 2), (at.y as usize).min(self.rows - 2));
        (j, i, at - Vec2::new(i as f32, j as f32))
    }

    #[inline]
    fn at(&self, slice: usize, row: usize, column: usize) -> f32 {
        self.values[(slice * self.rows + row) * self.columns + column]
    }

    /// The value of the mixture at a point of [0, 1]².
    #[inline]
    pub fn eval(&self, mix: &Mix, p: Vec2) -> f32 {
        let (j, i, f) = self.cell(p);
        mix.of(|s| {
            let row = |j| lerp(self.at(s, j, i), self.at(s, j, i + 1), f.x);
            lerp(row(j), row(j + 1), f.y)
        })
    }
}

/// Densities on the unit square: a [`BilinearPile`] of functions that each integrate to one.
#[derive(Clone, Debug)]
pub struct BilinearDensity {
    density: BilinearPile,
    /// Integral along its row up to each point, in the density's layout.
    along: Vec<f32>,
    /// Integral of all rows up to each one, slice after slice.
    upward: Vec<f32>,
}

impl BilinearDensity {
    /// Scales each function of the pile to a density. `None` if one is negative somewhere, or zero everywhere.
    pub fn new(mut density: BilinearPile) -> Option<Self> {
        let (rows, columns) = (density.rows, density.columns);
        let mut along = vec![0.0; density.values.len()];
        let mut upward = Vec::with_capacity(density.slices() * rows);
        for (values, along) in density.values.chunks_mut(rows * columns).zip(along.chunks_mut(rows * columns)) {
            let mut sums = Vec::with_capacity(rows);
            let (width, height) = (1.0 / (columns - 1) as f64, 1.0 / (rows - 1) as f64);
            let mut integrals = vec![0.0; rows * columns];
            for (row, integrals) in values.chunks(columns).zip(integrals.chunks_mut(columns)) {
                for i in 1..columns {
                    integrals[i] = integrals[i - 1] + 0.5 * width * (f64::from(row[i - 1]) + f64::from(row[i]));
                }
                sums.push(integrals[columns - 1]);
            }
            let mut total = 0.0;
            let mut running = vec![0.0];
            for pair in sums.windows(2) {
                total += 0.5 * height * (pair[0] + pair[1]);
                running.push(total);
            }
            if total.is_nan() || total <= 0.0 || values.iter().any(|&v| v < 0.0) {
                return None;
            }
            values.iter_mut().for_each(|v| *v = (f64::from(*v) / total) as f32);
            along.iter_mut().zip(integrals).for_each(|(a, integral)| *a = (integral / total) as f32);
            upward.extend(running.iter().map(|v| (v / total) as f32));
        }
        Some(Self { density, along, upward })
    }

    /// Integral of a row up to a point of it.
    #[inline]
    fn along(&self, mix: &Mix, row: usize, column: usize) -> f32 {
        let columns = self.density.columns;
        mix.of(|s| self.along[(s * self.density.rows + row) * columns + column])
    }

    #[inline]
    fn upward(&self, mix: &Mix, row: usize) -> f32 {
        mix.of(|s| self.upward[s * self.density.rows + row])
    }

    /// The density at a point of [0, 1]².
    #[inline]
    pub fn pdf(&self, mix: &Mix, p: Vec2) -> f32 {
        self.density.eval(mix, p)
    }

    /// The point that [`BilinearDensity::sample`] makes `p` of, and the density at `p`.
    pub fn invert(&self, mix: &Mix, p: Vec2) -> (Vec2, f32) {
        let d = &self.density;
        let (j, i, f) = d.cell(p);
        let last = d.columns - 1;
        let (below, above) = (self.along(mix, j, last), self.along(mix, j + 1, last));
        let y = self.upward(mix, j) + integral(below, above, f.y) / (d.rows - 1) as f32;
        let left = mix.of(|s| lerp(d.at(s, j, i), d.at(s, j + 1, i), f.y));
        let right = mix.of(|s| lerp(d.at(s, j, i + 1), d.at(s, j + 1, i + 1), f.y));
        let before = lerp(self.along(mix, j, i), self.along(mix, j + 1, i), f.y);
        let row = lerp(below, above, f.y);
        // Where the density's whole row is zero any point does.
        let x = if row > 0.0 { (before + integral(left, right, f.x) / last as f32) / row } else { p.x };
        (Vec2::new(x, y).clamp(Vec2::ZERO, Vec2::ONE), lerp(left, right, f.x))
    }

    /// Draws a point by two uniform numbers in [0, 1]; returns it and its density.
    pub fn sample(&self, mix: &Mix, u: Vec2) -> (Vec2, f32) {
        let d = &self.density;
        let (rows, last) = ((d.rows - 1) as f32, d.columns - 1);
        let j = interval(d.rows - 1, |j| self.upward(mix, j) <= u.y);
        let (below, above) = (self.along(mix, j, last), self.along(mix, j + 1, last));
        let t = inverse_integral(below, above, (u.y - self.upward(mix, j)) * rows);
        let prefix = |i| lerp(self.along(mix, j, i), self.along(mix, j + 1, i), t);
        let target = u.x * lerp(below, above, t);
        let i = interval(last, |i| prefix(i) <= target);
        let left = mix.of(|s| lerp(d.at(s, j, i), d.at(s, j + 1, i), t));
        let right = mix.of(|s| lerp(d.at(s, j, i + 1), d.at(s, j + 1, i + 1), t));
        let s = inverse_integral(left, right, (target - prefix(i)) * last as f32);
        let p = Vec2::new((i as f32 + s) / last as f32, (j as f32 + t) / rows);
        (p.min(Vec2::splat(ONE_MINUS_EPSILON)), lerp(left, right, s))
    }
}

#[inline]
fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

/// ∫ from 0 to t of the line from a to b.
#[inline]
fn integral(a: f32, b: f32, t: f32) -> f32 {
    t * (a + 0.5 * (b - a) * t)
}

/// t in [0, 1] up to which the line from a to b has this integral.
#[inline]
fn inverse_integral(a: f32, b: f32, integral: f32) -> f32 {
    // The root in the form that does not cancel, whichever end is higher.
    let root = (a * a + 2.0 * (b - a) * integral).max(0.0).sqrt();
    let t = if a + root > 0.0 { 2.0 * integral / (a + root) } else { 0.0 };
    t.clamp(0.0, 1.0)
}

/// The last of `n` intervals whose begin still is `before` what is looked for, or the first.
#[inline]
fn interval(n: usize, before: impl Fn(usize) -> bool) -> usize {
    let (mut lo, mut hi) = (0, n);
    while hi - lo > 1 {
        let middle = lo.midpoint(hi);
        if before(middle) { lo = middle } else { hi = middle }
    }
    lo
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Pcg32;
    use crate::stats;

    fn two() -> BilinearDensity {
        let mut rng = Pcg32::new(3, 5);
        let mut values: Vec<f32> = (0..2 * 4 * 6).map(|_| rng.next_f32() * rng.next_f32()).collect();
        // A cell without density, and a wide spread.
        for i in [0, 1, 6, 7] {
            values[i] = 0.0;
        }
        values[20] = 5.0;
        BilinearDensity::new(BilinearPile::new(values, 4, 6).unwrap()).unwrap()
    }

    const MIXED: Mix = Mix([(0, 0.25), (1, 0.75), (0, 0.0), (1, 0.0)]);

    /// False alarm: 1 in 10,000 for each of three.
    #[test]
    fn what_is_drawn_follows_the_density() {
        let d = two();
        for mix in [Mix::one(0), Mix::one(1), MIXED] {
            let (cells, samples) = (24, 200_000);
            let mut rng = Pcg32::new(11, 1);
            let mut seen = vec![0.0; cells * cells];
            for _ in 0..samples {
                let (p, pdf) = d.sample(&mix, Vec2::new(rng.next_f32(), rng.next_f32()));
                assert!((pdf - d.pdf(&mix, p)).abs() < 1e-3 * pdf.max(0.1), "{p}");
                seen[(p.y * cells as f32) as usize * cells + (p.x * cells as f32) as usize] += 1.0;
            }
            let middle = |i: usize, k: usize| ((i * 8 + k) as f32 + 0.5) / (8 * cells) as f32;
            let expected: Vec<f64> = (0..cells * cells)
                .map(|c| {
                    let points = (0..64).map(|k| Vec2::new(middle(c % cells, k % 8), middle(c / cells, k / 8)));
                    points.map(|p| f64::from(d.pdf(&mix, p))).sum::<f64>() / 64.0 / (cells * cells) as f64
                })
                .map(|p| p * f64::from(samples))
                .collect();
            stats::chi2_test(&seen, &expected, 1e-4).unwrap();
        }
    }

    #[test]
    fn inverting_gives_the_numbers_back() {
        let d = two();
        let mut rng = Pcg32::new(2, 9);
        for _ in 0..10_000 {
            let u = Vec2::new(rng.next_f32(), rng.next_f32());
            let (p, pdf) = d.sample(&MIXED, u);
            let (back, same) = d.invert(&MIXED, p);
            assert!((back - u).abs().max_element() < 2e-3 / pdf.clamp(0.05, 1.0), "{u} {p} {back} {pdf}");
            assert!((pdf - same).abs() <= 1e-3 * pdf.max(0.1));
        }
    }

    #[test]
    fn what_has_no_density_is_refused() {
        assert!(BilinearPile::new(vec![1.0; 7], 2, 2).is_none() && BilinearPile::new(vec![1.0; 4], 1, 4).is_none());
        assert!(BilinearPile::new(vec![f32::NAN; 4], 2, 2).is_none());
        let pile = |values| BilinearPile::new(values, 2, 2).unwrap();
        assert!(BilinearDensity::new(pile(vec![0.0; 4])).is_none());
        assert!(BilinearDensity::new(pile(vec![1.0, 1.0, 1.0, -0.1])).is_none());
        let flat = BilinearDensity::new(pile(vec![3.0; 4])).unwrap();
        let (p, pdf) = flat.sample(&Mix::one(0), Vec2::new(0.3, 0.6));
        assert!((p - Vec2::new(0.3, 0.6)).length() < 1e-6 && (pdf - 1.0).abs() < 1e-6);
    }
}
