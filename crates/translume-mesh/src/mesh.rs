//! The triangle mesh.

use glam::{DAffine3, DMat3, DVec3, Vec3};

/// Indexed triangles with optional attributes, one value per vertex.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriMesh {
    /// Vertex positions, in the file's unit of length.
    pub positions: Vec<[f32; 3]>,
    /// Unit shading normals, as long as `positions`.
    pub normals: Option<Vec<[f32; 3]>>,
    /// Texture coordinates, origin at the lower left, as long as `positions`.
    pub uvs: Option<Vec<[f32; 2]>>,
    /// Further sets of texture coordinates, of the second and so on, each as long as `positions`.
    pub more_uvs: Vec<Vec<[f32; 2]>>,
    /// Unit tangents for normal maps, as long as `positions`; the fourth number is 1 or −1: the bitangent is the normal
    /// cross the tangent, times it.
    pub tangents: Option<Vec<[f32; 4]>>,
    /// Vertex colours as stored, integers scaled to 0–1, as long as `positions`.
    pub colors: Option<Vec<[f32; 3]>>,
    /// Coverage of the vertices, beside their colours, as long as `positions`.
    pub alphas: Option<Vec<f32>>,
    /// Triangles, counter-clockwise seen from outside; every index is below `positions.len()`.
    pub indices: Vec<[u32; 3]>,
}

/// An axis-aligned box; empty (`lo > hi`) when nothing finite is inside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Smallest coordinates.
    pub lo: Vec3,
    /// Largest coordinates.
    pub hi: Vec3,
}

impl Bounds {
    /// The box of nothing.
    pub const EMPTY: Self = Self { lo: Vec3::INFINITY, hi: Vec3::NEG_INFINITY };

    /// Grows to hold `p`.
    #[inline]
    pub fn grow(&mut self, p: Vec3) {
        self.lo = self.lo.min(p);
        self.hi = self.hi.max(p);
    }

    /// Grows to hold `other`.
    #[inline]
    pub fn join(&mut self, other: &Self) {
        self.lo = self.lo.min(other.lo);
        self.hi = self.hi.max(other.hi);
    }

    /// Nothing inside.
    pub fn is_empty(&self) -> bool {
        !(self.lo.cmple(self.hi).all())
    }

    /// Edge lengths, zero when empty.
    #[inline]
    pub fn extent(&self) -> Vec3 {
        (self.hi - self.lo).max(Vec3::ZERO)
    }

    /// The middle.
    pub fn center(&self) -> Vec3 {
        self.lo * 0.5 + self.hi * 0.5
    }

    /// Half the surface area, the measure of the surface area heuristic.
    #[inline]
    pub fn half_area(&self) -> f32 {
        let e = self.extent();
        e.x * e.y + e.y * e.z + e.z * e.x
    }
}

impl TriMesh {
    /// The corners of triangle `face`.
    #[inline]
    pub fn corners(&self, face: usize) -> [Vec3; 3] {
        self.indices[face].map(|i| Vec3::from(self.positions[i as usize]))
    }

    /// The box of the finite vertices.
    pub fn bounds(&self) -> Bounds {
        let mut bounds = Bounds::EMPTY;
        for p in self.positions.iter().map(|&p| Vec3::from(p)).filter(|p| p.is_finite()) {
            bounds.grow(p);
        }
        bounds
    }

    /// Total area of the triangles, summed in double precision.
    pub fn area(&self) -> f64 {
        let corner = |i: u32| DVec3::from(self.positions[i as usize].map(f64::from));
        let double: f64 = self
            .indices
            .iter()
            .map(|&[a, b, c]| (corner(b) - corner(a)).cross(corner(c) - corner(a)).length())
            .filter(|a| a.is_finite())
            .sum();
        0.5 * double
    }

