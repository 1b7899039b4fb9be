//! The BSDF at a shading point: flags, samples, the closed set of models and the adapters over them.

use crate::{
    CoatedSheet, Conductor, Dielectric, Diffuse, DiffuseSheet, Entrance, MetalRough, Plastic, Principled, Rgb,
    RoughConductor, RoughDielectric, RoughPlastic, Skin, ThinDielectric, fresnel,
};
use glam::{Vec2, Vec3};

/// What is carried along the path, which decides how refraction scales it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Radiance, on paths from the camera.
    Radiance,
    /// Importance, on paths from the lights.
    Importance,
}

/// A set of properties of a BSDF or of one sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Flags(u8);

impl Flags {
    /// None.
    pub const EMPTY: Self = Self(0);
    /// Scatters to the side it came from.
    pub const REFLECTION: Self = Self(1);
    /// Scatters to the other side.
    pub const TRANSMISSION: Self = Self(2);
    /// A smooth lobe over the whole hemisphere.
    pub const DIFFUSE: Self = Self(4);
    /// A concentrated lobe with a density.
    pub const GLOSSY: Self = Self(8);
    /// A lobe of single directions: no density per solid angle.
    pub const DELTA: Self = Self(16);
    /// Passes straight through, as if nothing were there (comes with `DELTA` and `TRANSMISSION`).
    pub const NULL: Self = Self(32);
    /// Goes under the surface; where it comes from there, and how much, is for a [`crate::bssrdf::Bssrdf`] to say. A sample has
    /// what the boundary lets through as its weight, the choice's probability as density, and no direction of its own.
    pub const SUBSURFACE: Self = Self(64);

    /// Union.
    #[inline]
    pub const fn or(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Whether all of `other` are set.
    #[inline]
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Whether any of `other` is set.
    #[inline]
    pub const fn intersects(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    /// Whether there is a lobe with a density, so that light sampling can contribute.
    #[inline]
    pub const fn has_smooth(self) -> bool {
        self.intersects(Self::DIFFUSE.or(Self::GLOSSY))
    }
}

/// A sampled direction.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Sampled direction.
    pub wi: Vec3,
    /// f·|cos θ_i|/pdf, what the path's throughput is multiplied by.
    pub weight: Rgb,
    /// Density per solid angle of `wi`, over all smooth lobes; for delta lobes the probability of having chosen the lobe.
    pub pdf_w: f32,
    /// The sampled lobe.
    pub flags: Flags,
    /// Index of refraction on the side of `wi` over that on the side of `wo`; 1 unless refracted.
    pub eta: f32,
}

impl Sample {
    /// Goes straight on.
    #[inline]
    pub(crate) fn pass_through(wo: Vec3, weight: Rgb, probability: f32) -> Self {
        let flags = Flags::TRANSMISSION.or(Flags::DELTA).or(Flags::NULL);
        Self { wi: -wo, weight, pdf_w: probability, flags, eta: 1.0 }
    }

    /// The BSDF's value at the sample (delta lobes: times the delta function), recovered from the weight.
    #[inline]
    pub fn value(&self) -> Rgb {
        self.weight * (self.pdf_w / self.wi.z.abs())
    }
}

/// A model from outside this crate, as measured materials are. The contract is that of the crate's front page, at the
/// texture coordinates `uv`.
pub trait CustomBsdf: Send + Sync + std::fmt::Debug {
    /// Value (without cosine) and density per solid angle.
    fn eval_pdf(&self, uv: Vec2, wo: Vec3, wi: Vec3, mode: Mode) -> (Rgb, f32);
    /// Draws `wi`.
    fn sample(&self, uv: Vec2, wo: Vec3, u_lobe: f32, u: Vec2, mode: Mode) -> Option<Sample>;
    /// All lobes there may be.
    fn flags(&self) -> Flags;
    /// An estimate of the reflected fraction, for feature images.
    fn albedo(&self, uv: Vec2) -> Rgb;
}

/// A [`CustomBsdf`] at a place.
#[derive(Clone, Copy)]
pub struct Custom<'a> {
    /// The model.
    pub model: &'a dyn CustomBsdf,
    /// Where.
    pub uv: Vec2,
}

impl std::fmt::Debug for Custom<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "Custom at {}", self.uv)
    }
}

/// A linear mixture: (1 − weight)·first + weight·second.
#[derive(Clone, Debug)]
pub struct Blend<'a> {
    /// Share of `second`, in [0, 1].
    pub weight: f32,
    /// What there is at weight 0.
    pub first: Bsdf<'a>,
    /// What there is at weight 1.
    pub second: Bsdf<'a>,
}

