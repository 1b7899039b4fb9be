//! The modules of a crate and which of them names which: `use` and paths, re-exports followed to where things are defined.
//!
//! Limits: macros are read as words, names that a macro makes are not seen, a `use` within a function counts for the whole
//! module, and single words are taken to be what a `use` said.

use crate::source;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use syn::visit::Visit;

/// A crate's modules; the first is its root.
#[derive(Debug, Default)]
pub(crate) struct Modules {
    all: Vec<Module>,
}

/// A module with what it defines, imports and names.
#[derive(Debug, Default)]
struct Module {
    /// `world::hit`; empty for the root.
    name: String,
    parent: Option<usize>,
    children: BTreeMap<String, usize>,
    defined: BTreeSet<String>,
    imports: Vec<Import>,
    /// Modules of which everything is imported.
    globs: Vec<Vec<String>>,
    /// Paths of two and more words in its code.
    named: Vec<Vec<String>>,
}

#[derive(Debug)]
struct Import {
    name: String,
    path: Vec<String>,
    /// `pub use`, in any visibility.
    again: bool,
}

/// What a path leads to.
#[derive(Clone, Copy, PartialEq)]
enum Target {
    Module(usize),
    /// Something that this module defines.
    Item(usize),
}

/// Longest chain of re-exports.
const DEPTH: usize = 16;

impl Modules {
    /// Reads a crate from its root file.
    ///
    /// # Errors
    /// A file that is missing or cannot be parsed.
    pub(crate) fn read(root: &Path) -> Result<Self, String> {
        Self::load(root, &|path| std::fs::read_to_string(path).ok())
    }

    fn load(root: &Path, read: &dyn Fn(&Path) -> Option<String>) -> Result<Self, String> {
        let mut modules = Self::default();
        let text = read(root).ok_or_else(|| format!("{}: cannot be read", root.display()))?;
        let file = source::parse(root, &text)?;
        let folder = root.parent().unwrap_or(Path::new("")).to_owned();
        modules.add(String::new(), None, (&file.items, &folder), read)?;
        Ok(modules)
    }

    /// Adds a module and those below it; `folder` is where the files of its children are.
    fn add(
        &mut self,
        name: String,
        parent: Option<usize>,
        (items, folder): (&[syn::Item], &Path),
        read: &dyn Fn(&Path) -> Option<String>,
    ) -> Result<usize, String> {
        let index = self.all.len();
        let mut reader = Reader { module: Module { name: name.clone(), parent, ..Module::default() } };
        items.iter().for_each(|item| reader.visit_item(item));
        self.all.push(reader.module);
        for item in items {
            let syn::Item::Mod(inner) = item else { continue };
            if source::is_test(&inner.attrs) {
                continue;
            }
            let short = inner.ident.to_string();
            let below = folder.join(&short);
            let full = if name.is_empty() { short.clone() } else { format!("{name}::{short}") };
            let child = match &inner.content {
                Some((_, items)) => self.add(full, Some(index), (items, &below), read)?,
                None => {
                    let places: [PathBuf; 2] = [folder.join(format!("{short}.rs")), below.join("mod.rs")];
                    let found = places.iter().find_map(|p| Some((p, read(p)?)));
                    let (path, text) = found.ok_or_else(|| format!("{}: no such module", below.display()))?;
                    let file = source::parse(path, &text)?;
                    self.add(full, Some(index), (&file.items, &below), read)?
                }
            };
            self.all[index].children.insert(short, child);
        }
        Ok(index)
    }

    /// Names of the modules, the root's being `crate`.
    fn name(&self, module: usize) -> String {
        if module == 0 { "crate".into() } else { self.all[module].name.clone() }
    }

    pub(crate) fn len(&self) -> usize {
        self.all.len()
    }

    fn is_above(&self, above: usize, below: usize) -> bool {
        let parents = std::iter::successors(self.all[below].parent, |m| self.all[*m].parent);
        parents.into_iter().any(|m| m == above)
    }

