//! Eight triangles against a ray, watertight (Woop, Benthin, Wald 2013, "Watertight Ray/Triangle Intersection").
//!
//! The ray's frame is sheared so that it runs along +z; an edge function of exactly zero, or one that over- or underflowed,
//! is computed again in double precision, where it has the right sign. Edges belong to both their triangles.

use crate::lanes::Lanes;
use crate::ray::Ray;
use glam::Vec3;

/// The ray's part of the test, computed once.
pub(crate) struct Shear {
    /// Axis numbers; `axes[2]` is the one of the largest direction component.
    pub(crate) axes: [usize; 3],
    o: [f32; 3],
    s: [f32; 3],
}

impl Shear {
    #[inline(always)]
    pub(crate) fn of(ray: &Ray) -> Self {
        let d = ray.d.to_array();
        let size = ray.d.abs();
        let kz = if size.x > size.y && size.x > size.z { 0 } else { 1 + usize::from(size.z >= size.y) };
        let (kx, ky) = ([1, 2, 0][kz], [2, 0, 1][kz]);
        let o = ray.o.to_array();
        let inverse = 1.0 / d[kz];
        Self { axes: [kx, ky, kz], o: [o[kx], o[ky], o[kz]], s: [d[kx] * inverse, d[ky] * inverse, inverse] }
    }

    /// Corners relative to the ray in its sheared frame, rounded alike for every triangle that shares the corner.
    #[inline(always)]
    fn shear<L: Lanes>(&self, c: &[[f32; 8]; 3]) -> (L, L, L) {
        let [kx, ky, kz] = self.axes;
        let z = L::load(&c[kz]).sub(L::splat(self.o[2]));
        let x = L::load(&c[kx]).sub(L::splat(self.o[0])).sub(L::splat(self.s[0]).mul(z));
        let y = L::load(&c[ky]).sub(L::splat(self.o[1])).sub(L::splat(self.s[1]).mul(z));
        (x, y, z)
    }
}

/// Corners of eight triangles by corner, axis and lane. Unused lanes repeat the first.
#[repr(C, align(32))]
#[derive(Clone)]
pub(crate) struct Block {
    corners: [[[f32; 8]; 3]; 3],
    /// Numbers of the triangles in the whole geometry.
    pub(crate) prims: [u32; 8],
}

/// A triangle hit: parameter, barycentric coordinates of corners two and three, number in the geometry.
#[derive(Clone, Copy)]
pub(crate) struct TriangleHit {
    pub(crate) t: f32,
    pub(crate) u: f32,
    pub(crate) v: f32,
    pub(crate) prim: u32,
}

impl Block {
    /// From one to eight triangles with their numbers.
    pub(crate) fn new(triangles: &[([Vec3; 3], u32)]) -> Self {
        let mut block = Self { corners: [[[0.0; 8]; 3]; 3], prims: [0; 8] };
        for lane in 0..8 {
            let (corners, prim) = triangles.get(lane).unwrap_or(&triangles[0]);
            block.prims[lane] = *prim;
            for (k, corner) in corners.iter().enumerate() {
                (0..3).for_each(|axis| block.corners[k][axis][lane] = corner[axis]);
            }
        }
        block
    }

    /// The closest hit with `t_min < t < t_max`.
    #[inline(always)]
    pub(crate) fn intersect<L: Lanes>(&self, ray: &Shear, t_min: f32, t_max: f32) -> Option<TriangleHit> {
        let (ax, ay, az) = ray.shear::<L>(&self.corners[0]);
        let (bx, by, bz) = ray.shear::<L>(&self.corners[1]);
        let (cx, cy, cz) = ray.shear::<L>(&self.corners[2]);
        // Two roundings and no fused operation: the two triangles of an edge must get opposite values.
        let u = cx.mul(by).sub(cy.mul(bx));
        let v = ax.mul(cy).sub(ay.mul(cx));
        let w = bx.mul(ay).sub(by.mul(ax));
        let zero = L::splat(0.0);
        let (low, high) = (u.min(v).min(w), u.max(v).max(w));
        let inside = zero.le(low) | high.le(zero);
        let det = u.add(v).add(w);
        let decided = zero.lt(u.abs().min(v.abs()).min(w.abs())) & det.abs().lt(L::splat(f32::INFINITY));
        let doubtful = !decided & 0xff;
        let mut best: Option<TriangleHit> = None;
        let sure = inside & !doubtful;
        if sure != 0 {
            let t = u.mul(az).add(v.mul(bz)).add(w.mul(cz)).mul(L::splat(ray.s[2])).div(det);
            let mut hits = sure & L::splat(t_min).lt(t) & t.lt(L::splat(t_max));
            if hits != 0 {
                let (t, v, w, det) = (t.store(), v.store(), w.store(), det.store());
                while hits != 0 {
                    let i = hits.trailing_zeros() as usize & 7;
                    hits &= hits - 1;
                    if best.is_none_or(|b| t[i] < b.t) {
                        best = Some(TriangleHit { t: t[i], u: v[i] / det[i], v: w[i] / det[i], prim: self.prims[i] });
                    }
                }
            }
        }
        if doubtful != 0 {
            let sheared = [
                ax.store(),
                ay.store(),
                az.store(),
                bx.store(),
                by.store(),
                bz.store(),
                cx.store(),
                cy.store(),
                cz.store(),
            ];
            best = doubtful_lanes(self, doubtful, &sheared, ray.s[2], t_min, t_max, best);
        }
        best
    }
}

/// The test in double precision for the lanes where single precision could not decide.
#[cold]
#[inline(never)]
fn doubtful_lanes(
    block: &Block,
    mut lanes: u32,
    sheared: &[[f32; 8]; 9],
    sz: f32,
    t_min: f32,
    t_max: f32,
    mut best: Option<TriangleHit>,
) -> Option<TriangleHit> {
    while lanes != 0 {
        let i = lanes.trailing_zeros() as usize & 7;
        lanes &= lanes - 1;
        let [ax, ay, az, bx, by, bz, cx, cy, cz] = sheared.map(|x| f64::from(x[i]));
        // Products of two floats are exact here, so the sign of each difference is right.
        let (u, v, w) = (cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax);
        let inside = u >= 0.0 && v >= 0.0 && w >= 0.0 || u <= 0.0 && v <= 0.0 && w <= 0.0;
        let det = u + v + w;
        if !inside || det == 0.0 {
            continue;
        }
        let t = ((u * az + v * bz + w * cz) * f64::from(sz) / det) as f32;
        if t > t_min && t < best.map_or(t_max, |b| b.t) {
            best = Some(TriangleHit { t, u: (v / det) as f32, v: (w / det) as f32, prim: block.prims[i] });
        }
    }
    best
}
