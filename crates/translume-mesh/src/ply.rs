//! PLY (Turk 1994): ASCII and binary of both byte orders, polygons and triangle strips; writes binary little-endian.
//!
//! Read: `vertex` with x y z, nx ny nz, colours, and texture coordinates under their usual names; `face` with
//! `vertex_indices` or `vertex_index`; `tristrips`. Other elements and properties are skipped. Per-corner texture
//! coordinates (`texcoord` lists) are not kept, which is reported.

use crate::error::{Fault, Result, invalid};
use crate::files::{Loaded, Part};
use crate::mesh::TriMesh;
use crate::polygon;
use std::io::Write;
use std::path::Path;

type Parsed<T> = std::result::Result<T, Fault>;

/// Reads the PLY file `bytes`; `path` is for messages and names.
///
/// # Errors
/// [`crate::Error::Invalid`] with the element and record where the file goes wrong, [`crate::Error::Unsupported`] for other versions.
pub fn read(path: &Path, bytes: &[u8]) -> Result<Loaded> {
    parse(bytes).map_err(|fault| fault.at(path)).map(|(mesh, warnings)| Loaded {
        parts: vec![Part::named(path, mesh)],
        warnings,
        ..Loaded::default()
    })
}

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn parse(word: &str) -> Parsed<Self> {
        Ok(match word {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return invalid(format!("PLY header: unknown property type {word:?}")),
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The stored value of full colour.
    fn full_color(self) -> f32 {
        match self {
            Self::F32 | Self::F64 => 1.0,
            Self::I8 | Self::U8 => 255.0,
            Self::I16 | Self::U16 => 65535.0,
            Self::I32 | Self::U32 => u32::MAX as f32,
        }
    }
}

struct Property {
    name: String,
    /// Type of the length, for lists.
    length: Option<Kind>,
    kind: Kind,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

fn parse(bytes: &[u8]) -> Parsed<(TriMesh, Vec<String>)> {
    let (encoding, elements, body) = header(bytes)?;
    let mut source = Source { bytes: body, at: 0, encoding };
    let mut mesh = TriMesh::default();
    let mut polygons = Polygons::default();
    let mut warnings = Vec::new();
    for element in &elements {
        source.check_room(element)?;
        match element.name.as_str() {
            "vertex" => vertices(&mut source, element, &mut mesh)?,
            "face" => faces(&mut source, element, &mut polygons, &mut warnings)?,
            "tristrips" => faces(&mut source, element, polygons.strips(), &mut warnings)?,
            _ => skip(&mut source, element)?,
        }
    }
    polygons.triangles(&mut mesh, &mut warnings)?;
    Ok((mesh, warnings))
}

// ---- Header ----

fn header(bytes: &[u8]) -> Parsed<(Encoding, Vec<Element>, &[u8])> {
    const LONGEST: usize = 1 << 20;
    let newline: &[u8] = if bytes.starts_with(b"ply\r\n") {
        b"\r\n"
    } else if bytes.starts_with(b"ply\n") {
        b"\n"
    } else if bytes.starts_with(b"ply\r") {
        b"\r"
    } else {
        return invalid("not a PLY file: it does not begin with a line \"ply\"");
    };
    let mut rest = &bytes[3 + newline.len()..];
    let (mut encoding, mut elements) = (None, Vec::<Element>::new());
    loop {
        let window = &rest[..rest.len().min(LONGEST)];
        let Some(end) = window.windows(newline.len()).position(|w| w == newline) else {
            return invalid("PLY header: no end_header line");
        };
        let line = String::from_utf8_lossy(&rest[..end]);
        rest = &rest[end + newline.len()..];
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words[..] {
            ["format", name, "1.0"] => encoding = Some(encoding_named(name)?),
            ["format", ..] => return Err(Fault::Unsupported(format!("PLY header: {:?} is not version 1.0", &*line))),
            ["element", name, count] => {
                let Ok(count) = count.parse() else {
                    return invalid(format!("PLY header: {count:?} is no count of {name} elements"));
                };
                elements.push(Element { name: name.into(), count, properties: Vec::new() });
            }
            ["property", ref words @ ..] => match elements.last_mut() {
                Some(element) => element.properties.push(property(words)?),
                None => return invalid("PLY header: a property stands before any element"),
            },
            ["end_header"] => break,
            [] | ["comment" | "obj_info", ..] => {}
            _ => return invalid(format!("PLY header: cannot understand the line {:?}", shorten(&line))),
        }
        if bytes.len() - rest.len() > LONGEST {
            return invalid("PLY header: longer than a mebibyte");
        }
    }
    match encoding {
        Some(encoding) => Ok((encoding, elements, rest)),
        None => invalid("PLY header: no format line"),
    }
}

fn encoding_named(name: &str) -> Parsed<Encoding> {
    match name {
        "ascii" => Ok(Encoding::Ascii),
        "binary_little_endian" => Ok(Encoding::Little),
        "binary_big_endian" => Ok(Encoding::Big),
        _ => Err(Fault::Unsupported(format!("PLY header: unknown format {name:?}"))),
    }
}

fn property(words: &[&str]) -> Parsed<Property> {
    match *words {
        ["list", length, kind, name] => {
            let (length, kind) = (Kind::parse(length)?, Kind::parse(kind)?);
            if matches!(length, Kind::F32 | Kind::F64) {
                return invalid(format!("PLY header: the length of list {name:?} is not an integer"));
            }
            Ok(Property { name: name.into(), length: Some(length), kind })
        }
        [kind, name] => Ok(Property { name: name.into(), length: None, kind: Kind::parse(kind)? }),
        _ => invalid(format!("PLY header: cannot understand the property {:?}", shorten(&words.join(" ")))),
    }
}

fn shorten(line: &str) -> String {
    line.chars().take(80).collect()
}

// ---- Values ----

struct Source<'a> {
    bytes: &'a [u8],
    at: usize,
    encoding: Encoding,
}

impl Source<'_> {
    fn left(&self) -> usize {
        self.bytes.len() - self.at
    }

    /// Refuses a count that the rest of the file has no room for, so that counts can be trusted from here on.
    fn check_room(&self, element: &Element) -> Parsed<()> {
        let record: u64 = match self.encoding {
            Encoding::Ascii => 2 * element.properties.len() as u64,
            _ => element.properties.iter().map(|p| p.length.unwrap_or(p.kind).size() as u64).sum(),
        };
        // The last word of an ASCII file needs no separator.
        let room = self.left() as u64 + u64::from(self.encoding == Encoding::Ascii);
        if element.count.saturating_mul(record) > room {
            return invalid(format!(
                "the header promises {} {} elements, the file ends before that many",
                element.count, element.name
            ));
        }
        Ok(())
    }

    /// The next value; every type fits an f64.
    #[inline]
    fn value(&mut self, kind: Kind) -> Option<f64> {
        if self.encoding == Encoding::Ascii {
            return self.word().and_then(number);
        }
        let big = self.encoding == Encoding::Big;
        macro_rules! take {
            ($t:ty) => {{
                let raw = *self.bytes.get(self.at..)?.first_chunk()?;
                self.at += size_of::<$t>();
                f64::from(if big { <$t>::from_be_bytes(raw) } else { <$t>::from_le_bytes(raw) })
            }};
        }
        Some(match kind {
            Kind::I8 => take!(i8),
            Kind::U8 => take!(u8),
            Kind::I16 => take!(i16),
            Kind::U16 => take!(u16),
            Kind::I32 => take!(i32),
            Kind::U32 => take!(u32),
            Kind::F32 => take!(f32),
            Kind::F64 => take!(f64),
        })
    }

    fn word(&mut self) -> Option<&[u8]> {
        let rest = &self.bytes[self.at..];
        let start = rest.iter().position(|b| !b.is_ascii_whitespace())?;
        let length = rest[start..].iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len() - start);
        self.at += start + length;
        Some(&rest[start..start + length])
    }

    fn skip(&mut self, count: usize, kind: Kind) -> Option<()> {
        if self.encoding == Encoding::Ascii {
            return (0..count).try_for_each(|_| self.word().map(|_| ()));
        }
        let bytes = count.checked_mul(kind.size()).filter(|&n| n <= self.left())?;
        self.at += bytes;
        Some(())
    }
}

