//! From elements to objects: plugins with typed properties, whose names have one spelling for all dialects.
//!
//! Dialects: 0.4–0.6 write `toWorld`, `intIOR`, `<lookAt>`, `<srgb>`, `<blackbody>`; 2.x and 3.x write `to_world`,
//! `int_ior`, `<lookat>`. Names are taken to the newer spelling whatever the version says.

use super::tree::{Element, Place, find, read_text};
use crate::Result;
use crate::spectrum::{self, Quantity};
use glam::{DAffine3, DMat3, DVec3};
use std::cell::Cell;
use std::path::PathBuf;
use std::rc::Rc;
use translume_bxdf::Rgb;

/// A plugin with its properties and what is nested in it.
#[derive(Debug)]
pub(crate) struct Object {
    /// What it is: "shape", "bsdf", …
    pub(crate) class: String,
    /// Which one: "sphere", "diffuse", …
    pub(crate) plugin: String,
    /// Empty when it has none.
    pub(crate) id: String,
    pub(crate) place: Place,
    pub(crate) properties: Vec<Property>,
    pub(crate) children: Vec<Child>,
}

#[derive(Debug)]
pub(crate) struct Property {
    pub(crate) name: String,
    pub(crate) value: Value,
    pub(crate) place: Place,
    pub(crate) used: Cell<bool>,
}

#[derive(Clone, Debug)]
pub(crate) enum Value {
    Bool(bool),
    Number(f64),
    Text(String),
    Point(DVec3),
    Color(Rgb),
    Spectrum(Spectrum),
    Transform(DAffine3),
}

/// A spectrum that is not a colour yet: what it becomes depends on what it is used for.
#[derive(Clone, Debug)]
pub(crate) enum Spectrum {
    Uniform(f64),
    /// Wavelengths in nm and values.
    Sampled(Vec<(f64, f64)>),
    /// Linear Rec. 709, worked out already.
    Light(Rgb),
}

impl Spectrum {
    pub(crate) fn color(&self, quantity: Quantity) -> Rgb {
        match self {
            Self::Uniform(v) => spectrum::uniform(*v, quantity),
            Self::Sampled(samples) => spectrum::sampled(samples, quantity),
            Self::Light(rgb) => *rgb,
        }
    }
}

#[derive(Debug)]
pub(crate) struct Child {
    /// The role it plays for its parent; empty when it has none.
    pub(crate) name: String,
    pub(crate) target: Target,
    pub(crate) place: Place,
    pub(crate) used: Cell<bool>,
}

#[derive(Clone, Debug)]
pub(crate) enum Target {
    Object(Rc<Object>),
    /// What carries this id, somewhere in the scene.
    Reference(String),
}

/// What building an object needs to know.
pub(crate) struct Context<'a> {
    /// Where files are looked for.
    pub(crate) folders: &'a [PathBuf],
    pub(crate) warnings: Vec<String>,
}

/// Tags of properties, and of objects.
const PROPERTIES: [&str; 10] =
    ["boolean", "integer", "float", "string", "rgb", "srgb", "blackbody", "point", "vector", "transform"];
const OBJECTS: [&str; 15] = [
    "integrator",
    "sensor",
    "bsdf",
    "shape",
    "emitter",
    "medium",
    "texture",
    "volume",
    "film",
    "rfilter",
    "sampler",
    "phase",
    "subsurface",
    "spectrum",
    "shader",
];

/// Builds the object that `element` describes, children included.
pub(crate) fn object(element: &Element, context: &mut Context) -> Result<Object> {
    let plugin = element.need("type")?;
    let mut object = Object {
        class: class(&element.tag).to_owned(),
        plugin: plugin.to_ascii_lowercase(),
        id: element.get("id").unwrap_or_default().to_owned(),
        place: element.place.clone(),
        properties: Vec::new(),
        children: Vec::new(),
    };
    for child in &element.children {
        if is_property(child) {
            let name = snake_case(child.get("name").unwrap_or_default());
            let value = value(child, context)?;
            object.properties.push(Property { name, value, place: child.place.clone(), used: Cell::new(false) });
            warn_unused(child, context);
        } else {
            object.children.extend(scene_child(child, context)?);
        }
    }
    Ok(object)
}

