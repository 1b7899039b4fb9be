//! How far a model is from the pixels that were kept from its fit.

use super::model::VertexModel;
use super::samples::MeshCapture;
use crate::planar::{ErrorMap, held_out};
use rayon::prelude::*;
use translume_image::Result;

/// The error of each laser position: the root mean square over its held-out samples, of all views, of ln(α R_d / s)
/// [Fuchs 2005, Eq. 7], [Fuchs 2005, Eq. 8], corrected: log E(x_i) is the RMS of log E(x_i → x_o).
///
/// # Errors
/// Those of reading frames.
pub fn error_map(mesh: &MeshCapture, model: &VertexModel) -> Result<ErrorMap> {
    let channels = mesh.capture.rig.channels.len();
    let beam = |beam: usize| -> Result<Vec<f64>> {
        let one = |channel: usize| -> Result<f64> {
            let (mut sum, mut n) = (0.0, 0usize);
            for &view in mesh.views(beam) {
                let values = mesh.reflectance(beam, view, channel)?;
                let predicted = model.predict(mesh, beam, view, channel);
                for (i, (s, m)) in values.iter().zip(&predicted).enumerate() {
                    if held_out(beam, i) && *s > 0.0 && *m > 0.0 {
                        // m/s is E(x_i → x_o) of [Fuchs 2005, Eq. 7].
                        (sum, n) = (sum + (m / f64::from(*s)).ln().powi(2), n + 1);
                    }
                }
            }
            Ok((sum / n as f64).sqrt()) // [Fuchs 2005, Eq. 8]; NaN without samples
        };
        (0..channels).map(one).collect()
    };
    Ok(ErrorMap { ln: (0..mesh.beams.len()).into_par_iter().map(beam).collect::<Result<_>>()? })
}
