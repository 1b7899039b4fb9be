//! R_d between any two places, as relighting has it.

use super::atlas::{NONE, RADIUS};
use super::kernel::{CELLS, cells};
use super::model::Hierarchical;
use super::split::near_enough;
use glam::Vec3;

/// A place of the surface: triangle, barycentric coordinates of its second and third corner.
pub(crate) type On = (u32, [f32; 2]);

impl Hierarchical {
    /// R_d in mm⁻² of light that goes in at `from` and comes out at `to`: T F, linear between vertices, and K of the texel that `from` lies in,
    /// linear between the texels around `to`. Noise of K can make it negative.
    pub(crate) fn reflectance(&self, from: On, to: On) -> Vec3 {
        let corners = |(face, [u, v]): On| (self.mesh.indices[face as usize], [1.0 - u - v, u, v]);
        let around = self.atlas.between(to.0, to.1);
        let detail: Vec3 = around.iter().map(|&(t, w)| w * Vec3::from(self.detail[t as usize])).sum();
        let mut sum = detail * Vec3::from(self.throughput.between(corners(from), corners(to)));
        let reach = (2.2 * (2.0 * (RADIUS * RADIUS) as f32).sqrt() + 6.0) * self.atlas.texel_mm;
        if self.at(from).distance(self.at(to)) > reach {
            return sum;
        }
        let Some(lit) = self.atlas.texel(from.0, from.1) else { return sum };
        for (t, w) in around.into_iter().filter(|a| a.1 > 0.0) {
            let t = t as usize;
            for (cell, (dx, dy)) in cells().enumerate() {
                if self.atlas.neighbour(t, dx, dy).unwrap_or(NONE as usize) == lit {
                    let d = self.atlas.texels[lit].at.distance(self.atlas.texels[t].at) / self.atlas.texel_mm;
                    if near_enough(dx, dy, d) {
                        sum += w * Vec3::from(self.kernels[t * CELLS + cell].map(half::f16::to_f32));
                    }
                }
            }
        }
        sum
    }

    fn at(&self, (face, [u, v]): On) -> Vec3 {
        let [a, b, c] = self.mesh.corners(face as usize);
        a + u * (b - a) + v * (c - a)
    }
}
