//! Phase functions: where light goes that a volume scatters.
//!
//! Sources: Henyey & Greenstein 1941; Rayleigh's dipole pattern, sampled by Cardano's formula (Frisvad 2011). Both directions
//! point AWAY from the point, as for BSDFs: forward scattering is wi = −wo. The value is the density: it integrates to one.

use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, TAU};
use translume_core::frame::Frame;

/// The closed set of phase functions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Phase {
    /// Uniform.
    Isotropic,
    /// Mean cosine `g` in (−1, 1), positive forwards.
    HenyeyGreenstein {
        /// Mean cosine of the deflection.
        g: f32,
    },
    /// Scatterers much smaller than the wavelength.
    Rayleigh,
}

impl Phase {
    /// Value and density per solid angle.
    #[inline]
    pub fn pdf_w(&self, wo: Vec3, wi: Vec3) -> f32 {
        let cos = -wo.dot(wi);
        match *self {
            Self::Isotropic => 0.25 * FRAC_1_PI,
            Self::HenyeyGreenstein { g } => {
                let t = (1.0 + g * g - 2.0 * g * cos).max(1e-12);
                0.25 * FRAC_1_PI * (1.0 - g * g) / (t * t.sqrt())
            }
            Self::Rayleigh => 3.0 / 16.0 * FRAC_1_PI * (1.0 + cos * cos),
        }
    }

    /// Draws `wi` with density [`Phase::pdf_w`].
    #[inline]
    pub fn sample(&self, wo: Vec3, u: Vec2) -> Vec3 {
        let cos = match *self {
            Self::HenyeyGreenstein { g } if g.abs() > 1e-3 => {
                let t = (1.0 - g * g) / (1.0 - g + 2.0 * g * u.x);
                (1.0 + g * g - t * t) / (2.0 * g)
            }
            // To first order in g, where the inverse above cancels.
            Self::HenyeyGreenstein { g } => {
                let x = 2.0 * u.x - 1.0;
                x + 1.5 * g * (1.0 - x * x)
            }
            Self::Isotropic => 2.0 * u.x - 1.0,
            Self::Rayleigh => {
                let z = 2.0 * (2.0 * u.x - 1.0);
                let t = (z * z + 1.0).sqrt();
                (z + t).cbrt() + (z - t).cbrt()
            }
        }
        .clamp(-1.0, 1.0);
        let sin = (1.0 - cos * cos).sqrt();
        let (sin_phi, cos_phi) = (TAU * u.y).sin_cos();
        Frame::from_normal(-wo).to_world(Vec3::new(sin * cos_phi, sin * sin_phi, cos))
    }

    /// Mean cosine of the deflection.
    pub fn mean_cosine(&self) -> f32 {
        match *self {
            Self::HenyeyGreenstein { g } => g,
            Self::Isotropic | Self::Rayleigh => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use translume_core::chi2::SphereTest;

    const ALL: [Phase; 6] = [
        Phase::Isotropic,
        Phase::HenyeyGreenstein { g: 0.8 },
        Phase::HenyeyGreenstein { g: -0.5 },
        Phase::HenyeyGreenstein { g: 5e-4 },
        Phase::HenyeyGreenstein { g: 0.0 },
        Phase::Rayleigh,
    ];

    #[test]
    fn samples_follow_the_density_and_it_integrates_to_one() {
        let wo = Vec3::new(0.3, -0.5, 0.2).normalize();
        for phase in ALL {
            let sample =
                |r: &mut translume_core::rng::Pcg32| Some(phase.sample(wo, Vec2::new(r.next_f32(), r.next_f32())));
            // What is missing from one would be a cell of dropped samples, which never come.
            SphereTest::default().run(&format!("{phase:?}"), sample, |wi| phase.pdf_w(wo, wi), ALL.len()).unwrap();
        }
    }

    #[test]
    fn mean_cosine_is_the_mean_cosine() {
        for phase in ALL {
            let n = 10_000;
            // Quadrature over the cosine.
            let mean: f64 = (0..n)
                .map(|i| {
                    let cos = (i as f32 + 0.5) / n as f32 * 2.0 - 1.0;
                    let wi = Vec3::new((1.0 - cos * cos).sqrt(), 0.0, cos);
                    f64::from(phase.pdf_w(-Vec3::Z, wi) * cos) * std::f64::consts::TAU * 2.0 / f64::from(n)
                })
                .sum();
            assert!((mean - f64::from(phase.mean_cosine())).abs() < 1e-3, "{phase:?} {mean}");
        }
    }
}