    /// For each module those whose definitions it names, itself left out. What a module only passes on from those below it does
    /// not count.
    fn edges(&self) -> Vec<BTreeSet<usize>> {
        let of = |m: usize| {
            let module = &self.all[m];
            let passed_on = |import: &Import, to: usize| import.again && self.is_above(m, to);
            let imported = module.imports.iter().filter_map(|i| {
                let to = self.place(m, &i.path)?;
                (!passed_on(i, to)).then_some(to)
            });
            let globs = module.globs.iter().filter_map(|path| self.place(m, path)).filter(|to| !self.is_above(m, *to));
            let named = module.named.iter().filter_map(|path| self.place(m, path));
            imported.chain(globs).chain(named).filter(|to| *to != m).collect()
        };
        (0..self.all.len()).map(of).collect()
    }

    /// The module where what a path leads to is defined; `None` outside the crate.
    fn place(&self, from: usize, path: &[String]) -> Option<usize> {
        match self.resolve(from, path, DEPTH)? {
            Target::Module(m) | Target::Item(m) => Some(m),
        }
    }

    fn resolve(&self, from: usize, path: &[String], depth: usize) -> Option<Target> {
        let (first, mut rest) = path.split_first()?;
        let mut at = match first.as_str() {
            "crate" => Target::Module(0),
            "self" => Target::Module(from),
            "super" => {
                let mut at = self.all[from].parent?;
                while let Some((_, more)) = rest.split_first().filter(|(word, _)| *word == "super") {
                    (at, rest) = (self.all[at].parent?, more);
                }
                Target::Module(at)
            }
            word => self.find(from, word, depth)?,
        };
        for word in rest {
            let Target::Module(module) = at else { break };
            // What is not found was made by a macro, there.
            at = self.find(module, word, depth).unwrap_or(Target::Item(module));
        }
        Some(at)
    }

    /// What a word means in a module.
    fn find(&self, module: usize, word: &str, depth: usize) -> Option<Target> {
        let depth = depth.checked_sub(1)?;
        let m = &self.all[module];
        if let Some(child) = m.children.get(word) {
            return Some(Target::Module(*child));
        }
        if m.defined.contains(word) {
            return Some(Target::Item(module));
        }
        // `use word::…` says the outer word, a crate.
        let import = m.imports.iter().find(|i| i.name == word && i.path[0] != word);
        if let Some(import) = import {
            return self.resolve(module, &import.path, depth);
        }
        let globbed = |path: &Vec<String>| match self.resolve(module, path, depth)? {
            Target::Module(of) if of != module => self.find(of, word, depth),
            _ => None,
        };
        m.globs.iter().find_map(globbed)
    }

    /// Modules that lead to each other, but for parents with their children: circles that all go through one module with all
    /// others below it are taken apart without it.
    pub(crate) fn circles(&self) -> Vec<Vec<String>> {
        let edges = self.edges();
        let mut open = vec![(0..self.all.len()).collect::<BTreeSet<usize>>()];
        let mut found = Vec::new();
        while let Some(among) = open.pop() {
            for mut circle in components(&edges, &among) {
                let top = circle.iter().copied().find(|t| circle.iter().all(|m| m == t || self.is_above(*t, *m)));
                match top {
                    Some(top) => {
                        circle.remove(&top);
                        open.push(circle);
                    }
                    None => found.push(circle.iter().map(|m| self.name(*m)).collect()),
                }
            }
        }
        found.sort();
        found
    }

    /// Who names whom within a circle, for the message.
    pub(crate) fn within(&self, circle: &[String]) -> String {
        let edges = self.edges();
        let number = |name: &String| (0..self.all.len()).find(|m| self.name(*m) == *name);
        let members: BTreeSet<usize> = circle.iter().filter_map(number).collect();
        let line = |m: &usize| {
            let to: Vec<_> = edges[*m].intersection(&members).map(|t| self.name(*t)).collect();
            format!("    {} -> {}", self.name(*m), to.join(", "))
        };
        members.iter().map(line).collect::<Vec<_>>().join("\n")
    }
}

