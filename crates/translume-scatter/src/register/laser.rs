//! The laser projector's pose from the places that it lit.
//!
//! A projector stands somewhere else for each stop of the turntable, seen from the object. The beams of one place are moved as one, so
//! that the sum of squares of their distances from the lit places is least. What the deflection of the mirrors was is in the rig: the
//! angles between the beams stay.

use super::cameras::visible;
use super::pictures::Pictures;
use super::pose::{Motion, MotionFit, Row, median, robust, solve};
use crate::capture::{Rig, Surface};
use glam::DVec3;
use serde::Serialize;

/// Fewer lit places tell nothing of six parameters.
const FEWEST: usize = 6;
/// The error that a lit place has anyway, as a share of the beam's diameter.
const PLACE: f64 = 0.1;
/// What the rig is trusted: the angle, and shifts as shares of the object and of the distance.
const TRUST: (f64, f64, f64) = (0.1, 0.5, 0.05);
/// Places that are seen or lit at a smaller cosine are not used.
const LEAST_COS: f64 = 0.3;
/// Rounds of weights by size.
const ROUNDS: usize = 8;

/// What was found out about the beams of one place of the projector.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Beams {
    /// Where they come from.
    pub origin_mm: [f64; 3],
    /// Lit places that were seen.
    pub seen: usize,
    /// Median distance of the lit places from the beams, before and after.
    pub off_mm: Option<[f64; 2]>,
}

/// Moves the beams of `rig`, from where they are in `given`; hits are where they meet the mesh.
pub(super) fn refine(surface: &Surface, given: &Rig, rig: &mut Rig, pictures: &Pictures, shown: &[bool]) -> Vec<Beams> {
    let seen = lit_places(surface, rig, pictures, Some(shown));
    let mut groups: Vec<([f64; 3], Vec<usize>)> = Vec::new();
    for position in 0..given.laser.hits_mm.len() {
        let origin = given.laser.origin(position);
        match groups.iter_mut().find(|g| g.0 == origin) {
            Some(group) => group.1.push(position),
            None => groups.push((origin, vec![position])),
        }
    }
    let bounds = surface.mesh.bounds();
    let (pivot, radius) = (bounds.center().as_dvec3(), 0.5 * f64::from(bounds.extent().length()).max(1e-9));
    let one_origin = given.laser.origins_mm.is_empty();
    let mut told = Vec::new();
    for (origin, positions) in groups {
        let beam = |&i: &usize| {
            let direction = (DVec3::from_array(given.laser.hits_mm[i]) - DVec3::from_array(origin)).normalize();
            Beam { direction, place: seen[i] }
        };
        let beams: Vec<Beam> = positions.iter().map(beam).collect();
        let (motion, report) =
            fit(DVec3::from_array(origin), &beams, (pivot, radius), PLACE * given.laser.beam_diameter_mm);
        let from = motion.of(DVec3::from_array(origin), pivot);
        for (&i, beam) in positions.iter().zip(&beams) {
            // As far along the beam as it was, until it lands.
            let far = (DVec3::from_array(given.laser.hits_mm[i]) - DVec3::from_array(origin)).length();
            rig.laser.hits_mm[i] = (from + far * (motion.rotation * beam.direction)).to_array();
            if !one_origin {
                rig.laser.origins_mm[i] = from.to_array();
            }
        }
        if one_origin || given.laser.origin_mm == origin {
            rig.laser.origin_mm = from.to_array();
        }
        told.push(Beams { origin_mm: from.to_array(), ..report });
    }
    land(surface, rig);
    told
}

/// A beam as the rig has it, and the place that it lit.
struct Beam {
    direction: DVec3,
    place: Option<DVec3>,
}

fn fit(origin: DVec3, beams: &[Beam], (pivot, radius): (DVec3, f64), error_mm: f64) -> (Motion, Beams) {
    let seen: Vec<(DVec3, DVec3)> = beams.iter().filter_map(|b| Some((b.direction, b.place?))).collect();
    let far = (origin - pivot).length();
    let off = |x: &[f64]| -> Vec<f64> {
        let motion = Motion::new(x, radius);
        let from = motion.of(origin, pivot);
        seen.iter().map(|(d, p)| (motion.rotation * *d).cross(*p - from).length()).collect()
    };
    let mut x = [0.0; 6];
    let before = median(&off(&x));
    if seen.len() >= FEWEST {
        let along = (origin - pivot) / far.max(1e-9);
        // Shifts along the beams change little; the one number for all three axes is the larger trust for the way.
        let expected = std::array::from_fn(|i| match i {
            0..=2 => TRUST.0 * radius,
            _ => TRUST.1 * radius + TRUST.2 * far * along[i - 3].abs(),
        });
        for _ in 0..ROUNDS {
            let weights = robust(&off(&x), error_mm);
            let rows = |x: &[f64], add: &mut dyn FnMut(Row)| {
                rows(&Motion::new(x, radius), origin, (pivot, radius), &seen, &weights, error_mm, add);
                true
            };
            let last = x;
            if !solve(&MotionFit { rows, expected: &expected }, &mut x) {
                x = last;
                break;
            }
        }
    }
    let after = median(&off(&x));
    (
        Motion::new(&x, radius),
        Beams { origin_mm: origin.to_array(), seen: seen.len(), off_mm: before.zip(after).map(|(a, b)| [a, b]) },
    )
}

