//! Fitted models as materials: each is a [`Bssrdf`], which renderers evaluate and draw from.
//!
//! Colours of a model are told by their names: `red`, `green`, `blue`, or a single channel for all three.

mod fall_off;
mod planar;
mod vertex;

use serde_json::Value;
use std::path::Path;
use std::sync::Arc;
use translume_bxdf::Bssrdf;
use translume_image::{Error, Result};

pub use planar::PlanarMaterial;
pub use vertex::VertexMaterial;

/// Reads the model in the folder `path`, of whatever kind it is.
///
/// # Errors
/// [`Error::Io`]; [`Error::Invalid`] for damaged files; [`Error::Unsupported`] for other kinds, versions and channels.
pub fn load_material(path: &Path) -> Result<Arc<dyn Bssrdf>> {
    let file = path.join("model.json");
    let text = std::fs::read(&file).map_err(|e| Error::io(&file, e))?;
    let head: Value = serde_json::from_slice(&text).map_err(|e| Error::invalid(&file, e.to_string()))?;
    match head["format"].as_str() {
        Some(crate::planar::FORMAT) => Ok(Arc::new(PlanarMaterial::load(path)?)),
        Some(crate::vertex::FORMAT) => Ok(Arc::new(VertexMaterial::load(path)?)),
        _ => Err(Error::invalid(&file, "not a model of a translucent object")),
    }
}

/// Which channel is red, green and blue.
fn colours(file: &Path, names: &[String]) -> Result<[usize; 3]> {
    let find = |name: &str| names.iter().position(|n| n.eq_ignore_ascii_case(name));
    match (names.len(), find("red"), find("green"), find("blue")) {
        (1, ..) => Ok([0; 3]),
        (_, Some(r), Some(g), Some(b)) => Ok([r, g, b]),
        _ => Err(Error::unsupported(
            file,
            format!("channels {names:?}: red, green and blue or one for all are rendered"),
        )),
    }
}

/// A bound of fall-offs at growing distances, so that it need not be looked for at each.
#[derive(Clone, Debug, Default)]
struct Envelope {
    values: Vec<f32>,
}

impl Envelope {
    const LAST: usize = 127;

    /// From 0 to about 600 mm.
    fn distance(i: usize) -> f32 {
        0.05 * ((i as f32 * 0.074).exp() - 1.0)
    }

    /// `at` is the largest value of any fall-off at a distance.
    fn new(at: impl Fn(f32) -> f32) -> Self {
        let mut values: Vec<f32> = (0..=Self::LAST).map(|i| at(Self::distance(i))).collect();
        // Fall-offs may rise first; the bound is for a distance and all beyond.
        (0..Self::LAST).rev().for_each(|i| values[i] = values[i].max(values[i + 1]));
        Self { values }
    }

    fn bound(&self, r: f32) -> f32 {
        let i = ((r / 0.05 + 1.0).ln() / 0.074) as usize;
        // Between two distances a rising fall-off may be a little above both.
        1.05 * self.values[i.min(Self::LAST)]
    }
}
