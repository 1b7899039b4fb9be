//! The layout that RelightLab writes and that RelightLab and OpenLIME show: `info.json` and coefficient planes of a fixed
//! basis, three to a JPEG file `plane_0.jpg`, `plane_1.jpg`, …
//!
//! A coefficient is (code/255 − bias) · scale. What the sum gives is shown as it is: display values, not light.
//! PTM and HSH in `rgb` and `lrgb` are read; RelightLab's own RBF and bilinear planes are not. Tiled layouts (deepzoom) are
//! not read.

use crate::Relighter;
use crate::basis::Basis;
use crate::field::{Angular, Field, Model};
use crate::lights::normalised;
use crate::texture::{Codec, Texture};
use crate::{Domain, Error, Result};
use serde::Deserialize;
use serde_json::json;
use std::path::Path;
use translume_image::{Codes, Samples, atomic, read_codes, write_jpeg};

#[derive(Deserialize)]
struct Info {
    width: usize,
    height: usize,
    #[serde(rename = "type")]
    kind: String,
    colorspace: String,
    nplanes: usize,
    materials: Vec<Material>,
}

#[derive(Deserialize)]
struct Material {
    scale: Vec<f32>,
    bias: Vec<f32>,
}

/// Reads the folder of RelightLab's output.
///
/// # Errors
/// [`Error::Invalid`] for what is damaged or does not fit together; [`Error::Unsupported`] for other bases.
pub fn import(folder: &Path) -> Result<Field> {
    let path = folder.join("info.json");
    let text = std::fs::read(&path).map_err(|e| Error::io(&path, e))?;
    let info: Info = serde_json::from_slice(&text)
        .map_err(|e| Error::invalid(&path, format!("not the description that RelightLab writes: {e}")))?;
    let unsupported = |what: String| Error::Unsupported { path: path.clone(), what };
    let basis = match (info.kind.as_str(), info.colorspace.as_str(), info.nplanes) {
        ("ptm", "rgb", 18) | ("ptm", "lrgb", 9) => Basis::Ptm,
        ("hsh", "rgb", 27) => Basis::Hsh,
        ("hsh", "rgb", 12) => Basis::Hsh4,
        (kind, colour, n) => {
            return Err(unsupported(format!(
                "{n} planes of type {kind} in {colour}: PTM and HSH in rgb, PTM in lrgb are read"
            )));
        }
    };
    let Some(material) =
        info.materials.first().filter(|m| m.scale.len() == info.nplanes && m.bias.len() == info.nplanes)
    else {
        return Err(Error::invalid(
            &path,
            format!("a scale and a bias are wanted for each of {} planes", info.nplanes),
        ));
    };
    if material.scale.iter().chain(&material.bias).any(|v| !v.is_finite()) {
        return Err(Error::invalid(&path, "scale or bias is no number"));
    }
    let files: Result<Vec<Vec<u8>>> =
        (0..info.nplanes / 3).map(|i| plane_file(folder, i, (info.width, info.height))).collect();
    let files = files?;
    let range = |plane: usize| {
        let (scale, bias) = (material.scale[plane], material.bias[plane]);
        (-bias * scale, (1.0 - bias) * scale)
    };
    let layers = if info.colorspace == "rgb" {
        let layer = |(i, data): (usize, Vec<u8>)| {
            let ranges = [0, 1, 2].map(|c| range(3 * i + c));
            Texture { codec: Codec::Rgb8, data, low: ranges.map(|r| r.0), high: ranges.map(|r| r.1) }
        };
        files.into_iter().enumerate().map(layer).collect()
    } else {
        lrgb(&files, &range, info.width)?
    };
    Ok(Field {
        model: Model::Imported,
        width: info.width,
        height: info.height,
        domain: Domain::Display,
        white: 1.0,
        layers,
        tiles: None,
        angular: Angular::Basis(basis),
    })
}

/// The codes of one file, interleaved.
fn plane_file(folder: &Path, i: usize, size: (usize, usize)) -> Result<Vec<u8>> {
    let path = ["jpg", "png"].map(|e| folder.join(format!("plane_{i}.{e}"))).into_iter().find(|p| p.is_file());
    let path = path.ok_or_else(|| Error::invalid(folder, format!("plane_{i}.jpg is missing")))?;
    match read_codes(&path)? {
        Codes { width, height, samples: Samples::U8(v), .. } if (width, height) == size => Ok(v),
        codes => {
            let what = format!(
                "{} × {} pixels where info.json says {} × {} of 8 bits",
                codes.width, codes.height, size.0, size.1
            );
            Err(Error::invalid(&path, what))
        }
    }
}