/// Sets of two and more nodes that reach each other, within `among`.
fn components(edges: &[BTreeSet<usize>], among: &BTreeSet<usize>) -> Vec<BTreeSet<usize>> {
    let reach = |from: usize| {
        let (mut seen, mut open) = (BTreeSet::new(), vec![from]);
        while let Some(node) = open.pop() {
            open.extend(edges[node].intersection(among).filter(|next| seen.insert(**next)));
        }
        seen
    };
    let reached: BTreeMap<usize, BTreeSet<usize>> = among.iter().map(|m| (*m, reach(*m))).collect();
    let mut left = among.clone();
    let mut found = Vec::new();
    while let Some(first) = left.pop_first() {
        let with: BTreeSet<_> =
            left.iter().copied().filter(|m| reached[&first].contains(m) && reached[m].contains(&first)).collect();
        if !with.is_empty() {
            left.retain(|m| !with.contains(m));
            found.push(with.into_iter().chain([first]).collect());
        }
    }
    found
}

/// Fills a [`Module`] from its items, not from those of modules within it.
struct Reader {
    module: Module,
}

impl Reader {
    fn tree(&mut self, before: &[String], tree: &syn::UseTree, again: bool) {
        let with = |word: &syn::Ident| [before, &[word.to_string()]].concat();
        let mut import = |name: String, path| self.module.imports.push(Import { name, path, again });
        match tree {
            syn::UseTree::Path(p) => self.tree(&with(&p.ident), &p.tree, again),
            syn::UseTree::Group(g) => g.items.iter().for_each(|t| self.tree(before, t, again)),
            syn::UseTree::Glob(_) => self.module.globs.push(before.to_vec()),
            syn::UseTree::Name(n) if n.ident == "self" => {
                if let Some(last) = before.last() {
                    import(last.clone(), before.to_vec());
                }
            }
            syn::UseTree::Name(n) => import(n.ident.to_string(), with(&n.ident)),
            syn::UseTree::Rename(r) if r.ident == "self" => import(r.rename.to_string(), before.to_vec()),
            syn::UseTree::Rename(r) => import(r.rename.to_string(), with(&r.ident)),
        }
    }
}

impl<'a> Visit<'a> for Reader {
    fn visit_item(&mut self, item: &'a syn::Item) {
        let (attributes, name) = match item {
            syn::Item::Const(i) => (&i.attrs, Some(&i.ident)),
            syn::Item::Enum(i) => (&i.attrs, Some(&i.ident)),
            syn::Item::Fn(i) => (&i.attrs, Some(&i.sig.ident)),
            syn::Item::Static(i) => (&i.attrs, Some(&i.ident)),
            syn::Item::Struct(i) => (&i.attrs, Some(&i.ident)),
            syn::Item::Trait(i) => (&i.attrs, Some(&i.ident)),
            syn::Item::Type(i) => (&i.attrs, Some(&i.ident)),
            syn::Item::Union(i) => (&i.attrs, Some(&i.ident)),
            syn::Item::Macro(i) => (&i.attrs, i.ident.as_ref()),
            syn::Item::Impl(i) => (&i.attrs, None),
            syn::Item::Use(i) => (&i.attrs, None),
            _ => return,
        };
        if source::is_test(attributes) {
            return;
        }
        self.module.defined.extend(name.map(|n| n.to_string()));
        syn::visit::visit_item(self, item);
    }

    fn visit_item_use(&mut self, item: &'a syn::ItemUse) {
        let again = !matches!(item.vis, syn::Visibility::Inherited);
        self.tree(&[], &item.tree, again);
    }

