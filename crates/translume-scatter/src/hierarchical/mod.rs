//! The hierarchical model of an object (DISCO) [Goesele 2004, §3.1]: R_d between the vertices of a mesh (F, global), 7 × 7 kernels on the
//! texels of an atlas (K, local), and a modulation texture (T).
//!
//! With E the irradiance that enters, A areas, and ∗ the sum over the 49 texels around, B = T · (F E A, interpolated) + K ∗ E A is the radiosity from
//! inside. Kernels are measured from the lit texel outwards and used, by reciprocity, as filters around the texel that is seen.
//!
//! | file | does |
//! |---|---|
//! | `charts`, `atlas`, `grid` | the texture atlas |
//! | `stage`, `views` | what stands still while frames go by |
//! | `resample`, `pairs` | frames to measurements between vertices |
//! | `trend`, `complete` | filling F, by the Laplace solver of the crate |
//! | `refine` | F corrected by what it leaves of the measurements |
//! | `kernel`, `local`, `split` | kernels: of single spots, of all of them, less F |
//! | `detail` | T |
//! | `value` | R_d between two places |
//! | `model`, `file` | all of it |
//!
//! Not modelled: highlights, single scattering's directions, light that leaves and enters again (where it was measured, it is in F).

mod array;
mod atlas;
mod charts;
mod colour;
mod complete;
mod detail;
mod file;
mod grid;
mod kernel;
mod local;
mod model;
mod pairs;
mod refine;
mod resample;
mod split;
mod stage;
mod trend;
mod value;
mod views;

#[cfg(test)]
pub(crate) use atlas::tests;
pub use atlas::{Atlas, AtlasParams, RADIUS, Texel};
pub use complete::{Completion, Solver, complete};
pub use file::{
    HIERARCHICAL_FORMAT, HIERARCHICAL_VERSION, HierarchicalHead, load_hierarchical, read_head, save_hierarchical,
};
pub use model::{Corners, Hierarchical, HierarchicalParams, Step, Told, fit_hierarchical};
pub use pairs::{Measured, Throughput};
pub use resample::{Kernels, resample};
pub use stage::{Losses, Stage};
pub(crate) use views::hidden;
