//! Where the cameras and the laser of a capture really were [Goesele 2004, §4.4], from its own frames.
//!
//! 1. All frames of a view together show the object, which glows as a whole: its outline against the dark is compared with that of
//!    the mesh, along the normals of the outline, and the camera is moved until they agree [Lensch et al. 2001, who compare areas].
//! 2. A lit point is where the brightest spot of a frame meets the mesh. The beams of the rig, which keep the angles between them as
//!    the deflection of the projector gave them, are moved as one until they go through those points.
//! 3. With the beams known the spots say more about the cameras than outlines do (a ball may be turned without changing its
//!    outline), so cameras and beams are refined in turn, by outlines and spots.
//!
//! All poses are drawn weakly to what the rig says, so that what nothing tells stays as it was. Limits: cameras keep their focal
//! length; the background is dark; the mesh is right; the peak of light is taken to be where the beam enters.

mod cameras;
mod laser;
mod outline;
mod pictures;
mod pose;

pub use laser::Beams;

use crate::capture::{Camera, Capture, Surface};
use cameras::{Residuals, refine, residuals};
use pictures::Pictures;
use serde::Serialize;
use translume_image::{Error, Result};

/// How to register.
#[derive(Clone, Debug, PartialEq)]
pub struct RegisterParams {
    /// Rounds of cameras and beams in turn.
    pub rounds: usize,
    /// Hits are where the spots were seen, not where the beams meet the mesh.
    pub seen_hits: bool,
}

impl Default for RegisterParams {
    fn default() -> Self {
        Self { rounds: 6, seen_hits: false }
    }
}

/// What was found out about a camera. Residuals are medians of absolute values, before and after.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ViewReport {
    /// Places of the outline that were compared.
    pub outline_points: usize,
    /// Their distances from the outline of the mesh, in pixels; `None` without any.
    pub outline_px: Option<[f64; 2]>,
    /// Spots that were compared.
    pub spots: usize,
    /// Their distances from the hits, in pixels.
    pub spot_px: Option<[f64; 2]>,
    /// Angle by which the camera was turned about the object.
    pub turned_deg: f64,
    /// Length by which it was moved.
    pub moved_mm: f64,
}

/// What was found out about a capture.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RegisterReport {
    /// As the views.
    pub views: Vec<ViewReport>,
    /// For each place that the laser shone from; empty where outlines do not show where the cameras were.
    pub beams: Vec<Beams>,
    /// Beams that do not meet the mesh; their hits stay as they were.
    pub missed: usize,
}

/// Corrects the cameras, the laser's origins and its hits in `capture.rig` [Goesele 2004, §4.4]; `progress` is called for each laser position.
///
/// # Errors
/// [`Error::Invalid`] where no view sees the mesh, or none that has frames shows an outline or spots; those of reading frames.
pub fn register(capture: &mut Capture, params: &RegisterParams, progress: impl Fn() + Sync) -> Result<RegisterReport> {
    let mesh_file = capture.path.join(&capture.rig.mesh);
    if let Some(fault) = capture.mesh.fault() {
        return Err(Error::invalid(&mesh_file, fault));
    }
    let surface = Surface::new(capture.mesh.clone());
    let surface = surface.ok_or_else(|| Error::unsupported(&mesh_file, "too many triangles"))?;
    in_sight(capture, &surface)?;
    let pictures = Pictures::read(capture, progress)?;
    let given = capture.rig.clone();
    let mut shown: Vec<bool> = vec![false; given.views.len()];
    // Outlines alone first: they need no beam.
    for (view, lit) in pictures.views.iter().enumerate() {
        let found = refine(&surface, &given.views[view].camera, lit, None);
        shown[view] = found.is_some();
        capture.rig.views[view].camera = found.unwrap_or_else(|| given.views[view].camera.clone());
    }
    // On a sample that fills the frames nothing tells cameras and laser apart; then the laser is taken to be right.
    let outlined = shown.contains(&true);
    if outlined {
        laser::land(&surface, &mut capture.rig);
    }
    let mut beams = Vec::new();
    for _ in 0..params.rounds {
        if outlined {
            beams = laser::refine(&surface, &given, &mut capture.rig, &pictures, &shown);
        }
        for (view, lit) in pictures.views.iter().enumerate() {
            let hits = Some(&capture.rig.laser.hits_mm[..]);
            let start = if shown[view] { &capture.rig.views[view].camera } else { &given.views[view].camera };
            if let Some(camera) = cameras::refine_from(&surface, &given.views[view].camera, start, lit, hits) {
                capture.rig.views[view].camera = camera;
                shown[view] = true;
            }
        }
    }
    if !shown.contains(&true) {
        let what = "neither an outline of the object nor spots of the laser can be made out in its frames";
        return Err(Error::invalid(&capture.path, what));
    }
    let missed = if outlined { laser::missed(&surface, &capture.rig) } else { 0 };
    if params.seen_hits {
        laser::take_seen(&surface, &mut capture.rig, &pictures);
    }
    let views = (0..given.views.len()).map(|v| tell(&surface, &given, capture, &pictures, v));
    Ok(RegisterReport { views: views.collect(), beams, missed })
}

