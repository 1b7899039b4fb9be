//! Heterogeneous media on a grid, and the procedural ones with fixed parameters.
//!
//! Scattering is the same for all channels, only absorption has colour: so one random walk serves all of them. The parameters of
//! the media stand in `docs/scatter.md`; changing them here means changing them there.

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

/// A block of cells below z = 0, centred on the z axis; mirrored for ever to the sides, its last layer goes on below.
#[derive(Clone, Debug)]
pub struct Medium {
    size: [usize; 3],
    cell_mm: f64,
    cells: Vec<Local>,
    /// Above every σs + σa.
    pub(crate) majorant: f64,
}

impl Medium {
    /// `size` cells of edge `cell_mm`, each by `at`, which gets x, y and depth of its centre in mm.
    pub fn new(size: [usize; 3], cell_mm: f64, at: impl Fn([f64; 3]) -> Local) -> Self {
        let center = |i: usize, n: usize| (i as f64 + 0.5 - n as f64 / 2.0) * cell_mm;
        let mut cells = Vec::with_capacity(size.iter().product());
        for k in 0..size[2] {
            for j in 0..size[1] {
                for i in 0..size[0] {
                    cells.push(at([center(i, size[0]), center(j, size[1]), (k as f64 + 0.5) * cell_mm]));
                }
            }
        }
        let extinction = |c: &Local| f64::from(c.sigma_s + c.sigma_a.iter().copied().fold(0.0, f32::max));
        // A little above the largest, so that a null collision is possible everywhere and its weight is defined.
        let majorant = 1.02 * cells.iter().map(extinction).fold(1e-6, f64::max);
        Self { size, cell_mm, cells, majorant }
    }

    /// The same everywhere.
    pub fn homogeneous(local: Local) -> Self {
        Self::new([1; 3], 1.0, |_| local)
    }

    /// Layers from the top down, of thickness `cell_mm` each; the last goes on.
    pub fn layers(cell_mm: f64, layers: &[Local]) -> Self {
        Self::new([1, 1, layers.len()], cell_mm, |p| layers[(p[2] / cell_mm) as usize])
    }

    #[inline]
    pub(crate) fn at(&self, p: [f64; 3]) -> Local {
        let mirrored = |x: f64, n: usize| {
            let i = (x / self.cell_mm + n as f64 / 2.0).floor() as i64;
            let i = i.rem_euclid(2 * n as i64) as usize;
            if i < n { i } else { 2 * n - 1 - i }
        };
        let (i, j) = (mirrored(p[0], self.size[0]), mirrored(p[1], self.size[1]));
        let k = ((p[2] / self.cell_mm).max(0.0) as usize).min(self.size[2] - 1);
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

/// Cells of a procedural medium: 32 mm × 32 mm × 16 mm.
const SIZE: [usize; 3] = [128, 128, 64];
const CELL_MM: f64 = 0.25;

impl Procedural {
    /// The medium with the pattern number `seed`.
    pub fn build(self, seed: u64) -> Medium {
        let noise = Noise { seed };
        let gray = |sigma_s: f64, a: [f64; 3]| Local { sigma_s: sigma_s as f32, sigma_a: a.map(|x| x as f32), g: 0.0 };
        let mix = |t: f64, a: f64, b: f64| a + (b - a) * t.clamp(0.0, 1.0);
        let mix3 = |t: f64, a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|i| mix(t, a[i], b[i]));
        match self {
            Self::Homogeneous => Medium::homogeneous(gray(2.0, [0.004, 0.006, 0.010])),
            Self::Marble => Medium::new(SIZE, CELL_MM, |p| {
                let bend = 2.2 * noise.fractal(p.map(|x| x / 9.0), 3);
                let wave = ((0.8 * p[0] + 0.55 * p[1] + 0.3 * p[2]) / 7.0 + bend).sin();
                let vein = (-(wave / 0.28).powi(2)).exp();
                gray(mix(vein, 2.0, 3.5), mix3(vein, [0.004, 0.006, 0.010], [0.30, 0.36, 0.42]))
            }),
            Self::Apple => Medium::new(SIZE, CELL_MM, |p| {
                let blotch = 0.5 + 0.5 * noise.fractal([p[0] / 4.0, p[1] / 4.0, 0.0], 3);
                let fibre = noise.fractal([p[0] / 1.5, p[1] / 6.0, p[2] / 6.0], 2);
                match p[2] < 0.5 {
                    true => gray(3.0, mix3(2.0 * blotch - 0.5, [0.02, 0.05, 0.15], [0.05, 0.60, 0.70])),
                    false => gray(1.9 + 0.8 * fibre, [0.004, 0.006, 0.040]),
                }
            }),
            Self::Sponge => Medium::new(SIZE, CELL_MM, |p| {
                let (near, _, _) = noise.cells(p.map(|x| x / 3.0));
                let pore = 1.0 - ((near - 0.38) / 0.08).clamp(0.0, 1.0);
                gray(mix(pore, 4.0, 0.4), mix3(pore, [0.02, 0.03, 0.08], [0.002, 0.003, 0.006]))
            }),
            Self::Wax => Medium::new(SIZE, CELL_MM, |p| {
                let (_, _, id) = noise.cells(p.map(|x| x / 5.0));
                let random = |k: u64| noise.hash(&[id as i64, k as i64, 7]);
                gray(
                    1.0 + 2.5 * random(0),
                    [0.003 + 0.03 * random(1), 0.004 + 0.20 * random(2).powi(2), 0.006 + 0.30 * random(2).powi(2)],
                )
            }),
            Self::Stone => Medium::new(SIZE, CELL_MM, |p| {
                let (_, _, id) = noise.cells(p.map(|x| x / 1.8));
                let cloud = 0.5 + 0.5 * noise.fractal(p.map(|x| x / 6.0), 2);
                let dark = 0.6 * noise.hash(&[id as i64, 1, 7]) + 0.6 * cloud - 0.1;
                gray(mix(dark, 3.5, 2.0), [0.02 + 0.30 * dark.max(0.0); 3])
            }),
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
