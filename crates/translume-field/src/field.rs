//! A compressed field, and pictures from it.
//!
//! A picture is, on the field's [`Domain`], the sum of its layers with weights that depend on the light alone. It is
//! linear light relative to that of the stack's lights: a directional light as strong as the stack's gives the stack's
//! pictures.

use crate::basis::Basis;
use crate::domain::{exp, ln};
use crate::sphere::{Interpolation, Kernel};
use crate::texture::Texture;
use crate::{Domain, Error, Result};
use nalgebra::DMatrix;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How a field was made, and so what its layers are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Model {
    /// Planes with weights in colour, found in a closed loop, cross-validated interpolation: the default.
    Layers,
    /// The thesis' eigenimages of log light.
    LogPca,
    /// The same of linear light.
    LinearPca,
    /// Polynomial texture maps.
    Ptm,
    /// Hemispherical harmonics of orders 0 to 2.
    Hsh,
    /// Planes of another program, as it left them.
    Imported,
}

/// Where a layer's weight for a direction comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum Angular {
    /// Weights at the stack's lights: a row a light.
    Lights {
        /// Whether weights have colour: then the columns are red, green and blue of a constant, then of each channel of each
        /// layer. Otherwise layers have three channels, which are the picture's, and there is a column for each layer.
        colour: bool,
        /// Unit directions.
        lights: Vec<[f32; 3]>,
        /// Lights × columns.
        table: DMatrix<f32>,
        /// What is between the lights.
        kernel: Kernel,
    },
    /// Functions of the direction, one a layer.
    Basis(Basis),
}

/// A compressed reflectance field.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// How it was made.
    pub model: Model,
    /// Width in texels.
    pub width: usize,
    /// Height in texels.
    pub height: usize,
    /// The scale of the sums.
    pub domain: Domain,
    /// Light that a value of 1 on a linear scale stands for.
    pub white: f32,
    /// The textures.
    pub layers: Vec<Texture>,
    /// Weights by direction.
    pub angular: Angular,
}

/// What the layers are multiplied with for one light.
#[derive(Clone, Debug, PartialEq)]
pub struct Mix {
    /// Added everywhere, by channel.
    pub constant: [f32; 3],
    /// Weight by channel: of each plane if the weights have colour, else of each layer.
    pub layers: Vec<[f32; 3]>,
}

impl Field {
    /// Whether the weights have colour ([`Angular::Lights`]).
    pub fn in_colour(&self) -> bool {
        matches!(self.angular, Angular::Lights { colour: true, .. })
    }

    /// Planes of all textures.
    pub fn planes(&self) -> usize {
        self.layers.iter().map(|l| l.codec.channels()).sum()
    }

    /// Bytes of the textures.
    pub fn texture_bytes(&self) -> usize {
        self.layers.iter().map(|l| l.data.len()).sum()
    }

    /// The unit directions of the stack's lights, where the field knows them.
    pub fn lights(&self) -> &[[f32; 3]] {
        match &self.angular {
            Angular::Lights { lights, .. } => lights,
            Angular::Basis(_) => &[],
        }
    }

    fn mix(&self, columns: &[f32]) -> Mix {
        if self.in_colour() {
            let mut triples = columns.chunks_exact(3).map(|c| [c[0], c[1], c[2]]);
            return Mix { constant: triples.next().unwrap_or_default(), layers: triples.collect() };
        }
        Mix { constant: [0.0; 3], layers: columns.iter().map(|w| [*w; 3]).collect() }
    }

    /// The weights of light `i` of the stack, as they were found, without interpolation.
    pub fn mix_of_light(&self, i: usize) -> Option<Mix> {
        match &self.angular {
            Angular::Lights { table, .. } if i < table.nrows() => {
                Some(self.mix(&table.row(i).iter().copied().collect::<Vec<_>>()))
            }
            _ => None,
        }
    }
}

