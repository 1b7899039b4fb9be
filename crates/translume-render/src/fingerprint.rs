//! A number that tells scenes apart, for checkpoints: everything that changes the picture enters it.

use translume_image::Picture;
use translume_scene::emitter::Emitter;
use translume_scene::medium::Volume;
use translume_scene::texture::Texture;
use translume_scene::{Geometry, Scene, Shape};

/// FNV-1a over 64-bit words, finished by a multiply and shift; no defence against malice.
struct Hash(u64);

impl Hash {
    fn word(&mut self, w: u64) {
        self.0 = (self.0 ^ w).wrapping_mul(0x0000_0100_0000_01b3);
        self.0 ^= self.0 >> 29;
    }

    fn text(&mut self, text: &str) {
        self.word(text.len() as u64);
        text.bytes().for_each(|b| self.word(b.into()));
    }

    fn debug(&mut self, value: &impl std::fmt::Debug) {
        self.text(&format!("{value:?}"));
    }

    fn floats(&mut self, values: impl IntoIterator<Item = f32>) {
        values.into_iter().for_each(|v| self.word(v.to_bits().into()));
    }

    fn picture(&mut self, picture: &Picture) {
        self.debug(&picture.pixels.dimensions());
        self.floats(picture.pixels.as_raw().iter().copied());
        self.floats(picture.alpha.iter().flatten().copied());
    }

    fn shape(&mut self, shape: &Shape) {
        let Shape {
            name: _,
            geometry,
            world_from_object,
            flip_normals,
            material,
            radiance,
            shines_behind,
            interior,
            exterior,
        } = shape;
        self.debug(&(world_from_object, flip_normals, material, radiance, shines_behind, interior, exterior));
        match geometry {
            Geometry::Mesh(mesh) => {
                self.floats(mesh.positions.iter().flatten().copied());
                self.floats(mesh.normals.iter().flatten().flatten().copied());
                self.floats(mesh.uvs.iter().chain(&mesh.more_uvs).flatten().flatten().copied());
                self.floats(mesh.tangents.iter().flatten().flatten().copied());
                self.floats(mesh.alphas.iter().flatten().copied());
                self.floats(mesh.colors.iter().flatten().flatten().copied());
                mesh.indices.iter().flatten().for_each(|&i| self.word(i.into()));
            }
            other => self.debug(other),
        }
    }

    fn volume(&mut self, volume: &Volume) {
        match volume {
            Volume::Constant(rgb) => self.debug(rgb),
            Volume::Grid { grid, world_from_grid, samples, filter, wrap } => {
                self.debug(&(grid.size, grid.channels, world_from_grid, samples, filter, wrap));
                self.floats(grid.values.iter().copied());
            }
        }
    }
}

/// The fingerprint of a scene and of `settings`, a line of whatever else decides the picture.
pub fn fingerprint(scene: &Scene, settings: &str) -> u64 {
    let mut hash = Hash(0xcbf2_9ce4_8422_2325);
    hash.text(settings);
    scene.shapes.iter().for_each(|s| hash.shape(s));
    scene.groups.iter().flat_map(|g| &g.shapes).for_each(|s| hash.shape(s));
    hash.debug(&scene.instances);
    hash.debug(&scene.materials.iter().map(|m| &m.model).collect::<Vec<_>>());
    for texture in &scene.textures {
        match texture {
            Texture::Bitmap(b) => {
                hash.picture(&b.image);
                hash.debug(&(b.set, b.image_from_uv, b.filter, b.wrap, b.channel, b.scale));
            }
            other => hash.debug(other),
        }
    }
    for emitter in &scene.emitters {
        match emitter {
            Emitter::Environment { image, scale, world_from_light } => {
                hash.picture(image);
                hash.debug(&(scale, world_from_light));
            }
            other => hash.debug(other),
        }
    }
    for medium in &scene.media {
        hash.volume(&medium.sigma_t);
        hash.volume(&medium.albedo);
        hash.debug(&(medium.scale, medium.phase, medium.domain));
    }
    hash.debug(&scene.sensors.first());
    hash.0
}
