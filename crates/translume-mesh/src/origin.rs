//! Coordinates that 32-bit floats cannot hold, as of map projections and site plans, kept about an origin near them.
//!
//! What counts is the distance between neighbours, which is taken to be that of as many points spread evenly over the
//! extent: where rounding moves a point by more than a 256th of it, an origin is taken off. It is a multiple of a power of
//! two (of 1 for what is larger than that), so that it can be written down and added again.

use glam::DVec3;

/// Rounding may move a point by this part of the distance to its neighbours.
const MOST_MOVED: f64 = 1.0 / 256.0;

/// The origin to take off `points`; `None` where 32-bit floats hold them well.
pub(crate) fn of(points: impl Iterator<Item = DVec3> + Clone) -> Option<DVec3> {
    let (mut lo, mut hi, mut moved, mut count) = (DVec3::INFINITY, DVec3::NEG_INFINITY, 0.0_f64, 0_u64);
    for p in points.filter(|p| p.is_finite()) {
        (lo, hi, count) = (lo.min(p), hi.max(p), count + 1);
        moved = moved.max((p - p.as_vec3().as_dvec3()).abs().max_element());
    }
    let extent = (hi - lo).max_element();
    let spacing = extent / (count as f64).sqrt();
    // False for no points, and for points that are one place.
    if !(extent > 0.0 && extent.is_finite() && moved.is_finite() && moved > MOST_MOVED * spacing) {
        return None;
    }
    let unit = extent.log2().floor().min(0.0).exp2();
    let origin = ((lo * 0.5 + hi * 0.5) / unit).floor() * unit;
    (origin.is_finite() && origin != DVec3::ZERO).then_some(origin)
}

/// `points` about their origin, and that origin; zero where none is needed.
pub(crate) fn narrowed(points: &[[f64; 3]]) -> (Vec<[f32; 3]>, DVec3) {
    let origin = of(points.iter().map(|p| DVec3::from(*p))).unwrap_or(DVec3::ZERO);
    (points.iter().map(|p| (DVec3::from(*p) - origin).as_vec3().into()).collect(), origin)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(at: DVec3, step: f64) -> Vec<DVec3> {
        (0..900).map(|i| at + step * DVec3::new(f64::from(i % 30), f64::from(i / 30), 0.0)).collect()
    }

    #[test]
    fn only_what_floats_cannot_hold_is_moved() {
        let at = DVec3::new(443_211.0, 5_412_345.0, 0.0);
        let origin = of(grid(at, 0.005).into_iter()).unwrap();
        assert!((origin - at).length() < 1.0 && origin == origin.floor(), "{origin}");
        // Objects about as far off as they are large, of any size, and single points.
        assert_eq!(of(grid(DVec3::new(3.3, 1.7, -20.0), 0.1).into_iter()), None);
        assert_eq!(of(grid(DVec3::splat(1e-7), 1e-9).into_iter()), None);
        assert_eq!(of(grid(at, 1000.0).into_iter()), None);
        assert_eq!(of([at + 0.1].into_iter()), None);
        assert_eq!(of([DVec3::splat(1e300), DVec3::splat(f64::NAN)].into_iter()), None);
        // Small things far off.
        let origin = of(grid(DVec3::splat(0.7), 1e-9).into_iter()).unwrap();
        assert!((origin - 0.7).length() < 1e-7, "{origin}");
    }
}
