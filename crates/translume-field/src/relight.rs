//! Pictures from a field: weights for a light, the sum of the layers, light from it.
//!
//! Two ways to the same sums. Fields of BC1 and BC4 are lit block by block ([`crate::lines`]), 25 bytes of memory a texel at 16 layers;
//! others, and fields with blocks that lie on no line, from decoded planes.

use crate::field::{Angular, Field, Mix};
use crate::lights::Shot;
use crate::lines::{Factors, GROUP, Lines, Steps, TEXELS, Tile, last_code};
use crate::sphere::{Interpolation, points};
use crate::texture::Texture;
use crate::tiles::SIDE;
use crate::{Error, Result};
use rayon::prelude::*;

/// A field in memory, ready to be lit.
#[derive(Debug)]
pub struct Relighter<'a> {
    field: &'a Field,
    store: Store,
    interpolation: Option<Interpolation>,
}

#[derive(Debug)]
enum Store {
    Lines(Lines),
    /// 16-bit codes by layer, then channel.
    Planes(Vec<Vec<u16>>),
}

type Rgb = [f32; 3];

/// What becomes of light. A trait and no closure, as closures are not always compiled for the vectors of their caller.
trait Put<T>: Sync {
    /// Takes light relative to white, by channel, of texels side by side.
    fn put(&self, light: [&[f32]; 3], out: &mut [T]);
}

/// Added to linear RGB, times this.
struct Add(Rgb);

impl Put<[f32; 3]> for Add {
    #[inline(always)]
    fn put(&self, light: [&[f32]; 3], out: &mut [[f32; 3]]) {
        for (i, p) in out.iter_mut().enumerate() {
            (0..3).for_each(|c| p[c] += light[c][i] * self.0[c]);
        }
    }
}

/// As codes of a display, after this exposure.
struct Display(f32);

impl Put<[u8; 4]> for Display {
    #[inline(always)]
    fn put(&self, light: [&[f32]; 3], out: &mut [[u8; 4]]) {
        let [r, g, b] = light.map(|l| &l[..out.len()]);
        for (i, p) in out.iter_mut().enumerate() {
            let [r, g, b] = [r[i], g[i], b[i]].map(|v| display_code(v * self.0));
            *p = (r | g << 8 | b << 16 | 255 << 24).to_le_bytes();
        }
    }
}

/// Texels that are decoded at a time where a picture is handed out by rows.
const ROWS_OF: usize = 1 << 19;

/// Rows of texels that one task lights: whole blocks.
const BAND: usize = 8;

impl<'a> Relighter<'a> {
    /// Decodes the textures and prepares the interpolation.
    ///
    /// # Errors
    /// [`Error::Parameter`] when textures and weights do not fit each other.
    pub fn new(field: &'a Field) -> Result<Self> {
        let mut relighter = Self::without_directions(field)?;
        if let Angular::Lights { lights, views, table, kernel, .. } = &field.angular {
            relighter.interpolation = Some(Interpolation::new(*kernel, &points(lights, views), table, field.domain));
        }
        Ok(relighter)
    }

    /// The same for mixes that are known: with many lights, most of the work is what is between them.
    pub(crate) fn without_directions(field: &'a Field) -> Result<Self> {
        let odd = !field.in_colour() && field.layers.iter().any(|l| l.codec.channels() != 3);
        match &field.angular {
            Angular::Lights { colour, lights, views, table, .. } => {
                let columns = if *colour { 3 + 3 * field.planes() } else { field.layers.len() };
                let seen = views.is_empty() || views.len() == lights.len();
                if odd || !seen || table.shape() != (lights.len(), columns) || lights.is_empty() {
                    return Err(Error::Parameter("the weights do not fit the layers".into()));
                }
            }
            Angular::Basis(basis) if odd || basis.terms() != field.layers.len() => {
                return Err(Error::Parameter(format!("{} layers for {basis:?}", field.layers.len())));
            }
            Angular::Basis(_) => (),
        }
        let store = match Lines::new(&field.layers, field.tiles.as_ref(), field.width, field.height) {
            Some(lines) => Store::Lines(lines),
            None if field.tiles.is_some() => {
                return Err(Error::Parameter("tiles of other codecs than BC1 and BC4, or of another size".into()));
            }
            None => {
                let planes: Result<Vec<_>> = field.layers.iter().map(|l| l.decode(field.width, field.height)).collect();
                Store::Planes(planes?.into_iter().flatten().collect())
            }
        };
        Ok(Self { field, store, interpolation: None })
    }

