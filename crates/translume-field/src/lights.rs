//! Which picture was lit from where: RTI `.lp` files, tables of directions, `lights.csv`.
//!
//! Directions point from the object to the light: x right, y up, z to the camera. They are normalised here.

use crate::listed::{Found, Pictures, ending, is_picture, relative};
use crate::{Error, Result};
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use translume_image::text;

/// A picture and the unit direction to its light.
#[derive(Clone, Debug, PartialEq)]
pub struct Shot {
    /// The picture file.
    pub path: PathBuf,
    /// Unit vector to the light.
    pub light: [f32; 3],
    /// Unit vector to the camera, where pictures differ in that: a BTF or a surface light field, its pictures rectified to the texels of
    /// the surface.
    pub view: Option<[f32; 3]>,
    /// How strong the light was, where lights differ: the picture is divided by it.
    pub strength: f32,
}

impl Shot {
    /// A picture under a light of strength 1, of a stack with one view.
    pub fn new(path: PathBuf, light: [f32; 3]) -> Self {
        Self { path, light, view: None, strength: 1.0 }
    }
}

/// The shots of the stack in `folder`, and how many pictures there have no light. The list is `list`, or the only `.lp` file of the folder, or
/// its `lights.csv`, `lights.txt` or `light_directions.txt`.
///
/// # Errors
/// [`Error::Invalid`] when there is no list or it does not fit the pictures; [`Error::Io`].
pub fn find(folder: &Path, list: Option<&Path>) -> Result<(Vec<Shot>, usize)> {
    let entries = entries(folder)?;
    let list = match list {
        Some(list) => list.to_owned(),
        None => find_list(folder, &entries)?,
    };
    let text = read_text(&list)?;
    let ending = ending(&list);
    let shots = match ending.as_str() {
        "lp" => parse_named(&text, &list, folder, true)?,
        "csv" => parse_named(&text, &list, folder, false)?,
        _ => {
            let lights = parse_table(&text, &list)?;
            let pictures = numbered_pictures(&entries);
            if pictures.len() != lights.len() {
                let what = format!(
                    "{} directions for {} pictures in {}: give every picture one, or name them in an .lp file",
                    lights.len(),
                    pictures.len(),
                    folder.display()
                );
                return Err(Error::invalid(&list, what));
            }
            pictures.into_iter().zip(lights).map(|(path, light)| Shot::new(path, light)).collect()
        }
    };
    check(&shots, &list);
    let file = |p: &Path| p.canonicalize().unwrap_or_else(|_| p.to_owned());
    let lit: HashSet<PathBuf> = shots.iter().map(|s| file(&s.path)).collect();
    let unlit = numbered_pictures(&entries).iter().filter(|p| !lit.contains(&file(p))).count();
    Ok((shots, unlit))
}

/// The pictures of a folder in the order of the numbers in their names; masks left out.
///
/// # Errors
/// [`Error::Io`].
pub fn pictures(folder: &Path) -> Result<Vec<PathBuf>> {
    Ok(numbered_pictures(&entries(folder)?))
}

/// The text of an `.lp` file of `shots` in `folder`; names are relative to it.
pub fn to_lp(shots: &[Shot], folder: &Path) -> String {
    let line = |s: &Shot| format!("{} {} {} {}\n", name_in(folder, s), s.light[0], s.light[1], s.light[2]);
    format!("{}\n", shots.len()) + &shots.iter().map(line).collect::<String>()
}

/// The text of a `lights.csv` of `shots`, with strengths, names as in [`to_lp`].
pub fn to_csv(shots: &[Shot], folder: &Path) -> String {
    let line = |s: &Shot| {
        let [x, y, z] = s.light;
        format!("{},{x},{y},{z},{}\n", name_in(folder, s), s.strength)
    };
    String::from("file,x,y,z,strength\n") + &shots.iter().map(line).collect::<String>()
}

fn name_in(folder: &Path, shot: &Shot) -> String {
    let name = relative(&shot.path, folder);
    if std::path::MAIN_SEPARATOR == '\\' {
        name.to_string_lossy().replace('\\', "/")
    } else {
        name.to_string_lossy().into_owned()
    }
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut all = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))? {
        all.push(entry.map_err(|e| Error::io(folder, e))?.path());
    }
    all.sort();
    Ok(all)
}

