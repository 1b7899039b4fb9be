//! Tiles: each part of a picture has as many layers as it needs.
//!
//! A field of K layers spends the same on a black background as on a chrome ball. Cut into tiles of 32 × 32 texels, of which
//! each has the first n of the layers only, the same bytes go where they serve: what a tile would leave after 0, 1, 2, … layers is
//! found by a trial on a part of its rows, and the numbers are those that leave least for the bytes (one price λ a tile and
//! layer for all tiles, by bisection: Everett 1963). A black tile has none: the background is masked.

use crate::texture::Codec;

/// Edge of a tile in texels.
pub const SIDE: usize = 32;
/// Edge of a tile in blocks.
const BLOCKS: usize = SIDE / 4;
/// Most tiles beside and below each other in a texture: 4096 texels.
const MOST: usize = 128;

/// How many layers each tile has.
#[derive(Clone, Debug, PartialEq)]
pub struct Tiles {
    /// Tiles in a row.
    pub across: usize,
    /// By tile, row by row.
    pub counts: Vec<u8>,
}

/// How layers are given to the parts of the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tiling {
    /// As [`Tiling::Adaptive`] where a trial finds that it pays.
    Auto,
    /// All layers everywhere.
    Whole,
    /// All layers wherever any picture has light.
    Mask,
    /// Each tile as many as serve best.
    Adaptive,
}

impl Tiles {
    /// How many tiles a picture has in a row and in a column.
    pub fn grid(width: usize, height: usize) -> (usize, usize) {
        (width.div_ceil(SIDE), height.div_ceil(SIDE))
    }

    /// Layers of the tile that the block at (`x`, `y`) is in.
    pub fn layers_at(&self, x: usize, y: usize) -> usize {
        usize::from(self.counts[y / BLOCKS * self.across + x / BLOCKS])
    }

    /// Tiles that are stored, all layers together.
    pub fn slots(&self) -> usize {
        self.counts.iter().map(|c| usize::from(*c)).sum()
    }

    /// Most layers of a tile.
    pub fn most(&self) -> usize {
        self.counts.iter().max().map_or(0, |c| usize::from(*c))
    }

    /// Bytes of the textures of these `codecs` (by layer), and of the numbers.
    pub fn bytes(&self, codecs: &[Codec]) -> usize {
        let stored = self.counts.iter().flat_map(|c| &codecs[..usize::from(*c).min(codecs.len())]);
        stored.map(|c| c.bytes(SIDE, SIDE)).sum::<usize>() + self.counts.len()
    }

    /// Sets `plane`, of `width` texels in a row, of which the first is row `above` of the picture, to 0 where tiles have no layer
    /// `layer`.
    pub(crate) fn clear(&self, layer: usize, plane: &mut [f32], width: usize, above: usize) {
        for (y, row) in plane.chunks_mut(width).enumerate() {
            for (x, part) in row.chunks_mut(SIDE).enumerate() {
                if self.layers_at(x * BLOCKS, (above + y) / 4) <= layer {
                    part.fill(0.0);
                }
            }
        }
    }

    /// Hands out the stored blocks (8 bytes each) of the layers `data` (their numbers, and blocks of the whole picture, `blocks` in a
    /// row), tile by tile, in each tile layer by layer, as textures of [`Tiles::atlas`] size.
    pub(crate) fn pack(
        &self,
        data: &[(usize, &[u8])],
        blocks: usize,
        put: &mut dyn FnMut(&[u8]) -> std::io::Result<()>,
    ) -> std::io::Result<()> {
        let (size, parts) = self.atlas(data.iter().map(|d| d.0));
        let total = data.first().map_or(0, |d| d.1.len() / 8);
        // Blocks come texture after texture.
        let (mut out, mut current, mut result) = (vec![0u8; size.0 * size.1 / 2], 0, Ok(()));
        self.each_block(data.iter().map(|d| d.0), blocks, total, size, |which, from, part, to| {
            if part > current && result.is_ok() {
                result = put(&out);
                out.fill(0);
                current = part;
            }
            out[8 * to..8 * to + 8].copy_from_slice(&data[which].1[8 * from..8 * from + 8]);
        });
        result?;
        debug_assert_eq!(current + 1, parts);
        put(&out)
    }

    /// The reverse of [`Tiles::pack`]: blocks of the whole picture by layer, 0 where a tile has no such layer. `None` when the
    /// textures are not of the right size or number.
    pub(crate) fn unpack(
        &self,
        layers: &[usize],
        (blocks, rows): (usize, usize),
        size: (usize, usize),
        parts: &[&[u8]],
    ) -> Option<Vec<Vec<u8>>> {
        let (wanted, count) = self.atlas(layers.iter().copied());
        if wanted != size || parts.len() != count || parts.iter().any(|p| p.len() != size.0 * size.1 / 2) {
            return None;
        }
        let mut out = vec![vec![0u8; 8 * blocks * rows]; layers.len()];
        self.each_block(layers.iter().copied(), blocks, blocks * rows, size, |which, to, part, from| {
            out[which][8 * to..8 * to + 8].copy_from_slice(&parts[part][8 * from..8 * from + 8]);
        });
        Some(out)
    }

    /// Width, height and number of the textures that the tiles of these layers fill.
    pub(crate) fn atlas(&self, layers: impl Iterator<Item = usize> + Clone) -> ((usize, usize), usize) {
        let stored = |c: &u8| layers.clone().filter(|l| *l < usize::from(*c)).count();
        let n = self.counts.iter().map(stored).sum::<usize>().max(1);
        let parts = n.div_ceil(MOST * MOST);
        let each = n.div_ceil(parts);
        let down = each.div_ceil(MOST);
        ((SIDE * each.div_ceil(down), SIDE * down), parts)
    }