    /// Hands out the picture of one light from the top down, some rows at a time, with the number of the first: for large fields, of which a
    /// part at a time is decoded.
    pub(crate) fn by_rows(field: &Field, mix: &Mix, put: &mut dyn FnMut(usize, &[f32])) -> Result<()> {
        let rows = (ROWS_OF / field.width.max(1)).next_multiple_of(SIDE).max(SIDE);
        for start in (0..field.height).step_by(rows) {
            let part = field.rows(start..(start + rows).min(field.height));
            put(start, &Relighter::without_directions(&part)?.picture(mix));
        }
        Ok(())
    }

    /// The weights for a unit direction to the light, seen along the normal where the field has several views.
    pub fn mix(&self, direction: [f32; 3]) -> Mix {
        self.mix_seen(direction, [0.0, 0.0, 1.0])
    }

    /// The weights for unit directions to the light and to the camera. Only fields with several views look at the latter.
    pub fn mix_seen(&self, direction: [f32; 3], view: [f32; 3]) -> Mix {
        match (&self.interpolation, &self.field.angular) {
            (Some(interpolation), _) => self.field.mix(&interpolation.at(direction, view)),
            (None, Angular::Basis(basis)) => self.field.mix(&basis.at(direction)),
            // Not made by new().
            (None, Angular::Lights { .. }) => self.field.mix(&[]),
        }
    }

    /// The weights for the light and view of a picture.
    pub fn mix_of(&self, shot: &Shot) -> Mix {
        shot.view.map_or_else(|| self.mix(shot.light), |view| self.mix_seen(shot.light, view))
    }

    /// Linear light under one light: interleaved RGB in the stack's unit.
    pub fn picture(&self, mix: &Mix) -> Vec<f32> {
        let mut out = vec![0.0; 3 * self.field.width * self.field.height];
        self.add_picture(mix, [1.0; 3], &mut out);
        out
    }

    /// Adds the picture of one light, times `colour`, to `sum`.
    pub fn add_picture(&self, mix: &Mix, colour: [f32; 3], sum: &mut [f32]) {
        self.render(mix, sum.as_chunks_mut::<3>().0, &Add(colour.map(|c| c * self.field.white)));
    }

    /// The picture as a display shows it with white at `exposure` times the stack's, gamma 2.2: red, green, blue and 255, a
    /// texel each, as textures and screens take them.
    pub fn display(&self, mix: &Mix, exposure: f32, out: &mut [[u8; 4]]) {
        self.render(mix, out, &Display(exposure));
    }

    /// Lets `put` take light relative to white, by channel, of runs of texels to their places in `out`.
    fn render<T: Send>(&self, mix: &Mix, out: &mut [T], put: &impl Put<T>) {
        let width = self.field.width;
        match &self.store {
            Store::Lines(lines) => {
                let (constants, factors) = self.factors(mix);
                out.par_chunks_mut(width * BAND).enumerate().for_each(|(band, out)| {
                    for (y, out) in out.chunks_mut(4 * width).enumerate() {
                        self.row_of_blocks(lines, band * BAND / 4 + y, (&constants, &factors), out, put);
                    }
                });
            }
            Store::Planes(planes) => {
                let sums = self.prepare(mix);
                out.par_chunks_mut(TILE).enumerate().for_each(|(i, out)| {
                    let mut tile = sums.constant.map(|c| [c; TILE]);
                    self.add_planes(planes, &sums, i * TILE, out.len(), &mut tile);
                    tile.iter_mut().for_each(|t| self.field.domain.light(&mut t[..out.len()]));
                    put.put([0, 1, 2].map(|c| &tile[c][..out.len()]), out);
                });
            }
        }
    }

