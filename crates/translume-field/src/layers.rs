//! Layers: planes with a weight by light and channel, stored one or three to a texture, found one after the other.
//!
//! The rows that are taken apart are texels, the columns lights × channels: colour is in the weights, so that a plane is
//! one number a texel where the thesis' eigenimages are three. Four bits a texel hold one plane in BC4 (two ends of 8 bits,
//! eight steps a block) or three in BC1 (four steps on one line). [`best_codecs`] finds out on a part of the picture whether
//! the one, the other, or for each texture that which takes off more leaves least in the end.
//!
//! The loop is closed: a texture is encoded, decoded, and what it does not give is left for the next, whose directions are
//! the principal ones of what is left: planes whose errors weigh are stored a second time for finer steps. At the end all
//! weights are fitted to what the textures decode to.

use crate::Result;
use crate::matrix::{add_product, transposed, view};
use crate::pca::eigen;
use crate::texture::{Codec, Texture};
use crate::tiles::{self, Tiles};
use nalgebra::{Cholesky, DMatrix};
use rayon::prelude::*;

/// Texels that one task takes.
const CHUNK: usize = 1 << 13;

/// Encoded planes and their weights.
pub(crate) struct Layers {
    /// Textures.
    pub(crate) textures: Vec<Texture>,
    /// (1 + planes) × inputs: weights of the constant 1, then of each plane.
    pub(crate) weights: DMatrix<f64>,
    /// Mean products of the constant and the planes over all pixels.
    pub(crate) products: DMatrix<f64>,
}

/// A texture that could come next.
struct Candidate {
    texture: Texture,
    /// Its planes before encoding and after decoding.
    exact: Vec<Vec<f32>>,
    decoded: Vec<Vec<f32>>,
    /// Products of the decoded planes with what is left: planes × inputs.
    cross: DMatrix<f64>,
    /// Products of the decoded planes with each other.
    products: DMatrix<f64>,
    /// Least-squares weights of the decoded planes: planes × inputs.
    weights: DMatrix<f64>,
    /// Energy it takes off what is left, a byte.
    gain: f64,
}

impl Candidate {
    fn new(
        codec: Codec,
        left: &[f32],
        size: (usize, usize),
        directions: &DMatrix<f64>,
        part: Option<(&Tiles, usize)>,
    ) -> Result<Self> {
        let pixels = size.0 * size.1;
        let direction = |j: usize| directions.column(j).iter().map(|v| *v as f32).collect::<Vec<f32>>();
        let exact: Vec<Vec<f32>> = (0..codec.channels()).map(|j| combine(left, pixels, &direction(j))).collect();
        let planes: Vec<&[f32]> = exact.iter().map(|p| &p[..]).collect();
        let keep = |x: usize, y: usize| part.is_none_or(|(tiles, number)| tiles.layers_at(x, y) > number);
        let texture = Texture::encode_where(codec, &planes, size.0, &keep)?;
        let mut decoded = texture.values(size.0, size.1)?;
        if let Some((tiles, number)) = part {
            decoded.iter_mut().for_each(|plane| tiles.clear(number, plane, size.0));
        }
        let n = decoded.len();
        let inputs = left.len() / pixels;
        let cross = DMatrix::from_fn(n, inputs, |j, i| dot(&left[i * pixels..(i + 1) * pixels], &decoded[j]));
        let products = DMatrix::from_fn(n, n, |i, j| dot(&decoded[i], &decoded[j]));
        let weights = least_squares(&products, &cross);
        let gain = weights.dot(&cross) / codec.bytes(4, 4) as f64;
        Ok(Self { texture, exact, decoded, cross, products, weights, gain })
    }
}

/// How many textures, and where.
#[derive(Clone, Copy)]
pub(crate) struct Plan<'a> {
    /// Most textures.
    pub(crate) count: usize,
    /// How many more, of 16 bits, follow for what they leave.
    pub(crate) residual: usize,
    /// Whether a texture sees what encoding the earlier ones lost.
    pub(crate) closed_loop: bool,
    /// Which parts of the picture have how many of them; `None`: all have all.
    pub(crate) tiles: Option<&'a Tiles>,
}

