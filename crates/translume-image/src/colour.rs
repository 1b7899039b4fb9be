//! Colour spaces: RGB by primaries and white, CIE XYZ, L*a*b*, u′v′, and cone responses (LMS).
//!
//! Every matrix is derived from chromaticities here; none is pasted. RGB is linear unless a name says `srgb`. XYZ is
//! scaled so that white has Y = 1.

/// A 3 × 3 matrix, rows first.
pub type Matrix = [[f64; 3]; 3];

/// A linear RGB space: CIE 1931 xy of red, green, blue and white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Space {
    /// xy of red, green, blue.
    pub primaries: [[f64; 2]; 3],
    /// xy of R = G = B.
    pub white: [f64; 2],
}

/// xy of CIE D65 as ITU-R BT.709 rounds it.
pub const D65: [f64; 2] = [0.3127, 0.3290];
/// xy of the ACES white point (SMPTE ST 2065-1).
pub const ACES_WHITE: [f64; 2] = [0.32168, 0.33767];
/// XYZ of the ICC profile connection space, CIE D50 as the ICC rounds it.
pub const D50_XYZ: [f64; 3] = [0.9642, 1.0, 0.8249];

/// Bradford cone responses from XYZ (Lam 1985; the standard choice of ICC for adaptation).
const BRADFORD: Matrix = [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]];
/// Hunt–Pointer–Estevez cone responses from XYZ, normalised to equal energy.
const HUNT_POINTER_ESTEVEZ: Matrix = [[0.38971, 0.68898, -0.07868], [-0.22981, 1.18340, 0.04641], [0.0, 0.0, 1.0]];

impl Space {
    /// Rec. 709, which has the primaries of sRGB.
    pub const REC709: Self = Self { primaries: [[0.640, 0.330], [0.300, 0.600], [0.150, 0.060]], white: D65 };
    /// Rec. 2020.
    pub const REC2020: Self = Self { primaries: [[0.708, 0.292], [0.170, 0.797], [0.131, 0.046]], white: D65 };
    /// ACEScg (AP1).
    pub const ACESCG: Self = Self { primaries: [[0.713, 0.293], [0.165, 0.830], [0.128, 0.044]], white: ACES_WHITE };

    /// Adobe RGB (1998).
    pub const ADOBE_RGB: Self = Self { primaries: [[0.64, 0.33], [0.21, 0.71], [0.15, 0.06]], white: D65 };

