//! Where samples are added up: tiles of pixels, each with its own number of samples.
//!
//! Sums are in double precision and in the order of the samples, so that a picture does not depend on threads, on the
//! lengths of passes, or on interruptions. What light paths add all over the film is kept apart (`splat.rs`).

use crate::splat::Splats;
use crate::{Error, Result, Rgb};
use glam::Vec3;

/// Edge of a tile in pixels.
pub const TILE: u32 = 16;

/// Feature images.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Aov {
    /// Colour of the first surface without the light: `Albedo.R/G/B`.
    Albedo,
    /// Shading normal in the world: `Ns.X/Y/Z`.
    Normal,
    /// Normal of the surface itself: `N.X/Y/Z`.
    GeometricNormal,
    /// Place in the world: `P.X/Y/Z`.
    Position,
    /// Texture coordinates: `u`, `v`.
    Uv,
    /// Distance from the camera: `Z`. Samples that met nothing count as 0, as for the others.
    Depth,
    /// Variance of the pixel's value, estimated from its samples as if they were independent: `Variance.R/G/B`.
    Variance,
}

impl Aov {
    /// All of them by the names that options take, with their channels.
    pub const NAMED: [(&'static str, Self, &'static [&'static str]); 7] = [
        ("albedo", Self::Albedo, &["Albedo.R", "Albedo.G", "Albedo.B"]),
        ("normal", Self::Normal, &["Ns.X", "Ns.Y", "Ns.Z"]),
        ("geometric-normal", Self::GeometricNormal, &["N.X", "N.Y", "N.Z"]),
        ("position", Self::Position, &["P.X", "P.Y", "P.Z"]),
        ("uv", Self::Uv, &["u", "v"]),
        ("depth", Self::Depth, &["Z"]),
        ("variance", Self::Variance, &["Variance.R", "Variance.G", "Variance.B"]),
    ];

    /// Names of its channels, after pbrt-v4's GBuffer film (Z after OpenEXR's convention).
    pub fn channels(self) -> &'static [&'static str] {
        Self::NAMED.iter().find(|n| n.1 == self).map_or(&[], |n| n.2)
    }
}

/// What the camera ray of a sample met first.
#[derive(Clone, Copy, Debug)]
pub struct Features {
    /// See [`Aov`].
    pub albedo: Rgb,
    /// Shading normal.
    pub ns: Vec3,
    /// Geometric normal.
    pub n: Vec3,
    /// Position.
    pub p: Vec3,
    /// Texture coordinates.
    pub uv: glam::Vec2,
    /// Distance.
    pub depth: f32,
}

/// Some of the picture's pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile {
    /// Upper left pixel.
    pub origin: [u32; 2],
    /// Width and height.
    pub size: [u32; 2],
    /// Samples that every pixel of the tile has.
    pub samples: u64,
    /// Samples that were not finite; they counted as black.
    pub broken: u64,
    /// Per pixel the sum of samples.
    pub(crate) sums: Vec<[f64; 3]>,
    /// Per pixel the sum of squares; empty unless the variance is wanted.
    pub(crate) squares: Vec<[f64; 3]>,
    /// Per pixel the sums of the features' channels, one after the other.
    pub(crate) features: Vec<f64>,
}

/// A picture under way.
#[derive(Clone, Debug, PartialEq)]
pub struct Film {
    size: [u32; 2],
    aovs: Vec<Aov>,
    pub(crate) tiles: Vec<Tile>,
    /// Of methods whose light paths reach the film by themselves.
    pub(crate) splats: Option<Splats>,
}

impl Film {
    /// An empty film.
    ///
    /// # Errors
    /// [`Error::Scene`] for a film without pixels or too large a one (2²⁸ pixels).
    pub fn new(size: [u32; 2], aovs: &[Aov]) -> Result<Self> {
        let pixels = u64::from(size[0]) * u64::from(size[1]);
        if pixels == 0 || pixels > 1 << 28 {
            return Err(Error::Scene(format!(
                "a picture of {} × {} pixels: from 1 to 2^28 pixels can be rendered",
                size[0], size[1]
            )));
        }
        let channels: usize = aovs.iter().filter(|a| **a != Aov::Variance).map(|a| a.channels().len()).sum();
        let squared = aovs.contains(&Aov::Variance);
        let mut tiles = Vec::new();
        for y in (0..size[1]).step_by(TILE as usize) {
            for x in (0..size[0]).step_by(TILE as usize) {
                let tile = [TILE.min(size[0] - x), TILE.min(size[1] - y)];
                let n = (tile[0] * tile[1]) as usize;
                tiles.push(Tile {
                    origin: [x, y],
                    size: tile,
                    samples: 0,
                    broken: 0,
                    sums: vec![[0.0; 3]; n],
                    squares: vec![[0.0; 3]; if squared { n } else { 0 }],
                    features: vec![0.0; n * channels],
                });
            }
        }
        Ok(Self { size, aovs: aovs.to_vec(), tiles, splats: None })
    }

    /// The same film, ready for methods that splat ([`crate::integrator::Integrator::splats`]), of a picture of about the brightness
    /// `typical` ([`crate::light::Lights::typical`]).
    pub fn with_splats(mut self, typical: f64) -> Self {
        let pixels = self.size[0] as usize * self.size[1] as usize;
        self.splats = Some(Splats::new(pixels, self.aovs.contains(&Aov::Variance), typical));
        self
    }

    /// Samples per pixel on average: as many light paths as this times the pixels have been splatted.
    pub(crate) fn mean_samples(&self) -> f64 {
        let paths: f64 = self.tiles.iter().map(|t| t.samples as f64 * t.sums.len() as f64).sum();
        paths / (f64::from(self.size[0]) * f64::from(self.size[1]))
    }

