//! STL (3D Systems 1989), binary and text: triangles without shared vertices, which are joined here where their
//! coordinates are equal. Facet normals are left: the winding has them. Written is binary.
//!
//! "solid" begins texts, but many binary files too: the length tells, which a binary file's count fixes.

use crate::error::{Fault, Result, invalid};
use crate::lines::{lines, number, shown, text, words};
use crate::loaded::{Loaded, Part};
use crate::mesh::TriMesh;
use crate::{origin, polygon};
use glam::DVec3;
use std::collections::HashMap;
use std::io::Write;
use std::path::Path;

type Parsed<T> = std::result::Result<T, Fault>;

const HEAD: usize = 84;
const FACET: usize = 50;

/// Reads the STL file `bytes`; `path` is for messages and names.
///
/// # Errors
/// [`crate::Error::Invalid`] with the line or what is missing.
pub fn read(path: &Path, bytes: &[u8]) -> Result<Loaded> {
    let count = bytes.get(80..HEAD).and_then(|b| b.try_into().ok()).map_or(0, u32::from_le_bytes) as usize;
    let length = count.saturating_mul(FACET).saturating_add(HEAD);
    let is_text = bytes.trim_ascii_start().get(..5).is_some_and(|b| b.eq_ignore_ascii_case(b"solid"));
    if is_text && bytes.len() != length {
        return parse_text(bytes, path).map_err(|fault| fault.at(path));
    }
    parse_binary(bytes, count, length, path).map_err(|fault| fault.at(path))
}

fn parse_binary(bytes: &[u8], count: usize, length: usize, path: &Path) -> Parsed<Loaded> {
    if bytes.len() < length || bytes.len() < HEAD {
        let what = format!(
            "{} bytes are too few for the {count} triangles that the header of a binary STL promises",
            bytes.len()
        );
        return invalid(what + " (truncated, or no STL file)");
    }
    let mut loaded = Loaded::default();
    if bytes.len() > length {
        loaded.warnings.push(format!("{} bytes after the last triangle are ignored", bytes.len() - length));
    }
    let mut weld = Weld::default();
    let mut mesh = TriMesh { indices: Vec::with_capacity(count), ..TriMesh::default() };
    let mut coloured = 0;
    for facet in bytes[HEAD..length].chunks_exact(FACET) {
        let float = |i: usize| f32::from_le_bytes([facet[i], facet[i + 1], facet[i + 2], facet[i + 3]]);
        let corner = |i: usize| [float(12 * i), float(12 * i + 4), float(12 * i + 8)];
        mesh.indices.push([1, 2, 3].map(|i| weld.number(corner(i), &mut mesh.positions)));
        coloured += usize::from(facet[48..] != [0, 0]);
    }
    if coloured > 0 {
        loaded.dropped.push(format!("the attribute bytes (colours, in some programs) of {coloured} triangles"));
    }
    loaded.parts.push(Part::named(path, mesh));
    Ok(loaded)
}

/// Numbers of vertices by their coordinates.
#[derive(Default)]
struct Weld(HashMap<[u32; 3], u32>);

impl Weld {
    fn number(&mut self, p: [f32; 3], positions: &mut Vec<[f32; 3]>) -> u32 {
        let next = positions.len() as u32;
        // −0 is 0.
        let number = *self.0.entry(p.map(|x| (x + 0.0).to_bits())).or_insert(next);
        if number == next {
            positions.push(p);
        }
        number
    }
}

/// A solid of a text: its name, the corners of its facets, and where each facet ends.
#[derive(Default)]
struct Solid {
    name: String,
    corners: Vec<[f64; 3]>,
    ends: Vec<usize>,
}

fn parse_text(bytes: &[u8], path: &Path) -> Parsed<Loaded> {
    let mut solids: Vec<Solid> = Vec::new();
    let mut open = false;
    for (line_number, line) in lines(text(bytes)?) {
        let wrong = |what: String| Fault::Invalid(format!("line {line_number}: {what}"));
        let mut words = words(line);
        let keyword = words.next().unwrap_or_default().to_ascii_lowercase();
        match &keyword[..] {
            b"solid" => {
                let name = String::from_utf8_lossy(line[5..].trim_ascii()).into_owned();
                solids.push(Solid { name, ..Solid::default() });
            }
            b"vertex" => {
                let Some(solid) = solids.last_mut() else { return Err(wrong("a vertex before any solid".into())) };
                let mut coordinate = || match words.next().map(number) {
                    Some(Ok(x)) => Ok(x),
                    Some(Err(Fault::Invalid(what) | Fault::Unsupported(what))) => Err(wrong(what)),
                    None => Err(wrong("a vertex needs three numbers".into())),
                };
                solid.corners.push([coordinate()?, coordinate()?, coordinate()?]);
                open = true;
            }
            b"endloop" | b"endfacet" | b"endsolid" => {
                if let Some(solid) = solids.last_mut().filter(|_| open) {
                    solid.ends.push(solid.corners.len());
                }
                open = false;
            }
            b"facet" | b"outer" | b"color" => {}
            _ => return Err(wrong(format!("{:?} is no word of STL", shown(&keyword)))),
        }
    }
    if open {
        return invalid("the file ends within a facet (truncated)");
    }
    solids.retain(|s| !s.corners.is_empty());
    if solids.is_empty() {
        return invalid("an STL text without facets");
    }
    assemble(&solids, path)
}

fn assemble(solids: &[Solid], path: &Path) -> Parsed<Loaded> {
    let all = solids.iter().flat_map(|s| &s.corners).map(|p| DVec3::from(*p));
    let mut loaded = Loaded { origin: origin::of(all).unwrap_or(DVec3::ZERO), ..Loaded::default() };
    let mut too_few = 0;
    for solid in solids {
        let (mut weld, mut mesh, mut begin) = (Weld::default(), TriMesh::default(), 0);
        for &end in &solid.ends {
            let corners = &solid.corners[begin..end];
            begin = end;
            if corners.len() < 3 {
                too_few += 1;
                continue;
            }
            let place = |p: &[f64; 3]| (DVec3::from(*p) - loaded.origin).as_vec3().into();
            let numbers: Vec<u32> = corners.iter().map(|p| weld.number(place(p), &mut mesh.positions)).collect();
            polygon::triangulate(corners.len(), |i| corners[i], |t| mesh.indices.push(t.map(|i| numbers[i])));
        }
        let mut part = Part::named(path, mesh);
        if !solid.name.is_empty() {
            part.name.clone_from(&solid.name);
        }
        loaded.parts.push(part);
    }
    if too_few > 0 {
        loaded.warnings.push(format!("{too_few} facets with fewer than three corners were left out"));
    }
    Ok(loaded)
}

/// Writes binary STL: triangles with their normals, nothing else.
///
/// # Errors
/// Those of `out`; more triangles than 32 bits count.
pub fn write(mesh: &TriMesh, out: &mut dyn Write) -> std::io::Result<()> {
    let count = u32::try_from(mesh.indices.len()).map_err(std::io::Error::other)?;
    out.write_all(&[b' '; 80])?;
    out.write_all(&count.to_le_bytes())?;
    for face in 0..mesh.indices.len() {
        let [a, b, c] = mesh.corners(face);
        let n = (b - a).as_dvec3().cross((c - a).as_dvec3()).normalize_or_zero().as_vec3();
        for x in [n, a, b, c].iter().flat_map(|v| v.to_array()) {
            out.write_all(&x.to_le_bytes())?;
        }
        out.write_all(&[0; 2])?;
    }
    Ok(())
}
