//! `translume render --integrator volpath` through the binary, on scenes whose pictures are known.
//!
//! False alarms: single numbers are compared within 4 standard errors (6·10⁻⁵), pictures at a level of 10⁻⁴ after Šidák.
//! Seeds are fixed, so that what passes once goes on passing.

mod common;

use common::translume;
use std::path::Path;
use translume_core::stats::{Estimate, compare_pictures};
use translume_image::read_exr_channels;

/// A camera at `origin` that looks at 0 through an opening of `fov` degrees.
fn camera(origin: &str, fov: f64) -> String {
    format!(
        r#"<sensor type="perspective"><float name="fov" value="{fov}"/>
          <transform name="to_world"><lookat origin="{origin}" target="0, 0, 0" up="0, 1, 0"/></transform>
          <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="16"/>
            <rfilter type="box"/></film></sensor>"#
    )
}

/// Green of every pixel.
fn render(dir: &Path, body: &str, method: &str, samples: u32, seed: u32) -> Vec<Estimate> {
    let integrator = r#"<integrator type="path"><integer name="max_depth" value="-1"/></integrator>"#;
    std::fs::write(dir.join("s.xml"), format!(r#"<scene version="3.0.0">{integrator}{body}</scene>"#)).unwrap();
    let (samples, seed) = (samples.to_string(), seed.to_string());
    let arguments = ["s.xml", "-o", "s.exr", "--integrator", method, "--spp", &samples, "--seed", &seed];
    translume(dir, &[&["render"], &arguments[..], &["--aov", "variance", "--quiet"]].concat()).ok();
    let planes = read_exr_channels(&dir.join("s.exr"), 0).unwrap().planes;
    let plane = |name: &str| planes.iter().find(|p| p.0 == name).unwrap().1.iter().map(|&v| f64::from(v));
    plane("G").zip(plane("Variance.G")).map(|(mean, variance)| Estimate { mean, variance }).collect()
}

/// Mean of the picture and its standard error.
fn mean(pixels: &[Estimate]) -> (f64, f64) {
    let n = pixels.len() as f64;
    (pixels.iter().map(|p| p.mean).sum::<f64>() / n, pixels.iter().map(|p| p.variance).sum::<f64>().sqrt() / n)
}

/// Absorption and scattering per unit of length, mean cosine of scattering, thickness.
type Layer = (f64, f64, f64, f64);

/// Which side of the slab is lit.
#[derive(Clone, Copy)]
enum Lit {
    Front,
    Back,
}

/// Layers of refractive index `eta` under a camera that looks along their normal, under a sky of radiance 1 on one side. By
/// reciprocity the camera sees the reflectance or transmittance of a beam that arrives along the normal.
fn slab(layers: &[Layer], eta: f64, lit: Lit) -> String {
    let square = |z: f64, scale: f64, rest: &str| {
        format!(
            r#"<shape type="rectangle">{rest}<transform name="to_world"><scale value="{scale}"/>
              <translate z="{z}"/></transform></shape>"#
        )
    };
    let clear = r#"<bsdf type="null"/>"#;
    let boundary = match eta {
        1.0 => clear.to_owned(),
        _ => format!(
            r#"<bsdf type="dielectric"><float name="int_ior" value="{eta}"/><float name="ext_ior" value="1"/></bsdf>"#
        ),
    };
    let mut body = String::new();
    let mut z = 0.0;
    for (i, (absorption, scattering, g, thickness)) in layers.iter().enumerate() {
        let (extinction, albedo) = (absorption + scattering, scattering / (absorption + scattering));
        body += &format!(
            r#"<medium type="homogeneous" id="m{i}"><rgb name="sigma_t" value="{extinction}"/>
              <rgb name="albedo" value="{albedo}"/><phase type="hg"><float name="g" value="{g}"/></phase></medium>"#
        );
        let (bsdf, above) = match i {
            0 => (&boundary[..], String::new()),
            _ => (clear, format!(r#"<ref name="exterior" id="m{}"/>"#, i - 1)),
        };
        body += &square(z, 2.0, &format!(r#"{bsdf}{above}<ref name="interior" id="m{i}"/>"#));
        z -= thickness;
    }
    let flip = r#"<boolean name="flip_normals" value="true"/>"#;
    body += &square(z, 2.0, &format!(r#"{boundary}{flip}<ref name="interior" id="m{}"/>"#, layers.len() - 1));
    let black = r#"<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf></bsdf>"#;
    let shade = match lit {
        Lit::Front => z - 1.0,
        Lit::Back => 6.0,
    };
    body + &square(shade, 1000.0, black) + r#"<emitter type="constant"/>"# + &camera("0, 0, 5", 0.01)
}

/// MCML is the reference program for light in layered tissue (Wang, Jacques & Zheng 1995). Its sample run of 10⁶ photons,
/// `sample.mco` of github.com/lhvwang/MCML: specular reflectance 0.0243729, diffuse 0.237544, transmittance 0.0964896.
/// Then what its authors compare it with: van de Hulst 1980 (matched indices), Giovanelli 1955 (semi-infinite, n = 1.5).
#[test]
fn slabs_reflect_and_transmit_as_in_mcml() {
    let layers = [(1.0, 100.0, 0.9, 0.1), (1.0, 10.0, 0.0, 0.1), (2.0, 10.0, 0.7, 0.2)];
    let thin = [(10.0, 90.0, 0.75, 0.02)];
    let dir = tempfile::tempdir().unwrap();
    for (layers, eta, lit, samples, expected, its_error) in [
        (&layers[..], 1.37, Lit::Front, 400, 0.0243729 + 0.237544, 4e-4),
        (&layers, 1.37, Lit::Back, 400, 0.0964896, 3e-4),
        (&thin, 1.0, Lit::Front, 2000, 0.09739, 5e-6),
        (&thin, 1.0, Lit::Back, 2000, 0.66096, 5e-6),
        (&[(10.0, 90.0, 0.0, 4.0)], 1.5, Lit::Front, 2000, 0.2600, 5e-5),
    ] {
        let (mean, error) = mean(&render(dir.path(), &slab(layers, eta, lit), "volpath", samples, 1));
        let error = f64::hypot(error, its_error);
        assert!(error < 3e-3, "{error} would hide a mistake");
        assert!((mean - expected).abs() < 4.0 * error, "{mean} ± {error} instead of {expected}");
    }
}

/// A ball of a medium, `sigma_t` and `albedo` as Mitsuba has them, its boundary and its surroundings.
fn ball(sigma_t: &str, albedo: &str, kind: &str, bsdf: &str) -> String {
    format!(
        r#"<shape type="sphere">{bsdf}<medium type="{kind}" name="interior">{sigma_t}{albedo}
          <phase type="hg"><float name="g" value="0.4"/></phase></medium></shape>"#
    )
}

const NULL: &str = r#"<bsdf type="null"/>"#;
const ROUGH_GLASS: &str = r#"<bsdf type="roughdielectric"><float name="alpha" value="0.3"/></bsdf>"#;

/// A grid of 4 × 4 × 4 numbers in the box from −1 to 1.
fn write_grid(path: &Path) {
    let mut bytes = b"VOL\x03".to_vec();
    bytes.extend([1_i32, 4, 4, 4, 1].iter().flat_map(|v| v.to_le_bytes()));
    let values = (0..64).map(|i| [0.0_f32, 0.6, 0.1, 1.0, 0.3][i % 5]);
    bytes.extend([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0].into_iter().chain(values).flat_map(f32::to_le_bytes));
    std::fs::write(path, bytes).unwrap();
}

const GRID: &str = r#"<volume type="gridvolume" name="sigma_t"><string name="filename" value="grid.vol"/>
    <boolean name="use_grid_bbox" value="true"/></volume><float name="scale" value="8"/>"#;

/// Where nothing is absorbed and light comes from everywhere, nothing can be seen.
#[test]
fn furnaces_are_white() {
    let dir = tempfile::tempdir().unwrap();
    write_grid(&dir.path().join("grid.vol"));
    let albedo = r#"<rgb name="albedo" value="1"/>"#;
    let sky = r#"<emitter type="constant"/>"#;
    for (kind, sigma_t) in [
        ("homogeneous", r#"<rgb name="sigma_t" value="0.1, 1, 0.5"/><float name="scale" value="4"/>"#),
        ("heterogeneous", GRID),
    ] {
        let body = ball(sigma_t, albedo, kind, NULL) + sky + &camera("0, -4, 1", 40.0);
        let pixels = render(dir.path(), &body, "volpath", 256, 2);
        let white = vec![Estimate { mean: 1.0, variance: 0.0 }; pixels.len()];
        compare_pictures(&pixels, &white, 1e-4, 1e-4).unwrap();
        let (mean, error) = mean(&pixels);
        assert!(error < 5e-3 && (mean - 1.0).abs() < 4.0 * error.max(1e-4), "{kind}: {mean} ± {error}");
    }
}

/// A medium that is not there changes nothing: `volpath` gives what `path` gives without it.
#[test]
fn media_of_no_density_are_not_there() {
    let dir = tempfile::tempdir().unwrap();
    let floor = r#"<shape type="rectangle"><transform name="to_world"><scale value="9"/><translate z="-1.2"/></transform></shape>"#;
    let lamp = r#"<shape type="sphere"><point name="center" x="2" y="-1" z="3"/><float name="radius" value="0.5"/>
      <emitter type="area"><rgb name="radiance" value="20"/></emitter></shape>"#;
    let sky = r#"<emitter type="constant"/>"#;
    let nothing = r#"<rgb name="sigma_t" value="0"/>"#;
    for (bsdf, light) in [(NULL, lamp), (ROUGH_GLASS, sky)] {
        let rest = format!("{floor}{light}{}", camera("0, -5, 2", 40.0));
        let with = ball(nothing, "", "homogeneous", bsdf) + &rest;
        let without = format!(r#"<shape type="sphere">{bsdf}</shape>{rest}"#);
        let a = render(dir.path(), &with, "volpath", 256, 3);
        let b = render(dir.path(), &without, "path", 256, 4);
        compare_pictures(&a, &b, 2e-3, 1e-4).unwrap();
        let (a, b) = (mean(&a), mean(&b));
        assert!((a.0 - b.0).abs() < 4.0 * f64::hypot(a.1, b.1), "{a:?} {b:?}");
    }
}
