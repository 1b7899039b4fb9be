//! Typed access to parameter lists.

use super::lexer::{Parameter, Place, Values};
use crate::spectrum::{self, Quantity};
use crate::{Error, Result};
use glam::DVec3;
use translume_bxdf::{Rgb, metal_by_name};

/// The parameters of one directive.
pub(super) struct Parameters {
    pub(super) list: Vec<Parameter>,
    /// Where the directive stands.
    pub(super) place: Place,
}

impl Parameter {
    fn wrong(&self, wanted: &str) -> Error {
        self.place.invalid(format!("parameter {:?} is not {wanted}", self.name))
    }
}

impl Parameters {
    /// A parameter by name; it counts as used from now on.
    pub(super) fn get(&self, name: &str) -> Option<&Parameter> {
        let parameter = self.list.iter().find(|p| p.name == name)?;
        parameter.used.set(true);
        Some(parameter)
    }

    /// All numbers of a parameter.
    pub(super) fn numbers(&self, name: &str) -> Result<Option<&[f64]>> {
        let Some(p) = self.get(name) else { return Ok(None) };
        if let Values::Numbers(v) = &p.values { Ok(Some(v)) } else { Err(p.wrong("a list of numbers")) }
    }

    pub(super) fn number(&self, name: &str, default: f64) -> Result<f64> {
        match self.numbers(name)? {
            None => Ok(default),
            Some(&[v]) => Ok(v),
            Some(_) => Err(self.place.invalid(format!("parameter {name:?} is not one number"))),
        }
    }

    pub(super) fn integer(&self, name: &str, default: i64) -> Result<i64> {
        let v = self.number(name, default as f64)?;
        let whole = v.fract() == 0.0 && v.abs() < 9e15;
        if whole { Ok(v as i64) } else { Err(self.place.invalid(format!("parameter {name:?} is no whole number"))) }
    }

    pub(super) fn boolean(&self, name: &str, default: bool) -> Result<bool> {
        let Some(p) = self.get(name) else { return Ok(default) };
        match &p.values {
            Values::Bools(v) if v.len() == 1 => Ok(v[0]),
            // Older files put them in quotes.
            Values::Texts(t) if t.len() == 1 && (t[0] == "true" || t[0] == "false") => Ok(t[0] == "true"),
            _ => Err(p.wrong("true or false")),
        }
    }

    pub(super) fn text(&self, name: &str) -> Result<Option<&str>> {
        let Some(p) = self.get(name) else { return Ok(None) };
        match &p.values {
            Values::Texts(t) if t.len() == 1 => Ok(Some(&t[0])),
            _ => Err(p.wrong("one string")),
        }
    }

    pub(super) fn point(&self, name: &str, default: DVec3) -> Result<DVec3> {
        match self.numbers(name)? {
            None => Ok(default),
            Some(&[x, y, z]) => Ok(DVec3::new(x, y, z)),
            Some(_) => Err(self.place.invalid(format!("parameter {name:?} is not three numbers"))),
        }
    }

    /// Rows of `N` numbers.
    pub(super) fn rows<const N: usize>(&self, name: &str) -> Result<Option<Vec<[f32; N]>>> {
        let Some(values) = self.numbers(name)? else { return Ok(None) };
        let (rows, rest) = values.as_chunks::<N>();
        if !rest.is_empty() {
            let what = format!("parameter {name:?} has {} numbers, no multiple of {N}", values.len());
            return Err(self.place.invalid(what));
        }
        Ok(Some(rows.iter().map(|row| row.map(|v| v as f32)).collect()))
    }

    /// The texture a parameter names.
    pub(super) fn texture(&self, name: &str) -> Option<&str> {
        let p = self.get(name).filter(|p| p.kind == "texture")?;
        match &p.values {
            Values::Texts(t) if t.len() == 1 => Some(&t[0]),
            _ => None,
        }
    }

    /// A colour: `rgb`, `spectrum` (samples or a name), `blackbody`, or a number.
    pub(super) fn color(&self, name: &str, quantity: Quantity) -> Result<Option<Rgb>> {
        let Some(p) = self.get(name) else { return Ok(None) };
        let rgb = match (&p.values, p.kind.as_str()) {
            (Values::Numbers(v), "rgb" | "color") if v.len() == 3 => DVec3::new(v[0], v[1], v[2]).as_vec3(),
            (Values::Numbers(v), "float") if v.len() == 1 => Rgb::splat(v[0] as f32),
            (Values::Numbers(v), "blackbody") if v.len() == 1 && v[0] > 0.0 => {
                // Of luminance 1 in this format.
                let body = spectrum::black_body(v[0]);
                body / body.dot(Rgb::new(0.2126, 0.7152, 0.0722)).max(f32::MIN_POSITIVE)
            }
            (Values::Numbers(v), "spectrum") if v.len() % 2 == 0 && v.len() >= 2 => {
                let samples: Vec<(f64, f64)> = v.as_chunks::<2>().0.iter().map(|s| (s[0], s[1])).collect();
                if !samples.is_sorted_by(|a, b| a.0 < b.0) {
                    return Err(p.wrong("a spectrum of increasing wavelengths"));
                }
                spectrum::sampled(&samples, quantity)
            }
            (Values::Texts(t), "spectrum") if t.len() == 1 => named_spectrum(&t[0])
                .ok_or_else(|| p.place.unsupported(format!("the spectrum {:?} is not known; give samples", t[0])))?,
            _ => return Err(p.wrong("a colour")),
        };
        if rgb.is_finite() && rgb.min_element() >= 0.0 {
            Ok(Some(rgb))
        } else {
            Err(p.wrong("a colour of numbers ≥ 0"))
        }
    }
}

/// `metal-Au-eta`, `metal-Au-k` and glasses.
fn named_spectrum(name: &str) -> Option<Rgb> {
    if let Some(metal) = name.strip_prefix("metal-") {
        let (symbol, part) = metal.rsplit_once('-')?;
        let metal = metal_by_name(symbol).filter(|_| symbol != "none")?;
        return match part {
            "eta" => Some(metal.eta),
            "k" => Some(metal.k),
            _ => None,
        };
    }
    let glasses = [
        ("glass-BK7", 1.5168),
        ("glass-BAF10", 1.67),
        ("glass-FK51A", 1.4866),
        ("glass-LASF9", 1.8503),
        ("glass-F5", 1.6034),
        ("glass-F10", 1.6228),
        ("glass-F11", 1.6206),
        ("glass-SF5", 1.6727),
        ("glass-SF10", 1.7283),
        ("glass-SF11", 1.7847),
    ];
    glasses.iter().find(|g| g.0 == name).map(|g| Rgb::splat(g.1))
}
