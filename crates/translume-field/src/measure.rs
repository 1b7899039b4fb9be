//! How far a field is from its stack, as [Menzel 2012, §4.6] measures it: after an adaptive exposure (here the stack's
//! white, once for all pictures) and gamma 2.2, clipped to what a display shows.

use crate::Relighter;
pub use crate::display::shown;
use crate::field::Field;
use crate::matrix::Matrix;
use crate::pca;
use crate::stack::Stack;
use crate::{Domain, Error, Result};
use nalgebra::DMatrix;
use rayon::prelude::*;

/// PSNR of pictures that are the same (black ones, mostly): with infinity there would be no mean.
pub const MOST_PSNR: f64 = 100.0;

/// Errors of one picture.
#[derive(Clone, Copy, Debug)]
pub struct PictureError {
    /// Number of the light in the stack.
    pub light: usize,
    /// Root mean square difference of what a display shows, in [0, 1].
    pub rms: f64,
    /// PSNR of the same in dB, peak 1; at most [`MOST_PSNR`].
    pub psnr: f64,
    /// Root mean square of ln((x + δ)/(y + δ)), δ 1 % of white: every exposure counts.
    pub log_rms: f64,
}

/// Whether the field was made from these lights, in this order: then its own weights are used, and no interpolation.
pub fn is_own(field: &Field, stack: &Stack) -> bool {
    let lights = field.lights();
    let near = |a: &[f32; 3], b: &[f32; 3]| (0..3).all(|c| (a[c] - b[c]).abs() < 1e-4);
    let views = stack.views();
    lights.len() == stack.shots.len()
        && lights.iter().zip(&stack.shots).all(|(l, s)| near(l, &s.light))
        && views.len() == field.views().len()
        && views.iter().zip(field.views()).all(|(a, b)| near(a, b))
}

/// Errors of all pictures of a stack.
///
/// # Errors
/// [`Error::Parameter`] when the sizes differ; of reading.
pub fn compare(field: &Field, stack: &mut Stack, progress: &(dyn Fn() + Sync)) -> Result<Vec<PictureError>> {
    if (field.width, field.height) != (stack.width, stack.height) {
        let what = format!(
            "the field is {} × {}, the pictures are {} × {}",
            field.width, field.height, stack.width, stack.height
        );
        return Err(Error::Parameter(what));
    }
    let relighter = Relighter::new(field)?;
    let own = is_own(field, stack);
    let shots = stack.shots.clone();
    let found = std::sync::Mutex::new(vec![None; shots.len()]);
    let each = |light: usize, rgb: Vec<f32>| {
        let mix = field.mix_of_light(light).filter(|_| own).unwrap_or_else(|| relighter.mix_of(&shots[light]));
        let got = relighter.picture(&mix);
        let (mut sum, mut log_sum) = (0.0f64, 0.0f64);
        for (x, y) in rgb.iter().zip(&got) {
            let y = y / field.white;
            sum += f64::from(shown(*x) - shown(y)).powi(2);
            log_sum += f64::from(((x + 0.01) / (y + 0.01)).ln()).powi(2);
        }
        let (mse, log_mse) = (sum / rgb.len() as f64, log_sum / rgb.len() as f64);
        let error = PictureError {
            light,
            rms: mse.sqrt(),
            psnr: (-10.0 * mse.log10()).min(MOST_PSNR),
            log_rms: log_mse.sqrt(),
        };
        found.lock().unwrap_or_else(|p| p.into_inner())[light] = Some(error);
        Ok(())
    };
    stack.white = field.white;
    stack.for_each(each, progress)?;
    Ok(found.into_inner().unwrap_or_else(|p| p.into_inner()).into_iter().flatten().collect())
}

/// Root mean square error on a display of a truncated decomposition with 1, 2, … terms [Menzel 2012, Fig. 4.2]: in floats,
/// nothing quantised, three channels a term.
///
/// # Errors
/// Of reading the stack.
pub fn curve(stack: &mut Stack, domain: Domain, most: usize, progress: &(dyn Fn() + Sync)) -> Result<Vec<f64>> {
    // Some 60,000 texels say enough.
    let n = stack.shots.len();
    let matrix = Matrix::read(stack, domain, 6 * n * (1 << 16), progress)?;
    let (gram, white) = pca::light_gram(&matrix, 1);
    let (vectors, _) = pca::lanczos(&gram, &white, most.min(n));
    let vectors = vectors.map(|v| v as f32);
    let terms = vectors.ncols();
    let part = |piece: usize| {
        let mut values = Vec::new();
        matrix.load(piece, &mut values);
        let texels = matrix.piece(piece).len();
        let mut sums = vec![0.0f64; terms];
        let show = |m: &DMatrix<f32>| {
            let mut light = m.as_slice().to_vec();
            domain.light(&mut light);
            light.iter_mut().for_each(|v| *v = shown(*v));
            light
        };
        for c in 0..3 {
            let x = pca::channel(&values, texels, n, c).clone_owned();
            let truth = show(&x);
            let along = pca::along(&pca::channel(&values, texels, n, c), &vectors);
            let mut sum = DMatrix::zeros(texels, n);
            for k in 0..terms {
                sum.ger(1.0, &along.column(k), &vectors.column(k), 1.0);
                sums[k] += show(&sum).iter().zip(&truth).map(|(a, b)| f64::from((a - b) * (a - b))).sum::<f64>();
            }
        }
        sums
    };
    let parts: Vec<Vec<f64>> = (0..matrix.pieces()).into_par_iter().map(part).collect();
    let total = (3 * n * matrix.texels) as f64;
    Ok((0..terms).map(|k| (parts.iter().map(|p| p[k]).sum::<f64>() / total).sqrt()).collect())
}
