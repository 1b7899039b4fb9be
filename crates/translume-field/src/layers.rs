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
use crate::planes::Planes;
use crate::texture::{Codec, Ends, Texture};
use crate::tiles::{self, Tiles};
use nalgebra::{Cholesky, DMatrix};
use rayon::prelude::*;
use std::ops::Range;

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
    exact: Planes,
    decoded: Planes,
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
        left: &Planes,
        size: (usize, usize),
        directions: &DMatrix<f64>,
        part: Option<(&Tiles, usize)>,
    ) -> Result<Self> {
        let (n, inputs) = (codec.channels(), left.count());
        let direction = |j: usize| directions.column(j).iter().map(|v| *v as f32).collect::<Vec<f32>>();
        let directions: Vec<Vec<f32>> = (0..n).map(direction).collect();
        let mut exact = left.empty_like(n)?;
        exact.grow(n)?;
        let mut buffer = Vec::new();
        for band in left.bands(CHUNK, inputs + n) {
            let values = left.read(0..inputs, band.clone(), &mut buffer)?;
            for (j, direction) in directions.iter().enumerate() {
                exact.write(j, band.clone(), &combine(values, band.len(), direction))?;
            }
        }
        let mut decoded = left.empty_like(n)?;
        decoded.grow(n)?;
        let keep = |x: usize, y: usize| part.is_none_or(|(tiles, number)| tiles.layers_at(x, y) > number);
        let texture = encode_planes(codec, (&exact, 0), size.0, &keep, &mut |band, mut values| {
            for plane in values.iter_mut().filter(|_| part.is_some()) {
                part.iter().for_each(|(tiles, number)| tiles.clear(*number, plane, size.0, band.start / size.0));
            }
            values.iter().enumerate().try_for_each(|(j, plane)| decoded.write(j, band.clone(), plane))
        })?;
        let (mut cross, mut products) = (DMatrix::zeros(n, inputs), DMatrix::zeros(n, n));
        let mut own = Vec::new();
        for band in left.bands(CHUNK, inputs + n) {
            let (from, to) =
                (left.read(0..inputs, band.clone(), &mut buffer)?, decoded.read(0..n, band.clone(), &mut own)?);
            add_dots(&mut cross, band.len(), to, from);
            add_dots(&mut products, band.len(), to, to);
        }
        let weights = least_squares(&products, &cross);
        let gain = weights.dot(&cross) / codec.bytes(4, 4) as f64;
        Ok(Self { texture, exact, decoded, cross, products, weights, gain })
    }
}

