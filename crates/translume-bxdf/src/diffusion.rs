//! Diffusion dipoles and normalised diffusion: the reflectance of a half-space of homogeneous material around a lit point.
//!
//! Sources: Jensen, Marschner, Levoy, Hanrahan 2001 ("dipole"); d'Eon 2012 "A Better Dipole" after d'Eon & Irving 2011
//! ("better dipole": Grosjean's diffusion coefficient, the exitance of Kienle & Patterson); Burley 2015 ("normalised").
//! The moments C1 = ∫ F(μ) μ dμ and C2 = ∫ F(μ) μ² dμ of the internal Fresnel reflectance are integrated here instead of
//! the polynomials of the paper. Both dipoles set the real source at depth 1/σt′, for a beam of normal incidence without its
//! Fresnel loss, so that R_d is the R_d of the measurement equation.

use crate::fresnel;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Which dipole.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DipoleKind {
    /// Jensen et al. 2001.
    Dipole,
    /// d'Eon 2012.
    BetterDipole,
}

/// What of a dipole depends on the index of refraction alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Boundary {
    kind: DipoleKind,
    /// The extrapolation distance is 2 A D.
    a: f64,
    c_phi: f64,
    c_e: f64,
}

impl Boundary {
    /// Which dipole it belongs to.
    pub fn kind(&self) -> DipoleKind {
        self.kind
    }

    /// For the relative index of refraction `eta` ≥ 1.
    pub fn new(kind: DipoleKind, eta: f64) -> Self {
        match kind {
            DipoleKind::Dipole => {
                let f = f64::from(fresnel::diffuse_reflectance(1.0 / eta as f32));
                let f = if eta == 1.0 { 0.0 } else { f }; // the fit is not made for 1
                Self { kind, a: (1.0 + f) / (1.0 - f), c_phi: 0.0, c_e: 1.0 }
            }
            DipoleKind::BetterDipole => {
                let n = 4096;
                let (mut c1, mut c2) = (0.0, 0.0);
                for i in 0..n {
                    let mu = (f64::from(i) + 0.5) / f64::from(n);
                    let f = f64::from(fresnel::dielectric(-mu as f32, eta as f32).reflectance) / f64::from(n);
                    c1 += f * mu;
                    c2 += f * mu * mu;
                }
                let a = (1.0 + 3.0 * c2) / (1.0 - 2.0 * c1);
                Self { kind, a, c_phi: 0.25 * (1.0 - 2.0 * c1), c_e: 0.5 * (1.0 - 3.0 * c2) }
            }
        }
    }
}

/// A dipole with its material.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dipole {
    /// Which formula.
    pub kind: DipoleKind,
    /// Reduced scattering coefficient σs′ in mm⁻¹.
    pub sigma_s_prime: f64,
    /// Absorption coefficient σa in mm⁻¹.
    pub sigma_a: f64,
    /// Relative index of refraction.
    pub eta: f64,
    /// Factor on the reflectance, 1 where the samples are absolute.
    pub scale: f64,
}

impl Dipole {
    /// R_d in mm⁻² at distance `r` in mm.
    pub fn value(&self, r: f64) -> f64 {
        self.sources().value(r)
    }

    /// The two sources, to evaluate at many distances.
    pub fn sources(&self) -> Sources {
        self.sources_behind(&Boundary::new(self.kind, self.eta))
    }

    /// ∫ R_d dA over the plane, in closed form.
    pub fn total(&self) -> f64 {
        let s = self.sources();
        let decay = |z: f64| (-s.sigma_tr * z).exp();
        let flux = 0.5 * (decay(s.real) + decay(s.mirror));
        // (e^{−σ z} − e^{−σ m}) / (2 D σ), whose limit for σ → 0 is (m − z)/(2 D).
        let fluence = match s.sigma_tr * s.mirror < 1e-9 {
            true => (s.mirror - s.real) / (2.0 * s.diffusion),
            false => (decay(s.real) - decay(s.mirror)) / (2.0 * s.diffusion * s.sigma_tr),
        };
        s.strength * (s.c_phi * fluence + s.c_e * flux)
    }

    /// [`Dipole::sources`] with the boundary known already.
    pub fn sources_behind(&self, boundary: &Boundary) -> Sources {
        let sigma_t = self.sigma_s_prime + self.sigma_a;
        let albedo = self.sigma_s_prime / sigma_t;
        let (diffusion, strength) = match boundary.kind {
            DipoleKind::Dipole => (1.0 / (3.0 * sigma_t), albedo),
            // Grosjean: D = (2σa + σs′)/(3σt′²), and a second factor α′ because the unscattered light is apart.
            DipoleKind::BetterDipole => {
                ((2.0 * self.sigma_a + self.sigma_s_prime) / (3.0 * sigma_t * sigma_t), albedo * albedo)
            }
        };
        let real = 1.0 / sigma_t;
        Sources {
            sigma_tr: (self.sigma_a / diffusion).sqrt(),
            diffusion,
            real,
            mirror: real + 4.0 * boundary.a * diffusion,
            strength: self.scale * strength,
            c_phi: boundary.c_phi,
            c_e: boundary.c_e,
        }
    }
}

/// The two sources of a dipole, below and above the surface.
pub struct Sources {
    sigma_tr: f64,
    diffusion: f64,
    /// Depth of the real source in mm.
    real: f64,
    /// Height of the mirrored one.
    mirror: f64,
    strength: f64,
    c_phi: f64,
    c_e: f64,
}

impl Sources {
    /// R_d in mm⁻² at distance `r` in mm.
    pub fn value(&self, r: f64) -> f64 {
        let (mut flux, mut fluence) = (0.0, 0.0);
        for (z, sign) in [(self.real, 1.0), (self.mirror, -1.0)] {
            let d = (r * r + z * z).sqrt();
            let e = (-self.sigma_tr * d).exp() / d;
            flux += z * (1.0 + self.sigma_tr * d) * e / (d * d);
            fluence += sign * e / self.diffusion;
        }
        self.strength / (4.0 * PI) * (self.c_phi * fluence + self.c_e * flux)
    }
}

/// Normalised diffusion: R(r) = A (e^{−r/d} + e^{−r/3d}) / (8π d r).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Normalized {
    /// A, the integral of R over the plane.
    pub albedo: f64,
    /// d in mm.
    pub shape: f64,
    /// The mean free path in mm that Burley's fit for a searchlight of normal incidence gives to A and d; `None` for A > 1.
    pub mean_free_path: Option<f64>,
}

impl Normalized {
    /// With the mean free path that belongs to it.
    pub fn new(albedo: f64, shape: f64) -> Self {
        // s(A) of the searchlight configuration [Burley 2015, Eq. 6]; d = ℓ/s.
        let s = 1.85 - albedo + 7.0 * (albedo - 0.8).abs().powi(3);
        Self { albedo, shape, mean_free_path: (albedo <= 1.0).then_some(shape * s) }
    }

    /// R in mm⁻² at distance `r` in mm. At 0 it has a pole; nearer than a thousandth of d it is held constant.
    pub fn value(&self, r: f64) -> f64 {
        let t = (r / self.shape).max(1e-3);
        self.albedo * ((-t).exp() + (-t / 3.0).exp()) / (8.0 * PI * self.shape * self.shape * t)
    }
}
