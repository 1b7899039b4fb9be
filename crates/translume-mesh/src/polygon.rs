//! Polygons to triangles: a fan where the polygon is convex, ear clipping where it is not.
//!
//! Deviates from the textbook in one thing: polygons of more than [`LARGEST_CLIPPED`] corners are fanned as they are,
//! because ear clipping takes quadratic time and a damaged file may ask for a million corners.

use glam::{DVec2, DVec3};

const LARGEST_CLIPPED: usize = 1024;

/// Calls `emit` with corner numbers of `n - 2` triangles that cover the polygon `corner(0..n)`, wound as it is.
pub(crate) fn triangulate(n: usize, corner: impl Fn(usize) -> [f64; 3], mut emit: impl FnMut([usize; 3])) {
    if n == 3 {
        return emit([0, 1, 2]);
    }
    let flat = (4..=LARGEST_CLIPPED).contains(&n).then(|| project(n, &corner));
    match flat {
        Some(flat) if !is_convex(&flat) => clip_ears(&flat, emit),
        _ => (2..n).for_each(|i| emit([0, i - 1, i])),
    }
}

/// The polygon on the plane of its Newell normal, counter-clockwise.
fn project(n: usize, corner: &impl Fn(usize) -> [f64; 3]) -> Vec<DVec2> {
    let at = |i: usize| DVec3::from(corner(i % n));
    let normal: DVec3 = (0..n).map(|i| (at(i) - at(0)).cross(at(i + 1) - at(0))).sum();
    let normal = normal.try_normalize().unwrap_or(DVec3::Z);
    let (s, t) = normal.any_orthonormal_pair();
    (0..n).map(|i| DVec2::new(s.dot(at(i)), t.dot(at(i)))).collect()
}

fn turn(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    (b - a).perp_dot(c - b)
}

fn is_convex(p: &[DVec2]) -> bool {
    let n = p.len();
    // NaN counts as convex: such polygons are fanned.
    !(0..n).any(|i| turn(p[i], p[(i + 1) % n], p[(i + 2) % n]) < 0.0)
}

fn clip_ears(p: &[DVec2], mut emit: impl FnMut([usize; 3])) {
    let mut left: Vec<usize> = (0..p.len()).collect();
    let mut ears: Vec<bool> = (0..p.len()).map(|i| is_ear(p, &left, i)).collect();
    while left.len() > 3 {
        // A polygon that crosses itself may have no ear; any corner does then.
        let i = ears.iter().position(|&e| e).unwrap_or(1);
        emit(around(&left, i));
        left.remove(i);
        ears.remove(i);
        // Only the neighbours can become ears or cease to be.
        for i in [(i + left.len() - 1) % left.len(), i % left.len()] {
            ears[i] = is_ear(p, &left, i);
        }
    }
    emit([left[0], left[1], left[2]]);
}

fn around(left: &[usize], i: usize) -> [usize; 3] {
    let n = left.len();
    [left[(i + n - 1) % n], left[i], left[(i + 1) % n]]
}

fn is_ear(p: &[DVec2], left: &[usize], i: usize) -> bool {
    let [a, b, c] = around(left, i);
    turn(p[a], p[b], p[c]) > 0.0 && !left.iter().any(|&j| j != a && j != b && j != c && inside(p[j], p[a], p[b], p[c]))
}

fn inside(q: DVec2, a: DVec2, b: DVec2, c: DVec2) -> bool {
    let side = |a: DVec2, b: DVec2| (b - a).perp_dot(q - a);
    side(a, b) >= 0.0 && side(b, c) >= 0.0 && side(c, a) >= 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(p: &[[f32; 3]]) -> (f64, f64) {
        let (mut signed, mut absolute) = (0.0, 0.0);
        triangulate(
            p.len(),
            |i| p[i].map(f64::from),
            |[a, b, c]| {
                let v = |i: usize| DVec2::new(f64::from(p[i][0]), f64::from(p[i][1]));
                let twice = (v(b) - v(a)).perp_dot(v(c) - v(a));
                signed += twice / 2.0;
                absolute += twice.abs() / 2.0;
            },
        );
        (signed, absolute)
    }

    #[test]
    fn concave_polygons_are_covered_once() {
        let arrow = [[0.0, 0.0, 0.0], [2.0, -2.0, 0.0], [0.0, 3.0, 0.0], [-2.0, -2.0, 0.0]];
        assert_eq!(area(&arrow), (6.0, 6.0));
        let comb: Vec<[f32; 3]> =
            [[0, 0], [7, 0], [7, 5], [6, 5], [6, 1], [4, 1], [4, 5], [3, 5], [3, 1], [1, 1], [1, 5], [0, 5]]
                .map(|[x, y]: [i16; 2]| [f32::from(x), f32::from(y), 0.0])
                .to_vec();
        assert_eq!(area(&comb), (19.0, 19.0));
        let reversed: Vec<_> = comb.into_iter().rev().collect();
        assert_eq!(area(&reversed), (-19.0, 19.0));
    }

    #[test]
    fn every_polygon_gives_n_minus_two_triangles() {
        for n in [3, 4, 5, 50, LARGEST_CLIPPED + 1] {
            for nan in [false, true] {
                let mut count = 0;
                let corner = |i: usize| [if nan && i == 2 { f64::NAN } else { (i * i % 17) as f64 }, i as f64, 0.0];
                triangulate(n, corner, |_| count += 1);
                assert_eq!(count, n - 2);
            }
        }
    }
}