fn find_list(folder: &Path, entries: &[PathBuf]) -> Result<PathBuf> {
    let lp: Vec<_> = entries.iter().filter(|p| ending(p) == "lp").collect();
    match lp[..] {
        [one] => return Ok(one.clone()),
        [] => {}
        _ => {
            let what = format!("{} .lp files: say which with --lights", lp.len());
            return Err(Error::invalid(folder, what));
        }
    }
    let names = ["lights.csv", "lights.txt", "light_directions.txt"];
    names.iter().map(|n| folder.join(n)).find(|p| p.is_file()).ok_or_else(|| {
        Error::invalid(
            folder,
            "no light directions: put an .lp file, lights.csv or lights.txt there, give one with --lights, or estimate them from a \
             ball in the pictures with `translume field lights`",
        )
    })
}

/// The text of a plain file.
fn read_text(path: &Path) -> Result<String> {
    let kind = std::fs::metadata(path).map_err(|e| Error::io(path, e))?;
    if !kind.is_file() {
        return Err(Error::invalid(path, "not a plain file"));
    }
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    Ok(text::decode(&bytes))
}

/// What stands between the fields of a list: the first of these that its first line holds.
fn separator(line: &str) -> Option<char> {
    [';', '\t', ','].into_iter().find(|c| line.contains(*c))
}

/// A name and the `wanted` numbers after it. Between them is `separator` or white space; decimal marks are points or
/// commas. Names may hold spaces.
fn named_numbers(line: &str, wanted: usize, separator: Option<char>) -> Option<(String, Vec<f32>)> {
    let of = |fields: Vec<&str>, between: &str| {
        let at = fields.len().checked_sub(wanted).filter(|n| *n > 0)?;
        let numbers: Option<Vec<f32>> = fields[at..].iter().map(|w| text::number(w)).collect();
        Some((fields[..at].join(between), numbers?))
    };
    let trimmed = line.trim().trim_end_matches([';', ',']).trim_end();
    let split = |c: char| trimmed.split(c).map(str::trim).collect::<Vec<_>>();
    let listed = || {
        // What is left of the line when the numbers are taken off its end, spaces in it as they are.
        let words: Vec<&str> = trimmed.split_whitespace().collect();
        let bare: Vec<&str> = words.iter().map(|w| w.trim_end_matches([';', ','])).collect();
        let (_, numbers) = of(bare, " ")?;
        let mut name = trimmed;
        for word in words[words.len() - wanted..].iter().rev() {
            name = name.strip_suffix(word).unwrap_or(name).trim_end();
        }
        Some((name.trim_end_matches([';', ',']).to_owned(), numbers))
    };
    match separator {
        // A comma between fields leaves none for decimals, unless white space is between, too.
        Some(',') => listed().or_else(|| of(split(','), ",")),
        Some(c) => of(split(c), &c.to_string()).or_else(listed),
        None => listed(),
    }
}

/// Joins `a,b,c,d,e,f` to `a.b, c.d, e.f` in lists whose numbers only make sense so: whole numbers everywhere, and pairs of
/// them unit vectors, in every line.
fn decimal_commas_between_commas(lines: &[(usize, &str)]) -> bool {
    let paired = |line: &str| {
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        let Some(numbers) = fields.len().checked_sub(6).filter(|n| *n > 0).map(|n| &fields[n..]) else { return false };
        let digits = |w: &str| !w.is_empty() && w.bytes().all(|b| b.is_ascii_digit());
        let values = numbers.chunks(2).map(|p| {
            let whole = p[0].strip_prefix(['-', '+']).unwrap_or(p[0]);
            (digits(whole) && digits(p[1])).then(|| format!("{}.{}", p[0], p[1]).parse::<f32>().ok()).flatten()
        });
        let values: Option<Vec<f32>> = values.collect();
        values.is_some_and(|v| (v.iter().map(|x| x * x).sum::<f32>().sqrt() - 1.0).abs() < 0.02)
    };
    lines.len() > 2 && lines.iter().all(|(_, line)| paired(line))
}

