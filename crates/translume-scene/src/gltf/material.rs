//! glTF materials as Mitsuba's principled BSDF and its neighbours.
//!
//! Transmission without thickness is a thin sheet, with thickness a solid whose absorption is a medium inside. Alpha is a
//! mask; with a cutoff its picture is thresholded before filtering. Diffuse transmission is a sheet, see [`Loader::sheet`]; into a
//! volume it is translucent, as volumes that scatter (a draft) are: see [`Loader::translucent`].

use super::{Dress, Loader, index_of, vector3};
use crate::material::{Dielectric, Model, Principled, Subsurface, ThinPrincipled};
use crate::medium::{Medium, Volume};
use crate::scene::{MaterialId, MediumId, TextureId};
use crate::texture::{Bitmap, Channel, Filter, Texture, Wrap};
use crate::{Error, Result};
use glam::{DAffine2, DMat2, DVec2};
use serde_json::Value;
use std::path::PathBuf;
use std::sync::Arc;
use translume_bxdf::homogeneous::{Diffusion, Homogeneous};
use translume_bxdf::{Distribution, Phase, Rgb};
use translume_image::{Picture, Rgb32FImage};

impl Loader {
    /// What material number `index` becomes; the default material for `None`.
    pub(super) fn material(&mut self, index: Option<usize>, has_colors: bool) -> Result<Dress> {
        if let Some(&dress) = self.materials.get(&(index, has_colors)) {
            return Ok(dress);
        }
        let source = match index {
            Some(i) => match self.asset.json["materials"].get(i) {
                Some(source) => source.clone(),
                None => return Err(self.invalid(format!("there is no material {i}"))),
            },
            None => Value::Null,
        };
        let name = source["name"].as_str().unwrap_or_default().to_owned();
        let dress = Dress {
            material: self.surface(&source, &name, has_colors)?,
            radiance: self.emission(&source)?,
            interior: self.interior(&source, &name),
        };
        self.materials.insert((index, has_colors), dress);
        Ok(dress)
    }

    fn surface(&mut self, source: &Value, name: &str, has_colors: bool) -> Result<MaterialId> {
        let extensions = &source["extensions"];
        let old = &extensions["KHR_materials_pbrSpecularGlossiness"];
        let pbr = &source["pbrMetallicRoughness"];
        let (base, base_factor) = if old.is_null() {
            (&pbr["baseColorTexture"], &pbr["baseColorFactor"])
        } else {
            (&old["diffuseTexture"], &old["diffuseFactor"])
        };
        let factor = vector3(base_factor, [1.0; 3]).max(Rgb::ZERO);
        let base_color = match self.bitmap(base, false, Channel::Rgb, factor)? {
            Some(id) => {
                if has_colors {
                    self.warn_once(format!("material {name:?}: vertex colours beside a texture are not used"));
                }
                id
            }
            None if has_colors => self.builder.texture(Texture::VertexColor(factor)),
            None => self.builder.constant(factor),
        };
        let is_unlit = !extensions["KHR_materials_unlit"].is_null();
        let model = if is_unlit {
            self.warn_once(format!("material {name:?} is unlit; it is taken as diffuse"));
            Model::Diffuse { reflectance: base_color }
        } else if !old.is_null() {
            if !extensions["KHR_materials_diffuse_transmission"].is_null() {
                self.warn_once(format!(
                    "material {name:?} has specular glossiness, which no diffuse transmission goes with"
                ));
            }
            self.specular_glossiness(old, base_color)
        } else if let Some(model) = self.translucent(extensions, pbr, base_color, name)? {
            model
        } else {
            self.metal_or_not(pbr, extensions, base_color)?
        };
        let opaque = self.transmitting(source, model, base_color, name)?;
        let bumped = self.bumped(source, name, opaque)?;
        self.masked(source, base, base_factor[3].as_f64().unwrap_or(1.0) as f32, name, bumped)
    }