/// Encodes `planes` (several, each of as many values as the picture has pixels; they are used up) as `count` textures, each
/// in that of `codecs` that takes off most. In an open loop, for comparison, the next texture does not see what encoding
/// lost. `observe` sees what is left before the first texture and after each.
pub(crate) fn encode(
    mut left: Vec<f32>,
    size: (usize, usize),
    codecs: &[Codec],
    plan: &Plan,
    observe: &mut dyn FnMut(&[f32]),
) -> Result<Layers> {
    let Plan { count, residual, closed_loop, tiles } = *plan;
    let pixels = size.0 * size.1;
    let inputs = left.len() / pixels;
    // Products of what is left: followed up, as summing them anew is most of the work.
    let Gram { mut products, sums } = Gram::of(&left, pixels);
    let energy = products.trace().max(f64::MIN_POSITIVE);
    let (mut textures, mut decoded) = (Vec::new(), Vec::<Vec<f32>>::new());
    // What was taken off: planes and their weights. In a closed loop the planes are the decoded ones.
    let (mut taken, mut opened) = (Vec::<Vec<f64>>::new(), Vec::<Vec<f32>>::new());
    // Products with the planes as they were at first: with what is left, plus what was taken off.
    let mut cross: Vec<Vec<f64>> = vec![sums];
    observe(&left);
    for number in 0..count + residual {
        if let Some(tiles) = tiles {
            products -= products_in_tiles(&left, size, tiles, number);
            left.par_chunks_mut(pixels).for_each(|plane| tiles.clear(number, plane, size.0));
        }
        let (directions, energies) = eigen(&products);
        if energies[0] <= 1e-12 * energy {
            break;
        }
        let mut best: Option<Candidate> = None;
        let codecs = if number < count { codecs } else { &[Codec::R16] };
        for codec in codecs.iter().filter(|c| c.channels() <= inputs) {
            let candidate = Candidate::new(*codec, &left, size, &directions, tiles.map(|t| (t, number)))?;
            best = best.filter(|b| b.gain >= candidate.gain).or(Some(candidate));
        }
        let Some(next) = best else { break };
        let earlier = if closed_loop { &decoded } else { &opened };
        for (j, plane) in next.decoded.iter().enumerate() {
            let with_earlier: Vec<f64> = earlier.iter().map(|e| dot(e, plane)).collect();
            let before = |i: usize| with_earlier.iter().zip(&taken).map(|(d, w)| d * w[i]).sum::<f64>();
            cross.push((0..inputs).map(|i| next.cross[(j, i)] + before(i)).collect());
        }
        for j in 0..next.decoded.len() {
            let (plane, weights) = if closed_loop {
                (&next.decoded[j], next.weights.row(j).iter().copied().collect::<Vec<f64>>())
            } else {
                (&next.exact[j], directions.column(j).iter().copied().collect())
            };
            subtract(&mut left, pixels, plane, &weights);
            taken.push(weights);
        }
        if closed_loop {
            // (X − D W)ᵀ (X − D W), with C = Dᵀ X.
            let cw = next.cross.transpose() * &next.weights;
            products += next.weights.transpose() * &next.products * &next.weights - &cw - cw.transpose();
        } else {
            products = Gram::of(&left, pixels).products;
            opened.extend(next.exact);
        }
        decoded.extend(next.decoded);
        textures.push(next.texture);
        observe(&left);
    }
    let n = 1 + decoded.len();
    let ones = vec![1.0; pixels];
    let all: Vec<&[f32]> = std::iter::once(&ones[..]).chain(decoded.iter().map(|d| &d[..])).collect();
    let upper = DMatrix::from_fn(n, n, |i, j| if i <= j { dot(all[i], all[j]) / pixels as f64 } else { 0.0 });
    let products = DMatrix::from_fn(n, n, |i, j| upper[(i.min(j), i.max(j))]);
    let cross = DMatrix::from_fn(n, inputs, |i, j| cross[i][j] / pixels as f64);
    Ok(Layers { textures, weights: least_squares(&products, &cross), products })
}

/// The weights `w` that make `products · w = cross`, a little damped so that layers that repeat each other do no harm.
fn least_squares(products: &DMatrix<f64>, cross: &DMatrix<f64>) -> DMatrix<f64> {
    let mut damped = products.clone();
    (0..damped.nrows()).for_each(|i| damped[(i, i)] *= 1.0 + 1e-9);
    match Cholesky::new(damped) {
        Some(factored) => factored.solve(cross),
        None => products
            .clone()
            .svd(true, true)
            .solve(cross, 1e-12)
            .unwrap_or_else(|_| DMatrix::zeros(cross.nrows(), cross.ncols())),
    }
}

/// Texels that are enough to choose a codec on.
pub(crate) const ENOUGH: usize = 1 << 15;
/// Texels that are enough to find out how many layers each tile needs.
pub(crate) const ENOUGH_FOR_TILES: usize = 1 << 17;

