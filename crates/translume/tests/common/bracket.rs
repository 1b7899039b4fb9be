//! Small brackets with a known truth, as files.

use std::path::Path;
use translume_core::rng::Pcg32;
use translume_hdr::simulate::{Camera, Pose};
use translume_image::{
    Codes, ExrOptions, Picture, Precision, Rgb32FImage, Samples, write_exr, write_png8, write_png16,
};

/// Seconds of the usual three shots.
pub(crate) const SECS: [f64; 3] = [1.0 / 60.0, 1.0 / 15.0, 1.0 / 4.0];
/// The same as an option.
pub(crate) const EXPOSURES: &str = "--exposures=1/60,1/15,1/4";
/// How the hand moved between them; the second is the anchor.
pub(crate) const POSES: [Pose; 3] = [
    Pose { rotation_rad: 0.02, shift_px: [4.5, -3.25] },
    Pose { rotation_rad: 0.0, shift_px: [0.0, 0.0] },
    Pose { rotation_rad: -0.015, shift_px: [-5.75, 2.5] },
];

/// A textured scene of five decades: patches and grain at several scales, brighter to the right.
pub(crate) fn scene() -> Rgb32FImage {
    let (w, h) = (280u32, 216u32);
    let mut rng = Pcg32::new(11, 0);
    let mut light = vec![0.0f32; (w * h) as usize];
    for cell in [3u32, 7, 16, 40] {
        let columns = w / cell + 1;
        let levels: Vec<f32> = (0..columns * (h / cell + 1)).map(|_| rng.next_f32() - 0.5).collect();
        for y in 0..h {
            for x in 0..w {
                light[(y * w + x) as usize] += 0.9 * levels[(y / cell * columns + x / cell) as usize];
            }
        }
    }
    let mut scene = Rgb32FImage::new(w, h);
    for (x, y, p) in scene.enumerate_pixels_mut() {
        let l = (light[(y * w + x) as usize] + 4.5 * x as f32 / w as f32 - 3.5).exp();
        p.0 = [l, 0.9 * l, (0.7 + 0.3 * (y as f32 / 30.0).sin()) * l];
    }
    scene
}

/// A camera for it.
pub(crate) fn camera() -> Camera {
    Camera { size: (240, 176), ..Camera::default() }
}

/// The shots of a bracket.
pub(crate) fn shots(camera: &Camera, poses: &[Pose], secs: &[f64]) -> Vec<Codes> {
    let scene = scene();
    let shot = |(i, (pose, t)): (usize, (&Pose, &f64))| camera.expose(&camera.view(&scene, pose, None), *t, i as u32);
    poses.iter().zip(secs).enumerate().map(shot).collect()
}

/// Writes a shot as its depth demands: PNG, or OpenEXR for linear ones.
pub(crate) fn save(path: &Path, codes: &Codes) {
    let size = (codes.width, codes.height);
    match &codes.samples {
        Samples::U8(v) => write_png8(path, size, v).unwrap(),
        Samples::U16(v) => write_png16(path, size, v).unwrap(),
        Samples::F32(v) => {
            let pixels = Rgb32FImage::from_raw(size.0 as u32, size.1 as u32, v.clone()).unwrap();
            let picture = Picture { metadata: codes.metadata.clone(), ..Picture::new(pixels) };
            let options = ExrOptions { precision: Precision::Float, ..ExrOptions::default() };
            write_exr(path, &picture, &options).unwrap();
        }
    }
}

/// The usual bracket as `a.png`, `b.png`, `c.png` in `dir`.
pub(crate) fn usual(dir: &Path) {
    for (name, codes) in ["a.png", "b.png", "c.png"].iter().zip(shots(&camera(), &POSES, &SECS)) {
        save(&dir.join(name), &codes);
    }
}
