//! Radiance HDR (`.hdr`, `.pic`): RGBE and XYZE, plain, old and new run lengths, every orientation; EXPOSURE, COLORCORR
//! and PRIMARIES are honoured. Source: Ward, "Real Pixels" (Graphics Gems II) and the Radiance file format notes.

use crate::limits::{self, Claim};
use crate::orient::Orientation;
use crate::raster::{Raster, Transfer};
use crate::{Error, Metadata, Picture, Result, Samples, atomic};
use std::io::Write;
use std::path::Path;

pub(crate) fn read(file: &[u8], path: &Path) -> Result<Raster> {
    let header = header(file).ok_or_else(|| Error::invalid(path, "damaged Radiance header"))?;
    // A run packs at most 127 bytes into 2.
    let size = (header.columns as u64, header.rows as u64);
    let claim = Claim { size, channels: 3, bits: 32, file_bytes: file.len() as u64, max_ratio: limits::MAX_RATIO };
    let count = claim.samples(path)?;
    let mut samples = limits::buffer::<f32>(path, count)?;
    let mut rest = header.pixels;
    let mut line = vec![[0u8; 4]; header.columns];
    let mut packed = false;
    for (y, row) in samples.chunks_exact_mut(3 * header.columns).enumerate() {
        packed = read_line(&mut rest, &mut line, packed).ok_or_else(|| match rest.len() {
            0..4 => Error::invalid(path, "the Radiance file ends before its picture does (truncated)"),
            _ => Error::invalid(path, format!("row {y} of the Radiance file is damaged; copy the file again")),
        })?;
        for (rgb, rgbe) in row.as_chunks_mut::<3>().0.iter_mut().zip(&line) {
            *rgb = decode(*rgbe, header.divide_by);
        }
    }
    if header.xyz {
        let to_rgb = crate::colour::Space::REC709.xyz_to_rgb_from_equal_energy();
        samples.as_chunks_mut::<3>().0.iter_mut().for_each(|p| *p = crate::colour::apply(&to_rgb, *p));
    }
    Ok(Raster {
        width: header.columns,
        height: header.rows,
        channels: 3,
        samples: Samples::F32(samples),
        transfer: Transfer::Power(1.0),
        associated: true,
        orientation: header.orientation,
        metadata: Metadata { chromaticities: header.primaries.filter(|_| !header.xyz), ..Metadata::default() },
    })
}

struct Header<'a> {
    xyz: bool,
    columns: usize,
    rows: usize,
    orientation: Orientation,
    /// Product of EXPOSURE and COLORCORR: what the pixels were multiplied by.
    divide_by: [f32; 3],
    primaries: Option<[[f32; 2]; 4]>,
    pixels: &'a [u8],
}

fn header(file: &[u8]) -> Option<Header<'_>> {
    let mut rest = file;
    let mut line = || {
        let end = rest.iter().take(1 << 16).position(|&b| b == b'\n')?;
        let text = String::from_utf8_lossy(&rest[..end]).trim_end_matches('\r').to_owned();
        rest = &rest[end + 1..];
        Some(text)
    };
    let mut divide_by = [1.0f32; 3];
    let (mut xyz, mut primaries) = (false, None);
    line()?; // #?RADIANCE or #?RGBE
    loop {
        let text = line()?;
        if text.is_empty() {
            break;
        }
        let Some((key, value)) = text.split_once('=') else { continue };
        let numbers: Vec<f32> = value.split_whitespace().filter_map(|w| w.parse().ok()).collect();
        match (key.trim(), numbers.as_slice()) {
            ("FORMAT", _) => match value.trim() {
                "32-bit_rle_rgbe" => {}
                "32-bit_rle_xyze" => xyz = true,
                _ => return None,
            },
            ("EXPOSURE", &[e]) if e.is_normal() => divide_by = divide_by.map(|d| d * e),
            ("COLORCORR", &[r, g, b]) if r.is_normal() && g.is_normal() && b.is_normal() => {
                divide_by = [divide_by[0] * r, divide_by[1] * g, divide_by[2] * b];
            }
            ("PRIMARIES", &[a, b, c, d, e, f, g, h]) => primaries = Some([[a, b], [c, d], [e, f], [g, h]]),
            _ => {}
        }
    }
    let resolution = line()?;
    let (columns, rows, orientation) = size(&resolution)?;
    Some(Header { xyz, columns, rows, orientation, divide_by, primaries, pixels: rest })
}

