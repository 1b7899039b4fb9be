//! Spectra to linear Rec. 709.
//!
//! Data: CIE 1931 colour matching functions and the relative power of illuminant D65 (CIE 015), every 5 nm. A reflectance is
//! seen under D65, so that white stays white; emitted light is taken as it is, so that equal energy is (1.20, 0.95, 0.91).
//! That is how Mitsuba's RGB variants read spectra (theirs are darker by 0.1 % for reflectances, a matter of normalisation).
//! Limits: three numbers instead of a spectrum.

use glam::{DMat3, DVec3};
use translume_bxdf::Rgb;

/// First wavelength and spacing of the table, in nm.
const FIRST: f64 = 360.0;
const STEP: f64 = 5.0;

/// x̄, ȳ, z̄ and the power of D65.
#[rustfmt::skip]
const CIE: [[f64; 4]; 95] = [
    [0.0001299, 0.000003917, 0.0006061, 46.6383],
    [0.0002321, 0.000006965, 0.001086, 49.3637],
    [0.0004149, 0.00001239, 0.001946, 52.0891],
    [0.0007416, 0.00002202, 0.003486, 51.0323],
    [0.001368, 0.000039, 0.00645, 49.9755],
    [0.002236, 0.000064, 0.01055, 52.3118],
    [0.004243, 0.00012, 0.02005, 54.6482],
    [0.00765, 0.000217, 0.03621, 68.7015],
    [0.01431, 0.000396, 0.06785, 82.7549],
    [0.02319, 0.00064, 0.1102, 87.1204],
    [0.04351, 0.00121, 0.2074, 91.486],
    [0.07763, 0.00218, 0.3713, 92.4589],
    [0.13438, 0.004, 0.6456, 93.4318],
    [0.21477, 0.0073, 1.03905, 90.057],
    [0.2839, 0.0116, 1.3856, 86.6823],
    [0.3285, 0.01684, 1.62296, 95.7736],
    [0.34828, 0.023, 1.74706, 104.865],
    [0.34806, 0.0298, 1.7826, 110.936],
    [0.3362, 0.038, 1.77211, 117.008],
    [0.3187, 0.048, 1.7441, 117.41],
    [0.2908, 0.06, 1.6692, 117.812],
    [0.2511, 0.0739, 1.5281, 116.336],
    [0.19536, 0.09098, 1.28764, 114.861],
    [0.1421, 0.1126, 1.0419, 115.392],
    [0.09564, 0.13902, 0.81295, 115.923],
    [0.05795, 0.1693, 0.6162, 112.367],
    [0.03201, 0.20802, 0.46518, 108.811],
    [0.0147, 0.2586, 0.3533, 109.082],
    [0.0049, 0.323, 0.272, 109.354],
    [0.0024, 0.4073, 0.2123, 108.578],
    [0.0093, 0.503, 0.1582, 107.802],
    [0.0291, 0.6082, 0.1117, 106.296],
    [0.06327, 0.71, 0.07825, 104.79],
    [0.1096, 0.7932, 0.05725, 106.239],
    [0.1655, 0.862, 0.04216, 107.689],
    [0.22575, 0.91485, 0.02984, 106.047],
    [0.2904, 0.954, 0.0203, 104.405],
    [0.3597, 0.9803, 0.0134, 104.225],
    [0.43345, 0.99495, 0.00875, 104.046],
    [0.51205, 1.0, 0.00575, 102.023],
    [0.5945, 0.995, 0.0039, 100.0],
    [0.6784, 0.9786, 0.00275, 98.1671],
    [0.7621, 0.952, 0.0021, 96.3342],
    [0.8425, 0.9154, 0.0018, 96.0611],
    [0.9163, 0.87, 0.00165, 95.788],
    [0.9786, 0.8163, 0.0014, 92.2368],
    [1.0263, 0.757, 0.0011, 88.6856],
    [1.0567, 0.6949, 0.001, 89.3459],
    [1.0622, 0.631, 0.0008, 90.0062],
    [1.0456, 0.5668, 0.0006, 89.8026],
    [1.0026, 0.503, 0.00034, 89.5991],
    [0.9384, 0.4412, 0.00024, 88.6489],
    [0.85445, 0.381, 0.00019, 87.6987],
    [0.7514, 0.321, 0.0001, 85.4936],
    [0.6424, 0.265, 0.00005, 83.2886],
    [0.5419, 0.217, 0.00003, 83.4939],
    [0.4479, 0.175, 0.00002, 83.6992],
    [0.3608, 0.1382, 0.00001, 81.863],
    [0.2835, 0.107, 0.0, 80.0268],
    [0.2187, 0.0816, 0.0, 80.1207],
    [0.1649, 0.061, 0.0, 80.2146],
    [0.1212, 0.04458, 0.0, 81.2462],
    [0.0874, 0.032, 0.0, 82.2778],
    [0.0636, 0.0232, 0.0, 80.281],
    [0.04677, 0.017, 0.0, 78.2842],
    [0.0329, 0.01192, 0.0, 74.0027],
    [0.0227, 0.00821, 0.0, 69.7213],
    [0.01584, 0.005723, 0.0, 70.6652],
    [0.0113592, 0.004102, 0.0, 71.6091],
    [0.00811092, 0.002929, 0.0, 72.979],
    [0.00579035, 0.002091, 0.0, 74.349],
    [0.00410946, 0.001484, 0.0, 67.9765],
    [0.00289933, 0.001047, 0.0, 61.604],
    [0.00204919, 0.00074, 0.0, 65.7448],
    [0.00143997, 0.00052, 0.0, 69.8856],
    [0.000999949, 0.0003611, 0.0, 72.4863],
    [0.000690079, 0.0002492, 0.0, 75.087],
    [0.000476021, 0.0001719, 0.0, 69.3398],
    [0.000332301, 0.00012, 0.0, 63.5927],
    [0.000234826, 0.0000848, 0.0, 55.0054],
    [0.00016615, 0.00006, 0.0, 46.4182],
    [0.000117413, 0.0000424, 0.0, 56.6118],
    [0.000083075, 0.00003, 0.0, 66.8054],
    [0.000058707, 0.0000212, 0.0, 65.0941],
    [0.00004151, 0.00001499, 0.0, 63.3828],
    [0.000029353, 0.0000106, 0.0, 63.8434],
    [0.000020674, 0.000007466, 0.0, 64.304],
    [0.00001456, 0.000005258, 0.0, 61.8779],
    [0.000010254, 0.000003703, 0.0, 59.4519],
    [0.000007221, 0.000002608, 0.0, 55.7054],
    [0.000005086, 0.000001837, 0.0, 51.959],
    [0.000003582, 0.000001293, 0.0, 54.6998],
    [0.000002523, 0.000000911, 0.0, 57.4406],
    [0.000001777, 0.000000642, 0.0, 58.8765],
    [0.000001251, 0.000000452, 0.0, 60.3125],
];

