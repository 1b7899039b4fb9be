//! Heterogeneous media on a grid, and the procedural ones with fixed parameters.
//!
//! Scattering is the same for all channels, only absorption has colour: so one random walk serves all of them. The parameters of
//! the media stand in `docs/scatter-capture.md`; changing them here means changing them there.

use rayon::prelude::*;
use translume_core::rng::Pcg32;

/// Coefficients at a place, per mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Local {
    /// Scattering coefficient σs.
    pub sigma_s: f32,
    /// Absorption coefficient σa of each channel.
    pub sigma_a: [f32; 3],
    /// Mean cosine of the scattering angle (Henyey–Greenstein).
    pub g: f32,
}

/// A block of cells; mirrored for ever to the sides, its lowest and highest layers go on.
#[derive(Clone, Debug)]
pub struct Medium {
    /// Lowest corner in mm.
    origin: [f64; 3],
    size: [usize; 3],
    cell_mm: f64,
    cells: Vec<Local>,
    /// Above every σs + σa.
    pub(crate) majorant: f64,
}

impl Medium {
    /// A block below z = 0, centred on the z axis, of `size` cells of edge `cell_mm`, each by `at`, which gets x, y and depth
    /// of its centre in mm.
    pub fn new(size: [usize; 3], cell_mm: f64, at: impl Fn([f64; 3]) -> Local + Sync) -> Self {
        let [x, y, z] = size.map(|n| n as f64 * cell_mm);
        Self::block([-x / 2.0, -y / 2.0, -z], size, cell_mm, |[x, y, z]| at([x, y, -z]))
    }

    /// A block whose lowest corner is `origin`, of `size` cells, each by `at`, which gets its centre in mm.
    pub fn block(origin: [f64; 3], size: [usize; 3], cell_mm: f64, at: impl Fn([f64; 3]) -> Local + Sync) -> Self {
        let center = |axis: usize, i: usize| origin[axis] + (i as f64 + 0.5) * cell_mm;
        let layer = |k: usize| {
            let row = |j: usize| (0..size[0]).map(move |i| [center(0, i), center(1, j), center(2, k)]);
            (0..size[1]).flat_map(row).map(&at).collect::<Vec<_>>()
        };
        let cells: Vec<Local> = (0..size[2]).into_par_iter().flat_map_iter(layer).collect();
        let extinction = |c: &Local| f64::from(c.sigma_s + c.sigma_a.iter().copied().fold(0.0, f32::max));
        // A little above the largest, so that a null collision is possible everywhere and its weight is defined.
        let majorant = 1.02 * cells.iter().map(extinction).fold(1e-6, f64::max);
        Self { origin, size, cell_mm, cells, majorant }
    }

    /// The same everywhere.
    pub fn homogeneous(local: Local) -> Self {
        Self::new([1; 3], 1.0, |_| local)
    }

    /// Layers from the top down, of thickness `cell_mm` each; the last goes on.
    pub fn layers(cell_mm: f64, layers: &[Local]) -> Self {
        Self::new([1, 1, layers.len()], cell_mm, |p| layers[(p[2] / cell_mm) as usize])
    }

    /// Numbers of cells, lowest and highest corner in mm, and the cells, x fastest.
    pub fn cells(&self) -> ([usize; 3], [[f64; 3]; 2], &[Local]) {
        let high = [0, 1, 2].map(|i| self.origin[i] + self.size[i] as f64 * self.cell_mm);
        (self.size, [self.origin, high], &self.cells)
    }

    /// Mean over the cells of the reduced extinction σs (1 − g) + σa of the least absorbed channel.
    pub(crate) fn mean_extinction(&self) -> f64 {
        let least = |c: &Local| c.sigma_s * (1.0 - c.g) + c.sigma_a.iter().copied().fold(f32::INFINITY, f32::min);
        self.cells.iter().map(|c| f64::from(least(c))).sum::<f64>() / self.cells.len() as f64
    }

