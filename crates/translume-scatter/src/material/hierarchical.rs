//! The hierarchical model of an object as a material: F, K and T between any two places [Goesele 2004, §8]. It stands on the mesh that it was
//! fitted to.
//!
//! Distances are drawn from a mixture that is made of the mean light by distance: measured R_d has no closed form, and what it has beside its mean is left to the
//! weights and to the share of places that are drawn uniformly over the object. Where noise of K makes R_d negative it counts as 0.

use super::same_mesh;
use crate::hierarchical::{Hierarchical, load_hierarchical};
use glam::Vec3;
use rayon::prelude::*;
use std::path::Path;
use translume_bxdf::Rgb;
use translume_bxdf::bssrdf::{Bssrdf, Gammas, Radii, Site};
use translume_image::Result;

/// See the module.
pub struct HierarchicalMaterial {
    name: String,
    model: Hierarchical,
    radii: Gammas,
    total: Rgb,
    /// Largest R_d from each of [`RINGS`] distances on.
    bounds: Vec<f32>,
    /// Ratio between the distances, and the first in mm.
    rings: (f32, f32),
}

/// Rings of distances.
const RINGS: usize = 10;
/// Texels that are seen for the mean light by distance.
const SEEN: usize = 160;

impl std::fmt::Debug for HierarchicalMaterial {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        // Enough to tell two models apart, for checkpoints of renders.
        let vertices = self.model.mesh.positions.len();
        write!(f, "hierarchical model {}, {vertices} vertices, {:?} {:?}", self.name, self.total, self.radii)
    }
}

impl HierarchicalMaterial {
    /// From a model's folder.
    ///
    /// # Errors
    /// Those of [`load_hierarchical`].
    pub fn load(path: &Path) -> Result<Self> {
        Ok(Self::new(path, load_hierarchical(path)?.1))
    }

    /// From a model in memory; `path` is for messages.
    pub fn new(path: &Path, model: Hierarchical) -> Self {
        let extent = model.mesh.bounds().extent().length();
        let first = model.atlas.texel_mm;
        let rings = ((extent / first).max(2.0).powf(1.0 / (RINGS - 1) as f32), first);
        let (light, total) = light(&model, rings);
        let mut radii = Gammas::default();
        for (i, light) in light.iter().enumerate() {
            // The mean of the density k² r e^{−kr} is 2/k.
            radii.push(*light, 2.0 / (rings.1 * rings.0.powf(i as f32 - 0.5)));
        }
        if radii.total() <= 0.0 {
            radii.push(1.0, 2.0 / first);
        }
        let bounds = bounds(&model, rings);
        Self { name: path.display().to_string(), model, radii, total, bounds, rings }
    }
}

fn ring(d: f32, (ratio, first): (f32, f32)) -> usize {
    if d < first { 0 } else { (((d / first).ln() / ratio.ln()) as usize + 1).min(RINGS - 1) }
}

/// Mean light by rings of distance, and all of it.
fn light(model: &Hierarchical, rings: (f32, f32)) -> ([f32; RINGS], Rgb) {
    let texels = &model.atlas.texels;
    let step = (texels.len() / SEEN).max(1);
    let seen = |t: usize| {
        let to = &texels[t];
        let (mut light, mut total) = ([0.0f32; RINGS], Rgb::ZERO);
        for from in texels {
            let value = from.area * model.reflectance((from.face, from.uv), (to.face, to.uv)).max(Vec3::ZERO);
            light[ring(from.at.distance(to.at), rings)] += value.element_sum();
            total += value;
        }
        (light, total)
    };
    let all: Vec<_> = (0..texels.len()).into_par_iter().step_by(step).map(seen).collect();
    let mean = 1.0 / all.len().max(1) as f32;
    let sum = all.iter().fold(([0.0; RINGS], Rgb::ZERO), |(light, total), (l, t)| {
        (std::array::from_fn(|i| light[i] + mean * l[i]), total + *t * mean)
    });
    (sum.0, sum.1)
}