/// Whether the mesh is in any frame at all.
fn in_sight(capture: &Capture, surface: &Surface) -> Result<()> {
    let sees = |camera: &Camera| {
        let (w, h) = (camera.width, camera.height);
        let step = (w.min(h) / 64).max(1);
        let mut all = (0..h).step_by(step).flat_map(|y| (0..w).step_by(step).map(move |x| (x, y)));
        all.any(|(x, y)| surface.seen(camera, [x as f64 + 0.5, y as f64 + 0.5]).is_some())
    };
    match capture.rig.views.iter().any(|v| sees(&v.camera)) {
        true => Ok(()),
        false => Err(Error::invalid(
            &capture.path,
            "no camera of rig.json has the mesh in its frame; a pose must be roughly right to be found (is the mesh in mm?)",
        )),
    }
}

/// What a view says before and after.
fn tell(
    surface: &Surface,
    given: &crate::capture::Rig,
    capture: &Capture,
    pictures: &Pictures,
    view: usize,
) -> ViewReport {
    let (before, after) = (&given.views[view].camera, &capture.rig.views[view].camera);
    let lit = &pictures.views[view];
    let old = residuals(surface, before, lit, Some(&given.laser.hits_mm));
    let new = residuals(surface, after, lit, Some(&capture.rig.laser.hits_mm));
    let pair = |of: fn(&Residuals) -> Option<f64>| Some([of(&old).unwrap_or(f64::NAN), of(&new)?]);
    let (turned, moved) = pose::between(before, after);
    ViewReport {
        outline_points: new.outline.len(),
        outline_px: pair(Residuals::outline_median),
        spots: new.spots.len(),
        spot_px: pair(Residuals::spot_median),
        turned_deg: turned.to_degrees(),
        moved_mm: moved,
    }
}

/// Factors that make a white target white: `light` is the sum over its pictures, for each channel. The lasers' powers are part of
/// the measurement equation, so factor × light / power is the same for all channels; the product of all factors stays as it was,
/// because a target tells colours, not how bright it is.
///
/// # Errors
/// [`Error::Mismatch`] where a channel has no light, or there are not as many numbers as channels.
pub fn white_balance(rig: &mut crate::capture::Rig, light: &[f64]) -> Result<()> {
    if light.len() != rig.channels.len() {
        let what = format!("{} pictures of the white target for {} channels", light.len(), rig.channels.len());
        return Err(Error::Mismatch(what));
    }
    if let Some(i) = light.iter().position(|l| !(*l > 0.0 && l.is_finite())) {
        return Err(Error::Mismatch(format!("the white target is black in channel {}", rig.channels[i].name)));
    }
    let factors: Vec<f64> = rig.laser.power.iter().zip(light).map(|(p, l)| p / l).collect();
    let log = |v: &mut dyn Iterator<Item = f64>| v.map(f64::ln).sum::<f64>() / light.len() as f64;
    let before = log(&mut rig.channels.iter().map(|c| c.white_balance));
    let scale = (before - log(&mut factors.iter().copied())).exp();
    rig.channels.iter_mut().zip(factors).for_each(|(c, f)| c.white_balance = f * scale);
    Ok(())
}
