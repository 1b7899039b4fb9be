//! Scenes: what stands where, what it is made of, what shines, and who looks.
//!
//! A front end reads a file into a [`Scene`], a description that no renderer has touched: shapes, materials, textures,
//! lights, media and cameras with all defaults filled in, so that whoever compiles it has no format to know about.
//!
//! Conventions of the description, whatever the file's own:
//! - Colours are linear Rec. 709 RGB. Lengths are the file's; scattering coefficients are per that unit of length.
//! - Matrices take column vectors; `world_from_x` takes points of x to the world. Angles are radians.
//! - Texture coordinates of shapes have their origin at the lower left (v up). [`texture::Bitmap::image_from_uv`] takes
//!   them to the picture (row 0 on top), so the transforms of the formats are all in there.
//! - A camera looks along +z, +y is up and +x is the LEFT of the picture. An environment's direction d, in its own
//!   space, lies at the column atan2(d.x, −d.z)/2π (taken modulo 1) and the row acos(d.y)/π of its picture.
//! - Normals of shapes point outwards: by the winding of triangles in the mesh's own space, and the side stays the same
//!   under transforms that mirror. Area lights shine on the side of the normal.
//!
//! This crate knows nothing about rays, sampling or integrators.

pub mod emitter;
mod error;
pub mod material;
pub mod medium;
mod scene;
pub mod sensor;
pub mod texture;

pub use error::{Error, Result};
pub use glam;
pub use scene::{
    Geometry, Group, GroupId, Instance, Integrator, LoadOptions, MaterialId, MediumId, Scene, Shape, TextureId,
};
