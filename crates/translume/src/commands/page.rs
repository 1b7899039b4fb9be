//! Pages of HTML for people to look at: chapters with pictures and figures, no script, nothing from elsewhere.

use std::fmt::Write as _;
use std::path::Path;
use translume_image::atomic;

/// One part of a page.
pub(crate) struct Chapter {
    /// Heading.
    pub(crate) title: String,
    /// What was done, as HTML.
    pub(crate) html: String,
    /// Rows of pictures.
    pub(crate) pictures: Vec<Vec<Figure>>,
    /// What was measured.
    pub(crate) figures: Table,
}

/// A picture file and what it shows, as text.
pub(crate) struct Figure {
    /// Path relative to the page, with `/`.
    pub(crate) file: String,
    pub(crate) caption: String,
}

/// A table: names of the columns, then the rows.
#[derive(Default)]
pub(crate) struct Table {
    pub(crate) columns: Vec<String>,
    pub(crate) rows: Vec<Vec<String>>,
}

/// Writes a page of `chapters` after an `introduction` (HTML).
pub(crate) fn write(path: &Path, title: &str, introduction: &str, chapters: &[Chapter]) -> anyhow::Result<()> {
    let body: String = chapters.iter().map(Chapter::html).collect();
    let html = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width\">\n<title>{title}</title>\n<style>{STYLE}</style>\n</head>\n\
         <body>\n<h1>{title}</h1>\n{introduction}\n{body}</body>\n</html>\n",
        title = escape(title)
    );
    Ok(atomic::write_bytes(path, html.as_bytes())?)
}

impl Chapter {
    fn html(&self) -> String {
        let mut out = format!("<section>\n<h2>{}</h2>\n{}\n", escape(&self.title), self.html);
        for row in &self.pictures {
            out.push_str("<div class=\"row\">\n");
            for figure in row {
                let (file, caption) = (escape(&figure.file), escape(&figure.caption));
                let _ = writeln!(
                    out,
                    "<figure><a href=\"{file}\"><img src=\"{file}\" alt=\"{caption}\"></a><figcaption>{caption}</figcaption></figure>"
                );
            }
            out.push_str("</div>\n");
        }
        out + &self.figures.html() + "</section>\n"
    }
}

impl Table {
    fn html(&self) -> String {
        if self.rows.is_empty() {
            return String::new();
        }
        let cells = |row: &[String], tag: &str| -> String {
            row.iter().map(|cell| format!("<{tag}>{}</{tag}>", escape(cell))).collect()
        };
        let head = cells(&self.columns, "th");
        let rows: String = self.rows.iter().map(|row| format!("<tr>{}</tr>\n", cells(row, "td"))).collect();
        format!("<table>\n<tr>{head}</tr>\n{rows}</table>\n")
    }
}

const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;margin:2rem auto;padding:0 1rem;max-width:1180px;color:#222;background:#fafafa}\
    h1{font-size:1.7rem}h2{font-size:1.3rem;margin-top:2.5rem;border-top:1px solid #ddd;padding-top:1.2rem}p{max-width:48rem}\
    .row{display:flex;gap:.8rem;margin:1rem 0}figure{margin:0;flex:1;min-width:0}img{width:100%;display:block;background:#ddd}\
    figcaption{font-size:.85rem;color:#555;padding-top:.3rem}table{border-collapse:collapse;margin:1.2rem 0}\
    td,th{padding:.3rem 1.2rem .3rem 0;text-align:left;border-bottom:1px solid #ddd}td:not(:first-child),th:not(:first-child)\
    {text-align:right;font-variant-numeric:tabular-nums}pre{background:#eee;padding:.8rem;overflow-x:auto;font-size:.85rem}.warn{color:#a40}\
    @media(max-width:640px){.row{flex-direction:column}}";

/// Text as HTML.
pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_cannot_become_markup() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("p.html");
        let figure = Figure { file: "a&b.png".into(), caption: "<b>".into() };
        let figures = Table { columns: vec!["\"x\"".into()], rows: vec![vec!["<td>".into()]] };
        let chapter =
            Chapter { title: "1 < 2".into(), html: "<p>as it is</p>".into(), pictures: vec![vec![figure]], figures };
        write(&path, "a & b", "", &[chapter]).unwrap();
        let page = std::fs::read_to_string(path).unwrap();
        for part in ["<h1>a &amp; b</h1>", "1 &lt; 2", "<p>as it is</p>", "a&amp;b.png", "&lt;b&gt;", "&lt;td&gt;"] {
            assert!(page.contains(part), "{part}: {page}");
        }
    }
}
