//! Size on disk, and pictures a second with a light that moves.

use crate::row;
use crate::shape::{bumpy, reflectance};
use glam::Vec3;
use std::path::Path;
use std::time::Instant;
use translume_scatter::capture::Surface;
use translume_scatter::hierarchical::{
    AtlasParams, HIERARCHICAL_FORMAT, HIERARCHICAL_VERSION, Hierarchical, HierarchicalHead, Throughput,
    load_hierarchical, save_hierarchical,
};
use translume_scatter::relight::{Light, Part, Relighter, Sight, Sources};

const FRAMES: usize = 60;

pub(crate) fn run() -> anyhow::Result<()> {
    let mesh = bumpy(67);
    let at: Vec<Vec3> = mesh.positions.iter().map(|&p| p.into()).collect();
    // As many kernels as the paper's models have.
    let params = AtlasParams { per_edge: 5.2, ..AtlasParams::default() };
    // Kernels by distance alone; F with the heterogeneity.
    let mut model = Hierarchical::from_transfer(
        mesh,
        1.3,
        &params,
        |_, d| reflectance(Vec3::ZERO, Vec3::new(d, 0.0, 0.0)),
        |_, _| [1.0; 3],
    )
    .expect("it has an area");
    model.throughput = Throughput::from_function(at.len(), |a, b| reflectance(at[a], at[b]));
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("model");
    let begin = Instant::now();
    save_hierarchical(&path, &head(&model), &model)?;
    let saved = begin.elapsed().as_secs_f64();
    let begin = Instant::now();
    drop(model);
    let (_, model) = load_hierarchical(&path)?;
    let loaded = begin.elapsed().as_secs_f64();
    row(
        "vertices, kernels, side of the atlas",
        format!("{}, {}, {}", at.len(), model.atlas.texels.len(), model.atlas.side),
    );
    row(
        "model on disk",
        format!("{:.0} MB (written in {saved:.1} s, read in {loaded:.1} s)", bytes(&path)? as f64 / 1e6),
    );
    relight(&model)?;
    row("peak memory so far", format!("{:?} MB", crate::peak_mb()));
    Ok(())
}

fn head(model: &Hierarchical) -> HierarchicalHead {
    HierarchicalHead {
        format: HIERARCHICAL_FORMAT.into(),
        version: HIERARCHICAL_VERSION.into(),
        command: "bench-scatter".into(),
        threshold: 0.0,
        eta: model.eta,
        side: model.atlas.side,
        texel_mm: model.atlas.texel_mm,
        texels: model.atlas.texels.len(),
        kernel_error: None,
        measured_kernels: 0,
        never_lit: 0,
        never_seen: 0,
        measured: 1.0,
    }
}

fn bytes(path: &Path) -> anyhow::Result<u64> {
    let mut sum = 0;
    for entry in std::fs::read_dir(path)? {
        let entry = entry?;
        sum += if entry.file_type()?.is_dir() { bytes(&entry.path())? } else { entry.metadata()?.len() };
    }
    Ok(sum)
}

/// 512 × 384, one sample a pixel, the view fixed, shadows on, no file written.
fn relight(model: &Hierarchical) -> anyhow::Result<()> {
    let surface = Surface::new(model.mesh.clone()).expect("small enough");
    let sight = Sight {
        eye: [0.0, -260.0, 80.0],
        target: [0.0; 3],
        up: [0.0, 0.0, 1.0],
        fov_deg: 28.0,
        width: 512,
        height: 384,
        samples: 1,
    };
    let relighter = Relighter::new(model, &surface, &sight).expect("a view");
    let point = [Light::Point { position: [0.0; 3], intensity: [1e5; 3] }];
    let mut sources = Sources::new(&point, Path::new(""))?;
    let (mut spent, cpu) = ([0.0; 2], crate::cpu_seconds());
    let mut sum = 0.0;
    for frame in 0..FRAMES {
        let angle = std::f32::consts::TAU * frame as f32 / FRAMES as f32;
        sources.move_first(Vec3::new(150.0 * angle.cos(), 150.0 * angle.sin(), 60.0));
        let begin = Instant::now();
        let power = sources.shine(&surface, &model.atlas, model.eta as f32);
        spent[0] += begin.elapsed().as_secs_f64();
        let begin = Instant::now();
        let picture = relighter.picture(&power, Part::Whole);
        spent[1] += begin.elapsed().as_secs_f64();
        sum += picture[picture.len() / 2 + 256][1];
    }
    assert!(sum > 0.0, "a black picture is no bench");
    let frames = FRAMES as f64;
    row(
        "relighting at 512 × 384",
        format!(
            "{:.1} pictures/s (light and shadows {:.1} ms, F, K, T and picture {:.1} ms; {:.1} ms of processor time in all)",
            frames / (spent[0] + spent[1]),
            1e3 * spent[0] / frames,
            1e3 * spent[1] / frames,
            1e3 * (crate::cpu_seconds() - cpu) / frames
        ),
    );
    Ok(())
}