    fn metal_or_not(&mut self, pbr: &Value, extensions: &Value, base_color: TextureId) -> Result<Model> {
        let number = |v: &Value, default: f64| v.as_f64().unwrap_or(default).clamp(0.0, 1.0) as f32;
        let mut factor = |texture: &Value, raw: bool, channel: Channel, value: f32| -> Result<TextureId> {
            match self.bitmap(texture, raw, channel, Rgb::splat(value))? {
                Some(id) => Ok(id),
                None => Ok(self.builder.constant(Rgb::splat(value))),
            }
        };
        let both = &pbr["metallicRoughnessTexture"];
        let metallic = factor(both, true, Channel::Blue, number(&pbr["metallicFactor"], 1.0))?;
        let roughness = factor(both, true, Channel::Green, number(&pbr["roughnessFactor"], 1.0))?;
        let coat = &extensions["KHR_materials_clearcoat"];
        let clearcoat = factor(&coat["clearcoatTexture"], true, Channel::Red, number(&coat["clearcoatFactor"], 0.0))?;
        let gloss = 1.0 - number(&coat["clearcoatRoughnessFactor"], 0.0);
        let volume = extensions["KHR_materials_volume"]["thicknessFactor"].as_f64().unwrap_or(0.0) > 0.0;
        let through = &extensions["KHR_materials_transmission"];
        let amount = if volume { number(&through["transmissionFactor"], 0.0) } else { 0.0 };
        let spec_trans = factor(&through["transmissionTexture"], true, Channel::Red, amount)?;
        let specular = number(&extensions["KHR_materials_specular"]["specularFactor"], 1.0);
        let mut constant = |v: f32| self.builder.constant(Rgb::splat(v));
        let zero = constant(0.0);
        Ok(Model::Principled(Box::new(Principled {
            base_color,
            roughness,
            anisotropic: zero,
            metallic,
            spec_trans,
            eta: index_of_refraction(extensions, specular),
            spec_tint: zero,
            sheen: zero,
            sheen_tint: zero,
            flatness: zero,
            clearcoat,
            clearcoat_gloss: constant(gloss),
        })))
    }

    /// Light that goes into a volume in all directions and comes out elsewhere, as a dipole: `KHR_materials_volume` with thickness and an
    /// attenuation, and `KHR_materials_diffuse_transmission` or the draft `KHR_materials_volume_scatter`.
    ///
    /// The attenuation distance is that between two meetings with particles. With the draft, the attenuation is σ_t = −ln(color)/distance and
    /// `multiscatterColor` is what comes back; without it the same distance holds for all colours, and what comes back is the
    /// transmission's colour times the attenuation's. The part of the surface that does not transmit is part of what comes back.
    fn translucent(
        &mut self,
        extensions: &Value,
        pbr: &Value,
        base_color: TextureId,
        name: &str,
    ) -> Result<Option<Model>> {
        let volume = &extensions["KHR_materials_volume"];
        let (through, scatter) =
            (&extensions["KHR_materials_diffuse_transmission"], &extensions["KHR_materials_volume_scatter"]);
        let amount = match (through.is_null(), scatter.is_null()) {
            (true, true) => return Ok(None),
            (true, false) => 1.0,
            (false, _) => through["diffuseTransmissionFactor"].as_f64().unwrap_or(0.0).clamp(0.0, 1.0) as f32,
        };
        let distance = volume["attenuationDistance"].as_f64().filter(|d| *d > 0.0 && d.is_finite());
        let solid = volume["thicknessFactor"].as_f64().unwrap_or(0.0) > 0.0;
        let Some(distance) = distance.filter(|_| solid && amount > 0.0) else {
            return match () {
                () if amount == 0.0 => Ok(None),
                () if through.is_null() => {
                    let what = "scatters in a volume without an attenuation distance; it is taken as opaque";
                    self.warn_once(format!("material {name:?} {what}"));
                    Ok(None)
                }
                // Of a solid, clear transmission takes the place of diffuse transmission.
                () if solid && extensions["KHR_materials_transmission"]["transmissionFactor"].as_f64() > Some(0.0) => {
                    Ok(None)
                }
                () => self.sheet(extensions, pbr, base_color, name).map(Some),
            };
        };
        let distance = distance as f32;
        let attenuation = vector3(&volume["attenuationColor"], [1.0; 3]).clamp(Rgb::splat(1e-6), Rgb::ONE);
        let mut varies = self.builder.scene.constant(base_color).is_none();
        let base = self.builder.scene.mean(base_color);
        let mut mean = |texture: &Value, raw: bool, channel: Channel, factor: Rgb| -> Result<Rgb> {
            let Some(id) = self.bitmap(texture, raw, channel, factor)? else { return Ok(factor) };
            varies = true;
            Ok(self.builder.scene.mean(id))
        };
        let tint = vector3(&through["diffuseTransmissionColorFactor"], [1.0; 3]).clamp(Rgb::ZERO, Rgb::ONE);
        let tint = mean(&through["diffuseTransmissionColorTexture"], false, Channel::Rgb, tint)?;
        let amount = mean(&through["diffuseTransmissionTexture"], true, Channel::Alpha, Rgb::splat(amount))?.x;
        let color = vector3(&scatter["multiscatterColor"], [0.0; 3]).clamp(Rgb::ZERO, Rgb::ONE);
        let color = mean(&scatter["multiscatterColorTexture"], false, Channel::Rgb, color)?;
        if varies {
            self.warn_once(format!(
                "material {name:?} is translucent: of its textures the means are used, of its vertex colours none"
            ));
        }
        let (inside, path) = match scatter.is_null() {
            true => (tint * attenuation, Rgb::splat(distance)),
            false => {
                let g = scatter["scatterAnisotropy"].as_f64().unwrap_or(0.0).clamp(-0.99, 0.99) as f32;
                let path = Rgb::from(attenuation.to_array().map(|c| distance / -c.min(0.9999).ln()));
                (tint * color, path / (1.0 - g))
            }
        };
        let reflectance = base.clamp(Rgb::ZERO, Rgb::ONE) * (1.0 - amount) + inside * amount;
        let eta = index_of_refraction(extensions, 1.0);
        let made = Homogeneous::from_reflectance(Diffusion::Dipole, reflectance, path, eta);
        let made = made.ok_or_else(|| self.invalid(format!("material {name:?}: its volume scatters nothing")))?;
        let rough = pbr["roughnessFactor"].as_f64().unwrap_or(1.0).clamp(0.0, 1.0) as f32;
        Ok(Some(Model::Subsurface(Box::new(Subsurface {
            model: Arc::new(made),
            mm_per_unit: 1.0,
            in_object_space: false,
            eta,
            roughness: (rough > 0.03).then_some((Distribution::Ggx, rough * rough)),
            specular_reflectance: self.builder.constant(Rgb::ONE),
        }))))
    }

