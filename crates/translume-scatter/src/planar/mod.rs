//! The exponential model of a planar sample [Fuchs 2005, §4]: a fall-off for each lit point and direction, and a modulation
//! texture.

mod error;
mod file;
mod gains;
mod model;
mod samples;

pub use error::{ErrorMap, Mean, error_map};
pub(crate) use file::FORMAT;
pub use file::{MODEL_VERSION, ModelHead, load_model, read_model, save_model};
pub use gains::estimate_gains;
pub(crate) use model::fit_shared;
pub use model::{LitPoint, PlanarModel, PlanarParams, fit_planar};
pub use samples::{PlanarCapture, Spot, held_out};
