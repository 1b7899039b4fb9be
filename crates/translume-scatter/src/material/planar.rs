//! The exponential model of a flat sample as a material, for surfaces that are seen along z of their own space: x and y are those
//! of the sample, and beyond its rim the parameters of the rim go on and the modulation ends. Between lit points fall-offs are
//! blended bilinearly on a grid of the median spacing.

use super::fall_off::{FallOff, widen};
use super::{Envelope, colours};
use crate::capture::Camera;
use crate::fit::PointFit;
use crate::planar::{LitPoint, ModelHead, PlanarModel, read_model};
use crate::segments::hat;
use glam::Vec3;
use std::path::Path;
use translume_bxdf::Rgb;
use translume_bxdf::bssrdf::{Bssrdf, Gammas, Radii, Site};
use translume_image::{Error, Result};

/// See the module.
pub struct PlanarMaterial {
    name: String,
    eta: f32,
    points: Vec<Point>,
    grid: Grid,
    views: Vec<View>,
    envelope: Envelope,
}

/// The most that may come back of what came in: lit points with more are left out, and their neighbours serve.
const MOST: f64 = 1.5;

/// A lit point.
struct Point {
    scale: Rgb,
    /// Fall-offs of each direction, for red, green and blue or for all.
    fall_off: Vec<Vec<FallOff>>,
    gammas: Gammas,
    total: Rgb,
}

/// The nearest lit point of each node of a grid.
struct Grid {
    origin: [f32; 2],
    step: f32,
    size: [usize; 2],
    nearest: Vec<u32>,
}

/// The modulation as one camera saw it.
struct View {
    camera: Camera,
    /// α and whether it was measured, for each pixel.
    alpha: Vec<(Rgb, bool)>,
}

impl std::fmt::Debug for PlanarMaterial {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let total: f64 = self.points.iter().map(|p| f64::from(p.total.element_sum())).sum();
        let alpha: f64 = self.views.iter().flat_map(|v| &v.alpha).map(|a| f64::from(a.0.element_sum())).sum();
        write!(f, "planar model {}, {} points, {total} {alpha}", self.name, self.points.len())
    }
}

impl Point {
    fn new(point: &LitPoint, rgb: [usize; 3]) -> Option<Self> {
        let all: Option<Vec<Vec<FallOff>>> = match point.fall_off.len() {
            1 => vec![&point.fall_off[0]],
            _ => rgb.iter().map(|&c| &point.fall_off[c]).collect(),
        }
        .into_iter()
        .map(|fit| (!fit.segments.is_empty()).then(|| fit.segments.iter().map(|s| FallOff::new(&s.curve)).collect()))
        .collect();
        let fall_off = all?;
        // Samples of a short range do not tell how slow the slowest term is; such a fit would be as bright as it likes.
        let bright = |fit: &PointFit| {
            let total: f64 = fit.segments.iter().map(|s| s.curve.total()).sum::<f64>() / fit.segments.len() as f64;
            !(0.0..=MOST).contains(&(total * point.scale.iter().copied().fold(0.0, f64::max)))
        };
        if point.fall_off.iter().any(bright) {
            return None;
        }
        let scale = Rgb::from_array(rgb.map(|c| point.scale[c] as f32));
        let total = |c: usize| {
            let segments: &Vec<FallOff> = &fall_off[c % fall_off.len()];
            segments.iter().map(FallOff::total).sum::<f32>() / segments.len() as f32
        };
        let total = scale * Rgb::new(total(0), total(1), total(2));
        Some(Self { scale, gammas: gammas(&fall_off), fall_off, total })
    }

