//! Which pictures of a folder, in their order, form brackets.
//!
//! Four ways to cut are tried in turn: by the pattern in which the exposures repeat, by the first exposure that comes
//! again, by pauses between the shots, and by how the pictures look. The first whose every bracket holds together, as
//! far as looks and pauses tell, is taken; if none does, nobody should merge anything: that is an error.

use crate::look::{DIFFERENT, Look, SAME};
use crate::{Error, Result};
use std::ops::Range;

/// What is known of a picture before it is merged.
#[derive(Clone, Debug, Default)]
pub struct Fact {
    /// Name for messages.
    pub name: String,
    /// Relative exposure.
    pub exposure: Option<f64>,
    /// Exposure time in seconds.
    pub exposure_secs: Option<f64>,
    /// Width and height as stored.
    pub size: (usize, usize),
    /// Moment of the shot in seconds.
    pub captured_secs: Option<f64>,
    /// Whether the camera calls it part of an automatic bracket.
    pub auto_bracket: Option<bool>,
    /// How it looks.
    pub look: Option<Look>,
}

/// Brackets as runs of pictures, and pictures that stand alone.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Brackets {
    /// Runs of two or more.
    pub sets: Vec<Range<usize>>,
    /// Single pictures between them.
    pub alone: Vec<usize>,
}

/// Lengths of brackets of `count` among `n` pictures.
///
/// # Errors
/// [`Error::Bracket`] when the count does not divide the number of pictures.
pub fn group_by_count(n: usize, count: usize) -> Result<Vec<Range<usize>>> {
    if count >= 2 && n.is_multiple_of(count) {
        return Ok((0..n / count).map(|k| k * count..(k + 1) * count).collect());
    }
    Err(Error::Bracket(format!("{n} pictures do not make brackets of {count}; check --group or the folder")))
}

/// The brackets that pictures form, in their order.
///
/// # Errors
/// [`Error::Doubt`] when no way to cut them gives brackets that each seem to show one scene.
pub fn group(facts: &[Fact]) -> Result<Brackets> {
    let mut out = Brackets::default();
    let mut start = 0;
    for end in 1..=facts.len() {
        let differs = |a: &Fact, b: &Fact| a.size != b.size || a.auto_bracket != b.auto_bracket;
        if end == facts.len() || differs(&facts[end - 1], &facts[end]) {
            for run in (Series { facts: &facts[start..end] }).cut()? {
                match run.len() {
                    1 => out.alone.push(start + run.start),
                    _ => out.sets.push(start + run.start..start + run.end),
                }
            }
            start = end;
        }
    }
    Ok(out)
}

/// Pictures of one size and one mode of shooting.
struct Series<'a> {
    facts: &'a [Fact],
}

type Cut = Vec<Range<usize>>;

/// Whether two exposures are the same, to a sixth of a stop.
fn same(a: f64, b: f64) -> bool {
    (a / b).ln().abs() < 0.12
}

