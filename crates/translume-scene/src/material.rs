//! Descriptions of materials: the parameters of the BSDFs with a texture for whatever may vary.
//!
//! Meanings and defaults are those of Mitsuba 3, which the models of `translume-bxdf` follow too.

use crate::{MaterialId, TextureId};
use std::sync::Arc;
use translume_bxdf::{Bssrdf, CustomBsdf, Distribution};

/// A material.
#[derive(Clone, Debug)]
pub struct Material {
    /// Name or identifier in the file, for messages; may be empty.
    pub name: String,
    /// What it does.
    pub model: Model,
}

/// What a material does. Colours and numbers that vary are [`TextureId`]s; those that no format varies are numbers.
/// Indices of refraction are ratios `eta`: that of the inside (away from the normal) over that of the outside.
#[derive(Clone, Debug)]
pub enum Model {
    /// Nothing: light goes straight on. The boundary of a medium.
    Null,
    /// Lambert's.
    Diffuse {
        /// Fraction reflected.
        reflectance: TextureId,
    },
    /// Lambert's on both sides of a thin sheet that lets light through: paper, a leaf, a lampshade.
    DiffuseTransmission {
        /// Fraction reflected. Where this and `transmittance` exceed 1 together they are taken by less.
        reflectance: TextureId,
        /// Fraction transmitted.
        transmittance: TextureId,
    },
    /// Smooth glass.
    Dielectric(Dielectric),
    /// A sheet of glass too thin to refract.
    ThinDielectric(Dielectric),
    /// Frosted glass.
    RoughDielectric {
        /// The glass.
        dielectric: Dielectric,
        /// Its surface.
        roughness: Roughness,
    },
    /// Smooth metal.
    Conductor(Conductor),
    /// Rough metal.
    RoughConductor {
        /// The metal.
        conductor: Conductor,
        /// Its surface.
        roughness: Roughness,
    },
    /// Smooth coat over a diffuse base.
    Plastic(Plastic),
    /// Rough coat over a diffuse base.
    RoughPlastic {
        /// Base and coat.
        plastic: Plastic,
        /// Shape of the microfacets.
        distribution: Distribution,
        /// Their roughness.
        alpha: f32,
    },
    /// Disney's principled model.
    Principled(Box<Principled>),
    /// glTF's metallic-roughness model.
    MetalRough(Box<MetalRough>),
    /// A thin sheet that transmits diffusely, under a clear coat on both sides.
    ThinPrincipled(Box<ThinPrincipled>),
    /// A measured reflectance.
    Measured(Arc<dyn CustomBsdf>),
    /// A translucent object: light comes out elsewhere than it went in.
    Subsurface(Box<Subsurface>),
    /// Seen from behind (against the normal) it is `back`, turned over.
    TwoSided {
        /// On the side of the normal.
        front: MaterialId,
        /// On the other.
        back: MaterialId,
    },
    /// Partly not there.
    Mask {
        /// Fraction that is there.
        opacity: TextureId,
        /// What is there.
        nested: MaterialId,
    },
    /// Shading normals from a height field.
    BumpMap {
        /// Heights, in the scene's unit of length.
        height: TextureId,
        /// Factor on them.
        scale: f32,
        /// Where the bent normals are of no use.
        limits: BendLimits,
        /// What is shaded.
        nested: MaterialId,
    },
    /// Shading normals from a picture of them.
    NormalMap {
        /// Normals n as (n + 1)/2, z along the shading normal, x along ∂p/∂u.
        normals: TextureId,
        /// Factor on the normals' x and y.
        scale: f32,
        /// What y is along.
        axes: NormalAxes,
        /// Where the bent normals are of no use.
        limits: BendLimits,
        /// What is shaded.
        nested: MaterialId,
    },
    /// A mixture.
    Blend {
        /// Fraction of `second`.
        weight: TextureId,
        /// Where the weight is 0.
        first: MaterialId,
        /// Where it is 1.
        second: MaterialId,
    },
}

/// What becomes of shading normals that a bump or normal map bent so far that they are seen from behind, or that light
/// ends abruptly where it should fade. The default leaves both black.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BendLimits {
    /// A normal on the far side of the viewer is turned by half a turn about the surface's own.
    pub turns_to_viewer: bool,
    /// Light fades towards grazing directions by the masking of microfacets as steep as the bent normal (Estevez, Lecocq
    /// and Stein 2019).
    pub softens_terminator: bool,
}

/// The second axis of normal maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NormalAxes {
    /// The normal cross the first axis, however the picture lies on the surface (Mitsuba).
    RightHanded,
    /// Towards the top of the picture, by the mesh's tangents where it has such, else as the texture coordinates of the
    /// picture have it; so is the first, towards its right (glTF).
    OfPicture,
}

/// Parameters of clear materials.
#[derive(Clone, Copy, Debug)]
pub struct Dielectric {
    /// Index of refraction, inside over outside.
    pub eta: f32,
    /// Factor on what is reflected.
    pub specular_reflectance: TextureId,
    /// Factor on what is transmitted.
    pub specular_transmittance: TextureId,
}