/// The largest R_d at the beginning of each ring or farther.
fn bounds(model: &Hierarchical, rings: (f32, f32)) -> Vec<f32> {
    let mesh = &model.mesh;
    let at = |i: usize| Vec3::from(mesh.positions[i]);
    let edges = (0..mesh.indices.len()).map(|f| {
        let [a, b, c] = mesh.corners(f);
        a.distance(b).max(b.distance(c)).max(c.distance(a))
    });
    // Places of two triangles are farther apart than their corners by two edges at most.
    let slack = 2.0 * edges.fold(0.0, f32::max);
    let brightest = model.detail.iter().flatten().copied().fold(0.0, f32::max);
    let largest = |a: usize| {
        let mut most = vec![0.0f32; RINGS];
        for b in 0..=a {
            let value = brightest * model.throughput.value(a, b).into_iter().fold(0.0, f32::max);
            let ring = ring(at(a).distance(at(b)) + slack, rings);
            most[ring] = most[ring].max(value);
        }
        most
    };
    let join = |a: Vec<f32>, b: Vec<f32>| a.iter().zip(b).map(|(x, y)| x.max(y)).collect();
    let mut most = (0..mesh.positions.len()).into_par_iter().map(largest).reduce(|| vec![0.0; RINGS], join);
    let kernel = model.kernels.iter().flatten().map(|k| k.to_f32()).fold(0.0, f32::max);
    let reach = 14.0 * model.atlas.texel_mm;
    for i in (0..RINGS).rev() {
        let beyond = most.get(i + 1).copied().unwrap_or(0.0);
        most[i] = most[i].max(beyond);
    }
    let begin = |i: usize| if i == 0 { 0.0 } else { rings.1 * rings.0.powi(i as i32 - 1) };
    (0..RINGS).map(|i| most[i] + if begin(i) < reach { kernel } else { 0.0 }).collect()
}

impl Bssrdf for HierarchicalMaterial {
    fn eval(&self, from: &Site, to: &Site) -> Rgb {
        self.model.reflectance((from.face, from.uv.to_array()), (to.face, to.uv.to_array())).max(Rgb::ZERO)
    }

    fn radii(&self, _to: &Site) -> Radii<'_> {
        Radii::Gammas(self.radii)
    }

    fn total(&self, _from: &Site) -> Rgb {
        self.total
    }

    fn bound(&self, r: f32) -> f32 {
        self.bounds[ring(r, self.rings)]
    }

    fn eta(&self) -> Option<f32> {
        Some(self.model.eta as f32)
    }

    fn fits(&self, faces: usize, corners: &dyn Fn(usize) -> [Vec3; 3]) -> std::result::Result<(), String> {
        same_mesh(&self.name, &self.model.mesh, faces, corners)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::Surface;
    use crate::hierarchical::{AtlasParams, tests::sphere};
    use crate::relight::{Light, Part, Relighter, SIGHT, Sight, Sources, sight_samples};
    use glam::Vec2;
    use std::f32::consts::PI;

    #[test]
    fn a_hierarchical_material_is_what_relighting_shows() {
        let mesh = sphere(12, 10.0);
        let fall_off = |d: f32| [0.05, 0.04, 0.02].map(|s| s * ((-d / 0.8).exp() + 0.05 * (-d / 4.0).exp()));
        let params = AtlasParams::default();
        let model = Hierarchical::from_transfer(mesh.clone(), 1.0, &params, |_, d| fall_off(d), |_, _| [2.0, 1.0, 0.5]);
        let model = model.unwrap();
        let surface = Surface::new(mesh.clone()).unwrap();
        let sight = Sight { width: 16, height: 12, ..SIGHT };
        let lights = [Light::Point { position: [20.0, -40.0, 20.0], intensity: [1000.0; 3] }];
        let power = Sources::new(&lights, Path::new("")).unwrap().shine(&surface, &model.atlas, 1.0);
        let picture = Relighter::new(&model, &surface, &sight).unwrap().picture(&power, Part::Whole);
        let material = HierarchicalMaterial::new(Path::new("m"), model.clone());
        let site = |face: u32, uv: [f32; 2]| {
            let [a, b, c] = mesh.corners(face as usize);
            Site { p: a + uv[0] * (b - a) + uv[1] * (c - a), face, uv: Vec2::from(uv) }
        };
        let (mut error, mut all) = (0.0, 0.0);
        for (pixel, face, uv, _) in sight_samples(&surface, &sight).unwrap() {
            let to = site(face, uv);
            let lit = model.atlas.texels.iter().zip(&power.texels).filter(|l| *l.1 != Vec3::ZERO);
            let sum: Rgb = lit.map(|(t, p)| *p * material.eval(&site(t.face, t.uv), &to)).sum();
            let shown = Vec3::from(picture[pixel as usize]);
            error += (sum / PI - shown).length_squared();
            all += shown.length_squared();
        }
        // 16-bit floats of relighting, and negative K that counts as 0 here.
        assert!(all > 0.0 && (error / all).sqrt() < 0.02, "{}", (error / all).sqrt());
        let to = site(40, [0.3, 0.3]);
        super::super::tests::check_density(&material, &to);
        for t in model.atlas.texels.iter().step_by(7) {
            let from = site(t.face, t.uv);
            assert!(material.eval(&from, &to).max_element() <= material.bound(from.p.distance(to.p)));
        }
        let corners = |scale: f32| move |face: usize| sphere(12, 10.0).corners(face).map(|p| p * scale);
        let faces = mesh.indices.len();
        assert!(material.fits(faces, &corners(1.0)).is_ok() && material.fits(faces, &corners(1.1)).is_err());
    }
}
