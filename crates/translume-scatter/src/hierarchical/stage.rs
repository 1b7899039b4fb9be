//! A capture made ready for resampling: surface, atlas, what the views see, where the beams hit.

use super::atlas::{Atlas, AtlasParams};
use super::views::{ViewMap, vertex_normals};
use crate::capture::{Capture, Surface, normalize, sub};
use glam::Vec3;
use std::f32::consts::PI;
use translume_bxdf::fresnel;
use translume_image::{Error, Result};

/// A laser position on the mesh.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beam {
    /// Its number in the rig.
    pub(super) position: usize,
    pub(super) at: Vec3,
    pub(super) normal: Vec3,
    /// Direction to the laser.
    pub(super) towards: Vec3,
    pub(super) face: u32,
    pub(super) uv: [f32; 2],
    /// Cosine of incidence.
    pub(super) cos: f32,
    /// π/F_t(η, ω_i).
    pub(super) gain: f32,
}

impl Beam {
    /// Weights of the corners of its triangle.
    pub(super) fn weights(&self) -> [f32; 3] {
        [1.0 - self.uv[0] - self.uv[1], self.uv[0], self.uv[1]]
    }
}

/// What could not be used.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Losses {
    /// Laser positions that miss the mesh or hit it at a grazing angle.
    pub astray: usize,
    /// Laser positions without a view that has all channels.
    pub missing: usize,
    /// Laser positions whose frames are all dark, or whose spot is not where the rig says.
    pub dark: usize,
    /// Views of laser positions with clipped pixels, which are left out.
    pub clipped: usize,
}

/// A capture of an object, ready to be resampled.
pub struct Stage {
    /// The capture.
    pub capture: Capture,
    /// Its mesh, one vertex for each position.
    pub surface: Surface,
    /// Texels on it.
    pub atlas: Atlas,
    /// Multiple of the noise floor above which a pixel is a sample.
    pub threshold: f64,
    /// Laser positions left out so far.
    pub losses: Losses,
    pub(super) views: Vec<ViewMap>,
    pub(super) beams: Vec<Beam>,
}

/// Beams at less than this cosine are left out.
const GRAZING: f32 = 0.25;
/// Vertices for which F fits the memory of a large machine; 30 GB.
const MOST_VERTICES: usize = 60_000;

impl Stage {
    /// Prepares `capture`.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a mesh without area or a rig whose beams all miss it; [`Error::Unsupported`] for a mesh of too many
    /// vertices, and for other numbers of channels than one and three.
    pub fn new(capture: Capture, threshold: f64, params: &AtlasParams) -> Result<Self> {
        let file = capture.path.join(&capture.rig.mesh);
        if let Some(fault) = capture.mesh.fault() {
            return Err(Error::invalid(&file, fault));
        }
        let mesh = capture.mesh.compacted();
        if mesh.positions.iter().flatten().any(|x| !x.is_finite()) {
            return Err(Error::invalid(&file, "a vertex is infinite or NaN"));
        }
        if mesh.positions.len() > MOST_VERTICES {
            let what = format!(
                "{} vertices: hierarchical models have up to {MOST_VERTICES}, one for each few square millimetres; simplify the mesh",
                mesh.positions.len()
            );
            return Err(Error::unsupported(&file, what));
        }
        let capture = capture.in_rgb_order();
        if ![1, 3].contains(&capture.rig.channels.len()) || capture.rig.rgb().is_none() {
            let names: Vec<&str> = capture.rig.channels.iter().map(|c| c.name.as_str()).collect();
            let what = format!("channels {}: hierarchical models have one, or red, green and blue", names.join(", "));
            return Err(Error::unsupported(&capture.path.join("rig.json"), what));
        }
        let atlas = Atlas::new(&mesh, params).ok_or_else(|| {
            Error::invalid(&file, "no triangle has an area, or there are too many pieces for an atlas")
        })?;
        let surface = Surface::new(mesh).ok_or_else(|| Error::unsupported(&file, "too many triangles"))?;
        let normals = vertex_normals(&surface.mesh);
        let eta = capture.rig.eta;
        let views =
            capture.rig.views.iter().map(|v| ViewMap::new(&v.camera, eta, &surface, &normals, &atlas)).collect();
        let positions = capture.rig.laser.hits_mm.len();
        let beams: Vec<Beam> = (0..positions).filter_map(|p| beam(&capture, &surface, p)).collect();
        if beams.is_empty() {
            return Err(Error::invalid(&capture.path, "no laser beam hits the mesh"));
        }
        let losses = Losses { astray: positions - beams.len(), ..Losses::default() };
        Ok(Self { capture, surface, atlas, threshold, losses, views, beams })
    }

    /// Number of laser positions that hit the mesh.
    pub fn positions(&self) -> usize {
        self.beams.len()
    }

    /// Leaves out laser positions, by their numbers in the rig, to see how well the others predict them.
    pub fn hold_out(&mut self, held: impl Fn(usize) -> bool) {
        self.beams.retain(|b| !held(b.position));
    }

    /// Corners of a triangle.
    pub(super) fn corners(&self, face: u32) -> [u32; 3] {
        self.surface.mesh.indices[face as usize]
    }
}

fn beam(capture: &Capture, surface: &Surface, position: usize) -> Option<Beam> {
    let laser = &capture.rig.laser;
    let (hit, origin) = (laser.hits_mm[position], laser.origin(position));
    let single = |v: [f64; 3]| Vec3::from_array(v.map(|x| x as f32));
    let direction = single(normalize(sub(hit, origin)));
    let place = surface.first(single(origin), direction)?;
    let cos = -direction.dot(place.normal);
    if cos < GRAZING {
        return None;
    }
    let entered = 1.0 - fresnel::dielectric(cos, capture.rig.eta as f32).reflectance;
    let at = single(place.at);
    Some(Beam {
        position,
        at,
        normal: place.normal,
        towards: -direction,
        face: place.face,
        uv: place.uv,
        cos,
        gain: PI / entered,
    })
}
