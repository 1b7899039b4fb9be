//! Materials and textures.

use super::Loader;
use super::lexer::{self, Place, Values};
use super::parameters::Parameters;
use crate::Result;
use crate::material::{BendLimits, Conductor, Dielectric, Model, NormalAxes, Plastic, Roughness, Subsurface};
use crate::scene::{MaterialId, TextureId};
use crate::spectrum::Quantity;
use crate::texture::{Bitmap, Channel, Checkerboard, Filter, Texture, Wrap};
use glam::{DAffine2, DVec2};
use std::sync::Arc;
use translume_bxdf::homogeneous::{Diffusion, Homogeneous, measured_by_name};
use translume_bxdf::{Distribution, Rgb, metal_by_name};

const FACTOR: Quantity = Quantity::Factor;

impl Loader {
    pub(super) fn named_material(&mut self, name: &str, p: &Parameters) -> Result<()> {
        let kind = p.text("type")?.ok_or_else(|| p.place.invalid(format!("material {name:?} has no \"type\"")))?;
        let id = self.material(kind, name, p)?;
        self.materials.insert(name.to_owned(), id);
        Ok(())
    }

    /// A material of `kind`. Those that do not transmit look the same from both sides.
    pub(super) fn material(&mut self, kind: &str, name: &str, p: &Parameters) -> Result<MaterialId> {
        let (model, two_sided) = match kind {
            "interface" | "" | "none" => (Model::Null, false),
            "diffuse" => (Model::Diffuse { reflectance: self.given(p, "reflectance", 0.5)? }, true),
            "diffusetransmission" => (self.diffuse_transmission(p)?, false),
            "conductor" => (self.conductor(p)?, true),
            "dielectric" => (self.dielectric(p)?, false),
            "thindielectric" => (Model::ThinDielectric(self.glass(p)?), false),
            "coateddiffuse" => (self.coated(p)?, true),
            "mix" => (self.mix(p)?, false),
            "measured" => (self.measured(p)?, true),
            "subsurface" => (self.subsurface(p)?, false),
            _ => return Err(p.place.unsupported(format!("material {kind:?} is not supported"))),
        };
        let mut id = self.builder.material(name, model);
        if two_sided {
            id = self.builder.material(name, Model::TwoSided { front: id, back: id });
        }
        if let Some(file) = p.text("normalmap")? {
            let normals = self.bitmap(file, &p.place, true, DAffine2::IDENTITY, Rgb::ONE, Wrap::Repeat)?;
            id = self.builder.material(
                name,
                Model::NormalMap {
                    normals,
                    scale: 1.0,
                    axes: NormalAxes::RightHanded,
                    limits: BendLimits::default(),
                    nested: id,
                },
            );
        }
        if let Some(texture) = p.texture("displacement") {
            let height = self.named_texture(texture, &p.place)?;
            id = self
                .builder
                .material(name, Model::BumpMap { height, scale: 1.0, limits: BendLimits::default(), nested: id });
        }
        let _ = p.get("type");
        self.finish(kind, p);
        Ok(id)
    }

    fn named_texture(&self, name: &str, place: &Place) -> Result<TextureId> {
        self.textures.get(name).copied().ok_or_else(|| place.invalid(format!("there is no texture {name:?}")))
    }

    /// A texture or colour by parameter name.
    pub(super) fn optional(&mut self, p: &Parameters, name: &str) -> Result<Option<TextureId>> {
        if let Some(texture) = p.texture(name) {
            return self.named_texture(texture, &p.place).map(Some);
        }
        Ok(p.color(name, FACTOR)?.map(|rgb| self.builder.constant(rgb)))
    }

    fn given(&mut self, p: &Parameters, name: &str, default: f32) -> Result<TextureId> {
        match self.optional(p, name)? {
            Some(id) => Ok(id),
            None => Ok(self.builder.constant(Rgb::splat(default))),
        }
    }

