//! Weights that know what merges at one vertex have in common: the camera's path to it.
//!
//! Source: Grittmann, Georgiev, Slusallek: Correlation-aware multiple importance sampling for bidirectional rendering algorithms,
//! Computer Graphics Forum 40(2), 2021.
//!
//! The heuristics of Veach take the g_j merges at z_j to be independent. All of them share z_j … z_k: where most of the noise is in the choice of these
//! vertices, many merges are little better than one. So g_j becomes g_j ρ_j, where
//! ρ_j = C_j / (C_j + L_j − C_j L_j),
//! C_j is about the chance that another camera path passes near z_j … z_{k−1} on its way, L_j that another light path passes near z_0 … z_j: products of
//! min(1, p A), p the density per area of each vertex and A the area that is called near. At z_k, which every path of
//! a pixel finds, ρ = 1. A is what so many pixels see of the first surface (the source: a circle around it that the camera sees within one degree).
//!
//! ρ_j is of the whole path: the sums along the two walks ([`super::weight`]) cannot have it. Here every vertex is looked at, for each path that is weighed.

use crate::subpath::NONE;

/// A vertex of a path from a light, z₀, to the camera.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Node {
    /// Density per area of the light's walk; of z₀, of the begin.
    pub(crate) light: f32,
    /// Of the camera's walk, in the same measure; 0 of z₀ that it cannot meet.
    pub(crate) camera: f32,
    /// g of what may happen here, before powers; of z₀ it is 1.
    pub(crate) made: f32,
    /// It scatters in single directions.
    pub(crate) delta: bool,
}

/// That of a camera's path, beyond the two vertices next to the light.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ancestor {
    pub(crate) node: Node,
    /// Number of the next one to the camera, or [`NONE`].
    pub(crate) above: u32,
}

impl Ancestor {
    /// Behind `by` others.
    pub(crate) fn moved(&self, by: u32) -> Self {
        Self { above: moved(self.above, by), ..*self }
    }
}

/// The number of an ancestor behind `by` others.
pub(crate) fn moved(number: u32, by: u32) -> u32 {
    if number == NONE { NONE } else { number + by }
}

/// A way to make a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Technique {
    /// The camera's walk meets the light.
    Met,
    /// Emitter sampling at z₁.
    Sampled,
    /// Merging at the vertex of this number.
    Joined(usize),
}

/// A path, with all that weights need to know of it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Whole {
    /// z₀ … z_k.
    pub(crate) nodes: Vec<Node>,
    /// Density of z₀ by emitter sampling at z₁.
    pub(crate) direct: f32,
    /// That of z₀ is per area.
    pub(crate) extended: bool,
}

impl Whole {
    /// With only its begin at a light, of these densities: by light paths, by the camera's walk where that may meet it, if not 0, and by emitter sampling.
    pub(crate) fn from_light(light: f32, camera: f32, extended: bool, direct: f32) -> Self {
        Self { nodes: vec![Node { light, camera, made: 1.0, delta: false }], direct, extended }
    }

    /// Appends the vertices of a camera's path from `ancestors[from]` on.
    pub(crate) fn ascend(&mut self, ancestors: &[Ancestor], from: u32) {
        let next = |a: &&Ancestor| ancestors.get(a.above as usize);
        debug_assert!(from == NONE || (from as usize) < ancestors.len());
        self.nodes.extend(std::iter::successors(ancestors.get(from as usize), next).map(|a| a.node));
    }

    /// Weight of a way to make it by the power heuristic, where paths within as many pixels as `alike` are near each other.
    pub(crate) fn weight(&self, technique: Technique, alike: f32) -> f32 {
        let near = self.independence(alike);
        // Of merging at vertex j, over l₀ Π_{0<i<j} l_i Π_{i≥j} e_i.
        let merges = |j: usize| f64::from(self.nodes[j].made * near[j] * self.nodes[0].light);
        let ratio = |i: usize| f64::from(self.nodes[i].light) / f64::from(self.nodes[i].camera);
        let joint = if let Technique::Joined(j) = technique { j } else { 1 };
        let mut sum = merges(joint).powi(2);
        // What the vertex at hand takes in place of the joint's densities, in both directions.
        let mut factor = 1.0;
        for j in (1..joint).rev() {
            factor /= ratio(j);
            sum += finite(merges(j) * factor).powi(2);
        }
        let met = f64::from(self.nodes[0].camera);
        let sampled = f64::from(self.direct);
        sum += finite(met * factor).powi(2) + finite(sampled * factor).powi(2);
        factor = 1.0;
        for j in joint + 1..self.nodes.len() {
            factor *= ratio(j - 1);
            sum += finite(merges(j) * factor).powi(2);
        }
        let own = match technique {
            Technique::Met => met,
            Technique::Sampled => sampled,
            Technique::Joined(j) => merges(j),
        };
        if sum > 0.0 { (own * own / sum) as f32 } else { 0.0 }
    }