    /// `KHR_materials_diffuse_transmission` of what is not a volume that attenuates: a sheet that light goes through where it is, the
    /// coat of the metallic-roughness model on both its sides.
    fn sheet(&mut self, extensions: &Value, pbr: &Value, base_color: TextureId, name: &str) -> Result<Model> {
        let Model::Principled(p) = self.metal_or_not(pbr, extensions, base_color)? else {
            return Err(self.invalid(format!("material {name:?} has no metallic-roughness model")));
        };
        if self.builder.scene.constant(p.clearcoat) != Some(Rgb::ZERO) {
            self.warn_once(format!("material {name:?} lets light through diffusely; its clear coat is not used"));
        }
        let through = &extensions["KHR_materials_diffuse_transmission"];
        let amount = through["diffuseTransmissionFactor"].as_f64().unwrap_or(0.0).clamp(0.0, 1.0) as f32;
        let color = vector3(&through["diffuseTransmissionColorFactor"], [1.0; 3]).clamp(Rgb::ZERO, Rgb::ONE);
        let amounts = self.bitmap(&through["diffuseTransmissionTexture"], true, Channel::Alpha, Rgb::splat(amount))?;
        let colors = self.bitmap(&through["diffuseTransmissionColorTexture"], false, Channel::Rgb, color)?;
        Ok(Model::ThinPrincipled(Box::new(ThinPrincipled {
            base_color,
            transmission_color: colors.unwrap_or_else(|| self.builder.constant(color)),
            diff_trans: amounts.unwrap_or_else(|| self.builder.constant(Rgb::splat(amount))),
            eta: p.eta,
            roughness: p.roughness,
            metallic: p.metallic,
        })))
    }

