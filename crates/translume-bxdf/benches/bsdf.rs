//! Cost of one sample, and of one evaluation with density, per model. `cargo bench -p translume-bxdf`.

use divan::{Bencher, black_box};
use glam::{Vec2, Vec3};
use std::sync::LazyLock;
use translume_bxdf::*;
use translume_core::{rng::Pcg32, warp};

static COAT: LazyLock<Coat> = LazyLock::new(|| Coat::new(Distribution::Ggx, 0.1, 1.5));

static SHEET_COAT: LazyLock<SheetCoat> = LazyLock::new(|| SheetCoat::new(1.5));

const NAMES: [&str; 10] = [
    "diffuse",
    "metal-ggx",
    "metal-beckmann",
    "glass",
    "rough-glass-ggx",
    "rough-glass-beckmann",
    "plastic",
    "rough-plastic",
    "principled",
    "coated-sheet",
];

fn model(name: &str) -> Bsdf<'static> {
    let facets = |name: &str| {
        let d = if name.ends_with("ggx") { Distribution::Ggx } else { Distribution::Beckmann };
        Microfacets::new(d, 0.2, 0.2)
    };
    match name {
        "diffuse" => Bsdf::from(Diffuse::default()).two_sided(),
        "glass" => Dielectric::default().into(),
        "plastic" => Bsdf::from(Plastic::default()).two_sided(),
        "rough-plastic" => Bsdf::from(RoughPlastic::new(&COAT)).two_sided(),
        "principled" => Principled { clearcoat: 0.5, ..Default::default() }.into(),
        "coated-sheet" => {
            let sheet = DiffuseSheet::default();
            CoatedSheet { coat: &SHEET_COAT, roughness: 0.4, sheet, metallic: 0.0, metal: Rgb::ZERO }.into()
        }
        _ if name.starts_with("metal") => {
            RoughConductor { microfacets: facets(name), metal: metal_by_name("Au").expect("gold is known") }.into()
        }
        _ => RoughDielectric { microfacets: facets(name), ..Default::default() }.into(),
    }
}

/// A thousand directions and numbers, so that branches are as unpredictable as in a picture.
fn inputs() -> Vec<(Vec3, Vec3, f32, Vec2)> {
    let mut rng = Pcg32::new(1, 1);
    let mut up = || warp::cosine_hemisphere(rng.next_f32(), rng.next_f32());
    let pairs: Vec<_> = (0..1000).map(|_| (up(), up())).collect();
    pairs.into_iter().map(|(a, b)| (a, b, rng.next_f32(), Vec2::new(rng.next_f32(), rng.next_f32()))).collect()
}

#[divan::bench(args = NAMES)]
fn sample_1000(bencher: Bencher, name: &str) {
    let (bsdf, inputs) = (model(name), inputs());
    bencher.counter(divan::counter::ItemsCount::new(inputs.len())).bench(|| {
        inputs
            .iter()
            .filter_map(|&(wo, _, u_lobe, u)| black_box(&bsdf).sample(wo, u_lobe, u, Mode::Radiance))
            .fold(Rgb::ZERO, |sum, s| sum + s.weight)
    });
}

#[divan::bench(args = NAMES)]
fn eval_pdf_1000(bencher: Bencher, name: &str) {
    let (bsdf, inputs) = (model(name), inputs());
    bencher.counter(divan::counter::ItemsCount::new(inputs.len())).bench(|| {
        inputs.iter().fold(Rgb::ZERO, |sum, &(wo, wi, ..)| {
            let (f, pdf) = black_box(&bsdf).eval_pdf(wo, wi, Mode::Radiance);
            sum + f * pdf
        })
    });
}

fn main() {
    eprintln!("a Bsdf is {} bytes", size_of::<Bsdf>());
    divan::main();
}
