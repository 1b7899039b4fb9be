//! Lists that people write: lights of pictures, exposures of brackets.

use super::Said;
use crate::input::Input;
use std::path::Path;
use translume_field::{lights, names};

/// A folder with a list, or with a `pattern` of its pictures' names.
pub(super) fn lights(folder: &Path, input: &Input) -> Said {
    let found = match input.files.iter().find(|f| f.0 == "pattern") {
        Some((_, pattern)) => names::find(folder, &String::from_utf8_lossy(pattern)),
        None => lights::find(folder, None),
    };
    if let Ok((shots, _)) = &found {
        for shot in shots {
            let unit = |v: [f32; 3]| (v.iter().map(|x| x * x).sum::<f32>() - 1.0).abs() < 1e-4;
            assert!(unit(shot.light) && shot.view.is_none_or(unit), "directions are unit vectors: {shot:?}");
            assert!(shot.strength > 0.0 && shot.strength.is_finite(), "a strength of {}", shot.strength);
        }
        let written = lights::to_lp(shots, folder);
        assert_eq!(written.lines().count(), shots.len() + 1, "a line for each");
    }
    Said::of(&found, |f| format!("{} unlit", f.1))
}

/// Exposure times by name.
pub(super) fn exposures(_: &Path, input: &Input) -> Said {
    let Some((_, bytes)) = input.files.first() else { return Said { accepted: false, text: String::new() } };
    let text = translume_image::text::decode(bytes);
    let list = translume_hdr::parse_list(&text);
    if let Ok(list) = &list {
        assert!(list.iter().all(|(_, secs)| *secs > 0.0 && secs.is_finite()), "exposures are positive");
    }
    Said::of(&list, |_| String::new())
}
