//! The crates as a picture: who stands on whom, and what each does not know. Made of `cargo metadata` and the table of
//! ARCHITECTURE.md, so it cannot say anything else than they do.

use crate::layers::{self, Edge};
use crate::source;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

const FILE: &str = "docs/images/layers.svg";
const WIDTH: f64 = 1200.0;
/// Between boxes of a row, and around the picture.
const GAP: f64 = 34.0;
/// Between rows, where the lines are.
const ROWS: f64 = 56.0;
const LINE: f64 = 16.0;
/// A character of the small text, on average.
const CHARACTER: f64 = 6.5;

/// A crate as it is drawn.
#[derive(Debug)]
struct Card {
    name: String,
    /// What it knows nothing about.
    unknown: String,
    /// Rows from the bottom.
    level: usize,
    below: BTreeSet<String>,
}

/// A card's box.
#[derive(Clone, Copy)]
struct Place {
    x: f64,
    y: f64,
    width: f64,
    height: f64,
}

/// Writes the picture.
///
/// # Errors
/// The file.
pub(crate) fn write() -> Result<(), String> {
    let path = source::root().join(FILE);
    std::fs::write(&path, current()?).map_err(|e| format!("{}: {e}", path.display()))?;
    println!("{FILE}: the crates and what they do not know");
    Ok(())
}

/// # Errors
/// The picture is not what it would be now.
pub(crate) fn check() -> Result<(), String> {
    let there = std::fs::read_to_string(source::root().join(FILE)).unwrap_or_default();
    match there == current()? {
        true => Ok(()),
        false => Err(format!("{FILE} is stale: run `cargo xtask layers --picture`")),
    }
}

fn current() -> Result<String, String> {
    let metadata = crate::metadata(&["--no-deps"])?;
    let map = source::read(&source::root().join("ARCHITECTURE.md"))?;
    Ok(draw(&cards(&layers::edges(&metadata), &map)))
}

/// The crates of the table in `map` that are not tools, each above all that it depends on, by name within a level.
fn cards(edges: &[Edge<'_>], map: &str) -> Vec<Card> {
    let rows = map.lines().filter_map(|line| {
        let cells: Vec<_> = line.strip_prefix('|')?.strip_suffix('|')?.split('|').map(str::trim).collect();
        let [name, _, unknown] = cells[..] else { return None };
        let name = name.strip_prefix('`')?.strip_suffix('`')?;
        (layers::is_ours(name) && name != "translume-fuzz").then(|| (name.to_owned(), unknown.replace('`', "")))
    });
    let table: BTreeMap<String, String> = rows.collect();
    let below = |name: &str| -> BTreeSet<String> {
        let own = edges.iter().filter(|e| e.from == name && e.ships && table.contains_key(e.to));
        own.map(|e| e.to.to_owned()).collect()
    };
    let all: BTreeMap<&str, BTreeSet<String>> = table.keys().map(|name| (name.as_str(), below(name))).collect();
    let mut levels: BTreeMap<&str, usize> = all.keys().map(|name| (*name, 0)).collect();
    // As often as there are crates is enough for the longest chain.
    for _ in 0..all.len() {
        for (name, below) in &all {
            let level = below.iter().map(|b| levels[b.as_str()] + 1).max().unwrap_or(0);
            levels.insert(name, level);
        }
    }
    let card = |(name, unknown): (&String, &String)| {
        let direct = &all[name.as_str()];
        // What another dependency has below it is not drawn again.
        let through = |b: &&String| !direct.iter().any(|other| other != *b && reaches(&all, other, b));
        let below = direct.iter().filter(through).cloned().collect();
        Card { name: name.clone(), unknown: unknown.clone(), level: levels[name.as_str()], below }
    };
    table.iter().map(card).collect()
}

fn reaches(all: &BTreeMap<&str, BTreeSet<String>>, from: &str, to: &str) -> bool {
    all[from].iter().any(|next| next == to || reaches(all, next, to))
}

fn draw(cards: &[Card]) -> String {
    let (places, height) = layout(cards);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height:.0}\" font-family=\"sans-serif\">\n\
         <title>The crates of translume: each stands on those that its lines lead down to, and knows nothing about what its box says</title>\n\
         <rect width=\"{WIDTH}\" height=\"{height:.0}\" fill=\"#ffffff\"/>\n"
    );
    for line in lines(cards, &places) {
        let _ = writeln!(svg, "<path d=\"{line}\" fill=\"none\" stroke=\"#8a98a8\" stroke-width=\"1.5\"/>");
    }
    for card in cards {
        let p = places[card.name.as_str()];
        let _ = writeln!(
            svg,
            "<rect x=\"{:.0}\" y=\"{:.0}\" width=\"{:.0}\" height=\"{:.0}\" rx=\"6\" fill=\"#eef3f8\" stroke=\"#48607a\"/>",
            p.x, p.y, p.width, p.height
        );
        let _ = writeln!(
            svg,
            "<text x=\"{:.0}\" y=\"{:.0}\" font-size=\"15\" font-weight=\"bold\" fill=\"#1c2b3a\">{}</text>",
            p.x + 10.0,
            p.y + 21.0,
            card.name
        );
        for (i, line) in text_of(card, p.width).iter().enumerate() {
            let y = p.y + 40.0 + LINE * i as f64;
            let _ = writeln!(
                svg,
                "<text x=\"{:.0}\" y=\"{y:.0}\" font-size=\"12\" fill=\"#51606f\">{}</text>",
                p.x + 10.0,
                escape(line)
            );
        }
    }
    svg += "</svg>\n";
    svg
}

