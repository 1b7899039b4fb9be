//! Vertex normals from faces, weighted by the angle at the vertex (Thürmer and Wüthrich 1998: how a surface is cut into
//! triangles does not matter), with or without a crease angle.

use crate::mesh::TriMesh;
use glam::{DVec3, Vec3};
use std::collections::HashMap;

/// Around a vertex of more faces than this all of them are averaged: comparing every pair would take quadratic time.
const MOST_COMPARED: usize = 512;

impl TriMesh {
    /// Sets each vertex normal to the mean of the faces that use the vertex, weighted by their angles there. Vertices without such a face
    /// get +z.
    pub fn compute_normals(&mut self) {
        let mut sums = vec![DVec3::ZERO; self.positions.len()];
        for face in 0..self.indices.len() {
            let normals = self.corner_normals(face);
            self.indices[face].iter().zip(normals).for_each(|(&i, normal)| sums[i as usize] += normal);
        }
        self.normals = Some(sums.into_iter().map(unit).collect());
    }

    /// Sets normals that are smooth over edges up to `max_angle_rad` and creased at sharper ones, splitting vertices
    /// there. Faces around the same position are compared even across seams.
    pub fn crease_normals(&mut self, max_angle_rad: f32) {
        let (weld, positions) = self.weld();
        let cosine = f64::from(max_angle_rad).cos();
        let corners: Vec<DVec3> = (0..self.indices.len()).flat_map(|f| self.corner_normals(f)).collect();
        let units: Vec<DVec3> = corners.chunks(3).map(|of| of.iter().sum::<DVec3>().normalize_or_zero()).collect();
        let around = Around::new(&self.indices, &weld, positions);
        let mut vertices: Vec<u32> = Vec::new();
        let mut normals: Vec<[f32; 3]> = Vec::new();
        let mut numbers: HashMap<(u32, [u32; 3]), u32> = HashMap::new();
        let mut indices = self.indices.clone();
        for (face, triangle) in indices.iter_mut().enumerate() {
            for i in triangle {
                let here = around.corners(weld[*i as usize]);
                let near = |c: &&usize| {
                    // A face without area has no say and no angle.
                    here.len() > MOST_COMPARED || **c / 3 == face || units[face].dot(units[**c / 3]) >= cosine
                };
                let normal = unit(here.iter().filter(near).map(|&c| corners[c]).sum());
                *i = *numbers.entry((*i, normal.map(f32::to_bits))).or_insert_with(|| {
                    vertices.push(*i);
                    normals.push(normal);
                    vertices.len() as u32 - 1
                });
            }
        }
        self.pick(&vertices);
        self.normals = Some(normals);
        self.indices = indices;
    }

    /// The face's normal at each corner, as long as the angle there in radians; zero for a face without area or with a
    /// corner that is not finite.
    fn corner_normals(&self, face: usize) -> [DVec3; 3] {
        let p = self.corners(face).map(Vec3::as_dvec3);
        let normal = (p[1] - p[0]).cross(p[2] - p[0]).try_normalize().unwrap_or(DVec3::ZERO);
        std::array::from_fn(|k| {
            let (a, b) = (p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]);
            if normal == DVec3::ZERO { normal } else { normal * a.angle_between(b) }
        })
    }
}

fn unit(sum: DVec3) -> [f32; 3] {
    sum.try_normalize().unwrap_or(DVec3::Z).as_vec3().into()
}

/// Corners (three times the face, and which of its vertices) around each welded position, as one array with offsets.
struct Around {
    begins: Vec<usize>,
    corners: Vec<usize>,
}

impl Around {
    fn new(indices: &[[u32; 3]], weld: &[u32], positions: usize) -> Self {
        let mut begins = vec![0; positions + 1];
        indices.iter().flatten().for_each(|&i| begins[weld[i as usize] as usize + 1] += 1);
        (0..positions).for_each(|p| begins[p + 1] += begins[p]);
        let mut next = begins.clone();
        let mut corners = vec![0; begins[positions]];
        for (face, triangle) in indices.iter().enumerate() {
            for (k, &i) in triangle.iter().enumerate() {
                let slot = &mut next[weld[i as usize] as usize];
                corners[*slot] = 3 * face + k;
                *slot += 1;
            }
        }
        Self { begins, corners }
    }

    fn corners(&self, position: u32) -> &[usize] {
        &self.corners[self.begins[position as usize]..self.begins[position as usize + 1]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two unit squares that meet at `angle` along the y axis.
    fn roof(angle: f32) -> TriMesh {
        let (s, c) = angle.sin_cos();
        TriMesh {
            positions: vec![
                [-1.0, 0.0, 0.0],
                [0.0, 0.0, 0.0],
                [0.0, 1.0, 0.0],
                [-1.0, 1.0, 0.0],
                [c, 0.0, -s],
                [c, 1.0, -s],
            ],
            indices: vec![[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]],
            ..TriMesh::default()
        }
    }

    #[test]
    fn diagonals_do_not_matter() {
        let mut mesh = roof(0.6);
        mesh.compute_normals();
        let ridge = Vec3::from(mesh.normals.as_ref().unwrap()[1]);
        // One half of the left square's angle, the whole of the right one's in two triangles.
        let (s, c) = 0.6_f32.sin_cos();
        let right = Vec3::new(s, 0.0, c);
        assert!(ridge.distance((Vec3::Z + right).normalize()) < 1e-6, "{ridge}");
    }

    #[test]
    fn an_edge_above_the_angle_is_creased() {
        let (mut smooth, mut creased) = (roof(0.6), roof(0.6));
        smooth.crease_normals(0.7);
        creased.crease_normals(0.5);
        assert_eq!(smooth.positions.len(), 6);
        assert_eq!(creased.positions.len(), 8);
        assert_eq!(creased.fault(), None);
        for f in 0..4 {
            let [a, b, c] = creased.corners(f);
            let face = (b - a).cross(c - a).normalize();
            for i in creased.indices[f] {
                assert!(face.distance(creased.normals.as_ref().unwrap()[i as usize].into()) < 1e-6);
            }
        }
    }
}