/// Distances across the beams in units of their error, and derivatives.
fn rows(
    motion: &Motion,
    origin: DVec3,
    (pivot, radius): (DVec3, f64),
    seen: &[(DVec3, DVec3)],
    weights: &[f64],
    error_mm: f64,
    add: &mut dyn FnMut(Row),
) {
    for ((direction, place), weight) in seen.iter().zip(weights) {
        let scale = weight.sqrt() / error_mm;
        let arm = *place - pivot - motion.shift;
        let (u, v) = direction.any_orthonormal_pair();
        for across in [u, v] {
            let turned = motion.rotation * across;
            // R a · (p − R(o − c) − c − t) = R a · (p − c − t) − a · (o − c)
            let off = turned.dot(arm) - across.dot(origin - pivot);
            let turn = turned.cross(arm) / radius; // (e × R a) · arm = e · (R a × arm)
            add((scale * off, [turn.x, turn.y, turn.z, -turned.x, -turned.y, -turned.z].map(|d| scale * d)));
        }
    }
}

/// Where on the mesh each laser position's spot was seen: the mean over the views that see its hit, where the spot is on a side
/// that the laser lights. With `only`, of these views.
fn lit_places(surface: &Surface, rig: &Rig, pictures: &Pictures, only: Option<&[bool]>) -> Vec<Option<DVec3>> {
    let mut sums = vec![(DVec3::ZERO, 0.0); rig.laser.hits_mm.len()];
    for (view, lit) in pictures.views.iter().enumerate().filter(|(v, _)| only.is_none_or(|o| o[*v])) {
        let camera = &rig.views[view].camera;
        for spot in &lit.spots {
            // Where the beam is hidden from the camera, what is brightest is the glow at a rim or on top.
            let hit = rig.laser.hits_mm[spot.position];
            if !camera.project(hit).is_some_and(|px| visible(surface, camera, px, hit)) {
                continue;
            }
            let Some((place, cos)) = surface.seen(camera, spot.px) else { continue };
            let at = DVec3::from_array(place.at);
            let towards = (DVec3::from_array(rig.laser.origin(spot.position)) - at).normalize();
            if cos > LEAST_COS && towards.dot(place.normal.as_dvec3()) > LEAST_COS {
                sums[spot.position].0 += cos * at;
                sums[spot.position].1 += cos;
            }
        }
    }
    sums.into_iter().map(|(sum, weight)| (weight > 0.0).then(|| sum / weight)).collect()
}

/// Puts hits to where the beams meet the mesh; those of beams that go past it stay.
pub(super) fn land(surface: &Surface, rig: &mut Rig) {
    for i in 0..rig.laser.hits_mm.len() {
        if let Some(place) = landing(surface, rig, i) {
            rig.laser.hits_mm[i] = place;
        }
    }
}

fn landing(surface: &Surface, rig: &Rig, position: usize) -> Option<[f64; 3]> {
    let origin = DVec3::from_array(rig.laser.origin(position));
    let direction = (DVec3::from_array(rig.laser.hits_mm[position]) - origin).normalize();
    surface.first(origin.as_vec3(), direction.as_vec3()).map(|place| place.at)
}

/// Beams that go past the mesh.
pub(super) fn missed(surface: &Surface, rig: &Rig) -> usize {
    (0..rig.laser.hits_mm.len()).filter(|&i| landing(surface, rig, i).is_none()).count()
}

/// Takes hits from where the spots were seen.
pub(super) fn take_seen(surface: &Surface, rig: &mut Rig, pictures: &Pictures) {
    let seen = lit_places(surface, rig, pictures, None);
    for (hit, place) in rig.laser.hits_mm.iter_mut().zip(seen) {
        *hit = place.map_or(*hit, |p| p.to_array());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use translume_core::rng::Pcg32;

    #[test]
    fn a_projector_is_found_by_what_it_lit() {
        // Places on a bumpy ball, lit from a projector that is turned by 2° and moved; a tenth of the places are wrong.
        let mut rng = Pcg32::new(3, 3);
        let (origin, pivot, radius) = (DVec3::new(800.0, 100.0, 200.0), DVec3::new(1.0, 2.0, 3.0), 10.0);
        let truth = Motion::new(&[0.35, -0.2, 0.15, 1.0, -0.8, 0.6], radius);
        let mut beams = Vec::new();
        for i in 0..150 {
            let place =
                pivot + 10.0 * DVec3::new(1.0 - rng.next_f64(), 2.0 * rng.next_f64() - 1.0, 2.0 * rng.next_f64() - 1.0);
            // The beam that the true projector sends there, as the rig has it.
            let from = truth.of(origin, pivot);
            let direction = truth.rotation.transpose() * (place - from).normalize();
            let noise = if i % 10 == 0 { 5.0 } else { 0.05 };
            let off = DVec3::new(rng.next_normal(), rng.next_normal(), rng.next_normal()) * noise;
            beams.push(Beam { direction, place: Some(place + off) });
        }
        let (found, told) = fit(origin, &beams, (pivot, radius), 0.2);
        let at = |m: &Motion, d: DVec3| {
            let (from, d) = (m.of(origin, pivot), m.rotation * d);
            from + d * (pivot - from).dot(d)
        };
        let worst =
            beams.iter().map(|b| (at(&found, b.direction) - at(&truth, b.direction)).length()).fold(0.0, f64::max);
        assert!(worst < 0.06, "{worst}");
        let [before, after] = told.off_mm.unwrap();
        assert!(before > 1.0 && after < 0.12 && told.seen == 150, "{told:?}");
        assert!(
            (found.rotation.transpose() * found.rotation - DMat3::IDENTITY)
                .to_cols_array()
                .iter()
                .all(|x| x.abs() < 1e-12)
        );
    }
}
