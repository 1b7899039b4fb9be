//! Lines of text formats.

use crate::error::{Fault, invalid};

/// `text` without a mark of its encoding; UTF-16 is refused.
pub(crate) fn text(bytes: &[u8]) -> std::result::Result<&[u8], Fault> {
    if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
        return Err(Fault::Unsupported("UTF-16 text; save it as UTF-8".into()));
    }
    Ok(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes))
}

/// All lines, comments after `#` off, with their numbers from 1; any line ends.
pub(crate) fn all_lines(text: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    let (mut rest, mut number) = (text, 0);
    std::iter::from_fn(move || {
        if rest.is_empty() {
            return None;
        }
        let end = rest.iter().position(|&b| b == b'\n' || b == b'\r').unwrap_or(rest.len());
        let line = rest[..end].split(|&b| b == b'#').next().unwrap_or_default().trim_ascii();
        rest = match &rest[end..] {
            [b'\r', b'\n', after @ ..] | [_, after @ ..] => after,
            [] => &[],
        };
        number += 1;
        Some((number, line))
    })
}

/// Those of [`all_lines`] that hold something.
pub(crate) fn lines(text: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    all_lines(text).filter(|(_, line)| !line.is_empty())
}

/// The words of a line.
pub(crate) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty())
}

/// A word for messages.
pub(crate) fn shown(word: &[u8]) -> String {
    let text = String::from_utf8_lossy(&word[..word.len().min(40)]).into_owned();
    text.chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect()
}

/// A number in whatever way C libraries print it.
pub(crate) fn number(word: &[u8]) -> std::result::Result<f64, Fault> {
    let text = std::str::from_utf8(word).unwrap_or("");
    if let Ok(x) = text.parse() {
        return Ok(x);
    }
    let lower = text.to_ascii_lowercase();
    match () {
        () if lower.contains("nan") || lower.contains("ind") => Ok(f64::NAN), // nan(ind), 1.#QNAN, -1.#IND
        () if lower.contains("#inf") => Ok(if lower.starts_with('-') { f64::NEG_INFINITY } else { f64::INFINITY }),
        () => invalid(format!("{:?} is not a number", shown(word))),
    }
}
