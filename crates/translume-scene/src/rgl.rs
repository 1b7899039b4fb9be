//! `.bsdf` files of RGL's material database: a small container of arrays, and in them a [`Measured`] reflectance.
//!
//! Container (little-endian): "tensor_file\0", two bytes of version, u32 count of arrays; of each u16 length and name, u16 dimensions,
//! u8 type, u64 offset, u64 sizes. Colours are in `rgb`, or in `spectra` at `wavelengths` (nm), which become Rec. 709 under D65 here.

use crate::spectrum;
use crate::{Error, Result};
use std::collections::HashMap;
use std::path::Path;
use translume_bxdf::{Measured, MeasuredTables};
use translume_core::bilinear::BilinearPile;

type Found<T> = std::result::Result<T, String>;

/// Reads a file.
pub(crate) fn read(path: &Path) -> Result<Measured> {
    let bytes = crate::files::bytes(path)?;
    parse(&bytes).map_err(|what| Error::invalid(path, None, what))
}

/// An array of a file.
struct Field<'a> {
    shape: Vec<usize>,
    kind: u8,
    bytes: &'a [u8],
}

const FLOAT: u8 = 10;
const BYTE: u8 = 1;

impl Field<'_> {
    fn floats(&self, name: &str) -> Found<Vec<f32>> {
        if self.kind != FLOAT {
            return Err(format!("{name:?} does not hold 32-bit floats (type {})", self.kind));
        }
        Ok(self.bytes.as_chunks::<4>().0.iter().map(|&b| f32::from_le_bytes(b)).collect())
    }
}

fn parse(bytes: &[u8]) -> Found<Measured> {
    let fields = fields(bytes)?;
    let field = |name: &str| fields.get(name).ok_or_else(|| format!("there is no {name:?} in it"));
    let angles = |name| {
        let field = field(name)?;
        if field.shape.len() == 1 { field.floats(name) } else { Err(format!("{name:?} is not a list")) }
    };
    let (theta_i, phi_i) = (angles("theta_i")?, angles("phi_i")?);
    let incident = [phi_i.len(), theta_i.len()];
    // Slices by the leading sizes, which must be these, and rows and columns by the last two.
    let slices = |name: &str, values: Vec<f32>, leading: &[usize]| {
        let shape = &field(name)?.shape;
        match shape.strip_prefix(leading) {
            Some(&[rows, columns]) => BilinearPile::new(values, rows, columns),
            _ => None,
        }
        .ok_or_else(|| format!("{name:?} has the sizes {shape:?}, or values that are not finite"))
    };
    let pile = |name: &str, leading: &[usize]| slices(name, field(name)?.floats(name)?, leading);
    let rgb = match fields.get("rgb") {
        Some(_) => pile("rgb", &[&incident[..], &[3]].concat())?,
        None => {
            let wavelengths = angles("wavelengths")?;
            let pile = slices(
                "spectra",
                field("spectra")?.floats("spectra")?,
                &[&incident[..], &[wavelengths.len()]].concat(),
            )?;
            let (rows, columns) = pile.size();
            let values = to_rgb(pile.values(), rows * columns, &wavelengths)?;
            BilinearPile::new(values, rows, columns).ok_or("the spectra are not finite")?
        }
    };
    let jacobian = field("jacobian")?;
    let tables = MeasuredTables {
        ndf: pile("ndf", &[])?,
        sigma: pile("sigma", &[])?,
        vndf: pile("vndf", &incident)?,
        luminance: pile("luminance", &incident)?,
        rgb,
        jacobian: jacobian.kind == BYTE && jacobian.bytes.first().is_some_and(|&b| b != 0),
        theta_i,
        phi_i,
    };
    Measured::new(tables).map_err(str::to_owned)
}

/// The arrays by their names.
fn fields(bytes: &[u8]) -> Found<HashMap<String, Field<'_>>> {
    let mut rest = bytes.strip_prefix(b"tensor_file\0").ok_or("not a .bsdf file of RGL's material database")?;
    let mut take = |n: usize| {
        let (taken, after) = rest.split_at_checked(n).ok_or("the file is truncated")?;
        rest = after;
        Ok::<_, String>(taken)
    };
    let number = |b: &[u8]| b.iter().rev().fold(0_u64, |sum, &b| sum << 8 | u64::from(b));
    let version = take(2)?;
    if version != [1, 0] {
        return Err(format!("version {}.{} of such files is not read; 1.0 is", version[0], version[1]));
    }
    let count = number(take(4)?);
    let mut fields = HashMap::new();
    for _ in 0..count {
        let length = number(take(2)?) as usize;
        let name = String::from_utf8_lossy(take(length)?).into_owned();
        let dimensions = number(take(2)?) as usize;
        let kind = take(1)?[0];
        let offset = usize::try_from(number(take(8)?)).map_err(|_| "the file is truncated")?;
        let shape = take(8 * dimensions)?.as_chunks::<8>().0.iter().map(|&size| u64::from_le_bytes(size) as usize);
        let shape: Vec<usize> = shape.collect();
        let width = match kind {
            1 | 2 => 1,
            3 | 4 | 9 => 2,
            5 | 6 | FLOAT => 4,
            7 | 8 | 11 => 8,
            _ => return Err(format!("{name:?} has an unknown type ({kind})")),
        };
        let size = shape.iter().try_fold(width, |product: usize, &n| product.checked_mul(n));
        let end = size.and_then(|size| size.checked_add(offset));
        let body = end.and_then(|end| bytes.get(offset..end));
        let bytes = body.ok_or_else(|| format!("truncated: {name:?} of {shape:?} goes beyond the end"))?;
        fields.insert(name, Field { shape, kind, bytes });
    }
    Ok(fields)
}

/// Slices of one number a wavelength as slices of red, green and blue.
fn to_rgb(values: &[f32], slice: usize, wavelengths: &[f32]) -> Found<Vec<f32>> {
    let nm: Vec<f64> = wavelengths.iter().map(|&w| f64::from(w)).collect();
    if nm.is_empty() || !nm.is_sorted_by(|a, b| a < b) {
        return Err("the wavelengths do not increase".to_owned());
    }
    let weights = spectrum::reflectance_weights(&nm);
    let mut rgb = Vec::with_capacity(values.len() / nm.len() * 3);
    for spectra in values.chunks_exact(slice * nm.len()) {
        for c in 0..3 {
            let mixed = (0..slice).map(|i| {
                let terms = weights.iter().zip(spectra[i..].iter().step_by(slice));
                terms.map(|(w, &v)| w[c] * f64::from(v)).sum::<f64>() as f32
            });
            rgb.extend(mixed);
        }
    }
    Ok(rgb)
}
