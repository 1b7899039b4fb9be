//! Directions in the names of the pictures: `ball_t{theta}_p{phi}.exr`.
//!
//! A pattern is a file name with `{x}`, `{y}` and `{z}`, or with `{theta}` and `{phi}`, in the places of numbers (a sign, digits,
//! a point and digits), and `{*}` for anything. Angles are degrees: theta from the view (0: the lamp is at the camera), phi about it,
//! from the right (0) over the top (90). `{vtheta}` and `{vphi}` are the same of the camera, for pictures from several views.

use crate::lights::{Shot, normalised, pictures};
use crate::{Error, Result};
use std::path::Path;

#[derive(Debug, PartialEq)]
enum Part<'a> {
    Text(&'a str),
    /// One of [`NUMBERS`].
    Number(usize),
    Any,
}

const NUMBERS: [&str; 7] = ["x", "y", "z", "theta", "phi", "vtheta", "vphi"];

/// The pictures of `folder` whose names fit `pattern`, with the directions there, and how many do not fit.
///
/// # Errors
/// [`Error::Parameter`] for a pattern that is none; [`Error::Invalid`] for directions that are none; [`Error::Io`].
pub fn find(folder: &Path, pattern: &str) -> Result<(Vec<Shot>, usize)> {
    let parts = parse(pattern)?;
    let (mut shots, mut others) = (Vec::new(), 0);
    for path in pictures(folder)? {
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let mut values = [0.0; 7];
        if !fits(&name, &parts, &mut values) {
            others += 1;
            continue;
        }
        let [x, y, z, theta, phi, vtheta, vphi] = values;
        let polar = |theta: f64, phi: f64| {
            let ((sin, cos), (up, right)) = (theta.to_radians().sin_cos(), phi.to_radians().sin_cos());
            [sin * right, sin * up, cos]
        };
        let light = if parts.contains(&Part::Number(3)) { polar(theta, phi) } else { [x, y, z] };
        let light =
            normalised(light.map(|v| v as f32)).ok_or_else(|| Error::invalid(&path, "the name holds no direction"))?;
        let view = parts.contains(&Part::Number(5)).then(|| polar(vtheta, vphi).map(|v| v as f32));
        shots.push(Shot { view, ..Shot::new(path, light) });
    }
    Ok((shots, others))
}

fn parse(pattern: &str) -> Result<Vec<Part<'_>>> {
    let wrong = |what: &str| Error::Parameter(format!("the pattern {pattern}: {what}"));
    let (mut parts, mut rest) = (Vec::new(), pattern);
    while let Some(open) = rest.find('{') {
        let (text, after) = rest.split_at(open);
        let close = after.find('}').ok_or_else(|| wrong("a { without }"))?;
        let name = &after[1..close];
        if !text.is_empty() {
            parts.push(Part::Text(text));
        } else if !parts.is_empty() {
            return Err(wrong("two places without anything between them"));
        }
        let number = NUMBERS.iter().position(|n| *n == name);
        let part = match number {
            Some(i) => Part::Number(i),
            None if name == "*" => Part::Any,
            None => return Err(wrong("places are {x}, {y}, {z}, or {theta}, {phi}, then {vtheta}, {vphi}, and {*}")),
        };
        if parts.contains(&part) && part != Part::Any {
            return Err(wrong("a place occurs twice"));
        }
        parts.push(part);
        rest = &after[close + 1..];
    }
    if !rest.is_empty() {
        parts.push(Part::Text(rest));
    }
    let has = |i| parts.contains(&Part::Number(i));
    match [has(0), has(1), has(2), has(3), has(4)] {
        _ if has(5) != has(6) => Err(wrong("{vtheta} and {vphi} are wanted, or none of them")),
        [true, true, true, false, false] | [false, false, false, true, true] => Ok(parts),
        _ => Err(wrong("{x}, {y} and {z}, or {theta} and {phi} are wanted")),
    }
}

fn fits(name: &str, parts: &[Part], values: &mut [f64; 7]) -> bool {
    match parts {
        [] => name.is_empty(),
        [Part::Text(text), rest @ ..] => name.strip_prefix(text).is_some_and(|n| fits(n, rest, values)),
        [Part::Number(i), rest @ ..] => {
            let length = number_length(name);
            name[..length].parse().is_ok_and(|v| {
                values[*i] = v;
                fits(&name[length..], rest, values)
            })
        }
        [Part::Any, rest @ ..] => {
            name.char_indices().any(|(i, _)| fits(&name[i..], rest, values)) || fits("", rest, values)
        }
    }
}

/// Length of the number that `text` begins with; a point counts if a digit follows.
fn number_length(text: &str) -> usize {
    let bytes = text.as_bytes();
    let digits = |from: usize| bytes[from..].iter().take_while(|b| b.is_ascii_digit()).count();
    let sign = usize::from(matches!(bytes.first(), Some(b'+' | b'-')));
    let whole = sign + digits(sign);
    match bytes.get(whole) {
        Some(b'.') if digits(whole + 1) > 0 => whole + 1 + digits(whole + 1),
        _ => whole,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn directions(pattern: &str, files: &[&str]) -> Result<(Vec<[f32; 3]>, usize)> {
        let dir = tempfile::tempdir().unwrap();
        files.iter().for_each(|f| std::fs::write(dir.path().join(f), "").unwrap());
        let (shots, others) = find(dir.path(), pattern)?;
        Ok((shots.iter().map(|s| s.light).collect(), others))
    }

    #[test]
    fn directions_are_read_off_names() {
        let near = |a: [f32; 3], b: [f32; 3]| (0..3).all(|c| (a[c] - b[c]).abs() < 1e-6);
        let files = ["a_t90_p0.png", "a_t90_p90.png", "b_t45.0_p-90.png", "other.png"];
        let (found, others) = directions("{*}_t{theta}_p{phi}.png", &files).unwrap();
        let half = 0.5f32.sqrt();
        let wanted = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -half, half]];
        assert!(others == 1 && found.len() == 3, "{found:?}");
        assert!(wanted.iter().all(|w| found.iter().any(|f| near(*f, *w))), "{found:?}");
        let (found, _) = directions("x{x}y{y}z{z}.exr", &["x0y-3.0z4.exr"]).unwrap();
        assert!(near(found[0], [0.0, -0.6, 0.8]));
        // As the Bonn BTFs name them.
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("7 tl045 pl180 tv090 pv090.jpg"), "").unwrap();
        let shot = find(dir.path(), "{*} tl{theta} pl{phi} tv{vtheta} pv{vphi}.jpg").unwrap().0.swap_remove(0);
        assert!(near(shot.light, [-half, 0.0, half]) && near(shot.view.unwrap(), [0.0, 1.0, 0.0]), "{shot:?}");
    }

    #[test]
    fn patterns_that_are_none_are_refused() {
        for (pattern, what) in [
            ("a.png", "are wanted"),
            ("{x}_{y}.png", "are wanted"),
            ("{theta}_{phi}_{x}.png", "are wanted"),
            ("{theta}{phi}", "between"),
            ("{theta}_{phi", "without"),
            ("{t}_{phi}", "places are"),
            ("{theta}_{theta}_{phi}", "twice"),
            ("{theta}_{phi}_{vphi}", "or none of them"),
        ] {
            let error = directions(pattern, &[]).unwrap_err().to_string();
            assert!(error.contains(what), "{pattern}: {error}");
        }
        assert!(directions("{x}_{y}_{z}.png", &["0_0_0.png"]).is_err());
    }
}
