//! Reflectance of smooth interfaces.
//!
//! Sources: Fresnel's equations for dielectrics and conductors (the latter as in Born & Wolf §14.4); Schlick 1994; diffuse
//! reflectance by the fits of Egan & Hilgeman 1973 (η < 1) and d'Eon & Irving 2011 (η > 1), both good to about 0.2 % for
//! usual indices.

use crate::Rgb;
use glam::Vec3;

/// What an unpolarised ray meets at a dielectric interface.
#[derive(Clone, Copy, Debug)]
pub struct Interface {
    /// Fraction of the power that is reflected.
    pub reflectance: f32,
    /// Cosine of the refracted ray to the normal, of the sign opposite to the incident one; 0 for total reflection.
    pub cos_t: f32,
    /// Index on the refracted side over the index on the incident side.
    pub eta_it: f32,
    /// Its reciprocal.
    pub eta_ti: f32,
}

/// Fresnel's equations for a dielectric. `cos_i` is the cosine between the normal and the direction the ray came from, signed;
/// `eta` is the index on the side the normal does not point to over the index on the other.
#[inline]
pub fn dielectric(cos_i: f32, eta: f32) -> Interface {
    let (eta_it, eta_ti) = if cos_i >= 0.0 { (eta, 1.0 / eta) } else { (1.0 / eta, eta) };
    let cos_t2 = 1.0 - eta_ti * eta_ti * (1.0 - cos_i * cos_i);
    let (abs_i, abs_t) = (cos_i.abs(), cos_t2.max(0.0).sqrt());
    let reflectance = if eta == 1.0 {
        0.0
    } else if abs_i == 0.0 || cos_t2 <= 0.0 {
        1.0
    } else {
        let r_s = (abs_i - eta_it * abs_t) / (abs_i + eta_it * abs_t);
        let r_p = (abs_t - eta_it * abs_i) / (abs_t + eta_it * abs_i);
        0.5 * (r_s * r_s + r_p * r_p)
    };
    Interface { reflectance, cos_t: -abs_t.copysign(cos_i), eta_it, eta_ti }
}

/// Indices beyond this reflect all that a float can tell from all; their fourth powers would not fit one.
const MAX_INDEX: f32 = 1e8;

/// Fresnel's equations for a conductor of complex index `eta` + i `k` per channel, relative to the medium in front.
#[inline]
pub fn conductor(cos_i: f32, eta: Rgb, k: Rgb) -> Rgb {
    let cos2 = cos_i * cos_i;
    let sin2 = 1.0 - cos2;
    let (eta, k) = (eta.min(Vec3::splat(MAX_INDEX)), k.min(Vec3::splat(MAX_INDEX)));
    let (eta2, k2) = (eta * eta, k * k);
    let t = eta2 - k2 - Vec3::splat(sin2);
    // a² + b² and a of the complex refracted cosine times the index.
    let a2_b2 = sqrt(t * t + 4.0 * eta2 * k2);
    let a = sqrt((0.5 * (a2_b2 + t)).max(Vec3::ZERO));
    let u = a2_b2 + Vec3::splat(cos2);
    let v = 2.0 * cos_i * a;
    let r_s = (u - v) / (u + v);
    let w = a2_b2 * cos2 + Vec3::splat(sin2 * sin2);
    let x = v * sin2;
    let r_p = r_s * (w - x) / (w + x);
    // Of equal indices the rounding is left, of either sign.
    (0.5 * (r_s + r_p)).max(Vec3::ZERO)
}

/// Schlick's weight (1 − cos θ)⁵, so that F = r0 + (1 − r0)·weight.
#[inline]
pub fn schlick_weight(cos: f32) -> f32 {
    let m = (1.0 - cos).clamp(0.0, 1.0);
    let m2 = m * m;
    m2 * m2 * m
}

/// Fresnel reflectance of a smooth dielectric averaged over diffuse illumination; `eta` as for [`dielectric`] seen from the
/// illuminated side (below 1 for light inside the denser medium).
pub fn diffuse_reflectance(eta: f32) -> f32 {
    let inv = 1.0 / eta;
    if eta < 1.0 {
        -1.4399 * eta * eta + 0.7099 * eta + 0.6681 + 0.0636 * inv
    } else {
        [-1.36881, 4.98554, -7.80989, 6.75335, -3.4793, 0.919317].iter().fold(0.0, |p, c| p * inv + c)
    }
}

/// Mirror image of `w` about the normal `m`.
#[inline]
pub fn reflect(w: Vec3, m: Vec3) -> Vec3 {
    2.0 * w.dot(m) * m - w
}

