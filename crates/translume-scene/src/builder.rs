//! What the front ends share: a scene in the making, with every file read once and every constant stored once.

use crate::check;
use crate::scene::{LoadOptions, MaterialId, Scene, TextureId};
use crate::texture::{Bitmap, Checkerboard, Texture};
use crate::{Error, Result, material, rgl, vol};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use translume_bxdf::{CustomBsdf, Rgb};
use translume_image::{Picture, TextureCodes};
use translume_mesh::{ReadOptions, TriMesh};

/// Vertex normals of a mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Normals {
    /// Those of the file, smooth ones where it has none.
    Smooth,
    /// Those of the file or none.
    Keep,
    /// None.
    Flat,
    /// Smooth over edges up to this angle, the bits of an `f32` in radians.
    Crease(u32),
}

/// Which mesh of which file, and how.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct MeshKey {
    pub(crate) path: PathBuf,
    /// `None` for all parts of the file as one.
    pub(crate) part: Option<usize>,
    pub(crate) normals: Normals,
    /// Texture coordinates have their origin at the upper left in the file.
    pub(crate) flip_v: bool,
}

/// A mesh from a file.
#[derive(Clone)]
pub(crate) struct Mesh {
    pub(crate) mesh: Arc<TriMesh>,
    /// Its normals are those of the file, not our own.
    pub(crate) has_own_normals: bool,
}

/// A scene in the making.
pub(crate) struct Builder {
    pub(crate) scene: Scene,
    pub(crate) options: LoadOptions,
    pub(crate) path: PathBuf,
    meshes: HashMap<MeshKey, Mesh>,
    images: HashMap<(PathBuf, bool), Arc<Picture>>,
    grids: HashMap<PathBuf, Arc<vol::Loaded>>,
    measured: HashMap<PathBuf, Arc<dyn CustomBsdf>>,
    constants: HashMap<[u32; 3], TextureId>,
    default_material: HashMap<u32, MaterialId>,
    scaled: HashMap<(TextureId, [u32; 3]), TextureId>,
    /// How deep textures nest that hold others.
    depths: HashMap<TextureId, u32>,
}

/// Textures do not nest deeper.
const DEEPEST_TEXTURE: u32 = 200;

impl Builder {
    pub(crate) fn new(path: &Path, options: &LoadOptions) -> Self {
        Self {
            scene: Scene::default(),
            options: options.clone(),
            path: path.to_owned(),
            meshes: HashMap::new(),
            images: HashMap::new(),
            grids: HashMap::new(),
            measured: HashMap::new(),
            constants: HashMap::new(),
            default_material: HashMap::new(),
            scaled: HashMap::new(),
            depths: HashMap::new(),
        }
    }

    pub(crate) fn warn(&mut self, warning: impl Into<String>) {
        self.scene.warnings.push(warning.into());
    }

    /// The texture of one colour.
    pub(crate) fn constant(&mut self, rgb: Rgb) -> TextureId {
        let key = rgb.to_array().map(f32::to_bits);
        if let Some(&id) = self.constants.get(&key) {
            return id;
        }
        let id = self.texture(Texture::Constant(rgb));
        self.constants.insert(key, id);
        id
    }

    pub(crate) fn texture(&mut self, texture: Texture) -> TextureId {
        self.scene.textures.push(texture);
        TextureId(self.scene.textures.len() - 1)
    }

    /// The texture times a factor. Textures that refer to others in many ways are taken once for each factor.
    pub(crate) fn scaled(&mut self, id: TextureId, factor: Rgb) -> TextureId {
        let key = (id, factor.to_array().map(f32::to_bits));
        if let Some(&known) = self.scaled.get(&key) {
            return known;
        }
        let scaled = match self.scene.textures[id.0].clone() {
            _ if factor == Rgb::ONE => return id,
            Texture::Constant(rgb) => return self.constant(rgb * factor),
            Texture::VertexColor(rgb) => Texture::VertexColor(rgb * factor),
            Texture::VertexAlpha | Texture::Product(..) | Texture::Complement(_) | Texture::Threshold { .. } => {
                Texture::Product(id, self.constant(factor))
            }
            Texture::Bitmap(b) => Texture::Bitmap(Bitmap { scale: b.scale * factor, ..b }),
            Texture::Checkerboard(b) => Texture::Checkerboard(Checkerboard {
                color0: self.scaled(b.color0, factor),
                color1: self.scaled(b.color1, factor),
                ..b
            }),
        };
        let scaled = self.texture(scaled);
        self.scaled.insert(key, scaled);
        scaled
    }

    /// Squares of textures; `None` where these nest too deep.
    pub(crate) fn checkerboard(&mut self, board: Checkerboard) -> Option<TextureId> {
        let depth = |id: TextureId| self.depths.get(&id).copied().unwrap_or(0);
        let depth = 1 + depth(board.color0).max(depth(board.color1));
        if depth > DEEPEST_TEXTURE {
            return None;
        }
        let id = self.texture(Texture::Checkerboard(board));
        self.depths.insert(id, depth);
        Some(id)
    }

