//! From lights to the power that enters an object at its texels and vertices.
//!
//! E = Σ I cos θ F_t(η, θ)/r² over the lights that a texel's centre sees. Light that a concave object throws onto itself is left out, as it is where the
//! model was measured: there it is part of F.

use super::lights::{Light, look};
use crate::capture::Surface;
use crate::hierarchical::{Atlas, hidden};
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::f32::consts::{PI, TAU};
use std::path::Path;
use translume_bxdf::fresnel;
use translume_core::distribution::Piecewise2d;
use translume_core::frame::Frame;
use translume_core::rng::Pcg32;
use translume_core::warp;
use translume_image::{Picture, Result, read_picture};

/// Lights, ready to shine.
#[derive(Clone, Debug, Default)]
pub struct Sources {
    places: Vec<Place>,
    /// Unit direction to the light, radiance times solid angle.
    directions: Vec<(Vec3, Vec3)>,
}

/// A light without extent.
#[derive(Clone, Debug)]
struct Place {
    at: Vec3,
    shape: Shape,
}

#[derive(Clone, Debug)]
enum Shape {
    Point(Vec3),
    /// Axis, cosines of cutoff and beam.
    Spot(Vec3, Vec3, [f32; 2]),
    /// Right, down, forward; half width at distance 1; slide.
    Projector([Vec3; 3], f32, Slide),
}

#[derive(Clone, Debug)]
struct Slide {
    width: usize,
    height: usize,
    pixels: Vec<Vec3>,
}

/// Power that enters.
#[derive(Clone, Debug)]
pub struct Power {
    /// At each texel: irradiance times area.
    pub texels: Vec<Vec3>,
    /// At each vertex, by the linear weights of the texels around.
    pub vertices: Vec<Vec3>,
}

impl Sources {
    /// Reads the pictures of lights; their names are relative to `folder`.
    ///
    /// # Errors
    /// Those of reading pictures.
    pub fn new(lights: &[Light], folder: &Path) -> Result<Self> {
        let mut sources = Self::default();
        let single = |v: &[f64; 3]| Vec3::from_array(v.map(|x| x as f32));
        for light in lights {
            match light {
                Light::Point { position, intensity } => {
                    sources.places.push(Place { at: single(position), shape: Shape::Point(Vec3::from(*intensity)) });
                }
                Light::Spot { position, target, intensity, cutoff_deg, beam_deg } => {
                    let at = single(position);
                    let axis = (single(target) - at).normalize();
                    let cosines = [cutoff_deg, beam_deg].map(|a| a.to_radians().cos() as f32);
                    sources.places.push(Place { at, shape: Shape::Spot(Vec3::from(*intensity), axis, cosines) });
                }
                Light::Environment { file, scale, samples } => {
                    let picture = read_picture(&folder.join(file))?;
                    sources.directions.extend(directions(&picture, *scale, *samples));
                }
                Light::Projector { position, target, up, fov_deg, file, scale } => {
                    let picture = read_picture(&folder.join(file))?;
                    let frame = look(*position, *target, *up).expect("checked");
                    let half = (0.5 * fov_deg.to_radians()).tan() as f32;
                    let shape = Shape::Projector(frame, half, Slide::new(&picture, *scale));
                    sources.places.push(Place { at: single(position), shape });
                }
            }
        }
        Ok(sources)
    }

    /// Moves the first light that has a place; what an interactive user does.
    pub fn move_first(&mut self, to: Vec3) {
        self.places.iter_mut().take(1).for_each(|p| p.at = to);
    }

