//! The matrix of a stack: a row a texel, a column a light and channel, values on a [`Domain`] scale.
//!
//! Held as 16-bit floats, of all texels or of evenly spread pieces of them, so that its size is bounded; what is left
//! out is read from the files once more when the texels are projected. Work is divided into fixed pieces whose sums run
//! in order: results do not depend on the number of threads.

use crate::display::shown;
use crate::planes::Planes;
use crate::stack::Stack;
use crate::{Domain, Error, Result};
use half::f16;
use half::slice::HalfFloatSliceExt;
use nalgebra::{DMatrix, DMatrixView, Dyn};
use rayon::prelude::*;
use std::sync::Mutex;

/// Texels of a piece.
pub(crate) const PIECE: usize = 512;

/// A sampled matrix in memory.
#[derive(Debug)]
pub struct Matrix {
    /// Number of lights.
    pub lights: usize,
    /// Texels held.
    pub texels: usize,
    /// Pixels of a picture.
    pub pixels: usize,
    /// Every so many pieces of a picture one is held.
    pub stride: usize,
    /// Planes by light and channel, each of `texels` values.
    planes: Vec<f16>,
}

/// A view of floats with any strides.
pub(crate) type View<'a> = DMatrixView<'a, f32, Dyn, Dyn>;

/// The matrix `rows × columns` at `data` in column order, its columns `stride` apart.
pub(crate) fn view(data: &[f32], rows: usize, columns: usize, stride: usize) -> View<'_> {
    View::from_slice_with_strides(data, rows, columns, 1, stride)
}

/// The transposed of the matrix that [`view`] would give: `columns × rows`.
pub(crate) fn transposed(data: &[f32], rows: usize, columns: usize, stride: usize) -> View<'_> {
    View::from_slice_with_strides(data, columns, rows, stride, 1)
}

/// An owned matrix as a view.
pub(crate) fn whole(matrix: &DMatrix<f32>) -> View<'_> {
    view(matrix.as_slice(), matrix.nrows(), matrix.ncols(), matrix.nrows())
}

/// `out += a b`. nalgebra multiplies blocks with up to five rows or columns by another routine, which (0.35) reads beside views
/// whose rows are not adjacent: those are copied first.
pub(crate) fn add_product(out: &mut DMatrix<f32>, a: &View<'_>, b: &View<'_>) {
    if a.nrows().min(a.ncols()).min(b.ncols()) > 5 {
        out.gemm(1.0, a, b, 1.0);
    } else {
        out.gemm(1.0, &a.clone_owned(), &b.clone_owned(), 1.0);
    }
}

impl Matrix {
    /// Reads a stack into at most `bytes` of memory.
    ///
    /// # Errors
    /// As [`Stack::for_each`].
    pub fn read(stack: &mut Stack, domain: Domain, bytes: usize, progress: &(dyn Fn() + Sync)) -> Result<Self> {
        let (lights, pixels) = (stack.shots.len(), stack.pixels());
        let pieces = pixels.div_ceil(PIECE);
        let fitting = (bytes / (6 * lights * PIECE)).max(1);
        let stride = pieces.div_ceil(fitting);
        let texels: usize = held(pixels, stride).map(|r| r.len()).sum();
        let length = 3 * lights * texels;
        let mut planes: Vec<f16> = Vec::new();
        let too_large = |_| Error::Parameter(format!("{} bytes of memory for the stack are refused", 2 * length));
        planes.try_reserve_exact(length).map_err(too_large)?;
        planes.resize(length, f16::ZERO);
        {
            let slots: Vec<Mutex<&mut [f16]>> = planes.chunks_mut(3 * texels).map(Mutex::new).collect();
            let each = |i: usize, rgb: Vec<f32>| {
                // Each light has one slot and one task: the lock is never waited for.
                let mut slot = slots[i].lock().unwrap_or_else(|p| p.into_inner());
                let mut at = 0;
                let mut buffer = [0.0f32; PIECE];
                for range in held(pixels, stride) {
                    for c in 0..3 {
                        let n = range.len();
                        let buffer = &mut buffer[..n];
                        let pixels = &rgb.as_chunks::<3>().0[range.clone()];
                        buffer.iter_mut().zip(pixels).for_each(|(b, p)| *b = p[c]);
                        domain.values(buffer);
                        buffer.iter_mut().for_each(|b| *b = b.min(65504.0));
                        slot[c * texels + at..][..n].convert_from_f32_slice(buffer);
                    }
                    at += range.len();
                }
                Ok(())
            };
            stack.for_each(each, progress)?;
        }
        Ok(Self { lights, texels, pixels, stride, planes })
    }

