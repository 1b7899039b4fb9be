//! From XML text to a tree of elements: `<include>`, `<default>`, `$name` and `<path>` are resolved here.
//!
//! Document type declarations are refused, so entities cannot multiply; values of parameters are refused when they grow beyond
//! [`LONGEST_VALUE`], includes when they go in circles, are more than [`MOST_INCLUDES`] or when the whole grows beyond
//! [`MOST_ELEMENTS`]. Messages name places in included files, but do not quote them: a scene may name any file.

use crate::{Error, Result};
use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// A whole scene has no more elements than this.
const MOST_ELEMENTS: usize = 4_000_000;
/// A value is not longer with the values of its parameters put in, and what is put in is not longer in all.
const LONGEST_VALUE: usize = 1 << 20;
const MOST_PUT_IN: usize = 1 << 27;
/// Parameters of a scene, and files that it includes, with the bytes of these.
const MOST_PARAMETERS: usize = 10_000;
const MOST_INCLUDES: usize = 10_000;
const MOST_INCLUDED: usize = 1 << 28;
/// Includes and elements do not nest deeper.
const DEEPEST_INCLUDE: usize = 32;
const DEEPEST_ELEMENT: usize = 200;

/// Where an element stands.
#[derive(Clone, Debug)]
pub(crate) struct Place {
    pub(crate) file: Rc<Path>,
    pub(crate) line: u32,
}

impl Place {
    pub(crate) fn invalid(&self, what: impl Into<String>) -> Error {
        Error::invalid(&self.file, self.line, what)
    }

    pub(crate) fn unsupported(&self, what: impl Into<String>) -> Error {
        Error::unsupported(&self.file, self.line, what)
    }

    pub(crate) fn warning(&self, what: impl std::fmt::Display) -> String {
        format!("{}: {what}", crate::error::place(&self.file, Some(self.line)))
    }
}

/// An element with its attributes, parameters filled in.
#[derive(Debug)]
pub(crate) struct Element {
    /// Name in lower case: dialects differ there.
    pub(crate) tag: String,
    attributes: Vec<(String, String, Cell<bool>)>,
    pub(crate) children: Vec<Element>,
    pub(crate) place: Place,
}

impl Element {
    /// An attribute's value.
    pub(crate) fn get(&self, name: &str) -> Option<&str> {
        let (_, value, used) = self.attributes.iter().find(|a| a.0 == name)?;
        used.set(true);
        Some(value)
    }

    /// An attribute that must be there.
    pub(crate) fn need(&self, name: &str) -> Result<&str> {
        self.get(name).ok_or_else(|| self.place.invalid(format!("<{}> has no attribute {name:?}", self.tag)))
    }

    /// Attributes nobody asked for.
    pub(crate) fn unused(&self) -> impl Iterator<Item = &str> {
        self.attributes.iter().filter(|a| !a.2.get()).map(|a| a.0.as_str())
    }
}

/// The tree with what belongs to the whole of it.
pub(crate) struct Tree {
    pub(crate) root: Element,
    /// Folders in which files are looked for: that of the scene first.
    pub(crate) folders: Vec<PathBuf>,
    pub(crate) warnings: Vec<String>,
}

/// Reads the file `path` and those it includes. `defines` are values of parameters.
pub(crate) fn read(path: &Path, text: &str, defines: &[(String, String)]) -> Result<Tree> {
    let folder = path.parent().unwrap_or(Path::new("")).to_owned();
    let mut reader = Reader {
        parameters: defines.iter().map(|(n, v)| (n.clone(), v.clone(), Cell::new(false))).collect(),
        given: defines.len(),
        folders: vec![folder],
        open: vec![path.canonicalize().unwrap_or_else(|_| path.to_owned())],
        elements: 0,
        put_in: 0,
        included: (0, 0),
        warnings: Vec::new(),
    };
    let root = reader.file(path, text)?;
    for (name, _, used) in &reader.parameters[..reader.given] {
        if !used.get() {
            reader.warnings.push(format!("{}: no parameter ${name} in the scene", path.display()));
        }
    }
    Ok(Tree { root, folders: reader.folders, warnings: reader.warnings })
}

struct Reader {
    /// Name, value and whether the file knows it.
    parameters: Vec<(String, String, Cell<bool>)>,
    /// How many of them came from outside.
    given: usize,
    folders: Vec<PathBuf>,
    /// Files being read, outermost first.
    open: Vec<PathBuf>,
    elements: usize,
    /// Bytes that stand for parameters.
    put_in: usize,
    /// Files that were included, and their bytes.
    included: (usize, usize),
    warnings: Vec<String>,
}

