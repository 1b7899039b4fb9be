//! The Rust files of the workspace's crates, and what is where in them.

use proc_macro2::{TokenStream, TokenTree};
use std::path::{Path, PathBuf};
use syn::spanned::Spanned;

/// A named thing of a file: `function`, `Type::method`, `Trait::method`, `Type`, `CONSTANT`.
#[derive(Debug, PartialEq)]
pub(crate) struct Item {
    pub(crate) name: String,
    /// Lines from its documentation to its end, counted from 1.
    pub(crate) lines: std::ops::RangeInclusive<usize>,
}

/// The root of the workspace.
pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// All `.rs` files below a folder, in the order of their names.
///
/// # Errors
/// A folder that cannot be read.
pub(crate) fn files(folder: &Path) -> Result<Vec<PathBuf>, String> {
    let entries = std::fs::read_dir(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    let mut entries: Vec<_> = entries.filter_map(Result::ok).map(|entry| entry.path()).collect();
    entries.sort();
    let mut found = Vec::new();
    for path in entries {
        if path.is_dir() {
            found.extend(files(&path)?);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
    Ok(found)
}

/// # Errors
/// The file's name before what is wrong.
pub(crate) fn read(path: &Path) -> Result<String, String> {
    std::fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))
}

/// # Errors
/// The file's name before what is wrong.
pub(crate) fn parse(path: &Path, text: &str) -> Result<syn::File, String> {
    syn::parse_file(text).map_err(|e| format!("{}:{}: {e}", path.display(), e.span().start().line))
}

/// Whether an item is for tests alone.
pub(crate) fn is_test(attributes: &[syn::Attribute]) -> bool {
    attributes.iter().any(|a| {
        a.path().is_ident("test")
            || a.path().is_ident("cfg") && a.parse_args::<syn::Ident>().is_ok_and(|word| word == "test")
    })
}

/// Paths of two and more words among tokens, as they stand in the arguments of a macro.
pub(crate) fn paths_in(tokens: TokenStream, found: &mut Vec<Vec<String>>) {
    let mut path: Vec<String> = Vec::new();
    // Colons since the last word.
    let mut colons = 0;
    let mut end = |path: &mut Vec<String>| {
        let done = std::mem::take(path);
        if done.len() > 1 {
            found.push(done);
        }
    };
    let mut groups = Vec::new();
    for token in tokens {
        match token {
            TokenTree::Ident(word) => {
                if colons != 2 {
                    end(&mut path);
                }
                path.push(word.to_string());
                colons = 0;
            }
            TokenTree::Punct(p) if p.as_char() == ':' => colons += 1,
            other => {
                end(&mut path);
                colons = 0;
                if let TokenTree::Group(group) = other {
                    groups.push(group.stream());
                }
            }
        }
    }
    end(&mut path);
    groups.into_iter().for_each(|group| paths_in(group, found));
}

/// String literals among tokens, with their lines.
pub(crate) fn texts_in(tokens: TokenStream, found: &mut Vec<(usize, String)>) {
    for token in tokens {
        match token {
            TokenTree::Group(group) => texts_in(group.stream(), found),
            TokenTree::Literal(literal) => {
                if let syn::Lit::Str(text) = syn::Lit::new(literal) {
                    found.push((text.span().start().line, text.value()));
                }
            }
            _ => {}
        }
    }
}

/// The items of a file, without those for tests.
pub(crate) fn items(file: &syn::File) -> Vec<Item> {
    let mut found = Vec::new();
    collect(&file.items, &mut found);
    found
}

fn collect(items: &[syn::Item], found: &mut Vec<Item>) {
    let mut add = |name: String, all: &dyn Lines| found.push(Item { name, lines: all.lines() });
    for item in items {
        match item {
            syn::Item::Fn(f) if !is_test(&f.attrs) => add(f.sig.ident.to_string(), f),
            syn::Item::Struct(s) => add(s.ident.to_string(), s),
            syn::Item::Enum(e) => add(e.ident.to_string(), e),
            syn::Item::Const(c) => add(c.ident.to_string(), c),
            syn::Item::Static(s) => add(s.ident.to_string(), s),
            syn::Item::Trait(t) => {
                add(t.ident.to_string(), t);
                for member in &t.items {
                    if let syn::TraitItem::Fn(f) = member {
                        add(format!("{}::{}", t.ident, f.sig.ident), f);
                    }
                }
            }
            syn::Item::Impl(i) => {
                let Some(of) = type_name(&i.self_ty) else { continue };
                for member in &i.items {
                    match member {
                        syn::ImplItem::Fn(f) => add(format!("{of}::{}", f.sig.ident), f),
                        syn::ImplItem::Const(c) => add(format!("{of}::{}", c.ident), c),
                        _ => {}
                    }
                }
            }
            _ => {}
        }
    }
    for item in items {
        match item {
            syn::Item::Mod(m) if !is_test(&m.attrs) => collect(m.content.as_ref().map_or(&[][..], |c| &c.1), found),
            _ => {}
        }
    }
}

/// The lines of a piece of syntax.
trait Lines {
    fn lines(&self) -> std::ops::RangeInclusive<usize>;
}

impl<T: Spanned> Lines for T {
    fn lines(&self) -> std::ops::RangeInclusive<usize> {
        let span = self.span();
        span.start().line..=span.end().line
    }
}

fn type_name(of: &syn::Type) -> Option<String> {
    match of {
        syn::Type::Path(p) => p.path.segments.last().map(|s| s.ident.to_string()),
        syn::Type::Reference(r) => type_name(&r.elem),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_found_among_the_tokens_of_macros() {
        let mut found = Vec::new();
        paths_in("\"{}\", a::b, (crate::c::D { e: f }, g), x: y, ::std::z".parse().unwrap(), &mut found);
        let joined: Vec<_> = found.iter().map(|p| p.join("::")).collect();
        assert_eq!(joined, ["a::b", "std::z", "crate::c::D"]);
    }

    #[test]
    fn items_reach_from_their_documentation_to_their_end() {
        let text = "//! Header\n\n/// One.\n/// Two.\nfn a() {\n}\n\nstruct S<T>(T);\n\nimpl<T> S<T> {\n    /// M.\n    fn m() {\n    }\n}\n\n\
                    #[cfg(test)]\nmod tests {\n    fn b() {}\n}\n";
        let found = items(&syn::parse_file(text).unwrap());
        let told: Vec<_> = found.iter().map(|i| (i.name.as_str(), i.lines.clone())).collect();
        assert_eq!(told, [("a", 3..=6), ("S", 8..=8), ("S::m", 11..=13)]);
    }
}
