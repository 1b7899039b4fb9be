//! Translucent objects: `<bsdf type="subsurface">`, this project's own, and Mitsuba 0.6's `<subsurface type="dipole">` of a shape.
//!
//! Coefficients are per unit of the scene, as in Mitsuba; published materials are per mm, so a scene in other units gives
//! `scale`, the factor on all coefficients. For objects that were captured `scale` is mm per unit of the shape's own space.
//! The words of OpenPBR's subsurface are known, too.

use super::Loader;
use super::object::Object;
use crate::Result;
use crate::material::{Model, Subsurface};
use crate::scene::MaterialId;
use crate::spectrum::Quantity;
use std::rc::Rc;
use std::sync::Arc;
use translume_bxdf::homogeneous::{Diffusion, Homogeneous, measured_by_name};
use translume_bxdf::{AIR, Bssrdf, Rgb};

const FACTOR: Quantity = Quantity::Factor;

impl Loader {
    /// `<bsdf type="subsurface">`.
    pub(super) fn subsurface_bsdf(&mut self, object: &Rc<Object>) -> Result<Model> {
        let rough = object.properties.iter().any(|p| p.name == "alpha" || p.name == "distribution");
        let roughness = match rough {
            true => Some((self.distribution(object)?, self.color(object, "alpha", 0.1, FACTOR)?.x)),
            false => None,
        };
        let specular_reflectance = self.albedo(object, "specular_reflectance", 1.0)?;
        let scale = object.positive("scale", 1.0)?;
        if object.text("filename")?.is_some() {
            let path = self.file(object, "filename")?;
            let load = self.builder.options.bssrdf_loader;
            let load =
                load.ok_or_else(|| object.place.unsupported("measured translucent objects are not read here"))?;
            crate::files::note(&path);
            let model = load(&path).map_err(|what| object.place.invalid(what))?;
            let known = model.eta().unwrap_or(1.3);
            let eta = self.ior(object, "int_ior", known * AIR)? / self.ior(object, "ext_ior", AIR)?;
            return Ok(boxed(Subsurface {
                model,
                mm_per_unit: scale,
                in_object_space: true,
                eta: checked(object, eta)?,
                roughness,
                specular_reflectance,
            }));
        }
        let (model, eta) = self.diffusion(object, object.text("model")?.unwrap_or("dipole"), scale)?;
        Ok(boxed(Subsurface { model, mm_per_unit: 1.0, in_object_space: false, eta, roughness, specular_reflectance }))
    }

    /// `<subsurface>` of a shape; the boundary is that of the shape's BSDF, as far as it has one.
    pub(super) fn subsurface_of_shape(
        &mut self,
        object: &Rc<Object>,
        boundary: Option<MaterialId>,
    ) -> Result<MaterialId> {
        let kind = match object.plugin.as_str() {
            "dipole" => "dipole",
            _ => return Err(object.unsupported()),
        };
        let scale = object.positive("scale", 1.0)?;
        let (model, eta) = self.diffusion(object, kind, scale)?;
        for name in ["irr_samples", "irr_indirect", "quality", "sample_multiplier"] {
            let _ = object.property(name); // how irradiance is sampled there
        }
        self.finish(object)?;
        let (roughness, specular_reflectance) = match boundary
            .map(|id| self.builder.scene.materials[id.0].model.clone())
        {
            Some(Model::Plastic(p)) => (None, p.specular_reflectance),
            Some(Model::RoughPlastic { plastic, distribution, alpha }) => {
                (Some((distribution, alpha)), plastic.specular_reflectance)
            }
            Some(Model::Dielectric(d)) => (None, d.specular_reflectance),
            Some(Model::RoughDielectric { dielectric, roughness }) => {
                let alpha = self.builder.scene.constant(roughness.alpha_u);
                let alpha = alpha.ok_or_else(|| object.place.unsupported("a textured roughness over a subsurface"))?;
                (Some((roughness.distribution, alpha.x)), dielectric.specular_reflectance)
            }
            None => (None, self.builder.constant(Rgb::ZERO)),
            Some(_) => {
                let what =
                    format!("of the BSDF under {} only the highlight would be used, and it has none", object.title());
                self.builder.warn(object.place.warning(what));
                (None, self.builder.constant(Rgb::ZERO))
            }
        };
        let model =
            Subsurface { model, mm_per_unit: 1.0, in_object_space: false, eta, roughness, specular_reflectance };
        Ok(self.builder.material(&object.id, boxed(model)))
    }