/// A field decoded into memory, ready to be lit.
#[derive(Debug)]
pub struct Relighter<'a> {
    field: &'a Field,
    /// By layer, then channel.
    planes: Vec<Vec<u16>>,
    interpolation: Option<Interpolation>,
}

/// Texels of a tile: sums of three channels stay in the first cache.
const TILE: usize = 1024;

impl<'a> Relighter<'a> {
    /// Decodes the textures and prepares the interpolation.
    ///
    /// # Errors
    /// [`Error::Parameter`] when textures and weights do not fit each other.
    pub fn new(field: &'a Field) -> Result<Self> {
        let planes: Result<Vec<_>> = field.layers.iter().map(|l| l.decode(field.width, field.height)).collect();
        let odd = !field.in_colour() && field.layers.iter().any(|l| l.codec.channels() != 3);
        let interpolation = match &field.angular {
            Angular::Lights { colour, lights, table, kernel } => {
                let columns = if *colour { 3 + 3 * field.planes() } else { field.layers.len() };
                if odd || table.shape() != (lights.len(), columns) || lights.is_empty() {
                    return Err(Error::Parameter("the weights do not fit the layers".into()));
                }
                Some(Interpolation::new(*kernel, lights, table, field.domain))
            }
            Angular::Basis(basis) => {
                if odd || basis.terms() != field.layers.len() {
                    return Err(Error::Parameter(format!("{} layers for {basis:?}", field.layers.len())));
                }
                None
            }
        };
        Ok(Self { field, planes: planes?.into_iter().flatten().collect(), interpolation })
    }

    /// The weights for a unit direction to the light.
    pub fn mix(&self, direction: [f32; 3]) -> Mix {
        match (&self.interpolation, &self.field.angular) {
            (Some(interpolation), _) => self.field.mix(&interpolation.at(direction)),
            (None, Angular::Basis(basis)) => self.field.mix(&basis.at(direction)),
            // Not made by new().
            (None, Angular::Lights { .. }) => self.field.mix(&[]),
        }
    }