    /// Moves the mesh by `world_from_mesh`, computed in double precision. Normals go by the inverse transpose; a
    /// transform that mirrors turns the triangles over so that they still face outwards.
    pub fn transform(&mut self, world_from_mesh: &DAffine3) {
        for p in &mut self.positions {
            *p = world_from_mesh.transform_point3(DVec3::from(p.map(f64::from))).as_vec3().into();
        }
        let mirrors = world_from_mesh.matrix3.determinant() < 0.0;
        if let Some(normals) = &mut self.normals {
            let matrix = normal_matrix(&world_from_mesh.matrix3);
            for n in normals {
                *n = (matrix * DVec3::from(n.map(f64::from))).normalize_or_zero().as_vec3().into();
            }
        }
        for t in self.tangents.iter_mut().flatten() {
            let along = DVec3::new(t[0].into(), t[1].into(), t[2].into());
            let [x, y, z] = (world_from_mesh.matrix3 * along).normalize_or_zero().as_vec3().to_array();
            *t = [x, y, z, if mirrors { -t[3] } else { t[3] }];
        }
        if mirrors {
            self.indices.iter_mut().for_each(|t| t.swap(1, 2));
        }
    }

    /// Turns every triangle and normal over.
    pub fn flip(&mut self) {
        self.indices.iter_mut().for_each(|t| t.swap(1, 2));
        if let Some(normals) = &mut self.normals {
            normals.iter_mut().flatten().for_each(|x| *x = -*x);
        }
        self.tangents.iter_mut().flatten().for_each(|t| t[3] = -t[3]);
    }

    /// Leaves out the vertices that no triangle uses.
    pub fn compact(&mut self) {
        let mut numbers = vec![u32::MAX; self.positions.len()];
        let mut kept: Vec<u32> = Vec::new();
        for i in self.indices.iter_mut().flatten() {
            let number = &mut numbers[*i as usize];
            if *number == u32::MAX {
                *number = kept.len() as u32;
                kept.push(*i);
            }
            *i = *number;
        }
        self.pick(&kept);
    }

    /// Vertices become those of the numbers `from`, with all their attributes; the indices are the caller's.
    pub(crate) fn pick(&mut self, from: &[u32]) {
        fn picked<T: Copy>(values: &mut Vec<T>, from: &[u32]) {
            *values = from.iter().map(|&v| values[v as usize]).collect();
        }
        picked(&mut self.positions, from);
        self.normals.iter_mut().for_each(|v| picked(v, from));
        self.uvs.iter_mut().chain(&mut self.more_uvs).for_each(|v| picked(v, from));
        self.tangents.iter_mut().for_each(|v| picked(v, from));
        self.colors.iter_mut().for_each(|v| picked(v, from));
        self.alphas.iter_mut().for_each(|v| picked(v, from));
    }

    /// Adds the triangles of `other` with their own vertices. An attribute that only one side has is filled with
    /// zeros on the other (white for colours, opaque, a tangent along x).
    ///
    /// Returns false, leaving the mesh as it was, when the sum would not fit 32-bit indices.
    #[must_use]
    pub fn append(&mut self, other: &Self) -> bool {
        let (here, there) = (self.positions.len(), other.positions.len());
        let Ok(base) = u32::try_from(here) else { return false };
        if u32::try_from(here + there).is_err() {
            return false;
        }
        join(&mut self.normals, &other.normals, here, there, [0.0; 3]);
        join(&mut self.uvs, &other.uvs, here, there, [0.0; 2]);
        join(&mut self.tangents, &other.tangents, here, there, [1.0, 0.0, 0.0, 1.0]);
        join(&mut self.colors, &other.colors, here, there, [1.0; 3]);
        join(&mut self.alphas, &other.alphas, here, there, 1.0);
        for i in 0..self.more_uvs.len().max(other.more_uvs.len()) {
            let mut set = self.more_uvs.get_mut(i).map(std::mem::take);
            join(&mut set, &other.more_uvs.get(i).cloned(), here, there, [0.0; 2]);
            let set = set.unwrap_or_default();
            if i < self.more_uvs.len() { self.more_uvs[i] = set } else { self.more_uvs.push(set) }
        }
        self.positions.extend_from_slice(&other.positions);
        self.indices.extend(other.indices.iter().map(|t| t.map(|i| i + base)));
        true
    }