/// XYZ to linear Rec. 709, by columns.
const RGB_FROM_XYZ: DMat3 = DMat3::from_cols(
    DVec3::new(3.240479, -0.969256, 0.055648),
    DVec3::new(-1.537150, 1.875991, -0.204043),
    DVec3::new(-0.498535, 0.041556, 1.057311),
);

/// What a spectrum stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Quantity {
    /// A factor on light: reflectances, indices of refraction, coefficients.
    Factor,
    /// A number: roughness, weights, opacity. Spectra are as for factors.
    Number,
    /// Light.
    Light,
}

/// Table values at `nm`, interpolated; zero outside.
fn cie(nm: f64) -> [f64; 4] {
    let x = (nm - FIRST) / STEP;
    if !(0.0..=(CIE.len() - 1) as f64).contains(&x) {
        return [0.0; 4];
    }
    let i = (x as usize).min(CIE.len() - 2);
    let t = x - i as f64;
    std::array::from_fn(|c| CIE[i][c] * (1.0 - t) + CIE[i + 1][c] * t)
}

/// Colour of a spectrum given as a function of the wavelength in nm. Colours outside Rec. 709 are clipped at 0.
fn integrate(spectrum: impl Fn(f64) -> f64, quantity: Quantity) -> Rgb {
    unclipped(spectrum, quantity).max(DVec3::ZERO).as_vec3()
}

fn unclipped(spectrum: impl Fn(f64) -> f64, quantity: Quantity) -> DVec3 {
    let (mut xyz, mut white) = (DVec3::ZERO, 0.0);
    for nm in 360..=830 {
        let [x, y, z, d65] = cie(f64::from(nm));
        let light = if quantity == Quantity::Light { 1.0 } else { d65 };
        xyz += DVec3::new(x, y, z) * light * spectrum(f64::from(nm));
        white += y * light;
    }
    RGB_FROM_XYZ * (xyz / white)
}