    /// Linear light under one light: interleaved RGB in the stack's unit.
    pub fn picture(&self, mix: &Mix) -> Vec<f32> {
        let mut out = vec![0.0; 3 * self.field.width * self.field.height];
        self.tiles(mix, &mut out, |tile, out| {
            for (i, p) in out.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                *p = [0, 1, 2].map(|c| tile[c][i] * self.field.white);
            }
        });
        out
    }

    /// Adds the picture of one light, times `colour`, to `sum`.
    pub fn add_picture(&self, mix: &Mix, colour: [f32; 3], sum: &mut [f32]) {
        let scale = colour.map(|c| c * self.field.white);
        self.tiles(mix, sum, |tile, out| {
            for (i, p) in out.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                (0..3).for_each(|c| p[c] += tile[c][i] * scale[c]);
            }
        });
    }

    /// The picture as a display shows it with white at `exposure` times the stack's, gamma 2.2: 8-bit RGB.
    pub fn display(&self, mix: &Mix, exposure: f32, out: &mut [u8]) {
        self.tiles(mix, out, |tile, out| {
            for plane in tile.iter_mut() {
                plane.iter_mut().for_each(|v| *v = 255.0 * gamma(*v * exposure) + 0.5);
            }
            for (i, p) in out.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                *p = [0, 1, 2].map(|c| tile[c][i] as u8);
            }
        });
    }

    /// Sums the layers tile by tile, turns them into light relative to white, and calls `put` with planes of a tile and its
    /// part of `out` (three values a texel).
    fn tiles<T: Send>(&self, mix: &Mix, out: &mut [T], put: impl Fn(&mut [[f32; TILE]; 3], &mut [T]) + Sync) {
        let sums = self.prepare(mix);
        out.par_chunks_mut(3 * TILE).enumerate().for_each(|(i, out)| self.tile(&sums, i * TILE, out, &put));
    }

    /// What is the same for all texels: codes are 16-bit integers, weights take up their ranges.
    fn prepare(&self, mix: &Mix) -> Sums {
        let step = |low: f32, high: f32| (high - low) / 65535.0;
        let ranges: Vec<[(f32, f32); 3]> = if self.field.in_colour() {
            let planes = self.field.layers.iter().flat_map(|l| (0..l.codec.channels()).map(|k| (l.low[k], l.high[k])));
            planes.map(|(low, high)| [(low, step(low, high)); 3]).collect()
        } else {
            let ranges = |l: &Texture| [0, 1, 2].map(|c| (l.low[c], step(l.low[c], l.high[c])));
            self.field.layers.iter().map(ranges).collect()
        };
        let mut sums = Sums { constant: mix.constant, weights: Vec::with_capacity(mix.layers.len()) };
        for (w, range) in mix.layers.iter().zip(&ranges) {
            (0..3).for_each(|c| sums.constant[c] += w[c] * range[c].0);
            sums.weights.push([0, 1, 2].map(|c| w[c] * range[c].1));
        }
        sums
    }

    /// One tile, with the widest vectors that the processor has.
    fn tile<T>(&self, sums: &Sums, start: usize, out: &mut [T], put: &impl Fn(&mut [[f32; TILE]; 3], &mut [T])) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            #[allow(unsafe_code, reason = "eight lanes instead of four: bench-field speed")]
            // SAFETY: the processor has AVX2, which is all that the function asks for.
            unsafe {
                self.tile_avx2(sums, start, out, put);
            }
            return;
        }
        self.tile_any(sums, start, out, put);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn tile_avx2<T>(&self, sums: &Sums, start: usize, out: &mut [T], put: &impl Fn(&mut [[f32; TILE]; 3], &mut [T])) {
        self.tile_any(sums, start, out, put);
    }

    #[inline(always)]
    fn tile_any<T>(&self, sums: &Sums, start: usize, out: &mut [T], put: &impl Fn(&mut [[f32; TILE]; 3], &mut [T])) {
        let mut tile = sums.constant.map(|c| [c; TILE]);
        let n = out.len() / 3;
        let codes = |plane: usize| &self.planes[plane][start..start + n];
        if self.field.in_colour() {
            for (first, four) in sums.weights.chunks(4).enumerate() {
                let at =
                    |i: usize| (codes(4 * first + i.min(four.len() - 1)), four.get(i).copied().unwrap_or_default());
                add_four([at(0), at(1), at(2), at(3)], &mut tile);
            }
        } else {
            for (j, w) in sums.weights.iter().enumerate() {
                for (c, sums) in tile.iter_mut().enumerate() {
                    sums.iter_mut().zip(codes(3 * j + c)).for_each(|(s, code)| *s += w[c] * f32::from(*code));
                }
            }
        }
        tile.iter_mut().for_each(|sums| self.field.domain.light(&mut sums[..n]));
        put(&mut tile, out);
    }
}

/// Weights of codes.
struct Sums {
    constant: [f32; 3],
    weights: Vec<[f32; 3]>,
}

/// Adds four layers to the sums of all channels at once: each code is converted once, each sum loaded and stored once.
#[inline(always)]
fn add_four(layers: [(&[u16], [f32; 3]); 4], tile: &mut [[f32; TILE]; 3]) {
    let [(a, u), (b, v), (c, w), (d, x)] = layers;
    let n = a.len().min(TILE);
    let (a, b, c, d) = (&a[..n], &b[..n], &c[..n], &d[..n]);
    let [red, green, blue] = tile;
    let (red, green, blue) = (&mut red[..n], &mut green[..n], &mut blue[..n]);
    for i in 0..n {
        let [a, b, c, d] = [a[i], b[i], c[i], d[i]].map(f32::from);
        red[i] += (u[0] * a + v[0] * b) + (w[0] * c + x[0] * d);
        green[i] += (u[1] * a + v[1] * b) + (w[1] * c + x[1] * d);
        blue[i] += (u[2] * a + v[2] * b) + (w[2] * c + x[2] * d);
    }
}

