//! glTF textures: pictures, samplers, sets and transforms of coordinates.

use super::{Loader, index_of};
use crate::scene::TextureId;
use crate::texture::{Bitmap, Channel, Filter, Texture, Wrap};
use crate::{Error, Result};
use glam::{DAffine2, DMat2, DVec2};
use serde_json::Value;
use std::path::PathBuf;
use std::sync::Arc;
use translume_bxdf::Rgb;
use translume_image::Picture;
use translume_mesh::gltf::is_data;

impl Loader {
    /// The texture that a texture reference names, `None` when there is no reference.
    pub(super) fn bitmap(
        &mut self,
        reference: &Value,
        raw: bool,
        channel: Channel,
        scale: Rgb,
    ) -> Result<Option<TextureId>> {
        if reference.is_null() {
            return Ok(None);
        }
        let transform = &reference["extensions"]["KHR_texture_transform"];
        let wanted = if transform["texCoord"].is_null() { &reference["texCoord"] } else { &transform["texCoord"] };
        let set = if wanted.is_null() { Some(0) } else { index_of(wanted) };
        let set = set.ok_or_else(|| self.invalid(format!("texCoord {wanted} of a texture is no number of a set")))?;
        if set >= self.sets {
            let instead = if self.sets == 0 { "the triangles' own" } else { "the first" };
            self.warn_once(format!(
                "a material asks for TEXCOORD_{set}, which a mesh with it has not; {instead} are used"
            ));
        }
        let made = self.picture(reference, raw);
        let (image, sampler) = match made {
            Err(e) if self.builder.options.lenient => {
                self.builder.warn(format!("{e}; left out"));
                return Ok(None);
            }
            made => made?,
        };
        let wrap = |key: &str| match sampler[key].as_f64().map(|v| v as u32) {
            Some(33071) => Wrap::Clamp,
            Some(33648) => Wrap::Mirror,
            _ => Wrap::Repeat,
        };
        let nearest = sampler["magFilter"].as_f64() == Some(9728.0);
        let bitmap = Bitmap {
            image,
            set,
            image_from_uv: image_from_uv(transform),
            filter: if nearest { Filter::Nearest } else { Filter::Bilinear },
            wrap: [wrap("wrapS"), wrap("wrapT")],
            channel,
            scale,
        };
        if !bitmap.image_from_uv.is_finite() {
            return Err(self.invalid("a transform of texture coordinates is not finite"));
        }
        Ok(Some(self.builder.texture(Texture::Bitmap(bitmap))))
    }

    /// Pixels and sampler of a texture reference.
    fn picture(&mut self, reference: &Value, raw: bool) -> Result<(Arc<Picture>, Value)> {
        let index = index_of(&reference["index"]);
        let texture = index.and_then(|i| self.asset.json["textures"].get(i)).cloned();
        let texture = texture.ok_or_else(|| self.invalid(format!("there is no texture {}", reference["index"])))?;
        let source = index_of(&texture["source"]);
        let image = source.and_then(|i| self.asset.json["images"].get(i)).cloned();
        let (Some(number), Some(image)) = (source, image) else {
            let what = format!(
                "texture {}: there is no image {} of a kind that is read",
                reference["index"], texture["source"]
            );
            return Err(Error::unsupported(&self.asset.path, None, what));
        };
        let sampler = index_of(&texture["sampler"]).map_or(Value::Null, |i| self.asset.json["samplers"][i].clone());
        let fault = |e: Error| e.inside(&self.asset.path, &format!("image {number}"));
        let loaded = match image["uri"].as_str() {
            Some(uri) if !is_data(uri) => {
                let path = self.asset.file(uri).map_err(Error::from).map_err(fault)?;
                match self.builder.known_image(&path, raw) {
                    Some(image) => Ok(image),
                    None => {
                        let bytes = crate::files::bytes(&path).map_err(fault)?;
                        self.builder.decoded_image(&bytes, &path, raw)
                    }
                }
            }
            uri => {
                let bytes = match uri {
                    Some(uri) => self.asset.resolve(uri).map_err(Error::from).map_err(fault)?,
                    None => self.view(&image["bufferView"]).map_err(fault)?,
                };
                let name = PathBuf::from(format!("{}#image{number}", self.asset.path.display()));
                self.builder.decoded_image(&bytes, &name, raw)
            }
        };
        Ok((loaded.map_err(|e| e.inside(&self.asset.path, &format!("image {number}")))?, sampler))
    }

    /// The bytes of a buffer view.
    fn view(&self, index: &Value) -> Result<Vec<u8>> {
        let missing = || self.invalid(format!("there is no buffer view {index}"));
        self.asset.bytes(index_of(index).ok_or_else(missing)?).map(<[u8]>::to_vec).map_err(Error::from)
    }
}

/// Where our texture coordinates (v up) fall in the picture: T·R·S of the extension on glTF's own (v down).
fn image_from_uv(transform: &Value) -> DAffine2 {
    let pair = |key: &str, default: f64| {
        let component = |i: usize| transform[key][i].as_f64().unwrap_or(default);
        DVec2::new(component(0), component(1))
    };
    let (sin, cos) = transform["rotation"].as_f64().unwrap_or(0.0).sin_cos();
    let rotation = DMat2::from_cols(DVec2::new(cos, -sin), DVec2::new(sin, cos));
    let matrix = rotation * DMat2::from_diagonal(pair("scale", 1.0));
    let flip = DAffine2::from_cols(DVec2::X, DVec2::NEG_Y, DVec2::Y);
    DAffine2::from_mat2_translation(matrix, pair("offset", 0.0)) * flip
}
