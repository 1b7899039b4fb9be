//! Reflectance fields: stacks of pictures of one view under many lights, compressed and relit.
//!
//! [`Stack`] finds pictures and the directions of their lights, [`compress()`] makes a [`Field`] of them, [`Relighter`]
//! shows the field under any light, [`mod@file`] keeps it. The method is chapter 4 of N. Menzel's thesis on the
//! simplification of materials (2012): logarithm, principal components, 8 bits, block compression. What the default
//! model does otherwise, and what that brings, is in `docs/field.md`.
//!
//! Directions point from the object to the light: x right, y up, z to the camera.

pub mod basis;
mod bc6h;
mod compress;
mod display;
mod domain;
pub mod environment;
mod error;
mod field;
pub mod file;
mod ktx2;
mod layers;
pub mod lights;
mod lines;
mod listed;
pub mod matrix;
pub mod measure;
mod memory;
pub mod names;
pub mod pca;
mod planes;
mod preview;
pub mod probe;
mod relight;
pub mod relightlab;
pub mod simulate;
pub mod sphere;
mod stack;
pub mod strength;
pub mod texture;
pub mod tiles;

pub use compress::{MOST_TERMS, Params, Rate, compress};
pub use domain::Domain;
pub use error::{Error, Result};
pub use field::{Angular, Field, Mix, Model};
pub use relight::Relighter;
pub use stack::{FEWEST, Source, Stack};
