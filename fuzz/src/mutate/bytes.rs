//! Mutations that know nothing about a format.

use super::{below, pick};
use translume_core::rng::Pcg32;

/// Numbers at which arithmetic breaks.
const ODD: [u64; 16] = [0, 1, 2, 3, 4, 7, 8, 16, 0x7f, 0x80, 0xff, 0x7fff, 0x8000, 0xffff, 0x7fff_ffff, 0xffff_ffff];
const ODD_F32: [f32; 10] =
    [0.0, -0.0, 1.0, -1.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN_POSITIVE, 1e-42];

/// Changes `v` in one place; `other` lends a part.
pub(super) fn mutate(v: &mut Vec<u8>, other: &[u8], rng: &mut Pcg32) {
    if v.is_empty() {
        v.extend_from_slice(&other[..other.len().min(64)]);
        return;
    }
    // Headers come first in most formats: half of the changes go there.
    let span = if below(2, rng) == 0 { v.len().min(256) } else { v.len() };
    let at = below(span, rng);
    match below(14, rng) {
        0 | 1 => v[at] ^= 1 << below(8, rng),
        2 => v[at] = rng.next_u32() as u8,
        3 | 4 => integer(v, at, rng),
        5 => put(v, at, &pick(&ODD_F32, rng).to_le_bytes()),
        6 => put(v, at, &f64::from(*pick(&ODD_F32, rng)).to_le_bytes()),
        7 => v.truncate(at),
        8 => drop(v.drain(at..(at + 1 + below(16, rng)).min(v.len()))),
        9 => {
            let copy = v[at..(at + 1 + below(64, rng)).min(v.len())].to_vec();
            let to = below(v.len(), rng);
            drop(v.splice(to..to, copy));
        }
        10 => {
            let byte = rng.next_u32() as u8;
            drop(v.splice(at..at, std::iter::repeat_n(byte, 1 + below(16, rng))));
        }
        11 if !other.is_empty() => {
            // The same place of another file: heads and tables change places.
            let from = if below(2, rng) == 0 { at.min(other.len() - 1) } else { below(other.len(), rng) };
            let part = &other[from..(from + 1 + below(128, rng)).min(other.len())];
            put(v, at, part);
        }
        12 => {
            let n = (1 + below(32, rng)).min(v.len() - at);
            let byte = *pick(&[0, 0xff, 0x7f, 0x80], rng);
            v[at..at + n].fill(byte);
        }
        _ => {
            let n = 4.min(v.len() - at);
            v[at..at + n].rotate_left(1);
        }
    }
}

/// An integer of 2, 4 or 8 bytes of either order: an odd one, the file's length, or a little more or less.
fn integer(v: &mut [u8], at: usize, rng: &mut Pcg32) {
    let width = *pick(&[2usize, 4, 4, 8], rng);
    // Fields are aligned more often than not.
    let at = if below(2, rng) == 0 { at / width * width } else { at };
    let big = below(2, rng) == 0;
    let Some(field) = v.get(at..at + width) else { return };
    let old = match big {
        true => field.iter().fold(0u64, |n, b| n << 8 | u64::from(*b)),
        false => field.iter().rev().fold(0u64, |n, b| n << 8 | u64::from(*b)),
    };
    let new = match below(4, rng) {
        0 => old.wrapping_add(1 + below(4, rng) as u64),
        1 => old.wrapping_sub(1 + below(4, rng) as u64),
        2 => v.len() as u64,
        _ => *pick(&ODD, rng) << (8 * below(2, rng) * (width - 2)),
    };
    let bytes = if big { new.to_be_bytes() } else { new.to_le_bytes() };
    let bytes = if big { &bytes[8 - width..] } else { &bytes[..width] };
    v[at..at + width].copy_from_slice(bytes);
}

fn put(v: &mut [u8], at: usize, bytes: &[u8]) {
    let n = bytes.len().min(v.len() - at);
    v[at..at + n].copy_from_slice(&bytes[..n]);
}