/// Stored row length, number of rows and how they lie, of a line such as `-Y 480 +X 640`.
fn size(line: &str) -> Option<(usize, usize, Orientation)> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let &[major, rows, minor, columns] = words.as_slice() else { return None };
    // The first axis runs over the rows of the file. Radiance counts Y upwards, so -Y starts at the top.
    let orientation = match (major, minor) {
        ("-Y", "+X") => 1,
        ("-Y", "-X") => 2,
        ("+Y", "-X") => 3,
        ("+Y", "+X") => 4,
        ("+X", "-Y") => 5,
        ("-X", "-Y") => 6,
        ("-X", "+Y") => 7,
        ("+X", "+Y") => 8,
        _ => return None,
    };
    Some((columns.parse().ok()?, rows.parse().ok()?, Orientation::from_exif(orientation)))
}

/// One row of RGBE pixels, in any of the three codings; whether it has run lengths of the new kind. Where the row before
/// (`packed`) has them, this one has them too: programs choose by the width of the picture.
fn read_line(rest: &mut &[u8], line: &mut [[u8; 4]], packed: bool) -> Option<bool> {
    let n = line.len();
    // A pixel 2 2 b with b below 128 is none: the largest of three is 128 at least.
    if let &[2, 2, high @ 0..128, low, ..] = *rest
        && (8..32768).contains(&n)
    {
        if (usize::from(high) << 8 | usize::from(low)) != n {
            return None;
        }
        *rest = &rest[4..];
        return (0..4).try_for_each(|channel| read_run_lengths(rest, line, channel)).map(|()| true);
    }
    if packed {
        return None;
    }
    // Plain pixels; 1 1 1 n repeats the one before, and repeats in a row count in base 256.
    let (mut x, mut shift) = (0, 0);
    while x < n {
        let (pixel, tail) = rest.split_first_chunk::<4>()?;
        *rest = tail;
        if pixel[..3] == [1, 1, 1] && x > 0 {
            let count = usize::from(pixel[3]).checked_shl(shift)?;
            let end = x.checked_add(count).filter(|&e| e <= n)?;
            let before = line[x - 1];
            line[x..end].fill(before);
            x = end;
            shift += 8;
            if shift > 24 {
                return None;
            }
        } else {
            line[x] = *pixel;
            x += 1;
            shift = 0;
        }
    }
    Some(false)
}

/// One channel of a row as runs (length above 128, then a value) and literals.
fn read_run_lengths(rest: &mut &[u8], line: &mut [[u8; 4]], channel: usize) -> Option<()> {
    let mut x = 0;
    while x < line.len() {
        let (&count, tail) = rest.split_first()?;
        let (length, repeats) =
            if count > 128 { (usize::from(count - 128), true) } else { (usize::from(count), false) };
        let target = line.get_mut(x..x + length).filter(|t| !t.is_empty())?;
        if repeats {
            let (&value, tail) = tail.split_first()?;
            target.iter_mut().for_each(|p| p[channel] = value);
            *rest = tail;
        } else {
            let (values, tail) = tail.split_at_checked(length)?;
            target.iter_mut().zip(values).for_each(|(p, &v)| p[channel] = v);
            *rest = tail;
        }
        x += length;
    }
    Some(())
}

fn decode([r, g, b, e]: [u8; 4], divide_by: [f32; 3]) -> [f32; 3] {
    if e == 0 {
        return [0.0; 3];
    }
    // v · 2^(e-136) without the half step some readers add, so that what we write reads back the same.
    let scale = (f64::from(e) - 136.0).exp2();
    let value = |v: u8, d: f32| (f64::from(v) * scale / f64::from(d)) as f32;
    [value(r, divide_by[0]), value(g, divide_by[1]), value(b, divide_by[2])]
}