/// Colour of a spectrum given at increasing wavelengths (nm), linear between and zero outside.
pub(crate) fn sampled(samples: &[(f64, f64)], quantity: Quantity) -> Rgb {
    integrate(linear(samples), quantity)
}

/// What a reflectance given at increasing wavelengths (nm) adds to red, green and blue for each of its values; linear between, so
/// not clipped. The ends go on, as a spectrometer's range says nothing of what is beyond.
pub(crate) fn reflectance_weights(nm: &[f64]) -> Vec<[f64; 3]> {
    let one = |i: usize| {
        let samples: Vec<_> = nm.iter().enumerate().map(|(k, &w)| (w, f64::from(u8::from(k == i)))).collect();
        let inside = linear(&samples);
        let value = |w: f64| inside(w.clamp(nm[0], nm[nm.len() - 1]));
        unclipped(value, Quantity::Factor).to_array()
    };
    (0..nm.len()).map(one).collect()
}

/// The function that is linear between samples and zero outside.
fn linear(samples: &[(f64, f64)]) -> impl Fn(f64) -> f64 {
    |nm: f64| {
        let after = samples.partition_point(|s| s.0 < nm);
        match (after.checked_sub(1).map(|i| samples[i]), samples.get(after)) {
            (_, Some(&(at, v))) if at == nm => v,
            (Some((w0, v0)), Some(&(w1, v1))) => v0 + (v1 - v0) * (nm - w0) / (w1 - w0),
            _ => 0.0,
        }
    }
}

/// Colour of the constant spectrum `value`.
pub(crate) fn uniform(value: f64, quantity: Quantity) -> Rgb {
    match quantity {
        Quantity::Factor | Quantity::Number => Rgb::splat(value as f32),
        Quantity::Light => integrate(|_| value, quantity),
    }
}

/// Colour of a black body of `kelvin`, by Planck's law, in W m⁻² sr⁻¹ nm⁻¹.
pub(crate) fn black_body(kelvin: f64) -> Rgb {
    const H: f64 = 6.626_070_15e-34;
    const C: f64 = 299_792_458.0;
    const K: f64 = 1.380_649e-23;
    let planck = |nm: f64| {
        let m = nm * 1e-9;
        1e-9 * 2.0 * H * C * C / (m.powi(5) * (H * C / (m * K * kelvin)).exp_m1())
    };
    integrate(planck, Quantity::Light)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(a: Rgb, b: [f32; 3], tolerance: f32) {
        assert!((a - Rgb::from(b)).abs().max_element() <= tolerance, "{a} for {b:?}");
    }

    /// Numbers from Mitsuba 3.9, `scalar_rgb`.
    #[test]
    fn spectra_have_the_colours_of_mitsuba() {
        near(uniform(2.0, Quantity::Light), [2.40959, 1.89658, 1.81783], 2e-3);
        let samples = |v: [f64; 4]| [400.0, 500.0, 600.0, 700.0].into_iter().zip(v).collect::<Vec<_>>();
        near(sampled(&samples([1.0, 2.0, 3.0, 4.0]), Quantity::Light), [4.02061, 2.31368, 1.24453], 2e-3);
        near(sampled(&samples([0.1, 0.2, 0.3, 0.4]), Quantity::Factor), [0.340779, 0.242912, 0.140304], 6e-4);
        near(sampled(&[(400.0, 1.5), (700.0, 1.2)], Quantity::Factor), [1.25177, 1.3567, 1.45155], 3e-3);
    }

    #[test]
    fn white_stays_white_and_hot_bodies_are_blue() {
        near(sampled(&[(360.0, 0.5), (830.0, 0.5)], Quantity::Factor), [0.5; 3], 1e-3);
        let (warm, hot) = (black_body(2500.0), black_body(12000.0));
        assert!(warm.x > 2.0 * warm.z && hot.z > hot.x, "{warm} {hot}");
        // D65 has a correlated colour temperature of about 6500 K.
        let day = black_body(6504.0);
        assert!((day / day.y - Rgb::ONE).abs().max_element() < 0.08, "{day}");
    }
}
