//! Primitives as triangles, in the pose of a node: morph targets by their weights, skins by their joints where they rest.
//!
//! Sources: glTF 2.0, §3.7.2.2 (morph targets) and §3.7.3 (skins). Without normals a mesh is flat, and its tangents do not count.

use super::document::{Node, Primitive};
use super::{Asset, Parsed};
use crate::error::{Error, Fault, Result, invalid};
use crate::mesh::{TriMesh, normal_matrix};
use glam::{DAffine3, DMat3, DMat4, DVec3};
use std::collections::BTreeMap;

/// How a node poses its mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pose {
    /// Of the morph targets; those that are not there are 0.
    pub weights: Vec<f32>,
    /// Number of the skin.
    pub skin: Option<usize>,
}

/// The triangles of a primitive in a pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Posed {
    /// The triangles.
    pub mesh: TriMesh,
    /// They are skinned: in world space, whatever the node's transform.
    pub in_world: bool,
}

impl Pose {
    /// A key for maps.
    pub fn key(&self) -> (Vec<u32>, Option<usize>) {
        (self.weights.iter().map(|w| w.to_bits()).collect(), self.skin)
    }
}

impl Asset {
    /// The pose of a node: its own weights, else its mesh's.
    pub fn pose(&self, node: usize) -> Pose {
        let Some(Node { mesh: Some(mesh), weights, skin, .. }) = self.document.nodes.get(node) else {
            return Pose::default();
        };
        let mesh = self.document.meshes.get(mesh.get()).filter(|m| m.primitives.iter().any(|p| !p.targets.is_empty()));
        let weights = mesh.map(|m| weights.as_ref().unwrap_or(&m.weights));
        let weights = weights.filter(|w| w.iter().any(|&w| w != 0.0));
        Pose { weights: weights.cloned().unwrap_or_default(), skin: skin.map(|s| s.get()) }
    }

    /// What the triangles of a primitive are made of: alike for primitives with the same ones.
    pub fn recipe(&self, mesh: usize, primitive: usize) -> String {
        let source = self.document.meshes.get(mesh).and_then(|m| m.primitives.get(primitive));
        source.map_or(String::new(), |p| {
            let Primitive { attributes, indices, mode, targets, extensions, material: _ } = p;
            let compressed = extensions.contains_key("KHR_draco_mesh_compression");
            format!("{attributes:?} {indices:?} {mode:?} {targets:?} {compressed}")
        })
    }

    /// Triangles of primitive `primitive` of mesh `mesh` in a pose; `None` for points and lines.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming mesh, primitive and attribute.
    pub fn posed(&self, mesh: usize, primitive: usize, pose: &Pose) -> Result<Option<Posed>> {
        let read = || match self.document.meshes.get(mesh).and_then(|m| m.primitives.get(primitive)) {
            Some(p) => self.triangles(p, pose),
            None => invalid("there is no such primitive"),
        };
        read().map_err(|fault| {
            let place = |what| format!("mesh {mesh}, primitive {primitive}: {what}");
            match fault {
                Fault::Invalid(what) => Error::invalid(&self.path, place(what)),
                Fault::Unsupported(what) => Error::unsupported(&self.path, place(what)),
            }
        })
    }

    /// [`Asset::posed`] with neither weights nor skin.
    ///
    /// # Errors
    /// As there.
    pub fn primitive(&self, mesh: usize, primitive: usize) -> Result<Option<TriMesh>> {
        Ok(self.posed(mesh, primitive, &Pose::default())?.map(|p| p.mesh))
    }