/// Rows of blocks of several planes, as planes of a lower picture, and its height.
fn strips(planes: &[f32], (width, height): (usize, usize), rows: &[usize]) -> (Vec<f32>, usize) {
    let strip = |p: &[f32], i: usize| p[4 * i * width..(4 * i + 4).min(height) * width].to_vec();
    let part = planes.chunks(width * height).flat_map(|p| rows.iter().flat_map(move |i| strip(p, *i))).collect();
    (part, rows.iter().map(|i| (4 * i + 4).min(height) - 4 * i).sum())
}

/// What `codecs` can be encoded with: each alone, or all of them, for each texture that which takes off more.
pub(crate) fn choices(codecs: &[Codec]) -> Vec<Vec<Codec>> {
    let all = (codecs.len() > 1).then(|| codecs.to_vec());
    codecs.iter().map(|c| vec![*c]).chain(all).collect()
}

/// Which of [`choices`] leaves least of an even choice of rows of blocks.
pub(crate) fn best_codecs(
    planes: &[f32],
    size: (usize, usize),
    codecs: &[Codec],
    count: usize,
    closed_loop: bool,
) -> Result<Vec<Codec>> {
    if codecs.len() < 2 {
        return Ok(codecs.to_vec());
    }
    let rows: Vec<usize> = (0..size.1.div_ceil(4)).step_by((size.0 * size.1).div_ceil(ENOUGH)).collect();
    let (part, height) = strips(planes, size, &rows);
    let mut found = (f64::NEG_INFINITY, codecs.to_vec());
    for choice in choices(codecs) {
        let plan = Plan { count, residual: 0, closed_loop, tiles: None };
        let layers = encode(part.clone(), (size.0, height), &choice, &plan, &mut |_| ())?;
        let kept = (layers.weights.transpose() * &layers.products * &layers.weights).trace();
        if kept > found.0 {
            found = (kept, choice);
        }
    }
    Ok(found.1)
}

/// What each tile would leave after 0, 1, … `count` layers, from a part of its rows of blocks with some `enough` texels: by
/// layers, then tile.
pub(crate) fn left_in_tiles(
    planes: &[f32],
    size: (usize, usize),
    codecs: &[Codec],
    count: usize,
    enough: usize,
) -> Result<Vec<Vec<f64>>> {
    let grid = Tiles::grid(size.0, size.1);
    let per_tile = tiles::SIDE / 4;
    let every = (size.0 * size.1).div_ceil(enough).clamp(1, per_tile);
    // The last tiles may be low: each begins with a row that counts.
    let rows: Vec<usize> = (0..size.1.div_ceil(4)).filter(|i| (i % per_tile).is_multiple_of(every)).collect();
    let tile_row: Vec<usize> = rows.iter().flat_map(|i| vec![i / per_tile; (4 * i + 4).min(size.1) - 4 * i]).collect();
    let (part, height) = strips(planes, size, &rows);
    let mut left = Vec::new();
    let plan = Plan { count, residual: 0, closed_loop: true, tiles: None };
    encode(part, (size.0, height), codecs, &plan, &mut |planes| {
        left.push(tiles::energies(planes, (size.0, height), grid, &tile_row));
    })?;
    Ok(left)
}

/// Products of planes with each other, and their sums.
struct Gram {
    products: DMatrix<f64>,
    sums: Vec<f64>,
}

impl Gram {
    fn of(planes: &[f32], pixels: usize) -> Self {
        let n = planes.len() / pixels;
        let starts: Vec<usize> = (0..pixels).step_by(CHUNK).collect();
        let parts: Vec<DMatrix<f64>> = starts
            .par_iter()
            .map(|&start| {
                let rows = CHUNK.min(pixels - start);
                let columns = view(&planes[start..], rows, n, pixels);
                let mut out = DMatrix::<f32>::zeros(n, n);
                add_product(&mut out, &transposed(&planes[start..], rows, n, pixels), &columns);
                out.map(f64::from)
            })
            .collect();
        let products = parts.iter().fold(DMatrix::zeros(n, n), |sum, p| sum + p);
        let sums =
            planes.chunks(pixels).map(|p| p.par_chunks(CHUNK).map(sum).collect::<Vec<_>>().iter().sum()).collect();
        Self { products, sums }
    }
}

