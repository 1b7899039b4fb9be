//! Wavefront OBJ and its MTL material libraries.
//!
//! Read: v (with colours), vt, vn, f with positive and relative indices, o, g, usemtl, mtllib, line continuation.
//! Faces are grouped into one part per pair of object-or-group name and material. Free-form curves, lines and points
//! are skipped and counted. A vertex is made for each distinct v/vt/vn triple; a file without faces is a point cloud.
//! Corners may name texture coordinates and normals that are not there, as some exporters write them: they have none
//! then.

use crate::error::{Error, Fault, Result, invalid};
use crate::lines::{all_lines, shown, text};
use crate::loaded::{Loaded, Part, bytes_of};
use crate::mesh::TriMesh;
use crate::{origin, polygon};
use glam::DVec3;
use std::collections::HashMap;
use std::io::Write;
use std::path::{Path, PathBuf};

type Parsed<T> = std::result::Result<T, Fault>;

/// Reads the OBJ file `bytes`; `path` is for messages, names and to resolve material libraries (which are not read:
/// see [`read_mtl`]).
///
/// # Errors
/// [`Error::Invalid`] with the line, [`Error::Unsupported`] for UTF-16 text.
pub fn read(path: &Path, bytes: &[u8]) -> Result<Loaded> {
    let mut reader = Reader::default();
    lines(bytes, |line| reader.line(line)).map_err(|fault| fault.at(path))?;
    reader.finish(path)
}

/// Calls `parse` with each line, continuations joined, comments and line ends off; adds the line's number to faults.
fn lines(bytes: &[u8], mut parse: impl FnMut(&[u8]) -> Parsed<()>) -> Parsed<()> {
    let mut joined = Vec::new();
    for (number, line) in all_lines(text(bytes)?) {
        if let Some(begun) = line.strip_suffix(b"\\") {
            joined.extend_from_slice(begun);
            joined.push(b' ');
            continue;
        }
        let result = if joined.is_empty() {
            parse(line)
        } else {
            joined.extend_from_slice(line);
            let result = parse(&joined);
            joined.clear();
            result
        };
        result.map_err(|fault| match fault {
            Fault::Invalid(what) => Fault::Invalid(format!("line {number}: {what}")),
            Fault::Unsupported(what) => Fault::Unsupported(format!("line {number}: {what}")),
        })?;
    }
    Ok(())
}

/// Position, texture coordinate and normal of a corner; `NONE` where there is none.
type Corner = [u32; 3];
const NONE: u32 = u32::MAX;

#[derive(Default)]
struct Reader {
    positions: Vec<[f64; 3]>,
    colors: Vec<[f32; 3]>,
    uvs: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
    groups: Vec<Group>,
    by_name: HashMap<(Vec<u8>, Option<Vec<u8>>), usize>,
    current: Option<usize>,
    name: Vec<u8>,
    material: Option<Vec<u8>>,
    libraries: Vec<PathBuf>,
    corners: Vec<Corner>,
    skipped: usize,
    /// Corners that name a texture coordinate and a normal that are not there.
    absent: [usize; 2],
}

#[derive(Default)]
struct Group {
    name: Vec<u8>,
    material: Option<Vec<u8>>,
    triangles: Vec<[Corner; 3]>,
}

impl Reader {
    fn line(&mut self, line: &[u8]) -> Parsed<()> {
        let keyword = line.iter().position(u8::is_ascii_whitespace).unwrap_or(line.len());
        let (keyword, rest) = line.split_at(keyword);
        let rest = rest.trim_ascii_start();
        match keyword {
            b"v" => self.vertex(rest)?,
            b"vt" => {
                // One number makes a 1D texture coordinate.
                let ([u, v, ..], n) = floats::<3>(rest)?;
                self.uvs.push([u, if n > 1 { v } else { 0.0 }]);
            }
            b"vn" => match floats::<3>(rest)? {
                (n, 3) => self.normals.push(n),
                _ => return invalid("a vn needs three numbers"),
            },
            b"f" | b"fo" => self.face(rest)?,
            b"o" | b"g" => self.regroup(|r| r.name = rest.to_vec()),
            b"usemtl" => self.regroup(|r| r.material = (!rest.is_empty()).then(|| rest.to_vec())),
            b"mtllib" => self.libraries.push(PathBuf::from(String::from_utf8_lossy(rest).replace('\\', "/"))),
            b"" | b"s" => {}
            b"l" | b"p" | b"curv" | b"curv2" | b"surf" => self.skipped += 1,
            _ => {
                // Unknown statements of the standard are skipped; binary garbage is not text.
                if keyword.iter().any(|b| b.is_ascii_control()) {
                    return invalid("this is not OBJ text");
                }
            }
        }
        Ok(())
    }

