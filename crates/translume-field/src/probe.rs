//! Light directions from a ball in the picture, seen from afar (orthographically).
//!
//! A mirror ball shows the light where the normal is half way between light and view: with the highlight's normal n and
//! the view v = (0, 0, 1), l = 2 (n·v) n − v. A matt ball is n·l wherever it is lit: a least-squares fit over its lit
//! pixels, fitted again over those that the first fit says are lit, gives direction and strength.
//!
//! What looks like no ball gives no direction: a mirror has one small spot much brighter than most of it, a matt ball is what
//! the fit says it is. Half of the ball at least must be in the picture.

use crate::lights::normalised;
use crate::{Error, Result};
use std::path::Path;
use translume_image::{Picture, read_picture};

/// A ball in a picture, in pixels; the centre of the top left pixel is (0, 0).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    /// Column of the centre.
    pub x: f32,
    /// Row of the centre.
    pub y: f32,
    /// Radius.
    pub radius: f32,
}

/// What the ball is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Surface {
    /// Chrome: a highlight.
    Mirror,
    /// Plaster or grey paint: a shading.
    Matt,
}

/// A light as a ball shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProbeLight {
    /// Unit direction, x right, y up, z to the camera.
    pub direction: [f32; 3],
    /// What a matt ball shows where it faces the light; 1 for a mirror, whose highlight is mostly clipped.
    pub strength: f32,
}

/// The light that `ball` shows in the picture at `path`.
///
/// # Errors
/// Of reading; [`Error::Invalid`] when the ball is not in the picture or shows no light.
pub fn light(path: &Path, ball: Ball, surface: Surface) -> Result<ProbeLight> {
    let picture = read_picture(path)?;
    let found = match surface {
        Surface::Mirror => highlight(&picture, ball),
        Surface::Matt => shading(&picture, ball),
    };
    found.ok_or_else(|| {
        let (x, y, r) = (ball.x, ball.y, ball.radius);
        Error::invalid(path, format!("the ball at ({x}, {y}) of radius {r} shows no light: is it there?"))
    })
}

/// Normals and mean values of the pixels on the ball, the outermost 2 % left out.
fn pixels(picture: &Picture, ball: Ball) -> Vec<([f32; 3], f32)> {
    let rows = picture.pixels.enumerate_pixels();
    rows.filter_map(|(x, y, p)| {
        let (nx, ny) = ((x as f32 - ball.x) / ball.radius, (ball.y - y as f32) / ball.radius);
        let r2 = nx * nx + ny * ny;
        let value = (p[0] + p[1] + p[2]) / 3.0;
        (r2 < 0.96 && value.is_finite()).then(|| ([nx, ny, (1.0 - r2).sqrt()], value))
    })
    .collect()
}

/// Whether most of the ball lies within the picture.
fn is_in_picture(pixels: &[([f32; 3], f32)], ball: Ball) -> bool {
    pixels.len() as f32 > 0.5 * 0.96 * std::f32::consts::PI * ball.radius * ball.radius
}

/// The brightest of the pixels of a mirror, of which this part at most is a lamp's reflection …
const MOST_BRIGHT: f32 = 0.2;
/// … this part at least in one place, a spot of their area or somewhat more …
const LEAST_TOGETHER: f32 = 0.5;
/// … and that many times as bright as three quarters of all, which the shading of a matt ball or a gloss is not.
const LEAST_CONTRAST: f32 = 2.0;
/// What the shading of a matt ball may differ from the fit, RMS, relative to the values'.
const MOST_RESIDUAL: f64 = 0.25;

