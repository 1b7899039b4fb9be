//! Models of objects under new light, at interactive rates on the CPU [Goesele 2004, §8; Lensch et al. 2003].
//!
//! Light becomes the irradiance that enters the texels of the atlas (shadows by rays, Fresnel's transmittance), that becomes the power at the
//! vertices, and B = T · (F P) + K ∗ P with powers P = E A. Any model that knows R_d between two places is brought into that form by
//! [`crate::hierarchical::Hierarchical::from_transfer`].
//!
//! | file | does |
//! |---|---|
//! | `lights` | the description of lights and view, as JSON |
//! | `irradiance` | light to power |
//! | `evaluate` | power to pictures of a fixed view |
//! | `predict` | pictures of a capture's own laser positions |
//! | `vertex` | the model with a fall-off for each vertex in the same form |

mod evaluate;
mod irradiance;
mod lights;
mod predict;
mod vertex;

pub(crate) use evaluate::sight_samples;
pub use evaluate::{Part, Relighter};
pub use irradiance::{Power, Sources};
pub use lights::{Light, Lighting, Sight};
pub use predict::Predictor;
pub use vertex::from_vertex_model;
