//! `docs/papers.md` and the tags in the code, held against each other.
//!
//! A tag is `[Fuchs 2005, Eq. 1]`, `[Goesele 2004, §6.2 colour]` or the like in a comment: the paper, then an equation, figure or
//! table by its number, or a section, in which a word may name an unnumbered formula. Every row of the tables must find its tag
//! in the file and within the item that it names, and every tag must have a row with its file.

use crate::source::{self, Item};
use std::collections::BTreeSet;

/// The papers, as tags have them.
const PAPERS: [&str; 4] = ["Bekaert 2003", "Goesele 2004", "Fuchs 2005", "Menzel 2012"];
const PAGE: &str = "docs/papers.md";

/// A row of a table: where an equation is.
#[derive(Debug, PartialEq)]
struct Row {
    line: usize,
    /// As it stands between the brackets.
    tag: String,
    /// Below `crates/`.
    file: String,
    /// `None`: anywhere in the file.
    item: Option<String>,
}

/// What a file says: its items and its tags with their lines.
struct File {
    name: String,
    items: Vec<Item>,
    tags: Vec<(usize, String)>,
}

/// Checks both directions.
///
/// # Errors
/// Every row and every tag that finds nothing, one a line.
pub(crate) fn check() -> Result<(), String> {
    let root = source::root();
    let mut wrong = Vec::new();
    let rows = rows(&source::read(&root.join(PAGE))?, &mut wrong);
    let mut files = Vec::new();
    let crates = root.join("crates");
    for path in source::files(&crates)? {
        let name = path.strip_prefix(&crates).map_err(|e| e.to_string())?.to_string_lossy().replace('\\', "/");
        let text = source::read(&path)?;
        let tags = tags(&name, &text, &mut wrong);
        let items = if tags.is_empty() { Vec::new() } else { source::items(&source::parse(&path, &text)?) };
        files.push(File { name, items, tags });
    }
    wrong.extend(compare(&rows, &files));
    if wrong.is_empty() {
        let distinct: BTreeSet<_> = rows.iter().map(|r| &r.tag).collect();
        println!("equations: {} in {} places, each with its row in {PAGE}", distinct.len(), rows.len());
        Ok(())
    } else {
        Err(format!("{PAGE} and the code differ:\n  {}", wrong.join("\n  ")))
    }
}

/// The rows of all tables with five columns: paper, equation, meaning, place, deviation.
fn rows(page: &str, wrong: &mut Vec<String>) -> Vec<Row> {
    let mut rows = Vec::new();
    for (i, line) in page.lines().enumerate() {
        let Some(cells) = line.strip_prefix('|').and_then(|l| l.strip_suffix('|')) else { continue };
        let cells: Vec<_> = cells.split('|').map(str::trim).collect();
        let [paper, equation, _, place, _] = cells[..] else { continue };
        if paper == "paper" || paper.starts_with("---") {
            continue;
        }
        let tag = format!("{paper}, {equation}");
        let place = place.trim_matches('`');
        if !is_tag(&tag) {
            wrong.push(format!("{PAGE}:{}: '{tag}' is no tag", i + 1));
            continue;
        }
        let (file, item) = match place.split_once("::") {
            Some((file, item)) => (file, Some(item.to_owned())),
            None => (place, None),
        };
        rows.push(Row { line: i + 1, tag, file: file.to_owned(), item });
    }
    rows
}

/// Whether what stands between brackets is a tag in the one spelling.
fn is_tag(text: &str) -> bool {
    let Some((paper, place)) = text.split_once(", ") else { return false };
    let digits = |s: &str| !s.is_empty() && s.bytes().all(|b| b.is_ascii_digit());
    let number = |s: &str| s.split('.').all(digits);
    let right = match place.strip_prefix('§') {
        Some(section) => {
            let (section, name) = section.split_once(' ').unwrap_or((section, "x"));
            number(section) && !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || " ()-".contains(c))
        }
        None => {
            let numbered = ["Eq. ", "Fig. ", "Table "].iter().find_map(|kind| place.strip_prefix(kind));
            numbered.is_some_and(number)
        }
    };
    PAPERS.contains(&paper) && right
}

/// The tags in the comments of a file; what begins with a paper's author and is no tag is `wrong`.
fn tags(name: &str, text: &str, wrong: &mut Vec<String>) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let Some((_, comment)) = line.split_once("//") else { continue };
        for piece in comment.split('[').skip(1) {
            let author = |paper: &&str| paper.split(' ').next().is_some_and(|author| piece.starts_with(author));
            if !PAPERS.iter().any(author) {
                continue;
            }
            match piece.split_once(']') {
                Some((tag, _)) if is_tag(tag) => found.push((i + 1, tag.to_owned())),
                _ => wrong.push(format!(
                    "crates/{name}:{}: '[{}' is not spelt like [{}, Eq. 1] or [{}, §2.3 word]",
                    i + 1,
                    piece.split(']').next().unwrap_or(piece),
                    PAPERS[0],
                    PAPERS[0]
                )),
            }
        }
    }
    found
}

