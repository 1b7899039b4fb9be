//! What the pixels say of the exposures: given ones that contradict them would make garbage of the merge.
//!
//! The q-th share of the darkest pixels is about the same part of the scene in every picture, so the codes at q say by
//! how much more light one picture got than another: roughly, since the response is not known yet, but the sign is sure.

use crate::exposure::Exposure;
use crate::{Error, Result};
use translume_image::{Codes, colour};

/// Quantiles that are compared.
const QUANTILES: usize = 100;
/// Quantiles that must be well exposed in both pictures.
const FEWEST: usize = 5;
/// ln of exposure below which neither a given nor a measured difference says anything.
const SURE: f64 = 0.2;

/// Green values at the quantiles, as light (full range of codes is 1); `None` where lost in black or near the clip.
struct Profile(Vec<Option<f64>>);

impl Profile {
    fn of(codes: &Codes, hidden: Option<&[bool]>, linear: bool) -> Self {
        let pixels = codes.width * codes.height;
        let step = (pixels / 40_000).max(1);
        let shown = (0..pixels).step_by(step).filter(|i| hidden.is_none_or(|h| !h[*i]));
        let mut values: Vec<f32> = shown.map(|i| codes.unit(3 * i + 1)).collect();
        values.sort_by(f32::total_cmp);
        let (top, floats) = (values.last().copied().unwrap_or(0.0), codes.is_linear());
        let light = |u: f32| {
            let good = if floats { (1e-4 * top..0.98 * top).contains(&u) } else { (0.06..0.94).contains(&u) };
            good.then(|| f64::from(if floats || linear { u } else { colour::srgb_to_linear(u) }))
        };
        let at = |k: usize| values.get((2 * k + 1) * values.len() / (2 * QUANTILES)).copied();
        Self((0..QUANTILES).map(|k| at(k).and_then(light)).collect())
    }

    /// ln of by how much more light `other` got; `None` if too little is well exposed in both.
    fn step(&self, other: &Self) -> Option<f64> {
        let both = self.0.iter().zip(&other.0).filter_map(|(a, b)| Some((*b.as_ref()? / a.as_ref()?).ln()));
        let mut steps: Vec<f64> = both.collect();
        if steps.len() < FEWEST {
            return None;
        }
        let mid = steps.len() / 2;
        Some(*steps.select_nth_unstable_by(mid, f64::total_cmp).1)
    }
}

/// Refuses exposures that the pixels contradict; `hidden` says per picture where it shows nothing, `order` lists
/// indices from short to long exposure.
///
/// # Errors
/// [`Error::Bracket`] with what the pixels say.
pub(crate) fn check(exposures: &[Exposure], hidden: &[Option<&[bool]>], order: &[usize], linear: bool) -> Result<()> {
    let profiles: Vec<Profile> = exposures.iter().zip(hidden).map(|(e, h)| Profile::of(&e.codes, *h, linear)).collect();
    let pairs = order.windows(2).filter_map(|p| {
        let given = (exposures[p[1]].secs / exposures[p[0]].secs).ln();
        let measured = profiles[p[0]].step(&profiles[p[1]])?;
        (given > SURE).then_some((p[0], p[1], given, measured))
    });
    let pairs: Vec<(usize, usize, f64, f64)> = pairs.collect();
    let is_wrong = |p: &&(usize, usize, f64, f64)| p.3 < -SURE;
    let Some((a, b, given, measured)) = pairs.iter().find(is_wrong) else { return Ok(()) };
    let stops = |ln: f64| ln / std::f64::consts::LN_2;
    let advice = if pairs.iter().all(|p| is_wrong(&p)) {
        "the order is the reverse of the pixels': are these 1/t, or shutter speeds, instead of seconds?"
    } else {
        "are they in the order of the pictures?"
    };
    Err(Error::Bracket(format!(
        "the pixels contradict the exposures: {} should be {:+.1} EV brighter than {}, but is {:+.1} EV; {advice}",
        exposures[*b].name,
        stops(*given),
        exposures[*a].name,
        stops(*measured)
    )))
}

/// What the pixels say of pictures whose exposures are all the same: nothing, if they are alike.
pub(crate) fn measured(exposures: &[Exposure]) -> Option<String> {
    let profiles: Vec<Profile> = exposures.iter().map(|e| Profile::of(&e.codes, None, false)).collect();
    let steps: Vec<f64> = profiles.iter().map(|p| profiles[0].step(p)).collect::<Option<Vec<f64>>>()?;
    let stops: Vec<String> = steps.iter().map(|s| format!("{:+.1}", s / std::f64::consts::LN_2)).collect();
    steps.iter().any(|s| s.abs() > SURE).then(|| format!("the pixels say about {} EV", stops.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use translume_image::{Metadata, Samples};

    fn exposure(name: &str, secs: f64, light: f32) -> Exposure {
        let code = |i: usize| {
            let linear = light * (0.02 + (i * 37 % 4800) as f32 / 4800.0);
            (colour::linear_to_srgb(linear.min(1.0)) * 255.0) as u8
        };
        let samples = Samples::U8((0..80 * 60).flat_map(|i| [code(i); 3]).collect());
        let codes = Codes { width: 80, height: 60, samples, metadata: Metadata::default() };
        Exposure { name: name.into(), codes, alpha: None, secs }
    }

    fn checked(secs: [f64; 3]) -> Result<()> {
        let bracket: Vec<Exposure> =
            ["a", "b", "c"].iter().zip([0.2, 0.8, 3.2]).zip(secs).map(|((n, l), s)| exposure(n, s, l)).collect();
        let mut order = vec![0, 1, 2];
        order.sort_by(|i, j| bracket[*i].secs.total_cmp(&bracket[*j].secs));
        check(&bracket, &[None; 3], &order, false)
    }

    #[test]
    fn exposures_that_the_pixels_contradict_are_refused() {
        checked([0.0625, 0.25, 1.0]).unwrap();
        checked([1.0, 2.0, 4.0]).unwrap();
        let error = |secs| checked(secs).unwrap_err().to_string();
        assert!(error([16.0, 4.0, 1.0]).contains("1/t"), "{}", error([16.0, 4.0, 1.0]));
        assert!(error([0.25, 0.0625, 1.0]).contains("in the order"), "{}", error([0.25, 0.0625, 1.0]));
    }

    #[test]
    fn equal_exposures_of_different_pictures_are_measured() {
        let text = measured(&[exposure("a", 1.0, 0.2), exposure("b", 1.0, 0.8)]).unwrap();
        assert!(text.contains("+2.0"), "{text}");
        assert_eq!(measured(&[exposure("a", 1.0, 0.2), exposure("b", 1.0, 0.2)]), None);
    }
}