/// The lines between the boxes: beside the boxes of the rows that they pass, each in a lane of its own.
fn lines(cards: &[Card], places: &BTreeMap<&str, Place>) -> Vec<String> {
    // From left to right, so that lines of one box do not cross.
    let sorted = |mut some: Vec<&Card>| -> Vec<String> {
        some.sort_by(|a, b| places[a.name.as_str()].x.total_cmp(&places[b.name.as_str()].x));
        some.into_iter().map(|c| c.name.clone()).collect()
    };
    // The place of the i-th of the lines that meet a box.
    let port = |p: &Place, all: &[String], name: &str| {
        let i = all.iter().position(|n| n == name).unwrap_or(0);
        p.x + p.width * (i + 1) as f64 / (all.len() + 1) as f64
    };
    let mut taken = BTreeMap::new();
    let mut lines = Vec::new();
    for card in cards {
        let from = places[card.name.as_str()];
        let below = sorted(cards.iter().filter(|c| card.below.contains(&c.name)).collect());
        for end in cards.iter().filter(|c| card.below.contains(&c.name)) {
            let to = places[end.name.as_str()];
            let above = sorted(cards.iter().filter(|c| c.below.contains(&end.name)).collect());
            let goal = port(&to, &above, &card.name);
            let mut points = vec![(port(&from, &below, &end.name), from.y + from.height)];
            for level in (end.level + 1..card.level).rev() {
                let at = points[points.len() - 1].0;
                let row: Vec<_> = cards.iter().filter(|c| c.level == level).map(|c| places[c.name.as_str()]).collect();
                // The rows that are left share the way.
                let x = lane(&row, at + (goal - at) / (level - end.level + 1) as f64, &mut taken);
                points.extend([(x, row[0].y), (x, row[0].y + row[0].height)]);
            }
            points.push((goal, to.y));
            lines.push(curve(&points));
        }
    }
    lines
}

/// Where a line passes a row: in the gap that is nearest to where it wants to, beside those that are there (`taken`).
fn lane(row: &[Place], wish: f64, taken: &mut BTreeMap<(i64, i64), u32>) -> f64 {
    let gaps = std::iter::once(row[0].x - 0.5 * GAP).chain(row.iter().map(|p| p.x + p.width + 0.5 * GAP));
    let gap = gaps.min_by(|a, b| (a - wish).abs().total_cmp(&(b - wish).abs())).unwrap_or(wish);
    let used = taken.entry((row[0].y as i64, gap as i64)).or_default();
    let side = if *used % 2 == 1 { 6.0 } else { -6.0 };
    let lane = gap + side * f64::from(used.div_ceil(2));
    *used += 1;
    lane
}

