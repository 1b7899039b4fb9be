//! Vertex normals from faces, weighted by area, with or without a crease angle.

use crate::mesh::TriMesh;
use glam::{DVec3, Vec3};
use std::collections::HashMap;

/// Around a vertex of more faces than this all of them are averaged: comparing every pair would take quadratic time.
const MOST_COMPARED: usize = 512;

impl TriMesh {
    /// Sets each vertex normal to the area-weighted mean of the faces that use the vertex. Vertices without such a face
    /// get +z.
    pub fn compute_normals(&mut self) {
        let mut sums = vec![DVec3::ZERO; self.positions.len()];
        for face in 0..self.indices.len() {
            let normal = self.double_area(face);
            self.indices[face].iter().for_each(|&i| sums[i as usize] += normal);
        }
        self.normals = Some(sums.into_iter().map(unit).collect());
    }

    /// Sets normals that are smooth over edges up to `max_angle_rad` and creased at sharper ones, splitting vertices
    /// there. Faces around the same position are compared even across seams.
    pub fn crease_normals(&mut self, max_angle_rad: f32) {
        let (weld, positions) = self.weld();
        let cosine = f64::from(max_angle_rad).cos();
        let areas: Vec<DVec3> = (0..self.indices.len()).map(|f| self.double_area(f)).collect();
        let units: Vec<DVec3> = areas.iter().map(|n| n.normalize_or_zero()).collect();
        let around = Around::new(&self.indices, &weld, positions);
        let mut vertices: Vec<u32> = Vec::new();
        let mut normals: Vec<[f32; 3]> = Vec::new();
        let mut numbers: HashMap<(u32, [u32; 3]), u32> = HashMap::new();
        let mut indices = self.indices.clone();
        for (face, triangle) in indices.iter_mut().enumerate() {
            for i in triangle {
                let faces = around.faces(weld[*i as usize]);
                let near = |f: &&u32| {
                    // A face without area has no say and no angle.
                    faces.len() > MOST_COMPARED
                        || **f as usize == face
                        || units[face].dot(units[**f as usize]) >= cosine
                };
                let normal = unit(faces.iter().filter(near).map(|&f| areas[f as usize]).sum());
                *i = *numbers.entry((*i, normal.map(f32::to_bits))).or_insert_with(|| {
                    vertices.push(*i);
                    normals.push(normal);
                    vertices.len() as u32 - 1
                });
            }
        }
        self.positions = pick(&vertices, &self.positions);
        self.colors = self.colors.as_deref().map(|colors| pick(&vertices, colors));
        self.uvs = self.uvs.as_deref().map(|uvs| pick(&vertices, uvs));
        self.normals = Some(normals);
        self.indices = indices;
    }

    /// Face normal whose length is twice the area; zero when a corner is not finite.
    fn double_area(&self, face: usize) -> DVec3 {
        let [a, b, c] = self.corners(face).map(Vec3::as_dvec3);
        let normal = (b - a).cross(c - a);
        if normal.is_finite() { normal } else { DVec3::ZERO }
    }
}

fn pick<T: Copy>(vertices: &[u32], from: &[T]) -> Vec<T> {
    vertices.iter().map(|&v| from[v as usize]).collect()
}

fn unit(sum: DVec3) -> [f32; 3] {
    sum.try_normalize().unwrap_or(DVec3::Z).as_vec3().into()
}

/// Faces around each welded position, as one array with offsets.
struct Around {
    begins: Vec<usize>,
    faces: Vec<u32>,
}

impl Around {
    fn new(indices: &[[u32; 3]], weld: &[u32], positions: usize) -> Self {
        let mut begins = vec![0; positions + 1];
        indices.iter().flatten().for_each(|&i| begins[weld[i as usize] as usize + 1] += 1);
        (0..positions).for_each(|p| begins[p + 1] += begins[p]);
        let mut next = begins.clone();
        let mut faces = vec![0; begins[positions]];
        for (face, triangle) in indices.iter().enumerate() {
            for &i in triangle {
                let slot = &mut next[weld[i as usize] as usize];
                faces[*slot] = face as u32;
                *slot += 1;
            }
        }
        Self { begins, faces }
    }

    fn faces(&self, position: u32) -> &[u32] {
        &self.faces[self.begins[position as usize]..self.begins[position as usize + 1]]
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
    fn normals_are_means_weighted_by_area() {
        let mut mesh = roof(0.6);
        mesh.compute_normals();
        let ridge = Vec3::from(mesh.normals.as_ref().unwrap()[1]);
        // One half triangle on the left, two on the right.
        let (s, c) = 0.6_f32.sin_cos();
        let expected = (Vec3::Z + 2.0 * Vec3::new(s, 0.0, c)).normalize();
        assert!(ridge.distance(expected) < 1e-6);
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
