//! Exposures as people write them down, and folders that hold several brackets.

use crate::{Error, Result};

/// Seconds from `0.25`, `1/30`, `1/30s` or `2"`.
///
/// # Errors
/// [`Error::Bracket`] for what is no positive number.
pub fn parse_seconds(text: &str) -> Result<f64> {
    let t = text.trim().trim_end_matches(['s', '"', ' ']);
    let value = match t.split_once('/') {
        Some((a, b)) => a.trim().parse::<f64>().ok().zip(b.trim().parse::<f64>().ok()).map(|(a, b)| a / b),
        None => t.parse().ok().or_else(|| t.replacen(',', ".", 1).parse().ok()),
    };
    value.filter(|v| v.is_finite() && *v > 0.0).ok_or_else(|| {
        Error::Bracket(format!("exposure '{text}' is not a positive number of seconds like 0.25 or 1/30"))
    })
}

/// Name and seconds per line, as published sets ship them.
///
/// Blank lines, lines that begin with `#` and settings (`KEY=value`) are passed over. The first two fields count,
/// separated by commas, semicolons or white space. A first line without a number is a header: then the column whose
/// title has `exposure` or `second` or `time` in it holds the seconds, and the first the name.
///
/// # Errors
/// [`Error::Bracket`] with the line that cannot be read.
pub fn parse_list(text: &str) -> Result<Vec<(String, f64)>> {
    let mut column = 1;
    let mut out: Vec<(String, f64)> = Vec::new();
    let mut first = true;
    for (number, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') || line.contains('=') {
            continue;
        }
        let fields = fields(line);
        if std::mem::take(&mut first) && fields.len() > 1 && fields.iter().skip(1).all(|f| parse_seconds(f).is_err()) {
            let titled = |f: &&str| ["exposure", "second", "time"].iter().any(|w| f.to_lowercase().contains(w));
            column = fields.iter().position(titled).unwrap_or(1);
            continue;
        }
        let seconds = fields.get(column).map(|f| parse_seconds(f)).transpose().ok().flatten();
        let (Some(name), Some(seconds)) = (fields.first(), seconds) else {
            return Err(Error::Bracket(format!("line {}: '{line}' is not a file name and seconds", number + 1)));
        };
        out.push(((*name).to_owned(), seconds));
    }
    if out.is_empty() {
        return Err(Error::Bracket("no line with a file name and seconds".into()));
    }
    Ok(out)
}

/// The fields of a line. A comma is a decimal mark, not a separator, where semicolons or tabs separate, or nothing but
/// white space could.
fn fields(line: &str) -> Vec<&str> {
    if line.contains([';', '\t']) {
        return line.split([';', '\t']).map(|f| f.trim().trim_end_matches(',')).collect();
    }
    let words: Vec<&str> = line.split_whitespace().collect();
    let bare = words.iter().all(|w| !w.ends_with(',') && !w.starts_with(','));
    if line.contains(',') && !(words.len() > 1 && bare && parse_seconds(words[1]).is_ok()) {
        return line.split(',').map(str::trim).collect();
    }
    words
}

/// How a folder's pictures, in their order, fall into brackets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grouping {
    /// By the repeating pattern of the exposures; one bracket if there is none.
    Pattern,
    /// Every so many pictures.
    Count(usize),
}

/// Lengths of the brackets that pictures of these relative exposures and pixel sizes form, in order.
///
/// # Errors
/// [`Error::Bracket`] when a count does not divide the number of pictures.
pub fn group(exposures: &[f64], sizes: &[(usize, usize)], how: Grouping) -> Result<Vec<usize>> {
    let n = exposures.len();
    match how {
        Grouping::Count(k) if k >= 2 && n.is_multiple_of(k) => Ok(vec![k; n / k]),
        Grouping::Count(k) => {
            Err(Error::Bracket(format!("{n} pictures do not make brackets of {k}; check --group or the folder")))
        }
        Grouping::Pattern => {
            // Pictures of another size never belong to the bracket before.
            let mut lengths = Vec::new();
            let mut start = 0;
            for end in 1..=n {
                if end == n || sizes[end] != sizes[start] {
                    lengths.extend(periods(&exposures[start..end]));
                    start = end;
                }
            }
            Ok(lengths)
        }
    }
}

/// The shortest period of two or more after which the exposure *steps* repeat (the light may have changed meanwhile).
fn periods(exposures: &[f64]) -> Vec<usize> {
    let n = exposures.len();
    let same = |a: f64, b: f64| (a / b).ln().abs() < 0.12;
    for period in 2..=n / 2 {
        let repeats = n.is_multiple_of(period)
            && (0..n / period).all(|k| {
                (1..period)
                    .all(|i| same(exposures[k * period + i] / exposures[k * period], exposures[i] / exposures[0]))
            });
        // A monotone series repeats its steps too: a bracket must return to where it began.
        let returns = repeats
            && (1..n / period).all(|k| {
                let last = exposures[k * period - 1];
                let step = exposures[1] / exposures[0];
                !same(exposures[k * period] / last, step)
            });
        let differs = (1..period).any(|i| !same(exposures[i], exposures[0]));
        if returns && differs {
            return vec![period; n / period];
        }
    }
    vec![n]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_are_read_as_written() {
        for (t, v) in [("1/30", 1.0 / 30.0), ("0.25", 0.25), (" 2s", 2.0), ("1/4 s", 0.25)] {
            assert!((parse_seconds(t).unwrap() - v).abs() < 1e-12, "{t}");
        }
        for t in ["", "a", "0", "-1", "1/0", "nan", "inf"] {
            assert!(parse_seconds(t).is_err(), "{t}");
        }
    }

    #[test]
    fn lists_of_three_dialects_are_read() {
        let memorial = "# Filename exposure 1/shutter\nALIGN=OUR\n\nm1.png 32 0.03125 8 0 0\nm2.png 1/2 2 8 0 0\n";
        assert_eq!(parse_list(memorial).unwrap(), [("m1.png".into(), 32.0), ("m2.png".into(), 0.5)]);
        let csv = "file,size,exposure_s,f_number\na b.jpg,640x427,0.25,4\n";
        assert_eq!(parse_list(csv).unwrap(), [("a b.jpg".into(), 0.25)]);
        assert!(parse_list("a.jpg soon\nb.jpg later\n").unwrap_err().to_string().contains("line 2"));
        assert!(parse_list("# nothing\n").is_err());
    }

    #[test]
    fn patterns_are_found() {
        let size = |n: usize| vec![(4, 4); n];
        let of = |e: &[f64]| group(e, &size(e.len()), Grouping::Pattern).unwrap();
        assert_eq!(of(&[1.0, 4.0, 0.25, 2.0, 8.0, 0.5]), [3, 3]);
        assert_eq!(of(&[1.0, 2.0, 4.0, 8.0]), [4], "one series, not two");
        assert_eq!(of(&[0.25, 1.0, 4.0, 0.25, 1.0, 4.0, 0.25, 1.0, 4.0]), [3, 3, 3]);
        assert_eq!(of(&[1.0, 1.3, 2.7]), [3]);
        assert_eq!(group(&[1.0; 4], &[(1, 1), (1, 1), (2, 2), (2, 2)], Grouping::Pattern).unwrap(), [2, 2]);
        assert!(group(&[1.0; 5], &size(5), Grouping::Count(2)).is_err());
        assert_eq!(group(&[1.0; 6], &size(6), Grouping::Count(3)).unwrap(), [3, 3]);
    }
}
