//! Subsurface scattering, measured: the fall-off of diffuse reflectance around a lit point, fitted.
//!
//! Lengths are millimetres, coefficients mm⁻¹, the diffuse subsurface reflectance R_d is mm⁻² (radiosity out per power in).
//! Parameters belong to the lit point x_i: R_d(x_i → x_o) is not symmetric in its arguments.
//!
//! | file | does |
//! |---|---|
//! | `npy` | sample lists, a block at a time |
//! | `lanes`, `lm`, `radial` | least squares; the fit of one fall-off |
//! | `exponential`, `diffusion`, `curve` | the models |
//! | `segments`, `fit`, `batch` | directions, one point, all points |
//!
//! This crate knows nothing about options, scenes or how a picture is rendered from a model.

mod batch;
mod curve;
mod diffusion;
mod exponential;
mod fit;
mod lanes;
mod lm;
mod npy;
mod radial;
mod segments;

pub use batch::{FIT_VERSION, Sink, Summary, fit_file};
pub use curve::{Curve, Evaluator, Exponentials};
pub use diffusion::{Boundary, Dipole, DipoleKind, Normalized, Sources};
pub use exponential::MAX_TERMS;
pub use fit::{Fitter, Model, Params, PointEvaluator, PointFit, Segment};
pub use npy::SampleFile;
pub use segments::hat;
pub use translume_image::{Error, Result};
