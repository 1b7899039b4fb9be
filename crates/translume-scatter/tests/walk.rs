//! The random walk against tables, closed forms and other models.

use translume_scatter::simulate::{Exit, Importance, Interface, Local, Medium, Procedural, Slab, TOP, pencil_beam};
use translume_scatter::{Dipole, DipoleKind};

fn local(sigma_a: f32, sigma_s: f32, g: f32) -> Local {
    Local { sigma_s, sigma_a: [sigma_a; 3], g }
}

/// Sums of weights: [top, bottom], and their squares.
#[derive(Clone, Default)]
struct Totals([f64; 2]);

/// From thickness in mm, index of refraction and whether it is rough.
fn slab_of((thickness_mm, eta, rough): (f64, f64, bool)) -> (Slab, Interface) {
    (Slab { thickness_mm }, Interface::new(eta, rough))
}

/// Reflectance and transmittance, in the first channel.
fn totals(medium: &Medium, walls: (f64, f64, bool), photons: usize) -> [f64; 2] {
    let (slab, interface) = slab_of(walls);
    let add = |t: &mut Totals, e: Exit| t.0[usize::from(e.wall.face != TOP)] += e.weight[0];
    let merge = |a: Totals, b: Totals| Totals([a.0[0] + b.0[0], a.0[1] + b.0[1]]);
    let world = (&slab, medium, &interface, &Importance::flat());
    let sum = pencil_beam(world, (photons, 7), Totals::default, add, merge);
    sum.0.map(|s| s / photons as f64)
}

#[test]
fn slabs_have_the_published_totals() {
    // Values of MCML's paper; weights lie in [0, 1], so five standard errors are below 2.5/√n: false alarms < 1e-6.
    let n = 40_000;
    let tolerance = 2.5 / f64::from(n as u32).sqrt();
    // van de Hulst 1980: matched, μa 1/mm, μs 9/mm, g 0.75, 0.2 mm.
    let slab = (0.2, 1.0, false);
    let [r, t] = totals(&Medium::homogeneous(local(1.0, 9.0, 0.75)), slab, n);
    assert!((r - 0.09739).abs() < tolerance && (t - 0.66096).abs() < tolerance, "{r} {t}");
    // Giovanelli 1955: half-space, index 1.5, isotropic; 0.04 of the total is specular and not recorded here.
    let slab = (f64::INFINITY, 1.5, false);
    let [r, _] = totals(&Medium::homogeneous(local(1.0, 9.0, 0.0)), slab, n);
    assert!((r + 0.04 - 0.2600).abs() < tolerance, "{r}");
}

#[test]
fn energy_is_conserved_without_absorption() {
    // All that enters comes out, photon by photon, but for the games of roulette.
    for rough in [false, true] {
        let slab = (2.0, 1.4, rough);
        let [r, t] = totals(&Medium::homogeneous(local(0.0, 2.0, 0.3)), slab, 20_000);
        let entered = 1.0 - (0.4f64 / 2.4).powi(2);
        assert!((r + t - entered).abs() < 0.01, "{rough}: {r} + {t}, entered {entered}");
    }
}

#[test]
fn diffuse_reflectance_of_dipoles_is_near_the_truth() {
    // Normal incidence, index 1.3: R_d without the loss at entry. The better dipole counts multiple scattering only.
    let slab = (f64::INFINITY, 1.3, false);
    for (s, a) in [(2.0, 0.004), (2.0, 0.05)] {
        let [r, _] = totals(&Medium::homogeneous(local(a, s, 0.0)), slab, 20_000);
        let truth = r / (1.0 - (0.3f64 / 2.3).powi(2));
        for kind in [DipoleKind::Dipole, DipoleKind::BetterDipole] {
            let (s, a) = (f64::from(s), f64::from(a));
            let total = Dipole { kind, sigma_s_prime: s, sigma_a: a, eta: 1.3, scale: 1.0 }.total();
            assert!((total / truth - 1.0).abs() < 0.12, "{kind:?} {s} {a}: {total} {truth}");
        }
    }
}

/// Radial profile of exits through the top, per mm².
fn profile(medium: &Medium, walls: (f64, f64, bool), photons: usize, bins: usize, width: f64) -> Vec<f64> {
    windowed(medium, (walls, &Importance::flat()), (photons, 3), (bins, width))
}

/// The same with a choice of effort.
fn windowed(
    medium: &Medium,
    (walls, importance): ((f64, f64, bool), &Importance),
    (photons, seed): (usize, u64),
    (bins, width): (usize, f64),
) -> Vec<f64> {
    let (slab, interface) = slab_of(walls);
    let empty = || vec![0.0; bins];
    let add = |t: &mut Vec<f64>, e: Exit| {
        let i = (e.wall.at[0].hypot(e.wall.at[1]) / width) as usize;
        if e.wall.face == TOP && i < bins {
            t[i] += e.weight[0];
        }
    };
    let merge = |mut a: Vec<f64>, b: Vec<f64>| {
        a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        a
    };
    let world = (&slab, medium, &interface, importance);
    let sums = pencil_beam(world, (photons, seed), empty, add, merge);
    let area = |i: usize| std::f64::consts::PI * width * width * (2 * i + 1) as f64;
    sums.into_iter().enumerate().map(|(i, s)| s / (photons as f64 * area(i))).collect()
}

