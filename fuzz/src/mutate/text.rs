//! Mutations of text: numbers, words, lines, quoted parts, nesting.

use super::{below, pick};
use std::ops::Range;
use translume_core::rng::Pcg32;

const NUMBERS: [&str; 22] = [
    "0",
    "-1",
    "1",
    "2",
    "-0",
    "0.5",
    "1e38",
    "-1e38",
    "1e39",
    "1e300",
    "1e999",
    "1e-300",
    "nan",
    "inf",
    "-inf",
    "255",
    "65536",
    "2147483647",
    "2147483648",
    "4294967295",
    "18446744073709551615",
    "99999999999999999999",
];
const WORDS: [&str; 16] = ["", " ", "\n", "\0", "\"", "'", "<", ">", "{", "}", "[", "]", "#", "$a", "\\", "\u{feff}"];

/// Changes `v` in one place; `other` lends words and lines.
pub(super) fn mutate(v: &mut Vec<u8>, other: &[u8], rng: &mut Pcg32) {
    match below(16, rng) {
        0..=3 => replace(v, numbers, |rng| pick(&NUMBERS, rng).as_bytes().to_vec(), rng),
        4 => replace(v, words, |rng| pick(&WORDS, rng).as_bytes().to_vec(), rng),
        5 | 6 => {
            // A word becomes another one, of this file or of a relative.
            let from = if below(3, rng) == 0 && !other.is_empty() { other.to_vec() } else { v.clone() };
            let all = words(&from);
            if !all.is_empty() {
                replace(v, words, |rng| from[pick(&all, rng).clone()].to_vec(), rng);
            }
        }
        7 | 8 => copy_part(v, lines, other, rng),
        9 => copy_part(v, elements, other, rng),
        10 => replace(v, lines, |_| Vec::new(), rng),
        11 => replace(v, elements, |_| Vec::new(), rng),
        12 => nest(v, rng),
        13 => {
            let at = below(v.len() + 1, rng);
            v.truncate(at);
        }
        14 => {
            let at = below(v.len() + 1, rng);
            drop(v.splice(at..at, pick(&WORDS, rng).bytes()));
        }
        _ => line_ends(v, rng),
    }
}

type Parts = fn(&[u8]) -> Vec<Range<usize>>;

/// Replaces a part.
fn replace(v: &mut Vec<u8>, parts: Parts, by: impl Fn(&mut Pcg32) -> Vec<u8>, rng: &mut Pcg32) {
    let all = parts(v);
    if !all.is_empty() {
        let part = pick(&all, rng).clone();
        drop(v.splice(part, by(rng)));
    }
}

/// Puts a copy of a part, of this text or another, before a part.
fn copy_part(v: &mut Vec<u8>, parts: Parts, other: &[u8], rng: &mut Pcg32) {
    let from = if below(3, rng) == 0 && !other.is_empty() { other.to_vec() } else { v.clone() };
    let (sources, places) = (parts(&from), parts(v));
    if !sources.is_empty() && !places.is_empty() {
        let copy = from[pick(&sources, rng).clone()].to_vec();
        let at = pick(&places, rng).start;
        drop(v.splice(at..at, copy));
    }
}

/// Puts a part into itself, many times: what recursion without a bound falls over.
fn nest(v: &mut Vec<u8>, rng: &mut Pcg32) {
    let times = *pick(&[2, 10, 300, 3000], rng);
    let all = elements(v);
    let Some(part) = (!all.is_empty()).then(|| pick(&all, rng).clone()) else { return };
    let inside =
        v[part.clone()].iter().position(|b| matches!(b, b'>' | b'{' | b'[')).map_or(part.start, |i| part.start + i + 1);
    let end =
        v[part.clone()].iter().rposition(|b| matches!(b, b'<' | b'}' | b']')).map_or(part.end, |i| part.start + i);
    if inside >= end || (inside - part.start + part.end - end) * times > super::LARGEST {
        return;
    }
    let (open, close) = (v[part.start..inside].to_vec(), v[end..part.end].to_vec());
    let nested = [open.repeat(times), v[inside..end].to_vec(), close.repeat(times)].concat();
    drop(v.splice(part, nested));
}

fn line_ends(v: &mut Vec<u8>, rng: &mut Pcg32) {
    let end = *pick(&[&b"\r\n"[..], b"\r", b"\n\n", b" "], rng);
    *v = v.split(|b| *b == b'\n').collect::<Vec<_>>().join(end);
}

/// Runs of bytes that `keep` holds of.
fn runs(v: &[u8], keep: impl Fn(u8) -> bool) -> Vec<Range<usize>> {
    let (mut all, mut begin) = (Vec::new(), None);
    for (i, b) in v.iter().chain(b"\0").enumerate() {
        match (keep(*b) && i < v.len(), begin) {
            (true, None) => begin = Some(i),
            (false, Some(b)) => {
                all.push(b..i);
                begin = None;
            }
            _ => {}
        }
    }
    all
}

fn numbers(v: &[u8]) -> Vec<Range<usize>> {
    let mut all = runs(v, |b| b.is_ascii_digit() || matches!(b, b'.' | b'-' | b'+' | b'e' | b'E'));
    all.retain(|r| v[r.clone()].iter().any(u8::is_ascii_digit));
    all
}

fn words(v: &[u8]) -> Vec<Range<usize>> {
    runs(v, |b| b.is_ascii_alphanumeric() || matches!(b, b'_' | b'.' | b'-' | b'+'))
}

/// Lines with their ends.
fn lines(v: &[u8]) -> Vec<Range<usize>> {
    let mut begin = 0;
    v.split_inclusive(|b| *b == b'\n').map(|l| (begin, begin += l.len()).0..begin).collect()
}

/// Elements of XML, and what stands in braces or brackets.
fn elements(v: &[u8]) -> Vec<Range<usize>> {
    let (mut all, mut open) = (Vec::new(), Vec::new());
    for (i, b) in v.iter().enumerate() {
        match b {
            b'{' | b'[' => open.push(i),
            b'}' | b']' => all.extend(open.pop().map(|begin| begin..i + 1)),
            b'<' if v.get(i + 1) == Some(&b'/') => {
                let end = v[i..].iter().position(|b| *b == b'>').map(|n| i + n + 1);
                all.extend(open.pop().zip(end).map(|(begin, end)| begin..end));
            }
            b'<' => open.push(i),
            b'>' if i > 0 && matches!(v[i - 1], b'/' | b'?' | b'-') => {
                all.extend(open.pop().map(|begin| begin..i + 1));
            }
            _ => {}
        }
    }
    all
}
