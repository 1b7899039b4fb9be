//! A model seen by a fixed camera under light that moves [Goesele 2004, §8] [Lensch et al. 2003].
//!
//! What the view decides is found once: what its samples see, the rows of F of the vertices in sight (decoded, as 16 bits of a float each), and
//! the kernels of the texels in sight. For each light, F P is a product with those rows alone, and only with blocks of columns whose
//! vertices are lit: vertices are sorted along a space-filling curve, so that the lit ones lie together.

use super::irradiance::Power;
use super::lights::{Sight, look};
use crate::capture::{Camera, Surface};
use crate::hierarchical::{Atlas, Hierarchical, RADIUS};
use glam::{Vec3, Vec4};
use rayon::prelude::*;
use std::f32::consts::PI;
use translume_bxdf::fresnel;
use translume_core::morton;
use translume_trace::Ray;

/// Which light to show.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// All of it.
    Whole,
    /// K ∗ P alone; it may be negative.
    Local,
    /// T · (F P) alone.
    Global,
}

/// What a sample of a pixel sees.
struct Seen {
    pixel: u32,
    /// Numbers of the corners among the rows, and their weights.
    rows: [u32; 3],
    weights: [f32; 3],
    /// Numbers of texels among those in sight, and their weights.
    texels: [(u32, f32); 4],
    /// F_t(η, ω_o)/π, divided by the samples of a pixel; times T.
    factor: Vec3,
    /// The same without T.
    plain: f32,
}

/// A model in front of a camera.
pub struct Relighter {
    /// Columns and rows of the pictures.
    pub size: (usize, usize),
    seen: Vec<Seen>,
    /// Vertices along the curve; columns of `rows` in their order.
    order: Vec<u32>,
    /// Columns of a row, a multiple of [`BLOCK`].
    stride: usize,
    /// Upper halves of the floats of F: for each row red, green, blue, `stride` each.
    rows: Vec<u16>,
    /// For each texel in sight, the 49 neighbours with power and their K.
    neighbours: Vec<[u32; CELLS]>,
    kernels: Vec<[Vec4; CELLS]>,
}

const CELLS: usize = ((2 * RADIUS + 1) * (2 * RADIUS + 1)) as usize;
/// Columns that are skipped together if they are dark.
const BLOCK: usize = 32;

impl Relighter {
    /// Prepares `model` for a view. `surface` is its mesh. `None` where the view has no direction.
    pub fn new(model: &Hierarchical, surface: &Surface, sight: &Sight) -> Option<Self> {
        let samples = sight_samples(surface, sight)?;
        Some(Self::of_samples(model, (sight.width, sight.height), sight.samples, samples))
    }

    /// Prepares `model` for the camera of a capture, one sample a pixel.
    pub fn for_camera(model: &Hierarchical, surface: &Surface, camera: &Camera) -> Self {
        let size = (camera.width, camera.height);
        let single = |v: [f64; 3]| Vec3::from_array(v.map(|x| x as f32));
        let direction = |x: f32, y: f32| single(camera.direction([f64::from(x), f64::from(y)]));
        let samples = cast(surface, (size.0, size.1, 1), single(camera.eye()), direction);
        Self::of_samples(model, size, 1, samples)
    }

    fn of_samples(model: &Hierarchical, size: (usize, usize), per_side: usize, samples: Vec<Sample>) -> Self {
        let order = morton::order(&model.mesh.positions.iter().map(|p| Vec3::from(*p)).collect::<Vec<_>>());
        let (mut rows, mut texels) = (Numbers::new(model.mesh.positions.len()), Numbers::new(model.atlas.texels.len()));
        let share = 1.0 / (per_side * per_side) as f32;
        let mut seen = Vec::with_capacity(samples.len());
        for (pixel, face, uv, cos) in samples {
            let corners = model.mesh.indices[face as usize];
            let four = model.atlas.between(face, uv);
            let plain = share * (1.0 - fresnel::dielectric(cos, model.eta as f32).reflectance) / PI;
            let detail: Vec3 = four.iter().map(|&(t, w)| w * Vec3::from(model.detail[t as usize])).sum();
            seen.push(Seen {
                pixel,
                rows: corners.map(|v| rows.number(v)),
                weights: [1.0 - uv[0] - uv[1], uv[0], uv[1]],
                texels: four.map(|(t, w)| (texels.number(t), w)),
                factor: plain * detail,
                plain,
            });
        }
        let stride = order.len().next_multiple_of(BLOCK);
        let row = |&vertex: &u32| {
            let mut out = vec![0u16; 3 * stride];
            for (column, &other) in order.iter().enumerate() {
                let f = model.throughput.value(vertex as usize, other as usize);
                // Rounded to the nearest float of 16 bits.
                (0..3).for_each(|c| out[c * stride + column] = (f[c].to_bits().saturating_add(0x8000) >> 16) as u16);
            }
            out
        };
        let rows = rows.all.par_iter().flat_map_iter(row).collect();
        let neighbours = texels.all.par_iter().map(|&t| neighbours(&model.atlas, t)).collect();
        let kernel = |&t: &u32| {
            std::array::from_fn(|cell| {
                let k = model.kernels[t as usize * CELLS + cell].map(half::f16::to_f32);
                Vec4::new(k[0], k[1], k[2], 0.0)
            })
        };
        let kernels = texels.all.par_iter().map(kernel).collect();
        Self { size, seen, order, stride, rows, neighbours, kernels }
    }

