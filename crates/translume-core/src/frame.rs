//! Orthonormal frames.
//!
//! Source: Duff et al. 2017, "Building an Orthonormal Basis, Revisited": no branch but a sign, no loss of precision
//! near n = −z.

use glam::Vec3;

/// A right-handed orthonormal frame: s × t = n.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// First tangent, local x.
    pub s: Vec3,
    /// Second tangent, local y.
    pub t: Vec3,
    /// Normal, local z.
    pub n: Vec3,
}

impl Frame {
    /// The frame of a unit normal; the tangents are arbitrary but continuous except across n.z = 0.
    #[inline]
    pub fn from_normal(n: Vec3) -> Self {
        let sign = 1f32.copysign(n.z);
        let a = -1.0 / (sign + n.z);
        let b = n.x * n.y * a;
        let s = Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x);
        let t = Vec3::new(b, sign + n.y * n.y * a, -n.y);
        Self { s, t, n }
    }

    /// The frame of a unit normal whose `s` is `tangent` made orthogonal to it; an unusable tangent (zero, parallel to n,
    /// not finite) falls back to [`Frame::from_normal`].
    #[inline]
    pub fn from_normal_tangent(n: Vec3, tangent: Vec3) -> Self {
        let s = tangent - n * n.dot(tangent);
        let length2 = s.length_squared();
        if length2.is_finite() && length2 > 1e-12 * tangent.length_squared() && length2 > 0.0 {
            let s = s / length2.sqrt();
            Self { s, t: n.cross(s), n }
        } else {
            Self::from_normal(n)
        }
    }

    /// World to local.
    #[inline]
    pub fn to_local(&self, v: Vec3) -> Vec3 {
        Vec3::new(self.s.dot(v), self.t.dot(v), self.n.dot(v))
    }

    /// Local to world.
    #[inline]
    pub fn to_world(&self, v: Vec3) -> Vec3 {
        self.s * v.x + self.t * v.y + self.n * v.z
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{rng::Pcg32, warp};

    fn assert_orthonormal(f: &Frame) {
        for v in [f.s, f.t, f.n] {
            assert!((v.length() - 1.0).abs() < 1e-5, "{f:?}");
        }
        for (a, b) in [(f.s, f.t), (f.t, f.n), (f.n, f.s)] {
            assert!(a.dot(b).abs() < 1e-5, "{f:?}");
        }
        assert!((f.s.cross(f.t) - f.n).length() < 1e-5, "{f:?}");
    }

    #[test]
    fn frames_are_orthonormal_and_invert() {
        let mut rng = Pcg32::new(1, 2);
        let mut normals = vec![Vec3::Z, -Vec3::Z, Vec3::X, Vec3::new(1e-4, 1e-4, -1.0).normalize()];
        normals.extend((0..1000).map(|_| warp::uniform_sphere(rng.next_f32(), rng.next_f32())));
        for n in normals {
            let f = Frame::from_normal(n);
            assert_orthonormal(&f);
            let v = warp::uniform_sphere(rng.next_f32(), rng.next_f32());
            assert!((f.to_world(f.to_local(v)) - v).length() < 1e-5);
            let tangent = warp::uniform_sphere(rng.next_f32(), rng.next_f32());
            let g = Frame::from_normal_tangent(n, tangent);
            assert_orthonormal(&g);
            assert!(g.s.dot(tangent) > 0.0);
        }
        assert_orthonormal(&Frame::from_normal_tangent(Vec3::Z, Vec3::Z * 3.0));
        assert_orthonormal(&Frame::from_normal_tangent(Vec3::Z, Vec3::ZERO));
        assert_orthonormal(&Frame::from_normal_tangent(Vec3::Z, Vec3::NAN));
    }
}
