//! The hierarchical model of a capture that was computed from a known R_d: relit, it is what the integral over the surface says.

use glam::{DVec3, Vec3};
use std::f64::consts::PI;
use std::path::Path;
use translume_mesh::TriMesh;
use translume_scatter::Params;
use translume_scatter::capture::{Camera, Capture, Channel, Laser, RIG_VERSION, Rig, Surface, View};
use translume_scatter::hierarchical::{
    AtlasParams, Hierarchical, HierarchicalHead, HierarchicalParams, Stage, Told, fit_hierarchical, load_hierarchical,
    save_hierarchical,
};
use translume_scatter::relight::{Light, Part, Relighter, Sight, Sources};
use translume_scatter::vertex::{MeshCapture, fit_uniform};

const PIXELS: usize = 72;
const BANDS: u32 = 12;
const RADIUS: f64 = 10.0;

fn sphere() -> TriMesh {
    let n = BANDS;
    let ring = |j: u32, i: u32| match j {
        0 => 0,
        j if j == n => 1 + (n - 1) * 2 * n,
        j => 1 + (j - 1) * 2 * n + i % (2 * n),
    };
    let place = |j: u32, i: u32| {
        let (theta, phi) = (PI * f64::from(j) / f64::from(n), PI * f64::from(i) / f64::from(n));
        [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()].map(|x| (RADIUS * x) as f32)
    };
    let mut positions = vec![place(0, 0)];
    positions.extend((1..n).flat_map(|j| (0..2 * n).map(move |i| place(j, i))));
    positions.push(place(n, 0));
    let mut indices = Vec::new();
    for (j, i) in (0..n).flat_map(|j| (0..2 * n).map(move |i| (j, i))) {
        let [a, b, c, d] = [ring(j, i), ring(j + 1, i), ring(j + 1, i + 1), ring(j, i + 1)];
        indices.extend([[a, b, c], [a, c, d]].into_iter().filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]));
    }
    TriMesh { positions, indices, ..TriMesh::default() }
}

/// Symmetric, steep near the spot, with stripes.
fn reflectance(a: DVec3, b: DVec3) -> f64 {
    let stripes = |p: DVec3| 1.0 + 0.5 * (p.x * 0.6 + p.z * 0.3).sin();
    let d = a.distance(b);
    stripes(a) * stripes(b) * (0.02 * (-d / 1.2).exp() + 0.0015 * (-d / 6.0).exp())
}

/// Beams from above and around, not from below; four cameras.
fn capture(path: &Path) -> Capture {
    let mesh = sphere();
    let surface = Surface::new(mesh.clone()).unwrap();
    let cameras: Vec<Camera> = (0..4)
        .map(|i| {
            let angle = PI / 2.0 * f64::from(i) + 0.3;
            let eye = [150.0 * angle.cos(), 150.0 * angle.sin(), 60.0];
            Camera::looking_at(eye, [0.0; 3], [0.0, 0.0, 1.0], (PIXELS, PIXELS), 22.0)
        })
        .collect();
    let count = 420;
    let beams: Vec<(DVec3, DVec3)> = (0..count)
        .filter_map(|i| {
            let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(count);
            let (s, phi) = ((1.0 - z * z).sqrt(), 2.399_963 * f64::from(i));
            let direction = DVec3::new(s * phi.cos(), s * phi.sin(), z);
            let place = surface.first((100.0 * direction).as_vec3(), -direction.as_vec3())?;
            (z > -0.4).then_some((100.0 * direction, DVec3::from_array(place.at)))
        })
        .collect();
    let channel = Channel { name: "gray".into(), wavelength_nm: Some(550.0), white_balance: 1.0, noise_floor: 1e-9 };
    let rig = Rig {
        format: "translume capture".into(),
        version: RIG_VERSION.into(),
        units: "mm".into(),
        frames: "frames".into(),
        mesh: "mesh.ply".into(),
        eta: 1.0,
        channels: vec![channel],
        views: cameras.iter().map(|c| View { turntable_deg: 0.0, camera: c.clone() }).collect(),
        laser: Laser {
            origin_mm: [0.0, 0.0, 100.0],
            origins_mm: beams.iter().map(|b| b.0.to_array()).collect(),
            beam_diameter_mm: 1.0,
            power: vec![2.0],
            grid: [beams.len(), 1],
            hits_mm: beams.iter().map(|b| b.1.to_array()).collect(),
        },
        provenance: serde_json::Value::Null,
    };
    let capture = Capture::create(path, rig, mesh).unwrap();
    for (view, camera) in cameras.iter().enumerate() {
        let centre = |i: usize| [(i % PIXELS) as f64 + 0.5, (i / PIXELS) as f64 + 0.5];
        let seen: Vec<Option<DVec3>> =
            (0..PIXELS * PIXELS).map(|i| surface.seen(camera, centre(i)).map(|s| DVec3::from_array(s.0.at))).collect();
        for (position, (_, at)) in beams.iter().enumerate() {
            // Radiance is power · R_d/π.
            let value = |p: &Option<DVec3>| p.map_or(0.0, |p| (2.0 * reflectance(*at, p) / PI) as f32);
            let frame: Vec<f32> = seen.iter().map(value).collect();
            capture.frames.write([view, position, 0], &frame).unwrap();
        }
    }
    capture
}