    /// The roughness, `None` for a smooth surface. Numbers are taken to alpha by the square root, unless the file says no.
    fn roughness(&mut self, p: &Parameters) -> Result<Option<Roughness>> {
        let remap = p.boolean("remaproughness", true)?;
        let both = self.given(p, "roughness", 0.0)?;
        let along = self.optional(p, "uroughness")?.unwrap_or(both);
        let across = self.optional(p, "vroughness")?.unwrap_or(both);
        let mut alpha = |id: TextureId| match self.builder.scene.constant(id) {
            Some(r) if remap => Ok(self.builder.constant(Rgb::splat(r.x.sqrt()))),
            None if remap => Err(p.place.unsupported("a roughness texture with \"remaproughness\"")),
            _ => Ok(id),
        };
        let (alpha_u, alpha_v) = (alpha(along)?, alpha(across)?);
        let smooth = |id| self.builder.scene.constant(id).is_some_and(|a| a.x < 1e-3);
        let rough = !(smooth(alpha_u) && smooth(alpha_v));
        Ok(rough.then_some(Roughness { distribution: Distribution::Ggx, alpha_u, alpha_v }))
    }

    fn diffuse_transmission(&mut self, p: &Parameters) -> Result<Model> {
        let scale = Rgb::splat(p.number("scale", 1.0)? as f32);
        let (r, t) = (self.given(p, "reflectance", 0.25)?, self.given(p, "transmittance", 0.25)?);
        Ok(Model::DiffuseTransmission {
            reflectance: self.builder.scaled(r, scale),
            transmittance: self.builder.scaled(t, scale),
        })
    }

    fn conductor(&mut self, p: &Parameters) -> Result<Model> {
        let white = self.builder.constant(Rgb::ONE);
        let (eta, k) = match p.color("reflectance", FACTOR)? {
            Some(r) => {
                // The metal of index 1 that reflects so much.
                let k = r.min(Rgb::splat(0.9999)).map(|r| 2.0 * (r / (1.0 - r)).sqrt());
                (self.builder.constant(Rgb::ONE), self.builder.constant(k))
            }
            None => {
                let copper = metal_by_name("Cu").unwrap_or_default();
                let eta = self.optional(p, "eta")?;
                let k = self.optional(p, "k")?;
                let mut known = |id: Option<TextureId>, rgb| id.unwrap_or_else(|| self.builder.constant(rgb));
                (known(eta, copper.eta), known(k, copper.k))
            }
        };
        let conductor = Conductor { eta, k, specular_reflectance: white };
        Ok(match self.roughness(p)? {
            Some(roughness) => Model::RoughConductor { conductor, roughness },
            None => Model::Conductor(conductor),
        })
    }

    fn glass(&mut self, p: &Parameters) -> Result<Dielectric> {
        let eta = p.color("eta", FACTOR)?.map_or(1.5, |eta| eta.element_sum() / 3.0);
        if eta <= 0.0 {
            return Err(p.place.invalid("\"eta\" is not above 0"));
        }
        let white = self.builder.constant(Rgb::ONE);
        Ok(Dielectric { eta, specular_reflectance: white, specular_transmittance: white })
    }

    fn dielectric(&mut self, p: &Parameters) -> Result<Model> {
        let dielectric = self.glass(p)?;
        Ok(match self.roughness(p)? {
            Some(roughness) => Model::RoughDielectric { dielectric, roughness },
            None => Model::Dielectric(dielectric),
        })
    }

    /// pbrt follows light between coat and base at random; the closed form for a thin coat comes close.
    fn coated(&mut self, p: &Parameters) -> Result<Model> {
        for name in ["thickness", "maxdepth", "nsamples"] {
            let _ = p.get(name);
        }
        if p.color("albedo", FACTOR)?.is_some_and(|a| a != Rgb::ZERO) {
            self.builder.warn(p.place.warning("scattering inside the coat is not used"));
        }
        let plastic = Plastic {
            eta: self.glass(p)?.eta,
            diffuse_reflectance: self.given(p, "reflectance", 0.5)?,
            specular_reflectance: self.builder.constant(Rgb::ONE),
            nonlinear: true,
        };
        let Some(Roughness { distribution, alpha_u, alpha_v }) = self.roughness(p)? else {
            return Ok(Model::Plastic(plastic));
        };
        let alphas = self.builder.scene.constant(alpha_u).zip(self.builder.scene.constant(alpha_v));
        let Some((u, v)) = alphas else {
            return Err(p.place.unsupported("a roughness texture on \"coateddiffuse\""));
        };
        Ok(Model::RoughPlastic { plastic, distribution, alpha: (u.x * v.x).sqrt() })
    }