    fn specular_glossiness(&mut self, old: &Value, base_color: TextureId) -> Model {
        let gloss = old["glossinessFactor"].as_f64().unwrap_or(1.0).clamp(0.0, 1.0) as f32;
        let f0 = vector3(&old["specularFactor"], [1.0; 3]);
        let zero = self.builder.constant(Rgb::ZERO);
        Model::Principled(Box::new(Principled {
            base_color,
            roughness: self.builder.constant(Rgb::splat(1.0 - gloss)),
            anisotropic: zero,
            metallic: zero,
            spec_trans: zero,
            eta: eta_of_reflectance(f0.element_sum() / 3.0),
            spec_tint: zero,
            sheen: zero,
            sheen_tint: zero,
            flatness: zero,
            clearcoat: zero,
            clearcoat_gloss: zero,
        }))
    }

    /// Sheets let light through without refraction; everything else is the same from both sides unless it transmits.
    fn transmitting(&mut self, source: &Value, model: Model, base_color: TextureId, name: &str) -> Result<MaterialId> {
        let extensions = &source["extensions"];
        let through = &extensions["KHR_materials_transmission"];
        let amount = through["transmissionFactor"].as_f64().unwrap_or(0.0).clamp(0.0, 1.0) as f32;
        let solid = extensions["KHR_materials_volume"]["thicknessFactor"].as_f64().unwrap_or(0.0) > 0.0;
        let first = self.builder.material(name, model);
        let translucent = matches!(self.builder.scene.materials[first.0].model, Model::Subsurface(_));
        if amount > 0.0 && solid || translucent {
            return Ok(first); // inside and outside differ
        }
        // A sheet knows no sides.
        let both = match self.builder.scene.materials[first.0].model {
            Model::ThinPrincipled(_) => first,
            _ => self.builder.material(name, Model::TwoSided { front: first, back: first }),
        };
        if amount == 0.0 {
            return Ok(both);
        }
        let weight = match self.bitmap(&through["transmissionTexture"], true, Channel::Red, Rgb::splat(amount))? {
            Some(id) => id,
            None => self.builder.constant(Rgb::splat(amount)),
        };
        let white = self.builder.constant(Rgb::ONE);
        let sheet = Model::ThinDielectric(Dielectric {
            eta: index_of_refraction(extensions, 1.0),
            specular_reflectance: white,
            specular_transmittance: base_color,
        });
        let second = self.builder.material(name, sheet);
        Ok(self.builder.material(name, Model::Blend { weight, first: both, second }))
    }

    fn bumped(&mut self, source: &Value, name: &str, nested: MaterialId) -> Result<MaterialId> {
        let texture = &source["normalTexture"];
        let Some(normals) = self.bitmap(texture, true, Channel::Rgb, Rgb::ONE)? else { return Ok(nested) };
        let scale = texture["scale"].as_f64().unwrap_or(1.0) as f32;
        Ok(self.builder.material(name, Model::NormalMap { normals, scale, nested }))
    }

    fn masked(
        &mut self,
        source: &Value,
        base: &Value,
        factor: f32,
        name: &str,
        nested: MaterialId,
    ) -> Result<MaterialId> {
        let mode = source["alphaMode"].as_str().unwrap_or("OPAQUE");
        if mode == "OPAQUE" {
            return Ok(nested);
        }
        let cutoff = (mode == "MASK").then(|| source["alphaCutoff"].as_f64().unwrap_or(0.5) as f32);
        let picture = self.bitmap(base, false, Channel::Alpha, Rgb::splat(factor))?;
        let opacity = match (picture.map(|id| self.builder.scene.textures[id.0].clone()), cutoff) {
            (Some(Texture::Bitmap(bitmap)), _) if bitmap.image.alpha.is_none() && factor >= 1.0 => return Ok(nested),
            (Some(Texture::Bitmap(bitmap)), Some(cutoff)) => {
                let image = Arc::new(threshold(&bitmap.image, cutoff / factor.max(1e-6)));
                let opacity = Bitmap { image, channel: Channel::Rgb, scale: Rgb::ONE, ..bitmap };
                self.builder.texture(Texture::Bitmap(opacity))
            }
            (Some(texture), _) => self.builder.texture(texture),
            (None, Some(cutoff)) => self.builder.constant(if factor >= cutoff { Rgb::ONE } else { Rgb::ZERO }),
            (None, None) => self.builder.constant(Rgb::splat(factor.clamp(0.0, 1.0))),
        };
        if self.builder.scene.constant(opacity) == Some(Rgb::ONE) {
            return Ok(nested);
        }
        Ok(self.builder.material(name, Model::Mask { opacity, nested }))
    }