fn number(word: &[u8]) -> Option<f64> {
    let word = std::str::from_utf8(word).ok()?;
    // C libraries print NaN in many ways.
    word.parse().ok().or_else(|| word.to_ascii_lowercase().contains("nan").then_some(f64::NAN))
}

fn broken(element: &Element, record: u64) -> Fault {
    Fault::Invalid(format!("{} {record} of {}: the file ends or holds no number there", element.name, element.count))
}

fn list_length(source: &mut Source, kind: Kind) -> Option<usize> {
    let n = source.value(kind)?;
    // NaN and negative lengths fail the comparison.
    (n >= 0.0 && n <= source.left() as f64).then_some(n as usize)
}

fn skip_property(source: &mut Source, p: &Property) -> Option<()> {
    let count = match p.length {
        Some(kind) => list_length(source, kind)?,
        None => 1,
    };
    source.skip(count, p.kind)
}

fn skip(source: &mut Source, element: &Element) -> Parsed<()> {
    if element.properties.is_empty() {
        return Ok(());
    }
    for record in 0..element.count {
        element.properties.iter().try_for_each(|p| skip_property(source, p)).ok_or_else(|| broken(element, record))?;
    }
    Ok(())
}

// ---- Vertices ----

/// Names of a vertex property, by the number of its slot: position, normal, texture coordinates, colour.
const SLOTS: [&[&str]; 11] = [
    &["x"],
    &["y"],
    &["z"],
    &["nx"],
    &["ny"],
    &["nz"],
    &["u", "s", "texture_u", "texture_s"],
    &["v", "t", "texture_v", "texture_t"],
    // The last of each is what Mitsuba 3 writes of its attribute `vertex_color`.
    &["red", "r", "diffuse_red", "color_0"],
    &["green", "g", "diffuse_green", "color_1"],
    &["blue", "b", "diffuse_blue", "color_2"],
];

