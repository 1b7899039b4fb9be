//! How far a model is from the samples that were kept from its fit.

use super::model::PlanarModel;
use super::samples::{PlanarCapture, held_out};
use rayon::prelude::*;
use serde::Serialize;
use translume_image::Result;

/// ln E(x_i) for each lit point and channel.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorMap {
    /// Per point, then per channel; NaN where there is no held-out sample or no fit.
    pub ln: Vec<Vec<f64>>,
}

/// Means over the lit points. The logarithm of [Fuchs 2005, Table 1] has no base: all readings are given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Mean {
    /// Mean of E(x_i), which is 1 for a perfect model.
    pub e: f64,
    /// Mean of ln E(x_i).
    pub ln_e: f64,
    /// Mean of log10 E(x_i).
    pub log10_e: f64,
}

/// The error of each lit point: the root mean square over its held-out samples of ln(α R_d / s)
/// [Fuchs 2005, Eq. 7], [Fuchs 2005, Eq. 8], corrected: log E(x_i) is the RMS of log E(x_i → x_o).
///
/// # Errors
/// Those of reading frames.
pub fn error_map(capture: &PlanarCapture, model: &PlanarModel) -> Result<ErrorMap> {
    let channels = capture.capture.rig.channels.len();
    let point = |index: usize| -> Result<Vec<f64>> {
        (0..channels)
            .map(|channel| {
                let values = capture.reflectance(&capture.spots[index], channel)?;
                let predicted = model.predict(capture, index, channel);
                let tested = values.iter().zip(&predicted).enumerate();
                // Below, m/s is E(x_i → x_o) of [Fuchs 2005, Eq. 7]
                let tested = tested.filter(|(i, (s, m))| held_out(index, *i) && **s > 0.0 && **m > 0.0);
                let (sum, n) =
                    tested.fold((0.0, 0usize), |(sum, n), (_, (s, m))| (sum + (m / f64::from(*s)).ln().powi(2), n + 1));
                Ok((sum / n as f64).sqrt()) // [Fuchs 2005, Eq. 8]; NaN without samples
            })
            .collect()
    };
    Ok(ErrorMap { ln: (0..capture.spots.len()).into_par_iter().map(point).collect::<Result<_>>()? })
}

impl ErrorMap {
    /// Means over the lit points of one channel.
    pub fn mean(&self, channel: usize) -> Mean {
        let known: Vec<f64> = self.ln.iter().map(|p| p[channel]).filter(|l| l.is_finite()).collect();
        let mean = |f: fn(f64) -> f64| known.iter().map(|l| f(*l)).sum::<f64>() / known.len() as f64;
        Mean { e: mean(f64::exp), ln_e: mean(|l| l), log10_e: mean(|l| l / std::f64::consts::LN_10) }
    }
}