fn is_property(element: &Element) -> bool {
    PROPERTIES.contains(&element.tag.as_str()) || (element.tag == "spectrum" && element.get("type").is_none())
}

/// The object or reference that `element` is; `None` for an alias, with which the scene deals.
pub(crate) fn scene_child(element: &Element, context: &mut Context) -> Result<Option<Child>> {
    let name = snake_case(element.get("name").unwrap_or_default());
    let target = match class(&element.tag) {
        "alias" => return Ok(None),
        "ref" => Target::Reference(element.need("id")?.to_owned()),
        tag if OBJECTS.contains(&tag) => Target::Object(Rc::new(object(element, context)?)),
        _ if is_property(element) => {
            return Err(element.place.invalid(format!("<{}> stands where only objects do", element.tag)));
        }
        _ => return Err(element.place.unsupported(format!("<{}> is not known", element.tag))),
    };
    warn_unused(element, context);
    Ok(Some(Child { name, target, place: element.place.clone(), used: Cell::new(false) }))
}

fn warn_unused(element: &Element, context: &mut Context) {
    for attribute in element.unused().filter(|a| !["version", "intent", "unit"].contains(a)) {
        let what = format!("attribute {attribute:?} of <{}> is not known and not used", element.tag);
        context.warnings.push(element.place.warning(what));
    }
}

/// Old names of classes.
fn class(tag: &str) -> &str {
    match tag {
        "camera" => "sensor",
        "luminaire" => "emitter",
        tag => tag,
    }
}

/// `diffuseReflectance` → `diffuse_reflectance`, `intIOR` → `int_ior`.
pub(crate) fn snake_case(name: &str) -> String {
    let mut result = String::with_capacity(name.len() + 4);
    let mut before_was_lower = false;
    for c in name.chars() {
        if c.is_ascii_uppercase() && before_was_lower {
            result.push('_');
        }
        before_was_lower = c.is_ascii_lowercase() || c.is_ascii_digit();
        result.push(c.to_ascii_lowercase());
    }
    result
}

fn value(element: &Element, context: &mut Context) -> Result<Value> {
    let place = &element.place;
    Ok(match element.tag.as_str() {
        "boolean" => match element.need("value")?.trim() {
            "true" | "True" => Value::Bool(true),
            "false" | "False" => Value::Bool(false),
            other => return Err(place.invalid(format!("{other:?} is neither true nor false"))),
        },
        "integer" | "float" => Value::Number(number(element.need("value")?, place)?),
        "string" => Value::Text(element.need("value")?.to_owned()),
        "point" | "vector" => Value::Point(point(element, 0.0)?),
        "rgb" | "srgb" => Value::Color(color(element)?),
        "blackbody" => Value::Spectrum(black_body(element)?),
        "spectrum" => Value::Spectrum(spectrum(element, context)?),
        _ => Value::Transform(transform(element)?),
    })
}

/// One finite number.
pub(crate) fn number(text: &str, place: &Place) -> Result<f64> {
    let text = text.trim();
    match text.parse::<f64>() {
        Ok(v) if v.abs() <= f64::from(f32::MAX) => Ok(v),
        // Mitsuba accepts infinities where they mean "no limit".
        Ok(v) if v.is_infinite() && text.contains(['i', 'I']) => Ok(f64::from(f32::MAX).copysign(v)),
        Ok(v) if v.is_nan() => Err(place.invalid("NaN is no value")),
        Ok(_) => Err(place.invalid(format!("{text} is too large"))),
        Err(_) => Err(place.invalid(format!("{text:?} is not a number"))),
    }
}

/// Numbers separated by commas or spaces.
fn numbers(text: &str, place: &Place) -> Result<Vec<f64>> {
    text.split([',', ' ', '\t', '\r', '\n']).filter(|t| !t.is_empty()).map(|t| number(t, place)).collect()
}

