//! Lights without surfaces, and media.

use super::Loader;
use super::parameters::Parameters;
use crate::Result;
use crate::emitter::{Emitter, Falloff, Spot};
use crate::medium::{Medium, Volume};
use crate::scene::MediumId;
use crate::spectrum::Quantity;
use glam::{DAffine3, DMat3, DVec3};
use translume_bxdf::{Phase, Rgb};

impl Loader {
    /// Radiance or intensity of a light: colour times scale.
    pub(super) fn strength(&mut self, p: &Parameters, name: &str) -> Result<Rgb> {
        for other in ["power", "illuminance", "portal"] {
            if p.get(other).is_some() {
                return Err(p.place.unsupported(format!("{other:?} of a light is not supported")));
            }
        }
        let color = p.color(name, Quantity::Light)?.unwrap_or(Rgb::ONE);
        let scaled = color * p.number("scale", 1.0)? as f32;
        if scaled.is_finite() && scaled.min_element() >= 0.0 {
            return Ok(scaled);
        }
        Err(p.place.invalid("the strength of a light is negative or not finite"))
    }

    pub(super) fn light(&mut self, kind: &str, p: &Parameters) -> Result<()> {
        let m = self.state.world_from_object;
        let from = p.point("from", DVec3::ZERO)?;
        let to = p.point("to", DVec3::Z)?;
        let emitter = match kind {
            "point" => Emitter::Point { position: m.transform_point3(from), intensity: self.strength(p, "I")? },
            "distant" => {
                let direction = m.transform_vector3(to - from).try_normalize();
                let direction = direction.ok_or_else(|| p.place.invalid("a distant light has no direction"))?;
                Emitter::Directional { direction, irradiance: self.strength(p, "L")? }
            }
            "spot" => {
                let (cone, delta) = (p.number("coneangle", 30.0)?, p.number("conedeltaangle", 5.0)?);
                if !(0.0 < cone && cone <= 180.0 && (0.0..=cone).contains(&delta)) {
                    return Err(p.place.invalid("the angles of a spot light are wrong"));
                }
                let frame = frame_towards(m.transform_point3(from), m.transform_vector3(to - from));
                Emitter::Spot(Spot {
                    world_from_light: frame.ok_or_else(|| p.place.invalid("a spot light has no direction"))?,
                    intensity: self.strength(p, "I")?,
                    cutoff_angle: cone.to_radians() as f32,
                    beam_width: (cone - delta).to_radians() as f32,
                    falloff: Falloff::SmoothInCosine,
                })
            }
            "infinite" if p.get("filename").is_none() => Emitter::Constant { radiance: self.strength(p, "L")? },
            "infinite" => {
                let what = "an infinite light from a picture (an equal-area map) is not supported";
                return Err(p.place.unsupported(what));
            }
            _ => return Err(p.place.unsupported(format!("light {kind:?} is not supported"))),
        };
        self.finish(kind, p);
        self.builder.scene.emitters.push(emitter);
        Ok(())
    }

    pub(super) fn named_medium(&mut self, name: &str, p: &Parameters) -> Result<()> {
        let kind = p.text("type")?.ok_or_else(|| p.place.invalid(format!("medium {name:?} has no \"type\"")))?;
        if kind != "homogeneous" || p.get("preset").is_some() {
            return Err(p
                .place
                .unsupported(format!("medium {name:?}: only homogeneous ones are read, without presets")));
        }
        if p.color("Le", Quantity::Light)?.is_some_and(|le| le != Rgb::ZERO) {
            return Err(p.place.unsupported(format!("medium {name:?} emits light, which is not supported")));
        }
        let _ = p.get("Lescale");
        let absorbed = p.color("sigma_a", Quantity::Factor)?.unwrap_or(Rgb::new(0.0011, 0.0024, 0.014));
        let scattered = p.color("sigma_s", Quantity::Factor)?.unwrap_or(Rgb::new(2.55, 3.21, 3.77));
        let sigma_t = absorbed + scattered;
        let albedo = Rgb::from(std::array::from_fn(|c| if sigma_t[c] > 0.0 { scattered[c] / sigma_t[c] } else { 0.0 }));
        let (scale, g) = (p.number("scale", 1.0)? as f32, p.number("g", 0.0)? as f32);
        if !(scale >= 0.0 && scale.is_finite() && g.abs() < 1.0) {
            return Err(p.place.invalid(format!("medium {name:?}: scale ≥ 0 and −1 < g < 1")));
        }
        if !(sigma_t * scale).is_finite() {
            return Err(p.place.invalid(format!("the extinction of medium {name:?} times its scale is too large")));
        }
        let phase = if g == 0.0 { Phase::Isotropic } else { Phase::HenyeyGreenstein { g } };
        self.finish(kind, p);
        self.media.insert(name.to_owned(), MediumId(self.builder.scene.media.len()));
        self.builder.scene.media.push(Medium {
            name: name.to_owned(),
            sigma_t: Volume::Constant(sigma_t),
            albedo: Volume::Constant(albedo),
            scale,
            phase,
            domain: None,
        });
        Ok(())
    }
}

/// The frame at `origin` whose z points along `direction`.
fn frame_towards(origin: DVec3, direction: DVec3) -> Option<DAffine3> {
    let z = direction.try_normalize()?;
    let (x, y) = z.any_orthonormal_pair();
    Some(DAffine3::from_mat3_translation(DMat3::from_cols(x, y, z), origin))
}