/// Products of planes with each other in the tiles that have `number` layers and no more.
fn products_in_tiles(planes: &[f32], (width, height): (usize, usize), tiles: &Tiles, number: usize) -> DMatrix<f64> {
    let (pixels, n) = (width * height, planes.len() / (width * height));
    let own: Vec<usize> = (0..tiles.counts.len()).filter(|t| usize::from(tiles.counts[*t]) == number).collect();
    let of_tile = |t: &usize| {
        let (x, y) = (t % tiles.across * tiles::SIDE, t / tiles.across * tiles::SIDE);
        let columns = tiles::SIDE.min(width - x);
        let mut out = DMatrix::<f32>::zeros(n, n);
        for row in y..(y + tiles::SIDE).min(height) {
            let start = &planes[row * width + x..];
            add_product(&mut out, &transposed(start, columns, n, pixels), &view(start, columns, n, pixels));
        }
        out.map(f64::from)
    };
    let mut sum = DMatrix::zeros(n, n);
    // Rounds bound the memory of partial sums.
    for round in own.chunks(64) {
        round.par_iter().map(of_tile).collect::<Vec<_>>().iter().for_each(|p| sum += p);
    }
    sum
}

fn sum(values: &[f32]) -> f64 {
    values.iter().map(|v| f64::from(*v)).sum()
}

/// Product of two planes: in eight lanes of f32 over 256 values, in f64 over those and over chunks in order.
fn dot(a: &[f32], b: &[f32]) -> f64 {
    let short = |a: &[f32], b: &[f32]| {
        let mut lanes = [0.0f32; 8];
        let (a8, b8) = (a.as_chunks::<8>(), b.as_chunks::<8>());
        a8.0.iter().zip(b8.0).for_each(|(a, b)| (0..8).for_each(|i| lanes[i] += a[i] * b[i]));
        f64::from(lanes.iter().sum::<f32>() + a8.1.iter().zip(b8.1).map(|(a, b)| a * b).sum::<f32>())
    };
    let part = |(a, b): (&[f32], &[f32])| -> f64 { a.chunks(256).zip(b.chunks(256)).map(|(a, b)| short(a, b)).sum() };
    let parts: Vec<f64> = a.par_chunks(CHUNK).zip(b.par_chunks(CHUNK)).map(part).collect();
    parts.iter().sum()
}

/// The planes' sum with weights.
fn combine(planes: &[f32], pixels: usize, weights: &[f32]) -> Vec<f32> {
    let mut out = vec![0.0f32; pixels];
    out.par_chunks_mut(CHUNK).enumerate().for_each(|(i, out)| {
        for (plane, w) in planes.chunks(pixels).zip(weights) {
            out.iter_mut().zip(&plane[i * CHUNK..]).for_each(|(o, p)| *o += w * p);
        }
    });
    out
}