#[test]
fn far_fall_off_is_the_dipoles() {
    // Beyond some mean free paths the slope of ln R_d is that of diffusion theory.
    let slab = (f64::INFINITY, 1.3, false);
    let found = profile(&Medium::homogeneous(local(0.1, 2.0, 0.0)), slab, 150_000, 8, 1.0);
    let dipole = Dipole { kind: DipoleKind::Dipole, sigma_s_prime: 2.0, sigma_a: 0.1, eta: 1.3, scale: 1.0 };
    let sources = dipole.sources();
    let truth = |i: usize| {
        let (low, high) = (i as f64, i as f64 + 1.0);
        let n = 50;
        let ring = |k: usize| low + (high - low) * (k as f64 + 0.5) / n as f64;
        (0..n).map(|k| sources.value(ring(k)) * ring(k)).sum::<f64>() / (0..n).map(ring).sum::<f64>()
    };
    for i in [2, 3, 4] {
        let ratio = found[i] / truth(i);
        assert!((ratio - 1.0).abs() < 0.2, "{i}: {ratio}");
    }
}

#[test]
fn importance_changes_the_noise_and_not_the_mean() {
    let medium = Medium::homogeneous(local(0.1, 2.0, 0.0));
    let slab = (8.0, 1.3, false);
    let steps = |i: i32| (-1.1 * f64::from(i) * Importance::STEP_MM).exp().max(1e-6);
    let split = Importance::new((0..60).map(steps).collect());
    // Eight runs of each, so that their noise is known; twelve rings, false alarms below 1e-4.
    let runs = |importance: &Importance, photons: usize| -> Vec<[f64; 2]> {
        let all: Vec<Vec<f64>> =
            (0..8).map(|k| windowed(&medium, (slab, importance), (photons, k), (12, 1.0))).collect();
        (0..12)
            .map(|i| {
                let mean = all.iter().map(|r| r[i]).sum::<f64>() / 8.0;
                let variance = all.iter().map(|r| (r[i] - mean).powi(2)).sum::<f64>() / 7.0;
                [mean, variance / 8.0]
            })
            .collect()
    };
    let (plain, windows) = (runs(&Importance::flat(), 30_000), runs(&split, 1_000));
    for i in 0..12 {
        let [[a, va], [b, vb]] = [plain[i], windows[i]];
        // Student's t with some ten degrees of freedom.
        assert!((a - b).abs() < 6.5 * (va + vb).sqrt(), "ring {i}: {a} {b} ± {}", (va + vb).sqrt());
    }
    let noise = |r: &[f64; 2]| r[1].sqrt() / r[0];
    assert!(noise(&windows[9]) < noise(&plain[9]), "{} {}", noise(&windows[9]), noise(&plain[9]));
}

/// The numbers of a block of MCML's output that begins with `name`.
fn block(text: &str, name: &str) -> Vec<f64> {
    let lines = text.lines().skip_while(|l| !l.starts_with(&format!("{name} #"))).skip(1);
    lines.map_while(|l| l.split_whitespace().next()?.parse().ok()).collect()
}

#[test]
fn layered_tissue_is_mcmls() {
    let Some(data) = std::env::var_os("TRANSLUME_DATA") else {
        eprintln!("skipped: TRANSLUME_DATA is not set");
        return;
    };
    let file = std::path::Path::new(&data).join("captures/sss-mcml-reference/sample.mco");
    let text = std::fs::read_to_string(file).unwrap();
    let (totals_table, rings) = (block(&text, "RAT"), block(&text, "Rd_r"));
    // Three layers of 1, 1 and 2 mm, per mm.
    let [a, b, c] = [local(0.1, 10.0, 0.9), local(0.1, 1.0, 0.0), local(0.2, 1.0, 0.7)];
    let medium = Medium::layers(1.0, &[a, b, c, c]);
    let slab = (4.0, 1.37, false);
    let n = 100_000;
    let [r, t] = totals(&medium, slab, n);
    // Five standard errors at most, see above.
    let tolerance = 2.5 / (n as f64).sqrt();
    assert!((r - totals_table[1]).abs() < tolerance && (t - totals_table[3]).abs() < tolerance, "{r} {t}");
    // Rings of 0.1 mm, 1/cm²: the table's own noise is a third of ours.
    let found = profile(&medium, slab, n, rings.len(), 0.1);
    for i in 0..30 {
        let expected = rings[i] / 100.0;
        let photons = expected * n as f64 * std::f64::consts::PI * 0.01 * (2 * i + 1) as f64;
        let sigma = expected * (1.2 / photons).sqrt();
        assert!((found[i] - expected).abs() < 5.0 * sigma, "ring {i}: {} {expected} ± {sigma}", found[i]);
    }
}

#[test]
fn media_have_the_coefficients_of_their_description() {
    for medium in [
        Procedural::Marble,
        Procedural::Apple,
        Procedural::Sponge,
        Procedural::Wax,
        Procedural::Stone,
        Procedural::Homogeneous,
    ] {
        let slab = (16.0, 1.4, true);
        let [r, _] = totals(&medium.build(1), slab, 500);
        assert!((0.02..0.98).contains(&r), "{medium:?}: {r}");
    }
}