impl Reader {
    fn file(&mut self, path: &Path, text: &str) -> Result<Element> {
        let limit = u32::try_from(MOST_ELEMENTS).unwrap_or(u32::MAX);
        let options = roxmltree::ParsingOptions { allow_dtd: false, nodes_limit: limit, ..Default::default() };
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        check_depth(path, text)?;
        let document = roxmltree::Document::parse_with_options(text, options).map_err(|e| {
            let line = Some(e.pos().row).filter(|&row| row > 0);
            match e {
                roxmltree::Error::DtdDetected => {
                    Error::unsupported(path, line, "document type declarations are not read; remove <!DOCTYPE …>")
                }
                e => Error::invalid(path, line, format!("XML: {}", without_position(&e.to_string()))),
            }
        })?;
        let lines = Lines::new(text);
        let mut children = Vec::new();
        self.element(&document.root_element(), &Rc::from(path), &lines, &mut children)?;
        children.pop().ok_or_else(|| Error::invalid(path, None, "the file has no scene"))
    }

    /// Appends `node` to `out`, or what it stands for.
    fn element(
        &mut self,
        node: &roxmltree::Node,
        file: &Rc<Path>,
        lines: &Lines,
        out: &mut Vec<Element>,
    ) -> Result<()> {
        let place = Place { file: file.clone(), line: lines.of(node.range().start) };
        self.elements += 1;
        if self.elements > MOST_ELEMENTS {
            return Err(place.unsupported(format!("the scene has more than {MOST_ELEMENTS} elements")));
        }
        let mut element = Element {
            tag: node.tag_name().name().to_ascii_lowercase(),
            attributes: Vec::new(),
            children: Vec::new(),
            place,
        };
        for attribute in node.attributes() {
            let value = self.substitute(attribute.value(), &element.place)?;
            element.attributes.push((attribute.name().to_owned(), value, Cell::new(false)));
        }
        match element.tag.as_str() {
            "default" => return self.default(&element),
            "include" => return self.include(&element, out),
            "path" => return self.path(&element),
            _ => {}
        }
        for child in node.children() {
            if child.is_element() {
                self.element(&child, file, lines, &mut element.children)?;
            } else if let Some(text) = child.text().map(str::trim).filter(|t| child.is_text() && !t.is_empty()) {
                // The user's own file is quoted, others are not.
                let start: String = text.chars().take(40).collect();
                let quote = if self.open.len() == 1 { format!(" ({start:?})") } else { String::new() };
                return Err(element.place.invalid(format!("<{}> holds text{quote}", element.tag)));
            }
        }
        out.push(element);
        Ok(())
    }

    fn default(&mut self, element: &Element) -> Result<()> {
        let (name, value) = (element.need("name")?, element.need("value")?);
        match self.parameters.iter().find(|p| p.0 == name) {
            Some((_, _, used)) => used.set(true),
            None if self.parameters.len() >= MOST_PARAMETERS => {
                return Err(element.place.unsupported(format!("the scene has more than {MOST_PARAMETERS} parameters")));
            }
            None => self.parameters.push((name.to_owned(), value.to_owned(), Cell::new(true))),
        }
        Ok(())
    }

    fn path(&mut self, element: &Element) -> Result<()> {
        let value = element.need("value")?;
        let folder = self.folders.iter().map(|f| f.join(value)).find(|f| f.is_dir());
        let Some(folder) = folder else {
            return Err(element.place.invalid(format!("<path>: there is no folder {value:?}")));
        };
        self.folders.insert(0, folder);
        Ok(())
    }

    /// The children of an included `<scene>`, or the one element that the file holds.
    fn include(&mut self, element: &Element, out: &mut Vec<Element>) -> Result<()> {
        let place = &element.place;
        let path = find(&self.folders, element.need("filename")?, place);
        let name = path.canonicalize().unwrap_or_else(|_| path.clone());
        if self.open.contains(&name) {
            return Err(place.invalid(format!("{} includes itself", path.display())));
        }
        if self.open.len() >= DEEPEST_INCLUDE {
            return Err(place.unsupported(format!("includes nest deeper than {DEEPEST_INCLUDE}")));
        }
        let text = read_text(&path).map_err(|e| match e {
            Error::Io { source, .. } => place.invalid(format!("cannot include {}: {source}", path.display())),
            e => e,
        })?;
        self.included = (self.included.0 + 1, self.included.1.saturating_add(text.len()));
        if self.included.0 > MOST_INCLUDES || self.included.1 > MOST_INCLUDED {
            let what =
                format!("too many includes: more than {MOST_INCLUDES} files or {} MiB in all", MOST_INCLUDED >> 20);
            return Err(place.unsupported(what));
        }
        self.open.push(name);
        let root = self.file(&path, &text)?;
        self.open.pop();
        match root.tag.as_str() {
            "scene" => out.extend(root.children),
            _ => out.push(root),
        }
        Ok(())
    }