/// `x`, `y`, `z`, or `value` with one number or three; `missing` where one is not given.
fn point(element: &Element, missing: f64) -> Result<DVec3> {
    let place = &element.place;
    if let Some(value) = element.get("value") {
        return match numbers(value, place)?[..] {
            [x, y, z] => Ok(DVec3::new(x, y, z)),
            [x, y] => Ok(DVec3::new(x, y, missing)),
            [x] => Ok(DVec3::splat(x)),
            _ => Err(place.invalid(format!("<{}> wants one number or three, not {value:?}", element.tag))),
        };
    }
    let axis = |name| element.get(name).map_or(Ok(missing), |v| number(v, place));
    Ok(DVec3::new(axis("x")?, axis("y")?, axis("z")?))
}

fn color(element: &Element) -> Result<Rgb> {
    let place = &element.place;
    let value = element.need("value")?.trim();
    let encoded = element.tag == "srgb" || value.starts_with('#');
    let rgb = match value.strip_prefix('#') {
        Some(hex) if hex.len() == 6 && hex.is_ascii() => {
            let code = |i: usize| u8::from_str_radix(&hex[i..i + 2], 16).map(|v| f64::from(v) / 255.0);
            match (code(0), code(2), code(4)) {
                (Ok(r), Ok(g), Ok(b)) => vec![r, g, b],
                _ => return Err(place.invalid(format!("{value:?} is not a colour"))),
            }
        }
        _ => numbers(value, place)?,
    };
    let rgb = match rgb[..] {
        [v] => DVec3::splat(v),
        [r, g, b] => DVec3::new(r, g, b),
        _ => return Err(place.invalid(format!("a colour has one number or three, not {value:?}"))),
    }
    .as_vec3();
    Ok(if encoded { Rgb::from(rgb.to_array().map(translume_image::colour::srgb_to_linear)) } else { rgb })
}

fn black_body(element: &Element) -> Result<Spectrum> {
    let place = &element.place;
    let text = element.need("temperature")?;
    let kelvin = number(text.trim().trim_end_matches(['K', 'k']), place)?;
    let scale = element.get("scale").map_or(Ok(1.0), |s| number(s, place))?;
    if kelvin <= 0.0 {
        return Err(place.invalid("a temperature is above 0 K"));
    }
    Ok(Spectrum::Light(spectrum::black_body(kelvin) * scale as f32))
}

/// `value` with one number, or with pairs `nm:value`; or a file of such pairs.
fn spectrum(element: &Element, context: &Context) -> Result<Spectrum> {
    let place = &element.place;
    let pairs = if let Some(name) = element.get("filename") {
        let path = find(context.folders, name, place);
        let text = read_text(&path).map_err(|e| e.at(&place.file, place.line))?;
        spectrum_lines(&path, &text)?
    } else {
        let value = element.need("value")?;
        if !value.contains(':') {
            return match numbers(value, place)?[..] {
                [v] => Ok(Spectrum::Uniform(v)),
                [r, g, b] => Ok(Spectrum::Light(DVec3::new(r, g, b).as_vec3())),
                _ => Err(place.invalid("a spectrum is one number, or pairs of wavelength:value")),
            };
        }
        let parts = value.split([',', ' ', '\t', '\r', '\n']).filter(|t| !t.is_empty());
        parts.map(|pair| numbers(&pair.replace(':', " "), place)).collect::<Result<Vec<_>>>()?
    };
    samples(&pairs, place)
}

/// The lines of a file of a spectrum. The file may be any that the scene names: messages say the line, not what is in it.
fn spectrum_lines(path: &std::path::Path, text: &str) -> Result<Vec<Vec<f64>>> {
    let lines = text.lines().map(|l| l.split('#').next().unwrap_or_default().trim()).enumerate();
    let line = |(i, line): (usize, &str)| {
        let place = Place { file: path.into(), line: i as u32 + 1 };
        match numbers(line, &place) {
            Ok(pair) if pair.len() == 2 => Ok(pair),
            _ => Err(place.invalid("a wavelength and a number are wanted in each line of a spectrum")),
        }
    };
    lines.filter(|(_, l)| !l.is_empty()).map(line).collect()
}