    fn triangles(&self, p: &Primitive, pose: &Pose) -> Parsed<Option<Posed>> {
        let mode = p.mode.map_or(4, |m| m.0);
        if mode > 6 {
            return invalid(format!("unknown mode {mode}"));
        }
        if mode < 4 {
            return Ok(None);
        }
        if p.extensions.contains_key("KHR_draco_mesh_compression") {
            return Err(Fault::Unsupported("Draco compression; decompress the file first".into()));
        }
        let Some(mut mesh) = self.vertices(p, &pose.weights)? else { return Ok(None) };
        let order = match p.indices {
            Some(accessor) => self.indices(accessor.get())?,
            None => (0..u32::try_from(mesh.positions.len()).unwrap_or(u32::MAX)).collect(),
        };
        mesh.indices = triples(mode, &order);
        if let Some(fault) = mesh.fault() {
            return invalid(fault);
        }
        let in_world = match pose.skin {
            Some(skin) => self.bend(p, skin, &mut mesh)?,
            None => false,
        };
        Ok(Some(Posed { mesh, in_world }))
    }

    /// The attributes, morphed.
    fn vertices(&self, p: &Primitive, weights: &[f32]) -> Parsed<Option<TriMesh>> {
        let Some(positions) = self.attribute::<3, 3>(p, "POSITION", weights)? else { return Ok(None) };
        let normals = self.attribute::<3, 3>(p, "NORMAL", weights)?.map(|n| n.into_iter().map(unit).collect());
        let mut tangents = self.attribute::<4, 3>(p, "TANGENT", weights)?.filter(|_| normals.is_some());
        for t in tangents.iter_mut().flatten() {
            let [x, y, z] = unit([t[0], t[1], t[2]]);
            *t = [x, y, z, if t[3] < 0.0 { -1.0 } else { 1.0 }];
        }
        let set = |name: &str| -> Parsed<Option<Vec<[f32; 2]>>> {
            let mut uvs = self.attribute::<2, 2>(p, name, weights)?;
            uvs.iter_mut().flatten().for_each(|uv| uv[1] = 1.0 - uv[1]);
            Ok(uvs)
        };
        let mut more_uvs = Vec::new();
        while let Some(uvs) = set(&format!("TEXCOORD_{}", more_uvs.len() + 1))? {
            more_uvs.push(uvs);
        }
        let (colors, alphas) = self.colors(p, weights)?;
        let uvs = set("TEXCOORD_0")?;
        Ok(Some(TriMesh { positions, normals, uvs, more_uvs, tangents, colors, alphas, indices: Vec::new() }))
    }

    #[allow(clippy::type_complexity, reason = "two attributes of one accessor")]
    fn colors(&self, p: &Primitive, weights: &[f32]) -> Parsed<(Option<Vec<[f32; 3]>>, Option<Vec<f32>>)> {
        let Some(accessor) = p.attributes.get("COLOR_0") else { return Ok((None, None)) };
        let has_alpha = self.document.accessors.get(accessor.get()).is_some_and(|a| a.shape == "VEC4");
        let bound = |mut colors: Vec<[f32; 3]>| {
            if !weights.is_empty() {
                colors.iter_mut().flatten().for_each(|c| *c = c.clamp(0.0, 1.0));
            }
            colors
        };
        if !has_alpha {
            return Ok((self.attribute::<3, 3>(p, "COLOR_0", weights)?.map(bound), None));
        }
        let Some(rows) = self.attribute::<4, 4>(p, "COLOR_0", weights)? else { return Ok((None, None)) };
        let alphas = rows.iter().map(|c| c[3].clamp(0.0, 1.0)).collect();
        Ok((Some(bound(rows.into_iter().map(|[r, g, b, _]| [r, g, b]).collect())), Some(alphas)))
    }

    /// An attribute of `N` components, of which morph targets move the first `M`.
    fn attribute<const N: usize, const M: usize>(
        &self,
        p: &Primitive,
        name: &str,
        weights: &[f32],
    ) -> Parsed<Option<Vec<[f32; N]>>> {
        let Some(accessor) = p.attributes.get(name) else { return Ok(None) };
        let mut rows: Vec<[f32; N]> = self.floats(accessor.get())?;
        for (target, &weight) in p.targets.iter().zip(weights).filter(|(_, w)| **w != 0.0) {
            let Some(moves) = target.get(name) else { continue };
            let moves = self.moves::<M>(moves.get())?;
            if moves.len() != rows.len() {
                return invalid(format!("a morph target of {name} has {} rows for {}", moves.len(), rows.len()));
            }
            for (row, by) in rows.iter_mut().zip(moves) {
                row.iter_mut().zip(by).for_each(|(x, by)| *x += weight * by);
            }
        }
        Ok(Some(rows))
    }

