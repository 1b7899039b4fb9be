//! The model and its making, step by step.

use super::atlas::{Atlas, AtlasParams};
use super::complete::{Completion, Solver, complete};
use super::detail::detail;
use super::local::{fitted, near};
use super::pairs::Throughput;
use super::refine::corrected;
use super::resample::resample;
use super::split::{flatten, kernels};
use super::stage::{Losses, Stage};
use glam::Vec3;
use half::f16;
use translume_image::{Error, Result};
use translume_mesh::TriMesh;

/// A hierarchical model of an object.
#[derive(Clone, Debug)]
pub struct Hierarchical {
    /// The surface, one vertex for each position, in mm.
    pub mesh: TriMesh,
    /// Relative index of refraction.
    pub eta: f64,
    /// The texels of K and T.
    pub atlas: Atlas,
    /// F: global light between vertices, in mm⁻².
    pub throughput: Throughput,
    /// K: 49 values for each texel, row by row, in mm⁻²; added to what F and T give.
    pub kernels: Vec<[f16; 3]>,
    /// Share of each kernel that was measured, 0 to 255; 0: from its neighbours.
    pub kernel_confidence: Vec<u8>,
    /// T: factor on the global light of each texel.
    pub detail: Vec<[f32; 3]>,
    /// Weight of the measurements behind T; 0: none, T is 1.
    pub detail_weight: Vec<f32>,
}

/// How to make a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HierarchicalParams {
    /// How F is completed.
    pub solver: Solver,
    /// Rounds in which F is corrected by what it leaves of the measurements; each reads all frames.
    pub rounds: usize,
}

impl Default for HierarchicalParams {
    fn default() -> Self {
        Self { solver: Solver::default(), rounds: 3 }
    }
}

/// Where a fit is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// A laser position was resampled.
    Resampled,
    /// A column of F was completed.
    Completed,
    /// A laser position was used for T.
    Detailed,
}

/// What a fit tells beside the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Told {
    /// What of the capture could not be used.
    pub losses: Losses,
    /// What of F was measured.
    pub completion: Completion,
    /// Texels with a measured kernel.
    pub measured_kernels: usize,
    /// Relative error (RMS) of the light around spots held out, predicted by the kernels of the others.
    pub kernel_error: f64,
}

/// Fits `stage`; `progress` is told of each step.
///
/// # Errors
/// [`Error::Invalid`] where nothing can be measured; those of reading frames.
pub fn fit_hierarchical(
    mut stage: Stage,
    params: &HierarchicalParams,
    progress: impl Fn(Step) + Sync,
) -> Result<(Hierarchical, Told)> {
    let (measured, candidates) = resample(&mut stage, || progress(Step::Resampled))?;
    let nothing = || {
        Error::invalid(&stage.capture.path, "no laser position has pixels above the noise; is the threshold too high?")
    };
    let mesh = (*stage.surface.mesh).clone();
    let (mut throughput, completion) =
        complete(&mesh, measured, params.solver, || progress(Step::Completed)).ok_or_else(nothing)?;
    flatten(&mut throughput, &mesh, &stage.atlas);
    for _ in 0..params.rounds {
        let measured = corrected(&stage, &throughput, || progress(Step::Resampled))?;
        throughput = complete(&mesh, measured, params.solver, || progress(Step::Completed)).ok_or_else(nothing)?.0;
    }
    let (detail, detail_weight) = detail(&stage, &throughput, || progress(Step::Detailed))?;
    let measured_kernels = candidates.measured();
    let no_kernel = || Error::invalid(&stage.capture.path, "no laser spot is seen well enough for a local kernel");
    let near = near(&stage, &mesh, &throughput, &detail)?;
    let (records, kernel_error) = fitted(&stage, &candidates.0, &near).ok_or_else(no_kernel)?;
    let kernels = records.split(&mesh, &stage.atlas, &throughput, &detail);
    let told = Told { losses: stage.losses, completion, measured_kernels, kernel_error };
    let model = Hierarchical {
        mesh,
        eta: stage.capture.rig.eta,
        atlas: stage.atlas,
        throughput,
        kernels,
        kernel_confidence: records.confidence,
        detail,
        detail_weight,
    };
    Ok((model, told))
}

/// Parts of a texel along each side over which steep transfer is averaged.
const PARTS: usize = 4;

/// A place of a mesh: the corners of its triangle and their weights.
pub type Corners = ([u32; 3], [f32; 3]);

impl Hierarchical {
    /// The same form for any other model: `transfer` gives R_d in mm⁻² for light at one place and a distance in mm to another, without
    /// `modulation`, a factor for the place that is seen (triangle, barycentric coordinates of its second and third corner). So all models are
    /// relit by the same code. `None` for meshes without area.
    pub fn from_transfer(
        mesh: TriMesh,
        eta: f64,
        params: &AtlasParams,
        transfer: impl Fn(Corners, f32) -> [f32; 3] + Sync,
        modulation: impl Fn(u32, [f32; 2]) -> [f32; 3],
    ) -> Option<Self> {
        let atlas = Atlas::new(&mesh, params)?;
        let at: Vec<Vec3> = mesh.positions.iter().map(|&p| p.into()).collect();
        let vertex = |k: usize| ([k as u32; 3], [1.0, 0.0, 0.0]);
        // F is symmetric, other models need not be.
        let mut throughput = Throughput::from_function(at.len(), |a, b| {
            let d = at[a].distance(at[b]);
            let (one, other) = (transfer(vertex(a), d), transfer(vertex(b), d));
            [0, 1, 2].map(|c| 0.5 * (one[c] + other[c]))
        });
        flatten(&mut throughput, &mesh, &atlas);
        let detail: Vec<[f32; 3]> = atlas.texels.iter().map(|t| modulation(t.face, t.uv)).collect();
        let near = |t: usize, lit: usize, _: usize, d: f32, c: usize| {
            let texel = &atlas.texels[lit];
            let [u, v] = texel.uv;
            let place = (mesh.indices[texel.face as usize], [1.0 - u - v, u, v]);
            // The mean over a texel as large as this one at that distance.
            let edge = texel.area.sqrt();
            let part = |i: usize| ((i as f32 + 0.5) / PARTS as f32 - 0.5) * edge;
            let along = d * atlas.texel_mm;
            let parts = (0..PARTS * PARTS).map(|k| (along + part(k % PARTS)).hypot(part(k / PARTS)));
            detail[t][c] * parts.map(|r| transfer(place, r)[c]).sum::<f32>() / (PARTS * PARTS) as f32
        };
        let kernels = kernels(&mesh, &atlas, &throughput, &detail, near);
        let texels = atlas.texels.len();
        Some(Self {
            mesh,
            eta,
            atlas,
            throughput,
            kernels,
            kernel_confidence: vec![255; texels],
            detail,
            detail_weight: vec![0.0; texels],
        })
    }
}