fn highlight(picture: &Picture, ball: Ball) -> Option<ProbeLight> {
    let pixels = pixels(picture, ball);
    if !is_in_picture(&pixels, ball) {
        return None;
    }
    let most = pixels.iter().map(|p| p.1).fold(0.0, f32::max);
    // The brightest spot; a lamp's reflection is mostly clipped. Other bright things on the ball are kept out by taking
    // only what is near the spot's own centre, found again as it moves.
    let bright: Vec<_> = pixels.iter().filter(|p| p.1 > 0.9 * most && most > 0.0).collect();
    let centre_of = |around: Option<[f32; 3]>| {
        let close = |n: &[f32; 3]| around.is_none_or(|c| near(n, c, 0.15));
        let mut sum = [0.0f32; 3];
        bright.iter().filter(|p| close(&p.0)).for_each(|p| (0..3).for_each(|i| sum[i] += p.0[i] * p.1));
        normalised(sum)
    };
    // The densest place to start from: the bright pixel with most others about it, of up to 400.
    let step = bright.len().div_ceil(400).max(1);
    let about = |n: &[f32; 3]| bright.iter().filter(|p| near(n, p.0, 0.1)).count();
    let mut n = bright.iter().step_by(step).max_by_key(|p| about(&p.0))?.0;
    for _ in 0..3 {
        n = centre_of(Some(n))?;
    }
    let mut values: Vec<f32> = pixels.iter().map(|p| p.1).collect();
    let third = values.len() * 3 / 4;
    let quartile = *values.select_nth_unstable_by(third, f32::total_cmp).1;
    let spot = (1.5 * (bright.len() as f32 / pixels.len() as f32).sqrt()).max(0.15);
    let together = bright.iter().filter(|p| near(&p.0, n, spot)).count() as f32;
    let is_lamp = (bright.len() as f32) < MOST_BRIGHT * pixels.len() as f32
        && together > LEAST_TOGETHER * bright.len() as f32
        && most > LEAST_CONTRAST * quartile;
    if !is_lamp {
        return None;
    }
    let direction = [2.0 * n[2] * n[0], 2.0 * n[2] * n[1], 2.0 * n[2] * n[2] - 1.0];
    Some(ProbeLight { direction: normalised(direction)?, strength: 1.0 })
}

/// Whether two normals are closer than `distance`.
fn near(a: &[f32; 3], b: [f32; 3], distance: f32) -> bool {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f32>() < distance * distance
}

fn shading(picture: &Picture, ball: Ball) -> Option<ProbeLight> {
    let pixels = pixels(picture, ball);
    if !is_in_picture(&pixels, ball) {
        return None;
    }
    let most = pixels.iter().map(|p| p.1).fold(0.0, f32::max);
    if most <= 0.0 {
        return None;
    }
    let mut l = fit(pixels.iter().filter(|p| p.1 > 0.2 * most))?;
    for _ in 0..4 {
        let strength = l.norm();
        l = fit(pixels.iter().filter(|p| dot(p.0, &l) > 0.1 * strength))?;
    }
    // Over the whole ball: what faces away is dark.
    let (mut wrong, mut all) = (0.0, 0.0);
    for (n, value) in &pixels {
        wrong += (f64::from(*value) - dot(*n, &l).max(0.0)).powi(2);
        all += f64::from(*value).powi(2);
    }
    if wrong.is_nan() || wrong > MOST_RESIDUAL.powi(2) * all {
        return None;
    }
    let direction = normalised([l[0] as f32, l[1] as f32, l[2] as f32])?;
    Some(ProbeLight { direction, strength: l.norm() as f32 })
}

fn dot(n: [f32; 3], l: &nalgebra::Vector3<f64>) -> f64 {
    (0..3).map(|i| f64::from(n[i]) * l[i]).sum()
}