    /// Rows of a morph target; those of colours may leave out alpha.
    fn moves<const M: usize>(&self, index: usize) -> Parsed<Vec<[f32; M]>> {
        let short = M == 4 && self.document.accessors.get(index).is_some_and(|a| a.shape == "VEC3");
        if !short {
            return self.floats(index);
        }
        let rows: Vec<[f32; 3]> = self.floats(index)?;
        Ok(rows.into_iter().map(|row| std::array::from_fn(|i| row.get(i).copied().unwrap_or(0.0))).collect())
    }

    /// Puts the vertices where the joints of a skin have them; whether the primitive has joints at all.
    fn bend(&self, p: &Primitive, skin: usize, mesh: &mut TriMesh) -> Parsed<bool> {
        let sets = self.joint_sets(&p.attributes, mesh.positions.len())?;
        if sets.is_empty() {
            return Ok(false);
        }
        let joints = self.joints(skin)?;
        let mut mirrors = vec![false; mesh.positions.len()];
        for (i, mirrors) in mirrors.iter_mut().enumerate() {
            let m = blended(&joints, sets.iter().map(|set| set[i]))?;
            let moved = m.transform_point3(vector(mesh.positions[i]));
            mesh.positions[i] = moved.as_vec3().into();
            if let Some(normals) = &mut mesh.normals {
                let n = normal_matrix(&m.matrix3) * vector(normals[i]);
                normals[i] = n.normalize_or_zero().as_vec3().into();
            }
            *mirrors = m.matrix3.determinant() < 0.0;
            if let Some(tangents) = &mut mesh.tangents {
                let [x, y, z, w] = tangents[i];
                let [x, y, z] = (m.matrix3 * vector([x, y, z])).normalize_or_zero().as_vec3().to_array();
                tangents[i] = [x, y, z, if *mirrors { -w } else { w }];
            }
        }
        // Triangles that are turned inside out still face outwards, as under nodes that mirror.
        mesh.indices.iter_mut().filter(|t| mirrors[t[0] as usize]).for_each(|t| t.swap(1, 2));
        Ok(true)
    }

    /// Joints and weights of each vertex, four a set.
    #[allow(clippy::type_complexity, reason = "local to this file")]
    fn joint_sets(
        &self,
        attributes: &BTreeMap<String, super::document::Number>,
        vertices: usize,
    ) -> Parsed<Vec<Vec<([f32; 4], [f32; 4])>>> {
        let mut sets = Vec::new();
        let names = |n: usize| (format!("JOINTS_{n}"), format!("WEIGHTS_{n}"));
        while let (joints, weights) = names(sets.len())
            && let (Some(joints), Some(weights)) = (attributes.get(&joints), attributes.get(&weights))
        {
            let (joints, weights) = (self.floats::<4>(joints.get())?, self.floats::<4>(weights.get())?);
            if joints.len() != vertices || weights.len() != vertices {
                let (n, m) = (joints.len(), weights.len());
                return invalid(format!("{n} joints and {m} weights of a skin for {vertices} vertices"));
            }
            sets.push(joints.into_iter().zip(weights).collect());
        }
        Ok(sets)
    }

