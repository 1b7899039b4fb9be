//! What a header may ask for before anything is allocated, and which files are opened at all.
//!
//! Three guards. No picture has more than 2^31 samples. A file of a few bytes cannot hold gigabytes, so a header that
//! claims more than its codec could ever pack is damaged. And what a sound header asks for is held against a limit on
//! the decoded size ([`set_max_decoded_bytes`]): a few megabytes of one colour may well be gigabytes of pixels.

use crate::{Error, Result};
use std::fs::File;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// Most samples (pixels times channels) of one picture: 2^31, which is 700 Mpixel of RGB.
pub const MAX_SAMPLES: u64 = 1 << 31;

/// Decoded bytes that every file may ask for, however short it is, where no limit is set: 2 GiB.
pub const DEFAULT_DECODED_BYTES: u64 = 2 << 30;

/// Decoded bytes for each byte of a file that are always allowed, where no limit is set.
pub const DEFAULT_DECODED_RATIO: u64 = 64;

/// Bytes out per byte in that DEFLATE (1032), LZW (about 2700), JPEG (about 1000) and RLE (64) cannot exceed.
pub(crate) const MAX_RATIO: u64 = 4096;

/// What messages say to do about the limit, for programs to add how.
pub const RAISE_LIMIT: &str = "raise it if the file is to be trusted";

/// The limit that was set; 0 stands for none.
static MAX_DECODED: AtomicU64 = AtomicU64::new(0);

/// Sets how many bytes one picture may take, as 32-bit floats, for all pictures that this process reads from now on.
/// `None` goes back to the rule at the start: [`DEFAULT_DECODED_BYTES`], or [`DEFAULT_DECODED_RATIO`] times the size of
/// the file where that is more.
pub fn set_max_decoded_bytes(limit: Option<u64>) {
    MAX_DECODED.store(limit.map_or(0, |l| l.max(1)), Ordering::Relaxed);
}

/// The bytes that a picture in a file of `file_bytes` may take, as 32-bit floats.
pub fn max_decoded_bytes(file_bytes: u64) -> u64 {
    match MAX_DECODED.load(Ordering::Relaxed) {
        0 => file_bytes.saturating_mul(DEFAULT_DECODED_RATIO).max(DEFAULT_DECODED_BYTES),
        set => set,
    }
}

/// What a header says about its picture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Claim {
    /// Width and height.
    pub size: (u64, u64),
    /// Channels that are kept.
    pub channels: u64,
    /// Bits that a pixel takes in the file before it is packed.
    pub bits: u64,
    /// Bytes of the file.
    pub file_bytes: u64,
    /// Bytes out per byte in that the codec cannot exceed.
    pub max_ratio: u64,
}

impl Claim {
    /// Whether the header is plausible for its file.
    ///
    /// # Errors
    /// [`Error::Invalid`] without pixels or when the file is too short for the claim; [`Error::Unsupported`] above
    /// [`MAX_SAMPLES`].
    pub(crate) fn stored(&self, path: &Path) -> Result<()> {
        let &Self { size: (width, height), channels, bits, file_bytes, max_ratio } = self;
        if width == 0 || height == 0 {
            return Err(Error::invalid(path, format!("the header says {width} × {height} pixels: nothing to read")));
        }
        let count = width.checked_mul(height).and_then(|p| p.checked_mul(channels)).filter(|&n| n <= MAX_SAMPLES);
        if count.is_none() {
            let what =
                format!("{width} × {height} × {channels} samples are more than the limit of 2^31; split the picture");
            return Err(Error::unsupported(path, what));
        }
        // Below 2^31 pixels and some hundred bits each, the product fits.
        if (width * height).saturating_mul(bits) / 8 > file_bytes.saturating_mul(max_ratio).saturating_add(4096) {
            let what = format!(
                "{file_bytes} bytes cannot hold the {width} × {height} pixels of its header (truncated or damaged)"
            );
            return Err(Error::invalid(path, what));
        }
        Ok(())
    }

