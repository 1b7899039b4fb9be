//! The model with a fall-off for each vertex under new light: its curves by distance, blended over the lit triangle, times its modulation where
//! the light leaves.

use super::direct::direct_picture;
use super::irradiance::Power;
use super::lights::Sight;
use crate::capture::{Surface, Texels};
use crate::hierarchical::Atlas;
use crate::vertex::{UniformModel, Vertex, VertexModel};

/// Steps of a curve's table and the ratio between them; the first is at [`NEAR`] mm.
const STEPS: usize = 128;
const RATIO: f32 = 1.07;
const NEAR: f32 = 0.02;

/// ln R_d at distances NEAR · RATIO^i.
type Table = [[f32; 3]; STEPS];

/// Linear RGB of a view. `None` for other numbers of channels than one and three, models of another mesh or without any fall-off, and where the
/// view has no direction.
pub fn vertex_picture(
    model: &VertexModel,
    object: (&Surface, &Atlas, f64),
    power: &Power,
    sight: &Sight,
) -> Option<Vec<[f32; 3]>> {
    let channels = model.texture.len();
    if ![1, 3].contains(&channels) || model.vertices.len() != object.0.mesh.positions.len() {
        return None;
    }
    let tables: Vec<Option<Table>> = model.vertices.iter().map(|v| table(v, channels)).collect();
    tables.iter().flatten().next()?;
    let transfer = |(corners, weights): ([u32; 3], [f32; 3]), d: f32| {
        let mut sum = [0.0; 3];
        for (&v, w) in corners.iter().zip(weights) {
            let Some(table) = &tables[v as usize] else { continue };
            let value = looked_up(table, d);
            (0..3).for_each(|c| sum[c] += w * value[c]);
        }
        sum
    };
    let texels = Texels { per_edge: model.texels_per_edge };
    let modulation = |face: u32, uv: [f32; 2]| {
        let texel = texels.index(face, uv);
        [0, 1, 2].map(|c: usize| model.texture[c.min(channels - 1)][texel])
    };
    direct_picture(object, power, sight, transfer, modulation)
}

/// The same for the model with one fall-off.
pub fn uniform_picture(
    model: &UniformModel,
    object: (&Surface, &Atlas, f64),
    power: &Power,
    sight: &Sight,
) -> Option<Vec<[f32; 3]>> {
    let table = tabulated(|d| Some(model.value(d)))?;
    direct_picture(object, power, sight, |_, d| looked_up(&table, d), |face, uv| model.albedo(face, uv))
}

fn looked_up(table: &Table, d: f32) -> [f32; 3] {
    let x = ((d / NEAR).max(1.0).ln() / RATIO.ln()).min((STEPS - 1) as f32);
    let i = (x as usize).min(STEPS - 2);
    let t = x - i as f32;
    [0, 1, 2].map(|c| (table[i][c] + t * (table[i + 1][c] - table[i][c])).exp())
}

fn table(vertex: &Vertex, channels: usize) -> Option<Table> {
    tabulated(|d| {
        let channel = |c: usize| vertex.value(d, c.min(channels - 1)).map(|v| v as f32);
        Some([channel(0)?, channel(1)?, channel(2)?])
    })
}

/// `None` if `value` has none anywhere.
fn tabulated(value: impl Fn(f64) -> Option<[f32; 3]>) -> Option<Table> {
    let mut table = [[0.0; 3]; STEPS];
    for (i, entry) in table.iter_mut().enumerate() {
        *entry = value(f64::from(NEAR * RATIO.powi(i as i32)))?.map(|v| v.max(1e-26).ln());
    }
    Some(table)
}
