//! OFF (Geomview's object file format), as text: OFF, COFF, NOFF, CNOFF and those with ST texture coordinates before.
//! Colours of faces are not kept. 4OFF, nOFF and binary files are refused.

use crate::error::{Fault, Result, invalid};
use crate::lines::{lines, number, shown, text, words};
use crate::loaded::{Loaded, Part};
use crate::mesh::TriMesh;
use crate::{origin, polygon};
use std::path::Path;

type Parsed<T> = std::result::Result<T, Fault>;

/// Whether a file begins as OFF files do.
pub(crate) fn is_off(bytes: &[u8]) -> bool {
    let Ok(text) = text(&bytes[..bytes.len().min(512)]) else { return false };
    let first = lines(text).next().and_then(|(_, line)| words(line).next());
    first.is_some_and(|word| keyword(word).is_some())
}

/// What stands at a vertex beside its position.
#[derive(Clone, Copy)]
struct Kind {
    uvs: bool,
    colors: bool,
    normals: bool,
    /// 4OFF or nOFF.
    other: bool,
}

fn keyword(word: &[u8]) -> Option<Kind> {
    let rest = word.strip_suffix(b"OFF")?;
    let (uvs, rest) = rest.strip_prefix(b"ST").map_or((false, rest), |r| (true, r));
    let (colors, rest) = rest.strip_prefix(b"C").map_or((false, rest), |r| (true, r));
    let (normals, rest) = rest.strip_prefix(b"N").map_or((false, rest), |r| (true, r));
    matches!(rest, b"" | b"4" | b"n" | b"4n").then_some(Kind { uvs, colors, normals, other: !rest.is_empty() })
}

/// Reads the OFF file `bytes`; `path` is for messages and names.
///
/// # Errors
/// [`crate::Error::Invalid`] with the line, [`crate::Error::Unsupported`] for binary files and other dimensions.
pub fn read(path: &Path, bytes: &[u8]) -> Result<Loaded> {
    parse(bytes, path).map_err(|fault| fault.at(path))
}

fn parse(bytes: &[u8], path: &Path) -> Parsed<Loaded> {
    let text = text(bytes)?;
    let mut lines = lines(text).peekable();
    let mut kind = Kind { uvs: false, colors: false, normals: false, other: false };
    let mut counts = Vec::new();
    // The keyword may be missing, and the counts may stand behind it.
    while counts.is_empty() {
        let Some((line_number, line)) = lines.next() else { return invalid("no counts of vertices and faces") };
        for word in words(line) {
            match keyword(word) {
                Some(found) if counts.is_empty() => kind = found,
                _ if word == b"BINARY" => return Err(Fault::Unsupported("a binary OFF file; save it as text".into())),
                _ => counts.push(count(word).ok_or_else(|| at(line_number, format!("{:?} is no count", shown(word))))?),
            }
        }
    }
    if kind.other {
        return Err(Fault::Unsupported("points of another dimension than three (4OFF, nOFF)".into()));
    }
    let [vertices, faces, ..] = counts[..] else { return invalid("the counts of vertices and faces are missing") };
    // A vertex takes six bytes at least, a face two.
    if vertices.saturating_mul(6).saturating_add(faces.saturating_mul(2)) > text.len() + 2 {
        return invalid(format!("{vertices} vertices and {faces} faces do not fit into the file"));
    }
    let mut loaded = Loaded::default();
    let (mut points, mut mesh) = (Vec::with_capacity(vertices), TriMesh::default());
    let mut surplus = 0;
    for read in 0..vertices {
        let Some((line_number, line)) = lines.next() else {
            return invalid(format!("the file ends after {read} of {vertices} vertices"));
        };
        surplus += vertex(line, kind, &mut points, &mut mesh).map_err(|fault| line_of(line_number, fault))?;
    }
    if surplus > 0 {
        loaded.warnings.push(format!("{surplus} numbers at vertices beyond those of the keyword are ignored"));
    }
    let (mut coloured, mut too_few) = (0, 0);
    for read in 0..faces {
        let Some((line_number, line)) = lines.next() else {
            return invalid(format!("the file ends after {read} of {faces} faces"));
        };
        let (corners, more) = face(line, vertices).map_err(|fault| line_of(line_number, fault))?;
        coloured += usize::from(more);
        match corners.len() {
            ..3 => too_few += 1,
            n => polygon::triangulate(n, |i| points[corners[i] as usize], |t| mesh.indices.push(t.map(|i| corners[i]))),
        }
    }
    if too_few > 0 {
        loaded.warnings.push(format!("{too_few} faces with fewer than three corners were left out"));
    }
    if coloured > 0 {
        loaded.dropped.push(format!("the colours of {coloured} faces"));
    }
    let more = lines.count();
    if more > 0 {
        loaded.warnings.push(format!("{more} lines after the last face are ignored: more data than the counts say"));
    }
    (mesh.positions, loaded.origin) = origin::narrowed(&points);
    loaded.parts.push(Part::named(path, mesh));
    Ok(loaded)
}

