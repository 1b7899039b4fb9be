//! One brightness for the brackets of a panorama.

use super::Args;
use clap::ValueEnum;
use translume_hdr::{Exposure, Scale};

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum ScaleBy {
    /// The exposures: equal values are equal light in all brackets of the run
    Common,
    /// The anchor of each bracket: its mid grey comes out as 0.214
    Anchor,
}

/// The scale of the brackets of one run.
#[derive(Default)]
pub(super) struct Scales {
    /// There are several.
    many: bool,
    /// The exposures of the first, from short to long.
    first: Option<Vec<f64>>,
    /// How many have its scale, and how many one of their own because their exposures differ.
    shared: usize,
    apart: usize,
}

impl Scales {
    /// Of a run of several brackets.
    pub(super) fn of_many() -> Self {
        Self { many: true, ..Self::default() }
    }

    /// The scale of a bracket of these exposures.
    pub(super) fn of(&mut self, exposures: &[Exposure], args: &Args) -> Scale {
        let mut own: Vec<f64> = exposures.iter().map(|e| e.secs).collect();
        own.sort_by(f64::total_cmp);
        let first = self.first.get_or_insert_with(|| own.clone());
        let equal = first.len() == own.len() && first.iter().zip(&own).all(|(a, b)| (a / b).ln().abs() < 0.01);
        let common = match args.scale {
            Some(how) => how == ScaleBy::Common,
            None => self.many && equal,
        };
        *(if common { &mut self.shared } else { &mut self.apart }) += 1;
        if common { Scale::Exposure(first[first.len() / 2]) } else { Scale::Anchor }
    }

    /// What to tell of a scale that nobody chose.
    pub(super) fn note(&self, args: &Args) -> Option<String> {
        match (args.scale.is_none() && args.calibrate.is_none(), self.shared, self.apart) {
            (true, 2.., 0) => Some(
                "the brackets have the same exposures and one common scale; --scale anchor gives each its own".into(),
            ),
            (true, _, n @ 1..) if self.shared + n > 1 => Some(format!(
                "{n} of the brackets differ in their exposures from the first and have a scale of their own; \
                 --scale common gives all the same"
            )),
            _ => None,
        }
    }
}
