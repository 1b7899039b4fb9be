//! The primaries of encoded pictures, for pipelines that find the transfer curve themselves.

use crate::Metadata;
use crate::colour::{self, Matrix, Space};
use moxcms::{ColorProfile, DataColorSpace};

/// Linear Rec. 709 from the linearised RGB of a picture with this metadata: `None` where that is no change.
///
/// OpenEXR `chromaticities` come first, then the colorants of an RGB matrix profile (relative to D50, as the ICC has
/// them). Profiles of other kinds (tables, gray) say nothing about primaries and count as Rec. 709.
pub fn to_rec709(metadata: &Metadata) -> Option<Matrix> {
    if let Some(space) = metadata.chromaticities.and_then(Space::from_chromaticities) {
        return differs_from_identity(space.to(&Space::REC709));
    }
    let profile = match ColorProfile::new_from_slice(metadata.icc.as_deref()?) {
        Ok(profile) => profile,
        Err(e) => {
            log::warn!("an embedded ICC profile cannot be used ({e}): the primaries are taken for those of Rec. 709");
            return None;
        }
    };
    if profile.color_space != DataColorSpace::Rgb {
        return None;
    }
    // A matrix profile's white is D50: its rows sum to it. Anything else is no matrix profile.
    let white: Vec<f64> = profile.colorant_matrix().v.iter().map(|row| row.iter().sum()).collect();
    if white.iter().zip(colour::D50_XYZ).any(|(a, b)| (a - b).abs() > 0.01) {
        return None;
    }
    differs_from_identity(matrix_of(&profile))
}

/// Linear Rec. 709 from the linearised RGB of a matrix profile, by its colorants.
pub(crate) fn matrix_of(profile: &ColorProfile) -> Matrix {
    let from_pcs = colour::adaptation(colour::D50_XYZ, colour::xy_to_xyz(colour::D65));
    colour::product(&Space::REC709.xyz_to_rgb(), &colour::product(&from_pcs, &profile.colorant_matrix().v))
}

fn differs_from_identity(m: Matrix) -> Option<Matrix> {
    let identity = |i: usize, j: usize| if i == j { 1.0 } else { 0.0 };
    let far = (0..3).any(|i| (0..3).any(|j| (m[i][j] - identity(i, j)).abs() > 2e-3));
    far.then_some(m)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_icc(profile: &ColorProfile) -> Metadata {
        Metadata { icc: Some(profile.encode().unwrap()), ..Metadata::default() }
    }

    #[test]
    fn srgb_needs_no_matrix_and_display_p3_does() {
        assert!(to_rec709(&Metadata::default()).is_none());
        assert!(to_rec709(&with_icc(&ColorProfile::new_srgb())).is_none());
        let m = to_rec709(&with_icc(&ColorProfile::new_display_p3())).unwrap();
        // Known: linear P3 red in Rec. 709 is (1.2249, −0.0420, −0.0196); white stays white.
        for (row, red) in m.iter().zip([1.2249, -0.0420, -0.0196]) {
            assert!((row[0] - red).abs() < 2e-3, "{m:?}");
            assert!((row.iter().sum::<f64>() - 1.0).abs() < 2e-3);
        }
    }

    #[test]
    fn damaged_profiles_say_nothing() {
        let m = Metadata { icc: Some(vec![7; 200]), ..Metadata::default() };
        assert!(to_rec709(&m).is_none());
    }
}