    fn vertex(&mut self, rest: &[u8]) -> Parsed<()> {
        let (v, n) = numbers::<7>(rest)?;
        if n < 3 {
            return invalid("a v needs three numbers");
        }
        if self.positions.len() >= NONE as usize {
            return invalid("more vertices than 32-bit indices reach");
        }
        let rgb = match n {
            6 => Some([v[3], v[4], v[5]]),
            7 => Some([v[4], v[5], v[6]]), // after the weight
            _ => None,
        };
        match rgb.map(|rgb| rgb.map(|c| c as f32)) {
            Some(rgb) => {
                self.colors.resize(self.positions.len(), [1.0; 3]); // earlier ones had none
                self.colors.push(rgb);
            }
            None if !self.colors.is_empty() => self.colors.push([1.0; 3]),
            None => {}
        }
        self.positions.push([v[0], v[1], v[2]]);
        Ok(())
    }

    fn regroup(&mut self, change: impl FnOnce(&mut Self)) {
        change(self);
        self.current = None;
    }

    fn group(&mut self) -> usize {
        if let Some(current) = self.current {
            return current;
        }
        let key = (self.name.clone(), self.material.clone());
        let index = *self.by_name.entry(key).or_insert_with(|| {
            self.groups.push(Group { name: self.name.clone(), material: self.material.clone(), triangles: vec![] });
            self.groups.len() - 1
        });
        self.current = Some(index);
        index
    }

    fn face(&mut self, rest: &[u8]) -> Parsed<()> {
        self.corners.clear();
        let lengths = [self.positions.len(), self.uvs.len(), self.normals.len()];
        for word in rest.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty()) {
            self.corners.push(corner(word, lengths, &mut self.absent)?);
        }
        if self.corners.len() < 3 {
            self.skipped += 1;
            return Ok(());
        }
        let group = self.group();
        let Self { positions, groups, corners, .. } = self;
        let triangles = &mut groups[group].triangles;
        let at = |i: usize| positions[corners[i][0] as usize];
        polygon::triangulate(corners.len(), at, |t| triangles.push(t.map(|i| corners[i])));
        Ok(())
    }

    fn finish(self, path: &Path) -> Result<Loaded> {
        let mut warnings = Vec::new();
        if self.skipped > 0 {
            warnings.push(format!("{} points, lines, curves or faces of two corners were left out", self.skipped));
        }
        if self.positions.is_empty() {
            return Err(Error::invalid(path, "no vertices: this is not an OBJ file, or it is empty"));
        }
        let names = ["texture coordinates (vt)", "normals (vn)"];
        for (name, count) in names.iter().zip(self.absent).filter(|(_, count)| *count > 0) {
            warnings
                .push(format!("{count} corners of faces name {name} that the file does not have: they are without"));
        }
        let origin = origin::of(self.positions.iter().map(|p| DVec3::from(*p))).unwrap_or(DVec3::ZERO);
        let folder = path.parent().unwrap_or(Path::new(""));
        let material_files = self.libraries.iter().map(|l| folder.join(l)).collect();
        let parts = self.groups.iter().filter(|g| !g.triangles.is_empty());
        let mut parts = parts.map(|g| self.part(g, path, origin)).collect::<Result<Vec<_>>>()?;
        if parts.is_empty() {
            parts.push(Part::named(path, self.points(origin)));
        }
        Ok(Loaded { parts, material_files, warnings, origin, ..Loaded::default() })
    }

    /// All vertices, without triangles.
    fn points(&self, origin: DVec3) -> TriMesh {
        TriMesh {
            positions: self.positions.iter().map(|p| about(origin, p)).collect(),
            colors: (!self.colors.is_empty()).then(|| self.colors.clone()),
            ..TriMesh::default()
        }
    }

    /// Makes vertices from the distinct corners of a group, in the order of their first use.
    fn part(&self, group: &Group, path: &Path, origin: DVec3) -> Result<Part> {
        let all = |which: usize| group.triangles.iter().flatten().all(|c| c[which] != NONE);
        let any = |which: usize| group.triangles.iter().flatten().any(|c| c[which] != NONE);
        // Normals on some corners only are as good as none; texture coordinates are filled with zeros.
        let (with_uvs, with_normals) = (any(1), all(2));
        let mut vertices: Vec<Corner> = Vec::new();
        let mut numbers: HashMap<Corner, u32> = HashMap::new();
        let mut number = |[p, t, n]: Corner| {
            let corner = [p, if with_uvs { t } else { NONE }, if with_normals { n } else { NONE }];
            *numbers.entry(corner).or_insert_with(|| {
                vertices.push(corner);
                (vertices.len() - 1) as u32
            })
        };
        let indices: Vec<[u32; 3]> = group.triangles.iter().map(|t| t.map(&mut number)).collect();
        if vertices.len() >= NONE as usize {
            return Err(Error::unsupported(path, "more distinct corners than 32-bit indices reach"));
        }
        let mesh = TriMesh {
            positions: vertices.iter().map(|v| about(origin, &self.positions[v[0] as usize])).collect(),
            normals: with_normals.then(|| vertices.iter().map(|v| self.normals[v[2] as usize]).collect()),
            uvs: with_uvs
                .then(|| vertices.iter().map(|v| self.uvs.get(v[1] as usize).copied().unwrap_or_default()).collect()),
            colors: (!self.colors.is_empty()).then(|| vertices.iter().map(|v| self.colors[v[0] as usize]).collect()),
            indices,
            ..TriMesh::default()
        };
        let mut part = Part::named(path, mesh);
        if !group.name.is_empty() {
            part.name = String::from_utf8_lossy(&group.name).into_owned();
        }
        part.material = group.material.as_deref().map(|m| String::from_utf8_lossy(m).into_owned());
        Ok(part)
    }
}