    fn emission(&mut self, source: &Value) -> Result<Option<TextureId>> {
        let strength = &source["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"];
        let factor = vector3(&source["emissiveFactor"], [0.0; 3]) * strength.as_f64().unwrap_or(1.0) as f32;
        if !(factor.max_element() > 0.0 && factor.is_finite()) {
            return Ok(None);
        }
        let factor = factor.max(Rgb::ZERO);
        match self.bitmap(&source["emissiveTexture"], false, Channel::Rgb, factor)? {
            Some(id) => Ok(Some(id)),
            None => Ok(Some(self.builder.constant(factor))),
        }
    }

    /// The absorbing inside of a solid.
    fn interior(&mut self, source: &Value, name: &str) -> Option<MediumId> {
        let volume = &source["extensions"]["KHR_materials_volume"];
        let distance = volume["attenuationDistance"].as_f64().filter(|d| *d > 0.0 && d.is_finite())? as f32;
        volume["thicknessFactor"].as_f64().filter(|t| *t > 0.0)?;
        let extensions = &source["extensions"];
        let diffuse = extensions["KHR_materials_diffuse_transmission"]["diffuseTransmissionFactor"].as_f64();
        if diffuse.is_some_and(|f| f > 0.0) || !extensions["KHR_materials_volume_scatter"].is_null() {
            return None; // part of how light spreads
        }
        let color = vector3(&volume["attenuationColor"], [1.0; 3]).clamp(Rgb::splat(1e-6), Rgb::ONE);
        let sigma_t = Rgb::from(color.to_array().map(|c| -c.ln() / distance));
        if sigma_t == Rgb::ZERO {
            return None;
        }
        self.builder.scene.media.push(Medium {
            name: name.to_owned(),
            sigma_t: Volume::Constant(sigma_t),
            albedo: Volume::Constant(Rgb::ZERO),
            scale: 1.0,
            phase: Phase::Isotropic,
        });
        Some(MediumId(self.builder.scene.media.len() - 1))
    }

    /// The texture that a texture reference names, `None` when there is no reference.
    fn bitmap(&mut self, reference: &Value, raw: bool, channel: Channel, scale: Rgb) -> Result<Option<TextureId>> {
        if reference.is_null() {
            return Ok(None);
        }
        let transform = &reference["extensions"]["KHR_texture_transform"];
        let set = transform["texCoord"].as_f64().or(reference["texCoord"].as_f64()).unwrap_or(0.0);
        if set != 0.0 {
            self.warn_once("textures use the first set of coordinates, though a material asks for another".to_owned());
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
            Some(uri) if !uri.starts_with("data:") => {
                let path = self.asset.file(uri).map_err(Error::from).map_err(fault)?;
                self.builder.image(&path, raw)
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

/// 1 where the alpha of `image` reaches `cutoff`, 0 elsewhere.
fn threshold(image: &Picture, cutoff: f32) -> Picture {
    let (width, height) = image.pixels.dimensions();
    let step = |a: f32| if a >= cutoff { 1.0 } else { 0.0 };
    let opaque = step(1.0);
    let pixels = Rgb32FImage::from_fn(width, height, |x, y| {
        let alpha = image.alpha.as_ref().and_then(|a| a.get(y as usize * width as usize + x as usize));
        [alpha.map_or(opaque, |&a| step(a)); 3].into()
    });
    Picture::new(pixels)
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

/// From the extensions for it; `specular` scales the reflectance at normal incidence.
fn index_of_refraction(extensions: &Value, specular: f32) -> f32 {
    let ior = extensions["KHR_materials_ior"]["ior"].as_f64().unwrap_or(1.5) as f32;
    let f0 = ((ior - 1.0) / (ior + 1.0)).powi(2);
    eta_of_reflectance(f0 * specular)
}

/// The index with this reflectance at normal incidence, kept off 1 and off infinity.
fn eta_of_reflectance(f0: f32) -> f32 {
    let r = f0.clamp(0.0, 0.9).sqrt();
    ((1.0 + r) / (1.0 - r)).max(1.001)
}