    #[inline]
    pub(crate) fn at(&self, p: [f64; 3]) -> Local {
        let cell = |axis: usize| ((p[axis] - self.origin[axis]) / self.cell_mm).floor() as i64;
        let mirrored = |axis: usize| {
            let n = self.size[axis];
            let i = cell(axis).rem_euclid(2 * n as i64) as usize;
            if i < n { i } else { 2 * n - 1 - i }
        };
        let (i, j) = (mirrored(0), mirrored(1));
        let k = cell(2).clamp(0, self.size[2] as i64 - 1) as usize;
        self.cells[(k * self.size[1] + j) * self.size[0] + i]
    }
}

/// The procedural media.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Procedural {
    /// Clear matrix with dark, dense veins.
    Marble,
    /// A pigmented skin over fibrous flesh.
    Apple,
    /// Walls around pores that scatter little.
    Sponge,
    /// Pressed chunks of waxes of different colour.
    Wax,
    /// Fine grains, strongly absorbing.
    Stone,
    /// Marble's matrix alone.
    Homogeneous,
}

/// Cells of a procedural medium in a slab: 32 mm × 32 mm × 16 mm.
const SIZE: [usize; 3] = [128, 128, 64];
const CELL_MM: f64 = 0.25;

impl Procedural {
    /// The medium of a slab, with the pattern number `seed`.
    pub fn build(self, seed: u64) -> Medium {
        let noise = Noise { seed };
        match self {
            Self::Homogeneous => Medium::homogeneous(self.at(&noise, [0.0; 3], 0.0)),
            _ => Medium::new(SIZE, CELL_MM, |p| self.at(&noise, p, p[2])),
        }
    }

    /// The medium of a solid in the box from `low` to `high`; `depth` is the distance in mm to its surface.
    pub fn fill(self, seed: u64, (low, high): ([f64; 3], [f64; 3]), depth: impl Fn([f64; 3]) -> f64 + Sync) -> Medium {
        let noise = Noise { seed };
        let extent = [0, 1, 2].map(|i| high[i] - low[i]);
        let cell = extent.iter().copied().fold(0.0, f64::max).max(1e-3) / 128.0;
        let cell = cell.max(CELL_MM);
        let size = extent.map(|e| ((e / cell).ceil() as usize).max(1));
        match self {
            Self::Homogeneous => Medium::homogeneous(self.at(&noise, [0.0; 3], 0.0)),
            Self::Apple => Medium::block(low, size, cell, |p| self.at(&noise, p, depth(p))),
            _ => Medium::block(low, size, cell, |p| self.at(&noise, p, 0.0)),
        }
    }

    /// Coefficients at a place.
    fn at(self, noise: &Noise, p: [f64; 3], depth: f64) -> Local {
        let gray = |sigma_s: f64, a: [f64; 3]| Local { sigma_s: sigma_s as f32, sigma_a: a.map(|x| x as f32), g: 0.0 };
        let mix = |t: f64, a: f64, b: f64| a + (b - a) * t.clamp(0.0, 1.0);
        let mix3 = |t: f64, a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|i| mix(t, a[i], b[i]));
        match self {
            Self::Homogeneous => gray(2.0, [0.004, 0.006, 0.010]),
            Self::Marble => {
                let bend = 2.2 * noise.fractal(p.map(|x| x / 9.0), 3);
                let wave = ((0.8 * p[0] + 0.55 * p[1] + 0.3 * p[2]) / 7.0 + bend).sin();
                let vein = (-(wave / 0.28).powi(2)).exp();
                gray(mix(vein, 2.0, 3.5), mix3(vein, [0.004, 0.006, 0.010], [0.30, 0.36, 0.42]))
            }
            Self::Apple => {
                let blotch = 0.5 + 0.5 * noise.fractal([p[0] / 4.0, p[1] / 4.0, (p[2] - depth) / 4.0], 3);
                let fibre = noise.fractal([p[0] / 1.5, p[1] / 6.0, p[2] / 6.0], 2);
                match depth < 0.5 {
                    true => gray(3.0, mix3(2.0 * blotch - 0.5, [0.02, 0.05, 0.15], [0.05, 0.60, 0.70])),
                    false => gray(1.9 + 0.8 * fibre, [0.004, 0.006, 0.040]),
                }
            }
            Self::Sponge => {
                let (near, _, _) = noise.cells(p.map(|x| x / 3.0));
                let pore = 1.0 - ((near - 0.38) / 0.08).clamp(0.0, 1.0);
                gray(mix(pore, 4.0, 0.4), mix3(pore, [0.02, 0.03, 0.08], [0.002, 0.003, 0.006]))
            }
            Self::Wax => {
                let (_, _, id) = noise.cells(p.map(|x| x / 5.0));
                let random = |k: u64| noise.hash(&[id as i64, k as i64, 7]);
                gray(
                    1.0 + 2.5 * random(0),
                    [0.003 + 0.03 * random(1), 0.004 + 0.20 * random(2).powi(2), 0.006 + 0.30 * random(2).powi(2)],
                )
            }
            Self::Stone => {
                let (_, _, id) = noise.cells(p.map(|x| x / 1.8));
                let cloud = 0.5 + 0.5 * noise.fractal(p.map(|x| x / 6.0), 2);
                let dark = 0.6 * noise.hash(&[id as i64, 1, 7]) + 0.6 * cloud - 0.1;
                gray(mix(dark, 3.5, 2.0), [0.02 + 0.30 * dark.max(0.0); 3])
            }
        }
    }
}

