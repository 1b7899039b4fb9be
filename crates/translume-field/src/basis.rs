//! The polynomials of the RTI community: weights that are fixed functions of the light's direction.
//!
//! - PTM: Malzbender, Gelb and Wolters, "Polynomial texture maps" (SIGGRAPH 2001).
//! - HSH: Gautron et al., "A novel hemispherical basis" (EGSR 2004), orders 0 to 2.
//!
//! Order and constants are those of RelightLab's files, so that its planes are layers as they are.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

/// A set of functions on the upper hemisphere.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Basis {
    /// Biquadratic polynomial: six terms.
    Ptm,
    /// Hemispherical harmonics of orders 0 to 2: nine terms.
    Hsh,
    /// The first four of them.
    Hsh4,
}

impl Basis {
    /// Number of terms.
    pub fn terms(self) -> usize {
        match self {
            Self::Ptm => 6,
            Self::Hsh => 9,
            Self::Hsh4 => 4,
        }
    }

    /// The functions at a unit direction; below the horizon, those at the horizon.
    pub fn at(self, [x, y, z]: [f32; 3]) -> Vec<f32> {
        if self == Self::Ptm {
            return vec![1.0, x, y, x * x, x * y, y * y];
        }
        let z = z.clamp(0.0, 1.0);
        // √(z − z²) is the shifted sine of the polar angle, (cos φ, sin φ) the azimuth.
        let s = (z - z * z).sqrt();
        let across = x.hypot(y);
        let (cos, sin) = if across > 0.0 { (x / across, y / across) } else { (1.0, 0.0) };
        let (cos2, sin2) = (cos * cos - sin * sin, 2.0 * sin * cos);
        let m = 2.0 * z - 1.0;
        let [k0, k1, k2, k3, k4] = [0.5, 6.0, 1.5, 30.0, 2.5].map(|k: f32| (k / std::f32::consts::PI).sqrt());
        let mut all = vec![k0, k1 * s * cos, k2 * m, k1 * s * sin];
        if self == Self::Hsh {
            let order_2 = [-k3 * s * s * cos2, k3 * m * s * cos, k4 * (6.0 * z * z - 6.0 * z + 1.0), k3 * m * s * sin];
            all.extend(order_2);
            all.push(-k3 * s * s * sin2);
        }
        all
    }

    /// What the values under `lights` are multiplied with to give the coefficients of the least-squares fit: terms ×
    /// lights; `None` when the lights do not determine them.
    pub fn fit(self, lights: &[[f32; 3]]) -> Option<DMatrix<f64>> {
        let rows: Vec<f64> = lights.iter().flat_map(|l| self.at(*l)).map(f64::from).collect();
        let a = DMatrix::from_row_slice(lights.len(), self.terms(), &rows);
        if lights.len() < self.terms() {
            return None;
        }
        let svd = a.svd(true, true);
        let (most, least) = (svd.singular_values.max(), svd.singular_values.min());
        if least < 1e-6 * most { None } else { svd.pseudo_inverse(0.0).ok() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lights(n: usize) -> Vec<[f32; 3]> {
        (0..n)
            .map(|i| {
                let z = 1.0 - (i as f32 + 0.5) / n as f32;
                let (sin, cos) = (2.4 * i as f32).sin_cos();
                let s = (1.0 - z * z).sqrt();
                [s * cos, s * sin, z]
            })
            .collect()
    }

    #[test]
    fn a_fit_gives_back_the_coefficients_it_was_made_from() {
        for basis in [Basis::Ptm, Basis::Hsh, Basis::Hsh4] {
            let lights = lights(30);
            let truth: Vec<f32> = (0..basis.terms()).map(|j| 1.0 - 0.3 * j as f32).collect();
            let values: Vec<f64> =
                lights.iter().map(|l| basis.at(*l).iter().zip(&truth).map(|(a, b)| f64::from(a * b)).sum()).collect();
            let found = basis.fit(&lights).unwrap() * nalgebra::DVector::from_vec(values);
            assert!(found.iter().zip(&truth).all(|(f, t)| (f - f64::from(*t)).abs() < 1e-4), "{basis:?}: {found}");
            assert!(basis.fit(&lights[..3]).is_none());
            assert!(basis.fit(&vec![lights[0]; 30]).is_none());
        }
    }

    #[test]
    fn the_hemispherical_harmonics_are_orthogonal() {
        // Over the hemisphere: a uniform z and a uniform azimuth.
        let (nz, np) = (400, 24);
        let mut gram = [[0.0f64; 9]; 9];
        for i in 0..nz {
            for j in 0..np {
                let z = (i as f32 + 0.5) / nz as f32;
                let (sin, cos) = (j as f32 / np as f32 * std::f32::consts::TAU).sin_cos();
                let s = (1.0 - z * z).sqrt();
                let h = Basis::Hsh.at([s * cos, s * sin, z]);
                (0..9).for_each(|a| (0..9).for_each(|b| gram[a][b] += f64::from(h[a] * h[b]) / (nz * np) as f64));
            }
        }
        for a in 0..9 {
            for b in 0..a {
                assert!(gram[a][b].abs() < 1e-3 * (gram[a][a] * gram[b][b]).sqrt() + 1e-5, "{a} {b}: {}", gram[a][b]);
            }
        }
    }
}
