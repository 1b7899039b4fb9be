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
