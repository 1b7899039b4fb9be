//! BSDFs whose shading normal a bump or normal map bent.
//!
//! - Light that the bent normal has on the other side than the surface's own would leak through: it is cut.
//! - A bent normal that the viewer sees from behind is turned by half a turn about the surface's own
//!   ([`BendLimits::turns_to_viewer`]). The BSDF then depends on the viewer through its frame, so it is not reciprocal; it is
//!   the same for walks from both ends, since each asks which of the two directions is the viewer's. Walks from lights do
//!   not know the viewer before they have drawn it: they choose between the two frames with fixed probabilities.
//! - Light fades towards grazing directions ([`BendLimits::softens_terminator`]): A. C. Estevez, P. Lecocq, C. Stein, "A
//!   Microfacet-Based Shadowing Function to Solve the Bump Terminator Problem", Ray Tracing Gems 2019.

use crate::Rgb;
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;
use translume_bxdf::{Bsdf, Flags, Mode, Sample};
use translume_core::frame::Frame;
use translume_scene::material::BendLimits;

/// How a map bent the frame of a BSDF.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bend {
    /// The surface's shading normal.
    unbent: Vec3,
    /// For viewers who would see the bent frame from behind, and the probability with which walks from lights draw in it.
    turned: Option<(Frame, f32)>,
    /// Squared roughness of the microfacets that mask, 0: none do.
    alpha2: f32,
}

impl Bend {
    /// From the shading normal `unbent` to `bent`, whose tangent is along `tangent`.
    pub(crate) fn new(unbent: Vec3, bent: Vec3, tangent: Vec3, limits: BendLimits) -> Self {
        let cos = unbent.dot(bent);
        let turned = limits.turns_to_viewer.then(|| {
            let frame = Frame::from_normal_tangent((2.0 * cos * unbent - bent).normalize_or(unbent), tangent);
            // Of the half circle of viewers in the plane of both normals, that part sees `bent` from behind.
            (frame, cos.clamp(-1.0, 1.0).acos() * FRAC_1_PI)
        });
        // Ray Tracing Gems, ch. 12: α² = tan² θ_n / 8, at most 1.
        let alpha2 = if limits.softens_terminator { (0.125 * tan2(cos)).min(1.0) } else { 0.0 };
        Self { unbent, turned, alpha2 }
    }

    /// The same with all normals on the other side.
    pub(crate) fn seen_from_behind(self) -> Self {
        let turned = self.turned.map(|(frame, chance)| (Frame { n: -frame.n, ..frame }, chance));
        Self { unbent: -self.unbent, turned, ..self }
    }

    /// The surface's shading normal before it was bent.
    pub(crate) fn unbent(&self) -> Vec3 {
        self.unbent
    }

    /// The frame for a viewer in this direction, of the bent one and its turned twin.
    #[inline]
    pub(super) fn frame(&self, bent: &Frame, viewer: Vec3) -> Frame {
        match self.turned {
            Some((turned, _)) if self.unbent.dot(viewer) * bent.n.dot(viewer) <= 0.0 => turned,
            _ => *bent,
        }
    }

    /// [`super::Shading::eval_cos_pdf`].
    pub(super) fn eval_cos_pdf(&self, bsdf: &Bsdf, bent: &Frame, wo: Vec3, wi: Vec3, mode: Mode) -> (Rgb, f32) {
        let (viewer, light) = if mode == Mode::Radiance { (wo, wi) } else { (wi, wo) };
        let own = self.frame(bent, viewer);
        if self.unbent.dot(light) * own.n.dot(light) <= 0.0 {
            return (Rgb::ZERO, 0.0);
        }
        let both = |frame: &Frame| {
            let local = frame.to_local(wi);
            let (f, pdf_w) = bsdf.eval_pdf(frame.to_local(wo), local, mode);
            (f * local.z.abs(), pdf_w)
        };
        let (value, mut pdf_w) = both(&own);
        if let (Mode::Importance, Some((turned, chance))) = (mode, self.turned) {
            let is_turned = own.n != bent.n;
            let other = both(if is_turned { bent } else { &turned }).1;
            let share = if is_turned { chance } else { 1.0 - chance };
            pdf_w = share * pdf_w + (1.0 - share) * other;
        }
        (value * self.masking(light), pdf_w)
    }

    /// [`super::Shading::sample`].
    pub(super) fn sample(
        &self,
        bsdf: &Bsdf,
        bent: &Frame,
        wo: Vec3,
        mut u_lobe: f32,
        u: Vec2,
        mode: Mode,
    ) -> Option<Sample> {
        let (frame, share) = match (mode, self.turned) {
            (Mode::Radiance, _) => (self.frame(bent, wo), 1.0),
            (Mode::Importance, None) => (*bent, 1.0),
            (Mode::Importance, Some((turned, chance))) if u_lobe < chance => {
                u_lobe /= chance;
                (turned, chance)
            }
            (Mode::Importance, Some((_, chance))) => {
                u_lobe = ((u_lobe - chance) / (1.0 - chance)).min(1.0 - f32::EPSILON / 2.0);
                (*bent, 1.0 - chance)
            }
        };
        let mut sample = bsdf.sample(frame.to_local(wo), u_lobe, u, mode)?;
        // A straight pass is no matter of frames: both would have gone on.
        if sample.flags.contains(Flags::NULL) {
            sample.wi = -wo;
            return Some(sample);
        }
        sample.wi = frame.to_world(sample.wi);
        let (viewer, light) = if mode == Mode::Radiance { (wo, sample.wi) } else { (sample.wi, wo) };
        let is_cut = self.unbent.dot(light) * frame.n.dot(light) <= 0.0;
        if sample.flags.contains(Flags::DELTA) {
            if is_cut || self.frame(bent, viewer).n != frame.n {
                return None;
            }
            sample.weight *= self.masking(light) / share;
            sample.pdf_w *= share;
        } else if mode == Mode::Importance && self.turned.is_some() {
            let (value, pdf_w) = self.eval_cos_pdf(bsdf, bent, wo, sample.wi, mode);
            if pdf_w <= 0.0 {
                return None;
            }
            (sample.weight, sample.pdf_w) = (value / pdf_w, pdf_w);
        } else {
            if is_cut {
                return None;
            }
            sample.weight *= self.masking(light);
        }
        Some(sample)
    }

    /// Smith's masking of `light` over microfacets about the surface's own normal.
    #[inline]
    fn masking(&self, light: Vec3) -> f32 {
        if self.alpha2 == 0.0 {
            return 1.0;
        }
        2.0 / (1.0 + (1.0 + self.alpha2 * tan2(self.unbent.dot(light))).sqrt())
    }
}

/// Squared tangent of the angle of this cosine.
#[inline]
fn tan2(cos: f32) -> f32 {
    let cos2 = cos * cos;
    (1.0 - cos2).max(0.0) / cos2.max(f32::MIN_POSITIVE)
}
