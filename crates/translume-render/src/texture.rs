//! Values of textures at shading points.

use crate::{Rgb, luminance};
use glam::{DVec2, Vec2, Vec3};
use translume_mesh::TriMesh;
use translume_scene::texture::{Bitmap, Channel, Checkerboard, Filter, Texture, Wrap};
use translume_scene::{Scene, TextureId};

/// Where a texture is looked up.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place<'a> {
    /// Texture coordinates, of the first set.
    pub(crate) uv: Vec2,
    /// Where it is on a mesh.
    pub(crate) on: Option<OnMesh<'a>>,
}

/// A point of a triangle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OnMesh<'a> {
    pub(crate) mesh: &'a TriMesh,
    pub(crate) face: u32,
    /// Barycentric coordinates of the second and third corner.
    pub(crate) b: Vec2,
}

impl Place<'_> {
    /// Not on a mesh.
    pub(crate) fn bare(uv: Vec2) -> Self {
        Place { uv, on: None }
    }

    /// Texture coordinates of a set, of the first where there is no such.
    fn coordinates(&self, set: usize) -> Vec2 {
        match self.on {
            Some(on) if set > 0 => match on.mesh.more_uvs.get(set - 1) {
                Some(uvs) => on.mean(|i| Vec2::from(uvs[i])),
                None => self.uv,
            },
            _ => self.uv,
        }
    }
}

impl OnMesh<'_> {
    /// The mean of what the corners have.
    #[inline]
    pub(crate) fn mean<T: std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>>(
        &self,
        of: impl Fn(usize) -> T,
    ) -> T {
        let [i, j, k] = self.mesh.indices[self.face as usize].map(|i| i as usize);
        of(i) * (1.0 - self.b.x - self.b.y) + of(j) * self.b.x + of(k) * self.b.y
    }
}

/// Derivatives of the place on a mesh, in the mesh's space, by the axes of the picture of `id`: towards its right and
/// towards its top. `None` where nothing says how the picture lies.
pub(crate) fn picture_axes(scene: &Scene, id: TextureId, at: &Place) -> Option<(Vec3, Vec3)> {
    let (Texture::Bitmap(bitmap), Some(on)) = (&scene.textures[id.0], at.on) else { return None };
    let set = bitmap.set.checked_sub(1).and_then(|i| on.mesh.more_uvs.get(i)).or(on.mesh.uvs.as_ref())?;
    let [a, b, c] = on.mesh.indices[on.face as usize].map(|i| {
        let uv = bitmap.image_from_uv.transform_point2(Vec2::from(set[i as usize]).as_dvec2());
        (Vec3::from(on.mesh.positions[i as usize]), uv)
    });
    let (e1, e2, d1, d2) = (b.0 - a.0, c.0 - a.0, (b.1 - a.1).as_vec2(), (c.1 - a.1).as_vec2());
    let determinant = d1.perp_dot(d2);
    let (right, down) = ((e1 * d2.y - e2 * d1.y) / determinant, (e2 * d1.x - e1 * d2.x) / determinant);
    (right.is_finite() && down.is_finite()).then_some((right, -down))
}

/// The colour of a texture.
#[inline]
pub(crate) fn eval(scene: &Scene, id: TextureId, at: &Place) -> Rgb {
    match &scene.textures[id.0] {
        Texture::Constant(rgb) => *rgb,
        Texture::Bitmap(bitmap) => bitmap_value(bitmap, at.coordinates(bitmap.set)),
        Texture::Checkerboard(board) => eval(scene, square(board, at.uv), at),
        Texture::VertexColor(factor) => match at.on.and_then(|on| Some((on, on.mesh.colors.as_ref()?))) {
            Some((on, colors)) => *factor * on.mean(|i| Rgb::from(colors[i])),
            None => *factor,
        },
        Texture::VertexAlpha => match at.on.and_then(|on| Some((on, on.mesh.alphas.as_ref()?))) {
            Some((on, alphas)) => Rgb::splat(on.mean(|i| alphas[i])),
            None => Rgb::ONE,
        },
        Texture::Product(a, b) => eval(scene, *a, at) * eval(scene, *b, at),
        Texture::Complement(of) => Rgb::ONE - eval(scene, *of, at),
        Texture::Threshold { of, at: least } => Rgb::splat(if eval_1d(scene, *of, at) >= *least { 1.0 } else { 0.0 }),
    }
}

/// The number of a texture.
#[inline]
pub(crate) fn eval_1d(scene: &Scene, id: TextureId, at: &Place) -> f32 {
    let v = eval(scene, id, at);
    if v.x == v.y && v.y == v.z { v.x } else { luminance(v) }
}

