//! What goes beyond the paper, each part with a switch of its own, so that each can be measured alone.

use super::super::{Choice, Options};
use crate::Result;

/// How the chance of a light path to land with a camera vertex in its footprint is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Normalise {
    /// The footprint is taken for a disc in free space, §3.
    Disc,
    /// With rays where the surface around the light vertex is not flat.
    Rays,
    /// With rays everywhere, without bias.
    Unbiased,
}

/// The switches.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Method {
    /// Footprints are capped by the distance to the parent, and shrink with the steps.
    pub(crate) shrink: bool,
    pub(crate) normalise: Normalise,
    /// Merging behind mirrors and glass.
    pub(crate) caustics: bool,
    /// Trial links are drawn by what they would bring, among those of all vertices of a camera path.
    pub(crate) target: bool,
    /// Light paths begin at lights in proportion to what a pilot saw of them.
    pub(crate) importance: bool,
    /// What a link counts falls towards its footprint's rim (Epanechnikov's kernel).
    pub(crate) smooth: bool,
    /// Links are weighed by the number that is made, not by that of the candidates.
    pub(crate) acceptance: bool,
    /// They know what merges at a vertex have in common; of camera paths within so many pixels.
    pub(crate) correlation: f32,
    /// Lights are sampled at camera vertices as well.
    pub(crate) emitters: bool,
    /// That sampling knows which lights a pilot found to be seen from where.
    pub(crate) seen: bool,
    /// Light paths are kept by what they may bring.
    pub(crate) keep: bool,
    /// Pixels at the edges of lamps get more rays.
    pub(crate) edges: bool,
    /// Weights know how steady those samples are.
    pub(crate) steady: bool,
    /// Light paths of a step are points of a low-discrepancy sequence.
    pub(crate) sobol: bool,
    /// Merges are weighed as connections made many times, not by eq. 9.
    pub(crate) weights: bool,
}

/// The options, in the order of the table in the docs.
pub(crate) const OPTIONS: [Choice; 23] = [
    Choice { name: "light-paths", default: "0", about: "light paths of a step; 0: an eighth as many as pixels" },
    Choice { name: "eye-paths", default: "1", about: "camera paths of a pixel in each step" },
    Choice {
        name: "shared",
        default: "0",
        about: "side of blocks of pixels whose camera paths share what they find; 0: 8, with weights=false 1",
    },
    Choice { name: "sharers", default: "4", about: "camera paths in such a block for each that goes on for all" },
    Choice {
        name: "links",
        default: "0",
        about: "unoccluded links of a camera path; 0: 3, with target=false 10 of each vertex",
    },
    Choice {
        name: "printed",
        default: "false",
        about: "the method as in the paper of 2003, darker at edges: what `auto` below means",
    },
    Choice { name: "unbiased", default: "false", about: "no bias at all, slower: converges to what path finds" },
    Choice { name: "shrink", default: "auto", about: "footprints are capped and shrink with the steps" },
    Choice { name: "normalise", default: "auto", about: "chances of links: `disc`, or by `rays` where it is not flat" },
    Choice { name: "caustics", default: "auto", about: "merge photons behind mirrors and glass" },
    Choice { name: "target", default: "auto", about: "choose links by what they would bring" },
    Choice { name: "importance", default: "auto", about: "begin light paths where a pilot saw light come from" },
    Choice {
        name: "kernel",
        default: "auto",
        about: "weight in a footprint: `even`, or falling `smooth`ly to its rim",
    },
    Choice { name: "emitters", default: "auto", about: "sample lights at camera vertices as well, as path does" },
    Choice {
        name: "seen",
        default: "auto",
        about: "that sampling knows which lights are seen from where, as a pilot found",
    },
    Choice {
        name: "quota",
        default: "0",
        about: "percent of the light paths that all lamps share alike, whatever they bring",
    },
    Choice { name: "keep", default: "false", about: "keep light paths by what they may bring to the picture" },
    Choice { name: "edges", default: "auto", about: "more rays through pixels at the edges of lamps" },
    Choice {
        name: "steady",
        default: "auto",
        about: "weights know how little samples of lights at the first surface differ",
    },
    Choice { name: "sobol", default: "auto", about: "light paths by a low-discrepancy sequence" },
    Choice {
        name: "acceptance",
        default: "auto",
        about: "weights count the links that are made, not all that could be",
    },
    Choice {
        name: "correlation",
        default: "0",
        about: "weights know what links of a camera path have in common, as if paths within so many pixels were alike; 0: no",
    },
    Choice { name: "weights", default: "auto", about: "bidirectional weights by the number of links, not by eq. 9" },
];

impl Method {
    pub(crate) fn new(options: &Options) -> Result<Self> {
        let printed = options.switch("printed")?;
        let unbiased = options.switch("unbiased")?;
        if printed && unbiased {
            return options.wrong("unbiased", "the printed method is biased; one of the two");
        }
        let auto = |name| -> Result<bool> {
            let choice = options.choice(name, ["auto", "false", "true"])?;
            Ok(if choice == 0 { !printed } else { choice == 2 })
        };
        let normalise = match options.choice("normalise", ["auto", "disc", "rays"])? {
            _ if unbiased => Normalise::Unbiased,
            0 if printed => Normalise::Disc,
            1 => Normalise::Disc,
            _ => Normalise::Rays,
        };
        let caustics = options.choice("caustics", ["auto", "false", "true"])?;
        if unbiased && caustics == 2 {
            return options.wrong("caustics", "merging photons is biased: not with unbiased=true;");
        }
        if unbiased && options.choice("shrink", ["auto", "false", "true"])? == 1 {
            return options.wrong("shrink", "unbiased=true takes footprints that are capped: `auto` or `true`");
        }
        let correlation = options.number("correlation", 0..=1 << 40)? as f32;
        let weights = auto("weights")?;
        if correlation > 0.0 && !weights {
            return options.wrong("correlation", "0 with weights=false or printed=true, since eq. 9 knows of none,");
        }
        Ok(Self {
            shrink: auto("shrink")?,
            normalise,
            caustics: !unbiased && auto("caustics")?,
            target: auto("target")?,
            importance: auto("importance")?,
            smooth: options.choice("kernel", ["auto", "even", "smooth"])? == 2,
            acceptance: auto("acceptance")?,
            correlation,
            emitters: auto("emitters")?,
            seen: auto("seen")?,
            keep: options.switch("keep")?,
            edges: auto("edges")?,
            steady: auto("steady")?,
            sobol: auto("sobol")?,
            weights,
        })
    }
}