    /// ρ of each vertex.
    fn independence(&self, alike: f32) -> Vec<f32> {
        let nodes = &self.nodes;
        let Some(last) = nodes.last() else { return Vec::new() };
        let area = alike / last.camera;
        let near = |density: f32| (density * area).min(1.0);
        let mut light = Vec::with_capacity(nodes.len());
        let mut chance = if self.extended { near(nodes[0].light) } else { 1.0 };
        light.push(chance);
        for pair in nodes.windows(2) {
            // Out of a mirror there is one way only.
            chance *= if pair[0].delta { 1.0 } else { near(pair[1].light) };
            light.push(chance);
        }
        let mut camera = 1.0;
        for i in (0..nodes.len()).rev() {
            if nodes.get(i + 1).is_some_and(|next| !next.delta) {
                camera *= near(nodes[i].camera);
            }
            let either = camera + light[i] - camera * light[i];
            light[i] = if either > 0.0 { camera / either } else { 1.0 };
        }
        light
    }
}

/// What has no density elsewhere cannot be made there.
fn finite(x: f64) -> f64 {
    if x.is_finite() { x } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(light: f32, camera: f32, made: f32) -> Node {
        Node { light, camera, made, delta: false }
    }

    /// A path over three surfaces, of which a camera path passes near the last two with chance 0.1 each.
    fn path() -> Whole {
        let nodes = vec![node(0.5, 0.02, 1.0), node(0.2, 0.1, 40.0), node(0.3, 0.1, 40.0), node(0.4, 1.0, 40.0)];
        Whole { nodes, direct: 0.7, extended: true }
    }

    #[test]
    fn weights_sum_to_one() {
        for alike in [0.0, 0.01, 1.0, 4.0, f32::INFINITY] {
            let ways = [Technique::Met, Technique::Sampled].into_iter().chain((1..4).map(Technique::Joined));
            let sum: f32 = ways.map(|way| path().weight(way, alike)).sum();
            assert!((sum - 1.0).abs() < 1e-5, "{alike}: {sum}");
        }
    }

    #[test]
    fn merges_deep_down_a_rare_camera_path_count_less() {
        // C = 0.01, 0.1, 1 and L = 0.1, 0.03, 0.012.
        let expected = [0.01 / (0.01 + 0.1 - 0.001), 0.1 / (0.1 + 0.03 - 0.003), 1.0];
        let found = path().independence(1.0);
        assert!(found[1..].iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{found:?}");
        // Beside emitter sampling, the 40 merges of density 0.5 at z₁ are as 3.7; at z₂ 31 times 2.
        let [a, b, c] = [20.0 * expected[0], 20.0 * expected[1] * 2.0, 20.0 * 6.0];
        let others: f32 = [a, b, c, 0.02].iter().map(|g| g * g).sum();
        let weight = path().weight(Technique::Sampled, 1.0);
        assert!((weight - 0.49 / (0.49 + others)).abs() < 1e-6, "{weight}");
        // In the limit there is nothing in common.
        assert!(path().independence(f32::INFINITY).iter().all(|r| *r == 1.0));
    }

    #[test]
    fn a_mirror_is_no_choice() {
        let mut mirror = path();
        mirror.nodes[2] = Node { made: 0.0, delta: true, ..mirror.nodes[2] };
        let found = mirror.independence(1.0);
        // z₁ follows from z₂, and z₃ from the light's side.
        assert!((found[1] - 0.1 / (0.1 + 0.1 - 0.01)).abs() < 1e-5, "{found:?}");
    }
}