/// Least squares of value = n·l.
fn fit<'a>(pixels: impl Iterator<Item = &'a ([f32; 3], f32)>) -> Option<nalgebra::Vector3<f64>> {
    let (mut a, mut b) = (nalgebra::Matrix3::zeros(), nalgebra::Vector3::zeros());
    for (n, value) in pixels {
        let n = nalgebra::Vector3::new(f64::from(n[0]), f64::from(n[1]), f64::from(n[2]));
        a += n * n.transpose();
        b += n * f64::from(*value);
    }
    a.cholesky().map(|factored| factored.solve(&b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use translume_image::Rgb32FImage;

    const BALL: Ball = Ball { x: 40.0, y: 30.0, radius: 25.0 };

    fn picture(shade: impl Fn([f32; 3]) -> f32) -> Picture {
        Picture::new(Rgb32FImage::from_fn(80, 64, |x, y| {
            let (nx, ny) = ((x as f32 - BALL.x) / BALL.radius, (BALL.y - y as f32) / BALL.radius);
            let r2 = nx * nx + ny * ny;
            [if r2 < 1.0 { shade([nx, ny, (1.0 - r2).sqrt()]) } else { 0.1 }; 3].into()
        }))
    }

    fn angle(a: [f32; 3], b: [f32; 3]) -> f32 {
        (0..3).map(|i| a[i] * b[i]).sum::<f32>().clamp(-1.0, 1.0).acos().to_degrees()
    }

    #[test]
    fn both_balls_show_the_light() {
        for l in [[0.2f32, 0.1, 0.95], [-0.5, 0.4, 0.7], [0.1, -0.8, 0.5]] {
            let l = normalised(l).unwrap();
            // A lamp of 4° radius, and a second, smaller thing as bright.
            let window = normalised([-0.3, -0.3, 0.9]).unwrap();
            let mirror = picture(|n| {
                let r = [2.0 * n[2] * n[0], 2.0 * n[2] * n[1], 2.0 * n[2] * n[2] - 1.0];
                if angle(r, l) < 4.0 || angle(n, window) < 1.5 { 1.0 } else { 0.05 }
            });
            let got = highlight(&mirror, BALL).unwrap();
            assert!(angle(got.direction, l) < 1.5, "{got:?} for {l:?}");
            let matt = picture(|n| 0.6 * (0..3).map(|i| n[i] * l[i]).sum::<f32>().max(0.0));
            let got = shading(&matt, BALL).unwrap();
            assert!(angle(got.direction, l) < 0.5 && (got.strength - 0.6).abs() < 0.01, "{got:?} for {l:?}");
        }
        assert!(highlight(&picture(|_| 0.0), BALL).is_none() && shading(&picture(|_| 0.0), BALL).is_none());
        let elsewhere = Ball { x: 500.0, ..BALL };
        assert!(highlight(&picture(|_| 1.0), elsewhere).is_none());
    }

    /// Pictures of other things: a plain wall, a gradient, grain, a pattern, a ball that is half out of the picture.
    #[test]
    fn what_is_no_ball_shows_no_light() {
        let of = |value: &dyn Fn(u32, u32) -> f32| {
            Picture::new(Rgb32FImage::from_fn(80, 64, |x, y| [value(x, y); 3].into()))
        };
        let noise = |x: u32, y: u32| {
            f32::from((x.wrapping_mul(0x9e37).wrapping_add(y.wrapping_mul(0x79b9)) ^ (x * y)) as u8) / 255.0
        };
        type Shade<'a> = &'a dyn Fn(u32, u32) -> f32;
        let others: [(&str, Shade<'_>); 5] = [
            ("wall", &|_, _| 0.5),
            ("gradient", &|x, _| x as f32 / 80.0),
            ("grain", &noise),
            ("pattern", &|x, y| if (x / 6 + y / 6) % 2 == 0 { 0.9 } else { 0.1 }),
            ("text", &|x, y| if noise(x / 2, y / 2) > 0.9 { 0.9 } else { 0.2 }),
        ];
        for (name, value) in others {
            assert!(highlight(&of(value), BALL).is_none(), "{name}: {:?}", highlight(&of(value), BALL));
            // A gradient is what a ball lit from the side nearly is.
            let matt = shading(&of(value), BALL);
            assert!(matt.is_none() || name == "gradient", "{name}: {matt:?}");
        }
        // A matt ball is no mirror, wherever its light is.
        for l in [[0.0, 0.0, 1.0f32], [0.6, 0.0, 0.8], [0.0, 0.8, 0.6]] {
            let matt = picture(|n| 0.6 * (0..3).map(|i| n[i] * l[i]).sum::<f32>().max(0.0));
            assert!(highlight(&matt, BALL).is_none(), "{l:?}: {:?}", highlight(&matt, BALL));
        }
        let half_out = Ball { x: -3.0, ..BALL };
        assert!(highlight(&picture(|n| if n[2] > 0.99 { 1.0 } else { 0.05 }), half_out).is_none());
    }

    /// Mirror balls photographed by others, with the directions that they found.
    #[test]
    fn real_mirror_balls_agree_with_their_authors() {
        let Some(data) = std::env::var_os("TRANSLUME_DATA") else {
            eprintln!("TRANSLUME_DATA is not set: skipped");
            return;
        };
        for probe in ["probe1", "probe2"] {
            let dir = Path::new(&data).join("captures/refl-psbox-cat").join(probe);
            let numbers = |name: &str| -> Vec<f32> {
                let text = std::fs::read_to_string(dir.join(name)).unwrap();
                text.split_whitespace().map(|w| w.parse().unwrap()).collect()
            };
            let (circle, directions) = (numbers("circle_data.txt"), numbers("light_directions.txt"));
            // Their pixels count from 1, and upwards.
            let height = translume_image::read_picture(&dir.join("Image_01.JPG")).unwrap().pixels.height() as f32;
            let ball = Ball { x: circle[0] - 1.0, y: height - circle[1], radius: circle[2] };
            for i in 0..12 {
                let path = dir.join(format!("Image_{:02}.JPG", i + 1));
                let got = light(&path, ball, Surface::Mirror).unwrap().direction;
                let theirs = [directions[i], directions[12 + i], directions[24 + i]];
                let off = angle(got, theirs);
                assert!(off < 1.5, "{}: {got:?} for {theirs:?}, {off}°", path.display());
            }
        }
    }
}