/// A colour times six coefficients of luminance: multiplied out.
fn lrgb(files: &[Vec<u8>], range: &dyn Fn(usize) -> (f32, f32), width: usize) -> Result<Vec<Texture>> {
    let value = |plane: usize, texel: usize| {
        let (low, high) = range(plane);
        low + f32::from(files[plane / 3][3 * texel + plane % 3]) / 255.0 * (high - low)
    };
    let texels = files[0].len() / 3;
    (0..6)
        .map(|term| {
            let planes = [0, 1, 2].map(|c| (0..texels).map(|t| value(c, t) * value(3 + term, t)).collect::<Vec<f32>>());
            Texture::encode(Codec::Rgb8, &[&planes[0], &planes[1], &planes[2]], width)
        })
        .collect()
}

/// Writes `field` as RelightLab does, in `basis`: refitted to it under directions of the upper hemisphere where
/// it is not a sum of that basis already. Returns the largest root mean square error of the fit, on a display.
///
/// # Errors
/// [`Error::Picture`] of writing; [`Error::Io`].
pub fn export(field: &Field, basis: Basis, folder: &Path, quality: u8) -> Result<f64> {
    let (planes, error) = coefficients(field, basis)?;
    let pixels = field.width * field.height;
    let (mut scale, mut bias, mut files) = (Vec::new(), Vec::new(), Vec::new());
    for (i, rgb) in planes.chunks(3 * pixels).enumerate() {
        let channels: Vec<&[f32]> = rgb.chunks(pixels).collect();
        let texture = Texture::encode(Codec::Rgb8, &channels, field.width)?;
        for c in 0..3 {
            let range = texture.high[c] - texture.low[c];
            scale.push(range);
            bias.push(-texture.low[c] / range);
        }
        files.push((format!("plane_{i}.jpg"), texture.data));
    }
    let info = json!({
        "width": field.width,
        "height": field.height,
        "format": "jpg",
        "type": if basis == Basis::Ptm { "ptm" } else { "hsh" },
        "colorspace": "rgb",
        "nplanes": 3 * basis.terms(),
        "quality": quality,
        "materials": [{ "scale": scale, "bias": bias }],
    });
    atomic::write_folder(folder, is_own, |new| {
        for (name, codes) in &files {
            write_jpeg(&new.join(name), (field.width, field.height), codes, quality)?;
        }
        atomic::write_bytes(&new.join("info.json"), info.to_string().as_bytes())
    })?;
    Ok(error)
}

/// Names of files that an older export consists of: with more planes than the new one has, some would stay.
fn is_own(name: &str) -> bool {
    let plane = || name.strip_prefix("plane_")?.strip_suffix(".jpg")?.parse::<u32>().ok();
    name == "info.json" || plane().is_some()
}

/// Planes by term and channel, and the error of the fit.
fn coefficients(field: &Field, basis: Basis) -> Result<(Vec<f32>, f64)> {
    let pixels = field.width * field.height;
    if field.angular == Angular::Basis(basis) && field.domain == Domain::Display {
        let planes: Result<Vec<_>> = field.layers.iter().map(|l| l.values(field.width, field.height)).collect();
        return Ok((planes?.into_iter().flatten().flatten().collect(), 0.0));
    }
    let relighter = Relighter::new(field)?;
    let lights = directions(field);
    let fit = basis
        .fit(&lights)
        .ok_or_else(|| Error::Parameter(format!("{} lights do not determine {basis:?}", lights.len())))?;
    let shown = |light: [f32; 3]| {
        let mut values = relighter.picture(&relighter.mix(light));
        values.iter_mut().for_each(|v| *v = Domain::Display.value(*v / field.white).min(1.0));
        values
    };
    let mut planes = vec![0.0f32; 3 * basis.terms() * pixels];
    for (l, light) in lights.iter().enumerate() {
        let picture = shown(*light);
        for (out, plane) in planes.chunks_mut(pixels).enumerate() {
            let w = fit[(out / 3, l)] as f32;
            plane.iter_mut().zip(picture.iter().skip(out % 3).step_by(3)).for_each(|(p, v)| *p += w * v);
        }
    }
    let mut worst = 0.0f64;
    for light in lights.iter().step_by(lights.len().div_ceil(12)) {
        let (picture, weights) = (shown(*light), basis.at(*light));
        let sum = |t: usize, c: usize| {
            weights.iter().enumerate().map(|(j, w)| w * planes[(3 * j + c) * pixels + t]).sum::<f32>()
        };
        let squares = picture.iter().enumerate().map(|(i, v)| f64::from(sum(i / 3, i % 3) - v).powi(2));
        worst = worst.max((squares.sum::<f64>() / picture.len() as f64).sqrt());
    }
    Ok((planes, worst))
}

