//! One orientation for a bracket: a camera that points down or up writes tags by chance.

use crate::exposure::Exposure;
use crate::look::Look;
use translume_image::{Codes, Orientation, Samples};

/// Turns pictures whose orientation tag differs from that of the most, if their pixels lie as the others' do. Returns
/// what was done, for people.
///
/// Where sizes allow both ways, looks decide; a picture that fits better as its own tag says stays as it is.
pub fn one_orientation(exposures: &mut [Exposure]) -> Vec<String> {
    let tags: Vec<Orientation> = exposures.iter().map(|e| e.codes.metadata.orientation).collect();
    let count = |tag: Orientation| tags.iter().filter(|t| **t == tag).count();
    let Some(common) = tags.iter().copied().rev().max_by_key(|t| count(*t)) else { return Vec::new() };
    let mut said = Vec::new();
    for i in (0..tags.len()).filter(|i| tags[*i] != common) {
        let nearest = |j: &usize| (exposures[*j].secs / exposures[i].secs).ln().abs();
        let Some(j) = (0..tags.len()).filter(|j| tags[*j] == common).min_by(|a, b| nearest(a).total_cmp(&nearest(b)))
        else {
            continue;
        };
        let reference = Look::new(&exposures[j].codes);
        let turned = retagged(&exposures[i], common);
        let like = |e: &Exposure| reference.likeness(&Look::new(&e.codes));
        let size = |e: &Exposure| (e.codes.width, e.codes.height);
        let fits = size(&exposures[i]) == size(&exposures[j]);
        if size(&turned) != size(&exposures[j]) || fits && like(&exposures[i]) > like(&turned) {
            continue;
        }
        said.push(format!(
            "{}: its orientation tag ({}) is not that of the others ({}), but its pixels lie as theirs; taken as {}",
            turned.name, tags[i] as u8, common as u8, common as u8
        ));
        exposures[i] = turned;
    }
    said
}

/// The picture as if its file had said `tag`.
fn retagged(e: &Exposure, tag: Orientation) -> Exposure {
    let own = e.codes.metadata.orientation.inverse();
    let size = (e.codes.width, e.codes.height);
    fn turn<T: Copy>(
        v: &[T],
        n: usize,
        size: (usize, usize),
        undo: Orientation,
        tag: Orientation,
    ) -> (usize, usize, Vec<T>) {
        let (w, h, stored) = undo.apply(size, n, v.to_vec());
        tag.apply((w, h), n, stored)
    }
    let (width, height, samples) = match &e.codes.samples {
        Samples::U8(v) => wrap(turn(v, 3, size, own, tag), Samples::U8),
        Samples::U16(v) => wrap(turn(v, 3, size, own, tag), Samples::U16),
        Samples::F32(v) => wrap(turn(v, 3, size, own, tag), Samples::F32),
    };
    let metadata = translume_image::Metadata { orientation: tag, ..e.codes.metadata.clone() };
    let alpha = e.alpha.as_ref().map(|a| turn(a, 1, size, own, tag).2);
    Exposure { name: e.name.clone(), codes: Codes { width, height, samples, metadata }, alpha, secs: e.secs }
}

fn wrap<T>((w, h, v): (usize, usize, Vec<T>), samples: impl Fn(Vec<T>) -> Samples) -> (usize, usize, Samples) {
    (w, h, samples(v))
}

#[cfg(test)]
mod tests {
    use super::*;
    use translume_image::Metadata;

    /// A shot of patches, stored upright, whose file says `tag`.
    fn shot(name: &str, gain: f32, tag: Orientation) -> Exposure {
        let (w, h) = (96, 64);
        let mut rng = translume_core::rng::Pcg32::new(4, 0);
        let patches: Vec<f32> = (0..24 * 16).map(|_| rng.next_f32()).collect();
        let code = |x: usize, y: usize| (255.0 * (gain * patches[y / 4 * 24 + x / 4]).min(1.0).powf(0.45)) as u8;
        let stored: Vec<u8> =
            (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).flat_map(|(x, y)| [code(x, y); 3]).collect();
        let (width, height, upright) = tag.apply((w, h), 3, stored);
        let metadata = Metadata { orientation: tag, ..Metadata::default() };
        let codes = Codes { width, height, samples: Samples::U8(upright), metadata };
        Exposure { name: name.into(), codes, alpha: None, secs: f64::from(gain) }
    }

    #[test]
    fn a_tag_by_mistake_is_overruled_by_the_others() {
        for tag in [Orientation::BottomRight, Orientation::RightTop] {
            let good = Orientation::TopLeft;
            let mut bracket = [shot("a", 0.3, good), shot("b", 0.6, good), shot("c", 1.2, tag)];
            let said = one_orientation(&mut bracket);
            assert!(said.len() == 1 && said[0].starts_with("c: its orientation"), "{said:?}");
            let right = shot("c", 1.2, good);
            assert_eq!((bracket[2].codes.width, &bracket[2].codes.samples), (96, &right.codes.samples));
        }
    }

    #[test]
    fn a_camera_that_was_turned_is_believed() {
        // The third was shot upside down and its tag says so: upright it fits.
        let good = Orientation::TopLeft;
        let mut third = shot("c", 1.2, good);
        third.codes.metadata.orientation = Orientation::BottomRight;
        let before = third.codes.samples.clone();
        let mut bracket = [shot("a", 0.3, good), shot("b", 0.6, good), third];
        assert!(one_orientation(&mut bracket).is_empty());
        assert_eq!(bracket[2].codes.samples, before);
        let mut all = [shot("a", 0.3, Orientation::RightTop), shot("b", 0.6, Orientation::RightTop)];
        assert!(one_orientation(&mut all).is_empty());
    }
}
