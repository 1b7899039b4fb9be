//! From the frames of a mesh's capture to samples of R_d.
//!
//! R_d(x_i → x_o) = π L_o / (F_t(η, ω_o) F_t(η, ω_i) Φ) [Goesele 2004, Eq. 2] for a beam of power Φ. A pixel is a sample where its
//! centre sees the mesh at no grazing angle and all its neighbours see the mesh too: at silhouettes a small error of pose or
//! shape puts the light elsewhere.

use crate::capture::{Capture, Surface, Texels, dot, norm, normalize, sub};
use glam::Vec3;
use std::f64::consts::PI;
use translume_bxdf::fresnel;
use translume_image::{Error, Result};

/// What a pixel sees.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pixel {
    pub(super) at: [f64; 3],
    pub(super) face: u32,
    pub(super) uv: [f32; 2],
    /// Cosine of the line of sight.
    pub(super) cos: f32,
    /// 1/F_t towards the camera.
    inverse: f64,
}

/// A laser position that is used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    /// Its number in the rig.
    pub position: usize,
    /// Where it hits, in mm.
    pub at: [f64; 3],
    /// Cosine of incidence, 0.05 at least.
    pub cos: f64,
    /// Triangle of the mesh that it hits, and weights of its corners.
    pub on: Option<(u32, [f64; 3])>,
    /// R_d per radiance, without the pixel's Fresnel factor, for power 1.
    gain: f64,
}

/// A capture of a mesh, ready to be sampled.
pub struct MeshCapture {
    /// The capture.
    pub capture: Capture,
    /// The laser positions that have frames.
    pub beams: Vec<Beam>,
    /// Laser positions without any frame that has all channels.
    pub dark: usize,
    /// Multiple of the noise floor above which a pixel is a sample.
    pub threshold: f64,
    /// Power of the laser in the frames of each beam, its views and the channels, against what the rig says; empty where that is taken to
    /// be right.
    pub gains: Vec<Vec<Vec<f64>>>,
    /// Its mesh, for rays.
    pub surface: Surface,
    /// What each pixel of each view sees.
    pub(super) pixels: Vec<Vec<Option<Pixel>>>,
    /// Views with frames of each beam.
    pub(super) views: Vec<Vec<usize>>,
}

/// Lines of sight at less than this cosine are no samples.
const GRAZING: f64 = 0.25;

impl MeshCapture {
    /// Finds what the pixels see, and the laser positions with frames.
    ///
    /// # Errors
    /// [`Error::Invalid`] where no laser position has frames; those of reading frames.
    pub fn new(capture: Capture, threshold: f64) -> Result<Self> {
        let file = capture.path.join(&capture.rig.mesh);
        if let Some(fault) = capture.mesh.fault() {
            return Err(Error::invalid(&file, fault));
        }
        let surface = Surface::new(capture.mesh.clone());
        let surface = surface.ok_or_else(|| Error::unsupported(&file, "too many triangles"))?;
        let pixels = (0..capture.rig.views.len()).map(|v| seen(&capture, &surface, v)).collect();
        let mut mesh = Self {
            capture,
            beams: Vec::new(),
            dark: 0,
            threshold,
            gains: Vec::new(),
            surface,
            pixels,
            views: Vec::new(),
        };
        for position in 0..mesh.capture.rig.laser.hits_mm.len() {
            let views = mesh.lit_views(position)?;
            match views.is_empty() {
                true => mesh.dark += 1,
                false => {
                    mesh.beams.push(mesh.beam(position));
                    mesh.views.push(views);
                }
            }
        }
        match mesh.beams.is_empty() {
            true => Err(Error::invalid(&mesh.capture.path, "no laser position has frames in all channels")),
            false => Ok(mesh),
        }
    }

    /// Views that have frames of a position in all channels. Only their files are looked for; they are read when needed.
    fn lit_views(&self, position: usize) -> Result<Vec<usize>> {
        let [views, _, channels, ..] = self.capture.frames.shape;
        let whole = |&view: &usize| (0..channels).all(|c| self.capture.frames.exists(view, position, c));
        Ok((0..views).filter(whole).collect())
    }

    fn beam(&self, position: usize) -> Beam {
        let laser = &self.capture.rig.laser;
        let (at, origin) = (laser.hits_mm[position], laser.origin(position));
        let direction = normalize(sub(at, origin));
        let to_single = |v: [f64; 3]| Vec3::from_array(v.map(|x| x as f32));
        let place = self.surface.first(to_single(origin), to_single(direction));
        let cos = place.map_or(1.0, |p| -dot(direction, p.normal.as_dvec3().to_array())).max(0.05);
        let entered = f64::from(1.0 - fresnel::dielectric(cos as f32, self.capture.rig.eta as f32).reflectance);
        let on = place.map(|p| (p.face, Surface::weights(&p)));
        Beam { position, at, cos, on, gain: PI / entered }
    }

