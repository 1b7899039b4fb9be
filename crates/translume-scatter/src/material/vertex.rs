//! The exponential model of an object as a material: fall-offs of the corners of x_i's triangle blended, times the modulation
//! at x_o [Fuchs 2005, Eq. 9]. It stands on the mesh that it was fitted to.

use super::fall_off::{FallOff, widen};
use super::{Envelope, colours};
use crate::capture::Texels;
use crate::vertex::{VertexHead, VertexModel, read_vertex_model};
use glam::{Vec2, Vec3};
use std::path::Path;
use translume_bxdf::Rgb;
use translume_bxdf::bssrdf::{Bssrdf, Gammas, Radii, Site};
use translume_image::{Error, Result};
use translume_mesh::TriMesh;

/// See the module.
pub struct VertexMaterial {
    name: String,
    eta: f32,
    mesh: TriMesh,
    /// For each vertex factors and fall-off, where there is one.
    vertices: Vec<Option<(Rgb, FallOff)>>,
    texels: Texels,
    /// α of each texel.
    modulation: Vec<Rgb>,
    /// Decay of the widest fall-off.
    slowest: f32,
    envelope: Envelope,
}

impl std::fmt::Debug for VertexMaterial {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        // Enough to tell two models apart, for checkpoints of renders.
        let sums = self.vertices.iter().flatten().fold([0.0f64; 2], |[a, b], (scale, fall_off)| {
            [a + f64::from(scale.element_sum()), b + f64::from(fall_off.value(1.0))]
        });
        let modulation: f64 = self.modulation.iter().map(|m| f64::from(m.element_sum())).sum();
        write!(f, "vertex model {}, {} vertices, {sums:?} {modulation}", self.name, self.vertices.len())
    }
}

impl VertexMaterial {
    /// From a model's folder.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Invalid`], [`Error::Unsupported`].
    pub fn load(path: &Path) -> Result<Self> {
        let (head, model, mesh) = read_vertex_model(path)?;
        Self::new(path, &head, &model, mesh)
    }

    /// From a model in memory; `path` is for messages.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for channels without colours; [`Error::Invalid`] for a model without any fall-off.
    pub fn new(path: &Path, head: &VertexHead, model: &VertexModel, mesh: TriMesh) -> Result<Self> {
        let rgb = colours(path, &head.channels)?;
        let vertex = |v: &crate::vertex::Vertex| {
            let curve = &v.fall_off.segments.first()?.curve;
            Some((Rgb::from_array(rgb.map(|c| v.scale[c] as f32)), FallOff::new(curve)))
        };
        let vertices: Vec<_> = model.vertices.iter().map(vertex).collect();
        let modulation = (0..model.texture[0].len()).map(|i| Rgb::from_array(rgb.map(|c| model.texture[c][i])));
        // A few vertices with an odd fit do not decide how far is looked.
        let mut rates: Vec<f32> = vertices.iter().flatten().map(|v| v.1.slowest()).collect();
        rates.sort_by(f32::total_cmp);
        let slowest = *rates.get(rates.len() / 50).ok_or_else(|| Error::invalid(path, "no vertex has a fall-off"))?;
        let envelope = Envelope::new(|r| {
            let all = vertices.iter().flatten().map(|(scale, f)| scale.max_element() * f.value(r));
            all.fold(0.0, f32::max)
        });
        let modulation: Vec<Rgb> = modulation.collect();
        let brightest = modulation.iter().map(|m| m.max_element()).fold(0.0, f32::max);
        let envelope = Envelope { values: envelope.values.iter().map(|v| v * brightest).collect() };
        Ok(Self {
            name: path.display().to_string(),
            eta: head.eta as f32,
            texels: Texels { per_edge: model.texels_per_edge },
            mesh,
            vertices,
            modulation,
            slowest,
            envelope,
        })
    }

    /// The corners around a place that have a fall-off, and their weights, which sum to 1.
    fn corners(&self, face: u32, uv: Vec2) -> impl Iterator<Item = (f32, &(Rgb, FallOff))> {
        let corners = self.mesh.indices[face as usize].map(|i| self.vertices[i as usize].as_ref());
        let weights = [1.0 - uv.x - uv.y, uv.x, uv.y];
        let total: f32 = corners.iter().zip(weights).filter(|c| c.0.is_some()).map(|c| c.1).sum();
        let known = corners.into_iter().zip(weights).filter_map(|(v, w)| Some((w, v?)));
        known.filter(move |_| total > 1e-6).map(move |(w, v)| (w / total, v))
    }
}

impl Bssrdf for VertexMaterial {
    fn eval(&self, from: &Site, to: &Site) -> Rgb {
        let r = from.p.distance(to.p);
        let sum: Rgb =
            self.corners(from.face, from.uv).map(|(w, (scale, fall_off))| *scale * (w * fall_off.value(r))).sum();
        // [Fuchs 2005, Eq. 9]
        sum * self.modulation[self.texels.index(to.face, to.uv.to_array())]
    }

    fn radii(&self, to: &Site) -> Radii<'_> {
        let mut gammas = Gammas::default();
        for (w, (scale, fall_off)) in self.corners(to.face, to.uv) {
            fall_off.densities(|weight, k| gammas.push(w * scale.element_sum() * weight, k));
        }
        widen(&mut gammas, self.slowest);
        Radii::Gammas(gammas)
    }

    fn total(&self, from: &Site) -> Rgb {
        self.corners(from.face, from.uv).map(|(w, (scale, fall_off))| *scale * (w * fall_off.total())).sum()
    }

    fn bound(&self, r: f32) -> f32 {
        self.envelope.bound(r)
    }

    fn eta(&self) -> Option<f32> {
        Some(self.eta)
    }

    fn fits(&self, faces: usize, corners: &dyn Fn(usize) -> [Vec3; 3]) -> std::result::Result<(), String> {
        super::same_mesh(&self.name, &self.mesh, faces, corners)
    }
}
