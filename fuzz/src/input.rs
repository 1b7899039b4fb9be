//! What a reader is given: a file, or several that belong together.

use std::io::Result;
use std::path::Path;

/// Files by their names relative to a folder, `/` between; in the order of their names.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Input {
    /// Name and content.
    pub files: Vec<(String, Vec<u8>)>,
}

impl Input {
    /// One file.
    pub fn file(name: &str, bytes: impl Into<Vec<u8>>) -> Self {
        Self { files: vec![(name.to_owned(), bytes.into())] }
    }

    /// The file at `path` under its own name, or all files of that folder.
    ///
    /// # Errors
    /// Of reading.
    pub fn load(path: &Path) -> Result<Self> {
        let mut input = Self::default();
        if path.is_dir() {
            input.collect(path, "")?;
            input.files.sort();
        } else {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            input.files.push((name, std::fs::read(path)?));
        }
        Ok(input)
    }

    fn collect(&mut self, folder: &Path, prefix: &str) -> Result<()> {
        for entry in std::fs::read_dir(folder)? {
            let entry = entry?;
            let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
            if entry.path().is_dir() {
                self.collect(&entry.path(), &format!("{name}/"))?;
            } else {
                self.files.push((name, std::fs::read(entry.path())?));
            }
        }
        Ok(())
    }

    /// Writes the files into `folder`, which holds nothing else then.
    ///
    /// # Errors
    /// Of writing.
    pub fn write(&self, folder: &Path) -> Result<()> {
        if folder.exists() {
            std::fs::remove_dir_all(folder)?;
        }
        std::fs::create_dir_all(folder)?;
        for (name, bytes) in &self.files {
            let path = folder.join(name);
            std::fs::create_dir_all(path.parent().unwrap_or(folder))?;
            std::fs::write(path, bytes)?;
        }
        Ok(())
    }

    /// Replaces what `last`, written before, left in `folder`; only what differs is written.
    ///
    /// # Errors
    /// Of writing.
    pub fn replace(&self, last: &Self, folder: &Path) -> Result<()> {
        let same_names =
            self.files.len() == last.files.len() && self.files.iter().zip(&last.files).all(|(a, b)| a.0 == b.0);
        if !same_names {
            return self.write(folder);
        }
        for ((name, bytes), (_, before)) in self.files.iter().zip(&last.files) {
            if bytes != before {
                std::fs::write(folder.join(name), bytes)?;
            }
        }
        Ok(())
    }

    /// Saves it as `place` with the ending of its file, or as the folder `place`; returns the path.
    ///
    /// # Errors
    /// Of writing.
    pub fn save(&self, folder: &Path, name: &str) -> Result<std::path::PathBuf> {
        std::fs::create_dir_all(folder)?;
        let path = match &self.files[..] {
            [(file, bytes)] => {
                let ending =
                    Path::new(file).extension().map(|e| format!(".{}", e.to_string_lossy())).unwrap_or_default();
                let path = folder.join(format!("{name}{ending}"));
                std::fs::write(&path, bytes)?;
                path
            }
            _ => {
                let path = folder.join(name);
                self.write(&path)?;
                path
            }
        };
        Ok(path)
    }

    /// All bytes.
    pub fn size(&self) -> usize {
        self.files.iter().map(|f| f.1.len()).sum()
    }

    /// The first file whose name ends so.
    pub fn ending(&self, ending: &str) -> Option<&str> {
        self.files.iter().map(|f| f.0.as_str()).find(|name| name.ends_with(ending))
    }

    /// A number for names of files: FNV-1a of everything.
    pub fn hash(&self) -> u64 {
        let bytes = self.files.iter().flat_map(|(n, b)| n.bytes().chain(b.iter().copied()));
        bytes.fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0000_0100_0000_01b3))
    }
}