    /// A matrix of given planes by light and channel.
    #[cfg(test)]
    pub(crate) fn of(lights: usize, texels: usize, values: impl Fn(usize, usize) -> f32) -> Self {
        let planes = (0..3 * lights).flat_map(|i| (0..texels).map(move |t| (i, t)));
        let planes = planes.map(|(i, t)| f16::from_f32(values(i, t))).collect();
        Self { lights, texels, pixels: texels, stride: 1, planes }
    }

    /// Whether every texel is held.
    pub fn is_whole(&self) -> bool {
        self.stride == 1
    }

    /// Gives the memory back; the matrix is empty after.
    pub(crate) fn release(&mut self) {
        (self.planes, self.texels) = (Vec::new(), 0);
    }

    /// Memory that it takes.
    pub(crate) fn bytes(&self) -> usize {
        2 * self.planes.len()
    }

    /// Number of pieces.
    pub(crate) fn pieces(&self) -> usize {
        self.texels.div_ceil(PIECE)
    }

    /// Texels of piece `i` among those held.
    pub(crate) fn piece(&self, i: usize) -> std::ops::Range<usize> {
        i * PIECE..((i + 1) * PIECE).min(self.texels)
    }

    /// Copies the values of a piece into `out`: planes by light and channel, [`PIECE`] apart.
    pub(crate) fn load(&self, piece: usize, out: &mut Vec<f32>) {
        let range = self.piece(piece);
        out.resize(3 * self.lights * PIECE, 0.0);
        for (plane, out) in self.planes.chunks(self.texels).zip(out.chunks_mut(PIECE)) {
            plane[range.clone()].convert_to_f32_slice(&mut out[..range.len()]);
        }
    }

    /// Sums, in f64 and in a fixed order, what `each` adds up over every `step`-th piece, given the piece's values.
    pub(crate) fn sum(
        &self,
        step: usize,
        shape: (usize, usize),
        each: impl Fn(&[f32], usize, &mut DMatrix<f32>) + Sync,
    ) -> DMatrix<f64> {
        const GROUP: usize = 32;
        let picked: Vec<usize> = (0..self.pieces()).step_by(step.max(1)).collect();
        let partial = |pieces: &[usize]| {
            let (mut values, mut part) = (Vec::new(), DMatrix::zeros(shape.0, shape.1));
            for &piece in pieces {
                self.load(piece, &mut values);
                each(&values, self.piece(piece).len(), &mut part);
            }
            part.map(f64::from)
        };
        let mut total = DMatrix::zeros(shape.0, shape.1);
        // Rounds of a few groups bound the memory of partial sums, of which each is held in f32 and in f64.
        const MOST: usize = 64 << 20;
        let groups = (MOST / (12 * shape.0 * shape.1).max(1)).clamp(2, 16);
        for round in picked.chunks(GROUP * groups) {
            let parts: Vec<DMatrix<f64>> = round.par_chunks(GROUP).map(partial).collect();
            parts.iter().for_each(|p| total += p);
        }
        total
    }

    /// Mean of every column over every `step`-th piece.
    pub fn means(&self, step: usize) -> Vec<f32> {
        let sums = self.sum(step, (3 * self.lights, 1), |values, n, out| {
            for (o, plane) in out.iter_mut().zip(values.chunks(PIECE)) {
                *o += plane[..n].iter().sum::<f32>();
            }
        });
        let texels: usize = (0..self.pieces()).step_by(step.max(1)).map(|p| self.piece(p).len()).sum();
        sums.iter().map(|s| (s / texels as f64) as f32).collect()
    }

    /// The share of the texels (every `step`-th piece) that have `value` under all lights.
    pub(crate) fn share_of(&self, value: f32, step: usize) -> f64 {
        let value = f16::from_f32(value);
        let picked: Vec<usize> = (0..self.pieces()).step_by(step.max(1)).collect();
        let count = |piece: &usize| {
            let range = self.piece(*piece);
            let mut all = vec![true; range.len()];
            for plane in self.planes.chunks(self.texels) {
                all.iter_mut().zip(&plane[range.clone()]).for_each(|(all, v)| *all &= *v == value);
            }
            all.iter().filter(|a| **a).count()
        };
        let texels: usize = picked.iter().map(|p| self.piece(*p).len()).sum();
        picked.par_iter().map(count).sum::<usize>() as f64 / texels.max(1) as f64
    }

    /// Mean squared difference on a display ([`shown`]) between the picture of light `i` and another, over the texels held.
    pub(crate) fn display_error(&self, i: usize, picture: &[f32], white: f32, domain: Domain) -> f64 {
        let (mut sum, mut at) = (0.0, 0);
        let mut values = [0.0f32; PIECE];
        for range in held(self.pixels, self.stride) {
            for c in 0..3 {
                let values = &mut values[..range.len()];
                self.planes[(3 * i + c) * self.texels + at..][..range.len()].convert_to_f32_slice(values);
                domain.light(values);
                let pairs = values.iter().zip(&picture.as_chunks::<3>().0[range.clone()]);
                sum += pairs.map(|(v, p)| f64::from(shown(*v) - shown(p[c] / white)).powi(2)).sum::<f64>();
            }
            at += range.len();
        }
        sum / (3 * self.texels) as f64
    }