/// Stores the planes of a texture, the first of which is `from.1`, band by band; `decoded` gets what each band decodes to.
/// Of block codecs only the blocks (x, y) that are to be kept are stored: the others are 0.
pub(crate) fn encode_planes(
    codec: Codec,
    from: (&Planes, usize),
    width: usize,
    keep: &(dyn Fn(usize, usize) -> bool + Sync),
    decoded: &mut dyn FnMut(Range<usize>, Vec<Vec<f32>>) -> Result<()>,
) -> Result<Texture> {
    let (planes, n) = (from.0, codec.channels());
    let own = from.1..from.1 + n;
    let mut buffer = Vec::new();
    let mut ends = Ends::default();
    for band in planes.bands(1, n) {
        ends.see(&planes.read(own.clone(), band.clone(), &mut buffer)?.chunks(band.len()).collect::<Vec<_>>());
    }
    let (low, high) = ends.range(n);
    let mut texture = Texture { codec, data: Vec::new(), low, high };
    texture.data.reserve_exact(codec.bytes(width, planes.texels() / width));
    // Whole blocks and rows of tiles.
    for band in planes.bands(tiles::SIDE * width, 4 * n) {
        let values = planes.read(own.clone(), band.clone(), &mut buffer)?;
        let values: Vec<&[f32]> = values.chunks(band.len()).collect();
        let above = band.start / width / 4;
        let part = Texture::encode_in(codec, &values, width, (low, high), &|x, y| keep(x, y + above))?;
        decoded(band.clone(), part.values(width, band.len() / width)?)?;
        texture.data.extend(part.data);
    }
    Ok(texture)
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

/// Encodes `left` (several planes, which are used up) as `count` textures, each in that of `codecs` that takes off most. In an
/// open loop, for comparison, the next texture does not see what encoding lost. `observe` sees what is left before the first
/// texture and after each.
pub(crate) fn encode(
    mut left: Planes,
    size: (usize, usize),
    codecs: &[Codec],
    plan: &Plan,
    observe: &mut dyn FnMut(&Planes) -> Result<()>,
) -> Result<Layers> {
    let Plan { count, residual, closed_loop, tiles } = *plan;
    let (pixels, inputs) = (left.texels(), left.count());
    // Products of what is left: followed up, as summing them anew is most of the work.
    let Gram { mut products, sums } = Gram::of(&left)?;
    let energy = products.trace().max(f64::MIN_POSITIVE);
    let most = planes_of(codecs, count) + residual;
    let (mut textures, mut decoded) = (Vec::new(), left.empty_like(most)?);
    // What was taken off: planes and their weights. In a closed loop the planes are the decoded ones.
    let (mut taken, mut opened) = (Vec::<Vec<f64>>::new(), left.empty_like(if closed_loop { 0 } else { most })?);
    // Products with the planes as they were at first: with what is left, plus what was taken off.
    let mut cross: Vec<Vec<f64>> = vec![sums];
    observe(&left)?;
    for number in 0..count + residual {
        if let Some(tiles) = tiles {
            products -= leave_tiles(&mut left, size, tiles, number)?;
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
        let with_earlier = dots(&next.decoded, if closed_loop { &decoded } else { &opened })?;
        for j in 0..next.decoded.count() {
            let before = |i: usize| with_earlier.row(j).iter().zip(&taken).map(|(d, w)| d * w[i]).sum::<f64>();
            cross.push((0..inputs).map(|i| next.cross[(j, i)] + before(i)).collect());
        }
        let n = next.decoded.count();
        let weights: Vec<Vec<f64>> = match closed_loop {
            true => (0..n).map(|j| next.weights.row(j).iter().copied().collect()).collect(),
            false => (0..n).map(|j| directions.column(j).iter().copied().collect()).collect(),
        };
        subtract(&mut left, if closed_loop { &next.decoded } else { &next.exact }, &weights)?;
        taken.extend(weights);
        if closed_loop {
            // (X − D W)ᵀ (X − D W), with C = Dᵀ X.
            let cw = next.cross.transpose() * &next.weights;
            products += next.weights.transpose() * &next.products * &next.weights - &cw - cw.transpose();
        } else {
            products = Gram::of(&left)?.products;
            opened.append(&next.exact)?;
        }
        decoded.append(&next.decoded)?;
        textures.push(next.texture);
        observe(&left)?;
    }
    drop(left);
    let products = products_with_one(&decoded)?;
    let cross = DMatrix::from_fn(products.nrows(), inputs, |i, j| cross[i][j] / pixels as f64);
    Ok(Layers { textures, weights: least_squares(&products, &cross), products })
}

/// Most planes of so many textures.
pub(crate) fn planes_of(codecs: &[Codec], textures: usize) -> usize {
    textures * codecs.iter().map(|c| c.channels()).max().unwrap_or(1)
}

/// Mean products of the constant 1 and the planes.
fn products_with_one(planes: &Planes) -> Result<DMatrix<f64>> {
    let (n, texels) = (planes.count(), planes.texels());
    let mut upper = DMatrix::zeros(1 + n, 1 + n);
    let mut buffer = Vec::new();
    for band in planes.bands(CHUNK, n + 1) {
        let values = planes.read(0..n, band.clone(), &mut buffer)?;
        let ones = vec![1.0; band.len()];
        let all: Vec<&[f32]> = std::iter::once(&ones[..]).chain(values.chunks(band.len())).collect();
        for (i, j) in (0..=n).flat_map(|i| (i..=n).map(move |j| (i, j))) {
            add_dot(&mut upper[(i, j)], all[i], all[j]);
        }
    }
    Ok(DMatrix::from_fn(1 + n, 1 + n, |i, j| upper[(i.min(j), i.max(j))] / texels as f64))
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

/// Rows of blocks of several planes, as planes of a lower picture, of which `more` are to have room, and its height.
fn strips(planes: &Planes, (width, height): (usize, usize), rows: &[usize], more: usize) -> Result<(Planes, usize)> {
    let of_strip = |i: &usize| (4 * i + 4).min(height) - 4 * i;
    let low = rows.iter().map(of_strip).sum::<usize>();
    let expected = planes.count() + more + if planes.in_memory() { 0 } else { BESIDE };
    let mut part = planes.room().planes(width * low, expected)?;
    part.grow(planes.count())?;
    let mut strip = Vec::new();
    for plane in 0..planes.count() {
        let mut y = 0;
        for i in rows {
            strip.resize(of_strip(i) * width, 0.0);
            planes.read_run(plane, 4 * i * width, &mut strip)?;
            part.write_run(plane, y * width, &strip)?;
            y += of_strip(i);
        }
    }
    Ok((part, low))
}

/// Planes that are held for a while beside those that are encoded and decoded: of two candidates, before and after.
pub(crate) const BESIDE: usize = 16;

/// What `codecs` can be encoded with: each alone, or all of them, for each texture that which takes off more.
pub(crate) fn choices(codecs: &[Codec]) -> Vec<Vec<Codec>> {
    let all = (codecs.len() > 1).then(|| codecs.to_vec());
    codecs.iter().map(|c| vec![*c]).chain(all).collect()
}

/// Which of [`choices`] leaves least of an even choice of rows of blocks.
pub(crate) fn best_codecs(
    planes: &Planes,
    size: (usize, usize),
    codecs: &[Codec],
    count: usize,
    closed_loop: bool,
) -> Result<Vec<Codec>> {
    if codecs.len() < 2 {
        return Ok(codecs.to_vec());
    }
    let rows: Vec<usize> = (0..size.1.div_ceil(4)).step_by((size.0 * size.1).div_ceil(ENOUGH)).collect();
    let mut found = (f64::NEG_INFINITY, codecs.to_vec());
    for choice in choices(codecs) {
        let (part, height) = strips(planes, size, &rows, planes_of(&choice, count))?;
        let plan = Plan { count, residual: 0, closed_loop, tiles: None };
        let layers = encode(part, (size.0, height), &choice, &plan, &mut |_| Ok(()))?;
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
    planes: &Planes,
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
    let (part, height) = strips(planes, size, &rows, planes_of(codecs, count))?;
    // Rows of tiles are whole in each band, and as high but for the last.
    let of_tile = tile_row.iter().filter(|t| **t == 0).count();
    let mut left = Vec::new();
    let plan = Plan { count, residual: 0, closed_loop: true, tiles: None };
    encode(part, (size.0, height), codecs, &plan, &mut |planes| {
        let (mut sums, mut buffer) = (vec![0.0; grid.0 * grid.1], Vec::new());
        for band in planes.bands(of_tile * size.0, planes.count()) {
            let values = planes.read(0..planes.count(), band.clone(), &mut buffer)?;
            let (above, rows) = (band.start / size.0, band.len() / size.0);
            let part = tiles::energies(values, (size.0, rows), grid, &tile_row[above..above + rows]);
            sums.iter_mut().zip(part).for_each(|(s, p)| *s += p);
        }
        left.push(sums);
        Ok(())
    })?;
    Ok(left)
}

/// Products of planes with each other, and their sums.
struct Gram {
    products: DMatrix<f64>,
    sums: Vec<f64>,
}

impl Gram {
    fn of(planes: &Planes) -> Result<Self> {
        let n = planes.count();
        let (mut products, mut sums, mut buffer) = (DMatrix::zeros(n, n), vec![0.0; n], Vec::new());
        for band in planes.bands(CHUNK, n) {
            let (values, length) = (planes.read(0..n, band.clone(), &mut buffer)?, band.len());
            let starts: Vec<usize> = (0..length).step_by(CHUNK).collect();
            let product = |start: &usize| {
                let rows = CHUNK.min(length - start);
                let columns = view(&values[*start..], rows, n, length);
                let mut out = DMatrix::<f32>::zeros(n, n);
                add_product(&mut out, &transposed(&values[*start..], rows, n, length), &columns);
                out.map(f64::from)
            };
            // Rounds bound the memory of partial products.
            for round in starts.chunks(256) {
                round.par_iter().map(product).collect::<Vec<_>>().iter().for_each(|p| products += p);
            }
            for (total, plane) in sums.iter_mut().zip(values.chunks(length)) {
                plane.par_chunks(CHUNK).map(sum).collect::<Vec<_>>().iter().for_each(|s| *total += s);
            }
        }
        Ok(Self { products, sums })
    }
}

/// Sets the planes to 0 in the tiles that have `number` layers and no more; their products with each other there.
fn leave_tiles(left: &mut Planes, size: (usize, usize), tiles: &Tiles, number: usize) -> Result<DMatrix<f64>> {
    let n = left.count();
    let (mut sum, mut buffer) = (DMatrix::zeros(n, n), Vec::new());
    if !tiles.counts.iter().any(|c| usize::from(*c) == number) {
        return Ok(sum);
    }
    for band in left.bands(tiles::SIDE * size.0, n) {
        let (above, rows) = (band.start / size.0, band.len() / size.0);
        left.edit(band, &mut buffer, |values| {
            add_products_in_tiles(&mut sum, values, (size.0, rows), (tiles, above / tiles::SIDE), number);
            values.par_chunks_mut(rows * size.0).for_each(|plane| tiles.clear(number, plane, size.0, above));
            Ok(())
        })?;
    }
    Ok(sum)
}

/// Products of planes with each other in the tiles, from a row of them on, that have `number` layers and no more.
fn add_products_in_tiles(
    sum: &mut DMatrix<f64>,
    planes: &[f32],
    (width, height): (usize, usize),
    (tiles, above): (&Tiles, usize),
    number: usize,
) {
    let (pixels, n) = (width * height, planes.len() / (width * height));
    let here = 0..height.div_ceil(tiles::SIDE) * tiles.across;
    let count = |t: usize| usize::from(tiles.counts[above * tiles.across + t]);
    let own: Vec<usize> = here.filter(|t| count(*t) == number).collect();
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
    // Rounds bound the memory of partial sums.
    for round in own.chunks(64) {
        round.par_iter().map(of_tile).collect::<Vec<_>>().iter().for_each(|p| *sum += p);
    }
}

fn sum(values: &[f32]) -> f64 {
    values.iter().map(|v| f64::from(*v)).sum()
}

/// Adds the products of planes `a` with planes `b`, of `n` texels each.
fn add_dots(sums: &mut DMatrix<f64>, n: usize, a: &[f32], b: &[f32]) {
    for (i, a) in a.chunks(n).enumerate() {
        b.chunks(n).enumerate().for_each(|(j, b)| add_dot(&mut sums[(i, j)], a, b));
    }
}

/// Products of planes with planes.
fn dots(a: &Planes, b: &Planes) -> Result<DMatrix<f64>> {
    let mut sums = DMatrix::zeros(a.count(), b.count());
    let (mut of_a, mut of_b) = (Vec::new(), Vec::new());
    for band in a.bands(CHUNK, a.count() + b.count()).into_iter().filter(|_| b.count() > 0) {
        let a = a.read(0..a.count(), band.clone(), &mut of_a)?;
        add_dots(&mut sums, band.len(), a, b.read(0..b.count(), band, &mut of_b)?);
    }
    Ok(sums)
}

/// Adds the product of two planes: in eight lanes of f32 over 256 values, in f64 over those and over chunks in order.
fn add_dot(sum: &mut f64, a: &[f32], b: &[f32]) {
    let short = |a: &[f32], b: &[f32]| {
        let mut lanes = [0.0f32; 8];
        let (a8, b8) = (a.as_chunks::<8>(), b.as_chunks::<8>());
        a8.0.iter().zip(b8.0).for_each(|(a, b)| (0..8).for_each(|i| lanes[i] += a[i] * b[i]));
        f64::from(lanes.iter().sum::<f32>() + a8.1.iter().zip(b8.1).map(|(a, b)| a * b).sum::<f32>())
    };
    let part = |(a, b): (&[f32], &[f32])| -> f64 { a.chunks(256).zip(b.chunks(256)).map(|(a, b)| short(a, b)).sum() };
    let parts: Vec<f64> = a.par_chunks(CHUNK).zip(b.par_chunks(CHUNK)).map(part).collect();
    parts.iter().for_each(|p| *sum += p);
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

/// Takes `layers`, times their weights by plane, off the planes.
fn subtract(left: &mut Planes, layers: &Planes, weights: &[Vec<f64>]) -> Result<()> {
    let n = layers.count();
    let (mut buffer, mut own) = (Vec::new(), Vec::new());
    for band in left.bands(CHUNK, left.count() + n) {
        let layers = layers.read(0..n, band.clone(), &mut own)?;
        let length = band.len();
        left.edit(band, &mut buffer, |values| {
            for (layer, weights) in layers.chunks(length).zip(weights) {
                values.par_chunks_mut(length).zip(weights).for_each(|(plane, w)| {
                    let w = *w as f32;
                    plane.iter_mut().zip(layer).for_each(|(p, l)| *p -= w * l);
                });
            }
            Ok(())
        })?;
    }
    Ok(())
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
        let left =
            left_in_tiles(&Planes::of(size.0 * size.1, planes.clone()), size, &[Codec::Bc1], 8, ENOUGH_FOR_TILES)
                .unwrap();
        assert!(left[0][2] == 0.0 && left[0][1] > left[4][1] && left[4][1] > left[8][1]);
        let error = |tiles: Option<&Tiles>, count: usize| {
            let plan = Plan { count, residual: 0, closed_loop: true, tiles };
            let layers =
                encode(Planes::of(size.0 * size.1, planes.clone()), size, &[Codec::Bc1], &plan, &mut |_| Ok(()))
                    .unwrap();
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
            let layers = encode(
                Planes::of(size.0 * size.1, planes.clone()),
                size,
                &[Codec::Bc4],
                &whole(count),
                &mut |_| Ok(()),
            )
            .unwrap();
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
            let layers =
                encode(Planes::of(size.0 * size.1, texels.clone()), size, codecs, &whole(4), &mut |_| Ok(())).unwrap();
            let n = layers.products.nrows();
            let total: f64 = texels.iter().map(|v| f64::from(v * v)).sum::<f64>() / pixels as f64;
            let kept = (layers.weights.transpose() * &layers.products * &layers.weights).trace();
            (total - kept, n - 1, layers.textures.iter().map(|t| t.codec).collect::<Vec<_>>())
        };
        let (single, singles, _) = left(&[Codec::Bc4]);
        let (mixed, planes, codecs) = left(&[Codec::Bc4, Codec::Bc1]);
        assert_eq!(singles, 4);
        assert_eq!(
            best_codecs(&Planes::of(pixels, texels.clone()), size, &[Codec::Bc4, Codec::Bc1], 4, true).unwrap().last(),
            Some(&Codec::Bc1)
        );
        assert!(planes > 4 && mixed < 0.8 * single, "{mixed} against {single}: {codecs:?}");
    }

    #[test]
    fn few_strong_planes_are_stored_finely() {
        let size = (64, 64);
        let wave = |k: usize, i: usize| (0.05 * ((k + 2) * (i % 64) + (3 * k + 1) * (i / 64)) as f32 + k as f32).sin();
        let planes: Vec<f32> = (0..3).flat_map(|k| (0..64 * 64).map(move |i| wave(k, i))).collect();
        let codecs = best_codecs(&Planes::of(64 * 64, planes), size, &[Codec::Bc4, Codec::Bc1], 8, true).unwrap();
        assert!(codecs.contains(&Codec::Bc4), "{codecs:?}");
    }

    /// Where planes are kept does not change a bit of what becomes of them.
    #[test]
    fn planes_in_files_are_encoded_as_those_in_memory() {
        // Bands of 8192 texels and of 32 rows end at different places; the last are short.
        let size = (212, 171);
        let pixels = size.0 * size.1;
        let wave = |k: usize, i: usize| {
            let (x, y) = (i % size.0, i / size.0);
            // A quarter is black.
            let lit = if x < 64 && y < 96 { 0.0 } else { 1.0 };
            lit * (0.04 * ((k + 2) * x + (3 * k + 1) * y) as f32 + k as f32).sin() * 3.0 / (k + 1) as f32
        };
        let values: Vec<f32> = (0..7).flat_map(|k| (0..pixels).map(move |i| wave(k, i))).collect();
        let dir = tempfile::tempdir().unwrap();
        let planes = |bytes: usize| {
            let room = crate::planes::Room::new(bytes, dir.path().to_owned());
            let mut planes = room.planes(pixels, 1).unwrap();
            planes.grow(7).unwrap();
            values.chunks(pixels).enumerate().for_each(|(k, v)| planes.write_run(k, 0, v).unwrap());
            planes
        };
        let (memory, file) = (|| planes(usize::MAX), || planes(1 << 17));
        assert!(memory().in_memory() && !file().in_memory() && file().bands(CHUNK, 1).len() > 1);
        let codecs = [Codec::Bc4, Codec::Bc1];
        let left = |p: &Planes| left_in_tiles(p, size, &codecs, 5, 1 << 12).unwrap();
        let left = (left(&memory()), left(&file()));
        assert_eq!(left.0, left.1);
        let best = |p: &Planes| best_codecs(p, size, &codecs, 3, true).unwrap();
        assert_eq!(best(&memory()), best(&file()));
        let tiles = Tiles { across: 7, counts: tiles::choose(&left.0, 100) };
        assert!(tiles.counts.contains(&0) && tiles.most() > 2);
        for (count, residual, closed_loop, tiles) in
            [(3, 1, true, None), (2, 0, false, None), (tiles.most(), 0, true, Some(&tiles))]
        {
            let plan = Plan { count, residual, closed_loop, tiles };
            let made = |planes: Planes| encode(planes, size, &codecs, &plan, &mut |_| Ok(())).unwrap();
            let (a, b) = (made(memory()), made(file()));
            assert_eq!(a.textures, b.textures);
            assert!(a.textures.len() > 1 && a.weights == b.weights && a.products == b.products);
        }
    }
}
