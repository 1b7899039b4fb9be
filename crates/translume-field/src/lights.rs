//! Which picture was lit from where: RTI `.lp` files, tables of directions, `lights.csv`.
//!
//! Directions point from the object to the light: x right, y up, z to the camera. They are normalised here.

use crate::{Error, Result};
use std::path::{Path, PathBuf};

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

/// Endings of files that are taken for pictures where a list does not name them.
const PICTURES: [&str; 10] = ["png", "jpg", "jpeg", "tif", "tiff", "tga", "exr", "hdr", "pfm", "pic"];

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
    check(&shots, &list)?;
    let same = |p: &Path| shots.iter().any(|s| s.path == p);
    let unlit = numbered_pictures(&entries).iter().filter(|p| !same(p)).count();
    Ok((shots, unlit))
}

/// The pictures of a folder in the order of the numbers in their names; masks left out.
///
/// # Errors
/// [`Error::Io`].
pub fn pictures(folder: &Path) -> Result<Vec<PathBuf>> {
    Ok(numbered_pictures(&entries(folder)?))
}

/// The text of an `.lp` file of `shots`, names relative to its folder where they are inside it.
pub fn to_lp(shots: &[Shot], folder: &Path) -> String {
    let line = |s: &Shot| {
        let name = s.path.strip_prefix(folder).unwrap_or(&s.path);
        format!("{} {} {} {}\n", name.to_string_lossy().replace('\\', "/"), s.light[0], s.light[1], s.light[2])
    };
    format!("{}\n", shots.len()) + &shots.iter().map(line).collect::<String>()
}

/// The text of a `lights.csv` of `shots`, with strengths, names as in [`to_lp`].
pub fn to_csv(shots: &[Shot], folder: &Path) -> String {
    let line = |s: &Shot| {
        let name = s.path.strip_prefix(folder).unwrap_or(&s.path);
        let [x, y, z] = s.light;
        format!("{},{x},{y},{z},{}\n", name.to_string_lossy().replace('\\', "/"), s.strength)
    };
    String::from("file,x,y,z,strength\n") + &shots.iter().map(line).collect::<String>()
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut all = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))? {
        all.push(entry.map_err(|e| Error::io(folder, e))?.path());
    }
    all.sort();
    Ok(all)
}

fn ending(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
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

fn read_text(path: &Path) -> Result<String> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
    String::from_utf8(bytes.to_vec()).map_err(|_| Error::invalid(path, "not a text file in UTF-8"))
}

/// `NAME x y z` a line, after a count if `counted`. Names may hold spaces. Otherwise commas or semicolons are between, a first line
/// without numbers is a heading, and the direction to the camera may follow, then the strength of the light: as in the first line, so
/// in all.
fn parse_named(text: &str, list: &Path, folder: &Path, counted: bool) -> Result<Vec<Shot>> {
    let mut lines =
        text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty() && !l.trim_start().starts_with('#')).peekable();
    let mut count = None;
    if counted {
        let first = lines.next().and_then(|(_, l)| l.trim().parse::<usize>().ok());
        count =
            Some(first.ok_or_else(|| Error::invalid(list, "the first line of an .lp file is the number of pictures"))?);
    }
    let base = list.parent().unwrap_or(Path::new(""));
    let fields = lines.peek().map_or(0, |(_, l)| l.split([',', ';']).count());
    let wanted = if !counted && [5, 7, 8].contains(&fields) { fields - 1 } else { 3 };
    let mut shots = Vec::new();
    for (i, line) in lines {
        let spaced = if counted { line.to_owned() } else { line.replace([',', ';'], " ") };
        let words: Vec<&str> = spaced.split_whitespace().collect();
        let numbers: Option<Vec<f32>> = words
            .len()
            .checked_sub(wanted)
            .filter(|n| *n > 0)
            .and_then(|n| words[n..].iter().map(|w| w.parse().ok()).collect());
        let Some(numbers) = numbers else {
            if !counted && shots.is_empty() && words.iter().all(|w| w.parse::<f32>().is_err()) {
                continue;
            }
            let view = if wanted >= 6 { ", that to the camera, x y z," } else { "" };
            let strength = if wanted % 3 == 1 { " and the light's strength" } else { "" };
            let what = format!("line {}: a picture and its direction x y z{view}{strength} are wanted", i + 1);
            return Err(Error::invalid(list, what));
        };
        // What is left of the line when the numbers are taken off its end.
        let mut name = spaced.trim_end();
        for word in words[words.len() - wanted..].iter().rev() {
            name = name.strip_suffix(word).unwrap_or(name).trim_end();
        }
        let triple = |at: usize| unit([numbers[at], numbers[at + 1], numbers[at + 2]], list, i + 1);
        let view = (wanted >= 6).then(|| triple(3)).transpose()?;
        let strength = if wanted % 3 == 1 { numbers[wanted - 1] } else { 1.0 };
        if !(strength > 0.0 && strength.is_finite()) {
            return Err(Error::invalid(list, format!("line {}: {strength} is no strength of a light", i + 1)));
        }
        shots.push(Shot { path: locate(name.trim(), base, folder, list)?, light: triple(0)?, view, strength });
    }
    if let Some(n) = count.filter(|n| *n != shots.len()) {
        return Err(Error::invalid(list, format!("{n} pictures announced, {} listed", shots.len())));
    }
    Ok(shots)
}