fn subtract(planes: &mut [f32], pixels: usize, layer: &[f32], weights: &[f64]) {
    planes.par_chunks_mut(pixels).zip(weights).for_each(|(plane, w)| {
        let w = *w as f32;
        plane.iter_mut().zip(layer).for_each(|(p, l)| *p -= w * l);
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn whole(count: usize) -> Plan<'static> {
        Plan { count, residual: 0, closed_loop: true, tiles: None }
    }

    #[test]
    fn layers_of_tiles_leave_less_than_layers_everywhere() {
        // One tile of eight has all the detail; half of them are black.
        let size = (128, 64);
        let wave = |k: usize, x: usize, y: usize| {
            ((0.11 * (k + 1) as f32) * x as f32 + 0.07 * (k * k) as f32 * y as f32).sin()
        };
        let planes: Vec<f32> = (0..12)
            .flat_map(|k| {
                (0..size.0 * size.1).map(move |i| {
                    let (x, y) = (i % size.0, i / size.0);
                    match (x / 32, y / 32) {
                        (1, 0) => wave(k, x, y),
                        (0, _) | (1, 1) if k == 0 => 1.0 + 0.01 * x as f32,
                        _ => 0.0,
                    }
                })
            })
            .collect();
        let left = left_in_tiles(&planes, size, &[Codec::Bc1], 8, ENOUGH_FOR_TILES).unwrap();
        assert!(left[0][2] == 0.0 && left[0][1] > left[4][1] && left[4][1] > left[8][1]);
        let error = |tiles: Option<&Tiles>, count: usize| {
            let plan = Plan { count, residual: 0, closed_loop: true, tiles };
            let layers = encode(planes.clone(), size, &[Codec::Bc1], &plan, &mut |_| ()).unwrap();
            let total: f64 = planes.iter().map(|v| f64::from(v * v)).sum::<f64>() / (size.0 * size.1) as f64;
            total - (layers.weights.transpose() * &layers.products * &layers.weights).trace()
        };
        let tiles = Tiles { across: 4, counts: tiles::choose(&left, 2 * 8) };
        assert!(tiles.slots() <= 16 && tiles.layers_at(8, 0) == 8 && tiles.layers_at(16, 0) == 0, "{tiles:?}");
        let (adaptive, everywhere) = (error(Some(&tiles), tiles.most()), error(None, 2));
        assert!(adaptive < 0.3 * everywhere, "{adaptive} against {everywhere}");
    }

    #[test]
    fn more_layers_than_directions_make_the_steps_finer() {
        let size = (32, 24);
        let pixels = size.0 * size.1;
        let plane = |f: fn(f32, f32) -> f32| (0..pixels).map(move |i| f((i % 32) as f32, (i / 32) as f32));
        let a: Vec<f32> = plane(|x, y| (0.3 * x).sin() + 0.5 * (0.9 * y + 0.2 * x).cos()).collect();
        let b: Vec<f32> = plane(|x, y| 0.2 * (0.5 * x * y).cos()).collect();
        // Three planes of two directions and a constant.
        let planes: Vec<f32> = [0.5, 1.0, -1.0]
            .iter()
            .flat_map(|w| a.iter().zip(&b).map(move |(a, b)| 3.0 + w * a + (1.0 - w) * b))
            .collect();
        let left = |count: usize| {
            let layers = encode(planes.clone(), size, &[Codec::Bc4], &whole(count), &mut |_| ()).unwrap();
            let values: Vec<Vec<f32>> =
                layers.textures.iter().map(|t| t.values(size.0, size.1).unwrap().swap_remove(0)).collect();
            let mut sum = 0.0;
            for i in 0..3 {
                for t in 0..pixels {
                    let mut v = layers.weights[(0, i)];
                    values.iter().enumerate().for_each(|(j, l)| v += layers.weights[(1 + j, i)] * f64::from(l[t]));
                    sum += (v - f64::from(planes[i * pixels + t])).powi(2);
                }
            }
            (sum / (3 * pixels) as f64).sqrt()
        };
        let errors = [1, 2, 3, 4, 6].map(left);
        // Two layers leave the steps of BC4 (an RMS of some 1 % of the range); further ones go below.
        assert!(errors[1] < 0.3 * errors[0] && errors[4] < 0.2 * errors[1], "{errors:?}");
        assert!(errors.windows(2).all(|e| e[1] < 1.02 * e[0]), "{errors:?}");
    }

    #[test]
    fn weak_planes_share_a_texture() {
        let size = (64, 64);
        let pixels = size.0 * size.1;
        // A strong plane and eight weak ones, all different.
        let wave = |k: usize, i: usize| (0.05 * ((k + 2) * (i % 64) + (3 * k + 1) * (i / 64)) as f32 + k as f32).sin();
        let texels: Vec<f32> =
            (0..9).flat_map(|k| (0..pixels).map(move |i| if k == 0 { 10.0 } else { 1.0 } * wave(k, i))).collect();
        let left = |codecs: &[Codec]| {
            let layers = encode(texels.clone(), size, codecs, &whole(4), &mut |_| ()).unwrap();
            let n = layers.products.nrows();
            let total: f64 = texels.iter().map(|v| f64::from(v * v)).sum::<f64>() / pixels as f64;
            let kept = (layers.weights.transpose() * &layers.products * &layers.weights).trace();
            (total - kept, n - 1, layers.textures.iter().map(|t| t.codec).collect::<Vec<_>>())
        };
        let (single, singles, _) = left(&[Codec::Bc4]);
        let (mixed, planes, codecs) = left(&[Codec::Bc4, Codec::Bc1]);
        assert_eq!(singles, 4);
        assert_eq!(best_codecs(&texels, size, &[Codec::Bc4, Codec::Bc1], 4, true).unwrap().last(), Some(&Codec::Bc1));
        assert!(planes > 4 && mixed < 0.8 * single, "{mixed} against {single}: {codecs:?}");
    }

    #[test]
    fn few_strong_planes_are_stored_finely() {
        let size = (64, 64);
        let wave = |k: usize, i: usize| (0.05 * ((k + 2) * (i % 64) + (3 * k + 1) * (i / 64)) as f32 + k as f32).sin();
        let planes: Vec<f32> = (0..3).flat_map(|k| (0..64 * 64).map(move |i| wave(k, i))).collect();
        let codecs = best_codecs(&planes, size, &[Codec::Bc4, Codec::Bc1], 8, true).unwrap();
        assert!(codecs.contains(&Codec::Bc4), "{codecs:?}");
    }
}