/// `NAME x y z` a line, after a count if `counted`. Otherwise a first line without numbers is a heading, and the direction to
/// the camera may follow, then the strength of the light: as in the first line, so in all.
fn parse_named(text: &str, list: &Path, folder: &Path, counted: bool) -> Result<Vec<Shot>> {
    let numbered = text.lines().enumerate().map(|(i, line)| (i + 1, line.trim()));
    let mut lines: Vec<(usize, &str)> = numbered.filter(|(_, l)| !l.is_empty() && !l.starts_with('#')).collect();
    let mut count = None;
    if counted {
        count = lines.first().and_then(|(_, l)| l.trim_end_matches([';', ',']).trim().parse::<usize>().ok());
        if count.is_some() {
            lines.remove(0);
        } else {
            log::warn!("{}: the first line is not the number of pictures, as it is in .lp files", list.display());
        }
    }
    let heading = |l: &str| l.split([',', ';', '\t', ' ']).all(|w| text::number(w).is_none());
    let titles = lines.first().filter(|(_, l)| !counted && heading(l)).map(|(_, l)| *l);
    if titles.is_some() {
        lines.remove(0);
    }
    let separator = lines.first().and_then(|(_, l)| separator(l));
    let joined: Vec<String>;
    if separator == Some(',') && decimal_commas_between_commas(&lines) {
        log::warn!("{}: its numbers have decimal commas, and commas between them; read so", list.display());
        let join = |l: &str| {
            let fields: Vec<&str> = l.split(',').map(str::trim).collect();
            let (name, numbers) = fields.split_at(fields.len() - 6);
            let numbers: Vec<String> = numbers.chunks(2).map(|p| format!("{}.{}", p[0], p[1])).collect();
            format!("{},{}", name.join(","), numbers.join(","))
        };
        joined = lines.iter().map(|(_, l)| join(l)).collect();
        lines = lines.iter().zip(&joined).map(|((i, _), l)| (*i, l.as_str())).collect();
    }
    let first = titles.or(lines.first().map(|(_, l)| *l)).unwrap_or_default();
    let fields = separator.map_or(0, |c| first.trim_end_matches(c).split(c).count());
    let wanted = if !counted && [5, 7, 8].contains(&fields) { fields - 1 } else { 3 };
    let base = list.parent().unwrap_or(Path::new(""));
    let mut taken = Taken::new(list, Pictures::new(&[base, folder]));
    for &(number, line) in &lines {
        let Some((name, numbers)) = named_numbers(line, wanted, separator) else {
            let view = if wanted >= 6 { ", that to the camera, x y z," } else { "" };
            let strength = if wanted % 3 == 1 { " and the light's strength" } else { "" };
            let what = format!("line {number}: a picture and its direction x y z{view}{strength} are wanted");
            return Err(Error::invalid(list, what));
        };
        let triple = |at: usize| unit([numbers[at], numbers[at + 1], numbers[at + 2]], list, number);
        let view = (wanted >= 6).then(|| triple(3)).transpose()?;
        let strength = if wanted % 3 == 1 { numbers[wanted - 1] } else { 1.0 };
        if !(strength > 0.0 && strength.is_finite()) {
            return Err(Error::invalid(list, format!("line {number}: {strength} is no strength of a light")));
        }
        taken.add(name.trim(), number, |path| Ok(Shot { path, light: triple(0)?, view, strength }))?;
    }
    if let Some(n) = count.filter(|n| *n != lines.len()) {
        log::warn!("{}: {n} pictures announced, {} listed: the lines count", list.display(), lines.len());
    }
    taken.finish()
}

/// The shots of a list as they are read, and what is odd about their names.
struct Taken<'a> {
    list: &'a Path,
    pictures: Pictures,
    shots: Vec<Shot>,
    /// Where in `shots` a picture is.
    places: HashMap<PathBuf, usize>,
    alike: Vec<String>,
    missing: Vec<String>,
    twice: Vec<String>,
}

impl<'a> Taken<'a> {
    fn new(list: &'a Path, pictures: Pictures) -> Self {
        let (shots, places) = (Vec::new(), HashMap::new());
        Self { list, pictures, shots, places, alike: Vec::new(), missing: Vec::new(), twice: Vec::new() }
    }

    fn add(&mut self, name: &str, line: usize, shot: impl FnOnce(PathBuf) -> Result<Shot>) -> Result<()> {
        let path = match self.pictures.find(name) {
            Found::Exact(path) => path,
            Found::Alike(path) => {
                self.alike.push(format!("{name} is {}", path.file_name().unwrap_or_default().to_string_lossy()));
                path
            }
            Found::Missing => {
                // What else the line says must be sound all the same.
                shot(PathBuf::new())?;
                self.missing.push(name.to_owned());
                return Ok(());
            }
            Found::Unclear(several) => {
                let what = format!("line {line}: {name} is not there, and could be {}", several.join(" or "));
                return Err(Error::invalid(self.list, what));
            }
        };
        let shot = shot(path)?;
        match self.places.get(&shot.path) {
            Some(&at) if self.shots[at] == shot => self.twice.push(name.to_owned()),
            Some(_) => {
                let what = format!("line {line}: {name} is listed twice, with different lights");
                return Err(Error::invalid(self.list, what));
            }
            None => {
                self.places.insert(shot.path.clone(), self.shots.len());
                self.shots.push(shot);
            }
        }
        Ok(())
    }