/// v^(1/2.2) of [0, 1], clipped, without branches; to 1e-4.
#[inline(always)]
fn gamma(v: f32) -> f32 {
    exp(ln(v.clamp(1e-9, 1.0)) * (1.0 / 2.2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::texture::Codec;

    #[test]
    fn the_quick_gamma_is_right_to_a_hundredth_of_a_code() {
        for i in 0..=4096 {
            let v = i as f32 / 4096.0;
            let exact = v.powf(1.0 / 2.2);
            assert!((gamma(v) - exact).abs() < 1e-4, "{v}: {} for {exact}", gamma(v));
        }
        assert_eq!((gamma(-3.0) * 255.0) as u8, 0);
        assert!((gamma(7.0) - 1.0).abs() < 1e-5);
    }

    /// Two layers of two texels, exactly stored; ranges 1 … 3 and 0 … 1.
    fn small() -> Field {
        let layer = |data: [u8; 2], low: f32, high: f32| Texture {
            codec: Codec::R8,
            data: data.to_vec(),
            low: [low; 3],
            high: [high; 3],
        };
        let (a, b) = (0.8f32, 0.6f32);
        Field {
            model: Model::Layers,
            width: 2,
            height: 1,
            domain: Domain::Linear,
            white: 2.0,
            layers: vec![layer([0, 255], 1.0, 3.0), layer([255, 0], 0.0, 1.0)],
            angular: Angular::Lights {
                colour: true,
                lights: vec![[0.0, 0.0, 1.0], [b, 0.0, a], [0.0, -b, a]],
                table: DMatrix::from_fn(3, 9, |i, j| (i + j) as f32 * 0.1),
                kernel: Kernel::Gaussian { width: 0.3 },
            },
        }
    }

    #[test]
    fn a_picture_is_the_weighted_sum_of_its_layers() {
        let field = small();
        let relighter = Relighter::new(&field).unwrap();
        let got = relighter.picture(&field.mix_of_light(1).unwrap());
        // White 2 × (constant + w1 (1 | 3) + w2 (1 | 0)), weights 0.1, 0.2, … by channel.
        let expected = [0, 1, 2].map(|c| 2.0 * (0.1 + 0.4 + 0.7 + 0.3 * c as f32));
        assert!(got[..3].iter().zip(expected).all(|(g, e)| (g - e).abs() < 1e-5), "{got:?}");
        let expected = [0, 1, 2].map(|c| 2.0 * (0.1 + 3.0 * 0.4 + 0.4 * c as f32));
        assert!(got[3..].iter().zip(expected).all(|(g, e)| (g - e).abs() < 1e-5), "{got:?}");
        // At a light, the interpolation gives the light's weights.
        let mix = relighter.mix(field.lights()[1]);
        assert!((mix.layers[1][2] - field.mix_of_light(1).unwrap().layers[1][2]).abs() < 1e-3);
        let mut sum = vec![1.0; 6];
        relighter.add_picture(&field.mix_of_light(1).unwrap(), [0.5, 0.0, 1.0], &mut sum);
        assert!((sum[0] - 1.0 - 0.5 * got[0]).abs() < 1e-5 && sum[1] == 1.0 && (sum[5] - 1.0 - got[5]).abs() < 1e-5);
        let mut bytes = [0; 6];
        relighter.display(&field.mix_of_light(0).unwrap(), 0.25, &mut bytes);
        let light = relighter.picture(&field.mix_of_light(0).unwrap());
        for (b, l) in bytes.iter().zip(&light) {
            assert!((f32::from(*b) - 255.0 * (l / 2.0 * 0.25).powf(1.0 / 2.2)).abs() < 0.6, "{bytes:?} {light:?}");
        }
    }

    #[test]
    fn weights_that_do_not_fit_are_refused() {
        let mut field = small();
        field.layers.pop();
        assert!(Relighter::new(&field).is_err());
        field.angular = Angular::Basis(Basis::Ptm);
        assert!(Relighter::new(&field).is_err());
    }
}