fn samples(pairs: &[Vec<f64>], place: &Place) -> Result<Spectrum> {
    let mut samples = Vec::with_capacity(pairs.len());
    for pair in pairs {
        let [nm, value] = pair[..] else {
            return Err(place.invalid("a spectrum's samples are pairs of wavelength:value"));
        };
        if samples.last().is_some_and(|&(before, _)| nm <= before) {
            return Err(place.invalid(format!("the wavelengths of a spectrum do not increase at {nm}")));
        }
        samples.push((nm, value));
    }
    Ok(Spectrum::Sampled(samples))
}

/// The product of the operations in `element`, the first one applied first.
fn transform(element: &Element) -> Result<DAffine3> {
    let mut whole = DAffine3::IDENTITY;
    for step in &element.children {
        whole = operation(step)? * whole;
    }
    if !whole.is_finite() {
        return Err(element.place.invalid("the transform is not finite"));
    }
    Ok(whole)
}

fn operation(step: &Element) -> Result<DAffine3> {
    let place = &step.place;
    Ok(match step.tag.as_str() {
        "translate" => DAffine3::from_translation(point(step, 0.0)?),
        "scale" => DAffine3::from_mat3(DMat3::from_diagonal(point(step, 1.0)?)),
        "rotate" => {
            let Some(axis) = point(step, 0.0)?.try_normalize() else {
                return Err(place.invalid("<rotate> has no axis"));
            };
            DAffine3::from_axis_angle(axis, number(step.need("angle")?, place)?.to_radians())
        }
        "matrix" => matrix(&numbers(step.need("value")?, place)?, place)?,
        "lookat" => look_at(step)?,
        tag => return Err(place.unsupported(format!("<{tag}> in a transform is not known"))),
    })
}

fn matrix(v: &[f64], place: &Place) -> Result<DAffine3> {
    let rows = |n: usize| DMat3::from_cols_array(&std::array::from_fn(|i| v[i % 3 * n + i / 3]));
    match v.len() {
        9 => Ok(DAffine3::from_mat3(rows(3))),
        16 if v[12..15].iter().any(|x| x.abs() > 1e-9) || v[15] == 0.0 => {
            Err(place.unsupported("a matrix with perspective; only affine ones are read"))
        }
        16 => Ok(DAffine3::from_mat3_translation(rows(4) * v[15].recip(), DVec3::new(v[3], v[7], v[11]) / v[15])),
        n => Err(place.invalid(format!("a matrix has 16 numbers or 9, not {n}"))),
    }
}

fn look_at(step: &Element) -> Result<DAffine3> {
    let place = &step.place;
    let vector = |name: &str| match numbers(step.need(name)?, place)?[..] {
        [x, y, z] => Ok(DVec3::new(x, y, z)),
        _ => Err(place.invalid(format!("{name:?} of <lookat> has three numbers"))),
    };
    let (origin, target) = (vector("origin")?, vector("target")?);
    let Some(forward) = (target - origin).try_normalize() else {
        return Err(place.invalid("<lookat>: origin and target are the same point"));
    };
    let up = match step.get("up") {
        Some(_) => vector("up")?,
        None => forward.any_orthogonal_vector(),
    };
    crate::sensor::look_at(origin, target, up).ok_or_else(|| place.invalid("<lookat>: up is zero or along the view"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_all_dialects_are_one() {
        for (old, new) in [
            ("toWorld", "to_world"),
            ("intIOR", "int_ior"),
            ("diffuseReflectance", "diffuse_reflectance"),
            ("sigmaS", "sigma_s"),
            ("to_world", "to_world"),
            ("fovAxis", "fov_axis"),
            ("alpha", "alpha"),
        ] {
            assert_eq!(snake_case(old), new);
        }
    }
}
