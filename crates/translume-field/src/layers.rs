//! Layers: textures of one channel, each with a weight by light and channel, found one after the other.
//!
//! The rows that are taken apart are texels, the columns lights × channels: colour is in the weights, so that a layer
//! needs one channel (BC4: two ends of 8 bits and eight steps) where the thesis' eigenimages need three (BC1: ends of 5
//! and 6 bits, four steps, one line through colour space). The loop is closed: a layer is encoded, decoded, and what it
//! does not give is left for the next, whose direction is the principal one of what is left. So the first layers, whose
//! errors weigh most, get a second layer of finer steps where that pays more than a new direction. At the end all
//! weights are fitted to what the textures decode to.

use crate::Result;
use crate::matrix::{add_product, transposed, view};
use crate::pca::eigen;
use crate::texture::{Codec, Texture};
use nalgebra::{Cholesky, DMatrix};
use rayon::prelude::*;

/// Texels that one task takes.
const CHUNK: usize = 1 << 13;

/// Encoded layers and their weights.
pub(crate) struct Layers {
    /// Textures of one channel.
    pub(crate) textures: Vec<Texture>,
    /// (1 + layers) × inputs: weights of the constant 1, then of each layer.
    pub(crate) weights: DMatrix<f64>,
    /// Mean products of the constant and the layers over all pixels.
    pub(crate) products: DMatrix<f64>,
}

/// Encodes `planes` (several, each of as many values as the picture has pixels; they are used up) as `count` layers. In an
/// open loop, for comparison, the next layer does not see what encoding lost.
pub(crate) fn encode(
    mut left: Vec<f32>,
    (width, height): (usize, usize),
    codec: Codec,
    count: usize,
    closed_loop: bool,
) -> Result<Layers> {
    let pixels = width * height;
    let inputs = left.len() / pixels;
    let original = Gram::of(&left, pixels);
    let (mut textures, mut decoded) = (Vec::new(), Vec::<Vec<f32>>::new());
    let mut cross = DMatrix::zeros(1 + count, inputs);
    (0..inputs).for_each(|i| cross[(0, i)] = original.sums[i]);
    // Products of a layer with the original planes: with what is left, plus what earlier layers took away.
    let (mut taken, mut opened) = (Vec::<Vec<f64>>::new(), Vec::<Vec<f32>>::new());
    for _ in 0..count {
        let gram = Gram::of(&left, pixels);
        let (vectors, values) = eigen(&gram.products);
        if values[0] <= 1e-12 * original.products.trace().max(f64::MIN_POSITIVE) {
            break;
        }
        let direction: Vec<f32> = vectors.column(0).iter().map(|v| *v as f32).collect();
        let plane = combine(&left, pixels, &direction);
        let texture = Texture::encode(codec, &[&plane], width)?;
        let values = texture.values(width, height)?.swap_remove(0);
        let energy = dot(&values, &values).max(f64::MIN_POSITIVE);
        let with_left: Vec<f64> = left.chunks(pixels).map(|l| dot(l, &values)).collect();
        let weights: Vec<f64> = with_left.iter().map(|w| w / energy).collect();
        let j = decoded.len();
        let earlier = if closed_loop { &decoded } else { &opened };
        let with_layers: Vec<f64> = earlier.iter().map(|d| dot(d, &values)).collect();
        for i in 0..inputs {
            let before: f64 = with_layers.iter().zip(&taken).map(|(d, w)| w[i] * d).sum();
            cross[(1 + j, i)] = with_left[i] + before;
        }
        if closed_loop {
            subtract(&mut left, pixels, &values, &weights);
            taken.push(weights);
        } else {
            let exact: Vec<f64> = direction.iter().map(|v| f64::from(*v)).collect();
            subtract(&mut left, pixels, &plane, &exact);
            opened.push(plane);
            taken.push(exact);
        }
        decoded.push(values);
        textures.push(texture);
    }
    let n = 1 + textures.len();
    let ones = vec![1.0; pixels];
    let all: Vec<&[f32]> = std::iter::once(&ones[..]).chain(decoded.iter().map(|d| &d[..])).collect();
    let products = DMatrix::from_fn(n, n, |i, j| if i <= j { dot(all[i], all[j]) / pixels as f64 } else { 0.0 });
    let products = DMatrix::from_fn(n, n, |i, j| products[(i.min(j), i.max(j))]);
    let cross = cross.rows(0, n) / pixels as f64;
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

fn sum(values: &[f32]) -> f64 {
    values.iter().map(|v| f64::from(*v)).sum()
}

/// Product of two planes, summed in f64 over chunks in order.
fn dot(a: &[f32], b: &[f32]) -> f64 {
    let part = |(a, b): (&[f32], &[f32])| -> f64 {
        let lanes = a.chunks(256).zip(b.chunks(256));
        lanes.map(|(a, b)| f64::from(a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>())).sum()
    };
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
            let layers = encode(planes.clone(), size, Codec::Bc4, count, true).unwrap();
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
}
