//! Rays against triangles and quadrics.
//!
//! A [`Geometry`] holds the shapes that move together in one tree of eight-wide nodes; a [`Scene`] places geometries by
//! affine transforms under a second tree. Both answer the closest hit and whether anything is hit at all.
//!
//! What is promised:
//! - Closed triangle meshes do not leak, at any scale and angle: the triangle test is the watertight one of Woop, Benthin
//!   and Wald (2013) and the boxes are widened by a bound on its rounding errors. No fixed epsilon appears anywhere.
//! - [`SurfacePoint`] carries a bound on the error of its position, and starts rays outside that bound.
//! - Triangles with corners that are not finite, and rays that are not, hit nothing.
//!
//! This crate knows nothing about materials, lights or cameras.

mod build;
mod bvh;
mod geometry;
mod lanes;
mod quadric;
mod ray;
mod scene;
mod surface;
#[cfg(test)]
mod tests;
mod triangle;

pub use geometry::{Geometry, Shape, TooLarge};
pub use glam;
pub use quadric::{Cylinder, Disk, Sphere};
pub use ray::{Hit, Ray};
pub use scene::{Instance, Scene};
pub use surface::SurfacePoint;
