//! Values and samples of Mitsuba 3 (the tables in `tests/data` were written by its own `eval`, `pdf` and `sample`) against ours.
//! The models are defined by it where physics leaves a choice, so this is the test that a default or a convention has not slipped.

use glam::Vec3;
use translume_bxdf::*;

/// The coats that the cases need, made once.
struct Coats([Coat; 4]);

impl Coats {
    fn new() -> Self {
        let default = POLYPROPYLENE / AIR;
        Self([
            Coat::new(Distribution::Beckmann, 0.1, default),
            Coat::new(Distribution::Ggx, 0.15, 1.5),
            Coat::new(Distribution::Ggx, 0.05, 1.5),
            Coat::new(Distribution::Beckmann, 0.5, 1.5).with_visible_normals(false),
        ])
    }
}

const COLOUR: Rgb = Rgb::new(0.8, 0.4, 0.1);
const TINT: Rgb = Rgb::new(0.5, 0.6, 0.7);

fn facets(distribution: Distribution, u: f32, v: f32) -> Microfacets {
    Microfacets::new(distribution, u, v)
}

fn all(m: Microfacets) -> Microfacets {
    Microfacets { visible: false, ..m }
}

fn case<'a>(name: &str, coats: &'a Coats) -> Bsdf<'a> {
    use Distribution::{Beckmann, Ggx};
    let gold = |microfacets| RoughConductor { metal: metal_by_name("Au").unwrap(), microfacets };
    let rough_glass = |eta, microfacets| RoughDielectric { eta, microfacets, ..Default::default() };
    let principled = Principled { base_color: COLOUR, ..Default::default() };
    let plastic =
        |i: usize, nonlinear| RoughPlastic { diffuse_reflectance: COLOUR, nonlinear, ..RoughPlastic::new(&coats.0[i]) };
    let diffuse = Diffuse { reflectance: COLOUR };
    match name {
        "diffuse" => diffuse.into(),
        "conductor" => metal_by_name("Au").unwrap().into(),
        "mirror" => Conductor { specular_reflectance: COLOUR, ..metal_by_name("none").unwrap() }.into(),
        "dielectric" => Dielectric::default().into(),
        "dielectric_tint" => Dielectric {
            eta: ior_by_name("water").unwrap() / ior_by_name("diamond").unwrap(),
            specular_reflectance: COLOUR,
            specular_transmittance: TINT,
        }
        .into(),
        "thindielectric" => ThinDielectric { eta: ior_by_name("diamond").unwrap() / AIR, ..Default::default() }.into(),
        "roughconductor_beckmann_0.1" => gold(facets(Beckmann, 0.1, 0.1)).into(),
        "roughconductor_beckmann_0.5" => {
            let mut m = gold(facets(Beckmann, 0.5, 0.5));
            m.metal.specular_reflectance = COLOUR;
            m.into()
        }
        "roughconductor_ggx_0.05" => gold(facets(Ggx, 0.05, 0.05)).into(),
        "roughconductor_ggx_0.3" => gold(facets(Ggx, 0.3, 0.3)).into(),
        "roughconductor_ggx_aniso" => gold(facets(Ggx, 0.4, 0.1)).into(),
        "roughconductor_beckmann_aniso" => gold(facets(Beckmann, 0.1, 0.4)).into(),
        "roughconductor_ggx_all" => gold(all(facets(Ggx, 0.3, 0.3))).into(),
        "roughconductor_beckmann_all" => gold(all(facets(Beckmann, 0.4, 0.2))).into(),
        "roughdielectric_beckmann_0.2" => rough_glass(BK7 / AIR, facets(Beckmann, 0.2, 0.2)).into(),
        "roughdielectric_ggx_0.4" => rough_glass(1.5, facets(Ggx, 0.4, 0.4)).into(),
        "roughdielectric_ggx_inverse" => rough_glass(1.0 / 1.33, facets(Ggx, 0.3, 0.15)).into(),
        "roughdielectric_beckmann_all" => RoughDielectric {
            specular_reflectance: Rgb::new(0.9, 0.8, 0.7),
            specular_transmittance: TINT,
            ..rough_glass(BK7 / AIR, all(facets(Beckmann, 0.3, 0.3)))
        }
        .into(),
        "plastic" => Plastic::new(POLYPROPYLENE / AIR, COLOUR, Rgb::ONE, false).into(),
        "plastic_nonlinear" => Plastic::new(1.9, COLOUR, Rgb::ONE, true).into(),
        "roughplastic_beckmann_0.1" => plastic(0, false).into(),
        "roughplastic_ggx_0.15" => plastic(1, true).into(),
        "roughplastic_ggx_0.05" => plastic(2, true).into(),
        "roughplastic_beckmann_0.5" => RoughPlastic { specular_reflectance: TINT, ..plastic(3, false) }.into(),
        "principled" => principled.into(),
        "principled_metal" => Principled { metallic: 0.7, roughness: 0.3, anisotropic: 0.5, ..principled }.into(),
        "principled_coat" => Principled {
            roughness: 0.6,
            eta: Principled::eta_from_specular(0.3),
            spec_tint: 0.6,
            sheen: 0.8,
            sheen_tint: 0.4,
            clearcoat: 0.9,
            clearcoat_gloss: 0.2,
            flatness: 0.5,
            ..principled
        }
        .into(),
        "principled_glass" => Principled { roughness: 0.4, spec_trans: 1.0, eta: 1.45, ..principled }.into(),
        "principled_mix" => Principled {
            spec_trans: 0.6,
            metallic: 0.3,
            eta: 1.33,
            spec_tint: 0.3,
            anisotropic: 0.4,
            clearcoat: 0.5,
            clearcoat_gloss: 0.1,
            ..principled
        }
        .into(),
        "twosided_roughplastic" => Bsdf::from(plastic(0, false)).two_sided(),
        "mask_diffuse" => Bsdf::from(diffuse).with_opacity(0.3),
        "blend" => {
            Box::new(Blend { weight: 0.25, first: diffuse.into(), second: gold(facets(Ggx, 0.3, 0.3)).into() }).into()
        }
        other => panic!("the table has a case that the test does not know: {other}"),
    }
}