    /// Both textures multiplied.
    pub(crate) fn product(&mut self, a: TextureId, b: TextureId) -> TextureId {
        match (self.scene.constant(a), self.scene.constant(b)) {
            (Some(a), _) => self.scaled(b, a),
            (_, Some(b)) => self.scaled(a, b),
            _ => self.texture(Texture::Product(a, b)),
        }
    }

    /// One minus the texture.
    pub(crate) fn complement(&mut self, of: TextureId) -> TextureId {
        match self.scene.constant(of) {
            Some(rgb) => self.constant(Rgb::ONE - rgb),
            None => self.texture(Texture::Complement(of)),
        }
    }

    /// 1 where the texture is `at` or more, 0 elsewhere.
    pub(crate) fn threshold(&mut self, of: TextureId, at: f32) -> TextureId {
        match self.scene.constant(of) {
            Some(rgb) => self.constant(Rgb::splat(if rgb.x >= at { 1.0 } else { 0.0 })),
            None => self.texture(Texture::Threshold { of, at }),
        }
    }

    pub(crate) fn material(&mut self, name: &str, model: material::Model) -> MaterialId {
        self.scene.materials.push(material::Material { name: name.to_owned(), model });
        MaterialId(self.scene.materials.len() - 1)
    }

    /// Gray diffuse, for shapes without a material.
    pub(crate) fn gray(&mut self, reflectance: f32) -> MaterialId {
        if let Some(&id) = self.default_material.get(&reflectance.to_bits()) {
            return id;
        }
        let texture = self.constant(Rgb::splat(reflectance));
        let id = self.material("", material::Model::Diffuse { reflectance: texture });
        self.default_material.insert(reflectance.to_bits(), id);
        id
    }

    /// A mesh from a file, with as few copies in memory as there are different uses.
    pub(crate) fn mesh(&mut self, key: MeshKey) -> Result<Mesh> {
        if let Some(mesh) = self.meshes.get(&key) {
            return Ok(mesh.clone());
        }
        let path = &key.path;
        let options =
            ReadOptions { part: key.part, asset_roots: self.options.asset_roots.clone(), ..ReadOptions::default() };
        let mut loaded = translume_mesh::read(path, &options)?;
        crate::files::note(path);
        for warning in std::mem::take(&mut loaded.warnings) {
            self.scene.warnings.push(format!("{}: {warning}", path.display()));
        }
        let flat = key.normals != Normals::Keep && loaded.parts.iter().any(|p| p.flat);
        let too_large = || Error::unsupported(path, None, "the mesh has more vertices than 32-bit indices reach");
        let mut mesh = loaded.merged().ok_or_else(too_large)?;
        self.clean(&mut mesh, &path.display().to_string());
        let has_own_normals = mesh.normals.is_some() && !flat && matches!(key.normals, Normals::Smooth | Normals::Keep);
        match key.normals {
            Normals::Flat => mesh.normals = None,
            _ if flat => mesh.normals = None,
            Normals::Keep => {}
            Normals::Smooth if mesh.normals.is_some() => {}
            Normals::Smooth => mesh.compute_normals(),
            Normals::Crease(bits) => mesh.crease_normals(f32::from_bits(bits)),
        }
        if key.flip_v {
            mesh.uvs.iter_mut().flatten().for_each(|uv| uv[1] = 1.0 - uv[1]);
        }
        let mesh = Mesh { mesh: Arc::new(mesh), has_own_normals };
        self.meshes.insert(key, mesh.clone());
        Ok(mesh)
    }

    /// Leaves out triangles with corners that are not finite: nothing can be computed with them.
    pub(crate) fn clean(&mut self, mesh: &mut TriMesh, name: &str) {
        let bad: Vec<bool> = mesh.positions.iter().map(|p| !p.iter().all(|x| x.is_finite())).collect();
        let before = mesh.indices.len();
        if bad.contains(&true) {
            mesh.indices.retain(|t| !t.iter().any(|&i| bad[i as usize]));
            // Unused now, and harmless for whoever looks at all positions.
            mesh.positions.iter_mut().zip(&bad).filter(|(_, b)| **b).for_each(|(p, _)| *p = [0.0; 3]);
            let dropped = before - mesh.indices.len();
            self.warn(format!("{name}: {dropped} triangles with corners that are not finite are left out"));
        }
        // Directions and coordinates that are not finite would spread through whatever is computed with them.
        let fix = |v: &mut f32| *v = if v.is_finite() { *v } else { 0.0 };
        mesh.normals.iter_mut().flatten().flatten().for_each(fix);
        mesh.uvs.iter_mut().chain(&mut mesh.more_uvs).flatten().flatten().for_each(fix);
        mesh.tangents.iter_mut().flatten().flatten().for_each(fix);
        mesh.alphas.iter_mut().flatten().for_each(fix);
        mesh.colors.iter_mut().flatten().flatten().for_each(fix);
        if mesh.indices.is_empty() {
            self.warn(format!("{name}: the mesh has no triangles"));
        }
    }