fn fitted(capture: Capture) -> (Hierarchical, Told) {
    let stage = Stage::new(capture, 4.0, &AtlasParams::default()).unwrap();
    fit_hierarchical(stage, &HierarchicalParams::default(), |_| ()).unwrap()
}

const SIGHT: Sight = Sight {
    eye: [90.0, -60.0, 50.0],
    target: [0.0; 3],
    up: [0.0, 0.0, 1.0],
    fov_deg: 11.0,
    width: 48,
    height: 40,
    samples: 1,
};

/// Relative RMS error of a relit picture against the sum over the texels, and the share of light from `part` alone.
fn error(model: &Hierarchical, light: [f64; 3]) -> (f64, f64) {
    let surface = Surface::new(model.mesh.clone()).unwrap();
    let lights = [Light::Point { position: light, intensity: [1e4; 3] }];
    let power = Sources::new(&lights, Path::new("")).unwrap().shine(&surface, &model.atlas, 1.0);
    let relighter = Relighter::new(model, &surface, &SIGHT).unwrap();
    let [found, local] = [Part::Whole, Part::Local].map(|p| relighter.picture(&power, p));
    let camera = Camera::looking_at(SIGHT.eye, SIGHT.target, SIGHT.up, (SIGHT.width, SIGHT.height), {
        let far = Vec3::from_array(SIGHT.eye.map(|x| x as f32)).length();
        2.0 * f64::from(far) * (SIGHT.fov_deg.to_radians() / 2.0).tan()
    });
    let (mut wrong, mut all, mut near, mut sum) = (0.0, 0.0, 0.0, 0.0);
    for (i, (p, l)) in found.iter().zip(&local).enumerate() {
        let px = [(i % SIGHT.width) as f64 + 0.5, (i / SIGHT.width) as f64 + 0.5];
        let Some((place, _)) = surface.seen(&camera, px) else { continue };
        let at = DVec3::from_array(place.at);
        let lit = model.atlas.texels.iter().zip(&power.texels);
        let truth: f64 = lit.map(|(t, e)| f64::from(e.x) * reflectance(t.at.as_dvec3(), at)).sum::<f64>() / PI;
        wrong += (f64::from(p[0]) - truth).powi(2);
        all += truth.powi(2);
        near += f64::from(l[0]);
        sum += f64::from(p[0]);
    }
    ((wrong / all).sqrt(), near / sum)
}

#[test]
fn a_known_reflectance_comes_back_under_other_light() {
    let folder = tempfile::tempdir().unwrap();
    let (model, told) = fitted(capture(&folder.path().join("capture")));
    let never_lit = told.completion.never_lit as f64 / model.mesh.positions.len() as f64;
    assert!((0.15..0.4).contains(&never_lit) && told.losses.dark == 0, "{told:?}");
    assert!(told.measured_kernels > model.atlas.texels.len() / 10, "{told:?}");
    // From the side, from behind; the wrong split of K and F, or areas in F, would be off by tens of per cent.
    let (side, share) = error(&model, [60.0, 60.0, 60.0]);
    let (back, _) = error(&model, [-70.0, 50.0, 20.0]);
    assert!(side < 0.10 && back < 0.20, "{side} {back}");
    assert!((0.1..0.9).contains(&share), "{share}");

    // The same from its file.
    let path = folder.path().join("model");
    let head = HierarchicalHead::new(&model, &told, "test".into(), 4.0);
    save_hierarchical(&path, &head, &model).unwrap();
    let (again, loaded) = load_hierarchical(&path).unwrap();
    assert_eq!(again, head);
    assert!(loaded.throughput == model.throughput && loaded.kernels == model.kernels);
    assert!(loaded.atlas.texels == model.atlas.texels && loaded.kernel_confidence == model.kernel_confidence);
    // It may be written again, but not over something else.
    save_hierarchical(&path, &head, &model).unwrap();
    let other = folder.path().join("other");
    std::fs::create_dir(&other).unwrap();
    std::fs::write(other.join("mine.txt"), "keep").unwrap();
    assert!(save_hierarchical(&other, &head, &model).is_err() && other.join("mine.txt").exists());
    damaged(&path);
}