    /// A homogeneous material: by name, by coefficients, or by reflectance and mean free path.
    fn diffusion(&mut self, object: &Object, kind: &str, scale: f64) -> Result<(Arc<dyn Bssrdf>, f32)> {
        let place = &object.place;
        let model = Diffusion::by_name(kind).ok_or_else(|| {
            place.invalid(format!("{kind:?} is no model of diffusion: dipole, better-dipole or normalized"))
        })?;
        let given = |loader: &mut Self, name: &str| loader.given_color(object, name, FACTOR);
        let coefficients =
            [given(self, "sigma_s")?, given(self, "sigma_a")?, given(self, "sigma_t")?, given(self, "albedo")?];
        let [sigma_s, sigma_a, sigma_t, albedo] = coefficients;
        let (reflectance, path) = match given(self, "subsurface_color")? {
            Some(color) => (Some(color), Some(self.openpbr_path(object)?)),
            None => (given(self, "reflectance")?, given(self, "mfp")?),
        };
        let named = object.text("material")?;
        let unknown = |name: &str| {
            place.invalid(format!("the translucent material {name:?} is not known; give sigma_s and sigma_a"))
        };
        let anisotropy = 1.0 - object.number("g")?.unwrap_or(0.0) as f32;
        if !(0.0..=2.0).contains(&anisotropy) {
            return Err(place.invalid("\"g\" lies between −1 and 1"));
        }
        let scale = scale as f32;
        let (known, eta) =
            match named.or((sigma_s.is_none() && sigma_t.is_none() && reflectance.is_none()).then_some("skin1")) {
                Some(name) => measured_by_name(name).map(|(c, eta)| (Some(c), eta)).ok_or_else(|| unknown(name))?,
                None => (None, 1.3),
            };
        let eta = checked(object, self.ior(object, "int_ior", eta * AIR)? / self.ior(object, "ext_ior", AIR)?)?;
        let made = match (known, reflectance, sigma_t) {
            (Some([s, a]), ..) => Homogeneous::new(model, s * scale, a * scale, eta),
            (None, Some(r), _) => Homogeneous::from_reflectance(model, r, path.unwrap_or(Rgb::ONE) / scale, eta),
            (None, None, Some(t)) => {
                let albedo = albedo.ok_or_else(|| place.invalid("sigma_t without albedo"))?;
                Homogeneous::new(model, t * albedo * anisotropy * scale, t * (Rgb::ONE - albedo) * scale, eta)
            }
            (None, None, None) => {
                let (s, a) = (sigma_s.unwrap_or(Rgb::ZERO), sigma_a.unwrap_or(Rgb::ZERO));
                Homogeneous::new(model, s * anisotropy * scale, a * scale, eta)
            }
        };
        let sound = || place.invalid(format!("the coefficients of {} are no scattering material", object.title()));
        Ok((Arc::new(made.ok_or_else(sound)?), eta))
    }

    /// The mean free path in OpenPBR's words: `subsurface_radius` times `subsurface_radius_scale`. Scattering forwards lengthens the way
    /// until the direction is lost; `subsurface_color` is what comes back whatever the phase function.
    fn openpbr_path(&mut self, object: &Object) -> Result<Rgb> {
        let radius = object.positive("subsurface_radius", 1.0)? as f32;
        let scale = self.given_color(object, "subsurface_radius_scale", FACTOR)?.unwrap_or(Rgb::new(1.0, 0.5, 0.25));
        let anisotropy = object.number("subsurface_scatter_anisotropy")?.unwrap_or(0.0) as f32;
        if !(-1.0..1.0).contains(&anisotropy) || scale.min_element() <= 0.0 || !scale.is_finite() {
            let what = "\"subsurface_scatter_anisotropy\" lies between −1 and 1, \"subsurface_radius_scale\" above 0";
            return Err(object.place.invalid(what));
        }
        Ok(radius * scale / (1.0 - anisotropy))
    }
}

fn boxed(subsurface: Subsurface) -> Model {
    Model::Subsurface(Box::new(subsurface))
}

/// What the models are made for.
fn checked(object: &Object, eta: f32) -> Result<f32> {
    match (1.0..=4.0).contains(&eta) {
        true => Ok(eta),
        false => Err(object
            .place
            .invalid(format!("a relative index of refraction of {eta} inside {}: 1 to 4", object.title()))),
    }
}
