//! Independent renders of one picture, averaged by their numbers of samples.

use crate::{Error, Result};

/// The channels of a render: names, and as many values each as there are pixels.
pub type Channels = Vec<(String, Vec<f32>)>;

/// Stands for no samples at all in a divisor: its square is still a positive number.
const NO_SAMPLES: f64 = 1e-100;

/// The channel that holds the number of samples of each pixel.
pub const WEIGHT: &str = "samples";

/// Averages `renders` (a name for messages, and the channels) pixel by pixel, weighted by their channel `samples`. Variances
/// of means average with the squares of the weights; `samples` adds up.
///
/// # Errors
/// [`Error::Mismatch`] for renders without weights, or of different channels or numbers of pixels.
pub fn merge(renders: &[(String, Channels)]) -> Result<Channels> {
    let Some((first_name, first)) = renders.first() else {
        return Err(Error::Mismatch("there is nothing to merge".into()));
    };
    let mut weights = Vec::new();
    for (name, channels) in renders {
        let same = channels.len() == first.len()
            && channels.iter().zip(first).all(|(a, b)| a.0 == b.0 && a.1.len() == b.1.len());
        if !same {
            return Err(Error::Mismatch(format!("{name}: other channels or another size than {first_name}")));
        }
        let weight = channels.iter().find(|c| c.0 == WEIGHT).map(|c| &c.1).ok_or_else(|| {
            Error::Mismatch(format!("{name}: no channel `{WEIGHT}`: only pictures of `translume render` can be merged"))
        })?;
        if weight.iter().any(|w| !w.is_finite() || *w < 0.0) {
            return Err(Error::Mismatch(format!("{name}: numbers of samples that are negative or not finite")));
        }
        weights.push(weight);
    }
    let total: Vec<f64> =
        (0..weights[0].len()).map(|i| weights.iter().map(|w| f64::from(w[i])).sum::<f64>().max(NO_SAMPLES)).collect();
    let merged = first.iter().enumerate().map(|(c, (name, values))| {
        let power = if name.starts_with("Variance.") { 2 } else { 1 };
        let at = |i: usize| {
            let sum: f64 =
                renders.iter().zip(&weights).map(|(r, w)| f64::from(w[i]).powi(power) * f64::from(r.1[c].1[i])).sum();
            (sum / total[i].powi(power)) as f32
        };
        let merged = match name.as_str() {
            WEIGHT => total.iter().map(|&t| t as f32).collect(),
            _ => (0..values.len()).map(at).collect(),
        };
        (name.clone(), merged)
    });
    Ok(merged.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn render(r: f32, variance: f32, samples: f32) -> Channels {
        vec![("R".into(), vec![r]), ("Variance.R".into(), vec![variance]), (WEIGHT.into(), vec![samples])]
    }

    #[test]
    fn means_and_variances_are_those_of_all_samples() {
        // Variance of a sample is 8 in both.
        let merged = merge(&[("a".into(), render(1.0, 8.0 / 10.0, 10.0)), ("b".into(), render(4.0, 8.0 / 20.0, 20.0))]);
        let merged = merged.unwrap();
        assert_eq!(merged[0].1, [3.0]);
        assert!((merged[1].1[0] - 8.0 / 30.0).abs() < 1e-6, "{}", merged[1].1[0]);
        assert_eq!(merged[2].1, [30.0]);
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let a = || ("a".to_owned(), render(1.0, 1.0, 1.0));
        let mut other = a();
        other.1[0].0 = "G".into();
        assert!(merge(&[a(), other]).unwrap_err().to_string().contains("other channels"));
        let mut bare = a();
        bare.1.pop();
        assert!(merge(&[bare]).unwrap_err().to_string().contains("samples"));
        assert!(merge(&[("a".into(), render(1.0, 1.0, -1.0))]).is_err());
        assert!(merge(&[]).is_err());
    }

    #[test]
    fn pixels_without_samples_stay_finite() {
        let merged = merge(&[("a".into(), render(0.0, 0.0, 0.0))]).unwrap();
        assert!(merged.iter().all(|c| c.1.iter().all(|v| v.is_finite())));
    }
}