    /// Calls `f` with (which of `layers`, block of the picture, texture, block of the texture) of all stored blocks.
    fn each_block(
        &self,
        layers: impl Iterator<Item = usize> + Clone,
        blocks: usize,
        total: usize,
        (w, h): (usize, usize),
        mut f: impl FnMut(usize, usize, usize, usize),
    ) {
        let (across, per_part) = (w / SIDE, w / SIDE * (h / SIDE));
        let mut slot = 0;
        for (tile, count) in self.counts.iter().enumerate() {
            let (tx, ty) = (tile % self.across * BLOCKS, tile / self.across * BLOCKS);
            for (which, _) in layers.clone().enumerate().filter(|(_, l)| *l < usize::from(*count)) {
                let (part, place) = (slot / per_part, slot % per_part);
                let (px, py) = (place % across * BLOCKS, place / across * BLOCKS);
                for (x, y) in (0..BLOCKS * BLOCKS).map(|i| (i % BLOCKS, i / BLOCKS)) {
                    let whole = (ty + y) * blocks + tx + x;
                    if tx + x < blocks && whole < total {
                        f(which, whole, part, (py + y) * (w / 4) + px + x);
                    }
                }
                slot += 1;
            }
        }
    }
}

/// Sums of squares by tile of several planes of `width` texels in a row; `tile_row` says which row of tiles a row of texels is in.
pub(crate) fn energies(
    planes: &[f32],
    (width, height): (usize, usize),
    tiles: (usize, usize),
    tile_row: &[usize],
) -> Vec<f64> {
    let mut sums = vec![0.0; tiles.0 * tiles.1];
    for plane in planes.chunks(width * height) {
        for (row, ty) in plane.chunks(width).zip(tile_row) {
            for (part, sum) in row.chunks(SIDE).zip(&mut sums[ty * tiles.0..]) {
                *sum += f64::from(part.iter().map(|v| v * v).sum::<f32>());
            }
        }
    }
    sums
}

/// The number of layers of each tile that leaves least for `budget` layers of tiles in all, given what is left (by number of
/// layers, then tile).
pub(crate) fn choose(left: &[Vec<f64>], budget: usize) -> Vec<u8> {
    let at = |price: f64| -> Vec<u8> {
        let best = |t: usize| {
            let cost = |k: &usize| left[*k][t] + price * *k as f64;
            (0..left.len()).min_by(|a, b| cost(a).total_cmp(&cost(b))).unwrap_or(0) as u8
        };
        (0..left[0].len()).map(best).collect()
    };
    let total = |counts: &[u8]| counts.iter().map(|c| usize::from(*c)).sum::<usize>();
    // Between no price and one that nothing is worth.
    let (mut low, mut high) = (0.0, left[0].iter().copied().fold(0.0, f64::max) + 1e-300);
    for _ in 0..60 {
        let middle = if low == 0.0 { 1e-3 * high } else { f64::sqrt(low * high) };
        if total(&at(middle)) > budget {
            low = middle;
        } else {
            high = middle;
        }
        if low == 0.0 && high < 1e-18 {
            break;
        }
    }
    at(high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layers_go_where_they_serve() {
        // A black tile, one that one layer does, and two that fall slowly, one of them ten times as strong.
        let fall = |s: f64| move |k: usize| s * 0.5f64.powi(k as i32);
        let left: Vec<Vec<f64>> =
            (0..9).map(|k| vec![0.0, if k == 0 { 5.0 } else { 0.0 }, fall(1.0)(k), fall(16.0)(k)]).collect();
        let counts = choose(&left, 7);
        assert_eq!(counts, [0, 1, 1, 5]);
        assert!(choose(&left, 0).iter().all(|c| *c == 0));
        assert_eq!(choose(&left, 1000), [0, 1, 8, 8]);
    }

    #[test]
    fn blocks_come_back_from_their_tiles() {
        // 70 × 40 texels: 18 × 10 blocks in 3 × 2 tiles, cut at two edges.
        let (blocks, rows) = (18, 10);
        let tiles = Tiles { across: 3, counts: vec![2, 0, 3, 1, 2, 3] };
        let layer = |j: usize| -> Vec<u8> { (0..blocks * rows * 8).map(|i| (i * 7 + j * 31) as u8 | 1).collect() };
        let data = [layer(0), layer(2)];
        let (mut parts, (w, h)) = (Vec::new(), tiles.atlas([0, 2].into_iter()).0);
        let mut put = |part: &[u8]| {
            parts.push(part.to_vec());
            Ok(())
        };
        tiles.pack(&[(0, &data[0]), (2, &data[1])], blocks, &mut put).unwrap();
        assert_eq!(((w, h), parts.len()), ((7 * SIDE, SIDE), 1));
        let parts: Vec<&[u8]> = parts.iter().map(|p| &p[..]).collect();
        let back = tiles.unpack(&[0, 2], (blocks, rows), (w, h), &parts).unwrap();
        for (which, number) in [(0, 0), (1, 2)] {
            for i in 0..blocks * rows {
                let there = tiles.layers_at(i % blocks, i / blocks) > number;
                let expected: Vec<u8> = if there { data[which][8 * i..8 * i + 8].to_vec() } else { vec![0; 8] };
                assert_eq!(back[which][8 * i..8 * i + 8], expected, "{which} {i}");
            }
        }
        assert!(tiles.unpack(&[0, 2], (blocks, rows), (w, h), &parts[..0]).is_none());
        assert!(tiles.unpack(&[0, 1], (blocks, rows), (w, h), &parts).is_none());
    }
}
