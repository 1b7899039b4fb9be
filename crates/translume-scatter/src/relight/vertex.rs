//! The model with a fall-off for each vertex, in the form that is relit: its curves by distance, blended over the lit triangle, times its
//! modulation where the light leaves.

use crate::capture::Texels;
use crate::hierarchical::{AtlasParams, Hierarchical};
use crate::vertex::{Vertex, VertexModel};
use translume_mesh::TriMesh;

/// Steps of a curve's table and the ratio between them; the first is at [`NEAR`] mm.
const STEPS: usize = 128;
const RATIO: f32 = 1.07;
const NEAR: f32 = 0.02;

/// ln R_d at distances NEAR · RATIO^i.
type Table = [[f32; 3]; STEPS];

/// `None` for meshes without area, models without channels, or without any fall-off.
pub fn from_vertex_model(model: &VertexModel, mesh: TriMesh, eta: f64) -> Option<Hierarchical> {
    let channels = model.texture.len();
    if ![1, 3].contains(&channels) || model.vertices.len() != mesh.positions.len() {
        return None;
    }
    let tables: Vec<Option<Table>> = model.vertices.iter().map(|v| table(v, channels)).collect();
    tables.iter().flatten().next()?;
    let transfer = |(corners, weights): ([u32; 3], [f32; 3]), d: f32| {
        let x = ((d / NEAR).max(1.0).ln() / RATIO.ln()).min((STEPS - 1) as f32);
        let (i, t) = ((x as usize).min(STEPS - 2), x - ((x as usize).min(STEPS - 2)) as f32);
        let mut sum = [0.0; 3];
        for (&v, w) in corners.iter().zip(weights) {
            let Some(table) = &tables[v as usize] else { continue };
            (0..3).for_each(|c| sum[c] += w * (table[i][c] + t * (table[i + 1][c] - table[i][c])).exp());
        }
        sum
    };
    let texels = Texels { per_edge: model.texels_per_edge };
    let modulation = |face: u32, uv: [f32; 2]| {
        let texel = texels.index(face, uv);
        [0, 1, 2].map(|c: usize| model.texture[c.min(channels - 1)][texel])
    };
    Hierarchical::from_transfer(mesh, eta, &AtlasParams::default(), transfer, modulation)
}

fn table(vertex: &Vertex, channels: usize) -> Option<Table> {
    vertex.value(1.0, 0)?;
    let at = |i: usize| {
        let d = f64::from(NEAR * RATIO.powi(i as i32));
        [0, 1, 2].map(|c: usize| vertex.value(d, c.min(channels - 1)).map_or(-60.0, |v| v.max(1e-26).ln() as f32))
    };
    Some(std::array::from_fn(at))
}
