//! glTF materials: metallic roughness with its extensions, specular glossiness, unlit ones; alpha and emission.
//!
//! Transmission without thickness is a thin sheet, with thickness a solid whose absorption is a medium inside. Alpha is a mask, over
//! what shines as well; with a cutoff it is 0 or 1 at each point. Unlit materials shine with their base colour and reflect
//! nothing. Diffuse transmission is a sheet; into a volume it is translucent, as volumes that scatter (a draft) are: see
//! `translucent`.

use super::{Dress, Loader, Vertices, vector3};
use crate::Result;
use crate::material::{BendLimits, MetalRough, Model, NormalAxes};
use crate::scene::{MaterialId, TextureId};
use crate::texture::{Channel, Texture};
use serde_json::Value;
use translume_bxdf::Rgb;

/// What the base colour's texture, factor and vertex colours say together.
struct Base {
    color: TextureId,
    /// `None`: opaque.
    opacity: Option<TextureId>,
}

impl Loader {
    /// What material number `index` becomes on a mesh with such vertices; the default material for `None`.
    pub(super) fn material(&mut self, index: Option<usize>, vertices: Vertices) -> Result<Dress> {
        if let Some(&dress) = self.materials.get(&(index, vertices)) {
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
        self.sets = vertices.sets;
        let base = self.base(&source, vertices)?;
        let is_unlit = !source["extensions"]["KHR_materials_unlit"].is_null();
        let (surface, radiance, interior) = if is_unlit {
            let black = self.builder.constant(Rgb::ZERO);
            let nothing = self.builder.material(&name, Model::Diffuse { reflectance: black });
            (nothing, (base.color != black).then_some(base.color), None)
        } else {
            let surface = self.surface(&source, &name, base.color)?;
            (surface, self.emission(&source)?, self.interior(&source, &name))
        };
        let material = match base.opacity {
            Some(opacity) => self.builder.material(&name, Model::Mask { opacity, nested: surface }),
            None => surface,
        };
        let radiance = match (radiance, base.opacity) {
            (Some(radiance), Some(opacity)) => Some(self.builder.product(radiance, opacity)),
            (radiance, _) => radiance,
        };
        let dress = Dress { material, radiance, shines_behind: source["doubleSided"] == true, interior };
        self.materials.insert((index, vertices), dress);
        Ok(dress)
    }

    /// Texture times factor times vertex colours (glTF 2.0, §3.9.2), and what of it is there (§3.9.4).
    fn base(&mut self, source: &Value, vertices: Vertices) -> Result<Base> {
        let old = &source["extensions"]["KHR_materials_pbrSpecularGlossiness"];
        let pbr = &source["pbrMetallicRoughness"];
        let (texture, factors) = match old.is_null() {
            true => (&pbr["baseColorTexture"], &pbr["baseColorFactor"]),
            false => (&old["diffuseTexture"], &old["diffuseFactor"]),
        };
        let factor = vector3(factors, [1.0; 3]).max(Rgb::ZERO);
        let mut color = self.varied(texture, false, Channel::Rgb, factor)?;
        if vertices.colors {
            let vertex = self.builder.texture(Texture::VertexColor(Rgb::ONE));
            color = self.builder.product(color, vertex);
        }
        let mode = source["alphaMode"].as_str().unwrap_or("OPAQUE");
        if mode == "OPAQUE" {
            return Ok(Base { color, opacity: None });
        }
        let factor = factors[3].as_f64().unwrap_or(1.0).clamp(0.0, 1.0) as f32;
        let mut opacity = self.varied(texture, false, Channel::Alpha, Rgb::splat(factor))?;
        if matches!(&self.builder.scene.textures[opacity.0], Texture::Bitmap(b) if b.image.alpha.is_none()) {
            opacity = self.builder.constant(Rgb::splat(factor));
        }
        if vertices.alphas {
            let vertex = self.builder.texture(Texture::VertexAlpha);
            opacity = self.builder.product(opacity, vertex);
        }
        if mode == "MASK" {
            opacity = self.builder.threshold(opacity, source["alphaCutoff"].as_f64().unwrap_or(0.5) as f32);
        }
        let opaque = self.builder.scene.constant(opacity) == Some(Rgb::ONE);
        Ok(Base { color, opacity: (!opaque).then_some(opacity) })
    }

    /// A texture times a factor; the factor alone where there is no texture.
    fn varied(&mut self, texture: &Value, raw: bool, channel: Channel, factor: Rgb) -> Result<TextureId> {
        match self.bitmap(texture, raw, channel, factor)? {
            Some(id) => Ok(id),
            None => Ok(self.builder.constant(factor)),
        }
    }

    /// The same for a number of `source`, from 0 to 1.
    fn number(&mut self, source: &Value, factor: &str, missing: f64, texture: &str, of: Channel) -> Result<TextureId> {
        let factor = source[factor].as_f64().unwrap_or(missing).clamp(0.0, 1.0) as f32;
        self.varied(&source[texture], true, of, Rgb::splat(factor))
    }

    fn surface(&mut self, source: &Value, name: &str, base_color: TextureId) -> Result<MaterialId> {
        let (extensions, pbr) = (&source["extensions"], &source["pbrMetallicRoughness"]);
        let old = &extensions["KHR_materials_pbrSpecularGlossiness"];
        let made = if !old.is_null() {
            let others = ["diffuse_transmission", "transmission", "specular", "ior", "volume"];
            for other in others.iter().filter(|o| !extensions[format!("KHR_materials_{o}")].is_null()) {
                let what = format!("has specular glossiness, which no KHR_materials_{other} goes with; it is left out");
                self.warn_once(format!("material {name:?} {what}"));
            }
            let model = self.specular_glossiness(old, extensions, base_color)?;
            self.builder.material(name, Model::MetalRough(Box::new(model)))
        } else if let Some(model) = self.translucent(extensions, pbr, base_color, name)? {
            self.under_clear(source, model, base_color, name)?
        } else {
            let model = self.metal_rough(pbr, extensions, base_color)?;
            self.builder.material(name, Model::MetalRough(Box::new(model)))
        };
        self.bumped(source, name, made)
    }

    /// Metallic roughness with transmission, index of refraction, specular and clear coat.
    pub(super) fn metal_rough(&mut self, pbr: &Value, extensions: &Value, base_color: TextureId) -> Result<MetalRough> {
        let metallic = self.number(pbr, "metallicFactor", 1.0, "metallicRoughnessTexture", Channel::Blue)?;
        let roughness = self.number(pbr, "roughnessFactor", 1.0, "metallicRoughnessTexture", Channel::Green)?;
        // 0 stands for an index beyond all bounds, which reflects everything.
        let ior =
            extensions["KHR_materials_ior"]["ior"].as_f64().filter(|n| *n == 0.0 || *n >= 1.0).unwrap_or(1.5) as f32;
        let specular = &extensions["KHR_materials_specular"];
        let f0 =
            ((ior - 1.0) / (ior + 1.0)).powi(2) * vector3(&specular["specularColorFactor"], [1.0; 3]).max(Rgb::ZERO);
        let f0 = self.varied(&specular["specularColorTexture"], false, Channel::Rgb, f0)?;
        let specular = self.number(specular, "specularFactor", 1.0, "specularTexture", Channel::Alpha)?;
        let through = &extensions["KHR_materials_transmission"];
        let transmission = self.number(through, "transmissionFactor", 0.0, "transmissionTexture", Channel::Red)?;
        // What nothing gets into is alike from both sides.
        let solid = extensions["KHR_materials_volume"]["thicknessFactor"].as_f64().unwrap_or(0.0) > 0.0
            && self.builder.scene.constant(transmission) != Some(Rgb::ZERO);
        let (coat, coat_roughness, coat_normals) = self.coat(extensions)?;
        Ok(MetalRough {
            base_color,
            metallic,
            roughness,
            f0,
            specular,
            f0_dims_base: false,
            transmission,
            solid: solid.then_some(ior.max(1.0)),
            coat,
            coat_roughness,
            coat_normals,
        })
    }

    fn specular_glossiness(&mut self, old: &Value, extensions: &Value, base_color: TextureId) -> Result<MetalRough> {
        let factor = vector3(&old["specularFactor"], [1.0; 3]).clamp(Rgb::ZERO, Rgb::ONE);
        let f0 = self.varied(&old["specularGlossinessTexture"], false, Channel::Rgb, factor)?;
        let gloss = self.number(old, "glossinessFactor", 1.0, "specularGlossinessTexture", Channel::Alpha)?;
        let (coat, coat_roughness, coat_normals) = self.coat(extensions)?;
        let [zero, one] = [Rgb::ZERO, Rgb::ONE].map(|rgb| self.builder.constant(rgb));
        Ok(MetalRough {
            base_color,
            metallic: zero,
            roughness: self.builder.complement(gloss),
            f0,
            specular: one,
            f0_dims_base: true,
            transmission: zero,
            solid: None,
            coat,
            coat_roughness,
            coat_normals,
        })
    }

    /// Strength, roughness and normals of the clear coat.
    #[allow(clippy::type_complexity, reason = "three textures of one layer")]
    fn coat(&mut self, extensions: &Value) -> Result<(TextureId, TextureId, Option<(TextureId, f32)>)> {
        let coat = &extensions["KHR_materials_clearcoat"];
        let strength = self.number(coat, "clearcoatFactor", 0.0, "clearcoatTexture", Channel::Red)?;
        let roughness =
            self.number(coat, "clearcoatRoughnessFactor", 0.0, "clearcoatRoughnessTexture", Channel::Green)?;
        let texture = &coat["clearcoatNormalTexture"];
        let normals = self.bitmap(texture, true, Channel::Rgb, Rgb::ONE)?;
        let scale = texture["scale"].as_f64().unwrap_or(1.0) as f32;
        Ok((strength, roughness, normals.map(|id| (id, scale))))
    }

    /// A sheet that transmits diffusely, with clear transmission over it if there is such; solids as they are.
    fn under_clear(&mut self, source: &Value, model: Model, base: TextureId, name: &str) -> Result<MaterialId> {
        let (extensions, pbr) = (&source["extensions"], &source["pbrMetallicRoughness"]);
        let is_sheet = matches!(model, Model::ThinPrincipled(_));
        let first = self.builder.material(name, model);
        let clear = self.metal_rough(pbr, extensions, base)?;
        if !is_sheet || self.builder.scene.constant(clear.transmission) == Some(Rgb::ZERO) {
            return Ok(first);
        }
        let (weight, transmission) = (clear.transmission, self.builder.constant(Rgb::ONE));
        let over = MetalRough { transmission, ..clear };
        let second = self.builder.material(name, Model::MetalRough(Box::new(over)));
        Ok(self.builder.material(name, Model::Blend { weight, first, second }))
    }

    fn bumped(&mut self, source: &Value, name: &str, nested: MaterialId) -> Result<MaterialId> {
        let texture = &source["normalTexture"];
        let Some(normals) = self.bitmap(texture, true, Channel::Rgb, Rgb::ONE)? else { return Ok(nested) };
        let scale = texture["scale"].as_f64().unwrap_or(1.0) as f32;
        let axes = NormalAxes::OfPicture;
        Ok(self
            .builder
            .material(name, Model::NormalMap { normals, scale, axes, limits: BendLimits::default(), nested }))
    }

    fn emission(&mut self, source: &Value) -> Result<Option<TextureId>> {
        let strength = &source["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"];
        let factor = vector3(&source["emissiveFactor"], [0.0; 3]) * strength.as_f64().unwrap_or(1.0) as f32;
        if !(factor.max_element() > 0.0 && factor.is_finite()) {
            return Ok(None);
        }
        self.varied(&source["emissiveTexture"], false, Channel::Rgb, factor.max(Rgb::ZERO)).map(Some)
    }
}