fn about(origin: DVec3, p: &[f64; 3]) -> [f32; 3] {
    (DVec3::from(*p) - origin).as_vec3().into()
}

/// [`numbers`] as 32-bit floats.
fn floats<const N: usize>(rest: &[u8]) -> Parsed<([f32; N], usize)> {
    numbers::<N>(rest).map(|(values, n)| (values.map(|x| x as f32), n))
}

/// Up to `N` numbers; more are ignored.
fn numbers<const N: usize>(rest: &[u8]) -> Parsed<([f64; N], usize)> {
    let mut values = [0.0; N];
    let mut n = 0;
    for word in crate::lines::words(rest).take(N) {
        values[n] = crate::lines::number(word)?;
        n += 1;
    }
    if n == 0 {
        return invalid("numbers are missing");
    }
    Ok((values, n))
}

/// `p`, `p/t`, `p//n` or `p/t/n`, counted from 1, or backwards from the newest by negative numbers.
/// Texture coordinates and normals that are not there are counted in `absent`.
fn corner(word: &[u8], lengths: [usize; 3], absent: &mut [usize; 2]) -> Parsed<Corner> {
    let mut corner = [NONE; 3];
    for (which, field) in word.split(|&b| b == b'/').take(3).enumerate() {
        if field.is_empty() && which > 0 {
            continue;
        }
        let Some(i) = integer(field) else {
            return invalid(format!("face corner {:?}", shown(word)));
        };
        let length = lengths[which] as i64;
        let index = if i < 0 { length + i } else { i - 1 };
        match (which, (0..length).contains(&index)) {
            (_, true) => corner[which] = index as u32,
            (0, false) => return invalid(format!("a face uses vertex {i}, there are {length} so far")),
            (_, false) => absent[which - 1] += 1,
        }
    }
    Ok(corner)
}

fn integer(field: &[u8]) -> Option<i64> {
    let (negative, digits) = match field {
        [b'-', digits @ ..] => (true, digits),
        [b'+', digits @ ..] => (false, digits),
        digits => (false, digits),
    };
    if digits.is_empty() || digits.len() > 18 || !digits.iter().all(u8::is_ascii_digit) {
        return None;
    }
    let n = digits.iter().fold(0, |n, d| 10 * n + i64::from(d - b'0'));
    Some(if negative { -n } else { n })
}

/// Writes positions, texture coordinates, normals, colours (six-number v lines) and triangles.
///
/// # Errors
/// Those of `out`.
pub fn write(mesh: &TriMesh, out: &mut dyn Write) -> std::io::Result<()> {
    write_about(mesh, DVec3::ZERO, out)
}

/// [`write()`] with `origin` added to all positions.
///
/// # Errors
/// Those of `out`.
pub fn write_about(mesh: &TriMesh, origin: DVec3, out: &mut dyn Write) -> std::io::Result<()> {
    for (i, p) in mesh.positions.iter().enumerate() {
        // Without an origin the shortest text that gives the same 32-bit float.
        let [x, y, z] = match origin == DVec3::ZERO {
            true => p.map(|x| x.to_string()),
            false => (DVec3::from(p.map(f64::from)) + origin).to_array().map(|x| x.to_string()),
        };
        match mesh.colors.as_ref().map(|c| c[i]) {
            Some([r, g, b]) => writeln!(out, "v {x} {y} {z} {r} {g} {b}")?,
            None => writeln!(out, "v {x} {y} {z}")?,
        }
    }
    for [u, v] in mesh.uvs.iter().flatten() {
        writeln!(out, "vt {u} {v}")?;
    }
    for [x, y, z] in mesh.normals.iter().flatten() {
        writeln!(out, "vn {x} {y} {z}")?;
    }
    let (uvs, normals) = (mesh.uvs.is_some(), mesh.normals.is_some());
    for triangle in &mesh.indices {
        write!(out, "f")?;
        for i in triangle.map(|i| u64::from(i) + 1) {
            match (uvs, normals) {
                (true, true) => write!(out, " {i}/{i}/{i}")?,
                (true, false) => write!(out, " {i}/{i}")?,
                (false, true) => write!(out, " {i}//{i}")?,
                (false, false) => write!(out, " {i}")?,
            }
        }
        writeln!(out)?;
    }
    Ok(())
}

