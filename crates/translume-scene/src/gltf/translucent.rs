//! What light goes into or through: translucent solids, sheets that transmit diffusely, the absorbing inside of clear solids.

use super::{Loader, vector3};
use crate::Result;
use crate::material::{Model, Subsurface, ThinPrincipled};
use crate::medium::{Medium, Volume};
use crate::scene::{MediumId, TextureId};
use crate::texture::Channel;
use serde_json::Value;
use std::sync::Arc;
use translume_bxdf::homogeneous::{Diffusion, Homogeneous};
use translume_bxdf::{Distribution, Phase, Rgb};

impl Loader {
    /// Light that goes into a volume in all directions and comes out elsewhere, as a dipole: `KHR_materials_volume` with thickness and an
    /// attenuation, and `KHR_materials_diffuse_transmission` or the draft `KHR_materials_volume_scatter`.
    ///
    /// The attenuation distance is that between two meetings with particles. With the draft, the attenuation is σ_t = −ln(color)/distance and
    /// `multiscatterColor` is what comes back; without it the same distance holds for all colours, and what comes back is the
    /// transmission's colour times the attenuation's. The part of the surface that does not transmit is part of what comes back.
    pub(super) fn translucent(
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
        let p = self.metal_rough(pbr, extensions, base_color)?;
        if self.builder.scene.constant(p.coat) != Some(Rgb::ZERO) {
            self.warn_once(format!("material {name:?} lets light through diffusely; its clear coat is not used"));
        }
        let through = &extensions["KHR_materials_diffuse_transmission"];
        let specular = &extensions["KHR_materials_specular"];
        if ["specularTexture", "specularColorTexture", "specularColorFactor"].iter().any(|key| !specular[key].is_null())
        {
            let what = "lets light through diffusely; its specular textures and colour are not used";
            self.warn_once(format!("material {name:?} {what}"));
        }
        let specular = specular["specularFactor"].as_f64().unwrap_or(1.0).clamp(0.0, 1.0) as f32;
        let amount = through["diffuseTransmissionFactor"].as_f64().unwrap_or(0.0).clamp(0.0, 1.0) as f32;
        let color = vector3(&through["diffuseTransmissionColorFactor"], [1.0; 3]).clamp(Rgb::ZERO, Rgb::ONE);
        let amounts = self.bitmap(&through["diffuseTransmissionTexture"], true, Channel::Alpha, Rgb::splat(amount))?;
        let colors = self.bitmap(&through["diffuseTransmissionColorTexture"], false, Channel::Rgb, color)?;
        Ok(Model::ThinPrincipled(Box::new(ThinPrincipled {
            base_color,
            transmission_color: colors.unwrap_or_else(|| self.builder.constant(color)),
            diff_trans: amounts.unwrap_or_else(|| self.builder.constant(Rgb::splat(amount))),
            eta: index_of_refraction(extensions, specular),
            roughness: p.roughness,
            metallic: p.metallic,
        })))
    }

    /// The absorbing inside of a solid.
    pub(super) fn interior(&mut self, source: &Value, name: &str) -> Option<MediumId> {
        let volume = &source["extensions"]["KHR_materials_volume"];
        let distance = volume["attenuationDistance"].as_f64().filter(|d| *d > 0.0 && d.is_finite())? as f32;
        volume["thicknessFactor"].as_f64().filter(|t| *t > 0.0)?;
        let extensions = &source["extensions"];
        let diffuse = extensions["KHR_materials_diffuse_transmission"]["diffuseTransmissionFactor"].as_f64();
        let clear = extensions["KHR_materials_transmission"]["transmissionFactor"].as_f64();
        if clear.is_none_or(|f| f <= 0.0) {
            return None; // nothing gets in
        }
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
            domain: None,
        });
        Some(MediumId(self.builder.scene.media.len() - 1))
    }
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
