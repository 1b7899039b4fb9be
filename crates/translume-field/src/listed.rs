//! Pictures by the names that a list gives them.
//!
//! Lists come from other machines: with absolute paths, of which the name alone counts where the path leads nowhere;
//! from systems where case does not matter; and with the endings of other versions of the pictures. A match that is the
//! only one counts.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// Endings of pictures.
const PICTURES: [&str; 10] = ["png", "jpg", "jpeg", "tif", "tiff", "tga", "exr", "hdr", "pfm", "pic"];

/// The ending of a path, in lower case.
pub(crate) fn ending(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// Whether a path is a picture by its name; `._` files of macOS are none.
pub(crate) fn is_picture(path: &Path) -> bool {
    let hidden = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with("._"));
    PICTURES.contains(&ending(path).as_str()) && !hidden && path.is_file()
}

/// What became of a name.
#[derive(Debug, PartialEq)]
pub(crate) enum Found {
    /// The very name.
    Exact(PathBuf),
    /// The only picture of that name but for case and ending.
    Alike(PathBuf),
    /// Several pictures are as like.
    Unclear(Vec<String>),
    /// No picture.
    Missing,
}

/// The pictures of the folders that a list may mean.
pub(crate) struct Pictures {
    folders: Vec<PathBuf>,
    /// By lower-case name, and by lower-case name without its ending.
    by_name: HashMap<String, Vec<PathBuf>>,
    by_stem: HashMap<String, Vec<PathBuf>>,
}

impl Pictures {
    /// Of the list's folder and the stack's.
    pub(crate) fn new(folders: &[&Path]) -> Self {
        let mut found = BTreeMap::new();
        let mut kept: Vec<PathBuf> = Vec::new();
        for folder in folders {
            let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
            let own = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
            // The same folder by two names would make every match two.
            if kept.iter().any(|k| k.canonicalize().is_ok_and(|k| k == own)) {
                continue;
            }
            kept.push(folder.to_owned());
            for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
                let path = entry.path();
                if is_picture(&path) {
                    found.insert(path.canonicalize().unwrap_or_else(|_| path.clone()), path);
                }
            }
        }
        let (mut by_name, mut by_stem) = (HashMap::<_, Vec<_>>::new(), HashMap::<_, Vec<_>>::new());
        for path in found.into_values() {
            let lower =
                |part: Option<&std::ffi::OsStr>| part.map(|p| p.to_string_lossy().to_lowercase()).unwrap_or_default();
            by_name.entry(lower(path.file_name())).or_default().push(path.clone());
            by_stem.entry(lower(path.file_stem())).or_default().push(path);
        }
        Self { folders: kept, by_name, by_stem }
    }

    /// The picture called `name`.
    pub(crate) fn find(&self, name: &str) -> Found {
        let name = name.trim_matches('"').replace('\\', "/");
        let last = name.rsplit('/').next().unwrap_or(&name);
        let exact = self.folders.iter().map(|f| f.join(&name)).chain(self.folders.iter().map(|f| f.join(last)));
        if let Some(path) = exact.into_iter().find(|p| p.is_file()) {
            return Found::Exact(path);
        }
        let mut lower = last.to_lowercase();
        // Where points were made commas in numbers, those of endings may have been.
        if let Some((stem, ending)) = lower.rsplit_once(',').filter(|_| !lower.contains('.')) {
            lower = format!("{stem}.{ending}");
        }
        // What follows the last point must be able to be an ending.
        let is_ending = |e: &str| !e.is_empty() && e.len() <= 5 && e.bytes().all(|b| b.is_ascii_alphanumeric());
        let stem = lower.rsplit_once('.').filter(|(_, ending)| is_ending(ending)).map(|(stem, _)| stem);
        let alike = self.by_name.get(&lower).or_else(|| self.by_stem.get(stem?));
        match alike.map(Vec::as_slice).unwrap_or_default() {
            [] => Found::Missing,
            [one] => Found::Alike(one.clone()),
            several => Found::Unclear(several.iter().take(3).map(|p| p.display().to_string()).collect()),
        }
    }
}

/// The way from `folder` to `path`, by `..` where it must be; the name alone where there is none.
pub(crate) fn relative(path: &Path, folder: &Path) -> PathBuf {
    let absolute = |p: &Path| {
        let p = if p.as_os_str().is_empty() { Path::new(".") } else { p };
        p.canonicalize().or_else(|_| std::path::absolute(p)).unwrap_or_else(|_| p.to_owned())
    };
    // The folder of the picture, so that a link keeps its own name.
    let name = path.file_name().unwrap_or_default();
    let (from, to) = (absolute(folder), absolute(path.parent().unwrap_or(Path::new(""))));
    let common = from.components().zip(to.components()).take_while(|(a, b)| a == b).count();
    if common == 0 {
        return PathBuf::from(name);
    }
    let up = from.components().skip(common).map(|_| std::path::Component::ParentDir);
    up.chain(to.components().skip(common)).collect::<PathBuf>().join(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_one_match_is_a_match() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["IMG_1.JPG", "img_2.tif", "a.png", "A.jpg", "b.txt"] {
            std::fs::write(dir.path().join(name), "").unwrap();
        }
        let pictures = Pictures::new(&[dir.path(), dir.path()]);
        let at = |name: &str| dir.path().join(name);
        assert_eq!(pictures.find("a.png"), Found::Exact(at("a.png")));
        assert_eq!(pictures.find("D:\\shots\\a.png"), Found::Exact(at("a.png")));
        assert_eq!(pictures.find("img_1.jpg"), Found::Alike(at("IMG_1.JPG")));
        assert_eq!(pictures.find("/raw/IMG_2.CR2"), Found::Alike(at("img_2.tif")));
        assert_eq!(pictures.find("img_1,jpg"), Found::Alike(at("IMG_1.JPG")));
        assert!(matches!(pictures.find("a.tif"), Found::Unclear(names) if names.len() == 2));
        assert_eq!(pictures.find("c.png"), Found::Missing);
        assert_eq!(pictures.find("a.png,0,0,1"), Found::Missing);
        assert_eq!(pictures.find("b.png"), Found::Missing);
    }

    #[test]
    fn ways_between_folders_are_relative() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(dir.path().join("a/b")).unwrap();
        let at = |name: &str| dir.path().join(name);
        assert_eq!(relative(&at("a/x.png"), &at("a")), Path::new("x.png"));
        assert_eq!(relative(&at("a/b/x.png"), &at("a")), Path::new("b/x.png"));
        assert_eq!(relative(&at("x.png"), &at("a/b")), Path::new("../../x.png"));
    }
}