fn vertices(source: &mut Source, element: &Element, mesh: &mut TriMesh) -> Parsed<()> {
    let slot = |p: &Property| SLOTS.iter().position(|names| p.length.is_none() && names.contains(&p.name.as_str()));
    let slots: Vec<Option<usize>> = element.properties.iter().map(slot).collect();
    let has = |mut range: std::ops::Range<usize>| range.all(|s| slots.contains(&Some(s)));
    if !has(0..3) {
        return invalid("the vertices have no x, y, z");
    }
    if !mesh.positions.is_empty() {
        return invalid("two vertex elements");
    }
    if element.count > u64::from(u32::MAX) {
        return Err(Fault::Unsupported(format!("{} vertices: 32-bit indices do not reach them", element.count)));
    }
    let n = element.count as usize; // bounded by check_room
    let kind_of = |s: usize| element.properties[slots.iter().position(|&t| t == Some(s)).unwrap_or(0)].kind;
    let full = kind_of(8).full_color();
    mesh.positions.reserve_exact(n);
    mesh.normals = has(3..6).then(|| Vec::with_capacity(n));
    mesh.uvs = has(6..8).then(|| Vec::with_capacity(n));
    mesh.colors = has(8..11).then(|| Vec::with_capacity(n));
    let mut v = [0.0_f32; SLOTS.len()];
    for record in 0..element.count {
        for (p, slot) in element.properties.iter().zip(&slots) {
            match slot {
                Some(slot) => source.value(p.kind).map(|x| v[*slot] = x as f32),
                None => skip_property(source, p),
            }
            .ok_or_else(|| broken(element, record))?;
        }
        mesh.positions.push([v[0], v[1], v[2]]);
        if let Some(normals) = &mut mesh.normals {
            normals.push([v[3], v[4], v[5]]);
        }
        if let Some(uvs) = &mut mesh.uvs {
            uvs.push([v[6], v[7]]);
        }
        if let Some(colors) = &mut mesh.colors {
            colors.push([v[8], v[9], v[10]].map(|c| c / full));
        }
    }
    Ok(())
}

// ---- Faces ----

/// Corner lists in file order; −1 ends a strip.
#[derive(Default)]
struct Polygons {
    corners: Vec<i64>,
    ends: Vec<usize>,
    /// Lists from here on are strips.
    first_strip: Option<usize>,
}

impl Polygons {
    fn strips(&mut self) -> &mut Self {
        self.first_strip.get_or_insert(self.ends.len());
        self
    }

