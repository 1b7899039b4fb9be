//! Photons in a k-d tree: the nearest ones to a point.
//!
//! Source: Jensen 2001, "Realistic Image Synthesis Using Photon Mapping", chapters 4–6. The tree is an array whose middle is
//! the root, as of binary search, split along the widest axis of each part.

use crate::Rgb;
use glam::Vec3;
use std::collections::BinaryHeap;

/// Light that arrived.
#[derive(Clone, Copy, Debug)]
pub struct Photon {
    /// Where.
    pub p: Vec3,
    /// Unit direction back to where it came from.
    pub wi: Vec3,
    /// Flux.
    pub power: Rgb,
    /// Segments of its path.
    pub segments: u32,
}

/// Photons, ready to be searched.
#[derive(Clone, Debug, Default)]
pub struct PhotonMap {
    photons: Vec<Photon>,
    /// Axis that each splits.
    axes: Vec<u8>,
}

impl PhotonMap {
    /// Sorts the photons; the same tree for any number of threads.
    pub fn new(mut photons: Vec<Photon>) -> Self {
        photons.truncate(u32::MAX as usize);
        let mut axes = vec![0; photons.len()];
        sort(&mut photons, &mut axes);
        Self { photons, axes }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.photons.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.photons.is_empty()
    }

    /// Calls `each` with the photons nearest to `p`, at most `count` of those that `wanted` lets by, no farther than
    /// `radius`, from near to far with the squared distance.
    pub fn nearest(
        &self,
        p: Vec3,
        count: usize,
        radius: f32,
        wanted: impl Fn(&Photon) -> bool,
        mut each: impl FnMut(&Photon, f32),
    ) {
        if count == 0 {
            return;
        }
        let mut search = Search { map: self, p, count, reach2: radius * radius, wanted, found: BinaryHeap::new() };
        search.descend(0, self.photons.len());
        for (d2, i) in search.found.into_sorted_vec() {
            each(&self.photons[i as usize], f32::from_bits(d2));
        }
    }
}

fn sort(photons: &mut [Photon], axes: &mut [u8]) {
    if photons.len() < 2 {
        return;
    }
    let fold = |f: fn(Vec3, Vec3) -> Vec3| photons.iter().map(|p| p.p).reduce(f).unwrap_or_default();
    let extent = fold(Vec3::max) - fold(Vec3::min);
    let axis = if extent.x >= extent.y && extent.x >= extent.z {
        0
    } else if extent.y >= extent.z {
        1
    } else {
        2
    };
    let middle = photons.len() / 2;
    photons.select_nth_unstable_by(middle, |a, b| a.p[axis].total_cmp(&b.p[axis]));
    axes[middle] = axis as u8;
    let (first, rest) = photons.split_at_mut(middle);
    let (first_axes, rest_axes) = axes.split_at_mut(middle);
    let mut work = || sort(first, first_axes);
    if rest.len() > 10_000 {
        rayon::join(work, || sort(&mut rest[1..], &mut rest_axes[1..]));
    } else {
        work();
        sort(&mut rest[1..], &mut rest_axes[1..]);
    }
}

struct Search<'a, F> {
    map: &'a PhotonMap,
    p: Vec3,
    count: usize,
    reach2: f32,
    wanted: F,
    /// Squared distances, as bits (their order is that of the numbers), and photons; the farthest on top.
    found: BinaryHeap<(u32, u32)>,
}

impl<F: Fn(&Photon) -> bool> Search<'_, F> {
    fn descend(&mut self, lo: usize, hi: usize) {
        if lo >= hi {
            return;
        }
        let middle = lo + (hi - lo) / 2;
        let photon = &self.map.photons[middle];
        let axis = self.map.axes[middle] as usize;
        let beyond = self.p[axis] - photon.p[axis];
        let (near, far) =
            if beyond < 0.0 { ((lo, middle), (middle + 1, hi)) } else { ((middle + 1, hi), (lo, middle)) };
        self.descend(near.0, near.1);
        let d2 = photon.p.distance_squared(self.p);
        if d2 <= self.reach2 && (self.wanted)(photon) {
            self.found.push((d2.to_bits(), middle as u32));
            if self.found.len() > self.count {
                self.found.pop();
            }
            if let (true, Some((most, _))) = (self.found.len() == self.count, self.found.peek()) {
                self.reach2 = f32::from_bits(*most);
            }
        }
        if beyond * beyond <= self.reach2 {
            self.descend(far.0, far.1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use translume_core::rng::Pcg32;

    #[test]
    fn the_nearest_are_those_of_a_full_search() {
        let mut rng = Pcg32::new(3, 1);
        let mut v = || Vec3::new(rng.next_f32(), rng.next_f32(), rng.next_f32());
        let photons: Vec<Photon> = (0..3000)
            .map(|i| {
                let p = if i % 5 == 0 { (v() * 4.0).floor() * 0.25 } else { v() };
                Photon { p, wi: Vec3::Z, power: Rgb::ONE, segments: i % 4 }
            })
            .collect();
        let map = PhotonMap::new(photons.clone());
        for case in 0..200 {
            let (p, count, radius) = (v() * 1.2 - 0.1, 1 + case % 40, 0.02 + 0.01 * (case % 30) as f32);
            let mut all: Vec<f32> =
                photons.iter().filter(|q| q.segments < 3).map(|q| q.p.distance_squared(p)).collect();
            all.sort_by(f32::total_cmp);
            all.retain(|d| *d <= radius * radius);
            all.truncate(count);
            let mut found = Vec::new();
            map.nearest(p, count, radius, |q| q.segments < 3, |_, d2| found.push(d2));
            assert_eq!(found, all, "{case}");
        }
    }

    #[test]
    fn an_empty_map_has_none() {
        PhotonMap::new(Vec::new()).nearest(Vec3::ZERO, 5, 1.0, |_| true, |_, _| panic!());
    }
}
