//! From weights at the lights of a stack to weights at any direction.
//!
//! Two interpolations by radial functions. [`Kernel::Gaussian`] is the thesis' [Menzel 2012, §4.5] (corrected:
//! e^{−(d/s)²}, the printed exponent lacks the square), of width s = 1.5 × the mean distance to the nearest light: it
//! goes through all data. The default, [`Kernel::Surface`], is regression by a Gaussian process (Rasmussen and Williams
//! 2006, ch. 2 and 5) with an unknown constant and the covariance
//!
//! (1 − τ) E[v(ρ max(n·l, 0)) v(ρ max(n·l′, 0))] + τ (1 + √3 d/s) e^{−√3 d/s} + λ [l = l′]:
//!
//! what matt texels of all slopes do on the stack's own scale v, plus something rough (shadows, highlights: Matérn 3/2),
//! plus noise. τ, s and λ are those with the least error when each light in turn is left out, over all texels at once,
//! which needs no picture: only products of the terms [Rasmussen and Williams, eq. 5.12]. With few lights the first
//! part decides, with many the second.

use crate::Domain;
use nalgebra::{Cholesky, DMatrix, Dyn};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Where a picture was taken: the unit direction to the light, then that to the camera, or zeros where all have one view.
pub type Point = [f32; 6];

/// The points of `lights`, seen from `views` (as many, or none).
pub fn points(lights: &[[f32; 3]], views: &[[f32; 3]]) -> Vec<Point> {
    lights.iter().enumerate().map(|(i, l)| point(*l, views.get(i).copied())).collect()
}

fn point(light: [f32; 3], view: Option<[f32; 3]>) -> Point {
    let v = view.unwrap_or_default();
    [light[0], light[1], light[2], v[0], v[1], v[2]]
}

/// A radial function or covariance on the sphere, or on pairs of directions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", tag = "kind")]
pub enum Kernel {
    /// e^{−(d/s)²}, d the chord between directions.
    Gaussian {
        /// s.
        width: f32,
    },
    /// Matt surfaces, something rough, and noise.
    Surface {
        /// τ: share of the rough part.
        rough: f32,
        /// s: its width.
        width: f32,
        /// λ: variance of the noise.
        noise: f32,
    },
}

/// Weights at lights, ready for any direction.
#[derive(Clone, Debug)]
pub struct Interpolation {
    kernel: Kernel,
    lights: Vec<Point>,
    slopes: Slopes,
    /// Lights × columns: coefficients of what depends on the distance alone.
    radial: DMatrix<f64>,
    /// Features × columns: coefficients of the matt part.
    matt: DMatrix<f64>,
    /// The unknown constant, by column.
    constant: Vec<f64>,
}

/// Values of matt texels of many slopes: what the expectation runs over.
#[derive(Clone, Debug)]
struct Slopes {
    normals: Vec<[f32; 3]>,
    domain: Domain,
    scale: f64,
}

/// Reflectances that the expectation runs over, relative to white.
const ALBEDOS: [f32; 3] = [0.1, 0.3, 0.7];
/// Normals it runs over, cosine-distributed about the view.
const NORMALS: usize = 256;

impl Slopes {
    fn new(domain: Domain, lights: &[Point]) -> Self {
        let golden = std::f32::consts::PI * (1.0 + 5.0f32.sqrt());
        let normals = (0..NORMALS).map(|i| {
            let s2 = (i as f32 + 0.5) / NORMALS as f32;
            let (sin, cos) = (golden * i as f32).sin_cos();
            let s = s2.sqrt();
            [s * cos, s * sin, (1.0 - s2).sqrt()]
        });
        let mut slopes = Self { normals: normals.collect(), domain, scale: 1.0 };
        // The variance at the lights is 1 on average, as that of the rough part.
        let energy: f64 = lights.iter().map(|l| slopes.values(*l).iter().map(|v| v * v).sum::<f64>()).sum();
        slopes.scale = (lights.len() as f64 / energy.max(1e-30)).sqrt();
        slopes
    }

    /// Feature vector of a light: its products are the expectation.
    fn values(&self, l: Point) -> Vec<f64> {
        let cosines = self.normals.iter().map(|n| (n[0] * l[0] + n[1] * l[1] + n[2] * l[2]).max(0.0));
        cosines.flat_map(|c| ALBEDOS.map(|a| self.scale * f64::from(self.domain.value(a * c)))).collect()
    }