/// Derivatives of the number by the texture coordinates u and v; zero for what is piecewise constant.
pub(crate) fn gradient(scene: &Scene, id: TextureId, at: &Place) -> Vec2 {
    let Texture::Bitmap(bitmap) = &scene.textures[id.0] else { return Vec2::ZERO };
    if bitmap.filter == Filter::Nearest {
        return Vec2::ZERO;
    }
    let (w, h) = bitmap.image.pixels.dimensions();
    let (cell, t) = cell_of(bitmap, at.coordinates(bitmap.set));
    let [a, b, c, d] = corners(bitmap, cell).map(|v| if v.x == v.y && v.y == v.z { v.x } else { luminance(v) });
    let dx = ((b - a) * (1.0 - t.y) + (d - c) * t.y) * w as f32;
    let dy = ((c - a) * (1.0 - t.x) + (d - b) * t.x) * h as f32;
    let m = bitmap.image_from_uv.matrix2.as_mat2();
    Vec2::new(m.x_axis.dot(Vec2::new(dx, dy)), m.y_axis.dot(Vec2::new(dx, dy)))
}

fn square(board: &Checkerboard, uv: Vec2) -> TextureId {
    let p = board.board_from_uv.transform_point2(uv.as_dvec2());
    let left = |x: f64| x - x.floor() < 0.5;
    if left(p.x) == left(p.y) { board.color0 } else { board.color1 }
}

#[inline]
fn bitmap_value(bitmap: &Bitmap, uv: Vec2) -> Rgb {
    if bitmap.filter == Filter::Nearest {
        let (w, h) = bitmap.image.pixels.dimensions();
        let p = bitmap.image_from_uv.transform_point2(uv.as_dvec2()) * DVec2::new(w.into(), h.into());
        return texel(bitmap, p.x.floor() as i64, p.y.floor() as i64);
    }
    let (cell, t) = cell_of(bitmap, uv);
    let [a, b, c, d] = corners(bitmap, cell);
    (a * (1.0 - t.x) + b * t.x) * (1.0 - t.y) + (c * (1.0 - t.x) + d * t.x) * t.y
}

/// The cell between four pixel centres, by its upper left pixel, and the place in it.
#[inline]
fn cell_of(bitmap: &Bitmap, uv: Vec2) -> ([i64; 2], Vec2) {
    let (w, h) = bitmap.image.pixels.dimensions();
    let p = bitmap.image_from_uv.transform_point2(uv.as_dvec2()) * DVec2::new(w.into(), h.into()) - 0.5;
    let corner = p.floor();
    ([corner.x as i64, corner.y as i64], (p - corner).as_vec2())
}

#[inline]
fn corners(bitmap: &Bitmap, [x, y]: [i64; 2]) -> [Rgb; 4] {
    let (w, h) = bitmap.image.pixels.dimensions();
    let (x1, y1) = (x.saturating_add(1), y.saturating_add(1));
    if x >= 0 && y >= 0 && x1 < w.into() && y1 < h.into() {
        let at = y as usize * w as usize + x as usize;
        return [at, at + 1, at + w as usize, at + w as usize + 1].map(|i| value(bitmap, i));
    }
    [(x, y), (x1, y), (x, y1), (x1, y1)].map(|(x, y)| texel(bitmap, x, y))
}

fn texel(bitmap: &Bitmap, x: i64, y: i64) -> Rgb {
    let (w, h) = bitmap.image.pixels.dimensions();
    match (wrapped(x, w.into(), bitmap.wrap[0]), wrapped(y, h.into(), bitmap.wrap[1])) {
        (Ok(x), Ok(y)) => value(bitmap, y * w as usize + x),
        (Err(outside), _) | (_, Err(outside)) => outside * bitmap.scale,
    }
}

/// Of pixel number `i`.
#[inline]
fn value(bitmap: &Bitmap, i: usize) -> Rgb {
    let p = &bitmap.image.pixels.as_raw()[3 * i..3 * i + 3];
    let value = match bitmap.channel {
        Channel::Alpha => Rgb::splat(bitmap.image.alpha.as_ref().map_or(1.0, |a| a[i])),
        Channel::Red => Rgb::splat(p[0]),
        Channel::Green => Rgb::splat(p[1]),
        Channel::Blue => Rgb::splat(p[2]),
        _ => Rgb::new(p[0], p[1], p[2]),
    };
    value * bitmap.scale
}

#[inline]
fn wrapped(x: i64, n: i64, wrap: Wrap) -> Result<usize, Rgb> {
    if (0..n).contains(&x) {
        return Ok(x as usize);
    }
    match wrap {
        Wrap::Repeat => Ok(x.rem_euclid(n) as usize),
        Wrap::Mirror => {
            let x = x.rem_euclid(2 * n);
            Ok(if x < n { x } else { 2 * n - 1 - x } as usize)
        }
        Wrap::Clamp => Ok(x.clamp(0, n - 1) as usize),
        Wrap::Zero => Err(Rgb::ZERO),
        Wrap::One => Err(Rgb::ONE),
    }
}