    /// [Menzel 2012, §4.4 sum]: what the codes of each layer count; and what is the same for all texels with no, one, two, … layers.
    fn factors(&self, mix: &Mix) -> (Vec<Rgb>, Vec<Factors>) {
        let (mut constant, colour) = (mix.constant, self.field.in_colour());
        let mut constants = vec![constant];
        let mut weights = mix.layers.iter();
        let mut factors = Vec::with_capacity(self.field.layers.len());
        for layer in &self.field.layers {
            let last = f32::from(last_code(layer.codec));
            let mut f = Factors { channels: layer.codec.channels(), start: [[0.0; 3]; 3], step: [[0.0; 3]; 3] };
            let whole = if colour { [0.0; 3] } else { weights.next().copied().unwrap_or_default() };
            for k in 0..layer.codec.channels() {
                let own = if colour { weights.next().copied().unwrap_or_default() } else { whole };
                for c in (0..3).filter(|c| colour || *c == k) {
                    constant[c] += own[c] * layer.low[k];
                    f.start[k][c] = own[c] * (layer.high[k] - layer.low[k]) / 255.0;
                    f.step[k][c] = f.start[k][c] / last;
                }
            }
            factors.push(f);
            constants.push(constant);
        }
        (constants, factors)
    }

    /// Four rows of texels, with the widest vectors that the processor has.
    fn row_of_blocks<T>(
        &self,
        lines: &Lines,
        y: usize,
        factors: (&[Rgb], &[Factors]),
        out: &mut [T],
        put: &impl Put<T>,
    ) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
            #[allow(unsafe_code, reason = "several times as quick: bench-field speed")]
            // SAFETY: the processor has AVX2 and FMA, which is all that the function asks for.
            unsafe {
                self.row_avx2(lines, y, factors, out, put);
            }
            return;
        }
        let (constants, factors) = factors;
        self.row(lines.across(), out, put, |x, steps, tile| lines.sums((x, y), constants, factors, steps, tile));
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn row_avx2<T>(&self, lines: &Lines, y: usize, factors: (&[Rgb], &[Factors]), out: &mut [T], put: &impl Put<T>) {
        let (constants, factors) = factors;
        self.row(lines.across(), out, put, |x, steps, tile| lines.sums_avx2((x, y), constants, factors, steps, tile));
    }

    /// Calls `sums` for each group, turns what it gives into light, and puts it where it belongs.
    #[inline(always)]
    fn row<T>(&self, across: usize, out: &mut [T], put: &impl Put<T>, sums: impl Fn(usize, &mut Steps, &mut Tile)) {
        let width = self.field.width;
        let mut steps = vec![[[0.0; GROUP]; 3]; self.field.layers.len()];
        let mut tile = [[0.0; TEXELS]; 3];
        for x in 0..across {
            sums(x, &mut steps, &mut tile);
            tile.iter_mut().for_each(|t| self.field.domain.light(t));
            let (from, n) = (4 * GROUP * x, (4 * GROUP).min(width - 4 * GROUP * x));
            for (row, out) in out.chunks_mut(width).enumerate() {
                put.put([0, 1, 2].map(|c| &tile[c][4 * GROUP * row..][..n]), &mut out[from..from + n]);
            }
        }
    }

    /// Adds the layers of texels `start … start + n`.
    fn add_planes(&self, planes: &[Vec<u16>], sums: &Sums, start: usize, n: usize, tile: &mut [[f32; TILE]; 3]) {
        for (j, w) in sums.weights.iter().enumerate() {
            for (c, tile) in tile.iter_mut().enumerate() {
                let plane = &planes[if self.field.in_colour() { j } else { 3 * j + c }][start..start + n];
                tile.iter_mut().zip(plane).for_each(|(s, code)| *s += w[c] * f32::from(*code));
            }
        }
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
}

/// Texels of a tile of decoded planes.
const TILE: usize = 1024;

/// Weights of codes.
struct Sums {
    constant: [f32; 3],
    weights: Vec<[f32; 3]>,
}

