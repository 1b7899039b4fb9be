//! Filling functions on a mesh by Laplace's equation with the known values as its boundary [Goesele 2004, §6.2], with
//! the least-squares ψ. Three values at once; the hierarchical model fills in colours, the model by vertices the logarithms
//! of its curves.
//!
//! The paper's iteration F ← F + (1 − c) λ/|N| Σ (F_n − F)/e_n has the weighted mean of the neighbours as its fixed point. Here it is
//! reached quickly: a first guess from coarser and coarser groups of vertices (pull-push), then Gauss–Seidel with overrelaxation.
//! A known value with confidence c < 1 pulls with the strength c/(1 − c) against its neighbours' 1, so that it is smoothed a little.

use glam::Vec3;
use translume_mesh::TriMesh;

/// Three values and the strength with which they are known: 0 for not at all, infinite for fixed ones.
pub(crate) type Known = [f32; 4];

/// Neighbours with weights, and groups of vertices.
pub(crate) struct Graph {
    begins: Vec<u32>,
    links: Vec<(u32, f32)>,
    /// The group of each member, level by level.
    groups: Vec<Vec<u32>>,
}

/// Overrelaxation; below 2.
const OMEGA: f32 = 1.8;
/// The change that ends the rounds.
const ENOUGH: f32 = 3e-4;

impl Graph {
    /// Neighbours along edges, weighted by the reciprocal of their lengths [Desbrun et al. 1999].
    pub(crate) fn of_mesh(mesh: &TriMesh) -> Self {
        Self::of_edges(mesh, Vec::new())
    }

    /// The same; vertices at one place are neighbours, too.
    pub(crate) fn of_welded_mesh(mesh: &TriMesh) -> Self {
        let (weld, _) = mesh.weld();
        let mut first = vec![u32::MAX; mesh.positions.len()];
        let mut twins = Vec::new();
        for (i, &number) in weld.iter().enumerate() {
            match first[number as usize] {
                u32::MAX => first[number as usize] = i as u32,
                twin => twins.push((twin, i as u32)),
            }
        }
        Self::of_edges(mesh, twins)
    }

