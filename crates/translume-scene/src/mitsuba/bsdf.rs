//! BSDFs.

use super::Loader;
use super::object::{Object, Value};
use crate::Result;
use crate::material::{
    BendLimits, Conductor, Dielectric, Model, NormalAxes, Plastic, Principled, Roughness, ThinPrincipled,
};
use crate::scene::{MaterialId, TextureId};
use crate::spectrum::Quantity;
use std::rc::Rc;
use translume_bxdf::{AIR, BK7, Distribution, POLYPROPYLENE, Rgb, ior_by_name, metal_by_name};

const FACTOR: Quantity = Quantity::Factor;
const NUMBER: Quantity = Quantity::Number;

impl Loader {
    pub(super) fn bsdf(&mut self, object: &Rc<Object>) -> Result<MaterialId> {
        if let Some(&id) = self.materials.get(&Rc::as_ptr(object)) {
            self.asked.extend(self.attributes_of.get(&id).into_iter().flatten().cloned());
            return Ok(id);
        }
        let asked = std::mem::take(&mut self.asked);
        let made = self.guarded(object, |loader| {
            let model = loader.model(object)?;
            loader.finish(object)?;
            Ok(model)
        });
        let id = match made {
            Err(e) if self.builder.options.lenient => {
                self.builder.warn(format!("{e}; gray instead"));
                self.builder.gray(0.5)
            }
            model => {
                let model = model?;
                self.builder.material(&object.id, model)
            }
        };
        self.materials.insert(Rc::as_ptr(object), id);
        self.attributes_of.insert(id, self.asked.clone());
        self.asked.extend(asked);
        Ok(id)
    }

    fn model(&mut self, object: &Rc<Object>) -> Result<Model> {
        Ok(match object.plugin.as_str() {
            "null" => Model::Null,
            "diffuse" | "roughdiffuse" => {
                if object.plugin == "roughdiffuse" {
                    self.builder.warn(object.place.warning("\"roughdiffuse\" is taken as \"diffuse\""));
                    let _ = (object.property("alpha"), object.property("use_fast_approx"));
                }
                Model::Diffuse { reflectance: self.albedo(object, "reflectance", 0.5)? }
            }
            "difftrans" => Model::DiffuseTransmission {
                reflectance: self.builder.constant(Rgb::ZERO),
                transmittance: self.albedo(object, "transmittance", 0.5)?,
            },
            "dielectric" => Model::Dielectric(self.dielectric(object, BK7)?),
            "thindielectric" => Model::ThinDielectric(self.dielectric(object, BK7)?),
            "roughdielectric" => {
                Model::RoughDielectric { dielectric: self.dielectric(object, BK7)?, roughness: self.roughness(object)? }
            }
            "conductor" => Model::Conductor(self.conductor(object)?),
            "roughconductor" => {
                Model::RoughConductor { conductor: self.conductor(object)?, roughness: self.roughness(object)? }
            }
            "plastic" => Model::Plastic(self.plastic(object)?),
            "roughplastic" => self.rough_plastic(object)?,
            "principled" => self.principled(object)?,
            "principledthin" => self.principled_thin(object)?,
            "measured" => {
                let path = self.file(object, "filename")?;
                self.builder.measured(&path).map_err(|e| e.at(&object.place.file, object.place.line))?
            }
            "subsurface" => self.subsurface_bsdf(object)?,
            "phong" | "ward" => self.phong_or_ward(object)?,
            "twosided" => {
                let front = self.nested(object)?;
                let back = self.child_of_class(object, "bsdf")?.map(|o| self.bsdf(&o)).transpose()?;
                Model::TwoSided { front, back: back.unwrap_or(front) }
            }
            "mask" => {
                Model::Mask { opacity: self.texture(object, "opacity", 0.5, NUMBER)?, nested: self.nested(object)? }
            }
            "bumpmap" => Model::BumpMap {
                height: self.nested_texture(object)?,
                scale: object.number("scale")?.unwrap_or(1.0) as f32,
                limits: bend_limits(object)?,
                nested: self.nested(object)?,
            },
            "normalmap" => Model::NormalMap {
                normals: self.nested_texture(object)?,
                scale: 1.0,
                axes: NormalAxes::RightHanded,
                limits: bend_limits(object)?,
                nested: self.nested(object)?,
            },
            "blendbsdf" => Model::Blend {
                weight: self.texture(object, "weight", 0.5, NUMBER)?,
                first: self.nested(object)?,
                second: self.nested(object)?,
            },
            "mixturebsdf" => self.mixture(object)?,
            _ => return Err(object.unsupported()),
        })
    }

