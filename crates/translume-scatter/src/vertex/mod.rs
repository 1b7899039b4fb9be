//! The exponential model of an object of any shape [Fuchs 2005, §5]: a fall-off for each vertex of its mesh, shared by all
//! channels but for a factor, and a modulation texture.
//!
//! Distances are straight through space, as in the paper. Not modelled, and so part of the error: single scattering, light
//! that leaves and enters again, and the shape of the surface between two points.

mod error;
mod file;
mod gains;
mod interpolate;
mod model;
mod samples;
mod uniform;

pub use error::error_map;
pub(crate) use file::FORMAT;
pub use file::{
    FrameGain, UNIFORM_FORMAT, VERTEX_MODEL_VERSION, VertexHead, load_vertex_model, read_uniform_model,
    read_vertex_model, save_uniform_model, save_vertex_model,
};
pub use gains::estimate_gains;
pub use model::{Faults, Vertex, VertexModel, VertexParams, fit_vertices};
pub use samples::{Beam, MeshCapture};
pub use uniform::{UniformModel, fit_uniform};