    fn table(&self, lights: &[Point]) -> DMatrix<f64> {
        let rows: Vec<Vec<f64>> = lights.par_iter().map(|l| self.values(*l)).collect();
        DMatrix::from_fn(lights.len(), NORMALS * ALBEDOS.len(), |i, j| rows[i][j])
    }
}

fn chord(a: Point, b: Point) -> f64 {
    (0..6).map(|i| f64::from(a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

fn matern(distance: f64, width: f64) -> f64 {
    let q = 3f64.sqrt() * distance / width;
    (1.0 + q) * (-q).exp()
}

/// Mean distance of a point to its nearest neighbour (chord).
pub fn spacing(lights: &[Point]) -> f32 {
    let nearest = |i: usize| {
        let others = lights.iter().enumerate().filter(|(j, _)| *j != i);
        others.map(|(_, l)| chord(lights[i], *l)).fold(2.0, f64::min)
    };
    ((0..lights.len()).map(nearest).sum::<f64>() / lights.len() as f64) as f32
}

/// Variance of the constant: so large that nothing is known of it, so small that the sums keep their digits.
const FREE: f64 = 1e4;

/// Covariance of the lights with themselves, noise and constant left out.
fn covariance(kernel: Kernel, lights: &[Point], matt: &DMatrix<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(lights.len(), lights.len(), |i, j| {
        let d = chord(lights[i], lights[j]);
        // [Menzel 2012, §4.5], corrected.
        match kernel {
            Kernel::Gaussian { width } => (-(d / f64::from(width)).powi(2)).exp(),
            Kernel::Surface { rough, width, .. } => {
                (1.0 - f64::from(rough)) * matt[(i, j)] + f64::from(rough) * matern(d, f64::from(width))
            }
        }
    })
}

fn factor(kernel: Kernel, mut k: DMatrix<f64>) -> Option<Cholesky<f64, Dyn>> {
    let noise = match kernel {
        // As little as keeps the system regular where two lights coincide.
        Kernel::Gaussian { .. } => 1e-9,
        Kernel::Surface { noise, .. } => {
            k.add_scalar_mut(FREE);
            f64::from(noise)
        }
    };
    (0..k.nrows()).for_each(|i| k[(i, i)] += noise);
    Cholesky::new(k)
}

/// Lights that are enough to choose a kernel by.
const ENOUGH: usize = 512;

impl Kernel {
    /// The thesis' Gaussian for these lights.
    pub fn gaussian(lights: &[Point]) -> Self {
        Self::Gaussian { width: (1.5 * spacing(lights)).max(1e-3) }
    }

    /// The surface kernel that predicts a light left out best. `factors` (lights × anything) times its transposed is the
    /// matrix of products of the pictures.
    pub fn cross_validated(lights: &[Point], factors: &DMatrix<f64>, domain: Domain) -> Self {
        // Of very many, an even choice says enough.
        let step = lights.len().div_ceil(ENOUGH);
        if step > 1 {
            let picked: Vec<usize> = (0..lights.len()).step_by(step).collect();
            let lights: Vec<Point> = picked.iter().map(|i| lights[*i]).collect();
            return Self::cross_validated(&lights, &factors.select_rows(&picked), domain);
        }
        let table = Slopes::new(domain, lights).table(lights);
        let matt = &table * table.transpose();
        let mut shapes = vec![(0.0, 1.0)];
        for rough in [0.03, 0.1, 0.3, 1.0] {
            shapes.extend([0.1, 0.2, 0.4, 0.8, 1.6, 3.2].map(|width| (rough, width)));
        }
        let judge = |&(rough, width): &(f32, f32)| {
            let k = covariance(Self::Surface { rough, width, noise: 0.0 }, lights, &matt);
            let noises = [1e-5f32, 1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1];
            let errors = noises.map(|noise| {
                let kernel = Self::Surface { rough, width, noise };
                (left_out_error(kernel, k.clone(), factors).unwrap_or(f64::INFINITY), kernel)
            });
            errors.into_iter().min_by(|a, b| a.0.total_cmp(&b.0))
        };
        let found: Vec<_> = shapes.par_iter().filter_map(judge).collect();
        // The first of equal ones: the same for any number of threads.
        let best = found.iter().min_by(|a, b| a.0.total_cmp(&b.0));
        best.map_or(Self::Surface { rough: 0.3, width: 0.8, noise: 1e-2 }, |b| b.1)
    }
}

/// Mean squared error of the lights, each predicted from the others [Rasmussen and Williams, eq. 5.12].
fn left_out_error(kernel: Kernel, k: DMatrix<f64>, factors: &DMatrix<f64>) -> Option<f64> {
    let inverse = factor(kernel, k)?.inverse();
    let residuals = &inverse * factors;
    let n = inverse.nrows();
    let error = |i: usize| residuals.row(i).norm_squared() / inverse[(i, i)].powi(2);
    Some((0..n).map(error).sum::<f64>() / n as f64)
}

impl Interpolation {
    /// Interpolates `weights` (lights × columns).
    pub fn new(kernel: Kernel, lights: &[Point], weights: &DMatrix<f32>, domain: Domain) -> Self {
        let slopes = Slopes::new(domain, lights);
        let table = slopes.table(lights);
        let matt = &table * table.transpose();
        let weights = weights.map(f64::from);
        let k = covariance(kernel, lights, &matt);
        let coefficients = match factor(kernel, k.clone()) {
            Some(factored) => factored.solve(&weights),
            // Singular to rounding: least squares.
            None => k.svd(true, true).solve(&weights, 1e-9).unwrap_or_else(|_| weights.clone()),
        };
        let (rough, constant) = match kernel {
            Kernel::Gaussian { .. } => (1.0, vec![0.0; weights.ncols()]),
            Kernel::Surface { rough, .. } => {
                (f64::from(rough), coefficients.row_sum().iter().map(|s| FREE * s).collect())
            }
        };
        let matt = table.tr_mul(&coefficients) * (1.0 - rough);
        Self { kernel, lights: lights.to_vec(), slopes, radial: coefficients * rough, matt, constant }
    }

    /// The kernel.
    pub fn kernel(&self) -> Kernel {
        self.kernel
    }

    /// The columns at unit directions to a light and to the camera; the latter does not count where all pictures have one view.
    pub fn at(&self, light: [f32; 3], view: [f32; 3]) -> Vec<f32> {
        let seen = self.lights.iter().any(|l| l[3..] != [0.0; 3]);
        let direction = point(light, seen.then_some(view));
        let mut out = self.constant.clone();
        let mut add = |k: f64, row: nalgebra::MatrixView<'_, f64, nalgebra::U1, Dyn, nalgebra::U1, Dyn>| {
            out.iter_mut().zip(row.iter()).for_each(|(o, c)| *o += k * c);
        };
        for (i, l) in self.lights.iter().enumerate() {
            let d = chord(direction, *l);
            let k = match self.kernel {
                Kernel::Gaussian { width } => (-(d / f64::from(width)).powi(2)).exp(),
                Kernel::Surface { width, .. } => matern(d, f64::from(width)),
            };
            add(k, self.radial.row(i));
        }
        if let Kernel::Surface { .. } = self.kernel {
            let features = self.slopes.values(direction);
            features.iter().enumerate().for_each(|(j, f)| add(*f, self.matt.row(j)));
        }
        out.into_iter().map(|v| v as f32).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lights(n: usize) -> Vec<Point> {
        let light = |i: usize| {
            let z = 1.0 - 0.9 * (i as f32 + 0.5) / n as f32;
            let (sin, cos) = (2.4 * i as f32).sin_cos();
            let s = (1.0 - z * z).sqrt();
            [s * cos, s * sin, z, 0.0, 0.0, 0.0]
        };
        (0..n).map(light).collect()
    }

    /// Matt texels of random slopes under `lights`, on the scale of `domain`: lights × texels.
    fn matt_texels(lights: &[Point], domain: Domain, shift: f32) -> DMatrix<f32> {
        DMatrix::from_fn(lights.len(), 40, |i, t| {
            let (sin, cos) = (1.7 * t as f32 + shift).sin_cos();
            let slope = 0.9 * ((t as f32 * 0.37).fract()).sqrt();
            let n = [slope * cos, slope * sin, (1.0 - slope * slope).sqrt()];
            domain.value(0.5 * (0..3).map(|c| n[c] * lights[i][c]).sum::<f32>().max(0.0))
        })
    }

    fn error(kernel: Kernel, train: &[Point], test: &[Point], domain: Domain) -> f32 {
        let interpolation = Interpolation::new(kernel, train, &matt_texels(train, domain, 0.3), domain);
        let truth = matt_texels(test, domain, 0.3);
        let squares = test.iter().enumerate().map(|(i, l)| {
            interpolation
                .at([l[0], l[1], l[2]], [0.0; 3])
                .iter()
                .zip(truth.row(i).iter())
                .map(|(a, b)| (a - b) * (a - b))
                .sum::<f32>()
                / 40.0
        });
        (squares.sum::<f32>() / test.len() as f32).sqrt()
    }

    #[test]
    fn the_thesis_interpolation_goes_through_its_data_with_the_squared_exponent() {
        let lights = lights(60);
        let weights = DMatrix::from_fn(60, 2, |i, j| ((i * 7 + j * 3) % 11) as f32 - 5.0);
        let kernel = Kernel::gaussian(&lights);
        let found = Interpolation::new(kernel, &lights, &weights, Domain::THESIS);
        for (i, l) in lights.iter().enumerate() {
            let at = found.at([l[0], l[1], l[2]], [0.0; 3]);
            assert!((0..2).all(|j| (at[j] - weights[(i, j)]).abs() < 1e-2), "{i}: {at:?}");
        }
        // One light alone: the function itself, at the distance where it has fallen to 1/e.
        let one = Interpolation::new(
            Kernel::Gaussian { width: 0.5 },
            &lights[..1],
            &DMatrix::from_element(1, 1, 1.0),
            Domain::THESIS,
        );
        let [x, y, z, ..] = lights[0];
        let away = |d: f32| one.at([x, y, z - d], [0.0; 3])[0];
        assert!((away(0.5) - (-1f32).exp()).abs() < 1e-4 && (away(1.0) - (-4f32).exp()).abs() < 1e-4);
    }

    #[test]
    fn cross_validation_beats_the_fixed_gaussian_where_lights_are_few() {
        let (train, test) = (lights(11), lights(23));
        for domain in [Domain::default(), Domain::Linear] {
            let factors = matt_texels(&train, domain, 2.0).map(f64::from);
            let found = error(Kernel::cross_validated(&train, &factors, domain), &train, &test, domain);
            let fixed = error(Kernel::gaussian(&train), &train, &test, domain);
            assert!(found < 0.85 * fixed, "{domain:?}: {found} against {fixed}");
        }
    }

    /// What depends on the view as well is told apart by it, and what does not is the same.
    #[test]
    fn a_view_is_a_direction_too() {
        let (light, aside) = ([0.0, 0.0, 1.0], [0.6, 0.0, 0.8]);
        let at = points(&[light; 4], &[light, aside, [-0.6, 0.0, 0.8], [0.0, 0.6, 0.8]]);
        let weights = DMatrix::from_row_slice(4, 1, &[1.0, 3.0, -1.0, 1.0]);
        let found = Interpolation::new(Kernel::gaussian(&at), &at, &weights, Domain::THESIS);
        assert!((found.at(light, aside)[0] - 3.0).abs() < 1e-3 && (found.at(light, light)[0] - 1.0).abs() < 1e-3);
        let between = found.at(light, [0.316, 0.0, 0.949])[0];
        assert!((1.2..2.8).contains(&between), "{between}");
    }

    #[test]
    fn the_left_out_error_is_that_of_leaving_out() {
        let (lights, domain) = (lights(9), Domain::default());
        let kernel = Kernel::Surface { rough: 0.3, width: 0.8, noise: 1e-2 };
        let data = matt_texels(&lights, domain, 0.0);
        let table = Slopes::new(domain, &lights).table(&lights);
        let quick =
            left_out_error(kernel, covariance(kernel, &lights, &(&table * table.transpose())), &data.map(f64::from));
        // By hand, with the scale of the whole set, which is no parameter of the fit.
        let by_hand: f64 = (0..9)
            .map(|i| {
                let keep: Vec<usize> = (0..9).filter(|j| *j != i).collect();
                let rest: Vec<Point> = keep.iter().map(|j| lights[*j]).collect();
                let features = table.select_rows(&keep);
                let k = covariance(kernel, &rest, &(&features * features.transpose()));
                let solved = factor(kernel, k).unwrap().solve(&data.select_rows(&keep).map(f64::from));
                let to_all = covariance(kernel, &lights, &(&table * table.transpose())).add_scalar(FREE);
                let predicted = to_all.select_rows(&[i]).select_columns(&keep) * solved;
                (predicted - data.row(i).map(f64::from)).norm_squared()
            })
            .sum();
        assert!((quick.unwrap() / (by_hand / 9.0) - 1.0).abs() < 1e-6, "{quick:?} {}", by_hand / 9.0);
    }
}