/// Lists often carry the absolute paths of the machine they were made on: the name alone is looked for then.
fn locate(name: &str, base: &Path, folder: &Path, list: &Path) -> Result<PathBuf> {
    let name = name.trim_matches('"').replace('\\', "/");
    let last = name.rsplit('/').next().unwrap_or(&name);
    let candidates = [base.join(&name), folder.join(&name), base.join(last), folder.join(last)];
    candidates
        .into_iter()
        .find(|p| p.is_file())
        .ok_or_else(|| Error::invalid(list, format!("the picture {name} is not there")))
}

/// Rows of x y z after an optional count, or three rows of all x, all y, all z.
fn parse_table(text: &str, list: &Path) -> Result<Vec<[f32; 3]>> {
    let mut rows: Vec<Vec<f32>> = Vec::new();
    for (i, line) in text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
        let row: std::result::Result<Vec<f32>, _> =
            line.split([' ', '\t', ',', ';']).filter(|w| !w.is_empty()).map(str::parse).collect();
        rows.push(row.map_err(|_| Error::invalid(list, format!("line {}: numbers are wanted", i + 1)))?);
    }
    if rows.first().is_some_and(|r| r.len() == 1) {
        let count = rows.remove(0)[0];
        if count != rows.len() as f32 {
            return Err(Error::invalid(list, format!("{count} directions announced, {} listed", rows.len())));
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

fn unit(v: [f32; 3], list: &Path, line: usize) -> Result<[f32; 3]> {
    normalised(v)
        .ok_or_else(|| Error::invalid(list, format!("line {line}: ({}, {}, {}) is no direction", v[0], v[1], v[2])))
}

/// The unit vector along `v`, if it has a direction.
pub fn normalised(v: [f32; 3]) -> Option<[f32; 3]> {
    let length = v.iter().map(|x| x * x).sum::<f32>().sqrt();
    (length.is_finite() && length > 1e-6).then(|| v.map(|x| x / length))
}

fn check(shots: &[Shot], list: &Path) -> Result<()> {
    let mut seen = std::collections::HashSet::new();
    match shots.iter().find(|s| !seen.insert(&s.path)) {
        Some(twice) => Err(Error::invalid(list, format!("{} is listed twice", twice.path.display()))),
        None => Ok(()),
    }
}

/// Pictures by natural order: `cat.2.png` before `cat.10.png`. Masks are not pictures of the stack.
fn numbered_pictures(entries: &[PathBuf]) -> Vec<PathBuf> {
    let is_picture = |p: &&PathBuf| {
        let name = p.file_name().map(|n| n.to_string_lossy().to_lowercase()).unwrap_or_default();
        PICTURES.contains(&ending(p).as_str()) && !name.contains("mask") && p.is_file()
    };
    let mut pictures: Vec<PathBuf> = entries.iter().filter(is_picture).cloned().collect();
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
            (vec![("x.lp", "2\na.png 0 0 1\n"), a], "2 pictures announced, 1 listed"),
            (vec![("x.lp", "1\na.png 0 0\n"), a], "line 2: a picture and its direction"),
            (vec![("x.lp", "1\na.png 0 0 0\n"), a], "is no direction"),
            (vec![("x.lp", "1\na.png 0 nan 0\n"), a], "is no direction"),
            (vec![("x.lp", "1\nb.png 0 0 1\n"), a], "the picture b.png is not there"),
            (vec![("x.lp", "2\na.png 0 0 1\na.png 1 0 1\n"), a], "listed twice"),
            (vec![("x.lp", "a.png 0 0 1\n"), a], "the first line"),
            (vec![("lights.txt", "2\n0 0 1\n0 1 0\n"), a], "2 directions for 1 pictures"),
            (vec![("lights.txt", "0 0 one\n"), a], "line 1: numbers"),
            (vec![a], "no light directions"),
        ] {
            let error = lights(&files).unwrap_err();
            assert!(error.contains(expected), "{error} instead of {expected}");
        }
    }
}
