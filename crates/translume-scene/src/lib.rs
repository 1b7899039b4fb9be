//! Scenes: what stands where, what it is made of, what shines, and who looks.
//!
//! [`load`] reads a file into a [`Scene`], a description that no renderer has touched: shapes, materials, textures,
//! lights, media and cameras with all defaults filled in, so that whoever compiles it has no format to know about.
//!
//! Conventions of the description, whatever the file's own:
//! - Colours are linear Rec. 709 RGB. Lengths are the file's; scattering coefficients are per that unit of length.
//! - Matrices take column vectors; `world_from_x` takes points of x to the world. Angles are radians.
//! - Texture coordinates of shapes have their origin at the lower left (v up). [`texture::Bitmap::image_from_uv`] takes
//!   them to the picture (row 0 on top), so the transforms of the formats are all in there.
//! - A camera looks along +z, +y is up and +x is the LEFT of the picture. An environment's direction d, in its own
//!   space, has the azimuth atan2(d.x, −d.z) and the polar angle acos(d.y).
//! - Normals of shapes point outwards: by the winding of triangles in the mesh's own space, and the side stays the same
//!   under transforms that mirror. Area lights shine on the side of the normal.
//!
//! This crate knows nothing about rays, sampling or integrators.

mod builder;
mod check;
pub mod emitter;
mod error;
mod files;
pub mod gltf;
pub mod material;
pub mod medium;
pub mod mitsuba;
pub mod pbrt;
mod rgl;
mod scene;
pub mod sensor;
mod spectrum;
pub mod texture;
mod vol;

pub use error::{Error, Result};
pub use glam;
pub use scene::{
    BssrdfLoader, Geometry, Group, GroupId, Instance, Integrator, LoadOptions, MaterialId, MediumId, Scene, Shape,
    TextureId,
};
use std::path::Path;

/// Reads a Mitsuba `.vol` grid: its numbers and the box its file gives, from corner to corner.
///
/// # Errors
/// [`Error::Io`], [`Error::Invalid`].
pub fn read_grid(path: &Path) -> Result<(std::sync::Arc<medium::Grid>, [glam::DVec3; 2])> {
    let loaded = vol::read(path)?;
    Ok((loaded.grid, [loaded.lo, loaded.hi]))
}

/// A Mitsuba `.vol` grid of `channels` (1 or 3) numbers a cell, x fastest, in the box between two corners.
///
/// # Panics
/// Unless `values` has as many numbers as that.
pub fn grid_bytes(size: [usize; 3], channels: usize, corners: [glam::DVec3; 2], values: &[f32]) -> Vec<u8> {
    assert_eq!(values.len(), size.iter().product::<usize>() * channels);
    vol::bytes(size, channels, corners, values)
}

/// Reads a scene: Mitsuba XML, glTF or pbrt-v4, told by its first character or its name.
///
/// # Errors
/// [`Error::Io`], [`Error::Invalid`] for damaged files and [`Error::Unsupported`] for other formats and features.
pub fn load(path: &Path, options: &LoadOptions) -> Result<Scene> {
    let (scene, files) = files::recorded(|| load_by_kind(path, options));
    Ok(Scene { files, ..scene? })
}

fn load_by_kind(path: &Path, options: &LoadOptions) -> Result<Scene> {
    files::check(path)?;
    let mut head = [0; 64];
    let mut file = std::fs::File::open(path).map_err(|e| Error::io(path, e))?;
    let length = std::io::Read::read(&mut file, &mut head).map_err(|e| Error::io(path, e))?;
    let head = head[..length].strip_prefix(b"\xef\xbb\xbf").unwrap_or(&head[..length]).trim_ascii_start();
    match (head, path.extension().and_then(|e| e.to_str())) {
        ([], _) => Err(Error::invalid(path, None, "the file is empty")),
        ([b'g', b'l', b'T', b'F', ..] | [b'{', ..], _) | (_, Some("glb" | "gltf")) => gltf::load(path, options),
        ([b'<', ..], _) | (_, Some("xml")) => mitsuba::load(path, options),
        (_, Some("pbrt")) => pbrt::load(path, options),
        _ => Err(Error::unsupported(path, None, "not a scene that is read here (Mitsuba XML, glTF, pbrt-v4)")),
    }
}
