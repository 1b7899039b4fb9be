//! What is known of materials without a place: worked out once for each, from those that it refers to.

use super::is_matched;
use super::mixture::Mixture;
use crate::{Error, Result, Rgb};
use translume_scene::material::Model;
use translume_scene::{MaterialId, Scene};

/// Of a material, through adapters.
#[derive(Clone)]
pub(crate) struct Traits {
    /// Light may pass it straight; in any way.
    pub(crate) passes: (bool, bool),
    /// Front and back differ by [`Model::TwoSided`].
    pub(crate) sided: bool,
    /// The subsurface material that it is; an error for mixtures with one: light that goes in at one place and out at another has
    /// no share of both.
    subsurface: std::result::Result<Option<MaterialId>, String>,
    /// Materials that are looked at where it is shaded; `None`: too many.
    parts: Option<usize>,
}

/// Materials that one may be made of where it is shaded, adapters counted.
const MOST_PARTS: usize = 2048;

impl Traits {
    /// See [`Traits::subsurface`]; also refuses what would take too long.
    ///
    /// # Errors
    /// [`Error::Scene`].
    pub(crate) fn subsurface(&self) -> Result<Option<MaterialId>> {
        if self.parts.is_none() {
            let what =
                "a material is nested too deep: with masks, bumps and blends of each other it has too many parts";
            return Err(Error::Scene(what.into()));
        }
        self.subsurface.clone().map_err(Error::Scene)
    }

    fn plain(passes: (bool, bool)) -> Self {
        Self { passes, sided: false, subsurface: Ok(None), parts: Some(1) }
    }

    fn with(mut self, more: usize) -> Self {
        self.parts = self.parts.and_then(|n| n.checked_add(more)).filter(|n| *n <= MOST_PARTS);
        self
    }
}

/// The traits of all materials, and the mixtures among them.
pub(crate) fn traits(scene: &Scene) -> (Vec<Traits>, Vec<Option<Mixture>>) {
    let (mut all, mut mixtures): (Vec<Traits>, _) = (Vec::with_capacity(scene.materials.len()), Vec::new());
    for number in 0..scene.materials.len() {
        let mixture = Mixture::new(scene, MaterialId(number));
        let made = match &mixture {
            Ok(mixture) => of(scene, MaterialId(number), mixture.as_ref(), &all),
            Err(what) => Traits { subsurface: Err(what.clone()), ..Traits::plain((false, false)) },
        };
        all.push(made);
        mixtures.push(mixture.unwrap_or(None));
    }
    (all, mixtures)
}

/// Of one, by those before it.
fn of(scene: &Scene, id: MaterialId, mixture: Option<&Mixture>, all: &[Traits]) -> Traits {
    let both = |a: (bool, bool), b: (bool, bool)| (a.0 || b.0, a.1 || b.1);
    let is = |texture, value| scene.constant(texture) == Some(value);
    let before = |id: &MaterialId| all[id.0].clone();
    match &scene.materials[id.0].model {
        Model::Null | Model::ThinDielectric(_) => Traits::plain((true, true)),
        Model::Dielectric(d) | Model::RoughDielectric { dielectric: d, .. } => Traits::plain((is_matched(d), true)),
        Model::Principled(p) => Traits::plain((false, !is(p.spec_trans, Rgb::ZERO))),
        Model::MetalRough(p) => {
            let through = !is(p.transmission, Rgb::ZERO);
            let smooth = scene.constant(p.roughness).map_or(0.0, |r| r.x);
            let straight = translume_bxdf::MetalRough::is_straight(p.solid.is_none(), p.solid.unwrap_or(1.0), smooth);
            Traits::plain((through && straight, through))
        }
        Model::DiffuseTransmission { transmittance, .. } => Traits::plain((false, !is(*transmittance, Rgb::ZERO))),
        Model::ThinPrincipled(p) => Traits::plain((false, !is(p.diff_trans, Rgb::ZERO))),
        Model::Subsurface(_) => Traits { subsurface: Ok(Some(id)), ..Traits::plain((false, false)) },
        Model::TwoSided { front, back } => {
            let (front, back) = (before(front), before(back));
            let parts = front.parts.zip(back.parts).map(|(a, b)| a.max(b));
            Traits { passes: both(front.passes, back.passes), sided: true, parts, ..front }.with(1)
        }
        Model::Mask { opacity, nested } => {
            let (nested, open) = (before(nested), !is(*opacity, Rgb::ONE));
            Traits { passes: both((open, open), nested.passes), ..nested }.with(1)
        }
        Model::BumpMap { nested, .. } | Model::NormalMap { nested, .. } => before(nested).with(1),
        Model::Blend { .. } => {
            let mut whole = Traits::plain((false, false));
            for part in mixture.iter().flat_map(|m| m.materials()).map(before) {
                whole.passes = both(whole.passes, part.passes);
                whole.sided |= part.sided;
                whole.parts = whole.parts.zip(part.parts).map(|(a, b)| a.saturating_add(b));
                if !matches!(part.subsurface, Ok(None)) {
                    whole.subsurface = Err("a mixture with a subsurface material is not supported".into());
                }
            }
            whole.with(0)
        }
        _ => Traits::plain((false, false)),
    }
}
