//! What pictures must have in common to be one bracket.

use crate::exposure::Exposure;
use crate::{Error, Result, order};
use translume_image::Samples;

/// Checks that the pictures can be one bracket.
///
/// # Errors
/// [`Error::Bracket`] with what is wrong and what to do.
pub fn check(exposures: &[Exposure]) -> Result<()> {
    let [first, rest @ ..] = exposures else { return Err(Error::Bracket("no pictures".into())) };
    if rest.is_empty() {
        return Err(Error::Bracket(format!("{}: one picture is no bracket; give two or more", first.name)));
    }
    for e in exposures {
        if e.codes.width == 0 || e.codes.height == 0 {
            return Err(Error::Bracket(format!("{}: the picture is empty", e.name)));
        }
        if (e.codes.width, e.codes.height) != (first.codes.width, first.codes.height) {
            return Err(Error::Bracket(format!(
                "{}: {} × {} pixels, but {} has {} × {}; all pictures of a bracket must have one size",
                e.name, e.codes.width, e.codes.height, first.name, first.codes.width, first.codes.height
            )));
        }
        if !(e.secs.is_finite() && e.secs > 0.0) {
            return Err(Error::Bracket(format!("{}: exposure {} is not a positive number", e.name, e.secs)));
        }
        if e.codes.is_linear() != first.codes.is_linear() {
            return Err(Error::Bracket(format!(
                "{}: linear and encoded pictures cannot be mixed in one bracket",
                e.name
            )));
        }
        if let Samples::F32(v) = &e.codes.samples {
            if let Some(i) = v.iter().position(|x| !x.is_finite()) {
                let (x, y) = (i / 3 % e.codes.width, i / 3 / e.codes.width);
                return Err(Error::Bracket(format!(
                    "{}: value {} at pixel ({x}, {y}); repair the file first",
                    e.name, v[i]
                )));
            }
            if v.iter().all(|x| *x <= 0.0) {
                return Err(Error::Bracket(format!("{}: no positive value in it", e.name)));
            }
        }
    }
    if rest.iter().all(|e| (e.secs / first.secs - 1.0).abs() < 1e-3) {
        let pixels = order::measured(exposures).map_or_else(String::new, |m| format!("; {m}"));
        return Err(Error::Bracket(format!(
            "all {} pictures have the same exposure ({} s); a bracket needs different ones (give --exposures if the files \
             are wrong{pixels})",
            exposures.len(),
            first.secs
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use translume_image::{Codes, Metadata};

    #[test]
    fn brackets_that_cannot_be_merged_are_refused() {
        let e = |name: &str, secs: f64, w: usize| Exposure {
            name: name.into(),
            codes: Codes {
                width: w,
                height: 4,
                samples: Samples::U8(vec![100; 12 * w]),
                metadata: Metadata::default(),
            },
            alpha: None,
            secs,
        };
        let message = |v: &[Exposure]| check(v).unwrap_err().to_string();
        assert!(message(&[e("a", 1.0, 4)]).contains("a: one picture"));
        assert!(message(&[e("a", 1.0, 4), e("b", 2.0, 5)]).contains("b: 5 × 4"));
        assert!(message(&[e("a", 1.0, 4), e("b", 1.0, 4)]).contains("same exposure"));
        assert!(message(&[e("a", 1.0, 4), e("b", f64::NAN, 4)]).contains("b: exposure"));
        check(&[e("a", 1.0, 4), e("b", 1.0, 4), e("c", 4.0, 4)]).unwrap();
    }
}