    /// The transform of each joint of a skin, from the mesh's space to the world.
    fn joints(&self, skin: usize) -> Parsed<Vec<DAffine3>> {
        let Some(source) = self.document.skins.get(skin) else { return invalid(format!("there is no skin {skin}")) };
        let worlds = self.worlds();
        let inverses = match source.inverse_bind_matrices {
            Some(accessor) => self.floats::<16>(accessor.get())?,
            None => Vec::new(),
        };
        let joint = |(i, node): (usize, &super::document::Number)| {
            let Some(world) = worlds.get(node.get()) else {
                return invalid(format!("skin {skin} has node {} as a joint, which is not there", node.get()));
            };
            match inverses.get(i) {
                Some(m) => Ok(*world * DAffine3::from_mat4(DMat4::from_cols_array(&m.map(f64::from)))),
                None if source.inverse_bind_matrices.is_none() => Ok(*world),
                None => invalid(format!("skin {skin} has fewer inverse bind matrices than joints")),
            }
        };
        source.joints.iter().enumerate().map(joint).collect()
    }

    /// The transform of each node to the world, whether a scene shows it or not.
    fn worlds(&self) -> &[DAffine3] {
        self.worlds.get_or_init(|| {
            let nodes = &self.document.nodes;
            let mut is_child = vec![false; nodes.len()];
            for child in nodes.iter().flat_map(|n| &n.children) {
                is_child.get_mut(child.get()).into_iter().for_each(|c| *c = true);
            }
            let mut worlds = vec![None; nodes.len()];
            let roots = (0..nodes.len()).filter(|&i| !is_child[i]);
            let mut stack: Vec<(usize, DAffine3)> = roots.map(|i| (i, DAffine3::IDENTITY)).collect();
            while let Some((i, parent)) = stack.pop() {
                let Some(slot @ None) = worlds.get_mut(i) else { continue };
                let world = parent * nodes[i].local_transform();
                *slot = Some(world);
                stack.extend(nodes[i].children.iter().map(|c| (c.get(), world)));
            }
            worlds.into_iter().map(|w| w.unwrap_or(DAffine3::IDENTITY)).collect()
        })
    }
}

/// The mean of the joints' transforms by the weights, which count relative to their sum. Without any the first joint holds the vertex.
fn blended(joints: &[DAffine3], sets: impl Iterator<Item = ([f32; 4], [f32; 4])>) -> Parsed<DAffine3> {
    let (mut sum, mut total, mut first) = (DAffine3 { matrix3: DMat3::ZERO, translation: DVec3::ZERO }, 0.0, None);
    for (number, weight) in sets.flat_map(|(j, w)| j.into_iter().zip(w)) {
        first = first.or(Some(number));
        if weight.is_nan() || weight <= 0.0 {
            continue;
        }
        let joint = joint_of(joints, number)?;
        let weight = f64::from(weight);
        sum.matrix3 += joint.matrix3 * weight;
        sum.translation += joint.translation * weight;
        total += weight;
    }
    if total > 0.0 && total.is_finite() {
        return Ok(DAffine3 { matrix3: sum.matrix3 * (1.0 / total), translation: sum.translation / total });
    }
    joint_of(joints, first.unwrap_or(0.0)).copied()
}

fn joint_of(joints: &[DAffine3], number: f32) -> Parsed<&DAffine3> {
    match joints.get(number as usize) {
        Some(joint) => Ok(joint),
        None => invalid(format!("a vertex has joint {number} of a skin of {}", joints.len())),
    }
}

fn vector(v: [f32; 3]) -> DVec3 {
    DVec3::from(v.map(f64::from))
}

/// Of length 1; integers of few bits and sums of morph targets are not quite.
fn unit(v: [f32; 3]) -> [f32; 3] {
    vector(v).try_normalize().map_or(v, |n| n.as_vec3().into())
}

/// Corner triples of modes 4 (triangles), 5 (strip) and 6 (fan).
fn triples(mode: u64, order: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        5 => {
            let turned = |(i, w): (usize, &[u32])| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] };
            order.windows(3).enumerate().map(turned).collect()
        }
        6 => order.windows(2).skip(1).map(|w| [order[0], w[0], w[1]]).collect(),
        _ => order.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
    }
}
