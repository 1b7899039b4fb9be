//! What holds inside the crates: no circles of modules but parents with their children, and no names of command-line options in
//! libraries. What is not so yet is listed in [`crate::allowed`] and may only shrink.

use crate::allowed::{CIRCLES, OPTIONS};
use crate::modules::Modules;
use crate::source;
use std::collections::BTreeSet;
use std::path::Path;
use syn::visit::Visit;

/// The program, which may name its options.
const PROGRAM: &str = "translume";
/// Cargo's options, which a library may name: they say how to build it.
const CARGO: [&str; 1] = ["--features"];

/// Checks all crates in `crates/`.
///
/// # Errors
/// Circles and options that are not on the lists, and entries of the lists that are mended, one a line.
pub(crate) fn check() -> Result<(), String> {
    let mut wrong = Vec::new();
    let (mut modules, mut circles, mut options) = (0, BTreeSet::new(), BTreeSet::new());
    for (name, folder) in crates()? {
        let root = ["lib.rs", "main.rs"].map(|f| folder.join("src").join(f)).into_iter().find(|f| f.exists());
        let root = root.ok_or_else(|| format!("{}: no lib.rs and no main.rs", folder.display()))?;
        let read = Modules::read(&root)?;
        modules += read.len();
        for circle in read.circles() {
            match CIRCLES.iter().position(|(of, known)| *of == name && is_within(&circle, known)) {
                Some(known) => drop(circles.insert(known)),
                None => wrong.push(format!(
                    "{name}: {} modules name each other in a circle:\n{}",
                    circle.len(),
                    read.within(&circle)
                )),
            }
        }
        if name == PROGRAM {
            continue;
        }
        for path in source::files(&folder.join("src"))? {
            let file = path.strip_prefix(source::root().join("crates")).map_err(|e| e.to_string())?;
            let file = file.to_string_lossy().replace('\\', "/");
            for (line, option) in options_in(&source::parse(&path, &source::read(&path)?)?) {
                match OPTIONS.iter().position(|known| *known == (file.as_str(), option.as_str())) {
                    Some(known) => drop(options.insert(known)),
                    None => wrong.push(format!(
                        "crates/{file}:{line}: a library names the option {option}: say what is wrong, the program adds the option"
                    )),
                }
            }
        }
    }
    let mended = (0..CIRCLES.len()).filter(|i| !circles.contains(i)).map(|i| format!("the circle of {}", CIRCLES[i].0));
    let gone = (0..OPTIONS.len()).filter(|i| !options.contains(i));
    let gone = gone.map(|i| format!("{} in {}", OPTIONS[i].1, OPTIONS[i].0));
    wrong
        .extend(mended.chain(gone).map(|what| format!("xtask/src/allowed.rs: {what} is mended: take it off the list")));
    if wrong.is_empty() {
        println!(
            "layers: {modules} modules; {} circles and {} options in libraries are still allowed",
            CIRCLES.len(),
            OPTIONS.len()
        );
        Ok(())
    } else {
        Err(format!("inside the crates:\n  {}", wrong.join("\n  ")))
    }
}

/// Names and folders of the crates in `crates/`.
fn crates() -> Result<Vec<(String, std::path::PathBuf)>, String> {
    let folder = source::root().join("crates");
    let entries = std::fs::read_dir(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    let mut paths: Vec<_> = entries.filter_map(Result::ok).map(|entry| entry.path()).collect();
    paths.retain(|p| p.join("Cargo.toml").exists());
    paths.sort();
    let name = |p: &Path| p.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(paths.into_iter().map(|p| (name(&p), p)).collect())
}

/// Whether a circle is a known one, or what is left of it.
fn is_within(circle: &[String], known: &[&str]) -> bool {
    circle.iter().all(|module| known.contains(&module.as_str()))
}

/// The command-line options that string literals outside of tests name, with their lines.
fn options_in(file: &syn::File) -> Vec<(usize, String)> {
    let mut texts = Texts::default();
    texts.visit_file(file);
    texts.0.iter().flat_map(|(line, text)| options(text).map(move |o| (*line, o))).collect()
}

/// `--word` and `--word-word` in a text, not what only has hyphens.
fn options(text: &str) -> impl Iterator<Item = String> + '_ {
    text.match_indices("--")
        .filter_map(move |(at, _)| {
            let begins = !text[..at].ends_with(|c: char| c.is_alphanumeric() || c == '-');
            let word: String = text[at + 2..].chars().take_while(|c| c.is_ascii_lowercase() || *c == '-').collect();
            let word = word.trim_end_matches('-');
            (begins && word.starts_with(|c: char| c.is_ascii_lowercase())).then(|| format!("--{word}"))
        })
        .filter(|option| !CARGO.contains(&option.as_str()))
}

/// String literals with their lines.
#[derive(Default)]
struct Texts(Vec<(usize, String)>);

impl<'a> Visit<'a> for Texts {
    fn visit_item_mod(&mut self, item: &'a syn::ItemMod) {
        if !source::is_test(&item.attrs) {
            syn::visit::visit_item_mod(self, item);
        }
    }

    fn visit_item_fn(&mut self, item: &'a syn::ItemFn) {
        if !source::is_test(&item.attrs) {
            syn::visit::visit_item_fn(self, item);
        }
    }

    // Documentation is an attribute.
    fn visit_attribute(&mut self, _: &'a syn::Attribute) {}

    fn visit_lit_str(&mut self, text: &'a syn::LitStr) {
        self.0.push((text.span().start().line, text.value()));
    }

    fn visit_macro(&mut self, call: &'a syn::Macro) {
        source::texts_in(call.tokens.clone(), &mut self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_words_after_two_hyphens() {
        let found = |text: &str| options(text).collect::<Vec<_>>();
        assert_eq!(found("use --ev or (--exposure-list FILE)"), ["--ev", "--exposure-list"]);
        assert_eq!(found("build with --features raw"), [""; 0]);
        assert_eq!(found("a -- b, <!-- c -->, x--y, ---, --1"), [""; 0]);
    }

    #[test]
    fn options_in_tests_and_comments_do_not_count() {
        let text = "/// --doc\nfn a() -> String {\n    // --comment\n    format!(\"{} or --real\", f(\"--too\"))\n}\nconst B: &str = \"--three\";\n\
                    #[cfg(test)]\nmod tests {\n    const C: &str = \"--test\";\n}\n";
        let mut found = options_in(&syn::parse_file(text).unwrap());
        found.sort();
        assert_eq!(found, [(4, "--real".to_owned()), (4, "--too".into()), (6, "--three".into())]);
    }

    #[test]
    fn a_circle_may_shrink_and_not_grow() {
        let circle = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
        assert!(is_within(&circle(&["a", "b"]), &["a", "b", "c"]));
        assert!(!is_within(&circle(&["a", "d"]), &["a", "b", "c"]));
    }
}