    fn finish(self) -> Result<Vec<Shot>> {
        let list = self.list.display();
        let some = |names: &[String]| {
            let more = if names.len() > 5 { ", …" } else { "" };
            format!("{}{more}", names[..names.len().min(5)].join(", "))
        };
        if !self.missing.is_empty() {
            let (n, names) = (self.missing.len(), some(&self.missing));
            if self.shots.is_empty() {
                return Err(Error::invalid(self.list, format!("none of its {n} pictures is there: {names}")));
            }
            log::warn!("{list}: {n} of its pictures are missing and left out: {names}");
        }
        if !self.alike.is_empty() {
            let n = self.alike.len();
            log::warn!("{list}: {n} names differ from the pictures in case or ending: {}", some(&self.alike));
        }
        if !self.twice.is_empty() {
            log::warn!("{list}: listed twice, and taken once: {}", some(&self.twice));
        }
        Ok(self.shots)
    }
}

/// Rows of x y z after an optional count, or three rows of all x, all y, all z.
fn parse_table(text: &str, list: &Path) -> Result<Vec<[f32; 3]>> {
    let mut rows: Vec<Vec<f32>> = Vec::new();
    let lines = text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty() && !l.trim_start().starts_with('#'));
    for (i, line) in lines {
        // A comma between digits is a decimal mark where something else is between the numbers.
        let spaced: Vec<&str> =
            line.split([' ', '\t', ';']).map(|w| w.trim_matches(',')).filter(|w| !w.is_empty()).collect();
        let row = match &spaced[..] {
            [_] => line.split(',').map(str::trim).filter(|w| !w.is_empty()).map(|w| w.parse().ok()).collect(),
            words => words.iter().map(|w| text::number(w)).collect::<Option<Vec<f32>>>(),
        };
        rows.push(row.ok_or_else(|| Error::invalid(list, format!("line {}: numbers are wanted", i + 1)))?);
    }
    if rows.first().is_some_and(|r| r.len() == 1) {
        let count = rows.remove(0)[0];
        if count != rows.len() as f32 {
            log::warn!("{}: {count} directions announced, {} listed: the lines count", list.display(), rows.len());
        }
    }
    let wide = rows.len() == 3 && rows[0].len() > 3;
    if wide && rows.iter().all(|r| r.len() == rows[0].len()) {
        return (0..rows[0].len()).map(|i| unit([rows[0][i], rows[1][i], rows[2][i]], list, i + 1)).collect();
    }
    rows.iter()
        .enumerate()
        .map(|(i, r)| match r[..] {
            [x, y, z] => unit([x, y, z], list, i + 1),
            _ => Err(Error::invalid(list, format!("direction {}: x y z are wanted", i + 1))),
        })
        .collect()
}

/// Warns of lights below the horizon, of which a list of a dome has none, while those of a light stage are all around.
fn check(shots: &[Shot], list: &Path) {
    // A lamp at the horizon may be measured a little below.
    let below: Vec<&Shot> = shots.iter().filter(|s| s.light[2] < -0.02).collect();
    let Some(first) = below.first() else { return };
    if (0.25..=0.75).contains(&(below.len() as f32 / shots.len() as f32)) {
        return;
    }
    log::warn!(
        "{}: {} of {} lights are below the horizon, behind the object (z < 0, as for {}): z must \
         point from the object to the camera",
        list.display(),
        below.len(),
        shots.len(),
        first.path.file_name().unwrap_or_default().to_string_lossy()
    );
}

fn unit(v: [f32; 3], list: &Path, line: usize) -> Result<[f32; 3]> {
    normalised(v)
        .ok_or_else(|| Error::invalid(list, format!("line {line}: ({}, {}, {}) is no direction", v[0], v[1], v[2])))
}

/// The unit vector along `v`, if it has a direction.
pub fn normalised(v: [f32; 3]) -> Option<[f32; 3]> {
    let length = v.iter().map(|x| x * x).sum::<f32>().sqrt();
    (length.is_finite() && length > 1e-6).then(|| v.map(|x| x / length))
}