/// (case, mode, numbers) of each row.
fn rows(table: &str) -> impl Iterator<Item = (&str, Mode, Vec<f32>)> {
    table.lines().filter(|l| !l.starts_with('#')).map(|line| {
        let mut words = line.split(' ');
        let name = words.next().unwrap();
        let mode = if words.next() == Some("R") { Mode::Radiance } else { Mode::Importance };
        (name, mode, words.map(|w| w.parse().unwrap()).collect())
    })
}

fn vec(x: &[f32]) -> Vec3 {
    Vec3::from_slice(x)
}

/// Relative agreement, with a floor below which values do not matter.
fn close(a: f32, b: f32) -> bool {
    close_to(a, b, 1e-3)
}

fn close_to(a: f32, b: f32, relative: f32) -> bool {
    (a - b).abs() <= relative * b.abs() + 2e-6
}

#[test]
fn values_and_densities() {
    let coats = Coats::new();
    let (mut count, mut wrong) = (0, Vec::new());
    for (name, mode, x) in rows(include_str!("data/mitsuba.txt")) {
        let (wo, wi, value, pdf) = (vec(&x[0..]), vec(&x[3..]), vec(&x[6..]), x[9]);
        let (f, pdf_w) = case(name, &coats).eval_pdf(wo, wi, mode);
        let f = f * wi.z.abs();
        count += 1;
        // Behind an opaque principled surface Mitsuba states a density for what it never samples; ours is zero there.
        let unsampled = pdf_w == 0.0 && value == Vec3::ZERO && wo.z < 0.0;
        // Rough plastic chooses its lobes by 1 − T, a small difference of a coarse quadrature; it cancels from pictures.
        let pdf_tolerance = if name.contains("roughplastic") { 5e-3 } else { 1e-3 };
        let pdf_fine = close_to(pdf_w, pdf, pdf_tolerance) || unsampled;
        if (0..3).any(|i| !close(f[i], value[i])) || !pdf_fine {
            wrong.push(format!("{name} {mode:?} {wo} {wi}: {f} {pdf_w}, Mitsuba {value} {pdf}"));
        }
    }
    assert!(count > 400, "{count} rows");
    assert!(wrong.is_empty(), "{} of {count}:\n{}", wrong.len(), wrong.join("\n"));
}

#[test]
fn delta_samples() {
    let coats = Coats::new();
    let mut count = 0;
    for (name, mode, x) in rows(include_str!("data/mitsuba_delta.txt")) {
        let (wo, wi, weight, pdf, eta) = (vec(&x[0..]), vec(&x[3..]), vec(&x[6..]), x[9], x[10]);
        let bsdf = case(name, &coats);
        // The lobe's number is not the same in both; find it.
        let sample = [1e-4, 0.999]
            .iter()
            .filter_map(|&u| bsdf.sample(wo, u, glam::Vec2::new(0.3, 0.6), mode))
            .find(|s| s.flags.contains(Flags::DELTA) && s.wi.distance(wi) < 1e-4)
            .unwrap_or_else(|| panic!("{name} {wo}: no sample towards {wi}"));
        let same =
            (0..3).all(|i| close(sample.weight[i], weight[i])) && close(sample.pdf_w, pdf) && close(sample.eta, eta);
        assert!(same, "{name} {mode:?} {wo}: {sample:?}, Mitsuba {weight} {pdf} {eta}");
        count += 1;
    }
    assert!(count > 80, "{count} rows");
}
