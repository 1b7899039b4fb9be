//! Maps from the unit square to common domains, each with its density.
//!
//! Every function takes u, v in [0, 1) and is continuous, so that stratification survives. Local z is up.

use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, FRAC_PI_2, FRAC_PI_4, TAU};

/// Largest f32 below 1.
pub const ONE_MINUS_EPSILON: f32 = 1.0 - f32::EPSILON / 2.0;

/// Uniform on the unit disk, concentric (Shirley & Chiu 1997). Density per area: [`UNIFORM_DISK_PDF`].
#[inline]
pub fn uniform_disk(u: f32, v: f32) -> Vec2 {
    let (x, y) = (2.0 * u - 1.0, 2.0 * v - 1.0);
    if x == 0.0 && y == 0.0 {
        return Vec2::ZERO;
    }
    let (r, phi) = if x.abs() > y.abs() { (x, FRAC_PI_4 * (y / x)) } else { (y, FRAC_PI_2 - FRAC_PI_4 * (x / y)) };
    let (sin, cos) = phi.sin_cos();
    Vec2::new(r * cos, r * sin)
}

/// Density of [`uniform_disk`] per area.
pub const UNIFORM_DISK_PDF: f32 = FRAC_1_PI;

/// Uniform on the unit sphere. Density per solid angle: [`UNIFORM_SPHERE_PDF`].
#[inline]
pub fn uniform_sphere(u: f32, v: f32) -> Vec3 {
    from_cylindrical(1.0 - 2.0 * u, TAU * v)
}

/// Density of [`uniform_sphere`] per solid angle.
pub const UNIFORM_SPHERE_PDF: f32 = 0.25 * FRAC_1_PI;

/// Uniform on the upper hemisphere.
#[inline]
pub fn uniform_hemisphere(u: f32, v: f32) -> Vec3 {
    from_cylindrical(1.0 - u, TAU * v)
}

/// Density of [`uniform_hemisphere`] per solid angle.
#[inline]
pub fn uniform_hemisphere_pdf(w: Vec3) -> f32 {
    if w.z >= 0.0 { 0.5 * FRAC_1_PI } else { 0.0 }
}

/// Cosine-weighted on the upper hemisphere (Malley's method).
#[inline]
pub fn cosine_hemisphere(u: f32, v: f32) -> Vec3 {
    let d = uniform_disk(u, v);
    d.extend((1.0 - d.length_squared()).max(0.0).sqrt())
}

/// Density of [`cosine_hemisphere`] per solid angle.
#[inline]
pub fn cosine_hemisphere_pdf(w: Vec3) -> f32 {
    w.z.max(0.0) * FRAC_1_PI
}

/// Uniform on a triangle: barycentric coordinates (b1, b2) of the second and third corner. Density per area: 1/area.
#[inline]
pub fn uniform_triangle(u: f32, v: f32) -> Vec2 {
    let t = (1.0 - u).sqrt();
    Vec2::new(1.0 - t, t * v)
}

/// Uniform in the cone of directions about z with cos θ ≥ `cos_max`.
#[inline]
pub fn uniform_cone(u: f32, v: f32, cos_max: f32) -> Vec3 {
    // 1 − cos θ is kept apart, so that a narrow cone (a small, far light) does not lose its width to rounding.
    let one_minus_cos = u * (1.0 - cos_max);
    let sin = (one_minus_cos * (2.0 - one_minus_cos)).max(0.0).sqrt();
    let (sin_phi, cos_phi) = (TAU * v).sin_cos();
    Vec3::new(sin * cos_phi, sin * sin_phi, 1.0 - one_minus_cos)
}

/// Density of [`uniform_cone`] per solid angle, inside the cone.
#[inline]
pub fn uniform_cone_pdf(cos_max: f32) -> f32 {
    1.0 / (TAU * (1.0 - cos_max))
}

/// The direction with height z and azimuth φ.
#[inline]
fn from_cylindrical(z: f32, phi: f32) -> Vec3 {
    let r = (1.0 - z * z).max(0.0).sqrt();
    let (sin, cos) = phi.sin_cos();
    Vec3::new(r * cos, r * sin, z)
}

/// Azimuth of a direction, in [0, 2π).
#[inline]
pub fn azimuth(w: Vec3) -> f32 {
    let phi = w.y.atan2(w.x);
    if phi < 0.0 { (phi + TAU).min(TAU * ONE_MINUS_EPSILON) } else { phi }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{chi2::SphereTest, rng::Pcg32, stats};

    #[test]
    fn directions_follow_their_densities() {
        let cos_max = 0.3;
        let test = SphereTest::default();
        test.run("sphere", |r| Some(uniform_sphere(r.next_f32(), r.next_f32())), |_| UNIFORM_SPHERE_PDF, 4).unwrap();
        test.run("hemisphere", |r| Some(uniform_hemisphere(r.next_f32(), r.next_f32())), uniform_hemisphere_pdf, 4)
            .unwrap();
        test.run("cosine", |r| Some(cosine_hemisphere(r.next_f32(), r.next_f32())), cosine_hemisphere_pdf, 4).unwrap();
        let pdf = |w: Vec3| if w.z >= cos_max { uniform_cone_pdf(cos_max) } else { 0.0 };
        test.run("cone", |r| Some(uniform_cone(r.next_f32(), r.next_f32(), cos_max)), pdf, 4).unwrap();
        // The test can fail: a cosine sampler against the uniform density.
        assert!(
            test.run("wrong", |r| Some(cosine_hemisphere(r.next_f32(), r.next_f32())), uniform_hemisphere_pdf, 4)
                .is_err()
        );
    }

    #[test]
    fn disk_and_triangle_are_uniform() {
        let mut rng = Pcg32::new(3, 0);
        let n = 100_000;
        let (mut disk, mut triangle) = (vec![0.0; 16 * 16], vec![0.0; 64]);
        for _ in 0..n {
            let d = uniform_disk(rng.next_f32(), rng.next_f32());
            assert!(d.length() <= 1.0 + 1e-6);
            let ring = ((d.length_squared() * 16.0) as usize).min(15); // rings of equal area
            disk[ring * 16 + ((azimuth(d.extend(0.0)) / TAU * 16.0) as usize).min(15)] += 1.0;
            let b = uniform_triangle(rng.next_f32(), rng.next_f32());
            assert!(b.x >= 0.0 && b.y >= 0.0 && b.x + b.y <= 1.0 + 1e-6);
            // Subdivide: corner triangles of an 8-row split, (row, column, orientation).
            let (x, y) = (b.x * 8.0, b.y * 8.0);
            let (i, j) = (x as usize, y as usize);
            let upper = usize::from(x.fract() + y.fract() > 1.0);
            let row = (i + j + upper).min(7);
            triangle[row * row + (2 * i + upper).min(2 * row)] += 1.0;
        }
        let each = |m: usize| vec![f64::from(n) / m as f64; m];
        stats::chi2_test(&disk, &each(256), 1e-4).unwrap();
        stats::chi2_test(&triangle, &each(64), 1e-4).unwrap();
    }
}
