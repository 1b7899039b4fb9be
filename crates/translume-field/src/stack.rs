//! A stack of pictures: one view, one light each. Pictures are read when they are needed and forgotten after.

use crate::lights::{self, Shot};
use crate::names;
use crate::{Error, Result};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use translume_image::colour::Space;
use translume_image::{Format, read_codes, read_picture};

/// Fewest pictures that make a field.
pub const FEWEST: usize = 3;

/// How to read a folder as a stack.
#[derive(Clone, Debug, Default)]
pub struct Source {
    /// List of lights; `None`: the one in the folder ([`lights::find`]).
    pub list: Option<PathBuf>,
    /// Instead of a list: pattern of the pictures' names, with directions in it ([`names::find`]).
    pub names: Option<String>,
    /// Values of 8 and 16-bit pictures are light as they stand, not codes of a display.
    pub linear: bool,
}

/// A stack on disk.
#[derive(Clone, Debug)]
pub struct Stack {
    /// Its folder.
    pub folder: PathBuf,
    /// Pictures and lights.
    pub shots: Vec<Shot>,
    /// Width of every picture.
    pub width: usize,
    /// Height of every picture.
    pub height: usize,
    /// Light that a display shows as white: 1 for encoded pictures; for float ones, the mean luminance of what is lit
    /// (highlights cut) at 18 % (the "adaptive exposure" of the thesis, once for the whole stack).
    pub white: f32,
    /// Integers are light as they stand.
    pub linear: bool,
    /// What is odd about the stack but no reason to stop.
    pub warnings: Vec<String>,
    /// Bytes that the pictures may take that are read at the same time; one is in any case.
    pub reading: usize,
}

/// Bytes a pixel while a picture is read: the result, and what it is made of: codes, or floats and their file.
const PER_PIXEL: (usize, usize) = (24, 28);

/// Counts of samples that had to be changed.
#[derive(Debug, Default)]
struct Repairs {
    non_finite: AtomicUsize,
    negative: AtomicUsize,
    black: AtomicUsize,
}

impl Stack {
    /// Opens the stack in `folder` with the lights of `list` or of the list found there.
    ///
    /// # Errors
    /// As [`Stack::open_as`].
    pub fn open(folder: &Path, list: Option<&Path>) -> Result<Self> {
        Self::open_as(folder, &Source { list: list.map(Path::to_owned), ..Source::default() })
    }

    /// Opens the stack in `folder`.
    ///
    /// # Errors
    /// As [`lights::find`] and [`names::find`]; [`Error::Invalid`] for fewer than [`FEWEST`] pictures and for float stacks without light.
    pub fn open_as(folder: &Path, source: &Source) -> Result<Self> {
        let (shots, unlit) = match &source.names {
            Some(pattern) => names::find(folder, pattern)?,
            None => lights::find(folder, source.list.as_deref())?,
        };
        let mut stack = Self::made(folder, shots, source.linear)?;
        if unlit > 0 {
            let why =
                if source.names.is_some() { "have names of another pattern" } else { "are not in the list of lights" };
            stack.warnings.push(format!("{}: {unlit} pictures {why} and are left out", folder.display()));
        }
        Ok(stack)
    }

    /// A stack of `shots`; sizes and white are read off its pictures.
    ///
    /// # Errors
    /// As [`Stack::open_as`].
    pub fn of(folder: &Path, shots: Vec<Shot>) -> Result<Self> {
        Self::made(folder, shots, false)
    }

    fn made(folder: &Path, shots: Vec<Shot>, linear: bool) -> Result<Self> {
        if shots.len() < FEWEST {
            let what = format!("{} pictures with lights: a field needs {FEWEST} or more", shots.len());
            return Err(Error::invalid(folder, what));
        }
        let first = read_picture(&shots[0].path)?;
        let (width, height) = first.pixels.dimensions();
        let mut stack = Self {
            folder: folder.to_owned(),
            width: width as usize,
            height: height as usize,
            white: 1.0,
            linear,
            warnings: Vec::new(),
            reading: 1 << 30,
            shots,
        };
        if linear || is_float(&stack.shots[0].path)? {
            stack.white = stack.adaptive_white()?;
        }
        Ok(stack)
    }