    /// A ray towards the ball around `center`, by uniform chance, and the power that it stands for; `None` without any light.
    pub(crate) fn emit(&self, center: Vec3, radius: f32, rng: &mut Pcg32) -> Option<(Vec3, Vec3, Vec3)> {
        let count = self.places.len() + self.directions.len();
        let index = ((rng.next_f32() * count as f32) as usize).min(count.checked_sub(1)?);
        let u = [rng.next_f32(), rng.next_f32()];
        let Some(place) = self.places.get(index) else {
            let (direction, light) = self.directions[index - self.places.len()];
            let disc = radius * warp::uniform_disk(u[0], u[1]);
            let frame = Frame::from_normal(direction);
            let origin = center + frame.to_world(disc.extend(0.0)) + 4.0 * radius * direction;
            return Some((origin, -direction, light * (count as f32 * PI * radius * radius)));
        };
        let to = center - place.at;
        // From within the ball into all directions.
        let least = if to.length() > radius { (1.0 - (radius / to.length()).powi(2)).sqrt() } else { -1.0 };
        let cos = 1.0 - u[0] * (1.0 - least);
        let (sin, angle) = ((1.0 - cos * cos).max(0.0).sqrt(), TAU * u[1]);
        let direction =
            Frame::from_normal(to.normalize_or_zero()).to_world(Vec3::new(sin * angle.cos(), sin * angle.sin(), cos));
        Some((place.at, direction, place.shape.towards(direction) * (count as f32 * TAU * (1.0 - least))))
    }

    /// Power at all texels and vertices.
    pub fn shine(&self, surface: &Surface, atlas: &Atlas, eta: f32) -> Power {
        let texels: Vec<Vec3> = atlas
            .texels
            .par_iter()
            .with_min_len(256)
            .map(|t| t.area * self.irradiance(surface, t.at, t.normal, eta))
            .collect();
        let mut vertices = vec![Vec3::ZERO; surface.mesh.positions.len()];
        for (texel, power) in atlas.texels.iter().zip(&texels) {
            if *power != Vec3::ZERO {
                let [u, v] = texel.uv;
                let corners = surface.mesh.indices[texel.face as usize];
                corners.iter().zip([1.0 - u - v, u, v]).for_each(|(&i, w)| vertices[i as usize] += w * power);
            }
        }
        Power { texels, vertices }
    }

    /// Irradiance that enters at a place.
    fn irradiance(&self, surface: &Surface, at: Vec3, normal: Vec3, eta: f32) -> Vec3 {
        let entering = |cos: f32| cos * (1.0 - fresnel::dielectric(cos, eta).reflectance);
        let mut sum = Vec3::ZERO;
        for place in &self.places {
            let to = place.at - at;
            let square = to.length_squared();
            let direction = to / square.sqrt();
            let cos = direction.dot(normal);
            if cos > 0.0 {
                let intensity = place.shape.towards(-direction);
                if intensity != Vec3::ZERO && !hidden(surface, at, normal, place.at) {
                    sum += intensity * (entering(cos) / square);
                }
            }
        }
        let far = surface.extent().length() * 4.0;
        for &(direction, light) in &self.directions {
            let cos = direction.dot(normal);
            if cos > 0.0 && !hidden(surface, at, normal, at + direction * far) {
                sum += light * entering(cos);
            }
        }
        sum
    }
}

impl Shape {
    /// Intensity into a direction away from the light.
    fn towards(&self, d: Vec3) -> Vec3 {
        match self {
            Self::Point(intensity) => *intensity,
            Self::Spot(intensity, axis, [cutoff, beam]) => {
                let cos = d.dot(*axis);
                // Linear in the angle, as in the renderer's scenes.
                let [outer, inner, angle] = [cutoff.acos(), beam.acos(), cos.clamp(-1.0, 1.0).acos()];
                match angle {
                    a if a >= outer => Vec3::ZERO,
                    a if a <= inner => *intensity,
                    a => *intensity * ((outer - a) / (outer - inner)),
                }
            }
            Self::Projector([right, down, forward], half, slide) => {
                let z = d.dot(*forward);
                if z <= 0.0 {
                    return Vec3::ZERO;
                }
                let half = Vec2::new(*half, half * slide.height as f32 / slide.width as f32);
                let place = Vec2::new(d.dot(*right), d.dot(*down)) / z / half;
                // Irradiance on the plane at distance 1 is I cos³.
                slide.at(0.5 + 0.5 * place) / (z * z * z)
            }
        }
    }
}

impl Slide {
    fn new(picture: &Picture, scale: f32) -> Self {
        let (width, height) = (picture.pixels.width() as usize, picture.pixels.height() as usize);
        let value = |p: &[f32; 3]| (Vec3::from(*p) * scale).max(Vec3::ZERO);
        Self { width, height, pixels: picture.pixels.as_raw().as_chunks::<3>().0.iter().map(value).collect() }
    }