    /// pbrt's own numbers are a photon beam diffusion; here it is the dipole for the same coefficients, per mm times `scale`.
    fn subsurface(&mut self, p: &Parameters) -> Result<Model> {
        let invalid = |what: String| p.place.invalid(what);
        let scale = p.number("scale", 1.0)? as f32;
        let isotropy = 1.0 - p.number("g", 0.0)? as f32;
        if p.texture("reflectance").or(p.texture("sigma_a")).or(p.texture("sigma_s")).or(p.texture("mfp")).is_some() {
            return Err(p.place.unsupported("textures of a subsurface material"));
        }
        let color = |name: &str| p.color(name, FACTOR);
        let (reflectance, path) = (color("reflectance")?, color("mfp")?);
        let coefficients = (color("sigma_s")?, color("sigma_a")?);
        let eta = p.color("eta", FACTOR)?.map(|eta| eta.element_sum() / 3.0);
        let (model, eta) = match (p.text("name")?, reflectance, coefficients) {
            (Some(name), ..) => {
                let ([s, a], _) = measured_by_name(name).ok_or_else(|| {
                    invalid(format!("the translucent material {name:?} is not known; give sigma_a and sigma_s"))
                })?;
                let eta = eta.unwrap_or(1.33);
                (Homogeneous::new(Diffusion::Dipole, s * scale, a * scale, eta), eta)
            }
            (None, Some(r), _) => {
                let (path, eta) = (path.unwrap_or(Rgb::ONE) / scale, eta.unwrap_or(1.33));
                (Homogeneous::from_reflectance(Diffusion::Dipole, r, path, eta), eta)
            }
            (None, None, (s, a)) => {
                let (s, a) = (s.unwrap_or(Rgb::new(2.55, 3.21, 3.77)), a.unwrap_or(Rgb::new(0.0011, 0.0024, 0.014)));
                let eta = eta.unwrap_or(1.33);
                (Homogeneous::new(Diffusion::Dipole, s * isotropy * scale, a * scale, eta), eta)
            }
        };
        let model =
            model.ok_or_else(|| invalid("the coefficients of a subsurface are no scattering material".into()))?;
        let roughness = match self.roughness(p)? {
            None => None,
            Some(Roughness { distribution, alpha_u, alpha_v }) => {
                let alphas = self.builder.scene.constant(alpha_u).zip(self.builder.scene.constant(alpha_v));
                let (u, v) = alphas.ok_or_else(|| p.place.unsupported("a roughness texture on \"subsurface\""))?;
                Some((distribution, (u.x * v.x).sqrt()))
            }
        };
        Ok(Model::Subsurface(Box::new(Subsurface {
            model: Arc::new(model),
            mm_per_unit: 1.0,
            in_object_space: false,
            eta,
            roughness,
            specular_reflectance: self.builder.constant(Rgb::ONE),
        })))
    }

    fn mix(&mut self, p: &Parameters) -> Result<Model> {
        let names = match p.get("materials").map(|m| &m.values) {
            Some(Values::Texts(names)) if names.len() == 2 => names,
            _ => return Err(p.place.invalid("\"materials\" of a mix are not two names")),
        };
        let find = |name: &String| {
            let unknown = || p.place.invalid(format!("there is no material {name:?}"));
            self.materials.get(name).copied().ok_or_else(unknown)
        };
        let (first, second) = (find(&names[0])?, find(&names[1])?);
        Ok(Model::Blend { weight: self.given(p, "amount", 0.5)?, first, second })
    }

    /// `Texture "name" "type" "class" parameters`.
    pub(super) fn texture(&mut self, place: Place) -> Result<()> {
        let lexer = self.lexer()?;
        let name = lexer.text("a name")?;
        let _float_or_spectrum = lexer.text("a type")?;
        let class = lexer.text("a class")?;
        let p = Parameters { list: lexer::parameters(lexer)?, place };
        let id = match self.make_texture(&class, &p) {
            Err(e) if self.builder.options.lenient => {
                self.builder.warn(format!("{e}; gray instead"));
                self.builder.constant(Rgb::splat(0.5))
            }
            made => made?,
        };
        self.textures.insert(name, id);
        self.finish(&class, &p);
        Ok(())
    }