/// The stack's lights above the horizon; a spread of directions where the field does not know lights.
fn directions(field: &Field) -> Vec<[f32; 3]> {
    let above: Vec<[f32; 3]> = field.lights().iter().copied().filter(|l| l[2] > 0.0).collect();
    if !above.is_empty() {
        return above;
    }
    let spread = |i: usize| {
        let z = 1.0 - 0.9 * (i as f32 + 0.5) / 60.0;
        let (sin, cos) = (2.399_963_2 * i as f32).sin_cos();
        let s = (1.0 - z * z).sqrt();
        normalised([s * cos, s * sin, z])
    };
    (0..60).filter_map(spread).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A field of PTM planes that are smooth, so that JPEG keeps them.
    fn field() -> Field {
        let (w, h) = (24, 16);
        let plane = |term: usize, c: usize| -> Vec<f32> {
            let at = |i: usize| {
                0.2 + 0.1 * (0.2 * (i % w) as f32 + term as f32).sin() + 0.02 * (i / w) as f32 * c as f32 / 3.0
            };
            (0..w * h).map(|i| at(i) * if term == 0 { 1.0 } else { 0.3 }).collect()
        };
        let layer = |term| {
            let planes = [0, 1, 2].map(|c| plane(term, c));
            Texture::encode(Codec::Rgb8, &[&planes[0], &planes[1], &planes[2]], w).unwrap()
        };
        Field {
            model: Model::Ptm,
            width: w,
            height: h,
            domain: Domain::Display,
            white: 1.0,
            layers: (0..6).map(layer).collect(),
            tiles: None,
            angular: Angular::Basis(Basis::Ptm),
        }
    }

    fn shown(field: &Field, light: [f32; 3]) -> Vec<f32> {
        let relighter = Relighter::new(field).unwrap();
        relighter.picture(&relighter.mix(light)).iter().map(|v| Domain::Display.value(*v)).collect()
    }

    #[test]
    fn what_is_exported_is_imported_again() {
        let dir = tempfile::tempdir().unwrap();
        for basis in [Basis::Ptm, Basis::Hsh] {
            let error = export(&field(), basis, dir.path(), 95).unwrap();
            let back = import(dir.path()).unwrap();
            assert_eq!((back.width, back.angular.clone()), (24, Angular::Basis(basis)));
            let light = normalised([0.3, -0.2, 0.8]).unwrap();
            let (a, b) = (shown(&field(), light), shown(&back, light));
            let rms = (a.iter().zip(&b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>() / a.len() as f32).sqrt();
            assert!(rms < 0.02 && error < 0.02, "{basis:?}: {rms} {error}");
        }
    }

    #[test]
    fn descriptions_that_do_not_fit_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        export(&field(), Basis::Ptm, dir.path(), 90).unwrap();
        let path = dir.path().join("info.json");
        let text = std::fs::read_to_string(&path).unwrap();
        let error = |text: &str| {
            std::fs::write(&path, text).unwrap();
            import(dir.path()).unwrap_err().to_string()
        };
        assert!(error(&text.replace("\"ptm\"", "\"rbf\"")).contains("of type rbf"));
        assert!(error(&text.replace("18", "27")).contains("27 planes of type ptm"));
        assert!(
            error(&text.replace("\"width\":24", "\"width\":25"))
                .contains("24 × 16 pixels where info.json says 25 × 16")
        );
        assert!(error("{}").contains("not the description"));
        std::fs::remove_file(dir.path().join("plane_4.jpg")).unwrap();
        assert!(error(&text).contains("plane_4.jpg is missing"));
    }
}