/// A smooth path that is upright at its points.
fn curve(points: &[(f64, f64)]) -> String {
    let mut path = format!("M{:.0} {:.0}", points[0].0, points[0].1);
    for pair in points.windows(2) {
        let [(x0, y0), (x1, y1)] = [pair[0], pair[1]];
        let middle = 0.5 * (y0 + y1);
        let _ = write!(path, " C{x0:.0} {middle:.0} {x1:.0} {middle:.0} {x1:.0} {y1:.0}");
    }
    path
}

/// Boxes by crate, foundations at the bottom, and the height of all.
fn layout(cards: &[Card]) -> (BTreeMap<&str, Place>, f64) {
    let mut places = BTreeMap::new();
    let mut y = GAP;
    let top = cards.iter().map(|c| c.level).max().unwrap_or(0);
    for level in (0..=top).rev() {
        let row: Vec<_> = cards.iter().filter(|c| c.level == level).collect();
        let width = ((WIDTH - GAP) / row.len() as f64 - GAP).min(330.0);
        let all = row.len() as f64 * (width + GAP) - GAP;
        let lines = row.iter().map(|c| text_of(c, width).len()).max().unwrap_or(0);
        let height = 36.0 + LINE * lines as f64;
        for (i, card) in row.iter().enumerate() {
            let x = 0.5 * (WIDTH - all) + i as f64 * (width + GAP);
            places.insert(card.name.as_str(), Place { x, y, width, height });
        }
        y += height + ROWS;
    }
    (places, y - ROWS + GAP)
}

/// What a card does not know, in lines that its box holds.
fn text_of(card: &Card, width: f64) -> Vec<String> {
    let most = ((width - 20.0) / CHARACTER) as usize;
    let mut lines = vec![String::new()];
    for word in format!("knows nothing about {}", card.unknown).split_whitespace() {
        let last = lines.last_mut().expect("there is one");
        if !last.is_empty() && last.chars().count() + 1 + word.chars().count() > most {
            lines.push(word.to_owned());
        } else {
            if !last.is_empty() {
                last.push(' ');
            }
            last.push_str(word);
        }
    }
    lines
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    const MAP: &str = "\
| crate | holds | knows nothing about |
|---|---|---|
| `translume-core` | numbers | files, `geometry` |
| `translume-image` | images | where they come from & go |
| `translume` | the program | any algorithm |
| `translume-fuzz` | fuzzers | options |
| `xtask` | chores | the crates |
";

    fn edge<'a>(from: &'a str, to: &'a str, ships: bool) -> Edge<'a> {
        Edge { from, to, ships }
    }

    fn three() -> Vec<Card> {
        let edges = [
            edge("translume-image", "translume-core", true),
            edge("translume", "translume-image", true),
            edge("translume", "translume-core", true),
            edge("translume-core", "translume-image", false),
        ];
        cards(&edges, MAP)
    }

    #[test]
    fn a_crate_stands_above_what_it_uses_and_shows_the_direct_lines_alone() {
        let cards = three();
        let told: Vec<_> = cards
            .iter()
            .map(|c| (c.name.as_str(), c.level, c.below.iter().cloned().collect::<Vec<_>>().join(" ")))
            .collect();
        assert_eq!(
            told,
            [
                ("translume", 2, "translume-image".to_owned()),
                ("translume-core", 0, String::new()),
                ("translume-image", 1, "translume-core".into()),
            ]
        );
        assert_eq!(cards[1].unknown, "files, geometry");
    }

    #[test]
    fn the_picture_names_each_crate_once_and_is_well_formed() {
        let cards = three();
        let svg = draw(&cards);
        assert_eq!(svg.matches(">translume-core<").count(), 1);
        assert_eq!(svg.matches("<path").count(), 2);
        assert!(svg.contains("&amp; go") && svg.ends_with("</svg>\n"));
        let (places, height) = layout(&cards);
        assert!(places["translume"].y < places["translume-image"].y);
        let lowest = places["translume-core"];
        assert!((lowest.y + lowest.height + GAP - height).abs() < 1e-9);
    }

    #[test]
    fn lines_fit_their_box() {
        let card = Card { name: "a".into(), unknown: "word ".repeat(40), level: 0, below: BTreeSet::new() };
        let lines = text_of(&card, 200.0);
        assert!(lines.len() > 3 && lines.iter().all(|l| l.chars().count() <= 27), "{lines:?}");
    }
}
