//! `translume hdr` on real captures, found through `TRANSLUME_DATA`; skipped without.

mod common;

use common::translume;
use serde_json::Value;
use std::path::{Path, PathBuf};
use tempfile::tempdir;
use translume_image::{metrics, read_picture};

fn capture(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("TRANSLUME_DATA").map(|d| PathBuf::from(d).join("captures").join(name));
    let found = folder.filter(|f| f.is_dir());
    if found.is_none() {
        eprintln!("skipped: {name} is not there (TRANSLUME_DATA)");
    }
    found
}

fn merge(folder: &Path, out: &Path, more: &[&str]) -> Value {
    let (folder, out) = (folder.to_str().unwrap(), out.to_str().unwrap());
    let arguments = [&["hdr", folder, "-o", out, "--json"], more].concat();
    serde_json::from_str(&translume(Path::new("."), &arguments).ok()).unwrap()
}

#[test]
fn hand_held_brackets_are_aligned_and_people_left_out() {
    for name in ["hdr-handheld-venice", "hdr-ghost-hall"] {
        let Some(folder) = capture(name) else { continue };
        let dir = tempdir().unwrap();
        let out = dir.path().join("out.exr");
        let json = merge(&folder, &out, &[]);
        // Colours of a wide profile may be negative in Rec. 709, but only just.
        assert!(read_picture(&out).unwrap().pixels.iter().all(|v| v.is_finite() && *v > -0.01));
        let images = json["images"].as_array().unwrap();
        assert_eq!(images.len(), 3);
        let most = |key: &str| images.iter().map(|i| i[key].as_f64().unwrap()).fold(0.0, f64::max);
        assert!((0.1..60.0).contains(&most("displacement_p95_px")), "{name}: {json}");
        assert!((0.005..0.3).contains(&most("ghost_share")), "{name}: {json}");
    }
}

/// The published merge of Debevec and Malik's church, which has a response of its own: channels are scaled apart.
#[test]
fn the_memorial_church_comes_near_the_published_merge() {
    let Some(folder) = capture("hdr-memorial") else { return };
    let dir = tempdir().unwrap();
    let out = dir.path().join("out.exr");
    merge(&folder, &out, &["--list", folder.join("exposures.csv").to_str().unwrap()]);
    let inner = |path: &Path| -> Vec<f32> {
        let pixels = read_picture(path).unwrap().pixels;
        assert_eq!(pixels.dimensions(), (512, 768));
        // The scans have a border at the sides.
        pixels.chunks_exact(3 * 512).skip(40).take(668).flat_map(|row| &row[60..3 * 492]).copied().collect()
    };
    let (published, mut ours) = (inner(&folder.join("memorial.hdr")), inner(&out));
    for c in 0..3 {
        let mut ratios: Vec<f32> =
            published.iter().zip(&ours).skip(c).step_by(3).filter(|(_, o)| **o > 0.0).map(|(p, o)| p / o).collect();
        let mid = ratios.len() / 2;
        let scale = *ratios.select_nth_unstable_by(mid, f32::total_cmp).1;
        ours.iter_mut().skip(c).step_by(3).for_each(|v| *v *= scale);
    }
    let db = metrics::psnr_mu(&published, &ours, metrics::top_percentile(&published));
    assert!(db > 36.0, "{db} dB");
}
