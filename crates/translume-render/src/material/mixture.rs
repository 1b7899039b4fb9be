//! Blends of blends: a material may be part of a mixture in many ways, and is worked out once.
//!
//! A graph of n blends can have 2ⁿ ways from its top to its materials. Shares are handed down from each blend to its two parts once
//! all that come to it are known, so that a mixture takes as long as it has blends and materials.

use std::collections::HashMap;
use translume_scene::material::Model;
use translume_scene::{MaterialId, Scene, TextureId};

/// A mixture: its blends, each before what it refers to, and what is none.
pub(crate) struct Mixture {
    /// Weight of the second part, and the numbers of both: of blends, and beyond these of materials.
    blends: Vec<(TextureId, usize, usize)>,
    materials: Vec<MaterialId>,
}

/// Blends and materials of one mixture, at most.
const MOST: usize = 512;

impl Mixture {
    /// The mixture that `id` is; `None`: it is no blend.
    ///
    /// # Errors
    /// A line about what there is too much of.
    pub(crate) fn new(scene: &Scene, id: MaterialId) -> Result<Option<Self>, String> {
        let Model::Blend { .. } = scene.materials[id.0].model else { return Ok(None) };
        // Materials by the order in which they are met, first parts first; blends with what they are of.
        let (mut materials, mut blends) = (Vec::new(), Vec::new());
        let (mut met, mut waiting) = (std::collections::HashSet::new(), vec![id]);
        while let Some(id) = waiting.pop() {
            if !met.insert(id) {
                continue;
            }
            if met.len() > MOST {
                let name = &scene.materials[id.0].name;
                return Err(format!("too many nested blends: a mixture with {name:?} has more than {MOST} parts"));
            }
            match &scene.materials[id.0].model {
                Model::Blend { weight, first, second } => {
                    blends.push((id, *weight, *first, *second));
                    waiting.extend([*second, *first]);
                }
                _ => materials.push(id),
            }
        }
        // What a material refers to was made before it.
        blends.sort_by_key(|b| std::cmp::Reverse(b.0));
        let in_order = blends.iter().map(|b| b.0).chain(materials.iter().copied());
        let numbers: HashMap<MaterialId, usize> = in_order.enumerate().map(|(i, id)| (id, i)).collect();
        let blends =
            blends.iter().map(|(_, weight, first, second)| (*weight, numbers[first], numbers[second])).collect();
        Ok(Some(Self { blends, materials }))
    }

    /// The materials, with their shares where the weights of blends are as `weight` says.
    pub(super) fn shares(&self, weight: impl Fn(TextureId) -> f32) -> Vec<(MaterialId, f32)> {
        let mut shares = vec![0.0; self.blends.len() + self.materials.len()];
        shares[0] = 1.0;
        for (i, (texture, first, second)) in self.blends.iter().enumerate() {
            let share = shares[i];
            if share > 0.0 {
                let weight = weight(*texture);
                shares[*first] += share * (1.0 - weight);
                shares[*second] += share * weight;
            }
        }
        let parts = self.materials.iter().zip(shares.split_off(self.blends.len()));
        parts.map(|(id, share)| (*id, share)).filter(|(_, share)| *share > 0.0).collect()
    }

    /// What it is made of.
    pub(super) fn materials(&self) -> &[MaterialId] {
        &self.materials
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rgb;
    use translume_scene::material::Material;
    use translume_scene::texture::Texture;

    /// Each blend mixes the two materials before it: as many ways as Fibonacci's numbers.
    #[test]
    fn shares_are_those_of_all_ways() {
        let mut scene = Scene::default();
        scene.textures.push(Texture::Constant(Rgb::splat(0.25)));
        let mut add = |model| scene.materials.push(Material { name: String::new(), model });
        add(Model::Null);
        add(Model::Null);
        for i in 2..40 {
            add(Model::Blend { weight: TextureId(0), first: MaterialId(i - 1), second: MaterialId(i - 2) });
        }
        let mixture = Mixture::new(&scene, MaterialId(39)).unwrap().unwrap();
        let mut expected = [[1.0, 0.0], [0.0, 1.0_f32]];
        for _ in 2..40 {
            let [a, b] = expected;
            expected = [b, [0.75 * b[0] + 0.25 * a[0], 0.75 * b[1] + 0.25 * a[1]]];
        }
        let mut got = [0.0; 2];
        mixture.shares(|_| 0.25).into_iter().for_each(|(id, share)| got[id.0] = share);
        for c in 0..2 {
            assert!((got[c] - expected[1][c]).abs() < 1e-5, "{got:?} {expected:?}");
        }
    }

    #[test]
    fn too_many_are_refused() {
        let mut scene = Scene::default();
        let mut add = |model| scene.materials.push(Material { name: String::new(), model });
        add(Model::Null);
        for i in 1..600 {
            add(Model::Blend { weight: TextureId(0), first: MaterialId(i - 1), second: MaterialId(0) });
        }
        assert!(Mixture::new(&scene, MaterialId(500)).unwrap().is_some());
        assert!(Mixture::new(&scene, MaterialId(599)).err().unwrap().contains("nested"));
        assert!(Mixture::new(&scene, MaterialId(0)).unwrap().is_none());
    }
}