    fn make_texture(&mut self, class: &str, p: &Parameters) -> Result<TextureId> {
        let scale =
            Rgb::splat(p.number("scale", 1.0).or_else(|e| if class == "scale" { Ok(1.0) } else { Err(e) })? as f32);
        match class {
            "constant" => self.given(p, "value", 1.0),
            "imagemap" => {
                if p.boolean("invert", false)? {
                    return Err(p.place.unsupported("\"invert\" of an imagemap is not supported"));
                }
                let file = p.text("filename")?.ok_or_else(|| p.place.invalid("an imagemap has no \"filename\""))?;
                let raw = p.text("encoding")? == Some("linear");
                let wrap = match p.text("wrap")? {
                    None | Some("repeat") => Wrap::Repeat,
                    Some("black") => Wrap::Zero,
                    Some("clamp") => Wrap::Clamp,
                    Some(other) => return Err(p.place.invalid(format!("{other:?} is no way to wrap a texture"))),
                };
                let _ = (p.get("filter"), p.get("maxanisotropy"));
                let mapping = self.mapping(p)?;
                self.bitmap(file, &p.place, raw, mapping, scale, wrap)
            }
            "scale" => {
                let inner = self.given(p, "tex", 1.0)?;
                let factor = self.given(p, "scale", 1.0)?;
                match self.builder.scene.constant(factor) {
                    Some(f) => Ok(self.builder.scaled(inner, f)),
                    None => Err(p.place.unsupported("\"scale\" of a texture is a constant")),
                }
            }
            "checkerboard" if p.integer("dimension", 2)? == 2 => {
                let board = Checkerboard {
                    color0: self.given(p, "tex1", 1.0)?,
                    color1: self.given(p, "tex2", 0.0)?,
                    board_from_uv: DAffine2::from_scale(DVec2::splat(0.5)) * self.mapping(p)?,
                };
                self.builder.checkerboard(board).ok_or_else(|| p.place.unsupported("textures nest too deep"))
            }
            _ => Err(p.place.unsupported(format!("texture {class:?} is not supported"))),
        }
    }

    /// A file of RGL's material database.
    fn measured(&mut self, p: &Parameters) -> Result<Model> {
        let file = p.text("filename")?.ok_or_else(|| p.place.invalid("a measured material has no \"filename\""))?;
        self.builder.measured(&self.folder.join(file)).map_err(|e| e.at(&p.place.file, p.place.line))
    }

    /// Texture coordinates by the parameters of a "uv" mapping.
    fn mapping(&mut self, p: &Parameters) -> Result<DAffine2> {
        if let Some(other) = p.text("mapping")?.filter(|m| *m != "uv") {
            return Err(p.place.unsupported(format!("mapping {other:?} of a texture is not supported")));
        }
        let scale = DVec2::new(p.number("uscale", 1.0)?, p.number("vscale", 1.0)?);
        let delta = DVec2::new(p.number("udelta", 0.0)?, p.number("vdelta", 0.0)?);
        Ok(DAffine2::from_scale_angle_translation(scale, 0.0, delta))
    }

    fn bitmap(
        &mut self,
        file: &str,
        place: &Place,
        raw: bool,
        mapping: DAffine2,
        scale: Rgb,
        wrap: Wrap,
    ) -> Result<TextureId> {
        let path = self.folder.join(file);
        let image = self.builder.image(&path, raw).map_err(|e| e.at(&place.file, place.line))?;
        let flip = DAffine2::from_cols(DVec2::X, DVec2::NEG_Y, DVec2::Y);
        Ok(self.builder.texture(Texture::Bitmap(Bitmap {
            image,
            set: 0,
            image_from_uv: flip * mapping,
            filter: Filter::Bilinear,
            wrap: [wrap; 2],
            channel: Channel::Rgb,
            scale,
        })))
    }
}