    /// The directions to the camera, where the pictures differ in that; else none.
    pub fn views(&self) -> Vec<[f32; 3]> {
        self.shots.iter().filter_map(|s| s.view).collect()
    }

    /// Number of pixels of a picture.
    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// Bytes of memory that reading one picture takes.
    pub(crate) fn bytes_to_read(&self) -> usize {
        let codes = |s: &Shot| matches!(Format::of_file(&s.path), Ok(Format::Png | Format::Jpeg | Format::Tga));
        let each = if self.shots.first().is_some_and(codes) { PER_PIXEL.0 } else { PER_PIXEL.1 };
        each * self.pixels()
    }

    /// How many pictures are read at the same time; all, where there is room for as many as there are threads.
    fn at_once(&self) -> usize {
        let room = (self.reading / self.bytes_to_read().max(1)).max(1);
        if room < rayon::current_num_threads() { room } else { self.shots.len().max(1) }
    }

    /// Reads the picture of light `i`: interleaved RGB relative to [`Stack::white`], negative and not finite samples
    /// set to 0.
    ///
    /// # Errors
    /// Of reading, and [`Error::Invalid`] when its size is not that of the first.
    pub fn read(&self, i: usize) -> Result<Vec<f32>> {
        self.read_counting(i, &Repairs::default())
    }

    fn read_counting(&self, i: usize, repairs: &Repairs) -> Result<Vec<f32>> {
        let path = &self.shots[i].path;
        let (w, h, mut rgb) = if self.linear {
            let codes = read_codes(path)?;
            (codes.width, codes.height, (0..3 * codes.width * codes.height).map(|i| codes.unit(i)).collect())
        } else {
            let pixels = read_picture(path)?.pixels;
            (pixels.width() as usize, pixels.height() as usize, pixels.into_raw())
        };
        if (w, h) != (self.width, self.height) {
            let (w0, h0) = (self.width, self.height);
            let what = format!(
                "{w} × {h} pixels, but {} has {w0} × {h0}: all pictures of a stack show one view",
                self.shots[0].path.display()
            );
            return Err(Error::invalid(path, what));
        }
        let scale = 1.0 / (self.white * self.shots[i].strength);
        let (mut non_finite, mut negative, mut most) = (0, 0, 0.0f32);
        for v in &mut rgb {
            if !v.is_finite() {
                non_finite += 1;
                *v = 0.0;
            } else if *v < 0.0 {
                // Colours outside Rec. 709 are a little negative; that is no damage.
                negative += usize::from(*v < -0.05 * self.white);
                *v = 0.0;
            }
            *v *= scale;
            most = most.max(*v);
        }
        repairs.non_finite.fetch_add(non_finite, Ordering::Relaxed);
        repairs.negative.fetch_add(negative, Ordering::Relaxed);
        repairs.black.fetch_add(usize::from(most == 0.0), Ordering::Relaxed);
        Ok(rgb)
    }

