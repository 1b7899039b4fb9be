//! Completion of F: error on measurements kept from it, and time.
//!
//! The object is lit and seen from four sides; its lower quarter is never lit. Measurements have noise of 5 %. Kept back are single entries
//! at random, and whole discs of what a lit vertex sends out.

use crate::row;
use crate::shape::{bumpy, reflectance};
use glam::Vec3;
use std::time::Instant;
use translume_core::rng::Pcg32;
use translume_mesh::TriMesh;
use translume_scatter::hierarchical::{Measured, Solver, Throughput, complete};

/// Pairs kept back and their values.
type Kept = Vec<(usize, usize, [f32; 3])>;

fn measure(mesh: &TriMesh) -> (Measured, [Kept; 2]) {
    let at: Vec<Vec3> = mesh.positions.iter().map(|&p| p.into()).collect();
    let n = at.len();
    let mut rng = Pcg32::new(5, 0);
    let mut measured = Measured::new(n);
    let side = |p: Vec3, angle: f32| p.x * angle.cos() + p.y * angle.sin();
    for lit in 0..n {
        if at[lit].z < -25.0 {
            continue;
        }
        measured.light(lit, 1.0);
        // The stop of the turntable that lights it best, and the two cameras there.
        let stops = (0..4).map(|k| std::f32::consts::FRAC_PI_2 * k as f32);
        let stop = stops.max_by(|a, b| side(at[lit], *a).total_cmp(&side(at[lit], *b))).unwrap_or(0.0);
        for seen in 0..n {
            let visible = [stop - 0.9, stop + 0.9].iter().any(|&c| side(at[seen], c) > 0.15 * at[seen].length());
            if visible && at[seen].z > -42.0 {
                let noise = 1.0 + 0.05 * rng.next_normal() as f32;
                measured.add(lit, seen, reflectance(at[lit], at[seen]).map(|r| r * noise.max(0.1)), 0.7);
            }
        }
    }
    let mut kept = [Vec::new(), Vec::new()];
    for _ in 0..4 * n {
        let (a, b) = ((rng.next_f64() * n as f64) as usize, (rng.next_f64() * n as f64) as usize);
        if let Some(rgb) = measured.withdraw(a, b) {
            kept[0].push((a, b, rgb));
        }
    }
    for _ in 0..n / 4 {
        let (lit, middle) = ((rng.next_f64() * n as f64) as usize, (rng.next_f64() * n as f64) as usize);
        for seen in (0..n).filter(|&s| at[s].distance(at[middle]) < 12.0) {
            if let Some(rgb) = measured.withdraw(lit, seen) {
                kept[1].push((lit, seen, rgb));
            }
        }
    }
    (measured, kept)
}

/// Median of |ln Y| between what was kept back and what was filled in.
fn error(f: &Throughput, kept: &Kept) -> f64 {
    let y = |c: [f32; 3]| f64::from(0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]);
    let mut all: Vec<f64> = kept.iter().map(|&(a, b, rgb)| (y(f.value(a, b)) / y(rgb)).ln().abs()).collect();
    all.sort_by(f64::total_cmp);
    all[all.len() / 2]
}

/// Seconds, seconds of processors, errors.
fn solve(bands: u32, solver: Solver) -> ([f64; 2], [f64; 2]) {
    let mesh = bumpy(bands);
    let (measured, kept) = measure(&mesh);
    let (begin, cpu) = (Instant::now(), crate::cpu_seconds());
    let (f, _) = complete(&mesh, measured, solver, || ()).expect("measured");
    let seconds = [begin.elapsed().as_secs_f64(), crate::cpu_seconds() - cpu];
    (seconds, [error(&f, &kept[0]), error(&f, &kept[1])])
}

/// Beside the paper's relaxation, on a mesh that this can finish.
pub(crate) fn held_out() {
    for (name, solver) in [("multilevel", Solver::default()), ("200 plain rounds", Solver::Plain { rounds: 200 })] {
        let ([seconds, _], [single, discs]) = solve(22, solver);
        row(
            &format!("completion, 926 vertices, {name}: median error of ln Y, single entries / discs"),
            format!("{single:.3} / {discs:.3} ({seconds:.1} s)"),
        );
    }
}

pub(crate) fn large() {
    let ([seconds, cpu], [single, discs]) = solve(67, Solver::default());
    row("completion, 8846 vertices: median error of ln Y, single entries / discs", format!("{single:.3} / {discs:.3}"));
    row("completion, 8846 vertices: time", format!("{seconds:.1} s; {cpu:.1} s of processor time"));
    row("peak memory so far", format!("{:?} MB", crate::peak_mb()));
}