    /// Every pixel's row times `projection` (columns × outputs), less `offset`: planes of all pixels, by output, in `planes`, which are
    /// none yet. Reads the stack once more when not all texels are held.
    ///
    /// # Errors
    /// Of reading, and of files for planes.
    pub(crate) fn project(
        &self,
        stack: &mut Stack,
        domain: Domain,
        projection: &DMatrix<f32>,
        offset: &[f32],
        planes: &mut Planes,
        progress: &(dyn Fn() + Sync),
    ) -> Result<()> {
        let outputs = projection.ncols();
        planes.grow(outputs)?;
        let mut buffer = Vec::new();
        if self.is_whole() {
            for band in planes.bands(PIECE, outputs) {
                planes.edit(band.clone(), &mut buffer, |planes| {
                    let shares = pieces_of(planes, band.len(), outputs);
                    shares.into_par_iter().enumerate().for_each_init(Vec::new, |values, (i, mut share)| {
                        self.load(band.start / PIECE + i, values);
                        let n = share[0].len();
                        let mut out = DMatrix::zeros(n, outputs);
                        add_product(&mut out, &view(values, n, 3 * self.lights, PIECE), &whole(projection));
                        for (o, plane) in share.iter_mut().enumerate() {
                            plane.iter_mut().zip(out.column(o).iter()).for_each(|(p, v)| *p = v - offset[o]);
                        }
                    });
                    Ok(())
                })?;
            }
            return Ok(());
        }
        // Pictures in order, each spread over the threads by pieces: the sums are the same for any number of threads.
        let add = |planes: &mut [f32], rgb: &[f32], light: usize| {
            let weights = projection.rows(3 * light, 3).into_owned();
            let shares = pieces_of(planes, planes.len() / outputs, outputs);
            shares.into_par_iter().zip(rgb.par_chunks(3 * PIECE)).for_each(|(mut share, rgb)| {
                for (o, plane) in share.iter_mut().enumerate() {
                    let w = [weights[(0, o)], weights[(1, o)], weights[(2, o)]];
                    for (p, v) in plane.iter_mut().zip(rgb.as_chunks::<3>().0) {
                        *p += w[0] * v[0] + w[1] * v[1] + w[2] * v[2];
                    }
                }
            });
        };
        let begin = |planes: &mut [f32]| {
            let n = planes.len() / outputs;
            planes.chunks_mut(n).zip(offset).for_each(|(plane, o)| plane.fill(-o));
        };
        let read = |i: usize| {
            let mut rgb = stack.read(i)?;
            rgb.par_chunks_mut(1 << 14).for_each(|v| domain.values(v));
            progress();
            Ok::<_, Error>(rgb)
        };
        if planes.in_memory() {
            return planes.edit(0..self.pixels, &mut buffer, |planes| {
                begin(planes);
                (0..self.lights).try_for_each(|i| read(i).map(|rgb| add(planes, &rgb, i)))
            });
        }
        // Each band of the planes takes that of all pictures: those go to a file first.
        let mut pictures = planes.room().planes(3 * self.pixels, usize::MAX)?;
        pictures.grow(self.lights)?;
        for i in 0..self.lights {
            pictures.write_run(i, 0, &read(i)?)?;
        }
        let mut rgb = Vec::new();
        for band in planes.bands(PIECE, outputs + 3) {
            let own = 3 * band.start..3 * band.end;
            planes.edit(band, &mut buffer, |planes| {
                begin(planes);
                (0..self.lights)
                    .try_for_each(|i| pictures.read(i..i + 1, own.clone(), &mut rgb).map(|rgb| add(planes, rgb, i)))
            })?;
        }
        Ok(())
    }
}

/// Planes cut into pieces: by piece, then by plane.
pub(crate) fn pieces_of(planes: &mut [f32], pixels: usize, count: usize) -> Vec<Vec<&mut [f32]>> {
    let mut shares: Vec<Vec<&mut [f32]>> = (0..pixels.div_ceil(PIECE)).map(|_| Vec::with_capacity(count)).collect();
    for plane in planes.chunks_mut(pixels) {
        plane.chunks_mut(PIECE).zip(&mut shares).for_each(|(p, s)| s.push(p));
    }
    shares
}

/// The pixels of every `stride`-th piece of a picture.
pub(crate) fn held(pixels: usize, stride: usize) -> impl Iterator<Item = std::ops::Range<usize>> + Clone {
    (0..pixels).step_by(PIECE * stride).map(move |start| start..(start + PIECE).min(pixels))
}
