//! Fitted models as materials: each is a [`Bssrdf`], which renderers evaluate and draw from.
//!
//! Colours of a model are told by their names: `red`, `green`, `blue`, or a single channel for all three.

mod fall_off;
mod hierarchical;
mod planar;
mod vertex;

use crate::capture::rgb_of;
use glam::Vec3;
use serde_json::Value;
use std::path::Path;
use std::sync::Arc;
use translume_bxdf::Bssrdf;
use translume_image::{Error, Result};
use translume_mesh::TriMesh;

pub use hierarchical::HierarchicalMaterial;
pub use planar::PlanarMaterial;
pub use vertex::VertexMaterial;

/// Reads the model in the folder `path`, of whatever kind it is.
///
/// # Errors
/// [`Error::Io`]; [`Error::Invalid`] for damaged files; [`Error::Unsupported`] for other kinds, versions and channels.
pub fn load_material(path: &Path) -> Result<Arc<dyn Bssrdf>> {
    let file = path.join("model.json");
    let text = std::fs::read(&file).map_err(|e| Error::io(&file, e))?;
    let head: Value = serde_json::from_slice(&text).map_err(|e| Error::invalid(&file, e.to_string()))?;
    match head["format"].as_str() {
        Some(crate::planar::FORMAT) => Ok(Arc::new(PlanarMaterial::load(path)?)),
        Some(crate::vertex::FORMAT) => Ok(Arc::new(VertexMaterial::load(path)?)),
        Some(crate::hierarchical::HIERARCHICAL_FORMAT) => Ok(Arc::new(HierarchicalMaterial::load(path)?)),
        _ => Err(Error::invalid(&file, "not a model of a translucent object")),
    }
}

/// Whether a surface is the mesh that a model was fitted to; else a sentence for the user.
fn same_mesh(
    name: &str,
    mesh: &TriMesh,
    faces: usize,
    corners: &dyn Fn(usize) -> [Vec3; 3],
) -> std::result::Result<(), String> {
    let own = mesh.indices.len();
    let near = 1e-3 * mesh.bounds().extent().max_element();
    let same = |face: usize| mesh.corners(face).iter().zip(corners(face)).all(|(a, b)| a.distance(b) <= near);
    match faces == own && (0..own).all(same) {
        true => Ok(()),
        false => Err(format!("{name}: it stands only on the mesh it was fitted to, {name}/mesh.ply, in mm")),
    }
}

/// Which channel is red, green and blue.
fn colours(file: &Path, names: &[String]) -> Result<[usize; 3]> {
    let what = || format!("channels {names:?}: red, green and blue or one for all are rendered");
    rgb_of(names.iter().map(String::as_str)).ok_or_else(|| Error::unsupported(file, what()))
}

/// A bound of fall-offs at growing distances, so that it need not be looked for at each.
#[derive(Clone, Debug, Default)]
struct Envelope {
    values: Vec<f32>,
}

impl Envelope {
    const LAST: usize = 127;

    /// From 0 to about 600 mm.
    fn distance(i: usize) -> f32 {
        0.05 * ((i as f32 * 0.074).exp() - 1.0)
    }

    /// `at` is the largest value of any fall-off at a distance.
    fn new(at: impl Fn(f32) -> f32) -> Self {
        let mut values: Vec<f32> = (0..=Self::LAST).map(|i| at(Self::distance(i))).collect();
        // Fall-offs may rise first; the bound is for a distance and all beyond.
        (0..Self::LAST).rev().for_each(|i| values[i] = values[i].max(values[i + 1]));
        Self { values }
    }