    /// Linear between the centres of its pixels; nothing beside it. (0, 0) is the upper left corner.
    fn at(&self, p: Vec2) -> Vec3 {
        if !(0.0..=1.0).contains(&p.x) || !(0.0..=1.0).contains(&p.y) {
            return Vec3::ZERO;
        }
        let (x, y) = (p.x * self.width as f32 - 0.5, p.y * self.height as f32 - 0.5);
        let pixel = |x: f32, y: f32| {
            let column = x.clamp(0.0, (self.width - 1) as f32) as usize;
            self.pixels[y.clamp(0.0, (self.height - 1) as f32) as usize * self.width + column]
        };
        let (fx, fy) = (x - x.floor(), y - y.floor());
        let row = |y: f32| pixel(x.floor(), y).lerp(pixel(x.floor() + 1.0, y), fx);
        row(y.floor()).lerp(row(y.floor() + 1.0), fy)
    }
}

/// Directions that stand for a picture of them, drawn in proportion to its light from a low-discrepancy sequence.
fn directions(picture: &Picture, scale: f32, samples: usize) -> Vec<(Vec3, Vec3)> {
    let (width, height) = (picture.pixels.width() as usize, picture.pixels.height() as usize);
    let pixels = Slide::new(picture, scale).pixels;
    let sin = |row: usize| (PI * (row as f32 + 0.5) / height as f32).sin();
    let weights: Vec<f32> = pixels.iter().enumerate().map(|(i, p)| p.element_sum() * sin(i / width)).collect();
    let Some(distribution) = Piecewise2d::new(&weights, width) else { return Vec::new() };
    let one = |i: usize| {
        // Hammersley's points.
        let u = Vec2::new((i as f32 + 0.5) / samples as f32, (i as u32).reverse_bits() as f32 / 4_294_967_808.0);
        let (p, pdf) = distribution.sample(u);
        let row = ((p.y * height as f32) as usize).min(height - 1);
        let radiance = pixels[row * width + ((p.x * width as f32) as usize).min(width - 1)];
        let (theta, phi) = (PI * p.y, TAU * (0.5 - p.x));
        let direction = Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
        // The picture's unit square covers 2 π² sin θ of solid angle per area.
        (direction, radiance * (TAU * PI * theta.sin() / (pdf * samples as f32)))
    };
    (0..samples).map(one).filter(|d| d.1.is_finite() && d.1 != Vec3::ZERO).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hierarchical::AtlasParams;
    use crate::hierarchical::tests::sphere;
    use translume_image::Rgb32FImage;

    fn lit(lights: &[Light], sources: Option<Sources>) -> (Surface, Atlas, Power) {
        let mesh = sphere(16, 10.0);
        let atlas = Atlas::new(&mesh, &AtlasParams::default()).unwrap();
        let surface = Surface::new(mesh).unwrap();
        let sources = sources.unwrap_or_else(|| Sources::new(lights, Path::new("")).unwrap());
        let power = sources.shine(&surface, &atlas, 1.0);
        (surface, atlas, power)
    }

    #[test]
    fn a_sphere_takes_the_power_that_a_point_sends_into_its_cone() {
        let light = Light::Point { position: [0.0, 0.0, 40.0], intensity: [1.0, 2.0, 3.0] };
        let (_, atlas, power) = lit(&[light], None);
        let total: Vec3 = power.texels.iter().sum();
        let cos = (1.0 - 1.0 / 16.0f32).sqrt();
        let expected = TAU * (1.0 - cos);
        assert!(
            (total.x / expected - 1.0).abs() < 0.03 && (total.z / total.x - 3.0).abs() < 1e-4,
            "{total} {expected}"
        );
        // The vertices get all of it, the dark side nothing.
        let sum: Vec3 = power.vertices.iter().sum();
        assert!((sum - total).abs().max_element() < 1e-4 * total.z);
        for (t, p) in atlas.texels.iter().zip(&power.texels) {
            assert!(t.at.z > 0.5 || *p == Vec3::ZERO);
        }
    }

    #[test]
    fn rays_carry_the_power_that_goes_to_the_ball() {
        let point = Light::Point { position: [0.0, 0.0, 40.0], intensity: [1.0, 2.0, 3.0] };
        let mut sources = Sources::new(&[point], Path::new("")).unwrap();
        // And two directions of irradiance 0.5 and 1.5 on a disc across them.
        sources.directions = vec![(Vec3::X, Vec3::splat(0.5)), (Vec3::NEG_Y, Vec3::splat(1.5))];
        let (mut rng, mut sum, n) = (Pcg32::new(7, 1), Vec3::ZERO, 30_000);
        for _ in 0..n {
            let (origin, direction, power) = sources.emit(Vec3::ZERO, 10.0, &mut rng).unwrap();
            // It meets the ball.
            assert!(direction.is_normalized() && (origin - direction * origin.dot(direction)).length() < 10.01);
            sum += power / n as f32;
        }
        let expected = TAU * (1.0 - (1.0 - 1.0 / 16.0f32).sqrt()) + PI * 100.0 * 2.0;
        // Three kinds of rays of 0.6, 471 and 1414: five deviations of the mean are 3 %, one false alarm in a million.
        assert!((sum.x / expected - 1.0).abs() < 0.03, "{sum} {expected}");
        assert!(Sources::default().emit(Vec3::ZERO, 10.0, &mut rng).is_none());
    }

    #[test]
    fn a_uniform_sky_gives_pi_and_its_top_is_z() {
        let sky = |f: &dyn Fn(u32) -> f32| {
            let values = (0..16u32).flat_map(|y| [f(y); 3 * 32]).collect();
            Picture::new(Rgb32FImage::from_raw(32, 16, values).unwrap())
        };
        let even = Sources { directions: directions(&sky(&|_| 1.0), 1.0, 1024), ..Sources::default() };
        let (_, atlas, power) = lit(&[], Some(even));
        for (t, p) in atlas.texels.iter().zip(&power.texels) {
            assert!((p.x / t.area / PI - 1.0).abs() < 0.03, "{}", p.x / t.area);
        }
        let top = Sources {
            directions: directions(&sky(&|y| if y == 0 { 1.0 } else { 0.0 }), 1.0, 64),
            ..Sources::default()
        };
        let (_, atlas, power) = lit(&[], Some(top));
        assert!(atlas.texels.iter().zip(&power.texels).all(|(t, p)| t.at.z > -2.0 || p.x == 0.0));
    }

    #[test]
    fn a_slide_lies_as_it_should() {
        // Left half red, right half green, seen along −x with z up: +y is to the right.
        let mut pixels = Rgb32FImage::new(8, 4);
        for (x, _, p) in pixels.enumerate_pixels_mut() {
            p.0 = if x < 4 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        }
        let frame = look([40.0, 0.0, 0.0], [0.0; 3], [0.0, 0.0, 1.0]).unwrap();
        let shape = Shape::Projector(frame, 0.3, Slide::new(&Picture::new(pixels), 1600.0));
        let sources = Sources { places: vec![Place { at: Vec3::new(40.0, 0.0, 0.0), shape }], directions: Vec::new() };
        let (_, atlas, power) = lit(&[], Some(sources));
        let (mut left, mut right) = (Vec3::ZERO, Vec3::ZERO);
        for (t, p) in atlas.texels.iter().zip(&power.texels) {
            if t.at.y < -2.0 {
                left += *p;
            } else if t.at.y > 2.0 {
                right += *p;
            }
        }
        assert!(left.x > 0.0 && left.y == 0.0 && right.y > 0.0 && right.x == 0.0, "{left} {right}");
        // The slide tells the irradiance at distance 1.
        let middle = atlas
            .texels
            .iter()
            .zip(&power.texels)
            .filter(|(t, _)| t.at.y < -2.0 && t.at.y > -4.0 && t.at.z.abs() < 1.0 && t.at.x > 0.0);
        for (t, p) in middle {
            // E = I cos θ/r², I = 1/cos³ of the angle to the axis.
            let to = Vec3::new(40.0, 0.0, 0.0) - t.at;
            let axial = to.x / to.length();
            let expected = 1600.0 / axial.powi(3) * to.normalize().dot(t.normal) / to.length_squared();
            assert!((p.x / t.area / expected - 1.0).abs() < 0.05, "{} {expected}", p.x / t.area);
        }
    }
}
