//! From the description of a material to the BSDF at a shading point.
//!
//! Adapters that turn the frame are resolved here: of `TwoSided` the side that `wo` is on, with the normal turned to it;
//! bump and normal maps bend the frame. Blends of blends are one mixture of all that they come down to (`mixture`). Interfaces of
//! equal indices are none: light goes straight on. Limit: of a blend, the frame that its first part bends serves both.

mod mixture;
mod traits;

use crate::texture::{self, Place};
use crate::world::bend::Bend;
use crate::world::{SurfaceHit, Translucent};
use crate::{Rgb, luminance};
use glam::Vec3;
pub(crate) use mixture::Mixture;
use std::collections::HashMap;
use std::sync::Arc;
pub(crate) use traits::{Traits, traits};
use translume_bxdf::{self as bxdf, Bsdf, Microfacets};
use translume_core::frame::Frame;
use translume_scene::material::{
    BendLimits, Conductor, Dielectric, MetalRough, Model, NormalAxes, Principled, Roughness, Subsurface, ThinPrincipled,
};
use translume_scene::{MaterialId, Scene, TextureId};

/// What is tabulated once per material.
pub(crate) enum Prepared {
    Nothing,
    Plastic(bxdf::Plastic),
    Coat(Box<bxdf::Coat>),
    SheetCoat(Arc<bxdf::SheetCoat>),
}

pub(crate) fn prepare(scene: &Scene) -> Vec<Prepared> {
    let mut coats: HashMap<u32, Arc<bxdf::SheetCoat>> = HashMap::new();
    let one = |m: &translume_scene::material::Material| match &m.model {
        Model::Plastic(p) => Prepared::Plastic(bxdf::Plastic::new(p.eta, Rgb::ZERO, Rgb::ONE, p.nonlinear)),
        Model::RoughPlastic { plastic, distribution, alpha } => {
            Prepared::Coat(Box::new(bxdf::Coat::new(*distribution, *alpha, plastic.eta)))
        }
        Model::ThinPrincipled(p) if p.eta > 1.0 => {
            let coat = coats.entry(p.eta.to_bits()).or_insert_with(|| Arc::new(bxdf::SheetCoat::new(p.eta)));
            Prepared::SheetCoat(coat.clone())
        }
        Model::Subsurface(s) => match s.roughness {
            Some((distribution, alpha)) => Prepared::Coat(Box::new(bxdf::Coat::new(distribution, alpha, s.eta))),
            None => Prepared::Nothing,
        },
        _ => Prepared::Nothing,
    };
    scene.materials.iter().map(one).collect()
}

/// Ratios of indices this near 1 are 1: rounding would be left of the directions between microfacets.
const NO_INTERFACE: f32 = 1e-4;

/// Least ratio of a principled material that transmits, for the same reason; as in Mitsuba, its lobes bend light a little.
const LEAST_BENDING: f32 = 1.001;

/// Whether there is no interface between the two sides.
fn is_matched(glass: &Dielectric) -> bool {
    (glass.eta - 1.0).abs() < NO_INTERFACE
}

/// What makes the BSDF at `hit`, whose frame is bent on the way as materials want it.
#[derive(Clone)]
pub(crate) struct Shader<'a, 'b> {
    pub(crate) scene: &'a Scene,
    pub(crate) prepared: &'a [Prepared],
    pub(crate) hit: &'b SurfaceHit,
    /// Where the hit's geometry stands, unless that is in the world's own space.
    pub(crate) standing: Option<&'a translume_trace::Instance>,
    /// What is under the surface.
    pub(crate) under: Option<&'a Translucent>,
    pub(crate) place: Place<'a>,
    pub(crate) frame: Frame,
    /// How the frame was bent.
    pub(crate) bend: Option<Bend>,
    /// The frame was turned to the side that is seen.
    pub(crate) turned: bool,
    /// Mixtures by their material.
    pub(crate) mixtures: &'a [Option<Mixture>],
}