/// Lattice noise from a hash, so that a pattern needs no table.
struct Noise {
    seed: u64,
}

impl Noise {
    /// Uniform in [0, 1) for a key.
    fn hash(&self, key: &[i64; 3]) -> f64 {
        let mixed = key.iter().fold(self.seed ^ 0x9e37_79b9_7f4a_7c15, |h, k| {
            (h ^ (*k as u64)).wrapping_mul(0xff51_afd7_ed55_8ccd).rotate_left(29)
        });
        Pcg32::new(mixed, 1).next_f64()
    }

    /// Smooth value noise in (−1, 1) on the unit lattice.
    fn value(&self, p: [f64; 3]) -> f64 {
        let cell = p.map(f64::floor);
        let t = [0, 1, 2].map(|i| {
            let f = p[i] - cell[i];
            f * f * (3.0 - 2.0 * f)
        });
        let mut sum = 0.0;
        for corner in 0..8i64 {
            let bits = [corner & 1, corner >> 1 & 1, corner >> 2];
            let weight: f64 = (0..3).map(|i| if bits[i] == 1 { t[i] } else { 1.0 - t[i] }).product();
            sum += weight * (2.0 * self.hash(&[0, 1, 2].map(|i| cell[i] as i64 + bits[i])) - 1.0);
        }
        sum
    }

    /// Octaves of it, each half as strong and twice as fine; about in (−1, 1).
    fn fractal(&self, p: [f64; 3], octaves: u32) -> f64 {
        (0..octaves)
            .map(|o| self.value(p.map(|x| x * f64::from(1 << o) + 17.3 * f64::from(o))) / f64::from(1 << o))
            .sum()
    }

    /// Distances to the nearest and the second nearest of random points, one in each unit cell, and the number of the nearest.
    fn cells(&self, p: [f64; 3]) -> (f64, f64, u64) {
        let home = p.map(|x| x.floor() as i64);
        let (mut first, mut second, mut id) = (f64::INFINITY, f64::INFINITY, 0);
        for n in 0..27i64 {
            let cell = [home[0] + n % 3 - 1, home[1] + n / 3 % 3 - 1, home[2] + n / 9 - 1];
            let number = (self.hash(&cell) * (1u64 << 52) as f64) as u64;
            let mut rng = Pcg32::new(number, 2);
            let d2: f64 = (0..3).map(|i| (cell[i] as f64 + rng.next_f64() - p[i]).powi(2)).sum();
            let d = d2.sqrt();
            if d < first {
                (first, second, id) = (d, first, number);
            } else {
                second = second.min(d);
            }
        }
        (first, second, id)
    }
}