impl Series<'_> {
    fn cut(&self) -> Result<Cut> {
        let n = self.facts.len();
        let whole: Cut = std::iter::once(0..n).collect();
        let Some(exposures) = self.facts.iter().map(|f| f.exposure).collect::<Option<Vec<f64>>>() else {
            return Ok(whole);
        };
        if n < 2 || exposures.iter().all(|e| same(*e, exposures[0])) {
            return Ok(whole);
        }
        let rises = |w: &[f64]| w[1] > w[0] || same(w[0], w[1]);
        let falls = |w: &[f64]| w[1] < w[0] || same(w[0], w[1]);
        let one_way = exposures.windows(2).all(rises) || exposures.windows(2).all(falls);
        let by_repeat = by_repeat(&exposures);
        let mut ways = Vec::new();
        // A series that only rises or falls is one bracket, and so is one scene with an exposure taken twice.
        if one_way || by_repeat.iter().any(|r| r.len() == 1) && self.is_one_scene() {
            ways.push(whole);
        }
        ways.extend(by_pattern(&exposures));
        ways.push(by_repeat);
        ways.extend(self.by_pause());
        ways.extend(self.by_look());
        let mut doubt = None;
        // Pictures that all stand alone are no brackets.
        for way in ways.into_iter().filter(|way| way.len() < n) {
            match way.iter().find_map(|run| self.doubt(run.clone())) {
                None => return Ok(way),
                Some(why) => doubt.get_or_insert(why),
            };
        }
        Err(Error::Doubt(doubt.unwrap_or_default()))
    }

    fn likeness(&self, i: usize, j: usize) -> Option<f32> {
        self.facts[i].look.as_ref()?.likeness(self.facts[j].look.as_ref()?)
    }

    fn is_alike(&self, i: usize, j: usize) -> bool {
        self.likeness(i, j).is_some_and(|l| l > SAME)
    }

    fn is_one_scene(&self) -> bool {
        (1..self.facts.len()).all(|i| self.is_alike(i - 1, i))
    }

    /// What speaks against a run being one bracket.
    fn doubt(&self, run: Range<usize>) -> Option<String> {
        let name = |i: usize| &self.facts[i].name;
        let mut order: Vec<usize> = run.clone().collect();
        order.sort_by(|a, b| self.facts[*a].exposure.unwrap_or(0.0).total_cmp(&self.facts[*b].exposure.unwrap_or(0.0)));
        // Neighbours in exposure share most of their range.
        let strangers = order.windows(2).find(|p| self.likeness(p[0], p[1]).is_some_and(|l| l < DIFFERENT));
        if let Some(p) = strangers {
            let (first, second) = (p[0].min(p[1]), p[0].max(p[1]));
            return Some(format!("{} and {} do not look like one scene", name(first), name(second)));
        }
        let pauses = self.pauses();
        let i = (run.start + 1..run.end).find(|i| pauses.contains(i) && !self.is_alike(i - 1, *i))?;
        Some(format!("there is a long pause between {} and {}", name(i - 1), name(i)))
    }

    /// Pictures before which the camera rested clearly longer than between others.
    fn pauses(&self) -> Vec<usize> {
        let Some(at) = self.facts.iter().map(|f| f.captured_secs).collect::<Option<Vec<f64>>>() else {
            return Vec::new();
        };
        // Names may run against time.
        let rests: Vec<f64> = at.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
        let mut sorted = rests.clone();
        sorted.sort_by(f64::total_cmp);
        // Long exposures, and what cameras do after them, are no pauses.
        let exposed = self.facts.iter().filter_map(|f| f.exposure_secs).fold(0.0, f64::max);
        let clearly_longer = |w: &&[f64]| w[1] > 4.0 * w[0] + 2.0 + 2.0 * exposed;
        let Some(short) = sorted.windows(2).find(clearly_longer).map(|w| w[0]) else { return Vec::new() };
        (1..at.len()).filter(|i| rests[i - 1] > short).collect()
    }

    fn by_pause(&self) -> Option<Cut> {
        let pauses = self.pauses();
        (!pauses.is_empty()).then(|| runs(&pauses, self.facts.len()))
    }

    /// Cut where neighbours do not look alike, if every pair says clearly whether it does.
    fn by_look(&self) -> Option<Cut> {
        let mut cuts = Vec::new();
        for i in 1..self.facts.len() {
            match self.likeness(i - 1, i)? {
                l if l < DIFFERENT => cuts.push(i),
                l if l > SAME => {}
                _ => return None,
            }
        }
        (!cuts.is_empty()).then(|| runs(&cuts, self.facts.len()))
    }
}

/// The runs between the beginnings `cuts`.
fn runs(cuts: &[usize], n: usize) -> Cut {
    let ends = cuts.iter().copied().chain([n]);
    std::iter::once(0).chain(cuts.iter().copied()).zip(ends).map(|(a, b)| a..b).collect()
}

/// Cut before the first exposure that the bracket has already.
fn by_repeat(exposures: &[f64]) -> Cut {
    let mut cuts = Vec::new();
    let mut start = 0;
    for i in 1..exposures.len() {
        if exposures[start..i].iter().any(|e| same(*e, exposures[i])) {
            cuts.push(i);
            start = i;
        }
    }
    runs(&cuts, exposures.len())
}