impl<'a> Shader<'a, '_> {
    fn rgb(&self, id: TextureId) -> Rgb {
        texture::eval(self.scene, id, &self.place)
    }

    fn unit(&self, id: TextureId) -> Rgb {
        self.rgb(id).clamp(Rgb::ZERO, Rgb::ONE)
    }

    fn number(&self, id: TextureId) -> f32 {
        texture::eval_1d(self.scene, id, &self.place)
    }

    /// The BSDF of material `id`.
    pub(crate) fn bsdf(&mut self, id: MaterialId) -> Bsdf<'a> {
        match &self.scene.materials[id.0].model {
            Model::Null => Bsdf::new(bxdf::Model::Null),
            Model::Diffuse { reflectance } => bxdf::Diffuse { reflectance: self.unit(*reflectance) }.into(),
            Model::DiffuseTransmission { reflectance, transmittance } => {
                let (r, t) = (self.unit(*reflectance), self.unit(*transmittance));
                let excess = (r + t).max_element().max(1.0);
                bxdf::DiffuseSheet { reflectance: r / excess, transmittance: t / excess }.into()
            }
            Model::Dielectric(d) if is_matched(d) => self.matched(d),
            Model::RoughDielectric { dielectric, .. } if is_matched(dielectric) => self.matched(dielectric),
            Model::Dielectric(d) => {
                let (eta, specular_reflectance, specular_transmittance) = self.glass(d);
                bxdf::Dielectric { eta, specular_reflectance, specular_transmittance }.into()
            }
            Model::ThinDielectric(d) => {
                let (eta, specular_reflectance, specular_transmittance) = self.glass(d);
                bxdf::ThinDielectric { eta, specular_reflectance, specular_transmittance }.into()
            }
            Model::RoughDielectric { dielectric, roughness } => {
                let (eta, specular_reflectance, specular_transmittance) = self.glass(dielectric);
                let microfacets = self.microfacets(roughness);
                bxdf::RoughDielectric { eta, microfacets, specular_reflectance, specular_transmittance }.into()
            }
            Model::Conductor(c) => self.metal(c).into(),
            Model::RoughConductor { conductor, roughness } => {
                let microfacets = self.microfacets(roughness);
                bxdf::RoughConductor { metal: self.metal(conductor), microfacets }.into()
            }
            Model::Plastic(p) => {
                let Prepared::Plastic(mut plastic) = self.prepared[id.0] else { return Bsdf::new(bxdf::Model::Null) };
                (plastic.diffuse_reflectance, plastic.specular_reflectance) =
                    (self.unit(p.diffuse_reflectance), self.unit(p.specular_reflectance));
                plastic.into()
            }
            Model::RoughPlastic { plastic: p, .. } => {
                let Prepared::Coat(coat) = &self.prepared[id.0] else { return Bsdf::new(bxdf::Model::Null) };
                bxdf::RoughPlastic {
                    coat,
                    diffuse_reflectance: self.unit(p.diffuse_reflectance),
                    specular_reflectance: self.unit(p.specular_reflectance),
                    nonlinear: p.nonlinear,
                }
                .into()
            }
            Model::Principled(p) => self.principled(p).into(),
            Model::MetalRough(p) => self.metal_rough(p),
            Model::ThinPrincipled(p) => self.thin_principled(id, p),
            Model::Measured(model) => bxdf::Custom { model: &**model, uv: self.place.uv }.into(),
            Model::Subsurface(s) => self.skin(id, s),
            Model::TwoSided { front, back } => {
                let own = self.bend.map_or(self.frame.n, |b| b.unbent());
                let behind = self.turned || self.hit.wo.dot(own) < 0.0;
                if behind && !self.turned {
                    (self.frame.n, self.turned) = (-self.frame.n, true);
                    self.bend = self.bend.map(Bend::seen_from_behind);
                }
                self.bsdf(if behind { *back } else { *front })
            }
            Model::Mask { opacity, nested } => {
                let opacity = self.number(*opacity);
                self.bsdf(*nested).with_opacity(opacity)
            }
            Model::BumpMap { height, scale, limits, nested } => {
                self.bump(texture::gradient(self.scene, *height, &self.place) * *scale, *limits);
                self.bsdf(*nested)
            }
            Model::NormalMap { normals, scale, axes, limits, nested } => {
                self.bend(self.mapped_normal(*normals, *scale, *axes, &self.frame), *limits);
                self.bsdf(*nested)
            }
            Model::Blend { .. } => match &self.mixtures[id.0] {
                Some(mixture) => self.mixed(mixture),
                None => Bsdf::new(bxdf::Model::Null), // refused when the world was made
            },
        }
    }

    /// The parts that there are here, as a balanced tree of mixtures of two. The first bends the frame for all.
    fn mixed(&mut self, mixture: &Mixture) -> Bsdf<'a> {
        let mut parts = Vec::new();
        let shares = mixture.shares(|weight| self.number(weight).clamp(0.0, 1.0));
        for (material, share) in shares {
            parts.push((share, if parts.is_empty() { self.bsdf(material) } else { self.clone().bsdf(material) }));
        }
        mix(parts).map_or_else(|| Bsdf::new(bxdf::Model::Null), |(_, bsdf)| bsdf)
    }

    /// What is left of an interface of equal indices: the colour that what passes takes.
    fn matched(&self, d: &Dielectric) -> Bsdf<'a> {
        let (_, specular_reflectance, specular_transmittance) = self.glass(d);
        bxdf::ThinDielectric { eta: 1.0, specular_reflectance, specular_transmittance }.into()
    }

    /// The boundary of a translucent object, the same from both sides.
    fn skin(&self, id: MaterialId, s: &Subsurface) -> Bsdf<'a> {
        let coat = match &self.prepared[id.0] {
            Prepared::Coat(coat) => Some(&**coat),
            _ => None,
        };
        let albedo = self.under.map_or(Rgb::ZERO, |u| u.albedo(self.hit));
        let specular_reflectance = self.unit(s.specular_reflectance);
        Bsdf::from(bxdf::Skin { eta: s.eta, coat, specular_reflectance, albedo }).two_sided()
    }

    fn glass(&self, d: &Dielectric) -> (f32, Rgb, Rgb) {
        (d.eta, self.unit(d.specular_reflectance), self.unit(d.specular_transmittance))
    }

    fn metal(&self, c: &Conductor) -> bxdf::Conductor {
        bxdf::Conductor {
            eta: self.rgb(c.eta),
            k: self.rgb(c.k),
            specular_reflectance: self.unit(c.specular_reflectance),
        }
    }

    fn microfacets(&self, r: &Roughness) -> Microfacets {
        Microfacets::new(r.distribution, self.number(r.alpha_u), self.number(r.alpha_v))
    }

    fn principled(&self, p: &Principled) -> bxdf::Principled {
        let number = |id: TextureId| self.number(id).clamp(0.0, 1.0);
        let bends = |eta: f32| if (eta - 1.0).abs() < LEAST_BENDING - 1.0 { LEAST_BENDING } else { eta };
        let transmits = number(p.spec_trans) > 0.0;
        bxdf::Principled {
            base_color: self.unit(p.base_color),
            roughness: number(p.roughness),
            anisotropic: number(p.anisotropic),
            metallic: number(p.metallic),
            spec_trans: number(p.spec_trans),
            eta: if transmits { bends(p.eta) } else { p.eta },
            spec_tint: number(p.spec_tint),
            sheen: number(p.sheen),
            sheen_tint: number(p.sheen_tint),
            flatness: number(p.flatness),
            clearcoat: number(p.clearcoat),
            clearcoat_gloss: number(p.clearcoat_gloss),
        }
    }

    fn metal_rough(&self, p: &MetalRough) -> Bsdf<'a> {
        let number = |id: TextureId| self.number(id).clamp(0.0, 1.0);
        let (specular, f0) = (number(p.specular), self.unit(p.f0));
        let left = if p.f0_dims_base { 1.0 - f0.max_element() } else { 1.0 };
        let coat = number(p.coat);
        let bsdf = Bsdf::from(bxdf::MetalRough {
            base_color: self.unit(p.base_color) * left,
            metallic: number(p.metallic),
            roughness: number(p.roughness),
            f0: f0 * specular,
            f90: specular,
            transmission: number(p.transmission),
            thin: p.solid.is_none(),
            eta: p.solid.unwrap_or(1.0),
            coat,
            coat_roughness: if coat > 0.0 { number(p.coat_roughness) } else { 0.0 },
            coat_normal: if coat > 0.0 { self.coat_normal(p) } else { Vec3::Z },
        });
        if p.solid.is_none() { bsdf.two_sided() } else { bsdf }
    }

    /// The coat's normal in the local frame: the surface's own, which the normals of what is under it do not bend.
    fn coat_normal(&self, p: &MetalRough) -> Vec3 {
        let own = self.bend.map_or(self.frame, |b| Frame::from_normal_tangent(b.unbent(), self.hit.dp_du));
        let normal = match p.coat_normals {
            Some((normals, scale)) => self.mapped_normal(normals, scale, NormalAxes::OfPicture, &own),
            None => own.n,
        };
        self.frame.to_local(normal).try_normalize().unwrap_or(Vec3::Z)
    }

    /// A normal of a normal map over the frame `own`, of any length.
    fn mapped_normal(&self, normals: TextureId, scale: f32, axes: NormalAxes, own: &Frame) -> Vec3 {
        let n = self.rgb(normals) * 2.0 - Rgb::ONE;
        let n = Vec3::new(n.x * scale, n.y * scale, n.z);
        let of_picture = if axes == NormalAxes::OfPicture { self.picture_frame(normals, own.n) } else { None };
        match of_picture {
            Some((right, up)) => right * n.x + up * n.y + own.n * n.z,
            None => own.to_world(n),
        }
    }

    /// Unit vectors across the normal `n` to the right and to the top of a picture: by the mesh's tangents, or by how the
    /// picture lies on the triangle.
    fn picture_frame(&self, picture: TextureId, n: Vec3) -> Option<(Vec3, Vec3)> {
        let on = self.place.on?;
        let matrix = self.standing.map(|s| s.world_from_object.matrix3.as_mat3());
        let moved = |v: Vec3| matrix.map_or(v, |m| m * v);
        let mirrors = matrix.is_some_and(|m| m.determinant() < 0.0);
        let (right, is_right_handed) = match &on.mesh.tangents {
            Some(tangents) => {
                let sign = tangents[on.mesh.indices[on.face as usize][0] as usize][3];
                let along = on.mean(|i| Vec3::new(tangents[i][0], tangents[i][1], tangents[i][2]));
                (moved(along), (sign > 0.0) != mirrors)
            }
            None => {
                let (right, top) = texture::picture_axes(self.scene, picture, &self.place)?;
                let (right, top) = (moved(right), moved(top));
                (right, n.cross(right).dot(top) >= 0.0)
            }
        };
        let right = (right - n * n.dot(right)).try_normalize()?;
        let up = n.cross(right);
        Some((right, if is_right_handed { up } else { -up }))
    }

    fn thin_principled(&self, id: MaterialId, p: &ThinPrincipled) -> Bsdf<'a> {
        let number = |id: TextureId| self.number(id).clamp(0.0, 1.0);
        let (base, through) = (self.unit(p.base_color), number(p.diff_trans));
        let sheet = bxdf::DiffuseSheet {
            reflectance: base * (1.0 - through),
            transmittance: self.unit(p.transmission_color) * through,
        };
        let Prepared::SheetCoat(coat) = &self.prepared[id.0] else { return sheet.into() };
        let (roughness, metallic) = (number(p.roughness), number(p.metallic));
        bxdf::CoatedSheet { coat, roughness, sheet, metallic, metal: base }.into()
    }

    /// Bends the frame to the height field of this gradient (by u and v).
    fn bump(&mut self, gradient: glam::Vec2, limits: BendLimits) {
        let n = self.frame.n;
        let lift = |d: Vec3, slope: f32| d + n * (slope - n.dot(d));
        let bent = lift(self.hit.dp_du, gradient.x).cross(lift(self.hit.dp_dv, gradient.y));
        self.bend(if bent.dot(n) < 0.0 { -bent } else { bent }, limits);
    }

    /// Makes `normal`, of any length, the shading normal. Of maps upon maps the first says what the surface's own normal is.
    fn bend(&mut self, normal: Vec3, limits: BendLimits) {
        if let Some(n) = normal.try_normalize() {
            let unbent = self.bend.map_or(self.frame.n, |b| b.unbent());
            self.bend = Some(Bend::new(unbent, n, self.hit.dp_du, limits));
            self.frame = Frame::from_normal_tangent(n, self.hit.dp_du);
        }
    }
}

/// These BSDFs in their shares as one, with their sum.
fn mix(mut parts: Vec<(f32, Bsdf)>) -> Option<(f32, Bsdf)> {
    if parts.len() < 2 {
        return parts.pop();
    }
    let ((a, first), (b, second)) = {
        let rest = parts.split_off(parts.len() / 2);
        (mix(parts)?, mix(rest)?)
    };
    let weight = b / (a + b);
    Some((a + b, Box::new(bxdf::Blend { weight, first, second }).into()))
}

/// The mean luminance of a texture, for choosing among lights.
pub(crate) fn mean_luminance(scene: &Scene, id: TextureId) -> f32 {
    luminance(scene.mean(id))
}