    /// The next nested BSDF.
    fn nested(&mut self, object: &Rc<Object>) -> Result<MaterialId> {
        match self.child_of_class(object, "bsdf")? {
            Some(child) => self.bsdf(&child),
            None => Err(object.place.invalid(format!("{} has too few nested BSDFs", object.title()))),
        }
    }

    /// The nested texture, whatever its name.
    fn nested_texture(&mut self, object: &Rc<Object>) -> Result<TextureId> {
        match self.child_of_class(object, "texture")? {
            Some(child) => self.texture_object(&child, FACTOR),
            None => Err(object.place.invalid(format!("{} has no texture", object.title()))),
        }
    }

    /// A reflectance: a colour above 1 would make light.
    pub(super) fn albedo(&mut self, object: &Object, name: &str, default: f32) -> Result<TextureId> {
        let id = self.texture(object, name, default, FACTOR)?;
        match self.builder.scene.constant(id) {
            Some(rgb) if rgb.max_element() > 1.0 => {
                let what = format!("{name:?} of {} is above 1 ({rgb}); it is taken as 1", object.title());
                self.builder.warn(object.place.warning(what));
                Ok(self.builder.constant(rgb.min(Rgb::ONE)))
            }
            _ => Ok(id),
        }
    }

    /// An index of refraction, as a number or a name.
    pub(super) fn ior(&mut self, object: &Object, name: &str, default: f32) -> Result<f32> {
        let Some(property) = object.property(name) else { return Ok(default) };
        let place = &property.place;
        let ior = match &property.value {
            Value::Number(v) => *v as f32,
            Value::Text(text) => ior_by_name(text)
                .ok_or_else(|| place.invalid(format!("no index of refraction is known for {text:?}; give a number")))?,
            _ => return Err(place.invalid(format!("{name:?} is neither a number nor a name"))),
        };
        if ior > 0.0 && ior.is_finite() { Ok(ior) } else { Err(place.invalid(format!("{name:?} is not above 0"))) }
    }

    /// Ratio of the indices inside and outside.
    fn eta(&mut self, object: &Object, inside: f32) -> Result<f32> {
        Ok(self.ior(object, "int_ior", inside)? / self.ior(object, "ext_ior", AIR)?)
    }

    fn dielectric(&mut self, object: &Object, inside: f32) -> Result<Dielectric> {
        Ok(Dielectric {
            eta: self.eta(object, inside)?,
            specular_reflectance: self.albedo(object, "specular_reflectance", 1.0)?,
            specular_transmittance: self.albedo(object, "specular_transmittance", 1.0)?,
        })
    }

    fn conductor(&mut self, object: &Object) -> Result<Conductor> {
        let specular_reflectance = self.albedo(object, "specular_reflectance", 1.0)?;
        let eta = self.given_texture(object, "eta", FACTOR)?;
        let k = self.given_texture(object, "k", FACTOR)?;
        let named = object.text("material")?;
        let (eta, k) = match (eta, k, named) {
            (Some(eta), Some(k), _) => (eta, k),
            (None, None, named) => {
                let name = named.unwrap_or(if self.is_old() { "Cu" } else { "none" });
                let unknown = || object.place.invalid(format!("no indices are known for the metal {name:?}"));
                let metal = metal_by_name(name).ok_or_else(unknown)?;
                (self.builder.constant(metal.eta), self.builder.constant(metal.k))
            }
            _ => return Err(object.place.invalid(format!("{} has only one of \"eta\" and \"k\"", object.title()))),
        };
        // Only 0.6 has an outside other than the vacuum.
        let outside = self.ior(object, "ext_eta", 1.0)?;
        if outside == 1.0 {
            return Ok(Conductor { eta, k, specular_reflectance });
        }
        let mut relative = |id| match self.builder.scene.constant(id) {
            Some(rgb) => Ok(self.builder.constant(rgb / outside)),
            None => Err(object.place.unsupported("\"ext_eta\" together with textured indices")),
        };
        Ok(Conductor { eta: relative(eta)?, k: relative(k)?, specular_reflectance })
    }