/// 255 v^(1/2.2), rounded, for v clipped to [0, 1], without branches: a polynomial in the fourth root of v (minimax with f(1) = 1
/// held), within a twentieth of a code.
#[inline(always)]
fn display_code(v: f32) -> u32 {
    let t = v.clamp(0.0, 1.0).sqrt().sqrt();
    let p = -0.188_256_94f32;
    let p = p * t + 0.585_565_96;
    let p = p * t - 0.771_806_84;
    let p = p * t + 1.351_131_27;
    let p = p * t + 0.023_366_55;
    // The bits of 1.5 · 2^23 round to the nearest.
    (255.0 * p * t + 12_582_912.0).to_bits() & 255
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::basis::Basis;
    use crate::sphere::Kernel;
    use crate::texture::Codec;
    use crate::{Domain, Model};
    use nalgebra::DMatrix;

    #[test]
    fn the_quick_gamma_gives_the_nearest_code_or_one_as_near() {
        for i in 0..=65536 {
            let v = (i as f32 / 65536.0).powi(2);
            let exact = 255.0 * v.powf(1.0 / 2.2);
            assert!((display_code(v) as f32 - exact).abs() < 0.56, "{v}: {} for {exact}", display_code(v));
        }
        assert_eq!([-3.0, 0.0, 1.0, 7.0, f32::INFINITY].map(display_code), [0, 0, 255, 255, 255]);
    }

    /// What is lit block by block is what decoded planes give, for any size and both kinds of weights.
    #[test]
    fn lines_and_planes_give_the_same_picture() {
        for (w, h) in [(33, 7), (64, 9), (5, 4), (130, 12)] {
            for (colour, codecs) in [(true, vec![Codec::Bc4, Codec::Bc1, Codec::Bc4]), (false, vec![Codec::Bc1; 3])] {
                let plane =
                    |j: usize| (0..w * h).map(move |i| ((i % w) as f32 * 0.3 + j as f32).sin() + (i / w) as f32 * 0.1);
                let mut planes = (0..9).map(|j| plane(j).collect::<Vec<f32>>());
                let layer = |codec: &Codec| {
                    let own: Vec<Vec<f32>> = planes.by_ref().take(codec.channels()).collect();
                    Texture::encode(*codec, &own.iter().map(|p| &p[..]).collect::<Vec<_>>(), w).unwrap()
                };
                let layers: Vec<Texture> = codecs.iter().map(layer).collect();
                let count: usize = codecs.iter().map(|c| c.channels()).sum();
                let columns = if colour { 3 + 3 * count } else { 3 };
                let angular = Angular::Lights {
                    colour,
                    lights: small().lights().to_vec(),
                    views: Vec::new(),
                    table: DMatrix::from_fn(3, columns, |i, j| ((3 * i + 5 * j) % 7) as f32 * 0.1 - 0.3),
                    kernel: Kernel::Gaussian { width: 0.3 },
                };
                let field = Field { width: w, height: h, layers, angular, domain: Domain::default(), ..small() };
                let mut relighter = Relighter::new(&field).unwrap();
                assert!(matches!(relighter.store, Store::Lines(_)));
                let mix = field.mix_of_light(1).unwrap();
                let quick = relighter.picture(&mix);
                let planes: Vec<_> = field.layers.iter().flat_map(|l| l.decode(w, h).unwrap()).collect();
                relighter.store = Store::Planes(planes);
                let slow = relighter.picture(&mix);
                // Without the vectors of this processor.
                let (constants, factors) = relighter.factors(&mix);
                let lines = Lines::new(&field.layers, None, w, h).unwrap();
                let mut plain = vec![[0.0; 3]; w * h];
                for (y, out) in plain.chunks_mut(4 * w).enumerate() {
                    let sums = |x, steps: &mut _, tile: &mut _| lines.sums((x, y), &constants, &factors, steps, tile);
                    relighter.row(lines.across(), out, &Add([field.white; 3]), sums);
                }
                assert!(plain.as_flattened().iter().zip(&quick).all(|(a, b)| (a - b).abs() < 1e-4 * (1.0 + b)));
                let most = quick.iter().zip(&slow).map(|(a, b)| (a - b).abs() / (0.1 + b)).fold(0.0, f32::max);
                assert!(most < 1e-3 && quick.iter().any(|v| *v > 0.1), "{w} × {h}, colour {colour}: {most}");
            }
        }
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
            tiles: None,
            angular: Angular::Lights {
                colour: true,
                lights: vec![[0.0, 0.0, 1.0], [b, 0.0, a], [0.0, -b, a]],
                views: Vec::new(),
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
        let mut codes = [[0; 4]; 2];
        relighter.display(&field.mix_of_light(0).unwrap(), 0.25, &mut codes);
        let light = relighter.picture(&field.mix_of_light(0).unwrap());
        let bytes: Vec<u8> = codes.iter().flat_map(|p| p[..3].to_vec()).collect();
        for (b, l) in bytes.iter().zip(&light) {
            assert!((f32::from(*b) - 255.0 * (l / 2.0 * 0.25).powf(1.0 / 2.2)).abs() < 0.6, "{bytes:?} {light:?}");
        }
        assert!(codes.iter().all(|p| p[3] == 255));
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