    /// R_d in mm⁻² for all pixels of a view's frame of a beam; 0 where it is no sample.
    ///
    /// # Errors
    /// Those of reading frames.
    pub fn reflectance(&self, beam: usize, view: usize, channel: usize) -> Result<Vec<f32>> {
        let drift = self.gains.get(beam).map_or(1.0, |gains| {
            let own = self.views[beam].iter().position(|v| *v == view);
            own.map_or(1.0, |k| gains[k][channel])
        });
        let beam = &self.beams[beam];
        let frame = self.capture.frames.read(view, beam.position, channel)?;
        let frame = frame.ok_or_else(|| Error::invalid(&self.capture.path, "a frame vanished while it was read"))?;
        let rig = &self.capture.rig;
        let scale = beam.gain / drift * rig.channels[channel].white_balance / rig.laser.power[channel];
        let floor = (self.threshold * rig.channels[channel].noise_floor) as f32;
        let value = |(l, pixel): (&f32, &Option<Pixel>)| match pixel {
            // [Goesele 2004, Eq. 2]
            Some(p) if *l > floor && l.is_finite() => (f64::from(*l) * scale * p.inverse) as f32,
            _ => 0.0,
        };
        Ok(frame.iter().zip(&self.pixels[view]).map(value).collect())
    }

    /// Distance in mm of what each pixel of a view sees from where a beam hits.
    pub fn distances(&self, beam: usize, view: usize) -> Vec<Option<f64>> {
        let at = self.beams[beam].at;
        self.pixels[view].iter().map(|p| p.map(|p| norm(sub(p.at, at)))).collect()
    }

    /// The vertex nearest to where a beam hits.
    pub fn nearest_vertex(&self, beam: usize) -> usize {
        let at = self.beams[beam].at;
        let distance = |p: &[f32; 3]| norm(sub(p.map(f64::from), at));
        let all = self.surface.mesh.positions.iter().map(distance).enumerate();
        all.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |n| n.0)
    }

    /// A picture of a view: values of vertices, blended over the triangles; 0 beside the mesh.
    pub fn vertex_map(&self, view: usize, value: impl Fn(usize) -> f64) -> Vec<f32> {
        let blend = |p: &Pixel| {
            let corners = self.surface.mesh.indices[p.face as usize];
            let [u, v] = p.uv.map(f64::from);
            corners.iter().zip([1.0 - u - v, u, v]).map(|(&i, w)| w * value(i as usize)).sum::<f64>() as f32
        };
        self.pixels[view].iter().map(|p| p.as_ref().map_or(0.0, blend)).collect()
    }

    /// A picture of a view: values of texels; 0 beside the mesh.
    pub fn texel_map(&self, view: usize, per_edge: usize, values: &[f32]) -> Vec<f32> {
        let texels = Texels { per_edge };
        self.pixels[view].iter().map(|p| p.map_or(0.0, |p| values[texels.index(p.face, p.uv)])).collect()
    }

    /// Views that have frames of a beam.
    pub fn views(&self, beam: usize) -> &[usize] {
        &self.views[beam]
    }
}

/// What the pixels of a view see.
fn seen(capture: &Capture, surface: &Surface, view: usize) -> Vec<Option<Pixel>> {
    let camera = &capture.rig.views[view].camera;
    let (w, h) = (camera.width, camera.height);
    let center = |i: usize| [(i % w) as f64 + 0.5, (i / w) as f64 + 0.5];
    let all: Vec<_> = (0..w * h).map(|i| surface.seen(camera, center(i))).collect();
    let inner = |i: usize| {
        let (x, y) = (i % w, i / w);
        let span = |k: usize, n: usize| k.saturating_sub(1)..=(k + 1).min(n - 1);
        span(y, h).all(|y| span(x, w).all(|x| all[y * w + x].is_some()))
    };
    let pixel = |i: usize| {
        let (place, cos) = all[i].filter(|(_, cos)| *cos >= GRAZING && inner(i))?;
        let through = f64::from(1.0 - fresnel::dielectric(cos as f32, capture.rig.eta as f32).reflectance);
        let cos = cos as f32;
        Some(Pixel { at: place.at, face: place.face, uv: place.uv, cos, inverse: 1.0 / through.max(1e-6) })
    };
    (0..w * h).map(pixel).collect()
}