fn at(line: usize, what: String) -> Fault {
    Fault::Invalid(format!("line {line}: {what}"))
}

fn line_of(line: usize, fault: Fault) -> Fault {
    match fault {
        Fault::Invalid(what) => at(line, what),
        other => other,
    }
}

fn count(word: &[u8]) -> Option<usize> {
    std::str::from_utf8(word).ok()?.parse::<u32>().ok().map(|n| n as usize)
}

/// Position, normal, colour, texture coordinates, in the order of the format; how many numbers were left.
fn vertex(line: &[u8], kind: Kind, points: &mut Vec<[f64; 3]>, mesh: &mut TriMesh) -> Parsed<usize> {
    let all: Vec<&[u8]> = words(line).collect();
    let values: Vec<f64> = all.iter().map(|w| number(w)).collect::<Parsed<_>>()?;
    let mut left = &values[..];
    let mut take = |n: usize, what: &str| match left.split_at_checked(n) {
        Some((taken, rest)) => {
            left = rest;
            Ok(taken)
        }
        None => invalid(format!("a vertex needs {what}")),
    };
    let p = take(3, "three coordinates")?;
    points.push([p[0], p[1], p[2]]);
    if kind.normals {
        let n = take(3, "a normal")?;
        mesh.normals.get_or_insert_default().push([n[0], n[1], n[2]].map(|x| x as f32));
    }
    if kind.colors {
        let c = take(3, "a colour")?;
        let begin = 3 + 3 * usize::from(kind.normals);
        // Whole numbers are of 255, as Geomview has it.
        let whole = all[begin..begin + 3].iter().all(|w| w.iter().all(u8::is_ascii_digit));
        let full = if whole { 255.0 } else { 1.0 };
        mesh.colors.get_or_insert_default().push([c[0], c[1], c[2]].map(|x| (x / full) as f32));
    }
    if kind.uvs {
        // Behind an alpha, if there is one.
        let n = left_of(&values, kind);
        let uv = values.get(values.len().saturating_sub(2)..).filter(|_| n >= 2);
        let Some(&[u, v]) = uv else { return invalid("a vertex needs texture coordinates") };
        mesh.uvs.get_or_insert_default().push([u as f32, v as f32]);
    }
    let rest = left_of(&values, kind) - 2 * usize::from(kind.uvs);
    Ok(rest.saturating_sub(usize::from(kind.colors)))
}

/// Numbers after position, normal and colour.
fn left_of(values: &[f64], kind: Kind) -> usize {
    values.len().saturating_sub(3 + 3 * usize::from(kind.normals) + 3 * usize::from(kind.colors))
}

/// The corners of a face, and whether something follows.
fn face(line: &[u8], vertices: usize) -> Parsed<(Vec<u32>, bool)> {
    let mut words = words(line);
    let n = words.next().and_then(count);
    let n = n.ok_or_else(|| Fault::Invalid("a face begins with the number of its corners".into()))?;
    let mut corners = Vec::with_capacity(n.min(line.len()));
    for _ in 0..n {
        let Some(word) = words.next() else { return invalid(format!("a face of {n} corners has {}", corners.len())) };
        match count(word).filter(|&i| i < vertices) {
            Some(i) => corners.push(i as u32),
            None => return invalid(format!("a face uses vertex {:?}, there are {vertices}", shown(word))),
        }
    }
    Ok((corners, words.next().is_some()))
}
