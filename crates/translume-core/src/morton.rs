//! Morton's curve: an order of points in space in which neighbours are mostly near each other.
//!
//! Source: Morton 1966, "A computer oriented geodetic data base and a new technique in file sequencing".

use glam::Vec3;

/// Numbers of `points` along the curve through the cube around them; points in the same of 1024³ cells in the order given.
pub fn order(points: &[Vec3]) -> Vec<u32> {
    let (lo, hi) = points.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
    let scale = 1023.0 / (hi - lo).max_element().max(1e-30);
    let code = |i: &u32| {
        let p = (points[*i as usize] - lo) * scale;
        spread(p.x as u32) | spread(p.y as u32) << 1 | spread(p.z as u32) << 2
    };
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    order.sort_by_cached_key(code);
    order
}

/// The ten lowest bits, two zeros after each.
fn spread(x: u32) -> u32 {
    let x = (x | x << 16) & 0x0300_00ff;
    let x = (x | x << 8) & 0x0300_f00f;
    let x = (x | x << 4) & 0x030c_30c3;
    (x | x << 2) & 0x0924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_spread() {
        for x in [0, 1, 2, 3, 0x155, 0x2aa, 0x3ff] {
            let slow = (0..10).fold(0, |s, bit| s | ((x >> bit) & 1) << (3 * bit));
            assert_eq!(spread(x), slow, "{x}");
        }
    }

    #[test]
    fn octants_come_one_after_the_other() {
        let corner = |i: u32| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32);
        // Two points in each, in an order that mixes them.
        let points: Vec<Vec3> = (0..16).map(|i| corner(i * 5 % 8) * 9.0 + (i / 8) as f32 * 0.3).collect();
        let found: Vec<u32> = order(&points).iter().map(|i| i * 5 % 8).collect();
        assert_eq!(found, (0..8).flat_map(|i| [i, i]).collect::<Vec<_>>());
        assert_eq!(order(&[]), []);
        assert_eq!(order(&[Vec3::ONE; 3]), [0, 1, 2]);
    }
}