    pub(super) fn distribution(&mut self, object: &Object) -> Result<Distribution> {
        Ok(match object.text("distribution")? {
            None | Some("beckmann") => Distribution::Beckmann,
            Some("ggx") => Distribution::Ggx,
            Some(other @ ("phong" | "as")) => {
                self.builder.warn(object.place.warning(format!("the distribution {other:?} is taken as \"beckmann\"")));
                Distribution::Beckmann
            }
            Some(other) => return Err(object.place.invalid(format!("{other:?} is no distribution of microfacets"))),
        })
    }

    fn roughness(&mut self, object: &Object) -> Result<Roughness> {
        let distribution = self.distribution(object)?;
        let along = self.given_texture(object, "alpha_u", NUMBER)?;
        let across = self.given_texture(object, "alpha_v", NUMBER)?;
        let both = self.texture(object, "alpha", 0.1, NUMBER)?;
        Ok(Roughness { distribution, alpha_u: along.unwrap_or(both), alpha_v: across.unwrap_or(both) })
    }

    fn plastic(&mut self, object: &Object) -> Result<Plastic> {
        Ok(Plastic {
            eta: self.eta(object, POLYPROPYLENE)?,
            diffuse_reflectance: self.albedo(object, "diffuse_reflectance", 0.5)?,
            specular_reflectance: self.albedo(object, "specular_reflectance", 1.0)?,
            nonlinear: object.boolean("nonlinear", false)?,
        })
    }

    fn rough_plastic(&mut self, object: &Rc<Object>) -> Result<Model> {
        let plastic = self.plastic(object)?;
        let distribution = self.distribution(object)?;
        let alpha = self.color(object, "alpha", 0.1, FACTOR)?.x;
        Ok(Model::RoughPlastic { plastic, distribution, alpha })
    }

    fn principled(&mut self, object: &Rc<Object>) -> Result<Model> {
        let specular = object.number("specular")?;
        let eta = match object.number("eta")? {
            Some(eta) if eta >= 1.0 => eta as f32,
            Some(_) => return Err(object.place.invalid("\"eta\" of a principled BSDF is not below 1")),
            None => translume_bxdf::Principled::eta_from_specular(specular.unwrap_or(0.5).clamp(0.0, 1.0) as f32),
        };
        let mut factor = |name: &str, default: f32| self.texture(object, name, default, NUMBER);
        let mut made = Principled {
            roughness: factor("roughness", 0.5)?,
            anisotropic: factor("anisotropic", 0.0)?,
            metallic: factor("metallic", 0.0)?,
            spec_trans: factor("spec_trans", 0.0)?,
            eta,
            spec_tint: factor("spec_tint", 0.0)?,
            sheen: factor("sheen", 0.0)?,
            sheen_tint: factor("sheen_tint", 0.0)?,
            flatness: factor("flatness", 0.0)?,
            clearcoat: factor("clearcoat", 0.0)?,
            clearcoat_gloss: factor("clearcoat_gloss", 0.0)?,
            base_color: self.albedo(object, "base_color", 0.5)?,
        };
        // Without a difference of indices there is no interface, and nobody asked for a colour of what passes: the default is that of
        // a diffuse base, which there is none of either.
        let is = |id, value: f32| self.builder.scene.constant(id) == Some(Rgb::splat(value));
        let colored = object.properties.iter().any(|p| p.name == "base_color")
            || object.children.iter().any(|c| c.name == "base_color");
        if eta == 1.0 && !colored && is(made.spec_trans, 1.0) && is(made.metallic, 0.0) {
            made.base_color = self.builder.constant(Rgb::ONE);
        }
        Ok(Model::Principled(Box::new(made)))
    }

