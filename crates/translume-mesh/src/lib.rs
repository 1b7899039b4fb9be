//! Triangle meshes: files, topology, normals.
//!
//! [`read`] takes PLY, OBJ, STL, OFF, glTF/GLB and Mitsuba `.serialized` files and gives named [`Part`]s, each a [`TriMesh`].
//! What a reader accepts is sound by construction: every index is in range and every attribute has one value per
//! vertex. Positions may still be infinite or NaN (files are like that); [`Topology`] counts them and ray tracing
//! leaves such triangles out.
//!
//! Texture coordinates have their origin at the lower left of the image (v up) in memory, as OBJ has it; the glTF
//! reader turns v over.
//!
//! This crate knows nothing about materials beyond their names, about scenes, or about rays.

mod error;
mod files;
pub mod gltf;
mod lines;
mod loaded;
mod mesh;
mod normals;
pub mod obj;
pub mod off;
mod origin;
pub mod ply;
mod polygon;
pub mod serialized;
pub mod stl;
mod topology;

pub use error::{Error, Result};
pub use files::{Format, ReadOptions, read};
pub use glam;
pub use loaded::{Loaded, Part};
pub use mesh::{Bounds, TriMesh};
pub use topology::Topology;
