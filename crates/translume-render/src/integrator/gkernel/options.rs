//! The options of the method, and what became of those that it had.

use super::super::{Choice, Options, Settings};
use super::GKernel;
use crate::Result;
use std::sync::{Mutex, OnceLock};

/// The options, in the order of the table in the docs.
pub(crate) const OPTIONS: [Choice; 8] = [
    Choice { name: "light-paths", default: "0", about: "light paths of a step; 0: an eighth as many as pixels" },
    Choice { name: "eye-paths", default: "1", about: "camera paths of a pixel in each step" },
    Choice { name: "shared", default: "8", about: "side of blocks of pixels whose camera paths share; 1: they do not" },
    Choice { name: "sharers", default: "4", about: "camera paths in such a block for each that goes on for all" },
    Choice { name: "links", default: "3", about: "unoccluded links of a camera path" },
    Choice { name: "unbiased", default: "false", about: "no bias at all, slower: converges to what path finds" },
    Choice {
        name: "caustics",
        default: "auto",
        about: "merge photons behind mirrors and glass; auto: unless unbiased",
    },
    Choice { name: "emitters", default: "true", about: "sample lights at camera vertices as well, not only by links" },
];

/// Options that there were, and what became of them.
pub(crate) const REMOVED: [(&[&str], &str); 4] = [
    (&["printed"], "the method as published is one of its own, `gkernel-2003`"),
    (&["shrink", "normalise", "target", "weights"], "it is always on; the method without it is `gkernel-2003`"),
    (&["importance", "sobol", "seen", "edges", "steady", "acceptance"], "it is always on"),
    (
        &["kernel", "quota", "keep", "correlation"],
        "it did not pay; what it brought is in docs/decisions/0006-shared-camera-paths.md",
    ),
];

impl GKernel {
    /// With these settings and options.
    ///
    /// # Errors
    /// [`crate::Error::Mismatch`] for options that are none.
    pub fn new(settings: Settings, options: &Options) -> Result<Self> {
        let unbiased = options.switch("unbiased")?;
        let caustics = options.choice("caustics", ["auto", "false", "true"])?;
        if unbiased && caustics == 2 {
            return options.wrong("caustics", "merging photons is biased: not with unbiased=true;");
        }
        Ok(Self {
            settings,
            light_paths: options.number("light-paths", 0..=50_000_000)? as u32,
            eye_paths: options.number("eye-paths", 1..=1 << 40)?,
            shared: options.number("shared", 1..=16)? as u32,
            sharers: options.number("sharers", 1..=256)? as usize,
            links: options.number("links", 1..=1000)? as f32,
            unbiased,
            caustics: !unbiased && caustics != 1,
            emitters: options.switch("emitters")?,
            calibration: OnceLock::new(),
            visibility: Mutex::default(),
            kept: Mutex::default(),
            keep: false.into(),
            counts: Default::default(),
        })
    }
}
