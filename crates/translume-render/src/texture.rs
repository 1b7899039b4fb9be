//! Values of textures at shading points.

use crate::{Rgb, luminance};
use glam::{DVec2, Vec2};
use translume_scene::texture::{Bitmap, Channel, Checkerboard, Filter, Texture, Wrap};
use translume_scene::{Scene, TextureId};

/// Where a texture is looked up.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    pub(crate) uv: Vec2,
    /// The mesh's vertex colour, white where it has none.
    pub(crate) color: Rgb,
}

/// The colour of a texture.
#[inline]
pub(crate) fn eval(scene: &Scene, id: TextureId, at: &Place) -> Rgb {
    match &scene.textures[id.0] {
        Texture::Constant(rgb) => *rgb,
        Texture::Bitmap(bitmap) => bitmap_value(bitmap, at.uv),
        Texture::Checkerboard(board) => eval(scene, square(board, at.uv), at),
        Texture::VertexColor(factor) => *factor * at.color,
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
    let (cell, t) = cell_of(bitmap, at.uv);
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
