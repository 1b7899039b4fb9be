//! Light as the logarithm of its luminance and CIE 1976 u′v′ [Goesele 2004, §6.2 colour], "YUV" in the text.

use translume_image::colour::{Matrix, Space, product_vec, uv_to_xyz, xyz_to_uv};

/// ln Y, u′, v′.
pub(super) type Feature = [f32; 3];

/// Both ways between linear Rec. 709 and features.
pub(super) struct Colours {
    xyz_from_rgb: Matrix,
    rgb_from_xyz: Matrix,
}

impl Colours {
    pub(super) fn new() -> Self {
        Self { xyz_from_rgb: Space::REC709.rgb_to_xyz(), rgb_from_xyz: Space::REC709.xyz_to_rgb() }
    }

    pub(super) fn luminance(&self, rgb: [f32; 3]) -> f32 {
        let w = self.xyz_from_rgb[1];
        (w[0] * f64::from(rgb[0]) + w[1] * f64::from(rgb[1]) + w[2] * f64::from(rgb[2])) as f32
    }

    /// `None` for light without luminance. Noise can make a channel negative; it counts as a thousandth of the brightest.
    pub(super) fn feature(&self, rgb: [f32; 3]) -> Option<Feature> {
        let most = rgb.iter().copied().fold(0.0, f32::max);
        let xyz = product_vec(&self.xyz_from_rgb, rgb.map(|x| f64::from(x.max(1e-3 * most))));
        let white = product_vec(&self.xyz_from_rgb, [1.0; 3]);
        let [u, v] = xyz_to_uv(xyz, white);
        // [Goesele 2004, §6.2 colour]
        (xyz[1] > 0.0 && xyz[1].is_finite()).then(|| [xyz[1].ln() as f32, u as f32, v as f32])
    }

    /// The light of a feature; channels that its chromaticity would make negative are a thousandth of the brightest.
    pub(super) fn rgb(&self, [ln_y, u, v]: Feature) -> [f32; 3] {
        let xyz = uv_to_xyz(f64::from(ln_y).exp(), [f64::from(u), f64::from(v).max(1e-3)]);
        let rgb = product_vec(&self.rgb_from_xyz, xyz);
        let most = rgb.iter().copied().fold(0.0, f64::max);
        rgb.map(|x| x.max(1e-3 * most) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_and_back() {
        let colours = Colours::new();
        for rgb in [[1.0, 1.0, 1.0], [2e-5, 1e-6, 4e-7], [0.2, 0.5, 0.01]] {
            let back = colours.rgb(colours.feature(rgb).unwrap());
            assert!(rgb.iter().zip(back).all(|(a, b)| (a / b - 1.0).abs() < 1e-3), "{rgb:?} {back:?}");
        }
        assert!(colours.feature([0.0; 3]).is_none() && colours.feature([-1.0; 3]).is_none());
    }
}
