//! PLY (Turk 1994): ASCII and binary of both byte orders, polygons and triangle strips; writes binary little-endian.
//!
//! Read: `vertex` with x y z, nx ny nz, colours, and texture coordinates under their usual names; `face` with
//! `vertex_indices` or `vertex_index`; `tristrips`. Other elements and properties are skipped. Per-corner texture
//! coordinates (`texcoord` lists) are not kept, which is reported. What a line of an ASCII file holds beyond its record
//! is passed over, and said, where there are lines enough for one each.

mod attribute;

pub use attribute::attribute;

use crate::error::{Fault, Result, invalid};
use crate::loaded::{Loaded, Part};
use crate::mesh::TriMesh;
use crate::{origin, polygon};
use glam::DVec3;
use std::io::Write;
use std::path::Path;

type Parsed<T> = std::result::Result<T, Fault>;

/// Reads the PLY file `bytes`; `path` is for messages and names.
///
/// # Errors
/// [`crate::Error::Invalid`] with the element and record where the file goes wrong, [`crate::Error::Unsupported`] for other versions.
pub fn read(path: &Path, bytes: &[u8]) -> Result<Loaded> {
    let mut loaded = Loaded::default();
    let mesh = parse(bytes, &mut loaded).map_err(|fault| fault.at(path))?;
    loaded.parts.push(Part::named(path, mesh));
    Ok(loaded)
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
    I64,
    U64,
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
            "int64" => Self::I64,
            "uint64" => Self::U64,
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
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// The stored value of full colour.
    fn full_color(self) -> f32 {
        match self {
            Self::F32 | Self::F64 => 1.0,
            Self::I8 | Self::U8 => 255.0,
            Self::I16 | Self::U16 => 65535.0,
            Self::I32 | Self::U32 => u32::MAX as f32,
            Self::I64 | Self::U64 => u64::MAX as f32,
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

fn parse(bytes: &[u8], loaded: &mut Loaded) -> Parsed<TriMesh> {
    let (encoding, elements, body) = header(bytes, &mut loaded.warnings)?;
    let mut source = Source::new(encoding, &elements, body);
    let mut mesh = TriMesh::default();
    let mut polygons = Polygons::default();
    for element in &elements {
        source.check_room(element)?;
        match element.name.as_str() {
            "vertex" => vertices(&mut source, element, &mut mesh, loaded)?,
            "face" => faces(&mut source, element, &mut polygons, loaded)?,
            "tristrips" => faces(&mut source, element, polygons.strips(), loaded)?,
            _ => {
                if element.count > 0 {
                    loaded.dropped.push(format!("{} {} elements", element.count, element.name));
                }
                skip(&mut source, element)?;
            }
        }
    }
    polygons.triangles(&mut mesh, &mut loaded.warnings)?;
    if source.surplus > 0 {
        let what = "numbers in its lines beyond what the header promises are ignored";
        loaded.warnings.push(format!("{} {what}", source.surplus));
    }
    if let Some(left) = source.left_over() {
        loaded.warnings.push(format!("{left} after the last element that the header promises are ignored"));
    }
    Ok(mesh)
}

/// Whether an ASCII body has lines enough for each record to have its own.
fn by_line(encoding: Encoding, elements: &[Element], body: &[u8]) -> bool {
    let records = elements.iter().fold(0_u64, |n, e| n.saturating_add(e.count));
    encoding == Encoding::Ascii && crate::lines::lines(body).count() as u64 >= records
}

// ---- Header ----

fn header<'a>(bytes: &'a [u8], warnings: &mut Vec<String>) -> Parsed<(Encoding, Vec<Element>, &'a [u8])> {
    const LONGEST: usize = 1 << 20;
    let first = bytes.iter().position(|b| matches!(b, b'\r' | b'\n'));
    let Some(first) = first.filter(|&n| bytes[..n].trim_ascii() == b"ply") else {
        return invalid("not a PLY file: it does not begin with a line \"ply\"");
    };
    // Lines end at \n, which a \r may precede; where the first ends at \r alone, so do all: what follows the last one may
    // be a byte of data that looks like \n.
    let newline = if bytes[first] == b'\r' && bytes.get(first + 1) != Some(&b'\n') { b'\r' } else { b'\n' };
    let mut rest = &bytes[first + 1 + usize::from(bytes[first] != newline)..];
    let (mut encoding, mut elements) = (None, Vec::<Element>::new());
    loop {
        let window = &rest[..rest.len().min(LONGEST)];
        let Some(end) = window.iter().position(|&b| b == newline) else {
            return invalid("PLY header: no end_header line");
        };
        let line = String::from_utf8_lossy(&rest[..end]);
        rest = &rest[end + 1..];
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
            // Programs put words of their own there; what is no text is no header.
            _ if line.chars().any(|c| c.is_control() && !c.is_whitespace() || c == '\u{fffd}') => {
                return invalid(format!("PLY header: cannot understand the line {:?}", shorten(&line)));
            }
            _ => warnings.push(format!("the header's line {:?} is not known and passed over", shorten(&line))),
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
    /// See [`by_line`].
    by_line: bool,
    /// Words that lines hold beyond their records.
    surplus: u64,
}

impl<'a> Source<'a> {
    fn new(encoding: Encoding, elements: &[Element], body: &'a [u8]) -> Self {
        Self { bytes: body, at: 0, encoding, by_line: by_line(encoding, elements, body), surplus: 0 }
    }

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

    /// Ends a record: what is left of its line is surplus.
    fn end_record(&mut self) {
        if !self.by_line {
            return;
        }
        let rest = &self.bytes[self.at..];
        let length = rest.iter().position(|b| matches!(b, b'\n' | b'\r')).unwrap_or(rest.len());
        self.surplus += crate::lines::words(&rest[..length]).count() as u64;
        self.at += length;
    }

    /// What follows the last element.
    fn left_over(&self) -> Option<String> {
        let rest = &self.bytes[self.at..];
        match self.encoding {
            Encoding::Ascii => Some(crate::lines::words(rest).count()).filter(|&n| n > 0).map(|n| format!("{n} words")),
            // A line end, as editors put it there, is nothing.
            _ => (!rest.trim_ascii().is_empty()).then(|| format!("{} bytes", rest.len())),
        }
    }

    /// The next value; 64-bit integers lose what an f64 has no room for.
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
            Kind::I64 => self.wide(|raw| if big { i64::from_be_bytes(raw) } else { i64::from_le_bytes(raw) } as f64)?,
            Kind::U64 => self.wide(|raw| if big { u64::from_be_bytes(raw) } else { u64::from_le_bytes(raw) } as f64)?,
            Kind::F32 => take!(f32),
            Kind::F64 => take!(f64),
        })
    }

    fn wide(&mut self, value: impl Fn([u8; 8]) -> f64) -> Option<f64> {
        let raw = *self.bytes.get(self.at..)?.first_chunk()?;
        self.at += 8;
        Some(value(raw))
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
    // NaN and negative lengths fail the comparison; the last word of a text needs no separator.
    (n >= 0.0 && n <= source.left() as f64 && n.fract() == 0.0).then_some(n as usize)
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
        source.end_record();
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

fn vertices(source: &mut Source, element: &Element, mesh: &mut TriMesh, loaded: &mut Loaded) -> Parsed<()> {
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
    // Texts may hold more digits than their type.
    let exact = source.encoding == Encoding::Ascii || (0..3).any(|s| !matches!(kind_of(s), Kind::F32));
    let mut positions: Vec<[f64; 3]> = Vec::with_capacity(if exact { n } else { 0 });
    mesh.positions.reserve_exact(if exact { 0 } else { n });
    mesh.normals = has(3..6).then(|| Vec::with_capacity(n));
    mesh.uvs = has(6..8).then(|| Vec::with_capacity(n));
    mesh.colors = has(8..11).then(|| Vec::with_capacity(n));
    let mut v = [0.0_f64; SLOTS.len()];
    for record in 0..element.count {
        for (p, slot) in element.properties.iter().zip(&slots) {
            match slot {
                Some(slot) => source.value(p.kind).map(|x| v[*slot] = x),
                None => skip_property(source, p),
            }
            .ok_or_else(|| broken(element, record))?;
        }
        source.end_record();
        match exact {
            true => positions.push([v[0], v[1], v[2]]),
            false => mesh.positions.push([v[0], v[1], v[2]].map(|x| x as f32)),
        }
        let v = v.map(|x| x as f32);
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
    if exact {
        (mesh.positions, loaded.origin) = origin::narrowed(&positions);
    }
    let unused = element.properties.iter().zip(&slots).filter(|(_, slot)| slot.is_none()).map(|(p, _)| p.name.as_str());
    let unused: Vec<&str> = unused.take(8).collect();
    if !unused.is_empty() {
        loaded.dropped.push(format!("the vertices' {}", unused.join(", ")));
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
                let at = |i: usize| positions[corners[i] as usize].map(f64::from);
                polygon::triangulate(corners.len(), at, |t| indices.push(t.map(|i| corners[i] as u32)));
            }
        }
        if too_few > 0 {
            warnings.push(format!("{too_few} faces with fewer than three corners were left out"));
        }
        Ok(())
    }
}

fn faces(source: &mut Source, element: &Element, to: &mut Polygons, loaded: &mut Loaded) -> Parsed<()> {
    let is_corners = |p: &Property| p.length.is_some() && matches!(p.name.as_str(), "vertex_indices" | "vertex_index");
    let Some(which) = element.properties.iter().position(is_corners) else {
        loaded.warnings.push(format!("the {} elements have no vertex_indices: skipped", element.name));
        return skip(source, element);
    };
    if to.first_strip.is_some() && element.name == "face" {
        return Err(Fault::Unsupported("faces after triangle strips".into()));
    }
    if element.properties.iter().any(|p| p.name == "texcoord") {
        loaded.warnings.push("texture coordinates per face corner are not kept (store them per vertex)".into());
    }
    let other = |p: &&Property| !is_corners(p) && p.name != "texcoord";
    let unused: Vec<&str> = element.properties.iter().filter(other).map(|p| p.name.as_str()).take(8).collect();
    if !unused.is_empty() && element.count > 0 {
        loaded.dropped.push(format!("the faces' {}", unused.join(", ")));
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
        source.end_record();
    }
    Ok(())
}

// ---- Writing ----

/// Writes binary little-endian PLY. Texture coordinates are called s, t; colours are 8-bit, clamped to 0–1.
///
/// # Errors
/// Those of `out`.
pub fn write(mesh: &TriMesh, out: &mut dyn Write) -> std::io::Result<()> {
    write_about(mesh, DVec3::ZERO, out)
}

/// [`write()`] with `origin` added to all positions, which are doubles then unless it is zero.
///
/// # Errors
/// Those of `out`.
pub fn write_about(mesh: &TriMesh, origin: DVec3, out: &mut dyn Write) -> std::io::Result<()> {
    let double = origin != DVec3::ZERO;
    write_header(mesh, double, out)?;
    let floats = |out: &mut dyn Write, values: &[f32]| values.iter().try_for_each(|x| out.write_all(&x.to_le_bytes()));
    for i in 0..mesh.positions.len() {
        match double {
            true => {
                let p = DVec3::from(mesh.positions[i].map(f64::from)) + origin;
                p.to_array().iter().try_for_each(|x| out.write_all(&x.to_le_bytes()))?;
            }
            false => floats(out, &mesh.positions[i])?,
        }
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

fn write_header(mesh: &TriMesh, double: bool, out: &mut dyn Write) -> std::io::Result<()> {
    let index = if mesh.positions.len() > i32::MAX as usize { "uint" } else { "int" };
    write!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}\n", mesh.positions.len())?;
    for (there, kind, names) in [
        (true, if double { "double" } else { "float" }, &["x", "y", "z"][..]),
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
