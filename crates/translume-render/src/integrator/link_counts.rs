//! What the generalized kernel methods count, for `--json`.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Sums over all steps.
#[derive(Default)]
pub(super) struct LinkCounts {
    pub(super) steps: AtomicU64,
    /// Steps whose light paths were there from another view.
    pub(super) reused: AtomicU64,
    pub(super) light_vertices: AtomicU64,
    pub(super) camera_paths: AtomicU64,
    pub(super) eye_vertices: AtomicU64,
    pub(super) candidates: AtomicU64,
    pub(super) requested: AtomicU64,
    pub(super) unoccluded: AtomicU64,
}

impl LinkCounts {
    /// One more step.
    pub(super) fn add_step(&self, light_vertices: usize) {
        self.steps.fetch_add(1, Relaxed);
        self.light_vertices.fetch_add(light_vertices as u64, Relaxed);
    }

    /// A block of camera paths: their number, that of their vertices, and of links that could be made, were asked for,
    /// and are unoccluded.
    pub(super) fn add_block(&self, [paths, vertices, candidates, requested, unoccluded]: [usize; 5]) {
        self.camera_paths.fetch_add(paths as u64, Relaxed);
        self.eye_vertices.fetch_add(vertices as u64, Relaxed);
        self.candidates.fetch_add(candidates as u64, Relaxed);
        self.requested.fetch_add(requested as u64, Relaxed);
        self.unoccluded.fetch_add(unoccluded as u64, Relaxed);
    }

    /// All of it with names, beside this bandwidth and size of a light vertex.
    pub(super) fn facts(&self, h: f32, bytes: usize) -> Vec<(&'static str, f64)> {
        let of = |c: &AtomicU64| c.load(Relaxed) as f64;
        let eyes = of(&self.eye_vertices).max(1.0);
        let (requested, unoccluded) = (of(&self.requested), of(&self.unoccluded));
        vec![
            ("h", h.into()),
            ("steps", of(&self.steps)),
            ("steps_reused", of(&self.reused)),
            ("light_vertices", of(&self.light_vertices)),
            ("bytes_per_light_vertex", bytes as f64),
            ("camera_paths", of(&self.camera_paths)),
            ("eye_vertices", eyes),
            ("candidates_per_eye_vertex", of(&self.candidates) / eyes),
            ("requested_per_eye_vertex", requested / eyes),
            ("unoccluded_per_eye_vertex", unoccluded / eyes),
            ("unoccluded_per_camera_path", unoccluded / of(&self.camera_paths).max(1.0)),
            ("mean_visibility", unoccluded / requested.max(1.0)),
        ]
    }
}
