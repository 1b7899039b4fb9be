//! Attributes of PLY files by Mitsuba's names: `vertex_NAME` and `face_NAME` are the properties NAME_0, NAME_1, … of vertices and
//! faces, one number or three, as stored.
//!
//! The mesh reader keeps colours only; this looks for one attribute beside it. Damaged files are the mesh reader's to refuse: here
//! they have no attribute.

use std::path::Path;
use std::sync::Arc;
use translume_mesh::TriMesh;

/// The mesh with the attribute `name` of its file as colours; `None`: it has none.
pub(super) fn colored(mesh: &Arc<TriMesh>, path: &Path, name: &str) -> Option<Arc<TriMesh>> {
    let (element, name) = name.split_once('_')?;
    let values = Ply::open(&crate::files::bytes(path).ok()?)?.values(element, name)?;
    match element {
        "vertex" if values.len() == mesh.positions.len() => {
            Some(Arc::new(TriMesh { colors: Some(values), ..TriMesh::clone(mesh) }))
        }
        "face" if values.len() == mesh.indices.len() => Some(Arc::new(by_face(mesh, &values))),
        _ => None,
    }
}

/// The mesh with corners of their own for each triangle, in its colour.
fn by_face(mesh: &TriMesh, values: &[[f32; 3]]) -> TriMesh {
    let corners = || mesh.indices.iter().flatten().map(|i| *i as usize);
    // What else there may be is glTF's; nothing that this format has is left out.
    TriMesh {
        positions: corners().map(|i| mesh.positions[i]).collect(),
        normals: mesh.normals.as_ref().map(|n| corners().map(|i| n[i]).collect()),
        uvs: mesh.uvs.as_ref().map(|uv| corners().map(|i| uv[i]).collect()),
        colors: Some(values.iter().flat_map(|v| [*v; 3]).collect()),
        indices: (0..mesh.indices.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect(),
        ..TriMesh::default()
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

/// Bytes, and whether they are a float's or have a sign.
#[derive(Clone, Copy)]
struct Kind {
    size: usize,
    float: bool,
    signed: bool,
}

struct Property {
    name: String,
    length: Option<Kind>,
    kind: Kind,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

struct Ply<'a> {
    encoding: Encoding,
    elements: Vec<Element>,
    body: &'a [u8],
}

fn kind(word: &str) -> Option<Kind> {
    let (size, float, signed) = match word {
        "char" | "int8" => (1, false, true),
        "uchar" | "uint8" => (1, false, false),
        "short" | "int16" => (2, false, true),
        "ushort" | "uint16" => (2, false, false),
        "int" | "int32" => (4, false, true),
        "uint" | "uint32" => (4, false, false),
        "float" | "float32" => (4, true, true),
        "double" | "float64" => (8, true, true),
        _ => return None,
    };
    Some(Kind { size, float, signed })
}

impl<'a> Ply<'a> {
    fn open(bytes: &'a [u8]) -> Option<Ply<'a>> {
        let (mut encoding, mut elements, mut rest) = (None, Vec::<Element>::new(), bytes);
        loop {
            let end = rest.iter().position(|&b| b == b'\n')?;
            let line = std::str::from_utf8(&rest[..end]).ok()?;
            rest = &rest[end + 1..];
            match line.split_ascii_whitespace().collect::<Vec<_>>()[..] {
                ["format", "ascii", _] => encoding = Some(Encoding::Ascii),
                ["format", "binary_little_endian", _] => encoding = Some(Encoding::Little),
                ["format", "binary_big_endian", _] => encoding = Some(Encoding::Big),
                ["element", name, count] => {
                    elements.push(Element { name: name.into(), count: count.parse().ok()?, properties: Vec::new() });
                }
                ["property", "list", length, of, name] => {
                    let (length, kind) = (Some(kind(length)?), kind(of)?);
                    elements.last_mut()?.properties.push(Property { name: name.into(), length, kind });
                }
                ["property", of, name] => {
                    let property = Property { name: name.into(), length: None, kind: kind(of)? };
                    elements.last_mut()?.properties.push(property);
                }
                ["end_header"] => return Some(Ply { encoding: encoding?, elements, body: rest }),
                _ => {}
            }
        }
    }

    /// One number or three of each record of `element`.
    fn values(mut self, element: &str, name: &str) -> Option<Vec<[f32; 3]>> {
        for Element { name: found, count, properties } in std::mem::take(&mut self.elements) {
            let slot = |p: &Property| {
                let number = p.name.strip_prefix(name)?.strip_prefix('_')?.parse::<usize>().ok()?;
                (p.length.is_none() && number < 3).then_some(number)
            };
            let slots: Vec<Option<usize>> = properties.iter().map(slot).collect();
            let wanted = found == element;
            let channels = slots.iter().flatten().count();
            if wanted && channels != 1 && channels != 3 {
                return None;
            }
            let mut values = Vec::new();
            for _ in 0..if properties.is_empty() { 0 } else { count } {
                let mut value = [0.0; 3];
                for (p, slot) in properties.iter().zip(&slots) {
                    let n = match p.length {
                        Some(length) => Some(self.number(length)?).filter(|n| *n >= 0.0)? as u64,
                        None => 1,
                    };
                    for _ in 0..n {
                        let number = self.number(p.kind)?;
                        if let Some(slot) = slot {
                            value[*slot] = number as f32;
                        }
                    }
                }
                if wanted {
                    values.push(if channels == 1 { [value[0]; 3] } else { value });
                }
            }
            if wanted {
                return Some(values);
            }
        }
        None
    }

    fn number(&mut self, kind: Kind) -> Option<f64> {
        if self.encoding == Encoding::Ascii {
            let start = self.body.iter().position(|b| !b.is_ascii_whitespace())?;
            let rest = &self.body[start..];
            let length = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
            self.body = &rest[length..];
            return std::str::from_utf8(&rest[..length]).ok()?.parse().ok();
        }
        let (raw, rest) = self.body.split_at_checked(kind.size)?;
        self.body = rest;
        let mut bytes = [0; 8];
        bytes[..kind.size].copy_from_slice(raw);
        if self.encoding == Encoding::Big {
            bytes[..kind.size].reverse();
        }
        let bits = u64::from_le_bytes(bytes);
        let shift = 64 - 8 * kind.size as u32;
        Some(match (kind.float, kind.size, kind.signed) {
            (true, 4, _) => f32::from_bits(bits as u32).into(),
            (true, ..) => f64::from_bits(bits),
            (false, _, true) => ((bits << shift) as i64 >> shift) as f64,
            (false, ..) => bits as f64,
        })
    }
}
