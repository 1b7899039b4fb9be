//! Capture sets: pictures of an object lit by a narrow beam, point by point, with the rig that took them.

mod rig;
mod surface;
mod zarr;

pub use rig::{Camera, Channel, Laser, RIG_VERSION, Rig, View, rgb_of};
pub(crate) use rig::{dot, norm, normalize, sub};
pub use surface::{Place, Surface, Texels};
pub use zarr::{DIMENSIONS, Frames};

use std::path::{Path, PathBuf};
use translume_image::{Error, Result, atomic};
use translume_mesh::{ReadOptions, TriMesh, ply};

/// A capture set on disk: the rig and the surface in memory, frames read when they are asked for.
#[derive(Clone, Debug)]
pub struct Capture {
    /// Its folder.
    pub path: PathBuf,
    /// Camera, laser, channels.
    pub rig: Rig,
    /// The surface.
    pub mesh: TriMesh,
    /// The frames.
    pub frames: Frames,
}

impl Capture {
    /// Opens the folder `path` and checks that its parts go together.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Invalid`], [`Error::Unsupported`].
    pub fn open(path: &Path) -> Result<Self> {
        let file = path.join("rig.json");
        let text = std::fs::read(&file).map_err(|e| Error::io(&file, e))?;
        let rig: Rig = serde_json::from_slice(&text).map_err(|e| Error::invalid(&file, e.to_string()))?;
        check(&file, &rig)?;
        let frames = Frames::open(&path.join(&rig.frames))?;
        agree(&file, &rig, &frames)?;
        if let Some(doubt) = rig.doubts() {
            log::warn!("{}: {doubt}", file.display());
        }
        let mesh_file = path.join(&rig.mesh);
        let loaded = translume_mesh::read(&mesh_file, &ReadOptions::default())
            .map_err(|e| Error::invalid(&file, format!("its mesh: {e}")))?;
        let mesh = loaded.merged().filter(|m| !m.indices.is_empty());
        let mesh = mesh.ok_or_else(|| Error::invalid(&mesh_file, "no triangles"))?;
        Ok(Self { path: path.to_owned(), rig, mesh, frames })
    }

    /// The same with its channels in the order red, green, blue, if it has these; the files stay as they are.
    pub fn in_rgb_order(mut self) -> Self {
        let Some(order) = self.rig.rgb().filter(|_| self.rig.channels.len() == 3) else { return self };
        self.rig.channels = order.map(|c| self.rig.channels[c].clone()).to_vec();
        self.rig.laser.power = order.map(|c| self.rig.laser.power[c]).to_vec();
        self.frames.reorder_channels(order);
        self
    }

    /// Whether the surface is the plane z = 0, but for 2 % of its width.
    pub fn is_flat(&self) -> bool {
        let bounds = self.mesh.bounds();
        let width = (bounds.hi - bounds.lo).max_element();
        bounds.lo.z.abs().max(bounds.hi.z.abs()) <= 0.02 * width // false for NaN
    }

    /// Writes rig and mesh into the folder `path` and makes an array for the frames.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn create(path: &Path, rig: Rig, mesh: TriMesh) -> Result<Self> {
        std::fs::create_dir_all(path).map_err(|e| Error::io(path, e))?;
        let camera = &rig.views[0].camera;
        let shape = [rig.views.len(), rig.laser.hits_mm.len(), rig.channels.len(), camera.height, camera.width];
        let frames = Frames::create(&path.join(&rig.frames), shape)?;
        let text = serde_json::to_string_pretty(&rig).expect("plain data");
        atomic::write_bytes(&path.join("rig.json"), format!("{text}\n").as_bytes())?;
        let mesh_file = path.join(&rig.mesh);
        atomic::write(&mesh_file, |out| ply::write(&mesh, out).map_err(|e| Error::io(&mesh_file, e)))?;
        Ok(Self { path: path.to_owned(), rig, mesh, frames })
    }
}

/// What `rig.json` says by itself.
fn check(file: &Path, rig: &Rig) -> Result<()> {
    let invalid = |what: &str| Err(Error::invalid(file, what.to_owned()));
    if rig.format != "translume capture" || rig.units != "mm" {
        return invalid("not a translume capture in mm");
    }
    if rig.version.split('.').next() != RIG_VERSION.split('.').next() {
        return Err(Error::unsupported(file, format!("version {}; this program reads {RIG_VERSION}", rig.version)));
    }
    let outside = |name: &String| {
        Path::new(name).components().any(|c| !matches!(c, std::path::Component::Normal(_))) || name.is_empty()
    };
    if outside(&rig.frames) || outside(&rig.mesh) {
        return invalid("frames and mesh must lie inside the capture's folder");
    }
    if !(1.0..=4.0).contains(&rig.eta) {
        return invalid("eta must lie between 1 and 4");
    }
    if rig.laser.power.len() != rig.channels.len() || !rig.laser.power.iter().all(|p| *p > 0.0 && p.is_finite()) {
        return invalid("the laser needs one positive power for each channel");
    }
    if !rig.laser.origins_mm.is_empty() && rig.laser.origins_mm.len() != rig.laser.hits_mm.len() {
        return invalid("origins_mm needs one origin for each hit");
    }
    let places = rig.laser.hits_mm.iter().chain(&rig.laser.origins_mm).flatten();
    if places.chain(&rig.laser.origin_mm).any(|x| !x.is_finite()) {
        return invalid("a position of the laser is not finite");
    }
    let channel = |c: &Channel| c.white_balance > 0.0 && c.noise_floor >= 0.0 && c.noise_floor.is_finite();
    if !rig.channels.iter().all(channel) {
        return invalid("white balance must be positive and the noise floor 0 or more");
    }
    let pose = |v: &View| v.camera.focal_px > 0.0 && v.camera.camera_from_world.iter().flatten().all(|x| x.is_finite());
    if !rig.views.iter().all(pose) {
        return invalid("a camera needs a positive focal length and a finite pose");
    }
    Ok(())
}