/// Cut by the shortest period of two or more after which the exposure *steps* repeat (the light may have changed
/// meanwhile); the last bracket may be broken off.
fn by_pattern(exposures: &[f64]) -> Option<Cut> {
    let n = exposures.len();
    let period = (2..=n / 2).find(|period| {
        let repeats = (0..n).all(|i| {
            let base = exposures[i - i % period];
            same(exposures[i] / base, exposures[i % period] / exposures[0])
        });
        let differs = (1..*period).any(|i| !same(exposures[i], exposures[0]));
        // Broken off beside a change of the light could be anything.
        let whole = n.is_multiple_of(*period) || (0..n).step_by(*period).all(|k| same(exposures[k], exposures[0]));
        repeats && differs && whole
    })?;
    let cuts: Vec<usize> = (period..n).step_by(period).collect();
    Some(runs(&cuts, n))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts(exposures: &[f64]) -> Vec<Fact> {
        let fact = |(i, e): (usize, &f64)| Fact {
            name: format!("IMG_{i}"),
            exposure: Some(*e),
            size: (4, 4),
            ..Fact::default()
        };
        exposures.iter().enumerate().map(fact).collect()
    }

    fn lengths(facts: &[Fact]) -> Vec<usize> {
        let found = group(facts).unwrap();
        assert_eq!(found.alone, [0usize; 0]);
        found.sets.iter().map(|r| r.len()).collect()
    }

    #[test]
    fn brackets_of_every_order_are_found() {
        for order in [[0, 1, 2], [1, 0, 2], [2, 1, 0], [1, 2, 0], [0, 2, 1], [2, 0, 1]] {
            let one = order.map(|i| [0.25, 1.0, 4.0][i]);
            for times in [2, 3, 5] {
                assert_eq!(lengths(&facts(&one.repeat(times))), vec![3; times], "{one:?}");
            }
        }
        let of = |e: &[f64]| lengths(&facts(e));
        assert_eq!(of(&[1.0, 4.0, 0.25, 2.0, 8.0, 0.5]), [3, 3], "the light changed");
        assert_eq!(of(&[1.0, 2.0, 4.0, 8.0]), [4], "one series, not two");
        assert_eq!(of(&[8.0, 8.0, 4.0, 2.0]), [4], "an exposure twice");
        assert_eq!(of(&[1.0, 1.3, 2.7]), [3]);
        assert_eq!(of(&[1.0, 0.5, 2.0, 0.25, 4.0]), [5], "one automatic bracket of five");
    }

    #[test]
    fn brackets_of_different_length_are_found() {
        let of = |e: &[f64]| lengths(&facts(e));
        assert_eq!(of(&[1.0, 4.0, 16.0, 1.0, 4.0, 16.0, 1.0, 4.0]), [3, 3, 2], "the last broken off");
        assert_eq!(of(&[1.0, 4.0, 1.0, 4.0, 16.0, 1.0, 0.25, 4.0]), [2, 3, 3]);
        assert_eq!(of(&[1.0, 0.5, 2.0, 1.0, 0.5, 2.0, 0.25, 4.0]), [3, 5]);
        let found = group(&facts(&[1.0, 4.0, 16.0, 1.0, 4.0, 16.0, 1.0])).unwrap();
        assert_eq!((found.sets, found.alone), (vec![0..3, 3..6], vec![6]));
    }

    #[test]
    fn sizes_and_modes_cut() {
        let mut f = facts(&[1.0, 4.0, 2.0, 8.0]);
        f[2].size = (8, 4);
        f[3].size = (8, 4);
        assert_eq!(lengths(&f), [2, 2]);
        let mut f = facts(&[1.0, 4.0, 0.25, 2.0]);
        f.iter_mut().for_each(|f| f.auto_bracket = Some(true));
        f[3].auto_bracket = Some(false);
        let found = group(&f).unwrap();
        assert_eq!((found.sets.as_slice(), found.alone.as_slice()), (std::slice::from_ref(&(0..3)), &[3][..]));
    }

    #[test]
    fn pauses_say_where_brackets_begin() {
        // The first bracket lacks its first shot, so that the pattern is out of step.
        let mut f = facts(&[0.25, 4.0, 1.0, 0.25, 4.0, 1.0, 0.25, 4.0]);
        for (f, t) in f.iter_mut().zip([0.0, 1.0, 60.0, 60.5, 61.0, 200.0, 200.5, 201.0]) {
            f.captured_secs = Some(t);
        }
        assert_eq!(lengths(&f), [2, 3, 3]);
        // A hand-driven series with even rests, longer exposures taking longer, is one.
        let mut f = facts(&[1.0, 4.0, 16.0, 64.0]);
        for (f, t) in f.iter_mut().zip([0.0, 9.0, 20.0, 40.0]) {
            (f.captured_secs, f.exposure_secs) = (Some(t), f.exposure);
        }
        assert_eq!(lengths(&f), [4]);
    }

    #[test]
    fn counts_must_divide() {
        assert!(group_by_count(5, 2).is_err() && group_by_count(4, 0).is_err() && group_by_count(3, 1).is_err());
        assert_eq!(group_by_count(6, 3).unwrap(), [0..3, 3..6]);
    }
}