    /// The number of samples, if it is plausible and within the limit on decoded bytes.
    ///
    /// # Errors
    /// As [`Self::stored`]; [`Error::Unsupported`] above the limit.
    pub(crate) fn samples(&self, path: &Path) -> Result<usize> {
        self.stored(path)?;
        let &Self { size: (width, height), channels, file_bytes, .. } = self;
        let (wanted, limit) = (4 * width * height * channels.max(3), max_decoded_bytes(file_bytes));
        if wanted > limit {
            let what = format!(
                "{width} × {height} pixels take {} when decoded, from a file of {}; the limit is {}: {RAISE_LIMIT}",
                bytes_text(wanted),
                bytes_text(file_bytes),
                bytes_text(limit)
            );
            return Err(Error::unsupported(path, what));
        }
        usize::try_from(width * height * channels).map_err(|_| Error::unsupported(path, "too large for this machine"))
    }
}

/// `3.3 GB`, `512 B`.
fn bytes_text(bytes: u64) -> String {
    let mut value = bytes as f64;
    for unit in ["B", "kB", "MB"] {
        if value < 1000.0 {
            return if unit == "B" { format!("{bytes} B") } else { format!("{value:.1} {unit}") };
        }
        value /= 1000.0;
    }
    format!("{value:.1} GB")
}

/// Opens a file to be read as a picture; with its length.
///
/// # Errors
/// [`Error::Io`]; [`Error::Unsupported`] for folders, pipes and devices: what they hold has no end that can be known.
pub(crate) fn open(path: &Path) -> Result<(File, u64)> {
    // Asked before it is opened: a pipe that nobody writes to would hold the program for ever.
    let facts = std::fs::metadata(path).map_err(|e| Error::io(path, e))?;
    if facts.is_dir() {
        return Err(Error::unsupported(path, "a folder, not a picture"));
    }
    if !facts.is_file() {
        return Err(Error::unsupported(
            path,
            "not a plain file but a pipe or device; save the picture to a file first",
        ));
    }
    Ok((File::open(path).map_err(|e| Error::io(path, e))?, facts.len()))
}

/// A zeroed buffer of `len` values.
///
/// # Errors
/// [`Error::Unsupported`] when the machine refuses the memory.
pub(crate) fn buffer<T: Clone + Default>(path: &Path, len: usize) -> Result<Vec<T>> {
    // Asked first, because the zeroed allocation below, which the system makes for free, cannot fail politely.
    let probe = Vec::<T>::new().try_reserve_exact(len);
    probe.map_err(|_| Error::unsupported(path, "not enough memory for this picture"))?;
    Ok(vec![T::default(); len])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plausible_sizes_pass_and_bombs_do_not() {
        let check = |size, bits, file_bytes| {
            Claim { size, channels: 3, bits, file_bytes, max_ratio: MAX_RATIO }.samples(Path::new("a.png"))
        };
        assert_eq!(check((10_000, 10_000), 24, 1 << 20).unwrap(), 300_000_000); // 100 Mpixel, well packed
        assert!(matches!(check((10_000, 10_000), 24, 100), Err(Error::Invalid { .. })));
        assert!(matches!(check((1 << 31, 1 << 31), 24, u64::MAX), Err(Error::Unsupported { .. })));
        assert!(matches!(check((u64::MAX, 2), 24, u64::MAX), Err(Error::Unsupported { .. })));
        assert!(matches!(check((0, 5), 24, 100), Err(Error::Invalid { .. })));
        // 3.1 MB of one colour that are 3.2 GB of pixels; with the same pixels in 100 MB they are an ordinary picture.
        let bomb = check((16_400, 16_400), 48, 3_100_000).unwrap_err().to_string();
        assert!(bomb.contains("3.2 GB") && bomb.contains("3.1 MB") && bomb.contains("2.1 GB"), "{bomb}");
        assert!(check((16_400, 16_400), 48, 100_000_000).is_ok());
    }
}
