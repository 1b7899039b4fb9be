//! Exposures as people write them down.

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
}
