//! Methods of other programs by the ones here that find the same light.

use super::INTEGRATORS;
use crate::World;

/// What stands for a method that a scene names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Nearest {
    /// One of [`INTEGRATORS`].
    pub name: &'static str,
    /// How near it is.
    pub kind: Likeness,
}

/// How a method stands to the one that a scene names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Likeness {
    /// It is the one, or the scene named none.
    Same,
    /// It finds what the other finds.
    Like,
    /// The other is not known.
    Unknown,
}

/// Paths from the camera; the same through media; paths from both ends, or from the lights; photons and the like.
const PATHS: [&str; 13] = [
    "direct",
    "path",
    "prb",
    "prb_basic",
    "prb_projective",
    "prb_threepoint",
    "direct_projective",
    "direct_reparam",
    "prb_reparam",
    "simplepath",
    "randomwalk",
    "vpl",
    "wavefront",
];
const VOLUMES: [&str; 7] =
    ["volpath", "volpathmis", "volpath_simple", "prbvolpath", "simplevolpath", "volprim_rf_basic", "directvolume"];
const BOTH_ENDS: [&str; 10] =
    ["bdpt", "ptracer", "lightpath", "pssmlt", "mlt", "mmlt", "erpt", "manifold", "vcm", "upbp"];
const PHOTONS: [&str; 6] = ["sppm", "ppm", "photonmapper", "photonmap", "progressivephotonmap", "igi"];

/// The method for a scene that names `wanted` (empty: none), by what there is in it; `in_medium`: the camera is in one. Media are
/// never left out because of a method that does not see them here, unless the scene asks for paths that see none anywhere.
pub fn nearest(wanted: &str, world: &World, in_medium: bool) -> Nearest {
    choose(wanted, world.has_media() || in_medium, world.has_subsurface())
}

fn choose(wanted: &str, media: bool, translucent: bool) -> Nearest {
    let is = |names: &[&str]| names.contains(&wanted);
    let surfaces = if media { "volpath" } else { "path" };
    let general = |name| if media || translucent { surfaces } else { name };
    let name = match wanted {
        "" => surfaces,
        "gkernel" => general("gkernel"),
        "photonmap" => general("photonmap"),
        _ if is(&PATHS) => "path",
        _ if is(&VOLUMES) => "volpath",
        _ if is(&BOTH_ENDS) => general("bdpt"),
        _ if is(&PHOTONS) => general("gkernel"),
        _ => return Nearest { name: surfaces, kind: Likeness::Unknown },
    };
    let same = wanted.is_empty() || wanted == name;
    debug_assert!(INTEGRATORS.iter().any(|e| e.name == name));
    Nearest { name, kind: if same { Likeness::Same } else { Likeness::Like } }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn media_are_seen_by_whatever_stands_for_the_scenes_method() {
        let name = |wanted, media| choose(wanted, media, false).name;
        for (wanted, without, with) in [
            ("", "path", "volpath"),
            ("path", "path", "path"),
            ("direct", "path", "path"),
            ("volpathmis", "volpath", "volpath"),
            ("prbvolpath", "volpath", "volpath"),
            ("prb", "path", "path"),
            ("ptracer", "bdpt", "volpath"),
            ("bdpt", "bdpt", "volpath"),
            ("sppm", "gkernel", "volpath"),
            ("photonmapper", "gkernel", "volpath"),
            ("gkernel", "gkernel", "volpath"),
        ] {
            assert_eq!((name(wanted, false), name(wanted, true)), (without, with), "{wanted}");
        }
        assert_eq!(choose("bdpt", false, true).name, "path");
        assert_eq!(choose("volpath", true, false).kind, Likeness::Same);
        assert_eq!(choose("volpathmis", true, false).kind, Likeness::Like);
        assert_eq!(choose("neural", true, false), Nearest { name: "volpath", kind: Likeness::Unknown });
    }
}
