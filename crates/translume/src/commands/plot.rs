//! Plots as SVG: curves and dots over two axes, each linear or logarithmic.

use super::page::escape;
use std::fmt::Write as _;

/// A plot.
pub(crate) struct Plot<'a> {
    pub(crate) x: Axis<'a>,
    pub(crate) y: Axis<'a>,
    /// Drawn in this order, the last on top.
    pub(crate) series: Vec<Series<'a>>,
}

/// One axis.
#[derive(Clone, Copy)]
pub(crate) struct Axis<'a> {
    /// What is along it, with its unit.
    pub(crate) title: &'a str,
    /// Its ends, the first below the second; of a logarithmic one above 0.
    pub(crate) range: (f64, f64),
    /// Where its marks are.
    pub(crate) marks: Marks,
}

/// The marks of an axis.
#[derive(Clone, Copy)]
pub(crate) enum Marks {
    /// At the multiples of a step; the axis is linear.
    Every(f64),
    /// At the powers of ten; the axis is logarithmic.
    Decades,
}

/// Values of one kind.
pub(crate) struct Series<'a> {
    /// In the legend, unless it is empty.
    pub(crate) name: &'a str,
    /// Colour in the words of CSS.
    pub(crate) color: &'a str,
    /// Those outside of the axes are left out.
    pub(crate) points: Vec<[f64; 2]>,
    pub(crate) shape: Shape,
}

/// What is drawn of a series.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Shape {
    /// A curve through the points in their order.
    Curve,
    /// Dots of this radius. Of very many, some.
    Dots(f64),
}

const WIDTH: f64 = 720.0;
const HEIGHT: f64 = 420.0;
/// Left, right, top and bottom.
const MARGIN: [f64; 4] = [64.0, 16.0, 14.0, 48.0];
/// Dots of a series; more are thinned out.
const MAX_DOTS: usize = 3000;

impl Axis<'_> {
    /// The share of the axis below `value`.
    fn share(&self, value: f64) -> f64 {
        let scale = |v: f64| if matches!(self.marks, Marks::Decades) { v.log10() } else { v };
        let (low, high) = self.range;
        (scale(value) - scale(low)) / (scale(high) - scale(low))
    }

    fn holds(&self, value: f64) -> bool {
        value >= self.range.0 && value <= self.range.1
    }

    fn marks(&self) -> Vec<f64> {
        let (low, high) = self.range;
        match self.marks {
            Marks::Every(step) => {
                ((low / step).ceil() as i64..=(high / step + 1e-9).floor() as i64).map(|k| k as f64 * step).collect()
            }
            Marks::Decades => ((low.log10() - 1e-9).ceil() as i32..=(high.log10() + 1e-9).floor() as i32)
                .map(|k| 10f64.powi(k))
                .collect(),
        }
    }
}

/// A mark's number, short.
fn number(value: f64) -> String {
    let rounded = (value * 1e6).round() / 1e6;
    if value != 0.0 && rounded.abs() < 1e-4 { format!("{value:e}") } else { format!("{rounded}") }
}

impl Plot<'_> {
    /// As a document of its own, which may also stand within HTML.
    pub(crate) fn svg(&self) -> String {
        let [left, right, top, bottom] = MARGIN;
        let x = |v: f64| left + self.x.share(v) * (WIDTH - left - right);
        let y = |v: f64| HEIGHT - bottom - self.y.share(v) * (HEIGHT - top - bottom);
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\" font-size=\"13\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
        );
        for value in self.y.marks() {
            let at = y(value);
            let _ = writeln!(
                svg,
                "<path d=\"M{left} {at:.1}H{}\" stroke=\"#ddd\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                WIDTH - right,
                left - 8.0,
                at + 4.0,
                number(value)
            );
        }
        for value in self.x.marks() {
            let at = x(value);
            let _ = writeln!(
                svg,
                "<path d=\"M{at:.1} {top}V{}\" stroke=\"#eee\"/><text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                HEIGHT - bottom,
                HEIGHT - bottom + 18.0,
                number(value)
            );
        }
        let (across, up) = (escape(self.x.title), escape(self.y.title));
        let _ = writeln!(
            svg,
            "<text x=\"{:.0}\" y=\"{}\" text-anchor=\"middle\">{across}</text>\
             <text transform=\"translate(14 {:.0}) rotate(-90)\" text-anchor=\"middle\">{up}</text>",
            (WIDTH + left) / 2.0,
            HEIGHT - 8.0,
            (HEIGHT - bottom) / 2.0
        );
        let mut named = 0;
        for series in &self.series {
            let color = series.color;
            let inside = |p: &&[f64; 2]| self.x.holds(p[0]) && self.y.holds(p[1]);
            match series.shape {
                Shape::Curve => {
                    let mut path = String::new();
                    let mut before = false;
                    for p in &series.points {
                        let now = inside(&p);
                        if now {
                            let _ = write!(path, "{}{:.1} {:.1}", if before { 'L' } else { 'M' }, x(p[0]), y(p[1]));
                        }
                        before = now;
                    }
                    let _ = writeln!(svg, "<path d=\"{path}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"2\"/>");
                }
                Shape::Dots(radius) => {
                    let shown: Vec<&[f64; 2]> = series.points.iter().filter(inside).collect();
                    for p in shown.iter().step_by(shown.len().div_ceil(MAX_DOTS).max(1)) {
                        let (x, y) = (x(p[0]), y(p[1]));
                        let _ = writeln!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" fill=\"{color}\"/>");
                    }
                }
            }
            if !series.name.is_empty() {
                let (at, name) = (top + 18.0 + 17.0 * f64::from(named), escape(series.name));
                named += 1;
                let _ = writeln!(
                    svg,
                    "<text x=\"{}\" y=\"{at}\" fill=\"{color}\" text-anchor=\"end\">{name}</text>",
                    WIDTH - right - 8.0
                );
            }
        }
        svg + "</svg>\n"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn brighter_is_higher_and_farther_is_more_to_the_right() {
        let dots = Series {
            name: "a<b",
            color: "#999",
            points: vec![[0.5, 0.5], [4.0, 0.02], [5.0, 0.0], [9.0, 0.1]],
            shape: Shape::Dots(1.5),
        };
        let curve = |from: i32, to: i32| (from..=to).map(|k| [f64::from(k), 10f64.powi(-k)]).collect();
        let curve = Series { name: "", color: "#c00", points: curve(-1, 3), shape: Shape::Curve };
        let plot = Plot {
            x: Axis { title: "r", range: (0.0, 5.0), marks: Marks::Every(1.0) },
            y: Axis { title: "R", range: (1e-2, 1.0), marks: Marks::Decades },
            series: vec![dots, curve],
        };
        let svg = plot.svg();
        let numbers = |line: &str| -> Vec<f64> { line.split('"').filter_map(|n| n.parse().ok()).collect() };
        let dots: Vec<Vec<f64>> = svg.lines().filter(|l| l.starts_with("<circle")).map(numbers).collect();
        // Zero has no logarithm, and 9 is beyond the axis.
        assert!(dots.len() == 2 && dots[0][0] < dots[1][0] && dots[0][1] < dots[1][1], "{dots:?}");
        // 10^−k runs straight down, from corner to corner of (0, 1) and (2, 0.01).
        assert!(svg.contains("<path d=\"M64.0 14.0L192.0 193.0L320.0 372.0\""), "{svg}");
        assert!(svg.contains("a&lt;b") && !svg.contains("NaN") && svg.matches("text-anchor=\"middle\">").count() == 8);
    }
}
