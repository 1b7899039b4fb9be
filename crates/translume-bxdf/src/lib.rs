//! Scattering at surfaces and in volumes: Fresnel's equations, microfacets, BSDFs, BSSRDFs, phase functions.
//!
//! A material at a shading point is a [`Bsdf`]: a closed set of analytic models (an enum with one private module each) and
//! one open door, [`CustomBsdf`], for measured ones. The contract of all of them:
//!
//! - Directions are unit vectors in the local shading frame, the normal is +z, and both point AWAY from the surface.
//!   `wo` is the known one (towards the camera when radiance is traced, towards the light when importance is),
//!   `wi` the one that is evaluated or sampled.
//! - `eval` is the BSDF itself, in sr⁻¹, linear Rec. 709 RGB, WITHOUT the cosine of `wi`. Delta lobes (mirrors, clear glass,
//!   pass-through) evaluate to zero and have zero density: they exist only in `sample`.
//! - `pdf_w` is per solid angle of `wi`, zero where `sample` never goes.
//! - [`Sample::weight`] is f·|cos θ_i|/pdf, for delta lobes the limit of it.
//! - [`Mode::Radiance`] scales refraction by the compression of solid angles, 1/η²; [`Mode::Importance`] does not. With
//!   f* the importance form, f*(wo, wi) = f(wi, wo).
//! - Values are finite and non-negative for all unit directions; `None` or zero means that nothing is scattered.
//!
//! Definitions and defaults of the models are those of Mitsuba 3, which pictures are compared with, but for [`MetalRough`], glTF's;
//! `tests/mitsuba.rs` holds them to its numbers. This crate knows nothing about files, textures or scenes: whoever evaluates
//! textures fills the parameters per shading point, so the structs are small, plain and made without allocation.

mod bsdf;
pub mod bssrdf;
mod coated_sheet;
mod conductor;
mod dielectric;
mod diffuse;
mod diffusion;
pub mod fresnel;
pub mod homogeneous;
mod ior;
mod measured;
mod metal_rough;
mod metals;
mod microfacet;
mod phase;
mod plastic;
mod principled;
mod rough_dielectric;
mod rough_plastic;
mod skin;

pub use bsdf::{Blend, Bsdf, Custom, CustomBsdf, Flags, Mode, Model, Sample};
pub use bssrdf::Bssrdf;
pub use coated_sheet::{CoatedSheet, SheetCoat};
pub use conductor::{Conductor, RoughConductor};
pub use dielectric::{Dielectric, ThinDielectric};
pub use diffuse::{Diffuse, DiffuseSheet};
pub use diffusion::{Boundary, Dipole, DipoleKind, Normalized, Sources};
pub use ior::{AIR, BK7, POLYPROPYLENE, ior_by_name};
pub use measured::{Measured, MeasuredTables};
pub use metal_rough::MetalRough;
pub use metals::{METAL_NAMES, metal_by_name};
pub use microfacet::{Distribution, Microfacets};
pub use phase::Phase;
pub use plastic::Plastic;
pub use principled::Principled;
pub use rough_dielectric::RoughDielectric;
pub use rough_plastic::{Coat, RoughPlastic};
pub use skin::{Entrance, Skin};

/// Linear Rec. 709 red, green, blue.
pub type Rgb = glam::Vec3;