    /// The spaces that pictures are written in, by the names that options take.
    pub const NAMED: [(&'static str, Self); 3] =
        [("rec709", Self::REC709), ("rec2020", Self::REC2020), ("acescg", Self::ACESCG)];

    /// The space called `name` in [`Self::NAMED`].
    pub fn named(name: &str) -> Option<Self> {
        Self::NAMED.iter().find(|s| s.0 == name).map(|s| s.1)
    }

    /// The space of OpenEXR `chromaticities`, if they span one.
    pub fn from_chromaticities(c: [[f32; 2]; 4]) -> Option<Self> {
        let [r, g, b, white] = c.map(|v| v.map(f64::from));
        let space = Self { primaries: [r, g, b], white };
        let usable = white[1].abs() > 1e-6 && c.iter().flatten().all(|v| v.is_finite());
        (usable && inverse(&space.unscaled()).is_some()).then_some(space)
    }

    /// As OpenEXR writes it.
    pub fn chromaticities(&self) -> [[f32; 2]; 4] {
        [self.primaries[0], self.primaries[1], self.primaries[2], self.white].map(|v| v.map(|v| v as f32))
    }

    /// Columns x, y, 1 − x − y of the primaries: directions in XYZ without their lengths.
    fn unscaled(&self) -> Matrix {
        transpose(&self.primaries.map(|[x, y]| [x, y, 1.0 - x - y]))
    }

    /// XYZ (relative to this space's own white) from linear RGB.
    ///
    /// # Panics
    /// If the primaries lie on a line; [`Self::from_chromaticities`] gives no such space.
    pub fn rgb_to_xyz(&self) -> Matrix {
        let directions = self.unscaled();
        let inverted = inverse(&directions).expect("primaries span a triangle");
        // Lengths such that R = G = B = 1 gives the white with Y = 1.
        let lengths = product_vec(&inverted, xy_to_xyz(self.white));
        directions.map(|row| [row[0] * lengths[0], row[1] * lengths[1], row[2] * lengths[2]])
    }

    /// Linear RGB from XYZ relative to this space's own white.
    ///
    /// # Panics
    /// As [`Self::rgb_to_xyz`].
    pub fn xyz_to_rgb(&self) -> Matrix {
        inverse(&self.rgb_to_xyz()).expect("primaries span a triangle")
    }

    /// Linear RGB of `to` from linear RGB of this space, whites adapted by Bradford.
    ///
    /// # Panics
    /// As [`Self::rgb_to_xyz`].
    pub fn to(&self, to: &Self) -> Matrix {
        let adapted = adaptation(xy_to_xyz(self.white), xy_to_xyz(to.white));
        product(&to.xyz_to_rgb(), &product(&adapted, &self.rgb_to_xyz()))
    }

    /// Linear RGB from XYZ whose white is equal energy (Radiance XYZE files).
    pub(crate) fn xyz_to_rgb_from_equal_energy(&self) -> Matrix {
        product(&self.xyz_to_rgb(), &adaptation([1.0; 3], xy_to_xyz(self.white)))
    }

    /// Weights of R, G and B in the luminance Y.
    ///
    /// # Panics
    /// As [`Self::rgb_to_xyz`].
    pub fn luminance_weights(&self) -> [f64; 3] {
        self.rgb_to_xyz()[1]
    }
}

/// XYZ with Y = 1 of a chromaticity.
pub fn xy_to_xyz([x, y]: [f64; 2]) -> [f64; 3] {
    [x / y, 1.0, (1.0 - x - y) / y]
}

/// The Bradford transform that takes colours seen under `from` (XYZ of its white) to those under `to`.
pub fn adaptation(from: [f64; 3], to: [f64; 3]) -> Matrix {
    let (cones_from, cones_to) = (product_vec(&BRADFORD, from), product_vec(&BRADFORD, to));
    let mut scaled = BRADFORD;
    for i in 0..3 {
        scaled[i] = scaled[i].map(|v| v * cones_to[i] / cones_from[i]);
    }
    product(&inverse(&BRADFORD).expect("Bradford's matrix is regular"), &scaled)
}

/// Cone responses (Hunt–Pointer–Estevez) of an XYZ colour.
pub fn xyz_to_lms(xyz: [f64; 3]) -> [f64; 3] {
    product_vec(&HUNT_POINTER_ESTEVEZ, xyz)
}

/// The inverse of [`xyz_to_lms`].
pub fn lms_to_xyz(lms: [f64; 3]) -> [f64; 3] {
    product_vec(&inverse(&HUNT_POINTER_ESTEVEZ).expect("a regular matrix"), lms)
}

/// CIE 1976 u′v′ of an XYZ colour; black has those of `white`.
pub fn xyz_to_uv([x, y, z]: [f64; 3], white: [f64; 3]) -> [f64; 2] {
    let d = x + 15.0 * y + 3.0 * z;
    if d > 0.0 { [4.0 * x / d, 9.0 * y / d] } else { xyz_to_uv(white, white) }
}

/// XYZ of luminance `y` and chromaticity u′v′ (v′ > 0).
pub fn uv_to_xyz(y: f64, [u, v]: [f64; 2]) -> [f64; 3] {
    [y * 9.0 * u / (4.0 * v), y, y * (12.0 - 3.0 * u - 20.0 * v) / (4.0 * v)]
}

/// (6/29)³, below which L*a*b* is linear.
const LAB_EPSILON: f64 = 216.0 / 24389.0;
/// (29/3)³.
const LAB_KAPPA: f64 = 24389.0 / 27.0;

/// CIE 1976 L*a*b* of an XYZ colour under `white`.
pub fn xyz_to_lab(xyz: [f64; 3], white: [f64; 3]) -> [f64; 3] {
    let f = |i: usize| {
        let t = xyz[i] / white[i];
        if t > LAB_EPSILON { t.cbrt() } else { (LAB_KAPPA * t + 16.0) / 116.0 }
    };
    let [fx, fy, fz] = [f(0), f(1), f(2)];
    [116.0 * fy - 16.0, 500.0 * (fx - fy), 200.0 * (fy - fz)]
}

/// The inverse of [`xyz_to_lab`].
pub fn lab_to_xyz([l, a, b]: [f64; 3], white: [f64; 3]) -> [f64; 3] {
    let fy = (l + 16.0) / 116.0;
    let f = [fy + a / 500.0, fy, fy - b / 200.0];
    std::array::from_fn(|i| {
        let cube = f[i].powi(3);
        white[i] * if cube > LAB_EPSILON { cube } else { (116.0 * f[i] - 16.0) / LAB_KAPPA }
    })
}

/// Linear light of an sRGB value (IEC 61966-2-1); odd about zero.
pub fn srgb_to_linear(v: f32) -> f32 {
    let a = v.abs();
    let linear = if a <= 0.04045 { a / 12.92 } else { ((a + 0.055) / 1.055).powf(2.4) };
    linear.copysign(v)
}

/// sRGB value of linear light; odd about zero.
pub fn linear_to_srgb(v: f32) -> f32 {
    let a = v.abs();
    let coded = if a <= 0.003_130_8 { a * 12.92 } else { 1.055 * a.powf(1.0 / 2.4) - 0.055 };
    coded.copysign(v)
}

/// A matrix times a pixel.
#[inline]
pub fn apply(m: &Matrix, [r, g, b]: [f32; 3]) -> [f32; 3] {
    m.map(|row| (row[0] * f64::from(r) + row[1] * f64::from(g) + row[2] * f64::from(b)) as f32)
}

/// A matrix times a vector.
pub fn product_vec(m: &Matrix, v: [f64; 3]) -> [f64; 3] {
    m.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// `a · b`.
pub fn product(a: &Matrix, b: &Matrix) -> Matrix {
    transpose(&transpose(b).map(|column| product_vec(a, column)))
}

fn transpose(m: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| m[j][i]))
}

/// The inverse by cofactors, `None` for a singular matrix.
pub fn inverse(m: &Matrix) -> Option<Matrix> {
    let minor = |i: usize, j: usize| {
        let (r, s) = ((i + 1) % 3, (i + 2) % 3);
        let (c, d) = ((j + 1) % 3, (j + 2) % 3);
        m[r][c] * m[s][d] - m[r][d] * m[s][c]
    };
    let determinant: f64 = (0..3).map(|j| m[0][j] * minor(0, j)).sum();
    if !determinant.is_finite() || determinant.abs() < 1e-9 {
        return None;
    }
    Some(std::array::from_fn(|i| std::array::from_fn(|j| minor(j, i) / determinant)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(got: &[f64], expected: &[f64], tolerance: f64) {
        for (g, e) in got.iter().zip(expected) {
            assert!((g - e).abs() < tolerance, "{got:?} instead of {expected:?}");
        }
    }

    #[test]
    fn matrices_agree_with_the_standards() {
        // BT.709 luminance; IEC 61966-2-1 prints four digits of the matrix.
        near(&Space::REC709.luminance_weights(), &[0.2126, 0.7152, 0.0722], 5e-5);
        let srgb = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]];
        near(Space::REC709.rgb_to_xyz().as_flattened(), srgb.as_flattened(), 6e-5);
        // BT.2020 §4: Y' = 0.2627 R' + 0.6780 G' + 0.0593 B'.
        near(&Space::REC2020.luminance_weights(), &[0.2627, 0.6780, 0.0593], 5e-5);
        // ACES, S-2014-004: AP1 to XYZ.
        let ap1 = [
            [0.662_454_181_1, 0.134_004_206_5, 0.156_187_687_0],
            [0.272_228_716_8, 0.674_081_765_8, 0.053_689_517_4],
            [-0.005_574_649_5, 0.004_060_733_5, 1.010_339_100_3],
        ];
        near(Space::ACESCG.rgb_to_xyz().as_flattened(), ap1.as_flattened(), 1e-9);
        // BT.2087: Rec. 709 to Rec. 2020.
        let to2020 = [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]];
        near(Space::REC709.to(&Space::REC2020).as_flattened(), to2020.as_flattened(), 6e-5);
    }

