//! What a header may ask for before anything is allocated.
//!
//! Two guards: an absolute one (no picture of more than 2^31 samples), and a relative one: a file of a few bytes cannot
//! hold gigabytes, so a header that claims more than its codec could ever pack is damaged, whatever the machine has.

use crate::{Error, Result};
use std::path::Path;

/// Most samples (pixels times channels) of one picture: 2^31, which is 700 Mpixel of RGB.
pub const MAX_SAMPLES: u64 = 1 << 31;

/// Bytes out per byte in that DEFLATE (1032), LZW (about 2700), JPEG (about 1000) and RLE (64) cannot exceed.
pub(crate) const MAX_RATIO: u64 = 4096;

/// The number of samples of a `width × height × channels` picture, if it is plausible for a file of `file_bytes` that
/// stores `bits` a pixel, compressed by `max_ratio` at most.
///
/// # Errors
/// [`Error::Invalid`] without pixels or when the file is too short for the claim; [`Error::Unsupported`] above
/// [`MAX_SAMPLES`].
pub(crate) fn samples(
    path: &Path,
    (width, height): (u64, u64),
    channels: u64,
    bits: u64,
    file_bytes: u64,
    max_ratio: u64,
) -> Result<usize> {
    if width == 0 || height == 0 {
        return Err(Error::invalid(path, format!("the header says {width} × {height} pixels: nothing to read")));
    }
    let count = width.checked_mul(height).and_then(|p| p.checked_mul(channels)).filter(|&n| n <= MAX_SAMPLES);
    let Some(count) = count else {
        return Err(Error::unsupported(
            path,
            format!("{width} × {height} × {channels} samples are more than the limit of 2^31; split the picture"),
        ));
    };
    // Below 2^31 pixels and some hundred bits each, the product fits.
    if (width * height).saturating_mul(bits) / 8 > file_bytes.saturating_mul(max_ratio).saturating_add(4096) {
        return Err(Error::invalid(
            path,
            format!(
                "{file_bytes} bytes cannot hold the {width} × {height} pixels of its header (truncated or damaged)"
            ),
        ));
    }
    usize::try_from(count).map_err(|_| Error::unsupported(path, "too large for this machine"))
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
        let check = |size, bits, file| samples(Path::new("a.png"), size, 3, bits, file, MAX_RATIO);
        assert_eq!(check((10_000, 10_000), 24, 1 << 20).unwrap(), 300_000_000); // 100 Mpixel, well packed
        assert!(matches!(check((10_000, 10_000), 24, 100), Err(Error::Invalid { .. })));
        assert!(matches!(check((1 << 31, 1 << 31), 24, u64::MAX), Err(Error::Unsupported { .. })));
        assert!(matches!(check((u64::MAX, 2), 24, u64::MAX), Err(Error::Unsupported { .. })));
        assert!(matches!(check((0, 5), 24, 100), Err(Error::Invalid { .. })));
    }
}