    /// R_d without modulation at (dx, dy) mm from the point.
    fn value(&self, dx: f32, dy: f32) -> Rgb {
        let r = dx.hypot(dy);
        let of = |segments: &Vec<FallOff>| {
            let (l, blend) = hat(dx.into(), dy.into(), segments.len());
            let (near, blend) = (segments[l].value(r), blend as f32);
            match blend > 0.0 {
                true => near + blend * (segments[(l + 1) % segments.len()].value(r) - near),
                false => near,
            }
        };
        self.scale
            * match self.fall_off.len() {
                1 => Rgb::splat(of(&self.fall_off[0])),
                _ => Rgb::new(of(&self.fall_off[0]), of(&self.fall_off[1]), of(&self.fall_off[2])),
            }
    }
}

/// The terms of all directions with the same rank, as one each.
fn gammas(fall_off: &[Vec<FallOff>]) -> Gammas {
    let mut gammas = Gammas::default();
    for segments in fall_off {
        let mut ranks: Vec<(f32, f32)> = Vec::new();
        for segment in segments {
            let mut rank = 0;
            segment.densities(|weight, k| {
                if ranks.len() == rank {
                    ranks.push((0.0, 0.0));
                }
                ranks[rank].0 += weight;
                ranks[rank].1 += weight * k;
                rank += 1;
            });
        }
        ranks.iter().for_each(|(weight, sum)| gammas.push(*weight, sum / weight));
    }
    gammas
}

impl Grid {
    fn new(at: &[[f32; 2]]) -> Self {
        let distance = |a: &[f32; 2], b: &[f32; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        let nearest = |i: usize| {
            let others = at.iter().enumerate().filter(|o| o.0 != i).map(|o| distance(o.1, &at[i]));
            others.filter(|d| *d > 0.0).fold(f32::INFINITY, f32::min)
        };
        let mut gaps: Vec<f32> = (0..at.len()).map(nearest).filter(|d| d.is_finite()).collect();
        gaps.sort_by(f32::total_cmp);
        let range = |k: usize| {
            let all = at.iter().map(|p| p[k]);
            (all.clone().fold(f32::INFINITY, f32::min), all.fold(f32::NEG_INFINITY, f32::max))
        };
        let (x, y) = (range(0), range(1));
        let extent = (x.1 - x.0).max(y.1 - y.0);
        let step = gaps.get(gaps.len() / 2).copied().unwrap_or(1.0).max(extent / 1000.0).max(1e-6);
        let size = [x, y].map(|(low, high)| ((high - low) / step).round() as usize + 1);
        let node = |i: usize| [x.0 + (i % size[0]) as f32 * step, y.0 + (i / size[0]) as f32 * step];
        let to_node = |i: usize| {
            let all = at.iter().map(|p| distance(p, &node(i))).enumerate();
            all.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |n| n.0 as u32)
        };
        Self { origin: [x.0, y.0], step, size, nearest: (0..size[0] * size[1]).map(to_node).collect() }
    }

    /// Points around a place and their weights, which sum to 1.
    fn around(&self, x: f32, y: f32) -> [(f32, usize); 4] {
        let along = |v: f32, k: usize| {
            let t = ((v - self.origin[k]) / self.step).clamp(0.0, (self.size[k] - 1) as f32);
            let i = (t as usize).min(self.size[k].saturating_sub(2));
            (i, (i + 1).min(self.size[k] - 1), t - i as f32)
        };
        let ((i, j, u), (k, l, v)) = (along(x, 0), along(y, 1));
        let at = |i: usize, k: usize| self.nearest[k * self.size[0] + i] as usize;
        let (a, b) = (1.0 - u, 1.0 - v);
        [(a * b, at(i, k)), (u * b, at(j, k)), (a * v, at(i, l)), (u * v, at(j, l))]
    }
}

impl PlanarMaterial {
    /// From a model's folder.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Invalid`], [`Error::Unsupported`].
    pub fn load(path: &Path) -> Result<Self> {
        let (head, model) = read_model(path)?;
        Self::new(path, &head, &model)
    }

