//! Footprints of light vertices and the camera vertices in them: candidate links, and how some of them are chosen.
//!
//! Source: Bekaert et al. 2003, §5: queries go sphere by sphere over a tree of the camera vertices; trial links are
//! chosen by stratified sampling of a discrete distribution (Neumann et al. 1995). A chosen link counts by the number
//! of times that it was chosen over the expected number (errata: not over the acceptance probability alone).

use crate::points::Points;
use glam::Vec3;
use rayon::prelude::*;
use translume_core::morton;

/// Around a light vertex, to look for camera vertices.
#[derive(Clone, Copy, Debug)]
pub(super) struct Footprint {
    pub(super) p: Vec3,
    pub(super) radius: f32,
    /// Number of the light vertex.
    pub(super) light: u32,
}

/// A pair that is to be connected.
#[derive(Clone, Copy)]
pub(super) struct Link {
    pub(super) light: u32,
    pub(super) eye: u32,
    /// Times selected over the expected number.
    pub(super) weight: f32,
}

/// Light vertices by camera vertex.
pub(super) struct Candidates {
    begins: Vec<u32>,
    lights: Vec<u32>,
}

/// Light vertices that one task asks for.
const CHUNK: usize = 2048;

impl Candidates {
    /// All pairs of a camera vertex in a light vertex's footprint; `tree` has the `eyes` camera vertices by their
    /// numbers.
    pub(super) fn find(footprints: &[Footprint], tree: &Points, eyes: usize) -> Self {
        let found: Vec<Vec<(u32, u32)>> = footprints
            .par_chunks(CHUNK)
            .map(|chunk| {
                let mut pairs = Vec::new();
                tree.within_all(chunk, |f| (f.p, f.radius), |f, eye| pairs.push((eye, f.light)));
                pairs
            })
            .collect();
        let mut begins = vec![0_u32; eyes + 1];
        found.iter().flatten().for_each(|(eye, _)| begins[*eye as usize + 1] += 1);
        (0..eyes).for_each(|i| begins[i + 1] += begins[i]);
        let mut next = begins.clone();
        let mut sorted = vec![0; begins[eyes] as usize];
        for (eye, light) in found.into_iter().flatten() {
            let slot = &mut next[eye as usize];
            sorted[*slot as usize] = light;
            *slot += 1;
        }
        Self { begins, lights: sorted }
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.lights.len()
    }

    /// Those of camera vertex `eye`.
    pub(super) fn of(&self, eye: usize) -> &[u32] {
        &self.lights[self.begins[eye] as usize..self.begins[eye + 1] as usize]
    }
}

/// Camera vertices at these places, for [`Candidates::find`].
pub(super) fn tree(places: impl Iterator<Item = Vec3>) -> Points {
    Points::new(places.zip(0..).collect())
}

/// Footprints in an order in which neighbours are near each other.
pub(super) fn sorted(all: &[Footprint]) -> Vec<Footprint> {
    let places: Vec<Vec3> = all.iter().map(|f| f.p).collect();
    morton::order(&places).into_iter().map(|i| all[i as usize]).collect()
}

/// Chooses about `n` items in proportion to their strengths, by one random number `u`: calls `each` with the number of
/// each one that is chosen, and the times that it was chosen over the expected number.
pub(super) fn choose(strengths: &[f32], n: f32, u: f32, mut each: impl FnMut(usize, f32)) {
    let sum: f64 = strengths.iter().map(|s| f64::from(*s)).sum();
    let (mut passed, mut taken) = (f64::from(u), 0.0);
    for (i, s) in strengths.iter().enumerate() {
        let expected = f64::from(n) * f64::from(*s) / sum;
        passed += expected;
        let times = passed.floor() - taken;
        taken = passed.floor();
        if times > 0.0 {
            each(i, (times / expected) as f32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::choose;

    #[test]
    fn every_item_is_chosen_as_often_as_expected() {
        let strengths = [0.1_f32, 3.0, 0.0, 1.0, 0.4];
        let (n, draws) = (2.5, 4000);
        let mut times = [0.0_f64; 5];
        for i in 0..draws {
            let u = (i as f32 + 0.5) / draws as f32;
            choose(&strengths, n, u, |item, weight| times[item] += f64::from(weight));
        }
        // Weights are times over the expected number, so that each item has weight one in the mean, if it can be chosen
        // at all.
        for (item, sum) in times.into_iter().enumerate() {
            let expected = if strengths[item] > 0.0 { 1.0 } else { 0.0 };
            assert!((sum / f64::from(draws) - expected).abs() < 0.01, "{item}: {sum}");
        }
    }
}