    /// Calls `each` with the number and the samples of every picture, several at a time; tells `progress` of each.
    ///
    /// # Errors
    /// The first of reading or of `each`; [`Error::Invalid`] when all pictures are black. Warnings are added for what was repaired.
    pub fn for_each(
        &mut self,
        each: impl Fn(usize, Vec<f32>) -> Result<()> + Sync,
        progress: &(dyn Fn() + Sync),
    ) -> Result<()> {
        let repairs = Repairs::default();
        let stack = &*self;
        let one = |i: usize| {
            each(i, stack.read_counting(i, &repairs)?)?;
            progress();
            Ok::<_, Error>(())
        };
        let all: Vec<usize> = (0..stack.shots.len()).collect();
        for some in all.chunks(stack.at_once()) {
            some.par_iter().with_max_len(1).try_for_each(|i| one(*i))?;
        }
        let (black, n) = (repairs.black.into_inner(), self.shots.len());
        if black == n {
            return Err(Error::invalid(&self.folder, "all pictures are black: nothing to compress"));
        }
        let folder = self.folder.display();
        let mut warn = |count: usize, what: &str| {
            if count > 0 {
                self.warnings.push(format!("{folder}: {count} {what}"));
            }
        };
        warn(black, "of the pictures are all black and are kept; take lights that failed out of the list");
        warn(repairs.non_finite.into_inner(), "samples are NaN or infinite, taken for 0");
        warn(repairs.negative.into_inner(), "samples are far below zero, taken for 0");
        Ok(())
    }

    /// Mean luminance of lit pixels, over up to 16 pictures, divided by 0.18. What is brighter than all but a hundredth of them
    /// counts as that, so that a lamp seen in a mirror does not make the rest dark.
    fn adaptive_white(&self) -> Result<f32> {
        let n = self.shots.len();
        let count = n.min(16);
        let picked: Vec<usize> = (0..count).map(|i| i * n / count).collect();
        let y = Space::REC709.luminance_weights().map(|w| w as f32);
        let parts: Result<Vec<Vec<f32>>> = picked
            .into_par_iter()
            .with_max_len(1)
            .map(|i| {
                // Some 16,000 pixels of each say enough.
                let rgb = self.read(i)?;
                let pixels = rgb.as_chunks::<3>().0.iter().step_by((self.pixels() >> 14).max(1));
                Ok(pixels.map(|p| y[0] * p[0] + y[1] * p[1] + y[2] * p[2]).filter(|l| *l > 0.0).collect())
            })
            .collect();
        let mut lit = parts?.concat();
        if lit.is_empty() {
            return Err(Error::invalid(&self.folder, "the pictures are black: nothing to compress"));
        }
        lit.sort_by(f32::total_cmp);
        let most = lit[(lit.len() * 99 / 100).min(lit.len() - 1)];
        let bright = lit.iter().filter(|l| **l > 1e-3 * most);
        let (sum, count) = bright.fold((0.0, 0), |(s, n), l| (s + f64::from(l.min(most)), n + 1));
        Ok((sum / f64::from(count.max(1)) / 0.18) as f32)
    }
}

/// Whether a file holds light beyond white.
fn is_float(path: &Path) -> Result<bool> {
    Ok(match Format::of_file(path)? {
        Format::Exr | Format::Radiance | Format::Pfm => true,
        Format::Tiff => read_codes(path)?.is_linear(),
        _ => false,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use translume_image::{ExrOptions, Picture, Rgb32FImage, write_exr};

    /// A lamp in a mirror, 3000 times as bright as the rest, on half a per cent of the picture.
    #[test]
    fn a_highlight_does_not_decide_what_is_white() {
        let dir = tempfile::tempdir().unwrap();
        let white = |highlight: f32| {
            let shots: Vec<Shot> =
                (0..3).map(|i| Shot::new(dir.path().join(format!("{i}.exr")), [0.0, 0.0, 1.0])).collect();
            for shot in &shots {
                let light = |i: usize| match i {
                    ..1920 => 0.0,
                    1920..1930 => highlight,
                    _ => 0.4,
                };
                let pixels = Rgb32FImage::from_raw(64, 64, (0..3 * 64 * 64).map(|i| light(i / 3)).collect()).unwrap();
                write_exr(&shot.path, &Picture::new(pixels), &ExrOptions::default()).unwrap();
            }
            Stack::of(dir.path(), shots).unwrap().white
        };
        let (without, with) = (white(0.4), white(1200.0));
        assert!((without / (0.4 / 0.18) - 1.0).abs() < 0.01 && with < 1.05 * without, "{without} and {with}");
    }
}