    fn triangles(self, mesh: &mut TriMesh, warnings: &mut Vec<String>) -> Parsed<()> {
        let n = mesh.positions.len();
        let first_strip = self.first_strip.unwrap_or(self.ends.len());
        mesh.indices.reserve(self.ends.len());
        let (mut begin, mut too_few) = (0, 0_usize);
        for (list, &end) in self.ends.iter().enumerate() {
            let corners = &self.corners[begin..end];
            begin = end;
            let strip = list >= first_strip;
            if let Some(bad) = corners.iter().find(|&&i| !(strip && i == -1) && (i < 0 || i >= n as i64)) {
                return invalid(format!("face {list} uses vertex {bad}, there are {n}"));
            }
            if strip {
                for strip in corners.split(|&i| i == -1) {
                    mesh.indices.extend(strip.windows(3).enumerate().map(|(i, w)| {
                        let [a, b, c] = [w[0] as u32, w[1] as u32, w[2] as u32];
                        if i % 2 == 0 { [a, b, c] } else { [b, a, c] }
                    }));
                }
            } else if corners.len() < 3 {
                too_few += 1;
            } else {
                let TriMesh { positions, indices, .. } = mesh;
                let at = |i: usize| positions[corners[i] as usize];
                polygon::triangulate(corners.len(), at, |t| indices.push(t.map(|i| corners[i] as u32)));
            }
        }
        if too_few > 0 {
            warnings.push(format!("{too_few} faces with fewer than three corners were left out"));
        }
        Ok(())
    }
}

fn faces(source: &mut Source, element: &Element, to: &mut Polygons, warnings: &mut Vec<String>) -> Parsed<()> {
    let is_corners = |p: &Property| p.length.is_some() && matches!(p.name.as_str(), "vertex_indices" | "vertex_index");
    let Some(which) = element.properties.iter().position(is_corners) else {
        warnings.push(format!("the {} elements have no vertex_indices: skipped", element.name));
        return skip(source, element);
    };
    if to.first_strip.is_some() && element.name == "face" {
        return Err(Fault::Unsupported("faces after triangle strips".into()));
    }
    if element.properties.iter().any(|p| p.name == "texcoord") {
        warnings.push("texture coordinates per face corner are not kept (store them per vertex)".into());
    }
    let fault = |record| broken(element, record);
    for record in 0..element.count {
        for (i, p) in element.properties.iter().enumerate() {
            let Some(length) = p.length.filter(|_| i == which) else {
                skip_property(source, p).ok_or_else(|| fault(record))?;
                continue;
            };
            let length = list_length(source, length).ok_or_else(|| fault(record))?;
            for _ in 0..length {
                let index = source.value(p.kind).ok_or_else(|| fault(record))?;
                to.corners.push(index as i64); // NaN becomes 0, infinities saturate and are refused as out of range
            }
            to.ends.push(to.corners.len());
        }
    }
    Ok(())
}

// ---- Writing ----

/// Writes binary little-endian PLY. Texture coordinates are called s, t; colours are 8-bit, clamped to 0–1.
///
/// # Errors
/// Those of `out`.
pub fn write(mesh: &TriMesh, out: &mut dyn Write) -> std::io::Result<()> {
    write_header(mesh, out)?;
    let floats = |out: &mut dyn Write, values: &[f32]| values.iter().try_for_each(|x| out.write_all(&x.to_le_bytes()));
    for i in 0..mesh.positions.len() {
        floats(out, &mesh.positions[i])?;
        if let Some(normals) = &mesh.normals {
            floats(out, &normals[i])?;
        }
        if let Some(uvs) = &mesh.uvs {
            floats(out, &uvs[i])?;
        }
        if let Some(colors) = &mesh.colors {
            out.write_all(&colors[i].map(|c| (c * 255.0).round() as u8))?;
        }
    }
    for triangle in &mesh.indices {
        out.write_all(&[3])?;
        triangle.iter().try_for_each(|i| out.write_all(&i.to_le_bytes()))?;
    }
    Ok(())
}

fn write_header(mesh: &TriMesh, out: &mut dyn Write) -> std::io::Result<()> {
    let index = if mesh.positions.len() > i32::MAX as usize { "uint" } else { "int" };
    write!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}\n", mesh.positions.len())?;
    for (there, kind, names) in [
        (true, "float", &["x", "y", "z"][..]),
        (mesh.normals.is_some(), "float", &["nx", "ny", "nz"]),
        (mesh.uvs.is_some(), "float", &["s", "t"]),
        (mesh.colors.is_some(), "uchar", &["red", "green", "blue"]),
    ] {
        if there {
            names.iter().try_for_each(|name| writeln!(out, "property {kind} {name}"))?;
        }
    }
    write!(out, "element face {}\nproperty list uchar {index} vertex_indices\nend_header\n", mesh.indices.len())
}