/// A material of an MTL library, as written; what is absent is `None`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Material {
    /// Name after `newmtl`.
    pub name: String,
    /// Kd, diffuse colour.
    pub diffuse: Option<[f32; 3]>,
    /// Ks, specular colour.
    pub specular: Option<[f32; 3]>,
    /// Ke, emitted colour.
    pub emission: Option<[f32; 3]>,
    /// Ns, Phong exponent.
    pub exponent: Option<f32>,
    /// Ni, index of refraction.
    pub ior: Option<f32>,
    /// d (or 1 − Tr), opacity.
    pub opacity: Option<f32>,
    /// Pr, roughness.
    pub roughness: Option<f32>,
    /// Pm, metalness.
    pub metallic: Option<f32>,
    /// illum, illumination model.
    pub illumination: Option<u32>,
    /// Textures by statement (`map_Kd`, `map_Bump`, …), resolved against the library's folder.
    pub textures: Vec<(String, PathBuf)>,
}

/// Reads an MTL library. Unknown statements are skipped.
///
/// # Errors
/// [`Error::Io`], [`Error::Invalid`] with the line.
pub fn read_mtl(path: &Path) -> Result<Vec<Material>> {
    let bytes = bytes_of(path)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut materials: Vec<Material> = Vec::new();
    lines(&bytes, |line| {
        let keyword = line.iter().position(u8::is_ascii_whitespace).unwrap_or(line.len());
        let (keyword, rest) = line.split_at(keyword);
        let rest = rest.trim_ascii_start();
        if keyword == b"newmtl" {
            materials.push(Material { name: String::from_utf8_lossy(rest).into_owned(), ..Material::default() });
            return Ok(());
        }
        match materials.last_mut() {
            Some(material) => statement(material, keyword, rest, folder),
            None => Ok(()),
        }
    })
    .map_err(|fault| fault.at(path))?;
    Ok(materials)
}

fn statement(material: &mut Material, keyword: &[u8], rest: &[u8], folder: &Path) -> Parsed<()> {
    // "Kd spectral file.rfl" and "Kd xyz …" are left out.
    let color = || match floats::<3>(rest) {
        Ok((rgb, 3)) => Some(rgb),
        Ok((rgb, _)) => Some([rgb[0]; 3]),
        Err(_) => None,
    };
    let scalar = || floats::<1>(rest).map(|([x], _)| Some(x));
    match keyword {
        b"Kd" => material.diffuse = color(),
        b"Ks" => material.specular = color(),
        b"Ke" => material.emission = color(),
        b"Ns" => material.exponent = scalar()?,
        b"Ni" => material.ior = scalar()?,
        b"d" => material.opacity = scalar()?,
        b"Tr" => material.opacity = scalar()?.map(|t| 1.0 - t),
        b"Pr" => material.roughness = scalar()?,
        b"Pm" => material.metallic = scalar()?,
        b"illum" => material.illumination = scalar()?.map(|x| x as u32),
        _ if keyword.starts_with(b"map_") || matches!(keyword, b"bump" | b"norm" | b"disp") => {
            if let Some(file) = texture_file(rest) {
                let statement = String::from_utf8_lossy(keyword).into_owned();
                material.textures.push((statement, folder.join(file.replace('\\', "/"))));
            }
        }
        _ => {}
    }
    Ok(())
}

/// The file name after texture options such as `-bm 0.5` or `-o u v w`; names may hold spaces.
fn texture_file(rest: &[u8]) -> Option<String> {
    let text = String::from_utf8_lossy(rest);
    let mut words = text.split_ascii_whitespace().peekable();
    while let Some(option) = words.next_if(|w| w.starts_with('-')) {
        let most = match option {
            "-o" | "-s" | "-t" => 3,
            "-mm" => 2,
            _ => 1,
        };
        for i in 0..most {
            // -o, -s and -t take one to three numbers.
            if most == 3 && i > 0 && words.peek().is_some_and(|w| w.parse::<f32>().is_err()) {
                break;
            }
            words.next();
        }
    }
    let file = words.collect::<Vec<_>>().join(" ");
    (!file.is_empty()).then_some(file)
}
