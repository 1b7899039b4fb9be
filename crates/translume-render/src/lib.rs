//! From a scene to a picture: compiled scenes, lights, cameras, film, integrators.
//!
//! [`World`] is a [`translume_scene::Scene`] made ready for light transport. It answers what any integrator asks: what a
//! ray meets ([`World::intersect`]), what the surface there does ([`world::SurfaceHit`]), how lights are chosen and sampled
//! ([`light::Lights`]), what lies between two points ([`World::transmittance`]). [`camera::Camera`] starts rays and knows
//! its importance; [`film::Film`] adds samples up; [`integrator`] has one file per method and one table of their names;
//! [`render`] drives them in tiles and passes.
//!
//! Conventions: radiance is linear Rec. 709 RGB; names carry the measure of densities (`pdf_w` per solid angle, `pdf_a`
//! per area); `wo` points where the path came from, `wi` where it goes on, both away from the surface.
//!
//! A seed gives the same picture, to the bit, for any number of threads: a pixel's samples have random streams of their
//! own and are added in their order.

pub mod camera;
pub mod checkpoint;
pub mod film;
mod filter;
mod fingerprint;
pub mod integrator;
pub mod light;
pub mod light_stage;
mod material;
mod medium;
pub mod merge;
pub mod photons;
mod points;
pub mod render;
mod sampler;
pub mod splat;
pub mod subpath;
pub mod tally;
mod texture;
mod world;

pub use fingerprint::fingerprint;
pub use sampler::PathSampler;
pub use world::{Entry, Shading, SurfaceHit, World};

/// Linear Rec. 709 red, green, blue.
pub type Rgb = glam::Vec3;

/// Luminance of a linear Rec. 709 colour.
#[inline]
pub fn luminance(c: Rgb) -> f32 {
    c.dot(Rgb::new(0.2126, 0.7152, 0.0722))
}

/// What cannot be rendered.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The scene lacks something, or its parts contradict each other.
    #[error("{0}")]
    Scene(String),
    /// More triangles than the ray tracer numbers.
    #[error(transparent)]
    TooLarge(#[from] translume_trace::TooLarge),
    /// A file.
    #[error(transparent)]
    Image(#[from] translume_image::Error),
    /// Files that do not go together.
    #[error("{0}")]
    Mismatch(String),
}

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;