    /// Linear RGB of the view, row by row.
    pub fn picture(&self, power: &Power, part: Part) -> Vec<[f32; 3]> {
        let global = if part == Part::Local { Vec::new() } else { self.global(&power.vertices) };
        let local = if part == Part::Global { Vec::new() } else { self.local(&power.texels) };
        let value = |s: &Seen| {
            let smooth = |i: usize| global.get(s.rows[i] as usize).map_or(Vec3::ZERO, |g: &Vec3| s.weights[i] * g);
            let near = |(t, w): (u32, f32)| local.get(t as usize).map_or(Vec3::ZERO, |l: &Vec3| w * l);
            let sum =
                s.factor * (smooth(0) + smooth(1) + smooth(2)) + s.plain * s.texels.map(near).iter().sum::<Vec3>();
            (s.pixel, sum)
        };
        let mut out = vec![[0.0f32; 3]; self.size.0 * self.size.1];
        let values: Vec<(u32, Vec3)> = self.seen.par_iter().with_min_len(4096).map(value).collect();
        for (pixel, sum) in values {
            let p = &mut out[pixel as usize];
            // The samples of a pixel follow each other; noise of K must not make negative light of the whole.
            (0..3).for_each(|c| p[c] += if part == Part::Whole { sum[c].max(0.0) } else { sum[c] });
        }
        out
    }

    /// F P at the vertices in sight [Goesele 2004, §8].
    fn global(&self, power: &[Vec3]) -> Vec<Vec3> {
        let n = self.stride;
        let mut columns = vec![0.0f32; 3 * n];
        for (column, &vertex) in self.order.iter().enumerate() {
            (0..3).for_each(|c| columns[c * n + column] = power[vertex as usize][c]);
        }
        let dark = |block: &usize| (0..3).all(|c| columns[c * n + block * BLOCK..][..BLOCK].iter().all(|p| *p == 0.0));
        let lit: Vec<usize> = (0..n / BLOCK).filter(|b| !dark(b)).collect();
        let row = |row: &[u16]| {
            Vec3::from_array([0, 1, 2].map(|c| {
                let mut sums = [0.0f32; BLOCK];
                for &block in &lit {
                    let at = c * n + block * BLOCK;
                    let (f, p) = (&row[at..at + BLOCK], &columns[at..at + BLOCK]);
                    for i in 0..BLOCK {
                        sums[i] += f32::from_bits(u32::from(f[i]) << 16) * p[i];
                    }
                }
                sums.iter().sum()
            }))
        };
        self.rows.par_chunks(3 * n).with_min_len(64).map(row).collect()
    }

    /// K ∗ P at the texels in sight [Goesele 2004, §8].
    fn local(&self, power: &[Vec3]) -> Vec<Vec3> {
        let padded: Vec<Vec4> = power.iter().map(|p| p.extend(0.0)).chain([Vec4::ZERO]).collect();
        let one = |(neighbours, kernel): (&[u32; CELLS], &[Vec4; CELLS])| {
            let mut sum = Vec4::ZERO;
            for cell in 0..CELLS {
                sum += kernel[cell] * padded[neighbours[cell] as usize];
            }
            sum.truncate()
        };
        self.neighbours.par_iter().zip(&self.kernels).with_min_len(1024).map(one).collect()
    }
}

/// Numbers in the order in which things are met.
struct Numbers {
    of: Vec<u32>,
    all: Vec<u32>,
}

impl Numbers {
    fn new(n: usize) -> Self {
        Self { of: vec![u32::MAX; n], all: Vec::new() }
    }

    fn number(&mut self, thing: u32) -> u32 {
        let slot = &mut self.of[thing as usize];
        if *slot == u32::MAX {
            *slot = self.all.len() as u32;
            self.all.push(thing);
        }
        *slot
    }
}

/// The texels of a kernel; the number of texels, one past the last, where there is none.
fn neighbours(atlas: &Atlas, texel: u32) -> [u32; CELLS] {
    let side = 2 * RADIUS + 1;
    std::array::from_fn(|cell| {
        let (dx, dy) = (cell as i32 % side - RADIUS, cell as i32 / side - RADIUS);
        atlas.neighbour(texel as usize, dx, dy).unwrap_or(atlas.texels.len()) as u32
    })
}

/// Pixel, triangle, place on it and cosine for all samples that see the mesh from outside.
pub(crate) type Sample = (u32, u32, [f32; 2], f32);