    #[test]
    fn white_stays_white_between_spaces_and_conversions_go_round() {
        for a in [Space::REC709, Space::REC2020, Space::ACESCG] {
            for b in [Space::REC709, Space::REC2020, Space::ACESCG] {
                near(&product_vec(&a.to(&b), [1.0; 3]), &[1.0; 3], 1e-12);
                let v = [0.2, 0.7, -0.1];
                near(&product_vec(&b.to(&a), product_vec(&a.to(&b), v)), &v, 1e-12);
            }
            assert_eq!(
                Space::from_chromaticities(a.chromaticities()).map(|s| s.chromaticities()),
                Some(a.chromaticities())
            );
        }
        let white = xy_to_xyz(D65);
        for xyz in [[0.3, 0.4, 0.2], [0.001, 0.002, 0.003], white] {
            near(&lab_to_xyz(xyz_to_lab(xyz, white), white), &xyz, 1e-12);
            near(&lms_to_xyz(xyz_to_lms(xyz)), &xyz, 1e-12);
            near(&uv_to_xyz(xyz[1], xyz_to_uv(xyz, white)), &xyz, 1e-12);
        }
    }

    #[test]
    fn known_colours() {
        let white = product_vec(&Space::REC709.rgb_to_xyz(), [1.0; 3]);
        near(&xyz_to_lab(white, white), &[100.0, 0.0, 0.0], 1e-9);
        near(&xyz_to_lab([0.0; 3], white), &[0.0; 3], 1e-9);
        // Red of sRGB in CIELAB under D65, as every colour calculator has it.
        let red = product_vec(&Space::REC709.rgb_to_xyz(), [1.0, 0.0, 0.0]);
        near(&xyz_to_lab(red, white), &[53.24, 80.09, 67.20], 0.02);
        // u′v′ of D65: 0.1978, 0.4683.
        near(&xyz_to_uv(white, white), &[0.1978, 0.4683], 5e-5);
        near(&xyz_to_uv([0.0; 3], white), &[0.1978, 0.4683], 5e-5);
        // Hunt–Pointer–Estevez cones are equal for equal energy.
        near(&xyz_to_lms([1.0; 3]), &[1.0; 3], 1.1e-5);
        // Bradford from D65 to D50, as Lindbloom tabulates it.
        let d65_to_d50 = adaptation([0.95047, 1.0, 1.08883], [0.96422, 1.0, 0.82521]);
        let printed = [
            [1.047_811_2, 0.022_886_6, -0.050_127_0],
            [0.029_542_4, 0.990_484_4, -0.017_049_1],
            [-0.009_234_5, 0.015_043_6, 0.752_131_6],
        ];
        near(d65_to_d50.as_flattened(), printed.as_flattened(), 1e-4);
    }

    #[test]
    fn the_srgb_curve_is_continuous_and_goes_round() {
        for i in -20..=1020 {
            let v = i as f32 / 1000.0;
            assert!((linear_to_srgb(srgb_to_linear(v)) - v).abs() < 1e-5, "{v}");
        }
        assert!((srgb_to_linear(0.5) - 0.214_041_14).abs() < 1e-6);
    }

    #[test]
    fn primaries_on_a_line_are_no_space() {
        assert_eq!(Space::from_chromaticities([[0.1, 0.1], [0.2, 0.2], [0.3, 0.3], [0.33, 0.33]]), None);
        assert_eq!(Space::from_chromaticities([[0.6, 0.3], [0.3, 0.6], [0.1, 0.1], [0.33, 0.0]]), None);
        assert_eq!(Space::from_chromaticities([[f32::NAN; 2]; 4]), None);
    }
}