/// Pictures by natural order: `cat.2.png` before `cat.10.png`. Masks are not pictures of the stack.
fn numbered_pictures(entries: &[PathBuf]) -> Vec<PathBuf> {
    let is_of_stack = |p: &&PathBuf| {
        let name = p.file_name().map(|n| n.to_string_lossy().to_lowercase()).unwrap_or_default();
        !name.contains("mask") && is_picture(p)
    };
    let mut pictures: Vec<PathBuf> = entries.iter().filter(is_of_stack).cloned().collect();
    pictures.sort_by_cached_key(|p| translume_image::natural_key(&p.to_string_lossy()));
    pictures
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stack(files: &[(&str, &str)]) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        files.iter().for_each(|(name, text)| std::fs::write(dir.path().join(name), text).unwrap());
        dir
    }

    fn lights(files: &[(&str, &str)]) -> std::result::Result<Vec<(String, [f32; 3])>, String> {
        let dir = stack(files);
        let name = |p: &Path| p.file_name().unwrap().to_string_lossy().into_owned();
        let found = find(dir.path(), None).map_err(|e| e.to_string())?;
        Ok(found.0.iter().map(|s| (name(&s.path), s.light)).collect())
    }

    #[test]
    fn an_lp_file_may_hold_foreign_paths_and_names_with_spaces() {
        let lp = "2\r\nC:\\photos\\a b.png 0 0 2\r\nc.png 3 0 4\r\n";
        let got = lights(&[("x.lp", lp), ("a b.png", ""), ("c.png", "")]).unwrap();
        assert_eq!(got, [("a b.png".into(), [0.0, 0.0, 1.0]), ("c.png".into(), [0.6, 0.0, 0.8])]);
    }

    #[test]
    fn tables_go_with_pictures_in_the_order_of_their_numbers() {
        let files = [("m.10.png", ""), ("m.2.png", ""), ("m.mask.png", "")];
        for table in ["2\n1 0 0\n0 1 0\n", "1 0 0\n0 1 0\n"] {
            let got = lights(&[files[0], files[1], files[2], ("lights.txt", table)]).unwrap();
            assert_eq!(got, [("m.2.png".into(), [1.0, 0.0, 0.0]), ("m.10.png".into(), [0.0, 1.0, 0.0])]);
        }
        let wide = "1 0 0 1\n0 1 0 1\n0 0 1 0\n";
        let names = [("1.png", ""), ("2.png", ""), ("3.png", ""), ("4.png", ""), ("light_directions.txt", wide)];
        assert_eq!(lights(&names).unwrap()[1].1, [0.0, 1.0, 0.0]);
    }

    #[test]
    fn a_csv_file_may_hold_the_view_as_well() {
        let list = "file,lx,ly,lz,vx,vy,vz\na 1.png,0,0,2,3,0,4\n";
        let dir = stack(&[("lights.csv", list), ("a 1.png", "")]);
        let shots = find(dir.path(), None).unwrap().0;
        assert_eq!((shots[0].light, shots[0].view), ([0.0, 0.0, 1.0], Some([0.6, 0.0, 0.8])));
        std::fs::write(dir.path().join("lights.csv"), list.replace(",0,4", ",4")).unwrap();
        let error = find(dir.path(), None).unwrap_err().to_string();
        assert!(error.contains("line 2") && error.contains("to the camera"), "{error}");
        // A strength after either.
        for text in ["a 1.png,0,0,2,0.5\n", "a 1.png;0;0;2;0;0;1;0.5\n"] {
            std::fs::write(dir.path().join("lights.csv"), text).unwrap();
            assert_eq!(find(dir.path(), None).unwrap().0[0].strength, 0.5);
        }
        std::fs::write(dir.path().join("lights.csv"), "a 1.png,0,0,2,-1\n").unwrap();
        assert!(find(dir.path(), None).unwrap_err().to_string().contains("no strength"));
    }

    #[test]
    fn a_csv_file_may_have_a_heading() {
        let got = lights(&[("lights.csv", "file,x,y,z\na.exr,0,0,1\n"), ("a.exr", "")]).unwrap();
        assert_eq!(got, [("a.exr".into(), [0.0, 0.0, 1.0])]);
    }

    #[test]
    fn lists_that_do_not_fit_are_refused_with_the_place() {
        let a = ("a.png", "");
        for (files, expected) in [
            (vec![("x.lp", "1\na.png 0 0\n"), a], "line 2: a picture and its direction"),
            (vec![("x.lp", "1\na.png 0 0 0\n"), a], "is no direction"),
            (vec![("x.lp", "1\na.png 0 nan 0\n"), a], "is no direction"),
            (vec![("x.lp", "1\nb.png 0 0 0\n"), a], "is no direction"),
            (vec![("x.lp", "1\nb.png 0 0 1\n"), a], "none of its 1 pictures is there: b.png"),
            (vec![("x.lp", "2\na.png 0 0 1\na.png 1 0 1\n"), a], "listed twice, with different lights"),
            (vec![("x.lp", "1\nc.png 0 0 1\n"), ("c.jpg", ""), ("C.tif", "")], "could be"),
            (vec![("lights.txt", "2\n0 0 1\n0 1 0\n"), a], "2 directions for 1 pictures"),
            (vec![("lights.txt", "0 0 one\n"), a], "line 1: numbers"),
            (vec![a], "no light directions"),
        ] {
            let error = lights(&files).unwrap_err();
            assert!(error.contains(expected), "{error} instead of {expected}");
        }
    }

    /// All of these say the same of the same pictures.
    #[test]
    fn lists_as_other_programs_write_them() {
        let pictures = [("a 1.png", ""), ("b.png", ""), ("c.png", "")];
        let same = |name: &str, text: &str| {
            let got = lights(&[&[(name, text)], &pictures[..]].concat()).unwrap_or_else(|e| panic!("{text}: {e}"));
            let wanted = [[0.6, 0.0, 0.8], [0.0, 0.6, 0.8], [-0.6, 0.0, 0.8]];
            assert!(got.iter().zip(&pictures).all(|(g, p)| g.0 == p.0), "{text}: {got:?}");
            let near = |a: [f32; 3], b: [f32; 3]| (0..3).all(|i| (a[i] - b[i]).abs() < 1e-5);
            assert!(got.len() == 3 && got.iter().zip(wanted).all(|(g, w)| near(g.1, w)), "{text}: {got:?}");
        };
        let plain = "3\na 1.png 0.6 0.0 0.8\nb.png 0.0 0.6 0.8\nc.png -0.6 0.0 0.8\n";
        let commas = plain.replace("0.", "0,");
        same("x.lp", plain);
        same("x.lp", &commas);
        same("x.lp", &plain.replace('\n', "\r"));
        same("x.lp", &plain.replace("3\n", "3\n\n# made by hand\n"));
        same("x.lp", &plain.replace("3\n", "4\n"));
        same("x.lp", plain.trim_start_matches("3\n"));
        same("x.lp", &plain.replace("c.png", "C.JPG").replace("b.png", "/home/me/B.PNG"));
        same("x.lp", &format!("{}b.png 0.0 0.6 0.8\nd.png 0 0 1\n", plain.replace("3\n", "5\n")));
        for between in [";", "\t", "; ", ", "] {
            let text = plain.replace(" 0.", &format!("{between}0.")).replace(" -0.", &format!("{between}-0."));
            same("x.lp", &text);
            same("lights.csv", text.trim_start_matches("3\n"));
            if between != ", " {
                same("lights.csv", &text.trim_start_matches("3\n").replace("0.", "0,"));
            }
        }
        same("lights.csv", "file,x,y,z\na 1.png,0,6,0,0,0,8\nb.png,0,0,0,6,0,8\nc.png,-0,6,0,0,0,8\n");
        same("lights.txt", "3\n0,6 0,0 0,8\n0,0 0,6 0,8\n-0,6 0,0 0,8\n");
        same("lights.txt", "0.6,0,0.8\n0, 0.6, 0.8\n-0.6\t0\t0.8\n");
        same("lights.txt", "0,6;0;0,8\n0;0,6;0,8\n-0,6;0;0,8\n");
    }

    #[test]
    fn written_lists_are_relative() {
        let dir = stack(&[("a.png", ""), ("b.png", ""), ("x.lp", "2\na.png 0 0 1\nb.png 0 1 1\n")]);
        let lists = dir.path().join("lists");
        std::fs::create_dir(&lists).unwrap();
        let shots = find(&dir.path().canonicalize().unwrap(), None).unwrap().0;
        let text = to_lp(&shots, &lists);
        assert!(text.contains("../a.png 0 0 1") && !text.contains(&*dir.path().to_string_lossy()), "{text}");
        std::fs::write(lists.join("y.lp"), text).unwrap();
        assert_eq!(find(dir.path(), Some(&lists.join("y.lp"))).unwrap().0.len(), 2);
        assert!(to_csv(&shots, dir.path()).contains("\na.png,0,0,1,1"), "{}", to_csv(&shots, dir.path()));
    }
}