    /// `text` with parameters for their names.
    fn substitute(&mut self, text: &str, place: &Place) -> Result<String> {
        let mut result = String::new();
        let mut rest = text;
        while let Some((before, after)) = rest.split_once('$') {
            result.push_str(before);
            // The longest name that fits: $spp_final is not $spp followed by _final.
            let fits = |p: &&(String, String, Cell<bool>)| after.starts_with(&p.0) && !p.0.is_empty();
            let Some((name, value, used)) = self.parameters.iter().filter(fits).max_by_key(|p| p.0.len()) else {
                let name: String = after.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
                let what = format!("parameter ${name} has no value; define it, or give it a <default>");
                return Err(place.invalid(what));
            };
            used.set(true);
            self.put_in += value.len();
            if result.len() + value.len() > LONGEST_VALUE || self.put_in > MOST_PUT_IN {
                let what = format!(
                    "too long a value: with ${name} put in it has more than {} KiB, or all such values more than {} MiB",
                    LONGEST_VALUE >> 10,
                    MOST_PUT_IN >> 20
                );
                return Err(place.unsupported(what));
            }
            result.push_str(value);
            rest = &after[name.len()..];
        }
        result.push_str(rest);
        Ok(result)
    }
}

/// The file `name` in the first of `folders` that has it, the first folder's if none has; absolute names as they are,
/// and names relative to the file that names them before the others.
pub(crate) fn find(folders: &[PathBuf], name: &str, place: &Place) -> PathBuf {
    // Scenes from other systems use backslashes.
    let named: PathBuf = if cfg!(unix) && name.contains('\\') && !name.contains('/') {
        name.replace('\\', "/").into()
    } else {
        name.into()
    };
    let beside = place.file.parent().map(Path::to_owned);
    let candidates = beside.into_iter().chain(folders.iter().cloned()).map(|f| f.join(&named));
    let mut first = None;
    for candidate in candidates {
        if candidate.exists() {
            return candidate;
        }
        first.get_or_insert(candidate);
    }
    first.unwrap_or(named)
}

/// The file as UTF-8, or Latin-1 where it is not.
pub(crate) fn read_text(path: &Path) -> Result<String> {
    let bytes = crate::files::bytes(path)?;
    Ok(match String::from_utf8(bytes) {
        Ok(text) => text,
        Err(e) => e.into_bytes().iter().map(|&b| char::from(b)).collect(),
    })
}

/// The parser's recursion, and ours, must not exhaust the stack: counts how deep tags nest.
fn check_depth(path: &Path, text: &str) -> Result<()> {
    let bytes = text.as_bytes();
    let (mut depth, mut i) = (0_usize, 0);
    while let Some(next) = bytes[i..].iter().position(|&b| b == b'<') {
        i += next;
        let rest = &bytes[i..];
        let past = |end: &[u8]| rest.windows(end.len()).position(|w| w == end).map_or(rest.len(), |n| n + end.len());
        i += match rest {
            [b'<', b'!', b'-', b'-', ..] => past(b"-->"),
            [b'<', b'!', b'[', ..] => past(b"]]>"),
            [b'<', b'?', ..] => past(b"?>"),
            [b'<', b'/', ..] => {
                depth = depth.saturating_sub(1);
                2
            }
            _ => {
                let length = tag_length(rest);
                depth += usize::from(rest[..length].last_chunk() != Some(b"/>"));
                length
            }
        };
        if depth > DEEPEST_ELEMENT {
            let line = 1 + bytes[..i].iter().filter(|&&b| b == b'\n').count() as u32;
            return Err(Error::unsupported(path, line, format!("elements nest deeper than {DEEPEST_ELEMENT}")));
        }
    }
    Ok(())
}

/// Bytes of the tag that `rest` begins with, its `>` included; a `>` in quotes does not end it.
fn tag_length(rest: &[u8]) -> usize {
    let mut quote = None;
    for (i, &b) in rest.iter().enumerate() {
        match (quote, b) {
            (None, b'>') => return i + 1,
            (None, b'"' | b'\'') => quote = Some(b),
            (Some(q), b) if q == b => quote = None,
            _ => {}
        }
    }
    rest.len()
}

/// The XML parser's message without its "at 3:7": the place stands in front already.
fn without_position(message: &str) -> &str {
    message.rsplit_once(" at ").map_or(message, |(m, p)| if p.contains(':') { m } else { message })
}

/// Line numbers of byte offsets.
struct Lines(Vec<usize>);

impl Lines {
    fn new(text: &str) -> Self {
        Self(text.bytes().enumerate().filter(|b| b.1 == b'\n').map(|b| b.0).collect())
    }

    fn of(&self, offset: usize) -> u32 {
        self.0.partition_point(|&end| end < offset) as u32 + 1
    }
}
