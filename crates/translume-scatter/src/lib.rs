//! Subsurface scattering, measured: capture sets, and models of the diffuse reflectance around lit points.
//!
//! Lengths are millimetres, coefficients mm⁻¹, the diffuse subsurface reflectance R_d is mm⁻² (radiosity out per power in).
//! Parameters belong to the lit point x_i: R_d(x_i → x_o) is not symmetric in its arguments.
//!
//! | file | does |
//! |---|---|
//! | `npy` | sample lists, a block at a time |
//! | `lanes`, `lm`, `radial` | least squares; the fit of one fall-off |
//! | `exponential`, `diffusion`, `curve` | the models |
//! | `segments`, `fit`, `batch` | directions, one point, all points of a list |
//! | `laplace` | values of some vertices to all |
//! | `capture` | capture sets: rig, mesh, frames as a Zarr array |
//! | `simulate` | captures of slabs and solids of heterogeneous media |
//! | `register` | where cameras and laser of a capture were, from its frames |
//! | `gains` | the laser's power for each frame |
//! | `planar` | the exponential model of a flat sample, and its error |
//! | `hierarchical` | the hierarchical model of an object: throughput between vertices, local kernels, detail |
//! | `relight` | models of objects under new lights |
//! | `vertex` | the exponential model of an object: a fall-off for each vertex |
//! | `material` | fitted models as materials for renderers |
//!
//! This crate knows nothing about options, scenes or how a picture is rendered from a model: a material is a
//! [`translume_bxdf::Bssrdf`].

mod batch;
pub mod capture;
mod curve;
mod diffusion;
mod exponential;
mod fit;
mod gains;
pub mod hierarchical;
mod lanes;
mod laplace;
mod lm;
pub mod material;
mod model_folder;
mod npy;
pub mod planar;
mod radial;
pub mod register;
pub mod relight;
mod segments;
pub mod simulate;
pub mod vertex;

pub use batch::{FIT_VERSION, Sink, Summary, fit_file};
pub use curve::{Curve, Evaluator, Exponentials};
pub use exponential::MAX_TERMS;
pub use fit::{Fitter, Model, Params, PointEvaluator, PointFit, Segment};
pub use model_folder::check_model_folder;
pub use npy::SampleFile;
pub use segments::hat;
pub use translume_bxdf::{Boundary, Dipole, DipoleKind, Normalized, Sources};
pub use translume_image::{Error, Result};
