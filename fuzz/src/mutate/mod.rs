//! Mutations: of bytes, of text, and of the parts of formats that would hide what is behind them from both (checksums,
//! compression, lengths of chunks).

mod bytes;
mod json;
mod packed;
mod text;

use crate::input::Input;
use translume_core::rng::Pcg32;

/// Largest file that mutations make.
const LARGEST: usize = 1 << 18;

/// A choice below `n`.
pub(crate) fn below(n: usize, rng: &mut Pcg32) -> usize {
    rng.next_u32() as usize % n.max(1)
}

/// One of a list.
pub(crate) fn pick<'a, T>(list: &'a [T], rng: &mut Pcg32) -> &'a T {
    &list[below(list.len(), rng)]
}

/// Whether it reads as text.
fn is_text(bytes: &[u8]) -> bool {
    let head = &bytes[..bytes.len().min(512)];
    !head.is_empty()
        && head.iter().filter(|b| b.is_ascii_graphic() || b.is_ascii_whitespace()).count() * 20 > head.len() * 19
}

/// Changes one to five places of one or two files; `other` lends material.
pub fn input(input: &mut Input, other: &Input, rng: &mut Pcg32) {
    if input.files.is_empty() {
        return;
    }
    for _ in 0..1 + below(2, rng) * below(2, rng) {
        let which = below(input.files.len(), rng);
        let lent = other.files.iter().find(|f| ending(&f.0) == ending(&input.files[which].0)).map_or(&[][..], |f| &f.1);
        for _ in 0..1 + below(3, rng) * below(3, rng) {
            file(&mut input.files[which].1, lent, rng);
        }
        input.files[which].1.truncate(LARGEST);
    }
    // A file that is missing, or empty.
    if input.files.len() > 1 && below(200, rng) == 0 {
        let which = below(input.files.len(), rng);
        if below(2, rng) == 0 { drop(input.files.remove(which)) } else { input.files[which].1.clear() }
    }
}

fn ending(name: &str) -> &str {
    name.rsplit_once('.').map_or("", |n| n.1)
}

/// Changes a file in one place.
fn file(bytes: &mut Vec<u8>, other: &[u8], rng: &mut Pcg32) {
    if below(3, rng) > 0 && packed::mutate(bytes, other, rng) {
        return;
    }
    match is_text(bytes) {
        true => text_or_json(bytes, other, rng),
        false => bytes::mutate(bytes, other, rng),
    }
}

/// Changes a text in one place; JSON mostly so that it stays JSON.
fn text_or_json(bytes: &mut Vec<u8>, other: &[u8], rng: &mut Pcg32) {
    if bytes.first() == Some(&b'{') && below(3, rng) > 0 && json::mutate(bytes, rng) {
        return;
    }
    if below(8, rng) == 0 { bytes::mutate(bytes, other, rng) } else { text::mutate(bytes, other, rng) }
}