/// The models.
#[derive(Clone, Debug)]
pub enum Model<'a> {
    /// No interface: everything passes straight through.
    Null,
    /// See [`Diffuse`].
    Diffuse(Diffuse),
    /// See [`DiffuseSheet`].
    DiffuseSheet(DiffuseSheet),
    /// See [`CoatedSheet`].
    CoatedSheet(CoatedSheet<'a>),
    /// See [`Conductor`].
    Conductor(Conductor),
    /// See [`RoughConductor`].
    RoughConductor(RoughConductor),
    /// See [`Dielectric`].
    Dielectric(Dielectric),
    /// See [`ThinDielectric`].
    ThinDielectric(ThinDielectric),
    /// See [`RoughDielectric`].
    RoughDielectric(RoughDielectric),
    /// See [`Plastic`].
    Plastic(Plastic),
    /// See [`RoughPlastic`].
    RoughPlastic(RoughPlastic<'a>),
    /// See [`Principled`].
    Principled(Principled),
    /// See [`MetalRough`].
    MetalRough(MetalRough),
    /// See [`Skin`].
    Skin(Skin<'a>),
    /// See [`Entrance`].
    Entrance(Entrance<'a>),
    /// See [`Blend`]; boxed, since it is the one model that contains others.
    Blend(Box<Blend<'a>>),
    /// See [`CustomBsdf`].
    Custom(Custom<'a>),
}

/// A model with its adapters, at a shading point.
#[derive(Clone, Debug)]
pub struct Bsdf<'a> {
    /// The model.
    pub model: Model<'a>,
    /// Share of what meets the model, in [0, 1]; the rest passes straight through (Mitsuba's `mask`).
    pub opacity: f32,
    /// Whether the back looks like the front (Mitsuba's `twosided` with one child; with two, choose the child by the side of
    /// `wo`). For models that do not refract.
    pub two_sided: bool,
}

impl<'a> Bsdf<'a> {
    /// The bare model.
    #[inline]
    pub fn new(model: Model<'a>) -> Self {
        Self { model, opacity: 1.0, two_sided: false }
    }

    /// The same with the front's looks on both sides.
    #[inline]
    pub fn two_sided(self) -> Self {
        Self { two_sided: true, ..self }
    }

    /// The same, but of what meets it only `opacity` does.
    #[inline]
    pub fn with_opacity(self, opacity: f32) -> Self {
        Self { opacity: opacity.clamp(0.0, 1.0) * self.opacity, ..self }
    }

    /// Value without the cosine.
    #[inline]
    pub fn eval(&self, wo: Vec3, wi: Vec3, mode: Mode) -> Rgb {
        self.eval_pdf(wo, wi, mode).0
    }

    /// Density of [`Bsdf::sample`] per solid angle of `wi`.
    #[inline]
    pub fn pdf_w(&self, wo: Vec3, wi: Vec3, mode: Mode) -> f32 {
        self.eval_pdf(wo, wi, mode).1
    }

    /// Value without the cosine, and density per solid angle of `wi`, for the price of one.
    #[inline]
    pub fn eval_pdf(&self, wo: Vec3, wi: Vec3, mode: Mode) -> (Rgb, f32) {
        let (wo, wi) = if self.two_sided && wo.z < 0.0 { (flip(wo), flip(wi)) } else { (wo, wi) };
        let (f, pdf) = match &self.model {
            Model::Null | Model::Conductor(_) | Model::Dielectric(_) | Model::ThinDielectric(_) => (Rgb::ZERO, 0.0),
            Model::Diffuse(m) => m.eval_pdf(wo, wi),
            Model::DiffuseSheet(m) => m.eval_pdf(wo, wi),
            Model::CoatedSheet(m) => m.eval_pdf(wo, wi),
            Model::RoughConductor(m) => m.eval_pdf(wo, wi),
            Model::RoughDielectric(m) => m.eval_pdf(wo, wi, mode),
            Model::Plastic(m) => m.eval_pdf(wo, wi),
            Model::RoughPlastic(m) => m.eval_pdf(wo, wi),
            Model::Principled(m) => m.eval_pdf(wo, wi, mode),
            Model::MetalRough(m) => m.eval_pdf(wo, wi, mode),
            Model::Skin(m) => m.eval_pdf(wo, wi),
            Model::Entrance(m) => m.eval_pdf(wo, wi),
            Model::Blend(m) => m.eval_pdf(wo, wi, mode),
            Model::Custom(m) => m.model.eval_pdf(m.uv, wo, wi, mode),
        };
        (f * self.opacity, pdf * self.opacity)
    }

    /// Draws `wi` from three uniform numbers: `u_lobe` chooses among lobes, `u` a direction in it. `None`: absorbed.
    #[inline]
    pub fn sample(&self, wo: Vec3, u_lobe: f32, u: Vec2, mode: Mode) -> Option<Sample> {
        let mut u_lobe = u_lobe;
        if self.opacity < 1.0 {
            if u_lobe >= self.opacity {
                return Some(Sample::pass_through(wo, Rgb::ONE, 1.0 - self.opacity));
            }
            u_lobe /= self.opacity;
        }
        let flipped = self.two_sided && wo.z < 0.0;
        let wo = if flipped { flip(wo) } else { wo };
        let mut sample = match &self.model {
            Model::Null => Some(Sample::pass_through(wo, Rgb::ONE, 1.0)),
            Model::Diffuse(m) => m.sample(wo, u),
            Model::DiffuseSheet(m) => m.sample(wo, u_lobe, u),
            Model::CoatedSheet(m) => m.sample(wo, u_lobe, u),
            Model::Conductor(m) => m.sample(wo),
            Model::RoughConductor(m) => m.sample(wo, u),
            Model::Dielectric(m) => m.sample(wo, u_lobe, mode),
            Model::ThinDielectric(m) => m.sample(wo, u_lobe),
            Model::RoughDielectric(m) => m.sample(wo, u_lobe, u, mode),
            Model::Plastic(m) => m.sample(wo, u_lobe, u),
            Model::RoughPlastic(m) => m.sample(wo, u_lobe, u),
            Model::Principled(m) => m.sample(wo, u_lobe, u, mode),
            Model::MetalRough(m) => m.sample(wo, u_lobe, u, mode),
            Model::Skin(m) => m.sample(wo, u_lobe, u),
            Model::Entrance(m) => m.sample(wo, u),
            Model::Blend(m) => m.sample(wo, u_lobe, u, mode),
            Model::Custom(m) => m.model.sample(m.uv, wo, u_lobe, u, mode),
        }?;
        sample.pdf_w *= self.opacity;
        if flipped {
            sample.wi = flip(sample.wi);
        }
        Some(sample)
    }

    /// Whether it is [`Diffuse`] and nothing else: what leaves it on one side is the same in all directions.
    #[inline]
    pub fn is_lambertian(&self) -> bool {
        matches!(self.model, Model::Diffuse(_)) && self.opacity >= 1.0
    }

    /// All lobes there may be.
    #[inline]
    pub fn flags(&self) -> Flags {
        let null = Flags::TRANSMISSION.or(Flags::DELTA).or(Flags::NULL);
        let flags = match &self.model {
            Model::Null => null,
            Model::Diffuse(_) => Diffuse::FLAGS,
            Model::DiffuseSheet(_) => DiffuseSheet::FLAGS,
            Model::CoatedSheet(_) => CoatedSheet::FLAGS,
            Model::Conductor(_) => Conductor::FLAGS,
            Model::RoughConductor(_) => RoughConductor::FLAGS,
            Model::Dielectric(_) => Dielectric::FLAGS,
            Model::ThinDielectric(_) => ThinDielectric::FLAGS,
            Model::RoughDielectric(_) => RoughDielectric::FLAGS,
            Model::Plastic(_) => Plastic::FLAGS,
            Model::RoughPlastic(_) => RoughPlastic::FLAGS,
            Model::Principled(m) => m.flags(),
            Model::MetalRough(m) => m.flags(),
            Model::Skin(m) => m.flags(),
            Model::Entrance(_) => Entrance::FLAGS,
            Model::Blend(m) => m.first.flags().or(m.second.flags()),
            Model::Custom(m) => m.model.flags(),
        };
        if self.opacity < 1.0 { flags.or(null) } else { flags }
    }

    /// What passes straight through for a ray along `wo`: 0 for opaque models, 1 for [`Model::Null`].
    #[inline]
    pub fn null_transmittance(&self, wo: Vec3) -> Rgb {
        let wo = if self.two_sided && wo.z < 0.0 { flip(wo) } else { wo };
        let model = match &self.model {
            Model::Null => Rgb::ONE,
            Model::MetalRough(m) => m.straight(wo),
            Model::ThinDielectric(m) => m.specular_transmittance * (1.0 - m.reflectance(wo)),
            Model::Blend(m) => m.first.null_transmittance(wo).lerp(m.second.null_transmittance(wo), m.weight),
            _ => Rgb::ZERO,
        };
        model * self.opacity + Rgb::splat(1.0 - self.opacity)
    }

    /// An estimate of the scattered fraction, for feature images: the colour without the light.
    pub fn albedo(&self) -> Rgb {
        match &self.model {
            Model::Null => Rgb::ONE,
            Model::Diffuse(m) => m.reflectance,
            Model::DiffuseSheet(m) => m.reflectance + m.transmittance,
            Model::CoatedSheet(m) => m.albedo(),
            Model::Conductor(m) => m.fresnel(1.0),
            Model::RoughConductor(m) => m.metal.fresnel(1.0),
            Model::Dielectric(m) => mix_by_fresnel(m.eta, m.specular_reflectance, m.specular_transmittance),
            Model::ThinDielectric(m) => mix_by_fresnel(m.eta, m.specular_reflectance, m.specular_transmittance),
            Model::RoughDielectric(m) => mix_by_fresnel(m.eta, m.specular_reflectance, m.specular_transmittance),
            Model::Plastic(m) => m.diffuse_reflectance,
            Model::RoughPlastic(m) => m.diffuse_reflectance,
            Model::Principled(m) => m.base_color,
            Model::MetalRough(m) => m.base_color,
            Model::Skin(m) => m.albedo,
            Model::Entrance(_) => Rgb::ONE,
            Model::Blend(m) => m.first.albedo().lerp(m.second.albedo(), m.weight),
            Model::Custom(m) => m.model.albedo(m.uv),
        }
    }
}

macro_rules! bsdf_from {
    ($($model:ident: $type:ty),+) => {$(
        impl<'a> From<$type> for Bsdf<'a> {
            #[inline]
            fn from(model: $type) -> Self {
                Self::new(Model::$model(model))
            }
        }
    )+};
}

bsdf_from!(Diffuse: Diffuse, DiffuseSheet: DiffuseSheet, Conductor: Conductor, RoughConductor: RoughConductor, Dielectric: Dielectric);
bsdf_from!(ThinDielectric: ThinDielectric, RoughDielectric: RoughDielectric, Plastic: Plastic);
bsdf_from!(MetalRough: MetalRough, RoughPlastic: RoughPlastic<'a>, Principled: Principled, Blend: Box<Blend<'a>>, Custom: Custom<'a>);
bsdf_from!(CoatedSheet: CoatedSheet<'a>, Skin: Skin<'a>, Entrance: Entrance<'a>);

impl Blend<'_> {
    fn eval_pdf(&self, wo: Vec3, wi: Vec3, mode: Mode) -> (Rgb, f32) {
        let (f0, p0) = self.first.eval_pdf(wo, wi, mode);
        let (f1, p1) = self.second.eval_pdf(wo, wi, mode);
        (f0.lerp(f1, self.weight), p0 + (p1 - p0) * self.weight)
    }

    fn sample(&self, wo: Vec3, u_lobe: f32, u: Vec2, mode: Mode) -> Option<Sample> {
        let (chosen, share, u_lobe) = if u_lobe < self.weight {
            (&self.second, self.weight, u_lobe / self.weight)
        } else {
            (&self.first, 1.0 - self.weight, (u_lobe - self.weight) / (1.0 - self.weight))
        };
        let sample = chosen.sample(wo, u_lobe, u, mode)?;
        if sample.flags.contains(Flags::DELTA) {
            return Some(Sample { pdf_w: sample.pdf_w * share, ..sample });
        }
        // One-sample estimate over both: less variance than the chosen one's own weight, and a density that matches.
        let (f, pdf_w) = self.eval_pdf(wo, sample.wi, mode);
        (pdf_w > 0.0).then(|| Sample { weight: f * (sample.wi.z.abs() / pdf_w), pdf_w, ..sample })
    }
}

/// The other side of the surface.
#[inline]
fn flip(w: Vec3) -> Vec3 {
    Vec3::new(w.x, w.y, -w.z)
}

fn mix_by_fresnel(eta: f32, reflectance: Rgb, transmittance: Rgb) -> Rgb {
    transmittance.lerp(reflectance, fresnel::dielectric(1.0, eta).reflectance)
}
