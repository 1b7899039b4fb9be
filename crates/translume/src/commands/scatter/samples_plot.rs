//! A plot of reflectance against distance: samples as dots, models as curves.

use crate::commands::plot::{Axis, Marks, Plot, Series, Shape};
use std::path::Path;
use translume_image::atomic;

/// A model in a plot: its name, its colour and its value at a distance in mm.
pub(super) struct Line<'a> {
    pub(super) name: &'a str,
    pub(super) color: &'a str,
    pub(super) value: Box<dyn Fn(f64) -> Option<f64> + 'a>,
}

/// Writes samples (distance in mm, R_d in mm⁻²; those of 0 are not shown) and lines.
pub(super) fn write(path: &Path, samples: &[[f64; 2]], lines: &[Line<'_>]) -> anyhow::Result<()> {
    let shown: Vec<[f64; 2]> = samples.iter().copied().filter(|s| s[1] > 0.0).collect();
    let reach = shown.iter().map(|s| s[0]).fold(0.1, f64::max);
    let low = shown.iter().map(|s| s[1]).fold(f64::INFINITY, f64::min).min(1.0).log10().floor();
    let high = shown.iter().map(|s| s[1]).fold(0.0, f64::max).max(1e-12).log10().ceil().max(low + 1.0);
    let step = [0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0].into_iter().find(|s| reach / s < 10.0).unwrap_or(100.0);
    let mut series = vec![Series { name: "", color: "#999", points: shown, shape: Shape::Dots(1.2) }];
    series.extend(lines.iter().map(|line| {
        let distances = (0..=200).map(|k| reach * f64::from(k) / 200.0);
        // A distance without value leaves a gap.
        let points = distances.map(|r| [r, (line.value)(r).unwrap_or(f64::NAN)]).collect();
        Series { name: line.name, color: line.color, points, shape: Shape::Curve }
    }));
    let plot = Plot {
        x: Axis { title: "distance in mm", range: (0.0, reach), marks: Marks::Every(step) },
        y: Axis { title: "R in mm⁻²", range: (10f64.powf(low), 10f64.powf(high)), marks: Marks::Decades },
        series,
    };
    Ok(atomic::write_bytes(path, plot.svg().as_bytes())?)
}