    /// What is wrong with the arrays, if anything: an index out of range or an attribute of the wrong length.
    pub fn fault(&self) -> Option<String> {
        let n = self.positions.len();
        let lengths = [
            ("normals", self.normals.as_ref().map(Vec::len)),
            ("texture coordinates", self.uvs.as_ref().map(Vec::len)),
            ("tangents", self.tangents.as_ref().map(Vec::len)),
            ("colours", self.colors.as_ref().map(Vec::len)),
            ("alphas", self.alphas.as_ref().map(Vec::len)),
        ];
        let sets = self.more_uvs.iter().map(|set| ("texture coordinates", Some(set.len())));
        for (name, length) in lengths.into_iter().chain(sets) {
            if let Some(length) = length.filter(|&l| l != n) {
                return Some(format!("{length} {name} for {n} vertices"));
            }
        }
        let bad = self.indices.iter().position(|t| t.iter().any(|&i| i as usize >= n))?;
        Some(format!("triangle {bad} uses a vertex beyond the {n} there are ({:?})", self.indices[bad]))
    }
}

/// The inverse transpose up to a positive factor; the cofactor matrix, which exists for singular matrices too.
pub(crate) fn normal_matrix(m: &DMat3) -> DMat3 {
    let cofactor = DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
    if m.determinant() < 0.0 { -cofactor } else { cofactor }
}

fn join<T: Copy>(to: &mut Option<Vec<T>>, from: &Option<Vec<T>>, here: usize, there: usize, fill: T) {
    match (to.as_mut(), from) {
        (Some(a), Some(b)) => a.extend_from_slice(b),
        (Some(a), None) => a.resize(here + there, fill),
        (None, Some(b)) => {
            let mut a = vec![fill; here];
            a.extend_from_slice(b);
            *to = Some(a);
        }
        (None, None) => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(crate) fn triangle() -> TriMesh {
        TriMesh {
            positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            normals: Some(vec![[0.0, 0.0, 1.0]; 3]),
            indices: vec![[0, 1, 2]],
            ..TriMesh::default()
        }
    }

    #[test]
    fn transforms_keep_normals_upright_on_their_faces() {
        for m in [
            DAffine3::from_scale(DVec3::new(1.0, 5.0, -2.0)),
            DAffine3::from_rotation_x(1.0) * DAffine3::from_scale(DVec3::new(-1.0, 2.0, 3.0)),
            DAffine3::from_translation(DVec3::splat(1e3)),
        ] {
            let mut mesh = triangle();
            mesh.transform(&m);
            let [a, b, c] = mesh.corners(0);
            let face = (b - a).cross(c - a).normalize();
            let n = Vec3::from(mesh.normals.as_ref().unwrap()[0]);
            assert!(face.dot(n) > 0.9999, "{face} {n}");
        }
    }

    #[test]
    fn append_fills_what_one_side_lacks() {
        let mut a = triangle();
        let b = TriMesh { normals: None, uvs: Some(vec![[0.5, 0.5]; 3]), ..triangle() };
        assert!(a.append(&b));
        assert_eq!(a.fault(), None);
        assert_eq!(a.indices[1], [3, 4, 5]);
        assert_eq!(a.normals.unwrap()[3], [0.0; 3]);
        assert_eq!(a.uvs.unwrap()[0..4], [[0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.5, 0.5]]);
    }

    #[test]
    fn faults_are_named() {
        assert!(TriMesh { indices: vec![[0, 1, 3]], ..triangle() }.fault().unwrap().contains("triangle 0"));
        assert!(TriMesh { normals: Some(vec![]), ..triangle() }.fault().unwrap().contains("0 normals"));
    }
}
