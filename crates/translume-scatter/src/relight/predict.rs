//! What a model says about the frames of a capture: the light of a beam as power on the texels and vertices around its hit.
//!
//! The beam has no width here; the kernels carry that of the one they were measured with.

use super::evaluate::{Part, Relighter};
use super::irradiance::Power;
use crate::capture::{Capture, Surface, normalize, sub};
use crate::hierarchical::Hierarchical;
use crate::planar::ErrorMap;
use glam::Vec3;
use rayon::prelude::*;
use translume_bxdf::fresnel;
use translume_image::Result;

/// A model before the cameras of a capture.
pub struct Predictor<'a> {
    model: &'a Hierarchical,
    capture: &'a Capture,
    surface: Surface,
    views: Vec<Relighter>,
}

impl<'a> Predictor<'a> {
    /// `None` for a mesh that rays cannot be cast at.
    pub fn new(model: &'a Hierarchical, capture: &'a Capture) -> Option<Self> {
        let surface = Surface::new(model.mesh.clone())?;
        let view = |v: &crate::capture::View| Relighter::for_camera(model, &surface, &v.camera);
        let views = capture.rig.views.iter().map(view).collect();
        Some(Self { model, capture, surface, views })
    }

    /// A frame, as the capture's unit has it, for all channels. `None` for a beam that misses the mesh.
    pub fn frame(&self, position: usize, view: usize, part: Part) -> Option<Vec<[f32; 3]>> {
        let laser = &self.capture.rig.laser;
        let single = |v: [f64; 3]| Vec3::from_array(v.map(|x| x as f32));
        let origin = laser.origin(position);
        let direction = single(normalize(sub(laser.hits_mm[position], origin)));
        let place = self.surface.first(single(origin), direction)?;
        let cos = (-direction.dot(place.normal)).max(0.05);
        let entered = 1.0 - fresnel::dielectric(cos, self.model.eta as f32).reflectance;
        let channel = |c: usize| {
            let c = c.min(laser.power.len() - 1);
            (laser.power[c] / self.capture.rig.channels[c].white_balance) as f32
        };
        let light = entered * Vec3::new(channel(0), channel(1), channel(2));
        let mut power = Power {
            texels: vec![Vec3::ZERO; self.model.atlas.texels.len()],
            vertices: vec![Vec3::ZERO; self.model.mesh.positions.len()],
        };
        for (texel, w) in self.model.atlas.between(place.face, place.uv) {
            power.texels[texel as usize] += w * light;
        }
        let corners = self.model.mesh.indices[place.face as usize];
        for (&v, w) in corners.iter().zip(Surface::weights(&place)) {
            power.vertices[v as usize] += w as f32 * light;
        }
        Some(self.views[view].picture(&power, part))
    }

    /// For each laser position and channel the root mean square of ln(model/frame) over the pixels above `threshold` times the noise floor,
    /// of all views; NaN without any.
    ///
    /// # Errors
    /// Those of reading frames.
    pub fn errors(&self, threshold: f64) -> Result<ErrorMap> {
        let [views, positions, channels, ..] = self.capture.frames.shape;
        let one = |position: usize| -> Result<Vec<f64>> {
            let (mut sums, mut counts) = (vec![0.0; channels], vec![0.0; channels]);
            for view in 0..views {
                let mut predicted = None;
                for channel in 0..channels {
                    let Some(frame) = self.capture.frames.read(view, position, channel)? else { continue };
                    if predicted.is_none() {
                        predicted = self.frame(position, view, Part::Whole);
                    }
                    let floor = (threshold * self.capture.rig.channels[channel].noise_floor) as f32;
                    for (l, p) in frame.iter().zip(predicted.iter().flatten()) {
                        if *l > floor && p[channel] > 0.0 {
                            sums[channel] += f64::from((p[channel] / l).ln()).powi(2);
                            counts[channel] += 1.0;
                        }
                    }
                }
            }
            Ok(sums.iter().zip(&counts).map(|(s, n): (&f64, &f64)| (s / n).sqrt()).collect())
        };
        Ok(ErrorMap { ln: (0..positions).into_par_iter().map(one).collect::<Result<_>>()? })
    }
}