    fn bound(&self, r: f32) -> f32 {
        let i = ((r / 0.05 + 1.0).ln() / 0.074) as usize;
        // Between two distances a rising fall-off may be a little above both.
        1.05 * self.values[i.min(Self::LAST)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::Camera;
    use crate::curve::{Curve, Exponentials};
    use crate::fit::{Model, PointFit, Segment};
    use crate::planar::{LitPoint, ModelHead, PlanarModel};
    use crate::vertex::{Faults, Vertex, VertexHead, VertexModel};
    use glam::Vec2;
    use translume_bxdf::bssrdf::Site;

    fn fall_off(rates: &[f64]) -> PointFit {
        let segment = |d: &f64| Segment {
            curve: Curve::Exponential(Exponentials { c: vec![-0.01, 0.05], d: vec![3.0 * d, *d] }),
            samples: 50.0,
            borrowed: false,
        };
        PointFit { samples: 50, rms: Some(0.1), segments: rates.iter().map(segment).collect(), ..PointFit::default() }
    }

    fn names() -> Vec<String> {
        ["blue", "red", "green"].map(String::from).to_vec()
    }

    fn site(p: [f32; 3]) -> Site {
        Site { p: p.into(), face: 0, uv: Vec2::new(0.25, 0.5) }
    }

    /// The density of distances integrates to one over the plane.
    pub(super) fn check_density(material: &dyn Bssrdf, to: &Site) {
        let radii = material.radii(to);
        let total: f64 = (0..40_000)
            .map(|i| 0.005 * (f64::from(i) + 0.5))
            .map(|r| f64::from(radii.pdf_a(r as f32)) * std::f64::consts::TAU * r * 0.005)
            .sum();
        assert!((total - 1.0).abs() < 1e-2, "{total}");
    }

    /// That, and the bound bounds.
    fn check(material: &dyn Bssrdf, to: &Site) {
        check_density(material, to);
        for i in 0..200 {
            let r = 0.1 * i as f32;
            let from = Site { p: to.p + Vec3::X * r, ..*to };
            assert!(material.eval(&from, to).max_element() <= material.bound(r), "{r}");
        }
    }

    #[test]
    fn a_planar_material_is_its_model() {
        let point = |x: f64, rate: f64| LitPoint {
            at_mm: [x, 0.0],
            scale: vec![1.0; 3],
            fall_off: vec![fall_off(&[rate, rate, rate, 2.0 * rate]), fall_off(&[rate; 3]), fall_off(&[rate])],
        };
        let camera = Camera::looking_at([0.0, 0.0, 100.0], [0.0; 3], [0.0, 1.0, 0.0], (4, 4), 8.0);
        let texture = [2.0f32, 0.5, 1.5].map(|a| vec![a; 16]).to_vec();
        let model = PlanarModel {
            points: vec![point(0.0, -1.0), point(2.0, -0.5)],
            texture: vec![texture],
            texture_samples: vec![vec![vec![1.0; 16]; 3]],
        };
        let head = ModelHead {
            format: FORMAT.into(),
            version: crate::planar::MODEL_VERSION.into(),
            command: String::new(),
            model: Model::Exponential,
            segments: 4,
            terms: 2,
            shared: false,
            threshold: 4.0,
            channels: names(),
            frames: vec![[0, 0], [0, 1]],
            eta: 1.4,
            cameras: vec![camera],
            gains: Vec::new(),
        };
        let material = PlanarMaterial::new(Path::new("m"), &head, &model).unwrap();
        let (from, to) = (site([0.5, 0.0, 0.0]), site([1.0, -1.5, 0.0]));
        let found = material.eval(&from, &to);
        // A quarter of the way from one point to the other; red is the second channel.
        for (value, channel) in [(found.x, 1), (found.y, 2), (found.z, 0)] {
            let of = |i: usize| model.points[i].value([0.5, -1.5], channel).unwrap();
            let expected = (0.75 * of(0) + 0.25 * of(1)) * f64::from([2.0f32, 0.5, 1.5][channel]);
            assert!((f64::from(value) / expected - 1.0).abs() < 1e-5, "{channel}: {value} {expected}");
        }
        // Outside of the picture nothing is modulated.
        let far = material.eval(&site([100.0, 0.0, 0.0]), &site([101.0, 0.0, 0.0]));
        let expected = model.points[1].value([1.0, 0.0], 1).unwrap();
        assert!((f64::from(far.x) / expected - 1.0).abs() < 1e-5);
        assert_eq!(material.eta(), Some(1.4));
        check(&material, &to);
        let odd = ModelHead { channels: vec!["a".into(), "b".into(), "c".into()], ..head };
        assert!(PlanarMaterial::new(Path::new("m"), &odd, &model).is_err());
    }

    const FORMAT: &str = crate::planar::FORMAT;

    #[test]
    fn a_vertex_material_is_its_model_and_stands_on_its_mesh_alone() {
        let mesh = TriMesh {
            positions: vec![[0.0; 3], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]],
            indices: vec![[0, 1, 2]],
            ..TriMesh::default()
        };
        let vertex = |rate: f64, known: bool| Vertex {
            scale: vec![1.0, 0.5, 0.25],
            fall_off: if known { fall_off(&[rate]) } else { PointFit::default() },
            position: Some(0),
        };
        let model = VertexModel {
            vertices: vec![vertex(-1.0, true), vertex(-0.5, true), vertex(-9.0, false)],
            unstable: 0,
            faults: Faults::default(),
            texels_per_edge: 1,
            texture: vec![vec![3.0], vec![1.0], vec![0.5]],
            texture_samples: vec![vec![1.0]; 3],
        };
        let head = VertexHead {
            command: String::new(),
            model: Model::Exponential,
            terms: 2,
            threshold: 4.0,
            channels: names(),
            eta: 1.4,
            gains: Vec::new(),
        };
        let material = VertexMaterial::new(Path::new("m"), &head, &model, mesh.clone()).unwrap();
        let (from, to) = (site([1.0, 2.0, 0.0]), site([2.0, 2.0, 1.0]));
        let found = material.eval(&from, &to);
        for (value, channel) in [(found.x, 1), (found.y, 2), (found.z, 0)] {
            // Weights 0.25 and 0.25 of the corners that are known.
            let of = |i: usize| model.vertices[i].value(2f64.sqrt(), channel).unwrap();
            let expected = 0.5 * (of(0) + of(1)) * f64::from([3.0f32, 1.0, 0.5][channel]);
            assert!((f64::from(value) / expected - 1.0).abs() < 1e-5, "{channel}: {value} {expected}");
        }
        check(&material, &to);
        let corners = |scale: f32| move |face: usize| mesh.corners(face).map(|p| p * scale);
        assert!(material.fits(1, &corners.clone()(1.0)).is_ok() && material.fits(1, &corners.clone()(1.1)).is_err());
        assert!(material.fits(0, &corners(1.0)).is_err());
    }
}