fn encode(rgb: [f32; 3]) -> [u8; 4] {
    // Negative and NaN have no code: black. The largest code stands for everything above it.
    let rgb = rgb.map(|v| f64::from(v.clamp(0.0, 1.69e38)).max(0.0));
    let largest = rgb[0].max(rgb[1]).max(rgb[2]);
    if largest < 1e-38 {
        return [0; 4];
    }
    let mut exponent = largest.log2().floor() as i32 + 1;
    if (largest * f64::from(8 - exponent).exp2()).round() > 255.0 {
        exponent += 1; // rounding up would spill over the mantissa
    }
    let scale = f64::from(8 - exponent).exp2();
    let [r, g, b] = rgb.map(|v| (v * scale).round() as u8);
    [r, g, b, (exponent + 128) as u8]
}

/// Writes RGBE with run lengths, Rec. 709 primaries unless the metadata says otherwise.
///
/// # Errors
/// [`Error::Io`].
pub fn write_hdr(path: &Path, picture: &Picture) -> Result<()> {
    let (width, height) = picture.pixels.dimensions();
    warn_negative(path, picture);
    atomic::write(path, |f| {
        let mut put = |bytes: &[u8]| f.write_all(bytes).map_err(|e| Error::io(path, e));
        put(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n")?;
        if let Some(c) = picture.metadata.chromaticities {
            let numbers: Vec<String> = c.iter().flatten().map(ToString::to_string).collect();
            put(format!("PRIMARIES={}\n", numbers.join(" ")).as_bytes())?;
        }
        put(format!("\n-Y {height} +X {width}\n").as_bytes())?;
        for row in picture.pixels.as_raw().chunks_exact(3 * width as usize) {
            let line: Vec<[u8; 4]> = row.as_chunks::<3>().0.iter().map(|p| encode(*p)).collect();
            put(&pack_line(&line))?;
        }
        Ok(())
    })
}

/// Says how many pixels lose a negative component that is more than half a step of their codes.
fn warn_negative(path: &Path, picture: &Picture) {
    let lost = |p: &&image::Rgb<f32>| {
        let largest = p.0.iter().fold(0.0f32, |m, v| m.max(*v));
        p.0.iter().any(|v| *v < -largest / 256.0 && *v < -1e-38)
    };
    let count = picture.pixels.pixels().filter(lost).count();
    if count > 0 {
        log::warn!(
            "{}: {count} pixels have negative components (colours outside of the primaries), which Radiance files cannot \
             hold: stored as 0",
            path.display()
        );
    }
}

fn pack_line(line: &[[u8; 4]]) -> Vec<u8> {
    let n = line.len();
    if !(8..32768).contains(&n) {
        return line.as_flattened().to_vec();
    }
    let mut out = vec![2, 2, (n >> 8) as u8, n as u8];
    for channel in 0..4 {
        let value = |x: usize| line[x][channel];
        let run = |x: usize| (x..n.min(x + 127)).take_while(|&i| value(i) == value(x)).count();
        let mut x = 0;
        while x < n {
            let length = run(x);
            if length >= 3 {
                out.extend([128 + length as u8, value(x)]);
                x += length;
                continue;
            }
            let end = (x + 1..n.min(x + 128)).find(|&i| run(i) >= 3).unwrap_or(n.min(x + 128));
            out.push((end - x) as u8);
            out.extend((x..end).map(value));
            x = end;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_text(header: &str, pixels: &[u8]) -> Result<Raster> {
        read(&[header.as_bytes(), pixels].concat(), Path::new("a.hdr"))
    }

    fn floats(raster: Raster) -> Vec<f32> {
        let (codes, _) = raster.into_codes();
        (0..3 * codes.width * codes.height).map(|i| codes.unit(i)).collect()
    }

    #[test]
    fn exposure_and_colour_correction_are_undone() {
        let header =
            "#?RGBE\n# made by hand\nEXPOSURE=2\nEXPOSURE=4\nCOLORCORR=1 2 1\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n";
        // 128 · 2^(129 − 136) = 1.
        assert_eq!(floats(read_text(header, &[128, 128, 64, 129]).unwrap()), [0.125, 0.0625, 0.0625]);
    }

    #[test]
    fn old_run_lengths_count_in_base_256() {
        let header = "#?RADIANCE\n\n-Y 1 +X 260\n";
        let got = floats(read_text(header, &[128, 0, 0, 129, 1, 1, 1, 3, 1, 1, 1, 1]).unwrap());
        assert!(got.as_chunks::<3>().0.iter().all(|p| *p == [1.0, 0.0, 0.0]));
        assert!(read_text(header, &[128, 0, 0, 129, 1, 1, 1, 4, 1, 1, 1, 1]).is_err());
    }

    #[test]
    fn every_order_of_pixels_is_turned_upright() {
        let pixel = |v: u8| [v, 0, 0, 136];
        // Upright: 10 20 / 30 40.
        for (order, stored) in [
            ("-Y 2 +X 2", [10, 20, 30, 40]),
            ("+Y 2 +X 2", [30, 40, 10, 20]),
            ("-Y 2 -X 2", [20, 10, 40, 30]),
            ("+Y 2 -X 2", [40, 30, 20, 10]),
            ("+X 2 -Y 2", [10, 30, 20, 40]),
            ("-X 2 -Y 2", [20, 40, 10, 30]),
            ("+X 2 +Y 2", [30, 10, 40, 20]),
            ("-X 2 +Y 2", [40, 20, 30, 10]),
        ] {
            let got = floats(read_text(&format!("#?RADIANCE\n\n{order}\n"), &stored.map(pixel).concat()).unwrap());
            assert_eq!([got[0], got[3], got[6], got[9]], [10.0, 20.0, 30.0, 40.0], "{order}");
        }
    }

    #[test]
    fn a_damaged_row_is_an_error_with_its_number() {
        let path = std::env::temp_dir().join(format!("translume-rows-{}.hdr", std::process::id()));
        let picture = Picture::new(image::Rgb32FImage::from_fn(20, 3, |x, y| image::Rgb([x as f32, y as f32, 1.0])));
        write_hdr(&path, &picture).unwrap();
        let file = std::fs::read(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        assert!(read(&file, &path).is_ok());
        let rows: Vec<usize> = (0..file.len() - 3).filter(|&i| file[i..i + 4] == [2, 2, 0, 20]).collect();
        assert_eq!(rows.len(), 3);
        for byte in 0..4 {
            let mut damaged = file.clone();
            damaged[rows[1] + byte] ^= 0x41;
            let error = read(&damaged, Path::new("a.hdr")).unwrap_err().to_string();
            assert!(error.contains("row 1") && error.contains("damaged"), "{error}");
        }
        let error = read(&file[..rows[2]], Path::new("a.hdr")).unwrap_err().to_string();
        assert!(error.contains("truncated"), "{error}");
    }

    #[test]
    fn xyze_becomes_rgb_and_equal_energy_white() {
        let header = "#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n";
        let got = floats(read_text(header, &[128, 128, 128, 129]).unwrap());
        assert!(got.iter().all(|v| (v - 1.0).abs() < 1e-3), "{got:?}");
    }

    #[test]
    fn codes_go_round() {
        for rgb in [[1.0, 0.5, 0.25], [1e-20, 0.0, 0.0], [255.9, 1.0, 3.0], [0.999, 0.999, 0.999], [1.69e38, 1e36, 0.0]]
        {
            let back = decode(encode(rgb), [1.0; 3]);
            let largest = rgb.iter().fold(0.0f32, |m, v| m.max(*v));
            assert!((0..3).all(|c| (back[c] - rgb[c]).abs() <= largest / 255.0), "{rgb:?} became {back:?}");
        }
        assert_eq!(encode([f32::NAN, -1.0, 0.0]), [0; 4]);
        assert_eq!(decode(encode([f32::INFINITY, 0.0, 0.0]), [1.0; 3])[0].log2().round(), 127.0);
    }
}