    /// Its diffuse part is ours, without coat; what its specular part does to light is taken as smooth and colourless glass.
    fn principled_thin(&mut self, object: &Rc<Object>) -> Result<Model> {
        let base_color = self.albedo(object, "base_color", 0.5)?;
        let diff_trans = self.texture(object, "diff_trans", 0.0, NUMBER)?;
        let spec_trans = self.texture(object, "spec_trans", 0.0, NUMBER)?;
        let eta = object.number("eta")?.unwrap_or(1.5);
        if eta <= 1.0 {
            return Err(object.place.invalid("\"eta\" of a principledthin BSDF is not above 1"));
        }
        let none = self.builder.constant(Rgb::ZERO);
        let sheet = Model::ThinPrincipled(Box::new(ThinPrincipled {
            base_color,
            transmission_color: base_color,
            diff_trans: self.builder.scaled(diff_trans, Rgb::splat(0.5)), // 2 is all of it
            eta: 1.0,
            roughness: none,
            metallic: none,
        }));
        let is_clear = self.builder.scene.constant(spec_trans) != Some(Rgb::ZERO);
        let clear = ["roughness", "anisotropic", "spec_tint"];
        let mut unread = Vec::new();
        for name in [&clear[..], &["sheen", "sheen_tint", "flatness"]].concat() {
            let factor = self.texture(object, name, if name == "roughness" { 0.5 } else { 0.0 }, NUMBER)?;
            if self.builder.scene.constant(factor) != Some(Rgb::ZERO) && (is_clear || !clear.contains(&name)) {
                unread.push(name);
            }
        }
        if !unread.is_empty() {
            let what = format!("{} is taken without its {}", object.title(), unread.join(", "));
            self.builder.warn(object.place.warning(what));
        }
        if !is_clear {
            return Ok(sheet);
        }
        let glass = Model::ThinDielectric(Dielectric {
            eta: eta as f32,
            specular_reflectance: self.builder.constant(Rgb::ONE),
            specular_transmittance: base_color,
        });
        let (first, second) = (self.builder.material("", sheet), self.builder.material("", glass));
        Ok(Model::Blend { weight: spec_trans, first, second })
    }

    /// Lobes of Mitsuba 0.6 that have no twin here: the rough coat of about the same width over the same base.
    fn phong_or_ward(&mut self, object: &Rc<Object>) -> Result<Model> {
        let what = format!("{} is taken as a \"roughplastic\" of the same width", object.title());
        self.builder.warn(object.place.warning(what));
        let alpha = if object.plugin == "phong" {
            (2.0 / (object.positive("exponent", 30.0)? + 2.0)).sqrt()
        } else {
            let _ = object.property("variant");
            let both = object.positive("alpha", 0.1)?;
            (object.positive("alpha_u", both)? * object.positive("alpha_v", both)?).sqrt()
        };
        let plastic = Plastic {
            eta: POLYPROPYLENE / AIR,
            diffuse_reflectance: self.albedo(object, "diffuse_reflectance", 0.5)?,
            specular_reflectance: self.albedo(object, "specular_reflectance", 0.2)?,
            nonlinear: false,
        };
        Ok(Model::RoughPlastic { plastic, distribution: Distribution::Beckmann, alpha: alpha as f32 })
    }

    /// A weighted sum, as nested mixtures of two. Weights that do not reach 1 leave the rest black.
    fn mixture(&mut self, object: &Rc<Object>) -> Result<Model> {
        let place = &object.place;
        let text = object.text("weights")?.ok_or_else(|| place.invalid("mixturebsdf has no \"weights\""))?;
        let weights = text.split([',', ' ']).filter(|w| !w.is_empty());
        let weights = weights.map(|w| super::object::number(w, place)).collect::<Result<Vec<_>>>()?;
        if weights.iter().any(|w| *w < 0.0) || weights.is_empty() || weights.len() > 64 {
            return Err(place.invalid("the weights of a mixture are between 1 and 64 numbers that are not negative"));
        }
        let excess = weights.iter().sum::<f64>().max(1.0);
        let (mut sum, mut whole) = (1.0 - weights.iter().sum::<f64>() / excess, self.builder.gray(0.0));
        let mut model = Model::Diffuse { reflectance: self.builder.constant(Rgb::ZERO) };
        for (i, weight) in weights.iter().map(|w| w / excess).enumerate() {
            let second = self.nested(object)?;
            sum += weight;
            let share = if sum > 0.0 { weight / sum } else { 0.0 };
            let weight = self.builder.constant(Rgb::splat(share as f32));
            model = Model::Blend { weight, first: whole, second };
            if i + 1 < weights.len() {
                whole = self.builder.material("", model.clone());
            }
        }
        Ok(model)
    }
}

fn bend_limits(object: &Rc<Object>) -> Result<BendLimits> {
    Ok(BendLimits {
        turns_to_viewer: object.boolean("flip_invalid_normals", true)?,
        softens_terminator: object.boolean("use_shadowing_function", true)?,
    })
}
