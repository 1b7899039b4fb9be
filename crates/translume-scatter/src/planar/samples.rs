//! From the frames of a planar capture to samples of R_d.
//!
//! R_d(x_i → x_o) = π L_o / (F_t(η, ω_o) F_t(η, ω_i) Φ) [Goesele 2004, Eq. 2] for a beam of power Φ. For each pixel the
//! laser position is taken that is best centred in it [Fuchs 2005, §4.1]; a position that no pixel prefers is left out. Pixels
//! at or under the noise threshold are no samples.

use crate::capture::Capture;
use crate::simulate::{incidence, transmittance};
use std::f64::consts::PI;
use translume_bxdf::fresnel;
use translume_image::{Error, Result};

/// A laser position that was selected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spot {
    /// View and laser position of its frames.
    pub frame: [usize; 2],
    /// Where it hits, in mm.
    pub at: [f64; 2],
    /// R_d per radiance of a pixel, without the pixel's own Fresnel factor, for power 1.
    gain: f64,
}

/// A planar capture, ready to be sampled.
pub struct PlanarCapture {
    /// The capture.
    pub capture: Capture,
    /// Selected laser positions.
    pub spots: Vec<Spot>,
    /// Frames that are missing, over all channels of the selected positions.
    pub missing: usize,
    /// Multiple of the noise floor above which a pixel is a sample.
    pub threshold: f64,
    /// Power of the laser in each spot's frame, per channel, against what the rig says; empty where it is taken to be right.
    pub gains: Vec<Vec<f64>>,
    /// Where each pixel of each view is on the plane, in mm, and 1/F_t towards the camera.
    pixels: Vec<Vec<([f64; 2], f64)>>,
}

/// Every fifth pixel of a frame, in a pattern without structure that differs from frame to frame, is kept from all fits.
pub fn held_out(spot: usize, pixel: usize) -> bool {
    let mixed = (spot as u64 ^ 0x51ed_270b).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (pixel as u64);
    (mixed.wrapping_mul(0xff51_afd7_ed55_8ccd) >> 33).is_multiple_of(5)
}

impl PlanarCapture {
    /// Finds the plane, the pixels on it and the laser positions.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for a surface that is not the plane z = 0; [`Error::Invalid`] without any laser position
    /// in view.
    pub fn new(capture: Capture, threshold: f64) -> Result<Self> {
        if !capture.is_flat() {
            let bounds = capture.mesh.bounds();
            let (low, high) = (bounds.lo.z, bounds.hi.z);
            return Err(Error::unsupported(
                &capture.path.join(&capture.rig.mesh),
                format!("the planar model needs a flat sample in z = 0; this one reaches from z = {low} to {high} mm"),
            ));
        }
        let eta = capture.rig.eta;
        let pixels = capture.rig.views.iter().map(|v| {
            let camera = &v.camera;
            let all = (0..camera.height).flat_map(|row| (0..camera.width).map(move |column| (row, column)));
            let one = |(row, column): (usize, usize)| {
                let px = [column as f64 + 0.5, row as f64 + 0.5];
                // A pixel above the horizon is infinitely far and never a sample.
                let at = camera.on_plane(px, 0.0).unwrap_or([f64::INFINITY; 2]);
                (at, 1.0 / transmittance(camera, px, eta).max(1e-6))
            };
            all.map(one).collect::<Vec<_>>()
        });
        let pixels = pixels.collect();
        let spots = select(&capture);
        if spots.is_empty() {
            return Err(Error::invalid(&capture.path, "no laser position hits the surface inside a frame"));
        }
        let mut planar = Self { capture, spots, missing: 0, threshold, gains: Vec::new(), pixels };
        planar.drop_missing()?;
        Ok(planar)
    }

    /// Leaves out positions without frames.
    fn drop_missing(&mut self) -> Result<()> {
        let channels = self.capture.rig.channels.len();
        let mut kept = Vec::new();
        for spot in &self.spots {
            let mut there = 0;
            for channel in 0..channels {
                there += usize::from(self.capture.frames.read(spot.frame[0], spot.frame[1], channel)?.is_some());
            }
            self.missing += channels - there;
            if there == channels {
                kept.push(*spot);
            }
        }
        if kept.is_empty() {
            return Err(Error::invalid(&self.capture.path, "no laser position has frames in all channels"));
        }
        self.spots = kept;
        Ok(())
    }

    /// Places of the pixels of a view on the plane, in mm.
    pub fn places(&self, view: usize) -> impl ExactSizeIterator<Item = [f64; 2]> + '_ {
        self.pixels[view].iter().map(|p| p.0)
    }

    /// R_d in mm⁻² for all pixels of a spot's frame; 0 where it is not above the noise.
    ///
    /// # Errors
    /// Those of reading frames.
    pub fn reflectance(&self, spot: &Spot, channel: usize) -> Result<Vec<f32>> {
        let frame = self.capture.frames.read(spot.frame[0], spot.frame[1], channel)?;
        let frame = frame.ok_or_else(|| Error::invalid(&self.capture.path, "a frame vanished while it was read"))?;
        let rig = &self.capture.rig;
        let drift = self.spots.iter().position(|s| s.frame == spot.frame).and_then(|i| self.gains.get(i));
        let scale = spot.gain / drift.map_or(1.0, |d| d[channel]) * rig.channels[channel].white_balance
            / rig.laser.power[channel];
        let floor = (self.threshold * rig.channels[channel].noise_floor) as f32;
        let value = |(l, (at, inverse)): (&f32, &([f64; 2], f64))| {
            let seen = *l > floor && l.is_finite() && at[0].is_finite();
            // [Goesele 2004, Eq. 2]
            if seen { (f64::from(*l) * scale * inverse) as f32 } else { 0.0 }
        };
        Ok(frame.iter().zip(&self.pixels[spot.frame[0]]).map(value).collect())
    }
}

/// For every pixel the laser position nearest to its centre, if it lies inside the pixel; each once.
fn select(capture: &Capture) -> Vec<Spot> {
    let rig = &capture.rig;
    let mut spots = Vec::new();
    for (view, v) in rig.views.iter().enumerate() {
        let camera = &v.camera;
        let mut best: Vec<Option<(f64, usize)>> = vec![None; camera.width * camera.height];
        for (position, hit) in rig.laser.hits_mm.iter().enumerate() {
            let Some([x, y]) = camera.project(*hit) else { continue };
            if !((0.0..camera.width as f64).contains(&x) && (0.0..camera.height as f64).contains(&y)) {
                continue;
            }
            // [Fuchs 2005, §4.1]
            let off = (x.fract() - 0.5).hypot(y.fract() - 0.5);
            let pixel = &mut best[y as usize * camera.width + x as usize];
            if pixel.is_none_or(|(o, _)| off < o) {
                *pixel = Some((off, position));
            }
        }
        let mut chosen: Vec<usize> = best.into_iter().flatten().map(|(_, p)| p).collect();
        chosen.sort_unstable();
        spots.extend(chosen.into_iter().map(|position| {
            let hit = rig.laser.hits_mm[position];
            let cos = incidence(rig.laser.origin(position), hit);
            let entered = f64::from(1.0 - fresnel::dielectric(cos as f32, rig.eta as f32).reflectance);
            Spot { frame: [view, position], at: [hit[0], hit[1]], gain: PI / entered }
        }));
    }
    spots
}