/// What the samples of a view see; `None` where it has no direction.
pub(crate) fn sight_samples(surface: &Surface, sight: &Sight) -> Option<Vec<Sample>> {
    let [right, down, forward] = look(sight.eye, sight.target, sight.up)?;
    let eye = Vec3::from_array(sight.eye.map(|x| x as f32));
    let half = (0.5 * sight.fov_deg.to_radians()).tan() as f32;
    let (w, h) = (sight.width as f32, sight.height as f32);
    let direction = |x: f32, y: f32| {
        let (px, py) = ((2.0 * x - w) / w, (2.0 * y - h) / w);
        (forward + half * (px * right + py * down)).normalize()
    };
    Some(cast(surface, (sight.width, sight.height, sight.samples), eye, direction))
}

/// What rays from `eye` see, along the directions of places of the picture, `n` × `n` in each pixel.
fn cast(
    surface: &Surface,
    (w, h, n): (usize, usize, usize),
    eye: Vec3,
    direction: impl Fn(f32, f32) -> Vec3 + Sync,
) -> Vec<Sample> {
    let row = |y: usize| {
        let direction = &direction;
        let one = move |i: usize| {
            let (x, sub) = (i / (n * n), i % (n * n));
            let at = |k: usize, s: usize| k as f32 + (s as f32 + 0.5) / n as f32;
            let direction = direction(at(x, sub % n), at(y, sub / n));
            let (face, uv) = surface.first_hit(&Ray::new(eye, direction))?;
            let [a, b, c] = surface.mesh.corners(face as usize);
            let cos = -direction.dot((b - a).cross(c - a).normalize_or_zero());
            (cos > 0.0).then_some(((y * w + x) as u32, face, uv, cos))
        };
        (0..w * n * n).filter_map(one).collect::<Vec<Sample>>()
    };
    (0..h).into_par_iter().flat_map_iter(row).collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::capture::Surface;
    use crate::hierarchical::{AtlasParams, tests::sphere};
    use crate::relight::{Light, Sources};
    use std::path::Path;

    pub(crate) const SIGHT: Sight = Sight {
        eye: [0.0, -60.0, 5.0],
        target: [0.0; 3],
        up: [0.0, 0.0, 1.0],
        fov_deg: 24.0,
        width: 48,
        height: 36,
        samples: 1,
    };

    /// Energy leaves as the integral over the surface says, for a fall-off that is sharper than the mesh.
    #[test]
    fn local_and_global_together_are_the_integral_of_r() {
        let mesh = sphere(14, 10.0);
        let fall_off = |d: f32| [0.05, 0.04, 0.02].map(|s| s * ((-d / 0.8).exp() + 0.05 * (-d / 4.0).exp()));
        let model = Hierarchical::from_transfer(
            mesh.clone(),
            1.0,
            &AtlasParams::default(),
            |_, d| fall_off(d),
            |_, _| [2.0, 1.0, 1.0],
        )
        .unwrap();
        let surface = Surface::new(mesh.clone()).unwrap();
        let lights = [Light::Point { position: [20.0, -40.0, 20.0], intensity: [1000.0, 1000.0, 1000.0] }];
        let power = Sources::new(&lights, Path::new("")).unwrap().shine(&surface, &model.atlas, 1.0);
        let relighter = Relighter::new(&model, &surface, &SIGHT).unwrap();
        let found = relighter.picture(&power, Part::Whole);
        let samples = sight_samples(&surface, &SIGHT).unwrap();
        let texels = &model.atlas.texels;
        let (mut error, mut total) = (0.0f64, 0.0f64);
        for &(pixel, face, uv, _) in &samples {
            let [a, b, c] = mesh.corners(face as usize);
            let at = a + uv[0] * (b - a) + uv[1] * (c - a);
            let sum: f32 = texels.iter().zip(&power.texels).map(|(t, p)| p.y * fall_off(t.at.distance(at))[1]).sum();
            error += f64::from(found[pixel as usize][1] - sum / PI).powi(2);
            total += f64::from(sum / PI).powi(2);
        }
        assert!(samples.len() > 500 && (error / total).sqrt() < 0.06, "{}", (error / total).sqrt());
        // The modulation scales local and global light.
        let red = |p: [f32; 3]| p[0] / p[1];
        let bright = found.iter().filter(|p| p[1] > 0.0).map(|p| red(*p));
        assert!(
            bright.clone().count() > 500 && bright.clone().all(|r| (2.2..2.8).contains(&r)),
            "{:?}",
            bright.fold((9.0f32, 0.0f32), |(a, b), r| (a.min(r), b.max(r)))
        );
        // Each alone is not enough, and they add up.
        let [local, global] = [Part::Local, Part::Global].map(|p| relighter.picture(&power, p));
        let sum = |p: &[[f32; 3]]| p.iter().map(|v| f64::from(v[1])).sum::<f64>();
        assert!((sum(&local) + sum(&global)) / sum(&found) - 1.0 < 1e-3);
        assert!(
            sum(&local) > 0.2 * sum(&found) && sum(&global) > 0.1 * sum(&found),
            "{} {}",
            sum(&local),
            sum(&global)
        );
    }
}
