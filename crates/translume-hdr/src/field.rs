//! Where each anchor pixel lies in another picture: a global affine map after a bilinear grid of displacements.

/// Row-major `[a b tx; c d ty]`: x' = a x + b y + tx, y' = c x + d y + ty.
pub type Affine = [f64; 6];

/// The map that moves nothing.
pub(crate) const IDENTITY: Affine = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0];

/// Applies an affine map.
#[inline]
pub(crate) fn apply(m: &Affine, x: f32, y: f32) -> (f32, f32) {
    let (x, y) = (f64::from(x), f64::from(y));
    ((m[0] * x + m[1] * y + m[2]) as f32, (m[3] * x + m[4] * y + m[5]) as f32)
}

/// `a` after `b`.
pub(crate) fn compose(a: &Affine, b: &Affine) -> Affine {
    [
        a[0] * b[0] + a[1] * b[3],
        a[0] * b[1] + a[1] * b[4],
        a[0] * b[2] + a[1] * b[5] + a[2],
        a[3] * b[0] + a[4] * b[3],
        a[3] * b[1] + a[4] * b[4],
        a[3] * b[2] + a[4] * b[5] + a[5],
    ]
}

/// The inverse, `None` for a map that flattens.
pub(crate) fn invert(m: &Affine) -> Option<Affine> {
    let det = m[0] * m[4] - m[1] * m[3];
    if det.abs() < 1e-9 || !det.is_finite() {
        return None;
    }
    let (a, b, c, d) = (m[4] / det, -m[1] / det, -m[3] / det, m[0] / det);
    Some([a, b, -(a * m[2] + b * m[5]), c, d, -(c * m[2] + d * m[5])])
}

/// Displacements at the centres of square blocks of `step` pixels, in pixels, bilinear in between.
#[derive(Clone, Debug)]
pub struct Grid {
    /// Block size in pixels.
    pub step: usize,
    /// Nodes in a row.
    pub nx: usize,
    /// Rows of nodes.
    pub ny: usize,
    /// `[dx, dy]` per node.
    pub nodes: Vec<[f32; 2]>,
}

impl Grid {
    /// A grid that moves nothing and covers a picture.
    pub fn zero(step: usize, width: usize, height: usize) -> Self {
        let (nx, ny) = (width.div_ceil(step).max(1), height.div_ceil(step).max(1));
        Self { step, nx, ny, nodes: vec![[0.0; 2]; nx * ny] }
    }

    /// Pixel position of a node.
    #[inline]
    pub fn centre(&self, i: usize) -> f32 {
        (i * self.step) as f32 + 0.5 * (self.step as f32 - 1.0)
    }

    /// Displacement at a pixel.
    #[inline]
    pub fn at(&self, x: f32, y: f32) -> [f32; 2] {
        let half = 0.5 * (self.step as f32 - 1.0);
        let inverse = 1.0 / self.step as f32;
        let gx = ((x - half) * inverse).clamp(0.0, (self.nx - 1) as f32);
        let gy = ((y - half) * inverse).clamp(0.0, (self.ny - 1) as f32);
        let (ix, iy) = (gx as usize, gy as usize);
        let (fx, fy) = (gx - ix as f32, gy - iy as f32);
        let (ix1, iy1) = ((ix + 1).min(self.nx - 1), (iy + 1).min(self.ny - 1));
        let (a, b) = (self.nodes[iy * self.nx + ix], self.nodes[iy * self.nx + ix1]);
        let (c, d) = (self.nodes[iy1 * self.nx + ix], self.nodes[iy1 * self.nx + ix1]);
        std::array::from_fn(|k| {
            let top = a[k] + fx * (b[k] - a[k]);
            let bottom = c[k] + fx * (d[k] - c[k]);
            top + fy * (bottom - top)
        })
    }
}

/// Maps anchor pixels to positions in another picture: `affine(p + grid(p))`.
#[derive(Clone, Debug)]
pub struct Field {
    /// The global part.
    pub affine: Affine,
    /// The local part, if there is any.
    pub grid: Option<Grid>,
}

impl Field {
    /// The field that moves nothing.
    pub fn identity() -> Self {
        Self { affine: IDENTITY, grid: None }
    }

    /// Whether it moves nothing.
    pub fn is_identity(&self) -> bool {
        self.affine == IDENTITY && self.grid.is_none()
    }

    /// Position in the other picture of anchor pixel (x, y).
    #[inline]
    pub fn source(&self, x: f32, y: f32) -> (f32, f32) {
        match &self.grid {
            None => apply(&self.affine, x, y),
            Some(g) => {
                let d = g.at(x, y);
                apply(&self.affine, x + d[0], y + d[1])
            }
        }
    }

    /// Displacement in anchor pixels at (x, y).
    #[inline]
    pub fn displacement(&self, x: f32, y: f32) -> [f32; 2] {
        let (sx, sy) = self.source(x, y);
        [sx - x, sy - y]
    }

    /// The largest length of the displacement over a picture, sampled every 8 pixels and at the far edges.
    pub fn longest(&self, width: usize, height: usize) -> f32 {
        let rows = || (0..height).step_by(8).chain([height - 1]);
        let columns = || (0..width).step_by(8).chain([width - 1]);
        let lengths = rows().flat_map(|y| columns().map(move |x| self.displacement(x as f32, y as f32)));
        lengths.map(|[dx, dy]| dx.hypot(dy)).fold(0.0, f32::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_undoes() {
        let m = [0.98, -0.17, 5.0, 0.17, 0.98, -3.0];
        let back = compose(&invert(&m).unwrap(), &m);
        for (a, b) in back.iter().zip(IDENTITY) {
            assert!((a - b).abs() < 1e-12);
        }
        assert!(invert(&[1.0, 2.0, 0.0, 2.0, 4.0, 0.0]).is_none());
    }

    #[test]
    fn grid_is_bilinear_between_nodes() {
        let mut g = Grid::zero(16, 64, 48);
        for iy in 0..g.ny {
            for ix in 0..g.nx {
                g.nodes[iy * g.nx + ix] = [0.5 * g.centre(ix), -0.25 * g.centre(iy)];
            }
        }
        let d = g.at(20.0, 19.0);
        assert!((d[0] - 10.0).abs() < 1e-4 && (d[1] + 4.75).abs() < 1e-4, "{d:?}");
    }
}