    fn of_edges(mesh: &TriMesh, mut edges: Vec<(u32, u32)>) -> Self {
        let at = |i: u32| Vec3::from(mesh.positions[i as usize]);
        edges.extend(mesh.indices.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]));
        edges.iter_mut().for_each(|e| *e = (e.0.min(e.1), e.0.max(e.1)));
        edges.sort_unstable();
        edges.dedup();
        let mean = edges.iter().map(|&(a, b)| at(a).distance(at(b))).sum::<f32>() / edges.len().max(1) as f32;
        // Twins and slivers count a lot, but not without limit, or the rounds would not end.
        let weight = |a: u32, b: u32| mean / at(a).distance(at(b)).max(0.1 * mean).max(1e-30);
        Self::new(mesh.positions.len(), edges.into_iter().map(|(a, b)| (a, b, weight(a, b))))
    }

    /// From edges, each once, with positive weights.
    pub(crate) fn new(n: usize, edges: impl Iterator<Item = (u32, u32, f32)>) -> Self {
        let mut lists: Vec<Vec<(u32, f32)>> = vec![Vec::new(); n];
        for (a, b, w) in edges {
            lists[a as usize].push((b, w));
            lists[b as usize].push((a, w));
        }
        let mut begins = vec![0];
        let mut links = Vec::new();
        for list in &mut lists {
            let sum: f32 = list.iter().map(|l| l.1).sum();
            links.extend(list.iter().map(|l| (l.0, l.1 / sum)));
            begins.push(links.len() as u32);
        }
        let mut graph = Self { begins, links, groups: Vec::new() };
        graph.coarsen(lists);
        graph
    }

    pub(crate) fn len(&self) -> usize {
        self.begins.len() - 1
    }

    #[inline]
    pub(crate) fn neighbours(&self, i: usize) -> &[(u32, f32)] {
        &self.links[self.begins[i] as usize..self.begins[i + 1] as usize]
    }

    /// Joins each vertex with the free neighbour it is closest to, level after level.
    fn coarsen(&mut self, mut lists: Vec<Vec<(u32, f32)>>) {
        loop {
            let n = lists.len();
            let mut group = vec![u32::MAX; n];
            let mut count = 0;
            for i in 0..n {
                if group[i] == u32::MAX {
                    let free = lists[i].iter().filter(|l| group[l.0 as usize] == u32::MAX && l.0 as usize != i);
                    let partner = free.max_by(|a, b| a.1.total_cmp(&b.1)).map(|l| l.0);
                    group[i] = count;
                    partner.into_iter().for_each(|p| group[p as usize] = count);
                    count += 1;
                }
            }
            if count as usize > n * 9 / 10 {
                return;
            }
            let mut next: Vec<Vec<(u32, f32)>> = vec![Vec::new(); count as usize];
            for (i, list) in lists.iter().enumerate() {
                next[group[i] as usize].extend(list.iter().map(|l| (group[l.0 as usize], l.1)));
            }
            for (i, list) in next.iter_mut().enumerate() {
                list.retain(|l| l.0 as usize != i);
                list.sort_by_key(|l| l.0);
                list.dedup_by(|b, a| {
                    a.0 == b.0 && {
                        a.1 += b.1;
                        true
                    }
                });
            }
            self.groups.push(group);
            lists = next;
        }
    }

    /// Solves for all values, in at most `rounds`; where nothing is known in a piece of the mesh, they are `otherwise`.
    pub(crate) fn fill(&self, known: &[Known], otherwise: [f32; 3], rounds: usize) -> Vec<[f32; 3]> {
        let mut field = self.guess(known, otherwise);
        for round in 0..rounds {
            let mut change = 0.0f32;
            for k in 0..field.len() {
                let i = if round % 2 == 0 { k } else { field.len() - 1 - k };
                if known[i][3] == f32::INFINITY || self.neighbours(i).is_empty() {
                    continue;
                }
                let mut mean = [0.0f32; 3];
                for &(n, w) in self.neighbours(i) {
                    (0..3).for_each(|c| mean[c] += w * field[n as usize][c]);
                }
                let strength = known[i][3];
                let step = |c: usize| (mean[c] + strength * known[i][c]) / (1.0 + strength) - field[i][c];
                let steps = [step(0), step(1), step(2)];
                (0..3).for_each(|c| field[i][c] += OMEGA * steps[c]);
                change = steps.iter().fold(change, |c, s| c.max(s.abs()));
            }
            if change < ENOUGH {
                break;
            }
        }
        field
    }

    /// Known values as they are; the others from the smallest group around that knows something.
    fn guess(&self, known: &[Known], otherwise: [f32; 3]) -> Vec<[f32; 3]> {
        let mut levels: Vec<Vec<Known>> = vec![known.iter().map(|k| [k[0], k[1], k[2], k[3].min(1e3)]).collect()];
        for group in &self.groups {
            let below = levels.last().expect("not empty");
            let count = group.iter().max().map_or(0, |m| *m as usize + 1);
            let mut above = vec![[0.0f32; 4]; count];
            for (k, &g) in below.iter().zip(group) {
                let sum = &mut above[g as usize];
                (0..3).for_each(|c| sum[c] += k[3] * k[c]);
                sum[3] += k[3];
            }
            above.iter_mut().filter(|s| s[3] > 0.0).for_each(|s| (0..3).for_each(|c| s[c] /= s[3]));
            levels.push(above);
        }
        let top = levels.pop().expect("not empty");
        let value = |k: &Known| if k[3] > 0.0 { [k[0], k[1], k[2]] } else { otherwise };
        let mut field: Vec<[f32; 3]> = top.iter().map(value).collect();
        for (level, group) in levels.iter().zip(&self.groups).rev() {
            field = level
                .iter()
                .zip(group)
                .map(|(k, &g)| if k[3] > 0.0 { [k[0], k[1], k[2]] } else { field[g as usize] })
                .collect();
        }
        field
    }

    /// The paper's relaxation as it is printed, `rounds` times with the largest step that is stable, from `otherwise`.
    pub(crate) fn plain(&self, known: &[Known], otherwise: [f32; 3], rounds: usize) -> Vec<[f32; 3]> {
        let value = |k: &Known| if k[3] > 0.0 { [k[0], k[1], k[2]] } else { otherwise };
        let mut field: Vec<[f32; 3]> = known.iter().map(value).collect();
        for _ in 0..rounds {
            let step = |i: usize| match known[i][3] > 0.0 {
                true => field[i],
                // [Goesele 2004, §6.2]
                false => [0, 1, 2].map(|c| self.neighbours(i).iter().map(|&(n, w)| w * field[n as usize][c]).sum()),
            };
            field = (0..self.len()).map(step).collect();
        }
        field
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid of `n` × `n` vertices.
    fn grid(n: u32) -> Graph {
        let right = (0..n * n).filter(move |i| i % n + 1 < n).map(|i| (i, i + 1, 1.0));
        let down = (0..n * (n - 1)).map(move |i| (i, i + n, 1.0));
        Graph::new((n * n) as usize, right.chain(down))
    }

    #[test]
    fn harmonic_functions_come_out() {
        let n = 40u32;
        let graph = grid(n);
        // x² − y² is harmonic on a square grid too.
        let f = |i: u32| {
            let (x, y) = ((i % n) as f32 / 10.0, (i / n) as f32 / 10.0);
            [x * x - y * y, x * y, 1.0]
        };
        let border = |i: u32| i.is_multiple_of(n) || i % n == n - 1 || i / n == 0 || i / n == n - 1;
        let known: Vec<Known> = (0..n * n)
            .map(|i| {
                let v = f(i);
                [v[0], v[1], v[2], if border(i) { f32::INFINITY } else { 0.0 }]
            })
            .collect();
        let found = graph.fill(&known, [0.0; 3], 100);
        let worst = |field: &[[f32; 3]]| {
            (0..n * n)
                .map(|i| (0..3).map(|c| (field[i as usize][c] - f(i)[c]).abs()).fold(0.0, f32::max))
                .fold(0.0, f32::max)
        };
        assert!(worst(&found) < 0.1, "{}", worst(&found));
        // The plain iteration is far from there after as many rounds.
        let plain = worst(&graph.plain(&known, [0.0; 3], 100));
        assert!(plain > 10.0 * worst(&found), "{plain} {}", worst(&found));
    }

    #[test]
    fn uncertain_values_are_smoothed_and_lonely_pieces_get_the_default() {
        // A row of five, the third an outlier of confidence 1/2; and two vertices apart.
        let edges = [(0, 1), (1, 2), (2, 3), (3, 4), (5, 6)].map(|(a, b)| (a, b, 1.0));
        let graph = Graph::new(7, edges.into_iter());
        let mut known = vec![[1.0, 1.0, 1.0, f32::INFINITY]; 7];
        known[2] = [3.0, 3.0, 3.0, 1.0];
        known[5][3] = 0.0;
        known[6][3] = 0.0;
        let field = graph.fill(&known, [7.0; 3], 50);
        assert!((field[2][0] - 2.0).abs() < 1e-2 && field[6] == [7.0; 3], "{field:?}");
    }
}
