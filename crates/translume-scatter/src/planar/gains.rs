//! A gain for each frame, where the laser's power drifts.
//!
//! One frame alone cannot tell a stronger beam from a brighter place. Two frames can: transport is reciprocal, so what the
//! beam at i sends to the place of j is what the beam at j sends to the place of i, when both are weighted by the same beam.
//! Hence ln g_i − ln g_j = ln s(i → j) − ln s(j → i) for each pair, and the gains, whose logarithms are 0 in the mean, are the least
//! squares solution. Light that enters along the beam and light that leaves in all directions are not quite the same; on the
//! virtual media that is below 2 %.

use super::samples::PlanarCapture;
use crate::gains::{PAIRS, SEEN, solve};
use rayon::prelude::*;
use translume_image::Result;

/// Gains for each spot and channel, 1 where a spot has no pairs.
///
/// # Errors
/// Those of reading frames.
pub fn estimate_gains(capture: &PlanarCapture) -> Result<Vec<Vec<f64>>> {
    let channels = capture.capture.rig.channels.len();
    let received: Vec<Vec<Vec<(usize, f64)>>> =
        (0..capture.spots.len()).into_par_iter().map(|i| from_spot(capture, i)).collect::<Result<_>>()?;
    let mut gains = vec![vec![1.0; channels]; capture.spots.len()];
    for channel in 0..channels {
        let pairs = pairs(&received, channel);
        for (gain, ln) in gains.iter_mut().zip(solve(&pairs)) {
            gain[channel] = ln.exp();
        }
    }
    Ok(gains)
}

/// What a spot sends to others of its view, per channel: their numbers and R_d under the beam's profile there.
fn from_spot(capture: &PlanarCapture, from: usize) -> Result<Vec<Vec<(usize, f64)>>> {
    let spot = &capture.spots[from];
    let beam = capture.capture.rig.laser.beam_diameter_mm;
    let near = |p: [f64; 2], q: [f64; 2]| (p[0] - q[0]).hypot(p[1] - q[1]);
    let others: Vec<usize> = (0..capture.spots.len())
        .filter(|&j| {
            let other = &capture.spots[j];
            other.frame[0] == spot.frame[0] && (PAIRS.0..=PAIRS.1).contains(&(near(other.at, spot.at) / beam))
        })
        .collect();
    let channel = |channel: usize| -> Result<Vec<(usize, f64)>> {
        let values = capture.reflectance(spot, channel)?;
        let sigma = beam / 4.0;
        let under = |&j: &usize| {
            let (mut sum, mut seen, mut all) = (0.0, 0.0, 0.0);
            for (value, place) in values.iter().zip(capture.places(spot.frame[0])) {
                let weight = (-0.5 * (near(place, capture.spots[j].at) / sigma).powi(2)).exp();
                if weight > 1e-3 {
                    all += weight;
                    (sum, seen) = match *value > 0.0 {
                        true => (sum + weight * f64::from(*value), seen + weight),
                        false => (sum, seen),
                    };
                }
            }
            (seen > 0.0 && seen >= SEEN * all).then(|| (j, sum / seen))
        };
        Ok(others.iter().filter_map(under).collect())
    };
    (0..capture.capture.rig.channels.len()).map(channel).collect()
}

/// For each spot its partners and the logarithm of what it sends over what it gets.
fn pairs(received: &[Vec<Vec<(usize, f64)>>], channel: usize) -> Vec<Vec<(usize, f64)>> {
    let back = |from: usize, to: usize| {
        let all = &received[from][channel];
        all.iter().find(|(j, _)| *j == to).map(|(_, value)| *value)
    };
    let of = |i: usize| {
        let all = received[i][channel].iter();
        all.filter_map(|&(j, there)| Some((j, (there / back(j, i)?).ln()))).collect()
    };
    (0..received.len()).map(of).collect()
}