/// Whether the rig counts what the array holds.
fn agree(file: &Path, rig: &Rig, frames: &Frames) -> Result<()> {
    let counts = [rig.views.len(), rig.laser.hits_mm.len(), rig.channels.len()];
    if counts != frames.shape[..3] {
        let [v, p, c, ..] = frames.shape;
        return Err(Error::invalid(
            file,
            format!(
                "it has {} views, {} laser positions and {} channels, the frames {v}, {p} and {c}",
                counts[0], counts[1], counts[2]
            ),
        ));
    }
    let [.., rows, columns] = frames.shape;
    match rig.views.iter().position(|v| (v.camera.height, v.camera.width) != (rows, columns)) {
        Some(i) => Err(Error::invalid(file, format!("the camera of view {i} does not have {columns} × {rows} pixels"))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig(names: [&str; 3]) -> Rig {
        let camera = Camera::looking_at([0.0, 0.0, 100.0], [0.0; 3], [0.0, 1.0, 0.0], (2, 1), 10.0);
        let channel =
            |name: &&str| Channel { name: (*name).into(), wavelength_nm: None, white_balance: 1.0, noise_floor: 0.0 };
        let laser = Laser {
            origin_mm: [0.0, 0.0, 50.0],
            origins_mm: Vec::new(),
            beam_diameter_mm: 1.0,
            power: vec![1.0, 2.0, 3.0],
            grid: [1, 1],
            hits_mm: vec![[0.0; 3]],
        };
        let views = vec![View { turntable_deg: 0.0, camera }];
        Rig::new(1.3, names.iter().map(channel).collect(), views, laser)
    }

    fn mesh() -> TriMesh {
        let positions = vec![[-5.0, -5.0, 0.0], [5.0, -5.0, 0.0], [0.0, 5.0, 0.0]];
        TriMesh { positions, indices: vec![[0, 1, 2]], ..TriMesh::default() }
    }

    #[test]
    fn channels_are_what_their_names_say() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("capture");
        let made = Capture::create(&path, rig(["blue", "Green", "red"]), mesh()).unwrap();
        for c in 0..3 {
            made.frames.write([0, 0, c], &[c as f32; 2]).unwrap();
        }
        let stored = Capture::open(&path).unwrap();
        assert_eq!(stored.frames.read(0, 0, 0).unwrap().unwrap(), [0.0; 2]);
        let capture = stored.in_rgb_order();
        let names: Vec<&str> = capture.rig.channels.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["red", "Green", "blue"]);
        assert_eq!(capture.rig.laser.power, [3.0, 2.0, 1.0]);
        let firsts = [0, 1, 2].map(|c| capture.frames.read(0, 0, c).unwrap().unwrap()[0]);
        assert_eq!(firsts, [2.0, 1.0, 0.0]);
        // What has no colours in its names stays as it is.
        assert_eq!(rgb_of(["a", "b", "c"]), None);
        assert_eq!(rgb_of(["gray"]), Some([0; 3]));
    }

    #[test]
    fn unknown_keys_and_wavelengths_that_contradict_names_are_seen() {
        let text = serde_json::to_value(rig(["red", "green", "blue"])).unwrap();
        for (place, key) in
            [("/views/0/camera", "distortion"), ("/laser", "powers"), ("", "unit"), ("/channels/1", "gain")]
        {
            let mut odd = text.clone();
            odd.pointer_mut(place).unwrap()[key] = serde_json::json!(1);
            let error = serde_json::from_value::<Rig>(odd).unwrap_err().to_string();
            assert!(error.contains(key), "{error}");
        }
        let mut rig: Rig = serde_json::from_value(text).unwrap();
        assert_eq!(rig.doubts(), None);
        rig.channels[0].wavelength_nm = Some(473.0);
        rig.channels[2].wavelength_nm = Some(635.0);
        assert!(rig.doubts().is_some());
        rig.channels[0].name = "blue".into();
        rig.channels[2].name = "red".into();
        assert_eq!(rig.doubts(), None);
    }
}