/// Every damage is an error that names a file, and none a panic.
fn damaged(path: &Path) {
    for file in
        ["throughput/c/0/0/0", "kernels/c/0/0/0/0", "atlas/c/0/0/0", "mesh.ply", "modulation/zarr.json", "model.json"]
    {
        let file = path.join(file);
        let bytes = std::fs::read(&file).unwrap();
        std::fs::write(&file, &bytes[..bytes.len() / 2]).unwrap();
        let error = load_hierarchical(path).unwrap_err().to_string();
        assert!(error.contains(&*path.to_string_lossy()), "{error}");
        std::fs::remove_file(&file).unwrap();
        assert!(load_hierarchical(path).is_err(), "{}", file.display());
        std::fs::write(&file, bytes).unwrap();
    }
    load_hierarchical(path).unwrap();
}

#[test]
fn dark_clipped_and_missing_frames_are_counted_and_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("capture");
    let whole = capture(&path);
    let black = vec![0.0; PIXELS * PIXELS];
    (0..4).for_each(|view| whole.frames.write([view, 20, 0], &black).unwrap());
    for view in 0..4 {
        let frame = whole.frames.read(view, 30, 0).unwrap().unwrap();
        let most = frame.iter().copied().fold(0.0, f32::max);
        let clipped: Vec<f32> = frame.iter().map(|v| v.min(0.3 * most)).collect();
        whole.frames.write([view, 30, 0], &clipped).unwrap();
        std::fs::remove_file(path.join(format!("frames/c/{view}/40/0/0/0"))).unwrap();
    }
    let (model, told) = fitted(Capture::open(&path).unwrap());
    assert_eq!((told.losses.dark, told.losses.missing), (1, 1), "{told:?}");
    assert!((1..=4).contains(&told.losses.clipped), "{told:?}");
    assert!(error(&model, [60.0, 60.0, 60.0]).0 < 0.12);
}

#[test]
fn one_fall_off_and_the_stripes_of_an_object_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let capture = MeshCapture::new(capture(&folder.path().join("capture")), 4.0).unwrap();
    let model = fit_uniform(&capture, &Params { terms: 2, eta: 1.0, ..Params::default() }, || ()).unwrap();
    // What is left is that the stripes where light goes in are not in the model: (0.35/2)² of the light.
    assert!(model.held_out_error < 0.05, "{}", model.held_out_error);
    let mut both = Vec::new();
    for (face, corners) in capture.surface.mesh.indices.iter().enumerate() {
        let [a, b, c] = corners.map(|i| Vec3::from(capture.surface.mesh.positions[i as usize]));
        let at = ((a + b + c) / 3.0).as_dvec3();
        if at.z > -2.0 {
            let albedo = f64::from(model.albedo(face as u32, [1.0 / 3.0; 2])[1]);
            both.push(((1.0 + 0.5 * (at.x * 0.6 + at.z * 0.3).sin()).ln(), albedo.ln()));
        }
    }
    let n = both.len() as f64;
    let mean = both.iter().fold((0.0, 0.0), |m, b| (m.0 + b.0 / n, m.1 + b.1 / n));
    let slope = both.iter().map(|b| (b.0 - mean.0) * (b.1 - mean.1)).sum::<f64>()
        / both.iter().map(|b| (b.0 - mean.0).powi(2)).sum::<f64>();
    // The stripes show, drawn towards 1 where no spot is near; without any, or in other places, the slope would be about 0.
    assert!((0.5..2.1).contains(&slope), "{slope}");
}
