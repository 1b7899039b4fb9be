//! The camera paths of some tiles: which pixels share what they find, and the silhouettes of lights.

use super::eye::{CameraSubpath, Eye};
use super::{Block, GKernel, Plan};
use crate::film::Tile;
use crate::render::Shot;
use crate::subpath::Limits;
use crate::{PathSampler, Rgb, luminance};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use translume_core::sampler::Sampler;

/// Rays more for a pixel at the silhouette of a light. A light is hundreds of times brighter than what it lights, so
/// that how much of such a pixel it covers would be most of the noise of a picture, and takes next to nothing to find
/// out.
const SILHOUETTE_RAYS: u64 = 15;

/// Least contrast around a pixel that is called a silhouette.
const MIN_CONTRAST: f32 = 0.1;

/// Side of the squares that groups are made in, over that of a group.
const SPREAD: u32 = 2;

/// Tasks that the groups of a block are made of.
const TASKS: usize = 128;

impl GKernel {
    fn eye<'a>(&self, shot: &Shot<'a>, plan: Plan<'a>) -> Eye<'a> {
        let limits = Limits { segments: self.settings.most_segments(), rr_depth: self.settings.rr_depth };
        Eye { world: shot.world, limits, hide_lights: self.settings.hide_emitters, plan }
    }

    /// Camera paths number `sample` of the pixels of `tile` that `wanted` says, each for itself.
    pub(super) fn sparse_eyes<'a>(
        &self,
        shot: &Shot<'a>,
        plan: Plan<'a>,
        (tile, sample): (&Tile, u64),
        wanted: impl Fn(usize) -> bool,
    ) -> Block<'a> {
        let eye = self.eye(shot, plan);
        let mut block = Block::default();
        for i in (0..tile.sums.len()).filter(|i| wanted(*i)) {
            let subpath = begin(shot, &eye, (0, tile), (i, sample), &mut block.rays);
            eye.continue_paths(vec![subpath], 1, &mut block);
        }
        block
    }

    /// Camera paths number `sample` of all pixels of `tiles`.
    pub(super) fn eyes<'a>(
        &self,
        shot: &Shot<'a>,
        plan: Plan<'a>,
        tiles: &[Tile],
        sample: u64,
        stop: &AtomicBool,
    ) -> Vec<Block<'a>> {
        let eye = self.eye(shot, plan);
        let walk = |(number, tile): (usize, &Tile)| {
            let mut rays = 0;
            let pixels = 0..if stop.load(Ordering::Relaxed) { 0 } else { tile.sums.len() };
            let mut walks: Vec<CameraSubpath> =
                pixels.map(|i| begin(shot, &eye, (number as u32, tile), (i, sample), &mut rays)).collect();
            if !walks.is_empty() {
                supersample_silhouettes(shot, (tile, sample), &eye, &mut walks, &mut rays);
            }
            (walks, rays)
        };
        let (walks, rays): (Vec<_>, Vec<u64>) = tiles.par_iter().enumerate().map(walk).unzip();
        let walks: Vec<CameraSubpath> = walks.into_iter().flatten().collect();
        let groups = if self.shared > 1 {
            groups(walks, |w| w.pixel, self.shared, PathSampler::new(shot.seed ^ 0x7368_6966, 0, sample))
        } else {
            walks.into_iter().map(|subpath| vec![subpath]).collect()
        };
        let per_task = groups.len().div_ceil(TASKS).max(1);
        let continue_paths = |mut block: Block<'a>, group| {
            eye.continue_paths(group, self.sharers, &mut block);
            block
        };
        let mut blocks: Vec<Block> =
            groups.into_par_iter().fold_chunks(per_task, Block::default, continue_paths).collect();
        if let Some(block) = blocks.first_mut() {
            block.rays += rays.iter().sum::<u64>();
        }
        blocks
    }
}

fn begin(
    shot: &Shot,
    eye: &Eye,
    (number, tile): (u32, &Tile),
    (i, sample): (usize, u64),
    rays: &mut u64,
) -> CameraSubpath {
    let (sampler, ray, weight) = shot.camera_path(tile, i, sample);
    let begin = (&ray, shot.camera_density(&ray), weight);
    eye.begin((number, i as u32), tile.pixel(i), begin, sampler, rays)
}

