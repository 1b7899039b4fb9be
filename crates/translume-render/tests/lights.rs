//! Lights of all kinds: light paths carry the power that the light has, and densities are those of sampling.
//!
//! Means of light paths are compared within 4 standard errors (false alarm 6·10⁻⁵ each; seeds are fixed).

use glam::{Vec2, Vec3};
use std::f64::consts::PI;
use std::fmt::Write as _;
use std::sync::Arc;
use translume_core::rng::Pcg32;
use translume_render::light::End;
use translume_render::{World, luminance};
use translume_scene::LoadOptions;

/// The world of a Mitsuba scene; `sheet.obj` beside it is a square of side 1 of 800 triangles, facing +z.
fn world(body: &str) -> World {
    let folder = tempfile::tempdir().unwrap();
    let n = 20;
    let mut sheet = String::new();
    for i in 0..(n + 1) * (n + 1) {
        let _ = writeln!(sheet, "v {} {} 0", f64::from(i % (n + 1)) / 20.0, f64::from(i / (n + 1)) / 20.0);
    }
    for i in 0..n * n {
        let a = i / n * (n + 1) + i % n + 1;
        let _ = writeln!(sheet, "f {a} {} {}\nf {a} {} {}", a + 1, a + n + 2, a + n + 2, a + n + 1);
    }
    std::fs::write(folder.path().join("sheet.obj"), sheet).unwrap();
    let path = folder.path().join("s.xml");
    std::fs::write(&path, format!("<scene version=\"3.0.0\">{body}</scene>")).unwrap();
    World::new(Arc::new(translume_scene::load(&path, &LoadOptions::default()).unwrap())).unwrap()
}

fn place(scale: f64, x: f64) -> String {
    format!(
        r#"<transform name="to_world"><scale value="{scale}"/><rotate x="1" angle="30"/><translate x="{x}"/></transform>"#
    )
}

const GLOW: &str = r#"<emitter type="area"><rgb name="radiance" value="2"/></emitter>"#;

/// A mesh that stands in two places, twice and three times as large as it is.
fn sheets() -> String {
    let sheet = |scale, x| {
        format!(r#"<shape type="obj"><string name="filename" value="sheet.obj"/>{GLOW}{}</shape>"#, place(scale, x))
    };
    sheet(2.0, 0.0) + &sheet(3.0, 5.0)
}

#[test]
fn light_paths_carry_the_power() {
    let ball = r#"<shape type="sphere"/>"#;
    let spot = r#"<emitter type="spot"><rgb name="intensity" value="3"/><float name="cutoff_angle" value="60"/>
        <float name="beam_width" value="60"/></emitter>"#;
    // Bodies, and the power by the scene's bounding radius.
    type Case = (String, fn(f64) -> f64);
    let cases: [Case; 9] = [
        (format!(r#"<shape type="rectangle">{GLOW}</shape>"#), |_| 2.0 * PI * 4.0),
        (format!(r#"<shape type="sphere"><float name="radius" value="2"/>{GLOW}</shape>"#), |_| 2.0 * PI * 16.0 * PI),
        (format!(r#"<shape type="disk">{GLOW}{}</shape>"#, place(3.0, 1.0)), |_| 2.0 * PI * 9.0 * PI),
        (format!(r#"<shape type="cylinder"><float name="radius" value="0.5"/>{GLOW}</shape>"#), |_| 2.0 * PI * PI),
        (sheets(), |_| 2.0 * PI * 13.0),
        (format!(r#"{ball}<emitter type="point"><rgb name="intensity" value="3"/></emitter>"#), |_| 3.0 * 4.0 * PI),
        (format!("{ball}{spot}"), |_| 3.0 * PI),
        (format!(r#"{ball}<emitter type="directional"><rgb name="irradiance" value="5"/></emitter>"#), |r| {
            5.0 * PI * r * r
        }),
        (format!(r#"{ball}<emitter type="constant"/>"#), |r| 4.0 * PI * PI * r * r),
    ];
    for (body, power) in cases {
        let world = world(&body);
        let expected = power(world.bounding_sphere().1.into());
        let mut rng = Pcg32::new(1, 2);
        let (n, mut sum, mut squares) = (20_000, 0.0, 0.0);
        for _ in 0..n {
            let mut pair = || Vec2::new(rng.next_f32(), rng.next_f32());
            let (u, v) = (pair(), pair());
            let Some(start) = world.lights().start(world.scene(), world.lights().by_power(), rng.next_f32(), u, v)
            else {
                continue;
            };
            let cos = if matches!(start.origin, End::Surface(_)) { start.n.dot(start.direction) } else { 1.0 };
            let x = f64::from(luminance(start.radiance) * cos / (start.choice * start.pdf_a * start.pdf_w));
            (sum, squares) = (sum + x, squares + x * x);
        }
        let mean = sum / f64::from(n);
        let error = ((squares / f64::from(n) - mean * mean).max(0.0) / f64::from(n)).sqrt() + 1e-4 * expected;
        assert!((mean - expected).abs() < 4.0 * error, "{body}: {mean} ± {error} instead of {expected}");
    }
}

/// A ray that follows a sample meets the light that was sampled, and is told the density it was sampled with.
#[test]
fn what_was_sampled_is_found_with_its_density() {
    let one = format!(r#"<shape type="rectangle">{GLOW}{}</shape>"#, place(1.5, -4.0));
    let world = world(&format!("{}{one}", sheets()));
    assert_eq!(world.lights().len(), 2 + 2, "a light a place of the sheet, and a light a triangle of the rectangle");
    let mut rng = Pcg32::new(3, 4);
    let mut seen = [0; 4];
    for _ in 0..2000 {
        let mut number = || rng.next_f32();
        let p = Vec3::new(10.0 * number() - 4.0, 4.0 * number() - 4.0, 4.0 + 4.0 * number());
        let u = Vec2::new(number(), number());
        let Some(sample) = world.lights().sample(world.scene(), p, Vec3::ZERO, number(), u) else { continue };
        let Some(hit) = world.intersect(&translume_trace::Ray::new(p, sample.wi)) else { continue };
        let Some((radiance, light)) = world.emission(&hit) else { continue };
        let End::Surface(end) = sample.end else { panic!("these lights are surfaces") };
        if (end.p - hit.point.p).length() > 1e-4 {
            continue; // another light stands before it
        }
        seen[light] += 1;
        assert!((radiance - sample.radiance).abs().max_element() < 1e-6);
        let pdf_w = world.lights().pdf_surface(p, Vec3::ZERO, light, hit.point.p, hit.n());
        assert!((pdf_w / sample.pdf_w - 1.0).abs() < 1e-2, "{light}: {pdf_w} {}", sample.pdf_w);
    }
    assert!(seen.iter().all(|&n| n > 20), "{seen:?}");
}
