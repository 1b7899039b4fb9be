//! Typed access to the properties of objects.

use super::object::{Object, Property, Value};
use crate::{Error, Result};
use glam::{DAffine3, DVec3};

/// Properties that do not change the expected picture: how files are written, how sampling is done, what is cached.
pub(super) const WITHOUT_EFFECT: [&str; 24] = [
    "accel",
    "banner",
    "cache",
    "compensate",
    "component_format",
    "compress",
    "file_format",
    "format",
    "high_quality_edges",
    "max_anisotropy",
    "method",
    "metadata",
    "mis_compensation",
    "pixel_format",
    "sample_border",
    "sample_emitters",
    "sample_visible",
    "sampling_weight",
    "seed",
    "shutter_close",
    "shutter_open",
    "silhouette_sampling_weight",
    "specular_sampling_weight",
    "step_size",
];

impl Property {
    fn wrong(&self, wanted: &str) -> Error {
        self.place.invalid(format!("property {:?} is not {wanted}", self.name))
    }
}

impl Object {
    /// A property by name; it counts as used from now on.
    pub(super) fn property(&self, name: &str) -> Option<&Property> {
        let property = self.properties.iter().find(|p| p.name == name)?;
        property.used.set(true);
        Some(property)
    }

    pub(super) fn number(&self, name: &str) -> Result<Option<f64>> {
        self.property(name)
            .map(|p| if let Value::Number(v) = p.value { Ok(v) } else { Err(p.wrong("a number")) })
            .transpose()
    }

    /// A number that must be above 0.
    pub(super) fn positive(&self, name: &str, default: f64) -> Result<f64> {
        match self.number(name)? {
            Some(v) if v > 0.0 => Ok(v),
            Some(_) => Err(self.place.invalid(format!("{name:?} of {} is not above 0", self.title()))),
            None => Ok(default),
        }
    }

    pub(super) fn integer(&self, name: &str) -> Result<Option<i64>> {
        let Some(p) = self.property(name) else { return Ok(None) };
        match p.value {
            Value::Number(v) if v.fract() == 0.0 && v.abs() < 9e15 => Ok(Some(v as i64)),
            _ => Err(p.wrong("a whole number")),
        }
    }

    pub(super) fn boolean(&self, name: &str, default: bool) -> Result<bool> {
        let Some(p) = self.property(name) else { return Ok(default) };
        if let Value::Bool(v) = p.value { Ok(v) } else { Err(p.wrong("true or false")) }
    }

    pub(super) fn text(&self, name: &str) -> Result<Option<&str>> {
        self.property(name)
            .map(|p| if let Value::Text(v) = &p.value { Ok(v.as_str()) } else { Err(p.wrong("a string")) })
            .transpose()
    }

    pub(super) fn point(&self, name: &str) -> Result<Option<DVec3>> {
        self.property(name)
            .map(|p| if let Value::Point(v) = p.value { Ok(v) } else { Err(p.wrong("a point")) })
            .transpose()
    }

    /// The transform, the identity when there is none.
    pub(super) fn transform(&self, name: &str) -> Result<DAffine3> {
        let Some(p) = self.property(name) else { return Ok(DAffine3::IDENTITY) };
        if let Value::Transform(v) = p.value { Ok(v) } else { Err(p.wrong("a transform")) }
    }

    /// The transform; it must be possible to turn it back.
    pub(super) fn invertible(&self, name: &str) -> Result<DAffine3> {
        let m = self.transform(name)?;
        if crate::check::is_invertible(&m) {
            return Ok(m);
        }
        Err(self.place.invalid(format!("{name:?} of {} is degenerate: it cannot be inverted", self.title())))
    }
}
