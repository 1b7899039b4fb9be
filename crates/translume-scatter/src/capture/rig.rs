//! `rig.json`: where the camera and the laser of a capture were, and what their numbers mean.
//!
//! World coordinates are millimetres of the mesh; a camera looks along its z axis, x to the right and y down.

use serde::{Deserialize, Serialize};

/// Version of the format; a reader refuses another major one.
pub const RIG_VERSION: &str = "1.1";

/// The whole rig.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rig {
    /// `translume capture`.
    pub format: String,
    /// [`RIG_VERSION`].
    pub version: String,
    /// `mm`.
    pub units: String,
    /// Folder of the Zarr array of frames.
    pub frames: String,
    /// File of the surface.
    pub mesh: String,
    /// Relative index of refraction of the object.
    pub eta: f64,
    /// What the frames' third dimension counts.
    pub channels: Vec<Channel>,
    /// What the frames' first dimension counts.
    pub views: Vec<View>,
    /// What lit the object.
    pub laser: Laser,
    /// How the capture was made: for simulated ones the medium and all parameters.
    #[serde(default)]
    pub provenance: serde_json::Value,
}

impl Rig {
    /// With the files and units that every capture has, and nothing said of how it was made.
    pub fn new(eta: f64, channels: Vec<Channel>, views: Vec<View>, laser: Laser) -> Self {
        Self {
            format: "translume capture".into(),
            version: RIG_VERSION.into(),
            units: "mm".into(),
            frames: "frames".into(),
            mesh: "mesh.ply".into(),
            eta,
            channels,
            views,
            laser,
            provenance: serde_json::Value::Null,
        }
    }
}

/// Which of the channels with these names are red, green and blue; a single one is all three. `None` for other sets.
pub fn rgb_of<'a>(names: impl IntoIterator<Item = &'a str>) -> Option<[usize; 3]> {
    let names: Vec<&str> = names.into_iter().collect();
    if names.len() == 1 {
        return Some([0; 3]);
    }
    let find = |name: &str| names.iter().position(|n| n.eq_ignore_ascii_case(name));
    Some([find("red")?, find("green")?, find("blue")?])
}

/// A colour of the laser and the camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Channel {
    /// Its name.
    pub name: String,
    /// Wavelength in nm. Nothing is computed from it but whether it goes with the name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wavelength_nm: Option<f64>,
    /// Factor that makes a white target white.
    pub white_balance: f64,
    /// Standard deviation of the noise of a dark pixel, in the unit of the frames.
    pub noise_floor: f64,
}

/// A position of camera and turntable.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct View {
    /// Angle of the turntable; the pose already contains it.
    pub turntable_deg: f64,
    /// The camera in world coordinates.
    pub camera: Camera,
}

/// A pinhole camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Columns of a frame.
    pub width: usize,
    /// Rows of a frame.
    pub height: usize,
    /// Focal length in pixels.
    pub focal_px: f64,
    /// Principal point in pixels from the upper left corner of the frame.
    pub center_px: [f64; 2],
    /// Rotation and translation from world to camera, three rows.
    pub camera_from_world: [[f64; 4]; 3],
}

/// The laser projector.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Laser {
    /// Where the beams come from.
    pub origin_mm: [f64; 3],
    /// Where the beam of each hit comes from, where that is not the same for all: the turntable has moved.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub origins_mm: Vec<[f64; 3]>,
    /// Diameter of the beam on the object, where it has fallen to 1/e².
    pub beam_diameter_mm: f64,
    /// Power of each channel.
    pub power: Vec<f64>,
    /// Columns and rows of the deflection grid.
    pub grid: [usize; 2],
    /// Where each beam hits the object, in the order of the frames' second dimension.
    pub hits_mm: Vec<[f64; 3]>,
}

impl Rig {
    /// Which channels are red, green and blue, by [`rgb_of`].
    pub fn rgb(&self) -> Option<[usize; 3]> {
        rgb_of(self.channels.iter().map(|c| c.name.as_str()))
    }

