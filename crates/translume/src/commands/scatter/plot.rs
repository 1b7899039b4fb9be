//! A plot of reflectance against distance as SVG: logarithmic upwards, samples as dots, models as lines.

use std::fmt::Write as _;
use std::path::Path;
use translume_image::atomic;

/// A model in a plot: its name, its colour and its value at a distance in mm.
pub(super) struct Line<'a> {
    pub(super) name: &'a str,
    pub(super) color: &'a str,
    pub(super) value: Box<dyn Fn(f64) -> Option<f64> + 'a>,
}

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 420.0;
const MARGIN: f64 = 56.0;
/// More samples than this are thinned out.
const DOTS: usize = 3000;

/// Writes samples (distance in mm, R_d in mm⁻²; those of 0 are not shown) and lines.
pub(super) fn write(path: &Path, samples: &[[f64; 2]], lines: &[Line<'_>]) -> anyhow::Result<()> {
    let shown: Vec<[f64; 2]> = samples.iter().copied().filter(|s| s[1] > 0.0).collect();
    let reach = shown.iter().map(|s| s[0]).fold(0.1, f64::max);
    let low = shown.iter().map(|s| s[1]).fold(f64::INFINITY, f64::min).min(1.0).log10().floor();
    let high = shown.iter().map(|s| s[1]).fold(0.0, f64::max).max(1e-12).log10().ceil().max(low + 1.0);
    let x = |r: f64| MARGIN + r / reach * (WIDTH - MARGIN - 12.0);
    let y = |v: f64| HEIGHT - 40.0 - (v.log10() - low) / (high - low) * (HEIGHT - 60.0);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\" font-size=\"13\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
    );
    for decade in low as i32..=high as i32 {
        let at = y(10f64.powi(decade));
        let _ = writeln!(
            svg,
            "<path d=\"M{MARGIN} {at:.1}H{}\" stroke=\"#ddd\"/><text x=\"6\" y=\"{:.1}\">1e{decade}</text>",
            WIDTH - 12.0,
            at + 4.0
        );
    }
    let step = [0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0].into_iter().find(|s| reach / s < 10.0).unwrap_or(100.0);
    for i in 0..=(reach / step) as usize {
        let r = i as f64 * step;
        let _ = writeln!(svg, "<text x=\"{:.1}\" y=\"{}\">{r}</text>", x(r) - 4.0, HEIGHT - 24.0);
    }
    let _ = writeln!(svg, "<text x=\"{}\" y=\"{}\">distance in mm; R in mm⁻²</text>", WIDTH / 2.0, HEIGHT - 6.0);
    for s in shown.iter().step_by(shown.len().div_ceil(DOTS).max(1)) {
        let _ = writeln!(svg, "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"1.2\" fill=\"#999\"/>", x(s[0]), y(s[1]));
    }
    for (i, line) in lines.iter().enumerate() {
        let mut path = String::new();
        for k in 0..=200 {
            let r = reach * f64::from(k) / 200.0;
            let value = (line.value)(r).filter(|v| *v > 10f64.powf(low) && *v < 10f64.powf(high));
            if let Some(v) = value {
                let _ = write!(path, "{}{:.1} {:.1}", if path.is_empty() { 'M' } else { 'L' }, x(r), y(v));
            }
        }
        let color = line.color;
        let _ = writeln!(svg, "<path d=\"{path}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"2\"/>");
        if !line.name.is_empty() {
            let at = 24.0 + 17.0 * i as f64;
            let name = crate::commands::page::escape(line.name);
            let _ = writeln!(svg, "<text x=\"{}\" y=\"{at}\" fill=\"{color}\">{name}</text>", WIDTH - 210.0);
        }
    }
    svg.push_str("</svg>\n");
    Ok(atomic::write_bytes(path, svg.as_bytes())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn brighter_is_higher_and_farther_is_more_to_the_right() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("p.svg");
        let line = Line { name: "a<b", color: "#c00", value: Box::new(|r| Some((-r).exp())) };
        write(&path, &[[0.5, 0.5], [4.0, 0.02], [5.0, 0.0]], &[line]).unwrap();
        let svg = std::fs::read_to_string(path).unwrap();
        let dots: Vec<Vec<f64>> = svg
            .lines()
            .filter(|l| l.starts_with("<circle"))
            .map(|l| l.split('"').filter_map(|n| n.parse().ok()).collect())
            .collect();
        assert!(dots.len() == 2 && dots[0][0] < dots[1][0] && dots[0][1] < dots[1][1], "{dots:?}");
        assert!(svg.contains("a&lt;b") && !svg.contains("NaN"));
    }
}