/// Parameters of metals.
#[derive(Clone, Copy, Debug)]
pub struct Conductor {
    /// Real part of the index of refraction, relative to the outside. Zero, with `k` one, is a perfect mirror.
    pub eta: TextureId,
    /// Imaginary part.
    pub k: TextureId,
    /// Factor on what is reflected.
    pub specular_reflectance: TextureId,
}

/// Parameters of plastics.
#[derive(Clone, Copy, Debug)]
pub struct Plastic {
    /// Index of refraction, inside over outside.
    pub eta: f32,
    /// Colour of the base.
    pub diffuse_reflectance: TextureId,
    /// Factor on what the coat reflects.
    pub specular_reflectance: TextureId,
    /// Colours saturate by reflections inside.
    pub nonlinear: bool,
}

/// A rough surface.
#[derive(Clone, Copy, Debug)]
pub struct Roughness {
    /// Shape of the microfacets.
    pub distribution: Distribution,
    /// Roughness along ∂p/∂u.
    pub alpha_u: TextureId,
    /// Roughness across it.
    pub alpha_v: TextureId,
}

/// Parameters of [`Model::Principled`]; ranges 0–1 unless stated.
#[derive(Clone, Copy, Debug)]
pub struct Principled {
    /// Colour.
    pub base_color: TextureId,
    /// Roughness; microfacets have its square.
    pub roughness: TextureId,
    /// Stretch of highlights.
    pub anisotropic: TextureId,
    /// How much of a metal.
    pub metallic: TextureId,
    /// How much of a clear material.
    pub spec_trans: TextureId,
    /// Index of refraction, inside over outside, above 1.
    pub eta: f32,
    /// How much the highlight takes the base's colour.
    pub spec_tint: TextureId,
    /// Sheen at grazing angles.
    pub sheen: TextureId,
    /// How much the sheen takes the base's colour.
    pub sheen_tint: TextureId,
    /// How much the diffuse part looks like subsurface scattering.
    pub flatness: TextureId,
    /// Strength of a second, clear coat.
    pub clearcoat: TextureId,
    /// Its gloss.
    pub clearcoat_gloss: TextureId,
}

/// Parameters of [`Model::MetalRough`]; ranges 0–1 unless stated.
#[derive(Clone, Copy, Debug)]
pub struct MetalRough {
    /// Colour of the diffuse base, of the metal, and of what passes the surface.
    pub base_color: TextureId,
    /// How much of a metal.
    pub metallic: TextureId,
    /// Roughness; microfacets have its square.
    pub roughness: TextureId,
    /// What the dielectric reflects along the normal, before `specular`; taken as 1 where it is more.
    pub f0: TextureId,
    /// Factor on all that the dielectric reflects.
    pub specular: TextureId,
    /// The base has what `f0` leaves, 1 − its largest channel, beside what the angle leaves (specular glossiness).
    pub f0_dims_base: bool,
    /// How much of the base lets light through instead of scattering it.
    pub transmission: TextureId,
    /// Index of refraction, inside over outside, of a solid; `None`: a thin sheet.
    pub solid: Option<f32>,
    /// Strength of a clear coat.
    pub coat: TextureId,
    /// Its roughness.
    pub coat_roughness: TextureId,
    /// Its normals as for [`Model::NormalMap`], and the factor on their x and y; `None`: the surface's own.
    pub coat_normals: Option<(TextureId, f32)>,
}

/// Parameters of [`Model::ThinPrincipled`]; ranges 0–1 unless stated.
#[derive(Clone, Copy, Debug)]
pub struct ThinPrincipled {
    /// Colour of what is reflected diffusely, and by the metal.
    pub base_color: TextureId,
    /// Colour of what is transmitted.
    pub transmission_color: TextureId,
    /// How much of the diffuse light is transmitted instead of reflected.
    pub diff_trans: TextureId,
    /// Index of refraction of the coat over that of the air, from 1: no coat.
    pub eta: f32,
    /// Roughness of the coat and the metal; microfacets have its square.
    pub roughness: TextureId,
    /// How much of an opaque metal.
    pub metallic: TextureId,
}

/// Parameters of [`Model::Subsurface`].
#[derive(Clone, Debug)]
pub struct Subsurface {
    /// How light spreads.
    pub model: Arc<dyn Bssrdf>,
    /// Millimetres of the model for each unit of its space.
    pub mm_per_unit: f64,
    /// The model's space is the shape's own (as it is for objects that were captured), not the world.
    pub in_object_space: bool,
    /// Index of refraction, inside over outside.
    pub eta: f32,
    /// Shape and roughness of the boundary's microfacets; `None`: smooth.
    pub roughness: Option<(Distribution, f32)>,
    /// Factor on what the boundary reflects.
    pub specular_reflectance: TextureId,
}