    /// What the splats give channel `c` of pixel `at`, and the variance of that.
    fn splatted(&self, at: usize, c: usize) -> (f64, f64) {
        let Some(splats) = &self.splats else { return (0.0, 0.0) };
        let samples = self.mean_samples();
        let pixels = splats.sums.len() as f64;
        let (sum, square) = splats.sum(at, c);
        // One path's mean share is of one pixel's sample the part 1/pixels.
        (sum / samples.max(1e-300), pixels * pixels * variance_of(sum, square, samples * pixels))
    }

    /// Width and height.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// The feature images that are collected.
    pub fn aovs(&self) -> &[Aov] {
        &self.aovs
    }

    /// Fewest and most samples of a pixel.
    pub fn samples(&self) -> (u64, u64) {
        let of = |f: fn(u64, u64) -> u64| self.tiles.iter().map(|t| t.samples).reduce(f).unwrap_or(0);
        (of(u64::min), of(u64::max))
    }

    /// Samples that were not finite and counted as black.
    pub fn broken(&self) -> u64 {
        self.tiles.iter().map(|t| t.broken).sum()
    }

    /// The picture so far, rows from the top, RGB interleaved; pixels without samples are black.
    pub fn rgb(&self) -> Vec<f32> {
        let mut out = vec![0.0; self.size[0] as usize * self.size[1] as usize * 3];
        self.each(|at, tile, i| {
            let sums = tile.sums[i];
            (0..3).for_each(|c| {
                out[3 * at + c] = (sums[c] / tile.samples.max(1) as f64 + self.splatted(at, c).0) as f32;
            });
        });
        out
    }

    /// All channels by their names: `R`, `G`, `B`, `samples` (per pixel, the weight for merging), and the features.
    pub fn channels(&self) -> Vec<(&'static str, Vec<f32>)> {
        let n = self.size[0] as usize * self.size[1] as usize;
        let plane = |f: &dyn Fn(&Tile, usize, usize) -> f64| {
            let mut out = vec![0.0; n];
            self.each(|at, tile, i| out[at] = f(tile, i, at) as f32);
            out
        };
        let mut channels: Vec<(&'static str, Vec<f32>)> = Vec::new();
        for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
            channels.push((name, plane(&|t, i, at| t.sums[i][c] / t.samples.max(1) as f64 + self.splatted(at, c).0)));
        }
        channels.push(("samples", plane(&|t, _, _| t.samples as f64)));
        let mut first = 0;
        for aov in &self.aovs {
            for (c, name) in aov.channels().iter().enumerate() {
                let values = match aov {
                    Aov::Variance => plane(&|t, i, at| {
                        variance_of(t.sums[i][c], t.squares[i][c], t.samples as f64) + self.splatted(at, c).1
                    }),
                    _ => plane(&|t, i, _| t.features[i * t.per_pixel() + first + c] / t.samples.max(1) as f64),
                };
                channels.push((name, values));
            }
            first += if *aov == Aov::Variance { 0 } else { aov.channels().len() };
        }
        channels
    }

    /// Calls `f` with the number of each pixel in the picture, its tile and its number in the tile.
    fn each(&self, mut f: impl FnMut(usize, &Tile, usize)) {
        for tile in &self.tiles {
            for i in 0..tile.sums.len() {
                let (x, y) = (tile.origin[0] as usize + i % tile.size[0] as usize, i / tile.size[0] as usize);
                f((tile.origin[1] as usize + y) * self.size[0] as usize + x, tile, i);
            }
        }
    }
}

impl Tile {
    fn per_pixel(&self) -> usize {
        self.features.len() / self.sums.len()
    }

    /// Where pixel `i` of the tile is in the picture.
    pub(crate) fn pixel(&self, i: usize) -> [u32; 2] {
        let i = i as u32;
        [self.origin[0] + i % self.size[0], self.origin[1] + i / self.size[0]]
    }

    /// Adds one sample to pixel `i` of the tile; [`Tile::samples`] is the caller's to count, once for all pixels.
    #[inline]
    pub(crate) fn add(&mut self, i: usize, value: Rgb) {
        if !value.is_finite() {
            self.broken += 1;
            return;
        }
        for c in 0..3 {
            let v = f64::from(value[c]);
            self.sums[i][c] += v;
            if let Some(squares) = self.squares.get_mut(i) {
                squares[c] += v * v;
            }
        }
    }

    /// Adds what a sample met.
    pub(crate) fn add_features(&mut self, aovs: &[Aov], i: usize, f: &Features) {
        let per_pixel = self.per_pixel();
        let mut slots = self.features[i * per_pixel..(i + 1) * per_pixel].iter_mut();
        let mut push = |values: &[f32]| {
            values
                .iter()
                .filter_map(|v| Some((v, slots.next()?)))
                .filter(|(v, _)| v.is_finite())
                .for_each(|(v, s)| *s += f64::from(*v));
        };
        for aov in aovs {
            match aov {
                Aov::Albedo => push(&f.albedo.to_array()),
                Aov::Normal => push(&f.ns.to_array()),
                Aov::GeometricNormal => push(&f.n.to_array()),
                Aov::Position => push(&f.p.to_array()),
                Aov::Uv => push(&f.uv.to_array()),
                Aov::Depth => push(&[f.depth]),
                Aov::Variance => {}
            }
        }
    }
}

/// Variance of the mean of `n` samples with this sum and sum of squares.
fn variance_of(sum: f64, squares: f64, n: f64) -> f64 {
    if n < 2.0 {
        return 0.0;
    }
    ((squares - sum * sum / n) / (n - 1.0)).max(0.0) / n
}