/// Complaints about rows without their tag and tags without a row.
fn compare(rows: &[Row], files: &[File]) -> Vec<String> {
    let mut wrong = Vec::new();
    for row in rows {
        let place = |what: &str| format!("{PAGE}:{}: [{}]: {what}", row.line, row.tag);
        let Some(file) = files.iter().find(|f| f.name == row.file) else {
            wrong.push(place(&format!("no file crates/{}", row.file)));
            continue;
        };
        let mut lines = file.tags.iter().filter(|t| t.1 == row.tag).map(|t| t.0);
        let Some(item) = &row.item else {
            if lines.next().is_none() {
                wrong.push(place(&format!("not in crates/{}", row.file)));
            }
            continue;
        };
        let mut items = file.items.iter().filter(|i| i.name == *item).peekable();
        if items.peek().is_none() {
            // Files without any tag are not taken apart.
            wrong.push(place(&format!("no {item} with tags in crates/{}", row.file)));
        } else if !items.any(|i| file.tags.iter().any(|t| t.1 == row.tag && i.lines.contains(&t.0))) {
            wrong.push(place(&format!("not within {item} of crates/{}", row.file)));
        }
    }
    for file in files {
        for (line, tag) in &file.tags {
            if !rows.iter().any(|r| r.file == file.name && r.tag == *tag) {
                wrong.push(format!("crates/{}:{line}: [{tag}] has no row in {PAGE}", file.name));
            }
        }
    }
    wrong
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_spelling() {
        for right in [
            "Fuchs 2005, Eq. 1",
            "Menzel 2012, §5.1",
            "Menzel 2012, Eq. 3.4",
            "Goesele 2004, §7.1 m(d)",
            "Bekaert 2003, Fig. 1",
        ] {
            assert!(is_tag(right), "{right}");
        }
        for wrong in [
            "Fuchs 2005, eq. 1",
            "Fuchs 2005 Eq. 1",
            "Fuchs et al. 2005, Eq. 1",
            "Fuchs 2005, Eq. 1, 4",
            "Fuchs 2005, Eq. 1 and 2",
            "Fuchs 2005, Eq. ",
            "Menzel 2012, ch. 5",
            "Menzel 2012, §",
            "Menzel 2012, §5. ",
            "Menzel 2012, § 5",
            "Burley 2015, Eq. 6",
        ] {
            assert!(!is_tag(wrong), "{wrong}");
        }
    }

    #[test]
    fn tags_are_those_in_comments() {
        let text = "/// A [Fuchs 2005, Eq. 1] and [Fuchs 2005, Eq. 2].\nlet s = \"[Fuchs 2005, Eq. 3]\";\nx[0] // [Burley 2015, Eq. 6]\n\
                    // [Fuchs 2005, Eq. 4, corrected]\n// Menzel [Menzel ch. 5\n";
        let mut wrong = Vec::new();
        let found = tags("a.rs", text, &mut wrong);
        assert_eq!(found, [(1, "Fuchs 2005, Eq. 1".to_owned()), (1, "Fuchs 2005, Eq. 2".to_owned())]);
        assert_eq!(wrong.len(), 2, "{wrong:?}");
        assert!(wrong[0].starts_with("crates/a.rs:4: '[Fuchs 2005, Eq. 4, corrected'"), "{wrong:?}");
    }

    const PAGE_TEXT: &str = "\
| a | table | of | four |
|---|---|---|---|
| paper | equation | meaning | place | deviation |
|---|---|---|---|---|
| Fuchs 2005 | Eq. 1 | sum | `c/src/a.rs::S::m` | none |
| Fuchs 2005 | §4 | all | `c/src/a.rs` | |
";

    #[test]
    fn rows_are_read_off_the_tables() {
        let mut wrong = Vec::new();
        let read = rows(PAGE_TEXT, &mut wrong);
        assert!(wrong.is_empty());
        let file = || "c/src/a.rs".to_owned();
        assert_eq!(
            read,
            [
                Row { line: 5, tag: "Fuchs 2005, Eq. 1".into(), file: file(), item: Some("S::m".into()) },
                Row { line: 6, tag: "Fuchs 2005, §4".into(), file: file(), item: None },
            ]
        );
        rows("| Fuchs 2005 | Equation 1 | sum | `a.rs` | |\n", &mut wrong);
        assert_eq!(wrong.len(), 1);
    }

    fn file(text: &str) -> File {
        let items = source::items(&syn::parse_file(text).unwrap());
        File { name: "c/src/a.rs".into(), items, tags: tags("", text, &mut Vec::new()) }
    }

    #[test]
    fn both_directions_are_checked() {
        let complaints = |text: &str| compare(&rows(PAGE_TEXT, &mut Vec::new()), &[file(text)]);
        let right = "//! [Fuchs 2005, §4]\nstruct S;\nimpl S {\n    fn m() {\n        1 // [Fuchs 2005, Eq. 1]\n    }\n    fn n() {}\n}\n";
        assert_eq!(complaints(right), Vec::<String>::new());
        // The tag has moved out of its function.
        let moved =
            "//! [Fuchs 2005, §4]\nstruct S;\nimpl S {\n    fn m() {}\n    /// [Fuchs 2005, Eq. 1]\n    fn n() {}\n}\n";
        assert_eq!(complaints(moved), ["docs/papers.md:5: [Fuchs 2005, Eq. 1]: not within S::m of crates/c/src/a.rs"]);
        let renamed = right.replace("fn m", "fn k");
        assert_eq!(
            complaints(&renamed),
            ["docs/papers.md:5: [Fuchs 2005, Eq. 1]: no S::m with tags in crates/c/src/a.rs"]
        );
        let without = right.replace("//! [Fuchs 2005, §4]", "//!");
        assert_eq!(complaints(&without), ["docs/papers.md:6: [Fuchs 2005, §4]: not in crates/c/src/a.rs"]);
        let more = right.replace("fn n() {}", "fn n() {} // [Fuchs 2005, Eq. 2]");
        assert_eq!(complaints(&more), ["crates/c/src/a.rs:7: [Fuchs 2005, Eq. 2] has no row in docs/papers.md"]);
        let none = compare(&rows(PAGE_TEXT, &mut Vec::new()), &[]);
        assert!(none.iter().all(|c| c.ends_with("no file crates/c/src/a.rs")) && none.len() == 2, "{none:?}");
    }
}