    /// What is odd, though it can be worked with: wavelengths that contradict the channels' names.
    pub fn doubts(&self) -> Option<String> {
        let [r, g, b] = self.rgb()?.map(|c| self.channels[c].wavelength_nm);
        let longer = |a: Option<f64>, b: Option<f64>| a.zip(b).is_none_or(|(a, b)| a >= b);
        let right = longer(r, g) && longer(g, b) && longer(r, b);
        (!right)
            .then(|| "wavelengths do not fall from red over green to blue: are the channels' names right?".to_owned())
    }
}

impl Laser {
    /// Where the beam of a position comes from.
    pub fn origin(&self, position: usize) -> [f64; 3] {
        *self.origins_mm.get(position).unwrap_or(&self.origin_mm)
    }
}

impl Camera {
    /// A camera at `eye` that looks at `target`, upright towards `up`, whose frame spans `span_mm` at the target.
    pub fn looking_at(eye: [f64; 3], target: [f64; 3], up: [f64; 3], size: (usize, usize), span_mm: f64) -> Self {
        let forward = normalize(sub(target, eye));
        let right = normalize(cross(forward, up));
        let down = cross(forward, right);
        let row = |a: [f64; 3]| [a[0], a[1], a[2], -dot(a, eye)];
        Self {
            width: size.0,
            height: size.1,
            focal_px: size.0 as f64 * norm(sub(target, eye)) / span_mm,
            center_px: [size.0 as f64 / 2.0, size.1 as f64 / 2.0],
            camera_from_world: [row(right), row(down), row(forward)],
        }
    }

    /// Pixel coordinates of a point, in front of the camera.
    pub fn project(&self, p: [f64; 3]) -> Option<[f64; 2]> {
        let [x, y, z] = self.camera_from_world.map(|r| r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + r[3]);
        (z > 0.0).then(|| [self.center_px[0] + self.focal_px * x / z, self.center_px[1] + self.focal_px * y / z])
    }

    /// Where the camera is.
    pub fn eye(&self) -> [f64; 3] {
        let m = &self.camera_from_world;
        std::array::from_fn(|i| -(0..3).map(|k| m[k][i] * m[k][3]).sum::<f64>())
    }

    /// Direction through a place of the frame, of unit length.
    pub fn direction(&self, px: [f64; 2]) -> [f64; 3] {
        let local = [(px[0] - self.center_px[0]) / self.focal_px, (px[1] - self.center_px[1]) / self.focal_px, 1.0];
        let m = &self.camera_from_world;
        normalize(std::array::from_fn(|i| (0..3).map(|k| m[k][i] * local[k]).sum()))
    }

    /// Where the line of sight through a place of the frame meets the plane z = `height`.
    pub fn on_plane(&self, px: [f64; 2], height: f64) -> Option<[f64; 2]> {
        let (eye, d) = (self.eye(), self.direction(px));
        let t = (height - eye[2]) / d[2];
        (t > 0.0 && t.is_finite()).then(|| [eye[0] + t * d[0], eye[1] + t * d[1]])
    }
}

pub(crate) fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn norm(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

pub(crate) fn normalize(a: [f64; 3]) -> [f64; 3] {
    let n = norm(a);
    a.map(|x| x / n)
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn projection_and_line_of_sight_are_inverse() {
        let camera = Camera::looking_at([120.0, 30.0, 500.0], [1.0, 2.0, 0.0], [0.0, 1.0, 0.0], (64, 48), 24.0);
        let eye = camera.eye();
        assert!(norm(sub(eye, [120.0, 30.0, 500.0])) < 1e-9);
        for px in [[0.0, 0.0], [32.0, 24.0], [60.5, 3.25]] {
            let [x, y] = camera.on_plane(px, 0.0).unwrap();
            let back = camera.project([x, y, 0.0]).unwrap();
            assert!((back[0] - px[0]).abs() < 1e-9 && (back[1] - px[1]).abs() < 1e-9, "{px:?} {back:?}");
        }
        let center = camera.on_plane([32.0, 24.0], 0.0).unwrap();
        assert!((center[0] - 1.0).abs() < 1e-9 && (center[1] - 2.0).abs() < 1e-9);
        // y is up in the world and down in the frame.
        assert!(camera.project([1.0, 5.0, 0.0]).unwrap()[1] < 24.0);
    }
}
