//! Models of objects under new light, at interactive rates on the CPU [Goesele 2004, §8] [Lensch et al. 2003].
//!
//! Light becomes the irradiance that enters the texels of the atlas (shadows by rays, Fresnel's transmittance), that becomes the power at the
//! vertices, and B = T · (F P) + K ∗ P with powers P = E A. Models with a fall-off by distance are summed over all lit texels instead.
//!
//! | file | does |
//! |---|---|
//! | `lights` | the description of lights and view, as JSON |
//! | `irradiance` | light to power |
//! | `evaluate` | power to pictures of a fixed view |
//! | `predict` | pictures of a capture's own laser positions |
//! | `direct`, `vertex` | models with fall-offs by distance, summed over all lit texels |

mod direct;
mod evaluate;
mod irradiance;
mod lights;
mod predict;
mod vertex;

pub(crate) use evaluate::sight_samples;
#[cfg(test)]
pub(crate) use evaluate::tests::SIGHT;
pub use evaluate::{Part, Relighter};
pub use irradiance::{Power, Sources};
pub use lights::{Light, Lighting, Sight};
pub use predict::Predictor;
pub use vertex::{uniform_picture, vertex_picture};