    /// From a model in memory; `path` is for messages.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for channels without colours; [`Error::Invalid`] for a model without any fall-off.
    pub fn new(path: &Path, head: &ModelHead, model: &PlanarModel) -> Result<Self> {
        let rgb = colours(path, &head.channels)?;
        let known = model.points.iter().filter_map(|p| Some((p.at_mm.map(|x| x as f32), Point::new(p, rgb)?)));
        let (at, mut points): (Vec<[f32; 2]>, Vec<Point>) = known.unzip();
        let each = points.iter().flat_map(|p| p.fall_off.iter().flatten());
        let slowest = each.map(FallOff::slowest).fold(f32::INFINITY, f32::min);
        if points.is_empty() {
            return Err(Error::invalid(path, "no lit point has a fall-off that sends back less light than it gets"));
        }
        points.iter_mut().for_each(|p| widen(&mut p.gammas, slowest));
        let view = |(view, camera): (usize, &Camera)| {
            let (alpha, samples) = (&model.texture[view], &model.texture_samples[view]);
            let pixel =
                |i: usize| (Rgb::from_array(rgb.map(|c| alpha[c][i])), rgb.iter().all(|&c| samples[c][i] > 0.0));
            View { camera: camera.clone(), alpha: (0..alpha[0].len()).map(pixel).collect() }
        };
        let views: Vec<View> = head.cameras.iter().enumerate().map(view).collect();
        let brightest = views.iter().flat_map(|v| &v.alpha).map(|a| a.0.max_element()).fold(1.0, f32::max);
        let envelope = Envelope::new(|r| {
            let value =
                |p: &Point| p.fall_off.iter().flatten().map(|f| f.value(r)).fold(0.0, f32::max) * p.scale.max_element();
            brightest * points.iter().map(value).fold(0.0, f32::max)
        });
        let (name, eta) = (path.display().to_string(), head.eta as f32);
        Ok(Self { name, eta, grid: Grid::new(&at), points, views, envelope })
    }

    /// α at a place: the mean of the views that measured it; 1 where none did.
    fn modulation(&self, p: Vec3) -> Rgb {
        let (mut sum, mut weight) = (Rgb::ZERO, 0.0);
        for view in &self.views {
            let camera = &view.camera;
            let Some([x, y]) = camera.project([p.x.into(), p.y.into(), 0.0]) else { continue };
            let (x, y) = (x - 0.5, y - 0.5);
            for corner in 0..4 {
                let (i, j) = (x.floor() + f64::from(corner & 1), y.floor() + f64::from(corner >> 1));
                let inside = (0.0..camera.width as f64).contains(&i) && (0.0..camera.height as f64).contains(&j);
                let share = ((1.0 - (x - i).abs()) * (1.0 - (y - j).abs())) as f32;
                if inside && share > 0.0 {
                    let (alpha, measured) = view.alpha[j as usize * camera.width + i as usize];
                    if measured {
                        sum += share * alpha;
                        weight += share;
                    }
                }
            }
        }
        if weight > 0.0 { sum / weight } else { Rgb::ONE }
    }
}

impl Bssrdf for PlanarMaterial {
    fn eval(&self, from: &Site, to: &Site) -> Rgb {
        let d = to.p - from.p;
        let around = self.grid.around(from.p.x, from.p.y);
        let value = |&(w, i): &(f32, usize)| if w > 0.0 { w * self.points[i].value(d.x, d.y) } else { Rgb::ZERO };
        // [Fuchs 2005, Eq. 2]
        around.iter().map(value).sum::<Rgb>() * self.modulation(to.p)
    }

    fn radii(&self, to: &Site) -> Radii<'_> {
        let around = self.grid.around(to.p.x, to.p.y);
        let (_, nearest) = around.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((1.0, 0));
        Radii::Gammas(self.points[nearest].gammas)
    }

    fn total(&self, from: &Site) -> Rgb {
        self.grid.around(from.p.x, from.p.y).iter().map(|&(w, i)| w * self.points[i].total).sum()
    }

    fn bound(&self, r: f32) -> f32 {
        self.envelope.bound(r)
    }

    fn eta(&self) -> Option<f32> {
        Some(self.eta)
    }
}
