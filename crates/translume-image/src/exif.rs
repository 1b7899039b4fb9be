//! The facts of the shot from an EXIF block.

use crate::{Metadata, orient::Orientation};
use exif::{Exif, Field, In, Tag, Value};

/// Fills what `block` (a TIFF structure, as it stands in JPEG, PNG and TIFF files) says into `metadata`.
/// Damaged fields are left out: a broken tag is no reason to refuse the pixels.
pub(crate) fn read_block(block: Vec<u8>, metadata: &mut Metadata) -> Orientation {
    let mut reader = exif::Reader::new();
    reader.continue_on_error(true);
    match reader.read_raw(block).or_else(|e| e.distill_partial_result(|_| ())) {
        Ok(exif) => fill(&|tag| Exif::get_field(&exif, tag, In::PRIMARY), metadata),
        Err(_) => Orientation::default(),
    }
}

/// [`read_block`] for a whole TIFF file, without a copy of it.
pub(crate) fn read_tiff(file: &[u8], metadata: &mut Metadata) -> Orientation {
    match exif::parse_exif(file) {
        Ok((fields, _)) => fill(&|tag| fields.iter().find(|f| f.tag == tag && f.ifd_num == In::PRIMARY), metadata),
        Err(_) => Orientation::default(),
    }
}

fn fill<'a>(field: &dyn Fn(Tag) -> Option<&'a Field>, metadata: &mut Metadata) -> Orientation {
    let value = |tag| field(tag).and_then(|f| number(&f.value));
    let positive = |tag| value(tag).filter(|v| v.is_finite() && *v > 0.0);
    let words = |tag| field(tag).and_then(|f| text(&f.value));
    // APEX values stand in where the plain ones are missing: t = 2^-Tv, N = 2^(Av/2).
    metadata.exposure_secs =
        positive(Tag::ExposureTime).or_else(|| value(Tag::ShutterSpeedValue).map(|tv| (-tv).exp2()).filter(sane));
    metadata.f_number =
        positive(Tag::FNumber).or_else(|| value(Tag::ApertureValue).map(|av| (av / 2.0).exp2()).filter(sane));
    metadata.iso = positive(Tag::PhotographicSensitivity).or_else(|| positive(Tag::ISOSpeed));
    metadata.camera = match (words(Tag::Make), words(Tag::Model)) {
        (Some(make), Some(model)) if !model.starts_with(&make) => Some(format!("{make} {model}")),
        (make, model) => model.or(make),
    };
    metadata.owner = words(Tag::Copyright).or_else(|| words(Tag::Artist));
    metadata.date_time = words(Tag::DateTimeOriginal).or_else(|| words(Tag::DateTime));
    Orientation::from_exif(value(Tag::Orientation).map_or(1, |v| v as u32))
}

fn sane(v: &f64) -> bool {
    v.is_finite() && *v > 0.0
}

/// The first number of a field.
fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Rational(v) => v.first().map(|r| f64::from(r.num) / f64::from(r.denom)),
        Value::SRational(v) => v.first().map(|r| f64::from(r.num) / f64::from(r.denom)),
        Value::Float(v) => v.first().map(|&f| f64::from(f)),
        Value::Double(v) => v.first().copied(),
        other => other.get_uint(0).map(f64::from),
    }
}

fn text(value: &Value) -> Option<String> {
    let Value::Ascii(parts) = value else { return None };
    let joined = parts.iter().map(|p| String::from_utf8_lossy(p)).collect::<Vec<_>>().join(" ");
    let trimmed = joined.trim_matches(|c: char| c.is_whitespace() || c == '\0');
    (!trimmed.is_empty()).then(|| trimmed.to_owned())
}