    fn visit_attribute(&mut self, _: &'a syn::Attribute) {}

    fn visit_path(&mut self, path: &'a syn::Path) {
        if path.segments.len() > 1 && path.leading_colon.is_none() {
            self.module.named.push(path.segments.iter().map(|s| s.ident.to_string()).collect());
        }
        syn::visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, call: &'a syn::Macro) {
        self.visit_path(&call.path);
        source::paths_in(call.tokens.clone(), &mut self.module.named);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn modules(files: &[(&str, &str)]) -> Modules {
        let read = |path: &Path| {
            let name = path.to_string_lossy().replace('\\', "/");
            files.iter().find(|f| f.0 == name).map(|f| f.1.to_owned())
        };
        Modules::load(Path::new("src/lib.rs"), &read).unwrap()
    }

    /// "from -> to" of all edges.
    fn told(modules: &Modules) -> Vec<String> {
        let edges = modules.edges().into_iter().enumerate();
        let line = |(from, to): (usize, BTreeSet<usize>)| {
            to.into_iter().map(|t| format!("{} -> {}", modules.name(from), modules.name(t))).collect::<Vec<_>>()
        };
        edges.flat_map(line).collect()
    }

    #[test]
    fn uses_and_paths_and_macros_are_edges() {
        let read = modules(&[
            ("src/lib.rs", "mod a; mod b; mod c; mod d;"),
            ("src/a.rs", "use crate::b::{self, One}; use std::fmt; fn f() { b::two(); let _ = fmt::Error; }"),
            ("src/b.rs", "pub struct One; pub fn two() { super::c::three::<crate::d::Four>() }"),
            ("src/c.rs", "pub fn three<T>() { println!(\"{}\", crate::d::NUMBER) }"),
            (
                "src/d.rs",
                "pub struct Four; pub const NUMBER: u8 = 4; #[cfg(test)] mod tests { use crate::a::f; } #[cfg(test)] use crate::b::One;",
            ),
        ]);
        assert_eq!(told(&read), ["a -> b", "b -> c", "b -> d", "c -> d"]);
        assert!(read.circles().is_empty());
    }

    #[test]
    fn re_exports_lead_to_the_definition() {
        let read = modules(&[
            ("src/lib.rs", "pub mod a; pub mod b; pub use b::Deep; pub use b::inner::*;"),
            (
                "src/a.rs",
                "use crate::Deep; use crate::Wide; use crate::b::Deep as Other; mod child { use super::Deep; }",
            ),
            ("src/b/mod.rs", "pub mod inner; pub use inner::Deep;"),
            ("src/b/inner.rs", "pub struct Deep; pub struct Wide;"),
        ]);
        assert_eq!(told(&read), ["a -> b::inner", "a::child -> b::inner"]);
    }

    #[test]
    fn circles_are_found_but_for_parents_with_children() {
        let parent = [
            ("src/lib.rs", "mod a; mod b; pub struct Shared; fn drive() { a::go(); b::go() }"),
            ("src/a.rs", "use crate::Shared; use crate::b; pub fn go() { b::go() }"),
            ("src/b.rs", "use crate::Shared; pub fn go() {}"),
        ];
        assert!(modules(&parent).circles().is_empty());
        let mut wrong = parent;
        wrong[2].1 = "use crate::Shared; use crate::a::go as other; pub fn go() { other() }";
        assert_eq!(modules(&wrong).circles(), [["a", "b"]]);
    }

    #[test]
    fn a_circle_through_a_parent_and_a_stranger_is_one() {
        let read = modules(&[
            ("src/lib.rs", "mod methods; mod world;"),
            ("src/methods/mod.rs", "mod path; pub trait Method {} fn all() { path::new() }"),
            ("src/methods/path.rs", "use crate::world::World; pub fn new() {}"),
            ("src/world.rs", "use crate::methods::Method; pub struct World;"),
        ]);
        assert_eq!(read.circles(), [["methods", "methods::path", "world"]]);
        let within = read.within(&read.circles()[0]);
        assert!(within.contains("world -> methods\n") || within.ends_with("world -> methods"), "{within}");
    }

    #[test]
    fn a_missing_module_is_an_error() {
        let read = |path: &Path| (path == Path::new("src/lib.rs")).then(|| "mod a;".to_owned());
        assert!(Modules::load(Path::new("src/lib.rs"), &read).is_err());
    }
}