    /// A picture from a file: linear light, or for `raw` the stored numbers. All three formats of scenes say themselves
    /// which integer codes are sRGB: what the file says of its colour and orientation is passed over.
    pub(crate) fn image(&mut self, path: &Path, raw: bool) -> Result<Arc<Picture>> {
        if let Some(image) = self.images.get(&(path.to_owned(), raw)) {
            return Ok(image.clone());
        }
        let bytes = crate::files::bytes(path)?;
        self.decoded_image(&bytes, path, raw)
    }

    /// A picture that shines: linear light, of which there is none below 0.
    pub(crate) fn light_image(&mut self, path: &Path) -> Result<Arc<Picture>> {
        let image = self.image(path, false)?;
        let dark = image.pixels.as_raw().iter().filter(|v| **v < 0.0).count();
        if dark == 0 {
            return Ok(image);
        }
        self.warn(format!("{}: {dark} negative samples of a light count as 0", path.display()));
        let mut picture = (*image).clone();
        picture.pixels.iter_mut().for_each(|v| *v = v.max(0.0));
        Ok(Arc::new(picture))
    }

    /// A picture from memory; `name` tells it from others and stands in messages.
    pub(crate) fn decoded_image(&mut self, bytes: &[u8], name: &Path, raw: bool) -> Result<Arc<Picture>> {
        let key = (name.to_owned(), raw);
        if let Some(image) = self.images.get(&key) {
            return Ok(image.clone());
        }
        let codes = if raw { TextureCodes::Stored } else { TextureCodes::Srgb };
        let picture = translume_image::decode_texture(bytes, name, codes)?;
        self.keep_image(key, picture)
    }

    /// A picture that was read before.
    pub(crate) fn known_image(&self, name: &Path, raw: bool) -> Option<Arc<Picture>> {
        self.images.get(&(name.to_owned(), raw)).cloned()
    }

    fn keep_image(&mut self, key: (PathBuf, bool), mut picture: Picture) -> Result<Arc<Picture>> {
        let bad = picture.count_non_finite();
        if bad > 0 {
            self.warn(format!("{}: {bad} samples that are not finite count as 0", key.0.display()));
            picture.pixels.iter_mut().filter(|v| !v.is_finite()).for_each(|v| *v = 0.0);
        }
        let image = Arc::new(picture);
        self.images.insert(key, image.clone());
        Ok(image)
    }

    /// A Mitsuba grid file.
    pub(crate) fn grid(&mut self, path: &Path) -> Result<Arc<vol::Loaded>> {
        if let Some(grid) = self.grids.get(path) {
            return Ok(grid.clone());
        }
        let grid = Arc::new(vol::read(path)?);
        self.grids.insert(path.to_owned(), grid.clone());
        Ok(grid)
    }

    /// A measured reflectance.
    pub(crate) fn measured(&mut self, path: &Path) -> Result<material::Model> {
        let known = self.measured.get(path).cloned();
        let model = known.map_or_else(|| Ok::<_, Error>(Arc::new(rgl::read(path)?) as Arc<dyn CustomBsdf>), Ok)?;
        self.measured.insert(path.to_owned(), model.clone());
        Ok(material::Model::Measured(model))
    }

    /// The scene, after a look at what no front end should let pass.
    pub(crate) fn finish(mut self) -> Scene {
        check::repair(&mut self.scene, &self.path);
        self.scene
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_png_says_of_its_gamma_does_not_matter_to_scenes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        translume_image::write_gray_png(&path, (2, 1), &[128, 255]).unwrap();
        let plain = std::fs::read(&path).unwrap();
        // gAMA 1.0 behind the header.
        let gamma = [0, 0, 0, 4, b'g', b'A', b'M', b'A', 0x00, 0x01, 0x86, 0xa0, 0x31, 0xe8, 0x96, 0x5f];
        let with = [&plain[..33], &gamma, &plain[33..]].concat();
        let alone = translume_image::decode_picture(&with, &path).unwrap().pixels;
        assert!((alone.get_pixel(0, 0)[0] - 128.0 / 255.0).abs() < 1e-6, "as a picture it is linear");
        for (raw, wanted) in [(false, 0.215_860_5), (true, 128.0 / 255.0)] {
            let mut builder = Builder::new(&path, &LoadOptions::default());
            for (name, bytes) in [("plain.png", &plain), ("with.png", &with)] {
                let image = builder.decoded_image(bytes, Path::new(name), raw).unwrap();
                assert!((image.pixels.get_pixel(0, 0)[0] - wanted).abs() < 1e-6, "{name}, raw {raw}");
            }
            assert!(builder.scene.warnings.is_empty());
        }
    }
}