/// Refraction of `w` (pointing away from the surface) about the normal `m`, with what [`dielectric`] returned for it.
#[inline]
pub fn refract(w: Vec3, m: Vec3, interface: &Interface) -> Vec3 {
    m * (w.dot(m) * interface.eta_ti + interface.cos_t) - w * interface.eta_ti
}

#[inline]
fn sqrt(v: Vec3) -> Vec3 {
    Vec3::new(v.x.sqrt(), v.y.sqrt(), v.z.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dielectric_identities() {
        let eta = 1.5;
        assert!((dielectric(1.0, eta).reflectance - 0.04).abs() < 1e-6);
        assert!((dielectric(-1.0, eta).reflectance - 0.04).abs() < 1e-6);
        assert_eq!(dielectric(0.0, eta).reflectance, 1.0);
        assert_eq!(dielectric(0.3, 1.0).reflectance, 0.0);
        // Brewster: the p part vanishes, R = ((1 − η²)/(1 + η²))²/2.
        let brewster = (1.0 / (1.0 + eta * eta)).sqrt();
        let half = ((1.0 - eta * eta) / (1.0 + eta * eta)).powi(2) / 2.0;
        assert!((dielectric(brewster, eta).reflectance - half).abs() < 1e-6);
        // Total reflection beyond the critical angle, seen from inside.
        let critical = (1.0 - 1.0 / (eta * eta)).sqrt();
        assert_eq!(dielectric(-(critical - 0.01), eta).reflectance, 1.0);
        assert!(dielectric(-(critical + 0.01), eta).reflectance < 1.0);
        for i in 1..100 {
            // Reversed along the refracted ray, the reflectance is the same; Snell holds.
            let cos_i = i as f32 / 100.0;
            let a = dielectric(cos_i, eta);
            let b = dielectric(a.cos_t, eta);
            // The way back starts close to total reflection, where rounding of cos² weighs 1/cos.
            let tolerance = 1e-5 + 1e-5 / cos_i;
            assert!((a.reflectance - b.reflectance).abs() < tolerance, "{cos_i}: {a:?} {b:?}");
            assert!((b.cos_t - cos_i).abs() < tolerance, "{cos_i}: {b:?}");
            let w = Vec3::new((1.0 - cos_i * cos_i).sqrt(), 0.0, cos_i);
            let t = refract(w, Vec3::Z, &a);
            assert!((t.length() - 1.0).abs() < 1e-5 && (t.x * eta + w.x).abs() < 1e-5 && t.z < 0.0);
        }
    }

    #[test]
    fn conductor_reduces_to_dielectric_and_mirror() {
        for i in 0..=100 {
            let cos = i as f32 / 100.0;
            let glass = conductor(cos, Vec3::new(1.5, 1.2, 2.0), Vec3::ZERO);
            for (c, eta) in [(glass.x, 1.5), (glass.y, 1.2), (glass.z, 2.0)] {
                assert!((c - dielectric(cos, eta).reflectance).abs() < 1e-5, "{cos} {eta}");
            }
            assert!((conductor(cos, Vec3::ZERO, Vec3::ONE) - Vec3::ONE).abs().max_element() < 1e-6);
        }
        for cos in [0.0, 1e-3, 0.3, 1.0] {
            let nothing = conductor(cos, Vec3::ONE, Vec3::ZERO);
            assert!(nothing.min_element() >= 0.0 && (cos == 0.0 || nothing.max_element() < 1e-4), "{cos}: {nothing}");
            let all = conductor(cos, Vec3::new(1e20, 0.0, 1e30), Vec3::new(1e20, 1e30, 0.0));
            assert!((all - Vec3::ONE).abs().max_element() < 1e-4, "{cos}: {all}");
        }
        // Normal incidence: ((η−1)² + k²)/((η+1)² + k²).
        let f = conductor(1.0, Vec3::splat(0.2), Vec3::splat(3.9)).x;
        assert!((f - (0.64 + 15.21) / (1.44 + 15.21)).abs() < 1e-5);
    }

    #[test]
    fn diffuse_reflectance_agrees_with_quadrature() {
        for eta in [1.3f32, 1.49, 1.8] {
            for e in [eta, 1.0 / eta] {
                let n = 20_000;
                let exact: f64 = (0..n)
                    .map(|i| {
                        let cos = (i as f32 + 0.5) / n as f32;
                        f64::from(2.0 * cos * dielectric(cos, e).reflectance) / f64::from(n)
                    })
                    .sum();
                assert!((f64::from(diffuse_reflectance(e)) / exact - 1.0).abs() < 0.01, "{e}");
            }
        }
    }
}
