//! Mitsuba's `.vol` grids, version 3: "VOL", the byte 3, then little-endian: the encoding (1: 32-bit floats), sizes x, y, z,
//! channels, a box of six floats, and the values, channels together, x fastest.

use crate::medium::Grid;
use crate::{Error, Result};
use glam::DVec3;
use std::path::Path;
use std::sync::Arc;

/// A grid with the box its file gives.
#[derive(Debug)]
pub(crate) struct Loaded {
    pub(crate) grid: Arc<Grid>,
    pub(crate) lo: DVec3,
    pub(crate) hi: DVec3,
    /// Values that were negative or not finite and count as 0.
    pub(crate) bad: usize,
}

const HEAD: usize = 48;

pub(crate) fn read(path: &Path) -> Result<Loaded> {
    let bytes = crate::files::bytes(path)?;
    parse(&bytes).map_err(|what| Error::invalid(path, None, what))
}

fn parse(bytes: &[u8]) -> std::result::Result<Loaded, String> {
    let Some((head, body)) = bytes.split_first_chunk::<HEAD>() else {
        return Err("the file is truncated: a .vol file begins with 48 bytes".to_owned());
    };
    if &head[..4] != b"VOL\x03" {
        return Err("not a .vol file of version 3".to_owned());
    }
    let int = |i: usize| i32::from_le_bytes([head[i], head[i + 1], head[i + 2], head[i + 3]]);
    let float = |i: usize| f64::from(f32::from_bits(int(i) as u32));
    if int(4) != 1 {
        return Err(format!("encoding {} of .vol is not read; 1 (32-bit floats) is", int(4)));
    }
    let positive = |i: usize| usize::try_from(int(i)).ok().filter(|&n| n > 0);
    let (Some(x), Some(y), Some(z), Some(channels)) = (positive(8), positive(12), positive(16), positive(20)) else {
        return Err("the grid's sizes are not above 0".to_owned());
    };
    if channels != 1 && channels != 3 {
        return Err(format!("grids have 1 channel or 3, not {channels}"));
    }
    let count = x.checked_mul(y).and_then(|n| n.checked_mul(z)).and_then(|n| n.checked_mul(channels));
    let wanted = count.and_then(|n| n.checked_mul(4));
    if wanted.is_none_or(|n| n > body.len()) {
        return Err(format!("truncated: {x} × {y} × {z} × {channels} values do not fit into {} bytes", body.len()));
    }
    let mut bad = 0;
    let values = body.as_chunks::<4>().0[..wanted.unwrap_or(0) / 4].iter().map(|&raw| {
        let v = f32::from_le_bytes(raw);
        let good = v.is_finite() && v >= 0.0;
        bad += usize::from(!good);
        if good { v } else { 0.0 }
    });
    let values = values.collect();
    let (lo, hi) = (DVec3::new(float(24), float(28), float(32)), DVec3::new(float(36), float(40), float(44)));
    if !(lo.is_finite() && hi.is_finite() && lo.cmplt(hi).all()) {
        return Err(format!("the grid's box from {lo} to {hi} is empty"));
    }
    Ok(Loaded { grid: Arc::new(Grid { size: [x, y, z], channels, values }), lo, hi, bad })
}

/// The bytes of a grid of `channels` numbers a cell, x fastest, in a box.
pub(crate) fn bytes(size: [usize; 3], channels: usize, [lo, hi]: [DVec3; 2], values: &[f32]) -> Vec<u8> {
    let mut bytes = b"VOL\x03".to_vec();
    let sizes = [1, size[0], size[1], size[2], channels];
    bytes.extend(sizes.iter().flat_map(|&n| (n as i32).to_le_bytes()));
    let corners = lo.as_vec3().to_array().into_iter().chain(hi.as_vec3().to_array());
    bytes.extend(corners.chain(values.iter().copied()).flat_map(f32::to_le_bytes));
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(size: [i32; 4], values: &[f32]) -> Vec<u8> {
        let mut bytes = b"VOL\x03".to_vec();
        bytes.extend([1].iter().chain(&size).flat_map(|v| v.to_le_bytes()));
        bytes.extend([-1.0_f32, -1.0, -1.0, 1.0, 1.0, 1.0].iter().chain(values).flat_map(|v| v.to_le_bytes()));
        bytes
    }

    #[test]
    fn values_are_read_and_bad_ones_counted() {
        let loaded = parse(&file([2, 1, 1, 1], &[0.5, f32::NAN])).unwrap();
        assert_eq!((loaded.grid.values.as_slice(), loaded.bad), ([0.5, 0.0].as_slice(), 1));
        assert_eq!(loaded.lo, DVec3::splat(-1.0));
    }

    #[test]
    fn what_is_written_is_read() {
        let values: Vec<f32> = (0..24).map(|i| i as f32 / 8.0).collect();
        let corners = [DVec3::new(-1.0, 0.0, 2.0), DVec3::new(3.0, 4.0, 5.5)];
        let loaded = parse(&bytes([4, 2, 1], 3, corners, &values)).unwrap();
        assert_eq!((loaded.grid.size, loaded.grid.channels, &loaded.grid.values), ([4, 2, 1], 3, &values));
        assert_eq!([loaded.lo, loaded.hi], corners);
    }

    #[test]
    fn damaged_files_are_refused() {
        let good = file([2, 2, 2, 3], &[1.0; 24]);
        assert!(parse(&good).is_ok());
        for end in 0..good.len() {
            assert!(parse(&good[..end]).is_err(), "cut at {end}");
        }
        assert!(parse(&file([i32::MAX, i32::MAX, i32::MAX, 3], &[])).unwrap_err().contains("truncated"));
        assert!(parse(&file([-1, 2, 2, 1], &[])).is_err());
    }
}