/// Camera paths in groups of about `side`² pixels, by their place in the picture. Neighbours are in different groups,
/// by chance: what is left of the noise that a group has in common looks like noise, not like blocks.
fn groups<T>(walks: Vec<T>, pixel: impl Fn(&T) -> [u32; 2], side: u32, mut sampler: PathSampler) -> Vec<Vec<T>> {
    // The squares lie elsewhere for each sample, so that their borders do not show.
    let square = SPREAD * side;
    let shift = (sampler.next_2d() * square as f32).as_uvec2();
    let mut squares = BTreeMap::<_, Vec<(u32, T)>>::new();
    for subpath in walks {
        let [x, y] = pixel(&subpath);
        let (x, y) = (x + shift.x, y + shift.y);
        let along = (0..16).map(|bit| (x >> bit & 1) << (2 * bit) | (y >> bit & 1) << (2 * bit + 1)).sum();
        squares.entry((y / square, x / square)).or_default().push((along, subpath));
    }
    let mut all = Vec::new();
    for (_, mut square) in squares {
        // In Morton order as many as there are groups are one beside the other; each group gets one of them.
        square.sort_by_key(|(along, _)| *along);
        let n = ((square.len() as u32 + side * side / 2) / (side * side)).max(1) as usize;
        let begin = all.len();
        all.resize_with(begin + n, Vec::new);
        let mut order: Vec<usize> = (0..n).collect();
        for (i, (_, subpath)) in square.into_iter().enumerate() {
            if i % n == 0 {
                for k in (1..n).rev() {
                    order.swap(k, ((sampler.next_1d() * (k + 1) as f32) as usize).min(k));
                }
            }
            all[begin + order[i % n]].push(subpath);
        }
    }
    all
}

/// Sends more rays through pixels at the silhouettes of lights, for what they see at once. Whether a pixel is one its
/// neighbours say, not its own path, which counts as one ray more: no bias.
fn supersample_silhouettes(
    shot: &Shot,
    (tile, sample): (&Tile, u64),
    eye: &Eye,
    walks: &mut [CameraSubpath],
    rays: &mut u64,
) {
    let [w, h] = tile.size.map(|n| n as usize);
    let seen: Vec<f32> = walks.iter().map(|subpath| luminance(eye.direct_emission(subpath))).collect();
    if seen.iter().all(|s| *s == 0.0) {
        return;
    }
    for (i, subpath) in walks.iter_mut().enumerate() {
        let (x, y) = (i % w, i / w);
        let around = |n: usize, most: usize| n.saturating_sub(1)..(n + 2).min(most);
        let others = around(y, h).flat_map(|v| around(x, w).map(move |u| v * w + u)).filter(|j| *j != i);
        let (min, max) = others.fold((f32::INFINITY, 0.0_f32), |(a, b), j| (a.min(seen[j]), b.max(seen[j])));
        if max - min <= MIN_CONTRAST * max {
            continue;
        }
        *rays += SILHOUETTE_RAYS;
        let along = |k| {
            let (ray, weight) = shot.camera_ray_beside(tile, i, sample * SILHOUETTE_RAYS + k);
            eye.direct_emission_along(&ray) * weight
        };
        let part = 1.0 / (SILHOUETTE_RAYS + 1) as f32;
        subpath.supersampled = (0..SILHOUETTE_RAYS).map(along).sum::<Rgb>() * part;
        subpath.own_part = part;
    }
}

#[cfg(test)]
mod tests {
    use super::groups;
    use crate::PathSampler;

    #[test]
    fn groups_have_every_pixel_once_and_part_neighbours() {
        for (w, h, side) in [(40_u32, 24_u32, 8_u32), (16, 16, 3), (5, 16, 8), (1, 1, 8), (64, 64, 16)] {
            for sample in 0..5 {
                let pixels: Vec<[u32; 2]> = (0..h).flat_map(|y| (0..w).map(move |x| [x, y])).collect();
                let groups = groups(pixels.clone(), |p| *p, side, PathSampler::new(7, 0, sample));
                let mut all = groups.concat();
                all.sort_unstable_by_key(|p| (p[1], p[0]));
                assert_eq!(all, pixels, "{w} {h} {side}");
                assert!(groups.iter().all(|g| g.len() as u32 <= 2 * side * side), "{w} {h} {side}");
            }
        }
        // Of a large picture's pixels with their right neighbours.
        let pixels: Vec<[u32; 2]> = (0..64).flat_map(|y| (0..64).map(move |x| [x, y])).collect();
        let groups = groups(pixels, |p| *p, 8, PathSampler::new(7, 0, 1));
        let together = |g: &Vec<[u32; 2]>| g.iter().filter(|p| g.contains(&[p[0] + 1, p[1]])).count();
        let part = groups.iter().map(together).sum::<usize>() as f32 / 4096.0;
        // In blocks it would be seven eighths.
        assert!(part < 0.3, "{part}");
    }
}
